"""`fdem.tune` on problems with known answers, against the cheapest settings measured by hand."""

from __future__ import annotations

from statistics import median
from typing import Any

import precision_report
from problems import PROBLEMS
from problems.base import Problem, measure

import fdem

BUDGET = 120.0  # CPU s of one search


def one(problem: Problem, tolerance: float, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Tune one problem; the setting it chose and the best by hand are timed in turn, so that load falls on both."""
    result: dict[str, Any] = {"tolerance": tolerance}
    try:
        tuned = fdem.tune(problem.build, lambda solve: solve(), tolerance, budget=BUDGET, **problem.tune)
    except fdem.ToleranceError as error:
        return result | {"failure": f"refused: {error}"[:160]}
    best = precision_report.cheapest(rows, tolerance)
    by_hand = None
    again = [tuned.settings]
    if best is not None:
        everything = {str(s): s for s in [*problem.series, *problem.more]}
        chosen = [s for s in everything.values() if _same(s, best)]
        again += chosen[:1]
    timed = measure(problem, again, 5)
    if len(timed) > 1:
        by_hand = timed[1].cpu
    return result | {
        "settings": str(tuned.settings),
        "value_error": problem.error(tuned.value),
        "true_error": problem.error(tuned.quantity),
        "error": tuned.error,
        "cpu": timed[0].cpu,
        "by_hand": by_hand,
        "runs": len(tuned.runs),
        "cost": tuned.total_cost,
        "median_run": median(run.cost for run in tuned.runs),
    }


def _same(setting: Any, row: dict[str, Any]) -> bool:
    return setting.kind == row["series"] and all(
        getattr(setting, knob) == row.get(knob) for knob in precision_report.KNOBS
    )


def run(data: dict[str, Any], only: list[str] | None, full: bool) -> None:
    """Tune the problems that have been measured; results go into `data`."""
    for name, measured in data["problems"].items():
        if only and name not in only:
            continue
        problem, measured["tuned"] = PROBLEMS[name], []
        for tolerance in (*problem.asked, *(problem.asked_too if full else ())):
            found = one(problem, tolerance, measured["rows"])
            measured["tuned"].append(found)
            if "failure" in found:
                print(f"{name:11s} {tolerance:g}: {found['failure']}", flush=True)
                continue
            ratio = found["cpu"] / found["by_hand"] if found["by_hand"] else float("nan")
            print(
                f"{name:11s} {tolerance:g}: {found['settings']}: true {found['true_error']:.1e}, value "
                f"{found['value_error']:.1e}, estimated {found['error']:.1e}; {ratio:.2f} x by hand; "
                f"{found['runs']} runs, {found['cost']:.1f} CPU s",
                flush=True,
            )
