"""Hard contact: points at the corners of patches, their velocities as rows, impulses carried from step to step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.table import frames
from fdem.errors import UnsupportedError
from fdem.kernels import joints, nonsmooth
from fdem.kernels import patches as kernels

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts

__all__ = ["Points", "contact_points", "solve", "table"]

Array = NDArray[np.float64]

MERGE = 1e-3  # of the smaller block's size: points of a pair closer than that are one
NEAR = 0.05  # of that size: how far a point may move and take its impulse along
UNALIGNED = 0.99  # -n_a.n_f below which patches of a pair share one normal (CONTACT.md 3.6)


@dataclass
class Points:
    """Points of hard contact, sorted by pair.

    Attributes
    ----------
    patch, pair : (n,) int arrays
        Patch and pair of each point.
    gp, w : (n, 7) arrays
        Gridpoints and weights, + slave, - master at the same place.
    frame : (n, 3, 3) array
        Rows: normal from master to slave, two tangents.
    gap : (n,) array
        [m].
    area : (n,) array
        Share of the patch [m2].
    friction, cohesion, tension, restitution : (n,) arrays
        [-], [Pa], [Pa], [-].
    position : (n, 3) array
        [m].
    """

    patch: Any
    pair: Any
    gp: Any
    w: Array
    frame: Array
    gap: Array
    area: Array
    friction: Array
    cohesion: Array
    tension: Array
    restitution: Array
    position: Array

    def __len__(self) -> int:
        return len(self.pair)

    def matched(self, old: Points, size: Array) -> Any:
        """Nearest old point of the same pair (n,) within `NEAR` of the pairs' `size`; -1: none."""
        if len(old) == len(self) and np.array_equal(old.pair, self.pair):
            if (np.abs(old.position - self.position).max(axis=1) <= NEAR * size[self.pair]).all():
                return np.arange(len(self))
        if not len(old) or not len(self):
            return np.full(len(self), -1)
        from scipy.spatial import cKDTree

        # pairs are kept apart by a fourth coordinate
        apart = 4.0 * max(float(np.ptp(self.position, axis=0).max()), float(size.max()))
        tree = cKDTree(np.column_stack([old.position, apart * old.pair]))
        distance, at = tree.query(np.column_stack([self.position, apart * self.pair]))
        return np.where(distance <= NEAR * size[self.pair], at, -1)


def contact_points(c: Contacts, x: Array) -> Points:
    """Points of all patches whose faces look at each other, at positions `x` (n_gp, 3) [m].

    Raises
    ------
    UnsupportedError
        A joint law has no hard counterpart.
    """
    p, s = c.patches, c.surfaces
    facing = (p.flags & kernels.FACING) > 0
    most = len(p.corners)
    patch, weight, gap = np.zeros(most, np.int64), np.zeros((most, 2)), np.zeros(most)
    n = nonsmooth.corner_points(p.gp, p.start, p.corners, p.offset, facing, x, patch, weight, gap)
    patch, weight, gap = patch[:n], weight[:n], gap[:n]
    w0 = np.column_stack([1.0 - weight.sum(axis=1), weight])
    position = np.einsum("ij,ijk->ik", w0, x[p.gp[patch, :3]])
    size = np.minimum(s.size[c.slave], s.size[c.master])[p.pair]
    cell = np.rint((position - x.mean(axis=0)) / (MERGE * size[patch])[:, None]).astype(np.int64)
    order = np.lexsort((gap, cell[:, 2], cell[:, 1], cell[:, 0], p.pair[patch]))
    same = (p.pair[patch[order]][1:] == p.pair[patch[order]][:-1]) & (cell[order][1:] == cell[order][:-1]).all(axis=1)
    first = order[np.concatenate([[True], ~same])] if n else order
    patch, weight, gap, position = patch[first], weight[first], gap[first], position[first]
    normal, area = _normals(c, x)
    count = np.bincount(patch, minlength=len(p))
    points = np.repeat(weight[:, None], 3, axis=1)
    w = np.zeros((3 * len(patch), 7))
    kernels.weights_at(p.gp[patch], c._thick[patch], points, x, w)
    laws = [_hard(c, k) for k in range(len(c.laws))]
    values = np.zeros((len(patch), 4))
    for k, table in enumerate(laws):
        mine = p.law[patch] == k
        values[mine] = table[p.prop[patch[mine]]]
    intact = p.memory_old[3 * patch, 3] > 0.0
    return Points(
        patch=patch, pair=p.pair[patch], gp=p.gp[patch], w=w[::3].copy(), frame=frames(normal[patch]), gap=gap,
        area=area[patch] / np.maximum(count[patch], 1), friction=values[:, 0],
        cohesion=np.where(intact, values[:, 1], 0.0), tension=np.where(intact, values[:, 2], 0.0),
        restitution=values[:, 3], position=position,
    )  # fmt: skip


