"""Files written while a simulation runs: series of frames for ParaView, and checkpoints."""

from __future__ import annotations

import itertools
import os
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fdem.errors import SceneError, UnsupportedError
from fdem.results.datasets import Cells, cell_stress, cells_of, full_tensor
from fdem.results.history import Every, as_every

__all__ = ["Checkpoint", "Frames"]

_VERTEX, _TRIANGLE, _TETRA = 1, 5, 10  # cell types of VTK


class Frames:
    """A series of frames in one VTKHDF file, which ParaView and pyvista open.

    Points are the current positions [m]; point data ``displacement`` [m], ``velocity`` [m/s] and ``radius`` [m] (0 but
    in the centres of spheres, which are cells of one point: glyphs of this size show them); cell data ``block``,
    ``group`` (numbers) and ``stress`` [Pa] (9 components, tension positive); field data ``group_names``,
    ``block_names`` and ``step``. The mesh is written once, and again when it changes (excavation).

    Parameters
    ----------
    path : path
        File to write, ending in .vtkhdf; an existing one is replaced at the first frame.
    every : Every, int or None, optional
        When; an int counts steps, None is each step.
    axis : {"time", "step"}, optional
        What ParaView counts: time [s], or the number of steps where time has no meaning.

    Raises
    ------
    SceneError
        If the path does not end in .vtkhdf.

    Notes
    -----
    The file is closed after each frame, so it can be opened while the run goes on and survives a
    crash. Positions are written in double precision, everything else in single.

    References
    ----------
    VTKHDF specification 2.x, section "Temporal Data", Kitware.
    """

    def __init__(
        self, path: str | Path, every: Every | int | None = None, *, axis: Literal["time", "step"] = "time"
    ) -> None:
        self.path = Path(path)
        self.every = as_every(every)
        if self.path.suffix != ".vtkhdf":
            raise SceneError(f"Frames: path must end in .vtkhdf, got {str(path)!r}")
        if axis not in ("time", "step"):
            raise SceneError(f"Frames: axis must be 'time' or 'step', got {axis!r}")
        self._axis = axis
        self._model: Any = None
        self._cells: Cells | None = None
        self._step: int | None = None
        self._count = 0

    def __len__(self) -> int:
        """Count the frames written."""
        return self._count

    def next(self, step: int, t: float, dt: float) -> int:
        """Count the steps until due (see `Every.next`)."""
        return self.every.next(step, t, dt)

    def record(self, view: Any) -> None:
        """Append a frame; a second call at the same step does nothing."""
        try:
            import h5py
        except ImportError:
            raise UnsupportedError("Frames needs h5py: pip install 'fdem[plot]'") from None
        if self._step == view.steps and self._model is view.model:
            return
        # HDF5's lock would stop the run when somebody looks at the file meanwhile
        with h5py.File(self.path, "r+" if self._count else "w", locking=False) as file:
            root = file["VTKHDF"] if self._count else _create(file)
            if view.model is not self._model:
                self._model, self._cells = view.model, cells_of(view.model)
                self._write_mesh(root)
            self._write_frame(root, view)
        self._step = view.steps
        self._count += 1

    def _write_mesh(self, root: Any) -> None:
        """Append the cells: a new part, to which the frames that follow refer."""
        cells = self._cells
        assert cells is not None
        m, k, n = len(cells.zones), len(cells.triangles), len(cells.balls)
        connectivity = np.concatenate([cells.zones.ravel(), cells.triangles.ravel(), cells.balls])
        offsets = np.concatenate([[0], np.cumsum(np.repeat([4, 3, 1], [m, k, n]))])
        root.attrs["part"] = [len(root[name]) for name in ("NumberOfCells", "Types", "Connectivity")]
        _append(root, "NumberOfPoints", [len(self._model.X)])
        _append(root, "NumberOfCells", [m + k + n])
        _append(root, "NumberOfConnectivityIds", [len(connectivity)])
        _append(root, "Connectivity", connectivity)
        _append(root, "Offsets", offsets)
        _append(root, "Types", np.repeat([_TETRA, _TRIANGLE, _VERTEX], [m, k, n]))
        radius = np.zeros(len(self._model.X))
        radius[self._model.balls] = self._model.ball_radius
        root.attrs["radius"] = len(root["PointData/radius"])
        _append(root, "PointData/radius", radius)
        _append(root, "CellData/block", cells.block)
        _append(root, "CellData/group", cells.group)
        for name, values in (("group_names", cells.groups), ("block_names", self._model.names)):
            # VTK's reader fails on anything but ASCII
            _append(root, f"FieldData/{name}", [str(value).encode("ascii", "replace") for value in values])

    def _write_frame(self, root: Any, view: Any) -> None:
        """Append what moves, and the row of every table of offsets."""
        cells = self._cells
        assert cells is not None
        part, cell, connectivity = (int(i) for i in root.attrs["part"])
        steps = root["Steps"]
        frame = self._count
        _append(steps, "Values", [view.time if self._axis == "time" else view.steps])
        steps.attrs["NSteps"] = frame + 1
        _append(steps, "NumberOfParts", [1])
        _append(steps, "PartOffsets", [part])
        _append(steps, "CellOffsets", [[cell]])
        _append(steps, "ConnectivityIdOffsets", [[connectivity]])
        # block, group and names are those of the mesh; the rest comes anew
        fields = root["FieldData"]
        sizes = {"group_names": len(cells.groups), "block_names": len(self._model.names), "step": 1}
        _append(steps, "CellDataOffsets/block", [cell])
        _append(steps, "CellDataOffsets/group", [cell])
        for name, size in sizes.items():
            start = frame if name == "step" else len(fields[name]) - size
            _append(steps, f"FieldDataOffsets/{name}", [start])
            _append(steps, f"FieldDataSizes/{name}", [[1, size]])
        _append(root, "FieldData/step", [view.steps])
        _append(steps, "CellDataOffsets/stress", [len(root["CellData/stress"])])
        _append(root, "CellData/stress", full_tensor(cell_stress(view, cells)))
        _append(steps, "PointOffsets", [len(root["Points"])])
        _append(root, "Points", view.positions())
        _append(steps, "PointDataOffsets/radius", [int(root.attrs["radius"])])
        for name, values in (("displacement", view.displacements()), ("velocity", view.velocities())):
            _append(steps, f"PointDataOffsets/{name}", [len(root[f"PointData/{name}"])])
            _append(root, f"PointData/{name}", values)


