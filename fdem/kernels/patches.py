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
        double = _two_normals(gp, i, x, frame)
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
def prune(local, facing, area, closed, margin, share, keep, largest, largest_closed, nearest):
    """Which patches weigh (`keep`): at least `share` of their pair's largest; strips by their closed part.

    Out per pair, `local` (n,) being the pair of a patch: largest area of facing patches or closed part of any [m2],
    largest closed part [m2], and in `nearest` the smaller of what it holds and the margins of kept patches [m].
    """
    for i in range(len(local)):
        k = local[i]
        largest[k] = max(largest[k], area[i] if facing[i] else closed[i])
        largest_closed[k] = max(largest_closed[k], closed[i])
    for i in range(len(local)):
        k = local[i]
        keep[i] = share <= 0.0
        if facing[i]:
            keep[i] |= area[i] > share * largest[k]
        else:
            keep[i] |= closed[i] > share * largest_closed[k]
        if keep[i]:
            nearest[k] = min(nearest[k], margin[i])


@kernel
def latent_reach(local, skip, start, corners, depth, area, ratio, level, out):
    """How much deeper [m] a pair may get until `level` (n_pairs,) [m2] of a patch not in `skip` is closed.

    `depth` (n, 3) [m] is taken at the reference gridpoints, `area` (n,) [m2] and `ratio` are those of the whole polygons.
    Bisection to 10 %, on the safe side; `out` (n_pairs,) is lowered.
    """
    longest = 3
    for i in range(len(local)):
        longest = max(longest, start[i + 1] - start[i])
    poly, pts = np.empty((2 * longest + 2, 2)), np.empty((3, 2))
    for i in range(len(local)):
        limit = level[local[i]]
        if skip[i] or not area[i] > limit:
            continue
        low, high = np.inf, -np.inf
        for k in range(start[i], start[i + 1]):
            w1, w2 = corners[k, 0], corners[k, 1]
            v = depth[i, 0] * (1.0 - w1 - w2) + depth[i, 1] * w1 + depth[i, 2] * w2
            low, high = min(low, v), max(high, v)
        near, far = max(-high, 0.0), min(max(-low, 0.0), out[local[i]])
        if limit > 0.0:
            while far - near > 0.1 * near and far - near > 1e-9 * (high - low):
                half = 0.5 * (near + far)
                d0, d1, d2 = depth[i, 0] + half, depth[i, 1] + half, depth[i, 2] + half
                n = _close(corners, start[i], start[i + 1], d0, d1, d2, poly)
                part = _moment_points(poly, n, pts) if n >= 3 else 0.0
                if part * area[i] > limit * ratio[i]:
                    far = half
                else:
                    near = half
        out[local[i]] = min(out[local[i]], near)


@kernel
def _two_normals(gp, i, x, out):
    """Unit normals of slave (0:3) and master face (3:6) of patch i; returns twice the area of the slave's triangle."""
    double = 0.0
    for side in range(2):
        o = 3 * side
        p, q, r = gp[i, o], gp[i, o + 1], gp[i, o + 2]
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
        _master_frame(gp, i, thick[i], x, tet)
        a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
        for q in range(3):
            row = 3 * i + q
            w1, w2 = points[i, q, 0], points[i, q, 1]
            w0 = 1.0 - w1 - w2
            dx = w0 * x[a, 0] + w1 * x[b, 0] + w2 * x[c, 0] - tet[0]
            dy = w0 * x[a, 1] + w1 * x[b, 1] + w2 * x[c, 1] - tet[1]
            dz = w0 * x[a, 2] + w1 * x[b, 2] + w2 * x[c, 2] - tet[2]
            l1 = dx * tet[3] + dy * tet[4] + dz * tet[5]
            l2 = dx * tet[6] + dy * tet[7] + dz * tet[8]
            l3 = dx * tet[9] + dy * tet[10] + dz * tet[11]
            w[row, 0], w[row, 1], w[row, 2] = w0, w1, w2
            w[row, 3], w[row, 4], w[row, 5], w[row, 6] = -(1.0 - l1 - l2 - l3), -l1, -l2, -l3


