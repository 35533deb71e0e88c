"""The scenes of `skip.py`: each with and without an item, and one that needs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from skipping_imports import Process, without_mesher

import fdem

ROCK = fdem.Elastic(2500.0, 1e9, 0.2)
STIFF = fdem.Elastic(2500.0, 1e13, 0.2)
SOFTER = fdem.Elastic(2500.0, 1e8, 0.2)
SLAB_STEP = 1.9e-5  # [s] about that of the slabs
STEP = 2e-5  # [s] stable for both, where what is added would shorten the step
Answer = tuple[Any, Any]


@dataclass
class Case:
    """One item: the scene with (True) and without it, the answer, and the answers of a scene that needs it."""

    item: str
    said: str
    tolerance: float
    scene: Callable[[bool], Any]
    answer: Callable[[Any], Any]
    matters: Callable[[], Answer]
    steps: int = 200


CASES: dict[str, Case] = {}


def enter(name: str, *args: Any, **given: Any) -> None:
    """Add a case."""
    CASES[name] = Case(*args, **given)


def compiled(scene: fdem.Scene, integrator: Any = None, **options: Any) -> fdem.Simulation:
    """Explicit by habit, without a ledger."""
    return fdem.Simulation(scene, integrator or fdem.Explicit(), progress=False, **({"energy": False} | options))


def bricks(
    courses: int = 5, body: Any = None, joint: Any = None, material: Any = ROCK, extra: Any = None
) -> fdem.Scene:
    """A wall of bricks in bond on a base; `extra` adds to the scene."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (5, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    scene.add(fdem.wall(4.0, 0.2 * courses, 0.2, (0.4, 0.2, 0.2)), body or fdem.Rigid(), material, group="wall")
    scene.joint(joint or fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
    if extra is not None:
        extra(scene)
    return scene


def wall_of(sim: fdem.Simulation) -> np.ndarray:
    """Displacements of the wall."""
    return sim["wall"].displacement


def one(body: Any, shape: Any = None, joint: Any = None, **given: Any) -> tuple[fdem.Scene, Any]:
    """One block on a base."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-2, -2, -1), (3, 3, 0)), fdem.Rigid(), fixed=True, name="base")
    block = scene.add(shape or fdem.brick((0, 0, 0), (1, 1, 1)), body, ROCK, name="block", **given)
    scene.joint(joint or fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
    return scene, block


def after(sim: fdem.Simulation, steps: int, what: str = "displacement") -> np.ndarray:
    """A property of the block after so many steps."""
    sim.cycle(steps)
    return getattr(sim["block"], what)


# formulations


def strangers(scene: fdem.Scene) -> None:
    """One block of every kind that deforms, and a sphere, where nothing else is."""
    bodies = (fdem.UniformStrain(), fdem.LinearStrain(), fdem.Zoned())
    for k, body in enumerate(bodies):
        scene.add(fdem.brick((2 * k, 8, 0), (2 * k + 1, 9, 1)), body, ROCK)
    scene.add(fdem.sphere(0.5, (7, 8.5, 0.5)), fdem.Rigid(), ROCK)


def bent() -> Answer:
    """A soft block under its weight as zones, and taken as rigid."""
    return tuple(after(compiled(one(body)[0]), 400) for body in (fdem.Zoned(), fdem.Rigid()))


enter(
    "formulations", "formulations not in the scene", "zoned", 1e-9,
    lambda needed: compiled(bricks(extra=strangers if needed else None), fdem.Explicit(dt=STEP)), wall_of, bent,
)  # fmt: skip

# laws


def other_joint(scene: fdem.Scene) -> None:
    """A row of blocks elsewhere that touch and have another law."""
    for k in range(20):
        scene.add(fdem.brick((k, 8, 0), (k + 1, 9, 1)), fdem.Rigid(), ROCK, group="others")
    law = fdem.BartonBandis(kn=1e9, ks=5e8, max_closure=1e-3, jrc=8.0, jcs=5e7, residual_friction=25.0)
    scene.joint(law, "others")


def stiffening() -> Answer:
    """A joint that stiffens, and the plain one in its place."""
    law = fdem.BartonBandis(kn=1e9, ks=5e8, max_closure=1e-4, jrc=8.0, jcs=5e7, residual_friction=25.0)
    return tuple(after(compiled(one(fdem.Rigid(), joint=joint)[0]), 300) for joint in (law, None))


def switched(name: str, on: bool, sim: fdem.Simulation) -> fdem.Simulation:
    """Switch a trait of all laws on or off by force."""
    contacts = sim.system.contacts
    for law in contacts.laws:
        setattr(law, name, on)
    contacts._prepare()
    sim.system.current = False
    return sim


def landing(forced: bool) -> Any:
    """A block that drops on a damped joint."""
    scene, _ = one(
        fdem.Rigid(), fdem.brick((0, 0, 0.001), (1, 1, 1.001)), fdem.Coulomb(kn=1e9, ks=5e8, friction=30, damping=0.3)
    )
    sim = compiled(scene)
    return after(switched("damped", False, sim) if forced else sim, 600)


def rolling(arm: float) -> Any:
    """A facetted ball on a slope."""
    scene = fdem.Scene(gravity=(3.0, 0, -9.0))
    scene.add(fdem.brick((-2, -2, -1), (9, 3, 0)), fdem.Rigid(), fixed=True, name="base")
    ball = fdem.icosphere(0.5, (0, 0, 0.5), subdivisions=2)
    scene.add(ball, fdem.Rigid(), ROCK, name="block")
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=40, rolling=arm))
    return after(compiled(scene), 3000)


enter(
    "laws", "laws not in the scene", "contact moments: left out", 1e-9,
    lambda needed: compiled(bricks(extra=other_joint if needed else None), fdem.Explicit(dt=STEP)), wall_of,
    stiffening,
)  # fmt: skip
enter(
    "damping", "contact damping", "contact damping: left out", 0.0,
    lambda needed: switched("damped", needed, compiled(bricks())), wall_of, lambda: (landing(False), landing(True)),
)  # fmt: skip
enter(
    "moments", "contact moments", "contact moments: left out", 1e-9,
    lambda needed: compiled(
        bricks(joint=fdem.Coulomb(kn=1e9, ks=5e8, friction=30, rolling=1e-15 * needed)), fdem.Explicit(dt=STEP)
    ), wall_of, lambda: (rolling(0.3), rolling(0.0)),
)  # fmt: skip

# terms


def no_load(scene: fdem.Scene) -> None:
    """A load of nothing."""
    scene.apply(fdem.Force((0.0, 0.0, 0.0)), "wall")


def pushed(forced: bool) -> Any:
    """A block pushed up to 0.4 of its weight, with or without the push."""
    scene, block = one(fdem.Rigid())
    scene.apply(fdem.Force((1e4, 0, 0)), block, factor=0.0 if forced else 1.0)
    return after(compiled(scene), 300)


def straining(needed: bool) -> fdem.Simulation:
    """A wall of blocks so stiff that their strain does not matter."""
    body = fdem.LinearStrain() if needed else fdem.Rigid()
    return compiled(bricks(body=body, material=STIFF), fdem.Explicit(dt=2e-7))


def squeezed(forced: bool) -> Any:
    """The strain of a block on a base, with or without its internal forces."""
    sim = compiled(one(fdem.UniformStrain())[0])
    if forced:
        system = sim.system
        system._terms = tuple(
            t for t in system._terms if getattr(getattr(t, "func", None), "__name__", "") != "internal"
        )
    return after(sim, 300, "strain")


enter(
    "loads", "loads", "loads: left out", 0.0,
    lambda needed: compiled(bricks(extra=no_load if needed else None)), wall_of,
    lambda: (pushed(False), pushed(True)),
)  # fmt: skip
enter(
    # the joints are softer than the blocks by 2e-5
    "internal", "strain and internal forces", "strain and internal forces: left out", 1e-3, straining, wall_of,
    lambda: (squeezed(False), squeezed(True)),
)  # fmt: skip

# detection


def detecting(always: bool) -> fdem.Simulation:
    """A wall at rest; its contacts found anew in every step or not."""
    scene = bricks(joint=fdem.Coulomb(kn=1e12, ks=5e11, friction=30))
    start = compiled(scene, fdem.Relaxation())
    start.solve(ratio=1e-9)
    sim = compiled(scene, start=start)
    sim.system.contacts.clip_always = always
    return sim


def sliding(forced: bool) -> Any:
    """A smooth box that slides half over the edge of its base: what carries it."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-2, -2, -1), (1, 3, 0)), fdem.Rigid(), fixed=True, name="base")
    scene.add(fdem.brick((0, 0, 0), (1, 1, 0.3)), fdem.Rigid(), ROCK, name="block", velocity=(2.0, 0, 0))
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=0))
    sim = compiled(scene)
    if forced:
        sim.system.contacts.update = lambda x: False
    sim.run(time=0.35)
    return sim["block"].rotation_vector


