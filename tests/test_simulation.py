"""The simulation: time, equilibrium, energy, histories, views, excavation, and the scenes of the API page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scenes import STONE, pile, simulation, staged

import fdem

G = 9.81
TUNNEL = Path(__file__).parent.parent / "meshes" / "tunnel.msh"


def free_block(body=None, **given):
    scene = fdem.Scene()
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), body or fdem.Rigid(), STONE, name="cube", **given)
    return scene, block


def column(n=3, body=None, kn=1e9):
    """Cubes on a base; closed form: joint i carries the weight above it."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), name="base", fixed=True)
    for i in range(n):
        scene.add(fdem.brick((0, 0, i), (1, 1, i + 1)), body or fdem.Rigid(), STONE, name=f"cube {i}", group="column")
    scene.joint(fdem.Coulomb(kn=kn, ks=kn / 2, friction=30))
    return scene


# ---------------------------------------------------------------------------------------------------------------------
# time


@pytest.mark.parametrize("body", [fdem.Rigid(), fdem.Zoned()])
def test_run_ends_at_the_time_asked_for(body):
    scene, block = free_block(body, velocity=(1, 0, 2))
    sim = simulation(scene, fdem.Explicit(dt=1e-4))
    for time in (0.01, 0.00123, 0.0, 1e-7):
        before = sim.time
        sim.run(time=time)
        assert sim.time == pytest.approx(before + time, rel=1e-12)
    t = sim.time
    assert_allclose(sim[block].displacement, [t, 0, 2 * t - G * t * t / 2], rtol=1e-6, atol=1e-12)
    assert_allclose(sim[block].velocity, [1, 0, 2 - G * t], rtol=1e-9, atol=1e-9)
    assert_allclose(sim[block].acceleration, [0, 0, -G], rtol=1e-9, atol=1e-9)


def test_nothing_limits_the_step_in_free_flight():
    scene, block = free_block()
    sim = simulation(scene)
    assert sim.dt == np.inf
    sim.run(time=2.0)
    assert_allclose(sim[block].displacement, [0, 0, -G * 2], rtol=1e-9)


def test_cycle_counts_steps():
    scene, _ = free_block()
    sim = simulation(scene, fdem.Explicit(dt=1e-3))
    sim.cycle(7)
    sim.cycle(0)
    assert (sim.steps, sim.time) == (7, pytest.approx(7e-3))


def test_reset_sets_to_zero_what_it_says():
    sim = simulation(pile())
    sim.cycle(300)
    assert sim["high"].displacement[0] != 0
    sim.reset()
    assert_allclose(sim.displacements(), 0.0, atol=0)
    assert_allclose(sim["high"].displacement, 0.0, atol=0)
    assert_allclose(sim["high"].rotation_vector, 0.0, atol=0)
    position = sim.positions()
    sim.reset("velocity")
    assert_allclose(sim["high"].velocity, 0.0, atol=0)
    assert_allclose(sim.velocities(), 0.0, atol=0)
    sim.reset("time")
    assert sim.time == 0.0
    assert np.abs(sim.contact_table()["slip"]).max() > 0
    sim.reset("slip")
    assert_allclose(sim.contact_table()["slip"], 0.0, atol=1e-15)
    assert (sim.positions() == position).all()
    sim.cycle(100)
    assert sim.energy.closure < 2e-2, "the ledger survived the reset"


# ---------------------------------------------------------------------------------------------------------------------
# equilibrium and reports


@pytest.mark.parametrize("body", [fdem.Rigid(), fdem.Zoned(), fdem.Zoned(size=0.6, strain="small")])
def test_a_column_comes_to_rest_on_its_weight(body):
    scene = column(3, body)
    sim = simulation(scene, fdem.Relaxation())
    report = sim.solve(ratio=1e-6)
    assert (report.reason, report.converged) == ("equilibrium", True)
    assert report.ratio <= 1e-6
    assert report.cycles == sim.steps > 0
    assert report.wall_time > 0
    weight = 2500 * G
    for i in range(3):
        below = "base" if i == 0 else f"cube {i - 1}"
        assert_allclose(sim.pair_force(below, f"cube {i}"), [0, 0, (3 - i) * weight], rtol=1e-5, atol=1e-5 * weight)
        assert_allclose(sim.pair_force(f"cube {i}", below), [0, 0, -(3 - i) * weight], rtol=1e-5, atol=1e-5 * weight)
        assert_allclose(sim.pair_moment(below, f"cube {i}"), 0.0, atol=1e-3 * weight)
    assert_allclose(sim.pair_force("base", "column")[2], 3 * weight, rtol=1e-5)
    assert_allclose(sim["cube 1"].contact_force, [0, 0, weight], rtol=1e-4, atol=1e-4 * weight)


