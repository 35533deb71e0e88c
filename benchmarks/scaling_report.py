"""Exponents, tables and the picture of `scaling.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import reporting

UNITS = {"zones": "zones", "blocks": "rigid blocks", "contacts": "patches", "spheres": "spheres"}


def exponent(rows: list[dict[str, Any]], name: str, large: int) -> float | None:
    """Slope of log(value) over log(n) by least squares, of the sizes from `large` on (three largest at least)."""
    rows = sorted(rows, key=lambda r: r["n"])
    some = [r for r in rows if r["n"] >= 0.7 * large]
    some = some if len(some) >= 3 else rows[-3:]
    if len(some) < 2 or min(r[name] for r in some) <= 0:
        return None
    return float(np.polyfit(np.log([r["n"] for r in some]), np.log([r[name] for r in some]), 1)[0])


def report(data: dict[str, Any], large: int, bar: float) -> str:
    """Tables of steps, set-up, jointed rock and starts."""
    lines, setup = [], []
    for kind, unit in UNITS.items():
        rows = [r for r in data["rows"] if r["kind"] == kind]
        one = sorted((r for r in rows if r["threads"] == 1), key=lambda r: r["n"])
        if not one:
            continue
        most, slope, memory = one[-1], exponent(one, "step", large), exponent(one, "memory", large)
        two = [r for r in rows if r["threads"] == 2]
        gain = f"{most['step'] / two[0]['step']:.2f}" if two else ""
        lines.append([
            unit, f"{one[0]['n']} .. {most['n']}", f"{1e9 * most['step'] / most['n']:.0f} ns", slope,
            slope is not None and slope <= bar, f"{most['memory'] / most['n']:.0f} B", memory, gain,
        ])  # fmt: skip
        for row in one:
            parts = [f"{row[name]:.2f}" for name in ("scene", "compile", "detection")]
            whole = row["scene"] + row["compile"] + row["detection"]
            setup.append([unit, row["n"], *parts, f"{1e6 * whole / row['n']:.0f}", f"{1e3 * row['step']:.3f}"])
        slopes = [exponent(one, name, large) for name in ("scene", "compile", "detection")]
        setup.append([unit, "exponent", *[f"{s:.2f}" if s is not None else "" for s in slopes], "", ""])
    text = []
    if lines:
        head = ["", "sizes", "step / n", "exponent", f"<= {bar}", "memory / n", "exponent", "two threads (wall)"]
        text += ["![Cost against size](results/scaling.png)", reporting.table(head, lines), "Set-up, CPU s:",
                 reporting.table(["", "n", "scene", "compile", "detection", "us / n", "step [ms]"], setup)]  # fmt: skip
    if any(data.get("jointed", [])):
        rows = [
            [r["n"], r["patches"], *[f"{r[k]:.2f}" for k in ("cutting", "scene", "compile", "ten steps")],
             f"{sum(r[k] for k in ('cutting', 'scene', 'compile', 'ten steps')):.1f}", f"{r['memory'] / 1e9:.2f}"]
            for r in data["jointed"] if r
        ]  # fmt: skip
        head = ["blocks", "patches", "cutting", "scene", "compile", "ten steps", "in all [CPU s]", "memory [GB]"]
        text += ["Rigid blocks cut by three joint sets (10 000 of them: < 30 s, < 2 GB):", reporting.table(head, rows)]
    if start := data.get("start"):
        text.append(
            f"`examples/incline.py`: cold (no compiled kernels on disk) {start['cold']:.1f} CPU s (< 20 s), warm "
            f"{start['warm']:.2f} CPU s (< 2 s)."
        )
    return "\n\n".join(text)


def draw(data: dict[str, Any], path: Path) -> None:
    """Step, set-up and memory over n."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(13, 4.4))
    panels = {
        "step [CPU s]": lambda r: r["step"],
        "set-up [CPU s]": lambda r: r["scene"] + r["compile"] + r["detection"],
        "memory [MB]": lambda r: r["memory"] / 1e6,
    }
    for place, (label, value) in zip(axes, panels.items(), strict=True):
        ends = []
        for (kind, unit), mark in zip(UNITS.items(), "osD^", strict=True):
            rows = sorted((r for r in data["rows"] if r["kind"] == kind and r["threads"] == 1), key=lambda r: r["n"])
            rows = [r for r in rows if value(r) > 0]
            if rows:
                place.loglog([r["n"] for r in rows], [value(r) for r in rows], f"{mark}-", ms=5, label=unit)
                ends.append((rows[-1]["n"], value(rows[-1])))
        if ends:
            n, v = max(ends)
            line = np.array([n / 100, n])
            place.loglog(line, v * 3 * line / n, "k:", lw=1, label="linear")
        place.set_xlabel("n")
        place.set_ylabel(label)
        place.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
    facts = data["machine"]
    figure.suptitle(
        f"Cost against size: {facts['cpu']}, one thread, commit {facts['commit']}, {facts['date']}", fontsize=9
    )
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    plt.close(figure)
