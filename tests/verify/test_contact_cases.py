"""Joints between blocks: non-matching patch test, direct shear, friction energy."""

from __future__ import annotations

import numpy as np
import pytest
from verify.meshes import box_mesh, plane

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia

G = 9.81
KINDS = {"rigid": fdem.Rigid(), "uniform": fdem.UniformStrain(), "linear": fdem.LinearStrain(), "zoned": fdem.Zoned()}
LOWER, UPPER = [0.0, 0.3, 0.7, 1.0], [0.0, 0.22, 0.5, 0.81, 1.0]
YOUNG, POISSON, PRESSURE, KN = 1e10, 0.2, 1e6, 1e11
ROCK = fdem.Elastic(density=2500, young=YOUNG, poisson=POISSON)


def graded(grid, bottom):
    """1 m block on z = bottom whose surface nodes lie on `grid` in x and y."""
    n = len(grid) - 1
    points, tets = box_mesh((n, n, 2), (n, n, 2))
    index = np.rint(points).astype(int)
    where = np.column_stack([np.take(grid, index[:, 0]), np.take(grid, index[:, 1]), bottom + 0.5 * points[:, 2]])
    return fdem.tet_mesh(where, tets)


def hold(scene, block, z=None):
    """Rollers under the block, and three components that stop it from drifting sideways and turning."""
    if z is not None:
        scene.fix(block, component="z", where=plane(2, z))
    low = block.shape.bounds[0]
    scene.fix(scene.gridpoint(near=low, target=block), component=("x", "y"))
    scene.fix(scene.gridpoint(near=low + np.array([1, 0, 0]), target=block), component="y")


def zones_uniform(sim, block, rel):
    expected = np.zeros((len(sim[block].zone_stress), 6))
    expected[:, 2] = -PRESSURE
    assert np.abs(sim[block].zone_stress - expected).max() <= rel * PRESSURE


def nodal_forces(sim, block, z):
    """Contact force on every gridpoint of the face z: what the zones there and the weight leave over."""
    view = sim[block]
    place, stress = view.gridpoints - view.gridpoint_displacement, view.zone_stress  # small strain: as it was
    corners = place[view.zones]
    edges = corners[:, 1:] - corners[:, :1]
    volume = np.abs(np.linalg.det(edges)) / 6
    gradient = np.swapaxes(np.linalg.inv(edges), 1, 2)
    gradient = np.concatenate([-gradient.sum(axis=1, keepdims=True), gradient], axis=1)
    force = np.zeros(len(place))
    pull = volume[:, None] * np.einsum("nki,ni->nk", gradient, stress[:, [4, 3, 2]])
    np.add.at(force, view.zones, pull)
    return force[np.abs(place[:, 2] - z) < 1e-9]


def consistent(grid):
    """p times the area of the triangles round each node / 3, all diagonals of the surface cells parallel."""
    share = np.zeros((len(grid), len(grid)))
    for i, a in enumerate(np.diff(grid)):
        for j, b in enumerate(np.diff(grid)):
            share[i : i + 2, j : j + 2] += a * b / 6 * np.array([[2, 1], [1, 2]])
    return PRESSURE * share.ravel()


