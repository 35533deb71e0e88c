"""Homogeneous states of a box by tractions and Relaxation: strains, shortening, strain energy."""

from __future__ import annotations

import numpy as np
import pytest
from verify.meshes import box, plane

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia
YOUNG, POISSON = 2e10, 0.3
SIZE = np.array([1.0, 1.0, 2.0])
COMPLIANCE = (
    np.array(
        [
            [1, -POISSON, -POISSON, 0, 0, 0],
            [-POISSON, 1, -POISSON, 0, 0, 0],
            [-POISSON, -POISSON, 1, 0, 0, 0],
            [0, 0, 0, 2 + 2 * POISSON, 0, 0],
            [0, 0, 0, 0, 2 + 2 * POISSON, 0],
            [0, 0, 0, 0, 0, 2 + 2 * POISSON],
        ]
    )
    / YOUNG
)
STATES = {
    "triaxial": (-5e6, -5e6, -20e6, 0, 0, 0),
    "uniaxial": (0, 0, -10e6, 0, 0, 0),
    "hydrostatic": (-7e6, -7e6, -7e6, 0, 0, 0),
    "shear": (0, 0, 0, 0, 3e6, 0),
}
# 1e-3 of the loads: the formulas are linear, a strain of 8.5e-4 by dead loads changes areas by as much
SCALE = 1e-3


def solve(stress, oedometer=False, scale=SCALE, strain="small"):
    scene = fdem.Scene(gravity=(0, 0, 0))
    shape = box((2, 2, 4), SIZE, jitter=0.2, seed=3)
    block = scene.add(shape, fdem.Zoned(strain=strain), fdem.Elastic(2500, YOUNG, POISSON))
    if oedometer:
        for axis, name in ((0, "x"), (1, "y")):
            scene.fix(block, name, where=lambda x, a=axis: plane(a, 0.0)(x) | plane(a, SIZE[a])(x))
        scene.fix(block, "z", where=plane(2, 0.0))
        scene.apply(fdem.Traction((0, 0, scale * stress[2])), block, where=plane(2, SIZE[2]))
    else:
        scene.apply(fdem.Traction(scale * np.array(stress)), block)
        # six components, statically determinate: no restraint of the strain
        for corner, parts in (((0, 0, 0), ("x", "y", "z")), ((0, 0, SIZE[2]), ("x", "y")), ((0, SIZE[1], 0), "x")):
            scene.fix(scene.gridpoint(corner, block), parts)
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-7).converged
    return sim, block


@pytest.mark.parametrize("state", STATES)
def test_state_under_tractions(state):
    stress = np.array(STATES[state])
    strain = COMPLIANCE @ stress
    sim, block = solve(stress)
    view, big = sim[block], np.abs(strain).max()
    # the oracle's 1e-5 for relaxation; second-order terms are 1e-6 at these loads
    assert np.abs(view.zone_strain / SCALE - strain).max() <= 1e-5 * big
    assert np.abs(view.zone_stress / SCALE - stress).max() <= 1e-5 * np.abs(stress).max()
    assert np.abs(view.strain / SCALE - strain).max() <= 1e-5 * big
    assert sim.energy.strain / SCALE**2 == pytest.approx(0.5 * stress @ strain * SIZE.prod(), rel=2e-5)
    moved = view.gridpoint_displacement / SCALE
    places = view.gridpoints - view.gridpoint_displacement
    for axis in range(3):
        high, low = plane(axis, SIZE[axis])(places), plane(axis, 0.0)(places)
        stretch = moved[high, axis].mean() - moved[low, axis].mean()
        assert stretch == pytest.approx(strain[axis] * SIZE[axis], abs=1e-5 * big * SIZE[axis])


def test_oedometer():
    modulus = YOUNG * (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON))
    sim, block = solve((0, 0, -10e6), oedometer=True)
    side = -10e6 * POISSON / (1 - POISSON)
    exact = np.array([side, side, -10e6, 0, 0, 0])
    assert np.abs(sim[block].zone_stress / SCALE - exact).max() <= 1e-5 * 10e6  # as above
    assert sim[block].strain[2] / SCALE == pytest.approx(-10e6 / modulus, rel=1e-5)
    assert sim.energy.strain / SCALE**2 == pytest.approx(0.5 * 1e14 / modulus * SIZE.prod(), rel=2e-5)


@pytest.mark.parametrize("strain", ["small", "large"])
def test_full_load_differs_by_the_strain_only(strain):
    stress = np.array(STATES["triaxial"])
    sim, block = solve(stress, scale=1.0, strain=strain)
    exact = COMPLIANCE @ stress
    # dead loads on a block strained by 8.5e-4: stress and strain are defined to a few times that
    assert np.abs(sim[block].strain - exact).max() <= 3 * np.abs(exact).max() ** 2
    assert np.abs(sim[block].stress - stress).max() <= 3 * np.abs(exact).max() * np.abs(stress).max()
