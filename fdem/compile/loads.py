"""From the loads of a scene to forces on gridpoints."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem import loads as numeric
from fdem.blocks.conditions import shared_forces
from fdem.compile.select import Selector
from fdem.errors import SceneError
from fdem.model import Model
from fdem.scene import boundary
from fdem.scene.scene import Applied, Gridpoint

__all__ = ["compile_loads"]


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
        made: Any = makers.get(type(load), _user)(select, applied)
        result.extend(made if isinstance(made, list) else [made])
    return result, alpha, drags


def _block_dofs(model: Model, block: int) -> np.ndarray:
    batch = model.batch_of(block)
    if batch is None:
        return np.zeros(0, dtype=np.int64)
    own = batch.dofs_of(model.batch_row[block])
    return np.arange(own.start, own.stop)


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
            corner, share = select.evenly(block)
            gps.append(corner)
            weights.append(share * max(model.mass[block], np.finfo(float).tiny))
        else:
            gps.append(gp)
            weights.append(np.full(len(gp), max(model.mass[block], np.finfo(float).tiny) / (stop - start)))
    total = np.concatenate(weights)
    return np.concatenate(gps), total / total.sum()


def _moment(select: Selector, applied: Applied) -> list[numeric.Load]:
    """Every block takes a share of the moment by its mass."""
    model, blocks = select.model, select.blocks(applied.target, "Moment")
    value = np.asarray(applied.load.value, dtype=float)
    mass = np.array([max(model.mass[b], np.finfo(float).tiny) for b in blocks])
    parts, dofs, turning = [], [], []
    for block, share in zip(blocks, mass / mass.sum(), strict=True):
        batch = model.batch_of(block)
        if model.gp_range[block, 1] - model.gp_range[block, 0] == 1:
            if batch is not None:
                dofs.append(batch.dofs_of(model.batch_row[block]).start + 3)
                turning.append(share * value)
            continue
        gp = np.arange(*model.gp_range[block])
        weights = model.gp_mass[gp] if model.zoned[block] else select.dual(block)
        parts.append((gp, weights, share * value))
    result: list[numeric.Load] = [numeric.Couple(applied, parts)] if parts else []
    return [*result, numeric.Torque(applied, np.array(dofs), np.array(turning))] if dofs else result


def _traction(select: Selector, applied: Applied) -> numeric.Load:
    """Consistent gridpoint forces."""
    model, value = select.model, applied.load.value
    rows = select.faces(applied.target, applied.where, "Traction")
    curved = np.array([getattr(model.batch_of(b), "by_points", False) for b in model.triangle_block[rows]])
    gps, forces = [], []
    for block in np.unique(model.triangle_block[rows[curved]]):
        mine = rows[curved & (model.triangle_block[rows] == block)]
        gp, force = shared_forces(
            model.batch_of(block), int(model.batch_row[block]), *_on_triangles(select, value, mine, *_FINE)
        )
        gps.append(gp)
        forces.append(force)
    if not curved.all():
        flat = rows[~curved]
        # exact for tractions linear on a triangle
        force = _on_triangles(select, value, flat, *_MIDDLES)[1].reshape(len(flat), len(_MIDDLES[0]), 3)
        gps.append(model.triangles[flat].ravel())
        forces.append(np.einsum("pk,tpi->tki", _MIDDLES[0], force).reshape(-1, 3))
    return numeric.DeadLoad(applied, np.concatenate(gps), np.vstack(forces))


# points of a triangle (barycentric) and weights: exact for degree 2, and for degree 5 (Radon 1948)
_MIDDLES = (0.5 * (1.0 - np.eye(3)), np.full(3, 1.0 / 3.0))
_NEAR, _FAR = (6.0 - np.sqrt(15.0)) / 21.0, (6.0 + np.sqrt(15.0)) / 21.0
_FINE = (
    np.vstack([np.full((1, 3), 1 / 3), *((1 - 3 * a) * np.eye(3) + a for a in (_NEAR, _FAR))]),
    np.array([0.225, *[(155.0 - np.sqrt(15.0)) / 1200.0] * 3, *[(155.0 + np.sqrt(15.0)) / 1200.0] * 3]),
)


def _on_triangles(
    select: Selector, value: Any, rows: np.ndarray, points: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 3), relative to the model's origin, and forces (n, 3) of a traction on surface triangles."""
    model, area = select.model, np.repeat(select.area_vectors(rows), len(weights), axis=0)
    places = np.einsum("pk,tki->tpi", points, model.X[model.triangles[rows]]).reshape(-1, 3)
    given = _traction_at(value, places + model.origin)
    size = np.linalg.norm(area, axis=1, keepdims=True)
    force = given * size if given.shape[1] == 3 else _voigt_times(given, area)
    return places, force * np.tile(weights, len(rows))[:, None]


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


def _face_matrices(
    select: Selector, rows: np.ndarray, normal: np.ndarray, shear: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
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
