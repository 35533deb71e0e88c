"""Blocks on joints against closed forms: toppling, a sliding wedge, a wave through a joint, a slipping crack.

Values and tolerances are those of the verification oracle as corrected for elastic joints.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar
from stress.far import CRITICAL, LINE, RA, RB, SIDES, slid
from verify.meshes import box, plane

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia

G = 9.81

# ------------------------------------------------------------------------------------------------------- toppling

B, H, DENSITY = 1.0, 2.0, 2000.0
WEIGHT = DENSITY * B * H * G  # per metre of depth


def tilted(degrees, phi, settlement, damping=0.0, body=None):
    """A block of 1 x 1 x 2 m on a slope; gravity is tilted. Upright it would settle by `settlement` [m]."""
    a, kn = np.radians(degrees), WEIGHT / (B * settlement)
    scene = fdem.Scene(gravity=G * np.array([np.sin(a), 0, -np.cos(a)]))
    scene.add(fdem.brick((-5, -2, -1), (8, 3, 0)), fdem.Rigid(), fixed=True, name="slope")
    scene.add(fdem.brick((0, 0, 0), (B, 1, H)), body or fdem.Rigid(), fdem.Elastic(DENSITY, 1e11, 0.2), name="block")
    scene.joint(fdem.Coulomb(kn=kn, ks=kn, friction=phi, damping=damping))
    return scene


def winkler_tilt(settlement):
    """Critical tilt [deg] of the block on an elastic base without tension.

    Turned by t about its lower edge it touches over the length ``c = sqrt(2 N / (kn t))``, N = W cos a, and the base
    pushes at c / 3. It is in balance at the tilt a for which
    ``b/2 cos(a + t) - h/2 sin(a + t) = c/3 (cos a + t sin a)``; the largest of these tilts over t is critical.
    """
    kn = WEIGHT / (B * settlement)

    def balance(t):
        def moment(a):
            arm = np.sqrt(2 * WEIGHT * np.cos(a) / (kn * t)) / 3
            return B / 2 * np.cos(a + t) - H / 2 * np.sin(a + t) - arm * (np.cos(a) + t * np.sin(a))

        return brentq(moment, 0.0, np.arctan(B / H))

    log_t = np.log(2.5 * settlement / B), np.log(0.1)
    best = minimize_scalar(lambda x: -balance(np.exp(x)), bounds=log_t, method="bounded", options={"xatol": 1e-9})
    return np.degrees(-best.fun)


def outcome(sim):
    """ "stable", "slide" or "topple" of a block that was let go by Relaxation."""
    report = sim.solve(ratio=1e-6)
    if abs(sim["block"].rotation_vector[1]) > 1e-3 and (
        report.reason != "equilibrium" or sim["block"].rotation_vector[1] > 0.5
    ):
        return "topple"
    return {"equilibrium": "stable", "collapse": "slide"}[report.reason]


@pytest.mark.parametrize(
    ("body", "settlement"),
    [
        (fdem.Rigid(), 1e-4),
        (fdem.Rigid(), 1e-5),
        pytest.param(fdem.Rigid(), 1e-7, marks=pytest.mark.long),
        (fdem.UniformStrain(), 1e-4),
        pytest.param(fdem.LinearStrain(), 1e-4, marks=pytest.mark.long),
        pytest.param(fdem.Zoned(mass="inertia-matched"), 1e-4, marks=pytest.mark.long),
    ],
)
def test_toppling_threshold(body, settlement):
    """Critical tilt within 0.1 degree of the elastic base's: 23.97, 25.38, 26.31 against atan(b/h) = 26.57 degrees."""
    critical = winkler_tilt(settlement)
    assert np.degrees(np.arctan(B / H)) - 600 * settlement ** (1 / 3) < critical < np.degrees(np.arctan(B / H))
    for away, expected in ((-0.1, "stable"), (0.1, "topple")):
        sim = fdem.Simulation(
            tilted(critical + away, 45, settlement, body=body), fdem.Relaxation(), progress=False, energy=False
        )
        assert outcome(sim) == expected


@pytest.mark.parametrize(
    ("degrees", "phi", "regime"),
    [
        pytest.param(26.0, 45.0, "stable", marks=pytest.mark.long), (27.0, 45.0, "topple"), (20.0, 15.0, "slide"),
        (20.0, 25.0, "stable"),
    ],
)  # fmt: skip
def test_regimes_of_a_block_on_a_slope(degrees, phi, regime):
    """The four cases, the joint stiff enough (1e-7 b) for the tilt of the first to lie below the elastic base's."""
    sim = fdem.Simulation(tilted(degrees, phi, 1e-7), fdem.Relaxation(), progress=False, energy=False)
    assert outcome(sim) == regime


