"""One surface mesh for what the faces of two blocks have in common: bond, cuts that stop, crossing edges, sizes."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter

import numpy as np
import pytest
from scenes import STONE, assert_same_bits, everything, simulation
from test_meshing import check, notched

import fdem
from fdem.contact.response import slip_energies
from fdem.errors import MeshError
from fdem.kernels.patches import FLAT
from fdem.scene import gmsh_session, meshing, overlay
from fdem.scene.interfaces import Interfaces, cell_key
from fdem.scene.meshing import zone_meshes


def corner_sets(mesh, chosen=None):
    """Triangles of a surface as sets of corners, rounded to 1e-8 m."""
    triangles = mesh.triangles if chosen is None else mesh.triangles[chosen]
    return [frozenset(map(tuple, t)) for t in (np.round(mesh.points[triangles], 8) + 0.0).tolist()]


def inner(mesh, lower, upper):
    """Mask of triangles that do not lie on the sides of a box."""
    corners = mesh.points[mesh.triangles]
    on = (np.abs(corners - lower) < 1e-7) | (np.abs(corners - upper) < 1e-7)
    return ~on.all(axis=1).any(axis=1)


def matched(meshes, lower, upper):
    """Part of the area inside a box that has the same triangle on the other side; no triangle may be there thrice."""
    count, area = Counter(), {}
    for mesh in meshes:
        chosen = inner(mesh, lower, upper)
        p = mesh.points[mesh.triangles[chosen]]
        sizes = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
        for key, size in zip(corner_sets(mesh, chosen), sizes.tolist(), strict=True):
            count[key] += 1
            area[key] = size
    assert max(count.values()) <= 2
    total = sum(area[key] * n for key, n in count.items())
    return sum(2 * area[key] for key, n in count.items() if n == 2) / total


def checked(shapes, sizes, notes=None):
    """Zone meshes of blocks, each closed, filled and with its faces complete."""
    meshes = zone_meshes(shapes, sizes, None, notes)
    for mesh, shape in zip(meshes, shapes, strict=True):
        check(mesh, shape)
    return meshes


def bond():
    """Two bricks on two others, the joint of the upper ones in the middle of the lower ones'."""
    ends = [(0.0, 1.0), (1.0, 2.0)]
    low = [fdem.brick((a, 0, 0), (b, 0.6, 0.5)) for a, b in ends]
    high = [fdem.brick((a - 0.4, 0, 0.5), (b - 0.4, 0.6, 1)) for a, b in ends]
    return low + high


def crossed():
    """A cube halved by a plane; the lower half is cut one way, the upper one another way: edges cross in the plane."""
    low, high = fdem.cut(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.JointSet(15, 70, origin=(0.5, 0.5, 0.5)))
    low = fdem.cut(low, fdem.JointSet(85, 20, origin=(0.45, 0.5, 0.5)))
    return low + fdem.cut(high, fdem.JointSet(80, 110, origin=(0.5, 0.6, 0.5)))


def rock(persistence=0.7, seed=3):
    """A jointed cube of 10 m: cuts stop at earlier ones, so that most faces meet in part only."""
    shapes = [fdem.brick((0, 0, 0), (10, 10, 10))]
    for k, (dip, direction) in enumerate([(75, 40), (65, 160), (20, 280)]):
        joints = fdem.JointSet(
            dip, direction, spacing=3.5, origin=(5, 5, 5), deviation=2, persistence=persistence, seed=10 * seed + k
        )
        shapes = fdem.cut(shapes, joints)
    return shapes


# ---------------------------------------------------------------------------------------------------------------------


def test_bricks_in_bond_share_all_triangles():
    shapes, notes = bond(), []
    meshes = checked(shapes, [0.3] * 4, notes)
    joint = [np.all(np.abs(m.points[m.triangles][:, :, 2] - 0.5) < 1e-12, axis=1) for m in meshes]
    low = Counter(key for m, on in zip(meshes[:2], joint[:2], strict=True) for key in corner_sets(m, on))
    high = Counter(key for m, on in zip(meshes[2:], joint[2:], strict=True) for key in corner_sets(m, on))
    # the upper course stands out by 0.4 m on the left, the lower one on the right
    common = {key for key in high if all(0.0 <= x for x, _, _ in key)}
    assert common == {key for key in low if all(x <= 1.6 for x, _, _ in key)} and len(common) > 30
    assert notes == ["zones: 5 common faces of blocks carry one surface mesh"]  # two upright joints, three overlaps


