"""Rolling and twisting resistance of contacts of spheres: elastic-plastic couples.

A length l of the law stands for the half width of the contact: springs k at the distance l resist a rotation with
``k l^2``, and the contact would tip about its edge at the couple ``l N``, the limit. Rolling takes the secant stiffness
of the normal spring, K r, twisting that of the shear spring, k_t r (kernels/spheres.py). The rotations that the springs
hold obey the rule of the elastic slip: they turn with the contact, and shrink where it gets stiffer.

| shared argument | shape | |
|---|---|---|
| kind, table | | as in kernels/spheres.py; columns 9 and 10 are the rolling and the twisting length [m] |
| normal force | (m,) | column 0 of a record [N] |
| old, new | (m, 6) | committed and trial: rotations of rolling (0-2) and twisting (3) [rad], their stiffness over r |
| force | (n, 6) | moments in 3-5 are added to [N m] |
| out | (1,) | work of friction [J], added to |
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel


@kernel
def _energy(root, held):
    """Energy [J] of the springs of one contact."""
    rolled = held[0] * held[0] + held[1] * held[1] + held[2] * held[2]
    return 0.5 * root * (held[4] * rolled + held[5] * held[3] * held[3])


@kernel
def _couple(dx, dy, dz, nx, ny, nz, about, root, old_root, row, pressing, held, moment):
    """Couple on the first side of one contact, into `moment` (3,); `held` (6,) goes from old to new. Returns the work.

    (dx, dy, dz) is the rotation of the first side against the other since the last commit, `about` that of the pair
    about the normal, `row` of the table, `pressing` the normal force [N].
    """
    for c in range(3):
        moment[c] = 0.0
    grown = min(old_root / root, 1.0)
    twist = dx * nx + dy * ny + dz * nz
    rolling, twisting = row[9], row[10]
    lost = _energy(old_root, held)
    kr, kw = row[0] * rolling * rolling, row[1] * twisting * twisting
    held[4], held[5] = kr, kw
    if rolling > 0.0:
        s0, s1, s2 = held[0], held[1], held[2]
        length = s0 * s0 + s1 * s1 + s2 * s2
        along = s0 * nx + s1 * ny + s2 * nz
        s0, s1, s2 = s0 - along * nx, s1 - along * ny, s2 - along * nz
        b0, b1, b2 = (
            s0 + about * (ny * s2 - nz * s1), s1 + about * (nz * s0 - nx * s2), s2 + about * (nx * s1 - ny * s0)
        )  # fmt: skip
        flat = b0 * b0 + b1 * b1 + b2 * b2
        scale = math.sqrt(length / flat) if flat > 0.0 else 0.0
        ex, ey, ez = dx - twist * nx, dy - twist * ny, dz - twist * nz
        lost += 0.5 * kr * old_root * scale * (b0 * ex + b1 * ey + b2 * ez)
        scale *= grown
        s0, s1, s2 = b0 * scale + ex, b1 * scale + ey, b2 * scale + ez
        length = math.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
        share = min(1.0, rolling * pressing / (kr * root * length)) if length > 0.0 else 0.0
        held[0], held[1], held[2] = s0 * share, s1 * share, s2 * share
        lost += 0.5 * kr * root * (held[0] * ex + held[1] * ey + held[2] * ez)
        for c in range(3):
            moment[c] -= kr * root * held[c]
    if twisting > 0.0:
        lost += 0.5 * kw * old_root * held[3] * twist
        most = twisting * pressing / (kw * root)
        held[3] = min(max(held[3] * grown + twist, -most), most)
        lost += 0.5 * kw * root * held[3] * twist
        moment[0] -= kw * root * held[3] * nx
        moment[1] -= kw * root * held[3] * ny
        moment[2] -= kw * root * held[3] * nz
    return lost - _energy(root, held)


@kernel
def pair_couples(place, motion, start, partner, kind, table, memory_old, memory, record, old, new, force, out):
    """Couples of all pairs of spheres (top of file), after `pair_forces` with the same arguments and a record."""
    moment = np.zeros(3)
    for a in range(len(start) - 1):
        for k in range(start[a], start[a + 1]):
            b = partner[k]
            row = table[kind[k]]
            for c in range(6):
                new[k, c] = old[k, c]
            root = memory[k, 3]
            if root == 0.0:
                out[0] += _energy(memory_old[k, 3], old[k])
                for c in range(6):
                    new[k, c] = 0.0
                continue
            nx, ny, nz = place[b, 0] - place[a, 0], place[b, 1] - place[a, 1], place[b, 2] - place[a, 2]
            scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
            nx, ny, nz = nx * scale, ny * scale, nz * scale
            ax, ay, az = motion[a, 3], motion[a, 4], motion[a, 5]
            bx, by, bz = motion[b, 3], motion[b, 4], motion[b, 5]
            about = 0.5 * ((ax + bx) * nx + (ay + by) * ny + (az + bz) * nz)
            out[0] += _couple(
                ax - bx, ay - by, az - bz, nx, ny, nz, about, root, memory_old[k, 3], row, record[k, 0], new[k], moment
            )
            for c in range(3):
                force[a, 3 + c] += moment[c]
                force[b, 3 + c] -= moment[c]


@kernel
def face_couples(
    at, active, geometry, kind, table, memory_old, source, memory, record, old, new, force, couple, out
):  # fmt: skip
    """Couples of contacts of spheres with faces; `couple` (k, 3) is that on the face [N m] (see `face_forces`)."""
    moment, gone = np.zeros(3), np.ones(len(old), np.bool_)
    for k in range(len(at)):
        for c in range(6):
            new[k, c] = 0.0
        for c in range(3):
            couple[k, c] = 0.0
        if not active[k]:
            continue
        root, old_root = memory[k, 3], 0.0
        if source[k] >= 0:
            old_root = memory_old[source[k], 3]
            gone[source[k]] = False
            for c in range(6):
                new[k, c] = old[source[k], c]
        nx, ny, nz = geometry[k, 0], geometry[k, 1], geometry[k, 2]
        out[0] += _couple(
            geometry[k, 9], geometry[k, 10], geometry[k, 11], nx, ny, nz, geometry[k, 7], root, old_root,
            table[kind[k]], record[k, 0], new[k], moment,
        )  # fmt: skip
        for c in range(3):
            force[at[k], 3 + c] += moment[c]
            couple[k, c] = -moment[c]
    for k in range(len(at)):
        if gone[k] and memory_old[k, 3] > 0.0:
            out[0] += _energy(memory_old[k, 3], old[k])


@kernel
def spread_couples(active, candidate, face, ref, couple, x, f_gp):
    """Add couples on faces [N m] to the three reference gridpoints of each, as forces [N] that sum to zero."""
    r, inertia, force = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for k in range(len(active)):
        if not active[k]:
            continue
        f = face[candidate[k]]
        for d in range(3):
            middle = (x[ref[f, 0], d] + x[ref[f, 1], d] + x[ref[f, 2], d]) / 3.0
            for c in range(3):
                r[c, d] = x[ref[f, c], d] - middle
        for i in range(3):
            for j in range(3):
                inertia[i, j] = 0.0
                for c in range(3):
                    square = r[c, 0] * r[c, 0] + r[c, 1] * r[c, 1] + r[c, 2] * r[c, 2] if i == j else 0.0
                    inertia[i, j] += square - r[c, i] * r[c, j]
        spin = np.linalg.solve(inertia, couple[k])
        for c in range(3):
            force[0] = spin[1] * r[c, 2] - spin[2] * r[c, 1]
            force[1] = spin[2] * r[c, 0] - spin[0] * r[c, 2]
            force[2] = spin[0] * r[c, 1] - spin[1] * r[c, 0]
            for d in range(3):
                f_gp[ref[f, c], d] += force[d]


@kernel
def stored_couples(memory, held):
    """Energy of rolling and twisting springs [J] of contacts with history `memory` (m, 4 or more), held (m, 6)."""
    energy = 0.0
    for k in range(len(held)):
        energy += _energy(memory[k, 3], held[k])
    return energy
