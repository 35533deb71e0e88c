"""Joint laws: one sweep per law over contact rows, all with the same signature.

A user's law is a kernel with this signature, in the user's own file (see `fdem.Joint`):

    law(lo, hi, dt, gap, push, slip, normal, align, area, mass, arm, prop, props, memory_old, memory, traction, work,
        state)

| argument | shape | unit | |
|---|---|---|---|
| lo, hi | int | - | rows to treat; rows with area 0 are open and must be left alone, but for their state |
| dt | float | s | time since the last commit; 0 or less: no rates (static) |
| gap | (n,) | m | > 0 open, < 0 closed by the depth -gap |
| push | (n_patches, 3) | - | outward normal n_a of the slave face per *patch* (row // 3): p acts as -p n_a on it |
| slip | (n, 3) | m | motion of the slave relative to the master at the point since the last commit |
| normal | (n, 3) | - | unit normal of the friction frame; shear acts in the plane across it |
| align | (n,) | - | part of the pressure that counts for friction, 0 for side strips |
| area | (n,) | m2 | |
| mass | (n,) | kg/m2 | reduced mass per area, for damping as a fraction of critical (laws that need "damping") |
| arm | (n, 3) | m | from the middle of the patch's three points to the point (laws that need "arms", else no rows) |
| prop | (n_patches,) | - | row of `props` per patch (row // 3) |
| props | (n_props, k) | | columns 0 and 1 are kn and ks [Pa/m]; the rest is the law's business |
| memory_old | (n, m) | | history at the start of the step, already moved and rotated to this row; not to be written |
| memory | (n, m) | | at the end: 0-2 elastic slip [m], 3 bond, 4 slip distance, 5 dilation [m], then the law's own |
| traction | (n, 4) | Pa | out: pressure, and the shear traction on the slave (global axes) |
| work | (n, 2) | J | out: dissipated by friction (and breaking), by damping, in this step |
| state | (n,) int8 | - | out: 0 intact (bonded), 1 closed, 2 slipping, 3 open |

Memory 3 is 1 where the faces touched at compile and nothing has failed, 0 where there is nothing to fail (any more),
-1 or -2 where a bond failed in tension or in shear. When points move, columns 0-2, 4 and 5 are linear fields of the
three old points; the others come from the nearest of them.

A law whose normal response is not ``p = kn depth``, or which stores energy beyond closure and slip, brings a second
kernel over rows, which must not depend on anything else:

    closure(lo, hi, gap, prop, props, memory, out)

`out` (n, 4): pressure [Pa], tangent stiffness [Pa/m], energy of closure [J/m2], other energy but that of slip [J].

| law | columns of `props` |
|---|---|
| coulomb | kn, ks, tan(friction), cohesion, tension, tan(dilation), dilation limit, tan(residual friction), residual \
cohesion, damping fraction |
| coulomb_moments | those of "coulomb", rolling length, twisting length [m] |
| bonded | kn, ks, tan(friction), shear strength, tension strength |
| barton_bandis | kn, ks, largest closure [m], JRC, JCS, residual friction [deg], peak displacement [m], 1 / damage, \
damping fraction |
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

OPEN, SLIPPING, CLOSED, INTACT = 3, 2, 1, 0
SQRT2, HALF3 = math.sqrt(2.0), math.sqrt(0.75)
STEEPEST = 70.0  # [deg] of Barton's total friction angle: its logarithm has no bound towards zero stress (Barton 1976)


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
def _part(i, energy, bond, memory, traction, work, state):
    """Row i opens: it forgets its slip, carries nothing, and `energy` [J] is gone."""
    memory[i, 0], memory[i, 1], memory[i, 2], memory[i, 3] = 0.0, 0.0, 0.0, bond
    traction[i, 0], traction[i, 1], traction[i, 2], traction[i, 3] = 0.0, 0.0, 0.0, 0.0
    work[i, 0] = energy
    state[i] = OPEN


@kernel
def _mean_pressure(q, kn, gap, memory):
    """Mean elastic pressure of patch q: it works on the lift of a point, as a patch is lifted by the mean of three."""
    total = 0.0
    for r in range(3 * q, 3 * q + 3):
        if gap[r] < 0.0 or memory[r, 3] > 0.0:
            total -= kn * gap[r]
    return total / 3.0


@kernel
def coulomb(
    lo, hi, dt, gap, push, slip, normal, align, area, mass, arm, prop, props, memory_old, memory, traction, work, state
):  # fmt: skip
    """Linear stiffness, friction cone, cohesion and tension until failure, dilation, damping (see top of file).

    The dashpot resists the rate of the depth, the motion along `normal`: sliding along the face closes nothing, however
    the slave's face is pitched. Its pressure counts for friction; both together do not pull. Contacts formed after
    compile have residual strength: their faces do not match.
    """
    last, kn, ks, peak, cohesion, tension, give = -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    residual, residual_cohesion, damping, dilation, widest, torn, sheared = 7 * (0.0,)
    for i in range(lo, hi):
        if area[i] == 0.0:
            state[i] = OPEN
            continue
        q = i // 3
        j = prop[q]
        if j != last:
            last = j
            kn, ks, peak, cohesion, tension = props[j, 0], props[j, 1], props[j, 2], props[j, 3], props[j, 4]
            residual, residual_cohesion, damping, dilation = props[j, 7], props[j, 8], props[j, 9], props[j, 5]
            widest = dilation * props[j, 6] if dilation > 0.0 else 0.0
            give = 1.0 / ks if ks > 0.0 else 0.0
            frail = tension > 0.0 or cohesion > residual_cohesion or peak > residual
            torn, sheared = (-1.0, -2.0) if frail else (0.0, 0.0)
        a, facing = area[i], align[i]
        p = -kn * gap[i]
        s0, s1, s2, bond = memory_old[i, 0], memory_old[i, 1], memory_old[i, 2], memory_old[i, 3]
        memory[i, 3], memory[i, 4], memory[i, 5] = bond, memory_old[i, 4], memory_old[i, 5]
        for k in range(6, memory.shape[1]):
            memory[i, k] = memory_old[i, k]
        work[i, 0], work[i, 1] = 0.0, 0.0
        if p < 0.0 and (bond <= 0.0 or p < -tension):
            energy = 0.5 * a * ks * (s0 * s0 + s1 * s1 + s2 * s2)
            if bond > 0.0:
                energy, bond = energy + 0.5 * a * kn * gap[i] * gap[i], torn
            _part(i, energy, bond, memory, traction, work, state)
            continue
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        s0, s1, s2 = _in_plane(s0, s1, s2, nx, ny, nz)
        d0, d1, d2 = slip[i, 0], slip[i, 1], slip[i, 2]
        along = d0 * nx + d1 * ny + d2 * nz
        extra = 0.0
        if damping > 0.0 and dt > 0.0:
            extra = max(-2.0 * damping * math.sqrt(kn * mass[i]) * along / dt, min(p, 0.0) - p)
        e0, e1, e2 = d0 - along * nx, d1 - along * ny, d2 - along * nz
        state[i], limit = CLOSED, -1.0
        if bond > 0.0:
            t0, t1, t2 = s0 + e0, s1 + e1, s2 + e2
            strength = _cone(cohesion, peak, p + extra, facing)
            if ks * ks * (t0 * t0 + t1 * t1 + t2 * t2) <= strength * strength:
                limit = strength
                state[i] = INTACT if cohesion > 0.0 or tension > 0.0 else CLOSED
            elif p < 0.0:
                energy = 0.5 * a * (ks * (s0 * s0 + s1 * s1 + s2 * s2) + kn * gap[i] * gap[i])
                _part(i, energy, sheared, memory, traction, work, state)
                continue
            else:
                memory[i, 3] = sheared
        if limit < 0.0:
            limit = _cone(residual_cohesion, residual, p + extra, facing)
        if limit < math.inf:
            s0, s1, s2, released, plastic = _slide(s0, s1, s2, e0, e1, e2, limit * give)
            work[i, 0] = 0.5 * a * ks * released
            if plastic > 0.0:
                state[i] = SLIPPING
                work[i, 0] += a * limit * plastic
                memory[i, 4] += plastic
                if dilation > 0.0 and p > 0.0:
                    widened = max(min(dilation * plastic, widest - memory[i, 5]), 0.0)
                    memory[i, 5] += widened
                    work[i, 0] -= a * _mean_pressure(q, kn, gap, memory_old) * widened
        else:
            s0, s1, s2 = s0 + e0, s1 + e1, s2 + e2
        memory[i, 0], memory[i, 1], memory[i, 2] = s0, s1, s2
        if extra != 0.0:
            work[i, 1] = a * extra * (d0 * push[q, 0] + d1 * push[q, 1] + d2 * push[q, 2])
        traction[i, 0] = p + extra
        traction[i, 1], traction[i, 2], traction[i, 3] = -ks * s0, -ks * s1, -ks * s2


@kernel
def bonded(
    lo, hi, dt, gap, push, slip, normal, align, area, mass, arm, prop, props, memory_old, memory, traction, work, state
):  # fmt: skip
    """Glued until the shear or tension strength is exceeded, then Coulomb friction (arguments: top of file)."""
    same = np.zeros((len(props), 10))  # a Coulomb joint with cohesion only, which leaves friction behind
    same[:, 0:2] = props[:, 0:2]
    same[:, 3:5] = props[:, 3:5]
    same[:, 7] = props[:, 2]
    coulomb(
        lo, hi, dt, gap, push, slip, normal, align, area, mass, arm, prop, same, memory_old, memory, traction, work,
        state,
    )  # fmt: skip


@kernel
def coulomb_moments(
    lo, hi, dt, gap, push, slip, normal, align, area, mass, arm, prop, props, memory_old, memory, traction, work, state
):  # fmt: skip
    """Coulomb joint whose patches also resist rolling and twisting (arguments: top of file).

    A patch carries a couple by its three points: zero-sum pressures for rolling, zero-sum shear for twisting. With its
    area A, its second moments A S about axes in its plane and the lengths L, the elastic couples are ``kn A (S + L^2)``
    times the relative rotation, and ``ks A (tr S + L^2)`` times the relative twist. So a narrow closed part, an edge or
    a corner, does not come away without its couple. Both are cut at L times the normal force of the patch.

    Memory 6 and 7: the elastic rotation and twist, scaled so that the energy is ``kn / 3 m^2`` and ``ks / 2 m^2`` added
    up over the three points: a closed part that moves or shrinks keeps its energy.
    """
    coulomb(
        lo, hi, dt, gap, push, slip, normal, align, area, mass, arm, prop, props, memory_old, memory, traction, work,
        state,
    )  # fmt: skip
    for i in range(lo, hi, 3):
        if area[i] == 0.0:
            continue
        q, j = i // 3, prop[i // 3]
        force = 0.0
        for r in range(i, i + 3):
            force += area[r] * traction[r, 0] if align[r] > 0.0 else 0.0
        force, kn, ks = max(force, 0.0), props[j, 0], props[j, 1]
        if props[j, 10] > 0.0:
            _roll(i, push[q], slip, area[i], arm, kn, props[j, 10], force, memory, traction, work)
        if props[j, 11] > 0.0 and ks > 0.0:
            _twist(i, push[q], slip, area[i], arm, ks, props[j, 11], force, memory, traction, work)


@kernel
def _roll(i, n, slip, a, arm, kn, length, force, memory, traction, work):
    """Rolling of the patch with rows i, i + 1, i + 2 and the area `a` each; memory 6 holds the old state.

    The points are ``arm = sqrt(2) T e`` with T T^t = S and three unit vectors e at 120 degrees; a closing ``g . arm``
    is ``sqrt(2) h . e`` with h = T^t g, and S + L^2 becomes 1 + L^2 (T^t T)^-1.
    """
    b00, b01, b11 = 0.0, 0.0, 0.0
    for d in range(3):
        j0 = SQRT2 / 3.0 * (arm[i, d] - 0.5 * (arm[i + 1, d] + arm[i + 2, d]))
        j1 = SQRT2 / 3.0 * HALF3 * (arm[i + 1, d] - arm[i + 2, d])
        b00, b01, b11 = b00 + j0 * j0, b01 + j0 * j1, b11 + j1 * j1
    det, l2 = b00 * b11 - b01 * b01, length * length
    if not det > 1e-20 * (b00 + b11) ** 2:  # a line of points: no rotation about it can be told
        det, l2 = 1.0, 0.0
    s00, s01, s11 = 1.0 + l2 * b11 / det, -l2 * b01 / det, 1.0 + l2 * b00 / det
    root = math.sqrt(max(s00 * s11 - s01 * s01, 1.0))
    scale = math.sqrt(3.0 * a / (s00 + s11 + 2.0 * root))  # (s + root 1) scale is the root of 3 a s
    r00, r01, r11 = (s00 + root) * scale, s01 * scale, (s11 + root) * scale
    y0 = (2.0 * memory[i, 6] - memory[i + 1, 6] - memory[i + 2, 6]) / 3.0
    y1 = 2.0 / 3.0 * HALF3 * (memory[i + 1, 6] - memory[i + 2, 6])
    double = 3.0 * a * root
    h0, h1 = (r11 * y0 - r01 * y1) / double, (r00 * y1 - r01 * y0) / double
    most = length * force / (3.0 * a * kn)
    p0, p1 = s00 * h0 + s01 * h1, s01 * h0 + s11 * h1
    couple = math.sqrt(b00 * p0 * p0 + 2.0 * b01 * p0 * p1 + b11 * p1 * p1)
    keep = most / couple if couple > most else 1.0
    work[i, 0] += 0.5 * kn * (y0 * y0 + y1 * y1) * (1.0 - keep * keep)
    c0 = slip[i, 0] * n[0] + slip[i, 1] * n[1] + slip[i, 2] * n[2]
    c1 = slip[i + 1, 0] * n[0] + slip[i + 1, 1] * n[1] + slip[i + 1, 2] * n[2]
    c2 = slip[i + 2, 0] * n[0] + slip[i + 2, 1] * n[1] + slip[i + 2, 2] * n[2]
    h0, h1 = keep * h0 + SQRT2 / 3.0 * (c0 - 0.5 * (c1 + c2)), keep * h1 + SQRT2 / 3.0 * HALF3 * (c1 - c2)
    p0, p1 = s00 * h0 + s01 * h1, s01 * h0 + s11 * h1
    couple = math.sqrt(b00 * p0 * p0 + 2.0 * b01 * p0 * p1 + b11 * p1 * p1)
    keep = most / couple if couple > most else 1.0
    work[i, 0] += 3.0 * a * kn * keep * (1.0 - keep) * (h0 * p0 + h1 * p1)
    y0, y1 = keep * (r00 * h0 + r01 * h1), keep * (r01 * h0 + r11 * h1)
    p0, p1 = keep * SQRT2 * kn * p0, keep * SQRT2 * kn * p1
    memory[i, 6], traction[i, 0] = y0, traction[i, 0] + p0
    memory[i + 1, 6], traction[i + 1, 0] = -0.5 * y0 + HALF3 * y1, traction[i + 1, 0] - 0.5 * p0 + HALF3 * p1
    memory[i + 2, 6], traction[i + 2, 0] = -0.5 * y0 - HALF3 * y1, traction[i + 2, 0] - 0.5 * p0 - HALF3 * p1


@kernel
def _twist(i, n, slip, a, arm, ks, length, force, memory, traction, work):
    """Twisting of the patch with rows i, i + 1, i + 2 and the area `a` each; memory 7 holds the old state."""
    polar, turn, old = 0.0, 0.0, 0.0
    for r in range(i, i + 3):
        b0, b1, b2 = arm[r, 0], arm[r, 1], arm[r, 2]
        polar += b0 * b0 + b1 * b1 + b2 * b2
        turn += slip[r, 0] * (n[1] * b2 - n[2] * b1)
        turn += slip[r, 1] * (n[2] * b0 - n[0] * b2) + slip[r, 2] * (n[0] * b1 - n[1] * b0)
        old += memory[r, 7] / 3.0
    if polar == 0.0:
        return
    moment = a * (polar + 3.0 * length * length)
    stiffness, scale = ks * moment, math.sqrt(moment / 3.0)
    widest, angle = length * force / stiffness, old / scale
    held = max(min(angle, widest), -widest)
    new = max(min(held + turn / polar, widest), -widest)
    work[i, 0] += 0.5 * stiffness * (angle * angle - held * held) + stiffness * new * (held + turn / polar - new)
    shear = stiffness * new / (a * polar)
    for r in range(i, i + 3):
        b0, b1, b2 = arm[r, 0], arm[r, 1], arm[r, 2]
        memory[r, 7] = scale * new
        traction[r, 1] -= shear * (n[1] * b2 - n[2] * b1)
        traction[r, 2] -= shear * (n[2] * b0 - n[0] * b2)
        traction[r, 3] -= shear * (n[0] * b1 - n[1] * b0)


@kernel
def coulomb_moments_closure(lo, hi, gap, prop, props, memory, out):
    """Normal response and energy of "coulomb_moments" (arguments: top of file)."""
    for i in range(lo, hi):
        kn, ks = props[prop[i // 3], 0], props[prop[i // 3], 1]
        closed = gap[i] < 0.0 or memory[i, 3] > 0.0
        out[i, 0], out[i, 1] = -kn * gap[i] if closed else 0.0, kn
        out[i, 2] = 0.5 * kn * gap[i] * gap[i] if closed else 0.0
        out[i, 3] = kn * memory[i, 6] * memory[i, 6] / 3.0 + 0.5 * ks * memory[i, 7] * memory[i, 7]


@kernel
def _hyperbola(depth, kn, largest):
    """Pressure, tangent stiffness and energy per area of Bandis' closure ``kn d / (1 - d / largest)``.

    From 99 % of the largest closure on the curve goes on along its tangent, 10^4 kn.
    """
    d = min(depth, 0.99 * largest)
    ratio, more = d / largest, depth - d
    left = 1.0 - ratio
    p, k = kn * d / left, kn / (left * left)
    if ratio > 1e-3:
        energy = -math.log(left) - ratio
    else:  # the same without cancellation
        energy = ratio * ratio * (1 / 2 + ratio * (1 / 3 + ratio * (1 / 4 + ratio * (1 / 5))))
    return p + k * more, k, kn * largest * largest * energy + p * more + 0.5 * k * more * more


@kernel
def _mobilised(ratio):
    """JRC over its peak after shear by `ratio` times the peak displacement, from the peak (1) to none (100).

    Barton, Bandis and Bakhtar (1985), Int. J. Rock Mech. Min. Sci. 22, 121-140: 1, 0.85, 0.7, 0.5, 0.4, 0 at 1, 2, 4,
    10, 25, 100, straight between them.
    """
    if ratio < 2.0:
        return 1.0 - 0.15 * (ratio - 1.0)
    if ratio < 4.0:
        return 0.85 - 0.075 * (ratio - 2.0)
    if ratio < 10.0:
        return 0.7 - (ratio - 4.0) / 30.0
    if ratio < 25.0:
        return 0.5 - (ratio - 10.0) / 150.0
    return max(0.4 - 0.4 * (ratio - 25.0) / 75.0, 0.0)


@kernel
def barton_bandis(
    lo, hi, dt, gap, push, slip, normal, align, area, mass, arm, prop, props, memory_old, memory, traction, work, state
):  # fmt: skip
    """Bandis' closure and Barton's shear strength (arguments: top of file). Memory 6: slip since compile [m]."""
    for i in range(lo, hi):
        if area[i] == 0.0:
            state[i] = OPEN
            continue
        q = i // 3
        j = prop[q]
        kn, ks, largest, jrc, jcs, base = props[j, 0], props[j, 1], props[j, 2], props[j, 3], props[j, 4], props[j, 5]
        a, worn = area[i], memory_old[i, 6]
        s0, s1, s2 = memory_old[i, 0], memory_old[i, 1], memory_old[i, 2]
        for k in range(3, memory.shape[1]):
            memory[i, k] = memory_old[i, k]
        work[i, 1] = 0.0
        if gap[i] >= 0.0:
            _part(i, 0.5 * a * ks * (s0 * s0 + s1 * s1 + s2 * s2), 0.0, memory, traction, work, state)
            continue
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        s0, s1, s2 = _in_plane(s0, s1, s2, nx, ny, nz)
        d0, d1, d2 = slip[i, 0], slip[i, 1], slip[i, 2]
        along = d0 * nx + d1 * ny + d2 * nz
        p, _, _ = _hyperbola(-gap[i], kn, largest)
        extra = max(-2.0 * props[j, 8] * math.sqrt(kn * mass[i]) * along / dt, -p) if dt > 0.0 else 0.0
        pressed = p + extra
        rough = 0.0
        if pressed > 0.0:
            mobile = jrc * _mobilised(1.0 + worn / props[j, 6])
            rough = min(mobile * max(math.log10(jcs / pressed), 0.0), STEEPEST - base)
        limit = _cone(0.0, math.tan(math.radians(base + rough)), pressed, align[i])
        give = 1.0 / ks if ks > 0.0 else 0.0
        s0, s1, s2, released, plastic = _slide(
            s0, s1, s2, d0 - along * nx, d1 - along * ny, d2 - along * nz, limit * give
        )
        widened = plastic * math.tan(math.radians(rough * props[j, 7]))
        state[i] = SLIPPING if plastic > 0.0 else CLOSED
        memory[i, 0], memory[i, 1], memory[i, 2] = s0, s1, s2
        memory[i, 4] += plastic
        memory[i, 5] += widened
        memory[i, 6] = worn + plastic
        work[i, 0] = 0.5 * a * ks * released + a * limit * plastic
        if widened > 0.0:
            for r in range(3 * q, 3 * q + 3):  # see _mean_pressure
                work[i, 0] -= a * _hyperbola(max(-gap[r], 0.0), kn, largest)[0] * widened / 3.0
        work[i, 1] = a * extra * (d0 * push[q, 0] + d1 * push[q, 1] + d2 * push[q, 2])
        traction[i, 0] = pressed
        traction[i, 1], traction[i, 2], traction[i, 3] = -ks * s0, -ks * s1, -ks * s2


@kernel
def barton_bandis_closure(lo, hi, gap, prop, props, memory, out):
    """Normal response and energy of "barton_bandis" (arguments: top of file)."""
    for i in range(lo, hi):
        j = prop[i // 3]
        out[i, 0], out[i, 1], out[i, 2] = _hyperbola(max(-gap[i], 0.0), props[j, 0], props[j, 2])
        out[i, 3] = 0.0


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
