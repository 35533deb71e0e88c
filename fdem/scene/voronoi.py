"""Voronoi blocks of a closed shape."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.errors import SceneError
from fdem.scene.clipping import components, divide
from fdem.scene.polygons import Array
from fdem.scene.pool import Face, Plane, Pool, as_polyhedron, faces_of
from fdem.scene.shapes import Polyhedron, Shape

__all__ = ["voronoi"]


def voronoi(shape: Any, n: int, seed: int = 0) -> list[Shape]:
    """Voronoi blocks of random seeds in a closed shape, convex or not.

    Parameters
    ----------
    shape : closed shape
        What to divide.
    n : int
        Number of seeds, uniform in the shape. A cell of a non-convex shape may be several blocks.
    seed : int, optional
        Of the random numbers.

    Returns
    -------
    list of Polyhedron
        They fill the shape; neighbours share their faces' vertices exactly. New faces have no tag.

    Raises
    ------
    SceneError
        If `n` is not a positive integer or the shape is not a closed polyhedron.
    """
    from fdem.scene.reading import as_shape

    solid = as_shape(shape)
    if not isinstance(solid, Polyhedron):
        raise SceneError(f"voronoi: shape = {solid!r}, allowed is a closed polyhedron")
    if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 1:
        raise SceneError(f"voronoi: n = {n!r}, allowed is an integer >= 1")
    seeds = _seeds(solid, int(n), np.random.default_rng(seed))
    cells: list[Polyhedron] = []
    for i in range(n):
        pool = Pool(solid)
        cells += [as_polyhedron(pool, part) for part in components(pool, _cell(pool, faces_of(solid, pool), seeds, i))]
    return list(_welded(cells, solid))


def _seeds(solid: Polyhedron, n: int, rng: np.random.Generator) -> Array:
    """Uniform random points in a solid: rejection by winding number."""
    corners = solid.points[solid.triangles]
    lower, upper = solid.bounds
    found: list[Array] = []
    while len(found) < n:
        point = lower + rng.random(3) * (upper - lower)
        a, b, c = (corners[:, k] - point for k in range(3))
        la, lb, lc = (np.sqrt((x * x).sum(axis=1)) for x in (a, b, c))
        dots = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        # solid angles of the triangles (Van Oosterom and Strackee 1983, doi:10.1109/TBME.1983.325207)
        if np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), dots).sum() > np.pi:
            found.append(point)
    return np.array(found)


def _cell(pool: Pool, faces: list[Face], seeds: Array, i: int) -> list[Face]:
    """The part of a solid that is nearer to seed i than to any other."""
    apart = seeds - seeds[i]
    distance = np.sqrt((apart * apart).sum(axis=1))
    centre = seeds[i].tolist()
    for j in np.argsort(distance, kind="stable")[1:].tolist():
        reach = max(
            sum((c - o) ** 2 for c, o in zip(pool.points[v], centre, strict=True)) for f in faces for v in f.loop
        )
        if 0.25 * distance[j] ** 2 > reach:
            break
        # both cells use the plane of the pair in the same direction: the same bits
        a, b = (i, j) if i < j else (j, i)
        normal = (seeds[b] - seeds[a]) / distance[j]
        plane = Plane(tuple((0.5 * (seeds[a] + seeds[b])).tolist()), tuple(normal.tolist()))
        above, below = divide(pool, faces, plane, None)[:2]
        faces = below if i == a else above
    return faces


def _welded(cells: list[Polyhedron], solid: Polyhedron) -> list[Polyhedron]:
    """Cells whose common vertices, computed in different order, are made identical."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    points = np.concatenate([cell.points for cell in cells])
    pairs = cKDTree(points).query_pairs(1e-9 * solid.size, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    label = connected_components(graph, directed=False)[1]
    first = np.unique(label, return_index=True)[1]
    points = points[first[label]]
    out, start = [], 0
    for cell in cells:
        own = points[start : start + len(cell.points)]
        start += len(cell.points)
        if len(np.unique(own, axis=0)) < len(own):
            own = cell.points
        out.append(Polyhedron.trusted(own, [f.tolist() for f in cell.faces], cell.face_tags, cell.name))
    return out
