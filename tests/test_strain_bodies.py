"""Blocks of uniform strain in scenes: supports, driven motion, stress, restart, excavation, units, other bodies."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from contact_tools import grid_box
from numpy.testing import assert_allclose, assert_array_equal
from scenes import assert_same_bits, everything, pile, quietly, simulation
from test_invariance import SI, Units
from verify.meshes import box

import fdem

ROCK = fdem.Elastic(density=2500.0, young=1e9, poisson=0.25)
KINDS = {"uniform": fdem.UniformStrain(), "linear": fdem.LinearStrain()}
each = pytest.mark.parametrize("body", KINDS)
G = 9.81


def one(body, shape=None, gravity=(0.0, 0.0, 0.0), **given):
    scene = fdem.Scene(gravity=gravity)
    shape = fdem.brick((0, 0, 0), (1, 2, 3)) if shape is None else shape
    return scene, scene.add(shape, KINDS[body], ROCK, name="block", **given)


# supports and driven motion


@each
@pytest.mark.parametrize(
    ("component", "held", "strained"),
    [
        ("x", [0], [1, 2, 3]),
        (("x", "y"), [0, 1], [2]),
        (("x", "y", "z", "rotation"), [0, 1, 2], [0, 1, 2, 3, 4, 5]),
        (("z", "rotation"), [2], [0, 1, 2, 3, 4, 5]),
        ("rotation", [], [0, 1, 2, 3, 4, 5]),
    ],
)
def test_fixed_components(body, component, held, strained):
    """Alone a component holds every point; beside "rotation" it holds the centre and leaves the strain free."""
    scene, block = one(body)
    fix = scene.fix(block, component)
    scene.apply(fdem.Force((3e6, 4e6, 5e6), at=(0.9, 1.7, 2.9)), block)
    sim = simulation(scene, fdem.Explicit(safety=0.1))
    sim.cycle(50)
    view = sim[block]
    assert_array_equal(np.abs(view.displacement[held]) <= 1e-15, True)
    if "rotation" in component:
        assert_allclose(view.rotation, np.eye(3), atol=1e-13)
        assert np.abs(view.displacement)[[k for k in range(3) if k not in held]].min(initial=1.0) > 1e-9
    else:
        assert np.abs(view.gridpoint_displacement[:, held]).max() <= 1e-15
        free = [k for k in range(3) if k not in held]
        assert np.abs(view.gridpoint_displacement[:, free]).max(axis=0).min() > 1e-9
    assert np.abs(view.strain[strained]).min() > 1e-12
    assert sim.energy.closure < 1e-3
    # the reaction: what keeps a fixed direction from moving
    force = sim[fix].force
    free = [k for k in range(3) if k not in held]
    assert_allclose(force[held], -np.array([3e6, 4e6, 5e6])[held], rtol=1e-9)
    assert_allclose(force[free], 0.0, atol=1e-3)


@each
def test_a_fixed_block_has_no_unknowns(body):
    scene, block = one(body, gravity=(0, 0, -G))
    scene.fix(block)
    sim = simulation(scene)
    assert len(sim.state.v) == 0
    with pytest.raises(fdem.UnsupportedError, match="fixed"):
        _ = sim[block].strain


@each
def test_normal_holds_an_oblique_face(body):
    turn = np.eye(4)
    turn[:3, :3] = np.linalg.qr(np.array([[1.0, 2, 0.5], [0, 1, -1], [0.3, 0, 1]]))[0]
    turn[:3, :3] *= np.sign(np.linalg.det(turn[:3, :3]))
    shape = fdem.brick((0, 0, 0), (1, 2, 3)).transform(turn)
    scene, block = one(body, shape, gravity=(0, 0, -G))
    normal = turn[:3, 2]
    scene.fix(block, "normal", where=lambda x: np.abs(x @ normal) < 1e-9)
    sim = simulation(scene)
    sim.cycle(200)
    moved = sim[block].gridpoint_displacement
    assert np.abs(moved).max() > 1e-6
    low = np.abs((sim[block].gridpoints - moved) @ normal) < 1e-9
    assert np.abs(moved[low] @ normal).max() <= 1e-15


@each
def test_velocity_drives_and_its_work_is_counted(body):
    """A block stretched by a field of velocities: exact strain, and the work is the strain energy."""
    scene, block = one(body)
    rate = np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 0.5]])
    drive = scene.apply(fdem.Velocity(lambda x: x @ rate.T), block)
    sim = simulation(scene, fdem.Explicit(dt=1e-5))
    sim.cycle(200)
    e = 0.5 * 200 * 1e-5
    strain = e + 0.5 * e**2 if body == "linear" else e  # Green's strain, or that of the stretch
    assert_allclose(sim[block].strain, [0, 0, strain, 0, 0, 0], atol=1e-12)
    energy = sim.energy
    exact = 0.5 * (1e9 * 0.75 / (1.25 * 0.5)) * e**2 * 6
    assert energy.strain == pytest.approx(exact * (strain / e) ** 2, rel=1e-9)
    assert energy.kinetic <= 1e-20 * exact
    assert energy.work == pytest.approx(energy.strain, rel=1e-3)
    assert np.abs(sim[drive].force).max() < 1e-3 * 1e9  # no net force: it stretches
    with pytest.raises(fdem.SceneError, match="angular"):
        scene.apply(fdem.Velocity((0, 0, 0), angular=(0, 0, 1)), block)
        simulation(scene)


@each
def test_a_driven_component_leaves_the_others(body):
    scene, block = one(body, gravity=(0, 0, -G))
    scene.apply(fdem.Velocity((0.1, None, None)), block)
    sim = simulation(scene)
    sim.run(time=0.1)
    assert sim[block].displacement[0] == pytest.approx(0.01, rel=1e-9)
    assert sim[block].displacement[2] == pytest.approx(-0.5 * G * 0.01, rel=1e-6)


@each
def test_displacement_arrives(body):
    scene, block = one(body)
    scene.apply(fdem.Displacement((1e-3, None, -2e-3)), block)
    sim = simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-8).converged
    assert_allclose(sim[block].displacement[[0, 2]], [1e-3, -2e-3], rtol=1e-8)
    assert_allclose(sim[block].strain, 0, atol=1e-12)


# stress, views, pictures


@each
def test_in_situ_stress_starts_in_equilibrium(body):
    """A column of blocks under a stress that balances its weight: nothing moves, and the blocks carry it."""
    scene = fdem.Scene()
    for k in range(3):
        scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), KINDS[body], ROCK, group="rock")
    scene.fix(component="normal", where=lambda x: x[:, 2] < 1e-9)
    for axis in range(2):
        scene.fix(component="xy"[axis])
    scene.joint(fdem.Coulomb(kn=1e10, ks=1e10, friction=30))
    scene.apply(fdem.Stress(zz=lambda x: 2500 * G * (x[:, 2] - 3), k=(0.5, 0.5)))
    sim = simulation(scene, fdem.Relaxation())
    # linear stress and plane joints: only round-off is left
    assert sim.ratio <= 1e-12
    assert sim.solve(ratio=1e-9).cycles == 0
    stress = np.array([sim[b].stress for b in scene.blocks])
    assert_allclose(stress[:, 2], -2500 * G * np.array([2.5, 1.5, 0.5]), rtol=1e-12)
    assert_allclose(stress[:, 0], 0.5 * stress[:, 2], rtol=1e-12)
    cells = sim.mesh().cell_data["stress"]
    assert cells.shape == (36, 9) or body == "linear"
    assert np.isfinite(cells).all()


@each
def test_what_a_body_does_not_have(body):
    scene, block = one(body)
    scene.add(fdem.brick((9, 0, 0), (10, 1, 1)), fdem.Rigid(), ROCK, name="rigid")
    scene.joint(fdem.Coulomb(kn=1e9, friction=0))
    sim = quietly(simulation, scene)
    for name in ("zones", "zone_stress", "zone_strain", "zone_rotation", "gridpoint_mass"):
        with pytest.raises(fdem.UnsupportedError, match=name):
            getattr(sim[block], name)
    for name in ("strain", "stress"):
        with pytest.raises(fdem.UnsupportedError, match=f"'rigid' is rigid and has no {name}"):
            getattr(sim["rigid"], name)
    assert "strain" in sim.describe()
    with pytest.raises(fdem.SceneError, match="young"):
        scene.add(fdem.brick((5, 0, 0), (6, 1, 1)), KINDS[body], fdem.Elastic(2500.0))


@each
def test_a_block_turned_inside_out_is_reported(body):
    scene, block = one(body)
    scene.apply(fdem.Velocity(lambda x: np.column_stack([0 * x[:, :2], -x[:, 2]])), block)
    sim = simulation(scene, fdem.Explicit(dt=1e-3))
    with pytest.raises(fdem.UnstableError, match=r"'block'.*inside out"):
        sim.cycle(1200)


@each
def test_quiet_boundary_and_local_damping_stop_a_block(body):
    """A moving block on dashpots all round: the step stays stable and the motion dies."""
    scene, block = one(body, velocity=(0.3, 0.2, -0.1), angular_velocity=(0.1, 0.2, 0.3))
    scene.apply(fdem.Drag(), block)
    sim = simulation(scene, fdem.Explicit())
    first = sim.energy.kinetic
    sim.run(time=0.02)
    assert sim.energy.kinetic < 1e-5 * first
    scene, block = one(body, gravity=(0, 0, -G))
    scene.add(fdem.brick((-1, -1, -1), (2, 3, 0)), fdem.Rigid(), fixed=True, name="base")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=0))
    sim = simulation(scene, fdem.Explicit(damping=fdem.Local(0.8)))
    sim.run(time=0.3)
    assert sim.pair_force("base", block)[2] == pytest.approx(15000 * G, rel=1e-3)
    for damping in (fdem.Adaptive(), fdem.Local(0.8)):
        sim = simulation(scene, fdem.Relaxation(damping=damping))
        assert sim.solve(ratio=1e-8).converged
        assert sim[block].strain[2] == pytest.approx(-0.5 * 15000 * G / (2 * 1e9), rel=1e-3)


# the same bits


INTEGRATORS = {
    "explicit": lambda: fdem.Explicit(),
    "local": lambda: fdem.Explicit(damping=fdem.Local(0.3)),
    "rayleigh": lambda: fdem.Explicit(damping=fdem.Rayleigh(mass=2.0, stiffness=2e-5)),
    "relaxation": lambda: fdem.Relaxation(),
    "adaptive": lambda: fdem.Relaxation(damping=fdem.Adaptive()),
}


@each
@pytest.mark.parametrize("name", INTEGRATORS)
def test_half_and_half_is_the_whole(tmp_path, body, name):
    def scene():
        made = pile(body_above=KINDS[body])
        made.fix("side", "y")
        made.blocks[3].body = KINDS[body]
        return made

    whole = simulation(scene(), INTEGRATORS[name]())
    whole.cycle(250)
    everything(whole)  # the ledger keeps the largest turnover it has seen
    whole.cycle(250)
    half = simulation(scene(), INTEGRATORS[name]())
    half.cycle(250)
    half.save(tmp_path / "half.npz")
    again = quietly(fdem.load, tmp_path / "half.npz", scene(), INTEGRATORS[name](), progress=False)
    assert_same_bits(everything(again), everything(half))
    again.cycle(250)
    assert_same_bits(everything(again), everything(whole))
    assert np.abs(whole["high"].strain).max() > 1e-9 and np.ptp(whole.contact_table()["slip"]) > 0


def jointed(body):
    """A wall with an opening under in-situ stress, every other block of the body in question."""
    scene = fdem.Scene()
    scene.add(fdem.brick((0, 0, 0), (2, 1, 3)), fdem.Rigid(), ROCK, name="rock")
    scene.cut(fdem.JointSet(20, 90, spacing=1.0, origin=(1, 0, 0.3), name="bed"))
    scene.cut(fdem.brick((0.6, -1, 1.0), (1.4, 2, 1.9)), name="opening")
    for i, block in enumerate(scene.blocks):
        if i % 2:
            block.body = KINDS[body]
    scene.fix(component="z", where=lambda x: np.abs(x[:, 2]) < 1e-9)
    scene.joint(fdem.Coulomb(kn=2e9, ks=1e9, friction=30))
    scene.joint(fdem.Bonded(kn=4e9, ks=2e9), "opening")
    scene.apply(fdem.Stress(zz=lambda x: -2.5e4 * (5 - x[:, 2]), k=(0.5, 0.5)))
    return scene


@each
def test_excavation_and_restart(tmp_path, body):
    def run(save):
        sim = simulation(jointed(body), fdem.Relaxation())
        sim.cycle(150)
        sim.reset("displacement")
        sim.excavate("opening", over=100)
        sim.cycle(50)
        if save:
            sim.save(tmp_path / "state.npz")
            sim = quietly(fdem.load, tmp_path / "state.npz", jointed(body), fdem.Relaxation(), progress=False)
        sim.cycle(150)
        return everything(sim)

    whole = run(False)
    assert_same_bits(run(True), whole)
    assert np.abs(whole["displacement"]).max() > 1e-9


@each
def test_a_change_that_changes_nothing_leaves_the_bits_alone(body):
    def run(change):
        sim = simulation(pile(body_above=KINDS[body]), fdem.Explicit(dt=5e-5))
        sim.cycle(100)
        if change:
            sim[sim.apply(fdem.Force((0, 0, 0)), "base")].factor = 0.0
        sim.cycle(100)
        return everything(sim)

    first, second = run(False), run(True)
    for key in ("q", "v", "x", "turned", "dt", "lag"):
        assert first[key].tobytes() == second[key].tobytes(), key


def falling(u, body):
    """Blocks that fall, spin and slide on a base, under every kind of load."""
    scene = fdem.Scene(gravity=np.array([2.0, 0.5, -9.0]) * u.acceleration)
    scene.add(u.brick((-2, -2, -0.5), (3, 3, 0)), fdem.Rigid(), name="base", fixed=True)
    scene.add(u.brick((0, 0, 0), (1, 1, 0.5)), KINDS[body], u.elastic(), name="low")
    scene.add(
        u.brick((0.25, 0.25, 0.53125), (1.125, 0.875, 1.125)), KINDS[body], u.elastic(), name="high",
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


@each
@pytest.mark.parametrize("integrator", [fdem.Explicit, fdem.Relaxation])
def test_lengths_scaled_by_powers_of_two_give_the_same_bits(body, integrator):
    def run(u):
        sim = simulation(falling(u, body), integrator())
        sim.cycle(150)
        return sim, sim["high"]

    (first, a), (second, b) = run(SI), run(Units(length=2.0**10, mass=2.0**-3))
    assert_array_equal(first.displacements() * 2.0**10, second.displacements())
    assert_array_equal(a.strain, b.strain)
    assert_array_equal(a.rotation_vector, b.rotation_vector)


# beside other bodies


@each
def test_a_mixed_stack(body):
    """Rigid, strained and zoned cubes on each other: every joint carries the weight above, whatever meets there."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    stone = fdem.Elastic(density=2000, young=1e10, poisson=0.0)
    kinds = [fdem.Rigid(), KINDS[body], fdem.Zoned(mass="inertia-matched"), KINDS[body], fdem.Rigid(), KINDS[body]]
    cubes = [
        scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), kind, stone, name=f"cube {k}") for k, kind in enumerate(kinds)
    ]
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
    sim = quietly(simulation, scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-6).converged
    weights = 2000 * G * np.arange(6, 0, -1)
    for below, cube, weight in zip(["base", *cubes[:-1]], cubes, weights, strict=True):
        force = sim.pair_force(below, cube)
        assert force[2] == pytest.approx(weight, rel=1e-5)
        assert np.abs(force[:2]).max() <= 1e-5 * weights[0]
        table = sim.contact_table()
        mine = (table["block_b"] == sim.model.names.index(cube.name)) & (table["area"] > 0)
        share = table["force"][mine, 2] / table["force"][mine, 2].sum()
        assert_allclose(
            share @ table["position"][mine, :2], [0.5, 0.5], atol=1e-5
        )  # of the rims of flush faces, two are missing
    # mean stress of a cube: half its weight and what stands on it
    assert sim[cubes[1]].stress[2] == pytest.approx(-(weights[1] - 0.5 * 2000 * G), rel=1e-3)


