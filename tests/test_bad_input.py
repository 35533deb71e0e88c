"""Bad input is refused with the name of the field, before the first step (S28 of the stress list, and more)."""

from __future__ import annotations

import numpy as np
import pytest
from stress.steps import CUBE, FACES, ROCK, TWELVE, scene_of, with_row

import fdem

TETS = [[0, 1, 2, 3]]
CORNER = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)


def brick():
    return fdem.brick((0, 0, 0), (1, 1, 1))


def refused(act, match, kind=fdem.FdemError):
    """`act` must raise an fdem error whose text names the field, without taking a step."""
    steps = []
    original = fdem.Simulation._step
    fdem.Simulation._step = lambda self, dt: (steps.append(1), original(self, dt))[1]
    try:
        with pytest.raises(kind, match=match):
            act()
    finally:
        fdem.Simulation._step = original
    assert not steps, "the first step was taken"


@pytest.mark.parametrize("name", TWELVE)
def test_the_twelve_of_the_stress_list(name):
    act, match = TWELVE[name]
    refused(act, match)


SHAPES = {
    "NaN corner of a brick": (lambda: fdem.brick((0, 0, np.nan), (1, 1, 1)), "lower"),
    "brick upside down": (lambda: fdem.brick((0, 0, 2), (1, 1, 1)), "lower"),
    "inf in a tet mesh": (lambda: fdem.tet_mesh(with_row(CORNER, (2, 0), np.inf), TETS), r"points\[2\]"),
    "tet index": (lambda: fdem.tet_mesh(CORNER, [[0, 1, 2, 4]]), r"tets\[0\]"),
    "flat tet": (lambda: fdem.tet_mesh(with_row(CORNER, 3, (1, 1, 0)), TETS), r"tets\[0\].*volume"),
    "doubled tet point": (lambda: fdem.tet_mesh(with_row(CORNER, 3, CORNER[0]), TETS), "points|tets"),
    "empty tet mesh": (lambda: fdem.tet_mesh(np.zeros((0, 3)), np.zeros((0, 4), int)), "empty mesh"),
    "no faces": (lambda: fdem.polyhedron(CUBE, []), "empty mesh"),
    "two corners": (lambda: fdem.polyhedron(CUBE, [[0, 1]]), r"faces\[0\]"),
    "negative index": (lambda: fdem.polyhedron(CUBE, [*FACES[:-1], [1, 5, -1, 3]]), r"faces\[5\]"),
    "points in the plane": (lambda: fdem.polyhedron(CUBE[:, :2], FACES), "points"),
    "hull of a plane": (lambda: fdem.convex_hull(CUBE[:4]), "plane"),
    "hull of nan": (lambda: fdem.convex_hull(with_row(CUBE, 0, np.nan)), "points"),
    "radius": (lambda: fdem.icosphere(-1.0), "radius"),
    "dip": (lambda: fdem.JointSet(95, 0), "dip = 95"),
    "spacing": (lambda: fdem.JointSet(30, 0, spacing=0), "spacing = 0"),
    "persistence": (lambda: fdem.JointSet(30, 0, persistence=1.5), "persistence"),
    "disc radius": (lambda: fdem.Disc((0, 0, 0), 10, 10, -1.0), "radius"),
    "wall of nothing": (lambda: fdem.wall(0.0, 1.0, 0.2, (0.4, 0.2, 0.2)), "length"),
    "transform with nan": (lambda: brick().transform(np.full((4, 4), np.nan)), "matrix"),
    "file that is not there": (lambda: fdem.read("nowhere.obj"), "nowhere.obj"),
    "mesh that is not there": (lambda: fdem.Scene.from_mesh("nowhere.msh", fdem.Rigid(), ROCK), "nowhere.msh"),
    "scale": (lambda: fdem.read("nowhere.obj", scale=-1.0), "scale|nowhere"),
}


@pytest.mark.parametrize("name", SHAPES)
def test_shapes(name):
    act, match = SHAPES[name]
    refused(act, match)


