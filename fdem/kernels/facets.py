"""Spheres against faces of blocks: where a sphere touches a surface of convex polygons.

A contact is a point of the surface nearest to the centre among the points around it (a local minimum of the distance):
inside a face, on an edge or at a vertex. What a face reports counts only if no face that holds the same point comes
nearer; so an edge or vertex between two faces gives one force, or none where a face gives it already. Contacts of one
sphere with one block whose normals differ by less than 26 degrees are one: the deepest. So a sphere that rolls over the
facets of a surface, flat or curved, feels one contact, and in a true corner one with either side.
"""

from __future__ import annotations

import math

import numpy as np

from fdem._jit import kernel

SAME = 0.9  # cosine above which two contacts of a sphere with a block are one
ON = 1e-7  # of the radius: distance at which a point lies on a face
MOST = 64  # faces of one block looked at for one sphere, nearest first


@kernel
def place_faces(ref, corner_start, corner_w, x, corner_x, normal):
    """Corners (n_corners, 3) [m] and outward unit normals (n, 3) of faces in the positions `x`.

    ============  ==============  ==================================================
    ref           (n, 3)          reference gridpoints
    corner_start  (n + 1,)        corners of each face, counter-clockwise from outside
    corner_w      (n_corners, 2)  weights of the second and third reference gridpoint
    ============  ==============  ==================================================
    """
    for f in range(len(ref)):
        a, b, c = ref[f, 0], ref[f, 1], ref[f, 2]
        ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
        normal[f, 0], normal[f, 1], normal[f, 2] = nx * scale, ny * scale, nz * scale
        for k in range(corner_start[f], corner_start[f + 1]):
            s, t = corner_w[k, 0], corner_w[k, 1]
            corner_x[k, 0] = x[a, 0] + s * ux + t * vx
            corner_x[k, 1] = x[a, 1] + s * uy + t * vy
            corner_x[k, 2] = x[a, 2] + s * uz + t * vz


@kernel
def frame_faces(ref, corner_start, corner_x, normal, x, side, across):
    """Outward directions (n_corners, 3) of the edges that start at corners, and what `_inside` needs, of placed faces.

    `across` (n, 6): gradients of the barycentric weights of the second and third reference gridpoint [1/m].
    """
    for f in range(len(ref)):
        nx, ny, nz = normal[f, 0], normal[f, 1], normal[f, 2]
        lo, hi = corner_start[f], corner_start[f + 1]
        for k in range(lo, hi):
            j = k + 1 if k + 1 < hi else lo
            ax, ay, az = corner_x[k, 0], corner_x[k, 1], corner_x[k, 2]
            tx, ty, tz = corner_x[j, 0] - ax, corner_x[j, 1] - ay, corner_x[j, 2] - az
            side[k, 0], side[k, 1], side[k, 2] = ty * nz - tz * ny, tz * nx - tx * nz, tx * ny - ty * nx
        a, b, c = ref[f, 0], ref[f, 1], ref[f, 2]
        uu = uv = vv = 0.0
        for d in range(3):
            u, v = x[b, d] - x[a, d], x[c, d] - x[a, d]
            uu += u * u
            uv += u * v
            vv += v * v
        det = uu * vv - uv * uv
        for d in range(3):
            u, v = x[b, d] - x[a, d], x[c, d] - x[a, d]
            across[f, d], across[f, 3 + d] = (vv * u - uv * v) / det, (uu * v - uv * u) / det


@kernel(inline=True)
def _inside(px, py, pz, lo, hi, corner_x, side):
    """Whether a point lies over a face."""
    for k in range(lo, hi):
        rx, ry, rz = px - corner_x[k, 0], py - corner_x[k, 1], pz - corner_x[k, 2]
        if rx * side[k, 0] + ry * side[k, 1] + rz * side[k, 2] > 0.0:
            return False
    return True


