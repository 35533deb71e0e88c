"""What a picture shows: the blocks where they are drawn, cut open or not, as triangles and edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.errors import SceneError
from fdem.results import surfaces
from fdem.results.balls import skins_of

__all__ = ["Picture", "Sheet"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]


@dataclass
class Sheet:
    """Visible triangles: points (n, 3), triangles (m, 3), nodal values (n, k), block and joint tag of each (m,)."""

    points: Array
    triangles: Ints
    values: Array
    block: Ints
    tag: Ints


@dataclass
class Picture:
    """Positions to draw and the blocks to draw; the cut, if any. `gridpoint` is what each point moves with."""

    view: Any
    warp: float | str
    hide: Sequence[str | int]
    clip: Any
    note: str = field(init=False, default="")
    factor: float = field(init=False)
    n_faces: int = field(init=False)
    thin: int | None = field(init=False)

    def __post_init__(self) -> None:
        model, view = self.model, self.view
        self.shown = ~_hidden(model, self.hide)
        # faces of blocks, then those of spheres, whose points move with their centres
        faces, skins = self.shown[model.triangle_block], skins_of(model, self.shown)
        self.n_faces = int(faces.sum())
        self.gridpoint: Ints = np.concatenate([np.arange(len(model.X), dtype=np.int32), skins.gridpoint])
        self.triangles: Ints = np.concatenate([model.triangles[faces], skins.triangles + np.int32(len(model.X))])
        self.block: Ints = np.concatenate([model.triangle_block[faces], skins.block])
        self.tag: Ints = np.concatenate([model.triangle_tag[faces], np.full(len(skins.block), -1, dtype=np.int32)])
        # closed surfaces: the spheres of a clump overlap
        centre = skins.gridpoint[skins.triangles[:, 0]]
        self.part: Ints = np.concatenate([self.block[: self.n_faces], len(model.names) + centre])
        self.used = np.unique(self.triangles)
        if not len(self.used):
            raise SceneError("plot: nothing to draw, all blocks are hidden")
        displacement = np.asarray(view.displacements())[self.gridpoint]
        self.positions: Array = np.asarray(view.positions(), dtype=np.float64)[self.gridpoint]
        self.positions[len(model.X) :] += skins.offset
        positions = self.positions
        extent = np.ptp(positions[self.used], axis=0)
        if self.warp == "auto":
            largest = float(np.linalg.norm(displacement[self.used], axis=1).max())
            self.factor = 0.05 * float(extent.max()) / largest if largest > 0.0 else 1.0
            self.factor = float(f"{self.factor:.1g}")
        elif isinstance(self.warp, str):
            raise SceneError(f"plot: warp must be a number or 'auto', got {self.warp!r}")
        else:
            self.factor = float(self.warp)
        self.points: Array = positions + (self.factor - 1.0) * displacement
        order = np.argsort(extent)
        self.thin = int(order[0]) if extent[order[0]] < 0.25 * extent[order[1]] else None
        if self.clip is not None:
            self.clip = _plane(self.clip)

    @property
    def model(self) -> Any:
        """The model drawn."""
        return self.view.model

    def look(self, camera: str | Sequence[float] | None) -> Array:
        """Find the unit vector from the scene to the eye."""
        corner = np.array([0.55, -1.0, 0.55])
        if camera is None:
            if self.thin is not None:
                direction = np.eye(3)[self.thin] * (-1.0 if self.thin == 1 else 1.0)
            elif self.clip is not None:
                normal = self.clip[0]
                side = np.cross([0.0, 0.0, 1.0], normal)
                direction = normal + 0.45 * side + (0.0 if abs(normal[2]) > 0.8 else 0.4) * np.array([0.0, 0.0, 1.0])
                if abs(normal[2]) > 0.8:
                    direction = normal + 0.7 * np.array([0.4, -1.0, 0.0])
            else:
                direction = corner
        elif isinstance(camera, str):
            axis = camera.lstrip("+-")
            if camera == "iso":
                direction = corner
            elif axis in ("x", "y", "z"):
                direction = np.eye(3)["xyz".index(axis)] * (-1.0 if camera.startswith("-") else 1.0)
            else:
                raise SceneError(f"plot: camera must be iso, x, -x, y, -y, z, -z or a direction, got {camera!r}")
        else:
            direction = np.asarray(camera, dtype=np.float64)
            if direction.shape != (3,) or not np.linalg.norm(direction) > 0.0:
                raise SceneError(f"plot: camera must be a direction (3,) that is not zero, got {camera!r}")
        return np.asarray(direction / np.linalg.norm(direction))

    def flat_look(self, camera: Any) -> bool:
        """Whether one looks along an axis: then without perspective."""
        return bool(np.abs(self.look(camera)).max() > 0.9999)

    def sheet(self, nodal: Array) -> Sheet:
        """Surface of what is shown, cut open and capped if there is a clip."""
        if self.clip is None:
            return Sheet(self.points, self.triangles, nodal, self.block, self.tag)
        parts = [_below(self, nodal), *_zone_caps(self, nodal), *_block_caps(self, nodal)]
        start = np.cumsum([0, *(len(part.points) for part in parts)])
        return Sheet(
            np.concatenate([part.points for part in parts]),
            np.concatenate([part.triangles + n for part, n in zip(parts, start[:-1], strict=True)]).astype(np.int32),
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.block for part in parts]),
            np.concatenate([part.tag for part in parts]),
        )

    def outlines(self) -> tuple[Array, Ints, Ints]:
        """Find the edges of blocks and their traces in the cut.

        Returns
        -------
        points : (n, 3) array
            Points as drawn.
        lines : (k, 2) int32 array
            Edges of blocks as far as the cut leaves them, then traces.
        tag : (k,) int32 array
            Joint set of a trace; also of an edge where a face of that set ends in one of none.
        """
        lines, sides = surfaces.feature_edges(self.model.X, self.triangles[: self.n_faces])
        tags = self.tag[sides]
        tag = np.where(tags.min(axis=1) < 0, tags.max(axis=1), -1)
        if self.clip is None:
            return self.points, lines, tag
        normal, origin = self.clip
        distance = (self.points - origin) @ normal
        kept = (distance[lines] <= 0.0).any(axis=1)
        lines, tag = lines[kept], tag[kept]
        ends = self.points[lines]
        d = distance[lines]
        for i, j in ((0, 1), (1, 0)):
            over = d[:, i] > 0.0
            share = (d[over, i] / (d[over, i] - d[over, j]))[:, None]
            ends[over, i] += share * (ends[over, j] - ends[over, i])
        cut = surfaces.section(self.points, self.triangles, normal, origin)
        points = np.concatenate([ends.reshape(-1, 3), cut.interpolate(self.points)])
        whole = np.arange(2 * len(ends), dtype=np.int32).reshape(-1, 2)
        lines = np.concatenate([whole, cut.segments + 2 * len(ends)]).astype(np.int32)
        return points, lines, np.concatenate([tag, self.tag[cut.triangle]])


def _plane(clip: Any) -> tuple[Array, Array]:
    """Check the plane of a cut; its unit normal and a point of it."""
    try:
        normal, origin = (np.asarray(part, dtype=np.float64) for part in clip)
    except (TypeError, ValueError):
        normal = origin = np.empty(0)
    if normal.shape != (3,) or origin.shape != (3,) or not np.linalg.norm(normal) > 0.0:
        raise SceneError(f"plot: clip must be (normal, origin), each (3,), got {clip!r}")
    return normal / np.linalg.norm(normal), origin


def _hidden(model: Any, hide: Sequence[str | int]) -> NDArray[np.bool_]:
    """Blocks that are not drawn, (n_blocks,)."""
    hidden = np.zeros(len(model.names), dtype=bool)
    for what in [hide] if isinstance(hide, str) else hide:
        if isinstance(what, (int, np.integer)):
            found = np.arange(len(hidden)) == what
        else:
            pairs = zip(model.names, model.groups, strict=True)
            found = np.array([any(fnmatchcase(name or "", what) for name in pair) for pair in pairs])
        if not found.any():
            raise SceneError(f"plot: hide={what!r} is no block, name or group")
        hidden |= found
    return hidden


def _below(picture: Picture, nodal: Array) -> Sheet:
    """Part of the surface that the cut leaves."""
    import pyvista as pv

    data = pv.PolyData.from_regular_faces(picture.points, picture.triangles)
    data.point_data["values"] = nodal
    data.cell_data["block"], data.cell_data["tag"] = picture.block, picture.tag
    left = data.clip(normal=picture.clip[0], origin=picture.clip[1]).triangulate()
    if not left.n_cells:
        raise SceneError("plot: clip leaves nothing to draw")
    return _sheet_of(left)


def _sheet_of(data: Any) -> Sheet:
    values = np.asarray(data.point_data["values"], dtype=np.float64).reshape(data.n_points, -1)
    triangles = np.asarray(data.regular_faces, dtype=np.int32)
    block, tag = (np.asarray(data.cell_data[name], dtype=np.int32) for name in ("block", "tag"))
    return Sheet(np.asarray(data.points, dtype=np.float64), triangles, values, block, tag)


def _zone_caps(picture: Picture, nodal: Array) -> list[Sheet]:
    """Zones cut by the plane."""
    import pyvista as pv

    model = picture.model
    shown = picture.shown[model.zone_block] if len(model.zones) else np.empty(0, dtype=bool)
    above = (picture.points - picture.clip[1]) @ picture.clip[0] > 0.0
    side = above[model.zones[shown]]
    crossed = np.flatnonzero(shown)[side.any(axis=1) & ~side.all(axis=1)]
    if not len(crossed):
        return []
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: model.zones[crossed]}, picture.points)
    grid.point_data["values"] = nodal
    grid.cell_data["block"] = model.zone_block[crossed]
    grid.cell_data["tag"] = np.full(len(crossed), -1, dtype=np.int32)
    cut = grid.slice(normal=picture.clip[0], origin=picture.clip[1]).triangulate()
    return [_sheet_of(cut)] if cut.n_cells else []


def _block_caps(picture: Picture, nodal: Array) -> list[Sheet]:
    """Blocks without zones cut by the plane."""
    model = picture.model
    bare = ~np.asarray(model.zoned, dtype=bool)[picture.block]
    triangles, owner, part = picture.triangles[bare], picture.block[bare], picture.part[bare]
    cut = surfaces.section(picture.points, triangles, *picture.clip)
    if not len(cut.segments):
        return []
    points, block, part = cut.interpolate(picture.points), owner[cut.triangle], part[cut.triangle]
    faces, faces_block = [], []
    for closed in np.unique(part):
        filled = surfaces.cap(points, cut.segments[part == closed], picture.clip[0])
        faces.append(filled)
        faces_block.append(np.full(len(filled), block[part == closed][0], dtype=np.int32))
    triangles = np.concatenate(faces)
    tag = np.full(len(triangles), -1, dtype=np.int32)
    return [Sheet(points, triangles, cut.interpolate(nodal), np.concatenate(faces_block), tag)]
