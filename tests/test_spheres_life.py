"""Beds of spheres and clumps: settling, restart, excavation, relaxation, loads, readout, pictures."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import assert_same_bits, everything, quietly

import fdem

R = 0.01
GRAIN = fdem.Elastic(density=2500, young=1e7, poisson=0.25)


def simulation(scene, integrator=None, **options):
    return quietly(fdem.Simulation, scene, integrator or fdem.Explicit(), progress=False, **options)


def grains(n, kind="spheres", seed=1):
    """Shapes of a loose lattice and the length of its side."""
    rng = np.random.default_rng(seed)
    pitch = 2.04 * R
    places = (np.stack(np.meshgrid(*3 * [np.arange(n)], indexing="ij"), -1).reshape(-1, 3) + 0.5) * pitch
    places += rng.uniform(-0.02, 0.02, places.shape) * R
    if kind == "spheres":
        shapes = [fdem.sphere(R, p) for p in places]
    elif kind == "sizes":
        shapes = [fdem.sphere(r, p) for r, p in zip(R * rng.uniform(0.5, 1.0, len(places)), places, strict=True)]
    else:
        d = np.array([0.3 * R, 0, 0])
        shapes = [fdem.clump([(p - d, 0.6 * R), (p + d, 0.6 * R)]) for p in places]
    return shapes, n * pitch


def bed(n=5, kind="spheres", law=None):
    """A box with grains above its floor."""
    scene = fdem.Scene()
    shapes, side = grains(n, kind)
    t = 0.03
    for lower, upper in (
        ((-t, -t, -t), (side + t, side + t, 0)),
        ((-t, -t, 0), (0, side + t, 2 * side)),
        ((side, -t, 0), (side + t, side + t, 2 * side)),
        ((0, -t, 0), (side, 0, 2 * side)),
        ((0, side, 0), (side, side + t, 2 * side)),
    ):
        scene.add(fdem.brick(lower, upper), fdem.Rigid(), GRAIN, fixed=True, group="box")
    scene.add(shapes, fdem.Rigid(), GRAIN, group="bed")
    scene.joint(law or fdem.Hertz(friction=26, restitution=0.3))
    return scene, side


@pytest.mark.parametrize("kind, n", [("spheres", 10), ("sizes", 7), ("clumps", 6)])
def test_a_bed_settles(kind, n):
    """1000 spheres (fewer of other kinds): none lost, the box carries the weight, the energy balance closes."""
    scene, side = bed(n, kind)
    sim = simulation(scene)
    sim.run(time=0.5)
    push = sim.history("box", "contact_force", component="z", every=20)
    sim.run(time=0.1)
    view = sim["bed"]
    weight = view.mass.sum() * 9.81
    assert ((view.position > 0) & (view.position < [side, side, 2 * side])).all()
    assert np.sqrt((view.velocity**2).sum(axis=1).mean()) < 0.02  # it fell with 1 m/s
    # what still rattles moves the centre of mass with accelerations of some 1e-3 g
    assert -push.values.sum(axis=1).mean() == pytest.approx(weight, rel=5e-3)
    # the step resolves a collision by ten steps
    assert sim.energy.closure < 5e-3
    assert sim.energy.friction > 0.0
    assert sim.energy.damping > 0.0


@pytest.mark.parametrize("kind", ["spheres", "sizes", "clumps"])
def test_a_bed_goes_on_bit_for_bit(kind, tmp_path):
    law = fdem.Hertz(friction=26, restitution=0.3, rolling=0.01 * R, twisting=0.01 * R)
    scene, _ = bed(4, kind, law)
    whole = simulation(scene)
    whole.cycle(700)
    whole.save(tmp_path / "state")
    whole.cycle(400)
    again = quietly(fdem.load, tmp_path / "state.npz" if (tmp_path / "state.npz").exists() else tmp_path / "state",
                    bed(4, kind, law)[0], fdem.Explicit(), progress=False)  # fmt: skip
    again.cycle(400)
    assert_same_bits(everything(whole), everything(again))


def test_the_same_run_has_the_same_bits():
    results = []
    for _ in range(2):
        sim = simulation(bed(4)[0])
        sim.cycle(600)
        results.append(everything(sim))
    assert_same_bits(*results)


def test_lengths_scaled_by_powers_of_two_have_the_same_bits():
    """Lengths times 2^10, densities, moduli and gravity such that times and strains stay: every digit the same."""
    results = []
    for scale in (1.0, 1024.0):
        scene = fdem.Scene(gravity=(0, 0, -9.75 * scale))
        scene.add(fdem.brick((-scale, -scale, -scale), (scale, scale, 0)), fdem.Rigid(), fixed=True)
        material = fdem.Elastic(density=2048, young=1e7 * scale**2, poisson=0.25)
        for place in ((0, 0, 0.125), (0.0625, 0.03125, 0.375), (-0.0625, 0.03125, 0.625)):
            scene.add(fdem.sphere(0.125 * scale, scale * np.array(place)), fdem.Rigid(), material)
        scene.joint(fdem.Hertz(friction=30, restitution=0.5))
        sim = simulation(scene, fdem.Explicit(dt=2.0**-13))
        sim.cycle(3000)
        results.append((sim.state.q / scale, sim.state.v.reshape(-1, 6)[:, 3:].copy()))
    for a, b in zip(*results, strict=True):
        np.testing.assert_array_equal(a, b)


def test_excavation_lets_the_rest_go_on():
    """Three balls on top of each other: without the lowest the others fall, without the highest they stay."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -0.1), (1, 1, 0)), fdem.Rigid(), fixed=True, name="floor")
    for i in range(3):
        scene.add(fdem.sphere(0.1, (0, 0, 0.1 + 0.2 * i)), fdem.Rigid(), GRAIN, name=f"ball{i}")
    scene.joint(fdem.Hertz(friction=30, restitution=0.2))
    sim = simulation(scene)
    sim.run(time=0.5)
    before = sim["ball0"].position, sim.energy.friction
    weight = sim["ball0"].mass * 9.81
    # 0.9 % of swinging is left after 0.5 s
    np.testing.assert_allclose(sim["ball0"].contact_force[2], weight, rtol=1e-2)
    assert sim.excavate("ball2") == ["ball2"]
    np.testing.assert_array_equal(sim["ball0"].position, before[0])
    assert sim.pair_force("floor", "ball0")[2] == pytest.approx(3 * weight, rel=1e-2)
    sim.run(time=0.3)
    assert sim.pair_force("floor", "ball0")[2] == pytest.approx(2 * weight, rel=1e-2)
    np.testing.assert_allclose(sim["ball0"].position[:2], 0.0, atol=1e-9)
    sim.excavate("ball0", over=50)
    sim.cycle(5)
    assert sim["ball1"].acceleration[2] > -9.81  # carried by what is being taken away
    sim.run(time=0.3)
    assert sim["ball1"].position[2] < 0.12


