"""Cutting closed surfaces of polygons by planes and taking one solid out of another.

All pieces of one cut refer to one pool of vertices, so pieces that a cut made neighbours share their
common faces exactly. A crossing of an edge and a plane is computed from the edge's ends in sorted
order: blocks that share the edge get the same bits. Vertices within a tolerance of the plane count as
on it, so that no sliver can arise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from fdem.errors import MeshError
from fdem.scene.polygons import area_vector, plane_basis, regions, trace, triangulate
from fdem.scene.polyhedra import Polyhedron

__all__ = [
    "CavityError",
    "Face",
    "Plane",
    "Pool",
    "as_polyhedron",
    "complement",
    "components",
    "divide",
    "faces_of",
    "heights",
    "pinched",
    "sides",
]

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
        For a vertex made by a cut, the ends of the edge it was made on.
    tolerance : float
        Distance within which a vertex lies on a plane [m].
    """

    def __init__(self, shape: Polyhedron) -> None:
        self.points: list[Point] = [(x, y, z) for x, y, z in shape.points.tolist()]
        self.parents: dict[int, tuple[int, int]] = {}
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
                return k
        self.points.append(new)
        self._made[key] = len(self.points) - 1
        self.parents[self._made[key]] = (a, b)
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


def heights(pool: Pool, faces: Iterable[Face], plane: Plane) -> dict[int, float]:
    """Signed distance of every vertex of the faces from a plane, 0 within the tolerance [m]."""
    (ox, oy, oz), (nx, ny, nz), offset = plane
    out: dict[int, float] = {}
    for face in faces:
        for v in face.loop:
            if v not in out:
                x, y, z = pool.points[v]
                h = (x - ox) * nx + (y - oy) * ny + (z - oz) * nz - offset
                out[v] = 0.0 if abs(h) <= pool.tolerance else h
    return out


def divide(
    pool: Pool, faces: list[Face], plane: Plane, tag: str | None
) -> tuple[list[Face], list[Face], list[list[int]]]:
    """Cut a closed surface by a plane.

    Parameters
    ----------
    pool : Pool
        Vertices; new ones are added.
    faces : list of Face
        Closed surface of planar faces.
    plane : Plane
        The cut; `normal` is a unit vector.
    tag : str or None
        Tag of the new faces.

    Returns
    -------
    above, below : list of Face
        Closed surfaces on the two sides, empty if nothing lies there; each may be several solids.
    caps : list of list of int
        The section: simple loops, counter-clockwise seen from below.

    Raises
    ------
    MeshError
        If the section does not close (a plane that grazes a self-touching solid).
    """
    d = heights(pool, faces, plane)
    if all(h >= 0.0 for h in d.values()):
        return faces, [], []
    if all(h <= 0.0 for h in d.values()):
        return [], faces, []
    above: list[Face] = []
    below: list[Face] = []
    for face in faces:
        signs = [d[v] for v in face.loop]
        up, down = max(signs) > 0.0, min(signs) < 0.0
        if up and down:
            ring = _ring(pool, face.loop, d, plane)
            above += [Face(loop, face.tag, face.source) for loop in _side(pool, ring, d, plane.normal, 1.0)]
            below += [Face(loop, face.tag, face.source) for loop in _side(pool, ring, d, plane.normal, -1.0)]
        elif up or down:
            (above if up else below).append(face)
        else:
            # a face in the plane belongs to the solid behind it
            (below if _dot(area_vector(_ring_points(pool, face)), plane.normal) > 0.0 else above).append(face)
    caps = _caps(pool, above + below, d, plane.normal)
    above += [Face(loop, tag, -1) for loop in caps]
    below += [Face(loop[::-1], tag, -1) for loop in caps]
    if not (_closed(above) and _closed(below)):
        raise MeshError("the section does not close")
    return above, below, caps


def sides(loop: Sequence[int]) -> list[tuple[int, int]]:
    """Directed edges of a loop."""
    return [(loop[k - 1], v) for k, v in enumerate(loop)]


