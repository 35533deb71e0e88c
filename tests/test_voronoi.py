"""Clipped Voronoi masses: tensor grids, symmetric bodies, independence of the triangulation, the oracle's meshes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import reference as ref

from fdem.blocks.voronoi import voronoi_masses

ORACLE = Path(__file__).resolve().parents[2] / "shared" / "oracle" / "data" / "fe_voronoi_volumes.json"


def volumes(X, tets, density=1.0):
    return voronoi_masses(
        X, tets.astype(np.int32), np.full(len(tets), density), np.array([0, len(X)]), np.array([0, len(tets)])
    )


@pytest.mark.parametrize("aspect", [(1, 1, 1), (1, 0.1, 3), (20, 1, 0.05)])
def test_tensor_grid_is_a_product_of_widths(aspect):
    """Uneven, stretched grid: most of its tets are obtuse, the cells are boxes all the same."""
    X, tets = ref.kuhn_cube(4)
    lines = [np.cumsum([0, 1.0, 0.6, 1.7, 0.9]) * a for a in aspect]
    index = np.rint(X * 4).astype(int)
    X = np.stack([lines[k][index[:, k]] for k in range(3)], axis=1)
    widths = [np.diff(np.concatenate([[x[0]], 0.5 * (x[1:] + x[:-1]), [x[-1]]])) for x in lines]
    exact = np.prod([widths[k][index[:, k]] for k in range(3)], axis=0)
    np.testing.assert_allclose(volumes(X, tets), exact, rtol=1e-12)


def test_octahedron_about_its_centre():
    """Closed form: the centre owns 5/6, every vertex 1/12 of the octahedron |x| + |y| + |z| <= 1."""
    X = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [0, 0, 0]], dtype=float)
    tets = np.array([[i, j, k, 6] for i in (0, 1) for j in (2, 3) for k in (4, 5)])
    inverted = ref.tet_volumes(X, tets) < 0
    tets[inverted] = tets[inverted][:, [1, 0, 2, 3]]
    np.testing.assert_allclose(volumes(X, tets), [1 / 12] * 6 + [5 / 6], rtol=1e-13)


def test_the_definition_knows_no_triangulation():
    """Same points, same body, mirrored tets: the same masses, although none of the tets is Delaunay."""
    X, tets = ref.kuhn_cube(3, jitter=0.3, seed=3)
    index = np.rint(ref.kuhn_cube(3)[0] * 3).astype(int)
    mirror = ((3 - index[:, 0]) * 4 + index[:, 1]) * 4 + index[:, 2]
    other = mirror[tets][:, [0, 2, 1, 3]]
    assert ref.tet_volumes(X, other).min() > 0
    np.testing.assert_allclose(volumes(X, tets), volumes(X, other), rtol=0, atol=1e-14)


def test_needle_points_reach_through_neighbours():
    """A point close to a face takes volume from tets it is not a node of; masses add up and stay positive."""
    X = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.3, 0.3, 0.02]], dtype=float)
    tets = np.array([[0, 1, 2, 4], [0, 2, 3, 4], [0, 3, 1, 4], [1, 3, 2, 4]])
    inverted = ref.tet_volumes(X, tets) < 0
    tets[inverted] = tets[inverted][:, [1, 0, 2, 3]]
    found = volumes(X, tets)
    assert found.min() > 0 and found.sum() == pytest.approx(1 / 6, rel=1e-13)
    np.testing.assert_allclose(found[[1]], found[[2]], rtol=1e-12)
    np.testing.assert_allclose(found, ref.voronoi_samples(X, tets, 40000), atol=4e-3 / 6)


@pytest.mark.parametrize("seed", range(8))
def test_cospherical_points_turned_out_of_their_axes(seed):
    """Round-off breaks every tie of a grid differently after a rotation: the masses do not notice."""
    rng = np.random.default_rng(seed)
    X, tets = ref.kuhn_cube(3, jitter=0.0 if seed % 2 else 0.2)
    X = X @ np.diag(rng.uniform(0.02, 3, 3)) if seed % 4 > 1 else X
    turned = X @ ref.rotation(rng.standard_normal(3)).T + 100 * rng.standard_normal(3)
    whole = ref.tet_volumes(X, tets).sum()
    np.testing.assert_allclose(volumes(turned, tets), volumes(X, tets), rtol=0, atol=1e-11 * whole)


def test_scaling_by_powers_of_two_keeps_the_bits():
    X, tets = ref.kuhn_cube(3, jitter=0.25)
    assert np.array_equal(volumes(X * 1024.0, tets), volumes(X, tets) * 2.0**30)


def test_density_varies_by_zone():
    X, tets = ref.kuhn_cube(2, jitter=0.2)
    density = np.random.default_rng(0).uniform(1, 2, len(tets))
    mass = voronoi_masses(X, tets, density, np.array([0, len(X)]), np.array([0, len(tets)]))
    assert mass.sum() == pytest.approx(density @ ref.tet_volumes(X, tets), rel=1e-13)


@pytest.mark.skipif(not ORACLE.exists(), reason=f"{ORACLE} is not there")
@pytest.mark.parametrize("name", ["structured", "jittered", "obtuse"])
def test_oracle(name):
    case = json.loads(ORACLE.read_text())["expected"][name]
    X, tets = np.array(case["nodes"], dtype=float), np.array(case["tets"])
    inverted = ref.tet_volumes(X, tets) < 0
    tets[inverted] = tets[inverted][:, [0, 2, 1, 3]]
    found = volumes(X, tets)
    np.testing.assert_allclose(found, case["volumes"], rtol=0, atol=1e-12)
    assert found.sum() == pytest.approx(1.0, rel=1e-12)
