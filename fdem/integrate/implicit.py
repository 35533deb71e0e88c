"""Implicit steps by Newton's method: Newmark and generalised-alpha (HHT's successor), DDA's among them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdem.errors import ConvergenceError, OverlapError, SceneError
from fdem.integrate.linear import LinearSolver
from fdem.integrate.matrices import Assembler
from fdem.integrate.trial import Trial

__all__ = ["GeneralizedAlpha", "Newmark"]

Array = Any

RECUTS = 4  # times the contacts may be found anew within a step
CLIMB = 2.0  # growth of the residual that a Newton step may bring before it is shortened
SHORTENINGS = 3  # of a Newton step, by half
HALVINGS = 10  # of the time step


def told(history: list[float]) -> str:
    """The last residuals, for messages."""
    return ", ".join(f"{r:.1e}" for r in history[-6:])


def _number(owner: str, name: str, value: Any, low: float, high: float = math.inf) -> None:
    known = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    if not known or not low <= value <= high or not math.isfinite(value):
        raise SceneError(f"{owner}: {name} = {value!r}, allowed is a finite number in [{low:g}, {high:g}]")


@dataclass
class Rule:
    """How displacement, velocity and acceleration at the end of a step hang together.

    ``v1 = v0 + h ((1 - gamma) a0 + gamma a1)``, ``d = h v0 + h^2 ((1/2 - beta) a0 + beta a1)``, and the equations hold
    for ``(1 - alpha_m) M a1 + alpha_m M a0 = (1 - alpha_f) f1 + alpha_f f0``.
    """

    beta: float
    gamma: float
    alpha_m: float = 0.0
    alpha_f: float = 0.0

    def rates(self, d: Array, v0: Array, a0: Array, h: float) -> tuple[Array, Array]:
        """Velocity and acceleration at the end of a step with the increment `d`."""
        a1 = (d - h * v0) / (self.beta * h * h) - (0.5 / self.beta - 1.0) * a0
        return v0 + h * ((1.0 - self.gamma) * a0 + self.gamma * a1), a1


@dataclass
class _Implicit:
    """Newton's method on the equations at the end of the step, shared by the implicit integrators."""

    dt: float
    tolerance: float = field(default=1e-8, kw_only=True)
    max_iterations: int = field(default=30, kw_only=True)
    solver: str = field(default="auto", kw_only=True)
    scaled: bool = field(default=False, init=False, repr=False)
    history: list[float] = field(default_factory=list, init=False, repr=False)
    iterations: int = field(default=0, init=False, repr=False)

    def __post_init__(self) -> None:
        owner = type(self).__name__
        _number(owner, "dt", self.dt, np.finfo(float).tiny)
        _number(owner, "tolerance", self.tolerance, 1e-15, 0.1)
        _number(owner, "max_iterations", self.max_iterations, 1)
        self.linear = LinearSolver(self.solver)
        self.rule = self._rule()

    def _rule(self) -> Rule:
        raise NotImplementedError

    def start(self, system: Any) -> None:
        """Prepare the matrices; velocities that lag half a step are brought to the time of the configuration."""
        if system.lag:
            system.state.v[:] = system.velocity()
            system.lag = 0.0
        self.assembler, self.trial = Assembler(system), Trial(system)
        self.step_length = self.dt
        self._a: Array | None = None
        system.stale = False

    def refresh(self, system: Any) -> None:
        """Nothing hangs on the stable step."""
        system.stale = False

    def limit(self, system: Any) -> float:
        """No step is too long to be stable: infinite."""
        return math.inf

    def step(self, system: Any, dt: float) -> None:
        """Advance by `dt` [s], in shorter steps where Newton's method does not converge."""
        left, h = dt, dt
        while left > 1e-9 * dt:
            h = min(h, left)
            if self._attempt(system, h):
                left -= h
                h *= 2.0
                continue
            h *= 0.5
            if h < dt * 0.5**HALVINGS:
                raise ConvergenceError(
                    f"step {system.state.step}, t = {system.state.t:.6g} s: no convergence in {self.max_iterations} "
                    f"iterations even with dt = {h:.3g} s; residuals {told(self.history)}; "
                    f"worst is {self.trial.worst_block()}"
                )
        system.state.step += 1

    def _attempt(self, system: Any, h: float) -> bool:
        """One step of `h` [s]; everything as before if it does not converge."""
        state, rule = system.state, self.rule
        trial = self.trial
        trial.mass = mass = self.assembler.mass()
        f0 = trial.all_forces()
        if self._a is None or len(self._a) != len(state.v):
            self._a = system.accelerate(f0).copy()
        a0, v0 = self._a, state.v.copy()
        system.commit()
        before = trial.snapshot()
        d = h * v0 + 0.5 * h * h * a0
        trial.prescribe_increment(d, h)
        converged = False
        try:
            trial.displace(before, d, h)
            converged = self._iterate(d, v0, a0, f0, mass, h)
        except OverlapError:
            if h < self.dt * 0.5 ** (HALVINGS - 1):
                raise
        if not converged:
            trial.back_to(before)
            return False
        v1, a1 = rule.rates(d, v0, a0, h)
        system.damped += trial.numerical_loss(d, v0, v1, a0, a1)
        state.v[:], self._a = v1, a1
        return True

    def _iterate(self, d: Array, v0: Array, a0: Array, f0: Array, mass: Any, h: float) -> bool:
        """Newton's method on the increment `d`, in place."""
        trial, rule, recuts, shortened, seen, last = self.trial, self.rule, 0, 0, set(), b""
        self.history = []
        change = None
        for iteration in range(self.max_iterations + 1):
            v1, a1 = rule.rates(d, v0, a0, h)
            r = self._residual(v1, a1, a0, f0, mass)
            ratio = trial.residual_ratio(r, a1)
            self.history.append(ratio)
            if not np.isfinite(ratio):
                return False
            if ratio <= self.tolerance:
                if recuts < RECUTS and trial.find_contacts():
                    recuts += 1
                    continue
                self.iterations = iteration
                return True
            if iteration == self.max_iterations:
                return False
            mark = trial.contact_state()
            circling = mark != last and mark in seen  # a set of open, closed and slipping points that comes back
            seen.add(mark)
            last = mark
            if change is not None and shortened < SHORTENINGS and (circling or ratio > CLIMB * self.history[-2]):
                change = 0.5 * change
                trial.displace_further(-change)
                d -= change
                shortened += 1
                continue
            shortened = 0
            cm = (1.0 - rule.alpha_m) / (rule.beta * h * h * (1.0 - rule.alpha_f))
            A = self.assembler.effective(mass, cm, rule.gamma / (rule.beta * h), h)
            change = self.linear.solve(A, r / (1.0 - rule.alpha_f), self.assembler.groups, None, False)
            trial.displace_further(change)
            d += change
        return False

    def _residual(self, v1: Array, a1: Array, a0: Array, f0: Array, mass: Any) -> Array:
        rule = self.rule
        self.trial.state.v[:] = v1
        r = (1.0 - rule.alpha_f) * self.trial.all_forces() + rule.alpha_f * f0
        r -= mass @ ((1.0 - rule.alpha_m) * a1 + rule.alpha_m * a0)
        self.trial.constraints.release(r)
        return r


