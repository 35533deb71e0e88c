"""ContactDynamics on problems with a closed form: slopes, stacks, impacts, spheres, toppling, wedges, energy.

Values and tolerances are those of the verification oracle for contact dynamics; formulas are coded here.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # stiffness that contact dynamics does not use

G = 9.81
STONE = fdem.Elastic(density=2000.0, young=1e10, poisson=0.2)


def simulate(scene, dt, **options):
    return fdem.Simulation(scene, fdem.ContactDynamics(dt=dt, **options), progress=False)


def slope(phi, angle=30.0, size=(1.0, 1.0, 0.5), velocity=(0, 0, 0), body=None):
    """A block on a slope: gravity is tilted, not the geometry."""
    a = np.radians(angle)
    scene = fdem.Scene(gravity=G * np.array([np.sin(a), 0.0, -np.cos(a)]))
    scene.add(fdem.brick((-20, -2, -1), (20, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    block = scene.add(fdem.brick((0, 0, 0), size), body or fdem.Rigid(), STONE, name="block", velocity=velocity)
    scene.joint(fdem.Coulomb(friction=phi))
    return scene, block


# ----------------------------------------------------------------------------------------------------------- slopes


@pytest.mark.parametrize("phi", [0.0, 10.0, 20.0, 29.0])
def test_block_slides_down(phi):
    """Case rigid_block_incline: s = g (sin a - cos a tan phi) t^2 / 2 to 1e-6, at any step; friction takes its work."""
    a, mu = np.radians(30.0), np.tan(np.radians(phi))
    for dt in (5e-2, 1e-2):
        scene, block = slope(phi)
        sim = simulate(scene, dt)
        for t in (0.5, 1.0, 2.0):
            sim.run(time=t - sim.time)
            exact = 0.5 * G * (np.sin(a) - np.cos(a) * mu) * t**2
            assert sim[block].displacement[0] == pytest.approx(exact, rel=1e-6)
        assert np.abs(sim[block].displacement[1:]).max() < 1e-7  # m: deeper is pushed out
        assert sim.energy.friction == pytest.approx(mu * sim[block].mass * G * np.cos(a) * exact, rel=1e-6)
        assert sim.energy.closure < 1e-9


@pytest.mark.parametrize("phi", [20.0, 40.0])
def test_block_launched_up_stops(phi):
    """v0 = 3 m/s: v0^2 / 2 g (sin a + mu cos a); then it stays, or comes back.

    In the step in which it stops friction acts one way all along: 2 mu g cos a h of speed, and h^2 of way.
    """
    a, mu, dt = np.radians(30.0), np.tan(np.radians(phi)), 1e-3
    scene, block = slope(phi, velocity=(-3, 0, 0))
    sim = simulate(scene, dt)
    brake = G * (np.sin(a) + mu * np.cos(a))
    stop, way = 3.0 / brake, 4.5 / brake
    sim.run(time=stop + 1e-2)
    back = max(G * (np.sin(a) - mu * np.cos(a)), 0.0)
    assert sim[block].displacement[0] == pytest.approx(
        -way + 0.5 * back * (sim.time - stop) ** 2, abs=2 * brake * dt * 1e-2
    )
    if phi > 30.0:
        assert np.abs(sim.state.v).max() < 1e-9


@pytest.mark.parametrize(("phi", "dt"), [(31.0, 1e-1), (31.0, 1e-2), (40.0, 1e-1)])
def test_block_sticks(phi, dt):
    """No creep: less than 1e-6 m in 10 s at any step."""
    scene, block = slope(phi)
    sim = simulate(scene, dt)
    sim.run(time=10.0)
    assert np.abs(sim[block].displacement).max() < 1e-6


def test_no_creep_at_99_percent_of_friction():
    phi = np.degrees(np.arctan(np.tan(np.radians(30.0)) / 0.99))
    for dt in (2e-1, 2e-2):
        scene, block = slope(phi)
        sim = simulate(scene, dt)
        sim.run(time=10.0)
        assert np.abs(sim[block].displacement).max() < 1e-6


# ----------------------------------------------------------------------------------------------- toppling, rocking


@pytest.mark.parametrize(("offset", "topples"), [(-0.005, False), (0.005, True)])
def test_toppling_threshold(offset, topples):
    """Case rigid_toppling_threshold: atan(b / h) within 0.01 degree."""
    scene, block = slope(45.0, np.degrees(np.arctan(0.5)) + offset, (1.0, 1.0, 2.0))
    sim = simulate(scene, 1e-2, tolerance=1e-8)
    sim.cycle(4)
    a = np.radians(np.degrees(np.arctan(0.5)) + offset)
    onset = 3 * G * (2.0 * np.sin(a) - np.cos(a)) / (2 * 5.0)
    turned = sim[block].angular_velocity[1]
    assert turned == pytest.approx(onset * 0.04 if topples else 0.0, abs=0.01 * abs(onset) * 0.04)


@pytest.mark.parametrize(
    ("angle", "phi", "regime"), [(27.0, 45.0, "topple"), (20.0, 15.0, "slide"), (20.0, 25.0, "stable")]
)
def test_regimes(angle, phi, regime):
    """Angular acceleration at the onset, g (sin a - mu cos a), or nothing."""
    scene, block = slope(phi, angle, (1.0, 1.0, 2.0))
    sim = simulate(scene, 1e-3)
    sim.cycle(5)
    a = np.radians(angle)
    turn = 0.049955880780605436 if regime == "topple" else 0.0
    slide = G * (np.sin(a) - np.cos(a) * np.tan(np.radians(phi))) if regime == "slide" else turn
    assert sim[block].angular_velocity[1] / 5e-3 == pytest.approx(turn, abs=1e-2 * turn + 1e-6)
    assert sim[block].velocity[0] / 5e-3 == pytest.approx(slide, abs=1e-2 * abs(slide) + 1e-6)


@pytest.mark.parametrize("share", [0.2, pytest.param(0.5, marks=pytest.mark.long)])
def test_rocking_block(share):
    """Case rigid_rocking_block: time to the impact to 0.1 %, ratio 1 - 3/2 sin^2 alpha to 0.5 %, energy in between."""
    b, h, dt = 0.5, 4.0, 5e-4
    alpha, R = np.arctan(b / h), np.hypot(b, h) / 2
    p2, start = 3 * G / (4 * R), share * np.arctan(b / h)
    s = (np.arange(4000) + 0.5) / 4000  # theta = start (1 - s^2): the integrand of the quarter period is smooth
    rate = np.sqrt(2 * p2 * (np.cos(alpha - start) - np.cos(alpha - start * (1 - s**2))))
    impact = float(np.mean(2 * start * s / rate))
    scene = fdem.Scene()
    scene.add(fdem.brick((-3, -2, -1), (3, 2, 0)), fdem.Rigid(), fixed=True)
    tilted = fdem.brick((-b, 0, 0), (0, 1, h))  # pivot: the edge x = 0
    c, sn = np.cos(start), np.sin(start)
    block = scene.add(
        tilted.transform(np.array([[c, 0, sn, 0], [0, 1, 0, 0], [-sn, 0, c, 0], [0, 0, 0, 1.0]])),
        fdem.Rigid(), fdem.Elastic(2500.0), name="block",
    )  # fmt: skip
    scene.joint(fdem.Coulomb(friction=45.0))
    sim = simulate(scene, dt)
    turning = sim.history(block, "angular_velocity", component="y", every=1)
    sim.run(time=impact + 0.1)
    w, t = turning.values, turning.time
    k = int(np.argmin(w))
    assert t[k] == pytest.approx(impact, abs=1e-3 * impact + dt)
    before = np.sqrt(2 * p2 * (np.cos(alpha - start) - np.cos(alpha)))
    assert -w[k] == pytest.approx(before, rel=2e-3)
    assert w[k + 2] / w[k] == pytest.approx(1 - 1.5 * np.sin(alpha) ** 2, rel=5e-3)


# ------------------------------------------------------------------------------------------------- stacks and walls


@pytest.mark.parametrize("dt", [1e-1, 1e-3])
def test_stack_forces(dt):
    """Case rigid_stack_forces: N_k = (n - k + 1) m g to 1e-8, corners share evenly to 1e-6."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="floor")
    for k in range(10):
        scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), fdem.Rigid(), STONE, name=f"cube {k}")
    scene.joint(fdem.Coulomb(friction=30))
    sim = simulate(scene, dt, tolerance=1e-8)
    sim.cycle(3)
    table = sim.contact_table()
    for k in range(10):
        below = "floor" if k == 0 else f"cube {k - 1}"
        force = 2000 * G * (10 - k)
        assert sim.pair_force(below, f"cube {k}")[2] == pytest.approx(force, rel=1e-8)
        names = np.array(sim.model.names)
        mine = (names[table["block_a"]] == below) & (names[table["block_b"]] == f"cube {k}")
        corners = table["force"][mine, 2]
        assert corners == pytest.approx(force / 4, rel=1e-6) and len(corners) == 4


