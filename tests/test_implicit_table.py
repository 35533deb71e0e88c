"""Every body with every joint law and every implicit integrator; restart; what has no tangent is refused."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest
from contracts import LAWS, example_law
from scenes import assert_same_bits, everything, pile, quietly, simulation

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia

G = 9.81
STONE = fdem.Elastic(density=2500.0, young=1e9, poisson=0.2)
BODIES = {
    "rigid": fdem.Rigid(),
    "uniform": fdem.UniformStrain(),
    "linear": fdem.LinearStrain(),
    "zoned": fdem.Zoned(size=0.8),
    "zoned, small": fdem.Zoned(size=0.8, strain="small"),
}
INTEGRATORS = {
    "newmark": lambda: fdem.Newmark(dt=2e-4),
    "dda": lambda: fdem.Newmark(dt=2e-4, beta=0.5, gamma=1.0),
    "alpha": lambda: fdem.GeneralizedAlpha(dt=2e-4),
    "static": lambda: fdem.Static(),
}
FACES = {name: law for name, law in LAWS.items() if name != "user's own"}
ROUND = {
    "coulomb": fdem.Coulomb(kn=1e8, ks=5e7, friction=30),
    "coulomb, all at once": fdem.Coulomb(kn=1e8, ks=5e7, friction=30, restitution=0.3, rolling=0.02, twisting=0.02),
    "hertz": fdem.Hertz(friction=30, young=1e8, poisson=0.2, restitution=0.5, rolling=0.01),
}


def pushed(body, law, integrator):
    """Two blocks on a floor, the upper one pushed sideways: it is pressed, sheared and tilted."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-2, -2, -1), (3, 3, 0)), fdem.Rigid(), fixed=True, name="floor")
    scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), body, STONE, name="low")
    top = scene.add(fdem.brick((0.1, 0, 0.5), (1.1, 1, 1)), body, STONE, name="top")
    scene.joint(law)
    scene.apply(fdem.Force((2000.0, 300.0, 0)), top)
    return fdem.Simulation(scene, integrator)


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("law", FACES)
@pytest.mark.parametrize("body", BODIES)
def test_body_law_integrator(body, law, integrator):
    """Steps that converge, and at rest (static) the floor carries weight and push to 1e-6."""
    sim = pushed(BODIES[body], FACES[law], INTEGRATORS[integrator]())
    if integrator == "static":
        report = sim.solve(ratio=1e-8)
        assert report.converged, report.notes
        weight = 2500.0 * G
        assert sim.pair_force("floor", "low") == pytest.approx([-2000, -300, weight], abs=1e-6 * weight)
        return
    sim.cycle(10)
    assert max(residual for residual, _ in sim.integrator.accepted) < 1e-6
    assert sim.time == pytest.approx(2e-3)
    assert 0.0 < np.abs(sim["top"].displacement).max() < 1e-4
    # friction that begins, and faces that meet, within a step are wrong by a part of it
    assert sim.energy.closure < 0.05


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("law", ROUND)
@pytest.mark.parametrize("shape", ["sphere", "clump"])
def test_round_bodies(shape, law, integrator):
    """A sphere or clump that rests on two others, which a fixed block keeps from rolling away."""
    scene, r = fdem.Scene(), 0.5
    walls = (((-2, -2, -1), (3, 3, 0)), ((-1.6, -2, 0), (-0.501, 3, 1)), ((1.5, -2, 0), (2.6, 3, 1)))
    for k, (low, high) in enumerate(walls):
        scene.add(fdem.brick(low, high), fdem.Rigid(), fixed=True, name=f"wall {k}")
    for k, place in enumerate(((0, 0, 0.4995), (0.9995, 0, 0.4995), (0.5, 0, 1.3645))):
        body = fdem.sphere(r, place) if shape == "sphere" or k < 2 else _pair(place, r)
        scene.add(body, fdem.Rigid(), STONE, name=f"ball {k}")
    scene.joint(ROUND[law])
    sim = fdem.Simulation(scene, INTEGRATORS[integrator]())
    if integrator == "static":
        assert sim.solve(ratio=1e-8).converged
        mass = sum(sim[f"ball {k}"].mass for k in range(3))
        total = sum(sim.pair_force(f"wall {k}", f"ball {j}") for k in range(3) for j in range(3))
        assert total[2] == pytest.approx(G * mass, rel=1e-6)
        return
    sim.cycle(10)
    assert max(residual for residual, _ in sim.integrator.accepted) < 1e-6
    assert np.abs(sim["ball 2"].displacement).max() < 5e-3


def _pair(place, r):
    place = np.asarray(place, dtype=float)
    return fdem.clump([(place, r), (place - [0, 0, 0.35], 0.4 * r)])


