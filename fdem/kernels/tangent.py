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
def _answer(rows, push, area, response, w, foot, normal, row, dF):
    """Derivatives (3, 7, 3) of the force of `row` through depth and slip at the points `rows` of its patch."""
    for d in range(3):
        for n in range(7):
            for k in range(3):
                dF[d, n, k] = 0.0
    for q in range(3):
        if not (response[row, q] != 0.0).any():
            continue
        for d in range(3):
            sink = area[row] * (response[row, q, 1 + d, 0] - push[d] * response[row, q, 0, 0])
            for k in range(3):
                inner = area[row] * (response[row, q, 1 + d, 1 + k] - push[d] * response[row, q, 0, 1 + k])
                for n in range(7):
                    dF[d, n, k] += inner * w[rows + q, n] - sink * normal[k] * foot[q, n]


@kernel
def _spread(i, row, w, foot, dF, turn, shift, force, normal, gradients, height, out):
    """Add the derivatives of one row's force, given to the gridpoints of slave and master, to ``out[i]``.

    On the master the part along the face normal acts at the foot of the point, the rest at the point itself.
    """
    plane, dn, across = np.empty((4, 3)), np.zeros((3, 7, 3)), 0.0
    for d in range(3):
        across += normal[d] * force[d]
    for m in range(4):  # gradients within the face
        along = normal[0] * gradients[m, 0] + normal[1] * gradients[m, 1] + normal[2] * gradients[m, 2]
        for d in range(3):
            plane[m, d] = gradients[m, d] - along * normal[d] if m < 3 else 0.0
    for n in range(7):
        for k in range(3):
            for d in range(3):
                if n < 3:
                    for j in range(3):
                        dF[d, n, k] += turn[d, j] * shift[n, j, k]
                else:
                    dn[d, n, k] = -plane[n - 3, d] * normal[k]
    for n in range(7):
        for k in range(3):
            along = normal[0] * dF[0, n, k] + normal[1] * dF[1, n, k] + normal[2] * dF[2, n, k]
            bent = dn[0, n, k] * force[0] + dn[1, n, k] * force[1] + dn[2, n, k] * force[2]
            for m in range(7):
                gap = foot[m] - w[row, m] if m >= 3 else 0.0
                slide, roll = 0.0, 0.0
                if m >= 3:
                    slide = gradients[m - 3, k] * w[row, n]
                    roll = plane[m - 3, k] * foot[n]
                    for j in range(3):
                        roll += height * plane[m - 3, j] * dn[j, n, k]
                for d in range(3):
                    value = w[row, m] * dF[d, n, k] + gap * normal[d] * along
                    value -= (force[d] - across * normal[d]) * slide + across * normal[d] * roll
                    value += gap * (dn[d, n, k] * across + normal[d] * bent)
                    out[i, m, d, n, k] += value


@kernel
def contact_tangent(gp, active, thick, x, w, area, push, face_normal, traction, response, out):
    """Derivatives of the forces on the gridpoints of every patch with respect to their positions.

    | argument | shape | unit | |
    |---|---|---|---|
    | gp, active, thick, push, face_normal | | | as in `patches.fill_rows` |
    | w, area, traction | (3 n, 7), (3 n,), (3 n, 4) | | rows, as the joint laws left them |
    | response | (3 n, 3, 4, 4) | Pa/m | derivatives of (pressure, shear traction) by (depth, slip) at 3 points |
    | out | (n, 7, 3, 7, 3) | N/m | out: d force of gridpoint (a, i) / d position of gridpoint (b, j) |

    Notes
    -----
    Force on the slave at a point, ``F = a t - p A`` with the area vector ``A = a n_a``, and the opposite at the same
    place on the master. The slip is the relative motion ``du = sum w dx``; the depth changes with the motion of the
    point against its foot on the master face, the area vector with the slave's edges, and the weights on the master
    with ``grad w . du``. Where contact ends the pressure is zero, so that the moving border adds nothing.
    """
    gradients, dF, turn = np.empty((4, 3)), np.empty((3, 7, 3)), np.empty((3, 3))
    force, height, shift, foot = np.empty(3), np.empty(3), np.empty((3, 3, 3)), np.empty((3, 7))
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
            q = row - 3 * i
            height[q] = 0.0
            for d in range(3):
                at = w[row, 0] * x[a, d] + w[row, 1] * x[b, d] + w[row, 2] * x[c, d]
                height[q] += face_normal[i, d] * (x[gp[i, 3], d] - at)
            for m in range(7):
                foot[q, m] = w[row, m]
                if m >= 3:
                    for d in range(3):
                        foot[q, m] -= gradients[m - 3, d] * face_normal[i, d] * height[q]
        for row in range(3 * i, 3 * i + 3):
            q, pressure = row - 3 * i, traction[row, 0]
            for d in range(3):
                force[d] = area[row] * (traction[row, 1 + d] - pressure * push[i, d])
                for k in range(3):
                    turn[d, k] = traction[row, 1 + d] * push[i, k] - (pressure if d == k else 0.0)
            _answer(3 * i, push[i], area, response, w, foot, face_normal[i], row, dF)
            # d A / d position of the slave's gridpoints, times area / |e1 x e2|
            share = area[row] / double
            for d in range(3):
                unit = np.zeros(3)
                unit[d] = share
                second, third = np.cross(unit, e2), np.cross(e1, unit)
                for k in range(3):
                    shift[1, k, d], shift[2, k, d] = second[k], third[k]
                    shift[0, k, d] = -second[k] - third[k]
            _spread(i, row, w, foot[q], dF, turn, shift, force, face_normal[i], gradients, height[q], out)
