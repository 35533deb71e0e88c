"""Sparse matrices of formulations for implicit methods: (row, column, value) of the unknowns of the whole model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fdem.blocks import recovery

if TYPE_CHECKING:
    from fdem.blocks.zoned import ZonedBlocks

__all__ = [
    "Additive",
    "Entries",
    "Stiff",
    "nothing",
    "of_arms",
    "of_blocks",
    "of_pairs",
    "same",
    "turn",
    "turn_on",
    "zone_mass",
]

Array = Any
Entries = tuple[Array, Array, Array]


class Kicked:
    """Batches that know their accelerations."""

    dofs: slice
    accelerate: Any

    def kick(self, q: Array, f: Array, v: Array, h: float, a: Array, scaled: Array | None = None) -> None:
        """Add the accelerations over `h` [s] to the velocities `v`; `a` (n_dofs,) is room for them."""
        self.accelerate(q, f, a, scaled)
        own = a[self.dofs]
        own *= h
        v[self.dofs] += own


class Additive(Kicked):
    """Batches whose unknowns add up: placement and mass are constant."""

    coords: slice
    width = 3  # unknowns that belong together
    steady = True  # the mass does not depend on q

    def groups(self) -> Array:
        """Unknowns (m, width) that belong together: those of a block, or of a gridpoint."""
        return np.arange(self.dofs.start, self.dofs.stop).reshape(-1, self.width)

    def theory(self, row: int, q: Array) -> Array | None:
        """None: the unknowns are the theory's."""
        return None

    def shift(self, q: Array, d: Array) -> None:
        """Move `q` by the increment `d` (n_dofs,)."""
        q[self.coords] += d[self.dofs]

    def compose(self, d: Array, change: Array) -> None:
        """Let the increment `d` (n_dofs,) be that of `d` and then `change`."""
        d[self.dofs] += change[self.dofs]

    def gyroscopic(self, q: Array, v: Array, f: Array) -> None:
        """Nothing: the mass is constant."""

    def geometric(self, q: Array, f_gp: Array) -> Entries:
        """Nothing: the placement is constant."""
        return nothing()


class Stiff(Kicked):
    """Batches without internal forces: six unknowns a block, translation and rotation."""

    oriented = True  # rotations are kept; else they are angles rolled, which add up

    def groups(self) -> Array:
        """Unknowns (n_blocks, 6) that belong together: those of every block."""
        return np.arange(self.dofs.start, self.dofs.stop).reshape(-1, 6)

    def compose(self, d: Array, change: Array) -> None:
        """Let the increment `d` (n_dofs,) be that of `d` and then `change`."""
        own, more = d[self.dofs].reshape(-1, 6), change[self.dofs].reshape(-1, 6)
        own[:, :3] += more[:, :3]
        own[:, 3:] = turn_on(own[:, 3:], more[:, 3:]) if self.oriented else own[:, 3:] + more[:, 3:]

    def turned(self, q0: Array, q: Array, d: Array) -> Array:
        """Rotation vectors (n_blocks, 3) [rad] of the increment `d` from `q0` to `q`."""
        return d[self.dofs].reshape(-1, 6)[:, 3:].copy()

    def tangent(self, q: Array, x: Array) -> Entries:
        """Nothing: there are no internal forces."""
        return nothing()


def nothing() -> Entries:
    """No entries."""
    return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)


def of_blocks(first: Array, matrices: Array) -> Entries:
    """Entries of square matrices (n, m, m) whose unknowns are `first` (n,) and the m - 1 after it."""
    place = np.asarray(first)[:, None] + np.arange(matrices.shape[1])
    rows = np.broadcast_to(place[:, :, None], matrices.shape)
    columns = np.broadcast_to(place[:, None, :], matrices.shape)
    return rows.ravel(), columns.ravel(), matrices.ravel()


def of_pairs(first: int, row: Array, column: Array, blocks: Array) -> Entries:
    """Entries of 3x3 `blocks` (n, 3, 3) between gridpoints `row` and `column` (n,), unknowns counted from `first`."""
    rows = np.broadcast_to((first + 3 * row)[:, None, None] + np.arange(3)[:, None], blocks.shape)
    columns = np.broadcast_to((first + 3 * column.astype(np.int64))[:, None, None] + np.arange(3), blocks.shape)
    return rows.ravel(), columns.ravel(), blocks.ravel()


def same(first: int, dofs: slice) -> Entries:
    """Entries of the unit matrix, rows from `first` on and the unknowns `dofs`."""
    columns = np.arange(dofs.start, dofs.stop)
    return first + np.arange(len(columns)), columns, np.ones(len(columns))


def of_arms(first: int, arms: Array, groups: Array, count: Array) -> Entries:
    """Entries of ``v + omega x r``: rows 3 gp + axis of the gridpoints from `first` on, with the arms (n, 3) [m].

    Each row of `groups` (n_blocks, 6) has the unknowns of a block with `count` (n_blocks,) gridpoints.
    """
    rows = 3 * (first + np.arange(len(arms)))[:, None] + np.arange(3)
    columns = np.repeat(groups, count, axis=0)
    x, y, z = arms.T
    values = np.column_stack([np.ones((len(arms), 3)), z, -y, -z, x, y, -x])
    at, axis = [0, 1, 2, 0, 0, 1, 1, 2, 2], [0, 1, 2, 4, 5, 3, 5, 3, 4]
    return rows[:, at].ravel(), columns[:, axis].ravel(), values.ravel()


def turn(q: Array, d: Array) -> None:
    """Move places and unit quaternions `q` (n, 7) by translations and rotation vectors `d` (n, 6) [m, rad]."""
    q[:, :3] += d[:, :3]
    q[:, 3], q[:, 4:] = _product(*_quaternions(d[:, 3:]), q[:, 3], q[:, 4:])
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1)[:, None]


def turn_on(first: Array, second: Array) -> Array:
    """Rotation vectors (n, 3) of the rotations `first` (n, 3) and then `second` [rad]; exact for small ones too."""
    w, u = _product(*_quaternions(second), *_quaternions(first))
    sine = np.linalg.norm(u, axis=1)
    angle = 2.0 * np.arctan2(sine, w)
    return np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0)[:, None] * u


def _quaternions(turns: Array) -> tuple[Array, Array]:
    """Unit quaternions of rotation vectors (n, 3): w (n,) and the rest (n, 3)."""
    angle = 0.5 * np.linalg.norm(turns, axis=1)
    return np.cos(angle), 0.5 * np.sinc(angle / np.pi)[:, None] * turns


def _product(w: Array, u: Array, w0: Array, u0: Array) -> tuple[Array, Array]:
    """Product of quaternions (w, u) (w0, u0)."""
    return w * w0 - np.einsum("ni,ni->n", u, u0), w[:, None] * u0 + w0[:, None] * u + np.cross(u, u0)


def zone_mass(blocks: ZonedBlocks) -> Entries:
    """Mass of zoned blocks: diagonal, and full where the inertia of a block is matched."""
    own = np.arange(blocks.dofs.start, blocks.dofs.stop)
    parts = [(own, own, np.repeat(blocks.gp_mass, 3))]
    if blocks._correction is not None:
        for row in (int(row) for row in blocks._matched):
            first = np.array([blocks.dofs_of(row).start])
            full = recovery.mass_matrix(blocks, row)
            full -= np.diag(np.repeat(blocks.gp_mass[slice(*blocks._start[row : row + 2])], 3))
            parts.append(of_blocks(first, full[None]))
    rows, columns, values = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return rows, columns, values
