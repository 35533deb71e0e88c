"""Structured tetrahedral meshes for the verification cases: six tetrahedra per cell (Kuhn)."""

from __future__ import annotations

import numpy as np
from stress.meshes import box, box_mesh

import fdem

__all__ = ["box", "box_mesh", "plane", "quarter_ring"]


def quarter_ring(radial, around, inner, outer, depth, layers=1):
    """Quarter ring in x, y > 0 (axis z): a structured box mesh bent round; radial spacing is uniform."""
    points, tets = box_mesh((radial, around, layers), (1.0, 1.0, depth))
    r, angle = inner + points[:, 0] * (outer - inner), 0.5 * np.pi * points[:, 1]
    flat = np.column_stack([r * np.cos(angle), r * np.sin(angle), points[:, 2]])
    # the straight edges lie exactly in the planes of symmetry
    flat[points[:, 1] == 1.0, 0] = 0.0
    flat[points[:, 1] == 0.0, 1] = 0.0
    return fdem.tet_mesh(flat, tets)


def plane(axis, value):
    """Selector of what lies in the plane ``x[axis] = value`` (a face's centroid or a gridpoint)."""
    return lambda x: np.abs(x[:, axis] - value) < 1e-9
