"""Kernels of contact geometry: faces, walls, boxes, thickness, and which blocks and faces are near each other."""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

SMOOTH, SHARP, BORDER = 0, 1, 2  # kinds of edges
SLACK = 1e-6  # of the height: what lies in a wall between two cells meets the boxes of both, whatever round-off says
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
def _lean(f, corner_start, wall, kind, normal, out):
    """How far the cell of face f grows beyond its box, per height over or under the face, in the three directions.

    At every height a triangle all of whose edges are smooth bounds its cell by a similar triangle.
    """
    first, last = corner_start[f], corner_start[f + 1]
    aside = 0.0
    for c in range(first, last):
        b = c - 1 if c > first else last - 1
        rx = wall[b, 1] * wall[c, 2] - wall[b, 2] * wall[c, 1]
        ry = wall[b, 2] * wall[c, 0] - wall[b, 0] * wall[c, 2]
        rz = wall[b, 0] * wall[c, 1] - wall[b, 1] * wall[c, 0]
        s = rx * normal[f, 0] + ry * normal[f, 1] + rz * normal[f, 2]
        if kind[c] != SMOOTH or last - first > 3 or abs(s) < 1e-9:
            aside = np.inf
            break
        rx, ry, rz = rx / s - normal[f, 0], ry / s - normal[f, 1], rz / s - normal[f, 2]
        aside = max(aside, math.sqrt(rx * rx + ry * ry + rz * rz))
    for d in range(3):
        out[d] = min(1.0, abs(normal[f, d]) + aside + SLACK)


@kernel
def leans(blocks, face_start, corner_start, wall, kind, normal, lean):
    """Lean (n_faces, 3) of the faces of `blocks`."""
    for b in blocks:
        for f in range(face_start[b], face_start[b + 1]):
            _lean(f, corner_start, wall, kind, normal, lean[f])


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
def _extent(f, b, p, tree, corner_start, corner_x, normal):
    """Extent of block b behind the point `p` of face f, along its normal [m]."""
    node_start, nodes, order, bounds = tree
    h, i = 0.0, node_start[b]
    while i < node_start[b + 1]:
        far, size = 0.0, 0.0  # of the corner of the box that lies deepest, a little farther off
        for d in range(3):
            v = p[d] - bounds[i, d if normal[f, d] > 0.0 else d + 3]
            far, size = far + normal[f, d] * v, size + abs(v)
        if far + 1e-12 * size <= h:
            i = nodes[i, 0]
            continue
        for k in range(nodes[i, 1], nodes[i, 2] if nodes[i, 0] == i + 1 else nodes[i, 1]):
            for c in range(corner_start[order[k]], corner_start[order[k] + 1]):
                d = (
                    normal[f, 0] * (p[0] - corner_x[c, 0])
                    + normal[f, 1] * (p[1] - corner_x[c, 1])
                    + normal[f, 2] * (p[2] - corner_x[c, 2])
                )
                h = max(h, d)
        i += 1
    return h


@kernel
def _pierced(i, o, n, slack, hit, bounds):
    """Whether the ray from `o` along -n meets the box of node i, grown by `slack`, before the length `hit`."""
    first, last = 0.0, hit
    for d in range(3):
        low, high = bounds[i, d] - slack, bounds[i, d + 3] + slack
        if abs(n[d]) < 1e-12:
            if o[d] < low or o[d] > high:
                return False
            continue
        s, t = (o[d] - high) / n[d], (o[d] - low) / n[d]
        first, last = max(first, min(s, t)), min(last, max(s, t))
    return first <= last


@kernel
def _behind(f, b, o, tree, corner_start, corner_x, normal, y):
    """Distance [m] from the point `o` of face f, along its normal and into the block, to the next face of block b."""
    node_start, nodes, order, bounds = tree
    hit, i, slack = np.inf, node_start[b], 0.0
    for d in range(3):  # `_above` admits points a little beside the face
        slack = max(slack, 1e-6 * (bounds[i, d + 3] - bounds[i, d]))
    while i < node_start[b + 1]:
        if not _pierced(i, o, normal[f], slack, hit, bounds):
            i = nodes[i, 0]
            continue
        for k in range(nodes[i, 1], nodes[i, 2] if nodes[i, 0] == i + 1 else nodes[i, 1]):
            g = order[k]
            slope, height, a = 0.0, 0.0, corner_start[g]
            for d in range(3):
                slope += normal[f, d] * normal[g, d]
                height += normal[g, d] * (o[d] - corner_x[a, d])
            if g == f or slope > -1e-6:
                continue
            t = height / slope
            if t <= 0.0 or t >= hit:
                continue
            for d in range(3):
                y[d] = o[d] - t * normal[f, d]
            if _above(y, g, corner_start, corner_x, normal):
                hit = t
        i += 1
    return hit


