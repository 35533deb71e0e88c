"""Uniform-strain blocks against closed forms: moments, mass matrix, spin, block on a joint, homogeneous states."""

from __future__ import annotations

from itertools import product
from math import factorial

import numpy as np
import pytest
from bodies import rotation
from stress.solids import SPIN, spinning
from verify.meshes import plane
from verify.test_fe_triaxial import COMPLIANCE, POISSON, STATES, YOUNG

import fdem
from fdem.scene.moments import quadrature

CORNER = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]
TET = np.array([[0.1, 0.2, 0.0], [1.3, 0.1, 0.2], [0.4, 1.1, 0.1], [0.3, 0.4, 0.9]])
G = 9.81


# moments and masses


def box_moment(exponents):
    """Integral of x^i y^j z^k over the L-prism, two boxes."""

    def line(a, b, n):
        return (b ** (n + 1) - a ** (n + 1)) / (n + 1)

    i, j, k = exponents
    return (line(0, 2, i) * line(0, 1, j) + line(0, 1, i) * line(1, 2, j)) * line(0, 1, k)


def tet_moment(exponents):
    """The same over the tetrahedron, from ``int l0^a l1^b l2^c l3^d = 6 V a! b! c! d! / (a + b + c + d + 3)!``."""
    volume = abs(np.linalg.det(TET[1:] - TET[0])) / 6
    axes = [d for d, n in enumerate(exponents) for _ in range(n)]
    total = 0.0
    for corners in product(range(4), repeat=len(axes)):
        factor = np.prod([TET[c, d] for c, d in zip(corners, axes, strict=True)])
        powers = np.bincount(np.array(corners, dtype=int), minlength=4)
        total += factor * np.prod([factorial(p) for p in powers]) / factorial(len(axes) + 3)
    return 6 * volume * total


@pytest.mark.parametrize(("name", "inside"), [("tet", False), ("tet", True), ("L-prism", False)])
def test_dda_simplex_moments(name, inside):
    """All monomials of degree <= 4 about the world origin, to 1e-12 of V size^degree."""
    shape = fdem.convex_hull(TET) if name == "tet" else fdem.prism(CORNER, 1.0, axis="z")
    exact, size = (tet_moment, 1.3) if name == "tet" else (box_moment, 2.0)
    points, weights = quadrature(shape, 4, inside)
    for exponents in product(range(5), repeat=3):
        if sum(exponents) <= 4:
            have = weights @ np.prod(points ** np.array(exponents), axis=1)
            assert have == pytest.approx(exact(exponents), abs=1e-12 * shape.volume * size ** sum(exponents))


def theory_motion(r):
    """T of u = T (d, phi, eps) at the arm r; engineering shear yz zx xy."""
    x, y, z = r
    return np.array(
        [
            [1, 0, 0, 0, z, -y, x, 0, 0, 0, z / 2, y / 2],
            [0, 1, 0, -z, 0, x, 0, y, 0, z / 2, 0, x / 2],
            [0, 0, 1, y, -x, 0, 0, 0, z, y / 2, x / 2, 0],
        ]
    )


def theory_mass(mass, second):
    """M = int rho T^T T dV of the mass and ``second = int rho r r^T dV`` about the centre."""
    constant = theory_motion(np.zeros(3))
    linear = [theory_motion(axis) - constant for axis in np.eye(3)]
    result = mass * constant.T @ constant
    return result + sum(second[i, j] * linear[i].T @ linear[j] for i in range(3) for j in range(3))


def alone(shape, density=2500.0, gravity=(0, 0, 0), young=1e10, poisson=0.25, body=None, integrator=None, **given):
    scene = fdem.Scene(gravity=gravity)
    block = scene.add(shape, body or fdem.UniformStrain(), fdem.Elastic(density, young, poisson), **given)
    return fdem.Simulation(scene, integrator or fdem.Explicit(), progress=False), block


