"""Tolerance in, settings out: on laws of error that are known, on failures, and on scenes with closed forms."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

import fdem
from fdem.tuning.estimate import limit

G = 9.81
NEWMARK = fdem.Newmark(dt=0.4)

# ---------------------------------------------------------------------------------------------------------- limits


@pytest.mark.parametrize("order", [0.5, 1.0, 1.5, 2.0])
def test_limit_of_a_law_of_one_order(order):
    values = [3.0 + 0.5 * 1.5 ** (-order * k) for k in range(4)]
    found = limit(values, 1.5, 1.0)
    assert found.order == pytest.approx(order, rel=1e-9)
    assert values[-1] + found.rest == pytest.approx(3.0, abs=1e-12)
    assert found.uncertainty <= abs(found.rest)


@pytest.mark.parametrize("values", [
    [1.0, 1.1], [1.2, 1.1, 1.02], [1.0, 1.05, 0.98, 1.02], [1.3, 1.2, 1.09], [1.1, 1.1, 1.02], [1.4, 1.1, 1.1],
])  # fmt: skip
def test_uncertainty_covers_limits_that_cannot_be_told(values):
    """Two values, swinging ones, ones that do not come closer, a value twice: 1 is within what is left open."""
    found = limit(values, 2.0, 1.0)
    assert abs(values[-1] + found.rest - 1.0) <= found.uncertainty


def test_one_value_tells_nothing():
    assert limit([1.0], 2.0, 1.0).uncertainty == math.inf


# --------------------------------------------------------------------------------------------------- laws of error


def worked(seconds):
    """Spend CPU time, as a simulation would."""
    begin = time.process_time()
    while time.process_time() - begin < seconds:
        pass


def laws(s):
    """Errors of second order in the mesh, first in the step, one half in the stiffness, and a product of two."""
    worked(min(2e-7 / (s.size**3 * s.dt), 0.1))
    return 3.0 * (1 + 0.3 * s.size**2 + 0.2 * s.dt + 0.1 * s.size * s.dt + 0.4 * math.sqrt(1e8 / s.kn))


def tuned(function, tolerance, quantity=float, **given):
    given = {"body": fdem.Zoned(), "integrator": NEWMARK, "size": 1.0, "kn": 1e8, "time": 1.0, "budget": 20.0} | given
    return fdem.tune(function, quantity, tolerance, **given)


@pytest.mark.parametrize("tolerance", [0.03, 0.005])
def test_known_laws(tolerance):
    found = tuned(laws, tolerance)
    assert abs(found.value / 3 - 1) <= found.uncertainty <= 0.5 * tolerance
    assert abs(found.quantity / 3 - 1) <= found.error <= tolerance
    # not far finer than asked for
    assert abs(found.quantity / 3 - 1) > 0.5 * tolerance
    assert found.settings.body.size == found.settings.size and found.settings.integrator.dt == found.settings.dt
    assert found.total_cost >= sum(run.cost for run in found.runs[:5])
    assert len(found.table().splitlines()) == len(found.runs) + 1


def test_what_does_not_matter_stays_coarse():
    found = tuned(lambda s: 2.0 + 0.1 * s.size + 0.0 * s.dt + 0.0 * s.kn, 0.01)
    assert found.settings.dt >= NEWMARK.dt
    assert found.settings.kn <= 1e8
    assert found.quantity == pytest.approx(2.0, rel=0.01)  # what was asked for, here and below


def test_what_is_not_read_is_not_refined():
    found = tuned(lambda s: 1.0 + s.integrator.dt**2, 0.01, body=fdem.Rigid(), size=None)
    assert {run.settings.kn for run in found.runs} == {None}
    assert found.quantity == pytest.approx(1.0, rel=0.01)


def test_values_that_swing():
    """Meshes without structure: the error is of its order on the average only."""

    def law(s):
        return 5.0 * (1 + 0.4 * s.size**2 * (1 + 0.8 * math.sin(40 / s.size)))

    found = tuned(law, 0.02, kn=None)
    assert found.value == pytest.approx(5.0, rel=0.02)
    assert found.quantity == pytest.approx(5.0, rel=0.02)


def test_failures_are_data():
    """Too soft a contact overlaps, too stiff a one does not converge, coarse meshes give no number."""

    def law(s):
        if s.kn < 1e9:
            raise fdem.OverlapError("too soft")
        if s.kn > 1e14:
            raise fdem.ConvergenceError("too stiff")
        return math.nan if s.size > 0.9 else 1.0 + 0.3 * s.size**2 + 0.1 * math.sqrt(1e9 / s.kn)

    found = tuned(law, 0.01)
    assert found.quantity == pytest.approx(1.0, rel=0.01)
    assert {run.failure.split(":")[0] for run in found.runs if run.failure} >= {"OverlapError"}


@pytest.mark.parametrize(("offset", "expected"), [(0.002, "rigid"), (0.05, "zoned")])
def test_the_first_body_is_the_model(offset, expected):
    """Another body is taken if it gives the same, and left if it does not."""

    def law(s):
        worked(1e-4 if s.body.kind == "rigid" else 2e-3)
        return {"rigid": 1.0 + offset, "zoned": 1.0 + 0.1 * (s.size or 0) ** 2}[s.body.kind]

    found = tuned(law, 0.01, body=[fdem.Zoned(), fdem.Rigid()], kn=None)
    assert found.settings.body.kind == expected


def test_integrators_that_disagree_are_refused():
    def law(s):
        return 1.0 if isinstance(s.integrator, fdem.Newmark) else 1.1

    with pytest.raises(fdem.ToleranceError, match="different limits"):
        tuned(law, 0.01, integrator=[NEWMARK, fdem.ContactDynamics(0.4)], kn=None)


def test_what_cannot_be_reached_is_refused():
    def slow(s):
        worked(2e-3 / s.size**3)
        return 1.0 + 0.5 * s.size**0.5

    with pytest.raises(fdem.ToleranceError, match=r"0.001 was not reached.*best estimate") as caught:
        tuned(slow, 0.001, kn=None, budget=0.5)
    best = caught.value.best
    assert best.runs and best.error > 0.001 and abs(best.value - 1.0) < 0.5
    with pytest.raises(fdem.ToleranceError, match="no run of Zoned gave a value: UnstableError: always"):
        tuned(always_fails, 0.01)


def always_fails(s):
    raise fdem.UnstableError("always")


def test_mistakes_of_the_user_are_not_swallowed():
    with pytest.raises(TypeError):
        tuned(lambda s: 1.0 + None, 0.01)


@pytest.mark.parametrize(("given", "name"), [
    ({"tolerance": 0.0}, "tolerance"), ({"tolerance": 2}, "tolerance"), ({"size": -1.0}, "size"), ({"dt": 0.0}, "dt"),
    ({"kn": math.inf}, "kn"), ({"quantity": 3}, "callable"),
])  # fmt: skip
def test_bad_input_is_refused(given, name):
    with pytest.raises(fdem.SceneError, match=name):
        tuned(laws, **({"tolerance": 0.01} | given))


# ----------------------------------------------------------------------------------------------------------- scenes


def slide(s):
    """A block on a slope of 30 degrees, friction 20; stiffness stands for a hard contact."""
    a = np.radians(30.0)
    scene = fdem.Scene(gravity=G * np.array([np.sin(a), 0.0, -np.cos(a)]))
    scene.add(fdem.brick((-4, -1, -1), (13, 2, 0)), fdem.Rigid(), fixed=True)
    scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), s.body, fdem.Elastic(2000.0, 1e10, 0.2), name="block")
    scene.joint(fdem.Coulomb(kn=s.kn, ks=s.kn, friction=20))
    return scene


def test_a_scene_that_is_run():
    """The factory gives a scene, tune runs it; explicit steps and contact dynamics agree."""
    exact = 0.5 * G * (np.sin(np.radians(30)) - np.cos(np.radians(30)) * np.tan(np.radians(20))) * 0.04
    found = fdem.tune(
        slide, lambda sim: sim["block"].displacement[0], 0.01, body=fdem.Rigid(), kn=1e9, time=0.2,
        integrator=[fdem.Explicit(), fdem.ContactDynamics(dt=2e-2)],
    )  # fmt: skip
    assert isinstance(found.sim, fdem.Simulation) and found.sim.time == pytest.approx(0.2)
    assert found.value == pytest.approx(exact, rel=0.01)
    assert found.sim["block"].displacement[0] == pytest.approx(exact, rel=0.01)


def pressed(s):
    """A cube on a joint whose stiffness is a datum, pressed on top; solved for equilibrium."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), s.body, fdem.Elastic(2000.0, 1e9, 0.0), name="block")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=0))
    scene.fix(block, ("x", "y"))
    scene.apply(fdem.Traction((0, 0, -1e5)), block, where=lambda x: x[:, 2] > 1 - 1e-9)
    return scene


