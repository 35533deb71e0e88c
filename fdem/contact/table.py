"""Views of the contacts: the public table, rows for stiffness, starting tractions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact import response
from fdem.contact.corners import felt_areas
from fdem.contact.laws import COMMON
from fdem.kernels import joints, upkeep
from fdem.kernels import patches as kernels

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts
    from fdem.contact.narrow import Patches

__all__ = ["contact_table", "frames", "potential_k_gp", "preload", "stiffness", "whole_points"]

Array = NDArray[np.float64]

FEW = 300  # patches up to which NumPy spares the first start kernels to compile


def frames(normal: Array) -> Array:
    """Right-handed frames (n, 3, 3) with rows normal, s, t; s is horizontal-most by a fixed rule."""
    axis = np.argmin(np.abs(normal), axis=1)
    e = np.zeros_like(normal)
    e[np.arange(len(normal)), axis] = 1.0
    s = np.cross(normal, e)
    s /= np.linalg.norm(s, axis=1)[:, None]
    return np.ascontiguousarray(np.stack([normal, s, np.cross(normal, s)], axis=1))


def _unit(v: Array) -> Array:
    out: Array = v / np.linalg.norm(v, axis=1)[:, None]
    return out


def _face_normals(gp: Any, x: Array, side: int) -> Array:
    a, b, c = (x[gp[:, 3 * side + k]] for k in range(3))
    return np.cross(b - a, c - a)


def _areas(c: Contacts, x: Array) -> Array:
    """Areas (n,) of whole patches [m2]."""
    if len(c.patches) > FEW:
        out: Array = np.zeros(len(c.patches))
        upkeep.whole_areas(c.patches.gp, c.patches.ref_ratio, x, out)
        return out
    double = np.sqrt((_face_normals(c.patches.gp, x, 0) ** 2).sum(axis=1))
    few: Array = 0.5 * c.patches.ref_ratio * double
    return few


def whole_points(p: Patches, x: Array) -> Array:
    """Places of the three points of every whole patch (3 n_patches, 3) [m]."""
    w = p.ref_points.reshape(-1, 2)
    w = np.column_stack([1.0 - w.sum(axis=1), w])
    out: Array = np.einsum("ij,ijk->ik", w, x[np.repeat(p.gp[:, :3], 3, axis=0)])
    return out


def stiffness(c: Contacts, x: Array) -> tuple[Any, Array, Array, Array, Array]:
    """Rows of all patches as if closed, with the tangent stiffness of the present closure.

    Returns
    -------
    gp : (3 n, 7) int32
    w : (3 n, 7)
    frame : (3 n, 3, 3)
        Rows: normal of the master face and two tangents.
    kn, ks : (3 n,)
        Stiffness times area [N/m].
    """
    p = c.patches
    w = np.zeros((3 * len(p), 7))
    kernels.weights_at(p.gp, c._thick, p.ref_points, x, w)
    area = felt_areas(c, _areas(c, x)) / 3.0
    normal = _unit(_face_normals(p.gp, x, 1))
    frame = np.repeat(frames(normal), 3, axis=0)
    parts = [(p.gp, w, frame, response.stiffness_now(c, x) * area, c._ks * area)]
    for ids, points, kn, ks in response.couples(c, x):
        more = np.zeros((3 * len(ids), 7))
        kernels.weights_at(p.gp[ids], c._thick[ids], points, x, more)
        rows = (3 * ids[:, None] + np.arange(3)).ravel()
        parts.append((p.gp[ids], more, frame[rows], kn * area[ids], ks * area[ids]))
    gp, w, frame, kn, ks = (np.concatenate(column) for column in zip(*parts, strict=True))
    return np.repeat(gp, 3, axis=0), w, frame, np.repeat(kn, 3), np.repeat(ks, 3)


def potential_k_gp(c: Contacts, x: Array, mobile: Any) -> Array:
    """Upper bound (n_gp,) of the contact stiffness at gridpoints [N/m], whole patches, for mobile gridpoints."""
    p = c.patches
    out = np.zeros(len(x))
    if not len(p):
        return out
    w = np.zeros((3 * len(p), 7))
    kernels.weights_at(p.gp, c._thick, p.ref_points, x, w)
    affine = c.surfaces.affine
    soft = 1 - np.column_stack([affine[c.slave[p.pair]], affine[c.master[p.pair]]])
    kn, area = response.stiffness_now(c, x), felt_areas(c, _areas(c, x)) / 3.0
    mobile = np.asarray(mobile, dtype=bool)
    k = np.repeat(np.maximum(kn, c._ks) * area, 3)
    _spread(p.gp, w, k, mobile, soft, out)
    for ids, points, kn, ks in response.couples(c, x):
        more = np.zeros((3 * len(ids), 7))
        kernels.weights_at(p.gp[ids], c._thick[ids], points, x, more)
        k = np.repeat(np.maximum(kn, ks) * area[ids], 3)
        _spread(p.gp[ids], more, k, mobile, soft[ids], out)
    return out


def _spread(gp: Any, w: Array, stiffness: Array, mobile: Any, soft: Any, out: Array) -> None:
    """Add an upper bound of the contact stiffness of gridpoints [N/m] for whole patches, rows of `stiffness` (3 n,).

    ``(sum w u)^2 <= sum |w| * sum |w| u^2``; two mobile sides double it. For affine blocks (`soft` (n, 2) == 0) the
    stiffness is only distributed over the gridpoints, their weights do not multiply it.
    """
    if len(gp) > FEW:
        upkeep.gridpoint_stiffness(gp, w, stiffness, mobile, soft.astype(np.uint8), out)
        return
    gp, soft, size = np.repeat(gp, 3, axis=0), np.repeat(soft, 3, axis=0), np.abs(w)
    total = np.column_stack([size[:, 0] + size[:, 1] + size[:, 2], size[:, 3] + size[:, 4] + size[:, 5] + size[:, 6]])
    scale = np.where(soft != 0, total, 1.0 / total)
    both = np.where(mobile[gp[:, 0]] & mobile[gp[:, 3]], 2.0, 1.0)
    share = (both * stiffness)[:, None] * np.repeat(scale, (3, 4), axis=1) * size
    moves = mobile[gp]
    np.add.at(out, gp[moves], share[moves])


def contact_table(c: Contacts, x: Array) -> dict[str, Any]:
    """Contact points of the last `forces`, as a dict of arrays.

    Returns
    -------
    dict
        block_a, block_b, joint (int32; a has the lower id), normal (n, 3) from a to b, gap [m], area [m2],
        traction (n, 3) [Pa] as pressure and two shear components in `frame`, force (n, 3) [N] on block b, slip [m]
        (distance slipped up to the last commit), state (int8: 0 intact, 1 closed, 2 slipping, 3 open), failure (int8,
        up to the last commit: 0 never bonded or intact, 1 bond failed in tension, 2 in shear), position (n, 3) [m],
        patch, frame, and the columns of history that laws name.
        Open rows stand for the whole patch; side strips are listed only while they carry force.
    """
    p = c.patches
    rows = np.flatnonzero(np.repeat(((p.flags & kernels.FACING) > 0) | (c._active > 0) | (p.active_old > 0), 3))
    patch = rows // 3
    is_open = c._area[rows] == 0.0
    point = np.where(is_open[:, None], p.ref_points.reshape(-1, 2)[rows], _last_points(c).reshape(-1, 2)[rows])
    w = np.column_stack([1.0 - point.sum(axis=1), point])
    corners = x[p.gp[patch, :3]]
    position = np.einsum("ij,ijk->ik", w, corners)
    master = _unit(_face_normals(p.gp, x, 1))[patch] if len(p) else np.zeros((0, 3))
    depth = np.einsum("ij,ij->i", master, x[p.gp[patch, 3]] - position) - np.einsum("ij,ij->i", w, p.offset[patch])
    whole = _areas(c, x)[patch] / 3.0
    slave, other = c.slave[p.pair[patch]], c.master[p.pair[patch]]
    sign = np.where(slave > other, 1.0, -1.0)
    normal = np.where(is_open[:, None], master, c._normal[rows]) * sign[:, None]
    frame = frames(normal) if len(rows) else np.zeros((0, 3, 3))
    t = np.where(is_open[:, None], 0.0, c._traction[rows])
    on_slave = t[:, 1:] - t[:, :1] * c._push[patch]
    shear = np.einsum("ijk,ik->ij", frame, on_slave * sign[:, None])
    area = np.where(is_open, whole, c._area[rows])
    return {
        "block_a": np.minimum(slave, other),
        "block_b": np.maximum(slave, other),
        "joint": p.joint[patch],
        "normal": normal,
        "gap": np.where(is_open, -depth, c._gap[rows]),
        "area": area,
        "traction": np.column_stack([t[:, 0], shear[:, 1:]]),
        "force": on_slave * (area * sign)[:, None],
        "slip": np.where(is_open, 0.0, p.memory_old[rows, 4]),
        "state": np.where(is_open, joints.OPEN, c._state[rows]).astype(np.int8),
        "failure": p.failure.reshape(-1)[rows].astype(np.int8),
        **_columns(c, rows, is_open),
        "position": position,
        "patch": patch.astype(np.int32),
        "frame": frame,
    }


def _columns(c: Contacts, rows: Any, is_open: Any) -> dict[str, Array]:
    """What laws remember beyond the common columns, by name; 0 where open and where another law acts."""
    out: dict[str, Array] = {}
    for k, law in enumerate(c.laws):
        mine = (c.patches.law[rows // 3] == k) & ~is_open
        for j, name in enumerate(law.columns):
            values = out.setdefault(name, np.zeros(len(rows)))
            values[mine] = c.patches.memory_old[rows[mine], COMMON + j]
    return out


def _last_points(c: Contacts) -> Array:
    """Places of the points of the last `forces`: trial before a commit, history after it."""
    return c._points if c._trial else c.patches.points_old


def preload(c: Contacts, x: Array, stress: Array) -> None:
    """Let all contacts carry the tractions of a stress field in the positions `x`.

    The reference gap is shifted by the closure under p, linear on every patch, and the elastic slip set to the shear
    traction over ks. Tension is dropped where the law carries none.

    Parameters
    ----------
    stress : (3 n_patches, 6) array
        Stress at `points(x)` [Pa], xx yy zz yz zx xy, tension positive.
    """
    p = c.patches
    if not len(p):
        return
    facing = (p.flags & kernels.FACING) > 0
    n_a = _unit(_face_normals(p.gp, x, 0))
    n_f = _unit(_face_normals(p.gp, x, 1))
    s = np.asarray(stress, dtype=float).reshape(len(p), 3, 6)
    full = s[:, :, [0, 5, 4, 5, 1, 3, 4, 3, 2]].reshape(len(p), 3, 3, 3)
    t = np.einsum("pqij,pj->pqi", full, n_a)
    pressure = -np.einsum("pqi,pi->pq", t, n_a)
    tensile = (p.flags & kernels.WHOLE) > 0
    pressure = np.where(tensile[:, None], pressure, np.maximum(pressure, 0.0))
    shear = t - np.einsum("pqi,pi->pq", t, n_f)[:, :, None] * n_f[:, None, :]
    shear[(pressure <= 0.0) & ~tensile[:, None]] = 0.0
    points = p.ref_points
    linear = np.concatenate([1.0 - points.sum(axis=2, keepdims=True), points], axis=2)
    closure = np.zeros(len(p) * 3)
    for k, law in enumerate(c.laws):
        mine = np.flatnonzero(p.law == k)
        rows = (3 * mine[:, None] + np.arange(3)).ravel()
        closure[rows] = law.depth(pressure[mine].ravel(), np.ascontiguousarray(p.prop[mine]))
    at_gp = np.linalg.solve(linear, closure.reshape(-1, 3, 1))[:, :, 0]
    p.offset[facing] -= at_gp[facing]
    with np.errstate(divide="ignore", invalid="ignore"):
        elastic = np.where(c._ks[:, None, None] > 0.0, -shear / c._ks[:, None, None], 0.0)
    memory = p.memory_old.reshape(len(p), 3, -1)
    memory[facing, :, :3] = elastic[facing]
    p.points_old[facing] = points[facing]
    p.active_old[facing] = 1
    p.area_old[facing] = _areas(c, x)[facing] / 3.0
