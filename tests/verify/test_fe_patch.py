"""Linear patch test: a linear displacement of the boundary gives it inside, and one stress everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from stress.far import POISSON, SHIFT, YOUNG, A, exact_stress
from verify.meshes import box

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia
LINEAR_STRESS = np.array([1.04e6, -0.56e6, 0.72e6, 0.32e6, -0.04e6, 0.92e6])


def solve(gradient, strain, mass="voronoi"):
    scene = fdem.Scene(gravity=(0, 0, 0))
    body = fdem.Zoned(strain=strain, mass=mass)
    shape = box((3, 3, 3), (1, 1, 1), jitter=0.25, seed=1)
    block = scene.add(shape, body, fdem.Elastic(2500, YOUNG, POISSON))
    drive = scene.apply(
        fdem.Displacement(lambda x: x @ gradient.T + SHIFT),
        block,
        where=lambda x: (np.abs(x - 0.5) > 0.5 - 1e-9).any(axis=1),
    )
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    report = sim.solve(ratio=1e-9)
    sim.cycle(1000)  # on to round-off, so that the stress of every zone can be held to 1e-10
    moved = sim[block].gridpoint_displacement
    return sim, block, drive, report, moved, sim[block].gridpoints - moved


@pytest.mark.parametrize("mass", ["voronoi", "row-sum", "inertia-matched"])
def test_displacement_and_stress_of_every_zone(mass):
    sim, block, drive, report, moved, places = solve(A, "large", mass)
    assert report.converged
    # the oracle's tolerance for relaxation
    assert np.abs(moved - (places @ A.T + SHIFT)).max() <= 1e-8 * np.abs(A).max()
    exact = exact_stress(A)
    # the rule of the oracle, 1e-10, with the round-off of positions over the strain: eps |x| / 1e-4 / h = 7e-12
    assert np.abs(sim[block].zone_stress - exact).max() <= 1e-10 * np.abs(exact).max()
    # a uniform stress needs no net force
    assert np.abs(sim[drive].force).max() <= 1e-9 * np.abs(exact).max()


def test_it_is_the_linear_stress_but_for_squares_of_the_gradient():
    sim, block, _, report, _, _ = solve(A, "large")
    assert report.converged
    # a St. Venant-Kirchhoff material differs from the linear formula by the order of |A|
    assert np.abs(sim[block].zone_stress - LINEAR_STRESS).max() <= 5 * np.abs(A).max() * np.abs(LINEAR_STRESS).max()


@pytest.mark.parametrize("component", range(6))
def test_elementary_strains_in_the_linear_range(component):
    gradient = np.zeros((3, 3))
    row, column = [(0, 0), (1, 1), (2, 2), (1, 2), (2, 0), (0, 1)][component]
    gradient[row, column] = gradient[column, row] = 1e-4
    sim, block, _, report, moved, places = solve(gradient, "small")
    assert report.converged
    assert np.abs(moved - (places @ gradient.T + SHIFT)).max() <= 1e-8 * 1e-4  # as above
    lam = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    mu = YOUNG / (2 * (1 + POISSON))
    exact = (lam * np.trace(gradient) * np.eye(3) + 2 * mu * gradient)[[0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]]
    # a symmetric gradient does not turn the block: its frame, and so Hooke's law, is exact to round-off
    assert np.abs(sim[block].zone_stress - exact).max() <= 1e-10 * np.abs(exact).max()
