"""Cutting: exact books of volume, shared faces, tags, persistence, non-convex blocks and cutters."""

from __future__ import annotations

import time
from collections import Counter

import numpy as np
import pytest

from fdem.errors import MeshError, SceneError
from fdem.scene.cutting import Disc, JointSet, cut, split
from fdem.scene.generate import brick, icosphere, prism, tet_mesh
from fdem.scene.shapes import Polyhedron

L_OUTLINE = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]
SETS = (
    JointSet(50, 120, 3.0, persistence=0.9, seed=1, name="a"),
    JointSet(80, 30, 3.5, persistence=0.8, seed=2, name="b"),
    JointSet(20, 250, 4.0, persistence=0.7, seed=3, name="c"),
)


def moved(shape, x=0.0, y=0.0, z=0.0):
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return shape.transform(matrix)


def horseshoe(depth=20.0, start=-10.0):
    """12-gon: vault of eight chords over straight walls."""
    angle = np.linspace(0.0, np.pi, 9)
    profile = [(2.5 * np.cos(a), 2.5 * np.sin(a)) for a in angle] + [(-2.5, -2.0), (0.0, -2.2), (2.5, -2.0)]
    return moved(prism(profile, depth), y=start)


def rock_mass():
    blocks = [brick((-10, -10, -10), (10, 10, 10))]
    for joints in SETS:
        blocks = cut(blocks, joints)
    return blocks


def check(pieces, volume):
    """Pieces fill the volume to 1e-12 and every one is a valid solid."""
    assert sum(p.volume for p in pieces) == pytest.approx(volume, rel=1e-12)
    for p in pieces:
        again = Polyhedron(p.points, [f.tolist() for f in p.faces])
        assert again.volume == pytest.approx(p.volume)


def faces(shapes, tag):
    """Count of every face with a tag, by the exact bits of its vertices."""
    return Counter(
        frozenset(map(tuple, s.points[f].tolist()))
        for s in shapes
        for f, t in zip(s.faces, s.face_tags, strict=True)
        if t == tag
    )


def section_area(shapes, tag):
    area = np.zeros(3)
    total = 0.0
    for s in shapes:
        c = s.points[s.triangles]
        normals = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]) / 2
        chosen = np.array([t == tag for t in s.face_tags])[s.triangle_face]
        area += normals[chosen].sum(axis=0)
        total += np.linalg.norm(normals[chosen], axis=1).sum()
    return area, total


def test_rock_mass_and_horseshoe_fill_the_domain():
    start = time.perf_counter()
    blocks = rock_mass()
    tunnel = horseshoe()
    pieces = [p for b in blocks for p in split(b, tunnel, "tunnel")]
    assert time.perf_counter() - start < 5.0
    assert len(blocks) > 150
    check(blocks, 8000.0)
    check([p for p, _ in pieces], 8000.0)
    inside = [p for p, within in pieces if within]
    check(inside, tunnel.volume)
    assert {t for p, _ in pieces for t in p.face_tags} == {None, "a", "b", "c", "tunnel"}
    assert any(not p.is_convex for p, within in pieces if not within)
    # every face the tunnel made has its counterpart with the same bits
    made = faces([p for p, _ in pieces], "tunnel")
    assert set(made.values()) == {2}
    # and no piece is a sliver
    assert min(p.volume for p, _ in pieces) > 1e-12


def test_untouched_shapes_come_back_as_they_are():
    box = brick((0, 0, 0), (1, 1, 1))
    assert split(box, JointSet(0, 0, origin=(0, 0, 5)))[0][0] is box
    assert split(box, JointSet(0, 0, origin=(0, 0, 1)))[0][0] is box
    # nearer than the tolerance: the plane touches the face
    assert split(box, JointSet(0, 0, origin=(0, 0, 1 - 1e-11)))[0][0] is box
    assert split(box, brick((1, 0, 0), (2, 1, 1))) == [(box, False)]
    assert split(box, brick((-1, -1, -1), (2, 2, 2))) == [(box, True)]
    assert split(box, box) == [(box, True)]
    assert split(box, Disc((5, 5, 0.5), 0, 0, 1.0)) == [(box, False)]


