"""What contact patches remember when their polygons are cut anew: reference gaps, laws, elastic slip."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.narrow import Patches
from fdem.contact.surface import FaceGeometry, Surfaces
from fdem.kernels import footprints, memory
from fdem.kernels import patches as kernels

__all__ = ["inherit_history", "inherit_laws", "known_offsets"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

PARALLEL = 1.0 - 1e-5  # cosine up to which a neighbouring master face continues a reference gap


def _match(old_keys: Any, new_keys: Any) -> tuple[Any, Any]:
    """For every new key the first old index with it, and whether there is one."""
    order = np.argsort(old_keys, kind="stable")
    at = np.searchsorted(old_keys[order], new_keys)
    at = np.minimum(at, max(len(order) - 1, 0))
    if not len(order):
        return np.zeros(len(new_keys), np.int64), np.zeros(len(new_keys), bool)
    found = old_keys[order][at] == new_keys
    return order[at], found


def known_offsets(old: Patches, n_faces: int, geometry: FaceGeometry) -> Callable[[Ints, Ints, Ints], Array]:
    """Reference gaps of old patches as a function of (pair, face_s, face_m); 0 where nothing is known.

    A gap belongs to a pair of faces. A face of the same master that continues the plane of the old one takes it over:
    without that a patch sliding over a mesh line would lose its offset at once.
    """

    def lookup(pair: Ints, face_s: Ints, face_m: Ints) -> Array:
        out = np.zeros((len(face_s), 3))
        used = np.flatnonzero(old.offset.any(axis=1))
        if not len(used) or not len(face_s):
            return out
        a, m = old.face_s[used].astype(np.int64), old.face_m[used].astype(np.int64)
        at, found = _match(old.pair[used].astype(np.int64) * n_faces + a, pair.astype(np.int64) * n_faces + face_s)
        near = np.einsum("ij,ij->i", geometry.normal[m[at]], geometry.normal[face_m]) > PARALLEL
        take = found & near
        out[take] = old.offset[used[at[take]]]
        at, found = _match(a * n_faces + m, face_s.astype(np.int64) * n_faces + face_m)
        out[found] = old.offset[used[at[found]]]
        return out

    return lookup


def inherit_laws(old: Patches, new: Patches, n_faces: int) -> Any:
    """Copy law, property row and joint id from old patches of the same two faces; mask of patches that had none."""
    at, found = _match(
        old.face_s.astype(np.int64) * n_faces + old.face_m, new.face_s.astype(np.int64) * n_faces + new.face_m
    )
    for name in ("law", "prop", "joint"):
        getattr(new, name)[found] = getattr(old, name)[at[found]]
    return ~found


def _same(old: Patches, new: Patches, n_faces: int) -> Any:
    """For every new patch the one closed old patch (n,) of the same two faces; -1 if there is none, or several."""
    held = np.flatnonzero(old.active_old)
    before = old.face_s[held].astype(np.int64) * n_faces + old.face_m[held]
    after = new.face_s.astype(np.int64) * n_faces + new.face_m
    order = np.argsort(before, kind="stable")
    first, last = (np.searchsorted(before[order], after, side=side) for side in ("left", "right"))
    same = np.full(len(new), -1)
    one = last - first == 1
    same[one] = held[order[first[one]]]
    return same


def inherit_history(surfaces: Surfaces, old: Patches, new: Patches, x: Array) -> Array:
    """Fill points, activity, memory and failures of `new` patches from `old` ones of the same pairs (CONTACT.md 3.7).

    Returns
    -------
    (n,) array
        Closed area of the new patches in the positions `x` [m2].
    """
    area = np.zeros(len(new))
    if not len(new):
        return area
    order = np.lexsort((old.face_m, old.face_s, old.pair))
    old = old.take(order)
    at, found = _match(
        old.face_s.astype(np.int64) * surfaces.n_faces + old.face_m,
        new.face_s.astype(np.int64) * surfaces.n_faces + new.face_m,
    )
    bonded = np.zeros(len(new), np.uint8)
    flag = (old.memory_old[:, 3].reshape(-1, 3).max(axis=1, initial=0.0) > 0.0) & (old.active_old > 0)
    bonded[found] = flag[at[found]]
    bonded &= ((new.flags & kernels.WHOLE) > 0).astype(np.uint8)
    footprints.closed_points(
        new.gp, new.start, new.corners, new.offset, bonded, new.ref_points, new.ref_ratio, x, new.points_old,
        new.active_old, area,
    )  # fmt: skip
    new.area_old[:] = area / 3.0
    # old patches of the same slave face
    old_face = old.pair.astype(np.int64) * surfaces.n_faces + old.face_s
    new_face = new.pair.astype(np.int64) * surfaces.n_faces + new.face_s
    begin, end = (np.searchsorted(old_face, new_face, side=side) for side in ("left", "right"))
    same = _same(old, new, surfaces.n_faces)
    memory.keep(same, new.points_old, new.active_old, new.memory_old, old.points_old, old.memory_old)
    if ((same < 0) & (new.active_old > 0)).any():
        first, last = (np.searchsorted(old.pair, new.pair, side=side) for side in ("left", "right"))
        memory.inherit(
            same, first, last, begin, end, new.face_s, new.face_m, new.gp, new.points_old, new.active_old,
            new.memory_old, old.face_s, old.face_m, old.gp, old.points_old, old.active_old, old.memory_old, x,
        )  # fmt: skip
    # failures stay with two faces; where a face meets a new one without a bond, what has failed on it goes along
    worst = np.zeros(len(old) + 1, np.uint8)
    np.maximum.at(worst, np.searchsorted(old_face, old_face), old.failure.max(axis=1, initial=0))
    new.failure[found] = old.failure[at[found]]
    loose = (new.failure == 0) & (new.memory_old[:, 3].reshape(-1, 3) <= 0.0) & (end > begin)[:, None]
    new.failure[loose] = np.repeat(worst[begin], 3).reshape(-1, 3)[loose]
    return area
