"""Kernels of contact geometry: faces, boxes, pairs, and the clip that makes contact patches (CONTACT.md 3.1-3.3).

A polygon on a slave face lives in the face's reference triangle: a corner is (w1, w2), the weights of the second
and third reference gridpoint. A linear function in space is, on the face, given by its three values there; clipping
a polygon by a plane needs nothing else. The same numbers hold in every affinely deformed position.

The depth field of a master is ``d(x) = min over its faces g with x in R_g of n_g . (c_g - x)``. For convex masters
``R_g`` is everything, so cells are bounded by the bisectors with all other faces. For other masters ``R_g`` is bounded
by the bisector at re-entrant and smooth edges, and at a sharp convex edge by the *union* of bisector and the plane
through the edge normal to the face, so that a face does not compete beyond its border.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

SMOOTH, SHARP, BORDER = 0, 1, 2  # kinds of edges
SNAP = 1e-13  # of the size: a corner this close to a plane lies on it
FALSE_DEPTH = 1e-6  # of the size: pieces deeper than this must prove that they lie inside the master


@kernel
def face_geometry(
    blocks, face_start, corner_start, corner_w, ref, neighbour, sharp, is_open, x,
    corner_x, normal, wall, kind, lower, upper, block_lower, block_upper,
):  # fmt: skip
    """Corners [m], normals, walls (unit, into the cell), edge kinds and boxes of the faces of `blocks`."""
    for b in blocks:
        for d in range(3):
            block_lower[b, d] = np.inf
            block_upper[b, d] = -np.inf
        for f in range(face_start[b], face_start[b + 1]):
            p, q, r = ref[f, 0], ref[f, 1], ref[f, 2]
            ax, ay, az = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
            bx, by, bz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            s = math.sqrt(nx * nx + ny * ny + nz * nz)
            normal[f, 0], normal[f, 1], normal[f, 2] = nx / s, ny / s, nz / s
            for d in range(3):
                lower[f, d] = np.inf
                upper[f, d] = -np.inf
            for c in range(corner_start[f], corner_start[f + 1]):
                w1, w2 = corner_w[c, 0], corner_w[c, 1]
                for d in range(3):
                    v = x[p, d] * (1.0 - w1 - w2) + x[q, d] * w1 + x[r, d] * w2
                    corner_x[c, d] = v
                    lower[f, d] = min(lower[f, d], v)
                    upper[f, d] = max(upper[f, d], v)
            for d in range(3):
                block_lower[b, d] = min(block_lower[b, d], lower[f, d])
                block_upper[b, d] = max(block_upper[b, d], upper[f, d])
        for f in range(face_start[b], face_start[b + 1]):
            first, last = corner_start[f], corner_start[f + 1]
            for c in range(first, last):
                follow = c + 1 if c + 1 < last else first
                ex = corner_x[follow, 0] - corner_x[c, 0]
                ey = corner_x[follow, 1] - corner_x[c, 1]
                ez = corner_x[follow, 2] - corner_x[c, 2]
                nx, ny, nz = normal[f, 0], normal[f, 1], normal[f, 2]
                g = neighbour[c]
                kind[c] = SMOOTH
                if g >= 0:
                    gx, gy, gz = normal[g, 0], normal[g, 1], normal[g, 2]
                    cosine = nx * gx + ny * gy + nz * gz
                    tilt = gx * (ny * ez - nz * ey) + gy * (nz * ex - nx * ez) + gz * (nx * ey - ny * ex)
                    if tilt < 0.0 and cosine <= sharp[b]:
                        kind[c] = SHARP
                    if cosine > -1.0 + 1e-9:
                        nx, ny, nz = nx + gx, ny + gy, nz + gz
                elif is_open[b]:
                    kind[c] = BORDER
                wx, wy, wz = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
                s = math.sqrt(wx * wx + wy * wy + wz * wz)
                wall[c, 0], wall[c, 1], wall[c, 2] = wx / s, wy / s, wz / s


@kernel
def convex_blocks(face_start, corner_start, neighbour, normal, corner_x, affine, is_open, convex):
    """Mark affine closed blocks all of whose edges are convex (a closed connected surface is then convex)."""
    for b in range(len(face_start) - 1):
        good = affine[b] == 1 and is_open[b] == 0
        for f in range(face_start[b], face_start[b + 1]):
            if not good:
                break
            first, last = corner_start[f], corner_start[f + 1]
            for c in range(first, last):
                follow = c + 1 if c + 1 < last else first
                g = neighbour[c]
                if g < 0:
                    good = False
                    break
                ex = corner_x[follow, 0] - corner_x[c, 0]
                ey = corner_x[follow, 1] - corner_x[c, 1]
                ez = corner_x[follow, 2] - corner_x[c, 2]
                nx, ny, nz = normal[f, 0], normal[f, 1], normal[f, 2]
                tilt = (
                    normal[g, 0] * (ny * ez - nz * ey)
                    + normal[g, 1] * (nz * ex - nx * ez)
                    + normal[g, 2] * (nx * ey - ny * ex)
                )
                if tilt > 1e-9 * math.sqrt(ex * ex + ey * ey + ez * ez):
                    good = False
                    break
        convex[b] = 1 if good else 0


@kernel
def thickness(face_start, corner_start, corner_x, normal, convex, is_open, lower, upper, out):
    """Thickness of the block behind every face [m]: extent of a convex block, else along the ray from the centroid."""
    for b in range(len(face_start) - 1):
        f0, f1 = face_start[b], face_start[b + 1]
        for f in range(f0, f1):
            if is_open[b]:
                out[f] = np.inf
                continue
            first, last = corner_start[f], corner_start[f + 1]
            n0, n1, n2 = normal[f, 0], normal[f, 1], normal[f, 2]
            if convex[b]:
                h = 0.0
                for c in range(corner_start[f0], corner_start[f1]):
                    d = (
                        n0 * (corner_x[first, 0] - corner_x[c, 0])
                        + n1 * (corner_x[first, 1] - corner_x[c, 1])
                        + n2 * (corner_x[first, 2] - corner_x[c, 2])
                    )
                    h = max(h, d)
                out[f] = h
                continue
            px, py, pz = 0.0, 0.0, 0.0
            for c in range(first, last):
                px, py, pz = px + corner_x[c, 0], py + corner_x[c, 1], pz + corner_x[c, 2]
            m = last - first
            px, py, pz = px / m, py / m, pz / m
            hit = np.inf
            for g in range(f0, f1):
                slope = n0 * normal[g, 0] + n1 * normal[g, 1] + n2 * normal[g, 2]
                if g == f or slope > -1e-6:
                    continue
                a, z = corner_start[g], corner_start[g + 1]
                t = (
                    normal[g, 0] * (px - corner_x[a, 0])
                    + normal[g, 1] * (py - corner_x[a, 1])
                    + normal[g, 2] * (pz - corner_x[a, 2])
                ) / slope
                if t <= 0.0 or t >= hit:
                    continue
                yx, yy, yz = px - t * n0, py - t * n1, pz - t * n2
                inside = True
                for c in range(a, z):
                    k = c + 1 if c + 1 < z else a
                    ex, ey, ez = (
                        corner_x[k, 0] - corner_x[c, 0],
                        corner_x[k, 1] - corner_x[c, 1],
                        corner_x[k, 2] - corner_x[c, 2],
                    )
                    dx, dy, dz = yx - corner_x[c, 0], yy - corner_x[c, 1], yz - corner_x[c, 2]
                    turn = (
                        normal[g, 0] * (ey * dz - ez * dy)
                        + normal[g, 1] * (ez * dx - ex * dz)
                        + normal[g, 2] * (ex * dy - ey * dx)
                    )
                    if turn < -1e-9 * (ex * ex + ey * ey + ez * ez):
                        inside = False
                        break
                if inside:
                    hit = t
            if hit == np.inf:  # numerically open: fall back to the extent of the block along the normal
                hit = 0.0
                for c in range(corner_start[f0], corner_start[f1]):
                    d = n0 * (px - corner_x[c, 0]) + n1 * (py - corner_x[c, 1]) + n2 * (pz - corner_x[c, 2])
                    hit = max(hit, d)
            out[f] = hit


@kernel
def sweep(lower, upper, reach, fixed):
    """Pairs (i < j) of blocks whose boxes, grown by `reach` (n_blocks,) [m], meet; not both fixed. Sorted by id."""
    n = len(reach)
    lo, hi = lower.copy(), upper.copy()
    spread = np.zeros(3)
    for i in range(n):
        for d in range(3):
            lo[i, d] -= reach[i]
            hi[i, d] += reach[i]
    for d in range(3):
        spread[d] = np.std(lo[:, d])
    axis = np.argmax(spread)
    order = np.argsort(lo[:, axis], kind="mergesort")
    out = np.empty((max(16, 8 * n), 2), np.int32)
    m = 0
    for k in range(n):
        i = order[k]
        for q in range(k + 1, n):
            j = order[q]
            if lo[j, axis] > hi[i, axis]:
                break
            if fixed[i] and fixed[j]:
                continue
            apart = False
            for d in range(3):
                if lo[j, d] > hi[i, d] or lo[i, d] > hi[j, d]:
                    apart = True
            if apart:
                continue
            if m == len(out):
                grown = np.empty((2 * m, 2), np.int32)
                grown[:m] = out
                out = grown
            out[m, 0], out[m, 1] = min(i, j), max(i, j)
            m += 1
    out = out[:m]
    key = out[:, 0].astype(np.int64) * n + out[:, 1]
    return out[np.argsort(key, kind="mergesort")]


@kernel
def _cut(poly, n, l0, l1, l2, snap, tmp):
    """Clip `poly[:n]` in place to ``l >= 0`` of the linear function with corner values l0, l1, l2; new corner count.

    Values below `snap` count as zero, so that a plane through a corner leaves the polygon alone.
    """
    out = False
    inside = False
    for i in range(n):
        w1, w2 = poly[i, 0], poly[i, 1]
        v = l0 * (1.0 - w1 - w2) + l1 * w1 + l2 * w2
        if v < -snap:
            out = True
        elif v > snap:
            inside = True
    if not out:
        return n
    if not inside:
        return 0
    m = 0
    a1, a2 = poly[n - 1, 0], poly[n - 1, 1]
    va = l0 * (1.0 - a1 - a2) + l1 * a1 + l2 * a2
    for i in range(n):
        b1, b2 = poly[i, 0], poly[i, 1]
        vb = l0 * (1.0 - b1 - b2) + l1 * b1 + l2 * b2
        if (va >= 0.0) != (vb >= 0.0):
            t = va / (va - vb)
            tmp[m, 0] = a1 + t * (b1 - a1)
            tmp[m, 1] = a2 + t * (b2 - a2)
            m += 1
        if vb >= 0.0:
            tmp[m, 0] = b1
            tmp[m, 1] = b2
            m += 1
        a1, a2, va = b1, b2, vb
    for i in range(m):
        poly[i, 0] = tmp[i, 0]
        poly[i, 1] = tmp[i, 1]
    return m if m >= 3 else 0


@kernel
def _extremes(poly, n, l0, l1, l2):
    """Smallest and largest value of a linear function on the corners of a polygon."""
    low, high = np.inf, -np.inf
    for i in range(n):
        w1, w2 = poly[i, 0], poly[i, 1]
        v = l0 * (1.0 - w1 - w2) + l1 * w1 + l2 * w2
        low = min(low, v)
        high = max(high, v)
    return low, high


@kernel
def _ratio(poly, n):
    """Area of the polygon over the area of the reference triangle."""
    s = 0.0
    for i in range(1, n - 1):
        s += (poly[i, 0] - poly[0, 0]) * (poly[i + 1, 1] - poly[0, 1])
        s -= (poly[i, 1] - poly[0, 1]) * (poly[i + 1, 0] - poly[0, 0])
    return s


@kernel
def _plane_values(n, c, xs, out):
    """Values n . (x_k - c) at the three reference gridpoints xs (3, 3) of the slave face."""
    for k in range(3):
        out[k] = n[0] * (xs[k, 0] - c[0]) + n[1] * (xs[k, 1] - c[1]) + n[2] * (xs[k, 2] - c[2])


@kernel
def _middle(poly, n, xs, out):
    """Mean of the corners of a polygon: its place `out` [m] and its two weights."""
    w1, w2 = 0.0, 0.0
    for i in range(n):
        w1, w2 = w1 + poly[i, 0] / n, w2 + poly[i, 1] / n
    for d in range(3):
        out[d] = (1.0 - w1 - w2) * xs[0, d] + w1 * xs[1, d] + w2 * xs[2, d]
    return w1, w2


@kernel
def _distance2(o, g, corner_start, corner_x, normal):
    """Square of the distance of the point `o` from the convex polygon g [m^2]."""
    first, last = corner_start[g], corner_start[g + 1]
    best = np.inf
    over = True
    for c in range(first, last):
        k = c + 1 if c + 1 < last else first
        ex, ey, ez = corner_x[k, 0] - corner_x[c, 0], corner_x[k, 1] - corner_x[c, 1], corner_x[k, 2] - corner_x[c, 2]
        dx, dy, dz = o[0] - corner_x[c, 0], o[1] - corner_x[c, 1], o[2] - corner_x[c, 2]
        turn = (
            normal[g, 0] * (ey * dz - ez * dy) + normal[g, 1] * (ez * dx - ex * dz) + normal[g, 2] * (ex * dy - ey * dx)
        )
        if turn < 0.0:
            over = False
            t = (ex * dx + ey * dy + ez * dz) / (ex * ex + ey * ey + ez * ez)
            t = min(max(t, 0.0), 1.0)
            rx, ry, rz = dx - t * ex, dy - t * ey, dz - t * ez
            best = min(best, rx * rx + ry * ry + rz * rz)
    if over:
        d = (
            normal[g, 0] * (o[0] - corner_x[first, 0])
            + normal[g, 1] * (o[1] - corner_x[first, 1])
            + normal[g, 2] * (o[2] - corner_x[first, 2])
        )
        best = d * d
    return best


@kernel
def _own_cell(f, b, xs, df, poly, count, snap, convex, corner_start, corner_x, normal, wall, kind, bufs, work, tmp):
    """Split `poly[:count]` into the pieces inside R_f; returns their number, margin and miss; counts go to `work`.

    Margin: distance to the nearest wall that did not cut; miss: how far outside an emptied polygon lies.
    """
    v = np.empty(3)
    margin, miss = np.inf, np.inf
    first, last = corner_start[f], corner_start[f + 1]
    for c in range(first, last):
        if kind[c] == BORDER or (kind[c] == SHARP and not convex):
            continue
        _plane_values(wall[c], corner_x[c], xs, v)
        low, high = _extremes(poly, count, v[0], v[1], v[2])
        if high <= snap:
            return 0, margin, max(-high, 0.0)
        margin = min(margin, max(low, 0.0))
        count = _cut(poly, count, v[0], v[1], v[2], snap, tmp)
        if count == 0:
            return 0, 0.0, 0.0
    for i in range(count):
        bufs[0, i, 0], bufs[0, i, 1] = poly[i, 0], poly[i, 1]
    work[0] = count
    n_pieces = 1
    if convex:
        return n_pieces, margin, miss
    side = np.empty(3)
    vertical = np.empty(3)
    for c in range(first, last):
        if kind[c] != SHARP:
            continue
        _plane_values(wall[c], corner_x[c], xs, v)
        k = c + 1 if c + 1 < last else first
        ex, ey, ez = corner_x[k, 0] - corner_x[c, 0], corner_x[k, 1] - corner_x[c, 1], corner_x[k, 2] - corner_x[c, 2]
        length = math.sqrt(ex * ex + ey * ey + ez * ez)
        side[0] = (normal[f, 1] * ez - normal[f, 2] * ey) / length
        side[1] = (normal[f, 2] * ex - normal[f, 0] * ez) / length
        side[2] = (normal[f, 0] * ey - normal[f, 1] * ex) / length
        _plane_values(side, corner_x[c], xs, vertical)
        for q in range(n_pieces):
            m = work[q]
            if m == 0:
                continue
            low, high = _extremes(bufs[q], m, v[0], v[1], v[2])
            margin = min(margin, max(low, 0.0))
            if low >= -snap:
                continue
            if n_pieces < len(bufs):  # the part beyond the bisector but above the face
                for i in range(m):
                    bufs[n_pieces, i, 0], bufs[n_pieces, i, 1] = bufs[q, i, 0], bufs[q, i, 1]
                extra = _cut(bufs[n_pieces], m, -v[0], -v[1], -v[2], snap, tmp)
                if extra > 0:
                    extra = _cut(bufs[n_pieces], extra, vertical[0], vertical[1], vertical[2], snap, tmp)
                if extra > 0 and _ratio(bufs[n_pieces], extra) > 1e-14:
                    work[n_pieces] = extra
                    n_pieces += 1
            if high <= snap:
                miss = min(miss, max(-high, 0.0))
            work[q] = _cut(bufs[q], m, v[0], v[1], v[2], snap, tmp)
    return n_pieces, margin, miss


@kernel
def _rival(
    f, g, xs, df, dg, outside, reach, bufs, work, n_pieces, snap, corner_start, corner_x, normal, wall, kind, tmp, part,
    side, v,
):  # fmt: skip
    """Take away from the pieces what lies in the cell of the competing face g; returns the number of pieces.

    Inside the master (depth of g >= 0) g reaches up to the planes normal to it through its sharp edges, outside
    (`outside`) up to the bisectors, and only where its polygon is not farther away than that of f.
    """
    first, last = corner_start[g], corner_start[g + 1]
    n_old = n_pieces
    for q in range(n_old):
        m = work[q]
        if m == 0:
            continue
        # the planes of the region to take away, one by one; what lies beyond each is a piece to keep
        for i in range(m):
            part[i, 0], part[i, 1] = bufs[q, i, 0], bufs[q, i, 1]
        n = m
        for step in range(2):  # first find out whether there is anything to take away, then do it
            if step == 1:
                if n == 0 or _ratio(part, n) <= 1e-13 * _ratio(bufs[q], m):
                    break
                if outside:
                    _middle(part, n, xs, side)
                    mine = _distance2(side, f, corner_start, corner_x, normal)
                    if _distance2(side, g, corner_start, corner_x, normal) > mine * (1.0 + 1e-9):
                        break
                for i in range(m):
                    part[i, 0], part[i, 1] = bufs[q, i, 0], bufs[q, i, 1]
                n = m
                work[q] = 0
                made = False
            for e in range(-2 if not outside else -3, last - first):
                if e == -3:
                    for k in range(3):
                        v[k] = dg[k] + reach
                elif e == -2:
                    for k in range(3):
                        v[k] = df[k] - dg[k]
                elif e == -1:
                    for k in range(3):
                        v[k] = -dg[k] if outside else dg[k]
                else:
                    c = first + e
                    if kind[c] == BORDER:
                        continue
                    if kind[c] == SHARP and not outside:
                        k = c + 1 if c + 1 < last else first
                        ex, ey, ez = (
                            corner_x[k, 0] - corner_x[c, 0],
                            corner_x[k, 1] - corner_x[c, 1],
                            corner_x[k, 2] - corner_x[c, 2],
                        )
                        length = math.sqrt(ex * ex + ey * ey + ez * ez)
                        side[0] = (normal[g, 1] * ez - normal[g, 2] * ey) / length
                        side[1] = (normal[g, 2] * ex - normal[g, 0] * ez) / length
                        side[2] = (normal[g, 0] * ey - normal[g, 1] * ex) / length
                        _plane_values(side, corner_x[c], xs, v)
                    else:
                        _plane_values(wall[c], corner_x[c], xs, v)
                if step == 1:
                    low, _ = _extremes(part, n, v[0], v[1], v[2])
                    if low >= -snap:
                        continue
                    target = q if not made else n_pieces
                    if target < len(bufs):
                        for i in range(n):
                            bufs[target, i, 0], bufs[target, i, 1] = part[i, 0], part[i, 1]
                        rest = _cut(bufs[target], n, -v[0], -v[1], -v[2], snap, tmp)
                        if rest > 0 and _ratio(bufs[target], rest) > 1e-14:
                            work[target] = rest
                            if made:
                                n_pieces += 1
                            made = True
                n = _cut(part, n, v[0], v[1], v[2], snap, tmp)
                if n == 0:
                    break
    return n_pieces


@kernel
def _inside(o, b, face_start, corner_start, corner_x):
    """Whether the point `o` lies inside the closed surface of block b (Van Oosterom and Strackee, 1983)."""
    angle = 0.0
    for f in range(face_start[b], face_start[b + 1]):
        first = corner_start[f]
        for c in range(first + 1, corner_start[f + 1] - 1):
            ax, ay, az = corner_x[first, 0] - o[0], corner_x[first, 1] - o[1], corner_x[first, 2] - o[2]
            bx, by, bz = corner_x[c, 0] - o[0], corner_x[c, 1] - o[1], corner_x[c, 2] - o[2]
            cx, cy, cz = corner_x[c + 1, 0] - o[0], corner_x[c + 1, 1] - o[1], corner_x[c + 1, 2] - o[2]
            la, lb = math.sqrt(ax * ax + ay * ay + az * az), math.sqrt(bx * bx + by * by + bz * bz)
            lc = math.sqrt(cx * cx + cy * cy + cz * cz)
            triple = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
            ab, bc, ca = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz, cx * ax + cy * ay + cz * az
            angle += 2.0 * math.atan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb)
    return angle > 2.0 * math.pi


@kernel
def _owns(f, b, part, n, xs, df, affine, face_start, corner_start, corner_x, normal, lower, upper, o):
    """Whether the middle of the polygon `part[:n]` lies inside block b, and no face of b is nearer than the plane of f.

    The depth of a cell is at most the distance to the whole surface; faces that count as one smooth surface are
    compared with a tolerance.
    """
    w1, w2 = _middle(part, n, xs, o)
    depth = (1.0 - w1 - w2) * df[0] + w1 * df[1] + w2 * df[2]
    radius = depth * (0.98 if affine else 0.8)
    r2 = radius * radius
    alone = True
    for g in range(face_start[b], face_start[b + 1]):
        if g == f:
            continue
        gap2 = 0.0
        for d in range(3):
            gap = max(lower[g, d] - o[d], o[d] - upper[g, d])
            if gap > 0.0:
                gap2 += gap * gap
        if gap2 < depth * depth:
            d2 = _distance2(o, g, corner_start, corner_x, normal)
            if d2 < r2:
                return False
            alone = alone and d2 > depth * depth
    if alone and _distance2(o, f, corner_start, corner_x, normal) <= depth * depth * (1.0 + 1e-9):
        return True  # straight below f and nothing in between
    return _inside(o, b, face_start, corner_start, corner_x)


@kernel
def clip_pairs(
    slave, master, window, size, max_corners, face_start, corner_start, corner_w, ref, limit, convex, affine, is_open,
    x, corner_x, normal, wall, kind, lower, upper, block_lower, block_upper,
):  # fmt: skip
    """Cut the surfaces of slaves by the depth cells of masters: the patches of the pairs.

    | argument | shape | unit | |
    |---|---|---|---|
    | slave, master | (n_pairs,) | - | block ids |
    | window | (n_pairs,) | m | patches are made up to this gap |
    | size | (n_pairs,) | m | size of the smaller block |
    | others | | | arrays of `Surfaces` and `FaceGeometry` |

    Returns
    -------
    pair, face_s, face_m : (n_patches,) int32
    start : (n_patches + 1,) int32
        Corner offsets.
    corners : (n, 2)
    margin : (n_patches,)
        Distance to the nearest wall that could cut the polygon next [m]; 0 if one did.
    miss : (n_pairs,)
        Smallest distance by which a face near the master's surface missed a cell [m].
    miss_face : (n_pairs, 2)
        The faces concerned (slave, master), -1 if none.
    too_deep : (n_pairs,) uint8
        1 where a part of the slave lies deeper than the limit.
    """
    n_pairs = len(slave)
    room = 4 * max_corners + 64
    poly = np.empty((room, 2))
    tmp = np.empty((room, 2))
    part = np.empty((room, 2))
    bufs = np.empty((64, room, 2))
    work = np.zeros(64, np.int64)
    xs, df, dg, v, side = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    cap, corner_cap = 64, 512
    pair, face_s, face_m = np.empty(cap, np.int32), np.empty(cap, np.int32), np.empty(cap, np.int32)
    margins, start = np.empty(cap), np.zeros(cap + 1, np.int32)
    corners = np.empty((corner_cap, 2))
    miss = np.full(n_pairs, np.inf)
    miss_face = np.full((n_pairs, 2), -1, np.int32)
    too_deep = np.zeros(n_pairs, np.uint8)
    n_out, n_corners = 0, 0
    for p in range(n_pairs):
        s, m = slave[p], master[p]
        h = window[p]
        snap = SNAP * size[p]
        near_m = np.empty(face_start[m + 1] - face_start[m], np.int32)
        k_m = 0
        for f in range(face_start[m], face_start[m + 1]):
            far = 2.0 * (
                h + min(limit[f], size[p])
            )  # a slave that is all inside is still in the cells of faces around it
            apart = False
            for d in range(3):
                if lower[f, d] > block_upper[s, d] + far or upper[f, d] < block_lower[s, d] - far:
                    apart = True
            if not apart:
                near_m[k_m] = f
                k_m += 1
        near_s = np.empty(face_start[s + 1] - face_start[s], np.int32)
        k_s = 0
        for a in range(face_start[s], face_start[s + 1]):
            apart = False
            for d in range(3):
                if lower[a, d] > block_upper[m, d] + h or upper[a, d] < block_lower[m, d] - h:
                    apart = True
            if not apart:
                near_s[k_s] = a
                k_s += 1
        if k_s == 0 or k_m == 0:
            continue
        axis, widest, longest = 0, -1.0, 0.0
        for d in range(3):
            lo, hi = np.inf, -np.inf
            for i in range(k_s):
                lo, hi = min(lo, lower[near_s[i], d]), max(hi, upper[near_s[i], d])
            if hi - lo > widest:
                axis, widest = d, hi - lo
        begin = np.empty(k_s)
        for i in range(k_s):
            begin[i] = lower[near_s[i], axis]
            longest = max(longest, upper[near_s[i], axis] - lower[near_s[i], axis])
        order = np.argsort(begin, kind="mergesort")
        sorted_begin = begin[order]
        few = face_start[m + 1] - face_start[m] <= 32
        for fi in range(k_m):
            f = near_m[fi]
            deep = min(limit[f], size[p])
            i0 = np.searchsorted(sorted_begin, lower[f, axis] - 2.0 * (h + deep) - longest)
            chosen = np.empty(k_s, np.int32)
            n_chosen = 0
            for i in range(i0, k_s):
                if sorted_begin[i] > upper[f, axis] + 2.0 * (h + deep):
                    break
                chosen[n_chosen] = near_s[order[i]]
                n_chosen += 1
            chosen_s = np.sort(chosen[:n_chosen])
            for a in chosen_s:
                for k in range(3):
                    for d in range(3):
                        xs[k, d] = x[ref[a, k], d]
                base = corner_x[corner_start[f]]
                _plane_values(normal[f], base, xs, df)
                for k in range(3):
                    df[k] = -df[k]
                count = 0
                for c in range(corner_start[a], corner_start[a + 1]):
                    poly[count, 0], poly[count, 1] = corner_w[c, 0], corner_w[c, 1]
                    count += 1
                low, high = _extremes(poly, count, df[0], df[1], df[2])
                if high < -h:
                    continue
                reach = 2.0 * (h + min(max(high, 0.0), deep))
                apart = False
                for d in range(3):
                    if lower[a, d] > upper[f, d] + reach or upper[a, d] < lower[f, d] - reach:
                        apart = True
                if apart:
                    continue
                if low < -h:
                    count = _cut(poly, count, df[0] + h, df[1] + h, df[2] + h, snap, tmp)
                if count == 0:
                    continue
                n_pieces, margin, lost = _own_cell(
                    f, m, xs, df, poly, count, snap, convex[m], corner_start, corner_x, normal, wall, kind, bufs, work,
                    tmp,
                )  # fmt: skip
                if n_pieces == 0 and lost < miss[p]:
                    miss[p] = lost
                    miss_face[p, 0], miss_face[p, 1] = a, f
                if n_pieces == 0:
                    continue
                # rivals: other faces that are nearer somewhere on the polygon
                deepest = -np.inf
                for d in range(3):
                    side[d] = 0.0
                plo0, plo1, plo2, phi0, phi1, phi2 = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
                for q in range(n_pieces):
                    for i in range(work[q]):
                        w1, w2 = bufs[q, i, 0], bufs[q, i, 1]
                        w0 = 1.0 - w1 - w2
                        deepest = max(deepest, w0 * df[0] + w1 * df[1] + w2 * df[2])
                        y0 = w0 * xs[0, 0] + w1 * xs[1, 0] + w2 * xs[2, 0]
                        y1 = w0 * xs[0, 1] + w1 * xs[1, 1] + w2 * xs[2, 1]
                        y2 = w0 * xs[0, 2] + w1 * xs[1, 2] + w2 * xs[2, 2]
                        plo0, plo1, plo2 = min(plo0, y0), min(plo1, y1), min(plo2, y2)
                        phi0, phi1, phi2 = max(phi0, y0), max(phi1, y1), max(phi2, y2)
                near = max(4.0 * h, deepest)
                for g in range(face_start[m], face_start[m + 1]):
                    if g == f:
                        continue
                    if not (few and convex[m]) and (
                        lower[g, 0] > phi0 + near or lower[g, 1] > phi1 + near or lower[g, 2] > phi2 + near
                        or upper[g, 0] < plo0 - near or upper[g, 1] < plo1 - near or upper[g, 2] < plo2 - near
                    ):  # fmt: skip
                        continue
                    cosine = normal[f, 0] * normal[g, 0] + normal[f, 1] * normal[g, 1] + normal[f, 2] * normal[g, 2]
                    if cosine > (1.0 - 1e-14 if affine[m] else 0.9):
                        continue
                    _plane_values(normal[g], corner_x[corner_start[g]], xs, dg)
                    for k in range(3):
                        dg[k] = -dg[k]
                    if convex[m]:
                        length = math.sqrt(2.0 - 2.0 * cosine)
                        if work[0] == 0:
                            break
                        for k in range(3):
                            v[k] = (dg[k] - df[k]) / length
                        low, high = _extremes(bufs[0], work[0], v[0], v[1], v[2])
                        if high <= snap:
                            if max(-high, 0.0) < miss[p]:
                                miss[p] = max(-high, 0.0)
                                miss_face[p, 0], miss_face[p, 1] = a, f
                            work[0] = 0
                            break
                        margin = min(margin, max(low, 0.0))
                        work[0] = _cut(bufs[0], work[0], v[0], v[1], v[2], snap, tmp)
                    else:
                        nearer = False
                        for q in range(n_pieces):
                            low, high = _extremes(bufs[q], work[q], dg[0] - df[0], dg[1] - df[1], dg[2] - df[2])
                            if work[q] > 0 and low < -snap:
                                nearer = True
                        if not nearer:
                            continue
                        n_before = n_pieces
                        for outside in range(2):
                            n_pieces = _rival(
                                f, g, xs, df, dg, outside == 1, 4.0 * h, bufs, work, n_pieces, snap, corner_start,
                                corner_x, normal, wall, kind, tmp, part, side, v,
                            )  # fmt: skip
                        if n_pieces != n_before:
                            margin = 0.0
                e1x, e1y, e1z = xs[1, 0] - xs[0, 0], xs[1, 1] - xs[0, 1], xs[1, 2] - xs[0, 2]
                e2x, e2y, e2z = xs[2, 0] - xs[0, 0], xs[2, 1] - xs[0, 1], xs[2, 2] - xs[0, 2]
                cx, cy, cz = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
                triangle = 0.5 * math.sqrt(cx * cx + cy * cy + cz * cz)
                for q in range(n_pieces):
                    count = work[q]
                    if count == 0:
                        continue
                    low, high = _extremes(bufs[q], count, df[0], df[1], df[2])
                    check = not convex[m] and not is_open[m]
                    if high > deep:
                        for i in range(count):
                            part[i, 0], part[i, 1] = bufs[q, i, 0], bufs[q, i, 1]
                        rest = _cut(part, count, df[0] - deep, df[1] - deep, df[2] - deep, snap, tmp)
                        if rest > 0 and _ratio(part, rest) * triangle > 1e-12 * size[p] ** 2:
                            if not check or _owns(
                                f, m, part, rest, xs, df, affine[m], face_start, corner_start, corner_x, normal, lower,
                                upper, side,
                            ):
                                too_deep[p] = 1
                        count = _cut(bufs[q], count, deep - df[0], deep - df[1], deep - df[2], snap, tmp)
                        high = deep
                    if check and count > 0 and high > FALSE_DEPTH * size[p]:
                        for i in range(count):
                            part[i, 0], part[i, 1] = bufs[q, i, 0], bufs[q, i, 1]
                        low = 0.5 * high
                        rest = _cut(part, count, df[0] - low, df[1] - low, df[2] - low, snap, tmp)
                        if rest > 0 and not _owns(
                            f, m, part, rest, xs, df, affine[m], face_start, corner_start, corner_x, normal, lower,
                            upper, side,
                        ):  # behind f there is air again, or another face is nearer
                            count = _cut(bufs[q], count, -df[0], -df[1], -df[2], snap, tmp)
                            margin = 0.0
                    if count == 0 or not _ratio(bufs[q], count) * triangle > 1e-12 * size[p] * size[p]:
                        continue
                    if n_out == cap:
                        pair, face_s, face_m = _grow_int(pair), _grow_int(face_s), _grow_int(face_m)
                        grown = np.empty(2 * cap)
                        grown[:cap] = margins
                        margins = grown
                        longer = np.zeros(2 * cap + 1, np.int32)
                        longer[: cap + 1] = start
                        start = longer
                        cap *= 2
                    while n_corners + count > corner_cap:
                        wide = np.empty((2 * corner_cap, 2))
                        wide[:corner_cap] = corners
                        corners = wide
                        corner_cap *= 2
                    for i in range(count):
                        corners[n_corners + i, 0] = bufs[q, i, 0]
                        corners[n_corners + i, 1] = bufs[q, i, 1]
                    n_corners += count
                    pair[n_out], face_s[n_out], face_m[n_out], margins[n_out] = p, a, f, margin
                    n_out += 1
                    start[n_out] = n_corners
    return (
        pair[:n_out], face_s[:n_out], face_m[:n_out], start[: n_out + 1], corners[:n_corners], margins[:n_out],
        miss, miss_face, too_deep,
    )  # fmt: skip


@kernel
def _grow_int(a):
    """Twice the room."""
    out = np.empty(2 * len(a), np.int32)
    out[: len(a)] = a
    return out


@kernel
def swallowed(slave, master, block_lower, block_upper, face_start, corner_start, corner_x, is_open, out):
    """Mark pairs (n_pairs,) uint8 one block of which lies inside the other: box in box, then one corner."""
    for p in range(len(slave)):
        for turn in range(2):
            a, b = (slave[p], master[p]) if turn == 0 else (master[p], slave[p])
            if is_open[b]:
                continue
            within = True
            for d in range(3):
                if not (block_lower[a, d] > block_lower[b, d] and block_upper[a, d] < block_upper[b, d]):
                    within = False
            if not within:
                continue
            if _inside(corner_x[corner_start[face_start[a]]], b, face_start, corner_start, corner_x):
                out[p] = 1
