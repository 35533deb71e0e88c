"""Linear-strain blocks against closed forms: bending, self weight, homogeneous states, spin, mass matrix."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from bodies import rotation
from verify.meshes import plane
from verify.test_fe_triaxial import COMPLIANCE, POISSON, SCALE, SIZE, STATES, YOUNG
from verify.test_uniform_strain import CORNER, SPIN, alone, box_moment

import fdem

G = 9.81
LINEAR = fdem.LinearStrain()


# bending


LENGTH, DEPTH, WIDTH, LOAD, STIFF = 8.0, 1.0, 1.0, 1e5, 1e10
SECOND = WIDTH * DEPTH**3 / 12


def ritz_tip():
    """Tip deflection of the quadratic displacement field that a clamp at x = 0 allows, nu = 0.

    Every component is x (a + b x + c y + d z): twelve coefficients minimise the energy E/2 (e:e) less the work of the
    parabolic end shear; Gauss quadrature, exact for these polynomials.
    """
    points, weights = np.polynomial.legendre.leggauss(4)

    def fields(x, y, z):
        """Values (4,) and gradients (4, 3) of x, x^2, x y, x z."""
        return np.array([x, x * x, x * y, x * z]), np.array([[1, 0, 0], [2 * x, 0, 0], [y, x, 0], [z, 0, x]])

    K, f = np.zeros((12, 12)), np.zeros(12)
    for (i, wi), (j, wj), (k, wk) in product(zip(points, weights, strict=True), repeat=3):
        x, y, z = LENGTH * (i + 1) / 2, DEPTH * j / 2, WIDTH * (k + 1) / 2
        gradient = fields(x, y, z)[1]
        strain = np.zeros((3, 3, 12))
        for d in range(3):
            for m in range(4):
                g = np.zeros((3, 3))
                g[d] = gradient[m]
                strain[:, :, 4 * d + m] = 0.5 * (g + g.T)
        K += STIFF * LENGTH * DEPTH * WIDTH / 8 * wi * wj * wk * np.einsum("ijm,ijn->mn", strain, strain)
    for (j, wj), (k, wk) in product(zip(points, weights, strict=True), repeat=2):
        y, z = DEPTH * j / 2, WIDTH * (k + 1) / 2
        shear = -LOAD / (2 * SECOND) * (DEPTH**2 / 4 - y * y)
        f[4:8] += DEPTH * WIDTH / 4 * wj * wk * shear * fields(LENGTH, y, z)[0]
    return (np.linalg.solve(K, f)[4:8]) @ fields(LENGTH, 0.0, WIDTH / 2)[0]


def cantilever(turn, size=None):
    """The beam of fe_cantilever as one block, the whole scene turned; displacement of the tip in its own axes."""
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    scene = fdem.Scene(gravity=(0, 0, 0))
    shape = fdem.brick((0, -DEPTH / 2, 0), (LENGTH, DEPTH / 2, WIDTH)).transform(matrix)
    beam = scene.add(shape, fdem.LinearStrain(size), fdem.Elastic(2500, STIFF, 0.0))
    clamp = scene.fix(beam, where=lambda x: np.abs(x @ turn[:, 0]) < 1e-9)
    scene.apply(
        fdem.Traction(lambda x: -LOAD / (2 * SECOND) * (DEPTH**2 / 4 - (x @ turn[:, 1:2]) ** 2) * turn[:, 1]),
        beam,
        where=lambda x: x @ turn[:, 0] > LENGTH - 1e-9,
    )
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-10).converged
    tip = scene.gridpoint(near=turn @ (LENGTH, 0, WIDTH / 2), target=beam)
    assert turn.T @ sim[clamp].force == pytest.approx([0, LOAD, 0], abs=1e-5 * LOAD)
    return sim, beam, turn.T @ sim[tip].displacement


def test_fe_cantilever():
    """Within 2 % of the Ritz value, in fact to the square of the slope; equal to 1e-6 after a turn of 37 degrees."""
    sim, beam, straight = cantilever(np.eye(3))
    ritz = ritz_tip()
    assert ritz == pytest.approx(-0.0155184, rel=1e-3)  # of -0.02064: one block has constant curvature
    assert straight[1] == pytest.approx(ritz, rel=3e-4)  # a slope of 3e-3 shortens by its square
    _, _, turned = cantilever(rotation((1.0, 2.0, -0.7), np.radians(37.0)))
    assert np.abs(turned - straight).max() <= 1e-6 * abs(straight[1])
    _, _, fine = cantilever(np.eye(3), 0.5)
    assert fine[1] == pytest.approx(straight[1], rel=1e-6)  # facets are for contact: the block does not feel them
    # bending stress: M y / I with the mean moment, at the middle of the beam
    (batch,) = sim.model.batches
    place = np.array([[LENGTH / 2, DEPTH / 2, WIDTH / 2]]) - sim.model.origin
    stress = batch.stress_at(sim.state.q, np.array([0]), place)[0]
    assert stress[0] == pytest.approx(LOAD * LENGTH / 2 * DEPTH / 2 / SECOND, rel=1e-2)
    assert np.abs(sim[beam].stress[0]) <= 1e-2 * stress[0]
    assert np.isfinite(sim.mesh().cell_data["stress"]).all()


def test_pure_bending_is_exact():
    """End moments of M: constant curvature M / (E I), no shear, whatever the facets."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    shape = fdem.brick((-LENGTH / 2, -DEPTH / 2, -WIDTH / 2), (LENGTH / 2, DEPTH / 2, WIDTH / 2))
    beam = scene.add(shape, LINEAR, fdem.Elastic(2500, STIFF, 0.0))
    moment = 1e2
    for end in (-1.0, 1.0):
        scene.apply(
            fdem.Traction(lambda x, s=end: np.column_stack([-s * moment / SECOND * x[:, 1], 0 * x[:, :2]])),
            beam,
            where=plane(0, end * LENGTH / 2),
        )
    scene.fix(beam, ("x", "y", "z", "rotation"))
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-11).converged
    B = sim.state.q[3:].reshape(3, 9)
    curvature = moment / (STIFF * SECOND)
    exact = np.zeros((3, 6))
    exact[0, 5], exact[1, 0] = -curvature, curvature  # u_x = -k x y, u_y = k x^2 / 2
    np.testing.assert_allclose(B[:, 3:], exact, atol=1e-6 * curvature)
    np.testing.assert_allclose(B[:, :3], np.eye(3), atol=1e-6 * curvature * LENGTH)
    assert sim.energy.strain == pytest.approx(0.5 * moment**2 * LENGTH / (STIFF * SECOND), rel=1e-6)


