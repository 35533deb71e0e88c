"""A simulation as arrays and pyvista datasets: the cells that stand for it and what lies on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.results.balls import skins_of

__all__ = ["FAILURES", "STATES", "Cells", "cell_stress", "cells_of", "contacts", "full_tensor", "group_ids", "mesh"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

STATES = ("intact", "closed", "slipping", "open")
FAILURES = ("none", "tension", "shear")

# xx yy zz yz zx xy -> xx xy xz yx yy yz zx zy zz, the order of VTK
_FULL = np.array([0, 5, 4, 5, 1, 3, 4, 3, 2])


@dataclass(frozen=True)
class Cells:
    """What a file is made of: all zones, then the surface triangles of blocks without zones, then spheres.

    Parameters
    ----------
    zones : (m, 4) int32 array
        Gridpoints of the zones.
    triangles : (k, 3) int32 array
        Gridpoints of the surface triangles of the blocks that have no zones.
    surface : (k,) int32 array
        Their rows among the surface triangles of the model.
    balls : (n,) int32 array
        Gridpoints in the centres of spheres.
    block : (m + k + n,) int32 array
        Block of each cell.
    group : (m + k + n,) int32 array
        Index of the block's group in `groups`.
    groups : list of str
        Names of the groups; blocks without one are in "".
    """

    zones: Ints
    triangles: Ints
    surface: Ints
    balls: Ints
    block: Ints
    group: Ints
    groups: list[str]


def group_ids(model: Any) -> tuple[Ints, list[str]]:
    """Group of each block as an index (n_blocks,) and the names, in order of first appearance."""
    names = ["" if group is None else str(group) for group in model.groups]
    groups = list(dict.fromkeys(names))
    index = {name: i for i, name in enumerate(groups)}
    return np.array([index[name] for name in names], dtype=np.int32), groups


def cells_of(model: Any) -> Cells:
    """Cells of a model (see `Cells`)."""
    bare = ~np.asarray(model.zoned, dtype=bool)[model.triangle_block]
    block = np.concatenate([model.zone_block, model.triangle_block[bare], model.gp_block[model.balls]])
    block = block.astype(np.int32)
    group, groups = group_ids(model)
    zones = np.asarray(model.zones, dtype=np.int32).reshape(-1, 4)
    surface = np.flatnonzero(bare).astype(np.int32)
    triangles = np.asarray(model.triangles[bare], dtype=np.int32)
    return Cells(zones, triangles, surface, model.balls, block, group[block], groups)


def full_tensor(voigt: Array) -> Array:
    """Symmetric tensors (n, 6) in the order xx yy zz yz zx xy as (n, 9), row by row.

    Not for engineering shear strain, whose off-diagonal terms are doubled.
    """
    return np.asarray(voigt)[:, _FULL]


def cell_stress(view: Any, cells: Cells) -> Array:
    """Cauchy stress of each cell [Pa], tension positive, (n_cells, 6): the zone's, or its block's in that place."""
    stress = np.full((len(cells.block), 6), np.nan)
    m = len(cells.zones)
    stress[:m] = view.zone_stresses() if m else 0.0
    stress[m : m + len(cells.surface)] = view.surface_stress(cells.surface)
    return stress


def mesh(view: Any) -> Any:
    """Everything as one unstructured grid.

    Parameters
    ----------
    view : Simulation
        What is shown.

    Returns
    -------
    pyvista.UnstructuredGrid
        Zones as tetrahedra, then blocks without zones as their surface triangles, then spheres as faceted ones, at
        the current positions. Points: ``displacement`` [m], ``velocity`` [m/s], ``gridpoint`` (number; of points
        on a sphere that of its centre, which they move with). Cells:
        ``block``, ``group`` (numbers), ``stress`` [Pa] (9 components, tension positive; not a number
        where a body has none). Field: ``block_names``, ``group_names``, ``time`` [s], ``step``.
    """
    import pyvista as pv

    model = view.model
    cells, skins = cells_of(model), skins_of(model)
    triangles = np.concatenate([cells.triangles, skins.triangles + len(model.X)])
    kinds = {}
    if len(cells.zones):
        kinds[pv.CellType.TETRA] = cells.zones
    if len(triangles):
        kinds[pv.CellType.TRIANGLE] = triangles
    if not kinds:
        return pv.UnstructuredGrid()
    gridpoint = np.concatenate([np.arange(len(model.X), dtype=np.int32), skins.gridpoint])
    points = np.array(view.positions())[gridpoint]
    points[len(model.X) :] += skins.offset
    grid = pv.UnstructuredGrid(kinds, points)
    grid.point_data["displacement"] = np.asarray(view.displacements())[gridpoint]
    grid.point_data["velocity"] = np.asarray(view.velocities())[gridpoint]
    grid.point_data["gridpoint"] = gridpoint
    # all triangles of a sphere show what is known of it
    faces = len(cells.zones) + len(cells.triangles)
    each = np.bincount(skins.gridpoint[skins.triangles[:, 0]], minlength=len(model.X))[cells.balls]
    cell = np.repeat(np.arange(len(cells.block)), np.concatenate([np.ones(faces, dtype=np.int64), each]))
    grid.cell_data["block"] = cells.block[cell]
    grid.cell_data["group"] = cells.group[cell]
    grid.cell_data["stress"] = full_tensor(cell_stress(view, cells))[cell]
    _describe(grid, view, block_names=model.names, group_names=cells.groups)
    return grid


def contacts(view: Any) -> Any:
    """All contacts as points.

    Parameters
    ----------
    view : Simulation
        What is shown.

    Returns
    -------
    pyvista.PolyData
        One vertex per contact with ``block_a``, ``block_b``, ``joint`` (numbers), ``normal`` (from a
        to b), ``gap`` [m] (> 0 open), ``area`` [m^2], ``traction`` [Pa] (normal, compression positive,
        and two tangents), ``force`` [N] on block b in global axes, ``slip`` [m], ``state`` (0 intact,
        1 closed, 2 slipping, 3 open), ``failure`` of the bond (0 none, 1 tension, 2 shear), and what laws remember by
        its name. Field: ``joint_names``, ``state_names``, ``failure_names``, ``block_names``, ``time`` [s], ``step``.
    """
    import pyvista as pv

    table = view.contact_table()
    points = np.array(table["position"], dtype=np.float64).reshape(-1, 3)
    cloud = pv.PolyData(points) if len(points) else pv.PolyData()
    for name in [key for key in table if key not in ("position", "patch", "frame", "joint_names")]:
        cloud.point_data[name] = np.array(table[name])
    names = {"joint_names": table["joint_names"], "state_names": STATES, "failure_names": FAILURES}
    _describe(cloud, view, **names, block_names=view.model.names)
    return cloud


def _describe(dataset: Any, view: Any, **names: Any) -> None:
    """Attach names and the moment as field data."""
    for key, values in names.items():
        dataset.field_data[key] = [str(value) for value in values]
    dataset.field_data["time"] = np.array([float(view.time)])
    dataset.field_data["step"] = np.array([int(view.steps)])