def test_heavy_on_light():
    """S01, mass ratio 1e6: forces to 1e-6 within 1000 iterations, no ejection."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (1, 1, 0)), fdem.Rigid(), fixed=True, name="floor")
    light = scene.add(fdem.brick((0, 0, 0), (0.1, 0.1, 0.1)), fdem.Rigid(), fdem.Elastic(1e3), name="light")
    heavy = scene.add(fdem.brick((0, 0, 0.1), (0.1, 0.1, 0.2)), fdem.Rigid(), fdem.Elastic(1e9), name="heavy")
    scene.joint(fdem.Coulomb(friction=30))
    sim = simulate(scene, 1e-2)
    for _ in range(100):
        sim.cycle(1)
        assert sim.integrator.iterations <= 1000
    assert sim.pair_force("light", "heavy")[2] == pytest.approx(1e6 * G, rel=1e-6)
    assert sim.pair_force("floor", "light")[2] == pytest.approx((1e6 + 1) * G, rel=1e-6)
    assert np.abs(sim[[light, heavy]].velocity).max() < 1e-3
    assert sim.integrator.penetration < 1e-9


@pytest.mark.parametrize("friction", [0.0, 30.0])
def test_redundant_contacts(friction):
    """S20: a box on 1, 4 and 100 tiles (4, 16, 400 points): the same resultant to 1e-8, iterations <= 10 times."""
    counts, iterations = [], []
    for n in (1, 2, 10):
        scene = fdem.Scene()
        edges = np.linspace(0, 1, n + 1)
        for i in range(n):
            for j in range(n):
                scene.add(
                    fdem.brick((edges[i], edges[j], -0.1), (edges[i + 1], edges[j + 1], 0)), fdem.Rigid(), fixed=True
                )
        scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE, name="box")
        scene.joint(fdem.Coulomb(friction=friction))
        sim = simulate(scene, 1e-2)
        sim.cycle(1)
        iterations.append(sim.integrator.iterations)
        table = sim.contact_table()
        counts.append(len(table["gap"]))
        assert sim["box"].contact_force == pytest.approx([0, 0, 2000 * G], abs=1e-8 * 2000 * G)
        # one of many shares, and the symmetric one: a point and its mirror images carry the same
        place, force = table["position"] - (0.5, 0.5, 0.0), table["force"][:, 2]
        for mirror in ((-1, 1, 1), (1, -1, 1)):
            other = np.abs(place[:, None] - place[None] * mirror).sum(axis=2).argmin(axis=1)
            sums = [np.abs(force[np.abs(place - p).max(axis=1) < 1e-6].sum()) for p in place]
            assert np.array(sums)[other] == pytest.approx(np.array(sums), abs=1e-6 * 2000 * G)
    assert counts == [4, 16, 400]
    assert iterations[-1] <= 10 * max(iterations[0], 1)


def test_box_wedged_in_a_groove():
    """S20: on its edge in a V groove of 45 degrees without friction each side carries W / sqrt 2, to 1e-8."""
    scene = fdem.Scene()
    h = np.sqrt(0.5)
    for name, sign in (("left", -1), ("right", 1)):
        points = np.array([(0, 0), (3 * sign, 3), (3 * sign, -1), (0, -1)], dtype=float)
        scene.add(fdem.prism(points[::sign], 3.0), fdem.Rigid(), fixed=True, name=name)
    edge = np.array([(0, 0), (h, h), (0, 2 * h), (-h, h)])
    shift = np.eye(4)
    shift[1, 3] = 1.0
    scene.add(fdem.prism(edge, 1.0).transform(shift), fdem.Rigid(), STONE, name="box")
    scene.joint(fdem.Coulomb(friction=0.0))
    sim = simulate(scene, 1e-2)
    sim.cycle(10)
    weight = sim["box"].mass * G
    for name, sign in (("left", 1), ("right", -1)):
        assert sim.pair_force(name, "box") == pytest.approx([sign * weight / 2, 0, weight / 2], abs=1e-8 * weight)


def test_overlap_makes_no_energy():
    """S07: cubes that overlap by 20 % are moved apart without getting any speed."""
    scene = fdem.Scene(gravity=(0, 0, 0), gap_tolerance=0)
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE, name="a")
    scene.add(fdem.brick((0, 0, 0.8), (1, 1, 1.8)), fdem.Rigid(), STONE, name="b")
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    sim = simulate(scene, 1e-3)
    sim.cycle(60)
    assert sim.energy.kinetic <= 1e-6 * 2000 * G
    assert sim.integrator.penetration < 1e-6
    assert sim["b"].position[2] - sim["a"].position[2] == pytest.approx(1.0, abs=1e-6)


# -------------------------------------------------------------------------------------------------------- spheres


def ball(height, restitution, friction=0.0, velocity=(0, 0, 0), gravity=(0, 0, -G)):
    scene = fdem.Scene(gravity=gravity)
    scene.add(fdem.brick((-5, -1, -1), (50, 1, 0)), fdem.Rigid(), fixed=True)
    sphere = scene.add(
        fdem.sphere(0.1, (0, 0, 0.1 + height)),
        fdem.Rigid(),
        fdem.Elastic(1 / (4 / 3 * np.pi * 1e-3)),
        velocity=velocity,
    )
    scene.joint(fdem.Coulomb(friction=friction, restitution=restitution))
    return scene, sphere


@pytest.mark.parametrize("dt", [1e-3, pytest.param(1e-4, marks=pytest.mark.long)])
def test_bouncing_sphere(dt):
    """Case rigid_bouncing_sphere, h = 1, e = 0.8: impacts within 2 dt k, apexes e^2, then it lies still."""
    e, t1 = 0.8, np.sqrt(2 / G)
    scene, sphere = ball(1.0, e)
    sim = simulate(scene, dt)
    height = sim.history(sphere, "position", component="z", every=1)
    speed = sim.history(sphere, "velocity", component="z", every=1)
    sim.run(time=t1 * (1 + e) / (1 - e) + 0.1)
    impacts = height.time[1:][(speed.values[:-1] < 0) & (speed.values[1:] > 0)]
    exact = t1 + 2 * t1 * np.cumsum(np.concatenate([[0.0], e ** np.arange(1, 8)]))
    assert (np.abs(impacts[:8] - exact) <= 2 * dt * np.arange(1, 9)).all()
    if dt <= 1e-4:
        apexes = [
            height.values[(height.time > a) & (height.time < b)].max() - 0.1 for a, b in itertools.pairwise(exact)
        ]
        assert np.array(apexes[1:]) / np.array(apexes[:-1]) == pytest.approx(e**2, rel=5e-3)
    assert abs(speed.values[-1]) <= 1e-10
    assert sim.integrator.penetration <= 1e-8


def test_sphere_slips_then_rolls():
    """Case rigid_sphere_slip_roll: v = 5/7 v0 to 1e-10, the path while slipping, what is dissipated."""
    scene, sphere = ball(0.0, None, np.degrees(np.arctan(0.2)), (2, 0, 0))
    sim = simulate(scene, 1e-3)
    sim.run(time=1.0)
    v, t = 10 / 7, 2 * 2.0 / (7 * 0.2 * G)
    assert sim[sphere].velocity == pytest.approx([v, 0, 0], abs=1e-9)
    assert sim[sphere].angular_velocity == pytest.approx([0, v / 0.1, 0], abs=1e-8)
    path = (4.0 - v**2) / (2 * 0.2 * G) + v * (1.0 - t)
    assert sim[sphere].displacement[0] == pytest.approx(path, rel=1e-5)
    assert sim.energy.friction == pytest.approx(4 / 7, rel=1e-3)


@pytest.mark.parametrize("mu", [0.1, 0.16, 0.17, 0.5])
def test_sphere_on_an_incline(mu):
    """Rolls if mu >= 2/7 tan a: 5/7 g sin a; else slides with spin 5 mu g cos a / 2 r."""
    a = np.radians(30.0)
    scene, sphere = ball(0.0, None, np.degrees(np.arctan(mu)), gravity=G * np.array([np.sin(a), 0, -np.cos(a)]))
    sim = simulate(scene, 1e-2)
    sim.run(time=1.0)
    rolls = mu >= 2 / 7 * np.tan(a)
    speed = 5 / 7 * G * np.sin(a) if rolls else G * (np.sin(a) - mu * np.cos(a))
    spin = speed / 0.1 if rolls else 2.5 * mu * G * np.cos(a) / 0.1
    assert sim[sphere].velocity[0] == pytest.approx(speed, rel=1e-8)
    assert sim[sphere].angular_velocity[1] == pytest.approx(spin, rel=1e-8)
    assert sim[sphere].displacement[0] == pytest.approx(speed / 2, rel=1e-6)


@pytest.mark.parametrize("e", [1.0, 0.5, 0.0])
def test_newtons_cradle(e):
    """Case newtons_cradle: five balls, gaps 1e-4 r; one impact after the other, momentum to round-off."""
    r, gap = 0.02, 2e-6
    scene = fdem.Scene(gravity=(0, 0, 0))
    density = 0.25 / (4 / 3 * np.pi * r**3)
    balls = [
        scene.add(
            fdem.sphere(r, (k * (2 * r + gap), 0, 0)),
            fdem.Rigid(),
            fdem.Elastic(density),
            name=f"ball {k}",
            velocity=(float(k == 0), 0, 0),
        )
        for k in range(5)
    ]
    scene.joint(fdem.Coulomb(friction=0.0, restitution=e, kn=1e9, ks=1e9))
    sim = simulate(scene, 1e-6, tolerance=1e-13)
    sim.cycle(20 if e else 400)
    v = sim[balls].velocity[:, 0]
    passed = np.array([(1 + e) ** k * (1 - e) / 2 ** (k + 1) for k in range(4)] + [((1 + e) / 2) ** 4])
    if e == 1.0:
        assert v == pytest.approx(passed, abs=1e-12)
        assert 0.125 * (v**2).sum() == pytest.approx(0.125, rel=1e-10)
    if e == 0.5:
        assert v[-1] == pytest.approx(passed[-1], rel=1e-10)
    if e == 0.0:
        assert v == pytest.approx(0.2, abs=1e-8)
    assert v.sum() == pytest.approx(1.0, rel=1e-12)


# ---------------------------------------------------------------------------------------------------------- energy


def test_block_stops_on_the_level():
    """Case friction_energy (1): v0^2 / 2 mu g, all of m v0^2 / 2 dissipated."""
    scene, block = slope(np.degrees(np.arctan(0.4)), 0.0, velocity=(3, 0, 0))
    sim = simulate(scene, 1e-2)
    sim.run(time=1.0)
    assert sim[block].displacement[0] == pytest.approx(9 / (0.8 * G), rel=2e-3)
    assert sim.energy.friction == pytest.approx(0.5 * sim[block].mass * 9, rel=1e-9)
    assert sim.energy.kinetic < 1e-12 and sim.energy.closure < 1e-9


class Spring:
    """Pulls all gridpoints towards a point that moves at 0.1 m/s, 1e4 N/m in all."""

    def force(self, t, x, v):
        f = np.zeros_like(x)
        f[:, 0] = 1e4 * (0.1 * t - (x[:, 0] - self.x0)) / len(x)
        return f


def test_block_dragged_by_a_spring():
    """Case friction_energy (2): slip begins at mu m g / K V, then v = V (1 - cos w t), peak 2 V."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-2, -2, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
    block = scene.add(fdem.brick((-0.5, -0.5, 0), (0.5, 0.5, 0.1)), fdem.Rigid(), fdem.Elastic(1000.0))
    scene.joint(fdem.Coulomb(friction=np.degrees(np.arctan(0.4))))
    load = Spring()
    load.x0 = np.array([-0.5, 0.5])[np.array([0, 1])].mean()
    scene.apply(load, block)
    sim = simulate(scene, 1e-3)
    moving = sim.history(block, "velocity", component="x", every=1)
    start, period = 0.4 * 100 * G / (1e4 * 0.1), 2 * np.pi / 10
    sim.run(time=start + period)
    assert moving.time[np.flatnonzero(moving.values > 1e-6)[0]] == pytest.approx(start, abs=3e-3)
    late = moving.time > start
    exact = 0.1 * (1 - np.cos(10 * (moving.time[late] - start)))
    assert moving.values[late] == pytest.approx(exact, abs=2e-3)  # 1 % of the peak: steps of 1/600 of the period
    assert sim.energy.closure < 1e-3


