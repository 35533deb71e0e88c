"""What every benchmark writes: machine and versions, a table for people, JSON, a marked section of the README."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
RESULTS = HERE / "results"
PACKAGES = ("numpy", "scipy", "numba", "scikit-fem", "gmsh", "pyamg")


def machine() -> dict[str, Any]:
    """What the figures were measured on and with; a commit with "+" had changes in the package."""
    try:
        with open("/proc/cpuinfo") as lines:
            model = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        model = platform.processor() or platform.machine()
    git = ["git", "-C", str(HERE)]
    commit = _said([*git, "rev-parse", "--short", "HEAD"])
    if commit and _said([*git, "status", "--porcelain", "../fdem"]):
        commit += "+"
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in PACKAGES},
        "commit": commit or "unknown",
        "date": time.strftime("%Y-%m-%d"),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


def _said(command: list[str]) -> str:
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:
        return ""


def caption(facts: dict[str, Any]) -> str:
    """One line on machine, versions and commit."""
    packages = ", ".join(f"{name} {number}" for name, number in facts["versions"].items() if number != "none")
    return (
        f"{facts['cpu']}, {facts['cores']} cores, load {facts['load']}; Python {facts['python']}, {packages}; "
        f"commit {facts['commit']}, {facts['date']}."
    )


def table(head: list[str], rows: list[list[Any]]) -> str:
    """Markdown table, padded so that it reads well on a terminal too."""
    cells = [head, *([_cell(value) for value in row] for row in rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(head))]
    lines = ["| " + " | ".join(text.ljust(w) for text, w in zip(row, widths, strict=True)) + " |" for row in cells]
    return "\n".join([lines[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *lines[1:]])


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "NO"
    if isinstance(value, float):
        return f"{value:.3g}"
    return "" if value is None else str(value).replace("|", "/")


def keep(name: str, data: Any) -> None:
    """Write results/<name>.json."""
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps(data, indent=1, default=float) + "\n")


def section(name: str, title: str, text: str) -> None:
    """Replace the section of the README between the marks of `name`, or add it at the end."""
    readme = HERE / "README.md"
    begin, end = f"<!-- {name}: written by {name}.py -->", f"<!-- {name}: end -->"
    old, new = readme.read_text(), f"{begin}\n{text.strip()}\n{end}"
    if begin in old:
        head, rest = old.split(begin)
        readme.write_text(head + new + rest.split(end)[1])
    else:
        readme.write_text(f"{old.rstrip()}\n\n## {title}\n\n{new}\n")
