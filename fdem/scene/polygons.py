"""Polygons in space: area vectors, triangulation, tracing of loops, regions with holes.

Everything is homogeneous in length and does not depend on where a loop starts or which way round it
is listed, so that two blocks that share a face divide it in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from fdem.errors import MeshError

__all__ = ["Array", "Ints", "area_vector", "plane_basis", "regions", "trace", "triangulate"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
Point = Sequence[float]


def area_vector(loop: Sequence[Point]) -> tuple[float, float, float]:
    """Area vector of a closed loop of points (Newell's sum), [m^2].

    Parameters
    ----------
    loop : sequence of (3,) points
        Vertices in order [m].

    Returns
    -------
    tuple of float
        ``1/2 sum (p_i - p_0) x (p_{i+1} - p_0)``: normal times area for a planar loop.
    """
    ox, oy, oz = loop[0]
    nx = ny = nz = 0.0
    ax, ay, az = loop[1][0] - ox, loop[1][1] - oy, loop[1][2] - oz
    for point in loop[2:]:
        bx, by, bz = point[0] - ox, point[1] - oy, point[2] - oz
        nx += ay * bz - az * by
        ny += az * bx - ax * bz
        nz += ax * by - ay * bx
        ax, ay, az = bx, by, bz
    return 0.5 * nx, 0.5 * ny, 0.5 * nz


def plane_basis(normal: Sequence[float]) -> tuple[Array, Array]:
    """Two unit vectors u, v with u x v along `normal`.

    Parameters
    ----------
    normal : (3,) sequence
        Any non-zero vector.

    Returns
    -------
    u, v : (3,) arrays
        Unit vectors spanning the plane.
    """
    x, y, z = normal
    length = sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    sizes = abs(x), abs(y), abs(z)
    # across n and the axis it is least along
    least = sizes.index(min(sizes))
    a, b, c = (0.0, -z, y) if least == 0 else (z, 0.0, -x) if least == 1 else (-y, x, 0.0)
    length = sqrt(a * a + b * b + c * c)
    a, b, c = a / length, b / length, c / length
    return np.array([a, b, c]), np.array([y * c - z * b, z * a - x * c, x * b - y * a])


def _canonical(loop: Sequence[Point]) -> list[int]:
    """Positions of the loop from its smallest point towards that point's smaller neighbour."""
    n = len(loop)
    keys = [tuple(p) for p in loop]
    first = min(range(n), key=keys.__getitem__)
    step = 1 if keys[(first + 1) % n] <= keys[first - 1] else -1
    return [(first + step * k) % n for k in range(n)]


def _quality(p: Point, q: Point, r: Point) -> float:
    """Signed area of a triangle over its summed squared edges (0.144 is equilateral)."""
    ax, ay, bx, by = q[0] - p[0], q[1] - p[1], r[0] - p[0], r[1] - p[1]
    cx, cy = bx - ax, by - ay
    edges = ax * ax + ay * ay + bx * bx + by * by + cx * cx + cy * cy
    return 0.5 * (ax * by - ay * bx) / edges if edges > 0.0 else 0.0


def _best_triangulation(xy: list[tuple[float, float]]) -> tuple[float, list[tuple[int, int, int]]]:
    """Triangulation of a counter-clockwise loop whose worst triangle is best.

    A triangulation of the index polygon with positive areas only is one of the region (the map has
    degree one), so no test of visibility is needed, also for loops that touch themselves.
    """
    n = len(xy)
    points = np.array(xy)
    best = np.full((n, n), np.inf)
    split = np.zeros((n, n), dtype=np.int64)
    for length in range(2, n):
        for i in range(n - length):
            j = i + length
            if length < 8:
                value, at = -np.inf, i + 1
                for k in range(i + 1, j):
                    q = min(best[i, k], best[k, j], _quality(xy[i], xy[k], xy[j]))
                    if q > value:
                        value, at = q, k
            else:
                a, b = points[i + 1 : j] - points[i], points[j] - points[i]
                c = b - a
                edges = (a * a).sum(axis=1) + (b * b).sum() + (c * c).sum(axis=1)
                quality = 0.5 * (a[:, 0] * b[1] - a[:, 1] * b[0]) / np.where(edges > 0.0, edges, 1.0)
                values = np.minimum(np.minimum(best[i, i + 1 : j], best[i + 1 : j, j]), quality)
                at = i + 1 + int(np.argmax(values))
                value = float(values[at - i - 1])
            best[i, j], split[i, j] = value, at
    triangles, stack = [], [(0, n - 1)]
    while stack:
        i, j = stack.pop()
        if j - i < 2:
            continue
        k = int(split[i, j])
        triangles.append((i, k, j))
        stack += [(i, k), (k, j)]
    return float(best[0, n - 1]), triangles


def triangulate(loop: Sequence[Point]) -> list[tuple[int, int, int]]:
    """Triangles of a simple loop, convex or not, planar or nearly so.

    Parameters
    ----------
    loop : sequence of (3,) points
        Vertices in order [m].

    Returns
    -------
    list of (int, int, int)
        Positions in the loop, each triangle turning as the loop does. The choice does not depend on
        the loop's start or direction.

    Raises
    ------
    MeshError
        If the loop crosses itself.
    """
    n = len(loop)
    if n == 3:
        return [(0, 1, 2)]
    order = _canonical(loop)
    ring = [loop[k] for k in order]
    u, v = (axis.tolist() for axis in plane_basis(area_vector(ring)))
    ox, oy, oz = ring[0]
    xy = [
        (
            (p[0] - ox) * u[0] + (p[1] - oy) * u[1] + (p[2] - oz) * u[2],
            (p[0] - ox) * v[0] + (p[1] - oy) * v[1] + (p[2] - oz) * v[2],
        )
        for p in ring
    ]
    if n == 4:
        # the common case: compare the two diagonals
        first = min(_quality(xy[0], xy[1], xy[2]), _quality(xy[0], xy[2], xy[3]))
        second = min(_quality(xy[0], xy[1], xy[3]), _quality(xy[1], xy[2], xy[3]))
        worst = max(first, second)
        found = [(0, 1, 2), (0, 2, 3)] if first >= second else [(0, 1, 3), (1, 2, 3)]
    else:
        worst, found = _best_triangulation(xy)
    if worst < -1e-9:
        raise MeshError("the vertex loop of a face crosses itself")
    forward = order[1] == (order[0] + 1) % n
    triangles = [(order[i], order[j], order[k]) for i, j, k in found]
    return triangles if forward else [(i, k, j) for i, j, k in triangles]


def trace(edges: Sequence[tuple[int, int]], xy: dict[int, tuple[float, float]]) -> list[list[int]]:
    """Loops made of directed edges that have the region on their left.

    Parameters
    ----------
    edges : sequence of (int, int)
        Directed edges; as many leave a vertex as arrive.
    xy : dict
        Plane coordinates of the vertices.

    Returns
    -------
    list of list of int
        Loops; where several edges leave a vertex the leftmost turn is taken, so loops that touch in a
        corner come apart. Spikes (there and straight back) are removed.

    Raises
    ------
    MeshError
        If the edges do not close.
    """
    leaving: dict[int, list[int]] = {}
    for a, b in sorted(edges):
        leaving.setdefault(a, []).append(b)
    loops = []
    for start in sorted(leaving):
        while leaving[start]:
            loop = [start]
            here, there = start, leaving[start].pop(0)
            while there != start:
                options = leaving.get(there)
                if not options:
                    raise MeshError(f"the section is not closed at vertex {there}")
                following = options[0] if len(options) == 1 else _leftmost(xy, here, there, options)
                options.remove(following)
                loop.append(there)
                here, there = there, following
            loops.append(_without_spikes(loop))
    return [loop for loop in loops if len(loop) > 2]


def _leftmost(xy: dict[int, tuple[float, float]], here: int, there: int, options: list[int]) -> int:
    """The continuation that turns most to the left; straight back comes last."""
    (ax, ay), (bx, by) = xy[here], xy[there]
    dx, dy = bx - ax, by - ay

    def turn(option: int) -> float:
        ex, ey = xy[option][0] - bx, xy[option][1] - by
        angle = float(np.arctan2(dx * ey - dy * ex, dx * ex + dy * ey))
        return -np.pi if option == here else angle

    return max(options, key=turn)


def _without_spikes(loop: list[int]) -> list[int]:
    """The loop without a -> b -> a excursions."""
    out: list[int] = []
    for vertex in loop:
        if len(out) > 1 and out[-2] == vertex:
            out.pop()
        else:
            out.append(vertex)
    while len(out) > 2 and out[0] == out[-2]:
        out = out[:-2]
    while len(out) > 2 and out[1] == out[-1]:
        out = out[2:]
    return out


def _area(loop: Sequence[int], xy: dict[int, tuple[float, float]]) -> float:
    """Signed area of a plane loop, from its first vertex."""
    ox, oy = xy[loop[0]]
    total = 0.0
    for a, b in pairwise(loop[1:]):
        total += (xy[a][0] - ox) * (xy[b][1] - oy) - (xy[a][1] - oy) * (xy[b][0] - ox)
    return 0.5 * total


def _inside(point: tuple[float, float], loop: Sequence[int], xy: dict[int, tuple[float, float]]) -> bool:
    """Whether a point lies inside a loop (crossing number)."""
    x, y = point
    odd = False
    for k, vertex in enumerate(loop):
        (ax, ay), (bx, by) = xy[loop[k - 1]], xy[vertex]
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            odd = not odd
    return odd


def regions(loops: list[list[int]], xy: dict[int, tuple[float, float]]) -> list[list[int]]:
    """Simple loops, free of holes, that cover what the given loops enclose.

    Parameters
    ----------
    loops : list of list of int
        Outer loops counter-clockwise, holes clockwise, as `trace` gives them.
    xy : dict
        Plane coordinates of the vertices.

    Returns
    -------
    list of list of int
        Counter-clockwise simple loops over the same vertices.

    Raises
    ------
    MeshError
        If a hole lies in no outer loop.
    """
    sized = [(_area(loop, xy), loop) for loop in loops]
    outer = [(area, loop) for area, loop in sized if area > 0.0]
    holes: list[list[list[int]]] = [[] for _ in outer]
    for area, hole in sized:
        if area > 0.0:
            continue
        homes = [
            (size, k)
            for k, (size, loop) in enumerate(outer)
            if size > -area and any(_inside(xy[v], loop, xy) for v in hole if v not in loop)
        ]
        if homes:
            holes[min(homes)[1]].append(hole)
        elif area < 0.0:
            raise MeshError("a hole of a section lies outside of it")
    out: list[list[int]] = []
    for (_, loop), inner in zip(outer, holes, strict=True):
        if not inner and len(set(loop)) == len(loop):
            out.append(loop)
        else:
            out += _simple_parts(loop, inner, xy)
    return out


def _simple_parts(loop: list[int], holes: list[list[int]], xy: dict[int, tuple[float, float]]) -> list[list[int]]:
    """Cut a region with holes, or one that touches itself, into simple loops."""
    ring = _rotated(loop, xy)
    for hole in sorted(holes, key=lambda h: min(xy[v] for v in h)):
        ring = _bridged(ring, _rotated(hole, xy), holes, xy)
    worst, triangles = _best_triangulation([xy[v] for v in ring])
    if worst < -1e-9:
        raise MeshError("a section with holes could not be divided into simple faces")
    parts = [[ring[i], ring[k], ring[j]] for i, k, j in triangles]
    merged = True
    while merged:
        merged = False
        for a in range(len(parts)):
            for b in range(a + 1, len(parts)):
                joined = _joined(parts[a], parts[b])
                if joined is not None:
                    parts[a] = joined
                    del parts[b]
                    merged = True
                    break
            if merged:
                break
    return parts


def _rotated(loop: list[int], xy: dict[int, tuple[float, float]]) -> list[int]:
    """The loop from its smallest vertex on."""
    first = min(range(len(loop)), key=lambda k: xy[loop[k]])
    return loop[first:] + loop[:first]


def _bridged(ring: list[int], hole: list[int], holes: list[list[int]], xy: dict[int, tuple[float, float]]) -> list[int]:
    """Join a hole to the ring by the shortest segment that crosses nothing."""
    walls = [(ring[k - 1], v) for k, v in enumerate(ring)]
    walls += [(h[k - 1], v) for h in holes for k, v in enumerate(h)]
    pairs = sorted(
        ((xy[a][0] - xy[b][0]) ** 2 + (xy[a][1] - xy[b][1]) ** 2, i, j)
        for i, a in enumerate(ring)
        for j, b in enumerate(hole)
    )
    for _, i, j in pairs:
        a, b = ring[i], hole[j]
        if a != b and any(_crosses(xy, a, b, c, d) for c, d in walls):
            continue
        if not _leaves_inside(xy, ring, i, xy[b]) and a != b:
            continue
        tail = hole[j:] + hole[: j + 1]
        return ring[: i + 1] + (tail[1:] if a == b else tail) + ([] if a == b else [a]) + ring[i + 1 :]
    raise MeshError("a hole of a section could not be joined to its outline")


def _leaves_inside(xy: dict[int, tuple[float, float]], ring: list[int], i: int, target: tuple[float, float]) -> bool:
    """Whether the segment from ring[i] to the target starts into the region on the ring's left."""
    px, py = xy[ring[i - 1]]
    cx, cy = xy[ring[i]]
    nx, ny = xy[ring[(i + 1) % len(ring)]]
    inner = float(np.arctan2(py - cy, px - cx) - np.arctan2(ny - cy, nx - cx)) % (2.0 * np.pi)
    angle = float(np.arctan2(target[1] - cy, target[0] - cx) - np.arctan2(ny - cy, nx - cx)) % (2.0 * np.pi)
    return angle < (inner or 2.0 * np.pi)


def _crosses(xy: dict[int, tuple[float, float]], a: int, b: int, c: int, d: int) -> bool:
    """Whether segment a-b meets c-d elsewhere than in a common end."""

    def side(p: int, q: int, r: int) -> float:
        (px, py), (qx, qy), (rx, ry) = xy[p], xy[q], xy[r]
        return (qx - px) * (ry - py) - (qy - py) * (rx - px)

    ends = {a, b} & {c, d}
    if len(ends) == 2:
        return True
    if ends:
        # a common end: they overlap only if collinear and on the same side of it
        shared = ends.pop()
        p, q = (b if a == shared else a), (d if c == shared else c)
        (sx, sy), (px, py), (qx, qy) = xy[shared], xy[p], xy[q]
        return side(shared, p, q) == 0.0 and (px - sx) * (qx - sx) + (py - sy) * (qy - sy) > 0.0
    return side(a, b, c) * side(a, b, d) <= 0.0 and side(c, d, a) * side(c, d, b) <= 0.0


def _joined(one: list[int], other: list[int]) -> list[int] | None:
    """Union of two loops along their common edges if it is a simple loop."""
    ahead = {(one[k - 1], v) for k, v in enumerate(one)}
    behind = {(other[k - 1], v) for k, v in enumerate(other)}
    common = {(a, b) for a, b in ahead if (b, a) in behind}
    if not common:
        return None
    following: dict[int, int] = {}
    for a, b in (ahead - common) | {e for e in behind if (e[1], e[0]) not in common}:
        if a in following:
            return None
        following[a] = b
    start = next(iter(sorted(following)))
    loop, here = [start], following[start]
    while here != start:
        loop.append(here)
        here = following[here]
    return loop if len(loop) == len(following) else None
