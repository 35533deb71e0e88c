"""Every load, support and start of motion against a closed form, on rigid and zoned blocks."""

from __future__ import annotations

import numpy as np
import pytest
from verify.meshes import box, plane

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia
DENSITY, YOUNG, POISSON = 2500.0, 1e9, 0.25
ROCK = fdem.Elastic(DENSITY, YOUNG, POISSON)
SIZE = np.array([1.0, 2.0, 3.0])
MASS = DENSITY * SIZE.prod()
INERTIA = MASS / 12 * np.diag([13.0, 10.0, 5.0])
BODIES = {
    "rigid": fdem.Rigid(),
    "uniform": fdem.UniformStrain(),
    "linear": fdem.LinearStrain(),
    "zoned": fdem.Zoned(mass="inertia-matched"),
}


def one_block(body="rigid", gravity=(0, 0, 0), shape=None, **given):
    scene = fdem.Scene(gravity=gravity)
    if shape is None:
        shape = fdem.brick((0, 0, 0), SIZE) if body != "zoned" else box((1, 2, 3), SIZE)
    return scene, scene.add(shape, BODIES[body], ROCK, name="block", **given)


def make(scene, integrator=None, **options):
    return fdem.Simulation(scene, integrator or fdem.Explicit(), progress=False, **options)


def resultant(sim, block, body):
    """Force and moment (about the centroid) on the block from its generalised force."""
    force = sim[block].generalised_force
    if body != "zoned":
        return force[:3], force[3:6]
    each = force.reshape(-1, 3)
    arm = sim[block].gridpoints - SIZE / 2
    return each.sum(axis=0), np.cross(arm, each).sum(axis=0)


# forces


@pytest.mark.parametrize("body", BODIES)
def test_force_shared_over_the_block(body):
    scene, block = one_block(body)
    load = scene.apply(fdem.Force((3.0, -2.0, 5.0)), block, factor=2.0)
    sim = make(scene)
    force, moment = resultant(sim, block, body)
    np.testing.assert_allclose(force, [6, -4, 10], rtol=1e-12)  # a sum of shares: round-off
    np.testing.assert_allclose(moment, 0, atol=1e-9 * 10)  # shared by mass: no moment about the centre
    np.testing.assert_allclose(sim[load].force, [6, -4, 10], rtol=1e-12)
    np.testing.assert_allclose(sim[block].acceleration, np.array([6, -4, 10]) / MASS, rtol=1e-12)
    sim.run(time=0.5)
    # leapfrog is exact under a constant force
    exact = np.array([6, -4, 10]) / MASS * 0.5**2 / 2
    np.testing.assert_allclose(sim[block].displacement, exact, rtol=1e-6)
    sim[load].factor = -1.0
    np.testing.assert_allclose(sim[load].force, [-3, 2, -5], rtol=1e-12)


@pytest.mark.parametrize("body", BODIES)
def test_force_at_a_material_point(body):
    at, value = np.array([0.9, 0.3, 2.5]), np.array([100.0, 50.0, -20.0])
    scene, block = one_block(body)
    scene.apply(fdem.Force(value, at=at), block)
    sim = make(scene)
    force, moment = resultant(sim, block, body)
    exact = np.cross(at - SIZE / 2, value)
    np.testing.assert_allclose(force, value, rtol=1e-12)  # affine weights reproduce both: round-off
    np.testing.assert_allclose(moment, exact, rtol=1e-9)
    if body == "rigid":
        alpha = np.linalg.solve(INERTIA, exact)
        np.testing.assert_allclose(sim.acceleration[3:6], alpha, rtol=1e-9)


@pytest.mark.parametrize("body", BODIES)
def test_moment_turns_and_does_not_push(body):
    value = np.array([10.0, -20.0, 30.0])
    scene, block = one_block(body)
    scene.apply(fdem.Moment(value), block)
    sim = make(scene)
    force, moment = resultant(sim, block, body)
    np.testing.assert_allclose(force, 0, atol=1e-10)
    np.testing.assert_allclose(moment, value, rtol=1e-9)
    sim.run(time=1.0)
    # angular momentum is the moment times the time, as long as the block has hardly turned
    np.testing.assert_allclose(sim[block].angular_momentum, value, rtol=1e-4)


