"""Bounds on the highest frequency from 3x3 stiffness blocks: coupling norms and their Perron bound."""

from __future__ import annotations

import math

from fdem._jit import kernel


@kernel
def coupling_blocks(nodes, edges, gradients, volume, lam, mu, diagonal, blocks):
    """Assemble the 3x3 blocks ``K_ij = sum V (lam G_i G_j^T + mu G_j G_i^T + mu G_i.G_j I)``.

    ==============  ==================  =========================================================
    nodes           (m, 4) int32        gridpoints of every zone
    edges           (m, 6) int32        rows of ``blocks`` of its edges 01 02 03 12 13 23
    gradients       (m, 9)              gradients of shape functions 1, 2, 3 [1/m]
    volume          (m,)                [m^3]
    lam, mu         (m,)                Lame constants [Pa]
    diagonal        (n, 9) in, out      K_ii [N/m], added to
    blocks          (n_edges, 9) in/out K_ij or its transpose (norms do not care) [N/m], added to
    ==============  ==================  =========================================================
    """
    for e in range(nodes.shape[0]):
        k = 0
        for a in range(4):
            for b in range(a, 4):
                if a == b:
                    row = diagonal[nodes[e, a]]
                else:
                    row = blocks[edges[e, k]]
                    k += 1
                # shape function 0 is 1 minus the others
                if a == 0:
                    p0 = -gradients[e, 0] - gradients[e, 3] - gradients[e, 6]
                    p1 = -gradients[e, 1] - gradients[e, 4] - gradients[e, 7]
                    p2 = -gradients[e, 2] - gradients[e, 5] - gradients[e, 8]
                else:
                    p0, p1, p2 = gradients[e, 3 * a - 3], gradients[e, 3 * a - 2], gradients[e, 3 * a - 1]
                if b == 0:
                    q0, q1, q2 = p0, p1, p2
                else:
                    q0, q1, q2 = gradients[e, 3 * b - 3], gradients[e, 3 * b - 2], gradients[e, 3 * b - 1]
                # one orientation for all zones of an edge: from the lower to the higher gridpoint
                if nodes[e, a] > nodes[e, b]:
                    p0, p1, p2, q0, q1, q2 = q0, q1, q2, p0, p1, p2
                x = volume[e] * lam[e]
                y = volume[e] * mu[e]
                dot = y * (p0 * q0 + p1 * q1 + p2 * q2)
                row[0] += (x + y) * p0 * q0 + dot
                row[1] += x * p0 * q1 + y * q0 * p1
                row[2] += x * p0 * q2 + y * q0 * p2
                row[3] += x * p1 * q0 + y * q1 * p0
                row[4] += (x + y) * p1 * q1 + dot
                row[5] += x * p1 * q2 + y * q1 * p2
                row[6] += x * p2 * q0 + y * q2 * p0
                row[7] += x * p2 * q1 + y * q2 * p1
                row[8] += (x + y) * p2 * q2 + dot


@kernel
def spectral_norms(blocks, norm):
    """Largest singular values of 3x3 blocks (n, 9), rounded up: invariant under any rotation.

    The largest eigenvalue of ``B^T B`` by the trigonometric formula (O. K. Smith, CACM 4 (1961) 168).
    """
    for k in range(blocks.shape[0]):
        b = blocks[k]
        s00 = b[0] * b[0] + b[3] * b[3] + b[6] * b[6]
        s11 = b[1] * b[1] + b[4] * b[4] + b[7] * b[7]
        s22 = b[2] * b[2] + b[5] * b[5] + b[8] * b[8]
        s01 = b[0] * b[1] + b[3] * b[4] + b[6] * b[7]
        s02 = b[0] * b[2] + b[3] * b[5] + b[6] * b[8]
        s12 = b[1] * b[2] + b[4] * b[5] + b[7] * b[8]
        mean = (s00 + s11 + s22) / 3.0
        d0, d1, d2 = s00 - mean, s11 - mean, s22 - mean
        square = (d0 * d0 + d1 * d1 + d2 * d2 + 2.0 * (s01 * s01 + s02 * s02 + s12 * s12)) / 6.0
        p = math.sqrt(square)
        largest = mean
        if p > 0.0:
            det = d0 * (d1 * d2 - s12 * s12) - s01 * (s01 * d2 - s12 * s02) + s02 * (s01 * s12 - d1 * s02)
            cosine = min(1.0, max(-1.0, 0.5 * det / (p * p * p)))
            largest = mean + 2.0 * p * math.cos(math.acos(cosine) / 3.0)
        norm[k] = math.sqrt(largest) * (1.0 + 1e-12)


@kernel
def perron_bounds(row_start, column, value, diagonal, mass, k_gp, gp_start, sweeps, z, work, bound, worst):
    """Upper bounds of the largest eigenvalue of ``M^-1 (K + K_contact)``, block by block.

    For any positive z, ``max_i sum_j N_ij z_j / (m_i z_i)`` with ``N_ij = |K_ij|_2`` (and k_gp on the
    diagonal) bounds it from above: block Gershgorin with the scaling z (Horn and Johnson, Matrix analysis,
    6.1 and 8.1). Power sweeps on z make it tighter; every sweep is a bound, the smallest is kept.

    ==============  ==================  =========================================================
    row_start       (n + 1,) int32      off-diagonal couplings of every gridpoint
    column, value   (nnz,)              their other gridpoint and norm [N/m]
    diagonal        (n,)                norm of K_ii [N/m]
    mass            (n,)                [kg]
    k_gp            (n,)                contact stiffness, row sum [N/m]
    gp_start        (n_blocks + 1,)     gridpoints of every block
    sweeps          int                 power sweeps
    z, work         (n,)                scratch
    bound           (n_blocks,) out     [1/s^2]
    worst           (n_blocks,) out     gridpoint that limits the block
    ==============  ==================  =========================================================
    """
    for k in range(gp_start.size - 1):
        lo, hi = gp_start[k], gp_start[k + 1]
        for i in range(lo, hi):
            z[i] = 1.0 / math.sqrt(mass[i])
        bound[k] = math.inf
        worst[k] = lo
        for _sweep in range(sweeps):
            highest = 0.0
            at = lo
            for i in range(lo, hi):
                total = (diagonal[i] + k_gp[i]) * z[i]
                for c in range(row_start[i], row_start[i + 1]):
                    total += value[c] * z[column[c]]
                work[i] = total / mass[i]
                if work[i] > highest * z[i]:
                    highest = work[i] / z[i]
                    at = i
            if highest < bound[k]:
                bound[k] = highest
                worst[k] = at
            for i in range(lo, hi):
                # the average keeps z positive and damps the oscillation of a plain power sweep
                z[i] = 0.5 * (z[i] + work[i] / highest)
