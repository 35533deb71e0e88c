"""Spheres and clumps in scenes: what they touch, what is kept, what is left out."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scenes import quietly

import fdem
from fdem.contact.sphere_springs import alone, stiffest_alone
from fdem.kernels import particles as kernels

R = 0.1
STONE = fdem.Elastic(density=2500, young=1e8, poisson=0.25)
MASS = 2500 * 4 / 3 * np.pi * R**3
KN = 1e8
SPRING = KN * np.pi * R**2


def simulation(scene, integrator=None, **options):
    return quietly(fdem.Simulation, scene, integrator or fdem.Explicit(), progress=False, **options)


def coulomb(friction=30, **law):
    return fdem.Coulomb(**{"kn": KN, "ks": KN, "friction": friction, **law})


# ------------------------------------------------------------------ detection


def listed(x, reach):
    """Pairs that the kernels find, as a set of sorted ids, and the list itself."""
    n = len(x)
    level, cell, origin, key = np.zeros(n, np.int64), np.zeros((n, 3), np.int64), np.zeros(3), np.zeros(n, np.int64)
    kernels.cells(x, reach, level, cell, origin)
    fits = kernels.sort_keys(level, cell, key)
    order = np.sort(key) % n if fits else np.lexsort((cell[:, 2], cell[:, 1], cell[:, 0], -level))
    own = np.arange(n, dtype=np.int32)
    near = (x[order], reach[order], own, np.ones(n, dtype=bool), level[order], cell[order])
    start, partner = kernels.near_pairs(*near, *kernels.tabulate(*near[4:]), 0.9)
    first = np.repeat(order, np.diff(start.astype(np.int64)))
    second = order[partner]
    pairs = set(zip(np.minimum(first, second).tolist(), np.maximum(first, second).tolist(), strict=True))
    assert len(pairs) == len(partner)
    return pairs


def brute(x, reach):
    """The same by comparing all."""
    found = set()
    for i in range(len(x) - 1):
        apart = np.linalg.norm(x[i + 1 :] - x[i], axis=1)
        found |= {(i, i + 1 + int(j)) for j in np.flatnonzero(apart < reach[i] + reach[i + 1 :])}
    return found


@pytest.mark.parametrize("seed, low, box", [(0, 1.0, 1.0), (1, 1e-3, 1.0), (2, 1e-2, 50.0)])
def test_near_pairs_are_those_of_all_pairs(seed, low, box):
    rng = np.random.default_rng(seed)
    x, reach = rng.uniform(0, box, (1500, 3)), 0.04 * np.exp(rng.uniform(np.log(low), 0.0, 1500))
    assert listed(x, reach) == brute(x, reach)


def test_many_sizes_in_a_wide_domain():
    """10,000 spheres, sizes 1 : 10,000, in 1000 km: the pairs of all pairs, and at most 2 kB for a body."""
    rng = np.random.default_rng(0)
    n = 10_000
    radius = 10 ** rng.uniform(0, 4, n)
    x = rng.uniform(0, 1e6, (n, 3))
    x[: n // 2] = x[n // 2 :] + rng.normal(size=(n // 2, 3)) * radius[n // 2 :, None]  # half of them near another
    reach = 1.05 * radius
    assert listed(x, reach) == brute(x, reach)
    # without overlap deeper than half a radius, as scenes demand
    deep = {a for a, b in brute(x, radius) for a in (a, b)}
    keep = np.array(sorted(set(range(n)) - deep))
    assert len(keep) > 3000

    def built(rows):
        scene = fdem.Scene()
        scene.add([fdem.sphere(radius[i], x[i]) for i in rows], fdem.Rigid(), STONE)
        scene.joint(fdem.Hertz(friction=20))
        return scene

    simulation(built(keep[:5]))  # what is imported and compiled is no part of it
    scene = built(keep)
    tracemalloc.start()
    sim = simulation(scene)
    used, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    contacts = sim.system.particles
    first, second = contacts.pair_particles()
    found = set(zip(np.minimum(first, second).tolist(), np.maximum(first, second).tolist(), strict=True))
    assert found == brute(x[keep] - sim.model.origin, contacts.particles.radius + contacts.allowed)
    assert used / len(keep) < 2000


# ------------------------------------------------------------------ faces, edges, vertices


def pressed(shape, place, law=None):
    """Force on a ball held at `place` against a fixed shape, over the spring of its reference area, and contacts."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(shape, fdem.Rigid(), fixed=True)
    ball = scene.add(fdem.sphere(R, place), fdem.Rigid(), STONE)
    scene.joint(law or coulomb())
    sim = simulation(scene)
    return sim[ball].contact_force / SPRING, len(sim.contact_table()["gap"])


