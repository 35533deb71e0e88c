"""Polyhedra, convex or not, and open surfaces: checked, repaired where the repair is beyond doubt."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from fdem.errors import FdemWarning, MeshError
from fdem.scene.measures import Shape, ShapeReport, checked_matrix, checked_points, frozen_ints, moved
from fdem.scene.polygons import Array, Ints, area_vector, triangulate

__all__ = ["Polyhedron", "Surface"]

# a face with less area than this part of its squared perimeter is a line
DEGENERATE = 1e-12
# vertices may stand out of a convex shape by this part of its size (CONTACT.md 3)
CONVEX = 1e-6

Tags = str | Sequence[str | None] | None


class Polyhedron(Shape):
    """A closed polyhedron, convex or not.

    Parameters
    ----------
    points : (n, 3) array_like
        Vertices [m].
    faces : sequence of sequences of int
        Vertex loops, counter-clockwise from outside; simple, without holes, planar or not (faces that
        are not planar are two or more triangles each).
    face_tags : str or sequence of str, optional
        What made each face: the name of a cutter or the tag of a mesh.
    name : str, optional
        The name in the file it came from.

    Attributes
    ----------
    points : (n, 3) array
        Vertices that faces use [m], read-only.
    faces : tuple of int32 arrays
        Vertex loops.
    face_tags : tuple of (str or None)
        One per face.

    Raises
    ------
    MeshError
        If a coordinate is not finite, an index out of range, a point doubled, a face flat, the surface
        open, self-overlapping or in several parts. The message names the point, face or edge.

    Warns
    -----
    FdemWarning
        If faces had to be turned round.
    """

    def __init__(
        self, points: Any, faces: Sequence[Sequence[int]], face_tags: Tags = None, name: str | None = None
    ) -> None:
        what = f"polyhedron {name!r}" if name else "polyhedron"
        points = checked_points(points, what)
        loops = _checked_loops(points, faces, what)
        loops, turned = _oriented(loops, what)
        self._set(points, loops, _checked_tags(face_tags, len(loops), what), name)
        if self.volume < 0.0:
            self._set(points, [loop[::-1] for loop in loops], self.face_tags, name)
            turned = f"was inside out: all {len(loops)} faces were turned round"
        if self.volume <= 1e-15 * self.size**3:
            raise MeshError(f"{what}: it encloses no volume")
        if turned:
            warnings.warn(f"{what}: the surface {turned}", FdemWarning, stacklevel=2)

    def _set(self, points: Array, loops: Sequence[Sequence[int]], tags: Sequence[str | None], name: str | None) -> None:
        """Take over checked data, without points that no face uses."""
        for key in ("triangles", "triangle_face", "_triangulation", "_moments", "is_convex", "bounds", "size"):
            self.__dict__.pop(key, None)
        used = sorted({v for loop in loops for v in loop})
        new = dict(zip(used, range(len(used)), strict=True))
        self.points = np.ascontiguousarray(points[used])
        self.points.flags.writeable = False
        self.faces = tuple(frozen_ints([new[v] for v in loop]) for loop in loops)
        self.face_tags = tuple(tags)
        self.name = name

    @classmethod
    def trusted(
        cls,
        points: Array,
        faces: Sequence[Sequence[int]],
        face_tags: Sequence[str | None],
        name: str | None = None,
    ) -> Polyhedron:
        """A polyhedron from data known to be closed and oriented: no checks, see `Polyhedron`."""
        out = cls.__new__(cls)
        out._set(points, faces, face_tags, name)
        return out

    @cached_property
    def _triangulation(self) -> tuple[Ints, Ints]:
        return _triangles(self.points, self.faces)

    @cached_property
    def triangles(self) -> Ints:  # type: ignore[override]
        """The surface as triangles, counter-clockwise from outside, (m, 3)."""
        return self._triangulation[0]

    @property
    def triangle_face(self) -> Ints:
        """The face each triangle belongs to, (m,)."""
        return self._triangulation[1]

    @cached_property
    def is_convex(self) -> bool:
        """Whether no vertex stands out of any face's plane by more than 1e-6 of the size."""
        corners = self.points[self.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1)
        # the planes of needles say nothing
        good = lengths > 1e-9 * self.size**2
        normals = normals[good] / lengths[good, None]
        heights = self.points @ normals.T - np.einsum("ij,ij->i", corners[good, 0], normals)
        return bool((heights <= CONVEX * self.size).all())

    @cached_property
    def edges(self) -> Ints:
        """Undirected edges of the faces, (k, 2), sorted."""
        return _edges(self.faces)

    def transform(self, matrix: Any) -> Polyhedron:
        """The polyhedron moved, turned, scaled or mirrored.

        Parameters
        ----------
        matrix : (4, 4) array_like
            Affine map, last row 0 0 0 1.

        Returns
        -------
        Polyhedron
            With the same faces and tags; a mirrored one has its faces turned round.

        Raises
        ------
        MeshError
            If the matrix is singular or not affine.
        """
        m = checked_matrix(matrix)
        faces: list[Any] = [f.tolist() for f in self.faces]
        if np.linalg.det(m[:3, :3]) < 0.0:
            faces = [f[::-1] for f in faces]
        return Polyhedron.trusted(moved(self.points, m), faces, self.face_tags, self.name)

    def report(self) -> ShapeReport:
        """Quality of the polyhedron, see `ShapeReport`."""
        return self._report(self.edges, 0, len(self.faces))