@pytest.mark.parametrize("body", BODIES)
def test_tractions(body):
    stress = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    cases = [
        # a face x = 1 of area 6: a traction, a stress, and a traction that grows with z
        (np.array([1.0, 2.0, 3.0]), [6.0, 12.0, 18.0], None),
        (stress, 6.0 * stress[[0, 5, 4]], None),
        (lambda x: np.column_stack([x[:, 2], 0 * x[:, 2], 0 * x[:, 2]]), [9.0, 0, 0], [0, 4.5, 0]),
    ]
    for value, total, moment in cases:
        scene, block = one_block(body)
        load = scene.apply(fdem.Traction(value), block, where=plane(0, 1.0))
        sim = make(scene)
        force, turning = resultant(sim, block, body)
        np.testing.assert_allclose(force, total, rtol=1e-12, atol=1e-12)  # exact for linear tractions
        np.testing.assert_allclose(sim[load].force, total, rtol=1e-12, atol=1e-12)
        if moment is not None:
            # integral of (z - 3/2) z over the face: 2 * 27/12
            np.testing.assert_allclose(turning, moment, atol=1e-11)


def test_stress_on_the_whole_surface_is_in_balance():
    scene, block = one_block("zoned")
    scene.apply(fdem.Traction((1, 2, 3, 4, 5, 6)), block)
    sim = make(scene)
    force, moment = resultant(sim, block, "zoned")
    np.testing.assert_allclose(force, 0, atol=1e-10)  # divergence theorem: round-off of 50
    np.testing.assert_allclose(moment, 0, atol=1e-10)


def test_pressure_follows_the_face():
    scene = fdem.Scene(gravity=(0, 0, 0))
    spin = np.array([0, 0, np.pi / 2])
    block = scene.add(fdem.brick((0, 0, 0), SIZE), fdem.Rigid(), ROCK, angular_velocity=spin)
    scene.apply(fdem.Velocity((0, 0, 0), angular=spin), block)
    face = scene.apply(fdem.Pressure(7.0), block, where=plane(0, 1.0))
    around = scene.apply(fdem.Pressure(7.0), block)
    sim = make(scene, fdem.Explicit(dt=1e-3))
    np.testing.assert_allclose(sim[face].force, [-42, 0, 0], atol=1e-11)
    sim.run(time=1.0)
    # a quarter of a turn by exact rotations of 1e-3 each; Velocity turns by its constant rate: round-off
    sim.forces()
    np.testing.assert_allclose(sim[face].force, [0, -42, 0], atol=1e-9)
    np.testing.assert_allclose(sim[around].force, 0, atol=1e-9)  # closed surface


def test_pressure_compresses_by_the_bulk_modulus():
    scene, block = one_block("zoned")
    scene.apply(fdem.Pressure(1e4), block)
    for corner, parts in (((0, 0, 0), ("x", "y", "z")), ((0, 0, 3), ("x", "y")), ((0, 2, 0), "x")):
        scene.fix(scene.gridpoint(corner, block), parts)
    sim = make(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-8).converged
    bulk = YOUNG / (3 * (1 - 2 * POISSON))
    # strains of 7e-6: second order of that
    assert sim[block].strain[:3].sum() == pytest.approx(-1e4 / bulk, rel=1e-4)
    np.testing.assert_allclose(sim[block].zone_stress[:, :3], -1e4, rtol=1e-4)


# prescribed motion


