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
FEW = 32  # most faces of a block that is looked at without a tree, as in kernels/geometry.py
SNAP = 1e-13  # of the size: a corner this close to a plane lies on it
FALSE_DEPTH = 1e-6  # of the size: pieces deeper than this must prove that they lie inside the master


@kernel
def _sort(ids, n):
    """Sort ``ids[:n]`` in place (Shell)."""
    gap = n // 2
    while gap > 0:
        for i in range(gap, n):
            j = i
            while j >= gap and ids[j - gap] > ids[j]:
                ids[j - gap], ids[j] = ids[j], ids[j - gap]
                j -= gap
        gap //= 2


@kernel
def _copy(source, n, target):
    """Copy n corners."""
    for i in range(n):
        target[i, 0], target[i, 1] = source[i, 0], source[i, 1]


@kernel
def _extremes(poly, n, l0, l1, l2):
    """Smallest and largest value of a linear function on the corners of a polygon."""
    low, high = np.inf, -np.inf
    for i in range(n):
        w1, w2 = poly[i, 0], poly[i, 1]
        v = l0 * (1.0 - w1 - w2) + l1 * w1 + l2 * w2
        low, high = min(low, v), max(high, v)
    return low, high


@kernel
def _cut(poly, n, l0, l1, l2, snap, tmp):
    """Clip `poly[:n]` in place to ``l >= 0`` of the linear function with corner values l0, l1, l2; new corner count.

    Values below `snap` count as zero, so that a plane through a corner leaves the polygon alone.
    """
    low, high = _extremes(poly, n, l0, l1, l2)
    if low >= -snap or high <= snap:
        return 0 if low < -snap else n
    m = np.int64(0)  # a literal would have numba compile `_copy` once more
    a1, a2 = poly[n - 1, 0], poly[n - 1, 1]
    va = l0 * (1.0 - a1 - a2) + l1 * a1 + l2 * a2
    for i in range(n):
        b1, b2 = poly[i, 0], poly[i, 1]
        vb = l0 * (1.0 - b1 - b2) + l1 * b1 + l2 * b2
        if (va >= 0.0) != (vb >= 0.0):
            t = va / (va - vb)
            tmp[m, 0], tmp[m, 1] = a1 + t * (b1 - a1), a2 + t * (b2 - a2)
            m += 1
        if vb >= 0.0:
            tmp[m, 0], tmp[m, 1] = b1, b2
            m += 1
        a1, a2, va = b1, b2, vb
    _copy(tmp, m, poly)
    return m if m >= 3 else 0


@kernel
def _mine(v):
    """Whether the cell on the positive side of a wall of normal `v` (not short) owns what lies in the wall itself.

    ``-v`` answers differently; round-off does not matter.
    """
    return (v[0] if abs(v[0]) > 1e-9 else v[1] if abs(v[1]) > 1e-9 else v[2]) > 0.0


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
    best, over = np.inf, True
    for c in range(first, last):
        k = c + 1 if c + 1 < last else first
        ex, ey, ez = corner_x[k, 0] - corner_x[c, 0], corner_x[k, 1] - corner_x[c, 1], corner_x[k, 2] - corner_x[c, 2]
        dx, dy, dz = o[0] - corner_x[c, 0], o[1] - corner_x[c, 1], o[2] - corner_x[c, 2]
        if nx * (ey * dz - ez * dy) + ny * (ez * dx - ex * dz) + nz * (ex * dy - ey * dx) < 0.0:
            over = False
            t = min(max((ex * dx + ey * dy + ez * dz) / (ex * ex + ey * ey + ez * ez), 0.0), 1.0)
            rx, ry, rz = dx - t * ex, dy - t * ey, dz - t * ez
            best = min(best, rx * rx + ry * ry + rz * rz)
    dx, dy, dz = o[0] - corner_x[first, 0], o[1] - corner_x[first, 1], o[2] - corner_x[first, 2]
    height = nx * dx + ny * dy + nz * dz
    return height * height if over else best


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
    _plane_values((s0, s1, s2), corner_x[c], xs, out)


