"""Kernels of blocks that move as a whole: placement, push and pull, acceleration and advance of rigid blocks.

Every block stores its motion as centroid ``c`` and unit quaternion ``(w, x, y, z)``, the rotation ``R`` since start.
A gridpoint is ``x = X + (c - C) + (R - 1)(X - C)``: a block that has not moved is where it was to the last bit, and the
shape cannot drift because it is always rebuilt from the reference ``X``.
"""

from __future__ import annotations

import numpy as np

from fdem._jit import kernel

__all__ = ["rigid_accelerate", "rigid_advance", "rigid_joints", "rigid_place", "rigid_pull", "rigid_push"]


@kernel
def _turn(q, b):
    """Rows of ``R - 1`` of block ``b``; divided by the norm, so that ``R`` is orthogonal for any quaternion."""
    w, x, y, z = q[b, 3], q[b, 4], q[b, 5], q[b, 6]
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        -s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y),
        s * (x * y + w * z), -s * (x * x + z * z), s * (y * z - w * x),
        s * (x * z - w * y), s * (y * z + w * x), -s * (x * x + y * y),
    )  # fmt: skip


@kernel
def _principal(q, axes, b):
    """Return the current principal axes of block ``b``, ``A = R Q``, row by row; ``Q`` is ``axes[b]``."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = _turn(q, b)
    xx += 1.0
    yy += 1.0
    zz += 1.0
    e = axes[b]
    return (
        xx * e[0, 0] + xy * e[1, 0] + xz * e[2, 0],
        xx * e[0, 1] + xy * e[1, 1] + xz * e[2, 1],
        xx * e[0, 2] + xy * e[1, 2] + xz * e[2, 2],
        yx * e[0, 0] + yy * e[1, 0] + yz * e[2, 0],
        yx * e[0, 1] + yy * e[1, 1] + yz * e[2, 1],
        yx * e[0, 2] + yy * e[1, 2] + yz * e[2, 2],
        zx * e[0, 0] + zy * e[1, 0] + zz * e[2, 0],
        zx * e[0, 1] + zy * e[1, 1] + zz * e[2, 1],
        zx * e[0, 2] + zy * e[1, 2] + zz * e[2, 2],
    )


@kernel
def _along(A, x, y, z):
    """Components ``A^T (x, y, z)`` along the axes."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = A
    return xx * x + yx * y + zx * z, xy * x + yy * y + zy * z, xz * x + yz * y + zz * z


