"""Jointed rock of some 500 zoned blocks: one surface mesh on common faces against independent meshes, one thread.

    python benchmarks/jointed.py [cycles]

A cube is cut by three joint sets, by planes that go through everything and by planes that stop at other joints
(persistence 0.8); the last scene is a wall of bricks in bond. Three kinds of meshes: "alone" is what gmsh makes of
every block by itself (without a size: faces divided as they are listed), "faces" shares the mesh of faces that are the
same polygon on both sides, "shared" is what fdem makes: one mesh on everything that two faces have in common. Printed
are zones, median over the blocks of the smallest altitude of a zone [m], the stable step, patches of faces lying
against each other and of all kinds, the contact share of an explicit step, and for "shared" the share of detection in
a quasi-static run. Times are CPU seconds.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable

import numpy as np

import fdem
from fdem.contact.contacts import Contacts
from fdem.kernels.patches import FLAT
from fdem.scene import interfaces
from fdem.scene.meshing import zone_meshes

SIDE, REPEATS, STEPS = 20.0, 3, 10
ROCK = fdem.Elastic(2600.0, 2e10, 0.25)


def blocks(persistence: float) -> list:
    """Pieces of a cube; seeds without needles."""
    seed, spacing = (20, 2.85) if persistence == 1.0 else (30, 2.3)
    origin = tuple((SIDE / 2 + np.random.default_rng(seed).uniform(-1.4, 1.4, 3)).tolist())
    shapes = [fdem.brick((0, 0, 0), (SIDE, SIDE, SIDE))]
    for k, (dip, direction) in enumerate([(75, 40), (65, 150), (15, 280)]):
        joints = fdem.JointSet(
            dip, direction, spacing=spacing, origin=origin, deviation=2, seed=10 * seed + k, persistence=persistence
        )
        shapes = fdem.cut(shapes, joints)
    return shapes


def alone(shape: fdem.Polyhedron, size: float | None) -> fdem.TetMesh:
    """The block meshed by itself: by gmsh, or by triangles of its faces as listed and its centroid."""
    if size is None:
        triangles = [(f[0], f[k], f[k + 1]) for f in shape.faces for k in range(1, len(f) - 1)]
        tets = [(c, b, a, len(shape.points)) for a, b, c in triangles]
        return fdem.tet_mesh(np.vstack([shape.points, shape.centroid]), np.array(tets))
    import gmsh

    geo = gmsh.model.geo
    gmsh.model.add("block")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    points = [geo.addPoint(*p, size) for p in shape.points.tolist()]
    lines = {(a, b): geo.addLine(points[a], points[b]) for a, b in shape.edges.tolist()}
    loops = [
        [lines[a, b] if (a, b) in lines else -lines[b, a] for a, b in zip(f, np.roll(f, -1), strict=True)]
        for f in shape.faces
    ]
    surfaces = [geo.addPlaneSurface([geo.addCurveLoop(loop)]) for loop in loops]
    geo.addVolume([geo.addSurfaceLoop(surfaces)])
    geo.synchronize()
    gmsh.model.mesh.generate(3)
    tags, places, _ = gmsh.model.mesh.getNodes()
    tets = np.asarray(gmsh.model.mesh.getElementsByType(4)[1], dtype=np.int64).reshape(-1, 4)
    gmsh.model.remove()
    number = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    number[tags] = np.arange(len(tags))
    return fdem.tet_mesh(places.reshape(-1, 3), number[tets])


def meshed(kind: str, shapes: list, sizes: list) -> tuple[list, float]:
    """Zones of all blocks as shapes, and the seconds they took."""
    start = time.process_time()
    if kind == "alone":
        import gmsh

        if not gmsh.isInitialized():
            gmsh.initialize(interruptible=False)
        for option, value in (("General.Terminal", 0), ("General.NumThreads", 1), ("Mesh.Algorithm3D", 10)):
            gmsh.option.setNumber(option, value)
        result = [alone(shape, size) for shape, size in zip(shapes, sizes, strict=True)]
        return result, time.process_time() - start
    link = interfaces.Interfaces._link
    if kind == "faces":
        interfaces.Interfaces._link = lambda self, a, b: []
    try:
        meshes = zone_meshes(shapes, sizes)
    finally:
        interfaces.Interfaces._link = link
    return [fdem.tet_mesh(mesh.points, mesh.tets) for mesh in meshes], time.process_time() - start


def scene(shapes: list) -> fdem.Scene:
    """Blocks on rollers under gravity."""
    result = fdem.Scene()
    result.add(shapes, fdem.Zoned(), ROCK, name="block")
    result.joint(fdem.Coulomb(kn=2e10, ks=1e10, friction=35))
    corners = np.concatenate([shape.points for shape in shapes])
    for axis, name in enumerate("xyz"):
        low, high = corners[:, axis].min() + 1e-6, corners[:, axis].max() - (1e-6 if name != "z" else -1.0)
        result.fix(component=name, where=lambda x, k=axis, low=low, high=high: (x[:, k] < low) | (x[:, k] > high))
    return result


def timed(names: tuple[str, ...], run: Callable[[], None]) -> tuple[float, dict[str, float]]:
    """Seconds of a run and those spent in methods of `Contacts`."""
    spent = dict.fromkeys(names, 0.0)
    methods = {name: getattr(Contacts, name) for name in names}

    def clocked(name: str) -> Callable:
        def method(self: Contacts, *args: object) -> object:
            start = time.process_time()
            result = methods[name](self, *args)
            spent[name] += time.process_time() - start
            return result

        return method

    for name in names:
        setattr(Contacts, name, clocked(name))
    start = time.process_time()
    try:
        run()
    finally:
        for name in names:
            setattr(Contacts, name, methods[name])
    return time.process_time() - start, spent


def quality(shapes: list) -> float:
    """Median over the blocks of the smallest altitude of a zone, which the stable step follows [m]."""
    least = []
    for shape in shapes:
        corners = shape.points[shape.tets]
        facets = corners[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]]
        doubled = np.cross(facets[:, :, 1] - facets[:, :, 0], facets[:, :, 2] - facets[:, :, 0])
        volume6 = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
        least.append((volume6 / np.linalg.norm(doubled, axis=2).max(axis=1)).min())
    return float(np.median(least))


def row(kind: str, shapes: list, sizes: list, cycles: int) -> int:
    """Print one line; the number of patches of faces lying against each other."""
    zoned, seconds = meshed(kind, shapes, sizes)
    sim = fdem.Simulation(scene(zoned), fdem.Explicit(), energy=False, progress=False)
    contacts = sim.system.contacts
    flat = (contacts.patches.flags & FLAT) > 0
    pairs, n_flat, n_all = len(np.unique(contacts.patches.pair[flat])), int(flat.sum()), contacts.n_patches
    sim.cycle(3)
    shares = []
    for _ in range(REPEATS):
        total, spent = timed(("forces", "update", "commit"), lambda: sim.cycle(STEPS))
        shares.append((sum(spent.values()) / total, 1e3 * total / STEPS))
    share, step = np.median(shares, axis=0)
    print(
        f"  {kind:6s} {pairs:6d} {seconds:7.1f} {sum(len(s.tets) for s in zoned):7d} {quality(zoned):9.3f}"
        f" {1e6 * sim.dt:8.2f} {n_flat:8d} {n_all:8d} {step:8.2f} {share:8.2f}",
        end="" if kind == "shared" else "\n",
        flush=True,
    )
    if kind == "shared":
        slow = fdem.Simulation(sim.scene, fdem.Relaxation(), energy=False, progress=False)
        total, spent = timed(("update",), lambda: slow.cycle(cycles))
        grown = slow.system.contacts.n_patches
        print(f" {spent['update'] / total:10.3f}   ({cycles} cycles, then {grown} patches, ratio {slow.ratio:.1e})")
    return n_flat


def main() -> None:
    """Print one table per scene."""
    warnings.simplefilter("ignore", fdem.FdemWarning)
    cycles = int(sys.argv[1]) if len(sys.argv) > 1 else 3000
    through, stopped, wall = blocks(1.0), blocks(0.8), fdem.wall(10.0, 5.0, 0.25, (0.5, 0.2, 0.25))
    mixed = 1.2 * np.random.default_rng(0).uniform(0.8, 1.25, len(through))
    for what, shapes, sizes in (
        ("cut through, no size", through, [None] * len(through)),
        ("cut through, size 1.2 m", through, [1.2] * len(through)),
        ("cut through, sizes 1 to 1.5 m", through, mixed.tolist()),
        ("cuts that stop, size 1.2 m", stopped, [1.2] * len(stopped)),
        ("wall in bond, size 0.12 m", wall, [0.12] * len(wall)),
    ):
        print(f"{what}: {len(shapes)} blocks")
        print("  mesh    pairs  mesh s   zones  altitude    dt us  flat pa.  patches  step ms  contact  detection")
        count = {kind: row(kind, shapes, sizes, cycles) for kind in ("alone", "faces", "shared")}
        fewer = ", ".join(f"{count[kind] / count['shared']:.2f} x fewer than {kind}" for kind in ("alone", "faces"))
        print(f"  patches of faces lying against each other: {fewer}", flush=True)


if __name__ == "__main__":
    main()
