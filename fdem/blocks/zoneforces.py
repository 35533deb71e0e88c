"""The two ways a zoned block resists deformation: large strain zone by zone, small strain in a block frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from fdem.blocks.assembly import elastic_stiffness, upper_block_rows
from fdem.kernels import corotated, zones

if TYPE_CHECKING:
    from fdem.blocks.zoned import ZonedBlocks

__all__ = ["LargeStrain", "SmallStrain", "elasticity", "rotation_vectors", "tensors", "terms_of", "voigt_strain"]

Array = Any

_CHUNK_ZONES = 8192  # a chunk's window of forces stays in the second cache
_CHUNK_ROWS = 4096
_THREAD_ZONES = 32768  # below this, waking a thread costs more than it saves


def elasticity(strain: Array, lam: Array, mu: Array) -> Array:
    """Stresses ``lam tr(e) I + 2 mu e`` (m, 3, 3) [Pa] of strains (m, 3, 3)."""
    trace = np.trace(strain, axis1=1, axis2=2)
    return (lam * trace)[:, None, None] * np.eye(3) + 2.0 * mu[:, None, None] * strain


def voigt_strain(strain: Array) -> Array:
    """Strain vectors (m, 6) xx yy zz yz zx xy with engineering shear of tensors (m, 3, 3)."""
    return strain[:, [0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]] * np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])


def tensors(voigt: Array) -> Array:
    """Symmetric tensors (m, 3, 3) of stresses (m, 6) xx yy zz yz zx xy."""
    return voigt[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]


def rotation_vectors(R: Array) -> Array:
    """Rotation vectors of rotation matrices (m, 3, 3), through the largest quaternion component."""
    diagonal = R[:, [0, 1, 2], [0, 1, 2]]
    trace = diagonal.sum(axis=1)
    # 4 q q^T: any of its rows is a multiple of the quaternion (w, x, y, z)
    outer = np.empty((R.shape[0], 4, 4))
    outer[:, 0, 0] = 1.0 + trace
    outer[:, [1, 2, 3], [1, 2, 3]] = 1.0 - trace[:, None] + 2.0 * diagonal
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0)), start=1):
        outer[:, 0, k] = outer[:, k, 0] = R[:, i, j] - R[:, j, i]
    for (a, b), (i, j) in (((1, 2), (0, 1)), ((1, 3), (0, 2)), ((2, 3), (1, 2))):
        outer[:, a, b] = outer[:, b, a] = R[:, i, j] + R[:, j, i]
    row = np.argmax(outer[:, [0, 1, 2, 3], [0, 1, 2, 3]], axis=1)
    q = outer[np.arange(R.shape[0]), row]
    q *= np.where(q[:, :1] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(q[:, 1:], axis=1)
    angle = 2.0 * np.arctan2(sine, q[:, 0])
    factor = np.divide(angle, sine, out=np.full_like(sine, 0.0), where=sine > 0.0)
    return q[:, 1:] * factor[:, None]


def _chunks(count: int, size: int) -> Array:
    """Boundaries (n + 1,) of equal chunks of about `size` items: fixed by the model, not by the threads."""
    n = max(1, -(-count // size))
    return (np.arange(n + 1) * count // n).astype(np.int32)


def _windows(first: Array, last: Array) -> tuple[Array, Array, Array]:
    """First row of every window, where each starts in the buffer, and the buffer."""
    start = np.concatenate([[0], np.cumsum(last - first)]).astype(np.int32)
    return first.astype(np.uint32), start, np.empty((int(start[-1]), 3))


def _lanes(rows: Array, fill: Any) -> Array:
    """Rows (m, k) as (n, k, L): L side by side, the last ones filled up."""
    m, k = rows.shape
    full = np.empty((-(-m // zones.L) * zones.L, k), dtype=rows.dtype)
    full[:m], full[m:] = rows, fill
    return np.ascontiguousarray(full.reshape(-1, zones.L, k).transpose(0, 2, 1))


def _share(owner: ZonedBlocks, n_chunks: int, work: Callable[[int, int], None]) -> None:
    """Run ``work(lo, hi)`` on equal shares of the chunks, one per thread, the first on this thread."""
    cuts = [n_chunks * k // owner.threads for k in range(owner.threads + 1)]
    pool = owner.executor()
    others = [pool.submit(work, cuts[k], cuts[k + 1]) for k in range(1, owner.threads)]
    work(cuts[0], cuts[1])
    for other in others:
        other.result()


class LargeStrain:
    """St. Venant-Kirchhoff zones of some blocks of a batch.

    Parameters
    ----------
    owner : ZonedBlocks
        The batch.
    member : (m,) bool array
        Which of its zones belong here.
    """

    def __init__(self, owner: ZonedBlocks, member: Array) -> None:
        self._owner = owner
        block = owner.zone_block[member]
        volume = owner.zone_volume[member]
        nodes = _lanes(owner._nodes[member].astype(np.uint32), fill=owner._nodes[member][-1:, :1])
        table = np.column_stack([owner.gradients[member], owner.lam[block] * volume, owner.mu[block] * volume])
        self.nodes, self.table = nodes, _lanes(table, fill=0.0)
        if owner.stress0 is None:
            self.stress0 = np.empty((0, 6))
        else:
            self.stress0 = np.zeros((len(nodes) * zones.L, 6))
            self.stress0[: len(table)] = owner.stress0[member] * volume[:, None]
        self.chunk_start = _chunks(len(nodes), _CHUNK_ZONES // zones.L)
        first = np.minimum.reduceat(nodes.min(axis=(1, 2)), self.chunk_start[:-1])
        last = np.maximum.reduceat(nodes.max(axis=(1, 2)), self.chunk_start[:-1]) + 1
        self.chunk_gp, self.window_start, self.windows = _windows(first, last)
        self.threaded = owner.threads > 1 and len(table) >= _THREAD_ZONES

    def subtract_force(self, x: Array, f: Array) -> None:
        """``f -= internal force``, x and f (n, 3) of the batch."""
        data = (x, self.nodes, self.table, self.stress0, self.chunk_start, self.chunk_gp, self.window_start)
        if not self.threaded:
            zones.stvk_force(*data, self.windows, f)
            return
        _share(self._owner, self.chunk_gp.size, lambda lo, hi: zones.stvk_chunks(*data, self.windows, lo, hi))
        zones.subtract_windows(self.chunk_gp, self.window_start, self.windows, f)

    def energy(self, x: Array) -> float:
        """Strain energy [J]."""
        return float(zones.stvk_energy(x, self.nodes, self.table, self.stress0, self.chunk_start))


class SmallStrain:
    """Blocks of a batch with a constant stiffness in a frame that rotates with the block.

    Parameters
    ----------
    owner : ZonedBlocks
        The batch.
    member : (n_blocks,) bool array
        Which of its blocks belong here.
    """

    def __init__(self, owner: ZonedBlocks, member: Array) -> None:
        self._owner = owner
        self.blocks = np.flatnonzero(member)
        self.zones = np.flatnonzero(member[owner.zone_block])
        block = owner.zone_block[self.zones]
        self.start, self.stop = owner._start[:-1][self.blocks], owner._start[1:][self.blocks]
        n = owner.X.shape[0]
        K = elastic_stiffness(owner.X, owner._nodes[self.zones], owner.lam[block], owner.mu[block])
        self.row_start, self.column, self.diagonal, self.upper = upper_block_rows(K)
        self._set_frame(n)
        self.prestress = np.zeros((n, 3))
        if owner.stress0 is not None:
            self._set_prestress(owner.stress0[self.zones] * owner.zone_volume[self.zones, None])
        self.R, self.stretch = np.empty((self.blocks.size, 3, 3)), np.empty((self.blocks.size, 3, 3))
        self.y, self.g = np.zeros((n, 3)), np.empty((n, 3))
        bounds = _chunks(n, _CHUNK_ROWS)
        reach = np.arange(n)
        filled = np.flatnonzero(np.diff(self.row_start))
        reach[filled] = np.maximum(filled, np.maximum.reduceat(self.column, self.row_start[filled]))
        last = np.maximum.reduceat(reach, bounds[:-1]) + 1
        _, self.window_start, self.windows = _windows(bounds[:-1], last)
        self.chunk_row = bounds.astype(np.uint32)
        # columns count from the chunk's first row: the product of a chunk sees nothing but its window
        first = np.repeat(self.chunk_row[:-1], np.diff(self.row_start[bounds].astype(np.int64)))
        self.column -= first
        self.threaded = owner.threads > 1 and self.zones.size >= 4 * _THREAD_ZONES

    def _set_frame(self, n: int) -> None:
        """Weights and arms of the average deformation, from quarter volumes: positive, mesh-fair."""
        owner = self._owner
        volume = np.bincount(
            owner._nodes[self.zones].ravel(), np.repeat(0.25 * owner.zone_volume[self.zones], 4), minlength=n
        )
        self.weight, self.arm, self.X = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3))
        for lo, hi in zip(self.start, self.stop, strict=True):
            w = volume[lo:hi] / volume[lo:hi].sum()
            # from a gridpoint, so that a block far from the origin keeps its digits
            local = owner.X[lo:hi] - owner.X[lo]
            local -= w @ local
            D = (w[:, None] * local).T @ local
            self.weight[lo:hi], self.X[lo:hi] = w, local
            self.arm[lo:hi] = w[:, None] * np.linalg.solve(D, local.T).T

    def _set_prestress(self, stress: Array) -> None:
        """Constant gridpoint forces ``sum V S0 G_a`` of the in-situ stress."""
        owner = self._owner
        gradients = owner.gradients[self.zones].reshape(-1, 3, 3)
        tensor = stress[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
        forces = np.einsum("eaj,eij->eai", gradients, tensor)
        forces = np.concatenate([-forces.sum(axis=1, keepdims=True), forces], axis=1)
        nodes = owner._nodes[self.zones].ravel()
        for c in range(3):
            self.prestress[:, c] = np.bincount(nodes, forces[:, :, c].ravel(), minlength=self.prestress.shape[0])

    def _product(self, x: Array) -> None:
        """Fill frames, local displacements y and ``g = p + K y``."""
        corotated.corotate(x, self.X, self.weight, self.arm, self.start, self.stop, self.R, self.stretch, self.y)
        np.copyto(self.g, self.prestress)
        data = (self.row_start, self.column, self.diagonal, self.upper, self.y)
        partition = (self.chunk_row, self.window_start, self.windows)
        if self.threaded:
            _share(
                self._owner,
                self.window_start.size - 1,
                lambda lo, hi: corotated.block_row_chunks(*data, *partition, lo, hi),
            )
            corotated.add_windows(self.chunk_row, self.window_start, self.windows, self.g)
        else:
            corotated.block_row_product(*data, *partition, self.g)

    def subtract_force(self, x: Array, f: Array) -> None:
        """``f -= internal force``, x and f (n, 3) of the batch."""
        self._product(x)
        corotated.corotated_force(self.X, self.arm, self.start, self.stop, self.R, self.stretch, self.y, self.g, f)

    def energy(self, x: Array) -> float:
        """Strain energy [J]."""
        self._product(x)
        return float(0.5 * np.sum(self.y * (self.g + self.prestress)))

    def override(self, x: Array, F: Array, R: Array, strain: Array) -> None:
        """Replace rotation and strain of this term's zones by the block's rotation and the linear strain."""
        corotated.corotate(x, self.X, self.weight, self.arm, self.start, self.stop, self.R, self.stretch, self.y)
        R[self.zones] = np.repeat(self.R, np.diff(self._owner.zone_start)[self.blocks], axis=0)
        local = np.swapaxes(R[self.zones], 1, 2) @ F[self.zones]
        strain[self.zones] = 0.5 * (local + np.swapaxes(local, 1, 2)) - np.eye(3)

    def local_range(self, x: Array, F: Array, strain: Array, rotation: Array) -> None:
        """Write the largest strain and rotation [rad] against the frame, per block of the batch."""
        R, linear = np.empty_like(F), np.empty_like(F)
        self.override(x, F, R, linear)
        local = np.swapaxes(R[self.zones], 1, 2) @ F[self.zones]
        spin = 0.5 * np.linalg.norm((local - np.swapaxes(local, 1, 2)).reshape(-1, 9), axis=1) / np.sqrt(2.0)
        owner_block = self._owner.zone_block[self.zones]
        np.maximum.at(strain, owner_block, np.abs(linear[self.zones]).reshape(-1, 9).max(axis=1))
        np.maximum.at(rotation, owner_block, spin)


def terms_of(owner: ZonedBlocks, blocks: Array) -> list[LargeStrain | SmallStrain]:
    """What resists the deformation of some `blocks` (n_blocks,) bool of a batch."""
    terms: list[LargeStrain | SmallStrain] = []
    if (large := owner.large & blocks).any():
        terms.append(LargeStrain(owner, large[owner.zone_block]))
    if (small := ~owner.large & blocks).any():
        terms.append(SmallStrain(owner, small))
    return terms
