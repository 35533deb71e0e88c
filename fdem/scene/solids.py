"""Solids cut by solids: inside and outside in whole pieces, by convex parts and complements."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from fdem.errors import MeshError
from fdem.scene.clipping import components, divide, heights, pinched
from fdem.scene.polygons import area_vector, regions, trace
from fdem.scene.polyhedra import Polyhedron
from fdem.scene.pool import (
    Face,
    Plane,
    Pool,
    closed,
    cross,
    dot,
    faces_of,
    minus,
    plane_coordinates,
    ring_points,
    sides,
)

# a plane that touches a solid in a way no section can be made of is moved by this part of the block's size
NUDGE = 1e-6


Divided = tuple[Pool, list[list[Face]], list[list[Face]]]


def divide_safely(
    pool: Pool, piece: list[Face], plane: Plane, tag: str | None, size: float
) -> tuple[list[Face], list[Face], list[list[int]]]:
    """`divide`, with the plane moved a little where it grazes the solid in an unlucky way."""
    for shift in (0.0, NUDGE, -NUDGE, 3.0 * NUDGE, -3.0 * NUDGE):
        try:
            above, below, caps = divide(pool, piece, plane._replace(offset=plane.offset + shift * size), tag)
            if above and below:
                components(pool, above)
                components(pool, below)
            return above, below, caps
        except (MeshError, ZeroDivisionError) as error:
            problem = str(error)
    raise MeshError(f"a plane at {plane.origin} cannot cut a block of size {size:g}: {problem}")


def solids(pool: Pool, faces: list[Face], tag: str | None, size: float, depth: int = 0) -> list[list[Face]]:
    """Connected solids; one that touches itself in an edge is divided there along one of its faces."""
    out: list[list[Face]] = []
    for solid in components(pool, faces) if faces else []:
        edge = pinched(solid)
        halves: tuple[list[Face], list[Face]] = ([], [])
        for face in solid if edge is not None and depth < 12 else []:
            if edge in sides(face.loop) and not (halves[0] and halves[1]):
                halves = divide_safely(pool, solid, face_plane(pool, face), tag, size)[:2]
        if halves[0] and halves[1]:
            out += [part for half in halves for part in solids(pool, half, tag, size, depth + 1)]
        elif edge is not None:
            raise MeshError(f"a block touches itself in an edge at {pool.points[edge[0]]}")
        else:
            out.append(solid)
    return out


_PARTS: weakref.WeakKeyDictionary[Polyhedron, list[list[Plane]]] = weakref.WeakKeyDictionary()


def convex_parts(solid: Polyhedron) -> list[list[Plane]]:
    """Planes, outward, of convex parts that make up a solid; the same plane has the same bits in all."""
    if solid not in _PARTS:
        pool = Pool(solid)
        faces = faces_of(solid, pool)
        planes = [face_plane(pool, face) for face in faces]
        stack = [[Face(f.loop, str(i), i) for i, f in enumerate(faces)]]
        parts: list[list[Plane]] = []
        while stack:
            piece = stack.pop()
            number_of = _reflex_face(pool, piece, planes)
            if number_of is None:
                parts.append(_unique_planes(piece, planes))
                continue
            above, below, _ = divide_safely(pool, piece, planes[number_of], str(len(planes)), solid.size)
            x, y, z = planes[number_of].normal
            # caps close the part above with the reversed plane, the part below with the plane itself
            planes.append(planes[number_of]._replace(normal=(-x, -y, -z), offset=-planes[number_of].offset))
            flipped = [
                f._replace(tag=str(number_of)) if f.source == -1 and f.tag == str(len(planes) - 1) else f for f in below
            ]
            stack += components(pool, above) + components(pool, flipped)
        _PARTS[solid] = parts
    return _PARTS[solid]


def face_plane(pool: Pool, face: Face) -> Plane:
    """Outward plane of a face."""
    ring = [pool.points[v] for v in face.loop]
    x, y, z = area_vector(ring)
    length = float(np.sqrt(x * x + y * y + z * z))
    if length == 0.0:
        raise MeshError(f"a face of the cut at {ring[0]} has no area")
    return Plane(min(ring), (x / length, y / length, z / length))


def _unique_planes(piece: Sequence[Face], planes: list[Plane]) -> list[Plane]:
    """The planes of a convex piece, once each."""
    return list(dict.fromkeys(planes[int(face.tag or 0)] for face in piece))


def _reflex_face(pool: Pool, piece: list[Face], planes: list[Plane]) -> int | None:
    """Number of a face's plane that has vertices of its own solid in front of it, None for a convex one.

    Of all such planes the one is taken that divides the solid most evenly.
    """
    best: tuple[float, int] | None = None
    for k in sorted({int(face.tag or 0) for face in piece}):
        d = heights(pool, piece, planes[k]).values()
        low, high = min(d), max(d)
        if high > 0.0 and low < 0.0:
            score = min(high, -low)
            if best is None or score > best[0]:
                best = (score, k)
    return best[1] if best else None


def inside_outside(shape: Polyhedron, parts: list[list[Plane]], tag: str | None) -> Divided:
    """Solids of a shape outside and inside all convex parts of a cutter, each in one piece."""
    pool = Pool(shape)
    block = faces_of(shape, pool)
    outside = [block]
    inside: list[list[Face]] = []
    for planes in parts:
        left: list[list[Face]] = []
        for piece in outside:
            core, rest = _taken(pool, piece, planes, tag)
            inside += [core] if core else []
            left += rest
        outside = left
    if len(parts) > 1:
        outside = _merged(pool, outside, len(shape.points))
    if len(inside) > 1 and outside:
        # several convex parts meet inside the cutter: the inside in one piece is what the outside leaves
        inside = [complement(pool, block, [face for piece in outside for face in piece])]
    return (
        pool,
        [solid for piece in outside for solid in solids(pool, piece, tag, shape.size)],
        [solid for piece in inside for solid in solids(pool, piece, tag, shape.size)],
    )


def cells(shape: Polyhedron, parts: list[list[Plane]], tag: str | None) -> Divided:
    """Solids of a shape outside and inside the convex parts of a cutter, divided along all planes of the parts."""
    pool = Pool(shape)
    outside = [faces_of(shape, pool)]
    inside: list[list[Face]] = []
    for planes in parts:
        left: list[list[Face]] = []
        for piece in outside:
            core = [piece]
            for plane in planes:
                halves = [divide_safely(pool, solid, plane, tag, shape.size)[:2] for solid in core]
                left += [solid for above, _ in halves for solid in solids(pool, above, tag, shape.size)]
                core = [solid for _, below in halves for solid in solids(pool, below, tag, shape.size)]
            inside += core
        outside = left
    return pool, outside, inside


def _taken(
    pool: Pool, piece: list[Face], planes: Iterable[Plane], tag: str | None
) -> tuple[list[Face], list[list[Face]]]:
    """What of a solid lies within planes, and the solids that are left; sources stay those of the block."""
    sources = [face.source for face in piece]
    local = [face._replace(source=i) for i, face in enumerate(piece)]
    core = local
    for plane in planes:
        core = [face for part in components(pool, core) for face in divide(pool, part, plane, tag)[1]]
        if not core:
            return [], [piece]
    rest = complement(pool, local, core)

    def named(faces: Iterable[Face]) -> list[Face]:
        return [f._replace(source=sources[f.source] if f.source >= 0 else -1) for f in faces]

    return named(core), [named(part) for part in components(pool, rest)] if rest else []


def complement(pool: Pool, base: list[Face], part: list[Face]) -> list[Face]:
    """What is left of a solid without a part that was cut out of it by planes.

    Parameters
    ----------
    pool : Pool
        The vertices of both.
    base : list of Face
        The solid; ``base[i].source == i``.
    part : list of Face
        A part of it; `source` tells the face of `base` a face lies on, -1 a cut.

    Returns
    -------
    list of Face
        Closed surface: the faces of the solid without those of the part, and the part's caps turned
        round. Faces stay whole polygons, no cut runs beyond the part.
    """
    vertices = {v for face in base for v in face.loop}
    edges = {(min(a, b), max(a, b)) for face in base for a, b in sides(face.loop)}
    locate = _locator(pool, vertices, edges)
    on_edge: dict[tuple[int, int], list[int]] = {}
    lost: dict[int, list[Face]] = {}
    for v in sorted({v for face in part for v in face.loop}):
        edge = locate(v)
        if edge is not None:
            on_edge.setdefault(edge, []).append(v)
    for face in part:
        lost.setdefault(face.source, []).append(face)
    out = [Face(face.loop[::-1], face.tag, -1) for face in lost.get(-1, [])]
    for i, face in enumerate(base):
        loop: list[int] = []
        for a, b in sides(face.loop):
            inside = on_edge.get((min(a, b), max(a, b)), [])
            start = pool.points[a]
            away = {v: dot(r, r) for v in inside for r in [minus(pool.points[v], start)]}
            loop += [a, *sorted(inside, key=away.__getitem__)]
        if i in lost:
            out += [Face(rest, face.tag, i) for rest in _difference(pool, face, loop, lost[i])]
        else:
            out.append(Face(loop, face.tag, i))
    if not closed(out):
        raise MeshError("the surface left by a closed cutter does not close")
    return out


def _difference(pool: Pool, face: Face, loop: list[int], removed: list[Face]) -> list[list[int]]:
    """Loops of a plane face without parts of it; common edges are split at the same vertices."""
    edges = set(sides(loop))
    for gone in removed:
        for a, b in sides(gone.loop):
            if (a, b) in edges:
                edges.discard((a, b))
            else:
                edges.add((b, a))
    if not edges:
        return []
    xy = plane_coordinates(pool, sorted({v for e in edges for v in e}), area_vector(ring_points(pool, face)))
    return regions(trace(sorted(edges), xy), xy)


def _locator(pool: Pool, vertices: set[int], edges: set[tuple[int, int]]) -> Callable[[int], tuple[int, int] | None]:
    """A function that names the edge of a solid a cut's vertex was made on, None for other vertices."""
    known: dict[int, tuple[int, int] | None] = {}

    def locate(v: int) -> tuple[int, int] | None:
        if v in vertices or v not in pool.parents:
            return None
        if v not in known:
            # an edge may have been met again after it had been divided: look at all it was made on
            known[v] = None
            # in order and no further than needed: later ones may refer back to this vertex
            through = (_edge_through(a, b) for a, b in pool.parents[v])
            known[v] = next((edge for edge in through if edge is not None and _inside(pool, v, *edge)), None)
        return known[v]

    def _edge_through(a: int, b: int) -> tuple[int, int] | None:
        if a in vertices and b in vertices:
            key = (min(a, b), max(a, b))
            return key if key in edges else None
        # one end at least lies inside the edge
        at = [(p, None if p in vertices else locate(p)) for p in (a, b)]
        edge = next((e for _, e in at if e is not None), None)
        fits = edge is not None and all(e == edge or (e is None and p in edge) for p, e in at)
        return edge if fits else None

    return locate


