"""Stress scenarios of many blocks: broad phase, contacts that come and go, walls at rest.

S-numbers are those of the list of numerical stress scenarios; the number beside each assertion is the one listed.
"""

from __future__ import annotations

import numpy as np
import pytest
from stress.rest import wall
from verify.meshes import box

import fdem

STONE = fdem.Elastic(density=2000.0, young=1e10, poisson=0.2)


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
