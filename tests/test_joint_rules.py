"""Which contact gets which joint law: every kind of rule against every other, selectors of every kind."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest
from scenes import simulation

import fdem

STONE = fdem.Elastic(density=2500, young=1e9, poisson=0.2)


def law(i):
    """A law that its friction tells."""
    return fdem.Coulomb(kn=1e8, ks=5e7, friction=1.0 + i)


def cut_wall():
    """A wall in two groups, cut by a joint set along it; the lower row of pieces stands on a base."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((0, 0, -1), (4, 1, 0)), fdem.Rigid(), fixed=True, name="base")
    for k, group in enumerate(("left", "right")):
        scene.add(fdem.brick((2 * k, 0, 0), (2 * k + 2, 1, 2)), fdem.Rigid(), STONE, name=f"w{k}", group=group)
    scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 1), name="bed"), ["left", "right"])
    return scene


def owners(sim):
    """Rule of the contact between two blocks, by the pair of names; one rule per pair here."""
    t, names = sim.contact_table(), sim.model.names
    facing = t["area"] > 0.1
    found = {}
    for a, b, rule in zip(t["block_a"][facing], t["block_b"][facing], t["joint"][facing], strict=True):
        found.setdefault(frozenset((names[a], names[b])), set()).add(int(rule))
    assert all(len(rules) == 1 for rules in found.values())
    return {pair: rules.pop() for pair, rules in found.items()}


BED = frozenset(("w0/0", "w0/1"))  # between two pieces of the left wall, on the joint set


def here(x):
    return (np.abs(x[:, 2] - 1.0) < 1e-6) & (x[:, 0] < 2.0)


# every way to mean the contact BED, with its rank: where with anything, then between, then target, then the default
RULES = {
    "default": (0, {}),
    "block": (1, {"target": "w0"}),
    "group": (1, {"target": "left"}),
    "pattern": (1, {"target": "le*"}),
    "list": (1, {"target": ["right", "left"]}),
    "joint set": (1, {"target": "bed"}),
    "list with a joint set": (1, {"target": ["base", "bed"]}),
    "between a group and itself": (2, {"between": ("left", "left")}),
    "between pieces": (2, {"between": ("w0/0", "w0/1")}),
    "between faces of a set and a group": (2, {"between": ("bed", "left")}),
    "where": (3, {"where": here}),
    "where with a target": (3, {"target": "left", "where": here}),
    "where between": (3, {"between": ("left", "left"), "where": here}),
}


@pytest.mark.parametrize("first", RULES)
def test_the_most_specific_rule_wins_among_equals_the_later(first):
    for second in RULES:
        if first == second:
            continue
        scene = cut_wall()
        scene.joint(law(9))  # for the others
        for i, name in enumerate((first, second)):
            scene.joint(law(i), **RULES[name][1])
        wins = 1 if RULES[second][0] >= RULES[first][0] else 0
        sim = simulation(scene)
        assert owners(sim)[BED] == 1 + wins, f"{first} and then {second}"


def test_all_ranks_at_once_in_any_order():
    chosen = ("default", "group", "between pieces", "where")
    for order in permutations(chosen):
        scene = cut_wall()
        for name in order:
            scene.joint(law(chosen.index(name)), **RULES[name][1])
        rules = owners(simulation(scene))
        assert order[rules[BED]] == "where"
        assert order[rules[frozenset(("w1/0", "w1/1"))]] == "default"
        assert order[rules[frozenset(("w0/0", "base"))]] == order[rules[frozenset(("w0/1", "w1/1"))]] == "group"


@pytest.mark.parametrize("name", RULES)
def test_a_rule_covers_what_its_selector_means_and_no_more(name):
    scene = cut_wall()
    scene.joint(law(0))
    scene.joint(law(1), **RULES[name][1])
    rules = owners(simulation(scene))
    mine = {tuple(sorted(pair)) for pair, rule in rules.items() if rule == 1}
    left = {("base", "w0/0"), ("w0/0", "w0/1"), ("w0/0", "w1/0"), ("w0/1", "w1/1")}
    beds = {("w0/0", "w0/1"), ("w1/0", "w1/1")}
    everything = left | beds | {("base", "w1/0")}
    expected = {
        "default": everything, "block": left, "group": left, "pattern": left, "list": everything, "joint set": beds,
        "list with a joint set": beds | {("base", "w0/0"), ("base", "w1/0")},
    }  # fmt: skip
    assert mine == expected.get(name, {("w0/0", "w0/1")})