def test_dda_mass_matrix():
    """All entries to 1e-12 of the largest: box, L-prism, and a box that has been turned and stretched."""
    sim, block = alone(fdem.brick((0, 0, 0), (1, 2, 3)))
    have, m = sim[block].generalised_mass, 15000.0
    assert np.abs(have - theory_mass(m, m / 12 * np.diag([1.0, 4.0, 9.0]))).max() <= 1e-12 * np.abs(have).max()
    # the coupling terms and the shear's quarter, entry by entry: m (b^2 - c^2) / 24, m (b^2 + c^2) / 48
    assert have[3, 9] == pytest.approx(m * (4 - 9) / 24) and have[5, 11] == pytest.approx(m * (1 - 4) / 24)
    assert have[9, 9] == pytest.approx(m * 13 / 48) and np.linalg.eigvalsh(have).min() > 0
    assert np.array_equal(have, have.T)

    sim, block = alone(fdem.prism(CORNER, 1.0, axis="z"))
    moment = {e: box_moment(e) for e in product(range(3), repeat=3)}
    volume = moment[0, 0, 0]
    unit = np.eye(3, dtype=int)
    centre = np.array([moment[tuple(a)] for a in unit]) / volume
    second = np.array([[moment[tuple(a + b)] for b in unit] for a in unit]) - volume * np.outer(centre, centre)
    have = sim[block].generalised_mass
    assert np.abs(have - theory_mass(2500 * volume, 2500 * second)).max() <= 1e-12 * np.abs(have).max()
    np.testing.assert_allclose(sim[block].position, centre, rtol=1e-14)

    sim, block = alone(fdem.brick((0, 0, 0), (1, 2, 3)))
    F = rotation((1, 2, -1), 0.8) @ np.array([[1.02, 0.01, 0], [0.01, 0.99, 0], [0, 0, 1.01]])
    sim.state.q[3:] = F.ravel()
    have = sim[block].generalised_mass
    assert np.abs(have - theory_mass(m, m / 12 * F @ np.diag([1, 4, 9]) @ F.T)).max() <= 1e-12 * np.abs(have).max()


def test_density_that_varies():
    """Mass, centre and second moments of a density that is a polynomial: exact, for every body."""
    a, b, c = 1.0, 2.0, 3.0

    def density(x):
        return 1000.0 * (1 + x[:, 2] ** 2 / c**2 + x[:, 0] / a)

    def line(length, n):
        return length ** (n + 1) / (n + 1)

    def exact(i, j, k):
        base = [line(a, i + s) * line(b, j) * line(c, k + t) for s, t in ((0, 0), (0, 2), (1, 0))]
        return 1000.0 * (base[0] + base[1] / c**2 + base[2] / a)

    mass = exact(0, 0, 0)
    centre = np.array([exact(1, 0, 0), exact(0, 1, 0), exact(0, 0, 1)]) / mass
    unit = np.eye(3, dtype=int)
    second = np.array([[exact(*(p + q)) for q in unit] for p in unit]) - mass * np.outer(centre, centre)
    for body in (fdem.Rigid(), fdem.UniformStrain(), fdem.Zoned(mass="inertia-matched")):
        sim, block = alone(fdem.brick((0, 0, 0), (a, b, c)), density, body=body)
        view = sim[block]
        assert view.mass == pytest.approx(mass, rel=1e-12)
        if not isinstance(body, fdem.Zoned):
            np.testing.assert_allclose(view.position, centre, rtol=1e-12)
            np.testing.assert_allclose(view.inertia, np.trace(second) * np.eye(3) - second, atol=1e-12 * mass)
        else:
            # a density is constant in a zone: six of them know the mass, not its distribution
            assert view.gridpoint_mass.sum() == pytest.approx(mass, rel=1e-12)
    with pytest.raises(fdem.SceneError, match="density"):
        alone(fdem.brick((0, 0, 0), (a, b, c)), lambda x: x[:, 0] - 0.5)


def test_density_in_a_body_that_is_not_convex():
    """The function is asked inside the body only; a density of degree 2 is exact."""
    shape = fdem.prism(CORNER, 1.0, axis="z")

    def density(x):
        outside = (x[:, 0] > 1 + 1e-9) & (x[:, 1] > 1 + 1e-9)
        assert not outside.any()
        return 100.0 * (1 + x[:, 0] * x[:, 1])

    sim, block = alone(shape, density)
    exact = 100 * (box_moment((0, 0, 0)) + box_moment((1, 1, 0)))
    assert sim[block].mass == pytest.approx(exact, rel=1e-12)
    first = 100 * (box_moment((1, 0, 0)) + box_moment((2, 1, 0)))
    assert sim[block].position[0] == pytest.approx(first / exact, rel=1e-12)


# spin


