"""Sub-steps: every block at its own rate gives the answer of one rate for all, and costs less."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scenes import assert_same_bits, everything, simulation

import fdem

ROCK = fdem.Elastic(density=2600.0, young=2e10, poisson=0.25)
SOFT = fdem.Elastic(density=2600.0, young=2e8, poisson=0.25)
JOINT = fdem.Coulomb(kn=2e10, ks=1e10, friction=35.0)


def rock_mass(side=8.0, spacing=1.75, joint=JOINT, gravity=(0.0, 0.0, -9.81)):
    """A cube on rollers, cut by three joint sets: slivers between large blocks."""
    shapes = [fdem.brick((0, 0, 0), (side, side, side))]
    for k, (dip, direction) in enumerate([(75, 40), (65, 150), (15, 280)]):
        joints = fdem.JointSet(dip, direction, spacing=spacing, origin=(4.3, 3.9, 4.1), deviation=3, seed=k)
        shapes = fdem.cut(shapes, joints)
    scene = fdem.Scene(gravity=gravity)
    scene.add(shapes, fdem.Zoned(), ROCK, name="block")
    scene.joint(joint)
    for axis, name in enumerate("xyz"):
        scene.fix(component=name, where=lambda x, k=axis: x[:, k] < 1e-9)
    return scene


def two(slow=SOFT, joint=JOINT, body=None, **given):
    """A stiff slab on a fixed base and a soft block on it: rates 1 and 16 or so."""
    scene = fdem.Scene(**given)
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    scene.add(fdem.brick((0, 0, 0), (1, 1, 0.1)), fdem.Zoned(), ROCK, name="fast")
    scene.add(fdem.brick((0, 0, 0.1), (1, 1, 1.1)), body or fdem.Zoned(size=0.5), slow, name="slow")
    scene.joint(joint)
    return scene


def momentum(sim):
    return sum(sim[name].mass * sim[name].velocity for name in sim.model.names)


def own_rates(sim):
    """Levels of the blocks that move."""
    return set(sim.integrator.rates.level[~sim.model.fixed].tolist())


def test_a_jointed_rock_mass_costs_less():
    """Issue: 2.5 x fewer updates of zones on 200 blocks and more, with an error that its meshes do not notice.

    A wave from above that comes within 0.2 ms. Against half the step, plain steps are 2e-5 off (root mean square),
    sub-steps 4e-4 at a sixth of the updates; blocks of a dozen zones are several per cent off.
    """
    scene, time = rock_mass(), 3e-4
    scene.apply(fdem.Pressure(1e6), where=lambda x: x[:, 2] > 8.0 - 1e-6, factor=lambda t: min(t / 2e-4, 1.0))
    plain, ours = (simulation(scene, fdem.Explicit(substeps=n)) for n in (1, 8))
    assert len(scene.blocks) > 200
    for sim in (plain, ours):
        sim.run(time)
    assert ours.integrator.rates.saved > 5.0
    assert len(own_rates(ours)) == 4
    apart, largest = ours.displacements() - plain.displacements(), np.abs(plain.displacements()).max()
    assert np.abs(apart).max() < 2e-3 * largest
    assert np.linalg.norm(apart) < 1e-3 * np.linalg.norm(plain.displacements())
    assert ours.energy.closure < 1e-4
    assert_allclose(ours.energy.kinetic, plain.energy.kinetic, rtol=2e-3)


def test_equal_blocks_step_together_bit_for_bit():
    """Nothing to gain: the scheme is the plain one, and its bits are."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (5, 2, 0)), fdem.Rigid(), fixed=True)
    for k in range(3):
        scene.add(fdem.brick((1.5 * k, 0, 0.01), (1.5 * k + 1, 1, 1.01)), fdem.Zoned(size=0.5), ROCK)
    scene.joint(JOINT)
    plain, ours = (simulation(scene, fdem.Explicit(substeps=n)) for n in (1, 8))
    for sim in (plain, ours):
        sim.cycle(200)
    assert ours.integrator.rates.every == 1
    assert plain.time == ours.time
    assert_array_equal(plain.displacements(), ours.displacements())
    assert_array_equal(plain.velocities(), ours.velocities())


