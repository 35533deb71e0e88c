"""Barton-Bandis joints: closure, strength, wear and dilation by their formulas; steps that follow the stiffness."""

from __future__ import annotations

import numpy as np
import pytest
from contact_tools import table
from scenes import assert_same_bits, everything, quietly, simulation
from test_failure import under_constant_pressure
from test_joints import drive, halves

import fdem

KN, KS, MOST = 1e10, 5e9, 2e-4
JRC, JCS, BASE, PEAK = 10.0, 50e6, 25.0, 1e-3
GIVEN = {"kn": KN, "ks": KS, "max_closure": MOST, "jrc": JRC, "jcs": JCS, "residual_friction": BASE}


def barton_bandis(**given):
    return fdem.BartonBandis(**GIVEN | given)


def pressure(closure):
    return KN * closure / (1.0 - closure / MOST)


def closure(pressure):
    return pressure / (KN + pressure / MOST)


def strength(sn, jrc=JRC):
    """Barton's criterion [Pa] with its angle kept between the residual one and 70 degrees."""
    angle = np.clip(jrc * np.log10(JCS / sn) + BASE, BASE, 70.0)
    return sn * np.tan(np.radians(angle))


def test_closure_follows_the_hyperbola_there_and_back():
    w = halves(table(barton_bandis()))
    ratio = np.r_[np.linspace(0.05, 0.98, 40), np.linspace(0.96, 0.02, 40)]
    f = drive(w, np.c_[np.zeros((80, 2)), -MOST * np.diff(np.r_[0.0, ratio])])
    np.testing.assert_allclose(f[:, 2], pressure(ratio * MOST), rtol=1e-9)  # positions round off at 1e-16 m, / (1 - r)
    assert drive(w, [[0, 0, 0.03 * MOST]])[-1, 2] == 0.0  # no tension


@pytest.mark.parametrize("ratio", [1e-5, 1e-3, 0.3, 0.9, 0.98])
def test_energy_of_closure_is_the_area_under_the_hyperbola(ratio):
    w = halves(table(barton_bandis()))
    drive(w, [[0, 0, -ratio * MOST]])
    exact = KN * MOST**2 * (-np.log1p(-ratio) - ratio) if ratio > 1e-4 else 0.5 * KN * (ratio * MOST) ** 2
    np.testing.assert_allclose(w.contacts.energy(), exact, rtol=1e-5 if ratio < 1e-4 else 1e-9)


def test_beyond_99_percent_the_curve_goes_on_along_its_tangent():
    w = halves(table(barton_bandis()))
    f = drive(w, [[0, 0, -0.99 * MOST], [0, 0, -0.11 * MOST]])
    np.testing.assert_allclose(f[1, 2] - f[0, 2], 1e4 * KN * 0.11 * MOST, rtol=1e-9)


@pytest.mark.parametrize("sn", [1.0, 1e2, 1e4, 1e5, 1e6, 5e6, 2e7, 1e8])
def test_strength_is_bartons(sn):
    """With the angle cut at 70 degrees at low stress, the residual one above JCS."""
    w = halves(table(barton_bandis(damage=np.inf)))
    drive(w, [[0, 0, -closure(sn)]])
    f = drive(w, [[2.0 * strength(sn) / KS, 0, 0]])[-1]
    np.testing.assert_allclose(f, [-strength(sn), 0, sn], rtol=1e-6, atol=1e-9 * sn)  # closure of 1 Pa: 1e-10 m


def test_no_strength_without_stress():
    w = halves(table(barton_bandis()))
    drive(w, [[0, 0, -1e-16]])
    f = drive(w, [[1e-3, 0, 0]])[-1]
    assert np.isfinite(f).all()
    assert abs(f[0]) <= np.tan(np.radians(70.0)) * f[2] * (1 + 1e-9)


def test_roughness_wears_off_with_slip():
    """JRC after slips of 0, 1, 3, 9, 24, 99 and more peak displacements, and straight between."""
    sn = 1e6
    w = halves(table(barton_bandis(damage=np.inf, peak_displacement=PEAK)))
    drive(w, [[0, 0, -closure(sn)], [strength(sn) / KS, 0, 0]])
    for slip, share in ((0, 1), (0.5, 0.925), (1, 0.85), (3, 0.7), (9, 0.5), (24, 0.4), (61.5, 0.2), (99, 0), (110, 0)):
        have = w.contacts.patches.memory_old[:, 6].max()
        f = drive(w, [[slip * PEAK - have, 0, 0], [1e-9, 0, 0]])[-1]
        np.testing.assert_allclose(-f[0], strength(sn, JRC * share), rtol=1e-4)  # elastic unloading adds slip
    w.contacts.patches.memory_old[:, 4] = 0.0  # a reset of the slip that is shown heals nothing
    np.testing.assert_allclose(-drive(w, [[1e-9, 0, 0]])[-1, 0], strength(sn, 0.0), rtol=1e-6)


