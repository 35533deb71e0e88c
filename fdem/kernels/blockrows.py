"""Conjugate gradients on the upper half of a symmetric matrix of 3x3 blocks.

| shared argument | shape | |
|---|---|---|
| start | (n + 1,) | blocks of a row: the diagonal one first, then those to its right |
| column | (nb,) | |
| data | (nb, 9) | |
| x, b, ... | (3 n,) | |
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel


@kernel
def product(start, column, data, x, y):
    """``y = A x``."""
    n = len(start) - 1
    for i in range(3 * n):
        y[i] = 0.0
    for i in range(n):
        x0, x1, x2 = x[3 * i], x[3 * i + 1], x[3 * i + 2]
        k = start[i]
        y0 = data[k, 0] * x0 + data[k, 1] * x1 + data[k, 2] * x2
        y1 = data[k, 3] * x0 + data[k, 4] * x1 + data[k, 5] * x2
        y2 = data[k, 6] * x0 + data[k, 7] * x1 + data[k, 8] * x2
        for k in range(start[i] + 1, start[i + 1]):
            j = 3 * column[k]
            z0, z1, z2 = x[j], x[j + 1], x[j + 2]
            a, b, c = data[k, 0], data[k, 1], data[k, 2]
            d, e, f = data[k, 3], data[k, 4], data[k, 5]
            g, h, m = data[k, 6], data[k, 7], data[k, 8]
            y0 += a * z0 + b * z1 + c * z2
            y1 += d * z0 + e * z1 + f * z2
            y2 += g * z0 + h * z1 + m * z2
            y[j] += a * x0 + d * x1 + g * x2
            y[j + 1] += b * x0 + e * x1 + h * x2
            y[j + 2] += c * x0 + f * x1 + m * x2
        y[3 * i] += y0
        y[3 * i + 1] += y1
        y[3 * i + 2] += y2


@kernel
def conjugate_gradients(start, column, data, inverse, b, x, tolerance, most):
    """Solve ``A x = b`` from x = 0, preconditioned by the inverse diagonal blocks `inverse` (n, 9).

    Returns the iterations; negative where the matrix is not positive or `most` were not enough.
    """
    n = len(b)
    r, z, p, y = b.copy(), np.empty(n), np.empty(n), np.empty(n)
    goal, rz = 0.0, 0.0
    for i in range(n):
        x[i], p[i] = 0.0, 0.0
        goal += b[i] * b[i]
    goal *= tolerance * tolerance
    for count in range(1, most + 1):
        old, rz = rz, 0.0
        for i in range(n // 3):
            q = 3 * i
            r0, r1, r2 = r[q], r[q + 1], r[q + 2]
            for d in range(3):
                z[q + d] = inverse[i, 3 * d] * r0 + inverse[i, 3 * d + 1] * r1 + inverse[i, 3 * d + 2] * r2
            rz += r0 * z[q] + r1 * z[q + 1] + r2 * z[q + 2]
        beta = rz / old if count > 1 else 0.0
        for i in range(n):
            p[i] = z[i] + beta * p[i]
        product(start, column, data, p, y)
        curvature = 0.0
        for i in range(n):
            curvature += p[i] * y[i]
        if not curvature > 0.0 or not math.isfinite(curvature):
            return -count
        alpha, left = rz / curvature, 0.0
        for i in range(n):
            x[i] += alpha * p[i]
            r[i] -= alpha * y[i]
            left += r[i] * r[i]
        if left <= goal:
            return count
    return -most
