"""Implicit integrators in time: modes of blocks on joints, rocking, a wave through a joint, inversion, mass ratio.

Values and tolerances are those of the verification oracle; scenes are shared with the tests of other integrators.
"""

from __future__ import annotations

import numpy as np
import pytest
from stress import rest
from verify import test_contact_acceptance as acceptance
from verify import test_joint_cases as cases
from verify import test_rigid_cases as rigid

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia

G = 9.81


def test_block_on_joint_modes():
    """Six frequencies of the area-integrated joint to 0.2 % (oracle: block_on_joint_modes)."""
    scene, block, loads, _ = rigid.block_on_joint()
    settled = fdem.Simulation(scene, fdem.Static(tolerance=1e-13))
    assert settled.solve(ratio=1e-13).converged
    vertical, twist, about_x, about_y = rigid.modes_of_block()
    sim = fdem.Simulation(scene, fdem.Newmark(dt=0.2 / about_x[1], tolerance=1e-11), start=settled)
    for load in loads:
        sim[load].factor = 0.0
    history = sim.history(lambda s: np.concatenate([s[block].position, s[block].rotation_vector]))
    sim.cycle(600)
    expected = {(2,): [vertical], (5,): [twist], (1, 3): about_x, (0, 4): about_y}
    for columns, exact in expected.items():
        u = np.array(history.values)[:, columns]
        u = (u - u.mean(axis=0)) / np.ptp(u, axis=0)
        # 2 cos(w dt) of every mode, and a constant: rest is not where the rotations are counted from
        right = np.column_stack([u[1:-1], np.ones(len(u) - 2)])
        matrix = np.linalg.lstsq(right, u[2:] + u[:-2], rcond=None)[0][: len(columns)]
        found = np.arccos(0.5 * np.sort(np.linalg.eigvals(matrix).real)[::-1])
        # the period error of the trapezoidal rule taken out: tan(w dt / 2)
        assert 2.0 / sim.dt * np.tan(0.5 * found) == pytest.approx(exact, rel=2e-3), columns


def test_uniform_strain_on_a_joint():
    """Both frequencies of a uniform-strain block on its joint to 0.2 % (oracle: dda_block_on_springs)."""
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.UniformStrain(), fdem.Elastic(2500.0, 1e9, 0.0))
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    extra = scene.apply(fdem.Force((0, 0, -2000.0)), block)
    settled = fdem.Simulation(scene, fdem.Static(tolerance=1e-12))
    assert settled.solve(ratio=1e-12).converged
    sim = fdem.Simulation(scene, fdem.Newmark(dt=8e-5, tolerance=1e-12), start=settled)
    sim[extra].factor = 0.0
    history = sim.history(lambda s: np.array([s[block].position[2], s[block].strain[2]]))
    sim.cycle(300)
    found = rigid.sampled_modes(np.array(history.values), sim.dt)
    assert 2.0 / sim.dt * np.tan(0.5 * found * sim.dt) == pytest.approx(
        [561.7463659239894, 2466.6659725976665], rel=2e-3
    )


def test_rocking_to_the_first_impact():
    """Below 7 % at a closure of 1e-4 b, falling as kn^-1/2 to within 0.3 % (oracle: rigid_rocking_block, penalty)."""
    theta, times = 0.5 * acceptance.ALPHA, []
    stiff = acceptance.RHO * G * acceptance.H / (1e-4 * acceptance.B)
    available = acceptance.RHO * acceptance.B * acceptance.D * acceptance.H * G
    available *= acceptance.R * np.cos(acceptance.ALPHA - theta) - acceptance.H / 2
    for kn in (stiff, 10 * stiff):
        explicit, _ = acceptance.on_edge(theta, kn)
        sim = fdem.Simulation(explicit.scene, fdem.Newmark(dt=2e-3))
        block = sim.scene.blocks[1]
        before = last = theta
        while last > 0.0:
            before, t = last, sim.time
            sim.cycle(1)
            last = theta + sim[block].rotation_vector[1]
            if last > 0.1 * theta:
                assert abs(sim.energy.error) < 1e-4 * available
        times.append(t + (sim.time - t) * before / (before - last))
    errors = np.array(times) / acceptance.first_impact(theta) - 1
    assert 0.0 < errors[0] < 0.07
    limit = (np.sqrt(10) * errors[1] - errors[0]) / (np.sqrt(10) - 1)
    assert abs(limit) < 3e-3