def test_edges_that_cross_get_a_node_of_their_own():
    shapes = crossed()
    assert len(shapes) == 4
    meshes = checked(shapes, [0.35] * 4)
    assert matched(meshes, 0.0, 1.0) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("size", [1.0, 2.5])
def test_cuts_that_stop(size):
    shapes = rock()
    meshes = checked(shapes, [size] * len(shapes))
    # what is left out are overlaps that would need cells finer than a fifth of the zones; whole polygons alone: 0.5
    assert matched(meshes, 0.0, 10.0) > 0.9


@pytest.mark.parametrize("seed", range(4))
def test_every_block_stays_closed(seed):
    """Sets of any orientation, discs, an opening: sizes differ or are not given."""
    rng = np.random.default_rng(seed)
    shapes = [fdem.brick((0, 0, 0), (10, 10, 10))]
    for k in range(3):
        joints = fdem.JointSet(
            rng.uniform(0, 90), rng.uniform(0, 360), spacing=rng.uniform(3, 5), origin=(5, 5, 5), persistence=0.6,
            seed=100 * seed + k,
        )  # fmt: skip
        shapes = fdem.cut(shapes, joints)
    shapes = fdem.cut(shapes, fdem.Disc(tuple(rng.uniform(2, 8, 3)), 40, rng.uniform(0, 360), 3.0))
    shapes = fdem.cut(shapes, fdem.brick((3.1, -1, 3.2), (6.2, 11, 5.7)))
    sizes = [None if x < 0.3 else 1.2 if x < 0.6 else 2.4 for x in rng.uniform(size=len(shapes))]
    notes = []
    meshes = checked(shapes, sizes, notes)
    assert matched(meshes, 0.0, 10.0) > 0.5
    assert not any("their own" in note for note in notes)


def test_the_finer_size_wins_also_on_a_part_of_a_face():
    meshes = checked(bond(), [1.0, 1.0, 0.15, 1.0])
    p = meshes[0].points[meshes[0].triangles]
    top = np.all(np.abs(p[:, :, 2] - 0.5) < 1e-12, axis=1)
    edges = np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2).max(axis=1)
    fine = top & (p[:, :, 0].max(axis=1) < 0.6 + 1e-9)
    assert edges[fine].max() < 0.15 * 1.6 < 0.4 < edges[top & ~fine].max()
    assert set(corner_sets(meshes[0], fine)) <= set(corner_sets(meshes[2]))


def test_a_block_without_size_beside_a_finer_one_is_joined_to_its_centroid():
    shapes = bond()
    meshes = checked(shapes, [None, None, 0.2, 0.2])
    assert matched(meshes[:3], (-0.4, 0, 0), (2, 0.6, 1)) > 0.3
    for mesh, shape in zip(meshes[:2], shapes[:2], strict=True):
        assert len(mesh.tets) == len(mesh.triangles) > 12
        inside = np.setdiff1d(np.arange(len(mesh.points)), mesh.triangles)
        np.testing.assert_allclose(mesh.points[inside], [shape.centroid], atol=1e-12)


def test_blocks_that_ask_for_no_size_stay_as_coarse_as_they_can_be():
    meshes = checked(bond(), [None] * 4)
    assert [len(mesh.tets) for mesh in meshes] == [12] * 4
    shapes = rock(persistence=1.0)
    meshes = checked(shapes, [None] * len(shapes))
    assert matched(meshes, 0.0, 10.0) == pytest.approx(1.0, abs=1e-12)
    assert sum(len(mesh.tets) for mesh in meshes) == sum(len(shape.triangles) for shape in shapes)


