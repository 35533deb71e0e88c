"""Oracle cases of rigid and zoned blocks on other bodies: tops, mass properties, self weight, spin; sliver zones."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from bodies import rotation
from test_rigid import Top, box_inertia
from test_shapes import TET_FACES, TONON, l_prism
from verify.meshes import plane
from verify.test_uniform_strain import alone

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia
G = 9.81
STRAINED = {"uniform": fdem.UniformStrain(), "linear": fdem.LinearStrain()}
ALL = {"rigid": fdem.Rigid(), **STRAINED, "zoned": fdem.Zoned(mass="inertia-matched")}
strained = pytest.mark.parametrize("body", STRAINED)

# tops: stiff blocks that deform move as rigid ones do


@pytest.mark.parametrize("body", ["uniform", pytest.param("linear", marks=pytest.mark.long)])
def test_rigid_free_asymmetric_top(body):
    """E = 4 GPa: spin and attitude to 1e-4 at 20 s, energy to 1e-8, angular momentum to 1e-12.

    What the spin strains it, rho w^2 a^2 / (12 E) = 2e-7, is 5e-6 rad after 20 s.
    """
    sim, block = alone(
        fdem.brick((0, 0, 0), (3, 2, 1)), 1000.0, young=4e9, body=ALL[body], angular_velocity=(0.6, 0.1, 1.0)
    )
    top = Top(box_inertia((3.0, 2.0, 1.0), 1000.0)[1], (0.6, 0.1, 1.0))
    momentum, energy = sim[block].angular_momentum, sim.energy.kinetic + sim.energy.strain
    assert energy == pytest.approx(3725.0, rel=1e-13)
    for t in (1.0, 5.0, 20.0):
        sim.run(time=t - sim.time)
        turn = sim[block].rotation
        np.testing.assert_allclose(turn.T @ sim[block].angular_velocity, top.omega(t), atol=1e-4)
        np.testing.assert_allclose(turn, top.rotation(t), atol=1e-4)
        assert sim.energy.kinetic + sim.energy.strain == pytest.approx(energy, rel=1e-8)
        change = sim[block].angular_momentum - momentum
        assert np.linalg.norm(change) <= 1e-12 * np.linalg.norm(momentum)


@pytest.mark.parametrize("body", ["uniform", pytest.param("linear", marks=pytest.mark.long)])
def test_rigid_symmetric_top(body):
    """E = 4 GPa: the axis to 1e-4 rad at 30 s, the cone to 1e-6 rad, angular momentum to 1e-12."""
    shape = fdem.brick((0, 0, 0), (1, 1, 4))
    sim, block = alone(shape, 2500.0, young=4e9, body=ALL[body], angular_velocity=(0.5, 0.0, 4.0))
    momentum = sim[block].angular_momentum
    length = np.linalg.norm(momentum)
    cone = np.arccos(momentum[2] / length)
    for t in np.arange(5.0, 31.0, 5.0):
        sim.run(time=t - sim.time)
        axis = sim[block].rotation[:, 2]
        exact = rotation(momentum, length / 14166.666666666668 * t)[:, 2]
        assert np.linalg.norm(axis - exact) <= 1e-4
        assert np.arccos(axis @ momentum / length) == pytest.approx(cone, abs=1e-6)
    assert np.linalg.norm(sim[block].angular_momentum - momentum) <= 1e-12 * length
    axis_end = [0.5876397843591656, -0.7166446376366645, 0.37563272911838663]
    np.testing.assert_allclose(axis, axis_end, atol=1e-4)


# masses


def tonon():
    return fdem.polyhedron(TONON, [face[::-1] for face in TET_FACES])


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (500_000.0, 4_600_000.0, 100.0)], ids=["origin", "utm"])
@pytest.mark.parametrize("body", ["rigid", "uniform", "linear"])
def test_rigid_polyhedron_inertia(body, shift):
    """Mass, centre, inertia of Tonon's tetrahedron, a box and the L-prism as blocks: 1e-12, 1e-9 at UTM.

    Coordinates there have an ulp of 1e-9 m, which is what their box and prism are known to.
    """
    move = np.eye(4)
    move[:3, 3] = shift
    far = shift[0] > 0
    tetrahedron = np.array([
        [43520.33328539331, -11996.201393234081, 46343.16738139439],
        [-11996.201393234081, 194711.29259079363, -4417.661569685616],
        [46343.16738139439, -4417.661569685616, 191168.76488607796],
    ])  # fmt: skip
    prism = np.array([[7 / 6, 1 / 3, 0.0], [1 / 3, 7 / 6, 0.0], [0.0, 0.0, 11 / 6]])
    box = np.diag([6.5, 5.0, 2.5])
    for shape, volume, centre, inertia, size in (
        (tonon(), 1873.2333642164656, TONON.mean(axis=0), tetrahedron, 50.0),
        (fdem.brick((0, 0, 0), (1, 2, 3)), 6.0, [0.5, 1.0, 1.5], box, 3.0),
        (l_prism(), 3.0, [5 / 6, 5 / 6, 0.5], prism, 2.0),
    ):
        sim, block = alone(shape.transform(move), 1.0, body=ALL[body])
        rel = 1e-9 if far else 1e-12
        assert sim[block].mass == pytest.approx(volume, rel=rel)
        np.testing.assert_allclose(sim[block].position - shift, centre, atol=rel * size if not far else 2e-9)
        np.testing.assert_allclose(sim[block].inertia, inertia, atol=rel * np.abs(inertia).max())


def test_zones_have_the_mass_of_the_block():
    """Totals of zones, inertia-matched: volume and centre to 1e-12, inertia as well."""
    sim, block = alone(tonon(), 1.0, body=fdem.Zoned(mass="inertia-matched"))
    assert sim[block].mass == pytest.approx(1873.2333642164656, rel=1e-12)
    np.testing.assert_allclose(sim[block].position, TONON.mean(axis=0), atol=1e-12 * 50)
    np.testing.assert_allclose(sim[block].inertia, tonon().inertia(1.0), atol=1e-12 * 2e5)


# self weight


LENGTH, WIDTH, YOUNG, DENSITY = 10.0, 2.0, 1e9, 2500.0


@pytest.mark.parametrize("blocks", [1, 10])
def test_fe_bar_self_weight(blocks):
    """The column of uniform-strain blocks, nu = 0, on joints: top beside the closures, base to the weight.

    The constant strain of a block carries its mean stress: one block or ten, the top settles by rho g L^2 / (2 E).
    """
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((-1, -1, -1), (3, 3, 0)), fdem.Rigid(), fixed=True, name="base")
    heights, rock = np.linspace(0, LENGTH, blocks + 1), fdem.Elastic(DENSITY, YOUNG, 0.0)
    parts = [
        scene.add(fdem.brick((0, 0, low), (WIDTH, WIDTH, high)), fdem.UniformStrain(), rock, name=f"part {k}")
        for k, (low, high) in enumerate(pairwise(heights))
    ]
    kn = 1e9  # closes by 2.5e-4 m: round-off of places in the reaction is eps L / closure = 1e-11
    scene.joint(fdem.Coulomb(kn=kn, ks=1e9, friction=0))
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-12).converged
    weight = DENSITY * G * LENGTH * WIDTH**2
    assert sim.pair_force("base", parts[0])[2] == pytest.approx(
        weight, rel=1e-10 * blocks
    )  # the oracle's 1e-10, of every block
    above = weight * (blocks - np.arange(blocks)) / blocks
    view = sim[parts[-1]]
    top = view.gridpoint_displacement[view.gridpoints[:, 2] > LENGTH - 0.01, 2]
    # the formula is of small strain: 1.2e-4
    np.testing.assert_allclose(-top, 0.00122625 + above.sum() / (kn * WIDTH**2), rtol=2e-4)
    share = DENSITY * G * LENGTH / blocks
    stress = np.array([sim[part].stress[2] for part in parts])
    exact = above / WIDTH**2 - 0.5 * share
    np.testing.assert_allclose(-stress, exact, rtol=2e-4)


# homogeneous states


def test_oedometer_of_a_bending_block():
    """fe_triaxial, x and y fixed, 1e-3 of the load (linear formulas): K0, modulus, energy to 1e-5."""
    young, poisson = 2e10, 0.3
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 2)), fdem.LinearStrain(), fdem.Elastic(2500, young, poisson))
    scene.fix(block, ("x", "y"))
    for z, sign in ((0.0, 1.0), (2.0, -1.0)):
        scene.apply(fdem.Traction((0, 0, sign * 1e4)), block, where=plane(2, z))
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-11).converged
    modulus = young * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    np.testing.assert_allclose(sim[block].strain, [0, 0, -1e4 / modulus, 0, 0, 0], atol=1e-5 * 1e4 / modulus)
    assert sim[block].stress[:2] == pytest.approx(-1e4 * poisson / (1 - poisson), rel=1e-5)
    assert sim.energy.strain == pytest.approx(0.5 * 1e8 / modulus * 2.0, rel=1e-5)


# spin


@strained
def test_fe_rigid_rotation_in_free_spin(body):
    """10 rad/s about (1, 2, 2) for 2 s: L to 1e-10, energy to 1e-4, mean volume of the last turn to 1e-6."""
    spin, axis, density, young = 10.0, np.array([1.0, 2, 2]) / 3, 2000.0, 1e9
    shape = fdem.brick((0, 0, 0), (1, 1, 1))
    sim, block = alone(shape, density, young=young, body=STRAINED[body], angular_velocity=spin * axis)
    momentum, start = sim[block].angular_momentum, sim.energy.kinetic + sim.energy.strain
    assert np.linalg.norm(momentum) == pytest.approx(3333.333333333333, rel=1e-12)
    (batch,) = sim.model.batches

    def volume(s):
        if body == "uniform":
            return np.linalg.det(batch.deformation(s.state.q)[0])
        return batch._volumes(batch._gradients(s.state.q))[0]

    sim.run(time=2.0 - 2 * np.pi / spin)
    ratio = sim.history(volume)
    sim.run(time=2 * np.pi / spin)
    assert np.linalg.norm(sim[block].angular_momentum - momentum) <= 1e-10 * np.linalg.norm(momentum)
    assert sim.energy.kinetic + sim.energy.strain == pytest.approx(start, rel=1e-4)
    # virial: int tr(sigma) dV = -int rho |w x r|^2 dV = -rho w^2 a^5 / 6, over 3 K
    bulk = young / (3 * (1 - 2 * 0.25))
    assert np.mean(ratio.values) - 1.0 == pytest.approx(density * spin**2 / 6 / (3 * bulk), abs=1e-6)
    assert sim[block].rotation @ axis == pytest.approx(axis, abs=1e-4)


# S05
