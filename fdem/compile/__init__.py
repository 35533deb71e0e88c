"""Compile: the only place that knows both the scene and the numerics.

It asks every question once: which formulations, laws, loads and constraints are there; and answers
with objects and flat arrays, so that a step asks nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fdem.compile.assembly import assemble
from fdem.compile.formulations import FORMULATIONS
from fdem.compile.joints import JointTables
from fdem.compile.layout import Layout, in_situ, lay_out
from fdem.compile.loads import compile_loads
from fdem.compile.particles import compile_particles
from fdem.compile.select import Selector
from fdem.compile.supports import compile_constraints
from fdem.constraints import Constraints
from fdem.loads import Load
from fdem.model import Model
from fdem.scene.boundary import Stress
from fdem.scene.kept import Kept
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
        The contact layer of blocks with faces; None where no two of them can meet.
    particles : SphereContacts or None
        Contacts with a sphere in them.
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
    particles: Any
    constraints: Constraints
    loads: list[Load]
    alpha: np.ndarray | None
    drags: list[tuple[Applied, np.ndarray]]


def compile_scene(
    scene: Scene, removed: frozenset[str], loads: list[Applied], threads: int, before: Kept | None = None
) -> Compiled:
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
    before : Kept, optional
        Origin and zones that stay, because a state is to go on.

    Raises
    ------
    SceneError, JointError, MeshError
        If the scene is wrong; the message names block, field and value.
    """
    layout = lay_out(scene, removed, loads, before)
    model, state = assemble(layout, threads)
    select = Selector(layout, model)
    numeric, alpha, drags = compile_loads(select)
    constraints = compile_constraints(select)
    contacts, particles = _contacts(layout, model, select, state)
    _describe(layout, model, contacts, numeric)
    return Compiled(layout, select, model, state, contacts, particles, constraints, numeric, alpha, drags)


def _contacts(layout: Layout, model: Model, select: Selector, state: State) -> tuple[Any, Any]:
    """Contacts of blocks with faces, and of spheres; None each where there is nothing to meet."""
    if model.n_blocks < 2 or model.fixed.all():
        model.notes.append("contacts: left out, there are not two blocks of which one can move")
        return None, None
    tables = JointTables(layout, select)
    model.notes.extend(tables.notes)
    faced = np.array([len(loops) > 0 for loops in layout.loops])
    blocks = _surfaces(layout, model) if faced.any() else []
    contacts = None
    if faced.sum() >= 2 and not model.fixed[faced].all():
        contacts = _face_contacts(layout, model, state, blocks, tables)
    if faced.all():
        return contacts, None
    from fdem.contact.surface import Surfaces

    model.notes.append("spheres: no orientation is kept, their inertia is a number")
    if contacts is not None:
        return contacts, compile_particles(layout, model, state, contacts.surfaces, tables)
    model.notes.append("contacts of faces with faces: left out, no two blocks with faces can meet")
    surfaces = Surfaces.build(blocks, state.x) if faced.any() else None
    return None, compile_particles(layout, model, state, surfaces, tables)


def _surfaces(layout: Layout, model: Model) -> list[Any]:
    """Surfaces of all blocks, empty for those without faces."""
    from fdem.contact.surface import BlockSurface

    none = BlockSurface([], np.zeros(0, dtype=np.int32), True, (0, 0), True, 0.0, np.inf)
    number = {tag: i for i, tag in enumerate(model.tags)}
    surfaces = []
    for i, kind in enumerate(layout.kind):
        if not len(layout.loops[i]):
            surfaces.append(none)
            continue
        start, stop = (int(k) for k in model.gp_range[i])
        mesh = layout.meshes[i]
        shape = layout.blocks[i].shape
        surfaces.append(
            BlockSurface(
                loops=[np.asarray(loop, dtype=np.int32) + np.int32(start) for loop in layout.loops[i]],
                tags=np.array([-1 if tag is None else number[tag] for tag in layout.loop_tags[i]], dtype=np.int32),
                affine=mesh is None,
                gp=(start, stop),
                fixed=bool(model.fixed[i]),
                volume=0.0 if isinstance(shape, Surface) else float(model.volume[i]),
                mass=np.inf if model.fixed[i] else float(model.mass[i]),
                whole=kind != "zoned",
                still=kind == "static",
                behind=None if mesh is None else (_behind if kind == "zoned" else _opposite)(mesh) + start,
            )
        )
    return surfaces


def _face_contacts(layout: Layout, model: Model, state: State, surfaces: list[Any], tables: JointTables) -> Any:
    """The contact layer of blocks with faces."""
    from fdem.contact.contacts import Contacts
    from fdem.contact.table import whole_points

    contacts = Contacts(
        surfaces,
        state.x,
        gp_mass=model.gp_mass,
        laws=tables.tables(),
        numerical=tables.numerical,
        assign=tables.assign,
        gap_tolerance=layout.scene.gap_tolerance,
        names=model.names,
    )
    if any(isinstance(applied.load, Stress) for applied in layout.loads):
        owner = np.repeat(contacts.slave[contacts.patches.pair], 3)
        stress = in_situ(layout, whole_points(contacts.patches, state.x) + model.origin, owner)
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


def _opposite(mesh: Any) -> np.ndarray:
    """For every facet of a block without zones the gridpoint farthest behind it."""
    corners = mesh.points[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    depth = np.einsum("ti,ti->t", normal, corners[:, 0])[:, None] - normal @ mesh.points.T
    return np.argmax(depth, axis=1).astype(np.int32)


def _describe(layout: Layout, model: Model, contacts: Any, loads: list[Load]) -> None:
    """Notes on what this scene does not need."""
    counts = {row.label: len(layout.of_kind(row.kind)) for row in reversed(FORMULATIONS)}
    counts["fixed"] = len(layout.of_kind("static"))
    model.notes.append("blocks: " + ", ".join(f"{n} {label}" for label, n in counts.items() if n))
    if not layout.of_kind("zoned"):
        model.notes.append("zones: left out, no block has any (gmsh and scikit-fem are not imported)")
    if not any(batch.has_internal for batch in model.batches):
        model.notes.append("strain and internal forces: left out, no block that moves deforms")
    absent = [row.label for row in FORMULATIONS if row.kind not in layout.kind]
    if absent:
        model.notes.append(f"blocks that are {' or '.join(absent)}: left out")
    if counts["fixed"]:
        model.notes.append("fixed blocks: no unknowns; contacts between fixed blocks are never looked for")
    if not loads:
        model.notes.append("loads: left out, none is applied")
    if not np.any(model.gravity):
        model.notes.append("weight: left out, there is no gravity")
