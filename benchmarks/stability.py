"""Numerical stability: the public stress scenarios, each with its number, its criterion, passed or failed.

    python benchmarks/stability.py [--full] [--only S01 S07 ...]

Writes results/stability.json and the section of README.md. Without --full runs are shorter (steps, start phases,
bodies); the criteria are the same.
"""

from __future__ import annotations

import argparse
from typing import Any

import reporting
from stress import penetration, rest, solids, steps
from stress.base import SCENARIOS, run

MODULES = (penetration, rest, solids, steps)  # their scenarios enter SCENARIOS when they are imported


def measure(numbers: list[str], full: bool) -> list[dict[str, Any]]:
    """Every row as a dictionary, printed as it comes."""
    found = []
    for number in numbers:
        title = SCENARIOS[number][0]
        rows, spent = run(number, full)
        passed = bool(rows) and all(row.passed for row in rows)
        print(f"{number} {title}: {'pass' if passed else 'FAIL'} ({spent:.1f} CPU s)", flush=True)
        for row in rows:
            value = f"{row.value:.4g}" if isinstance(row.value, float) else row.value
            print(f"    {'ok  ' if row.passed else 'FAIL'} {row.what}: {value}  [{row.criterion}]", flush=True)
        found.append(
            {"number": number, "title": title, "passed": passed, "cpu": spent, "rows": [vars(r) for r in rows]}
        )
    return found


def report(found: list[dict[str, Any]]) -> str:
    """One line a scenario with its number nearest to the criterion or beyond it; below, what fails and why."""
    lines = []
    for each in found:
        numbers = [row for row in each["rows"] if isinstance(row["value"], float) and row["criterion"].startswith("<=")]
        worst = max(numbers, key=lambda row: share(row), default=each["rows"][-1])
        failed = [row for row in each["rows"] if not row["passed"]]
        shown = failed[0] if failed else worst
        passed = f"{len(each['rows']) - len(failed)} of {len(each['rows'])}"
        lines.append([
            each["number"], each["title"], shown["what"], shown["value"], shown["criterion"],
            "pass" if each["passed"] else "FAIL", passed, f"{each['cpu']:.1f}",
        ])  # fmt: skip
    head = ["", "scenario", "number nearest to its criterion", "value", "criterion", "", "checks passed", "CPU s"]
    text = reporting.table(head, lines)
    failures = []
    for each in found:
        for row in each["rows"]:
            if not row["passed"]:
                value = row["value"] if isinstance(row["value"], str) else f"{row['value']:.3g}"
                failures.append(f"- {each['number']}, {row['what']}: {value} against {row['criterion']}.")
    return text + ("\n\nWhat does not pass:\n\n" + "\n".join(failures) if failures else "\n\nAll pass.")


def share(row: dict[str, Any]) -> float:
    """A number over its limit."""
    limit = float(row["criterion"][2:])
    return row["value"] / limit if limit > 0 else row["value"]


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="steps and sizes as listed")
    parser.add_argument("--only", nargs="*", choices=sorted(SCENARIOS), help="these alone, nothing is written")
    options = parser.parse_args()
    found = measure(options.only or sorted(SCENARIOS), options.full)
    text = report(found)
    print(text)
    if not options.only:
        facts = reporting.machine()
        reporting.keep("stability", {"machine": facts, "full": options.full, "scenarios": found})
        mode = "runs as long as listed" if options.full else "shortened runs (`make bench`)"
        reporting.section(
            "stability", "Numerical stability", f"{reporting.caption(facts)} One thread, {mode}.\n\n{text}"
        )


if __name__ == "__main__":
    main()
