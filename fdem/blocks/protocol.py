"""What every formulation offers: one instance holds all its blocks of a scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from fdem.blocks.bounds import Springs
from fdem.blocks.entries import Entries

__all__ = ["Blocks"]


class Blocks(Protocol):
    """A batch of blocks of one formulation; arrays are those of the whole model.

    Attributes
    ----------
    dofs, coords, gridpoints : slice
        The share of this batch in velocities ``v``, configuration ``q`` and positions ``x``.
    label : str
        What messages call a block of this batch.
    has_internal, in_place : bool
        Whether `internal` does anything; whether the unknowns are positions of gridpoints, so that
        gridpoint forces are generalised forces, in the same memory.
    turns, has_strain : bool
        Whether `turn` gives the rotation of a step, to be accumulated; whether blocks have stress and strain.
    coupled, steady : bool
        Whether the mass matrix couples unknowns, so that conditions on them are `Coupled`; whether it is constant.
    rows : (n_blocks,) int array
        Row of each block in the model.
    """

    dofs: slice
    coords: slice
    gridpoints: slice
    label: str
    has_internal: bool
    in_place: bool
    turns: bool
    has_strain: bool
    coupled: bool
    steady: bool
    rows: np.ndarray

    def start(self, q: np.ndarray) -> None:
        """Write the configuration at the start into `q`."""

    def launch(self, q: np.ndarray, x: np.ndarray, v: np.ndarray, velocity: np.ndarray, spin: np.ndarray) -> None:
        """Write velocities of rigid motion into `v`: of the centres, and angular, (n_blocks, 3) [m/s, rad/s]."""

    def place(self, q: np.ndarray, x: np.ndarray) -> None:
        """Write the gridpoint positions of configuration `q` into `x` [m]."""

    def show(self, q: np.ndarray, x: np.ndarray) -> None:
        """Write the places of material points where contact sees gridpoints a little off them."""

    def push(self, q: np.ndarray, v: np.ndarray, xdot: np.ndarray) -> None:
        """Write gridpoint velocities ``P(q) v`` into `xdot` [m/s]."""

    def pull(self, q: np.ndarray, f_gp: np.ndarray, f: np.ndarray) -> None:
        """Add ``P(q)^T f_gp`` to the generalised forces `f`."""

    def internal(self, q: np.ndarray, x: np.ndarray, f: np.ndarray) -> None:
        """Subtract the internal forces of the configuration from `f`."""

    def graded(self, level: np.ndarray) -> list[tuple[int, Callable[..., None]]]:
        """`internal` in parts: every `level` (n_blocks,) there is, and what subtracts the forces of its blocks.

        Only of batches that have internal forces. Where they cost next to nothing, all are of level 0.
        """

    def weight(self, g: np.ndarray, f: np.ndarray) -> None:
        """Add the weight for gravity `g` [m/s^2] to `f`."""

    def accelerate(self, q: np.ndarray, f: np.ndarray, a: np.ndarray, scaled: Any) -> None:
        """Write ``M(q)^-1 f`` into `a`; with `scaled` masses if not None."""

    def kick(self, q: np.ndarray, f: np.ndarray, v: np.ndarray, h: float, a: np.ndarray, scaled: Any = None) -> None:
        """Add ``h M(q)^-1 f`` to `v`; `a` is room for the accelerations of all unknowns."""

    def advance(self, q: np.ndarray, v: np.ndarray, dt: float, scaled: Any = None) -> None:
        """Move `q` by `dt` [s] at fixed momentum, updating `v` where the inertia rotates."""

    def resist(self, q: np.ndarray, f: np.ndarray, v: np.ndarray, share: float, out: np.ndarray) -> None:
        """Write forces that resist the motion `v`, a `share` of the forces `f` by components, into `out`."""

    def kinetic(self, q: np.ndarray, v: np.ndarray) -> float:
        """Kinetic energy [J]."""

    def strain_energy(self, q: np.ndarray, x: np.ndarray) -> float:
        """Strain energy [J]."""

    def potential(self, g: np.ndarray, x: np.ndarray, q: np.ndarray) -> float:
        """Potential energy of the weight [J]."""

    def step_bound(self, q: np.ndarray, springs: Springs) -> np.ndarray:
        """Upper bound of the squared frequency of each block on all springs [1/s^2]."""

    def scaled_masses(self, q: np.ndarray, springs: Springs, swing: float) -> Any:
        """Fictitious masses whose highest frequency is at most 1 rad per unit of time."""

    def scaled_kinetic(self, q: np.ndarray, v: np.ndarray, scaled: Any) -> float:
        """``v.M v`` with the fictitious masses."""

    def decay_bound(self, q: np.ndarray, c_gp: np.ndarray) -> float:
        """Largest decay rate [1/s] that dashpots `c_gp` (n_gp,) [N s/m] on gridpoints give a block."""

    def unbalance(
        self, q: np.ndarray, x: np.ndarray, unbalanced: np.ndarray, pushes: np.ndarray, gravity: float, scaled: Any
    ) -> float:
        """Largest unbalanced force over the largest force acting."""

    def fit(self, row: int, q: np.ndarray, x: np.ndarray) -> None:
        """Take over one block whose gridpoints another formulation has moved to `x`: write `q`, and its own `x`."""

    # readout, (n_blocks, ...) of the whole batch

    def dofs_of(self, row: int) -> slice:
        """Unknowns of one block."""

    def coords_of(self, row: int) -> slice:
        """Coordinates of one block in ``q``."""

    def centres(self, q: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Centroids (n_blocks, 3) [m]."""

    def motion(self, q: np.ndarray, v: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean velocities and angular velocities (n_blocks, 3) [m/s, rad/s] of generalised velocities `v`."""

    def turn(self, q: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Rotation vectors (n_blocks, 3) [rad] of the step that ended in `q` with `v`."""

    def rotation(self, q: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Rotations (n_blocks, 3, 3) since the start."""

    def inertia(self, q: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Inertia about the centroids now (n_blocks, 3, 3) [kg m^2]."""

    def angular_momentum(self, q: np.ndarray, v: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Angular momentum about the centroids (n_blocks, 3) [kg m^2/s]."""

    def stresses(self, q: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Volume mean of the Cauchy stress (n_blocks, 6) [Pa]; only of batches that have strain."""

    def strains(self, q: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Volume mean of the strain (n_blocks, 6); only of batches that have strain."""

    def inverted(self, q: np.ndarray, x: np.ndarray) -> tuple[int, int, str] | None:
        """Model row, a gridpoint and what of the first block is turned inside out, or None."""

    def theory(self, row: int, q: np.ndarray) -> np.ndarray | None:
        """Matrix from the theory's rates of one block to those of its unknowns; None where they are the same."""

    def generalised_displacement(
        self, row: int, q: np.ndarray, displacement: np.ndarray, moved: np.ndarray, turned: np.ndarray
    ) -> np.ndarray:
        """The theory's u of one block, from what gridpoints and centroid moved [m] and it turned [rad]."""

    def mass_of(self, row: int, q: np.ndarray) -> np.ndarray:
        """Mass matrix of the unknowns of one block."""

    # for implicit methods: entries (rows, columns, values) of sparse matrices of the whole model's unknowns

    def mass_entries(self, q: np.ndarray) -> Entries:
        """Mass matrix ``M(q)``."""

    def tangent(self, q: np.ndarray, x: np.ndarray) -> Entries:
        """Derivative of the internal forces by the unknowns: what `internal` subtracts grows by ``K dq``."""

    def geometric(self, q: np.ndarray, f_gp: np.ndarray) -> Entries:
        """Derivative ``(dP^T/dq) f_gp`` of `pull` at constant gridpoint forces; not symmetric in general."""

    def jacobian(self, q: np.ndarray) -> Entries:
        """``P(q)`` of `push`: rows 3 gp + axis of the whole model, columns its unknowns."""

    def groups(self) -> np.ndarray:
        """Unknowns (m, k) that belong together, k of a block or gridpoint: for preconditioners."""

    def shift(self, q: np.ndarray, d: np.ndarray) -> None:
        """Move `q` by the increment `d` of the unknowns."""

    def compose(self, d: np.ndarray, change: np.ndarray) -> None:
        """Let the increment `d` be that of `d` and then `change`."""

    def turned(self, q0: np.ndarray, q: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Rotation vectors (n_blocks, 3) [rad] of the increment `d` from `q0` to `q`; zeros if not `turns`."""

    def gyroscopic(self, q: np.ndarray, v: np.ndarray, f: np.ndarray) -> None:
        """Subtract from `f` what the change of the inertia costs: ``M a = f`` then holds at one instant."""
