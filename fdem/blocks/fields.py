"""Blocks whose displacement is a polynomial of place: what uniform and linear strain have in common."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from fdem.blocks import entries, fieldmasses
from fdem.blocks.bounds import Springs, share
from fdem.blocks.zoneforces import rotation_vectors
from fdem.errors import SceneError
from fdem.kernels import fields as kernels

__all__ = ["FieldBlocks"]

Array = npt.NDArray[np.float64]


class FieldBlocks(entries.Additive):
    """Blocks ``x = X + (c - C) + sum_k B_k phi_k(X) - (X - C)``: constant mass M, constant placement P.

    The first three functions are ``X - C``, so the first three coefficients are the deformation gradient F. All
    functions have no mean over the mass, so M couples coefficients of one component only. There is no gyroscopic and
    no geometric term, and angular momentum is exact under leapfrog whenever the stress is symmetric.

    Parameters
    ----------
    X : (n_gp, 3) array
        Reference positions of the gridpoints of the whole model [m].
    gp_start : (n_blocks + 1,) int array
        Block ``b`` owns the gridpoints ``gp_start[b]`` to ``gp_start[b + 1] - 1`` of the model.
    mass : (n_blocks,) array
        Masses [kg].
    moments : (n_blocks, k, k) array
        ``int rho phi phi^T dV`` [kg m^2, kg m^3, kg m^4].
    centre : (n_blocks, 3) array
        Centres of mass at the start [m].
    volume : (n_blocks,) array
        Reference volumes [m^3].
    lam, mu : (n_blocks,) array
        Lame constants [Pa].
    dofs, coords, gridpoints : slice
        The batch's share of ``v`` and ``f``, of ``q``, and of ``x``.

    Attributes
    ----------
    k : int
        Functions of place: 3 for uniform, 9 for linear strain.
    width : int
        Unknowns of a block, ``3 + 3 k``: centre, then the rows x, y, z of the coefficients.
    phi, material : (n, k) array
        Functions at the batch's gridpoints [m, m^2], as contact sees them and of the material points they are.
    centre0 : (n_blocks, 3) array
        Centres of mass at the start [m].
    has_internal, in_place, turns, has_strain : bool
        See `Blocks`.
    rows, size, free : (n_blocks,) arrays
        Row in the model, size [m] and whether a block can move; set by compile.

    Raises
    ------
    SceneError
        If a mass or a moment is not positive and finite.
    """

    k = 3
    has_internal = True
    in_place = False
    turns = True
    coupled = True
    by_points = False
    has_strain = True

    def __init__(
        self,
        X: Array,
        gp_start: npt.NDArray[np.integer],
        mass: Array,
        moments: Array,
        centre: Array,
        volume: Array,
        lam: Array,
        mu: Array,
        dofs: slice,
        coords: slice,
        gridpoints: slice,
    ) -> None:
        self.dofs, self.coords, self.gridpoints = dofs, coords, gridpoints
        self.n_blocks, self.width = len(mass), 3 + 3 * self.k
        self.mass, self.volume, self.lam, self.mu = (
            np.ascontiguousarray(a, dtype=np.float64) for a in (mass, volume, lam, mu)
        )
        self.moments = np.ascontiguousarray(moments, dtype=np.float64)
        least = np.diagonal(self.moments, axis1=1, axis2=2).min(axis=1, initial=np.inf)
        for name, positive in (("mass", self.mass), ("second moment of mass", least)):
            bad = np.flatnonzero(~(np.isfinite(positive) & (positive > 0.0)))
            if len(bad):
                raise SceneError(f"block {bad[0]}: {name} is {positive[bad[0]]}, it must be positive and finite")
        self._X = np.array(X[gridpoints], dtype=np.float64, order="C")
        self.centre0 = np.array(centre, dtype=np.float64, order="C")
        self._start = np.ascontiguousarray(np.asarray(gp_start) - gridpoints.start, dtype=np.int32)
        self._owner = np.repeat(np.arange(self.n_blocks), np.diff(self._start))
        self.phi = self.material = self.functions(self._X - self.centre0[self._owner], self._owner)
        self._inverse = fieldmasses.inverse(self.moments, self.mass)
        self._turned = np.zeros((self.n_blocks, 3))  # by the last step
        self._limits: dict[int, Array] = {}
        self.stress0 = np.zeros((0, 6))
        self.rows = np.arange(self.n_blocks)
        self.size = np.cbrt(self.volume)
        self.free = np.ones(self.n_blocks, dtype=bool)

    def functions(self, arms: Array, owner: Any) -> Array:
        """Functions (m, k) at places (m, 3) from the centre [m] of the blocks `owner` (m,)."""
        return np.ascontiguousarray(arms)

    # placement

    def start(self, q: Array) -> None:
        """Write the configuration at the start into `q`: reference centres, no deformation."""
        own = self._q(q)
        own[:] = 0.0
        own[:, :3] = self.centre0
        for d in range(3):
            own[:, 3 + d * self.k + d] = 1.0

    def launch(self, q: Array, x: Array, v: Array, velocity: Array, spin: Array) -> None:
        """Give the blocks the motion of rigid bodies, velocity and angular velocity (n_blocks, 3)."""
        own = self._v(v)
        own[:, :3] = velocity
        own[:, 3:] = np.einsum("nij,njk->nik", fieldmasses.cross(spin), self._rows(self._q(q))).reshape(
            self.n_blocks, -1
        )

    def place(self, q: Array, x: Array) -> None:
        """Write the positions of the batch's gridpoints into `x` [m]."""
        kernels.place(self._q(q), self._X, self.centre0, self.phi, self._start, x[self.gridpoints])

    def fit(self, row: int, q: Array, x: Array) -> None:
        """Give one block the motion nearest to the gridpoint positions `x` [m], and place these there."""
        own = slice(*self._start[row : row + 2])
        moved = x[self.gridpoints][own] - self._X[own]
        scale = np.abs(self.phi[own]).max(axis=0)
        basis = np.hstack([np.ones((len(moved), 1)), self.phi[own] / scale])
        found = np.linalg.lstsq(basis, moved, rcond=None)[0]
        self._q(q)[row, :3] = self.centre0[row] + found[0]
        rest = found[1:].T / scale
        rest[:, :3] += np.eye(3)
        self._q(q)[row, 3:] = rest.ravel()
        self.place(q, x)

    def show(self, q: Array, x: Array) -> None:
        """Write where the material points of the batch's gridpoints are into `x` [m]."""
        if self.material is not self.phi:
            kernels.place(self._q(q), self._X, self.centre0, self.material, self._start, x[self.gridpoints])

    def push(self, q: Array, v: Array, xdot: Array) -> None:
        """Write the gridpoint velocities ``P v`` into `xdot` [m/s]."""
        kernels.push(self._v(v), self.phi, self._start, xdot[self.gridpoints])

    def pull(self, q: Array, f_gp: Array, f: Array) -> None:
        """Add ``P^T f_gp`` to the generalised forces `f` [N, N m, N m^2]."""
        kernels.pull(f_gp[self.gridpoints], self.phi, self._start, self._v(f))

    def advance(self, q: Array, v: Array, dt: float, scaled: Array | None = None) -> None:
        """``q += dt v``; with fictitious masses rotation and stretch apart, each without the other's error."""
        move = kernels.advance if scaled is None else kernels.creep
        move(self._q(q), self._v(v), dt, self._turned)

    # forces and masses; `internal`, `strain_energy` and `stiffness` are the formulations' own

    def internal(self, q: Array, x: Array, f: Array) -> None:
        """Subtract the internal forces from `f`."""
        raise NotImplementedError

    def strain_energy(self, q: Array, x: Array) -> float:
        """Strain energy [J]; with in-situ stress, counted from the reference configuration."""
        raise NotImplementedError

    def stiffness(self, q: Array) -> Array:
        """Derivative (n_blocks, 3 k, 3 k) of the internal forces on the coefficients."""
        raise NotImplementedError

    def set_initial_stress(self, stress0: Array | None) -> None:
        """Choose the in-situ stress of the reference configuration; None: stress-free."""
        raise NotImplementedError

    def stress_at(self, q: Array, owner: Any, places: Array) -> Array:
        """Cauchy stress (m, 6) [Pa] at reference places (m, 3) of the blocks `owner` (m,)."""
        raise NotImplementedError

    def graded(self, level: Array) -> list[tuple[int, Callable[..., None]]]:
        """`internal`, in every step."""
        return [(0, self.internal)]

    def weight(self, g: Array, f: Array) -> None:
        """Add ``m g`` to the forces `f` [N]; no function has a mean over the mass."""
        self._v(f)[:, :3] += self.mass[:, None] * g

    def accelerate(self, q: Array, f: Array, a: Array, scaled: Array | None = None) -> None:
        """Write ``M^-1 f`` into `a`; `scaled` is what `scaled_masses` returned, None the true mass."""
        if scaled is None:
            kernels.accelerate(self._v(f), self.mass, self._inverse, self._v(a))
        else:
            kernels.relax(self._q(q), self._v(f), scaled[1], self._v(a))

    def resist(self, q: Array, f: Array, v: Array, share: float, out: Array) -> None:
        """Write local damping into `out`: a share of the force of every motion, against its rate."""
        kernels.resist(self._q(q), self._v(f), self._v(v), share, *self._damped, self._v(out))

    @cached_property
    def _damped(self) -> Array:
        """Motions that local damping acts on and mass times these (2, n_blocks, width, width); see `motions`."""
        start = np.zeros(self.coords.stop)
        self.start(start)
        inner = fieldmasses.inner(self, start)
        rows = range(self.n_blocks)
        limits = self._limits
        made = [fieldmasses.motions(self, row, start, inner[row], limits.get(row)) for row in rows]
        return np.ascontiguousarray(np.stack(made, axis=1))

    def confine(self, row: int, rows: Array) -> None:
        """Take note of conditions ``rows v = 0`` on the unknowns of one block, before anything is damped."""
        self._limits[row] = rows

    def kinetic(self, q: Array, v: Array) -> float:
        """Kinetic energy [J]."""
        own, rate = self._v(v), self._rows(self._v(v))
        energy = np.sum(self.mass[:, None] * own[:, :3] ** 2) + np.einsum("nik,nkl,nil->", rate, self.moments, rate)
        return 0.5 * float(energy)

    def potential(self, g: Array, x: Array, q: Array) -> float:
        """Energy ``-sum m g.c`` in the gravity `g` [J]."""
        return -float(np.sum(self.mass * (self._q(q)[:, :3] @ np.asarray(g, dtype=np.float64))))

    # stable step, fictitious masses

    def masses(self) -> Array:
        """Mass matrices (n_blocks, width, width)."""
        return fieldmasses.masses(self)

    def step_bound(self, q: Array, springs: Springs) -> Array:
        """Largest ``omega^2`` of every block (n_blocks,) with its strains and on all springs [1/s^2]."""
        return fieldmasses.largest(self, fieldmasses.inner(self, q) + fieldmasses.outer(self, springs))

    def decay_bound(self, q: Array, c_gp: Array) -> float:
        """Largest decay rate [1/s] that dashpots `c_gp` (n_gp,) [N s/m] on gridpoints give a block."""
        return float(fieldmasses.largest(self, fieldmasses.spread(self, c_gp))[self.free].max(initial=0.0))

    def scaled_masses(self, q: Array, springs: Springs, swing: float) -> Array:
        """Fictitious mass matrices and inverses (2, n_blocks, width, width); see `fieldmasses.fictitious`."""
        return fieldmasses.fictitious(self, q, springs, swing)

    def scaled_kinetic(self, q: Array, v: Array, scaled: Array) -> float:
        """``v.M v`` with the fictitious masses."""
        local = np.einsum("nji,nj->ni", fieldmasses.turns(self, q), self._v(v))
        return float(np.einsum("ni,nij,nj->", local, scaled[0], local))

    def inverse_mass(self, row: int, q: Array, scaled: Array | None) -> Array:
        """Inverse mass matrix (width, width) of one block, true or fictitious."""
        if scaled is None:
            result = np.kron(np.eye(3), self._inverse[row])
            return np.block(
                [[np.eye(3) / self.mass[row], np.zeros((3, 3 * self.k))], [np.zeros((3 * self.k, 3)), result]]
            )
        turn = fieldmasses.turns(self, q)[row]
        return turn @ scaled[1, row] @ turn.T

    def unbalance(
        self, q: Array, x: Array, unbalanced: Array, pushes: Array, gravity: float, scaled: Array | None
    ) -> float:
        """Largest unbalanced force, or moment over the block size, over the largest force acting on a block.

        The forces on coefficients count as forces over the block size (quadratic functions: over its square). Unknowns
        end at their last bits, and so forces: that much is not counted when masses, and so stiffness, are known.
        """
        if not self.free.any():
            return 0.0
        inner = np.zeros(len(unbalanced))
        self.internal(q, x, inner)
        left, strained = self._sizes(unbalanced), self._sizes(inner).max(axis=1)
        if scaled is not None:
            noise = np.zeros(len(unbalanced))
            self._v(noise)[:] = np.einsum("nij,nj->ni", np.abs(scaled[0]), np.abs(self._q(q)))
            left -= 8 * np.finfo(float).eps * self._sizes(noise)
        left = np.maximum(left, 0.0).max(axis=1)
        pushed = np.add.reduceat(pushes[self.gridpoints], self._start[:-1])
        acting = np.maximum(np.maximum(pushed, strained), self.mass * gravity)
        return share(float(left[self.free].max()), float(acting[self.free].max()))

    def _sizes(self, f: Array) -> Array:
        """Norms of the forces on the centre, on F and on the quadratic functions, as forces (n_blocks, 2 or 3) [N]."""
        own, rest = self._v(f), self._rows(self._v(f))
        parts = [np.linalg.norm(own[:, :3], axis=1), np.linalg.norm(rest[:, :, :3], axis=(1, 2)) / self.size]
        if self.k > 3:
            parts.append(np.linalg.norm(rest[:, :, 3:], axis=(1, 2)) / self.size**2)
        return np.column_stack(parts)

    # readout

    def dofs_of(self, row: int) -> slice:
        """Unknowns of one block."""
        first = self.dofs.start + self.width * row
        return slice(first, first + self.width)

    def coords_of(self, row: int) -> slice:
        """Coordinates of one block in `q`."""
        first = self.coords.start + self.width * row
        return slice(first, first + self.width)

    def centres(self, q: Array, x: Array) -> Array:
        """Centres of mass (n_blocks, 3) [m]."""
        return self._q(q)[:, :3].copy()

    def deformation(self, q: Array) -> Array:
        """Deformation gradients F at the centres (n_blocks, 3, 3)."""
        return np.ascontiguousarray(self._rows(self._q(q))[:, :, :3])

    def rotation(self, q: Array, x: Array | None = None) -> Array:
        """Rotations (n_blocks, 3, 3) since the start, of the polar decomposition of F."""
        result = np.empty((self.n_blocks, 3, 3))
        kernels.rotations(self._q(q), self.k, result)
        return result

    def turn(self, q: Array, v: Array, dt: float) -> Array:
        """Rotation vectors (n_blocks, 3) [rad] of the last step, exact at any angle below pi."""
        return self._turned

    def turned(self, q0: Array, q: Array, d: Array) -> Array:
        """Rotation vectors (n_blocks, 3) [rad] of the increment `d` from `q0` to `q`."""
        return rotation_vectors(self.rotation(q) @ np.swapaxes(self.rotation(q0), 1, 2))

    def second_moments(self, q: Array) -> Array:
        """Integral of ``rho r r^T`` about the centres now (n_blocks, 3, 3) [kg m^2]."""
        B = self._rows(self._q(q))
        return B @ self.moments @ np.swapaxes(B, 1, 2)

    def inertia(self, q: Array, x: Array | None = None) -> Array:
        """Inertia about the centres now (n_blocks, 3, 3) [kg m^2]."""
        second = self.second_moments(q)
        return np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second

    def angular_momentum(self, q: Array, v: Array, x: Array | None = None) -> Array:
        """Angular momentum about the centres (n_blocks, 3) [kg m^2/s]."""
        return fieldmasses.axial(self._rows(self._v(v)) @ self.moments @ np.swapaxes(self._rows(self._q(q)), 1, 2))

    def motion(self, q: Array, v: Array, x: Array) -> tuple[Array, Array]:
        """Velocity of the centre and angular velocity of the mean rotation (n_blocks, 3) each, ``I omega = L``."""
        spin = np.asarray(np.linalg.solve(self.inertia(q), self.angular_momentum(q, v)[:, :, None])[:, :, 0])
        return self._v(v)[:, :3].copy(), spin

    def inverted(self, q: Array, x: Array) -> tuple[int, int, str] | None:
        """Row in the model, a gridpoint and words about the first block turned inside out, or None."""
        bad = np.flatnonzero(~(np.linalg.det(self.deformation(q)) > 0.0))
        if not len(bad):
            return None
        return int(self.rows[bad[0]]), self.gridpoints.start + int(self._start[bad[0]]), "it"

    def theory(self, row: int, q: Array) -> Array:
        """Matrix (width, width) from the theory's rates of one block to those of its unknowns.

        The theory's are translation, rotation and strain (xx yy zz yz zx xy, engineering shear) of the present shape
        about its centre; then, for linear strain, the rates of the quadratic coefficients beside them.
        """
        result = np.zeros((self.width, self.width))
        B = self._rows(self._q(q))[row]
        result[:3, :3] = np.eye(3)
        for i, gradient in enumerate(fieldmasses.GRADIENTS):
            result[3:, 3 + i] = (gradient @ B).ravel()
        higher = [3 + d * self.k + m for d in range(3) for m in range(3, self.k)]
        result[higher, 12 + np.arange(len(higher))] = 1.0
        return result

    def mass_of(self, row: int, q: Array) -> Array:
        """Mass matrix (width, width) of the unknowns of one block."""
        return self.masses()[row]

    def strains(self, q: Array, x: Array) -> Array:
        """Strain (n_blocks, 6), xx yy zz yz zx xy in global axes with engineering shear, volume mean."""
        raise NotImplementedError

    def stresses(self, q: Array, x: Array) -> Array:
        """Volume mean of the Cauchy stress (n_blocks, 6) [Pa], xx yy zz yz zx xy in global axes."""
        raise NotImplementedError

    def generalised_displacement(self, row: int, q: Array, displacement: Array, moved: Array, turned: Array) -> Array:
        """The theory's u (12,): translation [m], accumulated rotation [rad], strain; linear strain: (30,)."""
        rest = self._rows(self._q(q))[row, :, 3:].ravel()
        return np.concatenate([moved, turned, self.strains(q, displacement)[row], rest])

    # for implicit methods

    def mass_entries(self, q: Array) -> entries.Entries:
        """Mass matrix, constant."""
        return entries.of_blocks(self.dofs.start + self.width * np.arange(self.n_blocks), self.masses())

    def tangent(self, q: Array, x: Array) -> entries.Entries:
        """Derivative of the internal forces by the unknowns."""
        first = self.dofs.start + self.width * np.arange(self.n_blocks) + 3
        return entries.of_blocks(first, self.stiffness(q))

    def jacobian(self, q: Array) -> entries.Entries:
        """``P`` of `push`: rows 3 gp + axis of the model, columns its unknowns; constant."""
        rows = 3 * (self.gridpoints.start + np.arange(len(self.phi)))[:, None] + np.arange(3)
        first = (self.dofs.start + self.width * self._owner)[:, None] + np.arange(3)
        inner = np.arange(3 * self.k).reshape(3, self.k) + 3 - np.arange(3)[:, None] + first[:, :, None]
        columns = np.concatenate([first[:, :, None], inner], axis=2)
        values = np.concatenate([np.ones((len(self.phi), 1)), self.phi], axis=1)[:, None, :]
        return (
            np.repeat(rows.ravel(), self.k + 1),
            columns.ravel(),
            np.broadcast_to(values, columns.shape).ravel(),
        )

    # views of the flat arrays

    def _q(self, q: Array) -> Array:
        return q[self.coords].reshape(self.n_blocks, self.width)

    def _v(self, v: Array) -> Array:
        return v[self.dofs].reshape(self.n_blocks, self.width)

    def _rows(self, own: Array) -> Array:
        """Coefficients (n_blocks, 3, k) among unknowns (n_blocks, width)."""
        return own[:, 3:].reshape(self.n_blocks, 3, self.k)
