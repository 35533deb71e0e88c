"""Linear systems of implicit steps: direct, conjugate gradients with block Jacobi, algebraic multigrid.

What to use was measured (NUMERICS.md 6): conjugate gradients with 3x3 blocks for dynamic steps of zones, multigrid with
the rigid motions for large static problems, sparse LU for small or unsymmetric ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdem.errors import ConvergenceError, SceneError

__all__ = ["METHODS", "LinearSolver"]

Array = Any

METHODS = ("auto", "direct", "cg", "amg")
SMALL = 6000  # unknowns up to which sparse LU is the fastest even for blocks of zones
PLANAR = 60_000  # the same for rigid blocks on joints, whose graphs fill in little
SYMMETRIC = 1e-9  # |A - A^T| over |A| below which A counts as symmetric


@dataclass
class LinearSolver:
    """Solves ``A x = b`` by the method that suits A; remembers what it did for `describe`.

    Parameters
    ----------
    method : str
        "auto", "direct", "cg" (block Jacobi) or "amg" (smoothed aggregation, for zones).
    tolerance : float
        Relative residual of iterative methods.
    """

    method: str = "auto"
    tolerance: float = 1e-10
    used: str = field(default="none yet", init=False)
    iterations: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise SceneError(f"solver = {self.method!r}, allowed are {', '.join(map(repr, METHODS))}")

    def solve(self, A: Any, b: Array, assembler: Any, static: bool = False) -> Array:
        """Solution of ``A x = b``.

        Parameters
        ----------
        A : (n, n) scipy sparse matrix
        b : (n,) array
        assembler : Assembler
            Knows which unknowns belong together, and the rigid motions.
        static : bool
            Whether A has no mass in it.

        Raises
        ------
        ConvergenceError
            A is singular.
        """
        n, groups = len(b), assembler.groups
        if not b.any():
            return np.zeros(n)
        few = max((g.shape[1] for g in groups), default=3) > 3
        method = self.method
        if method == "auto":
            big = "amg" if static and assembler.modes() is not None else "cg"
            method = "direct" if n <= (PLANAR if few else SMALL) else big
        if method != "direct" and not _symmetric(A):
            return self._unsymmetric(A, b, groups)
        if method == "direct":
            return self._direct(A, b)
        precondition = _block_jacobi(A, groups) if method == "cg" else _multigrid(A, assembler.modes())
        x, count, converged = conjugate_gradients(A, b, precondition, self.tolerance)
        self.used, self.iterations = f"{method}, {count} iterations", count
        return x if converged else self._unsymmetric(A, b, groups)

    def _direct(self, A: Any, b: Array) -> Array:
        from scipy.sparse.linalg import splu

        try:
            x = splu(A.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(b)
        except RuntimeError as error:
            raise ConvergenceError(
                f"the stiffness is singular: something can move without resistance ({error})"
            ) from None
        self.used, self.iterations = "sparse LU", 1
        return x

    def _unsymmetric(self, A: Any, b: Array, groups: list[Array]) -> Array:
        """BiCGStab with block Jacobi, sparse LU if that stalls."""
        from scipy.sparse.linalg import LinearOperator, bicgstab

        precondition = LinearOperator(A.shape, matvec=_block_jacobi(A, groups))
        count = [0]
        x, info = bicgstab(
            A,
            b,
            rtol=self.tolerance,
            maxiter=1000,
            M=precondition,
            callback=lambda _: count.__setitem__(0, count[0] + 1),
        )
        self.used, self.iterations = f"BiCGStab, {count[0]} iterations", count[0]
        return x if info == 0 and np.isfinite(x).all() else self._direct(A, b)


def _symmetric(A: Any) -> bool:
    difference = abs(A - A.T)
    return difference.nnz == 0 or difference.max() <= SYMMETRIC * abs(A).max()


def _block_jacobi(A: Any, groups: list[Array]) -> Any:
    """Inverse of the diagonal blocks of A as a function."""
    A = A.tocsr()
    parts = []
    for group in groups:
        k = group.shape[1]
        blocks = np.empty((len(group), k, k))
        for i in range(k):
            for j in range(k):
                blocks[:, i, j] = np.asarray(A[group[:, i], group[:, j]]).ravel()
        parts.append((group, np.linalg.inv(blocks)))

    def apply(r: Array) -> Array:
        z = np.zeros_like(r)
        for group, inverse in parts:
            z[group] = np.einsum("nij,nj->ni", inverse, r[group])
        return z

    return apply


def _multigrid(A: Any, modes: Array | None) -> Any:
    """One V-cycle of smoothed aggregation as a function."""
    from pyamg import smoothed_aggregation_solver

    levels = smoothed_aggregation_solver(A.tobsr((3, 3)), B=modes, smooth="energy", max_coarse=500)
    return levels.aspreconditioner(cycle="V").matvec


def conjugate_gradients(
    A: Any, b: Array, precondition: Any, tolerance: float, most: int = 3000
) -> tuple[Array, int, bool]:
    """Preconditioned conjugate gradients from zero: solution, iterations, whether the residual fell below tolerance."""
    x, r = np.zeros_like(b), b.copy()
    z = precondition(r)
    p, rz, goal = z.copy(), float(r @ z), tolerance * float(np.linalg.norm(b))
    for k in range(1, most + 1):
        Ap = A @ p
        curvature = float(p @ Ap)
        if not curvature > 0.0:
            return x, k, False
        alpha = rz / curvature
        x += alpha * p
        r -= alpha * Ap
        if np.linalg.norm(r) <= goal:
            return x, k, True
        z = precondition(r)
        old, rz = rz, float(r @ z)
        p = z + (rz / old) * p
    return x, most, False
