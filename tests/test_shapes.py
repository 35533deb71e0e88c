"""Shapes: closed-form moments, reports, transforms, and every kind of bad surface refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from fdem.errors import FdemWarning, MeshError
from fdem.scene.polygons import area_vector, regions, trace, triangulate
from fdem.scene.shapes import Polyhedron, Surface, TetMesh

CUBE = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
FACES = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
L_OUTLINE = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], dtype=float)
TONON = np.array([[8.3322, -11.86875, 0.93355], [0.75523, 5.0, 16.37072], [52.61236, 5.0, -5.3858], [2.0, 5.0, 3.0]])
TET_FACES = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]
FIVE_TETS = [[0, 1, 2, 4], [3, 1, 2, 7], [5, 1, 4, 7], [6, 2, 4, 7], [1, 2, 4, 7]]


def l_prism(shift=(0.0, 0.0, 0.0)):
    n = len(L_OUTLINE)
    points = np.vstack([np.c_[L_OUTLINE, np.full(n, z)] for z in (0.0, 1.0)]) + shift
    sides = [[i, (i + 1) % n, (i + 1) % n + n, i + n] for i in range(n)]
    return Polyhedron(points, [list(range(n))[::-1], list(range(n, 2 * n)), *sides])


def test_oracle_rigid_polyhedron_inertia():
    """Tonon's tetrahedron, cube, box and L-prism, 1e-12 relative (oracle case rigid_polyhedron_inertia)."""
    with pytest.warns(FdemWarning, match="inside out"):
        tet = Polyhedron(TONON, TET_FACES)
    assert tet.volume == pytest.approx(1873.2333642164656, rel=1e-12)
    np.testing.assert_allclose(tet.centroid, TONON.mean(axis=0), rtol=1e-12)
    expected = [
        [43520.33328539331, -11996.201393234081, 46343.16738139439],
        [-11996.201393234081, 194711.29259079363, -4417.661569685616],
        [46343.16738139439, -4417.661569685616, 191168.76488607796],
    ]
    np.testing.assert_allclose(tet.inertia(1.0), expected, rtol=1e-12)
    np.testing.assert_allclose(Polyhedron(CUBE, FACES).inertia(1.0), np.eye(3) / 6.0, atol=1e-15)
    box = Polyhedron(CUBE * [1.0, 2.0, 3.0], FACES)
    np.testing.assert_allclose(box.inertia(2.0), np.diag([13.0, 10.0, 5.0]), rtol=1e-12, atol=1e-14)
    exact = np.array([[7 / 6, 1 / 3, 0.0], [1 / 3, 7 / 6, 0.0], [0.0, 0.0, 11 / 6]])
    for shift, tolerance in (((0.0, 0.0, 0.0), 1e-12), ((500000.0, 4600000.0, 100.0), 1e-9)):
        prism = l_prism(shift)
        assert prism.volume == pytest.approx(3.0, rel=tolerance)
        np.testing.assert_allclose(prism.centroid - shift, [5 / 6, 5 / 6, 0.5], atol=2e-9)
        np.testing.assert_allclose(prism.inertia(), exact, atol=tolerance)


def test_regular_tetrahedron():
    points = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]]) / 8**0.5
    tet = Polyhedron(points, TET_FACES if np.linalg.det(points[1:] - points[0]) < 0 else [f[::-1] for f in TET_FACES])
    assert tet.volume == pytest.approx(2**0.5 / 12, rel=1e-13)
    np.testing.assert_allclose(tet.inertia(), np.eye(3) * 2**0.5 / 12 / 20, atol=1e-16)


def test_tet_mesh_totals_and_orientation():
    mesh = TetMesh(CUBE * [1, 2, 3], FIVE_TETS, {"all": range(5)}, {"floor": [[0, 2, 1], [1, 2, 3]]})
    edges = mesh.points[mesh.tets[:, 1:]] - mesh.points[mesh.tets[:, :1]]
    assert (np.linalg.det(edges) > 0.0).all()
    assert mesh.volume == pytest.approx(6.0, rel=1e-14)
    np.testing.assert_allclose(mesh.inertia(), np.diag([6.5, 5.0, 2.5]), atol=1e-14)
    assert sorted(filter(None, mesh.surface.face_tags)) == ["floor", "floor"]
    assert mesh.surface.volume == pytest.approx(6.0)
    assert mesh.report().n_zones == 5
    mirrored = mesh.transform(np.diag([-1.0, 1.0, 1.0, 1.0]))
    assert mirrored.volume == pytest.approx(6.0)


