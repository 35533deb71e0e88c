"""Kernels about how contacts respond beyond forces: stiffness now, energy stored, bonds that failed, safe closing.

Rows 3 i .. 3 i + 2 are the points of patch i; `gp` (n, 7) are three slave and four master gridpoints.
"""

from __future__ import annotations

import math

from fdem._jit import kernel

DILATES = 8  # bit of a patch's flags, see kernels/patches.py


@kernel
def arms(gp, points, active, x, arm):
    """Arms (3 n, 3) [m] of the points of active patches from the middle of the three."""
    for i in range(len(gp)):
        if active[i] == 0:
            continue
        a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
        m1 = (points[i, 0, 0] + points[i, 1, 0] + points[i, 2, 0]) / 3.0
        m2 = (points[i, 0, 1] + points[i, 1, 1] + points[i, 2, 1]) / 3.0
        for q in range(3):
            w1, w2 = points[i, q, 0] - m1, points[i, q, 1] - m2
            for d in range(3):
                arm[3 * i + q, d] = w1 * (x[b, d] - x[a, d]) + w2 * (x[c, d] - x[a, d])


@kernel
def whole_gaps(gp, flags, offset, active_old, memory_old, ref_points, x, gap):
    """Gaps (3 n,) [m] at the points of whole patches in the positions `x`, dilation as committed."""
    for i in range(len(gp)):
        p, q, r = gp[i, 3], gp[i, 4], gp[i, 5]
        ux, uy, uz = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
        vx, vy, vz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
        fx, fy, fz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        level = math.sqrt(fx * fx + fy * fy + fz * fz)
        lift = 0.0
        if flags[i] & DILATES and active_old[i]:
            lift = (memory_old[3 * i, 5] + memory_old[3 * i + 1, 5] + memory_old[3 * i + 2, 5]) / 3.0
        for k in range(3):
            w1, w2 = ref_points[i, k, 0], ref_points[i, k, 1]
            depth = lift
            for s in range(3):
                g = gp[i, s]
                w = w1 if s == 1 else w2 if s == 2 else 1.0 - w1 - w2
                across = fx * (x[p, 0] - x[g, 0]) + fy * (x[p, 1] - x[g, 1]) + fz * (x[p, 2] - x[g, 2])
                depth += w * (across / level - offset[i, s])
            gap[3 * i + k] = -depth


@kernel
def stored(area, facing, memory, ks, active, response, lo, hi):
    """Elastic energy [J] of the patches lo..hi, whose laws answered `response` (3 n, 4)."""
    total = 0.0
    for i in range(lo, hi):
        if active[i] == 0:
            continue
        for row in range(3 * i, 3 * i + 3):
            s = memory[row, 0] ** 2 + memory[row, 1] ** 2 + memory[row, 2] ** 2
            total += area[row] * (response[row, 2] * facing[i] + 0.5 * ks[i] * s) + response[row, 3]
    return total


@kernel
def changed(area, active, response, bound, lo, hi, share):
    """Whether a tangent stiffness of the patches lo..hi outgrew its `bound` (n,) by `share`, or they halved in all."""
    now, before = 0.0, 0.0
    for i in range(lo, hi):
        if active[i] == 0:
            continue
        for row in range(3 * i, 3 * i + 3):
            if response[row, 1] > (1.0 + share) * bound[i]:
                return True
            now += area[row] * response[row, 1]
            before += area[row] * bound[i]
    return now < 0.5 * before


@kernel
def pace(
    gp, w, face_normal, active, gap, response, kn, reach, prop, slave, master, pair, share, xdot, change, lo, hi, out
):  # fmt: skip
    """Lower `out` (n_blocks,) [s] to the time in which no patch lo..hi closes beyond `share` of what it can still take.

    A stiffening law can take ``reach (kn / k)^(1/2)`` at the tangent stiffness k: the rest of a hyperbola; an open
    patch its gap as well. `w` (3 n, 7) are row weights, `reach` is one per row of `props`; the velocities are
    ``xdot + change t`` (n_gp, 3) for a step t.
    """
    for i in range(lo, hi):
        for row in range(3 * i, 3 * i + 3):
            closing, faster = 0.0, 0.0
            for k in range(7):
                g = gp[i, k]
                for d in range(3):
                    closing -= w[row, k] * xdot[g, d] * face_normal[i, d]
                    faster -= w[row, k] * change[g, d] * face_normal[i, d]
            closing, faster = max(closing, 0.0), max(faster, 0.0)
            if closing > 0.0 or faster > 0.0:
                left = reach[prop[i]]
                if active[i]:
                    left *= math.sqrt(kn[i] / response[row, 1])
                left = max(gap[row], 0.0) + share * left
                # left = closing t + faster t^2
                time = 2.0 * left / (closing + math.sqrt(closing * closing + 4.0 * faster * left))
                for b in (slave[pair[i]], master[pair[i]]):
                    out[b] = min(out[b], time)


@kernel
def fail(active, active_old, memory, memory_old, brittle, failure):
    """Note in `failure` (n, 3) how bonds of `brittle` patches failed in this step: 1 in tension, 2 in shear.

    A patch that opened altogether with its bond has failed in tension.
    """
    for i in range(len(active)):
        if brittle[i] == 0:
            continue
        for q in range(3):
            row = 3 * i + q
            if active[i]:
                if memory[row, 3] < 0.0:
                    failure[i, q] = -memory[row, 3]
            elif active_old[i] and memory_old[row, 3] > 0.0:
                failure[i, q] = 1
