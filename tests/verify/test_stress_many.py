"""Stress scenarios of many blocks: broad phase, contacts that come and go, walls at rest.

S-numbers are those of the list of numerical stress scenarios; the number beside each assertion is the one listed.
"""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from test_broad import brute
from verify.meshes import box

import fdem
from fdem.contact.broad import REACH, candidate_pairs

G = 9.81
STONE = fdem.Elastic(density=2000.0, young=1e10, poisson=0.2)


def chains(n):
    """Bricks of 0.1 to 1000 m anywhere in 1e6 m, in chains whose members touch, nearly touch or do not."""
    rng = np.random.default_rng(36)
    lower, upper, left = [], [], 0
    for edge in 10.0 ** rng.uniform(-1, 3, n):
        sizes = edge * rng.uniform(0.3, 1, 3)
        if left == 0:
            end, left = rng.uniform(0, 1e6, 3), rng.integers(1, 12)
        low = end - [0, *rng.uniform(0, 0.4, 2)] * sizes
        lower.append(low)
        upper.append(low + sizes)
        end = low + sizes * [1, 0.5, 0.5] + [rng.choice([0, 1e-3, 0.03]) * sizes.min(), 0, 0]
        left -= 1
    return np.array(lower), np.array(upper)


@pytest.mark.parametrize("n", [1000, pytest.param(10_000, marks=pytest.mark.long)])
def test_s36_broad_phase_of_a_large_domain(n):
    """1e4 bodies, sizes 1 : 1e4, domain 1e6 m: pairs equal brute force, memory <= 2 kB a body."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    lower, upper = chains(n)
    for low, up in zip(lower, upper, strict=True):
        scene.add(fdem.brick(low, up), fdem.Rigid(), STONE)
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    sim = fdem.Simulation(scene, fdem.Explicit(), progress=False, energy=False)
    c = sim.system.contacts
    expected = brute(lower - sim.model.origin, upper - sim.model.origin, REACH * c._skins, np.zeros(n, np.uint8))
    assert len(expected) > n / 3
    np.testing.assert_array_equal(c.pairs, expected)
    tracemalloc.start()
    candidate_pairs(c.surfaces, sim.state.x, c._skins, None)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak <= 2048 * n


def heap(shape):
    """Bricks in random positions that fall onto a floor and each other; smooth, so forces depend on positions alone."""
    rng = np.random.default_rng(1)
    scene = fdem.Scene(gap_tolerance=0)
    scene.add(fdem.brick((-2, -2, -1), (4, 4, 0)), fdem.Rigid(), fixed=True, name="floor")
    for i, j, k in np.ndindex(*shape):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        place, half = np.eye(4), rng.uniform(0.06, 0.09, 3)
        place[:3, :3], place[:3, 3] = turn * np.sign(np.linalg.det(turn)), [0.3 * i, 0.3 * j, 0.3 + 0.3 * k]
        scene.add(fdem.brick(-half, half).transform(place), fdem.Rigid(), STONE, velocity=(0, 0, -1))
    scene.joint(fdem.Coulomb(kn=5e8, ks=5e8, friction=0))
    return fdem.Simulation(scene, fdem.Explicit(), progress=False, energy=False)


def compiled_afresh(sim):
    """The same blocks where they are now, compiled from nothing."""
    scene = fdem.Scene(gap_tolerance=0)
    for block in sim.scene.blocks:
        shape = block.shape
        if not block.fixed:
            place = np.eye(4)
            place[:3, :3] = sim[block].rotation
            place[:3, 3] = sim[block].position - sim[block].rotation @ shape.centroid
            shape = shape.transform(place)
        scene.add(shape, fdem.Rigid(), STONE, name=block.name, fixed=block.fixed)
    scene.joint(fdem.Coulomb(kn=5e8, ks=5e8, friction=0))
    return fdem.Simulation(scene, fdem.Explicit(), progress=False, energy=False)


def forces_of_pairs(sim):
    """Pairs of blocks that push each other, and the forces."""
    table, result = sim.contact_table(), {}
    for a, b, force in zip(table["block_a"].tolist(), table["block_b"].tolist(), table["force"], strict=True):
        result[a, b] = result.get((a, b), 0.0) + force
    return {pair: force for pair, force in result.items() if np.any(force)}


@pytest.mark.parametrize(("shape", "time"), [((3, 3, 3), 0.3), pytest.param((6, 6, 8), 0.6, marks=pytest.mark.long)])
def test_contacts_that_come_and_go_are_those_of_a_fresh_compile(shape, time):
    """From no patch to hundreds: at every look the same pairs, and forces to 1e-3 of the largest (frozen patches)."""
    sim, most = heap(shape), 0
    assert sim.system.contacts.n_patches == 0
    for _ in range(6):
        sim.run(time=time / 6)
        running, afresh = forces_of_pairs(sim), forces_of_pairs(compiled_afresh(sim))
        most = max(most, sim.system.contacts.n_patches)
        largest = max((np.linalg.norm(f) for f in afresh.values()), default=0.0)
        for pair in running.keys() | afresh.keys():
            difference = running.get(pair, np.zeros(3)) - afresh.get(pair, np.zeros(3))
            assert np.linalg.norm(difference) <= 1e-3 * largest, (pair, sim.time)
    assert most > 1.5 * len(sim.scene.blocks)


def test_thousands_of_patches_appear_at_once():
    """A finely zoned block lands on another mesh: no patch before, thousands after, and their area is the face's."""
    scene = fdem.Scene(gravity=(0, 0, 0), gap_tolerance=0)
    base = box((19, 19, 1), (1, 1, 0), (0, 0, -0.3))
    low = scene.add(base, fdem.Zoned(), STONE, name="low")
    scene.fix(low, component=("x", "y", "z"))  # zones that are fixed as a whole would be one rigid surface
    high = scene.add(box((22, 22, 1), (1, 1, 0.35), (0, 0, 0.05)), fdem.Zoned(), STONE, name="high")
    scene.joint(fdem.Coulomb(kn=1e10, ks=1e10, friction=0))
    scene.apply(fdem.Velocity((0, 0, -1)), high)
    sim = fdem.Simulation(scene, fdem.Explicit(dt=1e-5), progress=False, energy=False)
    assert sim.system.contacts.n_patches == 0
    sim.cycle(5010)
    closure = -sim[high].displacement[2] - 0.05
    assert closure == pytest.approx(1e-4, rel=1e-9)
    assert sim.system.contacts.n_patches > 2 * (19 + 22) ** 2
    table = sim.contact_table()
    facing = np.abs(table["normal"][:, 2]) > 0.5
    # the rim, as wide as the closure when the patches were last cut, is nearer to the sides
    assert table["area"][facing].sum() == pytest.approx(1.0, abs=4.1e-4)
    assert sim.pair_force(low, high)[2] == pytest.approx(1e10 * closure, rel=4.1e-4)


