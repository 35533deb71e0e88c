"""The scene: one selector everywhere, cuts, joint precedence, fixing, blocks from a mesh."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose
from reference import kuhn_cube

import fdem
from fdem.scene.shapes import TetMesh

ROCK = fdem.Elastic(density=2500, young=1e10, poisson=0.2)


def law(friction=30.0):
    return fdem.Coulomb(kn=1e10, ks=5e9, friction=friction)


def row_of_cubes(n=4, body=None):
    """Cubes side by side along x: names a, b, ...; groups left (first half) and right."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    blocks = [
        scene.add(
            fdem.brick((i, 0, 0), (i + 1, 1, 1)),
            body or fdem.Rigid(),
            ROCK,
            name="abcdefgh"[i],
            group="left" if i < n // 2 else "right",
        )
        for i in range(n)
    ]
    return scene, blocks


def names(scene, target):
    return [block.name for block in scene.select_blocks(target)]


def rules_used(scene):
    """Friction angle of the law of every contact point, by pair of block names."""
    sim = fdem.Simulation(scene, fdem.Explicit())
    table = sim.contact_table()
    used = {}
    for a, b, joint in zip(table["block_a"], table["block_b"], table["joint"], strict=True):
        pair = "".join(sorted(sim.model.names[i] for i in (a, b)))
        used.setdefault(pair, set()).add(scene.joints[joint].law.friction)
    return used


# ---------------------------------------------------------------------------------------------------------------------
# selectors


def test_every_kind_of_target_selects_blocks():
    scene, (a, b, c, d) = row_of_cubes()
    assert names(scene, None) == ["a", "b", "c", "d"]
    assert names(scene, b) == ["b"]
    assert names(scene, [d, "a"]) == ["d", "a"]
    assert names(scene, (a, b)) == ["a", "b"]
    assert names(scene, "c") == ["c"]
    assert names(scene, "left") == ["a", "b"]
    assert names(scene, "*t") == ["a", "b", "c", "d"]
    assert names(scene, "r*") == ["c", "d"]
    assert names(scene, ["left", c]) == ["a", "b", "c"]
    assert names(scene, ["left", "a", a]) == ["a", "b"], "nothing is selected twice"


def test_the_same_selectors_read_results():
    scene, (a, _, c, _) = row_of_cubes()
    scene.joint(law())
    sim = fdem.Simulation(scene, fdem.Explicit())
    assert sim[a].position.shape == (3,)
    assert sim["a"].position.shape == (3,)
    assert_allclose(sim["left"].position, [[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]])
    assert sim["*"].mass.shape == (4,)
    assert_allclose(sim[[c, "left"]].position[:, 0], [2.5, 0.5, 1.5])
    with pytest.raises(fdem.SceneError, match="nowhere"):
        sim["nowhere"]


def test_a_joint_set_means_the_faces_it_made():
    scene, (a, b, _, _) = row_of_cubes()
    scene.cut(fdem.JointSet(90, 0, origin=(0, 0.5, 0), name="J"), target=[a, b])
    assert {block.name[0] for block in scene.select_blocks("J")} == {"a", "b"}
    assert all(tag == "J" for _, tag in scene.select("J"))
    scene.joint(law())
    load = scene.apply(fdem.Pressure(1e5), "J")
    sim = fdem.Simulation(scene, fdem.Explicit())
    assert_allclose(sim[load].force, 0.0, atol=1e-6)
    assert_allclose(np.abs(sim.system.f_load).sum(axis=0), [0, 4e5, 0], rtol=1e-12)


def two_group_mesh():
    """Unit cube of tetrahedra: groups low (z < 1/2) and high; surfaces base (z = 0) and seam (z = 1/2)."""
    points, tets = kuhn_cube(2)
    high = points[tets][:, :, 2].mean(axis=1) > 0.5
    faces = np.vstack([tets[:, c] for c in ([0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3])])
    z = points[faces][:, :, 2]
    base = faces[(z == 0.0).all(axis=1)]
    seam = np.unique(np.sort(faces[(z == 0.5).all(axis=1)], axis=1), axis=0)
    cells = [("tetra", tets[~high]), ("tetra", tets[high]), ("triangle", base), ("triangle", seam)]
    physical = [np.full(len(rows), i) for i, (_, rows) in enumerate(cells, start=1)]
    tags = {"low": [1, 3], "high": [2, 3], "base": [3, 2], "seam": [4, 2]}
    return meshio.Mesh(points, cells, cell_data={"gmsh:physical": physical}, field_data=tags)