CUBE = fdem.brick((-1, -1, -1), (0, 0, 0))
DEPTH = 0.001


@pytest.mark.parametrize(
    "nearest, direction",
    [
        ((-0.5, -0.5, 0), (0, 0, 1)),
        ((0, -0.5, 0), (1, 0, 1)),
        ((0, -0.5, 0), (1, 0, 0.001)),
        ((0, 0, 0), (1, 1, 1)),
        ((0, 0, 0), (1, 1e-6, 1)),
        ((0, -1e-9, 0), (0.3, 0, 1)),
    ],
)
def test_force_comes_from_the_nearest_point(nearest, direction):
    """Inside a face, on an edge, at a vertex: one force, along the line from the nearest point to the centre."""
    d = np.array(direction) / np.linalg.norm(direction)
    force, count = pressed(CUBE, np.array(nearest) + (R - DEPTH) * d)
    np.testing.assert_allclose(force, DEPTH * d, atol=1e-12)
    assert count == 1


def test_a_cylinder_is_round_to_its_tolerance():
    """At any angle one force: depth to tolerance x radius, as stated, direction to half the angle between facets."""
    tolerance, radius, depth = 1e-3, 0.5, 0.002
    shape = fdem.cylinder(radius, (0, 0, -1), (0, 0, 1), tolerance=tolerance)
    facets = len(shape.faces) - 2
    worst = 0.0
    for angle in [0.0, np.pi / facets, *np.random.default_rng(0).uniform(0, 2 * np.pi, 8)]:
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        force, count = pressed(shape, (radius + R - depth) * out)
        assert count == 1
        assert abs(np.linalg.norm(force) - depth) <= tolerance * radius
        assert force @ out >= np.linalg.norm(force) * np.cos(np.pi / facets)
        worst = max(worst, abs(np.linalg.norm(force) - depth))
    assert worst > 0.1 * tolerance * radius  # the facets are there


def test_two_faces_of_a_corner_both_push():
    ell = fdem.prism([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], 1.0)
    force, count = pressed(ell, (1 + R - 0.001, 0.5, 1 + R - 0.002))
    np.testing.assert_allclose(force, (0.001, 0, 0.002), atol=1e-12)
    assert count == 2


def test_a_box_corner_has_three_contacts_with_three_blocks():
    scene = fdem.Scene(gravity=(0, 0, 0))
    for lower, upper in (((-1, -1, -1), (1, 1, 0)), ((-1, -1, 0), (0, 1, 1)), ((0, -1, 0), (1, 0, 1))):
        scene.add(fdem.brick(lower, upper), fdem.Rigid(), fixed=True)
    ball = scene.add(fdem.sphere(R, (0.099, 0.098, 0.097)), fdem.Rigid(), STONE)
    scene.joint(coulomb())
    sim = simulation(scene)
    np.testing.assert_allclose(sim[ball].contact_force / SPRING, (0.001, 0.002, 0.003), atol=1e-12)


def rolling_floor(kind):
    scene = fdem.Scene()
    if kind == "zoned":
        floor = scene.add(fdem.brick((-0.5, -0.5, -0.2), (1.5, 0.5, 0)), fdem.Zoned(size=0.1), STONE)
        scene.fix(floor, where=lambda x: np.ones(len(x), dtype=bool))
    elif kind == "triangles":
        side = np.linspace(-0.5, 1.5, 21)
        grid = np.array([(x, y, 0.0) for x in side for y in side - 0.5])
        at = np.arange(441).reshape(21, 21)
        a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
        faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
        scene.add(fdem.surface(grid, faces.tolist()), fdem.Rigid(), fixed=True)
    else:
        scene.add(fdem.brick((-0.5, -0.5, -0.2), (1.5, 0.5, 0)), fdem.Rigid(), STONE, fixed=True)
    return scene


