"""Natural frequencies of a free zoned block from nothing but what a user can read of it."""

from __future__ import annotations

import numpy as np

import fdem


class Kick:
    """A random force on every gridpoint during one step: it excites every mode."""

    def __init__(self, pattern):
        self.pattern, self.on = pattern, True

    def force(self, t, x, v):
        return self.pattern if self.on else np.zeros_like(self.pattern)


def natural_frequencies(make, highest, n, seeds=4, periods=30, pattern=None):
    """The `n` lowest angular frequencies [1/s] of the block in the scene ``make()``.

    Free vibration after a kick is filtered at frequencies up to `highest` [1/s]: displacements u and forces
    f = -K u (linear) filtered alike. In the span of those u, ``-u^T f`` and ``u^T M u`` are the
    stiffness and the mass, so that Ritz values are the discrete frequencies, degenerate ones included.
    Returns also the net force of the rigid modes over the size of the elastic forces.
    """
    shapes, forces = [], []
    for seed in range(seeds):
        scene, block = make()
        kick = scene.apply(Kick(None), block)
        sim = fdem.Simulation(scene, fdem.Explicit(), progress=False, energy=False)
        start = sim[block].gridpoints
        mass = sim[block].gridpoint_mass
        rng = np.random.default_rng(seed)
        draw = rng.standard_normal(start.shape) if pattern is None else pattern(start, rng)
        # no rigid motion: turning would add forces of second order
        moves = np.linalg.qr((np.sqrt(np.repeat(mass, 3)) * _rigid(start)).T)[0]
        draw = np.sqrt(mass)[:, None] * draw
        draw = (draw.ravel() - moves @ (moves.T @ draw.ravel())).reshape(-1, 3) / np.sqrt(mass)[:, None]
        # so weak that the response is linear: strains of about 1e-5
        kick.load.pattern = 1e-6 * mass[:, None] * draw * np.ptp(start, axis=0).max() / sim.dt**2
        sim.cycle(1)
        kick.load.on = False
        every = max(1, int(0.25 * np.pi / (highest * sim.dt)))
        steps = int(periods * 2 * np.pi / (highest * sim.dt) / every)
        view = sim[block]
        u, f = np.empty((steps, start.size)), np.empty((steps, start.size))
        for k in range(steps):
            sim.cycle(every)
            u[k] = (view.gridpoints - start).ravel()
            f[k] = view.generalised_force
        # a smooth window keeps what lies above `highest` out of the span
        time, window = np.arange(steps) * every * sim.dt, np.hanning(steps)
        for omega in np.linspace(highest / (3 * n), highest, 3 * n):
            for wave in (np.cos(omega * time), np.sin(omega * time)):
                shapes.append((window * wave) @ u)
                forces.append((window * wave) @ f)
    return _ritz(np.array(shapes), np.array(forces), mass, start)[:n], _rigid_force(np.array(forces), start)


def _rigid(start):
    arm = start - start.mean(axis=0)
    moves = [np.tile(axis, (len(start), 1)) for axis in np.eye(3)] + [np.cross(axis, arm) for axis in np.eye(3)]
    return np.array(moves).reshape(6, -1)


def _rigid_force(forces, start):
    moves = _rigid(start)
    return np.abs(moves @ forces.T).max() / (np.abs(moves) @ np.abs(forces).T).max()


def _ritz(shapes, forces, mass, start):
    weight = np.repeat(mass, 3)
    moves = np.linalg.qr((np.sqrt(weight) * _rigid(start)).T)[0]
    scaled = shapes * np.sqrt(weight)
    scaled -= (scaled @ moves) @ moves.T  # rigid motion exerts no force
    size = np.linalg.norm(scaled, axis=1)[:, None]
    left, singular, right = np.linalg.svd(scaled / size, full_matrices=False)
    keep = singular > 1e-3 * singular[0]
    # the same combinations of the forces
    combined = (left[:, keep] / singular[keep]).T @ (forces / np.sqrt(weight) / size)
    stiffness = -right[keep] @ combined.T
    values = np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T))
    return np.sqrt(np.abs(values)) * np.sign(values)