@pytest.mark.parametrize("kn", [1e10])
def test_step_through_a_joint(kn):
    """v = v0 (1 - exp(-2 k t / Z)) behind the joint, to 1 % of v0 (oracle: wave_joint_transmission)."""
    edge = 0.4 * 1e9 / kn
    sim = cases.column(kn, 80, 80, edge, 0.25 * edge, lambda t: 1.0 if t > 0 else 0.0)
    sim = fdem.Simulation(sim.scene, fdem.GeneralizedAlpha(dt=0.25 * edge / cases.SPEED, rho=0.5), energy=False)
    behind, constant = cases.plane_wave(sim, 5 * edge), 0.5 * cases.IMPEDANCE / kn
    sim.run(time=80 * edge / cases.SPEED + 4 * constant)
    t = np.array(behind.time) - 85 * edge / cases.SPEED
    exact = cases.V0 * (1 - np.exp(-np.maximum(t, 0.0) / constant))
    assert np.abs(np.array(behind.values) - exact)[t > 0.5 * constant].max() <= 0.01 * cases.V0


def test_s01_mass_ratio_of_a_million_in_time():
    """Forces to 1e-8 over 10 s, no ejection."""
    start = fdem.Simulation(rest.million_on_one(), fdem.Static(tolerance=1e-11))
    assert start.solve(ratio=1e-11).converged
    sim = fdem.Simulation(rest.million_on_one(), fdem.Newmark(dt=0.5, tolerance=1e-10), start=start)
    for _ in range(20):
        sim.cycle(1)
        rest.check_million_on_one(sim, 1e-8)


def test_s14_trapezoid_does_not_drift():
    """Linear trend of the energy over the run below 1e-9 of it, w dt = 0.2 (explicit: 1e6 steps)."""
    kn, mass = 1e9, 2000.0
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), fdem.Elastic(density=mass))
    scene.fix(block, component=("x", "y", "rotation"))
    scene.joint(fdem.Coulomb(kn=kn, ks=kn, friction=0))
    extra = scene.apply(fdem.Force((0, 0, -1e4)), block)
    settled = fdem.Simulation(scene, fdem.Static(tolerance=1e-13))
    assert settled.solve(ratio=1e-13).converged
    sim = fdem.Simulation(scene, fdem.Newmark(dt=0.2 / np.sqrt(kn / mass), tolerance=1e-13), start=settled)
    sim[extra].factor = 0.0
    at_rest, found = sim[block].position[2] + 1e-5, []  # 1e4 N less on kn A
    for _ in range(500):
        sim.cycle(1)
        found.append(0.5 * mass * sim[block].velocity[2] ** 2 + 0.5 * kn * (sim[block].position[2] - at_rest) ** 2)
    found = np.array(found) / found[0]
    assert np.abs(found - 1).max() < 1e-8  # round-off of positions of 0.5 m over 1e-5 m
    assert abs(np.polyfit(np.arange(500), found, 1)[0]) * 500 < 1e-9


