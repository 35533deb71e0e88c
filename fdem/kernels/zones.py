"""Constant-strain tetrahedra at large rotation: St. Venant-Kirchhoff forces, energy, deformation.

A zone stores the gradients of its last three shape functions (the first is minus their sum) with the
Lame constants times its volume, so that nothing is recomputed in the loop. Zones are visited in fixed
chunks; each chunk adds into its own window of gridpoint forces and the windows are added up in the order
of the chunks, so that the bits do not depend on who computed which chunk.

Arguments shared by the kernels of this file:

==============  ==================  =====================================================================
x               (n_gp, 3) float64   positions [m]
nodes           (n, 4, L) int       gridpoints of every zone, L zones side by side (the last ones of the last are
                                    empty); unsigned (uint32) indices save the test for Python's negative ones
table           (n, 11, L) float64  gradients of shape functions 1, 2, 3 [1/m], lambda V, mu V [N m]
stress0         (n L, 6) float64    V times the initial 2nd Piola-Kirchhoff stress, xx yy zz yz zx xy [N m]
chunk_start     (n_chunks + 1,)     rows of `nodes` of a chunk, int32
chunk_gp        (n_chunks,) uint32  first gridpoint of the chunk's window
window_start    (n_chunks + 1,)     where a chunk's window starts in ``windows``, int32
windows         (n, 3) float64      internal forces of the windows [N]
f               (n_gp, 3) float64   forces, the internal force is subtracted [N]
==============  ==================  =====================================================================
"""

from __future__ import annotations

import numpy as np

from fdem._jit import kernel

L = 16  # zones computed side by side


@kernel
def _stress_lanes(work):
    """``f_a = V F S G_a`` of L zones at once: edges in rows 0-8 of `work`, their table in 9-19, forces in 20-28.

    One array only: its rows are a constant distance apart, so that the compiler sees that stores do not meet loads, and
    computes the lanes side by side.
    """
    for lane in range(L):
        ax, ay, az = work[lane], work[L + lane], work[2 * L + lane]
        bx, by, bz = work[3 * L + lane], work[4 * L + lane], work[5 * L + lane]
        cx, cy, cz = work[6 * L + lane], work[7 * L + lane], work[8 * L + lane]
        g10, g11, g12 = work[9 * L + lane], work[10 * L + lane], work[11 * L + lane]
        g20, g21, g22 = work[12 * L + lane], work[13 * L + lane], work[14 * L + lane]
        g30, g31, g32 = work[15 * L + lane], work[16 * L + lane], work[17 * L + lane]
        f00 = ax * g10 + bx * g20 + cx * g30
        f01 = ax * g11 + bx * g21 + cx * g31
        f02 = ax * g12 + bx * g22 + cx * g32
        f10 = ay * g10 + by * g20 + cy * g30
        f11 = ay * g11 + by * g21 + cy * g31
        f12 = ay * g12 + by * g22 + cy * g32
        f20 = az * g10 + bz * g20 + cz * g30
        f21 = az * g11 + bz * g21 + cz * g31
        f22 = az * g12 + bz * g22 + cz * g32
        c00 = f00 * f00 + f10 * f10 + f20 * f20 - 1.0
        c11 = f01 * f01 + f11 * f11 + f21 * f21 - 1.0
        c22 = f02 * f02 + f12 * f12 + f22 * f22 - 1.0
        mu = work[19 * L + lane]
        pressure = 0.5 * work[18 * L + lane] * (c00 + c11 + c22)
        s00 = pressure + mu * c00
        s11 = pressure + mu * c11
        s22 = pressure + mu * c22
        s12 = mu * (f01 * f02 + f11 * f12 + f21 * f22)
        s02 = mu * (f00 * f02 + f10 * f12 + f20 * f22)
        s01 = mu * (f00 * f01 + f10 * f11 + f20 * f21)
        # S G_a first: three vectors, then F times each
        t0 = s00 * g10 + s01 * g11 + s02 * g12
        t1 = s01 * g10 + s11 * g11 + s12 * g12
        t2 = s02 * g10 + s12 * g11 + s22 * g12
        work[20 * L + lane] = f00 * t0 + f01 * t1 + f02 * t2
        work[21 * L + lane] = f10 * t0 + f11 * t1 + f12 * t2
        work[22 * L + lane] = f20 * t0 + f21 * t1 + f22 * t2
        t0 = s00 * g20 + s01 * g21 + s02 * g22
        t1 = s01 * g20 + s11 * g21 + s12 * g22
        t2 = s02 * g20 + s12 * g21 + s22 * g22
        work[23 * L + lane] = f00 * t0 + f01 * t1 + f02 * t2
        work[24 * L + lane] = f10 * t0 + f11 * t1 + f12 * t2
        work[25 * L + lane] = f20 * t0 + f21 * t1 + f22 * t2
        t0 = s00 * g30 + s01 * g31 + s02 * g32
        t1 = s01 * g30 + s11 * g31 + s12 * g32
        t2 = s02 * g30 + s12 * g31 + s22 * g32
        work[26 * L + lane] = f00 * t0 + f01 * t1 + f02 * t2
        work[27 * L + lane] = f10 * t0 + f11 * t1 + f12 * t2
        work[28 * L + lane] = f20 * t0 + f21 * t1 + f22 * t2