@kernel
def _master_frame(gp, i, thick, x, out):
    """Origin (3) and reciprocal edge vectors (9) of the tetrahedron of the master gridpoints of patch i."""
    p, q, r, t = gp[i, 3], gp[i, 4], gp[i, 5], gp[i, 6]
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
def _unit_normal(a, b, c, x):
    """Unit normal of the triangle of gridpoints a, b, c, and twice its area."""
    ex, ey, ez = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    hx, hy, hz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    nx, ny, nz = ey * hz - ez * hy, ez * hx - ex * hz, ex * hy - ey * hx
    double = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / double, ny / double, nz / double, double


@kernel
def _close_patches(
    gp, start, corners, offset, flags, limit, ref_points, ref_ratio, x, active_old, memory_old, points, active, area, gap,
    depth, face_normal,
):  # fmt: skip
    """The closed part of every patch: its points, and in `area` its share of the slave's triangle (once per patch).

    `depth` (n, 3) and the master normal `face_normal[:, 0:3]` are left for `_fill_rows`. Returns the first patch deeper than
    its limit, or -1.
    """
    longest = 3
    for i in range(len(gp)):
        longest = max(longest, start[i + 1] - start[i])
    poly, pts = np.empty((2 * longest + 2, 2)), np.empty((3, 2))
    too_deep, p, q, r = -1, -1, -1, -1
    fx, fy, fz, level = 0.0, 0.0, 0.0, 0.0
    for i in range(len(gp)):
        a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
        if gp[i, 3] != p or gp[i, 4] != q or gp[i, 5] != r:
            p, q, r = gp[i, 3], gp[i, 4], gp[i, 5]
            fx, fy, fz, _ = _unit_normal(p, q, r, x)
        face_normal[i, 0], face_normal[i, 1], face_normal[i, 2] = fx, fy, fz
        ox, oy, oz = x[p, 0], x[p, 1], x[p, 2]
        d0 = fx * (ox - x[a, 0]) + fy * (oy - x[a, 1]) + fz * (oz - x[a, 2]) - offset[i, 0]
        d1 = fx * (ox - x[b, 0]) + fy * (oy - x[b, 1]) + fz * (oz - x[b, 2]) - offset[i, 1]
        d2 = fx * (ox - x[c, 0]) + fy * (oy - x[c, 1]) + fz * (oz - x[c, 2]) - offset[i, 2]
        if flags[i] & DILATES and active_old[i]:
            lift = (memory_old[3 * i, 5] + memory_old[3 * i + 1, 5] + memory_old[3 * i + 2, 5]) / 3.0
            d0, d1, d2 = d0 + lift, d1 + lift, d2 + lift
        depth[i, 0], depth[i, 1], depth[i, 2] = d0, d1, d2
        low, high = np.inf, -np.inf
        for k in range(start[i], start[i + 1]):
            w1, w2 = corners[k, 0], corners[k, 1]
            level = d0 * (1.0 - w1 - w2) + d1 * w1 + d2 * w2
            low = min(low, level)
            high = max(high, level)
        whole = low >= 0.0
        if not whole and flags[i] & WHOLE and active_old[i]:
            whole = memory_old[3 * i, 3] > 0.0 or memory_old[3 * i + 1, 3] > 0.0 or memory_old[3 * i + 2, 3] > 0.0
        ratio = 0.0
        if whole:
            ratio = ref_ratio[i]
            for k in range(3):
                points[i, k, 0], points[i, k, 1] = ref_points[i, k, 0], ref_points[i, k, 1]
        elif high > 0.0:
            m = _close(corners, start[i], start[i + 1], d0, d1, d2, poly)
            if m >= 3:
                ratio = _moment_points(poly, m, pts)
            if ratio > 0.0:
                for k in range(3):
                    points[i, k, 0], points[i, k, 1] = pts[k, 0], pts[k, 1]
        active[i] = 1 if ratio > 0.0 else 0
        area[3 * i] = max(ratio, 0.0)
        if active[i] == 0:
            area[3 * i + 1], area[3 * i + 2] = 0.0, 0.0
            gap[3 * i], gap[3 * i + 1], gap[3 * i + 2] = -high, -high, -high
        elif too_deep < 0 and high + max(offset[i, 0], offset[i, 1], offset[i, 2]) > limit[i]:  # without preload
            too_deep = i
    return too_deep


