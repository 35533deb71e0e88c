"""Explicit and Relaxation on oscillators whose discrete answers are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from stress.steps import MASS, OMEGA, STIFFNESS, oscillator, released
from stress.steps import WEAK as G

import fdem

# gravity only keeps the joint closed; small, so that the sides of the block hardly dip into the base
CRITICAL = 2.0 / OMEGA


@pytest.fixture(scope="module")
def plain():
    return oscillator()


def frequency(u):
    """Phase [rad] per step of a sampled oscillation about zero, from u(n+1) + u(n-1) = 2 cos(phase) u(n)."""
    return np.arccos(0.5 * (u[2:] + u[:-2]) @ u[1:-1] / (u[1:-1] @ u[1:-1]))


@pytest.mark.parametrize("w_dt", [0.1, 0.5, 1.0, 1.9, 1.99])
def test_central_difference_period(plain, w_dt):
    """sin(w_d dt / 2) = w dt / 2: the period ratio to 1e-6."""
    sim = released(plain, fdem.Explicit(dt=w_dt / OMEGA))
    history = sim.history(plain[1], "displacement", component="z")
    sim.cycle(500)
    u = history.values - history.values[0] - 400.0 / STIFFNESS
    ratio = w_dt / frequency(u)
    assert ratio == pytest.approx(0.5 * w_dt / np.arcsin(0.5 * w_dt), rel=1e-6)


def bounded(setup, integrator, steps=2000):
    """Whether the released block keeps to three times its first distance from equilibrium."""
    sim = released(setup, integrator, energy=False)
    first = abs(setup[2].load.value[2]) / STIFFNESS
    rest = sim[setup[1]].position[2] + first
    history = sim.history(setup[1], "position", component="z")
    while sim.steps < steps:
        try:
            sim.cycle(50)
        except fdem.FdemError:
            return False
        if np.abs(history.values[-50:] - rest).max() > 3 * first:
            return False
    return True


def lagged(zeta):
    return np.sqrt(1 + zeta**2) - zeta


FORMS = {
    "mass": (lambda dt, zeta: fdem.Explicit(dt=dt, damping=fdem.Rayleigh(mass=2 * zeta * OMEGA)), lambda zeta: 1.0),
    "stiffness": (lambda dt, zeta: fdem.Explicit(dt=dt, damping=fdem.Rayleigh(stiffness=2 * zeta / OMEGA)), lagged),
    "joint": (lambda dt, zeta: fdem.Explicit(dt=dt), lagged),
}


@pytest.mark.parametrize("zeta", [0.0, 0.05, 0.2, 1.0])
@pytest.mark.parametrize("form", FORMS)
def test_central_difference_critical_step(form, zeta):
    """The critical step, bisected, within 0.5 % of the closed form of each kind of damping."""
    make, share = FORMS[form]
    setup = oscillator(push=-20.0, joint_damping=zeta if form == "joint" else 0.0)
    exact = CRITICAL * share(zeta)
    low, high = 0.98 * exact, 1.02 * exact
    assert bounded(setup, make(low, zeta)) and not bounded(setup, make(high, zeta))
    while high - low > 1e-3 * exact:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if bounded(setup, make(middle, zeta)) else (low, middle)
    assert 0.5 * (low + high) == pytest.approx(exact, rel=5e-3)


def energy_above(setup, sim):
    """Energy [J] over that of the block at rest under its weight."""
    rest = MASS * G / STIFFNESS
    bottom = sim[setup[1]].position[2] - 0.2
    kinetic = 0.5 * MASS * sim[setup[1]].velocity[2] ** 2
    return kinetic + 0.5 * STIFFNESS * (bottom + rest) ** 2


def test_bounded_just_below_the_critical_step(plain):
    """At 0.999 of the limit 1e5 steps stay within the discrete bound (here E0), at 1.001 the motion grows."""
    sim = released(plain, fdem.Explicit(dt=0.999 * CRITICAL))
    start = energy_above(plain, sim)
    history = sim.history(lambda s: energy_above(plain, s), every=50)
    sim.cycle(100_000)
    assert history.values.max() <= start * (1 + 1e-9)
    assert not bounded(oscillator(push=-20.0), fdem.Explicit(dt=1.001 * CRITICAL))


def test_step_above_the_limit_warns_and_raises(plain):
    """A step of the user's above the limit: a warning at once, an error when energy grows."""
    scene, _, load, settled = plain
    with pytest.warns(fdem.FdemWarning, match="stable"):
        sim = fdem.Simulation(scene, fdem.Explicit(dt=1.01 * CRITICAL), start=settled)
    sim[load].factor = 0.0
    with pytest.raises(fdem.UnstableError, match="block"):
        sim.cycle(5000)


