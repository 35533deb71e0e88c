"""Kernels that tell when contacts are cut anew, which patches weigh, and how stiff they make gridpoints."""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

FLAT, AJAR = 16, 64  # bits of a patch's flags, see kernels/patches.py


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
            if d0 * (1.0 - corners[k, 0] - corners[k, 1]) + d1 * corners[k, 0] + d2 * corners[k, 1] > 0.0:
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
