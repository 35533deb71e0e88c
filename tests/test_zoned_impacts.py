"""Impacts of zoned blocks without friction: kinetic, strain and joint energy together (CONTACT.md 6)."""

from __future__ import annotations

import numpy as np
import pytest
from contact_tools import rotation
from verify.meshes import box

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia

CORNER = np.array([[1, -1, 0], [1, 1, -2], [1, 1, 1]]) / np.sqrt([[2], [6], [3]]) @ rotation([1, 2, 3], 0.2)
TURNS = {
    "corner": CORNER,
    "edge": rotation([0, 1, 0], np.pi / 4) @ rotation([1, 0.3, 0], 0.1),
    "face": rotation([1, 0.5, 0], 0.03),
}


def momenta(sim):
    """Linear and angular momentum of everything."""
    model, v, total = sim.model, sim.velocities(), np.zeros((2, 3))
    for row in range(model.n_blocks):
        if model.zoned[row]:
            own = slice(*model.gp_range[row])
            p, place, spin = model.gp_mass[own, None] * v[own], sim.state.x[own], np.zeros(3)
        else:
            p = model.mass[row] * sim.block_motions(sim.velocity)[0][row][None]
            place, spin = sim.centroids()[row], sim.angular_momenta()[row]
        total += [p.sum(axis=0), np.cross(place, p).sum(axis=0) + spin]
    return total


def impact(part, body, safety=0.8, cut_always=True, young=1e10):
    """A spinning zoned cube meets a block head on at 2 m/s; relative change of the energy until they have parted."""
    rock = fdem.Elastic(density=2500, young=young, poisson=0.2)
    where = np.eye(4)
    where[:3, :3] = TURNS[part]
    corners = np.stack(np.meshgrid(*3 * [[-0.5, 0.5]]), -1).reshape(-1, 3) @ TURNS[part].T
    where[:3, 3] = 0.1, 0.07, 1.002 - corners[:, 2].min()
    scene = fdem.Scene(gravity=(0, 0, 0))
    cube = box((2, 2, 2), (0.5, 0.5, 0.5), (-0.5, -0.5, -0.5)).transform(where)
    scene.add(cube, fdem.Zoned(), rock, velocity=(0, 0, -1), angular_velocity=(0.3, 0.2, 0.1))
    lower = (1, 1, 1), (-0.8, -0.8, 0)
    if body == "rigid":
        scene.add(fdem.brick(*lower[::-1]), fdem.Rigid(), rock, velocity=(0, 0, 1))
    else:
        scene.add(box((2, 2, 2), *lower), fdem.Zoned(), rock, velocity=(0, 0, 1))
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=0))
    sim = fdem.Simulation(scene, fdem.Explicit(safety=safety))
    contacts = sim.system.contacts
    if cut_always:
        contacts.clip_always, contacts.prune = True, 0.0
    before, start, met = sim.energy.kinetic, momenta(sim), False
    for _ in range(500):
        sim.cycle(20)
        closed = contacts.n_patches > 0 and bool(contacts._active.any())
        met |= closed
        if met and not closed:
            break
    assert met and not closed and sim.energy.joint == 0.0
    # m v and m v L are 2500 in SI
    np.testing.assert_allclose(momenta(sim), start, rtol=0, atol=1e-11 * 2500)
    return abs(sim.energy.error) / before


@pytest.mark.parametrize("part", [*(pytest.param(p, marks=pytest.mark.long) for p in ("corner", "edge")), "face"])
def test_zoned_on_rigid(part):
    """1e-5 of the energy, falling with the square of the step."""
    coarse, fine = impact(part, "rigid"), impact(part, "rigid", safety=0.4)
    assert coarse < 1e-5
    assert fine < coarse / 3.5  # 1/4, less what the phase of the first touch changes


@pytest.mark.parametrize("part", [pytest.param("corner", marks=pytest.mark.long), "edge", "face"])
def test_zoned_on_zoned(part):
    """1e-5. The depth below a face that deforms is no potential: a loss stays that goes with the strain, 1 / E."""
    loss = impact(part, "zoned")
    assert loss < 1e-5
    if part == "face":
        assert impact(part, "zoned", safety=0.4) < loss / 1.5
    if part == "corner":
        assert impact(part, "zoned", young=1e11) < loss / 5


@pytest.mark.parametrize("body", ["rigid", "zoned"])
@pytest.mark.parametrize("part", TURNS)
def test_zoned_with_the_defaults(part, body):
    """Small patches dropped, cuts when due: 2e-4 as for rigid blocks."""
    assert impact(part, body, cut_always=False) < 2e-4