def tagged(lower, upper, tag):
    """A box of zones with a tag on its lower face."""
    meshio = pytest.importorskip("meshio")
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    points = np.asarray(lower) + corners * (np.asarray(upper) - np.asarray(lower))
    tets = []
    for order in ((4, 2, 1), (4, 1, 2), (2, 4, 1), (2, 1, 4), (1, 4, 2), (1, 2, 4)):
        path = np.cumsum([0, *order])
        tets.append([int(k) for k in path])
    tets = np.array(tets)
    e = points[tets[:, 1:]] - points[tets[:, :1]]
    flip = np.linalg.det(e) < 0
    tets[flip, 2], tets[flip, 3] = tets[flip, 3].copy(), tets[flip, 2].copy()
    bottom = np.array([[0, 4, 6], [0, 6, 2]])
    return meshio.Mesh(
        points, [("tetra", tets), ("triangle", bottom)],
        cell_data={"gmsh:physical": [np.full(6, 1), np.full(2, 2)]},
        field_data={"rock": np.array([1, 3]), tag: np.array([2, 2])},
    )  # fmt: skip


@pytest.mark.parametrize("given", [{"target": "sole"}, {"between": ("sole", "base")}, {"target": ["sole"]}])
def test_a_mesh_tag_on_one_of_the_two_faces_is_enough(given):
    scene = fdem.Scene.from_mesh(tagged((0, 0, 0), (1, 1, 1), "sole"), fdem.Zoned(), STONE)
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    scene.add(fdem.brick((0, 0, 1), (1, 1, 2)), fdem.Rigid(), STONE, name="top")
    scene.joint(law(0))
    scene.joint(law(1), **given)
    sim = simulation(scene)
    t, base = sim.contact_table(), sim.model.names.index("base")
    below = (t["block_a"] == base) | (t["block_b"] == base)
    assert below.any() and not below.all()
    assert (t["joint"] == below).all()


def stope():
    """A block from which a closed shape cuts a piece, and a joint set crosses both."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((0, 0, 0), (3, 1, 3)), fdem.Rigid(), STONE, name="rock")
    scene.cut(fdem.brick((1, -1, 1), (2, 2, 4)), name="stope")
    scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 2), name="bed"), "stope")
    return scene


def test_faces_a_shape_cut_are_addressed_by_its_name():
    """The name means the faces it cut; between two selectors it means its group, as elsewhere."""
    for given, faces in (({"target": "stope"}, True), ({"between": ("stope", "stope")}, False)):
        scene = stope()
        scene.joint(law(0))
        scene.joint(law(1), **given)
        rules = owners(simulation(scene))
        inner = {b.name for b in scene.blocks if b.group == "stope"}
        assert len(inner) == 2
        for pair, rule in rules.items():
            across = len(pair & inner) == 1
            assert rule == (across if faces else not across)


def test_a_joint_set_acts_between_faces_it_made():
    """Two sets that cross: a contact belongs to the set that made its faces, whichever rule came first."""
    for order in permutations((("a", 0), ("b", 1))):
        scene = fdem.Scene(gravity=(0, 0, 0))
        scene.add(fdem.brick((0, 0, 0), (2, 1, 2)), fdem.Rigid(), STONE)
        scene.cut(fdem.JointSet(0, 0, origin=(0, 0, 1), name="a"))
        scene.cut(fdem.JointSet(90, 90, origin=(1, 0, 0), name="b"))
        for name, i in order:
            scene.joint(law(i), name)
        sim = simulation(scene)
        t = sim.contact_table()
        facing = t["area"] > 0.1
        level = np.abs(t["normal"][:, 2]) > 0.9
        friction = np.array([rule.law.friction for rule in scene.joints])[t["joint"]]
        assert (friction[facing] == np.where(level, 1.0, 2.0)[facing]).all()


def test_where_is_asked_per_contact():
    """A place on the faces between the same two blocks has its own law."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    scene.add(fdem.brick((0, 0, -1), (4, 1, 0)), fdem.Rigid(), fixed=True)
    size = 1.0
    scene.add(fdem.brick((0, 0, 0), (4, 1, 1)), fdem.Zoned(size=size), STONE)
    scene.joint(law(0))
    scene.joint(law(1), where=lambda x: x[:, 0] > 2.0)
    t = simulation(scene).contact_table()
    facing = t["area"] > 1e-3
    middle = np.zeros(int(t["patch"].max()) + 1)
    np.add.at(middle, t["patch"], t["position"][:, 0] / 3)
    assert (t["joint"][facing] == (middle[t["patch"]] > 2.0)[facing]).all()
    assert 0 < t["joint"][facing].mean() < 1


def test_a_selector_of_nothing_and_pairs_without_a_law_are_refused():
    for given in ({"target": "nobody"}, {"between": ("left", "nobody")}, {"target": []}):
        with pytest.raises(fdem.SceneError):
            cut_wall().joint(law(0), **given)
    for names in combinations(("left", "right"), 1):
        scene = cut_wall()
        scene.joint(law(0), between=(names[0], names[0]))
        with pytest.raises(fdem.JointError, match="base"):
            simulation(scene)
