"""Cost of contact: patches, clip, broad phase, and a wall of rigid bricks against Yade; one thread.

    python benchmarks/contact.py [--quick]

Every figure is the median of at least three repeats with its range; what is compared runs in turn. Yade is used if
the command `yade` is there (Debian package of that name).
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

import fdem
from fdem.contact.history import known_offsets
from fdem.contact.narrow import cut_pairs
from fdem.kernels import clipping, footprints, geometry
from fdem.kernels import patches as kernels
from fdem.kernels.broad import box_pairs

REPEATS = 5
BRICK, DENSITY, KN, FRICTION = (0.4, 0.2, 0.2), 2000.0, 1e10, 0.6
HERE = Path(__file__).parent


def seconds(*functions: Callable[[], object], repeats: int = REPEATS) -> list[np.ndarray]:
    """Seconds of every function, called in turn `repeats` times after one call to warm up."""
    for function in functions:
        function()
    times = np.zeros((len(functions), repeats))
    for repeat in range(repeats):
        for k, function in enumerate(functions):
            start = time.perf_counter()
            function()
            times[k, repeat] = time.perf_counter() - start
    return list(times)


def spread(values: np.ndarray, scale: float, unit: str) -> str:
    """Median and range as text."""
    v = np.asarray(values) * scale
    return f"{np.median(v):.0f} {unit} ({v.min():.0f} .. {v.max():.0f})"


def wall(width: int, height: int) -> fdem.Scene:
    """Running bond on a fixed slab, exactly touching."""
    scene = fdem.Scene()
    a, b, c = BRICK
    scene.add(fdem.brick((-1, -1, -0.5), (width * a + 1, 1, 0)), fdem.Rigid(), fixed=True, name="slab")
    for k in range(height):
        for i in range(width):
            x = (i + 0.5 * (k % 2)) * a
            scene.add(fdem.brick((x, -b / 2, k * c), (x + a, b / 2, (k + 1) * c)), fdem.Rigid(), fdem.Elastic(DENSITY))
    scene.joint(fdem.Coulomb(kn=KN, ks=0.5 * KN, friction=float(np.degrees(np.arctan(FRICTION)))))
    return scene


def rows() -> None:
    """Three contact points per resting face; cost of a patch, closed and partly open."""
    sim = fdem.Simulation(wall(25, 20), fdem.Relaxation(), energy=False, progress=False)
    sim.solve(ratio=1e-4)
    contacts, x = sim.system.contacts, sim.state.x
    p = contacts.patches
    facing = (p.flags & kernels.FACING) > 0
    pairs = len(np.unique(p.pair[facing]))
    print(f"wall 25 x 20: {int(facing.sum())} patches facing each other in {pairs} pairs, three points each")
    arguments = list(contacts._close_arguments)
    whole, half = list(arguments), list(arguments)
    whole[3] = np.full_like(p.offset, -1e-5)
    half[3] = p.offset.copy()
    low = np.zeros((len(p), 3))
    points, sizes, centre = np.zeros_like(p.ref_points), np.zeros((5, len(p))), np.zeros((len(p), 3))
    footprints.measure(p.gp, p.start, p.corners, p.offset, x, points, *sizes, low, centre)
    half[3][:] = low - 1e-5 * np.array([1.0, 0.2, -1.0])  # zero depth runs through every patch

    def project(chosen: list[np.ndarray]) -> Callable[[], None]:
        def run() -> None:
            for _ in range(20):
                footprints.close_patches(
                    *chosen, x, p.active_old, p.memory_old, contacts._points, contacts._active, *contacts._closed
                )
                kernels.fill_rows(
                    p.gp, p.pair, contacts._cluster, contacts._thick, x, sim.state.x_old, contacts._points,
                    contacts._active, *contacts._rows,
                )  # fmt: skip

        return run

    for name, chosen in (("fully closed", whole), ("partly open", half)):
        times = seconds(project(chosen))[0] / 20
        share = contacts._active.mean()
        print(f"  {name}: re-projection, closing, three points, rows {spread(times / len(p), 1e9, 'ns')} per patch, "
              f"{share:.0%} of patches carrying")  # fmt: skip


def jointed(body: object, edge: float) -> fdem.Scene:
    """A cube cut by three joint sets of 1 m spacing."""
    scene = fdem.Scene()
    scene.add(fdem.brick((0, 0, 0), (edge,) * 3), body, fdem.Elastic(2500.0, 1e10, 0.2), group="rock")
    for dip, direction in ((70, 10), (80, 120), (10, 230)):
        scene.cut(fdem.JointSet(dip=dip, dip_direction=direction, spacing=1.0))
    scene.joint(fdem.Coulomb(kn=1e10, ks=5e9, friction=30))
    return scene


def clip(name: str, body: object, edge: float) -> None:
    """Cost of the clip per candidate pair of faces, and of a whole cut per patch."""
    sim = fdem.Simulation(jointed(body, edge), fdem.Relaxation(), energy=False, progress=False)
    c = sim.system.contacts
    s, g, x = c.surfaces, c._geometry, sim.state.x
    which = np.arange(len(c.pairs), dtype=np.int32)
    size = np.minimum(s.size[c.slave], s.size[c.master])
    near = geometry.face_pairs(
        c.slave, c.master, c._window, size, s.face_start, s.corner_start, s.limit, s.deep, s.convex, g.corner_x,
        g.normal, g.lower, g.upper, g.block_lower, g.block_upper, g.lean, g.tree,
    )  # fmt: skip
    most, corners = np.minimum(s.most[c.slave], s.most[c.master]), int(np.diff(s.corner_start).max())
    offsets = known_offsets(c.patches, s.n_faces, g)

    def clipped() -> None:
        clipping.clip_faces(
            *near, c.master, c._window, size, most, corners, s.face_start, s.corner_start, s.corner_w, s.ref, s.limit,
            s.mixed, s.affine, s.open, x, g.corner_x, g.normal, g.wall, g.kind, g.search,
        )  # fmt: skip

    def cut() -> None:
        cut_pairs(s, g, which, c.slave, c.master, c._window, c._least, x, offsets, c.prune, c.n_memory)

    alone, whole = seconds(clipped, cut)
    print(
        f"clip, {len(sim.model.names)} {name} blocks: {spread(alone / len(near[1]), 1e9, 'ns')} per candidate face "
        f"pair; {len(near[1])} candidates, {len(c.patches)} patches; a whole cut "
        f"{spread(whole / len(c.patches), 1e9, 'ns')} per patch"
    )


def tree_pairs(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The same pairs by scipy's cKDTree of the centres and a box filter."""
    from scipy.spatial import cKDTree

    centre, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    near = cKDTree(centre).query_pairs(2.0 * np.linalg.norm(half, axis=1).max(), output_type="ndarray")
    meet = (np.abs(centre[near[:, 0]] - centre[near[:, 1]]) <= half[near[:, 0]] + half[near[:, 1]]).all(axis=1)
    return near[meet]