def _inside(pool: Pool, v: int, a: int, b: int) -> bool:
    """Whether a vertex on the line through a and b lies between them."""
    edge, away = minus(pool.points[b], pool.points[a]), minus(pool.points[v], pool.points[a])
    return 0.0 < dot(edge, away) < dot(edge, edge)


def _merged(pool: Pool, pieces: list[list[Face]], first_new: int) -> list[list[Face]]:
    """Pieces whose caps are whole polygons again where convex parts of a cutter had divided them."""
    joined = [[f for f in piece if f.source >= 0] + _merged_caps(pool, piece) for piece in pieces]
    around: dict[int, list[tuple[int, int]]] = {}
    for piece in joined:
        for face in piece:
            for k, v in enumerate(face.loop):
                around.setdefault(v, []).append((face.loop[k - 1], face.loop[(k + 1) % len(face.loop)]))
    straight: set[int] = set()
    for v, neighbours in sorted(around.items()):
        if v >= first_new and len(neighbours) == 2 and set(neighbours[0]) == set(neighbours[1]):
            a, b = neighbours[0]
            if not {a, b} & straight and _between(pool, v, a, b):
                straight.add(v)
    return [[face._replace(loop=[v for v in face.loop if v not in straight]) for face in piece] for piece in joined]


def _between(pool: Pool, v: int, a: int, b: int) -> bool:
    """Whether a vertex lies on the straight line between two others."""
    edge, away = minus(pool.points[b], pool.points[a]), minus(pool.points[v], pool.points[a])
    off = cross(edge, away)
    return dot(off, off) <= pool.tolerance**2 * dot(edge, edge)


def _merged_caps(pool: Pool, piece: list[Face]) -> list[Face]:
    """The caps of a piece, those in one plane that share edges joined."""
    caps = [face for face in piece if face.source < 0]
    normals = [face_plane(pool, face).normal for face in caps]
    owner = {edge: i for i, face in enumerate(caps) for edge in sides(face.loop)}
    group = list(range(len(caps)))
    changed = True
    while changed:
        changed = False
        for (a, b), i in owner.items():
            j = owner.get((b, a), i)
            # parallel to 1e-6 rad
            if group[i] != group[j] and dot(normals[i], normals[j]) > 1.0 - 5e-13:
                group[i] = group[j] = min(group[i], group[j])
                changed = True
    out: list[Face] = []
    for k in sorted(set(group)):
        members = [face for face, g in zip(caps, group, strict=True) if g == k]
        if len(members) == 1:
            out += members
            continue
        edges = {edge for face in members for edge in sides(face.loop)}
        rest = sorted((a, b) for a, b in edges if (b, a) not in edges)
        xy = plane_coordinates(pool, sorted({v for e in rest for v in e}), normals[caps.index(members[0])])
        out += [Face(loop, members[0].tag, -1) for loop in regions(trace(rest, xy), xy)]
    return out
