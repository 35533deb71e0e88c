"""A tunnel through a jointed rock mass, excavated in two stages.

    python examples/demo.py [--seed N] [--size METRES] [--out FOLDER]

A cube of 20 m with three joint sets is cut by the tunnel's heading and bench. Blocks near the
tunnel are deformable, those far from it rigid; the outer ones slide on the planes of the model's
boundary. In-situ stress, then the heading is excavated, then the bench; each stage is relaxed to
equilibrium.

The joint sets are those of the example in E. Hoek, Practical Rock Engineering, chapter
"Structurally controlled instability in tunnels": J1 70/036, J2 85/144, J3 55/262 (mean dip / dip
direction), for a tunnel that trends 025. Here the tunnel runs along +y (north), so 25 degrees are
taken off every dip direction. Spacing, persistence, strength and stress are this script's own.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path

import numpy as np

import fdem
from fdem.results.plot import history_plot

HALF = 10.0  # half the edge of the cube [m]
TREND = 25.0  # of the tunnel in the source [deg]
DEPTH = 400.0  # of the tunnel's axis [m]
UNIT_WEIGHT = 26.5e3  # [N/m^3]
GRANITE = fdem.Elastic(density=UNIT_WEIGHT / 9.81, young=20e9, poisson=0.25)
RADIUS = 2.5  # of the crown [m]
SLIVER = 1e-3  # chips smaller than this are taken out before the start [m^3]


def tunnel() -> dict[str, fdem.Polyhedron]:
    """Heading (above the springline) and bench (below it), through the whole cube along y."""
    arc = np.linspace(0.0, np.pi, 9)
    heading = np.column_stack([RADIUS * np.cos(arc), RADIUS * np.sin(arc)])
    bench = np.array([(-RADIUS, -2.0), (RADIUS, -2.0), (RADIUS, 0.0), (-RADIUS, 0.0)])
    shift = np.eye(4)
    shift[1, 3] = -1.2 * HALF
    return {
        "heading": fdem.prism(heading, 2.4 * HALF, axis="y").transform(shift),
        "bench": fdem.prism(bench, 2.4 * HALF, axis="y").transform(shift),
    }


def rock_mass(seed: int, size: float) -> fdem.Scene:
    """The jointed cube with its boundary, joints and in-situ stress."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-HALF,) * 3, (HALF,) * 3), fdem.Rigid(), GRANITE, group="rock")
    origins = np.random.default_rng(seed).uniform(-1.5, 1.5, (3, 3))
    sets = {"J1": (70, 36, 3.5, 1.0), "J2": (85, 144, 4.0, 0.9), "J3": (55, 262, 3.5, 0.8)}
    for (name, (dip, direction, spacing, persistence)), origin in zip(sets.items(), origins, strict=True):
        scene.cut(fdem.JointSet(dip, direction - TREND, spacing, origin, persistence, seed=seed, name=name))
    for name, shape in tunnel().items():
        scene.cut(shape, name=name)
    for block in scene.blocks:
        if np.linalg.norm(block.shape.points[:, [0, 2]], axis=1).min() < 2.0 * RADIUS:
            block.body = fdem.Zoned(size=size)
    for axis in range(3):  # nothing but the model's boundary holds the outer faces, so rigid blocks must not turn there
        scene.fix(component=("xyz"[axis], "rotation"), where=lambda x, k=axis: np.abs(np.abs(x[:, k]) - HALF) < 1e-6)
    scene.joint(fdem.Coulomb(kn=10e9, ks=4e9, friction=32))
    scene.joint(fdem.Coulomb(kn=10e9, ks=4e9, friction=20), "J3")
    for name in ("heading", "bench"):
        scene.joint(fdem.Bonded(kn=40e9, ks=20e9), name)
    scene.apply(fdem.Stress(zz=lambda x: -UNIT_WEIGHT * (DEPTH - x[:, 2]), k=(1.3, 0.8)))
    return scene