def test_pair_moment_is_about_the_centroid_of_the_second():
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((0, 0, -1), (3, 1, 0)), fdem.Rigid(), name="base", fixed=True)
    scene.add(fdem.brick((1, 0, 0), (2, 1, 1)), fdem.Rigid(), STONE, name="cube")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    scene.apply(fdem.Force((0, 0, -1e4), at=(1.75, 0.5, 1)), "cube")
    sim = simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-8).converged
    assert_allclose(sim.pair_moment("base", "cube"), [0, -2500, 0], rtol=1e-4, atol=0.5)


def test_solve_gives_up_after_max_cycles_and_knows_a_collapse():
    sim = simulation(column(), fdem.Relaxation())
    report = sim.solve(ratio=1e-14, max_cycles=60)
    assert (report.reason, report.converged, report.cycles) == ("cycles", False, 60)
    assert sim.solve(ratio=1e-6).converged
    again = sim.solve(ratio=1e-6)
    assert again.converged
    assert again.cycles == 0
    scene = fdem.Scene(gravity=G * np.array([np.sin(0.8), 0, -np.cos(0.8)]))
    scene.add(fdem.brick((-1, -1, -1), (40, 2, 0)), fdem.Rigid(), name="base", fixed=True)
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE, name="cube")
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=20))
    slide = simulation(scene, fdem.Relaxation())
    report = slide.solve(ratio=1e-5, max_cycles=30_000)
    assert report.reason == "collapse", report
    assert not report.converged


def test_an_explicit_run_with_local_damping_solves_too():
    sim = simulation(column(2), fdem.Explicit(damping=fdem.Local(0.8)))
    assert sim.solve(ratio=1e-5, max_cycles=20_000).converged
    assert_allclose(sim.pair_force("base", "cube 0")[2], 5000 * G, rtol=1e-3)


# ---------------------------------------------------------------------------------------------------------------------
# energy, instability


def test_the_energy_balance_closes():
    sim = simulation(pile(damping=0.1))
    sim.run(time=0.2)
    energy = sim.energy
    assert energy.friction > 0
    assert energy.damping > 0
    assert energy.closure < 1e-3
    for name in ("kinetic", "strain", "joint", "potential", "friction", "damping", "work"):
        assert np.isfinite(getattr(energy, name)), name


def test_the_energy_balance_counts_the_work_of_loads_and_platens():
    scene = column(1, fdem.Zoned())
    scene.apply(fdem.Force((0, 0, -5e4)), "cube 0", factor=lambda t: min(t / 0.05, 1.0))
    scene.add(
        fdem.brick((0, 0, 1), (1, 1, 1.2)), fdem.Rigid(), STONE, name="platen", fixed=True, velocity=(0, 0, -1e-3)
    )
    sim = simulation(scene, fdem.Explicit(damping=fdem.Rayleigh(mass=20.0)))
    sim.run(time=0.1)
    assert sim.energy.work > 0
    assert sim.energy.closure < 1e-2


def test_the_ledger_can_be_left_out():
    with_it, without = (simulation(pile(), energy=energy) for energy in (True, False))
    for sim in (with_it, without):
        sim.cycle(200)
    assert (with_it.positions() == without.positions()).all(), "bookkeeping must not touch the motion"
    assert without.ledger is None
    with pytest.raises(fdem.UnsupportedError, match="energy=False"):
        assert without.energy is None
    assert "ledger: left out" in without.describe()


