"""Contacts of spheres as others see them: the public table, a saved state, a state taken over, notes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.facets import FaceContacts
from fdem.contact.table import frames
from fdem.errors import CheckpointError
from fdem.kernels import joints
from fdem.kernels import particles as kernels

if TYPE_CHECKING:
    from fdem.contact.spheres import SphereContacts

__all__ = ["adopt", "forces_between", "notes", "restore", "sphere_table", "state_arrays"]

Array = NDArray[np.float64]

STATE = ("order", "start", "partner", "memory", "held", "rule", "x_ref", "turn", "work")
GROUPED = ("at", "block", "start", "face", "used", "rule", "slot_start", "memory", "held")


def _touching(c: SphereContacts) -> dict[str, Any]:
    """Contacts that are closed in the last forces: particles, other block, normal, overlap, forces, rule, place."""
    p, f = c.particles, c.faces
    record = c.recorded()
    rows = np.flatnonzero(c.trial_roots() > 0.0)
    first, second = c.pair_particles(rows)
    overlap = c.overlaps()[rows]
    place = c.place[c.at]
    between = place[second, :3] - place[first, :3]
    normal = between / np.linalg.norm(between, axis=1)[:, None]
    arm = p.radius[first] - 0.5 * overlap
    slots = np.flatnonzero(f.active) if len(f.at) else np.zeros(0, np.int64)
    particle = c.order[f.slot_at[slots]] if len(slots) else np.zeros(0, np.int64)
    group = np.searchsorted(f.slot_start, slots, side="right") - 1
    geometry = f.geometry[slots] if len(slots) else np.zeros((0, 9))
    face_rule = f.rule[f.candidate[slots]] if len(slots) else np.zeros(0, np.int32)
    kind = np.concatenate([c.kind[rows], f.slot_kind[slots] if len(slots) else np.zeros(0, np.uint32)])
    return {
        "a": np.concatenate([p.block[first], p.block[particle]]),
        "b": np.concatenate([p.block[second], f.block[group]]).astype(np.int32),
        "radius": np.append(np.minimum(p.radius[first], p.radius[second]), p.radius[particle]),
        "normal": np.concatenate([normal, geometry[:, :3]]),
        "overlap": np.append(overlap, geometry[:, 3]),
        "force": np.concatenate([record[rows], f.record[slots] if len(slots) else np.zeros((0, 4))]),
        "rule": np.append(c.rule[rows], face_rule).astype(np.int32),
        "position": np.concatenate(
            [place[first, :3] + arm[:, None] * normal, place[particle, :3] + geometry[:, 8:9] * geometry[:, :3]]
        ),
        "friction": c.table.rows[kind, 4],
    }


def sphere_table(c: SphereContacts) -> dict[str, Any]:
    """Closed contacts of the last `forces`, with the columns of `table.contact_table`.

    Pressure and shear are forces over the reference area ``pi r^2`` of the smaller sphere.
    """
    t = _touching(c)
    sign = np.where(t["a"] < t["b"], 1.0, -1.0)[:, None]
    normal = t["normal"] * sign
    frame = frames(normal) if len(normal) else np.zeros((0, 3, 3))
    area = np.pi * t["radius"] ** 2
    pressing, shear = t["force"][:, 0], t["force"][:, 1:]
    size = np.linalg.norm(shear, axis=1)
    # 1e-9: the cap is met to round-off
    slipping = (size >= (1.0 - 1e-9) * t["friction"] * pressing) & (size > 0.0)
    on_b = (pressing[:, None] * t["normal"] + shear) * sign
    return {
        "block_a": np.minimum(t["a"], t["b"]),
        "block_b": np.maximum(t["a"], t["b"]),
        "joint": t["rule"],
        "normal": normal,
        "gap": -t["overlap"],
        "area": area,
        "traction": np.column_stack([pressing, np.einsum("ijk,ik->ij", frame, shear * sign)[:, 1:]]) / area[:, None],
        "force": on_b,
        "slip": np.zeros(len(area)),
        "state": np.where(slipping, joints.SLIPPING, joints.CLOSED).astype(np.int8),
        "failure": np.zeros(len(area), dtype=np.int8),
        "position": t["position"],
        "patch": np.full(len(area), -1, dtype=np.int32),
        "frame": frame,
    }


def forces_between(c: SphereContacts, chosen: Any, f_gp: Array) -> None:
    """Add to `f_gp` the last forces of contacts with exactly one block in `chosen` (n_blocks,) bool."""
    p, f = c.particles, c.faces
    record = c.recorded()
    first, second = c.pair_particles()
    rows = np.flatnonzero((c.trial_roots() > 0.0) & (chosen[p.block[first]] != chosen[p.block[second]]))
    first, second = first[rows], second[rows]
    place = c.place[c.at]
    between = place[second, :3] - place[first, :3]
    normal = between / np.linalg.norm(between, axis=1)[:, None]
    on_second = record[rows, :1] * normal + record[rows, 1:]
    np.add.at(f_gp, p.gp[second], on_second)
    np.add.at(f_gp, p.gp[first], -on_second)
    if not len(f.at):
        return
    group = np.repeat(np.arange(len(f.at)), np.diff(f.slot_start))
    particle = c.order[f.slot_at]
    mixed = (f.active > 0) & (chosen[p.block[particle]] != chosen[f.block[group]])
    np.add.at(f_gp, p.gp[particle[mixed]], -f.push[mixed])
    for k in range(3):
        np.add.at(f_gp, f.ref[f.face[f.candidate[mixed]], k], f.weight[mixed, k : k + 1] * f.push[mixed])


def state_arrays(c: SphereContacts) -> dict[str, Array]:
    """Everything that influences the next step, as copies."""
    out = {name: getattr(c, name).copy() for name in STATE}
    out |= {f"face_{name}": getattr(c.faces, name).copy() for name in GROUPED}
    if c.facets is not None:
        out["face_ref"] = c.face_ref.copy()
    out["numbers"] = np.array([c.stiffest, c._known, float(c.n_detections)])
    return out


def restore(c: SphereContacts, arrays: dict[str, Any], x: Array) -> None:
    """Take back what `state_arrays` returned.

    Raises
    ------
    CheckpointError
        The arrays do not fit this model.
    """
    try:
        if arrays["order"].shape != c.order.shape:
            raise CheckpointError("contacts of spheres: the saved state belongs to another model")
        for name in STATE:
            setattr(c, name, np.array(arrays[name]))
        c.faces = FaceContacts(*(np.array(arrays[f"face_{name}"]) for name in GROUPED))
        if c.facets is not None:
            c.face_ref = np.array(arrays["face_ref"])
        c.stiffest, c._known = (float(k) for k in arrays["numbers"][:2])
        c.n_detections = int(arrays["numbers"][2])
    except KeyError as missing:
        raise CheckpointError(f"contacts of spheres: the saved state lacks {missing}") from None
    c._prepare(x)


def adopt(new: SphereContacts, old: SphereContacts, rows: Any, x: Array) -> None:
    """Give `new` the history of `old` for all blocks that are still there.

    Parameters
    ----------
    new, old : SphereContacts
        Target and source.
    rows : (n, 2) int array
        Old and new number of every surviving block.
    x : (n_gp, 3) array
        Positions in the new model [m].
    """
    block = np.full(old.n_blocks, -1, dtype=np.int64)
    block[rows[:, 0]] = rows[:, 1]
    # particles of a block keep their order
    first_old = {int(b): i for i, b in reversed(list(enumerate(old.particles.block)))}
    first_new = {int(b): i for i, b in reversed(list(enumerate(new.particles.block)))}
    number = np.full(len(old.particles), -1, dtype=np.int64)
    for i, b in enumerate(old.particles.block):
        if block[b] in first_new:
            number[i] = first_new[int(block[b])] + i - first_old[int(b)]
    there = np.full(len(new.particles), -1, np.int64)
    there[number[number >= 0]] = np.flatnonzero(number >= 0)
    new.detect(x)
    at_old = np.where(there[new.order] >= 0, old.at[there[new.order]], -1)
    source = np.zeros(len(new.partner), np.int64)
    lists = (old.start, old.partner), (at_old, new.start, new.partner)
    kernels.carry_pairs(*lists[0], old.memory, *lists[1], new.memory, source)
    if len(old.held) and len(new.held):
        kernels.carry_pairs(*lists[0], old.held, *lists[1], new.held, source)
    new.faces.inherit(old.faces, at_old, new.n_blocks, block)
    new.turn[number[number >= 0]] = old.turn[number >= 0]
    new.work[:] = old.work
    new.stiffest, new._known = old.stiffest, old._known


def notes(c: SphereContacts) -> list[str]:
    """What the contact of spheres found and does, one fact a line."""
    touching = int((c.trial_roots() > 0.0).sum()) + (int(c.faces.active.sum()) if len(c.faces.at) else 0)
    lines = [
        f"spheres: {len(c.particles)} in contact detection, {len(c.partner)} near pairs, {len(c.faces.at)} near blocks "
        f"with faces, {touching} contacts closed",
        "tangential contact of spheres: simplified Mindlin, a spring 8 G* a (or ks) and a slider",
    ]
    if any(law.hertz for law in c.table.laws):
        lines.append("Hertz contacts: elastic constants of the joint, else of the materials; a block without is rigid")
    if not any(law.damping > 0.0 for law in c.table.laws):
        lines.append("damping of sphere contacts: left out, no joint asks for it")
    if not any(law.rolling > 0.0 or law.twisting > 0.0 for law in c.table.laws):
        lines.append("rolling and twisting resistance: left out, no joint asks for it")
    return lines
