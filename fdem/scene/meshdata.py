"""Volume meshes with named volumes and surfaces, whatever library they come from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdem.errors import MeshError, SceneError
from fdem.scene.polygons import Array, Ints
from fdem.scene.tetmesh import FACETS, TetMesh, boundary_facets, n_parts

__all__ = ["VolumeMesh", "divide_mesh", "volume_mesh"]

# integer cell arrays that files use to number volumes and surfaces, in order of preference
NUMBERS = ("gmsh:physical", "medit:ref", "cell_tags", "CellEntityIds", "group", "block", "region", "material")


@dataclass
class VolumeMesh:
    """Tetrahedra with named volumes and surfaces.

    Attributes
    ----------
    points : (n, 3) array
        [m].
    tets : (m, 4) int array
        Any orientation.
    group : (m,) int array
        Index into `groups`.
    groups : list of (str or None)
        Names of volumes.
    facets : dict of str to (k, 3) int array
        Triangles of named surfaces.
    source : str
        What to call it in messages.
    """

    points: Array
    tets: Ints
    group: Ints
    groups: list[str | None]
    facets: dict[str, Ints] = field(default_factory=dict)
    source: str = "mesh"


def volume_mesh(mesh: Any, source: str) -> VolumeMesh | None:
    """The tetrahedra of a meshio mesh, a skfem mesh or a pyvista grid; None if there are none.

    Parameters
    ----------
    mesh : mesh
        Any of these.
    source : str
        What to call it in messages.

    Returns
    -------
    VolumeMesh or None
        With names of volumes (gmsh physical groups, cell sets, subdomains) and surfaces.

    Raises
    ------
    SceneError
        If there are volume cells other than tetrahedra.
    """
    if hasattr(mesh, "p") and hasattr(mesh, "t"):
        return _from_skfem(mesh, source)
    if hasattr(mesh, "cells_dict") and hasattr(mesh, "celltypes"):
        return _from_pyvista(mesh, source)
    if hasattr(mesh, "cells") and hasattr(mesh, "points"):
        return _from_meshio(mesh, source)
    return None


def _from_skfem(mesh: Any, source: str) -> VolumeMesh | None:
    tets = np.asarray(mesh.t).T
    if tets.shape[1] not in (4, 10):
        return None
    tets = tets[:, :4].astype(np.int32)
    names, group = _by_sets(
        len(tets), {str(k): np.asarray(v) for k, v in (getattr(mesh, "subdomains", None) or {}).items()}
    )
    facets = {
        str(k): np.asarray(mesh.facets).T[np.asarray(v)][:, :3].astype(np.int32)
        for k, v in (getattr(mesh, "boundaries", None) or {}).items()
    }
    return VolumeMesh(np.asarray(mesh.p, dtype=np.float64).T.copy(), tets, group, names, facets, source)


def _from_pyvista(mesh: Any, source: str) -> VolumeMesh | None:
    cells = mesh.cells_dict
    if 10 not in cells:
        return None
    if set(cells) - {10, 5, 3, 1}:
        raise SceneError(f"{source}: cell types {sorted(set(cells) - {10})} are not tetrahedra")
    kinds = np.asarray(mesh.celltypes)
    data = {str(k): np.asarray(mesh.cell_data[k]) for k in mesh.cell_data}
    names, group = _by_numbers({k: v[kinds == 10] for k, v in data.items()}, {}, len(cells[10]))
    points = np.asarray(mesh.points, dtype=np.float64)
    return VolumeMesh(points, cells[10].astype(np.int32), group, names, {}, source)


def _from_meshio(mesh: Any, source: str) -> VolumeMesh | None:
    is_tet = [block.type in ("tetra", "tetra10") for block in mesh.cells]
    if not any(is_tet):
        return None
    solid = {"hexahedron", "wedge", "pyramid", "hexahedron20", "polyhedron"}
    other = sorted({block.type for block in mesh.cells} & solid)
    if other:
        raise SceneError(f"{source}: cells of type {other[0]} cannot be zones, only tetrahedra can")
    tets = _stack(mesh, is_tet, 4)
    names, group = _meshio_names(mesh, is_tet, len(tets), 3)
    is_triangle = [block.type in ("triangle", "triangle6") for block in mesh.cells]
    facets: dict[str, Ints] = {}
    if any(is_triangle):
        triangles = _stack(mesh, is_triangle, 3)
        tags, number_of = _meshio_names(mesh, is_triangle, len(triangles), 2)
        facets = {tag: triangles[number_of == k] for k, tag in enumerate(tags) if tag is not None}
        facets.update(_overlapping(mesh, is_triangle, triangles))
    for name, nodes in (getattr(mesh, "point_sets", None) or {}).items():
        # a node set names the boundary facets all of whose corners are in it
        boundary = boundary_facets(tets)
        chosen = boundary[np.isin(boundary, np.asarray(nodes)).all(axis=1)]
        if len(chosen) and name not in facets:
            facets[str(name)] = chosen
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeshError(f"{source}: points must have shape (n, 3), not {points.shape}")
    return VolumeMesh(points, tets, group, names, facets, source)


def _stack(mesh: Any, chosen: list[bool], corners: int) -> Ints:
    """Corner indices of the chosen cell blocks, one below the other."""
    data = [np.asarray(b.data)[:, :corners] for b, take in zip(mesh.cells, chosen, strict=True) if take]
    return np.concatenate(data).astype(np.int32)


def _sets(mesh: Any, chosen: list[bool]) -> dict[str, Ints]:
    """Cell sets as positions among the chosen blocks, one below the other."""
    out: dict[str, Ints] = {}
    for name, members in (getattr(mesh, "cell_sets", None) or {}).items():
        if str(name).startswith("gmsh:"):
            continue
        start, found = 0, []
        for block, ids, take in zip(mesh.cells, members, chosen, strict=True):
            if take:
                found.append(start + np.asarray([] if ids is None else ids, dtype=np.int64))
                start += len(block.data)
        ids = np.concatenate(found) if found else np.zeros(0, dtype=np.int64)
        if len(ids):
            out[str(name)] = ids
    return out


def _overlapping(mesh: Any, chosen: list[bool], triangles: Ints) -> dict[str, Ints]:
    """Facets of every cell set; a facet may be in several."""
    return {name: triangles[ids] for name, ids in _sets(mesh, chosen).items()}


def _meshio_names(mesh: Any, chosen: list[bool], n: int, dimension: int) -> tuple[list[str | None], Ints]:
    """Names and name index of the chosen cells, from numbers with field names or from cell sets."""
    data = {}
    for key in NUMBERS:
        if key in mesh.cell_data:
            parts = [np.asarray(v) for v, take in zip(mesh.cell_data[key], chosen, strict=True) if take]
            data[key] = np.concatenate(parts)
    fields = {
        int(value[0]): str(name)
        for name, value in (mesh.field_data or {}).items()
        if np.size(value) == 2 and int(value[1]) == dimension
    }
    names, index = _by_numbers(data, fields, n)
    if names == [None]:
        return _by_sets(n, _sets(mesh, chosen))
    return names, index


def _by_numbers(data: dict[str, Any], fields: dict[int, str], n: int) -> tuple[list[str | None], Ints]:
    """Names from the first known integer array; 0 means none where names are given for others."""
    for key in NUMBERS:
        values = data.get(key)
        if values is None or values.ndim != 1 or not np.issubdtype(values.dtype, np.integer) or not values.any():
            continue
        numbers, index = np.unique(values, return_inverse=True)
        names = [fields.get(int(v), str(int(v)) if int(v) != 0 else None) for v in numbers]
        return names, index.reshape(-1).astype(np.int32)
    return [None], np.zeros(n, dtype=np.int32)


def _by_sets(n: int, sets: dict[str, Ints]) -> tuple[list[str | None], Ints]:
    """Names from sets; a cell in several belongs to the smallest, as a set of everything names nothing."""
    index = np.zeros(n, dtype=np.int32)
    names: list[str | None] = [None]
    for name, ids in sorted(sets.items(), key=lambda item: (-len(item[1]), item[0])):
        names.append(name)
        index[ids] = len(names) - 1
    used, compact = np.unique(index, return_inverse=True)
    return [names[k] for k in used.tolist()], compact.reshape(-1).astype(np.int32)


def divide_mesh(mesh: VolumeMesh, split: list[str]) -> list[tuple[TetMesh, str | None]]:
    """Blocks of a volume mesh: parts that hang together in one volume and between splitting surfaces.

    Parameters
    ----------
    mesh : VolumeMesh
        The mesh.
    split : list of str
        Tags of splitting surfaces.

    Returns
    -------
    list of (TetMesh, str or None)
        In the order of volumes, then of their first tetrahedra.

    Raises
    ------
    SceneError
        If a tag is unknown, its surface lies on the boundary only or ends inside the body.
    """
    for tag in split:
        if tag not in mesh.facets:
            raise SceneError(f"{mesh.source}: split = {tag!r} is no surface of the mesh; it has {sorted(mesh.facets)}")
    facets = np.sort(mesh.tets[:, FACETS].reshape(-1, 3), axis=1)
    order = np.lexsort(facets.T[::-1])
    pair = np.flatnonzero((facets[order[1:]] == facets[order[:-1]]).all(axis=1))
    # per interior facet: its corners and the two tetrahedra
    corners, one, two = facets[order[pair]], order[pair] // 4, order[pair + 1] // 4
    between = mesh.group[one] != mesh.group[two]
    cut = {tag: _rows_in(corners, np.sort(mesh.facets[tag], axis=1)) for tag in split}
    closed = between.copy()
    for mask in cut.values():
        closed |= mask
    part = n_parts(mesh.tets, corners[closed])[1]
    for tag, mask in cut.items():
        if not mask.any():
            raise SceneError(f"{mesh.source}: split = {tag!r} lies on the boundary of the mesh, it separates nothing")
        loose = mask & (part[one] == part[two])
        if loose.any():
            place = mesh.points[corners[np.argmax(loose)]].mean(axis=0).tolist()
            raise SceneError(
                f"{mesh.source}: split = {tag!r} ends inside the body, both sides of its facet at {place} hang together"
            )
    tags = _interfaces(mesh, corners[between], one[between], two[between])
    tags.update(mesh.facets)
    return _blocks(mesh, part, tags)


def _interfaces(mesh: VolumeMesh, corners: Ints, one: Ints, two: Ints) -> dict[str, Ints]:
    """Facets between volumes, tagged "a|b"."""
    names = [name or "" for name in mesh.groups]
    keys = ["|".join(sorted((names[a], names[b]))) for a, b in zip(mesh.group[one], mesh.group[two], strict=True)]
    found = np.array(keys)
    return {str(key): corners[found == key] for key in np.unique(found)} if len(found) else {}


def _blocks(mesh: VolumeMesh, part: Ints, tags: dict[str, Ints]) -> list[tuple[TetMesh, str | None]]:
    """One mesh per part."""
    first = np.unique(part, return_index=True)[1]
    out: list[tuple[TetMesh, str | None]] = []
    for k in sorted(range(len(first)), key=lambda k: (mesh.group[first[k]], first[k])):
        group = mesh.groups[int(mesh.group[first[k]])]
        tets = mesh.tets[part == k]
        used = np.unique(tets)
        own = _all_in(used, tags)
        zones = {group: np.arange(len(tets))} if group is not None else {}
        try:
            local = {tag: _own_facets(tets, rows) for tag, rows in own.items()}
            kept = {tag: np.searchsorted(used, rows) for tag, rows in local.items() if len(rows)}
            shape = TetMesh(mesh.points[used], np.searchsorted(used, tets), zones, kept, group)
        except MeshError as error:
            raise MeshError(f"{mesh.source}: {error}") from None
        out.append((shape, group))
    return out


def _all_in(used: Ints, tags: dict[str, Ints]) -> dict[str, Ints]:
    """Of every tag, the facets all of whose corners are used."""
    return {tag: rows[np.isin(rows, used).all(axis=1)] for tag, rows in tags.items()}


def _own_facets(tets: Ints, rows: Ints) -> Ints:
    """The rows that are facets of the tetrahedra."""
    own: Ints = rows[_rows_in(np.sort(rows, axis=1), np.sort(tets[:, FACETS].reshape(-1, 3), axis=1))]
    return own


def _rows_in(rows: Ints, others: Ints) -> Any:
    """Mask of rows that occur among others, both with sorted entries."""
    if not len(rows) or not len(others):
        return np.zeros(len(rows), dtype=bool)
    inverse = np.unique(np.concatenate([rows, others]), axis=0, return_inverse=True)[1].reshape(-1)
    return np.isin(inverse[: len(rows)], inverse[len(rows) :])
