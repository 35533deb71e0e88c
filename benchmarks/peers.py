"""Other codes on the same cases: ratios of rates measured by turns, one table.

    python benchmarks/peers.py [--full] [--only spheres wall-explicit wall-hard wall-siconos flex arch]

Each comparison is a benchmark of its own; this runs them and collects the medians. Codes that are not installed are
listed as such. `install_peers.sh` installs those that come as Python packages into the folder .peers; LIGGGHTS, Yade
and Siconos come with the system. Writes results/peers.json and the section of README.md.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import reporting

import fdem

HERE = Path(__file__).parent
PEERS = HERE.parent / ".peers" / "bin" / "python"
ROUNDS = 3


def python_with(package: str) -> str | None:
    """A Python that can import the package: this one, that of the folder .peers, or the system's."""
    system = shutil.which("python3", path=os.defpath)
    for python in (sys.executable, os.environ.get(f"{package.upper()}_PYTHON"), str(PEERS), system):
        if python and Path(python).exists():
            code = f"import importlib.util as u, sys; sys.exit(u.find_spec({package!r}) is None)"
            if subprocess.run([python, "-c", code], check=False, capture_output=True).returncode == 0:
                return python
    return None


def row(
    case: str, peer: str, unit: str, ours: list[float], theirs: list[float], goal: float, note: str
) -> dict[str, Any]:
    """Medians of rates (larger is better), their ratio with its range, and what it should be."""
    ratios = sorted(a / b for a, b in zip(ours, theirs, strict=True))
    return {
        "case": case, "peer": peer, "unit": unit, "ours": statistics.median(ours), "theirs": statistics.median(theirs),
        "ratio": statistics.median(ours) / statistics.median(theirs), "range": [ratios[0], ratios[-1]], "goal": goal,
        "note": note,
    }  # fmt: skip


def absent(case: str, peer: str) -> dict[str, Any]:
    """The row of a code that is not here."""
    return {"case": case, "peer": peer, "note": "not installed here"}


def spheres(full: bool) -> Iterator[dict[str, Any]]:
    """Bed of spheres, Hertz-Mindlin with history (case S)."""
    import spheres as case

    n = 50_000 if full else 10_000
    name = f"{n} spheres settled in a box, Hertz-Mindlin with history"
    if shutil.which("liggghts") is None:
        yield absent(name, "LIGGGHTS")
        return
    ours, theirs = [], []
    for _ in range(ROUNDS):
        ours.append(n * case.TIMED / case.own(n)[1] / 1e6)
        theirs.append(n * case.TIMED / case.peer(n)[1] / 1e6)
    same = "same law, step, box and bed; CPU time"
    yield row(name, "LIGGGHTS", "M particle steps/s", ours, theirs, 2.5, same)


def wall_explicit(full: bool) -> Iterator[dict[str, Any]]:
    """Wall of 500 bricks, explicit, both with 1e10 Pa/m (case W)."""
    import contact as case

    name = "wall of 500 bricks, explicit"
    if shutil.which("yade") is None:
        yield absent(name, "Yade")
        return
    sim = fdem.Simulation(case.wall(25, 20), fdem.Explicit(damping=fdem.Local(0.3)), energy=False, progress=False)
    sim.cycle(500)
    ours, theirs, found = [], [], {}
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        sim.cycle(500)
        patches = sim.system.contacts.patches
        pairs = len(np.unique(patches.pair[patches.active_old > 0]))
        ours.append(pairs * 500 / (time.perf_counter() - begin) / 1e3)
        found = case.yade(25, 20, 100 if full else 60, 20)
        if found is None:
            yield absent(name, "Yade")
            return
        theirs.append(found["pairs"] / found["seconds_per_step"] / 1e3)
    note = f"pairs closed {pairs} and {found['pairs']}, same stiffness per area, both below their stable step"
    yield row(name, "Yade polyhedra", "k pair steps/s", ours, theirs, 60, note)


def wall_hard(full: bool) -> Iterator[dict[str, Any]]:
    """Walls by contact dynamics (case W)."""
    import wall as case

    python = python_with("compas_lmgc90")
    for n, (width, height, steps) in case.CASES.items():
        name = f"wall of {n} bricks, contact dynamics"
        if python is None:
            yield absent(name, "LMGC90")
            continue
        case.ours(4, 4, 3)
        mine, other = [], []
        for _ in range(ROUNDS):
            mine.append(case.ours(width, height, steps))
            other.append(case.theirs(python, width, height, steps))
        bases = [abs(runs[-1]["base"] - 1) for runs in (mine, other)]
        firsts = [statistics.median(r["first"] for r in runs) for runs in (mine, other)]
        note = (
            f"base force / weight off by {bases[0]:.1e} and {bases[1]:.1e}; first step {firsts[0]:.2f} and "
            f"{firsts[1]:.2f} s"
        )
        rates = [[run["rate"] for run in runs] for runs in (mine, other)]
        yield row(name, "LMGC90", "steps/s", *rates, 5, note)


def wall_siconos(full: bool) -> Iterator[dict[str, Any]]:
    """The wall of 100 bricks by contact dynamics against Siconos, which takes a second a step."""
    import wall as case

    python, name = python_with("siconos"), "wall of 100 bricks, contact dynamics"
    if python is None:
        yield absent(name, "Siconos")
        return
    width, height, steps = case.CASES[100]
    command = [
        python,
        str(HERE / "siconos_wall.py"),
        str(width),
        str(height),
        "30" if full else "10",
        str(case.DT),
        "1e-4",
    ]
    case.ours(4, 4, 3)
    mine, other = [], []
    for _ in range(ROUNDS):
        mine.append(case.ours(width, height, steps))
        lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        other.append(json.loads(next(line for line in lines if line.startswith("RESULT"))[7:]))
    bases = [abs(runs[-1]["base"] - 1) for runs in (mine, other)]
    note = f"base force / weight off by {bases[0]:.1e} and {bases[1]:.1e}; Siconos stops at 1e-4, fdem at 1e-9"
    rates = [[run["rate"] for run in runs] for runs in (mine, other)]
    yield row(name, "Siconos", "steps/s", *rates, 1, note)


