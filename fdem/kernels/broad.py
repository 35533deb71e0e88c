"""Broad phase: pairs of boxes that meet, by a grid with one level per power of two in box size."""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

SLACK = 1.0 + 1e-6  # a cell is a little larger than its boxes, so that rounding cannot push one past a neighbour
FINEST = 60  # deepest level


@kernel
def _levels(lo, hi, level):
    """Grid level of every box (n,): its extent is at most the cell size ``size / 2**level``. Returns `size` [m]."""
    n = len(lo)
    size = 0.0
    for i in range(n):
        for d in range(3):
            size = max(size, hi[i, d] - lo[i, d])
    size *= SLACK
    for i in range(n):
        extent = SLACK * max(hi[i, 0] - lo[i, 0], hi[i, 1] - lo[i, 1], hi[i, 2] - lo[i, 2])
        step = 0
        while step < FINEST and extent <= size / 2.0 ** (step + 1):
            step += 1
        level[i] = step
    return size


@kernel
def _slot(level, a, b, c, mask):
    """Place of a cell in the hash table."""
    return (a * 73856093 ^ b * 19349663 ^ c * 83492791 ^ level * 49979687) & mask


@kernel
def _longer(ids):
    """Twice as many; those there are keep their place."""
    return np.concatenate((ids, np.empty_like(ids)))


@kernel
def _by_first(first, second, m, n):
    """The `m` pairs sorted by first and second id (counting, then insertion in the short rows)."""
    start = np.zeros(n + 1, np.int64)
    for k in range(m):
        start[first[k] + 1] += 1
    for i in range(n):
        start[i + 1] += start[i]
    out, at = np.empty((m, 2), np.int32), start.copy()
    for k in range(m):
        i, j = first[k], second[k]
        q = at[i]
        while q > start[i] and out[q - 1, 1] > j:
            out[q, 1] = out[q - 1, 1]
            q -= 1
        out[q, 1] = j
        out[at[i], 0] = i
        at[i] += 1
    return out


@kernel
def box_pairs(lower, upper, reach, fixed):
    """Pairs (i < j) of blocks whose boxes, grown by `reach` (n_blocks,) [m], meet; not both fixed. Sorted by id.

    A box lies in the cell of its lower corner, on the coarsest level whose cells hold it; it is compared with the
    boxes of half of the 27 cells around it there, and with those in reach on all coarser levels. So large and small
    blocks together cost no more than blocks of one size (Ericson, Real-time collision detection, 2005, 7.2).
    """
    n = len(reach)
    lo, hi, origin = lower.copy(), upper.copy(), np.zeros(3)
    for d in range(3):
        origin[d] = np.inf
        for i in range(n):
            lo[i, d] -= reach[i]
            hi[i, d] += reach[i]
            origin[d] = min(origin[d], lo[i, d])
    level, cell = np.zeros(n, np.int64), np.zeros((n, 3), np.int64)
    size = _levels(lo, hi, level)
    mask = 1
    while mask < 2 * n:
        mask *= 2
    mask -= 1
    head, following = np.full(mask + 1, -1, np.int64), np.empty(n, np.int64)
    used = np.zeros(FINEST + 1, np.bool_)
    for i in range(n):
        used[level[i]] = True
        s = size / 2.0 ** level[i]
        for d in range(3):
            cell[i, d] = math.floor((lo[i, d] - origin[d]) / s)
        slot = _slot(level[i], cell[i, 0], cell[i, 1], cell[i, 2], mask)
        following[i] = head[slot]
        head[slot] = i
    first, second, m = np.empty(8 * n + 16, np.int32), np.empty(8 * n + 16, np.int32), np.int64(0)
    for i in range(n):
        for step in range(level[i] + 1):
            if not used[step]:
                continue
            s, same = size / 2.0**step, step == level[i]
            a0, b0, c0 = cell[i, 0] - 1, cell[i, 1] - 1, cell[i, 2] - 1
            a1, b1, c1 = cell[i, 0] + 1, cell[i, 1] + 1, cell[i, 2] + 1
            if not same:
                a0, a1 = math.floor((lo[i, 0] - origin[0]) / s) - 1, math.floor((hi[i, 0] - origin[0]) / s)
                b0, b1 = math.floor((lo[i, 1] - origin[1]) / s) - 1, math.floor((hi[i, 1] - origin[1]) / s)
                c0, c1 = math.floor((lo[i, 2] - origin[2]) / s) - 1, math.floor((hi[i, 2] - origin[2]) / s)
            for a in range(a0, a1 + 1):
                for b in range(b0, b1 + 1):
                    for c in range(c0, c1 + 1):
                        own = same and a == cell[i, 0] and b == cell[i, 1] and c == cell[i, 2]
                        if same and not own:  # of two neighbouring cells the later one looks at the earlier one
                            da, db, dc = a - cell[i, 0], b - cell[i, 1], c - cell[i, 2]
                            if da > 0 or (da == 0 and (db > 0 or (db == 0 and dc > 0))):
                                continue
                        j = head[_slot(step, a, b, c, mask)]
                        while j >= 0:
                            q = j
                            j = following[q]
                            if level[q] != step or cell[q, 0] != a or cell[q, 1] != b or cell[q, 2] != c:
                                continue
                            if (own and q >= i) or (fixed[i] and fixed[q]):
                                continue
                            if lo[q, 0] > hi[i, 0] or lo[q, 1] > hi[i, 1] or lo[q, 2] > hi[i, 2]:
                                continue
                            if lo[i, 0] > hi[q, 0] or lo[i, 1] > hi[q, 1] or lo[i, 2] > hi[q, 2]:
                                continue
                            if m == len(first):
                                first, second = _longer(first), _longer(second)
                            first[m], second[m] = min(i, q), max(i, q)
                            m += 1
    return _by_first(first, second, m, n)
