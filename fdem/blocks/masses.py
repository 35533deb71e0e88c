"""Masses of gridpoints: Voronoi, row-sum, and lumped masses corrected to the exact inertia."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fdem.blocks.voronoi import voronoi_masses
from fdem.errors import SceneError

__all__ = [
    "InertiaCorrection",
    "block_moments",
    "lumped_moments",
    "principal_axes",
    "row_sum_masses",
    "voronoi_masses",
]

Array = Any


def row_sum_masses(zones: Array, zone_mass: Array, n: int) -> Array:
    """Return a quarter of every zone's mass for each of its gridpoints, (n,) [kg]."""
    return np.bincount(zones.ravel(), np.repeat(0.25 * zone_mass, 4), minlength=n)


def block_moments(X: Array, zones: Array, zone_mass: Array, zone_start: Array, origin: Array) -> Array:
    """Exact mass moments of blocks.

    Parameters
    ----------
    X : (n, 3) array
        Reference positions [m].
    zones : (m, 4) int array
        Gridpoints of the zones, sorted by block.
    zone_mass : (m,) array
        [kg].
    zone_start : (n_blocks + 1,) int array
        Zones of every block.
    origin : (n_blocks, 3) array
        The point of every block from which moments are taken [m].

    Returns
    -------
    (n_blocks, 4, 4) array
        ``int rho phi phi^T dV`` with ``phi = (1, X, Y, Z)`` [kg, kg m, kg m^2]; a tetrahedron gives
        ``V/20 (sum x_a x_a^T + (sum x_a)(sum x_a)^T)``.
    """
    block = np.repeat(np.arange(zone_start.size - 1), np.diff(zone_start))
    local = X[zones] - origin[block][:, None, :]
    modes = np.concatenate([np.ones((*local.shape[:2], 1)), local], axis=2)
    total = modes.sum(axis=1)
    moments = (np.einsum("eai,eaj->eij", modes, modes) + total[:, :, None] * total[:, None, :]) / 20.0
    return np.add.reduceat(moments * zone_mass[:, None, None], zone_start[:-1], axis=0)


def lumped_moments(X: Array, mass: Array, gp_start: Array, origin: Array) -> Array:
    """Moments of gridpoint masses, as `block_moments`."""
    modes = _modes(X, gp_start, origin)
    return np.add.reduceat(mass[:, None, None] * modes[:, :, None] * modes[:, None, :], gp_start[:-1], axis=0)


def _modes(X: Array, gp_start: Array, origin: Array) -> Array:
    local = X - np.repeat(origin, np.diff(gp_start), axis=0)
    return np.concatenate([np.ones((X.shape[0], 1)), local], axis=1)


