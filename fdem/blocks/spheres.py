"""Rigid spheres: centres and nothing else; the inertia is a number (THEORY.md 1)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fdem.blocks import entries
from fdem.blocks.bounds import Springs, share
from fdem.errors import SceneError
from fdem.kernels import spheres as kernels

__all__ = ["SphereBlocks"]

Array = npt.NDArray[np.float64]


class SphereBlocks(entries.Stiff):
    """All spheres of a model, one batch of the `Blocks` protocol.

    The configuration of a sphere is its centre, the gridpoint it has; its velocity that of the centre and the angular
    velocity. No orientation is kept, for nothing depends on it.

    Parameters
    ----------
    centre : (n_blocks, 3) array
        Centres at the start [m].
    radius, mass : (n_blocks,) array
        [m], [kg].
    dofs, coords, gridpoints : slice
        The batch's share of ``v`` and ``f``, of ``q``, and of ``x``.

    Raises
    ------
    SceneError
        If a mass is not positive and finite.
    """

    label = "a sphere"
    has_internal = False
    in_place = False
    turns = True
    has_strain = False
    coupled = False
    oriented = False
    steady = True

    def __init__(
        self, centre: Array, radius: Array, mass: Array, dofs: slice, coords: slice, gridpoints: slice
    ) -> None:
        self.dofs, self.coords, self.gridpoints = dofs, coords, gridpoints
        self.n_blocks = len(mass)
        self.centre0 = np.array(centre, dtype=np.float64, order="C")
        self.radius, self.mass = np.array(radius, dtype=np.float64), np.array(mass, dtype=np.float64)
        bad = np.flatnonzero(~(np.isfinite(self.mass) & (self.mass > 0.0)))
        if len(bad):
            raise SceneError(f"sphere {bad[0]}: mass is {self.mass[bad[0]]}, it must be positive and finite")
        self.moment = 0.4 * self.mass * self.radius**2
        self._inverse = np.column_stack([1.0 / self.mass, 1.0 / self.moment])
        self._turn = np.zeros((self.n_blocks, 3))
        self.rows = np.arange(self.n_blocks)
        self.size = np.ones(self.n_blocks)
        self.free = np.ones(self.n_blocks, dtype=bool)

    def start(self, q: Array) -> None:
        """Write the centres at the start into ``q``."""
        self._q(q)[:] = self.centre0

    def launch(self, q: Array, x: Array, v: Array, velocity: Array, spin: Array) -> None:
        """Write velocities of the centres and angular velocities (n_blocks, 3) into ``v`` [m/s, rad/s]."""
        own = self._v(v)
        own[:, :3], own[:, 3:] = velocity, spin

    def place(self, q: Array, x: Array) -> None:
        """Write the centres into ``x`` [m]."""
        x[self.gridpoints] = self._q(q)

    def fit(self, row: int, q: Array, x: Array) -> None:
        """Take over one sphere whose centre another formulation has moved to `x` [m]."""
        self._q(q)[row] = x[self.gridpoints][row]

    def show(self, q: Array, x: Array) -> None:
        """Nothing: a centre is a material point."""

    def push(self, q: Array, v: Array, xdot: Array) -> None:
        """Write the velocities of the centres into ``xdot`` [m/s]."""
        xdot[self.gridpoints] = self._v(v)[:, :3]

    def pull(self, q: Array, f_gp: Array, f: Array) -> None:
        """Add the forces on the centres to ``f`` [N]; the transpose of `push`."""
        kernels.ball_pull(f_gp[self.gridpoints], self._v(f))

    def internal(self, q: Array, x: Array, f: Array) -> None:
        """Nothing: rigid blocks have no internal forces."""

    def weight(self, g: Array, f: Array) -> None:
        """Add ``m g`` to the forces ``f`` [N]; ``g`` is gravity [m/s^2]."""
        self._v(f)[:, :3] += self.mass[:, None] * g

    def accelerate(self, q: Array, f: Array, a: Array, scaled: Array | None = None) -> None:
        """Write the accelerations ``(F / m, T / I)`` into ``a`` [m/s^2, rad/s^2]; `scaled` as of `scaled_masses`."""
        kernels.ball_accelerate(self._v(f), self._inverse_of(scaled), self._v(a))

    def kick(self, q: Array, f: Array, v: Array, h: float, a: Array, scaled: Array | None = None) -> None:
        """Add the accelerations over `h` [s] to the velocities `v` in one pass."""
        kernels.ball_kick(self._v(f), self._inverse_of(scaled), h, self._v(v))

    def advance(self, q: Array, v: Array, dt: float, scaled: Array | None = None) -> None:
        """Move the centres by ``dt`` [s]; angular velocities are momenta and stay."""
        kernels.ball_advance(self._q(q), self._v(v), dt)

    def resist(self, q: Array, f: Array, v: Array, share: float, out: Array) -> None:
        """Write local damping into `out`: a share of the force against every unknown's velocity."""
        out[self.dofs] = share * np.abs(f[self.dofs]) * np.sign(v[self.dofs])

    def kinetic(self, q: Array, v: Array) -> float:
        """Kinetic energy ``(m v.v + I omega.omega) / 2`` of the batch [J]."""
        square = self._v(v) ** 2
        return 0.5 * float(self.mass @ square[:, :3].sum(axis=1) + self.moment @ square[:, 3:].sum(axis=1))

    def strain_energy(self, q: Array, x: Array) -> float:
        """Strain energy [J]: zero."""
        return 0.0

    def potential(self, g: Array, x: Array, q: Array) -> float:
        """Energy ``-sum m g.c`` in the gravity ``g`` [J]."""
        return -float(self.mass @ (self._q(q) @ np.asarray(g, dtype=np.float64)))

    def step_bound(self, q: Array, springs: Springs) -> Array:
        """Upper bound of the squared frequency (n_blocks,) of every sphere on all its contacts [1/s^2].

        That of translations plus that of rotations: the stiffness matrix has no eigenvalue above the sum of those of
        its two diagonal blocks.
        """
        bedding = springs.bedding[self.gridpoints] / self.mass
        if springs.particles is None:
            return bedding
        straight, turning = springs.particles.at_gridpoints(self.gridpoints)
        return bedding + _largest(straight) / self.mass + _largest(turning) / self.moment

    def scaled_masses(self, q: Array, springs: Springs, swing: float) -> Array:
        """Factors on mass and inertia for which the highest frequency is 1 rad per unit of time.

        A sphere that touches nothing yet gets the largest factor of the others: it falls slowly until it does.
        """
        bound = swing * self.step_bound(q, springs)
        largest = bound.max(initial=0.0)
        return np.where(bound > 0.0, bound, largest if largest > 0.0 else 1.0)

    def scaled_kinetic(self, q: Array, v: Array, scaled: Array) -> float:
        """``v.M v`` with the fictitious masses."""
        square = self._v(v) ** 2
        return float(scaled * self.mass @ square[:, :3].sum(axis=1) + scaled * self.moment @ square[:, 3:].sum(axis=1))

    def decay_bound(self, q: Array, c_gp: Array) -> float:
        """Largest decay rate [1/s] that dashpots `c_gp` (n_gp,) [N s/m] on gridpoints give a sphere."""
        return float((c_gp[self.gridpoints] / self.mass)[self.free].max(initial=0.0))

    def unbalance(
        self, q: Array, x: Array, unbalanced: Array, pushes: Array, gravity: float, scaled: Array | None
    ) -> float:
        """Largest unbalanced force, or moment over the radius, over the largest force acting on a sphere."""
        if not self.free.any():
            return 0.0
        six = self._v(unbalanced)
        left = np.maximum(np.linalg.norm(six[:, :3], axis=1), np.linalg.norm(six[:, 3:], axis=1) / self.radius)
        acting = np.maximum(pushes[self.gridpoints], self.mass * gravity)
        return share(float(left[self.free].max()), float(acting[self.free].max()))

    # readout

    def dofs_of(self, row: int) -> slice:
        """Unknowns of one sphere."""
        return slice(self.dofs.start + 6 * row, self.dofs.start + 6 * row + 6)

    def coords_of(self, row: int) -> slice:
        """Coordinates of one sphere in ``q``."""
        return slice(self.coords.start + 3 * row, self.coords.start + 3 * row + 3)

    def centres(self, q: Array, x: Array) -> Array:
        """Centres (n_blocks, 3) [m]."""
        return self._q(q).copy()

    def motion(self, q: Array, v: Array, x: Array) -> tuple[Array, Array]:
        """Velocities of the centres and angular velocities (n_blocks, 3)."""
        own = self._v(v)
        return own[:, :3].copy(), own[:, 3:].copy()

    def turn(self, q: Array, v: Array, dt: float) -> Array:
        """Rotation vectors (n_blocks, 3) [rad] of the step ``dt``."""
        kernels.ball_turn(self._v(v), dt, self._turn)
        return self._turn

    def rotation(self, q: Array, x: Array | None = None) -> Array:
        """Not a number, (n_blocks, 3, 3): no orientation is kept."""
        return np.full((self.n_blocks, 3, 3), np.nan)

    def inertia(self, q: Array, x: Array | None = None) -> Array:
        """Inertia about the centres, (n_blocks, 3, 3) [kg m^2]."""
        return self.moment[:, None, None] * np.eye(3)

    def angular_momentum(self, q: Array, v: Array, x: Array | None = None) -> Array:
        """Angular momentum about the centres, (n_blocks, 3) [kg m^2/s]."""
        momentum: Array = self.moment[:, None] * self._v(v)[:, 3:]
        return momentum

    def inverted(self, q: Array, x: Array) -> None:
        """None: a rigid block keeps its shape."""

    def theory(self, row: int, q: Array) -> None:
        """None: the unknowns are the theory's."""

    def mass_of(self, row: int, q: Array) -> Array:
        """Mass matrix (6, 6) of one sphere."""
        return np.diag(np.repeat([self.mass[row], self.moment[row]], 3))

    def generalised_displacement(self, row: int, q: Array, displacement: Array, moved: Array, turned: Array) -> Array:
        """The theory's u (6,): translation [m] and accumulated rotation [rad]."""
        return np.concatenate([moved, turned])

    def mass_entries(self, q: Array) -> entries.Entries:
        """Mass matrix, constant."""
        masses = np.concatenate(
            [np.repeat(self.mass[:, None], 3, axis=1), np.repeat(self.moment[:, None], 3, axis=1)], 1
        )
        own = np.arange(self.dofs.start, self.dofs.stop)
        return own, own, masses.ravel()

    def geometric(self, q: Array, f_gp: Array) -> entries.Entries:
        """Nothing: forces act at the centres."""
        return entries.nothing()

    def shift(self, q: Array, d: Array) -> None:
        """Move the centres by the translations in `d` (n_dofs,) [m]."""
        self._q(q)[:] += self._v(d)[:, :3]

    def gyroscopic(self, q: Array, v: Array, f: Array) -> None:
        """Nothing: angular velocity and momentum of a sphere are parallel."""

    def jacobian(self, q: Array) -> entries.Entries:
        """``P`` of `push`: rows 3 gp + axis of the model, columns its unknowns."""
        rows = 3 * self.gridpoints.start + np.arange(3 * self.n_blocks)
        return rows, self.groups()[:, :3].ravel(), np.ones(len(rows))

    def _inverse_of(self, scaled: Array | None) -> Array:
        return self._inverse if scaled is None else self._inverse / scaled[:, None]

    def _q(self, q: Array) -> Array:
        return q[self.coords].reshape(self.n_blocks, 3)

    def _v(self, v: Array) -> Array:
        return v[self.dofs].reshape(self.n_blocks, 6)


def _largest(matrices: Array) -> Array:
    """Largest eigenvalue (n,) of symmetric positive matrices (n, 3, 3)."""
    return np.asarray(np.linalg.eigvalsh(matrices)[:, -1]) if len(matrices) else np.zeros(0)
