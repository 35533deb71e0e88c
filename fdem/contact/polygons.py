"""Planar polygons of one block: merge coplanar faces, split non-convex ones (compile time, plain Python).

Polygons have a few corners: numbers one by one are ten times faster here than arrays of three.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from math import atan2, inf, pi, sqrt

__all__ = ["convex_faces", "largest_triangle", "newell", "true_corners", "weights"]

Vector = tuple[float, float, float]
Point = Sequence[float]
Loop = list[int]
Piece = tuple[Loop, int, int]

FLAT = 1e-6  # rad, and fraction of the block size
TURN = 1e-9  # sine of a turn that still counts as straight


def minus(a: Point, b: Point) -> Vector:
    """Vector from `b` to `a`."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def dot(a: Point, b: Point) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Point, b: Point) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def mean(p: Sequence[Point]) -> Vector:
    """Mean of points."""
    share = 1.0 / len(p)
    x = y = z = 0.0
    for a, b, c in p:
        x, y, z = x + a, y + b, z + c
    return x * share, y * share, z * share


def newell(p: Sequence[Point]) -> Vector:
    """Unit normal of the polygon `p` (n, 3); zeros if it has no area."""
    u, v, w = mean(p)
    x = y = z = 0.0
    ax, ay, az = p[-1][0] - u, p[-1][1] - v, p[-1][2] - w
    for cx, cy, cz in p:
        bx, by, bz = cx - u, cy - v, cz - w
        x += ay * bz - az * by
        y += az * bx - ax * bz
        z += ax * by - ay * bx
        ax, ay, az = bx, by, bz
    length = sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length) if length > 0.0 else (0.0, 0.0, 0.0)


def _spread(p: Sequence[Point], n: Vector) -> float:
    """Largest distance of points from the plane through their mean with the normal `n`."""
    height = dot(mean(p), n)
    return max(abs(dot(q, n) - height) for q in p)


def _edges(p: Sequence[Point]) -> list[Vector] | None:
    """Unit vectors from every corner to the next; None where two coincide."""
    out = []
    ax, ay, az = p[0]
    for bx, by, bz in [*p[1:], p[0]]:
        x, y, z = bx - ax, by - ay, bz - az
        length = sqrt(x * x + y * y + z * z)
        if length == 0.0:
            return None
        out.append((x / length, y / length, z / length))
        ax, ay, az = bx, by, bz
    return out


def is_convex(p: Sequence[Point], normal: Vector) -> bool:
    """Whether the loop `p` (n, 3) never turns right seen along -normal, and turns around once."""
    edges = _edges(p)
    if edges is None:
        return False
    turn, before = 0.0, edges[-1]
    for e in edges:
        sine = dot(cross(before, e), normal)
        if sine < -TURN:
            return False
        turn += atan2(sine, dot(before, e))
        before = e
    return abs(turn - 2.0 * pi) < 1e-3


