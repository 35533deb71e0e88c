"""Trees over faces: the same thickness and the same patches as a look at all faces, at a cost that grows with them."""

from __future__ import annotations

import time

import numpy as np
import pytest
from bodies import rotation
from stress.meshes import box_mesh

import fdem
from fdem.contact.depth import few_convex
from fdem.contact.surface import FaceGeometry
from fdem.kernels import clipping, geometry, trees

ROCK = fdem.Elastic(2500.0, 1e9, 0.2)


def bent(cells, upper, lower, amplitude, phase, turn, lift=0.0):
    """Lattice of tetrahedra whose layers are waves, turned."""
    points, tets = box_mesh(cells, upper, lower, jitter=0.2)
    points[:, 2] += lift + amplitude * np.sin(3 * points[:, 0] + phase) * np.cos(4 * points[:, 1] + phase)
    return fdem.tet_mesh(points @ turn.T, tets)


def star(n, seed, height, scale=1.0):
    """Prism over a random star of n corners, n / 4 of them re-entrant or more."""
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    r = scale * (1 + 0.3 * np.random.default_rng(seed).uniform(-1, 1, n))
    return fdem.prism(np.c_[r * np.cos(angle), r * np.sin(angle)], height, "z")


def contacts_of(shapes, body):
    scene = fdem.Scene(gravity=(0, 0, 0))
    for shape in shapes:
        scene.add(shape, body, ROCK)
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
    sim = fdem.Simulation(scene, fdem.Explicit(), energy=False, progress=False)
    return sim.system.contacts, sim.state.x.copy()


def waves(seed):
    """Two bent lattices that lie on each other, contacts and the direction from the lower to the upper."""
    rng = np.random.default_rng(seed)
    turn = rotation(rng.normal(size=3), rng.uniform(0, 3)) if seed else np.eye(3)
    amplitude, phase = (0.0, 0.02, 0.06, 0.1)[seed % 4], rng.uniform(0, 6)
    low = bent((6, 5, 2), (1, 1, 0), (0, 0, -0.4), amplitude, phase, turn)
    high = bent((5, 6, 2), (1.2, 0.9, 0.4), (0.1, 0.05, 0), amplitude, phase, turn, lift=0.2 * amplitude + 1e-3)
    return *contacts_of([low, high], fdem.Zoned(mass="inertia-matched")), turn[:, 2]


def lattices(seed):
    """Sides of one lattice stand in lines of the other, up to round-off: the wall there belongs to one of two cells."""
    low = box_mesh((10, 10, 2), (1, 1, 0), (0, 0, -0.4))
    high = box_mesh((3, 3, 2), (0.6, 0.6, 0.401), (0.3, 0.3, 1e-3))
    turn = rotation((1, 2, 3), 0.7 * seed)
    shapes = [fdem.tet_mesh(points @ turn.T, tets) for points, tets in (low, high)]
    return *contacts_of(shapes, fdem.Zoned(mass="inertia-matched")), turn[:, 2]


def stars(seed):
    """A concave prism on another."""
    low, high = star(60, seed, 0.5), star(40, seed + 7, 0.3, 0.7)
    move = np.eye(4)
    move[2, 3] = low.points[:, 2].max() - high.points[:, 2].min() + 1e-3
    return *contacts_of([low, high.transform(move)], fdem.Rigid()), np.array([0, 0, 1.0])


def ball(seed):
    """A fine rigid ball on a coarse one: convex blocks of many faces."""
    low = fdem.icosphere(0.5, subdivisions=2)
    high = fdem.icosphere(0.3, subdivisions=3)
    turn = np.eye(4)
    turn[:3, :3] = rotation((1, 2, seed), 0.3 + seed)
    turn[2, 3] = 0.8 + 1e-3
    return *contacts_of([low, high.transform(turn)], fdem.Rigid()), np.array([0, 0, 1.0])


def inputs(c, x):
    """Arguments of `face_pairs` and of the rest of `clip_faces` for all pairs in the positions x."""
    s, g = c.surfaces, c._geometry
    g.refresh(s, x, np.arange(s.n_blocks, dtype=np.int32))
    size, most = np.minimum(s.size[c.slave], s.size[c.master]), np.minimum(s.most[c.slave], s.most[c.master])
    pairs = (
        c.slave, c.master, c._window, size, s.face_start, s.corner_start, s.limit, s.deep, s.convex, g.corner_x,
        g.normal, g.lower, g.upper, g.block_lower, g.block_upper, g.lean, g.tree,
    )  # fmt: skip
    clip = (
        c.master, c._window, size, most, int(np.diff(s.corner_start).max()), s.face_start, s.corner_start,
        s.corner_w, s.ref, s.limit, s.mixed, s.affine, s.open, x, g.corner_x, g.normal, g.wall, g.kind,
    )  # fmt: skip
    return pairs, clip


