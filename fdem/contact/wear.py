"""How far the blocks of a pair moved against each other: since the cut, which must be renewed, or in a single step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.broad import box_pairs
from fdem.errors import OverlapError
from fdem.kernels import patches, upkeep

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts

__all__ = ["closing", "drifted_pairs", "least_volumes", "refuse_leaps", "too_deep", "worn_pairs"]

Array = NDArray[np.float64]


EARLY = 0.5  # of what a cut allows
SEAM = (
    0.05  # of it: what moved less since its cut, 5e-5 of a face's size, need not be cut with what shares a face with it
)
BESIDE = 0.1  # of the largest contact force on a block: what is less needs no finer cuts than this


def closing(c: Contacts, x: Array, out: Any) -> bool:
    """Mark pairs in `out` (n_pairs,) uint8 with a patch that is wider than the faces and closes; whether there are."""
    p = c.patches
    return bool(upkeep.closing(p.gp, p.pair, p.flags, p.start, p.corners, p.offset, x, out))


def worn_pairs(c: Contacts, x: Array) -> Any:
    """Pairs (n_pairs,) uint8 to be cut anew: one of their patches or near misses moved further than its cut allows.

    If there are any, those that have used up half of it are cut along: the table of patches is made anew at the cost
    of a step, however few they are. So are all that moved and share a face with them: a face that slides over a seam
    is never carried twice, nor not at all, by the parts of it that were cut before and after.
    """
    worn = _moved(c, x, 1.0)
    if not worn.any():
        return worn
    return _moved(c, x, EARLY) | (_moved(c, x, SEAM) & _beside(c, worn > 0))


def _beside(c: Contacts, worn: Any) -> Any:
    """Pairs (n_pairs,) uint8 with a face against a face that one of the pairs `worn` lies against as well."""
    p = c.patches
    flat = np.flatnonzero(p.flags & patches.FLAT)
    mine = flat[worn[p.pair[flat]]]
    faces, out = np.zeros(c.surfaces.n_faces, bool), np.zeros(len(c.pairs), np.uint8)
    faces[p.face_s[mine]] = faces[p.face_m[mine]] = True
    out[p.pair[flat[faces[p.face_s[flat]] | faces[p.face_m[flat]]]]] = 1
    return out


def _moved(c: Contacts, x: Array, share: float) -> Any:
    p, g = c.patches, c.ghosts
    worn = np.zeros(len(c.pairs), np.uint8)
    upkeep.worn_pairs(p.gp, p.pair, p.w_clip, p.flags, share * p.reach, share * p.normal_reach, x, worn)
    reach = share * g.reach
    upkeep.worn_pairs(g.gp, g.pair, g.w, np.zeros(len(g.pair), np.uint8), reach, reach, x, worn)
    closing(c, x, worn)
    return worn


def drifted_pairs(c: Contacts, x: Array) -> Any:
    """Pairs (n_pairs,) bool without a patch, or moved a quarter of the window against each other since the cut."""
    p = c.patches
    far = np.ones(len(c.pairs), np.uint8)
    if c.clip_always:
        return far > 0
    far[p.pair] = 0
    limit = 0.25 * c._window[p.pair]
    upkeep.worn_pairs(p.gp, p.pair, p.w_clip, np.zeros(len(p), np.uint8), limit, limit, x, far)
    return far > 0


def least_volumes(c: Contacts) -> Array:
    """Overlap (n_pairs,) [m3] of every pair that matters beside the other contacts of its blocks.

    Blocks that only touch along an edge would be cut anew in every step for a force that is lost in the others.
    """
    p, force, stiffest = c.patches, np.zeros(len(c.pairs)), np.zeros(len(c.pairs))
    if not c._filled:
        return force
    volume = (c._area * np.maximum(-c._gap, 0.0)).reshape(-1, 3).sum(axis=1)
    np.add.at(force, p.pair, c._kn * volume)
    np.maximum.at(stiffest, p.pair, c._kn)
    largest = np.zeros(c.surfaces.n_blocks)
    np.maximum.at(largest, c.slave, force)
    np.maximum.at(largest, c.master, force)
    beside = BESIDE * np.minimum(largest[c.slave], largest[c.master])
    return np.divide(beside, stiffest, out=np.zeros_like(beside), where=stiffest > 0.0)


def refuse_leaps(c: Contacts, x_old: Array, x: Array) -> None:
    """Refuse a step from `x_old` to `x` in which one block may have jumped through another.

    Raises
    ------
    OverlapError
        Two blocks, one in the way of the other, moved against each other by more than the thinner one's deepest point;
        names them.
    """
    s = c.surfaces
    motion = np.zeros(s.n_blocks)
    upkeep.block_motion(s.movers, s.surface_gp, s.surface_start, x, x_old, motion)
    if not 2.0 * motion.max(initial=0.0) > s.room.min(initial=np.inf):
        return
    first = s.surface_start[:-1]
    points, before = x[s.surface_gp], x_old[s.surface_gp]
    lower = np.minimum.reduceat(np.minimum(points, before), first, axis=0)
    upper = np.maximum.reduceat(np.maximum(points, before), first, axis=0)
    shift = np.add.reduceat(points - before, first, axis=0) / np.diff(s.surface_start)[:, None]
    turn = np.zeros(s.n_blocks)
    owner = np.repeat(np.arange(s.n_blocks), np.diff(s.surface_start))
    np.maximum.at(turn, owner, np.linalg.norm(points - before - shift[owner], axis=1))
    pairs = box_pairs(lower, upper, np.zeros(s.n_blocks), s.fixed)
    if c.may_touch is not None and len(pairs):
        pairs = pairs[np.asarray(c.may_touch(pairs[:, 0], pairs[:, 1]), dtype=bool)]
    a, b = pairs[:, 0], pairs[:, 1]
    against = np.linalg.norm(shift[a] - shift[b], axis=1) + turn[a] + turn[b]
    far = np.flatnonzero(against > np.minimum(s.room[a], s.room[b]))
    if len(far):
        k = far[np.argmax(against[far])]
        raise OverlapError(
            f"blocks {c.names[a[k]]!r} and {c.names[b[k]]!r} moved by {against[k]:.3g} m against each other in one "
            "step, so far that contact between them may have gone unseen; the step is too large"
        )


def too_deep(c: Contacts, patch: int) -> str:
    """What to say about a patch whose deepest corner is beyond its limit."""
    p = c.patches
    w = p.corners[p.start[patch] : p.start[patch + 1]]
    depth = np.column_stack([1.0 - w.sum(axis=1), w]) @ (c._closed[2][patch] + p.offset[patch])
    return (
        f"blocks {c.pair_names(p.pair[patch])} overlap by {depth.max():.3g} m, more than their surfaces describe "
        f"({p.limit[patch]:.3g} m, a quarter of the local thickness); joint too soft or step too large"
    )
