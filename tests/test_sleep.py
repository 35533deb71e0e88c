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
    scene.add(fdem.brick((-3, -4, -0.5), (5, 3, 0)), fdem.Rigid(), name="base", fixed=True)
    scene.joint(fdem.Coulomb(kn=1e8, ks=5e7, friction=friction, damping=damping))
    return scene


def pillar(body=None, n=3, **given):
    """Bricks on top of each other; what deforms is damped by its mass."""
    scene = ground(**given)
    for i in range(n):
        scene.add(
            fdem.brick((0, 0, 0.5 * i), (1, 1, 0.5 * i + 0.5)), body or fdem.Rigid(), STONE, name=f"b{i}", group="pillar"
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


def wall_and_stone(sleep):
    scene = ground(damping=1.0)
    for shape in fdem.wall(1.2, 0.6, 0.4, (0.4, 0.2)):
        scene.add(shape, fdem.Rigid(), STONE, group="wall")
    stone = fdem.brick((0.45, -1.35, 0.5), (0.6, -1.2, 0.65))
    scene.add(stone, fdem.Rigid(), STONE, name="stone", velocity=(0.0, 4.0, 1.5))
    return simulation(scene, fdem.Explicit(dt=2e-4, sleep=sleep))


def both(sims, steps):
    for sim in sims:
        sim.cycle(steps)


def test_a_thrown_stone_wakes_the_wall_it_hits():
    """A wall settles and sleeps, is hit, moves and sleeps again; beside it the same run without sleep."""
    never, sim = sims = wall_and_stone(None), wall_and_stone(SOON)
    wall, size = set(sim.model.names) - {"base", "stone"}, 0.3175
    while not asleep(sim):
        both(sims, 100)
        assert sim.time < 0.3, "the wall does not fall asleep"
    assert asleep(sim) == wall
    # what is awake does not notice: the same bits
    assert_array_equal(sim["stone"].velocity, never["stone"].velocity)
    assert_array_equal(sim["stone"].displacement, never["stone"].displacement)
    # sleepers have stopped short of their rest by less than one may move in a window
    assert np.abs(sim.displacements() - never.displacements()).max() < SOON.motion * size
    while asleep(sim):
        both(sims, 1)
        assert sim.time < 0.4, "nothing hit the wall"
    assert asleep(sim) == set()
    both(sims, 250)
    assert np.abs(sim["wall"].velocity).max() > 1e-3
    # the hit begins within a step of where it does without sleep: no more than rest itself has left uncertain
    assert np.abs(sim.displacements() - never.displacements()).max() < 10 * SOON.motion * size
    print(np.abs(sim.displacements() - never.displacements()).max())
    while asleep(sim) != wall | {"stone"}:
        both(sims, 100)
        assert sim.time < 3.0, "the wall does not fall asleep again"
    print(sim.time, np.abs(sim.displacements() - never.displacements()).max(), sim.energy.closure, never.energy.closure)
    assert np.abs(sim.displacements() - never.displacements()).max() < 1e-3 * size


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
    assert_allclose(sim.contact_forces()[0, 2], -weight - 5000.0, rtol=1e-4)
    assert_allclose(sim[jump].force[2], -5000.0, rtol=1e-12)
    sim.apply(fdem.Force((3000.0, 0.0, 0.0)), "b0")
    assert asleep(sim) == set()
    rest(sim)
    assert_allclose(sim.contact_forces()[0, 0], 3000.0, rtol=1e-3)
