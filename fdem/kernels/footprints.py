"""Kernels over the polygons of contact patches: closed part, three points, size (CONTACT.md 3.3, 3.4).

A patch is a convex polygon on a slave face, its corners in the face's reference triangle (see kernels/geometry.py).
The depth below the master face is linear there, so three values (at the reference gridpoints) describe it.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

SHARP = 1  # kind of an edge, see kernels/geometry.py
WHOLE, DILATES, AJAR = 1, 8, 64  # bits of a patch's flags, see kernels/patches.py
SQRT2 = math.sqrt(2.0)
COS3 = (1.0, -0.5, -0.5)
SIN3 = (0.0, math.sqrt(0.75), -math.sqrt(0.75))
IN_PLANE = 1e-13  # of the face's size: a patch this close to the master's plane lies in it


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
def close_patches(
    gp, start, corners, offset, flags, limit, ref_points, ref_ratio, x, active_old, memory_old, points, active, area,
    gap, depth, face_normal,
):  # fmt: skip
    """Re-project patches and find their closed parts (CONTACT.md 3.4).

    | argument | shape | unit | |
    |---|---|---|---|
    | gp | (n, 7) | - | 3 slave, 4 master gridpoints |
    | offset | (n, 3) | m | reference gap d0 at the slave gridpoints |
    | limit | (n,) | m | largest depth |
    | ref_points, ref_ratio | (n, 3, 2), (n,) | - | points of the whole polygon, its share of the slave's triangle |
    | active_old, memory_old | (n,), (3 n, k) | | committed history: bonds and dilation |
    | points | (n, 3, 2) | - | out: places of the three points |
    | active | (n,) | - | out: 1 where the patch carries anything |
    | area | (3 n,) | - | out: in row 3 i the closed share of the slave's triangle; 0 in all rows where open |
    | gap | (3 n,) | m | out for open patches |
    | depth, face_normal | (n, 3) | m, - | out: depth at the slave gridpoints, normal of the master face |

    Returns
    -------
    int
        Index of a patch deeper than its limit, or -1.
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
            ux, uy, uz = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
            vx, vy, vz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
            fx, fy, fz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            level = math.sqrt(fx * fx + fy * fy + fz * fz)
            fx, fy, fz = fx / level, fy / level, fz / level
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
def _copy(source, target):
    """Three points."""
    for q in range(3):
        target[q, 0], target[q, 1] = source[q, 0], source[q, 1]


@kernel
def measure(
    gp, start, corners, offset, x, ref_points, ref_ratio, area, closed, align, depth, plane_depth, centre
):  # fmt: skip
    """Size and position of patches: whole area, closed area [m2], -n_a.n_f, largest depth [m], centroid (n, 3).

    `ref_points` (n, 3, 2), `ref_ratio` (n,): points of the whole polygons and their shares of the slaves' triangles.
    `plane_depth` (n, 3): depth below the master plane at the three slave gridpoints, no offset taken off. A patch that
    lies in the plane but for round-off is closed, whatever its sign.
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
        low, top = np.inf, -np.inf
        n = start[i + 1] - start[i]
        for k in range(n):
            w1, w2 = corners[start[i] + k, 0], corners[start[i] + k, 1]
            poly[k, 0], poly[k, 1] = w1, w2
            level = d0 * (1.0 - w1 - w2) + d1 * w1 + d2 * w2
            low, top = min(low, level), max(top, level)
        depth[i] = top
        ref_ratio[i] = _moment_points(poly, n, pts)
        area[i] = 0.5 * double * ref_ratio[i]
        if ref_ratio[i] > 0.0:
            _copy(pts, ref_points[i])
        for d in range(3):
            c = 0.0
            for q in range(3):
                w1, w2 = pts[q, 0], pts[q, 1]
                c += (1.0 - w1 - w2) * x[gp[i, 0], d] + w1 * x[gp[i, 1], d] + w2 * x[gp[i, 2], d]
            centre[i, d] = c / 3.0
        n = _close(corners, start[i], start[i + 1], d0, d1, d2, poly)
        closed[i] = 0.5 * double * _moment_points(poly, n, pts) if n >= 3 else 0.0
        if low > -IN_PLANE * math.sqrt(double):
            closed[i] = area[i]


@kernel
def along_edges(
    use, face_m, gp, start, corners, x, area, depth, corner_start, corner_x, normal, kind, share, flags, reach
):  # fmt: skip
    """Tell patches in `use` (n,) that end at a sharp edge of their master face, where its cell ends at a bisector.

    An open one (`depth` (n,) [m], its largest, below 0) goes beyond the edge and is flagged AJAR; a closed one ends
    before it and gets the normal `reach` (n,) [m] `share` times its width. `area` (n,) [m2]; the others are arrays of
    `Patches`, `Surfaces` and `FaceGeometry`.
    """
    place = np.empty(3)
    for i in range(len(use)):
        if not use[i]:
            continue
        f = face_m[i]
        first, last = corner_start[f], corner_start[f + 1]
        at_edge, longest = False, 0.0
        for k in range(start[i], start[i + 1]):
            w1, w2 = corners[k, 0], corners[k, 1]
            v1, v2 = corners[start[i], 0], corners[start[i], 1]
            far = 0.0
            for d in range(3):
                p, q, r = x[gp[i, 0], d], x[gp[i, 1], d], x[gp[i, 2], d]
                place[d] = p + w1 * (q - p) + w2 * (r - p)
                far += ((w1 - v1) * (q - p) + (w2 - v2) * (r - p)) ** 2
            longest = max(longest, math.sqrt(far))
            for c in range(first, last):
                if kind[c] != SHARP:
                    continue
                e = c + 1 if c + 1 < last else first
                ax, ay, az = (
                    corner_x[e, 0] - corner_x[c, 0],
                    corner_x[e, 1] - corner_x[c, 1],
                    corner_x[e, 2] - corner_x[c, 2],
                )
                bx, by, bz = place[0] - corner_x[c, 0], place[1] - corner_x[c, 1], place[2] - corner_x[c, 2]
                beyond = normal[f, 0] * (by * az - bz * ay) + normal[f, 1] * (bz * ax - bx * az)
                beyond += normal[f, 2] * (bx * ay - by * ax)
                beyond /= math.sqrt(ax * ax + ay * ay + az * az)
                at_edge = at_edge or beyond > -2.0 * max(depth[i], 0.0)
        if at_edge and depth[i] < 0.0:
            flags[i] |= AJAR
        elif at_edge:
            reach[i] = min(reach[i], share * area[i] / longest)


@kernel
def closed_points(gp, start, corners, offset, bonded, ref_points, ref_ratio, x, points, active, area):
    """Points (n, 3, 2) and area (n,) [m2] of the parts closed in `x`; all of a polygon where `bonded` (n,) is set."""
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
        _copy(ref_points[i], points[i])
        if low < 0.0 and not bonded[i]:
            n = _close(corners, start[i], start[i + 1], depth[0], depth[1], depth[2], poly)
            ratio = _moment_points(poly, n, pts) if n >= 3 else 0.0
            if ratio > 0.0:
                _copy(pts, points[i])
            else:
                active[i] = 0
        area[i] = 0.5 * double * max(ratio, 0.0)


@kernel
def latent_reach(local, skip, start, corners, depth, area, ratio, level, out):
    """How much deeper [m] a pair may get until `level` (n_pairs,) [m2] of a patch not in `skip` is closed.

    `depth` (n, 3) [m] is taken at the reference gridpoints; `area` (n,) [m2] and `ratio` are those of whole polygons.
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