def broad(name: str, factor: float, n: int = 10_000) -> None:
    """Broad phase of a dense packing against the tree."""
    g = np.random.default_rng(0)
    centre = g.uniform(0.0, n ** (1 / 3), (n, 3))
    half = 0.5 * np.exp(factor * g.uniform(-1, 1, (n, 1))) * g.uniform(0.8, 1.2, (n, 3))
    lower, upper = centre - half, centre + half
    reach, fixed = np.zeros(n), np.zeros(n, np.uint8)
    ours, tree = seconds(lambda: box_pairs(lower, upper, reach, fixed), lambda: tree_pairs(lower, upper))
    assert len(box_pairs(lower, upper, reach, fixed)) == len(tree_pairs(lower, upper))
    print(
        f"broad phase, {n} boxes ({name}): {spread(ours, 1e3, 'ms')}, cKDTree with filter {spread(tree, 1e3, 'ms')}, "
        f"ratio {np.median(tree / ours):.1f}"
    )


def yade(width: int, height: int, warm: int, steps: int) -> dict[str, float] | None:
    """Pairs and seconds per step of the same wall in Yade; None without it."""
    if shutil.which("yade") is None:
        return None
    sizes = {"WIDTH": str(width), "HEIGHT": str(height), "WARM": str(warm), "STEPS": str(steps)}
    done = subprocess.run(
        ["yade", "-x", "-n", "-j1", str(HERE / "yade_wall.py")],
        env=os.environ | sizes, capture_output=True, text=True, check=False,
    )  # fmt: skip
    line = [text for text in done.stdout.splitlines() if text.startswith("RESULT ")]
    return json.loads(line[0][7:]) if line else None


def wall_against_yade(repeats: int, warm: int) -> None:
    """Explicit wall of 500 bricks with kn = 1e10 Pa/m in both codes, pair-steps per second."""
    sim = fdem.Simulation(wall(25, 20), fdem.Explicit(damping=fdem.Local(0.3)), energy=False, progress=False)
    sim.cycle(500)
    contacts, ours, theirs = sim.system.contacts, [], []
    for _ in range(repeats):
        start = time.perf_counter()
        sim.cycle(500)
        per_step = (time.perf_counter() - start) / 500
        pairs = len(np.unique(contacts.patches.pair[contacts.patches.active_old > 0]))
        ours.append(pairs / per_step)
        if (peer := yade(25, 20, warm, 20)) is not None:
            theirs.append(peer["pairs"] / peer["seconds_per_step"])
    print(f"wall 25 x 20, explicit: {pairs} pairs closed, {spread(np.array(ours), 1e-3, 'k pair-steps/s')}")
    if theirs:
        ratio = np.array(ours) / np.array(theirs)
        print(f"  Yade polyhedra: {peer['pairs']} pairs, {spread(np.array(theirs), 1e-3, 'k pair-steps/s')}, "
              f"ratio {np.median(ratio):.0f} ({ratio.min():.0f} .. {ratio.max():.0f})")  # fmt: skip


def main() -> None:
    """Run everything."""
    warnings.simplefilter("ignore", fdem.FdemWarning)
    quick = "--quick" in sys.argv
    rows()
    clip("rigid", fdem.Rigid(), 8.0)
    clip("zoned", fdem.Zoned(), 5.0)
    clip("finely zoned", fdem.Zoned(size=0.6), 4.0)
    broad("equal", 0.0)
    broad("sizes 1 : 7", 1.0)
    wall_against_yade(3, 60 if quick else 100)


if __name__ == "__main__":
    main()