@pytest.mark.parametrize("kind", ["face", "triangles", "zoned"])
def test_a_ball_that_rolls_over_mesh_lines_feels_no_kick(kind):
    """Normal force to round-off of the depth, one contact, no friction, whatever the triangles below."""
    scene = rolling_floor(kind)
    depth = MASS * 9.81 / SPRING
    spin = np.array([-0.3, 1.0, 0.0]) / (R - depth)
    ball = scene.add(
        fdem.sphere(R, (-0.2, -0.17, R - depth)), fdem.Rigid(), STONE, velocity=(1, 0.3, 0), angular_velocity=spin
    )
    scene.joint(coulomb())
    sim = simulation(scene)
    found = []
    sim.history(lambda sim: found.append([len(sim.contact_table()["gap"]), *sim[ball].contact_force]) or 0.0, every=2)
    sim.run(time=0.9)
    count, *force = np.array(found).T
    assert (count == 1).all()
    # positions of 1 m have round-off 1e-16, the depth is 3e-5 m
    np.testing.assert_allclose(force[2] / (MASS * 9.81), 1.0, atol=1e-10)
    assert np.abs(force[:2]).max() < 1e-10 * MASS * 9.81
    np.testing.assert_allclose(sim[ball].velocity, (1, 0.3, 0), atol=1e-12)
    assert len(sim.system.particles.faces.used) > 5 if kind == "zoned" else True


def test_rolling_over_the_facets_of_a_dome_is_one_contact():
    """A curved surface of triangles: always one contact, and energy is kept while nothing slips."""
    dome = fdem.icosphere(1.0, (0, 0, 0), 3)
    scene = fdem.Scene()
    scene.add(dome, fdem.Rigid(), fixed=True)
    ball = scene.add(fdem.sphere(R, (0.02, 0.01, 1.0 + R)), fdem.Rigid(), STONE)
    scene.joint(fdem.Hertz(friction=60, young=1e9, poisson=0.3, restitution=0.5))
    sim = simulation(scene)
    count = sim.history(lambda sim: len(sim.contact_table()["gap"]), every=20)
    sim.run(time=0.8)
    assert sim[ball].position[0] > 0.05
    assert count.values.max() == 1
    assert sim.energy.closure < 2e-3


# ------------------------------------------------------------------ balances


def momenta(sim, blocks):
    view = sim[blocks]
    linear = view.mass[:, None] * view.velocity
    return linear.sum(axis=0), (np.cross(view.position, linear) + view.angular_momentum).sum(axis=0)


