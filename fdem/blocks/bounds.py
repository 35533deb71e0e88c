"""Stiffness of joints as rigid blocks feel it: the stable step and the fictitious masses rest on it."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.kernels import blocks as kernels

__all__ = ["joint_stiffness"]


def joint_stiffness(
    rows: tuple[Any, ...],
    x: np.ndarray,
    gp_block: np.ndarray,
    mobile: np.ndarray,
    place: np.ndarray,
    centre: np.ndarray,
) -> np.ndarray:
    """Stiffness of all joints, as if closed, against motions of one rigid block while the others bound it.

    Parameters
    ----------
    rows : tuple
        ``gp, w, frame, kn, ks`` of ``Contacts.stiffness``.
    x : (n_gp, 3) array
        Positions [m].
    gp_block, mobile, place : (n_gp,), (n_blocks,), (n_blocks,) array
        Block of a gridpoint, whether a block can move, and its place among the rigid blocks (-1: none).
    centre : (n_rigid, 3) array
        Centroids [m].

    Returns
    -------
    (n_rigid, 6, 6) array
        For translations and rotations about the centroid, global axes [N/m, N, N m].

    Notes
    -----
    ``k (u_a - u_b)^2 <= 2 k u_a^2 + 2 k u_b^2``, so a joint between two blocks that move counts twice on both, and
    the largest frequency of any block on these springs is a bound of that of the whole.
    """
    gp, w, frame, kn, ks = rows
    result = np.zeros((len(centre), 6, 6))
    kernels.rigid_joints(gp, w, frame, kn, ks, x, gp_block, mobile, place, np.ascontiguousarray(centre), result)
    return result
