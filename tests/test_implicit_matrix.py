"""The matrix of Newton's method against differences of the forces: every body, loads that depend on place."""

from __future__ import annotations

import numpy as np
import pytest

import fdem

SOFT = fdem.Elastic(density=2000, young=1e7, poisson=0.25)
BODIES = {
    "rigid": fdem.Rigid(),
    "uniform": fdem.UniformStrain(),
    "linear": fdem.LinearStrain(),
    "zoned": fdem.Zoned(size=0.7),
    "zoned, small strain": fdem.Zoned(size=0.7, strain="small"),
    "zoned, matched": fdem.Zoned(size=0.7, mass="inertia-matched"),
}


def resting(body, law=None):
    """A box that hangs a little into a floor, turned, no symmetry left."""
    scene = fdem.Scene(gap_tolerance=0.0)
    scene.add(fdem.brick((-2, -2, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="floor")
    block = scene.add(fdem.brick((-0.5, -0.4, -1e-3), (0.5, 0.4, 0.7)), body, SOFT, name="block")
    scene.joint(law or fdem.Coulomb(kn=1e7, ks=5e6, friction=30))
    return scene, block


def balls(law):
    """Three spheres and a clump between each other and a floor."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-2, -2, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="floor")
    for k, x in enumerate(([0, 0, 0.4999], [0.9998, 0, 0.4999], [0.5, 0.0, 1.3655])):
        scene.add(fdem.sphere(0.5, x), fdem.Rigid(), SOFT, name=f"ball {k}")
    scene.joint(law)
    return scene


def mismatch(sim, h=1e-3, seed=0, e=1e-7):
    """Largest error of ``K w`` against central differences, relative, for a motion `w` that goes on the same way."""
    trial, rng = fdem_trial(sim), np.random.default_rng(seed)
    d = rng.normal(size=trial.n) * trial_size(trial)
    trial.prescribe(d, h)
    trial.displace(1e-4 * d, h)
    w = d + 0.2 * rng.normal(size=trial.n) * trial_size(trial)
    trial.prescribe(w, h)
    trial.plain_forces()
    expected = trial.assembler.effective(0.0, 0.0, h) @ w
    ends = []
    for sign in (1.0, -1.0):
        trial.displace_further(sign * e * w)
        ends.append(trial.released(trial.plain_forces()))
        trial.displace_further(-sign * e * w)
    change = (ends[1] - ends[0]) / (2.0 * e)
    return np.abs(change - expected).max() / np.abs(change).max()


def fdem_trial(sim):
    trial = sim.integrator.trial
    trial.begin()
    return trial


def trial_size(trial):
    """Sizes that let translations, rotations and coefficients of fields move gridpoints alike."""
    reach = np.array([np.abs(trial.pushed(np.eye(trial.n)[k])).max() for k in range(trial.n)])
    return 1.0 / np.maximum(reach, 0.5)


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_matrix_of_every_body(body):
    """2e-3: small-strain blocks leave out how their frame turns under stress; the contact its friction frame."""
    scene, _ = resting(body)
    assert mismatch(fdem.Simulation(scene, fdem.Newmark(dt=1e-3))) < 2e-3


LOADS = {
    "pressure": (fdem.Pressure(1e5), lambda p: p[:, 2] > 0.6),
    "support": (fdem.Support(normal=1e6, shear=5e5), lambda p: p[:, 2] > 0.6),
    "force at": (fdem.Force((1e4, 2e4, -3e4), at=(0.3, 0.2, 0.7)), None),
    "dead force": (fdem.Force((1e4, 2e4, -3e4)), None),
}


@pytest.mark.parametrize("body", ["rigid", "uniform", "linear", "zoned"])
@pytest.mark.parametrize("load", LOADS)
def test_matrix_of_loads(load, body):
    scene, block = resting(BODIES[body])
    scene.apply(LOADS[load][0], block, where=LOADS[load][1])
    assert mismatch(fdem.Simulation(scene, fdem.Newmark(dt=1e-3))) < 2e-3


SPHERE_LAWS = {
    "coulomb": fdem.Coulomb(kn=1e7, ks=5e6, friction=30),
    "damped": fdem.Coulomb(kn=1e7, ks=5e6, friction=30, restitution=0.5),
    "rolling": fdem.Coulomb(kn=1e7, ks=5e6, friction=30, rolling=0.05, twisting=0.05),
    "hertz": fdem.Hertz(friction=30, restitution=0.7),
}


@pytest.mark.parametrize("law", SPHERE_LAWS.values(), ids=SPHERE_LAWS)
def test_matrix_of_spheres(law):
    """1e-2: the dashpots of spheres look back over steps, which differences of one step do not."""
    assert mismatch(fdem.Simulation(balls(law), fdem.Newmark(dt=1e-3)), e=1e-8) < 1e-2
