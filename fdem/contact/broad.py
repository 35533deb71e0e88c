"""Broad phase: which blocks are close enough to be looked at."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.surface import Surfaces
from fdem.kernels import broad as kernels

__all__ = ["block_skins", "candidate_pairs", "common_pairs", "master_first"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

SKIN = 0.02  # of the block size
FEW = 64  # blocks of which all pairs are looked at
REACH = 0.75  # of the skin: half of it before the next detection, a quarter that was not yet refreshed


def block_skins(surfaces: Surfaces) -> Array:
    """Skin of every block [m]: 2 % of its size, or of the median mobile block's if that is smaller."""
    s = surfaces
    usable = np.isfinite(s.size)
    mobile = usable & (s.fixed == 0)
    pool = s.size[mobile if mobile.any() else usable]
    typical = float(np.sort(pool)[len(pool) // 2]) if len(pool) else 1.0
    skins: Array = SKIN * np.minimum(s.size, typical)
    return skins


def candidate_pairs(surfaces: Surfaces, x: Array, skins: Array, may_touch: Callable[..., Any] | None) -> Ints:
    """Pairs of blocks (n, 2), lower id first and sorted, whose boxes grown by the reach of the skin meet.

    Two fixed blocks are never a pair; `may_touch(block_a, block_b) -> bool mask` removes others.
    """
    s = surfaces
    points = x[s.surface_gp]
    faced = np.flatnonzero(np.diff(s.surface_start))
    lower = np.minimum.reduceat(points, s.surface_start[faced], axis=0)
    upper = np.maximum.reduceat(points, s.surface_start[faced], axis=0)
    pairs: Ints = faced[box_pairs(lower, upper, REACH * skins[faced], s.fixed[faced])].astype(np.int32)
    if may_touch is not None and len(pairs):
        pairs = pairs[np.asarray(may_touch(pairs[:, 0], pairs[:, 1]), dtype=bool)]
    return pairs


def box_pairs(lower: Array, upper: Array, reach: Array, fixed: Any) -> Ints:
    """`kernels.broad.box_pairs`; of few blocks all pairs are looked at, which spares a small scene its compilation."""
    if len(reach) > FEW:
        pairs: Ints = kernels.box_pairs(lower, upper, reach, fixed)
        return pairs
    low, high = lower - reach[:, None], upper + reach[:, None]
    i, j = np.triu_indices(len(reach), 1)
    meet = ((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1) & ~((fixed[i] != 0) & (fixed[j] != 0))
    return np.column_stack([i[meet], j[meet]]).astype(np.int32)


def common_pairs(old: Ints, new: Ints) -> tuple[Any, Any, Ints]:
    """Rows of `old` and `new` (sorted pairs) that are the same pair, and for every old row its new one or -1."""
    n = int(max(old.max(initial=-1), new.max(initial=-1))) + 1
    before, after = (pairs[:, 0].astype(np.int64) * n + pairs[:, 1] for pairs in (old, new))
    _, at_old, at_new = np.intersect1d(before, after, assume_unique=True, return_indices=True)
    number = np.full(len(old), -1, np.int32)
    number[at_old] = at_new
    return at_old, at_new, number


def master_first(surfaces: Surfaces, pairs: Ints) -> tuple[Ints, Ints]:
    """Slave and master of every pair (CONTACT.md 3.2): master has fewer faces; tie: is larger; tie: has the lower id.

    Open surfaces are always masters.
    """
    s = surfaces
    a, b = pairs[:, 0], pairs[:, 1]
    count = np.diff(s.face_start)
    b_larger = s.volume[b] > s.volume[a] * (1.0 + 1e-9)
    b_master = np.where(count[a] != count[b], count[b] < count[a], b_larger)
    opened = s.open[a] != s.open[b]
    b_master = np.where(opened, s.open[b] == 1, b_master)
    return np.where(b_master, a, b).astype(np.int32), np.where(b_master, b, a).astype(np.int32)
