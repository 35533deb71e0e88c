"""Kernels over contact patches: re-project, close, three points, rows, history, scatter (CONTACT.md 3.4-3.9).

A patch is a convex polygon on a slave face, its corners in the face's reference triangle (see kernels/geometry.py).
The depth below the master face is linear there, so three values (at the reference gridpoints) describe it.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

WHOLE, FACING, LATENT, DILATES = 1, 2, 4, 8  # bits of a patch's flags
ALIGNED = 0.99
SQRT2 = math.sqrt(2.0)
COS3 = (1.0, -0.5, -0.5)
SIN3 = (0.0, math.sqrt(0.75), -math.sqrt(0.75))


@kernel
def _moment_points(poly, n, pts):
    """Three equal-weight points exact to degree 2 on `poly[:n]`; returns area / reference triangle area."""
    o1, o2 = poly[0, 0], poly[0, 1]
    area, g1, g2, s11, s12, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(1, n - 1):
        a1, a2 = poly[i, 0] - o1, poly[i, 1] - o2
        b1, b2 = poly[i + 1, 0] - o1, poly[i + 1, 1] - o2
        t = a1 * b2 - a2 * b1
        area += t
        g1 += t * (a1 + b1)
        g2 += t * (a2 + b2)
        s11 += t * (a1 * a1 + a1 * b1 + b1 * b1)
        s12 += t * (2.0 * a1 * a2 + a1 * b2 + a2 * b1 + 2.0 * b1 * b2)
        s22 += t * (a2 * a2 + a2 * b2 + b2 * b2)
    if not area > 0.0:
        return 0.0
    g1 /= 3.0 * area
    g2 /= 3.0 * area
    s11 = s11 / (6.0 * area) - g1 * g1
    s12 = s12 / (12.0 * area) - g1 * g2
    s22 = s22 / (6.0 * area) - g2 * g2
    t11 = math.sqrt(max(s11, 0.0))
    t21 = s12 / t11 if t11 > 0.0 else 0.0
    t22 = math.sqrt(max(s22 - t21 * t21, 0.0))
    for q in range(3):
        c, s = SQRT2 * COS3[q], SQRT2 * SIN3[q]
        pts[q, 0] = o1 + g1 + t11 * c
        pts[q, 1] = o2 + g2 + t21 * c + t22 * s
    return area


@kernel
def _close(corners, lo, hi, d0, d1, d2, poly):
    """The part of a polygon with depth >= 0; its corners go to `poly`; returns their number."""
    m = 0
    a1, a2 = corners[hi - 1, 0], corners[hi - 1, 1]
    va = d0 * (1.0 - a1 - a2) + d1 * a1 + d2 * a2
    for i in range(lo, hi):
        b1, b2 = corners[i, 0], corners[i, 1]
        vb = d0 * (1.0 - b1 - b2) + d1 * b1 + d2 * b2
        if (va >= 0.0) != (vb >= 0.0):
            t = va / (va - vb)
            poly[m, 0] = a1 + t * (b1 - a1)
            poly[m, 1] = a2 + t * (b2 - a2)
            m += 1
        if vb >= 0.0:
            poly[m, 0] = b1
            poly[m, 1] = b2
            m += 1
        a1, a2, va = b1, b2, vb
    return m


@kernel
def reference_points(start, corners, points, ratio):
    """Points (n, 3, 2) and area ratios (n,) of the whole polygons."""
    longest = 3
    for i in range(len(ratio)):
        longest = max(longest, start[i + 1] - start[i])
    poly = np.empty((longest, 2))
    for i in range(len(ratio)):
        n = start[i + 1] - start[i]
        for k in range(n):
            poly[k, 0], poly[k, 1] = corners[start[i] + k, 0], corners[start[i] + k, 1]
        ratio[i] = _moment_points(poly, n, points[i])


@kernel
def measure(gp, start, corners, offset, x, area, closed, align, depth, plane_depth, centre):
    """Size and position of patches: whole area, closed area [m2], -n_a.n_f, largest depth [m], centroid (n, 3).

    `plane_depth` (n, 3): depth below the master plane at the three slave gridpoints, no offset taken off.
    """
    longest = 3
    for i in range(len(area)):
        longest = max(longest, start[i + 1] - start[i])
    poly, pts, frame = np.empty((2 * longest + 2, 2)), np.empty((3, 2)), np.empty(6)
    for i in range(len(area)):
        double = _two_normals(gp[i], x, frame)
        for k in range(3):
            s, m = gp[i, k], gp[i, 3]
            plane_depth[i, k] = (
                frame[3] * (x[m, 0] - x[s, 0]) + frame[4] * (x[m, 1] - x[s, 1]) + frame[5] * (x[m, 2] - x[s, 2])
            )
        align[i] = -(frame[0] * frame[3] + frame[1] * frame[4] + frame[2] * frame[5])
        d0, d1, d2 = (
            plane_depth[i, 0] - offset[i, 0],
            plane_depth[i, 1] - offset[i, 1],
            plane_depth[i, 2] - offset[i, 2],
        )
        top = -np.inf
        n = start[i + 1] - start[i]
        for k in range(n):
            w1, w2 = corners[start[i] + k, 0], corners[start[i] + k, 1]
            poly[k, 0], poly[k, 1] = w1, w2
            top = max(top, d0 * (1.0 - w1 - w2) + d1 * w1 + d2 * w2)
        depth[i] = top
        area[i] = 0.5 * double * _moment_points(poly, n, pts)
        for d in range(3):
            c = 0.0
            for q in range(3):
                w1, w2 = pts[q, 0], pts[q, 1]
                c += (1.0 - w1 - w2) * x[gp[i, 0], d] + w1 * x[gp[i, 1], d] + w2 * x[gp[i, 2], d]
            centre[i, d] = c / 3.0
        n = _close(corners, start[i], start[i + 1], d0, d1, d2, poly)
        closed[i] = 0.5 * double * _moment_points(poly, n, pts) if n >= 3 else 0.0


@kernel
def latent_reach(start, corners, depth, area, ratio, level, out):
    """How much deeper [m] patches must get until `level` (n,) [m2] of them is closed; infinite if that cannot be.

    `depth` (n, 3) [m] is taken at the reference gridpoints, `area` (n,) [m2] and `ratio` are those of the whole polygons.
    Bisection to 10 %, on the safe side.
    """
    longest = 3
    for i in range(len(out)):
        longest = max(longest, start[i + 1] - start[i])
    poly, pts = np.empty((2 * longest + 2, 2)), np.empty((3, 2))
    for i in range(len(out)):
        if not area[i] > level[i]:
            out[i] = np.inf
            continue
        low, high = np.inf, -np.inf
        for k in range(start[i], start[i + 1]):
            w1, w2 = corners[k, 0], corners[k, 1]
            v = depth[i, 0] * (1.0 - w1 - w2) + depth[i, 1] * w1 + depth[i, 2] * w2
            low, high = min(low, v), max(high, v)
        near, far = max(-high, 0.0), max(-low, 0.0)
        if level[i] > 0.0:
            while far - near > 0.1 * near and far - near > 1e-9 * (high - low):
                half = 0.5 * (near + far)
                d0, d1, d2 = depth[i, 0] + half, depth[i, 1] + half, depth[i, 2] + half
                n = _close(corners, start[i], start[i + 1], d0, d1, d2, poly)
                part = _moment_points(poly, n, pts) if n >= 3 else 0.0
                if part * area[i] > level[i] * ratio[i]:
                    far = half
                else:
                    near = half
        out[i] = near


@kernel
def _two_normals(g, x, out):
    """Unit normals of slave (0:3) and master face (3:6); returns twice the area of the slave's triangle."""
    double = 0.0
    for side in range(2):
        o = 3 * side
        p, q, r = g[o], g[o + 1], g[o + 2]
        ax, ay, az = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
        bx, by, bz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        s = math.sqrt(nx * nx + ny * ny + nz * nz)
        out[o], out[o + 1], out[o + 2] = nx / s, ny / s, nz / s
        if side == 0:
            double = s
    return double


