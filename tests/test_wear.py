"""Which pairs are cut anew: those that must be, and with them those that soon would."""

from __future__ import annotations

import pytest
from scenes import STONE, simulation

import fdem
from fdem.contact.wear import worn_pairs


@pytest.mark.parametrize(("used", "expected"), [((0.6, 0.6), 0), ((1.1, 0.4), 1), ((1.1, 0.6), 2)])
def test_pairs_past_half_of_their_allowance_are_cut_along(used, expected):
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((-1, -1, -1), (5, 2, 0)), fdem.Rigid(), name="base", fixed=True)
    for k in range(2):
        scene.add(fdem.brick((2 * k, 0, 0), (2 * k + 1, 1, 1)), fdem.Rigid(), STONE, name=f"brick {k}")
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
