"""Rigid blocks: kernels against NumPy, exact tops, momentum, energy, stability bound."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import eigh
from stress.top import Top

from fdem.blocks.rigid import RigidBlocks
from fdem.errors import SceneError

CORNERS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) / 2.0


def box_inertia(edges, density=1.0):
    """Mass and principal moments of a box."""
    a, b, c = edges
    m = density * a * b * c
    return m, m / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])


def make(edges, density=1000.0, centroid=(0.0, 0.0, 0.0), turn=None, offset=0):
    """One rigid box and its q, v; `offset` other gridpoints, coordinates and unknowns come before it."""
    edges, centroid = np.asarray(edges, float), np.asarray(centroid, float)
    turn = np.eye(3) if turn is None else turn
    m, moments = box_inertia(edges, density)
    x = np.concatenate([np.zeros((offset, 3)), centroid + (CORNERS * edges) @ turn.T])
    blocks = RigidBlocks(
        x,
        np.array([offset, offset + 8]),
        np.array([m]),
        (turn * moments) @ turn.T[None],
        centroid[None],
        slice(offset, offset + 6),
        slice(offset, offset + 7),
        slice(offset, offset + 8),
    )
    q = np.zeros(offset + 7)
    blocks.start(q)
    return blocks, q, np.zeros(offset + 6), x


def random_batch(n=7, offset=5, seed=0):
    """Boxes of random shape, attitude and motion."""
    rng = np.random.default_rng(seed)
    x, start, mass, inertia, centroid = [rng.normal(size=(offset, 3))], [offset], [], [], []
    for _ in range(n):
        edges = rng.uniform(0.3, 2.0, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        m, moments = box_inertia(edges, 2500.0)
        c = rng.normal(size=3)
        points = np.concatenate([CORNERS, rng.uniform(-0.5, 0.5, (rng.integers(1, 4), 3))])
        x.append(c + (points * edges) @ turn.T)
        start.append(start[-1] + len(points))
        mass.append(m)
        inertia.append((turn * moments) @ turn.T)
        centroid.append(c)
    x = np.concatenate(x)
    blocks = RigidBlocks(
        x,
        np.array(start),
        np.array(mass),
        np.array(inertia),
        np.array(centroid),
        slice(3, 3 + 6 * n),
        slice(2, 2 + 7 * n),
        slice(offset, len(x)),
    )
    q, v = rng.normal(size=2 + 7 * n), rng.normal(size=3 + 6 * n)
    own = q[2:].reshape(n, 7)
    own[:, 3:] /= np.linalg.norm(own[:, 3:], axis=1)[:, None]
    return blocks, q, v, x, np.array(start), np.array(mass), np.array(inertia), np.array(centroid), rng


def rotation_of(axis, angle):
    """Rotation by `angle` about `axis` (Rodrigues)."""
    n = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


TILT = rotation_of((1.0, 2.0, -0.5), 0.7)


def test_place_push_pull_against_numpy():
    blocks, q, v, x0, start, _, _, centroid, rng = random_batch()
    x, xdot, f = np.full_like(x0, np.nan), np.full_like(x0, np.nan), rng.normal(size=v.shape)
    f_gp, before = rng.normal(size=x.shape), f.copy()
    blocks.place(q, x)
    blocks.push(q, v, xdot)
    blocks.pull(q, f_gp, f)
    turn, own = blocks.rotation(q), q[2:].reshape(-1, 7)
    assert np.isnan(x[:5]).all() and np.isnan(xdot[:5]).all()
    assert_array_equal(f[:3], before[:3])
    for b, (lo, hi) in enumerate(pairwise(start)):
        w, vec = own[b, 3], own[b, 4:]
        k = np.array([[0, -vec[2], vec[1]], [vec[2], 0, -vec[0]], [-vec[1], vec[0], 0]])
        assert_allclose(turn[b], np.eye(3) + 2 * w * k + 2 * k @ k, atol=1e-15)
        arm = (x0[lo:hi] - centroid[b]) @ turn[b].T
        assert_allclose(x[lo:hi], own[b, :3] + arm, atol=1e-14)
        velocity = v[3 + 6 * b : 9 + 6 * b]
        assert_allclose(xdot[lo:hi], velocity[:3] + np.cross(velocity[3:], arm), atol=1e-14)
        load = np.concatenate([f_gp[lo:hi].sum(0), np.cross(arm, f_gp[lo:hi]).sum(0)])
        assert_allclose((f - before)[3 + 6 * b : 9 + 6 * b], load, atol=1e-13)
    power = np.sum(f_gp[5:] * xdot[5:])
    assert power == pytest.approx((f - before) @ v, rel=1e-13)


def test_accelerate_inverts_the_generalised_mass():
    blocks, q, v, _, _, mass, inertia, _, rng = random_batch(seed=1)
    f, a, b = rng.normal(size=v.shape), np.zeros_like(v), np.zeros_like(v)
    blocks.accelerate(q, f, a)
    matrix, turn = blocks.generalised_mass(q), blocks.rotation(q)
    assert_allclose(matrix[:, 3:, 3:], turn @ inertia @ turn.transpose(0, 2, 1), rtol=1e-13, atol=1e-11)
    assert_allclose(np.einsum("nij,nj->ni", matrix, a[3:].reshape(-1, 6)), f[3:].reshape(-1, 6), atol=1e-13)
    scale = rng.uniform(0.5, 5.0, len(mass))
    blocks.accelerate(q, f, b, scale)
    assert_allclose(b[3:].reshape(-1, 6) * scale[:, None], a[3:].reshape(-1, 6), rtol=1e-14)
    velocity = v[3:].reshape(-1, 6)
    assert blocks.kinetic(q, v) == pytest.approx(0.5 * np.einsum("ni,nij,nj", velocity, matrix, velocity), rel=1e-13)
    assert_allclose(blocks.angular_momentum(q, v), np.einsum("nij,nj->ni", matrix, velocity)[:, 3:], rtol=1e-11)


def test_weight_and_potential_agree():
    blocks, q, v, _, _, mass, _, _, _ = random_batch(seed=2)
    g, f = np.array([1.0, -2.0, -9.0]), np.zeros_like(v)
    blocks.weight(g, f)
    assert_array_equal(f[3:].reshape(-1, 6)[:, :3], mass[:, None] * g)
    assert_array_equal(f[3:].reshape(-1, 6)[:, 3:], 0.0)
    assert blocks.potential(g, np.zeros((0, 3)), q) == pytest.approx(
        -np.sum(f[3:].reshape(-1, 6)[:, :3] * q[2:].reshape(-1, 7)[:, :3])
    )
    assert blocks.strain_energy(q, np.zeros((0, 3))) == 0.0


def test_advance_agrees_with_push_to_second_order():
    blocks, q, v, x, *_ = random_batch(seed=3)
    errors = []
    for dt in (1e-3, 5e-4):
        x0, x1, xdot = (np.zeros_like(x) for _ in range(3))
        moved, new = q.copy(), v.copy()
        blocks.place(moved, x0)
        blocks.push(moved, new, xdot)
        blocks.advance(moved, new, dt)
        blocks.place(moved, x1)
        errors.append(np.abs(x1 - x0 - dt * xdot).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.02)


def test_a_block_that_only_translates_keeps_its_orientation_to_the_last_bit():
    blocks, q, v, x = make((3.0, 2.0, 1.0), centroid=(0.1, 0.2, 0.3), turn=TILT)
    placed = np.empty_like(x)
    blocks.place(q, placed)
    assert_array_equal(placed, x)
    v[:3] = (0.1, -3.0, 0.7)
    for _ in range(1000):
        blocks.advance(q, v, 1e-3)
    assert_array_equal(q[3:], (1.0, 0.0, 0.0, 0.0))
    assert_array_equal(v, (0.1, -3.0, 0.7, 0.0, 0.0, 0.0))
    assert_allclose(q[:3], np.array([0.1, 0.2, 0.3]) + v[:3], rtol=1e-12)


@pytest.mark.parametrize("turn", [np.eye(3), TILT], ids=["aligned", "tilted"])
def test_rigid_free_asymmetric_top(turn):
    """Oracle case `rigid_free_asymmetric_top`; also with body axes that are not the global ones."""
    blocks, q, v, _ = make((3.0, 2.0, 1.0), turn=turn)
    top = Top(box_inertia((3.0, 2.0, 1.0), 1000.0)[1], (0.6, 0.1, 1.0))
    assert_allclose(np.sort(blocks.moments[0]), [2500.0, 5000.0, 6500.0], rtol=1e-14)
    assert top.period == pytest.approx(9.661403862339652, rel=1e-12)
    v[3:] = turn @ (0.6, 0.1, 1.0)
    momentum, energy = blocks.angular_momentum(q, v)[0], blocks.kinetic(q, v)
    assert energy == pytest.approx(3725.0, rel=1e-13)
    assert_allclose(momentum, turn @ (1500.0, 500.0, 6500.0), rtol=1e-13)
    step = 0
    for t in (1.0, 5.0, 20.0):
        while step < round(t * 1000):
            blocks.advance(q, v, 1e-3)
            step += 1
        rotation = blocks.rotation(q)[0]
        # fourth order: far below the 1e-4 that a scheme of second order is allowed
        assert_allclose(turn.T @ rotation.T @ v[3:], top.omega(t), atol=1e-10)
        assert_allclose(turn.T @ rotation @ turn, top.rotation(t), atol=1e-10)
        assert blocks.kinetic(q, v) == pytest.approx(energy, rel=1e-12)
        assert_allclose(blocks.angular_momentum(q, v)[0], momentum, atol=1e-13 * np.linalg.norm(momentum))


def test_order_of_the_free_top():
    top = Top(box_inertia((3.0, 2.0, 1.0), 1000.0)[1], (0.6, 0.1, 1.0))
    exact, errors = top.rotation(5.0), []
    for n in (50, 100, 200):
        blocks, q, v, _ = make((3.0, 2.0, 1.0))
        v[3:] = (0.6, 0.1, 1.0)
        for _ in range(n):
            blocks.advance(q, v, 5.0 / n)
        errors.append(np.abs(blocks.rotation(q)[0] - exact).max())
    assert np.log2(errors[0] / errors[1]) > 3.8 and np.log2(errors[1] / errors[2]) > 3.8


def test_rigid_symmetric_top():
    """Oracle case `rigid_symmetric_top`: the axis turns about L at the rate L / I."""
    blocks, q, v, _ = make((1.0, 1.0, 4.0), density=2500.0)
    transverse, axial = 14166.666666666668, 1666.6666666666667
    v[3:] = (0.5, 0.0, 4.0)
    momentum = blocks.angular_momentum(q, v)[0]
    assert_allclose(momentum, [0.5 * transverse, 0.0, 4.0 * axial], rtol=1e-13)
    length = np.linalg.norm(momentum)
    cone = np.arccos(momentum[2] / length)
    assert cone == pytest.approx(0.8156919233162233, rel=1e-12)
    for step in range(1, 30001):
        blocks.advance(q, v, 1e-3)
        if step % 5000 == 0:
            axis = blocks.rotation(q)[0, :, 2]
            exact = rotation_of(momentum, length / transverse * step * 1e-3)[:, 2]
            assert np.linalg.norm(axis - exact) < 1e-9
            assert np.arccos(axis @ momentum / length) == pytest.approx(cone, abs=1e-12)
            assert_allclose(blocks.angular_momentum(q, v)[0], momentum, atol=1e-13 * length)
    axis_end = [0.5876397843591656, -0.7166446376366645, 0.37563272911838663]
    assert_allclose(blocks.rotation(q)[0, :, 2], axis_end, atol=1e-9)
    body = blocks.rotation(q)[0].T @ v[3:]
    assert_allclose(body, [0.2981961406530162, 0.40134656059277074, 4.0], atol=1e-9)


def spin(periods):
    """S24 of the stress list: errors of energy, momentum, norm and phase after so many periods at dt = T / 500."""
    top = Top(box_inertia((3.0, 2.0, 1.0), 1000.0)[1], (0.6, 0.1, 1.0))
    blocks, q, v, _ = make((3.0, 2.0, 1.0))
    v[3:] = (0.6, 0.1, 1.0)
    momentum, energy = blocks.angular_momentum(q, v)[0], blocks.kinetic(q, v)
    worst = np.zeros(3)
    for _ in range(periods):
        for _ in range(500):
            blocks.advance(q, v, top.period / 500)
        worst = np.maximum(
            worst,
            [
                abs(blocks.kinetic(q, v) / energy - 1),
                np.linalg.norm(blocks.angular_momentum(q, v)[0] - momentum) / np.linalg.norm(momentum),
                abs(np.linalg.norm(q[3:]) - 1),
            ],
        )
    body = blocks.rotation(q)[0].T @ v[3:]
    nutation = np.linalg.norm(body - top.omega(periods * top.period)) / (top.rate * np.linalg.norm(body))
    return (*worst, nutation, blocks.rotation(q)[0], top)


def test_spin_of_a_thousand_periods():
    """S24 with the bound that it gives to schemes of fourth order: phase within 1e-4 of a turn."""
    energy, momentum, norm, nutation, rotation, top = spin(1000)
    assert energy < 1e-11 and momentum < 1e-12 and norm < 1e-14
    angle = np.arccos(np.clip((np.trace(rotation.T @ top.rotation(1000 * top.period)) - 1) / 2, -1, 1))
    assert angle < 1e-4 * 2 * np.pi and nutation < 1e-4 * 2 * np.pi


def test_steps_of_several_turns_keep_energy_and_momentum():
    blocks, q, v, _ = make((10.0, 0.2, 0.1), turn=TILT)
    v[3:] = (300.0, -40.0, 25.0)
    momentum, energy = blocks.angular_momentum(q, v)[0], blocks.kinetic(q, v)
    for _ in range(200):
        blocks.advance(q, v, 0.1)
    assert blocks.kinetic(q, v) == pytest.approx(energy, rel=1e-11)
    assert_allclose(blocks.angular_momentum(q, v)[0], momentum, atol=1e-13 * np.linalg.norm(momentum))


def test_advance_is_reversible():
    blocks, q, v, _, *_ = random_batch(seed=4)
    q0, v0 = q.copy(), v.copy()
    blocks.advance(q, v, 0.05)
    blocks.advance(q, v, -0.05)
    assert_allclose(q, q0, atol=1e-13)
    assert_allclose(v, v0, atol=1e-12)


def test_a_moment_adds_its_impulse_to_the_momentum():
    """Leapfrog on a spinning block: L changes by the sum of dt T, also where T turns with the block."""
    blocks, q, v, x, _, _, _, _, rng = random_batch(n=3, seed=5)
    f, a, f_gp = np.zeros_like(v), np.zeros_like(v), np.zeros_like(x)
    f_gp[5:] = 500.0 * rng.normal(size=x[5:].shape)
    expected = blocks.angular_momentum(q, v)
    for _ in range(300):
        f[:] = 0.0
        blocks.pull(q, f_gp, f)
        blocks.accelerate(q, f, a)
        v += 1e-3 * a
        expected = expected + 1e-3 * f[3:].reshape(-1, 6)[:, 3:]
        blocks.advance(q, v, 1e-3)
    assert_allclose(blocks.angular_momentum(q, v), expected, rtol=1e-11)


def test_rotation_vector():
    blocks, q, _, _ = make((1.0, 2.0, 3.0))
    assert_array_equal(blocks.rotation_vector(q), 0.0)
    axis = np.array([1.0, -2.0, 2.0]) / 3.0
    for angle in (1e-12, 0.3, 3.0):
        q[3:] = np.r_[np.cos(angle / 2), np.sin(angle / 2) * axis]
        assert_allclose(blocks.rotation_vector(q)[0], angle * axis, rtol=1e-14)
        q[3:] *= -1
        assert_allclose(blocks.rotation_vector(q)[0], angle * axis, rtol=1e-14)
        assert_allclose(blocks.rotation(q)[0], rotation_of(axis, angle), atol=1e-15)


def test_frequency_bound_is_the_generalised_eigenvalue():
    blocks, q, v, x0, start, _, _, _, rng = random_batch(seed=6)
    k, x = rng.uniform(0.0, 1e8, len(x0)), np.zeros_like(x0)
    blocks.place(q, x)
    bound, matrix = blocks.frequency_bound(q, x, k), blocks.generalised_mass(q)
    for b, (lo, hi) in enumerate(pairwise(start)):
        columns = []
        for j in range(6):
            unit, xdot = np.zeros_like(v), np.zeros_like(x0)
            unit[3 + 6 * b + j] = 1.0
            blocks.push(q, unit, xdot)
            columns.append(xdot[lo:hi].ravel())
        p = np.array(columns).T
        exact = eigh(p.T @ (np.repeat(k[lo:hi], 3)[:, None] * p), matrix[b], eigvals_only=True)[-1]
        assert bound[b] == pytest.approx(exact, rel=1e-12)
    scale = blocks.relaxation_mass(q, x, k)
    assert_array_equal(scale, bound)


def test_relaxation_mass_of_blocks_without_contacts():
    blocks, q, _, x0, start, *_ = random_batch(seed=7)
    assert_array_equal(blocks.relaxation_mass(q, x0, np.zeros(len(x0))), 1.0)
    k = np.zeros(len(x0))
    k[: start[2]] = 1e6
    scale = blocks.relaxation_mass(q, x0, k)
    assert (scale[2:] == scale[:2].max()).all()


@pytest.mark.parametrize("factor", [2.0**10, 2.0**-10])
def test_same_bits_at_another_unit_of_length(factor):
    def run(unit):
        rng = np.random.default_rng(8)
        edges, c = unit * np.array([3.0, 1.5, 0.7]), unit * np.array([0.3, 0.1, -0.2])
        blocks, q, v, x = make(edges, density=2500.0 / unit**3, centroid=c, turn=TILT)
        v[:3], v[3:] = unit * rng.normal(size=3), rng.normal(size=3)
        f, a, f_gp = np.zeros(6), np.zeros(6), unit * 1e3 * rng.normal(size=x.shape)
        for _ in range(50):
            f[:] = 0.0
            blocks.pull(q, f_gp, f)
            blocks.accelerate(q, f, a)
            v += 1e-3 * a
            blocks.advance(q, v, 1e-3)
        blocks.place(q, x)
        return x / unit, q[3:], v[3:], blocks.frequency_bound(q, x, np.arange(8.0))

    for a, b in zip(run(1.0), run(factor), strict=True):
        assert_array_equal(a, b)


@pytest.mark.parametrize("field", ["mass", "inertia"])
@pytest.mark.parametrize("value", [-1.0, 0.0, np.nan, np.inf])
def test_bad_mass_properties_name_block_and_field(field, value):
    mass, inertia = np.ones(2), np.tile(np.eye(3), (2, 1, 1))
    (mass if field == "mass" else np.einsum("nii->ni", inertia))[1] = value
    with pytest.raises(SceneError, match=f"block 1: {field}"):
        RigidBlocks(
            np.zeros((8, 3)),
            np.array([0, 4, 8]),
            mass,
            inertia,
            np.zeros((2, 3)),
            slice(0, 12),
            slice(0, 14),
            slice(0, 8),
        )


def test_a_batch_without_blocks():
    blocks = RigidBlocks(
        np.zeros((0, 3)),
        np.zeros(1, int),
        np.zeros(0),
        np.zeros((0, 3, 3)),
        np.zeros((0, 3)),
        slice(0, 0),
        slice(0, 0),
        slice(0, 0),
    )
    empty = np.zeros(0)
    blocks.advance(empty, empty, 0.1)
    assert blocks.kinetic(empty, empty) == 0.0
    assert blocks.frequency_bound(empty, np.zeros((0, 3)), empty).shape == (0,)
