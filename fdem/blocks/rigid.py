"""Rigid blocks: centroid and unit quaternion, any polyhedron or clump (THEORY.md 1, NUMERICS.md 8)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fdem.blocks.bounds import Springs, joint_stiffness, share
from fdem.errors import SceneError
from fdem.kernels import blocks as kernels

__all__ = ["RigidBlocks"]

Array = npt.NDArray[np.float64]


class RigidBlocks:
    """All rigid blocks of a model, one batch of the `Blocks` protocol.

    The configuration of a block is its centroid and the unit quaternion (w, x, y, z) of its rotation *since the start*;
    its velocity is that of the centroid and the angular velocity in global axes. Principal axes stay inside.

    Parameters
    ----------
    X : (n_gp, 3) array
        Reference positions of the gridpoints of the whole model [m].
    gp_start : (n_blocks + 1,) array of int
        Block ``b`` owns the gridpoints ``gp_start[b]`` to ``gp_start[b + 1] - 1`` of the model.
    mass : (n_blocks,) array
        Masses [kg].
    inertia : (n_blocks, 3, 3) array
        Inertia about the centroid in global axes at the start [kg m^2].
    centroid : (n_blocks, 3) array
        Centroids at the start [m].
    dofs, coords, gridpoints : slice
        The batch's share of ``v`` and ``f``, of ``q``, and of ``x``.

    Attributes
    ----------
    has_internal, in_place : bool
        False: rigid blocks have no internal forces, and their unknowns are not positions of gridpoints.
    rows, size, free : (n_blocks,) arrays
        Row in the model, size [m] and whether a block can move; set by compile.

    Raises
    ------
    SceneError
        If a mass or a principal moment of inertia is not positive and finite.
    """

    has_internal = False
    in_place = False

    def __init__(
        self,
        X: Array,
        gp_start: npt.NDArray[np.integer],
        mass: Array,
        inertia: Array,
        centroid: Array,
        dofs: slice,
        coords: slice,
        gridpoints: slice,
    ) -> None:
        self.dofs, self.coords, self.gridpoints = dofs, coords, gridpoints
        self.n_blocks = len(mass)
        self.mass = np.ascontiguousarray(mass, dtype=np.float64)
        self.moments, self.axes = _principal_axes(np.asarray(inertia, dtype=np.float64))
        for name, positive in (("mass", self.mass), ("inertia", self.moments.min(axis=1, initial=np.inf))):
            bad = np.flatnonzero(~(np.isfinite(positive) & (positive > 0.0)))
            if len(bad):
                raise SceneError(f"rigid block {bad[0]}: {name} is {positive[bad[0]]}, it must be positive and finite")
        self._X = np.array(X[gridpoints], dtype=np.float64, order="C")
        self._C = np.array(centroid, dtype=np.float64, order="C")
        self._start = np.ascontiguousarray(np.asarray(gp_start) - gridpoints.start, dtype=np.int32)
        self._unscaled = np.ones(self.n_blocks)
        self.rows = np.arange(self.n_blocks)
        self.size = np.ones(self.n_blocks)
        self.free = np.ones(self.n_blocks, dtype=bool)

    def start(self, q: Array) -> None:
        """Write the configuration at the start into ``q``: reference centroids, no rotation."""
        own = self._q(q)
        own[:, :3] = self._C
        own[:, 3:] = (1.0, 0.0, 0.0, 0.0)

    def place(self, q: Array, x: Array) -> None:
        """Write the positions ``X + (c - C) + (R - 1)(X - C)`` of the batch's gridpoints into ``x`` [m]."""
        kernels.rigid_place(self._q(q), self._X, self._C, self._start, x[self.gridpoints])

    def push(self, q: Array, v: Array, xdot: Array) -> None:
        """Write the gridpoint velocities ``v + omega x r`` into ``xdot`` [m/s]."""
        kernels.rigid_push(self._q(q), self._v(v), self._X, self._C, self._start, xdot[self.gridpoints])

    def pull(self, q: Array, f_gp: Array, f: Array) -> None:
        """Add force and moment about the centroid to ``f`` [N, N m]; the transpose of `push`."""
        kernels.rigid_pull(self._q(q), f_gp[self.gridpoints], self._X, self._C, self._start, self._v(f))

    def weight(self, g: Array, f: Array) -> None:
        """Add ``m g`` to the forces ``f`` [N]; ``g`` is gravity [m/s^2]."""
        self._v(f)[:, :3] += self.mass[:, None] * g

    def accelerate(self, q: Array, f: Array, a: Array, scaled: Array | None = None) -> None:
        """Write the accelerations ``(F / m, I(R)^-1 T)`` into ``a`` [m/s^2, rad/s^2].

        Parameters
        ----------
        q : (n_q,) array
            Configuration [m, -].
        f : (n_dofs,) array
            Generalised forces [N, N m].
        a : (n_dofs,) array
            Out: accelerations in global axes. There is no gyroscopic term: `advance` keeps the momentum instead.
        scaled : (n_blocks,) array, optional
            What `relaxation_mass` returned; None is the true mass.
        """
        scale = self._unscaled if scaled is None else scaled
        kernels.rigid_accelerate(self._q(q), self._v(f), self.mass, self.moments, self.axes, scale, self._v(a))

    def advance(self, q: Array, v: Array, dt: float) -> None:
        """Move by ``dt`` [s] at fixed momentum, in place.

        Parameters
        ----------
        q : (n_q,) array
            In, out: configuration [m, -].
        v : (n_dofs,) array
            In, out: velocities; the angular velocity changes so that ``I(R) omega`` does not [m/s, rad/s].
        dt : float
            Step [s].

        Notes
        -----
        Implicit midpoint rule in principal axes with moments of inertia corrected to fourth order, solved to round-off
        (NUMERICS.md 8; Hairer & Vilmart, J. Phys. A 39 (2006) 13225). Energy and angular momentum are exact to
        round-off for any step; a block that does not rotate keeps its orientation to the last bit.
        """
        kernels.rigid_advance(self._q(q), self._v(v), dt, self.moments, self.axes)

    def kinetic(self, q: Array, v: Array) -> float:
        """Kinetic energy ``(m v.v + omega.I omega) / 2`` of the batch [J]."""
        own = self._v(v)
        spin = np.einsum("nji,nj->ni", self._current_axes(q), own[:, 3:])
        return 0.5 * float(np.sum(self.mass[:, None] * own[:, :3] ** 2) + np.sum(self.moments * spin**2))

    def strain_energy(self, x: Array) -> float:
        """Strain energy [J]: zero."""
        return 0.0

    def potential(self, g: Array, x: Array, q: Array) -> float:
        """Energy ``-sum m g.c`` in the gravity ``g`` [J]."""
        return -float(np.sum(self.mass * (self._q(q)[:, :3] @ np.asarray(g, dtype=np.float64))))

    def frequency_bound(self, q: Array, x: Array, k_gp: Array, joints: Array | None = None) -> Array:
        """Largest ``omega^2`` of every block on the springs ``k_gp`` of its gridpoints.

        Parameters
        ----------
        q : (n_q,) array
            Configuration; isotropic springs see the same block in every orientation, `joints` do not.
        x : (n_gp, 3) array
            Positions; not needed.
        k_gp : (n_gp,) array
            Stiffness per gridpoint, the same in all directions [N/m].
        joints : (n_blocks, 6, 6) array, optional
            Stiffness against translation and rotation about the centroid, global axes [N/m, N, N m], added.

        Returns
        -------
        (n_blocks,) array
            Largest eigenvalue of ``M^-1 P^T diag(k_gp) P`` [1/s^2], exact for springs equal in all directions.
        """
        if self.n_blocks == 0:
            return np.zeros(0)
        arms = np.einsum("nji,nj->ni", np.repeat(self.axes, np.diff(self._start), axis=0), self._arms())
        k = k_gp[self.gridpoints]
        # P^T k P in principal axes: [[s1, -[s x]], [[s x], sum k (r.r 1 - r r^T)]]
        first = self._sum(k[:, None] * arms)
        second = self._sum(k[:, None, None] * arms[:, :, None] * arms[:, None, :])
        stiffness = np.zeros((self.n_blocks, 6, 6))
        diagonal = np.arange(3)
        stiffness[:, diagonal, diagonal] = self._sum(k)[:, None]
        cross = np.zeros((self.n_blocks, 3, 3))
        cross[:, [2, 0, 1], [1, 2, 0]] = first
        cross[:, [1, 2, 0], [2, 0, 1]] = -first
        stiffness[:, 3:, :3] = cross
        stiffness[:, :3, 3:] = -cross
        stiffness[:, 3:, 3:] = -second
        stiffness[:, 3 + diagonal, 3 + diagonal] += np.trace(second, axis1=1, axis2=2)[:, None]
        if joints is not None:
            turn = np.zeros((self.n_blocks, 6, 6))
            turn[:, :3, :3] = turn[:, 3:, 3:] = self._current_axes(q)
            stiffness += np.swapaxes(turn, 1, 2) @ joints @ turn
        root = np.sqrt(np.concatenate([np.repeat(self.mass[:, None], 3, axis=1), self.moments], axis=1))
        largest: Array = np.linalg.eigvalsh(stiffness / (root[:, :, None] * root[:, None, :]))[:, -1]
        return np.maximum(largest, 0.0)

    def relaxation_mass(self, q: Array, x: Array, k_gp: Array, joints: Array | None = None) -> Array:
        """Mass scale of every block for which its largest ``omega`` on the springs ``k_gp`` is 1 rad/s.

        Parameters
        ----------
        q, x, k_gp, joints : array
            As for `frequency_bound`.

        Returns
        -------
        (n_blocks,) array
            Factors on mass and inertia, to be given back to `accelerate`. A block without springs gets the largest
            factor of the others (1 if there are none): it falls slowly until it touches something.
        """
        scale = self.frequency_bound(q, x, k_gp, joints)
        largest = scale.max(initial=0.0)
        return np.where(scale > 0.0, scale, largest if largest > 0.0 else 1.0)

    def _held_by(self, q: Array, springs: Springs) -> tuple[Array, Array | None]:
        """Gridpoint stiffness and (n_blocks, 6, 6) joint stiffness that bound the motion of each block."""
        if springs.contacts is None:
            return springs.k_gp, None
        place = np.full(len(springs.mobile), -1)
        place[self.rows] = np.arange(self.n_blocks)
        centre = self._q(q)[:, :3]
        joints = joint_stiffness(springs.rows, springs.x, springs.gp_block, springs.mobile, place, centre)
        return springs.bedding, joints

    def step_bound(self, q: Array, springs: Springs) -> Array:
        """Largest ``omega^2`` of every block (n_blocks,) on all springs [1/s^2]."""
        return self.frequency_bound(q, springs.x, *self._held_by(q, springs))

    def scaled_masses(self, q: Array, springs: Springs, swing: float) -> Array:
        """Fictitious masses for `springs`; `swing` is the largest factor by which damping stiffens them.

        The bound is close to the true frequency, so `swing` counts in full. A block that touches nothing yet moves as
        if on its joint: else it falls through what is below it.
        """
        held = self._held_by(q, springs)
        scale = swing * self.relaxation_mass(q, springs.x, *held)
        loose = self.frequency_bound(q, springs.x, *held) == 0.0
        scale[loose] = np.maximum(scale[loose], springs.kn * self.size[loose] ** 2 / self.mass[loose])
        return scale

    def scaled_kinetic(self, q: Array, v: Array, scaled: Array) -> float:
        """``v.M v`` with the fictitious masses."""
        six = self._v(v)
        return float(np.einsum("n,ni,nij,nj->", scaled, six, self.generalised_mass(q), six))

    def unbalance(self, x: Array, unbalanced: Array, pushes: Array, gravity: float, scaled: Array | None) -> float:
        """Largest unbalanced force, or moment over the block size, over the largest force acting on a block.

        Parameters
        ----------
        x : (n_gp, 3) array
            Positions; not needed.
        unbalanced : (n_dofs,) array
            Generalised forces that nothing balances [N, N m].
        pushes : (n_gp,) array
            Contact forces and loads on gridpoints [N].
        gravity : float
            [m/s^2].
        scaled : array or None
            Fictitious masses; not needed.
        """
        if not self.free.any():
            return 0.0
        six = self._v(unbalanced)
        left = np.maximum(np.linalg.norm(six[:, :3], axis=1), np.linalg.norm(six[:, 3:], axis=1) / self.size)
        acting = np.maximum(np.add.reduceat(pushes[self.gridpoints], self._start[:-1]), self.mass * gravity)
        return share(float(left[self.free].max()), float(acting[self.free].max()))

    def rotation(self, q: Array) -> Array:
        """Rotation of every block since the start, (n_blocks, 3, 3) [-]."""
        w, x, y, z = self._q(q)[:, 3:].T
        s = 2.0 / (w * w + x * x + y * y + z * z)
        turn = np.empty((self.n_blocks, 3, 3))
        turn[:, 0] = np.column_stack([1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)])
        turn[:, 1] = np.column_stack([s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)])
        turn[:, 2] = np.column_stack([s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)])
        return turn

    def rotation_vector(self, q: Array) -> Array:
        """Axis times angle of `rotation`, (n_blocks, 3) [rad], angle at most pi."""
        quaternion = self._q(q)[:, 3:]
        sine = np.linalg.norm(quaternion[:, 1:], axis=1)
        # q and -q are the same rotation: take the one that turns less
        half = np.arctan2(sine, np.abs(quaternion[:, 0]))
        ratio = np.where(sine > 0.0, half / np.where(sine > 0.0, sine, 1.0), 1.0)
        sign = np.where(quaternion[:, 0] < 0.0, -1.0, 1.0)
        return (2.0 * sign * ratio)[:, None] * quaternion[:, 1:]

    def inertia(self, q: Array) -> Array:
        """Inertia about the centroid in global axes now, (n_blocks, 3, 3) [kg m^2]."""
        axes = self._current_axes(q)
        inertia: Array = np.einsum("nij,nj,nkj->nik", axes, self.moments, axes)
        return inertia

    def angular_momentum(self, q: Array, v: Array) -> Array:
        """Angular momentum about the centroid, (n_blocks, 3) [kg m^2/s], global axes."""
        axes = self._current_axes(q)
        momentum: Array = np.einsum("nij,nj,nkj,nk->ni", axes, self.moments, axes, self._v(v)[:, 3:])
        return momentum

    def generalised_mass(self, q: Array) -> Array:
        """Mass matrix of every block, (n_blocks, 6, 6), blocks ``m 1`` and ``I(R)`` [kg, kg m^2]."""
        matrix = np.zeros((self.n_blocks, 6, 6))
        diagonal = np.arange(3)
        matrix[:, diagonal, diagonal] = self.mass[:, None]
        matrix[:, 3:, 3:] = self.inertia(q)
        return matrix

    # implicit steps

    def shift(self, q: Array, d: Array) -> None:
        """``q <- q (+) d``: centroids by the translation, orientations by the rotation vector in `d` (n_dofs,)."""
        own, step = self._q(q), self._v(d)
        own[:, :3] += step[:, :3]
        half = 0.5 * step[:, 3:]
        angle = np.linalg.norm(half, axis=1)
        sinc = np.sinc(angle / np.pi)[:, None]
        w, u = np.cos(angle), sinc * half
        w0, u0 = own[:, 3].copy(), own[:, 4:].copy()
        own[:, 3] = w * w0 - np.einsum("ni,ni->n", u, u0)
        own[:, 4:] = w[:, None] * u0 + w0[:, None] * u + np.cross(u, u0)
        own[:, 3:] /= np.linalg.norm(own[:, 3:], axis=1)[:, None]

    def gyroscopic(self, q: Array, v: Array, f: Array) -> None:
        """Subtract ``omega x I omega`` from the moments [N m]."""
        spin = self._v(v)[:, 3:]
        self._v(f)[:, 3:] -= np.cross(spin, np.einsum("nij,nj->ni", self.inertia(q), spin))

    def dof_rows(self) -> npt.NDArray[np.int64]:
        """Row in the model of the block of every unknown of this batch."""
        return np.repeat(self.rows, 6)

    def mass_diagonal(self, q: Array) -> Array:
        """Diagonal of the mass matrix of this batch."""
        return np.ascontiguousarray(np.diagonal(self.generalised_mass(q), axis1=1, axis2=2)).ravel()

    def add_momentum(self, q: Array, v: Array, out: Array) -> None:
        """``out += M v``."""
        self._v(out)[:] += np.einsum("nij,nj->ni", self.generalised_mass(q), self._v(v))

    def unknown_groups(self) -> list[npt.NDArray[np.int64]]:
        """Unknowns that belong together: the six of every block."""
        return [self.dofs.start + np.arange(6 * self.n_blocks).reshape(-1, 6)]

    def mass_entries(self, q: Array) -> tuple[Array, Array, Array]:
        """Rows, columns and values of the mass matrix."""
        return _block_entries(self.unknown_groups()[0], self.generalised_mass(q))

    def stiffness_entries(self, x: Array) -> tuple[Array, Array, Array]:
        """Entries of the internal stiffness: none."""
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)

    def geometric_entries(self, q: Array, f_gp: Array) -> tuple[Array, Array, Array]:
        """Entries of ``-(dP^T / dq) f_gp``: moments change when the arms of constant forces turn.

        ``d(sum r x f) = sum (r f^T - (r.f) 1) d phi``; not symmetric in general.
        """
        arms = np.einsum("nij,nj->ni", np.repeat(self.rotation(q), np.diff(self._start), axis=0), self._arms())
        f = f_gp[self.gridpoints]
        outer = self._sum(arms[:, :, None] * f[:, None, :])
        diagonal = np.arange(3)
        outer[:, diagonal, diagonal] -= self._sum(np.einsum("ni,ni->n", arms, f))[:, None]
        return _block_entries(self.unknown_groups()[0][:, 3:], -outer)

    def jacobian_entries(self, q: Array) -> tuple[Array, Array, Array]:
        """Entries of ``P``: rows 3 gp + axis, columns unknowns."""
        count = np.diff(self._start)
        arms = np.einsum("nij,nj->ni", np.repeat(self.rotation(q), count, axis=0), self._arms())
        rows = 3 * (self.gridpoints.start + np.arange(len(arms)))[:, None] + np.arange(3)
        base = np.repeat(self.unknown_groups()[0], count, axis=0)
        x, y, z = arms.T
        values = np.column_stack([np.ones((len(arms), 3)), z, -y, -z, x, y, -x])
        at, axis = [0, 1, 2, 0, 0, 1, 1, 2, 2], [0, 1, 2, 4, 5, 3, 5, 3, 4]
        return rows[:, at].ravel(), base[:, axis].ravel(), values.ravel()

    def _q(self, q: Array) -> Array:
        return q[self.coords].reshape(self.n_blocks, 7)

    def _v(self, v: Array) -> Array:
        return v[self.dofs].reshape(self.n_blocks, 6)

    def _arms(self) -> Array:
        return self._X - np.repeat(self._C, np.diff(self._start), axis=0)

    def _current_axes(self, q: Array) -> Array:
        return self.rotation(q) @ self.axes

    def _sum(self, per_gridpoint: Array) -> Array:
        """Sum over the gridpoints of each block (none is empty)."""
        total: Array = np.add.reduceat(per_gridpoint, self._start[:-1], axis=0)
        return total


def _block_entries(groups: Array, blocks: Array) -> tuple[Array, Array, Array]:
    """Entries of dense blocks (m, k, k) on groups (m, k) of unknowns."""
    k = groups.shape[1]
    return np.repeat(groups, k, axis=1).ravel(), np.tile(groups, (1, k)).ravel(), np.ascontiguousarray(blocks).ravel()


def _principal_axes(inertia: Array) -> tuple[Array, Array]:
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
