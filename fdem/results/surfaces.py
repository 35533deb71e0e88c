"""Geometry behind the pictures: edges worth drawing, cuts through closed blocks, joints painted on faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Section", "cap", "feature_edges", "normals", "paint", "refine", "section"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]


def normals(points: Array, triangles: Ints) -> Array:
    """Find the unit normals (n, 3) of triangles; zero where a triangle has no area."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)


def feature_edges(points: Array, triangles: Ints, angle: float = 20.0) -> tuple[Ints, Ints]:
    """Edges where a surface bends, or ends.

    Parameters
    ----------
    points : (n, 3) array
        Points [m].
    triangles : (m, 3) int32 array
        Triangles.
    angle : float, optional
        The least angle between two triangles that makes their edge a feature [degrees].

    Returns
    -------
    edges : (k, 2) int32 array
        Points of the edges.
    sides : (k, 2) int32 array
        Triangles on both sides; twice the same at an end.
    """
    if not len(triangles):
        return np.empty((0, 2), dtype=np.int32), np.empty((0, 2), dtype=np.int32)
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.int64)
    owner = np.repeat(np.arange(len(triangles)), 3)
    key = edges[:, 0] * len(points) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    key, owner, edges = key[order], owner[order], edges[order]
    first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    count = np.diff(np.append(first, len(key)))
    normal = normals(points, triangles)
    second = np.where(count > 1, np.minimum(first + 1, len(key) - 1), first)
    cosine = np.einsum("ij,ij->i", normal[owner[first]], normal[owner[second]])
    bent = (count != 2) | (cosine < np.cos(np.radians(angle)))
    sides = np.stack([owner[first], owner[second]], axis=1)
    return edges[first[bent]].astype(np.int32), sides[bent].astype(np.int32)


@dataclass(frozen=True)
class Section:
    """Where a plane cuts triangles: points on their edges, joined by segments.

    Parameters
    ----------
    ends : (n, 2) int32 array
        Points of the edge that each point of the section lies on.
    weight : (n,) array
        Its place there: 0 at the first end, 1 at the second.
    segments : (k, 2) int32 array
        Points of the section.
    triangle : (k,) int32 array
        Triangle that each segment lies in.
    """

    ends: Ints
    weight: Array
    segments: Ints
    triangle: Ints

    def interpolate(self, values: Array) -> Array:
        """Values at the points of the section from values (n_points, ...) at the points."""
        weight = self.weight.reshape(-1, *(1,) * (values.ndim - 1))
        return (1.0 - weight) * values[self.ends[:, 0]] + weight * values[self.ends[:, 1]]


def section(points: Array, triangles: Ints, normal: Array, origin: Array) -> Section:
    """Cut triangles with a plane.

    A point counts as on the positive side only if it is strictly so: each triangle is cut in two
    edges or not at all, and closed surfaces give closed loops, whatever lies in the plane.
    """
    distance = (points - origin) @ normal
    above = distance > 0.0
    side = above[triangles]
    crossed = np.flatnonzero(side.any(axis=1) & ~side.all(axis=1))
    corners = triangles[crossed]
    ring = corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 3, 2)
    cut = above[ring[:, :, 0]] != above[ring[:, :, 1]]
    edges = np.sort(ring[cut], axis=1).astype(np.int64)
    _, first, segment = np.unique(edges[:, 0] * len(points) + edges[:, 1], return_index=True, return_inverse=True)
    ends = edges[first].astype(np.int32).reshape(-1, 2)
    d = distance[ends]
    weight = d[:, 0] / (d[:, 0] - d[:, 1])
    return Section(ends, weight, segment.reshape(-1, 2).astype(np.int32), crossed.astype(np.int32))


