"""Implicit, quasi-static and non-smooth integrators on problems with a closed form: incline, stack, arch, spring."""

from __future__ import annotations

import numpy as np
import pytest

import fdem
from fdem.integrate import implicit

G, SLOPE = 9.81, np.radians(30.0)
STONE = fdem.Elastic(density=2000, young=1e10, poisson=0.2)
INTEGRATORS = {
    "newmark": lambda dt: fdem.Newmark(dt=dt),
    "dda": lambda dt: fdem.Newmark(dt=dt, beta=0.5, gamma=1.0),
    "alpha": lambda dt: fdem.GeneralizedAlpha(dt=dt),
    "contact dynamics": lambda dt: fdem.ContactDynamics(dt=dt),
}


def slope(phi, body=None):
    """The 1 x 1 x 0.5 m block on a slope of 30 degrees: gravity is tilted, not the geometry."""
    scene = fdem.Scene(gravity=G * np.array([np.sin(SLOPE), 0.0, -np.cos(SLOPE)]))
    scene.add(fdem.brick((-4, -1, -1), (13, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), body or fdem.Rigid(), STONE, name="block")
    scene.joint(fdem.Coulomb(kn=5e9, ks=2e9, friction=phi))
    return scene, block


@pytest.mark.parametrize("name", ["newmark", "dda", "alpha"])
@pytest.mark.parametrize("phi", [20.0, 29.0])
def test_block_slides(name, phi):
    """s = g (sin a - cos a tan phi) t^2 / 2; the elastic slip set free at the start is what is left of it."""
    start = fdem.Simulation(slope(30.05)[0], fdem.Relaxation())
    assert start.solve(ratio=1e-9).converged
    scene, block = slope(phi)
    sim = fdem.Simulation(scene, INTEGRATORS[name](1e-2), start=start)
    sim.run(time=0.5)
    exact = 0.5 * G * (np.sin(SLOPE) - np.cos(SLOPE) * np.tan(np.radians(phi))) * 0.25
    assert sim[block].displacement[0] == pytest.approx(exact, abs=5e-6)  # m g sin a / (ks A) = 2.5e-6 m of spring
    assert sim.energy.closure < 1e-4


@pytest.mark.parametrize("phi", [0.0, 20.0, 29.0])
def test_hard_block_slides(phi):
    """Contact dynamics, from rest under sudden gravity: 1e-6 of the oracle, at any step."""
    for dt in (1e-2, 1e-3):
        scene, block = slope(phi)
        sim = fdem.Simulation(scene, fdem.ContactDynamics(dt=dt))
        sim.run(time=0.3)
        exact = 0.5 * G * (np.sin(SLOPE) - np.cos(SLOPE) * np.tan(np.radians(phi))) * 0.09
        assert sim[block].displacement[0] == pytest.approx(exact, rel=1e-6)
        assert np.abs(sim[block].displacement[1:]).max() < 1e-8
        assert sim.energy.closure < 1e-9


@pytest.mark.parametrize("name", INTEGRATORS)
def test_block_sticks(name):
    """At 0.99 tan(phi) no creep beyond 1e-6 m in 10 s, at any step."""
    phi = np.degrees(np.arctan(np.tan(SLOPE) / 0.99))
    start = None
    if name != "contact dynamics":
        start = fdem.Simulation(slope(phi)[0], fdem.Static())
        assert start.solve().converged
    for dt in (5e-2,) if name == "contact dynamics" else (1.0, 5e-2):
        scene, block = slope(phi)
        sim = fdem.Simulation(scene, INTEGRATORS[name](dt), start=start)
        before = sim[block].position[0]
        sim.run(time=10.0)
        assert abs(sim[block].position[0] - before) < 1e-6


@pytest.mark.parametrize("body", [fdem.Rigid(), fdem.Zoned(size=0.6)])
def test_static_arch_carries_its_weight(body):
    scene = fdem.Scene()
    stones = scene.add(fdem.arch(span=10, rise=5, thickness=1.2, depth=1, n=25), body, STONE, group="voussoirs")
    supports = scene.fix([stones[0], stones[-1]])
    scene.joint(fdem.Coulomb(kn=50e9, ks=20e9, friction=35))
    sim = fdem.Simulation(scene, fdem.Static())
    report = sim.solve()
    assert report.converged and report.cycles <= 20
    weight = G * sim[stones[1:-1]].mass.sum()
    assert sim[supports].force[2] == pytest.approx(weight, rel=1e-8)
    relaxed = fdem.Simulation(scene, fdem.Relaxation())
    assert relaxed.solve(ratio=1e-7).converged
    # friction depends on the path, so the two are not the same to the last digit
    assert sim[stones[12]].displacement[2] == pytest.approx(relaxed[stones[12]].displacement[2], rel=1e-2)


def test_static_says_what_cannot_stand():
    scene, _ = slope(29.0)
    report = fdem.Simulation(scene, fdem.Static()).solve()
    assert not report.converged and report.reason == "collapse"
    sim = fdem.Simulation(scene, fdem.Static())
    with pytest.raises(fdem.ConvergenceError, match="'block'"):
        sim.cycle(1)


def test_static_refuses_a_free_block():
    scene = fdem.Scene()
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE, name="lost")
    with pytest.raises(fdem.SceneError, match="'lost' is free"):
        fdem.Simulation(scene, fdem.Static())


