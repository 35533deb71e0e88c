"""ContactDynamics: Moreau-Jean time stepping with Signorini contact and the exact Coulomb cone."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdem.errors import ConvergenceError
from fdem.integrate.implicit import KEPT, _number
from fdem.integrate.impulses import Impulses
from fdem.integrate.matrices import Assembler

__all__ = ["ContactDynamics"]

Array = Any

DEEP = 1e-7  # of a block's size: penetration that is pushed out again
CLOSED = 1e-8  # of a block's size: gaps that count as closed, lest round-off of positions moves what is at rest


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
        Largest error of an impulse over the mean one, or of a velocity over the largest that there would be without
        contact.
    max_iterations : int, optional
        Newton iterations of a step before `ConvergenceError`.

    Attributes
    ----------
    iterations, sweeps : int
        Newton iterations of the last step, and sweeps of Gauss-Seidel where they needed help.
    residual : float
        Error of the last step, as for `tolerance`.
    penetration : float
        Largest in the middle of the last step [m].

    Raises
    ------
    SceneError
        If a value is out of range.

    Notes
    -----
    ``q_m = q0 + h (1 - theta) v0``; ``M (v1 - v0) = h f(q_m) + H^T r``; ``q1 = q_m + h theta v1`` (Jean, Comput.
    Methods Appl. Mech. Engrg. 177 (1999) 235); kn and ks are ignored. A gap g is closed within the step,
    ``0 <= u_n + g / (theta h)``; with restitution e a closed contact obeys ``0 <= u_n + e u_n0``. The friction cone is
    neither faceted nor made convex. All impulses r together are found by Newton's method on proximal problems, from
    those of the last step. What penetrates all the same, by the curvature of paths or in the step of an impact, is
    pushed out by a displacement that no velocity comes from.
    """

    dt: float
    theta: float = 0.5
    tolerance: float = 1e-6
    max_iterations: int = field(default=1000, kw_only=True)
    scaled: bool = field(default=False, init=False, repr=False)
    iterations: int = field(default=0, init=False, repr=False)
    sweeps: int = field(default=0, init=False, repr=False)
    residual: float = field(default=0.0, init=False, repr=False)
    penetration: float = field(default=0.0, init=False, repr=False)
    accepted: Any = field(default_factory=lambda: deque(maxlen=KEPT), init=False, repr=False)

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
        self._given = 0.0  # largest relative velocity without contact in the last step [m/s]
        self.solver = self._hard.solver(self.tolerance, int(self.max_iterations))
        system.stale = False

    def take_turns(self) -> list[Any]:
        """Rotation vectors since last asked, of the batches that turn."""
        return self._hard.take_turns()

    def refresh(self, system: Any) -> None:
        """Nothing hangs on the stable step."""
        system.stale = False

    def limit(self, system: Any) -> float:
        """No step is too long to be stable: infinite."""
        return math.inf

    def at_rest(self, share: float) -> bool:
        """Whether nothing moves faster than `share` of the largest relative velocity without contact of the last step.

        From rest one step shows it: what cannot stand has the velocity that its acceleration gives in the step.

        Parameters
        ----------
        share : float
            Part of that velocity.
        """
        return self._hard.largest_speed() <= share * self._given

    def kept(self) -> dict[str, Array]:
        """Arrays that influence the next step, for a saved state: what the last step found."""
        if self._points is None:
            return {}
        last = np.array([self.iterations, self._given])
        return self._hard.kept(self._points) | {"impulses": self._impulses, "last": last}

    def restore(self, arrays: dict[str, Array]) -> None:
        """Go on from what `kept` gave.

        Parameters
        ----------
        arrays : dict of arrays
            Empty if another integrator wrote the state.
        """
        if arrays:
            self._points, self._impulses = self._hard.restore(arrays), arrays["impulses"]
            self.iterations, self._given = int(arrays["last"][0]), float(arrays["last"][1])
            self.solver.iterations = self.iterations

    @property
    def notes(self) -> list[str]:
        """What a report says about the last step."""
        return [
            f"{self.iterations} iterations, {self.sweeps} sweeps, residual {self.residual:.2g}, "
            f"penetration {self.penetration:.2g} m in the last step"
        ]

    def step(self, system: Any, dt: float) -> None:
        """Advance by `dt` [s]; all is as before if that fails."""
        before = self._hard.snapshot()
        try:
            self._advance(system, dt)
        except ConvergenceError:
            self._hard.back_to(before)
            raise
        self.accepted.append((self.residual, dt * self._hard.largest_speed()))

    def _advance(self, system: Any, dt: float) -> None:
        h, theta, state = dt, self.theta, system.state
        hard = self._hard
        hard.commit_loads()
        hard.drift((1.0 - theta) * h)
        before = state.v.copy()
        mass = self.assembler.mass()
        f = hard.soft_forces(mass)
        mobility = hard.mobility(self.assembler, mass, h * theta)
        free = state.v + mobility.solve(h * f - h * h * (2.0 * theta - 1.0) * mobility.stiffness_times(state.v))
        hard.prescribe_velocity(free, h)
        points = hard.points()
        if points is None:
            self.iterations, self.sweeps, self.residual, self.penetration = 0, 0, 0.0, 0.0
            state.v[:], impulses, problem, self._given = free, np.zeros((0, 3)), None, 0.0
        else:
            self.penetration = -float(points.gap.min(initial=0.0))
            near = points.gap <= CLOSED * points.size
            points.gap[near] = np.minimum(points.gap[near], 0.0)
            points, problem = self._problem(points, mobility, free, h)
            impulses = self._solve(points, problem)
            # what bounces moves apart by itself
            deep = np.where(problem.bias < 0.0, 0.0, points.gap)
            if (deep < -DEEP * points.size).any():
                hard.push_out(problem, deep, points.size, f)
        self._points, self._impulses = points, impulses
        hard.keep(points, impulses, before, problem, f, h)
        hard.drift(theta * h)
        state.step += 1

    def _problem(self, points: Any, mobility: Any, free: Array, h: float) -> tuple[Any, Any]:
        """The contact problem, and its points: what bounces does so when it has closed, not before.

        What comes no faster than forces made it in two steps does not bounce: else nothing comes to rest.
        """
        hard, v = self._hard, self._hard.system.state.v
        problem = hard.problem(points, self.assembler, mobility, free, h)
        incoming, gained = problem.rows.times(v)[:, 0], problem.rows.times(free - v)[:, 0]
        bounce = (points.law[:, 3] > 0.0) & (incoming < -2.0 * np.abs(gained))
        early = bounce & (points.gap > 0.0)
        if early.any():
            return self._problem(points.take(~early), mobility, free, h)
        problem.bias[:] = np.maximum(points.gap, 0.0) / (self.theta * h)
        problem.bias[bounce] = points.law[bounce, 3] * incoming[bounce]
        return points, problem

    def _solve(self, points: Any, problem: Any) -> Array:
        """Impulses (n, 3) of the contact points; velocities are changed by them."""
        system = self._hard.system
        impulses, v, self.residual = self.solver.solve(problem, self._warm(points))
        self.iterations, self.sweeps = self.solver.iterations, self.solver.sweeps
        if not self.residual <= self.tolerance:
            raise ConvergenceError(
                f"step {system.state.step}: impulses are wrong by {self.residual:.2e} of the mean after "
                f"{self.iterations} iterations and {self.sweeps} sweeps, worst between "
                f"{self._hard.names(points, self.solver.worst)}; residuals: "
                f"{', '.join(f'{e:.1e}' for e in self.solver.history[-8:])}; "
                "a shorter step or a larger tolerance helps",
                self.solver.history,
            )
        system.state.v[:], self._given = v, problem.speed
        return impulses

    def _warm(self, points: Any) -> Array:
        """Impulses to start from: those of the last step at the same places."""
        impulses = np.zeros((len(points), 3))
        if self._points is not None:
            at = points.matched(self._points)
            known = at >= 0
            world = np.einsum("nij,ni->nj", self._points.frame[at[known]], self._impulses[at[known]])
            impulses[known] = np.einsum("nij,nj->ni", points.frame[known], world)
        return impulses
