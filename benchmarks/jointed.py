"""Jointed rock of some 500 zoned blocks: one surface mesh per common face against independent meshes, one thread.

    python benchmarks/jointed.py [cycles]

A cube is cut by three joint sets, once by planes that go through everything and once by planes that stop at other
joints (persistence 0.8). Three kinds of meshes: "alone" is what every block gets when gmsh meshes it by itself (without
a size: its faces divided as they are listed), "faces" shares the mesh of faces that are the same polygon on both sides,
"shared" is what fdem makes: one mesh on everything that two faces have in common. Printed are patches of faces lying
against each other and of all kinds, the contact share of an explicit step, and the share of detection in a
quasi-static run under gravity.
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
from fdem.scene.tetmesh import boundary_facets

SIDE, SIZE, REPEATS, STEPS = 20.0, 1.2, 3, 20
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


def alone(shape: fdem.Polyhedron, size: float | None) -> object:
    """The block meshed by itself: by gmsh, or by triangles of its faces as listed and its centroid."""
    if size is None:
        triangles = [(f[0], f[k], f[k + 1]) for f in shape.faces for k in range(1, len(f) - 1)]
        tets = [(c, b, a, len(shape.points)) for a, b, c in triangles]
        return fdem.tet_mesh(np.vstack([shape.points, shape.centroid]), np.array(tets))
    import gmsh

    geo = gmsh.model.geo
    gmsh.model.add("block")
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


def meshed(kind: str, shapes: list, size: float | None) -> tuple[list, float]:
    """Zones of all blocks as shapes, and the seconds they took."""
    start = time.perf_counter()
    if kind == "alone":
        import gmsh

        gmsh.initialize(interruptible=False)
        for option, value in (("General.Terminal", 0), ("General.NumThreads", 1), ("Mesh.MeshSizeMax", size or 1.0)):
            gmsh.option.setNumber(option, value)
        gmsh.option.setNumber("Mesh.Algorithm3D", 10)
        result = [alone(shape, size) for shape in shapes]
        gmsh.finalize()
        return result, time.perf_counter() - start
    links = interfaces.Interfaces._links
    if kind == "faces":
        interfaces.Interfaces._links = lambda self, sizes: links(self, sizes) and []
    try:
        meshes = zone_meshes(shapes, [size] * len(shapes))
    finally:
        interfaces.Interfaces._links = links
    taken = time.perf_counter() - start
    return [fdem.tet_mesh(mesh.points, mesh.tets) for mesh in meshes], taken


def scene(shapes: list) -> fdem.Scene:
    """Blocks on rollers under gravity."""
    result = fdem.Scene()
    result.add(shapes, fdem.Zoned(), ROCK, name="rock")
    result.joint(fdem.Coulomb(kn=2e10, ks=1e10, friction=35))
    result.fix(component="z", where=lambda x: x[:, 2] < 1e-6)
    for axis in range(2):
        result.fix(component="xy"[axis], where=lambda x, k=axis: np.abs(x[:, k] - SIDE / 2) > SIDE / 2 - 1e-6)
    return result


def timed(names: tuple[str, ...], run: Callable[[], None]) -> tuple[float, dict[str, float]]:
    """Seconds of a run and those spent in methods of `Contacts`."""
    spent = dict.fromkeys(names, 0.0)
    methods = {name: getattr(Contacts, name) for name in names}

    def clocked(name: str) -> Callable:
        def method(self: Contacts, *args: object) -> object:
            start = time.perf_counter()
            result = methods[name](self, *args)
            spent[name] += time.perf_counter() - start
            return result

        return method

    for name in names:
        setattr(Contacts, name, clocked(name))
    start = time.perf_counter()
    try:
        run()
    finally:
        for name in names:
            setattr(Contacts, name, methods[name])
    return time.perf_counter() - start, spent


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


def main() -> None:
    """Print one line per scene and kind of mesh."""
    warnings.simplefilter("ignore", fdem.FdemWarning)
    cycles = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    for persistence in (1.0, 0.8):
        shapes = blocks(persistence)
        for size in (None, SIZE):
            print(f"persistence {persistence}, size {size}: {len(shapes)} blocks")
            first = 0
            for kind in ("alone", "faces", "shared"):
                zoned, seconds = meshed(kind, shapes, size)
                sim = fdem.Simulation(scene(zoned), fdem.Explicit(), energy=False, progress=False)
                contacts = sim.system.contacts
                flat = (contacts.patches.flags & FLAT) > 0
                pairs = len(np.unique(contacts.patches.pair[flat]))
                sim.cycle(3)
                shares = []
                for _ in range(REPEATS):
                    total, spent = timed(("forces", "update", "commit"), lambda sim=sim: sim.cycle(STEPS))
                    shares.append((sum(spent.values()) / total, total / STEPS))
                share, step = (float(np.median(column)) for column in zip(*shares, strict=True))
                n_patches = contacts.n_patches
                slow = fdem.Simulation(sim.scene, fdem.Relaxation(), energy=False, progress=False)
                total, spent = timed(("update",), lambda sim=slow: sim.cycle(cycles))
                first = first or int(flat.sum())
                print(
                    f"  {kind:7s} {seconds:5.1f} s to mesh, {sum(len(s.tets) for s in zoned):6d} zones, "
                    f"{sum(len(boundary_facets(s.tets)) for s in zoned):6d} triangles, altitude {quality(zoned):.3f} m;"
                    f" {pairs} touching pairs, patches {int(flat.sum()):6d} face to face "
                    f"({first / flat.sum():.2f} x fewer), {n_patches:6d} in all; step {1e3 * step:6.2f} ms, "
                    f"contact {share:.2f}; detection {spent['update'] / total:.3f} of {cycles} cycles "
                    f"({slow.system.contacts.n_patches} patches then)",
                    flush=True,
                )


if __name__ == "__main__":
    main()
