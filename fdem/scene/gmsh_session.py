"""The only place that talks to gmsh: one small model at a time, in coordinates of order one.

What gmsh sees is rounded to multiples of 2^-20 of the size of the part, so that the same shape gives the same mesh
in any unit of length and anywhere in space; what it returns is cached by exactly what it saw.
"""

from __future__ import annotations

import atexit
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from fdem.log import logger

__all__ = ["ROUND", "fill_surface", "mesh_polygon", "session"]

Array = Any

ROUND = 2.0**-20
_OPTIONS = {
    "General.Terminal": 0,
    "General.Verbosity": 0,
    "General.NumThreads": 1,  # HXT on two threads gave another mesh every time
    "Mesh.MeshSizeExtendFromBoundary": 1,
    "Mesh.MeshSizeFromPoints": 1,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.MeshSizeMin": 0,
    "Mesh.ElementOrder": 1,
    "Mesh.SecondOrderIncomplete": 0,
    "Mesh.RecombineAll": 0,
    "Mesh.Optimize": 1,
    "Mesh.RandomSeed": 1,
}
_CHANGED = (*_OPTIONS, "Mesh.Algorithm", "Mesh.Algorithm3D", "Mesh.MeshSizeMax", "Mesh.OptimizeNetgen")
_CACHE_SIZE = 4096
_cache: OrderedDict[Any, Any] = OrderedDict()


@contextmanager
def session() -> Iterator[Any]:
    """Give gmsh, quiet and with our options; what a user of the process had set is put back afterwards."""
    import gmsh

    if not gmsh.isInitialized():
        gmsh.initialize(interruptible=False)
        atexit.register(lambda: gmsh.isInitialized() and gmsh.finalize())
    models = gmsh.model.list()
    current = gmsh.model.getCurrent() if models else None
    saved = {name: gmsh.option.getNumber(name) for name in _CHANGED}
    _set_options(gmsh)
    try:
        yield gmsh
    finally:
        for name, value in saved.items():
            gmsh.option.setNumber(name, value)
        if current is not None and current in gmsh.model.list():
            gmsh.model.setCurrent(current)


def _set_options(gmsh: Any) -> None:
    for name, value in _OPTIONS.items():
        gmsh.option.setNumber(name, value)


def _attempt(gmsh: Any, make: Callable[[], Any]) -> Any:
    """Result of a gmsh job in a model of its own, None if gmsh gave up."""
    gmsh.model.add("fdem part")
    try:
        return make()
    except Exception as error:  # gmsh raises nothing more specific
        logger.debug("gmsh: %s", error)
        failed = True
    finally:
        gmsh.model.remove()
    if failed and gmsh.model.list() in ([], [""]):
        # after an error inside a mesher gmsh does nothing any more until it is started again
        gmsh.finalize()
        gmsh.initialize(interruptible=False)
        _set_options(gmsh)
    return None


def _cached(key: Any, make: Callable[[], Any]) -> Any:
    if key in _cache:
        _cache.move_to_end(key)
        return _cache[key]
    value = make()
    _cache[key] = value
    if len(_cache) > _CACHE_SIZE:
        _cache.popitem(last=False)
    return value


def mesh_polygon(
    gmsh: Any, corners: Array, divisions: Array, size: float, algorithm: int
) -> tuple[Array, Array] | None:
    """Triangulate a plane polygon.

    Parameters
    ----------
    gmsh : module
        From `session`.
    corners : (n, 2) array
        Corners, counter-clockwise, of order one and rounded to `ROUND`.
    divisions : (n,) int array
        Equal parts of the edge that starts at each corner.
    size : float
        Largest edge inside, in the units of `corners`.
    algorithm : int
        gmsh's ``Mesh.Algorithm``.

    Returns
    -------
    points : (k, 2) array
        Points inside.
    triangles : (m, 3) int array
        Counter-clockwise. Numbers: the boundary points in order round the polygon, then `points`.
        None instead of both if gmsh gave up.
    """
    key = ("polygon", corners.tobytes(), divisions.tobytes(), size, algorithm)

    def mesh() -> tuple[Array, Array]:
        return _mesh_polygon(gmsh, corners, divisions, size, algorithm)

    return _cached(key, lambda: _attempt(gmsh, mesh))


