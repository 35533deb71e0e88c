"""Joint laws on one rigid block on a floor: exact shear paths, strength, bonds, dilation, damping."""

from __future__ import annotations

import numpy as np
import pytest
from contact_tools import World, bonded, box, coulomb, move, rotation

KN, KS, SN = 1e10, 5e9, 1e6
TAN = np.tan(np.radians(30.0))


def halves(law, gap_tolerance=None, clip_always=False):
    """Unit cube on a wide floor, touching."""
    return World(
        [move(box(1, 1, 1), t=(0, 0, 0.5)), move(box(4, 4, 1), t=(0, 0, -0.5))], law=law, gap_tolerance=gap_tolerance,
        prune=1e-4, clip_always=clip_always,
    )  # fmt: skip


def drive(w, steps, dt=0.0):
    """Apply displacement increments to the cube; tractions on it after every one (area 1)."""
    out = []
    for step in steps:
        w.shift(0, np.asarray(step, float))
        w.contacts.update(w.x)
        w.forces(dt)
        w.commit()
        out.append(w.resultant(0)[0].copy())
    return np.array(out)


@pytest.mark.parametrize("n", [1, 40])
def test_direct_shear_path(n):
    c = 1e5
    w = halves(coulomb(kn=KN, ks=KS, tan=TAN, c=c, rc=c))
    drive(w, [[0, 0, -SN / KN]])
    tau_max = c + SN * TAN
    tau, dissipated, old = 0.0, 0.0, 0.0
    for target in (4e-4, -4e-4, 4e-4):
        f = drive(w, [[(target - old) / n, 0, 0]] * n)
        trial = tau + KS * (target - old)
        tau = np.clip(trial, -tau_max, tau_max)
        dissipated += tau_max * abs(trial - tau) / KS
        old = target
        np.testing.assert_allclose(-f[-1, 0], tau, rtol=1e-9)
        np.testing.assert_allclose(f[-1, 2], SN, rtol=1e-9)
    np.testing.assert_allclose(w.contacts.friction_work, dissipated, rtol=1e-9)
    np.testing.assert_allclose(w.contacts.energy(), SN**2 / KN / 2 + tau_max**2 / KS / 2, rtol=1e-9)


def test_energy_balance_of_a_shear_cycle():
    w = halves(coulomb(kn=KN, ks=KS, tan=TAN))
    drive(w, [[0, 0, -SN / KN]])
    start, work, last = w.contacts.energy(), 0.0, np.zeros(3)
    last[2] = SN
    path = np.r_[np.full(500, 1e-6), np.full(900, -1e-6), np.full(300, 1e-6)]
    for d in path:
        f = drive(w, [[d, 0, 0]])[0]
        work -= 0.5 * (f[0] + last[0]) * d
        last = f
    stored = w.contacts.energy() - start
    np.testing.assert_allclose(work, stored + w.contacts.friction_work, rtol=1e-3)


def test_cohesion_and_tension_are_lost_for_good():
    w = halves(coulomb(kn=KN, ks=KS, tan=TAN, c=1e5, t=5e4))
    assert (w.contacts.table(w.x)["state"] == 3).all()
    f = drive(w, [[0, 0, 4e4 / KN]])
    np.testing.assert_allclose(f[-1, 2], -4e4, rtol=1e-9)
    assert (w.contacts.table(w.x)["state"] == 0).all()
    assert np.abs(drive(w, [[0, 0, 2e4 / KN]])).max() == 0.0
    f = drive(w, [[0, 0, -(SN + 6e4) / KN], [5e-4, 0, 0]])
    np.testing.assert_allclose(f[-1], [-SN * TAN, 0, SN], rtol=1e-9, atol=1e-3)


def test_residual_friction_after_slip():
    w = halves(coulomb(kn=KN, ks=KS, tan=TAN, rtan=0.2))
    drive(w, [[0, 0, -SN / KN]])
    f = drive(w, [[0.9 * SN * TAN / KS, 0, 0], [1e-3, 0, 0]])
    np.testing.assert_allclose(-f[:, 0], [0.9 * SN * TAN, 0.2 * SN], rtol=1e-9)


def test_bonded_holds_both_ways_and_breaks():
    w = halves(bonded(kn=KN, ks=KS, tan=0.5, shear=2e5, tension=1e5))
    f = drive(w, [[0, 0, 9e4 / KN], [1.9e5 / KS, 0, 0]])
    np.testing.assert_allclose(f[-1], [-1.9e5, 0, -9e4], rtol=1e-9)
    f = drive(w, [[1.1e5 / KS, 0, 0]])
    assert np.abs(f).max() == 0.0
    f = drive(w, [[0, 0, -(9e4 + SN) / KN], [1e-3, 0, 0]])
    np.testing.assert_allclose(f[-1], [-0.5 * SN, 0, SN], rtol=1e-9, atol=1e-3)


def test_bonds_do_not_form_later():
    w = World(
        [move(box(1, 1, 1), t=(0, 0, 0.51)), move(box(4, 4, 1), t=(0, 0, -0.5))], law=bonded(kn=KN, ks=KS), prune=1e-4
    )  # fmt: skip
    drive(w, [[0, 0, -0.0101]] + [[0, 0, 1e-5]] * 12)
    assert np.abs(w.f).max() == 0.0


