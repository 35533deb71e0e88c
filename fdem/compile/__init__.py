"""Compile: the only place that knows both the scene and the numerics.

It asks every question once: which formulations, laws, loads and constraints are there; and answers
with objects and flat arrays, so that a step asks nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fdem.compile.assembly import Layout, assemble, in_situ, lay_out
from fdem.compile.joints import JointTables
from fdem.compile.loads import compile_loads
from fdem.compile.select import Selector
from fdem.compile.supports import compile_constraints
from fdem.constraints import Constraints
from fdem.loads import Load
from fdem.model import Model
from fdem.scene.boundary import Stress
from fdem.scene.scene import Applied, Scene
from fdem.scene.shapes import Surface
from fdem.state import State

__all__ = ["Compiled", "compile_scene"]


@dataclass
class Compiled:
    """Everything a system needs, and the way back to the scene.

    Attributes
    ----------
    layout, select : Layout, Selector
        Blocks in model order and the resolver of targets.
    model, state : Model, State
        Frozen arrays, and those that change.
    contacts : Contacts or None
        The contact layer; None where no two blocks can meet.
    constraints : Constraints
        Fixed and prescribed components.
    loads : list of Load
        Forces on gridpoints.
    alpha : (n_dofs,) array or None
        Mass-proportional damping [1/s].
    """

    layout: Layout
    select: Selector
    model: Model
    state: State
    contacts: Any
    constraints: Constraints
    loads: list[Load]
    alpha: np.ndarray | None
    drags: list[tuple[Applied, np.ndarray]]


def compile_scene(scene: Scene, removed: frozenset[str], loads: list[Applied], threads: int) -> Compiled:
    """Resolve a scene into arrays, formulations, contacts, loads and constraints.

    Parameters
    ----------
    scene : Scene
        What the user wrote.
    removed : frozenset of str
        Names of excavated blocks.
    loads : list of Applied
        The scene's loads and those applied to the simulation.
    threads : int
        Threads of the zone kernels.

    Raises
    ------
    SceneError, JointError, MeshError
        If the scene is wrong; the message names block, field and value.
    """
    layout = lay_out(scene, removed, loads)
    model, state = assemble(layout, threads)
    for batch in model.batches:
        batch.place(state.q, state.x)
    state.x_old[:] = state.x
    select = Selector(layout, model)
    numeric, alpha, drags = compile_loads(select)
    constraints = compile_constraints(select)
    contacts = _contacts(layout, model, select, state)
    _describe(layout, model, contacts, numeric)
    return Compiled(layout, select, model, state, contacts, constraints, numeric, alpha, drags)


def _contacts(layout: Layout, model: Model, select: Selector, state: State) -> Any:
    """The contact layer of the model, or None where no two blocks can meet."""
    if model.n_blocks < 2 or model.fixed.all():
        model.notes.append("contacts: left out, there are not two blocks of which one can move")
        return None
    from fdem.contact.contacts import Contacts, LawTable
    from fdem.contact.surface import BlockSurface

    number = {tag: i for i, tag in enumerate(model.tags)}
    surfaces = []
    for i, kind in enumerate(layout.kind):
        start, stop = (int(k) for k in model.gp_range[i])
        deformable = kind == "zoned"
        shape = layout.blocks[i].shape
        surfaces.append(
            BlockSurface(
                loops=[np.asarray(loop, dtype=np.int32) + np.int32(start) for loop in layout.loops[i]],
                tags=np.array([-1 if tag is None else number[tag] for tag in layout.loop_tags[i]], dtype=np.int32),
                affine=not deformable,
                gp=(start, stop),
                fixed=bool(model.fixed[i]),
                volume=0.0 if isinstance(shape, Surface) else float(model.volume[i]),
                mass=np.inf if model.fixed[i] else float(model.mass[i]),
                behind=_behind(layout.meshes[i]) + start if deformable else None,
            )
        )
    tables = JointTables(layout, select)
    model.notes.extend(tables.notes)
    contacts = Contacts(
        surfaces,
        state.x,
        gp_mass=model.gp_mass,
        laws=[
            LawTable(kernel, np.array(rows), hard=tables.hard(k))
            for k, (kernel, rows) in enumerate(zip(tables.kernels, tables.rows, strict=True))
        ],
        assign=tables.assign,
        gap_tolerance=layout.scene.gap_tolerance,
        names=model.names,
    )
    if any(isinstance(applied.load, Stress) for applied in layout.loads):
        owner = np.repeat(contacts.slave[contacts.patches.pair], 3)
        stress = in_situ(layout, contacts.points(state.x) + model.origin, owner)
        assert stress is not None
        contacts.preload(state.x, stress)
    return contacts


def _behind(mesh: Any) -> np.ndarray:
    """For every boundary triangle the fourth vertex of its zone."""
    tets, opposite = np.asarray(mesh.tets), ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))
    faces = np.sort(np.vstack([tets[:, corners] for corners in opposite]), axis=1).astype(np.int64)
    n = int(tets.max()) + 1
    keys = (faces[:, 0] * n + faces[:, 1]) * n + faces[:, 2]
    order = np.argsort(keys, kind="stable")
    wanted = np.sort(np.asarray(mesh.triangles), axis=1).astype(np.int64)
    found = order[np.searchsorted(keys[order], (wanted[:, 0] * n + wanted[:, 1]) * n + wanted[:, 2])]
    return tets[found % len(tets), found // len(tets)].astype(np.int32)


def _describe(layout: Layout, model: Model, contacts: Any, loads: list[Load]) -> None:
    """Notes on what this scene does not need."""
    counts = {kind: len(layout.of_kind(kind)) for kind in ("zoned", "rigid", "static")}
    model.notes.append(f"blocks: {counts['zoned']} zoned, {counts['rigid']} rigid or driven, {counts['static']} fixed")
    if not counts["zoned"]:
        model.notes.append("zones: left out, no block is deformable (gmsh and scikit-fem are not imported)")
    if not counts["rigid"]:
        model.notes.append("rigid blocks: left out")
    if counts["static"]:
        model.notes.append("fixed blocks: no unknowns; contacts between fixed blocks are never looked for")
    if not loads:
        model.notes.append("loads: left out, none is applied")
    if not np.any(model.gravity):
        model.notes.append("weight: left out, there is no gravity")
