"""Contact of spheres: one fused pass over a half list of pairs, many contacts side by side, history inline.

Every law is one formula in the overlap d and what the pair's row of `table` says:

    N = K d r + z_n sqrt(m K r) d'                not less than 0
    T = k_t r s + z_t sqrt(m K r) s'              spring not more than mu N, no dashpot where both are more

with ``r = sqrt(d)`` for Hertz-Mindlin (K = 4/3 E* sqrt(R*), k_t = 8 G* sqrt(R*)) and ``r = 1`` for linear springs. s
is the elastic slip, a vector that turns with the contact. Where the contact area grows, s shrinks so that T stays (new
area carries no shear); where it shrinks, s stays and T falls. So the spring loses energy and never gains any; what it
loses counts as dissipated by friction (Thornton, Cummins, Cleary, Powder Technology 233 (2013) 30-46).

The two bodies meet in the middle of the overlap: arms and forces are those of one point, which keeps angular momentum.

| shared argument | shape | |
|---|---|---|
| place | (n, 4) | centre [m] and radius [m], packed order |
| motion | (n, 8) | displacement [m] (0-2) and rotation [rad] (3-5) since the last commit |
| start, partner | uint32 | half list of pairs |
| kind | (m,) uint32 | row of `table` |
| table | (k, 11) | K [N/m, N/m^1.5], k_t, z_n, z_t, mu, 1 for Hertz or 0, 1/k_t, reduced mass m [kg], 1/m, rolling and
twisting length [m] |
| memory_old, memory | (m, 5) | committed and trial history: s [m], r (0: open), z: half of what the contact force
adds to the closing speed in a step less half that speed [m/s] |
| dt | float | time since the last commit [s]; 0: no dashpots |
| force | (n, 6) | out: force [N] and moment [N m] |
| record | (m, 4) or (0, 4) | out, if it has rows: N [N], T on the first sphere's partner [N]; zeros at first |
| out | (5,) | friction and damping work [J], added to; touching pairs; 1 + row of a pair that is too deep, or 0;
largest tangent stiffness over reduced mass [1/s^2] |
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

L = 32  # contacts computed side by side: two or four vectors, so that one waits while the other computes
OWN = 1.5  # times what a contact force alone changes of its closing speed: other contacts of the sphere change it too
DEEP = 1.0 / 3.0  # half the overlap over the arm where the overlap is half the smaller radius: no contact any more


@kernel
def _pair_geometry(work):
    """Normal, overlap, slip and arms of L pairs.

    One array only: its rows are a constant distance apart, so that the compiler sees that stores do not meet loads, and
    computes the lanes side by side. Rows 0-2 distance, 3, 4 radii, 5-7 relative displacement, 8-10 and 11-13 rotations;
    out: 14-16 normal from the first to the second, 17 overlap, 18-20 motion of the first against the second at the
    contact, 21 rotation of the pair about the normal, 22, 23 arms.
    """
    for i in range(L):
        dx, dy, dz = work[i], work[L + i], work[2 * L + i]
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        inverse = 1.0 / distance
        nx, ny, nz = dx * inverse, dy * inverse, dz * inverse
        ri, rj = work[3 * L + i], work[4 * L + i]
        overlap = ri + rj - distance
        ai, aj = ri - 0.5 * overlap, rj - 0.5 * overlap
        ox, oy, oz = work[8 * L + i], work[9 * L + i], work[10 * L + i]
        px, py, pz = work[11 * L + i], work[12 * L + i], work[13 * L + i]
        wx, wy, wz = ai * ox + aj * px, ai * oy + aj * py, ai * oz + aj * pz
        work[14 * L + i], work[15 * L + i], work[16 * L + i] = nx, ny, nz
        work[17 * L + i] = overlap
        work[18 * L + i] = work[5 * L + i] + (wy * nz - wz * ny)
        work[19 * L + i] = work[6 * L + i] + (wz * nx - wx * nz)
        work[20 * L + i] = work[7 * L + i] + (wx * ny - wy * nx)
        work[21 * L + i] = 0.5 * ((ox + px) * nx + (oy + py) * ny + (oz + pz) * nz)
        work[22 * L + i], work[23 * L + i] = ai, aj


@kernel
def _law(work, dt, inverse_dt, deep):
    """Forces of L contacts (top of file) from rows 14-21, history in 24-28 and table in 29-37.

    Out: row 0 N, 1-3 force on the second, 4-6 normal x T, 7 friction work, 8 damping work, 9 stiffness over mass, 10
    whether half the overlap is more than `deep` times the smaller arm, 24-28 history.

    In three short loops: the long one waits for its roots and divisions, of short ones the next lanes begin meanwhile.
    """
    _press(work, dt, inverse_dt, deep)
    _carry(work)
    _slide(work)


@kernel
def _press(work, dt, inverse_dt, deep):
    """Normal forces. Out: rows 0, 8-10, 28; 11 r, 12 dashpot across [N/m], 18-20 only what is in the plane of contact.

    The normal dashpot acts on the speed at the time of the force, which is not known yet:
    ``v(n) = 3/2 v(n-1/2) - 1/2 v(n-3/2) - (N(n) - N(n-1)) dt / 2m``, the last two speeds carried on and what this
    force alone changes. So it is right to second order, takes nothing from the stable step, and is zero at rest.
    """
    for i in range(L):
        nx, ny, nz = work[14 * L + i], work[15 * L + i], work[16 * L + i]
        overlap = work[17 * L + i]
        ex, ey, ez = work[18 * L + i], work[19 * L + i], work[20 * L + i]
        old_root = work[27 * L + i]
        hertz = work[34 * L + i]
        root = math.sqrt(overlap) if hertz > 0.0 else 1.0
        closing = ex * nx + ey * ny + ez * nz
        work[18 * L + i], work[19 * L + i], work[20 * L + i] = ex - closing * nx, ey - closing * ny, ez - closing * nz
        stiffness = work[29 * L + i] * root
        elastic = stiffness * overlap
        # a contact that began a share of a step ago is damped for that and the half step to come
        begun = 0.5 + overlap / closing if old_root == 0.0 and overlap < closing else 1.0
        critical = math.sqrt(stiffness * work[36 * L + i])
        dashpot = work[31 * L + i] * critical * begun
        step, speed = 0.5 * OWN * dt * work[37 * L + i], closing * inverse_dt
        before = work[28 * L + i] if old_root > 0.0 else -0.5 * speed
        # nothing is carried on from a force without a step before it: at the start, and out of fictitious time
        known = 1.0 if before != 0.0 else 0.0
        before += (1.0 + 0.5 * known) * speed
        normal = (elastic + dashpot * before) / (1.0 + known * dashpot * step)
        normal = normal if normal > 0.0 else 0.0
        viscous = normal - elastic
        closing = dt * (before - known * step * normal)
        # across, a sphere that rolls gives way 7/2 as easily
        drag = work[32 * L + i] * critical
        work[i] = normal
        work[8 * L + i] = viscous * closing
        work[9 * L + i] = stiffness * (1.0 + 0.5 * hertz) * work[37 * L + i]
        work[10 * L + i] = 0.0 if 0.5 * overlap < deep * min(work[22 * L + i], work[23 * L + i]) else 1.0
        work[11 * L + i], work[12 * L + i] = root, drag * (inverse_dt / (1.0 + 3.5 * drag * step))
        work[28 * L + i] = step * normal - 0.5 * speed


@kernel
def _carry(work):
    """History with the plane of contact, round its normal, at its length. Out: rows 7, 24-27, 13 the longest spring."""
    for i in range(L):
        nx, ny, nz = work[14 * L + i], work[15 * L + i], work[16 * L + i]
        ex, ey, ez = work[18 * L + i], work[19 * L + i], work[20 * L + i]
        about = work[21 * L + i]
        s0, s1, s2, old_root = work[24 * L + i], work[25 * L + i], work[26 * L + i], work[27 * L + i]
        inverse_root = 1.0 / work[11 * L + i]
        most = work[33 * L + i] * work[i] * work[35 * L + i] * inverse_root
        length = s0 * s0 + s1 * s1 + s2 * s2
        along = s0 * nx + s1 * ny + s2 * nz
        s0, s1, s2 = s0 - along * nx, s1 - along * ny, s2 - along * nz
        b0, b1, b2 = (
            s0 + about * (ny * s2 - nz * s1), s1 + about * (nz * s0 - nx * s2), s2 + about * (nx * s1 - ny * s0)
        )  # fmt: skip
        flat = b0 * b0 + b1 * b1 + b2 * b2
        grown = old_root * inverse_root
        grown = grown if grown < 1.0 else 1.0
        kept = length * grown * grown
        kept = kept if kept < most * most else most * most
        scale = kept / flat
        scale = math.sqrt(scale) if flat > 0.0 else 0.0
        # what the force of before does to the motion, less what the spring takes up: as the motion sees it
        work[7 * L + i] = 0.5 * work[30 * L + i] * old_root * (length + b0 * ex + b1 * ey + b2 * ez)
        work[13 * L + i] = most
        work[24 * L + i], work[25 * L + i], work[26 * L + i] = b0 * scale + ex, b1 * scale + ey, b2 * scale + ez
        work[27 * L + i] = work[11 * L + i]


@kernel
def _slide(work):
    """Shear forces. Out: rows 1-6, 24-26, and what is added to 7 and 8."""
    for i in range(L):
        nx, ny, nz = work[14 * L + i], work[15 * L + i], work[16 * L + i]
        ex, ey, ez = work[18 * L + i], work[19 * L + i], work[20 * L + i]
        s0, s1, s2, most = work[24 * L + i], work[25 * L + i], work[26 * L + i], work[13 * L + i]
        normal, kt, drag = work[i], work[30 * L + i] * work[11 * L + i], work[12 * L + i]
        trial = math.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
        held = trial if trial < most else most
        share = held / trial
        share = share if trial > 0.0 else 0.0
        s0, s1, s2 = s0 * share, s1 * share, s2 * share
        # what the force of now does
        work[7 * L + i] += 0.5 * kt * (s0 * ex + s1 * ey + s2 * ez - held * held)
        # the dashpot beside the spring, where the cone holds both
        slip = ex * ex + ey * ey + ez * ez
        left = work[33 * L + i] * normal - kt * held
        drag = drag if drag * drag * slip <= left * left else 0.0
        t0, t1, t2 = kt * s0 + drag * ex, kt * s1 + drag * ey, kt * s2 + drag * ez
        work[L + i], work[2 * L + i], work[3 * L + i] = normal * nx + t0, normal * ny + t1, normal * nz + t2
        work[4 * L + i], work[5 * L + i], work[6 * L + i] = ny * t2 - nz * t1, nz * t0 - nx * t2, nx * t1 - ny * t0
        work[8 * L + i] += drag * slip
        work[24 * L + i], work[25 * L + i], work[26 * L + i] = s0, s1, s2


@kernel
def _lanes():
    """Work of L contacts that gives no NaN wherever it is not filled; rows 38-41 are sums over what a lane has had."""
    work = np.zeros(42 * L)
    for i in range(L):
        work[i] = work[3 * L + i] = work[4 * L + i] = work[17 * L + i] = 1.0
        work[29 * L + i] = work[30 * L + i] = work[35 * L + i] = 1.0
    return work


@kernel
def _keep_sums(count, work):
    """Add work, and keep the largest stiffness and depth, of the first `count` lanes."""
    for i in range(count):
        work[38 * L + i] += work[7 * L + i]
        work[39 * L + i] += work[8 * L + i]
        work[40 * L + i] = max(work[40 * L + i], work[9 * L + i])
        work[41 * L + i] = max(work[41 * L + i], work[10 * L + i])


@kernel
def _total(work, out):
    """Bring the sums of all lanes to `out`; returns whether a contact is too deep."""
    deep = False
    for i in range(L):
        out[0] += work[38 * L + i]
        out[1] += work[39 * L + i]
        out[4] = max(out[4], work[40 * L + i])
        deep |= work[41 * L + i] > 0.0
    return deep


@kernel(inline=True)
def _record(k, i, work, record):
    """Write N and T of lane `i` to row `k`."""
    normal = work[i]
    record[k, 0] = normal
    for c in range(3):
        record[k, 1 + c] = work[(1 + c) * L + i] - normal * work[(14 + c) * L + i]


@kernel
def _pairs_done(count, first, second, row, work, dt, inverse_dt, memory, force, record):
    """Compute the pairs gathered in `work` and add their forces."""
    _pair_geometry(work)
    _law(work, dt, inverse_dt, DEEP)
    _keep_sums(count, work)
    for i in range(count):
        a, b, k = first[i], second[i], row[i]
        gx, gy, gz = work[L + i], work[2 * L + i], work[3 * L + i]
        mx, my, mz = work[4 * L + i], work[5 * L + i], work[6 * L + i]
        ai, aj = work[22 * L + i], work[23 * L + i]
        force[a, 0] -= gx
        force[a, 1] -= gy
        force[a, 2] -= gz
        force[a, 3] -= ai * mx
        force[a, 4] -= ai * my
        force[a, 5] -= ai * mz
        force[b, 0] += gx
        force[b, 1] += gy
        force[b, 2] += gz
        force[b, 3] -= aj * mx
        force[b, 4] -= aj * my
        force[b, 5] -= aj * mz
        for c in range(5):
            memory[k, c] = work[(24 + c) * L + i]
        if len(record) > 0:
            _record(k, i, work, record)


@kernel
def _deepest(place, start, partner):
    """1 + row of the pair whose overlap is the largest share of its smaller arm."""
    most, deepest = -np.inf, 0
    for a in range(len(start) - 1):
        for k in range(start[a], start[a + 1]):
            b = partner[k]
            square = 0.0
            for c in range(3):
                square += (place[b, c] - place[a, c]) ** 2
            half = 0.5 * (place[a, 3] + place[b, 3] - math.sqrt(square))
            share = half / (min(place[a, 3], place[b, 3]) - half)
            if not share <= most:
                most, deepest = share, k + 1
    return deepest


@kernel
def pair_forces(place, motion, start, partner, kind, table, memory_old, memory, dt, force, record, out):
    """Forces, history and work of all pairs of spheres (arguments: top of file)."""
    inverse_dt = 1.0 / dt if dt > 0.0 else 0.0
    work = _lanes()
    first, second, row = np.zeros(L, np.uint32), np.zeros(L, np.uint32), np.zeros(L, np.uint32)
    filled = np.full(L, -1, np.int64)  # row of the table that a lane holds already
    # unsigned, for an index that could count from the end costs a comparison
    count, one, full = np.uint64(0), np.uint64(1), np.uint64(L)
    touching, lost = 0, 0.0
    force[:, :] = 0.0
    out[3] = out[4] = 0.0
    for a in range(len(start) - 1):
        x, y, z, r = place[a, 0], place[a, 1], place[a, 2], place[a, 3]
        for k in range(start[a], start[a + 1]):
            b = partner[k]
            dx, dy, dz = place[b, 0] - x, place[b, 1] - y, place[b, 2] - z
            s = place[b, 3]
            if not dx * dx + dy * dy + dz * dz < (r + s) * (r + s):
                old = memory_old[k, 3]
                # what is open already is zero in both histories, and in the record
                if old != 0.0 or memory[k, 3] != 0.0:
                    s0, s1, s2 = memory_old[k, 0], memory_old[k, 1], memory_old[k, 2]
                    lost += 0.5 * table[kind[k], 1] * old * (s0 * s0 + s1 * s1 + s2 * s2)
                    memory[k, 0] = memory[k, 1] = memory[k, 2] = memory[k, 3] = memory[k, 4] = 0.0
                    if len(record) > 0:
                        record[k, 0] = record[k, 1] = record[k, 2] = record[k, 3] = 0.0
                continue
            work[count], work[count + full] = dx, dy
            work[count + np.uint64(2 * L)], work[count + np.uint64(3 * L)], work[count + np.uint64(4 * L)] = dz, r, s
            for c in range(3):
                work[count + np.uint64((5 + c) * L)] = motion[a, c] - motion[b, c]
                work[count + np.uint64((8 + c) * L)] = motion[a, 3 + c]
                work[count + np.uint64((11 + c) * L)] = motion[b, 3 + c]
            for c in range(5):
                work[count + np.uint64((24 + c) * L)] = memory_old[k, c]
            law = kind[k]
            if filled[count] != law:
                filled[count] = law
                for c in range(9):
                    work[count + np.uint64((29 + c) * L)] = table[law, c]
            first[count], second[count], row[count] = a, b, k
            count += one
            touching += 1
            if count == full:
                _pairs_done(L, first, second, row, work, dt, inverse_dt, memory, force, record)
                count = np.uint64(0)
    _pairs_done(np.int64(count), first, second, row, work, dt, inverse_dt, memory, force, record)
    out[0] += lost
    out[2] = touching
    if _total(work, out):
        out[3] = _deepest(place, start, partner)


@kernel
def face_forces(
    at, active, geometry, kind, table, memory_old, source, memory, dt, force, push, record, out
):  # fmt: skip
    """Forces, history and work of contacts between spheres and faces.

    ============  ==========  ==========================================================================
    at            (m,)        packed place of the sphere
    active        (m,) uint8  0: open, its row is skipped
    geometry      (m, 12)     normal from the sphere to the face, overlap [m], motion of the sphere against the face at
                              the contact [m] (4-6), rotation about the normal [rad], arm [m], not used here (9-11)
    kind, table               as for pairs
    memory_old    (m, 9)      committed history: s [m], r, z, normal (5-7), k_t
    source        (m,)        row of `memory_old` that a contact goes on from, -1: new
    memory        (m, 9)      out: trial history
    dt            float       [s]; 0: no dashpots
    force         (n, 6)      added to, as for pairs
    push          (m, 3)      out: force on the face [N], 0 for open rows
    record        (m, 4)      out: N and T [N], 0 for open rows
    out           (5,)        as for pairs; touching contacts are added to
    ============  ==========  ==========================================================================
    """
    inverse_dt = 1.0 / dt if dt > 0.0 else 0.0
    work, row, count = _lanes(), np.zeros(L, np.int64), 0
    work[23 * L : 24 * L] = np.inf
    n = len(at)
    for k in range(n + 1):
        if k < n:
            for c in range(3):
                push[k, c] = 0.0
            for c in range(4):
                record[k, c] = 0.0
            if not active[k]:
                for c in range(9):
                    memory[k, c] = 0.0
                continue
            for c in range(9):
                work[(14 + c) * L + count] = geometry[k, c]
            for c in range(5):
                work[(24 + c) * L + count] = memory_old[source[k], c] if source[k] >= 0 else 0.0
            for c in range(9):
                work[(29 + c) * L + count] = table[kind[k], c]
            row[count] = k
            count += 1
        if count == L or k == n:
            _law(work, dt, inverse_dt, 0.5)
            _keep_sums(count, work)
            for i in range(count):
                _face_done(i, row[i], at[row[i]], work, memory, force, push, record)
            out[2] += count
            count = 0
    if _total(work, out):
        for k in range(n):
            if active[k] and not geometry[k, 3] < geometry[k, 8]:
                out[3] = k + 1


@kernel(inline=True)
def _face_done(i, k, a, work, memory, force, push, record):
    """Add what lane `i` says of the contact in row `k`, of the sphere at packed place `a`."""
    gx, gy, gz = work[L + i], work[2 * L + i], work[3 * L + i]
    arm = work[22 * L + i]
    push[k, 0], push[k, 1], push[k, 2] = gx, gy, gz
    force[a, 0] -= gx
    force[a, 1] -= gy
    force[a, 2] -= gz
    force[a, 3] -= arm * work[4 * L + i]
    force[a, 4] -= arm * work[5 * L + i]
    force[a, 5] -= arm * work[6 * L + i]
    for c in range(5):
        memory[k, c] = work[(24 + c) * L + i]
    memory[k, 5], memory[k, 6], memory[k, 7] = work[14 * L + i], work[15 * L + i], work[16 * L + i]
    memory[k, 8] = work[30 * L + i]
    _record(k, i, work, record)


@kernel
def stored(overlap, kind, table, memory):
    """Energy [J] of springs, (m,) overlaps of closed contacts with history (m, 4 or more): normal, shear."""
    normal, shear = 0.0, 0.0
    for k in range(len(overlap)):
        root = memory[k, 3]
        if root > 0.0:
            row = kind[k]
            power = 0.4 if table[row, 5] > 0.0 else 0.5
            normal += power * table[row, 0] * root * overlap[k] * overlap[k]
            shear += 0.5 * table[row, 1] * root * (memory[k, 0] ** 2 + memory[k, 1] ** 2 + memory[k, 2] ** 2)
    return normal, shear


@kernel
def ball_accelerate(f, inverse, a):
    """Accelerations F / m and T / I of spheres; `inverse` (n, 2) is 1/m, 1/I; f, a (n, 6)."""
    for b in range(len(f)):
        m, i = inverse[b, 0], inverse[b, 1]
        a[b, 0], a[b, 1], a[b, 2] = m * f[b, 0], m * f[b, 1], m * f[b, 2]
        a[b, 3], a[b, 4], a[b, 5] = i * f[b, 3], i * f[b, 4], i * f[b, 5]


@kernel
def ball_kick(f, inverse, h, v):
    """Add the accelerations of `ball_accelerate` over `h` [s] to the velocities v (n, 6)."""
    for b in range(len(f)):
        m, i = inverse[b, 0], inverse[b, 1]
        v[b, 0] += h * (m * f[b, 0])
        v[b, 1] += h * (m * f[b, 1])
        v[b, 2] += h * (m * f[b, 2])
        v[b, 3] += h * (i * f[b, 3])
        v[b, 4] += h * (i * f[b, 4])
        v[b, 5] += h * (i * f[b, 5])


@kernel
def ball_pull(f_gp, f):
    """Add forces on the centres f_gp (n, 3) [N] to the generalised forces f (n, 6)."""
    for b in range(len(f)):
        f[b, 0] += f_gp[b, 0]
        f[b, 1] += f_gp[b, 1]
        f[b, 2] += f_gp[b, 2]


@kernel
def ball_advance(q, v, dt):
    """Move the centres q (n, 3) [m] by `dt` [s] with v (n, 6)."""
    for b in range(len(q)):
        q[b, 0] += dt * v[b, 0]
        q[b, 1] += dt * v[b, 1]
        q[b, 2] += dt * v[b, 2]


@kernel
def ball_turn(v, dt, turn):
    """Rotation vectors (n, 3) [rad] of a step `dt` [s] with v (n, 6)."""
    for b in range(len(turn)):
        turn[b, 0], turn[b, 1], turn[b, 2] = dt * v[b, 3], dt * v[b, 4], dt * v[b, 5]
