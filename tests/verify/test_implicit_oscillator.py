"""Implicit rules on a linear oscillator, a block on a joint: amplification, period, energy (integ_newmark_hht)."""

from __future__ import annotations

import numpy as np
import pytest

import fdem

MASS, KN = 2000.0, 2e6
W = np.sqrt(KN / MASS)


def oscillator(integrator, speed=1e-3):
    """A cube on a joint that stays closed, from rest under its weight with a small velocity."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    material = fdem.Elastic(density=MASS)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), material, name="block", velocity=(0, 0, speed))
    scene.fix(block, component=("x", "y", "rotation"))
    scene.joint(fdem.Coulomb(kn=KN, ks=KN, friction=0))
    rest = fdem.Simulation(scene, fdem.Static(tolerance=1e-13))
    assert rest.solve(ratio=1e-13).converged
    return fdem.Simulation(scene, integrator, start=rest), block


def amplification(rule, wdt):
    """Amplification matrix of (u, dt v, dt^2 a) of the oscillator ``a = -w^2 u`` (Hughes 1987, chapter 9)."""
    beta, gamma, alpha_m, alpha_f = rule
    k = wdt * wdt
    left = np.array([[1, 0, -beta], [0, 1, -gamma], [(1 - alpha_f) * k, 0, 1 - alpha_m]])
    right = np.array([[1, 1, 0.5 - beta], [0, 1, 1 - gamma], [-alpha_f * k, 0, -alpha_m]])
    return np.linalg.solve(left, right)


def alpha(rho):
    m, f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    return 0.25 * (1 - m + f) ** 2, 0.5 - m + f, m, f


RULES = {
    "trapezoid": (lambda dt, **k: fdem.Newmark(dt=dt, **k), (0.25, 0.5, 0.0, 0.0)),
    "dda": (lambda dt, **k: fdem.Newmark(dt=dt, beta=0.5, gamma=1.0, **k), (0.5, 1.0, 0.0, 0.0)),
    "alpha 0.8": (lambda dt, **k: fdem.GeneralizedAlpha(dt=dt, **k), alpha(0.8)),
    "alpha 0": (lambda dt, **k: fdem.GeneralizedAlpha(dt=dt, rho=0.0, **k), alpha(0.0)),
}


@pytest.mark.parametrize("name", RULES)
@pytest.mark.parametrize("wdt", [0.01, 0.1, 0.5, 1.0, 10.0, 100.0])
def test_steps_are_those_of_the_rule(name, wdt):
    """The motion is that of the amplification matrix, step by step, to 1e-6 (oracle: integ_newmark_hht)."""
    make, rule = RULES[name]
    sim, block = oscillator(make(wdt / W, tolerance=1e-13))
    start = sim[block].displacement[2]
    state, A, seen, expected = np.array([0.0, wdt / W * 1e-3, 0.0]), amplification(rule, wdt), [], []
    for _ in range(12):
        sim.cycle(1)
        state = A @ state
        seen.append(sim[block].displacement[2] - start)
        expected.append(state[0])
    assert np.abs(np.array(seen) - expected).max() <= 1e-6 * np.abs(expected).max()


def test_listed_numbers():
    """Spectral radius and period of the matrices used above against the listed ones (trapezoid, DDA)."""
    for wdt, rho, period in ((0.5, 1.0, 1.0204970376156197), (0.1, 1.0, 1.0008327785041065)):
        value = np.linalg.eigvals(amplification(RULES["trapezoid"][1], wdt))
        value = value[np.argmax(value.imag)]
        assert abs(value) == pytest.approx(rho, abs=1e-12)
        assert wdt / np.angle(value) == pytest.approx(period, rel=1e-12)
    dda = np.linalg.eigvals(amplification(RULES["dda"][1], 0.5))
    assert np.abs(dda).max() == pytest.approx(0.9428090415820636, rel=1e-12)
    # generalised alpha: the radius at infinite frequency is the one asked for
    far = np.linalg.eigvals(amplification(alpha(0.8), 1e6))
    assert np.abs(far).max() == pytest.approx(0.8, abs=2e-3)  # a double root: its error is that of the square root


@pytest.mark.parametrize("steps", [300, pytest.param(10_000, marks=pytest.mark.long)])
def test_trapezoid_keeps_energy(steps):
    """Constant to 1e-10 of the energy of the oscillation, over 1e4 steps (oracle: integ_newmark_hht)."""
    sim, block = oscillator(fdem.Newmark(dt=0.5 / W, tolerance=1e-13), speed=0.1)
    rest = sim[block].displacement[2]
    swing = 0.5 * MASS * 0.1**2

    def energy():
        return 0.5 * MASS * sim[block].velocity[2] ** 2 + 0.5 * KN * (sim[block].displacement[2] - rest) ** 2

    start = energy()
    assert start == pytest.approx(swing, rel=1e-9)
    worst = 0.0
    for _ in range(steps // 100):
        sim.cycle(100)
        worst = max(worst, abs(energy() - start))
    assert worst <= 1e-10 * swing
    # differences of the weight's and the joint's energies, each some 10^4 swings, carry their round-off
    assert sim.energy.closure < 1e-9


@pytest.mark.parametrize("name", ["dda", "alpha 0.8", "alpha 0"])
def test_numerical_loss_is_counted(name):
    """What the rule takes out of the motion is an entry of the balance: damping."""
    sim, _ = oscillator(RULES[name][0](1.0 / W, tolerance=1e-13))
    start = sim.energy.kinetic
    sim.cycle(40)
    assert sim.energy.damping > 0.02 * start
    assert abs(sim.energy.error) < 1e-13 * sim.energy.potential  # round-off of the energies it is a difference of
