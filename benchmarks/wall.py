"""Contact dynamics on a wall of rigid bricks, against LMGC90: steps per second from the second step on, first step.

    python benchmarks/wall.py [--quick]

Walls of 100 and 500 bricks (10 x 10, 25 x 20), dt = 1e-3 s, exactly touching at the start; one thread. Both run in
turn, three times; medians with their range. Compared is at the same quality: gaps of at most 1e-6 m, base force within
0.3 % of the weight, impulses within 1.7e-4 of the mean of the law (ours: 1e-6). LMGC90 runs with the Python named by
the environment variable LMGC90_PYTHON, or with this one if it has compas_lmgc90; else our figures stand beside those
measured before, on two cores of an AVX-512 x86 machine. Then the verdict on an arch of 27 voussoirs.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import warnings
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import fdem

HERE = Path(__file__).parent
BRICK, DENSITY, FRICTION, DT = np.array([0.4, 0.2, 0.2]), 2000.0, 0.6, 1e-3
MEASURED = {100: (34.6, 44.5), 500: (3.1, 3.7)}  # steps/s of LMGC90 before
CASES = {100: (10, 10, 100), 500: (25, 20, 40)}  # width, height, steps


def wall(width: int, height: int) -> fdem.Scene:
    """Running bond on a fixed slab."""
    scene = fdem.Scene()
    length = (width + 0.5) * BRICK[0]
    scene.add(fdem.brick((-1, -1, -0.5), (length + 1, 1, 0)), fdem.Rigid(), fixed=True, name="slab")
    for k in range(height):
        for i in range(width):
            low = np.array([(i + 0.5 * (k % 2)) * BRICK[0], -BRICK[1] / 2, k * BRICK[2]])
            scene.add(fdem.brick(low, low + BRICK), fdem.Rigid(), fdem.Elastic(DENSITY), group="bricks")
    scene.joint(fdem.Coulomb(friction=float(np.degrees(np.arctan(FRICTION)))))
    return scene


def ours(width: int, height: int, steps: int) -> dict[str, float]:
    """First step [s], rate [1/s], and how good the state is that is reached."""
    sim = fdem.Simulation(wall(width, height), fdem.ContactDynamics(dt=DT), progress=False)
    start = time.perf_counter()
    sim.cycle(1)
    first = time.perf_counter() - start
    start, iterations = time.perf_counter(), 0
    for _ in range(steps - 1):
        sim.cycle(1)
        iterations += sim.integrator.iterations
    seconds = time.perf_counter() - start
    table = sim.contact_table()
    weight = width * height * BRICK.prod() * DENSITY * 9.81
    return {
        "first": first,
        "rate": (steps - 1) / seconds,
        "points": len(table["gap"]),
        "gap": float(np.abs(table["gap"]).max()),
        "base": sim.pair_force("slab", "bricks")[2] / weight,
        "residual": sim.integrator.residual,
        "iterations": iterations / (steps - 1),
    }


def theirs(python: str, width: int, height: int, steps: int) -> dict[str, float]:
    """The same of LMGC90, in a process of its own: it holds one simulation."""
    command = [python, str(HERE / "lmgc90_wall.py"), str(width), str(height), str(steps), str(DT)]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    found: dict[str, float] = json.loads(next(line for line in lines if line.startswith("RESULT"))[7:])
    return found


def peer() -> str | None:
    """Python that has LMGC90."""
    return os.environ.get("LMGC90_PYTHON") or (sys.executable if find_spec("compas_lmgc90") else None)


def line(name: str, runs: list[dict[str, float]]) -> str:
    """Medians of some runs as text."""
    rates, last = [run["rate"] for run in runs], runs[-1]
    more = (
        f", residual {last['residual']:.1e}, {last['iterations']:.1f} iterations a step" if "residual" in last else ""
    )
    return (
        f"  {name}: {np.median(rates):.1f} steps/s ({min(rates):.1f} .. {max(rates):.1f}), first step "
        f"{np.median([run['first'] for run in runs]):.2f} s, {last['points']} points, gap {last['gap']:.1e} m, "
        f"base force / weight {last['base']:.6f}{more}"
    )


def walls(repeats: int) -> None:
    """Both in turn."""
    python = peer()
    ours(4, 4, 3)  # compiles the kernels
    for n, (width, height, steps) in CASES.items():
        mine, other = [], []
        for _ in range(repeats):
            mine.append(ours(width, height, steps))
            if python is not None:
                other.append(theirs(python, width, height, steps))
        print(f"wall of {n} bricks, dt = {DT:g} s")
        print(line("fdem", mine))
        rate = float(np.median([run["rate"] for run in mine]))
        if other:
            print(line("LMGC90", other))
            print(f"  ratio: {rate / np.median([run['rate'] for run in other]):.1f}")
        else:
            low, high = MEASURED[n]
            print(
                f"  LMGC90 is not here; measured before: {low} .. {high} steps/s; ratio {rate / high:.1f} to the best"
            )


def arches() -> None:
    """Seconds from the scene to the verdict: semicircular arch, mean radius 1 m, 27 voussoirs, mu = 0.7."""
    for eta in (0.15, 0.09):
        scene = fdem.Scene()
        scene.add(fdem.arch(2.0, 1.0, eta, 0.2, 27), fdem.Rigid(), fdem.Elastic(DENSITY))
        for x in (-1.0, 1.0):
            scene.add(fdem.brick((x - eta, -0.2, -0.2), (x + eta, 0.4, 0)), fdem.Rigid(), fixed=True)
        scene.joint(fdem.Coulomb(friction=float(np.degrees(np.arctan(0.7)))))
        start = time.perf_counter()
        sim = fdem.Simulation(scene, fdem.ContactDynamics(dt=1e-2), progress=False, energy=False)
        compiled = time.perf_counter() - start
        sim.cycle(1)
        verdict = "stands" if sim.integrator.at_rest(1e-5) else "falls"
        seconds = time.perf_counter() - start
        print(f"arch of 27 voussoirs, t/R = {eta}: {verdict}, {seconds:.2f} s, of which {compiled:.2f} s to compile")


if __name__ == "__main__":
    warnings.simplefilter("ignore", fdem.FdemWarning)
    walls(1 if "--quick" in sys.argv else 3)
    arches()
