"""Small strain in a rotating frame: polar decomposition, block frames, symmetric 3x3 block rows.

The energy of a block is ``E(x) = 1/2 y.K y + p.y`` with ``y_a = R^T (x_a - c) - X_a``; R(x) is the polar
rotation of the average deformation ``A = sum (x_a - c) b_a^T = R U``, where ``b_a = w_a D^-1 X_a``,
``D = sum w_a X_a X_a^T``, and the X_a are taken from the weighted centre. With ``g = K y + p`` and the torque
``tau = sum R^T(x_a - c) x g_a`` the exact gradient is

    dE/dx_a = R (g_a - h x b_a),    h = (tr(U) I - U)^-1 tau,

because ``(tr(U) I - U) dtheta = sum b_a x R^T dx_a``. Force and torque then add up to zero identically.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel


@kernel
def _polar(F, R):
    """Write the rotation of ``F = R U`` to R by scaled Newton: ``R <- (s R + R^-T / s) / 2``.

    N. J. Higham, Computing the polar decomposition, SIAM J. Sci. Stat. Comput. 7 (1986), algorithm 3.3.
    """
    a, b, c = F[0, 0], F[0, 1], F[0, 2]
    d, e, f = F[1, 0], F[1, 1], F[1, 2]
    g, h, i = F[2, 0], F[2, 1], F[2, 2]
    for _sweep in range(40):
        # cofactor matrix: det times the inverse transpose
        ca, cb, cc = e * i - f * h, f * g - d * i, d * h - e * g
        cd, ce, cf = c * h - b * i, a * i - c * g, b * g - a * h
        cg, ch, ci = b * f - c * e, c * d - a * f, a * e - b * d
        det = a * ca + b * cb + c * cc
        if not abs(det) > 0.0:
            break
        size = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + i * i
        inverse = ca * ca + cb * cb + cc * cc + cd * cd + ce * ce + cf * cf + cg * cg + ch * ch + ci * ci
        inverse /= det * det
        s = 1.0
        if abs(size - 3.0) + abs(inverse - 3.0) > 0.1:
            s = math.sqrt(math.sqrt(inverse / size))
        p = 0.5 * s
        q = 0.5 / (s * det)
        change = (p * a + q * ca - a) ** 2 + (p * b + q * cb - b) ** 2 + (p * c + q * cc - c) ** 2
        change += (p * d + q * cd - d) ** 2 + (p * e + q * ce - e) ** 2 + (p * f + q * cf - f) ** 2
        change += (p * g + q * cg - g) ** 2 + (p * h + q * ch - h) ** 2 + (p * i + q * ci - i) ** 2
        a, b, c = p * a + q * ca, p * b + q * cb, p * c + q * cc
        d, e, f = p * d + q * cd, p * e + q * ce, p * f + q * cf
        g, h, i = p * g + q * cg, p * h + q * ch, p * i + q * ci
        if change < 1e-17:  # quadratic: the step just made is exact to round-off
            break
    R[0, 0], R[0, 1], R[0, 2] = a, b, c
    R[1, 0], R[1, 1], R[1, 2] = d, e, f
    R[2, 0], R[2, 1], R[2, 2] = g, h, i


@kernel
def polar_rotations(F, R):
    """Rotations R (n, 3, 3) of the polar decompositions of F (n, 3, 3)."""
    for k in range(F.shape[0]):
        _polar(F[k], R[k])


@kernel
def corotate(x, X, weight, arm, start, stop, R, stretch, y):
    """Frames and local displacements of blocks.

    ==============  ==================  =========================================================
    x               (n, 3)              positions [m]
    X               (n, 3)              reference positions from the block's weighted centre [m]
    weight          (n,)                weights, 1 in sum over a block
    arm             (n, 3)              ``b_a = w_a D^-1 X_a`` [1/m]
    start, stop     (n_blocks,) int32   rows of every block
    R, stretch      (n_blocks, 3, 3)    out: rotation and U
    y               (n, 3) out          displacement in the block's frame [m]
    ==============  ==================  =========================================================
    """
    A = np.empty((3, 3))
    for k in range(start.size):
        # a gridpoint as base keeps the sums as accurate as the block's size, wherever it is
        base = start[k]
        ox, oy, oz = x[base, 0], x[base, 1], x[base, 2]
        cx = cy = cz = 0.0
        a00 = a01 = a02 = a10 = a11 = a12 = a20 = a21 = a22 = 0.0
        for i in range(start[k], stop[k]):
            px, py, pz = x[i, 0] - ox, x[i, 1] - oy, x[i, 2] - oz
            w, b0, b1, b2 = weight[i], arm[i, 0], arm[i, 1], arm[i, 2]
            cx += w * px
            cy += w * py
            cz += w * pz
            a00 += px * b0
            a01 += px * b1
            a02 += px * b2
            a10 += py * b0
            a11 += py * b1
            a12 += py * b2
            a20 += pz * b0
            a21 += pz * b1
            a22 += pz * b2
        A[0, 0], A[0, 1], A[0, 2] = a00, a01, a02
        A[1, 0], A[1, 1], A[1, 2] = a10, a11, a12
        A[2, 0], A[2, 1], A[2, 2] = a20, a21, a22
        _polar(A, R[k])
        r00, r01, r02 = R[k, 0, 0], R[k, 0, 1], R[k, 0, 2]
        r10, r11, r12 = R[k, 1, 0], R[k, 1, 1], R[k, 1, 2]
        r20, r21, r22 = R[k, 2, 0], R[k, 2, 1], R[k, 2, 2]
        for j in range(3):
            stretch[k, 0, j] = r00 * A[0, j] + r10 * A[1, j] + r20 * A[2, j]
            stretch[k, 1, j] = r01 * A[0, j] + r11 * A[1, j] + r21 * A[2, j]
            stretch[k, 2, j] = r02 * A[0, j] + r12 * A[1, j] + r22 * A[2, j]
        for i in range(start[k], stop[k]):
            px = x[i, 0] - ox - cx
            py = x[i, 1] - oy - cy
            pz = x[i, 2] - oz - cz
            y[i, 0] = r00 * px + r10 * py + r20 * pz - X[i, 0]
            y[i, 1] = r01 * px + r11 * py + r21 * pz - X[i, 1]
            y[i, 2] = r02 * px + r12 * py + r22 * pz - X[i, 2]


@kernel
def _block_rows(row_start, column, diagonal, upper, y, count, window):
    """Add the symmetric product of some rows with y to a window; all arrays start at the first of these rows.

    ==============  ==================  =========================================================
    row_start       (n + 1,) uint32     blocks right of the diagonal of every row, places in ``upper``
    column          (nnz,) uint32       their column, counted from the first row, larger than the row's own;
                                        unsigned, because a signed index costs
                                        a test for Python's negative indices: a third of the run time here
    diagonal        (n, 6)              diagonal blocks, 00 11 22 12 02 01 [N/m]
    upper           (nnz, 9)            blocks right of the diagonal, by rows [N/m]
    y               (n, 3)              displacements [m]
    ==============  ==================  =========================================================
    """
    for i in range(count):
        u0, u1, u2 = y[i, 0], y[i, 1], y[i, 2]
        s0 = diagonal[i, 0] * u0 + diagonal[i, 5] * u1 + diagonal[i, 4] * u2
        s1 = diagonal[i, 5] * u0 + diagonal[i, 1] * u1 + diagonal[i, 3] * u2
        s2 = diagonal[i, 4] * u0 + diagonal[i, 3] * u1 + diagonal[i, 2] * u2
        for k in range(row_start[i], row_start[i + 1]):
            j = column[k]
            v0, v1, v2 = y[j, 0], y[j, 1], y[j, 2]
            b0, b1, b2 = upper[k, 0], upper[k, 1], upper[k, 2]
            b3, b4, b5 = upper[k, 3], upper[k, 4], upper[k, 5]
            b6, b7, b8 = upper[k, 6], upper[k, 7], upper[k, 8]
            s0 += b0 * v0 + b1 * v1 + b2 * v2
            s1 += b3 * v0 + b4 * v1 + b5 * v2
            s2 += b6 * v0 + b7 * v1 + b8 * v2
            window[j, 0] += b0 * u0 + b3 * u1 + b6 * u2
            window[j, 1] += b1 * u0 + b4 * u1 + b7 * u2
            window[j, 2] += b2 * u0 + b5 * u1 + b8 * u2
        window[i, 0] += s0
        window[i, 1] += s1
        window[i, 2] += s2


@kernel
def block_row_chunks(row_start, column, diagonal, upper, y, chunk_row, window_start, windows, lo, hi):
    """Fill the windows of chunks lo..hi of rows, bounded by ``chunk_row``, with their part of K y."""
    for c in range(lo, hi):
        window = windows[window_start[c] : window_start[c + 1]]
        window[:, :] = 0.0
        row = chunk_row[c]
        count = chunk_row[c + 1] - row
        _block_rows(row_start[row:], column, diagonal[row:], upper, y[row:], count, window)


@kernel
def add_windows(chunk_row, window_start, windows, g):
    """``g += windows``, chunk after chunk."""
    for c in range(window_start.size - 1):
        row = chunk_row[c]
        for k in range(window_start[c], window_start[c + 1]):
            g[row, 0] += windows[k, 0]
            g[row, 1] += windows[k, 1]
            g[row, 2] += windows[k, 2]
            row += 1


@kernel
def block_row_product(row_start, column, diagonal, upper, y, chunk_row, window_start, windows, g):
    """``g += K y`` on one thread, window by window: the same sums as `block_row_chunks` and `add_windows`."""
    for c in range(window_start.size - 1):
        window = windows[window_start[c] : window_start[c + 1]]
        window[:, :] = 0.0
        row = chunk_row[c]
        count = chunk_row[c + 1] - row
        _block_rows(row_start[row:], column, diagonal[row:], upper, y[row:], count, window)
        add_windows(chunk_row[c : c + 1], window_start[c : c + 2], windows, g)


@kernel
def corotated_force(X, arm, start, stop, R, stretch, y, g, f):
    """``f -= R (g_a - h x b_a)``: the exact gradient of the energy (see the head of this file)."""
    for k in range(start.size):
        t0 = t1 = t2 = 0.0
        for i in range(start[k], stop[k]):
            z0, z1, z2 = y[i, 0] + X[i, 0], y[i, 1] + X[i, 1], y[i, 2] + X[i, 2]
            t0 += z1 * g[i, 2] - z2 * g[i, 1]
            t1 += z2 * g[i, 0] - z0 * g[i, 2]
            t2 += z0 * g[i, 1] - z1 * g[i, 0]
        U = stretch[k]
        # M = tr(U) I - U, symmetric; solve M h = tau by cofactors
        m00, m11, m22 = U[1, 1] + U[2, 2], U[0, 0] + U[2, 2], U[0, 0] + U[1, 1]
        m01 = -0.5 * (U[0, 1] + U[1, 0])
        m02 = -0.5 * (U[0, 2] + U[2, 0])
        m12 = -0.5 * (U[1, 2] + U[2, 1])
        k00, k01, k02 = m11 * m22 - m12 * m12, m02 * m12 - m01 * m22, m01 * m12 - m02 * m11
        k11, k12, k22 = m00 * m22 - m02 * m02, m01 * m02 - m00 * m12, m00 * m11 - m01 * m01
        det = m00 * k00 + m01 * k01 + m02 * k02
        h0 = (k00 * t0 + k01 * t1 + k02 * t2) / det
        h1 = (k01 * t0 + k11 * t1 + k12 * t2) / det
        h2 = (k02 * t0 + k12 * t1 + k22 * t2) / det
        Q = R[k]
        for i in range(start[k], stop[k]):
            b0, b1, b2 = arm[i, 0], arm[i, 1], arm[i, 2]
            g0 = g[i, 0] - (h1 * b2 - h2 * b1)
            g1 = g[i, 1] - (h2 * b0 - h0 * b2)
            g2 = g[i, 2] - (h0 * b1 - h1 * b0)
            f[i, 0] -= Q[0, 0] * g0 + Q[0, 1] * g1 + Q[0, 2] * g2
            f[i, 1] -= Q[1, 0] * g0 + Q[1, 1] * g1 + Q[1, 2] * g2
            f[i, 2] -= Q[2, 0] * g0 + Q[2, 1] * g1 + Q[2, 2] * g2
