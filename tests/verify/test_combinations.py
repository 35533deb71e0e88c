"""One scene each for sliding, toppling and a stack: four bodies by four integrators, one closed form.

``python tests/verify/test_combinations.py docs/combinations.md`` writes the table of errors.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia

G, ROCK = 9.81, fdem.Elastic(density=2500, young=5e10, poisson=0.2)
BODIES = {
    "Rigid": fdem.Rigid(),
    "UniformStrain": fdem.UniformStrain(),
    "LinearStrain": fdem.LinearStrain(),
    "Zoned": fdem.Zoned(mass="inertia-matched"),
}
INTEGRATORS = ("Explicit", "Newmark", "ContactDynamics", "Static")
MU, SLOPE = 0.3, 30.0


def tilted(slope: float, body: object, friction: float, size: tuple[float, float, float]) -> tuple[fdem.Scene, object]:
    """A block of `size` on a plane, gravity turned by `slope` [deg]."""
    angle = np.radians(slope)
    scene = fdem.Scene(gravity=(G * np.sin(angle), 0.0, -G * np.cos(angle)))
    scene.add(fdem.brick((-2, -2, -1), (8, 2, 0)), fdem.Rigid(), fixed=True)
    block = scene.add(fdem.brick((0, 0, 0), size), body, ROCK)
    scene.joint(fdem.Coulomb(kn=1e11, ks=1e11, friction=float(np.degrees(np.arctan(friction)))))
    return scene, block


def rule(name: str, dt: float) -> object:
    """The integrator `name` with the step `dt` [s]; rules that damp, as blocks are to come to rest."""
    return {
        "Explicit": lambda: fdem.Explicit(),
        "Newmark": lambda: fdem.Newmark(dt=dt, beta=0.5, gamma=1.0),
        "ContactDynamics": lambda: fdem.ContactDynamics(dt=dt, theta=1.0, tolerance=1e-9),
        "Static": lambda: fdem.Static(),
    }[name]()


def stands(scene: fdem.Scene) -> bool:
    """Whether `Static` finds rest."""
    try:
        return bool(fdem.Simulation(scene, fdem.Static(), progress=False).solve(ratio=1e-8).converged)
    except fdem.SolveError:
        return False


def sliding(body: object, name: str) -> float:
    """Relative error of the acceleration g (sin a - mu cos a); `Static`: of mu in a bracket of 1 % around tan a."""
    if name == "Static":
        at_rest = [
            stands(tilted(SLOPE, body, share * np.tan(np.radians(SLOPE)), (1, 1, 0.5))[0]) for share in (0.99, 1.01)
        ]
        return 0.01 if at_rest == [False, True] else 1.0
    scene, block = tilted(SLOPE, body, MU, (1, 1, 0.5))
    sim = fdem.Simulation(scene, rule(name, 2e-3), progress=False)
    v = []
    for _ in range(2):
        sim.run(time=0.05)
        v.append(sim[block].velocity[0])
    exact = G * (np.sin(np.radians(SLOPE)) - MU * np.cos(np.radians(SLOPE)))
    return abs((v[1] - v[0]) / 0.05 / exact - 1.0)


def toppling(body: object, name: str) -> float:
    """Half the width over atan(b / h) of a bracket: the block stands below, and turns over above."""
    critical, share = np.degrees(np.arctan(0.5)), 0.03
    answers = []
    for factor in (1.0 - share, 1.0 + share):
        scene, block = tilted(critical * factor, body, 2.0, (0.5, 1.0, 1.0))
        if name == "Static":
            answers.append(stands(scene))
            continue
        sim = fdem.Simulation(scene, rule(name, 5e-3), progress=False)
        sim.run(time=0.3)
        answers.append(abs(float(sim[block].rotation_vector[1])) < 2e-3)
    return share if answers == [True, False] else 1.0


def stack(body: object, name: str) -> float:
    """Largest relative error of the forces under two cubes at rest."""
    scene = fdem.Scene()
    base = scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    cubes = [scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), body, ROCK) for k in range(2)]
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    integrator = fdem.Explicit(damping=fdem.Local(0.5)) if name == "Explicit" else rule(name, 0.02)
    sim = fdem.Simulation(scene, integrator, progress=False)
    if name == "Static":
        sim.solve(ratio=1e-10)
    else:
        sim.run(time=0.4 if name == "Explicit" else 4.0)
    weight = 2500 * G
    forces = [sim.pair_force(base, cubes[0])[2] / (2 * weight), sim.pair_force(*cubes)[2] / weight]
    return float(np.abs(np.array(forces) - 1.0).max())


# bounds: penalty springs of 1e11 Pa/m store what a step of 1 % of the acceleration is; brackets are as wide as said;
# rest is approached by damping
PROBLEMS = {"sliding": (sliding, 0.011), "toppling": (toppling, 0.031), "stack": (stack, 1e-4)}


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("name", INTEGRATORS)
@pytest.mark.parametrize(
    "body", [pytest.param(b, marks=pytest.mark.long) if b in ("UniformStrain", "LinearStrain") else b for b in BODIES]
)
def test_every_body_with_every_integrator(body, name, problem):
    """One scene, one closed form, sixteen ways."""
    error, bound = PROBLEMS[problem]
    assert error(BODIES[body], name) <= bound


def main(path: str) -> None:
    """Write the table of errors."""
    warnings.simplefilter("ignore", fdem.FdemWarning)
    lines = [
        "# One scene, four bodies, four integrators",
        "",
        "Relative errors against closed forms, by `python tests/verify/test_combinations.py docs/combinations.md`; the",
        "test in that file holds them to the bounds in the last line. Sliding: acceleration on 30 degrees; `Static`",
        "brackets the friction at which the block rests. Toppling: half the width of a bracket about atan(b/h).",
        "Stack: forces under two cubes.",
        "",
        "| body | integrator | " + " | ".join(PROBLEMS) + " |", "|---|---|" + "---|" * len(PROBLEMS),
    ]  # fmt: skip
    for body, kind in BODIES.items():
        for name in INTEGRATORS:
            errors = [f"{error(kind, name):.1e}" for error, _ in PROBLEMS.values()]
            lines.append(f"| {body} | {name} | " + " | ".join(errors) + " |")
    lines.append("| | bound | " + " | ".join(f"{bound:g}" for _, bound in PROBLEMS.values()) + " |")
    Path(path).write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
