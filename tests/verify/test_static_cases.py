"""Blocks on joints by Static: stacks, chains, shear box, crack, wedge, toppling, groove, units, mixed bodies, spheres.

Values and tolerances are those of the verification oracle; scenes are shared with the tests of other integrators.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from stress import far, rest
from verify import test_contact_acceptance as acceptance
from verify import test_contact_cases as shear
from verify import test_joint_cases as cases

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia

G = 9.81
STONE = fdem.Elastic(density=2000.0, young=1e10, poisson=0.0)
BODIES = {
    "rigid": fdem.Rigid(),
    "uniform": fdem.UniformStrain(),
    "linear": fdem.LinearStrain(),
    "zoned": fdem.Zoned(size=0.7),
}


def at_rest(scene, tolerance=1e-10, **options):
    sim = fdem.Simulation(scene, fdem.Static(tolerance=tolerance, **options))
    report = sim.solve(ratio=tolerance)
    assert report.converged, report.notes
    return sim


def stack(bodies, n=10, origin=(0.0, 0.0, 0.0), size=1.0, young=1e10, kn=1e9, density=2000.0, g=G):
    scene, origin = fdem.Scene(gravity=(0, 0, -g)), np.asarray(origin)
    base = size * np.array([[-1, -1, -1], [2, 2, 0]])
    scene.add(fdem.brick(origin + base[0], origin + base[1]), fdem.Rigid(), fixed=True, name="base")
    stone = fdem.Elastic(density=density, young=young, poisson=0.0)
    for k in range(n):
        low = origin + size * np.array([0, 0, k])
        scene.add(fdem.brick(low, low + size), bodies[k % len(bodies)], stone, name=f"cube {k}")
    scene.joint(fdem.Coulomb(kn=kn, ks=kn, friction=30))
    return scene


def carried(sim, n=10):
    """Vertical forces (n,) of the interfaces from below."""
    names = ["base", *(f"cube {k}" for k in range(n))]
    return np.array([sim.pair_force(a, b)[2] for a, b in pairwise(names)])


@pytest.mark.parametrize("kind", [*BODIES, "mixed"])
def test_stack_forces(kind):
    """N_k = (n - k + 1) m g to 1e-8, settlement of rigid cubes sum N / (kn A) (oracle: rigid_stack_forces)."""
    sim = at_rest(stack(list(BODIES.values()) if kind == "mixed" else [BODIES[kind]]))
    exact = 2000 * G * np.arange(10, 0, -1)
    assert carried(sim) == pytest.approx(exact, rel=1e-8)
    settled = -np.array([sim[f"cube {k}"].displacement[2] for k in range(10)])
    closed = np.cumsum(exact) / 1e9
    if kind == "rigid":
        assert settled == pytest.approx(closed, rel=1e-8)
    elif kind != "mixed":  # its own shortening: half that of the block, and that of all below; the centre of gravity
        below = np.concatenate([[0.0], np.cumsum(exact - 1000 * G)[:-1]]) / 1e10
        own = {"uniform": exact - 1000 * G, "linear": exact - 2000 * G / 3}.get(kind, exact - 2000 * G / 3) / 2e10
        # zones of a stack: the mean of the displacement is that of the column but for the mesh
        assert settled == pytest.approx(closed + below + own, rel=1e-3 if kind == "zoned" else 2e-5)


def test_chain_between_platens():
    """Ten blocks squeezed between platens, joints of different stiffness: u to 1e-10 (integ_relaxation_equilibrium)."""
    k = np.array([1e8, 2e8, 5e8, 1e8, 1e9, 2e8, 3e8, 1e8, 4e8, 1e8, 2e8])
    exact = [
        -0.0036218663185378576, -0.0053837494778067865, -0.006068882741514358, -0.009396449060052214,
        -0.009719395691906,
        -0.01128507885117493, -0.012296167624020882, -0.015231333942558739, -0.015940600522193205, -0.01867956684073107,
    ]  # fmt: skip
    scene = fdem.Scene(gravity=(0, 0, -G))
    blocks = [scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="low")]
    for i in range(10):
        blocks.append(scene.add(fdem.brick((0, 0, i), (1, 1, i + 1)), fdem.Rigid(), fdem.Elastic(1000.0)))
    blocks.append(scene.add(fdem.brick((-1, -1, 10), (2, 2, 11)), fdem.Rigid(), fdem.Elastic(1.0), name="high"))
    scene.fix(blocks[-1], component=("x", "y", "rotation"))
    for i in range(11):
        scene.joint(fdem.Coulomb(kn=k[i], ks=k[i], friction=0), between=(blocks[i], blocks[i + 1]))
    scene.apply(fdem.Displacement((None, None, -0.02)), blocks[-1])
    sim = at_rest(scene, 1e-13)
    moved = np.array([sim[b].displacement[2] for b in blocks[1:-1]])
    assert moved == pytest.approx(exact, rel=1e-10)


def test_uniform_strain_on_a_joint():
    """Closure m g / k, strain -m g / (2 E A), platens: 2 F / k + F h / (E A), to 1e-8 (dda_block_on_springs)."""
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.UniformStrain(), fdem.Elastic(2500.0, 1e9, 0.0))
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    sim = at_rest(scene, 1e-12)
    assert -sim.contact_table()["gap"].min() == pytest.approx(2.4525e-05, rel=1e-8)
    # the strain is that of U - 1, the force that of the first Piola-Kirchhoff stress: linear but for rotations
    assert sim[block].strain[2] == pytest.approx(-1.22625e-05, rel=1e-8)
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.UniformStrain(), fdem.Elastic(2500.0, 1e9, 0.0))
    platen = scene.add(fdem.brick((-1, -1, 1), (2, 2, 2)), fdem.Rigid(), fdem.Elastic(1.0), name="platen")
    scene.fix(platen, component=("x", "y", "rotation"))
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    scene.apply(fdem.Force((0, 0, -1e6)), platen)
    assert -at_rest(scene, 1e-12)[platen].displacement[2] == pytest.approx(0.003, rel=1e-8)


@pytest.mark.parametrize("body", shear.KINDS)
def test_direct_shear(body):
    """tau = min(ks u, c + sn tan phi), its loop and its work, to 1e-6 (oracle: joint_direct_shear)."""
    scene, _, drive = shear.shear_box(body)
    sim = at_rest(scene, 1e-10)
    before = sim.energy.friction

    def pushed(distance, steps):
        sim[drive].factor = distance / steps
        sim.cycle(steps)
        return sim.pair_force("upper", "base")[0]

    assert pushed(1e-4, 2) == pytest.approx(5e9 * 1e-4, rel=1e-6)
    assert pushed(shear.U_MAX - 1e-4, 4) == pytest.approx(shear.TAU, rel=1e-6)
    slipped = shear.U_MAX - shear.TAU / 5e9
    assert pushed(-1e-4, 2) == pytest.approx(shear.TAU - 5e5, rel=1e-6)
    assert pushed(1e-4 - 2 * shear.U_MAX, 6) == pytest.approx(-shear.TAU, rel=1e-6)
    assert pushed(2 * shear.U_MAX, 6) == pytest.approx(shear.TAU, rel=1e-6)
    slipped += 2 * (2 * shear.U_MAX - 2 * shear.TAU / 5e9)
    # zones also slip unevenly on the way
    assert sim.energy.friction - before == pytest.approx(shear.TAU * slipped, rel=1e-2 if body == "zoned" else 1e-6)


def test_slipping_crack():
    """Slopes OA, AB, BO of the loop to 1e-3, three of the four rigid blocks fixed (oracle: slipping_crack_block)."""
    scene, ends = fdem.Scene(gravity=(0, 0, 0)), [0.0, 0.5 - cases.HALF, 0.5 + cases.HALF, 1.0]
    for k, name in enumerate(("left", "crack", "right")):
        a, b = ends[k], ends[k + 1]
        scene.add(fdem.prism([(a, 0), (b, 0), (b, 0.5 + b), (a, 0.5 + a)], 1.0), fdem.Rigid(), fixed=True, name=name)
    upper = fdem.prism([(0, 0.5), (1, 1.5), (1, cases.TOP), (0, cases.TOP)], 1.0)
    upper = scene.add(upper, fdem.Rigid(), fdem.Elastic(2500.0), name="upper")
    scene.joint(fdem.Coulomb(kn=cases.STIFF, ks=cases.STIFF, friction=60, cohesion=1e12, tension=1e12))
    scene.joint(fdem.Coulomb(kn=cases.STIFF, ks=cases.STIFF, friction=16), between=("crack", "upper"))
    scene.fix(upper, component=("y", "rotation"))
    load = scene.apply(fdem.Force((0, 0, -1)), upper, factor=0.0)
    sim = fdem.Simulation(scene, fdem.Static(tolerance=1e-9))
    exact = cases.slopes(rigid=True)
    peak = 1e-4 * exact[0]
    path = cases.cycle_of(sim, load, lambda s: -s[upper].displacement[2], peak, fine=1)
    assert cases.measured(path, peak) == pytest.approx(exact, rel=1e-3)


def test_wedge_factor():
    """Stands 0.1 degree above the critical friction angle, 33.357, and not 0.1 below (oracle: rigid_wedge_factor).

    To tell so little from the elastic joints, which let a wedge in rotate, its rotation is held.
    """
    for offset, stands in ((0.1, True), (-0.1, False)):
        scene = far.wedge(far.CRITICAL + offset)
        scene.fix("wedge", component="rotation")
        report = fdem.Simulation(scene, fdem.Static()).solve()
        assert report.converged == stands
        assert stands or "'wedge'" in report.notes


@pytest.mark.parametrize("settlement", [1e-4, 1e-9])
def test_toppling_threshold(settlement):
    """0.1 degree either side of the value on an elastic base; as good as hard, 0.1 degree of atan(b/h)."""
    critical = cases.winkler_tilt(settlement)
    if settlement < 1e-8:
        assert critical == pytest.approx(np.degrees(np.arctan(cases.B / cases.H)), abs=0.1)
    for offset, stands in ((-0.1, True), (0.1, False)):
        scene = cases.tilted(critical + offset, 45.0, settlement)
        assert fdem.Simulation(scene, fdem.Static()).solve().converged == stands


def test_slide_threshold():
    """At 20 degrees: slides at phi = 15, stands at 25."""
    for phi, stands in ((15.0, False), (25.0, True)):
        assert fdem.Simulation(cases.tilted(20.0, phi, 1e-6), fdem.Static()).solve().converged == stands


def test_s01_mass_ratio_of_a_million():
    """Forces to 1e-8 (quasi-static)."""
    rest.check_million_on_one(at_rest(rest.million_on_one(), 1e-10), 1e-8)


@pytest.mark.parametrize("body", ["uniform", "zoned"])
def test_s03_stiffness_ratio(body):
    """E = 1e4 Pa between blocks of 1e12 Pa, squeezed by 1e-4: force within 1e-6 of the series."""
    scene, kn, kinds = fdem.Scene(gravity=(0, 0, 0)), 1e12, {"uniform": fdem.UniformStrain(), "zoned": fdem.Zoned(0.7)}
    blocks = []
    for k, young in enumerate((1e12, 1e4, 1e12)):
        material = fdem.Elastic(2500.0, young, 0.0)
        blocks.append(scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), kinds[body], material, name=f"block {k}"))
    scene.joint(fdem.Coulomb(kn=kn, ks=kn, friction=0))
    for k in range(3):
        if body == "uniform":
            scene.fix(blocks[k], component=("x", "y"))
        else:
            scene.fix(blocks[k], "x", where=lambda x: x[:, 0] < 1e-9)
            scene.fix(blocks[k], "y", where=lambda x: x[:, 1] < 1e-9)
    squeeze = 1e-4
    scene.fix(blocks[0], "z", where=lambda x: x[:, 2] < 1e-9)
    push = scene.apply(fdem.Displacement((None, None, -squeeze)), blocks[2], where=lambda x: x[:, 2] > 3 - 1e-9)
    sim = at_rest(scene, 1e-10)
    assert np.abs(sim[push].force[2]) == pytest.approx(1.0, rel=1e-3)  # a stiff block is strained by 1e-12 only
    # the soft block alone knows the force to 1e-6; St. Venant-Kirchhoff: nominal stress E e (1 + 3/2 e + e^2 / 2)
    e = -squeeze / (1 + 1e4 / 1e12 * 2 + 2 * 1e4 / kn)
    exact = 1e4 * e * (1.0 if body == "uniform" else 1 + 1.5 * e + 0.5 * e * e)
    assert sim[blocks[1]].stress[2] == pytest.approx(exact, rel=1e-6)  # nu = 0: the area stays


def test_s20_redundant_contacts():
    """4, 16 and 400 facets: resultant to 1e-8, even shares to 1e-6, iterations at most tenfold."""
    iterations = []
    for n in (2, 4, 20):
        scene, box = rest.on_facets(n)
        sim = at_rest(scene)
        iterations.append(sim.integrator.iterations)
        assert sim[box].contact_force == pytest.approx([0, 0, 1000 * G], abs=1e-8 * 1000 * G)
        table = sim.contact_table()
        share = np.bincount(table["block_a"], np.abs(table["force"][:, 2]), n * n)
        assert share == pytest.approx(1000 * G / n**2, rel=1e-6)
    assert max(iterations) <= 10 * max(min(iterations), 1)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_s21_units(scale):
    """The same stack in mm and km: all dimensionless results to 1e-9, the same iterations."""
    one, other = stack([fdem.Rigid(), fdem.UniformStrain()]), None
    # lengths times s, the rest so that closures and strains are the same
    other = stack([fdem.Rigid(), fdem.UniformStrain()], size=scale, young=1e10 * scale, kn=1e9, g=G)
    first, second = at_rest(one), at_rest(other)
    assert carried(second) / scale**3 == pytest.approx(carried(first), rel=1e-9)
    for k in range(10):
        moved = second[f"cube {k}"].displacement[2] / scale
        assert moved == pytest.approx(first[f"cube {k}"].displacement[2], rel=1e-9)
    assert first.integrator.iterations == second.integrator.iterations


def test_s22_utm():
    """Pair forces within 1e-6 at (500000, 4600000, 300)."""
    first, second = (
        at_rest(stack([fdem.Rigid()], origin=o), 1e-9) for o in ((0, 0, 0), (500_000.0, 4_600_000.0, 300.0))
    )
    assert carried(second) == pytest.approx(carried(first), rel=1e-6)


def test_what_nothing_holds_is_reported():
    """A block on a smooth floor can slide: solved, and said; a block in the air, or only on such a one, is refused."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE, name="skater")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=0))
    report = fdem.Simulation(scene, fdem.Static()).solve()
    assert report.converged and "'skater'" in report.notes and "out of balance" in report.notes
    scene.add(fdem.brick((0, 0, 5), (1, 1, 6)), fdem.Zoned(size=1.0), STONE, name="cloud")
    with pytest.raises(fdem.SceneError, match="'cloud' is free"):
        fdem.Simulation(scene, fdem.Static())