def test_dda_false_expansion():
    """Free fall and two turns: volume, angle, centroid; a rotation of first order would expand the block by 8 %."""
    velocity, g, density, young, poisson = np.array([1.0, 0, 5.0]), np.array([0, 0, -G]), 2000.0, 1e10, 0.25
    shape = fdem.brick((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
    given = dict(velocity=velocity, angular_velocity=(0, 0, SPIN), gravity=g)
    sim, block = alone(shape, density, young=young, poisson=poisson, **given)
    sim.run(time=1.0)
    volume = sim.history(lambda s: np.linalg.det(s.model.batches[0].deformation(s.state.q)[0]))
    stress = sim.history(block, "stress")
    sim.run(time=1.0)
    # the oracle's 1e-8 + rho w^2 a^2 / (12 E) and 1e-6 E, of means over the last turn: the block breathes
    assert abs(np.mean(volume.values) - 1.0) <= 1e-8 + density * SPIN**2 / (12 * young)
    assert np.abs(np.mean(stress.values, axis=0)).max() <= 1e-6 * young
    assert np.linalg.norm(sim[block].rotation_vector) == pytest.approx(2 * SPIN, abs=1e-4)
    np.testing.assert_allclose(sim[block].rotation_vector[:2], 0, atol=1e-12)
    np.testing.assert_allclose(sim[block].position, velocity * 2 + 0.5 * g * 4, atol=1e-10)
    assert sim.energy.closure <= 1e-8


@pytest.mark.parametrize(("turns", "steps"), [(20, 1000), (100, 100), pytest.param(100, 1000, marks=pytest.mark.long)])
def test_deformable_spin(turns, steps):
    """S26 at 1000 and 100 steps a turn, each half the stable one: volume to 1e-6, no trend above 1e-9 a turn."""
    volume, strain, change, steady = spinning(SPIN / steps, turns, steps)
    # at 100 steps a turn the discrete spin itself stretches by (w dt)^2 / 24 of the steady 0.8 % more
    assert np.abs(volume).max() <= 1e-6 + steady * (SPIN / steps) ** 2
    for values in (volume, strain):
        assert abs(np.polyfit(np.arange(turns), values, 1)[0]) <= 1e-9
    assert change <= 1e-12


@pytest.mark.parametrize("turns", [50, pytest.param(1000, marks=pytest.mark.long)])
def test_a_stiff_block_spins(turns):
    """omega / omega_strain = 0.01: volume and strain (means over a turn) drift by less than 1e-9, L to 1e-12."""
    volume, strain, change, _ = spinning(0.01, turns, 400)
    assert np.ptp(volume) <= 1e-9 and np.ptp(strain) <= 1e-9
    assert change <= 1e-12


def test_imposed_rotations_make_no_stress():
    """fe_rigid_rotation: 30, 90, 180, 720 degrees about (1, 2, 2), stress <= 1e-12 E, volume 1."""
    sim, block = alone(fdem.brick((0, 0, 0), (1, 1, 1)), 2000.0, young=1e9)
    (batch,), v = sim.model.batches, sim.state.v
    for degrees in (30, 90, 180, 720):
        R = rotation((1, 2, 2), np.radians(degrees))
        sim.state.q[3:] = R.ravel()
        batch.place(sim.state.q, sim.state.x)
        assert np.abs(sim[block].stress).max() <= 1e-12 * 1e9
        np.testing.assert_allclose(sim[block].rotation, R, atol=1e-15)
        f = np.zeros_like(v)
        batch.internal(sim.state.q, sim.state.x, f)
        assert np.abs(f).max() <= 1e-12 * 1e9


# on a joint


def on_springs():
    """The unit cube of dda_block_on_springs on a joint, nu = 0."""
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    rock = fdem.Elastic(2500.0, 1e9, 0.0)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.UniformStrain(), rock, name="block")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=0))
    return scene, block


@pytest.fixture(scope="module")
def settled():
    scene, block = on_springs()
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-10).converged
    return scene, block, sim