def _mesh_polygon(gmsh: Any, corners: Array, divisions: Array, size: float, algorithm: int) -> tuple[Array, Array]:
    n = len(corners)
    gmsh.option.setNumber("Mesh.Algorithm", algorithm)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    geo = gmsh.model.geo
    points = [geo.addPoint(x, y, 0.0, size) for x, y in corners.tolist()]
    lines = [geo.addLine(points[i], points[(i + 1) % n]) for i in range(n)]
    for line, parts in zip(lines, divisions.tolist(), strict=True):
        geo.mesh.setTransfiniteCurve(line, parts + 1)
    surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    geo.synchronize()
    gmsh.model.mesh.generate(2)
    order: list[int] = []
    for point, line in zip(points, lines, strict=True):
        order.append(int(gmsh.model.mesh.getNodes(0, point)[0][0]))
        tags, _, place = gmsh.model.mesh.getNodes(1, line, returnParametricCoord=True)
        order.extend(np.asarray(tags)[np.argsort(place)].tolist())
    inner, coordinates, _ = gmsh.model.mesh.getNodes(2, surface)
    order.extend(np.asarray(inner).tolist())
    triangles = np.asarray(gmsh.model.mesh.getElementsByType(2)[1], dtype=np.int64).reshape(-1, 3)
    number = np.full(int(max(max(order), triangles.max(initial=0))) + 1, -1)
    number[order] = np.arange(len(order))
    return np.asarray(coordinates).reshape(-1, 3)[:, :2].copy(), number[triangles]


def fill_surface(
    gmsh: Any, points: Array, triangles: Array, size: float, algorithm: int, netgen: bool
) -> tuple[Array, Array] | None:
    """Fill a closed triangulated surface with tetrahedra; the surface itself is kept.

    Parameters
    ----------
    gmsh : module
        From `session`.
    points : (n, 3) array
        Surface points, of order one and rounded to `ROUND`.
    triangles : (k, 3) int array
        The surface, outward.
    size : float
        Largest edge inside, in the units of `points`.
    algorithm : int
        gmsh's ``Mesh.Algorithm3D`` (10: HXT, 1: Delaunay).
    netgen : bool
        Whether Netgen's optimiser runs as well.

    Returns
    -------
    inside : (j, 3) array
        Points inside.
    tets : (m, 4) int array
        Numbers: `points`, then `inside`. None instead of both if gmsh gave up.
    """
    key = ("volume", points.tobytes(), triangles.tobytes(), size, algorithm, netgen)

    def fill() -> tuple[Array, Array]:
        return _fill_surface(gmsh, points, triangles, size, algorithm, netgen)

    return _cached(key, lambda: _attempt(gmsh, fill))


def _fill_surface(
    gmsh: Any, points: Array, triangles: Array, size: float, algorithm: int, netgen: bool
) -> tuple[Array, Array]:
    gmsh.option.setNumber("Mesh.Algorithm3D", algorithm)
    gmsh.option.setNumber("Mesh.OptimizeNetgen", int(netgen))
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    n = len(points)
    surface = gmsh.model.addDiscreteEntity(2)
    gmsh.model.mesh.addNodes(2, surface, np.arange(1, n + 1), points.ravel())
    gmsh.model.mesh.addElementsByType(surface, 2, [], (triangles + 1).ravel())
    geo = gmsh.model.geo
    volume = geo.addVolume([geo.addSurfaceLoop([surface])])
    geo.synchronize()
    gmsh.model.mesh.generate(3)
    tags, coordinates, _ = gmsh.model.mesh.getNodes(3, volume)
    tets = np.asarray(gmsh.model.mesh.getElementsByType(4)[1], dtype=np.int64).reshape(-1, 4)
    number = np.full(int(max(np.max(tags, initial=n), tets.max(initial=0))) + 1, -1)
    number[1 : n + 1] = np.arange(n)
    number[np.asarray(tags, dtype=np.int64)] = n + np.arange(len(tags))
    return np.asarray(coordinates).reshape(-1, 3).copy(), number[tets]
