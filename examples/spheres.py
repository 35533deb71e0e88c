"""A bed of 1500 spheres and clumps settles on a deformable plate: what the plate carries against statics.

    python examples/spheres.py [picture folder]

Walls without friction carry no weight, so the plate carries all of it, and bends a little. The bed falls and comes to
rest in real time, then `Relaxation` takes out the last motion.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import fdem

RADIUS, SIDE, LAYERS = 0.01, 10, 15
STONE = fdem.Elastic(density=2600, young=1e7, poisson=0.25)  # soft: what matters here does not depend on it
PLATE = fdem.Elastic(density=1200, young=1e7, poisson=0.3)


def bed() -> tuple[list, float, float]:
    """Spheres, every third one replaced by a clump of two, on a loose lattice; width and height of their box [m]."""
    pitch = 2.06 * RADIUS
    rng = np.random.default_rng(1)
    k, j, i = np.meshgrid(np.arange(LAYERS), np.arange(SIDE), np.arange(SIDE), indexing="ij")
    centres = (np.stack([i, j, k], -1).reshape(-1, 3) + 0.5) * pitch
    shapes = []
    for number, centre in enumerate(centres + rng.uniform(-0.03, 0.03, centres.shape) * RADIUS):
        arm = rng.normal(size=3)
        arm *= 0.3 * RADIUS / np.linalg.norm(arm)
        pair = [(centre - arm, 0.65 * RADIUS), (centre + arm, 0.65 * RADIUS)]
        shapes.append(fdem.clump(pair) if number % 3 == 0 else fdem.sphere(RADIUS, centre))
    return shapes, SIDE * pitch, LAYERS * pitch


def main(folder: Path = Path("out")) -> float:
    """Return the relative error of the force on the plate against the weight of the bed."""
    shapes, side, height = bed()
    scene = fdem.Scene()
    t, low = 2.0 * RADIUS, 0.2 * RADIUS  # the walls end just above the plate
    for lower, upper in (
        ((-t, -t, low), (0, side + t, height)),
        ((side, -t, low), (side + t, side + t, height)),
        ((0, -t, low), (side, 0, height)),
        ((0, side, low), (side, side + t, height)),
    ):
        scene.add(fdem.brick(lower, upper), fdem.Rigid(), STONE, fixed=True, group="walls")
    plate = scene.add(fdem.brick((0, 0, -0.5 * t), (side, side, 0)), fdem.Zoned(size=0.03), PLATE, name="plate")
    scene.fix(plate, where=lambda x: np.isclose(x[:, 0], 0) | np.isclose(x[:, 0], side))
    scene.add(shapes, fdem.Rigid(), STONE, group="bed")
    scene.joint(fdem.Hertz(friction=27, restitution=0.3))
    scene.joint(fdem.Hertz(friction=0, restitution=0.3), between=("walls", "bed"))
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=27), between=("walls", "plate"))  # Hertz is for spheres

    sim = fdem.Simulation(scene, fdem.Explicit(), energy=False)
    sim.run(time=0.3)
    rest = fdem.Simulation(scene, fdem.Relaxation(), start=sim)
    rest.solve(ratio=1e-4)

    view = rest["bed"]
    weight = float(view.mass.sum()) * 9.81
    carried = float(-rest["plate"].contact_force[2]) / weight
    print(f"force on the plate over weight of the bed {carried:.5f}")
    table = rest.contact_table()
    among = int(((table["block_a"] > 4) & (table["block_b"] > 4)).sum())  # walls and plate are blocks 0 to 4
    top = float(np.quantile(view.position[:, 2], 0.9))
    inside = view.position[:, 2] < top
    solid = float(view.mass[inside].sum()) / STONE.density
    print(f"coordination number {2 * among / len(view.mass):.2f}, porosity {1 - solid / (side**2 * top):.3f}")

    folder.mkdir(parents=True, exist_ok=True)
    sim.plot(folder / "spheres.png", hide=["walls"])
    return abs(carried - 1.0)


if __name__ == "__main__":
    print(f"relative error: {main(*map(Path, sys.argv[1:])):.2e}")