@kernel
def weights_at(gp, thick, points, x, w):
    """Seven weights of the rows at `points` (n, 3, 2) into `w` (3 n, 7): + slave, - master at the same place."""
    tet = np.empty(12)
    for i in range(len(gp)):
        _master_frame(gp[i], thick[i], x, tet)
        for q in range(3):
            _row_weights(gp[i], points[i, q, 0], points[i, q, 1], x, tet, w[3 * i + q])


@kernel
def _master_frame(g, thick, x, out):
    """Origin (3) and reciprocal edge vectors (9) of the tetrahedron of the master gridpoints."""
    p, q, r, t = g[3], g[4], g[5], g[6]
    ax, ay, az = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
    bx, by, bz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
    if thick:
        cx, cy, cz = x[t, 0] - x[p, 0], x[t, 1] - x[p, 1], x[t, 2] - x[p, 2]
    else:
        cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    ux, uy, uz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    vx, vy, vz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    sx, sy, sz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    det = ax * ux + ay * uy + az * uz
    out[0], out[1], out[2] = x[p, 0], x[p, 1], x[p, 2]
    out[3], out[4], out[5] = ux / det, uy / det, uz / det
    out[6], out[7], out[8] = vx / det, vy / det, vz / det
    if thick:
        out[9], out[10], out[11] = sx / det, sy / det, sz / det
    else:
        out[9], out[10], out[11] = 0.0, 0.0, 0.0


