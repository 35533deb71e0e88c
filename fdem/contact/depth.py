"""How deep convex blocks of few faces are, by NumPy: `kernels.thickness` and `kernels.deepest` need not be compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

__all__ = ["few_convex"]


def _along(normal: Array, arm: Array) -> Array:
    out: Array = normal[:, 0] * arm[:, 0] + normal[:, 1] * arm[:, 1] + normal[:, 2] * arm[:, 2]
    return out


def _middles(corner_start: Ints, corner_x: Array) -> Array:
    """Means (n_faces, 3) of the corners of faces [m], summed in their order."""
    count = np.diff(corner_start)
    total = np.zeros((len(count), 3))
    for k in range(count.max(initial=0)):
        more = count > k
        total[more] += corner_x[corner_start[:-1][more] + k]
    return total / count[:, None]


def few_convex(
    face_start: Ints, corner_start: Ints, corner_x: Array, normal: Array, thickness: Array, room: Array
) -> None:
    """Thickness (n_faces,) of closed convex blocks behind faces and depth `room` (n_blocks,) of a point of them [m].

    The same as `kernels.thickness` (extent behind every face) and `kernels.deepest` (largest ball that touches a face
    at its middle); the cost grows with the square of the faces of a block.
    """
    n_faces = np.diff(face_start)
    block: Any = np.repeat(np.arange(len(n_faces)), n_faces)
    first, begin = face_start[block], corner_start[face_start[block]]
    n_corners = corner_start[face_start[block + 1]] - begin
    own = corner_x[corner_start[:-1]]
    thickness[:] = 0.0
    for k in range(n_corners.max(initial=0)):  # of a block with fewer corners the last one once more
        corner = corner_x[begin + np.minimum(k, n_corners - 1)]
        np.maximum(thickness, _along(normal, own - corner), out=thickness)
    middle, radius = _middles(corner_start, corner_x), np.full(len(block), np.inf)
    for k in range(n_faces.max(initial=0)):
        other = first + np.minimum(k, n_faces[block] - 1)
        slope = _along(normal, normal[other])
        use = (other != np.arange(len(block))) & (slope <= 1.0 - 1e-9)
        height = _along(normal[other], own[other] - middle)
        t = height[use] / (1.0 - slope[use])
        radius[use] = np.minimum(radius[use], t)
    room[:] = 0.0
    np.maximum.at(room, block, np.where(radius < np.inf, radius, 0.0))