@kernel
def _fill_rows(
    gp, flags, pair, thick, x, x_old, points, active, w, gap, area, align, normal, push, slip, facing_out, pair_area,
    pair_normal, depth, face_normal,
):  # fmt: skip
    """Weights, gap, area, frame and slip of the rows of active patches; True if some patch is not aligned."""
    tet, du = np.empty(12), np.zeros((4, 3))
    unaligned, moving, p, q, r, t = False, False, -1, -1, -1, -1
    for i in range(len(gp)):
        if active[i] == 0:
            continue
        a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
        if gp[i, 3] != p or gp[i, 4] != q or gp[i, 5] != r or gp[i, 6] != t:
            p, q, r, t = gp[i, 3], gp[i, 4], gp[i, 5], gp[i, 6]
            _master_frame(gp, i, thick[i], x, tet)
            moving = False
            for k in range(4):
                g = gp[i, 3 + k]
                for d in range(3):
                    du[k, d] = x[g, d] - x_old[g, d]
                    moving |= du[k, d] != 0.0
        nx, ny, nz, double = _unit_normal(a, b, c, x)
        fx, fy, fz = face_normal[i, 0], face_normal[i, 1], face_normal[i, 2]
        push[i, 0], push[i, 1], push[i, 2] = nx, ny, nz
        facing = -(nx * fx + ny * fy + nz * fz)
        facing_out[i] = facing
        share = double * area[3 * i] / 6.0
        k = pair[i]
        pair_area[k] += 3.0 * share
        friction = (flags[i] & FACING) != 0
        ax, ay, az = x[a, 0] - x_old[a, 0], x[a, 1] - x_old[a, 1], x[a, 2] - x_old[a, 2]
        bx, by, bz = x[b, 0] - x_old[b, 0], x[b, 1] - x_old[b, 1], x[b, 2] - x_old[b, 2]
        cx, cy, cz = x[c, 0] - x_old[c, 0], x[c, 1] - x_old[c, 1], x[c, 2] - x_old[c, 2]
        pressed = 0.0
        for row in range(3 * i, 3 * i + 3):
            w1, w2 = points[i, row - 3 * i, 0], points[i, row - 3 * i, 1]
            w0 = 1.0 - w1 - w2
            dx = w0 * x[a, 0] + w1 * x[b, 0] + w2 * x[c, 0] - tet[0]
            dy = w0 * x[a, 1] + w1 * x[b, 1] + w2 * x[c, 1] - tet[1]
            dz = w0 * x[a, 2] + w1 * x[b, 2] + w2 * x[c, 2] - tet[2]
            l1 = dx * tet[3] + dy * tet[4] + dz * tet[5]
            l2 = dx * tet[6] + dy * tet[7] + dz * tet[8]
            l3 = dx * tet[9] + dy * tet[10] + dz * tet[11]
            l0 = 1.0 - l1 - l2 - l3
            w[row, 0], w[row, 1], w[row, 2] = w0, w1, w2
            w[row, 3], w[row, 4], w[row, 5], w[row, 6] = -l0, -l1, -l2, -l3
            slip[row, 0] = w0 * ax + w1 * bx + w2 * cx
            slip[row, 1] = w0 * ay + w1 * by + w2 * cy
            slip[row, 2] = w0 * az + w1 * bz + w2 * cz
            if moving:
                for d in range(3):
                    slip[row, d] -= l0 * du[0, d] + l1 * du[1, d] + l2 * du[2, d] + l3 * du[3, d]
            gap[row] = -(depth[i, 0] * w0 + depth[i, 1] * w1 + depth[i, 2] * w2)
            pressed += min(gap[row], 0.0)
            area[row] = share
            align[row] = facing if friction else 0.0
            normal[row, 0], normal[row, 1], normal[row, 2] = fx, fy, fz
        if friction and facing <= ALIGNED:
            unaligned = True
            pair_normal[k, 0] += share * pressed * nx
            pair_normal[k, 1] += share * pressed * ny
            pair_normal[k, 2] += share * pressed * nz
    return unaligned


