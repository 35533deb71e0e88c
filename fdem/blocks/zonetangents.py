"""Stiffness of zoned blocks for implicit steps, refilled into a fixed pattern of 3x3 blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fdem.blocks import recovery
from fdem.blocks.zoneforces import elasticity, tensors
from fdem.kernels import zonetangent

if TYPE_CHECKING:
    from fdem.blocks.zoned import ZonedBlocks

__all__ = ["ZonePattern"]

Array = Any

PAIRS = np.array([(a, b) for a in range(4) for b in range(a, 4)])


class ZonePattern:
    """Pattern of the stiffness of a batch of zoned blocks, by rows of 3x3 blocks.

    Parameters
    ----------
    owner : ZonedBlocks
        The batch.

    Attributes
    ----------
    start, column : int arrays
        Rows of the whole symmetric matrix.
    """

    def __init__(self, owner: ZonedBlocks) -> None:
        self._owner = owner
        n = len(owner.X)
        first, second = (owner._nodes[:, PAIRS[:, k]].astype(np.int64) for k in range(2))
        self._turned = np.ascontiguousarray(first > second)
        keys, place = np.unique(np.minimum(first, second) * n + np.maximum(first, second), return_inverse=True)
        self._place = np.ascontiguousarray(place.reshape(first.shape))
        row, column = keys // n, keys % n
        self._count = len(keys)
        off = np.flatnonzero(row != column)
        rows, columns = np.concatenate([row, column[off]]), np.concatenate([column, row[off]])
        order = np.lexsort((columns, rows))
        self._source = np.concatenate([np.arange(len(keys)), off])[order]
        self._mirrored = (np.arange(len(order)) >= len(keys))[order]
        self.column = columns[order].astype(np.int32)
        self.start = np.searchsorted(rows[order], np.arange(n + 1)).astype(np.int32)

    @property
    def pairs(self) -> tuple[Array, Array]:
        """Row and column of every block."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start)), self.column

    def blocks(self, x: Array) -> Array:
        """Blocks (nb, 3, 3) [N/m] of d internal force / d position at the positions `x` (n_gp, 3) of the model.

        Blocks of small strain take the reference stiffness turned by their frame; what is left out is of the order of
        the strain.
        """
        owner = self._owner
        F, block = owner.deformation(x), owner.zone_block
        lam, mu, large = owner.lam[block], owner.mu[block], owner.large[block]
        S = elasticity(0.5 * (np.swapaxes(F, 1, 2) @ F - np.eye(3)), lam, mu)
        if owner.stress0 is not None:
            S += tensors(owner.stress0)
        if not large.all():
            F = np.where(large[:, None, None], F, recovery.frames(owner, x))
            S = np.where(large[:, None, None], S, 0.0)
        upper = np.zeros((self._count, 9))
        F, S = np.ascontiguousarray(F), np.ascontiguousarray(S)
        zonetangent.fill(F, S, owner.gradients, owner.zone_volume, lam, mu, self._place, self._turned, upper)
        data: Array = upper.reshape(-1, 3, 3)[self._source]
        data[self._mirrored] = np.swapaxes(data[self._mirrored], 1, 2)
        return data
