"""Sleeping: blocks at rest are left out of the work, wake when something disturbs them, and no energy gets lost."""

from __future__ import annotations

import time

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scenes import assert_same_bits, everything, simulation

import fdem

STONE = fdem.Elastic(density=2500.0, young=1e8, poisson=0.2)
SOON = fdem.Sleep(motion=1e-6, steps=200)
BODIES = {
    "rigid": fdem.Rigid(),
    "uniform": fdem.UniformStrain(),
    "linear": fdem.LinearStrain(),
    "zoned": fdem.Zoned(size=1.0),
}


def ground(gravity=(0.0, 0.0, -9.81), friction=35.0, damping=0.3):
    """A fixed base below z = 0."""
    scene = fdem.Scene(gravity=gravity)
    scene.add(fdem.brick((-3, -4, -0.5), (27, 3, 0)), fdem.Rigid(), name="base", fixed=True)
    scene.joint(fdem.Coulomb(kn=1e8, ks=5e7, friction=friction, damping=damping))
    return scene


def pillar(body=None, n=3, **given):
    """Bricks on top of each other; what deforms is damped by its mass."""
    scene = ground(**given)
    for i in range(n):
        scene.add(
            fdem.brick((0, 0, 0.5 * i), (1, 1, 0.5 * i + 0.5)),
            body or fdem.Rigid(),
            STONE,
            name=f"b{i}",
            group="pillar",
        )
    return scene


def asleep(sim):
    """Names of the blocks that sleep."""
    return {name for name, sleeps in zip(sim.model.names, sim.system.contacts.asleep, strict=True) if sleeps}


def rest(sim, names="b0 b1 b2", steps=20000):
    """Cycle until these blocks, and no others, sleep."""
    for _ in range(steps // 100):
        sim.cycle(100)
        if asleep(sim) == set(names.split()):
            return sim
    raise AssertionError(f"asleep are {asleep(sim)}")


def wall_and_stone(sleep, corner=(0.45, -1.35, 0.5), velocity=(0.0, 4.0, 1.5), damping=None):
    """A wall of ten bricks and a small one that is thrown at it."""
    scene = ground(damping=1.0)
    for shape in fdem.wall(1.2, 0.6, 0.4, (0.4, 0.2)):
        scene.add(shape, fdem.Rigid(), STONE, group="wall")
    stone = fdem.brick(corner, np.add(corner, 0.15))
    scene.add(stone, fdem.Rigid(), STONE, name="stone", velocity=velocity)
    return simulation(scene, fdem.Explicit(dt=2e-4, damping=damping, sleep=sleep))


def both(sims, steps):
    for sim in sims:
        sim.cycle(steps)


def apart(first, second):
    """Largest distance of a gridpoint between two runs [m]."""
    return np.abs(first.displacements() - second.displacements()).max()


def test_a_thrown_stone_wakes_the_wall_it_hits():
    """A wall settles, sleeps and is hit; beside it the same run without sleep."""
    never, sim = sims = wall_and_stone(None), wall_and_stone(SOON)
    wall, size = set(sim.model.names) - {"base", "stone"}, np.cbrt(0.4 * 0.2 * 0.4)
    while not asleep(sim):
        both(sims, 100)
        assert sim.time < 0.3, "the wall does not fall asleep"
    assert asleep(sim) == wall
    # sleepers have stopped short of their rest by less than one may move in a window
    assert apart(sim, never) < SOON.motion * size
    while asleep(sim):
        if never["stone"].velocity[1] == 4.0:
            # what is awake and touches nothing does not notice: the same bits, in the same steps
            assert_array_equal(sim["stone"].velocity, never["stone"].velocity)
            assert_array_equal(sim["stone"].displacement, never["stone"].displacement)
        both(sims, 5)
        assert sim.time < 0.4, "nothing hit the wall"
    assert asleep(sim) == set()
    both(sims, 250)
    moved = np.abs(sim["wall"].displacement).max()
    assert moved > 100 * SOON.motion * size
    # measured 8e-7 m: what the wall had still to go when it fell asleep, and what the impact made of it
    assert apart(sim, never) < 10 * SOON.motion * size
    assert_allclose(sim.energy.error, never.energy.error, atol=1e-5 * sim.ledger.turned)


def test_a_sleeper_is_awake_in_the_step_in_which_it_is_hit():
    """A floating block rests exactly: hit, it moves as it does without sleep, to the last bit."""

    def floating(sleep):
        scene = fdem.Scene(gravity=(0, 0, 0))
        scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE, name="target")
        scene.add(fdem.brick((1.5, 0.3, 0.2), (1.9, 0.7, 0.9)), fdem.Rigid(), STONE, name="stone", velocity=(-3, 0, 0))
        scene.joint(fdem.Coulomb(kn=1e8, ks=5e7, friction=35.0, damping=0.1))
        return simulation(scene, fdem.Explicit(dt=2e-4, sleep=sleep))

    never, sim = sims = floating(None), floating(SOON)
    both(sims, 500)
    assert asleep(sim) == {"target"}
    both(sims, 1500)
    assert asleep(sim) == set()
    assert_array_equal(sim.state.v, never.state.v)
    assert_array_equal(sim.state.x, never.state.x)
    assert sim["target"].velocity[0] < -0.1
    first = np.array([-3.0, 0.0, 0.0]) * sim["stone"].mass
    assert_allclose(sum(sim[n].mass * sim[n].velocity for n in ("target", "stone")), first, atol=1e-11 * abs(first[0]))


