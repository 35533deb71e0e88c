"""Masses of Voronoi cells clipped to a tetrahedral mesh: convex clipping, tetrahedron by tetrahedron.

The cell of a gridpoint is the part of the body that is closer to it than to any other gridpoint of the body.
Inside one tetrahedron it is convex: the tetrahedron cut by bisecting planes. A gridpoint that is not one of the
four nodes owns a part only if it is closest at a vertex of one of the four nodes' parts (the region where it is
closer is a half-space), so looking at those vertices finds every owner, also where the mesh is obtuse or not
Delaunay.
"""

from __future__ import annotations

import numpy as np

from fdem._jit import kernel

_MAX_FACES = 160
_MAX_VERTICES = 320


@kernel
def _start_tetrahedron(corners, points, loops, length):
    """Set up the tetrahedron (4, 3), positively oriented, as four outward loops."""
    for a in range(4):
        for c in range(3):
            points[a, c] = corners[a, c]
    loops[0, 0], loops[0, 1], loops[0, 2] = 0, 2, 1
    loops[1, 0], loops[1, 1], loops[1, 2] = 0, 1, 3
    loops[2, 0], loops[2, 1], loops[2, 2] = 1, 2, 3
    loops[3, 0], loops[3, 1], loops[3, 2] = 2, 0, 3
    length[0] = length[1] = length[2] = length[3] = 3


@kernel
def _add_caps(loops, length, cap_next, cuts, faces, base):
    """Close a cut: every cut edge is entered once and left once, the caps are the cycles of that permutation.

    Returns the new number of faces, -1 if the arrays overflow.
    """
    for start in range(cuts):
        if cap_next[start] < 0:
            continue
        if faces >= loops.shape[0]:
            return -1
        kept = 0
        c = start
        while cap_next[c] >= 0:
            if kept >= loops.shape[1]:
                return -1
            loops[faces, kept] = base + c
            kept += 1
            after = cap_next[c]
            cap_next[c] = -1
            c = after
        if kept > 2:
            length[faces] = kept
            faces += 1
    return faces


@kernel
def _drop_outside(points, loops, length, count, total, faces, side, new_id):
    """Renumber the vertices that are left: those inside and those on cut edges."""
    base = count[0]
    n = 0
    for i in range(total):
        if i >= base or side[i] <= 0.0:
            new_id[i] = n
            for d in range(3):
                points[n, d] = points[i, d]
            n += 1
    for f in range(faces):
        for k in range(length[f]):
            loops[f, k] = new_id[loops[f, k]]
    count[0], count[1] = n, faces


@kernel
def _clip(points, loops, length, count, px, py, pz, nx, ny, nz, side, scratch):
    """Keep the part of a convex polyhedron with ``(x - p).n <= 0``.

    ``count`` holds the numbers of vertices and faces. New vertices are known by the edge they lie on, never by
    their coordinates, so that the faces stay closed in degenerate cuts. Returns False if the arrays overflow.
    """
    outside = 0
    for i in range(count[0]):
        side[i] = (points[i, 0] - px) * nx + (points[i, 1] - py) * ny + (points[i, 2] - pz) * nz
        if side[i] > 0.0:
            outside += 1
    if outside == 0:
        return True
    if outside == count[0]:
        count[0] = count[1] = 0
        return True
    edge_in, edge_out, cap_next, new_id = scratch[0], scratch[1], scratch[2], scratch[3]
    row = scratch[4]
    cuts = 0
    faces = 0
    base = count[0]
    for f in range(count[1]):
        m = length[f]
        kept = 0
        leave = first_enter = -1
        for k in range(m):
            i = loops[f, k]
            j = loops[f, k + 1 if k + 1 < m else 0]
            if side[i] <= 0.0:
                row[kept] = i
                kept += 1
            if (side[i] <= 0.0) != (side[j] <= 0.0):
                a, b = (i, j) if side[i] <= 0.0 else (j, i)
                c = 0
                while c < cuts and not (edge_in[c] == a and edge_out[c] == b):
                    c += 1
                if c == cuts:
                    if base + cuts >= points.shape[0]:
                        return False
                    t = side[a] / (side[a] - side[b])
                    for d in range(3):
                        points[base + c, d] = points[a, d] + t * (points[b, d] - points[a, d])
                    edge_in[c], edge_out[c] = a, b
                    cuts += 1
                row[kept] = base + c
                kept += 1
                # the cap runs against the new edge of this face; round-off may let a face cross more than once
                if side[i] <= 0.0:
                    leave = c
                elif leave >= 0:
                    cap_next[c] = leave
                    leave = -1
                else:
                    first_enter = c
        if first_enter >= 0:
            cap_next[first_enter] = leave
        if kept == 0:
            continue
        if kept > loops.shape[1]:
            return False
        for k in range(kept):
            loops[faces, k] = row[k]
        length[faces] = kept
        faces += 1
    faces = _add_caps(loops, length, cap_next, cuts, faces, base)
    if faces < 0:
        return False
    _drop_outside(points, loops, length, count, base + cuts, faces, side, new_id)
    return True