def test_convention_of_dip_and_dip_direction():
    np.testing.assert_allclose(JointSet(45, 90).normal, [0.5**0.5, 0, 0.5**0.5])
    np.testing.assert_allclose(JointSet(30, 0).normal, [0, 0.5, 0.75**0.5])
    # a vertical plane that dips east is exactly x = constant
    np.testing.assert_array_equal(JointSet(90, 90).normal, [1, 0, 0])
    np.testing.assert_array_equal(JointSet(0, 77).normal, [0, 0, 1])
    halves = cut(brick((0, 0, 0), (1, 1, 1)), JointSet(90, 90, origin=(0.25, 0, 0)))
    assert sorted(round(h.volume, 12) for h in halves) == [0.25, 0.75]


def test_grid_of_planes_shares_all_faces():
    blocks = [brick((0, 0, 0), (4, 3, 2))]
    for k, (dip, direction) in enumerate([(90, 90), (90, 0), (0, 0)]):
        blocks = cut(blocks, JointSet(dip, direction, 1.0, name=str(k)))
    assert len(blocks) == 24
    assert all(b.volume == 1.0 for b in blocks)
    for k, count in enumerate([18, 16, 12]):
        shared = faces(blocks, str(k))
        assert len(shared) == count
        assert set(shared.values()) == {2}


def test_oblique_sets_share_all_faces_bit_for_bit():
    blocks = [brick((0, 0, 0), (4, 4, 4))]
    for k, (dip, direction, spacing) in enumerate([(62, 13, 1.1), (31, 140, 1.3), (77, 255, 0.9)]):
        blocks = cut(blocks, JointSet(dip, direction, spacing, name=str(k)))
    check(blocks, 64.0)
    for k in "012":
        assert set(faces(blocks, k).values()) == {2}


def test_persistence_and_seed():
    box = brick((0, 0, 0), (20, 1, 1))
    full = cut(box, JointSet(90, 90, 1.0, origin=(0.5, 0, 0)))
    assert len(full) == 21
    half = [len(cut(box, JointSet(90, 90, 1.0, origin=(0.5, 0, 0), persistence=0.5, seed=s))) for s in range(30)]
    assert 9 < np.mean(half) < 13
    again = [len(cut(box, JointSet(90, 90, 1.0, origin=(0.5, 0, 0), persistence=0.5, seed=s))) for s in range(30)]
    assert half == again
    assert len(cut(box, JointSet(90, 90, 1.0, persistence=0.0))) == 1


def test_deviation_tilts_planes_and_keeps_the_books():
    box = brick((-5, -5, -5), (5, 5, 5))
    joints = JointSet(40, 60, 2.0, deviation=5.0, seed=7, name="d")
    pieces = cut(box, joints)
    check(pieces, 1000.0)
    normals = []
    for p in pieces:
        for f, t in zip(p.faces, p.face_tags, strict=True):
            if t == "d":
                n = np.cross(p.points[f[1]] - p.points[f[0]], p.points[f[2]] - p.points[f[0]])
                normals.append(abs(n @ joints.normal) / np.linalg.norm(n))
    angles = np.degrees(np.arccos(np.clip(normals, -1, 1)))
    assert 1.0 < np.sqrt(np.mean(angles**2)) < 15.0
    # half of the body is cut by the same planes
    other = cut(brick((-5, -5, -5), (0, 5, 5)), joints)
    area, size = section_area(other, "d")
    assert size > 10.0
    np.testing.assert_allclose(area, 0.0, atol=1e-9)
    with pytest.raises(SceneError, match="spacing"):
        cut(box, JointSet(40, 60, 1e-6))


