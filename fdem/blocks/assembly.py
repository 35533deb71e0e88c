"""Stiffness of constant-strain tetrahedra: matrices by scikit-fem, and norms of their blocks."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.kernels import stiffness

__all__ = ["coupling_norms", "elastic_stiffness", "upper_block_rows"]

Array = Any


def elastic_stiffness(X: Array, nodes: Array, lam: Array, mu: Array) -> Any:
    """Assemble linear elasticity.

    Parameters
    ----------
    X : (n, 3) array
        Positions [m].
    nodes : (m, 4) int array
        Zones.
    lam, mu : (m,) arrays
        Lame constants of every zone [Pa].

    Returns
    -------
    (3n, 3n) scipy.sparse.csr_matrix
        K [N/m]; degree of freedom ``3 gp + component``.

    Notes
    -----
    ``Basis(MeshTet, ElementVector(ElementTetP1()), intorder=1)`` integrates constant strains exactly; the default
    order doubles the time.
    """
    from skfem import Basis, BilinearForm, ElementTetP1, ElementVector, MeshTet
    from skfem.helpers import ddot, sym_grad, trace

    # scikit-fem numbers only what elements use
    used, local = np.unique(nodes, return_inverse=True)
    mesh = MeshTet(np.ascontiguousarray(X[used].T), np.ascontiguousarray(local.reshape(nodes.shape).T))
    basis = Basis(mesh, ElementVector(ElementTetP1()), intorder=1)

    @BilinearForm
    def virtual_work(u: Any, v: Any, w: Any) -> Any:
        strain, virtual = sym_grad(u), sym_grad(v)
        return w.lam * trace(strain) * trace(virtual) + 2.0 * w.mu * ddot(strain, virtual)

    K = virtual_work.assemble(basis, lam=lam[:, None], mu=mu[:, None])
    if used.size < len(X):
        from scipy.sparse import coo_matrix

        K = K.tocoo()
        place = (3 * used[:, None] + np.arange(3)).ravel()
        K = coo_matrix((K.data, (place[K.row], place[K.col])), shape=(X.size, X.size))
    return K.tocsr()


def upper_block_rows(K: Any) -> tuple[Array, Array, Array, Array]:
    """Split a symmetric matrix of 3x3 blocks into its diagonal and the blocks right of it.

    Parameters
    ----------
    K : (3n, 3n) scipy sparse matrix
        Symmetric [N/m].

    Returns
    -------
    row_start : (n + 1,) uint32 array
        Blocks of every row.
    column : (nnz,) uint32 array
        Their block column.
    diagonal : (n, 6) array
        00 11 22 12 02 01 of the diagonal blocks [N/m].
    upper : (nnz, 9) array
        Blocks right of the diagonal, by rows [N/m].
    """
    K = K.tobsr((3, 3))
    K.sort_indices()
    n = K.shape[0] // 3
    row = np.repeat(np.arange(n), np.diff(K.indptr))
    on, right = K.indices == row, K.indices > row
    diagonal = np.zeros((n, 6))
    diagonal[row[on]] = K.data[on][:, [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    row_start = np.concatenate([[0], np.cumsum(np.bincount(row[right], minlength=n))]).astype(np.uint32)
    return (
        row_start,
        K.indices[right].astype(np.uint32),
        diagonal,
        np.ascontiguousarray(K.data[right].reshape(-1, 9)),
    )


def coupling_norms(
    nodes: Array, gradients: Array, volume: Array, lam: Array, mu: Array, n: int
) -> tuple[Array, Array, Array, Array]:
    """Spectral norms of the off-diagonal 3x3 blocks in CSR form and of the diagonal blocks [N/m]."""
    pairs = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
    ends = nodes[:, pairs].astype(np.int64)
    keys, edges = np.unique(ends.min(axis=2) * n + ends.max(axis=2), return_inverse=True)
    blocks, diagonal = np.zeros((keys.size, 9)), np.zeros((n, 9))
    stiffness.coupling_blocks(
        nodes, edges.reshape(-1, 6).astype(np.int32), gradients, volume, lam, mu, diagonal, blocks
    )
    norms, diagonal_norms = np.empty(keys.size), np.empty(n)
    stiffness.spectral_norms(blocks, norms)
    stiffness.spectral_norms(diagonal, diagonal_norms)
    low, high = keys // n, keys % n
    row = np.concatenate([low, high])
    order = np.argsort(row, kind="stable")
    row_start = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=n))]).astype(np.int32)
    column = np.concatenate([high, low])[order].astype(np.int32)
    return row_start, column, np.concatenate([norms, norms])[order], diagonal_norms
