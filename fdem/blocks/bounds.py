"""Stiffness of joints as rigid blocks feel it: the stable step and the fictitious masses rest on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fdem.kernels import blocks as kernels

__all__ = ["Springs", "joint_stiffness", "share"]


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
    gp, w, frame, kn, ks = rows
    result = np.zeros((len(centre), 6, 6))
    kernels.rigid_joints(gp, w, frame, kn, ks, x, gp_block, mobile, place, np.ascontiguousarray(centre), result)
    return result
