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
