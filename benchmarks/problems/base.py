"""What a problem with a known answer is, and how one of its settings is timed."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import numpy as np

import fdem
from fdem.tuning.settings import Settings

Solve = Callable[[], float]
KNOBS = ("size", "dt", "safety", "kn", "ratio")


@dataclass(frozen=True)
class Problem:
    """A scene with an answer in closed form.

    Attributes
    ----------
    name, title : str
        For files, and for people.
    quantity : str
        What is compared, with its unit.
    exact : float
        The closed form.
    build : callable
        ``build(settings) -> solve``: sets the scene up, compiled; ``solve()`` runs it and returns the value.
    series : list of Settings
        Quick mode: formulation x integrator x resolution.
    more : list of Settings
        What the full mode adds.
    tune : dict
        Coarse settings to start `fdem.tune` from.
    asked, asked_too : tuple of float
        Errors that `fdem.tune` is asked for in quick mode, and in full mode besides.
    """

    name: str
    title: str
    quantity: str
    exact: float
    build: Callable[[Settings], Solve]
    series: Sequence[Settings]
    more: Sequence[Settings] = ()
    tune: dict[str, Any] = field(default_factory=dict)
    asked: tuple[float, ...] = (0.01, 0.001)
    asked_too: tuple[float, ...] = ()

    def run(self, setting: Settings) -> float:
        """Value that a setting gives."""
        return self.build(setting)()

    def error(self, value: float) -> float:
        """Relative error."""
        return abs(value / self.exact - 1.0)


def grid(bodies: Any, integrators: Any, **numbers: Iterable[float]) -> list[Settings]:
    """Every combination; numbers that a body or integrator has no use for are left to the problem."""
    bodies, integrators = (x if isinstance(x, (list, tuple)) else [x] for x in (bodies, integrators))
    names = list(numbers)
    return [
        Settings.of(body, integrator, **dict(zip(names, values, strict=True)))
        for body in bodies
        for integrator in integrators
        for values in itertools.product(*numbers.values())
    ]


@dataclass
class Measured:
    """Median times of one setting [s], its error, and what the very first run of its series took."""

    setting: Settings
    value: float = float("nan")
    error: float = float("nan")
    setup: float = float("nan")
    solve: float = float("nan")
    cpu: float = float("nan")
    wall: float = float("nan")
    first: float = float("nan")
    failure: str = ""

    def row(self) -> dict[str, Any]:
        """For the JSON file."""
        numbers = {knob: getattr(self.setting, knob) for knob in KNOBS if getattr(self.setting, knob) is not None}
        times = {key: round(getattr(self, key), 6) for key in ("setup", "solve", "cpu", "wall", "first")}
        kept = {"series": self.setting.kind, **numbers, "value": self.value, "error": self.error, **times}
        return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in kept.items()} | (
            {"failure": self.failure} if self.failure else {}
        )


def measure(problem: Problem, settings: Sequence[Settings], repeats: int) -> list[Measured]:
    """Median times of `repeats` runs of every setting, taken in turn so that the machine's load falls on all alike.

    The first run of every series is not counted: kernels are loaded in it.
    """
    results = [Measured(setting) for setting in settings]
    first: dict[str, float] = {}
    for result in results:
        if result.setting.kind not in first:
            begin = time.perf_counter()
            _timed(problem, result)
            first[result.setting.kind] = time.perf_counter() - begin
        result.first = first[result.setting.kind]
    times: list[list[Any]] = [[] for _ in results]
    for _ in range(repeats):
        for result, taken in zip(results, times, strict=True):
            if not result.failure:
                taken.append(_timed(problem, result))
    for result, taken in zip(results, times, strict=True):
        if not result.failure:
            result.error = problem.error(result.value)
            result.setup, result.solve, result.cpu, result.wall = (median(x) for x in zip(*taken, strict=True))
    return results


def _timed(problem: Problem, result: Measured) -> tuple[float, float, float, float] | None:
    """Set-up and solve [wall s], CPU and wall seconds of both; a failure is kept in the result."""
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        solve = problem.build(result.setting)
        between = time.perf_counter()
        result.value = float(solve())
    except fdem.FdemError as error:
        result.failure = f"{type(error).__name__}: {error}"[:200]
        return None
    done = time.perf_counter()
    return between - wall, done - between, time.process_time() - cpu, done - wall
