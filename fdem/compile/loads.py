"""From the loads and supports of a scene to forces and constraints on gridpoints."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem import loads as numeric
from fdem.compile.assembly import Layout
from fdem.constraints import Approach, Constraints, Directions, Motion
from fdem.errors import SceneError
from fdem.model import Model
from fdem.scene import boundary
from fdem.scene.scene import Applied, Fix, Gridpoint, choose

__all__ = ["Selector", "compile_constraints", "compile_loads"]

# share of the remaining prescribed displacement travelled in one step: slow against the stable step
APPROACH = 0.02
# normals closer than this belong to one face of the body: the facets of a curved boundary
SAME_FACE = np.cos(np.radians(30.0))


class Selector:
    """Resolves the user's targets to gridpoints, blocks and surface triangles of a model."""

    def __init__(self, layout: Layout, model: Model) -> None:
        self.layout, self.model, self.scene = layout, model, layout.scene
        self.tag_number = {tag: i for i, tag in enumerate(model.tags)}
        self.owner = model.gp_block

    def blocks(self, target: Any, what: str) -> list[int]:
        """Model rows of the blocks selected (removed ones left out)."""
        index = self.layout.index
        return [index[b] for b in self.scene.select_blocks(target) if b in index]

    def pairs(self, target: Any) -> list[tuple[int, int | None]]:
        """Model rows with the face tag that selects within (None: all of the block)."""
        index = self.layout.index
        return [
            (index[b], None if tag is None else self.tag_number.get(tag, -2))
            for b, tag in self.scene.select(target)
            if b in index
        ]

    def nearest(self, handle: Gridpoint) -> int:
        """Gridpoint nearest to the handle's place."""
        blocks = self.blocks(handle.target, "gridpoint")
        gp = np.concatenate([np.arange(*self.model.gp_range[b]) for b in blocks])
        distance = np.linalg.norm(self.model.X[gp] + self.model.origin - handle.near, axis=1)
        return int(gp[np.argmin(distance)])

    def gridpoints(self, target: Any, where: Any, what: str) -> np.ndarray:
        """Gridpoints selected by target and `where`, ascending.

        Raises
        ------
        SceneError
            If none is selected.
        """
        if isinstance(target, Gridpoint):
            return np.array([self.nearest(target)])
        parts = []
        for block, tag in self.pairs(target):
            if tag is None:
                parts.append(np.arange(*self.model.gp_range[block]))
            else:
                faces = (self.model.triangle_block == block) & (self.model.triangle_tag == tag)
                parts.append(np.unique(self.model.triangles[faces]))
        gp = np.unique(np.concatenate(parts)) if parts else np.zeros(0, dtype=np.int64)
        if where is not None and len(gp):
            gp = gp[choose(what, where, self.model.X[gp] + self.model.origin)]
        if not len(gp):
            raise SceneError(f"{what}: target {target!r} with where = {where!r} selects no gridpoint")
        return gp

    def faces(self, target: Any, where: Any, what: str) -> np.ndarray:
        """Surface triangles selected by target and `where` (rows of model.triangles).

        Raises
        ------
        SceneError
            If none is selected.
        """
        mask = np.zeros(len(self.model.triangles), dtype=bool)
        for block, tag in self.pairs(target):
            of_block = self.model.triangle_block == block
            mask |= of_block if tag is None else of_block & (self.model.triangle_tag == tag)
        rows = np.flatnonzero(mask)
        if where is not None and len(rows):
            centroids = self.model.X[self.model.triangles[rows]].mean(axis=1) + self.model.origin
            rows = rows[choose(what, where, centroids)]
        if not len(rows):
            raise SceneError(f"{what}: target {target!r} with where = {where!r} selects no face")
        return rows

    def area_vectors(self, rows: np.ndarray) -> np.ndarray:
        """Outward area vectors (n, 3) [m^2] of surface triangles."""
        a, b, c = (self.model.X[self.model.triangles[rows, k]] for k in range(3))
        return 0.5 * np.cross(b - a, c - a)

    def dof_rows(self, gp: np.ndarray) -> np.ndarray:
        """First velocity dof of zoned gridpoints."""
        first = self.model.deformable.dofs.start
        return first + 3 * gp

    def affine(self, block: int, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gridpoints and weights of a material point of `block` (exact for affine motion).

        Raises
        ------
        SceneError
            If the point lies outside a zoned block.
        """
        model = self.model
        if model.zoned[block]:
            zones = model.zones[model.zone_start[block] : model.zone_start[block + 1]]
            corners = model.X[zones]
            edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
            inner = np.linalg.solve(edges, (point - corners[:, 0])[:, :, None])[:, :, 0]
            weights = np.column_stack([1 - inner.sum(axis=1), inner])
            best = int(np.argmax(weights.min(axis=1)))
            if weights[best].min() < -1e-6:
                where = point + model.origin
                raise SceneError(f"Force: at = {where} lies outside block {model.names[block]!r}")
            return zones[best], weights[best]
        gp = np.arange(*model.gp_range[block])
        chosen = gp[_spread(model.X[gp])]
        corners = model.X[chosen]
        inner = np.linalg.solve((corners[1:] - corners[0]).T, point - corners[0])
        return chosen, np.concatenate([[1 - inner.sum()], inner])


def _spread(points: np.ndarray) -> list[int]:
    """Four points far from lying in a plane."""
    centre = points.mean(axis=0)
    first = int(np.argmax(np.linalg.norm(points - centre, axis=1)))
    second = int(np.argmax(np.linalg.norm(points - points[first], axis=1)))
    line = points[second] - points[first]
    third = int(np.argmax(np.linalg.norm(np.cross(points - points[first], line), axis=1)))
    normal = np.cross(line, points[third] - points[first])
    fourth = int(np.argmax(np.abs((points - points[first]) @ normal)))
    return [first, second, third, fourth]


def compile_loads(select: Selector) -> tuple[list[numeric.Load], np.ndarray | None, list[tuple[Applied, np.ndarray]]]:
    """Numeric loads, mass-proportional damping per dof [1/s] (None: none), and who asked for it."""
    result: list[numeric.Load] = []
    alpha: np.ndarray | None = None
    drags: list[tuple[Applied, np.ndarray]] = []
    n_dofs = sum(b.dofs.stop - b.dofs.start for b in select.model.batches)
    for applied in select.layout.loads:
        load = applied.load
        if isinstance(load, (boundary.Velocity, boundary.Displacement, boundary.Stress)):
            continue
        if not isinstance(applied.target, Gridpoint) and not select.pairs(applied.target):
            continue  # everything it acted on has been removed
        if isinstance(load, boundary.Drag) and load.mass is not None:
            dofs = np.concatenate([_block_dofs(select.model, b) for b in select.blocks(applied.target, "Drag")])
            alpha = np.zeros(n_dofs) if alpha is None else alpha
            alpha[dofs] += load.mass
            drags.append((applied, dofs))
            continue
        makers = {
            boundary.Force: _force,
            boundary.Moment: _moment,
            boundary.Traction: _traction,
            boundary.Pressure: _pressure,
            boundary.Drag: _drag,
            boundary.Support: _support,
        }
        result.append(makers.get(type(load), _user)(select, applied))
    return result, alpha, drags


def _block_dofs(model: Model, block: int) -> np.ndarray:
    row = model.batch_row[block]
    if row < 0:
        return np.zeros(0, dtype=np.int64)
    if model.zoned[block]:
        start, stop = model.gp_range[block]
        return np.arange(model.deformable.dofs.start + 3 * start, model.deformable.dofs.start + 3 * stop)
    return np.arange(6 * row, 6 * row + 6)


def _force(select: Selector, applied: Applied) -> numeric.Load:
    load, model = applied.load, select.model
    if load.at is not None:
        blocks = select.blocks(applied.target, "Force")
        if len(blocks) != 1:
            raise SceneError(f"Force: at = {load.at!r} needs one block, the target has {len(blocks)}")
        gp, weights = select.affine(blocks[0], np.asarray(load.at, dtype=float) - model.origin)
        value = boundary.evaluate("Force", load.value, np.asarray([load.at], dtype=float), (3,))[0]
        return numeric.DeadLoad(applied, gp, weights[:, None] * value)
    gp, weights = _mass_shares(select, applied)
    value = boundary.evaluate("Force", load.value, model.X[gp] + model.origin, (3,))
    return numeric.DeadLoad(applied, gp, weights[:, None] * value)


def _mass_shares(select: Selector, applied: Applied) -> tuple[np.ndarray, np.ndarray]:
    """Gridpoints and their shares (sum 1) of a force on a selection."""
    model = select.model
    chosen = select.gridpoints(applied.target, applied.where, "Force")
    gps, weights = [], []
    for block in np.unique(select.owner[chosen]):
        gp = chosen[select.owner[chosen] == block]
        start, stop = model.gp_range[block]
        if model.zoned[block]:
            gps.append(gp)
            weights.append(model.gp_mass[gp])
        elif len(gp) == stop - start and not isinstance(applied.target, Gridpoint):
            corner, share = select.affine(block, model.centroid[block])
            gps.append(corner)
            weights.append(share * max(model.mass[block], np.finfo(float).tiny))
        else:
            gps.append(gp)
            weights.append(np.full(len(gp), max(model.mass[block], np.finfo(float).tiny) / (stop - start)))
    total = np.concatenate(weights)
    return np.concatenate(gps), total / total.sum()


def _moment(select: Selector, applied: Applied) -> numeric.Load:
    """Forces m (theta x r) on each block's gridpoints, whose moment about the centroid is the block's share."""
    model, blocks = select.model, select.blocks(applied.target, "Moment")
    value = np.asarray(applied.load.value, dtype=float)
    mass = np.array([max(model.mass[b], np.finfo(float).tiny) for b in blocks])
    gps, forces = [], []
    for block, share in zip(blocks, mass / mass.sum(), strict=True):
        gp = np.arange(*model.gp_range[block])
        weight = model.gp_mass[gp] if model.zoned[block] else np.ones(len(gp))
        arm = model.X[gp] - weight @ model.X[gp] / weight.sum()
        inertia = (weight @ (arm * arm).sum(axis=1)) * np.eye(3) - np.einsum("n,ni,nj->ij", weight, arm, arm)
        spin = np.linalg.solve(inertia, share * value)
        gps.append(gp)
        forces.append(weight[:, None] * np.cross(spin, arm))
    return numeric.DeadLoad(applied, np.concatenate(gps), np.vstack(forces))


def _traction(select: Selector, applied: Applied) -> numeric.Load:
    """Consistent gridpoint forces; the mid-edge rule is exact for tractions linear on a triangle."""
    model, value = select.model, applied.load.value
    rows = select.faces(applied.target, applied.where, "Traction")
    triangles, area = model.triangles[rows], select.area_vectors(rows)
    size = np.linalg.norm(area, axis=1, keepdims=True)
    forces = np.zeros((len(rows), 3, 3))
    for i, j in ((0, 1), (1, 2), (2, 0)):
        middle = 0.5 * (model.X[triangles[:, i]] + model.X[triangles[:, j]]) + model.origin
        given = _traction_at(value, middle)
        traction = given * size if given.shape[1] == 3 else _voigt_times(given, area)
        forces[:, i] += traction / 6.0
        forces[:, j] += traction / 6.0
    return numeric.DeadLoad(applied, triangles.ravel(), forces.reshape(-1, 3))


def _traction_at(value: Any, places: np.ndarray) -> np.ndarray:
    size = np.asarray(value(places[:1])).shape[-1] if callable(value) else len(value)
    if size not in (3, 6):
        raise SceneError(f"Traction: the function returned {size} components, expected 3 or 6")
    return boundary.evaluate("Traction", value, places, (size,))


def _voigt_times(stress: np.ndarray, n: np.ndarray) -> np.ndarray:
    xx, yy, zz, yz, zx, xy = stress.T
    return np.column_stack(
        [
            xx * n[:, 0] + xy * n[:, 1] + zx * n[:, 2],
            xy * n[:, 0] + yy * n[:, 1] + yz * n[:, 2],
            zx * n[:, 0] + yz * n[:, 1] + zz * n[:, 2],
        ]
    )


def _pressure(select: Selector, applied: Applied) -> numeric.Load:
    rows = select.faces(applied.target, applied.where, "Pressure")
    triangles = select.model.triangles[rows]
    places = select.model.X[triangles].reshape(-1, 3) + select.model.origin
    pressure = boundary.evaluate("Pressure", applied.load.value, places, ()).reshape(-1, 3)
    return numeric.Follower(applied, triangles, np.ascontiguousarray(pressure))


def _face_matrices(select: Selector, rows: np.ndarray, normal: np.ndarray, shear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gridpoints and (3, 3) matrices of a face property, a third of each triangle's area to a corner."""
    area = select.area_vectors(rows)
    size = np.linalg.norm(area, axis=1)
    unit = area / size[:, None]
    dyad = unit[:, :, None] * unit[:, None, :]
    matrix = (size / 3.0)[:, None, None] * (normal[:, None, None] * dyad + shear[:, None, None] * (np.eye(3) - dyad))
    gp, inverse = np.unique(select.model.triangles[rows], return_inverse=True)
    result = np.zeros((len(gp), 3, 3))
    inverse = inverse.reshape(-1, 3)
    for k in range(3):
        np.add.at(result, inverse[:, k], matrix)
    return gp, result


def _drag(select: Selector, applied: Applied) -> numeric.Load:
    load, model = applied.load, select.model
    rows = select.faces(applied.target, applied.where, "Drag")
    block = model.triangle_block[rows]
    density = model.mass[block] / model.volume[block]
    values = []
    for field, speed in (("normal", model.wave_speed[block, 0]), ("shear", model.wave_speed[block, 1])):
        given = getattr(load, field)
        value = density * speed if given is None else np.full(len(rows), float(given))
        if not np.isfinite(value).all():
            name = model.names[block[np.argmin(np.isfinite(value))]]
            raise SceneError(f"Drag: {field} = None needs the elastic constants of block {name!r}")
        values.append(value)
    return numeric.Dashpot(applied, *_face_matrices(select, rows, *values))


def _support(select: Selector, applied: Applied) -> numeric.Load:
    rows = select.faces(applied.target, applied.where, "Support")
    values = [np.full(len(rows), float(getattr(applied.load, field))) for field in ("normal", "shear")]
    return numeric.Bedding(applied, *_face_matrices(select, rows, *values), select.model.X)


def _user(select: Selector, applied: Applied) -> numeric.Load:
    return numeric.UserLoad(applied, select.gridpoints(applied.target, applied.where, "load"), select.model.origin)


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


def _fix(select: Selector, fix: Fix, fixed: np.ndarray, normals: dict[int, list[np.ndarray]], constraints: Constraints) -> None:
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


def _components(value: Any) -> list[tuple[int, float]]:
    return [(k, float(v)) for k, v in enumerate(value) if v is not None]


def _motion(select: Selector, applied: Applied, constraints: Constraints) -> Motion:
    model, load = select.model, applied.load
    gp = select.gridpoints(applied.target, applied.where, "Velocity")
    dofs, values = [], []
    for block in np.unique(select.owner[gp]):
        row = model.batch_row[block]
        if row < 0:
            raise SceneError(f"Velocity: block {model.names[block]!r} is fixed by fix(); give it fixed=True instead")
        bases = select.dof_rows(gp[select.owner[gp] == block]) if model.zoned[block] else np.array([6 * row])
        for axis, value in _components(load.value):
            dofs.append(bases + axis)
            values.append(np.full(len(bases), value))
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
    return Directions(handle, np.array(rows, dtype=np.int64), np.array(projectors).reshape(-1, 3, 3), np.zeros(0, dtype=np.int64))


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
        if callable(value):
            wanted = boundary.evaluate("Displacement", value, places + model.origin, (3,))
            axes = [(k, wanted[:, k]) for k in range(3)]
        else:
            axes = [(k, np.full(len(bases), v)) for k, v in _components(value)]
        for axis, amount in axes:
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