@kernel
def _carry_memory(gp, flags, x, x_old, points_old, active_old, memory_old, points, active, memory):
    """Committed memory moved to the new points, its elastic slip turned with the frame of the slave face.

    The frame: first edge e, normal n, their product v. A slip s becomes ``sum (s.e_old) e / |e_old||e|`` over the three.
    """
    columns = memory.shape[1]
    for i in range(len(gp)):
        if active[i] == 0:
            continue
        lo = 3 * i
        if active_old[i] == 0 or not flags[i] & FACING:
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
                memory[row, 3], memory[row, 4], memory[row, 5] = memory_old[row, 3], memory_old[row, 4], memory_old[row, 5]
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
def project(
    gp, start, corners, offset, flags, pair, limit, thick, ref_points, ref_ratio, inverse_mass, inverse_gp, damped,
    x, x_old,
    points_old, active_old, memory_old, points, active, memory, w, gap, area, align, normal, push, slip, mass,
    facing_out, pair_area, pair_normal, depth, face_normal,
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
    | depth, face_normal | (n, 3) | m, - | out: depth at the slave gridpoints, normal of the master face |

    Returns
    -------
    int
        Index of a patch deeper than its limit, or -1.
    """
    for i in range(len(pair_area)):
        pair_area[i] = 0.0
        pair_normal[i, 0], pair_normal[i, 1], pair_normal[i, 2] = 0.0, 0.0, 0.0
    too_deep = _close_patches(
        gp, start, corners, offset, flags, limit, ref_points, ref_ratio, x, active_old, memory_old, points, active, area,
        gap, depth, face_normal,
    )  # fmt: skip
    unaligned = _fill_rows(
        gp, flags, pair, thick, x, x_old, points, active, w, gap, area, align, normal, push, slip, facing_out, pair_area,
        pair_normal, depth, face_normal,
    )  # fmt: skip
    _carry_memory(gp, flags, x, x_old, points_old, active_old, memory_old, points, active, memory)
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
    """Add -p a n_a + t a on the slave and the opposite on the master to the gridpoints, serially in row order.

    Weights of a side sum to one, so the first gridpoint gets what the others leave of the force. Forces on a master face
    are summed as long as patches stay on it.
    """
    n = len(gp)
    m1x, m1y, m1z, m2x, m2y, m2z, m3x, m3y, m3z, mx, my, mz = 12 * (0.0,)
    for i in range(n):
        if active[i] == 0:
            continue
        s1x, s1y, s1z, s2x, s2y, s2z, sx, sy, sz = 9 * (0.0,)
        for row in range(3 * i, 3 * i + 3):
            a, p = area[row], traction[row, 0]
            fx = a * (traction[row, 1] - p * push[i, 0])
            fy = a * (traction[row, 2] - p * push[i, 1])
            fz = a * (traction[row, 3] - p * push[i, 2])
            v, u = w[row, 1], w[row, 2]
            sx, sy, sz = sx + fx, sy + fy, sz + fz
            s1x, s1y, s1z = s1x + v * fx, s1y + v * fy, s1z + v * fz
            s2x, s2y, s2z = s2x + u * fx, s2y + u * fy, s2z + u * fz
            v, u, t = w[row, 4], w[row, 5], w[row, 6]
            m1x, m1y, m1z = m1x + v * fx, m1y + v * fy, m1z + v * fz
            m2x, m2y, m2z = m2x + u * fx, m2y + u * fy, m2z + u * fz
            m3x, m3y, m3z = m3x + t * fx, m3y + t * fy, m3z + t * fz
        g, h, k = gp[i, 0], gp[i, 1], gp[i, 2]
        f_gp[g, 0] += sx - s1x - s2x
        f_gp[g, 1] += sy - s1y - s2y
        f_gp[g, 2] += sz - s1z - s2z
        f_gp[h, 0] += s1x
        f_gp[h, 1] += s1y
        f_gp[h, 2] += s1z
        f_gp[k, 0] += s2x
        f_gp[k, 1] += s2y
        f_gp[k, 2] += s2z
        mx, my, mz = mx + sx, my + sy, mz + sz
        if i + 1 < n and active[i + 1] != 0 and gp[i, 3] == gp[i + 1, 3] and gp[i, 4] == gp[i + 1, 4]:
            if gp[i, 5] == gp[i + 1, 5] and gp[i, 6] == gp[i + 1, 6]:
                continue
        g, h, k, q = gp[i, 3], gp[i, 4], gp[i, 5], gp[i, 6]
        f_gp[g, 0] -= mx + m1x + m2x + m3x
        f_gp[g, 1] -= my + m1y + m2y + m3y
        f_gp[g, 2] -= mz + m1z + m2z + m3z
        f_gp[h, 0] += m1x
        f_gp[h, 1] += m1y
        f_gp[h, 2] += m1z
        f_gp[k, 0] += m2x
        f_gp[k, 1] += m2y
        f_gp[k, 2] += m2z
        f_gp[q, 0] += m3x
        f_gp[q, 1] += m3y
        f_gp[q, 2] += m3z
        m1x, m1y, m1z, m2x, m2y, m2z, m3x, m3y, m3z, mx, my, mz = 12 * (0.0,)


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
        _two_normals(gp, i, x, frame)
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
    face_m, points, frames, begin_old, end_old, face_m_old, points_old, active_old, memory_old, active, memory,
):  # fmt: skip
    """History of new patches from the old ones of the same pair (CONTACT.md 3.7).

    The same faces: the linear field of the old points. Else the nearest old point on the same slave face, unless it is
    further away than the patch is large; then the flag (column 3) stays 0. `begin_old`, `end_old` (n,) bound the old
    patches of the same pair and slave face; `frames` (n, 3) is the metric (g11, g12, g22) of the slave's reference triangle.
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
def closed_points(gp, start, corners, offset, bonded, ref_points, ref_ratio, x, points, active, area):
    """Points (n, 3, 2) and area (n,) [m2] of the parts closed in `x`; of the whole polygons where `bonded` (n,) says so."""
    longest = 3
    for i in range(len(gp)):
        longest = max(longest, start[i + 1] - start[i])
    poly, pts, frame, depth = np.empty((2 * longest + 2, 2)), np.empty((3, 2)), np.empty(6), np.empty(3)
    for i in range(len(gp)):
        double = _two_normals(gp, i, x, frame)
        m = gp[i, 3]
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
        ratio = ref_ratio[i]
        points[i] = ref_points[i]
        if low < 0.0 and not bonded[i]:
            n = _close(corners, start[i], start[i + 1], depth[0], depth[1], depth[2], poly)
            ratio = _moment_points(poly, n, pts) if n >= 3 else 0.0
            if ratio > 0.0:
                points[i] = pts
            else:
                active[i] = 0
        area[i] = 0.5 * double * max(ratio, 0.0)


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
