"""A whole explicit step of a free block against its force kernel, one thread.

    python benchmarks/step.py

Both are timed in turn in one process, medians of 5. The bar is a step of at most 1.4 times the kernel at 100k zones.
"""

from __future__ import annotations

import itertools
import time
import warnings

import numpy as np

import fdem

REPEATS, STEPS = 5, 50


def cube(n: int) -> object:
    """Unit cube of n^3 cells, six zones each."""
    axis = np.arange(n + 1) / n
    points = np.array(list(itertools.product(axis, repeat=3)))
    zones = []
    for cell in itertools.product(range(n), repeat=3):
        for order in itertools.permutations(range(3)):
            corner, zone = list(cell), []
            for step in (None, *order):
                if step is not None:
                    corner[step] += 1
                zone.append((corner[0] * (n + 1) + corner[1]) * (n + 1) + corner[2])
            zones.append(zone)
    return fdem.tet_mesh(points, np.array(zones))


def main() -> None:
    """Print microseconds of kernel and step, and their ratio."""
    warnings.simplefilter("ignore", fdem.FdemWarning)
    for n in (10, 26):
        shape = cube(n)
        for strain in ("large", "small"):
            scene = fdem.Scene()
            scene.add(shape, fdem.Zoned(strain=strain), fdem.Elastic(1000.0, 1e6, 0.3), velocity=(0.1, 0, 0))
            sim = fdem.Simulation(scene, fdem.Explicit(), energy=False, progress=False)
            sim.cycle(20)
            batch, state = sim.model.deformable, sim.state
            kernel, step = [], []
            for _ in range(REPEATS):
                start = time.perf_counter()
                for _ in range(STEPS):
                    batch.internal(state.q, state.x, state.f)
                middle = time.perf_counter()
                sim.system.current = False
                sim.cycle(STEPS)
                kernel.append((middle - start) / STEPS * 1e6)
                step.append((time.perf_counter() - middle) / STEPS * 1e6)
            ratio = np.median(step) / np.median(kernel)
            spread = [f"{np.median(t):7.1f} us ({min(t):.1f} .. {max(t):.1f})" for t in (kernel, step)]
            print(f"{6 * n**3:7d} zones, {strain:5s}: kernel {spread[0]}, step {spread[1]}, ratio {ratio:.2f}")


if __name__ == "__main__":
    main()
