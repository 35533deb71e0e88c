"""Stress scenarios of resting and slowly driven rigid blocks: mass ratio, redundant contacts, friction, origin.

S-numbers are those of the list of numerical stress scenarios; the number beside each assertion is the one listed.
"""

from __future__ import annotations

import numpy as np
import pytest

import fdem

G = 9.81
STONE = fdem.Elastic(density=2000.0)


def settled(scene, ratio=1e-10, **options):
    """The scene in equilibrium."""
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False, **options)
    report = sim.solve(ratio=ratio)
    assert report.reason == "equilibrium", report
    return sim


LIGHT, HEAVY, CLOSURE = 1.0, 1e6, 1e6 * G / (1e13 * 0.01)


def million_on_one():
    """1e6 kg on 1 kg, cubes of 0.1 m: kn = 1e13 Pa/m closes by 1e-3 of the edge (1e9 by more than all of it)."""
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((-1, -1, -1), (1, 1, 0)), fdem.Rigid(), fixed=True, name="base")
    for k, (name, density) in enumerate({"light": 1e3, "heavy": 1e9}.items()):
        scene.add(
            fdem.brick((0, 0, 0.1 * k), (0.1, 0.1, 0.1 + 0.1 * k)), fdem.Rigid(), fdem.Elastic(density), name=name
        )
    scene.joint(fdem.Coulomb(kn=1e13, ks=1e13, friction=30))
    return scene


def check_million_on_one(sim, rel):
    assert sim.pair_force("base", "light") == pytest.approx([0, 0, (LIGHT + HEAVY) * G], rel=rel, abs=rel * HEAVY * G)
    assert sim.pair_force("light", "heavy") == pytest.approx([0, 0, HEAVY * G], rel=rel, abs=rel * HEAVY * G)
    heights = sim[["light", "heavy"]].position[:, 2] - [0.05, 0.15]
    assert -np.diff([0.0, *heights]).min() <= 1.05 * CLOSURE
    assert np.abs(sim[["light", "heavy"]].velocity).max() <= 1e-3


def test_s01_mass_ratio_of_a_million_relaxed():
    check_million_on_one(settled(million_on_one(), 1e-9), 1e-8)


@pytest.mark.parametrize("time", [0.05, pytest.param(10.0, marks=pytest.mark.long)])
def test_s01_mass_ratio_of_a_million_in_time(time):
    """Forces within 1e-4 at every look, no ejection."""
    sim = fdem.Simulation(
        million_on_one(), fdem.Explicit(), start=settled(million_on_one(), 1e-9), progress=False, energy=False
    )
    for _ in range(20):
        sim.run(time=time / 20)
        check_million_on_one(sim, 1e-4)


@pytest.mark.parametrize(("offset", "limit"), [(0.0, 1e-6), (1e-9, 1e-3)])
def test_s11_stack_without_friction(offset, limit):
    """Ten cubes, mu = 0, 1e5 steps: 1e-6 m sideways aligned, 1e-3 m in 10 s with offsets of 1e-9 m; rotation <= 1e-6.

    A stack without friction is unstable: the lowest joint tilts by N d / (kn I) where the load above is d off, and g
    times that drives it on, so offsets grow at up to sqrt(12 g N / (kn b^4)) = 0.15 / s. Half the stable step keeps
    1e5 steps within 40 s of it.
    """
    rng = np.random.default_rng(11)
    scene, cubes = fdem.Scene(gravity=(0, 0, -G)), []
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    for k in range(10):
        low = np.array([*rng.uniform(-offset, offset, 2), k])
        cubes.append(scene.add(fdem.brick(low, low + 1), fdem.Rigid(), STONE))
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=0))
    sim = fdem.Simulation(scene, fdem.Explicit(safety=0.4), start=settled(scene), progress=False, energy=False)
    begin = sim[cubes].position
    if offset:
        sim.run(time=10.0)
    else:
        sim.cycle(100_000)
    assert np.abs(sim[cubes].position - begin)[:, :2].max() <= limit
    assert np.abs(sim[cubes].rotation_vector).max() <= 1e-6


def on_facets(n):
    """A box on n x n flush fixed blocks."""
    scene, grid = fdem.Scene(), np.linspace(0, 1, n + 1)
    for i in range(n):
        for j in range(n):
            scene.add(
                fdem.brick((grid[i], grid[j], -1), (grid[i + 1], grid[j + 1], 0)), fdem.Rigid(), fixed=True,
                group="floor",
            )  # fmt: skip
    box = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), fdem.Rigid(), STONE, name="box")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    return scene, box


