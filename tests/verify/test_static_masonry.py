"""Vaults of rigid and zoned voussoirs by Static: reaction, balance, every point in its friction cone."""

from __future__ import annotations

import numpy as np
import pytest
from verify import test_masonry as masonry
from verify.test_masonry import published  # noqa: F401

import fdem
from fdem.kernels.patches import FLAT

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia

G = 9.81


def at_rest(scene, free, support, mu, tolerance):
    sim = fdem.Simulation(scene, fdem.Static(tolerance=tolerance), energy=False)
    report = sim.solve(ratio=tolerance)
    assert report.converged, report.notes
    table = sim.contact_table()
    faces = (sim.system.contacts.patches.flags[table["patch"]] & FLAT) > 0
    normal, shear = table["traction"][:, 0], np.linalg.norm(table["traction"][:, 1:], axis=1)
    assert normal[faces].min() >= 0.0
    # tractions are given across the master face, against which the slave's is tilted by closure over size, 1e-4
    assert (shear - mu * normal)[faces].max() <= 2e-4 * normal.max()
    weight = G * sim[free].mass.sum()
    assert sim[support].force == pytest.approx([0, 0, weight], abs=1e-9 * weight)
    return report


BODIES = [fdem.Rigid(), pytest.param(fdem.Zoned(), marks=pytest.mark.long)]


@masonry.needs_data
@pytest.mark.parametrize("body", BODIES, ids=["rigid", "zoned"])
def test_barrel_vault(published, body):  # noqa: F811
    """121 voussoirs: residual and reaction to 1e-9 (CONTACT.md 6); zoned: to the round-off of positions, 2e-9."""
    scene, free, support = masonry.barrel_vault(published, body)
    mu = published[1]["friction_coefficient"]
    rigid = isinstance(body, fdem.Rigid)
    report = at_rest(scene, free, support, mu, 1e-9 if rigid else 5e-9)
    assert report.ratio <= (1e-9 if rigid else 5e-9)


@pytest.mark.parametrize("body", [fdem.Rigid(), fdem.UniformStrain(), fdem.Zoned()], ids=["rigid", "uniform", "zoned"])
def test_own_vault(body):
    """The vault of `meshes`: reaction to 1e-9."""
    shapes = fdem.read(masonry.ROOT / "meshes" / "vault.obj")
    low = np.array([shape.bounds[0][2] for shape in shapes])
    scene = fdem.Scene()
    blocks = scene.add(shapes, body, fdem.Elastic(2400.0, 3e10, 0.2), name="stone")
    held = low < low.min() + 0.02
    support = scene.fix([block for block, h in zip(blocks, held, strict=True) if h])
    scene.joint(fdem.Coulomb(kn=1e10, ks=5e9, friction=35))
    free = [block for block, h in zip(blocks, held, strict=True) if not h]
    at_rest(scene, free, support, np.tan(np.radians(35)), 5e-9)


@pytest.mark.parametrize("n", [20, pytest.param(40, marks=pytest.mark.long)])
def test_thinnest_arch(n):
    """Stands at 1.2 times the least thickness, falls at 0.97; the thrust at t/R = 0.15 is between its bounds."""
    for factor, stands in ((1.2, True), (0.97, False)):
        scene, _ = masonry.arch(factor * masonry.THINNEST[n], n, fdem.Rigid())
        report = fdem.Simulation(scene, fdem.Static(), energy=False).solve()
        assert report.reason == ("equilibrium" if stands else "collapse")
    scene, voussoirs = masonry.arch(0.15, n, fdem.Rigid())
    sim = fdem.Simulation(scene, fdem.Static(), energy=False)
    assert sim.solve().converged
    thrust = sim.pair_force(*voussoirs[n // 2 - 1 : n // 2 + 1])
    least, largest = masonry.THRUST[n]
    assert least < thrust[0] < largest
