"""A rigid block slides down a 35 degree slope: its acceleration against the closed form.

    python examples/incline.py [picture folder]

Friction of 30 degrees is less than the slope, so the block slides with g (sin a - cos a tan phi).
Gravity is switched on suddenly; the joint's springs are loaded first, which gives the block a small
head start in speed, so the acceleration is taken once it slides.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import fdem


def main(folder: Path = Path("out")) -> float:
    """Return the relative error of the acceleration over the second half of the run."""
    slope, phi = np.radians(35.0), 30.0
    gravity = 9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)])  # tilt gravity, not geometry

    scene = fdem.Scene(gravity=gravity)
    scene.add(fdem.brick((-1, -1, -0.5), (9, 1, 0)), fdem.Rigid(), name="base", fixed=True)
    block = scene.add(fdem.brick((0, -0.5, 0), (1, 0.5, 1)), fdem.Rigid(), fdem.Elastic(density=2500), name="block")
    scene.joint(fdem.Coulomb(kn=5e9, ks=2e9, friction=phi, damping=0.1))

    sim = fdem.Simulation(scene, fdem.Explicit())
    speed = sim.history(block, "velocity", component="x", every=10)
    sim.run(time=1.0)

    exact = 9.81 * (np.sin(slope) - np.cos(slope) * np.tan(np.radians(phi)))
    late = speed.time > 0.5
    measured = np.polyfit(speed.time[late], speed.values[late], 1)[0]
    folder.mkdir(parents=True, exist_ok=True)
    sim.plot(folder / "incline.png", scalars="displacement")
    return float(abs(measured / exact - 1))


if __name__ == "__main__":
    print(f"relative error of the acceleration: {main(*map(Path, sys.argv[1:])):.2e}")
