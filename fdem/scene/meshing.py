"""Zones: from the shape of a block to its tetrahedra."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np

from fdem.errors import MeshError
from fdem.log import logger
from fdem.scene.gmsh_session import ROUND, fill_surface, session
from fdem.scene.interfaces import Interfaces
from fdem.scene.surfaces import BlockSurface, SharedSurfaces
from fdem.scene.tetmesh import TetMesh, boundary_facets

__all__ = ["ZoneMesh", "zone_meshes"]

Array = Any

# (gmsh algorithm, Netgen): HXT, HXT + Netgen, Delaunay, Delaunay + Netgen
_RECIPES = ((10, False), (10, True), (1, False), (1, True))
_GOOD = 0.1  # altitude over the shortest surface edge: below it another recipe is tried
_TINY = 1e-12  # six volumes over the cube of the longest edge below which a zone is refused, as in TetMesh
_VOLUME = 1e-5  # the zones must fill the block to this part
_FAN = 1.25  # convex blocks within this many sizes of their centroid may be fanned
_RENUMBER = 256  # points from which the order of memory matters


@dataclass(frozen=True)
class ZoneMesh:
    """The zones of one block.

    Parameters
    ----------
    points : (n, 3) array
        Gridpoints [m].
    tets : (m, 4) int32 array
        Zones, positively oriented, neighbours near each other in memory.
    triangles : (k, 3) int32 array
        Boundary, outward.
    triangle_face : (k,) int32 array
        Face of the polyhedron (of the surface of a `TetMesh`) each lies on.
    size : float
        Zone edge that the block asked for [m]; ``inf``: none.
    """

    points: Array
    tets: Array
    triangles: Array
    triangle_face: Array
    size: float = np.inf


def zone_meshes(
    shapes: Sequence[Any],
    sizes: Sequence[float | None],
    names: Sequence[Any] | None = None,
    notes: list[str] | None = None,
) -> list[ZoneMesh]:
    """Divide blocks into zones, all at once, so that neighbours share the triangles of what their faces have in common.

    Parameters
    ----------
    shapes : sequence of Polyhedron or TetMesh
        The blocks; the zones of a `TetMesh` are taken as they are.
    sizes : sequence of (float or None)
        Target zone edge of each [m]; None: as few zones as possible (a convex block is joined to its centroid).
    names : sequence, optional
        What to call the blocks in messages; None: their number in `shapes`.
    notes : list of str, optional
        Gets what is worth telling: faces with one mesh, with meshes of their own.

    Returns
    -------
    list of ZoneMesh
        In the order of `shapes`.

    Raises
    ------
    MeshError
        If a block cannot be meshed; names it.

    Notes
    -----
    One gmsh model per block, in normalised coordinates: equal blocks get equal meshes anywhere and in any unit.
    Where neighbours ask for different sizes the finer one wins on the common face. A block that gmsh cannot fill
    from the shared surface gets a surface of its own.
    """
    names = range(len(shapes)) if names is None else names
    meshes: list[ZoneMesh | None] = [None] * len(shapes)
    chosen: list[int] = []
    for k, shape in enumerate(shapes):
        if isinstance(shape, TetMesh):
            triangles = shape.triangles
            meshes[k] = ZoneMesh(shape.points, shape.tets, triangles, np.arange(len(triangles), dtype=np.int32))
        else:
            chosen.append(k)
    if chosen:
        targets = [np.inf if (size := sizes[k]) is None else float(size) for k in chosen]
        surfaces = SharedSurfaces([shapes[k] for k in chosen], targets, [names[k] for k in chosen])
        # a convex block that asks for no size needs no gmsh
        fans = [size == np.inf and shapes[k].is_convex for k, size in zip(chosen, targets, strict=True)]
        alone = []
        with nullcontext() if all(fans) else session() as gmsh:
            for place, k in enumerate(chosen):
                if fans[place] and not surfaces.is_finer(place):
                    meshes[k] = _fan_of(shapes[k], names[k])
                    continue
                try:
                    meshes[k] = _filled(gmsh, shapes[k], targets[place], surfaces.surface(gmsh, place), names[k])
                except MeshError as error:
                    logger.info("%s; it gets a surface mesh of its own", error)
                    own = SharedSurfaces([shapes[k]], [targets[place]], [names[k]])
                    meshes[k] = _filled(gmsh, shapes[k], targets[place], own.surface(gmsh, 0), names[k])
                    alone.append(names[k])
        if notes is not None:
            notes.extend(_notes(surfaces.interfaces, alone))
    return [mesh for mesh in meshes if mesh is not None]


def _notes(interfaces: Interfaces, alone: list[Any]) -> list[str]:
    """What became of the faces that blocks have in common."""
    lines = []
    if interfaces.shared:
        lines.append(f"zones: {interfaces.shared} common faces of blocks carry one surface mesh")
    if interfaces.separate:
        lines.append(
            f"zones: {interfaces.separate} overlaps of faces are left to independent meshes, a common one would be "
            "much finer than the zones"
        )
    if alone:
        several = ", ".join(repr(name) for name in alone[:5]) + (", ..." if len(alone) > 5 else "")
        lines.append(
            f"zones: {len(alone)} blocks ({several}) have surface meshes of their own, gmsh could not fill the shared "
            "ones"
        )
    return lines


def _fan_of(shape: Any, block: Any) -> ZoneMesh:
    """Join the triangles of a convex block's surface to its centroid."""
    triangles = np.asarray(shape.triangles)
    points = np.vstack([shape.points, shape.centroid])
    tets = _fan(triangles, len(shape.points))
    if not _acceptable(points, tets):
        raise MeshError(f"block {block}: the block is too flat to be joined to its centroid")
    return ZoneMesh(points, tets, triangles.astype(np.int32), np.asarray(shape.triangle_face, dtype=np.int32))


