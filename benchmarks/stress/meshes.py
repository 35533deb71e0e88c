"""Structured tetrahedral meshes: six tetrahedra per cell (Kuhn)."""

from __future__ import annotations

import itertools

import numpy as np

import fdem


def box_mesh(cells, upper, lower=(0.0, 0.0, 0.0), jitter=0.0, seed=0):
    """Points (n, 3) and tets (m, 4) of a box of ``cells`` cells; inner points moved by `jitter` cell sizes."""
    cells, lower, upper = np.asarray(cells), np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in cells), indexing="ij"), -1).reshape(-1, 3)
    points = lower + grid / cells * (upper - lower)
    if jitter:
        inside = np.all((grid > 0) & (grid < cells), axis=1)
        shift = np.random.default_rng(seed).uniform(-jitter, jitter, (int(inside.sum()), 3))
        points[inside] += shift * (upper - lower) / cells
    corner = np.stack(np.meshgrid(*(np.arange(n) for n in cells), indexing="ij"), -1).reshape(-1, 3)
    paths = []
    for order in itertools.permutations(range(3)):
        step = np.zeros((4, 3), dtype=int)
        for k, axis in enumerate(order, start=1):
            step[k] = step[k - 1]
            step[k, axis] += 1
        paths.append(corner[:, None, :] + step)
    tets = np.stack(paths, axis=1).reshape(-1, 4, 3)
    return points, (tets[..., 0] * (cells[1] + 1) + tets[..., 1]) * (cells[2] + 1) + tets[..., 2]


def box(cells, upper, lower=(0.0, 0.0, 0.0), jitter=0.0, seed=0):
    """Shape of `box_mesh`."""
    return fdem.tet_mesh(*box_mesh(cells, upper, lower, jitter, seed))