# ------------------------------------------------------------------------------------------------------------ wedge


def normal_of(dip, direction):
    d, a = np.radians(dip), np.radians(direction)
    return np.array([np.sin(d) * np.sin(a), np.sin(d) * np.cos(a), np.cos(d)])


SIDES = normal_of(40, 130), normal_of(60, 220)
LINE = np.cross(*SIDES) / np.linalg.norm(np.cross(*SIDES))
LINE = LINE if LINE[2] < 0 else -LINE
RA, RB, DRIVE = np.linalg.solve(np.column_stack([*SIDES, -LINE]), [0.0, 0.0, 1.0])
CRITICAL = np.degrees(np.arctan(DRIVE / (RA + RB)))


def wedge(phi, speed=0.0):
    """Rock cut by planes 40/130 and 60/220; the piece above both is free, g = 10."""
    scene, pieces = fdem.Scene(gravity=(0, 0, -10)), [fdem.brick((-5, -5, -5), (5, 5, 5))]
    for dip, direction in ((40, 130), (60, 220)):
        pieces = fdem.cut(pieces, fdem.JointSet(dip, direction))
    for piece in pieces:
        above = tuple(bool(piece.centroid @ n > 0) for n in SIDES)
        name = {(1, 1): "wedge", (0, 1): "under A", (1, 0): "under B", (0, 0): "deep"}[above]
        moves = {"velocity": speed * LINE} if name == "wedge" else {"fixed": True}
        if name == "deep":
            continue  # it touches the line alone, and what the line carries is not to be told from RA and RB
        scene.add(piece, fdem.Rigid(), fdem.Elastic(2000.0), name=name, **moves)
    scene.joint(fdem.Coulomb(friction=phi))
    return scene


