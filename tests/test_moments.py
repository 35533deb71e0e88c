"""Rolling and twisting resistance: couples cut at a length times the normal force, beside the patch's own springs."""

from __future__ import annotations

import numpy as np
import pytest
from contact_tools import World, box, move, rotation, table
from numpy.testing import assert_allclose
from scenes import assert_same_bits, everything, quietly, simulation
from test_joints import KN, KS, SN, drive, halves

import fdem

MU = np.tan(np.radians(30.0))
SECOND, POLAR = 1 / 12, 1 / 6  # second moments of the unit square [m4]
RADIUS = 1 / np.sqrt(6)  # distance of the three points from the middle: their sum of squares is the polar moment


def coulomb(friction=30.0, **given):
    return table(fdem.Coulomb(kn=KN, ks=KS, friction=friction, **given))


def pressed(law):
    w = halves(law)
    drive(w, [[0, 0, -SN / KN]])
    return w


def turn(w, axis, angle, steps=1):
    """Turn the cube about the middle of its lower face; force and moment there after every step."""
    own, out = slice(w.start[0], w.start[1]), []
    middle = np.array([0.0, 0.0, w.x[own][:, 2].min()]) if not w.f.any() else np.array([0.0, 0.0, -SN / KN])
    for _ in range(steps):
        w.x[own] = (w.x[own] - middle) @ rotation(axis, angle / steps).T + middle
        w.contacts.update(w.x)
        w.forces()
        w.commit()
        out.append(w.resultant(0, middle))
    return np.array(out)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_twist_is_resisted_by_friction_and_a_length_times_the_force(sign):
    length = 0.03
    w = pressed(coulomb(twisting=length))
    elastic = turn(w, [0, 0, 1], sign * 1e-6)[-1]
    # the friction spring and that of the resistance
    assert_allclose(elastic[1], [0, 0, -sign * KS * (2 * POLAR + length**2) * 1e-6], rtol=1e-6, atol=1e-3)
    out = turn(w, [0, 0, 1], sign * 6e-4, 50)
    assert_allclose(out[-1, 1], [0, 0, -sign * SN * (MU * RADIUS + length)], rtol=1e-6, atol=1.0)
    assert_allclose(out[:, 0], np.tile([0, 0, SN], (50, 1)), rtol=1e-8, atol=1e-3)


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, -1, 0], [0.6, 0.8, 0]])
def test_rolling_is_resisted_by_the_closure_and_a_length_times_the_force(axis):
    length, axis = 0.02, np.array(axis, float)
    w = pressed(coulomb(rolling=length))
    angle = 1e-6
    assert_allclose(turn(w, axis, angle)[-1, 1], -KN * (2 * SECOND + length**2) * angle * axis, rtol=1e-6, atol=1e-3)
    out = turn(w, axis, 8e-5, 40)
    couple = KN * SECOND * (angle + 8e-5) + length * SN
    assert_allclose(out[-1, 1], -couple * axis, rtol=1e-5, atol=1.0)  # the force leans by the angle, 1e-4
    assert_allclose(out[:, 0, 2], SN, rtol=1e-7)


def test_turning_back_unloads_along_both_springs():
    """Elastic first, then the same limit the other way: the loop dissipates limit times plastic angle."""
    length, out_and_back = 0.02, np.r_[6e-5, -1.2e-4, 1.2e-4]
    w = pressed(coulomb(rolling=length))
    limit, elastic = length * SN, length * SN / (KN * (SECOND + length**2))
    spent = [0.0]
    for k, angle in enumerate(out_and_back):
        moment = turn(w, [0, 1, 0], angle, 200)[-1, 1]
        total = out_and_back[: k + 1].sum()
        assert_allclose(moment[1], -(KN * SECOND * total + np.sign(angle) * limit), rtol=1e-5)
        spent.append(w.contacts.friction_work)
    assert_allclose(np.diff(spent), limit * (np.abs(out_and_back) - np.array([1, 2, 2]) * elastic), rtol=1e-3)
    stored = 0.5 * SN**2 / KN + 0.5 * KN * SECOND * 6e-5**2 + 0.5 * limit * elastic
    assert_allclose(w.contacts.energy(), stored, rtol=1e-4)


