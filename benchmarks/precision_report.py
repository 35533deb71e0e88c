"""Pictures and tables of run time against error."""

from __future__ import annotations

import math
import re
from itertools import groupby
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

KNOBS = ("size", "dt", "safety", "kn", "ratio")
LEVELS = (0.01, 0.001)
FLOOR = 1e-10  # errors below are drawn there
PER_SHEET = 6
BODY = {"Rigid": "tab:gray", "UniformStrain": "tab:blue", "LinearStrain": "tab:green", "Zoned": "tab:red",
        "Zoned(strain='small')": "tab:orange"}  # fmt: skip
INTEGRATOR = {"Explicit": "o", "Newmark": "s", "Newmark(beta=0.5, gamma=1.0)": "v", "GeneralizedAlpha": "D",
              "ContactDynamics": "*", "Static": "P", "Relaxation(damping=Adaptive)": "^",
              "Relaxation(damping=Local)": "<"}  # fmt: skip
SIZE = {"ContactDynamics": 9}
SHORT = {"Newmark(beta=0.5, gamma=1.0)": "Newmark (DDA)", "Relaxation(damping=Adaptive)": "Relaxation, adaptive",
         "Relaxation(damping=Local)": "Relaxation", "Zoned(strain='small')": "Zoned, small strain"}  # fmt: skip


