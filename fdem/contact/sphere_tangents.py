"""Tangent of the contacts of spheres at the last trial: every contact on its own, by differences."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.kernels import couples, spheres

if TYPE_CHECKING:
    from fdem.contact.spheres import SphereContacts

__all__ = ["tangent"]

Array = NDArray[np.float64]
Entries = tuple[Any, Any, Array]

CHANGE = 1e-7  # of the radius, and of a radian: small change that derivatives are taken over


def tangent(c: SphereContacts, n_gp: int) -> Entries:
    """Derivatives of forces and moments by positions and rotations, as (row, column, value).

    Parameters
    ----------
    c : SphereContacts
        After `forces` at the same positions.
    n_gp : int
        Gridpoints of the model.

    Returns
    -------
    rows, columns : (n,) int arrays
        ``3 gp + axis`` of positions; ``3 n_gp + dof`` of rotations.
    values : (n,) array
        [N/m, N, N m].

    Notes
    -----
    How a face that moves tilts the contact is left out: of the order of the overlap over the radius.
    """
    parts = [_pairs(c, n_gp), _faces(c, n_gp)]
    rows, columns, values = (np.concatenate([part[k] for part in parts]) for k in range(3))
    return rows, columns, values


def _unknowns(c: SphereContacts, particle: Any, n_gp: int) -> Any:
    """Places (n, 6) of position and rotation of particles; -1: it does not turn."""
    p = c.particles
    straight = 3 * p.gp[particle].astype(np.int64)[:, None] + np.arange(3)
    spin = p.spin[particle][:, None]
    return np.hstack([straight, np.where(spin >= 0, 3 * n_gp + spin + np.arange(3), -1)])


def _entries(rows: Any, columns: Any, blocks: Array) -> Entries:
    """Entries of blocks (n, a, b) at rows (n, a) and columns (n, b); places below 0 are left out."""
    r, k = np.broadcast_to(rows[:, :, None], blocks.shape), np.broadcast_to(columns[:, None, :], blocks.shape)
    there = (r >= 0) & (k >= 0) & (blocks != 0.0)
    return r[there], k[there], blocks[there]


def _pairs(c: SphereContacts, n_gp: int) -> Entries:
    """Pairs of spheres: each is copied to a pair of its own, so that all are changed at once."""
    closed = np.flatnonzero(c.trial_roots() > 0.0)
    m = len(closed)
    packed = np.repeat(np.arange(len(c.order)), c.counts())
    sides = np.column_stack([packed[closed], c.partner[closed].astype(np.int64)])
    place, motion = c.place[sides.ravel()], c.motion[sides.ravel()]
    start = np.repeat(np.arange(m + 1), 2)[1:].astype(np.uint32)
    partner = (2 * np.arange(m) + 1).astype(np.uint32)
    kind, old = c.kind[closed].copy(), c.memory[closed].copy()
    held = c.held[closed].copy() if len(c.held) else c.held

    def forces(place: Array, motion: Array) -> Array:
        force, memory, record, out = np.zeros((2 * m, 6)), np.zeros_like(old), np.zeros((m, 4)), np.zeros(5)
        rows = c.table.rows
        spheres.pair_forces(place, motion, start, partner, kind, rows, old, memory, c._dt, force, record, out)
        if len(held):
            new, work = np.zeros_like(held), np.zeros(1)
            couples.pair_couples(
                place, motion, start, partner, kind, rows, old, memory, record, held, new, force, work
            )  # fmt: skip
        return force.reshape(m, 12)

    blocks, base = np.zeros((m, 12, 12)), forces(place, motion)
    for k in range(12):
        own = np.arange(k // 6, 2 * m, 2)
        step = _step(place[own], motion[own], k % 6)
        blocks[:, :, k] = (forces(*_moved(place, motion, own, k % 6, step)) - base) / step[:, None]
    unknowns = np.hstack([_unknowns(c, c.order[sides[:, k]], n_gp) for k in range(2)])
    return _entries(unknowns, unknowns, blocks)


def _faces(c: SphereContacts, n_gp: int) -> Entries:
    """Spheres on faces, each with one of its faces: the sphere is moved, and the face answers the other way."""
    f = c.faces
    closed = np.flatnonzero(f.active) if len(f.at) else np.zeros(0, int)
    m = len(closed)
    base = f.geometry[closed].copy()
    at = np.arange(m)
    none, source = np.ones(m, np.uint8), f.source[closed].copy()
    kind, reach = f.slot_kind[closed].copy(), base[:, 3] + base[:, 8]

    def forces(k: int, step: Array) -> Array:
        geometry = base.copy()
        n, arm = base[:, :3], base[:, 8]
        if k < 3:  # the overlap, the motion at the contact; a point that stays turns the normal
            across = (np.eye(3)[k] - n[:, k, None] * n) * (step / arm)[:, None]
            geometry[:, 3] += step * n[:, k]
            geometry[:, 4 + k] += step
            geometry[:, 8] = reach - geometry[:, 3]
            geometry[:, :3] -= across * edge[:, None]
        elif k < 6:
            turn = step[:, None] * np.eye(3)[k - 3]
            geometry[:, 4:7] += arm[:, None] * np.cross(turn, n)
            geometry[:, 7] += 0.5 * (turn * n).sum(axis=1)
            geometry[:, 9:12] += turn
        force, push, record, out = np.zeros((m, 6)), np.zeros((m, 3)), np.zeros((m, 4)), np.zeros(5)
        memory, rows = np.zeros((m, 9)), c.table.rows
        spheres.face_forces(
            at, none, geometry, kind, rows, f.memory, source, memory, c._dt, force, push, record, out
        )  # fmt: skip
        if len(f.held):
            new, couple, work = np.zeros((len(f.held), 6)), np.zeros((m, 3)), np.zeros(1)
            couples.face_couples(
                at, none, geometry, kind, rows, f.memory, source, memory, record, f.held, new, force, couple, work
            )  # fmt: skip
        return force

    face = f.face[f.candidate[closed]]
    edge = (np.abs(np.einsum("ni,ni->n", base[:, :3], f.normal[face])) < 1.0 - 1e-9).astype(float)
    blocks, rest = np.zeros((m, 6, 6)), forces(-1, np.zeros(m))
    for k in range(6):
        step = np.where(base[:, 4 + k % 3] < 0.0, -CHANGE, CHANGE) * (reach if k < 3 else 1.0)
        blocks[:, :, k] = (forces(k, step) - rest) / step[:, None]
    own = _unknowns(c, c.order[f.slot_at[closed]], n_gp)
    corners = 3 * f.ref[face].astype(np.int64)[:, :, None] + np.arange(3)
    weight = f.weight[closed]
    corners = np.where(f.mobile[face][:, None, None] > 0, corners, -1).reshape(m, 9)
    there = np.concatenate([own, corners], axis=1)
    spread = np.concatenate([np.broadcast_to(np.eye(6), (m, 6, 6)), np.zeros((m, 9, 6))], axis=1)
    for corner in range(3):
        spread[:, 6 + 3 * corner : 9 + 3 * corner, :3] = -weight[:, corner, None, None] * np.eye(3)
    return _entries(there, there, spread @ blocks @ np.swapaxes(spread, 1, 2))


def _step(place: Array, motion: Array, k: int) -> Array:
    """Small change (n,) of unknown `k` of spheres, the way they move."""
    size = CHANGE * (place[:, 3] if k < 3 else 1.0)
    return np.where(motion[:, k] < 0.0, -size, size)


def _moved(place: Array, motion: Array, own: Any, k: int, step: Array) -> tuple[Array, Array]:
    """Copies with unknown `k` of the spheres `own` changed by `step`."""
    place, motion = place.copy(), motion.copy()
    if k < 3:
        place[own, k] += step
    motion[own, k] += step
    return place, motion