VALUES = {
    "nan density": (lambda: fdem.Elastic(density=np.nan), "density"),
    "text for a density": (lambda: fdem.Elastic(density="2500 kg"), "density"),
    "nu = -1": (lambda: fdem.Elastic(2500, 1e10, -1.0), "poisson"),
    "young alone": (lambda: fdem.Elastic(2500, 1e10), "poisson"),
    "kn = 0": (lambda: fdem.Coulomb(kn=0, ks=1e9, friction=30), "kn"),
    "ks < 0": (lambda: fdem.Coulomb(kn=1e9, ks=-1, friction=30), "ks"),
    "friction = 90": (lambda: fdem.Coulomb(kn=1e9, ks=1e9, friction=90), "friction"),
    "nan cohesion": (lambda: fdem.Coulomb(kn=1e9, ks=1e9, friction=30, cohesion=np.nan), "cohesion"),
    "restitution > 1": (lambda: fdem.Coulomb(kn=1e9, ks=1e9, friction=30, restitution=1.2), "restitution"),
    "bond strength": (lambda: fdem.Bonded(kn=1e9, ks=1e9, tension=-1), "tension"),
    "zone size": (lambda: fdem.Zoned(size=0.0), "size"),
    "mass rule": (lambda: fdem.Zoned(mass="lumped"), "mass"),
    "strain": (lambda: fdem.Zoned(strain="huge"), "strain"),
    "force": (lambda: fdem.Force((0, 0, np.nan)), "Force.*value"),
    "force of two components": (lambda: fdem.Force((0, 1)), "Force.*value"),
    "place of a force": (lambda: fdem.Force((0, 0, 1), at=(0, 0, np.inf)), "Force.*at"),
    "moment": (lambda: fdem.Moment((0, np.inf, 0)), "Moment.*value"),
    "traction": (lambda: fdem.Traction((1, 2, 3, 4)), "Traction.*value"),
    "pressure": (lambda: fdem.Pressure(np.inf), "Pressure.*value"),
    "velocity": (lambda: fdem.Velocity((None, np.nan, None)), "Velocity.*value"),
    "drag": (lambda: fdem.Drag(normal=-1), "Drag.*normal"),
    "support": (lambda: fdem.Support(normal=-1), "Support.*normal"),
    "displacement": (lambda: fdem.Displacement((0, 0, np.inf)), "Displacement.*value"),
    "stress": (lambda: fdem.Stress(zz=np.nan), "Stress.*zz"),
    "k with xx": (lambda: fdem.Stress(xx=-1e6, zz=-1e6, k=(1, 1)), "Stress.*k"),
    "dt nan": (lambda: fdem.Explicit(dt=np.nan), "dt"),
    "dt as text": (lambda: fdem.Explicit(dt="1e-3"), "dt"),
    "safety": (lambda: fdem.Explicit(safety=1.5), "safety"),
    "safety nan": (lambda: fdem.Explicit(safety=np.nan), "safety"),
    "damping": (lambda: fdem.Local(1.0), "coefficient"),
    "damping of the wrong kind": (lambda: fdem.Explicit(damping=0.8), "damping"),
    "relaxation damping": (lambda: fdem.Relaxation(damping="local"), "damping"),
    "rayleigh": (lambda: fdem.Rayleigh(mass=-1.0), "mass"),
    "gravity": (lambda: fdem.Scene(gravity=(0, 0)), "gravity"),
    "every": (lambda: fdem.Every(steps=0), "steps"),
    "checkpoint": (lambda: fdem.Checkpoint("x.npz", keep=0), "keep"),
}


@pytest.mark.parametrize("name", VALUES)
def test_values(name):
    act, match = VALUES[name]
    refused(act, match)


def simulate(scene, integrator=None, **options):
    return fdem.Simulation(scene, integrator or fdem.Explicit(dt=1e-4), **options)


def with_load(load, target=None, body=None, **given):
    scene = scene_of(body=body or fdem.Zoned())
    scene.apply(load, target, **given)
    return simulate(scene)


