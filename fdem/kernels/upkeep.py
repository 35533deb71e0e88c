"""Kernels that tell when contacts are cut anew, which patches weigh, and how stiff they make gridpoints."""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

FLAT, AJAR = 16, 64  # bits of a patch's flags, see kernels/patches.py
CLOSED = 1e-12  # of the master's size: depth of a corner that has closed, and does not just lie in the plane


@kernel
def moved(movers, surface_gp, surface_start, x, x_check, tolerance):
    """Whether the surface of a block of `movers` moved more than its tolerance (n_blocks,) [m] since `x_check`."""
    for b in movers:
        t = tolerance[b] * tolerance[b]
        for j in range(surface_start[b], surface_start[b + 1]):
            g = surface_gp[j]
            a, b_, c = x[g, 0] - x_check[g, 0], x[g, 1] - x_check[g, 1], x[g, 2] - x_check[g, 2]
            if not a * a + b_ * b_ + c * c <= t:
                return True
    return False


@kernel
def block_motion(movers, surface_gp, surface_start, x, x_ref, out):
    """Largest displacement [m] of a surface gridpoint since `x_ref`, of the blocks `movers`; others are not written."""
    for b in movers:
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
def closing(gp, pair, flags, start, corners, offset, x, out):
    """Mark pairs (n_pairs,) uint8 one of whose patches flagged AJAR has closed; returns whether there are any."""
    found = False
    for i in range(len(gp)):
        if not flags[i] & AJAR:
            continue
        a, b, c = gp[i, 3], gp[i, 4], gp[i, 5]
        ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        scale = math.sqrt(nx * nx + ny * ny + nz * nz)
        p, q, r = gp[i, 0], gp[i, 1], gp[i, 2]
        d0 = (nx * (x[a, 0] - x[p, 0]) + ny * (x[a, 1] - x[p, 1]) + nz * (x[a, 2] - x[p, 2])) / scale - offset[i, 0]
        d1 = (nx * (x[a, 0] - x[q, 0]) + ny * (x[a, 1] - x[q, 1]) + nz * (x[a, 2] - x[q, 2])) / scale - offset[i, 1]
        d2 = (nx * (x[a, 0] - x[r, 0]) + ny * (x[a, 1] - x[r, 1]) + nz * (x[a, 2] - x[r, 2])) / scale - offset[i, 2]
        for k in range(start[i], start[i + 1]):
            depth = d0 * (1.0 - corners[k, 0] - corners[k, 1]) + d1 * corners[k, 0] + d2 * corners[k, 1]
            if depth > CLOSED * math.sqrt(scale):
                out[pair[i]] = 1
                found = True
                break
    return found


