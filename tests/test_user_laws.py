"""Joint laws of the user's own: a frozen dataclass and a kernel, with history, closure and needs of their own."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from contact_tools import table
from contracts import example_law
from scenes import assert_same_bits, everything, quietly, simulation
from test_joints import drive, halves

import fdem
from fdem.contact.laws import try_law

KN, KS = 1e10, 5e9
SIGNATURE = "lo hi dt gap push slip normal align area mass arm prop props memory_old memory traction work state".split()


@fdem.kernel
def worn_spring(
    lo, hi, dt, gap, push, slip, normal, align, area, mass, arm, prop, props, old, memory, traction, work, state
):  # fmt: skip
    """Frictionless spring that a second column counts the loadings of, and that knows the length of its arm."""
    for i in range(lo, hi):
        state[i] = 3
        if area[i] == 0.0:
            continue
        memory[i], work[i], traction[i] = old[i], 0.0, 0.0
        if gap[i] < 0.0:
            state[i] = 1
            traction[i, 0] = -props[prop[i // 3], 0] * gap[i]
        memory[i, 6] = max(old[i, 6], -gap[i])
        memory[i, 7] = np.sqrt((arm[i] ** 2).sum())


@dataclass(frozen=True, kw_only=True)
class WornSpring(fdem.Joint):
    kernel = worn_spring
    memory = ("deepest", "arm_length")
    needs = frozenset({"arms"})

    def properties(self, kn, ks):
        return kn, ks


@fdem.kernel
def cubic(lo, hi, dt, gap, push, slip, normal, align, area, mass, arm, prop, props, old, memory, traction, work, state):
    """Frictionless, p = kn d + kn d^3 / reach^2."""
    for i in range(lo, hi):
        state[i] = 3
        if area[i] == 0.0:
            continue
        memory[i], work[i], traction[i] = old[i], 0.0, 0.0
        d, kn, reach = max(-gap[i], 0.0), props[prop[i // 3], 0], props[prop[i // 3], 2]
        if d > 0.0:
            state[i] = 1
            traction[i, 0] = kn * d * (1.0 + (d / reach) ** 2)


@fdem.kernel
def cubic_closure(lo, hi, gap, prop, props, memory, out):
    for i in range(lo, hi):
        d, kn, reach = max(-gap[i], 0.0), props[prop[i // 3], 0], props[prop[i // 3], 2]
        ratio = (d / reach) ** 2
        out[i, 0], out[i, 1] = kn * d * (1.0 + ratio), kn * (1.0 + 3.0 * ratio)
        out[i, 2], out[i, 3] = kn * d * d * (0.5 + 0.25 * ratio), 0.0


@dataclass(frozen=True, kw_only=True)
class Cubic(fdem.Joint):
    """A joint that stiffens with the cube of its closure."""

    over: float
    kernel = cubic
    closure = cubic_closure

    @property
    def reach(self):
        return self.over

    def properties(self, kn, ks):
        return kn, ks, self.over


def standing(law, **options):
    scene = fdem.Scene(gravity=(0, 0, -10), **options)
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), name="base", fixed=True)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), fdem.Elastic(density=2500), name="block")
    scene.joint(law)
    return scene, block


def test_columns_of_history_are_arrays_of_the_contacts():
    sim = simulation(standing(WornSpring(kn=1e8, ks=5e7))[0])
    sim.cycle(400)
    t, cloud = sim.contact_table(), sim.contacts()
    np.testing.assert_allclose(t["deepest"].max(), 2 * 25000 / 1e8, rtol=1e-2)  # twice the weight: it falls from rest
    np.testing.assert_allclose(t["arm_length"][t["area"] > 0.1], np.sqrt(1 / 6), rtol=1e-9)
    assert (cloud.point_data["deepest"] == t["deepest"]).all()


def test_a_table_with_other_laws_has_columns_where_they_act():
    scene, _ = standing(WornSpring(kn=1e8, ks=5e7))
    scene.add(fdem.brick((0, 0, 1), (1, 1, 2)), fdem.Rigid(), fdem.Elastic(density=2500), name="top")
    scene.joint(fdem.Coulomb(kn=1e8, ks=5e7, friction=30), between=("block", "top"))
    sim = simulation(scene)
    sim.cycle(5)
    t = sim.contact_table()
    below = t["joint"] == 0
    assert below.any() and not below.all()
    assert (t["deepest"][below & (t["area"] > 0.1)] > 0.0).all()
    assert not t["deepest"][~below].any()


@pytest.mark.parametrize("law", [WornSpring(kn=1e8, ks=5e7), Cubic(kn=1e8, ks=5e7, over=1e-4), example_law()])
def test_restart_goes_on_bit_for_bit(tmp_path, law):
    sim = simulation(standing(law)[0])
    sim.cycle(150)
    sim.save(tmp_path / "half.npz")
    again = quietly(fdem.load, tmp_path / "half.npz", standing(law)[0], fdem.Explicit(), progress=False)
    assert_same_bits(everything(again), everything(sim))
    sim.cycle(150)
    again.cycle(150)
    assert_same_bits(everything(again), everything(sim))


def test_a_closure_of_its_own_sets_step_energy_and_preload():
    """The cubic law: exact settlement by Relaxation, exact energy, a step below 2/omega of its tangent, preload."""
    law = Cubic(kn=1e8, ks=5e7, over=1e-4)
    load = 1e6
    d = np.roots([1.0, 0.0, 1e-8, -1e-8 * (load + 25000) / 1e8])
    d = float(d[np.abs(d.imag) < 1e-12].real[0])
    scene, block = standing(law)
    scene.apply(fdem.Force((0, 0, -load)), block)
    sim = simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-9).converged
    np.testing.assert_allclose(-sim[block].displacement[2], d, rtol=1e-7)
    after = simulation(scene, start=sim)
    tangent = 1e8 * (1 + 3 * (d / 1e-4) ** 2)
    assert 0.3 < after.dt / (2 * np.sqrt(2500 / tangent)) < 0.81
    np.testing.assert_allclose(after.energy.joint, 1e8 * d**2 * (0.5 + 0.25 * (d / 1e-4) ** 2), rtol=1e-6)
    w = halves(table(law))
    stress = np.tile([0, 0, -load, 0, 0, 0], (3 * w.contacts.n_patches, 1))
    w.contacts.preload(w.x, stress)
    w.forces()
    np.testing.assert_allclose(w.resultant(0)[0], [0, 0, load], rtol=1e-9, atol=1e-3)


def test_damping_and_bonds_are_given_to_laws_that_ask():
    seen = {}
    for needs in ((), ("damping",), ("bonds",)):
        law = table(type("Asks", (WornSpring,), {"needs": frozenset({"arms", *needs})})(kn=KN, ks=KS))
        w = halves(law)
        drive(w, [[0, 0, -1e-5]])
        seen[needs] = w.contacts._mass.max() > 0.0, bool(law.tensile.any())
    assert seen == {(): (False, False), ("damping",): (True, False), ("bonds",): (False, True)}


# ---------------------------------------------------------------------------------------------------------------------
# laws that cannot work


def law_with(body="", arguments=SIGNATURE, compiled=True, **members):
    """A law whose kernel has `body` as the loop over closed rows, after all outputs were written."""
    lines = [f"def sweep({', '.join(arguments)}):", "    for i in range(lo, hi):", "        state[i] = 1"]
    lines += ["        memory[i] = memory_old[i]", "        traction[i] = 0.0", "        work[i] = 0.0"]
    lines += ["        " + line for line in body.splitlines()]
    space = {"np": np, "math": math}
    exec("\n".join(lines), space)
    import numba

    sweep = numba.njit(space["sweep"]) if compiled else space["sweep"]
    given = {"kernel": sweep, "properties": lambda self, kn, ks: (kn, ks, 0.5)} | members
    return type("Mine", (fdem.Joint,), given)(kn=1e9, ks=5e8)


BAD = {
    "no kernel": (law_with(kernel=None), fdem.JointError, "kernel = None"),
    "a plain function": (law_with(compiled=False), fdem.JointError, "fdem.kernel"),
    "an argument too few": (law_with(arguments=SIGNATURE[:-1]), fdem.JointError, "17 arguments"),
    "a column it did not name": (law_with("memory[i, 6] = 1.0"), fdem.JointError, "memory"),
    "a property it does not have": (law_with("traction[i, 0] = props[0, 3]"), fdem.JointError, "properties"),
    "arms it did not ask for": (law_with("traction[i, 0] = arm[i, 0]"), fdem.JointError, "needs"),
    "old history changed": (law_with("memory_old[i, 0] = 1.0"), fdem.JointError, "not its own"),
    "nothing written": (law_with("traction[i, 2] = np.nan"), fdem.JointError, "traction"),
    "no state": (law_with("state[i] = 99"), fdem.JointError, "state"),
    "no properties": (
        type("Bare", (fdem.Joint,), {"kernel": worn_spring})(kn=1e9, ks=5e8), fdem.UnsupportedError, "properties",
    ),
    "stiffness not first": (law_with(properties=lambda self, kn, ks: (ks, kn)), fdem.JointError, "kn, ks"),
    "a word as property": (law_with(properties=lambda self, kn, ks: (kn, ks, "x")), fdem.JointError, "numbers"),
    "nan as property": (law_with(properties=lambda self, kn, ks: (kn, ks, np.nan)), fdem.JointError, "not a number"),
    "memory a number": (law_with(memory=2), fdem.JointError, "memory = 2"),
    "memory a word": (law_with(memory="damage"), fdem.JointError, "memory = 'damage'"),
    "a column named as another array": (law_with(memory=("gap",)), fdem.JointError, "gap"),
    "the same column twice": (law_with(memory=("a", "a")), fdem.JointError, "memory"),
    "an unknown need": (law_with(needs={"temperature"}), fdem.JointError, "temperature"),
    "a need as a word": (law_with(needs="damping"), fdem.JointError, "needs = 'damping'"),
    "a reach of nothing": (law_with(reach=0.0), fdem.SceneError, "reach"),
    "a closure that is no kernel": (law_with(closure=len), fdem.JointError, "closure"),
    "a closure with other arguments": (law_with(closure=worn_spring), fdem.JointError, "closure takes 18"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_laws_that_cannot_work_are_refused_before_the_first_step(name):
    law, error, text = BAD[name]
    with pytest.raises(error, match=text) as caught:
        simulation(standing(law)[0])
    assert type(law).__name__ in str(caught.value)


def test_a_law_that_takes_only_sensible_numbers_is_not_refused():
    """The trial run uses made-up numbers: what cannot be computed with them is not held against the law."""
    law = table(law_with("traction[i, 0] = math.sqrt(props[0, 2] + 10.0 * gap[i])"))
    gap = -np.ones(3)
    with pytest.raises(ValueError, match="math domain"):
        law.sweep.py_func(0, 3, 0.0, gap, *8 * [None], law.props, *2 * [np.zeros((3, 6))], *3 * [np.zeros((3, 4))])
    try_law("Mine", law)