def test_report_of_load_steps():
    """Residual and motion of every accepted load step; equal steps of a linear scene move it equally."""
    sim = fdem.Simulation(stack([fdem.Rigid()], n=3), fdem.Static(steps=4))
    report = sim.solve()
    assert len(report.residuals) == len(report.increments) == 4
    assert max(report.residuals) <= 1e-8
    assert max(report.increments) == pytest.approx(min(report.increments), rel=1e-6)
    assert report.start_ratio > 0.5


def test_excavation():
    """A prop is taken away from under a lintel that two others hold: their forces go up by the prop's share."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (5, 2, 0)), fdem.Rigid(), fixed=True, name="ground")
    for k, name in enumerate(("left", "middle", "right")):
        scene.add(fdem.brick((1.5 * k, 0, 0), (1.5 * k + 1, 1, 2)), fdem.Rigid(), STONE, name=name)
    scene.add(fdem.brick((0, 0, 2), (4, 1, 3)), fdem.Rigid(), STONE, name="lintel")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=40))
    sim = at_rest(scene)
    weight = 8000 * G
    assert sum(sim.pair_force(n, "lintel")[2] for n in ("left", "middle", "right")) == pytest.approx(weight, rel=1e-8)
    sim.excavate("middle")
    report = sim.solve(ratio=1e-10)
    assert report.converged and report.start_ratio > 0.1
    for name in ("left", "right"):
        assert sim.pair_force(name, "lintel")[2] == pytest.approx(0.5 * weight, rel=1e-8)


@pytest.mark.parametrize("body", ["uniform", "linear", "zoned"])
def test_in_situ_stress(body):
    """Rock between smooth walls starts under its weight and the lateral stress that goes with it: it stays."""
    scene, ratio, g = fdem.Scene(gravity=(0, 0, -G)), 1.0 / 3.0, 2000 * G
    rock = scene.add(fdem.brick((0, 0, -2), (1, 1, 0)), BODIES[body], fdem.Elastic(2000.0, 1e9, 0.25), name="rock")
    scene.fix(rock, "rotation") if body == "uniform" else None
    mean = body == "uniform"  # which carries the mean stress
    scene.apply(fdem.Stress(zz=-g if mean else lambda x: g * x[:, 2], k=(ratio, ratio)), rock)
    for axis in range(3):
        for side in (0.0, 1.0) if axis < 2 else (-2.0,):
            press = ratio * g if axis < 2 else 2 * g

            def where(x, a=axis, s=side):
                return np.abs(x[:, a] - s) < 1e-9

            depth = 1.0 if mean or axis == 2 else lambda x: -x[:, 2]
            value = press * depth if not callable(depth) else lambda x, p=press, d=depth: p * d(x)
            scene.apply(fdem.Pressure(value), rock, where=where)
            scene.apply(fdem.Support(normal=1e9), rock, where=where)
    sim = fdem.Simulation(scene, fdem.Static(tolerance=1e-9))
    report = sim.solve(ratio=1e-9)
    assert report.converged
    # weights of gridpoints of zones are those of Voronoi cells, not those that balance a linear stress
    assert report.start_ratio < (0.25 if body == "zoned" else 1e-3) or mean
    assert np.abs(sim[rock].displacement).max() < 1e-6


ROUND = {"linear": fdem.Coulomb(kn=1e8, ks=5e7, friction=30), "hertz": fdem.Hertz(friction=30, young=1e9, poisson=0.2)}


@pytest.mark.parametrize("law", ROUND.values(), ids=ROUND)
def test_pile_of_spheres(law):
    """Three spheres and one on top, on a floor: the floor carries all, the top one a third on each."""
    scene, r = fdem.Scene(), 0.5
    scene.add(fdem.brick((-3, -3, -1), (3, 3, 0)), fdem.Rigid(), fixed=True, name="floor")
    a = r * 2 / np.sqrt(3)
    for k in range(3):
        x, y = a * np.cos(2 * np.pi * k / 3), a * np.sin(2 * np.pi * k / 3)
        scene.add(fdem.sphere(r, (x, y, r)), fdem.Rigid(), STONE, name=f"ball {k}")
    top = r + np.sqrt(4 * r * r - a * a)
    scene.add(fdem.sphere(r, (0, 0, top)), fdem.Rigid(), STONE, name="top")
    scene.joint(law)
    sim = at_rest(scene, 1e-9)
    weight = 2000 * G * 4 / 3 * np.pi * r**3
    assert sum(sim.pair_force("floor", f"ball {k}")[2] for k in range(3)) == pytest.approx(4 * weight, rel=1e-7)
    for k in range(3):
        assert sim.pair_force(f"ball {k}", "top")[2] == pytest.approx(weight / 3, rel=1e-6)


@pytest.mark.parametrize("e", [0.05, 0.2, 0.35, 0.45])
def test_eccentric_load(e):
    """Load at e b: rotation of the no-tension Winkler foundation to 1e-6 (CONTACT.md 6)."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((-2, -2, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    block = scene.add(fdem.brick((-0.5, -0.5, 0), (0.5, 0.5, 0.5)), fdem.Rigid(), fdem.Elastic(density=2500))
    scene.joint(fdem.Coulomb(kn=1e12, ks=1e10, friction=45))
    scene.apply(fdem.Force((0, 0, -1e6), at=(e, 0, 0)), block)
    turned = at_rest(scene, 1e-9)[block].rotation_vector[1]
    assert turned == pytest.approx(acceptance.winkler(e, 1.0, 1e6, 1e12), rel=1e-6)