@pytest.mark.parametrize("body", [fdem.Zoned(size=0.5), fdem.Rigid(), fdem.UniformStrain(), fdem.LinearStrain()])
def test_every_body_has_a_rate(body):
    """A block dropped and pushed aside: same path as without sub-steps."""
    joint = fdem.Coulomb(kn=1e9, ks=5e8, friction=35.0)
    scene = two(body=body, joint=joint, gravity=(2.0, 0.0, -9.81))
    plain, ours = (simulation(scene, fdem.Explicit(substeps=n)) for n in (1, 16))
    for sim in (plain, ours):
        sim.run(0.02)
    assert max(own_rates(ours)) > 0
    assert plain.time == pytest.approx(ours.time, rel=1e-12)
    largest = np.abs(plain.displacements()).max()
    # second order in the longest rate: 0.8 of the stable step of the block, as that of plain runs is of theirs
    assert np.abs(plain.displacements() - ours.displacements()).max() < 5e-3 * largest
    assert ours.energy.closure < 2e-3
    if isinstance(body, fdem.Rigid):
        assert_allclose(ours["slow"].rotation, plain["slow"].rotation, atol=1e-6)


def test_momentum_is_exact():
    """Two blocks of different rates collide in free space: impulses come in pairs."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Zoned(size=0.5), ROCK, velocity=(1.0, 0, 0), name="fast")
    scene.add(fdem.brick((1.001, 0.3, 0.2), (2, 1.3, 1.2)), fdem.Zoned(size=0.5), SOFT, name="slow")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=20))
    sim = simulation(scene, fdem.Explicit(substeps=8))
    before = momentum(sim)
    sim.run(0.02)
    assert len(own_rates(sim)) > 1
    assert sim.energy.friction > 0.0
    # sums of 1e5 terms or so
    assert_allclose(momentum(sim), before, atol=1e-12 * np.abs(before).max())


def test_at_rest_the_forces_balance():
    """A soft block at rest on a stiff one, drag on both: the base carries both, the stress is that of the weight."""
    sim = simulation(two(), fdem.Explicit(substeps=8, damping=fdem.Rayleigh(mass=300.0)))
    sim.run(0.2)
    assert len(own_rates(sim)) > 1
    weight = 9.81 * (sim["fast"].mass + sim["slow"].mass)
    gp, forces = sim.tractions_of(["fast"])
    below = sim.model.gp_block[gp] == sim.model.names.index("base")
    # joints of the slab oscillate between two impulses of the block, of which this is the force at one end
    assert abs(-forces[below, 2].sum() - weight) < 2e-3 * weight
    assert_allclose(sim["slow"].stress[2], -0.5 * 9.81 * 2600.0, rtol=1e-3)


def test_goes_on_from_a_file_bit_for_bit(tmp_path):
    scene = rock_mass(side=4.0, spacing=1.9)
    sim = simulation(scene, fdem.Explicit(substeps=8))
    sim.cycle(20)
    assert len(own_rates(sim)) > 1
    sim.save(tmp_path / "state.npz")
    again = fdem.load(tmp_path / "state.npz", scene, fdem.Explicit(substeps=8), progress=False)
    for run in (sim, again):
        run.cycle(30)
    assert_same_bits(everything(sim), everything(again))


def test_loads_and_excavation_on_the_way_keep_the_balance():
    """A change on the way brings all blocks into step first: no slip and no work gets lost."""
    scene = rock_mass(side=4.0, spacing=1.9)
    sim = simulation(scene, fdem.Explicit(substeps=8))
    sim.cycle(30)
    closure, friction = sim.energy.closure, sim.energy.friction
    before = sim.velocities().copy()
    sim.apply(fdem.Pressure(1e5), where=lambda x: x[:, 2] > 4.0 - 1e-6)
    assert_allclose(sim.energy.friction, friction, rtol=1e-9)
    assert_allclose(sim.velocities(), before, atol=1e-12 * np.abs(before).max())
    sim.cycle(30)
    sim.excavate(sim.model.names[len(sim.model.names) // 2])
    sim.cycle(30)
    assert max(sim.energy.closure, closure) < 1e-4


def test_prescribed_motion_does_the_work_it_should():
    """A soft block pressed down at a constant speed on a stiff one: work goes to strain and joints."""
    scene = two(gravity=(0, 0, 0))
    scene.apply(fdem.Velocity((None, None, -0.05)), "slow", where=lambda x: x[:, 2] > 1.1 - 1e-9)
    plain, ours = (simulation(scene, fdem.Explicit(substeps=n)) for n in (1, 8))
    for sim in (plain, ours):
        sim.run(0.02)
    assert len(own_rates(ours)) > 1
    assert ours.energy.closure < 1e-3
    assert_allclose(ours.energy.work, plain.energy.work, rtol=5e-3)


def test_energy_from_nowhere_halves_the_rates():
    """What the balance has gained since the last look is judged by what is turned over; motion goes on."""
    sim = simulation(two(), fdem.Explicit(substeps=64))
    sim.cycle(50)
    rates, v, x = sim.integrator.rates, sim.velocities(), sim.places()
    every = rates.every
    assert every > 1
    sim.integrator.watch(sim.system, 0.5, 100.0)
    sim.integrator.watch(sim.system, 1.4, 100.0)
    assert rates.every == every
    with pytest.warns(fdem.FdemWarning, match="energy has grown by 1.1 J of 100 J .* sub-steps"):
        sim.integrator.watch(sim.system, 2.5, 100.0)
    assert rates.every == every // 2
    assert_allclose(sim.velocities(), v, atol=1e-12 * np.abs(v).max())
    assert_array_equal(sim.places(), x)
    sim.cycle(50)
    assert sim.energy.closure < 1e-3


def test_describe_tells_the_rates():
    assert "sub-steps: left out, not asked for" in simulation(two(), fdem.Explicit()).describe()
    text = simulation(two(), fdem.Explicit(substeps=8)).describe()
    assert "times fewer than all in all" in text


@pytest.mark.parametrize("n", [0, 3, -4, 2.0, True, "8"])
def test_substeps_must_be_a_power_of_two(n):
    with pytest.raises(fdem.SceneError, match="substeps"):
        fdem.Explicit(substeps=n)


@pytest.mark.parametrize(
    "given",
    [{"damping": fdem.Local()}, {"damping": fdem.Rayleigh(stiffness=1e-4)}, {"sleep": fdem.Sleep()}],
)
def test_what_needs_every_step_is_refused(given):
    with pytest.raises(fdem.UnsupportedError, match="substeps"):
        fdem.Explicit(substeps=4, **given)


def test_joints_that_stiffen_are_refused():
    law = fdem.BartonBandis(kn=1e9, ks=5e8, max_closure=1e-3, jrc=8.0, jcs=5e7, residual_friction=25.0)
    with pytest.raises(fdem.UnsupportedError, match="stiffen"):
        simulation(two(joint=law), fdem.Explicit(substeps=4))


@pytest.mark.long
def test_no_energy_comes_in_the_long_run():
    """20,000 steps of a rock mass without damping, closed in itself: impulses do not resonate."""
    scene = rock_mass(side=4.0, spacing=1.9, joint=fdem.Coulomb(kn=2e10, ks=2e10, friction=60.0, tension=1e9))
    sim = simulation(scene, fdem.Explicit(substeps=16))
    sim.cycle(20000)
    assert sim.energy.closure < 1e-3
