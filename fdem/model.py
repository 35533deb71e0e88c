"""Model: what compile made of a scene, frozen; State: what changes in time."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

__all__ = ["Model"]


@dataclass(frozen=True)
class Model:
    """Flat arrays of a compiled scene. Positions are relative to `origin`.

    Attributes
    ----------
    names, groups : list
        Name and group of every block.
    gp_range : (n_blocks, 2) int array
        First and last + 1 gridpoint of each block.
    zoned, fixed : (n_blocks,) bool array
        Whether the block has zones; whether it is fixed, or driven.
    batch_row, batch_index : (n_blocks,) int array
        Row of the block in its batch, and which of `batches` that is (-1: fixed).
    volume, mass, size : (n_blocks,) array
        Volume [m^3], mass [kg] (0 for fixed blocks without material), cube root of volume [m].
    origin : (3,) array
        Subtracted from all coordinates [m].
    X : (n_gp, 3) array
        Positions at compile [m].
    zones, zone_block, zone_start : int arrays
        Gridpoints (m, 4) and block (m,) of every zone; first zone of each block (n_blocks + 1).
    triangles, triangle_block, triangle_tag : int arrays
        Surface triangles of all blocks, their block and row in `tags` (-1: none).
    batches : tuple
        The formulations present.
    deformable : ZonedBlocks or None
        The one whose blocks have zones.
    gravity : (3,) array
        [m/s^2].
    balls, ball_radius : (n,) arrays
        Gridpoints that are centres of spheres, those of clumps too, and the radii [m].
    notes : list of str
        What was compiled, chosen and left out, for `describe`.
    """

    names: list[str]
    groups: list[str | None]
    gp_range: np.ndarray
    zoned: np.ndarray
    fixed: np.ndarray
    batch_row: np.ndarray
    batch_index: np.ndarray
    volume: np.ndarray
    mass: np.ndarray
    size: np.ndarray
    centroid: np.ndarray
    gp_mass: np.ndarray
    origin: np.ndarray
    X: np.ndarray
    zones: np.ndarray
    zone_block: np.ndarray
    zone_start: np.ndarray
    triangles: np.ndarray
    triangle_block: np.ndarray
    triangle_tag: np.ndarray
    tags: list[str]
    batches: tuple[Any, ...]
    deformable: Any
    gravity: np.ndarray
    damping_ratio: float
    joint_names: list[str]
    wave_speed: np.ndarray
    balls: np.ndarray
    ball_radius: np.ndarray
    notes: list[str] = field(default_factory=list)

    @property
    def n_blocks(self) -> int:
        """Number of blocks."""
        return len(self.names)

    def batch_of(self, block: int) -> Any:
        """The formulation of a block; None if it is fixed."""
        return self.batches[self.batch_index[block]] if self.batch_index[block] >= 0 else None

    @cached_property
    def gp_block(self) -> np.ndarray:
        """Block of every gridpoint (n_gp,)."""
        owner = np.empty(len(self.X), dtype=np.int32)
        for block, (start, stop) in enumerate(self.gp_range):
            owner[start:stop] = block
        return owner
