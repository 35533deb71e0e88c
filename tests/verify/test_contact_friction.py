"""Friction of contacts that are not face on face: capacity in every direction, clusters, notches (CONTACT.md 3.6)."""

from __future__ import annotations

import numpy as np
import pytest
from contact_tools import World, box, coulomb, move, prism, rotation

MU, KS, DEPTH = 0.5, 5e9, 0.02
EDGE = rotation([0, 1, 0], np.pi / 4)
CORNER = np.array([[1, -1, 0], [1, 1, -2], [1, 1, 1]]) / np.sqrt([[2], [6], [3]])
DIRECTIONS = np.radians([0, 35, 90, 150, 250])


def above(upper, lower, depth=DEPTH):
    """`upper` moved so that it overlaps the highest point of `lower` by `depth`."""
    return move(upper, t=(0, 0, lower[0][:, 2].max() - upper[0][:, 2].min() - depth))


def dragged(shapes, step, n=100, **options):
    """Force on the first block while it is dragged by n steps; the elastic slip is used up by far."""
    w = World(shapes, law=coulomb(tan=MU, ks=KS * 100), **options)
    w.forces()
    w.commit()
    for _ in range(n):
        w.shift(0, step)
        w.contacts.update(w.x)
        w.forces()
        w.commit()
    return w, w.resultant(0)[0]


def capacity(shapes, angle, **options):
    """Friction over mu N, and what of it acts against the motion, in the direction `angle` across z."""
    t = np.array([np.cos(angle), np.sin(angle), 0.0])
    _, force = dragged(shapes, 1e-5 * t, **options)
    return np.hypot(*force[:2]) / (MU * force[2]), -force @ t / (MU * force[2])


def edge_on_face(degrees):
    return move(box(1, 1, 1), rotation([0, 1, 0], np.radians(degrees))), box(4, 4, 1)


def corner_on_face(degrees):
    return move(box(1, 1, 1), rotation([1, 2, 0.3], np.radians(degrees)) @ CORNER), box(4, 4, 1)


def edge_on_edge(degrees):
    return move(box(1, 3, 1), rotation([0, 0, 1], np.radians(degrees)) @ EDGE), move(box(1, 3, 1), EDGE)


CASES = [(edge_on_face, a) for a in (5, 10, 20, 30, 45)] + [(corner_on_face, a) for a in (0, 8, 20)]
CASES += [(edge_on_edge, a) for a in (14, 30, 60, 90)]


@pytest.mark.parametrize("options", [{"clip_always": True}, {"prune": 1e-4}], ids=["exact", "default"])
@pytest.mark.parametrize(("make", "degrees"), CASES, ids=[f"{m.__name__}-{a}" for m, a in CASES])
def test_capacity_of_edges_and_corners(make, degrees, options):
    """Friction / (mu N) = 1 +- 0.01 whatever the direction, against the motion."""
    upper, lower = make(degrees)
    for angle in DIRECTIONS:
        size, against = capacity([above(upper, lower), lower], angle, **options)
        assert size == pytest.approx(1.0, abs=0.01)
        assert against == pytest.approx(1.0, abs=0.01)


def upright(outline, length):
    """Prism whose outline stands in the x-z plane, symmetric about y = 0."""
    return move(prism(outline, length), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), (0, 0.5 * length, 0))


GABLE = upright([[-1.5, 0], [1.5, 0], [0, 1.5]], 4.0)  # slopes of 45 degrees


def test_two_places_of_one_pair_have_two_normals():
    """A block astride a gable, its two inner lower edges on the slopes: mu (N1 + N2), N across the slope of each.

    One normal for the pair, the vertical, would leave cos 45 of it.
    """
    foot = 0.8 - np.sqrt(2) * DEPTH
    leg = np.array([[0.7, 1.7], [0.7, foot], [1.2, foot], [1.2, 2.0]])
    astride = upright(np.vstack([leg, leg[::-1] * [-1, 1]]), 1.0)
    for options in ({"clip_always": True}, {"prune": 1e-4}):
        _, force = dragged([astride, GABLE], [0, 1e-5, 0], **options)
        assert force[2] == pytest.approx(np.sqrt(2) * 1e9 * DEPTH**2, rel=1e-9)  # kn L h^2 on each slope
        assert -force[1] / (MU * force[2]) == pytest.approx(np.sqrt(2), rel=0.01)


def test_a_block_in_a_notch_keeps_two_normals():
    """A cube lying in a right-angled groove: friction along it is mu (N1 + N2) = sqrt(2) mu N."""
    notch = upright([[-2, -1], [2, -1], [2, 1], [1.5, 1.5], [0, 0], [-1.5, 1.5], [-2, 1]], 4.0)
    cube = move(box(1, 1, 1), EDGE, (0, 0, np.sqrt(0.5) - 1e-4))
    for options in ({"clip_always": True}, {"prune": 1e-4}):
        _, force = dragged([cube, notch], [0, 1e-5, 0], **options)
        assert -force[1] / (MU * force[2]) == pytest.approx(np.sqrt(2), rel=0.01)