@kernel
def worn_pairs(gp, pair, w, flags, reach, normal_reach, x, out):
    """Mark pairs (n_pairs,) uint8 one of whose patches moved further than the clip allows.

    `w` (3 n, 7) are the row weights at the clip, so that ``sum w x`` is the motion since; `reach` (n,) [m] bounds its
    length, `normal_reach` (n,) how far it goes into the master face. Where a face lies against a face (`flags`),
    `reach` bounds the motion along it and the tilt, not the closure: the faces keep the area they had (CONTACT.md 3.9).
    """
    for i in range(len(gp)):
        if out[pair[i]]:
            continue
        flat = (flags[i] & FLAT) != 0
        low, high = np.inf, -np.inf
        a, b, c = gp[i, 3], gp[i, 4], gp[i, 5]
        ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        scale = math.sqrt(nx * nx + ny * ny + nz * nz)
        for q in range(3 * i, 3 * i + 3):
            dx, dy, dz = 0.0, 0.0, 0.0
            for k in range(7):
                g = gp[i, k]
                dx, dy, dz = dx + w[q, k] * x[g, 0], dy + w[q, k] * x[g, 1], dz + w[q, k] * x[g, 2]
            across = (dx * nx + dy * ny + dz * nz) / scale
            moved = dx * dx + dy * dy + dz * dz
            if flat:
                low, high = min(low, across), max(high, across)
                moved = max(moved - across * across, (high - low) ** 2)
            if not moved <= reach[i] * reach[i] or -across > normal_reach[i]:
                out[pair[i]] = 1


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
def whole_areas(gp, ratio, x, out):
    """Area (n,) [m2] of whole patches, `ratio` (n,) being their share of the slave's reference triangle."""
    for i in range(len(gp)):
        a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
        ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        out[i] = 0.5 * ratio[i] * math.sqrt(nx * nx + ny * ny + nz * nz)


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
def _touch(place, a, b, c, d, reach2):
    """Whether a corner of the polygon ``place[a:b]`` lies within sqrt(reach2) of the border of ``place[c:d]``."""
    for i in range(a, b):
        px, py, pz = place[i, 0], place[i, 1], place[i, 2]
        for j in range(c, d):
            k = j + 1 if j + 1 < d else c
            ex, ey, ez = place[k, 0] - place[j, 0], place[k, 1] - place[j, 1], place[k, 2] - place[j, 2]
            vx, vy, vz = px - place[j, 0], py - place[j, 1], pz - place[j, 2]
            square = ex * ex + ey * ey + ez * ez
            t = min(max((vx * ex + vy * ey + vz * ez) / square, 0.0), 1.0) if square > 0.0 else 0.0
            vx, vy, vz = vx - t * ex, vy - t * ey, vz - t * ez
            if vx * vx + vy * vy + vz * vz <= reach2:
                return True
    return False


@kernel
def _root(root, i):
    """First of the set that `i` belongs to."""
    while root[i] != i:
        root[i] = root[root[i]]
        i = root[i]
    return i


@kernel
def clusters(pair, aligned, gp, start, corners, x, reach, out):
    """Number within its pair (n,) of the set of patches that hang together with each; patches are sorted by pair.

    Two patches touch where a corner of one lies within `reach` (n_pairs,) [m] of the border of the other: tiles of one
    surface do so only along common edges. Pairs all of whose patches are `aligned` need no clusters and get 0.
    """
    n = len(pair)
    place, low, high = np.empty((len(corners), 3)), np.empty((n, 3)), np.empty((n, 3))
    root = np.arange(n)
    first = 0
    while first < n:
        last = first
        plain = True
        while last < n and pair[last] == pair[first]:
            plain &= aligned[last]
            last += 1
        if plain or last - first == 1:
            first = last
            continue
        far = reach[pair[first]]
        for i in range(first, last):
            a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
            low[i], high[i] = np.inf, -np.inf
            for k in range(start[i], start[i + 1]):
                w1, w2 = corners[k, 0], corners[k, 1]
                for d in range(3):
                    place[k, d] = (1.0 - w1 - w2) * x[a, d] + w1 * x[b, d] + w2 * x[c, d]
                    low[i, d], high[i, d] = min(low[i, d], place[k, d]), max(high[i, d], place[k, d])
        axis, widest = 0, -1.0
        for d in range(3):
            spread = high[first:last, d].max() - low[first:last, d].min()
            if spread > widest:
                axis, widest = d, spread
        order = first + np.argsort(low[first:last, axis], kind="mergesort")
        for m in range(len(order)):
            i = order[m]
            for other in range(m + 1, len(order)):
                j = order[other]
                if low[j, axis] > high[i, axis] + far:
                    break
                apart = False
                for d in range(3):
                    apart |= low[j, d] > high[i, d] + far or low[i, d] > high[j, d] + far
                if apart or _root(root, i) == _root(root, j):
                    continue
                if _touch(place, start[i], start[i + 1], start[j], start[j + 1], far * far) or _touch(
                    place, start[j], start[j + 1], start[i], start[i + 1], far * far
                ):
                    a, b = _root(root, i), _root(root, j)
                    root[max(a, b)] = min(a, b)
        for i in range(first, last):
            out[i] = _root(root, i) - first
        first = last
