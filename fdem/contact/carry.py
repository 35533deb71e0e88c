"""Contacts taken over from one compiled model into another, and reading of parts of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact import response
from fdem.contact.corners import absorb
from fdem.contact.narrow import Ghosts, Patches
from fdem.contact.parking import patches_of, whole
from fdem.errors import CheckpointError
from fdem.kernels import joints
from fdem.kernels import patches as kernels

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts

__all__ = ["adopt", "closure", "notes", "present", "reset_slip", "scatter_between"]

Array = NDArray[np.float64]


def adopt(new: Contacts, old: Contacts, rows: Any, gp_number: Any, x: Array) -> None:
    """Give `new` the patches and history of `old` for all pairs of blocks that are still there.

    Parameters
    ----------
    new, old : Contacts
        Target and source.
    rows : (n, 2) int array
        Old and new number of every surviving block.
    gp_number : (n_old_gp,) int array
        New number of every old gridpoint, -1 if gone.
    x : (n_gp, 3) array
        Positions in the new model [m].

    Raises
    ------
    CheckpointError
        If a surviving block has other faces than before.
    """
    old = whole(old)
    absorb(old)
    block = np.full(old.surfaces.n_blocks, -1, dtype=np.int64)
    block[rows[:, 0]] = rows[:, 1]
    other = np.not_equal(np.diff(old.surfaces.face_start)[rows[:, 0]], np.diff(new.surfaces.face_start)[rows[:, 1]])
    if other.any():
        worst = rows[int(np.argmax(other)), 1]
        raise CheckpointError(f"block {new.names[worst]!r} has other faces than the state it should take over")
    shift = np.zeros(old.surfaces.n_blocks, dtype=np.int64)
    shift[rows[:, 0]] = new.surfaces.face_start[rows[:, 1]] - old.surfaces.face_start[rows[:, 0]]
    pairs = block[old.pairs]
    keep = np.asarray((pairs >= 0).all(axis=1))
    number = np.full(len(old.pairs), -1, dtype=np.int32)
    number[keep] = np.arange(int(keep.sum()))
    new.pairs = np.ascontiguousarray(pairs[keep], dtype=np.int32)
    new._orient()
    patches = old.patches.take(np.flatnonzero(keep[old.patches.pair]))
    patches.pair = number[patches.pair]
    for name in ("face_s", "face_m"):
        face = getattr(patches, name)
        setattr(patches, name, (face + shift[old.surfaces.face_block[face]]).astype(np.int32))
    patches.gp = gp_number[patches.gp].astype(np.int32)
    ghosts = old.ghosts.without(~keep)
    new.ghosts = Ghosts(number[ghosts.pair], gp_number[ghosts.gp].astype(np.int32), ghosts.w, ghosts.reach)
    new.patches = patches
    known = gp_number >= 0
    for name in ("x_ref", "x_check"):
        getattr(new, name)[:] = x
        getattr(new, name)[gp_number[known]] = getattr(old, name)[known]
    new.work[:] = old.work
    new.n_detections, new.n_cuts, new.report = old.n_detections, old.n_cuts, old.report
    new._prepare()
    new._stored = None
    added = np.ones(new.surfaces.n_blocks, dtype=bool)
    added[rows[:, 1]] = False
    if added.any():
        new._redo(x, added)


def present(c: Contacts) -> tuple[float, float, float]:
    """Stored energy, friction and damping work [J] including the trial not yet committed."""
    c = whole(c)
    if not c._trial:
        return c.energy(), c.friction_work, c.damping_work
    work = c.work.copy()
    joints.total_work(c._area, c._work, work)
    work[0] += 0.5 * float(c._ks @ c._lost)
    return response.stored(c, c._memory, c._active), float(work[0]), float(work[1])


def closure(c: Contacts) -> tuple[float, str]:
    """Largest closure in the last `forces` over the size of the smaller block, and the names of the pair."""
    p, size = c.patches, c.surfaces.size
    depth = np.where(c._active > 0, -c._gap.reshape(-1, 3).min(axis=1, initial=0.0), 0.0)
    relative = depth / np.minimum(size[c.slave], size[c.master])[p.pair]
    if not len(relative):
        return 0.0, ""
    worst = int(np.argmax(relative))
    return float(relative[worst]), c.pair_names(int(p.pair[worst]))


def scatter_between(c: Contacts, chosen: Any, f_gp: Array) -> None:
    """Add to `f_gp` the last forces of contacts with exactly one block in `chosen` (n_blocks,) bool."""
    c = whole(c)
    p: Patches = c.patches
    if not len(p):
        return
    mixed = chosen[c.slave[p.pair]] != chosen[c.master[p.pair]]
    kernels.scatter(p.gp, c._active * mixed.astype(np.uint8), c._w, c._area, c._push, c._foot, c._traction, f_gp)


def reset_slip(c: Contacts) -> None:
    """Set the recorded slip distances to zero; tractions stay."""
    for p in patches_of(c):
        p.memory_old[:, 4] = 0.0


def notes(c: Contacts) -> list[str]:
    """What the contact layer found and does, one fact a line."""
    c = whole(c)
    report = c.report
    deepest, names = closure(c)
    lines = [
        f"contacts: {int(report.get('pairs', 0))} pairs near each other at compile, {c.n_patches} patches now, "
        f"{int(c._active.sum())} closed",
        f"reference gap: {int(report.get('gaps closed', 0))} patches taken as closed, "
        f"largest gap {report.get('largest gap / size', 0.0):.2g} of the block size",
    ]
    if deepest > 0.0:
        lines.append(f"closure: at most {deepest:.2g} of the block size now, between {names}")
    if not c._damped:
        lines.append("contact damping: left out, no joint asks for it")
    if not c._armed:
        lines.append("contact moments: left out, no joint asks for them")
    if c.curved:
        lines.append("joints that stiffen as they close: the step follows their tangent and how fast they close")
    return lines