def test_what_was_woken_comes_to_rest_where_it_does_without_sleep():
    """A stone falls flat on a sleeping wall and stays there."""
    given = {"corner": (0.5, 0.1, 1.4), "velocity": (0.0, 0.0, 0.0), "damping": fdem.Local(0.2)}
    never, sim = sims = [wall_and_stone(sleep, **given) for sleep in (None, SOON)]
    number, woken = [], False
    while not woken or len(asleep(sim)) < sim.model.n_blocks - 1:
        both(sims, 100)
        number.append(len(asleep(sim)))
        woken |= number[-1] == 0 and max(number) == 10
        assert sim.time < 2.0, "not everything falls asleep"
    # measured 0.14 of what counts as no motion, after a fall of five sizes
    assert apart(sim, never) < SOON.motion * 0.15
    assert_allclose(sim.energy.error, never.energy.error, atol=1e-5 * sim.ledger.turned)


@pytest.mark.parametrize("body", BODIES)
def test_sleepers_wake_when_their_support_is_excavated(body):
    scene = pillar(BODIES[body])
    sim = rest(simulation(scene, fdem.Explicit(damping=fdem.Local(0.8), sleep=SOON)))
    assert asleep(sim) == {"b0", "b1", "b2"}
    assert np.count_nonzero(sim.velocity) == 0
    z = sim["b2"].displacement[2]
    sim.excavate("b1")
    assert asleep(sim) == set()
    sim.cycle(20)
    assert sim["b2"].velocity[2] < 0.0
    rest(sim, "b0 b2")
    assert_allclose(sim["b2"].displacement[2], z - 0.5, atol=1e-3)
    assert sim.energy.closure < 1e-2


@pytest.mark.parametrize("body", BODIES)
def test_sleepers_wake_when_a_load_comes_or_changes(body):
    scene = pillar(BODIES[body])
    jump = scene.apply(fdem.Force((0.0, 0.0, -100.0)), "b2", factor=lambda t: 1.0 if t < 1.0 else 50.0)
    sim = rest(simulation(scene, fdem.Explicit(damping=fdem.Local(0.8), sleep=SOON)))
    sim.run(0.9 - sim.time)
    assert len(asleep(sim)) == 3
    down = sim.contact_forces()[0, 2]
    weight = 3 * 0.5 * 2500 * 9.81
    assert_allclose(down, -weight - 100.0, rtol=1e-4)
    sim.run(0.2)
    assert asleep(sim) == set() or sim.contact_forces()[0, 2] < -weight - 4000.0
    rest(sim)
    assert_allclose(sim.contact_forces()[0, 2], -weight - 5000.0, rtol=SOON.share)
    assert_allclose(sim[jump].force[2], -5000.0, rtol=1e-12)
    sim.apply(fdem.Force((3000.0, 0.0, 0.0)), "b0")
    assert asleep(sim) == set()
    rest(sim)
    assert_allclose(sim.contact_forces()[0, 0], 3000.0, atol=SOON.share * weight)


