"""How joints fail and what is left: strength lost at the first failure, the mode kept, energy of paths, dilation."""

from __future__ import annotations

import numpy as np
import pytest
from contact_tools import World, box, grid_box, move, rotation, table
from scenes import assert_same_bits, everything, quietly, simulation
from test_joints import KN, KS, SN, TAN, drive, halves

import fdem
from fdem.kernels.patches import FACING

INTACT, TENSION, SHEAR = 0, 1, 2


def coulomb(**given):
    return table(fdem.Coulomb(**{"kn": KN, "ks": KS, "friction": 30} | given))


def bonded(**given):
    return table(fdem.Bonded(kn=KN, ks=KS, **given))


def failures(w):
    """Failure of all contact points between the faces that lie on each other (strips beside them are narrow)."""
    t = w.contacts.table(w.x)
    return set(t["failure"][t["area"] > 0.01].tolist())


PRESS = [0, 0, -SN / KN]
PEAK = SN * TAN / KS
# law, displacement that breaks it, mode; the cube is pressed first where the last one says so
BREAK = {
    "bond in tension": (bonded(tension=1e5, shear=2e5), [0, 0, 1.1e5 / KN], TENSION),
    "bond in shear": (bonded(tension=1e5, shear=2e5), [2.2e5 / KS, 0, 0], SHEAR),
    "bond in shear while it is pulled": (bonded(tension=1e5, shear=2e5), [2.2e5 / KS, 0, 0.9e5 / KN], SHEAR),
    "tension": (coulomb(cohesion=1e5, tension=5e4), [0, 0, 6e4 / KN], TENSION),
    "cohesion": (coulomb(cohesion=1e5, tension=5e4), [1.1e5 / KS, 0, 0], SHEAR),
    "cohesion while it is pulled": (coulomb(cohesion=1e5, tension=5e4), [1e5 / KS, 0, 2e4 / KN], SHEAR),
    "cohesion without tension": (coulomb(cohesion=1e5), [0, 0, 1.1 * SN / KN], TENSION, PRESS),
    "friction alone": (coulomb(), [1.1 * PEAK, 0, 0], INTACT, PRESS),
    "friction that falls": (coulomb(residual_friction=20), [1.1 * PEAK, 0, 0], SHEAR, PRESS),
}


@pytest.mark.parametrize("name", BREAK)
def test_the_mode_is_kept_whatever_comes_after(name):
    law, step, mode, *before = BREAK[name]
    w = halves(law)
    drive(w, [*before, [0.4 * step[0], 0, 0.4 * step[2]]])
    assert failures(w) == {INTACT}
    drive(w, [[0.6 * step[0], 0, 0.6 * step[2]]])
    assert failures(w) == {mode}
    # apart, together again, along
    f = drive(w, [[0, 0, 1e-4], [0, 0, -2e-4 - SN / KN], [1e-3, 0, 0]])
    assert failures(w) == {mode}
    assert f[-1, 2] > SN
    slope = {"friction that falls": 20.0}.get(name, 0.0 if name.startswith("bond") else 30.0)
    np.testing.assert_allclose(-f[-1, 0], np.tan(np.radians(slope)) * f[-1, 2], rtol=1e-9, atol=1e-3)


def test_one_failure_loses_tension_and_cohesion():
    """Failed in shear, nothing holds in tension; failed in tension, shear has its residual strength only."""
    law = coulomb(cohesion=2e5, tension=1e5, residual_cohesion=5e4, residual_friction=20)
    rest = 5e4 + SN * np.tan(np.radians(20))
    w = halves(law)
    f = drive(w, [[0, 0, -SN / KN], [1e-3, 0, 0], [0, 0, (SN + 5e4) / KN]])
    np.testing.assert_allclose(f[1], [-rest, 0, SN], rtol=1e-9, atol=1e-3)
    assert np.abs(f[2]).max() == 0.0
    w = halves(law)
    f = drive(w, [[0, 0, 1.1e5 / KN], [0, 0, -(SN + 1.1e5) / KN], [1e-3, 0, 0]])
    np.testing.assert_allclose(f[-1], [-rest, 0, SN], rtol=1e-9, atol=1e-3)


def test_peak_strength_holds_until_it_is_reached():
    w = halves(coulomb(cohesion=2e5, tension=1e5, residual_friction=20))
    peak = 2e5 + SN * TAN
    f = drive(w, [[0, 0, -SN / KN], [0.999 * peak / KS, 0, 0], [0.002 * peak / KS, 0, 0]])
    np.testing.assert_allclose(-f[1:, 0], [0.999 * peak, SN * np.tan(np.radians(20))], rtol=1e-9)


def test_contacts_formed_later_have_residual_strength():
    w = World(
        [move(box(1, 1, 1), t=(0, 0, 0.51)), move(box(4, 4, 1), t=(0, 0, -0.5))],
        law=coulomb(cohesion=2e5, tension=1e5, residual_friction=20), prune=1e-4,
    )  # fmt: skip
    f = drive(w, [[0, 0, -0.01 - SN / KN], [1e-3, 0, 0]])
    np.testing.assert_allclose(f[-1], [-SN * np.tan(np.radians(20)), 0, SN], rtol=1e-9, atol=1e-3)
    assert failures(w) == {INTACT}


