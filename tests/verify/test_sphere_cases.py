"""Impacts, friction and rolling of spheres against closed forms; cases and tolerances of the verification list."""

from __future__ import annotations

import math

import numpy as np
import pytest

import fdem

FLOOR = ((-1, -1, -0.2), (6, 1, 0))


def run(scene, integrator, **options):
    return fdem.Simulation(scene, integrator, progress=False, **options)


# ------------------------------------------------------------------ hertz_collision: Chung & Ooi (2011), tests 1 and 2

HERTZ = {
    "glass": (4.8e10, 0.2, 2800.0, 0.01, 10.0, False),
    "limestone": (2.0e10, 0.25, 2500.0, 0.01, 10.0, False),
    "aluminium": (7.0e10, 0.3, 2699.0, 0.1, 0.2, True),
    "magnesium": (4.0e10, 0.35, 1800.0, 0.1, 0.2, True),
}


@pytest.mark.parametrize("name", HERTZ)
def test_hertz_collision(name):
    """Force ``4/3 E* sqrt(R*) d^1.5``; tolerances at 100 steps: force and overlap 1e-3, duration 0.5 %, speed 1e-4."""
    young, poisson, density, radius, speed, wall = HERTZ[name]
    modulus = young / (1 - poisson**2) * (1.0 if wall else 0.5)
    curvature, mass = radius * (1.0 if wall else 0.5), density * 4 / 3 * np.pi * radius**3 * (1.0 if wall else 0.5)
    closing = speed * (1.0 if wall else 2.0)
    overlap = (15 * mass * closing**2 / (16 * modulus * np.sqrt(curvature))) ** 0.4
    force = 4 / 3 * modulus * np.sqrt(curvature) * overlap**1.5
    duration = 4 * np.sqrt(np.pi) / 5 * math.gamma(0.4) / math.gamma(0.9) * overlap / closing
    dt = duration / 100
    scene = fdem.Scene(gravity=(0, 0, 0))
    material = fdem.Elastic(density=density, young=young, poisson=poisson)
    if wall:  # without material: rigid
        scene.add(fdem.brick(*FLOOR), fdem.Rigid(), fixed=True)
        top = radius
    else:
        scene.add(fdem.sphere(radius), fdem.Rigid(), material, velocity=(0, 0, speed))
        top = 2 * radius
    ball = scene.add(
        fdem.sphere(radius, (0, 0, top + 1.5 * closing * dt)), fdem.Rigid(), material, velocity=(0, 0, -speed)
    )
    scene.joint(fdem.Hertz(friction=0))
    sim = run(scene, fdem.Explicit(dt=dt))
    push = sim.history(ball, "contact_force", component="z")
    depth = sim.history(lambda sim: max(-sim.contact_table()["gap"], default=0.0))
    sim.cycle(120)
    assert push.values.max() == pytest.approx(force, rel=1e-3)
    assert depth.values.max() == pytest.approx(overlap, rel=1e-3)
    assert (push.values > 0).sum() * dt == pytest.approx(duration, rel=5e-3)
    assert sim[ball].velocity[2] == pytest.approx(speed, rel=1e-4)


# ------------------------------------------------------------------ damped_restitution


def linear_without_tension(zeta):
    """Restitution of a spring and dashpot that do not pull: Schwager & Poeschel (2007)."""
    root = np.sqrt(1 - zeta**2)
    end = np.arctan2(2 * zeta * root, -(1 - 2 * zeta**2))
    return -np.exp(-zeta / root * end) * (np.cos(end) - zeta / root * np.sin(end))


