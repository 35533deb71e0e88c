"""Tangent of the contact forces at the last trial, per patch: differences of the joint laws, exact geometry."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.errors import UnsupportedError
from fdem.kernels.tangent import contact_tangent

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts
    from fdem.contact.laws import LawTable

__all__ = ["culprit", "responses", "signature", "tangent"]

Array = NDArray[np.float64]

CHANGE = 1e-6  # of the largest closure or elastic slip of a law's joints: small change that derivatives are taken over


def signature(c: Contacts) -> bytes:
    """State of all contact points at the last trial."""
    return c._active.tobytes() + c._state.tobytes()


def culprit(c: Contacts, block: int) -> str:
    """Words about the contact that carries most among those of a block, for messages; empty: it has none."""
    p = c.patches
    mine = (c.slave[p.pair] == block) | (c.master[p.pair] == block)
    rows = np.repeat(mine & (c._active > 0), 3)
    if not rows.any():
        return ""
    force = c._area * np.linalg.norm(c._traction, axis=1) * rows
    carried = np.bincount(p.pair, force.reshape(-1, 3).sum(axis=1), len(c.pairs))
    return f", its largest contact force between {c.pair_names(int(np.argmax(carried)))}"


def tangent(c: Contacts, x: Array, dt: float) -> tuple[Any, Array]:
    """Derivatives of contact forces by positions, for the patches that carry something.

    Parameters
    ----------
    c : Contacts
        After `forces` at the same positions.
    x : (n_gp, 3) array
        Positions [m].
    dt : float
        Time since the last commit [s]; 0: no damping.

    Returns
    -------
    gp : (n, 7) int32
        Gridpoints of each patch.
    blocks : (n, 7, 3, 7, 3) array
        d force of gridpoint (a, i) / d position of gridpoint (b, j) [N/m].

    Raises
    ------
    UnsupportedError
        A joint law of the user's own does not say that it has derivatives.
    """
    p = c.patches
    ids = np.flatnonzero(c._active)
    blocks = np.zeros((len(ids), 7, 3, 7, 3))
    rows = (3 * ids[:, None] + np.arange(3)).ravel()
    contact_tangent(
        p.gp[ids], c._active[ids], c._thick[ids], x, c._w[rows], c._area[rows], c._push[ids], c._face_normal[ids],
        c._traction[rows], responses(c, dt)[rows], blocks,
    )  # fmt: skip
    return p.gp[ids], blocks


def responses(c: Contacts, dt: float) -> Array:
    """Derivatives (3 n, 3, 4, 4) [Pa/m] of (pressure, shear traction) by (depth, slip) at the points of the patch."""
    out = np.zeros((3 * len(c.patches), 3, 4, 4))
    for k, law in enumerate(c.laws):
        lo, hi = 3 * c._law_start[k], 3 * c._law_start[k + 1]
        if hi > lo:
            if not law.smooth:
                raise UnsupportedError(f"joint law {law.name!r} has no tangent: implicit integrators cannot use it")
            _differences(c, law, lo, hi, dt, out)
    if c._corner is not None:
        _, _, _, slopes, factor, _, _ = c._corner
        pair = np.repeat(c.patches.pair, 3)
        out[:, :, 1:] *= factor[pair][:, None, None, None]
        # the slopes themselves change with the depth of all points of a pair: left out
        closed = slopes[pair, 1] * ((c._gap <= 0.0) & (c._area > 0.0))
        own = np.arange(len(out)), np.arange(len(out)) % 3
        out[own[0], own[1], 1:, 0] += closed[:, None] * np.repeat(c._face_normal, 3, axis=0)
    return out


def _differences(c: Contacts, law: LawTable, lo: int, hi: int, dt: float, out: Array) -> None:
    """Differences of one law, away from where it came from: closing, and sliding on as the step slides."""
    mine = slice(lo, hi)
    closed = np.repeat(c._active, 3)[mine] > 0
    elastic = np.abs(c._memory[mine, :3])[closed]
    change = CHANGE * max(float(np.abs(c._gap[mine])[closed].max(initial=0.0)), float(elastic.max(initial=0.0)))
    if change == 0.0:
        change = CHANGE**2 * float(np.sqrt(c._area[mine].max(initial=0.0)))
    if change == 0.0:
        return
    onward = np.where(c._slip < 0.0, -change, change)
    base = _tractions(c, law, lo, hi, dt, c._gap, c._slip)
    points = range(3) if law.arms else [slice(None)]
    for point in points:
        chosen = np.zeros(len(c._gap), dtype=bool)
        chosen[mine] = True if isinstance(point, slice) else np.arange(lo, hi) % 3 == point
        for k in range(4):
            gap, slip = c._gap, c._slip
            if k == 0:
                gap = np.where(chosen, gap - change, gap)
            else:
                slip = slip.copy()
                slip[chosen, k - 1] += onward[chosen, k - 1]
            difference = _tractions(c, law, lo, hi, dt, gap, slip) - base
            if isinstance(point, slice):
                step = change if k == 0 else onward[mine, k - 1, None]
                out[np.arange(lo, hi), np.arange(lo, hi) % 3, :, k] = difference / step
            else:  # all points of a patch answer to this one
                step = change if k == 0 else np.repeat(onward[lo + point : hi : 3, k - 1], 3)[:, None]
                out[mine, point, :, k] = difference / step


def _tractions(c: Contacts, law: LawTable, lo: int, hi: int, dt: float, gap: Array, slip: Array) -> Array:
    """Tractions (hi - lo, 4) of a law for other gaps and slips; nothing else changes."""
    memory, traction, work = np.zeros_like(c._memory), np.zeros_like(c._traction), np.zeros_like(c._work)
    law.sweep(
        lo, hi, dt, gap, c._push, slip, c._normal, c._align, c._area, c._mass, c._arm, c.patches.prop, law.props,
        c._memory_start, memory, traction, work, np.zeros_like(c._state),
    )  # fmt: skip
    return np.where((c._area[lo:hi] > 0.0)[:, None], traction[lo:hi], 0.0)