def all_faces(c):
    """What a clip takes that leaves nothing out: all faces of slave and master, one leaf per block that holds all."""
    s, g = c.surfaces, c._geometry
    faces = [
        np.array([(a, f) for f in range(*s.face_start[m : m + 2]) for a in range(*s.face_start[b : b + 2])], np.int32)
        for b, m in zip(c.slave, c.master, strict=True)
    ]
    start = np.r_[0, np.cumsum([len(f) for f in faces])]
    around = np.tile([[-1e9] * 3, [1e9] * 3], (len(faces), 1, 1))
    first = np.arange(s.n_blocks + 1, dtype=np.int32)
    nodes = np.column_stack([first[1:], s.face_start[:-1], s.face_start[1:]]).astype(np.int32)
    bounds = np.tile([-np.inf] * 3 + [np.inf] * 3 + [-1.0] * 3 + [1.0] * 6, (s.n_blocks, 1))
    tree = (first, nodes, np.arange(s.n_faces, dtype=np.int32), bounds)
    search = g.lower, g.upper, np.ones((s.n_faces, 3)), tree, np.empty(s.n_faces, np.int32)
    return (start, np.concatenate(faces), around), search


@pytest.mark.parametrize("depth", [-1e-4, 1e-5, 4e-3, 2e-2])
@pytest.mark.parametrize(
    ("make", "seed"), [*((waves, k) for k in range(4)), (lattices, 0), (lattices, 1), (stars, 1), (ball, 3)]
)
def test_patches_are_those_of_a_look_at_all_faces(make, seed, depth):
    """Bit for bit: what the search leaves out has no part in any patch."""
    c, x, up = make(seed)
    s = c.surfaces
    upper = s.surface_gp[s.surface_start[1] : s.surface_start[2]]
    x[upper] -= (depth + 1e-3) * up
    pairs, clip = inputs(c, x)
    near = geometry.face_pairs(*pairs)
    key, corners, margin, *_, deep = clipping.clip_faces(*near, *clip, c._geometry.search)
    every, flat = all_faces(c)
    key_all, corners_all, margin_all, *_, deep_all = clipping.clip_faces(*every, *clip, flat)
    assert len(key) > 3
    assert len(near[1]) < 0.35 * len(every[1])
    np.testing.assert_array_equal(key, key_all)
    np.testing.assert_array_equal(corners, corners_all)
    np.testing.assert_array_equal(margin, margin_all)
    np.testing.assert_array_equal(deep, deep_all)


def thicknesses(s, g):
    """Distance [m] along the ray from the centroid of every triangle into the block, from all faces."""
    x = g.corner_x.reshape(-1, 3, 3)
    origin, n = x.mean(axis=1), g.normal
    out = np.full(len(x), np.inf)
    for b in range(s.n_blocks):
        faces = np.arange(*s.face_start[b : b + 2])
        p, m = x[faces], n[faces]
        for f in faces:
            slope = m @ n[f]
            t = np.einsum("gk,gk->g", m, origin[f] - p[:, 0]) / np.where(slope < -1e-6, slope, np.nan)
            hit = origin[f] - t[:, None] * n[f]
            turn = np.cross(np.roll(p, -1, axis=1) - p, hit[:, None] - p)
            above = (np.einsum("gck,gk->gc", turn, m) >= 0).all(axis=1)
            out[f] = np.min(t[above & (t > 0)], initial=np.inf)
    return out


@pytest.mark.parametrize("seed", range(4))
def test_thickness_is_that_of_a_look_at_all_faces(seed):
    c, x, _ = waves(seed)
    s, g = c.surfaces, c._geometry
    g.refresh(s, x, np.arange(s.n_blocks, dtype=np.int32))
    found = np.zeros(s.n_faces)
    geometry.thickness(s.face_start, s.corner_start, g.corner_x, g.normal, s.convex, s.open, g.tree, found)
    np.testing.assert_allclose(found, thicknesses(s, g), rtol=1e-12)  # round-off of the crossing


def test_extent_of_a_convex_block_is_that_of_all_its_corners():
    c, x, _ = ball(0)
    s, g = c.surfaces, c._geometry
    g.refresh(s, x, np.arange(2, dtype=np.int32))
    found = np.zeros(s.n_faces)
    geometry.thickness(s.face_start, s.corner_start, g.corner_x, g.normal, s.convex, s.open, g.tree, found)
    assert s.convex.all()
    for b in range(2):
        corners = g.corner_x[s.corner_start[s.face_start[b]] : s.corner_start[s.face_start[b + 1]]]
        for f in range(*s.face_start[b : b + 2]):
            deepest = ((g.corner_x[s.corner_start[f]] - corners) @ g.normal[f]).max()
            np.testing.assert_allclose(found[f], deepest, rtol=1e-12)


def stack(seed):
    """Turned convex blocks of few faces that press on each other: prisms of 3 to 12 sides and a brick."""
    rng, up = np.random.default_rng(seed), 0.0
    shapes = []
    for n in (4, 3, 7, 12):
        angle = 2 * np.pi * (np.arange(n) + rng.uniform()) / n
        shapes.append(fdem.prism(np.c_[np.cos(angle), np.sin(angle)], 0.5, "z"))
        move = np.eye(4)
        move[2, 3] = up - shapes[-1].points[:, 2].min()
        shapes[-1] = shapes[-1].transform(move)
        up = shapes[-1].points[:, 2].max() - 1e-4
    whole = np.eye(4)
    whole[:3, :3] = rotation(rng.normal(size=3), rng.uniform(0, 3))
    return contacts_of([shape.transform(whole) for shape in shapes], fdem.Rigid())


