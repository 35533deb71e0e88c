"""Stiff corners: an exact energy, friction that counts it, faces left alone, impacts that keep their energy."""

from __future__ import annotations

import numpy as np
import pytest
from contact_tools import Flight, World, box, coulomb, move, rotation
from scenes import simulation

import fdem
from fdem.contact.contacts import LawTable

KN, SIZE = 1e9, 0.1  # Pa/m, least size of a contact [m]
TILTS = {
    "corner": rotation([1, -1, 0], np.arctan(np.sqrt(2))),
    "edge": rotation([1, 0, 0], np.pi / 4),
    "any": rotation([1, 0.3, 0.2], 0.5),
}
MASTERS = {"face": (box(4, 4, 1), 0.5), "edge of a cube": (move(box(1, 1, 1), TILTS["edge"]), np.sqrt(0.5))}


def stiff(tan=0.0, size=SIZE):
    """Coulomb joint with stiff corners."""
    return LawTable("coulomb", coulomb(kn=KN, tan=tan).props, corner=np.array([size**2]))


def touching(tilt, master, depth, law, x=0.02):
    """A tilted cube `depth` below the top of a master."""
    shape, top = MASTERS[master]
    points, faces = move(box(1, 1, 1), TILTS[tilt])
    points = points + np.array([x, 0.03, top - depth - points[:, 2].min()])
    w = World([(points, faces), shape], law=law)
    w.forces()
    w.commit()
    return w


def extra(tilt, master, depth, x=0.02):
    """Force on the cube and energy that stiff corners add."""
    with_, without = (touching(tilt, master, depth, law, x) for law in (stiff(), coulomb(kn=KN)))
    return with_.resultant(0)[0] - without.resultant(0)[0], with_.contacts.energy() - without.contacts.energy()


@pytest.mark.parametrize("master", MASTERS)
@pytest.mark.parametrize("tilt", TILTS)
def test_force_is_the_gradient_of_the_energy(tilt, master):
    h, e = 0.05, 1e-5
    force, _ = extra(tilt, master, h)
    down = (extra(tilt, master, h + e)[1] - extra(tilt, master, h - e)[1]) / (2 * e)
    side = (extra(tilt, master, h, 0.02 + e)[1] - extra(tilt, master, h, 0.02 - e)[1]) / (2 * e)
    # central differences over 1e-5 m: curvature leaves 1e-7, round-off of the energies 1e-8
    assert force[2] == pytest.approx(down, rel=1e-6)
    assert force[0] == pytest.approx(-side, abs=1e-6 * abs(force[2]))


def test_a_cube_on_its_corner_rests_on_a_face_of_the_given_size():
    """F = kn A_c h / 4 for a shallow corner: mean depth h / 2; without it kn V, a hundred times softer here."""
    h = 1e-3
    force = touching("corner", "face", h, stiff()).resultant(0)[0]
    assert force[2] == pytest.approx(KN * SIZE**2 * h / 4, rel=1e-3)
    assert touching("corner", "face", h, coulomb(kn=KN)).resultant(0)[0][2] < 0.01 * force[2]


@pytest.mark.parametrize("tilt", TILTS)
def test_the_force_grows_with_depth(tilt):
    forces = [touching(tilt, "face", h, stiff()).resultant(0)[0][2] for h in np.geomspace(1e-4, 0.15, 60)]
    assert (np.diff(forces) > 0).all()


def test_faces_keep_the_stiffness_of_the_joint():
    """What is added to a contact of area A is (A_c / A)^3 of its stiffness."""
    shape = move(box(1, 1, 1), t=(0, 0, 1 - 1e-4))
    force = [World([shape, box(4, 4, 1)], law=law) for law in (stiff(), coulomb(kn=KN))]
    f, g = (w.forces()[:8].sum(axis=0)[2] for w in force)
    assert f / g - 1.0 == pytest.approx(SIZE**6, rel=1e-2)


@pytest.mark.parametrize("tilt", ["corner", "edge"])
def test_friction_counts_the_whole_normal_force(tilt):
    w = touching(tilt, "face", 1e-3, stiff(tan=0.5))
    for _ in range(40):
        w.shift(0, [1e-4, 0.5e-4, 0])
        w.contacts.update(w.x)
        w.forces(1e-4)
        w.commit()
    force = w.resultant(0)[0]
    # the unaligned facets of a corner share one normal (CONTACT.md 3.6): capacity to 1 %
    assert np.hypot(*force[:2]) == pytest.approx(0.5 * force[2], rel=1e-2)