@kernel
def _force(x, nodes, table, start, stop, gp0, window):
    """Add the internal forces of the zones of lanes start..stop to a window: ``f_a = V F S G_a``, ``S = C : E``."""
    work = np.empty(29 * L)
    for b in range(start, stop):
        for lane in range(L):
            i0, i1, i2, i3 = nodes[b, 0, lane], nodes[b, 1, lane], nodes[b, 2, lane], nodes[b, 3, lane]
            for k in range(3):
                o = x[i0, k]
                work[k * L + lane] = x[i1, k] - o
                work[(3 + k) * L + lane] = x[i2, k] - o
                work[(6 + k) * L + lane] = x[i3, k] - o
        for k in range(11):
            for lane in range(L):
                work[(9 + k) * L + lane] = table[b, k, lane]
        _stress_lanes(work)
        for lane in range(L):
            i0, i1, i2, i3 = nodes[b, 0, lane], nodes[b, 1, lane], nodes[b, 2, lane], nodes[b, 3, lane]
            for k in range(3):
                p, q, r = work[(20 + k) * L + lane], work[(23 + k) * L + lane], work[(26 + k) * L + lane]
                window[i0 - gp0, k] -= p + q + r
                window[i1 - gp0, k] += p
                window[i2 - gp0, k] += q
                window[i3 - gp0, k] += r


@kernel
def _initial_force(x, nodes, table, stress0, start, stop, gp0, window):
    """Add ``V F S0 G_a``: the part of the internal force that the in-situ stress makes."""
    for e in range(start * L, stop * L):
        b, lane = e // L, e % L
        i0 = nodes[b, 0, lane]
        s00, s11, s22 = stress0[e, 0], stress0[e, 1], stress0[e, 2]
        s12, s02, s01 = stress0[e, 3], stress0[e, 4], stress0[e, 5]
        t = np.empty(9)
        for a in range(3):
            g0, g1, g2 = table[b, 3 * a, lane], table[b, 3 * a + 1, lane], table[b, 3 * a + 2, lane]
            t[3 * a] = s00 * g0 + s01 * g1 + s02 * g2
            t[3 * a + 1] = s01 * g0 + s11 * g1 + s12 * g2
            t[3 * a + 2] = s02 * g0 + s12 * g1 + s22 * g2
        for c in range(3):
            o = x[i0, c]
            d1 = x[nodes[b, 1, lane], c] - o
            d2 = x[nodes[b, 2, lane], c] - o
            d3 = x[nodes[b, 3, lane], c] - o
            fc0 = d1 * table[b, 0, lane] + d2 * table[b, 3, lane] + d3 * table[b, 6, lane]
            fc1 = d1 * table[b, 1, lane] + d2 * table[b, 4, lane] + d3 * table[b, 7, lane]
            fc2 = d1 * table[b, 2, lane] + d2 * table[b, 5, lane] + d3 * table[b, 8, lane]
            p1 = fc0 * t[0] + fc1 * t[1] + fc2 * t[2]
            p2 = fc0 * t[3] + fc1 * t[4] + fc2 * t[5]
            p3 = fc0 * t[6] + fc1 * t[7] + fc2 * t[8]
            window[i0 - gp0, c] -= p1 + p2 + p3
            window[nodes[b, 1, lane] - gp0, c] += p1
            window[nodes[b, 2, lane] - gp0, c] += p2
            window[nodes[b, 3, lane] - gp0, c] += p3


@kernel
def stvk_chunks(x, nodes, table, stress0, chunk_start, chunk_gp, window_start, windows, lo, hi):
    """Fill the windows of chunks lo..hi with internal forces (``stress0`` may have no rows)."""
    for c in range(lo, hi):
        window = windows[window_start[c] : window_start[c + 1]]
        window[:, :] = 0.0
        _force(x, nodes, table, chunk_start[c], chunk_start[c + 1], chunk_gp[c], window)
        if stress0.shape[0]:
            _initial_force(x, nodes, table, stress0, chunk_start[c], chunk_start[c + 1], chunk_gp[c], window)


@kernel
def subtract_windows(chunk_gp, window_start, windows, f):
    """``f -= windows``, chunk after chunk."""
    for c in range(chunk_gp.size):
        gp = chunk_gp[c]
        for k in range(window_start[c], window_start[c + 1]):
            f[gp, 0] -= windows[k, 0]
            f[gp, 1] -= windows[k, 1]
            f[gp, 2] -= windows[k, 2]
            gp += 1


@kernel
def stvk_force(x, nodes, table, stress0, chunk_start, chunk_gp, window_start, windows, f):
    """`stvk_chunks` and `subtract_windows` on one thread: a window is used up while it is in cache."""
    for c in range(chunk_gp.size):
        stvk_chunks(x, nodes, table, stress0, chunk_start, chunk_gp, window_start, windows, c, c + 1)
        subtract_windows(chunk_gp[c : c + 1], window_start[c : c + 2], windows, f)


