"""A joint law of your own: friction that weakens with slip, dragged to its residual strength.

    python examples/user_law.py [picture folder]

A data class with the numbers and a kernel over contact points (arguments: top of fdem/kernels/joints.py). With friction
that falls from s to d over the slip D (Ida 1972), dragging a weight N further than D costs N (d slip + (s - d) D / 2).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import fdem
from fdem.results.plot import history_plot


@fdem.kernel
def weakening(
    lo, hi, dt, gap, push, slip, normal, align, area, mass, arm, prop, props, old, memory, traction, work, state
):  # fmt: skip
    """Linear springs; the shear strength is the pressure times a coefficient that falls with the slip (memory 4)."""
    for i in range(lo, hi):
        state[i] = 3  # open
        if area[i] == 0.0:
            continue
        kn, ks, static, dynamic, distance = [props[prop[i // 3], k] for k in range(5)]
        memory[i], work[i] = old[i], 0.0
        pressure = max(-kn * gap[i], 0.0)
        limit = max(static - (static - dynamic) * old[i, 4] / distance, dynamic) * pressure * align[i] / ks
        elastic = old[i, :3] + slip[i] - (slip[i] * normal[i]).sum() * normal[i]
        length = (elastic**2).sum() ** 0.5
        if length > limit:
            elastic *= limit / length
            memory[i, 4] += length - limit
            work[i, 0] = area[i] * ks * limit * (length - limit)
        memory[i, :3], traction[i, 0], traction[i, 1:] = elastic, pressure, -ks * elastic
        state[i] = 3 if pressure == 0.0 else 2 if length > limit else 1  # open, slipping, closed


@dataclass(frozen=True, kw_only=True)
class Weakening(fdem.Joint):
    """Friction coefficient that falls from `static` to `dynamic` over a slip of `distance` [m]."""

    static: float
    dynamic: float
    distance: float
    kernel = weakening

    def properties(self, kn: float, ks: float) -> tuple[float, ...]:
        """Row of numbers that the kernel reads, kn and ks first."""
        return kn, ks, self.static, self.dynamic, self.distance


def main(folder: Path = Path("out")) -> float:
    """Return the relative error of the work of friction."""
    law = Weakening(kn=2e9, ks=1e9, static=0.7, dynamic=0.4, distance=2e-3)
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -0.5), (2, 2, 0)), fdem.Rigid(), name="base", fixed=True)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), fdem.Elastic(density=2500), name="block")
    scene.fix(block, component="rotation")
    scene.joint(law)
    settled = fdem.Simulation(scene, fdem.Relaxation())
    settled.solve(ratio=1e-10)
    scene.apply(fdem.Velocity((0.02, None, None)), block)
    sim = fdem.Simulation(scene, fdem.Explicit(safety=0.05), start=settled)
    drag = sim.history(lambda s: -s.pair_force("base", block)[0], every=20)
    sim.run(time=0.2)
    slip, weight = sim.contact_table()["slip"].max(), 9.81 * sim[block].mass
    exact = weight * (law.dynamic * slip + 0.5 * (law.static - law.dynamic) * law.distance)
    drag.name, drag.unit = "drag", "N"
    folder.mkdir(parents=True, exist_ok=True)
    history_plot(drag, folder / "user_law.png")
    return float(abs(sim.energy.friction / exact - 1))


if __name__ == "__main__":
    print(f"relative error of the work of friction: {main(*map(Path, sys.argv[1:])):.2e}")
