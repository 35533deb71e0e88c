"""Uniform-strain blocks: one homogeneous deformation per block, as in DDA (THEORY.md 3)."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.blocks.fields import Array, FieldBlocks
from fdem.blocks.zoneforces import tensors
from fdem.kernels import fields as kernels

__all__ = ["UniformBlocks"]


class UniformBlocks(FieldBlocks):
    """All blocks ``x = c + F (X - C)`` of a model, one batch of the `Blocks` protocol.

    Inside, the twelve unknowns are the centre and the deformation gradient F = R U; the theory's translation,
    rotation and strain are read out by its polar decomposition.

    Notes
    -----
    The stress is linear in the stretch, in axes that turn with the block: ``P = R (lam tr(e) 1 + 2 mu e)`` with
    ``e = U - 1``, from the energy ``V (lam tr(e)^2 / 2 + mu e:e)``. It is objective under any rotation, equals linear
    elasticity at small strain, and under dead loads the strain is proportional to the load, as in the theory. In-situ
    stress adds ``F S0`` (a 2nd Piola-Kirchhoff stress, as in zones).
    """

    label = "of uniform strain"
    k = 3

    def internal(self, q: Array, x: Array, f: Array) -> None:
        """Subtract ``V P(F)`` from the forces `f` on F [N m]."""
        kernels.uniform_force(self._q(q), self.volume, self.lam, self.mu, self.stress0, self._v(f))

    def set_initial_stress(self, stress0: Array | None) -> None:
        """Choose the in-situ stress of the reference configuration (n_blocks, 6) [Pa]; None: stress-free."""
        self.stress0 = np.zeros((0, 6)) if stress0 is None else np.ascontiguousarray(stress0, dtype=np.float64)

    def _stretched(self, q: Array) -> tuple[Array, Array, Array]:
        """F, R and ``U - 1`` of every block, (n_blocks, 3, 3) each."""
        F, R = self.deformation(q), self.rotation(q)
        U = np.swapaxes(R, 1, 2) @ F
        return F, R, 0.5 * (U + np.swapaxes(U, 1, 2)) - np.eye(3)

    def _elastic(self, e: Array) -> Array:
        trace = np.trace(e, axis1=1, axis2=2)
        return (self.lam * trace)[:, None, None] * np.eye(3) + 2.0 * self.mu[:, None, None] * e

    def strain_energy(self, q: Array, x: Array) -> float:
        """Strain energy [J]; with in-situ stress, counted from the reference configuration."""
        F, _, e = self._stretched(q)
        energy = 0.5 * np.einsum("n,nij,nij->", self.volume, self._elastic(e), e)
        if len(self.stress0):
            green = 0.5 * (np.swapaxes(F, 1, 2) @ F - np.eye(3))
            energy += np.einsum("n,nij,nij->", self.volume, tensors(self.stress0), green)
        return float(energy)

    def stiffness(self, q: Array) -> Array:
        """Derivative (n_blocks, 9, 9) of the internal forces on F (by rows) by F [N m].

        With ``A = R^T dF`` and w the vector of its antisymmetric part, ``F = R U`` gives
        ``dP = 2 mu dF + lam tr(A) R - (2 mu - lam tr(e)) R [omega]x`` where ``(tr(U) 1 - U) omega = w``.
        """
        _, R, e = self._stretched(q)
        lam, mu, n = self.lam[:, None, None], self.mu[:, None, None], self.n_blocks
        trace = np.trace(e, axis1=1, axis2=2)[:, None, None]
        turn = np.zeros((n, 3, 9))  # from dF to w
        for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
            for d in range(3):
                turn[:, i, 3 * d + j] += R[:, d, k]
                turn[:, i, 3 * d + k] -= R[:, d, j]
        arms = (trace + 2.0) * np.eye(3) - e  # tr(U) 1 - U, U = 1 + e
        flat = R.reshape(n, 9)
        result = 2.0 * mu * np.eye(9) + lam * flat[:, :, None] * flat[:, None, :]
        result -= (2.0 * mu - lam * trace) * np.swapaxes(turn, 1, 2) @ np.linalg.solve(arms, turn)
        if len(self.stress0):
            for d in range(3):
                result[:, 3 * d : 3 * d + 3, 3 * d : 3 * d + 3] += tensors(self.stress0)
        return self.volume[:, None, None] * result

    def strains(self, q: Array, x: Array) -> Array:
        """Strain (n_blocks, 6), xx yy zz yz zx xy in global axes with engineering shear: ``R (U - 1) R^T``."""
        _, R, e = self._stretched(q)
        turned = R @ e @ np.swapaxes(R, 1, 2)
        return turned[:, [0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]] * np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])

    def stresses(self, q: Array, x: Array) -> Array:
        """Cauchy stress ``P F^T / det F`` (n_blocks, 6) [Pa], xx yy zz yz zx xy in global axes, tension positive."""
        F, R, e = self._stretched(q)
        kirchhoff = R @ self._elastic(e) @ np.swapaxes(F, 1, 2)
        if len(self.stress0):
            kirchhoff += F @ tensors(self.stress0) @ np.swapaxes(F, 1, 2)
        cauchy = kirchhoff / np.linalg.det(F)[:, None, None]
        return cauchy[:, [0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]]

    def stress_at(self, q: Array, owner: Any, places: Array) -> Array:
        """Cauchy stress (m, 6) [Pa]: that of the blocks `owner` (m,), the same everywhere in a block."""
        return self.stresses(q, np.zeros((0, 3)))[owner]
