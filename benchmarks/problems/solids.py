"""Blocks that deform: wave in a bar, cantilever, thick cylinder, wave through a joint, contact patch."""

from __future__ import annotations

import itertools
import math

import numpy as np

import fdem
from fdem.tuning.settings import Settings

from .base import Problem, Solve, grid
from .blocks import (
    ADAPTIVE,
    ALPHA,
    DDA,
    EXPLICIT,
    LINEAR,
    LOCAL,
    NEWMARK,
    RIGID,
    SMALL,
    STATIC,
    UNIFORM,
    ZONED,
    simulation,
)


def plane(axis: int, value: float):
    """Selector of what lies in the plane ``x[axis] = value``."""
    return lambda x: np.abs(x[:, axis] - value) < 1e-6


def pieces(length: float, size: float) -> np.ndarray:
    """Ends of equal pieces of at most `size`."""
    return np.linspace(0.0, length, math.ceil(length / size - 1e-9) + 1)


def mean_of(sim: fdem.Simulation, blocks, axis: int, value: float, component: int) -> float:
    """Mean displacement of the gridpoints that started in a plane."""
    moved = np.vstack([sim[b].gridpoint_displacement for b in blocks])
    places = np.vstack([sim[b].gridpoints for b in blocks]) - moved
    return float(moved[plane(axis, value)(places), component].mean())


# ------------------------------------------------------------------------------------------------------------ bar

LENGTH, WIDTH, YOUNG, DENSITY, LOAD = 1.0, 0.05, 2e11, 8000.0, 1e7
SPEED = math.sqrt(YOUNG / DENSITY)
STEEL = fdem.Elastic(DENSITY, YOUNG, 0.0)


