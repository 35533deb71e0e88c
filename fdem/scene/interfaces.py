"""Which parts of their faces blocks have in common: every face divided into cells that two blocks share.

Faces that are the same polygon are one cell. Where a cut stopped at a joint, or bricks are laid in bond, a face
meets several faces of its neighbours: it is divided along their edges, and nodes that an edge gets on the way are
nodes of all faces there, so that every block stays closed. Where that would make cells much finer than the zones
asked for, or where neither block asks for a size, such faces are left to meshes of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from fdem.errors import MeshError
from fdem.scene.overlay import Nodes, aligned, candidates, clearance, contains, crossings, touching
from fdem.scene.polygons import area_vector, plane_basis, regions, trace, triangulate

__all__ = ["Interfaces", "cell_key", "edges_of"]

Array = Any
Segment = tuple[int, int]
Frame = tuple[Array, Array, Array]

_SAME_POINT = 1e-9  # of the size of the scene: vertices of neighbours that are one point
_ROUND_OFF = 8.0 * float(np.finfo(np.float64).eps)
_FLAT = 1e-6  # of the size of a face: beyond that it is divided into its triangles
_FINE = 0.2  # of the smaller of zone size and face: cells finer than that are not made
_OWN = 0.7  # of the clearance of the faces as they are: nor much finer than these
_OVERLAP = 1e-3  # of the smaller face: less than that in common is no joint
_LOST = 1e-6  # of a face: its cells must cover it to this part


@dataclass
class _Face:
    """A flat face of a block, as a loop of shared point numbers."""

    block: int
    number: int
    loop: list[int]
    normal: Array = None
    area: float = 0.0
    scale: float = 0.0  # smaller of zone size and square root of the area [m]
    clear: float = 0.0  # clearance [m]


@dataclass
class _Link:
    """Two faces in one plane that look against each other."""

    a: int
    b: int
    frame: Frame  # a point of the plane and two axes; face `a` turns counter-clockwise there
    limit: float  # clearance that the common cells must have [m]
    area: float = 0.0
    events: list[tuple[Segment, int]] = field(default_factory=list)


class Interfaces:
    """Cells of the faces of a set of polyhedra.

    Parameters
    ----------
    shapes : sequence of Polyhedron
        The blocks.
    sizes : sequence of float
        Target zone edge of each [m]; ``inf``: none.

    Attributes
    ----------
    points : list of (3,) array
        Vertices of all blocks, those that are the same point once, and places where edges cross [m].
    ids : list of list of int
        Point of every vertex of each block.
    faces : list of list of (list of int, int)
        Per block the loops of its flat faces with their numbers in the polyhedron; faces that are not flat by
        triangles.
    cells : list of list of list of list of int
        Per block and flat face the cells as loops of points, turning as the face does.
    nodes : Nodes
        Points that lie inside the edges of faces.
    shared, separate : int
        Cells that two blocks have in common; pairs of overlapping faces that keep meshes of their own.
    """

    def __init__(self, shapes: Sequence[Any], sizes: Sequence[float]) -> None:
        self._number(shapes)
        every = [self._flat_faces(shape, k) for k, shape in enumerate(shapes)]
        self._flat = [face for faces in every for face in faces]
        self.faces = [[(face.loop, face.number) for face in faces] for faces in every]
        self._corners: Any = None
        self._known: dict[Any, list[list[int]]] = {}
        self._along: dict[Any, list[tuple[int, int]]] = {}
        self._parts: dict[Any, tuple[list[list[int]], set[int]]] = {}
        links = self._links(sizes)
        self.separate = sum(link.limit == np.inf for link in links)
        self._links_kept = {k: link for k, link in enumerate(links) if link.limit < np.inf}
        divided = self._settled()
        found = iter(divided[k] if k in divided else [self.nodes.expanded(f.loop)] for k, f in enumerate(self._flat))
        self.cells = [[next(found) for _ in faces] for faces in every]

    # ------------------------------------------------------------------ points and faces

    def _number(self, shapes: Sequence[Any]) -> None:
        """Give vertices of different blocks that are the same point one number."""
        points = np.concatenate([shape.points for shape in shapes])
        start = np.concatenate([[0], np.cumsum([len(shape.points) for shape in shapes])])
        extent = float(np.ptp(points, axis=0).max())
        self.tolerance = _SAME_POINT * extent + _ROUND_OFF * float(np.abs(points).max())
        root = np.arange(len(points))
        if len(shapes) > 1:
            from scipy.spatial import cKDTree

            pairs = cKDTree(points).query_pairs(self.tolerance, output_type="ndarray")
            if len(pairs):
                from scipy.sparse import coo_matrix
                from scipy.sparse.csgraph import connected_components

                graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
                root = connected_components(graph, directed=False)[1]
        _, first, ids = np.unique(root, return_index=True, return_inverse=True)
        self.points: list[Array] = list(points[first])
        self.ids = [ids[a:b].tolist() for a, b in pairwise(start)]

    def places(self, ids: Iterable[int]) -> Array:
        """Places (n, 3) of points [m]."""
        return np.array([self.points[k] for k in ids])

    def _flat_faces(self, shape: Any, block: int) -> list[_Face]:
        faces = []
        for number, face in enumerate(shape.faces):
            loop = [self.ids[block][v] for v in face]
            loop = [v for k, v in enumerate(loop) if v != loop[k - 1]]
            if len(loop) < 3:
                continue
            if len(loop) == 3 or self._is_flat(loop):
                faces.append(_Face(block, number, loop))
                continue
            for corners in triangulate(self.places(loop).tolist()):
                faces.append(_Face(block, number, [loop[k] for k in corners]))
        return faces

    def _is_flat(self, loop: list[int]) -> bool:
        points = self.places(loop)
        normal = np.array(area_vector(points.tolist()))
        heights = (points - points.mean(axis=0)) @ normal
        return bool(np.ptp(heights) <= _FLAT * np.linalg.norm(normal) * np.ptp(points, axis=0).max())

    # ------------------------------------------------------------------ faces against faces

    def _links(self, sizes: Sequence[float]) -> list[_Link]:
        """Overlaps of faces that are not the same polygon; limit ``inf``: too fine to be used."""
        owners: dict[tuple[int, ...], list[int]] = {}
        for k, face in enumerate(self._flat):
            owners.setdefault(cell_key(face.loop), []).append(k)
        self.shared = sum(len(found) > 1 for found in owners.values())
        alone = []
        for k in sorted(k for found in owners.values() if len(found) == 1 for k in found):
            face, ring = self._flat[k], self.places(self._flat[k].loop)
            vector = np.array(area_vector(ring.tolist()))
            face.area = float(np.linalg.norm(vector))
            if face.area > 0.0:
                alone.append(k)
                face.normal = vector / face.area
                face.scale = min(sizes[face.block], np.sqrt(face.area))
                face.clear = clearance(ring)
        rings = [self.places(self._flat[k].loop) for k in alone]
        pairs = candidates(
            np.array([ring.min(axis=0) for ring in rings]),
            np.array([ring.max(axis=0) for ring in rings]),
            np.array([self._flat[k].normal for k in alone]),
            np.array([self._flat[k].block for k in alone]),
            self.tolerance,
        )
        pairs = [(alone[i], alone[j]) for i, j in pairs]
        # two blocks that ask for no size stay as coarse as they can be
        asked = np.isfinite([sizes[face.block] for face in self._flat])
        return [link for a, b in pairs if asked[a] or asked[b] for link in self._link(a, b)]

    def _link(self, a: int, b: int) -> list[_Link]:
        """The overlap of two faces, if they lie in one plane and have something in common."""
        one, two = self._flat[a], self._flat[b]
        large, small = (one, two) if one.area >= two.area else (two, one)
        origin = self.points[large.loop[0]]
        if np.abs((self.places(small.loop) - origin) @ large.normal).max() > 2.0 * self.tolerance:
            return []
        u, v = plane_basis(large.normal if large is one else -large.normal)
        limit = min(_FINE * min(one.scale, two.scale), _OWN * max(one.clear, two.clear))
        link = _Link(a, b, (origin, u, v), limit)
        self._meet(link)
        nodes = Nodes(self.points, self.tolerance)
        for segment, node in link.events:
            nodes.add(segment, node, frozenset())
        try:
            cells = self._common(-1, link, nodes)
        except MeshError:
            return []
        rings = [self._drop(link.frame, cell) for cell in cells]
        link.area = sum(abs(_area(ring)) for ring in rings)
        if link.area < _OVERLAP * small.area:
            return []
        if min(clearance(ring) for ring in rings) < link.limit:
            link.limit = np.inf
        return [link]

    def _drop(self, frame: Frame, loop: Iterable[int]) -> Array:
        """Coordinates (n, 2) in a plane [m]."""
        origin, u, v = frame
        relative = self.places(loop) - origin
        return np.column_stack([relative @ u, relative @ v])

    def _meet(self, link: _Link) -> None:
        """Nodes that the edges of two faces give each other."""
        loops = self._flat[link.a].loop, self._flat[link.b].loop
        segments = [edges_of(loop) for loop in loops]
        plane = [self._drop(link.frame, loop) for loop in loops]
        for own, other in ((0, 1), (1, 0)):
            p = plane[own]
            on = touching(plane[other], p, np.roll(p, -1, axis=0), self.tolerance)
            link.events += [(segments[own][j], loops[other][i]) for i, j in np.argwhere(on).tolist()]
        for i, j in crossings(plane[0], plane[1], self.tolerance):
            node = self._crossing(segments[0][i], segments[1][j])
            link.events += [(edge, node) for edge in (segments[0][i], segments[1][j]) if node not in edge]

    def _crossing(self, one: Segment, other: Segment) -> int:
        """The point where two edges cross, the same one whichever faces ask for it."""
        one, other = min(one, other), max(one, other)
        p, q, r, s = (self.points[k] for k in (*one, *other))
        d, e = q - p, s - r
        normal = np.cross(d, e)
        place = p + np.cross(r - p, e) @ normal / (normal @ normal) * d
        return self._number_of(place)

    def _number_of(self, place: Array) -> int:
        """Number of a point, an old one if there is one at this place: three edges may cross in one point."""
        if self._corners is None:
            from scipy.spatial import cKDTree

            self._corners = cKDTree(np.array(self.points))
        reach = 4.0 * self.tolerance
        distance, nearest = self._corners.query(place, distance_upper_bound=reach)
        if distance <= reach:
            return int(nearest)
        first = self._corners.n
        if len(self.points) > first:
            away = np.linalg.norm(np.array(self.points[first:]) - place, axis=1)
            if away.min() <= reach:
                return first + int(np.argmin(away))
        self.points.append(place)
        return len(self.points) - 1

    def _common(self, k: int, link: _Link, nodes: Nodes) -> list[list[int]]:
        """What two faces have in common, as loops that turn as face `a` does."""
        a, b = nodes.expanded(self._flat[link.a].loop), nodes.expanded(self._flat[link.b].loop)[::-1]
        key = (k, tuple(a), tuple(b))
        if key not in self._known:
            ring_a, ring_b = self._drop(link.frame, a), self._drop(link.frame, b)
            of_a, of_b = _directed(a), _directed(b)
            both = set(of_b)
            edges = [edge for edge in of_a if edge in both]
            for own, ring, others, other in ((of_a, ring_a, of_b, ring_b), (of_b, ring_b, of_a, ring_a)):
                both = {*others, *((q, p) for p, q in others)}
                inside = contains(other, 0.5 * (ring + np.roll(ring, -1, axis=0)))
                edges += [edge for edge, into in zip(own, inside.tolist(), strict=True) if into and edge not in both]
            xy = {v: (x, y) for v, (x, y) in zip(a + b, [*ring_a.tolist(), *ring_b.tolist()], strict=True)}
            self._known[key] = regions(trace(edges, xy), xy) if edges else []
        return self._known[key]

    # ------------------------------------------------------------------ all of them together

    def _settled(self) -> dict[int, list[list[int]]]:
        """Cells of all faces that overlap others, after links that go badly together have been given up."""
        kept = self._links_kept
        while True:
            by_face: dict[int, list[int]] = {}
            for k, link in kept.items():
                by_face.setdefault(link.a, []).append(k)
                by_face.setdefault(link.b, []).append(k)
            self._imprint(by_face)
            bad = self._tight()
            divided = {}
            for f, partners in sorted(by_face.items()):
                cells, refused = self._divided(f, partners)
                divided[f] = cells
                if not bad & refused:  # one at a time: the other may then do no harm
                    bad |= refused
            if not bad:
                bad = self._open(divided, by_face)
            if not bad:
                self.shared += sum(len(self._common(k, link, self.nodes)) for k, link in kept.items())
                return divided
            self.separate += len(bad)
            for k in bad:
                del kept[k]

    def _imprint(self, by_face: dict[int, list[int]]) -> None:
        """Nodes on all edges: those of every link, and what edges that run along each other give on."""
        self.nodes = Nodes(self.points, self.tolerance)
        for k, link in self._links_kept.items():
            for segment, node in link.events:
                self.nodes.add(segment, node, frozenset([k]))
        pairs = []
        for f, partners in sorted(by_face.items()):
            owners: dict[Segment, set[int]] = {}
            for k in partners:
                link = self._links_kept[k]
                for face in (link.a, link.b):
                    for segment in edges_of(self._flat[face].loop):
                        owners.setdefault(segment, set()).update([] if face == f else [k])
            segments = list(owners)
            key = (f, *partners)
            if key not in self._along:
                ends = self.places(v for segment in segments for v in segment).reshape(-1, 2, 3)
                self._along[key] = aligned(ends[:, 0], ends[:, 1], self.tolerance)
            for i, j in self._along[key]:
                pairs.append((segments[i], segments[j], frozenset(owners[segments[i]] | owners[segments[j]])))
        self.nodes.spread(pairs)

    def _least(self, choices: Iterable[Iterable[int]]) -> set[int]:
        """The set of links with the least area: its loss costs least."""
        return set(min(choices, key=lambda links: (sum(self._links_kept[k].area for k in links), sorted(links))))

    def _tight(self) -> set[int]:
        """Links to be given up because they put nodes too close together: all that ask for one of two."""
        bad: set[int] = set()
        for gap, nodes in self.nodes.gaps():
            fine = [links for links in nodes if any(gap < self._links_kept[k].limit for k in links)]
            if fine and not any(links & bad for links in fine):
                bad |= self._least(fine)
        return bad

    def _divided(self, f: int, partners: list[int]) -> tuple[list[list[int]], set[int]]:
        """Cells of a face: what it has in common with others, and the rest; and the links to be given up."""
        loop = self.nodes.expanded(self._flat[f].loop)
        common: dict[int, list[list[int]]] = {}
        for k in partners:
            link = self._links_kept[k]
            try:
                found = self._common(k, link, self.nodes)
            except MeshError:
                return [], {k}
            common[k] = found if link.a == f else [cell[::-1] for cell in found]
        key = (f, tuple(loop), *((k, *map(tuple, cells)) for k, cells in common.items()))
        if key not in self._parts:
            self._parts[key] = self._judged(self._flat[f], loop, common)
        return self._parts[key]

    def _judged(
        self, face: _Face, loop: list[int], common: dict[int, list[list[int]]]
    ) -> tuple[list[list[int]], set[int]]:
        """Cells of an expanded face given what it has in common with others, or the links to be given up."""
        edges = set(_directed(loop))
        touched: dict[tuple[int, int], int] = {}
        for k, cells in common.items():
            for a, b in (edge for cell in cells for edge in _directed(cell)):
                touched[b, a] = k
                if (a, b) in edges:
                    edges.discard((a, b))
                else:
                    edges.add((b, a))
        cells = [cell for found in common.values() for cell in found]
        nodes = {*loop, *(v for cell in cells for v in cell)}
        frame = (self.points[loop[0]], *plane_basis(face.normal))
        xy = {v: (x, y) for v, (x, y) in zip(nodes, self._drop(frame, nodes).tolist(), strict=True)}
        try:
            rest = regions(trace(sorted(edges), xy), xy) if edges else []
        except MeshError:
            return [], set(common)
        for cell in rest:
            guilty = {touched[edge] for edge in _directed(cell) if edge in touched}
            if clearance(np.array([xy[v] for v in cell])) < min(_FINE * face.scale, _OWN * face.clear):
                return [], self._least([k] for k in guilty or common)
        total = sum(_area(np.array([xy[v] for v in cell])) for cell in cells + rest)
        if abs(total - face.area) > _LOST * face.area:
            return [], set(common)
        return cells + rest, set()

    def _open(self, divided: dict[int, list[list[int]]], by_face: dict[int, list[int]]) -> set[int]:
        """Links of blocks whose surface does not close."""
        balance: dict[int, dict[tuple[int, int], int]] = {}
        linked = {self._flat[f].block for f in by_face}
        for f, face in enumerate(self._flat):
            if face.block in linked:
                mine = balance.setdefault(face.block, {})
                for cell in divided[f] if f in divided else [self.nodes.expanded(face.loop)]:
                    for a, b in _directed(cell):
                        mine[a, b] = mine.get((a, b), 0) + 1
                        mine[b, a] = mine.get((b, a), 0) - 1
        opened = {block for block, mine in balance.items() if any(mine.values())}
        return {k for f, partners in by_face.items() if self._flat[f].block in opened for k in partners}


def cell_key(loop: Sequence[int]) -> tuple[int, ...]:
    """The same for a loop whatever corner and direction it is listed from, and for no other loop."""
    first = min(range(len(loop)), key=loop.__getitem__)
    ahead = [*loop[first:], *loop[:first]]
    return tuple(ahead) if ahead[1] < ahead[-1] else (ahead[0], *ahead[:0:-1])


def edges_of(loop: Sequence[int]) -> list[Segment]:
    """Edges of a loop, first the lower number; edge k starts at corner k."""
    return [(min(a, b), max(a, b)) for a, b in _directed(loop)]


def _directed(loop: Sequence[int]) -> list[tuple[int, int]]:
    return list(zip(loop, [*loop[1:], loop[0]], strict=True))


def _area(ring: Array) -> float:
    """Signed area of a plane loop [m^2]."""
    r = ring - ring[0]
    after = np.roll(r, -1, axis=0)
    return 0.5 * float(np.sum(r[:, 0] * after[:, 1] - r[:, 1] * after[:, 0]))