def test_velocity_with_a_time_factor():
    scene, block = one_block("rigid", gravity=(0, 0, -10.0))
    load = scene.apply(fdem.Velocity((2.0, None, 0.0)), block, factor=lambda t: np.cos(3 * t))
    sim = make(scene, fdem.Explicit(dt=1e-3))
    sim.run(time=2.0)
    # midpoint rule: dt^2 w^2 / 24 = 4e-7; y is free and unloaded, z is held against gravity
    exact = [2 / 3 * np.sin(6.0), 0.0, 0.0]
    np.testing.assert_allclose(sim[block].displacement, exact, atol=2e-6)
    assert sim[load].force[2] == pytest.approx(10 * MASS, rel=1e-12)


def test_displacement_of_a_rigid_block_is_reached():
    scene, block = one_block("rigid")
    scene.apply(fdem.Displacement((0.1, None, -0.2)), block)
    sim = make(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-6).converged
    # prescribed displacements come to the solve ratio before the run is called converged
    np.testing.assert_allclose(sim[block].displacement, [0.1, 0, -0.2], atol=1e-6 * 0.2)


def test_displacement_is_reached_though_nothing_resists_at_first():
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(box((1, 1, 1), (1, 1, 1)), fdem.Zoned(strain="small"), fdem.Elastic(DENSITY, YOUNG, 0.0))
    scene.fix(block, where=plane(2, 0.0))
    pull = scene.apply(fdem.Displacement((None, None, 1e-4)), block, where=plane(2, 1.0))
    sim = make(scene, fdem.Relaxation())
    report = sim.solve(ratio=1e-6)
    assert report.converged
    assert report.cycles > 0
    # what pulls a bar of nu = 0 by 1e-4: E A 1e-4, up to the solve ratio and squares of the strain
    assert sim[pull].force[2] == pytest.approx(YOUNG * 1e-4, rel=1e-4)


# damping and bedding


@pytest.mark.parametrize("body", BODIES)
def test_drag_on_the_mass(body):
    scene, block = one_block(body, velocity=(1.0, 2.0, 0.0))
    drag = scene.apply(fdem.Drag(mass=3.0), block)
    sim = make(scene, fdem.Explicit(dt=5e-4))
    np.testing.assert_allclose(sim[drag].force, -3.0 * MASS * np.array([1, 2, 0]), rtol=1e-9, atol=1e-6)
    sim.run(time=1.0)
    # the centred update has an error of (alpha dt)^2 alpha t / 12 = 6e-7
    np.testing.assert_allclose(sim[block].velocity, np.exp(-3.0) * np.array([1, 2, 0]), rtol=1e-5, atol=1e-9)
    energy = sim.energy
    assert energy.damping == pytest.approx(0.5 * MASS * 5 * (1 - np.exp(-6.0)), rel=1e-3)
    assert energy.closure < 1e-3


@pytest.mark.parametrize("shear", [False, True])
def test_quiet_boundary_lets_a_wave_out(shear):
    cells, length = 40, 1.0
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(box((cells, 1, 1), (length, 0.025, 0.025)), fdem.Zoned(strain="small"), ROCK)
    # one-dimensional waves: P with the sides held, S with motion along y alone
    scene.fix(block, ("x", "z") if shear else ("y", "z"))
    lam, mu = ROCK.lame
    speed = np.sqrt((mu if shear else lam + 2 * mu) / DENSITY)
    axis = 1 if shear else 0
    scene.apply(fdem.Drag(), block, where=plane(0, length))
    traction = np.zeros(3)
    traction[axis] = 1e4
    pulse = 0.4 * length / speed  # 16 cells long
    scene.apply(
        fdem.Traction(traction),
        block,
        where=plane(0, 0.0),
        factor=lambda t: np.sin(np.pi * t / pulse) ** 2 if t < pulse else 0.0,
    )
    sim = make(scene)
    sim.run(time=0.6 * length / speed)
    sent = sim.energy.kinetic + sim.energy.strain
    sim.run(time=1.2 * length / speed)
    left = sim.energy.kinetic + sim.energy.strain
    # 1 %: the pulse is long against the cells, so that the discrete impedance is rho c; the last cell is lumped
    assert left < 0.01 * sent
    # the pulse carries the integral of t^2 A / (rho c): 3/8 of its length
    exact = 0.375 * 1e8 * 0.025**2 * pulse / (DENSITY * speed)
    assert sent == pytest.approx(exact, rel=0.02)
    assert sim.energy.closure < 0.01