def _planar(ring: Sequence[Point], tolerance: float) -> bool:
    """Whether all points of a loop lie in its mean plane."""
    n = area_vector(ring)
    length = _dot(n, n) ** 0.5
    o = ring[0]
    return all(
        abs((p[0] - o[0]) * n[0] + (p[1] - o[1]) * n[1] + (p[2] - o[2]) * n[2]) <= tolerance * length for p in ring
    )


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _minus(a: Sequence[float], b: Sequence[float]) -> Point:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _cross(a: Sequence[float], b: Sequence[float]) -> Point:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _ring_points(pool: Pool, face: Face) -> list[Point]:
    return [pool.points[v] for v in face.loop]


def _ring(pool: Pool, loop: list[int], d: dict[int, float], plane: Plane) -> list[int]:
    """The loop with its crossings inserted."""
    ring: list[int] = []
    for k, b in enumerate(loop):
        a = loop[k - 1]
        if d[a] * d[b] < 0.0:
            ring.append(pool.crossing(a, b, d[a], d[b], plane))
            d[ring[-1]] = 0.0
        ring.append(b)
    return ring


def _side(pool: Pool, ring: list[int], d: dict[int, float], normal: Point, sign: float) -> list[list[int]]:
    """Loops of the part of a face above (sign 1) or below the line in which it meets the plane.

    The boundary falls into chains on this side. Where the chains end they are sorted along the line;
    just off the line, inside and outside alternate, so the ends pair up in that order.
    """
    chains = _chains(ring, d, sign)
    on = [v for v in ring if d[v] == 0.0]
    if len(chains) == 1 and len(on) == 2:
        return chains
    points = pool.points
    direction = _cross(area_vector([points[v] for v in ring]), normal)
    along = {v: _dot(direction, _minus(points[v], points[on[0]])) for v in on}

    def slope(v: int, neighbour: int) -> float:
        return _dot(direction, _minus(points[neighbour], points[v])) / abs(d[neighbour])

    ends = []
    for i, chain in enumerate(chains):
        ends.append((along[chain[0]], slope(chain[0], chain[1]), i, 0))
        ends.append((along[chain[-1]], slope(chain[-1], chain[-2]), i, 1))
    ends.sort()
    following: dict[int, int] = {}
    for one, other in zip(ends[::2], ends[1::2], strict=True):
        if one[3] == other[3]:
            raise MeshError("the section of a face does not close")
        following[(one if one[3] else other)[2]] = (other if one[3] else one)[2]
    return _linked(chains, following, on, along)


def _chains(ring: list[int], d: dict[int, float], sign: float) -> list[list[int]]:
    """Stretches of a ring on one side of the plane, with the vertices on the plane at both ends."""
    start = next((k for k, v in enumerate(ring) if sign * d[v] <= 0.0), -1)
    if start < 0:
        raise MeshError("the section of a face does not close")
    chains: list[list[int]] = []
    turned = ring[start:] + ring[: start + 1]
    for k, v in enumerate(turned):
        if sign * d[v] <= 0.0:
            continue
        if sign * d[turned[k - 1]] <= 0.0:
            chains.append([turned[k - 1]])
        chains[-1].append(v)
        if sign * d[turned[k + 1]] <= 0.0:
            chains[-1].append(turned[k + 1])
    return chains


def _linked(
    chains: list[list[int]], following: dict[int, int], on: list[int], along: dict[int, float]
) -> list[list[int]]:
    """Chains joined into loops, with the vertices that lie on the joining segments."""
    loops = []
    todo = set(range(len(chains)))
    while todo:
        start = here = min(todo)
        loop: list[int] = []
        while True:
            todo.discard(here)
            loop += chains[here] if not loop or loop[-1] != chains[here][0] else chains[here][1:]
            there = following[here]
            a, b = along[chains[here][-1]], along[chains[there][0]]
            between = {v for v in on if min(a, b) < along[v] < max(a, b)}
            loop += sorted(between, key=along.__getitem__, reverse=a > b)
            here = there
            if here == start:
                break
        if loop[0] == loop[-1]:
            loop.pop()
        loops.append(loop)
    return loops