def test_angular_acceleration_at_onset():
    """27 degrees: 3 g (h sin a - b cos a) / (2 (b^2 + h^2)) to 1 %, taken up as the block turns about its edge.

    Energy of rotation gained between two looks over the fall of the centroid: what the elastic base gave at the start
    drops out. Settlement 1e-9 b: the base still touches over sqrt(2 s / t), 0.6 mm at the first look.
    """
    start = fdem.Simulation(tilted(26.0, 45, 1e-9), fdem.Relaxation(), progress=False, energy=False)
    start.cycle(5000)
    scene = tilted(27.0, 45, 1e-9, damping=0.1)
    sim = fdem.Simulation(scene, fdem.Explicit(), start=start, progress=False, energy=False)
    a, look = np.radians(27.0), []
    for _ in range(2):
        sim.run(time=0.35)
        turn = sim["block"].rotation_vector[1]
        height = B / 2 * np.sin(a + turn) + H / 2 * np.cos(a + turn)
        look.append((0.5 * sim["block"].angular_velocity[1] ** 2, height))
    (before, high), (after, low) = look
    onset = 1.5 * G * (H * np.sin(a) - B * np.cos(a)) / (B**2 + H**2)
    assert onset == pytest.approx(0.049955880780605436, rel=1e-12)
    # g / (I / m) = 3 g / (b^2 + h^2) times the fall: at the onset the acceleration above, at any turn the exact one
    assert after - before == pytest.approx(3 * G / (B**2 + H**2) * (high - low), rel=0.01)


# ---------------------------------------------------------------------------------------------------------- wedge


# equilibrium of a unit weight across the line of intersection: normal forces, and what drives along it


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (500_000.0, 4_600_000.0, 300.0)])
def test_wedge_slides_below_the_critical_friction_angle(origin):
    """Moving along the line it speeds up or slows down 0.1 degree either side of 33.357; S22: the same at UTM.

    The acceleration beside it fixes the critical angle to 0.02 degrees. Direction within 0.1 degree, RA/W and RB/W to
    1e-3. (At rest a wedge may stick below the critical angle: shear across the line, left by settling, adds to the
    normal forces.)
    """
    assert CRITICAL == pytest.approx(33.357221408834086, rel=1e-12)
    assert (RA, RB) == pytest.approx((0.6733123018471943, 0.24210642634315446), rel=1e-12)
    rates = []
    for phi in (CRITICAL - 0.1, CRITICAL + 0.1):
        sim, begin, rate = slid(phi, origin)
        rates.append(rate)
        path = sim["wedge"].position - begin
        assert np.degrees(np.arccos(path @ LINE / np.linalg.norm(path))) <= 0.1
        weight = 10 * sim["wedge"].mass
        pushes = [sim.pair_force(f"under {side}", "wedge") @ n / weight for side, n in zip("AB", SIDES, strict=True)]
        assert pushes == pytest.approx([RA, RB], abs=1e-3)
        touching = {tuple(pair) for pair in np.sort(sim.system.contacts.pairs, axis=1).tolist()}
        assert len(touching) == 3
    assert rates[0] > 0 > rates[1]
    assert CRITICAL - 0.1 + 0.2 * rates[0] / (rates[0] - rates[1]) == pytest.approx(CRITICAL, abs=0.02)


def test_wedge_acceleration():
    """phi = 30 degrees: 0.7411 m/s2 to 0.1 %."""
    _, _, rate = slid(30.0, (0.0, 0.0, 0.0))
    assert rate == pytest.approx(0.741100316168658, rel=1e-3)


# ----------------------------------------------------------------------------------------------------------- wave

RHO, SPEED, V0 = 2650.0, 3000.0, 0.1
IMPEDANCE = RHO * SPEED


def column(kn, left, right, edge, width, source):
    """Two elastic bars (nu = 0) of so many cells along x with a joint at x = 0 and quiet ends; a source at the left."""
    scene, a, b = fdem.Scene(gravity=(0, 0, 0)), -left * edge, right * edge
    stone = fdem.Elastic(RHO, RHO * SPEED**2, 0.0)
    scene.add(box((left, 1, 1), (0, width, width), (a, 0, 0)), fdem.Zoned(), stone, name="left")
    scene.add(box((right, 1, 1), (b, width, width)), fdem.Zoned(), stone, name="right")
    scene.joint(fdem.Bonded(kn=kn, ks=kn))  # holds in tension, as the closed form's spring does
    scene.apply(fdem.Drag(), "left", where=plane(0, a))
    scene.apply(fdem.Drag(), "right", where=plane(0, b))
    scene.apply(fdem.Traction((2 * IMPEDANCE * V0, 0, 0)), "left", where=plane(0, a), factor=source)
    return fdem.Simulation(scene, fdem.Explicit(), progress=False, energy=False)


