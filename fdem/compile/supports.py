"""From fixed and prescribed components of a scene to constraints on velocities."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.compile.select import Selector
from fdem.constraints import Approach, Constraints, Directions, Motion
from fdem.errors import SceneError
from fdem.model import Model
from fdem.scene import boundary
from fdem.scene.scene import Applied, Fix, Gridpoint

__all__ = ["compile_constraints"]

# share of the remaining prescribed displacement travelled in one step: slow against the stable step
APPROACH = 0.02
# normals closer than this belong to one face of the body: the facets of a curved boundary
SAME_FACE = np.cos(np.radians(30.0))


def compile_constraints(select: Selector) -> Constraints:
    """Fixed and prescribed components of every block."""
    model = select.model
    n_dofs = sum(b.dofs.stop - b.dofs.start for b in model.batches)
    fixed = np.zeros(n_dofs, dtype=bool)
    normals: dict[int, list[np.ndarray]] = {}
    constraints = Constraints(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3)))
    for fix in select.scene.fixes:
        if isinstance(fix.target, Gridpoint) or select.pairs(fix.target):
            _fix(select, fix, fixed, normals, constraints)
    for applied in select.layout.loads:
        if isinstance(applied.target, Gridpoint) or select.pairs(applied.target):
            if isinstance(applied.load, boundary.Velocity):
                constraints.motions.append(_motion(select, applied, constraints))
            elif isinstance(applied.load, boundary.Displacement):
                constraints.approaches.append(_approach(select, applied, constraints))
    for i, block in enumerate(select.layout.blocks):
        if block.fixed and model.batch_row[i] >= 0:
            _platen(model, i, block, constraints)
    rows, projectors = [], []
    for row, directions in normals.items():
        held = [*directions, *(np.eye(3)[k] for k in range(3) if fixed[row + k])]
        basis = _basis(np.array(held))
        axes = np.abs(basis).max(axis=1) > 1 - 1e-12
        if axes.all():
            fixed[row + np.abs(basis).argmax(axis=1)] = True
        else:
            rows.append(row)
            projectors.append(np.eye(3) - basis.T @ basis)
    constraints.fixed = np.flatnonzero(fixed)
    if rows:
        constraints.oblique_rows, constraints.oblique = np.array(rows), np.array(projectors)
    return constraints


def _basis(vectors: np.ndarray) -> np.ndarray:
    """Orthonormal basis (k, 3) of the span of `vectors`."""
    _, singular, right = np.linalg.svd(vectors)
    return right[: int((singular > 1e-6 * singular[0]).sum())]


def _fix(
    select: Selector, fix: Fix, fixed: np.ndarray, normals: dict[int, list[np.ndarray]], constraints: Constraints
) -> None:
    model = select.model
    gp = select.gridpoints(fix.target, fix.where, "fix")
    components = fix.components or ("x", "y", "z", "rotation")
    axes = [k for k, name in enumerate("xyz") if name in components]
    rows, projectors = [], []
    static = []
    facing = _facing(select, fix, gp) if "normal" in components else {}
    for block in np.unique(select.owner[gp]):
        row = model.batch_row[block]
        mine = gp[select.owner[gp] == block]
        if row < 0:
            static.append(mine)
            continue
        if model.zoned[block]:
            bases, keys = select.dof_rows(mine), mine
        else:
            bases, keys = np.array([6 * row]), np.array([-1 - block])
            if "rotation" in components:
                fixed[6 * row + 3 : 6 * row + 6] = True
        for axis in axes:
            fixed[bases + axis] = True
        for base, key in zip(bases, keys, strict=True):
            directions = facing.get(int(key), [])
            if directions:
                normals.setdefault(int(base), []).extend(directions)
            held = np.array([*(np.eye(3)[k] for k in axes), *directions]).reshape(-1, 3)
            basis = _basis(held) if len(held) else held
            rows.append(int(base))
            projectors.append(basis.T @ basis)
    constraints.reactions.append(
        Directions(
            fix,
            np.array(rows, dtype=np.int64),
            np.array(projectors).reshape(-1, 3, 3),
            np.concatenate(static) if static else np.zeros(0, dtype=np.int64),
        )
    )


def _facing(select: Selector, fix: Fix, gp: np.ndarray) -> dict[int, list[np.ndarray]]:
    """Outward face normals at each gridpoint (rigid blocks: key -1 - block), facets of one face averaged."""
    model = select.model
    rows = select.faces(fix.target, None, "fix")
    if fix.where is not None:
        rows = rows[np.isin(model.triangles[rows], gp).all(axis=1)]
    sums: dict[int, list[np.ndarray]] = {}
    for triangle, area in zip(model.triangles[rows], select.area_vectors(rows), strict=True):
        block = int(select.owner[triangle[0]])
        keys = triangle.tolist() if model.zoned[block] else [-1 - block]
        for key in keys:
            clusters = sums.setdefault(int(key), [])
            for cluster in clusters:
                if cluster @ area > SAME_FACE * np.linalg.norm(cluster) * np.linalg.norm(area):
                    cluster += area
                    break
            else:
                clusters.append(area.copy())
    return {key: [c / np.linalg.norm(c) for c in clusters] for key, clusters in sums.items()}


def _components(what: str, value: Any, places: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Axes a value prescribes, with the amount at each of the `places` (n, 3)."""
    if callable(value):
        wanted = boundary.evaluate(what, value, places, (3,))
        return [(k, wanted[:, k]) for k in range(3)]
    return [(k, np.full(len(places), float(v))) for k, v in enumerate(value) if v is not None]