def _caps(pool: Pool, faces: Iterable[Face], d: dict[int, float], normal: Point) -> list[list[int]]:
    """The section as loops that close the part above the plane (counter-clockwise from below).

    `faces` are those of both sides. At every edge in the plane the faces around it, sorted by angle, tell
    whether solid lies in the plane left and right of it.
    """
    around: dict[tuple[int, int], list[tuple[float, bool]]] = {}
    for face in faces:
        signs = [d[v] for v in face.loop]
        for k, b in enumerate(face.loop):
            a = face.loop[k - 1]
            if d[a] != 0.0 or d[b] != 0.0:
                continue
            key = (min(a, b), max(a, b))
            axis = _minus(pool.points[key[1]], pool.points[key[0]])
            into = _cross(area_vector(_ring_points(pool, face)), axis)
            sign = 1.0 if a < b else -1.0
            left = sign * _dot(into, _cross(normal, axis))
            if max(signs) > 0.0 or min(signs) < 0.0:
                # a face that is off the plane stays so, whatever the round-off
                up = abs(_dot(into, normal)) * (1.0 if max(signs) > 0.0 else -1.0)
                angle = float(np.arctan2(up, left * _dot(axis, axis) ** -0.5))
            else:
                angle = 0.0 if left > 0.0 else np.pi
            around.setdefault(key, []).append((angle, a < b))
    edges: list[tuple[int, int]] = []
    for (a, b), found in around.items():
        for start, edge in ((0.0, (b, a)), (np.pi, (a, b))):
            # solid lies clockwise of faces that run along the edge; a face in the plane is no cap
            gap, forward = min(((angle - start) % (2.0 * np.pi), forward) for angle, forward in found)
            if forward and gap > 0.0:
                edges.append(edge)
    vertices = sorted({v for edge in edges for v in edge})
    xy = _plane_coordinates(pool, vertices, [-x for x in normal])
    return regions(trace(edges, xy), xy)


def _plane_coordinates(pool: Pool, vertices: Sequence[int], normal: Sequence[float]) -> dict[int, tuple[float, float]]:
    """Coordinates of vertices in a plane, seen against its normal."""
    if not vertices:
        return {}
    u, v = plane_basis(normal)
    origin = min(pool.points[k] for k in vertices)
    relative = {k: _minus(pool.points[k], origin) for k in vertices}
    return {k: (float(_dot(r, u)), float(_dot(r, v))) for k, r in relative.items()}


def _closed(faces: Iterable[Face]) -> bool:
    """Whether every edge is run as often one way as the other."""
    balance: dict[tuple[int, int], int] = {}
    for face in faces:
        for k, b in enumerate(face.loop):
            a = face.loop[k - 1]
            key, step = ((a, b), 1) if a < b else ((b, a), -1)
            balance[key] = balance.get(key, 0) + step
    return not any(balance.values())


def components(pool: Pool, faces: list[Face]) -> list[list[Face]]:
    """Connected solids of a closed surface.

    Where more than two faces meet in an edge, those that bound the same wedge of solid belong together.

    Returns
    -------
    list of list of Face
        In the order of their first faces.

    Raises
    ------
    MeshError
        If a part of the surface is a cavity.
    """
    directed: dict[tuple[int, int], list[int]] = {}
    for i, face in enumerate(faces):
        for k, b in enumerate(face.loop):
            directed.setdefault((face.loop[k - 1], b), []).append(i)
    root = list(range(len(faces)))

    def find(i: int) -> int:
        while root[i] != i:
            root[i] = root[root[i]]
            i = root[i]
        return i

    for (a, b), owners in directed.items():
        if a < b:
            others = directed.get((b, a), [])
            for i, j in (
                _wedges(pool, faces, a, b, owners, others) if len(owners) > 1 else zip(owners, others, strict=True)
            ):
                one, two = sorted((find(i), find(j)))
                root[two] = one
    groups: dict[int, list[Face]] = {}
    for i, face in enumerate(faces):
        groups.setdefault(find(i), []).append(face)
    parts = list(groups.values())
    if len(parts) > 1 and any(_signed_volume(pool, part) < 0.0 for part in parts):
        raise CavityError("the cut leaves a cavity inside a block: cut the block by a plane through the cavity first")
    return parts


def pinched(faces: Sequence[Face]) -> tuple[int, int] | None:
    """An edge in which a solid touches itself, None if there is none."""
    seen: set[tuple[int, int]] = set()
    for face in faces:
        for edge in sides(face.loop):
            if edge in seen:
                return edge
            seen.add(edge)
    return None