@pytest.mark.parametrize(
    "body, law, closure",
    [
        (fdem.Rigid(), coulomb(0), 2e-3),
        (fdem.Rigid(), coulomb(30), 2e-3),
        (fdem.Rigid(), fdem.Hertz(friction=30), 1e-3),
        (fdem.UniformStrain(), coulomb(20), 5e-3),
        (fdem.Zoned(size=0.3), coulomb(20), 5e-3),
    ],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_impact_on_a_free_cube_keeps_momentum(body, law, closure, seed):
    """Face, edge or corner of a turning cube, with friction: both momenta to 1e-11, energy with what was dissipated."""
    rng = np.random.default_rng(seed)
    scene = fdem.Scene(gravity=(0, 0, 0))
    cube = scene.add(fdem.brick((-0.3, -0.3, -0.3), (0.3, 0.3, 0.3)), body, STONE, angular_velocity=rng.normal(size=3))
    d = rng.normal(size=3)
    d /= np.linalg.norm(d)
    place = 0.7 * d + rng.uniform(-0.2, 0.2, 3)
    ball = scene.add(
        fdem.sphere(R, place), fdem.Rigid(), STONE, velocity=-5 * d, angular_velocity=5 * rng.normal(size=3)
    )
    scene.joint(law)
    sim = simulation(scene, fdem.Explicit(safety=0.2))
    before = momenta(sim, [cube, ball])
    sim.run(time=0.15)
    after = momenta(sim, [cube, ball])
    assert sim[ball].velocity @ d > -4.5  # it hit
    for old, new in zip(before, after, strict=True):
        np.testing.assert_allclose(new, old, atol=1e-11 * 5 * MASS)
    assert sim.energy.closure < closure


def gas(shapes, speed, law, seed=3):
    rng = np.random.default_rng(seed)
    scene = fdem.Scene(gravity=(0, 0, 0))
    for shape in shapes:
        v = -speed * shape.centroid / np.linalg.norm(shape.centroid) + 0.3 * speed * rng.normal(size=3)
        scene.add(shape, fdem.Rigid(), STONE, velocity=v, angular_velocity=3 * rng.normal(size=3), group="gas")
    scene.joint(law)
    return scene


def scattered(n, make, seed=0):
    """Shapes on a coarse lattice, so that none overlap."""
    rng = np.random.default_rng(seed)
    places = 3.2 * R * (np.stack(np.meshgrid(*3 * [np.arange(n)], indexing="ij"), -1).reshape(-1, 3) - 0.5 * (n - 1.1))
    return [make(place + rng.uniform(-0.1, 0.1, 3) * R, rng) for place in places]


def ball_at(place, rng):
    return fdem.sphere(R * rng.uniform(0.5, 1.0), place)


def clump_at(place, rng):
    d = rng.normal(size=3)
    d *= 0.4 * R / np.linalg.norm(d)
    return fdem.clump([(place - d, 0.6 * R), (place + d, 0.5 * R), (place, 0.55 * R)])


@pytest.mark.parametrize("make", [ball_at, clump_at])
def test_collisions_of_many_keep_momentum(make):
    law = coulomb(25, rolling=0.01 * R, twisting=0.01 * R, restitution=0.7)
    sim = simulation(gas(scattered(3, make), 3.0, law), fdem.Explicit(safety=0.5))
    before = momenta(sim, "gas")
    sim.run(time=0.3)
    after, energy = momenta(sim, "gas"), sim.energy
    assert energy.friction > 0.01 * energy.kinetic
    scale = np.abs(sim["gas"].mass[:, None] * sim["gas"].velocity).sum()
    for old, new in zip(before, after, strict=True):
        np.testing.assert_allclose(new, old, atol=1e-12 * scale)
    assert energy.closure < 5e-3


def test_turning_the_whole_scene_turns_the_result():
    """Oblique impact of two balls of different size, seen from axes turned by 37 degrees: 1e-9."""
    k = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    cross = np.cross(np.eye(3), -k)
    turn = np.eye(3) + np.sin(0.6458) * cross + (1 - np.cos(0.6458)) * cross @ cross
    results = []
    for axes in (np.eye(3), turn):
        scene = fdem.Scene(gravity=(0, 0, 0))
        for radius, place, v, w in (
            (R, (0, 0, 0), (1, 0.5, 0), (2, 3, 4)),
            (0.6 * R, (0.2, 0.05, 0.03), (-2, 0, 0), (-5, 1, 0)),
        ):
            scene.add(
                fdem.sphere(radius, axes @ place), fdem.Rigid(), STONE, velocity=axes @ v, angular_velocity=axes @ w
            )
        scene.joint(coulomb(20, rolling=0.01 * R, twisting=0.02 * R, damping=0.1))
        sim = simulation(scene, fdem.Explicit(dt=2e-5))
        sim.cycle(2500)
        view = sim[scene.blocks]
        results.append(np.concatenate([view.position, view.velocity, view.angular_velocity]) @ axes)
    np.testing.assert_allclose(results[1], results[0], atol=1e-9)


# ------------------------------------------------------------------ no tunnelling


@pytest.mark.parametrize("speed", [100.0, 1000.0])
def test_fast_spheres_do_not_pass_a_thin_plate(speed):
    """Radius 0.05 m against 0.01 m: rebound within 5 % with the step chosen, never through with any other step."""
    rng = np.random.default_rng(int(speed))
    law = fdem.Coulomb(kn=1e12, ks=1e12, friction=30)
    for trial in range(20):
        scene = fdem.Scene(gravity=(0, 0, 0))
        scene.add(fdem.brick((-1, -1, -0.01), (1, 1, 0)), fdem.Rigid(), fixed=True)
        gap = rng.uniform(0, 0.05)
        ball = scene.add(fdem.sphere(0.05, (0.3, -0.2, 0.05 + gap)), fdem.Rigid(), STONE, velocity=(0, 0, -speed))
        scene.joint(law)
        dt = None if trial < 3 else rng.uniform(0.001, 0.05) / speed
        sim = simulation(scene, fdem.Explicit(dt=dt))
        try:
            sim.run(time=0.4 / speed)
        except fdem.OverlapError:
            assert dt is not None
            continue
        assert sim[ball].position[2] > 0.0
        if dt is None:
            assert sim[ball].velocity[2] == pytest.approx(speed, rel=0.05)  # S09 of the oracle: within 5 %


@pytest.mark.long
def test_none_of_a_thousand_phases_tunnels():
    """Steps of twice the thickness: rebound or refusal, whatever the distance at the start."""
    rng = np.random.default_rng(0)
    for k in range(1000):
        speed = (100.0, 1000.0)[k % 2]
        scene = fdem.Scene(gravity=(0, 0, 0))
        scene.add(fdem.brick((-1, -1, -0.01), (1, 1, 0)), fdem.Rigid(), fixed=True)
        place = (0.3, -0.2, 0.05 + rng.uniform(0, 0.05))
        ball = scene.add(fdem.sphere(0.05, place), fdem.Rigid(), STONE, velocity=(0, 0, -speed))
        scene.joint(fdem.Coulomb(kn=10 ** rng.uniform(9, 13), ks=0, friction=0))
        sim = simulation(scene, fdem.Explicit(dt=0.02 / speed))
        try:
            sim.run(time=0.4 / speed)
        except fdem.SolveError:
            continue
        assert sim[ball].position[2] > 0.0


def test_two_fast_spheres_do_not_pass_each_other():
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.sphere(R, (0, 0, 0)), fdem.Rigid(), STONE, name="a", velocity=(100, 0, 0))
    scene.add(fdem.sphere(R, (1.0, 0.05, 0)), fdem.Rigid(), STONE, name="b", velocity=(-100, 0, 0))
    scene.joint(fdem.Coulomb(kn=1e11, ks=0, friction=0))
    sim = simulation(scene, fdem.Explicit(dt=2e-3))
    with pytest.raises(fdem.OverlapError, match="'a' and 'b' meet in a step"):
        sim.cycle(10)