@pytest.mark.parametrize("kind", ["rolling", "twisting"])
def test_a_couple_follows_the_normal_force_down(kind):
    """Half the force carries half the couple; the rest of its energy is counted as lost."""
    length = 0.02
    w = pressed(coulomb(friction=0.0, **{kind: length}))
    axis, k = ([0, 0, 1], 2) if kind == "twisting" else ([0, 1, 0], 1)
    angle = 5e-5
    turn(w, axis, angle, 10)
    own = KN * SECOND * angle if kind == "rolling" else 0.0
    stiffness = KN * (SECOND + length**2) if kind == "rolling" else KS * (POLAR + length**2)
    spent = w.contacts.friction_work
    assert_allclose(w.resultant(0, (0, 0, -1e-4))[1][k], -own - length * SN, rtol=1e-5)
    drive(w, [[0, 0, 0.5 * SN / KN]])
    assert_allclose(w.resultant(0, (0, 0, -0.5e-4))[1][k], -own - 0.5 * length * SN, rtol=1e-5)
    lost = 0.5 * (length * SN) ** 2 / stiffness * (1 - 0.25)
    assert_allclose(w.contacts.friction_work - spent, lost, rtol=1e-5)


def test_no_couple_without_contact_and_none_in_tension():
    law = table(fdem.Coulomb(kn=KN, ks=KS, friction=30, tension=1e6, rolling=0.1, twisting=0.1))
    w = halves(law)
    drive(w, [[0, 0, 5e5 / KN]])
    free = halves(table(fdem.Coulomb(kn=KN, ks=KS, friction=30, tension=1e6)))
    drive(free, [[0, 0, 5e5 / KN]])
    for each in (w, free):
        own = slice(each.start[0], each.start[1])
        each.x[own] = each.x[own] @ rotation([0.3, 0.5, 0.8], 1e-6).T
        each.forces()
    assert_allclose(w.resultant(0)[1], free.resultant(0)[1], rtol=1e-12, atol=1e-9)


def test_no_length_no_difference():
    """A patch without resistance in a table that has some gives the bits of plain Coulomb."""
    plain, row = fdem.Coulomb(kn=KN, ks=KS, friction=30), fdem.Coulomb(kn=KN, ks=KS, friction=30, rolling=0.1)
    law = table(row)
    law.props[0, 10] = 0.0
    results = []
    for each in (table(plain), law):
        w = pressed(each)
        results.append(turn(w, [0.2, 0.1, 0.9], 1e-4, 20))
    assert results[0].tobytes() == results[1].tobytes()


# ---------------------------------------------------------------------------------------------------------------------
# simulations


def standing(spin=(0.0, 0.0, 0.0), **given):
    """A cube that stands on a base without friction, 25 kN."""
    scene = fdem.Scene(gravity=(0, 0, -10))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    stone = fdem.Elastic(density=2500)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), stone, name="block", angular_velocity=spin)
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=0, **{"damping": 0.2} | given))
    return scene, block


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_block_spins_only_beyond_its_twisting_resistance(share):
    """Without friction the torque that turns it is twisting times its weight; beyond, it speeds up by what is left."""
    length, weight, inertia = 0.04, 25000.0, 2500 / 6
    scene, block = standing(twisting=length)
    settled = simulation(scene, fdem.Relaxation())
    assert settled.solve(ratio=1e-10).converged
    torque = share * length * weight
    scene.apply(fdem.Moment((0, 0, torque)), block, factor=lambda t: min(t / 0.02, 1.0))
    sim = simulation(scene, start=settled)
    sim.run(time=0.05)
    spin = sim[block].angular_velocity[2]
    sim.run(time=0.05)
    gain = (sim[block].angular_velocity[2] - spin) / 0.05
    if share < 1.0:
        assert abs(sim[block].rotation_vector[2]) < 2.0 * torque / (5e8 * (POLAR + length**2))
    else:
        assert gain == pytest.approx((torque - length * weight) / inertia, rel=1e-3)
    assert sim.energy.closure < 5e-3


def test_the_stable_step_knows_the_springs_of_the_couples():
    """At the automatic step a block that rocks and twists within its resistance keeps its energy."""
    length = 1.0
    settled_scene, _ = standing(rolling=length, twisting=length)
    settled = simulation(settled_scene, fdem.Relaxation())
    assert settled.solve(ratio=1e-8).converged
    scene, _ = standing((1e-3, -2e-3, 1e-3), rolling=length, twisting=length, damping=0.0)
    sim = simulation(scene, fdem.Explicit(safety=1.0), start=settled)
    inertia = 2500 / 6
    limit = 2.0 / np.sqrt(1e9 * (2 * SECOND + length**2) / inertia)  # the fastest mode is rocking, its arm left out
    assert 0.4 * limit < sim.dt < limit
    before = sim.system.kinetic()
    kinetic = sim.history("kinetic")
    sim.cycle(5000)
    assert 0.5 * before < kinetic.values.max() < 3.0 * before  # leapfrog near its limit swings, it does not grow
    assert kinetic.values[:1000].max() > 0.9 * kinetic.values.max()