@kernel
def _nearest(lo, hi, corner_x, nx, ny, nz, px, py, pz, height, out):
    """Point of a face nearest to p, which stands `height` over its plane: written to `out`; squared distance [m2]."""
    qx, qy, qz = px - height * nx, py - height * ny, pz - height * nz
    best = np.inf
    for k in range(lo, hi):
        j = k + 1 if k + 1 < hi else lo
        ax, ay, az = corner_x[k, 0], corner_x[k, 1], corner_x[k, 2]
        tx, ty, tz = corner_x[j, 0] - ax, corner_x[j, 1] - ay, corner_x[j, 2] - az
        rx, ry, rz = qx - ax, qy - ay, qz - az
        # outside this edge: the nearest point of the face lies on such an edge
        if rx * (ty * nz - tz * ny) + ry * (tz * nx - tx * nz) + rz * (tx * ny - ty * nx) > 0.0:
            s = (rx * tx + ry * ty + rz * tz) / (tx * tx + ty * ty + tz * tz)
            s = min(max(s, 0.0), 1.0)
            ex, ey, ez = rx - s * tx, ry - s * ty, rz - s * tz
            away = ex * ex + ey * ey + ez * ez
            if away < best:
                best = away
                out[0], out[1], out[2] = ax + s * tx, ay + s * ty, az + s * tz
    if best == np.inf:
        out[0], out[1], out[2] = qx, qy, qz
        return height * height
    return best + height * height


@kernel
def _holds(lo, hi, corner_x, nx, ny, nz, point, tolerance):
    """Whether a point lies on a face."""
    ax, ay, az = corner_x[lo, 0], corner_x[lo, 1], corner_x[lo, 2]
    if abs((point[0] - ax) * nx + (point[1] - ay) * ny + (point[2] - az) * nz) > tolerance:
        return False
    for k in range(lo, hi):
        j = k + 1 if k + 1 < hi else lo
        ax, ay, az = corner_x[k, 0], corner_x[k, 1], corner_x[k, 2]
        tx, ty, tz = corner_x[j, 0] - ax, corner_x[j, 1] - ay, corner_x[j, 2] - az
        rx, ry, rz = point[0] - ax, point[1] - ay, point[2] - az
        out = rx * (ty * nz - tz * ny) + ry * (tz * nx - tx * nz) + rz * (tx * ny - ty * nx)
        if out > tolerance * math.sqrt(tx * tx + ty * ty + tz * tz):
            return False
    return True


@kernel
def _candidates(px, py, pz, r, lo, hi, face, corner_start, corner_x, normal, spot, found, point, away):
    """Faces that come within `r` of p, nearest first: row, nearest point, squared distance; returns how many."""
    m = 0
    for q in range(lo, hi):
        f = face[q]
        first = corner_start[f]
        nx, ny, nz = normal[f, 0], normal[f, 1], normal[f, 2]
        height = (px - corner_x[first, 0]) * nx + (py - corner_x[first, 1]) * ny + (pz - corner_x[first, 2]) * nz
        if not (0.0 < height < r):
            continue
        square = _nearest(first, corner_start[f + 1], corner_x, nx, ny, nz, px, py, pz, height, spot)
        if not square < r * r or (m == MOST and square >= away[m - 1]):
            continue
        k = m if m < MOST else m - 1
        while k > 0 and away[k - 1] > square:
            found[k], away[k] = found[k - 1], away[k - 1]
            for d in range(3):
                point[k, d] = point[k - 1, d]
            k -= 1
        found[k], away[k] = q, square
        for d in range(3):
            point[k, d] = spot[d]
        m = min(m + 1, MOST)
    return m


@kernel
def _accept(m, px, py, pz, r, face, corner_start, corner_x, normal, found, point, away, chosen, direction, most):
    """Which candidates are contacts (top of file): their numbers in `chosen`, normals to the face; returns how many."""
    count = 0
    for k in range(m):
        distance = math.sqrt(away[k])
        dx, dy, dz = (point[k, 0] - px) / distance, (point[k, 1] - py) / distance, (point[k, 2] - pz) / distance
        new = count < most
        for j in range(count):
            if dx * direction[j, 0] + dy * direction[j, 1] + dz * direction[j, 2] > SAME:
                new = False
        for j in range(k):
            if not new:
                break
            f = face[found[j]]
            if away[j] < away[k] * (1.0 - ON) and _holds(
                corner_start[f],
                corner_start[f + 1],
                corner_x,
                normal[f, 0],
                normal[f, 1],
                normal[f, 2],
                point[k],
                ON * r,
            ):
                new = False
        if new:
            chosen[count] = k
            direction[count, 0], direction[count, 1], direction[count, 2] = dx, dy, dz
            count += 1
    return count


