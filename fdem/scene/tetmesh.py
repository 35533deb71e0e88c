"""A block whose zones the user brings: tetrahedra with tags on zones and facets."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from fdem.errors import MeshError
from fdem.scene.measures import Shape, ShapeReport, checked_matrix, checked_points, frozen_ints, moved
from fdem.scene.polygons import Ints
from fdem.scene.polyhedra import Polyhedron

__all__ = ["FACETS", "TetMesh", "boundary_facets"]

# facets of a positive tetrahedron, counter-clockwise from outside
FACETS = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]], dtype=np.int32)


class TetMesh(Shape):
    """A closed body divided into tetrahedra.

    Parameters
    ----------
    points : (n, 3) array_like
        Vertices [m]; points that no tetrahedron uses are dropped.
    tets : (m, 4) array_like of int
        Tetrahedra; negatively oriented ones are turned.
    zone_tags : dict of str to array of int, optional
        Zones by tag.
    facet_tags : dict of str to (k, 3) array of int, optional
        Triangles by tag, as vertex indices; those inside the body are kept too.
    name : str, optional
        The name in the file it came from.

    Attributes
    ----------
    points : (n, 3) array
        Vertices [m], read-only.
    tets : (m, 4) int32 array
        Positively oriented tetrahedra, read-only.
    zone_tags, facet_tags : dict
        Tags, in the shape's own numbers.

    Raises
    ------
    MeshError
        If a coordinate is not finite, an index out of range, a point doubled, a tetrahedron flat or the
        mesh empty or in several parts.
    """

    def __init__(
        self,
        points: Any,
        tets: Any,
        zone_tags: Mapping[str, Any] | None = None,
        facet_tags: Mapping[str, Any] | None = None,
        name: str | None = None,
    ) -> None:
        what = f"tetrahedral mesh {name!r}" if name else "tetrahedral mesh"
        points = np.asarray(points, dtype=np.float64)
        cells = np.asarray(tets)
        if cells.size == 0 or points.size == 0:
            raise MeshError(f"{what}: empty mesh, there are no {'points' if points.size == 0 else 'tets'}")
        if cells.ndim != 2 or cells.shape[1] != 4 or not np.issubdtype(cells.dtype, np.integer):
            raise MeshError(f"{what}: tets must be integers of shape (m, 4), not {cells.dtype} {cells.shape}")
        if cells.min() < 0 or cells.max() >= len(points):
            bad = int(np.argmax(((cells < 0) | (cells >= len(points))).any(axis=1)))
            raise MeshError(f"{what}: tets[{bad}] = {cells[bad].tolist()} is out of range, {len(points)} points")
        used, compact = np.unique(cells, return_inverse=True)
        checked_points(points, what)
        self.points = checked_points(points[used], what)
        self.tets = _positive(self.points, compact.reshape(cells.shape), what)
        self.name = name
        _check_connected(self.tets, what)
        new = np.full(len(points), -1)
        new[used] = np.arange(len(used))
        self.zone_tags = {str(k): frozen_ints(np.asarray(v)) for k, v in (zone_tags or {}).items()}
        self.facet_tags = {}
        for tag, facets in (facet_tags or {}).items():
            mapped = new[np.asarray(facets, dtype=np.int64).reshape(-1, 3)]
            mapped = mapped[(mapped >= 0).all(axis=1)]
            if len(mapped):
                self.facet_tags[str(tag)] = frozen_ints(mapped)

    @cached_property
    def surface(self) -> Polyhedron:
        """The boundary as a polyhedron of triangles; facet tags are carried over.

        A facet with several tags keeps the last one that names it.
        """
        facets = boundary_facets(self.tets)
        tags: dict[tuple[int, ...], str] = {}
        for tag, triples in self.facet_tags.items():
            tags.update({tuple(sorted(triple)): tag for triple in triples.tolist()})
        used = np.unique(facets)
        compact = np.searchsorted(used, facets).tolist()
        return Polyhedron.trusted(
            self.points[used], compact, [tags.get(tuple(sorted(f))) for f in facets.tolist()], self.name
        )

    @property
    def triangles(self) -> Ints:  # type: ignore[override]
        """Boundary facets, counter-clockwise from outside, (k, 3), in the numbers of `points`."""
        return self._boundary

    @cached_property
    def _boundary(self) -> Ints:
        return boundary_facets(self.tets)

    def transform(self, matrix: Any) -> TetMesh:
        """The mesh moved, turned, scaled or mirrored, see `Polyhedron.transform`."""
        m = checked_matrix(matrix)
        return TetMesh(moved(self.points, m), self.tets, self.zone_tags, self.facet_tags, self.name)

    def report(self) -> ShapeReport:
        """Quality of the mesh, see `ShapeReport`; the shortest edge is that of the zones."""
        pairs = self.tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
        edges = np.unique(np.sort(pairs, axis=1), axis=0)
        return self._report(edges, 0, len(self.triangles), len(self.tets))


def boundary_facets(tets: Ints) -> Ints:
    """Facets with one tetrahedron, counter-clockwise from outside.

    Parameters
    ----------
    tets : (m, 4) int array
        Positively oriented tetrahedra.

    Returns
    -------
    (k, 3) int32 array
        In the order of the tetrahedra.
    """
    facets = tets[:, FACETS].reshape(-1, 3)
    _, first, counts = np.unique(np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True)
    return frozen_ints(facets[np.sort(first[counts == 1])])


def _positive(points: Any, tets: Any, what: str) -> Ints:
    """Tetrahedra with positive volume; flat ones are refused."""
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    volumes = np.linalg.det(edges)
    lengths = np.sqrt((edges * edges).sum(axis=2)).max(axis=1)
    flat = np.abs(volumes) <= 1e-12 * lengths**3
    if flat.any():
        bad = int(np.argmax(flat))
        raise MeshError(f"{what}: tets[{bad}] = {tets[bad].tolist()} is degenerate, it has no volume")
    out = tets.astype(np.int32)
    inverted = volumes < 0.0
    out[inverted] = out[inverted][:, [0, 2, 1, 3]]
    return frozen_ints(out)


def _check_connected(tets: Ints, what: str) -> None:
    """Refuse a mesh in several parts (parts are joined by facets)."""
    n = n_parts(tets)[0]
    if n > 1:
        raise MeshError(f"{what}: the mesh has {n} disconnected parts; make each part a block of its own")


def n_parts(tets: Ints, open_facets: Any = None) -> tuple[int, Ints]:
    """Parts of a mesh that hang together by facets.

    Parameters
    ----------
    tets : (m, 4) int array
        Tetrahedra.
    open_facets : (k, 3) int array, optional
        Facets that do not join (sorted vertex indices, as rows).

    Returns
    -------
    n : int
        Number of parts.
    part : (m,) int32 array
        Part of each tetrahedron.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    facets = np.sort(tets[:, FACETS].reshape(-1, 3), axis=1)
    order = np.lexsort(facets.T[::-1])
    same = (facets[order[1:]] == facets[order[:-1]]).all(axis=1)
    if open_facets is not None and len(open_facets):
        stacked = np.concatenate([np.sort(open_facets, axis=1), facets])
        inverse = np.unique(stacked, axis=0, return_inverse=True)[1].reshape(-1)
        closed = ~np.isin(inverse[len(open_facets) :], inverse[: len(open_facets)])
        same &= closed[order[1:]]
    a, b = order[:-1][same] // 4, order[1:][same] // 4
    graph = coo_matrix((np.ones(len(a), dtype=np.int8), (a, b)), shape=(len(tets), len(tets)))
    n, part = connected_components(graph, directed=False)
    return int(n), part.astype(np.int32)
