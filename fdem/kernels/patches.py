"""Kernels over contact patches: rows of weights, slip and frames for the joint laws, and their forces (CONTACT.md 3.5).

A patch is a convex polygon on a slave face (see kernels/footprints.py); it has three points, the rows 3 i .. 3 i + 2.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

WHOLE, FACING, DILATES, FLAT = 1, 2, 8, 16  # bits of a patch's flags; FLAT: face against face
AJAR = 64  # open at its cut and wider than the faces: cut anew when it closes
ALIGNED = 0.99  # -n_a.n_f above which a patch keeps the normal of its master face
STRIP = 0.02  # part of the pressure along the friction normal below which there is no friction


@kernel
def _unit_normal(a, b, c, x):
    """Unit normal of the triangle of gridpoints a, b, c, and twice its area."""
    ex, ey, ez = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    hx, hy, hz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    nx, ny, nz = ey * hz - ez * hy, ez * hx - ex * hz, ex * hy - ey * hx
    double = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / double, ny / double, nz / double, double


@kernel
def _master_frame(gp, i, thick, x, out):
    """Origin (3) and reciprocal edge vectors (9) of the tetrahedron of the master gridpoints of patch i."""
    p, q, r, t = gp[i, 3], gp[i, 4], gp[i, 5], gp[i, 6]
    ax, ay, az = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
    bx, by, bz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
    if thick:
        cx, cy, cz = x[t, 0] - x[p, 0], x[t, 1] - x[p, 1], x[t, 2] - x[p, 2]
    else:
        cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    ux, uy, uz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    vx, vy, vz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    sx, sy, sz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    det = ax * ux + ay * uy + az * uz
    out[0], out[1], out[2] = x[p, 0], x[p, 1], x[p, 2]
    out[3], out[4], out[5] = ux / det, uy / det, uz / det
    out[6], out[7], out[8] = vx / det, vy / det, vz / det
    if thick:
        out[9], out[10], out[11] = sx / det, sy / det, sz / det
    else:
        out[9], out[10], out[11] = 0.0, 0.0, 0.0


@kernel
def weights_at(gp, thick, points, x, w):
    """Seven weights of the rows at `points` (n, 3, 2) into `w` (3 n, 7): + slave, - master at the same place."""
    tet = np.empty(12)
    for i in range(len(gp)):
        _master_frame(gp, i, thick[i], x, tet)
        a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
        for q in range(3):
            row = 3 * i + q
            w1, w2 = points[i, q, 0], points[i, q, 1]
            w0 = 1.0 - w1 - w2
            dx = w0 * x[a, 0] + w1 * x[b, 0] + w2 * x[c, 0] - tet[0]
            dy = w0 * x[a, 1] + w1 * x[b, 1] + w2 * x[c, 1] - tet[1]
            dz = w0 * x[a, 2] + w1 * x[b, 2] + w2 * x[c, 2] - tet[2]
            l1 = dx * tet[3] + dy * tet[4] + dz * tet[5]
            l2 = dx * tet[6] + dy * tet[7] + dz * tet[8]
            l3 = dx * tet[9] + dy * tet[10] + dz * tet[11]
            w[row, 0], w[row, 1], w[row, 2] = w0, w1, w2
            w[row, 3], w[row, 4], w[row, 5], w[row, 6] = -(1.0 - l1 - l2 - l3), -l1, -l2, -l3


@kernel
def fill_rows(
    gp, pair, cluster, thick, x, x_old, points, active, w, gap, area, align, normal, push, slip, facing_out,
    pair_area, cluster_normal, foot, depth, face_normal,
):  # fmt: skip
    """Fill the rows of active patches, which the joint laws work on (CONTACT.md 3.5, 3.6).

    | argument | shape | unit | |
    |---|---|---|---|
    | gp | (n, 7) | - | 3 slave, 4 master gridpoints |
    | points, active, depth, face_normal | | | from `close_patches` |
    | w | (3 n, 7) | - | out: weights, + slave, - master at the same place |
    | gap, area | (3 n,) | m, m2 | out: > 0 open; `area` holds the closed shares of `close_patches` before |
    | cluster | (n,) | - | number of the patches that hang together with this one |
    | align, normal | (3 n[, 3]) | - | out: -n_a.n_c, 0 where next to nothing; friction normal |
    | push, facing_out | (n[, 3]) | - | out: slave normal n_a, -n_a.n_f |
    | slip | (3 n, 3) | m | out: motion of the slave relative to the master since `x_old` |
    | pair_area | (n_pairs,) | m2 | out: closed area |
    | cluster_normal | (n_clusters, 3) | m3 | out: summed normal force over kn |
    | foot | (n, 5) | - | out: normal of the master face; weights 5 and 6 that leave with weight 7 along it |
    """
    pair_area[:] = 0.0
    cluster_normal[:] = 0.0
    tet, du = np.empty(12), np.empty((4, 3))
    unaligned, moving, p, q, r, t = False, False, -1, -1, -1, -1
    for i in range(len(gp)):
        if active[i] == 0:
            continue
        a, b, c = gp[i, 0], gp[i, 1], gp[i, 2]
        if gp[i, 3] != p or gp[i, 4] != q or gp[i, 5] != r or gp[i, 6] != t:
            p, q, r, t = gp[i, 3], gp[i, 4], gp[i, 5], gp[i, 6]
            _master_frame(gp, i, thick[i], x, tet)
            moving = False
            for k in range(4):
                g = gp[i, 3 + k]
                for d in range(3):
                    du[k, d] = x[g, d] - x_old[g, d]
                    moving |= du[k, d] != 0.0
        nx, ny, nz, double = _unit_normal(a, b, c, x)
        fx, fy, fz = face_normal[i, 0], face_normal[i, 1], face_normal[i, 2]
        push[i, 0], push[i, 1], push[i, 2] = nx, ny, nz
        facing = -(nx * fx + ny * fy + nz * fz)
        facing_out[i] = facing
        foot[i, 0], foot[i, 1], foot[i, 2] = fx, fy, fz
        foot[i, 3], foot[i, 4] = 0.0, 0.0
        if thick[i]:
            fall = fx * tet[9] + fy * tet[10] + fz * tet[11]
            foot[i, 3] = (fx * tet[3] + fy * tet[4] + fz * tet[5]) / fall
            foot[i, 4] = (fx * tet[6] + fy * tet[7] + fz * tet[8]) / fall
        share = double * area[3 * i] / 6.0
        pair_area[pair[i]] += 3.0 * share
        ax, ay, az = x[a, 0] - x_old[a, 0], x[a, 1] - x_old[a, 1], x[a, 2] - x_old[a, 2]
        bx, by, bz = x[b, 0] - x_old[b, 0], x[b, 1] - x_old[b, 1], x[b, 2] - x_old[b, 2]
        cx, cy, cz = x[c, 0] - x_old[c, 0], x[c, 1] - x_old[c, 1], x[c, 2] - x_old[c, 2]
        pressed = 0.0
        for row in range(3 * i, 3 * i + 3):
            w1, w2 = points[i, row - 3 * i, 0], points[i, row - 3 * i, 1]
            w0 = 1.0 - w1 - w2
            dx = w0 * x[a, 0] + w1 * x[b, 0] + w2 * x[c, 0] - tet[0]
            dy = w0 * x[a, 1] + w1 * x[b, 1] + w2 * x[c, 1] - tet[1]
            dz = w0 * x[a, 2] + w1 * x[b, 2] + w2 * x[c, 2] - tet[2]
            l1 = dx * tet[3] + dy * tet[4] + dz * tet[5]
            l2 = dx * tet[6] + dy * tet[7] + dz * tet[8]
            l3 = dx * tet[9] + dy * tet[10] + dz * tet[11]
            l0 = 1.0 - l1 - l2 - l3
            w[row, 0], w[row, 1], w[row, 2] = w0, w1, w2
            w[row, 3], w[row, 4], w[row, 5], w[row, 6] = -l0, -l1, -l2, -l3
            slip[row, 0] = w0 * ax + w1 * bx + w2 * cx
            slip[row, 1] = w0 * ay + w1 * by + w2 * cy
            slip[row, 2] = w0 * az + w1 * bz + w2 * cz
            if moving:
                for d in range(3):
                    slip[row, d] -= l0 * du[0, d] + l1 * du[1, d] + l2 * du[2, d] + l3 * du[3, d]
            gap[row] = -(depth[i, 0] * w0 + depth[i, 1] * w1 + depth[i, 2] * w2)
            pressed += min(gap[row], 0.0)
            area[row] = share
            align[row] = facing
            normal[row, 0], normal[row, 1], normal[row, 2] = fx, fy, fz
        k = cluster[i]
        cluster_normal[k, 0] += share * pressed * nx
        cluster_normal[k, 1] += share * pressed * ny
        cluster_normal[k, 2] += share * pressed * nz
        unaligned |= facing <= ALIGNED
    if unaligned:
        _common_normals(active, facing_out, cluster, push, cluster_normal, align, normal)


@kernel
def _common_normals(active, facing, cluster, push, cluster_normal, align, normal):
    """Friction frame of unaligned patches: the direction of the normal force of all that hangs together with them.

    So the shares of an edge or a corner add up to the force there, and friction to mu times that (CONTACT.md 3.6).
    """
    for i in range(len(active)):
        if active[i] == 0 or facing[i] > ALIGNED:
            continue
        k = cluster[i]
        cx, cy, cz = cluster_normal[k, 0], cluster_normal[k, 1], cluster_normal[k, 2]
        s = math.sqrt(cx * cx + cy * cy + cz * cz)
        share = 0.0
        if s > 0.0:
            cx, cy, cz = cx / s, cy / s, cz / s
            share = -(push[i, 0] * cx + push[i, 1] * cy + push[i, 2] * cz)
        for row in range(3 * i, 3 * i + 3):
            align[row] = 0.0
            if share > STRIP:
                align[row] = share
                normal[row, 0], normal[row, 1], normal[row, 2] = cx, cy, cz


@kernel
def reduced_mass(gp, active, pair, pair_area, inverse_mass, inverse_gp, area, w, mass):
    """Reduced mass per area of every row [kg/m2]: a block's mass over the pair's closed area, a zone's gridpoints'.

    `inverse_mass` (n, 2) [1/kg] of slave and master block; negative: take `inverse_gp` (n_gp,) of the gridpoints.
    """
    for i in range(len(active)):
        if active[i] == 0:
            continue
        for row in range(3 * i, 3 * i + 3):
            inverse = 0.0
            for side in range(2):
                if inverse_mass[i, side] >= 0.0:
                    inverse += pair_area[pair[i]] * inverse_mass[i, side]
                else:
                    for k in range(3 * side, 3 + 4 * side):
                        inverse += area[row] * w[row, k] ** 2 * inverse_gp[gp[i, k]]
            mass[row] = 1.0 / inverse if inverse > 0.0 else 0.0


@kernel
def scatter(gp, active, w, area, push, foot, traction, f_gp):
    """Add -p a n_a + t a on the slave and the opposite on the master to the gridpoints, serially in row order.

    The part across the master's face is moved along itself to the face (`foot` from `fill_rows`): no moment changes,
    and the pressure on a zoned master is that on its surface, not one from within the zone. Weights of a side sum to
    one, so the first gridpoint gets what the others leave of the force. Forces on a master face are summed as long as
    patches stay on it.
    """
    n = len(gp)
    m1x, m1y, m1z, m2x, m2y, m2z, m3x, m3y, m3z, mx, my, mz = 12 * (0.0,)
    for i in range(n):
        if active[i] == 0:
            continue
        s1x, s1y, s1z, s2x, s2y, s2z, sx, sy, sz, across = 10 * (0.0,)
        nx, ny, nz = foot[i, 0], foot[i, 1], foot[i, 2]
        for row in range(3 * i, 3 * i + 3):
            a, p = area[row], traction[row, 0]
            fx = a * (traction[row, 1] - p * push[i, 0])
            fy = a * (traction[row, 2] - p * push[i, 1])
            fz = a * (traction[row, 3] - p * push[i, 2])
            v, u = w[row, 1], w[row, 2]
            sx, sy, sz = sx + fx, sy + fy, sz + fz
            s1x, s1y, s1z = s1x + v * fx, s1y + v * fy, s1z + v * fz
            s2x, s2y, s2z = s2x + u * fx, s2y + u * fy, s2z + u * fz
            v, u, t = w[row, 4], w[row, 5], w[row, 6]
            m1x, m1y, m1z = m1x + v * fx, m1y + v * fy, m1z + v * fz
            m2x, m2y, m2z = m2x + u * fx, m2y + u * fy, m2z + u * fz
            m3x, m3y, m3z = m3x + t * fx, m3y + t * fy, m3z + t * fz
            across += t * (fx * nx + fy * ny + fz * nz)
        v, u = across * foot[i, 3], across * foot[i, 4]
        m1x, m1y, m1z = m1x - v * nx, m1y - v * ny, m1z - v * nz
        m2x, m2y, m2z = m2x - u * nx, m2y - u * ny, m2z - u * nz
        m3x, m3y, m3z = m3x - across * nx, m3y - across * ny, m3z - across * nz
        g, h, k = gp[i, 0], gp[i, 1], gp[i, 2]
        f_gp[g, 0] += sx - s1x - s2x
        f_gp[g, 1] += sy - s1y - s2y
        f_gp[g, 2] += sz - s1z - s2z
        f_gp[h, 0] += s1x
        f_gp[h, 1] += s1y
        f_gp[h, 2] += s1z
        f_gp[k, 0] += s2x
        f_gp[k, 1] += s2y
        f_gp[k, 2] += s2z
        mx, my, mz = mx + sx, my + sy, mz + sz
        if i + 1 < n and active[i + 1] != 0 and gp[i, 3] == gp[i + 1, 3] and gp[i, 4] == gp[i + 1, 4]:
            if gp[i, 5] == gp[i + 1, 5] and gp[i, 6] == gp[i + 1, 6]:
                continue
        g, h, k, q = gp[i, 3], gp[i, 4], gp[i, 5], gp[i, 6]
        f_gp[g, 0] -= mx + m1x + m2x + m3x
        f_gp[g, 1] -= my + m1y + m2y + m3y
        f_gp[g, 2] -= mz + m1z + m2z + m3z
        f_gp[h, 0] += m1x
        f_gp[h, 1] += m1y
        f_gp[h, 2] += m1z
        f_gp[k, 0] += m2x
        f_gp[k, 1] += m2y
        f_gp[k, 2] += m2z
        f_gp[q, 0] += m3x
        f_gp[q, 1] += m3y
        f_gp[q, 2] += m3z
        m1x, m1y, m1z, m2x, m2y, m2z, m3x, m3y, m3z, mx, my, mz = 12 * (0.0,)


@kernel
def stored_energy(area, gap, push_align, memory, kn, ks, active, lo, hi):
    """Elastic energy [J] of the patches lo..hi: 1/2 kn d^2 a (-n_a.n_f) + 1/2 ks s^2 a."""
    total = 0.0
    for i in range(lo, hi):
        if active[i] == 0:
            continue
        for row in range(3 * i, 3 * i + 3):
            s = memory[row, 0] ** 2 + memory[row, 1] ** 2 + memory[row, 2] ** 2
            # not where a bond has failed and the faces stand apart
            normal = kn[i] * gap[row] ** 2 * push_align[i] if gap[row] < 0.0 or memory[row, 3] > 0.0 else 0.0
            total += 0.5 * area[row] * (normal + ks[i] * s)
    return total
