"""Generators: volumes, shared faces, orientation, refusals."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from fdem.errors import MeshError, SceneError
from fdem.scene.generate import arch, brick, convex_hull, icosphere, polyhedron, prism, surface, tet_mesh, voronoi, wall

L_OUTLINE = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]


def shared_faces(shapes):
    """How many faces occur once, twice..., by the exact bits of their vertices."""
    keys = Counter(frozenset(map(tuple, s.points[f].tolist())) for s in shapes for f in s.faces)
    return Counter(keys.values())


def test_brick():
    box = brick((1, 2, 3), (2, 4, 6))
    assert box.volume == pytest.approx(6.0, rel=1e-15)
    np.testing.assert_array_equal(box.bounds, [[1, 2, 3], [2, 4, 6]])
    assert len(box.faces) == 6
    with pytest.raises(SceneError, match="lower"):
        brick((0, 0, 0), (1, 0, 1))


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("reverse", [False, True])
def test_prism_axes_and_orientation(axis, reverse):
    outline = L_OUTLINE[::-1] if reverse else L_OUTLINE
    shape = prism(outline, 4.0, axis)
    assert shape.volume == pytest.approx(12.0, rel=1e-14)
    along = "xyz".index(axis)
    assert shape.bounds[1, along] == 4.0
    others = [k for k in range(3) if k != along]
    np.testing.assert_allclose(shape.centroid[others], [5 / 6, 5 / 6])
    # an unequal outline: the first column is the first of the other two axes
    thin = prism([[0, 0], [3, 0], [3, 1], [0, 1]], 4.0, axis)
    np.testing.assert_array_equal(thin.bounds[1, others], [3.0, 1.0])


@pytest.mark.parametrize(
    ("polygon", "depth", "message"),
    [
        ([[0, 0], [1, 0], [1, 1]], 0.0, "depth"),
        ([[0, 0], [1, 0]], 1.0, "polygon"),
        ([[0, 0], [1, 1], [1, 0], [0, 1]], 1.0, "crosses itself"),
        ([[0, 0], [1, 0], [1, 0], [0, 1]], 1.0, "duplicates"),
        ([[0, 0], [1, np.nan], [0, 1]], 1.0, "not finite"),
    ],
)
def test_prism_refuses(polygon, depth, message):
    with pytest.raises(SceneError, match=message):
        prism(polygon, depth)


def test_hull_merges_coplanar_triangles():
    rng = np.random.default_rng(0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], dtype=float)
    hull = convex_hull(np.vstack([corners, rng.random((20, 3)) * [1, 2, 3]]) + 1000.0)
    assert len(hull.faces) == 6
    assert hull.volume == pytest.approx(6.0, rel=1e-12)
    assert hull.is_convex
    cloud = convex_hull(rng.standard_normal((60, 3)))
    assert cloud.is_convex
    assert cloud.report().concavity == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(MeshError, match="plane"):
        convex_hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])


def test_icosphere():
    ball = icosphere(2.0, (1, 2, 3))
    assert len(ball.faces) == 320
    np.testing.assert_allclose(np.linalg.norm(ball.points - [1, 2, 3], axis=1), 2.0, rtol=1e-14)
    np.testing.assert_allclose(ball.centroid, [1, 2, 3], atol=1e-14)
    assert 0.95 < ball.volume / (4 / 3 * np.pi * 8) < 1.0
    with pytest.raises(SceneError, match="subdivisions"):
        icosphere(1.0, subdivisions=-1)


def test_arch_shares_joints_and_is_symmetric():
    blocks = arch(span=10, rise=5, thickness=1.2, depth=1, n=25)
    assert len(blocks) == 25
    assert shared_faces(blocks)[2] == 24
    # chords of both circles: a ring of trapezia
    angle = np.pi / 25
    exact = 25 * 0.5 * np.sin(angle) * (5.6**2 - 4.4**2)
    assert sum(b.volume for b in blocks) == pytest.approx(exact, rel=1e-12)
    assert blocks[0].centroid[0] < 0.0 < blocks[-1].centroid[0]
    np.testing.assert_array_equal(np.sort(blocks[0].points[:, 0]), np.sort(-blocks[-1].points[:, 0]))
    np.testing.assert_allclose(blocks[0].points[:, 2].min(), 0.0, atol=1e-15)
    flat = arch(span=8, rise=1, thickness=0.5, depth=2, n=7)
    ends = np.vstack([flat[0].points, flat[-1].points])
    centre = [0.0, 1.0, 1.0 - (16 + 1) / 2]
    np.testing.assert_allclose(np.unique(np.round(np.linalg.norm((ends - centre)[:, [0, 2]], axis=1), 9)), [8.25, 8.75])
    middle = 0.5 * (flat[0].points[flat[0].points[:, 0].argsort()[:2]].mean(axis=0))
    assert middle[0] < 0.0
    for bad in ({"n": 0}, {"thickness": 20.0}, {"span": -1.0}):
        with pytest.raises(SceneError, match=next(iter(bad))):
            arch(**{"span": 10, "rise": 5, "thickness": 1.2, "depth": 1, "n": 25, **bad})


def test_wall_is_running_bond():
    bricks = wall(2.0, 1.0, 0.25, (0.5, 0.25))
    assert len(bricks) == 4 + 5 + 4 + 5
    assert sum(b.volume for b in bricks) == pytest.approx(0.5, rel=1e-14)
    assert {round(b.volume / (0.5 * 0.25 * 0.25), 9) for b in bricks} == {0.5, 1.0}
    # head joints are shared exactly; bed joints overlap by half a brick
    assert shared_faces(bricks)[2] == 3 + 4 + 3 + 4
    with pytest.raises(SceneError, match="brick"):
        wall(2.0, 1.0, 0.25, (0.5, -0.25))


@pytest.mark.parametrize("shape", [brick((0, 0, 0), (2, 2, 2)), prism(L_OUTLINE, 2.0)], ids=["box", "L"])
def test_voronoi_fills_and_shares(shape):
    cells = voronoi(shape, 25, seed=4)
    assert sum(c.volume for c in cells) == pytest.approx(shape.volume, rel=1e-12)
    shared = shared_faces(cells)
    assert set(shared) <= {1, 2}
    assert shared[2] > 60
    # what is not shared is the boundary of the shape, cell by cell
    once = Counter(frozenset(map(tuple, c.points[f].tolist())) for c in cells for f in c.faces)
    area = 0.0
    for cell in cells:
        corners = cell.points[cell.triangles]
        sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        for k, face in enumerate(cell.faces):
            if once[frozenset(map(tuple, cell.points[face].tolist()))] == 1:
                area += sizes[cell.triangle_face == k].sum()
    corners = shape.points[shape.triangles]
    exact = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(exact, rel=1e-9)


def test_voronoi_is_seeded_and_scales_exactly():
    small, same = voronoi(brick((0, 0, 0), (1, 1, 1)), 8, seed=2), voronoi(brick((0, 0, 0), (1, 1, 1)), 8, seed=2)
    large = voronoi(brick((0, 0, 0), (1024, 1024, 1024)), 8, seed=2)
    for a, b, c in zip(small, same, large, strict=True):
        assert (a.points == b.points).all()
        assert (c.points == a.points * 1024.0).all()
    assert len(voronoi(brick((0, 0, 0), (1, 1, 1)), 1)) == 1
    with pytest.raises(SceneError, match="n = 0"):
        voronoi(brick((0, 0, 0), (1, 1, 1)), 0)


def test_users_own_shapes():
    box = brick((0, 0, 0), (1, 1, 1))
    assert polyhedron(box.points, [f.tolist() for f in box.faces]).volume == pytest.approx(1.0)
    assert tet_mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2, 3]]).volume == pytest.approx(1 / 6)
    assert surface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).volume == 0.0