@kernel
def _row_weights(g, w1, w2, x, tet, w):
    """Weights of one row: the slave point and the same spatial point on the master."""
    a, b, c = g[0], g[1], g[2]
    w0 = 1.0 - w1 - w2
    dx = w0 * x[a, 0] + w1 * x[b, 0] + w2 * x[c, 0] - tet[0]
    dy = w0 * x[a, 1] + w1 * x[b, 1] + w2 * x[c, 1] - tet[1]
    dz = w0 * x[a, 2] + w1 * x[b, 2] + w2 * x[c, 2] - tet[2]
    l1 = dx * tet[3] + dy * tet[4] + dz * tet[5]
    l2 = dx * tet[6] + dy * tet[7] + dz * tet[8]
    l3 = dx * tet[9] + dy * tet[10] + dz * tet[11]
    w[0], w[1], w[2] = w0, w1, w2
    w[3], w[4], w[5], w[6] = -(1.0 - l1 - l2 - l3), -l1, -l2, -l3


@kernel
def _blend(points, memory, row, w1, w2, out):
    """Memory at (w1, w2) from the three old points: clamped barycentric, the flag (column 3) from the nearest."""
    p1, p2 = points[0, 0], points[0, 1]
    a1, a2 = points[1, 0] - p1, points[1, 1] - p2
    b1, b2 = points[2, 0] - p1, points[2, 1] - p2
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
    for k in range(len(out)):
        if k < 3 or k == 4 or k == 5:
            out[k] = m0 * memory[row, k] + m1 * memory[row + 1, k] + m2 * memory[row + 2, k]
        else:
            out[k] = memory[row + near, k]


@kernel
def _frame(a, b, c, x, out):
    """Orthonormal frame of the triangle a, b, c: first edge, normal, their product."""
    ex, ey, ez = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    hx, hy, hz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    nx, ny, nz = ey * hz - ez * hy, ez * hx - ex * hz, ex * hy - ey * hx
    s = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
    t = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    ex, ey, ez = ex * s, ey * s, ez * s
    nx, ny, nz = nx * t, ny * t, nz * t
    out[0], out[1], out[2] = ex, ey, ez
    out[3], out[4], out[5] = nx, ny, nz
    out[6], out[7], out[8] = ey * nz - ez * ny, ez * nx - ex * nz, ex * ny - ey * nx