def _fan(triangles: Array, apex: int) -> Array:
    # reversed, because an outward triangle seen from inside turns the other way
    return np.column_stack([triangles[:, ::-1], np.full(len(triangles), apex)]).astype(np.int32)


@dataclass(frozen=True)
class _Surface:
    """A closed surface mesh in the order and the places that gmsh sees."""

    shape: Any
    size: float
    points: Array  # (n, 3) [m]
    places: Array  # (n, 3) normalised and rounded
    triangles: Array
    middle: Array
    extent: float

    def fan(self) -> tuple[Array, Array]:
        """The centroid, and the tets that join it to all triangles."""
        return np.asarray(self.shape.centroid)[None, :], _fan(self.triangles, len(self.points))

    def judged(self, inside: Array, tets: Array) -> tuple[float, Array, Array] | None:
        """The mesh with its smallest altitude, which sets the stable step; None if it does not fill the block."""
        points = np.concatenate([self.points, inside])
        tets = _positive(points, tets)
        volume = float(_volumes6(points, tets).sum()) / 6.0
        if abs(volume - self.shape.volume) > _VOLUME * self.shape.volume or not _acceptable(points, tets):
            return None
        return _smallest_altitude(points, tets), inside, tets


def _filled(gmsh: Any, shape: Any, size: float, raw: BlockSurface, block: Any) -> ZoneMesh:
    """Fill a surface mesh with zones and put everything into a fast order."""
    # numbers by place: what gmsh sees does not depend on how the scene was listed
    order = np.lexsort(raw.places.T[::-1])
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.arange(len(order))
    triangles, owner = _sorted_triangles(number[raw.triangles], raw.triangle_face)
    surface = _Surface(shape, size, raw.points[order], raw.places[order], triangles, raw.middle, raw.extent)
    inside, tets = _best_fill(gmsh, surface, block)
    return _renumbered(np.concatenate([surface.points, inside]), tets, triangles, owner, size)


