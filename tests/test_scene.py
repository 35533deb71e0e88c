"""The scene: one selector everywhere, cuts, joint precedence, fixing, blocks from a mesh."""

from __future__ import annotations

import numpy as np
import pytest

import fdem

ROCK = fdem.Elastic(density=2500, young=1e10, poisson=0.2)
LAW = fdem.Coulomb(kn=1e10, ks=5e9, friction=30)


def law(friction):
    return fdem.Coulomb(kn=1e10, ks=5e9, friction=friction)


def row_of_cubes(n=4, **given):
    """Cubes side by side along x: names a, b, ...; groups left (first half) and right."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    blocks = [
        scene.add(
            fdem.brick((i, 0, 0), (i + 1, 1, 1)), fdem.Rigid(), ROCK, name="abcdefgh"[i],
            group="left" if i < n // 2 else "right", **given,
        )
        for i in range(n)
    ]  # fmt: skip
    return scene, blocks


def names(scene, target):
    return [block.name for block in scene.select_blocks(target)]


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


def test_a_joint_set_means_the_faces_it_made():
    scene, (a, b, _, _) = row_of_cubes()
    scene.cut(fdem.JointSet(90, 0, origin=(0, 0.5, 0), name="J"), target=[a, b])
    assert {block.name[0] for block in scene.select_blocks("J")} == {"a", "b"}
    assert all(tag == "J" for _, tag in scene.select("J"))
    fix = scene.fix("J")
    scene.joint(LAW)
    sim = fdem.Simulation(scene, fdem.Relaxation())
    assert sim[fix].force.shape == (3,)
    table = sim.contact_table()
    assert len(table["gap"]) > 0


def test_a_tag_of_a_mesh_selects_its_faces():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    mesh = fdem.tet_mesh(points, [[0, 1, 2, 3]])
    mesh.facet_tags["base"] = np.array([[0, 1, 2]])