# self weight


def column(poisson, confined, scale=1e-4):
    """The column of fe_bar_self_weight, 1e-4 of its weight: linear formulas are good to the strain."""
    scene = fdem.Scene(gravity=(0, 0, -G))
    rock = fdem.Elastic(2500.0 * scale, 1e9, poisson)
    block = scene.add(fdem.brick((0, 0, 0), (2, 2, 10)), LINEAR, rock)
    if confined:
        scene.fix(block, ("x", "y"))
    base = scene.fix(block, "z", where=plane(2, 0.0))
    if not confined:
        scene.fix(scene.gridpoint((0, 0, 0), block), ("x", "y"))
        scene.fix(scene.gridpoint((2, 0, 0), block), "y")
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-8).converged
    return sim, block, base


@pytest.mark.parametrize(("poisson", "confined"), [(0.0, False), (0.25, True)])
def test_fe_bar_self_weight(poisson, confined):
    """One block carries the exact field: settlement rho g L^2 / 2E, stress rho g (L - z), K0, reaction."""
    scale = 1e-4
    sim, block, base = column(poisson, confined, scale)
    modulus = 1e9 * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    places = sim[block].gridpoints - sim[block].gridpoint_displacement
    moved = sim[block].gridpoint_displacement[:, 2]
    z = places[:, 2]
    exact = -2500 * scale * G / modulus * (10 * z - z * z / 2)
    np.testing.assert_allclose(moved, exact, atol=1e-6 * np.abs(exact).max())
    assert sim[base].force[2] == pytest.approx(2500 * scale * G * 40, rel=1e-9)
    (batch,) = sim.model.batches
    heights = np.array([[1.0, 1.0, 0.0], [0.3, 1.8, 4.0], [1.0, 0.0, 10.0]])
    stress = batch.stress_at(sim.state.q, np.zeros(3, int), heights - sim.model.origin)
    np.testing.assert_allclose(stress[:, 2], -2500 * scale * G * (10 - heights[:, 2]), atol=1e-6 * 25 * G)
    if confined:
        np.testing.assert_allclose(stress[:, 0], poisson / (1 - poisson) * stress[:, 2], atol=1e-6 * 25 * G)
    assert sim[block].stress[2] == pytest.approx(-2500 * scale * G * 5, rel=1e-6)


