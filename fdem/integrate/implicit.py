"""Implicit steps by Newton's method: Newmark and generalised-alpha (HHT's successor), DDA's among them."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdem.errors import ConvergenceError, OverlapError, SceneError
from fdem.integrate.linear import LinearSolver
from fdem.integrate.trial import Trial

__all__ = ["GeneralizedAlpha", "Newmark"]

Array = Any

NEAR = 1e-3  # of the smallest block's size: longest motion of the guess, so that what touches is still there
FAR = 0.25  # of that size: longest motion in a Newton step
STALLED = 0.3  # of the best residual so far: a residual that falls less than that has come to round-off
RECUTS = 4  # times the contacts may be found anew within a step
GAIN = 0.3  # of the residual: while an iteration leaves less, the matrix of the step is good enough
CLIMB = 2.0  # growth of the residual that a Newton step may bring before it is shortened
SHORTENINGS = 3  # of a Newton step, by half
SMALLEST = 0.125  # share of Newton's steps taken where sets of contacts go round in circles
HALVINGS = 10  # of the time step
KEPT = 100_000  # accepted steps whose residuals are kept for the report


def told(history: list[float]) -> str:
    """The last residuals, for messages."""
    return ", ".join(f"{r:.1e}" for r in history[-6:])


def settled(history: list[float], tolerance: float, floor: float) -> bool:
    """Whether the last residual is small enough: as asked for, or at round-off `floor` and no longer falling."""
    return history[-1] <= tolerance or (history[-1] <= floor and history[-1] > STALLED * min(history[:-1]))


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
class _Start:
    """What a step starts from: velocity, acceleration, forces of all kinds and inertia, and the step [s]."""

    v: Array
    a: Array
    plain: Array
    all: Array
    inertia: Array
    h: float


@dataclass
class _Implicit(ABC):
    """Newton's method on the equations at the end of the step, shared by the implicit integrators."""

    dt: float
    tolerance: float = field(default=1e-8, kw_only=True)
    max_iterations: int = field(default=30, kw_only=True)
    solver: str = field(default="auto", kw_only=True)
    scaled: bool = field(default=False, init=False, repr=False)
    implicit: bool = field(default=True, init=False, repr=False)
    history: list[float] = field(default_factory=list, init=False, repr=False)
    iterations: int = field(default=0, init=False, repr=False)
    accepted: Any = field(default_factory=lambda: deque(maxlen=KEPT), init=False, repr=False)

    def __post_init__(self) -> None:
        owner = type(self).__name__
        _number(owner, "dt", self.dt, np.finfo(float).tiny)
        _number(owner, "tolerance", self.tolerance, 1e-15, 0.1)
        _number(owner, "max_iterations", self.max_iterations, 1)
        self.linear = LinearSolver(self.solver)
        self.rule = self._rule()

    @abstractmethod
    def _rule(self) -> Rule:
        """Coefficients of the rule."""

    def start(self, system: Any) -> None:
        """Prepare the matrices; velocities that lag half a step are brought to the time of the configuration."""
        if system.lag:
            system.state.v[:] = system.velocity()
            system.lag = 0.0
            system.a_old = None
        self.trial = Trial(system)
        self.step_length = self.dt
        self._h = self.dt
        system.stale = False

    def take_turns(self) -> list[Any]:
        """Rotation vectors since last asked, of the batches that turn."""
        return self.trial.take_turns()

    def refresh(self, system: Any) -> None:
        """Nothing hangs on the stable step."""
        system.stale = False

    def limit(self, system: Any) -> float:
        """No step is too long to be stable: infinite."""
        return math.inf

    def step(self, system: Any, dt: float) -> None:
        """Advance by `dt` [s], in shorter steps where Newton's method does not converge."""
        left = dt
        while left > 1e-9 * dt:
            h = min(self._h, left)
            done = self._attempt(system, h, last=h <= 2.0 * dt * 0.5**HALVINGS)
            if done:
                left -= h
                self._h = min(2.0 * self._h, self.dt) if h == self._h else self._h
                continue
            self._h = 0.5 * h
            if self._h < dt * 0.5**HALVINGS:
                raise ConvergenceError(
                    f"step {system.state.step}, t = {system.state.t:.6g} s: no convergence in {self.max_iterations} "
                    f"iterations even with dt = {h:.3g} s; residuals {told(self.history)}; {self._culprit}",
                    self.history,
                )
        system.state.step += 1

    def _attempt(self, system: Any, h: float, last: bool) -> bool:
        """One step of `h` [s]; everything as before if it does not converge."""
        state, trial = system.state, self.trial
        start = self._begin(system, h)
        d = h * start.v + 0.5 * h * h * start.a
        d *= min(1.0, NEAR / max(trial.relative_motion(d), NEAR))
        trial.prescribe(d, h)
        converged = False
        try:
            trial.displace(d, h)
            converged = self._iterate(start)
        except OverlapError:
            if last:
                raise
            self._culprit = "blocks overlap too deep"
        if not converged:
            trial.back()
            return False
        v1, system.a_old = self._rates(start)
        before = self._kinetic
        state.v[:] = v1
        plain = trial.plain_forces()
        system.damped += 0.5 * trial.work_on_free(start.plain + plain) - (trial.kinetic() - before)
        self.accepted.append((self.history[-1], trial.accept()))
        return True

    def _begin(self, system: Any, h: float) -> _Start:
        """Accept where the last step ended."""
        trial = self.trial
        plain = system.forces().copy()
        trial.begin()
        forces = trial.all_forces(plain)
        if system.a_old is None:
            system.a_old = system.accelerate(forces).copy()
        self._kinetic = trial.kinetic()
        a = system.a_old
        return _Start(system.state.v.copy(), a, plain, forces, trial.assembler.mass() @ a, h)

    def _rates(self, start: _Start) -> tuple[Array, Array]:
        """Velocity and acceleration of the trial; prescribed ones as prescribed, not as the rule would have them."""
        trial, h = self.trial, start.h
        v, a = self.rule.rates(trial.d, start.v, start.a, h)
        if trial.constraints.moving:
            trial.constraints.keep(v, trial.end_velocity(trial.d, h))
            trial.constraints.keep(a, (v - start.v) / h)
        return v, a

    def _residual(self, start: _Start) -> tuple[Array, Array]:
        """Unbalanced forces of the trial, and its acceleration."""
        rule, trial = self.rule, self.trial
        trial.state.v[:], a = self._rates(start)
        r = (1.0 - rule.alpha_f) * trial.all_forces(trial.plain_forces()) + rule.alpha_f * start.all
        r -= (1.0 - rule.alpha_m) * (trial.assembler.mass() @ a) + rule.alpha_m * start.inertia
        return trial.released(r), a

    def _change(self, r: Array, cm: float, h: float, gain: float, again: Any) -> tuple[Array, Any]:
        """Correction for the residual `r`, and what solves with its matrix once more; by `again` if there is one."""
        if again is not None:
            return again(r), again
        rule, assembler = self.rule, self.trial.assembler
        A = assembler.effective(cm, rule.gamma / (rule.beta * h), h)
        return self.linear.solve(A, r, assembler, gain), self.linear.again

    def _iterate(self, start: _Start) -> bool:
        """Newton's method on the increment of the trial."""
        rule, trial, h = self.rule, self.trial, start.h
        cm = (1.0 - rule.alpha_m) / (rule.beta * h * h * (1.0 - rule.alpha_f))
        recuts, share, floor, last = 0, 1.0, 0.0, b""
        seen: dict[bytes, float] = {}  # best residual with every set of open, closed and slipping points
        self.history = []
        again: Any = None  # solves with the last matrix of this step, while that gains enough
        r, a = self._residual(start)
        for iteration in range(self.max_iterations + 1):
            ratio = trial.residual_ratio(r, a)
            self.history.append(ratio)
            if settled(self.history, self.tolerance, floor):
                if recuts == RECUTS or not trial.find_contacts():
                    self.iterations = iteration
                    trial.refuse_leaps()
                    return True
                recuts += 1
                r, a = self._residual(start)
                continue
            mark = trial.contact_state()
            # a set that comes back without gain: Newton's method goes round in circles
            circling = mark != last and ratio > 0.5 * seen.get(mark, math.inf)
            share = max(0.5 * share, SMALLEST) if circling else min(2.0 * share, 1.0)
            seen[mark], last = min(ratio, seen.get(mark, math.inf)), mark
            if iteration == self.max_iterations or not math.isfinite(ratio):
                break
            if iteration and not ratio < GAIN * self.history[-2]:
                again = None
            try:
                change, again = self._change(r / (1.0 - rule.alpha_f), cm, h, self.tolerance / ratio, again)
            except ConvergenceError:
                break
            floor = trial.round_off(r, ratio)
            change *= min(share, FAR / max(trial.relative_motion(change), FAR))
            trial.displace_further(change)
            r, a = self._residual(start)
            for _ in range(SHORTENINGS):
                if trial.residual_ratio(r, a) <= CLIMB * ratio:
                    break
                change *= 0.5
                trial.displace_further(-change)
                r, a = self._residual(start)
        self._culprit = trial.worst(r)
        return False


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
        "auto", "direct", "cg", "amg", "cholmod" or "pardiso"; `describe` tells what was chosen and used.

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
