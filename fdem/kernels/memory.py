"""Kernels over the history of contact points: carried along every step, inherited at a cut (CONTACT.md 3.7).

Rows 3 i .. 3 i + 2 are the points of patch i. Columns 0-2 are elastic slip [m], 3 a bond, 4 slip distance, 5 dilation.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

SMOOTH = 0.9  # cosine between slave faces above which history passes from one to the other


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
def carry_memory(gp, x, x_old, points_old, active_old, area_old, memory_old, points, active, area, memory, lost):
    """Committed memory of this step, its elastic slip turned with the frame of the slave face.

    The frame: first edge e, normal n, their product. A slip s becomes ``sum (s.e_old) e / |e_old||e|`` over the three.
    Where the closed part of a patch changes, its points keep what they have, and slip is scaled so that its energy
    stays: at the border of the closed part there is no pressure, hence no slip to be lost or won, and what comes and
    goes there leaves no trace (interpolated, it would creep). `area_old` (n,) [m2] is that of each point before; `lost`
    (n,) [m4] is ``sum a s^2`` of patches that open.
    """
    columns = memory.shape[1]
    for i in range(len(gp)):
        lo = 3 * i
        lost[i] = 0.0
        if active[i] == 0:
            if active_old[i]:
                for row in range(lo, lo + 3):
                    s0, s1, s2 = memory_old[row, 0], memory_old[row, 1], memory_old[row, 2]
                    lost[i] += area_old[i] * (s0 * s0 + s1 * s1 + s2 * s2)
            continue
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
        st = s * t
        if points[i, 0, 0] != points_old[i, 0, 0] or points[i, 0, 1] != points_old[i, 0, 1]:
            stretch = math.sqrt(area_old[i] / area[lo])
            s, t, st = s * stretch, t * stretch, st * stretch
        for row in range(lo, lo + 3):
            s0, s1, s2 = memory_old[row, 0], memory_old[row, 1], memory_old[row, 2]
            c0 = (s0 * ux + s1 * uy + s2 * uz) * s
            c1 = (s0 * ox + s1 * oy + s2 * oz) * t
            c2 = (s0 * vx + s1 * vy + s2 * vz) * st
            memory[row, 0] = c0 * ex + c1 * nx + c2 * gx
            memory[row, 1] = c0 * ey + c1 * ny + c2 * gy
            memory[row, 2] = c0 * ez + c1 * nz + c2 * gz
            for k in range(3, 6):  # a constant length, which the compiler unrolls
                memory[row, k] = memory_old[row, k]
            for k in range(6, columns):
                memory[row, k] = memory_old[row, k]


@kernel
def _places(gp, points, x, place, normal, size2):
    """Places (n, 3, 3) of the points [m], normals (n, 2, 3) of slave and master face, squared sizes (n,) [m2]."""
    for i in range(len(gp)):
        for side in range(2):
            a, b, c = gp[i, 3 * side], gp[i, 3 * side + 1], gp[i, 3 * side + 2]
            square = 0.0
            for d in range(3):
                j, k = (d + 1) % 3, (d + 2) % 3
                n = (x[b, j] - x[a, j]) * (x[c, k] - x[a, k]) - (x[b, k] - x[a, k]) * (x[c, j] - x[a, j])
                normal[i, side, d] = n
                square += n * n
            for d in range(3):
                normal[i, side, d] /= math.sqrt(square)
        a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
        for q in range(3):
            w1, w2 = points[i, q, 0], points[i, q, 1]
            for d in range(3):
                place[i, q, d] = (1.0 - w1 - w2) * x[a, d] + w1 * x[b, d] + w2 * x[c, d]
        size2[i] = 0.0
        for q in range(3):
            size2[i] = max(size2[i], _distance2(place, i, q, place, i, (q + 1) % 3))


@kernel
def _distance2(place, i, q, other, j, r):
    """Squared distance of two points [m2]."""
    s = 0.0
    for d in range(3):
        s += (place[i, q, d] - other[j, r, d]) ** 2
    return s


@kernel
def _nearest(place, normal, size2, i, q, lo, hi, smooth, place_old, normal_old, size2_old, active_old):
    """Row of the old point nearest to point q of patch i, -1 if none is within twice the size of either patch.

    Only the patches lo..hi; if `smooth`, of them those whose faces continue the surfaces of this one on both sides.
    """
    best, row = np.inf, -1
    for j in range(lo, hi):
        if active_old[j] == 0:
            continue
        if smooth:
            turned = False
            for side in range(2):
                along = 0.0
                for d in range(3):
                    along += normal[i, side, d] * normal_old[j, side, d]
                turned |= along < SMOOTH
            if turned:
                continue
        for r in range(3):
            s = _distance2(place, i, q, place_old, j, r)
            if s < best and s <= 4.0 * max(size2[i], size2_old[j]):
                best, row = s, 3 * j + r
    return row


@kernel
def keep(same, points, active, memory, points_old, memory_old):
    """History of new patches i from old ones ``same[i]`` of the same faces (-1: none): their linear field."""
    for i in range(len(same)):
        if active[i] and same[i] >= 0:
            for q in range(3):
                w1, w2 = points[i, q, 0], points[i, q, 1]
                _blend(points_old, same[i], memory_old, 3 * same[i], w1, w2, memory, 3 * i + q)


@kernel
def inherit(
    same, first_old, end_old, first_face, end_face, face_s, face_m, gp, points, active, memory, face_s_old, face_m_old,
    gp_old, points_old, active_old, memory_old, x,
):  # fmt: skip
    """History of new patches that are not the `same` (n,) as an old one: -1 there (CONTACT.md 3.7).

    The nearest old point on faces that continue these two, so that contact goes on across the lines of a mesh; else
    the nearest on the same slave face. The old patches of its pair are ``first_old[i]:end_old[i]``, those of its slave
    face ``first_face[i]:end_face[i]``. A bond (column 3) stays with its two faces, its failure goes along. `active`
    (n,) becomes 0 where nothing is inherited.
    """
    n, m = len(gp), len(gp_old)
    place, normal, size2 = np.empty((n, 3, 3)), np.empty((n, 2, 3)), np.empty(n)
    place_old, normal_old, size2_old = np.empty((m, 3, 3)), np.empty((m, 2, 3)), np.empty(m)
    _places(gp, points, x, place, normal, size2)
    _places(gp_old, points_old, x, place_old, normal_old, size2_old)
    for i in range(n):
        if active[i] == 0 or same[i] >= 0:
            continue
        found = False
        for q in range(3):
            row, best = 3 * i + q, -1
            for smooth in (True, False):
                lo, hi = first_face[i], end_face[i]
                if smooth:
                    lo, hi = first_old[i], end_old[i]
                best = _nearest(
                    place, normal, size2, i, q, lo, hi, smooth, place_old, normal_old, size2_old, active_old
                )
                if best >= 0:
                    break
            if best >= 0:
                for k in range(memory.shape[1]):
                    memory[row, k] = memory_old[best, k]
                if face_m_old[best // 3] != face_m[i] or face_s_old[best // 3] != face_s[i]:
                    memory[row, 3] = min(memory[row, 3], 0.0)
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
