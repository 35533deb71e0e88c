"""Matrices of zoned blocks for implicit steps: masses, and stiffness refilled into a fixed pattern of 3x3 blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fdem.kernels import zonetangent

if TYPE_CHECKING:
    from fdem.blocks.zoned import ZonedBlocks

__all__ = ["ZoneMatrices"]

Array = Any


class ZoneMatrices:
    """Pattern of the stiffness of a batch of zoned blocks.

    Parameters
    ----------
    owner : ZonedBlocks
        The batch.
    """

    def __init__(self, owner: ZonedBlocks) -> None:
        self._owner = owner
        n = len(owner.X)
        pairs = np.repeat(owner._nodes.astype(np.int64), 4, axis=1) * n + np.tile(owner._nodes, (1, 4))
        keys, place = np.unique(pairs, return_inverse=True)
        self.place = np.ascontiguousarray(place.reshape(-1, 16))
        self.first, self.second = keys // n, keys % n
        self.large = np.flatnonzero(owner.large[owner.zone_block])

    def stiffness(self, x: Array) -> tuple[Array, Array, Array]:
        """Entries of d internal force / d position at the batch's positions x (n, 3)."""
        owner = self._owner
        data = np.zeros((len(self.first), 3, 3))
        ids = self.large
        stress0 = np.zeros((0, 6)) if owner.stress0 is None else owner.stress0[ids]
        block = owner.zone_block[ids]
        zonetangent.stvk_tangent(
            x, owner._nodes[ids], owner.gradients[ids], owner.zone_volume[ids], owner.lam[block], owner.mu[block],
            stress0, self.place[ids], data,
        )  # fmt: skip
        for term in owner._terms:
            if hasattr(term, "block_stiffness"):
                term.block_stiffness(x, self.first, self.second, data)
        base = owner.dofs.start
        rows = base + 3 * self.first[:, None, None] + np.arange(3)[:, None]
        cols = base + 3 * self.second[:, None, None] + np.arange(3)
        return np.broadcast_to(rows, data.shape).ravel(), np.broadcast_to(cols, data.shape).ravel(), data.ravel()

    def mass(self) -> tuple[Array, Array, Array]:
        """Entries of the mass matrix: lumped, and dense in blocks whose inertia is matched."""
        owner = self._owner
        diagonal = owner.dofs.start + np.arange(3 * len(owner.X))
        rows, cols, values = [diagonal], [diagonal], [np.repeat(owner.gp_mass, 3)]
        if (extra := owner._correction) is not None:
            for k in range(len(extra.start) - 1):
                mine = slice(extra.start[k], extra.start[k + 1])
                dense = extra.weighted[mine] @ extra.S[k] @ extra.weighted[mine].T
                for axis in range(3):
                    dof = owner.dofs.start + 3 * extra.rows[mine] + axis
                    rows.append(np.repeat(dof, len(dof)))
                    cols.append(np.tile(dof, len(dof)))
                    values.append(dense.ravel())
        return np.concatenate(rows), np.concatenate(cols), np.concatenate(values)