@kernel
def _back(A, p, s, t):
    """Vector ``A (p, s, t)`` in global axes."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = A
    return xx * p + xy * s + xz * t, yx * p + yy * s + yz * t, zx * p + zy * s + zz * t


@kernel
def rigid_place(q, X, C, start, x):
    """Positions of all gridpoints, ``x = X + (c - C) + (R - 1)(X - C)``.

    ========  ===============  ==================================================
    q         (n, 7)           centroid [m] and quaternion [-]
    X         (n_gp, 3)        reference positions [m]
    C         (n, 3)           reference centroids [m]
    start     (n + 1,) int     gridpoints of block b: start[b] to start[b + 1]
    x         (n_gp, 3)        out: positions [m]
    ========  ===============  ==================================================
    """
    for b in range(q.shape[0]):
        xx, xy, xz, yx, yy, yz, zx, zy, zz = _turn(q, b)
        ux, uy, uz = q[b, 0] - C[b, 0], q[b, 1] - C[b, 1], q[b, 2] - C[b, 2]
        for i in range(start[b], start[b + 1]):
            rx, ry, rz = X[i, 0] - C[b, 0], X[i, 1] - C[b, 1], X[i, 2] - C[b, 2]
            x[i, 0] = X[i, 0] + (ux + (xx * rx + xy * ry + xz * rz))
            x[i, 1] = X[i, 1] + (uy + (yx * rx + yy * ry + yz * rz))
            x[i, 2] = X[i, 2] + (uz + (zx * rx + zy * ry + zz * rz))


@kernel
def rigid_push(q, v, X, C, start, xdot):
    """Velocities of all gridpoints, ``xdot = v + omega x r`` with ``r = R (X - C)``.

    ========  ===============  ==================================================
    q         (n, 7)           centroid [m] and quaternion [-]
    v         (n, 6)           velocity [m/s] and angular velocity [rad/s], global axes
    X, C      as in `rigid_place`
    start     (n + 1,) int     gridpoints of each block
    xdot      (n_gp, 3)        out: velocities [m/s]
    ========  ===============  ==================================================
    """
    for b in range(q.shape[0]):
        xx, xy, xz, yx, yy, yz, zx, zy, zz = _turn(q, b)
        ox, oy, oz = v[b, 3], v[b, 4], v[b, 5]
        for i in range(start[b], start[b + 1]):
            rx, ry, rz = X[i, 0] - C[b, 0], X[i, 1] - C[b, 1], X[i, 2] - C[b, 2]
            ax = rx + (xx * rx + xy * ry + xz * rz)
            ay = ry + (yx * rx + yy * ry + yz * rz)
            az = rz + (zx * rx + zy * ry + zz * rz)
            xdot[i, 0] = v[b, 0] + (oy * az - oz * ay)
            xdot[i, 1] = v[b, 1] + (oz * ax - ox * az)
            xdot[i, 2] = v[b, 2] + (ox * ay - oy * ax)


@kernel
def rigid_pull(q, f_gp, X, C, start, f):
    """Add gridpoint forces to force and moment about the centroid, the transpose of `rigid_push`.

    ========  ===============  ==================================================
    q         (n, 7)           centroid [m] and quaternion [-]
    f_gp      (n_gp, 3)        forces [N]
    X, C      as in `rigid_place`
    start     (n + 1,) int     gridpoints of each block
    f         (n, 6)           added to: force [N] and moment [N m], global axes
    ========  ===============  ==================================================
    """
    for b in range(q.shape[0]):
        xx, xy, xz, yx, yy, yz, zx, zy, zz = _turn(q, b)
        sx = sy = sz = tx = ty = tz = 0.0
        for i in range(start[b], start[b + 1]):
            rx, ry, rz = X[i, 0] - C[b, 0], X[i, 1] - C[b, 1], X[i, 2] - C[b, 2]
            ax = rx + (xx * rx + xy * ry + xz * rz)
            ay = ry + (yx * rx + yy * ry + yz * rz)
            az = rz + (zx * rx + zy * ry + zz * rz)
            fx, fy, fz = f_gp[i, 0], f_gp[i, 1], f_gp[i, 2]
            sx += fx
            sy += fy
            sz += fz
            tx += ay * fz - az * fy
            ty += az * fx - ax * fz
            tz += ax * fy - ay * fx
        f[b, 0] += sx
        f[b, 1] += sy
        f[b, 2] += sz
        f[b, 3] += tx
        f[b, 4] += ty
        f[b, 5] += tz


@kernel
def rigid_accelerate(q, f, mass, moments, axes, scale, a):
    """Accelerations ``(F / m, I(R)^-1 T)`` divided by ``scale``; no gyroscopic term, `rigid_advance` holds it.

    ========  ===============  ==================================================
    q         (n, 7)           centroid [m] and quaternion [-]
    f         (n, 6)           force [N] and moment [N m]
    mass      (n,)             [kg]
    moments   (n, 3)           principal moments of inertia [kg m^2]
    axes      (n, 3, 3)        principal axes at the start, in columns
    scale     (n,)             mass scaling [-]
    a         (n, 6)           out: [m/s^2], [rad/s^2]
    ========  ===============  ==================================================
    """
    for b in range(q.shape[0]):
        k = 1.0 / (scale[b] * mass[b])
        for j in range(3):
            a[b, j] = k * f[b, j]
        tx, ty, tz = f[b, 3], f[b, 4], f[b, 5]
        if tx == 0.0 and ty == 0.0 and tz == 0.0:
            a[b, 3] = a[b, 4] = a[b, 5] = 0.0
            continue
        A = _principal(q, axes, b)
        p, s, t = _along(A, tx, ty, tz)
        p /= scale[b] * moments[b, 0]
        s /= scale[b] * moments[b, 1]
        t /= scale[b] * moments[b, 2]
        a[b, 3], a[b, 4], a[b, 5] = _back(A, p, s, t)


@kernel
def _midpoint(p1, p2, p3, j1, j2, j3, h):
    """Half-turn vector ``tan(theta / 2) n`` of a free step ``h`` from the body momentum ``p``, in principal axes.

    Implicit midpoint rule ``m = p + (h a / 2) m x J^-1 m`` for the mean momentum m, Newton to round-off. The rotation
    that takes p to its image is the Cayley transform of ``h (a J^-1 m + b m) / 2`` whatever a and b are, so energy and
    momentum are exact for all of them. ``a = 1, b = 0`` is the plain rule; the values here remove its phase error of
    second order (Hairer & Vilmart, J. Phys. A 39 (2006) 13225, there for the discrete Moser-Veselov algorithm).
    """
    i1, i2, i3 = 1.0 / j1, 1.0 / j2, 1.0 / j3
    square = p1 * p1 + p2 * p2 + p3 * p3
    c = 0.5 * square
    e = 0.5 * (p1 * p1 * i1 + p2 * p2 * i2 + p3 * p3 * i3)
    product = i1 * i2 * i3
    a0 = 1.0 + h * h * ((j1 + j2 + j3) * product * c / 6.0 - (i1 + i2 + i3) * e / 3.0)
    b = h * h * product * ((j1 + j2 + j3) * e / 6.0 - c / 3.0)
    m1, m2, m3 = p1, p2, p3
    a = a0
    for _ in range(12):
        a = a0 + 0.25 * h * h * ((m1 * i1) ** 2 + (m2 * i2) ** 2 + (m3 * i3) ** 2)
        k = 0.5 * h * a
        d1, d2, d3 = k * (i3 - i2), k * (i1 - i3), k * (i2 - i1)
        r1 = p1 - m1 + d1 * m2 * m3
        r2 = p2 - m2 + d2 * m3 * m1
        r3 = p3 - m3 + d3 * m1 * m2
        # (1 - G) delta = r with the gradient G of the product terms, by Cramer's rule
        g12, g13 = -d1 * m3, -d1 * m2
        g21, g23 = -d2 * m3, -d2 * m1
        g31, g32 = -d3 * m2, -d3 * m1
        c1, c2, c3 = 1.0 - g23 * g32, g23 * g31 - g21, g21 * g32 - g31
        det = c1 + g12 * c2 + g13 * c3
        s1 = (c1 * r1 + (g13 * g32 - g12) * r2 + (g12 * g23 - g13) * r3) / det
        s2 = (c2 * r1 + (1.0 - g13 * g31) * r2 + (g13 * g21 - g23) * r3) / det
        s3 = (c3 * r1 + (g12 * g31 - g32) * r2 + (1.0 - g12 * g21) * r3) / det
        m1 += s1
        m2 += s2
        m3 += s3
        if s1 * s1 + s2 * s2 + s3 * s3 <= 1e-31 * square:
            break
    k = 0.5 * h
    return k * (a * i1 + b) * m1, k * (a * i2 + b) * m2, k * (a * i3 + b) * m3


@kernel
def _rotate(q, b, e, u1, u2, u3):
    """Turn block ``b`` by the half-turn vector ``u`` in the principal axes ``e`` of the start; keep it unit."""
    x = e[0, 0] * u1 + e[0, 1] * u2 + e[0, 2] * u3
    y = e[1, 0] * u1 + e[1, 1] * u2 + e[1, 2] * u3
    z = e[2, 0] * u1 + e[2, 1] * u2 + e[2, 2] * u3
    w, i, j, k = q[b, 3], q[b, 4], q[b, 5], q[b, 6]
    qw = w - (i * x + j * y + k * z)
    qx = i + (w * x + j * z - k * y)
    qy = j + (w * y + k * x - i * z)
    qz = k + (w * z + i * y - j * x)
    s = 1.0 / np.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    q[b, 3], q[b, 4], q[b, 5], q[b, 6] = s * qw, s * qx, s * qy, s * qz


@kernel
def _spin(A, j1, j2, j3, lx, ly, lz):
    """Angular velocity of the angular momentum ``L``.

    The axes are orthogonal to round-off only, and off always the same way: solved once, L would drift by it.
    """
    p1, p2, p3 = _along(A, lx, ly, lz)
    ox, oy, oz = _back(A, p1 / j1, p2 / j2, p3 / j3)
    p1, p2, p3 = _along(A, ox, oy, oz)
    ex, ey, ez = _back(A, j1 * p1, j2 * p2, j3 * p3)
    p1, p2, p3 = _along(A, lx - ex, ly - ey, lz - ez)
    ex, ey, ez = _back(A, p1 / j1, p2 / j2, p3 / j3)
    return ox + ex, oy + ey, oz + ez


@kernel
def rigid_advance(q, v, dt, moments, axes):
    """Move all blocks by ``dt`` at fixed momentum; the angular velocity changes so that ``L = I(R) omega`` does not.

    ========  ===============  ==================================================
    q         (n, 7)           in, out: centroid [m] and quaternion [-]
    v         (n, 6)           in, out: velocity [m/s], angular velocity [rad/s], global axes
    dt        float            step [s]
    moments   (n, 3)           principal moments of inertia [kg m^2]
    axes      (n, 3, 3)        principal axes at the start, in columns
    ========  ===============  ==================================================

    Steps in which the block or its momentum (in body axes) turns by more than half a radian are divided.
    """
    for b in range(q.shape[0]):
        for j in range(3):
            q[b, j] += dt * v[b, j]
        ox, oy, oz = v[b, 3], v[b, 4], v[b, 5]
        if ox == 0.0 and oy == 0.0 and oz == 0.0:
            continue
        j1, j2, j3 = moments[b, 0], moments[b, 1], moments[b, 2]
        A = _principal(q, axes, b)
        p1, p2, p3 = _along(A, ox, oy, oz)
        p1 *= j1
        p2 *= j2
        p3 *= j3
        lx, ly, lz = _back(A, p1, p2, p3)
        spread = 1.0 / min(j1, j2, j3) - 1.0 / max(j1, j2, j3)
        rate = max(np.sqrt(ox * ox + oy * oy + oz * oz), np.sqrt(p1 * p1 + p2 * p2 + p3 * p3) * spread)
        parts = 1
        if 2.0 * abs(dt) * rate > 1.0:
            parts = int(min(1000.0, np.ceil(2.0 * abs(dt) * rate)))
        for _ in range(parts):
            u1, u2, u3 = _midpoint(p1, p2, p3, j1, j2, j3, dt / parts)
            _rotate(q, b, axes[b], u1, u2, u3)
            # the momentum stays in space: read it again in the turned axes, whatever the iteration left
            A = _principal(q, axes, b)
            p1, p2, p3 = _along(A, lx, ly, lz)
        v[b, 3], v[b, 4], v[b, 5] = _spin(A, j1, j2, j3, lx, ly, lz)


@kernel
def _add_spring(point, centre, normal, straight, shear, turn, along, out):
    """Add a spring at `point` (normal stiffness `straight`, shear stiffness `shear`) to the (6, 6) matrix `out`.

    Scratch: `turn` (3, 6), motion of the point by translation (unit matrix) and rotation x arm; `along` (6,).
    """
    ax, ay, az = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    turn[0, 4], turn[1, 5], turn[2, 3] = az, ax, ay
    turn[0, 5], turn[1, 3], turn[2, 4] = -ay, -az, -ax
    for i in range(6):
        along[i] = normal[0] * turn[0, i] + normal[1] * turn[1, i] + normal[2] * turn[2, i]
        for j in range(i + 1):
            dot = turn[0, i] * turn[0, j] + turn[1, i] * turn[1, j] + turn[2, i] * turn[2, j]
            out[i, j] += shear * dot + (straight - shear) * along[i] * along[j]
            out[j, i] = out[i, j]


@kernel
def rigid_joints(gp, w, frame, kn, ks, x, gp_block, mobile, place, centre, out):
    """Stiffness (n_rigid, 6, 6) of contact rows against motions of each rigid block, twice between two mobile ones.

    ========  ============  ==================================================
    gp, w     (n, 7)        gridpoints and weights: three of the slave, four of the master
    frame     (n, 3, 3)     first row the normal of the master face
    kn, ks    (n,)          stiffness [N/m]; the larger all round where the faces are not parallel within 8 degrees
    x         (n_gp, 3)     positions [m]
    gp_block  (n_gp,)       block of each gridpoint
    mobile    (n_blocks,)   whether the block can move
    place     (n_blocks,)   place among the rigid blocks, -1: none
    centre    (n_rigid, 3)  centroids [m]
    out       (n_rigid, 6, 6)  added to
    ========  ============  ==================================================
    """
    point, own, turn, along = np.zeros(3), np.zeros(3), np.eye(3, 6), np.zeros(6)
    for row in range(len(gp)):
        sides = gp_block[gp[row, 0]], gp_block[gp[row, 3]]
        for d in range(3):
            point[d] = w[row, 0] * x[gp[row, 0], d] + w[row, 1] * x[gp[row, 1], d] + w[row, 2] * x[gp[row, 2], d]
            own[d] = 0.0
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
        for side in sides:
            if place[side] >= 0 and mobile[side]:
                _add_spring(
                    point, centre[place[side]], normal, twice * straight, twice * shear, turn, along, out[place[side]]
                )