@kernel(inline=True)
def _weights(f, ref, x, across, point, w):
    """Barycentric weights of a point in the plane of a face in its three reference gridpoints."""
    a = ref[f, 0]
    second = third = 0.0
    for d in range(3):
        s = point[d] - x[a, d]
        second += s * across[f, d]
        third += s * across[f, 3 + d]
    w[0], w[1], w[2] = 1.0 - second - third, second, third


@kernel
def _rotation(f, ref, x, x_old, out):
    """Rotation vector of a face since the last commit [rad], into `out` (3,)."""
    a, b, c = ref[f, 0], ref[f, 1], ref[f, 2]
    u, v, du, dv, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for d in range(3):
        u[d], v[d] = x[b, d] - x[a, d], x[c, d] - x[a, d]
        du[d], dv[d] = u[d] - (x_old[b, d] - x_old[a, d]), v[d] - (x_old[c, d] - x_old[a, d])
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        n[i] = u[j] * v[k] - u[k] * v[j]
    area = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
    up, vp, about, uu = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        up += du[i] * n[i]
        vp += dv[i] * n[i]
        about += n[i] * (u[j] * du[k] - u[k] * du[j])
        uu += u[i] * u[i]
    # with the normal m = n / |n|: du.m = w.(u x m), dv.m = w.(v x m), so w = (u (dv.m) - v (du.m)) / |n| + about m
    for d in range(3):
        out[d] = (u[d] * vp - v[d] * up) / area + about * n[d] / (area * uu)


@kernel
def touch(
    at, start, face, face_kind, slot_start, place, motion, ref, moves, corner_start, corner_x, normal, side, across, x,
    x_old, memory_old, active, geometry, kind, source, candidate, weight, out,
):  # fmt: skip
    """Contacts of spheres with faces, and what they go on from.

    =================  ============  ==========================================================================
    at                 (n,)          packed place of the sphere of each group (a sphere and a block)
    start              (n + 1,)      candidates of a group
    face, face_kind    (m,)          face and row of `table` of each candidate
    slot_start         (n + 1,)      rows of a group's contacts
    place, motion                    packed spheres (kernels/spheres.py)
    ref, corner_start, corner_x, normal, side, across  faces
    moves              (n_faces,)    whether a face can move
    x, x_old           (n_gp, 3)     positions now and at the last commit [m]
    memory_old         (k, 9)        committed history of the rows: s [m], r, z, normal, k_t
    active             (k,) uint8    out
    geometry           (k, 12)       out, see `face_forces`; rotation of the sphere against the face in 9-11 [rad]
    kind, source       (k,)          out: row of `table`; row of history, -1: new
    candidate, weight  (k,), (k, 3)  out: candidate; weights of the reference gridpoints of its face at the contact
    out                (1,)          energy of shear springs that are no more [J], added to
    =================  ============  ==========================================================================
    """
    found, point, away, spot = np.empty(MOST, np.int64), np.empty((MOST, 3)), np.empty(MOST), np.empty(3)
    chosen, direction = np.empty(MOST, np.int64), np.empty((MOST, 3))
    for g in range(len(at)):
        a, first, last = at[g], slot_start[g], slot_start[g + 1]
        px, py, pz, r = place[a, 0], place[a, 1], place[a, 2], place[a, 3]
        for k in range(first, last):
            active[k], source[k] = 0, -1
        q = start[g]
        m = count = 0
        if start[g + 1] == q + 1:
            # mostly: one face, and the sphere over its inside
            f = face[q]
            k, nx, ny, nz = corner_start[f], normal[f, 0], normal[f, 1], normal[f, 2]
            height = (px - corner_x[k, 0]) * nx + (py - corner_x[k, 1]) * ny + (pz - corner_x[k, 2]) * nz
            if not (0.0 < height < r):
                m = -1
            elif _inside(px, py, pz, k, corner_start[f + 1], corner_x, side):
                m, count, chosen[0], found[0], away[0] = -1, 1, 0, q, height * height
                point[0, 0], point[0, 1], point[0, 2] = px - height * nx, py - height * ny, pz - height * nz
                direction[0, 0], direction[0, 1], direction[0, 2] = -nx, -ny, -nz
        if m == 0:
            m = _candidates(
                px, py, pz, r, q, start[g + 1], face, corner_start, corner_x, normal, spot, found, point, away
            )  # fmt: skip
        if m > 0:
            count = _accept(
                m, px, py, pz, r, face, corner_start, corner_x, normal, found, point, away, chosen, direction,
                last - first,
            )  # fmt: skip
        for j in range(count):
            k, q = first + j, found[chosen[j]]
            f = face[q]
            active[k], kind[k], candidate[k] = 1, face_kind[q], q
            nx, ny, nz = direction[j, 0], direction[j, 1], direction[j, 2]
            arm = math.sqrt(away[chosen[j]])
            _weights(f, ref, x, across, point[chosen[j]], weight[k])
            ox, oy, oz = motion[a, 3], motion[a, 4], motion[a, 5]
            geometry[k, 0], geometry[k, 1], geometry[k, 2], geometry[k, 3] = nx, ny, nz, r - arm
            geometry[k, 4] = motion[a, 0] + arm * (oy * nz - oz * ny)
            geometry[k, 5] = motion[a, 1] + arm * (oz * nx - ox * nz)
            geometry[k, 6] = motion[a, 2] + arm * (ox * ny - oy * nx)
            for c in range(3 if moves[f] else 0):
                for d in range(3):
                    geometry[k, 4 + d] -= weight[k, c] * (x[ref[f, c], d] - x_old[ref[f, c], d])
            if moves[f]:
                _rotation(f, ref, x, x_old, spot)
            else:
                spot[0] = spot[1] = spot[2] = 0.0
            geometry[k, 7] = 0.5 * ((ox + spot[0]) * nx + (oy + spot[1]) * ny + (oz + spot[2]) * nz)
            geometry[k, 8] = arm
            geometry[k, 9], geometry[k, 10], geometry[k, 11] = ox - spot[0], oy - spot[1], oz - spot[2]
        _go_on(first, last, count, direction, memory_old, source, out)


