"""What joint laws answer to small changes: derivatives of traction by depth and slip, for implicit steps.

One kernel per law, named after it, with the arguments of the law's sweep (kernels/joints.py) that it needs:

    law(lo, hi, dt, gap, slip, normal, align, area, mass, prop, props, memory_old, memory, traction, state, response)

`response` (n, 4, 4) [Pa/m] gets the derivatives of (pressure, shear traction), rows, by (depth, slip),
columns.
"""

from __future__ import annotations

import math

from fdem._jit import kernel

OPEN, SLIPPING, CLOSED, INTACT = 3, 2, 1, 0


@kernel
def coulomb(
    lo, hi, dt, gap, slip, normal, align, area, mass, prop, props, memory_old, memory, traction, state, response
):  # fmt: skip
    """Linear springs; on the friction cone the part along the slip follows the pressure, the part across it turns."""
    for i in range(lo, hi):
        for j in range(4):
            for k in range(4):
                response[i, j, k] = 0.0
        if area[i] == 0.0 or state[i] == OPEN:
            continue
        row = prop[i // 3]
        kn, ks = props[row, 0], props[row, 1]
        response[i, 0, 0] = kn if gap[i] < 0.0 or state[i] != SLIPPING else 0.0
        damping = props[row, 9]
        if damping > 0.0 and dt > 0.0 and traction[i, 0] + kn * gap[i] != 0.0:
            rate = 2.0 * damping * math.sqrt(kn * mass[i]) / dt
            for k in range(3):
                response[i, 0, 1 + k] = -rate * normal[i, k]
        if ks == 0.0:
            continue
        t0, t1, t2 = traction[i, 1], traction[i, 2], traction[i, 3]
        strength = math.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
        if state[i] != SLIPPING:
            for j in range(3):
                for k in range(3):
                    response[i, 1 + j, 1 + k] = -ks * ((1.0 if j == k else 0.0) - normal[i, j] * normal[i, k])
            continue
        # elastic slip the springs would have had: what is left of it lies on the cone
        slid = memory[i, 4] - memory_old[i, 4]
        trial = strength / ks + slid
        tan = props[row, 7] * align[i]
        for j in range(3):
            along = traction[i, 1 + j] / strength if strength > 0.0 else 0.0
            response[i, 1 + j, 0] = tan * along * response[i, 0, 0]
            for k in range(3):
                across = traction[i, 1 + k] / strength if strength > 0.0 else 0.0
                plane = (1.0 if j == k else 0.0) - normal[i, j] * normal[i, k] - along * across
                response[i, 1 + j, 1 + k] = -(strength / trial) * plane if trial > 0.0 else 0.0
                response[i, 1 + j, 1 + k] += tan * along * response[i, 0, 1 + k]
