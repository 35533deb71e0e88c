"""Rows of the table of stress scenarios, and the list of them."""

from __future__ import annotations

import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import fdem

G = 9.81


@dataclass
class Row:
    """One number of a scenario beside the criterion it is held to."""

    what: str
    value: Any
    criterion: str
    passed: bool


def at_most(what: str, value: float, limit: float) -> Row:
    """Return the row of a number that must not be larger; nan fails."""
    return Row(what, float(value), f"<= {limit:.4g}", bool(value <= limit))


def between(what: str, value: float, low: float, high: float) -> Row:
    """Return the row of a number in a range."""
    return Row(what, float(value), f"{low:.5g} .. {high:.5g}", bool(low <= value <= high))


def holds(what: str, fact: bool, criterion: str, value: Any = None) -> Row:
    """Return the row of what is true or not."""
    return Row(what, ("yes" if fact else "no") if value is None else value, criterion, bool(fact))


Scenario = Callable[[bool], Iterable[Row]]
SCENARIOS: dict[str, tuple[str, Scenario]] = {}


def scenario(number: str, title: str) -> Callable[[Scenario], Scenario]:
    """Enter a function of `full` that yields rows into the list."""

    def enter(function: Scenario) -> Scenario:
        SCENARIOS[number] = (title, function)
        return function

    return enter


def rows_of(number: str, full: bool) -> Iterator[Row]:
    """Rows of one scenario; one that ends in an error has failed with its message."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", fdem.FdemWarning)
            yield from SCENARIOS[number][1](full)
    except Exception as error:  # the table goes on with the next one
        place = traceback.extract_tb(error.__traceback__)[-1]
        yield Row(
            "runs", f"{type(error).__name__}: {str(error)[:150]} ({place.name}:{place.lineno})", "no error", False
        )


def run(number: str, full: bool) -> tuple[list[Row], float]:
    """Rows of one scenario and the CPU seconds it took."""
    start = time.process_time()
    rows = list(rows_of(number, full))
    return rows, time.process_time() - start


def simulation(scene: fdem.Scene, integrator: Any = None, **options: Any) -> fdem.Simulation:
    """Compile without a progress bar and without warnings, explicit by habit."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fdem.FdemWarning)
        return fdem.Simulation(scene, integrator or fdem.Explicit(), progress=False, **options)


def settled(scene: fdem.Scene, ratio: float = 1e-10, **options: Any) -> fdem.Simulation:
    """Return the scene in equilibrium, by relaxation."""
    sim = simulation(scene, fdem.Relaxation(), **options)
    report = sim.solve(ratio=ratio)
    if report.reason != "equilibrium":
        raise AssertionError(f"no equilibrium: {report}")
    return sim