def test_dda_block_on_springs_at_rest(settled):
    """Closure m g / (kn A), strain -m g / (2 E A); the theory's f vanishes, with the contacts' share on the strain."""
    _, block, sim = settled
    view, weight = sim[block], 2500 * G
    bottom = view.gridpoint_displacement[view.gridpoints[:, 2] < 0.5, 2]
    np.testing.assert_allclose(bottom, -2.4525e-05, rtol=1e-8)
    assert view.strain[2] == pytest.approx(-1.22625e-05, rel=1e-8)
    assert view.generalised_displacement[8] == pytest.approx(-1.22625e-05, rel=1e-8)
    assert np.abs(view.generalised_force).max() <= 1e-9 * weight
    assert view.stress[2] == pytest.approx(-0.5 * weight, rel=1e-4)  # Cauchy, over the strained face
    # without the contacts' share the strain would feel V sigma alone
    f = np.zeros_like(sim.state.f)
    sim.model.batches[0].internal(sim.state.q, sim.state.x, f)
    assert (sim.model.batches[0].theory(0, sim.state.q).T @ f)[8] == pytest.approx(0.5 * weight, rel=1e-4)
    top = view.gridpoint_displacement[view.gridpoints[:, 2] > 0.5, 2]
    # fe_bar_self_weight, one block: tip = rho g L^2 / (2 E) beside the closure
    np.testing.assert_allclose(-top - 2.4525e-05, 2500 * G / (2 * 1e9), rtol=1e-8)


def test_dda_block_on_springs_frequencies(settled):
    """Both to 0.2 % at 0.05 of the critical step; the automatic step is that of the strain mode."""
    scene, _, start = settled
    exact = np.array([561.7463659239894, 2466.6659725976665])
    sim = fdem.Simulation(scene, fdem.Explicit(dt=0.05 * 2 / exact[1]), start=start, progress=False)
    assert sim.integrator.limit(sim.system) == pytest.approx(2 / exact[1], rel=1e-4)
    sim.state.v[2], sim.state.v[11] = 1e-4, 1e-4  # upwards, and stretching
    history = sim.history(lambda s: np.array([s.state.q[2], s.state.q[11]]))
    sim.cycle(4000)
    u = np.array(history.values)
    u -= u.mean(axis=0)
    # u(n+1) + u(n-1) = 2 cos(w dt) u(n) in every mode
    matrix = np.linalg.lstsq(u[1:-1], u[2:] + u[:-2], rcond=None)[0]
    have = np.sort(np.arccos(0.5 * np.linalg.eigvals(matrix).real)) / sim.dt
    assert have == pytest.approx(exact, rel=2e-3)


def test_platens():
    """Squeezed by 1 MN between two joints: shortening 2 F / (kn A) + F h / (E A) = 3 mm to 1e-5."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    rock = fdem.Elastic(2500.0, 1e9, 0.0)
    low = scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.UniformStrain(), rock)
    top = scene.add(fdem.brick((-1, -1, 1), (2, 2, 2)), fdem.Rigid(), rock)
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=0))
    scene.fix(top, ("x", "y", "rotation"))
    scene.apply(fdem.Force((0, 0, -1e6)), top)
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-8).converged
    assert -sim[top].displacement[2] == pytest.approx(0.003, rel=1e-5)
    assert sim[low].displacement[2] == 0.0


# homogeneous states


@pytest.mark.parametrize("state", STATES)
def test_state_under_tractions(state):
    """fe_triaxial, one block, full load: strain and energy exact, because stress is linear in the stretch."""
    stress = np.array(STATES[state], dtype=float)
    scene = fdem.Scene(gravity=(0, 0, 0))
    shape = fdem.brick((0, 0, 0), (1, 1, 2))
    block = scene.add(shape, fdem.UniformStrain(), fdem.Elastic(2500, YOUNG, POISSON))
    scene.apply(fdem.Traction(stress), block)
    scene.fix(block, ("x", "y", "z", "rotation"))  # dead loads that press turn a free block round
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-11).converged
    strain = COMPLIANCE @ stress
    np.testing.assert_allclose(sim[block].strain, strain, atol=1e-10 * np.abs(strain).max())
    assert sim.energy.strain == pytest.approx(0.5 * stress @ strain * 2.0, rel=1e-10)
    shortening = np.ptp(sim[block].gridpoints, axis=0) - [1, 1, 2]
    if state != "shear":
        np.testing.assert_allclose(shortening, strain[:3] * [1, 1, 2], atol=1e-9 * np.abs(strain).max())


def test_oedometer():
    """x and y fixed for the whole block: K0 and the oedometric modulus exactly; reactions carry the lateral stress."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 2)), fdem.UniformStrain(), fdem.Elastic(2500, YOUNG, POISSON))
    scene.fix(block, ("x", "y"))
    for z, sign in ((0.0, 1.0), (2.0, -1.0)):
        scene.apply(fdem.Traction((0, 0, sign * 1e7)), block, where=plane(2, z))
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-10).converged
    modulus = YOUNG * (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON))
    np.testing.assert_allclose(sim[block].strain, [0, 0, -1e7 / modulus, 0, 0, 0], atol=1e-9 * 1e7 / modulus)
    side = -1e7 * POISSON / (1 - POISSON)
    # Cauchy stress of a block shortened by 3.7e-4
    assert sim[block].stress[:2] == pytest.approx([side, side], rel=1e-3)
    assert sim.energy.strain == pytest.approx(0.5 * 1e14 / modulus * 2.0, rel=1e-9)


