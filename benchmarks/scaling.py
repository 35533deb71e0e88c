"""Cost per step and memory against size, set-up apart, one and two threads; cold and warm start.

    python benchmarks/scaling.py [--full] [--runs 3] [--only zones blocks contacts spheres jointed start]

Every size runs in a process of its own, so that its memory is its own. Times are CPU seconds of one thread; those of
two threads are wall times (the same work on two cores). All sizes run several times in turn and the run with the
cheapest step counts: what others do to the caches of the machine only ever adds, and it adds most to large models
(one run each gave exponents of patches of 0.99 to 1.11). Exponents are those of least squares over the sizes of 4000
and more (below, what a step costs in any case hides it). Writes results/scaling.json, results/scaling.png and the
section of README.md.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import reporting

import fdem

QUICK = {
    "zones": [1_000, 4_000, 16_000, 64_000],
    "blocks": [10, 100, 1_000, 4_000],
    "contacts": [1_000, 4_000, 16_000, 32_000],
    "spheres": [1_000, 4_000, 16_000],
}
FULL = {
    "zones": [1_000, 4_000, 16_000, 64_000, 250_000, 1_000_000],
    "blocks": [10, 100, 1_000, 4_000, 10_000],
    "contacts": [1_000, 4_000, 16_000, 64_000, 250_000, 1_000_000],
    "spheres": [1_000, 4_000, 16_000, 64_000, 100_000],
}
LARGE = 4000  # exponents count from here
BAR = 1.05
ROCK = fdem.Elastic(2500.0, 1e10, 0.2)
JOINT = fdem.Coulomb(kn=1e10, ks=5e9, friction=30)


def zones(n: int, threads: int) -> Callable[[], fdem.Simulation]:
    """A free cube of so many tetrahedra that breathes."""
    from stress.meshes import box

    cells = round((n / 6) ** (1 / 3))
    shape = box((cells,) * 3, (1.0, 1.0, 1.0))
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(shape, fdem.Zoned(mass="row-sum"), ROCK, velocity=(0.1, 0, 0))
    return lambda: compiled(scene, threads)


def blocks(n: int, threads: int) -> Callable[[], fdem.Simulation]:
    """A wall in running bond of so many rigid bricks, four times as long as it is high in bricks."""
    courses = max(2, round((n / 2) ** 0.5))
    scene = fdem.Scene()
    shapes = fdem.wall(0.2 * max(2, n // courses), 0.1 * courses, 0.1, (0.2, 0.1, 0.1))
    scene.add(shapes, fdem.Rigid(), ROCK)
    scene.add(fdem.brick((-1, -1, -1), (0.2 * n + 1, 1.1, 0)), fdem.Rigid(), fixed=True)
    scene.joint(JOINT)
    return lambda: compiled(scene, threads)


def contacts(n: int, threads: int) -> Callable[[], fdem.Simulation]:
    """Two zoned plates of different meshes lie on each other: so many patches of contact."""
    from stress.meshes import box

    cells = max(3, round((n / 7.6) ** 0.5))
    scene = fdem.Scene()
    low = scene.add(box((cells, cells, 1), (1, 1, 0), (0, 0, -0.2)), fdem.Zoned(mass="row-sum"), ROCK)
    scene.fix(low, component=("x", "y", "z"), where=lambda x: x[:, 2] < -0.1)
    scene.add(box((cells + 3, cells + 3, 1), (1, 1, 0.2)), fdem.Zoned(mass="row-sum"), ROCK)
    scene.joint(JOINT)
    return lambda: compiled(scene, threads)


def spheres(n: int, threads: int) -> Callable[[], fdem.Simulation]:
    """Spheres on a jittered lattice that overlap a little in an open box: a bed at rest."""
    edge, radius = round((n / 1.5) ** (1 / 3)), 0.01
    counts = (edge, edge, max(1, round(n / edge**2)))
    grid = np.stack(np.meshgrid(*(np.arange(c) for c in counts), indexing="ij"), -1).reshape(-1, 3)
    centres = (2 * grid + 1.0) * radius + np.random.default_rng(1).uniform(-0.01, 0.01, grid.shape) * radius
    scene = fdem.Scene()
    size, thick = 2 * radius * np.array(counts), 5 * radius
    scene.add(fdem.brick((-thick, -thick, -thick), (*(size[:2] + thick), 0)), fdem.Rigid(), ROCK, fixed=True)
    scene.add([fdem.sphere(radius, c) for c in centres], fdem.Rigid(), fdem.Elastic(2600.0, 1e7, 0.3))
    scene.joint(fdem.Hertz(friction=26.6, restitution=0.3))
    return lambda: compiled(scene, threads)


def cut_rock(n: int) -> list[Any]:
    """Pieces of a cube cut by three joint sets, about `n`."""
    side = 20.0
    spacing = 1.05 * side / n ** (1 / 3)
    shapes = [fdem.brick((0, 0, 0), (side, side, side))]
    for dip, direction in ((75, 40), (65, 150), (15, 280)):
        shapes = fdem.cut(shapes, fdem.JointSet(dip, direction, spacing=spacing, origin=(9.7, 10.2, 9.9)))
    return shapes


def compiled(scene: fdem.Scene, threads: int) -> fdem.Simulation:
    """Explicit, without a ledger."""
    return fdem.Simulation(scene, fdem.Explicit(), energy=False, progress=False, threads=threads)


KINDS = {"zones": zones, "blocks": blocks, "contacts": contacts, "spheres": spheres}
COUNTED = {
    "zones": lambda sim: len(sim.model.zones),
    "blocks": lambda sim: sim.model.n_blocks,
    "contacts": lambda sim: sim.system.contacts.n_patches,
    "spheres": lambda sim: sim.model.n_blocks - 1,
}


def clocked() -> dict[str, float]:
    """CPU seconds of detection while compiling: broad phase, cut and tables of all contacts."""
    from fdem.contact.contacts import Contacts
    from fdem.contact.spheres import SphereContacts

    spent = {"detection": 0.0}

    def timed(make: Any) -> Any:
        def measured(self: Any, *args: Any, **given: Any) -> None:
            start = time.process_time()
            make(self, *args, **given)
            spent["detection"] += time.process_time() - start

        return measured

    for kind in (Contacts, SphereContacts):
        kind.__init__ = timed(kind.__init__)
    return spent


def child(kind: str, n: int, threads: int) -> dict[str, Any]:
    """One size: seconds of scene, compile (detection in it), a step; memory."""
    warnings.simplefilter("ignore", fdem.FdemWarning)
    if threads == 1:
        KINDS[kind](min(n, 500), 1)().cycle(3)  # kernels are loaded
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    make = KINDS[kind](n, threads)
    made = time.process_time()
    spent = clocked()
    sim = make()
    done = time.process_time()
    detection = spent["detection"]
    sim.cycle(3)
    clock = time.process_time if threads == 1 else time.perf_counter
    costs, steps = [], 1
    while len(costs) < 5:
        begin = clock()
        sim.cycle(steps)
        cost = clock() - begin
        if cost < 0.05 and not costs:
            steps = max(steps + 1, int(steps * 0.08 / max(cost, 1e-4)))
            continue
        costs.append(cost / steps)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "kind": kind, "asked": n, "n": COUNTED[kind](sim), "threads": threads, "step": float(np.median(costs)),
        "scene": made - start, "compile": done - made - detection, "detection": detection,
        "memory": 1024 * (memory - before),
    }  # fmt: skip


def jointed(n: int) -> dict[str, Any]:
    """Rigid blocks cut by three joint sets: cutting, scene, compile, the first steps; memory of the whole process."""
    warnings.simplefilter("ignore", fdem.FdemWarning)
    marks = [time.process_time()]
    wall = time.perf_counter()
    shapes = cut_rock(n)
    marks.append(time.process_time())
    scene = fdem.Scene()
    for shape in shapes:
        scene.add(shape, fdem.Rigid(), ROCK, fixed=bool(shape.centroid[2] < 1.0))
    scene.joint(JOINT)
    marks.append(time.process_time())
    sim = fdem.Simulation(scene, fdem.Relaxation(), energy=False, progress=False)
    marks.append(time.process_time())
    sim.cycle(10)
    marks.append(time.process_time())
    names = ("cutting", "scene", "compile", "ten steps")
    return dict(zip(names, np.diff(marks).tolist(), strict=True)) | {
        "n": len(shapes), "patches": sim.system.contacts.n_patches, "wall": time.perf_counter() - wall,
        "memory": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }  # fmt: skip


def starts() -> dict[str, float]:
    """CPU seconds of examples/incline.py without and with compiled kernels on disk."""
    script = reporting.HERE.parent / "examples" / "incline.py"
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder, "fdem")
        shutil.copytree(reporting.HERE.parent / "fdem", copy, ignore=shutil.ignore_patterns("__pycache__"))
        found = {}
        for name in ("cold", "warm"):
            env = os.environ | {"PYTHONPATH": folder, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
                                "MPLBACKEND": "Agg"}  # fmt: skip
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            begin = time.perf_counter()
            subprocess.run([sys.executable, str(script)], cwd=folder, env=env, check=True, capture_output=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            found[name] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            found[f"{name} wall"] = time.perf_counter() - begin
    return found


def apart(*arguments: str) -> dict[str, Any] | None:
    """Result of this script in a process of its own; None, with what it said, if that fails."""
    threads = arguments[3] if arguments[0] == "--child" and len(arguments) > 3 else "1"
    env = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": threads}
    done = subprocess.run([sys.executable, __file__, *arguments], capture_output=True, text=True, env=env, check=False)
    if done.returncode:
        print(f"  {' '.join(arguments)}: {done.stderr.strip().splitlines()[-1:]}", flush=True)
        return None
    return json.loads(done.stdout.strip().splitlines()[-1])


def main() -> None:
    """Measure, fit, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="up to a million zones and contacts, 100k spheres")
    parser.add_argument(
        "--only", nargs="*", choices=[*KINDS, "jointed", "start"], help="these alone, nothing is written"
    )
    parser.add_argument("--runs", type=int, default=3, help="of every size, in turn; the cheapest counts")
    parser.add_argument("--child", nargs=3, metavar=("KIND", "SIZE", "THREADS"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        kind, n, threads = options.child
        print(json.dumps(jointed(int(n)) if kind == "jointed" else child(kind, int(n), int(threads))))
        return
    from scaling_report import draw, report

    wanted, best = options.only or [*KINDS, "jointed", "start"], {}
    for kind, sizes in (FULL if options.full else QUICK).items():
        # two threads where there is work for them
        cases = [(n, 1) for n in sizes] + ([(sizes[-1], 2)] if kind != "blocks" else [])
        for n, threads in cases * options.runs if kind in wanted else []:
            if (row := apart("--child", kind, str(n), str(threads))) is not None:
                best[kind, n, threads] = min(row, best.get((kind, n, threads), row), key=itemgetter("step"))
                print(
                    f"{kind:9s} {row['n']:8d} x {threads} threads: step {1e3 * row['step']:9.3f} ms, scene "
                    f"{row['scene']:6.2f} s, compile {row['compile']:6.2f} s, detection {row['detection']:6.2f} s, "
                    f"{row['memory'] / 1e6:7.1f} MB", flush=True,
                )  # fmt: skip
    rows = list(best.values())
    data: dict[str, Any] = {"machine": reporting.machine(), "full": options.full, "rows": rows}
    if "jointed" in wanted:
        data["jointed"] = [apart("--child", "jointed", str(n), "1") for n in (1_000, 4_000, 10_000)]
    if "start" in wanted:
        data["start"] = starts()
    text = report(data, LARGE, BAR)
    print(text)
    if not options.only:
        reporting.keep("scaling", data)
        draw(data, reporting.RESULTS / "scaling.png")
        reporting.section("scaling", "Cost against size", f"{reporting.caption(data['machine'])}\n\n{text}")


if __name__ == "__main__":
    main()