def test_a_deep_overlap_is_refused():
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.sphere(R, (0, 0, 0)), fdem.Rigid(), STONE, name="a")
    scene.add(fdem.sphere(R, (0.9 * R, 0, 0)), fdem.Rigid(), STONE, name="b")
    scene.joint(coulomb())
    with pytest.raises(fdem.SceneError, match="'a' and 'b' overlap by more than half a radius"):
        simulation(scene)


def test_spheres_alone_meet_by_an_implicit_rule():
    """No block has faces here; the speeds are those of the explicit run, both right to 1e-3 at 80 steps a contact."""
    speeds = []
    for integrator in (fdem.Newmark(dt=5e-7), fdem.Explicit(dt=5e-7)):
        scene, glass = fdem.Scene(gravity=(0, 0, 0)), fdem.Elastic(2800.0, 4.8e10, 0.2)
        balls = [
            scene.add(fdem.sphere(R / 10, (0, 0, 0.2001 * k * R)), fdem.Rigid(), glass, velocity=(0, 0, 10 * (1 - k)))
            for k in range(2)
        ]
        scene.joint(fdem.Hertz(friction=0))
        sim = simulation(scene, integrator)
        sim.run(time=2.5e-5)
        assert sim[balls].velocity[:, 2].sum() == pytest.approx(10.0, rel=1e-9)
        speeds.append(sim[balls[1]].velocity[2])
    assert 1.0 < speeds[0] < 9.0  # still in contact
    assert speeds[0] == pytest.approx(speeds[1], abs=1e-2)  # 1e-3 of the speed of approach: what each is right to


def test_a_kick_is_the_acceleration_over_a_time():
    """Whether it is made in one pass or by way of the accelerations, and the fastest of each kind are the stiffest."""
    rng = np.random.default_rng(3)
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (1, 1, 0)), fdem.Rigid(), STONE, name="cube")
    for k in range(8):
        shape = fdem.sphere(R * (1 + k % 2), (0.5 * k, 0, 0.5))
        scene.add(shape, fdem.Rigid(), STONE, velocity=tuple(rng.normal(size=3)))
    scene.joint(fdem.Hertz(friction=30))
    system = simulation(scene).system
    v, f = system.state.v, system.state.f
    f[:] = rng.normal(size=len(f))
    before, after = v.copy(), v + 0.3 * system.accelerate(f)
    for kick in (system._kick_free, system._kick_held):
        v[:] = before
        kick(0.3)
        # one product is rounded in another order
        np.testing.assert_allclose(v, after, rtol=1e-14, atol=1e-14 * np.abs(after).max())
    contacts, speed = system.particles, system._speeds()
    each = alone(contacts, speed) * contacts.inverse_mass[contacts.particles.block]
    assert len(np.unique(each.round(3))) == 8
    assert stiffest_alone(contacts, speed) == pytest.approx(each.max(), rel=1e-14)