def test_a_step_of_a_wall_asleep_is_cheap():
    """300 bricks of which all sleep but three others that fly: 1.5 times faster at least."""
    scene = ground(damping=1.0)
    for shape in fdem.wall(24.0, 1.0, 0.3, (0.4, 0.2)):
        scene.add(shape, fdem.Rigid(), STONE, group="wall")
    for i in range(3):
        corner = np.array([i, -2.0, 1.0])
        scene.add(fdem.brick(corner, corner + 0.1), fdem.Rigid(), STONE, group="others", velocity=(0, 0, 2.0))
    sim = simulation(scene, fdem.Explicit(damping=fdem.Local(0.5), sleep=fdem.Sleep(steps=100)), energy=False)
    never = simulation(scene, fdem.Explicit(damping=fdem.Local(0.5)), energy=False)
    never.cycle(100)
    while not asleep(sim) and sim.steps < 3000:
        sim.cycle(50)
    assert len(asleep(sim)) == sim.model.n_blocks - 4 > 280
    spent = np.zeros((2, 5))
    for k in range(5):
        for i, each in enumerate((never, sim)):
            begin = time.process_time()
            each.cycle(100)
            spent[i, k] = time.process_time() - begin
    assert len(asleep(sim)) > 280
    ratio = float(np.divide(*np.median(spent, axis=1)))
    print(f"a step without sleep costs {ratio:.1f} times one with: {1e4 * np.median(spent, axis=1)} us")
    assert ratio > 1.5


def test_what_moves_at_constant_speed_or_is_at_the_top_of_its_flight_does_not_sleep():
    scene = ground(friction=0.0)
    dt = 1e-4
    speed = 3.0 * SOON.motion * 0.5 / (SOON.steps * dt)
    scene.add(fdem.brick((0, 0, 0), (0.5, 0.5, 0.5)), fdem.Rigid(), STONE, name="slow", velocity=(speed, 0, 0))
    scene.add(fdem.brick((2, 0, 0), (2.5, 0.5, 0.5)), fdem.Rigid(), STONE, name="still")
    scene.add(fdem.brick((0, -3, 0), (0.5, -2.5, 0.5)), fdem.Rigid(), STONE, name="driven")
    scene.apply(fdem.Velocity((0, 0, 0)), "driven")
    sim = rest(simulation(scene, fdem.Explicit(dt=dt, sleep=SOON)), "still")
    for _ in range(10):
        sim.cycle(500)
        assert asleep(sim) == {"still"}
    assert_allclose(sim["slow"].velocity[0], speed, rtol=1e-9)

    scene = ground()
    scene.add(fdem.brick((0, 0, 1), (1, 1, 2)), fdem.Rigid(), STONE, name="flying", velocity=(0, 0, 0.5 * 9.81 * 0.02))
    few = fdem.Sleep(motion=1e-4, steps=20)
    sim = simulation(scene, fdem.Explicit(dt=dt, sleep=few))
    # around the top it moves less than what counts as rest, over more than a window
    assert 9.81 * (0.5 * 1.5 * few.steps * dt) ** 2 / 2.0 < few.motion
    for _ in range(30):
        sim.cycle(10)
        assert asleep(sim) == set()
    assert_allclose(sim["flying"].velocity[2], 9.81 * (0.01 - 0.03), rtol=1e-9)


def test_going_on_from_a_file_saved_in_sleep(tmp_path):
    """The same bits; and whoever does not sleep can read the file."""

    def scene():
        made = pillar()
        made.apply(fdem.Force((0.0, 0.0, -1000.0)), "b2", factor=lambda t: float(t > 2.0))
        return made

    given = {"damping": fdem.Local(0.8), "sleep": SOON}
    sim = rest(simulation(scene(), fdem.Explicit(**given)))
    sim.save(tmp_path / "asleep.npz")
    again = fdem.load(tmp_path / "asleep.npz", scene(), fdem.Explicit(**given), progress=False)
    assert asleep(again) == asleep(sim)
    assert_same_bits(everything(again), everything(sim))
    for end, sleeping in ((1.9, 3), (2.02, 0), (4.0, 3)):  # the load wakes it at 2 s
        for each in (sim, again):
            each.run(end - each.time)
        assert len(asleep(sim)) == sleeping
        assert_same_bits(everything(again), everything(sim))
    awake = fdem.load(tmp_path / "asleep.npz", scene(), fdem.Explicit(damping=fdem.Local(0.8)), progress=False)
    assert "sleeping: left out" in awake.describe()
    taken = simulation(scene(), fdem.Explicit(**given), start=again)
    assert asleep(taken) == set()
    for each, end in ((awake, 3.0), (taken, 5.0)):
        each.run(end - each.time)
        assert_allclose(each.contact_forces()[0, 2], -3 * 0.5 * 2500 * 9.81 - 1000.0, rtol=SOON.share)


