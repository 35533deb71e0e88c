"""Stress scenarios of the contact layer through the public API: seams, near-degenerate edges, redundant contacts.

S-numbers are those of the list of numerical stress scenarios; the number beside each assertion is the one listed.
"""

from __future__ import annotations

import numpy as np
import pytest
from stress.penetration import EDGE_KN, LENGTH, crossing, over_a_seam

import fdem

G = 9.81
STONE = fdem.Elastic(density=2000.0)
QUIET = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # a prescribed motion has no stable step


@QUIET
@pytest.mark.parametrize("gap", [1e-3, 5e-3, 0.02])
def test_a_wide_face_lands_on_a_narrow_one(gap):
    """A plate with more faces, so the slave, comes down on a cube from `gap`: the area is the cube's, not wider.

    A patch made while blocks are apart reaches beyond the edges of the master, where its faces are nearest; what
    remains after the landing is the rim, twice the motion of a step on every edge (4e-5 of the force here).
    """
    angle = np.arange(6) * np.pi / 3
    scene = fdem.Scene(gravity=(0, 0, 0), gap_tolerance=0)
    scene.add(fdem.brick((-0.5, -0.5, -1 - gap), (0.5, 0.5, -gap)), fdem.Rigid(), fixed=True, name="cube")
    plate = fdem.prism(2 * np.column_stack([np.cos(angle), np.sin(angle)]), 1.0, axis="z")
    plate = scene.add(plate, fdem.Rigid(), STONE, name="plate")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=0))
    scene.apply(fdem.Velocity((0, 0, -1e-2), angular=(0, 0, 0)), plate)
    sim = fdem.Simulation(scene, fdem.Explicit(dt=1e-3), progress=False)
    sim.cycle(round(gap / 1e-5) + 20)
    closure = -sim[plate].displacement[2] - gap
    assert 1e-4 < closure < 3e-4
    assert sim.pair_force("cube", plate)[2] == pytest.approx(1e9 * closure, rel=1e-4)


@pytest.mark.parametrize(("speed", "travel"), [(1.0, 0.2), (1e-2, 2e-3)])
def test_s17_seam_with_the_default_cuts(speed, travel):
    """Patches kept for 1e-3 of the block's size: the force is off by that, for a step or two by the motion of them.

    The box does not catch: the kick is that force on the contact's spring, dF / sqrt(kn A m) = 1e-5 m/s at 1 cm/s or
    less, and what the seam takes from the speed is below 1e-5.
    """
    velocity, force = over_a_seam(0.0, 0.0, speed, travel, every_step=False)
    assert np.abs(velocity[:, 1:]).max() <= 1e-5
    assert np.abs(velocity[:, 0] / speed - 1).max() <= 1e-5
    assert np.abs(force - [0, 0, 1000 * G]).max() <= 5e-3 * 1000 * G


def edge_force(depth, angle):
    """``kn / sqrt 2`` times the integral of the vertical overlap of the two ridges: depth below the nearest face.

    Across the upper edge (w), where it lies q off the lower one, the overlap is ``depth - |w| - |w cos(angle) + q|``.
    """
    n, c, s = 20_000, np.cos(angle), np.sin(angle)
    end = min(0.5 * LENGTH, depth / s if s > 0 else np.inf)
    q = s * (np.arange(n) + 0.5) / n * end
    top, side = depth - q, depth - q / c
    whole = 0.5 * q / c * (top + side) + (top**2 + side**2) / (2 * (1 + c))
    part = 0.5 * top**2 * (1 / (1 + c) + (1 / (1 - c) if c < 1 else 0.0))
    return EDGE_KN / np.sqrt(2) * 2 * end * np.where(side > 0, whole, part).mean()


@QUIET
@pytest.mark.parametrize("angle", [1e-1, 1e-3, 1e-6, 1e-9, 0.0])
def test_s16_crossing_edges(angle):
    """Edges that cross at 0.1 to 1e-9 rad, and parallel ones: no contact missed, force exact, normal vertical.

    No switch between edge-edge and edge-face: the force follows the closed form to the 2e-4 that pruning admits, from
    a depth of 1e-4 of the block's size on: so late may a pair be looked at again whose edges have met.
    """
    sim = crossing(angle, 0.0)
    sim.cycle(99)
    assert not sim["upper"].contact_force.any()
    sim.cycle(1)
    for steps in (25, 75, 400, 500):
        sim.cycle(steps)
        depth = -sim["upper"].displacement[2] - 1e-4
        force = sim["upper"].contact_force
        assert force[2] == pytest.approx(edge_force(depth, angle), rel=2e-4)
        assert np.abs(force[:2]).max() <= 1e-9 * force[2]  # the listed jump of the normal is 1e-3 rad


@QUIET
@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 1e-3, 1e-1])
def test_s16_forces_of_crossing_edges_are_continuous(angle):
    """1e-6 rad more change the resultant by <= 1 % and its direction by <= 1e-3 rad, with friction too."""
    forces = []
    for turn in (angle, angle + 1e-6):
        sim = crossing(turn, 30.0)
        sim.cycle(1100)
        forces.append(sim["upper"].contact_force)
    sizes = np.linalg.norm(forces, axis=1)
    assert np.ptp(sizes) <= 0.01 * sizes[0]
    assert np.linalg.norm(forces[1] / sizes[1] - forces[0] / sizes[0]) <= 1e-3
