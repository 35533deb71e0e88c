"""Every array that changes in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["State"]


@dataclass(slots=True)
class State:
    """Configuration, velocity, forces and positions.

    Zoned gridpoints come last in `q` and `f` and first in `x` and `f_gp`, in one buffer each:
    placing zoned blocks and pulling their gridpoint forces costs nothing.

    Attributes
    ----------
    q : (n_q,) array
        Configuration: rigid 7 (centroid [m], quaternion), zoned 3 per gridpoint [m].
    v : (n_dofs,) array
        Velocity [m/s, rad/s]; half a step behind `q` in explicit runs.
    f : (n_dofs,) array
        Generalised forces [N, N m].
    x, x_old : (n_gp, 3) array
        Positions now and at the last commit [m].
    f_gp : (n_gp, 3) array
        Forces on gridpoints [N].
    t : float
        Time [s].
    step : int
        Steps done.
    """

    q: np.ndarray
    v: np.ndarray
    f: np.ndarray
    x: np.ndarray
    x_old: np.ndarray
    f_gp: np.ndarray
    t: float = 0.0
    step: int = 0

    @classmethod
    def make(cls, X: np.ndarray, n_rigid: int, n_zoned_gp: int) -> State:
        """State of a model at rest: zoned gridpoints at `X`, rigid part of `q` still empty."""
        shared, n_gp = 3 * n_zoned_gp, len(X)
        n_q, n_dofs = 7 * n_rigid + shared, 6 * n_rigid + shared
        positions = np.zeros(n_q - shared + 3 * n_gp)
        forces = np.zeros(n_dofs - shared + 3 * n_gp)
        x = positions[n_q - shared :].reshape(-1, 3)
        x[:] = X
        return cls(
            q=positions[:n_q],
            v=np.zeros(n_dofs),
            f=forces[:n_dofs],
            x=x,
            x_old=x.copy(),
            f_gp=forces[n_dofs - shared :].reshape(-1, 3),
        )
