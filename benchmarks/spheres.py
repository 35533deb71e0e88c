"""Spheres settling in an open box, Hertz-Mindlin contact with history; beside LIGGGHTS where that is installed.

Particle steps per second of the settled bed (5 planes, restitution 0.3, friction 0.5), one thread. The two codes run in
turn, three times, and the medians are compared. Usage: spheres.py [number of spheres: 1000, 10000 or 50000]
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np

import fdem

RADIUS, DENSITY, YOUNG, POISSON, FRICTION, RESTITUTION, STEP = 0.01, 2600.0, 1e7, 0.3, 0.5, 0.3, 5e-5
SIZES = {1000: (10, 10, 10), 10000: (20, 20, 25), 50000: (40, 50, 25)}
SETTLE, TIMED, REPEATS = 6000, 1000, 3

LIGGGHTS = """atom_style granular
atom_modify map array
boundary f f f
newton off
communicate single vel yes
units si
read_data spheres.data
neighbor {skin} bin
neigh_modify delay 0
fix m1 all property/global youngsModulus peratomtype {young}
fix m2 all property/global poissonsRatio peratomtype {poisson}
fix m3 all property/global coefficientRestitution peratomtypepair 1 {restitution}
fix m4 all property/global coefficientFriction peratomtypepair 1 {friction}
pair_style gran model hertz tangential history
pair_coeff * *
timestep {step}
fix weight all gravity 9.81 vector 0.0 0.0 -1.0
fix z1 all wall/gran model hertz tangential history primitive type 1 zplane 0.0
fix x1 all wall/gran model hertz tangential history primitive type 1 xplane 0.0
fix x2 all wall/gran model hertz tangential history primitive type 1 xplane {x}
fix y1 all wall/gran model hertz tangential history primitive type 1 yplane 0.0
fix y2 all wall/gran model hertz tangential history primitive type 1 yplane {y}
fix move all nve/sphere
thermo 1000
thermo_modify lost error norm no
run {settle}
shell 'cat /proc/$PPID/stat > before'
run {timed}
shell 'cat /proc/$PPID/stat > after'
"""


def lattice(n: int) -> tuple[np.ndarray, tuple[float, float, float]]:
    """Centres (n, 3) of a jittered cubic lattice that does not touch yet, and the box it fills [m]."""
    nx, ny, nz = SIZES[n]
    pitch = 2.04 * RADIUS
    k, j, i = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
    centres = (np.stack([i, j, k], -1).reshape(-1, 3) + 0.5) * pitch
    centres += np.random.default_rng(1).uniform(-0.02, 0.02, centres.shape) * RADIUS
    return centres, (nx * pitch, ny * pitch, nz * pitch)


def scene(n: int) -> fdem.Scene:
    """The spheres in a box of five bricks of the same material."""
    centres, (x, y, z) = lattice(n)
    thick = 5.0 * RADIUS
    material = fdem.Elastic(density=DENSITY, young=YOUNG, poisson=POISSON)
    result = fdem.Scene()
    for lower, upper in (
        ((-thick, -thick, -thick), (x + thick, y + thick, 0)),
        ((-thick, -thick, 0), (0, y + thick, 2 * z)),
        ((x, -thick, 0), (x + thick, y + thick, 2 * z)),
        ((0, -thick, 0), (x, 0, 2 * z)),
        ((0, y, 0), (x, y + thick, 2 * z)),
    ):
        result.add(fdem.brick(lower, upper), fdem.Rigid(), material, fixed=True, group="box")
    result.add([fdem.sphere(RADIUS, c) for c in centres], fdem.Rigid(), material, group="bed")
    result.joint(fdem.Hertz(friction=float(np.degrees(np.arctan(FRICTION))), restitution=RESTITUTION))
    return result


def peer(n: int) -> tuple[float, float]:
    """Wall and CPU time of the timed steps of LIGGGHTS [s]."""
    centres, (x, y, z) = lattice(n)
    with tempfile.TemporaryDirectory() as folder:
        lines = [f"{i + 1} 1 {2 * RADIUS:g} {DENSITY:g} {a:.9g} {b:.9g} {c:.9g}" for i, (a, b, c) in enumerate(centres)]
        box = "".join(f"-0.001 {s:.9g} {d}lo {d}hi\n" for s, d in ((x + 0.001, "x"), (y + 0.001, "y"), (1.2 * z, "z")))
        head = f"spheres\n\n{n} atoms\n1 atom types\n\n{box}\nAtoms\n\n"
        Path(folder, "spheres.data").write_text(head + "\n".join(lines) + "\n")
        text = LIGGGHTS.format(
            skin=0.4 * RADIUS, young=YOUNG, poisson=POISSON, restitution=RESTITUTION, friction=FRICTION, step=STEP,
            x=x, y=y, settle=SETTLE, timed=TIMED,
        )  # fmt: skip
        Path(folder, "in.settle").write_text(text)
        done = subprocess.run(
            ["liggghts", "-in", "in.settle"], cwd=folder, capture_output=True, text=True, check=True,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        # user and system time in clock ticks (proc(5))
        ticks = [sum(map(int, Path(folder, name).read_text().split()[13:15])) for name in ("before", "after")]
    loops = [float(line.split()[3]) for line in done.stdout.splitlines() if line.startswith("Loop time of")]
    return loops[1], (ticks[1] - ticks[0]) / os.sysconf("SC_CLK_TCK")


def own(n: int) -> tuple[float, float, fdem.Simulation]:
    """Wall and CPU time of the timed steps [s], and the simulation."""
    sim = fdem.Simulation(scene(n), fdem.Explicit(dt=STEP), progress=False, energy=False)
    sim.cycle(SETTLE)
    wall, cpu = time.perf_counter(), time.process_time()
    sim.cycle(TIMED)
    return time.perf_counter() - wall, time.process_time() - cpu, sim


def line(name: str, n: int, wall: float, cpu: float) -> str:
    """One result."""
    return f"{name} {n * TIMED / wall / 1e6:.2f} M particle steps/s ({wall:.2f} s, {cpu:.2f} s CPU)"


def main() -> None:
    """Run and compare."""
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 10000
    known = shutil.which("liggghts") is not None
    ours, theirs = [], []
    for _ in range(REPEATS):
        *times, sim = own(n)
        ours.append(times)
        print(line("fdem", n, *times), flush=True)
        if known:
            theirs.append(peer(n))
            print(line("LIGGGHTS", n, *theirs[-1]), flush=True)
    weight = n * 4.0 / 3.0 * np.pi * RADIUS**3 * DENSITY * 9.81
    share = -sim["box"].contact_force[:, 2].sum() / weight
    print(f"{len(sim.contact_table()['gap'])} contacts; force on the box over the weight {share:.3f}")
    if known:
        walls, cpus = (median(a[k] for a in theirs) / median(a[k] for a in ours) for k in (0, 1))
        print(f"times LIGGGHTS: {walls:.2f} by wall time, {cpus:.2f} by CPU time")


if __name__ == "__main__":
    main()