@kernel
def project(
    gp, start, corners, offset, flags, pair, limit, thick, ref_points, ref_ratio, inverse_mass, inverse_gp, damped,
    x, x_old,
    points_old, active_old, memory_old, points, active, memory, w, gap, area, align, normal, push, slip, mass,
    facing_out, pair_area, pair_normal,
):  # fmt: skip
    """Re-project, close and sample every patch: the rows the joint laws work on.

    | argument | shape | unit | |
    |---|---|---|---|
    | gp | (n, 7) | - | 3 slave, 4 master gridpoints |
    | offset | (n, 3) | m | reference gap d0 at the slave gridpoints |
    | inverse_mass | (n, 2) | 1/kg | of slave and master block; negative: take `inverse_gp` (n_gp,) |
    | damped | bool | - | whether `mass` is wanted |
    | points_old, active_old, memory_old | | | committed history |
    | points | (n, 3, 2) | - | out: places of the three points |
    | active | (n,) | - | out: 1 where the patch carries anything |
    | memory | (3 n, k) | | out: committed memory moved to the points and rotated with the slave face |
    | w | (3 n, 7) | - | out |
    | gap, area, align, normal, push | (3 n[, 3]) | m, m2 | out: > 0 open; -n_a.n_c; friction normal; n_a per patch |
    | slip | (3 n, 3) | m | out: motion of the slave relative to the master since `x_old` |
    | facing_out | (n,) | - | out: -n_a.n_f |
    | mass | (3 n,) | kg/m2 | out: reduced mass per area |

    Returns
    -------
    int
        Index of a patch deeper than its limit, or -1.
    """
    n_patches = len(gp)
    longest = 3
    for i in range(n_patches):
        longest = max(longest, start[i + 1] - start[i])
    poly, tet = np.empty((2 * longest + 2, 2)), np.empty(12)
    pts, du = np.empty((3, 2)), np.empty((7, 3))
    old, new = np.empty(9), np.empty(9)
    fx, fy, fz = 0.0, 0.0, 0.0
    for i in range(len(pair_area)):
        pair_area[i] = 0.0
        pair_normal[i, 0], pair_normal[i, 1], pair_normal[i, 2] = 0.0, 0.0, 0.0
    too_deep, unaligned = -1, False
    last = -1
    for i in range(n_patches):
        a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
        p = gp[i, 3]
        same = (
            last >= 0
            and gp[last, 3] == p
            and gp[last, 4] == gp[i, 4]
            and gp[last, 5] == gp[i, 5]
            and gp[last, 6] == gp[i, 6]
        )
        if not same:
            q, r = gp[i, 4], gp[i, 5]
            ux, uy, uz = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
            vx, vy, vz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
            fx, fy, fz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            s = math.sqrt(fx * fx + fy * fy + fz * fz)
            fx, fy, fz = fx / s, fy / s, fz / s
            _master_frame(gp[i], thick[i], x, tet)
            last = i
        ox, oy, oz = x[p, 0], x[p, 1], x[p, 2]
        d0 = fx * (ox - x[a, 0]) + fy * (oy - x[a, 1]) + fz * (oz - x[a, 2]) - offset[i, 0]
        d1 = fx * (ox - x[b, 0]) + fy * (oy - x[b, 1]) + fz * (oz - x[b, 2]) - offset[i, 1]
        d2 = fx * (ox - x[c, 0]) + fy * (oy - x[c, 1]) + fz * (oz - x[c, 2]) - offset[i, 2]
        if flags[i] & DILATES and active_old[i]:
            lift = (memory_old[3 * i, 5] + memory_old[3 * i + 1, 5] + memory_old[3 * i + 2, 5]) / 3.0
            d0, d1, d2 = d0 + lift, d1 + lift, d2 + lift
        low, high = np.inf, -np.inf
        for k in range(start[i], start[i + 1]):
            w1, w2 = corners[k, 0], corners[k, 1]
            v = d0 * (1.0 - w1 - w2) + d1 * w1 + d2 * w2
            low = min(low, v)
            high = max(high, v)
        whole = False
        if flags[i] & WHOLE and active_old[i]:
            whole = memory_old[3 * i, 3] > 0.0 or memory_old[3 * i + 1, 3] > 0.0 or memory_old[3 * i + 2, 3] > 0.0
        ratio = ref_ratio[i]
        shut = low >= 0.0 or whole
        if not shut:
            ratio = 0.0
            if high > 0.0:
                m = _close(corners, start[i], start[i + 1], d0, d1, d2, poly)
                if m >= 3:
                    ratio = _moment_points(poly, m, pts)
        if not ratio > 0.0:
            active[i] = 0
            for q in range(3 * i, 3 * i + 3):
                area[q] = 0.0
                gap[q] = -high
            continue
        if high > limit[i] and too_deep < 0:
            too_deep = i
        active[i] = 1
        e1x, e1y, e1z = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        e2x, e2y, e2z = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        nx, ny, nz = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
        double = math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / double, ny / double, nz / double
        push[i, 0], push[i, 1], push[i, 2] = nx, ny, nz
        facing = -(nx * fx + ny * fy + nz * fz)
        facing_out[i] = facing
        share = double * ratio / 6.0
        pair_area[pair[i]] += 3.0 * share
        friction = (flags[i] & FACING) != 0
        for k in range(7):
            g = gp[i, k]
            du[k, 0], du[k, 1], du[k, 2] = x[g, 0] - x_old[g, 0], x[g, 1] - x_old[g, 1], x[g, 2] - x_old[g, 2]
        turned = friction and active_old[i] == 1
        if turned:  # frames of the slave face before and now: first edge, normal, their product
            _frame(a, b, c, x_old, old)
            _frame(a, b, c, x, new)
        for q in range(3):
            row = 3 * i + q
            if shut:
                w1, w2 = ref_points[i, q, 0], ref_points[i, q, 1]
            else:
                w1, w2 = pts[q, 0], pts[q, 1]
            w0 = 1.0 - w1 - w2
            if turned:
                unmoved = w1 == points_old[i, q, 0] and w2 == points_old[i, q, 1]
                if unmoved:
                    for k in range(memory.shape[1]):
                        memory[row, k] = memory_old[row, k]
                else:
                    _blend(points_old[i], memory_old, 3 * i, w1, w2, memory[row])
                s0, s1, s2 = memory[row, 0], memory[row, 1], memory[row, 2]
                if s0 != 0.0 or s1 != 0.0 or s2 != 0.0:
                    c0 = s0 * old[0] + s1 * old[1] + s2 * old[2]
                    c1 = s0 * old[3] + s1 * old[4] + s2 * old[5]
                    c2 = s0 * old[6] + s1 * old[7] + s2 * old[8]
                    for d in range(3):
                        memory[row, d] = c0 * new[d] + c1 * new[3 + d] + c2 * new[6 + d]
            else:
                for k in range(memory.shape[1]):
                    memory[row, k] = 0.0
            points[i, q, 0], points[i, q, 1] = w1, w2
            _row_weights(gp[i], w1, w2, x, tet, w[row])
            gap[row] = -(d0 * w0 + d1 * w1 + d2 * w2)
            area[row] = share
            align[row] = facing if friction else 0.0
            normal[row, 0], normal[row, 1], normal[row, 2] = fx, fy, fz
            for d in range(3):
                v = 0.0
                for k in range(7):
                    v += w[row, k] * du[k, d]
                slip[row, d] = v
        if friction and facing <= ALIGNED:
            unaligned = True
            v = -share * (min(gap[3 * i], 0.0) + min(gap[3 * i + 1], 0.0) + min(gap[3 * i + 2], 0.0))
            k = pair[i]
            pair_normal[k, 0] -= v * nx
            pair_normal[k, 1] -= v * ny
            pair_normal[k, 2] -= v * nz
    if unaligned:
        _common_normals(active, align, pair, push, pair_normal, normal)
    if damped:
        _reduced_mass(gp, active, pair, pair_area, inverse_mass, inverse_gp, area, w, mass)
    return too_deep