def impact(seed, share):
    """Relative change of energy and momentum in a random impact of two cubes, at dt omega = share."""
    g = np.random.default_rng(seed)
    a, b = (move(box(1, 1, 1), rotation(g.normal(size=3), g.uniform(0, 3)), (0, 0, z)) for z in (0, 1.75))
    w = World([a, b], law=stiff(), clip_always=True)
    flight = Flight(w, [[0, 0, 1.0], [0, 0, -1.0]], [g.normal(size=3) * 0.5 for _ in range(2)])
    e0, (p0, h0) = flight.kinetic(), flight.momentum()
    dt = share * np.sqrt(flight.m[0] / 2 / KN)
    hit, apart = False, 0
    while apart <= 20:
        w.forces(dt)
        closed = w.contacts.n_patches > 0 and bool((w.contacts._area > 0).any())
        hit |= closed
        apart = apart + 1 if hit and not closed else 0
        flight.step(dt if w.contacts.n_patches else 0.5 / share * dt)
        assert np.abs(w.x).max() < 10.0
    p, h = flight.momentum()
    scale = flight.m[0] * 2.0
    return abs(flight.kinetic() / e0 - 1), max(np.abs(p - p0).max(), np.abs(h - h0).max()) / scale


@pytest.mark.parametrize("seed", [0, 2])
def test_impacts_keep_their_energy(seed):
    """The force sets in with a finite stiffness, where leapfrog loses its order: 1e-6 at 0.1, 1e-7 at 0.025."""
    for share, bound in ((0.1, 2e-6), (0.025, 2e-7)):
        energy, momentum = impact(seed, share)
        assert energy < bound
        assert momentum < 1e-11


def test_a_joint_law_takes_the_size_of_corners():
    """A 25 kN cube on its corner sinks (W / (kn sqrt(3)/2))^(1/3) = 14 mm; with stiff corners of 10 cm a millimetre."""
    sunk = {}
    for corner in (0.0, 0.1):
        scene = fdem.Scene()
        scene.add(fdem.brick((-2, -2, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="floor")
        turn = np.eye(4)
        turn[:3, :3] = TILTS["corner"]
        shape = fdem.brick((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)).transform(turn)
        turn = np.eye(4)
        turn[2, 3] = -np.asarray(shape.bounds)[0, 2]
        cube = scene.add(shape.transform(turn), fdem.Rigid(), fdem.Elastic(2500.0), name="cube")
        scene.fix(cube, component=("x", "y", "rotation"))
        scene.joint(fdem.Coulomb(kn=1e10, ks=5e9, friction=30, corner=corner))
        sim = fdem.Simulation(scene, fdem.Relaxation())
        assert sim.solve(ratio=1e-6).converged
        sunk[corner] = -sim[cube].displacement[2]
    assert sunk[0.0] == pytest.approx((2500 * 9.81 / (1e10 * np.sqrt(0.75))) ** (1 / 3), rel=1e-3)
    assert sunk[0.1] == pytest.approx(4 * 2500 * 9.81 / (1e10 * 0.1**2), rel=0.05)  # F = kn A_c h / 4, less kn V


def test_a_chosen_stiffness_that_is_too_low_is_reported():
    scene = fdem.Scene()
    scene.add(fdem.brick((-2, -2, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="floor")
    cube = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), fdem.Elastic(2500.0), name="cube")
    scene.joint(fdem.Coulomb(friction=30))
    with pytest.warns(fdem.FdemWarning, match="was chosen"):
        sim = fdem.Simulation(scene, fdem.Relaxation())
        sim.apply(fdem.Force((0, 0, -6e6)), cube)
    with pytest.warns(fdem.FdemWarning, match="'floor' and 'cube' overlap by .* of their size"):
        sim.solve(ratio=1e-4)
    assert "closure: at most" in sim.describe()


@pytest.mark.parametrize("friction", [0.0, 30.0])
def test_a_flush_wall_with_stiff_corners_makes_no_energy(friction):
    """Faces that just touch have depths of round-off: they once made forces of 1e3 N, and slip made energy."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (5, 2, 0)), fdem.Rigid(), fixed=True)
    scene.add(fdem.wall(1.2, 0.6, 0.3, (0.4, 0.3)), fdem.Rigid(), fdem.Elastic(2500.0, 1e9, 0.2))
    scene.joint(fdem.Coulomb(kn=1e8, ks=5e7, friction=friction, corner=0.01))
    for dt, bound in ((None, 1e-2), (1e-3, 1e-2)):  # bricks fall by 0.1 mm and clatter
        sim = simulation(scene, fdem.Explicit(dt=dt))
        sim.run(2.0)
        assert sim.energy.closure < bound
        assert sim.energy.kinetic < 1.0  # of 4 J turned over
