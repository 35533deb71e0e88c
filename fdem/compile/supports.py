"""From fixed and prescribed components of a scene to constraints on velocities."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from fdem.blocks.conditions import driven_rows, fixed_rows
from fdem.compile.select import Selector
from fdem.constraints import APPROACH, Approach, Condition, Constraints, Coupled, Directions, Motion
from fdem.errors import SceneError
from fdem.model import Model
from fdem.scene import boundary
from fdem.scene.scene import Applied, Fix, Gridpoint

__all__ = ["compile_constraints"]

# normals closer than this belong to one face of the body: the facets of a curved boundary
SAME_FACE = np.cos(np.radians(30.0))


def compile_constraints(select: Selector) -> Constraints:
    """Fixed and prescribed components of every block."""
    model = select.model
    n_dofs = sum(b.dofs.stop - b.dofs.start for b in model.batches)
    fixed = np.zeros(n_dofs, dtype=bool)
    normals: dict[int, list[np.ndarray]] = {}
    coupled: dict[int, list[Condition]] = {}
    constraints = Constraints(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3)))
    for fix in select.scene.fixes:
        if isinstance(fix.target, Gridpoint) or select.pairs(fix.target):
            _fix(select, fix, fixed, normals, coupled, constraints)
    for applied in select.layout.loads:
        if isinstance(applied.target, Gridpoint) or select.pairs(applied.target):
            if isinstance(applied.load, boundary.Velocity):
                _motion(select, applied, coupled, constraints)
            elif isinstance(applied.load, boundary.Displacement):
                _approach(select, applied, coupled, constraints)
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
    for number, conditions in sorted(coupled.items()):
        batch, row = model.batch_of(number), int(model.batch_row[number])
        constraints.coupled.append(Coupled(number, batch.dofs_of(row), batch.coords_of(row), conditions))
    if rows:
        constraints.oblique_rows, constraints.oblique = np.array(rows), np.array(projectors)
    return constraints


def _basis(vectors: np.ndarray) -> np.ndarray:
    """Orthonormal basis (k, 3) of the span of `vectors`."""
    _, singular, right = np.linalg.svd(vectors)
    return right[: int((singular > 1e-6 * singular[0]).sum())]


def _fix(
    select: Selector,
    fix: Fix,
    fixed: np.ndarray,
    normals: dict[int, list[np.ndarray]],
    coupled: dict[int, list[Condition]],
    constraints: Constraints,
) -> None:
    model = select.model
    gp = select.gridpoints(fix.target, fix.where, "fix")
    components = fix.components or ("x", "y", "z", "rotation")
    axes = [k for k, name in enumerate("xyz") if name in components]
    rows, projectors = [], []
    static = []
    facing = _facing(select, fix, gp) if "normal" in components else {}
    for block in np.unique(select.owner[gp]):
        batch = model.batch_of(block)
        mine = gp[select.owner[gp] == block]
        if batch is None:
            static.append(mine)
            continue
        if batch.coupled:
            row = int(model.batch_row[block])
            held = fixed_rows(batch, row, mine, fix.components, [np.eye(3)[k] for k in axes], facing)
            coupled.setdefault(int(block), []).append(Condition(fix, held))
            continue
        if batch.in_place:
            bases, keys = batch.dofs.start + 3 * (mine - batch.gridpoints.start), mine
        else:
            first = batch.dofs_of(model.batch_row[block]).start
            bases, keys = np.array([first]), np.array([-1 - block])
            if "rotation" in components:
                fixed[first + 3 : first + 6] = True
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
    """Outward face normals at each gridpoint, and of each block (key -1 - block), facets of one face averaged."""
    model = select.model
    rows = select.faces(fix.target, None, "fix")
    if fix.where is not None:
        rows = rows[np.isin(model.triangles[rows], gp).all(axis=1)]
    sums: dict[int, list[np.ndarray]] = {}
    for triangle, area in zip(model.triangles[rows], select.area_vectors(rows), strict=True):
        for key in (*triangle.tolist(), -1 - int(select.owner[triangle[0]])):
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


def _driven(select: Selector, applied: Applied, what: str) -> Iterator[tuple[int, Any, np.ndarray]]:
    """Blocks that a prescribed motion moves, with their formulation and the gridpoints selected."""
    gp = select.gridpoints(applied.target, applied.where, what)
    for block in np.unique(select.owner[gp]):
        batch = select.model.batch_of(block)
        if batch is None:
            name = select.model.names[block]
            raise SceneError(f"{what}: block {name!r} is fixed by fix(); give it fixed=True instead")
        yield int(block), batch, gp[select.owner[gp] == block]


def _bases(select: Selector, block: int, batch: Any, gp: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First unknowns and coordinates of what a prescribed motion moves, and its places."""
    if batch.in_place:
        local = 3 * (gp - batch.gridpoints.start)
        return batch.dofs.start + local, batch.coords.start + local, select.model.X[gp]
    row = select.model.batch_row[block]
    first = np.array([batch.dofs_of(row).start]), np.array([batch.coords_of(row).start])
    return *first, select.model.centroid[block][None]


