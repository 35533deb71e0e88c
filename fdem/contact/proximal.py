"""Impulses at points of hard contact: proximal Newton on all of them at once, Gauss-Seidel where that gives up.

Far from the solution the problem is made convex (associated cone, shift ``mu |u_t|`` kept from the last iterate), which
finds the impulses of blocks at rest in some ten iterations whatever their number and their ratio of masses; what
slides is then solved with Coulomb's law itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.kernels import cones, nonsmooth

__all__ = ["Problem", "Rows", "Solver"]

Array = NDArray[np.float64]

SOFTEST, SOFT, STIFF = 1e-2, 10.0, 1e9  # rho over the mass that a point seems to have: least, first, largest
GROWTH, SHRINK = 2.0, 0.3  # of rho after a proximal step that was easy, or failed
EASY = 5  # Newton iterations of an easy proximal step
INNER = 8, 20  # most iterations of a proximal step, and of a convex one
FIRST = 1e5  # largest rho to begin with: the smaller the residual, the larger
ACCURACY = 0.1  # of the residual: to this a proximal step is solved
SHORTENINGS = 5  # of a Newton step
SLOW = 0.8  # a convex step that leaves more of the residual makes way for Coulomb's law
PATIENCE = 4  # proximal steps that fail before Gauss-Seidel is asked to help
MARGIN = 0.001  # of the tolerance is what iterations aim at, so that blocks at rest need none in the steps that follow
KEEP = 0.1  # up to this part of the tolerance impulses are kept: more would add up to motion, step by step
STILL = 0.01  # the same after a step that stopped a motion: its impulses would start the opposite one
ROUND_OFF = 1e-14  # of the velocities of bodies: no tolerance asks for more
SWEEPS = 100  # of Gauss-Seidel when it helps


@dataclass
class Rows:
    """Relative velocities of points over the unknowns (kernels/cones.py).

    Attributes
    ----------
    start, dof, J : (n + 1,), (entries,), (entries, 3) arrays
    """

    start: Any
    dof: Any
    J: Array

    def __iter__(self) -> Iterator[Any]:
        return iter((self.start, self.dof, self.J))

    def onto(self, r: Array, n: int) -> Array:
        """``J^T r`` (n,) for forces or impulses `r` (n_points, 3)."""
        f = np.zeros(n)
        cones.add_impulses(*self, r, f)
        return f

    def times(self, v: Array, bias: Array | None = None) -> Array:
        """``J v`` (n, 3) [m/s], `bias` (n,) added to its normal part."""
        n = len(self.start) - 1
        u = np.empty((n, 3))
        cones.velocities(*self, v, np.zeros(n) if bias is None else bias, u)
        return u


@dataclass
class Problem:
    """One contact problem: ``A (v - free) = J^T r`` and the law at every point.

    Attributes
    ----------
    rows, free_rows : Rows
        Relative velocities over all unknowns, and over the motions that nothing prescribes.
    A : (n_dofs, n_dofs) scipy CSC matrix
        Masses, and stiffness over the step.
    mass : (n_dofs,) array
        Diagonal of the masses alone: how heavy points seem.
    inverse : callable
        ``f -> A^-1 f``, zero where velocities are given.
    answers : callable
        ``A^-1 J^T`` as rows, for Gauss-Seidel.
    free : (n_dofs,) array
        Velocities without impulses [m/s].
    bias : (n,) array
        Added to the normal velocity [m/s]: gap over step, restitution.
    friction, cohesion, tension : (n,) arrays
        [-], [N s], [N s].
    rho : (n,) array
        Masses that points seem to have [kg].
    speed, noise : float
        Velocities [m/s] that errors are measured by, and below which nothing is resolved; the solver sets them.
    """

    rows: Rows
    free_rows: Rows
    A: Any
    mass: Array
    inverse: Callable[[Array], Array]
    answers: Callable[[], Rows]
    free: Array
    bias: Array
    friction: Array
    cohesion: Array
    tension: Array
    rho: Array = field(init=False)
    speed: float = field(default=1.0, init=False)
    noise: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self.rho = np.zeros(len(self.bias))
        cones.effective_masses(*self.free_rows, self.mass, self.rho)
        # a point between bodies whose motion is given has no say
        self.rho[self.rho == 0.0] = self.rho.max(initial=0.0) or 1.0

    def velocity(self, r: Array) -> Array:
        """Velocities (n_dofs,) under the impulses `r` (n, 3)."""
        return self.free + self.inverse(self.push(r))

    def push(self, r: Array) -> Array:
        """``J^T r`` (n_dofs,) on what is free."""
        return self.free_rows.onto(r, len(self.free))

    def relative(self, v: Array) -> Array:
        """Relative velocities (n, 3), bias included."""
        return self.rows.times(v, self.bias)

    def shift(self, v: Array) -> Array:
        """``mu |u_t|`` (n,) [m/s]: what makes the associated cone Coulomb's law."""
        u = self.relative(v)
        return self.friction * np.hypot(u[:, 1], u[:, 2])

    def residual(self, r: Array, v: Array) -> tuple[float, int]:
        """Largest error of an impulse over the mean, or of a velocity over the largest without impulses; and where."""
        worst, speed, where, mean = cones.natural_residual(
            self.relative(v), self.friction, self.tension, self.cohesion, self.rho, r
        )
        if not speed > 0.0:
            return float(speed), 0  # not a number stays that
        mean = max(mean, self.noise * float(self.rho.max()))
        return max(worst / mean if mean > 0.0 else 1.0, speed / self.speed), int(where)


