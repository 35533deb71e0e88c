"""The tangent of contact forces against differences of the forces, at any tilt, partly open, rigid and zoned."""

from __future__ import annotations

import numpy as np
import pytest
from contact_tools import World, box, coulomb, grid_box, move, rotation

from fdem.kernels.tangent import contact_tangent

KN = 1e9
TILTS = {
    "face": np.eye(3),
    "tilted face": rotation([1, 0.3, 0], 0.1),
    "edge": rotation([1, 0, 0], 0.7),
    "corner": rotation([1, -1, 0.1], 0.9),
}


def tangent(w):
    """Dense derivative (n_gp, 3, n_gp, 3) of the contact forces by the positions, no friction."""
    c, p = w.contacts, w.contacts.patches
    response = np.zeros((3 * len(p), 3, 4, 4))
    for q in range(3):
        response[q::3, q, 0, 0] = KN
    blocks = np.zeros((len(p), 7, 3, 7, 3))
    contact_tangent(
        p.gp, c._active, c._thick, w.x, c._w, c._area, c._push, c._face_normal, c._traction, response, blocks
    )
    matrix = np.zeros((len(w.x), 3, len(w.x), 3))
    for gp, block in zip(p.gp, blocks, strict=True):
        for a in range(7):
            for b in range(7):
                matrix[gp[a], :, gp[b], :] += block[a, :, b, :]
    return matrix


def worst(w):
    """Largest difference, relative, for motions of either block as a whole and of single gridpoints."""
    w.forces()
    matrix, x, g, e = tangent(w), w.x.copy(), np.random.default_rng(0), 1e-7
    errors = []
    for kind in ("first", "second", "gridpoints"):
        du = g.normal(size=x.shape)
        if kind != "gridpoints":
            block = 0 if kind == "first" else 1
            mine = slice(w.start[block], w.start[block + 1])
            du[:] = 0.0
            du[mine] = g.normal(size=3) + np.cross(g.normal(size=3), x[mine])
        w.x[:] = x + e * du
        after = w.forces().copy()
        w.x[:] = x - e * du
        difference = (after - w.forces()) / (2 * e)
        w.x[:] = x
        expected = np.einsum("aibj,bj->ai", matrix, du)
        errors.append(np.abs(difference - expected).max() / np.abs(difference).max())
    return max(errors)


# central differences over 1e-7 m: round-off of forces over the step leaves 1e-9, curvature less
@pytest.mark.parametrize("master", ["floor", "cube"])
@pytest.mark.parametrize("tilt", TILTS)
def test_tangent_is_exact_at_any_tilt(tilt, master):
    points, faces = move(box(1, 1, 1), TILTS[tilt])
    if master == "floor":
        other, place = box(4, 4, 1), np.array([0.13, 0.07, 0.5 - 0.03 - points[:, 2].min()])
    else:
        other = move(box(1, 1, 1), rotation([0.2, 0.1, 1], 0.4))
        place = np.array([0.43, 0.37, other[0][:, 2].max() - 0.09 - points[:, 2].min()])
    assert worst(World([(points + place, faces), other], law=coulomb(kn=KN))) < 1e-7


def test_tangent_between_zoned_surfaces():
    points, faces = grid_box(3, 3)
    points = (points - 0.5) @ rotation([1, 0.3, 0], 0.02).T + np.array([0.53, 0.47, 1.48])
    assert worst(World([(points, faces), grid_box(4, 4)], law=coulomb(kn=KN), affine=[False, False])) < 1e-7
