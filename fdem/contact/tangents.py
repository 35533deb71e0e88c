"""Tangent of the contact forces at the last trial, per patch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.errors import UnsupportedError
from fdem.kernels.tangent import contact_tangent

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts

__all__ = ["signature", "tangent"]


def signature(c: Contacts) -> bytes:
    """State of all contact points at the last trial."""
    return c._active.tobytes() + c._state.tobytes()


def tangent(c: Contacts, x: NDArray[np.float64], dt: float) -> tuple[Any, Any]:
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
        A joint law brings no response to small changes.
    """
    p = c.patches
    response = np.zeros((3 * len(p), 4, 4))
    for k, law in enumerate(c.laws):
        lo, hi = c._law_start[k], c._law_start[k + 1]
        if hi > lo:
            if law.response is None:
                raise UnsupportedError(f"joint law {law.name!r} has no tangent: implicit integrators cannot use it")
            law.response(
                3 * lo, 3 * hi, dt, c._gap, c._slip, c._normal, c._align, c._area, c._mass, p.prop, law.props,
                c._memory_start, c._memory, c._traction, c._state, response,
            )  # fmt: skip
    ids = np.flatnonzero(c._active)
    blocks = np.zeros((len(p), 7, 3, 7, 3))
    contact_tangent(
        p.gp, c._active, c._thick, x, c._w, c._area, c._push, c._face_normal, c._traction, response, blocks
    )  # fmt: skip
    return p.gp[ids], blocks[ids]
