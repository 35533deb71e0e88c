"""Measures of shapes: the base of every shape, closed-form moments, quality reports, checks of points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fdem.errors import MeshError
from fdem.scene.polygons import Array, Ints

__all__ = ["Shape", "ShapeReport", "checked_points", "hull_volume", "moments"]

# points closer than this part of a shape's extent are the same place
COINCIDENT = 1e-10


@dataclass(frozen=True)
class ShapeReport:
    """Quality of one shape.

    Attributes
    ----------
    volume : float
        [m^3].
    shortest_edge : float
        Length of the shortest edge [m].
    aspect : float
        Longest over shortest extent along the principal axes of inertia.
    concavity : float
        Share of the convex hull's volume that is missing; 0 for a convex shape.
    open_edges : int
        Edges with one face; 0 for a closed surface.
    n_points, n_faces, n_triangles, n_zones : int
        Counts; `n_zones` is 0 for a shape without zones.
    """

    volume: float
    shortest_edge: float
    aspect: float
    concavity: float
    open_edges: int
    n_points: int
    n_faces: int
    n_triangles: int
    n_zones: int = 0

    def __str__(self) -> str:
        zones = f", {self.n_zones} zones" if self.n_zones else ""
        return (
            f"volume {self.volume:.6g} m3, shortest edge {self.shortest_edge:.4g} m, aspect {self.aspect:.3g}, "
            f"concavity {self.concavity:.2%}, {self.open_edges} open edges, {self.n_points} points, "
            f"{self.n_faces} faces, {self.n_triangles} triangles{zones}"
        )


class Shape:
    """What every shape of triangles can tell; `points` and `triangles` come from the subclass.

    Attributes
    ----------
    points : (n, 3) array
        Vertices [m].
    triangles : (m, 3) int32 array
        The surface, counter-clockwise from outside.
    name : str or None
        The name it had in a file.
    """

    points: Array
    triangles: Ints
    name: str | None = None

    @cached_property
    def bounds(self) -> Array:
        """Lower and upper corner of the bounding box, (2, 3) [m]."""
        return _frozen(np.array([self.points.min(axis=0), self.points.max(axis=0)]))

    @cached_property
    def size(self) -> float:
        """Largest extent of the bounding box [m]: the length that tolerances are relative to."""
        return float((self.bounds[1] - self.bounds[0]).max())

    @cached_property
    def _moments(self) -> tuple[float, Array, Array]:
        return moments(self.points, self.triangles)

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        return self._moments[0]

    @property
    def centroid(self) -> Array:
        """Centroid of the volume, (3,) [m]."""
        return self._moments[1]

    def inertia(self, density: float = 1.0) -> Array:
        """Inertia tensor about the centroid, global axes.

        Parameters
        ----------
        density : float, optional
            [kg/m^3].

        Returns
        -------
        (3, 3) array
            [kg m^2]; off the diagonal stands ``-integral of rho x y``.
        """
        second = self._moments[2]
        inertia: Array = float(density) * (np.trace(second) * np.eye(3) - second)
        return inertia

    def transform(self, matrix: Any) -> Shape:
        """The shape moved, turned, scaled or mirrored; see the subclasses."""
        raise NotImplementedError

    def report(self) -> ShapeReport:
        """Quality of the shape, see `ShapeReport`."""
        raise NotImplementedError

    def _report(self, edges: Ints, open_edges: int, n_faces: int, n_zones: int = 0) -> ShapeReport:
        """Put a report together from the undirected edges (k, 2)."""
        lengths = np.linalg.norm(self.points[edges[:, 0]] - self.points[edges[:, 1]], axis=1)
        hull = hull_volume(self.points)
        return ShapeReport(
            volume=self.volume,
            shortest_edge=float(lengths.min()),
            aspect=self._aspect(),
            # a hull is never smaller than what it holds but for round-off
            concavity=max(0.0, 1.0 - self.volume / hull) if hull > 0.0 and self.volume > 0.0 else 0.0,
            open_edges=open_edges,
            n_points=len(self.points),
            n_faces=n_faces,
            n_triangles=len(self.triangles),
            n_zones=n_zones,
        )

    def _aspect(self) -> float:
        """Longest over shortest extent along the principal axes of the second moments."""
        axes = np.linalg.eigh(self._moments[2])[1]
        local = (self.points - self.centroid) @ axes
        extents = local.max(axis=0) - local.min(axis=0)
        return float(extents.max() / extents.min()) if extents.min() > 0.0 else float("inf")

    def __repr__(self) -> str:
        name = f" {self.name!r}" if self.name else ""
        return f"<{type(self).__name__}{name}: {len(self.points)} points, {len(self.triangles)} triangles>"


def moments(points: Array, triangles: Ints) -> tuple[float, Array, Array]:
    """Volume, centroid and second moments about the centroid of a closed triangulated surface.

    Parameters
    ----------
    points : (n, 3) array
        Vertices [m].
    triangles : (m, 3) int array
        Counter-clockwise from outside.

    Returns
    -------
    volume : float
        [m^3], negative for an inside-out surface.
    centroid : (3,) array
        [m].
    second : (3, 3) array
        ``integral of (x - c)(x - c)^T`` [m^5].

    Notes
    -----
    Exact sums over the signed tetrahedra from a point to each triangle (a, b, c), with
    ``d = a . (b x c)`` and ``s = a + b + c``: ``V = sum d / 6``, ``integral x = sum d s / 24``,
    ``integral x x^T = sum d (a a^T + b b^T + c c^T + s s^T) / 120``. Taken first from the middle of
    the points and once more from the centroid, so that nothing is lost far from the origin.

    References
    ----------
    Tonon (2004), J. Math. Stat. 1(1), 8-11, doi:10.3844/jmssp.2005.8.11.
    """
    origin = 0.5 * (points.min(axis=0) + points.max(axis=0))
    for _ in range(2):
        corners = (points - origin)[triangles]
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        det = np.einsum("ij,ij->i", a, np.cross(b, c))
        s = a + b + c
        volume = float(det.sum() / 6.0)
        if volume == 0.0:
            return 0.0, _frozen(origin), _frozen(np.zeros((3, 3)))
        shift = (det[:, None] * s).sum(axis=0) / (24.0 * volume)
        origin = origin + shift
    # `shift` of the second pass is round-off: the moments are about the centroid
    second = np.einsum("t,tki,tkj->ij", det, corners, corners) + np.einsum("t,ti,tj->ij", det, s, s)
    second = second / 120.0 - volume * np.outer(shift, shift)
    return volume, _frozen(origin), _frozen(0.5 * (second + second.T))


def hull_volume(points: Array) -> float:
    """Volume of the convex hull of points [m^3]; 0 for flat sets.

    Parameters
    ----------
    points : (n, 3) array
        [m].

    Returns
    -------
    float
        [m^3].
    """
    from scipy.spatial import ConvexHull, QhullError

    lower, upper = points.min(axis=0), points.max(axis=0)
    scale = float((upper - lower).max())
    try:
        # normalised, because qhull works with absolute thresholds
        return float(ConvexHull((points - lower) / scale).volume) * scale**3
    except QhullError:
        return 0.0


def checked_points(points: Any, what: str) -> Array:
    """A copy of points as (n, 3) float64.

    Parameters
    ----------
    points : array_like
        Coordinates [m].
    what : str
        What to call the shape in messages.

    Returns
    -------
    (n, 3) array
        Read-only.

    Raises
    ------
    MeshError
        If there are none, the shape is wrong, a value is not finite or two points coincide.
    """
    try:
        out = np.array(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MeshError(f"{what}: points must be numbers of shape (n, 3): {error}") from None
    if out.size == 0:
        raise MeshError(f"{what}: empty mesh, there are no points")
    if out.ndim != 2 or out.shape[1] != 3:
        raise MeshError(f"{what}: points must have shape (n, 3), not {out.shape}")
    if not np.isfinite(out).all():
        row, column = np.argwhere(~np.isfinite(out))[0]
        raise MeshError(f"{what}: points[{row}] has a coordinate {'xyz'[column]} = {out[row, column]}, not finite")
    pair = _coincident(out)
    if pair is not None:
        raise MeshError(
            f"{what}: points[{pair[0]}] and points[{pair[1]}] are duplicates, both at {out[pair[0]].tolist()}"
        )
    return _frozen(out)


def _coincident(points: Array) -> tuple[int, int] | None:
    """The first two points at the same place, or None."""
    tolerance = COINCIDENT * float((points.max(axis=0) - points.min(axis=0)).max())
    if len(points) < 2:
        return None
    if len(points) <= 300:
        apart = np.abs(points[:, None] - points[None]).max(axis=2)
        near = np.argwhere(np.triu(apart <= tolerance, 1))
    else:
        from scipy.spatial import cKDTree

        near = cKDTree(points).query_pairs(tolerance, p=np.inf, output_type="ndarray")
        near = near[np.lexsort((near[:, 1], near[:, 0]))]
    return (int(near[0, 0]), int(near[0, 1])) if len(near) else None


def checked_matrix(matrix: Any) -> Array:
    """A 4 x 4 affine matrix, checked.

    Parameters
    ----------
    matrix : (4, 4) array_like
        The last row is 0 0 0 1; the last column the shift [m].

    Returns
    -------
    (4, 4) array
        The matrix.

    Raises
    ------
    MeshError
        If it is no affine map or a singular one.
    """
    m = np.array(matrix, dtype=np.float64)
    if m.shape != (4, 4) or not np.isfinite(m).all() or not np.array_equal(m[3], [0.0, 0.0, 0.0, 1.0]):
        raise MeshError("transform: matrix must be a finite (4, 4) array with last row 0 0 0 1")
    scale = float(np.abs(m[:3, :3]).max())
    if scale == 0.0 or abs(np.linalg.det(m[:3, :3] / scale)) < 1e-12:
        raise MeshError("transform: matrix is singular, it flattens the shape")
    return m


def moved(points: Array, matrix: Array) -> Array:
    """Points mapped by a 4 x 4 affine matrix.

    Parameters
    ----------
    points : (n, 3) array
        [m].
    matrix : (4, 4) array
        As `checked_matrix` gives it.

    Returns
    -------
    (n, 3) array
        [m].
    """
    # column by column: the same point gets the same bits in every block, whatever its row
    columns = [
        points[:, 0] * matrix[i, 0] + points[:, 1] * matrix[i, 1] + points[:, 2] * matrix[i, 2] + matrix[i, 3]
        for i in range(3)
    ]
    return _frozen(np.column_stack(columns))


def _frozen(array: Array) -> Array:
    """The array, contiguous and read-only."""
    array = np.ascontiguousarray(array, dtype=np.float64)
    array.flags.writeable = False
    return array


def frozen_ints(values: Sequence[Any] | Ints) -> Ints:
    """An int32 array that is read-only.

    Parameters
    ----------
    values : sequence of int
        The values.

    Returns
    -------
    int32 array
        Contiguous, read-only.
    """
    out = np.array(values, dtype=np.int32, order="C")
    out.flags.writeable = False
    return out