@pytest.mark.parametrize("offset", [-0.02, 0.02])
def test_moving_wedge(offset):
    """Case rigid_wedge_factor: moving along the line it speeds up or slows down 0.02 degrees either side of 33.357."""
    phi = CRITICAL + offset
    sim = simulate(wedge(phi, 0.3), 1e-2)
    sim.cycle(10)
    exact = 10 * (DRIVE - (RA + RB) * np.tan(np.radians(phi)))
    velocity = sim["wedge"].velocity
    assert (velocity @ LINE - 0.3) / 0.1 == pytest.approx(exact, abs=1e-5)
    assert np.degrees(np.arccos(min(velocity @ LINE / np.linalg.norm(velocity), 1.0))) <= 0.1
    weight = 10 * sim["wedge"].mass
    pushes = [sim.pair_force(f"under {side}", "wedge") @ n / weight for side, n in zip("AB", SIDES, strict=True)]
    assert pushes == pytest.approx([RA, RB], abs=1e-5)


# ------------------------------------------------------------------------------------- bodies that deform, and bonds


@pytest.mark.parametrize("body", [fdem.UniformStrain(), fdem.LinearStrain(), fdem.Zoned(size=0.5)])
def test_deformable_block_slides_or_sticks(body):
    """The rigid block's path to 1e-5: elastic waves of sudden gravity move its centre by 1e-6 of it."""
    scene, block = slope(20.0, body=body)
    sim = simulate(scene, 1e-2)
    sim.run(time=0.5)
    a = np.radians(30.0)
    exact = 0.125 * G * (np.sin(a) - np.cos(a) * np.tan(np.radians(20.0)))
    assert sim[block].displacement[0] == pytest.approx(exact, rel=1e-5)
    assert sim.energy.closure < 1e-6
    scene, block = slope(40.0, body=body)
    sim = simulate(scene, 1e-2)
    sim.run(time=0.5)
    # elastic: m g sin a over the shear stiffness of its height
    assert abs(sim[block].displacement[0]) < 2000 * 0.5 * G / (STONE.young / 2.4 / 0.5)