def test_no_size_needs_no_gmsh_whatever_the_faces():
    code = (
        "import sys\n"
        "import fdem\nfrom fdem.scene.meshing import zone_meshes\n"
        "shapes = fdem.wall(2.0, 0.6, 0.3, (0.5, 0.2, 0.3))\n"
        "zone_meshes(shapes, [None] * len(shapes)); assert 'gmsh' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("offset", [1e-7, 1e-3, 0.03])
def test_overlaps_finer_than_the_zones_are_left_to_meshes_of_their_own(offset):
    shapes = [fdem.brick((0, 0, 0), (1, 1, 1)), fdem.brick((offset, 0, 1), (1 + offset, 1, 2))]
    notes: list[str] = []
    meshes = checked(shapes, [0.4, 0.4], notes)
    alone = [checked([shape], [0.4])[0] for shape in shapes]
    for mesh, own in zip(meshes, alone, strict=True):
        assert np.array_equal(mesh.points, own.points) and np.array_equal(mesh.tets, own.tets)
    assert notes == [
        "zones: 1 overlaps of faces are left to independent meshes, a common one would be much finer than the zones"
    ]


def test_two_nodes_close_together_on_one_edge():
    """Joints on two sides of a block meet its edge 1 mm apart: the smaller side is given up, the block stays closed."""
    low = fdem.brick((0, 0, 0), (2, 1, 1))
    top = [fdem.brick((0, 0, 1), (0.8, 1, 2)), fdem.brick((0.8, 0, 1), (2, 1, 2))]
    front = [fdem.brick((0, -0.8, 0), (0.801, 0, 0.9)), fdem.brick((0.801, -0.8, 0), (2, 0, 0.9))]
    shapes = [low, *top, *front]
    meshes = checked(shapes, [0.5] * 5)
    assert matched([meshes[0], *meshes[1:3]], (0, 0, 0), (2, 1, 2)) == 1.0
    edges = np.concatenate([m.points[m.triangles] - np.roll(m.points[m.triangles], 1, axis=1) for m in meshes])
    assert np.linalg.norm(edges, axis=2).min() > 0.1


def test_what_is_left_of_a_face_may_have_a_hole():
    shapes = [fdem.brick((0, 0, 0), (3, 3, 1)), fdem.brick((1, 1.1, 1), (2, 2.2, 2))]
    meshes = checked(shapes, [0.5, 0.5])
    p = meshes[0].points[meshes[0].triangles]
    middle = p.mean(axis=1)
    under = np.all(np.abs(p[:, :, 2] - 1) < 1e-12, axis=1) & (np.abs(middle[:, :2] - [1.5, 1.65]) < [0.5, 0.55]).all(1)
    assert set(corner_sets(meshes[0], under)) <= set(corner_sets(meshes[1])) and under.sum() > 10


def test_equal_corners_do_not_make_equal_polygons():
    assert cell_key([4, 7, 2, 9]) == cell_key([2, 9, 4, 7]) == cell_key([7, 4, 9, 2])
    assert cell_key([4, 7, 2, 9]) != cell_key([7, 4, 2, 9])


def test_a_needle_at_a_corner_is_meshed():
    """An edge of 1e-5 of the block: the zone on the small face is what TetMesh takes too."""
    far = fdem.cut(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.JointSet(54.7, 45, origin=(1 - 1e-5, 1, 1)))
    body = max(far, key=lambda shape: shape.volume)
    assert len(body.faces) == 7
    (mesh,) = checked([body], [None])
    assert len(mesh.tets) == len(mesh.triangles)


# ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1024.0, 2.0**-10])
def test_powers_of_two_scale_the_mesh_to_the_bit(scale):
    shapes = crossed() + [shape.transform(np.diag([2.0, 2.0, 2.0, 1.0])) for shape in bond()]
    matrix = np.diag([scale, scale, scale, 1.0])
    one = zone_meshes(shapes, [0.4] * len(shapes))
    two = zone_meshes([shape.transform(matrix) for shape in shapes], [0.4 * scale] * len(shapes))
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.points * scale, b.points) and np.array_equal(a.tets, b.tets)
        assert np.array_equal(a.triangles, b.triangles)


@pytest.mark.parametrize(
    ("scale", "shift"), [(1e3, 0.0), (1e-3, 0.0), (1.0, np.array([4.5e5, 5.3e6, 900.0]))], ids=["mm", "km", "UTM"]
)
def test_same_topology_in_any_unit_and_place(scale, shift):
    shapes = rock(seed=5)
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = shift
    one = zone_meshes(shapes, [1.5] * len(shapes))
    two = zone_meshes([shape.transform(matrix) for shape in shapes], [1.5 * scale] * len(shapes))
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.tets, b.tets) and np.array_equal(a.triangles, b.triangles)
        np.testing.assert_allclose((b.points - shift) / scale, a.points, atol=1e-7)