def rebound(law, speed, dt, radius=0.01, steps=300):
    """Restitution of two equal spheres, their largest pull, and the energy closure."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    material = fdem.Elastic(density=2500, young=1e7, poisson=0.3)
    scene.add(fdem.sphere(radius), fdem.Rigid(), material, velocity=(0, 0, speed / 2))
    ball = scene.add(
        fdem.sphere(radius, (0, 0, 2 * radius + 0.5 * speed * dt)), fdem.Rigid(), material, velocity=(0, 0, -speed / 2)
    )
    scene.joint(law)
    sim = run(scene, fdem.Explicit(dt=dt))
    push = sim.history(ball, "contact_force", component="z")
    sim.cycle(steps)
    return sim[ball].velocity[2] / (speed / 2), push.values.min(), sim.energy.closure


@pytest.mark.parametrize("zeta", [0.02, 0.1, 0.3, 0.6])
def test_restitution_of_linear_damping(zeta):
    """Within 0.5 % at 100 steps per contact (1e-3 is reached: the dashpot acts mid-step); no tension."""
    mass, kn = 0.5 * 2500 * 4 / 3 * np.pi * 0.01**3, 1e8
    dt = np.pi * np.sqrt(mass / (kn * np.pi * 0.01**2)) / 100
    e, pull, closure = rebound(fdem.Coulomb(kn=kn, ks=0, friction=0, damping=zeta), 1.0, dt)
    assert e == pytest.approx(linear_without_tension(zeta), rel=1e-3)
    assert pull == 0.0
    assert closure < 5e-4


@pytest.mark.parametrize("wanted", [0.2, 0.5, 0.8, 0.95])
def test_restitution_of_hertz_does_not_depend_on_speed(wanted):
    """The coefficient asked for within 0.5 % at 100 steps, independent of speed to 1e-3; no tension."""
    found = []
    for speed in (0.01, 1.0):
        mass, modulus, curvature = 0.5 * 2500 * 4 / 3 * np.pi * 0.01**3, 1e7 / (2 * (1 - 0.09)), 0.005
        overlap = (15 * mass * speed**2 / (16 * modulus * np.sqrt(curvature))) ** 0.4
        e, pull, closure = rebound(fdem.Hertz(friction=0, restitution=wanted), speed, 2.9432750 * overlap / speed / 100)
        assert e == pytest.approx(wanted, rel=5e-3)
        assert pull == 0.0
        assert closure < 5e-4
        found.append(e)
    assert found[0] == pytest.approx(found[1], rel=1e-6)


# ------------------------------------------------------------------ mindlin_loop, simplified


def test_mindlin_spring_and_slider():
    """``ks = 8 G* a`` and the cap ``mu N`` to 1e-10; no loss below gross slip (a simplified model, and labelled so)."""
    young, poisson, radius, force, mu = 7e10, 0.3, 0.01, 100.0, 0.3
    modulus, shear = young / (2 * (1 - poisson**2)), young / (2 * (1 + poisson)) / (2 * (2 - poisson))
    contact_radius = (3 * force * (radius / 2) / (4 * modulus)) ** (1 / 3)
    overlap = contact_radius**2 / (radius / 2)
    scene = fdem.Scene(gravity=(0, 0, 0))
    material = fdem.Elastic(density=2700, young=young, poisson=poisson)
    low = scene.add(fdem.sphere(radius), fdem.Rigid(), material)
    scene.fix(low, component=("x", "y", "z", "rotation"))
    high = scene.add(
        fdem.sphere(radius, (0, 0, 2 * radius - overlap)), fdem.Rigid(), material, fixed=True, velocity=(1e-6, 0, 0)
    )
    scene.joint(fdem.Hertz(friction=float(np.degrees(np.arctan(mu)))))
    dt = 1e-5  # 1e-11 m a step: the normal turns by 1e-9, and forces change by its square
    sim = run(scene, fdem.Explicit(dt=dt))

    def forces():
        table = sim.contact_table()
        return table["traction"][0, 0] * table["area"][0], np.linalg.norm(table["traction"][0, 1:]) * table["area"][0]

    assert "simplified Mindlin" in sim.describe()
    sim.cycle(100)
    moved = 100 * dt * 1e-6
    assert forces()[0] == pytest.approx(force, rel=1e-10)
    assert forces()[1] == pytest.approx(8 * shear * contact_radius * moved, rel=1e-10)
    assert 8 * shear * contact_radius == pytest.approx(13533308.04157712, rel=1e-12)
    assert sim.energy.friction < 1e-9 * sim.energy.work
    back = sim.apply(fdem.Velocity((-2e-6, None, None)), high)  # to the other side: the same line
    sim.cycle(100)
    assert forces()[1] == pytest.approx(8 * shear * contact_radius * moved, rel=1e-9)
    assert sim.energy.friction < 1e-9 * 0.5 * 8 * shear * contact_radius * moved**2
    sim[back].factor = -2.5e3  # 5 mm/s: beyond the slip of mu N / (8 G* a) = 2.2e-6 m
    sim.cycle(60)
    normal, across = forces()
    assert across == pytest.approx(mu * normal, rel=1e-10)
    assert sim.contact_table()["state"].tolist() == [2]


# ------------------------------------------------------------------ newtons_cradle


def cradle(law, gap, steps, time):
    """Final speeds of five balls and the largest relative error of momentum."""
    n, radius, mass, stiffness = 5, 0.02, 0.25, 1e7
    scene = fdem.Scene(gravity=(0, 0, 0))
    material = fdem.Elastic(density=mass / (4 / 3 * np.pi * radius**3))
    balls = [
        scene.add(fdem.sphere(radius, (i * (2 * radius + gap), 0, 0)), fdem.Rigid(), material, velocity=(i == 0, 0, 0))
        for i in range(n)
    ]
    scene.joint(law)
    sim = run(scene, fdem.Explicit(dt=np.pi * np.sqrt(mass / 2 / stiffness) / steps))
    momentum = sim.history(lambda sim: sim[balls].velocity[:, 0].sum(), every=10)
    sim.run(time=time)
    return sim[balls].velocity[:, 0], np.abs(momentum.values - 1).max(), sim.energy


KN = 1e7 / (np.pi * 0.02**2)


def test_newtons_cradle_elastic():
    """Gaps wider than the overlap: the last ball leaves with the speed of the first (1e-3); energy 1e-4 at 50 steps."""
    u, momentum, energy = cradle(fdem.Coulomb(kn=KN, ks=0, friction=0), 1e-3, 50, 0.02)
    assert momentum < 1e-12
    np.testing.assert_allclose(u, [0, 0, 0, 0, 1], atol=1e-3)
    assert energy.kinetic == pytest.approx(0.125, rel=1e-4)


def test_newtons_cradle_with_restitution():
    """First pass at e = 0.5: 1/4, 3/16, 9/64, 27/256, 81/256, last ball to 1e-3; 100 steps per contact."""
    u, momentum, _ = cradle(fdem.Coulomb(kn=KN, ks=0, friction=0, restitution=0.5), 2e-3, 100, 0.0215)
    assert momentum < 1e-12
    assert u[-1] == pytest.approx(0.31640625, rel=1e-3)
    np.testing.assert_allclose(u, [0.25, 0.1875, 0.140625, 0.10546875, 0.31640625], rtol=2e-2)


def test_newtons_cradle_touching():
    """Gap far below the overlap: all at once; momentum to 1e-12 and energy to 1e-4 remain.

    60 steps for two balls: the chain is stiffer than a pair, at 50 steps the leapfrog itself is off by 1.3e-4.
    """
    _, momentum, energy = cradle(fdem.Coulomb(kn=KN, ks=0, friction=0), 2e-6, 60, 0.02)
    assert momentum < 1e-12
    assert energy.kinetic == pytest.approx(0.125, rel=1e-4)


# ------------------------------------------------------------------ rigid_sphere_slip_roll

R, M, G = 0.1, 1.0, 9.81
SOFT = M * G / (np.pi * R**2) / (5e-5 * R)  # penetration 5e-5 r under the weight


def on_floor(gravity, mu, speed, damping=0.1, **law):
    """A ball that starts in contact, at the penetration of its weight."""
    scene = fdem.Scene(gravity=gravity)
    scene.add(fdem.brick(*FLOOR), fdem.Rigid(), fixed=True)
    depth = -M * gravity[2] / (SOFT * np.pi * R**2)
    ball = scene.add(
        fdem.sphere(R, (0, 0, R - depth)),
        fdem.Rigid(),
        fdem.Elastic(density=M / (4 / 3 * np.pi * R**3)),
        velocity=(speed, 0, 0),
    )
    scene.joint(fdem.Coulomb(kn=SOFT, ks=SOFT, friction=float(np.degrees(np.arctan(mu))), damping=damping, **law))
    return scene, ball


def test_sphere_slides_then_rolls():
    """v = 5/7 v0 after 2 v0 / (7 mu g): speed, distance and loss to 1e-3."""
    mu, v0 = 0.2, 2.0
    scene, ball = on_floor((0, 0, -G), mu, v0)
    sim = run(scene, fdem.Explicit(safety=0.5))
    speed = sim.history(ball, "velocity", component="x")
    spin = sim.history(ball, "angular_velocity", component="y")
    place = sim.history(ball, "position", component="x")
    sim.run(time=0.6)
    v = 5 * v0 / 7
    end = (v0 - v) / (mu * G)
    slips = np.argmax(speed.values - R * spin.values < 1e-4 * v0)
    assert speed.values[-1] == pytest.approx(v, rel=1e-3)
    assert spin.values[-1] * R == pytest.approx(v, rel=1e-3)
    assert speed.time[slips] == pytest.approx(end, rel=5e-3)
    assert np.interp(end, place.time, place.values) == pytest.approx(v0 * end - mu * G * end**2 / 2, rel=1e-3)
    assert sim.energy.friction == pytest.approx(0.5 * M * v0**2 - 0.7 * M * v**2, rel=1e-3)
    assert sim.energy.closure < 1e-3


@pytest.mark.parametrize("mu", [0.1, 0.16, 0.17, 0.5])
def test_sphere_on_incline(mu):
    """Slides below mu = 2/7 tan 30 = 0.165, else rolls with 5/7 g sin 30: speeds at 1 s to 1e-3."""
    a = np.radians(30)
    scene, ball = on_floor((G * np.sin(a), 0, -G * np.cos(a)), mu, 0.0)
    sim = run(scene, fdem.Explicit(safety=0.5))
    sim.run(time=1.0)
    rolls = mu >= 2 / 7 * np.tan(a)
    acceleration = 5 / 7 * G * np.sin(a) if rolls else G * (np.sin(a) - mu * np.cos(a))
    turning = acceleration / R if rolls else 2.5 * mu * G * np.cos(a) / R
    assert sim[ball].velocity[0] == pytest.approx(acceleration, rel=1e-3)
    assert sim[ball].angular_velocity[1] == pytest.approx(turning, rel=1e-3)
    assert sim.energy.closure < 1e-4


@pytest.mark.parametrize("share, stays", [(0.95, True), (1.05, False)])
def test_rolling_resistance_holds_a_ball_up_to_its_limit(share, stays):
    """A couple of l N holds while tan(slope) < l / r (moment about the contact: m g r sin against l m g cos)."""
    length = 0.02 * R
    a = np.arctan(share * length / R)
    scene, ball = on_floor((0, 0, -G), 0.5, 0.0, damping=0.3, rolling=length)
    # slowly: the rolling spring swings with a period of 0.3 s and nothing damps it below the limit
    scene.apply(fdem.Force((M * G * np.sin(a) / np.cos(a), 0, 0)), ball, factor=lambda t: min(t, 1.0))
    sim = run(scene, fdem.Explicit(safety=0.8))
    sim.run(time=1.5)
    moved = sim[ball].displacement[0]
    # the springs give way by d / l = 2.5e-3 rad at the limit; beyond, it rolls with a = 5/7 g (tan a - l / r)
    free = 5 / 14 * G * 0.05 * length / R * 0.5**2
    assert moved < 3.5e-3 * R if stays else moved > free
    assert sim.energy.closure < 1e-3


def test_twisting_resistance_stops_a_spinning_ball():
    """A ball that spins about the vertical is stopped by the couple l N: in I w / (l m g)."""
    length, w = 0.05 * R, 10.0
    scene, ball = on_floor((0, 0, -G), 0.3, 0.0, damping=0.3, twisting=length)
    ball.set(angular_velocity=np.array([0.0, 0.0, w]))
    sim = run(scene, fdem.Explicit(safety=0.5))
    spin = sim.history(ball, "angular_velocity", component="z")
    stop = 0.4 * M * R**2 * w / (length * M * G)
    sim.run(time=1.1 * stop)
    half = np.interp(0.5 * stop, spin.time, spin.values)
    assert half == pytest.approx(0.5 * w, rel=2e-3)
    assert abs(spin.values[-1]) < 0.02 * w
    assert sim.energy.friction == pytest.approx(0.5 * 0.4 * M * R**2 * w**2, rel=5e-3)


# ------------------------------------------------------------------ rigid_bouncing_sphere


def test_bouncing_sphere():
    """Apex heights fall by e^2 within 0.5 %; impact times within the contact times they are late by."""
    e, h, dt = 0.8, 1.0, 4e-5
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((-1, -1, -0.2), (1, 1, 0)), fdem.Rigid(), fixed=True)
    material = fdem.Elastic(density=2500, young=1e8, poisson=0.2)
    ball = scene.add(fdem.sphere(0.1, (0, 0, h + 0.1)), fdem.Rigid(), material)
    scene.joint(fdem.Hertz(friction=0, restitution=e))
    sim = run(scene, fdem.Explicit(dt=dt))
    height = sim.history(ball, "position", component="z", every=5)
    push = sim.history(lambda sim: sim.system.particles.stiffest, every=5)
    sim.run(time=1.7)
    z = height.values - 0.1
    apex = np.flatnonzero((z[1:-1] > z[:-2]) & (z[1:-1] >= z[2:])) + 1
    heights = np.concatenate([[h], z[apex]])
    assert len(heights) >= 3
    np.testing.assert_allclose(heights[1:] / heights[:-1], e**2, rtol=5e-3)
    first = np.sqrt(2 * h / G)
    hits = height.time[1:][(push.values[1:] > 0) & (push.values[:-1] == 0)]
    exact = first * (1 + 2 * np.concatenate([[0], np.cumsum(e ** np.arange(1, len(hits)))]))
    # a contact lasts 2.94 d / v, 3 ms at first and longer for slower ones: each impact delays the next ones by it
    np.testing.assert_allclose(hits, exact, atol=4e-3 * len(hits))


def heap(rolling):
    """Angle [deg] of the heap that a column of balls between two smooth walls falls to.

    A triangle of section A and base angle a has its centroid at z with tan a = 9 z^2 / A.
    """
    r, wide, deep, high = 0.01, 6, 2, 14
    stone = fdem.Elastic(density=2500, young=1e7, poisson=0.25)
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -0.1), (1, 1, 0)), fdem.Rigid(), stone, fixed=True, name="floor")
    pitch = 2.02 * r
    for name, (low, top) in {"front": (-0.1, 0.0), "back": (deep * pitch, 1.0)}.items():
        wall = fdem.brick((-1, low, 0), (1, top, 1))
        scene.add(wall, fdem.Rigid(), stone, fixed=True, name=name, group="walls")
    i, j, k = (part.ravel() for part in np.indices((wide, deep, high)))
    centres = np.column_stack([i - 0.5 * (wide - 1), j + 0.5, k + 0.5]) * pitch
    centres += np.random.default_rng(3).uniform(-0.01, 0.01, centres.shape) * r
    scene.add([fdem.sphere(r, c) for c in centres], fdem.Rigid(), stone, group="bed")
    scene.joint(fdem.Hertz(friction=30, restitution=0.3, rolling=rolling * r))
    scene.joint(fdem.Hertz(friction=0, restitution=0.3), between=("walls", "bed"))
    sim = fdem.Simulation(scene, fdem.Explicit(), progress=False, energy=False)
    sim.run(time=1.2)
    height = sim["bed"].position[:, 2].mean()
    section = len(centres) * 4 / 3 * np.pi * r**3 / (0.6 * deep * pitch)
    return np.degrees(np.arctan(9 * height**2 / section))


@pytest.mark.long
def test_angle_of_repose_grows_with_rolling_resistance():
    """Balls that roll freely lie flat; with a rolling length of 0.1 and 0.3 radii they stand up (4, 13, 21 degrees)."""
    angles = [heap(rolling) for rolling in (0.0, 0.1, 0.3)]
    assert angles[0] + 2.0 < angles[1] and angles[1] + 2.0 < angles[2] < 45.0
