"""Reading shapes from files and from other libraries' meshes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fdem.errors import MeshError, SceneError
from fdem.scene.checks import number
from fdem.scene.meshdata import VolumeMesh, divide_mesh, volume_mesh
from fdem.scene.polygons import Array
from fdem.scene.shapes import Polyhedron, Shape, Surface, TetMesh

__all__ = ["as_shape", "read", "tet_blocks"]


def read(path: Any, scale: float = 1.0, *, surface: bool = False) -> list[Shape]:
    """Shapes from a file.

    Parameters
    ----------
    path : path
        OBJ (one shape per ``o`` or ``g``), STL, PLY, OFF (one shape per connected part), or a volume mesh
        such as msh, vtu, inp (one shape per physical volume and connected part): whatever meshio reads.
    scale : float, optional
        Length of the file's unit [m].
    surface : bool, optional
        Take open surfaces as `Surface` (terrain) where a closed one is expected otherwise.

    Returns
    -------
    list of Shape
        `Polyhedron`, `TetMesh` with zone and facet tags, or `Surface`; `name` is that of the file's group.

    Raises
    ------
    SceneError
        If the file is missing or of an unknown format, or `scale` is not positive.
    MeshError
        If a surface is open, overlaps itself or is degenerate; file and group are named.
    """
    number("read", "scale", scale, low=0.0, open_low=True)
    file = Path(path)
    if not file.is_file():
        raise SceneError(f"read: path = {str(path)!r}, there is no such file")
    if file.suffix.lower() == ".obj":
        groups = _obj_groups(file)
    else:
        mesh = _meshio(file)
        volume = volume_mesh(mesh, str(file))
        if volume is not None:
            volume.points = volume.points * float(scale)
            return [shape for shape, _ in divide_mesh(volume, [])]
        groups = _meshio_surfaces(mesh, file)
    if not groups:
        raise MeshError(f"read: {file}: empty mesh, the file holds no faces")
    return [_closed(file, name, points * float(scale), faces, surface) for name, points, faces in groups]


def tet_blocks(mesh_or_path: Any, split: Any = None) -> list[tuple[TetMesh, str | None]]:
    """Blocks of a volume mesh: one per physical volume and part that hangs together.

    Parameters
    ----------
    mesh_or_path : path or mesh
        A file that meshio reads, a meshio mesh, a `skfem.MeshTet` or a pyvista grid of tetrahedra.
    split : str or list of str, optional
        Tags of surfaces along which the mesh becomes several blocks.

    Returns
    -------
    list of (TetMesh, str or None)
        Each block and the name of its physical volume. Facets between blocks of different volumes carry the
        tag ``"a|b"`` (names in alphabetical order) unless the mesh gives them one.

    Raises
    ------
    SceneError
        If a tag is unknown or its surface ends inside the body.
    """
    tags = [split] if isinstance(split, str) else list(split or [])
    if isinstance(mesh_or_path, (str, Path)):
        file = Path(mesh_or_path)
        if not file.is_file():
            raise SceneError(f"from_mesh: path = {str(mesh_or_path)!r}, there is no such file")
        mesh, source = _meshio(file), str(file)
    else:
        mesh, source = mesh_or_path, type(mesh_or_path).__name__
    volume = volume_mesh(mesh, source)
    if volume is None:
        raise SceneError(f"from_mesh: {source} holds no tetrahedra")
    return divide_mesh(volume, tags)


def as_shape(value: Any) -> Shape:
    """A shape from what the user handed over.

    Parameters
    ----------
    value : Shape or mesh
        A fdem shape (returned as it is), a closed `pyvista.PolyData`, a `skfem.MeshTet`, a meshio mesh or a
        pyvista grid of tetrahedra or of a closed surface.

    Returns
    -------
    Shape
        `Polyhedron` or `TetMesh`.

    Raises
    ------
    SceneError
        If it is none of these.
    """
    if isinstance(value, Shape):
        return value
    kind = type(value).__name__
    if _is_polydata(value):
        points, faces = _welded(np.asarray(value.points, dtype=np.float64), _padded_faces(np.asarray(value.faces)))
        return Polyhedron(points, faces)
    volume = volume_mesh(value, kind)
    if volume is not None:
        return _whole(volume)
    if hasattr(value, "cells") and hasattr(value, "points"):
        groups = _meshio_surfaces(value, Path(kind))
        if len(groups) == 1:
            return Polyhedron(groups[0][1], groups[0][2])
        if groups:
            raise MeshError(f"shape: the {kind} has {len(groups)} disconnected parts; make each a block of its own")
    raise SceneError(
        f"shape = {kind}, allowed are fdem shapes, a closed pyvista.PolyData, a skfem.MeshTet and a meshio mesh"
    )


def _whole(volume: VolumeMesh) -> TetMesh:
    """A volume mesh as one block, whatever its physical volumes."""
    zones = {g: np.flatnonzero(volume.group == k) for k, g in enumerate(volume.groups) if g is not None}
    return TetMesh(volume.points, volume.tets, zones, volume.facets)


def _is_polydata(value: Any) -> bool:
    return hasattr(value, "faces") and hasattr(value, "n_points") and hasattr(value, "points")


def _padded_faces(flat: Array) -> list[list[int]]:
    """Loops from VTK's flat array of (n, v0, v1, ...)."""
    out, k, values = [], 0, flat.tolist()
    while k < len(values):
        out.append(values[k + 1 : k + 1 + values[k]])
        k += values[k] + 1
    return out