def test_the_same_bits_again():
    shapes = rock(seed=6)
    one = zone_meshes(shapes, [1.5] * len(shapes))
    gmsh_session._cache.clear()
    for a, b in zip(one, zone_meshes(shapes, [1.5] * len(shapes)), strict=True):
        assert np.array_equal(a.points, b.points) and np.array_equal(a.tets, b.tets)


def test_gmsh_failing_on_a_shared_surface_is_told(monkeypatch):
    """The block then has a surface mesh of its own; if that fails too it is an error."""
    shapes = [notched(), fdem.brick((-1, 0, 0), (0, 1, 3))]
    fill, shared = meshing.fill_surface, zone_meshes(shapes, [0.6, 0.2])
    assert matched(shared, (-1, 0, 0), (2, 1, 3)) > 0.3
    refused = len(shared[0].triangles)
    monkeypatch.setattr(
        meshing, "fill_surface", lambda g, x, t, *more: None if len(t) == refused else fill(g, x, t, *more)
    )
    notes: list[str] = []
    meshes = checked(shapes, [0.6, 0.2], notes)
    assert len(meshes[0].triangles) < refused and np.array_equal(meshes[1].tets, shared[1].tets)
    assert notes[-1].startswith("zones: 1 blocks (0) have surface meshes of their own")
    monkeypatch.setattr(meshing, "fill_surface", lambda *args: None)
    with pytest.raises(MeshError, match="block 0"):
        zone_meshes(shapes, [0.6, 0.2])


# ---------------------------------------------------------------------------------------------------------------------


def halves(size):
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((0, 0, 0), (2, 2, 2)), fdem.Zoned(size=size), STONE, name="block")
    scene.cut(fdem.JointSet(20, 70, origin=(1, 1, 1), name="joint"))
    scene.joint(fdem.Coulomb(kn=2e9, ks=1e9, friction=35))
    return scene


def whole(sim, contacts):
    """Patches of faces lying against each other: their number, and how many are a triangle that both sides have."""
    p, s, x = contacts.patches, contacts.surfaces, sim.state.x
    flat = (p.flags & FLAT) > 0
    own, other = (np.sort(x[s.ref[face[flat], :3]].round(8).reshape(-1, 3, 3), axis=1) for face in (p.face_s, p.face_m))
    return int(flat.sum()), int(np.all(own == other, axis=(1, 2)).sum())


@pytest.mark.parametrize("size", [None, 0.5, 0.3])
def test_a_shared_triangle_is_one_patch(size):
    """Also when cut anew after closure and sliding of 1e-6 of the block: strips weigh less than 1e-4 of a triangle."""
    sim = simulation(halves(size))
    contacts = sim.system.contacts
    joint = (contacts.surfaces.tag >= 0).sum() // 2
    assert whole(sim, contacts) == (joint, joint)
    assert np.ptp(contacts.patches.ref_ratio[(contacts.patches.flags & FLAT) > 0] - 1.0) < 1e-9
    normal = fdem.JointSet(20, 70).normal
    along = np.cross(normal, (0, 0, 1.0))
    x = sim.state.x.copy()
    x[slice(*sim.model.gp_range[1])] += 2e-6 * along / np.linalg.norm(along) - 1e-5 * normal
    before = contacts.n_cuts
    contacts._replace(np.arange(len(contacts.pairs), dtype=np.int32), x, slip_energies(contacts))
    assert contacts.n_cuts > before
    assert whole(sim, contacts) == (joint, joint)


def test_a_wall_in_bond_has_a_third_of_the_patches(monkeypatch):
    def patches():
        scene = fdem.Scene()
        scene.add(fdem.wall(2.0, 1.0, 0.3, (0.5, 0.2, 0.3)), fdem.Zoned(size=0.15), STONE, name="brick")
        scene.joint(fdem.Coulomb(kn=1e10, ks=5e9, friction=35))
        sim = simulation(scene)
        return whole(sim, sim.system.contacts)

    n, n_whole = patches()
    assert n == n_whole
    monkeypatch.setattr(Interfaces, "_link", lambda self, a, b: [])
    assert patches()[0] > 2.5 * n


def test_notes_are_in_the_description():
    sim = simulation(halves(0.5))
    assert "1 common faces of blocks carry one surface mesh" in sim.describe()