def largest_triangle(p: Sequence[Point]) -> tuple[int, int, int]:
    """Indices, in loop order, of the largest triangle among (at most 12 of) the corners of `p`."""
    n = len(p)
    ids = range(n) if n <= 12 else sorted({k * n // 12 for k in range(12)})
    triples = list(itertools.combinations(ids, 3))
    squares = []
    for i, j, k in triples:
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = p[i], p[j], p[k]
        ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        squares.append(x * x + y * y + z * z)
    least = max(squares) * (1.0 - 1e-9) ** 2
    return triples[next(i for i, square in enumerate(squares) if square >= least)]


def true_corners(p: Sequence[Point], near: Sequence[int], normals: Sequence[Vector]) -> list[int]:
    """Corners of `p` but for those in the middle of a straight edge with one plane on the other side.

    `near` is the face across the edge from every corner to the next, -1 for none.
    """
    edges = _edges(p)
    if edges is None:
        return list(range(len(p)))
    out = []
    for k in range(len(p)):
        turn, last, this = cross(edges[k - 1], edges[k]), near[k - 1], near[k]
        straight = dot(turn, turn) < 1e-18
        if not straight or not (
            last == this or (last >= 0 and this >= 0 and dot(normals[last], normals[this]) > 1.0 - 1e-12)
        ):
            out.append(k)
    return out


def weights(p: Sequence[Point], tri: tuple[int, int, int]) -> list[tuple[float, float]]:
    """Weights of the second and third corner of the triangle `tri` of `p` for all points `p` in its plane."""
    base = p[tri[0]]
    e1, e2 = minus(p[tri[1]], base), minus(p[tri[2]], base)
    a, b, c = dot(e1, e1), dot(e1, e2), dot(e2, e2)
    area = a * c - b * b
    out = []
    (x, y, z), (ux, uy, uz), (vx, vy, vz) = base, e1, e2
    for cx, cy, cz in p:
        dx, dy, dz = cx - x, cy - y, cz - z
        s, t = dx * ux + dy * uy + dz * uz, dx * vx + dy * vy + dz * vz
        out.append(((c * s - b * t) / area, (a * t - b * s) / area))
    return out


def convex_faces(
    loops: list[Loop], tags: list[int], x: Sequence[Point]
) -> tuple[list[Loop], list[int], list[int], list[Vector]]:
    """Convex planar faces equivalent to `loops`.

    Parameters
    ----------
    loops : list of lists of int
        Faces of one closed (or open) surface, conforming: every edge is shared vertex by vertex.
    tags : list of int
        Only faces with the same tag are merged.
    x : (n, 3) sequence of points
        Coordinates in units of the block size, by vertex id.

    Returns
    -------
    loops, tags, source, normals
        `source` is the index of one input loop of every face.
    """
    pieces: list[Piece] = []
    normals: list[Vector] = []
    for k, loop in enumerate(loops):
        p = [x[i] for i in loop]
        n = newell(p)
        if not any(n):
            continue
        if len(loop) == 3 or _spread(p, n) <= FLAT:
            pieces.append((loop, tags[k], k))
            normals.append(n)
            continue
        for part in triangulate(loop, p, n):
            pieces.append((part, tags[k], k))
            normals.append(newell([x[i] for i in part]))
    out: list[Piece] = []
    unit: list[Vector] = []
    for region in _regions(pieces, normals, x):
        made = _merge(region, pieces, normals, x)
        out.extend(made)
        same = len(made) == len(region) == 1
        unit.extend([normals[region[0]]] if same else [newell([x[i] for i in o[0]]) for o in made])
    return [o[0] for o in out], [o[1] for o in out], [o[2] for o in out], unit


def triangulate(loop: Loop, p: Sequence[Point], n: Vector) -> list[Loop]:
    """Ear clipping of a simple loop with mean normal `n`; of two good ears the fatter goes first."""
    axis = max(range(3), key=lambda d: abs(n[d]))
    sign = 1.0 if n[axis] > 0.0 else -1.0
    u, v = [q[(axis + 1) % 3] for q in p], [sign * q[(axis + 2) % 3] for q in p]
    ids = list(range(len(loop)))
    out = []

    def area_of(i: int, j: int, k: int) -> float:
        return (u[j] - u[i]) * (v[k] - v[i]) - (v[j] - v[i]) * (u[k] - u[i])

    while len(ids) > 3:
        best, best_quality = 0, -inf
        for m in range(len(ids)):
            i, j, k = ids[m - 1], ids[m], ids[(m + 1) % len(ids)]
            area = area_of(i, j, k)
            blocked = any(
                area_of(i, j, q) > 0 and area_of(j, k, q) > 0 and area_of(k, i, q) > 0
                for q in ids
                if q not in (i, j, k)
            )
            edge = (u[i] - u[k]) ** 2 + (v[i] - v[k]) ** 2
            quality = area / edge if area > 0 and not blocked else area - 1e300
            if quality > best_quality:
                best, best_quality = m, quality
        out.append([ids[best - 1], ids[best], ids[(best + 1) % len(ids)]])
        del ids[best]
    out.append(ids)
    return [[loop[k] for k in t] for t in out if any(newell([p[k] for k in t]))]


def _owners(loops: Sequence[Loop]) -> dict[tuple[int, int], int]:
    """Which loop has an edge (from, to)."""
    return {(loop[i - 1], loop[i]): k for k, loop in enumerate(loops) for i in range(len(loop))}


def _regions(pieces: list[Piece], normals: list[Vector], x: Sequence[Point]) -> list[list[int]]:
    """Sets of faces that are coplanar, tagged alike and connected by edges."""
    root = list(range(len(pieces)))

    def find(i: int) -> int:
        while root[i] != i:
            root[i] = root[root[i]]
            i = root[i]
        return i

    owner = _owners([piece[0] for piece in pieces])
    for (a, b), k in owner.items():
        g = owner.get((b, a), -1)
        if g > k and pieces[g][1] == pieces[k][1] and dot(normals[g], normals[k]) > 0.0:
            turn = cross(normals[g], normals[k])
            if dot(turn, turn) < FLAT**2:
                root[max(find(g), find(k))] = min(find(g), find(k))
    groups: dict[int, list[int]] = {}
    for k in range(len(pieces)):
        groups.setdefault(find(k), []).append(k)
    out = []
    for members in groups.values():
        if len(members) == 1:
            out.append(members)
            continue
        x_, y_, z_ = mean([normals[k] for k in members])
        length = sqrt(x_ * x_ + y_ * y_ + z_ * z_)
        p = [x[i] for k in members for i in pieces[k][0]]
        flat = _spread(p, (x_ / length, y_ / length, z_ / length)) <= FLAT
        out.extend([members] if flat else [[k] for k in members])
    return out


def _merge(region: list[int], pieces: list[Piece], normals: list[Vector], x: Sequence[Point]) -> list[Piece]:
    """One convex face if the region is one, else a convex partition."""
    tag, source = pieces[region[0]][1], pieces[region[0]][2]
    n = normals[region[0]]
    whole = pieces[region[0]][0] if len(region) == 1 else _outline([pieces[k][0] for k in region])
    if whole is not None and is_convex([x[i] for i in whole], n):
        return [(whole, tag, source)]
    triangles: list[Loop] = []
    for k in region:
        loop = pieces[k][0]
        p = [x[i] for i in loop]
        triangles.extend([loop] if is_convex(p, n) else triangulate(loop, p, n))
    return [(loop, tag, source) for loop in _join(triangles, n, x)]


def _outline(loops: list[Loop]) -> Loop | None:
    """The one boundary loop of a set of faces; None if there are several or it touches itself."""
    edges = _owners(loops)
    border = [(a, b) for a, b in sorted(edges) if (b, a) not in edges]
    follow = dict(border)
    if len(follow) != len(border):
        return None
    start = border[0][0]
    out = [start]
    while follow[out[-1]] != start:
        out.append(follow[out[-1]])
    return out if len(out) == len(border) else None


def _join(parts: list[Loop], n: Vector, x: Sequence[Point]) -> list[Loop]:
    """Remove shared edges as long as the pieces stay convex (Hertel and Mehlhorn, 1983)."""
    parts = list(parts)
    merged = True
    while merged:
        merged = False
        owner = _owners(parts)
        for (a, b), k in owner.items():
            g = owner.get((b, a), -1)
            if g <= k:
                continue
            whole = _outline([parts[k], parts[g]])
            if whole is not None and is_convex([x[i] for i in whole], n):
                parts[k] = whole
                del parts[g]
                merged = True
                break
    return parts
