"""Which block is what, and where its gridpoints are, before any mechanics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fdem.compile.zones import scene_zones
from fdem.errors import SceneError
from fdem.scene.boundary import Stress, Velocity
from fdem.scene.facets import facets
from fdem.scene.kept import Kept
from fdem.scene.moments import MassProperties, mass_properties
from fdem.scene.scene import Applied, Block, Gridpoint, Scene, choose, surface_of
from fdem.scene.shapes import Balls, Sphere, Surface

__all__ = ["Layout", "in_situ", "lay_out"]

# order of gridpoints: those that are unknowns first, in memory that x and q share
NUMBERED = ("zoned", "rigid", "uniform", "linear", "sphere", "static")


@dataclass
class Layout:
    """Which block is what, and where its gridpoints are, before any mechanics.

    Attributes
    ----------
    blocks : list of Block
        Blocks in model order.
    kind : list of str
        "rigid" (with its motion prescribed if the block is fixed), "sphere", "uniform", "linear", "zoned" or "static".
    meshes : list
        Zone mesh of each zoned block, facets of each block of linear strain, else None.
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

    def properties(self, i: int) -> MassProperties:
        """Mass properties of a block with a material; they belong to the scene, as excavations do not change them."""
        block = self.blocks[i]
        cache: dict[Any, MassProperties] = self.scene.__dict__.setdefault("mass_cache", {})
        key = block.shape, block.material.density
        if key not in cache:
            cache[key] = mass_properties(block.shape, block.material.density, f"block {block.name!r}")
        return cache[key]

    @cached_property
    def volume(self) -> np.ndarray:
        """Volumes (n_blocks,) [m^3]; of an open surface the cube of its extent."""
        return np.array([_extent(b) ** 3 if isinstance(b.shape, Surface) else b.shape.volume for b in self.blocks])

    @cached_property
    def density(self) -> np.ndarray:
        """Mean densities (n_blocks,) [kg/m^3]; 0 without material."""
        result = np.zeros(len(self.blocks))
        for i, block in enumerate(self.blocks):
            if block.material is not None and not isinstance(block.shape, Surface):
                rho = block.material.density
                result[i] = self.properties(i).mass / self.volume[i] if callable(rho) else float(rho)
        return result

    def balls(self) -> tuple[np.ndarray, np.ndarray]:
        """Gridpoints (n,) of all spheres, those of clumps too, in the order of blocks, and their radii (n,) [m]."""
        rows = [i for i, block in enumerate(self.blocks) if isinstance(block.shape, Balls)]
        counts = np.array([len(self.blocks[i].shape.points) for i in rows], dtype=np.int64)
        first = np.repeat(self.gp_range[rows, 0] - np.cumsum(counts) + counts, counts)
        radii = np.array([r for i in rows for r in self.blocks[i].shape.radii], dtype=np.float64)
        return (first + np.arange(len(first))).astype(np.int32), radii

    def zones(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gridpoints (m, 4) and block (m,) of every zone, first zone of every block (n_blocks + 1,)."""
        zoned = self.of_kind("zoned")
        counts = np.zeros(len(self.blocks), dtype=np.int64)
        counts[zoned] = [len(self.meshes[i].tets) for i in zoned]
        parts = [self.meshes[i].tets + self.gp_range[i, 0] for i in zoned]
        zones = np.vstack(parts).astype(np.int32) if parts else np.zeros((0, 4), dtype=np.int32)
        block = np.repeat(np.arange(len(counts)), counts).astype(np.int32)
        return zones, block, np.concatenate([[0], np.cumsum(counts)])


def _extent(block: Block) -> float:
    return float(np.ptp(np.asarray(block.shape.bounds), axis=0).max())


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
    surfaces = _facets(scene, blocks, kind)
    meshes = [kept.get(block.name, zoned.get(block, surfaces.get(block))) for block in blocks]
    points: list[Any] = []
    loops: list[Any] = []
    loop_tags: list[Any] = []
    triangles: list[Any] = []
    triangle_tags: list[Any] = []
    none: list[Any] = []
    for block, mesh, moves in zip(blocks, meshes, kind, strict=True):
        if isinstance(block.shape, Balls):
            points.append(_ball_points(block.shape, moves) - origin)
            for empty in (loops, loop_tags, triangle_tags):
                empty.append(none)  # one list for all: there may be many spheres
            triangles.append(block.shape.triangles)
            continue
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
    order = [i for k in NUMBERED for i, have in enumerate(kind) if have == k]
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


def _ball_points(shape: Balls, kind: str) -> np.ndarray:
    """Gridpoints of spheres and clumps: centres; where they turn as a block also four points not in a plane."""
    if kind != "rigid":
        return shape.points
    frame = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    return np.concatenate([shape.points, shape.centroid + 0.25 * shape.size * frame])


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
            kinds.append(_moving_kind(block) if moves else "static")
        else:
            kinds.append(_moving_kind(block))
    return kinds


def _moving_kind(block: Block) -> str:
    """Formulation of a block that moves."""
    if isinstance(block.shape, Sphere) and not block.body.orientation:
        return "sphere"
    return "rigid" if block.fixed else str(block.body.kind)


def _facets(scene: Scene, blocks: list[Block], kind: list[str]) -> dict[Block, Any]:
    """Facets of the blocks of linear strain; they belong to the scene, so that an excavation divides nothing again."""
    cache: dict[Any, Any] = scene.__dict__.setdefault("facet_cache", {})
    result = {}
    for block in (b for b, what in zip(blocks, kind, strict=True) if what == "linear"):
        key = block, block.shape, block.body
        if key not in cache:
            cache[key] = facets(block.shape, block.body.size)
        result[block] = cache[key]
    return result


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