def _best_fill(gmsh: Any, surface: _Surface, block: Any) -> tuple[Array, Array]:
    """Points inside [m] and tets by the first good recipe, else by the best of all."""
    points, shape = surface.points, surface.shape
    if len(points) == 4:
        return np.empty((0, 3)), _positive(points, np.array([[0, 1, 2, 3]], dtype=np.int32))
    wanted = _GOOD * _shortest_edge(points, surface.triangles)
    found = []
    if shape.is_convex and np.linalg.norm(points - shape.centroid, axis=1).max() <= _FAN * surface.size:
        found = [mesh for mesh in [surface.judged(*surface.fan())] if mesh]
        if found and (surface.size == np.inf or found[0][0] >= 3.0 * wanted):
            return found[0][1:]
    relative = float(np.rint(min(surface.size / surface.extent, 4.0) / ROUND) * ROUND)
    for algorithm, netgen in _RECIPES:
        filled = fill_surface(gmsh, surface.places, surface.triangles, relative, algorithm, netgen)
        if filled is None or not _keeps_surface(filled[1], surface.triangles):
            continue
        mesh = surface.judged(surface.middle + surface.extent * filled[0], filled[1].astype(np.int32))
        if mesh:
            found.append(mesh)
            if mesh[0] >= wanted:
                break
    if not found and shape.is_convex:
        found = [mesh for mesh in [surface.judged(*surface.fan())] if mesh]
    if not found:
        raise MeshError(
            f"block {block}: gmsh cannot fill its surface ({len(surface.triangles)} triangles, volume "
            f"{shape.volume:.3g} m^3) with zones; is it thinner than 1e-6 of its length, or does it touch itself?"
        )
    return max(found, key=lambda mesh: mesh[0])[1:]


def _volumes6(points: Array, tets: Array) -> Array:
    a, b, c = (points[tets[:, k]] - points[tets[:, 0]] for k in (1, 2, 3))
    return np.einsum("ij,ij->i", a, np.cross(b, c))


def _positive(points: Array, tets: Array) -> Array:
    inverted = _volumes6(points, tets) < 0.0
    if inverted.any():
        tets = tets.copy()
        tets[inverted] = tets[inverted][:, [0, 2, 1, 3]]
    return tets


def _acceptable(points: Array, tets: Array) -> bool:
    corners = points[tets]
    longest = np.linalg.norm(corners[:, [0, 0, 0, 1, 1, 2]] - corners[:, [1, 2, 3, 2, 3, 3]], axis=2).max(axis=1)
    return bool(np.all(_volumes6(points, tets) > _TINY * longest**3))


def _smallest_altitude(points: Array, tets: Array) -> float:
    corners = points[tets]
    facets = corners[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]]
    areas2 = np.linalg.norm(np.cross(facets[:, :, 1] - facets[:, :, 0], facets[:, :, 2] - facets[:, :, 0]), axis=2).max(
        axis=1
    )
    return float(np.min(_volumes6(points, tets) / areas2))


def _shortest_edge(points: Array, triangles: Array) -> float:
    corners = points[triangles]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min())


def _keeps_surface(tets: Array, triangles: Array) -> bool:
    found = np.sort(boundary_facets(tets), axis=1)
    wanted = np.sort(triangles, axis=1)
    if found.shape != wanted.shape:
        return False
    return bool(np.array_equal(found[np.lexsort(found.T)], wanted[np.lexsort(wanted.T)]))


def _sorted_triangles(triangles: Array, owner: Array) -> tuple[Array, Array]:
    """Triangles from their lowest point on, in order: the same surface is always the same array."""
    first = np.argmin(triangles, axis=1)
    triangles = np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)
    order = np.lexsort(triangles.T[::-1])
    return np.ascontiguousarray(triangles[order]), owner[order]


def _renumbered(points: Array, tets: Array, triangles: Array, owner: Array, size: float) -> ZoneMesh:
    """Reverse Cuthill-McKee order of the points, zones and triangles sorted by point."""
    n = len(points)
    if n >= _RENUMBER:
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import reverse_cuthill_mckee

        rows, columns = np.repeat(tets, 4, axis=1).ravel(), np.tile(tets, (1, 4)).ravel()
        graph = coo_matrix((np.ones(rows.size, dtype=np.int8), (rows, columns)), shape=(n, n)).tocsr()
        order = np.asarray(reverse_cuthill_mckee(graph, symmetric_mode=True))
        number = np.empty(n, dtype=np.int64)
        number[order] = np.arange(n)
        points, tets = points[order], number[tets]
        triangles, owner = _sorted_triangles(number[triangles], owner)
    tets = tets[np.lexsort(np.sort(tets, axis=1).T[::-1])]
    return ZoneMesh(
        np.ascontiguousarray(points),
        np.ascontiguousarray(tets, dtype=np.int32),
        np.ascontiguousarray(triangles, dtype=np.int32),
        np.ascontiguousarray(owner, dtype=np.int32),
        size,
    )
