"""Integrals over bodies: polynomials exactly, densities that vary in space, mass properties from both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from fdem.errors import SceneError
from fdem.scene.polygons import Array
from fdem.scene.tetmesh import TetMesh

__all__ = ["MassProperties", "cell_densities", "mass_properties", "quadrature", "tet_rule"]

# degree of polynomials that are integrated exactly with a density that varies in space: the density may have degree 5
# where moments of degree 4 are wanted (linear strain), 7 where those of degree 2 are (all others)
DEGREE = 9


@cache
def tet_rule(degree: int) -> tuple[Array, Array]:
    """Quadrature on a tetrahedron, exact for polynomials up to `degree`.

    Returns
    -------
    points : (n, 4) array
        Barycentric coordinates; all inside.
    weights : (n,) array
        Positive, their sum is 1.

    Notes
    -----
    Gauss-Legendre in collapsed coordinates: ``x = (a, b (1 - a), c (1 - a)(1 - b))`` with Jacobian
    ``(1 - a)^2 (1 - b)``, so that 2 m - 1 >= degree + 2 points in each direction are exact.
    """
    line, weight = np.polynomial.legendre.leggauss((degree + 4) // 2)
    line, weight = 0.5 * (line + 1.0), 0.5 * weight
    a, b, c = (grid.ravel() for grid in np.meshgrid(line, line, line, indexing="ij"))
    wa, wb, wc = (grid.ravel() for grid in np.meshgrid(weight, weight, weight, indexing="ij"))
    inner = np.column_stack([a, b * (1.0 - a), c * (1.0 - a) * (1.0 - b)])
    points = np.column_stack([1.0 - inner.sum(axis=1), inner])
    return points, 6.0 * wa * wb * wc * (1.0 - a) ** 2 * (1.0 - b)


def quadrature(shape: Any, degree: int, inside: bool = False) -> tuple[Array, Array]:
    """Points and weights that integrate polynomials up to `degree` over a body exactly.

    Parameters
    ----------
    shape : Shape
        Closed body, convex or not.
    degree : int
        Highest degree of the polynomials.
    inside : bool, optional
        All points lie in the body. Without it they may lie outside one that is not convex, with negative weights: exact
        for polynomials all the same.

    Returns
    -------
    points : (n, 3) array
        [m].
    weights : (n,) array
        [m^3]; their sum is the volume.
    """
    corners = _cells(shape) if inside else _signed_cells(shape)
    barycentric, part = tet_rule(degree)
    edges = corners[:, 1:] - corners[:, :1]
    volume = np.einsum("ni,ni->n", edges[:, 0], np.cross(edges[:, 1], edges[:, 2])) / 6.0
    points = np.einsum("pk,nki->npi", barycentric, corners).reshape(-1, 3)
    return points, (volume[:, None] * part).ravel()


def _signed_cells(shape: Any) -> Array:
    """Tetrahedra (n, 4, 3) from the centroid of the body to its triangles; volumes may be negative."""
    corners = np.asarray(shape.points)[np.asarray(shape.triangles)]
    return np.concatenate([np.broadcast_to(shape.centroid, (len(corners), 1, 3)), corners], axis=1)


def _cells(shape: Any) -> Array:
    """Tetrahedra (n, 4, 3) that fill the body."""
    if isinstance(shape, TetMesh):
        return np.asarray(shape.points)[shape.tets]
    if shape.is_convex:
        return _signed_cells(shape)
    from fdem.scene.meshing import zone_meshes

    mesh = zone_meshes([shape], [None])[0]
    return np.asarray(mesh.points)[mesh.tets]


@dataclass(frozen=True)
class MassProperties:
    """Mass, centre and second moments of a body.

    Attributes
    ----------
    mass : float
        [kg].
    centre : (3,) array
        Centre of mass [m].
    second : (3, 3) array
        ``int rho r r^T dV`` from the centre of mass [kg m^2].
    density : float or None
        [kg/m^3]; None where it varies.
    points, weights : (n, 3) array, (n,) array or None
        Places [m] and masses [kg] that stand for a body whose density varies.
    """

    mass: float
    centre: Array
    second: Array
    density: float | None
    points: Array | None = None
    weights: Array | None = None

    @property
    def inertia(self) -> Array:
        """Inertia (3, 3) about the centre of mass [kg m^2]."""
        return np.trace(self.second) * np.eye(3) - self.second


def mass_properties(shape: Any, density: float | Callable[[Array], Array], who: str) -> MassProperties:
    """Mass properties of a body of constant density, or of one that varies in space.

    Parameters
    ----------
    shape : Shape
        The body.
    density : float or callable
        [kg/m^3]; a callable is a function of places (n, 3) -> (n,).
    who : str
        Block, for messages.

    Returns
    -------
    MassProperties
        Exact for constant density; for a density that is a polynomial of degree 7 or less exact too (5 or less for the
        moments of degree 4 that follow from `points`), else a quadrature of degree 9 on the body's tetrahedra.

    Raises
    ------
    SceneError
        If a density is not positive and finite, or the function returns another number of values.
    """
    if not callable(density):
        rho = float(density)
        unit = shape.inertia(1.0)
        second = rho * (0.5 * np.trace(unit) * np.eye(3) - unit)
        return MassProperties(rho * shape.volume, np.asarray(shape.centroid), second, rho)
    points, weights = quadrature(shape, DEGREE, inside=True)
    weights = weights * _evaluated(density, points, who)
    mass = float(weights.sum())
    origin = np.asarray(shape.centroid)
    arms = points - origin
    centre = weights @ arms / mass
    arms = arms - centre
    return MassProperties(mass, origin + centre, np.einsum("n,ni,nj->ij", weights, arms, arms), None, points, weights)


def cell_densities(points: Array, cells: Array, density: Callable[[Array], Array], who: str) -> Array:
    """Mean density (n,) [kg/m^3] of tetrahedra, exact for a density that is cubic in each.

    Parameters
    ----------
    points : (k, 3) array
        [m].
    cells : (n, 4) int array
        Tetrahedra.
    density : callable
        (n, 3) -> (n,) [kg/m^3].
    who : str
        Block, for messages.
    """
    barycentric, part = tet_rule(3)
    places = np.einsum("pk,nki->npi", barycentric, points[cells])
    values = _evaluated(density, places.reshape(-1, 3), who)
    return np.asarray(values.reshape(len(cells), -1) @ part)


def _evaluated(density: Callable[[Array], Array], places: Array, who: str) -> Array:
    values = np.asarray(density(places), dtype=np.float64)
    if values.shape != (len(places),):
        raise SceneError(f"{who}: density returned shape {values.shape} for {len(places)} places")
    if not (np.isfinite(values) & (values > 0.0)).all():
        worst = int(np.argmin(np.where(np.isfinite(values), values, -np.inf)))
        raise SceneError(f"{who}: density is {values[worst]} at {places[worst].tolist()}, it must be positive")
    return values