def _wedges(
    pool: Pool, faces: list[Face], a: int, b: int, forward: list[int], backward: list[int]
) -> list[tuple[int, int]]:
    """Pairs of faces that bound one wedge of solid at an edge with more than two faces."""
    axis = _minus(pool.points[b], pool.points[a])
    u, v = plane_basis(axis)

    def angle(i: int, sign: float) -> float:
        into = _cross(area_vector(_ring_points(pool, faces[i])), axis)
        return float(np.arctan2(sign * _dot(into, v), sign * _dot(into, u)))

    # seen along the axis the solid lies clockwise of a forward face, up to the next backward one
    closing = [(angle(j, -1.0), j) for j in backward]
    pairs = []
    for i in forward:
        mine = angle(i, 1.0)
        pairs.append((i, min(closing, key=lambda c: (mine - c[0]) % (2.0 * np.pi))[1]))
    return pairs


def _signed_volume(pool: Pool, faces: Iterable[Face]) -> float:
    """Six times the volume of a closed surface of planar faces."""
    origin = None
    total = 0.0
    for face in faces:
        ring = _ring_points(pool, face)
        origin = origin or ring[0]
        total += 2.0 * _dot(area_vector(ring), _minus(ring[0], origin))
    return total


def complement(pool: Pool, base: list[Face], part: list[Face]) -> list[Face]:
    """What is left of a solid without a part that was cut out of it by planes.

    Parameters
    ----------
    pool : Pool
        The vertices of both.
    base : list of Face
        The solid; ``base[i].source == i``.
    part : list of Face
        A part of it; `source` tells the face of `base` a face lies on, -1 a cut.

    Returns
    -------
    list of Face
        Closed surface: the faces of the solid without those of the part, and the part's caps turned
        round. Faces stay whole polygons, no cut runs beyond the part.
    """
    vertices = {v for face in base for v in face.loop}
    edges = {(min(a, b), max(a, b)) for face in base for a, b in sides(face.loop)}
    locate = _locator(pool, vertices, edges)
    on_edge: dict[tuple[int, int], list[int]] = {}
    lost: dict[int, list[Face]] = {}
    for v in sorted({v for face in part for v in face.loop}):
        edge = locate(v)
        if edge is not None:
            on_edge.setdefault(edge, []).append(v)
    for face in part:
        lost.setdefault(face.source, []).append(face)
    out = [Face(face.loop[::-1], face.tag, -1) for face in lost.get(-1, [])]
    for i, face in enumerate(base):
        loop: list[int] = []
        for a, b in sides(face.loop):
            inside = on_edge.get((min(a, b), max(a, b)), [])
            start = pool.points[a]
            away = {v: _dot(r, r) for v in inside for r in [_minus(pool.points[v], start)]}
            loop += [a, *sorted(inside, key=away.__getitem__)]
        if i in lost:
            out += [Face(rest, face.tag, i) for rest in _difference(pool, face, loop, lost[i])]
        else:
            out.append(Face(loop, face.tag, i))
    if not _closed(out):
        raise MeshError("the surface left by a closed cutter does not close")
    return out


def _difference(pool: Pool, face: Face, loop: list[int], removed: list[Face]) -> list[list[int]]:
    """Loops of a plane face without parts of it; common edges are split at the same vertices."""
    edges = set(sides(loop))
    for gone in removed:
        for a, b in sides(gone.loop):
            if (a, b) in edges:
                edges.discard((a, b))
            else:
                edges.add((b, a))
    if not edges:
        return []
    xy = _plane_coordinates(pool, sorted({v for e in edges for v in e}), area_vector(_ring_points(pool, face)))
    return regions(trace(sorted(edges), xy), xy)


def _locator(pool: Pool, vertices: set[int], edges: set[tuple[int, int]]) -> Callable[[int], tuple[int, int] | None]:
    """A function that names the edge of a solid a cut's vertex was made on, None for other vertices."""
    known: dict[int, tuple[int, int] | None] = {}

    def locate(v: int) -> tuple[int, int] | None:
        if v in vertices or v not in pool.parents:
            return None
        if v not in known:
            a, b = pool.parents[v]
            at = [(p, None if p in vertices else locate(p)) for p in (a, b)]
            if a in vertices and b in vertices:
                key = (min(a, b), max(a, b))
                known[v] = key if key in edges else None
            else:
                # one end at least lies inside the edge, if the vertex does
                edge = next((e for _, e in at if e is not None), None)
                fits = edge is not None and all(e == edge or (e is None and p in edge) for p, e in at)
                known[v] = edge if fits else None
        return known[v]

    return locate
