"""Steps, drift, units, input and restart."""

from __future__ import annotations

import re
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import eigh

import fdem

from .base import G, Row, at_most, between, holds, scenario, settled, simulation
from .units import Units

# an oscillator: gravity only keeps the joint closed; small, so that the sides of the block hardly dip into the base
MASS, STIFFNESS, WEAK = 1000.0, 4e6, 0.981
OMEGA = np.sqrt(STIFFNESS / MASS)


def oscillator(push: float = -400.0, joint_damping: float = 0.0) -> tuple[fdem.Scene, Any, Any, fdem.Simulation]:
    """A block of 1000 kg on a joint of 4e6 N/m, pressed down by its weight and a force to be released.

    It is 1 x 1 x 0.4 m with next to no shear stiffness, so that the vertical mode is its fastest.
    """
    scene = fdem.Scene(gravity=(0, 0, -WEAK))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.4)), fdem.Rigid(), fdem.Elastic(density=2500), name="block")
    scene.joint(fdem.Coulomb(kn=STIFFNESS, ks=1e-3 * STIFFNESS, friction=30, damping=joint_damping))
    load = scene.apply(fdem.Force((0, 0, push)), block)
    return scene, block, load, settled(scene, 1e-12)


def released(setup: tuple[Any, ...], integrator: Any, **options: Any) -> fdem.Simulation:
    """The block let go from rest, `push` / K below its equilibrium."""
    scene, _, load, start = setup
    sim = simulation(scene, integrator, start=start, **options)
    sim[load].factor = 0.0
    return sim


@scenario("S14", "energy of an oscillator over 1e6 steps")
def s14(full: bool) -> Iterator[Row]:
    """W dt = 0.2 (quick: 2e4 steps). The part that swings is known exactly: what is left is the drift."""
    setup, w_dt = oscillator(), 0.2
    sim = released(setup, fdem.Explicit(dt=w_dt / OMEGA), energy=False)
    position = sim.history(setup[1], "position", component="z")
    velocity = sim.history(setup[1], "velocity", component="z")
    sim.cycle(1_000_000 if full else 20_000)
    u, v = position.values - 0.2 + MASS * WEAK / STIFFNESS, velocity.values
    kinetic, strain = 0.5 * MASS * v**2, 0.5 * STIFFNESS * u**2
    first = kinetic[0] + strain[0]
    name = f"{sim.steps} steps"
    yield at_most(f"{name}: E_min / E0 off 0.99", abs((kinetic + strain).min() / first - 0.99), 1e-6)
    invariant = (kinetic + strain * (1 - 0.25 * w_dt**2)) / first
    trend = np.polyfit(np.linspace(0, len(invariant) / 1e6, len(invariant)), invariant, 1)[0]
    yield at_most(f"{name}: trend of E / E0 " + ("per 1e6 steps" if full else "over the run"),
                  abs(trend) * (1 if full else len(invariant) / 1e6), 1e-9)  # fmt: skip


B, D, H = 1.0, 0.6, 2.0
BLOCK_KN, BLOCK_KS, DENSITY = 2e9, 1e9, 2500.0


def modes_of_block() -> tuple[Any, ...]:
    """Vertical, twist, two sway-rock pairs about x and about y [rad/s] of the area-integrated joint."""
    mass, area = DENSITY * B * D * H, B * D
    inertia = mass / 12 * np.array([D**2 + H**2, B**2 + H**2, B**2 + D**2])
    second = np.array([B * D**3, D * B**3]) / 12
    vertical = np.sqrt(BLOCK_KN * area / mass)
    twist = np.sqrt(BLOCK_KS * second.sum() / inertia[2])
    pairs = []
    for k in range(2):
        shear, arm = BLOCK_KS * area, 0.5 * H
        stiffness = np.array([[shear, shear * arm], [shear * arm, BLOCK_KN * second[k] + shear * arm**2]])
        scale = 1 / np.sqrt([mass, inertia[k]])
        pairs.append(np.sqrt(np.linalg.eigvalsh(stiffness * np.outer(scale, scale))))
    return vertical, twist, pairs[0], pairs[1]