def plane_wave(sim, x):
    """History of the mean velocity of the section at x; what is not a plane wave drops out."""
    gp = np.flatnonzero(np.abs(sim.positions()[:, 0] - x) < 1e-9)
    share = sim.model.gp_mass[gp] / sim.model.gp_mass[gp].sum()
    return sim.history(lambda s: float(share @ s.velocities()[gp, 0]))


@pytest.mark.parametrize("kn", [1e9, 1e10, 1e11])
def test_wave_through_a_joint(kn):
    """|T| within 1 %, |R|^2 + |T|^2 = 1 within 2 % at 50 and 200 Hz: a pulse, 25 cells to a wave length of 15 m."""
    edge, left, right, middle = 0.6, 150, 60, 75
    delay = 1.5 / 120.0

    def pulse(t):
        q = (120.0 * np.pi * (t - delay)) ** 2
        return (1 - 2 * q) * np.exp(-q)

    sim = column(kn, left, right, edge, 0.15, pulse)
    before, behind = plane_wave(sim, -middle * edge), plane_wave(sim, 20 * edge)
    sim.run(time=(left + middle) * edge / SPEED + 2 * delay + 2 * IMPEDANCE / kn)
    t, v, w = np.array(before.time), np.array(before.values), np.array(behind.values)
    there = t < left * edge / SPEED + delay  # the pulse has passed, its reflection has not come back
    for f in (50.0, 200.0):
        wave = np.exp(-2j * np.pi * f * t) * np.gradient(t)
        come, back, through = (v * wave)[there].sum(), (v * wave)[~there].sum(), (w * wave).sum()
        q = np.pi * f * IMPEDANCE / kn
        assert abs(through / come) == pytest.approx(1 / np.sqrt(1 + q * q), rel=0.01)
        assert abs(through / come) ** 2 + abs(back / come) ** 2 == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("kn", [1e9, 1e10])
def test_step_through_a_joint(kn):
    """v = v0 (1 - exp(-2 k t / Z)) behind the joint, to 1 % of v0 once the front of the mesh has passed."""
    edge = 0.4 * 1e9 / kn
    sim = column(kn, 80, 80, edge, 0.25 * edge, lambda t: 1.0 if t > 0 else 0.0)
    behind, constant = plane_wave(sim, 5 * edge), 0.5 * IMPEDANCE / kn
    sim.run(time=80 * edge / SPEED + 4 * constant)
    t = np.array(behind.time) - 85 * edge / SPEED
    exact = V0 * (1 - np.exp(-np.maximum(t, 0.0) / constant))
    assert np.abs(np.array(behind.values) - exact)[t > 0.5 * constant].max() <= 0.01 * V0
    assert t[-1] > 3 * constant


# ---------------------------------------------------------------------------------------------------------- crack

YOUNG, POISSON, STIFF, ANGLE, SLIP_LENGTH, TOP = 88.9e9, 0.26, 220e9, np.radians(45.0), 0.54, 2.0
TAN = np.tan(np.radians(16.0))
HALF = 0.5 * SLIP_LENGTH * np.cos(ANGLE)  # of the slipping part, along x
LENGTH = 1.0 / np.cos(ANGLE)


def slopes(rigid):
    """Axial stiffness [N/m] while loading, at the turn and near the end of unloading (two springs, one of which slips).

    ``1/k = H/(W B E) + cos^2/(kn L B) + sin^2/(ks L B)``, plus, while the part l slips, its share of the compliance
    ``(l/L) sin a sin(a -+ phi) / (ks B (L - l) cos phi)``.
    """
    phi = np.arctan(TAN)
    k = (0.0 if rigid else TOP / YOUNG) + 1.0 / (STIFF * LENGTH)
    rest = STIFF * (LENGTH - SLIP_LENGTH) * np.cos(phi)
    more = [SLIP_LENGTH / LENGTH * np.sin(ANGLE) * np.sin(ANGLE - s * phi) / rest for s in (1, -1)]
    return 1 / (k + more[0]), 1 / k, 1 / (k + more[1])


def cycle_of(sim, load, shortening, peak, fine):
    """Force-displacement path of a cycle up to `peak` [N] in steps of peak / 20, each in `fine` increments."""
    path, last = {}, 0.0
    for percent in [*range(5, 101, 5), *range(95, 0, -5)]:
        for k in range(fine):
            sim[load].factor = (last + (percent - last) * (k + 1) / fine) / 100 * peak
            assert sim.solve(ratio=1e-8 if fine > 1 else 1e-6).converged
        path[percent, percent < last] = shortening(sim)
        last = percent
    return path


