"""Stiff corners: which pairs have them, what they store, how stiff they make contacts (kernels/corners.py)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.kernels import corners as kernels

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts

__all__ = ["absorb", "felt_areas", "keep", "pair_corners", "push", "stiffen", "stored_in_corners"]

Array = NDArray[np.float64]

CURVATURE = 2.0  # bound of d2U/dh2 over kn A_c for a contact that gets deeper by h: 1 for a face, less for corners


def pair_corners(c: Contacts) -> tuple[Array, ...] | None:
    """Arrays of `corner_energy` per pair and the factor at the last commit; None if not asked for.

    Those of `corner_energy` are stiffness, area, scratch, slopes, factor and energy.
    """
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
    return kn, area, np.zeros((n, 4)), np.zeros((n, 2)), np.ones(n), np.zeros(n), np.ones(n)


def stiffen(c: Contacts) -> None:
    """Before the joint laws: how much stiffer pairs are now; elastic slip keeps its energy."""
    if c._corner is not None:
        p, before = c.patches, c._corner[6]
        kernels.corner_energy(p.pair, c._active, c._gap, c._area, c._align, *c._corner[:6])
        kernels.carry_slip(p.pair, c._active, before, c._corner[4], c._memory_start)


def push(c: Contacts) -> None:
    """After them: add the tractions."""
    if c._corner is not None:
        kn, _, _, slopes, factor, energy, _ = c._corner
        kernels.corner_tractions(
            c.patches.pair, c._active, c._gap, c._area, c._face_normal, kn, slopes, factor, c._ks, c._memory,
            c._traction, c._work, energy,
        )  # fmt: skip


def keep(c: Contacts) -> None:
    """Accept the factors with the memory of a commit."""
    if c._corner is not None:
        np.copyto(c._corner[6], c._corner[4])


def absorb(c: Contacts) -> None:
    """Write slip as it is without stiff corners at the same energy: pairs are about to be cut or renumbered."""
    if c._corner is not None:
        factor = c._corner[6]
        c.patches.memory_old[:, :3] *= np.repeat(np.sqrt(np.maximum(factor[c.patches.pair], 0.0)), 3)[:, None]
        factor[:] = 1.0


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
