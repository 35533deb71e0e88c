"""Hard contact: points at the corners of patches, their velocities as rows, impulses carried from step to step."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.proximal import Problem, Rows, Solver
from fdem.contact.table import frames
from fdem.errors import UnsupportedError
from fdem.kernels import cones, joints, nonsmooth
from fdem.kernels import patches as kernels

if TYPE_CHECKING:
    from fdem.contact.contacts import Contacts

__all__ = ["NONE", "Points", "Problem", "Solver", "contact_points", "point_rows", "table", "wear"]

Array = NDArray[np.float64]

MERGE = 1e-3  # of the smaller block's size: points of a pair closer than that are one
NEAR = 0.05  # of that size: how far a point may move and take its impulse along
SAME_NORMAL = 1e-4  # loss of length of the mean of unit normals up to which they count as one
MOVES = 1e-4  # of the largest velocity without contact: more is motion, less is what solvers leave
AT_LIMIT = 1e-5  # of a strength: how near to it counts as reached
UNALIGNED = 0.99  # -n_a.n_f below which patches of a pair share one normal (CONTACT.md 3.6)


@dataclass
class Points:
    """Points of hard contact; those of a pair of blocks follow each other.

    Attributes
    ----------
    slave, master : (n,) int arrays
        Blocks.
    gp, w : (n, k) arrays
        Gridpoints and weights, + slave, - master at the same place.
    frame : (n, 3, 3) array
        Rows: normal from master to slave, two tangents.
    gap : (n,) array
        [m].
    area : (n,) array
        Share of the contact's area [m2].
    law : (n, 4) array
        Friction coefficient, cohesion [Pa], tension [Pa], restitution.
    position : (n, 3) array
        [m].
    size : (n,) array
        Size of the smaller block, or radius of the smaller sphere [m].
    patch, joint : (n,) int arrays
        Patch (-1: of a sphere) and joint rule.
    spin, arm : (n, 2) int array, (n, 2, 3) array
        First rotational velocity of what turns about a gridpoint at the centre of a sphere (-1: nothing), and the
        way from there to the contact [m]; slave and master.
    """

    slave: Any
    master: Any
    gp: Any
    w: Array
    frame: Array
    gap: Array
    area: Array
    law: Array
    position: Array
    size: Array
    patch: Any
    joint: Any
    spin: Any
    arm: Array

    def __len__(self) -> int:
        return len(self.gap)

    @property
    def pair(self) -> Any:
        """A number (n,) for each pair of blocks."""
        return self.slave.astype(np.int64) * 2**31 + self.master

    def take(self, keep: Any) -> Points:
        """Points of a mask."""
        return self if keep.all() else Points(*(getattr(self, f.name)[keep] for f in fields(self)))

    def and_(self, other: Points) -> Points:
        """All points of both."""
        if not len(self) or not len(other):
            return self if len(self) else other
        k = max(self.gp.shape[1], other.gp.shape[1])
        both: dict[str, Any] = {}
        for f in fields(self):
            parts = [getattr(points, f.name) for points in (self, other)]
            if f.name in ("gp", "w"):
                parts = [np.pad(part, ((0, 0), (0, k - part.shape[1]))) for part in parts]
            both[f.name] = np.concatenate(parts)
        return Points(**both)

    def matched(self, old: Points) -> Any:
        """Nearest old point of the same pair (n,) within `NEAR` of its size; -1: none."""
        n, near = len(self), NEAR * self.size
        if not len(old) or not n:
            return np.full(n, -1)
        pair, before = self.pair, old.pair
        if len(old) == n and np.array_equal(before, pair):
            if (np.abs(old.position - self.position).max(axis=1) <= near).all():
                return np.arange(n)
        from scipy.spatial import cKDTree

        # pairs are kept apart by a fourth coordinate
        _, number = np.unique(np.concatenate([pair, before]), return_inverse=True)
        apart = 4.0 * max(float(np.ptp(self.position, axis=0).max()), float(self.size.max()))
        tree = cKDTree(np.column_stack([old.position, apart * number[n:]]))
        distance, at = tree.query(np.column_stack([self.position, apart * number[:n]]))
        return np.where(distance <= near, at, -1)


NONE = Points(
    slave=np.zeros(0, np.int64), master=np.zeros(0, np.int64), gp=np.zeros((0, 1), np.int64), w=np.zeros((0, 1)),
    frame=np.zeros((0, 3, 3)), gap=np.zeros(0), area=np.zeros(0), law=np.zeros((0, 4)), position=np.zeros((0, 3)),
    size=np.zeros(0), patch=np.zeros(0, np.int64), joint=np.zeros(0, np.int64), spin=np.zeros((0, 2), np.int64),
    arm=np.zeros((0, 2, 3)),
)  # fmt: skip


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
    normal, align, area = _normals(c, x)
    cell = np.rint((position - x.mean(axis=0)) / (MERGE * size[patch])[:, None]).astype(np.int64)
    # of points at one place, that of the best aligned faces knows the normal
    askew = np.rint((1.0 - align[patch]) / MERGE)
    order = np.lexsort((gap, askew, cell[:, 2], cell[:, 1], cell[:, 0], p.pair[patch]))
    same = (p.pair[patch[order]][1:] == p.pair[patch[order]][:-1]) & (cell[order][1:] == cell[order][:-1]).all(axis=1)
    first = order[np.concatenate([[True], ~same])] if n else order
    patch, weight, gap, position = patch[first], weight[first], gap[first], position[first]
    count = np.bincount(patch, minlength=len(p))
    points = np.repeat(weight[:, None], 3, axis=1)
    w = np.zeros((3 * len(patch), 7))
    kernels.weights_at(p.gp[patch], c._thick[patch], points, x, w)
    values = np.zeros((len(patch), 6))
    for k in range(len(c.laws)):
        mine = p.law[patch] == k
        if mine.any():
            values[mine] = _hard(c, k)[p.prop[patch[mine]]]
    lost = p.memory_old[3 * patch, 3] <= 0.0
    values[lost, :2], values[lost, 2] = values[lost, 4:], 0.0
    pair = p.pair[patch]
    return Points(
        slave=c.slave[pair], master=c.master[pair], gp=p.gp[patch], w=w[::3].copy(), frame=frames(normal[patch]),
        gap=gap, area=area[patch] / np.maximum(count[patch], 1), law=values[:, :4].copy(), position=position,
        size=size[patch], patch=patch, joint=p.joint[patch], spin=np.full((len(patch), 2), -1),
        arm=np.zeros((len(patch), 2, 3)),
    )  # fmt: skip


def wear(c: Contacts, points: Points, force: Array, u: Array, speed: float) -> None:
    """Bonds of patches whose strength is reached anywhere are lost.

    Parameters
    ----------
    force : (n, 3) array
        On the slave, in the frames of the points [N].
    u : (n, 3) array
        Relative velocities [m/s].
    speed : float
        Largest relative velocity without contact [m/s]: what is much slower did not move.
    """
    cohesion, tension = (points.law[:, k] * points.area for k in (1, 2))
    limit = points.law[:, 0] * force[:, 0] + cohesion
    sheared = (np.hypot(force[:, 1], force[:, 2]) >= (1.0 - AT_LIMIT) * limit) & (
        np.hypot(u[:, 1], u[:, 2]) > MOVES * speed
    )
    torn = (force[:, 0] <= -(1.0 - AT_LIMIT) * tension) & (u[:, 0] > MOVES * speed)
    gone = points.patch[(points.patch >= 0) & (cohesion + tension > 0.0) & (sheared | torn)]
    c.patches.memory_old[3 * gone[:, None] + np.arange(3), 3] = 0.0


def table(points: Points, force: Array, slip: Array) -> dict[str, Any]:
    """Contact table of hard points, as `table.contact_table` gives it for patches.

    Parameters
    ----------
    force : (n, 3) array
        Normal force and two tangential ones on the slave [N].
    slip : (n,) array
        Sliding speed [m/s], to tell what slips.
    """
    sign = np.where(points.slave > points.master, 1.0, -1.0)
    area = np.maximum(points.area, 1e-300)
    on_slave = np.einsum("nij,ni->nj", points.frame, force)
    strength = points.law[:, 0] * force[:, 0] + points.law[:, 1] * points.area
    sliding = (np.hypot(force[:, 1], force[:, 2]) >= strength * (1.0 - 1e-3)) & (slip > 0.0)
    state = np.where(force[:, 0] <= 0.0, joints.OPEN, np.where(sliding, joints.SLIPPING, joints.CLOSED))
    return {
        "block_a": np.minimum(points.slave, points.master),
        "block_b": np.maximum(points.slave, points.master),
        "joint": points.joint,
        "normal": points.frame[:, 0] * sign[:, None],
        "gap": points.gap,
        "area": points.area,
        "traction": np.column_stack([force[:, 0], sign * force[:, 1], sign * force[:, 2]]) / area[:, None],
        "force": on_slave * sign[:, None],
        "slip": np.zeros(len(points)),
        "state": state.astype(np.int8),
        "failure": np.zeros(len(points), dtype=np.int8),
        "position": points.position,
        "patch": points.patch.astype(np.int32),
        "frame": points.frame * sign[:, None, None],
    }


def point_rows(points: Points, placement: Any) -> Rows:
    """Rows of relative velocities over the unknowns.

    Parameters
    ----------
    placement : scipy CSR matrix
        ``P`` (3 n_gp, n_dofs) of ``xdot = P v``.
    """
    n, most = len(points), 24 * len(points)
    start = np.zeros(n + 1, np.int64)
    while True:
        dof, J = np.zeros(most, np.int64), np.zeros((most, 3))
        found = cones.point_rows(
            points.gp, points.w, points.frame, points.spin, points.arm, placement.indptr, placement.indices,
            placement.data, most, start, dof, J,
        )  # fmt: skip
        if found <= most:
            return Rows(start, dof[:found], J[:found])
        most = found


def _hard(c: Contacts, k: int) -> Array:
    law = c.laws[k]
    if law.hard is None:
        raise UnsupportedError(f"joint law {law.name!r} has no hard counterpart: ContactDynamics cannot use it")
    return law.hard


def _normals(c: Contacts, x: Array) -> tuple[Array, Array, Array]:
    """Contact normal of every patch (from master to slave), how well its faces are aligned, and its whole area.

    Aligned faces: that of the master. An edge or vertex of the slave in a face of the master: that of the master; a
    face of the slave on an edge or vertex of the master: that of the slave; two edges: the mean over the patches.
    """
    p = c.patches
    cross = [np.cross(x[p.gp[:, o + 1]] - x[p.gp[:, o]], x[p.gp[:, o + 2]] - x[p.gp[:, o]]) for o in (0, 3)]
    double = np.linalg.norm(cross[0], axis=1)
    slave, master = (v / np.linalg.norm(v, axis=1)[:, None] for v in cross)
    align = -np.einsum("ij,ij->i", slave, master)
    area = 0.5 * double * p.ref_ratio
    normal, facing = master.copy(), (p.flags & kernels.FACING) > 0
    loose = facing & (align <= UNALIGNED)
    if loose.any():
        pair = p.pair.astype(np.int64)
        bent_master = _bent(pair * 2**32 + p.face_s, master, facing)[loose]
        bent_slave = _bent(pair * 2**32 + p.face_m, slave, facing)[loose]
        total = np.zeros((len(c.pairs), 3))
        np.add.at(total, p.pair[loose], -slave[loose] * area[loose, None])
        mean = total[p.pair[loose]]
        mean /= np.maximum(np.linalg.norm(mean, axis=1), 1e-300)[:, None]
        both = (bent_master & bent_slave)[:, None]
        normal[loose] = np.where(both, mean, np.where(bent_master[:, None], -slave[loose], master[loose]))
    return normal, align, area


def _bent(key: Any, normal: Array, among: Any) -> Any:
    """Whether patches (n,) share their key with others, `among` those of a mask, whose normal is another."""
    _, group = np.unique(key, return_inverse=True)
    count = np.maximum(np.bincount(group, among), 1.0)
    mean = np.column_stack([np.bincount(group, normal[:, k] * among) for k in range(3)]) / count[:, None]
    return (np.linalg.norm(mean, axis=1) < 1.0 - SAME_NORMAL)[group]
