"""Numeric loads: what a load of the scene becomes, forces on gridpoints.

Every load acts through gridpoint forces, so it needs to know no formulation; a force at a material
point of a rigid block is an affine combination of four of its gridpoints, which is exact.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from fdem.errors import SceneError, SolveError, UnsupportedError

__all__ = ["Bedding", "Couple", "Dashpot", "DeadLoad", "Follower", "Load", "Release", "Torque", "UserLoad"]


class Load(ABC):
    """A load on gridpoints.

    Parameters
    ----------
    handle : Applied
        The user's handle; its `factor` is a number or a function of time.
    gp : (n,) int array
        Gridpoints, each at most once.
    """

    needs_velocity = False

    def __init__(self, handle: Any, gp: np.ndarray) -> None:
        self.handle, self.gp = handle, np.ascontiguousarray(gp, dtype=np.int64)
        self.total = np.zeros(3)

    def factor(self, t: float) -> float:
        """Factor at time `t` [s].

        Raises
        ------
        SolveError
            If the user's function returns something that is not finite.
        """
        value = self.handle.factor
        result = float(value(t)) if callable(value) else float(value)
        if not np.isfinite(result):
            raise SolveError(f"load {self.handle.load!r}: factor = {result!r} at t = {t:g} s is not finite")
        return result

    @abstractmethod
    def values(self, t: float, x: np.ndarray, xdot: np.ndarray | None) -> np.ndarray:
        """Forces (n, 3) [N] on the gridpoints."""

    def add(self, t: float, step: int, x: np.ndarray, xdot: np.ndarray | None, f_gp: np.ndarray) -> None:
        """Add the forces to `f_gp` [N]."""
        forces = self.factor(t) * self.values(t, x, xdot)
        self.total = forces.sum(axis=0)
        f_gp[self.gp] += forces

    def tangent(self, t: float, x: np.ndarray, cc: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Minus the derivatives of the forces by positions, plus `cc` [1/s] times those by velocities.

        Returns
        -------
        first, second : (n,) int arrays
            Gridpoints.
        blocks : (n, 3, 3) array
            [N/m].
        """
        return None


class DeadLoad(Load):
    """Constant forces (n, 3) [N]."""

    def __init__(self, handle: Any, gp: np.ndarray, forces: np.ndarray) -> None:
        unique, inverse = np.unique(gp, return_inverse=True)
        super().__init__(handle, unique)
        self.forces = np.zeros((len(unique), 3))
        np.add.at(self.forces, inverse.ravel(), forces)

    def values(self, t: float, x: np.ndarray, xdot: np.ndarray | None) -> np.ndarray:
        """Forces (n, 3) [N] on the gridpoints."""
        return self.forces


