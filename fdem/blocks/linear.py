"""Linear-strain blocks: a quadratic displacement per block, integrated exactly, so that it bends without a mesh."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.blocks.fields import Array, FieldBlocks
from fdem.blocks.zoneforces import tensors
from fdem.kernels import fields as kernels

__all__ = ["LinearBlocks", "fairing", "function_moments", "monomials"]

# F(xi) = sum_a F_a xi_a with xi_0 = 1: coefficient m of a component stands in entries (a, j) of F_a
PLACE = np.zeros((9, 4, 3))
for _j in range(3):
    PLACE[_j, 0, _j] = 1.0
    PLACE[3 + _j, 1 + _j, _j] = 1.0
    PLACE[6 + _j, 1 + (_j + 1) % 3, (_j + 2) % 3] = PLACE[6 + _j, 1 + (_j + 2) % 3, (_j + 1) % 3] = 1.0
HALVES = np.array([0.5, 0.5, 0.5, 1.0, 1.0, 1.0])  # of the quadratic monomials in the functions
# monomial of the product xi_a xi_b: 1, x, y, z, xx, yy, zz, yz, zx, xy
PRODUCT = np.array([[0, 1, 2, 3], [1, 4, 9, 8], [2, 9, 5, 7], [3, 8, 7, 6]])


def monomials(arms: Array) -> Array:
    """1, x, y, z, xx, yy, zz, yz, zx, xy (n, 10) of places (n, 3) from the centre."""
    x, y, z = arms.T
    return np.column_stack([np.ones(len(arms)), arms, arms**2, y * z, z * x, x * y])


def function_moments(moments: Array) -> Array:
    """Moments (..., 9, 9) of the functions from those of the monomials (..., 10, 10) over the mass."""
    change = np.zeros((*moments.shape[:-2], 9, 10))
    change[..., np.arange(9), np.arange(1, 10)] = [1, 1, 1, *HALVES]
    # quadratic functions less their means
    change[..., 3:, 0] = -HALVES * moments[..., 0, 4:] / moments[..., 0, 0, None]
    return change @ moments @ np.swapaxes(change, -1, -2)


def fairing(arms: Array, triangles: Array, face: Array) -> Array:
    """What brings facets of curved faces to the right place in the mean.

    Facets between points of a curved face lie on its inner side. A uniform pressure on them would bend the block; with
    this it does on every function exactly what it does on the face.

    Parameters
    ----------
    arms : (n, 3) array
        Gridpoints from the centre [m].
    triangles : (m, 3) int array
        Facets.
    face : (m,) int array
        Plane face of the body each facet lies on.

    Returns
    -------
    (n, 6) array
        Least change of the quadratic functions at gridpoints within faces [m^2] for which their integrals over each
        face are exact; edges stay, and so do faces without a gridpoint of their own.
    """
    corners = arms[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1))
    at_middles, at_corners = (
        (HALVES * monomials(p.reshape(-1, 3))[:, 4:]).reshape(-1, 3, 6).mean(axis=1) for p in (middles, corners)
    )
    number: Any = np.unique(face, return_inverse=True)[1]
    missing, mean = np.zeros((number.max() + 1, 6)), np.zeros((number.max() + 1, len(arms)))
    np.add.at(missing, number, area[:, None] * (at_middles - at_corners))
    np.add.at(mean, (np.repeat(number, 3), np.asarray(triangles, dtype=int).ravel()), np.repeat(area / 3.0, 3))
    inner = np.where((mean > 0.0).sum(axis=0) == 1, mean, 0.0)
    own = (inner**2).sum(axis=1)
    # each gridpoint within a face belongs to that face alone
    return inner.T @ (missing / np.where(own > 0.0, own, 1.0)[:, None])


class LinearBlocks(FieldBlocks):
    """All blocks ``x = c + F xi + G : (xi xi) / 2`` less the mean of the last, ``xi = X - C``, of a model.

    Parameters
    ----------
    integrals : (n_blocks, 10, 10) array
        Integrals over the volume of the products of the monomials 1, x, y, z, xx, yy, zz, yz, zx, xy from the centre.
    fairing : (n_gp, 6) array
        Added to the quadratic functions at the batch's gridpoints [m^2], see `fairing`.
    **given
        As for `FieldBlocks`.

    Notes
    -----
    Thirty unknowns: the centre, and nine coefficients of each component: three of F, then those of the halves of xx,
    yy, zz and of yz, zx, xy. St. Venant-Kirchhoff, exact under any rotation; the energy is a polynomial of degree 4 in
    place and integrated exactly by moments.
    """

    label = "of linear strain"
    k = 9
    by_points = True

    def __init__(self, *, integrals: Array, fairing: Array, **given: Any) -> None:
        self.integrals = np.ascontiguousarray(integrals, dtype=np.float64)
        super().__init__(**given)
        self.phi = self.material.copy()
        self.phi[:, 3:] += fairing
        self.stress0 = np.zeros((0, 10, 6))
        self._field0 = np.zeros((self.n_blocks, 10, 6))

    def functions(self, arms: Array, owner: Any) -> Array:
        """Functions (m, 9) at places (m, 3) from the centre [m, m^2] of the blocks `owner` (m,)."""
        mean = self.moments_of_place()[owner] / self.mass[owner][:, None]
        return np.ascontiguousarray(np.hstack([arms, monomials(arms)[:, 4:] * HALVES - mean * HALVES]))

    def moments_of_place(self) -> Array:
        """Integrals over the mass (n_blocks, 6) of xx, yy, zz, yz, zx, xy."""
        return self.moments[:, [0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]]

    def internal(self, q: Array, x: Array, f: Array) -> None:
        """Subtract the internal forces from `f` [N m, N m^2]."""
        kernels.linear_force(self._q(q), self.lam, self.mu, self.integrals, self.stress0, self._v(f))

    def set_initial_stress(self, stress0: Array | None) -> None:
        """Choose the in-situ stress by its integrals with the monomials (n_blocks, 10, 6); None: stress-free."""
        if stress0 is None:
            self.stress0 = np.zeros((0, 10, 6))
            return
        self.stress0 = np.ascontiguousarray(stress0, dtype=np.float64)
        size = self.size[:, None] ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
        scaled = self.integrals / (size[:, :, None] * size[:, None, :])
        self._field0 = np.linalg.solve(scaled, self.stress0 / size[:, :, None]) / size[:, :, None]

    # the polynomials

    def _gradients(self, q: Array) -> Array:
        """F_a (n_blocks, 4, 3, 3)."""
        return np.einsum("nim,maj->naij", self._rows(self._q(q)), PLACE)

    def _green(self, F: Array) -> Array:
        """Green strain by monomials (n_blocks, 10, 3, 3)."""
        products = 0.5 * np.einsum("nadi,ncdj->nacij", F, F)
        result = np.zeros((self.n_blocks, 10, 3, 3))
        for a in range(4):
            for c in range(4):
                result[:, PRODUCT[a, c]] += products[:, a, c]
        result[:, 0] -= 0.5 * np.eye(3)
        return result

    def _elastic(self, e: Array) -> Array:
        trace = np.trace(e, axis1=-2, axis2=-1)[..., None, None]
        shape = (-1, *(1,) * (e.ndim - 1))
        return self.lam.reshape(shape) * trace * np.eye(3) + 2.0 * self.mu.reshape(shape) * e

    def _stress_moments(self, e: Array) -> Array:
        """Integrals of monomials times the 2nd Piola-Kirchhoff stress (n_blocks, 10, 3, 3)."""
        result = np.einsum("nab,nbij->naij", self.integrals, self._elastic(e))
        if len(self.stress0):
            result += tensors(self.stress0.reshape(-1, 6)).reshape(-1, 10, 3, 3)
        return result

    def strain_energy(self, q: Array, x: Array) -> float:
        """Strain energy [J]; with in-situ stress, counted from the reference configuration."""
        e = self._green(self._gradients(q))
        energy = 0.5 * np.einsum("naij,nab,nbij->", e, self.integrals, self._elastic(e))
        if len(self.stress0):
            energy += np.sum(e * tensors(self.stress0.reshape(-1, 6)).reshape(-1, 10, 3, 3))
        return float(energy)

    def stiffness(self, q: Array) -> Array:
        """Derivative (n_blocks, 27, 27) of the internal forces on the coefficients by the coefficients."""
        F, n = self._gradients(q), self.n_blocks
        change = np.zeros((n, 10, 3, 3, 3, 9))  # of the strain of each monomial by B
        for a in range(4):
            for c in range(4):
                half = 0.5 * np.einsum("mj,nik->njkim", PLACE[:, a], F[:, c])
                change[:, PRODUCT[a, c]] += half + np.swapaxes(half, 1, 2)
        D = change.reshape(n, 10, 9, 27)
        trace = change[:, :, 0, 0] + change[:, :, 1, 1] + change[:, :, 2, 2]
        lam, mu = self.lam[:, None, None], self.mu[:, None, None]
        flat = trace.reshape(n, 10, 27)
        spread = np.swapaxes(flat, 1, 2) @ self.integrals @ flat
        weighted = (self.integrals @ D.reshape(n, 10, -1)).reshape(n, 90, 27)
        result = lam * spread + 2.0 * mu * (np.swapaxes(D.reshape(n, 90, 27), 1, 2) @ weighted)
        T = self._stress_moments(self._green(F))[:, PRODUCT]
        stressed = np.einsum("maj,nacjk,ock->nmo", PLACE, T, PLACE)
        for d in range(3):
            result[:, 9 * d : 9 * d + 9, 9 * d : 9 * d + 9] += stressed
        return result

    # readout

    def _volumes(self, F: Array) -> Array:
        """Present volumes (n_blocks,): integrals of det F, a cubic."""
        cubic = self.integrals[:, PRODUCT][:, :, :, PRODUCT[0]]  # of xi_a xi_b xi_c
        cross = np.zeros((3, 3, 3))
        cross[[0, 1, 2], [1, 2, 0], [2, 0, 1]], cross[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = 1.0, -1.0
        minors = np.einsum("ijk,lmp,nbjm,nckp->nbcil", cross, cross, F, F)
        return np.einsum("nail,nbcil,nabc->n", F, minors, cubic) / 6.0

    def strains(self, q: Array, x: Array) -> Array:
        """Strain (n_blocks, 6), xx yy zz yz zx xy in global axes with engineering shear.

        Volume mean of the Green-Lagrange strain, turned to the present axes of the block.
        """
        e = np.einsum("na,naij->nij", self.integrals[:, 0], self._green(self._gradients(q)))
        R = self.rotation(q)
        turned = R @ (e / self.volume[:, None, None]) @ np.swapaxes(R, 1, 2)
        return turned[:, [0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]] * np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])

    def stresses(self, q: Array, x: Array) -> Array:
        """Volume mean of the Cauchy stress (n_blocks, 6) [Pa], xx yy zz yz zx xy in global axes, exact."""
        F = self._gradients(q)
        T = self._stress_moments(self._green(F))[:, PRODUCT]
        mean = np.einsum("naij,nacjk,nclk->nil", F, T, F) / self._volumes(F)[:, None, None]
        return mean[:, [0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]]

    def stress_at(self, q: Array, owner: Any, places: Array) -> Array:
        """Cauchy stress (m, 6) [Pa] at reference places (m, 3) of the blocks `owner` (m,)."""
        arms = places - self.centre0[owner]
        linear = np.hstack([np.ones((len(arms), 1)), arms])
        F = np.einsum("ma,maij->mij", linear, self._gradients(q)[owner])
        e = 0.5 * (np.swapaxes(F, 1, 2) @ F - np.eye(3))
        lam, mu = self.lam[owner][:, None, None], self.mu[owner][:, None, None]
        S = lam * np.trace(e, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 2.0 * mu * e
        S += tensors(np.einsum("ma,mai->mi", monomials(arms), self._field0[owner]))
        cauchy = F @ S @ np.swapaxes(F, 1, 2) / np.linalg.det(F)[:, None, None]
        return cauchy[:, [0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]]

    def inverted(self, q: Array, x: Array) -> tuple[int, int, str] | None:
        """Row in the model, a gridpoint and words about the first block turned inside out at a gridpoint, or None."""
        arms = self._X - self.centre0[self._owner]
        linear = np.hstack([np.ones((len(arms), 1)), arms])
        F = np.einsum("ma,maij->mij", linear, self._gradients(q)[self._owner])
        bad = np.flatnonzero(~(np.linalg.det(F) > 0.0))
        if not len(bad):
            return None
        return int(self.rows[self._owner[bad[0]]]), self.gridpoints.start + int(bad[0]), "it"