def test_faces_rise_by_half_the_roughness_angle():
    sn, tan = 1e6, np.tan(np.radians(0.5 * JRC * np.log10(JCS / 1e6)))
    w = halves(table(barton_bandis()))
    drive(w, [[0, 0, -closure(sn)], [strength(sn) / KS, 0, 0]])
    tangent = KN / (1.0 - closure(sn) / MOST) ** 2
    rise, _ = under_constant_pressure(w, [[2e-6, 0, 0]] * 50, sn, tangent)
    # the pressure swings by 0.7 % while the cube is brought back to it, which unloads the shear spring a little
    np.testing.assert_allclose(rise, tan * 2e-6 * np.arange(1, 51), rtol=2e-3)


def test_a_second_pass_under_a_harder_press_shows_the_closure_of_both():
    """Dilation lifts a face that is held down along the hyperbola."""
    w = halves(table(barton_bandis()))
    drive(w, [[0, 0, -0.5 * MOST]])
    f = drive(w, [[1e-6, 0, 0]] * 400 + [[0, 0, 0]])[-1]
    lift = w.contacts.patches.memory_old[:3, 5]
    assert lift.min() > 0.02 * MOST
    np.testing.assert_allclose(f[2], pressure(0.5 * MOST + lift[0]), rtol=1e-9)


# ---------------------------------------------------------------------------------------------------------------------
# integrators

MASS, G = 2500.0, 10.0


def block_on_joint(force=0.0, factor=1.0, law=None, zoned=False, **options):
    """A unit cube on a fixed base, pushed down by `force` [N]."""
    scene = fdem.Scene(gravity=(0, 0, -G), **options)
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    body = fdem.Zoned(size=1.0) if zoned else fdem.Rigid()
    material = fdem.Elastic(density=MASS, young=1e10, poisson=0.0)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), body, material, name="block")
    scene.joint(law or barton_bandis(damping=0.2))
    if force:
        scene.apply(fdem.Force((0, 0, -force)), block, factor=factor)
    return scene, block


@pytest.mark.parametrize("force", [0.0, 1e6, 1e7, 1e8])
@pytest.mark.parametrize("damping", [fdem.Local(), fdem.Adaptive()], ids=["local", "adaptive"])
def test_relaxation_ends_at_the_exact_closure(force, damping):
    """Weight alone closes it by 1 %, 1e8 N by 98 %, in as many cycles; sudden loads do not throw the block away."""
    scene, block = block_on_joint(force)
    sim = simulation(scene, fdem.Relaxation(damping=damping))
    report = sim.solve(ratio=1e-9)
    assert report.reason == "equilibrium"
    assert report.cycles < 2000
    np.testing.assert_allclose(-sim[block].displacement[2], closure(force + MASS * G), rtol=1e-7)


@pytest.mark.parametrize("shift", [-2e-4, 3e-4])
def test_closure_counts_from_the_reference_gap(shift):
    """A gap or an overlap below the tolerance is a closed joint without stress, whose closure starts there."""
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    block = scene.add(fdem.brick((0, 0, shift), (1, 1, 1 + shift)), fdem.Rigid(), fdem.Elastic(density=MASS))
    scene.joint(barton_bandis())
    scene.apply(fdem.Force((0, 0, -4e6)), block)
    sim = simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-9).converged
    np.testing.assert_allclose(-sim[block].displacement[2], closure(4e6 + MASS * G), rtol=1e-7)


def test_a_zoned_block_settles_on_the_joint():
    scene, _ = block_on_joint(5e6, zoned=True)
    sim = simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-8).reason == "equilibrium"
    table = sim.contact_table()
    np.testing.assert_allclose((table["force"][:, 2]).sum(), 5e6 + MASS * G, rtol=1e-6)
    np.testing.assert_allclose(table["traction"][:, 0], pressure(np.maximum(-table["gap"], 0.0)), rtol=1e-9)


