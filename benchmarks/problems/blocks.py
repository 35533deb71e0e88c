"""Blocks that move on joints or bounce: sliding, rocking, Hertz collision, stack, block on a spring."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import quad

import fdem
from fdem.tuning.settings import Settings

from .base import Problem, Solve, grid

G = 9.81
DDA = fdem.Newmark(dt=1.0, beta=0.5, gamma=1.0)
NEWMARK, ALPHA, HARD = fdem.Newmark(dt=1.0), fdem.GeneralizedAlpha(dt=1.0), fdem.ContactDynamics(dt=1.0)
EXPLICIT, STATIC = fdem.Explicit(), fdem.Static()
ADAPTIVE, LOCAL = fdem.Relaxation(damping=fdem.Adaptive()), fdem.Relaxation()
RIGID, UNIFORM, LINEAR = fdem.Rigid(), fdem.UniformStrain(), fdem.LinearStrain()
ZONED, SMALL = fdem.Zoned(), fdem.Zoned(strain="small")


def simulation(scene: fdem.Scene, s: Settings) -> fdem.Simulation:
    """Compiled, without the energy ledger."""
    return fdem.Simulation(scene, s.integrator, progress=False, energy=False)


# ------------------------------------------------------------------------------------------------------- sliding

SLOPE, PHI, SLIDE_TIME = np.radians(30.0), 20.0, 0.5


def sliding(s: Settings) -> Solve:
    """1 x 1 x 0.5 m block on a slope of 30 degrees, friction 20 degrees, from rest under sudden gravity."""
    scene = fdem.Scene(gravity=G * np.array([np.sin(SLOPE), 0.0, -np.cos(SLOPE)]))
    scene.add(fdem.brick((-4, -1, -1), (13, 2, 0)), fdem.Rigid(), fixed=True)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), s.body, fdem.Elastic(2000.0, 1e10, 0.2))
    scene.joint(fdem.Coulomb(kn=s.kn, ks=None if s.kn is None else 0.4 * s.kn, friction=PHI))
    sim = simulation(scene, s)

    def solve() -> float:
        sim.run(time=SLIDE_TIME)
        return float(sim[block].displacement[0])

    return solve


SLIDING = Problem(
    "sliding",
    "Block sliding down 30 degrees",
    "displacement along the slope after 0.5 s [m]",
    0.5 * G * (np.sin(SLOPE) - np.cos(SLOPE) * np.tan(np.radians(PHI))) * SLIDE_TIME**2,
    sliding,
    [
        *grid(RIGID, EXPLICIT, safety=[0.8], kn=[1e7, 1e8, 1e9, 1e10]),
        *grid(RIGID, [NEWMARK, ALPHA, DDA], dt=[2e-2], kn=[1e9, 1e10]),
        *grid([RIGID, UNIFORM], HARD, dt=[0.1, 1e-2]),
        *grid(UNIFORM, EXPLICIT, safety=[0.8], kn=[1e8]),
    ],
    [
        *grid(RIGID, EXPLICIT, safety=[0.2, 0.4], kn=[1e8, 1e9, 1e10]),
        *grid([RIGID, UNIFORM], [NEWMARK, ALPHA, DDA], dt=[1e-2, 5e-3, 2.5e-3], kn=[1e8, 1e9, 1e10, 1e11]),
        *grid([UNIFORM, ZONED], EXPLICIT, safety=[0.8], kn=[1e8, 1e9]),
    ],
    {"body": [RIGID], "integrator": [EXPLICIT, NEWMARK, ALPHA, HARD], "dt": 2e-2, "kn": 1e8},
)

# ------------------------------------------------------------------------------------------------------- rocking

WIDTH, HEIGHT = 0.5, 4.0
ALPHA_0 = math.atan(WIDTH / HEIGHT)
THETA_0, P2 = 0.5 * ALPHA_0, 0.75 * G / (0.5 * math.hypot(WIDTH, HEIGHT))
ROCK_END = 0.1 * THETA_0


def rocking_time() -> float:
    """Time from rest at theta_0 to a tenth of it, Housner's equation, by quadrature (theta = theta_0 - x^2)."""

    def speed(x: float) -> float:
        energy = math.cos(ALPHA_0 - THETA_0) - math.cos(ALPHA_0 - THETA_0 + x * x)
        return 2 * x / math.sqrt(2 * P2 * energy)

    return float(quad(speed, 0.0, math.sqrt(THETA_0 - ROCK_END), epsabs=1e-13, epsrel=1e-12)[0])


