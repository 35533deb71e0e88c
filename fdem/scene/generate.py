"""Generators of shapes: bricks, prisms, hulls, spheres of triangles, arches, walls, Voronoi blocks."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from fdem.errors import MeshError, SceneError
from fdem.scene.checks import number, vector
from fdem.scene.measures import COINCIDENT, Shape
from fdem.scene.polygons import Array, area_vector
from fdem.scene.shapes import Polyhedron, Surface, TetMesh
from fdem.scene.voronoi import voronoi

__all__ = [
    "arch",
    "brick",
    "convex_hull",
    "icosphere",
    "polyhedron",
    "prism",
    "surface",
    "tet_mesh",
    "voronoi",
    "wall",
]


# corners of a box, x fastest, and its faces seen from outside
BOX = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


def brick(lower: Any, upper: Any) -> Polyhedron:
    """Axis-aligned box.

    Parameters
    ----------
    lower, upper : (3,) array_like
        Opposite corners [m], `lower` below `upper` in every axis.

    Returns
    -------
    Polyhedron
        Six faces.

    Raises
    ------
    SceneError
        If `lower` is not below `upper`.
    """
    low, high = vector("brick", "lower", lower), vector("brick", "upper", upper)
    if not (low < high).all():
        raise SceneError(f"brick: lower = {low.tolist()} must be below upper = {high.tolist()} in every axis")
    corners = [(x, y, z) for z in (low[2], high[2]) for y in (low[1], high[1]) for x in (low[0], high[0])]
    return Polyhedron(corners, BOX)


def prism(polygon: Any, depth: float, axis: str = "y") -> Polyhedron:
    """A polygon extruded along an axis.

    Parameters
    ----------
    polygon : (n, 2) array_like
        Simple polygon [m], convex or not, either way round, in the other two axes: (y, z), (x, z) or
        (x, y) for `axis` "x", "y" or "z".
    depth : float
        The prism reaches from 0 to `depth` along +axis [m], > 0.
    axis : {"x", "y", "z"}, optional
        Direction of extrusion.

    Returns
    -------
    Polyhedron
        The two polygons and a quadrilateral on every side.

    Raises
    ------
    SceneError
        If the polygon crosses itself or an argument is out of range.
    """
    number("prism", "depth", depth, low=0.0, open_low=True)
    if axis not in ("x", "y", "z"):
        raise SceneError(f"prism: axis = {axis!r}, allowed are 'x', 'y' and 'z'")
    try:
        outline = np.array(polygon, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError("prism: polygon must be numbers of shape (n, 2)") from None
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3:
        raise SceneError(f"prism: polygon must have shape (n, 2) with n >= 3, not {outline.shape}")
    if not np.isfinite(outline).all():
        raise MeshError(f"prism: polygon[{int(np.argwhere(~np.isfinite(outline))[0, 0])}] is not finite")
    if (outline[0] == outline[-1]).all():
        outline = outline[:-1]
    n, along = len(outline), "xyz".index(axis)
    _check_simple(outline)
    points = np.zeros((2 * n, 3))
    points[:n, [k for k in range(3) if k != along]] = outline
    points[n:] = points[:n]
    points[n:, along] = depth
    ring = list(range(n))
    # the outline has to turn the positive way about the axis
    if area_vector(points[:n].tolist())[along] < 0.0:
        ring.reverse()
    sides = [[a, b, b + n, a + n] for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]
    return Polyhedron(points, [ring[::-1], [k + n for k in ring], *sides])


def polyhedron(points: Any, faces: Sequence[Sequence[int]]) -> Polyhedron:
    """A closed polyhedron from vertices and vertex loops, see `Polyhedron`.

    Parameters
    ----------
    points : (n, 3) array_like
        Vertices [m].
    faces : sequence of sequences of int
        Vertex loops, counter-clockwise from outside, convex or not.

    Returns
    -------
    Polyhedron
        Checked; an inside-out surface is turned with an `FdemWarning`.

    Raises
    ------
    MeshError
        If the surface is open, overlaps itself or is degenerate.
    """
    return Polyhedron(points, faces)


def surface(points: Any, faces: Sequence[Sequence[int]]) -> Surface:
    """An open surface (terrain), for fixed rigid blocks only, see `Surface`.

    Parameters
    ----------
    points : (n, 3) array_like
        Vertices [m].
    faces : sequence of sequences of int
        Vertex loops, counter-clockwise seen from the side that blocks touch.

    Returns
    -------
    Surface
        Checked.
    """
    return Surface(points, faces)


def tet_mesh(points: Any, tets: Any) -> TetMesh:
    """A block whose zones the user brings, see `TetMesh`.

    Parameters
    ----------
    points : (n, 3) array_like
        Vertices [m].
    tets : (m, 4) array_like of int
        Tetrahedra, either orientation.

    Returns
    -------
    TetMesh
        Checked.
    """
    return TetMesh(points, tets)


def convex_hull(points: Any) -> Polyhedron:
    """Convex polyhedron around points; coplanar triangles are merged to polygons.

    Parameters
    ----------
    points : (n, 3) array_like
        At least four points that are not in one plane [m]; doubled ones do no harm.

    Returns
    -------
    Polyhedron
        The hull.

    Raises
    ------
    MeshError
        If the points are flat or not finite.
    """
    from scipy.spatial import ConvexHull, QhullError

    cloud = np.array(points, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or not np.isfinite(cloud).all():
        raise MeshError(f"convex_hull: points must be finite and of shape (n, 3), not {cloud.shape}")
    lower = cloud.min(axis=0)
    scale = float((cloud.max(axis=0) - lower).max()) or 1.0
    try:
        hull = ConvexHull((cloud - lower) / scale)
    except (QhullError, ValueError):
        raise MeshError(f"convex_hull: the {len(cloud)} points lie in one plane or are too few") from None
    used = np.unique(hull.simplices)
    corners = np.searchsorted(used, hull.simplices)
    local = (cloud[used] - lower) / scale
    normals = np.cross(local[corners[:, 1]] - local[corners[:, 0]], local[corners[:, 2]] - local[corners[:, 0]])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0.0
    corners[inward] = corners[inward][:, ::-1]
    loops = _merged(local, corners.tolist(), hull.equations, hull.neighbors)
    return Polyhedron(cloud[used], loops)


def icosphere(radius: float, centre: Any = (0.0, 0.0, 0.0), subdivisions: int = 2) -> Polyhedron:
    """Faceted sphere: an icosahedron, each triangle divided in four `subdivisions` times.

    Parameters
    ----------
    radius : float
        Of the sphere through the vertices [m].
    centre : (3,) array_like, optional
        [m].
    subdivisions : int, optional
        0 is the icosahedron, 2 has 320 faces.

    Returns
    -------
    Polyhedron
        ``20 * 4**subdivisions`` triangles.
    """
    number("icosphere", "radius", radius, low=0.0, open_low=True)
    middle = vector("icosphere", "centre", centre)
    if isinstance(subdivisions, bool) or not isinstance(subdivisions, (int, np.integer)) or not 0 <= subdivisions <= 6:
        raise SceneError(f"icosphere: subdivisions = {subdivisions!r}, allowed is an integer from 0 to 6")
    golden = (1.0 + 5.0**0.5) / 2.0
    points = [np.roll([0.0, a, b * golden], k) for k in range(3) for b in (-1.0, 1.0) for a in (-1.0, 1.0)]
    points = [p / np.linalg.norm(p) for p in points]
    edge = min(float(np.linalg.norm(points[0] - p)) for p in points[1:]) * 1.01
    near = [[float(np.linalg.norm(p - q)) < edge for q in points] for p in points]
    faces = [
        (i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i][j] and near[j][k] and near[i][k]
    ]
    faces = [f if np.linalg.det(np.array([points[v] for v in f])) > 0.0 else f[::-1] for f in faces]
    for _ in range(subdivisions):
        faces = _quartered(points, faces)
    return Polyhedron(middle + float(radius) * np.array(points), faces)


def arch(span: float, rise: float, thickness: float, depth: float, n: int) -> list[Shape]:
    """Circular arch of `n` voussoirs with plane faces and radial joints.

    Parameters
    ----------
    span, rise : float
        Of the circular centreline [m]; the springing line is z = 0, the arch is centred on x = 0.
    thickness : float
        Radial [m].
    depth : float
        The arch fills 0 <= y <= depth [m].
    n : int
        Number of voussoirs, from -x to +x.

    Returns
    -------
    list of Polyhedron
        Neighbours share their joint's vertices exactly. Intrados and extrados are chords of their circles.

    Raises
    ------
    SceneError
        If an argument is out of range, or the arch is thicker than its circle allows.
    """
    for field, value in (("span", span), ("rise", rise), ("thickness", thickness), ("depth", depth)):
        number("arch", field, value, low=0.0, open_low=True)
    if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 1:
        raise SceneError(f"arch: n = {n!r}, allowed is an integer >= 1")
    radius = (0.25 * span * span + rise * rise) / (2.0 * rise)
    if 0.5 * thickness >= radius:
        raise SceneError(
            f"arch: thickness = {thickness!r} must be less than twice the radius {radius:g} of the centreline"
        )
    half = np.arctan2(0.5 * span, radius - rise)
    if n * np.pi <= 2.0 * half:
        raise SceneError(f"arch: n = {n!r} is too few, a voussoir would span more than a half turn")
    # written so that left and right are mirror images to the last bit
    angles = half * ((2.0 * np.arange(n + 1) - n) / n)
    joints = np.empty((n + 1, 4, 3))
    for k, (r, y) in enumerate([(-0.5, 0.0), (0.5, 0.0), (-0.5, depth), (0.5, depth)]):
        joints[:, k, 0] = (radius + r * thickness) * np.sin(angles)
        joints[:, k, 1] = y
        joints[:, k, 2] = (radius + r * thickness) * np.cos(angles) + (rise - radius)
    # a voussoir is a box: from joint to joint, inwards to outwards, front to back
    order = [0, 4, 2, 6, 1, 5, 3, 7]
    return [Polyhedron(np.concatenate([a, b])[order], BOX) for a, b in itertools.pairwise(joints)]


def wall(length: float, height: float, thickness: float, brick: Sequence[float]) -> list[Shape]:
    """Wall in running bond in the x-z plane, half bricks at the ends of every second course.

    Parameters
    ----------
    length, height, thickness : float
        The wall fills 0 <= x <= length, 0 <= y <= thickness, 0 <= z <= height [m].
    brick : (2,) sequence
        Length and height of a brick [m]; both are adjusted a little so that whole bricks fill the wall.

    Returns
    -------
    list of Polyhedron
        Course by course from below, each from -x to +x.

    Raises
    ------
    SceneError
        If an argument is out of range.
    """
    for field, value in (("length", length), ("height", height), ("thickness", thickness)):
        number("wall", field, value, low=0.0, open_low=True)
    size = vector("wall", "brick", brick, sizes=(2, 3))
    if not (size > 0.0).all():
        raise SceneError(f"wall: brick = {size.tolist()}, allowed are lengths > 0")
    # with three numbers the middle one is the thickness, which the wall already gives
    along, courses = max(1, round(length / size[0])), max(1, round(height / size[-1]))
    # joints of both kinds of course on one grid of half bricks, so that they have the same bits
    x = length * (np.arange(2 * along + 1) / (2 * along))
    z = height * (np.arange(courses + 1) / courses)
    out: list[Shape] = []
    for course in range(courses):
        ends = list(range(0, 2 * along + 1, 2)) if course % 2 == 0 else [0, *range(1, 2 * along, 2), 2 * along]
        for a, b in itertools.pairwise(ends):
            out.append(_box((x[a], 0.0, z[course]), (x[b], thickness, z[course + 1])))
    return out


def _box(lower: Sequence[float], upper: Sequence[float]) -> Polyhedron:
    corners = [(x, y, z) for z in (lower[2], upper[2]) for y in (lower[1], upper[1]) for x in (lower[0], upper[0])]
    return Polyhedron.trusted(np.array(corners), BOX, [None] * 6)


def _check_simple(outline: Array) -> None:
    """Refuse a polygon with doubled vertices or edges that cross."""
    n = len(outline)
    tolerance = COINCIDENT * float((outline.max(axis=0) - outline.min(axis=0)).max())
    close = np.triu(np.abs(outline[:, None] - outline[None]).max(axis=2) <= tolerance, 1)
    if close.any():
        i, j = np.argwhere(close)[0]
        raise MeshError(f"prism: polygon[{i}] and polygon[{j}] are duplicates")
    ahead = np.roll(outline, -1, axis=0)

    def side(p: Array, q: Array, r: Array) -> Array:
        a, b = q - p, r - p
        return np.sign(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])

    p, q = outline[:, None], ahead[:, None]
    r, s = outline[None], ahead[None]
    crosses = (side(p, q, r) * side(p, q, s) < 0.0) & (side(r, s, p) * side(r, s, q) < 0.0)
    if crosses.any():
        i, j = np.argwhere(crosses)[0]
        raise MeshError(f"prism: polygon crosses itself, edge {i}-{(i + 1) % n} and edge {j}-{(j + 1) % n}")


def _merged(points: Array, triangles: list[list[int]], equations: Array, neighbours: Array) -> list[list[int]]:
    """Loops of a hull's triangles merged where they are coplanar (points of size one)."""
    group = [-1] * len(triangles)
    loops: list[list[int]] = []
    for first in range(len(triangles)):
        if group[first] >= 0:
            continue
        group[first] = first
        stack, members = [first], [first]
        while stack:
            for other in neighbours[stack.pop()].tolist():
                apart = np.abs(points[triangles[other]] @ equations[first, :3] + equations[first, 3]).max()
                if group[other] < 0 and apart < COINCIDENT:
                    group[other] = first
                    stack.append(other)
                    members.append(other)
        edges = {(t[k - 1], t[k]) for m in members for t in [triangles[m]] for k in range(3)}
        following = {a: b for a, b in edges if (b, a) not in edges}
        start = min(following)
        loop, here = [start], following[start]
        while here != start:
            loop.append(here)
            here = following[here]
        loops.append(loop)
    return loops


def _quartered(points: list[Array], faces: list[tuple[int, int, int]]) -> list[tuple[int, int, int]]:
    """Triangles on the unit sphere divided in four; new points are appended."""
    middle: dict[tuple[int, int], int] = {}

    def half(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in middle:
            p = points[a] + points[b]
            points.append(p / np.linalg.norm(p))
            middle[key] = len(points) - 1
        return middle[key]

    out = []
    for a, b, c in faces:
        ab, bc, ca = half(a, b), half(b, c), half(c, a)
        out += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return out
