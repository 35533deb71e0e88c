"""Resting and slowly driven rigid blocks: mass ratio, redundant contacts, friction, a wall, coordinates far away."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

import fdem

from .base import G, Row, at_most, holds, scenario, settled, simulation

STONE = fdem.Elastic(density=2000.0)
UTM = (500_000.0, 4_600_000.0, 300.0)

LIGHT, HEAVY, CLOSURE = 1.0, 1e6, 1e6 * G / (1e13 * 0.01)


def million_on_one() -> fdem.Scene:
    """1e6 kg on 1 kg, cubes of 0.1 m: kn = 1e13 Pa/m closes by 1e-3 of the edge (1e9 by more than all of it)."""
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((-1, -1, -1), (1, 1, 0)), fdem.Rigid(), fixed=True, name="base")
    for k, (name, density) in enumerate({"light": 1e3, "heavy": 1e9}.items()):
        shape = fdem.brick((0, 0, 0.1 * k), (0.1, 0.1, 0.1 + 0.1 * k))
        scene.add(shape, fdem.Rigid(), fdem.Elastic(density), name=name)
    scene.joint(fdem.Coulomb(kn=1e13, ks=1e13, friction=30))
    return scene


def errors_of_million(sim: fdem.Simulation) -> tuple[float, float, float]:
    """Worst error of the two forces over the weight, deepest closure over the elastic one, largest speed."""
    weight = np.array([LIGHT + HEAVY, HEAVY]) * G
    forces = np.array([sim.pair_force("base", "light"), sim.pair_force("light", "heavy")])
    forces[:, 2] -= weight
    heights = sim[["light", "heavy"]].position[:, 2] - [0.05, 0.15]
    closure = -np.diff([0.0, *heights]).min() / CLOSURE
    return np.abs(forces).max() / (HEAVY * G), closure, np.abs(sim[["light", "heavy"]].velocity).max()


def check_million_on_one(sim: fdem.Simulation, rel: float) -> None:
    """Raise an error unless forces are right to `rel`, and closure and speed within the criterion."""
    force, closure, speed = errors_of_million(sim)
    if not (force <= rel and closure <= 1.05 and speed <= 1e-3):
        raise AssertionError(f"forces {force:.2g} against {rel:g}, closure {closure:.4g}, speed {speed:.2g} m/s")


@scenario("S01", "mass ratio 1 : 1e6, heavy on light")
def s01(full: bool) -> Iterator[Row]:
    """Relaxed, then ten seconds (quick: 0.05 s) of explicit steps from there."""
    start = settled(million_on_one(), 1e-9)
    force, closure, _ = errors_of_million(start)
    yield at_most("relaxation: error of the forces", force, 1e-8)
    yield at_most("relaxation: closure / elastic", closure, 1.05)
    sim = simulation(million_on_one(), fdem.Explicit(), start=start, energy=False)
    worst = np.zeros(3)
    for _ in range(20):
        sim.run(time=(10.0 if full else 0.05) / 20)
        worst = np.maximum(worst, errors_of_million(sim))
    yield at_most(f"explicit {sim.time:.2g} s: error of the forces", worst[0], 1e-4)
    yield at_most("explicit: closure / elastic", worst[1], 1.05)
    yield at_most("explicit: speed [m/s]", worst[2], 1e-3)
    static = simulation(million_on_one(), fdem.Static(tolerance=1e-11))
    static.solve(ratio=1e-11)
    force, closure, _ = errors_of_million(static)
    yield at_most("Static: error of the forces", force, 1e-8)
    yield at_most("Static: closure / elastic", closure, 1.05)
    sim = simulation(million_on_one(), fdem.Newmark(dt=0.5, tolerance=1e-10), start=static)
    worst = np.zeros(3)
    for _ in range(20):
        sim.cycle(1)
        worst = np.maximum(worst, errors_of_million(sim))
    yield at_most(f"Newmark {sim.time:.2g} s: error of the forces", worst[0], 1e-8)
    yield at_most("Newmark: speed [m/s]", worst[2], 1e-3)
    sim, iterations, speed = simulation(million_on_one(), fdem.ContactDynamics(dt=1e-2)), 0, 0.0
    for _ in range(1000 if full else 100):
        sim.cycle(1)
        iterations = max(iterations, sim.integrator.iterations)
        speed = max(speed, np.abs(sim[["light", "heavy"]].velocity).max())
    yield at_most(f"contact dynamics {sim.time:.2g} s: error of the forces", errors_of_million(sim)[0], 1e-6)
    yield at_most("contact dynamics: iterations of a step", iterations, 1000)
    yield at_most("contact dynamics: speed [m/s]", speed, 1e-3)


@scenario("S11", "stack of ten cubes without friction")
def s11(full: bool) -> Iterator[Row]:
    """Aligned and 1e-9 m off.

    A stack without friction is unstable: the lowest joint tilts by N d / (kn I) where the load above is d off, and g
    times that drives it on, so offsets grow at up to sqrt(12 g N / (kn b^4)) = 0.15 / s. Half the stable step keeps
    1e5 steps within 40 s of it.
    """
    for offset, limit in ((0.0, 1e-6), (1e-9, 1e-3)):
        rng = np.random.default_rng(11)
        scene, cubes = fdem.Scene(gravity=(0, 0, -G)), []
        scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
        for k in range(10):
            low = np.array([*rng.uniform(-offset, offset, 2), k])
            cubes.append(scene.add(fdem.brick(low, low + 1), fdem.Rigid(), STONE))
        scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=0))
        sim = simulation(scene, fdem.Explicit(safety=0.4), start=settled(scene), energy=False)
        begin = sim[cubes].position
        if offset:
            sim.run(time=10.0)
        else:
            sim.cycle(100_000)
        name = f"offset {offset:g} m, {sim.steps} steps"
        yield at_most(f"{name}: motion sideways [m]", np.abs(sim[cubes].position - begin)[:, :2].max(), limit)
        yield at_most(f"{name}: rotation [rad]", np.abs(sim[cubes].rotation_vector).max(), 1e-6)


def on_facets(n: int) -> tuple[fdem.Scene, Any]:
    """A box on n x n flush fixed blocks."""
    scene, grid = fdem.Scene(), np.linspace(0, 1, n + 1)
    for i, j in np.ndindex(n, n):
        facet = fdem.brick((grid[i], grid[j], -1), (grid[i + 1], grid[j + 1], 0))
        scene.add(facet, fdem.Rigid(), fixed=True, group="floor")
    box = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), fdem.Rigid(), STONE, name="box")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    return scene, box


def in_groove(friction: float) -> tuple[fdem.Scene, Any]:
    """A square bar in a V groove of 90 degrees."""
    scene, h = fdem.Scene(), np.sqrt(0.5)
    sides = ([(0, 0), (-2, 2), (-2, -1), (0, -1)], [(0, 0), (0, -1), (2, -1), (2, 2)])
    for name, side in zip(("left", "right"), sides, strict=True):
        scene.add(fdem.prism(side, 1.0), fdem.Rigid(), fixed=True, name=name)
    box = scene.add(fdem.prism([(0, 0), (h, h), (0, 2 * h), (-h, h)], 1.0), fdem.Rigid(), STONE, name="box")
    scene.joint(fdem.Coulomb(kn=1e10, ks=1e10, friction=friction))
    return scene, box


def errors_on_facets(n: int, sim: fdem.Simulation, box: Any) -> tuple[float, float]:
    """Error of the resultant over the weight, and of the shares of the facets."""
    error = np.abs(sim[box].contact_force - [0, 0, 1000 * G]).max() / (1000 * G)
    table = sim.contact_table()
    share = np.bincount(table["block_a"], np.abs(table["force"][:, 2]), n * n) * n**2 / (1000 * G)
    return error, np.abs(share - 1).max()


@scenario("S20", "redundant contacts")
def s20(full: bool) -> Iterator[Row]:
    """4, 16 and 400 facets under a box, and a box in a groove.

    With friction the shares of thrust and shear in the groove are one admissible set of many: they depend on the way
    to rest.
    """
    cycles = []
    for n in (2, 4, 20):
        scene, box = on_facets(n)
        sim = simulation(scene, fdem.Relaxation())
        report = sim.solve(ratio=1e-10)
        cycles.append(report.cycles)
        error, share = errors_on_facets(n, sim, box)
        yield at_most(f"{n * n} facets: error of the resultant", error if report.converged else np.nan, 1e-8)
        yield at_most(f"{n * n} facets: error of the shares", share, 1e-6)
    yield at_most("cycles, most over fewest", max(cycles) / min(cycles), 10)
    for name, integrator in (("Static", fdem.Static), ("contact dynamics", partial(fdem.ContactDynamics, dt=1e-2))):
        iterations = []
        for n in (1, 2, 10):
            scene, box = on_facets(n)
            sim = simulation(scene, integrator())
            if name == "Static":
                sim.solve(ratio=1e-10)
            else:
                sim.cycle(1)
            iterations.append(max(sim.integrator.iterations, 1))
            error = np.abs(sim[box].contact_force - [0, 0, 1000 * G]).max() / (1000 * G)
            yield at_most(f"{name}, {4 * n * n} points: error of the resultant", error, 1e-8)
        yield at_most(f"{name}: iterations, most over fewest", max(iterations) / min(iterations), 10)
    weight, h = 2000 * G, np.sqrt(0.5)
    for friction in (0.0, 20.0, 50.0):
        scene, box = in_groove(friction)
        sim = settled(scene)
        left, right = sim.pair_force("left", box), sim.pair_force("right", box)
        name = f"groove, friction {friction:g}"
        yield at_most(f"{name}: error of the resultant", np.abs(left + right - [0, 0, weight]).max() / weight, 1e-8)
        yield at_most(f"{name}: left against right", np.abs(left * [-1, 1, 1] - right).max() / weight, 1e-6)
        normal, shear = (left[0] + left[2]) * h, (left[2] - left[0]) * h
        beyond = (abs(shear) - np.tan(np.radians(friction)) * normal) / weight
        yield at_most(f"{name}: shear beyond the cone", beyond, 1e-8)
        if friction == 0:
            yield at_most(f"{name}: error of the normal force", abs(normal / (weight * h) - 1), 1e-8)


def pulled(degrees: float) -> tuple[fdem.Scene, Any, Any]:
    """A box on a plane, mu = 0.5, with a load at its base of mu W in this direction."""
    turn = np.radians(degrees)
    pull = np.array([np.cos(turn), np.sin(turn), 0.0])
    scene = fdem.Scene()
    scene.add(fdem.brick((-3, -3, -1), (4, 4, 0)), fdem.Rigid(), fixed=True, name="base")
    box = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), fdem.Rigid(), STONE, name="box")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=np.degrees(np.arctan(0.5))))
    load = scene.apply(fdem.Force(0.5 * 1000 * G * pull, at=(0.5, 0.5, 0)), box, factor=0.0)
    return scene, box, load


@scenario("S33", "friction is the same in every direction")
def s33(full: bool) -> Iterator[Row]:
    """Holds at 0.995 of mu W, slides at 1.005, along the pull."""
    for degrees in (0.0, 11.25, 22.5, 45.0):
        scene, box, load = pulled(degrees)
        sim = settled(scene, 1e-8)
        sim[load].factor = 0.995
        held = sim.solve(ratio=1e-6).reason
        yield holds(f"{degrees:g} degrees, 0.995 mu W", held == "equilibrium", "equilibrium", held)
        before = sim[box].position
        sim[load].factor = 1.005
        slides = sim.solve(ratio=1e-6).reason
        yield holds(f"{degrees:g} degrees, 1.005 mu W", slides == "collapse", "collapse", slides)
        slid = sim[box].position - before
        off = abs(np.degrees(np.arctan2(slid[1], slid[0])) - degrees)
        yield at_most(f"{degrees:g} degrees: slip off the pull [degrees]", off, 0.5)


def stack_at(origin: Any) -> tuple[np.ndarray, set[tuple[int, int]]]:
    """Forces (10, 3) between ten cubes at rest, and the pairs in contact."""
    origin = np.asarray(origin, float)
    scene = fdem.Scene()
    scene.add(fdem.brick(origin - 1, origin + np.array([2, 2, 0])), fdem.Rigid(), fixed=True, name="base")
    low = [origin + np.array([0, 0, k]) for k in range(10)]
    cubes = [scene.add(fdem.brick(at, at + 1), fdem.Rigid(), STONE, name=f"cube {k}") for k, at in enumerate(low)]
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
    sim = settled(scene, 1e-9)
    forces = np.array([sim.pair_force(a, b) for a, b in zip(["base", *cubes[:-1]], cubes, strict=True)])
    table = sim.contact_table()
    return forces, set(zip(table["block_a"].tolist(), table["block_b"].tolist(), strict=True))


def wall(courses: int, bricks: int, kn: float = 1e10) -> tuple[fdem.Scene, list[Any]]:
    """Dry running bond of so many courses on a fixed base, mu = 0.6."""
    scene = fdem.Scene()
    shapes = fdem.wall(0.2 * bricks, 0.1 * courses, 0.1, (0.2, 0.1, 0.1))
    stones = scene.add(shapes, fdem.Rigid(), STONE, name="brick")
    scene.add(fdem.brick((-1, -1, -1), (0.2 * bricks + 1, 1.1, 0)), fdem.Rigid(), fixed=True, name="base")
    scene.joint(fdem.Coulomb(kn=kn, ks=0.8 * kn, friction=np.degrees(np.arctan(0.6))))
    return scene, stones


def pushes_in_wall(sim: fdem.Simulation, stones: list[Any], courses: int) -> dict[str, float]:
    """What the courses and the pairs of bricks carry, against the weight above them."""
    weight = G * np.array([sim[stone].mass for stone in stones])
    height = np.array([stone.shape.centroid[2] for stone in stones])
    course = np.floor(height / 0.1).astype(int)
    table = sim.contact_table()
    lying = np.abs(table["normal"][:, 2]) > 0.5
    level = np.append(height, -1.0)  # the base was added last
    a, b = table["block_a"], table["block_b"]
    upper = np.where(level[a] > level[b], a, b)
    push = np.where(upper == b, 1, -1) * table["force"][:, 2] * lying
    carried = np.array([weight[course >= k].sum() for k in range(courses)])
    n = len(level)
    pairs = np.bincount(a * n + b, push, n * n).reshape(n, n)
    ground = pairs[:, len(stones)] + pairs[len(stones)]
    between_bricks = pairs[: len(stones), : len(stones)]
    return {
        "courses": np.abs(np.bincount(course[upper], push, courses) / carried - 1).max(),
        "ground": np.abs(ground).max() / (courses * weight.max()) - 1,
        "bricks": between_bricks.max() / ((courses - 1) * weight.max() / 2) - 1,
        "weight": weight.sum(),
        "brick": weight.max(),
    }


@scenario("S12", "running-bond wall of a thousand bricks")
def s12(full: bool) -> Iterator[Row]:
    """25 x 40, gravity from zero, by relaxation (the documented damping)."""
    courses, bricks, kn = 25, 40, 1e10
    scene, stones = wall(courses, bricks, kn)
    sim = simulation(scene, fdem.Relaxation())
    report = sim.solve(ratio=1e-5)
    yield holds(
        f"{len(stones)} bricks: equilibrium", report.reason == "equilibrium" and len(stones) > 1000, "reached",
        f"{report.reason}, {report.cycles} cycles, {report.wall_time:.1f} s",
    )  # fmt: skip
    found = pushes_in_wall(sim, stones, courses)
    yield at_most("mean of the courses: error", found["courses"], 1e-4)
    yield at_most("largest force on the ground: error", abs(found["ground"]), 0.02)
    yield at_most("largest force between bricks: error", abs(found["bricks"]), 0.02)
    kinetic = sim.energy.kinetic / (found["weight"] * 0.1 * courses)
    yield at_most("kinetic energy / m g h", kinetic, 1e-8)
    closures = courses * (courses + 1) / 2 * found["brick"] / (kn * 0.2 * 0.1)
    moved = np.linalg.norm(sim[stones].displacement, axis=1).max()
    yield at_most("largest motion / sum of closures", moved / closures, 2.0)
    rows, columns = (courses, bricks) if full else (10, 10)
    scene, stones = wall(rows, columns)
    sim, residual = simulation(scene, fdem.ContactDynamics(dt=1e-3)), 0.0
    for _ in range(3):
        sim.cycle(1)
        residual = max(residual, sim.integrator.residual)
    name = f"contact dynamics, {len(stones)} bricks"
    yield at_most(f"{name}: residual", residual, 1e-6)
    found = pushes_in_wall(sim, stones, rows)
    yield at_most(f"{name}: mean of the courses: error", found["courses"], 1e-4)


@scenario("S22", "coordinates of a national grid")
def s22(full: bool) -> Iterator[Row]:
    """Stack, patch test and wedge at (500000, 4600000, 300) m against the origin."""
    from .far import patch_at, wedge_angle

    (near, pairs), (far, far_pairs) = stack_at((0, 0, 0)), stack_at(UTM)
    yield at_most("stack: change of the forces", np.abs(far - near).max() / np.abs(near).max(), 1e-6)
    yield holds("stack: same contacts", pairs == far_pairs, "the same", len(pairs))
    stresses = [patch_at(origin) for origin in ((0, 0, 0), UTM)]
    change = np.abs(stresses[1] - stresses[0]).max() / np.abs(stresses[0]).max()
    yield at_most("patch test: change of the stresses", change, 1e-6)
    angles, touching = zip(*(wedge_angle(origin) for origin in ((0, 0, 0), UTM)), strict=True)
    yield at_most("wedge: change of the critical angle [degrees]", abs(angles[1] - angles[0]), 0.05)
    yield holds("wedge: same contacts", touching[0] == touching[1], "the same", len(touching[0]))