class _Law:
    """One proximal problem: the law around the impulses `r0`, with or without the shift of the convex form."""

    def __init__(self, p: Problem, r0: Array, rho: Array, shift: Array | None) -> None:
        self.p, self.r0, self.rho, self.shift = p, r0, rho, shift
        self.r, self.slope = np.empty_like(r0), np.empty((len(r0), 3, 3))
        self._diagonal = p.A.diagonal()

    def balance(self, x: Array) -> Array:
        """``A (x - free) - J^T r`` (n_dofs,) with the impulses that the law gives for velocities `x`."""
        p, u = self.p, self.p.relative(x)
        if self.shift is not None:
            u[:, 0] += self.shift
        z = self.r0 - self.rho[:, None] * u
        if self.shift is not None:
            cones.project_cone(z, p.friction, self.r, self.slope)
        else:
            cones.project(z, p.friction, p.tension, p.cohesion, self.r, self.slope)
        F: Array = p.A @ (x - p.free) - p.push(self.r)
        return F

    def better(self, before: Array, after: Array, change: Array, share: float) -> bool:
        """Whether a `share` of a Newton step leaves less out of balance.

        Of the convex problem: whether it did not go too far past the least energy, by the slope along the step (the
        energy itself is round-off long before the impulses are exact); else the size of what is out of balance.
        """
        if self.shift is not None:
            return float(after @ change) <= 0.5 * abs(float(before @ change))
        size = [float(F @ (F / self._diagonal)) for F in (before, after)]
        return size[1] <= (1.0 - 0.2 * share) * size[0]


def _mean(r: Array) -> float:
    """Mean normal impulse of the points that have one; 0: none has."""
    size = np.abs(r[:, 0][r[:, 0] != 0.0])
    return float(size.mean()) if len(size) else 0.0