@pytest.mark.parametrize("body", [fdem.Rigid(), fdem.Zoned()])
def test_an_unstable_step_raises_and_names_step_block_and_gridpoint(body):
    stable = simulation(column(2, body))
    with pytest.warns(fdem.FdemWarning, match=r"dt = .* is above"):
        sim = fdem.Simulation(column(2, body), fdem.Explicit(dt=2.5 * stable.dt / 0.8), progress=False)
    with pytest.raises(fdem.SolveError) as caught:
        sim.cycle(50_000)
    if isinstance(caught.value, fdem.UnstableError):
        text = str(caught.value)
        assert "step " in text
        assert "gridpoint" in text
        assert "block 'cube" in text
    else:
        assert isinstance(caught.value, fdem.OverlapError)
        assert "'cube" in str(caught.value)


def test_an_unstable_deformable_block_raises():
    scene, _ = free_block(fdem.Zoned(size=0.4), velocity=(0, 0, 1))
    scene.fix("cube", where=lambda x: x[:, 2] < 1e-9)
    limit = simulation(scene).dt / 0.8
    sim = simulation(scene, fdem.Explicit(dt=2.0 * limit))
    with pytest.raises(fdem.UnstableError, match=r"step \d+.*gridpoint \d+ of block 'cube'"):
        sim.cycle(20_000)
    held = simulation(scene, fdem.Explicit(dt=0.99 * limit))
    held.cycle(3000)
    assert np.isfinite(held.positions()).all()


def test_a_value_that_is_not_finite_is_found():
    scene = fdem.Scene()
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE, name="cube")
    sim = simulation(scene, fdem.Explicit(dt=1e-3))
    sim.cycle(1)
    sim.state.v[2] = np.nan
    with pytest.raises(fdem.UnstableError, match=r"not finite.*'cube'"):
        sim.cycle(5)


# ---------------------------------------------------------------------------------------------------------------------
# histories and observers


def test_histories_by_selector_gridpoint_function_and_name():
    scene, block = free_block(velocity=(1, 0, 0))
    point = scene.gridpoint((1, 1, 1), target=block)
    sim = simulation(scene, fdem.Explicit(dt=1e-3))
    x = sim.history(block, "displacement", component="x", every=10)
    corner = sim.history(point, "position", component="z", every=5)
    own = sim.history(lambda s: s.time**2, every=20)
    kinetic = sim.history("kinetic", every=50)
    group = sim.history([block], "velocity", every=fdem.Every(time=0.025))
    sim.cycle(100)
    assert x.steps.tolist() == list(range(0, 101, 10))
    assert_allclose(x.values, x.time, rtol=1e-12)
    assert x.unit == "m"
    assert_allclose(corner.values, 1 - G * corner.time**2 / 2, rtol=1e-6)
    assert_allclose(own.values, own.time**2)
    assert_allclose(kinetic.values, 1250 * (1 + (G * kinetic.time) ** 2), rtol=1e-6)
    assert_allclose(group.time, np.arange(5) * 0.025, atol=1e-12)
    assert group.values.shape == (5, 1, 3)
    assert x.to_numpy().shape == (11, 2)


def test_an_observer_needs_only_next_and_record():
    class Watcher:
        def __init__(self):
            self.seen = []

        def next(self, step, t):
            return 4 - step % 4

        def record(self, sim):
            self.seen.append(sim.steps)

    scene, _ = free_block()
    sim = simulation(scene, fdem.Explicit(dt=1e-3))
    watcher = sim.observe(Watcher())
    sim.cycle(9)
    sim.run(time=0.003)
    assert watcher.seen == [0, 4, 8, 12]


def test_checkpoints_are_written_while_it_runs(tmp_path):
    scene, _ = free_block()
    sim = simulation(scene, fdem.Explicit(dt=1e-3))
    sim.observe(fdem.Checkpoint(tmp_path / "run.npz", every=fdem.Every(time=0.01)))
    sim.run(time=0.025)
    again = fdem.load(tmp_path / "run.npz", free_block()[0], fdem.Explicit(dt=1e-3))
    assert again.time == pytest.approx(0.02)


# ---------------------------------------------------------------------------------------------------------------------
# views


