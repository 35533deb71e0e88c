"""Conditions on polynomial blocks (`fields`): rows whose product with the unknowns is a velocity."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from fdem.blocks.fields import FieldBlocks

__all__ = ["driven_rows", "dual", "fixed_rows", "shared_forces", "weights_of"]

Array = np.ndarray

# rows that follow from others to this part are left out
DEPENDENT = 1e-9


def _translation(blocks: FieldBlocks, direction: Array) -> Array:
    """Row (1, width): the velocity of the centre along `direction` (3,)."""
    rows = np.zeros((1, blocks.width))
    rows[0, :3] = direction
    return rows


def _whole(blocks: FieldBlocks, row: int, direction: Array) -> Array:
    """Rows (1 + k, width): the velocity along `direction` (3,) of every point of a block."""
    degree = np.repeat([1, 2], [3, blocks.k - 3])
    inner = np.zeros((blocks.k, blocks.width))
    for d in range(3):
        part = slice(3 + d * blocks.k, 3 + (d + 1) * blocks.k)
        inner[:, part] = direction[d] * np.diag(float(blocks.size[row]) ** degree)
    return np.vstack([_translation(blocks, direction), inner])


def _everything(blocks: FieldBlocks, row: int) -> Array:
    """Rows (width, width): all unknowns of a block."""
    return np.vstack([_whole(blocks, row, axis) for axis in np.eye(3)])


def _turning(blocks: FieldBlocks, row: int) -> Array:
    """Rows (3, width): the rotation of the deformation gradient, from a start that is not turned."""
    rows = np.zeros((3, blocks.width))
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        rows[i, 3 + k * blocks.k + j], rows[i, 3 + j * blocks.k + k] = 1.0, -1.0
    return blocks.size[row] * rows


def _at_points(blocks: FieldBlocks, gridpoints: Any, direction: Array) -> Array:
    """Rows (n, width): the velocity along `direction` (3,) of gridpoints (n,) of one block."""
    phi = blocks.material[np.asarray(gridpoints) - blocks.gridpoints.start]
    parts = [np.asarray(direction)[d] * phi for d in range(3)]
    return np.hstack([np.tile(direction, (len(phi), 1)), *parts])


def _least(blocks: FieldBlocks, row: int, wanted: Array) -> Array:
    """Least values (n, m) at the gridpoints of a block whose sums with 1 and its functions are `wanted` (1 + k, m)."""
    start, stop = blocks._start[row : row + 2]
    phi = blocks.phi[start:stop]
    scale = np.concatenate([[1.0], np.abs(phi).max(axis=0)])
    basis = np.hstack([np.ones((len(phi), 1)), phi]) / scale
    return np.linalg.lstsq(basis.T, wanted / scale[:, None], rcond=None)[0]


def weights_of(blocks: FieldBlocks, row: int, value: Array) -> tuple[Array, Array]:
    """Gridpoints (n,) and least weights (n,) that sum to 1 and give the functions of a block a `value` (k,)."""
    own = np.arange(*blocks._start[row : row + 2]) + blocks.gridpoints.start
    return own, _least(blocks, row, np.concatenate([[1.0], value])[:, None])[:, 0]


def shared_forces(blocks: FieldBlocks, row: int, places: Array, forces: Array) -> tuple[Array, Array]:
    """Gridpoints (n,) and forces (n, 3) on them that do what `forces` (m, 3) at `places` (m, 3) of one block do."""
    phi = blocks.functions(places - blocks.centre0[row], np.full(len(places), row))
    wanted = np.vstack([forces.sum(axis=0), phi.T @ forces])
    return np.arange(*blocks._start[row : row + 2]) + blocks.gridpoints.start, _least(blocks, row, wanted)


def dual(blocks: FieldBlocks, row: int) -> Array:
    """Weights (n, 3) of gridpoints of one block whose sums give F: 1 on one linear function, 0 on all others."""
    wanted = np.zeros((1 + blocks.k, 3))
    wanted[[1, 2, 3], [0, 1, 2]] = 1.0
    return _least(blocks, row, wanted)


def _compressed(rows: Array) -> Array:
    """As few rows as say the same, each still a velocity."""
    _, size, right = np.linalg.svd(rows, full_matrices=False)
    kept = size > DEPENDENT * size[0]
    return size[kept, None] * right[kept] / np.sqrt(len(rows))


def fixed_rows(
    blocks: FieldBlocks, row: int, gridpoints: Any, components: Any, axes: list[Array], facing: dict[int, list[Array]]
) -> Array:
    """Rows that fixing components of one block asks for.

    Parameters
    ----------
    blocks, row : FieldBlocks, int
        The batch and the block's row in it.
    gridpoints : (n,) int array
        Gridpoints of the block that were selected.
    components : tuple of str or None
        What was asked for; None: everything.
    axes : list of (3,) array
        Those of x, y, z among them.
    facing : dict
        Normals by gridpoint, and by ``-1 - block``, if "normal" is among them.

    Notes
    -----
    For the whole block, a direction holds the displacement of every point, strain included; together with
    "rotation" it holds the translation of the centre, and the strain stays free. Blocks that mind points
    (`by_points`) hold the gridpoints selected where these are not all.
    """
    whole_block = not blocks.by_points or len(gridpoints) == blocks._start[row + 1] - blocks._start[row]
    if components is None:
        if whole_block:
            return _everything(blocks, row)
        return _compressed(np.vstack([_at_points(blocks, gridpoints, axis) for axis in np.eye(3)]))
    turns = [_turning(blocks, row)] if "rotation" in components else []
    if whole_block:
        directions = [*axes, *facing.get(-1 - int(blocks.rows[row]), [])]
        moves = [_translation(blocks, d) if turns else _whole(blocks, row, d) for d in directions]
        return np.vstack([*moves, *turns])
    rows = [_at_points(blocks, gridpoints, axis) for axis in axes]
    rows += [_at_points(blocks, [gp], n) for gp in gridpoints for n in facing.get(int(gp), [])]
    return np.vstack([*([_compressed(np.vstack(rows))] if rows else []), *turns])


def driven_rows(
    blocks: FieldBlocks, row: int, gridpoints: Any, values: list[tuple[int, Array]], whole_block: bool
) -> tuple[Array, Array]:
    """Rows and unknowns of a motion that is prescribed along some axes.

    Parameters
    ----------
    blocks, row : FieldBlocks, int
        The batch and the block's row in it.
    gridpoints : (n,) int array
        Where the motion is given.
    values : list of (int, (n,) array)
        Axes and values there. The block takes what its functions can of it.
    whole_block : bool
        The rest of the block moves by the same rule.

    Returns
    -------
    rows : (m, width) array
        What is prescribed.
    target : (width,) array
        Unknowns that move like that.
    """
    rows, target = [], np.zeros(blocks.width)
    for axis, amount in values:
        target += _fitted(blocks, gridpoints, axis, amount)
        direction = np.eye(3)[axis]
        rows.append(_whole(blocks, row, direction) if whole_block else _at_points(blocks, gridpoints, direction))
    return np.vstack(rows) if whole_block else _compressed(np.vstack(rows)), target


def _fitted(blocks: FieldBlocks, gridpoints: Any, axis: int, values: Array) -> Array:
    """Unknowns (width,) of one block whose motion along `axis` is nearest to `values` (n,) at its gridpoints (n,)."""
    phi = blocks.material[np.asarray(gridpoints) - blocks.gridpoints.start]
    scale = np.maximum(np.abs(phi).max(axis=0), np.finfo(float).tiny)
    basis = np.hstack([np.ones((len(phi), 1)), phi / scale])
    coefficients = np.linalg.lstsq(basis, values, rcond=None)[0]
    target = np.zeros(blocks.width)
    target[axis] = coefficients[0]
    target[3 + axis * blocks.k : 3 + (axis + 1) * blocks.k] = coefficients[1:] / scale
    return target
