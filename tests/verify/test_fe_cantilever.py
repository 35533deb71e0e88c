"""Cantilever with a parabolic end shear (Timoshenko and Goodier; Augarde and Deeks 2008), by Relaxation."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from verify.meshes import box, plane

import fdem

LENGTH, DEPTH, WIDTH, LOAD, YOUNG = 8.0, 1.0, 1.0, 1e5, 1e10
INERTIA = WIDTH * DEPTH**3 / 12
TIP = -0.02064
# 1e-3 of the load: the formula is linear, the tip would otherwise move by 2 % of the depth
SCALE = 1e-3


def exact(x):
    across = (
        LOAD
        * x[:, 1]
        / (6 * YOUNG * INERTIA)
        * ((6 * LENGTH - 3 * x[:, 0]) * x[:, 0] + 2 * (x[:, 1] ** 2 - DEPTH**2 / 4))
    )
    down = -LOAD / (6 * YOUNG * INERTIA) * (DEPTH**2 * x[:, 0] + (3 * LENGTH - x[:, 0]) * x[:, 0] ** 2)
    return SCALE * np.column_stack([across, down, 0 * down])


def end_shear(x):
    shear = -LOAD / (2 * INERTIA) * (DEPTH**2 / 4 - x[:, 1] ** 2)
    return SCALE * np.column_stack([0 * shear, shear, 0 * shear])


@functools.cache
def tip(cells, strain="small", ratio=1e-5):
    """Tip deflection over the exact one, and the strain energy over that of the exact solution."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    shape = box((4 * cells, cells, max(1, cells // 2)), (LENGTH, DEPTH / 2, WIDTH), (0, -DEPTH / 2, 0))
    beam = scene.add(shape, fdem.Zoned(strain=strain), fdem.Elastic(2500, YOUNG, 0.0))
    root = scene.apply(fdem.Displacement(exact), beam, where=plane(0, 0.0))
    scene.apply(fdem.Traction(end_shear), beam, where=plane(0, LENGTH))
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    report = sim.solve(ratio=ratio)
    assert report.converged
    moved = sim[beam].gridpoint_displacement
    places = sim[beam].gridpoints - moved
    end = (np.abs(places[:, 0] - LENGTH) < 1e-9) & (np.abs(places[:, 1]) < 1e-9)
    return (
        moved[end, 1].mean() / (SCALE * TIP),
        sim[root].force / (SCALE * LOAD),
        sim.energy.strain / (SCALE**2 * 1033.6),
    )


@pytest.mark.parametrize(("cells", "low"), [(2, 0.638), (4, 0.319), (8, 0.109)])
def test_tip_is_as_low_as_the_reference(cells, low):
    # half a point: the reference is given to three digits; the solve ratio 1e-5 leaves 0.1 % of the deflection
    assert 1.0 - tip(cells)[0] == pytest.approx(low, abs=0.005)


def test_order_of_convergence_grows_towards_two():
    low = [1.0 - tip(cells)[0] for cells in (2, 4, 8)]
    # constant strain is far from its asymptote here: the independent reference gives 1.0 and 1.55 (2 at 16)
    assert np.log2(low[0] / low[1]) == pytest.approx(1.0, abs=0.1)
    assert np.log2(low[1] / low[2]) == pytest.approx(1.55, abs=0.1)


def test_reaction_at_the_root_carries_the_load():
    # equal to the load up to the unbalanced force that the solve ratio allows on every gridpoint
    np.testing.assert_allclose(tip(4)[1], [0, 1, 0], atol=2e-3)


def test_strain_energy_approaches_from_below():
    energy = [tip(cells)[2] for cells in (2, 4, 8)]
    assert energy[0] < energy[1] < energy[2] < 1.0  # minimum of the potential energy: too stiff


def test_large_strain_gives_the_same():
    # the tip turns by 4e-6 only; the solve ratio of 1e-5 leaves 0.1 % of the deflection to either
    assert tip(4, "large")[0] == pytest.approx(tip(4)[0], rel=2e-3)
