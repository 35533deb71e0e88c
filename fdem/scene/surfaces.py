"""Surface meshes of blocks to be zoned: edges and cells of faces are divided once for all blocks that share them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fdem.errors import MeshError
from fdem.scene.gmsh_session import ROUND, mesh_polygon
from fdem.scene.interfaces import Interfaces, cell_key, edges_of
from fdem.scene.polygons import area_vector, triangulate

__all__ = ["BlockSurface", "SharedSurfaces"]

Array = Any

_LONG = 0.37  # of the longest side: long enough to lay the axes of a face along
_SPARE = 0.25  # of the zone size: pieces of an edge this much too long are not divided once more
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

    Attributes
    ----------
    interfaces : Interfaces
        What the faces have in common.

    Notes
    -----
    Edges are cut into ``ceil(length / size)`` equal parts, pieces between nodes a little more coarsely; the cells of
    faces are meshed in a frame of their own that starts at a corner chosen by geometry. So two blocks that share a
    cell get the same triangles, to the bit, and equal shapes get equal meshes wherever they stand.
    """

    def __init__(self, shapes: Sequence[Any], sizes: Sequence[float], names: Sequence[int]) -> None:
        self._shapes, self._names = shapes, names
        self.interfaces = Interfaces(shapes, sizes)
        self._edge_size: dict[tuple[int, int], float] = {}
        self._cell_size: dict[tuple[int, ...], float] = {}
        for faces, size in zip(self.interfaces.cells, sizes, strict=True):
            for loop in (loop for cells in faces for loop in cells):
                key = cell_key(loop)
                self._cell_size[key] = min(size, self._cell_size.get(key, np.inf))
                for edge in edges_of(loop):
                    self._edge_size[edge] = min(size, self._edge_size.get(edge, np.inf))
        self._pieces = self.interfaces.nodes.pieces()
        self._points: list[Array] = list(self.interfaces.points)
        self._edge_points: dict[tuple[int, int], list[int]] = {}
        self._inside: dict[tuple[int, ...], _Inner] = {}
        self._meshes: dict[tuple[int, ...], tuple[list[int], Array]] = {}

    def is_finer(self, block: int) -> bool:
        """Whether neighbours give a block nodes on its edges or smaller triangles than it asks for itself."""
        found = self.interfaces
        for (loop, _), cells in zip(found.faces[block], found.cells[block], strict=True):
            if len(cells) > 1 or len(cells[0]) > len(loop) or np.isfinite(self._cell_size[cell_key(loop)]):
                return True
            if any(np.isfinite(self._edge_size[edge]) for edge in edges_of(loop)):
                return True
        return False

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
        found = self.interfaces
        triangles, owner = [], []
        for (_, number), cells in zip(found.faces[block], found.cells[block], strict=True):
            for loop in cells:
                try:
                    triangles.append(self._oriented(gmsh, loop))
                except MeshError as error:
                    raise MeshError(f"block {self._names[block]}, face {number}: {error}") from None
                owner.append(np.full(len(triangles[-1]), number))
        used, local = np.unique(np.concatenate(triangles), return_inverse=True)
        points = np.array([self._points[k] for k in used.tolist()])
        own = dict(zip(found.ids[block], self._shapes[block].points, strict=True))
        for row, k in enumerate(used.tolist()):
            if k in own:
                points[row] = own[k]
        corners = np.array(list(own.values()))
        lower, upper = corners.min(axis=0), corners.max(axis=0)
        extent, middle = float((upper - lower).max()), 0.5 * (lower + upper)
        place = {k: np.rint((p - middle) / (extent * ROUND)) * ROUND for k, p in own.items()}
        for (loop, _), cells in zip(found.faces[block], found.cells[block], strict=True):
            self._place_nodes(loop, cells, place)
            for cell in cells:
                self._place_inner(cell, place)
        places = np.rint(np.array([place[k] for k in used.tolist()]) / ROUND) * ROUND
        return BlockSurface(points, places, local.reshape(-1, 3), np.concatenate(owner), middle, extent)

    def _place_nodes(self, loop: list[int], cells: list[list[int]], place: dict[int, Array]) -> None:
        """Normalised places of the corners of cells, from those of the block's corners.

        What is rounded is the place along an edge or in the plane of a face, so that edges stay straight.
        """
        found = self.interfaces
        for a, b in edges_of(loop):
            p, q = found.points[a], found.points[b]
            for node in found.nodes.between(a, b):
                part = float((found.points[node] - p) @ (q - p)) / float((q - p) @ (q - p))
                place[node] = place[a] + (place[b] - place[a]) * (np.rint(part / ROUND) * ROUND)
        inner = sorted({v for cell in cells for v in cell} - place.keys())
        if inner:
            corners = found.places(loop)
            first = _first_side(corners)
            plane = np.rint(_Frame(corners, first).drop(found.places(inner)) / ROUND) * ROUND
            there = _Frame(np.array([place[k] for k in loop]), first)
            place.update(zip(inner, there.lift(plane), strict=True))

    def _place_inner(self, cell: list[int], place: dict[int, Array]) -> None:
        """Normalised places of points on edges and inside of a cell, from those of its corners.

        Rounding the corners alone, and not every point, is what makes the mesh insensitive to noise in the
        coordinates: a few roundings instead of thousands could tip over.
        """
        for a, b in edges_of(cell):
            inner = self._edge_points[a, b]
            for k, point in enumerate(inner, start=1):
                place[point] = place[a] + (place[b] - place[a]) * (k / (len(inner) + 1))
        inside = self._inside[cell_key(cell)]
        if len(inside.plane):
            frame = _Frame(np.array([place[k] for k in inside.ring]), inside.first)
            numbers = range(inside.start, inside.start + len(inside.plane))
            place.update(zip(numbers, frame.lift(inside.plane), strict=True))

    def _oriented(self, gmsh: Any, loop: list[int]) -> Array:
        """Triangles of a cell, turning as the loop does."""
        key = cell_key(loop)
        if key not in self._meshes:
            ring = self._canonical(loop)
            self._meshes[key] = (ring, self._mesh_cell(gmsh, ring, self._cell_size[key]))
        ring, triangles = self._meshes[key]
        same = loop[(loop.index(ring[0]) + 1) % len(loop)] == ring[1]
        return triangles if same else triangles[:, ::-1]

    def _canonical(self, loop: list[int]) -> list[int]:
        """The loop from a corner and in a direction chosen by the corners' places, whoever lists it."""
        points = self.interfaces.places(loop)
        lower, upper = points.min(axis=0), points.max(axis=0)
        places = np.rint((points - 0.5 * (lower + upper)) / ((upper - lower).max() * ROUND)).tolist()
        start = min(range(len(loop)), key=lambda k: (places[k], loop[k]))
        ahead = loop[start:] + loop[:start]
        there = places[(start + 1) % len(loop)], loop[(start + 1) % len(loop)]
        back = places[start - 1], loop[start - 1]
        return ahead if there < back else [ahead[0], *ahead[:0:-1]]

    def _divide(self, a: int, b: int) -> list[int]:
        """Points of the edge from a (included) to b (not included)."""
        key = (min(a, b), max(a, b))
        if key not in self._edge_points:
            ends = self.interfaces.places(key)
            length = float(np.linalg.norm(ends[1] - ends[0]))
            spare = _SPARE if key in self._pieces else 1e-6
            parts = max(1, int(np.ceil(length / self._edge_size[key] - spare)))
            first = len(self._points)
            self._points.extend(ends[0] + (ends[1] - ends[0]) * (k / parts) for k in range(1, parts))
            self._edge_points[key] = list(range(first, len(self._points)))
        inner = self._edge_points[key]
        return [a, *(inner if a < b else inner[::-1])]

    def _mesh_cell(self, gmsh: Any, ring: list[int], size: float) -> Array:
        """Triangles (numbers of shared points) of a cell given by its corners."""
        corners = self.interfaces.places(ring)
        sides = [self._divide(a, b) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]
        boundary = [v for side in sides for v in side]
        first = _first_side(corners)
        frame = _Frame(corners, first)
        key = cell_key(ring)
        self._inside[key] = _Inner(ring, first, np.empty((0, 2)), len(self._points))
        if len(boundary) == len(ring) and frame.extent <= _WHOLE * size:
            return np.array([[ring[k] for k in t] for t in triangulate(corners.tolist())])
        rounded = _rounded(frame.drop(corners))
        divisions = np.array([len(side) for side in sides])
        relative = float(np.rint(min(size / frame.extent, 1e3) / ROUND) * ROUND)
        edge = frame.drop(np.array([self._points[k] for k in boundary]))
        for algorithm in _ALGORITHMS:
            meshed = mesh_polygon(gmsh, rounded, divisions, relative, algorithm)
            if meshed is not None and _covers(np.concatenate([edge, meshed[0]]), meshed[1], _area2(edge), len(edge)):
                break
        else:
            raise MeshError(f"gmsh cannot mesh the face with corners {corners.tolist()}")
        start = len(self._points)
        self._inside[key] = _Inner(ring, first, meshed[0], start)
        self._points.extend(frame.lift(meshed[0]))
        return np.concatenate([boundary, np.arange(start, len(self._points))]).astype(np.int64)[meshed[1]]


