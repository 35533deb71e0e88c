"""Tangent of contact forces: exact for frictionless contact at any tilt, with the law's own response for friction."""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel


@kernel
def _gradients(gp, i, thick, x, out):
    """Gradients (4, 3) [1/m] of the weights of the master gridpoints of patch i."""
    p, q, r, t = gp[i, 3], gp[i, 4], gp[i, 5], gp[i, 6]
    a, b, c = x[q] - x[p], x[r] - x[p], x[t] - x[p]
    if not thick:
        c = np.cross(a, b)
    u, v, s = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    det = a[0] * u[0] + a[1] * u[1] + a[2] * u[2]
    for d in range(3):
        out[1, d], out[2, d] = u[d] / det, v[d] / det
        out[3, d] = s[d] / det if thick else 0.0
        out[0, d] = -out[1, d] - out[2, d] - out[3, d]


@kernel
def contact_tangent(gp, active, thick, x, w, area, push, face_normal, traction, response, out):
    """Derivatives of the forces on the gridpoints of every patch with respect to their positions.

    | argument | shape | unit | |
    |---|---|---|---|
    | gp, active, thick, push, face_normal | | | as in `patches.fill_rows` |
    | w, area, traction | (3 n, 7), (3 n,), (3 n, 4) | | rows, as the joint laws left them |
    | response | (3 n, 4, 4) | Pa/m | derivatives of pressure and shear traction by depth and slip (rows p, t; columns d, s) |
    | out | (n, 7, 3, 7, 3) | N/m | out: d force of gridpoint (a, i) / d position of gridpoint (b, j) |

    Notes
    -----
    Force on the slave at a point, ``F = a t - p A`` with the area vector ``A = a n_a``, and the opposite at the same
    place on the master. The slip is the relative motion ``du = sum w dx``; the depth changes with the motion of the
    point against its foot on the master face, the area vector with the slave's edges, and the weights on the master
    with ``grad w . du``. Where contact ends the pressure is zero, so that the moving border adds nothing.
    """
    gradients, inner, turn = np.empty((4, 3)), np.empty((3, 3)), np.empty((3, 3))
    force, sink, shift, foot = np.empty(3), np.empty(3), np.empty((3, 3, 3)), np.empty(7)
    for i in range(len(gp)):
        out[i] = 0.0
        if active[i] == 0:
            continue
        a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
        e1, e2 = x[b] - x[a], x[c] - x[a]
        cross = np.cross(e1, e2)
        double = math.sqrt(cross[0] ** 2 + cross[1] ** 2 + cross[2] ** 2)
        _gradients(gp, i, thick[i], x, gradients)
        for row in range(3 * i, 3 * i + 3):
            pressure = traction[row, 0]
            for d in range(3):
                force[d] = area[row] * (traction[row, 1 + d] - pressure * push[i, d])
                sink[d] = area[row] * (response[row, 1 + d, 0] - push[i, d] * response[row, 0, 0])
                for k in range(3):
                    inner[d, k] = area[row] * (response[row, 1 + d, 1 + k] - push[i, d] * response[row, 0, 1 + k])
                    turn[d, k] = traction[row, 1 + d] * push[i, k] - (pressure if d == k else 0.0)
            height = 0.0
            for d in range(3):
                at = w[row, 0] * x[a, d] + w[row, 1] * x[b, d] + w[row, 2] * x[c, d]
                height += face_normal[i, d] * (x[gp[i, 3], d] - at)
            for m in range(7):
                foot[m] = w[row, m]
                if m >= 3:
                    for d in range(3):
                        foot[m] -= gradients[m - 3, d] * face_normal[i, d] * height
            # d A / d position of the slave's gridpoints, times area / |e1 x e2|
            share = area[row] / double
            for d in range(3):
                unit = np.zeros(3)
                unit[d] = share
                second, third = np.cross(unit, e2), np.cross(e1, unit)
                for k in range(3):
                    shift[1, k, d], shift[2, k, d] = second[k], third[k]
                    shift[0, k, d] = -second[k] - third[k]
            for m in range(7):
                for n in range(7):
                    for d in range(3):
                        for k in range(3):
                            value = w[row, m] * (inner[d, k] * w[row, n] - sink[d] * face_normal[i, k] * foot[n])
                            if m >= 3:
                                value -= force[d] * gradients[m - 3, k] * w[row, n]
                            if n < 3:
                                for j in range(3):
                                    value += w[row, m] * turn[d, j] * shift[n, j, k]
                            out[i, m, d, n, k] += value
