"""Overlap, tunnelling, edges that nearly lie along each other, seams, and a broad phase over a large domain."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Iterator
from typing import Any

import numpy as np

import fdem
from fdem.contact.broad import REACH, candidate_pairs

from .base import G, Row, at_most, holds, scenario, settled, simulation

STONE = fdem.Elastic(density=2000.0, young=1e10, poisson=0.2)


def overlapping(part: float, gap_tolerance: float | None = 0.0) -> tuple[fdem.Scene, Any, Any]:
    """Two 1 m cubes that overlap by a part of the edge, at rest, without gravity."""
    scene = fdem.Scene(gravity=(0, 0, 0), gap_tolerance=gap_tolerance)
    a = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE, name="a")
    b = scene.add(fdem.brick((0, 0, 1 - part), (1, 1, 2 - part)), fdem.Rigid(), STONE, name="b")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    return scene, a, b


@scenario("S07", "huge initial overlap")
def s07(full: bool) -> Iterator[Row]:
    """20 % of the edge sets free no more than it stores, 30 % is refused.

    The stored energy is kn times the depth below the nearest face integrated over the overlap: with the side faces
    near the rim, ``kn int_0^d (1 - 2 s)^2 (d - s) ds``, three quarters of ``kn d^2 / 2``.
    """
    scene, a, b = overlapping(0.2)
    sim = simulation(scene)
    sim.run(time=0.05)
    d, speed = 0.2, sim[b].velocity[2] - sim[a].velocity[2]
    stored = 1e9 * (d**2 / 2 - 2 * d**3 / 3 + d**4 / 3)
    apart = not np.any(sim.contact_table()["area"])
    yield holds("20 %: blocks part", apart and speed > 0, "yes")
    yield at_most("20 %: speed / sqrt(kn A d^2 / m)", speed / np.sqrt(1e9 * d**2 / 1000.0), 1.05)
    yield at_most("20 %: energy after / stored", sim.energy.kinetic / stored, 1.01)
    hard = simulation(overlapping(0.2)[0], fdem.ContactDynamics(dt=1e-3))
    hard.cycle(60)
    yield at_most("20 %, contact dynamics: kinetic energy / m g L", hard.energy.kinetic / (2000 * G), 1e-6)
    left = abs(hard["b"].position[2] - hard["a"].position[2] - 1.0)
    yield at_most("20 %, contact dynamics: overlap that is left [m]", left, 1e-6)
    for part, tolerance in ((0.3, 0.0), (0.2, None), (0.3, None)):
        name = f"{100 * part:g} %, gap_tolerance={tolerance}"
        try:
            simulation(overlapping(part, tolerance)[0])
            yield holds(name, False, "refused, both blocks named", "accepted")
        except (fdem.SceneError, fdem.OverlapError) as error:
            yield holds(name, "'a' and 'b'" in str(error), "refused, both blocks named", type(error).__name__)


def shot(speed: float, kn: float, gap: float, dt: float | None = None) -> fdem.Simulation:
    """A sphere of 0.05 m (320 facets) that flies at a plate of 0.01 m from a height `gap` above it."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((-0.5, -0.5, -0.01), (0.5, 0.5, 0)), fdem.Rigid(), fixed=True, name="plate")
    ball = fdem.icosphere(0.05, (0, 0, 0.05 + gap))
    scene.add(ball, fdem.Rigid(), fdem.Elastic(density=7800.0), name="ball", velocity=(0, 0, -speed))
    scene.joint(fdem.Coulomb(kn=kn, ks=kn, friction=0))
    return simulation(scene, fdem.Explicit(dt=dt), energy=False)


