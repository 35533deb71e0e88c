"""What contacts start from: reference gaps and flags at compile, or a saved state."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.corners import absorb
from fdem.contact.narrow import Cut, Ghosts, Patches
from fdem.errors import CheckpointError, SceneError
from fdem.kernels import patches as kernels

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts

__all__ = ["close_gaps", "restore", "state_arrays"]

Array = NDArray[np.float64]

GAP = 1e-3  # default gap tolerance, of the smaller block's size
PARALLEL = float(np.cos(np.radians(15.0)))
TOUCH = 1e-6  # of the size: gap below which a contact exists at compile when the gap tolerance is off
# what the last `forces` left behind: energy() and table() read it
_LAST = (
    "active", "w", "gap", "area", "align", "normal", "push", "foot", "depth", "face_normal", "facing", "traction",
    "state", "bound",
)  # fmt: skip


def close_gaps(c: Contacts, cut: Cut) -> dict[str, float]:
    """Take gaps and overlaps below the tolerance as closed, set intact flags (CONTACT.md 3.8); the report.

    Raises
    ------
    SceneError
        Two blocks overlap by more than the gap tolerance; names them.
    """
    p = cut.patches
    size = np.minimum(c.surfaces.size[c.slave[p.pair]], c.surfaces.size[c.master[p.pair]])
    tolerance = np.full(len(p), c.gap_tolerance) if c.gap_tolerance is not None else GAP * size
    owner = np.repeat(np.arange(len(p)), np.diff(p.start))
    w0 = 1.0 - p.corners.sum(axis=1)
    at_corners = np.einsum("ij,ij->i", np.column_stack([w0, p.corners]), cut.plane_depth[owner])
    shallow = np.full(len(p), -np.inf)
    np.maximum.at(shallow, owner, np.abs(at_corners))
    fit = (cut.align > PARALLEL) & (shallow <= tolerance)
    if c.gap_tolerance is None or c.gap_tolerance > 0.0:
        p.offset[fit] = cut.plane_depth[fit]
        p.flags[fit] &= np.uint8(255 - kernels.AJAR)  # closed by definition, as wide as the faces
        strip = ~fit & (cut.depth > 0.0) & (cut.depth <= tolerance)  # beside a face that was closed: not to push either
        p.offset[strip] = cut.depth[strip, None]
        bad = np.flatnonzero((cut.depth > tolerance) & ~fit & ((p.flags & kernels.FACING) > 0))
        if len(bad):
            worst = bad[np.argmax(cut.depth[bad])]
            raise SceneError(
                f"blocks {c.pair_names(p.pair[worst])} overlap by {cut.depth[worst]:.3g} m at the start, more "
                f"than gap_tolerance = {tolerance[worst]:.3g} m"
            )
    touching = fit if c.gap_tolerance is None or c.gap_tolerance > 0.0 else cut.depth > -TOUCH * size
    touching = touching & ((p.flags & kernels.FACING) > 0)
    p.memory_old[np.repeat(touching, 3), 3] = 1.0
    p.points_old[:] = p.ref_points
    p.active_old[:] = touching
    relative = np.abs(p.offset).max(axis=1) / size if len(p) else np.zeros(0)
    return {
        "pairs": float(len(c.pairs)),
        "patches": float(len(p)),
        "gaps closed": float(fit.sum()),
        "largest gap / size": float(relative.max(initial=0.0)),
    }


def state_arrays(c: Contacts) -> dict[str, Array]:
    """Everything that influences the next step, as copies."""
    absorb(c)
    out = {f"patch_{f.name}": getattr(c.patches, f.name).copy() for f in fields(Patches)}
    out |= {f"ghost_{f.name}": getattr(c.ghosts, f.name).copy() for f in fields(Ghosts)}
    out |= {name: getattr(c, name).copy() for name in ("pairs", "x_ref", "x_check", "work")}
    out |= {name: getattr(c, f"_{name}").copy() for name in _LAST}
    out["counters"] = np.array([c.n_detections, c.n_cuts])
    out["stored"], out["filled"] = np.array([c.energy()]), np.array([c._filled])
    return out


def restore(c: Contacts, arrays: dict[str, Any]) -> None:
    """Take back what `state_arrays` returned.

    Raises
    ------
    CheckpointError
        The arrays do not fit this model.
    """
    try:
        patches = Patches(**{f.name: np.array(arrays[f"patch_{f.name}"]) for f in fields(Patches)})
        ghosts = Ghosts(*(np.array(arrays[f"ghost_{f.name}"]) for f in fields(Ghosts)))
        if arrays["x_ref"].shape != c.x_ref.shape or patches.memory_old.shape[1] != c.n_memory:
            raise CheckpointError("contacts: the saved state belongs to another model")
        for name in ("pairs", "x_ref", "x_check", "work"):
            setattr(c, name, np.array(arrays[name]))
        c.n_detections, c.n_cuts = (int(c) for c in arrays["counters"])
        c._orient()
        c.patches, c.ghosts = patches, ghosts
        c._prepare()
        for name in _LAST:
            getattr(c, f"_{name}")[:] = arrays[name]
        c._stored, c._filled = float(arrays["stored"][0]), bool(arrays["filled"][0])
    except KeyError as missing:
        raise CheckpointError(f"contacts: the saved state lacks {missing}") from None
