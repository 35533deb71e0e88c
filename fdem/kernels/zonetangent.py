"""Stiffness of zones, added up in the upper half of a fixed pattern of 3x3 blocks."""

from __future__ import annotations

import numpy as np

from fdem._jit import kernel


@kernel
def fill(F, S, gradients, volume, lam, mu, place, turned, data):
    """Add ``K_ab = V ((g_a.S g_b) 1 + F D F^T)``, ``D = lam g_a g_b^T + mu (g_b g_a^T + g_a.g_b 1)`` for a <= b.

    | argument | shape | unit | |
    |---|---|---|---|
    | F, S | (m, 3, 3) | -, Pa | deformation, 2nd Piola-Kirchhoff stress |
    | gradients | (m, 9) | 1/m | of the shape functions of gridpoints 1-3 |
    | volume, lam, mu | (m,) | m3, Pa | |
    | place | (m, 10) | - | block of `data` for every pair of gridpoints, 00 01 02 03 11 12 ... |
    | turned | (m, 10) | - | whether that block is the transpose |
    | data | (n, 9) | N/m | added to |
    """
    G, FG, SG, B = np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3))
    for e in range(len(place)):
        for d in range(3):
            G[1, d], G[2, d], G[3, d] = gradients[e, d], gradients[e, 3 + d], gradients[e, 6 + d]
            G[0, d] = -G[1, d] - G[2, d] - G[3, d]
        for i in range(3):
            for j in range(3):
                B[i, j] = F[e, i, 0] * F[e, j, 0] + F[e, i, 1] * F[e, j, 1] + F[e, i, 2] * F[e, j, 2]
        for a in range(4):
            for i in range(3):
                FG[a, i] = F[e, i, 0] * G[a, 0] + F[e, i, 1] * G[a, 1] + F[e, i, 2] * G[a, 2]
                SG[a, i] = S[e, i, 0] * G[a, 0] + S[e, i, 1] * G[a, 1] + S[e, i, 2] * G[a, 2]
        v, vl, vm, k = volume[e], volume[e] * lam[e], volume[e] * mu[e], 0
        for a in range(4):
            for b in range(a, 4):
                p = place[e, k]
                initial = v * (G[a, 0] * SG[b, 0] + G[a, 1] * SG[b, 1] + G[a, 2] * SG[b, 2])
                dot = vm * (G[a, 0] * G[b, 0] + G[a, 1] * G[b, 1] + G[a, 2] * G[b, 2])
                for i in range(3):
                    for j in range(3):
                        value = vl * FG[a, i] * FG[b, j] + vm * FG[b, i] * FG[a, j] + dot * B[i, j]
                        if i == j:
                            value += initial
                        if turned[e, k]:
                            data[p, 3 * j + i] += value
                        else:
                            data[p, 3 * i + j] += value
                k += 1