@dataclass
class Newmark(_Implicit):
    """Newmark's implicit step: the equations hold at the end of the step.

    Parameters
    ----------
    dt : float
        Time step [s]; halved where Newton's method does not converge.
    beta, gamma : float, optional
        1/4, 1/2: constant average acceleration, no numerical damping, second order. 1/2, 1: the acceleration of the
        end of the step (DDA), first order and dissipative.
    tolerance : float, optional
        Largest unbalanced force over the largest force acting.
    max_iterations : int, optional
        Newton iterations before the step is halved.
    solver : str, optional
        "auto", "direct", "cg" or "amg".

    Raises
    ------
    SceneError
        If a value is out of range: unconditional stability asks for ``2 beta >= gamma >= 1/2``.

    Notes
    -----
    Newmark, A method of computation for structural dynamics, J. Eng. Mech. Div. ASCE 85 (1959) 67.
    """

    beta: float = 0.25
    gamma: float = 0.5

    def __post_init__(self) -> None:
        _number("Newmark", "gamma", self.gamma, 0.5, 1.0)
        _number("Newmark", "beta", self.beta, 0.5 * self.gamma, 1.0)
        super().__post_init__()

    def _rule(self) -> Rule:
        return Rule(self.beta, self.gamma)


@dataclass
class GeneralizedAlpha(_Implicit):
    """Generalised-alpha step: second order, with numerical damping of high frequencies only.

    Parameters
    ----------
    dt : float
        Time step [s]; halved where Newton's method does not converge.
    rho : float, optional
        Spectral radius at infinite frequency, 1 (no damping) to 0 (gone in one step).
    tolerance, max_iterations, solver
        As for `Newmark`.

    Raises
    ------
    SceneError
        If a value is out of range.

    Notes
    -----
    Chung and Hulbert, A time integration algorithm for structural dynamics with improved numerical dissipation,
    J. Appl. Mech. 60 (1993) 371: ``alpha_m = (2 rho - 1)/(rho + 1)``, ``alpha_f = rho/(rho + 1)``.
    """

    rho: float = 0.8

    def __post_init__(self) -> None:
        _number("GeneralizedAlpha", "rho", self.rho, 0.0, 1.0)
        super().__post_init__()

    def _rule(self) -> Rule:
        alpha_m, alpha_f = (2.0 * self.rho - 1.0) / (self.rho + 1.0), self.rho / (self.rho + 1.0)
        return Rule(0.25 * (1.0 - alpha_m + alpha_f) ** 2, 0.5 - alpha_m + alpha_f, alpha_m, alpha_f)
