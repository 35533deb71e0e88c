"""Stress scenarios of the list on bodies that deform, and on pairs of different ones; numbers as listed."""

from __future__ import annotations

import numpy as np
import pytest

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia
G = 9.81
ROCK = fdem.Elastic(density=2000.0, young=1e10, poisson=0.2)
KINDS = {
    "rigid": fdem.Rigid(),
    "uniform": fdem.UniformStrain(),
    "linear": fdem.LinearStrain(),
    "zoned": fdem.Zoned(mass="inertia-matched"),
}
DEFORM = ("uniform", "linear", "zoned")


def settled(scene, ratio):
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    report = sim.solve(ratio=ratio)
    assert report.reason == "equilibrium", report
    return sim


@pytest.mark.parametrize(
    ("lower", "upper", "d"),
    [
        ("rigid", "uniform", 0.2),
        ("uniform", "uniform", 0.2),
        ("linear", "linear", 0.15),
        ("uniform", "linear", 0.15),
        ("zoned", "uniform", 0.15),
    ],
)
def test_s07_huge_overlap_sets_free_no_more_than_it_stores(lower, upper, d):
    """20 % of the edge: speed of separation <= 1.05 sqrt(kn A d^2 / m_red), energy at any time <= stored + 1 %.

    A face in two triangles admits a depth of a sixth of the edge, and 20 % is refused.
    """
    scene = fdem.Scene(gravity=(0, 0, 0), gap_tolerance=0.0)
    a = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), KINDS[lower], ROCK, name="a")
    b = scene.add(fdem.brick((0, 0, 1 - d), (1, 1, 2 - d)), KINDS[upper], ROCK, name="b")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    sim = fdem.Simulation(scene, fdem.Explicit(), progress=False)
    stored, largest = 1e9 * (d**2 / 2 - 2 * d**3 / 3 + d**4 / 3), 0.0
    for _ in range(25):
        sim.run(time=0.002)
        energy = sim.energy
        largest = max(largest, energy.kinetic + energy.strain + energy.joint)
    assert largest <= 1.01 * stored
    assert not np.any(sim.contact_table()["area"])
    # what the ledger finds is what the motion has: nothing is made on the way
    assert energy.kinetic + energy.strain >= 0.9 * stored
    assert 0.0 < sim[b].velocity[2] - sim[a].velocity[2] <= 1.05 * np.sqrt(1e9 * d**2 / 1000.0)


@pytest.mark.parametrize("body", DEFORM)
def test_s20_redundant_contacts(body):
    """A box on 16 flush facets: resultant to 1e-8; a base that stays plane shares it evenly to 1e-6."""
    scene, grid, n = fdem.Scene(), np.linspace(0, 1, 5), 4
    for i, j in np.ndindex(n, n):
        facet = fdem.brick((grid[i], grid[j], -1), (grid[i + 1], grid[j + 1], 0))
        scene.add(facet, fdem.Rigid(), fixed=True, group="floor")
    box = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), KINDS[body], ROCK, name="box")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    sim = settled(scene, 1e-9)
    sim.cycle(1500)  # on to round-off
    assert sim[box].contact_force == pytest.approx([0, 0, 1000 * G], abs=1e-8 * 1000 * G)
    if body == "uniform":
        table = sim.contact_table()
        share = np.bincount(table["block_a"], np.abs(table["force"][:, 2]), n * n)
        assert share == pytest.approx(1000 * G / n**2, rel=1e-6)


@pytest.mark.parametrize("body", DEFORM)
def test_s33_friction_is_isotropic(body):
    """mu = 0.5, pulled at the base at 22.5 degrees: holds at 0.995, slides at 1.005 of mu W, within 0.5 degrees."""
    mu, degrees = 0.5, 22.5
    pull = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0.0])
    scene = fdem.Scene()
    scene.add(fdem.brick((-3, -3, -1), (4, 4, 0)), fdem.Rigid(), fixed=True, name="base")
    box = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), KINDS[body], ROCK, name="box")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=np.degrees(np.arctan(mu))))
    at = (0.5, 0.5, 0.0) if body != "zoned" else None  # at one gridpoint it would only pull a corner
    load = scene.apply(fdem.Force(mu * 1000 * G * pull, at=at), box, factor=0.0)
    sim = settled(scene, 1e-8)
    sim[load].factor = 0.995
    assert sim.solve(ratio=1e-6).reason == "equilibrium"
    held = sim[box].position
    sim[load].factor = 1.005
    assert sim.solve(ratio=1e-6).reason == "collapse"
    slid = sim[box].position - held
    assert abs(np.degrees(np.arctan2(slid[1], slid[0])) - degrees) <= 0.5
    assert np.linalg.norm(slid) > 1e-3


def test_s22_stack_of_all_bodies_at_utm_coordinates():
    """Pair forces within 1e-6 of the run at the origin, the same pairs."""
    results = []
    for origin in (np.zeros(3), np.array([500_000.0, 4_600_000.0, 300.0])):
        scene = fdem.Scene()
        scene.add(fdem.brick(origin - 1, origin + np.array([2, 2, 0])), fdem.Rigid(), fixed=True, name="base")
        low = [origin + np.array([0, 0, k]) for k in range(4)]
        cubes = [
            scene.add(fdem.brick(at, at + 1), KINDS[list(KINDS)[k]], ROCK, name=f"cube {k}") for k, at in enumerate(low)
        ]
        scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
        sim = settled(scene, 1e-9)
        forces = np.array([sim.pair_force(a, b) for a, b in zip(["base", *cubes[:-1]], cubes, strict=True)])
        table = sim.contact_table()
        results.append((forces, set(zip(table["block_a"].tolist(), table["block_b"].tolist(), strict=True))))
        assert forces[:, 2] == pytest.approx(2000 * G * np.arange(4, 0, -1), rel=1e-6)
    assert results[0][1] == results[1][1]
    assert np.abs(results[1][0] - results[0][0]).max() <= 1e-6 * np.abs(results[0][0]).max()