def bar(s: Settings) -> Solve:
    """A bar held at one end, suddenly pulled at the other; zones, or pieces in a row (rigid: springs E / size)."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    if s.body.kind == "zoned":
        blocks = [scene.add(fdem.brick((0, 0, 0), (LENGTH, WIDTH, WIDTH)), s.body, STEEL)]
        scene.fix(blocks, ("y", "z"))
        scene.fix(blocks, "x", where=plane(0, 0.0))
    else:
        x = pieces(LENGTH, s.size)
        if s.body.kind == "rigid":  # a lattice: its springs are those of the material, half of one at the wall
            kn = YOUNG / (x[1] - x[0])
        else:
            kn = s.kn * YOUNG / (x[1] - x[0])
        scene.add(fdem.brick((-0.1, 0, 0), (0, WIDTH, WIDTH)), RIGID, fixed=True, name="wall")
        blocks = [scene.add(fdem.brick((a, 0, 0), (b, WIDTH, WIDTH)), s.body, STEEL) for a, b in itertools.pairwise(x)]
        scene.joint(fdem.Bonded(kn=kn, ks=kn))
        if s.body.kind == "rigid":
            scene.joint(fdem.Bonded(kn=2 * kn, ks=kn), "wall")
    scene.apply(fdem.Traction((LOAD, 0, 0)), blocks[-1], where=plane(0, LENGTH))
    sim = simulation(scene, s)

    def solve() -> float:
        sim.run(time=1.5 * LENGTH / SPEED)
        return mean_of(sim, blocks[-1:], 0, LENGTH, 0)

    return solve


CELLS = [LENGTH / n for n in (10, 20, 40, 80)]
BAR = Problem(
    "bar",
    "Wave in a bar",
    "displacement of the pulled end after 1.5 passages [m]",
    1.5 * LOAD * LENGTH / YOUNG,
    bar,
    [
        *grid([SMALL, ZONED], EXPLICIT, safety=[0.8], size=CELLS[:3]),
        *grid(RIGID, EXPLICIT, safety=[0.8], size=CELLS),
        *grid(UNIFORM, EXPLICIT, safety=[0.8], size=CELLS[:2], kn=[1e2]),
        *grid(SMALL, [NEWMARK, ALPHA, DDA], dt=[2e-5, 1e-5, 5e-6], size=CELLS[1:2]),
    ],
    [
        *grid([SMALL, ZONED], EXPLICIT, safety=[0.8, 0.4], size=[LENGTH / 80, LENGTH / 160]),
        *grid(RIGID, [EXPLICIT, NEWMARK], safety=[0.8], dt=[1e-6], size=[LENGTH / 160, LENGTH / 320]),
        *grid(UNIFORM, EXPLICIT, safety=[0.8], size=CELLS, kn=[10, 1e2, 1e3]),
        *grid(SMALL, [NEWMARK, ALPHA, DDA], dt=[1e-5, 2.5e-6, 6e-7], size=CELLS),
    ],
    {"body": [SMALL, RIGID], "integrator": [EXPLICIT, NEWMARK], "size": LENGTH / 8, "dt": 2e-5},
    asked=(0.01,),
    asked_too=(0.001,),
)

# ----------------------------------------------------------------------------------------------------- cantilever

SPAN, DEPTH, TIP_LOAD, STONE_YOUNG = 8.0, 1.0, 100.0, 1e10
INERTIA = DEPTH**3 / 12


def root_motion(x: np.ndarray) -> np.ndarray:
    """Displacement of the root that the exact solution has: the section bulges."""
    y = x[:, 1]
    return np.column_stack([TIP_LOAD * y / (3 * STONE_YOUNG * INERTIA) * (y**2 - DEPTH**2 / 4), 0 * y, 0 * y])


def end_shear(x: np.ndarray) -> np.ndarray:
    """Parabolic traction on the end."""
    shear = -TIP_LOAD / (2 * INERTIA) * (DEPTH**2 / 4 - x[:, 1] ** 2)
    return np.column_stack([0 * shear, shear, 0 * shear])


def cantilever(s: Settings) -> Solve:
    """A beam of 8 x 1 x 1 m under a parabolic end shear; zones, or bending blocks, glue kn times as stiff."""
    stone = fdem.Elastic(2500.0, STONE_YOUNG, 0.0)
    scene, half = fdem.Scene(gravity=(0, 0, 0)), DEPTH / 2
    if s.body.kind == "zoned":
        blocks = [scene.add(fdem.brick((0, -half, 0), (SPAN, half, 1)), s.body, stone)]
        scene.apply(fdem.Displacement(root_motion), blocks, where=plane(0, 0.0))
    else:
        scene.add(fdem.brick((-1, -half, 0), (0, half, 1)), RIGID, fixed=True)
        body = fdem.LinearStrain() if s.body.kind == "linear" else s.body
        blocks = [
            scene.add(fdem.brick((a, -half, 0), (b, half, 1)), body, stone)
            for a, b in itertools.pairwise(pieces(SPAN, s.size))
        ]
        glue = s.kn * STONE_YOUNG / s.size
        scene.joint(fdem.Bonded(kn=glue, ks=glue))
    scene.apply(fdem.Traction(end_shear), blocks[-1], where=plane(0, SPAN))
    sim = simulation(scene, s)

    def solve() -> float:
        report = sim.solve(ratio=s.ratio, max_cycles=20_000)
        if not report.converged:
            raise fdem.ConvergenceError(f"solve ended with {report.reason}: {report.notes}")
        return mean_of(sim, blocks[-1:], 0, SPAN, 1)

    return solve


CANTILEVER = Problem(
    "cantilever",
    "Cantilever (Timoshenko and Goodier)",
    "deflection of the end [m]",
    -TIP_LOAD / (6 * STONE_YOUNG * INERTIA) * (DEPTH**2 * SPAN + 2 * SPAN**3),
    cantilever,
    [
        *grid([SMALL, ZONED], STATIC, ratio=[1e-6], size=[0.7, 0.35, 0.2]),
        *grid(SMALL, ADAPTIVE, ratio=[1e-4], size=[0.7, 0.35]),
        *grid(LINEAR, STATIC, ratio=[1e-6], size=[8.0, 4.0, 2.0, 1.0, 0.5], kn=[1e3]),
        *grid(LINEAR, STATIC, ratio=[1e-6], size=[1.0], kn=[1e2, 1e4]),
        *grid(LINEAR, ADAPTIVE, ratio=[1e-4], size=[4.0, 2.0], kn=[1e2]),
    ],
    [
        *grid(SMALL, STATIC, ratio=[1e-6], size=[0.14, 0.1, 0.07]),
        *grid(SMALL, [ADAPTIVE, LOCAL], ratio=[1e-5, 1e-7], size=[0.7, 0.35, 0.2]),
        *grid(LINEAR, STATIC, ratio=[1e-6], size=[2.0, 1.0, 0.5, 0.25], kn=[1e2, 1e3, 1e4]),
    ],
    {"body": [LINEAR, SMALL], "integrator": [STATIC, ADAPTIVE], "size": 4.0, "kn": 10.0, "ratio": 1e-4},
    asked=(0.01,),
    asked_too=(0.001,),
)

# ------------------------------------------------------------------------------------------------------- cylinder

INNER, OUTER, PRESSURE, C_YOUNG, C_POISSON = 1.0, 2.0, 1e4, 5e9, 0.3


def ring(radial: int, around: int, depth: float) -> fdem.tet_mesh:
    """Quarter ring of six tetrahedra a cell."""
    cells = np.array([radial, around, 1])
    at = np.stack(np.meshgrid(*(np.arange(n + 1) for n in cells), indexing="ij"), -1).reshape(-1, 3) / cells
    r, angle = INNER + at[:, 0] * (OUTER - INNER), 0.5 * np.pi * at[:, 1]
    points = np.column_stack([r * np.cos(angle), r * np.sin(angle), at[:, 2] * depth])
    points[at[:, 1] == 1.0, 0] = 0.0
    points[at[:, 1] == 0.0, 1] = 0.0
    corner = np.stack(np.meshgrid(*(np.arange(n) for n in cells), indexing="ij"), -1).reshape(-1, 3)
    steps = [np.vstack([np.zeros(3, int), np.cumsum(np.eye(3, dtype=int)[list(o)], axis=0)])
             for o in itertools.permutations(range(3))]  # fmt: skip
    tets = (corner[:, None, None, :] + np.array(steps)[None]).reshape(-1, 4, 3)
    return fdem.tet_mesh(points, (tets[..., 0] * (around + 1) + tets[..., 1]) * 2 + tets[..., 2])


def cylinder(s: Settings) -> Solve:
    """Quarter of a thick-walled cylinder under internal pressure, plane strain (Lame)."""
    scene, radial = fdem.Scene(gravity=(0, 0, 0)), math.ceil((OUTER - INNER) / s.size - 1e-9)
    body = fdem.Zoned(strain=s.body.strain)
    block = scene.add(ring(radial, radial + radial // 2, s.size), body, fdem.Elastic(2500.0, C_YOUNG, C_POISSON))
    scene.fix(block, "z")
    scene.fix(block, "x", where=lambda x: x[:, 0] == 0.0)
    scene.fix(block, "y", where=lambda x: x[:, 1] == 0.0)
    scene.apply(fdem.Pressure(PRESSURE), block, where=lambda x: np.hypot(x[:, 0], x[:, 1]) < INNER + 0.01 * s.size)
    sim = simulation(scene, s)

    def solve() -> float:
        report = sim.solve(ratio=s.ratio, max_cycles=20_000)
        if not report.converged:
            raise fdem.ConvergenceError(f"solve ended with {report.reason}: {report.notes}")
        moved = sim[block].gridpoint_displacement
        places = sim[block].gridpoints - moved
        bore = np.abs(np.hypot(places[:, 0], places[:, 1]) - INNER) < 1e-9
        return float((moved[bore] * places[bore]).sum(axis=1).mean() / INNER)

    return solve


_A = PRESSURE * INNER**2 / (OUTER**2 - INNER**2)
CYLINDER = Problem(
    "cylinder",
    "Thick-walled cylinder (Lame)",
    "radial displacement of the bore [m]",
    (1 + C_POISSON) / C_YOUNG * ((1 - 2 * C_POISSON) * _A * INNER + _A * OUTER**2 / INNER),
    cylinder,
    [
        *grid(SMALL, STATIC, ratio=[1e-6], size=[1 / 4, 1 / 8, 1 / 16, 1 / 32]),
        *grid(ZONED, STATIC, ratio=[1e-6], size=[1 / 4, 1 / 8, 1 / 16]),
        *grid(SMALL, ADAPTIVE, ratio=[1e-3], size=[1 / 4, 1 / 8, 1 / 16]),
        *grid(SMALL, [ADAPTIVE, LOCAL], ratio=[1e-6], size=[1 / 4, 1 / 8]),
        *grid(SMALL, ADAPTIVE, ratio=[1e-6], size=[1 / 16]),
    ],
    [
        *grid(SMALL, STATIC, ratio=[1e-6], size=[1 / 48, 1 / 64, 1 / 96]),
        *grid([SMALL, ZONED], [ADAPTIVE, LOCAL], ratio=[1e-4, 1e-6], size=[1 / 16, 1 / 32]),
    ],
    {"body": [SMALL, ZONED], "integrator": [STATIC, ADAPTIVE], "size": 0.5, "ratio": 1e-4},
    asked=(0.01,),
    asked_too=(0.001,),
)

# ---------------------------------------------------------------------------------------------------------- joint

RHO, C_WAVE, V0, J_KN = 2650.0, 3000.0, 0.1, 1e10
IMPEDANCE = RHO * C_WAVE
J_TIME = 2 * 0.5 * IMPEDANCE / J_KN  # two time constants behind the front
J_LEFT, J_RIGHT = 3.0, 3.0


def joint(s: Settings) -> Solve:
    """A step of stress meets an elastic joint between two half-spaces: what has passed through after two constants."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    stone, width = fdem.Elastic(RHO, RHO * C_WAVE**2, 0.0), 0.1
    scene.joint(fdem.Bonded(kn=J_KN, ks=J_KN))
    if s.body.kind == "zoned":
        left = scene.add(fdem.brick((-J_LEFT, 0, 0), (0, width, width)), s.body, stone)
        right = scene.add(fdem.brick((0, 0, 0), (J_RIGHT, width, width)), s.body, stone)
        scene.fix([left, right], ("y", "z"))
        behind = right
    else:
        spans = [[x - J_LEFT for x in pieces(J_LEFT, s.size)], list(pieces(J_RIGHT, s.size))]
        halves = [[scene.add(fdem.brick((a, 0, 0), (b, width, width)), s.body, stone, group=side)
                   for a, b in itertools.pairwise(x)]
                  for side, x in zip(("left", "right"), spans, strict=True)]  # fmt: skip
        glue = RHO * C_WAVE**2 / (spans[1][1] - spans[1][0]) * (1.0 if s.body.kind == "rigid" else s.kn)
        for side in ("left", "right"):
            scene.joint(fdem.Bonded(kn=glue, ks=glue), between=(side, side))
        left, right, behind = halves[0][0], halves[1][-1], halves[1][0]
    scene.apply(fdem.Drag(), left, where=plane(0, -J_LEFT))
    scene.apply(fdem.Drag(), right, where=plane(0, J_RIGHT))
    scene.apply(fdem.Traction((2 * IMPEDANCE * V0, 0, 0)), left, where=plane(0, -J_LEFT))
    sim = simulation(scene, s)

    def solve() -> float:
        sim.run(time=J_LEFT / C_WAVE + J_TIME)
        return mean_of(sim, [behind], 0, 0.0, 0)

    return solve


