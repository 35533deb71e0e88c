"""The measurements and pictures of docs/contact.md: run by `make docs`.

    python tools/contact_study.py [folder for the pictures]

Works on bare polyhedra with the rigid-body world of tests/contact_tools.py, so that every choice of the contact layer
can be varied: pruning, cutting interval, slave and master, stiff corners.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from contact_tools import Flight, World, box, coulomb, grid_box, move, rotation  # noqa: E402

import fdem  # noqa: E402
from fdem.contact import contacts as contacts_module  # noqa: E402
from fdem.contact import narrow  # noqa: E402
from fdem.contact.laws import LawTable  # noqa: E402

KN = 1e9
CORNER = rotation([1, -1, 0], np.arctan(np.sqrt(2)))
EDGE = rotation([1, 0, 0], np.pi / 4)


@contextmanager
def replaced(thing: Any, name: str, value: Any) -> Iterator[None]:
    """`thing.name` is `value` inside."""
    before = getattr(thing, name)
    setattr(thing, name, value)
    yield
    setattr(thing, name, before)


def on_floor(shape: tuple[Any, Any], depth: float, turn: Any, **options: Any) -> World:
    """A turned shape, its lowest point `depth` below the top of a wide floor."""
    points, faces = move(shape, turn)
    points = points + np.array([0.03, 0.02, 0.5 - depth - points[:, 2].min()])
    return World([(points, faces), box(4, 4, 1)], **options)


def impact(seed: int, share: float = 0.1, law: LawTable | None = None, **options: Any) -> tuple[float, int]:
    """Relative change of energy in a random impact of two cubes, and how often pairs were cut."""
    g = np.random.default_rng(seed)
    a, b = (move(box(1, 1, 1), rotation(g.normal(size=3), g.uniform(0, 3)), (0, 0, z)) for z in (0, 1.75))
    w = World([a, b], law=law or coulomb(kn=KN), **options)
    flight = Flight(w, [[0, 0, 1.0], [0, 0, -1.0]], [g.normal(size=3) * 0.5 for _ in range(2)])
    e0 = flight.kinetic()
    dt = share * np.sqrt(flight.m[0] / 2 / KN)
    hit, apart = False, 0
    while apart <= 20:
        w.forces(dt)
        closed = w.contacts.n_patches > 0 and bool((w.contacts._area > 0).any())
        hit |= closed
        apart = apart + 1 if hit and not closed else 0
        flight.step(dt if w.contacts.n_patches else 0.5 / share * dt)
    return abs(flight.kinetic() / e0 - 1.0), w.contacts.n_cuts


def pruning(seeds: range = range(12)) -> None:
    """What patches left out cost in energy, and what they save in rows."""
    rows = {}
    for prune in (0.0, 1e-4, 1e-3):
        resting = World([move(box(1, 1, 1), t=(0, 0, 1 - 1e-4)), box(4, 4, 1)], prune=prune)
        rows[prune] = 3 * resting.contacts.n_patches
    for always in (True, False):
        for prune in (0.0, 1e-4, 1e-3):
            errors = [impact(s, prune=prune, clip_always=always)[0] for s in seeds]
            when = "every step" if always else "when due"
            print(f"| {prune:g} | {when} | {np.median(errors):.1e} | {max(errors):.1e} | {rows[prune]} |")


def cutting(seeds: range = range(6)) -> None:
    """Interval of the cuts: travel before a pair is cut anew, in square roots of its largest patch."""
    for travel in (1e-4, 1e-3, 1e-2):
        with replaced(narrow, "TRAVEL", travel):
            results = [impact(s, prune=1e-4) for s in seeds]
            floor = grid_box(8, 8, size=(4.0, 4.0, 1.0))
            w = World(
                [move(box(1, 1, 1), t=(1.3, 1.4, 1.5 - 1e-4)), floor], law=coulomb(tan=0.5), affine=[True, False],
                fixed=[False, True], prune=1e-4,
            )  # fmt: skip
            w.forces()
            w.commit()
            n0, noise, friction, cuts = w.resultant(0)[0][2], [], [], w.contacts.n_cuts
            for _ in range(1500):
                w.shift(0, [3e-4, 1e-4, 0])
                w.contacts.update(w.x)
                w.forces(1e-4)
                w.commit()
                f = w.resultant(0)[0]
                noise.append(abs(f[2] / n0 - 1))
                friction.append(np.hypot(*f[:2]) / (0.5 * f[2]))
        print(
            f"| {travel:g} | {max(r[0] for r in results):.1e} | {np.median([r[1] for r in results]):.0f} | "
            f"{max(noise):.1e} | {min(friction[200:]):.4f} | {w.contacts.n_cuts - cuts} |"
        )


def roles() -> None:
    """Stiffness of a corner by who is the slave."""

    def forced(first: int) -> Any:
        return lambda s, p: (p[:, first].copy(), p[:, 1 - first].copy())

    h = 0.03
    for name, turn in (("corner", CORNER), ("edge", EDGE)):
        forces = []
        for first in (0, 1):
            with replaced(contacts_module, "master_first", forced(first)):
                forces.append(on_floor(box(1, 1, 1), h, turn, law=coulomb(kn=KN)).forces()[:8].sum(axis=0)[2])
        print(f"| {name} | {forces[0]:.4g} N | {forces[1]:.4g} N | {forces[1] / forces[0]:.3f} |")


def master_rows() -> None:
    """Moment that three gridpoints of the master would leave out, against the moment arm of the force."""
    for angle in (0.0, 1.0, 5.0, 20.0, 45.0):
        w = on_floor(box(1, 1, 1), 0.02, rotation([1, 0.3, 0], np.radians(angle)), law=coulomb(kn=KN))
        f = w.forces()
        balance = np.abs(np.cross(w.x, f).sum(axis=0)).max()
        c = w.contacts
        p = c.patches
        # the fourth gridpoint's share lies across the face; without it the point of attack is lifted to the face
        depth = -c._gap.reshape(-1, 3)
        force = (c._area * c._traction[:, 0]).reshape(-1, 3)
        tilt = np.linalg.norm(np.cross(c._push, c._face_normal), axis=1)
        defect = float((force * depth * tilt[:, None] * (c._active[:, None] > 0)).sum())
        total = np.linalg.norm(w.resultant(0)[0])
        print(f"| {angle:g} | {balance / total:.0e} m | {defect / total:.1e} m | {len(p)} |")


def corners() -> None:
    """How deep a cube of 25 kN stands in a face."""
    for name, turn in (("corner", CORNER), ("edge", EDGE), ("face", np.eye(3))):
        depths = []
        for size in (0.0, 0.05, 0.1):
            law = coulomb(kn=1e10)
            law = LawTable("coulomb", law.props, corner=np.array([size**2]))
            low, high = 1e-9, 0.2
            for _ in range(50):
                middle = np.sqrt(low * high)
                force = on_floor(box(1, 1, 1), middle, turn, law=law).forces()[:8].sum(axis=0)[2]
                low, high = (middle, high) if force < 25e3 else (low, middle)
            depths.append(1e3 * low)
        print(f"| {name} | " + " | ".join(f"{d:.3g} mm" for d in depths) + " |")


def default_stiffness() -> None:
    """Closure that the chosen stiffness leads to, and what contact does to the step."""
    stone = fdem.Elastic(2400.0, 10e9, 0.2)
    for name, shapes, body in (
        ("wall of 60 rigid bricks", fdem.wall(2.4, 2.0, 0.2, (0.4, 0.2, 0.2)), fdem.Rigid()),
        ("arch of 15 rigid voussoirs", fdem.arch(10, 5, 1.2, 1, 15), fdem.Rigid()),
        ("arch of 15 zoned voussoirs", fdem.arch(10, 5, 1.2, 1, 15), fdem.Zoned(size=0.6)),
    ):
        scene = fdem.Scene()
        blocks = scene.add(shapes, body, stone)
        low = min(b.shape.bounds[0][2] for b in blocks)
        if "wall" in name:
            scene.add(fdem.brick((-2, -2, -0.5), (5, 2, low)), fdem.Rigid(), fixed=True, name="slab")
        else:
            scene.fix([blocks[0], blocks[-1]])
        scene.joint(fdem.Coulomb(friction=35))
        sim = fdem.Simulation(scene, fdem.Relaxation())
        report = sim.solve(ratio=1e-5)
        table = sim.contact_table()
        closure = -table["gap"][table["area"] > 0].min() / min(np.cbrt(b.shape.volume) for b in blocks)
        with_ = fdem.Simulation(scene, fdem.Explicit()).dt
        kn = next(line for line in sim.describe().splitlines() if "kn =" in line).split("kn = ")[1].split(" ")[0]
        print(f"| {name} | {kn} | {closure:.1e} | {with_:.2e} s | {report.cycles} |")


def main(folder: Path) -> None:
    """Print all tables, draw all pictures."""
    warnings.simplefilter("ignore", fdem.FdemWarning)
    print("\n| prune | cut | median energy error | largest | rows of a resting cube |\n|---|---|---|---|---|")
    pruning()
    print(
        "\n| travel | energy error | cuts per impact | N noise | friction / mu N | cuts, sliding |\n" + 6 * "|---" + "|"
    )
    cutting()
    print("\n| slave has | as slave | as master | ratio |\n|---|---|---|---|")
    roles()
    print("\n| tilt [deg] | moment error, 7 gridpoints | with 6 | patches |\n|---|---|---|---|")
    master_rows()
    print("\n| stands on | no stiff corners | 5 cm | 10 cm |\n|---|---|---|---|")
    corners()
    print("\n| scene | kn chosen [Pa/m] | largest closure / L | step | cycles |\n|---|---|---|---|---|")
    default_stiffness()


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs")