@kernel
def _volume(points, loops, length, count):
    """Volume of a closed polyhedron, fans of its faces seen from its first vertex."""
    if count[1] == 0:
        return 0.0
    ox, oy, oz = points[0, 0], points[0, 1], points[0, 2]
    total = 0.0
    for f in range(count[1]):
        i = loops[f, 0]
        ax, ay, az = points[i, 0] - ox, points[i, 1] - oy, points[i, 2] - oz
        for k in range(1, length[f] - 1):
            i, j = loops[f, k], loops[f, k + 1]
            bx, by, bz = points[i, 0] - ox, points[i, 1] - oy, points[i, 2] - oz
            cx, cy, cz = points[j, 0] - ox, points[j, 1] - oy, points[j, 2] - oz
            total += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return total / 6.0


@kernel
def _grid(X, n_cells, lower, width, cell_start, cell_points):
    """Sort gridpoints into the cells of a uniform grid (counting sort)."""
    n = X.shape[0]
    cell = np.empty(n, dtype=np.int64)
    for i in range(n):
        index = 0
        for d in range(3):
            k = int((X[i, d] - lower[d]) / width[d])
            index = index * n_cells[d] + min(max(k, 0), n_cells[d] - 1)
        cell[i] = index
        cell_start[index + 1] += 1
    for k in range(cell_start.size - 1):
        cell_start[k + 1] += cell_start[k]
    fill = cell_start.copy()
    for i in range(n):
        cell_points[fill[cell[i]]] = i
        fill[cell[i]] += 1