@pytest.mark.parametrize("seed", range(4))
def test_convex_blocks_of_few_faces_need_no_tree(seed):
    """Bit for bit the same pairs of faces, patches and thickness as by the search that other scenes compile."""
    c, x = stack(seed)
    s, g = c.surfaces, c._geometry
    assert s.tree is None
    pairs, clip = inputs(c, x)
    bare = geometry.face_pairs(*pairs)
    found = clipping.clip_faces(*bare, *clip, g.search)
    s.tree = trees.plant(s.face_start, g.lower, g.upper)
    g = c._geometry = FaceGeometry.of(s)
    pairs, clip = inputs(c, x)
    searched = geometry.face_pairs(*pairs)
    for one, other in zip(bare[:2], searched[:2], strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(found[0]) > 3
    for one, other in zip(found, clipping.clip_faces(*searched, *clip, g.search), strict=True):
        np.testing.assert_array_equal(one, other)
    surfaces, thickness, room = (s.face_start, s.corner_start, g.corner_x, g.normal), np.zeros(s.n_faces), s.room * 0
    few_convex(*surfaces, thickness, room)
    by_kernel, deepest = thickness * 0, room * 0
    geometry.thickness(*surfaces, s.convex, s.open, g.tree, by_kernel)
    geometry.deepest(*surfaces, s.convex, s.open, deepest)
    np.testing.assert_array_equal(thickness, by_kernel)
    np.testing.assert_array_equal(room, deepest)


def plates(cells):
    """Two plates of so many and three more cells along an edge lie on each other."""
    low = fdem.tet_mesh(*box_mesh((cells, cells, 1), (1, 1, 0), (0, 0, -0.2)))
    high = fdem.tet_mesh(*box_mesh((cells + 3, cells + 3, 1), (1, 1, 0.2)))
    return contacts_of([low, high], fdem.Zoned(mass="row-sum"))


def test_pairs_of_faces_and_nodes_looked_at_do_not_grow_with_the_number_of_faces():
    """Per patch; four times the faces. A window of fixed width would take four times as many, a sweep twice."""
    per_patch, per_face = [], []
    for cells in (20, 40):
        c, x = plates(cells)
        s, g = c.surfaces, c._geometry
        near = geometry.face_pairs(*inputs(c, x)[0])
        per_patch.append(len(near[1]) / c.n_patches)
        bounds, first, last = g.tree[3], g.tree[0][0], g.tree[0][1]
        up = [f for f in range(s.face_start[1]) if g.normal[f, 2] > 0.9]
        met = [  # a search enters the children of the nodes it meets
            (bounds[first:last, :3] <= g.upper[f]).all(axis=1) & (bounds[first:last, 3:6] >= g.lower[f]).all(axis=1)
            for f in up
        ]
        per_face.append(2 * np.mean(np.sum(met, axis=1)))
    assert per_patch[1] < 1.3 * per_patch[0]
    assert per_face[1] < 1.5 * per_face[0]  # the depth of the tree: logarithm
    assert per_face[1] < 0.1 * (last - first)


def test_set_up_grows_with_the_number_of_faces():
    """Trees, thickness, pairs and clip at four times the faces: less than seven times the CPU time (square: 16)."""
    cost = []
    for cells in (24, 48):
        c, x = plates(cells)
        s, spent = c.surfaces, []
        for _ in range(3):
            begin = time.process_time()
            s._measure(x)
            pairs, clip = inputs(c, x)
            clipping.clip_faces(*geometry.face_pairs(*pairs), *clip, c._geometry.search)
            spent.append(time.process_time() - begin)
        cost.append(min(spent))
    assert cost[1] < 7 * cost[0]


def test_trees_hold_every_face_once_and_bound_what_they_hold():
    c, x, _ = waves(3)
    s = c.surfaces
    g = FaceGeometry.of(s)
    g.refresh(s, x, np.arange(s.n_blocks, dtype=np.int32))
    node_start, nodes, order, bounds = g.tree
    for b in range(s.n_blocks):
        faces = np.arange(*s.face_start[b : b + 2])
        leaves = [i for i in range(*node_start[b : b + 2]) if nodes[i, 0] == i + 1]
        np.testing.assert_array_equal(np.sort(np.concatenate([order[slice(*nodes[i, 1:])] for i in leaves])), faces)
    for i, (_, begin, end) in enumerate(nodes):
        held = order[begin:end]
        np.testing.assert_array_equal(bounds[i, :3], g.lower[held].min(axis=0))
        np.testing.assert_array_equal(bounds[i, 3:6], g.upper[held].max(axis=0))
        np.testing.assert_array_equal(bounds[i, 6:9], g.normal[held].min(axis=0))
        np.testing.assert_array_equal(bounds[i, 9:12], g.normal[held].max(axis=0))
        np.testing.assert_array_equal(bounds[i, 12:], g.lean[held].max(axis=0))