@pytest.mark.parametrize("law", ["bond in shear while it is pulled", "cohesion while it is pulled"])
def test_a_bond_that_shears_while_it_is_pulled_gives_all_its_energy_back(law):
    """Work put in up to failure is the elastic energy of both springs, and all of it is counted as lost."""
    law, step, _ = BREAK[law]
    w, n = halves(law), 2000
    pulled = drive(w, [[0, 0, step[2]]])[-1]
    work, last = 0.5 * -pulled[2] * step[2], pulled
    for _ in range(n):
        f = drive(w, [[step[0] / n, 0, 0]])[0]
        if not f.any():
            break
        work -= 0.5 * (f[0] + last[0]) * step[0] / n
        last = f
    assert not f.any()
    np.testing.assert_allclose(w.contacts.friction_work, work, rtol=2e-3)  # n steps
    assert w.contacts.energy() == 0.0


def test_points_that_have_failed_store_nothing():
    """A bonded cube is pried open about one edge: points fail one by one, the work goes on adding up."""
    w = halves(bonded(tension=2e5, shear=1e7))
    own, pivot = slice(w.start[0], w.start[1]), np.array([-0.5, 0.0, 0.0])
    work, f_old, seen, n = 0.0, np.zeros_like(w.x), set(), 4000
    for k in range(n):
        before = w.x.copy()
        w.x[own] = (w.x[own] - pivot) @ rotation([0, 1, 0], -4e-4 / n).T + pivot
        w.contacts.update(w.x)
        f = w.forces().copy()
        w.commit()
        work -= 0.5 * float(np.vdot(f + f_old, w.x - before))
        f_old = f
        if k % 50 == 49:
            seen.add(int((w.contacts.patches.failure == TENSION).sum()))
            kept = w.contacts.energy() + w.contacts.friction_work
            assert abs(work - kept) < 0.01  # each break is off by half a step's work at 67 kN: 3e-3 J
    assert {0, 1, 3} <= seen  # partly open in between
    assert kept > 1.0


def test_failures_go_along_when_patches_are_cut_anew():
    """A meshed cube slides over the mesh lines of a floor; its patches are cut anew every step and get new partners."""
    shapes = [grid_box(6, 6, (0.5, 0.5, 0.5)), move(grid_box(4, 4, (2.0, 2.0, 1.0)), t=(-1, -1, -1))]
    w = World(
        shapes, law=coulomb(cohesion=1e5), affine=[False, False], clip_always=True, gap_tolerance=None, prune=1e-4
    )
    drive(w, [PRESS])
    assert not w.contacts.table(w.x)["failure"].any()
    drive(w, [[1e-3, 0, 0]])
    for step in 60 * [[5e-3, 2e-3, 0]]:
        drive(w, [step])
        t = w.contacts.table(w.x)
        pressed = (t["traction"][:, 0] > 0.1 * SN) & ((w.contacts.patches.flags[t["patch"]] & FACING) > 0)
        area = np.bincount(t["failure"][pressed], t["area"][pressed], 3)
        assert area[SHEAR] == area.sum() > 0.24
    again = w.contacts.state_arrays()
    drive(w, [[0, 0, 1.0]])
    w.contacts.restore(again)
    assert (w.contacts.patches.failure == again["patch_failure"]).all()


def column():
    """Three glued bricks: the middle joint breaks, by the weight of a brick that hangs there."""
    scene = fdem.Scene()
    for i, name in enumerate(("top", "middle", "bottom")):
        lower, upper = (0, 0, 2 - i), (1, 1, 3 - i)
        scene.add(fdem.brick(lower, upper), fdem.Rigid(), fdem.Elastic(density=2500), name=name, fixed=name == "top")
    scene.add(fdem.brick((1, 0, 2), (2, 1, 3)), fdem.Rigid(), fdem.Elastic(density=2500), name="side")
    scene.joint(fdem.Bonded(kn=1e9, ks=5e8, tension=6e4, shear=1e5))
    scene.joint(fdem.Bonded(kn=1e9, ks=5e8, tension=2e4, shear=1e5), between=("middle", "bottom"))
    return scene


def modes(sim):
    """Failure of every pair of blocks by name."""
    t, names = sim.contact_table(), sim.model.names
    pairs = {}
    for a, b, mode in zip(t["block_a"], t["block_b"], t["failure"], strict=True):
        pairs.setdefault(frozenset((names[a], names[b])), set()).add(int(mode))
    return pairs


def test_failures_outlive_restart_and_excavation(tmp_path):
    sim = simulation(column())
    sim.run(time=0.02)
    broken, whole = frozenset(("middle", "bottom")), frozenset(("top", "middle"))
    assert modes(sim)[broken] == {TENSION}
    assert modes(sim)[whole] == {INTACT}
    sim.save(tmp_path / "state.npz")
    again = quietly(fdem.load, tmp_path / "state.npz", column(), fdem.Explicit(), progress=False)
    assert_same_bits(everything(again), everything(sim))
    again.excavate("side")
    assert modes(again)[broken] == {TENSION}
    assert modes(again)[whole] == {INTACT}
    started = simulation(column(), fdem.Relaxation(), start=sim)
    assert modes(started)[broken] == {TENSION}