def test_a_mesh_tag_selects_faces():
    scene = fdem.Scene.from_mesh(two_group_mesh(), fdem.Zoned(), ROCK, split="seam", gravity=(0, 0, 0))
    load = scene.apply(fdem.Traction((0, 0, -1e6)), "base")
    scene.joint(law(), "seam")
    sim = fdem.Simulation(scene, fdem.Explicit())
    assert_allclose(sim[load].force, [0, 0, -1e6], rtol=1e-12)
    assert np.isin(
        np.flatnonzero(np.abs(sim.system.f_load).sum(axis=1)), np.flatnonzero(sim.positions()[:, 2] < 1e-12)
    ).all()


def test_from_mesh_takes_bodies_and_materials_by_group_pattern():
    soft = fdem.Elastic(density=2000, young=1e9, poisson=0.3)
    scene = fdem.Scene.from_mesh(
        two_group_mesh(), {"lo*": fdem.Zoned(), "high": fdem.Rigid()}, {"low": soft, "*": ROCK}, split="seam"
    )
    by_group = {block.group: block for block in scene.blocks}
    assert set(by_group) == {"low", "high"}
    assert isinstance(by_group["high"].body, fdem.Rigid)
    assert by_group["low"].material is soft
    assert by_group["high"].material is ROCK
    assert_allclose(sum(b.shape.volume for b in scene.blocks), 1.0, rtol=1e-12)
    scene.joint(law())
    sim = fdem.Simulation(scene, fdem.Explicit())
    assert_allclose(sim["low"].mass, 1000.0, rtol=1e-12)
    with pytest.raises(fdem.SceneError, match="'high' has no material"):
        fdem.Scene.from_mesh(two_group_mesh(), fdem.Rigid(), {"low": ROCK})


def test_where_sees_centroids_gridpoints_faces_and_contact_points():
    seen = {}

    def watch(key, result):
        def where(x):
            seen[key] = x.copy()
            return result(x)

        return where

    scene, (a, *_) = row_of_cubes()
    scene.cut(fdem.JointSet(90, 0, origin=(0, 0.5, 0), name="J"), where=watch("cut", lambda x: x[:, 0] > 3))
    assert_allclose(seen["cut"], [[i + 0.5, 0.5, 0.5] for i in range(4)])
    assert len(scene.blocks) == 5
    scene.joint(law())
    scene.joint(law(10), where=watch("joint", lambda x: x[:, 0] > 2.5))
    scene.fix(a, where=watch("fix", lambda x: x[:, 0] < 0.5))
    scene.apply(fdem.Pressure(1.0), a, where=watch("face", lambda x: x[:, 0] < 1e-9))
    scene.apply(fdem.Force((1, 0, 0)), a, where=watch("force", lambda x: x[:, 0] < 0.5))
    sim = fdem.Simulation(scene, fdem.Explicit())
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
    assert_allclose(np.unique(seen["fix"], axis=0), corners)
    assert_allclose(np.unique(seen["force"], axis=0), corners)
    assert len(seen["face"]) == 12
    assert seen["joint"][:, 0].min() == pytest.approx(1.0)
    gone = sim.excavate(where=watch("excavate", lambda x: x[:, 0] < 1))
    assert gone == ["a"]
    assert len(seen["excavate"]) == 5


@pytest.mark.parametrize("answer", [True, np.ones(3, bool), np.ones((8, 1), bool), np.ones(8), None])
def test_where_of_the_wrong_shape_or_kind_is_refused(answer):
    scene, (a, *_) = row_of_cubes()
    scene.joint(law())
    scene.fix(a, where=lambda x: answer)
    with pytest.raises(fdem.SceneError, match="fix: where returned"):
        fdem.Simulation(scene, fdem.Explicit())


@pytest.mark.parametrize(
    "act",
    [
        lambda s: s.fix("nobody"),
        lambda s: s.apply(fdem.Force((0, 0, 1)), "nobody"),
        lambda s: s.joint(law(), "nobody"),
        lambda s: s.joint(law(), between=("left", "nobody")),
        lambda s: s.cut(fdem.JointSet(0, 0, 1.0, name="J"), "nobody"),
        lambda s: s.gridpoint((0, 0, 0), "nobody"),
        lambda s: s.fix("nobody*"),
        lambda s: s.fix(["left", "nobody"]),
    ],
)
def test_an_empty_selection_names_the_selector(act):
    scene, _ = row_of_cubes()
    with pytest.raises(fdem.SceneError, match="nobody"):
        act(scene)


