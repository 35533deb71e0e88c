"""Joint laws: one sweep per law over contact rows, all with the same signature.

A user's law is a kernel with this signature, in the user's own file:

    law(lo, hi, dt, gap, push, slip, normal, align, area, mass, prop, props, memory_old, memory, traction, work, state)

| argument | shape | unit | |
|---|---|---|---|
| lo, hi | int | - | rows to treat; rows with area 0 are open and must be left alone |
| dt | float | s | time since the last commit; 0 or less: no rates (static) |
| gap | (n,) | m | > 0 open, < 0 closed by the depth -gap |
| push | (n_patches, 3) | - | outward normal n_a of the slave face per *patch* (row // 3): p acts as -p n_a on it |
| slip | (n, 3) | m | motion of the slave relative to the master at the point since the last commit |
| normal | (n, 3) | - | unit normal of the friction frame; shear acts in the plane across it |
| align | (n,) | - | part of the pressure that counts for friction, 0 for side strips |
| area | (n,) | m2 | |
| mass | (n,) | kg/m2 | reduced mass per area, for damping as a fraction of critical |
| prop | (n_patches,) | - | row of `props` per patch (row // 3) |
| props | (n_props, k) | | columns 0 and 1 are kn and ks [Pa/m]; the rest is the law's business |
| memory_old | (n, m) | | history at the start of the step, already moved and rotated to this row; not to be written |
| memory | (n, m) | | at the end: 0-2 elastic slip [m], 3 intact flag, 4 slip distance [m], 5 dilation [m], free |
| traction | (n, 4) | Pa | out: pressure, and the shear traction on the slave (global axes) |
| work | (n, 2) | J | out: dissipated by friction (and breaking), by damping, in this step |
| state | (n,) int8 | - | out: 0 intact (bonded), 1 closed, 2 slipping, 3 open |

Columns of `props` for "coulomb": kn, ks, tan(friction), cohesion, tension, tan(dilation), dilation limit, tan(residual
friction), residual cohesion, damping fraction. For "bonded": kn, ks, tan(friction), shear strength, tension strength.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

OPEN, SLIPPING, CLOSED, INTACT = 3, 2, 1, 0


@kernel
def _in_plane(s0, s1, s2, nx, ny, nz):
    """Vector turned into the plane across (nx, ny, nz) at its length."""
    along = s0 * nx + s1 * ny + s2 * nz
    length = s0 * s0 + s1 * s1 + s2 * s2
    if along != 0.0:
        s0, s1, s2 = s0 - along * nx, s1 - along * ny, s2 - along * nz
        if along * along > 1e-24 * length:  # below, the length is the same to the last bits
            flat = s0 * s0 + s1 * s1 + s2 * s2
            if flat > 0.0:
                scale = math.sqrt(length / flat)
                s0, s1, s2 = s0 * scale, s1 * scale, s2 * scale
    return s0, s1, s2


@kernel
def _cone(cohesion, tan, pressure, facing):
    """Shear strength [Pa] under a pressure of which the part `facing` counts; side strips (0) have none."""
    return max(cohesion + tan * pressure * facing, 0.0) if facing > 0.0 else 0.0


@kernel
def _slide(s0, s1, s2, d0, d1, d2, most):
    """Elastic slip after the slip (d0, d1, d2), no longer than `most`; released length^2 and length slid.

    A cone that shrank releases energy first; then the slip of the step works against the cone.
    """
    released, plastic = 0.0, 0.0
    old = s0 * s0 + s1 * s1 + s2 * s2
    if old > most * most:
        released = old - most * most
        shrink = most / math.sqrt(old)
        s0, s1, s2 = s0 * shrink, s1 * shrink, s2 * shrink
    s0, s1, s2 = s0 + d0, s1 + d1, s2 + d2
    trial = s0 * s0 + s1 * s1 + s2 * s2
    if trial > most * most:
        trial = math.sqrt(trial)
        plastic = trial - most
        shrink = most / trial
        s0, s1, s2 = s0 * shrink, s1 * shrink, s2 * shrink
    return s0, s1, s2, released, plastic


@kernel
def coulomb(
    lo, hi, dt, gap, push, slip, normal, align, area, mass, prop, props, memory_old, memory, traction, work, state
):  # fmt: skip
    """Linear stiffness, friction cone, cohesion and tension until failure, dilation, damping (see top of file).

    The dashpot resists the rate of the depth, the motion along `normal`: sliding along the face closes nothing, however
    the slave's face is pitched. Its pressure counts for friction; both together do not pull.
    """
    last, kn, ks, peak, cohesion, tension, give = -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    residual, residual_cohesion, damping, dilation, dilation_limit = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(lo, hi):
        if area[i] == 0.0:
            state[i] = OPEN
            continue
        q = i // 3
        j = prop[q]
        if j != last:
            last = j
            kn, ks, peak, cohesion, tension = props[j, 0], props[j, 1], props[j, 2], props[j, 3], props[j, 4]
            dilation, dilation_limit = props[j, 5], props[j, 6]
            residual, residual_cohesion, damping = props[j, 7], props[j, 8], props[j, 9]
            give = 1.0 / ks if ks > 0.0 else 0.0
        a, facing = area[i], align[i]
        p = -kn * gap[i]
        s0, s1, s2 = memory_old[i, 0], memory_old[i, 1], memory_old[i, 2]
        intact = memory_old[i, 3] > 0.0
        memory[i, 3], memory[i, 4], memory[i, 5] = memory_old[i, 3], memory_old[i, 4], memory_old[i, 5]
        for k in range(6, memory.shape[1]):
            memory[i, k] = memory_old[i, k]
        work[i, 1] = 0.0
        if p < 0.0 and (not intact or p < -tension):
            # the rest of the elastic energy is lost with the contact
            work[i, 0] = 0.5 * a * ks * (s0 * s0 + s1 * s1 + s2 * s2)
            if intact:
                work[i, 0] += 0.5 * a * kn * gap[i] * gap[i]
            memory[i, 0], memory[i, 1], memory[i, 2], memory[i, 3] = 0.0, 0.0, 0.0, 0.0
            traction[i, 0], traction[i, 1], traction[i, 2], traction[i, 3] = 0.0, 0.0, 0.0, 0.0
            state[i] = OPEN
            continue
        work[i, 0] = 0.0
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        s0, s1, s2 = _in_plane(s0, s1, s2, nx, ny, nz)
        d0, d1, d2 = slip[i, 0], slip[i, 1], slip[i, 2]
        along = d0 * nx + d1 * ny + d2 * nz
        extra = 0.0
        if damping > 0.0 and dt > 0.0:
            extra = max(-2.0 * damping * math.sqrt(kn * mass[i]) * along / dt, min(p, 0.0) - p)
        e0, e1, e2 = d0 - along * nx, d1 - along * ny, d2 - along * nz
        state[i], limit = CLOSED, -1.0
        if intact:
            t0, t1, t2 = s0 + e0, s1 + e1, s2 + e2
            strength = _cone(cohesion, peak, p + extra, facing)
            if ks * ks * (t0 * t0 + t1 * t1 + t2 * t2) > strength * strength:
                memory[i, 3] = 0.0
                if p < 0.0:
                    p, extra = 0.0, max(p + extra, 0.0)
            else:
                limit = strength
                if cohesion > 0.0 or tension > 0.0:
                    state[i] = INTACT
        if limit < 0.0:
            limit = _cone(residual_cohesion, residual, p + extra, facing)
        if limit < math.inf:
            s0, s1, s2, released, plastic = _slide(s0, s1, s2, e0, e1, e2, limit * give)
            work[i, 0] = 0.5 * a * ks * released
            if plastic > 0.0:
                state[i] = SLIPPING
                widened = dilation * max(min(plastic, dilation_limit - memory[i, 4]), 0.0) if p > 0.0 else 0.0
                memory[i, 5] += widened
                work[i, 0] += a * (limit * plastic - p * widened)
                memory[i, 4] += plastic
        else:
            s0, s1, s2 = s0 + e0, s1 + e1, s2 + e2
        memory[i, 0], memory[i, 1], memory[i, 2] = s0, s1, s2
        if extra != 0.0:
            work[i, 1] = a * extra * (d0 * push[q, 0] + d1 * push[q, 1] + d2 * push[q, 2])
        traction[i, 0] = p + extra
        traction[i, 1], traction[i, 2], traction[i, 3] = -ks * s0, -ks * s1, -ks * s2


@kernel
def bonded(
    lo, hi, dt, gap, push, slip, normal, align, area, mass, prop, props, memory_old, memory, traction, work, state
):  # fmt: skip
    """Glued until the shear or tension strength is exceeded, then Coulomb friction (arguments: top of file)."""
    same = np.zeros((len(props), 10))  # a Coulomb joint with cohesion only, which leaves friction behind
    same[:, 0:2] = props[:, 0:2]
    same[:, 3:5] = props[:, 3:5]
    same[:, 7] = props[:, 2]
    coulomb(
        lo, hi, dt, gap, push, slip, normal, align, area, mass, prop, same, memory_old, memory, traction, work, state
    )  # fmt: skip


@kernel
def total_work(area, work, out):
    """Add the work of all rows [J] to `out` (2,): friction, damping."""
    friction, damping = 0.0, 0.0
    for i in range(len(area)):
        if area[i] > 0.0:
            friction += work[i, 0]
            damping += work[i, 1]
    out[0] += friction
    out[1] += damping