def rocking(s: Settings) -> Solve:
    """A slender block let go on one edge, tilted by half its critical angle."""
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((-3, -1, -1), (3, 2, 0)), fdem.Rigid(), fixed=True)
    turn = np.eye(4)
    c, si = math.cos(THETA_0), math.sin(THETA_0)
    turn[np.ix_([0, 2], [0, 2])] = [[c, si], [-si, c]]
    block = fdem.brick((-WIDTH, 0, 0), (0, 1, HEIGHT)).transform(turn)
    block = scene.add(block, s.body, fdem.Elastic(2500.0, 5e10, 0.2))
    scene.joint(fdem.Coulomb(kn=s.kn, ks=s.kn, friction=45.0))
    sim = simulation(scene, s)

    def solve() -> float:
        angle = sim.history(block, "rotation_vector", component="y")
        limit = THETA_0 - ROCK_END
        while abs(angle.values[-1]) < limit and sim.time < 2.0:
            sim.run(time=0.02)
        return float(np.interp(limit, np.abs(angle.values), angle.time))

    return solve


ROCKING = Problem(
    "rocking",
    "Rocking block (Housner)",
    "time to fall from half to a twentieth of the critical angle [s]",
    rocking_time(),
    rocking,
    [
        *grid(RIGID, EXPLICIT, safety=[0.8], kn=[1e8, 1e9, 1e10, 1e11]),
        *grid(RIGID, [NEWMARK, DDA], dt=[1e-2], kn=[1e9, 1e11]),
        *grid(RIGID, HARD, dt=[4e-2, 2e-2, 1e-2]),
    ],
    [
        *grid(RIGID, [NEWMARK, ALPHA, DDA], dt=[1e-2, 5e-3, 2.5e-3], kn=[1e10, 1e11, 1e12]),
        *grid(RIGID, EXPLICIT, safety=[0.4], kn=[1e9, 1e10, 1e11, 1e12]),
        *grid(UNIFORM, HARD, dt=[1e-2, 5e-3, 1e-3]),
    ],
    {"body": [RIGID], "integrator": [EXPLICIT, NEWMARK, ALPHA, HARD], "dt": 2e-2, "kn": 1e9},
)

# --------------------------------------------------------------------------------------------------------- Hertz

GLASS, RADIUS, APPROACH = fdem.Elastic(2800.0, 4.8e10, 0.2), 0.01, 10.0
MODULUS = 0.5 * 4.8e10 / (1 - 0.2**2)
REDUCED = 0.5 * 2800.0 * 4 / 3 * math.pi * RADIUS**3
OVERLAP = (15 * REDUCED * (2 * APPROACH) ** 2 / (16 * MODULUS * math.sqrt(0.5 * RADIUS))) ** 0.4
DURATION = 4 * math.sqrt(math.pi) / 5 * math.gamma(0.4) / math.gamma(0.9) * OVERLAP / (2 * APPROACH)


def hertz(s: Settings) -> Solve:
    """Two glass spheres of 10 mm meet at 20 m/s (Chung and Ooi 2011)."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.sphere(RADIUS), s.body, GLASS, velocity=(0, 0, APPROACH))
    ball = scene.add(fdem.sphere(RADIUS, (0, 0, 2.002 * RADIUS)), s.body, GLASS, velocity=(0, 0, -APPROACH))
    scene.joint(fdem.Hertz(friction=0))
    sim = simulation(scene, s)

    def solve() -> float:
        push = sim.history(ball, "contact_force", component="z")
        sim.run(time=0.8 * DURATION)
        force, k = np.asarray(push.values), int(np.argmax(push.values))
        return float(force[k])

    return solve


HERTZ = Problem(
    "hertz",
    "Collision of two spheres (Hertz)",
    "largest force [N]",
    4 / 3 * MODULUS * math.sqrt(0.5 * RADIUS) * OVERLAP**1.5,
    hertz,
    [
        *grid(RIGID, [EXPLICIT, NEWMARK, ALPHA, DDA], dt=[DURATION / n for n in (10, 20, 40, 80, 160)]),
        *grid(RIGID, EXPLICIT, safety=[0.8, 0.4, 0.2, 0.1]),
    ],
    grid(RIGID, [EXPLICIT, NEWMARK, ALPHA, DDA], dt=[DURATION / n for n in (320, 640, 1280)]),
    {"body": [RIGID], "integrator": [EXPLICIT, NEWMARK, ALPHA], "dt": DURATION / 8},
)

# --------------------------------------------------------------------------------------------------------- stack

CUBES, CUBE_MASS, STACK_KN = 10, 2000.0, 1e9


def stack(s: Settings) -> Solve:
    """Ten cubes of 1 m, one on the other, at rest: the force under the lowest."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="floor")
    for k in range(CUBES):
        scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), s.body, fdem.Elastic(2000.0, 1e10, 0.0), name=f"cube {k}")
    scene.joint(fdem.Coulomb(kn=STACK_KN, ks=STACK_KN, friction=30))
    sim = simulation(scene, s)

    def solve() -> float:
        if s.dt is None:
            sim.solve(ratio=s.ratio)
        else:
            sim.cycle(5)
        return float(sim.pair_force("floor", "cube 0")[2])

    return solve