def measured(path, peak):
    up = (path[100, False] - path[20, False]) / 0.8
    turn = (path[95, True] - path[60, True]) / 0.35
    down = (path[50, True] - path[5, True]) / 0.45
    return np.array([peak / up, peak / turn, peak / down])


def test_slipping_crack_between_rigid_halves():
    """Slopes OA, AB, BO to 1e-3, and with them the whole loop.

    The lower half is three fixed blocks, the middle one under the slipping part of the crack. The load comes in small
    steps: Relaxation overshoots, and what slips too far stays.
    """
    scene, ends = fdem.Scene(gravity=(0, 0, 0)), [0.0, 0.5 - HALF, 0.5 + HALF, 1.0]
    for k, name in enumerate(("left", "crack", "right")):
        a, b = ends[k], ends[k + 1]
        shape = fdem.prism([(a, 0), (b, 0), (b, 0.5 + b), (a, 0.5 + a)], 1.0)
        scene.add(shape, fdem.Rigid(), fixed=True, name=name)
    upper = fdem.prism([(0, 0.5), (1, 1.5), (1, TOP), (0, TOP)], 1.0)
    upper = scene.add(upper, fdem.Rigid(), fdem.Elastic(2500.0), name="upper")
    scene.joint(fdem.Coulomb(kn=STIFF, ks=STIFF, friction=60, cohesion=1e12, tension=1e12))
    scene.joint(fdem.Coulomb(kn=STIFF, ks=STIFF, friction=16), between=("crack", "upper"))
    scene.fix(upper, component=("y", "rotation"))
    load = scene.apply(fdem.Force((0, 0, -1)), upper, factor=0.0)
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    exact = slopes(rigid=True)
    assert exact == pytest.approx((254961932791.17575, 311126983722.0809, 222645446176.05713), rel=1e-12)
    peak = 1e-4 * exact[0]
    path = cycle_of(sim, load, lambda s: -s[upper].displacement[2], peak, fine=6)
    assert measured(path, peak) == pytest.approx(exact, rel=1e-3)
    # slip turns round where the shear that unloading takes from the crack is twice the friction of then
    turn = (1 - TAN / np.tan(ANGLE)) / (1 + TAN / np.tan(ANGLE)) * peak
    u_peak = peak / exact[0]
    u_turn = u_peak - (peak - turn) / exact[1]
    for (percent, unloading), u in path.items():
        force = percent / 100 * peak
        back = u_peak - (peak - force) / exact[1] if force > turn else u_turn - (turn - force) / exact[2]
        assert u == pytest.approx(back if unloading else force / exact[0], abs=1e-3 * u_peak)


def test_slipping_crack_in_an_elastic_block():
    """Slopes within 10 % of the same model in series with the block: the stress beside the crack is not uniform."""
    scene, stone = fdem.Scene(gravity=(0, 0, 0)), fdem.Elastic(2500.0, YOUNG, POISSON)
    for name, side in (
        ("lower", [(0, 0), (1, 0), (1, 1.5), (0, 0.5)]),
        ("upper", [(0, 0.5), (1, 1.5), (1, 2), (0, 2)]),
    ):
        scene.add(fdem.prism(side, 1.0), fdem.Zoned(size=0.35), stone, name=name)
    scene.joint(fdem.Coulomb(kn=STIFF, ks=STIFF, friction=60, cohesion=1e12, tension=1e12))
    scene.joint(fdem.Coulomb(kn=STIFF, ks=STIFF, friction=16), where=lambda x: np.abs(x[:, 0] - 0.5) < HALF)
    scene.fix("lower", component="z", where=plane(2, 0.0))
    scene.fix(scene.gridpoint(near=(0, 0, 0), target="lower"), component=("x", "y"))
    scene.fix(scene.gridpoint(near=(1, 0, 0), target="lower"), component="y")
    load = scene.apply(fdem.Traction((0, 0, -1)), "upper", where=plane(2, TOP), factor=0.0)
    sim = fdem.Simulation(scene, fdem.Relaxation(), progress=False)
    top = sim["upper"].gridpoints[:, 2] > TOP - 1e-9
    peak = 1e-4 * slopes(rigid=False)[0]
    path = cycle_of(sim, load, lambda s: -s["upper"].gridpoint_displacement[top, 2].mean(), peak, fine=1)
    assert measured(path, peak) == pytest.approx(slopes(rigid=False), rel=0.1)
