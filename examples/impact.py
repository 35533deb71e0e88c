"""A rigid ball hits a zoned beam: momentum and energy balance of an impact.

python examples/impact.py [picture folder]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import fdem
from fdem.results.plot import history_plot

STEEL = fdem.Elastic(density=7850, young=200e9, poisson=0.3)


def main(folder: Path = Path("out")) -> float:
    """Return the closure error of the energy balance (energy lost or gained over energy turned over)."""
    scene = fdem.Scene()
    beam = scene.add(fdem.brick((0, 0, 0), (4, 0.2, 0.3)), fdem.Zoned(size=0.1), STEEL, name="beam")
    scene.fix(beam, where=lambda x: np.isclose(x[:, 0], 0) | np.isclose(x[:, 0], 4))
    scene.add(fdem.icosphere(0.1, centre=(2, 0.1, 0.42)), fdem.Rigid(), STEEL, velocity=(0, 0, -5), name="ball")
    scene.joint(fdem.Coulomb(kn=2e11, ks=1e11, friction=0))

    sim = fdem.Simulation(scene, fdem.Explicit())
    middle = scene.gridpoint(near=(2, 0.1, 0), target=beam)
    mid = sim.history(middle, "displacement", component="z", every=20)
    ball = sim.history("ball", "velocity", component="z", every=20)
    sim.run(time=0.02)

    folder.mkdir(parents=True, exist_ok=True)
    sim.plot(folder / "impact.png", scalars="stress", warp="auto")
    history_plot([mid, ball], folder / "impact_history.png")
    return sim.energy.closure


if __name__ == "__main__":
    print(f"closure error of the energy balance: {main(*map(Path, sys.argv[1:])):.2e}")