def test_dilation_lifts_by_its_angle():
    tan_dilation, limit = np.tan(np.radians(10.0)), 3e-4
    w = halves(coulomb(kn=KN, ks=KS, tan=TAN, dil=tan_dilation, dil_limit=limit))
    drive(w, [[0, 0, -SN / KN]])
    f = drive(w, [[1e-6, 0, 0]] * 800)
    np.testing.assert_allclose(f[-1, 2] - SN, KN * tan_dilation * limit, rtol=1e-6)


def test_dashpot_is_a_fraction_of_critical_and_does_not_pull():
    zeta, mass, dt = 0.1, 2500.0, 1e-5
    w = World(
        [move(box(1, 1, 1), t=(0, 0, 0.5)), move(box(4, 4, 1), t=(0, 0, -0.5))], law=coulomb(kn=KN, damping=zeta),
        fixed=[False, True], prune=1e-4,
    )  # fmt: skip
    drive(w, [[0, 0, -1e-4]])
    f = drive(w, [[0, 0, -1e-6]], dt)
    np.testing.assert_allclose(f[-1, 2], KN * 1.01e-4 + 2 * zeta * np.sqrt(KN * mass) * 1e-6 / dt, rtol=1e-9)
    np.testing.assert_allclose(w.contacts.damping_work, 2 * zeta * np.sqrt(KN * mass) * 1e-6**2 / dt, rtol=1e-9)
    assert drive(w, [[0, 0, 0.9e-4]], 1e-7)[-1, 2] == 0.0


def pitched(damping, lift=0.0):
    """Damped cube with a slight pitch, sliding at a constant speed while it moves by `lift` a step; last force."""
    turned = move(box(1, 1, 1), rotation([0, 1, 0], 2e-5), (0, 0, 0.5 - 1e-4))
    w = World(
        [turned, move(box(8, 4, 1), t=(0, 0, -0.5))], law=coulomb(kn=KN, ks=KS, tan=TAN, damping=damping),
        fixed=[False, True], prune=1e-4,
    )  # fmt: skip
    drive(w, [[0, 0, 0]])
    return w, drive(w, [[1e-4, 0, lift]] * 40, 1e-5)[-1]


def test_sliding_along_the_face_is_not_damped():
    """The dashpot feels the rate of the depth, not the motion along the normal of a pitched slave face."""
    (_, free), (w, damped) = pitched(0.0), pitched(0.1)
    np.testing.assert_allclose(damped, free, rtol=1e-12)
    assert abs(w.contacts.damping_work) < 1e-9 * w.contacts.friction_work


@pytest.mark.parametrize("lift", [-1e-6, 1e-6])
def test_friction_counts_the_dashpot(lift):
    """Friction over friction coefficient times the normal force really exerted is 1 while sliding."""
    w, _ = pitched(0.1, lift)
    c = w.contacts
    sliding = (c._state == 2) & (c._align > 0.0)
    assert sliding.any()
    shear = np.linalg.norm(c._traction[sliding, 1:], axis=1)
    np.testing.assert_allclose(shear, TAN * c._traction[sliding, 0] * c._align[sliding], rtol=1e-12)
    assert (np.abs(c._traction[sliding, 0] / -c._gap[sliding] / KN - 1.0) > 1e-3).all()  # the dashpot does work


@pytest.mark.parametrize("shape", ["edge", "corner", "edges"])
def test_friction_capacity_of_unaligned_contacts(shape):
    edge = rotation([0, 1, 0], np.pi / 4)
    corner = np.array([[1, -1, 0], [1, 1, -2], [1, 1, 1]]) / np.sqrt([[2], [6], [3]])
    lower, r = box(4, 4, 1), edge if shape != "corner" else corner
    upper = move(box(1, 1, 1), r)
    if shape == "edges":
        lower, upper = move(box(1, 1, 1), edge), move(box(1, 1, 1), rotation([0, 0, 1], 1.2) @ edge)
    upper = move(upper, t=(0, 0, lower[0][:, 2].max() - upper[0][:, 2].min() - 0.02))
    w = World([upper, lower], law=coulomb(tan=0.5), clip_always=True)
    f = drive(w, [[0, 0, 0]] + [[0, 5e-4, 0]] * 100)
    # CONTACT.md 6: friction capacity of edges and corners 1 +- 0.01
    np.testing.assert_allclose(np.abs(f[-1, 1]) / f[-1, 2], 0.5, rtol=1e-2)


def test_slip_turns_with_the_blocks():
    """Rigid rotation of both blocks turns the forces and changes nothing else."""
    w = halves(coulomb(kn=KN, ks=KS, tan=10.0))
    f0 = drive(w, [[2e-5, 1e-5, -0.5 * SN / KN]])[-1]  # closure well below what brings side strips in
    axis, n = np.array([1.0, 2.0, -0.5]), 200
    r = rotation(axis, 1.0 / n)
    for _ in range(n):
        w.x[:] = w.x @ r.T
        w.contacts.update(w.x)
        w.forces()
        w.commit()
    np.testing.assert_allclose(w.resultant(0)[0], rotation(axis, 1.0) @ f0, rtol=0, atol=1e-8 * np.abs(f0).max())