def _prescribed(
    select: Selector, block: int, batch: Any, gp: np.ndarray, applied: Applied, displacement: bool = False
) -> Condition:
    """Condition of a prescribed motion on a block whose mass couples its unknowns."""
    what, model = type(applied.load).__name__, select.model
    places = np.arange(*model.gp_range[block])
    whole = not batch.by_points or len(gp) == len(places)
    places = places if whole else gp
    values = _components(what, applied.load.value, model.X[places] + model.origin)
    return Condition(applied, *driven_rows(batch, int(model.batch_row[block]), places, values, whole), displacement)


def _motion(select: Selector, applied: Applied, coupled: dict[int, list[Condition]], constraints: Constraints) -> None:
    model, load = select.model, applied.load
    dofs, values, straight = [], [], []
    for block, batch, gp in _driven(select, applied, "Velocity"):
        if load.angular is not None and (batch.coupled or batch.in_place):
            name = model.names[block]
            raise SceneError(f"Velocity: angular is for rigid blocks, block {name!r} is {batch.label}")
        if batch.coupled:
            coupled.setdefault(block, []).append(_prescribed(select, block, batch, gp, applied))
            continue
        bases, _, places = _bases(select, block, batch, gp)
        for axis, amount in _components("Velocity", load.value, places + model.origin):
            dofs.append(bases + axis)
            values.append(amount)
            straight.append(bases + axis)
        if load.angular is not None:
            dofs.append(bases[0] + 3 + np.arange(3))
            values.append(np.asarray(load.angular, dtype=float))
    if dofs:
        constraints.motions.append(Motion(applied, np.concatenate(dofs), np.concatenate(values)))
        constraints.reactions.append(_held(applied, straight))


def _held(handle: Any, dofs: list[np.ndarray]) -> Directions:
    """Reaction rows of single translational dofs (the base of a triple is 3 k from the start)."""
    rows, projectors = [], []
    for dof in (int(one) for part in dofs for one in part):
        for axis in range(3):
            if (dof - axis) % 3 == 0:
                rows.append(dof - axis)
                projectors.append(np.diag(np.eye(3)[axis]))
    return Directions(
        handle, np.array(rows, dtype=np.int64), np.array(projectors).reshape(-1, 3, 3), np.zeros(0, dtype=np.int64)
    )


def _approach(
    select: Selector, applied: Applied, coupled: dict[int, list[Condition]], constraints: Constraints
) -> None:
    model, value = select.model, applied.load.value
    dofs, coords, target = [], [], []
    for block, batch, gp in _driven(select, applied, "Displacement"):
        if batch.coupled:
            coupled.setdefault(block, []).append(_prescribed(select, block, batch, gp, applied, True))
            continue
        bases, first, places = _bases(select, block, batch, gp)
        for axis, amount in _components("Displacement", value, places + model.origin):
            dofs.append(bases + axis)
            coords.append(first + axis)
            target.append(amount)
    if dofs:
        constraints.approaches.append(
            Approach(applied, np.concatenate(dofs), np.concatenate(coords), np.concatenate(target), APPROACH)
        )
        constraints.reactions.append(_held(applied, dofs))


def _platen(model: Model, i: int, block: Any, constraints: Constraints) -> None:
    """A fixed block with a velocity: every component that no load drives keeps what it was given."""
    own = model.batch_of(i).dofs_of(model.batch_row[i])
    dofs = np.arange(own.start, own.stop)
    driven = np.concatenate([m.dofs for m in constraints.motions] or [np.zeros(0, dtype=np.int64)])
    free = ~np.isin(dofs, driven)
    values = np.concatenate([block.velocity, block.angular_velocity])
    handle = Applied(None, block)
    constraints.motions.append(Motion(handle, dofs[free], values[free]))