@pytest.mark.parametrize("body", BODIES)
def test_nothing_read_changes_when_blocks_fall_asleep(body):
    """Contacts, forces, energy and the step: those of the same run without sleep, at the same time."""
    never, sim = sims = [
        simulation(pillar(BODIES[body]), fdem.Explicit(damping=fdem.Local(0.8), sleep=sleep)) for sleep in (None, SOON)
    ]
    while not asleep(sim):
        both(sims, 100)
    both(sims, 300)
    weight = 3 * 0.5 * 2500 * 9.81
    assert "sleeping: 3 of 4 blocks sleep now" in sim.describe()
    assert sim.dt == never.dt
    first, second = never.contact_table(), sim.contact_table()
    for name, rows in first.items():
        if name in ("block_a", "block_b", "state", "failure", "patch", "joint"):
            assert_array_equal(second[name], rows, err_msg=name)
    # what was not yet balanced when they fell asleep: less than share of the forces acting
    assert_allclose(second["force"], first["force"], atol=SOON.share * weight)
    assert_allclose(sim.pair_force("b0", "b1"), never.pair_force("b0", "b1"), atol=SOON.share * weight)
    assert_allclose(sim.contact_forces(), never.contact_forces(), atol=SOON.share * weight)
    assert sim.ratio < SOON.share
    for name in ("strain", "joint", "potential", "work"):
        assert_allclose(getattr(sim.energy, name), getattr(never.energy, name), rtol=1e-3, err_msg=name)
    assert sim.energy.kinetic == 0.0
    assert sim.energy.closure < never.energy.closure + 1e-6


def test_a_driven_platen_wakes_what_lies_on_it():
    scene = ground()
    scene.add(fdem.brick((0, 0, 0.1), (1, 1, 0.6)), fdem.Rigid(), name="platen", fixed=True)
    for axis in range(3):
        scene.add(fdem.brick((0, 0, 0.6 + 0.5 * axis), (1, 1, 1.1 + 0.5 * axis)), fdem.Rigid(), STONE, name=f"b{axis}")
    scene.apply(fdem.Velocity((0, 0, 1.0)), "platen", factor=lambda t: float(0.6 < t < 0.7))
    sim = rest(simulation(scene, fdem.Explicit(dt=1e-4, damping=fdem.Local(0.5), sleep=SOON)))
    sim.run(0.59 - sim.time)
    assert len(asleep(sim)) == 3
    before = sim["b2"].displacement[2]
    sim.run(0.06)
    assert asleep(sim) == set()
    rest(sim)
    # the platen's way is a sum of whole steps
    assert_allclose(sim["b2"].displacement[2] - before, sim["platen"].displacement[2], atol=1e-6)
    assert_allclose(sim["platen"].displacement[2], 0.1, atol=2e-4)


def test_options_and_scenes_that_cannot_sleep():
    for wrong in ({"motion": 0.0}, {"share": 2.0}, {"steps": 0}, {"steps": 1.5}, {"motion": "little"}):
        with pytest.raises(fdem.SceneError, match=f"Sleep: {next(iter(wrong))}"):
            fdem.Sleep(**wrong)
    with pytest.raises(fdem.SceneError, match="sleep = True"):
        fdem.Explicit(sleep=True)
    with pytest.raises(TypeError):
        fdem.Relaxation(sleep=SOON)
    scene = ground()
    scene.add(fdem.sphere(0.5, (0, 0, 0.5)), fdem.Rigid(), STONE)
    with pytest.raises(fdem.UnsupportedError, match="spheres"):
        simulation(scene, fdem.Explicit(sleep=SOON))
    lonely = fdem.Scene()
    lonely.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE)
    sim = simulation(lonely, fdem.Explicit(dt=1e-3, sleep=SOON))
    sim.cycle(3)
    assert "sleeping: left out" in sim.describe()