def test_a_scene_that_is_solved():
    """Closure p/kn and half the shortening p H/E; bodies and integrators are left to the code."""
    found = fdem.tune(pressed, lambda sim: sim["block"].displacement[2], 0.01)
    assert found.value == pytest.approx(-1.5e-4, rel=0.01)
    assert found.quantity == pytest.approx(-1.5e-4, rel=0.01)
    assert found.settings.body.kind != "rigid"  # which does not shorten


def test_a_joint_of_given_stiffness_is_not_hard():
    """A block swings on a joint whose stiffness is a datum, x = v/w sin(w t): no hard contact is tried."""

    def swing(s):
        scene = fdem.Scene(gravity=(0, 0, 0))
        scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
        stone = fdem.Elastic(density=2000)
        scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), s.body, stone, name="block", velocity=(0, 0, 0.1))
        scene.joint(fdem.Bonded(kn=2e7, ks=2e7))
        return scene

    found = fdem.tune(swing, lambda sim: sim["block"].displacement[2], 0.01, body=fdem.Rigid(), time=0.02)
    assert found.quantity == pytest.approx(1e-3 * np.sin(2.0), rel=0.01)
    assert not any(isinstance(run.settings.integrator, fdem.ContactDynamics) for run in found.runs)


@pytest.mark.long
def test_collision_to_a_thousandth():
    """Two spheres (Hertz): the largest force; 0.1 %, by explicit and implicit rules."""
    radius, speed, young = 0.01, 10.0, 0.5 * 4.8e10 / (1 - 0.2**2)
    mass = 0.5 * 2800 * 4 / 3 * np.pi * radius**3
    deep = (15 * mass * (2 * speed) ** 2 / (16 * young * np.sqrt(0.5 * radius))) ** 0.4

    def collide(s):
        scene, glass = fdem.Scene(gravity=(0, 0, 0)), fdem.Elastic(2800.0, 4.8e10, 0.2)
        scene.add(fdem.sphere(radius), s.body, glass, velocity=(0, 0, speed))
        ball = scene.add(fdem.sphere(radius, (0, 0, 2.002 * radius)), s.body, glass, velocity=(0, 0, -speed))
        scene.joint(fdem.Hertz(friction=0))
        sim = fdem.Simulation(scene, s.integrator, progress=False)
        force = sim.history(ball, "contact_force", component="z")
        sim.run(time=3.2e-5)
        return force

    found = fdem.tune(
        collide, lambda force: max(force.values), 0.001, body=fdem.Rigid(), dt=4e-6,
        integrator=[fdem.Explicit(), fdem.Newmark(dt=4e-6), fdem.GeneralizedAlpha(dt=4e-6)],
    )  # fmt: skip
    exact = 4 / 3 * young * np.sqrt(0.5 * radius) * deep**1.5
    assert found.value == pytest.approx(exact, rel=1e-3)
    assert found.quantity == pytest.approx(exact, rel=1e-3)