enter(
    # the rim of a patch cut anew, as wide as the closure, is 1e-6 of it
    "detection", "detection where nothing moves", "detection: left out of steps", 1e-5, detecting,
    lambda sim: sim["wall"].contact_force, lambda: (sliding(False), sliding(True)), steps=20,
)  # fmt: skip

# results


def recorded(needed: bool) -> fdem.Simulation:
    """A history of all the wall."""
    sim = compiled(bricks())
    if needed:
        sim.history("wall", "displacement", every=1)
    return sim


def bounced(forced: bool) -> Any:
    """Deepest place of a block that bounces: of its history, or of what is left at the end."""
    sim = compiled(one(fdem.Rigid())[0])
    history = sim.history("block", "displacement", component="z", every=1)
    sim.cycle(290)
    return sim["block"].displacement[2] if forced else history.values.min()


def stresses(needed: bool) -> fdem.Simulation:
    """Zones, with their stresses computed in every step or when asked for."""
    sim = compiled(one(fdem.Zoned(size=0.2))[0])
    if needed:
        step = sim._step
        sim._step = lambda dt: (sim.zone_stresses(), step(dt))
    return sim


def closure(energy: bool) -> Any:
    """Energy turned over by a block that falls; None without a ledger."""
    sim = compiled(one(fdem.Rigid())[0], energy=energy)
    sim.cycle(200)
    try:
        return sim.energy.work + sim.energy.joint
    except fdem.FdemError:
        return None