@pytest.mark.parametrize("body", BODIES)
def test_support_carries_the_weight(body):
    scene, block = one_block(body, gravity=(1.0, 0, -10.0))
    bed = scene.apply(fdem.Support(normal=1e6, shear=5e5), block, where=plane(2, 0.0))
    sim = make(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-7).converged
    np.testing.assert_allclose(sim[bed].force, MASS * np.array([-1, 0, 10.0]), rtol=1e-5, atol=0.05)
    moved = sim[block].gridpoint_displacement
    base = (sim[block].gridpoints - moved)[:, 2] < 1e-9
    area = 2.0
    # the mean over the base follows from the forces alone; forces to 1e-5, tilting to second order
    assert moved[base, 2].mean() == pytest.approx(-MASS * 10 / (1e6 * area), rel=2e-3)
    if body == "rigid":
        assert moved[base, 0].mean() == pytest.approx(MASS / (5e5 * area), rel=2e-2)


def test_support_and_mass_swing_at_their_frequency():
    scene, block = one_block("rigid", velocity=(0, 0, 0.1))
    scene.apply(fdem.Support(normal=1e6), block, where=plane(2, 0.0))
    scene.fix(block, ("x", "y", "rotation"))
    omega = np.sqrt(1e6 * 2.0 / MASS)
    sim = make(scene, fdem.Explicit(dt=0.05 / omega))
    h = sim.history(block, "displacement", component="z", every=1)
    sim.run(time=4 * 2 * np.pi / omega)
    # leapfrog period: (omega dt)^2 / 24 a period
    error = (omega * sim.dt) ** 2 / 24 * 4 * 2 * np.pi
    assert np.abs(h.values - 0.1 / omega * np.sin(omega * h.time)).max() <= (error + 1e-3) * 0.1 / omega
    assert sim.energy.closure < 1e-3  # the energy of leapfrog breathes by (omega dt)^2 / 4


# in-situ stress


def test_in_situ_stress_is_in_equilibrium_at_the_start():
    depth, g = 10.0, 10.0
    scene = fdem.Scene(gravity=(0, 0, -g))
    shape = box((2, 2, 5), (4, 4, 0), (0, 0, -depth), jitter=0.2, seed=2)
    block = scene.add(shape, fdem.Zoned(mass="row-sum"), ROCK)
    scene.apply(fdem.Stress(zz=lambda x: DENSITY * g * x[:, 2], k=(0.5, 1.5)), block)
    for axis, name, at in ((0, "x", (0, 4)), (1, "y", (0, 4)), (2, "z", (-depth,))):
        scene.fix(block, name, where=lambda x, a=axis, p=at: np.min([np.abs(x[:, a] - v) for v in p], axis=0) < 1e-9)
    sim = make(scene, fdem.Relaxation())
    stress, centre = sim[block].zone_stress, sim[block].gridpoints[sim[block].zones].mean(axis=1)
    exact = DENSITY * g * centre[:, 2]
    np.testing.assert_allclose(stress[:, 2], exact, rtol=1e-10)
    np.testing.assert_allclose(stress[:, 0], 0.5 * exact, rtol=1e-10)
    np.testing.assert_allclose(stress[:, 1], 1.5 * exact, rtol=1e-10)
    # the centroid rule is exact for a linear stress, and row sums are the consistent weights: round-off
    assert sim.ratio < 1e-10


def test_uniform_in_situ_stress_with_matching_tractions_needs_no_cycle():
    scene = fdem.Scene(gravity=(0, 0, 0))
    stress = {"xx": -3e6, "yy": -1e6, "zz": -2e6, "yz": 1e5, "zx": -2e5, "xy": 3e5}
    block = scene.add(box((3, 3, 3), (1, 1, 1), jitter=0.2), fdem.Zoned(), ROCK)
    scene.apply(fdem.Stress(**stress), block)
    scene.apply(fdem.Traction(tuple(stress.values())), block)
    sim = make(scene, fdem.Relaxation())
    assert sim.ratio < 1e-10  # divergence theorem on every gridpoint: round-off
    report = sim.solve(ratio=1e-9)
    assert report.converged and report.cycles == 0


