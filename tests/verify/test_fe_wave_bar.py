"""Longitudinal waves in a bar of nu = 0: free modes and a suddenly applied end load (d'Alembert)."""

from __future__ import annotations

import numpy as np
import pytest
from verify.meshes import box, plane
from verify.modes import natural_frequencies

import fdem

LENGTH, WIDTH, YOUNG, DENSITY, LOAD = 1.0, 0.05, 2e11, 8000.0, 1e7
SPEED = 5000.0
STEEL = fdem.Elastic(DENSITY, YOUNG, 0.0)
pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")


def bar(scene, cells, **given):
    # Voronoi masses of uniform cells are the one-dimensional lumping: end gridpoints half of the others
    return scene.add(box((cells, 1, 1), (LENGTH, WIDTH, WIDTH)), fdem.Zoned(strain="small"), STEEL, **given)


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
    # zones are not quite the one-dimensional lumping: 0.03, 0.14, 0.3 % below it
    np.testing.assert_allclose(found / (2 * np.pi), theory, rtol=5e-3)
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
    # fronts disperse: after twelve passages the corners of the triangle wave are off by three cells of 50
    assert np.abs(tip.values - exact).max() <= 0.08 * static
    first = tip.time < period
    # 2 %: the peak is rounded over one cell
    assert tip.values[first].max() == pytest.approx(2 * static, rel=0.02)
    # period between two minima
    spans = [(tip.time > a * period) & (tip.time < (a + 1) * period) for a in (0.5, 1.5)]
    low = [tip.time[span][np.argmin(tip.values[span])] for span in spans]
    assert low[1] - low[0] == pytest.approx(period, rel=0.01)
    # root stress: 0 until L/c, 2 p until 3 L/c; means over the plateaux, free of the front's oscillation
    stress = -np.asarray(force.values) / WIDTH**2
    quiet = force.time < 0.8 * LENGTH / SPEED
    plateau = (force.time > 1.1 * LENGTH / SPEED) & (force.time < 2.9 * LENGTH / SPEED)
    assert np.abs(stress[quiet]).max() <= 0.02 * LOAD
    assert stress[plateau].mean() == pytest.approx(2 * LOAD, rel=0.02)
    # the step turns over p^2 L A / E; leapfrog loses nothing
    assert sim.energy.closure < 1e-3


def impact(cells, stiffness=10.0):
    """A bar flying at 1 m/s against a rigid wall: contact force, its duration, speed of rebound."""
    scene = fdem.Scene(gravity=(0, 0, 0), gap_tolerance=0)
    wall = scene.add(fdem.brick((-0.1, -0.1, -0.1), (0, 0.15, 0.15)), fdem.Rigid(), fixed=True)
    block = bar(scene, cells, velocity=(-1.0, 0, 0))
    # stiff against a cell, so that it does not prolong the contact: 10 E / h
    scene.joint(fdem.Coulomb(kn=stiffness * YOUNG * cells / LENGTH, ks=0.0, friction=0.0))
    sim = fdem.Simulation(scene, fdem.Explicit(), progress=False)
    force = sim.history(lambda s: s.pair_force(wall, block)[0], every=1)
    sim.run(time=3 * LENGTH / SPEED)
    return sim, block, force


def impulse_of(force):
    """Impulse, and the duration of the contact as the span that holds 98 % of it in the middle."""
    impulse = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(force.time) * (force.values[1:] + force.values[:-1]))])
    first, last = np.interp([0.01 * impulse[-1], 0.99 * impulse[-1]], impulse, force.time)
    return impulse[-1], (last - first) / 0.98


def test_wall_impact():
    sim, block, force = impact(50)
    impulse, duration = impulse_of(force)
    mass = DENSITY * LENGTH * WIDTH**2
    # the oracle's 2 % for the momentum-averaged force rho c v A and the duration 2 L / c
    assert duration == pytest.approx(2 * LENGTH / SPEED, rel=0.02)
    assert impulse / duration == pytest.approx(DENSITY * SPEED * WIDTH**2, rel=0.02)
    assert sim[block].velocity[0] * mass == pytest.approx(impulse - mass, rel=1e-2)
    assert np.all(np.asarray(force.values)[force.time > 1.1 * duration] == 0.0)
    assert sim.energy.closure < 1e-2


def test_wall_impact_rebound():
    sim, block, _ = impact(100)
    assert sim[block].velocity[0] >= 0.97  # the oracle's, at 100 cells


def test_equal_bars_exchange_velocities():
    scene = fdem.Scene(gravity=(0, 0, 0), gap_tolerance=0)
    left, right = (
        scene.add(
            box((50, 1, 1), (at + LENGTH, WIDTH, WIDTH), (at, 0, 0)),
            fdem.Zoned(strain="small"),
            STEEL,
            velocity=(v, 0, 0),
        )
        for at, v in ((-LENGTH, 1.0), (0.0, 0.0))
    )
    scene.joint(fdem.Coulomb(kn=10 * YOUNG * 50 / LENGTH, ks=0.0, friction=0.0))
    sim = fdem.Simulation(scene, fdem.Explicit(), progress=False)
    force = sim.history(lambda s: s.pair_force(left, right)[0], every=1)
    sim.run(time=3 * LENGTH / SPEED)
    impulse, duration = impulse_of(force)
    # as for the wall: stress rho c v / 2 for 2 L / c
    assert duration == pytest.approx(2 * LENGTH / SPEED, rel=0.02)
    assert impulse / duration == pytest.approx(0.5 * DENSITY * SPEED * WIDTH**2, rel=0.02)
    assert sim[right].velocity[0] == pytest.approx(1.0, abs=0.03)
    assert sim[left].velocity[0] == pytest.approx(0.0, abs=0.03)
    # momentum: Newton's third law, to round-off
    assert sim[left].velocity[0] + sim[right].velocity[0] == pytest.approx(1.0, abs=1e-12)
