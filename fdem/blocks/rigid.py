"""Rigid blocks: centroid and unit quaternion, any polyhedron or clump (THEORY.md 1, NUMERICS.md 8)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fdem.blocks import entries
from fdem.blocks.bounds import Springs, joint_stiffness, share
from fdem.blocks.masses import principal_axes
from fdem.errors import SceneError
from fdem.kernels import blocks as kernels

__all__ = ["RigidBlocks"]

Array = npt.NDArray[np.float64]


class RigidBlocks(entries.Stiff):
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
    has_internal, in_place, turns, has_strain : bool
        See `Blocks`: rigid blocks have no internal forces, and their unknowns are not positions of gridpoints.
    centre0 : (n_blocks, 3) array
        Centroids at the start [m].
    rows, size, free : (n_blocks,) arrays
        Row in the model, size [m] and whether a block can move; set by compile.

    Raises
    ------
    SceneError
        If a mass or a principal moment of inertia is not positive and finite.
    """

    label = "rigid"
    has_internal = False
    in_place = False
    turns = True
    coupled = False
    has_strain = False
    steady = False

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
        self.moments, self.axes = principal_axes(np.asarray(inertia, dtype=np.float64))
        for name, positive in (("mass", self.mass), ("inertia", self.moments.min(axis=1, initial=np.inf))):
            bad = np.flatnonzero(~(np.isfinite(positive) & (positive > 0.0)))
            if len(bad):
                raise SceneError(f"rigid block {bad[0]}: {name} is {positive[bad[0]]}, it must be positive and finite")
        self._X = np.array(X[gridpoints], dtype=np.float64, order="C")
        self.centre0 = np.array(centroid, dtype=np.float64, order="C")
        self._start = np.ascontiguousarray(np.asarray(gp_start) - gridpoints.start, dtype=np.int32)
        self._unscaled = np.ones(self.n_blocks)
        self.rows = np.arange(self.n_blocks)
        self.size = np.ones(self.n_blocks)
        self.free = np.ones(self.n_blocks, dtype=bool)

    def start(self, q: Array) -> None:
        """Write the configuration at the start into ``q``: reference centroids, no rotation."""
        own = self._q(q)
        own[:, :3] = self.centre0
        own[:, 3:] = (1.0, 0.0, 0.0, 0.0)

    def launch(self, q: Array, x: Array, v: Array, velocity: Array, spin: Array) -> None:
        """Write velocities of the centroids and angular velocities (n_blocks, 3) into ``v`` [m/s, rad/s]."""
        own = self._v(v)
        own[:, :3], own[:, 3:] = velocity, spin

    def place(self, q: Array, x: Array) -> None:
        """Write the positions ``X + (c - C) + (R - 1)(X - C)`` of the batch's gridpoints into ``x`` [m]."""
        kernels.rigid_place(self._q(q), self._X, self.centre0, self._start, x[self.gridpoints])

    def show(self, q: Array, x: Array) -> None:
        """Nothing: gridpoints are material points."""

    def fit(self, row: int, q: Array, x: Array) -> None:
        """Give one block the rotation and place nearest to the gridpoint positions `x` [m], and place these there."""
        own = slice(*self._start[row : row + 2])
        before, after = self._X[own], x[self.gridpoints][own]
        first, last = before.mean(axis=0), after.mean(axis=0)
        left, _, right = np.linalg.svd((after - last).T @ (before - first))
        left[:, 2] *= np.sign(np.linalg.det(left @ right))
        turn = left @ right
        self._q(q)[row, :3] = last + turn @ (self.centre0[row] - first)
        # the quaternion is the eigenvector of 4 q q^T - 1
        outer = np.empty((4, 4))
        outer[0, 0] = np.trace(turn)
        outer[0, 1:] = outer[1:, 0] = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
        outer[1:, 1:] = turn + turn.T - np.trace(turn) * np.eye(3)
        self._q(q)[row, 3:] = np.linalg.eigh(outer)[1][:, 3]
        self.place(q, x)

    def push(self, q: Array, v: Array, xdot: Array) -> None:
        """Write the gridpoint velocities ``v + omega x r`` into ``xdot`` [m/s]."""
        kernels.rigid_push(self._q(q), self._v(v), self._X, self.centre0, self._start, xdot[self.gridpoints])

    def pull(self, q: Array, f_gp: Array, f: Array) -> None:
        """Add force and moment about the centroid to ``f`` [N, N m]; the transpose of `push`."""
        kernels.rigid_pull(self._q(q), f_gp[self.gridpoints], self._X, self.centre0, self._start, self._v(f))

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

    def advance(self, q: Array, v: Array, dt: float, scaled: Array | None = None) -> None:
        """Move by ``dt`` [s] at fixed momentum, in place.

        Parameters
        ----------
        q : (n_q,) array
            In, out: configuration [m, -].
        v : (n_dofs,) array
            In, out: velocities; the angular velocity changes so that ``I(R) omega`` does not [m/s, rad/s].
        dt : float
            Step [s].
        scaled : array, optional
            Fictitious masses; they make no difference.

        Notes
        -----
        Implicit midpoint rule in principal axes with moments of inertia corrected to fourth order, solved to round-off
        (NUMERICS.md 8; Hairer & Vilmart, J. Phys. A 39 (2006) 13225). Energy and angular momentum are exact to
        round-off for any step; a block that does not rotate keeps its orientation to the last bit.
        """
        kernels.rigid_advance(self._q(q), self._v(v), dt, self.moments, self.axes)

    def resist(self, q: Array, f: Array, v: Array, share: float, out: Array) -> None:
        """Write local damping into `out`: a share of the force against every unknown's velocity."""
        out[self.dofs] = share * np.abs(f[self.dofs]) * np.sign(v[self.dofs])

    def kinetic(self, q: Array, v: Array) -> float:
        """Kinetic energy ``(m v.v + omega.I omega) / 2`` of the batch [J]."""
        own = self._v(v)
        spin = np.einsum("nji,nj->ni", self._current_axes(q), own[:, 3:])
        return 0.5 * float(np.sum(self.mass[:, None] * own[:, :3] ** 2) + np.sum(self.moments * spin**2))

    def internal(self, q: Array, x: Array, f: Array) -> None:
        """Nothing: rigid blocks have no internal forces."""

    def strain_energy(self, q: Array, x: Array) -> float:
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
        if springs.contacts is None and springs.particles is None:
            return springs.k_gp, None
        place = np.full(len(springs.mobile), -1)
        place[self.rows] = np.arange(self.n_blocks)
        centre = self._q(q)[:, :3]
        if springs.contacts is None:
            return springs.bedding, springs.particles.on_blocks(place, centre)
        joints = joint_stiffness(springs.rows, springs.x, springs.gp_block, springs.mobile, place, centre)
        if springs.particles is not None:
            joints += springs.particles.on_blocks(place, centre)
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

    def decay_bound(self, q: Array, c_gp: Array) -> float:
        """Largest decay rate [1/s] that dashpots `c_gp` (n_gp,) [N s/m] on gridpoints give a block."""
        # M^-1 P^T c P has the form of the stiffness
        return float(self.frequency_bound(q, self._X, c_gp)[self.free].max(initial=0.0))

    def unbalance(
        self, q: Array, x: Array, unbalanced: Array, pushes: Array, gravity: float, scaled: Array | None
    ) -> float:
        """Largest unbalanced force, or moment over the block size, over the largest force acting on a block.

        Parameters
        ----------
        q, x : (n_q,), (n_gp, 3) array
            Configuration and positions; not needed.
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

    def dofs_of(self, row: int) -> slice:
        """Unknowns of one block."""
        return slice(self.dofs.start + 6 * row, self.dofs.start + 6 * row + 6)

    def coords_of(self, row: int) -> slice:
        """Coordinates of one block in ``q``."""
        return slice(self.coords.start + 7 * row, self.coords.start + 7 * row + 7)

    def centres(self, q: Array, x: Array) -> Array:
        """Centroids (n_blocks, 3) [m]."""
        return self._q(q)[:, :3].copy()

    def motion(self, q: Array, v: Array, x: Array) -> tuple[Array, Array]:
        """Velocities of the centroids and angular velocities (n_blocks, 3)."""
        own = self._v(v)
        return own[:, :3].copy(), own[:, 3:].copy()

    def turn(self, q: Array, v: Array, dt: float) -> Array:
        """Rotation vectors (n_blocks, 3) [rad] of the step ``dt``."""
        return dt * self._v(v)[:, 3:]

    def inverted(self, q: Array, x: Array) -> None:
        """None: a rigid block keeps its shape."""

    def theory(self, row: int, q: Array) -> None:
        """None: the unknowns are the theory's."""

    def mass_of(self, row: int, q: Array) -> Array:
        """Mass matrix (6, 6) of one block."""
        return np.asarray(self.generalised_mass(q)[row])

    def generalised_displacement(self, row: int, q: Array, displacement: Array, moved: Array, turned: Array) -> Array:
        """The theory's u (6,): translation [m] and accumulated rotation [rad]."""
        return np.concatenate([moved, turned])

    def rotation(self, q: Array, x: Array | None = None) -> Array:
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

    def inertia(self, q: Array, x: Array | None = None) -> Array:
        """Inertia about the centroid in global axes now, (n_blocks, 3, 3) [kg m^2]."""
        axes = self._current_axes(q)
        inertia: Array = np.einsum("nij,nj,nkj->nik", axes, self.moments, axes)
        return inertia

    def angular_momentum(self, q: Array, v: Array, x: Array | None = None) -> Array:
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

    def mass_entries(self, q: Array) -> entries.Entries:
        """Mass matrix at the configuration `q`."""
        return entries.of_blocks(self.dofs.start + 6 * np.arange(self.n_blocks), self.generalised_mass(q))

    def geometric(self, q: Array, f_gp: Array) -> entries.Entries:
        """``(dP^T/dq) f_gp``: moments about the centroid change as arms turn, ``sum [f]x [r]x`` by rotation.

        Of gridpoint forces `f_gp` (n_gp, 3) [N] at the configuration `q`.
        """
        arm = self._turned(q)
        force = f_gp[self.gridpoints]
        # [f]x [r]x = r f^T - (f.r) 1
        turned = arm[:, :, None] * force[:, None, :] - np.sum(arm * force, axis=1)[:, None, None] * np.eye(3)
        return entries.of_blocks(self.dofs.start + 6 * np.arange(self.n_blocks) + 3, self._sum(turned))

    def shift(self, q: Array, d: Array) -> None:
        """Move `q` by the translations and rotation vectors in `d` (n_dofs,) [m, rad]."""
        entries.turn(self._q(q), self._v(d))

    def gyroscopic(self, q: Array, v: Array, f: Array) -> None:
        """Subtract ``omega x I omega`` from the moments `f` [N m]."""
        spin = self._v(v)[:, 3:]
        self._v(f)[:, 3:] -= np.cross(spin, np.einsum("nij,nj->ni", self.inertia(q), spin))

    def jacobian(self, q: Array) -> entries.Entries:
        """``P(q)`` of `push`: rows 3 gp + axis of the model, columns its unknowns."""
        return entries.of_arms(self.gridpoints.start, self._turned(q), self.groups(), np.diff(self._start))

    def _q(self, q: Array) -> Array:
        return q[self.coords].reshape(self.n_blocks, 7)

    def _v(self, v: Array) -> Array:
        return v[self.dofs].reshape(self.n_blocks, 6)

    def _arms(self) -> Array:
        return self._X - np.repeat(self.centre0, np.diff(self._start), axis=0)

    def _turned(self, q: Array) -> Array:
        """Arms of the gridpoints (n, 3) [m] from the centroids now."""
        return np.einsum("nij,nj->ni", np.repeat(self.rotation(q), np.diff(self._start), axis=0), self._arms())

    def _current_axes(self, q: Array) -> Array:
        return self.rotation(q) @ self.axes

    def _sum(self, per_gridpoint: Array) -> Array:
        """Sum over the gridpoints of each block (none is empty)."""
        total: Array = np.add.reduceat(per_gridpoint, self._start[:-1], axis=0)
        return total