def _create(file: Any) -> Any:
    """Lay out an empty temporal unstructured grid; returns its root group."""
    import h5py

    root = file.create_group("VTKHDF")
    root.attrs["Version"] = (2, 3)
    kind = b"UnstructuredGrid"
    root.attrs.create("Type", kind, dtype=h5py.string_dtype("ascii", len(kind)))

    def table(name: str, dtype: Any, *columns: int) -> None:
        # chunks of about 64 kB: small tables stay small, large ones are read in few pieces
        rows = max(64, 8192 // max(1, int(np.prod(columns))))
        root.create_dataset(name, (0, *columns), dtype, maxshape=(None, *columns), chunks=(rows, *columns))

    text = h5py.string_dtype("ascii")
    for name in ("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds", "Connectivity", "Offsets"):
        table(name, "i8")
    table("Types", "u1")
    table("Points", "f8", 3)
    table("PointData/displacement", "f4", 3)
    table("PointData/velocity", "f4", 3)
    table("PointData/radius", "f4")
    table("CellData/block", "i4")
    table("CellData/group", "i4")
    table("CellData/stress", "f4", 9)
    table("FieldData/group_names", text)
    table("FieldData/block_names", text)
    table("FieldData/step", "i8")
    table("Steps/Values", "f8")
    for name in ("NumberOfParts", "PartOffsets", "PointOffsets"):
        table(f"Steps/{name}", "i8")
    table("Steps/CellOffsets", "i8", 1)
    table("Steps/ConnectivityIdOffsets", "i8", 1)
    for group, names in (
        ("PointData", ("displacement", "velocity", "radius")),
        ("CellData", ("block", "group", "stress")),
        ("FieldData", ("group_names", "block_names", "step")),
    ):
        for name in names:
            table(f"Steps/{group}Offsets/{name}", "i8")
    for name in ("group_names", "block_names", "step"):
        table(f"Steps/FieldDataSizes/{name}", "i8", 2)
    root["Steps"].attrs["NSteps"] = 0
    return root


def _append(group: Any, name: str, rows: Any) -> None:
    """Add rows at the end of a table."""
    table = group[name]
    n = len(table)
    table.resize(n + len(rows), axis=0)
    if len(rows):
        table[n:] = rows


class Checkpoint:
    """Save the simulation now and then, so that it can be continued bit for bit.

    Parameters
    ----------
    path : path
        File to write; ``.npz`` is added if it has no such ending.
    every : Every, int or None, optional
        When; an int counts steps.
    keep : int, optional
        How many to keep: the newest is `path`, older ones ``name.1.npz``, ``name.2.npz``, ...

    Raises
    ------
    SceneError
        If `keep` is less than 1.

    Notes
    -----
    A file is written beside its place and moved there when complete: a crash leaves the one before.
    """

    def __init__(self, path: str | Path, every: Every | int | None = None, keep: int = 1) -> None:
        path = Path(path)
        self.path = path if path.suffix == ".npz" else path.with_name(path.name + ".npz")
        self.every = as_every(every)
        if not isinstance(keep, (int, np.integer)) or keep < 1:
            raise SceneError(f"Checkpoint: keep must be a whole number >= 1, got {keep!r}")
        self.keep = int(keep)

    def next(self, step: int, t: float, dt: float) -> int:
        """Count the steps until due (see `Every.next`)."""
        return self.every.next(step, t, dt)

    def record(self, view: Any) -> None:
        """Save, and rename the older ones."""
        fresh = self.path.with_name(f"{self.path.stem}.part.npz")
        view.save(fresh)
        older = [self.path] + [self.path.with_name(f"{self.path.stem}.{i}.npz") for i in range(1, self.keep)]
        for source, target in reversed(list(itertools.pairwise(older))):
            if source.exists():
                os.replace(source, target)
        os.replace(fresh, self.path)