@pytest.mark.parametrize("body", [fdem.UniformStrain(), fdem.LinearStrain(), fdem.Zoned(size=0.5)])
def test_stack_of_deformable_cubes(body):
    """theta = 1 damps the waves of sudden gravity away: what lies above, to 1e-5."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="floor")
    for k in range(4):
        scene.add(fdem.brick((0, 0, k), (1, 1, k + 1)), body, STONE, name=f"cube {k}")
    scene.joint(fdem.Coulomb(friction=30))
    sim = simulate(scene, 1e-2, theta=1.0)
    sim.cycle(40)
    for k in range(4):
        below = "floor" if k == 0 else f"cube {k - 1}"
        assert sim.pair_force(below, f"cube {k}")[2] == pytest.approx(2000 * G * (4 - k), rel=1e-5)


@pytest.mark.parametrize(("share", "holds"), [(0.99, True), (1.01, False)])
def test_cohesion_holds_until_it_is_exceeded(share, holds):
    """A block on a slope of 30 degrees, phi = 20: c A = m g (sin a - cos a tan phi) is just enough; then it slides."""
    a, phi = np.radians(30.0), 20.0
    need = 2000 * 0.5 * G * (np.sin(a) - np.cos(a) * np.tan(np.radians(phi)))  # Pa on 1 m2
    scene, block = slope(phi)
    scene.joint(fdem.Coulomb(friction=phi, cohesion=need / share))
    sim = simulate(scene, 1e-2)
    sim.cycle(20)
    exact = 0.0 if holds else 0.02 * need / 1000.0  # from the second step on friction alone
    assert sim[block].displacement[0] == pytest.approx(exact, rel=0.11, abs=1e-7)


@pytest.mark.parametrize(("share", "holds"), [(0.99, True), (1.01, False)])
def test_tension_holds_until_it_is_exceeded(share, holds):
    """A block that hangs from a ceiling by its weight over the area."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, 1), (2, 2, 2)), fdem.Rigid(), fixed=True)
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE)
    scene.joint(fdem.Coulomb(friction=30, tension=2000 * G / share, cohesion=1e6))
    sim = simulate(scene, 1e-2)
    sim.cycle(20)
    assert sim[block].displacement[2] == pytest.approx(0.0 if holds else -0.5 * G * 0.04, rel=0.11, abs=1e-7)


