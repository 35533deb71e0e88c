"""When patches must be cut anew: how far the blocks of a pair have moved against each other since the cut."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.kernels import upkeep

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts

__all__ = ["closing", "drifted_pairs", "worn_pairs"]

Array = NDArray[np.float64]


def closing(c: Contacts, x: Array, out: Any) -> bool:
    """Mark pairs in `out` (n_pairs,) uint8 with a patch that is wider than the faces and closes; whether there are."""
    p = c.patches
    return bool(upkeep.closing(p.gp, p.pair, p.flags, p.start, p.corners, p.offset, x, out))


def worn_pairs(c: Contacts, x: Array) -> Any:
    """Pairs (n_pairs,) uint8 one of whose patches or near misses moved further than its cut allows."""
    p, g = c.patches, c.ghosts
    worn = np.zeros(len(c.pairs), np.uint8)
    upkeep.worn_pairs(p.gp, p.pair, p.w_clip, p.flags, p.reach, p.normal_reach, x, worn)
    upkeep.worn_pairs(g.gp, g.pair, g.w, np.zeros(len(g.pair), np.uint8), g.reach, g.reach, x, worn)
    closing(c, x, worn)
    return worn


def drifted_pairs(c: Contacts, x: Array) -> Any:
    """Pairs (n_pairs,) bool without a patch, or moved a quarter of the window against each other since the cut."""
    p = c.patches
    far = np.ones(len(c.pairs), np.uint8)
    if c.clip_always:
        return far > 0
    far[p.pair] = 0
    limit = 0.25 * c._window[p.pair]
    upkeep.worn_pairs(p.gp, p.pair, p.w_clip, np.zeros(len(p), np.uint8), limit, limit, x, far)
    return far > 0
