"""Kernels of blocks whose displacement is a polynomial of place: uniform strain, linear strain.

A gridpoint is ``x = X + (c - C) + sum_k B_k phi_k(X) - (phi_1, phi_2, phi_3)``. The first three functions are the place
itself from the block's mass centre, ``phi_1..3 = X - C``, so their coefficients are the deformation gradient F; a block
of linear strain has six quadratic ones more. Placement P and mass M are constant. Arguments shared here:

========  ===============  ======================================================================================
q         (n, 3 + 3 k)     centre c [m], then the rows x, y, z of the coefficients B [-, 1/m]
v, a      (n, 3 + 3 k)     their first and second rates
f         (n, 3 + 3 k)     force [N] and the forces on the coefficients [N m, N m^2]
X, C      (n_gp, 3), (n, 3)  reference positions of gridpoints and centres [m]
phi       (n_gp, k)        functions at the gridpoints [m, m^2]
start     (n + 1,) int     gridpoints of block b: start[b] to start[b + 1]
========  ===============  ======================================================================================
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

__all__ = [
    "accelerate",
    "advance",
    "creep",
    "joint_stiffness",
    "linear_force",
    "place",
    "pull",
    "push",
    "relax",
    "resist",
    "rotations",
    "uniform_force",
]


@kernel
def place(q, X, C, phi, start, x):
    """Write the positions of all gridpoints to `x` (n_gp, 3) [m]; a block at the start keeps them to the last bit."""
    k = phi.shape[1]
    for b in range(q.shape[0]):
        for d in range(3):
            first, moved = 3 + d * k, q[b, d] - C[b, d]
            for i in range(start[b], start[b + 1]):
                s = q[b, first] * phi[i, 0]
                for m in range(1, k):
                    s += q[b, first + m] * phi[i, m]
                x[i, d] = X[i, d] + (moved + (s - phi[i, d]))


@kernel
def push(v, phi, start, xdot):
    """Write the velocities ``P v`` of all gridpoints to `xdot` (n_gp, 3) [m/s]."""
    k = phi.shape[1]
    for b in range(v.shape[0]):
        for d in range(3):
            first = 3 + d * k
            for i in range(start[b], start[b + 1]):
                s = v[b, d]
                for m in range(k):
                    s += v[b, first + m] * phi[i, m]
                xdot[i, d] = s


@kernel
def pull(f_gp, phi, start, f):
    """Add gridpoint forces `f_gp` (n_gp, 3) [N] to `f`, the transpose of `push`."""
    k = phi.shape[1]
    total = np.empty(3 * (k + 1))
    for b in range(f.shape[0]):
        total[:] = 0.0
        for i in range(start[b], start[b + 1]):
            fx, fy, fz = f_gp[i, 0], f_gp[i, 1], f_gp[i, 2]
            total[0] += fx
            total[1] += fy
            total[2] += fz
            for m in range(k):
                p = phi[i, m]
                total[3 + m] += fx * p
                total[3 + k + m] += fy * p
                total[3 + 2 * k + m] += fz * p
        for j in range(total.size):
            f[b, j] += total[j]


@kernel
def accelerate(f, mass, inverse, a):
    """Write ``M^-1 f`` to `a`; `mass` (n,) [kg], `inverse` (n, k, k) that of the moments of the functions."""
    k = inverse.shape[1]
    for b in range(f.shape[0]):
        one = 1.0 / mass[b]
        for d in range(3):
            a[b, d] = one * f[b, d]
            first = 3 + d * k
            for i in range(k):
                s = 0.0
                for j in range(k):
                    s += inverse[b, i, j] * f[b, first + j]
                a[b, first + i] = s


@kernel
def _polar(q, b, k, R):
    """Write the rotation of block ``b``, of ``F = R U``, to `R`.

    Scaled Newton, ``R <- (s R + R^-T / s) / 2``: N. J. Higham, SIAM J. Sci. Stat. Comput. 7 (1986), algorithm 3.3.
    """
    p = 3
    m00, m01, m02 = q[b, p], q[b, p + 1], q[b, p + 2]
    m10, m11, m12 = q[b, p + k], q[b, p + k + 1], q[b, p + k + 2]
    m20, m21, m22 = q[b, p + 2 * k], q[b, p + 2 * k + 1], q[b, p + 2 * k + 2]
    for _sweep in range(40):
        c00, c01, c02 = m11 * m22 - m12 * m21, m12 * m20 - m10 * m22, m10 * m21 - m11 * m20
        c10, c11, c12 = m02 * m21 - m01 * m22, m00 * m22 - m02 * m20, m01 * m20 - m00 * m21
        c20, c21, c22 = m01 * m12 - m02 * m11, m02 * m10 - m00 * m12, m00 * m11 - m01 * m10
        det = m00 * c00 + m01 * c01 + m02 * c02
        if not abs(det) > 0.0:
            break
        size = m00 * m00 + m01 * m01 + m02 * m02 + m10 * m10 + m11 * m11 + m12 * m12 + m20 * m20 + m21 * m21 + m22 * m22
        other = (
            c00 * c00 + c01 * c01 + c02 * c02 + c10 * c10 + c11 * c11 + c12 * c12 + c20 * c20 + c21 * c21 + c22 * c22
        )
        other /= det * det
        s = 1.0
        if abs(size - 3.0) + abs(other - 3.0) > 0.1:
            s = math.sqrt(math.sqrt(other / size))
        h, g = 0.5 * s, 0.5 / (s * det)
        n00, n01, n02 = h * m00 + g * c00, h * m01 + g * c01, h * m02 + g * c02
        n10, n11, n12 = h * m10 + g * c10, h * m11 + g * c11, h * m12 + g * c12
        n20, n21, n22 = h * m20 + g * c20, h * m21 + g * c21, h * m22 + g * c22
        change = (n00 - m00) ** 2 + (n01 - m01) ** 2 + (n02 - m02) ** 2
        change += (n10 - m10) ** 2 + (n11 - m11) ** 2 + (n12 - m12) ** 2
        change += (n20 - m20) ** 2 + (n21 - m21) ** 2 + (n22 - m22) ** 2
        m00, m01, m02, m10, m11, m12, m20, m21, m22 = n00, n01, n02, n10, n11, n12, n20, n21, n22
        if change < 1e-17:  # quadratic: the step just made is exact to round-off
            break
    R[0, 0], R[0, 1], R[0, 2] = m00, m01, m02
    R[1, 0], R[1, 1], R[1, 2] = m10, m11, m12
    R[2, 0], R[2, 1], R[2, 2] = m20, m21, m22


@kernel
def rotations(q, k, R):
    """Write the rotations of all blocks to `R` (n, 3, 3)."""
    for b in range(q.shape[0]):
        _polar(q, b, k, R[b])


@kernel
def _angle(old, new, angle):
    """Write the rotation vector of ``new old^T`` to `angle` (3,) [rad]."""
    trace = 0.0
    sx = sy = sz = 0.0  # twice the sine, along the axis: the antisymmetric part; the trace gives the cosine
    for m in range(3):
        sx += new[2, m] * old[1, m] - new[1, m] * old[2, m]
        sy += new[0, m] * old[2, m] - new[2, m] * old[0, m]
        sz += new[1, m] * old[0, m] - new[0, m] * old[1, m]
        trace += new[0, m] * old[0, m] + new[1, m] * old[1, m] + new[2, m] * old[2, m]
    sine = 0.5 * math.sqrt(sx * sx + sy * sy + sz * sz)
    theta = math.atan2(sine, 0.5 * (trace - 1.0))
    scale = 0.5 * theta / sine if sine > 1e-8 else 0.5
    angle[0], angle[1], angle[2] = scale * sx, scale * sy, scale * sz


@kernel
def advance(q, v, dt, angle):
    """Move all blocks, ``q += dt v``, and write by what rotation vectors they turned to `angle` (n, 3) [rad]."""
    size = q.shape[1]
    k = size // 3 - 1
    old, new = np.empty((3, 3)), np.empty((3, 3))
    for b in range(q.shape[0]):
        deforms = False
        for j in range(3, size):
            deforms = deforms or v[b, j] != 0.0
        for d in range(3):
            angle[b, d] = 0.0
            q[b, d] += dt * v[b, d]
        if deforms:
            _polar(q, b, k, old)
            for j in range(3, size):
                q[b, j] += dt * v[b, j]
            _polar(q, b, k, new)
            _angle(old, new, angle[b])


@kernel
def _spin(q, v, b, k, R):
    """Angular velocity (global axes) of the rotation R: ``(tr(U) 1 - U) R^T omega = w``, w that of ``R^T Fdot``."""
    U, A = np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            u = s = 0.0
            for d in range(3):
                u += R[d, i] * q[b, 3 + d * k + j]
                s += R[d, i] * v[b, 3 + d * k + j]
            U[i, j], A[i, j] = u, s
    trace = U[0, 0] + U[1, 1] + U[2, 2]
    a, e, i = trace - U[0, 0], trace - U[1, 1], trace - U[2, 2]
    h, g, f = -0.5 * (U[1, 2] + U[2, 1]), -0.5 * (U[0, 2] + U[2, 0]), -0.5 * (U[0, 1] + U[1, 0])
    w0, w1, w2 = A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]
    # symmetric 3x3 system [[a, f, g], [f, e, h], [g, h, i]] by cofactors
    c0, c1, c2 = e * i - h * h, g * h - f * i, f * h - g * e
    det = a * c0 + f * c1 + g * c2
    o0 = (c0 * w0 + c1 * w1 + c2 * w2) / det
    o1 = (c1 * w0 + (a * i - g * g) * w1 + (f * g - a * h) * w2) / det
    o2 = (c2 * w0 + (f * g - a * h) * w1 + (a * e - f * f) * w2) / det
    return (
        R[0, 0] * o0 + R[0, 1] * o1 + R[0, 2] * o2,
        R[1, 0] * o0 + R[1, 1] * o1 + R[1, 2] * o2,
        R[2, 0] * o0 + R[2, 1] * o1 + R[2, 2] * o2,
    )


@kernel
def creep(q, v, dt, angle):
    """Move all blocks in fictitious time: rotate by what the velocities turn, stretch by the rest, turn the velocities.

    A rotation is then no stretch whatever its size: fictitious masses make rotation as easy as joints are soft, and
    stretch as hard as the rock.
    """
    k = q.shape[1] // 3 - 1
    R = np.empty((3, 3))
    for b in range(q.shape[0]):
        _polar(q, b, k, R)
        x, y, z = _spin(q, v, b, k, R)
        for d in range(3):
            q[b, d] += dt * v[b, d]
        angle[b, 0], angle[b, 1], angle[b, 2] = dt * x, dt * y, dt * z
        theta = abs(dt) * math.sqrt(x * x + y * y + z * z)
        # exp(angle) = 1 + sine [angle] + cosine [angle]^2
        sine = math.sin(theta) / theta if theta > 0.0 else 1.0
        half = math.sin(0.5 * theta) / theta if theta > 0.0 else 0.5
        cosine = 2.0 * half * half
        ax, ay, az = dt * x, dt * y, dt * z
        for m in range(k):
            i, j, n = 3 + m, 3 + k + m, 3 + 2 * k + m
            p, r, s = v[b, i], v[b, j], v[b, n]
            u0 = q[b, i] + dt * (p - (y * q[b, n] - z * q[b, j]))
            u1 = q[b, j] + dt * (r - (z * q[b, i] - x * q[b, n]))
            u2 = q[b, n] + dt * (s - (x * q[b, j] - y * q[b, i]))
            t0, t1, t2 = ay * u2 - az * u1, az * u0 - ax * u2, ax * u1 - ay * u0
            q[b, i] = u0 + sine * t0 + cosine * (ay * t2 - az * t1)
            q[b, j] = u1 + sine * t1 + cosine * (az * t0 - ax * t2)
            q[b, n] = u2 + sine * t2 + cosine * (ax * t1 - ay * t0)
            t0, t1, t2 = ay * s - az * r, az * p - ax * s, ax * r - ay * p
            v[b, i] = p + sine * t0 + cosine * (ay * t2 - az * t1)
            v[b, j] = r + sine * t1 + cosine * (az * t0 - ax * t2)
            v[b, n] = s + sine * t2 + cosine * (ax * t1 - ay * t0)


@kernel
def _into_frame(R, values, b, out):
    """Write unknowns, rates or forces of block ``b`` in the axes of its frame `R` to `out`."""
    k = out.size // 3 - 1
    for d in range(3):
        out[d] = R[0, d] * values[b, 0] + R[1, d] * values[b, 1] + R[2, d] * values[b, 2]
        for m in range(k):
            x, y, z = values[b, 3 + m], values[b, 3 + k + m], values[b, 3 + 2 * k + m]
            out[3 + d * k + m] = R[0, d] * x + R[1, d] * y + R[2, d] * z


@kernel
def _out_of_frame(R, local, b, out):
    """Write `local` values in the axes of the frame `R` to row ``b`` of `out` in global axes."""
    k = local.size // 3 - 1
    for d in range(3):
        out[b, d] = R[d, 0] * local[0] + R[d, 1] * local[1] + R[d, 2] * local[2]
        for m in range(k):
            x, y, z = local[3 + m], local[3 + k + m], local[3 + 2 * k + m]
            out[b, 3 + d * k + m] = R[d, 0] * x + R[d, 1] * y + R[d, 2] * z


@kernel
def relax(q, f, inverse, a):
    """Accelerations by fictitious masses that turn with the blocks: ``a = T^T W T f``, T into the block's frame.

    `inverse` (n, 3 + 3 k, 3 + 3 k) is W, the inverse of the fictitious mass matrix of every block in its own frame.
    """
    size = f.shape[1]
    R, force, result = np.empty((3, 3)), np.empty(size), np.empty(size)
    for b in range(f.shape[0]):
        _polar(q, b, size // 3 - 1, R)
        _into_frame(R, f, b, force)
        for i in range(size):
            s = 0.0
            for j in range(size):
                s += inverse[b, i, j] * force[j]
            result[i] = s
        _out_of_frame(R, result, b, a)


@kernel
def resist(q, f, v, alpha, modes, carried, out):
    """Write local damping to `out` (n, 3 + 3 k): in every mode a share `alpha` of its force, against its rate.

    ========  ===============  ==================================================
    modes     (n, w, w)        modes of each block in its own frame, in columns; columns of zeros are no mode
    carried   (n, w, w)        mass times modes, such that ``modes^T carried`` is diagonal
    ========  ===============  ==================================================

    Unknown by unknown, forces that cancel in a soft motion would each be damped: a bending beam stands still or jumps.
    """
    size = f.shape[1]
    R, force, rate, result = np.empty((3, 3)), np.empty(size), np.empty(size), np.empty(size)
    for b in range(f.shape[0]):
        _polar(q, b, size // 3 - 1, R)
        _into_frame(R, f, b, force)
        _into_frame(R, v, b, rate)
        result[:] = 0.0
        for m in range(size):
            push = speed = norm = 0.0
            for i in range(size):
                push += modes[b, i, m] * force[i]
                speed += carried[b, i, m] * rate[i]
                norm += modes[b, i, m] * carried[b, i, m]
            if norm > 0.0 and speed != 0.0:
                share = alpha * abs(push) / norm
                if speed < 0.0:
                    share = -share
                for i in range(size):
                    result[i] += share * carried[b, i, m]
        _out_of_frame(R, result, b, out)


@kernel
def joint_stiffness(gp, w, frame, kn, ks, x, gp_block, mobile, place_of, phi, first, out):
    """Stiffness of contact rows against the unknowns of each block, twice between two blocks that move.

    ========  ============  ==================================================
    gp, w     (n, 7)        gridpoints and weights: three of the slave, four of the master
    frame     (n, 3, 3)     first row the normal of the master face
    kn, ks    (n,)          stiffness [N/m]; the larger all round where the faces are not parallel within 8 degrees
    x         (n_gp, 3)     positions [m]
    gp_block  (n_gp,)       block of each gridpoint
    mobile    (n_blocks,)   whether the block can move
    place_of  (n_blocks,)   place in this batch, -1: none
    phi       (m, k)        functions at the batch's gridpoints, the first of which is `first`
    out       (n_batch, 3 + 3 k, 3 + 3 k)  added to
    ========  ============  ==================================================
    """
    k = phi.shape[1]
    value, own, S = np.zeros(k + 1), np.zeros(3), np.zeros((3, 3))
    for row in range(len(gp)):
        sides = gp_block[gp[row, 0]], gp_block[gp[row, 3]]
        for d in range(3):
            i, j = (d + 1) % 3, (d + 2) % 3
            ei, ej = x[gp[row, 1], i] - x[gp[row, 0], i], x[gp[row, 1], j] - x[gp[row, 0], j]
            fi, fj = x[gp[row, 2], i] - x[gp[row, 0], i], x[gp[row, 2], j] - x[gp[row, 0], j]
            own[d] = ei * fj - ej * fi
        normal = frame[row, 0]
        cosine = abs(own[0] * normal[0] + own[1] * normal[1] + own[2] * normal[2])
        size = np.sqrt(own[0] * own[0] + own[1] * own[1] + own[2] * own[2])
        straight, shear = kn[row], ks[row]
        if cosine <= 0.99 * size:
            straight = shear = max(kn[row], ks[row])
        twice = 2.0 if mobile[sides[0]] and mobile[sides[1]] else 1.0
        for i in range(3):
            for j in range(3):
                S[i, j] = twice * (straight - shear) * normal[i] * normal[j]
            S[i, i] += twice * shear
        for side in range(2):
            b = place_of[sides[side]]
            if b < 0 or not mobile[sides[side]]:
                continue
            value[:] = 0.0
            for c in range(3 * side, 3 + 4 * side):
                weight, g = w[row, c], gp[row, c] - first
                value[0] += weight
                for m in range(k):
                    value[m + 1] += weight * phi[g, m]
            for d in range(3):
                for m in range(k + 1):
                    i = d if m == 0 else 2 + d * k + m
                    for e in range(3):
                        part = S[d, e] * value[m]
                        for c in range(k + 1):
                            out[b, i, e if c == 0 else 2 + e * k + c] += part * value[c]


@kernel
def uniform_force(q, volume, lam, mu, stress0, f):
    """Subtract ``V P(F)`` from `f`, ``P = R (lam tr(e) 1 + 2 mu e) + F S0`` with the stretch ``e = U - 1``.

    ========  ===============  ==================================================
    volume    (n,)             reference volumes [m^3]
    lam, mu   (n,)             Lame constants [Pa]
    stress0   (n, 6) or (0, 6)  in-situ stress (2nd Piola-Kirchhoff) [Pa], xx yy zz yz zx xy
    ========  ===============  ==================================================

    e is made symmetric before it becomes a stress, so that ``P F^T`` is symmetric to the last bits *of the stress*: the
    angular momentum of a stiff block does not feel the round-off of R.
    """
    R = np.empty((3, 3))
    for b in range(q.shape[0]):
        _polar(q, b, 3, R)
        f0, f1, f2 = q[b, 3], q[b, 4], q[b, 5]
        f3, f4, f5 = q[b, 6], q[b, 7], q[b, 8]
        f6, f7, f8 = q[b, 9], q[b, 10], q[b, 11]
        xx = R[0, 0] * f0 + R[1, 0] * f3 + R[2, 0] * f6 - 1.0
        yy = R[0, 1] * f1 + R[1, 1] * f4 + R[2, 1] * f7 - 1.0
        zz = R[0, 2] * f2 + R[1, 2] * f5 + R[2, 2] * f8 - 1.0
        yz = R[0, 1] * f2 + R[1, 1] * f5 + R[2, 1] * f8 + R[0, 2] * f1 + R[1, 2] * f4 + R[2, 2] * f7
        zx = R[0, 2] * f0 + R[1, 2] * f3 + R[2, 2] * f6 + R[0, 0] * f2 + R[1, 0] * f5 + R[2, 0] * f8
        xy = R[0, 0] * f1 + R[1, 0] * f4 + R[2, 0] * f7 + R[0, 1] * f0 + R[1, 1] * f3 + R[2, 1] * f6
        two, spread = 2.0 * mu[b], lam[b] * (xx + yy + zz)
        xx, yy, zz = volume[b] * (spread + two * xx), volume[b] * (spread + two * yy), volume[b] * (spread + two * zz)
        yz, zx, xy = volume[b] * mu[b] * yz, volume[b] * mu[b] * zx, volume[b] * mu[b] * xy
        for d in range(3):
            r0, r1, r2 = R[d, 0], R[d, 1], R[d, 2]
            f[b, 3 + 3 * d] -= r0 * xx + r1 * xy + r2 * zx
            f[b, 4 + 3 * d] -= r0 * xy + r1 * yy + r2 * yz
            f[b, 5 + 3 * d] -= r0 * zx + r1 * yz + r2 * zz
        if stress0.shape[0] > 0:
            xx, yy, zz = volume[b] * stress0[b, 0], volume[b] * stress0[b, 1], volume[b] * stress0[b, 2]
            yz, zx, xy = volume[b] * stress0[b, 3], volume[b] * stress0[b, 4], volume[b] * stress0[b, 5]
            for d in range(3):
                g0, g1, g2 = q[b, 3 + 3 * d], q[b, 4 + 3 * d], q[b, 5 + 3 * d]
                f[b, 3 + 3 * d] -= g0 * xx + g1 * xy + g2 * zx
                f[b, 4 + 3 * d] -= g0 * xy + g1 * yy + g2 * yz
                f[b, 5 + 3 * d] -= g0 * zx + g1 * yz + g2 * zz


@kernel
def _gradients(q, b, F):
    """Write ``F(xi) = F_0 + sum_a xi_a F_a`` of block ``b`` of linear strain to `F` (4, 3, 3).

    Functions 4 to 9 are the halves of xx, yy, zz and the products yz, zx, xy of the place xi from the centre.
    """
    for i in range(3):
        p = 3 + 9 * i
        F[0, i, 0], F[0, i, 1], F[0, i, 2] = q[b, p], q[b, p + 1], q[b, p + 2]
        F[1, i, 0], F[2, i, 1], F[3, i, 2] = q[b, p + 3], q[b, p + 4], q[b, p + 5]
        F[2, i, 2] = F[3, i, 1] = q[b, p + 6]
        F[3, i, 0] = F[1, i, 2] = q[b, p + 7]
        F[1, i, 1] = F[2, i, 0] = q[b, p + 8]


@kernel
def _green(F, a, c, e):
    """Write ``(F_a^T F_c + F_c^T F_a) / 2`` (halved again where a = c) to `e` (6,), xx yy zz yz zx xy, shear halved."""
    for n in range(6):
        i = n if n < 3 else (n - 2) % 3
        j = n if n < 3 else (n - 1) % 3
        s = 0.0
        for d in range(3):
            s += F[a, d, i] * F[c, d, j] + F[c, d, i] * F[a, d, j]
        e[n] = 0.5 * s if a != c else 0.25 * s


@kernel
def _linear_strain(F, e):
    """Green strain of linear F by monomials 1, x, y, z, xx, yy, zz, yz, zx, xy, to `e` (10, 6), shear halved."""
    for a in range(4):
        _green(F, 0, a, e[a])
    for a in range(3):
        _green(F, a + 1, a + 1, e[4 + a])
        _green(F, (a + 1) % 3 + 1, (a + 2) % 3 + 1, e[7 + a])
    for n in range(3):
        e[0, n] -= 0.5


@kernel
def _linear_stress(e, lam, mu, moments, start, out):
    """Write moments ``int m S dV`` (10, 6) of the stress [N m, ...] to `out`; `start` those of the in-situ stress."""
    for m in range(10):
        for n in range(6):
            s = 0.0
            for o in range(10):
                s += moments[m, o] * e[o, n]
            out[m, n] = 2.0 * mu * s
        spread = lam / (2.0 * mu) * (out[m, 0] + out[m, 1] + out[m, 2])
        for n in range(3):
            out[m, n] += spread
        if start.shape[0] > 0:
            for n in range(6):
                out[m, n] += start[m, n]


@kernel
def _add_product(F, a, t, P):
    """``P += F_a T`` for the symmetric tensor `t` (6,)."""
    for i in range(3):
        x, y, z = F[a, i, 0], F[a, i, 1], F[a, i, 2]
        P[i, 0] += x * t[0] + y * t[5] + z * t[4]
        P[i, 1] += x * t[5] + y * t[1] + z * t[3]
        P[i, 2] += x * t[4] + y * t[3] + z * t[2]


@kernel
def linear_force(q, lam, mu, moments, stress0, f):
    """Subtract the internal forces of blocks of linear strain from `f`: St. Venant-Kirchhoff, integrated exactly.

    F is linear in place, the Green strain quadratic, the energy of degree 4: moments of monomials up to degree 4 give
    it without quadrature. With ``T_ab = int xi_a xi_b S dV`` (xi_0 = 1) the force on F_a is ``sum_b F_b T_ab``.

    ========  ===============  ==================================================
    lam, mu   (n,)             Lame constants [Pa]
    moments   (n, 10, 10)      integrals of products of the monomials 1, x, y, z, xx, yy, zz, yz, zx, xy
    stress0   (n, 10, 6) or (0, 10, 6)  integrals of monomials times the in-situ stress (2nd Piola-Kirchhoff)
    ========  ===============  ==================================================
    """
    F, P = np.empty((4, 3, 3)), np.empty((4, 3, 3))
    e, t, none = np.empty((10, 6)), np.empty((10, 6)), np.empty((0, 6))
    for b in range(q.shape[0]):
        _gradients(q, b, F)
        _linear_strain(F, e)
        _linear_stress(e, lam[b], mu[b], moments[b], stress0[b] if stress0.shape[0] > 0 else none, t)
        P[:] = 0.0
        for a in range(4):
            _add_product(F, a, t[a], P[0])
        for a in range(1, 4):
            _add_product(F, 0, t[a], P[a])
            for c in range(1, 4):
                _add_product(F, c, t[3 + a] if a == c else t[12 - a - c], P[a])
        for i in range(3):
            p = 3 + 9 * i
            f[b, p] -= P[0, i, 0]
            f[b, p + 1] -= P[0, i, 1]
            f[b, p + 2] -= P[0, i, 2]
            f[b, p + 3] -= P[1, i, 0]
            f[b, p + 4] -= P[2, i, 1]
            f[b, p + 5] -= P[3, i, 2]
            f[b, p + 6] -= P[2, i, 2] + P[3, i, 1]
            f[b, p + 7] -= P[3, i, 0] + P[1, i, 2]
            f[b, p + 8] -= P[1, i, 1] + P[2, i, 0]
