"""Stiffness of joints as rigid blocks feel it: the stable step and the fictitious masses rest on it."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["joint_stiffness"]

ALIGNED = 0.99  # of the two normals: beyond, a joint has its normal and shear stiffness, else the larger all round


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
    if not len(gp):
        return result
    point = np.einsum("nk,nki->ni", w[:, :3], x[gp[:, :3]])
    normal = frame[:, 0]
    own = np.cross(x[gp[:, 1]] - x[gp[:, 0]], x[gp[:, 2]] - x[gp[:, 0]])
    aligned = np.abs(np.einsum("ni,ni->n", own, normal)) > ALIGNED * np.linalg.norm(own, axis=1)
    shear = np.where(aligned, ks, np.maximum(kn, ks))
    straight = np.where(aligned, kn, shear)
    along = (straight - shear)[:, None, None] * normal[:, :, None] * normal[:, None, :]
    spring = shear[:, None, None] * np.eye(3) + along
    sides = gp_block[gp[:, 0]], gp_block[gp[:, 3]]
    spring *= np.where(mobile[sides[0]] & mobile[sides[1]], 2.0, 1.0)[:, None, None]
    for side in sides:
        mine = np.flatnonzero((place[side] >= 0) & mobile[side])
        target = place[side[mine]]
        arm = point[mine] - centre[target]
        turn = np.zeros((len(mine), 3, 6))  # motion of the point: translation + rotation x arm
        turn[:, [0, 1, 2], [0, 1, 2]] = 1.0
        turn[:, [0, 1, 2], [4, 5, 3]] = arm[:, [2, 0, 1]]
        turn[:, [0, 1, 2], [5, 3, 4]] = -arm[:, [1, 2, 0]]
        np.add.at(result, target, np.swapaxes(turn, 1, 2) @ spring[mine] @ turn)
    return result
