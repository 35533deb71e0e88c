"""What must not change an answer: another run, more threads, other units, another origin.

Units: lengths times s, time times t and mass times m turn density into m / s^3, stress and Young's
modulus into m / (s t^2), kn and ks into m / (s t)^2, acceleration into s / t^2. If s, t and m are powers
of two every rounding stays what it was, so the bits must be the same.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scenes import assert_same_bits, everything, simulation, staged
from stress.units import Units

import fdem
from fdem.kernels.patches import FACING
from fdem.scene.shapes import Polyhedron

SI = Units()


def falling(u, strain="large"):
    """Zoned and rigid blocks that fall, spin and slide on a base; every kind of load."""
    scene = fdem.Scene(gravity=np.array([2.0, 0.5, -9.0]) * u.acceleration)
    scene.add(u.brick((-2, -2, -0.5), (3, 3, 0)), fdem.Rigid(), name="base", fixed=True)
    scene.add(u.brick((0, 0, 0), (1, 1, 0.5)), fdem.Zoned(size=0.5 * u.length, strain=strain), u.elastic(), name="low")
    scene.add(
        u.brick((0.25, 0.25, 0.53125), (1.125, 0.875, 1.125)), fdem.Rigid(), u.elastic(), name="high",
        velocity=np.array([0.25, 0.125, 0.0]) * u.velocity,
        angular_velocity=np.array([0.0, 0.5, 0.25]) * u.spin,
    )  # fmt: skip
    scene.joint(u.coulomb(damping=0.05, tension=1e3 * u.stress))
    scene.apply(fdem.Pressure(2e3 * u.stress), "low", where=lambda x: x[:, 0] < u.place((1e-9, 0, 0))[0])
    scene.apply(fdem.Force(np.array([50.0, 0, 0]) * u.force, at=u.place((0.5, 0.5, 0.75))), "high")
    scene.apply(fdem.Moment(np.array([0.0, 0, 10.0]) * u.force * u.length), "high")
    scene.apply(fdem.Drag(mass=0.5 * u.spin), "high")
    scene.apply(fdem.Support(normal=1e5 * u.stiffness), "low", where=lambda x: x[:, 1] > u.place((0, 1 - 1e-9, 0))[1])
    return scene


def resting(u, size=0.5):
    """A leaning pile with one unique equilibrium: all joints closed, far from slipping."""
    scene = fdem.Scene(gravity=np.array([0.3, 0.1, -9.81]) * u.acceleration)
    scene.add(u.brick((-2, -2, -0.5), (3, 3, 0)), fdem.Rigid(), name="base", fixed=True)
    scene.add(u.brick((0, 0, 0), (1, 1, 0.6)), fdem.Zoned(size=size * u.length), u.elastic(), name="low")
    scene.add(u.brick((0.1, 0.1, 0.6), (0.9, 0.8, 1.1)), fdem.Rigid(), u.elastic(), name="middle")
    scene.add(u.brick((0.2, 0.1, 1.1), (0.8, 0.8, 1.5)), fdem.Zoned(size=size * u.length), u.elastic(), name="top")
    scene.joint(u.coulomb(friction=80.0, kn=1e9, ks=7e8, cohesion=0.0))
    return scene


def dimensionless(sim, u):
    """Results of a simulation in SI numbers."""
    table = sim.contact_table()
    return {
        "displacement": sim.displacements() / u.length,
        "stress": sim.zone_stresses() / u.stress,
        "force": sim.contact_forces() / u.force,
        "point forces": table["force"] / u.force,
        "area": table["area"] / u.length**2,
        "pair": sim.pair_force("low", "base") / u.force,
    }


# ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", [fdem.Explicit(), fdem.Relaxation()])
def test_the_same_run_gives_the_same_bits(integrator):
    first, second = (simulation(falling(SI), integrator) for _ in range(2))
    for sim in (first, second):
        sim.cycle(300)
    assert_same_bits(everything(first), everything(second))
    # and by another route: in pieces, and looked at on the way
    third = simulation(falling(SI), integrator)
    for _ in range(30):
        third.cycle(10)
        third.contact_table(), third.zone_stresses(), third.velocity, third.ratio
    result, expected = everything(third), everything(first)
    for key in expected:
        if key not in ("energy_error", "energy_closure"):
            assert (result[key] == expected[key]).all(), key


@pytest.mark.parametrize("strain", ["large", "small"])
def test_the_number_of_threads_does_not_change_the_bits(strain):
    results = []
    for threads in (1, 2, 3):
        scene = fdem.Scene()
        scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
        for i in range(2):
            body = fdem.Zoned(size=0.2, strain=strain)
            scene.add(fdem.brick((0, 0, i), (1, 1, i + 1)), body, SI.elastic(), velocity=(0.1 * i, 0, 0))
        scene.joint(SI.coulomb(damping=0.1))
        sim = simulation(scene, fdem.Explicit(), threads=threads)
        sim.cycle(60)
        results.append(everything(sim))
    assert_same_bits(results[1], results[0])
    assert_same_bits(results[2], results[0])


POWERS = {
    "lengths x 2^10": Units(length=2.0**10),
    "lengths x 2^-10": Units(length=2.0**-10),
    "lengths x 2^10, times x 2^5": Units(length=2.0**10, time=2.0**5),
    "lengths x 2^-10, masses x 2^-30": Units(length=2.0**-10, mass=2.0**-30),
    "times x 2^-7, masses x 2^8": Units(time=2.0**-7, mass=2.0**8),
}


@pytest.mark.parametrize("name", POWERS)
@pytest.mark.parametrize("integrator", [fdem.Explicit(), fdem.Relaxation()])
def test_powers_of_two_give_the_same_bits(name, integrator):
    u = POWERS[name]
    plain, scaled = (simulation(falling(units), integrator) for units in (SI, u))
    for sim in (plain, scaled):
        sim.cycle(400)
    assert np.ptp(plain.contact_table()["gap"]) > 0
    # a Relaxation has a time of its own
    time, velocity = (1.0, u.length) if isinstance(integrator, fdem.Relaxation) else (u.time, u.velocity)
    assert scaled.dt == plain.dt * time
    assert scaled.time == plain.time * time
    assert (scaled.positions() == plain.positions() * u.length).all()
    assert (scaled.velocities() == plain.velocities() * velocity).all()
    assert (scaled.zone_stresses() == plain.zone_stresses() * u.stress).all()
    assert (scaled.contact_forces() == plain.contact_forces() * u.force).all()
    tables = scaled.contact_table(), plain.contact_table()
    for key, factor in (("gap", u.length), ("area", u.length**2), ("slip", u.length), ("traction", u.stress)):
        assert (tables[0][key] == tables[1][key] * factor).all(), key
    assert (tables[0]["state"] == tables[1]["state"]).all()
    energies = scaled.energy, plain.energy
    for key in ("strain", "joint", "friction", "potential", "work"):
        assert getattr(energies[0], key) == getattr(energies[1], key) * u.energy, key


@pytest.mark.parametrize("power", [10, -10])
def test_a_cut_and_excavated_scene_gives_the_same_bits(power):
    s = 2.0**power
    scaled_scene = rescaled(staged(), s)
    results = []
    for scene in (staged(), scaled_scene):
        sim = simulation(scene, fdem.Relaxation())
        sim.cycle(200)
        sim.excavate("opening", over=50)
        sim.cycle(200)
        results.append(sim)
    assert (results[1].positions() == results[0].positions() * s).all()
    assert (results[1].zone_stresses() == results[0].zone_stresses() * (1 / s)).all()


def rescaled(scene, s):
    """The scene `staged` at lengths times `s`, the rest consistent (masses and times as they were)."""
    u = Units(length=s)
    result = fdem.Scene(gravity=scene.gravity * u.acceleration)
    stone = scene.blocks[0].material
    result.add(
        fdem.brick((0, 0, 0), (2 * s, s, 3 * s)), fdem.Rigid(), u.elastic(stone.density, stone.young), name="rock"
    )
    result.cut(fdem.JointSet(20, 90, spacing=s, origin=(s, 0, 0.3 * s), name="bed"))
    result.cut(fdem.brick((0.6 * s, -s, s), (1.4 * s, 2 * s, 1.9 * s)), name="opening")
    for i, block in enumerate(result.blocks):
        if i % 2:
            block.body = fdem.Zoned(size=0.7 * s)
    assert [b.name for b in result.blocks] == [b.name for b in scene.blocks]
    for a, b in zip(result.blocks, scene.blocks, strict=True):
        assert isinstance(a.shape, Polyhedron)
        assert (a.shape.points == s * b.shape.points).all()
    result.fix(component="z", where=lambda x: np.abs(x[:, 2]) < 1e-9 * s)
    for axis in range(2):
        result.fix(component="xy"[axis], where=lambda x, k=axis: np.abs(x[:, k] / s - (1 - 0.5 * k)) > 0.999 - 0.5 * k)
    result.joint(fdem.Coulomb(kn=2e9 * u.stiffness, ks=1e9 * u.stiffness, friction=30))
    result.joint(fdem.Bonded(kn=4e9 * u.stiffness, ks=2e9 * u.stiffness), "opening")
    result.apply(fdem.Stress(zz=lambda x: -2.5e4 * (5 - x[:, 2] / s) * u.stress, k=(0.5, 0.5)))
    return result


METRIC = {
    "mm, t, s": Units(length=1e3, mass=1e-3),
    "km, kg, s": Units(length=1e-3),
    "mm, kg, ms": Units(length=1e3, time=1e3),
    "km, Gt, min": Units(length=1e-3, mass=1e-12, time=1 / 60),
}


def settled(u):
    sim = simulation(resting(u), fdem.Relaxation())
    assert sim.solve(ratio=1e-6).reason == "equilibrium"
    steps = sim.steps
    report = sim.solve(ratio=1e-10, max_cycles=30_000)
    assert report.reason == "equilibrium", report
    sim.cycle(3000)
    return sim, steps


@pytest.fixture(scope="module")
def in_metres():
    sim, steps = settled(SI)
    return dimensionless(sim, SI), steps


def assert_close(result, expected, tolerance):
    for key, value in expected.items():
        assert result[key].shape == value.shape, key
        assert_allclose(result[key], value, rtol=0, atol=tolerance * np.abs(value).max(), err_msg=key)


@pytest.mark.parametrize("name", METRIC)
def test_an_equilibrium_does_not_depend_on_the_units(in_metres, name):
    u = METRIC[name]
    sim, steps = settled(u)
    assert_close(dimensionless(sim, u), in_metres[0], 1e-9)
    # local damping turns on the sign of velocities, which round-off decides near rest
    assert 0.5 < steps / in_metres[1] < 2.0


def test_an_equilibrium_does_not_depend_on_the_origin(in_metres):
    u = Units(origin=(500_000.0, 4_600_000.0, 300.0))
    sim = simulation(resting(u), fdem.Relaxation())
    report = sim.solve(ratio=1e-8, max_cycles=30_000)
    assert report.reason == "equilibrium", report
    sim.cycle(3000)
    result = dimensionless(sim, u)
    assert_close(result, in_metres[0], 1e-6)
    assert sim.positions()[:, 1].min() > 4_599_990


def test_cuts_and_cracks_at_utm_coordinates_are_those_at_the_origin():
    origin = np.array([500_000.0, 4_600_000.0, 300.0])
    results = []
    for shift in (np.zeros(3), origin):
        scene = fdem.Scene()
        scene.add(fdem.brick(shift - 5, shift + 5), fdem.Rigid(), SI.elastic(), name="rock")
        scene.cut(fdem.JointSet(70, 36, 3.5, tuple(shift), name="J1"))
        scene.cut(fdem.JointSet(55, 262, 3.0, tuple(shift + 0.3), name="J2"))
        scene.joint(SI.coulomb())
        sim = simulation(scene, fdem.Explicit())
        results.append((scene, sim))
    (scene, sim), (far_scene, far) = results
    assert len(scene.blocks) == len(far_scene.blocks)
    volumes = [np.array([b.shape.volume for b in s.blocks]) for s in (scene, far_scene)]
    assert_allclose(volumes[1], volumes[0], rtol=1e-6)
    assert_allclose(volumes[1].sum(), 1000.0, rtol=1e-8)
    pairs = []
    for each in (sim, far):
        # strips beside the faces have no area of their own and come and go with round-off
        patches = each.system.contacts.patches
        facing = (patches.flags & FACING) > 0
        area = each.system.contacts.stiffness(each.state.x)[3][np.repeat(facing, 3)].sum() / 5e8
        blocks = each.system.contacts.pairs[patches.pair[facing]]
        pairs.append((area, set(map(tuple, blocks.tolist()))))
    assert pairs[0][1] == pairs[1][1]
    assert_allclose(pairs[1][0], pairs[0][0], rtol=1e-6)