class Surface(Shape):
    """An open surface, such as a terrain: for fixed rigid blocks only. It has no volume.

    Parameters
    ----------
    points : (n, 3) array_like
        Vertices [m].
    faces : sequence of sequences of int
        Vertex loops, counter-clockwise seen from the side that blocks touch.
    face_tags : str or sequence of str, optional
        One per face.
    name : str, optional
        The name in the file it came from.

    Raises
    ------
    MeshError
        If a coordinate is not finite, an index out of range, a point doubled, a face flat, or an edge
        has more than two faces or two that run the same way.
    """

    is_convex = False

    def __init__(
        self, points: Any, faces: Sequence[Sequence[int]], face_tags: Tags = None, name: str | None = None
    ) -> None:
        what = f"surface {name!r}" if name else "surface"
        points = checked_points(points, what)
        loops = _checked_loops(points, faces, what)
        directed = _directed(loops)
        for (a, b), owners in directed.items():
            if len(owners) > 1:
                raise MeshError(f"{what}: faces {owners[0]} and {owners[1]} both use edge ({a}, {b}) the same way")
        used = sorted({v for loop in loops for v in loop})
        new = dict(zip(used, range(len(used)), strict=True))
        self.points = np.ascontiguousarray(points[used])
        self.points.flags.writeable = False
        self.faces = tuple(frozen_ints([new[v] for v in loop]) for loop in loops)
        self.face_tags = tuple(_checked_tags(face_tags, len(loops), what))
        self.triangles, self.triangle_face = _triangles(self.points, self.faces)
        self.name = name

    @property
    def volume(self) -> float:
        """0: an open surface encloses nothing."""
        return 0.0

    @property
    def centroid(self) -> Array:
        """Centroid of the area, (3,) [m]."""
        corners = self.points[self.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.sqrt((normals * normals).sum(axis=1))
        centroid: Array = (areas[:, None] * corners.mean(axis=1)).sum(axis=0) / areas.sum()
        return centroid

    def inertia(self, density: float = 1.0) -> Array:
        """Zero: an open surface has no mass and can only be fixed."""
        return np.zeros((3, 3))

    def transform(self, matrix: Any) -> Surface:
        """The surface moved, turned, scaled or mirrored, see `Polyhedron.transform`."""
        m = checked_matrix(matrix)
        step = -1 if np.linalg.det(m[:3, :3]) < 0.0 else 1
        return Surface(moved(self.points, m), [f.tolist()[::step] for f in self.faces], self.face_tags, self.name)

    def report(self) -> ShapeReport:
        """Quality of the surface, see `ShapeReport`."""
        edges = _edges(self.faces)
        return self._report(edges, 2 * len(edges) - sum(len(f) for f in self.faces), len(self.faces))

    def _aspect(self) -> float:
        extents = self.bounds[1] - self.bounds[0]
        return float(extents.max() / extents.min()) if extents.min() > 0.0 else float("inf")


def _checked_loops(points: Array, faces: Any, what: str) -> list[list[int]]:
    """Faces as lists of int: in range, no vertex twice, not flat."""
    loops: list[list[int]] = []
    try:
        raw = [np.asarray(face) for face in faces]
    except TypeError:
        raise MeshError(f"{what}: faces must be a sequence of vertex loops") from None
    if not raw:
        raise MeshError(f"{what}: empty mesh, there are no faces")
    for i, face in enumerate(raw):
        if face.ndim != 1 or len(face) < 3 or not np.issubdtype(face.dtype, np.integer):
            raise MeshError(f"{what}: faces[{i}] = {face.tolist()} is not a loop of three or more vertex indices")
        loop = face.tolist()
        for vertex in loop:
            if not 0 <= vertex < len(points):
                raise MeshError(
                    f"{what}: faces[{i}] has face index {vertex} out of range, there are {len(points)} points"
                )
        if len(set(loop)) < len(loop):
            raise MeshError(f"{what}: faces[{i}] = {loop} uses a vertex twice")
        ring = points[loop]
        area = np.linalg.norm(area_vector(ring.tolist()))
        perimeter = np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1).sum()
        if area <= DEGENERATE * perimeter**2:
            raise MeshError(f"{what}: faces[{i}] = {loop} is degenerate, it has no area")
        loops.append(loop)
    return loops