def test_an_empty_list_or_a_foreign_object_is_refused():
    scene, _ = row_of_cubes()
    with pytest.raises(fdem.SceneError, match="nothing"):
        scene.fix([])
    with pytest.raises(fdem.SceneError, match="selector 7"):
        scene.fix(7)


def test_a_block_of_another_scene_is_refused():
    scene, _ = row_of_cubes()
    _, (stranger, *_) = row_of_cubes()
    with pytest.raises(fdem.SceneError, match="'a'"):
        scene.fix(stranger)


def test_a_where_that_selects_nothing_is_refused_before_the_first_step():
    scene, (a, *_) = row_of_cubes()
    scene.joint(law())
    scene.apply(fdem.Pressure(1.0), a, where=lambda x: x[:, 0] > 100)
    with pytest.raises(fdem.SceneError, match="Pressure"):
        fdem.Simulation(scene, fdem.Explicit())


# ---------------------------------------------------------------------------------------------------------------------
# one namespace


def test_names_that_clash_are_refused():
    scene, _ = row_of_cubes()
    brick = fdem.brick((10, 0, 0), (11, 1, 1))
    with pytest.raises(fdem.SceneError, match=r"'a'.*exists"):
        scene.add(brick, fdem.Rigid(), ROCK, name="a")
    with pytest.raises(fdem.SceneError, match=r"'left'.*group"):
        scene.add(brick, fdem.Rigid(), ROCK, name="left")
    with pytest.raises(fdem.SceneError, match=r"'a'.*block"):
        scene.add(brick, fdem.Rigid(), ROCK, group="a")
    with pytest.raises(fdem.SceneError, match=r"'left'.*group"):
        scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 0.5), name="left"))
    with pytest.raises(fdem.SceneError, match=r"'b'.*block"):
        scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 0.5), name="b"))
    assert len(scene.blocks) == 4, "what was refused left nothing behind"
    scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 0.5), name="J"))
    with pytest.raises(fdem.SceneError, match=r"'J'.*joint set"):
        scene.add(brick, fdem.Rigid(), ROCK, group="J")
    with pytest.raises(fdem.SceneError, match=r"'J'.*joint set"):
        scene.blocks[0].group = "J"
    assert scene.blocks[0].group == "left"


def test_a_refused_block_leaves_its_names_free():
    scene = fdem.Scene()
    with pytest.raises(fdem.SceneError, match="material is missing"):
        scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), name="base", group="all")
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), ROCK, name="base", group="all")
    assert names(scene, "all") == ["base"]


def test_a_refused_cut_leaves_its_name_free():
    scene, _ = row_of_cubes()
    with pytest.raises(fdem.SceneError, match="nobody"):
        scene.cut(fdem.JointSet(0, 0, 1.0, name="J"), "nobody")
    scene.add(fdem.brick((10, 0, 0), (11, 1, 1)), fdem.Rigid(), ROCK, name="J")


def test_a_tag_of_a_mesh_clashes_too():
    scene = fdem.Scene.from_mesh(two_group_mesh(), fdem.Zoned(), ROCK, split="seam")
    with pytest.raises(fdem.SceneError, match=r"'base'.*tag"):
        scene.add(fdem.brick((10, 0, 0), (11, 1, 1)), fdem.Rigid(), ROCK, name="base")


def test_a_list_of_shapes_gives_a_list_of_blocks():
    scene = fdem.Scene()
    blocks = scene.add(fdem.wall(2.0, 0.6, 0.2, (0.4, 0.2, 0.2)), fdem.Rigid(), ROCK, name="brick", group="wall")
    assert isinstance(blocks, list)
    assert [b.name for b in blocks[:2]] == ["brick_0", "brick_1"]
    assert names(scene, "wall") == [b.name for b in blocks]
    assert names(scene, "brick_1") == ["brick_1"]
    with pytest.raises(fdem.SceneError, match="empty"):
        scene.add([], fdem.Rigid(), ROCK)


