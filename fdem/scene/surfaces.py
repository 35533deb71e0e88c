"""Surface meshes of blocks to be zoned: every edge and every face is divided once for all blocks that share it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from fdem.errors import MeshError
from fdem.scene.gmsh_session import ROUND, mesh_polygon
from fdem.scene.polygons import area_vector, triangulate

__all__ = ["BlockSurface", "SharedSurfaces"]

Array = Any

_SAME_POINT = 1e-9  # of the size of the scene: vertices of neighbours that are one point
_FLAT = 1e-6  # of the size of a face: beyond that it is divided into its triangles
_WHOLE = 1.5  # faces smaller than this many zone sizes, with undivided edges, get no points inside
_ALGORITHMS = (6, 5, 1)  # frontal Delaunay, Delaunay, MeshAdapt


@dataclass(frozen=True)
class BlockSurface:
    """The surface mesh of one block.

    Parameters
    ----------
    points : (n, 3) array
        [m].
    places : (n, 3) array
        The same, normalised: ``(x - middle) / extent``, multiples of `ROUND`.
    triangles : (k, 3) int array
        Outward.
    triangle_face : (k,) int array
        Face of the polyhedron.
    middle : (3,) array
        [m].
    extent : float
        [m].
    """

    points: Array
    places: Array
    triangles: Array
    triangle_face: Array
    middle: Array
    extent: float


class SharedSurfaces:
    """Divided edges and faces of a set of polyhedra.

    Parameters
    ----------
    shapes : sequence of Polyhedron
        The blocks.
    sizes : sequence of float
        Target edge of each [m]; ``inf``: no point is added.
    names : sequence of int
        Number of each block in error messages.

    Notes
    -----
    Edges are cut into ``ceil(length / size)`` equal parts between sorted end points; faces are meshed in a frame of
    their own that starts at a corner chosen by geometry. So two blocks that share a face get the same triangles,
    to the bit, and equal shapes get equal meshes wherever they stand.
    """

    def __init__(self, shapes: Sequence[Any], sizes: Sequence[float], names: Sequence[int]) -> None:
        self._shapes, self._sizes, self._names = shapes, sizes, names
        self._number(shapes)
        self._faces = [self._flat_faces(k) for k in range(len(shapes))]
        self._edge_size: dict[tuple[int, int], float] = {}
        self._face_size: dict[tuple[int, ...], float] = {}
        for faces, size in zip(self._faces, sizes, strict=True):
            for loop, _ in faces:
                key = tuple(sorted(loop))
                self._face_size[key] = min(size, self._face_size.get(key, np.inf))
                for edge in _edges(loop):
                    self._edge_size[edge] = min(size, self._edge_size.get(edge, np.inf))
        self._points: list[Array] = list(self._corners)
        self._edge_points: dict[tuple[int, int], list[int]] = {}
        self._inside: dict[tuple[int, ...], tuple[list[int], Array, int]] = {}
        self._meshes: dict[tuple[int, ...], tuple[list[int], Array]] = {}

    def _number(self, shapes: Sequence[Any]) -> None:
        """Give vertices of different blocks that are the same point one number."""
        points = np.concatenate([shape.points for shape in shapes])
        start = np.concatenate([[0], np.cumsum([len(shape.points) for shape in shapes])])
        root = np.arange(len(points))
        if len(shapes) > 1:
            from scipy.spatial import cKDTree

            extent = float(np.ptp(points, axis=0).max())
            pairs = cKDTree(points).query_pairs(_SAME_POINT * extent, output_type="ndarray")
            if len(pairs):
                from scipy.sparse import coo_matrix
                from scipy.sparse.csgraph import connected_components

                graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
                root = connected_components(graph, directed=False)[1]
        _, first, ids = np.unique(root, return_index=True, return_inverse=True)
        self._corners = points[first]
        self._ids = [ids[a:b].tolist() for a, b in pairwise(start)]

    def _flat_faces(self, block: int) -> list[tuple[list[int], int]]:
        """Loops of shared vertex numbers and the face each belongs to; faces that are not flat by triangles."""
        faces = []
        for number, face in enumerate(self._shapes[block].faces):
            loop = [self._ids[block][v] for v in face]
            loop = [v for k, v in enumerate(loop) if v != loop[k - 1]]
            if len(loop) < 3:
                continue
            if len(loop) == 3 or self._is_flat(loop):
                faces.append((loop, number))
                continue
            for a, b, c in triangulate(self._corners[loop].tolist()):
                faces.append(([loop[a], loop[b], loop[c]], number))
        return faces

    def _is_flat(self, loop: list[int]) -> bool:
        points = self._corners[loop]
        normal = np.array(area_vector(points.tolist()))
        length = np.linalg.norm(normal)
        heights = (points - points.mean(axis=0)) @ normal
        return bool(np.ptp(heights) <= _FLAT * length * np.ptp(points, axis=0).max())

    def surface(self, gmsh: Any, block: int) -> BlockSurface:
        """Surface mesh of a block.

        Parameters
        ----------
        gmsh : module
            From `gmsh_session.session`.
        block : int
            Place in the list of shapes.

        Returns
        -------
        BlockSurface
            Corners are exactly the block's own.
        """
        triangles, owner = [], []
        for loop, number in self._faces[block]:
            try:
                found = self._oriented(gmsh, loop)
            except MeshError as error:
                raise MeshError(f"block {self._names[block]}, face {number}: {error}") from None
            triangles.append(found)
            owner.append(np.full(len(found), number))
        used, local = np.unique(np.concatenate(triangles), return_inverse=True)
        points = np.array([self._points[k] for k in used.tolist()])
        own = dict(zip(self._ids[block], self._shapes[block].points, strict=True))
        for row, k in enumerate(used.tolist()):
            if k in own:
                points[row] = own[k]
        corners = np.array(list(own.values()))
        lower, upper = corners.min(axis=0), corners.max(axis=0)
        extent, middle = float((upper - lower).max()), 0.5 * (lower + upper)
        place = {k: np.rint((p - middle) / (extent * ROUND)) * ROUND for k, p in own.items()}
        self._place_inner(block, place)
        places = np.rint(np.array([place[k] for k in used.tolist()]) / ROUND) * ROUND
        return BlockSurface(points, places, local.reshape(-1, 3), np.concatenate(owner), middle, extent)

    def _place_inner(self, block: int, place: dict[int, Array]) -> None:
        """Normalised places of points on edges and faces, from those of the corners.

        Rounding the corners alone, and not every point, is what makes the mesh insensitive to noise in the
        coordinates: a few roundings instead of thousands could tip over.
        """
        for loop, _ in self._faces[block]:
            for a, b in _edges(loop):
                inner = self._edge_points[a, b]
                for k, point in enumerate(inner, start=1):
                    place[point] = place[a] + (place[b] - place[a]) * (k / (len(inner) + 1))
            ring, inside, first = self._inside[tuple(sorted(loop))]
            if len(inside):
                frame = _Frame(np.array([place[k] for k in ring]))
                place.update(zip(range(first, first + len(inside)), frame.lift(inside), strict=True))

    def _oriented(self, gmsh: Any, loop: list[int]) -> Array:
        """Triangles of a face, turning as the loop does."""
        key = tuple(sorted(loop))
        if key not in self._meshes:
            ring = self._canonical(loop)
            self._meshes[key] = (ring, self._mesh_face(gmsh, ring, self._face_size[key]))
        ring, triangles = self._meshes[key]
        same = loop[(loop.index(ring[0]) + 1) % len(loop)] == ring[1]
        return triangles if same else triangles[:, ::-1]

    def _canonical(self, loop: list[int]) -> list[int]:
        """The loop from a corner and in a direction chosen by the corners' places, whoever lists it."""
        points = self._corners[sorted(loop)]
        extent = np.ptp(points, axis=0).max()
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        places = np.rint((self._corners[loop] - middle) / (extent * ROUND)).tolist()
        start = min(range(len(loop)), key=lambda k: (places[k], loop[k]))
        ahead = loop[start:] + loop[:start]
        there = places[(start + 1) % len(loop)], loop[(start + 1) % len(loop)]
        back = places[start - 1], loop[start - 1]
        return ahead if there < back else [ahead[0], *ahead[:0:-1]]

    def _divide(self, a: int, b: int) -> list[int]:
        """Points of the edge from a (included) to b (not included)."""
        key = (min(a, b), max(a, b))
        if key not in self._edge_points:
            ends = self._corners[list(key)]
            length = float(np.linalg.norm(ends[1] - ends[0]))
            parts = max(1, int(np.ceil(length / self._edge_size[key] - 1e-6)))
            first = len(self._points)
            self._points.extend(ends[0] + (ends[1] - ends[0]) * (k / parts) for k in range(1, parts))
            self._edge_points[key] = list(range(first, len(self._points)))
        inner = self._edge_points[key]
        return [a, *(inner if a < b else inner[::-1])]

    def _mesh_face(self, gmsh: Any, ring: list[int], size: float) -> Array:
        """Triangles (numbers of shared points) of a face given by its corners."""
        corners = self._corners[ring]
        sides = [self._divide(a, b) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]
        boundary = [v for side in sides for v in side]
        frame = _Frame(corners)
        key = tuple(sorted(ring))
        self._inside[key] = ring, np.empty((0, 2)), len(self._points)
        if len(boundary) == len(ring) and frame.extent <= _WHOLE * size:
            return np.array([[ring[k] for k in t] for t in triangulate(corners.tolist())])
        rounded = np.rint(frame.drop(corners) / ROUND) * ROUND
        divisions = np.array([len(side) for side in sides])
        relative = float(np.rint(min(size / frame.extent, 1e3) / ROUND) * ROUND)
        edge = frame.drop(np.array([self._points[k] for k in boundary]))
        for algorithm in _ALGORITHMS:
            meshed = mesh_polygon(gmsh, rounded, divisions, relative, algorithm)
            if meshed is not None and _covers(np.concatenate([edge, meshed[0]]), meshed[1], _area2(edge), len(edge)):
                break
        else:
            raise MeshError(f"gmsh cannot mesh the face with corners {corners.tolist()}")
        first = len(self._points)
        self._inside[key] = ring, meshed[0], first
        self._points.extend(frame.lift(meshed[0]))
        return np.concatenate([boundary, np.arange(first, len(self._points))]).astype(np.int64)[meshed[1]]