@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_patch(scale):
    """fe_patch_test: a linear field prescribed on a block is taken exactly; stress as one block of that strain."""
    A = scale * np.array([[1e-4, 2e-4, -5e-5], [3e-5, -1e-4, 7e-5], [4e-5, 1e-5, 6e-5]])
    b = scale * np.array([0.001, -0.002, 0.0005])
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.UniformStrain(), fdem.Elastic(2500, 1e10, 0.25))
    scene.apply(fdem.Displacement(lambda x: x @ A.T + b), block)
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    sim.cycle(2500)
    view = sim[block]
    start = view.gridpoints - view.gridpoint_displacement
    error = np.abs(view.gridpoint_displacement - start @ A.T - b).max()
    assert error <= 1e-8 * np.abs(A).max() + 8 * np.finfo(float).eps  # the oracle's, by relaxation
    linear = scale * np.array([1.04e6, -5.6e5, 7.2e5, 3.2e5, -4e4, 9.2e5])
    # the linear formula differs from any finite strain by the strain and rotation itself (2e-4 of it here)
    np.testing.assert_allclose(view.stress, linear, atol=6e-4 * scale * np.abs(linear).max() + 2e-5)


# the integrator, by a strain mode: stress is linear in the stretch, so the mode is a linear oscillator at any amplitude


def breathing(share, steps):
    """Stretch of all sides of a free cube over time, w dt = `share`; strain over its first value (steps + 1,)."""
    sim, _ = alone(fdem.brick((-0.5,) * 3, (0.5,) * 3), 2000.0, young=1e9, poisson=0.25)
    (batch,), q, v = sim.model.batches, sim.state.q, sim.state.v
    # 12 (3 lam + 2 mu) / (rho a^2)
    omega = np.sqrt(12 * (3 * batch.lam[0] + 2 * batch.mu[0]) / 2000.0)
    dt, f, a = share / omega, np.zeros(12), np.zeros(12)
    diagonal = [3, 7, 11]
    q[diagonal] = 1.01
    values, h = np.empty(steps + 1), 0.5 * dt
    values[0] = 0.01
    for n in range(steps):
        f[:] = 0.0
        batch.internal(q, sim.state.x, f)
        batch.accelerate(q, f, a)
        v += h * a
        h = dt
        batch.advance(q, v, dt)
        values[n + 1] = q[3] - 1.0
    return values / 0.01


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0, 1.9])
def test_integ_central_difference(share):
    """Discrete period of leapfrog, sin(w_d dt / 2) = w dt / 2, to 1e-6: the values are cos(w_d t) to round-off."""
    steps = 400
    values = breathing(share, steps)
    discrete = 2 * np.arcsin(share / 2)
    np.testing.assert_allclose(values, np.cos(discrete * np.arange(steps + 1)), atol=1e-6)


@pytest.mark.parametrize("steps", [5_000, pytest.param(100_000, marks=pytest.mark.long)])
def test_the_stable_step_is_sharp(steps):
    """Bounded at 0.999 of 2 / w, unbounded at 1.001."""
    assert np.abs(breathing(1.998, steps)).max() <= 1.0 + 1e-6
    assert np.abs(breathing(2.002, 400)).max() > 50.0


@pytest.mark.long
def test_integ_energy_drift():
    """S14: w dt = 0.2, a million steps; what leapfrog keeps exactly changes by no more than 1e-9 of itself."""
    values = breathing(0.2, 1_000_000)
    now, then = values[1:], values[:-1]
    kept = now**2 + then**2 - 2 * np.cos(2 * np.arcsin(0.1)) * now * then
    means = (kept / kept[0] - 1).reshape(100, -1).mean(axis=1)
    assert abs(np.polyfit(np.arange(100), means, 1)[0]) * 100 <= 1e-9
    assert np.abs(means).max() <= 1e-9