def test_s20_redundant_contacts():
    """4, 16 and 400 facets: resultant to 1e-8, cycles at most tenfold, facets share evenly to 1e-6."""
    cycles = []
    for n in (2, 4, 20):
        scene, box = on_facets(n)
        sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
        report = sim.solve(ratio=1e-10)
        assert report.reason == "equilibrium"
        cycles.append(report.cycles)
        assert sim[box].contact_force == pytest.approx([0, 0, 1000 * G], abs=1e-8 * 1000 * G)
        table = sim.contact_table()
        share = np.bincount(table["block_a"], np.abs(table["force"][:, 2]), n * n)
        assert share == pytest.approx(1000 * G / n**2, rel=1e-6)
    assert max(cycles) <= 10 * min(cycles)


@pytest.mark.parametrize("friction", [0.0, 20.0, 50.0])
def test_s20_box_in_a_groove(friction):
    """Resultant to 1e-8 and the two sides alike to 1e-6; without friction both push with W / sqrt 2.

    With friction the shares of thrust and shear are one admissible set of many: they depend on the way to rest.
    """
    scene, h = fdem.Scene(), np.sqrt(0.5)
    sides = ([(0, 0), (-2, 2), (-2, -1), (0, -1)], [(0, 0), (0, -1), (2, -1), (2, 2)])
    for name, side in zip(("left", "right"), sides, strict=True):
        scene.add(fdem.prism(side, 1.0), fdem.Rigid(), fixed=True, name=name)
    box = scene.add(fdem.prism([(0, 0), (h, h), (0, 2 * h), (-h, h)], 1.0), fdem.Rigid(), STONE, name="box")
    scene.joint(fdem.Coulomb(kn=1e10, ks=1e10, friction=friction))
    sim = settled(scene)
    weight = 2000 * G
    left, right = sim.pair_force("left", box), sim.pair_force("right", box)
    assert left + right == pytest.approx([0, 0, weight], abs=1e-8 * weight)
    assert left * [-1, 1, 1] == pytest.approx(right, abs=1e-6 * weight)
    normal, shear = (left[0] + left[2]) * h, (left[2] - left[0]) * h
    if friction == 0:
        assert normal == pytest.approx(weight * h, rel=1e-8)
    assert abs(shear) <= np.tan(np.radians(friction)) * normal + 1e-8 * weight


@pytest.mark.parametrize("degrees", [0.0, 11.25, 22.5, 45.0])
def test_s33_friction_is_isotropic(degrees):
    """mu = 0.5, pulled at the base: holds at 0.995, slides at 1.005 of mu W, within 0.5 degrees of the pull."""
    mu, turn = 0.5, np.radians(degrees)
    pull = np.array([np.cos(turn), np.sin(turn), 0.0])
    scene = fdem.Scene()
    scene.add(fdem.brick((-3, -3, -1), (4, 4, 0)), fdem.Rigid(), fixed=True, name="base")
    box = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), fdem.Rigid(), STONE, name="box")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=np.degrees(np.arctan(mu))))
    load = scene.apply(fdem.Force(mu * 1000 * G * pull, at=(0.5, 0.5, 0)), box, factor=0.0)
    sim = settled(scene, 1e-8)
    sim[load].factor = 0.995
    assert sim.solve(ratio=1e-6).reason == "equilibrium"
    held = sim[box].position
    sim[load].factor = 1.005
    assert sim.solve(ratio=1e-6).reason == "collapse"
    slid = sim[box].position - held
    assert abs(np.degrees(np.arctan2(slid[1], slid[0])) - degrees) <= 0.5
    assert np.linalg.norm(slid) > 1e-3


def test_s22_stack_at_utm_coordinates():
    """Pair forces within 1e-6 of the run at the origin, the same pairs."""
    results = []
    for origin in (np.zeros(3), np.array([500_000.0, 4_600_000.0, 300.0])):
        scene = fdem.Scene()
        scene.add(fdem.brick(origin - 1, origin + np.array([2, 2, 0])), fdem.Rigid(), fixed=True, name="base")
        cubes = [
            scene.add(
                fdem.brick(origin + np.array([0, 0, k]), origin + np.array([1, 1, k + 1])),
                fdem.Rigid(),
                STONE,
                name=f"cube {k}",
            )
            for k in range(10)
        ]
        scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
        sim = settled(scene, 1e-9)
        below = ["base", *cubes[:-1]]
        forces = np.array([sim.pair_force(a, b) for a, b in zip(below, cubes, strict=True)])
        table = sim.contact_table()
        results.append((forces, set(zip(table["block_a"].tolist(), table["block_b"].tolist(), strict=True))))
        assert forces[:, 2] == pytest.approx(2000 * G * np.arange(10, 0, -1), rel=1e-6)
    assert results[0][1] == results[1][1]
    assert np.abs(results[1][0] - results[0][0]).max() <= 1e-6 * np.abs(results[0][0]).max()
