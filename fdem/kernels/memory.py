"""Kernels over the history of contact points: carried along every step, inherited at a cut (CONTACT.md 3.7).

Rows 3 i .. 3 i + 2 are the points of patch i. Columns 0-2 are elastic slip [m], 3 a flag, 4 slip distance, 5 dilation.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel


@kernel
def _blend(points, i, old, first, w1, w2, memory, row):
    """Memory of `row` at (w1, w2) from the three points of i, rows `first`.. of `old`.

    Clamped barycentric coordinates; the flag (column 3) comes from the nearest point.
    """
    p1, p2 = points[i, 0, 0], points[i, 0, 1]
    a1, a2 = points[i, 1, 0] - p1, points[i, 1, 1] - p2
    b1, b2 = points[i, 2, 0] - p1, points[i, 2, 1] - p2
    c1, c2 = w1 - p1, w2 - p2
    det = a1 * b2 - a2 * b1
    m0, m1, m2 = 1.0, 0.0, 0.0
    if det != 0.0:
        m1 = min(max((c1 * b2 - c2 * b1) / det, 0.0), 1.0)
        m2 = min(max((a1 * c2 - a2 * c1) / det, 0.0), 1.0)
        m0 = min(max(1.0 - (c1 * b2 - c2 * b1) / det - (a1 * c2 - a2 * c1) / det, 0.0), 1.0)
        s = m0 + m1 + m2
        m0, m1, m2 = m0 / s, m1 / s, m2 / s
    near = 0
    if m1 > m0:
        near = 1
    if m2 > max(m0, m1):
        near = 2
    for k in range(memory.shape[1]):
        if k < 3 or k == 4 or k == 5:
            memory[row, k] = m0 * old[first, k] + m1 * old[first + 1, k] + m2 * old[first + 2, k]
        else:
            memory[row, k] = old[first + near, k]


@kernel
def carry_memory(gp, x, x_old, points_old, active_old, memory_old, points, active, memory):
    """Committed memory moved to the new points, its elastic slip turned with the frame of the slave face.

    The frame: first edge e, normal n, their product. A slip s becomes ``sum (s.e_old) e / |e_old||e|`` over the three.
    """
    columns = memory.shape[1]
    for i in range(len(gp)):
        if active[i] == 0:
            continue
        lo = 3 * i
        if active_old[i] == 0:
            for row in range(lo, lo + 3):
                for k in range(columns):
                    memory[row, k] = 0.0
            continue
        a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
        ux, uy, uz = x_old[b, 0] - x_old[a, 0], x_old[b, 1] - x_old[a, 1], x_old[b, 2] - x_old[a, 2]
        hx, hy, hz = x_old[c, 0] - x_old[a, 0], x_old[c, 1] - x_old[a, 1], x_old[c, 2] - x_old[a, 2]
        ox, oy, oz = uy * hz - uz * hy, uz * hx - ux * hz, ux * hy - uy * hx
        vx, vy, vz = uy * oz - uz * oy, uz * ox - ux * oz, ux * oy - uy * ox
        ex, ey, ez = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        hx, hy, hz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        nx, ny, nz = ey * hz - ez * hy, ez * hx - ex * hz, ex * hy - ey * hx
        gx, gy, gz = ey * nz - ez * ny, ez * nx - ex * nz, ex * ny - ey * nx
        s = 1.0 / math.sqrt((ux * ux + uy * uy + uz * uz) * (ex * ex + ey * ey + ez * ez))
        t = 1.0 / math.sqrt((ox * ox + oy * oy + oz * oz) * (nx * nx + ny * ny + nz * nz))
        for row in range(lo, lo + 3):
            w1, w2 = points[i, row - lo, 0], points[i, row - lo, 1]
            if w1 == points_old[i, row - lo, 0] and w2 == points_old[i, row - lo, 1]:
                s0, s1, s2 = memory_old[row, 0], memory_old[row, 1], memory_old[row, 2]
                for k in range(3, 6):  # a constant length, which the compiler unrolls
                    memory[row, k] = memory_old[row, k]
                for k in range(6, columns):
                    memory[row, k] = memory_old[row, k]
            else:
                _blend(points_old, i, memory_old, lo, w1, w2, memory, row)
                s0, s1, s2 = memory[row, 0], memory[row, 1], memory[row, 2]
            c0 = (s0 * ux + s1 * uy + s2 * uz) * s
            c1 = (s0 * ox + s1 * oy + s2 * oz) * t
            c2 = (s0 * vx + s1 * vy + s2 * vz) * (s * t)
            memory[row, 0] = c0 * ex + c1 * nx + c2 * gx
            memory[row, 1] = c0 * ey + c1 * ny + c2 * gy
            memory[row, 2] = c0 * ez + c1 * nz + c2 * gz


@kernel
def inherit(
    face_m, points, frames, begin_old, end_old, face_m_old, points_old, active_old, memory_old, active, memory,
):  # fmt: skip
    """History of new patches from the old ones of the same pair (CONTACT.md 3.7).

    The same faces: the linear field of the old points. Else the nearest old point on the same slave face, unless it is
    further away than the patch is large; then the flag (column 3) stays 0. `begin_old`, `end_old` (n,) bound the old
    patches of the same pair and slave face; `frames` (n, 3) is the metric (g11, g12, g22) of the reference triangle.
    """
    for i in range(len(face_m)):
        if active[i] == 0:
            continue
        exact = -1
        for j in range(begin_old[i], end_old[i]):
            if active_old[j] and face_m_old[j] == face_m[i]:
                exact = j if exact == -1 else -2
        found = False
        size2 = 0.0
        for q in range(3):
            a1, a2 = points[i, q, 0] - points[i, (q + 1) % 3, 0], points[i, q, 1] - points[i, (q + 1) % 3, 1]
            size2 = max(size2, frames[i, 0] * a1 * a1 + 2.0 * frames[i, 1] * a1 * a2 + frames[i, 2] * a2 * a2)
        for q in range(3):
            row = 3 * i + q
            if exact >= 0:
                _blend(points_old, exact, memory_old, 3 * exact, points[i, q, 0], points[i, q, 1], memory, row)
                found = True
                continue
            best, best_row, best_patch = np.inf, -1, -1
            for j in range(begin_old[i], end_old[i]):
                if active_old[j] == 0:
                    continue
                for r in range(3):
                    a1, a2 = points[i, q, 0] - points_old[j, r, 0], points[i, q, 1] - points_old[j, r, 1]
                    s = frames[i, 0] * a1 * a1 + 2.0 * frames[i, 1] * a1 * a2 + frames[i, 2] * a2 * a2
                    if s < best:
                        best, best_row, best_patch = s, 3 * j + r, j
            if best_row >= 0 and best <= 4.0 * size2:
                for k in range(memory.shape[1]):
                    memory[row, k] = memory_old[best_row, k]
                if face_m_old[best_patch] != face_m[i]:
                    memory[row, 3] = 0.0
                found = True
        if not found:
            active[i] = 0


@kernel
def slip_energy(area, memory, ks, active):
    """Elastic slip energy [J] of the patches with `area` (n,) [m2]: ``1/2 ks s^2 a`` over the three points of each."""
    total = 0.0
    for i in range(len(area)):
        if active[i]:
            s = 0.0
            for row in range(3 * i, 3 * i + 3):
                s += memory[row, 0] ** 2 + memory[row, 1] ** 2 + memory[row, 2] ** 2
            total += ks[i] * area[i] * s / 6.0
    return total