# homogeneous states, in-situ stress


@pytest.mark.parametrize("state", STATES)
def test_state_under_tractions(state):
    """fe_triaxial at 1e-3 of its loads (the formulas are linear): strain, stress, energy to 1e-5, no curvature."""
    stress = np.array(STATES[state], dtype=float)
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(fdem.brick((0, 0, 0), SIZE), LINEAR, fdem.Elastic(2500, YOUNG, POISSON))
    scene.apply(fdem.Traction(SCALE * stress), block)
    scene.fix(block, ("x", "y", "z", "rotation"))
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-11).converged
    strain = COMPLIANCE @ stress
    np.testing.assert_allclose(sim[block].strain / SCALE, strain, atol=1e-5 * np.abs(strain).max())
    np.testing.assert_allclose(sim[block].stress / SCALE, stress, atol=1e-5 * np.abs(stress).max())
    assert sim.energy.strain / SCALE**2 == pytest.approx(0.5 * stress @ strain * SIZE.prod(), rel=2e-5)
    assert np.abs(sim.state.q[3:].reshape(3, 9)[:, 3:]).max() <= 1e-9 * SCALE * np.abs(strain).max()


def test_in_situ_stress_field():
    """A stress that varies linearly is carried place by place, in a body that is not convex as well."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(fdem.prism(CORNER, 1.0, axis="z"), LINEAR, fdem.Elastic(2500, 1e10, 0.25))

    def field(x):
        return -1e5 * (1 + x[:, 2] + 0.5 * x[:, 0])

    scene.apply(fdem.Stress(zz=field, k=(0.5, 0.7)))
    sim = fdem.Simulation(scene, fdem.Explicit(), progress=False)
    places = np.array([[0.2, 0.3, 0.1], [1.7, 0.5, 0.9], [0.4, 1.6, 0.5]])
    (batch,) = sim.model.batches
    stress = batch.stress_at(sim.state.q, np.zeros(3, int), places - sim.model.origin)
    np.testing.assert_allclose(stress[:, 2], field(places), rtol=1e-10)
    np.testing.assert_allclose(stress[:, 1], 0.7 * field(places), rtol=1e-10)
    mean = [-1e5 * (box_moment((0, 0, 0)) + box_moment((0, 0, 1)) + 0.5 * box_moment((1, 0, 0))) / 3.0]
    assert sim[block].stress[2] == pytest.approx(mean[0], rel=1e-12)


# spin


def test_dda_false_expansion():
    """Free fall and two turns of the oracle's cube: volume, centroid, angle, momentum."""
    velocity, g, density, young = np.array([1.0, 0, 5.0]), np.array([0, 0, -G]), 2000.0, 1e10
    shape = fdem.brick((-0.5,) * 3, (0.5,) * 3)
    given = dict(velocity=velocity, angular_velocity=(0, 0, SPIN), gravity=g)
    sim, block = alone(shape, density, young=young, poisson=0.25, body=LINEAR, **given)
    momentum = sim[block].angular_momentum
    sim.run(time=1.0)
    volume = sim.history(lambda s: s.model.batches[0]._volumes(s.model.batches[0]._gradients(s.state.q))[0], every=5)
    sim.run(time=1.0)
    # the oracle's 1e-8 + rho w^2 a^2 / (12 E), of the mean over the last turn
    grown = density * SPIN**2 / (12 * young)
    assert abs(np.mean(volume.values) - 1.0) <= 1e-8 + grown
    assert np.linalg.norm(sim[block].rotation_vector) == pytest.approx(2 * SPIN, abs=1e-4)
    np.testing.assert_allclose(sim[block].position, velocity * 2 + 0.5 * g * 4, atol=1e-10)
    change = sim[block].angular_momentum - momentum
    assert np.linalg.norm(change) <= 1e-12 * np.linalg.norm(momentum)
    assert sim.energy.closure <= 1e-8


