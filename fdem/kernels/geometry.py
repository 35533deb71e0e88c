"""Kernels of contact geometry: faces, walls, boxes, thickness, and which blocks and faces are near each other."""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

SMOOTH, SHARP, BORDER = 0, 1, 2  # kinds of edges
FEW = 32  # faces of a convex block of which none is left out


@kernel
def _walls(b, face_start, corner_start, neighbour, sharp, is_open, corner_x, normal, wall, kind):
    """Walls (unit, into the cell) and kinds of the edges of block b."""
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
        _walls(b, face_start, corner_start, neighbour, sharp, is_open, corner_x, normal, wall, kind)


@kernel
def _above(p, g, corner_start, corner_x, normal):
    """Whether the point `p` lies over the convex polygon g, seen along its normal."""
    a, z = corner_start[g], corner_start[g + 1]
    for c in range(a, z):
        k = c + 1 if c + 1 < z else a
        ex, ey, ez = corner_x[k, 0] - corner_x[c, 0], corner_x[k, 1] - corner_x[c, 1], corner_x[k, 2] - corner_x[c, 2]
        dx, dy, dz = p[0] - corner_x[c, 0], p[1] - corner_x[c, 1], p[2] - corner_x[c, 2]
        turn = (
            normal[g, 0] * (ey * dz - ez * dy) + normal[g, 1] * (ez * dx - ex * dz) + normal[g, 2] * (ex * dy - ey * dx)
        )
        if turn < -1e-9 * (ex * ex + ey * ey + ez * ez):
            return False
    return True


@kernel
def _extent(f, b, p, face_start, corner_start, corner_x, normal):
    """Extent of block b behind the point `p` of face f, along its normal [m]."""
    h = 0.0
    for c in range(corner_start[face_start[b]], corner_start[face_start[b + 1]]):
        d = (
            normal[f, 0] * (p[0] - corner_x[c, 0])
            + normal[f, 1] * (p[1] - corner_x[c, 1])
            + normal[f, 2] * (p[2] - corner_x[c, 2])
        )
        h = max(h, d)
    return h


@kernel
def _middle(corner_x, first, n, out):
    """Mean (3,) [m] of the `n` corners from `first`."""
    for d in range(3):
        total = 0.0
        for c in range(first, first + n):
            total += corner_x[c, d]
        out[d] = total / n


@kernel
def thickness(face_start, corner_start, corner_x, normal, convex, is_open, out):
    """Thickness of the block behind every face [m]: extent of a convex block, else along the ray from the centroid.

    `convex`: None if all blocks are.
    """
    o, y = np.empty(3), np.empty(3)
    for b in range(len(face_start) - 1):
        for f in range(face_start[b], face_start[b + 1]):
            if is_open[b]:
                out[f] = np.inf
                continue
            first, last = corner_start[f], corner_start[f + 1]
            _middle(corner_x, first, np.int64(1) if convex is None or convex[b] else last - first, o)
            hit = np.inf
            if convex is None:
                out[f] = _extent(f, b, o, face_start, corner_start, corner_x, normal)
                continue
            for g in range(face_start[b], face_start[b + 1]):
                slope, height, a = 0.0, 0.0, corner_start[g]
                for d in range(3):
                    slope += normal[f, d] * normal[g, d]
                    height += normal[g, d] * (o[d] - corner_x[a, d])
                if convex[b] or g == f or slope > -1e-6:
                    continue
                t = height / slope
                if t <= 0.0 or t >= hit:
                    continue
                for d in range(3):
                    y[d] = o[d] - t * normal[f, d]
                if _above(y, g, corner_start, corner_x, normal):
                    hit = t
            if hit == np.inf:  # convex, or numerically open
                hit = _extent(f, b, o, face_start, corner_start, corner_x, normal)
            out[f] = hit