def test_the_step_follows_the_tangent_under_a_growing_load():
    """Explicit stays stable, below 2/omega of the present tangent, and ends at the closure of the load."""
    scene, block = block_on_joint(5e7, factor=lambda t: t / 0.1)
    sim = simulation(scene)
    steps, factors = [sim.dt], []
    for _ in range(5):
        sim.run(time=0.02)
        load = 5e7 * sim.time / 0.1 + MASS * G
        tangent = KN / (1.0 - closure(load) / MOST) ** 2
        factors.append(sim.dt * np.sqrt(tangent / MASS) / 2.0)
        steps.append(sim.dt)
        np.testing.assert_allclose(-sim[block].displacement[2], closure(load), rtol=1e-3)  # it lags in its damper
    zeta = 0.2
    assert np.all(np.diff(steps) < 0.0)
    # 0.8 of the limit with the dashpot, found again when the tangent has grown by a tenth
    assert max(factors) < 0.8 * np.sqrt(1.1)
    assert min(factors) > 0.7 * 0.8 * (np.sqrt(1 + zeta**2) - zeta)
    assert sim.energy.closure < 1e-3


@pytest.mark.parametrize("speed", [0.01, 1.0, 10.0])
def test_an_impact_gives_its_energy_back(speed):
    """The step is shortened before the joint stiffens; the error is that of the step, as with a linear joint."""
    law = barton_bandis()
    closures = []
    for safety in (0.2, 0.05):
        scene = fdem.Scene(gravity=(0, 0, 0), gap_tolerance=0.0)
        scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
        fall = fdem.brick((0, 0, 1e-3), (1, 1, 1.001))
        block = scene.add(fall, fdem.Rigid(), fdem.Elastic(density=MASS), velocity=(0, 0, -speed))
        scene.joint(law)
        sim = simulation(scene, fdem.Explicit(safety=safety))
        sim.run(time=2e-3 / speed + 2e-3)
        closures.append(sim.energy.closure)
        # no oracle: the joint stiffens within a few steps; 1.3 % at the longest of them
        assert sim[block].velocity[2] == pytest.approx(speed, rel=0.014 if safety == 0.2 else 0.01)
    assert closures[1] < 0.01


def test_restart_goes_on_bit_for_bit(tmp_path):
    def build():
        return block_on_joint(2e7, factor=lambda t: min(t / 0.004, 1.0))[0]

    for make in (fdem.Explicit, fdem.Relaxation):
        sim = simulation(build(), make())
        sim.cycle(60)
        sim.save(tmp_path / "half.npz")
        again = quietly(fdem.load, tmp_path / "half.npz", build(), make(), progress=False)
        assert_same_bits(everything(again), everything(sim))
        sim.cycle(150)
        again.cycle(150)
        assert_same_bits(everything(again), everything(sim))


def test_in_situ_stress_finds_the_closure_that_carries_it():
    """Stress in a block and in its joint are in balance from the start: nothing moves, tractions are as asked for."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((0, 0, -1), (1, 1, 0)), fdem.Rigid(), fixed=True)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Zoned(size=1.0), fdem.Elastic(MASS, 1e10, 0.2))
    scene.add(fdem.brick((0, 0, 1), (1, 1, 2)), fdem.Rigid(), fixed=True)
    scene.joint(barton_bandis())
    scene.apply(fdem.Stress(zz=-1.5e7))
    sim = simulation(scene)
    t = sim.contact_table()
    facing = t["area"] > 0.01
    np.testing.assert_allclose(t["traction"][facing, 0], 1.5e7, rtol=1e-9)
    np.testing.assert_allclose(-t["gap"][facing], closure(1.5e7), rtol=1e-9)
    tangent = KN / (1.0 - closure(1.5e7) / MOST) ** 2
    assert sim.dt < 2.0 / np.sqrt(tangent / MASS)
    sim.cycle(500)
    assert np.abs(sim[block].gridpoint_displacement).max() < 1e-6 * closure(1.5e7)


BAD = {
    "kn": (None, 0.0, -1.0, np.nan),
    "ks": (-1.0, np.inf),
    "max_closure": (0.0, -1e-4, np.inf, "thin"),
    "jrc": (-1.0, 21.0, None),
    "jcs": (0.0, -5e6, np.nan),
    "residual_friction": (-1.0, 70.5),
    "peak_displacement": (0.0, -1.0, np.inf),
    "damage": (0.5, np.nan),
    "damping": (-0.1, np.inf),
}


@pytest.mark.parametrize(("field", "value"), [(field, value) for field, values in BAD.items() for value in values])
def test_bad_values_are_named(field, value):
    with pytest.raises(fdem.SceneError, match=rf"BartonBandis: {field} = "):
        barton_bandis(**{field: value})
