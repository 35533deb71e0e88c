"""Contact patch tests: what closes evenly carries an even pressure, whatever the meshes and roles (CONTACT.md 6)."""

from __future__ import annotations

import numpy as np
import pytest
from contact_tools import rotation
from verify.test_contact_cases import LOWER, UPPER, graded

import fdem
import fdem.contact.contacts as contacts_module

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia

KN, CLOSURE, PRESSURE = 1e11, 1e-5, 1e6
ROCK = fdem.Elastic(density=2500, young=1e10, poisson=0.2)
LIMIT = 8 * np.finfo(float).eps / CLOSURE  # round-off of positions over the closure, blocks of 1 m
WIDE, FLUSH = ((-1, -1), (2, 2)), ((0, 0), (1, 1))
SHAPES = {
    "zoned": lambda low: graded(LOWER if low else UPPER, 0.0 if low else 1.0),
    "rigid": lambda low: _slab(WIDE, low),
    "rigid flush": lambda low: _slab(FLUSH, low),
}
PAIRS = [(a, b) for a in SHAPES for b in SHAPES if (a, b) != ("rigid", "rigid")]
TURN = rotation([1, 2, 3], np.radians(20))


def _slab(plan, low):
    return fdem.brick((*plan[0], 0.0 if low else 1.0), (*plan[1], 1.0 if low else 2.0))


def turned(shape, r):
    where = np.eye(4)
    where[:3, :3] = r
    return shape.transform(where)


@pytest.mark.parametrize("r", [np.eye(3), TURN], ids=["straight", "turned"])
@pytest.mark.parametrize(("lower", "upper"), PAIRS)
def test_prescribed_closure(lower, upper, r):
    """Traction of every point, and the total force, are kn times the closure to 8 eps L / closure.

    Flush faces too: a patch keeps the area it had at compile until the blocks slide or tilt (3.9). A fresh cut would
    leave a rim as wide as the closure to the sides, as the energy of the overlap asks.
    """
    scene = fdem.Scene(gravity=(0, 0, 0))
    blocks = []
    for kind, low in ((lower, True), (upper, False)):
        body = fdem.Zoned() if kind == "zoned" else fdem.Rigid()
        blocks.append(scene.add(turned(SHAPES[kind](low), r), body, ROCK))
    scene.fix(blocks[0])
    if upper != "zoned":
        scene.fix(blocks[1], component="rotation")
    scene.joint(fdem.Coulomb(kn=KN, ks=KN, friction=30))
    scene.apply(fdem.Velocity(tuple(r @ [0, 0, -CLOSURE])), blocks[1])
    sim = fdem.Simulation(scene, fdem.Explicit(dt=0.1))
    sim.cycle(10)
    table = sim.contact_table()
    facing = np.abs(table["normal"] @ r[:, 2]) > 0.5
    assert np.abs(table["traction"][facing, 0] / (KN * CLOSURE) - 1).max() <= LIMIT
    assert r.T @ sim.pair_force(*blocks) / (KN * CLOSURE) == pytest.approx([0, 0, 1], abs=LIMIT)


@pytest.mark.parametrize("order", ["by rule", "exchanged"])
@pytest.mark.parametrize("r", [np.eye(3), TURN], ids=["straight", "turned"])
@pytest.mark.parametrize(("lower", "upper"), [("zoned", "zoned"), ("zoned", "rigid"), ("rigid", "zoned")])
def test_solved_patch(monkeypatch, lower, upper, r, order):
    """Pressed together, both roles: the same stress in every zone, to 1e-8 of p (a solve ratio of 1e-10 leaves 2e-9).

    Poisson's ratio is 0, so that the bottom may be held in all directions. The joint is smooth: what slips on the way
    to rest would stay in the answer (5e-6, the closure times strains on the way, at 30 degrees of friction).
    """
    if order == "exchanged":
        rule = contacts_module.master_first
        monkeypatch.setattr(contacts_module, "master_first", lambda s, p: rule(s, p)[::-1])
    rock = fdem.Elastic(density=2500, young=1e10, poisson=0.0)
    scene = fdem.Scene(gravity=(0, 0, 0))
    blocks = []
    for kind, low in ((lower, True), (upper, False)):
        body = fdem.Zoned() if kind == "zoned" else fdem.Rigid()
        blocks.append(scene.add(turned(SHAPES[kind](low), r), body, rock))
    if lower == "zoned":
        scene.fix(blocks[0], where=lambda x: x @ r[:, 2] < 1e-9)
    else:
        scene.fix(blocks[0])
    scene.joint(fdem.Coulomb(kn=KN, ks=KN, friction=0))
    side = (0.0 if upper == "zoned" else -1.0) + 1e-9
    for axis in range(2):  # springs on two sides, which do not resist the closure
        scene.apply(fdem.Support(normal=KN), blocks[1], where=lambda x, n=r[:, axis]: x @ n < side)
    area = 1.0 if upper == "zoned" else 9.0
    load = fdem.Traction(tuple(-PRESSURE / area * r[:, 2]))
    scene.apply(load, blocks[1], where=lambda x: x @ r[:, 2] > 2.0 - 1e-9)
    sim = fdem.Simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-10).converged
    expected = -PRESSURE * np.outer(r[:, 2], r[:, 2])[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    for block, kind in zip(blocks, (lower, upper), strict=True):
        if kind == "zoned":
            assert np.abs(sim[block].zone_stress - expected).max() <= 1e-8 * PRESSURE
    assert r.T @ sim.pair_force(*blocks) == pytest.approx([0, 0, PRESSURE], abs=1e-8 * PRESSURE)