@kernel
def _middle(corner_x, first, last, out):
    """Mean (3,) [m] of the corners first, ..., last - 1."""
    for d in range(3):
        total = 0.0
        for c in range(first, last):
            total += corner_x[c, d]
        out[d] = total / (last - first)


@kernel
def thickness(face_start, corner_start, corner_x, normal, convex, is_open, tree, out):
    """Thickness of the block behind every face [m]: extent of a convex block, else along the ray from the centroid."""
    o, y = np.empty(3), np.empty(3)
    for b in range(len(face_start) - 1):
        for f in range(face_start[b], face_start[b + 1]):
            if is_open[b]:
                out[f] = np.inf
                continue
            first, last = corner_start[f], corner_start[f + 1]
            _middle(corner_x, first, first + 1 if convex[b] else last, o)
            hit = np.inf if convex[b] else _behind(f, b, o, tree, corner_start, corner_x, normal, y)
            if hit == np.inf:  # convex, or numerically open
                hit = _extent(f, b, o, tree, corner_start, corner_x, normal)
            out[f] = hit


@kernel
def deepest(face_start, corner_start, corner_x, normal, convex, is_open, out):
    """Depth (n_blocks,) [m] a point of every block can have: of the largest ball that touches a face at its middle.

    The ball grows until it meets the plane of another face, or one of its corners (blocks that are not convex: only
    where it touches the face itself). A lower bound for convex blocks; of 200 faces in large surfaces.
    """
    o, y = np.empty(3), np.empty(3)
    for b in range(len(face_start) - 1):
        out[b] = np.inf if is_open[b] else 0.0
        first, last = face_start[b], face_start[b + 1]
        for f in range(last if is_open[b] else first, last, max(1, (last - first) // 200)):
            _middle(corner_x, corner_start[f], corner_start[f + 1], o)
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
                if t < radius and (convex[b] or (t > 0.0 and _above(y, g, corner_start, corner_x, normal))):
                    radius = t
                for c in range(a, z if not convex[b] else a):
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
def _longer(rows):
    """Twice as many rows; those there are keep their place."""
    return np.concatenate((rows, np.empty_like(rows)))


@kernel
def _sort(ids, n):
    """Sort ``ids[:n]`` in place (Shell)."""
    gap = n // 2
    while gap > 0:
        for i in range(gap, n):
            v, j = ids[i], i
            while j >= gap and ids[j - gap] > v:
                ids[j] = ids[j - gap]
                j -= gap
            ids[j] = v
        gap //= 2


@kernel
def _meets(lower, upper, low, high):
    """Whether the box lower, upper meets the box low, high."""
    for d in range(3):
        if lower[d] > high[d] or upper[d] < low[d]:
            return False
    return True


@kernel
def _find(b, low, high, face_start, tree, lower, upper, out):
    """Faces of block b whose box meets the box low, high, in ascending order: (`out` or a larger array, how many)."""
    n = np.int64(0)
    if tree is None:
        for f in range(face_start[b], face_start[b + 1]):
            if _meets(lower[f], upper[f], low, high):
                out[n] = f
                n += 1
        return out, n
    node_start, nodes, order, bounds = tree
    i = node_start[b]
    while i < node_start[b + 1]:
        if not _meets(bounds[i], bounds[i, 3:], low, high):
            i = nodes[i, 0]
            continue
        for k in range(nodes[i, 1], nodes[i, 2] if nodes[i, 0] == i + 1 else nodes[i, 1]):
            if _meets(lower[order[k]], upper[order[k]], low, high):
                if n == len(out):
                    out = _longer(out)
                out[n] = order[k]
                n += 1
        i += 1
    if node_start[b + 1] > node_start[b] + 1:
        _sort(out, n)
    return out, n


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
def _around(rows, first, last, m, reach, convex, face_start, lower, upper, tree, found, out):
    """Box `out` (2, 3) of the slave faces ``rows[first:last, 0]`` grown by `reach`; infinite if all few faces count."""
    for d in range(3):
        out[0, d], out[1, d] = np.inf, -np.inf
    for row in range(first, last):
        a = rows[row, 0]
        for d in range(3):
            out[0, d], out[1, d] = min(out[0, d], lower[a, d] - reach), max(out[1, d], upper[a, d] + reach)
    few = face_start[m + 1] - face_start[m]
    if first == last or few > FEW:
        return found
    found, n = _find(m, out[0], out[1], face_start, tree, lower, upper, found)
    if convex or n == few:
        for d in range(3):
            out[0, d], out[1, d] = -np.inf, np.inf
    return found


@kernel
def face_pairs(
    slave, master, window, size, face_start, corner_start, limit, deep, convex, corner_x, normal, lower, upper,
    block_lower, block_upper, lean, tree,
):  # fmt: skip
    """Faces of slaves and masters whose boxes are so near that a patch may exist.

    Parameters as in `clipping.clip_faces`; `lean`, `tree`: None if all blocks are convex and have few faces, of which
    all are looked at (the search is not compiled then).

    Returns
    -------
    start : (n_pairs + 1,) int64
    faces : (n, 2) int32
        Slave and master face; sorted by pair, master face, slave face.
    around : (n_pairs, 2, 3)
        Box [m] in which faces of the master may be nearer than another; infinite where all few of them count (cells of
        convex blocks are bounded by all planes). Not filled without trees: all count.
    """
    n_pairs, n_rows, n_out = len(slave), 0, np.int64(0)  # a literal would have numba compile helpers once more
    for p in range(n_pairs if tree is None else 0):
        n_rows += (face_start[slave[p] + 1] - face_start[slave[p]]) * (
            face_start[master[p] + 1] - face_start[master[p]]
        )
    start, out = np.empty(n_pairs + 1, np.int64), np.empty((max(n_rows, 1024), 2), np.int32)
    start[0] = 0
    around = np.empty((n_pairs, 2, 3))
    near, found = np.empty(64, np.int32), np.empty(64, np.int32)
    lo, hi, low, high = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for p in range(n_pairs):
        s, m, h = slave[p], master[p], window[p]
        for d in range(3):  # no slave face outside counts
            low[d], high[d], lo[d], hi[d] = block_lower[m, d] - h, block_upper[m, d] + h, np.inf, -np.inf
        near, k = _find(s, low, high, face_start, tree, lower, upper, near)
        far = 2.0 * (h + min(deep[m], size[p])) * (1.0 + 1e-9)
        for i in range(k):
            for d in range(3):
                lo[d], hi[d] = min(lo[d], lower[near[i], d] - far), max(hi[d], upper[near[i], d] + far)
        near, k = _find(m, lo, hi, face_start, tree, lower, upper, near)
        for i in range(k):
            f = near[i]
            depth = min(limit[f], size[p])  # a slave that is all inside is still in the cells of faces around it
            far = 2.0 * (h + depth)
            for d in range(3):
                aside = far if lean is None else far * lean[f, d]
                lo[d], hi[d] = lower[f, d] - aside, upper[f, d] + aside
            found, n_found = _find(s, lo, hi, face_start, tree, lower, upper, found)
            for j in range(n_found):
                a = found[j]
                if not _meets(lower[a], upper[a], low, high):
                    continue
                most = _highest(a, f, corner_start, corner_x, normal)
                if most < -h or not _overlap(lower, upper, a, f, 2.0 * (h + min(max(most, 0.0), depth))):
                    continue
                if tree is not None and n_out == len(out):
                    out = _longer(out)
                out[n_out, 0], out[n_out, 1] = a, f
                n_out += 1
        start[p + 1] = n_out
        if tree is not None:
            reach = max(4.0 * h, min(deep[m], size[p])) + h
            found = _around(out, start[p], n_out, m, reach, convex[m], face_start, lower, upper, tree, found, around[p])
    return start, out[:n_out], around


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