def excavate(scene: fdem.Scene, verbose: bool) -> tuple[fdem.Simulation, dict[str, float], list[fdem.History]]:
    """Relax, excavate in two stages, relax; the numbers worth printing."""
    sim = fdem.Simulation(scene, fdem.Relaxation(damping=fdem.Adaptive()))
    chips = [block for block in scene.blocks if block.shape.volume < SLIVER]
    if chips:
        sim.excavate(chips)
    initial = sim.solve(ratio=1e-5)
    sim.reset("displacement")
    sim.reset("slip")
    crown = sim.history(scene.gridpoint((0, 0, RADIUS), "rock"), "displacement", component="z", every=25)
    wall = sim.history(scene.gridpoint((RADIUS, 0, 0), "rock"), "displacement", component="x", every=25)
    crown.name, wall.name = "crown, vertical", "wall, horizontal"
    if verbose:
        print(sim.describe())
        print(f"{len(chips)} chips of less than {SLIVER:g} m^3 were taken out")
        start = f"ratio {initial.start_ratio:.1e} -> {initial.ratio:.1e}"
        print(f"in situ: {initial.reason}, {start}, {initial.cycles} cycles")
    for stage in ("heading", "bench"):
        sim.excavate(stage, over=300)
        report = sim.solve(ratio=1e-5, max_cycles=60_000)
        if verbose:
            print(
                f"{stage}: {report.reason}, ratio {report.ratio:.1e}, {report.cycles} cycles, {report.wall_time:.1f} s"
            )
    table = sim.contact_table()
    moved = np.linalg.norm(sim["rock"].displacement, axis=1)
    numbers = {
        "crown displacement [mm]": 1e3 * float(crown.values[-1]),
        "wall displacement [mm]": 1e3 * float(wall.values[-1]),
        "largest block movement [mm]": 1e3 * float(moved.max()),
        "largest joint slip [mm]": 1e3 * float(table["slip"].max()),
        "blocks slipping more than 1 mm": float(
            len(set(table["block_a"][table["slip"] > 1e-3]) | set(table["block_b"][table["slip"] > 1e-3]))
        ),
        "solve ratio": sim.ratio,
        "energy closure": sim.energy.closure,
    }
    return sim, numbers, [crown, wall]


def main(seed: int = 4, size: float = 1.6, out: Path = Path("out"), verbose: bool = True) -> dict[str, float]:
    """Run the demo; return its numbers."""
    begin = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fdem.FdemWarning)
        scene = rock_mass(seed, size)
        built = time.perf_counter()
        sim, numbers, histories = excavate(scene, verbose)
    solved = time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    opened = ((0.0, -1.0, 0.0), (0.0, -2.0, 0.0))
    sim.plot(out / "demo_joint_sets.png", scalars="joint", warp=0.0, title="Rock mass by joint set")
    sim.plot(out / "demo_displacement.png", clip=opened, warp=0.0, title="Displacement around the opening")
    sim.plot(out / "demo_slip.png", scalars="slip", warp=0.0, title="Joint slip around the opening")
    history_plot(histories, out / "demo_history.png", against="steps", title="Convergence of the opening")
    if verbose:
        n_zoned = int(sim.model.zoned.sum())
        print(
            f"{sim.model.n_blocks} blocks left ({n_zoned} zoned), {len(sim.model.zones)} zones, "
            f"{len(sim.contact_table()['gap'])} contact points, {sim.steps} steps"
        )
        for name, value in numbers.items():
            print(f"{name:34s} {value:12.4g}")
        drawn = time.perf_counter()
        print(
            f"wall time: cutting {built - begin:.1f} s, solving {solved - built:.1f} s, pictures {drawn - solved:.1f} s"
        )
        print(f"pictures in {out}/: demo_joint_sets, demo_displacement, demo_slip, demo_history")
    return numbers


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--size", type=float, default=1.6)
    parser.add_argument("--out", type=Path, default=Path("out"))
    main(**vars(parser.parse_args()))
