"""6000 soft tetrahedra on a rigid plane, fdem against MuJoCo flex, both explicit, in tet-steps per second.

A block of 10 x 10 x 10 cells of 0.05 m, six tetrahedra each (E = 1 MPa, nu = 0.3, 1000 kg/m^3), starts on the plane
and is loaded by gravity with steps of 1e-5 s. Both codes run in one process, turn by turn, on one thread; the figures
are medians. MuJoCo (package ``mujoco``) is optional: without it only fdem is timed.

Usage: ``python benchmarks/flex.py [steps]``
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from itertools import permutations

import numpy as np
from flex_peer import CELLS, DENSITY, DT, EDGE, POISSON, YOUNG, mujoco_steps

import fdem

ROUNDS = 3


def grid() -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and tetrahedra (6 cells, 4): every cell has six around its diagonal (Kuhn)."""
    n = CELLS + 1
    points = EDGE * np.stack(np.meshgrid(*3 * [np.arange(n)], indexing="ij"), axis=-1).reshape(-1, 3)
    step = np.array([n * n, n, 1])
    first = (np.stack(np.meshgrid(*3 * [np.arange(CELLS)], indexing="ij"), axis=-1).reshape(-1, 3) * step).sum(axis=1)
    tets = np.concatenate(
        [first[:, None] + np.append(0, np.cumsum(step[list(order)])) for order in permutations(range(3))]
    )
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    left = np.linalg.det(edges) < 0
    tets[left] = tets[left][:, [0, 1, 3, 2]]
    return points, tets


def fdem_steps(strain: str) -> tuple[Callable[[int], None], str]:
    """Return a function that runs so many steps of fdem, and what it is."""
    scene = fdem.Scene()
    side = CELLS * EDGE
    scene.add(fdem.brick((-side, -side, -0.1), (2 * side, 2 * side, 0)), fdem.Rigid(), name="plane", fixed=True)
    soft = fdem.Elastic(density=DENSITY, young=YOUNG, poisson=POISSON)
    scene.add(fdem.tet_mesh(*grid()), fdem.Zoned(strain=strain), soft, name="block")
    scene.joint(fdem.Coulomb(kn=5 * YOUNG / EDGE, ks=2 * YOUNG / EDGE, friction=30))
    # MuJoCo keeps no energy ledger either
    sim = fdem.Simulation(scene, fdem.Explicit(dt=DT), threads=1, energy=False)
    return sim.cycle, f"fdem, strain={strain!r}"


def main() -> None:
    """Time all codes turn by turn and print the table."""
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    codes = [fdem_steps("large"), fdem_steps("small")]
    try:
        codes.append(mujoco_steps())
    except ImportError:
        print("MuJoCo is not installed: pip install mujoco")
    for run, _ in codes:
        run(10)
    seconds: dict[str, list[float]] = {name: [] for _, name in codes}
    for _ in range(ROUNDS):
        for run, name in codes:
            start = time.perf_counter()
            run(steps)
            seconds[name].append(time.perf_counter() - start)
    rates = {name: 6 * CELLS**3 * steps / statistics.median(taken) for name, taken in seconds.items()}
    peer = next((rate for name, rate in rates.items() if name.startswith("MuJoCo")), None)
    print(f"{6 * CELLS**3} tets on a plane, {steps} steps of {DT} s, median of {ROUNDS}, one thread")
    for name, rate in rates.items():
        ratio = f"{rate / peer:6.2f} x" if peer else ""
        spread = min(seconds[name]), max(seconds[name])
        print(f"{name:28s} {rate / 1e6:8.2f} Mtet-steps/s {ratio}   ({spread[0]:.2f} .. {spread[1]:.2f} s)")


if __name__ == "__main__":
    main()