@kernel
def _own_cell(f, xs, poly, count, snap, convex, bent, cells, bufs, work, tmp):
    """Split `poly[:count]` into the pieces inside R_f; returns their number, margin and miss; counts go to `work`.

    Margin: distance to the nearest wall that did not cut; miss: how far outside an emptied polygon lies.
    """
    corner_start, corner_x, normal, wall, kind = cells
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
    work[0], n_pieces = count, 1
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
                extra = _cut(bufs[n_pieces], extra, vertical[0], vertical[1], vertical[2], snap, tmp)
                if extra > 0 and _ratio(bufs[n_pieces], extra) > 1e-14:
                    work[n_pieces] = extra
                    n_pieces += 1
            if high <= snap:
                miss = min(miss, max(-high, 0.0))
            work[q] = _cut(bufs[q], m, v[0], v[1], v[2], snap, tmp)
    return n_pieces, margin, miss


@kernel
def _rival(f, g, xs, df, dg, outside, reach, bufs, work, n_pieces, snap, cells, tmp, part, o, v):
    """Take away from the pieces what lies in the cell of the competing face g; returns the number of pieces.

    Inside the master (depth of g >= 0) g reaches up to the planes normal to it through its sharp edges, outside
    (`outside`) up to the bisectors, and only where its polygon is not farther away than that of f.
    """
    corner_start, corner_x, normal, wall, kind = cells
    first, last, sign = corner_start[g], corner_start[g + 1], -1.0 if outside else 1.0
    for q in range(n_pieces):
        m = work[q]
        if m == 0:
            continue
        _copy(bufs[q], m, part)
        # first find out whether there is anything to take away, then do it: bisector, side of g, its edges, its reach
        n = _cut(part, m, df[0] - dg[0], df[1] - dg[1], df[2] - dg[2], snap, tmp)
        n = _cut(part, n, sign * dg[0], sign * dg[1], sign * dg[2], snap, tmp)
        if outside:
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
        n, work[q], made = m, 0, False
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
def _apart(box, reach, lean, low, high):
    """Whether the box low, high is farther from `box` than `reach` times `lean` in one of the three directions."""
    for d in range(3):
        far = reach * lean[d]
        if low[d] > box[1, d] + far or high[d] < box[0, d] - far:
            return True
    return False


@kernel
def _near(b, box, reach, n, alike, search):
    """Faces of block b, in order, from whose boxes their cells up to the height `reach` may come to `box`.

    Faces whose normals make a cosine with `n` above `alike` may be left out.
    """
    lower, upper, lean, (node_start, nodes, order, bounds), out = search
    i, n_out = node_start[b], np.int64(0)
    if reach == np.inf:
        return order[nodes[i, 1] : nodes[i, 2]]
    while i < node_start[b + 1]:
        cosine = 0.0
        for d in range(3):
            cosine += min(n[d] * bounds[i, d + 6], n[d] * bounds[i, d + 9])
        if cosine > alike or _apart(box, reach, bounds[i, 12:], bounds[i], bounds[i, 3:]):
            i = nodes[i, 0]
            continue
        for k in range(nodes[i, 1], nodes[i, 2] if nodes[i, 0] == i + 1 else nodes[i, 1]):
            g = order[k]
            if not _apart(box, reach, lean[g], lower[g], upper[g]):
                out[n_out] = g
                n_out += 1
        i += 1
    _sort(out, n_out)
    return out[:n_out]


@kernel
def _rivals(
    f, m, around, xs, df, h, snap, n_pieces, convex, bent, affine, face_start, cells, search, bufs, work, tmp, part,
    dg, v, o, box,
):  # fmt: skip
    """Take away what faces of m in the box `around` (all without `search`) are nearer to; returns as `_own_cell`."""
    corner_start, corner_x, normal, _, _ = cells
    margin, miss, reach, alike = np.inf, np.inf, np.inf, 1.0 - 1e-14 if affine else 0.9
    first, n_near = face_start[m], face_start[m + 1] - face_start[m]
    if search is not None:
        if around[0, 0] > -np.inf:
            reach = max(4.0 * h, _bounds(bufs, work, n_pieces, xs, df, box))
        near = _near(m, box, reach, normal[f], alike, search)
        n_near = len(near)
    for i in range(n_near):
        g = first + i if search is None else near[i]
        if g == f or (
            search is not None and reach < np.inf and _apart(around, 0.0, normal[g], search[0][g], search[1][g])
        ):
            continue
        cosine = normal[f, 0] * normal[g, 0] + normal[f, 1] * normal[g, 1] + normal[f, 2] * normal[g, 2]
        if cosine > alike:
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
            n_pieces = _rival(f, g, xs, df, dg, outside, 4.0 * h, bufs, work, n_pieces, snap, cells, tmp, part, o, v)
        if n_pieces != n_before:
            margin = 0.0
    return n_pieces, margin, miss


