"""A semicircular masonry arch under self weight, rigid voussoirs against zoned ones.

    python examples/arch.py [picture folder]

The two springings carry the weight of the free voussoirs, whatever the voussoirs are made of.
"""

from __future__ import annotations

import sys
from pathlib import Path

import fdem

STONE = fdem.Elastic(density=2400, young=10e9, poisson=0.2)


def arch(body: fdem.Rigid | fdem.Zoned) -> tuple[fdem.Simulation, float]:
    """Relax an arch of one kind of body; return it and the error of the support reaction."""
    scene = fdem.Scene()
    voussoirs = scene.add(fdem.arch(span=10, rise=5, thickness=1.2, depth=1, n=25), body, STONE, group="voussoirs")
    supports = scene.fix([voussoirs[0], voussoirs[-1]])
    scene.joint(fdem.Coulomb(kn=50e9, ks=20e9, friction=35))
    sim = fdem.Simulation(scene, fdem.Relaxation())
    report = sim.solve(ratio=1e-6)
    if report.reason != "equilibrium":
        raise SystemExit(f"the arch should stand, but the run ended with {report}")
    weight = 9.81 * sim[voussoirs[1:-1]].mass.sum()
    return sim, abs(float(sim[supports].force[2]) / weight - 1)


def main(folder: Path = Path("out")) -> float:
    """Return the larger relative error of the vertical support reaction."""
    folder.mkdir(parents=True, exist_ok=True)
    errors = []
    for name, body in (("rigid", fdem.Rigid()), ("zoned", fdem.Zoned(size=0.4))):
        sim, error = arch(body)
        errors.append(error)
        sim.plot(folder / f"arch_{name}.png", scalars="traction", warp="auto")
    return max(errors)


if __name__ == "__main__":
    print(f"largest relative error of the support reaction: {main(*map(Path, sys.argv[1:])):.2e}")
