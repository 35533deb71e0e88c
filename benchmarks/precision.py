"""Run time against error: problems with known answers over formulation x integrator x resolution.

    python benchmarks/precision.py [--full] [--tune | --no-tune] [--only NAME ...] [--repeats N] [--report]

Writes results/precision.json, the pictures results/precision_*.png, and the section of README.md that shows them.
Then `fdem.tune` is run against the cheapest settings found (--no-tune leaves it out, --tune does it alone). --full adds
finer settings; --report draws again from the JSON file.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import time
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import precision_report
from problems import PROBLEMS
from problems.base import Problem, measure

import fdem

RESULTS = Path(__file__).parent / "results" / "precision.json"


def machine() -> dict[str, Any]:
    """What the figures were measured on and with."""
    try:
        model = next(line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name"))
    except (OSError, StopIteration):
        model = platform.processor() or platform.machine()
    git = ["git", "-C", str(Path(__file__).parent)]
    commit = subprocess.run([*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip()
    if subprocess.run([*git, "status", "--porcelain", "../fdem"], capture_output=True, text=True).stdout.strip():
        commit += "+"
    names = ("numpy", "scipy", "numba", "scikit-fem", "gmsh", "pyamg")
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "threads": 1,
        "load": load,
        "python": platform.python_version(),
        "versions": {"fdem": fdem.__version__, **{name: version(name) for name in names}},
        "commit": commit or None,
        "date": time.strftime("%Y-%m-%d"),
    }


def run(problem: Problem, full: bool, repeats: int) -> dict[str, Any]:
    """All settings of one problem."""
    begin = time.perf_counter()
    settings = list({s.key: s for s in [*problem.series, *(problem.more if full else ())]}.values())
    rows = [measured.row() for measured in measure(problem, settings, repeats)]
    print(f"{problem.name:12s} {len(settings):3d} settings, {time.perf_counter() - begin:6.1f} s", flush=True)
    for row in rows:
        if "failure" in row:
            print(f"    {row['series']}: {row['failure']}")
    return {"title": problem.title, "quantity": problem.quantity, "exact": problem.exact, "rows": rows}


def main() -> None:
    """Measure, write, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="finer settings too")
    parser.add_argument("--tune", action="store_true", help="run fdem.tune alone, on what has been measured")
    parser.add_argument("--no-tune", action="store_true", help="leave out fdem.tune against the cheapest settings")
    parser.add_argument("--report", action="store_true", help="draw again what has been measured")
    parser.add_argument("--only", nargs="*", choices=list(PROBLEMS), help="these problems alone")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    warnings.simplefilter("ignore", fdem.FdemWarning)
    data = (
        json.loads(RESULTS.read_text()) if RESULTS.exists() and (options.only or options.report or options.tune) else {}
    )
    if not options.report and not options.tune:
        data["machine"] = machine() | {"mode": "full" if options.full else "quick", "repeats": options.repeats}
        problems = data.setdefault("problems", {})
        for name in options.only or PROBLEMS:
            tuned = problems.get(name, {}).get("tuned")
            problems[name] = run(PROBLEMS[name], options.full, options.repeats)
            if tuned:
                problems[name]["tuned"] = tuned
        data["problems"] = {name: problems[name] for name in PROBLEMS if name in problems}
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(data, indent=1) + "\n")  # what has been measured is kept, whatever comes
    if not options.report and not options.no_tune:
        import precision_tune

        precision_tune.run(data, options.only, options.full)
    RESULTS.write_text(json.dumps(data, indent=1) + "\n")
    precision_report.write(data, RESULTS.parent)


if __name__ == "__main__":
    main()