@kernel
def _inside(o, b, box, corner_start, corner_x, normal, search):
    """Whether the point `o` lies inside the closed surface of block b: a ray leaves it more often than it enters."""
    for d in range(3):
        box[0, d], box[1, d] = o[d], o[d] if d > 0 else np.inf
    leaves = 0
    for g in _near(b, box, 0.0, o, np.inf, search):
        first, last = corner_start[g], corner_start[g + 1]
        met, ahead = False, 0.0
        for c in range(first, last):
            k = c + 1 if c + 1 < last else first
            y, z, turn = corner_x[c, 1] - o[1], corner_x[c, 2] - o[2], corner_x[k, 1] - o[1]
            if (y > 0.0) != (turn > 0.0) and z + (corner_x[k, 2] - corner_x[c, 2]) * y / (y - turn) > 0.0:
                met = not met
        for d in range(3):
            ahead += normal[g, d] * (corner_x[first, d] - o[d])
        if met and ahead * normal[g, 0] > 0.0:
            leaves += 1 if normal[g, 0] > 0.0 else -1
    return leaves > 0


@kernel
def _owns(f, b, part, n, xs, df, affine, cells, search, o, box):
    """Whether the middle of the polygon `part[:n]` lies inside block b, and no face of b is nearer than the plane of f.

    The depth of a cell is at most the distance to the whole surface; faces that count as one smooth surface are
    compared with a tolerance.
    """
    corner_start, corner_x, normal, _, _ = cells
    w1, w2 = _middle(part, n, xs, o)
    depth = (1.0 - w1 - w2) * df[0] + w1 * df[1] + w2 * df[2]
    radius = depth * (0.98 if affine else 0.8)
    alone = True
    for d in range(3):
        box[0, d], box[1, d] = o[d] - depth, o[d] + depth
    for g in _near(b, box, 0.0, o, np.inf, search):
        d2 = _distance2(o, g, corner_start, corner_x, normal) if g != f else np.inf
        if d2 < radius * radius:
            return False
        alone = alone and d2 > depth * depth
    if alone and _distance2(o, f, corner_start, corner_x, normal) <= depth * depth * (1.0 + 1e-9):
        return True  # straight below f and nothing in between
    o[1], o[2] = o[1] + 0.0437 * depth, o[2] + 0.0711 * depth  # no face is so near; edges of meshes lie elsewhere
    return _inside(o, b, box, corner_start, corner_x, normal, search)