def flex(full: bool) -> Iterator[dict[str, Any]]:
    """Soft tetrahedra on a plane."""
    import flex as case

    python, steps = python_with("mujoco"), 1000 if full else 300
    if python is None:
        yield absent("6000 soft tetrahedra on a plane, explicit", "MuJoCo flex")
        return
    codes = {strain: case.fdem_steps(strain)[0] for strain in ("large", "small")}
    rates: dict[str, list[float]] = {name: [] for name in (*codes, "theirs")}
    for _ in range(ROUNDS):
        for name, run in codes.items():
            run(10)
            begin = time.perf_counter()
            run(steps)
            rates[name].append(6e-6 * case.CELLS**3 * steps / (time.perf_counter() - begin))
        done = subprocess.run(
            [python, str(HERE / "flex_peer.py"), str(steps)], capture_output=True, text=True, check=True
        )
        peer, seconds = json.loads(done.stdout.strip().splitlines()[-1])
        rates["theirs"].append(6e-6 * case.CELLS**3 * steps / seconds)
    for strain, goal in (("large", 4), ("small", 5)):
        name = f"6000 soft tetrahedra on a plane, explicit, {strain} strain"
        yield row(name, peer, "Mtet steps/s", rates[strain], rates["theirs"], goal, "same step of 1e-5 s and mesh")


def arch(full: bool) -> Iterator[dict[str, Any]]:
    """Does an arch of 27 voussoirs stand? Contact dynamics against static optimisation (case A)."""
    python = python_with("compas_cra")
    name = "arch of 27 voussoirs, t/R = 0.15: verdict"
    if python is None:
        yield absent(name, "compas_cra")
        return
    ours, theirs = [], []
    for _ in range(ROUNDS + 1):  # the first one loads the kernels
        scene = fdem.Scene()
        scene.add(fdem.arch(2.0, 1.0, 0.15, 0.2, 27), fdem.Rigid(), fdem.Elastic(2000.0))
        for x in (-1.0, 1.0):
            scene.add(fdem.brick((x - 0.15, -0.2, -0.2), (x + 0.15, 0.4, 0)), fdem.Rigid(), fixed=True)
        scene.joint(fdem.Coulomb(friction=float(np.degrees(np.arctan(0.7)))))
        begin = time.perf_counter()
        sim = fdem.Simulation(scene, fdem.ContactDynamics(dt=1e-2), progress=False, energy=False)
        sim.cycle(1)
        stands = sim.integrator.at_rest(1e-5)
        ours.append(1 / (time.perf_counter() - begin))
        done = subprocess.run([python, str(HERE / "cra_arch.py")], capture_output=True, text=True, check=True)
        found = json.loads(done.stdout.strip().splitlines()[-1])
        theirs.append(1 / found["seconds"])
    ours, theirs = ours[1:], theirs[1:]
    note = f"verdicts: {'stands' if stands else 'falls'} and {found['verdict']}; other methods; set-up included"
    yield row(name, "compas_cra", "verdicts/s", ours, theirs, 1, note)


COMPARISONS = {
    "spheres": spheres, "wall-explicit": wall_explicit, "wall-hard": wall_hard, "wall-siconos": wall_siconos,
    "flex": flex, "arch": arch,
}  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """For people."""
    lines = []
    for r in rows:
        if "ratio" not in r:
            lines.append([r["case"], r["peer"], None, None, None, None, None, r["note"]])
            continue
        low, high = r["range"]
        reached = "reached" if r["ratio"] >= r["goal"] else "MISSED"
        lines.append([
            r["case"], r["peer"], f"{r['ours']:.3g} {r['unit']}", f"{r['theirs']:.3g}", f"{r['ratio']:.2f}",
            f"{low:.2f} .. {high:.2f}", f">= {r['goal']:g}: {reached}", r["note"],
        ])  # fmt: skip
    head = ["case", "peer", "fdem", "peer's", "ratio of medians", "range", "goal", "conditions"]
    return reporting.table(head, lines)


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="50 000 spheres, longer runs")
    parser.add_argument("--only", nargs="*", choices=list(COMPARISONS), help="these alone, nothing is written")
    options = parser.parse_args()
    warnings.simplefilter("ignore", fdem.FdemWarning)
    rows = []
    for name in options.only or COMPARISONS:
        try:
            rows += list(COMPARISONS[name](options.full))
        except (subprocess.CalledProcessError, OSError, ValueError) as error:
            said = getattr(error, "stderr", None) or str(error)
            rows.append({"case": name, "peer": "", "note": f"did not run: {said.strip().splitlines()[-1][:120]}"})
        print(f"{name} done", flush=True)
    text = table(rows)
    print(text)
    if not options.only:
        facts = reporting.machine()
        reporting.keep("peers", {"machine": facts, "full": options.full, "rows": rows})
        words = f"{reporting.caption(facts)} One thread each, in turn, medians of {ROUNDS}."
        reporting.section("peers", "Other codes", f"{words}\n\n{text}")


if __name__ == "__main__":
    main()