def test_s27_inverted_zone_is_reported():
    """A column compressed past 90 %: named block and zone, not a number that is not one."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(
        fdem.brick((0, 0, 0), (1, 1, 2)), fdem.Zoned(size=1.0), fdem.Elastic(2500, 1e7, 0.2), name="column"
    )
    scene.fix(block, where=lambda x: x[:, 2] < 1e-9)
    scene.apply(fdem.Displacement((None, None, -1.9)), block, where=lambda x: x[:, 2] > 2 - 1e-9, factor=lambda t: t)
    sim = fdem.Simulation(scene, fdem.Static())
    with pytest.raises(fdem.SolveError, match="'column'"):
        for _ in range(3):
            sim.cycle(1)
    assert np.isfinite(sim.state.x).all()


def test_start_from_relaxation():
    """A state at rest by Relaxation stays at rest."""
    scene = cases.tilted(20.0, 35.0, 1e-5)
    settled = fdem.Simulation(scene, fdem.Relaxation())
    assert settled.solve(ratio=1e-10).converged
    for integrator in (fdem.Newmark(dt=0.1), fdem.GeneralizedAlpha(dt=0.1)):
        sim = fdem.Simulation(scene, integrator, start=settled)
        sim.run(time=2.0)
        assert np.abs(sim["block"].displacement).max() < 1e-10
    again = fdem.Simulation(scene, fdem.Static(), start=settled)
    report = again.solve()
    assert report.converged and report.cycles == 0 and report.notes == ""


def test_newmark_comes_to_rest():
    """`solve` with a dissipative rule: steps until equilibrium, with every residual in the report."""
    scene = cases.tilted(20.0, 35.0, 1e-5, damping=0.5)
    sim = fdem.Simulation(scene, fdem.Newmark(dt=0.01, beta=0.5, gamma=1.0))
    report = sim.solve(ratio=1e-6)
    assert report.converged
    assert len(report.residuals) >= report.cycles and max(report.residuals) <= 1e-8


def test_a_step_that_cannot_be_taken_says_why():
    """Residuals, block and contact in the message; the state is that before the step."""

    class Wild:
        def force(self, t, x, v):
            return 1e9 * np.sign(np.sin(1e12 * x))  # no derivative is of any use

        def tangent(self, t, x, v):
            return np.zeros((len(x), 3, 3))

    scene = cases.tilted(10.0, 35.0, 1e-4)
    scene.apply(Wild(), "block")
    sim = fdem.Simulation(scene, fdem.Newmark(dt=1e-2, max_iterations=5))
    before = sim.state.x.copy()
    with pytest.raises(fdem.ConvergenceError, match=r"residuals .*worst is block 'block', its largest contact"):
        sim.cycle(1)
    assert np.array_equal(sim.state.x, before)


BODIES = {
    "rigid": fdem.Rigid(),
    "uniform": fdem.UniformStrain(),
    "linear": fdem.LinearStrain(),
    "zoned": fdem.Zoned(size=0.7),
}


@pytest.mark.parametrize("rule", [fdem.Newmark(dt=1e-3), fdem.GeneralizedAlpha(dt=1e-3)], ids=["newmark", "alpha"])
@pytest.mark.parametrize("body", BODIES)
def test_driven_block(body, rule):
    """A block shaken by v = V sin(w t) under another that slips on it: path, velocity, and the work of the drive."""
    scene, w, speed, end = fdem.Scene(), 20.0, 0.1, 0.2
    stone = fdem.Elastic(density=2000, young=1e9, poisson=0.2)
    scene.add(fdem.brick((-1, -1, -1), (3, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    low = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), BODIES[body], stone, name="low")
    scene.add(fdem.brick((0, 0, 0.5), (1, 1, 1)), fdem.Rigid(), stone, name="top")
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
    rest = fdem.Simulation(scene, fdem.Static())
    assert rest.solve().converged
    scene.apply(fdem.Velocity((speed, None, None)), low, factor=lambda t: np.sin(w * t))
    sim = fdem.Simulation(scene, rule, start=rest)
    sim.run(time=end)
    # midpoint rule: (w dt)^2 / 24
    assert sim["low"].displacement[0] == pytest.approx(speed / w * (1 - np.cos(w * end)), rel=1e-4)
    assert sim["low"].velocity[0] == pytest.approx(speed * np.sin(w * end), rel=1e-9)
    assert sim.energy.work > 0 and sim.energy.friction > 0.9 * sim.energy.work
    assert sim.energy.closure < 1e-3