def _motion(select: Selector, applied: Applied, constraints: Constraints) -> Motion:
    model, load = select.model, applied.load
    gp = select.gridpoints(applied.target, applied.where, "Velocity")
    dofs, values = [], []
    for block in np.unique(select.owner[gp]):
        row = model.batch_row[block]
        if row < 0:
            raise SceneError(f"Velocity: block {model.names[block]!r} is fixed by fix(); give it fixed=True instead")
        mine = gp[select.owner[gp] == block]
        bases = select.dof_rows(mine) if model.zoned[block] else np.array([6 * row])
        places = model.X[mine] if model.zoned[block] else model.centroid[block][None]
        for axis, amount in _components("Velocity", load.value, places + model.origin):
            dofs.append(bases + axis)
            values.append(amount)
        if load.angular is not None:
            if model.zoned[block]:
                raise SceneError(f"Velocity: angular is for rigid blocks, block {model.names[block]!r} is zoned")
            dofs.append(6 * row + 3 + np.arange(3))
            values.append(np.asarray(load.angular, dtype=float))
    motion = Motion(applied, np.concatenate(dofs), np.concatenate(values))
    constraints.reactions.append(_held(applied, motion.dofs))
    return motion


def _held(handle: Any, dofs: np.ndarray) -> Directions:
    """Reaction rows of single translational dofs (the base of a triple is 3 k from its batch's start)."""
    rows, projectors = [], []
    for dof in dofs:
        for axis in range(3):
            if (dof - axis) % 3 == 0:
                rows.append(dof - axis)
                projectors.append(np.diag(np.eye(3)[axis]))
    return Directions(
        handle, np.array(rows, dtype=np.int64), np.array(projectors).reshape(-1, 3, 3), np.zeros(0, dtype=np.int64)
    )


def _approach(select: Selector, applied: Applied, constraints: Constraints) -> Approach:
    model, value = select.model, applied.load.value
    gp = select.gridpoints(applied.target, applied.where, "Displacement")
    dofs, coords, target = [], [], []
    for block in np.unique(select.owner[gp]):
        row, mine = model.batch_row[block], gp[select.owner[gp] == block]
        if row < 0:
            raise SceneError(f"Displacement: block {model.names[block]!r} is fixed")
        if model.zoned[block]:
            bases, first = select.dof_rows(mine), model.deformable.coords.start + 3 * mine
            places = model.X[mine]
        else:
            bases, first, places = np.array([6 * row]), np.array([7 * row]), model.centroid[block][None]
        for axis, amount in _components("Displacement", value, places + model.origin):
            dofs.append(bases + axis)
            coords.append(first + axis)
            target.append(amount)
    approach = Approach(applied, np.concatenate(dofs), np.concatenate(coords), np.concatenate(target), APPROACH)
    constraints.reactions.append(_held(applied, approach.dofs))
    return approach


def _platen(model: Model, i: int, block: Any, constraints: Constraints) -> None:
    """A fixed block with a velocity: every component that no load drives keeps what it was given."""
    dofs = 6 * model.batch_row[i] + np.arange(6)
    driven = np.concatenate([m.dofs for m in constraints.motions] or [np.zeros(0, dtype=np.int64)])
    free = ~np.isin(dofs, driven)
    values = np.concatenate([block.velocity, block.angular_velocity])
    handle = Applied(None, block)
    constraints.motions.append(Motion(handle, dofs[free], values[free]))
