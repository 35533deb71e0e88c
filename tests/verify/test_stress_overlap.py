"""Stress scenarios of penetration: deep overlap, tunnelling, jumps of a step; never a silent pass-through.

S-numbers are those of the list of numerical stress scenarios.
"""

from __future__ import annotations

import numpy as np
import pytest

import fdem

STONE = fdem.Elastic(density=2000.0, young=1e10, poisson=0.2)


def test_a_given_step_may_be_large_where_nothing_is_in_the_way():
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((0, 0, 0), (9, 9, 0.1)), fdem.Rigid(), fixed=True, name="plate")
    ball = scene.add(fdem.icosphere(0.05, (0, 0, 1)), fdem.Rigid(), STONE, velocity=(100, 100, 0))
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=0))
    sim = fdem.Simulation(scene, fdem.Explicit(dt=1e-2), progress=False)
    sim.cycle(8)
    assert sim[ball].position == pytest.approx([8, 8, 1])


ELL = np.array([[0, 0], [1, 0], [1, 0.4], [0.4, 0.4], [0.4, 1], [0, 1]]) - 0.4
TROUGH = np.array([[0, 0], [1, 0], [1, 1], [0.7, 1], [0.7, 0.3], [0.3, 0.3], [0.3, 1], [0, 1]]) - 0.5
CORNERS = 0.5 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
SHAPES = {
    "box": lambda: fdem.brick((-0.5, -0.4, -0.3), (0.5, 0.4, 0.3)),
    "plate": lambda: fdem.brick((-1, -1, -0.05), (1, 1, 0.05)),
    "tetrahedron": lambda: fdem.convex_hull(CORNERS),
    "L": lambda: fdem.prism(ELL, 0.5, axis="z"),
    "U": lambda: fdem.prism(TROUGH, 0.6, axis="z"),
    "ball": lambda: fdem.icosphere(0.4, (0, 0, 0)),
}


def inside(points, x, triangles):
    """Which points (n, 3) lie inside a closed surface: solid angle seen from there (Van Oosterom, Strackee 1983)."""
    a, b, c = (x[triangles[:, k]] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    volume = np.einsum("pti,pti->pt", a, np.cross(b, c))
    dot = [np.einsum("pti,pti->pt", u, v) for u, v in ((a, b), (b, c), (c, a))]
    return np.arctan2(volume, la * lb * lc + dot[0] * lc + dot[1] * la + dot[2] * lb).sum(axis=1) > np.pi


def thrown(seed):
    """Two shapes in random positions, a heavy one thrown at the other, the joint far too soft to stop it."""
    rng = np.random.default_rng(seed)
    scene, centre = fdem.Scene(gravity=(0, 0, 0)), rng.normal(size=3)
    centre /= np.linalg.norm(centre)
    speed = 10 ** rng.uniform(0, 3)
    sideways = np.cross(centre, rng.normal(size=3)) * 0.1
    for name in ("target", "missile"):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        place = np.eye(4)
        place[:3, :3] = turn * np.sign(np.linalg.det(turn))
        place[:3, 3] = 0.0 if name == "target" else sideways - 2.6 * centre
        shape = SHAPES[rng.choice(list(SHAPES))]().transform(place)
        body = fdem.Zoned() if rng.random() < 0.2 else fdem.Rigid()
        moves = {"velocity": speed * centre} if name == "missile" else {"fixed": bool(rng.random() < 0.5)}
        spin = {"angular_velocity": 0.3 * speed * rng.normal(size=3)} if isinstance(body, fdem.Rigid) and moves else {}
        stone = fdem.Elastic(density=2e6 if name == "missile" else 2e4, young=1e12, poisson=0.2)
        scene.add(shape, body, stone, name=name, **moves, **(spin if name == "missile" else {}))
    scene.joint(fdem.Coulomb(kn=1e6, ks=1e6, friction=20))
    return fdem.Simulation(scene, fdem.Explicit(), progress=False, energy=False), speed


@pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse zoned blocks: lumped inertia
@pytest.mark.parametrize("seeds", [range(15), pytest.param(range(15, 400), marks=pytest.mark.long)])
def test_nothing_passes_through_a_block_silently(seeds):
    """Random shapes, convex and not, rigid and zoned, 1 to 1000 m/s: refused before a centroid is inside the other.

    Where one only grazes the other there is no error, and no centroid comes inside.
    """
    refused = 0
    for seed in seeds:
        sim, speed = thrown(seed)
        surfaces = [block.shape for block in sim.scene.blocks]
        triangles = [
            np.array([(f[0], f[k], f[k + 1]) for f in s.faces for k in range(1, len(f) - 1)]) for s in surfaces
        ]
        corners = [len(s.points) for s in surfaces]  # gridpoints of a zoned block begin with the corners of its shape
        try:
            for _ in range(40):
                sim.run(time=5.2 / speed / 40)
                a, b = (sim[block].gridpoints[:n] for block, n in zip(sim.scene.blocks, corners, strict=True))
                assert not inside(b.mean(axis=0)[None], a, triangles[0])[0], seed
                assert not inside(a.mean(axis=0)[None], b, triangles[1])[0], seed
        except fdem.OverlapError as error:
            assert "'target'" in str(error) and "'missile'" in str(error)
            refused += 1
    assert refused > 0.8 * len(seeds)


@pytest.mark.parametrize("damping", [fdem.Local(), fdem.Adaptive()])
def test_relaxation_does_not_drop_blocks_through_others(damping):
    """Fictitious speeds are limited: a slab that falls ten times its size lands, at first contact as at any other."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -0.02), (2, 2, 0)), fdem.Rigid(), fixed=True, name="plate")
    slab = scene.add(fdem.brick((0, 0, 5), (1, 1, 5.1)), fdem.Rigid(), STONE, name="slab")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    sim = fdem.Simulation(scene, fdem.Relaxation(damping=damping), progress=False)
    assert sim.solve(ratio=1e-6).reason == "equilibrium"
    assert sim[slab].position[2] == pytest.approx(0.05 - 2000 * 0.1 * 9.81 / 1e9, abs=1e-7)
