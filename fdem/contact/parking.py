"""Contacts of blocks that sleep: taken out of the work of a step, with all they remember, until a block wakes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact import startup
from fdem.contact.contacts import Contacts
from fdem.contact.narrow import Ghosts, Patches
from fdem.contact.wear import worn_pairs
from fdem.kernels import patches, sleep, upkeep

__all__ = ["Parking", "patches_of", "sleepers", "whole"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_KEPT = ("asleep", "force", "reference", "limit", "mark", "since")


class Parking(Contacts):
    """Contacts that can put pairs of sleeping blocks aside; `patches` and `pairs` are those of the others.

    Parameters
    ----------
    contacts : Contacts
        Taken over; not to be used on its own any more.
    x, x_old : (n_gp, 3) array
        Positions now and at the last commit, as the state holds them [m].
    gp_block : (n_gp,) int array
        Block of every gridpoint.
    static : (n_blocks,) bool array
        Blocks that nothing moves, not even as prescribed.

    Attributes
    ----------
    asleep : (n_blocks,) bool array
        Blocks that sleep.
    gps : (n,) int array
        Their gridpoints.
    force : (n_gp, 3) array
        Forces of parked contacts on gridpoints [N]; they are added without being computed again.
    reference, limit : (n_gp, 3), (n_blocks,) array
        Forces when blocks fell asleep, and the change of them that wakes a block [N].
    mark, since : (n_gp, 3), (n_blocks,) array
        From where [m], and from which step on (-1: not yet), the motion of blocks is watched.
    changed : callable
        Called when `asleep` has changed.

    Notes
    -----
    Sleeping blocks do not move, so parked contacts stay as they are: memory, energy and force. A pair is parked if each
    of its blocks sleeps or is static. Detection neither looks for such pairs nor cuts them anew.
    """

    def __init__(self, contacts: Contacts, x: Array, x_old: Array, gp_block: Any, static: Mask) -> None:
        self.__dict__.update(contacts.__dict__)
        n = self.surfaces.n_blocks
        self._x, self._x_old, self._gp_block, self._static = x, x_old, gp_block, static
        self._allowed = contacts.may_touch
        self.may_touch = self._may_touch
        self.asleep: Mask = np.zeros(n, dtype=bool)
        self.force, self.reference, self.limit = np.zeros_like(x), np.zeros_like(x), np.zeros(n)
        self.mark, self.since = x.copy(), np.full(n, -1)
        self.changed: Callable[[], None] = _ignore
        self._change, self._last_dt = np.zeros(n), 0.0
        self._clear()

    def _clear(self) -> None:
        """Nothing is parked."""
        self.gps = np.zeros(0, dtype=np.int64)
        self._set_aside(np.zeros((0, 2), np.int32), Patches.none(self.n_memory), Ghosts(), np.zeros(0))

    def _set_aside(self, *parts: Any) -> None:
        """Park these pairs, patches, near misses and bounds."""
        self._parked = self._view(*parts)
        self._parked_rows: Any = None
        self._parked_k: Array | None = None
        self.force[:] = 0.0
        self._parked.forces(self._x, self._x, 0.0, self.force)
        self._parked._bound[:] = parts[3]

    # ---- what a step needs

    def forces(self, x: Array, x_old: Array, dt: float, f_gp: Array) -> None:
        """Add the forces of all contacts, parked ones as they were; see `Contacts.forces`."""
        self._last_dt = dt
        if len(self.gps):
            f_gp += self.force
        super().forces(x, x_old, dt, f_gp)

    def _may_touch(self, a: Any, b: Any) -> Any:
        held = self.asleep | self._static
        mask = ~(held[a] & held[b])
        return mask if self._allowed is None else mask & np.asarray(self._allowed(a, b), dtype=bool)

    # ---- rest and waking

    def largest(self, values: Array, origin: Array | None = None) -> Array:
        """Largest length of `values` (n_gp, 3), less `origin`, at a gridpoint of every block (n_blocks,)."""
        out = np.zeros(len(self.asleep))
        sleep.largest(self._gp_block, values, np.zeros_like(values) if origin is None else origin, out)
        return out

    def restart(self, blocks: Mask, step: int) -> None:
        """Watch the motion of `blocks` (n_blocks,) from here on."""
        mine = blocks[self._gp_block]
        self.mark[mine], self.since[blocks] = self._x[mine], step

    def resting(self, ready: Mask, mobile: Mask) -> Mask:
        """Blocks of islands (mobile blocks that hang together by closed contacts) all of which are `ready`."""
        label = _islands(mobile & ~self.asleep, self.pairs, self.patches)
        restless = np.zeros(len(ready), dtype=bool)
        restless[label[mobile & ~self.asleep & ~ready]] = True
        out: Mask = ready & ~restless[label]
        return out

    def park(self, blocks: Mask) -> bool:
        """Let `blocks` (n_blocks,), at rest after a commit, fall asleep; whether contacts were detected again for that.

        All motion up to now is then known to detection, so that it need not look at parked pairs, nor when they return.
        """
        x, s, moved = self._x, self.surfaces, np.zeros(len(blocks))
        upkeep.block_motion(s.movers, s.surface_gp, s.surface_start, x, self.x_ref, moved)
        far = moved > 0.25 * self._skins
        held = self.asleep | self._static | blocks
        due = bool((far & blocks).any() or worn_pairs(self, x)[held[self.pairs].all(axis=1)].any())
        if due:
            self._redo(x, far)
        mine = blocks[self._gp_block]
        self.x_check[mine] = x[mine]
        self._split(self.asleep | blocks)
        return due

    def pushes(self) -> Array:
        """Contact forces (n_gp, 3) [N] on gridpoints at the last commit."""
        out, p = self.force.copy(), self.patches
        if len(p):
            patches.scatter(p.gp, p.active_old, self._w, self._area, self._push, self._foot, self._traction, out)
        return out

    def remember(self, blocks: Mask, f: Array, limit: Array) -> None:
        """Keep the forces `f` (n_gp, 3) [N] on `blocks`; a change by more than `limit` (n_blocks,) wakes them."""
        mine = blocks[self._gp_block]
        self.reference[mine], self.limit[blocks] = f[mine], limit[blocks]

    def disturbed(self, f: Array) -> Mask | None:
        """Islands of sleepers (n_blocks,) one of whose blocks feels forces `f` (n_gp, 3) [N] that changed; or None."""
        sleep.changes(self.gps, self._gp_block, f, self.reference, self._change)
        felt = self._change > self.limit
        if not felt.any():
            return None
        label = _islands(self.asleep, self._parked.pairs, self._parked.patches)
        out: Mask = self.asleep & np.isin(label, label[felt])
        return out

    def wake(self, blocks: Mask, step: int) -> None:
        """Bring the contacts of `blocks` (n_blocks,) back, at the step `step`."""
        self.restart(blocks, step)
        self._split(self.asleep & ~blocks)

    def _split(self, asleep: Mask) -> None:
        """Park the pairs of blocks that sleep or are static, and no others."""
        merged = self._merged()
        self.asleep, held = asleep, asleep | self._static
        self.gps = np.flatnonzero(asleep[self._gp_block])
        self._change[:] = 0.0
        away = held[merged[0]].all(axis=1)
        self._set_aside(*_part(*merged, away))
        _take(self, *_part(*merged, ~away))
        self.changed()

    def _merged(self) -> tuple[Any, Patches, Ghosts, Array]:
        """All pairs, patches, near misses and bounds in the order of `Contacts`."""
        parked, ghosts = self._parked.patches, self._parked.ghosts
        both = np.concatenate([self.pairs, self._parked.pairs])
        order = np.lexsort((both[:, 1], both[:, 0]))
        number = np.empty(len(order), np.int32)
        number[order] = np.arange(len(order), dtype=np.int32)
        n = len(self.pairs)
        p = Patches.join(self.patches, parked)
        p.pair = np.concatenate([number[self.patches.pair], number[n + parked.pair]])
        g = Ghosts.join(self.ghosts, ghosts)
        g.pair = np.concatenate([number[self.ghosts.pair], number[n + ghosts.pair]])
        place = np.lexsort((p.face_s, p.face_m, p.pair, p.law))
        bound = np.concatenate([self._bound, self._parked._bound])[place]
        return np.ascontiguousarray(both[order]), p.take(place), g, bound

    # ---- reading: everything, as if nothing were parked

    def _view(self, *parts: Any) -> Contacts:
        """Contacts of their own with other pairs, patches, near misses and bounds, to be read."""
        view = Contacts.__new__(Contacts)
        view.__dict__.update(self.__dict__)
        view.__dict__.pop("_parked", None)
        _take(view, *parts)
        return view

    def whole(self) -> Contacts:
        """All contacts with the present forces, to be read."""
        if not len(self.gps):
            return self
        view = self._view(*self._merged())
        bound = view._bound.copy()
        view.forces(self._x, self._x_old, self._last_dt, np.zeros_like(self._x))
        view._bound[:] = bound
        return view

    @property
    def n_patches(self) -> int:
        """Number of patches, open and parked ones included."""
        return len(self.patches) + len(self._parked.patches)

    def stiffness(self, x: Array) -> Any:
        """Rows of all whole patches, parked ones included: the step must hold when blocks wake."""
        rows: tuple[Any, ...] = super().stiffness(x)
        if not len(self._parked.patches):
            return rows
        if self._parked_rows is None:
            self._parked_rows = self._parked.stiffness(x)
        return tuple(np.concatenate([a, b]) for a, b in zip(rows, self._parked_rows, strict=True))

    def potential_k_gp(self, x: Array, mobile: Any) -> Array:
        """Upper bound of the stiffness of all contacts per gridpoint (n_gp,) [N/m], parked ones included."""
        if self._parked_k is None:
            self._parked_k = self._parked.potential_k_gp(x, mobile)
        return super().potential_k_gp(x, mobile) + self._parked_k

    def table(self, x: Array) -> dict[str, Any]:
        """Contact table of all contacts; see `Contacts.table`."""
        return Contacts.table(self.whole(), x)

    def state_arrays(self) -> dict[str, Array]:
        """Everything that influences the next step, as copies."""
        kept: dict[str, Array] = {f"park_{name}": getattr(self, name).copy() for name in _KEPT}
        return startup.state_arrays(self.whole()) | kept

    def restore(self, arrays: dict[str, Any]) -> None:
        """Take back what `state_arrays` returned, or what contacts without sleeping blocks did."""
        self._clear()
        super().restore(arrays)
        if "park_asleep" not in arrays:
            self.asleep = np.zeros_like(self.asleep)
            self.since[:] = -1
            self.changed()
            return
        if arrays["park_asleep"].any():
            self._split(np.array(arrays["park_asleep"]))
        for name in _KEPT[1:]:
            getattr(self, name)[:] = arrays[f"park_{name}"]


def _ignore() -> None:
    """Nobody wants to know."""


def _take(c: Contacts, pairs: Any, patches: Patches, ghosts: Ghosts, bound: Array) -> None:
    """Let `c` work on these pairs, patches and near misses."""
    c.pairs = pairs
    c._orient()
    c.patches, c.ghosts = patches, ghosts
    c._prepare()
    c._bound[:] = bound
    c._stored = None if len(patches) else 0.0


def _part(pairs: Any, patches: Patches, ghosts: Ghosts, bound: Array, chosen: Mask) -> Any:
    """The share of the pairs `chosen` (n_pairs,)."""
    number = (np.cumsum(chosen) - 1).astype(np.int32)
    mine = chosen[patches.pair]
    p, g = patches.take(np.flatnonzero(mine)), ghosts.without(~chosen)
    p.pair, g.pair = number[p.pair], number[g.pair]
    return np.ascontiguousarray(pairs[chosen]), p, g, bound[mine]


def _islands(chosen: Mask, pairs: Any, patches: Patches) -> Any:
    """Number (n_blocks,) of the island of every block: `chosen` blocks that hang together by closed contacts."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ends = pairs[np.unique(patches.pair[patches.active_old > 0])]
    a, b = ends[chosen[ends].all(axis=1)].T
    n = len(chosen)
    return connected_components(coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(n, n)), directed=False)[1]


def whole(c: Contacts) -> Contacts:
    """All contacts of `c`, also those that are parked, to be read."""
    return c.whole() if isinstance(c, Parking) else c


def patches_of(c: Contacts) -> list[Patches]:
    """The patches `c` works on, and those that are parked."""
    return [c.patches, c._parked.patches] if isinstance(c, Parking) else [c.patches]


def sleepers(c: Contacts | None) -> str:
    """What `describe` says about sleeping."""
    if not isinstance(c, Parking):
        return "sleeping: left out, not asked for"
    asleep, parked = int(c.asleep.sum()), len(c._parked.patches)
    return f"sleeping: {asleep} of {len(c.asleep)} blocks sleep now, {parked} of {c.n_patches} patches are parked"