def cap(points: Array, segments: Ints, normal: Array) -> Ints:
    """Triangles (n, 3) that fill the closed loops of segments in a plane of this normal."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
    from vtkmodules.vtkFiltersGeneral import vtkContourTriangulator

    used, local = np.unique(segments, return_inverse=True)
    lines = vtkCellArray()
    for a, b in local.reshape(-1, 2):
        lines.InsertNextCell(2)
        lines.InsertCellPoint(int(a))
        lines.InsertCellPoint(int(b))
    vertices = vtkPoints()
    vertices.SetData(numpy_to_vtk(np.ascontiguousarray(points[used]), deep=True))
    loops = vtkPolyData()
    loops.SetPoints(vertices)
    loops.SetLines(lines)
    filler = vtkContourTriangulator()
    filler.TriangulationErrorDisplayOff()
    filler.SetInputData(loops)
    filler.Update()
    faces = filler.GetOutput().GetPolys()
    triangles = vtk_to_numpy(faces.GetConnectivityArray()).reshape(-1, 3)
    filled = used[triangles].astype(np.int32)
    flipped = normals(points, filled) @ normal < 0.0
    filled[flipped] = filled[flipped][:, ::-1]
    return filled


def refine(points: Array, triangles: Ints, size: float, limit: int = 200_000) -> tuple[Array, Ints, Ints]:
    """Split triangles in four until their edges are no longer than `size` or there are too many.

    Points may have more columns than the three that lengths are taken from; all are interpolated.

    Returns
    -------
    points : (n, ...) array
        Points, first those given.
    triangles : (m, 3) int32 array
        Triangles.
    parent : (m,) int32 array
        Given triangle of each.
    """
    parent = np.arange(len(triangles), dtype=np.int32)
    while len(triangles) < limit:
        corner = points[triangles]
        longest = np.linalg.norm((corner - np.roll(corner, 1, axis=1))[:, :, :3], axis=2).max(axis=1, initial=0.0)
        large = longest > size
        if not large.any():
            break
        a, b, c = corner[large, 0], corner[large, 1], corner[large, 2]
        k, n = int(large.sum()), len(points)
        points = np.concatenate([points, 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)])
        ab, bc, ca = (n + k * i + np.arange(k, dtype=np.int32) for i in range(3))
        i, j, l_ = triangles[large].T
        quarters = [np.stack(t, axis=1) for t in ((i, ab, ca), (ab, j, bc), (ca, bc, l_), (ab, bc, ca))]
        triangles = np.concatenate([triangles[~large], *quarters]).astype(np.int32)
        parent = np.concatenate([parent[~large], np.tile(parent[large], 4)])
    return points, triangles, parent


def paint(table: dict[str, Any], positions: Array, outward: Array, block: Ints) -> Ints:
    """Find the contact that a place on a block's surface belongs to.

    Parameters
    ----------
    table : dict
        Contacts: ``position``, ``normal`` (from a to b), ``area``, ``block_a``, ``block_b``.
    positions : (n, 3) array
        Places [m].
    outward : (n, 3) array
        Outward normals there.
    block : (n,) int32 array
        Blocks they are on.

    Returns
    -------
    (n,) int32 array
        The nearest contact of the same block that faces the same way and is large enough to reach
        there; -1 if there is none.
    """
    from scipy.spatial import cKDTree

    n = len(table["area"])
    if not n or not len(positions):
        return np.full(len(positions), -1, dtype=np.int32)
    radius = np.sqrt(np.asarray(table["area"]) / np.pi)
    size = np.sqrt(np.mean(np.square(radius)))
    place = np.tile(table["position"], (2, 1))
    normal = np.concatenate([table["normal"], -np.asarray(table["normal"])])
    owner = np.concatenate([table["block_a"], table["block_b"]])
    if not size > 0.0:
        size = float(np.ptp(place, axis=0).max()) or 1.0
    # A seventh coordinate keeps blocks apart, three more turn faces that look elsewhere away
    apart = 10.0 + 2.0 * float(np.ptp(np.concatenate([place, positions]), axis=0).max()) / size
    tree = cKDTree(np.column_stack([place / size, 3.0 * normal, apart * owner]))
    _, nearest = tree.query(np.column_stack([positions / size, 3.0 * outward, apart * block]))
    offset = positions - place[nearest]
    reach = 2.0 * radius[nearest % n]
    good = (owner[nearest] == block) & (np.einsum("ij,ij->i", normal[nearest], outward) > 0.8)
    good &= np.einsum("ij,ij->i", offset, offset) <= reach**2
    return np.where(good, nearest % n, -1).astype(np.int32)