def test_not_converged_is_said():
    scene = slope(20.0)[0]
    with pytest.raises(fdem.ConvergenceError, match="'base' and 'block'; residuals: ") as error:
        sim = simulate(scene, 1e-2, max_iterations=1)
        sim.cycle(1)
    assert len(error.value.residuals) >= 2
    assert sim.time == 0.0 and (sim["block"].displacement == 0.0).all()  # as before the step
    with pytest.raises(fdem.UnsupportedError, match="hard"):
        scene.joint(fdem.Coulomb(friction=20, rolling=0.1, kn=1e9, ks=1e9))
        simulate(scene, 1e-2).cycle(1)


def test_saved_state_goes_on_bit_for_bit(tmp_path):
    """Impulses are saved: a block that turns over its edge, forces told at once."""

    def scene():
        return slope(45.0, 35.0, (1.0, 1.0, 2.5))[0]

    whole = simulate(scene(), 1e-2)
    whole.cycle(40)
    half = simulate(scene(), 1e-2)
    half.cycle(20)
    half.save(tmp_path / "half.npz")
    on = fdem.load(tmp_path / "half.npz", scene(), fdem.ContactDynamics(dt=1e-2))
    assert (on.pair_force("base", "block") == half.pair_force("base", "block")).all()
    on.cycle(20)
    assert (on.state.q == whole.state.q).all() and (on.state.v == whole.state.v).all()
    assert np.abs(whole["block"].rotation_vector[1]) > 1e-3


