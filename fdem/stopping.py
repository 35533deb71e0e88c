"""When is a quasi-static run finished: equilibrium, collapse, or neither yet."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from fdem.errors import ConvergenceError

__all__ = ["Report", "Watch", "solve"]


@dataclass(frozen=True)
class Report:
    """How a `Simulation.solve` ended.

    Attributes
    ----------
    converged : bool
        Whether equilibrium was reached.
    reason : str
        "equilibrium", "cycles" or "collapse".
    cycles : int
        Steps taken.
    ratio, start_ratio : float
        Solve ratio at the end and at the start.
    kinetic_ratio : float
        Kinetic energy over its largest value of this solve.
    remaining : float
        Estimated displacement still to come over the largest displacement so far.
    wall_time : float
        [s].
    residuals, increments : tuple of float
        Of implicit integrators, for every step accepted in this solve: the largest unbalanced force over the largest
        acting, and the longest motion of a gridpoint in the step [m].
    notes : str
        What else there is to say: a start out of balance, blocks that nothing holds, why it did not converge.
    """

    converged: bool
    reason: str
    cycles: int
    ratio: float
    start_ratio: float
    kinetic_ratio: float
    remaining: float
    wall_time: float
    residuals: tuple[float, ...] = ()
    increments: tuple[float, ...] = ()
    notes: str = ""


class Watch:
    """Looks at a system every so many cycles and says when to stop.

    Parameters
    ----------
    system : System
        What is solved.
    target : float
        Solve ratio to reach.
    at_rest : callable, optional
        ``at_rest(ratio)``: whether an integrator that needs no settling sees everything at rest; then it is looked at
        after every cycle.

    Notes
    -----
    *Equilibrium*: the unbalanced force ratio is at most `target`, and the displacement still to come,
    estimated from a geometric decay of the motion per look, is at most 1000 times `target` (5 % at
    most) of the largest displacement; prescribed displacements have come to `target` of where they go.

    *Collapse*: over six windows, each half as long again as the one before (the last is longer than the
    slowest mode that could still be swinging out), motion per cycle did not fall by more than 10 %
    from window to window, it is not oscillation (net and summed motion agree within 20 %), the ratio
    stays ten times above `target`, and the motion exceeds 1e-3 of the size of the moving block.
    """

    every = 25
    windows = 6
    first_window = 400

    def __init__(self, system: Any, target: float, at_rest: Callable[[float], bool] | None = None) -> None:
        self.system, self.target, self._at_rest = system, float(target), at_rest
        self.every = self.every if at_rest is None else 1
        self.ratio = self.start_ratio = float("nan")
        self.kinetic_ratio, self.remaining = 0.0, 0.0
        self._kinetic_peak = 0.0
        self._x_first = system.state.x.copy()
        self._x_last = system.state.x.copy()
        self._moved: list[float] = []
        self._window = self.first_window
        self._mark = (system.state.step, system.state.x.copy(), 0.0)
        self._speeds: list[float] = []
        self._path = 0.0
        self._block_size = system.model.size[system.model.gp_block]

    def look(self) -> str | None:
        """Reason to stop, or None."""
        system, x = self.system, self.system.state.x
        self.ratio = system.ratio()
        if np.isnan(self.start_ratio):
            self.start_ratio = self.ratio
        kinetic = system.kinetic()
        self._kinetic_peak = max(self._kinetic_peak, kinetic)
        self.kinetic_ratio = kinetic / self._kinetic_peak if self._kinetic_peak > 0 else 0.0
        moved = float(np.sqrt(((x - self._x_last) ** 2).sum(axis=1).max()))
        total = float(np.sqrt(((x - self._x_first) ** 2).sum(axis=1).max()))
        self._x_last[:] = x
        self._path += moved
        self._moved = [*self._moved[-7:], moved]
        self.remaining = self._estimate(total)
        ahead = system.constraints.ahead(system.state.q, system.q0, system.state.t)
        near = self.remaining <= min(0.05, 1e3 * self.target) if self._at_rest is None else self._at_rest(self.target)
        if max(self.ratio, ahead) <= self.target and near:
            return "equilibrium"
        return "collapse" if self._collapsing(x) else None

    def _estimate(self, total: float) -> float:
        """Sum of the geometric series the last looks suggest, over the displacement so far."""
        if total == 0.0 or len(self._moved) < 2:
            return 0.0
        older, newer = max(self._moved[: len(self._moved) // 2]), max(self._moved[len(self._moved) // 2 :])
        # what is left at the last bits of the positions never dies out
        if older == 0.0 or newer <= 16 * np.finfo(float).eps * float(np.abs(self._x_last).max()):
            return 0.0
        decay = min((newer / older) ** (2.0 / len(self._moved)), 0.99)
        return newer * decay / (1.0 - decay) / total

    def _collapsing(self, x: np.ndarray) -> bool:
        step = self.system.state.step
        begin, x_begin, path_begin = self._mark
        if step - begin < self._window:
            return False
        distance = np.sqrt(((x - x_begin) ** 2).sum(axis=1))
        net, path = float(distance.max()), self._path - path_begin
        straight = net >= 0.8 * path
        speed = net / (step - begin)
        self._speeds = [*self._speeds, speed] if straight else []
        self._window = int(1.5 * self._window)
        self._mark = (step, x.copy(), self._path)
        recent = self._speeds[-self.windows :]
        if len(recent) < self.windows or self.ratio < 10 * self.target:
            return False
        growing = all(b >= 0.9 * a for a, b in pairwise(recent))
        worst = int(np.argmax(distance))
        return growing and net > 1e-3 * self._block_size[worst]


def solve(sim: Any, ratio: float, max_cycles: int) -> Report:
    """Take steps until equilibrium, collapse or `max_cycles` (see `Simulation.solve`)."""
    accepted = getattr(sim.integrator, "accepted", [])
    accepted.clear()
    run = _at_once if getattr(sim.integrator, "static", False) else _cycles
    begin = clock.perf_counter()
    result = run(sim, ratio, max_cycles)
    result |= {"wall_time": clock.perf_counter() - begin, "converged": result["reason"] == "equilibrium"}
    residuals, increments = (tuple(step[k] for step in accepted) for k in range(2))
    return Report(residuals=residuals, increments=increments, **result)


def _cycles(sim: Any, ratio: float, max_cycles: int) -> dict[str, Any]:
    first = sim.state.step
    # while tractions of removed blocks are still being released, what looks like equilibrium is none
    released = max((at + over - first for _, _, at, over in sim._releases), default=0)
    sim._steps(min(max(released, 0), max_cycles))
    watch = Watch(sim.system, ratio, getattr(sim.integrator, "at_rest", None))
    reason = watch.look()
    while reason is None and sim.state.step - first < max_cycles:
        sim._steps(min(watch.every, max_cycles - (sim.state.step - first)))
        reason = watch.look()
    return {
        "reason": reason or "cycles",
        "cycles": sim.state.step - first,
        "ratio": watch.ratio,
        "start_ratio": watch.start_ratio,
        "kinetic_ratio": watch.kinetic_ratio,
        "remaining": watch.remaining,
        "notes": "; ".join(getattr(sim.integrator, "notes", [])),
    }


def _at_once(sim: Any, ratio: float, max_cycles: int) -> dict[str, Any]:
    """One step of an integrator that finds equilibrium by itself."""
    integrator, start, reason = sim.integrator, sim.system.ratio(), "equilibrium"
    tolerance, integrator.tolerance = integrator.tolerance, min(ratio, integrator.tolerance)
    notes = [f"the start was out of balance by {start:.2g} of the largest force"] if start > ratio else []
    try:
        sim._steps(1)
        notes += integrator.notes
    except ConvergenceError as error:
        reason = "collapse"
        notes.append(str(error))
    finally:
        integrator.tolerance = tolerance
    return {
        "reason": reason,
        "cycles": integrator.iterations,
        "ratio": sim.system.ratio(),
        "start_ratio": start,
        "kinetic_ratio": 0.0,
        "remaining": 0.0,
        "notes": "; ".join(notes),
    }
