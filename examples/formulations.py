"""A slab on two pillars, moved in four ways: what each of them knows about bending, and what it costs.

    python examples/formulations.py [picture folder]

The formulation is one argument of `scene.add`. Statics holds for all: a pillar carries half the slab. Bending does not:
a rigid block and one of uniform strain stay straight, a block of linear strain has one curvature (a closed form, four
fifths of the beam's deflection), and zones come near the beam from below, the nearer the more of them lie across it.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Iterable
from pathlib import Path

import numpy as np

import fdem

SPAN, DEPTH, WIDTH, PILLAR = 8.0, 1.0, 0.5, 0.1
YOUNG, DENSITY = 10e9, 2500.0
LENGTH = SPAN + PILLAR  # the slab ends where the pillars do
LINE, AREA = 9.81 * DENSITY * DEPTH * WIDTH, DEPTH * WIDTH
EI, GA = YOUNG * WIDTH * DEPTH**3 / 12, YOUNG / 2 * AREA  # Poisson's ratio is 0
BODIES = {
    "rigid": fdem.Rigid(),
    "uniform": fdem.UniformStrain(),
    "linear": fdem.LinearStrain(size=0.5),
    "zoned": fdem.Zoned(size=DEPTH / 4),
}
# deflection and tension of the beam (Timoshenko), and of the least energy among fields of second degree, whose
# curvature, of bending and in all, is one number along the slab
BEAM = 5 * LINE * SPAN**4 / (384 * EI) + LINE * SPAN**2 / (8 * GA * 5 / 6), LINE * SPAN**2 / 8 * 6 / (AREA * DEPTH)
BENT = LINE * (SPAN**2 / 4 - LENGTH**2 / 12) / (2 * EI)
ONE_CURVATURE = (BENT + 12 * EI * BENT / (GA * LENGTH**2)) * SPAN**2 / 8, YOUNG * BENT * DEPTH / 2


def slab(y: float) -> fdem.Shape:
    """The slab from `y` on, with gridpoints in its middle and over the pillars whatever moves it."""
    x = np.array([-LENGTH, -SPAN, 0.0, SPAN, LENGTH]) / 2
    outline = np.vstack([np.column_stack([x, 0 * x]), np.column_stack([x[::-1], 0 * x + DEPTH])])
    place = np.eye(4)
    place[1, 3] = y
    return fdem.prism(outline, WIDTH, axis="y").transform(place)


def lanes(names: Iterable[str]) -> fdem.Simulation:
    """Slabs side by side, each on two fixed pillars."""
    scene = fdem.Scene()
    for k, name in enumerate(names):
        y = 4.0 * WIDTH * k
        for side, x in (("left", -SPAN / 2), ("right", SPAN / 2)):
            pillar = fdem.brick((x - PILLAR / 2, y, -1.0), (x + PILLAR / 2, y + WIDTH, 0.0))
            scene.add(pillar, fdem.Rigid(), fixed=True, name=f"{name} {side}")
        scene.add(slab(y), BODIES[name], fdem.Elastic(DENSITY, YOUNG, 0.0), name=name)
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e6, friction=30))  # soft in shear: no thrust to speak of
    return fdem.Simulation(scene, fdem.Relaxation(damping=fdem.Adaptive()))


def deflection(sim: fdem.Simulation, name: str) -> float:
    """How far the middle of a slab hangs below its ends [m]."""
    moved = sim[name].gridpoint_displacement
    start = sim[name].gridpoints - moved
    low = np.abs(start[:, 2]) < 1e-6
    left, middle, right = (moved[low & (np.abs(start[:, 0] - x) < 1e-6), 2].mean() for x in (-SPAN / 2, 0, SPAN / 2))
    return float((left + right) / 2 - middle)


def tension(sim: fdem.Simulation, name: str) -> float:
    """Largest tension along a slab [Pa]; not a number where the formulation has no stress."""
    mesh = sim.mesh()
    along = mesh.cell_data["stress"][mesh.cell_data["block"] == sim.model.names.index(name), 0]
    return float(along.max())


def cost(name: str) -> float:
    """Time of a step of one such slab alone [s]."""
    sim = lanes([name])
    sim.cycle(20)
    start = time.perf_counter()
    sim.cycle(200)
    return (time.perf_counter() - start) / 200


def main(folder: Path = Path("out")) -> float:
    """Print the table; return the largest relative error against closed forms: pillars, straightness, one curvature."""
    warnings.simplefilter("ignore", fdem.FdemWarning)  # coarse zones: lumped inertia
    sim = lanes(BODIES)
    report = sim.solve(ratio=1e-6)
    if report.reason != "equilibrium":
        raise SystemExit(f"the slabs should come to rest, but the run ended with {report}")
    print("          unknowns  deflection [mm]  tension [MPa]  pillar [kN]  step [us]")
    print(f"{'beam':8s} {'':9s} {1e3 * BEAM[0]:15.3f} {1e-6 * BEAM[1]:14.3f} {LINE * LENGTH / 2e3:13.3f}")
    errors = []
    for name in BODIES:
        hangs, pulls, push = deflection(sim, name), tension(sim, name), sim.pair_force(f"{name} left", name)[2]
        shown = "none" if np.isnan(pulls) else f"{1e-6 * pulls:.3f}"
        print(
            f"{name:8s} {len(sim[name].generalised_force):9d} {1e3 * hangs:15.3f} {shown:>14s} "
            f"{push / 1e3:13.3f} {1e6 * cost(name):10.0f}"
        )
        exact = {"rigid": 0.0, "uniform": 0.0, "linear": ONE_CURVATURE[0]}.get(name, hangs)
        errors += [abs(push / (LINE * LENGTH / 2) - 1), abs(hangs - exact) / BEAM[0]]
        if name == "linear":
            errors.append(abs(pulls / ONE_CURVATURE[1] - 1))
    if not 0.8 * BEAM[0] < hangs < BEAM[0]:
        raise SystemExit(f"zones should bend a little less than the beam, but they hang {hangs:g} m")
    folder.mkdir(parents=True, exist_ok=True)
    look = {"component": "xx", "camera": (0.3, -1.0, 0.7), "title": "Stress along slabs: rigid, uniform, linear, zoned"}
    sim.plot(folder / "formulations.png", "stress", 300.0, **look)
    return max(errors)


if __name__ == "__main__":
    print(f"largest error against closed forms: {main(*map(Path, sys.argv[1:])):.2e}")
