"""Narrow phase: pairs of blocks -> contact patches, and what patches keep when they are cut anew."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.surface import FaceGeometry, Surfaces
from fdem.kernels import clipping, footprints, upkeep
from fdem.kernels import geometry as faces
from fdem.kernels import patches as kernels

__all__ = ["Ghosts", "Patches", "cut_pairs"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

ALIGNED = 0.99  # -n_a.n_f above which two faces lie against each other
STRIP = 0.02  # -n_a.n_f below which a patch is a side strip: force only
TRAVEL = 1e-3  # of the square root of the pair's largest patch: motion after which walls are cut anew
EDGE_TRAVEL = 0.02  # of its width: closure after which a patch along an edge is cut anew
TOUCH = 1e-5  # of the slave's size: distance below which two patches touch
LATENT_TRAVEL = 1e-4  # of it: least motion into the face before side strips that were left out are looked at again


@dataclass
class Patches:
    """Contact patches as flat arrays, sorted by law, pair, master face, slave face.

    Every array has one row per patch, except `corners` (ragged, by `start`) and, with one row per contact point (three
    per patch), `memory_old` and `w_clip`.
    """

    pair: Ints
    face_s: Ints
    face_m: Ints
    start: Ints
    corners: Array
    margin: Array
    gp: Ints
    ref_points: Array
    ref_ratio: Array
    offset: Array
    flags: NDArray[np.uint8]
    limit: Array
    law: Ints
    prop: Ints
    joint: Ints
    points_old: Array
    active_old: NDArray[np.uint8]
    area_old: Array
    memory_old: Array
    failure: NDArray[np.uint8]
    w_clip: Array
    reach: Array
    normal_reach: Array
    cluster: Ints
    metric: Array

    def __len__(self) -> int:
        return len(self.pair)

    def clusters(self) -> Ints:
        """Numbers (n,) of the sets of patches that hang together; `cluster` counts within a pair."""
        if not self.cluster.any():
            return self.pair
        key = self.pair.astype(np.int64) * (int(self.cluster.max()) + 1) + self.cluster
        return np.unique(key, return_inverse=True)[1].astype(np.int32)

    def take(self, ids: Any) -> Patches:
        """The patches `ids` (int array), in that order."""
        ids = np.asarray(ids, dtype=np.int64)
        counts = np.diff(self.start)[ids]
        start = np.r_[0, np.cumsum(counts)].astype(np.int32)
        corner_ids = np.repeat(self.start[ids] - start[:-1], counts) + np.arange(start[-1])
        out = {}
        for f in fields(self):
            a = getattr(self, f.name)
            if f.name == "start":
                out[f.name] = start
            elif f.name == "corners":
                out[f.name] = a.take(corner_ids, axis=0)
            elif f.name in ("memory_old", "w_clip"):
                out[f.name] = a.reshape(len(self), 3 * a.shape[1]).take(ids, axis=0).reshape(-1, a.shape[1])
            else:
                out[f.name] = a.take(ids, axis=0)
        return Patches(**out)

    def part(self, lo: int, hi: int) -> Patches:
        """The patches lo..hi, in the same memory."""
        out = {f.name: getattr(self, f.name)[lo:hi] for f in fields(self)}
        out |= {name: getattr(self, name)[3 * lo : 3 * hi] for name in ("memory_old", "w_clip")}
        return Patches(**out | {"start": self.start[lo : hi + 1], "corners": self.corners})

    @staticmethod
    def join(a: Patches, b: Patches) -> Patches:
        """Both, one after the other."""
        out = {f.name: np.concatenate([getattr(a, f.name), getattr(b, f.name)]) for f in fields(a) if f.name != "start"}
        return Patches(start=np.concatenate([a.start, b.start[1:] + a.start[-1]]).astype(np.int32), **out)

    @staticmethod
    def none(memory: int) -> Patches:
        """No patch; `memory` columns of history."""
        i, z = np.zeros(0, np.int32), np.zeros(0)
        return Patches(
            pair=i, face_s=i, face_m=i, start=np.zeros(1, np.int32), corners=np.zeros((0, 2)), margin=z,
            gp=np.zeros((0, 7), np.int32), ref_points=np.zeros((0, 3, 2)), ref_ratio=z, offset=np.zeros((0, 3)),
            flags=np.zeros(0, np.uint8), limit=z, law=i, prop=i, joint=i, points_old=np.zeros((0, 3, 2)),
            active_old=np.zeros(0, np.uint8), area_old=z, memory_old=np.zeros((0, memory)),
            failure=np.zeros((0, 3), np.uint8), w_clip=np.zeros((0, 7)), reach=z, normal_reach=z, cluster=i,
            metric=np.zeros((0, 3)),
        )  # fmt: skip


@dataclass
class Ghosts:
    """Near misses of pairs without a patch: they only tell when the pair must be looked at again."""

    pair: Ints = field(default_factory=lambda: np.zeros(0, np.int32))
    gp: Ints = field(default_factory=lambda: np.zeros((0, 7), np.int32))
    w: Array = field(default_factory=lambda: np.zeros((0, 7)))
    reach: Array = field(default_factory=lambda: np.zeros(0))

    def without(self, mask: Any) -> Ghosts:
        """The ghosts of pairs for which `mask` (n_pairs,) is False."""
        keep = ~np.asarray(mask, bool)[self.pair]
        return Ghosts(self.pair[keep], self.gp[keep], self.w[np.repeat(keep, 3)], self.reach[keep])

    @staticmethod
    def join(a: Ghosts, b: Ghosts) -> Ghosts:
        """Both."""
        return Ghosts(*(np.concatenate([getattr(a, f.name), getattr(b, f.name)]) for f in fields(a)))


@dataclass
class Cut:
    """What `cut_pairs` returns besides the patches."""

    patches: Patches
    ghosts: Ghosts
    too_deep: Ints
    area: Array
    closed: Array
    align: Array
    depth: Array
    plane_depth: Array
    centre: Array


def metric_of(gp: Ints, x: Array) -> Array:
    """Squares and product (n, 3) of two edges of the slaves' reference triangles: g11, g12, g22 [m2]."""
    e1, e2 = x[gp[:, 1]] - x[gp[:, 0]], x[gp[:, 2]] - x[gp[:, 0]]
    return np.column_stack([np.einsum("ij,ij->i", *p) for p in ((e1, e1), (e1, e2), (e2, e2))])


