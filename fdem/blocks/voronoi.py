"""Voronoi masses: the theory's mass of a gridpoint."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.errors import MeshError
from fdem.kernels import voronoi

__all__ = ["voronoi_masses"]

Array = Any


def voronoi_masses(
    X: Array, zones: Array, density: Array, gp_start: Array, zone_start: Array, blocks: Array | None = None
) -> Array:
    """Masses of the Voronoi cells of gridpoints, clipped to their block.

    Parameters
    ----------
    X : (n, 3) array
        Gridpoints [m], block after block.
    zones : (m, 4) int32 array
        Zones, block after block, positively oriented.
    density : (m,) array
        [kg/m^3].
    gp_start, zone_start : (n_blocks + 1,) int arrays
        Gridpoints and zones of every block.
    blocks : int array, optional
        The blocks wanted; the gridpoints of the others get 0.

    Returns
    -------
    (n,) array
        [kg]; positive, and adding up to the mass of the block.

    Raises
    ------
    MeshError
        If the zones of a block are so flat that a cell cannot be described.

    Notes
    -----
    K. Bagi's definition: the points of the body closer to the gridpoint than to any other gridpoint of the body.
    """
    mass = np.zeros(X.shape[0])
    for block in range(len(gp_start) - 1) if blocks is None else blocks:
        lo, hi = int(gp_start[block]), int(gp_start[block + 1])
        first, last = int(zone_start[block]), int(zone_start[block + 1])
        local = np.ascontiguousarray(X[lo:hi] - X[lo])
        lower, extent = local.min(axis=0), np.ptp(local, axis=0)
        # about one gridpoint a cell; a flat body gets few cells across
        shape = extent / extent.max()
        edge = np.cbrt(np.prod(np.maximum(shape, 1.0 / 64.0)) / (hi - lo))
        n_cells = np.clip(shape // edge, 1, 512).astype(np.int64)
        failed = voronoi.voronoi_masses(
            local,
            np.ascontiguousarray(zones[first:last] - lo, dtype=np.int32),
            np.ascontiguousarray(density[first:last]),
            n_cells,
            lower,
            extent / n_cells,
            mass[lo:hi],
        )
        if failed >= 0:
            raise MeshError(f"zoned block {block}: zone {failed} is too flat for Voronoi masses; use mass='row-sum'")
    return mass
