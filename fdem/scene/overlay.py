"""Plane polygons laid over each other: where their edges meet, the part they have in common, how fine it is."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

__all__ = ["Nodes", "aligned", "candidates", "clearance", "contains", "crossings", "touching"]

Array = Any
Segment = tuple[int, int]


def _after(rows: Array) -> Array:
    """The rows from the second on, then the first."""
    return np.concatenate([rows[1:], rows[:1]])


def candidates(lower: Array, upper: Array, normal: Array, block: Array, reach: float) -> list[tuple[int, int]]:
    """Pairs of faces of different blocks whose boxes meet and which look against each other.

    Parameters
    ----------
    lower, upper : (n, 3) array
        Boxes [m].
    normal : (n, 3) array
        Unit normals, outward.
    block : (n,) int array
        Owner of each face.
    reach : float
        Boxes this far apart still meet [m].

    Returns
    -------
    list of (int, int)
        First the lower number; sorted.
    """
    if not len(lower):
        return []
    axis = int(np.argmax(np.ptp(lower, axis=0)))
    order = np.argsort(lower[:, axis], kind="stable")
    start = lower[order, axis]
    found = []
    for place, i in enumerate(order.tolist()):
        others = order[place + 1 : np.searchsorted(start, upper[i, axis] + reach, side="right")]
        near = (lower[others] <= upper[i] + reach).all(axis=1) & (upper[others] >= lower[i] - reach).all(axis=1)
        # opposite to 1e-3 rad; how far they lie in one plane is measured afterwards
        near &= (normal[others] @ normal[i] < -1.0 + 5e-7) & (block[others] != block[i])
        found += [(min(i, j), max(i, j)) for j in others[near].tolist()]
    return sorted(found)


def touching(points: Array, p: Array, q: Array, tolerance: float) -> Any:
    """Which points lie inside which segments, the ends not included.

    Parameters
    ----------
    points : (n, d) array
        [m].
    p, q : (m, d) array
        Ends of the segments [m].
    tolerance : float
        [m].

    Returns
    -------
    (n, m) bool array
    """
    d = q - p
    length = np.sqrt((d * d).sum(axis=1))
    r = points[:, None, :] - p
    along = (r * d).sum(axis=2) / length
    off = r - along[:, :, None] * (d / length[:, None])
    return ((off * off).sum(axis=2) <= tolerance**2) & (along > tolerance) & (along < length - tolerance)


def crossings(a: Array, b: Array, tolerance: float) -> list[tuple[int, int]]:
    """Edges of two loops that cross each other, away from all corners.

    Parameters
    ----------
    a, b : (n, 2), (m, 2) array
        Corners [m].
    tolerance : float
        Corners this close to an edge touch it [m].

    Returns
    -------
    list of (int, int)
        Edges by their first corners.
    """
    da, db = _after(a) - a, _after(b) - b

    def sides(p: Array, d: Array, q: Array) -> Array:
        """Distance (len(p), len(q)) of the points q from the lines of the edges (p, d)."""
        r = q[None, :, :] - p[:, None, :]
        turned = d[:, None, 0] * r[:, :, 1] - d[:, None, 1] * r[:, :, 0]
        return turned / np.sqrt((d * d).sum(axis=1))[:, None]

    of_b, of_a = sides(a, da, b), sides(b, db, a)
    apart = np.ones((len(a), len(b)), dtype=bool)
    for heights, mask in ((of_b, apart), (of_a, apart.T)):
        after = _after(heights.T).T
        mask &= (np.minimum(heights, after) < -tolerance) & (np.maximum(heights, after) > tolerance)
    return [(i, j) for i, j in np.argwhere(apart).tolist()]


def aligned(p: Array, q: Array, tolerance: float) -> list[tuple[int, int]]:
    """Pairs of segments that run along each other for a while.

    Parameters
    ----------
    p, q : (n, 3) array
        Ends [m].
    tolerance : float
        [m].

    Returns
    -------
    list of (int, int)
        First the lower number; segments with the same two ends are not among them.
    """
    lower, upper = np.minimum(p, q) - tolerance, np.maximum(p, q) + tolerance
    meet = np.ones((len(p), len(p)), dtype=bool)
    for k in range(3):
        meet &= (lower[:, None, k] <= upper[None, :, k]) & (upper[:, None, k] >= lower[None, :, k])
    first, second = np.nonzero(np.triu(meet, 1))
    d = q - p
    length = np.sqrt((d * d).sum(axis=1))
    # seen from the longer one, whose direction is known better
    swap = length[second] > length[first]
    i, j = np.where(swap, second, first), np.where(swap, first, second)
    unit = d[i] / length[i, None]
    along, off = [], []
    for end in (p[j], q[j]):
        r = end - p[i]
        along.append((r * unit).sum(axis=1))
        off.append(np.sqrt(((r - along[-1][:, None] * unit) ** 2).sum(axis=1)))
    low, high = np.minimum(*along), np.maximum(*along)
    overlap = np.minimum(high, length[i]) - np.maximum(low, 0.0)
    same = (np.abs(low) <= tolerance) & (np.abs(high - length[i]) <= tolerance)
    good = (np.maximum(*off) <= tolerance) & (overlap > 2.0 * tolerance) & ~same
    return [(int(a), int(b)) for a, b in zip(first[good], second[good], strict=True)]


def contains(loop: Array, points: Array) -> Any:
    """Which points lie inside a loop (crossing number).

    Parameters
    ----------
    loop : (n, 2) array
        Corners.
    points : (m, 2) array
        Not on the boundary.

    Returns
    -------
    (m,) bool array
    """
    a, b = loop, _after(loop)
    x, y = points[:, :1], points[:, 1:]
    across = (a[:, 1] > y) != (b[:, 1] > y)
    rise = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
    left = x < a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
    return (across & left).sum(axis=1) % 2 == 1


def clearance(loop: Array) -> float:
    """Shortest edge of a loop or distance of a corner from an edge it does not belong to, whatever is less.

    Parameters
    ----------
    loop : (n, d) array
        Corners [m].

    Returns
    -------
    float
        [m].
    """
    n = len(loop)
    d = _after(loop) - loop
    square = (d * d).sum(axis=1)
    r = loop[:, None, :] - loop
    t = np.clip((r * d).sum(axis=2) / square, 0.0, 1.0)
    gap = ((r - t[:, :, None] * d) ** 2).sum(axis=2)
    k = np.arange(n)
    gap[k, k] = gap[k, k - 1] = np.inf
    return float(np.sqrt(min(square.min(), gap.min())))


class Nodes:
    """Points that lie inside edges of polygons.

    Parameters
    ----------
    points : list of (3,) array
        Places of points by number [m]; may grow.
    tolerance : float
        [m].
    """

    def __init__(self, points: list[Array], tolerance: float) -> None:
        self._points, self._tolerance = points, tolerance
        self._on: dict[Segment, dict[int, frozenset[int]]] = {}

    def add(self, segment: Segment, node: int, causes: frozenset[int]) -> None:
        """Put a node inside an edge; `causes` are those who ask for it."""
        found = self._on.setdefault(segment, {})
        found[node] = found.get(node, frozenset()) | causes

    def spread(self, pairs: list[tuple[Segment, Segment, frozenset[int]]]) -> None:
        """Give the points of every edge to those that run along it, until nothing changes."""
        changed = True
        while changed:
            changed = False
            for one, other, causes in pairs:
                for source, target in ((one, other), (other, one)):
                    for node in (*source, *self._on.get(source, ())):
                        known = node in target or node in self._on.get(target, ())
                        if not known and self._within(target, node):
                            self.add(target, node, causes)
                            changed = True

    def _within(self, segment: Segment, node: int) -> bool:
        """Whether a point on the line of an edge lies between its ends."""
        p, q = (self._points[k] for k in segment)
        along = float((self._points[node] - p) @ (q - p))
        square = float((q - p) @ (q - p))
        margin = self._tolerance * square**0.5
        return margin < along < square - margin

    def between(self, a: int, b: int) -> list[int]:
        """Nodes inside an edge, from `a` to `b`."""
        segment = (min(a, b), max(a, b))
        found = self._on.get(segment)
        if not found:
            return []
        p, q = (self._points[k] for k in segment)
        inner = sorted(found, key=lambda node: float((self._points[node] - p) @ (q - p)))
        return inner if a < b else inner[::-1]

    def expanded(self, loop: Sequence[int]) -> list[int]:
        """A loop with the nodes on its edges."""
        return [v for a, b in zip(loop, [*loop[1:], loop[0]], strict=True) for v in (a, *self.between(a, b))]

    def pieces(self) -> set[Segment]:
        """What edges with nodes fall into."""
        chains = ([segment[0], *self.between(*segment), segment[1]] for segment in self._on)
        return {(min(a, b), max(a, b)) for chain in chains for a, b in pairwise(chain)}

    def gaps(self) -> list[tuple[float, list[frozenset[int]]]]:
        """Distances of neighbouring points on edges [m], shortest first, and who asked for each that is no end."""
        out = []
        for segment, found in self._on.items():
            chain = [segment[0], *self.between(*segment), segment[1]]
            for a, b in pairwise(chain):
                length = float(np.linalg.norm(self._points[b] - self._points[a]))
                out.append((length, [found[node] for node in (a, b) if node in found]))
        return sorted(out, key=lambda gap: (gap[0], [sorted(causes) for causes in gap[1]]))