def cut_pairs(
    surfaces: Surfaces, geometry: FaceGeometry, which: Ints, slave: Ints, master: Ints, window: Array, least: Array,
    x: Array, offsets: Any, prune: float, memory: int,
) -> Cut:  # fmt: skip
    """Cut the pairs `which` (indices into slave, master, window, least) in the positions `x`.

    Parameters
    ----------
    least : (n_all_pairs,) array
        Overlap [m3] that matters beside the other contacts of the two blocks.
    offsets : callable
        ``offsets(pair, face_s, face_m) -> (n, 3)`` reference gaps known for patches.
    prune : float
        Patches smaller than this part of the pair's largest are dropped; 0 keeps all.
    memory : int
        Columns of history.
    """
    s = surfaces
    blocks = np.unique(np.concatenate([slave[which], master[which]])).astype(np.int32)
    geometry.refresh(s, x, blocks)
    size = np.minimum(s.size[slave], s.size[master])[which]
    most = np.minimum(s.most[slave], s.most[master])[which]
    g = geometry
    near = faces.face_pairs(
        slave[which], master[which], window[which], size, s.face_start, s.corner_start, s.limit, s.deep, s.convex,
        g.corner_x, g.normal, g.lower, g.upper, g.block_lower, g.block_upper, g.lean, g.tree,
    )  # fmt: skip
    key, corners, margin, miss, miss_face, too_deep = clipping.clip_faces(
        *near, master[which], window[which], size, most, int(np.diff(s.corner_start).max()), s.face_start,
        s.corner_start, s.corner_w, s.ref, s.limit, s.mixed, s.affine, s.open, x,
        g.corner_x, g.normal, g.wall, g.kind, g.search,
    )  # fmt: skip
    local, face_s, face_m = np.ascontiguousarray(key[:, :3].T)
    corners, margin = corners.copy(), margin.copy()  # not with all the room they were made in
    start = np.r_[0, key[:, 3]].astype(np.int32)
    n = len(local)
    bare = np.flatnonzero(np.bincount(local, minlength=len(which)) == 0)
    too_deep[bare] |= _swallowed(s, g, slave[which[bare]], master[which[bare]])
    pair = which[local].astype(np.int32)
    gp = np.column_stack([s.ref[face_s, :3], s.ref[face_m]]).astype(np.int32)
    p = Patches.none(memory)
    p = Patches(
        pair=pair, face_s=face_s, face_m=face_m, start=start, corners=corners, margin=margin, gp=gp,
        ref_points=np.zeros((n, 3, 2)), ref_ratio=np.zeros(n), offset=offsets(pair, face_s, face_m),
        flags=np.zeros(n, np.uint8), limit=np.minimum(s.limit[face_m], most[local]), law=np.zeros(n, np.int32),
        prop=np.zeros(n, np.int32), joint=np.zeros(n, np.int32), points_old=np.zeros((n, 3, 2)),
        active_old=np.zeros(n, np.uint8), area_old=np.zeros(n), memory_old=np.zeros((3 * n, memory)),
        failure=np.zeros((n, 3), np.uint8),
        w_clip=np.zeros((3 * n, 7)), reach=np.zeros(n), normal_reach=np.zeros(n), cluster=np.zeros(n, np.int32),
        metric=metric_of(gp, x),
    )  # fmt: skip
    area, closed, align, depth = sizes = [np.zeros(n) for _ in range(4)]
    plane_depth, centre = np.zeros((n, 3)), np.zeros((n, 3))
    footprints.measure(gp, start, corners, p.offset, x, p.ref_points, p.ref_ratio, *sizes, plane_depth, centre)
    # side strips are weighed by what is closed: they exist only as far as the blocks overlap
    facing, keep = align > STRIP, np.zeros(n, bool)
    largest, largest_closed, nearest = np.zeros(len(which)), np.zeros(len(which)), miss.copy()
    upkeep.prune(local, facing, area, closed, margin, prune, keep, largest, largest_closed, nearest)
    travel = np.sqrt(np.maximum(largest, 0.25 * np.where(np.isfinite(size), size, 0.0) ** 2))
    p.reach[:] = (nearest + TRAVEL * travel)[local]
    p.flags[keep & (align > ALIGNED)] |= kernels.FLAT
    p.normal_reach[:] = _normal_reach(
        p, local, keep, facing, prune * largest_closed, travel, window[which], size, sizes, plane_depth
    )
    footprints.along_edges(
        keep & facing, face_m, gp, start, corners, x, area, depth, s.corner_start, g.corner_x, g.normal, g.kind,
        EDGE_TRAVEL, p.flags, p.normal_reach,
    )  # fmt: skip
    np.maximum(p.normal_reach, _slide(least[which], size)[local], out=p.normal_reach)
    p.flags[facing] |= kernels.FACING
    empty = np.ones(len(which), bool)
    empty[local[keep]] = False
    dropped = np.flatnonzero(~keep & empty[local])
    ghosts = _ghosts(s, which, empty, miss_face, nearest + TRAVEL * travel, x, p, local, dropped, area, depth)
    ids = np.flatnonzero(keep)
    p = p.take(ids) if len(ids) < n else p
    _find_clusters(s, p, align[ids] > ALIGNED, x, slave)
    kernels.weights_at(p.gp, s.has_behind[p.face_m], p.ref_points, x, p.w_clip)
    return Cut(
        p, ghosts, which[too_deep == 1], area[ids], closed[ids], align[ids], depth[ids], plane_depth[ids], centre[ids]
    )


