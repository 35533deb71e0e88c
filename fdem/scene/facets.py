"""Facets of a body whose faces curve: its surface triangles, divided until they follow a quadratic displacement."""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from typing import Any

import numpy as np

from fdem.scene.handles import surface_of
from fdem.scene.polygons import Array, Ints

__all__ = ["Facets", "facets"]

# a right triangle of two legs of the size asked for stays whole
LONGEST = 1.5


@dataclass(frozen=True)
class Facets:
    """A divided surface.

    Attributes
    ----------
    points : (n, 3) array
        Gridpoints [m]; the vertices of the body come first.
    triangles : (m, 3) int32 array
        Outward.
    triangle_face : (m,) int32 array
        Face of the body each lies on.
    """

    points: Array
    triangles: Ints
    triangle_face: Ints


def facets(shape: Any, size: float | None) -> Facets:
    """Divide the surface of a body.

    Parameters
    ----------
    shape : Shape
        The body.
    size : float or None
        Target edge [m]; None: two thirds of the cube root of the volume.

    Returns
    -------
    Facets
        Conforming triangles. Edges are halved at least once, unless the vertices tell all quadratic functions apart;
        every face that is divided has a gridpoint within.

    Notes
    -----
    Longest edges are halved first (Rivara 1984), so angles do not fall below half of what they were.
    """
    surface = surface_of(shape)
    points = [np.asarray(p) for p in np.asarray(surface.points)]
    triangles = [tuple(int(i) for i in t) for t in np.asarray(surface.triangles)]
    faces = [int(f) for f in surface.triangle_face]
    if not _tells_quadratics(np.array(points)):
        triangles, faces = _quartered(points, triangles, faces)
    target = 2.0 / 3.0 * float(np.cbrt(shape.volume)) if size is None else float(size)
    _bisect(points, triangles, faces, (LONGEST * target) ** 2)
    _fill(points, triangles, faces)
    return Facets(np.array(points), np.array(triangles, dtype=np.int32), np.array(faces, dtype=np.int32))


def _tells_quadratics(points: Array) -> bool:
    """Whether values at the points determine a quadratic function."""
    x, y, z = ((points - points.mean(axis=0)) / np.ptp(points, axis=0).max()).T
    basis = np.column_stack([np.ones(len(points)), x, y, z, x * x, y * y, z * z, y * z, z * x, x * y])
    return len(points) >= 10 and bool(np.linalg.svd(basis, compute_uv=False)[9] > 1e-6)


def _quartered(points: list[Array], triangles: list[Any], faces: list[int]) -> tuple[list[Any], list[int]]:
    """Every triangle in four, by the middles of its edges, which go to the end of `points`."""
    middle: dict[tuple[int, int], int] = {}

    def between(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in middle:
            middle[key] = len(points)
            points.append(0.5 * (points[key[0]] + points[key[1]]))
        return middle[key]

    result, owner = [], []
    for (a, b, c), face in zip(triangles, faces, strict=True):
        ab, bc, ca = between(a, b), between(b, c), between(c, a)
        result += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        owner += [face] * 4
    return result, owner


def _bisect(points: list[Array], triangles: list[Any], faces: list[int], limit: float) -> None:
    """Halve edges whose squared length is above `limit` [m^2], the longest first, in place."""
    sides: dict[tuple[int, int], list[int]] = {}

    def square(edge: tuple[int, int]) -> float:
        """Over the limit, and rounded: equal edges stay equal when the body is turned, and their order decides."""
        d = points[edge[0]] - points[edge[1]]
        return round(float(d @ d) / limit, 9)

    def edges(t: int) -> list[tuple[int, int]]:
        a, b, c = triangles[t]
        return [(min(p), max(p)) for p in ((a, b), (b, c), (c, a))]

    for t in range(len(triangles)):
        for edge in edges(t):
            sides.setdefault(edge, []).append(t)
    heap = [(-square(edge), edge) for edge in sides if square(edge) > 1.0]
    heapify(heap)
    while heap:
        edge = heappop(heap)[1]
        if edge not in sides:
            continue
        a, b = edge
        new = len(points)
        points.append(0.5 * (points[a] + points[b]))
        for t in sides.pop(edge):
            corners = triangles[t]
            k = next(k for k in range(3) if corners[k] not in edge)
            apex, first, second = corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]
            for old in edges(t):
                if old != edge:
                    sides[old].remove(t)
            triangles[t] = (apex, first, new)
            triangles.append((apex, new, second))
            faces.append(faces[t])
            for u in (t, len(triangles) - 1):
                for touched in edges(u):
                    known = touched in sides
                    sides.setdefault(touched, []).append(u)
                    if not known and square(touched) > 1.0:
                        heappush(heap, (-square(touched), touched))


def _fill(points: list[Array], triangles: list[Any], faces: list[int]) -> None:
    """Give divided faces a gridpoint within that have none: the middle of their largest triangle, in place."""
    owners: dict[int, set[int]] = {}
    members: dict[int, list[int]] = {}
    for t, (corners, face) in enumerate(zip(triangles, faces, strict=True)):
        members.setdefault(face, []).append(t)
        for corner in corners:
            owners.setdefault(corner, set()).add(face)
    for face, mine in members.items():
        if len(mine) == 1 or any(len(owners[c]) == 1 for t in mine for c in triangles[t]):
            continue
        sizes = []
        for t in mine:
            a, b, c = (points[k] for k in triangles[t])
            sizes.append(float(np.linalg.norm(np.cross(b - a, c - a))))
        largest = max(sizes)
        t = next(t for t, size in zip(mine, sizes, strict=True) if size >= largest * (1 - 1e-9))
        i, j, k = triangles[t]
        new = len(points)
        points.append((points[i] + points[j] + points[k]) / 3.0)
        triangles[t] = (i, j, new)
        triangles.extend([(j, k, new), (k, i, new)])
        faces.extend([face, face])