def test_relaxation_of_a_pile_of_balls():
    """Four balls, one on three: equilibrium by scaled masses; the floor carries the weight."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -0.1), (1, 1, 0)), fdem.Rigid(), fixed=True, name="floor")
    r = 0.1
    corners = 2 * r / np.sqrt(3) * np.array([[np.cos(a), np.sin(a)] for a in 2 * np.pi / 3 * np.arange(3)])
    for i, (x, y) in enumerate(corners):
        scene.add(fdem.sphere(r, (x, y, r)), fdem.Rigid(), GRAIN, name=f"low{i}", group="low")
    top = scene.add(fdem.sphere(r, (0, 0, r + 2 * r * np.sqrt(2 / 3))), fdem.Rigid(), GRAIN, name="top")
    scene.joint(fdem.Coulomb(kn=1e7, ks=5e6, friction=35, rolling=0.02 * r))
    sim = simulation(scene, fdem.Relaxation())
    report = sim.solve(ratio=1e-6)
    assert report.reason == "equilibrium"
    weight = sim["top"].mass * 9.81
    assert -sim["floor"].contact_force[2] == pytest.approx(4 * weight, rel=1e-5)
    # by symmetry each of the three takes a third
    for i in range(3):
        assert sim.pair_force(f"low{i}", top)[2] == pytest.approx(weight / 3, rel=1e-4)
    after = simulation(scene, fdem.Explicit(), start=sim)
    after.run(time=0.05)
    assert np.abs(after["top"].displacement).max() < 1e-5 * r


def test_a_clump_of_one_sphere_moves_as_the_sphere():
    """Through the rigid batch, with orientation, and through that of spheres: the same path to round-off."""
    paths = []
    for shape, body in (
        (fdem.sphere(0.1, (0, 0, 0.12)), fdem.Rigid()),
        (fdem.sphere(0.1, (0, 0, 0.12)), fdem.Rigid(orientation=True)),
        (fdem.clump([((0, 0, 0.12), 0.1)]), fdem.Rigid()),
    ):
        scene = fdem.Scene()
        scene.add(fdem.brick((-1, -1, -0.1), (1, 1, 0)), fdem.Rigid(), fixed=True)
        ball = scene.add(shape, body, GRAIN, velocity=(1, 0.2, 0), angular_velocity=(0, 3, 1))
        scene.joint(fdem.Hertz(friction=20, restitution=0.6))
        sim = simulation(scene, fdem.Explicit(dt=1e-4))
        sim.cycle(4000)
        view = sim[ball]
        paths.append(np.concatenate([view.position, view.velocity, view.angular_velocity, view.rotation_vector]))
        if body.orientation:
            turn = view.rotation
            np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
            assert abs(turn[0, 0]) < 0.9999
    np.testing.assert_allclose(paths[1], paths[0], atol=1e-9)
    np.testing.assert_allclose(paths[2], paths[0], atol=1e-9)


def test_a_clump_rests_on_its_spheres():
    """Three feet: each carries its part of the weight of the union."""
    feet = [((0, 0, 0), 0.1), ((0.3, 0, 0), 0.1), ((0, 0.3, 0), 0.1), ((0.1, 0.1, 0.05), 0.14)]
    shape = fdem.clump(feet)
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -0.3), (1, 1, -0.1)), fdem.Rigid(), fixed=True)
    clump = scene.add(shape, fdem.Rigid(), GRAIN)
    scene.joint(fdem.Coulomb(kn=1e8, ks=1e8, friction=30))
    sim = simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-6).converged
    table = sim.contact_table()
    assert len(table["gap"]) == 3
    weight = GRAIN.density * shape.volume * 9.81
    force, place = table["force"][:, 2], table["position"]
    assert force.sum() == pytest.approx(weight, rel=1e-5)
    np.testing.assert_allclose(force @ place[:, :2] / weight, shape.centroid[:2], atol=1e-5)
    assert sim[clump].mass == pytest.approx(GRAIN.density * shape.volume)


def test_loads_on_spheres():
    scene = fdem.Scene(gravity=(0, 0, 0))
    ball = scene.add(fdem.sphere(0.1, (0, 0, 0)), fdem.Rigid(), GRAIN, name="ball")
    turned = scene.add(fdem.sphere(0.1, (1, 0, 0)), fdem.Rigid(orientation=True), GRAIN, name="turned")
    driven = scene.add(fdem.sphere(0.1, (2, 0, 0)), fdem.Rigid(), fixed=True, velocity=(0, 0, 1), name="driven")
    held = scene.add(fdem.sphere(0.1, (3, 0, 0)), fdem.Rigid(), GRAIN, name="held")
    scene.joint(fdem.Hertz(friction=10, young=1e7, poisson=0.3))
    scene.apply(fdem.Force((2.0, 0, 0)), ball)
    scene.apply(fdem.Moment((0, 0, 0.5)), ball)
    scene.apply(fdem.Moment((0, 0, 0.5)), turned)
    fix = scene.fix(held, component=("x", "rotation"))
    scene.apply(fdem.Force((3.0, 1.0, 0)), held)
    sim = simulation(scene, fdem.Explicit(dt=1e-3))
    sim.run(time=0.2)
    m, moment = sim[ball].mass, 0.4 * sim[ball].mass * 0.01
    np.testing.assert_allclose(sim[ball].velocity, (0.4 / m, 0, 0), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(sim[ball].angular_velocity, (0, 0, 0.1 / moment), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(sim[turned].angular_velocity, (0, 0, 0.1 / moment), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(sim[driven].displacement, (0, 0, 0.2), rtol=1e-12)
    np.testing.assert_allclose(sim[held].velocity, (0, 0.2 / m, 0), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(sim[fix].force, (-3.0, 0, 0), atol=1e-12)
    # a constant force over a path: the work is the kinetic energy (to dt^2 where a couple of forces turns gridpoints)
    assert sim.energy.closure < 1e-6
    with pytest.raises(fdem.UnsupportedError, match="orientation"):
        simulation_with = fdem.Scene(gravity=(0, 0, 0))
        one = simulation_with.add(fdem.sphere(0.1), fdem.Rigid(), GRAIN)
        simulation_with.apply(fdem.Force((1, 0, 0), at=(0, 0, 0.1)), one)
        simulation(simulation_with)


def test_what_views_of_spheres_give():
    scene, _ = bed(3)
    sim = simulation(scene)
    sim.run(time=0.1)
    view = sim["bed"]
    assert view.position.shape == view.velocity.shape == view.contact_force.shape == (27, 3)
    assert view.generalised_mass.shape == (27, 6, 6)
    np.testing.assert_allclose(
        view.generalised_mass[0], np.diag([*3 * [view.mass[0]], *3 * [0.4 * view.mass[0] * R**2]])
    )
    assert view.generalised_displacement.shape == (27, 6)
    np.testing.assert_array_equal(view.generalised_displacement[:, 3:], view.rotation_vector)
    np.testing.assert_allclose(view.residual, 0.0, atol=1e-12)
    np.testing.assert_allclose(view.inertia, 0.4 * view.mass[0] * R**2 * np.broadcast_to(np.eye(3), (27, 3, 3)))
    with pytest.raises(fdem.UnsupportedError, match="orientation"):
        _ = view.rotation
    with pytest.raises(fdem.UnsupportedError, match="stress"):
        _ = view.stress
    text = sim.describe()
    for said in ("27 spheres without orientation", "no orientation is kept", "simplified Mindlin", "27 in contact"):
        assert said in text, text
    table = sim.contact_table()
    assert (table["block_a"] < table["block_b"]).all()
    assert (table["gap"] < 0).all()
    # the table says what the blocks feel
    total = np.zeros((len(sim.model.names), 3))
    np.add.at(total, table["block_b"], table["force"])
    np.add.at(total, table["block_a"], -table["force"])
    mass = np.array([sim.model.mass[i] if not sim.model.fixed[i] else 0.0 for i in range(sim.model.n_blocks)])
    free = ~sim.model.fixed
    acceleration = sim.block_motions(sim.acceleration)[0]
    np.testing.assert_allclose(
        (total + mass[:, None] * [0, 0, -9.81])[free], (mass[:, None] * acceleration)[free], atol=1e-12
    )


def test_joint_rules_choose_the_law_of_spheres():
    scene = fdem.Scene(gravity=(0, 0, 0))
    for name, x in (("a", 0.0), ("b", 0.199), ("c", 0.398)):
        scene.add(fdem.sphere(0.1, (x, 0, 0)), fdem.Rigid(), GRAIN, name=name, group="left" if name != "c" else "right")
    scene.joint(fdem.Coulomb(kn=1e7, ks=0, friction=0))
    scene.joint(fdem.Coulomb(kn=3e7, ks=0, friction=0), between=("left", "right"))
    sim = simulation(scene)
    area = np.pi * 0.01
    assert sim.pair_force("a", "b")[0] == pytest.approx(1e7 * area * 1e-3, rel=1e-9)
    assert sim.pair_force("b", "c")[0] == pytest.approx(3e7 * area * 1e-3, rel=1e-9)
    assert sim.contact_table()["joint"].tolist() == [0, 1]


def bad_scene(shape_a, shape_b, law, material=GRAIN, body=None):
    scene = fdem.Scene()
    scene.add(shape_a, body or fdem.Rigid(), material, name="a")
    scene.add(shape_b, body or fdem.Rigid(), material, name="b")
    if law is not None:
        scene.joint(law)
    return scene


BALLS = fdem.sphere(0.1, (0, 0, 0)), fdem.sphere(0.1, (0.2, 0, 0))
BOXES = fdem.brick((0, 0, 0), (1, 1, 1)), fdem.brick((0, 0, 1), (1, 1, 2))


@pytest.mark.parametrize(
    "shapes, law, material, error, words",
    [
        (BALLS, None, GRAIN, fdem.JointError, "no joint law"),
        (BALLS, fdem.Hertz(friction=30), fdem.Elastic(density=1), fdem.SceneError, "young and poisson are missing"),
        (BALLS, fdem.Bonded(), GRAIN, fdem.UnsupportedError, "Coulomb and Hertz"),
        (BALLS, fdem.Coulomb(kn=1e7, friction=30, cohesion=1.0), GRAIN, fdem.UnsupportedError, "cohesion"),
        (BOXES, fdem.Hertz(friction=30), GRAIN, fdem.JointError, "Hertz is for spheres"),
    ],
)
def test_what_laws_of_spheres_refuse(shapes, law, material, error, words):
    with pytest.raises(error, match=words):
        simulation(bad_scene(*shapes, law, material))


def test_what_spheres_refuse():
    scene = fdem.Scene()
    with pytest.raises(fdem.SceneError, match="icosphere"):
        scene.add(fdem.sphere(0.1), fdem.Zoned(), GRAIN)
    with pytest.raises(fdem.SceneError, match="one density"):
        scene.add(fdem.sphere(0.1), fdem.Rigid(), fdem.Elastic(density=lambda x: 1000.0 + x[:, 0]))
    with pytest.raises(fdem.SceneError, match="kn"):
        fdem.Hertz(friction=30, kn=1e9)
    with pytest.raises(fdem.SceneError, match="give both or none"):
        fdem.Hertz(friction=30, young=1e9)
    with pytest.raises(fdem.SceneError, match="restitution"):
        fdem.Hertz(friction=30, restitution=1.5)


def test_pictures_and_files_show_spheres(tmp_path):
    """Every sphere is a closed surface of its radius about its centre; ParaView gets the centres and radii."""
    pytest.importorskip("pyvista")
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -0.2), (1, 1, 0)), fdem.Rigid(), GRAIN, fixed=True, group="floor")
    scene.add(fdem.brick((-1, 0.5, 0), (1, 1, 0.3)), fdem.Zoned(0.3), GRAIN, fixed=True, name="wall")
    scene.add(fdem.sphere(0.1, (0, 0, 0.0999)), fdem.Rigid(), GRAIN, name="ball")
    pair = [((0.5, 0, 0.2), 0.12), ((0.5, 0.1, 0.2), 0.1)]
    scene.add(fdem.clump(pair), fdem.Rigid(), GRAIN, angular_velocity=(0, 0, 1), name="pair")
    scene.joint(fdem.Hertz(friction=26, restitution=0.3))
    sim = simulation(scene, fdem.Explicit(dt=1e-5))
    frames = fdem.Frames(tmp_path / "run.vtkhdf", every=50)
    sim.observe(frames)
    sim.cycle(100)
    mesh, block = sim.mesh(), sim.model.names.index
    centres = [sim["ball"].position, *sim.positions()[sim.model.balls[1:]]]
    for name, parts in (("ball", ((centres[0], 0.1),)), ("pair", ((centres[1], 0.12), (centres[2], 0.1)))):
        surface = mesh.extract_cells(mesh.cell_data["block"] == block(name)).extract_surface(algorithm=None)
        assert surface.is_manifold and surface.n_open_edges == 0
        distance = np.array([np.linalg.norm(surface.points - c, axis=1) - r for c, r in parts])
        assert np.abs(distance).min(axis=0).max() < 1e-7  # pyvista's sphere is in single precision
        inside = sum(4 / 3 * np.pi * r**3 for _, r in parts)
        assert 0.97 * inside < surface.volume < inside
        assert np.isnan(mesh.cell_data["stress"][mesh.cell_data["block"] == block(name)]).all()
    assert np.linalg.norm(centres[2] - pair[1][0]) > 0.5e-4  # the clump has turned
    for scalars, options in (("velocity", {}), ("group", {"clip": ((1, 0, 0), (0.5, 0, 0))}), ("traction", {})):
        assert sim.plot(tmp_path / f"{scalars}.png", scalars, **options).stat().st_size > 10_000
    seen = last_frame(tmp_path / "run.vtkhdf")
    balls = sim.model.balls
    np.testing.assert_allclose(seen.point_data["radius"][balls], [0.1, 0.12, 0.1], rtol=1e-7)
    np.testing.assert_array_equal(np.sort(balls), np.flatnonzero(seen.point_data["radius"]))
    np.testing.assert_allclose(seen.points[balls], sim.positions()[balls], rtol=1e-14)
    assert (seen.celltypes == 1).sum() == 3 and seen.cell_data["block"][seen.celltypes == 1].tolist() == [2, 3, 3]


def last_frame(path):
    """Last frame of a file, as VTK and with it ParaView reads it."""
    pv = pytest.importorskip("pyvista")
    pytest.importorskip("h5py")
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    reader.UpdateTimeStep(reader.GetOutputInformation(0).Get(reader.GetExecutive().TIME_STEPS())[-1])
    return pv.wrap(reader.GetOutput())