def block_on_joint() -> tuple[fdem.Scene, Any, list[Any], fdem.Simulation]:
    """The block on its joint, closed by a tenth of its weight, with small loads that excite every mode."""
    scene = fdem.Scene(gravity=(0, 0, -0.1 * G))
    scene.add(fdem.brick((-2, -2, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    shape = fdem.brick((-B / 2, -D / 2, 0), (B / 2, D / 2, H))
    block = scene.add(shape, fdem.Rigid(), fdem.Elastic(density=DENSITY), name="block")
    scene.joint(fdem.Coulomb(kn=BLOCK_KN, ks=BLOCK_KS, friction=60))
    loads = [scene.apply(fdem.Force((3.0, 2.0, -5.0)), block), scene.apply(fdem.Moment((2.0, 3.0, 1.0)), block)]
    return scene, block, loads, settled(scene, 1e-11)


def freed(setup: tuple[Any, ...], integrator: Any) -> fdem.Simulation:
    """The block without those loads."""
    scene, _, loads, start = setup
    sim = simulation(scene, integrator, start=start)
    for load in loads:
        sim[load].factor = 0.0
    return sim


def linear_energy(setup: tuple[Any, ...], sim: fdem.Simulation) -> tuple[Callable[[], float], float]:
    """Energy of the six linear modes now, and the most that leapfrog lets it become.

    Of a mode it keeps ``v^2 + (1 - (w dt / 2)^2) w^2 u^2``, so that its energy is at most this over that factor.
    """
    block, mass, arm = setup[1], DENSITY * B * D * H, 0.5 * H
    inertia = mass / 12 * np.array([D**2 + H**2, B**2 + H**2, B**2 + D**2])
    area, second = B * D, np.array([B * D**3, D * B**3]) / 12
    M, K = np.diag([mass] * 3 + list(inertia)), np.zeros((6, 6))
    K[0, 0] = K[1, 1] = BLOCK_KS * area
    K[2, 2] = BLOCK_KN * area
    # the base of the block moves by u + theta x (-arm z); the weight topples
    K[[3, 4], [3, 4]] = BLOCK_KN * second + BLOCK_KS * area * arm**2 - 0.1 * G * mass * arm
    K[1, 3] = K[3, 1] = BLOCK_KS * area * arm
    K[0, 4] = K[4, 0] = -BLOCK_KS * area * arm
    K[5, 5] = BLOCK_KS * second.sum()
    squares, modes = eigh(K, M)
    rest = np.array([0.0, 0.0, 0.5 * H - 0.1 * G * DENSITY * H / BLOCK_KN])
    loaded = setup[3][block].rotation_vector  # those of a new simulation begin at zero

    def amplitudes() -> tuple[np.ndarray, np.ndarray]:
        view = sim[block]
        u = np.concatenate([view.position - rest, loaded + view.rotation_vector])
        return modes.T @ M @ u, modes.T @ M @ np.concatenate([view.velocity, view.angular_velocity])

    def energy() -> float:
        u, v = amplitudes()
        return float(0.5 * (v**2 + squares * u**2).sum())

    u, v = amplitudes()
    left = 1 - 0.25 * squares * sim.dt**2
    return energy, float(0.5 * ((v**2 + left * squares * u**2) / left).sum())


@scenario("S30", "a step beside its limit")
def s30(full: bool) -> Iterator[Row]:
    """0.99 of 2 / omega_max for 1e5 steps (quick: 5e3), 1.01 of it; the automatic step with damping."""
    setup = block_on_joint()
    top = modes_of_block()[2][1]
    sim = freed(setup, fdem.Explicit(dt=0.99 * 2 / top))
    energy, bound = linear_energy(setup, sim)
    history = sim.history(lambda _: energy(), every=10 if full else 1)
    sim.cycle(100_000 if full else 5000)
    most = history.values.max()
    yield at_most(f"0.99, {sim.steps} steps: energy over its discrete bound", most / bound, 1 + 1e-9)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene, _, loads, start = setup
        sim = fdem.Simulation(scene, fdem.Explicit(dt=1.01 * 2 / top), start=start, progress=False)
    for load in loads:
        sim[load].factor = 0.0
    warned = any("stable" in str(w.message) for w in caught)
    yield holds("1.01: warned at compile", warned, "warning")
    try:
        sim.cycle(20_000)
        said = "ran on"
    except fdem.UnstableError:
        said = f"UnstableError after {sim.steps} steps"
    yield holds("1.01: grows and is refused", said != "ran on", "refused", said)
    for zeta in (0.0, 0.1, 1.0):
        damping = fdem.Rayleigh(stiffness=2 * zeta / top) if zeta else None
        sim = freed(setup, fdem.Explicit(damping=damping))
        critical = 2 / top * (np.sqrt(1 + zeta**2) - zeta)
        yield between(f"automatic step over the limit, zeta = {zeta:g}", sim.dt / critical, 0.5, 1.0)


def rocking(u: Units) -> fdem.Simulation:
    """A slender block let go at 0.2 of its toppling angle: Housner's block, at its automatic step, until it lands."""
    lean = 0.2 * np.arctan(0.5 / 4.0)
    scene = fdem.Scene(gravity=np.array([0, 0, -9.81]) * u.acceleration)
    scene.add(u.brick((-3, -3, -1), (3, 3, 0)), fdem.Rigid(), fixed=True, name="base")
    place = np.eye(4)
    place[:3, :3] = [[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]]
    pivot = np.array([0.25, 0, 0]) * u.length
    place[:3, 3] = pivot - place[:3, :3] @ pivot
    shape = u.brick((-0.25, -0.5, 0), (0.25, 0.5, 4)).transform(place)
    scene.add(shape, fdem.Rigid(), u.elastic(), name="block")
    scene.joint(u.coulomb(kn=2e10, ks=2e10, friction=45.0, cohesion=0.0))
    sim = simulation(scene, energy=False)
    sim.run(time=0.3 * u.time)
    return sim


def column(u: Units) -> tuple[float, float]:
    """Settlement and reaction of a free column under its own weight, over what the closed form says."""
    from .meshes import box_mesh

    points, tets = box_mesh((2, 2, 10), (2, 2, 10))
    scene = fdem.Scene(gravity=np.array([0, 0, -9.81]) * u.acceleration)
    block = scene.add(fdem.tet_mesh(u.place(points), tets), fdem.Zoned(), u.elastic(2500.0, 1e9, 0.0), name="column")
    held = scene.fix(block, where=lambda x: x[:, 2] < 1e-9 * u.length)
    sim = settled(scene, 1e-11)
    sim.cycle(2000)
    top = sim[block].gridpoint_displacement[:, 2].min() / u.length
    return top / (-2500 * 9.81 * 100 / 2e9), sim[held].force[2] / u.force / (2500 * 9.81 * 40)


@scenario("S21", "metres, kilometres, millimetres, and lengths times 1e-6 and 1e6")
def s21(full: bool) -> Iterator[Row]:
    """The same bits when lengths scale by powers of two; equilibria, where they are unique, to 1e-9 in any unit.

    A motion is not held to 1e-9 in other units: the block touches with an edge, and whether a strip of 1e-16 beside
    it is a patch turns on round-off (a change of 4e-5 in mm).
    """
    plain = rocking(Units())
    for power in (10, -10):
        u = Units(length=2.0**power)
        sim = rocking(u)
        same = bool((sim.positions() == plain.positions() * u.length).all()) and sim.steps == plain.steps
        yield holds(f"rocking block, lengths x 2^{power}", same, "same bits, same steps", f"{sim.steps} steps")
    for name, u in (("mm, t, s", Units(length=1e3, mass=1e-3)), ("km, kg, s", Units(length=1e-3))):
        sim = rocking(u)
        yield at_most(f"rocking block, {name}: change of the number of steps", abs(sim.steps - plain.steps), 1)
    exact = np.array(column(Units()))
    systems = {"mm, t, s": Units(length=1e3, mass=1e-3), "km, 1e12 kg, s": Units(length=1e-3, mass=1e-12),
               "lengths x 1e-6": Units(length=1e-6), "lengths x 1e6": Units(length=1e6)}  # fmt: skip
    for name, u in systems.items():
        yield at_most(f"column, {name}: change", np.abs(np.array(column(u)) / exact - 1).max(), 1e-9)


ROCK = fdem.Elastic(density=2500, young=1e10, poisson=0.2)
CUBE = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


def scene_of(shape: Any = None, body: Any = None, material: Any = ROCK, **given: Any) -> fdem.Scene:
    """One cube."""
    scene = fdem.Scene()
    shape = fdem.brick((0, 0, 0), (1, 1, 1)) if shape is None else shape
    scene.add(shape, body or fdem.Rigid(), material, name="cube", **given)
    return scene


def with_row(values: Any, row: Any, value: Any) -> np.ndarray:
    """An array with other values in one place."""
    values = np.array(values, dtype=float)
    values[row] = value
    return values


TWELVE: dict[str, tuple[Callable[[], Any], str]] = {
    "NaN coordinate": (lambda: fdem.polyhedron(with_row(CUBE, (3, 1), np.nan), FACES), r"points\[3\]"),
    "infinite velocity": (lambda: scene_of(velocity=(0, np.inf, 0)), "'cube'.*velocity"),
    "negative density": (lambda: fdem.Elastic(density=-2500), "density = -2500"),
    "nu = 0.5": (lambda: fdem.Elastic(density=2500, young=1e10, poisson=0.5), r"poisson = 0\.5"),
    "E = 0": (lambda: fdem.Elastic(density=2500, young=0, poisson=0.2), "young = 0"),
    "mu < 0": (lambda: fdem.Coulomb(kn=1e9, ks=1e9, friction=-5), "friction = -5"),
    "dt = 0": (lambda: fdem.Explicit(dt=0.0), r"dt = 0\.0"),
    "dt < 0": (lambda: fdem.Explicit(dt=-1e-3), r"dt = -0\.001"),
    "empty mesh": (lambda: fdem.polyhedron([], []), "empty mesh"),
    "duplicate node": (
        lambda: fdem.polyhedron(with_row(CUBE, 3, CUBE[1]), FACES),
        r"points\[1\].*points\[3\]|duplicate",
    ),
    "face index out of range": (lambda: fdem.polyhedron(CUBE, [*FACES[:-1], [1, 5, 8, 3]]), r"faces\[5\]"),
    "non-closed polyhedron": (lambda: fdem.polyhedron(CUBE, FACES[:-1]), "open at edge"),
    "material missing": (lambda: scene_of(body=fdem.Zoned(), material=None), "'cube'.*material"),
}


@scenario("S28", "garbage as input")
def s28(full: bool) -> Iterator[Row]:
    """Each refused by an error of fdem that names the field, before the first step."""
    for name, (act, match) in TWELVE.items():
        try:
            act()
            said, right = "accepted", False
        except fdem.FdemError as error:
            said, right = type(error).__name__, bool(re.search(match, str(error)))
        yield holds(name, right, "refused, field named", said)


def sliding_pile(body: Any) -> fdem.Scene:
    """A block that slides and leans on another one, with friction, cohesion and damping."""
    scene = fdem.Scene(gravity=(2.0, 0.5, -9.0))
    scene.add(fdem.brick((-2, -2, -0.5), (3, 3, 0)), fdem.Rigid(), name="base", fixed=True)
    stone = fdem.Elastic(density=2500, young=1e9, poisson=0.2)
    scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), body, stone, name="low")
    scene.add(
        fdem.brick((0.3, 0.2, 0.5), (1.1, 0.9, 1.1)), fdem.Rigid(), stone, name="high",
        velocity=(0.3, 0.1, 0.0), angular_velocity=(0.0, 0.0, 0.4),
    )  # fmt: skip
    scene.joint(fdem.Coulomb(kn=5e8, ks=3e8, friction=20, cohesion=1e3, tension=1e3, damping=0.05))
    return scene


def bits(sim: fdem.Simulation) -> dict[str, np.ndarray]:
    """State, contacts and energies."""
    table = sim.contact_table()
    result = {name: np.array(getattr(sim.state, name)) for name in ("q", "v", "x")}
    result |= {key: np.array(table[key]) for key in ("force", "slip", "state", "gap", "area")}
    energy = sim.energy
    return result | {"energy": np.array([energy.kinetic, energy.strain, energy.joint, energy.friction, energy.damping])}


@scenario("S38", "save at half time and restart")
def s38(full: bool) -> Iterator[Row]:
    """Every bit of state, contacts (slip among them) and energies, for every body."""
    kinds = {"rigid": fdem.Rigid(), "uniform": fdem.UniformStrain(), "linear": fdem.LinearStrain(),
             "zoned": fdem.Zoned(size=0.5)}  # fmt: skip
    for name, body in kinds.items():
        whole, half = simulation(sliding_pile(body)), simulation(sliding_pile(body))
        whole.cycle(709)
        half.cycle(359)
        with tempfile.TemporaryDirectory() as folder:
            half.save(Path(folder, "half.npz"))
            again = fdem.load(Path(folder, "half.npz"), sliding_pile(body), fdem.Explicit(), progress=False)
        again.cycle(350)
        ours, theirs = bits(again), bits(whole)
        different = [key for key in ours if ours[key].tobytes() != theirs[key].tobytes()]
        slipped = np.ptp(theirs["slip"]) > 0
        yield holds(f"{name}: bits", not different and slipped, "the same, with slip", ", ".join(different) or "same")