def fallen(forced: bool) -> Any:
    """Stress of a zoned block under its weight; read, or the zeros of the start."""
    sim = compiled(one(fdem.Zoned(size=0.5))[0])
    before = sim["block"].stress
    sim.cycle(300)
    return before if forced else sim["block"].stress


enter(
    "history",
    "histories",
    "histories and frames: left out",
    0.0,
    recorded,
    wall_of,
    lambda: (bounced(False), bounced(True)),
)
enter(
    "energy", "energy ledger", "energy ledger: left out", 0.0,
    lambda needed: compiled(bricks(), energy=needed), wall_of,
    lambda: (closure(True), closure(False)),
)  # fmt: skip
enter(
    "stress", "stress recovery", "stress recovery: left out of steps", 0.0, stresses, lambda sim: sim.positions(),
    lambda: (fallen(False), fallen(True)),
)  # fmt: skip

# orientation of spheres


def balls(oriented: bool, companion: bool = False) -> fdem.Simulation:
    """Fifty spheres that fall on a base; as clumps of one ball they keep an orientation."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (11, 6, 0)), fdem.Rigid(), fixed=True)
    for i, j in np.ndindex(10, 5):
        centre = (i + 0.5, j + 0.5, 0.5)
        parts = [(centre, 0.45)] + ([((i + 0.7, j + 0.5, 0.5), 0.3)] if companion else [])
        shape = fdem.clump(parts) if oriented else fdem.sphere(0.45, centre)
        scene.add(shape, fdem.Rigid(), ROCK, group="balls", angular_velocity=(0.0, 5.0, 0.0), velocity=(0.3, 0.1, 0))
    scene.joint(fdem.Coulomb(kn=1e8, ks=5e7, friction=30))
    return compiled(scene, fdem.Explicit(dt=1e-4))


def lopsided() -> Answer:
    """Clumps of two balls, and the larger one alone."""
    runs = balls(True, companion=True), balls(False)
    for sim in runs:
        sim.cycle(3000)
    return tuple(sim["balls"].velocity for sim in runs)


enter(
    "orientation", "orientation of spheres", "no orientation is kept", 1e-9, balls, lambda sim: sim["balls"].position,
    lopsided,
)  # fmt: skip

# sleeping


def resting(awake: bool) -> fdem.Simulation:
    """A wall at rest, with local damping; asleep after some steps, or not."""
    scene = bricks(courses=10)
    start = compiled(scene, fdem.Relaxation())
    start.solve(ratio=1e-9)
    sleep = {} if awake else {"sleep": fdem.Sleep(steps=100)}
    sim = compiled(scene, fdem.Explicit(damping=fdem.Local(0.5), **sleep), start=start)
    sim.cycle(300)
    return sim


def hit(forced: bool) -> Any:
    """A block at rest that is hit by another one; left out of all steps it stays."""
    scene, _ = one(fdem.Rigid(), fixed=forced)
    scene.add(fdem.brick((-1.2, 0, 0.3), (-0.2, 1, 1.3)), fdem.Rigid(), ROCK, velocity=(3.0, 0, 0))
    sim = compiled(scene, fdem.Explicit(damping=fdem.Local(0.1), sleep=fdem.Sleep()))
    sim.run(time=0.15)
    return sim["block"].displacement


enter(
    "sleeping", "blocks at rest (sleep)", "sleeping:", 1e-6, resting, lambda sim: sim["wall"].contact_force,
    lambda: (hit(False), hit(True)),
)  # fmt: skip

# sub-steps


class Timed:
    """A simulation with or without sub-steps, which cycles over equal times."""

    def __init__(self, every: bool) -> None:
        self.sim = compiled(slabs(), fdem.Explicit(substeps=1 if every else 16))

    def cycle(self, steps: int) -> None:
        """Run for as long as `steps` steps with sub-steps take."""
        self.sim.run(steps * 16 * SLAB_STEP)

    def describe(self) -> str:
        """Of the simulation."""
        return self.sim.describe()


def slabs() -> fdem.Scene:
    """Thin slabs between blocks, on a base: the blocks' stable step is 16 times that of the slabs."""
    scene, _ = one(fdem.Zoned(), fdem.brick((0, 0, 0), (1, 1, 0.05)))
    for k in range(4):
        low = 0.05 + 1.0 * k
        scene.add(fdem.brick((0, 0, low), (1, 1, low + 1.0)), fdem.Zoned(size=0.3), SOFTER, group="pillar")
    return scene


def beyond(forced: bool) -> Any:
    """How far the pillar has gone after a while; with blocks left out of more steps than their stable step allows."""
    sim = compiled(slabs(), fdem.Explicit(substeps=16))
    if forced:
        rates = sim.integrator.rates
        rates.take(rates.level + 2 * (rates.level > 0))
        sim.integrator.step_length *= 4
        rates.choose = lambda *limits: None
    try:
        sim.run(0.02)
    except fdem.FdemError:
        return None
    return sim["pillar"].displacement


enter(
    # second order in the step of the slow blocks
    "substeps", "forces of slow blocks in every step", "sub-steps:", 1e-2, Timed,
    lambda run: run.sim["pillar"].displacement, lambda: (beyond(False), beyond(True)), steps=20,
)  # fmt: skip

# imports

enter(
    "imports", "imports of gmsh, scikit-fem, pyvista", "gmsh and scikit-fem are not imported", 0.0, Process,
    lambda process: process.position, without_mesher, steps=1,
)  # fmt: skip