@kernel
def voronoi_masses(X, nodes, density, n_cells, lower, width, mass):
    """Add ``int density dV`` over the clipped Voronoi cells of one block to its gridpoints.

    ==============  ==================  =========================================================
    X               (n, 3)              gridpoints of the block [m]
    nodes           (m, 4) int32        its zones, positively oriented
    density         (m,)                [kg/m^3]
    n_cells         (3,) int64          search grid: cells along x, y, z
    lower, width    (3,)                its corner and cell edges [m]
    mass            (n,) in, out        [kg]
    return          int                 -1, or the zone with too many neighbours
    ==============  ==================  =========================================================
    """
    cell_start = np.zeros(n_cells[0] * n_cells[1] * n_cells[2] + 1, dtype=np.int64)
    cell_points = np.empty(X.shape[0], dtype=np.int64)
    _grid(X, n_cells, lower, width, cell_start, cell_points)
    corners, points = np.empty((4, 3)), np.empty((_MAX_VERTICES, 3))
    loops, length = np.empty((_MAX_FACES, _MAX_FACES), dtype=np.int64), np.empty(_MAX_FACES, dtype=np.int64)
    scratch, side = np.empty((5, _MAX_VERTICES), dtype=np.int64), np.empty(_MAX_VERTICES)
    count = np.empty(2, dtype=np.int64)
    vertices, owner_square = np.empty((4 * _MAX_VERTICES, 3)), np.empty(4 * _MAX_VERTICES)
    owners, volumes = np.empty(X.shape[0] + 4, dtype=np.int64), np.empty(X.shape[0] + 4)
    local = np.empty((X.shape[0] + 4, 3))
    for e in range(nodes.shape[0]):
        origin = X[nodes[e, 0]]
        for a in range(4):
            for d in range(3):
                corners[a, d] = X[nodes[e, a], d] - origin[d]
                local[a, d] = corners[a, d]
            owners[a] = nodes[e, a]
        n_owners = 4
        # first the parts of the four nodes among themselves; then of everybody who is closer at one of their vertices
        for attempt in range(2):
            n_vertices = 0
            reach = 0.0
            for a in range(n_owners):
                count[0] = count[1] = 4
                _start_tetrahedron(corners, points, loops, length)
                for b in range(n_owners):
                    if b != a and not _bisect(points, loops, length, count, local[a], local[b], side, scratch):
                        return e
                volumes[a] = _volume(points, loops, length, count)
                for i in range(count[0] if attempt == 0 else 0):
                    square = 0.0
                    for d in range(3):
                        vertices[n_vertices, d] = points[i, d]
                        square += (points[i, d] - local[a, d]) ** 2
                    owner_square[n_vertices] = square * (1.0 - 1e-12)
                    reach = max(reach, square)
                    n_vertices += 1
            if attempt == 1:
                break
            n_owners = _find_owners(
                X,
                nodes[e],
                origin,
                corners,
                np.sqrt(reach),
                vertices,
                owner_square,
                n_vertices,
                n_cells,
                lower,
                width,
                cell_start,
                cell_points,
                owners,
                local,
            )
            if n_owners == 4:
                break
        for a in range(n_owners):
            mass[owners[a]] += density[e] * volumes[a]
    return -1


@kernel
def _bisect(points, loops, length, count, a, b, side, scratch):
    """Keep what is closer to a than to b."""
    return _clip(
        points,
        loops,
        length,
        count,
        0.5 * (a[0] + b[0]),
        0.5 * (a[1] + b[1]),
        0.5 * (a[2] + b[2]),
        b[0] - a[0],
        b[1] - a[1],
        b[2] - a[2],
        side,
        scratch,
    )


@kernel
def _find_owners(
    X,
    tet,
    origin,
    corners,
    reach,
    vertices,
    owner_square,
    n_vertices,
    n_cells,
    lower,
    width,
    cell_start,
    cell_points,
    owners,
    local,
):
    """Append to ``owners`` the gridpoints nearer to some part's vertex than the owner of that part."""
    n_owners = 4
    first, last = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    for d in range(3):
        low = min(min(corners[0, d], corners[1, d]), min(corners[2, d], corners[3, d])) - reach + origin[d]
        high = max(max(corners[0, d], corners[1, d]), max(corners[2, d], corners[3, d])) + reach + origin[d]
        first[d] = min(max(int((low - lower[d]) / width[d]), 0), n_cells[d] - 1)
        last[d] = min(max(int((high - lower[d]) / width[d]), 0), n_cells[d] - 1)
    for cx in range(first[0], last[0] + 1):
        for cy in range(first[1], last[1] + 1):
            row = (cx * n_cells[1] + cy) * n_cells[2]
            for k in range(cell_start[row + first[2]], cell_start[row + last[2] + 1]):
                p = cell_points[k]
                if p == tet[0] or p == tet[1] or p == tet[2] or p == tet[3]:
                    continue
                px, py, pz = X[p, 0] - origin[0], X[p, 1] - origin[1], X[p, 2] - origin[2]
                for v in range(n_vertices):
                    dx, dy, dz = vertices[v, 0] - px, vertices[v, 1] - py, vertices[v, 2] - pz
                    if dx * dx + dy * dy + dz * dz < owner_square[v]:
                        owners[n_owners] = p
                        local[n_owners, 0], local[n_owners, 1], local[n_owners, 2] = px, py, pz
                        n_owners += 1
                        break
    return n_owners
