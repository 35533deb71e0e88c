"""Impulses at points of hard contact: relative velocities, the law as projections, matrices of Newton's method.

A point has a row of three velocities (normal, two tangents) of the slave against the master, ``u = J v + b n``; rows
are stored entry by entry: `dof` and `J` (entries, 3) from ``start[i]`` to ``start[i + 1]`` belong to point i. The law
(Jean, 1999; Acary and Brogliato, 2008): ``0 <= u_n`` and ``r_n >= -T``, one of them zero; ``|r_t| <= mu r_n + C``, and
sliding against r_t where that is reached. With any factor rho > 0 it is ``r = P(r - rho u)`` (Alart and Curnier,
Comput. Methods Appl. Mech. Engrg. 92 (1991) 353).
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel


@kernel
def _add_entry(j, a0, a1, a2, first, at, most, dof, J):
    """Add to the entry of unknown j among those from `first` on, or make it; returns the number of entries."""
    place = first
    while place < min(at, most) and dof[place] != j:
        place += 1
    if place >= most:
        return at + 1
    if place == at:
        dof[place], at = j, at + 1
        J[place, 0], J[place, 1], J[place, 2] = 0.0, 0.0, 0.0
    J[place, 0] += a0
    J[place, 1] += a1
    J[place, 2] += a2
    return at


@kernel
def point_rows(gp, w, frame, spin, arm, pstart, pdof, pvalue, most, start, dof, J):
    """Rows of the relative velocity of contact points over the unknowns.

    | argument | shape | unit | |
    |---|---|---|---|
    | gp, w | (n, k) | - | gridpoints and weights: + slave, - master |
    | frame | (n, 3, 3) | - | rows: normal, two tangents |
    | spin, arm | (n, 2), (n, 2, 3) | -, m | first rotational velocity (-1: none), way from gridpoint to contact |
    | pstart, pdof, pvalue | CSR | -, -, -, m | ``P`` (3 n_gp, n_dofs) of ``xdot = P v`` |
    | most | int | - | room in the arrays to fill: entries |
    | start, dof, J | (n + 1,), (most,), (most, 3) | -, -, m | out |

    Returns
    -------
    int
        Room needed; more than `most`: the rows are not complete, call again with more.
    """
    at = 0
    for i in range(len(gp)):
        start[i] = at
        for k in range(gp.shape[1]):
            g = gp[i, k]
            if w[i, k] == 0.0:
                continue
            for d in range(3):
                f0, f1, f2 = frame[i, 0, d], frame[i, 1, d], frame[i, 2, d]
                for entry in range(pstart[3 * g + d], pstart[3 * g + d + 1]):
                    c = w[i, k] * pvalue[entry]
                    at = _add_entry(pdof[entry], c * f0, c * f1, c * f2, start[i], at, most, dof, J)
        for side in range(2):
            if spin[i, side] < 0:
                continue
            sign = 1.0 if side == 0 else -1.0
            for d in range(3):
                # of omega x arm along a row of the frame: omega . (arm x row)
                e, f = (d + 1) % 3, (d + 2) % 3
                ye, yf = sign * arm[i, side, e], sign * arm[i, side, f]
                at = _add_entry(
                    spin[i, side] + d, ye * frame[i, 0, f] - yf * frame[i, 0, e],
                    ye * frame[i, 1, f] - yf * frame[i, 1, e], ye * frame[i, 2, f] - yf * frame[i, 2, e],
                    start[i], at, most, dof, J,
                )  # fmt: skip
    start[len(gp)] = at
    return at


@kernel
def velocities(start, dof, J, v, bias, u):
    """Relative velocities ``u = J v`` (n, 3), `bias` (n,) added to the normal part [m/s]."""
    for i in range(len(bias)):
        u0, u1, u2 = bias[i], 0.0, 0.0
        for k in range(start[i], start[i + 1]):
            speed = v[dof[k]]
            u0 += J[k, 0] * speed
            u1 += J[k, 1] * speed
            u2 += J[k, 2] * speed
        u[i, 0], u[i, 1], u[i, 2] = u0, u1, u2


@kernel
def add_impulses(start, dof, J, r, f):
    """Add ``J^T r`` to `f` (n_dofs,) [N s, N m s]."""
    for i in range(len(r)):
        for k in range(start[i], start[i + 1]):
            f[dof[k]] += J[k, 0] * r[i, 0] + J[k, 1] * r[i, 1] + J[k, 2] * r[i, 2]


@kernel
def effective_masses(start, dof, J, diagonal, rho):
    """Masses (n,) that contact points seem to have: 3 over the trace of ``J D^-1 J^T``, D the `diagonal` [kg]."""
    for i in range(len(rho)):
        total = 0.0
        for k in range(start[i], start[i + 1]):
            total += (J[k, 0] ** 2 + J[k, 1] ** 2 + J[k, 2] ** 2) / diagonal[dof[k]]
        rho[i] = 3.0 / total if total > 0.0 else 0.0


@kernel
def own_mobility(start, dof, J, bstart, bdof, B, n_dofs, W):
    """``W_i = J_i B_i`` (n, 3, 3) of every point [1/kg]; `B` are the rows of ``A^-1 J^T``."""
    kept = np.zeros((n_dofs, 3))
    for i in range(len(W)):
        for k in range(bstart[i], bstart[i + 1]):
            for b in range(3):
                kept[bdof[k], b] = B[k, b]
        for a in range(3):
            for b in range(3):
                total = 0.0
                for k in range(start[i], start[i + 1]):
                    total += J[k, a] * kept[dof[k], b]
                W[i, a, b] = total
        for k in range(bstart[i], bstart[i + 1]):
            for b in range(3):
                kept[bdof[k], b] = 0.0


@kernel
def project(z, mu, tension, cohesion, r, slope):
    """Impulses `r` (n, 3) from ``z = r - rho u`` by the law, and d r / d z in `slope` (n, 3, 3); not symmetric.

    Normal: ``max(z_n, -T)``; tangential: onto the disc of radius ``mu r_n + C``.
    """
    for i in range(len(z)):
        for a in range(3):
            for b in range(3):
                slope[i, a, b] = 0.0
        pressed = 1.0 if z[i, 0] > -tension[i] else 0.0
        r[i, 0] = max(z[i, 0], -tension[i])
        slope[i, 0, 0] = pressed
        limit = max(mu[i] * r[i, 0] + cohesion[i], 0.0)
        length = math.sqrt(z[i, 1] ** 2 + z[i, 2] ** 2)
        if limit == 0.0:
            r[i, 1], r[i, 2] = 0.0, 0.0
            continue
        if length <= limit:
            r[i, 1], r[i, 2] = z[i, 1], z[i, 2]
            slope[i, 1, 1], slope[i, 2, 2] = 1.0, 1.0
            continue
        t1, t2 = z[i, 1] / length, z[i, 2] / length
        r[i, 1], r[i, 2] = limit * t1, limit * t2
        share, grows = limit / length, pressed * mu[i]
        slope[i, 1, 0], slope[i, 2, 0] = grows * t1, grows * t2
        slope[i, 1, 1], slope[i, 2, 2] = share * (1.0 - t1 * t1), share * (1.0 - t2 * t2)
        slope[i, 1, 2] = slope[i, 2, 1] = -share * t1 * t2


@kernel
def project_cone(z, mu, r, slope):
    """Impulses `r` (n, 3): the nearest in the cone ``|r_t| <= mu r_n``, and d r / d z in `slope` (n, 3, 3); symmetric.

    With ``mu |u_t|`` added to the normal velocity it is the same law (De Saxce and Feng, Math. Comput. Modelling 28
    (1998) 225), and with that term kept as it was, the conditions of a convex problem.
    """
    for i in range(len(z)):
        n, m = z[i, 0], mu[i]
        length = math.sqrt(z[i, 1] ** 2 + z[i, 2] ** 2)
        for a in range(3):
            r[i, a] = 0.0
            for b in range(3):
                slope[i, a, b] = 0.0
        if m * length <= -n:
            continue
        if length <= m * n:
            for a in range(3):
                r[i, a] = z[i, a]
                slope[i, a, a] = 1.0 if a == 0 or m > 0.0 else 0.0
            continue
        share = 1.0 / (1.0 + m * m)
        t1, t2 = z[i, 1] / length, z[i, 2] / length
        along = (n + m * length) * share
        r[i, 0], r[i, 1], r[i, 2] = along, m * along * t1, m * along * t2
        g1, g2, bend = m * t1, m * t2, m * along / length
        slope[i, 0, 0] = share
        slope[i, 0, 1] = slope[i, 1, 0] = share * g1
        slope[i, 0, 2] = slope[i, 2, 0] = share * g2
        slope[i, 1, 1] = share * g1 * g1 + bend * (1.0 - t1 * t1)
        slope[i, 2, 2] = share * g2 * g2 + bend * (1.0 - t2 * t2)
        slope[i, 1, 2] = slope[i, 2, 1] = share * g1 * g2 - bend * t1 * t2


@kernel
def natural_residual(u, mu, tension, cohesion, rho, r):
    """How far impulses are from the law.

    Returns
    -------
    worst, speed : float
        Largest ``|r - P(r - rho u)|`` [N s], and largest such error over rho [m/s].
    where : int
        Point of the largest speed.
    mean : float
        Mean normal impulse of the points that have one [N s].
    """
    worst, speed, where, mean, count = 0.0, 0.0, 0, 0.0, 0
    for i in range(len(u)):
        n = max(r[i, 0] - rho[i] * u[i, 0], -tension[i])
        t1, t2 = r[i, 1] - rho[i] * u[i, 1], r[i, 2] - rho[i] * u[i, 2]
        limit = max(mu[i] * n + cohesion[i], 0.0)
        length = math.sqrt(t1 * t1 + t2 * t2)
        if length > limit:
            t1, t2 = t1 * limit / length, t2 * limit / length
        error = math.sqrt((r[i, 0] - n) ** 2 + (r[i, 1] - t1) ** 2 + (r[i, 2] - t2) ** 2)
        worst = max(worst, error)
        if not error <= speed * rho[i]:
            speed, where = error / rho[i], i
        if r[i, 0] != 0.0:
            mean += abs(r[i, 0])
            count += 1
    return worst, speed, where, mean / count if count else 0.0


@kernel
def add_matrices(start, dof, J, slope, rho, indptr, indices, data):
    """Add ``J^T (rho slope) J`` of all points to a CSC matrix that has room for it.

    Points that follow each other with the same unknowns, those of a pair of blocks, are summed up first.
    """
    n, first, widest = len(rho), 0, 0
    for i in range(n):
        widest = max(widest, start[i + 1] - start[i])
    local = np.empty((widest, widest))
    while first < n:
        lo, k = start[first], start[first + 1] - start[first]
        last = first
        while last < n and start[last + 1] - start[last] == k:
            same = True
            for a in range(k):
                if dof[start[last] + a] != dof[lo + a]:
                    same = False
                    break
            if not same:
                break
            last += 1
        local[:k, :k] = 0.0
        for i in range(first, last):
            at = start[i]
            for b in range(k):
                j0, j1, j2 = rho[i] * J[at + b, 0], rho[i] * J[at + b, 1], rho[i] * J[at + b, 2]
                s0 = slope[i, 0, 0] * j0 + slope[i, 0, 1] * j1 + slope[i, 0, 2] * j2
                s1 = slope[i, 1, 0] * j0 + slope[i, 1, 1] * j1 + slope[i, 1, 2] * j2
                s2 = slope[i, 2, 0] * j0 + slope[i, 2, 1] * j1 + slope[i, 2, 2] * j2
                if s0 == 0.0 and s1 == 0.0 and s2 == 0.0:
                    continue
                for a in range(k):
                    local[a, b] += J[at + a, 0] * s0 + J[at + a, 1] * s1 + J[at + a, 2] * s2
        for b in range(k):
            low, high = indptr[dof[lo + b]], indptr[dof[lo + b] + 1]
            for a in range(k):
                if local[a, b] != 0.0:
                    data[low + np.searchsorted(indices[low:high], dof[lo + a])] += local[a, b]
        first = last