class _Frame:
    """Axes in the plane of a face, the first along its first side: a turned copy of a face looks the same."""

    def __init__(self, corners: Array) -> None:
        normal = np.array(area_vector(corners.tolist()))
        normal /= np.linalg.norm(normal)
        side = corners[1] - corners[0]
        side = side - (side @ normal) * normal
        self.u = side / np.linalg.norm(side)
        self.v = np.cross(normal, self.u)
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        self.middle = middle - ((middle - corners.mean(axis=0)) @ normal) * normal
        self.extent = 1.0
        self.extent = float(np.ptp(self.drop(corners), axis=0).max())

    def drop(self, points: Array) -> Array:
        """Coordinates (n, 2) in the plane, of order one."""
        local = (points - self.middle) / self.extent
        return np.column_stack([local @ self.u, local @ self.v])

    def lift(self, plane: Array) -> Array:
        """Points (n, 3) in space."""
        return self.middle + self.extent * (plane[:, :1] * self.u + plane[:, 1:] * self.v)


def _edges(loop: list[int]) -> list[tuple[int, int]]:
    return [(min(a, b), max(a, b)) for a, b in zip(loop, loop[1:] + loop[:1], strict=True)]


def _area2(plane: Array) -> float:
    """Twice the area of a polygon in the plane."""
    after = np.roll(plane, -1, axis=0)
    return float(np.sum(plane[:, 0] * after[:, 1] - plane[:, 1] * after[:, 0]))


def _covers(points: Array, triangles: Array, area2: float, n_boundary: int) -> bool:
    """Whether triangles are all positive, use every boundary point and fill the polygon."""
    if not len(triangles) or triangles.min() < 0:
        return False
    a, b, c = (points[triangles[:, k]] for k in range(3))
    areas = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    if not np.all(areas > 1e-9 * area2 / len(triangles)):
        return False
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return abs(areas.sum() - area2) <= 1e-5 * area2 and int(np.sum(counts == 1)) == n_boundary