# ------------------------------------------------------------------------------------------- edges, corners and piles


def turned(shape, rotation, centre):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, centre
    return shape.transform(matrix)


def about(axis, angle):
    c, s, k = np.cos(angle), np.sin(angle), np.zeros((3, 3))
    k[[0, 1, 2], [1, 2, 0]] = -np.array(axis, float)[[2, 0, 1]]
    k -= k.T
    return np.eye(3) + s * k + (1 - c) * k @ k


def test_crossing_edges_push_apart_along_their_common_normal():
    """Two bars on edge, one across the other, in free flight: momentum goes up and down only; a blow of m v / 2."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    bar, h = fdem.brick((-1, -0.1, -0.1), (1, 0.1, 0.1)), 0.1 * np.sqrt(2)
    low = about((1, 0, 0), np.pi / 4)
    high = about((0, 0, 1), np.pi / 2) @ low
    scene.add(turned(bar, low, (0, 0, 0)), fdem.Rigid(), STONE, name="low")
    scene.add(turned(bar, high, (0, 0, 2 * h + 1e-3)), fdem.Rigid(), STONE, name="high", velocity=(0, 0, -1))
    scene.joint(fdem.Coulomb(friction=30, kn=1e9, ks=1e9))
    sim = simulate(scene, 1e-3)
    sim.run(time=5e-3)
    assert sim["low"].velocity == pytest.approx([0, 0, -0.5], abs=1e-6)
    assert sim["high"].velocity == pytest.approx([0, 0, -0.5], abs=1e-6)
    assert np.abs(sim["high"].angular_velocity).max() < 1e-6


def test_cube_dropped_on_its_corner():
    """It falls over onto a face, and lies; the corner does not sink."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-3, -3, -1), (3, 3, 0)), fdem.Rigid(), fixed=True)
    up = about((0, 1, 0), 0.6) @ about((1, 0, 0), 0.7)
    cube = turned(fdem.brick((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)), up, (0, 0, 0.95))
    scene.add(cube, fdem.Rigid(), STONE, name="cube")
    scene.joint(fdem.Coulomb(friction=35))
    sim = simulate(scene, 5e-3)
    sim.run(time=2.5)
    assert sim.energy.kinetic < 1e-9
    assert sim["cube"].position[2] == pytest.approx(0.5, abs=1e-6)
    assert sim.energy.closure < 1e-9