def test_views_of_one_block_and_of_many():
    sim = simulation(pile())
    sim.cycle(50)
    one, many = sim["high"], sim["free"]
    n = len(many.mass)
    assert n == 3
    shapes = {
        "position": (3,), "displacement": (3,), "velocity": (3,), "acceleration": (3,), "rotation": (3, 3),
        "rotation_vector": (3,), "angular_velocity": (3,), "angular_momentum": (3,), "inertia": (3, 3),
        "contact_force": (3,),
    }  # fmt: skip
    for name, shape in shapes.items():
        assert getattr(one, name).shape == shape, name
        assert getattr(many, name).shape == (n, *shape), name
        with pytest.raises(ValueError, match="read-only"):
            getattr(one, name)[...] = 0.0
    assert one.generalised_displacement.shape == one.generalised_force.shape == (6,)
    assert one.generalised_mass.shape == (6, 6)
    assert_allclose(one.residual, 0.0, atol=1e-6 * np.abs(one.generalised_force).max())
    assert one.gridpoints.shape == (8, 3)
    for name in ("stress", "strain", "zones", "zone_stress", "zone_strain", "zone_rotation", "gridpoint_mass"):
        with pytest.raises(fdem.UnsupportedError, match="'high'"):
            getattr(one, name)
    low = sim["low"]
    g, m = len(low.gridpoints), len(low.zones)
    assert low.zones.max() == g - 1
    assert low.gridpoint_displacement.shape == (g, 3)
    assert low.gridpoint_mass.sum() == pytest.approx(low.mass)
    assert low.zone_stress.shape == low.zone_strain.shape == (m, 6)
    assert low.zone_rotation.shape == (m, 3)
    assert low.stress.shape == low.strain.shape == (6,)
    assert low.generalised_mass.shape == (3 * g, 3 * g)
    assert_allclose(low.residual, 0.0, atol=1e-6 * np.abs(low.generalised_force).max())


def test_loads_and_supports_tell_their_force():
    scene = column(2)
    fix = scene.fix("cube 0", component="x")
    load = scene.apply(fdem.Force((3e3, 0, -2e3)), "column", factor=0.5)
    sim = simulation(scene, fdem.Relaxation())
    assert_allclose(sim[load].force, [1.5e3, 0, -1e3], rtol=1e-12)
    assert sim[load].factor == 0.5
    sim[load].factor = 2.0
    assert_allclose(sim[load].force, [6e3, 0, -4e3], rtol=1e-12)
    assert scene.loads[0].factor == 0.5, "the scene stays as it was"
    assert sim.solve(ratio=1e-7).converged
    on_base = sim.pair_force("base", "cube 0")
    assert_allclose(sim[fix].force[0] + on_base[0], -6e3, rtol=1e-4)
    assert_allclose(on_base[2], 5000 * G + 4e3, rtol=1e-5)
    with pytest.raises(fdem.SceneError, match="not applied"):
        simulation(column(2))[load]


def test_applied_loads_act_from_then_on():
    sim = simulation(column(1), fdem.Relaxation())
    assert sim.solve(ratio=1e-7).converged
    push = sim.apply(fdem.Pressure(1e4), "cube 0", where=lambda x: x[:, 2] > 1 - 1e-9)
    assert_allclose(sim[push].force, [0, 0, -1e4], rtol=1e-9, atol=1e-3)
    assert sim.solve(ratio=1e-7).converged
    assert_allclose(sim.pair_force("base", "cube 0")[2], 2500 * G + 1e4, rtol=1e-5)
    sim[push].factor = 0.0
    assert sim.solve(ratio=1e-7).converged
    assert_allclose(sim.pair_force("base", "cube 0")[2], 2500 * G, rtol=1e-5)


def test_describe_lists_what_is_there_and_what_is_left_out():
    scene, _ = free_block()
    scene.gravity = np.zeros(3)
    text = simulation(scene).describe()
    for words in (
        "1 blocks",
        "nothing limits it",
        "contacts: left out",
        "zones: left out",
        "loads: left out",
        "weight: left out",
    ):
        assert words in text, words
    text = simulation(pile()).describe()
    for words in (
        "4 blocks",
        "integrator: Explicit",
        "1 zoned, 2 rigid",
        "1 fixed",
        "limit",
        "set by block",
        "pairs",
        "in-situ stress",
    ):
        assert words in text, words


# ---------------------------------------------------------------------------------------------------------------------
# excavation


