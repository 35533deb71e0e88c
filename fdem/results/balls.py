"""Spheres, and clumps by their spheres, as triangles: what pictures and meshes show of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Skins", "skins_of"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

# spheres up to this number, and how often the triangles of an icosahedron are then divided in four
_FINE = ((50, 3), (3000, 2), (np.inf, 1))


@dataclass(frozen=True)
class Skins:
    """Surface triangles of all spheres of a model.

    Parameters
    ----------
    gridpoint : (n,) int32 array
        The centre that each point goes with.
    offset : (n, 3) array
        From there to the point [m]: a sphere looks the same whichever way it has turned.
    triangles : (m, 3) int32 array
        Triangles of these points.
    block : (m,) int32 array
        Their blocks.
    """

    gridpoint: Ints
    offset: Array
    triangles: Ints
    block: Ints


def skins_of(model: Any, shown: NDArray[np.bool_] | None = None) -> Skins:
    """Triangles of the spheres of a model; `shown` (n_blocks,) says of which blocks."""
    owner = model.gp_block[model.balls]
    chosen = np.ones(len(owner), dtype=bool) if shown is None else shown[owner]
    gridpoint, radius, owner = model.balls[chosen], model.ball_radius[chosen], owner[chosen]
    n = len(gridpoint)
    if not n:
        none = np.empty((0, 3), dtype=np.int32)
        return Skins(none[:, 0], np.empty((0, 3)), none, none[:, 0])
    import pyvista as pv

    ball = pv.Icosphere(radius=1.0, nsub=next(k for most, k in _FINE if n <= most))
    points, triangles = np.asarray(ball.points, dtype=np.float64), np.asarray(ball.regular_faces)
    first = len(points) * np.arange(n)
    return Skins(
        np.repeat(gridpoint, len(points)).astype(np.int32),
        (radius[:, None, None] * points).reshape(-1, 3),
        (first[:, None, None] + triangles).reshape(-1, 3).astype(np.int32),
        np.repeat(owner, len(triangles)).astype(np.int32),
    )