def test_in_situ_stress_nearly_balances_voronoi_weights():
    """Voronoi weights differ from the consistent ones locally: what is left to settle is local."""
    g, depth = 10.0, 10.0
    scene = fdem.Scene(gravity=(0, 0, -g))
    block = scene.add(box((1, 1, 10), (1, 1, 0), (0, 0, -depth)), fdem.Zoned(mass="voronoi"), ROCK)
    scene.apply(fdem.Stress(zz=lambda x: DENSITY * g * x[:, 2], k=(1 / 3, 1 / 3)), block)
    scene.fix(block, ("x", "y"))
    base = scene.fix(block, "z", where=plane(2, -depth))
    sim = make(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-8).converged
    assert sim[base].force[2] == pytest.approx(DENSITY * g * depth, rel=1e-6)
    # what is left to settle is local: far less than the settlement that gravity alone would cause
    modulus = YOUNG * (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON))
    assert np.abs(sim[block].gridpoint_displacement).max() < 0.02 * DENSITY * g * depth**2 / (2 * modulus)


# loads of the user's own


class Spring:
    """A force -k x - c v on every gridpoint."""

    def __init__(self, k, c):
        self.k, self.c = k, c

    def force(self, t, x, v):
        n = len(x)
        return -self.k / n * x - self.c / n * v


@pytest.mark.parametrize("body", BODIES)
def test_users_own_load(body):
    scene, block = one_block(body, shape=box((2, 2, 2), (0.5, 0.5, 0.5), (-0.5, -0.5, -0.5)), velocity=(0.1, 0, 0))
    mass = DENSITY
    k = mass * 4.0**2
    load = scene.apply(Spring(k, 0.1 * 2 * mass * 4.0), block)
    sim = make(scene, fdem.Explicit(dt=2e-4))
    h = sim.history(block, "displacement", component="x", every=10)
    sim.run(time=3.0)
    damped = 4.0 * np.sqrt(1 - 0.1**2)
    exact = 0.1 / damped * np.exp(-0.4 * h.time) * np.sin(damped * h.time)
    # rigid: second order but for the velocity that lags half a step, zeta omega dt = 8e-5;
    # zoned: equal shares on unequal masses strain the block a little
    assert np.abs(h.values - exact).max() <= (1e-3 if body == "rigid" else 2e-2) * 0.1 / 4.0
    assert sim[load].force.shape == (3,)


# supports


@pytest.mark.parametrize("body", BODIES)
def test_reactions_equal_loads(body):
    scene, block = one_block(body, gravity=(0, 0, -10))
    scene.apply(fdem.Force((500.0, -200.0, 0.0)), block)
    base = scene.fix(block, ("x", "y", "z", "rotation") if body == "rigid" else None, where=plane(2, 0.0))
    sim = make(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-9).converged
    np.testing.assert_allclose(sim[base].force, [-500, 200, 10 * MASS], rtol=1e-6)


def wedge(body):
    """A block with one oblique face, dipping 30 degrees towards +x, held across that face."""
    dip = np.radians(30.0)
    profile = [(0, 0), (2, -2 * np.tan(dip)), (2, 1), (0, 1)]
    scene = fdem.Scene(gravity=(0, 0, -10))
    block = scene.add(fdem.prism(profile, depth=1), body, ROCK)

    def below(x):
        return np.abs(x[:, 2] + x[:, 0] * np.tan(dip)) < 1e-9

    return scene, block, scene.fix(block, "normal", where=below), dip