def gridded(body, grid):
    """A unit cube whose upper face is cut into so many triangles, 2 to a cell; in zones, as a zoned block is."""
    return box((*grid, 1), (1, 1, 1)) if body == "zoned" else fdem.polyhedron(*grid_box(*grid))


@pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # flat zones
@pytest.mark.parametrize(
    ("body", "grid"),
    [
        *((body, (22, 23)) for body in ("rigid", "uniform", "zoned")),
        ("linear", (7, 8)),
        pytest.param("linear", (22, 23), marks=pytest.mark.long),
    ],
)
def test_facets_make_no_difference(monkeypatch, body, grid):
    """A face in a thousand triangles instead of one polygon, under a tilted stamp: the same force and moment.

    Without pruning: it leaves out slivers by their size, 1e-4 of the largest patch.
    """
    import fdem.contact.contacts as layer

    monkeypatch.setattr(layer, "Contacts", partial(layer.Contacts, prune=0.0))

    kind = {**KINDS, "rigid": fdem.Rigid(), "zoned": fdem.Zoned()}[body]
    results = []
    for shape in (
        box((1, 1, 1), (1, 1, 1)) if body == "zoned" else fdem.brick((0, 0, 0), (1, 1, 1)),
        gridded(body, grid),
    ):
        scene = fdem.Scene(gravity=(0, 0, 0), gap_tolerance=0)
        block = scene.add(shape, kind, ROCK, name="block")
        tilt, angle = np.eye(4), 2e-4
        tilt[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        tilt[2, 3] = 1e-4
        stamp = fdem.brick((0.2, 0.2, 1.0), (0.8, 0.7, 1.5)).transform(tilt)
        scene.add(stamp, fdem.Rigid(), fixed=True, name="stamp")
        scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
        sim = simulation(scene)
        results.append(np.concatenate([sim.pair_force("stamp", block), sim.pair_moment("stamp", block)]))
    # half open: kn b (2e-4 (0.8 - 0.5))^2 / (2 x 2e-4)
    assert results[0][2] == pytest.approx(-4500.0, rel=1e-3)
    assert_allclose(results[1], results[0], atol=1e-12 * np.abs(results[0]).max())


@pytest.mark.parametrize("first", ["rigid", "uniform"])
@pytest.mark.parametrize("second", ["rigid", "uniform", "zoned"])
def test_another_formulation_goes_on_from_a_state(first, second):
    """A block that has fallen and turned as one body goes on as another: it is where it was."""
    kinds = {"rigid": fdem.Rigid(), "uniform": fdem.UniformStrain(), "zoned": None}

    def scene(kind):
        made = fdem.Scene(gravity=(0, 0, -G))
        points = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], float)
        tets = np.array([[0, 4, 2, 1], [4, 6, 2, 7], [1, 4, 5, 7], [1, 2, 7, 3], [1, 4, 7, 2]])
        shape = fdem.tet_mesh(points, tets)  # its gridpoints are the corners, whatever the body
        body = fdem.Zoned() if kind == "zoned" else kinds[kind]
        return made, made.add(shape, body, ROCK, angular_velocity=(1.0, -2.0, 0.5))

    made, block = scene(first)
    before = simulation(made)
    before.run(time=0.6)
    other, same = scene(second)
    after = quietly(simulation, other, start=before)
    atol = 1e-4 if (first, second) == ("uniform", "rigid") else 1e-12  # the spin has strained it
    assert_allclose(after[same].gridpoints, before[block].gridpoints, atol=atol)
    assert_allclose(after[same].rotation, before[block].rotation, atol=1e-4 if second == "zoned" else atol)
    place = after.state.x.copy()
    after.cycle(1)
    assert np.abs(after.state.x - place).max() < 1e-2