_TAU = 0.5 * IMPEDANCE / J_KN
J_CELLS = [0.2, 0.1, 0.05, 0.025]
JOINT = Problem(
    "joint",
    "Step through an elastic joint",
    "displacement behind the joint two time constants after the front [m]",
    V0 * (J_TIME - _TAU * (1 - math.exp(-J_TIME / _TAU))),
    joint,
    [
        *grid([SMALL, ZONED], EXPLICIT, safety=[0.8], size=J_CELLS[:3]),
        *grid(RIGID, EXPLICIT, safety=[0.8], size=J_CELLS),
        *grid(UNIFORM, EXPLICIT, safety=[0.8], size=J_CELLS[:2], kn=[1e2]),
        *grid(SMALL, [NEWMARK, ALPHA], dt=[2e-4, 1e-4, 5e-5], size=J_CELLS[:1]),
    ],
    [
        *grid([SMALL, ZONED], EXPLICIT, safety=[0.8, 0.4], size=J_CELLS),
        *grid(SMALL, [NEWMARK, ALPHA, DDA], dt=[1e-4, 2.5e-5, 6e-6], size=J_CELLS[1:3]),
        *grid(UNIFORM, EXPLICIT, safety=[0.8], size=J_CELLS[:3], kn=[10, 1e2, 1e3]),
    ],
    {"body": [SMALL, RIGID], "integrator": [EXPLICIT, NEWMARK], "size": 0.4, "dt": 2e-4},
    asked=(0.01,),
    asked_too=(0.001,),
)

