"""Contacts as a whole: idempotence, restart, sliding over facets, impacts, stiffness rows, detection."""

from __future__ import annotations

import numpy as np
import pytest
from contact_tools import Flight, World, box, coulomb, grid_box, move, prism, rotation

from fdem.contact.response import slip_energies
from fdem.contact.table import whole_points
from fdem.errors import CheckpointError, SceneError
from fdem.kernels import patches as kernels


def pushed(law=None, **options):
    """A cube pressed and sheared into a triangulated floor."""
    floor = grid_box(6, 6, size=(3.0, 3.0, 1.0))
    options.setdefault("prune", 1e-4)
    return World(
        [move(box(1, 1, 1), t=(1.3, 1.4, 1.5 - 1e-4)), floor], law=law or coulomb(tan=0.5), affine=[True, False],
        fixed=[False, True], **options,
    )  # fmt: skip


def test_forces_may_be_repeated():
    w = pushed()
    w.shift(0, [1e-4, 0, 0])
    first = w.forces(1e-4).copy()
    np.testing.assert_array_equal(w.forces(1e-4), first)
    w.commit()
    assert w.contacts.energy() > 0.0


def test_restart_bit_for_bit():
    def walk(w, n, g):
        out = []
        for _ in range(n):
            w.shift(0, g.normal(size=3) * [2e-3, 2e-3, 1e-6])
            w.contacts.update(w.x)
            out.append(w.forces(1e-4).copy())
            w.commit()
        return np.array(out)

    a = pushed()
    walk(a, 15, np.random.default_rng(0))
    b = pushed()
    b.contacts.restore({k: v.copy() for k, v in a.contacts.state_arrays().items()})
    b.x[:], b.x_old[:] = a.x, a.x_old
    assert b.contacts.energy() == a.contacts.energy()
    fa, fb = walk(a, 15, np.random.default_rng(1)), walk(b, 15, np.random.default_rng(1))
    np.testing.assert_array_equal(fa, fb)
    np.testing.assert_array_equal(a.contacts.work, b.contacts.work)
    assert a.contacts.n_cuts == b.contacts.n_cuts
    with pytest.raises(CheckpointError):
        b.contacts.restore({})


def test_sliding_over_facets_is_smooth():
    w = pushed()
    w.forces()
    w.commit()
    n0 = w.resultant(0)[0][2]
    ratio, noise, cuts = [], [], w.contacts.n_cuts
    for _ in range(2000):
        w.shift(0, [3e-4, 1e-4, 0])
        w.contacts.update(w.x)
        w.forces(1e-4)
        w.commit()
        f = w.resultant(0)[0]
        ratio.append(np.hypot(f[0], f[1]) / (0.5 * f[2]))
        noise.append(abs(f[2] / n0 - 1))
    assert w.contacts.n_cuts > cuts + 100
    assert max(noise) < 2e-2  # frozen patches: motion since the clip over their size
    assert min(ratio[100:]) > 0.98 and max(ratio) < 1 + 1e-9


def test_sliding_over_facets_cut_every_step():
    w = pushed(clip_always=True, prune=0.0)
    w.forces()
    w.commit()
    n0 = w.resultant(0)[0][2]
    ratio, noise = [], []
    for _ in range(300):
        w.shift(0, [3e-4, 1e-4, 0])
        w.contacts.update(w.x)
        w.forces(1e-4)
        w.commit()
        f = w.resultant(0)[0]
        ratio.append(np.hypot(f[0], f[1]) / (0.5 * f[2]))
        noise.append(abs(f[2] / n0 - 1))
    assert max(noise) < 1e-11
    assert min(ratio[50:]) > 0.999 and max(ratio) < 1 + 1e-9


def test_a_block_arrives_beside_and_above():
    """Patches exist before blocks touch, whichever way they come."""
    floor = box(1, 1, 1)
    w = World([move(box(1, 1, 1), t=(1.05, 0, 1.0 - 1e-3)), floor], law=coulomb(), prune=1e-4)
    for _ in range(400):
        w.shift(0, [-5e-4, 0, 0])
        w.contacts.update(w.x)
        w.forces(1e-3)
        w.commit()
        # overlap of the two squares, less the corner cells of the master
        width = max(0.0, 1.0 - w.x[w.start[0] : w.start[1], 0].mean())
        f = w.resultant(0)[0][2]
        assert abs(f - 1e9 * 1e-3 * width) < 1e6 * 4e-3
    w = World([move(box(1, 1, 1), t=(0, 0, 1.2)), floor], law=coulomb(), prune=1e-4)
    for _ in range(202):
        w.shift(0, [0, 0, -1e-3])
        w.contacts.update(w.x)
    # kn A times 2 mm; the fresh cut gives a rim as wide as the closure (0.4 %) to the side faces
    np.testing.assert_allclose(w.forces()[:8].sum(0)[2], 1e9 * 2e-3, rtol=1e-2)