@scenario("S09", "tunnelling at 100 and 1000 m/s")
def s09(full: bool) -> Iterator[Row]:
    """Start phases at random (1000 in all, quick: 10): the ball rebounds, or the joint is refused as too soft.

    The joint is as stiff as the plate needs: kn r pi d^3 / 3 = m v^2 / 2 at a depth d of 1.4 mm, its limit is 2.5 mm.
    """
    for speed in (100.0, 1000.0):
        passed, worst = 0, 0.0
        phases = np.random.default_rng(9).uniform(1e-4, 0.02, 500 if full else 5)
        for gap in phases:
            sim = shot(speed, 2e14 * (speed / 100.0) ** 2, gap)
            sim.run(time=(2 * gap + 0.012) / speed)
            worst = max(worst, abs(sim["ball"].velocity[2] / speed - 1))
            passed += sim["ball"].position[2] < 0.05
        yield at_most(f"{speed:g} m/s: tunnelled of {len(phases)} phases", passed, 0)
        yield at_most(f"{speed:g} m/s: error of the rebound", worst, 0.05)
        for kn in (1e9, 1e12):
            try:
                sim = shot(speed, kn, 0.0123)
                sim.run(time=(2 * 0.0123 + 0.03) / speed)
                said = "accepted"
            except fdem.OverlapError as error:
                said = "OverlapError" if "'plate' and 'ball'" in str(error) else str(error)
            yield holds(f"{speed:g} m/s, kn = {kn:g}", said == "OverlapError", "refused, both blocks named", said)
    for jump in (0.02, 0.05, 0.15, 0.3):
        try:
            shot(100.0, 1e14, 0.03, dt=jump / 100.0).cycle(5)
            said = "accepted"
        except fdem.OverlapError:
            said = "OverlapError"
        yield holds(f"given step that flies {100 * jump:g} plates", said == "OverlapError", "refused", said)


LENGTH, HALF, EDGE_KN = 1.0, 0.1, 1e10


def ridge(length: float, height: float, angle: float) -> Any:
    """A square bar standing on its edge, along x, turned by `angle` about z."""
    section = HALF * np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])
    points = np.array([[x, y, z] for x in (-length / 2, length / 2) for y, z in section])
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return fdem.convex_hull(points @ turn.T + [0, 0, height])


def crossing(angle: float, friction: float) -> fdem.Simulation:
    """Two such bars, edge over edge, the upper one brought down at 1 mm/s; steps of 1 ms from 0.1 mm above."""
    scene = fdem.Scene(gravity=(0, 0, 0), gap_tolerance=0)
    scene.add(ridge(2 * LENGTH, -HALF, 0.0), fdem.Rigid(), fixed=True, name="lower")
    upper = scene.add(ridge(LENGTH, HALF + 1e-4, angle), fdem.Rigid(), STONE, name="upper")
    scene.joint(fdem.Coulomb(kn=EDGE_KN, ks=EDGE_KN, friction=friction))
    scene.apply(fdem.Velocity((0, 0, -1e-3), angular=(0, 0, 0)), upper)
    return simulation(scene, fdem.Explicit(dt=1e-3), energy=False)


@scenario("S16", "edges that cross at 0.1 to 1e-9 rad, and parallel ones")
def s16(full: bool) -> Iterator[Row]:
    """The contact is there in the step that meets it; 1e-6 rad more changes force and normal by little."""
    for angle in (1e-1, 1e-3, 1e-6, 1e-9, 0.0):
        forces = []
        for friction, turn in ((0.0, angle), (30.0, angle), (30.0, angle + 1e-6)):
            sim = crossing(turn, friction)
            sim.cycle(99)
            early = sim["upper"].contact_force.any()
            sim.cycle(26)
            met = not early and sim["upper"].contact_force[2] > 0
            sim.cycle(975)
            forces.append(sim["upper"].contact_force)
        sizes = np.linalg.norm(forces, axis=1)
        directions = np.array(forces) / sizes[:, None]
        name = f"{angle:g} rad"
        yield holds(f"{name}: contact found when edges meet", met, "yes")
        yield at_most(f"{name}: tilt of the normal [rad]", np.abs(directions[0, :2]).max(), 1e-3)
        yield at_most(f"{name}: change of the force for 1e-6 rad", abs(sizes[2] / sizes[1] - 1), 0.01)
        jump = np.linalg.norm(directions[2] - directions[1])
        yield at_most(f"{name}: change of its direction for 1e-6 rad [rad]", jump, 1e-3)


SEAM_KN = 1e11