@pytest.mark.parametrize("kind", ["cubes", "clumps"])
def test_pile(kind):
    """Bodies dropped into a box: energy closes to round-off, nothing sinks in."""
    rng, scene = np.random.default_rng(1), fdem.Scene()
    scene.add(fdem.brick((-3, -3, -1), (3, 3, 0)), fdem.Rigid(), fixed=True)
    for axis in (0, 1):
        for sign in (-1, 1):
            low, high = np.array([-0.9, -0.9, 0.0]), np.array([0.9, 0.9, 3.0])
            low[axis], high[axis] = sorted((sign * 0.9, sign * 1.2))
            scene.add(fdem.brick(low, high), fdem.Rigid(), fixed=True)
    for k in range(8):
        centre = np.array([0.8 * (k % 2) - 0.4, 0.8 * (k // 2 % 2) - 0.4, 0.5 + 0.8 * (k // 4)])
        axis = rng.normal(size=3)
        spin = about(axis / np.linalg.norm(axis), rng.uniform(0, 3))
        if kind == "cubes":
            shape = turned(fdem.brick((-0.2, -0.2, -0.2), (0.2, 0.2, 0.2)), spin, centre)
        else:
            shape = fdem.clump([(centre, 0.2), (centre + 0.15 * spin[0], 0.15)])
        scene.add(shape, fdem.Rigid(), STONE)
    scene.joint(fdem.Coulomb(friction=30))
    sim = simulate(scene, 5e-3)
    for _ in range(200 if kind == "cubes" else 100):
        sim.cycle(1)
        assert sim.integrator.penetration < 0.03  # m: an impact at 4 m/s within a step
    assert sim.energy.closure < 1e-9
    assert sim.integrator.penetration < 5e-3
    assert sim.energy.friction > 0.0
    # the cubes have all but settled: 1 % of what fell is still in motion; clumps roll on
    assert kind == "clumps" or sim.energy.kinetic < 0.01 * (sim.energy.friction + sim.energy.damping)


def test_platen_pushes_a_block():
    """A driven block at 0.5 m/s: mu m g on the face, its work mu m g v t goes into friction."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (5, 2, 0)), fdem.Rigid(), fixed=True)
    platen = fdem.brick((-0.5, 0, 0.01), (0, 1, 0.49))
    scene.add(platen, fdem.Rigid(), STONE, name="platen", fixed=True, velocity=(0.5, 0, 0))
    scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), fdem.Rigid(), STONE, name="block", velocity=(0.5, 0, 0))
    scene.joint(fdem.Coulomb(friction=30))
    scene.joint(fdem.Coulomb(friction=0), between=("platen", "block"))
    sim = simulate(scene, 1e-2)
    sim.run(time=0.5)
    force = 1000 * G * np.tan(np.radians(30))
    assert sim.pair_force("platen", "block")[0] == pytest.approx(force, rel=1e-6)
    assert sim["block"].displacement[0] == pytest.approx(0.25, rel=1e-6)
    assert sim.energy.work == pytest.approx(0.25 * force, rel=1e-6)
    assert sim.energy.friction == pytest.approx(0.25 * force, rel=1e-6) and sim.energy.closure < 1e-9


def test_moment_works_on_a_free_block():
    """I omega = M t and M^2 t^2 / 2 I of work."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), STONE)
    scene.joint(fdem.Coulomb(friction=30, kn=1e9, ks=1e9))
    scene.apply(fdem.Moment((0, 0, 100.0)), block)
    sim = simulate(scene, 1e-2)
    sim.run(time=1.0)
    assert sim[block].angular_velocity[2] == pytest.approx(100.0 * 6 / 2000.0, rel=1e-9)
    # a moment on a block is forces on its gridpoints, whose work is counted along chords: 1e-6 at this step
    assert sim.energy.work == pytest.approx(0.5 * 100.0**2 * 6 / 2000.0, rel=1e-6) and sim.energy.closure < 1e-6