# ---------------------------------------------------------------------------------------------------------- patch

P_KN, P_LOAD, P_YOUNG = 1e11, 1e6, 1e10


def patch(s: Settings) -> Solve:
    """Two blocks with meshes of their own pressed on each other: the top goes down by 2 p H / E + p / kn."""
    scene, rock = fdem.Scene(gravity=(0, 0, 0)), fdem.Elastic(2500.0, P_YOUNG, 0.0)
    finer = fdem.Zoned(size=0.7 * s.size, strain=s.body.strain) if s.body.kind == "zoned" else s.body
    bodies = [s.body, finer]
    blocks = [scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), bodies[k], rock) for k in range(2)]
    scene.fix(blocks[0], "z", where=plane(2, 0.0))
    scene.fix(blocks, ("x", "y"))
    scene.joint(fdem.Coulomb(kn=P_KN, ks=P_KN, friction=0.0))
    scene.apply(fdem.Traction((0, 0, -P_LOAD)), blocks[1], where=plane(2, 2.0))
    sim = simulation(scene, s)

    def solve() -> float:
        sim.solve(ratio=s.ratio)
        return mean_of(sim, blocks[1:], 2, 2.0, 2)

    return solve


PATCH = Problem(
    "patch",
    "Contact patch of two meshes",
    "shortening of two blocks and their joint [m]",
    -P_LOAD * (2 / P_YOUNG + 1 / P_KN),
    patch,
    [
        *grid([ZONED, SMALL], [STATIC, ADAPTIVE, LOCAL], ratio=[1e-3, 1e-5], size=[0.5]),
        *grid(ZONED, [STATIC, ADAPTIVE], ratio=[1e-5], size=[0.35]),
        *grid(LINEAR, [STATIC, ADAPTIVE], ratio=[1e-3, 1e-5]),
    ],
    [*grid([ZONED, SMALL], [STATIC, ADAPTIVE, LOCAL], ratio=[1e-2, 1e-4, 1e-7], size=[0.5, 0.25])],
    {"body": [ZONED, LINEAR], "integrator": [STATIC, ADAPTIVE, LOCAL], "size": 0.7, "ratio": 1e-2},
)

SOLIDS = [BAR, CANTILEVER, CYLINDER, JOINT, PATCH]
