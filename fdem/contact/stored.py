"""Elastic energy that contacts hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.kernels import energy
from fdem.kernels import patches as kernels

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts

__all__ = ["slip_energies", "stored_energy"]

Array = NDArray[np.float64]


def stored_energy(c: Contacts, memory: Array, active: Any) -> float:
    """Elastic energy [J] of the last `forces`, with `memory` (3 n, m) and `active` (n,) of the trial or the history.

    Exact for every overlap of polyhedra but where the master's ridges meet inside the slave (kernels/energy.py).
    """
    p = c.patches
    total = kernels.stored_energy(c._area, c._gap, c._facing, memory, c._kn, c._ks, active, 0, len(p))
    if c._partner is None:
        c._partner = np.full(len(p.corners), -1, dtype=np.int32)
        order = np.lexsort((p.face_s, p.pair)).astype(np.int32)
        energy.partners(order, p.pair, p.face_s, p.flags, p.start, p.corners, c._partner)
    total += energy.wall_energy(p.start, p.corners, c._partner, p.metric, c._depth, c._push, c._foot, c._kn, active)
    return float(total)


def slip_energies(c: Contacts) -> Array:
    """Elastic slip energy (n_patches,) of the last committed state [J]."""
    p = c.patches
    length = (p.memory_old[:, :3] ** 2).sum(axis=1)
    energies: Array = 0.5 * c._ks * (c._area * length).reshape(-1, 3).sum(axis=1) * (p.active_old > 0)
    return energies