def test_names_given_by_the_scene_avoid_those_of_the_user():
    scene = fdem.Scene()
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), ROCK, name="block_1")
    other = scene.add(fdem.brick((2, 0, 0), (3, 1, 1)), fdem.Rigid(), ROCK)
    assert other.name != "block_1"


def test_other_libraries_shapes_are_shapes():
    import pyvista
    import skfem

    scene = fdem.Scene()
    ball = scene.add(pyvista.Cube().triangulate().clean(), fdem.Rigid(), ROCK)
    tets = scene.add(skfem.MeshTet().translated((5, 0, 0)), fdem.Zoned(), ROCK)
    assert ball.shape.volume == pytest.approx(1.0, rel=1e-6)
    assert tets.shape.volume == pytest.approx(1.0)
    assert isinstance(tets.shape, TetMesh)


# ---------------------------------------------------------------------------------------------------------------------
# blocks and cuts


def test_fields_of_a_block_can_be_assigned():
    scene, (a, b, *_) = row_of_cubes()
    other = fdem.Elastic(density=1000, young=1e9, poisson=0.1)
    a.material, a.group, a.body = other, "extra", fdem.Zoned()
    b.fixed = True
    b.shape = fdem.brick((1, 0, 0), (2, 1, 2))
    scene.joint(law())
    sim = fdem.Simulation(scene, fdem.Explicit())
    assert names(scene, "extra") == ["a"]
    assert names(scene, "left") == ["b"]
    assert sim[a].mass == pytest.approx(1000)
    assert sim[a].zones.shape[1] == 4
    assert sim.model.fixed.tolist() == [False, True, False, False]
    assert sim[b].mass == pytest.approx(5000)


def test_wrong_assignments_are_refused_and_change_nothing():
    _, (a, *_) = row_of_cubes()
    for field, value, message in (
        ("body", "rigid", "body"),
        ("material", 2500, "material"),
        ("material", None, "material is missing"),
        ("shape", 3, "shape|as_shape|allowed"),
        ("group", "b", "block"),
    ):
        before = getattr(a, field)
        with pytest.raises(fdem.SceneError, match=message):
            setattr(a, field, value)
        assert getattr(a, field) is before, field
    a.body = fdem.Zoned()
    with pytest.raises(fdem.SceneError, match="young"):
        a.material = fdem.Elastic(density=2500)


def test_a_handle_means_all_its_pieces_after_cuts():
    scene, (a, b, *_) = row_of_cubes()
    scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 0.5), name="bed"), target=[a, b])
    pieces = scene.cut(fdem.JointSet(90, 0, origin=(0, 0.5, 0), name="cross"), target=a)
    assert len(pieces) == 4
    assert len(scene.select_blocks(a)) == 4
    assert len(scene.select_blocks("a")) == 4
    assert len(scene.select_blocks(b)) == 2
    assert len(scene.blocks) == 8
    assert names(scene, "right") == ["c", "d"]
    assert len(scene.select_blocks("left")) == 6, "pieces stay in the group"
    assert_allclose(sum(p.shape.volume for p in scene.select_blocks(a)), 1.0, rtol=1e-12)
    scene.joint(law())
    fix = scene.fix(a)
    sim = fdem.Simulation(scene, fdem.Explicit())
    assert sim[a].mass.sum() == pytest.approx(2500)
    assert sim[a].position.shape == (4, 3)
    assert sim[b].position.shape == (2, 3)
    assert sim[fix].force.shape == (3,)
    # a piece is addressed by its own handle and name as well
    leaf = scene.select_blocks(b)[0]
    assert sim[leaf].position.shape == (3,)
    assert sim[leaf.name].position.shape == (3,)


def test_assignments_reach_the_pieces():
    scene, (a, *_) = row_of_cubes()
    scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 0.5), name="bed"), target=a)
    a.group, a.fixed = "special", True
    assert len(scene.select_blocks("special")) == 2
    assert all(piece.fixed for piece in a.leaves())