@pytest.mark.parametrize("degrees", [30, 90, 180, 720])
def test_imposed_rotations_make_no_stress(degrees):
    """fe_rigid_rotation: stress <= 1e-12 E, volume 1."""
    sim, block = alone(fdem.brick((0, 0, 0), (1, 1, 1)), 2000.0, young=1e9, body=LINEAR)
    (batch,) = sim.model.batches
    R = rotation((1, 2, 2), np.radians(degrees))
    sim.state.q[3:].reshape(3, 9)[:, :3] = R
    batch.place(sim.state.q, sim.state.x)
    assert np.abs(sim[block].stress).max() <= 1e-12 * 1e9
    assert batch._volumes(batch._gradients(sim.state.q))[0] == pytest.approx(1.0, abs=1e-14)
    f = np.zeros(30)
    batch.internal(sim.state.q, sim.state.x, f)
    assert np.abs(f).max() <= 1e-12 * 1e9


# masses


@pytest.mark.parametrize("varies", [False, True])
def test_mass_matrix_from_moments_of_degree_four(varies):
    """All moments of the L-prism from closed forms; the density of degree 1 is exact too."""

    def density(x):
        return 1000.0 * (1 + x[:, 0])

    shape = fdem.prism(CORNER, 1.0, axis="z")
    sim, block = alone(shape, density if varies else 1000.0, body=LINEAR)

    def moment(i, j, k):
        return 1000.0 * (box_moment((i, j, k)) + (box_moment((i + 1, j, k)) if varies else 0.0))

    unit = np.eye(3, dtype=int)
    mass = moment(0, 0, 0)
    centre = np.array([moment(*a) for a in unit]) / mass
    assert sim[block].mass == pytest.approx(mass, rel=1e-12)
    np.testing.assert_allclose(sim[block].position, centre, rtol=1e-12)

    def central(exponents):
        """Moment about the centre by binomial expansion."""
        total = 0.0
        for powers in product(*(range(n + 1) for n in exponents)):
            factor = np.prod(
                [_choose(n, p) * (-c) ** (n - p) for n, p, c in zip(exponents, powers, centre, strict=True)]
            )
            total += factor * moment(*powers)
        return total

    places = [*unit, *(2 * unit), unit[1] + unit[2], unit[2] + unit[0], unit[0] + unit[1]]
    halves = [1, 1, 1, 0.5, 0.5, 0.5, 1, 1, 1]
    means = np.array([h * central(tuple(p)) / mass for p, h in zip(places, halves, strict=True)])
    exact = np.array(
        [
            [hp * hq * central(tuple(p + q)) - mp * mq * mass for q, hq, mq in zip(places, halves, means, strict=True)]
            for p, hp, mp in zip(places, halves, means, strict=True)
        ]
    )
    have = sim.model.batches[0].moments[0]
    np.testing.assert_allclose(have, exact, atol=1e-12 * mass * 16)
    M = sim[block].generalised_mass
    assert M.shape == (30, 30) and np.linalg.eigvalsh(M).min() > 0
    np.testing.assert_allclose(M[:12, :12][:3, :3], mass * np.eye(3), rtol=1e-12)


def _choose(n, k):
    return float(np.prod([(n - i) / (i + 1) for i in range(k)]))