@pytest.mark.parametrize(("shape", "seed"), [("cube", 2), ("L", 1)])
def test_frictionless_impact_keeps_energy_and_momentum(shape, seed):
    g = np.random.default_rng(seed)
    make = {"cube": box(1, 1, 1), "L": prism([[0, 0], [1, 0], [1, 0.4], [0.4, 0.4], [0.4, 1], [0, 1]], 0.5)}[shape]
    make = (make[0] - [0.4, 0.4, 0.25] if shape == "L" else make[0], make[1])
    kn, speed = 1e9, 2.0
    turns = [rotation(g.normal(size=3), g.uniform(0, 3)) for _ in range(2)]
    a = move(make, turns[0])
    b = move(make, turns[1], (0.0, 0.0, 1.75))
    w = World([a, b], law=coulomb(kn=kn), clip_always=True)
    flight = Flight(w, [[0, 0, speed / 2], [0, 0, -speed / 2]], [g.normal(size=3) * 0.5 for _ in range(2)])
    e0, (p0, h0) = flight.kinetic(), flight.momentum()
    dt = 0.1 * np.sqrt(flight.m[0] / 2 / kn)
    hit, apart = False, 0
    for _ in range(4000):
        w.forces(dt)
        busy = w.contacts.n_patches > 0
        closed = busy and bool((w.contacts._area > 0).any())
        hit |= closed
        apart = apart + 1 if hit and not closed else 0
        if apart > 20:
            break
        flight.step(dt if busy else 5 * dt)
    assert hit and apart > 20
    p, h = flight.momentum()
    scale = flight.m[0] * speed
    assert abs(flight.kinetic() / e0 - 1) < 1e-8
    assert np.abs(p - p0).max() < 1e-11 * scale
    assert np.abs(h - h0).max() < 1e-11 * scale


def test_stiffness_rows_reproduce_forces():
    w = pushed(coulomb(tan=0.0), prune=0.0)
    gp, wt, frame, kn, _ = w.contacts.stiffness(w.x)
    u = np.zeros_like(w.x)
    u[:8] = [0, 0, -1e-7]
    facing = np.abs(frame[:, 0, 2]) > 0.99
    area = kn[facing].sum() / 1e9
    np.testing.assert_allclose(area, 1.0, rtol=1e-3)
    motion = np.einsum("ij,ijk->ik", wt, u[gp])
    np.testing.assert_allclose(motion[facing], np.tile([0, 0, 1e-7], (facing.sum(), 1)), atol=1e-18)
    assert np.abs(np.einsum("ij,ijk->ik", wt, w.x[gp])).max() < 1e-13
    k = w.contacts.potential_k_gp(w.x, w.contacts._mobile_gp)
    assert k[8:].max() == 0.0
    assert k.sum() >= kn[facing].sum()


def test_table_sums_to_the_forces():
    w = pushed()
    w.shift(0, [1e-4, 2e-5, 0])
    w.contacts.update(w.x)
    w.forces(1e-4)
    w.commit()
    t = w.contacts.table(w.x)
    np.testing.assert_allclose(t["force"].sum(0), w.resultant(1)[0], rtol=1e-9, atol=1e-3)
    assert (t["block_a"] == 0).all() and (t["block_b"] == 1).all()
    facing = (w.contacts.patches.flags[t["patch"]] & kernels.FACING) > 0
    np.testing.assert_allclose(t["normal"][facing][:, 2], -1.0, atol=1e-9)
    assert set(np.unique(t["state"])) <= {1, 2, 3}


def test_preload_carries_a_stress():
    w = World(
        [move(box(1, 1, 1), t=(0, 0, 1)), box(4, 4, 1)],
        law=coulomb(kn=1e10, ks=5e9, tan=0.6),
        gap_tolerance=None,
        prune=1e-4,
    )
    points = whole_points(w.contacts.patches, w.x)
    stress = np.zeros((len(points), 6))
    stress[:, 2] = -2e6 * (1 + 0.1 * points[:, 0])
    stress[:, 4] = 3e5
    w.contacts.preload(w.x, stress)
    w.forces()
    force, moment = w.resultant(0, (0, 0, 0.5))
    np.testing.assert_allclose(force, [-3e5, 0, 2e6], rtol=1e-9, atol=1e-3)
    np.testing.assert_allclose(moment[1], -2e5 / 12, rtol=1e-6)


def test_slip_energy_of_vanished_patches_is_dissipated():
    w = pushed(coulomb(tan=10.0))
    w.forces()
    w.commit()
    w.shift(0, [2e-5, 0, 0])
    w.contacts.update(w.x)
    w.forces(1e-4)
    w.commit()
    slip = slip_energies(w.contacts).sum()
    # 1/2 ks A s^2; the area in contact is that of the cut, less its rim
    np.testing.assert_allclose(slip, 0.5 * 5e8 * 2e-5**2, rtol=1e-2)
    assert w.contacts.friction_work == 0.0
    w.shift(0, [0, 0, 1.0])
    w.contacts.update(w.x)
    w.forces(1e-4)
    w.commit()
    assert w.contacts.energy() == 0.0
    np.testing.assert_allclose(w.contacts.friction_work, slip, rtol=1e-6)


def test_side_strips_of_a_resting_block_cause_no_cuts():
    """A block that settles by less than what its side strips could weigh is cut once for them, not all the way."""
    w = pushed(gap_tolerance=1e-2)
    for _ in range(200):
        w.shift(0, [0, 0, -1e-6])
        w.contacts.update(w.x)
        w.forces(1e-4)
        w.commit()
    assert w.contacts.n_cuts <= 4


def test_fixed_pairs_and_filtered_pairs_are_not_listed():
    shapes = [box(1, 1, 1), move(box(1, 1, 1), t=(0, 0, 1)), move(box(1, 1, 1), t=(0, 0, 2))]
    w = World(shapes, fixed=[True, True, False], gap_tolerance=None)
    assert w.contacts.pairs.tolist() == [[1, 2]]
    w = World(shapes, gap_tolerance=None, may_touch=lambda a, b: a + b != 3)
    assert w.contacts.pairs.tolist() == [[0, 1]]


def test_unknown_law_is_refused():
    from fdem.contact.contacts import LawTable

    with pytest.raises(SceneError, match="hertz"):
        LawTable("hertz", [[1.0, 1.0]])
