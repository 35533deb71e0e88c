"""Surfaces the contact layer sees: flat arrays of convex planar faces over gridpoints.

Every face has three *reference gridpoints* (the largest triangle of its corners). A corner is kept as its two
barycentric weights in that triangle, so that faces follow any affine motion exactly and clipping is planar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.depth import few_convex
from fdem.contact.polygons import convex_faces, largest_triangle, true_corners, weights
from fdem.errors import MeshError
from fdem.kernels import geometry as kernels
from fdem.kernels import trees

__all__ = ["BlockSurface", "Surfaces"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

SHARP_ZONED = 0.9  # cosine above which two zone triangles count as one smooth surface
SHARP_AFFINE = 1.0 - 1e-12
DEPTH_FRACTION = 0.25  # of the local thickness: where contact stops being a boundary phenomenon
ROOM_FRACTION = 0.5  # of the depth of the deepest point, which is half the thickness between parallel faces
FEW = 32  # faces of a block up to which a tree over them pays for nothing
LEAST_DEPTH = 0.01  # of the block size: depth admitted even behind a facet at the tip of a wedge


@dataclass
class BlockSurface:
    """Surface of one block, as compile hands it over.

    Parameters
    ----------
    loops : (k, 3) array or list of int arrays
        Global gridpoint ids of every face, counter-clockwise seen from outside; empty for spheres.
    tags : (k,) int array
        Tag of every face, -1 for none.
    affine : bool
        True: the block moves affinely, so coplanar faces may be merged (rigid, uniform strain).
        False: zone triangles, kept as they are.
    gp : tuple of int
        First gridpoint of the block and one past its last.
    fixed : bool
        The block has no unknowns (it may still be moved as a platen).
    volume : float
        Volume [m^3]; 0 or less for an open surface.
    mass : float
        Mass [kg]; infinite for fixed blocks.
    behind : (k,) int array, optional
        Per face a gridpoint off its plane (fourth vertex of the zone). None: chosen.
    whole : bool, optional
        The block has few unknowns: dashpots move all its mass, not that of gridpoints (affine blocks always do).
    still : bool, optional
        The block never moves: no step looks whether it has.
    """

    loops: Any
    tags: Any
    affine: bool
    gp: tuple[int, int]
    fixed: bool
    volume: float
    mass: float
    behind: Any = None
    whole: bool = False
    still: bool = False


@dataclass
class Surfaces:
    """All faces of all blocks as flat arrays.

    Attributes
    ----------
    face_start : (n_blocks + 1,) int32
    face_block, tag, source : (n_faces,) int32
        Block, tag and index of (one of) the loops the face came from.
    corner_start : (n_faces + 1,) int32
    corner_w : (n_corners, 2)
        Weights of the second and third reference gridpoint.
    neighbour : (n_corners,) int32
        Face across the edge that starts at this corner, -1 at a border.
    ref : (n_faces, 4) int32
        Three reference gridpoints and one behind the face.
    has_behind : (n_faces,) uint8
        0 where no gridpoint lies off the plane; its weight is then 0.
    limit : (n_faces,)
        Largest admissible depth [m]; infinite on open surfaces.
    convex, affine, open, fixed, whole : (n_blocks,) uint8
    sharp : (n_blocks,)
        Cosine of the angle below which an edge bounds a face's cell.
    size, room, most, volume, mass : (n_blocks,)
        Cube root of the volume [m], depth of the deepest point [m], largest admissible depth of contact [m], volume
        [m^3], mass [kg].
    surface_gp, surface_start : int32
        Gridpoints on the surface of every block.
    movers : int32
        Blocks that may move.
    deep : (n_blocks,)
        Largest of the limits of the faces [m].
    tree : tuple of int32 arrays or None
        Trees over the faces of every block, from `trees.plant`; None if all blocks are convex and have few faces,
        which are all looked at.
    """

    face_start: Ints
    face_block: Ints
    tag: Ints
    source: Ints
    corner_start: Ints
    corner_w: Array
    neighbour: Ints
    ref: Ints
    has_behind: NDArray[np.uint8]
    limit: Array
    convex: NDArray[np.uint8]
    affine: NDArray[np.uint8]
    open: NDArray[np.uint8]
    fixed: NDArray[np.uint8]
    whole: NDArray[np.uint8]
    sharp: Array
    size: Array
    room: Array
    most: Array
    volume: Array
    mass: Array
    surface_gp: Ints
    surface_start: Ints
    movers: Ints
    deep: Array
    tree: tuple[Ints, ...] | None

    @property
    def n_blocks(self) -> int:
        """Number of blocks."""
        return len(self.size)

    @property
    def n_faces(self) -> int:
        """Number of faces."""
        return len(self.face_block)

    @property
    def mixed(self) -> NDArray[np.uint8] | None:
        """`convex`; None if all blocks are: kernels then leave out what only others need, compiled code too."""
        return None if self.convex.all() else self.convex

    @classmethod
    def build(cls, blocks: Sequence[BlockSurface], x: Array) -> Surfaces:
        """Make the faces of all blocks.

        Parameters
        ----------
        blocks : sequence of BlockSurface
        x : (n_gp, 3) array
            Gridpoint positions [m].

        Raises
        ------
        MeshError
            A block has no face or a degenerate one.
        """
        parts = [_faces_of(b, x, index) if len(b.loops) else _NO_FACES for index, b in enumerate(blocks)]
        counts = [len(p.ref) for p in parts]
        corners = [len(p.corner_w) for p in parts]
        first_face = np.r_[0, np.cumsum(counts)]
        first_corner = np.r_[0, np.cumsum(corners)]
        surface_gp = [p.vertices if p is _NO_FACES else np.unique(p.vertices) for p in parts]

        def cat(arrays: list[Any], dtype: Any = np.int32) -> Any:
            return np.ascontiguousarray(np.concatenate(arrays), dtype=dtype)

        is_open = np.array([b.volume <= 0.0 for b in blocks], dtype=np.uint8)
        volume = np.array([b.volume for b in blocks], dtype=float)
        s = cls(
            face_start=first_face.astype(np.int32),
            face_block=np.repeat(np.arange(len(blocks)), counts).astype(np.int32),
            tag=cat([p.tag for p in parts]),
            source=cat([p.source for p in parts]),
            corner_start=cat(
                [p.corner_start[:-1] + o for p, o in zip(parts, first_corner, strict=False)] + [first_corner[-1:]]
            ),
            corner_w=cat([p.corner_w for p in parts], float),
            neighbour=cat(
                [np.where(p.neighbour < 0, -1, p.neighbour + o) for p, o in zip(parts, first_face, strict=False)]
            ),
            ref=cat([p.ref for p in parts]),
            has_behind=cat([p.has_behind for p in parts], np.uint8),
            limit=np.zeros(first_face[-1]),
            convex=np.zeros(len(blocks), np.uint8),
            affine=np.array([b.affine for b in blocks], np.uint8),
            open=is_open,
            fixed=np.array([b.fixed for b in blocks], np.uint8),
            whole=np.array([b.affine or b.whole for b in blocks], np.uint8),
            sharp=np.where([b.affine for b in blocks], SHARP_AFFINE, SHARP_ZONED).astype(float),
            size=np.where(is_open, np.inf, np.cbrt(np.where(is_open, 1.0, volume))),
            room=np.zeros(len(blocks)),
            most=np.zeros(len(blocks)),
            volume=np.where(is_open, np.inf, volume),
            mass=np.array([np.inf if b.fixed else b.mass for b in blocks], dtype=float),
            surface_gp=cat(surface_gp),
            surface_start=np.r_[0, np.cumsum([len(g) for g in surface_gp])].astype(np.int32),
            movers=np.flatnonzero([not b.still for b in blocks]).astype(np.int32),
            deep=np.zeros(len(blocks)),
            tree=None,
        )
        s._measure(x)
        return s

    def _measure(self, x: Array) -> None:
        """Convexity of blocks and depth limits of faces, in the positions `x`."""
        blocks = np.arange(self.n_blocks, dtype=np.int32)
        geo = FaceGeometry.of(self)
        geo.refresh(self, x, blocks)
        owner = np.repeat(np.arange(self.n_faces), np.diff(self.corner_start))
        self._mark_convex(geo, owner)
        if self.mixed is None and np.diff(self.face_start).max(initial=0) <= FEW:
            few_convex(self.face_start, self.corner_start, geo.corner_x, geo.normal, self.limit, self.room)
        else:
            self.tree = trees.plant(self.face_start, geo.lower, geo.upper)
            geo = FaceGeometry.of(self)
            geo.refresh(self, x, blocks)
            surfaces = self.face_start, self.corner_start, geo.corner_x, geo.normal, self.convex, self.open
            kernels.thickness(*surfaces, geo.tree, self.limit)
            kernels.deepest(*surfaces, self.room)
        flat = (self.neighbour >= 0) & (np.einsum("ij,ij->i", geo.normal[owner], geo.normal[self.neighbour]) > 0.9999)
        for _ in range(4):  # a triangle beside an acute edge shares the thickness of its plane
            np.maximum.at(self.limit, owner[flat], self.limit[self.neighbour[flat]])
        self.limit *= DEPTH_FRACTION
        # behind the faces of a tetrahedron no point is as deep as a quarter of its height
        least = LEAST_DEPTH * np.where(np.isfinite(self.size), self.size, 0.0)
        self.most[:] = np.maximum(ROOM_FRACTION * self.room, least)
        np.maximum(self.limit, least[self.face_block], out=self.limit)
        np.minimum(self.limit, self.most[self.face_block], out=self.limit)
        np.maximum.at(self.deep, self.face_block, self.limit)

    def _mark_convex(self, geo: FaceGeometry, owner: Any) -> None:
        """Affine closed blocks all of whose edges are convex (a closed connected surface is then convex).

        `owner` (n_corners,): the face of a corner.
        """
        following = np.arange(1, len(owner) + 1)
        following[self.corner_start[1:] - 1] = self.corner_start[:-1]
        ex, ey, ez = (geo.corner_x[following] - geo.corner_x).T
        nx, ny, nz = geo.normal[owner].T
        gx, gy, gz = geo.normal[self.neighbour].T
        tilt = gx * (ny * ez - nz * ey) + gy * (nz * ex - nx * ez) + gz * (nx * ey - ny * ex)
        bad = (self.neighbour < 0) | (tilt > 1e-9 * np.sqrt(ex * ex + ey * ey + ez * ez))
        self.convex[:] = (self.affine == 1) & (self.open == 0)
        self.convex[self.face_block[owner[bad]]] = 0


@dataclass
class FaceGeometry:
    """Positions, normals, walls, boxes of faces and trees in the current configuration (scratch of the clip).

    `lean` (n_faces, 3): how far the cell of a face grows beyond its box in every direction, per height above or below
    the face; 1 where edges do not bound it. It and the trees are None where none is searched.
    """

    corner_x: Array
    normal: Array
    wall: Array
    kind: NDArray[np.int8]
    lower: Array
    upper: Array
    block_lower: Array
    block_upper: Array
    lean: Array | None
    tree: tuple[Any, ...] | None

    @property
    def search(self) -> tuple[Any, ...] | None:
        """What `clipping` takes to find faces near others, with room for them; None where all are looked at."""
        if self.tree is None:
            return None
        return self.lower, self.upper, self.lean, self.tree, np.empty(len(self.lower), np.int32)

    @classmethod
    def of(cls, s: Surfaces) -> FaceGeometry:
        """Allocate for the surfaces `s`."""
        nc, nf, nb = len(s.corner_w), s.n_faces, s.n_blocks
        return cls(
            np.zeros((nc, 3)), np.zeros((nf, 3)), np.zeros((nc, 3)), np.zeros(nc, np.int8),
            np.zeros((nf, 3)), np.zeros((nf, 3)), np.zeros((nb, 3)), np.zeros((nb, 3)),
            None if s.tree is None else np.ones((nf, 3)),
            None if s.tree is None else (*s.tree, np.zeros((len(s.tree[1]), 15))),
        )  # fmt: skip

    def refresh(self, s: Surfaces, x: Array, blocks: Ints) -> None:
        """Recompute everything of the given blocks from positions `x` (n_gp, 3)."""
        kernels.face_geometry(
            blocks, s.face_start, s.corner_start, s.corner_w, s.ref, s.neighbour, s.sharp, s.open, x,
            self.corner_x, self.normal, self.wall, self.kind, self.lower, self.upper,
            self.block_lower, self.block_upper,
        )  # fmt: skip
        if self.tree is not None:
            kernels.leans(blocks, s.face_start, s.corner_start, self.wall, self.kind, self.normal, self.lean)
            trees.grow(blocks, *self.tree, self.lower, self.upper, self.normal, self.lean)


@dataclass
class _Faces:
    """Faces of one block, block-local numbering."""

    ref: Ints
    has_behind: Any
    tag: Ints
    source: Ints
    corner_start: Ints
    corner_w: Array
    neighbour: Ints
    vertices: Ints


def _no_faces() -> _Faces:
    """Of a sphere, which meets others in its own way."""
    none = np.zeros(0, np.int32)
    zero = np.zeros(1, np.int32)
    return _Faces(none.reshape(0, 4), none.astype(np.uint8), none, none, zero, np.zeros((0, 2)), none, none)


_NO_FACES = _no_faces()


def _faces_of(block: BlockSurface, x: Array, index: int) -> _Faces:
    return _affine_faces(block, x, index) if block.affine else _triangle_faces(block, index)


def _triangle_faces(block: BlockSurface, index: int) -> _Faces:
    """Zone triangles: nothing is merged; neighbours by sorted edges."""
    tri = np.asarray(block.loops, dtype=np.int32).reshape(-1, 3)
    if block.behind is None:
        raise MeshError(f"block {index}: the triangles of a zoned block need the fourth vertex of their zone")
    n = len(tri)
    return _Faces(
        ref=np.column_stack([tri, np.asarray(block.behind, np.int32)]),
        has_behind=np.ones(n, np.uint8),
        tag=np.asarray(block.tags, np.int32),
        source=np.arange(n, dtype=np.int32),
        corner_start=(3 * np.arange(n + 1)).astype(np.int32),
        corner_w=np.tile(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), (n, 1)),
        neighbour=edge_neighbours(tri.ravel(), np.roll(tri, -1, axis=1).ravel(), np.repeat(np.arange(n), 3)),
        vertices=np.unique(tri),
    )


def edge_neighbours(a: Any, b: Any, face: Any) -> Ints:
    """Face across every directed edge (a, b): the owner of edge (b, a), or -1 if there is none."""
    n = int(max(a.max(), b.max())) + 1
    forward = a.astype(np.int64) * n + b
    backward = b.astype(np.int64) * n + a
    order = np.argsort(forward, kind="stable")
    at = np.minimum(np.searchsorted(forward[order], backward), len(order) - 1)
    found = forward[order][at] == backward
    return np.where(found, face[order][at], -1).astype(np.int32)


def _affine_faces(block: BlockSurface, x: Array, index: int) -> _Faces:
    """Merged, convex, planar faces of a block that moves affinely."""
    lo, hi = block.gp
    origin = x[lo:hi].mean(axis=0)
    size = float(np.abs(x[lo:hi] - origin).max())
    local = (x[lo:hi] - origin) / size
    points = local.tolist()
    raw = [(np.asarray(loop) - lo).tolist() for loop in block.loops]
    loops, tags, source, normals = convex_faces(raw, [int(t) for t in block.tags], points)
    if not loops:
        raise MeshError(f"block {index}: every face of its surface is degenerate")
    start = np.r_[0, np.cumsum([len(loop) for loop in loops])]
    flat = np.array([i for loop in loops for i in loop])
    following = np.array([i for loop in loops for i in (*loop[1:], loop[0])])
    near = edge_neighbours(flat, following, np.repeat(np.arange(len(loops)), np.diff(start))).tolist()
    corners, corner_w, neighbour, ref = [0], [], [], []
    for i, whole in enumerate(loops):
        across = near[start[i] : start[i + 1]]
        keep = true_corners([points[j] for j in whole], across, normals)
        loop = [whole[k] for k in keep]
        p = [points[j] for j in loop]
        tri = largest_triangle(p)
        corners.append(corners[-1] + len(loop))
        corner_w += weights(p, tri)
        neighbour += [across[k] for k in keep]
        ref.append([loop[k] for k in tri])
    behind, depth = _behind(local, np.array(normals), local[[three[0] for three in ref]])
    return _Faces(
        ref=np.column_stack([ref, behind]).astype(np.int32) + np.int32(lo),
        has_behind=(depth > 1e-9).astype(np.uint8),
        tag=np.array(tags, dtype=np.int32),
        source=np.array(source, dtype=np.int32),
        corner_start=np.array(corners, dtype=np.int32),
        corner_w=np.array(corner_w),
        neighbour=np.array(neighbour, dtype=np.int32),
        vertices=np.unique(flat).astype(np.int32) + np.int32(lo),
    )


def _behind(points: Array, normals: Array, base: Array) -> tuple[Any, Array]:
    """Of every plane (normal and a point of it) the point farthest off, the first of equal ones, and its distance."""
    far, depth = np.zeros(len(normals), np.int64), np.zeros(len(normals))
    some = max(1, 10**6 // len(points))  # planes at a time: the table of distances stays small
    for at in range(0, len(normals), some):
        here = slice(at, at + some)
        heights = np.einsum("fk,fk->f", base[here], normals[here])
        away = np.abs(points @ normals[here].T - heights)
        depth[here] = away.max(axis=0)
        far[here] = np.argmax(away >= depth[here] * (1.0 - 1e-9), axis=0)
    return far, depth
