"""ContactDynamics: Moreau-Jean time stepping with Signorini contact and the exact Coulomb cone."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdem.errors import ConvergenceError
from fdem.integrate.implicit import _number
from fdem.integrate.impulses import Impulses
from fdem.integrate.matrices import Assembler

__all__ = ["ContactDynamics"]

Array = Any


@dataclass
class ContactDynamics:
    """Moreau-Jean step: velocities jump so that hard contacts neither overlap nor pull, and friction stays in its cone.

    Parameters
    ----------
    dt : float
        Time step [s].
    theta : float, optional
        1/2: no numerical damping of smooth motion; 1: implicit Euler.
    tolerance : float, optional
        Largest change of an impulse in the last sweep over the mean normal impulse.
    max_iterations : int, optional
        Sweeps before `ConvergenceError`.

    Raises
    ------
    SceneError
        If a value is out of range.

    Notes
    -----
    ``q_m = q0 + h (1 - theta) v0``; ``M (v1 - v0) = h f(q_m) + H^T r``; ``q1 = q_m + h theta v1``; the impulses r by
    Gauss-Seidel from those of the last step (Jean, Comput. Methods Appl. Mech. Engrg. 177 (1999) 235). A gap g is
    closed within the step, ``0 <= u_n + g / (theta h)``; with restitution e a closed contact obeys
    ``0 <= u_n + e u_n0``. The friction cone is neither faceted nor made convex.
    """

    dt: float
    theta: float = 0.5
    tolerance: float = 1e-6
    max_iterations: int = field(default=100_000, kw_only=True)
    scaled: bool = field(default=False, init=False, repr=False)
    iterations: int = field(default=0, init=False, repr=False)
    residual: float = field(default=0.0, init=False, repr=False)

    def __post_init__(self) -> None:
        _number("ContactDynamics", "dt", self.dt, np.finfo(float).tiny)
        _number("ContactDynamics", "theta", self.theta, 0.5, 1.0)
        _number("ContactDynamics", "tolerance", self.tolerance, 1e-14, 0.1)
        _number("ContactDynamics", "max_iterations", self.max_iterations, 1)

    def start(self, system: Any) -> None:
        """Leave the penalty contacts out of the forces."""
        if system.lag:
            system.state.v[:] = system.velocity()
            system.lag = 0.0
        self._hard = Impulses(system)
        self.assembler = Assembler(system)
        self.step_length = self.dt
        self._points: Any = None
        self._impulses = np.zeros((0, 3))
        system.stale = False

    def refresh(self, system: Any) -> None:
        """Nothing hangs on the stable step."""
        system.stale = False

    def limit(self, system: Any) -> float:
        """No step is too long to be stable: infinite."""
        return math.inf

    def step(self, system: Any, dt: float) -> None:
        """Advance by `dt` [s]."""
        h, theta, state = dt, self.theta, system.state
        hard = self._hard
        hard.commit_loads()
        before = state.v.copy()
        hard.drift((1.0 - theta) * h)
        mass = self.assembler.mass()
        f = hard.soft_forces(mass)
        mobility = hard.mobility(self.assembler, mass, h * theta)
        free = state.v + mobility.solve(h * f - h * h * (2.0 * theta - 1.0) * mobility.stiffness_times(state.v))
        hard.prescribe_velocity(free, h)
        points = hard.points()
        if points is None or not len(points):
            self.iterations, self.residual, rows = 0, 0.0, None
            state.v[:], impulses = free, np.zeros((0, 3))
        else:
            rows = hard.velocity_rows(points, self.assembler)
            impulses = self._contacts(system, points, mobility, rows, free, h)
        self._points, self._impulses = points, impulses
        hard.keep(points, impulses, before, rows, h)
        hard.drift(theta * h)
        state.step += 1

    def _contacts(self, system: Any, points: Any, mobility: Any, rows: Any, free: Array, h: float) -> Array:
        """Impulses (n, 3) of the contact points; velocities are changed by them."""
        J, B, full = mobility.rows(rows, len(points))
        n = len(points)
        incoming = (rows @ system.state.v).reshape(n, 3)[:, 0]
        bias = np.maximum(points.gap, 0.0) / (self.theta * h)
        bounce = points.restitution > 0.0
        closed = points.gap <= 0.0
        bias[bounce & closed] = points.restitution[bounce & closed] * np.minimum(incoming[bounce & closed], 0.0)
        bias[bounce & ~closed] = 1e300
        impulses = self._warm(points, bounce & ~closed)
        v = free + full @ impulses.ravel()
        W = mobility.delassus(J, B, n)
        self.iterations, self.residual = self._hard.solve(
            J, B, W, bias, points, h, v, impulses, self.tolerance, int(self.max_iterations)
        )
        if self.residual > self.tolerance or not np.isfinite(impulses).all():
            raise ConvergenceError(
                f"step {system.state.step}: contact impulses still change by {self.residual:.2e} of the mean after "
                f"{self.iterations} sweeps; a shorter step or a larger tolerance helps"
            )
        system.state.v[:] = free + full @ impulses.ravel()
        return impulses

    def _warm(self, points: Any, idle: Array) -> Array:
        """Impulses to start from: those of the last step at the same places."""
        impulses = np.zeros((len(points), 3))
        if self._points is not None and len(self._points) and len(self._impulses):
            at = points.matched(self._points, self._hard.pair_sizes())
            known = at >= 0
            world = np.einsum("nij,ni->nj", self._points.frame[at[known]], self._impulses[at[known]])
            impulses[known] = np.einsum("nij,nj->ni", points.frame[known], world)
        impulses[idle] = 0.0
        return impulses
