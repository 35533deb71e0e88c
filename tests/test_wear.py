"""Which pairs are cut anew: those that must be, and with them those that soon would."""

from __future__ import annotations

import pytest
from scenes import STONE, simulation

import fdem
from fdem.contact.wear import worn_pairs


@pytest.mark.parametrize(("used", "expected"), [((0.6, 0.6), 0), ((1.1, 0.4), 1), ((1.1, 0.6), 2)])
def test_pairs_past_half_of_their_allowance_are_cut_along(used, expected):
    scene = fdem.Scene(gravity=(0, 0, 0))
    for k in range(2):
        low = 4 * k
        scene.add(fdem.brick((low - 1, -1, -1), (low + 2, 2, 0)), fdem.Rigid(), name=f"base {k}", fixed=True)
        scene.add(fdem.brick((low, 0, 0), (low + 1, 1, 1)), fdem.Rigid(), STONE, name=f"brick {k}")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    sim = simulation(scene)
    contacts = sim.system.contacts
    assert len(contacts.pairs) == 2
    x = sim.state.x.copy()
    assert not worn_pairs(contacts, x).any()
    for k, part in enumerate(used):
        reach = contacts.patches.reach[contacts.patches.pair == k].min()
        x[slice(*sim.model.gp_range[sim.model.names.index(f"brick {k}")]), 0] += part * reach
    assert worn_pairs(contacts, x).sum() == expected


@pytest.mark.parametrize(("used", "expected"), [(0.04, 1), (0.06, 2)])
def test_parts_of_a_sliding_face_are_cut_together(used, expected):
    """A brick over a seam: if one part is cut anew, so is the other, that they add up to the face.

    Both parts move alike; that the second has moved less since its cut is made up here, by a longer allowance.
    """
    scene = fdem.Scene(gravity=(0, 0, 0))
    for k in range(2):
        scene.add(fdem.brick((3 * k - 3, -1, -1), (3 * k, 2, 0)), fdem.Rigid(), name=f"base {k}", fixed=True)
    scene.add(fdem.brick((-0.5, 0, 0), (0.5, 1, 1)), fdem.Rigid(), STONE, name="brick")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    sim = simulation(scene)
    contacts = sim.system.contacts
    assert len(contacts.pairs) == 2
    p, x = contacts.patches, sim.state.x.copy()
    x[slice(*sim.model.gp_range[sim.model.names.index("brick")]), 0] += 1.1 * p.reach[p.pair == 0].min()
    p.reach[p.pair == 1] *= 1.1 / used
    assert worn_pairs(contacts, x).sum() == expected


def test_corners_in_the_plane_of_a_face_do_not_close_in_every_step():
    """Blocks cut through: corners lie in planes of other blocks but for round-off, of either sign in every cut."""
    shapes = [fdem.brick((0, 0, 0), (20, 20, 20))]
    for k, (dip, direction) in enumerate([(75, 40), (65, 150), (15, 280)]):
        joints = fdem.JointSet(dip, direction, spacing=6.0, origin=(10.5, 9.2, 9.8), seed=k, deviation=2)
        shapes = fdem.cut(shapes, joints)
    scene = fdem.Scene()
    scene.add(shapes, fdem.Zoned(size=3.0), fdem.Elastic(2600.0, 2e10, 0.25))
    scene.joint(fdem.Coulomb(kn=2e10, ks=1e10, friction=35))
    for axis, name in enumerate("xyz"):
        far = 1e9 if name == "z" else 20 - 1e-6
        scene.fix(component=name, where=lambda x, k=axis, far=far: (x[:, k] < 1e-6) | (x[:, k] > far))
    sim = simulation(scene, fdem.Relaxation(), energy=False)
    sim.cycle(100)  # corners settle into those planes
    moving = simulation(scene, fdem.Explicit(dt=1e-10), start=sim, energy=False)
    contacts = moving.system.contacts
    moving.cycle(1)
    before = contacts.n_cuts
    moving.cycle(20)
    assert contacts.n_cuts == before