@dataclass(frozen=True)
class _Inner:
    """Points inside a cell: numbers from `start` on, `plane` (n, 2) in the frame of the ring."""

    ring: list[int]
    first: int
    plane: Array
    start: int


class _Frame:
    """Axes in the plane of a face, one along its side `first`: a turned copy of a face looks the same."""

    def __init__(self, corners: Array, first: int) -> None:
        normal = np.array(area_vector(corners.tolist()))
        normal /= np.linalg.norm(normal)
        side = corners[(first + 1) % len(corners)] - corners[first]
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


def _first_side(corners: Array) -> int:
    """The first side that is long enough to tell a direction after rounding."""
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    return int(np.argmax(lengths > _LONG * lengths.max()))


def _rounded(plane: Array) -> Array:
    """Corners rounded; those in the middle of a straight side stay on it, rounded along it."""
    out = np.rint(plane / ROUND) * ROUND
    before, after = np.roll(plane, 1, axis=0), np.roll(plane, -1, axis=0)
    chord, r = after - before, plane - before
    length = np.sqrt((chord * chord).sum(axis=1))
    along = (chord * r).sum(axis=1) / length
    off = np.abs(chord[:, 0] * r[:, 1] - chord[:, 1] * r[:, 0]) / length
    bent = np.flatnonzero(~((off < 0.5 * ROUND) & (along > 0.0) & (along < length)))
    if len(bent) < 3:
        return out
    for i, j in zip(bent.tolist(), np.roll(bent, -1).tolist(), strict=True):
        side = plane[j] - plane[i]
        for k in range(i + 1, j if j > i else j + len(plane)):
            part = np.rint((plane[k % len(plane)] - plane[i]) @ side / (side @ side) / ROUND) * ROUND
            out[k % len(plane)] = out[i] + (out[j] - out[i]) * part
    return out


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