def test_the_mode_is_an_array_of_the_contacts():
    sim = simulation(column())
    sim.run(time=0.01)
    cloud = sim.contacts()
    assert list(cloud.field_data["failure_names"]) == ["none", "tension", "shear"]
    assert set(cloud.point_data["failure"]) == {INTACT, TENSION}
    assert (cloud.point_data["failure"] == sim.contact_table()["failure"]).all()


# ---------------------------------------------------------------------------------------------------------------------
# dilation


def under_constant_pressure(w, steps, pressure, stiffness=KN):
    """Shear increments with the cube free to rise; its rise and shear traction after each (area 1)."""
    rise, out = 0.0, []
    for step in steps:
        f = drive(w, [step])[-1]
        for _ in range(60):
            lift = (f[2] - pressure) / stiffness
            rise += lift
            f = drive(w, [[0, 0, lift]])[-1]
            if abs(f[2] - pressure) < 1e-9 * pressure:
                break
        out.append((rise, f[0]))
    return np.array(out).T


def test_the_faces_rise_by_the_dilation_angle_up_to_the_limit():
    """Rise = tan(dilation) times the slip, all slip added up, to the limit; there and back counts twice."""
    tan, limit = np.tan(np.radians(8.0)), 4e-4
    w = halves(coulomb(dilation=8.0, dilation_limit=limit))
    drive(w, [[0, 0, -SN / KN]])
    steps = np.r_[np.full(40, 1e-5), np.full(60, -1e-5)]
    rise, shear = under_constant_pressure(w, np.c_[steps, 0 * steps, 0 * steps], SN)
    elastic = SN * TAN / KS
    slip, s = np.zeros(len(steps)), 0.0
    for k, d in enumerate(steps):
        slip[k] = slip[k - 1] + max(abs(s + d) - elastic, 0.0)
        s = np.clip(s + d, -elastic, elastic)
    np.testing.assert_allclose(rise, tan * np.minimum(slip, limit), rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(np.abs(shear[[30, -1]]), SN * TAN, rtol=1e-7)
    assert slip[-1] > 1.5 * limit > 3.0 * elastic


def test_dilation_does_not_begin_again_when_slip_is_reset():
    scene = fdem.Scene(gravity=(0, 0, -10))
    scene.add(fdem.brick((-1, -1, -1), (3, 2, 0)), fdem.Rigid(), name="base", fixed=True)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), fdem.Elastic(density=2500), name="block")
    scene.fix(block, component="rotation")
    scene.joint(fdem.Coulomb(kn=1e8, ks=1e8, friction=20, dilation=5, dilation_limit=1e-3, damping=0.3))
    scene.apply(fdem.Velocity((0.1, None, None)), block)
    sim = simulation(scene)
    sim.run(time=0.2)
    top = sim[block].displacement[2] + 2500 * 10 / 1e8
    np.testing.assert_allclose(top, np.tan(np.radians(5)) * 1e-3, rtol=1e-3)  # after some swinging
    sim.reset("slip")
    sim.run(time=0.1)
    assert sim.contact_table()["slip"].max() > 5e-3
    np.testing.assert_allclose(sim[block].displacement[2] + 2500 * 10 / 1e8, top, rtol=1e-3)


# ---------------------------------------------------------------------------------------------------------------------
# damping


@pytest.mark.parametrize("restitution", [0.1, 0.3, 0.6, 0.9, 1.0])
def test_blocks_rebound_with_the_restitution_asked_for(restitution):
    """To 0.5 %, as the oracle has it; the dashpot does not pull, so the contact ends when the force vanishes."""
    scene = fdem.Scene(gravity=(0, 0, 0), gap_tolerance=0.0)
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    gap = 1e-5
    block = scene.add(
        fdem.brick((0, 0, gap), (1, 1, 1 + gap)), fdem.Rigid(), fdem.Elastic(density=2500), velocity=(0, 0, -0.1)
    )
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=0, restitution=restitution))
    omega = np.sqrt(1e9 / 2500)
    sim = simulation(scene, fdem.Explicit(dt=np.pi / omega / 1000))
    sim.run(time=gap / 0.1 + 12 / omega / max(restitution, 0.1))
    assert sim[block].velocity[2] == pytest.approx(0.1 * restitution, rel=5e-3)
    assert sim.energy.closure < 1e-2


def test_restitution_below_a_hundredth_is_taken_as_that():
    few = [fdem.Coulomb(friction=0, restitution=e).damping_ratio for e in (0.0, 0.005, 0.01)]
    assert few[0] == few[1] == few[2]
    assert 4.0 < few[0] < 5.0
    assert fdem.Coulomb(friction=0, restitution=1.0).damping_ratio == 0.0
    assert fdem.Coulomb(friction=0, damping=0.2).damping_ratio == 0.2
