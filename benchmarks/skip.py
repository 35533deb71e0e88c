"""What a scene does not need is left out: the same scene with and without it, and a scene that needs it.

    python benchmarks/skip.py [--full]

For every item: the largest difference of the answers with and without it, relative, against the tolerance ("bits": 0);
the CPU time of a step with and without, by turns, least of several; what becomes of the answer when it is left out
by force where it matters (the difference must be beyond the tolerance); and whether `describe()` says so. Writes
results/skip.json and the section of README.md. --full repeats more.
"""

from __future__ import annotations

import argparse
import time
import warnings
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import reporting
from skipping import CASES, Case

import fdem


@dataclass
class Found:
    """What one item gave."""

    item: str
    difference: float
    tolerance: float
    with_it: float
    without: float
    forced: float
    said: bool

    @property
    def passed(self) -> bool:
        """Identical, cheaper, needed where it matters, and said."""
        same = self.difference <= self.tolerance
        return same and self.without < self.with_it and self.forced > self.tolerance and self.said


def difference(a: Any, b: Any) -> float:
    """Largest difference over the largest value; infinite where one of them is missing."""
    if a is None or b is None:
        return np.inf
    a, b = np.asarray(a, float), np.asarray(b, float)
    return float(np.abs(a - b).max() / max(np.abs(a).max(), np.finfo(float).tiny)) if a.shape == b.shape else np.inf


def look_at(case: Case, repeats: int) -> Found:
    """Run one item."""
    needs, spares = case.scene(True), case.scene(False)
    said = case.said in spares.describe()
    for run in (needs, spares):
        run.cycle(5)
    spent: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(repeats):
        for kind, sim in ((True, needs), (False, spares)):
            clock = getattr(sim, "clock", time.process_time)
            start = clock()
            sim.cycle(case.steps)
            spent[kind].append((clock() - start) / case.steps)
    off = difference(case.answer(needs), case.answer(spares))
    least = {kind: min(times) for kind, times in spent.items()}
    return Found(case.item, off, case.tolerance, least[True], least[False], difference(*case.matters()), said)


def table(found: list[Found]) -> str:
    """For people."""
    rows = []
    for f in found:
        bar = "bits" if f.tolerance == 0 else f"{f.tolerance:g}"
        rows.append([
            f.item, f"{f.difference:.2g}", bar, f"{1e6 * f.with_it:.4g}", f"{1e6 * f.without:.4g}",
            f"{100 * (1 - f.without / f.with_it):.0f} %", "no answer" if np.isinf(f.forced) else f"{f.forced:.2g}",
            f.said, "pass" if f.passed else "FAIL",
        ])  # fmt: skip
    head = ["left out", "difference", "allowed", "us with", "us without", "saved", "left out by force", "described", ""]
    return reporting.table(head, rows)


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="more repeats")
    parser.add_argument("--only", nargs="*", choices=list(CASES), help="these alone, nothing is written")
    options = parser.parse_args()
    warnings.simplefilter("ignore", fdem.FdemWarning)
    found = []
    for name in options.only or CASES:
        found.append(look_at(CASES[name], 15 if options.full else 5))
        print(f"{name}: {'pass' if found[-1].passed else 'FAIL'}", flush=True)
    text = table(found)
    print(text)
    if not options.only:
        facts = reporting.machine()
        reporting.keep("skip", {"machine": facts, "items": [asdict(f) | {"passed": f.passed} for f in found]})
        words = (
            "Microseconds are CPU time of a step (of a whole process for imports), one thread. 'Left out by force' is "
            "the relative error of a scene that needs the item when it is left out all the same."
        )
        reporting.section("skip", "What a scene does not need", f"{reporting.caption(facts)} {words}\n\n{text}")


if __name__ == "__main__":
    main()