def _checked_tags(tags: Tags, n: int, what: str) -> list[str | None]:
    """One tag per face."""
    if tags is None or isinstance(tags, str):
        return [tags] * n
    out = [None if tag is None else str(tag) for tag in tags]
    if len(out) != n:
        raise MeshError(f"{what}: face_tags has {len(out)} entries for {n} faces")
    return out


def _directed(loops: Sequence[Sequence[int]]) -> dict[tuple[int, int], list[int]]:
    """Faces by directed edge."""
    directed: dict[tuple[int, int], list[int]] = {}
    for i, loop in enumerate(loops):
        for k, vertex in enumerate(loop):
            directed.setdefault((loop[k - 1], vertex), []).append(i)
    return directed


def _oriented(loops: list[list[int]], what: str) -> tuple[list[list[int]], str]:
    """Loops turned so that neighbours agree, and what was turned; checks that edges close."""
    directed = _directed(loops)
    for (a, b), owners in directed.items():
        both = owners + directed.get((b, a), [])
        if len(both) == 1:
            raise MeshError(f"{what}: the surface is open at edge ({a}, {b}) of face {owners[0]}")
        if len(both) > 2:
            raise MeshError(f"{what}: the surface overlaps itself, faces {sorted(both)} share edge ({a}, {b})")
    turned = [False] * len(loops)
    seen = [False] * len(loops)
    seen[0] = True
    stack = [0]
    while stack:
        i = stack.pop()
        loop = loops[i]
        for k, b in enumerate(loop):
            a = loop[k - 1]
            for j in directed[(a, b)] + directed.get((b, a), []):
                if seen[j]:
                    continue
                seen[j] = True
                turned[j] = turned[i] != (j in directed[(a, b)])
                stack.append(j)
    if not all(seen):
        raise MeshError(
            f"{what}: the surface has disconnected parts, face {seen.index(False)} cannot be reached from face 0; "
            "make each part a block of its own (a cavity: cut the shape through it first)"
        )
    if not any(turned):
        return loops, ""
    flip = sum(turned) <= len(loops) // 2
    result = [loop[::-1] if t == flip else loop for loop, t in zip(loops, turned, strict=True)]
    for (a, b), owners in _directed(result).items():
        if len(owners) > 1:
            raise MeshError(f"{what}: the surface cannot be oriented, faces {owners} disagree at edge ({a}, {b})")
    wrong = [i for i, t in enumerate(turned) if t == flip]
    return result, f"was oriented differently at faces {wrong}: they were turned round"


def _edges(faces: Sequence[Ints]) -> Ints:
    """Undirected edges of vertex loops, sorted, once each."""
    pairs = np.concatenate([np.column_stack([f, np.roll(f, -1)]) for f in faces])
    return np.unique(np.sort(pairs, axis=1), axis=0).astype(np.int32)


def _triangles(points: Array, faces: Sequence[Ints]) -> tuple[Ints, Ints]:
    """Triangles of all faces and the face of each."""
    coordinates = points.tolist()
    triangles: list[tuple[int, int, int]] = []
    owner: list[int] = []
    for i, face in enumerate(faces):
        loop = face.tolist()
        try:
            local = triangulate([coordinates[v] for v in loop])
        except MeshError as error:
            raise MeshError(f"faces[{i}] = {loop}: {error}") from None
        triangles += [(loop[a], loop[b], loop[c]) for a, b, c in local]
        owner += [i] * len(local)
    return frozen_ints(triangles), frozen_ints(owner)