@kernel
def _common_normals(active, align, pair, push, pair_normal, normal):
    """Friction frame of unaligned patches: the direction of their summed normal force in the pair (CONTACT.md 3.6)."""
    for i in range(len(active)):
        if active[i] == 0 or align[3 * i] == 0.0 or align[3 * i] > ALIGNED:
            continue
        k = pair[i]
        cx, cy, cz = pair_normal[k, 0], pair_normal[k, 1], pair_normal[k, 2]
        s = math.sqrt(cx * cx + cy * cy + cz * cz)
        if not s > 0.0:
            continue
        cx, cy, cz = cx / s, cy / s, cz / s
        facing = -(push[i, 0] * cx + push[i, 1] * cy + push[i, 2] * cz)
        for row in range(3 * i, 3 * i + 3):
            normal[row, 0], normal[row, 1], normal[row, 2] = cx, cy, cz
            align[row] = max(facing, 0.0)


@kernel
def _reduced_mass(gp, active, pair, pair_area, inverse_mass, inverse_gp, area, w, mass):
    """Reduced mass per area of every row [kg/m2]: a block's mass over the pair's closed area, a zone's gridpoints'."""
    for i in range(len(active)):
        if active[i] == 0:
            continue
        for row in range(3 * i, 3 * i + 3):
            inverse = 0.0
            for side in range(2):
                if inverse_mass[i, side] >= 0.0:
                    inverse += pair_area[pair[i]] * inverse_mass[i, side]
                else:
                    for k in range(3 * side, 3 + 4 * side):
                        inverse += area[row] * w[row, k] ** 2 * inverse_gp[gp[i, k]]
            mass[row] = 1.0 / inverse if inverse > 0.0 else 0.0


