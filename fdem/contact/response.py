"""How contacts respond now, whatever their laws: stiffness, energy stored, and how fast they may close.

Laws with ``p = kn depth`` cost nothing here; the others bring a `closure` kernel (kernels/joints.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.corners import stored_in_corners
from fdem.kernels import energy, response
from fdem.kernels import patches as kernels

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts
    from fdem.contact.narrow import Patches

__all__ = ["brittle_of", "couples", "held_energy", "look", "pace", "slip_energies", "stiffness_now", "stored"]

Array = NDArray[np.float64]

GROWTH = 0.1  # share by which a tangent stiffness may grow until the stable step is found again
SHARE = 0.1  # of the closure a contact can still take, in one step: its tangent then grows by less than a quarter


def brittle_of(laws: Any, p: Patches) -> Any:
    """Which patches (n,) uint8 have a joint that loses something by failure."""
    brittle = np.zeros(len(p), np.uint8)
    for k, law in enumerate(laws):
        mine = p.law == k
        brittle[mine] = law.brittle[p.prop[mine]]
    return brittle


def stiffness_now(c: Contacts, x: Array) -> Array:
    """Normal stiffness (n,) [Pa/m] of patches at the present closure; later growth counts from here."""
    p = c.patches
    c._bound[:] = c._kn
    c.stiffer = False
    if c._curved:
        gap = np.zeros(3 * len(p))
        response.whole_gaps(p.gp, p.flags, p.offset, p.active_old, p.memory_old, p.ref_points, x, gap)
    for k in c._curved:
        law, patches, rows = c.laws[k], *_slices(c, k)
        tangent = law.respond(gap[rows], p.prop[patches], p.memory_old[rows])[:, 1]
        if c._filled:
            closed = (c._area[rows] > 0.0) * c._response[rows, 1]
            tangent = np.maximum(tangent, closed)
        c._bound[patches] = tangent.reshape(-1, 3).max(axis=1)
    return c._bound


def couples(c: Contacts, x: Array) -> list[tuple[Any, Array, Array, Array]]:
    """Springs that stand for the couples of patches: ids (m,), points (m, 3, 2), kn (m,), ks (m,) [Pa/m].

    Three springs at ``sqrt(2) (S + L^2)^(1/2) e`` are as stiff against rotation as a rolling length L at ``sqrt(2)
    S^(1/2) e`` (kernels/joints.py); those of a twisting length resist along the faces.
    """
    p, out = c.patches, []
    e = np.array([[1.0, 0.0], [-0.5, np.sqrt(0.75)], [-0.5, -np.sqrt(0.75)]])
    for k, law in enumerate(c.laws):
        for kind in range(2):
            ids = np.flatnonzero((p.law == k) & ((p.flags & kernels.FACING) > 0))
            ids = ids[law.lengths[p.prop[ids], kind] > 0.0]
            if not len(ids):
                continue
            length2 = law.lengths[p.prop[ids], kind] ** 2
            middle = p.ref_points[ids].mean(axis=1, keepdims=True)
            arm = p.ref_points[ids] - middle
            a, b, d = (x[p.gp[ids, i]] for i in range(3))
            edges = np.stack([b - a, d - a], axis=1)
            j = np.sqrt(2.0) / 3.0 * np.einsum("nqk,nkx,qi->nxi", arm, edges, e)
            moments = np.einsum("nxi,nxj->nij", j, j)
            if kind:
                factor = np.sqrt(1.0 + length2 / np.trace(moments, axis1=1, axis2=2))
                points = middle + factor[:, None, None] * arm
            else:
                values, vectors = np.linalg.eigh(moments)
                values = np.sqrt(1.0 + length2[:, None] / np.maximum(values, 1e-20 * values[:, 1:]))
                turn = np.einsum("nik,nk,njk->nij", vectors, values, vectors)
                points = middle + 2.0 / 3.0 * np.einsum("pi,nij,qj,npk->nqk", e, turn, e, arm)
            none = np.zeros(len(ids))
            out.append((ids, points, none if kind else c._kn[ids], c._ks[ids] if kind else none))
    return out


def _slices(c: Contacts, k: int) -> tuple[slice, slice]:
    lo, hi = c._law_start[k], c._law_start[k + 1]
    return slice(lo, hi), slice(3 * lo, 3 * hi)


def look(c: Contacts) -> None:
    """Ask stiffening laws for their tangents after `forces`; see whether the stable step is still right."""
    for k in c._curved:
        law, lo, hi = c.laws[k], c._law_start[k], c._law_start[k + 1]
        law.closure(3 * lo, 3 * hi, c._gap, c.patches.prop, law.props, c._memory, c._response)
        c.stiffer |= bool(response.changed(c._area, c._active, c._response, c._bound, lo, hi, GROWTH))


def pace(c: Contacts, xdot: Array, change: Array) -> Array:
    """Step (n_blocks,) [s] in which blocks close stiffening contacts as far as a step may.

    Parameters
    ----------
    xdot, change : (n_gp, 3) array
        The velocities are ``xdot + change t`` for a step t [m/s, m/s^2].
    """
    p, out = c.patches, np.full(c.surfaces.n_blocks, np.inf)
    active = c._active if c._trial else p.active_old
    for k in c._curved:
        lo, hi = c._law_start[k], c._law_start[k + 1]
        response.pace(
            p.gp, p.w_clip, c._closed[3], active, c._gap, c._response, c._kn, c.laws[k].reach, p.prop, c.slave,
            c.master, p.pair, SHARE, xdot, change, lo, hi, out,
        )  # fmt: skip
    return out


def stored(c: Contacts, memory: Array, active: Any) -> float:
    """Elastic energy [J] of all contacts with the history `memory` at the gaps and areas of the last `forces`.

    With ``p = kn depth`` exact for every overlap of polyhedra (kernels/energy.py); with other laws without what passes
    through the walls between cells, which matters while an edge or corner of the master is overlapped.
    """
    total = stored_in_corners(c) + _through_walls(c, active)
    for k, law in enumerate(c.laws):
        lo, hi = c._law_start[k], c._law_start[k + 1]
        if hi == lo:
            continue
        if law.closure is None:
            total += kernels.stored_energy(c._area, c._gap, c._facing, memory, c._kn, c._ks, active, lo, hi)
        else:
            law.closure(3 * lo, 3 * hi, c._gap, c.patches.prop, law.props, memory, c._response)
            total += response.stored(c._area, c._facing, memory, c._ks, active, c._response, lo, hi)
    return float(total)


def _through_walls(c: Contacts, active: Any) -> float:
    """Energy [J] that passes through the walls between the cells of masters."""
    p = c.patches
    if c._partner is None:
        c._partner = np.full(len(p.corners), -1, dtype=np.int32)
        order = np.lexsort((p.face_s, p.pair)).astype(np.int32)
        if ((np.diff(p.pair[order]) == 0) & (np.diff(p.face_s[order]) == 0)).any():
            energy.partners(order, p.pair, p.face_s, p.flags, p.start, p.corners, c._partner)
        c._walled = bool((c._partner >= 0).any())
    if not c._walled:
        return 0.0
    kn = c._kn
    for k, law in enumerate(c.laws):
        if law.closure is not None and c._law_start[k + 1] > c._law_start[k]:
            kn = np.where(p.law == k, 0.0, kn)
    return float(
        energy.wall_energy(p.start, p.corners, c._partner, p.metric, c._depth, c._push, c._face_normal, kn, active)
    )


def slip_energies(c: Contacts) -> Array:
    """Energy (n_patches,) [J] of the last committed state that lives in the history: what a cut may lose."""
    p = c.patches
    length = (p.memory_old[:, :3] ** 2).sum(axis=1)
    energies: Array = 0.5 * c._ks * (c._area * length).reshape(-1, 3).sum(axis=1) * (p.active_old > 0)
    if c._corner is not None:
        energies *= c._corner[6][p.pair]
    return energies + held_energy(c.laws, p)


def held_energy(laws: Any, p: Patches) -> Array:
    """Energy (n,) [J] in the history of patches, that of slip left out."""
    energies = np.zeros(len(p))
    for k, law in enumerate(laws):
        mine = np.flatnonzero(p.law == k)
        if law.closure is None or not len(mine):
            continue
        memory = np.ascontiguousarray(p.memory_old.reshape(len(p), 3, -1)[mine].reshape(3 * len(mine), -1))
        each = law.respond(np.zeros(3 * len(mine)), np.ascontiguousarray(p.prop[mine]), memory)[:, 3]
        energies[mine] = each.reshape(-1, 3).sum(axis=1) * (p.active_old[mine] > 0)
    return energies