def test_a_release_takes_the_tractions_away_gradually():
    scene = column(2, kn=1e9)
    sim = simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-8).converged
    weight = 2500 * G
    assert sim.excavate("cube 1", over=100) == ["cube 1"]
    assert "cube 1" not in sim.model.names
    released = [load for load in sim.system.loads if type(load).__name__ == "Release"]
    totals = []
    for _ in range(5):
        sim.forces()
        totals.append(released[0].total[2])
        sim.cycle(25)
    assert_allclose(totals, -weight * np.array([1, 0.75, 0.5, 0.25, 0]), rtol=1e-5, atol=1e-9)
    assert sim.solve(ratio=1e-7).converged
    assert_allclose(sim.pair_force("base", "cube 0")[2], weight, rtol=1e-5)
    with pytest.raises(fdem.SceneError, match="still there"):
        sim.excavate("cube 1")
    with pytest.raises(fdem.SceneError, match="removed"):
        sim["cube 1"]


def test_a_release_at_once_jumps_and_one_over_cycles_does_not():
    ratios = []
    for over in (0, 200):
        sim = simulation(column(2), fdem.Relaxation())
        sim.solve(ratio=1e-8)
        sim.excavate("cube 1", over=over)
        ratios.append(sim.ratio)
    assert ratios[0] > 0.4
    assert ratios[1] < 1e-6


def test_an_opening_through_jointed_rock_is_excavated_in_stages():
    scene = staged()
    rock = scene.select_blocks("rock")
    sim = simulation(scene, fdem.Relaxation())
    first = sim.solve(ratio=1e-5, max_cycles=20_000)
    assert first.converged, first
    before = sim.positions().copy()
    sim.reset("displacement")
    gone = sim.excavate("opening", over=100)
    assert set(gone) == {b.name for b in rock if b.group == "opening"}
    assert len(gone) >= 2
    report = sim.solve(ratio=1e-5, max_cycles=20_000)
    assert report.converged, report
    assert 0 < np.abs(sim.displacements()).max() < 0.01
    assert len(sim.positions()) < len(before)
    assert sim.energy.closure < 0.05


def test_histories_of_removed_blocks_end_and_the_run_goes_on(tmp_path):
    sim = simulation(pile())
    one = sim.history("side", "displacement", component="x", every=5)
    group = sim.history("free", "velocity", every=5)
    point = sim.history(sim.scene.gridpoint((1.5, 0.5, 0.4), "side"), "position", every=5)
    other = sim.history("low", "velocity", component="z", every=5)
    sim.cycle(10)
    with pytest.warns(fdem.FdemWarning, match="ends here"):
        sim.excavate("side", over=7)
    sim.cycle(10)
    assert [h.steps[-1] for h in (one, group, point, other)] == [10, 10, 10, 20]
    with pytest.raises(fdem.SceneError, match="removed"):
        sim[sim.scene.gridpoint((1.5, 0.5, 0.4), "side")]


def test_glued_faces_hold_what_friction_would_not():
    def hanging(law):
        scene = fdem.Scene()
        scene.add(fdem.brick((0, 0, 1), (1, 1, 2)), fdem.Rigid(), name="roof", fixed=True)
        scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE, name="cube")
        scene.joint(law)
        return simulation(scene, fdem.Explicit(damping=fdem.Local(0.7)))

    glued = hanging(fdem.Bonded(kn=1e9, ks=5e8))
    assert glued.solve(ratio=1e-6).converged
    assert_allclose(glued.pair_force("roof", "cube"), [0, 0, 2500 * G], rtol=1e-5, atol=0.1)
    weak = hanging(fdem.Bonded(kn=1e9, ks=5e8, tension=1e4))
    weak.run(time=0.2)
    assert weak["cube"].displacement[2] < -0.02


# ---------------------------------------------------------------------------------------------------------------------
# scenes of the API page


