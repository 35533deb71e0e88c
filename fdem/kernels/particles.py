"""Particles (centres with radii): cell order, half lists of near pairs, history carried from list to list.

Particles are kept in *packed order*: by level (smallest spheres first), then by cell, then by id. A pair is listed
once, under its particle that comes first, touching partners before others; sums run in the order of the list.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

SLACK = 1.0 + 1e-6  # a cell is a little larger than what it holds, so that rounding cannot push one past a neighbour
FINEST = 60  # deepest level


@kernel
def cells(x, reach, level, cell, origin):
    """Grid level (n,) and cell (n, 3) of particles at `x` (n, 3) with `reach` (n,) [m]; returns the coarsest cell size.

    Two particles interact only if their distance is below the sum of their reaches: on one level they then lie in cells
    that touch, and so they do on the coarser level of the two.
    """
    n = len(reach)
    size = 0.0
    for i in range(n):
        size = max(size, reach[i])
    size *= 2.0 * SLACK
    for d in range(3):
        origin[d] = np.inf
        for i in range(n):
            origin[d] = min(origin[d], x[i, d])
    for i in range(n):
        step = 0
        while step < FINEST and 2.0 * SLACK * reach[i] <= size / 2.0 ** (step + 1):
            step += 1
        level[i] = step
        inverse = 2.0**step / size
        for d in range(3):
            cell[i, d] = math.floor((x[i, d] - origin[d]) * inverse)
    return size


@kernel
def sort_keys(level, cell, key):
    """One integer per particle that sorts them by level (finest first), cell and id; False if it does not fit."""
    n = len(level)
    top = np.zeros(3, np.int64)
    deepest = 0
    for i in range(n):
        deepest = max(deepest, level[i])
        for d in range(3):
            top[d] = max(top[d], cell[i, d] + 1)
    if math.log2(top[0]) + math.log2(top[1]) + math.log2(top[2]) + math.log2(n * (deepest + 1.0)) > 62.0:
        return False
    for i in range(n):
        key[i] = ((((deepest - level[i]) * top[0] + cell[i, 0]) * top[1] + cell[i, 1]) * top[2] + cell[i, 2]) * n + i
    return True


@kernel
def _slot(level, a, b, c, mask):
    """Place of a cell in the hash table."""
    h = (a * 73856093) ^ (b * 19349663) ^ (c * 83492791) ^ (level * 49979687)
    return (h ^ (h >> 15)) & mask


@kernel
def _find(level, a, b, c, head, mask, first, levels, cell_of):
    """Number of a cell that holds particles, -1 if there is none."""
    slot = _slot(level, a, b, c, mask)
    while head[slot] >= 0:
        u = head[slot]
        i = first[u]
        if levels[i] == level and cell_of[i, 0] == a and cell_of[i, 1] == b and cell_of[i, 2] == c:
            return u
        slot = (slot + 1) & mask
    return -1


@kernel
def _table(level, cell, first, head, mask):
    """Occupied cells of packed particles: first particle of each, and their hash table; returns how many."""
    n, used = len(level), 0
    for i in range(n):
        if (
            i > 0 and level[i] == level[i - 1] and cell[i, 0] == cell[i - 1, 0] and cell[i, 1] == cell[i - 1, 1]
            and cell[i, 2] == cell[i - 1, 2]
        ):  # fmt: skip
            continue
        first[used] = i
        slot = _slot(level[i], cell[i, 0], cell[i, 1], cell[i, 2], mask)
        while head[slot] >= 0:
            slot = (slot + 1) & mask
        head[slot] = used
        used += 1
    first[used] = n
    return used


@kernel
def _ranges(u, level, cell, first, head, mask, present, lo, hi):
    """Packed ranges of particles that may be near those of cell `u` and come after them; returns how many."""
    i = first[u]
    a, b, c = cell[i, 0], cell[i, 1], cell[i, 2]
    m = 1
    lo[0], hi[0] = first[u], first[u + 1]
    for down in range(level[i] + 1):
        coarse = level[i] - down
        if not present[coarse]:
            continue
        if down > 0:
            a, b, c = cell[i, 0] >> down, cell[i, 1] >> down, cell[i, 2] >> down
        for da in range(0 if down == 0 else -1, 2):
            for db in range(0 if down == 0 and da == 0 else -1, 2):
                for dc in range(1 if down == 0 and da == 0 and db == 0 else -1, 2):
                    w = _find(coarse, a + da, b + db, c + dc, head, mask, first, level, cell)
                    if w < 0:
                        continue
                    if first[w] == hi[m - 1]:
                        hi[m - 1] = first[w + 1]
                    else:
                        lo[m], hi[m] = first[w], first[w + 1]
                        m += 1
    return m


@kernel
def tabulate(level, cell):
    """First particle of each occupied cell (and one past the last), and the hash table of these cells."""
    n = len(level)
    mask = 1
    while mask < 2 * n + 2:
        mask *= 2
    mask -= 1
    head, first = np.full(mask + 1, -1, np.int32), np.empty(n + 1, np.int32)
    used = _table(level, cell, first, head, mask)
    return first[: used + 1].copy(), head


@kernel
def near_pairs(x, reach, body, mobile, level, cell, first, head, touch):
    """Half list of pairs closer than the sum of their reaches.

    ===========  ==========  ==================================================
    x            (n, 3)      centres in packed order [m]
    reach        (n,)        [m]
    body         (n,)        block of each: particles of one block are no pair
    mobile       (n,)        whether it can move: two that cannot are no pair
    level        (n,)        grid level
    cell         (n, 3)      cell on its level
    first, head              what `tabulate` returned
    touch                    share of the reaches below which a pair comes first in its row: what follows in the list
                             of pairs is then mostly alike, which a processor reckons with
    ===========  ==========  ==================================================

    Returns ``start`` (n + 1,) and ``partner`` (m,), uint32: the partners of i are ``partner[start[i]:start[i + 1]]``.
    """
    n, mask = len(reach), len(head) - 1
    present = np.zeros(FINEST + 1, np.bool_)
    for i in range(n):
        present[level[i]] = True
    lo, hi = np.empty(27 * (FINEST + 1), np.int32), np.empty(27 * (FINEST + 1), np.int32)
    start, partner = np.zeros(n + 1, np.uint32), np.empty(4 * n + 16, np.uint32)
    m = 0
    for u in range(len(first) - 1):
        ranges = _ranges(u, level, cell, first, head, mask, present, lo, hi)
        for i in range(first[u], first[u + 1]):
            px, py, pz, r = x[i, 0], x[i, 1], x[i, 2], reach[i]
            begin = m
            for k in range(ranges):
                for j in range(max(lo[k], i + 1), hi[k]):
                    dx, dy, dz, s = x[j, 0] - px, x[j, 1] - py, x[j, 2] - pz, r + reach[j]
                    square = dx * dx + dy * dy + dz * dz
                    if not square < s * s:
                        continue
                    if body[i] == body[j] or not (mobile[i] or mobile[j]):
                        continue
                    if m == len(partner):
                        partner = np.concatenate((partner, np.empty_like(partner)))
                    partner[m] = j
                    if square < touch * touch * s * s:
                        partner[m], partner[begin] = partner[begin], j
                        begin += 1
                    m += 1
            start[i + 1] = m
    return start, partner[:m].copy()


@kernel(inline=True)
def _beside(f, i, lower, upper, point, normal, pad, x, reach, body, mobile, face_body, face_mobile):
    """Whether particle `i` is within reach of the box and the plane of face `f`, and not far behind it."""
    if body[i] == face_body[f] or not (mobile[i] or face_mobile[f]):
        return False
    r = reach[i] + pad
    height = 0.0
    for d in range(3):
        if not lower[f, d] - r < x[i, d] < upper[f, d] + r:
            return False
        height += (x[i, d] - point[f, d]) * normal[f, d]
    return -0.5 * r < height < r


@kernel
def _cells_within(step, a, b, level, cell, first, head, out):
    """Occupied cells of one level in a range: into `out`; returns how many. A large range is not walked through."""
    m, count = 0, 1.0
    for d in range(3):
        count *= b[d] - a[d] + 1.0
    if count < len(first):
        for ca in range(a[0], b[0] + 1):
            for cb in range(a[1], b[1] + 1):
                for cc in range(a[2], b[2] + 1):
                    u = _find(step, ca, cb, cc, head, len(head) - 1, first, level, cell)
                    if u >= 0:
                        out[m] = u
                        m += 1
        return m
    for u in range(len(first) - 1):
        i = first[u]
        inside = level[i] == step
        for d in range(3):
            inside &= a[d] <= cell[i, d] <= b[d]
        if inside:
            out[m] = u
            m += 1
    return m


@kernel
def near_faces(
    lower, upper, point, normal, pad, face_body, face_mobile, x, reach, body, mobile, level, cell, first, head, origin,
    size,
):  # fmt: skip
    """Particles and faces that may touch.

    ==============  ==========  ==================================================
    lower, upper    (n, 3)      boxes of the faces [m]
    point, normal   (n, 3)      a point of each plane [m], outward unit normal
    pad             float       added to every reach [m]
    face_body       (n,)        block of each face
    face_mobile     (n,)        whether it can move
    x ... head                  as for `near_pairs`
    origin, size                of the cells, from `cells` [m]
    ==============  ==========  ==================================================

    Returns the packed place of the particle and the face of every candidate, (m,) each, in no particular order.
    """
    widest = np.zeros(FINEST + 1)
    for i in range(len(reach)):
        widest[level[i]] = max(widest[level[i]], reach[i])
    who, which, m = np.empty(len(reach) + 16, np.int64), np.empty(len(reach) + 16, np.int64), 0
    a, b, near = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(len(first), np.int64)
    for f in range(len(lower)):
        for step in range(FINEST + 1):
            if widest[step] == 0.0:
                continue
            r, inverse = widest[step] + pad, 2.0**step / size
            for d in range(3):
                a[d] = math.floor((lower[f, d] - r - origin[d]) * inverse)
                b[d] = math.floor((upper[f, d] + r - origin[d]) * inverse)
            for k in range(_cells_within(step, a, b, level, cell, first, head, near)):
                for i in range(first[near[k]], first[near[k] + 1]):
                    if not _beside(
                        f, i, lower, upper, point, normal, pad, x, reach, body, mobile, face_body, face_mobile
                    ):
                        continue
                    if m == len(who):
                        who = np.concatenate((who, np.empty_like(who)))
                        which = np.concatenate((which, np.empty_like(which)))
                    who[m], which[m] = i, f
                    m += 1
    return who[:m].copy(), which[:m].copy()


@kernel
def carry_pairs(old_start, old_partner, old_memory, at_old, start, partner, memory, source):
    """Move the history of pairs from one list to another.

    ==============================  ==========================================================================
    old_start, old_partner          half list of before
    old_memory  (m_old, k)          history; columns 0-2 a vector that changes sign with the order of the pair
    at_old      (n,)                packed place in the old list of each particle of the new one, -1: new
    start, partner                  half list of now
    memory      (m, k)              out: history, 0 for new pairs
    source      (m,)                out: row of the old list, -1: new
    ==============================  ==========================================================================
    """
    for i in range(len(start) - 1):
        oi = at_old[i]
        for k in range(start[i], start[i + 1]):
            source[k] = -1
            oj = at_old[partner[k]]
            if oi < 0 or oj < 0:
                continue
            a, b = min(oi, oj), max(oi, oj)
            for q in range(old_start[a], old_start[a + 1]):
                if old_partner[q] == b:
                    source[k] = q
                    sign = 1.0 if oi < oj else -1.0
                    for c in range(memory.shape[1]):
                        memory[k, c] = old_memory[q, c] * (sign if c < 3 else 1.0)
                    break


@kernel
def follow(order, gp, spin, x, x_old, before, v, dt, turn, place, motion):
    """Follow a step: rotations since the last commit, positions and motions in packed order as `pack` gives them.

    =============  ============  ==================================================
    order          (n,)          particle at every packed place
    gp, spin       (n,)          its gridpoint; its first rotational velocity in `v` (-1: does not turn)
    x, x_old       (n_gp, 3)     positions now, and at the last commit [m]
    before         (n, 4)        where pairs were last looked for, and the square of the motion after which they are due
    v              (n_dofs,)     velocities of the step just made
    dt             float         its length [s]
    turn           (n, 3)        in, out: rotation since the last commit [rad], by particle
    place, motion                out, as for `pack`
    =============  ============  ==================================================

    Returns whether pairs are due, and the largest motion since the last commit over the radius.
    """
    due, fast = False, 0.0
    for i in range(len(order)):
        p, g, s, r = order[i], gp[i], spin[i], place[i, 3]
        px, py, pz = x[g, 0], x[g, 1], x[g, 2]
        ux, uy, uz = px - x_old[g, 0], py - x_old[g, 1], pz - x_old[g, 2]
        a, b, c = px - before[i, 0], py - before[i, 1], pz - before[i, 2]
        if s >= 0:
            k = np.uint64(s)
            turn[p, 0] += dt * v[k]
            turn[p, 1] += dt * v[k + np.uint64(1)]
            turn[p, 2] += dt * v[k + np.uint64(2)]
        place[i, 0], place[i, 1], place[i, 2] = px, py, pz
        motion[i, 0], motion[i, 1], motion[i, 2] = ux, uy, uz
        motion[i, 3], motion[i, 4], motion[i, 5] = turn[p, 0], turn[p, 1], turn[p, 2]
        due |= not a * a + b * b + c * c <= before[i, 3]
        square = ux * ux + uy * uy + uz * uz
        if square > fast * (r * r):
            fast = square / (r * r)
    return due, math.sqrt(fast)


@kernel
def strayed(gp, x, x_ref, allowed):
    """Whether one of the gridpoints `gp` moved further than `allowed` [m] from `x_ref` (n, 3)."""
    for p in range(len(gp)):
        g = gp[p]
        a, b, c = x[g, 0] - x_ref[p, 0], x[g, 1] - x_ref[p, 1], x[g, 2] - x_ref[p, 2]
        if not a * a + b * b + c * c <= allowed * allowed:
            return True
    return False


@kernel
def pack(order, gp, x, x_old, turn, place, motion):
    """Positions and motions since the last commit in packed order.

    ========  ==========  ==================================================
    order     (n,)        particle at every packed place
    gp        (n,)        its gridpoint
    x, x_old  (n_gp, 3)   positions now and at the last commit [m]
    turn      (n, 3)      rotation since the last commit [rad], by particle
    place     (n, 4)      out: position [m]; column 3, the radius, is left
    motion    (n, 8)      out: displacement [m] in columns 0-2, rotation [rad] in 3-5
    ========  ==========  ==================================================
    """
    for i in range(len(order)):
        p, g = order[i], gp[i]
        for d in range(3):
            place[i, d] = x[g, d]
            motion[i, d] = x[g, d] - x_old[g, d]
            motion[i, 3 + d] = turn[p, d]


@kernel
def unpack(gp, spin, force, f_gp, f):
    """Add forces to gridpoints and moments to blocks.

    ============  ==========  ==================================================
    gp, spin      (n,)        packed: gridpoint; first rotational velocity, -1: does not turn
    force         (n, 6)      packed: force [N] and moment [N m]
    f_gp          (n_gp, 3)   added to [N]
    f             (n_dofs,)   added to [N m]
    ============  ==========  ==================================================
    """
    for i in range(len(gp)):
        g, s = gp[i], spin[i]
        for d in range(3):
            f_gp[g, d] += force[i, d]
        if s >= 0:
            for d in range(3):
                f[np.uint64(s) + np.uint64(d)] += force[i, 3 + d]


@kernel
def passed(start, partner, place, motion):
    """First pair that met in a step in which it moved by more than half the smaller radius; -1: none.

    ==============  ==================================================
    start, partner  half list
    place, motion   packed spheres at the end of the step, and how they moved in it (kernels/spheres.py)
    ==============  ==================================================
    """
    for i in range(len(start) - 1):
        for k in range(start[i], start[i + 1]):
            j = partner[k]
            square = along = moved = 0.0
            for d in range(3):
                apart, u = place[j, d] - place[i, d], motion[j, d] - motion[i, d]
                square += apart * apart
                along += apart * u
                moved += u * u
            if not moved > 0.25 * min(place[i, 3], place[j, 3]) ** 2:
                continue
            # nearest on the way: the distance was `apart - s u` a share s of the step ago
            s = min(max(along / moved, 0.0), 1.0)
            if square - 2.0 * s * along + s * s * moved < (place[i, 3] + place[j, 3]) ** 2:
                return k
    return -1
