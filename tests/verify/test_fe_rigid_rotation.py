"""Rigid rotation of a zoned cube: no stress at any angle; free spin keeps momentum and energy."""

from __future__ import annotations

import numpy as np
import pytest
from verify.meshes import box

import fdem

YOUNG, POISSON, DENSITY, SPIN = 1e9, 0.25, 2000.0, 10.0
AXIS = np.array([1.0, 2.0, 2.0]) / 3.0
pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")


def rotation(degrees):
    angle, (x, y, z) = np.radians(degrees), AXIS
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def turned(degrees, strain, start):
    scene = fdem.Scene(gravity=(0, 0, 0))
    shape = box((2, 2, 2), (1, 1, 1), jitter=0.2)
    block = scene.add(shape, fdem.Zoned(strain=strain), fdem.Elastic(DENSITY, YOUNG, POISSON), name="cube")
    scene.apply(fdem.Displacement(lambda x: x @ rotation(degrees).T + [5, -3, 1] - x), block)
    sim = fdem.Simulation(scene, fdem.Relaxation(), start=start, progress=False)
    sim.cycle(2500)
    return sim, block


@pytest.mark.parametrize("strain", ["large", "small"])
def test_imposed_rotation_makes_no_stress(strain):
    sim = None
    for degrees in (30, 90, 180, 270, 360, 450, 540, 630, 720):
        # points go straight to their new place: steps below 180 degrees keep the zones the right way round
        sim, block = turned(degrees, strain, sim)
        if degrees in (30, 90, 180, 720):
            view = sim[block]
            np.testing.assert_allclose(view.rotation, rotation(degrees), atol=1e-12)
            # the oracle's 1e-12 E: round-off of positions is eps * 5 m / 0.2 m
            assert np.abs(view.zone_stress).max() <= 1e-12 * YOUNG * 5
            corners = view.gridpoints[view.zones]
            volume = np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6
            assert volume == pytest.approx(1.0, abs=1e-12)


def centrifugal(strain):
    """A cube spinning at its quasi-static stretch for about three turns, by Explicit at its own step."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    shape = box((2, 2, 2), (1, 1, 1), jitter=0.2)
    block = scene.add(
        shape, fdem.Zoned(strain=strain), fdem.Elastic(DENSITY, YOUNG, POISSON), angular_velocity=SPIN * AXIS
    )
    return fdem.Simulation(scene, fdem.Explicit(), progress=False), block


@pytest.mark.parametrize("strain", ["large", "small"])
def test_free_spin_for_two_seconds(strain):
    sim, block = centrifugal(strain)
    momentum = sim[block].angular_momentum
    start = sim.energy.kinetic + sim.energy.strain
    mass, arm = sim[block].gridpoint_mass, sim[block].gridpoints
    arm = arm - mass @ arm / mass.sum()

    def volume(sim):
        corners = sim[block].gridpoints[sim[block].zones]
        return np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6

    sim.run(time=2.0 - 2 * np.pi / SPIN)
    ratio = sim.history(volume, every=1)
    sim.run(time=2 * np.pi / SPIN)
    # momentum: the oracle's 1e-10, about the centre of the lumped masses, which is where it is kept
    change = sim[block].angular_momentum - momentum
    assert np.linalg.norm(change) <= 1e-10 * np.linalg.norm(momentum)
    energy = sim.energy
    assert abs(energy.kinetic + energy.strain - start) <= 1e-4 * start  # the oracle's
    # mean over the last turn against the virial theorem: int tr(sigma) dV = -sum m |w x r|^2, so that
    # the volume grows by sum m |w x r|^2 / (3 K) in the mean (oracle: 1e-6)
    bulk = YOUNG / (3 * (1 - 2 * POISSON))
    speed = np.cross(SPIN * AXIS, arm)
    grown = (mass @ (speed**2).sum(axis=1)) / (3 * bulk)
    assert np.mean(ratio.values) - 1.0 == pytest.approx(grown, abs=1e-6)
    assert sim[block].rotation @ AXIS == pytest.approx(AXIS, abs=0.05)
