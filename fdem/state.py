"""Every array that changes in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["State"]


@dataclass(slots=True)
class State:
    """Configuration, velocity, forces and positions.

    Gridpoints that are unknowns (of zoned blocks) come last in `q` and `f` and first in `x` and `f_gp`, in one buffer
    each: placing them and pulling their forces costs nothing.

    Attributes
    ----------
    q : (n_q,) array
        Configuration: rigid 7 (centroid [m], quaternion), uniform strain 12 (centre [m], deformation gradient),
        zoned 3 per gridpoint [m].
    v : (n_dofs,) array
        Velocity [m/s, rad/s, 1/s]; half a step behind `q` in explicit runs.
    f : (n_dofs,) array
        Generalised forces [N, N m].
    x, x_old : (n_gp, 3) array
        Positions now and at the last commit [m].
    f_gp : (n_gp, 3) array
        Forces on gridpoints [N].
    forces : (n,) array
        The memory of `f` and `f_gp`.
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
    forces: np.ndarray
    t: float = 0.0
    step: int = 0

    @classmethod
    def make(cls, X: np.ndarray, n_q: int, n_dofs: int, n_in_place: int) -> State:
        """State of a model at rest.

        Parameters
        ----------
        X : (n_gp, 3) array
            Positions [m]; the first `n_in_place` are unknowns.
        n_q, n_dofs : int
            Coordinates and unknowns of all other blocks; these coordinates are still empty.
        n_in_place : int
            Gridpoints that are unknowns.
        """
        shared, n_gp = 3 * n_in_place, len(X)
        positions, forces = np.zeros(n_q + 3 * n_gp), np.zeros(n_dofs + 3 * n_gp)
        x = positions[n_q:].reshape(-1, 3)
        x[:] = X
        return cls(
            q=positions[: n_q + shared],
            v=np.zeros(n_dofs + shared),
            f=forces[: n_dofs + shared],
            x=x,
            x_old=x.copy(),
            f_gp=forces[n_dofs:].reshape(-1, 3),
            forces=forces,
        )
