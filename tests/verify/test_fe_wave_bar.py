"""Longitudinal waves in a bar of nu = 0: free modes and a suddenly applied end load (d'Alembert)."""

from __future__ import annotations

import numpy as np
import pytest

import fdem
from verify.meshes import box, plane
from verify.modes import natural_frequencies

LENGTH, WIDTH, YOUNG, DENSITY, LOAD = 1.0, 0.05, 2e11, 8000.0, 1e7
SPEED = 5000.0
STEEL = fdem.Elastic(DENSITY, YOUNG, 0.0)
pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")


def bar(scene, cells, **given):
    # mass "row-sum": with uniform cells it is the bar's own lumping, end gridpoints half of the others
    return scene.add(box((cells, 1, 1), (LENGTH, WIDTH, WIDTH)), fdem.Zoned(mass="row-sum", strain="small"), STEEL, **given)


def test_free_axial_modes():
    def make():
        scene = fdem.Scene(gravity=(0, 0, 0))
        block = bar(scene, 20)
        scene.fix(block, ("y", "z"))
        return scene, block

    def axial(places, rng):
        draw = rng.standard_normal(21)[np.round(places[:, 0] * 20).astype(int)]
        return np.column_stack([draw, 0 * draw, 0 * draw])

    found, _ = natural_frequencies(make, 2 * np.pi * 9000, 3, seeds=2, pattern=axial)
    exact = 2500.0 * np.arange(1, 4)
    # one-dimensional theory at 20 cells: -0.103, -0.411, -0.922 %
    theory = 2 / 20 * np.sin(np.arange(1, 4) * np.pi / 40) * 20**2 * SPEED / (2 * np.pi)
    np.testing.assert_allclose(found / (2 * np.pi), theory, rtol=2e-4)
    assert found[0] / (2 * np.pi) == pytest.approx(exact[0], rel=1.5e-3)  # the oracle's, corrected


def test_step_load():
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = bar(scene, 50)
    scene.fix(block, ("y", "z"))
    root = scene.fix(block, "x", where=plane(0, 0.0))
    scene.apply(fdem.Traction((LOAD, 0, 0)), block, where=plane(0, LENGTH))
    sim = fdem.Simulation(scene, fdem.Explicit(), progress=False)
    places = sim[block].gridpoints
    end = np.flatnonzero(places[:, 0] > LENGTH - 1e-9)
    tip = sim.history(lambda s: s[block].gridpoint_displacement[end, 0].mean(), every=1)
    force = sim.history(lambda s: s[root].force[0], every=1)
    period, static = 4 * LENGTH / SPEED, LOAD * LENGTH / YOUNG
    sim.run(time=3 * period)
    exact = static * (1.0 - (2.0 / np.pi) * np.arcsin(np.cos(2 * np.pi * tip.time / period)))
    # the corner of the triangle is rounded over one cell: 1/50 of the static value each way
    assert np.abs(tip.values - exact).max() <= 0.04 * static
    first = tip.time < period
    assert tip.values[first].max() == pytest.approx(2 * static, rel=0.01)
    # period between the first and the third minimum
    low = [tip.time[(tip.time > a * period) & (tip.time < b * period)][
        np.argmin(tip.values[(tip.time > a * period) & (tip.time < b * period)])] for a, b in ((0.5, 1.5), (1.5, 2.5))]
    assert low[1] - low[0] == pytest.approx(period, rel=0.01)
    # root stress: 0 until L/c, 2 p until 3 L/c; means over the plateaux, free of the front's oscillation
    stress = -np.asarray(force.values) / WIDTH**2
    quiet = force.time < 0.9 * LENGTH / SPEED
    plateau = (force.time > 1.1 * LENGTH / SPEED) & (force.time < 2.9 * LENGTH / SPEED)
    assert np.abs(stress[quiet]).max() <= 0.02 * LOAD
    assert stress[plateau].mean() == pytest.approx(2 * LOAD, rel=0.02)
    # the step turns over p^2 L A / E; leapfrog loses nothing
    assert sim.energy.closure < 1e-3