def table(c: Contacts, points: Points, force: Array, slip: Array) -> dict[str, Any]:
    """Contact table of hard points, as `table.contact_table` gives it for patches.

    Parameters
    ----------
    force : (n, 3) array
        Normal force and two tangential ones on the slave [N].
    slip : (n,) array
        Sliding speed [m/s], to tell what slips.
    """
    slave, master = c.slave[points.pair], c.master[points.pair]
    sign = np.where(slave > master, 1.0, -1.0)
    area = np.maximum(points.area, 1e-300)
    on_slave = np.einsum("nij,ni->nj", points.frame, force)
    strength = points.friction * force[:, 0]
    sliding = (np.hypot(force[:, 1], force[:, 2]) >= strength * (1.0 - 1e-3)) & (slip > 0.0)
    state = np.where(force[:, 0] <= 0.0, joints.OPEN, np.where(sliding, joints.SLIPPING, joints.CLOSED))
    return {
        "block_a": np.minimum(slave, master),
        "block_b": np.maximum(slave, master),
        "joint": c.patches.joint[points.patch],
        "normal": points.frame[:, 0] * sign[:, None],
        "gap": points.gap,
        "area": points.area,
        "traction": np.column_stack([force[:, 0], sign * force[:, 1], sign * force[:, 2]]) / area[:, None],
        "force": on_slave * sign[:, None],
        "slip": np.zeros(len(points)),
        "state": state.astype(np.int8),
        "position": points.position,
        "patch": points.patch.astype(np.int32),
        "frame": points.frame * sign[:, None, None],
    }


def solve(
    J: Any,
    B: Any,
    W: Array,
    bias: Array,
    points: Points,
    h: float,
    v: Array,
    impulses: Array,
    tolerance: float,
    most: int,
) -> tuple[int, float]:
    """Impulses of all points by Gauss-Seidel (kernels/nonsmooth.py), in place; sweeps and last relative change."""
    share = points.area * h
    sweeps, error = nonsmooth.gauss_seidel(
        *J, *B, W, bias, points.friction, points.tension * share, points.cohesion * share, v, impulses, tolerance, most
    )
    return int(sweeps), float(error)


def _hard(c: Contacts, k: int) -> Array:
    law = c.laws[k]
    if law.hard is None:
        raise UnsupportedError(f"joint law {law.name!r} has no hard counterpart: ContactDynamics cannot use it")
    return law.hard


def _normals(c: Contacts, x: Array) -> tuple[Array, Array]:
    """Contact normal of every patch (from master to slave), and its whole area."""
    p = c.patches
    cross = [np.cross(x[p.gp[:, o + 1]] - x[p.gp[:, o]], x[p.gp[:, o + 2]] - x[p.gp[:, o]]) for o in (0, 3)]
    double = np.linalg.norm(cross[0], axis=1)
    slave, master = (v / np.linalg.norm(v, axis=1)[:, None] for v in cross)
    align = -np.einsum("ij,ij->i", slave, master)
    area = 0.5 * double * p.ref_ratio
    normal = master.copy()
    loose = np.flatnonzero((align <= UNALIGNED) & ((p.flags & kernels.FACING) > 0))
    if len(loose):
        total = np.zeros((len(c.pairs), 3))
        np.add.at(total, p.pair[loose], -slave[loose] * area[loose, None])
        length = np.linalg.norm(total, axis=1)[p.pair[loose]]
        good = length > 0.0
        normal[loose[good]] = total[p.pair[loose[good]]] / length[good, None]
    return normal, area
