"""Faces of blocks as spheres meet them: which spheres are near which faces, and what history they have."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.surface import Surfaces
from fdem.kernels import facets as kernels

__all__ = ["FaceContacts", "Facets"]

Array = NDArray[np.float64]

SLOTS = 4  # contacts of one sphere with one block


class Facets:
    """All faces of all blocks: their boxes and planes when they are looked for.

    Parameters
    ----------
    surfaces : Surfaces
    mobile : (n_blocks,) bool array
        Which blocks can move.
    """

    def __init__(self, surfaces: Surfaces, mobile: Any) -> None:
        self.surfaces = surfaces
        self.ref = np.ascontiguousarray(surfaces.ref[:, :3])
        self.block = surfaces.face_block
        self.mobile = np.ascontiguousarray(mobile[self.block])
        self.moving_gp = np.unique(self.ref[self.mobile])
        self.corner_x = np.zeros((len(surfaces.corner_w), 3))
        self.normal = np.zeros((len(self.ref), 3))
        self.lower, self.upper = np.zeros((2, len(self.ref), 3))
        self.point = np.zeros((len(self.ref), 3))

    def place(self, x: Array) -> None:
        """Bring boxes and planes to the positions `x` [m]."""
        s = self.surfaces
        kernels.place_faces(self.ref, s.corner_start, s.corner_w, x, self.corner_x, self.normal)
        first = s.corner_start[:-1]
        self.lower = np.minimum.reduceat(self.corner_x, first, axis=0)
        self.upper = np.maximum.reduceat(self.corner_x, first, axis=0)
        self.point = np.ascontiguousarray(self.corner_x[first])


@dataclass
class FaceContacts:
    """Groups of candidate faces, one per sphere and block, and rows for up to four contacts of each.

    Attributes
    ----------
    at, block : (n,) int64
        Packed place of the sphere, and block of the faces.
    start : (n + 1,) int64
        Candidates of a group.
    face : (m,) int64
        Face of each candidate, in the numbering of `used`.
    used : (k,) int64
        Faces that are candidates at all.
    rule : (m,) int32
        Joint rule of each candidate.
    slot_start : (n + 1,) int64
        Rows of a group.
    memory, held : (n_rows, 9), (n_rows, 6) or (0, 6)
        Committed history of the springs (kernels/spheres.py) and of the couples (kernels/couples.py), if there are any.
    """

    at: NDArray[np.int64]
    block: NDArray[np.int64]
    start: NDArray[np.int64]
    face: NDArray[np.int64]
    used: NDArray[np.int64]
    rule: NDArray[np.int32]
    slot_start: NDArray[np.int64]
    memory: Array
    held: Array
    kind: NDArray[np.uint32] = field(default_factory=lambda: np.zeros(0, np.uint32))

    @classmethod
    def group(cls, who: Any, which: Any, face_block: Any, couples: bool) -> FaceContacts:
        """Groups from candidates: packed place of the sphere and face (m,) each, in any order."""
        n_faces = max(len(face_block), 1)
        key = np.sort(np.asarray(who, dtype=np.int64) * n_faces + which)
        at, face = key // n_faces, key % n_faces
        block = face_block[face].astype(np.int64)
        fresh = np.ones(len(key), dtype=bool)
        fresh[1:] = (at[1:] != at[:-1]) | (block[1:] != block[:-1])
        first = np.flatnonzero(fresh)
        start = np.append(first, len(key))
        used, face = np.unique(face, return_inverse=True)
        slots = np.concatenate([[0], np.cumsum(np.minimum(np.diff(start), SLOTS))])
        return cls(
            at[first], block[first], start, face.ravel(), used, np.zeros(len(key), np.int32), slots,
            np.zeros((int(slots[-1]), 9)), np.zeros((int(slots[-1]) if couples else 0, 6)),
        )  # fmt: skip

    def prepare(self, facets: Facets, x: Array) -> None:
        """Allocate what `touch` writes, and bring the faces to the positions `x`."""
        s = facets.surfaces
        n = len(self.memory)
        self.ref = np.ascontiguousarray(facets.ref[self.used])
        lo, hi = s.corner_start[self.used], s.corner_start[self.used + 1]
        self.corner_start = np.concatenate([[0], np.cumsum(hi - lo)]).astype(np.int64)
        rows = np.arange(int(self.corner_start[-1])) + np.repeat(lo - self.corner_start[:-1], hi - lo)
        self.corner_w = np.ascontiguousarray(s.corner_w[rows])
        self.corner_x, self.normal = np.zeros((len(rows), 3)), np.zeros((len(self.used), 3))
        self.side, self.across = np.zeros_like(self.corner_x), np.zeros((len(self.used), 6))
        self.mobile = np.ascontiguousarray(facets.mobile[self.used])
        self.moves = bool(self.mobile.any())
        self.slot_at = np.repeat(self.at, np.diff(self.slot_start))
        self.trial, self.trial_held = np.zeros_like(self.memory), np.zeros_like(self.held)
        self.couple = np.zeros((len(self.held), 3))
        self.active, self.source = np.zeros(n, np.uint8), np.full(n, -1, np.int64)
        self.geometry, self.push, self.record = np.zeros((n, 12)), np.zeros((n, 3)), np.zeros((n, 4))
        self.slot_kind, self.candidate = np.zeros(n, np.uint32), np.zeros(n, np.int64)
        self.weight = np.zeros((n, 3))
        self.lost = np.zeros(1)
        self.put(x)

    def put(self, x: Array) -> None:
        """Bring the faces to the positions `x` [m]."""
        kernels.place_faces(self.ref, self.corner_start, self.corner_w, x, self.corner_x, self.normal)
        kernels.frame_faces(self.ref, self.corner_start, self.corner_x, self.normal, x, self.side, self.across)

    def touch(self, place: Array, motion: Array, x: Array, x_old: Array) -> None:
        """Find the contacts in the positions `x`; `lost` is the energy [J] of shear springs that ended."""
        if self.moves:
            self.put(x)
        self.lost[0] = 0.0
        kernels.touch(
            self.at, self.start, self.face, self.kind, self.slot_start, place, motion, self.ref, self.mobile,
            self.corner_start, self.corner_x, self.normal, self.side, self.across, x, x_old, self.memory, self.active,
            self.geometry, self.slot_kind, self.source, self.candidate, self.weight, self.lost,
        )  # fmt: skip

    def commit(self) -> None:
        """Make the trial history the committed one."""
        self.memory, self.trial = self.trial, self.memory
        self.held, self.trial_held = self.trial_held, self.held

    def inherit(self, old: FaceContacts, at_old: Any, n_blocks: int, block: Any = None) -> None:
        """Take the history of groups that were there before.

        Parameters
        ----------
        old : FaceContacts
            Before.
        at_old : (n_particles,) int array
            Place in the old order of the particle at each packed place; -1: it was not there.
        n_blocks : int
            Number of blocks.
        block : (n_old_blocks,) int array, optional
            New number of every old block; None: the same.
        """
        before = old.block if block is None else np.asarray(block)[old.block]
        mine, theirs = at_old[self.at] * np.int64(n_blocks) + self.block, old.at * np.int64(n_blocks) + before
        mine[at_old[self.at] < 0] = -1
        theirs[before < 0] = -2
        _, here, there = np.intersect1d(mine, theirs, return_indices=True)
        for k in range(SLOTS):
            target, source = self.slot_start[here] + k, old.slot_start[there] + k
            both = (target < self.slot_start[here + 1]) & (source < old.slot_start[there + 1])
            self.memory[target[both]] = old.memory[source[both]]
            if len(self.held) and len(old.held):
                self.held[target[both]] = old.held[source[both]]

    def spread(self, f_gp: Array) -> None:
        """Add the forces on faces to their gridpoints [N]."""
        kernels.spread(self.active, self.candidate, self.weight, self.face, self.ref, self.push, f_gp)