def test_scale_by_a_power_of_two_gives_the_same_bits():
    tunnel = horseshoe()
    big = np.diag([1024.0, 1024.0, 1024.0, 1.0])
    for joints in SETS:
        scaled = JointSet(
            joints.dip, joints.dip_direction, joints.spacing * 1024, persistence=joints.persistence, seed=joints.seed
        )
        small = cut(cut(brick((-10, -10, -10), (10, 10, 10)), joints), tunnel)
        large = cut(cut(brick((-10240,) * 3, (10240,) * 3), scaled), tunnel.transform(big))
        assert len(small) == len(large)
        for a, b in zip(small, large, strict=True):
            assert (a.points * 1024.0 == b.points).all()
            assert [f.tolist() for f in a.faces] == [f.tolist() for f in b.faces]


def test_disc_cuts_fully_what_it_touches():
    row = cut(brick((0, 0, 0), (6, 1, 1)), JointSet(90, 90, 1.0))
    pieces = cut(row, Disc((2.5, 0.5, 0.5), 0, 0, radius=0.8, name="disc"))
    # blocks 1, 2 and 3 are touched, 0, 4 and 5 are not
    assert len(pieces) == 9
    assert set(faces(pieces, "disc").values()) == {2}
    assert len(cut(row, Disc((2.5, 0.5, 0.5), 0, 0, radius=0.49))) == 7
    assert len(cut(row, Disc((2.5, -0.3, 0.5), 0, 0, radius=0.2))) == 6


def test_plane_cuts_a_non_convex_block_into_components():
    u = prism([[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]], 2.0)
    pieces = cut(u, JointSet(0, 0, origin=(0, 0, 2), name="s"))
    assert len(pieces) == 3
    check(pieces, u.volume)
    assert sum(t == "s" for p in pieces for t in p.face_tags) == 4
    # along the bottom of the notch: the plane holds a face of the block
    pieces = cut(u, JointSet(0, 0, origin=(0, 0, 1), name="s"))
    assert sorted(round(p.volume, 12) for p in pieces) == [4.0, 4.0, 6.0]
    assert sum(t == "s" for p in pieces for t in p.face_tags) == 4


def test_plane_through_the_tip_of_a_notch_does_not_leave_a_bridge():
    notched = prism([[0, 0], [4, 0], [4, 3], [2, 1], [0, 3]], 2.0)
    pieces = cut(notched, JointSet(0, 0, origin=(0, 0, 1), name="s"))
    assert len(pieces) == 3
    check(pieces, notched.volume)


def test_annulus_is_one_block_and_can_be_cut_again():
    box, tunnel = brick((-10, -10, -10), (10, 10, 10)), horseshoe()
    pieces = split(box, tunnel, "tunnel")
    assert [within for _, within in pieces] == [False, True]
    ring = pieces[0][0]
    check([p for p, _ in pieces], 8000.0)
    # four sides, twelve walls, two ends of two loops each: nothing is cut up further
    assert len(ring.faces) == 4 + 12 + 4
    for plane in (
        JointSet(90, 90, name="v"),
        JointSet(0, 0, name="h"),
        JointSet(0, 0, origin=(0, 0, 2.5), name="crown"),
    ):
        halves = cut(ring, plane)
        assert len(halves) >= 2
        check(halves, ring.volume)
    blocks = [ring]
    for joints in SETS:
        blocks = cut(blocks, joints)
    check(blocks, ring.volume)


def test_section_with_a_hole_is_divided_into_simple_faces():
    ring = split(brick((-10, -10, -10), (10, 10, 10)), horseshoe(), "t")[0][0]
    halves = cut(ring, JointSet(90, 0, name="s"))
    assert len(halves) == 2
    check(halves, ring.volume)
    assert set(faces(halves, "s").values()) == {2}
    for half in halves:
        for face in half.faces:
            assert len(set(face.tolist())) == len(face)
    assert section_area(halves, "s")[1] == pytest.approx(2 * ring.volume / 20.0)


