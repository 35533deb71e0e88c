"""Stiff corners: which pairs have them, what they store, how stiff they make contacts (kernels/corners.py)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts

__all__ = ["felt_areas", "pair_corners", "stored_in_corners"]

Array = NDArray[np.float64]

CURVATURE = 2.0  # bound of d2U/dh2 over kn A_c for a contact that gets deeper by h: 1 for a face, less for corners


def pair_corners(c: Contacts) -> tuple[Array, ...] | None:
    """Arrays of `corner_energy` per pair: stiffness, area, scratch, slopes, factor, energy; None if not asked for."""
    p, n = c.patches, len(c.pairs)
    if not any(law.corner is not None and law.corner.any() for law in c.laws):
        return None
    area = np.zeros(n)
    for k, law in enumerate(c.laws):
        mine = p.law == k
        assert law.corner is not None
        np.maximum.at(area, p.pair[mine], law.corner[p.prop[mine]])
    kn = np.zeros(n)
    np.maximum.at(kn, p.pair, c._kn)
    return kn, area, np.zeros((n, 4)), np.zeros((n, 2)), np.ones(n), np.zeros(n)


def stored_in_corners(c: Contacts) -> float:
    """Energy [J] of stiff corners in the last `forces`."""
    return 0.0 if c._corner is None else float(c._corner[5].sum())


def felt_areas(c: Contacts, area: Array) -> Array:
    """Areas (n_patches,) [m2] whose stiffness bounds that of the patches, stiff corners included."""
    if c._corner is None:
        return area
    pair = c.patches.pair
    total = np.bincount(pair, area, len(c.pairs))
    with np.errstate(divide="ignore", invalid="ignore"):
        factor: Any = np.where(total > 0.0, 1.0 + CURVATURE * c._corner[1] / total, 1.0)
    out: Array = area * factor[pair]
    return out
