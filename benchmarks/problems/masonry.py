"""Rigid blocks that stand or fall: the thinnest arch of n voussoirs, the sliding wedge."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import linprog

import fdem
from fdem.tuning.settings import Settings

from .base import Problem, Solve, grid
from .blocks import ADAPTIVE, ALPHA, DDA, EXPLICIT, HARD, LOCAL, NEWMARK, RIGID, STATIC, simulation

# ----------------------------------------------------------------------------------------------------------- arch

RADIUS, VOUSSOIRS, FRICTION, RHO, G = 10.0, 20, math.degrees(math.atan(0.7)), 2000.0, 9.81


def holds(eta: float) -> bool:
    """Whether a line of thrust fits into half an arch of planar-faced voussoirs, t/R = eta (linear programme)."""
    d, inner, outer = math.pi / VOUSSOIRS, 1 - eta / 2, 1 + eta / 2
    weight = 0.5 * math.sin(d) * (outer**2 - inner**2) / eta
    reach = (outer**3 - inner**3) / (outer**2 - inner**2) * 2 / 3 * math.cos(d / 2)
    rows, limits = [], []
    for k in range(VOUSSOIRS // 2 + 1):
        c, s, w = math.cos(k * d), math.sin(k * d), k * weight
        moment = weight * reach * sum(math.sin((j + 0.5) * d) for j in range(k))
        rows += [[1, -outer * c], [-1, inner * c]]
        limits += [outer * w * s - moment, moment - inner * w * s]
    return linprog([0, 1], A_ub=rows, b_ub=limits, bounds=[(None, None), (0, None)]).status == 0


def thinnest() -> float:
    """Least t/R by bisection."""
    low, high = 0.05, 0.2
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def standing(s: Settings, eta: float) -> bool:
    """Whether the arch of that thickness finds rest; with contact dynamics, whether it stays where it is."""
    scene, t = fdem.Scene(), eta * RADIUS
    stones = scene.add(fdem.arch(2 * RADIUS, RADIUS, t, 1.0, VOUSSOIRS), s.body, fdem.Elastic(RHO))
    for x in (-RADIUS, RADIUS):
        scene.add(fdem.brick((x - t, -0.5, -1), (x + t, 1.5, 0)), fdem.Rigid(), fixed=True)
    scene.joint(fdem.Coulomb(kn=s.kn, ks=s.kn, friction=FRICTION))
    sim = simulation(scene, s)
    if s.dt is None:
        try:
            return bool(sim.solve(ratio=s.ratio, max_cycles=20_000).converged)
        except fdem.SolveError:
            return False
    sim.run(time=0.5)
    fallen = np.abs(sim[stones].displacement).max()
    return bool(fallen < 1e-3)


def arch(s: Settings) -> Solve:
    """A semicircular arch of 20 stones under its weight: bisection on its thickness to 1e-3."""

    def solve() -> float:
        low, high = 0.09, 0.15
        while high / low - 1 > 1e-3:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if standing(s, middle) else (middle, high)
        return 0.5 * (low + high)

    return solve


ARCH = Problem(
    "arch",
    "Thinnest arch of 20 stones",
    "critical thickness over radius [-]",
    thinnest(),
    arch,
    grid(RIGID, HARD, dt=[5e-2, 2e-2]),
    [*grid(RIGID, HARD, dt=[1e-2, 5e-3]), *grid(RIGID, [STATIC, ADAPTIVE, LOCAL], ratio=[1e-5], kn=[1e11, 1e13])],
    {"body": [RIGID], "integrator": [HARD, STATIC], "dt": 2e-2, "kn": 1e11, "ratio": 1e-5},
    asked=(),
    asked_too=(0.01,),
)

# ---------------------------------------------------------------------------------------------------------- wedge


def normal(dip: float, direction: float) -> np.ndarray:
    """Upward normal of a plane [deg]."""
    d, a = math.radians(dip), math.radians(direction)
    return np.array([math.sin(d) * math.sin(a), math.sin(d) * math.cos(a), math.cos(d)])


SIDES = normal(40, 130), normal(60, 220)
LINE = np.cross(*SIDES) / np.linalg.norm(np.cross(*SIDES))
LINE = LINE if LINE[2] < 0 else -LINE
# equilibrium of a unit weight across the line of intersection (Hoek and Bray)
RA, RB, DRIVE = np.linalg.solve(np.column_stack([*SIDES, -LINE]), [0.0, 0.0, 1.0])
TAN = math.tan(math.radians(30.0))
SPEED, RUN = 0.3, 0.25


def wedge(s: Settings) -> Solve:
    """A wedge that slides along the line of two planes: its path after some time gives its factor of safety."""
    scene, pieces = fdem.Scene(gravity=(0, 0, -10)), [fdem.brick((-5, -5, -5), (5, 5, 5))]
    for dip, direction in ((40, 130), (60, 220)):
        pieces = fdem.cut(pieces, fdem.JointSet(dip, direction))
    for piece in pieces:
        free = all(piece.centroid @ n > 0 for n in SIDES)
        moves = {"velocity": SPEED * LINE, "name": "wedge"} if free else {"fixed": True}
        scene.add(piece, s.body if free else fdem.Rigid(), fdem.Elastic(2000.0, 1e10, 0.2), **moves)
    scene.joint(fdem.Coulomb(kn=s.kn, ks=s.kn, friction=30.0))
    sim = simulation(scene, s)

    def solve() -> float:
        sim.run(time=RUN)
        rate = 2 * (sim["wedge"].displacement @ LINE - SPEED * RUN) / RUN**2
        # rate = g (drive - F drive): friction is F times what would be just enough
        return float(1 - rate / (10 * DRIVE))

    return solve


WEDGE = Problem(
    "wedge",
    "Sliding wedge (Hoek and Bray)",
    "factor of safety from the motion [-]",
    (RA + RB) * TAN / DRIVE,
    wedge,
    [
        *grid(RIGID, HARD, dt=[5e-2, 1e-2]),
        *grid(RIGID, EXPLICIT, safety=[0.8], kn=[1e8, 1e9, 1e10]),
        *grid(RIGID, [ALPHA, DDA], dt=[2e-2], kn=[1e9, 1e10]),
    ],
    [
        *grid(RIGID, HARD, dt=[2e-2, 5e-3]),
        *grid(RIGID, EXPLICIT, safety=[0.4], kn=[1e8, 1e9, 1e10, 1e11]),
        *grid(RIGID, [NEWMARK, ALPHA, DDA], dt=[1e-2, 5e-3], kn=[1e9, 1e10, 1e11]),
    ],
    {"body": [RIGID], "integrator": [EXPLICIT, HARD, ALPHA], "dt": 5e-2, "kn": 1e8},
)


MASONRY = [ARCH, WEDGE]