def test_a_shape_cuts_an_opening_whose_pieces_join_its_group():
    scene = fdem.Scene(gravity=(0, 0, 0))
    rock = scene.add(fdem.brick((-2, -2, -2), (2, 2, 2)), fdem.Rigid(), ROCK, name="rock")
    scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 0.2), name="bed"))
    scene.cut(fdem.brick((-1, -3, -1), (1, 3, 1)), name="stage_1")
    inside = scene.select_blocks("stage_*")
    assert_allclose(sum(b.shape.volume for b in inside), 16.0, rtol=1e-12)
    assert_allclose(sum(b.shape.volume for b in scene.blocks), 64.0, rtol=1e-12)
    assert {b.name for b in inside} < {b.name for b in scene.select_blocks(rock)}
    scene.joint(law())
    scene.joint(fdem.Bonded(kn=2e10, ks=1e10), "stage_1")
    sim = fdem.Simulation(scene, fdem.Explicit())
    table = sim.contact_table()
    bonded = np.array([isinstance(scene.joints[j].law, fdem.Bonded) for j in table["joint"]])
    inner = np.isin([sim.model.names[i] for i in range(sim.model.n_blocks)], [b.name for b in inside])
    assert (bonded == (inner[table["block_a"]] != inner[table["block_b"]])).all()
    assert bonded.any()
    assert (~bonded).any()


def test_a_name_given_to_cut_replaces_the_cutters():
    scene, (a, *_) = row_of_cubes()
    scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 0.5), name="bed"), target=a, name="layer")
    assert len(scene.select("layer")) == 2
    with pytest.raises(fdem.SceneError, match="bed"):
        scene.fix("bed")


def test_a_block_that_brings_its_zones_cannot_be_cut():
    scene = fdem.Scene()
    points, tets = kuhn_cube(1)
    scene.add(fdem.tet_mesh(points, tets), fdem.Zoned(), ROCK, name="imported")
    with pytest.raises(fdem.SceneError, match="zones"):
        scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 0.5)))


# ---------------------------------------------------------------------------------------------------------------------
# joints


def test_the_most_specific_joint_wins():
    scene, _ = row_of_cubes(5)
    # left: a b, right: c d e
    scene.joint(law(40), where=lambda x: x[:, 0] > 3.5)
    scene.joint(law(31), between=("left", "right"))
    scene.joint(law(32), between=("right", "right"))
    scene.joint(law(20), "left")
    scene.joint(law(10))
    used = rules_used(scene)
    assert used == {"ab": {20.0}, "bc": {31.0}, "cd": {32.0}, "de": {40.0}}


def test_among_equals_the_later_joint_wins():
    scene, (_, b, *_) = row_of_cubes()
    scene.joint(law(10))
    scene.joint(law(11))
    scene.joint(law(20), b)
    scene.joint(law(21), "left")
    assert rules_used(scene) == {"ab": {21.0}, "bc": {21.0}, "cd": {11.0}}


def test_between_the_same_group_needs_both_blocks_in_it():
    scene, _ = row_of_cubes(6)
    scene.joint(law(10))
    scene.joint(law(20), between=("left", "left"))
    assert rules_used(scene) == {"ab": {20.0}, "bc": {20.0}, "cd": {10.0}, "de": {10.0}, "ef": {10.0}}


def test_a_group_means_contacts_with_at_least_one_block_in_it():
    scene, _ = row_of_cubes(4)
    scene.joint(law(10))
    scene.joint(law(20), "right")
    assert rules_used(scene) == {"ab": {10.0}, "bc": {20.0}, "cd": {20.0}}


def test_a_joint_set_means_contacts_between_faces_it_made():
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((0, 0, 0), (2, 2, 2)), fdem.Rigid(), ROCK)
    scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 1), name="flat"))
    scene.cut(fdem.JointSet(90, 90, origin=(1, 0, 0), name="steep"))
    scene.joint(law(10), "flat")
    scene.joint(law(20), "steep")
    sim = fdem.Simulation(scene, fdem.Explicit())
    table = sim.contact_table()
    flat = np.abs(table["normal"][:, 2]) > 0.9
    assert flat.any()
    assert (~flat).any()
    assert {scene.joints[j].law.friction for j in table["joint"][flat]} == {10.0}
    assert {scene.joints[j].law.friction for j in table["joint"][~flat]} == {20.0}


def test_groups_that_touch_without_a_law_raise_and_are_named():
    scene, _ = row_of_cubes()
    scene.joint(law(), between=("left", "left"))
    with pytest.raises(fdem.JointError, match=r"'b' and 'c'|'c' and 'd'"):
        fdem.Simulation(scene, fdem.Explicit())
    scene, _ = row_of_cubes()
    with pytest.raises(fdem.JointError, match="no joint"):
        fdem.Simulation(scene, fdem.Explicit())