class Follower(Load):
    """Pressure on triangles that follows the face, linear on each triangle.

    Parameters
    ----------
    triangles : (n, 3) int array
        Gridpoints, outward.
    pressure : (n, 3) array
        Pressure at the corners [Pa].
    """

    def __init__(self, handle: Any, triangles: np.ndarray, pressure: np.ndarray) -> None:
        unique, inverse = np.unique(triangles, return_inverse=True)
        super().__init__(handle, unique)
        self.corner = inverse.reshape(-1, 3)
        # integral of N_i p over a triangle is A/12 (p_i + sum p)
        self.share = -(pressure + pressure.sum(axis=1, keepdims=True)) / 24.0

    def values(self, t: float, x: np.ndarray, xdot: np.ndarray | None) -> np.ndarray:
        """Forces (n, 3) [N] on the gridpoints."""
        corners = x[self.gp][self.corner]
        area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        forces = np.zeros((len(self.gp), 3))
        for k in range(3):
            np.add.at(forces, self.corner[:, k], self.share[:, k, None] * area)
        return forces

    def tangent(self, t: float, x: np.ndarray, cc: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The area vector of a triangle turns with its edges (not symmetric in general)."""
        factor, corners = self.factor(t), x[self.gp][self.corner]
        first, second, blocks = [], [], []
        for j in range(3):
            # d (b - a) x (c - a) / d corner j = [opposite edge x]
            edge = corners[:, (j + 2) % 3] - corners[:, (j + 1) % 3]
            turn = np.cross(edge[:, None], np.eye(3)[None]).transpose(0, 2, 1)
            for k in range(3):
                first.append(self.gp[self.corner[:, k]])
                second.append(self.gp[self.corner[:, j]])
                blocks.append(-factor * self.share[:, k, None, None] * turn)
        return np.concatenate(first), np.concatenate(second), np.concatenate(blocks)


class Couple(Load):
    """Moments on blocks by forces on their gridpoints, whatever the blocks' rotation.

    Parameters
    ----------
    parts : list of (gp (n,), weights, moment (3,))
        Gridpoints of each block, the moment [N m] in global axes, and masses (n,) of gridpoints, whose forces are those
        that a rotation takes, ``m theta x r``; or weights W (n, 3) that give the block's deformation gradient,
        ``F = x^T W``: then forces ``A W`` with ``A F^T = [T]x / 2``, which turn a block that moves as a whole and do
        not strain it.
    """

    def __init__(self, handle: Any, parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
        super().__init__(handle, np.concatenate([gp for gp, *_ in parts]))
        self.parts = parts

    def values(self, t: float, x: np.ndarray, xdot: np.ndarray | None) -> np.ndarray:
        """Forces (n, 3) [N] on the gridpoints."""
        forces = []
        for gp, weight, moment in self.parts:
            if weight.ndim == 1:
                arm = x[gp] - weight @ x[gp] / weight.sum()
                second = np.einsum("n,ni,nj->ij", weight, arm, arm)
                spin = np.linalg.solve(np.trace(second) * np.eye(3) - second, moment)
                forces.append(weight[:, None] * np.cross(spin, arm))
            else:
                turned = weight @ np.linalg.pinv(x[gp].T @ weight)  # W F^-1
                forces.append(0.5 * np.cross(moment, turned))
        return np.vstack(forces)


class Torque(Load):
    """Moments on blocks that have no gridpoints to take forces (spheres): on their rotational unknowns.

    Parameters
    ----------
    dofs : (n,) int array
        First of the three rotational unknowns of each block.
    moments : (n, 3) array
        [N m], global axes.
    """

    def __init__(self, handle: Any, dofs: np.ndarray, moments: np.ndarray) -> None:
        super().__init__(handle, np.zeros(0, dtype=np.int64))
        self.dofs, self.moments = dofs[:, None] + np.arange(3), moments

    def values(self, t: float, x: np.ndarray, xdot: np.ndarray | None) -> np.ndarray:
        """No forces on gridpoints."""
        return np.zeros((0, 3))

    def turn(self, t: float, f: np.ndarray) -> None:
        """Add the moments to generalised forces `f`."""
        f[self.dofs] += self.factor(t) * self.moments


class Dashpot(Load):
    """Forces ``-C xdot`` with a (3, 3) matrix [N s/m] per gridpoint."""

    needs_velocity = True

    def __init__(self, handle: Any, gp: np.ndarray, matrices: np.ndarray) -> None:
        super().__init__(handle, gp)
        self.matrices = matrices

    def values(self, t: float, x: np.ndarray, xdot: np.ndarray | None) -> np.ndarray:
        """Forces (n, 3) [N] on the gridpoints."""
        assert xdot is not None
        return -np.einsum("nij,nj->ni", self.matrices, xdot[self.gp])

    def tangent(self, t: float, x: np.ndarray, cc: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The matrices themselves."""
        return self.gp, self.gp, cc * self.factor(t) * self.matrices


class Bedding(Load):
    """Forces ``-K (x - X)`` with a (3, 3) matrix [N/m] per gridpoint."""

    def __init__(self, handle: Any, gp: np.ndarray, matrices: np.ndarray, X: np.ndarray) -> None:
        super().__init__(handle, gp)
        self.matrices, self.start = matrices, X[self.gp].copy()

    def values(self, t: float, x: np.ndarray, xdot: np.ndarray | None) -> np.ndarray:
        """Forces (n, 3) [N] on the gridpoints."""
        return -np.einsum("nij,nj->ni", self.matrices, x[self.gp] - self.start)

    def tangent(self, t: float, x: np.ndarray, cc: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The matrices themselves."""
        return self.gp, self.gp, self.factor(t) * self.matrices


class UserLoad(Load):
    """The user's ``force(t, x, v) -> (n, 3)`` on gridpoints, and for implicit methods ``tangent(t, x, v)``."""

    needs_velocity = True

    def tangent(self, t: float, x: np.ndarray, cc: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the user says: minus the derivative (n, 3, 3) of each gridpoint's force by its own position.

        What forces depend on besides is left out; Newton's method then takes more iterations.

        Raises
        ------
        UnsupportedError
            The load has no ``tangent(t, x, v)``.
        """
        given = getattr(self.handle.load, "tangent", None)
        if given is None:
            raise UnsupportedError(
                f"load {self.handle.load!r} has no tangent(t, x, v): implicit integrators cannot use it"
            )
        blocks = np.asarray(given(t, x[self.gp] + self.origin, np.zeros((len(self.gp), 3))), dtype=np.float64)
        if blocks.shape != (len(self.gp), 3, 3):
            raise SceneError(
                f"load {self.handle.load!r}: tangent returned shape {blocks.shape}, expected ({len(self.gp)}, 3, 3)"
            )
        return self.gp, self.gp, self.factor(t) * blocks

    def __init__(self, handle: Any, gp: np.ndarray, origin: np.ndarray) -> None:
        super().__init__(handle, gp)
        self.origin = origin

    def values(self, t: float, x: np.ndarray, xdot: np.ndarray | None) -> np.ndarray:
        """Forces (n, 3) [N] on the gridpoints."""
        assert xdot is not None
        forces = np.asarray(self.handle.load.force(t, x[self.gp] + self.origin, xdot[self.gp]), dtype=np.float64)
        if forces.shape != (len(self.gp), 3):
            raise SceneError(
                f"load {self.handle.load!r}: force returned shape {forces.shape}, expected ({len(self.gp)}, 3)"
            )
        if not np.isfinite(forces).all():
            raise SolveError(f"load {self.handle.load!r}: force is not finite at t = {t:g} s")
        return forces


class Release(Load):
    """Tractions of removed blocks, taken away linearly over a number of steps.

    Parameters
    ----------
    forces : (n_gp, 3) array
        What the removed blocks did to the gridpoints [N].
    start, over : int
        Step of the removal and steps the release takes.
    """

    def __init__(self, handle: Any, gp: np.ndarray, forces: np.ndarray, start: int, over: int) -> None:
        super().__init__(handle, gp)
        self.forces, self.start, self.over = forces, start, over

    def values(self, t: float, x: np.ndarray, xdot: np.ndarray | None) -> np.ndarray:
        """Forces (n, 3) [N] on the gridpoints."""
        return self.forces

    def add(self, t: float, step: int, x: np.ndarray, xdot: np.ndarray | None, f_gp: np.ndarray) -> None:
        """Add what is left of the forces to `f_gp` [N]."""
        left = max(0.0, 1.0 - (step - self.start) / self.over)
        self.total = left * self.forces.sum(axis=0)
        if left > 0.0:
            f_gp[self.gp] += left * self.forces
