"""Contacts whose forces are found at rates of their own: every 2^level steps, by the slower-paced block of a pair."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.contacts import Contacts

__all__ = ["Rated"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_PATCHES = (
    "_thick", "_inverse", "_kn", "_ks", "_brittle", "_bound", "_cluster", "_points", "_active", "_push", "_facing",
    "_foot", "_lost", "_depth", "_face_normal",
)  # fmt: skip
_ROWS = (
    "_memory_start", "_memory", "_w", "_gap", "_area", "_align", "_normal", "_slip", "_mass", "_traction", "_work",
    "_state", "_arm", "_response",
)  # fmt: skip


class Rated(Contacts):
    """Contacts, the patches of which are worked on in parts: those of pairs of one level.

    Parameters
    ----------
    contacts : Contacts
        Taken over; not to be used on its own any more.

    Attributes
    ----------
    level : (n_blocks,) int array
        Forces of a pair are found every ``2^level`` steps, with the smaller level of its blocks.
    x_before : dict of (n_gp, 3) arrays
        Positions at the last commit of every level but the lowest, which follows every step [m].

    Notes
    -----
    Everything else (detection, history, reading) sees one table of patches; parts are slices of its arrays. Where two
    laws meet in one pair, dashpots and friction normals see the patches of their own law.
    """

    def __init__(self, contacts: Contacts) -> None:
        self.__dict__.update(contacts.__dict__)
        self.level: Ints = np.zeros(self.surfaces.n_blocks, dtype=np.int64)
        self.x_before: dict[int, Array] = {}
        self._acted: dict[int, Array] = {}
        self._split()

    def grade(self, level: Any, x: Array) -> None:
        """Give blocks the rates `level` (n_blocks,); all motion up to `x` (n_gp, 3) [m] is committed."""
        self.energy()  # the arrays it reads are about to go
        self.level = np.array(level, dtype=np.int64)
        self.x_before = {k: x.copy() for k in range(1, int(self.level.max(initial=0)) + 1)}
        p = self.patches
        self.patches = p.take(self._order(p.face_s, p.face_m, p.pair, p.law))
        self._prepare()

    def resume(self, level: Any, x_before: dict[int, Array]) -> None:
        """Go on with the rates and positions of a saved state, whose patches are there already."""
        self.level, self.x_before = np.array(level, dtype=np.int64), x_before
        self._split()

    def act(self, level: int, x: Array, x_old: Array, dt: float, f_gp: Array) -> None:
        """Add the forces of the pairs of `level` alone; see `Contacts.forces`.

        `x_old` is for the lowest level, whose last commit was the last step; the others know their own.
        """
        for part in self._parts.get(level, ()):
            part.forces(x, self.x_before.get(level, x_old), dt, f_gp)
        self._acted[level] = x
        self._trial, self._filled = True, True

    def commit(self) -> None:
        """Make the trials since the last commit the history, and add their dissipation to `work`."""
        for level, x in self._acted.items():
            for part in self._parts.get(level, ()):
                part.commit()
            if level:
                np.copyto(self.x_before[level], x)
        self._acted.clear()
        self._trial, self._stored = False, None

    def _order(self, face_s: Any, face_m: Any, pair: Any, law: Any) -> Any:
        return np.lexsort((face_s, face_m, pair, self._levels()[pair], law))

    def _levels(self) -> Ints:
        """Levels (n_pairs,) of the pairs."""
        return np.minimum(self.level[self.slave], self.level[self.master])

    def _prepare(self) -> None:
        super()._prepare()
        self._split()

    def _split(self) -> None:
        """Cut the table of patches into runs of one law and one level."""
        p = self.patches
        level = self._levels()[p.pair]
        change = np.flatnonzero((np.diff(p.law) != 0) | (np.diff(level) != 0)) + 1
        bounds = np.concatenate([[0], change, [len(p)]]).astype(int).tolist() if len(p) else [0]
        self._parts: dict[int, list[_Part]] = {}
        for lo, hi in pairwise(bounds):
            self._parts.setdefault(int(level[lo]), []).append(_Part(self, lo, hi))


class _Part(Contacts):
    """The patches lo..hi of a table, all of one law, in the same memory."""

    def __init__(self, whole: Contacts, lo: int, hi: int) -> None:
        self.__dict__.update(whole.__dict__)
        for name in _PATCHES:
            setattr(self, name, getattr(whole, name)[lo:hi])
        for name in _ROWS:
            setattr(self, name, getattr(whole, name)[3 * lo : 3 * hi])
        self.patches = whole.patches.part(lo, hi)
        law = int(self.patches.law[0])
        self._law_start = [0] * (law + 1) + [hi - lo] * (len(self.laws) - law)
        self._bundle()

    def _keep(self) -> None:
        """Copy: arrays of the whole table must stay where they are."""
        p = self.patches
        np.copyto(p.memory_old, self._memory)
        np.copyto(p.points_old, self._points)
        np.copyto(p.active_old, self._active)
