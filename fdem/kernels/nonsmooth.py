"""Contact dynamics: points of hard contact, and Gauss-Seidel on impulses with the exact Coulomb cone.

A point has a row of three velocities (normal, two tangents) of the slave against the master, ``u = J v``; its impulse
``r`` changes the velocities by ``B r`` with ``B = M^-1 J^T``. Both are stored by rows: entries ``start[i]`` to
``start[i + 1]`` of `dof`, `J` (n, 3) and `B` (n, 3) belong to point i. The law at a point (Jean, 1999; Acary and
Brogliato, 2008): ``0 <= u_n + b`` and ``r_n >= -T``, one of them zero; ``|r_t| <= mu r_n + C``, and
sliding where that is reached.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

PATIENCE = 40  # sweeps after which progress is looked at


@kernel
def corner_points(gp, start, corners, offset, keep, x, patch, weight, gap):
    """Corners of the patches in `keep` as contact points; of more than five, the four at the ends of the main axes.

    | argument | shape | unit | |
    |---|---|---|---|
    | patch, weight, gap | (n,), (n, 2), (n,) | -, -, m | out: patch of each point, weights on the slave face, gap |

    Returns
    -------
    int
        Number of points.
    """
    n = 0
    for i in range(len(gp)):
        if not keep[i]:
            continue
        p, q, r = gp[i, 3], gp[i, 4], gp[i, 5]
        normal = np.cross(x[q] - x[p], x[r] - x[p])
        normal /= math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        d = np.empty(3)
        for k in range(3):
            s = gp[i, k]
            d[k] = normal[0] * (x[p, 0] - x[s, 0]) + normal[1] * (x[p, 1] - x[s, 1]) + normal[2] * (x[p, 2] - x[s, 2])
            d[k] -= offset[i, k]
        lo, hi = start[i], start[i + 1]
        chosen = np.ones(hi - lo, np.uint8)
        if hi - lo > 5:
            chosen[:] = 0
            e1, e2 = x[gp[i, 1]] - x[gp[i, 0]], x[gp[i, 2]] - x[gp[i, 0]]
            a = math.sqrt(e1[0] ** 2 + e1[1] ** 2 + e1[2] ** 2)
            along = (e1[0] * e2[0] + e1[1] * e2[1] + e1[2] * e2[2]) / a
            across = math.sqrt(max(e2[0] ** 2 + e2[1] ** 2 + e2[2] ** 2 - along * along, 0.0))
            for axis in range(2):
                least, most, low, high = lo, lo, np.inf, -np.inf
                for k in range(lo, hi):
                    u, v = corners[k, 0] * a + corners[k, 1] * along, corners[k, 1] * across
                    value = u + v if axis == 0 else u - v
                    if value < low:
                        least, low = k, value
                    if value > high:
                        most, high = k, value
                chosen[least - lo], chosen[most - lo] = 1, 1
        for k in range(lo, hi):
            if chosen[k - lo]:
                w1, w2 = corners[k, 0], corners[k, 1]
                patch[n], weight[n, 0], weight[n, 1] = i, w1, w2
                gap[n] = -(d[0] * (1.0 - w1 - w2) + d[1] * w1 + d[2] * w2)
                n += 1
    return n


@kernel
def _local(W, f0, f1, f2, mu, tension, cohesion, out):
    """Impulse that one point needs: `f` is the velocity without it (the normal part with its bias), W (3, 3)."""
    n = max(-f0 / W[0, 0], -tension)
    if n <= -tension and f0 + W[0, 0] * n > 0.0 and tension == 0.0:
        out[0], out[1], out[2] = 0.0, 0.0, 0.0
        return
    # sticking: all three velocities vanish
    det = (
        W[0, 0] * (W[1, 1] * W[2, 2] - W[1, 2] * W[2, 1])
        - W[0, 1] * (W[1, 0] * W[2, 2] - W[1, 2] * W[2, 0])
        + W[0, 2] * (W[1, 0] * W[2, 1] - W[1, 1] * W[2, 0])
    )
    if det > 1e-12 * W[0, 0] * W[1, 1] * W[2, 2]:
        a0 = W[1, 1] * W[2, 2] - W[1, 2] * W[2, 1]
        a1 = W[0, 2] * W[2, 1] - W[0, 1] * W[2, 2]
        a2 = W[0, 1] * W[1, 2] - W[0, 2] * W[1, 1]
        b1 = W[0, 0] * W[2, 2] - W[0, 2] * W[2, 0]
        b0 = W[1, 2] * W[2, 0] - W[1, 0] * W[2, 2]
        b2 = W[0, 2] * W[1, 0] - W[0, 0] * W[1, 2]
        c0 = W[1, 0] * W[2, 1] - W[1, 1] * W[2, 0]
        c1 = W[0, 1] * W[2, 0] - W[0, 0] * W[2, 1]
        c2 = W[0, 0] * W[1, 1] - W[0, 1] * W[1, 0]
        r0 = -(a0 * f0 + a1 * f1 + a2 * f2) / det
        r1 = -(b0 * f0 + b1 * f1 + b2 * f2) / det
        r2 = -(c0 * f0 + c1 * f1 + c2 * f2) / det
        limit = mu * r0 + cohesion
        if r0 >= -tension and limit >= 0.0 and r1 * r1 + r2 * r2 <= limit * limit:
            out[0], out[1], out[2] = r0, r1, r2
            return
    # sliding: the tangential impulse is -limit times the direction of sliding, found by projection
    r0, r1, r2 = max(n, 0.0) if mu > 0.0 else n, out[1], out[2]
    rho = 1.0 / max(W[1, 1], W[2, 2])
    for _ in range(25):
        limit = max(mu * r0 + cohesion, 0.0)
        s1 = r1 - rho * (f1 + W[1, 0] * r0 + W[1, 1] * r1 + W[1, 2] * r2)
        s2 = r2 - rho * (f2 + W[2, 0] * r0 + W[2, 1] * r1 + W[2, 2] * r2)
        length = math.sqrt(s1 * s1 + s2 * s2)
        if length > limit:
            s1, s2 = s1 * limit / length, s2 * limit / length
        s0 = max(-(f0 + W[0, 1] * s1 + W[0, 2] * s2) / W[0, 0], -tension)
        change = abs(s0 - r0) + abs(s1 - r1) + abs(s2 - r2)
        r0, r1, r2 = s0, s1, s2
        if change <= 1e-12 * (abs(r0) + limit):
            break
    out[0], out[1], out[2] = r0, r1, r2


@kernel
def _visit(i, start, dof, J, bstart, bdof, B, W, bias, mu, tension, cohesion, relax, v, r, new):
    """Solve point i for its impulse with all others held; returns the square of the change of its impulse."""
    u0, u1, u2 = 0.0, 0.0, 0.0
    for k in range(start[i], start[i + 1]):
        s = v[dof[k]]
        u0, u1, u2 = u0 + J[k, 0] * s, u1 + J[k, 1] * s, u2 + J[k, 2] * s
    w = W[i]
    f0 = u0 - (w[0, 0] * r[i, 0] + w[0, 1] * r[i, 1] + w[0, 2] * r[i, 2]) + bias[i]
    f1 = u1 - (w[1, 0] * r[i, 0] + w[1, 1] * r[i, 1] + w[1, 2] * r[i, 2])
    f2 = u2 - (w[2, 0] * r[i, 0] + w[2, 1] * r[i, 1] + w[2, 2] * r[i, 2])
    new[0], new[1], new[2] = r[i, 0], r[i, 1], r[i, 2]
    _local(w, f0, f1, f2, mu[i], tension[i], cohesion[i], new)
    d0, d1, d2 = relax * (new[0] - r[i, 0]), relax * (new[1] - r[i, 1]), relax * (new[2] - r[i, 2])
    if d0 != 0.0 or d1 != 0.0 or d2 != 0.0:
        for k in range(bstart[i], bstart[i + 1]):
            v[bdof[k]] += B[k, 0] * d0 + B[k, 1] * d1 + B[k, 2] * d2
        r[i, 0], r[i, 1], r[i, 2] = r[i, 0] + d0, r[i, 1] + d1, r[i, 2] + d2
    return d0 * d0 + d1 * d1 + d2 * d2


@kernel
def gauss_seidel(start, dof, J, bstart, bdof, B, W, bias, mu, tension, cohesion, v, r, tolerance, most):
    """Sweep over the points until no impulse changes by more than `tolerance` of the mean one.

    | argument | shape | unit | |
    |---|---|---|---|
    | W | (n, 3, 3) | 1/kg | ``J_i B_i`` |
    | bias | (n,) | m/s | added to the normal velocity: gap over step, restitution |
    | mu, tension, cohesion | (n,) | -, N s, N s | |
    | v, r | (n_dofs,), (n, 3) | m/s, N s | in, out: velocities with the impulses `r` applied |

    Returns
    -------
    sweeps : int
    error : float
        Root mean square of the changes in the last sweep over the mean normal impulse.
    """
    new, n = np.zeros(3), len(bias)
    error, sweep, relax, before = np.inf, 0, 1.0, np.inf
    while sweep < most:
        total = 0.0
        for k in range(n):
            i = k
            total += _visit(i, start, dof, J, bstart, bdof, B, W, bias, mu, tension, cohesion, relax, v, r, new)
        sweep += 1
        mean, count = 0.0, 0
        for i in range(n):
            if r[i, 0] > 0.0:
                mean += r[i, 0]
                count += 1
        if count == 0:
            return sweep, 0.0
        error = math.sqrt(total / count) * count / (mean * relax)
        if error <= tolerance:
            break
        if sweep % PATIENCE == 0:
            # impulses that go round in circles are changed by less, those that come down by more
            relax = max(0.7 * relax, 0.05) if error > 0.9999 * before else min(1.2 * relax, 1.0)
            before = error
    return sweep, error