def test_moments_scale_exactly():
    shape, large = l_prism(), l_prism().transform(np.diag([1024.0, 1024.0, 1024.0, 1.0]))
    assert large.volume == shape.volume * 2.0**30
    assert (large.inertia() == shape.inertia() * 2.0**50).all()
    assert (large.triangles == shape.triangles).all()


def test_transform_with_reflection():
    matrix = np.eye(4)
    matrix[:3, :3] = [[0.0, -2.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
    matrix[:3, 3] = [10.0, 0.0, 0.0]
    shape = l_prism()
    out = shape.transform(matrix)
    assert out.volume == pytest.approx(6.0)
    np.testing.assert_allclose(out.centroid, matrix[:3, :3] @ shape.centroid + [10, 0, 0])
    with pytest.raises(MeshError, match="singular"):
        shape.transform(np.diag([1.0, 1.0, 0.0, 1.0]))
    with pytest.raises(MeshError, match="matrix"):
        shape.transform(np.eye(3))


def test_report_and_convexity():
    report = l_prism().report()
    assert report.volume == pytest.approx(3.0)
    assert report.shortest_edge == 1.0
    assert report.concavity == pytest.approx(0.5 / 3.5)
    assert report.open_edges == 0
    assert "concavity" in str(report)
    assert not l_prism().is_convex
    cube = Polyhedron(CUBE * [1.0, 2.0, 4.0], FACES)
    assert cube.is_convex
    assert cube.report().aspect == pytest.approx(4.0)
    assert cube.report().concavity == pytest.approx(0.0, abs=1e-14)


def test_surface_is_open_and_without_volume():
    terrain = Surface([[0, 0, 0], [2, 0, 0], [2, 2, 1], [0, 2, 0]], [[0, 1, 2], [0, 2, 3]])
    assert terrain.volume == 0.0
    assert terrain.report().open_edges == 4
    assert len(terrain.triangles) == 2
    with pytest.raises(MeshError, match=r"edge \(0, 1\)"):
        Surface(CUBE, [[0, 1, 3], [0, 1, 2]])


def broken(name):
    points, faces = CUBE.copy(), [list(f) for f in FACES]
    if name == "nan":
        points[3, 1] = np.nan
    elif name == "inf":
        points[5, 2] = np.inf
    elif name == "index":
        faces[2][1] = 17
    elif name == "negative index":
        faces[2][1] = -1
    elif name == "empty points":
        points = np.zeros((0, 3))
    elif name == "empty faces":
        faces = []
    elif name == "duplicate":
        points = np.vstack([points, points[1]])
        faces[5][0] = 8
    elif name == "unused duplicate":
        points = np.vstack([points, points[1] + 1e-13])
    elif name == "open":
        del faces[1]
    elif name == "overlap":
        faces.append(list(faces[0]))
    elif name == "degenerate":
        points = np.vstack([points, [0.5, 0.0, 0.0]])
        faces.append([0, 8, 1])
    elif name == "vertex twice":
        faces[0] = [0, 2, 0, 1]
    elif name == "two parts":
        points = np.vstack([points, points + 3.0])
        faces += [[v + 8 for v in f] for f in FACES]
    elif name == "cavity":
        points = np.vstack([points, 0.25 + 0.5 * points])
        faces += [[v + 8 for v in f[::-1]] for f in FACES]
    elif name == "flat":
        points, faces = points[:4], [[0, 1, 3, 2], [2, 3, 1, 0]]
    elif name == "bow tie":
        faces[0] = [0, 3, 2, 1]
    return points, faces


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nan", r"points\[3\] has a coordinate y = nan"),
        ("inf", r"points\[5\] has a coordinate z = inf"),
        ("index", r"faces\[2\] has face index 17 out of range, there are 8 points"),
        ("negative index", r"faces\[2\] has face index -1 out of range"),
        ("empty points", "empty mesh, there are no points"),
        ("empty faces", "empty mesh, there are no faces"),
        ("duplicate", r"points\[1\] and points\[8\] are duplicates"),
        ("unused duplicate", r"points\[1\] and points\[8\] are duplicates"),
        ("open", r"open at edge \(\d, \d\)"),
        ("overlap", r"overlaps itself, faces \[0, \d, 6\] share edge"),
        ("degenerate", r"faces\[6\] = \[0, 8, 1\] is degenerate"),
        ("vertex twice", r"faces\[0\] = \[0, 2, 0, 1\] uses a vertex twice"),
        ("two parts", "disconnected parts, face 6"),
        ("cavity", "disconnected parts, face 6"),
        ("flat", "encloses no volume"),
        ("bow tie", "degenerate|open|crosses"),
    ],
)
def test_bad_surfaces_are_refused(name, message):
    with pytest.raises(MeshError, match=message):
        Polyhedron(*broken(name))


