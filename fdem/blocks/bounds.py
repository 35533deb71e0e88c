"""Stiffness of joints as rigid blocks feel it: the stable step and the fictitious masses rest on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fdem.kernels import blocks as kernels

__all__ = ["Springs", "joint_stiffness", "share"]

FEW = 1000  # rows up to which NumPy spares the first start a kernel to compile


@dataclass
class Springs:
    """What holds blocks from outside: contacts, as if all were closed, and bedded faces.

    Attributes
    ----------
    x : (n_gp, 3) array
        Positions [m].
    bedding : (n_gp,) array
        Stiffness of bedded faces per gridpoint [N/m].
    contacts : Contacts or None
        The contact layer.
    gp_block : (n_gp,) int array
        Block of every gridpoint.
    mobile : (n_blocks,) bool array
        Which blocks can move.
    particles : ParticleSprings or None
        Contacts of spheres; what they do to faces is in `bedding`.
    """

    x: np.ndarray
    bedding: np.ndarray
    contacts: Any
    gp_block: np.ndarray
    mobile: np.ndarray
    particles: Any = None

    @cached_property
    def k_gp(self) -> np.ndarray:
        """Row-sum bound of all springs per gridpoint (n_gp,) [N/m]."""
        if self.contacts is None:
            return self.bedding
        return self.bedding + np.asarray(self.contacts.potential_k_gp(self.x, self.mobile[self.gp_block]))

    @cached_property
    def rows(self) -> tuple[Any, ...]:
        """Contact points: ``gp, w, frame, kn, ks`` of ``Contacts.stiffness``."""
        return tuple(self.contacts.stiffness(self.x))

    @property
    def kn(self) -> float:
        """Largest normal stiffness of any joint [Pa/m]; 0 without contacts."""
        return 0.0 if self.contacts is None else max(float(law.props[:, 0].max()) for law in self.contacts.laws)


def share(part: float, whole: float) -> float:
    """``part / whole``; 1 if something stands against nothing."""
    return part / whole if whole > 0 else 0.0 if part == 0 else 1.0


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
    if len(rows[0]) > FEW:
        result = np.zeros((len(centre), 6, 6))
        kernels.rigid_joints(*rows, x, gp_block, mobile, place, np.ascontiguousarray(centre), result)
        return result
    row, owner, straight, shear, point = _springs(rows, x, gp_block, mobile)
    at = place[owner]
    use = (at >= 0) & mobile[owner]
    row, at = row[use], at[use]
    ax, ay, az = (point[row] - centre[at]).T
    turn = np.zeros((len(at), 3, 6))  # motion of the point: translation + rotation x arm
    turn[:, range(3), range(3)] = 1.0
    turn[:, 0, 4], turn[:, 1, 5], turn[:, 2, 3] = az, ax, ay
    turn[:, 0, 5], turn[:, 1, 3], turn[:, 2, 4] = -ay, -az, -ax
    along = sum(rows[2][row, 0, d, None] * turn[:, d] for d in range(3))
    dot = sum(turn[:, d, :, None] * turn[:, d, None] for d in range(3))
    more, shear = (straight - shear)[row, None, None], shear[row, None, None]
    few: np.ndarray = np.zeros((len(centre), 6, 6))
    np.add.at(few, at, shear * dot + more * along[:, :, None] * along[:, None])
    few = np.where(np.tri(6, dtype=bool), few, few.transpose(0, 2, 1))  # symmetric to the last bit, as by the kernel
    return few


def _springs(
    rows: Sequence[Any], x: np.ndarray, gp_block: np.ndarray, mobile: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of both sides of n contact rows: row and block (2 n,); of rows: stiffness across and along, place (n, 3).

    Stiffness [N/m] counts twice between two blocks that move; the larger of both all round where the faces are not
    parallel within 8 degrees.
    """
    gp, w, frame, kn, ks = rows
    a, b, c = (x[gp[:, k]] for k in range(3))
    point = w[:, 0, None] * a + w[:, 1, None] * b + w[:, 2, None] * c
    own, normal = np.cross(b - a, c - a), frame[:, 0]
    cosine = np.abs(own[:, 0] * normal[:, 0] + own[:, 1] * normal[:, 1] + own[:, 2] * normal[:, 2])
    tilted = cosine <= 0.99 * np.sqrt(own[:, 0] ** 2 + own[:, 1] ** 2 + own[:, 2] ** 2)
    sides = gp_block[gp[:, [0, 3]]]
    twice = np.where(mobile[sides].all(axis=1), 2.0, 1.0)
    straight, shear = (np.where(tilted, np.maximum(kn, ks), k) for k in (kn, ks))
    return np.repeat(np.arange(len(gp)), 2), sides.ravel(), twice * straight, twice * shear, point