def _meshio(file: Path) -> Any:
    import meshio

    try:
        return meshio.read(file)
    except (Exception, SystemExit) as error:
        # meshio leaves the interpreter where no reader fits
        reason = "meshio cannot read it" if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        raise SceneError(f"read: {file}: {reason}") from None


def _closed(file: Path, name: str | None, points: Array, faces: list[list[int]], surface: bool) -> Shape:
    """A polyhedron of one group of a file; messages name the file."""
    points, faces = _welded(points, faces)
    try:
        if surface and _is_open(faces):
            return Surface(points, faces, name=name)
        return Polyhedron(points, faces, name=name)
    except MeshError as error:
        raise MeshError(f"read: {file}: {error}") from None


def _is_open(faces: list[list[int]]) -> bool:
    edges: dict[tuple[int, int], int] = {}
    for face in faces:
        for k, b in enumerate(face):
            key = (min(face[k - 1], b), max(face[k - 1], b))
            edges[key] = edges.get(key, 0) + 1
    return any(count == 1 for count in edges.values())


def _welded(points: Array, faces: Sequence[Sequence[int]]) -> tuple[Array, list[list[int]]]:
    """Points used by faces with equal ones made one, in order of first use; faces collapsed by it go."""
    index: dict[tuple[float, ...], int] = {}
    out: list[list[int]] = []
    rows = points.tolist()
    for face in faces:
        loop = [index.setdefault(tuple(rows[v]), len(index)) for v in face]
        loop = [v for k, v in enumerate(loop) if v != loop[k - 1]]
        if len(loop) > 2:
            out.append(loop)
    return np.array(list(index), dtype=np.float64).reshape(-1, 3), out


def _parts(points: Array, faces: list[list[int]]) -> list[list[list[int]]]:
    """Faces by connected part, after welding."""
    index: dict[tuple[float, ...], int] = {}
    same = [index.setdefault(tuple(p), len(index)) for p in points.tolist()]
    root = list(range(len(index)))

    def find(i: int) -> int:
        while root[i] != i:
            root[i] = root[root[i]]
            i = root[i]
        return i

    for face in faces:
        for v in face[1:]:
            root[find(same[v])] = find(same[face[0]])
    groups: dict[int, list[list[int]]] = {}
    for face in faces:
        groups.setdefault(find(same[face[0]]), []).append(face)
    return list(groups.values())


def _meshio_surfaces(mesh: Any, file: Path) -> list[tuple[str | None, Array, list[list[int]]]]:
    """Connected parts of the surface cells of a meshio mesh."""
    faces: list[list[int]] = []
    for block in mesh.cells:
        if block.type in ("triangle", "quad", "polygon"):
            faces += [np.asarray(face).tolist() for face in block.data]
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim == 2 and points.shape[1] == 2:
        raise MeshError(f"read: {file}: points have two coordinates, blocks need three")
    return [(None, points, part) for part in _parts(points, faces)] if faces else []


def _obj_groups(file: Path) -> list[tuple[str | None, Array, list[list[int]]]]:
    """Groups of an OBJ file; without any, its connected parts."""
    points: list[tuple[float, float, float]] = []
    groups: list[tuple[str | None, list[list[int]]]] = []
    named: dict[str, list[list[int]]] = {}
    current: list[list[int]] | None = None
    lines = file.read_text(encoding="utf-8", errors="replace").replace("\\\n", " ").splitlines()
    for row, line in enumerate(lines, start=1):
        word, _, rest = line.strip().partition(" ")
        if word == "v":
            try:
                x, y, z = (float(t) for t in rest.split()[:3])
            except ValueError:
                raise MeshError(f"read: {file}, line {row}: v = {rest!r} is not three coordinates") from None
            points.append((x, y, z))
        elif word in ("o", "g"):
            name = rest.strip() or None
            if word == "o":
                named = {}
            # a group taken up again goes on; an object starts anew
            if word == "g" and name in named:
                current = named[name]
                continue
            current = []
            groups.append((name, current))
            if name is not None:
                named[name] = current
        elif word == "f":
            if current is None:
                current = []
                groups.append((None, current))
            current.append(_obj_face(file, row, rest, len(points)))
    table = np.array(points, dtype=np.float64).reshape(-1, 3)
    filled = [(name, faces) for name, faces in groups if faces]
    if len(filled) == 1 and filled[0][0] is None:
        return [(None, table, part) for part in _parts(table, filled[0][1])]
    return [(name, table, faces) for name, faces in filled]


def _obj_face(file: Path, row: int, text: str, n_points: int) -> list[int]:
    """Vertex indices of one ``f`` line, from 0."""
    loop = []
    for word in text.split():
        try:
            index = int(word.split("/")[0])
        except ValueError:
            raise MeshError(f"read: {file}, line {row}: f = {text!r} is not a list of vertex indices") from None
        vertex = index - 1 if index > 0 else n_points + index
        if index == 0 or not 0 <= vertex < n_points:
            raise MeshError(f"read: {file}, line {row}: face index {index} out of range, {n_points} points so far")
        loop.append(vertex)
    if len(loop) < 3:
        raise MeshError(f"read: {file}, line {row}: f = {text!r} has fewer than three vertices")
    return loop