def over_a_seam(step: float, gap: float, speed: float, travel: float, every_step: bool) -> tuple[Any, Any]:
    """Histories of velocity and contact force of a smooth box that slides over the seam of two coplanar blocks."""

    def scene_of(v: float) -> tuple[fdem.Scene, Any]:
        scene = fdem.Scene(gravity=(0, 0, -G))
        scene.add(fdem.brick((0, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="left")
        scene.add(fdem.brick((2 + gap, -1, -1), (5, 2, step)), fdem.Rigid(), fixed=True, name="right")
        first = 2 - 0.5 * travel
        shape = fdem.brick((first - 1, 0, 0), (first, 1, 0.5))
        box = scene.add(shape, fdem.Rigid(), fdem.Elastic(density=2000.0), name="box", velocity=(v, 0, 0))
        scene.joint(fdem.Coulomb(kn=SEAM_KN, ks=SEAM_KN, friction=0))
        return scene, box

    start = settled(scene_of(0.0)[0], 1e-9)
    scene, box = scene_of(speed)
    sim = simulation(scene, fdem.Explicit(), start=start)
    sim.system.contacts.clip_always = every_step
    velocity, force = sim.history(box, "velocity"), sim.history(box, "contact_force")
    sim.run(time=travel / speed)
    if sim[box].position[0] <= 1.5 + 0.4 * travel:
        raise AssertionError("the box has not passed the seam")
    return velocity.values, force.values


@scenario("S17", "box over the seam of coplanar faces")
def s17(full: bool) -> Iterator[Row]:
    """Faces level and 1e-12 m off, patches cut in every step; then with the patches kept as they are by habit."""
    for step, gap, every in ((0.0, 0.0, True), (1e-12, 0.0, True), (-1e-12, 1e-12, True), (0.0, 0.0, False)):
        velocity, force = over_a_seam(step, gap, 1.0, 0.2, every)
        name = f"step {step:g} m, {'cut every step' if every else 'patches kept'}"
        yield at_most(f"{name}: kick [m/s]", np.abs(velocity[:, 1:]).max(), 1e-6)
        yield at_most(f"{name}: loss of speed", np.abs(velocity[:, 0] - 1).max(), 1e-6)
        off = np.abs(force - [0, 0, 1000 * G]).max() / (1000 * G)
        yield at_most(f"{name}: error of the force", off, 1e-6)


def brute(lower: np.ndarray, upper: np.ndarray, reach: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """All pairs by comparison of all boxes, sorted."""
    lo, hi = lower - reach[:, None], upper + reach[:, None]
    found = []
    for i in range(len(lo)):
        meet = ((lo[i + 1 :] <= hi[i]) & (lo[i] <= hi[i + 1 :])).all(axis=1) & ~(fixed[i] & fixed[i + 1 :]).astype(bool)
        found += [(i, j) for j in i + 1 + np.flatnonzero(meet)]
    return np.array(found, dtype=np.int32).reshape(-1, 2)


def chains(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Bricks of 0.1 to 1000 m anywhere in 1e6 m, in chains whose members touch, nearly touch or do not."""
    rng = np.random.default_rng(36)
    lower, upper, left = [], [], 0
    for edge in 10.0 ** rng.uniform(-1, 3, n):
        sizes = edge * rng.uniform(0.3, 1, 3)
        if left == 0:
            end, left = rng.uniform(0, 1e6, 3), rng.integers(1, 12)
        low = end - [0, *rng.uniform(0, 0.4, 2)] * sizes
        lower.append(low)
        upper.append(low + sizes)
        end = low + sizes * [1, 0.5, 0.5] + [rng.choice([0, 1e-3, 0.03]) * sizes.min(), 0, 0]
        left -= 1
    return np.array(lower), np.array(upper)


@scenario("S36", "broad phase over 1e6 m, sizes 1 : 1e4")
def s36(full: bool) -> Iterator[Row]:
    """1e4 bodies (quick: 1e3) against brute force."""
    n = 10_000 if full else 1000
    scene = fdem.Scene(gravity=(0, 0, 0))
    lower, upper = chains(n)
    for low, up in zip(lower, upper, strict=True):
        scene.add(fdem.brick(low, up), fdem.Rigid(), STONE)
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    sim = simulation(scene, fdem.Explicit(), energy=False)
    c = sim.system.contacts
    expected = brute(lower - sim.model.origin, upper - sim.model.origin, REACH * c._skins, np.zeros(n, np.uint8))
    ours, theirs = (set(map(tuple, pairs.tolist())) for pairs in (c.pairs, expected))
    yield at_most(f"{n} bodies, {len(theirs)} pairs: missing", len(theirs - ours), 0)
    yield at_most(f"{n} bodies: extra", len(ours - theirs), 0)
    tracemalloc.start()
    begin = time.process_time()
    candidate_pairs(c.surfaces, sim.state.x, c._skins, None)
    spent, peak = time.process_time() - begin, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    yield at_most(f"memory per body [B] (in {1e3 * spent:.0f} ms)", peak / n, 2048)
