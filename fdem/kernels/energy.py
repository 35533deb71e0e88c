"""Kernels over the elastic energy of contact patches: what the walls between the master's cells add to the faces.

With d the depth, ``W = kn int d dV`` over the overlap. In the cell of face f, ``d = div(-n_f d^2 / 2)``: the slave's
surface gives ``1/2 kn int d^2 (-n_a.n_f) dA``, and every wall w of the cell the flux ``1/2 kn (-n_f.w) int d^2 dA``
over its part inside the slave. That part is bounded by edges of patches, so ``d^2 = div(t d^3 / 3 |t|^2)``, t the
gradient of d in the wall, turns it into integrals of d^3 along them; ridges, where three cells meet, end in corners of
patches and leave d^4 there. Where ridges meet inside the slave (below the middle of a short edge) a d^4 of that place
is missing.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

FLAT = 16  # bit of a patch's flags, see kernels/patches.py
SAME = 1e-9  # in units of the reference triangle: corners closer than this are one


@kernel
def partners(order, pair, face_s, flags, start, corners, out):
    """For every edge of every patch (n_corners,) the patch beyond it on the same slave face, -1 if there is none.

    `order` (n,) sorts the patches by pair and slave face. Where faces lie against faces on both sides of an edge there
    is no wall that counts.
    """
    n = len(order)
    first = 0
    while first < n:
        last = first
        while last < n and pair[order[last]] == pair[order[first]] and face_s[order[last]] == face_s[order[first]]:
            last += 1
        for u in range(first, last):
            i = order[u]
            if flags[i] & FLAT:
                continue
            for v in range(first, last):
                j = order[v]
                if i == j:
                    continue
                for k in range(start[i], start[i + 1]):
                    k2 = k + 1 if k + 1 < start[i + 1] else start[i]
                    for m in range(start[j], start[j + 1]):
                        m2 = m + 1 if m + 1 < start[j + 1] else start[j]
                        if (
                            abs(corners[k, 0] - corners[m2, 0]) + abs(corners[k, 1] - corners[m2, 1]) < SAME
                            and abs(corners[k2, 0] - corners[m, 0]) + abs(corners[k2, 1] - corners[m, 1]) < SAME
                        ):
                            out[k], out[m] = j, i
        first = last


@kernel
def _wall(i, j, lo, hi, corners, depth, normal, w):
    """Normal `w` (3) of the wall from the cell of patch i to that of patch j; -n_f.w, 0 if there is no wall."""
    w1, w2 = 0.0, 0.0
    for k in range(lo, hi):
        w1, w2 = w1 + corners[k, 0] / (hi - lo), w2 + corners[k, 1] / (hi - lo)
    above = (depth[j, 0] - depth[i, 0]) * (1.0 - w1 - w2)
    above += (depth[j, 1] - depth[i, 1]) * w1 + (depth[j, 2] - depth[i, 2]) * w2
    sign = 1.0 if above > 0.0 else -1.0  # at a re-entrant edge the deeper of the two counts
    square = 0.0
    for d in range(3):
        w[d] = sign * (normal[j, d] - normal[i, d])
        square += w[d] * w[d]
    length = math.sqrt(square)
    if length < 1e-7:
        return 0.0
    for d in range(3):
        w[d] /= length
    return 0.5 * sign * length


@kernel
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _outwards(n, w, s, normal, i):
    """``t.nu / |t|^2`` in the wall `w` of patch i for a border whose outward normal is `n`, and -n_f.w = s."""
    along = _dot(n, w)
    size = math.sqrt(max(_dot(n, n) - along * along, 0.0))
    square = 1.0 - s * s
    if not (size > 1e-9 and square > 1e-12):
        return 0.0
    # t = -n_f - s w, and nu = (n - along w) / size
    total = -s * along
    for d in range(3):
        total -= normal[i, d] * n[d]
    return total / (size * square)


@kernel
def _along_edge(d1, d2, length):
    """Integral of d^3 along an edge from depth d1 to d2, where d is positive."""
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0
    if d1 < 0.0:
        length, d1 = length * d2 / (d2 - d1), 0.0
    elif d2 < 0.0:
        length, d2 = length * d1 / (d1 - d2), 0.0
    return 0.25 * length * (d1 + d2) * (d1 * d1 + d2 * d2)


@kernel
def wall_energy(start, corners, partner, metric, depth, push, normal, kn, active):
    """Elastic energy [J] that passes through the walls of the cells (see the top of the file).

    | argument | shape | unit | |
    |---|---|---|---|
    | start, corners | | - | polygons of the patches |
    | partner | (n_corners,) | - | from `partners` |
    | metric | (n, 3) | m2 | g11, g12, g22 of the slave's reference triangle |
    | depth | (n, 3) | m | at the slave gridpoints |
    | push, normal | (n, 3) | - | normals of slave and master face |
    | kn, active | (n,) | Pa/m, - | |
    """
    total = 0.0
    w, v, r = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(active)):
        if active[i] == 0:
            continue
        lo, hi = start[i], start[i + 1]
        flux = 0.0
        for k in range(lo, hi):
            j = partner[k]
            if j < 0:
                continue
            s = _wall(i, j, lo, hi, corners, depth, normal, w)
            if s == 0.0:
                continue
            after = k + 1 if k + 1 < hi else lo
            before = k - 1 if k > lo else hi - 1
            a1, a2, b1, b2 = corners[k, 0], corners[k, 1], corners[after, 0], corners[after, 1]
            e1, e2 = b1 - a1, b2 - a2
            length = math.sqrt(metric[i, 0] * e1 * e1 + 2.0 * metric[i, 1] * e1 * e2 + metric[i, 2] * e2 * e2)
            da = depth[i, 0] * (1.0 - a1 - a2) + depth[i, 1] * a1 + depth[i, 2] * a2
            db = depth[i, 0] * (1.0 - b1 - b2) + depth[i, 1] * b1 + depth[i, 2] * b2
            flux += s * _outwards(push[i], w, s, normal, i) * _along_edge(da, db, length)
            for end in range(2):
                other, d = (partner[before], da) if end == 0 else (partner[after], db)
                if other < 0 or other == j or d <= 0.0 or _wall(i, other, lo, hi, corners, depth, normal, v) == 0.0:
                    continue
                for c in range(3):
                    c1, c2 = (c + 1) % 3, (c + 2) % 3
                    r[c] = w[c1] * v[c2] - w[c2] * v[c1]
                size = math.sqrt(_dot(r, r))
                fall = -(normal[i, 0] * r[0] + normal[i, 1] * r[1] + normal[i, 2] * r[2])
                if abs(fall) <= 1e-9 * size or size <= 1e-9:
                    continue
                leaves = 1.0 if _dot(push[i], r) * fall > 0.0 else -1.0
                flux += s * _outwards(v, w, s, normal, i) * leaves * d**4 * size / (4.0 * abs(fall))
        total += kn[i] * flux / 6.0
    return total
