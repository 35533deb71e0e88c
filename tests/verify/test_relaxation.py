"""How fast and how truly Relaxation comes to rest: cycles, and the error that a solve ratio leaves."""

from __future__ import annotations

import numpy as np
import pytest
from verify.meshes import box, plane, quarter_ring

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia
DAMPING = {"local": fdem.Local(0.8), "adaptive": fdem.Adaptive()}


def column():
    scene = fdem.Scene()
    block = scene.add(box((2, 2, 10), (2, 2, 10)), fdem.Zoned(), fdem.Elastic(2500, 1e9, 0.25))
    scene.fix(block, "z", where=plane(2, 0.0))
    scene.fix(block, ("x", "y"), where=plane(0, 0.0))
    return scene


def cylinder():
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(quarter_ring(8, 12, 1.0, 2.0, 1 / 8), fdem.Zoned(), fdem.Elastic(2500, 5e9, 0.3))
    scene.fix(block, "z")
    scene.fix(block, "x", where=lambda x: x[:, 0] == 0.0)
    scene.fix(block, "y", where=lambda x: x[:, 1] == 0.0)
    scene.apply(fdem.Pressure(1e4), block, where=lambda x: np.hypot(x[:, 0], x[:, 1]) < 1.001)
    return scene


def cantilever():
    scene = fdem.Scene()
    block = scene.add(box((16, 4, 2), (8, 1, 1)), fdem.Zoned(strain="small"), fdem.Elastic(2500, 1e10, 0.0))
    scene.fix(block, where=plane(0, 0.0))
    return scene


def stack(body):
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    for k in range(4):
        top = scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), body, fdem.Elastic(2500, 1e9, 0.25))
    scene.joint(fdem.Coulomb(kn=1e10, ks=5e9, friction=35))
    scene.apply(fdem.Force((2000.0, 0, 0)), top)
    return scene


SCENES = {
    "column": column,
    "cylinder": cylinder,
    "cantilever": cantilever,
    "rigid stack": lambda: stack(fdem.Rigid()),
    "zoned stack": lambda: stack(fdem.Zoned(size=0.5)),
}


def solve(scene, damping, ratio):
    sim = fdem.Simulation(scene, fdem.Relaxation(damping=damping), progress=False)
    report = sim.solve(ratio=ratio, max_cycles=40_000)
    assert report.converged
    return sim.displacements(), report


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("damping", DAMPING)
def test_error_that_a_ratio_leaves(name, damping):
    exact, _ = solve(SCENES[name](), DAMPING["adaptive"], 1e-8)
    for ratio in (1e-4, 1e-5):
        moved, _ = solve(SCENES[name](), DAMPING[damping], ratio)
        error = np.abs(moved - exact).max() / np.abs(exact).max()
        # the stop rule promises 1000 times the ratio (5 % at most) of the largest displacement, by an estimate
        assert error <= min(0.05, 1e3 * ratio)


def test_adaptive_damping_needs_fewer_cycles():
    local = solve(cantilever(), DAMPING["local"], 1e-6)[1].cycles
    adaptive = solve(cantilever(), DAMPING["adaptive"], 1e-6)[1].cycles
    # 17 critical decays of the slowest mode (1.8e-3 a cycle and step 1.6): about 5000
    assert adaptive < 6500
    assert adaptive < 0.6 * local


@pytest.mark.parametrize("damping", DAMPING)
@pytest.mark.parametrize(("degrees", "reason"), [(28.0, "equilibrium"), (32.0, "collapse")])
def test_sliding_is_told_from_rest(damping, degrees, reason):
    slope = np.radians(degrees)
    scene = fdem.Scene(gravity=9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)]))
    scene.add(fdem.brick((-1, -1, -0.5), (20, 2, 0)), fdem.Rigid(), fixed=True)
    scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), fdem.Rigid(), fdem.Elastic(2500))
    scene.joint(fdem.Coulomb(kn=5e9, ks=2e9, friction=30))
    sim = fdem.Simulation(scene, fdem.Relaxation(damping=DAMPING[damping]), progress=False)
    assert sim.solve(ratio=1e-5, max_cycles=60_000).reason == reason


def test_round_off_is_equilibrium():
    """A ratio that the last bits of the positions cannot give is reached where they end."""
    scene = fdem.Scene(gravity=(0, 0, -1e-6))
    block = scene.add(box((2, 2, 10), (2, 2, 10)), fdem.Zoned(strain="small"), fdem.Elastic(2500, 1e9, 0.0))
    scene.fix(block, "z", where=plane(2, 0.0))
    scene.fix(block, ("x", "y"))
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    report = sim.solve(ratio=1e-9, max_cycles=20_000)
    assert report.ratio <= 1e-9


def test_adaptive_is_for_relaxation():
    with pytest.raises(fdem.SceneError, match="Relaxation"):
        fdem.Explicit(damping=fdem.Adaptive())