class Solver:
    """Solves contact problems, one after the other, each from what the last has taught.

    Parameters
    ----------
    tolerance : float
        Residual to reach: largest error of an impulse over the mean one.
    most : int
        Newton iterations after which to give up.

    Attributes
    ----------
    iterations, sweeps : int
        Newton iterations (each with a factorisation) and Gauss-Seidel sweeps of the last problem.
    history : list of float
        Residuals of the last problem, step by step.
    """

    def __init__(self, tolerance: float, most: int) -> None:
        self.tolerance, self.most = tolerance, most
        self.iterations, self.sweeps, self.worst = 0, 0, 0
        self.history: list[float] = []
        self._pattern: tuple[Any, ...] | None = None

    def solve(self, p: Problem, r: Array) -> tuple[Array, Array, float]:
        """Impulses (n, 3), velocities (n_dofs,) and residual, from impulses `r` to start with."""
        moving = self.iterations > 0
        self.p, self.iterations, self.sweeps, self.history = p, 0, 0, []
        given = np.linalg.norm(p.rows.times(p.free), axis=1).max(initial=0.0)
        start, dof, J = p.rows
        carried = Rows(start, dof, np.abs(J)).times(np.abs(p.free)).max(initial=0.0)
        p.noise = ROUND_OFF / self.tolerance * float(carried)
        p.speed = max(float(given), -float(p.bias.min(initial=0.0)), p.noise) or 1.0  # else there is nothing to do
        v = p.velocity(r)
        residual, self.worst = p.residual(r, v)
        self.history.append(residual)
        convex = not (p.cohesion.any() or p.tension.any())
        stiff, failed = float(np.clip(1.0 / max(residual, 1e-300), SOFT, FIRST)), 0
        keep = (STILL if moving else KEEP) * self.tolerance
        goal = keep if residual <= keep else MARGIN * self.tolerance
        while residual > goal and self.iterations < self.most:
            trial, easy = self._proximal(r, v, stiff, residual, convex)
            after, gain = np.inf, np.inf
            if trial is not None:
                v_trial = p.velocity(trial)
                after, worst = p.residual(trial, v_trial)
            if trial is not None and after < np.inf and (easy is not None or after < residual):
                if convex and self._lags(v, v_trial, trial) > SLOW * after:
                    convex, stiff = False, min(stiff, 100.0)
                r, v, gain, residual, self.worst = trial, v_trial, after / residual, after, worst
            if residual <= self.tolerance and gain > SLOW:
                break
            failed = failed + 1 if easy is None else 0
            if easy is None:
                convex, stiff = False, max(SHRINK * stiff, SOFTEST)
            elif easy:
                stiff = min(GROWTH * stiff, STIFF)
            self.history.append(residual)
            if failed >= PATIENCE:
                r, v = self._sweep(r, SWEEPS)
                residual, self.worst = p.residual(r, v)
                self.history.append(residual)
                failed, stiff = 0, SOFT
        return r, v, residual

    def _lags(self, before: Array, after: Array, r: Array) -> float:
        """By how much the shift of the convex problem was wrong, as part of the mean impulse."""
        p = self.p
        wrong = p.rho * np.abs(p.shift(after) - p.shift(before))
        return float(wrong.max(initial=0.0)) / (_mean(r) or np.inf)

    def _proximal(
        self, r: Array, v: Array, stiff: float, residual: float, convex: bool
    ) -> tuple[Array | None, bool | None]:
        """Solve ``A (x - free) = J^T P(r - rho u(x))``; impulses, and whether that was easy (None: it failed)."""
        p = self.p
        law = _Law(p, r, stiff * p.rho, p.shift(v) if convex else None)
        x, F = v.copy(), law.balance(v)
        most = INNER[convex]
        for iteration in range(most + 1):
            error = float(np.abs(F).max(initial=0.0)) / (_mean(law.r) or 1.0)
            if not np.isfinite(error):
                return None, None
            if error <= max(ACCURACY * min(residual, 1.0), 0.1 * MARGIN * self.tolerance):
                return law.r, iteration <= EASY
            if iteration == most:
                return law.r, None
            factors = self._factor(law.slope, law.rho)
            self.iterations += 1
            change = factors.solve(-F)
            share = 1.0
            for _ in range(SHORTENINGS):
                after = law.balance(x + share * change)
                if law.better(F, after, change, share):
                    break
                share *= 0.5
            x, F = x + share * change, after
        return None, None

    def _factor(self, slope: Array, rho: Array) -> Any:
        """Sparse factors of ``A + J^T (rho slope) J``."""
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        p = self.p
        indptr, indices, at = self._places()
        data = np.zeros(len(indices))
        data[at] = p.A.data
        cones.add_matrices(*p.free_rows, slope, rho, indptr, indices, data)
        matrix = csc_matrix((data, indices, indptr), shape=p.A.shape)
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True})

    def _places(self) -> tuple[Any, Any, Any]:
        """Pattern of the matrices, and where the entries of A are in it; kept as long as the same unknowns touch."""
        from scipy.sparse import csr_matrix

        p, kept = self.p, self._pattern
        start, dof, _ = p.free_rows
        key = start, dof, p.A.indptr, p.A.indices
        if kept is not None and all(np.array_equal(a, b) for a, b in zip(kept[0], key, strict=True)):
            return kept[1]
        touch = csr_matrix((np.ones(len(dof), bool), dof, start), shape=(len(p.bias), len(p.free)))
        own = csr_matrix((np.ones(p.A.nnz, bool), p.A.indices, p.A.indptr), shape=p.A.shape)
        pattern = (touch.T @ touch + own + own.T).tocsc()
        pattern.sort_indices()
        columns = np.repeat(np.arange(len(p.free)), np.diff(p.A.indptr))
        width = len(p.free)
        keys = np.repeat(np.arange(width), np.diff(pattern.indptr)).astype(np.int64) * width + pattern.indices
        at = np.searchsorted(keys, columns.astype(np.int64) * width + p.A.indices)
        found = pattern.indptr, pattern.indices, at
        self._pattern = key, found
        return found

    def _sweep(self, r: Array, most: int) -> tuple[Array, Array]:
        """Sweeps of Gauss-Seidel from the impulses `r`."""
        p, r = self.p, r.copy()
        v = p.velocity(r)
        answers = p.answers()
        W = np.zeros((len(r), 3, 3))
        cones.own_mobility(*p.rows, *answers, len(p.free), W)
        sweeps, _ = nonsmooth.gauss_seidel(
            *p.rows, *answers, W, p.bias, p.friction, p.tension, p.cohesion, v, r, self.tolerance, most
        )
        self.sweeps += int(sweeps)
        return r, p.velocity(r)