@kernel
def deepest(face_start, corner_start, corner_x, normal, convex, is_open, out):
    """Depth (n_blocks,) [m] a point of every block can have: of the largest ball that touches a face at its middle.

    The ball grows until it meets the plane of another face, or one of its corners (blocks that are not convex: only
    where it touches the face itself). A lower bound for convex blocks; of 200 faces in large surfaces. `convex`: None
    if all blocks are.
    """
    o, y = np.empty(3), np.empty(3)
    for b in range(len(face_start) - 1):
        out[b] = np.inf if is_open[b] else 0.0
        first, last = face_start[b], face_start[b + 1]
        for f in range(last if is_open[b] else first, last, max(1, (last - first) // 200)):
            _middle(corner_x, corner_start[f], corner_start[f + 1] - corner_start[f], o)
            radius = np.inf
            for g in range(first, last):
                a, z = corner_start[g], corner_start[g + 1]
                slope, height = 0.0, 0.0
                for d in range(3):
                    slope += normal[f, d] * normal[g, d]
                    height += normal[g, d] * (corner_x[a, d] - o[d])
                if g == f or slope > 1.0 - 1e-9:
                    continue
                t = height / (1.0 - slope)
                for d in range(3):
                    y[d] = o[d] + t * (normal[g, d] - normal[f, d])
                if convex is None or convex[b]:
                    radius = t if t < radius else radius
                    continue
                if t > 0.0 and t < radius and _above(y, g, corner_start, corner_x, normal):
                    radius = t
                for c in range(a, z):
                    below, square = 0.0, 0.0
                    for d in range(3):
                        below += normal[f, d] * (o[d] - corner_x[c, d])
                        square += (o[d] - corner_x[c, d]) ** 2
                    if below > 1e-9 * math.sqrt(square):
                        radius = min(radius, 0.5 * square / below)
            if radius < np.inf:
                out[b] = max(out[b], radius)


@kernel
def _overlap(lower, upper, i, j, reach):
    """Whether the boxes i and j (rows of lower, upper), grown by `reach` in all, meet."""
    for d in range(3):
        if lower[i, d] > upper[j, d] + reach or upper[i, d] < lower[j, d] - reach:
            return False
    return True


@kernel
def _near_faces(b, low, high, reach, lower, upper, face_start, out):
    """Faces of block b whose box comes within `reach` of the box low, high; returns how many."""
    n = 0
    for f in range(face_start[b], face_start[b + 1]):
        apart = False
        for d in range(3):
            if lower[f, d] > high[d] + reach or upper[f, d] < low[d] - reach:
                apart = True
        if not apart:
            out[n] = f
            n += 1
    return n


@kernel
def _highest(a, f, corner_start, corner_x, normal):
    """Largest depth of a corner of face a below the plane of face f [m]."""
    high = -np.inf
    c = corner_start[f]
    for i in range(corner_start[a], corner_start[a + 1]):
        d = (
            normal[f, 0] * (corner_x[c, 0] - corner_x[i, 0])
            + normal[f, 1] * (corner_x[c, 1] - corner_x[i, 1])
            + normal[f, 2] * (corner_x[c, 2] - corner_x[i, 2])
        )
        high = max(high, d)
    return high


@kernel
def _longer(rows):
    """Twice as many rows; those there are keep their place. Blocks of few faces get all they may need at once."""
    return np.concatenate((rows, np.empty_like(rows)))


@kernel
def _around(rows, first, last, m, reach, face_start, lower, upper, lo, hi, out, n_out, many):
    """Append to `out` the faces of block m within `reach` of the slave faces ``rows[first:last, 0]`` by their boxes."""
    for d in range(3):
        lo[d], hi[d] = np.inf, -np.inf
    for row in range(first, last):
        a = rows[row, 0]
        for d in range(3):
            lo[d], hi[d] = min(lo[d], lower[a, d] - reach), max(hi[d], upper[a, d] + reach)
    for g in range(face_start[m], face_start[m + 1] if last > first else face_start[m]):
        if lower[g, 0] <= hi[0] and lower[g, 1] <= hi[1] and lower[g, 2] <= hi[2]:
            if upper[g, 0] >= lo[0] and upper[g, 1] >= lo[1] and upper[g, 2] >= lo[2]:
                if many is not None and n_out == len(out):
                    out = _longer(out)
                out[n_out] = g
                n_out += 1
    return out, n_out


@kernel
def _order(key, n, order, spare):
    """Sort ``key[:n]``, equal ones as they are: `order` (n,) tells where each was. Merges; `spare` (n,) is scratch."""
    for i in range(n):
        order[i] = i
    width = 1
    while width < n:
        for first in range(0, n, 2 * width):
            i, middle, last = first, min(first + width, n), min(first + 2 * width, n)
            j = middle
            for k in range(first, last):
                if j == last or (i < middle and key[order[i]] <= key[order[j]]):
                    spare[k] = order[i]
                    i += 1
                else:
                    spare[k] = order[j]
                    j += 1
        for k in range(n):
            order[k] = spare[k]
        width *= 2


@kernel
def _along(near, n, lower, upper, begin, key, order, spare):
    """Sort the faces ``near[:n]`` by the lower end `begin` of their boxes along the axis of their largest spread.

    Returns the axis and the length of the longest box along it [m].
    """
    axis, widest, longest = 0, -1.0, 0.0
    for d in range(3):
        lo, hi = np.inf, -np.inf
        for i in range(n):
            lo, hi = min(lo, lower[near[i], d]), max(hi, upper[near[i], d])
        if hi - lo > widest:
            axis, widest = d, hi - lo
    for i in range(n):
        key[i] = lower[near[i], axis]
        longest = max(longest, upper[near[i], axis] - key[i])
    _order(key, n, order, spare)
    for i in range(n):
        begin[i] = key[order[i]]
        spare[i] = near[order[i]]
    for i in range(n):
        near[i] = spare[i]
    return axis, longest


@kernel
def _first(begin, n, value):
    """How many of the ascending ``begin[:n]`` are less than `value`."""
    lo, hi = 0, n
    while lo < hi:
        middle = (lo + hi) // 2
        if begin[middle] < value:
            lo = middle + 1
        else:
            hi = middle
    return lo


@kernel
def face_pairs(
    slave, master, window, size, face_start, corner_start, limit, convex, corner_x, normal, lower, upper, block_lower,
    block_upper, many,
):  # fmt: skip
    """Faces of slaves and masters whose boxes are so near that a patch may exist.

    Parameters as in `clipping.clip_faces`; `many`: 1, or None if all blocks have few faces, of which all are looked at
    without sorting them (which is not compiled then).

    Returns
    -------
    start : (n_pairs + 1,) int64
    faces : (n, 2) int32
        Slave and master face; sorted by pair, master face, slave face.
    rival_start : (n_pairs + 1,) int64
    rivals : (n,) int32
        Faces of every pair's master that may be nearer than another: all of a convex one with few faces (its cells
        are bounded by all its planes), else those near the slave.
    """
    n_pairs, room, rows, others = len(slave), 0, 1024, 1024
    if many is None:
        rows, others = 0, 0
    n_out, n_rivals = np.int64(0), np.int64(0)  # not literals, for which numba would compile the helpers once more
    for p in range(n_pairs):
        n_s = face_start[slave[p] + 1] - face_start[slave[p]]
        n_m = face_start[master[p] + 1] - face_start[master[p]]
        room = max(room, n_s)
        if many is None:
            rows, others = rows + n_s * n_m, others + n_m
    start, out = np.zeros(n_pairs + 1, np.int64), np.empty((rows, 2), np.int32)
    rival_start, rivals = np.zeros(n_pairs + 1, np.int64), np.empty(others, np.int32)
    near, order, spare = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32)
    begin, key, ends = np.empty(room), np.empty(room), np.empty((2, 3))
    for p in range(n_pairs):
        s, m, h = slave[p], master[p], window[p]
        n = _near_faces(s, block_lower[m], block_upper[m], h, lower, upper, face_start, near)
        if many is not None:
            axis, longest = _along(near, n, lower, upper, begin, key, order, spare)
        widest = 0.0
        for f in range(face_start[m], face_start[m + 1]):
            widest = max(widest, limit[f])
            if n == 0:
                break
            deep = min(limit[f], size[p])  # a slave that is all inside is still in the cells of faces around it
            far = 2.0 * (h + deep)
            first, low = n_out, 0
            if many is not None:
                low = _first(begin, n, lower[f, axis] - far - longest)
            for i in range(low, n):
                a = near[i]
                if many is not None and begin[i] > upper[f, axis] + far:
                    break
                if not _overlap(lower, upper, a, f, far):
                    continue
                high = _highest(a, f, corner_start, corner_x, normal)
                if high < -h or not _overlap(lower, upper, a, f, 2.0 * (h + min(max(high, 0.0), deep))):
                    continue
                if many is not None and n_out == len(out):
                    out = _longer(out)
                out[n_out, 0], out[n_out, 1] = a, f
                n_out += 1
            if many is not None:
                for i in range(first, n_out):
                    key[i - first] = out[i, 0]
                _order(key, n_out - first, order, spare)
                for i in range(first, n_out):
                    out[i, 0] = int(key[order[i - first]])
        start[p + 1] = n_out
        reach = max(4.0 * h, min(widest, size[p])) + h
        if convex[m] and face_start[m + 1] - face_start[m] <= FEW:
            reach = np.inf
        rivals, n_rivals = _around(
            out, start[p], n_out, m, reach, face_start, lower, upper, ends[0], ends[1], rivals, n_rivals, many
        )
        rival_start[p + 1] = n_rivals
    return start, out[:n_out], rival_start, rivals[:n_rivals]


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
