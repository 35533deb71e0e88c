"""Every pair of bodies in contact, and structures of all of them: resultants, centres of pressure, thrust."""

from __future__ import annotations

import numpy as np
import pytest
from verify.meshes import plane

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia
G = 9.81
KINDS = {
    "rigid": fdem.Rigid(),
    "uniform": fdem.UniformStrain(),
    "linear": fdem.LinearStrain(),
    "zoned": fdem.Zoned(mass="inertia-matched"),
}
ROCK = fdem.Elastic(density=2500, young=1e10, poisson=0.2)


@pytest.mark.parametrize("upper", KINDS)
@pytest.mark.parametrize("lower", KINDS)
def test_resultant_and_centre_of_pressure(lower, upper):
    """A smaller block off the middle of a larger one, 1 MPa on part of it: statics, whatever meets there.

    The oracle's `contact_patch_nonmatching` for all pairs: centre of pressure to 1e-8 of the width, resultant to 1e-9
    of the load. Its 1e-10 is below round-off here: 8 eps L / closure, 5e-9 on the base (measured: at most 3e-10).
    """
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((-1, -1, -1), (4, 4, 0)), fdem.Rigid(), fixed=True, name="base")
    scene.add(fdem.brick((0, 0, 0), (3, 3, 1)), KINDS[lower], ROCK, name="lower")
    scene.add(fdem.brick((1.1, 0.9, 1), (2.1, 1.9, 2)), KINDS[upper], ROCK, name="upper")
    scene.joint(fdem.Coulomb(kn=1e11, ks=1e11, friction=30))
    # linear over the face, so that its centre is off the middle
    scene.apply(
        fdem.Traction(lambda x: np.column_stack([0 * x[:, :2], -1e6 * (1 + 0.8 * (x[:, 0] - 1.6))])),
        "upper",
        where=plane(2, 2.0),
    )
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-10).converged
    sim.cycle(1000)  # on to round-off
    load, x = sim.system.f_load, sim.state.x + sim.model.origin
    wanted = np.cross(x, load).sum(axis=0)
    # the dead load has moved with the block, by its closure
    assert np.array([wanted[1], -wanted[0]]) / 1e6 == pytest.approx([1.6 + 0.8 / 12, 1.4], abs=1e-3)
    for below, above in (("lower", "upper"), ("base", "lower")):
        force = sim.pair_force(below, above)
        assert force == pytest.approx([0, 0, 1e6], abs=1e-9 * 1e6)
        table = sim.contact_table()
        number = sim.model.names.index(above)
        mine = table["block_b"] == number
        f, x = table["force"][mine], table["position"][mine]
        # moments about the axes in the plane are the arms of the resultant
        assert np.cross(x, f).sum(axis=0) / 1e6 == pytest.approx(-wanted / 1e6, abs=1e-8 * 3)


R, N, DENSITY = 10.0, 20, 2000.0
ETA = 0.10734770132006818  # least thickness over radius of 20 voussoirs with plane faces


def arch(bodies, factor):
    """The semicircular arch of `masonry_arch_min_thickness` between fixed blocks, voussoirs of `bodies` in turn."""
    thickness = factor * ETA * R
    scene, stone = fdem.Scene(), fdem.Elastic(DENSITY, 1e10, 0.2)
    shapes = fdem.arch(span=2 * R, rise=R, thickness=thickness, depth=1.0, n=N)
    voussoirs = [
        scene.add(shape, KINDS[bodies[i % len(bodies)]], stone, name=f"voussoir {i}") for i, shape in enumerate(shapes)
    ]
    for side in (-1, 1):
        ends = sorted((side * (R - 2 * thickness), side * (R + 2 * thickness)))
        scene.add(fdem.brick((ends[0], -1, -1), (ends[1], 2, 0)), fdem.Rigid(), fixed=True)
    weight = DENSITY * G * thickness * np.pi * R
    kn = 0.5 * weight / thickness / (1e-5 * R)  # a closure of 1e-5 R at the springing
    scene.joint(fdem.Coulomb(kn=kn, ks=kn, friction=np.degrees(np.arctan(0.7))))
    return fdem.Simulation(scene, fdem.Relaxation(), progress=False), voussoirs


MIXED = ("rigid", "uniform", "linear", "zoned")


@pytest.mark.parametrize(
    "bodies",
    [("rigid",), ("uniform",), *(pytest.param(b, marks=pytest.mark.long) for b in (("linear",), ("zoned",), MIXED))],
    ids="-".join,
)
def test_masonry_arch_min_thickness(bodies):
    """Stands at 1.2 of the least thickness, falls at 0.97: the oracle's corrected bracket for penalty joints."""
    sim, voussoirs = arch(bodies, 1.2)
    report = sim.solve(ratio=1e-5, max_cycles=60_000)
    assert report.reason == "equilibrium"
    crown = sim.pair_force(voussoirs[N // 2 - 1], voussoirs[N // 2])
    assert crown[0] > 0.0
    weight = sum(sim[v].mass for v in voussoirs) * G
    assert sim.contact_forces()[-2:, 2].sum() == pytest.approx(-weight, rel=1e-3)
    sim, _ = arch(bodies, 0.97)
    try:
        assert sim.solve(ratio=1e-5, max_cycles=20_000).reason == "collapse"
    except fdem.OverlapError:
        # what falls has come to lie on the abutments
        assert sim.displacements()[:, 2].min() < -0.1 * R


def test_a_stack_of_all_bodies():
    """Four formulations on each other, with their own weights: every joint carries what is above."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    cubes = [
        scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), KINDS[MIXED[k % 4]], ROCK, name=f"cube {k}") for k in range(8)
    ]
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    assert sim.solve(ratio=1e-6).converged
    weights = 2500 * G * np.arange(8, 0, -1)
    for below, cube, weight in zip(["base", *cubes[:-1]], cubes, weights, strict=True):
        assert sim.pair_force(below, cube)[2] == pytest.approx(weight, rel=1e-4)
    # swapping the formulation changes one argument, and no joint force
    moved = [sim[cube].displacement[2] for cube in cubes]
    closures = np.cumsum(weights) / 1e9
    assert np.all(-np.array(moved) > closures * (1 - 1e-3))  # never stiffer than its joints
    assert np.all(-np.array(moved) < closures * 1.2)