def test_blocks_that_cannot_meet_need_no_law():
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), ROCK)
    scene.add(fdem.brick((50, 0, 0), (51, 1, 1)), fdem.Rigid(), ROCK)
    fdem.Simulation(scene, fdem.Explicit()).cycle(5) if scene.joints else None
    fixed = fdem.Scene(gravity=(0, 0, 0))
    fixed.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), fixed=True)
    fixed.add(fdem.brick((1, 0, 0), (2, 1, 1)), fdem.Rigid(), fixed=True)
    fixed.add(fdem.brick((9, 0, 0), (10, 1, 1)), fdem.Rigid(), ROCK)
    fdem.Simulation(fixed, fdem.Explicit(dt=1e-3)).cycle(5)


def test_a_stiffness_left_out_is_chosen_said_and_warned_of():
    scene, _ = row_of_cubes(2)
    scene.gravity = np.array([0, 0, -9.81])
    scene.joint(fdem.Coulomb(friction=30))
    with pytest.warns(fdem.FdemWarning, match="kn = None"):
        sim = fdem.Simulation(scene, fdem.Explicit())
    assert "kn =" in sim.describe()
    assert "was chosen" in sim.describe()


# ---------------------------------------------------------------------------------------------------------------------
# fixing


@pytest.mark.parametrize("body", [fdem.Rigid(), fdem.Zoned()])
@pytest.mark.parametrize(
    ("component", "free"), [(None, ""), ("x", "yz"), (("x", "z"), "y"), ("normal", "yz"), (("x", "y", "z"), "")]
)
def test_fixed_components_do_not_move(body, component, free):
    scene = fdem.Scene(gravity=(1, 2, 3))
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), body, ROCK)
    scene.fix(block, component=component, where=lambda x: x[:, 0] < 1e-9)
    sim = fdem.Simulation(scene, fdem.Explicit(dt=None if isinstance(body, fdem.Zoned) else 1e-4))
    sim.cycle(50)
    moved = sim[block].gridpoint_displacement[sim.model.X[:, 0] + sim.model.origin[0] < 1e-9]
    for k, axis in enumerate("xyz"):
        if axis in free:
            assert np.abs(moved[:, k]).max() > 0
        else:
            assert np.abs(moved[:, k]).max() == 0


def test_rotation_alone_can_be_fixed():
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), ROCK)
    scene.fix(block, component="rotation")
    scene.apply(fdem.Force((0, 0, 1e4), at=(1, 1, 0.5)), block)
    sim = fdem.Simulation(scene, fdem.Explicit(dt=1e-3))
    sim.cycle(100)
    assert np.abs(sim[block].rotation_vector).max() == 0
    assert sim[block].displacement[2] > 0


def test_a_fixed_block_with_a_velocity_is_a_platen():
    scene = fdem.Scene(gravity=(0, 0, -9.81))
    platen = scene.add(
        fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), fixed=True, velocity=(0.5, 0, 0), angular_velocity=(0, 0, 0.2)
    )
    sim = fdem.Simulation(scene, fdem.Explicit(dt=1e-3))
    sim.run(time=1.0)
    assert_allclose(sim[platen].displacement, [0.5, 0, 0], rtol=1e-12, atol=1e-15)
    assert_allclose(sim[platen].rotation_vector, [0, 0, 0.2], rtol=1e-9, atol=1e-15)


def test_scene_level_values_are_checked():
    with pytest.raises(fdem.SceneError, match="gravity"):
        fdem.Scene(gravity=(0, 0, np.nan))
    with pytest.raises(fdem.SceneError, match="gap_tolerance"):
        fdem.Scene(gap_tolerance=-1.0)


def test_gravity_given_later_is_a_vector_too():
    scene = fdem.Scene()
    scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), ROCK)
    scene.gravity = (0, 0, -5.0)
    sim = fdem.Simulation(scene, fdem.Explicit(dt=1e-3), progress=False)
    sim.run(0.1)
    np.testing.assert_allclose(sim.velocity[2], -0.5, rtol=1e-12)
    scene.gravity = (0, -5.0)
    with pytest.raises(fdem.SceneError, match="gravity"):
        fdem.Simulation(scene, fdem.Explicit())
