"""Strain and stress of zones, and what the gridpoints of a zoned block do as a whole."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fdem.blocks.zoneforces import SmallStrain, elasticity, tensors, voigt_strain
from fdem.kernels import corotated

if TYPE_CHECKING:
    from fdem.blocks.zoned import ZonedBlocks

__all__ = [
    "angular_momentum",
    "arms",
    "centres",
    "frames",
    "inertia",
    "mass_matrix",
    "motion",
    "polar",
    "rotation",
    "strain",
    "stress",
    "volume_mean",
]

Array = Any


def polar(F: Array) -> Array:
    """Rotations (m, 3, 3) of deformation gradients (m, 3, 3)."""
    R = np.empty_like(F)
    corotated.polar_rotations(F, R)
    return R


def frames(blocks: ZonedBlocks, x: Array) -> Array:
    """Rotations (m, 3, 3) of the zones: of the zone itself, or of its block's frame where strain is small."""
    return _strained(blocks, x)[1]


def _strained(blocks: ZonedBlocks, x: Array) -> tuple[Array, Array, Array]:
    """F, the rotation and the material strain of every zone, as its block's formulation measures them."""
    F = blocks.deformation(x)
    R = polar(F)
    material = 0.5 * (np.swapaxes(F, 1, 2) @ F - np.eye(3))
    for term in blocks._terms:
        if isinstance(term, SmallStrain):
            term.override(x[blocks.gridpoints], F, R, material)
    return F, R, material


def strain(blocks: ZonedBlocks, x: Array) -> Array:
    """Strain of the zones (m, 6), xx yy zz yz zx xy in global axes, engineering shear.

    Green-Lagrange strain turned to the present axes, ``R E R^T``; for ``strain="small"`` the linear strain in the
    frame of the block, turned alike.
    """
    _, R, material = _strained(blocks, x)
    return voigt_strain(R @ material @ np.swapaxes(R, 1, 2))


def stress(blocks: ZonedBlocks, x: Array) -> Array:
    """Cauchy stress of the zones (m, 6), xx yy zz yz zx xy in global axes, tension positive [Pa]."""
    F, R, material = _strained(blocks, x)
    second = elasticity(material, blocks.lam[blocks.zone_block], blocks.mu[blocks.zone_block])
    if blocks.stress0 is not None:
        second += tensors(blocks.stress0)
    large = blocks.large[blocks.zone_block][:, None, None]
    carrier = np.where(large, F, R)
    cauchy = carrier @ second @ np.swapaxes(carrier, 1, 2)
    cauchy /= np.where(large[:, 0, 0], np.linalg.det(F), 1.0)[:, None, None]
    return cauchy[:, [0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]]


def _sums(blocks: ZonedBlocks, values: Array) -> Array:
    """Sums (n_blocks, ...) over the gridpoints of every block."""
    return np.add.reduceat(values, blocks._start[:-1], axis=0)


def _owner(blocks: ZonedBlocks) -> Array:
    return np.repeat(np.arange(blocks.n_blocks), np.diff(blocks._start))


def volume_mean(blocks: ZonedBlocks, x: Array, values: Array) -> Array:
    """Means (n_blocks, k) over the present volume of values (m, k) of the zones."""
    a, b, c, d = (x[blocks.gridpoints][blocks._nodes[:, k]] for k in range(4))
    volume = np.abs(np.einsum("ni,ni->n", np.cross(b - a, c - a), d - a)) / 6.0
    total = np.bincount(blocks.zone_block, volume, blocks.n_blocks)
    columns = [np.bincount(blocks.zone_block, volume * column, blocks.n_blocks) for column in values.T]
    return np.column_stack(columns) / total[:, None]


def centres(blocks: ZonedBlocks, x: Array) -> Array:
    """Centroids (n_blocks, 3) [m]."""
    return volume_mean(blocks, x, x[blocks.gridpoints][blocks._nodes].mean(axis=1))


def arms(blocks: ZonedBlocks, local: Array) -> tuple[Array, Array]:
    """Arms (n, 3) [m] of positions (n, 3) from the centres of the gridpoint masses, and their blocks (n,)."""
    mass, owner = blocks.gp_mass[:, None], _owner(blocks)
    return local - (_sums(blocks, mass * local) / _sums(blocks, mass))[owner], owner


def motion(blocks: ZonedBlocks, v: Array, x: Array) -> tuple[Array, Array]:
    """Momentum over mass, and angular velocity of the mean rotation, (n_blocks, 3) each [m/s, rad/s]."""
    mass, (arm, owner) = blocks.gp_mass[:, None], arms(blocks, x[blocks.gridpoints])
    speed = v[blocks.dofs].reshape(-1, 3)
    mean = _sums(blocks, mass * speed) / _sums(blocks, mass)
    second = _sums(blocks, (mass * arm)[:, :, None] * arm[:, None, :])
    moments = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    momentum = _sums(blocks, mass * np.cross(arm, speed - mean[owner]))
    return mean, np.linalg.solve(moments, momentum[:, :, None])[:, :, 0]


def rotation(blocks: ZonedBlocks, x: Array) -> Array:
    """Rotations (n_blocks, 3, 3) of the mean deformation."""
    before, after = arms(blocks, blocks.X)[0], arms(blocks, x[blocks.gridpoints])[0]
    left, _, right = np.linalg.svd(_sums(blocks, (blocks.gp_mass[:, None] * after)[:, :, None] * before[:, None, :]))
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return left @ right


def inertia(blocks: ZonedBlocks, x: Array) -> Array:
    """Inertia about the centroids now (n_blocks, 3, 3) [kg m^2]."""
    corner = x[blocks.gridpoints][blocks._nodes] - centres(blocks, x)[blocks.zone_block][:, None]
    total = corner.sum(axis=1)
    second = np.einsum("nki,nkj->nij", corner, corner) + total[:, :, None] * total[:, None, :]
    second = np.add.reduceat(blocks.zone_mass[:, None, None] * second, blocks.zone_start[:-1], axis=0) / 20.0
    return np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second


def angular_momentum(blocks: ZonedBlocks, v: Array, x: Array) -> Array:
    """Angular momentum about the centroids (n_blocks, 3) [kg m^2/s]."""
    momentum = blocks.multiply_mass(v[blocks.dofs].reshape(-1, 3))
    return _sums(blocks, np.cross(x[blocks.gridpoints] - centres(blocks, x)[_owner(blocks)], momentum))


def mass_matrix(blocks: ZonedBlocks, row: int) -> Array:
    """Mass matrix (3 n, 3 n) of the gridpoints of one block [kg]."""
    start, stop = blocks._start[row : row + 2]
    unit = np.zeros((len(blocks.gp_mass), 3))
    columns = np.empty((stop - start, stop - start))
    for k in range(start, stop):
        unit[k, 0] = 1.0
        columns[:, k - start] = blocks.multiply_mass(unit)[start:stop, 0]
        unit[k, 0] = 0.0
    return np.kron(columns, np.eye(3))
