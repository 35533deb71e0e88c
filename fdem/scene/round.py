"""Round shapes: spheres, clumps of spheres, cylinders."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from fdem.errors import MeshError, SceneError
from fdem.scene.balls import union_moments
from fdem.scene.checks import number, vector
from fdem.scene.measures import Shape, ShapeReport, checked_matrix, frozen_ints, moved
from fdem.scene.polygons import Array, Ints, plane_basis
from fdem.scene.polyhedra import Polyhedron

__all__ = ["Balls", "Clump", "Cylinder", "Sphere", "clump", "cylinder", "sphere"]

SIMILAR = 1e-9  # relative departure of a map from a similarity that still counts as one


class Balls(Shape):
    """What a sphere and a clump of spheres share: no faces; points are the centres.

    Attributes
    ----------
    points : (n, 3) array
        Centres [m].
    radii : (n,) array
        [m].
    """

    triangles: Ints = np.zeros((0, 3), dtype=np.int32)
    triangle_face: ClassVar[Ints] = frozen_ints([])
    faces: ClassVar[tuple[Ints, ...]] = ()
    face_tags: ClassVar[tuple[str, ...]] = ()
    radii: Array

    @property
    def bounds(self) -> Array:
        """Lower and upper corner of the bounding box, (2, 3) [m]; not kept, there may be many spheres."""
        r = self.radii[:, None]
        return _frozen(np.array([(self.points - r).min(axis=0), (self.points + r).max(axis=0)]))

    def report(self) -> ShapeReport:
        """Quality of the shape: the shortest edge is the smallest diameter."""
        extents = self.bounds[1] - self.bounds[0]
        return ShapeReport(
            volume=self.volume,
            shortest_edge=2.0 * float(self.radii.min()),
            aspect=float(extents.max() / extents.min()),
            concavity=0.0,
            open_edges=0,
            n_points=len(self.points),
            n_faces=0,
            n_triangles=0,
        )

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {len(self.radii)} spheres, volume {self.volume:.6g} m3>"


class Sphere(Balls):
    """A sphere.

    Parameters
    ----------
    radius : float
        [m].
    centre : (3,) array
        [m].
    """

    def __init__(self, radius: float, centre: Array) -> None:
        self.radius = float(radius)
        self.points = np.array(centre, dtype=np.float64).reshape(1, 3)

    @property
    def radii(self) -> Array:  # type: ignore[override]
        """The radius, (1,) [m]."""
        return np.array([self.radius])

    @property
    def volume(self) -> float:
        """``4/3 pi r^3`` [m^3]."""
        return 4.0 / 3.0 * float(np.pi) * self.radius**3

    @property
    def centroid(self) -> Array:
        """The centre, (3,) [m]."""
        return self.points[0]

    def inertia(self, density: float = 1.0) -> Array:
        """Inertia about the centre, ``2/5 m r^2`` times the unit matrix (3, 3) [kg m^2]."""
        return 0.4 * float(density) * self.volume * self.radius**2 * np.eye(3)

    @property
    def size(self) -> float:
        """The diameter [m]."""
        return 2.0 * self.radius

    def transform(self, matrix: Any) -> Sphere:
        """The sphere moved or scaled.

        Parameters
        ----------
        matrix : (4, 4) array_like
            A similarity: rotation, reflection, one scale for all directions, shift.

        Returns
        -------
        Sphere

        Raises
        ------
        MeshError
            If the matrix is no similarity.
        """
        m, scale, _ = _similarity(matrix, "sphere")
        return Sphere(scale * self.radius, moved(self.points, m)[0])


class Clump(Balls):
    """A rigid union of spheres; overlaps are counted once in volume, centroid and inertia.

    Parameters
    ----------
    centres : (n, 3) array
        [m].
    radii : (n,) array
        [m].
    """

    def __init__(self, centres: Array, radii: Array) -> None:
        self.points, self.radii = _frozen(centres), _frozen(radii)

    @cached_property
    def _moments(self) -> tuple[float, Array, Array]:
        volume, centroid, second = union_moments(self.points, self.radii)
        return volume, _frozen(centroid), _frozen(second)

    def transform(self, matrix: Any) -> Clump:
        """The clump moved, turned, mirrored or scaled: its moments go along, so that copies cost nothing.

        Parameters
        ----------
        matrix : (4, 4) array_like
            A similarity: rotation, reflection, one scale for all directions, shift.

        Returns
        -------
        Clump

        Raises
        ------
        MeshError
            If the matrix is no similarity.
        """
        m, scale, turn = _similarity(matrix, "clump")
        out = Clump(moved(self.points, m), scale * self.radii)
        volume, centroid, second = self._moments
        out.__dict__["_moments"] = (
            scale**3 * volume,
            moved(centroid[None], m)[0],
            _frozen(scale**5 * (turn @ second @ turn.T)),
        )
        return out


class Cylinder(Polyhedron):
    """A cylinder: volume and inertia of the round body, contact by plane facets.

    The polygon across has the area of the circle, so that its ends are as stiff as they should be; its corners stand
    out of the circle and its sides lie inside of it by at most the tolerance it was made with.
    """

    radius: float
    axis: Array

    @classmethod
    def between(cls, radius: float, start: Array, end: Array, n: int) -> Cylinder:
        """Cylinder of `n` facets along the axis from `start` to `end`."""
        axis = end - start
        u, v = plane_basis(axis.tolist())
        turn = 2.0 * np.pi / n
        angle = turn * np.arange(n)
        around = radius * np.sqrt(turn / np.sin(turn)) * (np.outer(np.cos(angle), u) + np.outer(np.sin(angle), v))
        ring = np.arange(n)
        nxt = np.roll(ring, -1)
        sides = np.column_stack([ring, nxt, nxt + n, ring + n]).tolist()
        faces = [ring[::-1].tolist(), (ring + n).tolist(), *sides]
        out = cls.__new__(cls)
        out._set(np.concatenate([start + around, end + around]), faces, [None] * len(faces), None)
        out.radius, out.axis = float(radius), _frozen(np.array([start, end]))
        return out

    @cached_property
    def _moments(self) -> tuple[float, Array, Array]:
        start, end = self.axis
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        volume = float(np.pi) * self.radius**2 * length
        dyad = np.outer(along, along)
        second = volume * (0.25 * self.radius**2 * (np.eye(3) - dyad) + length**2 / 12.0 * dyad)
        return volume, _frozen(0.5 * (start + end)), _frozen(second)

    def transform(self, matrix: Any) -> Polyhedron:
        """The cylinder moved, turned or scaled; under a map that is no similarity its facets as a polyhedron."""
        m = checked_matrix(matrix)
        facets = super().transform(m)
        try:
            _, scale, _ = _similarity(m, "cylinder")
        except MeshError:
            return facets
        out = Cylinder.__new__(Cylinder)
        out._set(facets.points, [f.tolist() for f in facets.faces], facets.face_tags, facets.name)
        out.radius, out.axis = scale * self.radius, moved(self.axis, m)
        return out


def sphere(radius: float, centre: Any = (0.0, 0.0, 0.0)) -> Sphere:
    """Sphere, exact in mass, inertia and contact; for rigid blocks (`icosphere` is a faceted one for all bodies).

    Parameters
    ----------
    radius : float
        [m].
    centre : (3,) array_like, optional
        [m].

    Returns
    -------
    Sphere

    Raises
    ------
    SceneError
        If the radius is not positive or a value not finite.
    """
    return Sphere(number("sphere", "radius", radius, low=0.0, open_low=True), vector("sphere", "centre", centre))


def clump(spheres: Iterable[tuple[Any, float]]) -> Clump:
    """Rigid union of spheres, overlaps counted once in mass and inertia; for rigid blocks.

    Parameters
    ----------
    spheres : sequence of (centre, radius)
        Centres (3,) [m] and radii [m].

    Returns
    -------
    Clump
        Copies of it by ``transform`` need no new integration.

    Raises
    ------
    SceneError
        If there is no sphere, a radius is not positive or a value not finite.

    Notes
    -----
    One or two spheres, and any whose centres lie on a line, exactly; up to 12 spheres to 1e-9, more to 1e-6.
    """
    try:
        pairs = [(centre, radius) for centre, radius in spheres]
    except (TypeError, ValueError):
        raise SceneError("clump: spheres is a sequence of (centre, radius)") from None
    if not pairs:
        raise SceneError("clump: the list of spheres is empty")
    centres = np.array([vector("clump", f"centre {i}", centre) for i, (centre, _) in enumerate(pairs)])
    radii = [number("clump", f"radius {i}", r, low=0.0, open_low=True) for i, (_, r) in enumerate(pairs)]
    return Clump(centres, np.array(radii))


def cylinder(radius: float, start: Any, end: Any, tolerance: float = 1e-3) -> Cylinder:
    """Cylinder of exact mass and inertia whose contacts are those of plane facets.

    Parameters
    ----------
    radius : float
        [m].
    start, end : (3,) array_like
        Ends of the axis [m].
    tolerance : float, optional
        Largest distance between facets and the round surface over the radius; 1e-3 makes 60 facets.

    Returns
    -------
    Cylinder

    Raises
    ------
    SceneError
        If a value is out of range or the ends coincide.
    """
    r = number("cylinder", "radius", radius, low=0.0, open_low=True)
    a, b = vector("cylinder", "start", start), vector("cylinder", "end", end)
    given = number("cylinder", "tolerance", tolerance, low=1e-6, high=0.2)
    if not np.linalg.norm(b - a) > 1e-9 * r:
        raise SceneError(f"cylinder: start = {start!r} and end = {end!r} are the same place")
    # corners of the polygon of equal area stand out by (pi / n)^2 / 3 of the radius: its sides lie in by half of that
    n = 4 * int(np.ceil(0.25 * np.pi / np.sqrt(3.0 * given)))
    while np.sqrt(2.0 * np.pi / n / np.sin(2.0 * np.pi / n)) - 1.0 > given:
        n += 4
    return Cylinder.between(r, a, b, n)


def _similarity(matrix: Any, what: str) -> tuple[Array, float, Array]:
    """A 4 x 4 similarity, its scale and its orthogonal part.

    Raises
    ------
    MeshError
        If it is none.
    """
    m = checked_matrix(matrix)
    linear = m[:3, :3]
    scale = float(abs(np.linalg.det(linear))) ** (1.0 / 3.0)
    turn = linear / scale
    if np.abs(turn @ turn.T - np.eye(3)).max() > SIMILAR:
        raise MeshError(f"transform: a {what} can be moved, turned and scaled, but not distorted")
    return m, scale, turn


def _frozen(array: Any) -> Array:
    out = np.ascontiguousarray(array, dtype=np.float64)
    out.flags.writeable = False
    return out