@pytest.mark.parametrize("w_dt", [0.05, 0.2, 0.9])
@pytest.mark.parametrize("steps", [20_000, pytest.param(1_000_000, marks=pytest.mark.long)])
def test_energy_drift(plain, w_dt, steps):
    """E_min = E0 (1 - (w dt)^2 / 4) and E_max = E0 within 1e-6; no trend beyond 1e-9 E0 in 1e6 steps."""
    sim = released(plain, fdem.Explicit(dt=w_dt / OMEGA), energy=False)
    block, rest = plain[1], MASS * G / STIFFNESS
    position = sim.history(block, "position", component="z")
    velocity = sim.history(block, "velocity", component="z")
    sim.cycle(steps)
    u, v = position.values - 0.2 + rest, velocity.values
    kinetic, strain = 0.5 * MASS * v**2, 0.5 * STIFFNESS * u**2
    energy = (kinetic + strain) / (kinetic + strain)[0]
    assert energy.min() == pytest.approx(1 - 0.25 * w_dt**2, abs=1e-6)
    assert energy.max() == pytest.approx(1.0, abs=1e-6)
    # the part that swings is known exactly: what is left is the drift
    invariant = (kinetic + strain * (1 - 0.25 * w_dt**2)) / (kinetic + strain)[0]
    trend = np.polyfit(np.linspace(0, 1, len(invariant)), invariant, 1)[0]
    assert abs(trend) <= 1e-9


JOINTS = np.array([1e8, 2e8, 5e8, 1e8, 1e9, 2e8, 3e8, 1e8, 4e8, 1e8, 2e8])


def test_relaxed_chain():
    """Ten blocks between platens, 11 joints, weight, the upper platen 0.02 m down: 1e-6 at a ratio of 1e-8.

    Every other block is 2 x 2 m: where faces of the same size meet, the outer rim of the contact is nearer to the
    sides than to the face, and the force differs from kn A g by the order of closure / size.
    """
    g = 9.81
    scene = fdem.Scene(gravity=(0, 0, -g))
    base = scene.add(fdem.brick((-2, -2, -1), (3, 3, 0)), fdem.Rigid(), fixed=True, name="base")
    chain = []
    for i in range(11):
        wide = 0.5 * (i % 2)
        shape = fdem.brick((-wide, -wide, i), (1 + wide, 1 + wide, i + 1))
        stone = fdem.Elastic(density=MASS / shape.volume)
        chain.append(scene.add(shape, fdem.Rigid(), stone, name="platen" if i == 10 else f"block {i}"))
    pairs = list(zip([base, *chain[:-1]], chain, strict=True))
    for kn, between in zip(JOINTS, pairs, strict=True):
        scene.joint(fdem.Coulomb(kn=kn, ks=0.4 * kn, friction=30), between=between)
    scene.apply(fdem.Displacement((0, 0, -0.02)), chain[-1])
    scene.fix(chain[-1], component=("x", "y", "rotation"))
    matrix = np.diag(JOINTS[:-1] + JOINTS[1:]) - np.diag(JOINTS[1:-1], 1) - np.diag(JOINTS[1:-1], -1)
    right = np.full(10, -MASS * g)
    right[-1] -= JOINTS[-1] * 0.02
    exact = np.append(np.linalg.solve(matrix, right), -0.02)

    sim = fdem.Simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-8).converged
    assert sim[chain].displacement[:, 2] == pytest.approx(exact, rel=1e-6)
    forces = [sim.pair_force(a, b)[2] for a, b in pairs]
    assert forces == pytest.approx(-JOINTS * np.diff(exact, prepend=0.0), rel=1e-6)


@pytest.mark.parametrize("alpha", [0.1, 0.5, 0.8])
def test_local_damping_decay(plain, alpha):
    """Cundall's local damping: ratio per half cycle and half period to 1 % at w dt = 0.02."""
    sim = released(plain, fdem.Explicit(dt=0.02 / OMEGA, damping=fdem.Local(alpha)))
    history = sim.history(plain[1], "position", component="z")
    sim.cycle(2000)
    u = np.abs(history.values - 0.2 + MASS * G / STIFFNESS)
    tops = 1 + np.flatnonzero((u[1:-1] > u[:-2]) & (u[1:-1] >= u[2:]))[:4]
    swings = np.concatenate([[u[0]], u[tops]])
    assert swings[1:] / swings[:-1] == pytest.approx(np.sqrt((1 - alpha) / (1 + alpha)), rel=0.01)
    half = 0.5 * np.pi * (1 / np.sqrt(1 - alpha) + 1 / np.sqrt(1 + alpha))
    assert np.diff([0, *tops]).mean() * 0.02 == pytest.approx(half, rel=0.01)