def test_restart_goes_on_bit_for_bit(tmp_path):
    def build():
        scene, block = standing(rolling=0.02, twisting=0.03)
        scene.apply(fdem.Moment((300.0, 200.0, 900.0)), block)
        scene.add(fdem.brick((0.1, 0.2, 1), (0.8, 0.9, 1.5)), fdem.Rigid(), fdem.Elastic(density=2500), group="top")
        return scene

    sim = simulation(build())
    sim.cycle(300)
    sim.save(tmp_path / "half.npz")
    again = quietly(fdem.load, tmp_path / "half.npz", build(), fdem.Explicit(), progress=False)
    assert_same_bits(everything(again), everything(sim))
    sim.cycle(300)
    again.cycle(300)
    assert_same_bits(everything(again), everything(sim))
    assert np.abs(sim.contact_table()["twisting"]).max() > 0.0


@pytest.mark.parametrize(("length", "kn"), [(0.02, 1e9), (0.1, 1e9), (0.1, 1e10)])
def test_a_rolling_prism_is_braked_by_length_over_radius(length, kn):
    """A prism of 64 sides rolls down with 2/3 (g sin a - L/R g cos a), whatever its facets and the stiffness.

    5 % of g sin a: its corners sink in, tip and hit the slope.
    """
    slope, angle = np.radians(6.0), (np.arange(64) + 0.5) * 2 * np.pi / 64
    rim = 0.5 * np.c_[np.cos(angle), np.sin(angle)]
    scene = fdem.Scene(gravity=(10 * np.sin(slope), 0, -10 * np.cos(slope)))
    scene.add(fdem.brick((-3, -1, -1), (9, 2, 0)), fdem.Rigid(), fixed=True)
    block = scene.add(
        fdem.prism(rim - [0, rim[:, 1].min()], depth=1.0), fdem.Rigid(), fdem.Elastic(density=2500), velocity=(1, 0, 0),
        angular_velocity=(0, 2, 0),
    )  # fmt: skip
    scene.joint(fdem.Coulomb(kn=kn, ks=kn, friction=40, damping=0.5, rolling=length))
    sim = simulation(scene)
    speed = sim.history(block, "velocity", component="x", every=5)
    sim.run(time=0.8)
    late = speed.time > 0.3
    measured = np.polyfit(speed.time[late], speed.values[late], 1)[0]
    exact = 2 / 3 * (10 * np.sin(slope) - 2 * length * 10 * np.cos(slope))
    assert measured == pytest.approx(exact, abs=0.05 * 10 * np.sin(slope))
    assert sim.energy.closure < 5e-3


@pytest.mark.parametrize("field", ["rolling", "twisting"])
@pytest.mark.parametrize("value", [-0.1, np.inf, np.nan, "far"])
def test_bad_lengths_are_named(field, value):
    with pytest.raises(fdem.SceneError, match=f"Coulomb: {field} = "):
        fdem.Coulomb(friction=30, **{field: value})


def test_patches_carry_couples_of_neighbours_in_a_mesh():
    """The couple of a face cut into many patches has the same limit: each has its share of the force."""
    from contact_tools import grid_box

    length = 0.03
    w = World(
        [grid_box(4, 4), move(box(4, 4, 1), t=(0, 0, -0.5))], law=coulomb(friction=0.0, twisting=length),
        affine=[False, True], gap_tolerance=None, prune=1e-4,
    )  # fmt: skip
    drive(w, [[0, 0, -SN / KN]])
    own, middle = slice(w.start[0], w.start[1]), np.array([0.5, 0.5, -SN / KN])
    for _ in range(40):
        w.x[own] = (w.x[own] - middle) @ rotation([0, 0, 1], 1e-4).T + middle
        w.contacts.update(w.x)
        w.forces()
        w.commit()
    assert_allclose(w.resultant(0, middle)[1], [0, 0, -length * SN], rtol=1e-6, atol=1.0)
