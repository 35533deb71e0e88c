"""When patches must be cut anew: how far the blocks of a pair have moved against each other since the cut."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.kernels import upkeep

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts

__all__ = ["drifted_pairs", "worn_pairs"]

Array = NDArray[np.float64]


EARLY = 0.5  # of what a cut allows


def worn_pairs(c: Contacts, x: Array) -> Any:
    """Pairs (n_pairs,) uint8 to be cut anew: one of their patches or near misses moved further than its cut allows.

    If there are any, those that have used up half of it are cut along: the table of patches is made anew at the cost
    of a step, however few they are.
    """
    worn = _moved(c, x, 1.0)
    return _moved(c, x, EARLY) if worn.any() else worn


def _moved(c: Contacts, x: Array, share: float) -> Any:
    p, g = c.patches, c.ghosts
    worn = np.zeros(len(c.pairs), np.uint8)
    upkeep.worn_pairs(p.gp, p.pair, p.w_clip, p.flags, share * p.reach, share * p.normal_reach, x, worn)
    reach = share * g.reach
    upkeep.worn_pairs(g.gp, g.pair, g.w, np.zeros(len(g.pair), np.uint8), reach, reach, x, worn)
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