def test_bad_types_are_refused():
    with pytest.raises(MeshError, match=r"points must have shape \(n, 3\), not \(8, 2\)"):
        Polyhedron(CUBE[:, :2], FACES)
    with pytest.raises(MeshError, match="points must be numbers"):
        Polyhedron([["a", "b", "c"]], FACES)
    with pytest.raises(MeshError, match=r"faces\[0\] = \[0, 2\]"):
        Polyhedron(CUBE, [[0, 2], *FACES[1:]])
    with pytest.raises(MeshError, match=r"face_tags has 2 entries for 6 faces"):
        Polyhedron(CUBE, FACES, ["a", "b"])


@pytest.mark.parametrize(
    ("points", "tets", "message"),
    [
        (CUBE, [], "empty mesh, there are no tets"),
        (CUBE, [[0, 1, 2, 9]], r"tets\[0\] = \[0, 1, 2, 9\] is out of range"),
        (CUBE, [[0, 1, 2, 3]], r"tets\[0\] = \[0, 1, 2, 3\] is degenerate"),
        (np.vstack([CUBE, CUBE[0]]), FIVE_TETS, r"points\[0\] and points\[8\] are duplicates"),
        (np.where(np.arange(24).reshape(8, 3) == 4, np.nan, CUBE), FIVE_TETS, r"points\[1\] has a coordinate y"),
        (np.vstack([CUBE, CUBE + 3.0]), [[0, 1, 2, 4], [8, 9, 10, 12]], "2 disconnected parts"),
    ],
)
def test_bad_tet_meshes_are_refused(points, tets, message):
    with pytest.raises(MeshError, match=message):
        TetMesh(points, tets)


def test_inside_out_and_disagreeing_faces_are_repaired():
    with pytest.warns(FdemWarning, match="inside out"):
        shape = Polyhedron(CUBE, [f[::-1] for f in FACES], ["a", "b", "c", "d", "e", "f"])
    assert shape.volume == pytest.approx(1.0)
    assert shape.face_tags == ("a", "b", "c", "d", "e", "f")
    mixed = [f[::-1] if i in (1, 4) else f for i, f in enumerate(FACES)]
    with pytest.warns(FdemWarning, match=r"faces \[1, 4\]"):
        assert Polyhedron(CUBE, mixed).volume == pytest.approx(1.0)


def test_triangulation_does_not_depend_on_start_or_direction():
    rng = np.random.default_rng(3)
    for n in (4, 5, 7, 12, 30):
        angle = np.sort(rng.random(n)) * 2 * np.pi
        radius = rng.uniform(0.3, 1.0, n)
        ring = np.c_[radius * np.cos(angle), radius * np.sin(angle), np.zeros(n)]
        expected = None
        for start in (0, 1, n - 1):
            for step in (1, -1):
                loop = np.roll(ring, start, axis=0)[::step].tolist()
                triangles = triangulate(loop)
                assert len(triangles) == n - 2
                areas = [area_vector([loop[i] for i in t])[2] for t in triangles]
                assert min(a * step for a in areas) > 0.0
                assert sum(areas) == pytest.approx(area_vector(loop)[2])
                found = {frozenset(tuple(loop[i]) for i in t) for t in triangles}
                assert expected is None or found == expected
                expected = found


def test_triangulation_avoids_flat_triangles():
    ring = [[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [2.0, 1, 0], [2.0, 2, 0], [0.0, 2, 0]]
    areas = [area_vector([ring[i] for i in t])[2] for t in triangulate(ring)]
    assert min(areas) > 0.4


def test_regions_with_holes_are_simple_loops():
    outer = [(0, 0), (9, 0), (9, 9), (0, 9)]
    holes = [[(1, 1), (1, 3), (3, 3), (3, 1)], [(5, 5), (5, 7), (7, 7), (7, 5)]]
    xy = {k: (float(x), float(y)) for k, (x, y) in enumerate([*outer, *holes[0], *holes[1]])}
    edges = [(4 * h + k, 4 * h + (k + 1) % 4) for h in range(3) for k in range(4)]
    loops = regions(trace(edges, xy), xy)
    areas = [area_vector([(*xy[v], 0.0) for v in loop])[2] for loop in loops]
    assert all(len(set(loop)) == len(loop) for loop in loops)
    assert min(areas) > 0.0
    assert sum(areas) == pytest.approx(81 - 8)
    assert {v for loop in loops for v in loop} == set(range(12))