def _swallowed(s: Surfaces, g: FaceGeometry, slave: Ints, master: Ints) -> NDArray[np.uint8]:
    """1 for pairs (n,) uint8 one block of which lies inside the other."""
    lost = np.zeros(len(slave), np.uint8)
    if len(slave):
        faces.swallowed(
            slave, master, g.block_lower, g.block_upper, s.face_start, s.corner_start, g.corner_x, s.open, lost
        )
    return lost


def _find_clusters(s: Surfaces, p: Patches, aligned: Any, x: Array, slave: Ints) -> None:
    """Number the sets of patches that hang together, in pairs of several patches that are not all `aligned` (n,)."""
    if (~(aligned[1:] & aligned[:-1]) & (p.pair[1:] == p.pair[:-1])).any():
        # where corners meet, two places agree within what merging faces moves them
        upkeep.clusters(p.pair, aligned, p.gp, p.start, p.corners, x, TOUCH * s.size[slave], p.cluster)


def _slide(volume: Any, size: Array) -> Array:
    """Motion [m] of a strip as wide as the block that overlaps TRAVEL of the `volume` [m3] more."""
    slide: Array = np.sqrt(2.0 * TRAVEL * volume / np.where(np.isfinite(size), size, 1.0))
    return slide


def _normal_reach(
    p: Patches, local: Ints, keep: Any, facing: Any, level: Array, travel: Array, window: Array, size: Array,
    sizes: list[Array], plane_depth: Array,
) -> Array:  # fmt: skip
    """How far [m] every patch may go into its master face before its pair is cut anew; `local` (n,): its pair."""
    area, closed, _, depth = sizes
    # until a strip that was left out comes to weigh
    latent, skip = np.full(len(travel), np.inf), keep | facing
    if (~skip & (area > level[local])).any():
        footprints.latent_reach(
            local, skip, p.start, p.corners, plane_depth - p.offset, area, p.ref_ratio, level, latent
        )
    latent = np.maximum(latent, LATENT_TRAVEL * travel)
    # a strip gains closed area as the pair slides into it: no more force than TRAVEL of the pair's
    volume = np.bincount(local[facing], 0.5 * (closed * np.maximum(depth, 0.0))[facing], len(travel))
    slide = _slide(volume, size)
    reach = np.where(~facing & (slide[local] > 0.0), np.minimum(latent, slide)[local], latent[local])
    # face against face: strips carry no normal force, so closure alone is no reason (CONTACT.md 3.9)
    flat = (p.flags & kernels.FLAT) > 0
    reach[flat] = 0.25 * window[local[flat]]
    return reach


