"""Linear systems of implicit steps: direct, conjugate gradients with block Jacobi, algebraic multigrid.

What to use was measured (NUMERICS.md 6): conjugate gradients with 3x3 blocks for dynamic steps of zones, multigrid with
the rigid motions for large static problems, sparse LU for small or unsymmetric ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

import numpy as np

from fdem.errors import ConvergenceError, SceneError
from fdem.integrate.matrices import SMALL
from fdem.kernels import blockrows

__all__ = ["METHODS", "LinearSolver"]

Array = Any

METHODS = ("auto", "direct", "cg", "amg", "cholmod", "pardiso")
NAMES = dict.fromkeys(METHODS, "sparse LU") | {"cholmod": "CHOLMOD", "pardiso": "PARDISO"}
PACKAGES = {"cholmod": "sksparse.cholmod", "pardiso": "pypardiso"}
KEEP = 300  # unknowns from which a kept factor saves time
SPARE, FINEST, COARSEST = 0.1, 1e-12, 1e-3  # relative residual of iterative methods: as Newton's method needs it
PLANAR = 60_000  # the same for rigid blocks on joints, whose graphs fill in little


@dataclass
class LinearSolver:
    """Solves ``A x = b`` by the method that suits A; remembers what it did for `describe`.

    Parameters
    ----------
    method : str
        "auto", "direct" (sparse LU), "cg" (block Jacobi), "amg" (smoothed aggregation, for zones), or "cholmod" or
        "pardiso", if the package is installed.
    """

    method: str = "auto"
    tolerance: float = field(default=1e-10, init=False)  # relative residual of iterative methods
    used: str = field(default="none yet", init=False)
    iterations: int = field(default=0, init=False)
    again: Any = field(default=None, init=False, repr=False)  # factor of the last matrix itself, if one was made
    _kept: Any = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise SceneError(f"solver = {self.method!r}, allowed are {', '.join(map(repr, METHODS))}")
        package = PACKAGES.get(self.method)
        if package is not None and _missing(package):
            raise SceneError(f"solver = {self.method!r} needs the package {package}, which is not installed")

    def solve(self, A: Any, b: Array, assembler: Any, gain: float, static: bool = False) -> Array:
        """Solution of ``A x = b``.

        Parameters
        ----------
        A : (n, n) scipy sparse matrix
        b : (n,) array
        assembler : Assembler
            Knows which unknowns belong together, and the rigid motions.
        gain : float
            By how much the residual must fall to be small enough; iterative methods go `SPARE` further.
        static : bool
            Whether A has no mass in it.

        Raises
        ------
        ConvergenceError
            A is singular.
        """
        self.again = None
        n, groups, self.tolerance = len(b), assembler.groups, min(max(SPARE * gain, FINEST), COARSEST)
        if not b.any():
            return np.zeros(n)
        method = self.chosen(n, assembler, static)
        if method in FACTORS:
            return self._direct(A, b, FACTORS[method])
        if not assembler.symmetric:
            return self._unsymmetric(A, b, groups)
        if method == "cg" and len(groups) == 1 and groups[0].shape[1] == 3:
            x, count, converged = _by_block_rows(A.tobsr((3, 3)), b, self.tolerance)
        else:
            precondition = _block_jacobi(A, groups) if method == "cg" else _multigrid(A, assembler.modes())
            x, count, converged = conjugate_gradients(A, b, precondition, self.tolerance)
        self.used, self.iterations = f"{method}, {count} iterations", count
        return x if converged else self._unsymmetric(A, b, groups)

    def chosen(self, n: int, assembler: Any, static: bool) -> str:
        """Method for `n` unknowns: as asked for, or by size and kind."""
        if self.method != "auto":
            return self.method
        few = max((g.shape[1] for g in assembler.groups), default=3) > 3
        if n <= (PLANAR if few else SMALL):
            return "direct"
        return "amg" if static and assembler.modes() is not None else "cg"

    def _direct(self, A: Any, b: Array, factor: Any = None) -> Array:
        """By a factor: that of an earlier matrix as long as refinement with it converges fast, else a new one."""
        if self._kept is not None and self._kept[0] == A.shape and len(b) > KEEP:
            x = self._refined(A, b)
            if x is not None:
                return x
        try:
            solve = (factor or _lu)(A)
        except RuntimeError as error:
            raise ConvergenceError(
                f"the stiffness is singular: something can move without resistance ({error})"
            ) from None
        self._kept, self.again = (A.shape, solve), solve
        self.used, self.iterations = NAMES[self.method], 1
        return np.asarray(solve(b))

    def _refined(self, A: Any, b: Array) -> Array | None:
        """Solution with the kept factor; None if the residual falls by less than ten a time."""
        _, solve = self._kept
        x, left, goal = np.zeros_like(b), b, self.tolerance * float(np.linalg.norm(b))
        size = float(np.linalg.norm(b))
        for count in range(1, 9):
            x = x + solve(left)
            left = b - A @ x
            last, size = size, float(np.linalg.norm(left))
            if size <= goal:
                self.used, self.iterations = f"{NAMES[self.method]}, kept factor refined {count} times", count
                return x
            if not size < 0.1 * last:
                break
        return None

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


def _missing(package: str) -> bool:
    try:
        return find_spec(package) is None
    except ModuleNotFoundError:
        return True


def _lu(A: Any) -> Any:
    from scipy.sparse.linalg import splu

    return splu(A.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve


def _cholmod(A: Any) -> Any:
    """Cholesky factor of the symmetric part, which refinement makes up for."""
    from sksparse.cholmod import cholesky

    return cholesky((0.5 * (A + A.T)).tocsc())


def _pardiso(A: Any) -> Any:
    from pypardiso import PyPardisoSolver

    A, solver = A.tocsr(), PyPardisoSolver()
    solver.factorize(A)
    return lambda b: solver.solve(A, b)


FACTORS = {"direct": _lu, "cholmod": _cholmod, "pardiso": _pardiso}


def _by_block_rows(A: Any, b: Array, tolerance: float, most: int = 3000) -> tuple[Array, int, bool]:
    """Conjugate gradients with block Jacobi on the upper half of 3x3 block rows: solution, iterations, success."""
    A.sort_indices()
    row = np.repeat(np.arange(len(A.indptr) - 1), np.diff(A.indptr))
    upper = np.flatnonzero(A.indices >= row)
    start = np.searchsorted(row[upper], np.arange(len(A.indptr)))
    data = np.ascontiguousarray(A.data[upper].reshape(-1, 9))
    inverse = np.linalg.inv(data[start[:-1]].reshape(-1, 3, 3)).reshape(-1, 9)
    x = np.empty_like(b)
    column = A.indices[upper].astype(np.int64)
    count = int(blockrows.conjugate_gradients(start, column, data, inverse, b, x, tolerance, most))
    return x, abs(count), count > 0


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

    # sparse LU on the coarsest level: the default, a dense pseudo-inverse, takes longer than all the rest
    levels = smoothed_aggregation_solver(
        A.tobsr((3, 3)), B=modes, smooth="energy", max_coarse=500, coarse_solver="splu"
    )
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
