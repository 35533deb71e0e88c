"""Surfaces, clip and patches: forces and moments of overlaps against closed forms and the oracle."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from contact_tools import World, box, coulomb, grid_box, move, prism, rotation, triangulated

import fdem
from fdem.contact import contacts as contacts_module
from fdem.contact.narrow import cut_pairs
from fdem.errors import OverlapError, SceneError
from fdem.kernels import footprints
from fdem.scene.meshing import zone_meshes

KN = 1e9
ORACLE = Path(__file__).resolve().parents[2] / "shared" / "oracle" / "data" / "contact_energy.json"
CORNER = np.array([[1, -1, 0], [1, 1, -2], [1, 1, 1]]) / np.sqrt([[2], [6], [3]])
EDGE = rotation([0, 1, 0], np.pi / 4)


def on_top(slave, master, depth, x=0.0, y=0.0):
    return move(slave, t=(x, y, master[0][:, 2].max() - slave[0][:, 2].min() - depth))


def resultant(slave, master, **options):
    w = World([slave, master], law=coulomb(kn=KN), **options)
    w.forces()
    w.commit()
    return w, *w.resultant(0)


@pytest.fixture
def first_is_slave(monkeypatch):
    monkeypatch.setattr(contacts_module, "master_first", lambda s, p: (p[:, 0].copy(), p[:, 1].copy()))


def test_face_on_face_is_joint_stiffness_times_closure():
    h = 1e-3
    w, f, _ = resultant(on_top(box(1, 2, 1), box(4, 4, 1), h), box(4, 4, 1), prune=1e-4)
    np.testing.assert_allclose(f, [0, 0, KN * 2 * h], rtol=1e-12, atol=1e-6)
    np.testing.assert_allclose(w.contacts.energy(), KN * 2 * h * h / 2, rtol=1e-12)


def test_cube_corner_in_face(first_is_slave):
    h = 0.03
    _, f, _ = resultant(on_top(move(box(1, 1, 1), CORNER), box(4, 4, 1), h), box(4, 4, 1))
    np.testing.assert_allclose(f, [0, 0, KN * np.sqrt(3) / 2 * h**3], rtol=1e-11, atol=1e-6)


def test_right_angled_edge_in_face():
    h, length = 0.03, 1.0
    w, f, _ = resultant(on_top(move(box(1, length, 1), EDGE), box(4, 4, 1), h), box(4, 4, 1))
    np.testing.assert_allclose(f, [0, 0, KN * length * h**2], rtol=1e-11, atol=1e-5)
    np.testing.assert_allclose(w.contacts.energy(), KN * length * h**3 / 3, rtol=1e-11)


@pytest.mark.parametrize("angle", [90, 30, 5])
def test_two_edges_crossing(first_is_slave, angle):
    h, a = 0.03, np.radians(angle)
    lower = move(box(1, 3, 1), EDGE)
    upper = on_top(move(box(1, 3, 1), rotation([0, 0, 1], a) @ EDGE), lower, h)
    _, f, _ = resultant(upper, lower)
    np.testing.assert_allclose(f, [0, 0, KN * 2 * h**3 / (3 * np.sin(a)) / np.sqrt(2)], rtol=1e-10, atol=1e-5)


@pytest.mark.skipif(not ORACLE.exists(), reason="oracle data not beside the project")
@pytest.mark.parametrize(("prune", "tolerance"), [(0.0, 1e-9), (1e-4, 1e-5)])
def test_oracle_contact_energy(first_is_slave, prune, tolerance):
    for case in json.loads(ORACLE.read_text())["configs"]:
        slave, master = ((np.array(case[k]["points"]), case[k]["faces"]) for k in ("slave", "master"))
        w = World([slave, master], law=coulomb(kn=case["kn"]), prune=prune)
        w.forces()
        w.commit()
        volume, first = 0.0, np.zeros(3)
        for loop in slave[1]:
            for k in range(1, len(loop) - 1):
                a, b, c = (slave[0][loop[i]] for i in (0, k, k + 1))
                v = a @ np.cross(b, c) / 6
                volume, first = volume + v, first + v * (a + b + c) / 4
        f, m = w.resultant(0, first / volume)
        size = np.linalg.norm(case["F"])
        np.testing.assert_allclose(f, case["F"], rtol=0, atol=tolerance * size, err_msg=case["name"])
        np.testing.assert_allclose(m, case["M"], rtol=0, atol=tolerance * size * np.cbrt(volume), err_msg=case["name"])
        np.testing.assert_allclose(w.contacts.energy(), case["W"], rtol=tolerance, err_msg=case["name"])


def upright(outline, length):
    """Prism whose outline stands in the x-z plane, symmetric about y = 0."""
    return move(prism(outline, length), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), (0, 0.5 * length, 0))


TIP = rotation([1, 0, 0], np.pi) @ CORNER
OVERLAPS = {
    "edges": (move(box(1, 3, 1), rotation([0.1, 0.2, 1], 0.7) @ EDGE), move(box(1, 3, 1), EDGE)),
    "corner of the master": (box(2, 2, 1), move(box(1, 1, 1), TIP)),
    "corners": (move(box(1, 1, 1), CORNER), move(box(1, 1, 1), TIP)),
    "edge of the master": (box(1, 1, 1), move(box(1, 1, 1), rotation([0, 0, 1], 0.4) @ EDGE)),
    "groove": (
        box(0.5, 0.5, 0.5),
        upright([[-2, -1], [2, -1], [2, 1], [0.3, 1], [0, 0.4], [-0.2, 1], [-2, 1]], 3.0),
    ),
}


@pytest.mark.parametrize("case", OVERLAPS)
def test_force_is_the_slope_of_the_energy(first_is_slave, case):
    """W(u + h) - W(u - h) = -2 F.h and -2 M.h, also where edges and corners of the master are overlapped."""
    slave, master = OVERLAPS[case]
    start = move(slave, rotation([0.3, 1, 0.2], 0.05))[0]
    start = start + np.array([0.02, 0.03, master[0][:, 2].max() - start[:, 2].min()])
    w = World([(start, slave[1]), master], law=coulomb(kn=KN), clip_always=True)

    def energy(u, turn):
        w.x[: len(start)] = start @ turn.T + u
        w.contacts.update(w.x)
        w.forces()
        w.commit()
        return w.contacts.energy()

    while not energy(np.zeros(3), np.eye(3)) > 0.0:
        start[:, 2] -= 0.01
    start[:, 2] -= 0.03
    assert energy(np.zeros(3), np.eye(3)) > 0.0
    force, moment = (v.copy() for v in w.resultant(0))
    h, slopes, turns = 1e-5, [], []
    for u in np.eye(3):
        slopes.append((energy(-h * u, np.eye(3)) - energy(h * u, np.eye(3))) / (2 * h))
        turns.append((energy(0 * u, rotation(u, -h)) - energy(0 * u, rotation(u, h))) / (2 * h))
    # what is left of the difference quotient is of the order of (h / depth)^2
    np.testing.assert_allclose(slopes, force, rtol=0, atol=1e-6 * np.linalg.norm(force))
    np.testing.assert_allclose(turns, moment, rtol=0, atol=1e-6 * np.linalg.norm(force))


def test_brick_has_six_faces_whatever_the_triangulation():
    for shape in (triangulated(box(1, 2, 3)), grid_box(7, 5)):
        w = World([move(shape, t=(0, 0, 10)), box(1, 1, 1)])
        assert np.diff(w.contacts.surfaces.face_start).tolist() == [6, 6]


def test_l_prism_is_split_into_convex_faces():
    shape = prism([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], 1.0)
    s = World([triangulated(shape), move(box(1, 1, 1), t=(9, 9, 9))]).contacts.surfaces
    assert s.face_start[1] <= 12
    assert s.convex.tolist() == [0, 1]
    assert (s.neighbour >= 0).all()


def test_one_face_or_a_thousand_facets():
    r, t = rotation([1, 0.4, 0], 2e-4), (0.3, -0.2, 0.9999)
    floor = box(4, 4, 1)
    one = World([move(box(1, 1, 1), r, t), floor], law=coulomb(kn=KN))
    shape = grid_box(16, 16)
    many = World(
        [move((shape[0] - 0.5, shape[1]), r, t), floor], law=coulomb(kn=KN), affine=[False, True]
    )  # fmt: skip
    one.forces()
    many.forces()
    (f, m), (g, n) = one.resultant(0, t), many.resultant(0, t)
    assert many.contacts.n_patches > 200
    np.testing.assert_allclose(g, f, rtol=0, atol=1e-11 * f[2])
    np.testing.assert_allclose(n, m, rtol=0, atol=1e-11 * f[2])


def test_momentum_of_contact_forces_vanishes():
    g = np.random.default_rng(3)
    for _ in range(5):
        r = rotation(g.normal(size=3), 2.0)
        w = World([on_top(move(box(1, 1, 1), r), box(2, 2, 1), 0.05, 0.4, 0.7), box(2, 2, 1)], law=coulomb(tan=0.6))
        w.shift(0, [1e-4, 2e-4, 0])
        w.forces()
        size = np.abs(w.f).sum()
        assert np.abs(w.f.sum(0)).max() < 1e-13 * size
        assert np.abs(np.cross(w.x, w.f).sum(0)).max() < 1e-13 * size


def test_patch_test_two_nonmatching_zoned_surfaces():
    d = 1e-5
    lower = grid_box(3, 3, gx=[0, 0.3, 0.7, 1.0], gy=[0, 0.3, 0.7, 1.0])
    grid = np.array([0, 0.22, 0.5, 0.81, 1.0])
    upper = grid_box(4, 4, gx=grid, gy=grid)
    w = World([move(upper, t=(0, 0, 1 - d)), lower], law=coulomb(kn=1e11), affine=[False, False], prune=1e-4)
    f = w.forces()[: len(upper[0])]
    expected = np.zeros(len(f))
    for tri in upper[1]:
        p = upper[0][tri]
        if (p[:, 2] == 0).all():
            expected[tri] += 1e11 * d * np.linalg.norm(np.cross(p[1] - p[0], p[2] - p[0])) / 6
    scale = 1e11 * d
    # 8 eps L / closure, and the ring of width d that the bisector cells leave to the (pruned) side strips
    assert np.abs(f[:, 2] - expected).max() < (8 * np.finfo(float).eps / d + 4 * d) * scale
    interior = (np.abs(upper[0][:, :2] - 0.5) < 0.3).all(1) & (upper[0][:, 2] == 0)
    assert np.abs(f[interior, 2] - expected[interior]).max() < 8 * np.finfo(float).eps / d * scale


def test_conforming_meshes_give_whole_triangles():
    shape = grid_box(4, 4)
    w = World([move(shape, t=(0, 0, 1)), shape], affine=[False, False], prune=1e-4, gap_tolerance=None)
    assert w.contacts.n_patches == 32
    np.testing.assert_allclose(w.contacts.patches.ref_ratio, 1.0, rtol=1e-12)


@pytest.mark.parametrize("shape", ["L", "U"])
def test_cells_tile_the_layer_below_a_nonconvex_surface(first_is_slave, shape):
    """Small slaves anywhere in the layer feel exactly the depth field: no gap, no overlap of cells."""
    outline = {
        "L": [[0, 0], [1, 0], [1, 0.4], [0.4, 0.4], [0.4, 1], [0, 1]],
        "U": [[0, 0], [1.2, 0], [1.2, 1], [0.8, 1], [0.8, 0.4], [0.4, 0.4], [0.4, 1], [0, 1]],
    }[shape]
    parts = {
        "L": [(0, 1, 0, 0.4), (0, 0.4, 0, 1)],
        "U": [(0, 1.2, 0, 0.4), (0, 0.4, 0, 1), (0.8, 1.2, 0, 1)],
    }[shape]
    master = prism(outline, 0.5)
    g = np.random.default_rng(1)
    checked = 0

    def depth(p):
        x, y, z = p.T
        d = [np.minimum.reduce([x - a, b - x, y - c, e - y, z, 0.5 - z]) for a, b, c, e in parts]
        return np.maximum(np.maximum.reduce(d), 0.0)

    for _ in range(40):
        c = np.array([g.uniform(-0.02, 1.2), g.uniform(-0.02, 1.0), g.uniform(-0.02, 0.52)])
        slave = move(box(0.1, 0.12, 0.08), rotation(g.normal(size=3), 3.0), c)
        try:
            w = World([slave, master], law=coulomb(kn=KN))
        except SceneError:
            continue  # deeper than the limit
        w.forces()
        force = w.resultant(0)[0]
        expected = np.zeros(3)
        n = 160
        s, t = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n)
        for loop in slave[1]:
            a, b, e = slave[0][loop[0]], slave[0][loop[1]], slave[0][loop[3]]
            p = a + s.reshape(-1, 1) * (b - a) + t.reshape(-1, 1) * (e - a)
            expected -= KN * depth(p).mean() * np.cross(b - a, e - a)
        scale = max(np.linalg.norm(expected), KN * 1e-6)
        np.testing.assert_allclose(force, expected, rtol=0, atol=2e-3 * scale)
        checked += 1
    assert checked >= 5


def test_tilting_from_face_to_edge_to_corner_is_continuous():
    floor, steps, last, jumps = box(4, 4, 1), 300, None, []
    w = World([on_top(box(1, 1, 1), floor, 0.02), floor], law=coulomb(kn=KN), clip_always=True)
    cube = box(1, 1, 1)[0]
    for k in range(steps + 1):
        a = k / steps
        r = rotation([1, 0, 0], 0.6 * a) @ rotation([0, 1, 0], 0.7 * a)
        p = cube @ r.T
        w.x[:8] = p + np.array([0.1, 0.05, 0.5 - 0.02 - p[:, 2].min()])
        w.contacts.update(w.x)
        f = w.forces()[:8].sum(0)
        assert np.abs(f[:2]).max() < 1e-9 * f[2]
        if last is not None:
            jumps.append(abs(f[2] - last) / (KN * 0.02))
        last = f[2]
    assert max(jumps) < 0.12


def test_bits_do_not_depend_on_the_unit_of_length():
    def run(scale):
        r = rotation([1, 0.3, 0.2], 0.3)
        shape = on_top(move(box(1, 1, 1), r), box(2, 2, 1), 0.03, 0.5, 0.4)
        w = World(
            [(shape[0] * scale, shape[1]), (box(2, 2, 1)[0] * scale, box(2, 2, 1)[1])], law=coulomb(kn=KN), prune=1e-4
        )  # fmt: skip
        return w.forces().copy(), w.contacts.patches

    (f, p), (g, q) = run(1.0), run(1024.0)
    np.testing.assert_array_equal(p.corners, q.corners)
    np.testing.assert_array_equal(f * 1024.0**3, g)


def test_too_deep_is_an_error_with_names():
    floor = box(4, 4, 1)
    with pytest.raises(SceneError, match="'top' and 'floor'"):
        World([on_top(box(1, 1, 1), floor, 0.3), floor], names=["top", "floor"])
    with pytest.raises(SceneError, match="overlap"):
        World([move(box(0.1, 0.1, 0.1), t=(0.01, 0.02, 0.03)), floor])
    w = World([on_top(box(1, 1, 1), floor, 0.2), floor])
    w.shift(0, [0, 0, -0.06])
    with pytest.raises(OverlapError, match="'0' and '1'"):
        w.forces()


def test_reference_gap_closes_rounded_data_and_refuses_more():
    floor = box(4, 4, 1)
    for d in (5e-4, -5e-4):
        w = World([on_top(box(1, 1, 1), floor, d), floor], law=coulomb(kn=KN), gap_tolerance=None, prune=1e-4)
        assert np.abs(w.forces()).max() == 0.0
        w.shift(0, [0, 0, -1e-4])
        np.testing.assert_allclose(w.forces()[:8].sum(0)[2], KN * 1e-4, rtol=1e-9)
    with pytest.raises(SceneError, match="gap_tolerance"):
        World([on_top(box(1, 1, 1), floor, 2e-3), floor], gap_tolerance=None)


def test_open_surface_is_a_master():
    x = np.array([[-2.0, -2, 0.3], [2, -2, 0.3], [2, 2, 0.3], [-2, 2, 0.3], [0, 0, 0.3]])
    terrain = (x, [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    w = World(
        [move(box(1, 1, 1), t=(0.2, 0.3, 0.8 - 1e-3)), terrain], fixed=[False, True], law=coulomb(kn=KN), prune=1e-4
    )
    assert w.contacts.surfaces.open.tolist() == [0, 1]
    np.testing.assert_allclose(w.forces()[:8].sum(0), [0, 0, KN * 1e-3], rtol=1e-10, atol=1e-6)


def test_moment_points_are_exact_to_degree_two():
    g = np.random.default_rng(0)
    for _ in range(20):
        angle = np.sort(g.uniform(0, 2 * np.pi, 7))
        poly = np.ascontiguousarray(np.c_[3 * np.cos(angle), 0.2 * np.sin(angle)] + g.normal(size=2))
        if (np.diff(np.r_[angle, angle[0] + 2 * np.pi]) > np.pi).any():
            continue
        points, ratio, gp, x = (
            np.zeros((1, 3, 2)),
            np.zeros(1),
            np.arange(7, dtype=np.int32)[None],
            g.normal(size=(7, 3)),
        )
        ends, sizes, places = np.array([0, 7], np.int32), np.zeros((4, 1)), np.zeros((3, 1, 3))
        footprints.measure(gp, ends, poly, places[0], x, points, ratio, *sizes, *places[1:])
        exact = np.zeros(3)
        for i in range(1, 6):
            tri = poly[[0, i, i + 1]]
            area = _cross(tri)
            mid = 0.5 * (tri + np.roll(tri, 1, axis=0))
            exact += area / 3 * np.array([(mid[:, 0] ** 2).sum(), (mid[:, 0] * mid[:, 1]).sum(), mid[:, 1].sum()])
        p = points[0]
        got = ratio[0] / 3 * np.array([(p[:, 0] ** 2).sum(), (p[:, 0] * p[:, 1]).sum(), p[:, 1].sum()])
        np.testing.assert_allclose(got, exact, rtol=1e-11)


def _cross(tri):
    a, b = tri[1] - tri[0], tri[2] - tri[0]
    return a[0] * b[1] - a[1] * b[0]


def _pieces(*cutters, half=1.0):
    """Blocks that a cube is cut into: they touch everywhere, and form the cube again."""
    blocks = [fdem.brick((-half,) * 3, (half,) * 3)]
    for cutter in cutters:
        blocks = fdem.cut(blocks, cutter)
    return blocks


def _surface(shape, zoned):
    if not zoned:
        return shape.points, [loop.tolist() for loop in shape.faces]
    mesh = zone_meshes([shape], [zoned])[0]
    used, triangles = np.unique(mesh.triangles, return_inverse=True)
    return mesh.points[used], triangles.reshape(-1, 3).tolist()


def _touching(monkeypatch, surfaces, affine):
    """Deepest contact and, per block, the area of facing patches missing from its surface inside the hull of all."""
    cuts = []

    def recorded(s, geometry, which, slave, master, *rest):
        cuts.append((cut_pairs(s, geometry, which, slave, master, *rest), s, geometry, slave, master))
        return cuts[-1][0]

    monkeypatch.setattr(contacts_module, "cut_pairs", recorded)
    World(surfaces, affine=affine)
    cut, s, geometry, slave, master = cuts[0]
    p = cut.patches
    loops = np.split(geometry.corner_x, s.corner_start[1:-1])
    area = np.array([0.5 * np.linalg.norm(np.cross(q[1:-1] - q[0], q[2:] - q[0]).sum(axis=0)) for q in loops])
    low, high = geometry.corner_x.min(axis=0), geometry.corner_x.max(axis=0)
    outer = np.array([((np.abs(q - low) < 1e-9).all(0) | (np.abs(q - high) < 1e-9).all(0)).any() for q in loops])
    missing = np.bincount(s.face_block, np.where(outer, 0.0, area))
    on = (cut.align > 0.99) & (np.abs(cut.plane_depth).max(axis=1) < 1e-9)
    for side in (slave, master):
        missing -= np.bincount(side[p.pair[on]], cut.area[on], minlength=s.n_blocks)
    return cut.depth.max(), missing


NOTCHES = {
    "L": [[-2, -2], [2, -2], [2, 0.2], [0.1, 0.2], [0.1, 2], [-2, 2]],
    "U": [[-2, -2], [2, -2], [2, 2], [0.6, 2], [0.6, -0.3], [-0.5, -0.3], [-0.5, 2], [-2, 2]],
    "wedge": [[-2, -2], [2, -2], [2, 2], [0.1, 2], [0, -0.9], [-0.1, 2], [-2, 2]],
    "tunnel": [[-0.3, -0.3], [0.3, -0.3], [0.3, 0.3], [-0.3, 0.3]],
}


@pytest.mark.parametrize("zoned", [None, 0.5])
@pytest.mark.parametrize("name", NOTCHES)
def test_nonconvex_blocks_touch_their_neighbours_everywhere_and_overlap_nowhere(monkeypatch, name, zoned):
    lift = np.eye(4)
    lift[2, 3] = -2.0
    cutter = fdem.prism(NOTCHES[name], 4.0, axis="z").transform(lift)
    shapes = _pieces(cutter, fdem.JointSet(12.0, 30.0, origin=(0, 0, 0.13)))
    assert any(not shape.is_convex for shape in shapes)
    depth, missing = _touching(monkeypatch, [_surface(s, zoned) for s in shapes], [zoned is None] * len(shapes))
    assert depth < 1e-9
    assert np.abs(missing).max() < 1e-9


@pytest.mark.parametrize("zoned", [None, 0.7])
@pytest.mark.parametrize("seed", [1, 2, 4])
def test_rock_cut_by_joints_and_a_tunnel_has_no_false_contact(monkeypatch, seed, zoned):
    origin = np.random.default_rng(seed).uniform(-0.3, 0.3, (3, 3))
    arc = np.linspace(0.0, np.pi, 7)
    along = np.eye(4)
    along[1, 3] = -2.0
    profile = np.vstack([0.4 * np.column_stack([np.cos(arc), np.sin(arc)]), [[-0.4, -0.3], [0.4, -0.3]]])
    tunnel = fdem.prism(profile, 4.0, axis="y").transform(along)
    sets = ((70, 11, 0.9), (85, 119, 1.0), (55, 237, 0.9))
    shapes = _pieces(*(fdem.JointSet(*s, origin=o) for s, o in zip(sets, origin, strict=True)), tunnel)
    depth, missing = _touching(monkeypatch, [_surface(s, zoned) for s in shapes], [zoned is None] * len(shapes))
    assert any(not shape.is_convex for shape in shapes)
    assert depth < 1e-9
    assert np.abs(missing).max() < 1e-9


@pytest.mark.parametrize("zoned", [False, True])
@pytest.mark.parametrize("shift", [0.0, 1e-9, -1e-9])
def test_a_face_that_lies_in_a_wall_belongs_to_one_cell(first_is_slave, zoned, shift):
    """Half an edge's overlap: the slave's face cuts through the master's edge along the bisector. F = kn V along z."""
    h, length = 0.03, 1.0
    corner = np.array([1, 0, 1]) - h * np.array([1, 0, 1]) / np.sqrt(2) + shift * np.array([1, 0, -1])
    slave = move(box(1, length, 1), EDGE, corner - EDGE @ [0.5, 0, -0.5])
    master = triangulated(box(2, 2, 2)) if zoned else box(2, 2, 2)
    _, f, _ = resultant(slave, master, affine=[True, not zoned])
    np.testing.assert_allclose(f, [0, 0, KN * length * h**2 / 2], rtol=0, atol=1e-6 * KN * h**2)


def test_a_side_above_a_mesh_line_pushes(first_is_slave):
    """A vertical side right over a line between two triangles of the floor: its strip balances the one opposite."""
    floor = grid_box(8, 2, size=(0.4, 0.4, 0.3))
    for at in (0.15, 0.1500001):
        block = move(box(0.1, 0.1, 0.1), t=(at, 0.21, 0.35 - 1e-3))
        _, f, _ = resultant(block, floor, affine=[True, False])
        np.testing.assert_allclose(f, [0, 0, KN * 1e-3 * 0.01], rtol=0, atol=1e-9 * KN * 1e-5)