@pytest.mark.parametrize("kn", [KN, 1e13])
def test_patch_zoned_on_zoned(kn):
    """Two zoned blocks, 3 x 3 against 4 x 4 faces: uniform stress, resultant, centre, shortening, nodal forces to 1e-6.

    Small strain, as the closed form.
    """
    scene = fdem.Scene(gravity=(0, 0, 0))
    lower = scene.add(graded(LOWER, 0.0), fdem.Zoned(strain="small"), ROCK, name="lower")
    upper = scene.add(graded(UPPER, 1.0), fdem.Zoned(strain="small"), ROCK, name="upper")
    scene.joint(fdem.Coulomb(kn=kn, ks=KN, friction=0))  # smooth: where it slips on the way does not matter
    hold(scene, lower, 0.0)
    hold(scene, upper)
    scene.apply(fdem.Traction((0, 0, -PRESSURE)), upper, where=plane(2, 2.0))
    sim = fdem.Simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-9).converged
    for block in (lower, upper):
        zones_uniform(sim, block, 1e-6)
    assert sim.pair_force(upper, lower)[2] == pytest.approx(-PRESSURE, rel=1e-8)
    load = sim.contact_table()
    weight = load["force"][:, 2] / load["force"][:, 2].sum()
    face = sim[lower].gridpoints[sim[lower].gridpoints[:, 2] > 0.99]
    centre = 0.5 * (face.min(axis=0) + face.max(axis=0))[:2]
    assert (weight @ load["position"])[:2] == pytest.approx(centre, abs=1e-8)
    top = sim[upper].gridpoints[:, 2] > 1.9
    # the contact is as wide as the blocks have become
    shortening = 2 * PRESSURE / YOUNG + PRESSURE / kn / (1 + POISSON * PRESSURE / YOUNG) ** 2
    assert -sim[upper].gridpoint_displacement[top, 2] == pytest.approx(shortening, rel=1e-6)
    assert nodal_forces(sim, upper, 1.0) == pytest.approx(consistent(UPPER), rel=1e-6)
    assert nodal_forces(sim, lower, 1.0) == pytest.approx(-consistent(LOWER), rel=1e-6)


@pytest.mark.parametrize("grid", [LOWER, UPPER])
def test_patch_zoned_on_rigid(grid):
    """A zoned block on a smooth rigid base, its weight left out: uniform stress to 1e-6 p."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    block = scene.add(graded(grid, 0.0), fdem.Zoned(), ROCK, name="block")
    scene.joint(fdem.Coulomb(kn=KN, ks=KN, friction=0))
    hold(scene, block)
    scene.apply(fdem.Pressure(PRESSURE), block, where=plane(2, 1.0))
    sim = fdem.Simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-9).converged
    zones_uniform(sim, block, 1e-6)
    table = sim.contact_table()
    assert table["traction"][table["area"] > 0.01, 0] == pytest.approx(PRESSURE, rel=1e-6)


SHEAR = {"kn": 1e10, "ks": 5e9, "friction": 30.0, "cohesion": 1e5, "tension": 5e4, "residual_cohesion": 1e5}
TAU = 1e5 + 1e6 * np.tan(np.radians(30.0))
U_MAX = 4e-4


def shear_box(body):
    """An upper half of 1 m2 on a wider base, 1 MPa on it, pushed along x by a velocity whose factor is set later."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    stiff = fdem.Elastic(density=2500, young=YOUNG, poisson=0.0)
    if body != "zoned":
        upper = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), KINDS[body], stiff, name="upper")
        # of a block that bends y is held in all its points: sideways slip would take its time to come to rest
        scene.fix(upper, component="y" if body == "linear" else ("y", "rotation"))
    else:
        points, tets = box_mesh((2, 2, 1), (1, 1, 0.5))
        upper = scene.add(fdem.tet_mesh(points, tets), fdem.Zoned(), stiff, name="upper")
        scene.fix(upper, component="y")
    scene.joint(fdem.Coulomb(**SHEAR))
    load = scene.apply(fdem.Traction((0, 0, -1e6)), upper, where=plane(2, 0.5))
    drive = scene.apply(fdem.Velocity((1.0, None, None)), upper, factor=0.0)
    return scene, load, drive


def pushed(sim, drive, distance, steps):
    """Tangential force on the base after moving `distance` [m] along x in so many steps."""
    sim[drive].factor = distance / (steps * sim.dt)
    sim.cycle(steps)
    return sim.pair_force("upper", "base")[0]


