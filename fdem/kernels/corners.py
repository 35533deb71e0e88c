"""Stiff corners: an energy for contacts smaller than a given area, so that corners and edges do not sink.

With the depth d over the closed part of a pair, ``Q1 = sum a d`` and ``Q2 = sum a d^2``, the mean depth is
``delta = Q2 / Q1`` and the size of the contact ``A = Q1^2 / Q2`` (its area, if a face is closed evenly). The energy

    U = 1/2 kn A_c delta^2 / (1 + s^2),   s = A / A_c

adds the stiffness of a face of the area A_c to contacts much smaller than that, and (A_c / A)^3 of the stiffness of
larger ones. The three points of a patch integrate Q1 and Q2 exactly, d is continuous from cell to cell and zero where
contact ends: so U is smooth however a block tilts, and its gradient, ``(dU/dQ1 + 2 d dU/dQ2) a`` along the normal of
the master face, is a force that conserves energy and momentum.
"""

from __future__ import annotations

import math

from fdem._jit import kernel

ROUND_OFF = 1e-6  # of a row's size: gap of a closed point that lies where the depth is zero; more is a bond in tension


@kernel
def corner_energy(pair, active, gap, area, align, kn, corner, sums, slopes, factor, energy):
    """Energy of stiff corners and its derivatives.

    | argument | shape | unit | |
    |---|---|---|---|
    | pair, active | (n_patches,) | - | |
    | gap, area, align | (3 n_patches,) | m, m2, - | rows of the contact table |
    | kn, corner | (n_pairs,) | Pa/m, m2 | stiffness, and area A_c; 0: no stiff corners |
    | sums | (n_pairs, 4) | m2, m3, m4, m3 | scratch: closed area, Q1, Q2, the part of Q1 that counts for friction |
    | slopes | (n_pairs, 2) | N/m3, N/m4 | out: dU/dQ1, 2 dU/dQ2 |
    | factor | (n_pairs,) | - | out: normal force over that of the joint law alone |
    | energy | (n_pairs,) | J | out: U |
    """
    for k in range(len(corner)):
        sums[k, 0], sums[k, 1], sums[k, 2], sums[k, 3] = 0.0, 0.0, 0.0, 0.0
        slopes[k, 0], slopes[k, 1], factor[k], energy[k] = 0.0, 0.0, 1.0, 0.0
    for i in range(len(pair)):
        k = pair[i]
        if active[i] == 0 or corner[k] == 0.0:
            continue
        for row in range(3 * i, 3 * i + 3):
            if gap[row] <= ROUND_OFF * math.sqrt(area[row]):
                depth = max(-gap[row], 0.0)  # depths of either sign, all round-off, would leave sums of noise
                sums[k, 0] += area[row]
                sums[k, 1] += area[row] * depth
                sums[k, 2] += area[row] * depth * depth
                sums[k, 3] += area[row] * depth * align[row]
    for k in range(len(corner)):
        if not sums[k, 2] > 0.0:
            continue
        closed, q1, q2 = sums[k, 0], sums[k, 1], sums[k, 2]
        delta, s = q2 / q1, q1 * q1 / (q2 * corner[k])
        share = 1.0 / (1.0 + s * s)
        bend = -2.0 * s * s * share * share  # s d share / d s
        stiff = kn[k] * corner[k]
        slopes[k, 0] = stiff * delta * delta / q1 * (bend - share)
        slopes[k, 1] = stiff * delta / q1 * (2.0 * share - bend)
        energy[k] = 0.5 * stiff * delta * delta * share
        if sums[k, 3] > 0.0:
            factor[k] = max(1.0 + (slopes[k, 0] * closed + slopes[k, 1] * q1) / (kn[k] * sums[k, 3]), 0.0)


@kernel
def corner_tractions(pair, active, gap, area, face_normal, kn, slopes, factor, ks, memory, traction, work, energy):
    """Add the tractions ``(dU/dQ1 + 2 d dU/dQ2) n_f`` [Pa] on the slave to those of the joint laws (3 n_patches, 4).

    Shear stiffness and strength grow with the normal force: the law's shear traction, its work and the energy of the
    elastic slip (`memory`, `ks` (n_patches,)) are multiplied by `factor`.
    """
    for i in range(len(pair)):
        k = pair[i]
        if active[i] == 0 or slopes[k, 1] == 0.0:
            continue
        for row in range(3 * i, 3 * i + 3):
            if gap[row] <= ROUND_OFF * math.sqrt(area[row]):
                t = slopes[k, 0] - slopes[k, 1] * gap[row]
                p, held = -kn[k] * gap[row], factor[k]
                if traction[row, 0] > p > 0.0:  # what a dashpot adds to the pressure counts once
                    held = (factor[k] * p + traction[row, 0] - p) / traction[row, 0]
                slip = 0.0
                for d in range(3):
                    traction[row, 1 + d] = held * traction[row, 1 + d] + t * face_normal[i, d]
                    slip += memory[row, d] ** 2
                work[row, 0] *= held
                energy[k] += 0.5 * (held - 1.0) * ks[i] * area[row] * slip


@kernel
def carry_slip(pair, active, before, factor, memory):
    """Let elastic slip (3 n_patches, 3+) keep its energy while `factor` (n_pairs,) goes on from `before`."""
    for i in range(len(pair)):
        k = pair[i]
        if active[i] == 0 or before[k] == factor[k]:
            continue
        share = math.sqrt(before[k] / factor[k]) if factor[k] > 0.0 else 0.0
        for row in range(3 * i, 3 * i + 3):
            for d in range(3):
                memory[row, d] *= share
