"""Planar polygons of one block: merge coplanar faces, split non-convex ones (compile time, plain Python)."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["convex_faces", "largest_triangle", "newell"]

Array = NDArray[np.float64]
Loop = NDArray[np.int64]

FLAT = 1e-6  # rad, and fraction of the block size
TURN = 1e-9  # sine of a turn that still counts as straight


def newell(p: Array) -> Array:
    """Unit normal of the polygon `p` (n, 3); zeros if it has no area."""
    d = p - p.mean(axis=0)
    n = np.cross(d, np.roll(d, -1, axis=0)).sum(axis=0)
    length = np.linalg.norm(n)
    out: Array = n / length if length > 0.0 else n
    return out


def is_convex(p: Array, normal: Array) -> bool:
    """Whether the loop `p` (n, 3) never turns right seen along -normal, and turns around once."""
    e = np.roll(p, -1, axis=0) - p
    length = np.linalg.norm(e, axis=1)
    if (length == 0.0).any():
        return False
    e = e / length[:, None]
    following = np.roll(e, -1, axis=0)
    sine = np.cross(e, following) @ normal
    if (sine < -TURN).any():
        return False
    turn = np.arctan2(sine, np.einsum("ij,ij->i", e, following)).sum()
    return bool(abs(turn - 2.0 * np.pi) < 1e-3)


def largest_triangle(p: Array) -> Any:
    """Indices, in loop order, of the largest triangle among (at most 12 of) the corners of `p`."""
    ids = np.arange(len(p)) if len(p) <= 12 else np.unique(np.linspace(0, len(p), 12, endpoint=False).astype(int))
    triples = np.array(list(itertools.combinations(ids, 3)))
    area = np.linalg.norm(np.cross(p[triples[:, 1]] - p[triples[:, 0]], p[triples[:, 2]] - p[triples[:, 0]]), axis=1)
    return triples[int(np.argmax(area > area.max() * (1.0 - 1e-9)))]


def convex_faces(loops: list[Loop], tags: list[int], x: Any) -> tuple[list[Loop], list[int], list[int]]:
    """Convex planar faces equivalent to `loops`.

    Parameters
    ----------
    loops : list of int arrays
        Faces of one closed (or open) surface, conforming: every edge is shared vertex by vertex.
    tags : list of int
        Only faces with the same tag are merged.
    x : indexable by vertex id -> (n, 3)
        Coordinates in units of the block size.

    Returns
    -------
    loops, tags, source
        `source` is the index of one input loop of every face.
    """
    pieces: list[tuple[Loop, int, int]] = []
    for k, loop in enumerate(loops):
        p = x[loop]
        n = newell(p)
        if not n.any():
            continue
        planar = len(loop) == 3 or np.abs((p - p.mean(axis=0)) @ n).max() <= FLAT
        parts = [loop] if planar else triangulate(loop, p, n)
        pieces.extend((part, tags[k], k) for part in parts)
    normals = np.array([newell(x[part]) for part, _, _ in pieces]).reshape(-1, 3)
    out: list[tuple[Loop, int, int]] = []
    for region in _regions(pieces, normals, x):
        out.extend(_merge(region, pieces, normals, x))
    return [o[0] for o in out], [o[1] for o in out], [o[2] for o in out]


def triangulate(loop: Loop, p: Array, n: Array) -> list[Loop]:
    """Ear clipping of a simple loop with mean normal `n`; of two good ears the fatter goes first."""
    axis = np.argmax(np.abs(n))
    sign = 1.0 if n[axis] > 0.0 else -1.0
    u, v = p[:, (axis + 1) % 3], sign * p[:, (axis + 2) % 3]
    ids = list(range(len(loop)))
    out = []

    def cross(i: int, j: int, k: int) -> float:
        return float((u[j] - u[i]) * (v[k] - v[i]) - (v[j] - v[i]) * (u[k] - u[i]))

    while len(ids) > 3:
        best, best_quality = 0, -np.inf
        for m in range(len(ids)):
            i, j, k = ids[m - 1], ids[m], ids[(m + 1) % len(ids)]
            area = cross(i, j, k)
            blocked = any(
                cross(i, j, q) > 0 and cross(j, k, q) > 0 and cross(k, i, q) > 0 for q in ids if q not in (i, j, k)
            )
            edge = (u[i] - u[k]) ** 2 + (v[i] - v[k]) ** 2
            quality = area / edge if area > 0 and not blocked else area - 1e300
            if quality > best_quality:
                best, best_quality = m, quality
        out.append(loop[[ids[best - 1], ids[best], ids[(best + 1) % len(ids)]]])
        del ids[best]
    out.append(loop[ids])
    return [t for t in out if newell(p[[int(np.flatnonzero(loop == i)[0]) for i in t]]).any()]


def _regions(pieces: list[tuple[Loop, int, int]], normals: Array, x: Any) -> list[list[int]]:
    """Sets of faces that are coplanar, tagged alike and connected by edges."""
    root = list(range(len(pieces)))

    def find(i: int) -> int:
        while root[i] != i:
            root[i] = root[root[i]]
            i = root[i]
        return i

    owner = {
        (int(a), int(b)): k
        for k, (loop, _, _) in enumerate(pieces)
        for a, b in zip(loop, np.roll(loop, -1), strict=True)
    }
    for (a, b), k in owner.items():
        g = owner.get((b, a), -1)
        if g > k and pieces[g][1] == pieces[k][1] and normals[g] @ normals[k] > 0.0:
            if np.linalg.norm(np.cross(normals[g], normals[k])) < FLAT:
                root[max(find(g), find(k))] = min(find(g), find(k))
    groups: dict[int, list[int]] = {}
    for k in range(len(pieces)):
        groups.setdefault(find(k), []).append(k)
    out = []
    for members in groups.values():
        p = np.concatenate([x[pieces[k][0]] for k in members])
        n = normals[members].sum(axis=0)
        n = n / np.linalg.norm(n)
        flat = len(members) == 1 or np.abs((p - p.mean(axis=0)) @ n).max() <= FLAT
        out.extend([members] if flat else [[k] for k in members])
    return out


def _merge(
    region: list[int], pieces: list[tuple[Loop, int, int]], normals: Array, x: Any
) -> list[tuple[Loop, int, int]]:
    """One convex face if the region is one, else a convex partition."""
    tag, source = pieces[region[0]][1], pieces[region[0]][2]
    n = normals[region[0]]
    whole = pieces[region[0]][0] if len(region) == 1 else _outline([pieces[k][0] for k in region])
    if whole is not None and is_convex(x[whole], n):
        return [(whole, tag, source)]
    triangles: list[Loop] = []
    for k in region:
        loop = pieces[k][0]
        p = x[loop]
        triangles.extend([loop] if is_convex(p, n) else triangulate(loop, p, n))
    return [(loop, tag, source) for loop in _join(triangles, n, x)]


def _outline(loops: list[Loop]) -> Loop | None:
    """The one boundary loop of a set of faces; None if there are several or it touches itself."""
    edges = {(int(a), int(b)) for loop in loops for a, b in zip(loop, np.roll(loop, -1), strict=True)}
    border = [(a, b) for a, b in sorted(edges) if (b, a) not in edges]
    follow = dict(border)
    if len(follow) != len(border):
        return None
    start = border[0][0]
    out = [start]
    while follow[out[-1]] != start:
        out.append(follow[out[-1]])
    return np.array(out, dtype=np.int64) if len(out) == len(border) else None


def _join(parts: list[Loop], n: Array, x: Any) -> list[Loop]:
    """Remove shared edges as long as the pieces stay convex (Hertel and Mehlhorn, 1983)."""
    parts = list(parts)
    merged = True
    while merged:
        merged = False
        owner = {
            (int(a), int(b)): k for k, loop in enumerate(parts) for a, b in zip(loop, np.roll(loop, -1), strict=True)
        }
        for (a, b), k in owner.items():
            g = owner.get((b, a), -1)
            if g <= k:
                continue
            whole = _outline([parts[k], parts[g]])
            if whole is not None and is_convex(x[whole], n):
                parts[k] = whole
                del parts[g]
                merged = True
                break
    return parts