def test_law_of_the_users_own():
    """Refused without a word about its differences; with it, as any other."""
    law = example_law()
    with pytest.raises(fdem.UnsupportedError, match=r"weakening.*has no tangent"):
        pushed(fdem.Rigid(), law, fdem.Newmark(dt=1e-3)).cycle(1)

    class Smooth(type(law)):
        smooth = True

    values = {name: getattr(law, name) for name in ("kn", "ks", "static", "dynamic", "distance")}
    sim = pushed(fdem.Rigid(), Smooth(**values), fdem.Newmark(dt=2e-4))
    sim.cycle(10)
    assert max(residual for residual, _ in sim.integrator.accepted) < 1e-6


def test_load_without_tangent_is_refused():
    class Wind:
        def force(self, t, x, v):
            return np.ones_like(x)

    sim = pushed(fdem.Rigid(), LAWS["coulomb"], fdem.Newmark(dt=1e-3))
    sim.apply(Wind(), "top")
    with pytest.raises(fdem.UnsupportedError, match="tangent"):
        sim.cycle(1)


@pytest.mark.parametrize("strain", ["large", "small"])
@pytest.mark.parametrize("name", ["newmark", "alpha"])
def test_half_and_half_is_the_whole(tmp_path, name, strain):
    """S38: saved half way and gone on, the same to the last bit, slip included."""
    whole = simulation(pile(strain=strain), INTEGRATORS[name]())
    whole.cycle(9)
    half = simulation(pile(strain=strain), INTEGRATORS[name]())
    half.cycle(5)
    half.save(tmp_path / "half.npz")
    again = quietly(fdem.load, tmp_path / "half.npz", pile(strain=strain), INTEGRATORS[name](), progress=False)
    assert_same_bits(everything(again), everything(half))
    again.cycle(4)
    assert_same_bits(everything(again), everything(whole))


def test_static_goes_on_from_a_file(tmp_path):
    scene = pushed(fdem.Rigid(), LAWS["coulomb"], fdem.Static()).scene
    sim = fdem.Simulation(scene, fdem.Static())
    assert sim.solve().converged
    sim.save(tmp_path / "rest.npz")
    again = fdem.load(tmp_path / "rest.npz", scene, fdem.Static())
    assert_same_bits(everything(again), everything(sim))
    moving = fdem.Simulation(scene, fdem.Newmark(dt=1e-2), start=tmp_path / "rest.npz")
    moving.cycle(5)
    assert np.abs(moving["top"].displacement).max() < 1e-9


def test_describe_tells_the_linear_solver():
    sim = pushed(fdem.Zoned(size=0.8), LAWS["coulomb"], fdem.Newmark(dt=1e-3))
    assert "linear systems: direct (chosen by size and kind of blocks), last used: none yet" in sim.describe()
    sim.cycle(1)
    assert "last used: sparse LU" in sim.describe()
    asked = pushed(fdem.Zoned(size=0.8), LAWS["coulomb"], fdem.Newmark(dt=1e-3, solver="cg"))
    asked.cycle(2)
    assert "linear systems: cg (asked for)" in asked.describe()
    # the same motion whatever solves the systems
    sim.cycle(1)
    assert asked["top"].position == pytest.approx(sim["top"].position, abs=1e-9)


@pytest.mark.parametrize("solver", ["cg", "amg", "cholmod", "pardiso"])
def test_solvers_agree(solver):
    """The same state at rest and the same motion, to the tolerance of Newton's method, whatever solves the systems."""
    package = {"cholmod": "sksparse", "pardiso": "pypardiso"}.get(solver)
    if package is not None and find_spec(package) is None:
        with pytest.raises(fdem.SceneError, match=rf"solver = '{solver}' needs the package"):
            fdem.Newmark(dt=1e-3, solver=solver)
        return
    scene = pushed(fdem.Zoned(size=0.4), LAWS["coulomb"], fdem.Static()).scene
    ends = []
    for method in ("direct", solver):
        sim = fdem.Simulation(scene, fdem.Static(solver=method, tolerance=1e-9))
        assert sim.solve(ratio=1e-9).converged
        moving = fdem.Simulation(scene, fdem.Newmark(dt=1e-4, solver=method, tolerance=1e-9))
        moving.cycle(5)
        ends.append((sim["top"].displacement, moving["top"].displacement))
    for first, second in zip(*ends, strict=True):
        assert second == pytest.approx(first, rel=1e-6, abs=1e-6 * np.abs(first).max())


def test_a_kept_factor_is_refined():
    """A second step of nearly the same matrix needs no new factor."""
    sim = pushed(fdem.Zoned(size=0.4), fdem.Coulomb(kn=1e10, ks=5e9, friction=60), fdem.Newmark(dt=1e-4))
    sim.cycle(6)
    assert "kept factor refined" in sim.describe()