@kernel
def scatter(gp, active, w, area, push, traction, f_gp):
    """Add -p a n_a + t a on the slave and the opposite on the master to the gridpoints, serially in row order."""
    for i in range(len(gp)):
        if active[i] == 0:
            continue
        for row in range(3 * i, 3 * i + 3):
            a = area[row]
            p = traction[row, 0]
            fx = a * (traction[row, 1] - p * push[i, 0])
            fy = a * (traction[row, 2] - p * push[i, 1])
            fz = a * (traction[row, 3] - p * push[i, 2])
            for k in range(7):
                g = gp[i, k]
                f_gp[g, 0] += w[row, k] * fx
                f_gp[g, 1] += w[row, k] * fy
                f_gp[g, 2] += w[row, k] * fz


@kernel
def moved(surface_gp, surface_start, x, x_check, tolerance):
    """Whether some block's surface moved more than its tolerance (n_blocks,) [m] since `x_check`."""
    for b in range(len(tolerance)):
        t = tolerance[b] * tolerance[b]
        for j in range(surface_start[b], surface_start[b + 1]):
            g = surface_gp[j]
            a, b_, c = x[g, 0] - x_check[g, 0], x[g, 1] - x_check[g, 1], x[g, 2] - x_check[g, 2]
            if not a * a + b_ * b_ + c * c <= t:
                return True
    return False


@kernel
def block_motion(surface_gp, surface_start, x, x_ref, out):
    """Largest displacement of a surface gridpoint of every block since `x_ref` [m]."""
    for b in range(len(out)):
        far = 0.0
        for j in range(surface_start[b], surface_start[b + 1]):
            g = surface_gp[j]
            s = 0.0
            for d in range(3):
                s += (x[g, d] - x_ref[g, d]) ** 2
            if not s <= far:
                far = s
        out[b] = math.sqrt(far)


@kernel
def worn_pairs(gp, pair, w, reach, normal_reach, x, out):
    """Mark pairs (n_pairs,) uint8 one of whose patches moved further than the clip allows.

    `w` (3 n, 7) are the row weights at the clip, so that ``sum w x`` is the motion since; `reach` (n,) [m] bounds its
    length, `normal_reach` (n,) how far it goes into the master face.
    """
    frame = np.empty(6)
    for i in range(len(gp)):
        if out[pair[i]]:
            continue
        _two_normals(gp[i], x, frame)
        for q in range(3 * i, 3 * i + 3):
            s, across = 0.0, 0.0
            for d in range(3):
                v = 0.0
                for k in range(7):
                    v += w[q, k] * x[gp[i, k], d]
                s += v * v
                across += v * frame[3 + d]
            if not s <= reach[i] * reach[i] or -across > normal_reach[i]:
                out[pair[i]] = 1


