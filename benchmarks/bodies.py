"""A thousand blocks of every formulation: what a step costs, against rigid ones, one thread.

    python benchmarks/bodies.py

Blocks that fly apart and a wall in running bond at rest, explicit; all bodies in turn in one process, medians of 5.
The bar is a uniform-strain step of at most 3 times the rigid one. Then what it takes to compile 2000 rigid bricks.
"""

from __future__ import annotations

import statistics
import time
import tracemalloc
import warnings

import numpy as np

import fdem

REPEATS, STEPS = 5, 50
BODIES = {"rigid": fdem.Rigid(), "uniform": fdem.UniformStrain(), "linear": fdem.LinearStrain(), "zoned": fdem.Zoned()}
ROCK = fdem.Elastic(2500.0, 1e10, 0.2)


def flying(body: object) -> fdem.Simulation:
    """A cloud of 10 x 10 x 10 spinning cubes that never meet."""
    scene = fdem.Scene()
    for place in np.ndindex(10, 10, 10):
        lower = 1.5 * np.array(place)
        scene.add(fdem.brick(lower, lower + 1), body, ROCK, angular_velocity=(0.1, 0.2, 0.3))
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    return fdem.Simulation(scene, fdem.Explicit(), energy=False, progress=False)


def wall(body: object) -> fdem.Simulation:
    """A wall of 25 courses of about 40 bricks on a fixed base."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (41, 2, 0)), fdem.Rigid(), fixed=True)
    scene.add(fdem.wall(40.0, 12.5, 0.5, (1.0, 0.5, 0.5)), body, ROCK)
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
    return fdem.Simulation(scene, fdem.Explicit(), energy=False, progress=False)


def bricks() -> fdem.Scene:
    """Eighty courses of 25 rigid bricks on a base."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (26, 2, 0)), fdem.Rigid(), fixed=True)
    scene.add(fdem.wall(25.0, 40.0, 0.5, (1.0, 0.5, 0.5)), fdem.Rigid(), ROCK)
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
    return scene


def compilation() -> None:
    """Print processor time and memory to compile a brick."""
    spent = []
    for _ in range(REPEATS):
        scene = bricks()
        start = time.process_time()
        sim = fdem.Simulation(scene, fdem.Explicit(), progress=False)
        spent.append((time.process_time() - start) / sim.model.n_blocks * 1e3)
    scene = bricks()
    tracemalloc.start()
    sim = fdem.Simulation(scene, fdem.Explicit(), progress=False)
    kept, most = (size / sim.model.n_blocks / 1e3 for size in tracemalloc.get_traced_memory())
    tracemalloc.stop()
    print(
        f"compiling {sim.model.n_blocks} rigid bricks: {statistics.median(spent):.2f} ms, {kept:.1f} kB kept "
        f"({most:.1f} kB at most) per brick"
    )


def main() -> None:
    """Print microseconds a step and ratios to the rigid step."""
    warnings.simplefilter("ignore", fdem.FdemWarning)
    for name, make in (("flying", flying), ("wall", wall)):
        sims = {body: make(kind) for body, kind in BODIES.items()}
        times: dict[str, list[float]] = {body: [] for body in BODIES}
        for sim in sims.values():
            sim.cycle(20)
        for _ in range(REPEATS):
            for body, sim in sims.items():
                start = time.perf_counter()
                sim.cycle(STEPS)
                times[body].append((time.perf_counter() - start) / STEPS * 1e6)
        rigid = np.median(times["rigid"])
        blocks = sims["rigid"].model.n_blocks
        for body, spent in times.items():
            patches = sims[body].system.contacts.n_patches
            print(
                f"{name:6s} {blocks} blocks, {body:7s}: step {np.median(spent):8.1f} us ({min(spent):.1f} .. "
                f"{max(spent):.1f}), {patches} patches, ratio {np.median(spent) / rigid:.2f}"
            )
    compilation()


if __name__ == "__main__":
    main()