@kernel(inline=True)
def _go_on(first, last, count, direction, memory_old, source, out):
    """Give each contact of a group the history of the one whose normal is nearest; count what is left over as lost."""
    for k in range(first, last):
        if memory_old[k, 3] == 0.0:
            continue
        best, most = -1, SAME
        for j in range(count):
            if source[first + j] >= 0:
                continue
            cosine = 0.0
            for d in range(3):
                cosine += direction[j, d] * memory_old[k, 5 + d]
            if cosine > most:
                best, most = j, cosine
        if best >= 0:
            source[first + best] = k
        else:
            length = memory_old[k, 0] ** 2 + memory_old[k, 1] ** 2 + memory_old[k, 2] ** 2
            out[0] += 0.5 * memory_old[k, 8] * memory_old[k, 3] * length


@kernel
def spread(active, candidate, weight, face, ref, push, f_gp):
    """Add forces on faces [N] to their gridpoints (arguments: `touch`; `push` (k, 3) [N], `f_gp` (n_gp, 3) [N])."""
    for k in range(len(active)):
        if active[k]:
            f = face[candidate[k]]
            for c in range(3):
                g = ref[f, c]
                for d in range(3):
                    f_gp[g, d] += weight[k, c] * push[k, d]


@kernel
def swept(at, start, face, place, motion, corner_start, corner_x, normal):
    """First group whose sphere moved by more than half its radius in a step in which it met a face; -1: none."""
    spot = np.empty(3)
    for g in range(len(at)):
        a = at[g]
        r = place[a, 3]
        ux, uy, uz = motion[a, 0], motion[a, 1], motion[a, 2]
        length = math.sqrt(ux * ux + uy * uy + uz * uz)
        if not length > 0.5 * r:
            continue
        parts = int(min(4.0 * length / r, 1000.0)) + 1
        for q in range(start[g], start[g + 1]):
            f = face[q]
            first = corner_start[f]
            nx, ny, nz = normal[f, 0], normal[f, 1], normal[f, 2]
            for k in range(parts + 1):
                s = 1.0 - k / parts  # from the start of the step to its end
                px, py, pz = place[a, 0] - s * ux, place[a, 1] - s * uy, place[a, 2] - s * uz
                height = (
                    (px - corner_x[first, 0]) * nx + (py - corner_x[first, 1]) * ny + (pz - corner_x[first, 2]) * nz
                )
                if k == 0 and height <= 0.0:
                    break
                if _nearest(first, corner_start[f + 1], corner_x, nx, ny, nz, px, py, pz, height, spot) < r * r:
                    return g
    return -1
