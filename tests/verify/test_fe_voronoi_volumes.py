"""Voronoi volumes of gridpoints, clipped at the block: structured, jittered and obtuse meshes of a cube."""

from __future__ import annotations

import numpy as np
import pytest
from verify.meshes import box_mesh

import fdem

OBTUSE_POINTS = [
    [0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1],
    [0.5, 0.45, 0.06], [0.52, 0.55, 0.12],
]  # fmt: skip
OBTUSE_TETS = [
    [8, 9, 6, 2], [8, 9, 2, 0], [8, 6, 9, 4], [8, 5, 9, 1], [8, 1, 9, 0], [8, 9, 5, 4], [9, 5, 7, 1], [9, 7, 3, 1],
    [9, 7, 6, 2], [9, 3, 7, 2], [9, 1, 2, 0], [9, 1, 3, 2], [9, 7, 5, 4], [9, 6, 7, 4], [8, 4, 1, 0], [8, 5, 1, 4],
    [8, 2, 6, 4], [8, 2, 4, 0],
]  # fmt: skip
# by half-space clipping of every zone, an independent route (oracle, fe_voronoi_volumes)
OBTUSE_VOLUMES = [
    0.05047424252053198, 0.1064010852203524, 0.04888912325006814, 0.10326795780147224, 0.049387680315870576,
    0.10520312289830307, 0.04375037326388889, 0.10159742965494793, 0.11320603115754561, 0.2778229539170193,
]  # fmt: skip
DENSITY = 2000.0


def masses(points, tets, rule="voronoi"):
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(fdem.tet_mesh(points, tets), fdem.Zoned(mass=rule), fdem.Elastic(DENSITY, 1e9, 0.25))
    sim = fdem.Simulation(scene, fdem.Explicit(), progress=False)
    found = sim[block].gridpoints
    # gridpoints may be numbered anew
    order = [int(np.argmin(np.linalg.norm(found - p, axis=1))) for p in np.asarray(points, dtype=float)]
    return sim[block].gridpoint_mass[order] / DENSITY


def sampled(points, n=400_000):
    """Volumes by counting random places of the unit cube (definition of the cell; standard error 7e-4)."""
    places = np.random.default_rng(5).random((n, 3))
    nearest = np.argmin(((places[:, None, :] - points[None]) ** 2).sum(axis=2), axis=1)
    return np.bincount(nearest, minlength=len(points)) / n


@pytest.mark.filterwarnings("ignore::fdem.FdemWarning")
def test_structured_mesh_is_a_tensor_product():
    points, tets = box_mesh((3, 3, 3), (1, 1, 1))
    share = np.where((points < 1e-9) | (points > 1 - 1e-9), 1 / 6, 1 / 3).prod(axis=1)
    volumes = masses(points, tets)
    np.testing.assert_allclose(volumes, share, rtol=0, atol=1e-9)  # the oracle's, of the body's volume
    assert volumes.sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.filterwarnings("ignore::fdem.FdemWarning")
def test_obtuse_mesh():
    volumes = masses(OBTUSE_POINTS, OBTUSE_TETS)
    np.testing.assert_allclose(volumes, OBTUSE_VOLUMES, rtol=0, atol=1e-9)  # as above
    assert volumes.sum() == pytest.approx(1.0, abs=1e-12)
    # the signed circumcentric dual would give -0.139 somewhere here
    assert volumes.min() > 0
    centre = volumes @ np.array(OBTUSE_POINTS, dtype=float) / volumes.sum()
    np.testing.assert_allclose(centre, [0.5010095577486333, 0.5012502226456333, 0.45660071191457074], atol=1e-9)


@pytest.mark.filterwarnings("ignore::fdem.FdemWarning")
def test_jittered_mesh_against_the_definition():
    points, tets = box_mesh((2, 2, 2), (1, 1, 1), jitter=0.35, seed=7)
    volumes = masses(points, tets)
    assert volumes.sum() == pytest.approx(1.0, abs=1e-12)
    assert volumes.min() > 0
    # five standard errors of the sampling
    np.testing.assert_allclose(volumes, sampled(points), rtol=0, atol=4e-3)


@pytest.mark.filterwarnings("ignore::fdem.FdemWarning")
def test_row_sum_is_a_quarter_of_each_zone():
    quarter = np.zeros(10)
    corners = np.array(OBTUSE_POINTS, dtype=float)[np.array(OBTUSE_TETS)]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    np.add.at(quarter, np.array(OBTUSE_TETS), volume[:, None] / 4)
    np.testing.assert_allclose(masses(OBTUSE_POINTS, OBTUSE_TETS, "row-sum"), quarter, rtol=1e-12)