def test_zones_are_a_function_of_the_scene_not_of_what_was_excavated():
    """A scene built again and started from a state in which the finer neighbour is gone fits that state."""

    def build():
        scene = fdem.Scene()
        scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Zoned(size=0.8), STONE, name="stays")
        scene.add(fdem.brick((0.4, 0, 1), (1.4, 1, 2)), fdem.Zoned(size=0.3), STONE, name="goes")
        scene.fix("stays", where=lambda x: x[:, 2] < 1e-9)
        scene.joint(fdem.Coulomb(kn=2e9, ks=1e9, friction=35))
        return scene

    sim = simulation(build())
    before = len(sim.model.zones[: sim.model.zone_start[1]])
    sim.excavate("goes")
    again = simulation(build(), start=sim)
    assert again.model.names == ["stays"] and len(again.model.zones) == len(sim.model.zones) == before
    assert np.array_equal(again.positions(), sim.positions())


@pytest.mark.parametrize("body", [fdem.Zoned(size=0.4), fdem.Rigid()])
def test_a_block_added_to_a_state_leaves_zones_and_places_of_the_others(tmp_path, body):
    """The newcomer lies across the joint of the others and shifts the middle of the scene; load and sag go on."""
    scene = fdem.Scene()
    for k in range(2):
        scene.add(fdem.brick((k, 0, 0), (k + 1, 1, 1)), fdem.Zoned(size=0.5), STONE, name=f"old{k}")
    scene.fix(("old0", "old1"), where=lambda x: x[:, 2] < 1e-9)
    scene.joint(fdem.Coulomb(kn=2e9, ks=1e9, friction=35))
    sim = simulation(scene, fdem.Relaxation())
    sim.cycle(60)
    scene.add(fdem.brick((0.3, 0, 1), (1.3, 1, 2.5)), body, STONE, name="new")
    more = simulation(scene, fdem.Relaxation(), start=sim)
    zones = more.model.zones[: len(sim.model.zones)]
    assert np.array_equal(zones, sim.model.zones)
    assert np.array_equal(more.positions()[: len(sim.positions())], sim.positions())
    assert ("keep those they had" in more.describe()) == isinstance(body, fdem.Zoned)
    report = more.solve(ratio=1e-4)
    assert report.reason == "equilibrium"
    weight = 9.81 * more.model.mass.sum()
    assert more[scene.fixes[0]].force[2] == pytest.approx(weight, rel=1e-3)
    more.save(tmp_path / "more.npz")
    rebuilt = fdem.Scene()
    for block in scene.blocks:
        rebuilt.add(block.shape, block.body, STONE, name=block.name)
    rebuilt.fix(("old0", "old1"), where=lambda x: x[:, 2] < 1e-9)
    rebuilt.joint(fdem.Coulomb(kn=2e9, ks=1e9, friction=35))
    again = fdem.load(tmp_path / "more.npz", rebuilt, fdem.Relaxation(), progress=False)
    for each in (again, more):
        each.cycle(20)
    assert_same_bits(everything(again), everything(more))


# ---------------------------------------------------------------------------------------------------------------------


def test_clearance_of_a_polygon():
    square = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)])
    assert overlay.clearance(square) == 2.0
    spike = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (1.0, 0.25), (0.0, 2.0)])
    assert overlay.clearance(spike) == pytest.approx(0.25, rel=1e-12)


def test_segments_along_each_other_and_crossing_loops():
    p = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 0.0)])
    q = np.array([(2.0, 0.0, 0.0), (4.0, 0.0, 0.0), (5.0, 0.0, 0.0), (2.0, 1e-3, 0.0), (2.0, 0.0, 0.0)])
    # 0-1, 1-2 and 1-4 overlap; 0 and 4 are the same; 3 lies beside; 0 and 2 are apart
    assert overlay.aligned(p, q, 1e-9) == [(0, 1), (1, 2), (1, 4)]
    a = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)])
    assert overlay.crossings(a, a + 1.0, 1e-9) == [(1, 0), (2, 3)]
    assert overlay.crossings(a, a + np.array([2.0, 0.0]), 1e-9) == []
    assert overlay.contains(a, np.array([(1.0, 1.0), (3.0, 1.0)])).tolist() == [True, False]