def test_newton_converges_quadratically(monkeypatch):
    """On a closed set of contacts the number of exact digits doubles with every iteration, with a matrix for each."""
    monkeypatch.setattr(implicit, "GAIN", 0.0)
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    soft = fdem.Elastic(density=2000, young=1e7, poisson=0.2)
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Zoned(size=0.5), soft)
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=60))
    sim = fdem.Simulation(scene, fdem.Newmark(dt=5e-3, tolerance=1e-12))
    sim.cycle(3)
    residuals = np.array(sim.integrator.history)
    fast = residuals[(residuals < 1e-2) & (residuals > 1e-13)]
    assert len(fast) >= 2
    assert (fast[1:] <= np.maximum(30.0 * fast[:-1] ** 2, 2e-12)).all()


@pytest.mark.parametrize(("name", "order"), [("newmark", 2.0), ("alpha", 2.0), ("dda", 1.0)])
def test_order_on_a_spring(name, order):
    """A block bouncing on a closed joint: x = x0 cos(w t) about its rest, error falling with the order of the rule."""
    kn, mass = 1e6, 2000.0
    w = np.sqrt(kn / mass)
    errors = []
    for n in (40, 80, 160):
        scene = fdem.Scene()
        scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
        block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE)
        scene.fix(block, component=("x", "y", "rotation"))
        scene.joint(fdem.Coulomb(kn=kn, ks=kn, friction=0))
        dt = 2 * np.pi / w / n
        sim = fdem.Simulation(scene, INTEGRATORS[name](dt))
        sim.cycle(n // 2)
        rest = mass * G / kn
        errors.append(abs(sim[block].displacement[2] + 2 * rest) / rest)  # after half a period it is twice as deep
    observed = np.log2(np.array(errors[:-1]) / errors[1:])
    assert observed.min() > order - 0.3


def test_hard_stack_forces():
    """Ten cubes: the contact under cube k carries what lies above, to the tolerance of the solver."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="floor")
    for k in range(10):
        scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), fdem.Rigid(), STONE, name=f"cube {k}")
    scene.joint(fdem.Coulomb(friction=30))
    sim = fdem.Simulation(scene, fdem.ContactDynamics(dt=1e-2))
    sim.run(time=0.2)
    for k in range(10):
        below = "floor" if k == 0 else f"cube {k - 1}"
        assert sim.pair_force(below, f"cube {k}")[2] == pytest.approx(2000 * G * (10 - k), rel=1e-5)


def test_hard_restitution():
    """A cube dropped flat with e = 0.5 leaves with half its speed."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    cube = scene.add(fdem.brick((0, 0, 0.1), (1, 1, 1.1)), fdem.Rigid(), STONE)
    scene.joint(fdem.Coulomb(friction=0, restitution=0.5))
    sim = fdem.Simulation(scene, fdem.ContactDynamics(dt=1e-4))
    sim.run(time=0.2)
    fall = np.sqrt(2 * G * 0.1)
    flown = 0.2 - fall / G
    assert sim[cube].velocity[2] == pytest.approx(0.5 * fall - G * flown, abs=5e-3)  # a step of free fall is 1e-3 m/s


@pytest.mark.parametrize(("integrator", "field"), [
    (lambda: fdem.Newmark(dt=0.0), "dt"), (lambda: fdem.Newmark(dt=1.0, beta=0.1), "beta"),
    (lambda: fdem.GeneralizedAlpha(dt=1.0, rho=1.5), "rho"), (lambda: fdem.Static(tolerance=-1.0), "tolerance"),
    (lambda: fdem.ContactDynamics(dt=1e-3, theta=0.2), "theta"), (lambda: fdem.Newmark(dt=1.0, solver="x"), "solver"),
])  # fmt: skip
def test_bad_input_is_refused(integrator, field):
    with pytest.raises(fdem.SceneError, match=field):
        integrator()
