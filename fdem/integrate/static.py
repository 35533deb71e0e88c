"""Static: Newton's method on 0 = f(u), load step by load step."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdem.errors import ConvergenceError, OverlapError
from fdem.integrate.implicit import KEPT, RECUTS, _number, settled, told
from fdem.integrate.linear import LinearSolver
from fdem.integrate.trial import Trial

__all__ = ["Static"]

Array = Any

TRUST = 1.0  # first pseudo-time step: joints resist as if they were closed and held
LOOSE = 1e-6  # part of a block's stiffness on all its joints that holds what no joint holds
MOST_TRUST = 1e12  # what nothing holds is held by so little of the joints' stiffness in the end
GROWTH = 4.0  # of the pseudo-time step after an iteration that brought the residual down
MOTION = 1e-2  # of the smallest block's size: longest motion in an iteration, so that contacts are not jumped over
CLIMB = 2.0  # growth of the residual that an iteration may bring before it is shortened
SHORTENINGS = 4
HALVINGS = 6  # of the load step


@dataclass
class Static:
    """Quasi-static equilibrium: Newton's method on ``0 = f(u)``, inertia left out.

    Parameters
    ----------
    tolerance : float, optional
        Largest unbalanced force over the largest force acting.
    steps : int, optional
        Load steps: the unbalanced force is brought in by so many equal parts. Friction depends on the path.
    max_iterations : int, optional
        Iterations of a load step before it is halved.
    solver : str, optional
        "auto", "direct", "cg", "amg", "cholmod" or "pardiso"; `describe` tells what was chosen and used.

    Raises
    ------
    SceneError
        If a value is out of range.

    Notes
    -----
    A step of the iteration is that of an implicit Euler step in fictitious time, whose length grows as the residual
    falls (pseudo-transient continuation, Kelley and Keyes, SIAM J. Numer. Anal. 35 (1998) 508): far from equilibrium,
    where contacts open and close and blocks may be loose, it goes down the forces; near it, it is Newton's.
    """

    tolerance: float = 1e-8
    steps: int = field(default=1, kw_only=True)
    max_iterations: int = field(default=60, kw_only=True)
    solver: str = field(default="auto", kw_only=True)
    scaled: bool = field(default=True, init=False, repr=False)  # velocities mean nothing
    static: bool = field(default=True, init=False, repr=False)
    implicit: bool = field(default=True, init=False, repr=False)
    history: list[float] = field(default_factory=list, init=False, repr=False)
    iterations: int = field(default=0, init=False, repr=False)
    accepted: Any = field(default_factory=lambda: deque(maxlen=KEPT), init=False, repr=False)
    notes: list[str] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        _number("Static", "tolerance", self.tolerance, 1e-15, 0.1)
        _number("Static", "steps", self.steps, 1)
        _number("Static", "max_iterations", self.max_iterations, 1)
        self.linear = LinearSolver(self.solver)

    def start(self, system: Any) -> None:
        """Prepare the matrices; refuse blocks that nothing can hold."""
        system.state.v[:] = 0.0
        system.lag = 0.0
        system.fictitious = True
        self.trial = Trial(system)
        self.step_length = 1.0
        self.trial.refuse_free()
        self._hold()
        self.notes = []
        system.stale = False

    def _hold(self) -> None:
        """Stiffness that holds what no joint holds; spheres, whose contacts are not known to `joints`, altogether."""
        share = np.where(self.trial.round_owners(), 1.0, LOOSE)
        self._inertia = share * self.trial.reference_stiffness()

    def take_turns(self) -> list[Any]:
        """Rotation vectors since last asked, of the batches that turn."""
        return self.trial.take_turns()

    def refresh(self, system: Any) -> None:
        """Find the reference stiffness again after contacts have changed."""
        self._hold()
        system.stale = False

    def limit(self, system: Any) -> float:
        """No step is too long: infinite."""
        return math.inf

    def step(self, system: Any, dt: float) -> None:
        """Find the equilibrium under the loads at the end of the step."""
        left, part = 1.0, 1.0 / self.steps
        start, t = self._unbalanced(0.0), system.state.t
        while left > 1e-9:
            part = min(part, left)
            if self._attempt(system, start, t + dt * (1.0 - left + part), left, part):
                left -= part
                part = min(2.0 * part, 1.0 / self.steps)
                continue
            part *= 0.5
            if part < 0.5**HALVINGS / self.steps:
                raise ConvergenceError(
                    f"no equilibrium found: {1.0 - left:.0%} of the load step were in balance; the last residuals are "
                    f"{told(self.history)} of the largest force, {self._culprit}",
                    self.history,
                )
        loose = self.trial.loose()
        self.notes = [f"nothing holds {', '.join(map(repr, loose))} in some direction"] if loose else []
        system.state.step += 1

    def _attempt(self, system: Any, start: Array, t: float, left: float, part: float) -> bool:
        """One load step; everything as before if it does not converge."""
        trial = self.trial
        trial.begin()
        d, h = np.zeros_like(system.state.v), t - system.state.t
        trial.prescribe(d, h, part / left)
        try:
            trial.displace(d, h)
            if self._iterate((left - part) * start):
                self.accepted.append((self.history[-1], trial.accept()))
                return True
        except OverlapError:
            if part <= 2.0 * 0.5**HALVINGS / self.steps:
                raise
        trial.back()
        return False

    def _unbalanced(self, rest: Any) -> Array:
        """Forces of the trial that nothing holds, less `rest`."""
        return self.trial.released(self.trial.plain_forces()) - rest

    def _iterate(self, rest: Array) -> bool:
        """Iterate until the unbalanced force is `rest`."""
        from scipy.sparse import diags

        trial, recuts, trust, floor, self.history = self.trial, 0, TRUST, 0.0, []
        r = self._unbalanced(rest)
        ratio = trial.residual_ratio(r, None)
        for iteration in range(self.max_iterations):
            self.history.append(ratio)
            if not np.isfinite(ratio):
                break
            if settled(self.history, self.tolerance, floor):
                if recuts < RECUTS and trial.find_contacts():
                    recuts += 1
                    r = self._unbalanced(rest)
                    ratio = trial.residual_ratio(r, None)
                    continue
                self.iterations = iteration
                return True
            held = (diags(self._inertia) + trial.assembler.joints()) / trust
            A = trial.assembler.effective(0.0, 0.0, 0.0, held)
            floor = trial.round_off(r, ratio)
            change = self.linear.solve(A, r, trial.assembler, self.tolerance / ratio, static=True)
            change *= min(1.0, MOTION / max(trial.relative_motion(change), 1e-300))
            trial.displace_further(change)
            trial.find_contacts()
            r, before = self._unbalanced(rest), ratio
            ratio = trial.residual_ratio(r, None)
            for _ in range(SHORTENINGS):
                if ratio <= CLIMB * before:
                    break
                change *= 0.5
                trial.displace_further(-change)
                r = self._unbalanced(rest)
                ratio = trial.residual_ratio(r, None)
            if ratio <= before:
                trust *= max(GROWTH, before / max(ratio, 1e-300))
            elif ratio > CLIMB * before:
                trust /= GROWTH
            trust = min(trust, MOST_TRUST)
        self._culprit = trial.worst(r)
        return False