COMPILED = {
    "callable force of the wrong shape": (lambda: with_load(fdem.Force(lambda x: np.ones((2, 2)))), "Force.*shape"),
    "callable force that is nan": (lambda: with_load(fdem.Force(lambda x: np.full_like(x, np.nan))), "Force.*finite"),
    "callable traction": (lambda: with_load(fdem.Traction(lambda x: np.ones((len(x), 4)))), "Traction"),
    "callable pressure": (lambda: with_load(fdem.Pressure(lambda x: x)), "Pressure.*shape"),
    "callable stress": (lambda: with_load(fdem.Stress(zz=lambda x: x)), "Stress zz.*shape"),
    "callable k": (lambda: with_load(fdem.Stress(zz=-1e6, k=lambda x: x)), "Stress k.*shape"),
    "callable displacement": (lambda: with_load(fdem.Displacement(lambda x: x[:, 0])), "Displacement.*shape"),
    "no load": (lambda: with_load(7.0), "load = 7.0"),
    "law for a load": (lambda: with_load(fdem.Coulomb(kn=1, ks=1, friction=1)), "load"),
    "factor": (lambda: with_load(fdem.Force((0, 0, 1)), factor=np.nan), "factor"),
    "target": (lambda: with_load(fdem.Force((0, 0, 1)), "sphere"), "'sphere'"),
    "where": (lambda: with_load(fdem.Force((0, 0, 1)), where=lambda x: x[:, 0]), "where"),
    "place outside": (lambda: with_load(fdem.Force((0, 0, 1), at=(3, 0, 0))), "at = .*outside"),
    "quiet boundary of a rigid block": (
        lambda: simulate(_drag_on_bare_rigid()),
        "Drag.*elastic constants",
    ),
    "spin of a zoned block": (lambda: with_load(fdem.Velocity((0, 0, 0), angular=(0, 0, 1))), "angular"),
    "not a scene": (lambda: simulate([brick()]), "not a Scene"),
    "not an integrator": (lambda: simulate(scene_of(), 1e-3), "not an integrator"),
    "an integrator class": (lambda: simulate(scene_of(), fdem.Explicit), "integrator"),
    "threads": (lambda: simulate(scene_of(), threads=0), "threads"),
    "empty scene": (lambda: simulate(fdem.Scene()), "no block"),
    "body": (lambda: scene_of(body="rigid"), "body"),
    "shape": (lambda: scene_of(shape="cube.stl"), "shape|cube.stl"),
    "spin": (lambda: scene_of(angular_velocity=(0, 0, np.nan)), "angular_velocity"),
    "material of the wrong kind": (lambda: scene_of(material=2500), "material"),
    "rigid without density": (lambda: scene_of(material=None), "material"),
    "zoned without young": (lambda: scene_of(body=fdem.Zoned(), material=fdem.Elastic(2500)), "young"),
    "open surface that moves": (
        lambda: scene_of(shape=fdem.surface(CUBE[[0, 2, 4, 6]], [[0, 1, 3, 2]])),
        "surface",
    ),
    "component": (lambda: scene_of().fix(component="w"), "component = 'w'"),
    "component tuple": (lambda: scene_of().fix(component=("x", 3)), "component = 3"),
    "joint law": (lambda: scene_of().joint("coulomb"), "law"),
    "between of one": (lambda: scene_of().joint(_law(), between=("cube",)), "between"),
    "between that is a text": (lambda: scene_of().joint(_law(), between="cube"), "between"),
    "where that is no function": (lambda: scene_of().fix(where=True), "where"),
    "cutter": (lambda: scene_of().cut("plane"), "cut|shape|plane"),
    "near": (lambda: scene_of().gridpoint((0, 0)), "near"),
}


def _law():
    return fdem.Coulomb(kn=1e9, ks=1e9, friction=30)


def _drag_on_bare_rigid():
    scene = scene_of(material=fdem.Elastic(2500))
    scene.apply(fdem.Drag())
    return scene


@pytest.mark.parametrize("name", COMPILED)
def test_scenes(name):
    act, match = COMPILED[name]
    refused(act, match)


def settled():
    return simulate(scene_of())


CALLS = {
    "time": (lambda: settled().run(time=np.inf), "time"),
    "negative time": (lambda: settled().run(time=-1.0), "time"),
    "time as text": (lambda: settled().run(time="1 s"), "time"),
    "cycles": (lambda: settled().cycle(-1), "n = -1"),
    "cycles as float": (lambda: settled().cycle(1.5), "n = 1.5"),
    "solve ratio": (lambda: settled().solve(ratio=-1e-5), "ratio"),
    "solve ratio nan": (lambda: settled().solve(ratio=np.nan), "ratio"),
    "solve cycles": (lambda: settled().solve(max_cycles=-5), "max_cycles"),
    "reset": (lambda: settled().reset("everything"), "everything"),
    "selector": (lambda: settled()["ball"], "'ball'"),
    "quantity": (lambda: settled().history("cube", "colour"), "'colour'"),
    "component": (lambda: settled().history("cube", "velocity", component="w"), "'w'"),
    "target of a history": (lambda: settled().history("ball", "velocity"), "'ball'"),
    "interval": (lambda: settled().history("cube", "velocity", every=0), "steps"),
    "observer": (lambda: settled().observe(print), "next"),
    "over": (lambda: settled().excavate("cube", over=-1), "over"),
    "all blocks": (lambda: settled().excavate("cube"), "no block"),
    "load": (lambda: settled().apply(fdem.Force((0, 0, 1)), "ball"), "'ball'"),
    "where": (lambda: settled().apply(fdem.Force((0, 0, 1)), where=lambda x: [True]), "where"),
    "pair": (lambda: settled().pair_force("cube", "ball"), "'ball'"),
    "start": (lambda: simulate(scene_of(), start=7), "start"),
    "saved file": (lambda: simulate(scene_of(), start="nowhere.npz"), "nowhere.npz"),
}


@pytest.mark.parametrize("name", CALLS)
def test_calls(name):
    act, match = CALLS[name]
    refused(act, match)


