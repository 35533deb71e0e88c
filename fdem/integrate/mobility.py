"""How velocities answer to impulses: block inverses of masses, a sparse factor where stiffness couples."""

from __future__ import annotations

from typing import Any

import numpy as np

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
    """

    def __init__(self, assembler: Any, mass: Any, stiffness: Any, h: float) -> None:
        self.n, self._stiffness = mass.shape[0], stiffness
        A = mass if stiffness is None else mass + h * h * stiffness
        self._free = projector(assembler.system.constraints, self.n)
        A = assembler.constrained(A.tocsr())
        if stiffness is None:
            self._inverse = _block_inverse(A, assembler.groups)
            self._factor = None
        else:
            from scipy.sparse.linalg import splu

            self._factor = splu(A.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})

    def solve(self, f: Array) -> Array:
        """``A^-1 f`` (n,), zero where constrained."""
        f = self._free.T @ f
        return self._free @ (self._inverse @ f if self._factor is None else self._factor.solve(f))

    def stiffness_times(self, v: Array) -> Array:
        """``K v`` (n,)."""
        return np.zeros(self.n) if self._stiffness is None else self._stiffness @ v

    def rows(self, J: Any, count: int) -> tuple[Any, Any, Any]:
        """Rows of `count` points for the solver.

        Parameters
        ----------
        J : (3 count, n) scipy CSR
            Relative velocities of the points.

        Returns
        -------
        J, B : tuple of arrays
            ``start``, ``dof``, values (entries, 3), of J and of ``B = A^-1 J^T`` as far as J reaches.
        full : (n, 3 count) matrix
            ``A^-1 J^T``.
        """
        transposed = (self._free.T @ J.T).tocsr()
        if self._factor is None:
            full = self._free @ (self._inverse @ transposed)
            return _by_point(J, count), _by_point(full.T.tocsr(), count), full
        dense = self._free @ self._factor.solve(transposed.toarray())
        touched = np.unique(J.indices)
        from scipy.sparse import csr_matrix

        reach = np.zeros_like(dense)
        reach[touched] = dense[touched]
        reach[np.abs(reach) < 1e-14 * np.abs(reach).max()] = 0.0
        return _by_point(J, count), _by_point(csr_matrix(reach.T), count), dense

    @staticmethod
    def delassus(J: Any, B: Any, count: int) -> Array:
        """``J_i B_i`` of every point (count, 3, 3) [1/kg]."""
        from scipy.sparse import csr_matrix

        n = 1 + max(int(J[1].max(initial=0)), int(B[1].max(initial=0)))
        W = np.zeros((count, 3, 3))
        rows = [csr_matrix((J[2][:, k], J[1], J[0]), shape=(count, n)) for k in range(3)]
        columns = [csr_matrix((B[2][:, k], B[1], B[0]), shape=(count, n)) for k in range(3)]
        for a in range(3):
            for b in range(3):
                W[:, a, b] = np.asarray(rows[a].multiply(columns[b]).sum(axis=1)).ravel()
        return W


def _block_inverse(A: Any, groups: list[Array]) -> Any:
    """Inverse of a block-diagonal matrix, scipy CSR."""
    from scipy.sparse import coo_matrix

    rows, cols, values = [], [], []
    for group in groups:
        k = group.shape[1]
        blocks = np.empty((len(group), k, k))
        for i in range(k):
            for j in range(k):
                blocks[:, i, j] = np.asarray(A[group[:, i], group[:, j]]).ravel()
        rows.append(np.repeat(group, k, axis=1).ravel())
        cols.append(np.tile(group, (1, k)).ravel())
        values.append(np.linalg.inv(blocks).ravel())
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))
    return coo_matrix(entries, shape=A.shape).tocsr()


def _by_point(J: Any, count: int) -> tuple[Array, Array, Array]:
    """Rows 3 i .. 3 i + 2 of a CSR matrix on their common columns: start, columns, values (entries, 3)."""
    rows = np.repeat(np.arange(J.shape[0]), np.diff(J.indptr))
    key = (rows // 3).astype(np.int64) * J.shape[1] + J.indices
    order = np.argsort(key, kind="stable")
    fresh = np.concatenate([[True], np.diff(key[order]) != 0]) if len(key) else np.zeros(0, bool)
    place = np.cumsum(fresh) - 1
    unique = key[order][fresh]
    values = np.zeros((len(unique), 3))
    values[place, rows[order] % 3] = J.data[order]
    start = np.searchsorted(unique, np.arange(count + 1) * np.int64(J.shape[1]))
    return start, (unique % J.shape[1]).astype(np.int64), values
