"""From blocks of a scene to flat arrays: numbering, zones, masses, surfaces."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from fdem.compile.zones import scene_zones
from fdem.errors import FdemWarning, SceneError, UnsupportedError
from fdem.model import Model
from fdem.scene.bodies import Zoned
from fdem.scene.boundary import Stress, Velocity
from fdem.scene.kept import Kept
from fdem.scene.scene import Applied, Block, Gridpoint, Scene, choose, surface_of
from fdem.scene.shapes import Surface
from fdem.state import State

__all__ = ["Layout", "assemble", "lay_out"]


@dataclass
class Layout:
    """Which block is what, and where its gridpoints are, before any mechanics.

    Attributes
    ----------
    blocks : list of Block
        Blocks in model order.
    kind : list of str
        "zoned", "rigid" (with its motion prescribed if the block is fixed) or "static".
    meshes : list
        Zone mesh of each zoned block, else None.
    loops, loop_tags : list
        Faces of each block as vertex loops (local numbers) with their tags.
    triangles, triangle_tags : list
        Surface triangles of each block (local numbers) with their tags.
    zone_notes : list of str
        What is worth telling about the zones.
    kept : dict
        Zones by block name that are those of an earlier state, not what the scene would now get.
    """

    scene: Scene
    blocks: list[Block]
    index: dict[Block, int]
    kind: list[str]
    meshes: list[Any]
    origin: np.ndarray
    gp_range: np.ndarray
    points: list[np.ndarray]
    loops: list[list[np.ndarray]]
    loop_tags: list[list[str | None]]
    triangles: list[np.ndarray]
    triangle_tags: list[list[str | None]]
    loads: list[Applied]
    zone_notes: list[str]
    kept: dict[str, Any]

    def of_kind(self, kind: str) -> list[int]:
        """Model indices of the blocks of one kind, in order."""
        return [i for i, k in enumerate(self.kind) if k == kind]


def lay_out(scene: Scene, removed: frozenset[str], loads: list[Applied], before: Kept | None = None) -> Layout:
    """Decide how every block moves, subdivide the deformable ones, number gridpoints.

    Blocks that are in `before` with the same shape and body keep the zones they have there, and its origin stays.

    Raises
    ------
    SceneError
        If no block is left.
    """
    everything = scene.blocks
    blocks = [block for block in everything if block.name not in removed]
    if not blocks:
        raise SceneError("the scene has no block")
    for block in blocks:
        scene.check(block)
        if callable(getattr(block.material, "density", None)):
            raise UnsupportedError(f"block {block.name!r}: a density that varies in space is not there yet")
    kinds = dict(zip(everything, _kinds(scene, everything, loads), strict=True))
    kind = [kinds[block] for block in blocks]
    _refuse_twins(blocks, kind)
    bounds = np.array([block.shape.bounds for block in everything])
    # a state that goes on is relative to the origin it had
    origin = 0.5 * (bounds[:, 0].min(axis=0) + bounds[:, 1].max(axis=0)) if before is None else before.origin
    zoned, zone_notes = scene_zones(scene, [block for block in everything if kinds[block] == "zoned"])
    kept = {} if before is None else before.differing(zoned)
    if kept:
        zone_notes = [*zone_notes, f"zones: {len(kept)} blocks keep those they had, which do not fit new neighbours"]
    meshes = [kept.get(block.name, zoned.get(block)) for block in blocks]
    points, loops, loop_tags, triangles, triangle_tags = [], [], [], [], []
    for block, mesh in zip(blocks, meshes, strict=True):
        surface = surface_of(block.shape)
        face_tags = list(surface.face_tags)
        if mesh is None:
            points.append(np.asarray(surface.points) - origin)
            loops.append([np.asarray(face, dtype=np.int32) for face in surface.faces])
            loop_tags.append(face_tags)
            triangles.append(np.asarray(surface.triangles))
            triangle_tags.append([face_tags[f] for f in surface.triangle_face])
        else:
            points.append(np.asarray(mesh.points) - origin)
            loops.append(list(mesh.triangles))
            tags = [face_tags[f] for f in mesh.triangle_face]
            loop_tags.append(tags)
            triangles.append(mesh.triangles)
            triangle_tags.append(tags)
    order = [i for k in ("zoned", "rigid", "static") for i, have in enumerate(kind) if have == k]
    gp_range = np.zeros((len(blocks), 2), dtype=np.int64)
    start = 0
    for i in order:
        gp_range[i] = start, start + len(points[i])
        start += len(points[i])
    index = {block: i for i, block in enumerate(blocks)}
    return Layout(
        scene, blocks, index, kind, meshes, origin, gp_range, points, loops, loop_tags, triangles, triangle_tags, loads,
        zone_notes, kept,
    )  # fmt: skip


def _refuse_twins(blocks: list[Block], kind: list[str]) -> None:
    """Refuse a shape added twice: its faces look the same way, so contact would not see the overlap."""
    seen: dict[tuple[float, ...], int] = {}
    for i, block in enumerate(blocks):
        first = seen.setdefault((block.shape.volume, *np.asarray(block.shape.bounds).ravel().tolist()), i)
        if first != i and not kind[first] == kind[i] == "static":
            raise SceneError(f"blocks {blocks[first].name!r} and {block.name!r} overlap: they fill the same place")


def _kinds(scene: Scene, blocks: list[Block], loads: list[Applied]) -> list[str]:
    pinned: set[Block] = set()
    for fix in scene.fixes:
        if fix.components is None and fix.where is None and not isinstance(fix.target, Gridpoint):
            pinned |= {block for block, tag in scene.select(fix.target) if tag is None}
    driven: set[Block] = set()
    for applied in loads:
        if isinstance(applied.load, Velocity) and not isinstance(applied.target, Gridpoint):
            driven |= {block for block, tag in scene.select(applied.target) if tag is None}
    kinds = []
    for block in blocks:
        moves = bool(np.any(block.velocity) or np.any(block.angular_velocity)) or block in driven
        if block in pinned and not block.fixed:
            if moves:
                raise SceneError(f"block {block.name!r}: fix() holds it, but it has a velocity")
            kinds.append("static")
        elif block.fixed:
            kinds.append("rigid" if moves else "static")
        else:
            kinds.append("zoned" if isinstance(block.body, Zoned) else "rigid")
    return kinds


def assemble(layout: Layout, threads: int) -> tuple[Model, State]:
    """Flat arrays, formulations and the state at the start."""
    n_gp = int(layout.gp_range.max())
    X = np.zeros((n_gp, 3))
    for (start, stop), points in zip(layout.gp_range, layout.points, strict=True):
        X[start:stop] = points
    zoned, rigid = layout.of_kind("zoned"), layout.of_kind("rigid")
    n_zoned_gp = int(layout.gp_range[zoned, 1].max()) if zoned else 0
    state = State.make(X, len(rigid), n_zoned_gp)
    zones, zone_block, zone_start = _zones(layout, zoned)
    volume = np.array([b.shape.volume if not isinstance(b.shape, Surface) else _extent(b) ** 3 for b in layout.blocks])
    density = np.array([0.0 if b.material is None else float(b.material.density) for b in layout.blocks])
    notes = list(layout.zone_notes)
    deformable = _zoned_batch(layout, zoned, X, zones, zone_start, state, threads, notes) if zoned else None
    body, rigid_mass = _rigid_batch(layout, rigid, X, density) if rigid else (None, np.zeros(0))
    mass = density * volume
    gp_mass = np.zeros(n_gp)
    for i in rigid:
        gp_mass[slice(*layout.gp_range[i])] = rigid_mass[rigid.index(i)]
    if deformable is not None:
        gp_mass[:n_zoned_gp] = deformable.gp_mass
        _warn_inertia(layout, zoned, deformable, notes)
    row = np.full(len(layout.blocks), -1)
    row[zoned], row[rigid] = np.arange(len(zoned)), np.arange(len(rigid))
    tags = sorted({tag for per_block in layout.loop_tags for tag in per_block if tag is not None})
    number = {tag: i for i, tag in enumerate(tags)}
    counts = [len(t) for t in layout.triangles]
    speed = np.array([_wave_speeds(b) for b in layout.blocks])
    model = Model(
        names=[b.name for b in layout.blocks],
        groups=[b.group for b in layout.blocks],
        gp_range=layout.gp_range,
        zoned=np.array([k == "zoned" for k in layout.kind]),
        fixed=np.array([b.fixed or k == "static" for b, k in zip(layout.blocks, layout.kind, strict=True)]),
        batch_row=row,
        volume=volume,
        mass=mass,
        size=np.cbrt(volume),
        centroid=np.array([b.shape.centroid for b in layout.blocks]) - layout.origin,
        gp_mass=gp_mass,
        origin=layout.origin,
        X=X,
        zones=zones,
        zone_block=zone_block,
        zone_start=zone_start,
        triangles=np.vstack([t + s for t, (s, _) in zip(layout.triangles, layout.gp_range, strict=True)]).astype(
            np.int32
        ),
        triangle_block=np.repeat(np.arange(len(counts)), counts).astype(np.int32),
        triangle_tag=np.array(
            [-1 if t is None else number[t] for tags_ in layout.triangle_tags for t in tags_], dtype=np.int32
        ),
        tags=tags,
        batches=tuple(b for b in (body, deformable) if b is not None),
        rigid=body,
        deformable=deformable,
        gravity=layout.scene.gravity,
        damping_ratio=max([getattr(rule.law, "damping_ratio", 0.0) for rule in layout.scene.joints], default=0.0),
        joint_names=[_joint_name(rule) for rule in layout.scene.joints],
        wave_speed=speed,
        notes=notes,
    )
    if body is not None:
        body.rows, body.size, body.free = np.array(rigid), model.size[rigid], ~model.fixed[rigid]
    if deformable is not None:
        deformable.rows = np.array(zoned)
    _start(layout, model, state, rigid)
    return model, state


def _joint_name(rule: Any) -> str:
    what = rule.between or rule.target
    return type(rule.law).__name__ + (f" {what}" if what is not None else "")


def _extent(block: Block) -> float:
    return float(np.ptp(np.asarray(block.shape.bounds), axis=0).max())


def _wave_speeds(block: Block) -> tuple[float, float]:
    material = block.material
    if material is None or material.young is None:
        return np.nan, np.nan
    lam, mu = material.lame
    return float(np.sqrt((lam + 2 * mu) / material.density)), float(np.sqrt(mu / material.density))


def _zones(layout: Layout, zoned: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    counts = np.zeros(len(layout.blocks), dtype=np.int64)
    counts[zoned] = [len(layout.meshes[i].tets) for i in zoned]
    parts = [layout.meshes[i].tets + layout.gp_range[i, 0] for i in zoned]
    zones = np.vstack(parts).astype(np.int32) if parts else np.zeros((0, 4), dtype=np.int32)
    block = np.repeat(np.arange(len(counts)), counts).astype(np.int32)
    return zones, block, np.concatenate([[0], np.cumsum(counts)])


def _zoned_batch(
    layout: Layout,
    zoned: list[int],
    X: np.ndarray,
    zones: np.ndarray,
    zone_start: np.ndarray,
    state: State,
    threads: int,
    notes: list[str],
) -> Any:
    from fdem.blocks.zoned import ZonedBlocks

    blocks = [layout.blocks[i] for i in zoned]
    lame = np.array([b.material.lame for b in blocks])
    n_gp = int(layout.gp_range[zoned, 1].max())
    stress = in_situ(layout, X[zones].mean(axis=1) + layout.origin, np.repeat(zoned, np.diff(zone_start)[zoned]))
    if stress is None:
        notes.append("zones: no in-situ stress, its arrays are left out")
    return ZonedBlocks(
        X=X[:n_gp],
        zones=zones,
        zone_start=np.concatenate([[0], np.cumsum(np.diff(zone_start)[zoned])]),
        gp_start=np.concatenate([layout.gp_range[zoned, 0], [n_gp]]),
        density=np.array([float(b.material.density) for b in blocks]),
        lam=lame[:, 0].copy(),
        mu=lame[:, 1].copy(),
        large=np.array([b.body.strain == "large" for b in blocks]),
        mass=[b.body.mass for b in blocks],
        dofs=slice(len(state.v) - 3 * n_gp, len(state.v)),
        coords=slice(len(state.q) - 3 * n_gp, len(state.q)),
        gridpoints=slice(0, n_gp),
        stress0=stress,
        threads=threads,
    )


def in_situ(layout: Layout, places: np.ndarray, owner: np.ndarray) -> np.ndarray | None:
    """In-situ stress (n, 6) at `places` in the blocks `owner`; None where no `Stress` is applied."""
    result = None
    for applied in layout.loads:
        if not isinstance(applied.load, Stress):
            continue
        rows = [layout.index[b] for b in layout.scene.select_blocks(applied.target) if b in layout.index]
        mask = np.isin(owner, rows)
        if applied.where is not None:
            mask &= choose("Stress", applied.where, places)
        result = np.zeros((len(places), 6)) if result is None else result
        factor = applied.factor(0.0) if callable(applied.factor) else applied.factor
        result[mask] += float(factor) * applied.load.at(places[mask])
    return result


def _rigid_batch(layout: Layout, rigid: list[int], X: np.ndarray, density: np.ndarray) -> tuple[Any, np.ndarray]:
    from fdem.blocks.rigid import RigidBlocks

    mass, inertia, centroid = np.zeros(len(rigid)), np.zeros((len(rigid), 3, 3)), np.zeros((len(rigid), 3))
    for row, i in enumerate(rigid):
        shape = layout.blocks[i].shape
        # a platen without material moves as prescribed: its mass is never used, its weight must not matter
        rho = density[i] if density[i] > 0 else 1e-30 * density.max() or 1.0
        mass[row], inertia[row] = rho * shape.volume, shape.inertia(rho)
        if layout.blocks[i].fixed:
            # equal moments: a prescribed spin then stays what it is within a step
            inertia[row] = np.trace(inertia[row]) / 3.0 * np.eye(3)
        centroid[row] = shape.centroid - layout.origin
    start = np.append(layout.gp_range[rigid, 0], layout.gp_range[rigid[-1], 1])
    batch = RigidBlocks(
        X=X,
        gp_start=start,
        mass=mass,
        inertia=inertia,
        centroid=centroid,
        dofs=slice(0, 6 * len(rigid)),
        coords=slice(0, 7 * len(rigid)),
        gridpoints=slice(int(start[0]), int(start[-1])),
    )
    return batch, mass


def _start(layout: Layout, model: Model, state: State, rigid: list[int]) -> None:
    """Initial positions and velocities."""
    if model.rigid is not None:
        model.rigid.start(state.q)
        for row, i in enumerate(rigid):
            state.v[6 * row : 6 * row + 3] = layout.blocks[i].velocity
            state.v[6 * row + 3 : 6 * row + 6] = layout.blocks[i].angular_velocity
    first = 6 * len(rigid)
    for i in layout.of_kind("zoned"):
        start, stop = layout.gp_range[i]
        masses = model.gp_mass[start:stop]
        centre = masses @ model.X[start:stop] / masses.sum()
        block = layout.blocks[i]
        spin = np.cross(block.angular_velocity, model.X[start:stop] - centre)
        state.v[first + 3 * start : first + 3 * stop] = (block.velocity + spin).ravel()


def _warn_inertia(layout: Layout, zoned: list[int], batch: Any, notes: list[str]) -> None:
    ratio, shift = np.asarray(batch.inertia_ratio), np.asarray(batch.centre_shift)
    worst = int(np.argmax(ratio))
    notes.append(
        f"gridpoint masses: inertia up to {ratio.max():.3f} of exact (block {layout.blocks[zoned[worst]].name!r}), "
        f"centre of mass shifted by up to {shift.max():.3g} of the block size"
    )
    if ratio.max() > 1.1 or shift.max() > 0.1:
        warnings.warn(
            f"block {layout.blocks[zoned[worst]].name!r}: lumped masses give {ratio.max():.2f} times the exact "
            "inertia; "
            'a finer size or Zoned(mass="inertia-matched") helps where blocks rotate',
            FdemWarning,
            stacklevel=2,
        )