def _ghosts(
    s: Surfaces, which: Ints, empty: Any, miss_face: Ints, reach: Array, x: Array, p: Patches, local: Ints,
    dropped: Any, area: Array, depth: Array,
) -> Ghosts:  # fmt: skip
    """One watcher per pair without patches: its nearest miss, or the patch that was dropped and will close first."""
    face, reach = miss_face.copy(), reach.copy()
    largest = np.zeros(len(which))
    np.maximum.at(largest, local[dropped], area[dropped])
    order = dropped[np.argsort(depth[dropped], kind="stable")]  # the deepest is written last
    face[local[order], 0], face[local[order], 1] = p.face_s[order], p.face_m[order]
    reach[local[order]] = np.maximum(-depth[order], 0.0) + LATENT_TRAVEL * np.sqrt(largest[local[order]])
    ids = np.flatnonzero(empty & (face[:, 0] >= 0))
    gp = np.column_stack([s.ref[face[ids, 0], :3], s.ref[face[ids, 1]]]).astype(np.int32)
    w = np.zeros((3 * len(ids), 7))
    middle = np.full((len(ids), 3, 2), 1.0 / 3.0)
    kernels.weights_at(gp, s.has_behind[face[ids, 1]], middle, x, w)
    return Ghosts(which[ids].astype(np.int32), gp, w, reach[ids])