@kernel
def inherit(
    key_pair, face_s, face_m, points, frames, begin_old, end_old, face_s_old, face_m_old, points_old, active_old,
    memory_old, active, memory,
):  # fmt: skip
    """History of new patches from the old ones of the same pair (CONTACT.md 3.7).

    The same faces: the linear field of the old points. Else the nearest old point on the same slave face, unless it is
    further away than the patch is large; then the flag (column 3) stays 0. `begin_old`, `end_old` (n,) bound the old
    patches of the same pair; `frames` (n, 3) is the metric (g11, g12, g22) of the slave's reference triangle.
    """
    for i in range(len(face_s)):
        if active[i] == 0:
            continue
        exact = -1
        for j in range(begin_old[i], end_old[i]):
            if active_old[j] and face_s_old[j] == face_s[i] and face_m_old[j] == face_m[i]:
                exact = j if exact == -1 else -2
        found = False
        size2 = 0.0
        for q in range(3):
            a1, a2 = points[i, q, 0] - points[i, (q + 1) % 3, 0], points[i, q, 1] - points[i, (q + 1) % 3, 1]
            size2 = max(size2, frames[i, 0] * a1 * a1 + 2.0 * frames[i, 1] * a1 * a2 + frames[i, 2] * a2 * a2)
        for q in range(3):
            row = 3 * i + q
            if exact >= 0:
                _blend(points_old[exact], memory_old, 3 * exact, points[i, q, 0], points[i, q, 1], memory[row])
                found = True
                continue
            best, best_row, best_patch = np.inf, -1, -1
            for j in range(begin_old[i], end_old[i]):
                if active_old[j] == 0 or face_s_old[j] != face_s[i]:
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
def closed_points(gp, start, corners, offset, flags, memory_flag, ref_points, x, points, active):
    """Points (n, 3, 2) of the parts closed in `x`; whole polygons where `memory_flag` (n,) says the patch is bonded."""
    longest = 3
    for i in range(len(gp)):
        longest = max(longest, start[i + 1] - start[i])
    poly, frame = np.empty((2 * longest + 2, 2)), np.empty(6)
    for i in range(len(gp)):
        _two_normals(gp[i], x, frame)
        m = gp[i, 3]
        depth = np.empty(3)
        for k in range(3):
            s = gp[i, k]
            depth[k] = -offset[i, k]
            for d in range(3):
                depth[k] += frame[3 + d] * (x[m, d] - x[s, d])
        low = np.inf
        for k in range(start[i], start[i + 1]):
            w1, w2 = corners[k, 0], corners[k, 1]
            low = min(low, depth[0] * (1.0 - w1 - w2) + depth[1] * w1 + depth[2] * w2)
        active[i] = 1
        if low >= 0.0 or memory_flag[i]:
            points[i] = ref_points[i]
            continue
        n = _close(corners, start[i], start[i + 1], depth[0], depth[1], depth[2], poly)
        if n < 3 or not _moment_points(poly, n, points[i]) > 0.0:
            active[i] = 0
            points[i] = ref_points[i]


@kernel
def gridpoint_stiffness(gp, w, stiffness, mobile, soft, out):
    """Upper bound of the contact stiffness of gridpoints [N/m] for whole patches.

    ``(sum w u)^2 <= sum |w| * sum |w| u^2``; two mobile sides double it. For affine blocks (`soft` (n, 2) == 0) the
    stiffness is only distributed over the gridpoints, their weights do not multiply it.
    """
    for i in range(len(gp)):
        both = 1.0
        if mobile[gp[i, 0]] and mobile[gp[i, 3]]:
            both = 2.0
        for row in range(3 * i, 3 * i + 3):
            for side in range(2):
                lo, hi = 3 * side, 3 + 4 * side
                total = 0.0
                for k in range(lo, hi):
                    total += abs(w[row, k])
                scale = total if soft[i, side] else 1.0 / total
                for k in range(lo, hi):
                    if mobile[gp[i, k]]:
                        out[gp[i, k]] += both * stiffness[row] * scale * abs(w[row, k])


@kernel
def stored_energy(area, gap, push_align, memory, kn, ks, active, lo, hi):
    """Elastic energy [J] of the patches lo..hi: 1/2 kn d^2 a (-n_a.n_f) + 1/2 ks s^2 a."""
    total = 0.0
    for i in range(lo, hi):
        if active[i] == 0:
            continue
        for row in range(3 * i, 3 * i + 3):
            s = memory[row, 0] ** 2 + memory[row, 1] ** 2 + memory[row, 2] ** 2
            total += 0.5 * area[row] * (kn[i] * gap[row] ** 2 * push_align[i] + ks[i] * s)
    return total
