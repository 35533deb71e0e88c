"""Cutting closed surfaces of polygons by planes and taking one solid out of another.

All pieces of one cut refer to one pool of vertices, so pieces that a cut made neighbours share their
common faces exactly. A crossing of an edge and a plane is computed from the edge's ends in sorted
order: blocks that share the edge get the same bits. Vertices within a tolerance of the plane count as
on it, so that no sliver can arise.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import atan2

import numpy as np

from fdem.errors import MeshError
from fdem.scene.polygons import area_vector, plane_basis, regions, trace
from fdem.scene.pool import (
    CavityError,
    Face,
    Plane,
    Point,
    Pool,
    closed,
    cross,
    dot,
    minus,
    plane_coordinates,
    ring_points,
    sides,
)


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
            (below if dot(area_vector(ring_points(pool, face)), plane.normal) > 0.0 else above).append(face)
    caps = _caps(pool, above + below, d, plane.normal)
    above += [Face(loop, tag, -1) for loop in caps]
    below += [Face(loop[::-1], tag, -1) for loop in caps]
    if any(_folded(pool, loop) for loop in caps):
        raise MeshError("the solid touches itself in the plane of the cut")
    if not (closed(above) and closed(below)):
        raise MeshError("the section does not close")
    return above, below, caps


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
    direction = cross(area_vector([points[v] for v in ring]), normal)
    along = {v: dot(direction, minus(points[v], points[on[0]])) for v in on}

    def slope(v: int, neighbour: int) -> float:
        return dot(direction, minus(points[neighbour], points[v])) / abs(d[neighbour])

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
        for k, b in enumerate(face.loop if signs.count(0.0) > 1 else ()):
            a = face.loop[k - 1]
            if d[a] != 0.0 or d[b] != 0.0:
                continue
            key = (min(a, b), max(a, b))
            axis = minus(pool.points[key[1]], pool.points[key[0]])
            into = cross(area_vector(ring_points(pool, face)), axis)
            sign = 1.0 if a < b else -1.0
            left = sign * dot(into, cross(normal, axis))
            if max(signs) > 0.0 or min(signs) < 0.0:
                # a face that is off the plane stays so, whatever the round-off
                up = abs(dot(into, normal)) * (1.0 if max(signs) > 0.0 else -1.0)
                angle = atan2(up, left * dot(axis, axis) ** -0.5)
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
    xy = plane_coordinates(pool, vertices, [-x for x in normal])
    return regions(trace(edges, xy), xy)


def _folded(pool: Pool, loop: list[int]) -> bool:
    """Whether a loop turns straight back at a vertex."""
    points = [pool.points[v] for v in loop]
    for k, here in enumerate(points):
        back, ahead = minus(points[k - 2], points[k - 1]), minus(here, points[k - 1])
        along = dot(back, ahead)
        # an angle below 1e-7 rad
        if along > 0.0 and along * along >= (1.0 - 1e-14) * dot(back, back) * dot(ahead, ahead):
            return True
    return False


def _hang_together(faces: list[Face]) -> bool:
    """Whether every face is reached from the first one over edges of two faces (False: one has to look closer)."""
    owner = {(face.loop[k - 1], b): i for i, face in enumerate(faces) for k, b in enumerate(face.loop)}
    if not faces or len(owner) < sum(len(face.loop) for face in faces):
        return False
    reached, stack = {0}, [0]
    while stack and len(reached) < len(faces):
        loop = faces[stack.pop()].loop
        for k, b in enumerate(loop):
            i = owner.get((b, loop[k - 1]), 0)
            if i not in reached:
                reached.add(i)
                stack.append(i)
    return len(reached) == len(faces)


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
    if _hang_together(faces):
        return [faces]
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
    axis = minus(pool.points[b], pool.points[a])
    u, v = (direction.tolist() for direction in plane_basis(axis))

    def angle(i: int, sign: float) -> float:
        into = cross(area_vector(ring_points(pool, faces[i])), axis)
        return float(np.arctan2(sign * dot(into, v), sign * dot(into, u)))

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
        ring = ring_points(pool, face)
        origin = origin or ring[0]
        total += 2.0 * dot(area_vector(ring), minus(ring[0], origin))
    return total
