"""One list of formulations: what holds for all of them is tested for every entry (tests/test_bodies.py)."""

from __future__ import annotations

import numpy as np

import fdem

ROCK = fdem.Elastic(density=2500.0, young=1e9, poisson=0.25)

# a new formulation is done when its name is added here and everything passes
BODIES = {
    "rigid": fdem.Rigid(),
    "clump": fdem.Rigid(),
    "sphere": fdem.Rigid(),
    "uniform": fdem.UniformStrain(),
    "linear": fdem.LinearStrain(),
    "zoned": fdem.Zoned(),
    "zoned small": fdem.Zoned(strain="small"),
    "zoned matched": fdem.Zoned(mass="inertia-matched"),
}
DEFORM = [name for name, body in BODIES.items() if not isinstance(body, fdem.Rigid)]


def rotation(axis, angle):
    """Rotation matrix by Rodrigues' formula."""
    n = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def turned(shape, seed):
    """A shape in a random attitude."""
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(rng.normal(size=3), 2.0)
    matrix[:3, 3] = rng.normal(size=3)
    return shape.transform(matrix)


def apart(made):
    """Shapes in random attitudes, 10 m from one to the next."""
    away = np.tile(np.eye(4), (len(made), 1, 1))
    away[:, 0, 3] = 10.0 * np.arange(len(made))
    return [turned(shape, i).transform(away[i]) for i, shape in enumerate(made)]


def shapes(body):
    """A box, a prism that is not convex, a tetrahedron, or round ones: far apart, none aligned with the axes."""
    if body == "sphere":
        return [fdem.sphere(0.3 + 0.4 * i, (10.0 * i, 0.1, -0.2)) for i in range(3)]
    if body == "clump":
        balls = [[((0, 0, 0), 0.5), ((0.9, 0, 0), 0.8)], [((0, 0, 0), 0.6), ((1, 0, 0), 0.6), ((0.2, 0.7, 0.4), 0.6)]]
        made = [fdem.clump(each) for each in (*balls, [((0, 0, 0), 0.5), ((2, 1, 0), 0.3)])]
        return apart(made)
    corner = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]
    tetrahedron = fdem.convex_hull([[0.1, 0.2, 0.0], [1.3, 0.1, 0.2], [0.4, 1.1, 0.1], [0.3, 0.4, 0.9]])
    made = [fdem.brick((0, 0, 0), (1, 2, 3)), fdem.prism(corner, 1.0, axis="z"), tetrahedron]
    return apart(made)


def blocks_of(body, gravity=(0.0, 0.0, 0.0), stress=False, **given):
    """A simulation of three blocks that never meet."""
    scene = fdem.Scene(gravity=gravity)
    for shape in shapes(body):
        scene.add(shape, BODIES[body], ROCK, **given)
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30.0))
    if stress:
        scene.apply(fdem.Stress(xx=-3e6, yy=-1e6, zz=-5e6, yz=5e5, zx=-1e6, xy=2e6))
    return fdem.Simulation(scene, fdem.Explicit(dt=1e-6), progress=False)


def shaken(sim, seed=0, strain=2e-3, turn=None):
    """The batch with q and x after a random motion: strains, and a rotation of about half a radian or `turn`."""
    rng = np.random.default_rng(seed)
    (batch,) = sim.model.batches
    q, x, v = sim.state.q, sim.state.x, np.zeros_like(sim.state.v)
    n = batch.n_blocks
    spin = rng.normal(size=(n, 3)) * 0.5 if turn is None else np.tile(turn, (n, 1))
    for _ in range(200):  # in small steps: a rotation by linear motions of points stretches
        batch.launch(q, x, v, np.zeros((n, 3)), spin)
        batch.advance(q, v, 1.0 / 200, None)
        batch.place(q, x)
    if batch.has_strain:
        v[:] = rng.normal(size=v.shape)
        batch.advance(q, v, strain, None)
        batch.place(q, x)
    return batch, q, x, rng
