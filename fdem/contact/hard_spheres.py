"""Hard contact of spheres: one point per pair of spheres, and per face, edge or vertex that a sphere touches."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.hard import Points
from fdem.contact.table import frames
from fdem.errors import UnsupportedError

if TYPE_CHECKING:
    from fdem.contact.spheres import SphereContacts

__all__ = ["sphere_points"]

Array = NDArray[np.float64]


def sphere_points(c: SphereContacts, x: Array) -> Points:
    """Points of all near pairs of spheres, and of spheres and faces, at positions `x` (n_gp, 3) [m].

    The slave is a sphere; the other one, or the block of the face, is the master.
    """
    first, second = c.pair_particles()
    p = c.particles
    between = x[p.gp[first]] - x[p.gp[second]]
    distance = np.linalg.norm(between, axis=1)
    gap = distance - p.radius[first] - p.radius[second]
    near = (gap <= c.allowed[first] + c.allowed[second]) & (c.rule >= 0) & (distance > 0.0)
    first, second, gap = first[near], second[near], gap[near]
    n = len(gap)
    normal = between[near] / distance[near, None]
    arm = -(p.radius[first] + 0.5 * gap)[:, None] * normal
    back = (p.radius[second] + 0.5 * gap)[:, None] * normal
    gp, w = np.zeros((n, 4), np.int64), np.zeros((n, 4))
    gp[:, 0], gp[:, 1] = p.gp[first], p.gp[second]
    w[:, 0], w[:, 1] = 1.0, -1.0
    radius = np.minimum(p.radius[first], p.radius[second])
    pairs = Points(
        slave=p.block[first], master=p.block[second], gp=gp, w=w, frame=_frames(normal), gap=gap,
        area=np.pi * radius**2, law=_laws(c, c.rule[near]), position=x[p.gp[first]] + arm, size=radius,
        patch=np.full(n, -1), joint=c.rule[near], spin=np.column_stack([p.spin[first], p.spin[second]]),
        arm=np.stack([arm, back], axis=1),
    )  # fmt: skip
    return pairs.and_(_face_points(c, x)) if len(c.faces.at) else pairs


def _face_points(c: SphereContacts, x: Array) -> Points:
    """Points of spheres and faces that come as near as pairs of spheres are looked for."""
    p, f = c.particles, c.faces
    place = c.place.copy()
    place[:, :3] = x[p.gp[c.order]]
    wider = c.allowed[c.order]
    place[:, 3] += wider
    f.touch(place, np.zeros_like(c.motion), x, x)
    rows = np.flatnonzero(f.active)
    candidate = f.candidate[rows]
    rows, candidate = rows[f.rule[candidate] >= 0], candidate[f.rule[candidate] >= 0]
    at = f.slot_at[rows]
    particle, group = c.order[at], np.searchsorted(f.slot_start, rows, side="right") - 1
    normal, n = -f.geometry[rows, :3], len(rows)
    gap = wider[at] - f.geometry[rows, 3]
    arm = -f.geometry[rows, 8:9] * normal
    gp, w = np.zeros((n, 4), np.int64), np.zeros((n, 4))
    gp[:, 0], w[:, 0] = p.gp[particle], 1.0
    gp[:, 1:], w[:, 1:] = f.ref[f.face[candidate]], -f.weight[rows]
    f.active[:], f.geometry[:, 3] = 0, 0.0  # these are no springs
    return Points(
        slave=p.block[particle], master=f.block[group], gp=gp, w=w, frame=_frames(normal), gap=gap,
        area=np.pi * p.radius[particle] ** 2, law=_laws(c, f.rule[candidate]), position=x[p.gp[particle]] + arm,
        size=p.radius[particle], patch=np.full(n, -1), joint=f.rule[candidate],
        spin=np.column_stack([p.spin[particle], np.full(n, -1)]), arm=np.stack([arm, np.zeros_like(arm)], axis=1),
    )  # fmt: skip


def _frames(normal: Array) -> Array:
    return frames(normal) if len(normal) else np.zeros((0, 3, 3))


def _laws(c: SphereContacts, rule: Any) -> Array:
    """Friction, cohesion, tension and restitution (n, 4) of joint rules.

    Raises
    ------
    UnsupportedError
        A law has rolling or twisting resistance.
    """
    for k in np.unique(rule):
        if c.table.laws[k].rolling > 0.0 or c.table.laws[k].twisting > 0.0:
            raise UnsupportedError(f"joint law {c.table.laws[k].name!r}: ContactDynamics has no rolling or twisting")
    rows = np.array([[law.tan, 0.0, 0.0, law.restitution] for law in c.table.laws]).reshape(-1, 4)
    return rows[rule]