@pytest.mark.parametrize("flush", [True, False])
def test_non_convex_cutter(flush):
    cutter = moved(prism(L_OUTLINE, 20.0 if flush else 30.0), x=-0.9, y=-10.0 if flush else -15.0, z=-0.9)
    box = brick((-10, -10, -10), (10, 10, 10))
    pieces = split(box, cutter, "L")
    assert [within for _, within in pieces] == [False, True]
    assert pieces[1][0].volume == pytest.approx(60.0, rel=1e-12)
    # the parts the cutter was divided into leave no trace
    assert sum(t == "L" for t in pieces[1][0].face_tags) == 6
    parts = [p for b in rock_mass() for p in split(b, cutter, "L")]
    check([p for p, _ in parts], 8000.0)
    assert sum(p.volume for p, within in parts if within) == pytest.approx(60.0, rel=1e-12)
    assert set(faces([p for p, _ in parts], "L").values()) == {2}


def test_faceted_sphere_as_cutter():
    ball = icosphere(3.0, (0.1, 0.2, 0.3), subdivisions=1)
    pieces = [p for b in rock_mass() for p in split(b, ball, "ball")]
    check([p for p, _ in pieces], 8000.0)
    assert sum(p.volume for p, within in pieces if within) == pytest.approx(ball.volume, rel=1e-12)


def test_random_lattice_cuts_keep_the_books():
    """Planes and cutters through corners, edges and faces: everything that can coincide does."""
    rng = np.random.default_rng(5)
    outlines = [
        L_OUTLINE,
        [[0, 0], [4, 0], [4, 4], [3, 4], [3, 1], [1, 1], [1, 4], [0, 4]],
        [[0, 0], [4, 0], [4, 3], [2, 1], [0, 3]],
        [[0, 0], [2, 1], [4, 0], [3, 2], [4, 4], [2, 3], [0, 4], [1, 2]],
    ]

    def anything():
        shape = prism(outlines[rng.integers(4)], float(rng.integers(1, 4)), "xyz"[rng.integers(3)])
        return moved(shape, *rng.integers(-2, 3, 3).astype(float))

    for _ in range(60):
        pieces = [anything()]
        volume = pieces[0].volume
        for _ in range(3):
            if rng.random() < 0.5:
                origin = tuple(rng.integers(-1, 5, 3).tolist())
                cutter = JointSet(
                    float(rng.choice([0, 45, 90])), float(rng.choice([0, 45, 90, 180, 225])), origin=origin
                )
            else:
                cutter = anything()
            try:
                pieces = cut(pieces, cutter)
            except MeshError as error:
                assert "cavity" in str(error)
                break
        check(pieces, volume)


def test_cavity_is_refused_with_advice():
    with pytest.raises(MeshError, match="cavity"):
        split(brick((0, 0, 0), (4, 4, 4)), brick((1, 1, 1), (2, 2, 2)))


def test_only_polyhedra_are_cut():
    mesh = tet_mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2, 3]])
    with pytest.raises(SceneError, match="TetMesh cannot be cut"):
        cut(mesh, JointSet(0, 0))
    with pytest.raises(SceneError, match="shape = int"):
        cut(brick((0, 0, 0), (1, 1, 1)), 3)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("dip", 95.0),
        ("dip", float("nan")),
        ("dip_direction", float("inf")),
        ("spacing", 0.0),
        ("spacing", -1.0),
        ("origin", (0, 0)),
        ("origin", (0, 0, float("nan"))),
        ("persistence", 1.5),
        ("deviation", -1.0),
        ("seed", -1),
        ("seed", 0.5),
        ("name", ""),
    ],
)
def test_joint_set_names_the_bad_field(field, value):
    with pytest.raises(SceneError, match=f"JointSet.*{field}"):
        JointSet(**{"dip": 10.0, "dip_direction": 20.0, field: value})


@pytest.mark.parametrize(("field", "value"), [("radius", 0.0), ("centre", (0, 0)), ("dip", -1), ("dip_direction", "n")])
def test_disc_names_the_bad_field(field, value):
    with pytest.raises(SceneError, match=f"Disc.*{field}"):
        Disc(**{"centre": (0, 0, 0), "dip": 10.0, "dip_direction": 20.0, "radius": 1.0, field: value})
