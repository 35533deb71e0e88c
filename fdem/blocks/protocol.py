"""What every formulation offers: one instance holds all its blocks of a scene."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from fdem.blocks.bounds import Springs

__all__ = ["Blocks"]


class Blocks(Protocol):
    """A batch of blocks of one formulation; arrays are those of the whole model.

    Attributes
    ----------
    dofs, coords, gridpoints : slice
        The share of this batch in velocities ``v``, configuration ``q`` and positions ``x``.
    has_internal, in_place : bool
        Whether `internal` does anything; whether the unknowns are positions of gridpoints, so that
        gridpoint forces are generalised forces, in the same memory.
    rows : (n_blocks,) int array
        Row of each block in the model.
    """

    dofs: slice
    coords: slice
    gridpoints: slice
    has_internal: bool
    in_place: bool
    rows: np.ndarray

    def place(self, q: np.ndarray, x: np.ndarray) -> None:
        """Write the gridpoint positions of configuration `q` into `x` [m]."""

    def push(self, q: np.ndarray, v: np.ndarray, xdot: np.ndarray) -> None:
        """Write gridpoint velocities ``P(q) v`` into `xdot` [m/s]."""

    def pull(self, q: np.ndarray, f_gp: np.ndarray, f: np.ndarray) -> None:
        """Add ``P(q)^T f_gp`` to the generalised forces `f`."""

    def internal(self, x: np.ndarray, f: np.ndarray) -> None:
        """Subtract the internal forces of configuration `x` from `f`."""

    def weight(self, g: np.ndarray, f: np.ndarray) -> None:
        """Add the weight for gravity `g` [m/s^2] to `f`."""

    def accelerate(self, q: np.ndarray, f: np.ndarray, a: np.ndarray, scaled: Any) -> None:
        """Write ``M(q)^-1 f`` into `a`; with `scaled` masses if not None."""

    def advance(self, q: np.ndarray, v: np.ndarray, dt: float) -> None:
        """Move `q` by `dt` [s] at fixed momentum, updating `v` where the inertia rotates."""

    def kinetic(self, q: np.ndarray, v: np.ndarray) -> float:
        """Kinetic energy [J]."""

    def strain_energy(self, x: np.ndarray) -> float:
        """Strain energy [J]."""

    def potential(self, g: np.ndarray, x: np.ndarray, q: np.ndarray) -> float:
        """Potential energy of the weight [J]."""

    def step_bound(self, q: np.ndarray, springs: Springs) -> np.ndarray:
        """Upper bound of the squared frequency of each block on all springs [1/s^2]."""

    def scaled_masses(self, q: np.ndarray, springs: Springs, swing: float) -> Any:
        """Fictitious masses whose highest frequency is at most 1 rad per unit of time."""

    def scaled_kinetic(self, q: np.ndarray, v: np.ndarray, scaled: Any) -> float:
        """``v.M v`` with the fictitious masses."""

    def unbalance(
        self, x: np.ndarray, unbalanced: np.ndarray, pushes: np.ndarray, gravity: float, scaled: Any
    ) -> float:
        """Largest unbalanced force over the largest force acting."""