@pytest.mark.parametrize("body", KINDS)
def test_direct_shear_quasi_static(body):
    """tau = min(ks u, c + sn tan phi) and its loop to 1e-6; dissipation to 1 %, in fact to round-off."""
    scene, load, drive = shear_box(body)
    sim = fdem.Simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-10).converged
    assert sim.contact_table()["gap"].min() == pytest.approx(-1e-4, rel=1e-6)
    before = sim.energy.friction
    assert pushed(sim, drive, 1e-4, 50) == pytest.approx(5e9 * 1e-4, rel=1e-6)
    assert pushed(sim, drive, U_MAX - 1e-4, 200) == pytest.approx(TAU, rel=1e-6)
    slipped = U_MAX - TAU / 5e9
    assert pushed(sim, drive, -1e-4, 50) == pytest.approx(TAU - 5e5, rel=1e-6)  # unloading along ks
    assert pushed(sim, drive, 1e-4 - 2 * U_MAX, 400) == pytest.approx(-TAU, rel=1e-6)
    assert pushed(sim, drive, 2 * U_MAX, 400) == pytest.approx(TAU, rel=1e-6)
    slipped += 2 * (2 * U_MAX - 2 * TAU / 5e9)
    sim[drive].factor = 0.0
    sim.cycle(1)  # history is what the last whole step left
    table = sim.contact_table()
    assert table["slip"][table["area"] > 0.01] == pytest.approx(slipped, rel=1e-6)
    # the oracle: 1 % of the loop area; zones also slip unevenly on the way
    assert sim.energy.friction - before == pytest.approx(TAU * slipped, rel=1e-2 if body == "zoned" else 1e-6)
    # the peak follows the normal stress of now
    sim[load].factor = 0.5
    sim[drive].factor = 0.0
    sim.cycle(400)
    assert pushed(sim, drive, U_MAX, 200) == pytest.approx(1e5 + 0.5 * (TAU - 1e5), rel=1e-6)


def test_direct_shear_explicit():
    """The same path at 4 mm/s: 0.5 % of the shear stress, dissipation to 1 %."""
    scene, _, drive = shear_box("rigid")
    start = fdem.Simulation(scene, fdem.Relaxation())
    assert start.solve(ratio=1e-10).converged
    sim = fdem.Simulation(scene, fdem.Explicit(), start=start)
    for distance, tau in ((U_MAX, TAU), (-2 * U_MAX, -TAU), (2 * U_MAX, TAU)):
        steps = round(abs(distance) / 4e-3 / sim.dt)
        assert pushed(sim, drive, distance, steps) == pytest.approx(tau, rel=5e-3)
    # the oracle: dissipated work to 1 %
    assert sim.energy.friction == pytest.approx(TAU * 0.001322649730810374, rel=1e-2)


