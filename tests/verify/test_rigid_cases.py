"""Rigid (and zoned) blocks on joints: incline, stack, modes of a block on a joint."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from stress.steps import BLOCK_KN, DENSITY, H, block_on_joint, freed, modes_of_block
from verify.meshes import box

import fdem

G = 9.81
ANGLE = np.radians(30.0)
KN, KS = 5e9, 2e9
KINDS = {
    "rigid": fdem.Rigid(),
    "uniform": fdem.UniformStrain(),
    "linear": fdem.LinearStrain(),
    "zoned": fdem.Zoned(),
}
BODIES = list(KINDS)
# strain shortens the step: of these bodies the default run takes some friction angles only
SHORT = {
    "rigid": {0.0, 10.0, 20.0, 29.0, 31.0, 40.0},
    "uniform": {20.0},
    "linear": set(),
    "zoned": {0.0, 10.0, 20.0, 29.0, 31.0, 40.0},
}


def angles(*phis):
    """Bodies and friction angles, those beside the default run marked so."""
    pairs = [(body, phi) for body in BODIES for phi in phis]
    return [pytest.param(*pair, marks=() if pair[1] in SHORT[pair[0]] else pytest.mark.long) for pair in pairs]


SHARE = {"rigid": 0.25, "uniform": 0.5, "linear": 0.5, "zoned": 0.5}  # of the stable step, which strain shortens


def tilted(body, phi, velocity=(0.0, 0.0, 0.0), damping=0.0, along=1.0):
    """The 1 x 1 x 0.5 m block of 1000 kg on a slope of 30 degrees: gravity is tilted, not the geometry."""
    scene = fdem.Scene(gravity=G * np.array([along * np.sin(ANGLE), 0.0, -np.cos(ANGLE)]))
    scene.add(fdem.brick((-4, -1, -1), (13, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    shape = box((2, 2, 1), (1, 1, 0.5)) if body == "zoned" else fdem.brick((0, 0, 0), (1, 1, 0.5))
    material = fdem.Elastic(density=2000, young=1e10, poisson=0.2)
    block = scene.add(shape, KINDS[body], material, name="block", velocity=velocity)
    scene.joint(fdem.Coulomb(kn=KN, ks=KS, friction=phi, damping=damping))
    return scene, block


@pytest.fixture(scope="module")
def settle():
    """Equilibrium of a body under a friction angle, kept for the next test."""
    states = {}

    def of(body, phi, along=1.0):
        key = body, phi, along
        if key not in states:
            states[key] = fdem.Simulation(tilted(body, phi, along=along)[0], fdem.Relaxation())
            assert states[key].solve(ratio=1e-9).converged
        return states[key]

    return of


def on_slope(body, phi, start, safety=0.5, **options):
    """Explicit run at half the stable step."""
    scene, block = tilted(body, phi, **options)
    return fdem.Simulation(scene, fdem.Explicit(safety=safety), start=start), block


@pytest.mark.parametrize(("body", "phi"), angles(0.0, 10.0, 20.0, 29.0))
def test_incline_slides(settle, body, phi):
    """s = g (sin a - cos a tan phi) t^2 / 2 to 0.1 %; friction work mu m g cos a s.

    Settled where friction just holds it: every point of the contact is then close to its own limit, and little
    elastic energy is set free when friction drops.
    """
    sim, block = on_slope(body, phi, settle(body, 30.05))
    mu = np.tan(np.radians(phi))
    times = (0.5,) if body != "rigid" else (0.5, 1.0, 2.0) if phi > 10 else (0.5, 1.0)  # fast blocks take short steps
    for t in times:
        sim.run(time=t - sim.time)
        exact = 0.5 * G * (np.sin(ANGLE) - np.cos(ANGLE) * mu) * t**2
        assert sim[block].displacement[0] == pytest.approx(exact, rel=1e-3)
        work = mu * 1000 * G * np.cos(ANGLE) * exact
        assert sim.energy.friction == pytest.approx(work, rel=2e-3)


@pytest.mark.parametrize("phi", [31.0, 40.0])
@pytest.mark.parametrize(
    ("body", "time"),
    [
        ("rigid", 10.0),
        ("uniform", 0.5),
        ("zoned", 1.0),
        pytest.param("uniform", 10.0, marks=pytest.mark.long),
        pytest.param("linear", 1.0, marks=pytest.mark.long),
        pytest.param("zoned", 10.0, marks=pytest.mark.long),
    ],
)
def test_incline_sticks(settle, body, time, phi):
    """Drift below 1e-6 m in 10 s, beyond the elastic shear displacement that settling brought."""
    sim, block = on_slope(body, phi, settle(body, phi))
    path = sim.history(block, "displacement", component="x", every=100)
    sim.run(time=time)
    assert np.abs(path.values).max() <= 1e-6


@pytest.mark.parametrize(("body", "phi"), angles(0.0, 10.0, 20.0, 29.0, 31.0, 40.0))
def test_incline_launched_up(settle, body, phi):
    """Launched up-slope at 3 m/s: s = v0^2 / (2 g (sin a + mu cos a)) to 0.1 %, then sticks iff phi > 30 degrees.

    The joint is damped: friction that sets in at once makes the block rock, and a block that rocks slips. It starts
    without shear, and friction is complete one step later: an error of order dt.
    """
    start = settle(body, 30.05, along=0.0)
    sim, block = on_slope(body, phi, start, velocity=(-3.0, 0.0, 0.0), damping=0.3, safety=SHARE[body])
    path = sim.history(block, "displacement", component="x")
    mu = np.tan(np.radians(phi))
    stop = 3.0 / (G * (np.sin(ANGLE) + mu * np.cos(ANGLE)))
    sim.run(time=stop + 0.3)
    top = -path.values.min()
    assert top == pytest.approx(1.5 * stop, rel=1e-3)
    assert path.time[np.argmin(path.values)] == pytest.approx(stop, rel=1e-3)
    back = path.values[-1] + top
    # turning from one side of the cone to the other frees elastic energy: a speed of order ks^-1/2
    elastic = 1000 * G * np.cos(ANGLE) * mu / KS
    kick = np.sqrt(4 * G * np.sin(ANGLE) * elastic)
    down = G * (np.sin(ANGLE) - mu * np.cos(ANGLE))
    if phi > 30:
        assert back <= 2 * (2 * elastic - 0.5 * kick**2 / down)
    else:
        exact = 0.5 * down * 0.3**2
        # 0.1 % as on the way up, where no friction can kick; the top is read at whole steps, hence 1 % below
        assert 0.99 * exact <= back <= 1.001 * exact + 1.2 * 0.3 * kick


def test_impact_at_the_automatic_step():
    """Cubes that fly freely and meet askew, frictionless: seen in time, energy kept to 1e-3, they part again."""
    rng = np.random.default_rng(1)
    for _ in range(4):
        scene, moves = fdem.Scene(gravity=(0, 0, 0)), []
        for x, speed in ((0.0, 1.0), (1.9, -1.0)):
            turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
            turn *= np.sign(np.linalg.det(turn))
            placed = np.eye(4)
            placed[:3, :3], placed[:3, 3] = turn, np.array([x, *rng.uniform(-0.3, 0.3, 2)]) - turn @ np.full(3, 0.5)
            cube = fdem.brick((0, 0, 0), (1, 1, 1)).transform(placed)
            moves.append(scene.add(cube, fdem.Rigid(), fdem.Elastic(density=2500), velocity=(speed, 0, 0)))
        scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=0))
        sim = fdem.Simulation(scene, fdem.Explicit())
        sim.run(time=1.0)
        assert sim.time == pytest.approx(1.0)
        assert sim[moves[0]].velocity[0] < sim[moves[1]].velocity[0]
        assert sim.energy.closure <= 1e-3


def stack(body, n=10):
    """Ten 1 m cubes of 2000 kg on a fixed base, kn = 1e9 Pa/m."""
    scene = fdem.Scene(gravity=(0, 0, -G))
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    material = fdem.Elastic(density=2000, young=1e10, poisson=0.0)
    cubes = []
    for i in range(n):
        lower, upper = (0, 0, i), (1, 1, i + 1)
        shape = box((2, 2, 2), upper, lower) if body == "zoned" else fdem.brick(lower, upper)
        cubes.append(scene.add(shape, KINDS[body], material, name=f"cube {i}"))
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
    return scene, cubes


@pytest.mark.parametrize("body", BODIES)
def test_stack_forces(body):
    """N_k = (n - k + 1) m g to 1e-4 at a ratio of 1e-5; closures, settlements, even shares.

    What is unbalanced adds up over the ten cubes: with zones, where it has one sign while they settle, half the ratio.
    """
    scene, cubes = stack(body)
    sim = fdem.Simulation(scene, fdem.Relaxation())
    # a ratio for each of ten blocks; that of 30 unknowns counts their internal forces as acting too
    shares = {"rigid": 1e-5, "linear": 3e-6}
    assert sim.solve(ratio=shares.get(body, 5e-6)).converged
    below = ["base", *cubes[:-1]]
    weights = 2000 * G * np.arange(10, 0, -1)
    forces = np.array([sim.pair_force(a, b) for a, b in zip(below, cubes, strict=True)])
    assert forces[:, 2] == pytest.approx(weights, rel=1e-4)
    assert np.abs(forces[:, :2]).max() <= 1e-4 * weights[0]
    closures = np.cumsum(weights) / 1e9
    if body == "rigid":
        # faces of equal size: the rim of the contact is nearer to the sides, which takes the order of closure / edge
        assert -sim[cubes].displacement[:, 2] == pytest.approx(closures, rel=5e-4)
        table = sim.contact_table()
        face = table["area"] > 0.1  # the rest are the rims
        for k in range(10):
            pressure = table["traction"][face & (table["block_b"] == k + 1), 0]
            assert np.ptp(pressure) <= 1e-6 * pressure.mean()  # symmetric, so even
    else:
        top = sim[cubes[-1]].gridpoint_displacement[sim[cubes[-1]].gridpoints[:, 2] > 9.9, 2]
        shortening = (weights - 0.5 * 2000 * G) / 1e10
        assert -top.mean() == pytest.approx(closures[-1] + shortening.sum(), rel=1e-3)


def sampled_modes(samples, dt):
    """Angular frequencies [rad/s] of free vibration sampled at equal times (n_times, n_modes).

    In every mode u(n+1) + u(n-1) = 2 cos(w dt) u(n), so the matrix that maps the right side to the left has
    2 cos(w dt) as its eigenvalues: as good as zero crossings, for many modes at once.
    """
    samples = samples - samples.mean(axis=0)
    matrix = np.linalg.lstsq(samples[1:-1], samples[2:] + samples[:-2], rcond=None)[0]
    return np.sort(np.arccos(0.5 * np.linalg.eigvals(matrix).real)) / dt


def test_stack_frequencies():
    """All ten vertical frequencies 2 sqrt(K/m) sin((2 j - 1) pi / 42), the first and the last to 0.5 %."""
    scene, cubes = stack("rigid")
    loads = [scene.apply(fdem.Force((0, 0, -100.0 * (1 + k % 3))), cube) for k, cube in enumerate(cubes)]
    settled = fdem.Simulation(scene, fdem.Relaxation())
    assert settled.solve(ratio=1e-10).converged
    exact = 2 * np.sqrt(1e9 / 2000) * np.sin((2 * np.arange(1, 11) - 1) * np.pi / 42)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fdem.FdemWarning)
        sim = fdem.Simulation(scene, fdem.Explicit(dt=0.1 / exact[-1]), start=settled)
    for load in loads:
        sim[load].factor = 0.0
    history = sim.history(lambda s: s[cubes].position[:, 2])
    sim.cycle(4000)
    rest = np.arange(10) + 0.5 - np.cumsum(2000 * G * np.arange(10, 0, -1)) / 1e9
    assert sampled_modes(np.array(history.values) - rest, sim.dt) == pytest.approx(exact, rel=5e-3)


@pytest.fixture(scope="module")
def on_joint():
    return block_on_joint()


def test_block_on_joint_modes(on_joint):
    """Six frequencies to 0.2 % at 0.05 of the critical step: those of the area-integrated joint."""
    vertical, twist, about_x, about_y = modes_of_block()
    sim = freed(on_joint, fdem.Explicit(dt=0.05 * 2 / about_x[1]))
    block = on_joint[1]
    rest = 0.5 * H - 0.1 * G * DENSITY * H / BLOCK_KN
    history = sim.history(lambda s: np.concatenate([s[block].position, s[block].rotation_vector]))
    sim.cycle(6000)
    u = np.array(history.values)
    u[:, 2] -= rest
    expected = {(2,): [vertical], (5,): [twist], (1, 3): about_x, (0, 4): about_y}
    for columns, exact in expected.items():
        assert sampled_modes(u[:, columns], sim.dt) == pytest.approx(exact, rel=2e-3), columns


@pytest.mark.parametrize("zeta", [0.0, 0.1, 1.0])
def test_automatic_step(on_joint, zeta):
    """The step chosen lies in [0.5, 1.0] of the critical one, stiffness-proportional damping included."""
    top = modes_of_block()[2][1]
    damping = fdem.Rayleigh(stiffness=2 * zeta / top) if zeta else None
    sim = freed(on_joint, fdem.Explicit(damping=damping))
    critical = 2 / top * (np.sqrt(1 + zeta**2) - zeta)
    assert 0.5 <= sim.dt / critical <= 1.0


@pytest.mark.parametrize("steps", [5_000, pytest.param(100_000, marks=pytest.mark.long)])
def test_step_limit_is_honest(on_joint, steps):
    """A step of 0.99 of 2 / omega_max stays bounded; 1.01 grows and raises."""
    top, block = modes_of_block()[2][1], on_joint[1]
    sim = freed(on_joint, fdem.Explicit(dt=0.99 * 2 / top))
    history = sim.history(lambda s: np.abs(s[block].rotation_vector[1]), every=10)
    sim.cycle(steps)
    # at the limit the fast mode swings visibly, but by no more than its share of the start allows
    assert history.values.max() < 1e-6
    sim = freed(on_joint, fdem.Explicit(dt=1.01 * 2 / top))
    with pytest.raises(fdem.UnstableError, match="block"):
        sim.cycle(20_000)


def test_rotation_vector_of_contact_dynamics():
    """A brick on one edge falls back: the turn read out is that of its faces, though the step has two halves."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-3, -1, -1), (3, 2, 0)), fdem.Rigid(), fixed=True)
    turn, angle = np.eye(4), 0.06
    turn[np.ix_([0, 2], [0, 2])] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    shape = fdem.brick((-0.5, 0, 0), (0, 1, 4)).transform(turn)
    block = scene.add(shape, fdem.Rigid(), fdem.Elastic(density=2500))
    scene.joint(fdem.Coulomb(friction=45))
    sim = fdem.Simulation(scene, fdem.ContactDynamics(dt=5e-3))
    sim.run(time=0.3)
    up = sim[block].gridpoints - sim[block].gridpoints[0]
    high = up[np.argmax(up[:, 2])]
    before = shape.points - shape.points[0]
    start = before[np.argmax(before[:, 2])]
    turned = np.arctan2(high[0], high[2]) - np.arctan2(start[0], start[2])
    assert turned < -0.005
    assert sim[block].rotation_vector[1] == pytest.approx(turned, rel=1e-9)