@kernel
def _within_limit(
    f, m, xs, df, deep, poly, count, least, smallest, snap, convex, prove, affine, cells, search, part, tmp, o, box
):
    """Cut away what is deeper than `deep` or does not belong to f; corners left, and whether there was too much depth.

    The second value: 1 too deep, -1 cut because behind f there is air again or another face is nearer.
    """
    _, high = _extremes(poly, count, df[0], df[1], df[2])
    answer = 0
    if high > deep:
        _copy(poly, count, part)
        rest = _cut(part, count, df[0] - deep, df[1] - deep, df[2] - deep, snap, tmp)
        if rest > 0 and _ratio(part, rest) > smallest:
            if convex is None or not prove or _owns(f, m, part, rest, xs, df, affine, cells, search, o, box):
                answer = 1
        count = _cut(poly, count, deep - df[0], deep - df[1], deep - df[2], snap, tmp)
        high = deep
    if convex is not None and prove and count > 0 and high > least:
        _copy(poly, count, part)
        low = 0.5 * high
        rest = _cut(part, count, df[0] - low, df[1] - low, df[2] - low, snap, tmp)
        if rest > 0 and not _owns(f, m, part, rest, xs, df, affine, cells, search, o, box):
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
    _copy(corner_w[corner_start[a] :], count, poly)
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
    pair_start, faces, around, master, window, size, most, max_corners, face_start, corner_start, corner_w,
    ref, limit, convex, affine, is_open, x, corner_x, normal, wall, kind, search,
):  # fmt: skip
    """Cut faces of slaves by the depth cells of faces of masters: the patches of the pairs.

    | argument | shape | unit | |
    |---|---|---|---|
    | pair_start, faces, around | | | from `geometry.face_pairs` |
    | master, window | (n_pairs,) | -, m | block ids; patches are made up to this gap |
    | size, most | (n_pairs,) | m | size of the smaller block, largest depth that either block admits |
    | convex | | | None if all blocks are convex: what others need is not compiled |
    | search | | | `FaceGeometry.search`, None if all blocks have few faces too: no search is compiled |
    | others | | | arrays of `Surfaces` and `FaceGeometry` |

    Returns
    -------
    key : (n_patches, 4) int32
        Pair, slave face, master face, end of the corners.
    corners : (n, 2)
    margin : (n_patches,)
        Distance to the nearest wall that could cut the polygon next [m]; 0 if one did.
    miss, miss_face : (n_pairs,), (n_pairs, 2) int32
        Smallest distance by which a face near the master's surface missed a cell [m]; slave and master face, -1: none.
    too_deep : (n_pairs,) uint8
        1 where a part of the slave lies deeper than the limit.
    """
    n_pairs, room = len(master), 4 * max_corners + 64
    poly, tmp, part, bufs = np.empty((room, 2)), np.empty((room, 2)), np.empty((room, 2)), np.empty((64, room, 2))
    work, miss, too_deep = np.empty(64, np.int64), np.empty(n_pairs), np.empty(n_pairs, np.uint8)
    xs, box, df, dg, v, o = np.empty((3, 3)), np.empty((2, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    miss_face, most_out, most_corners = np.empty((n_pairs, 2), np.int32), 64, 512
    if search is None:  # one piece each, to which every plane adds one corner at most
        most_out, most_corners = len(faces), (2 * max_corners + FEW + 2) * len(faces)
    key, margins, corners = np.empty((most_out, 4), np.int32), np.empty(most_out), np.empty((most_corners, 2))
    cells, n_out, n_corners = (corner_start, corner_x, normal, wall, kind), 0, np.int64(0)
    for p in range(n_pairs):
        m, h, snap = master[p], window[p], SNAP * size[p]
        miss[p], miss_face[p, 0], miss_face[p, 1], too_deep[p] = np.inf, -1, -1, 0
        bent = convex is not None and not convex[m]
        prove = bent and not is_open[m]
        for row in range(pair_start[p], pair_start[p + 1]):
            a, f = faces[row, 0], faces[row, 1]
            count, area = _start(a, f, h, snap, x, ref, corner_start, corner_w, corner_x, normal, xs, df, poly, tmp)
            if count == 0:
                continue
            n_pieces, margin, lost = _own_cell(f, xs, poly, count, snap, convex, bent, cells, bufs, work, tmp)
            if n_pieces > 0:
                n_pieces, nearest, lost = _rivals(
                    f, m, around[p], xs, df, h, snap, n_pieces, convex, bent, affine[m],
                    face_start, cells, search, bufs, work, tmp, part, dg, v, o, box,
                )  # fmt: skip
                margin = min(margin, nearest)
            if n_pieces == 0 and lost < miss[p]:
                miss[p], miss_face[p, 0], miss_face[p, 1] = lost, a, f
            smallest, least = 1e-12 * size[p] * size[p] / area, FALSE_DEPTH * size[p]
            for q in range(n_pieces):
                count, answer = _within_limit(
                    f, m, xs, df, min(limit[f], most[p]), bufs[q], work[q], least, smallest, snap, convex, prove,
                    affine[m], cells, search, part, tmp, o, box,
                )  # fmt: skip
                too_deep[p] = max(too_deep[p], answer)
                if count == 0 or not _ratio(bufs[q], count) > smallest:
                    continue
                if search is not None and n_out == len(key):
                    key = np.concatenate((key, np.empty_like(key)))
                    margins = np.concatenate((margins, np.empty_like(margins)))
                while search is not None and n_corners + count > len(corners):
                    corners = np.concatenate((corners, np.empty_like(corners)))
                _copy(bufs[q], count, corners[n_corners:])
                n_corners += count
                key[n_out, 0], key[n_out, 1], key[n_out, 2], key[n_out, 3] = p, a, f, n_corners
                margins[n_out] = margin if answer == 0 else 0.0
                n_out += 1
    return key[:n_out], corners[:n_corners], margins[:n_out], miss, miss_face, too_deep