def wall(courses, bricks, kn=1e10):
    """Dry running bond of so many courses on a fixed base, mu = 0.6."""
    scene = fdem.Scene()
    shapes = fdem.wall(0.2 * bricks, 0.1 * courses, 0.1, (0.2, 0.1, 0.1))
    stones = scene.add(shapes, fdem.Rigid(), STONE, name="brick")
    scene.add(fdem.brick((-1, -1, -1), (0.2 * bricks + 1, 1.1, 0)), fdem.Rigid(), fixed=True, name="base")
    scene.joint(fdem.Coulomb(kn=kn, ks=0.8 * kn, friction=np.degrees(np.arctan(0.6))))
    return scene, stones


def test_s12_wall_of_a_thousand_bricks(record_property):
    """25 x 40, mu = 0.6, gravity from zero: courses to 1e-4, pairs within 2 %, no brick moved > 2 sum of closures."""
    courses, bricks, kn = 25, 40, 1e10
    scene, stones = wall(courses, bricks, kn)
    assert len(stones) > 1000
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    report = sim.solve(ratio=1e-5)
    record_property("cycles", report.cycles)
    record_property("wall time", report.wall_time)
    assert report.reason == "equilibrium"
    weight = G * np.array([sim[stone].mass for stone in stones])
    height = np.array([stone.shape.centroid[2] for stone in stones])
    course = np.floor(height / 0.1).astype(int)
    table = sim.contact_table()
    lying = np.abs(table["normal"][:, 2]) > 0.5
    level = np.append(height, -1.0)  # the base was added last
    a, b = table["block_a"], table["block_b"]
    upper = np.where(level[a] > level[b], a, b)
    push = np.where(upper == b, 1, -1) * table["force"][:, 2] * lying
    carried = np.array([weight[course >= k].sum() for k in range(courses)])
    assert np.bincount(course[upper], push, courses) == pytest.approx(carried, rel=1e-4)
    pairs = np.bincount(a * len(level) + b, push, len(level) ** 2)
    ground = pairs.reshape(len(level), -1)[:, len(stones)] + pairs.reshape(len(level), -1)[len(stones)]
    assert np.abs(ground).max() == pytest.approx(courses * weight.max(), rel=0.02)
    between = np.delete(np.delete(pairs.reshape(len(level), -1), len(stones), 0), len(stones), 1)
    assert between.max() == pytest.approx((courses - 1) * weight.max() / 2, rel=0.02)
    assert sim.energy.kinetic <= 1e-8 * weight.sum() * 0.1 * courses
    closures = courses * (courses + 1) / 2 * weight.max() / (kn * 0.2 * 0.1)
    assert np.linalg.norm(sim[stones].displacement, axis=1).max() <= 2 * closures


@pytest.mark.parametrize("steps", [50_000, pytest.param(1_000_000, marks=pytest.mark.long)])
def test_a_wall_at_rest_stays_at_rest(steps):
    """No contact lost, none gained, no brick drifts: 1e6 undamped steps from equilibrium."""
    scene, stones = wall(4, 3)
    start = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert start.solve(ratio=1e-9).reason == "equilibrium"
    sim = fdem.Simulation(scene, fdem.Explicit(), start=start, progress=False, energy=False)
    contacts, begin = sim.system.contacts, sim[stones].position
    sim.forces()
    closed, cuts = contacts._active.copy(), contacts.n_cuts
    assert closed.sum() >= len(stones)
    for _ in range(10):
        sim.cycle(steps // 10)
        sim.forces()
        np.testing.assert_array_equal(contacts._active, closed)
        assert np.abs(sim[stones].position - begin).max() <= 1e-10  # of 0.1 m: what the start was out of balance
    assert contacts.n_cuts == cuts