STACK = Problem(
    "stack",
    "Stack of ten cubes",
    "force under the lowest cube [N]",
    CUBES * CUBE_MASS * G,
    stack,
    [
        *grid([RIGID, UNIFORM, ZONED], [LOCAL, ADAPTIVE], ratio=[1e-2, 1e-3, 1e-4, 1e-6]),
        *grid([RIGID, UNIFORM, LINEAR, ZONED], STATIC, ratio=[1e-4, 1e-8]),
        *grid(RIGID, HARD, dt=[1e-2]),
    ],
    [*grid(LINEAR, [LOCAL, ADAPTIVE], ratio=[1e-2, 1e-3, 1e-4]), *grid(ZONED, STATIC, ratio=[1e-8], size=[0.5, 0.35])],
    {"body": [ZONED, UNIFORM, RIGID], "integrator": [LOCAL, ADAPTIVE, STATIC], "ratio": 1e-2},
)

# ---------------------------------------------------------------------------------------------- block on a spring

D_YOUNG, D_DENSITY, D_KN, D_TIME = 1e9, 2500.0, 1e9, 0.004


def dda_exact() -> float:
    """Fall of the centroid after `D_TIME` of sudden gravity: the two modes of translation and strain in closed form."""
    k, m = D_KN, D_DENSITY
    stiffness = np.array([[k, -k / 2], [-k / 2, k / 4 + D_YOUNG]])
    w2, modes = np.linalg.eigh(_scaled(stiffness, m))
    root = np.sqrt([m, m / 12])
    force = modes.T @ (np.array([-m * G, 0.0]) / root)
    return float((modes @ (force / w2 * (1 - np.cos(np.sqrt(w2) * D_TIME))) / root)[0])


def _scaled(stiffness: np.ndarray, m: float) -> np.ndarray:
    root = np.sqrt([m, m / 12])
    return stiffness / np.outer(root, root)


def dda(s: Settings) -> Solve:
    """A cube that can stretch, on a joint it cannot leave, gravity switched on."""
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), s.body, fdem.Elastic(D_DENSITY, D_YOUNG, 0.0))
    scene.joint(fdem.Bonded(kn=D_KN, ks=D_KN))
    sim = simulation(scene, s)

    def solve() -> float:
        sim.run(time=D_TIME)
        return float(sim[block].displacement[2])

    return solve


SPRING = Problem(
    "spring",
    "Uniform-strain block on a joint (DDA)",
    "fall of the centroid after 4 ms [m]",
    dda_exact(),
    dda,
    [
        *grid(UNIFORM, EXPLICIT, safety=[0.8, 0.4, 0.2, 0.1, 0.05]),
        *grid(UNIFORM, [NEWMARK, ALPHA, DDA], dt=[2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4]),
        *grid(RIGID, EXPLICIT, safety=[0.8]),
    ],
    [
        *grid(UNIFORM, EXPLICIT, safety=[0.025, 0.0125]),
        *grid(UNIFORM, [NEWMARK, ALPHA, DDA], dt=[6e-5, 3e-5]),
        *grid(LINEAR, [EXPLICIT], safety=[0.8, 0.4]),
    ],
    {"body": [UNIFORM, RIGID], "integrator": [EXPLICIT, NEWMARK, ALPHA], "dt": 4e-3},
)

BLOCKS = [SLIDING, ROCKING, HERTZ, STACK, SPRING]