def test_tension_cut_off():
    """Pulled apart: kn times the opening until T, then nothing, and cohesion is gone for good."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    upper = scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), fdem.Rigid(), ROCK, name="upper")
    scene.fix(upper, component="rotation")
    scene.joint(fdem.Coulomb(**(SHEAR | {"residual_cohesion": 0.0})))
    scene.apply(fdem.Velocity((0, 0, 1)), upper)
    sim = fdem.Simulation(scene, fdem.Explicit(dt=1e-7))
    sim.cycle(40)
    assert sim.pair_force("upper", "base")[2] == pytest.approx(1e10 * 4e-6, rel=1e-6)
    sim.cycle(20)
    assert np.abs(sim.pair_force("upper", "base")).max() == 0.0


def on_table(body, mu, velocity=(0.0, 0.0, 0.0)):
    """100 kg, 0.5 x 0.5 x 0.1 m, on a wide fixed base, settled under its weight; then given a velocity."""

    def scene_of(speed):
        scene = fdem.Scene(gravity=(0, 0, -G))
        scene.add(fdem.brick((-2, -2, -1), (4, 3, 0)), fdem.Rigid(), fixed=True, name="base")
        # one strain for the whole block: soft rock, so that the step is not short (one that bends would flutter)
        stone = fdem.Elastic(density=4000, young=1e8 if body == "uniform" else YOUNG, poisson=0.2)
        shape = fdem.brick((0, 0, 0), (0.5, 0.5, 0.1))
        if body == "zoned":
            shape = fdem.tet_mesh(*box_mesh((3, 3, 1), (0.5, 0.5, 0.1)))
        block = scene.add(shape, KINDS[body], stone, name="block", velocity=speed)
        scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=np.degrees(np.arctan(mu))))
        return scene, block

    settled = fdem.Simulation(scene_of((0, 0, 0))[0], fdem.Relaxation())
    assert settled.solve(ratio=1e-7).converged  # round-off of the zones' forces stays below
    return (*scene_of(velocity), settled)


@pytest.mark.parametrize(
    "body", [kind if kind != "linear" else pytest.param(kind, marks=pytest.mark.long) for kind in KINDS]
)
def test_stopping_block(body):
    """3 m/s, mu = 0.4: stops after v0^2 / (2 mu g) to 0.2 %; energy audit to 1e-3 of m v0^2 / 2."""
    mu, v0 = 0.4, 3.0
    scene, block, settled = on_table(body, mu, (v0, 0, 0))
    # the ledger counts a whole step of friction for the first one, in which the force grows from zero
    sim = fdem.Simulation(scene, fdem.Explicit(safety=0.4), start=settled)
    path = sim.history(block, "displacement", component="x")
    sim.run(time=v0 / (mu * G) + 0.05)
    kinetic = 50 * v0**2
    assert path.values.max() == pytest.approx(v0**2 / (2 * mu * G), rel=2e-3)
    assert path.values[-1] == pytest.approx(path.values.max(), rel=1e-3)  # stays: no chatter
    energy = sim.energy
    assert energy.friction == pytest.approx(kinetic, rel=2e-3)
    assert abs(energy.error) <= 1e-3 * kinetic


class Spring:
    """A spring K at every gridpoint whose far end moves at V; `K` is the total [N/m]."""

    def __init__(self, K, V, start):
        self.K, self.V, self.start = K, V, start

    def force(self, t, x, v):
        result = np.zeros_like(x)
        result[:, 0] = self.K / len(x) * (self.V * t - (x[:, 0] - self.start[:, 0]))
        return result


@pytest.mark.parametrize(
    "body", ["rigid", "uniform", *(pytest.param(kind, marks=pytest.mark.long) for kind in ("linear", "zoned"))]
)
def test_block_dragged_by_a_spring(body):
    """K = 1e4 N/m pulled at 0.1 m/s: slip starts at mu m g / (K V), peaks at 2 V, lasts 2 pi / w."""
    mu, K, V, mass = 0.4, 1e4, 0.1, 100.0
    scene, block, settled = on_table(body, mu)
    load = scene.apply(Spring(K, V, settled["block"].gridpoints), block)
    sim = fdem.Simulation(scene, fdem.Explicit(), start=settled)
    path = sim.history(block, "displacement", component="x")
    speed = sim.history(block, "velocity", component="x")
    begin, w = mu * mass * G / (K * V), np.sqrt(K / mass)
    sim.run(time=begin + 2 * np.pi / w)
    later = np.maximum(path.time - begin, 0.0)
    exact = V * later - V / w * np.sin(w * later)
    assert np.abs(path.values - exact).max() <= 5e-3 * exact[-1]
    assert speed.values.max() == pytest.approx(2 * V, rel=1e-2)
    slip = 2 * np.pi * V / w
    assert path.values[-1] == pytest.approx(slip, rel=2e-3)
    energy = sim.energy
    assert energy.friction == pytest.approx(mu * mass * G * slip, rel=2e-3)
    assert abs(energy.error) <= 1e-3 * energy.friction
    assert sim[load].force[0] == pytest.approx(mu * mass * G, rel=0.02)


@pytest.mark.parametrize("kn", [1e9, 5e7])
def test_flush_cubes_keep_the_area_they_touch_with(kn):
    """Ten equal cubes: closure k is N_k / (kn A), up to 4e-3 of the edge (oracle: integ_relaxation_equilibrium)."""
    scene = fdem.Scene()
    scene.add(fdem.brick((0, 0, -1), (1, 1, 0)), fdem.Rigid(), fixed=True)
    cubes = [
        scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), fdem.Rigid(), fdem.Elastic(density=2000.0)) for k in range(10)
    ]
    scene.joint(fdem.Coulomb(kn=kn, ks=kn, friction=30))
    sim = fdem.Simulation(scene, fdem.Relaxation())
    assert sim.solve(ratio=1e-9).converged
    heights = np.array([0.0, *(sim[cube].displacement[2] for cube in cubes)])
    exact = 2000.0 * 9.81 * np.arange(10, 0, -1) / kn
    np.testing.assert_allclose(-np.diff(heights), exact, rtol=1e-6)  # the oracle's 1e-6 at ratio 1e-8