def good(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows that gave a number."""
    return [row for row in rows if row["error"] is not None and row["cpu"] is not None]


def pareto(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows that no other beats in time and error, cheapest first."""
    front: list[dict[str, Any]] = []
    for row in sorted(good(rows), key=lambda r: (r["cpu"], r["error"])):
        if not front or max(row["error"], FLOOR) < front[-1]["error"]:
            front.append(row)
    return front


def cheapest(rows: list[dict[str, Any]], level: float) -> dict[str, Any] | None:
    """Cheapest row with an error of at most `level`."""
    return min((r for r in good(rows) if r["error"] <= level), key=lambda r: r["cpu"], default=None)


def parts(series: str) -> tuple[str, str]:
    """Body and integrator of a series."""
    body, integrator = re.match(r"((?:[^(,]|\([^)]*\))*), (.*)", series).groups()
    return body, integrator


def named(series: str) -> str:
    """Series as people read it."""
    return ", ".join(SHORT.get(part, part) for part in parts(series))


def numbers(row: dict[str, Any]) -> str:
    """The numbers of a setting."""
    return " ".join(f"{knob} {row[knob]:.3g}" for knob in KNOBS if knob in row)


def orders(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Observed order in every number that was varied, by least squares over three or more settings alike otherwise."""
    found = []
    for knob in KNOBS:
        for key, group in groupby(
            sorted(good(rows), key=lambda r: _alike(r, knob)), key=lambda r: _alike(r, knob)
        ):  # fmt: skip
            line = sorted((r for r in group if knob in r), key=lambda r: r[knob])
            if len({r[knob] for r in line}) < 3:
                continue
            x, y = np.log([r[knob] for r in line]), np.log([max(r["error"], 1e-16) for r in line])
            slope = float(np.polyfit(x, y, 1)[0]) * (-1 if knob == "kn" else 1)
            steady = bool(np.all(np.diff(y) * (-1 if knob == "kn" else 1) > 0))
            found.append(
                {"series": key[0], "knob": knob, "order": round(slope, 2), "monotone": steady, "points": len(line)}
            )
    return found


def _alike(row: dict[str, Any], knob: str) -> tuple[Any, ...]:
    return row["series"], tuple((k, row.get(k, math.nan)) for k in KNOBS if k != knob and k in row)


def draw(name: str, problem: dict[str, Any], axes: Any) -> None:
    """One problem: every setting, lines along the resolution, the Pareto front."""
    rows = good(problem["rows"])
    for series, group in groupby(sorted(rows, key=lambda r: r["series"]), key=lambda r: r["series"]):
        body, integrator = parts(series)
        line = sorted(group, key=lambda r: r["cpu"])
        x, y = [r["cpu"] for r in line], [max(r["error"], FLOOR) for r in line]
        axes.loglog(
            x,
            y,
            marker=INTEGRATOR.get(integrator, "x"),
            color=BODY.get(body, "k"),
            ls="",
            ms=SIZE.get(integrator, 6),
            alpha=0.8,
            mew=0,
        )
    front = pareto(rows)
    axes.loglog([r["cpu"] for r in front], [max(r["error"], FLOOR) for r in front], "k-", lw=1.2, zorder=0)
    axes.loglog([r["cpu"] for r in front], [max(r["error"], FLOOR) for r in front], "ko", ms=11, mfc="none", mew=1)
    for tuned in problem.get("tuned", []):
        if tuned.get("cpu"):
            axes.loglog(tuned["cpu"], max(tuned["true_error"], FLOOR), "x", color="magenta", ms=10, mew=2)
    for level in LEVELS:
        axes.axhline(level, color="0.6", lw=0.7, ls=":")
    axes.set_title(f"{problem['title']}", fontsize=10)
    axes.set_xlabel("CPU time, set-up and solve [s]", fontsize=8)
    axes.set_ylabel("relative error: " + fill(problem["quantity"].split(" [")[0], 42), fontsize=7)
    low, high = axes.get_xlim()
    if high < 10 * low:  # at least a decade, so that small differences look small
        middle = math.sqrt(low * high)
        axes.set_xlim(middle / math.sqrt(10), middle * math.sqrt(10))
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.25, which="major")


def sheets(data: dict[str, Any], folder: Path) -> list[Path]:
    """Pictures of so many problems each, one legend a sheet."""
    problems, paths = list(data["problems"].items()), []
    for sheet, first in enumerate(range(0, len(problems), PER_SHEET), start=1):
        figure, axes = plt.subplots(2, 3, figsize=(13, 9.2))
        some = problems[first : first + PER_SHEET]
        for (name, problem), place in zip(some, axes.flat, strict=False):
            draw(name, problem, place)
        for place in axes.flat[len(some) :]:
            place.set_visible(False)
        series = {parts(r["series"]) for _, problem in some for r in good(problem["rows"])}
        handles = [plt.Line2D([], [], color=c, marker="s", ls="", label=SHORT.get(b, b))
                   for b, c in BODY.items() if any(body == b for body, _ in series)]  # fmt: skip
        handles += [plt.Line2D([], [], color="0.3", marker=m, ls="", label=SHORT.get(i, i))
                    for i, m in INTEGRATOR.items() if any(other == i for _, other in series)]  # fmt: skip
        handles.append(plt.Line2D([], [], color="k", marker="o", mfc="none", ms=10, label="Pareto front"))
        if any(problem.get("tuned") for _, problem in some):
            handles.append(plt.Line2D([], [], color="magenta", marker="x", mew=2, ls="", label="chosen by fdem.tune"))
        m = data["machine"]
        figure.suptitle(
            f"Run time against error: {m['cpu']}, one thread, commit {m['commit']}, {m['date']}", fontsize=10
        )
        figure.legend(handles=handles, loc="lower center", ncol=7, fontsize=8)
        figure.tight_layout(rect=(0, 0.07, 1, 0.98))
        path = folder / f"precision_{sheet}.png"
        figure.savefig(path, dpi=100)
        plt.close(figure)
        paths.append(path)
    return paths


def table(data: dict[str, Any]) -> str:
    """Cheapest way to 1 % and to 0.1 %."""
    lines = [
        "| problem | compared | to 1 % | CPU s (wall) | error | to 0.1 % | CPU s (wall) | error |",
        "|" + "---|" * 8,
    ]
    for problem in data["problems"].values():
        cells = [problem["title"], problem["quantity"]]
        for level in LEVELS:
            row = cheapest(problem["rows"], level)
            if row is None:
                best = min(good(problem["rows"]), key=lambda r: r["error"])
                cells += [f"none; best: {named(best['series'])}", f"{best['cpu']:.3g} ({best['wall']:.3g})",
                          f"{best['error']:.1e}"]  # fmt: skip
            else:
                cells += [f"{named(row['series'])}; {numbers(row)}", f"{row['cpu']:.3g} ({row['wall']:.3g})",
                          f"{row['error']:.1e}"]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def order_table(data: dict[str, Any]) -> str:
    """Observed orders of convergence."""
    lines = ["| problem | series | in | observed order | points |", "|---|---|---|---|---|"]
    for problem in data["problems"].values():
        for o in problem["orders"]:
            shown = f"{o['order']:.2f}" + ("" if o["monotone"] else " (not monotone)")
            lines.append(f"| {problem['title']} | {named(o['series'])} | {o['knob']} | {shown} | {o['points']} |")
    return "\n".join(lines)


def tuned_table(data: dict[str, Any]) -> str:
    """What `fdem.tune` chose, against the cheapest setting of the table."""
    heads = ("problem", "asked", "chosen", "true error", "estimated", "CPU s", "best by hand", "ratio", "runs, CPU s")
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for problem in data["problems"].values():
        for t in problem.get("tuned", []):
            if t.get("failure"):
                lines.append(f"| {problem['title']} | {t['tolerance']:g} | {t['failure']} |" + " |" * 6)
                continue
            by_hand = f"{t['by_hand']:.3g}" if t["by_hand"] else "none"
            ratio = f"{t['cpu'] / t['by_hand']:.2f}" if t["by_hand"] else "-"
            cells = [problem["title"], f"{t['tolerance']:g}", t["settings"],
                     f"{t['true_error']:.1e}", f"{t['error']:.1e}",
                     f"{t['cpu']:.3g}", by_hand, ratio, f"{t['runs']}, {t['cost']:.3g}"]  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) if len(lines) > 2 else ""


def write(data: dict[str, Any], folder: Path) -> None:
    """Pictures, and the section of the README between its marks."""
    for problem in data["problems"].values():
        problem["orders"] = orders(problem["rows"])
    paths = sheets(data, folder)
    m = data["machine"]
    versions = ", ".join(f"{k} {v}" for k, v in m["versions"].items())
    text = [
        f"{m['cpu']}, {m['cores']} cores, one thread, load {m['load']:.1f}; Python {m['python']}, {versions}; commit "
        f"{m['commit']}, {m['date']}; {m['mode']} mode, medians of {m['repeats']} runs taken in turn.",
        *[f"![Run time against error, sheet {k}](results/{path.name})" for k, path in enumerate(paths, start=1)],
        "Cheapest way to 1 % and to 0.1 %:",
        table(data),
        "Observed orders:",
        order_table(data),
    ]
    if tuned := tuned_table(data):
        text += ["What `fdem.tune` chose for a requested error, knowing nothing of the answers:", tuned]
    readme = folder.parent / "README.md"
    begin, end = "<!-- precision: written by precision.py -->", "<!-- precision: end -->"
    old = readme.read_text()
    if begin in old:
        head, rest = old.split(begin)
        old_tail = rest.split(end)[1]
        readme.write_text(head + begin + "\n" + "\n\n".join(text) + "\n" + end + old_tail)
    print(table(data))
