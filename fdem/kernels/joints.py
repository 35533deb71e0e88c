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

`out` (n, 4): pressure [Pa], tangent stiffness [Pa/m], energy of closure [J/m2], other energy but that of slip [J/m2].

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
            residual, residual_cohesion, damping = props[j, 7], props[j, 8], props[j, 9]
            dilation = props[j, 5]
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
            if ks * ks * (t0 * t0 + t1 * t1 + t2 * t2) > strength * strength:
                memory[i, 3] = sheared
                if p < 0.0:
                    energy = 0.5 * a * (ks * (s0 * s0 + s1 * s1 + s2 * s2) + kn * gap[i] * gap[i])
                    _part(i, energy, sheared, memory, traction, work, state)
                    continue
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
                work[i, 0] += a * limit * plastic
                memory[i, 4] += plastic
                if dilation > 0.0 and p > 0.0:
                    widened = max(min(dilation * plastic, widest - memory[i, 5]), 0.0)
                    memory[i, 5] += widened
                    # each point lifts the whole patch by a third of this
                    for r in range(3 * q, 3 * q + 3):
                        if gap[r] < 0.0 or memory_old[r, 3] > 0.0:
                            work[i, 0] += a * kn * gap[r] * widened / 3.0
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

    A patch carries a couple by its three points. Rolling: extra pressures ``kn u``, u being the part of the closing
    that tilts the faces against each other (it sums to zero). Twisting: extra shear ``ks v`` round the middle of the
    points, v being the motion of a relative rotation about the normal. Both are cut where the couple reaches a length
    times the normal force of the patch. Memory 6: u [m], 7: v, its length at the point [m].
    """
    coulomb(
        lo, hi, dt, gap, push, slip, normal, align, area, mass, arm, prop, props, memory_old, memory, traction, work,
        state,
    )  # fmt: skip
    for i in range(lo, hi, 3):
        if area[i] == 0.0:
            continue
        q, rows = i // 3, range(i, i + 3)
        j = prop[q]
        force = 0.0
        for r in rows:
            force += area[r] * traction[r, 0] if align[r] > 0.0 else 0.0
        force = max(force, 0.0)
        n0, n1, n2 = push[q, 0], push[q, 1], push[q, 2]
        a, kn, ks = area[i], props[j, 0], props[j, 1]
        old, tilt = 0.0, 0.0
        for r in rows:
            old += memory_old[r, 6] / 3.0
            tilt += (slip[r, 0] * n0 + slip[r, 1] * n1 + slip[r, 2] * n2) / 3.0
        if props[j, 10] > 0.0:
            most = props[j, 10] * force
            shrink = _shrink(i, memory_old[:, 6], -old, arm, a * kn, most)
            for r in rows:
                before = memory_old[r, 6] - old
                work[r, 0] += 0.5 * a * kn * before * before * (1.0 - shrink * shrink)
                closing = slip[r, 0] * n0 + slip[r, 1] * n1 + slip[r, 2] * n2
                memory[r, 6] = before * shrink + closing - tilt
            shrink = _shrink(i, memory[:, 6], 0.0, arm, a * kn, most)
            for r in rows:
                work[r, 0] += a * kn * shrink * (1.0 - shrink) * memory[r, 6] * memory[r, 6]
                memory[r, 6] *= shrink
                traction[r, 0] += kn * memory[r, 6]
        polar, twist, turn = 0.0, 0.0, 0.0
        for r in rows:
            b0, b1, b2 = arm[r, 0], arm[r, 1], arm[r, 2]
            length2 = b0 * b0 + b1 * b1 + b2 * b2
            polar += length2
            twist += memory_old[r, 7] * math.sqrt(length2)
            d0, d1, d2 = slip[r, 0], slip[r, 1], slip[r, 2]
            turn += d0 * (n1 * b2 - n2 * b1) + d1 * (n2 * b0 - n0 * b2) + d2 * (n0 * b1 - n1 * b0)
        if props[j, 11] > 0.0 and ks > 0.0 and polar > 0.0:
            most = props[j, 11] * force / (a * ks * polar)
            twist /= polar
            held = max(min(twist, most), -most)
            work[i, 0] += 0.5 * a * ks * polar * (twist * twist - held * held)
            twist = max(min(held + turn / polar, most), -most)
            work[i, 0] += a * ks * polar * twist * (held + turn / polar - twist)
            for r in rows:
                b0, b1, b2 = arm[r, 0], arm[r, 1], arm[r, 2]
                memory[r, 7] = twist * math.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
                traction[r, 1] -= ks * twist * (n1 * b2 - n2 * b1)
                traction[r, 2] -= ks * twist * (n2 * b0 - n0 * b2)
                traction[r, 3] -= ks * twist * (n0 * b1 - n1 * b0)


@kernel
def _shrink(i, u, shift, arm, stiffness, most):
    """Factor that brings the couple of the extra closings ``u + shift`` [m] of three rows down to `most` [N m]."""
    m0, m1, m2 = 0.0, 0.0, 0.0
    for r in range(i, i + 3):
        m0 += (u[r] + shift) * arm[r, 0]
        m1 += (u[r] + shift) * arm[r, 1]
        m2 += (u[r] + shift) * arm[r, 2]
    couple = stiffness * math.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
    return most / couple if couple > most else 1.0


@kernel
def coulomb_moments_closure(lo, hi, gap, prop, props, memory, out):
    """Normal response and energy of "coulomb_moments" (arguments: top of file)."""
    for i in range(lo, hi):
        kn, ks = props[prop[i // 3], 0], props[prop[i // 3], 1]
        closed = gap[i] < 0.0 or memory[i, 3] > 0.0
        out[i, 0], out[i, 1] = -kn * gap[i] if closed else 0.0, kn
        out[i, 2] = 0.5 * kn * gap[i] * gap[i] if closed else 0.0
        out[i, 3] = 0.5 * kn * memory[i, 6] * memory[i, 6] + 0.5 * ks * memory[i, 7] * memory[i, 7]


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
            for r in range(3 * q, 3 * q + 3):  # each point lifts the whole patch by a third of this
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
