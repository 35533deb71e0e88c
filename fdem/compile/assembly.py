"""From blocks of a scene to flat arrays: formulations, masses, surfaces, the state at the start."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from fdem.compile.formulations import FORMULATIONS, Share
from fdem.compile.layout import Layout
from fdem.errors import FdemWarning
from fdem.model import Model
from fdem.scene.checks import vector
from fdem.scene.scene import Block
from fdem.state import State

__all__ = ["assemble"]


def assemble(layout: Layout, threads: int) -> tuple[Model, State]:
    """Flat arrays, formulations and the state at the start."""
    X, n_blocks = np.zeros((int(layout.gp_range.max()), 3)), len(layout.blocks)
    for (start, stop), points in zip(layout.gp_range, layout.points, strict=True):
        X[start:stop] = points
    notes = list(layout.zone_notes)
    shares = _shares(layout, X, notes, threads)
    batches = {kind: row.make(share) for row, (kind, share) in zip(_present(layout), shares.items(), strict=True)}
    moving = [share for kind, share in shares.items() if not batches[kind].in_place]
    state = State.make(
        X,
        n_q=max((share.coords.stop for share in moving), default=0),
        n_dofs=max((share.dofs.stop for share in moving), default=0),
        n_in_place=max((batch.gridpoints.stop for batch in batches.values() if batch.in_place), default=0),
    )
    zones, zone_block, zone_start = layout.zones()
    balls, ball_radius = layout.balls()
    mass = layout.density * layout.volume
    gp_mass = np.zeros(len(X))
    batch_row, batch_index = np.full(n_blocks, -1), np.full(n_blocks, -1)
    centroid = np.array([b.shape.centroid for b in layout.blocks]) - layout.origin
    for number, (kind, batch) in enumerate(batches.items()):
        rows = shares[kind].rows
        batch_row[rows], batch_index[rows] = np.arange(len(rows)), number
        if batch.in_place:
            gp_mass[batch.gridpoints] = batch.gp_mass
            _warn_inertia(layout, rows, batch, notes)
        else:
            # all gridpoints of a block that moves as a whole carry its whole mass
            gp_mass[batch.gridpoints] = np.repeat(batch.mass, np.diff(shares[kind].gp_start))
            centroid[rows] = batch.centre0
    model = Model(
        names=[b.name for b in layout.blocks],
        groups=[b.group for b in layout.blocks],
        gp_range=layout.gp_range,
        zoned=np.array([k == "zoned" for k in layout.kind]),
        fixed=np.array([b.fixed or k == "static" for b, k in zip(layout.blocks, layout.kind, strict=True)]),
        batch_row=batch_row,
        batch_index=batch_index,
        volume=layout.volume,
        mass=mass,
        size=np.cbrt(layout.volume),
        centroid=centroid,
        gp_mass=gp_mass,
        origin=layout.origin,
        X=X,
        zones=zones,
        zone_block=zone_block,
        zone_start=zone_start,
        **_triangles(layout),
        batches=tuple(batches.values()),
        deformable=batches.get("zoned"),
        gravity=vector("Scene", "gravity", layout.scene.gravity),
        # dashpots of spheres act in the middle of the step and do not shorten it
        damping_ratio=max(
            [getattr(rule.law, "damping_ratio", 0.0) for rule in layout.scene.joints if rule.law.for_faces], default=0.0
        ),
        joint_names=[_joint_name(rule) for rule in layout.scene.joints],
        wave_speed=np.array([_wave_speeds(b, rho) for b, rho in zip(layout.blocks, layout.density, strict=True)]),
        balls=balls,
        ball_radius=ball_radius,
        notes=notes,
    )
    _start(layout, model, state, shares, batches)
    return model, state


def _triangles(layout: Layout) -> dict[str, Any]:
    """Surface triangles of all blocks, their blocks and tags."""
    tags = sorted({tag for per_block in layout.loop_tags for tag in per_block if tag is not None})
    number_of: dict[str | None, int] = {tag: i for i, tag in enumerate(tags)} | {None: -1}
    triangles = [t + s for t, (s, _) in zip(layout.triangles, layout.gp_range, strict=True)]
    counts = [len(t) for t in triangles]
    return {
        "triangles": np.vstack(triangles).astype(np.int32),
        "triangle_block": np.repeat(np.arange(len(counts)), counts).astype(np.int32),
        "triangle_tag": np.array([number_of[t] for per_block in layout.triangle_tags for t in per_block], np.int32),
        "tags": tags,
    }


def _present(layout: Layout) -> list[Any]:
    """Rows of the table of formulations that the scene uses."""
    return [row for row in FORMULATIONS if row.kind in layout.kind]


def _shares(layout: Layout, X: np.ndarray, notes: list[str], threads: int) -> dict[str, Share]:
    """Every formulation's blocks, and its part of velocities, configuration and positions."""
    shares, n_q, n_dofs = {}, 0, 0
    for row in _present(layout):
        rows = layout.of_kind(row.kind)
        ranges = layout.gp_range[rows]
        gridpoints = slice(int(ranges[0, 0]), int(ranges[-1, 1]))
        unknowns = 3 * (gridpoints.stop - gridpoints.start)
        coords, dofs = (len(rows) * given if given else unknowns for given in (row.coords, row.dofs))
        shares[row.kind] = Share(
            layout, rows, X, slice(n_dofs, n_dofs + dofs), slice(n_q, n_q + coords), gridpoints, notes, threads
        )
        n_q, n_dofs = n_q + coords, n_dofs + dofs
    return shares


def _start(layout: Layout, model: Model, state: State, shares: dict[str, Share], batches: dict[str, Any]) -> None:
    """Initial configuration, positions and velocities; what every batch must know of its blocks."""
    for kind, batch in batches.items():
        rows = shares[kind].rows
        batch.rows, batch.size, batch.free = np.array(rows), model.size[rows], ~model.fixed[rows]
        batch.start(state.q)
        batch.place(state.q, state.x)
        velocity, spin = (
            np.array([getattr(layout.blocks[i], name) for i in rows]) for name in ("velocity", "angular_velocity")
        )
        batch.launch(state.q, state.x, state.v, velocity, spin)
    state.x_old[:] = state.x


def _joint_name(rule: Any) -> str:
    what = rule.between or rule.target
    return type(rule.law).__name__ + (f" {what}" if what is not None else "")


def _wave_speeds(block: Block, density: float) -> tuple[float, float]:
    material = block.material
    if material is None or material.young is None:
        return np.nan, np.nan
    lam, mu = material.lame
    return float(np.sqrt((lam + 2 * mu) / density)), float(np.sqrt(mu / density))


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