def test_api_scene_1_a_rigid_block_on_an_incline():
    slope, phi = np.radians(35.0), 30.0
    g = 9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)])
    scene = fdem.Scene(gravity=g)
    scene.add(fdem.brick((-1, -1, -0.5), (9, 1, 0)), fdem.Rigid(), name="base", fixed=True)
    block = scene.add(fdem.brick((0, -0.5, 0), (1, 0.5, 1)), fdem.Rigid(), fdem.Elastic(density=2500), name="block")
    scene.joint(fdem.Coulomb(kn=5e9, ks=2e9, friction=phi))
    sim = fdem.Simulation(scene, fdem.Explicit())
    slip = sim.history(block, "displacement", component="x", every=10)
    sim.run(time=0.5)
    exact = 9.81 * (np.sin(slope) - np.cos(slope) * np.tan(np.radians(phi)))
    late = slip.time > 0.1
    # gravity comes at once and leaves a small speed: the acceleration is what friction decides
    assert_allclose(2 * np.polyfit(slip.time[late], slip.values[late], 2)[0], exact, rtol=5e-3)
    assert sim.energy.closure < 5e-3


def test_api_scene_3_an_impact_on_a_zoned_beam(tmp_path):
    steel = fdem.Elastic(density=7850, young=200e9, poisson=0.3)
    scene = fdem.Scene()
    beam = scene.add(fdem.brick((0, 0, 0), (4, 0.2, 0.3)), fdem.Zoned(size=0.15), steel, name="beam")
    scene.fix(beam, where=lambda x: np.isclose(x[:, 0], 0) | np.isclose(x[:, 0], 4))
    scene.add(fdem.icosphere(0.1, centre=(2, 0.1, 0.405)), fdem.Rigid(), steel, velocity=(0, 0, -5))
    scene.joint(fdem.Coulomb(kn=2e11, ks=1e11, friction=0))
    sim = simulation(scene)
    mid = sim.history(scene.gridpoint(near=(2, 0.1, 0), target=beam), "displacement", component="z", every=20)
    pytest.importorskip("h5py")
    frames = fdem.Frames(tmp_path / "impact.vtkhdf", every=fdem.Every(time=1e-3))
    sim.observe(frames)
    sim.run(time=0.004)
    assert mid.values.min() < -1e-4
    assert len(frames) == 5
    assert sim.energy.closure < 1e-3


def tunnel():
    granite = fdem.Elastic(density=2700, young=40e9, poisson=0.25)
    scene = fdem.Scene.from_mesh(TUNNEL, fdem.Zoned(), {"rock": granite, "stage_*": granite}, split="fault")
    scene.joint(fdem.Coulomb(kn=20e9, ks=10e9, friction=30, cohesion=0.1e6), "fault")
    scene.apply(fdem.Stress(zz=lambda x: 27e3 * x[:, 2], k=(1.5, 1.0)))
    scene.fix("outer", component="normal")
    return scene


def test_api_scene_5_a_tunnel_from_an_imported_mesh(tmp_path):
    scene = tunnel()
    crown = scene.gridpoint(near=(0, 0, -100), target="rock")
    sim = simulation(scene, fdem.Relaxation())
    initial = sim.solve(ratio=1e-4, max_cycles=3000)
    assert initial.converged, initial
    # the stress given is near equilibrium: gravity of the material is 2 % less than its gradient
    assert np.abs(sim.displacements()).max() < 2e-4
    sim.reset("displacement")
    convergence = sim.history(crown, "displacement", component="z", every=50)
    for stage in ("stage_1", "stage_2"):
        sim.excavate(stage, over=100)
        report = sim.solve(ratio=1e-3, max_cycles=3000)
        assert report.converged, report
    # the crown goes where the high horizontal stress squeezes it, by parts of a millimetre
    assert 1e-6 < abs(convergence.values[-1]) < 5e-3
    assert np.isfinite(convergence.values).all()
    sim.save(tmp_path / "tunnel.npz")
    again = fdem.load(tmp_path / "tunnel.npz", tunnel(), fdem.Relaxation())
    for each in (sim, again):
        each.cycle(20)
    assert (again.positions() == sim.positions()).all()


@pytest.mark.long
def test_api_scene_5_in_full():
    scene = tunnel()
    sim = simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-5).converged
    sim.reset("displacement")
    for stage in ("stage_1", "stage_2", "stage_3"):
        sim.excavate(stage, over=200)
        assert sim.solve(ratio=1e-5).converged
    assert 1e-5 < np.abs(sim.displacements()).max() < 1e-2
