"""The clip that makes contact patches: surfaces of slaves cut by the depth cells of masters (CONTACT.md 3.1-3.3).

A polygon on a slave face lives in the face's reference triangle: a corner is (w1, w2), the weights of the second and
third reference gridpoint. A linear function in space is given on the face by its three values there: all a clip needs.

The depth field of a master is ``d(x) = min over its faces g with x in R_g of n_g . (c_g - x)``. For convex masters
``R_g`` is everything, so cells are bounded by the bisectors with all other faces. For other masters ``R_g`` is bounded
by the bisector at re-entrant and smooth edges, and at a sharp convex edge by the *union* of bisector and the plane
through the edge normal to the face, so that a face does not compete beyond its border.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

SHARP, BORDER = 1, 2  # kinds of edges, as in kernels/geometry.py
SNAP = 1e-13  # of the size: a corner this close to a plane lies on it
FALSE_DEPTH = 1e-6  # of the size: pieces deeper than this must prove that they lie inside the master


@kernel
def _longer(rows):
    """Twice as many; those there are keep their place."""
    return np.concatenate((rows, np.empty_like(rows)))


@kernel
def _copy(source, n, target):
    """Copy n corners."""
    for i in range(n):
        target[i, 0], target[i, 1] = source[i, 0], source[i, 1]


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
    m = np.int64(0)  # a literal would have numba compile `_copy` once more
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
    _copy(tmp, m, poly)
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
def _mine(v):
    """Whether the cell on the positive side of a wall of normal `v` (not short) owns what lies in the wall itself.

    ``-v`` answers differently; round-off does not matter.
    """
    if abs(v[0]) > 1e-9:
        return v[0] > 0.0
    return v[1] > 0.0 if abs(v[1]) > 1e-9 else v[2] > 0.0


@kernel
def _ratio(poly, n):
    """Area of the polygon over the area of the reference triangle."""
    s = 0.0
    for i in range(1, n - 1):
        s += (poly[i, 0] - poly[0, 0]) * (poly[i + 1, 1] - poly[0, 1])
        s -= (poly[i, 1] - poly[0, 1]) * (poly[i + 1, 0] - poly[0, 0])
    return s


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
    nx, ny, nz = normal[g, 0], normal[g, 1], normal[g, 2]
    best = np.inf
    over = True
    for c in range(first, last):
        k = c + 1 if c + 1 < last else first
        ex, ey, ez = corner_x[k, 0] - corner_x[c, 0], corner_x[k, 1] - corner_x[c, 1], corner_x[k, 2] - corner_x[c, 2]
        dx, dy, dz = o[0] - corner_x[c, 0], o[1] - corner_x[c, 1], o[2] - corner_x[c, 2]
        if nx * (ey * dz - ez * dy) + ny * (ez * dx - ex * dz) + nz * (ex * dy - ey * dx) < 0.0:
            over = False
            t = (ex * dx + ey * dy + ez * dz) / (ex * ex + ey * ey + ez * ez)
            t = min(max(t, 0.0), 1.0)
            rx, ry, rz = dx - t * ex, dy - t * ey, dz - t * ez
            best = min(best, rx * rx + ry * ry + rz * rz)
    if over:
        dx, dy, dz = o[0] - corner_x[first, 0], o[1] - corner_x[first, 1], o[2] - corner_x[first, 2]
        d = nx * dx + ny * dy + nz * dz
        best = d * d
    return best


@kernel
def _plane_values(n, c, xs, out):
    """Values n . (x_k - c) at the three reference gridpoints xs (3, 3) of the slave face."""
    for k in range(3):
        out[k] = n[0] * (xs[k, 0] - c[0]) + n[1] * (xs[k, 1] - c[1]) + n[2] * (xs[k, 2] - c[2])


@kernel
def _upright(f, c, xs, corner_start, corner_x, normal, out):
    """Values on the slave face of the plane through edge c of face f, normal to f."""
    k = c + 1 if c + 1 < corner_start[f + 1] else corner_start[f]
    ex, ey, ez = corner_x[k, 0] - corner_x[c, 0], corner_x[k, 1] - corner_x[c, 1], corner_x[k, 2] - corner_x[c, 2]
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    s0 = (normal[f, 1] * ez - normal[f, 2] * ey) / length
    s1 = (normal[f, 2] * ex - normal[f, 0] * ez) / length
    s2 = (normal[f, 0] * ey - normal[f, 1] * ex) / length
    for k in range(3):
        out[k] = s0 * (xs[k, 0] - corner_x[c, 0]) + s1 * (xs[k, 1] - corner_x[c, 1]) + s2 * (xs[k, 2] - corner_x[c, 2])


@kernel
def _own_cell(f, xs, poly, count, snap, convex, bent, corner_start, corner_x, normal, wall, kind, bufs, work, tmp):
    """Split `poly[:count]` into the pieces inside R_f; returns their number, margin and miss; counts go to `work`.

    Margin: distance to the nearest wall that did not cut; miss: how far outside an emptied polygon lies.
    """
    v = np.empty(3)
    margin, miss = np.inf, np.inf
    first, last = corner_start[f], corner_start[f + 1]
    for c in range(first, last):
        if kind[c] == BORDER or (kind[c] == SHARP and bent):
            continue
        _plane_values(wall[c], corner_x[c], xs, v)
        low, high = _extremes(poly, count, v[0], v[1], v[2])
        if high <= snap and (low < -snap or not _mine(wall[c])):
            return 0, margin, max(-high, 0.0)
        margin = min(margin, max(low, 0.0))
        count = _cut(poly, count, v[0], v[1], v[2], snap, tmp)
        if count == 0:
            return 0, 0.0, 0.0
    _copy(poly, count, bufs[0])
    work[0] = count
    n_pieces = 1
    if convex is None or not bent:
        return n_pieces, margin, miss
    vertical = np.empty(3)
    for c in range(first, last):
        if kind[c] != SHARP:
            continue
        _plane_values(wall[c], corner_x[c], xs, v)
        _upright(f, c, xs, corner_start, corner_x, normal, vertical)
        for q in range(n_pieces):
            m = work[q]
            if m == 0:
                continue
            low, high = _extremes(bufs[q], m, v[0], v[1], v[2])
            margin = min(margin, max(low, 0.0))
            if low >= -snap:
                work[q] = m if high > snap or _mine(wall[c]) else 0
                continue
            if n_pieces < len(bufs):  # the part beyond the bisector but above the face
                _copy(bufs[q], m, bufs[n_pieces])
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
    o, v,
):  # fmt: skip
    """Take away from the pieces what lies in the cell of the competing face g; returns the number of pieces.

    Inside the master (depth of g >= 0) g reaches up to the planes normal to it through its sharp edges, outside
    (`outside`) up to the bisectors, and only where its polygon is not farther away than that of f.
    """
    first, last = corner_start[g], corner_start[g + 1]
    sign = -1.0 if outside else 1.0
    n_old = n_pieces
    for q in range(n_old):
        m = work[q]
        if m == 0:
            continue
        _copy(bufs[q], m, part)
        # first find out whether there is anything to take away, then do it: bisector, side of g, its edges, its reach
        n = _cut(part, m, df[0] - dg[0], df[1] - dg[1], df[2] - dg[2], snap, tmp)
        if n > 0:
            n = _cut(part, n, sign * dg[0], sign * dg[1], sign * dg[2], snap, tmp)
        if n > 0 and outside:
            n = _cut(part, n, dg[0] + reach, dg[1] + reach, dg[2] + reach, snap, tmp)
        for c in range(first, last):
            if n == 0:
                break
            if kind[c] == BORDER:
                continue
            if kind[c] == SHARP and not outside:
                _upright(g, c, xs, corner_start, corner_x, normal, v)
            else:
                _plane_values(wall[c], corner_x[c], xs, v)
            n = _cut(part, n, v[0], v[1], v[2], snap, tmp)
        if n == 0 or _ratio(part, n) <= 1e-13 * _ratio(bufs[q], m):
            continue
        if outside:
            _middle(part, n, xs, o)
            mine = _distance2(o, f, corner_start, corner_x, normal)
            if _distance2(o, g, corner_start, corner_x, normal) > mine * (1.0 + 1e-9):
                continue
        _copy(bufs[q], m, part)
        n = m
        work[q] = 0
        made = False
        for e in range(-3, last - first):  # what lies beyond each plane is a piece to keep
            c = first + max(e, 0)
            if e < 0:
                for k in range(3):
                    v[k] = dg[k] + reach if e == -3 else df[k] - dg[k] if e == -2 else sign * dg[k]
            elif kind[c] == SHARP and not outside:
                _upright(g, c, xs, corner_start, corner_x, normal, v)
            else:
                _plane_values(wall[c], corner_x[c], xs, v)
            if (e == -3 and not outside) or (e >= 0 and kind[c] == BORDER):
                continue
            low, _ = _extremes(part, n, v[0], v[1], v[2])
            if low >= -snap:
                continue
            target = q if not made else n_pieces
            if target < len(bufs):
                _copy(part, n, bufs[target])
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
def _bounds(bufs, work, n_pieces, xs, df, box):
    """Box (2, 3) of all pieces [m]; returns the largest depth."""
    deepest = -np.inf
    for d in range(3):
        box[0, d], box[1, d] = np.inf, -np.inf
    for q in range(n_pieces):
        for i in range(work[q]):
            w1, w2 = bufs[q, i, 0], bufs[q, i, 1]
            w0 = 1.0 - w1 - w2
            deepest = max(deepest, w0 * df[0] + w1 * df[1] + w2 * df[2])
            for d in range(3):
                y = w0 * xs[0, d] + w1 * xs[1, d] + w2 * xs[2, d]
                box[0, d], box[1, d] = min(box[0, d], y), max(box[1, d], y)
    return deepest


@kernel
def _rivals(
    f, around, xs, df, h, snap, n_pieces, convex, bent, affine, all_faces, corner_start, corner_x, normal, wall, kind,
    lower, upper, bufs, work, tmp, part, dg, v, o, box,
):  # fmt: skip
    """Take away what the faces `around` of the master are nearer to; number of pieces, margin, miss as `_own_cell`."""
    margin, miss = np.inf, np.inf
    if lower is not None:
        near = max(4.0 * h, _bounds(bufs, work, n_pieces, xs, df, box))
        lo0, lo1, lo2 = box[0, 0] - near, box[0, 1] - near, box[0, 2] - near
        hi0, hi1, hi2 = box[1, 0] + near, box[1, 1] + near, box[1, 2] + near
    for g in around:
        if g == f or (lower is not None and not all_faces and (
            lower[g, 0] > hi0 or lower[g, 1] > hi1 or lower[g, 2] > hi2
            or upper[g, 0] < lo0 or upper[g, 1] < lo1 or upper[g, 2] < lo2
        )):  # fmt: skip
            continue
        cosine = normal[f, 0] * normal[g, 0] + normal[f, 1] * normal[g, 1] + normal[f, 2] * normal[g, 2]
        if cosine > (1.0 - 1e-14 if affine else 0.9):
            continue
        _plane_values(normal[g], corner_x[corner_start[g]], xs, dg)
        dg[0], dg[1], dg[2] = -dg[0], -dg[1], -dg[2]
        if convex is None or not bent:
            length = math.sqrt(2.0 - 2.0 * cosine)
            v[0], v[1], v[2] = (dg[0] - df[0]) / length, (dg[1] - df[1]) / length, (dg[2] - df[2]) / length
            low, high = _extremes(bufs[0], work[0], v[0], v[1], v[2])
            for k in range(3):
                o[k] = (normal[f, k] - normal[g, k]) / length
            if high <= snap and (low < -snap or not _mine(o)):
                return 0, margin, max(-high, 0.0)
            margin = min(margin, max(low, 0.0))
            work[0] = _cut(bufs[0], work[0], v[0], v[1], v[2], snap, tmp)
            if work[0] == 0:
                return 0, margin, miss
            continue
        nearer = False
        for q in range(n_pieces):
            low, _ = _extremes(bufs[q], work[q], dg[0] - df[0], dg[1] - df[1], dg[2] - df[2])
            nearer = nearer or (work[q] > 0 and low < -snap)
        if not nearer:
            continue
        n_before = n_pieces
        for outside in (False, True):
            n_pieces = _rival(
                f, g, xs, df, dg, outside, 4.0 * h, bufs, work, n_pieces, snap, corner_start, corner_x, normal, wall,
                kind, tmp, part, o, v,
            )  # fmt: skip
        margin = 0.0 if n_pieces != n_before else margin
    return n_pieces, margin, miss


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
            gap = max(lower[g, d] - o[d], o[d] - upper[g, d], 0.0)
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
def _within_limit(
    f, m, xs, df, deep, poly, count, least, smallest, snap, convex, prove, affine, face_start, corner_start, corner_x,
    normal, lower, upper, part, tmp, o,
):  # fmt: skip
    """Cut away what is deeper than `deep` or does not belong to f; corners left, and whether there was too much depth.

    The second value: 1 too deep, -1 cut because behind f there is air again or another face is nearer.
    """
    _, high = _extremes(poly, count, df[0], df[1], df[2])
    answer = 0
    if high > deep:
        _copy(poly, count, part)
        rest = _cut(part, count, df[0] - deep, df[1] - deep, df[2] - deep, snap, tmp)
        if rest > 0 and _ratio(part, rest) > smallest:
            if convex is None or not prove or _owns(
                f, m, part, rest, xs, df, affine, face_start, corner_start, corner_x, normal, lower, upper, o
            ):  # fmt: skip
                answer = 1
        count = _cut(poly, count, deep - df[0], deep - df[1], deep - df[2], snap, tmp)
        high = deep
    if convex is not None and prove and count > 0 and high > least:
        _copy(poly, count, part)
        low = 0.5 * high
        rest = _cut(part, count, df[0] - low, df[1] - low, df[2] - low, snap, tmp)
        if rest > 0 and not _owns(
            f, m, part, rest, xs, df, affine, face_start, corner_start, corner_x, normal, lower, upper, o
        ):
            count = _cut(poly, count, -df[0], -df[1], -df[2], snap, tmp)
            answer = answer if answer == 1 else -1
    return count, answer


@kernel
def _start(a, f, h, snap, x, ref, corner_start, corner_w, corner_x, normal, xs, df, poly, tmp):
    """Polygon of slave face a down to the gap h above face f, places of its gridpoints, depths there.

    Returns the number of corners and the area of the reference triangle [m^2].
    """
    for k in range(3):
        for d in range(3):
            xs[k, d] = x[ref[a, k], d]
    _plane_values(normal[f], corner_x[corner_start[f]], xs, df)
    df[0], df[1], df[2] = -df[0], -df[1], -df[2]
    count = corner_start[a + 1] - corner_start[a]
    for i in range(count):
        poly[i, 0], poly[i, 1] = corner_w[corner_start[a] + i, 0], corner_w[corner_start[a] + i, 1]
    low, high = _extremes(poly, count, df[0], df[1], df[2])
    if high < -h:
        return 0, 0.0
    if low < -h:
        count = _cut(poly, count, df[0] + h, df[1] + h, df[2] + h, snap, tmp)
    e1x, e1y, e1z = xs[1, 0] - xs[0, 0], xs[1, 1] - xs[0, 1], xs[1, 2] - xs[0, 2]
    e2x, e2y, e2z = xs[2, 0] - xs[0, 0], xs[2, 1] - xs[0, 1], xs[2, 2] - xs[0, 2]
    cx, cy, cz = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
    return count, 0.5 * math.sqrt(cx * cx + cy * cy + cz * cz)


@kernel
def clip_faces(
    pair_start, faces, rival_start, rivals, master, window, size, most, max_corners, face_start, corner_start, corner_w,
    ref, limit, convex, affine, is_open, x, corner_x, normal, wall, kind, lower, upper,
):  # fmt: skip
    """Cut faces of slaves by the depth cells of faces of masters: the patches of the pairs.

    | argument | shape | unit | |
    |---|---|---|---|
    | pair_start, faces, rival_start, rivals | | - | from `geometry.face_pairs` |
    | master | (n_pairs,) | - | block ids |
    | window | (n_pairs,) | m | patches are made up to this gap |
    | size, most | (n_pairs,) | m | size of the smaller block, largest depth that either block admits |
    | convex, lower, upper | | | None if all blocks are convex, and have few faces: what others need is not compiled |
    | others | | | arrays of `Surfaces` and `FaceGeometry` |

    Returns
    -------
    key : (n_patches, 4) int32
        Pair, slave face, master face, end of the corners.
    corners : (n, 2)
    margin : (n_patches,)
        Distance to the nearest wall that could cut the polygon next [m]; 0 if one did.
    miss : (n_pairs,)
        Smallest distance by which a face near the master's surface missed a cell [m].
    miss_face : (n_pairs, 2) int32
        The faces concerned (slave, master), -1 if none.
    too_deep : (n_pairs,) uint8
        1 where a part of the slave lies deeper than the limit.
    """
    n_pairs, room = len(master), 4 * max_corners + 64
    poly, tmp, part = np.empty((room, 2)), np.empty((room, 2)), np.empty((room, 2))
    bufs, work = np.empty((64, room, 2)), np.zeros(64, np.int64)
    xs, box, df, dg, v, o = np.empty((3, 3)), np.empty((2, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    most_out, most_corners = (len(faces), room * len(faces)) if convex is None else (64, 512)  # convex: one piece each
    key, margins, corners = np.empty((most_out, 4), np.int32), np.empty(most_out), np.empty((most_corners, 2))
    miss, miss_face = np.full(n_pairs, np.inf), np.full((n_pairs, 2), -1, np.int32)
    too_deep = np.zeros(n_pairs, np.uint8)
    n_out, n_corners = 0, np.int64(0)
    for p in range(n_pairs):
        m, h, snap = master[p], window[p], SNAP * size[p]
        bent = convex is not None and not convex[m]
        prove = bent and not is_open[m]
        around = rivals[rival_start[p] : rival_start[p + 1]]
        all_faces = len(around) == face_start[m + 1] - face_start[m]
        for row in range(pair_start[p], pair_start[p + 1]):
            a, f = faces[row, 0], faces[row, 1]
            count, area = _start(a, f, h, snap, x, ref, corner_start, corner_w, corner_x, normal, xs, df, poly, tmp)
            if count == 0:
                continue
            n_pieces, margin, lost = _own_cell(
                f, xs, poly, count, snap, convex, bent, corner_start, corner_x, normal, wall, kind, bufs, work, tmp
            )
            if n_pieces > 0:
                n_pieces, nearest, lost = _rivals(
                    f, around, xs, df, h, snap, n_pieces, convex, bent, affine[m], all_faces, corner_start, corner_x,
                    normal, wall, kind, lower, upper, bufs, work, tmp, part, dg, v, o, box,
                )  # fmt: skip
                margin = min(margin, nearest)
            if n_pieces == 0 and lost < miss[p]:
                miss[p] = lost
                miss_face[p, 0], miss_face[p, 1] = a, f
            smallest, least = 1e-12 * size[p] * size[p] / area, FALSE_DEPTH * size[p]
            for q in range(n_pieces):
                count, answer = 0, 0
                if work[q] > 0:
                    count, answer = _within_limit(
                        f, m, xs, df, min(limit[f], most[p]), bufs[q], work[q], least, smallest, snap, convex,
                        prove, affine[m], face_start, corner_start, corner_x, normal, lower, upper, part, tmp, o,
                    )  # fmt: skip
                if answer == 1:
                    too_deep[p] = 1
                if count == 0 or not _ratio(bufs[q], count) > smallest:
                    continue
                if convex is not None and n_out == len(key):
                    key, margins = _longer(key), _longer(margins)
                while convex is not None and n_corners + count > len(corners):
                    corners = _longer(corners)
                _copy(bufs[q], count, corners[n_corners:])
                n_corners += count
                key[n_out, 0], key[n_out, 1], key[n_out, 2], key[n_out, 3] = p, a, f, n_corners
                margins[n_out] = margin if answer == 0 else 0.0
                n_out += 1
    return key[:n_out], corners[:n_corners], margins[:n_out], miss, miss_face, too_deep
