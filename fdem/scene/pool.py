"""Vertices that the pieces of a cut share, faces over them, and the arithmetic of both."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from fdem.errors import MeshError
from fdem.scene.polygons import area_vector, plane_basis, triangulate
from fdem.scene.polyhedra import Polyhedron

# vertices within this part of the size (and of the coordinates' round-off) of a plane lie on it
SNAP = 1e-9


ROUND_OFF = 8.0 * float(np.finfo(np.float64).eps)


Point = tuple[float, float, float]


class CavityError(MeshError):
    """A cut would leave a hollow block."""


class Plane(NamedTuple):
    """Points x with ``(x - origin) . normal == offset``."""

    origin: Point
    normal: Point
    offset: float = 0.0


class Face(NamedTuple):
    """A simple vertex loop, counter-clockwise from outside; `source` -1 is a cap of the cut."""

    loop: list[int]
    tag: str | None
    source: int


class Pool:
    """Vertices of a shape and of everything cut from it.

    Parameters
    ----------
    shape : Polyhedron
        Its vertices come first.

    Attributes
    ----------
    points : list of (x, y, z)
        [m].
    parents : dict
        For a vertex made by a cut, the ends of the edges it was made on.
    tolerance : float
        Distance within which a vertex lies on a plane [m].
    """

    def __init__(self, shape: Polyhedron) -> None:
        self.points: list[Point] = [(x, y, z) for x, y, z in shape.points.tolist()]
        self.parents: dict[int, list[tuple[int, int]]] = {}
        self._made: dict[tuple[int, int, Plane], int] = {}
        self.tolerance = SNAP * shape.size + ROUND_OFF * float(np.abs(shape.bounds).max())

    def crossing(self, a: int, b: int, da: float, db: float, plane: Plane) -> int:
        """The vertex where the edge a-b, at heights `da` and `db`, meets the plane."""
        key = (min(a, b), max(a, b), plane)
        if key in self._made:
            return self._made[key]
        if self.points[b] < self.points[a]:
            a, b, da, db = b, a, db, da
        t = da / (da - db)
        p, q = self.points[a], self.points[b]
        new = (p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1]), p[2] + t * (q[2] - p[2]))
        near = 1e-3 * self.tolerance
        for k, o in enumerate(self.points):
            # the same edge met by the same plane after it had been divided elsewhere
            if abs(o[0] - new[0]) <= near and abs(o[1] - new[1]) <= near and abs(o[2] - new[2]) <= near:
                self._made[key] = k
                self.parents.setdefault(k, []).append((a, b))
                return k
        self.points.append(new)
        self._made[key] = len(self.points) - 1
        self.parents[self._made[key]] = [(a, b)]
        return self._made[key]


def faces_of(shape: Polyhedron, pool: Pool) -> list[Face]:
    """Planar faces of a polyhedron; those that are not planar come as triangles."""
    out: list[Face] = []
    for face, tag in zip(shape.faces, shape.face_tags, strict=True):
        loop = face.tolist()
        ring = [pool.points[v] for v in loop]
        if len(loop) > 3 and not _planar(ring, pool.tolerance):
            for i, j, k in triangulate(ring):
                out.append(Face([loop[i], loop[j], loop[k]], tag, len(out)))
        else:
            out.append(Face(loop, tag, len(out)))
    return out


def as_polyhedron(pool: Pool, faces: Sequence[Face], name: str | None = None) -> Polyhedron:
    """The polyhedron that faces of a pool make."""
    used = sorted({v for face in faces for v in face.loop})
    new = dict(zip(used, range(len(used)), strict=True))
    loops = [[new[v] for v in face.loop] for face in faces]
    return Polyhedron.trusted(np.array([pool.points[v] for v in used]), loops, [f.tag for f in faces], name)


def sides(loop: Sequence[int]) -> list[tuple[int, int]]:
    """Directed edges of a loop."""
    return [(loop[k - 1], v) for k, v in enumerate(loop)]


def _planar(ring: Sequence[Point], tolerance: float) -> bool:
    """Whether all points of a loop lie in its mean plane."""
    n = area_vector(ring)
    length = dot(n, n) ** 0.5
    o = ring[0]
    return all(
        abs((p[0] - o[0]) * n[0] + (p[1] - o[1]) * n[1] + (p[2] - o[2]) * n[2]) <= tolerance * length for p in ring
    )


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def minus(a: Sequence[float], b: Sequence[float]) -> Point:
    """Vector from b to a."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def cross(a: Sequence[float], b: Sequence[float]) -> Point:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def ring_points(pool: Pool, face: Face) -> list[Point]:
    """Coordinates of a face's vertices, in order [m]."""
    return [pool.points[v] for v in face.loop]


def plane_coordinates(pool: Pool, vertices: Sequence[int], normal: Sequence[float]) -> dict[int, tuple[float, float]]:
    """Coordinates of vertices in a plane, seen against its normal."""
    if not vertices:
        return {}
    u, v = (axis.tolist() for axis in plane_basis(normal))
    origin = min(pool.points[k] for k in vertices)
    relative = {k: minus(pool.points[k], origin) for k in vertices}
    return {k: (dot(r, u), dot(r, v)) for k, r in relative.items()}


def closed(faces: Iterable[Face]) -> bool:
    """Whether every edge is run as often one way as the other."""
    balance: dict[tuple[int, int], int] = {}
    for face in faces:
        for k, b in enumerate(face.loop):
            a = face.loop[k - 1]
            key, step = ((a, b), 1) if a < b else ((b, a), -1)
            balance[key] = balance.get(key, 0) + step
    return not any(balance.values())
