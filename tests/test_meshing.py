"""Zones of blocks: exact volumes, shared faces, the same mesh in any unit and place, quality, errors."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest
import reference as ref

from fdem.errors import MeshError
from fdem.scene import gmsh_session, meshing
from fdem.scene.cutting import JointSet, cut
from fdem.scene.generate import brick
from fdem.scene.meshing import zone_meshes
from fdem.scene.polyhedra import Polyhedron
from fdem.scene.tetmesh import TetMesh, boundary_facets


def check(mesh, shape):
    """Positive zones that fill the shape; the surface is theirs, outward, and knows its faces."""
    volumes = ref.tet_volumes(mesh.points, mesh.tets)
    assert volumes.min() > 0 and volumes.sum() == pytest.approx(shape.volume, rel=1e-12)
    assert mesh.tets.dtype == mesh.triangles.dtype == mesh.triangle_face.dtype == np.int32
    assert np.array_equal(np.unique(mesh.tets), np.arange(len(mesh.points)))
    found = {tuple(sorted(t)) for t in boundary_facets(mesh.tets).tolist()}
    assert found == {tuple(sorted(t)) for t in mesh.triangles.tolist()} and len(found) == len(mesh.triangles)
    p = mesh.points[mesh.triangles]
    areas = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    surface = shape.surface if isinstance(shape, TetMesh) else shape
    for k, face in enumerate(surface.faces):
        loop = surface.points[face]
        exact = np.cross(loop - loop[0], np.roll(loop, -1, axis=0) - loop[0]).sum(axis=0)
        np.testing.assert_allclose(areas[mesh.triangle_face == k].sum(axis=0), exact, atol=1e-12 * np.abs(areas).sum())


def notched():
    """An L-shaped prism: not convex."""
    profile = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 3), (0, 3)]
    points = [(x, y, z) for y in (0.0, 1.0) for x, z in profile]
    n = len(profile)
    sides = [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
    return Polyhedron(points, [list(range(n)), list(range(n, 2 * n))[::-1], *[s[::-1] for s in sides]])


@pytest.fixture(scope="module")
def rock():
    """A jointed cube: convex blocks of every size, with short edges and thin wedges."""
    shapes = [brick((-10, -10, -10), (10, 10, 10))]
    for seed, (dip, direction, spacing) in enumerate([(75, 40, 4), (60, 160, 5), (20, 280, 4.5)]):
        shapes = cut(shapes, JointSet(dip=dip, dip_direction=direction, spacing=spacing, deviation=4, seed=seed))
    return shapes


@pytest.mark.parametrize("size", [None, 5.0, 0.5, 0.3])
def test_brick(size):
    shape = brick((1, 2, 3), (2, 2.6, 4.1))
    (mesh,) = zone_meshes([shape], [size])
    check(mesh, shape)
    if size is None:
        assert len(mesh.tets) == 12 and len(mesh.points) == 9
    else:
        edges = mesh.points[mesh.tets][:, [0, 0, 0, 1, 1, 2]] - mesh.points[mesh.tets][:, [1, 2, 3, 2, 3, 3]]
        assert np.linalg.norm(edges, axis=2).max() < 2.0 * max(size, 1.1)
    corners = {tuple(p) for p in shape.points.tolist()}
    assert corners <= {tuple(p) for p in mesh.points.tolist()}


@pytest.mark.parametrize("size", [None, 0.4])
def test_block_that_is_not_convex(size):
    shape = notched()
    assert not shape.is_convex
    (mesh,) = zone_meshes([shape], [size])
    check(mesh, shape)
    if size is None:
        assert len(mesh.points) <= 14


def test_own_zones_are_kept_as_they_are():
    X, tets = ref.kuhn_cube(2)
    shape = TetMesh(X, tets)
    (mesh,) = zone_meshes([shape], [0.1])
    check(mesh, shape)
    assert np.array_equal(mesh.points, X) and np.array_equal(mesh.tets, tets)


def triangles_on(mesh, plane):
    """Triangles of a surface on a plane n.x = d, as sets of exact coordinates."""
    normal, d = plane
    p = mesh.points[mesh.triangles]
    on = np.all(np.abs(p @ normal - d) < 1e-9, axis=1)
    return {frozenset(map(tuple, t)) for t in p[on].tolist()}


@pytest.mark.parametrize("sizes", [(0.3, 0.3), (0.5, 0.2)])
def test_neighbours_share_the_triangles_of_their_face(sizes):
    shapes = [brick((0, 0, 0), (1, 1, 1)), brick((1, 0, 0), (1.7, 1, 1))]
    meshes = zone_meshes(shapes, list(sizes))
    for mesh, shape in zip(meshes, shapes, strict=True):
        check(mesh, shape)
    one, two = (triangles_on(mesh, (np.array([1.0, 0, 0]), 1.0)) for mesh in meshes)
    assert one == two and len(one) > 10


def test_rock_mass_is_meshed_fast_and_shared(rock):
    zone_meshes([brick((0, 0, 0), (1, 1, 1))], [0.5])
    gmsh_session._cache.clear()
    start = time.perf_counter()
    meshes = zone_meshes(rock, [2.0] * len(rock))
    each = (time.perf_counter() - start) / len(rock)
    assert each < 0.05  # 6-9 ms on a quiet machine
    for mesh, shape in zip(meshes, rock, strict=True):
        check(mesh, shape)
    count: dict = {}
    for mesh in meshes:
        for t in np.round(mesh.points[mesh.triangles], 9).tolist():
            key = frozenset(map(tuple, t))
            count[key] = count.get(key, 0) + 1
    outer = sum(
        np.any(np.all(np.abs(np.abs(mesh.points[mesh.triangles]) - 10) < 1e-9, axis=1), axis=1).sum() for mesh in meshes
    )
    alone = sum(1 for c in count.values() if c == 1)
    assert max(count.values()) == 2 and alone <= outer + 0.02 * len(count)


@pytest.mark.parametrize("scale", [1024.0, 2.0**-10])
def test_powers_of_two_scale_the_mesh_to_the_bit(rock, scale):
    chosen = rock[::9]
    matrix = np.diag([scale, scale, scale, 1.0])
    one = zone_meshes(chosen, [2.0] * len(chosen))
    two = zone_meshes([shape.transform(matrix) for shape in chosen], [2.0 * scale] * len(chosen))
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.points * scale, b.points) and np.array_equal(a.tets, b.tets)
        assert np.array_equal(a.triangles, b.triangles)


@pytest.mark.parametrize(
    ("scale", "shift"), [(1e3, 0.0), (1e-3, 0.0), (1.0, np.array([4.5e5, 5.3e6, 900.0]))], ids=["mm", "km", "UTM"]
)
@pytest.mark.parametrize("size", [0.31, 0.17])
def test_same_topology_in_any_unit_and_place(scale, shift, size):
    shapes = [notched(), brick((3, 0, 0), (4, 0.7, 1.3)), brick((4, 0, 0), (5.1, 0.7, 1.3))]
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = shift
    one = zone_meshes(shapes, [size] * 3)
    two = zone_meshes([shape.transform(matrix) for shape in shapes], [size * scale] * 3)
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.tets, b.tets) and np.array_equal(a.triangles, b.triangles)
        np.testing.assert_allclose((b.points - shift) / scale, a.points, atol=1e-8)


def test_equal_blocks_cost_gmsh_once(monkeypatch):
    gmsh_session._cache.clear()
    calls = []
    fill = gmsh_session._fill_surface
    monkeypatch.setattr(gmsh_session, "_fill_surface", lambda *args: calls.append(1) or fill(*args))
    shapes = [brick((k, 3 * k, -k), (k + 1, 3 * k + 1, 0.7 - k)) for k in range(6)]
    meshes = zone_meshes(shapes, [0.3] * 6)
    assert len(calls) == 1
    assert all(np.array_equal(meshes[0].tets, mesh.tets) for mesh in meshes)


def test_large_mesh_is_in_memory_order():
    """After renumbering, the gridpoints of a zone are near each other."""
    shape = brick((0, 0, 0), (1, 1, 1))
    (mesh,) = zone_meshes([shape], [0.1])
    check(mesh, shape)
    assert len(mesh.points) > meshing._RENUMBER
    spread = np.ptp(mesh.tets, axis=1)
    assert np.median(spread) < 0.25 * len(mesh.points)
    first = np.sort(mesh.tets, axis=1)
    assert np.array_equal(np.lexsort(first.T[::-1]), np.arange(len(first)))


def test_gmsh_failures_fall_back_and_then_name_the_block(monkeypatch):
    shapes = [brick((0, 0, 0), (1, 1, 1)), notched()]
    monkeypatch.setattr(meshing, "fill_surface", lambda *args: None)
    (mesh,) = zone_meshes(shapes[:1], [0.4])  # convex: joined to its centroid
    check(mesh, shapes[0])
    with pytest.raises(MeshError, match="block 1"):
        zone_meshes(shapes, [0.4, 0.4])


def test_gmsh_is_restarted_after_an_error():
    """A surface that crosses itself stops gmsh's mesher; the next block is meshed all the same."""
    points = brick((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)).points.copy()
    triangles = np.asarray(brick((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)).triangles)
    points[0] = [0.9, 0.9, 0.9]
    with gmsh_session.session() as gmsh:
        gmsh_session.fill_surface(gmsh, points, triangles, 0.3, 1, False)
    shape = brick((0, 0, 0), (1, 1.234, 1))
    check(zone_meshes([shape], [0.4])[0], shape)


def test_gmsh_is_left_as_it_was():
    import gmsh

    with gmsh_session.session():
        pass
    before = gmsh.option.getNumber("Mesh.Algorithm3D"), gmsh.model.list()
    zone_meshes([brick((0, 0, 0), (1, 1.1, 1.3))], [0.4])
    assert (gmsh.option.getNumber("Mesh.Algorithm3D"), gmsh.model.list()) == before


def test_quiet_and_lazy():
    """A fan needs no gmsh; gmsh writes nothing."""
    code = (
        "import sys\n"
        "from fdem.scene.generate import brick\nfrom fdem.scene.meshing import zone_meshes\n"
        "zone_meshes([brick((0, 0, 0), (1, 1, 1))], [None]); assert 'gmsh' not in sys.modules\n"
        "zone_meshes([brick((0, 0, 0), (1, 1, 1))], [0.3])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "" and done.stderr == ""
