"""How velocities answer to impulses: block inverses of masses, a sparse factor where stiffness couples."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.contact.proximal import Rows
from fdem.integrate.matrices import projector

__all__ = ["Mobility"]

Array = Any


class Mobility:
    """``A^-1`` of ``A = M + h^2 K`` over the unknowns that are free.

    Parameters
    ----------
    assembler : Assembler
        Matrices of the system.
    mass : scipy sparse matrix
        M (n, n).
    stiffness : scipy sparse matrix or None
        K (n, n) of zones and other bodies that deform; None where nothing does.
    h : float
        Share of the step that K acts over [s].

    Attributes
    ----------
    matrix : scipy CSC matrix
        A, with a diagonal in the place of what is constrained.
    mass : (n,) array
        Diagonal of M.
    """

    def __init__(self, assembler: Any, mass: Any, stiffness: Any, h: float) -> None:
        self.n, self._stiffness = mass.shape[0], stiffness
        self.mass = mass.diagonal()
        constraints = assembler.system.constraints
        self._free = projector(constraints, self.n) if constraints.any else None
        A = mass if stiffness is None else mass + h * h * stiffness
        self.matrix = assembler.constrained(A.tocsr()).tocsc()
        self.matrix.sort_indices()
        self._blocks: list[tuple[Array, Array]] = []
        if stiffness is None:
            self._blocks = _block_inverses(self.matrix, assembler.groups)
        else:
            from scipy.sparse.linalg import splu

            self._factor = splu(self.matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})

    def solve(self, f: Array) -> Array:
        """``A^-1 f`` (n,), zero where constrained."""
        if self._free is not None:
            f = self._free.T @ f
        if self._stiffness is not None:
            z = self._factor.solve(f)
        else:
            z = np.zeros(self.n)
            for group, inverse in self._blocks:
                z[group] = np.einsum("nij,nj->ni", inverse, f[group])
        return z if self._free is None else self._free @ z

    def stiffness_times(self, v: Array) -> Array:
        """``K v`` (n,)."""
        return np.zeros(self.n) if self._stiffness is None else self._stiffness @ v

    def free_rows(self, rows: Rows) -> Rows:
        """Rows over the motions that constraints leave free."""
        return rows if self._free is None else _by_point(self._wide(rows) @ self._free)

    def answers(self, rows: Rows) -> Rows:
        """``A^-1 J^T`` of rows over free motions, as rows again."""
        from scipy.sparse import csr_matrix

        wide = self._wide(rows)
        if self._stiffness is None:
            return _by_point(wide @ _joined(self._blocks, self.n))
        dense = self._factor.solve(wide.T.toarray()).T
        reach = np.zeros_like(dense)
        touched = np.unique(rows.dof)  # velocities elsewhere are found at the end
        reach[:, touched] = dense[:, touched]
        return _by_point(csr_matrix(reach))

    def _wide(self, rows: Rows) -> Any:
        """Rows as a matrix (3 n_points, n), scipy CSR."""
        from scipy.sparse import coo_matrix

        start, dof, J = rows
        count = len(start) - 1
        at = 3 * np.repeat(np.arange(count), np.diff(start))[:, None] + np.arange(3)
        columns = np.broadcast_to(dof[:, None], J.shape)
        return coo_matrix((J.ravel(), (at.ravel(), columns.ravel())), shape=(3 * count, self.n)).tocsr()


def _block_inverses(A: Any, groups: list[Array]) -> list[tuple[Array, Array]]:
    """Inverses of the diagonal blocks (m, k, k) of each of the `groups` (m, k) of unknowns."""
    rows, cols, found = A.indices, np.repeat(np.arange(A.shape[0]), np.diff(A.indptr)), []
    for group in groups:
        m, k = group.shape
        place = np.full(A.shape[0], -1)
        place[group] = np.arange(m * k).reshape(m, k)
        mine = (place[rows] >= 0) & (place[cols] >= 0)
        r, c = place[rows[mine]], place[cols[mine]]
        blocks = np.zeros((m, k, k))
        blocks[r // k, r % k, c % k] = A.data[mine]
        found.append((group, np.linalg.inv(blocks)))
    return found


def _joined(blocks: list[tuple[Array, Array]], n: int) -> Any:
    """Block-diagonal matrix (n, n), scipy CSR."""
    from scipy.sparse import coo_matrix

    rows = np.concatenate([np.repeat(group, group.shape[1], axis=1).ravel() for group, _ in blocks])
    cols = np.concatenate([np.tile(group, (1, group.shape[1])).ravel() for group, _ in blocks])
    values = np.concatenate([inverse.ravel() for _, inverse in blocks])
    return coo_matrix((values, (rows, cols)), shape=(n, n)).tocsr()


def _by_point(J: Any) -> Rows:
    """Rows 3 i .. 3 i + 2 of a CSR matrix on their common columns."""
    rows = np.repeat(np.arange(J.shape[0]), np.diff(J.indptr))
    key = (rows // 3).astype(np.int64) * J.shape[1] + J.indices
    order = np.argsort(key, kind="stable")
    fresh = np.concatenate([[True], np.diff(key[order]) != 0]) if len(key) else np.zeros(0, bool)
    place = np.cumsum(fresh) - 1
    unique = key[order][fresh]
    values = np.zeros((len(unique), 3))
    values[place, rows[order] % 3] = J.data[order]
    start = np.searchsorted(unique, np.arange(J.shape[0] // 3 + 1) * np.int64(J.shape[1]))
    return Rows(start, (unique % J.shape[1]).astype(np.int64), values)