@pytest.mark.parametrize("body", [fdem.Rigid(), fdem.Zoned()], ids=["rigid", "zoned"])
def test_fix_normal_lets_slide_along_the_face(body):
    scene, block, held, dip = wedge(body)
    sim = make(scene, fdem.Explicit())
    if np.isinf(sim.dt):
        sim = make(scene, fdem.Explicit(dt=1e-3))
    sim.run(time=0.2)
    moved = sim[block].displacement
    along = np.array([np.cos(dip), 0, -np.sin(dip)])
    normal = np.array([np.sin(dip), 0, np.cos(dip)])
    # frictionless: g sin(dip); the zoned block shakes on its support by its elastic settlement (1e-5 m)
    assert moved @ along == pytest.approx(0.5 * 10 * np.sin(dip) * 0.2**2, rel=1e-3)
    assert abs(moved @ normal) <= 1e-4
    if isinstance(body, fdem.Rigid):
        weight = sim[block].mass * 10
        np.testing.assert_allclose(sim[held].force, weight * np.cos(dip) * normal, atol=1e-9 * weight)


def test_roller_faces_by_normal_are_components():
    scene, block = one_block("zoned", gravity=(0, 0, -10))
    scene.fix(block, "normal", where=lambda x: (x[:, 2] < 1e-9) | plane(0, 0.0)(x) | plane(0, 1.0)(x))
    sim = make(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-7).converged
    moved = sim[block].gridpoint_displacement
    places = sim[block].gridpoints - moved
    assert np.abs(moved[plane(0, 0.0)(places), 0]).max() == 0.0
    assert np.abs(moved[plane(2, 0.0)(places), 2]).max() == 0.0
    assert np.abs(moved[plane(2, 0.0)(places), 1]).max() > 0.0


# start of motion


@pytest.mark.parametrize("body", BODIES)
def test_initial_velocity_and_spin(body):
    velocity, spin = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.2, -0.4])
    scene, block = one_block(body, velocity=velocity, angular_velocity=spin)
    sim = make(scene)
    np.testing.assert_allclose(sim[block].velocity, velocity, rtol=1e-12)
    np.testing.assert_allclose(sim[block].angular_velocity, spin, rtol=1e-9)
    # inertia-matched masses have the exact inertia
    np.testing.assert_allclose(sim[block].angular_momentum, INERTIA @ spin, rtol=1e-9)
    kinetic = 0.5 * MASS * velocity @ velocity + 0.5 * spin @ INERTIA @ spin
    assert sim.energy.kinetic == pytest.approx(kinetic, rel=1e-9)


@pytest.mark.parametrize("body", BODIES)
def test_free_flight_keeps_momentum(body):
    spin = np.array([0.3, 0.2, -0.4])
    scene, block = one_block(body, gravity=(0, 0, -10), velocity=(1, 0, 0), angular_velocity=spin)
    sim = make(scene, fdem.Explicit(dt=2e-4))
    before = sim[block].angular_momentum
    sim.run(time=0.5)
    # a parabola, exactly; momentum to round-off of 2500 steps
    assert np.abs(sim[block].displacement - [0.5, 0, -1.25]).max() <= 1e-6
    np.testing.assert_allclose(sim[block].velocity, [1, 0, -5], atol=1e-9)
    change = sim[block].angular_momentum - before
    assert np.linalg.norm(change) <= 1e-8 * np.linalg.norm(before)


def test_velocity_as_a_function_of_place():
    # a linear velocity field stretches the block by 1e-4; `gridpoints` are the stretched ones, hence 2e-4
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Zoned(size=0.6), fdem.Elastic(2000.0, 1e9, 0.25))
    scene.apply(fdem.Velocity(lambda x: 1e-3 * x * [1.0, 0.0, 0.0]), block)
    sim = fdem.Simulation(scene, fdem.Explicit(dt=1e-3))
    sim.run(time=0.1)
    np.testing.assert_allclose(sim[block].gridpoint_displacement[:, 0], 1e-4 * sim[block].gridpoints[:, 0], rtol=2e-4)
    assert np.abs(sim[block].gridpoint_displacement[:, 1:]).max() < 1e-15