@kernel
def stvk_energy(x, nodes, table, stress0, chunk_start):
    """Strain energy [J]: sum of ``lambda V/2 tr(E)^2 + mu V E:E + V S0:E``, chunk sums added in order."""
    total = 0.0
    for c in range(chunk_start.size - 1):
        part = 0.0
        for e in range(chunk_start[c] * L, chunk_start[c + 1] * L):
            b, lane = e // L, e % L
            i0 = nodes[b, 0, lane]
            e00 = e11 = e22 = e12 = e02 = e01 = 0.0
            for k in range(3):
                o = x[i0, k]
                d1 = x[nodes[b, 1, lane], k] - o
                d2 = x[nodes[b, 2, lane], k] - o
                d3 = x[nodes[b, 3, lane], k] - o
                f0 = d1 * table[b, 0, lane] + d2 * table[b, 3, lane] + d3 * table[b, 6, lane]
                f1 = d1 * table[b, 1, lane] + d2 * table[b, 4, lane] + d3 * table[b, 7, lane]
                f2 = d1 * table[b, 2, lane] + d2 * table[b, 5, lane] + d3 * table[b, 8, lane]
                e00 += f0 * f0
                e11 += f1 * f1
                e22 += f2 * f2
                e12 += f1 * f2
                e02 += f0 * f2
                e01 += f0 * f1
            e00, e11, e22 = 0.5 * (e00 - 1.0), 0.5 * (e11 - 1.0), 0.5 * (e22 - 1.0)
            trace = e00 + e11 + e22
            # e12, e02, e01 are engineering shears: E:E = sum e_ii^2 + 2 (e_ij / 2)^2
            square = e00 * e00 + e11 * e11 + e22 * e22 + 0.5 * (e12 * e12 + e02 * e02 + e01 * e01)
            part += 0.5 * table[b, 9, lane] * trace * trace + table[b, 10, lane] * square
            if stress0.shape[0]:
                part += stress0[e, 0] * e00 + stress0[e, 1] * e11 + stress0[e, 2] * e22
                part += stress0[e, 3] * e12 + stress0[e, 4] * e02 + stress0[e, 5] * e01
        total += part
    return total


@kernel
def deformation(x, nodes, gradients, F):
    """Deformation gradients ``F = sum x_a (x) G_a`` (m, 3, 3); ``gradients`` is (m, 9) or wider."""
    for e in range(nodes.shape[0]):
        for k in range(3):
            o = x[nodes[e, 0], k]
            d1 = x[nodes[e, 1], k] - o
            d2 = x[nodes[e, 2], k] - o
            d3 = x[nodes[e, 3], k] - o
            for j in range(3):
                F[e, k, j] = d1 * gradients[e, j] + d2 * gradients[e, 3 + j] + d3 * gradients[e, 6 + j]


@kernel
def first_inverted(x, nodes):
    """Return the first zone whose present volume is not positive (NaN included), or -1."""
    for e in range(nodes.shape[0]):
        i0, i1, i2, i3 = nodes[e, 0], nodes[e, 1], nodes[e, 2], nodes[e, 3]
        ox, oy, oz = x[i0, 0], x[i0, 1], x[i0, 2]
        ax, ay, az = x[i1, 0] - ox, x[i1, 1] - oy, x[i1, 2] - oz
        bx, by, bz = x[i2, 0] - ox, x[i2, 1] - oy, x[i2, 2] - oz
        cx, cy, cz = x[i3, 0] - ox, x[i3, 1] - oy, x[i3, 2] - oz
        six_volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        if not six_volume > 0.0:
            return e
    return -1


@kernel
def shape_gradients(X, nodes, gradients, volume):
    """Gradients of shape functions 1, 2, 3 (m, 9) [1/m] and signed volumes (m,) [m^3] in closed form.

    The inverse of the edge matrix ``[a b c]``: ``G_1 = b x c / (6 V)`` and cyclic.
    """
    for e in range(nodes.shape[0]):
        i0, i1, i2, i3 = nodes[e, 0], nodes[e, 1], nodes[e, 2], nodes[e, 3]
        ox, oy, oz = X[i0, 0], X[i0, 1], X[i0, 2]
        ax, ay, az = X[i1, 0] - ox, X[i1, 1] - oy, X[i1, 2] - oz
        bx, by, bz = X[i2, 0] - ox, X[i2, 1] - oy, X[i2, 2] - oz
        cx, cy, cz = X[i3, 0] - ox, X[i3, 1] - oy, X[i3, 2] - oz
        ux, uy, uz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        det = ax * ux + ay * uy + az * uz
        volume[e] = det / 6.0
        gradients[e, 0], gradients[e, 1], gradients[e, 2] = ux / det, uy / det, uz / det
        gradients[e, 3] = (cy * az - cz * ay) / det
        gradients[e, 4] = (cz * ax - cx * az) / det
        gradients[e, 5] = (cx * ay - cy * ax) / det
        gradients[e, 6] = (ay * bz - az * by) / det
        gradients[e, 7] = (az * bx - ax * bz) / det
        gradients[e, 8] = (ax * by - ay * bx) / det
