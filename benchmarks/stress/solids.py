"""Blocks that deform or turn: stiffness ratio, sliver zones, long spins, zones crushed, drift of an oscillator."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

import fdem

from .base import Row, at_most, between, holds, scenario, settled, simulation
from .far import SHIFT, A, exact_stress
from .meshes import box
from .top import Top

SOFT, HARD, JOINT, SQUEEZE = 1e4, 1e12, 1e9, 1e-4


def sandwich(factor: float = 1.0, hold: bool = True) -> fdem.Scene:
    """A soft cube between two hard ones, nu = 0; the upper face is pushed down by 1e-4 m.

    The soft one has uniform strain, linear in its load; the hard ones hardly strain.
    """
    scene = fdem.Scene(gravity=(0, 0, 0))
    bodies = {"low": fdem.Zoned(), "soft": fdem.UniformStrain(), "high": fdem.Zoned()}
    for k, (name, body) in enumerate(bodies.items()):
        young = SOFT if name == "soft" else HARD
        scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), body, fdem.Elastic(1000.0, young, 0.0), name=name)
    scene.joint(fdem.Coulomb(kn=JOINT, ks=JOINT, friction=30))
    scene.fix("low", where=lambda x: x[:, 2] < 1e-9)
    if hold:
        scene.apply(fdem.Displacement((0, 0, -SQUEEZE)), "high", where=lambda x: x[:, 2] > 3 - 1e-9, factor=factor)
    return scene


@scenario("S03", "stiffness ratio 1 : 1e8 in one model")
def s03(full: bool) -> Iterator[Row]:
    """Squeezed at rest, then let go at 0.9 of the stable step."""
    exact = SQUEEZE / (1 / SOFT + 2 / HARD + 2 / JOINT)
    static = simulation(sandwich(), fdem.Static(tolerance=1e-10))
    static.solve(ratio=1e-10)
    forces = [static.pair_force("low", "soft")[2], static.pair_force("soft", "high")[2]]
    yield at_most("Static: error of the force", np.abs(np.array(forces) / exact - 1).max(), 1e-6)
    if full:
        sim = settled(sandwich(), 1e-9)
        forces = [sim.pair_force("low", "soft")[2], sim.pair_force("soft", "high")[2]]
        yield at_most("relaxation: error of the force", np.abs(np.array(forces) / exact - 1).max(), 1e-6)
    free = simulation(sandwich(hold=False), fdem.Explicit(safety=0.9), start=static)
    energy = free.energy
    start, most = energy.kinetic + energy.strain + energy.joint, 0.0
    for _ in range(20):
        free.cycle(5000 if full else 500)
        energy = free.energy
        most = max(most, energy.kinetic + energy.strain + energy.joint)
    yield at_most(f"explicit, {free.steps} steps at 0.9 of the limit: E / E0", most / start, 1.001)


def sliver(away: float, integrator: Any = None) -> Any:
    """The zones of a cube from its 12 surface triangles to an inner node `away` from its lower face, free or held.

    With an integrator the free block, compiled; else the simulation and the block: brought to the linear field with
    all its nodes, then only the corners are held.
    """
    shape = fdem.brick((0, 0, 0), (1, 1, 1))
    points = np.vstack([shape.points, [0.4, 0.45, away]])
    tets = np.column_stack([np.full(12, 8), shape.triangles])

    def scene() -> tuple[fdem.Scene, Any]:
        made = fdem.Scene(gravity=(0, 0, 0))
        return made, made.add(fdem.tet_mesh(points, tets), fdem.Zoned(), fdem.Elastic(2500, 1e10, 0.25))

    made, block = scene()
    if integrator is not None:
        return simulation(made, integrator)
    made.apply(fdem.Displacement(lambda x: x @ A.T + SHIFT), block)
    start = simulation(made, fdem.Relaxation())
    start.cycle(1500)
    made, block = scene()
    made.fix(block, ("x", "y", "z"), where=lambda x: (np.abs(x - 0.5) > 0.5 - 1e-9).all(axis=1))
    return simulation(made, fdem.Relaxation(), start=start), block


@scenario("S05", "sliver zones")
def s05(full: bool) -> Iterator[Row]:
    """Patch test of 1e-3, 1e-5, 1e-7; the stable step goes with the root of the altitude (the node keeps its mass)."""
    reference = sliver(1e-2, fdem.Explicit())
    reference = reference.integrator.limit(reference.system)
    for away, limit in ((1e-3, 1e-6), (1e-5, 1e-3), (1e-7, 1e-2)):
        sim, block = sliver(away)
        sim.cycle(2000)
        exact = exact_stress(A)
        error = np.abs(sim[block].zone_stress - exact).max() / np.abs(exact).max()
        yield at_most(f"altitude {away:g}: error of the stress", error, limit)
        free = sliver(away, fdem.Explicit())
        step = free.integrator.limit(free.system) / reference / np.sqrt(away / 1e-2)
        yield between(f"altitude {away:g}: step over the root of the altitude", step, 0.5, 2.0)


def turn_of(matrix: np.ndarray) -> float:
    """Angle of a rotation matrix [rad], by its antisymmetric part as well: exact where small."""
    sine = 0.5 * np.linalg.norm([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    return float(np.arctan2(sine, 0.5 * (np.trace(matrix) - 1)))


@scenario("S24", "rigid top in free spin, 1000 periods")
def s24(full: bool) -> Iterator[Row]:
    """Dt = T / 500 (quick: 100 periods); the attitude against the closed form, held to what fourth order must reach."""
    spin, periods, looks = (0.6, 0.1, 1.0), 1000 if full else 100, 20
    scene = fdem.Scene(gravity=(0, 0, 0))
    shape = fdem.brick((-1.5, -1, -0.5), (1.5, 1, 0.5))
    block = scene.add(shape, fdem.Rigid(), fdem.Elastic(1000.0), name="top", angular_velocity=spin)
    top = Top(np.diag(shape.inertia(1000.0)), spin)
    sim = simulation(scene, fdem.Explicit(dt=top.period / 500), energy=False)
    momentum, energies, worst, norm = sim[block].angular_momentum, [], 0.0, 0.0
    for _ in range(looks):
        sim.cycle(500 * periods // looks)
        view = sim[block]
        energies.append(0.5 * view.angular_velocity @ view.angular_momentum)
        worst = max(worst, np.linalg.norm(view.angular_momentum - momentum) / np.linalg.norm(momentum))
        norm = max(norm, abs(np.linalg.norm(sim.state.q[3:7]) - 1))
    first = 0.5 * np.dot(spin, momentum)
    name = f"{periods} periods"
    yield at_most(f"{name}: error of the energy", np.abs(np.array(energies) / first - 1).max(), 1e-6)
    trend = np.polyfit(np.arange(1, looks + 1) * periods / looks, np.array(energies) / first, 1)[0]
    yield at_most(f"{name}: trend of the energy per turn", abs(trend), 1e-9)
    yield at_most(f"{name}: error of the angular momentum", worst, 1e-12)
    yield at_most(f"{name}: error of the norm", norm, 1e-14)
    off = turn_of(sim[block].rotation.T @ top.rotation(sim.steps * sim.dt)) / (2 * np.pi)
    yield at_most(f"{name}: error of the phase [turns]", off, 1e-4)


SPIN = 2 * np.pi


def spinning(
    spin_over_strain: float, turns: int, steps: int, axis: Any = (1.0, 2.0, 2.0)
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """A cube of uniform strain that spins in the shape it takes in steady spin, by its kernels alone.

    Returns volume and strain beyond those of steady spin, means over each turn, the largest change of L, and how
    much larger the block is in steady spin.
    """
    density, poisson, axis = 2000.0, 0.25, np.array(axis) / np.linalg.norm(axis)
    # its highest strain mode: all sides at once, omega^2 = 12 (3 lam + 2 mu) / (rho a^2)
    young = density / 12 * (1 - 2 * poisson) * (SPIN / spin_over_strain) ** 2
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((-0.5,) * 3, (0.5,) * 3), fdem.UniformStrain(), fdem.Elastic(density, young, poisson))
    sim = simulation(scene)
    (batch,), q, v, x = sim.model.batches, sim.state.q, sim.state.v, sim.state.x
    lam, mu, pull = batch.lam[0], batch.mu[0], density / 12 * SPIN**2
    # across the axis e: lam (2 e + z) + 2 mu e = rho a^2 / 12 w^2 (1 + e), along it z: no stress
    e, z = np.linalg.solve([[2 * lam + 2 * mu - pull, lam], [2 * lam, lam + 2 * mu]], [pull, 0.0])
    stretch = (1 + e) * (np.eye(3) - np.outer(axis, axis)) + (1 + z) * np.outer(axis, axis)
    q[3:] = stretch.ravel()
    batch.launch(q, x, v, np.zeros((1, 3)), SPIN * axis[None])
    dt, f, a = 1.0 / steps, np.zeros(12), np.zeros(12)
    momentum, steady = batch.angular_momentum(q, v)[0], np.linalg.det(stretch)
    volume, strain, change, h = np.zeros(turns), np.zeros(turns), 0.0, 0.5 * dt
    for turn in range(turns):
        sums = np.zeros(2)
        for _ in range(steps):
            f[:] = 0.0
            batch.internal(q, x, f)
            batch.accelerate(q, f, a)
            v += h * a
            h = dt
            batch.advance(q, v, dt)
            F = q[3:].reshape(3, 3)
            sums += np.linalg.det(F) - steady, np.vdot(F, F) - np.vdot(stretch, stretch)
        volume[turn], strain[turn] = sums / steps
        now = batch.angular_momentum(q, v)[0]
        change = max(change, np.linalg.norm(now - momentum) / np.linalg.norm(momentum))
    return volume, 0.5 * strain, change, steady - 1.0


@scenario("S26", "deformable block in free spin, 100 turns")
def s26(full: bool) -> Iterator[Row]:
    """100 and 1000 (quick: 20 turns) steps a turn, each half the stable one.

    At so many steps a turn the discrete spin itself stretches by (w dt)^2 / 24 of the steady value more. A rotation
    of first order would give exp(2 pi 100 dtheta).
    """
    for turns, steps in ((100, 100), (100 if full else 20, 1000)):
        volume, strain, change, steady = spinning(SPIN / steps, turns, steps)
        name = f"{turns} turns of {steps} steps"
        yield at_most(f"{name}: volume beyond steady spin", np.abs(volume).max(), 1e-6 + steady * (SPIN / steps) ** 2)
        trend = max(abs(np.polyfit(np.arange(turns), values, 1)[0]) for values in (volume, strain))
        yield at_most(f"{name}: trend per turn", trend, 1e-9)
        yield at_most(f"{name}: change of L", change, 1e-12)


@scenario("S27", "zones crushed past 90 %")
def s27(full: bool) -> Iterator[Row]:
    """The upper end of a column of 10 x 2 x 2 cells is driven down by 105 % in 1000 steps, in both strain measures."""
    for strain in ("large", "small"):
        scene = fdem.Scene(gravity=(0, 0, 0))
        young, density = 1e9, 2500.0
        shape = box((2, 2, 10), (1, 1, 5))
        column = scene.add(shape, fdem.Zoned(strain=strain), fdem.Elastic(density, young, 0.2), name="column")
        scene.add(fdem.brick((4, 0, 0), (5, 1, 1)), fdem.Zoned(), fdem.Elastic(density, young, 0.2), name="other")
        scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
        scene.fix(column, where=lambda x: x[:, 2] < 1e-9)
        dt = simulation(scene).dt
        speed = 1.05 * 5 / (1000 * dt)
        scene.apply(fdem.Velocity((0, 0, -speed)), column, where=lambda x: x[:, 2] > 5 - 1e-9)
        sim, c = simulation(scene, fdem.Explicit(dt=dt)), np.sqrt(young / density)
        fastest, said = 0.0, ""
        try:
            while sim.steps < 1000:
                sim.cycle(1)
                fastest = max(fastest, np.abs(sim.velocities()).max())
        except fdem.UnstableError as error:
            said = str(error)
        zone = re.search(r"'column'.*zone \d+", said)
        yield holds(f"{strain} strain: refused", bool(zone), "block and zone named", said[:90])
        yield at_most(f"{strain} strain: fastest gridpoint before / c (driven {speed / c:.2f})", fastest / c, 10.0)
        finite = bool(np.isfinite(sim["other"].gridpoints).all() and np.isfinite(sim["other"].zone_stress).all())
        yield holds(f"{strain} strain: the other block is finite", finite, "yes")