@dataclass(frozen=True)
class InertiaCorrection:
    """The low-rank part of an inertia-matched mass matrix.

    With the lumped masses D, the modes ``Phi = (1, X, Y, Z)`` of a block, its lumped moments
    ``J_D = Phi^T D Phi`` and its exact moments J, the mass matrix is
    ``M = D + D Phi S Phi^T D`` with ``S = J_D^-1 (J - J_D) J_D^-1``: then ``Phi^T M Phi = J`` exactly, so that
    the block's mass, centre and inertia are exact, and M stays positive. Woodbury's formula gives
    ``M^-1 = D^-1 + Phi T Phi^T`` with ``T = J^-1 - J_D^-1``. Both are constant in time.

    Parameters
    ----------
    rows : (k,) int array
        Gridpoints of the corrected blocks, block after block.
    start : (n + 1,) int array
        Where each of the n corrected blocks starts in `rows`.
    modes : (k, 4) array
        Phi [-, m].
    weighted : (k, 4) array
        D Phi [kg, kg m].
    S, T : (n, 4, 4) arrays
        As above.
    scale : (n, 4) array
        Powers of two that make the modes dimensionless [-, 1/m].
    """

    rows: Array
    start: Array
    modes: Array
    weighted: Array
    S: Array
    T: Array
    scale: Array

    @classmethod
    def build(
        cls, X: Array, mass: Array, gp_start: Array, origin: Array, exact: Array, blocks: Array
    ) -> InertiaCorrection:
        """Set up the correction of some `blocks` (ids); the other arguments are those of the batch."""
        counts = np.diff(gp_start)[blocks]
        rows = np.concatenate([np.arange(gp_start[b], gp_start[b + 1]) for b in blocks])
        start = np.concatenate([[0], np.cumsum(counts)])
        modes = _modes(X[rows], start, origin[blocks])
        weighted = mass[rows, None] * modes
        lumped = np.add.reduceat(weighted[:, :, None] * modes[:, None, :], start[:-1], axis=0)
        # scaled by a power of two near the block's size, the inverses are well conditioned in any unit of length
        size = np.exp2(np.round(0.5 * np.log2(lumped[:, [1, 2, 3], [1, 2, 3]].sum(axis=1) / lumped[:, 0, 0])))
        scale = np.ones((blocks.size, 4))
        scale[:, 1:] = 1.0 / size[:, None]
        outer = scale[:, :, None] * scale[:, None, :]
        inverse = np.linalg.inv(lumped * outer) * outer
        T = np.linalg.inv(exact[blocks] * outer) * outer - inverse
        S = inverse @ (exact[blocks] - lumped) @ inverse
        return cls(rows, start, modes, weighted, S, T, scale)

    def _low_rank(self, left: Array, core: Array, right: Array, u: Array) -> Array:
        values = u[self.rows]
        sums = np.add.reduceat(right[:, :, None] * values[:, None, :], self.start[:-1], axis=0)
        coefficients = np.repeat(core @ sums, np.diff(self.start), axis=0)
        return np.einsum("ki,kic->kc", left, coefficients)

    def add_mass(self, v: Array, out: Array) -> None:
        """``out += (M - D) v`` for (n, 3) arrays."""
        out[self.rows] += self._low_rank(self.weighted, self.S, self.weighted, v)

    def add_inverse(self, f: Array, out: Array) -> None:
        """``out += (M^-1 - D^-1) f`` for (n, 3) arrays."""
        out[self.rows] += self._low_rank(self.modes, self.T, self.modes, f)

    def frequency_bound(self, stiffness: Array, k_gp: Array) -> Array:
        """Bound what the correction adds to the largest eigenvalue of ``M^-1 K``, per corrected block.

        Parameters
        ----------
        stiffness : (n,) array
            Volume times the largest eigenvalue of the elasticity tensor [N m].
        k_gp : (k,) array
            Contact stiffness of the rows [N/m].

        Returns
        -------
        (n,) array
            Largest eigenvalue of ``T+ Phi^T K Phi`` [1/s^2], where T+ is the positive part of T.
        """
        values, vectors = np.linalg.eigh(self.T / (self.scale[:, :, None] * self.scale[:, None, :]))
        root = self.scale[:, :, None] * vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        gradient = np.zeros_like(self.T)
        gradient[:, [1, 2, 3], [1, 2, 3]] = stiffness[:, None]
        contact = np.add.reduceat(
            k_gp[:, None, None] * self.modes[:, :, None] * self.modes[:, None, :], self.start[:-1], axis=0
        )
        projected = np.swapaxes(root, 1, 2) @ (gradient + contact) @ root
        return np.linalg.eigvalsh(projected)[:, -1]


def principal_axes(inertia: Array) -> tuple[Array, Array]:
    """Principal moments (n, 3) [kg m^2] and directions (n, 3, 3) in columns, right-handed.

    Normalised by the trace first, so that the same body in another unit of length gets the same axes to the last bit.
    """
    if len(inertia) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3, 3))
    if not np.isfinite(inertia).all():
        bad = int(np.flatnonzero(~np.isfinite(inertia).all(axis=(1, 2)))[0])
        raise SceneError(f"rigid block {bad}: inertia is not finite")
    size = np.trace(inertia, axis1=1, axis2=2)
    size = np.where(size > 0.0, size, 1.0)
    moments, axes = np.linalg.eigh(inertia / size[:, None, None])
    axes[:, :, 2] *= np.sign(np.linalg.det(axes))[:, None]
    return np.ascontiguousarray(moments * size[:, None]), np.ascontiguousarray(axes)