def test_a_factor_set_to_nan_is_refused():
    scene = scene_of()
    load = scene.apply(fdem.Force((0, 0, 1)))
    sim = simulate(scene)
    with pytest.raises(fdem.FdemError, match="factor"):
        sim[load].factor = np.nan
    with pytest.raises(fdem.FdemError, match="factor"):
        sim[load].factor = "twice"
    assert sim[load].factor == 1.0


def test_a_refused_call_leaves_the_simulation_usable():
    scene = fdem.Scene()
    for i in range(2):
        scene.add(fdem.brick((2 * i, 0, 0), (2 * i + 1, 1, 1)), fdem.Rigid(), ROCK, name=f"cube {i}")
    scene.joint(_law())
    sim = simulate(scene)
    sim.cycle(3)
    for act in (
        lambda: sim.apply(fdem.Force((0, 0, 1)), where=lambda x: x[:, 0] > 100),
        lambda: sim.apply(fdem.Force(lambda x: x[:, 0])),
        lambda: sim.excavate("cube*"),
        lambda: sim.excavate("cube*", over=10),
    ):
        with pytest.raises(fdem.SceneError):
            act()
    sim.cycle(3)
    assert sim.excavate("cube 1") == ["cube 1"]
    assert sim[sim.apply(fdem.Force((0, 0, 1)))].force[2] == 1.0
    other = simulate(scene)
    other.cycle(6)
    assert (sim["cube 0"].position == other["cube 0"].position).all()


@pytest.mark.parametrize("answer", ["wrong shape", "nan"])
def test_a_users_load_that_answers_wrongly_is_refused(answer):
    class Wind:
        def force(self, t, x, v):
            return np.zeros((2, 2)) if answer == "wrong shape" else np.full_like(x, np.nan)

    scene = scene_of()
    scene.apply(Wind())
    with pytest.raises(fdem.FdemError, match="force"):
        simulate(scene).cycle(1)


def test_a_function_of_time_that_is_not_finite_is_refused():
    scene = scene_of()
    scene.apply(fdem.Force((0, 0, 1)), factor=lambda t: np.nan if t > 2.5e-4 else 1.0)
    with pytest.raises(fdem.FdemError, match="factor"):
        simulate(scene).cycle(10)


def overlapping(depth, body, **given):
    scene = fdem.Scene(gravity=(0, 0, 0), **given)
    scene.add(brick(), body, ROCK, name="one")
    scene.add(fdem.brick((1 - depth, 0, 0), (2 - depth, 1, 1)), body, ROCK, name="two")
    scene.joint(_law())
    return scene


@pytest.mark.parametrize("body", [fdem.Rigid(), fdem.Zoned()])
@pytest.mark.parametrize("depth", [0.01, 0.2, 0.3, 0.6, 1.0])
def test_blocks_that_overlap_are_named(depth, body):
    refused(lambda: simulate(overlapping(depth, body)), "'one' and 'two'.*overlap")


@pytest.mark.parametrize("depth", [0.3, 0.6])
def test_deep_overlap_is_refused_without_a_gap_tolerance_too(depth):
    refused(lambda: simulate(overlapping(depth, fdem.Rigid(), gap_tolerance=0)), "'one' and 'two'.*overlap")


def test_a_block_inside_another_is_named():
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(brick(), fdem.Rigid(), ROCK, name="outer")
    scene.add(fdem.brick((0.4, 0.4, 0.4), (0.6, 0.6, 0.6)), fdem.Rigid(), ROCK, name="inner")
    scene.joint(_law())
    refused(lambda: simulate(scene), "'outer'.*'inner'|'inner'.*'outer'")


def test_an_inside_out_block_is_repaired_with_a_warning():
    with pytest.warns(fdem.FdemWarning, match="inside"):
        shape = fdem.polyhedron(CUBE, [face[::-1] for face in FACES])
    assert shape.volume == pytest.approx(1.0)


def test_a_surface_that_splits_only_part_of_a_mesh_is_refused():
    import meshio
    from reference import kuhn_cube

    points, tets = kuhn_cube(2)
    faces = np.vstack([tets[:, c] for c in ([0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3])])
    on = (points[faces][:, :, 2] == 0.5).all(axis=1) & (points[faces][:, :, 0].max(axis=1) <= 0.5)
    seam = np.unique(np.sort(faces[on], axis=1), axis=0)
    mesh = meshio.Mesh(
        points, [("tetra", tets), ("triangle", seam)],
        cell_data={"gmsh:physical": [np.full(len(tets), 1), np.full(len(seam), 2)]},
        field_data={"rock": [1, 3], "seam": [2, 2]},
    )  # fmt: skip
    refused(lambda: fdem.Scene.from_mesh(mesh, fdem.Zoned(), ROCK, split="seam"), "seam")
    refused(lambda: fdem.Scene.from_mesh(mesh, fdem.Zoned(), ROCK, split="fault"), "fault")
