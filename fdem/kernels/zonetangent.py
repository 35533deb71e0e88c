"""Tangent of St. Venant-Kirchhoff zones, refilled into a fixed pattern of 3x3 blocks."""

from __future__ import annotations

import numpy as np

from fdem._jit import kernel


@kernel
def stvk_tangent(x, nodes, gradients, volume, lam, mu, stress0, place, data):
    """Add the stiffness of all zones to the 3x3 blocks of a matrix.

    ==============  ==================  =========================================================
    x               (n_gp, 3)           positions [m]
    nodes           (m, 4) int32        gridpoints
    gradients       (m, 9)              gradients of shape functions 1, 2, 3 [1/m]
    volume          (m,)                [m^3]
    lam, mu         (m,)                Lame constants [Pa]
    stress0         (m, 6) or (0, 6)    in-situ 2nd Piola-Kirchhoff stress [Pa], xx yy zz yz zx xy
    place           (m, 16) int64       block of every pair of corners (4 a + b)
    data            (n_blocks, 3, 3)    in, out: d internal force / d position [N/m]
    ==============  ==================  =========================================================

    ``K_ab = V (G_a.S G_b) I + V (lam (F G_a)(F G_b)^T + mu (F G_b)(F G_a)^T + mu (G_a.G_b) F F^T)``.
    """
    G, F, S, FG, SG, FF = (
        np.empty((4, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3)),
    )  # fmt: skip
    for e in range(len(nodes)):
        for d in range(3):
            G[1, d], G[2, d], G[3, d] = gradients[e, d], gradients[e, 3 + d], gradients[e, 6 + d]
            G[0, d] = -G[1, d] - G[2, d] - G[3, d]
        for i in range(3):
            for j in range(3):
                F[i, j] = 0.0
                for a in range(1, 4):
                    F[i, j] += (x[nodes[e, a], i] - x[nodes[e, 0], i]) * G[a, j]
        trace = -3.0
        for i in range(3):
            for j in range(3):
                trace += F[i, j] * F[i, j]
        for i in range(3):
            for j in range(3):
                c, b = 0.0, 0.0
                for k in range(3):
                    c += F[k, i] * F[k, j]
                    b += F[i, k] * F[j, k]
                FF[i, j] = b
                S[i, j] = mu[e] * c
            S[i, i] += 0.5 * lam[e] * trace - mu[e]
        if len(stress0):
            S[0, 0] += stress0[e, 0]
            S[1, 1] += stress0[e, 1]
            S[2, 2] += stress0[e, 2]
            S[1, 2] += stress0[e, 3]
            S[2, 1] += stress0[e, 3]
            S[0, 2] += stress0[e, 4]
            S[2, 0] += stress0[e, 4]
            S[0, 1] += stress0[e, 5]
            S[1, 0] += stress0[e, 5]
        for a in range(4):
            for i in range(3):
                FG[a, i] = F[i, 0] * G[a, 0] + F[i, 1] * G[a, 1] + F[i, 2] * G[a, 2]
                SG[a, i] = S[i, 0] * G[a, 0] + S[i, 1] * G[a, 1] + S[i, 2] * G[a, 2]
        v, vl, vm = volume[e], volume[e] * lam[e], volume[e] * mu[e]
        for a in range(4):
            for b in range(4):
                out = data[place[e, 4 * a + b]]
                initial = v * (G[a, 0] * SG[b, 0] + G[a, 1] * SG[b, 1] + G[a, 2] * SG[b, 2])
                dot = vm * (G[a, 0] * G[b, 0] + G[a, 1] * G[b, 1] + G[a, 2] * G[b, 2])
                for i in range(3):
                    for j in range(3):
                        out[i, j] += vl * FG[a, i] * FG[b, j] + vm * FG[b, i] * FG[a, j] + dot * FF[i, j]
                    out[i, i] += initial
