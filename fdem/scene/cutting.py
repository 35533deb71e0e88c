"""Cutting shapes into blocks: joint sets, discs and closed shapes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from fdem.errors import MeshError, SceneError
from fdem.scene.checks import number, vector
from fdem.scene.clipping import heights
from fdem.scene.polygons import Array
from fdem.scene.pool import CavityError, Face, Plane, Point, Pool, as_polyhedron, faces_of
from fdem.scene.shapes import Polyhedron, Shape
from fdem.scene.solids import cells, convex_parts, divide_safely, inside_outside, solids

__all__ = ["Disc", "JointSet", "cut", "split"]


# planes of one set through one block beyond which the set is taken for a mistake
MANY = 100_000


@dataclass(frozen=True)
class JointSet:
    """Parallel planes that cut blocks.

    Parameters
    ----------
    dip : float
        Angle of the planes below the horizontal [deg], 0 to 90.
    dip_direction : float
        Direction of the steepest descent, clockwise from north (y) [deg]; 90 is east (x).
    spacing : float, optional
        Distance of neighbouring planes [m]; None is the one plane through `origin`.
    origin : (3,) sequence, optional
        A point on one of the planes [m].
    persistence : float, optional
        The chance that a block in a plane's way is cut, 0 to 1.
    deviation : float, optional
        Standard deviation of the orientation of each plane [deg]: the normal is tilted by two
        independent normal deviates. Each plane turns about its point on the line through `origin` across
        the set, so `origin` should lie near the blocks.
    seed : int, optional
        Of persistence and deviation; the deviation of a plane depends on the seed and its number alone.
    name : str, optional
        What the new faces remember.

    Raises
    ------
    SceneError
        If a value is out of range; the message names the field.
    """

    dip: float
    dip_direction: float
    spacing: float | None = None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    persistence: float = 1.0
    deviation: float = 0.0
    seed: int = 0
    name: str | None = None

    def __post_init__(self) -> None:
        owner = _owner("JointSet", self.name)
        number(owner, "dip", self.dip, low=0.0, high=90.0)
        number(owner, "dip_direction", self.dip_direction, low=-360.0, high=360.0)
        if self.spacing is not None:
            number(owner, "spacing", self.spacing, low=0.0, open_low=True)
        number(owner, "persistence", self.persistence, low=0.0, high=1.0)
        number(owner, "deviation", self.deviation, low=0.0, high=45.0)
        if isinstance(self.seed, bool) or not isinstance(self.seed, (int, np.integer)) or self.seed < 0:
            raise SceneError(f"{owner}: seed = {self.seed!r}, allowed is an integer >= 0")
        _check_name(owner, self.name)
        object.__setattr__(self, "origin", tuple(vector(owner, "origin", self.origin).tolist()))

    @property
    def normal(self) -> Array:
        """Upward unit normal of the planes, (3,)."""
        return np.array(_normal(self.dip, self.dip_direction))


@dataclass(frozen=True)
class Disc:
    """A plane fracture of finite size: blocks whose section with its plane touches it are cut fully.

    Parameters
    ----------
    centre : (3,) sequence
        [m].
    dip, dip_direction : float
        As in `JointSet` [deg].
    radius : float
        [m].
    name : str, optional
        What the new faces remember.

    Raises
    ------
    SceneError
        If a value is out of range; the message names the field.
    """

    centre: tuple[float, float, float]
    dip: float
    dip_direction: float
    radius: float
    name: str | None = None

    def __post_init__(self) -> None:
        owner = _owner("Disc", self.name)
        object.__setattr__(self, "centre", tuple(vector(owner, "centre", self.centre).tolist()))
        number(owner, "dip", self.dip, low=0.0, high=90.0)
        number(owner, "dip_direction", self.dip_direction, low=-360.0, high=360.0)
        number(owner, "radius", self.radius, low=0.0, open_low=True)
        _check_name(owner, self.name)

    @property
    def normal(self) -> Array:
        """Upward unit normal, (3,)."""
        return np.array(_normal(self.dip, self.dip_direction))


Cutter = JointSet | Disc | Shape


def cut(shapes: Any, cutter: Any) -> list[Shape]:
    """Cut shapes into pieces.

    Parameters
    ----------
    shapes : shape or list of shapes
        Closed polyhedra, convex or not.
    cutter : JointSet, Disc or closed shape
        Planes, a fracture, or a solid that divides what is inside it from what is outside.

    Returns
    -------
    list of Shape
        Pieces in the order of `shapes`; shapes that are not cut come back as they are.

    Raises
    ------
    SceneError
        If a shape cannot be cut (it brings its own zones, is analytic or open).
    """
    from fdem.scene.reading import as_shape

    several = shapes if isinstance(shapes, (list, tuple)) else [shapes]
    rng = np.random.default_rng(cutter.seed) if isinstance(cutter, JointSet) else None
    return [piece for shape in several for piece, _ in split(as_shape(shape), cutter, rng=rng)]


def split(
    shape: Shape, cutter: Any, name: str | None = None, rng: np.random.Generator | None = None
) -> list[tuple[Shape, bool]]:
    """Pieces of one shape.

    Parameters
    ----------
    shape : Shape
        A polyhedron.
    cutter : JointSet, Disc or closed shape
        What cuts.
    name : str, optional
        Tag of the new faces; the cutter's name if None.
    rng : numpy.random.Generator, optional
        For the persistence of a joint set, to be shared by all blocks of one cut; None starts from the
        set's seed.

    Returns
    -------
    list of (Shape, bool)
        Every piece and whether it lies inside a closed cutter; the very same object if nothing was cut.

    Raises
    ------
    SceneError
        If the shape or the cutter is of a kind that cannot be used.
    MeshError
        If the cut would leave a cavity.
    """
    if not isinstance(shape, Polyhedron):
        raise SceneError(
            f"{type(shape).__name__} cannot be cut, only polyhedra can (a mesh that brings its own zones, an "
            "analytic shape or an open surface has to be cut before)"
        )
    if isinstance(cutter, (JointSet, Disc)):
        tag = name if name is not None else cutter.name
        if isinstance(cutter, JointSet):
            pool, pieces = _split_by_planes(shape, cutter, tag, rng or np.random.default_rng(cutter.seed))
        else:
            pool, pieces = _split_by_disc(shape, cutter, tag)
        if len(pieces) < 2:
            return [(shape, False)]
        return [(as_polyhedron(pool, piece, shape.name), False) for piece in pieces]
    from fdem.scene.reading import as_shape

    solid = as_shape(cutter)
    solid = getattr(solid, "surface", solid)
    if not isinstance(solid, Polyhedron):
        raise SceneError(f"cutter = {cutter!r}, allowed are a JointSet, a Disc and a closed polyhedron")
    return _split_by_solid(shape, solid, name if name is not None else solid.name)


def _owner(kind: str, name: Any) -> str:
    return f"{kind} {name!r}" if isinstance(name, str) else kind


def _check_name(owner: str, name: Any) -> None:
    if name is not None and (not isinstance(name, str) or not name):
        raise SceneError(f"{owner}: name = {name!r}, allowed is a non-empty string or None")


def _trig(degrees: float) -> tuple[float, float]:
    """Sine and cosine, exact at multiples of 90 degrees."""
    turns = {0.0: (0.0, 1.0), 90.0: (1.0, 0.0), 180.0: (0.0, -1.0), 270.0: (-1.0, 0.0)}
    angle = float(degrees) % 360.0
    return turns.get(angle) or (float(np.sin(np.radians(angle))), float(np.cos(np.radians(angle))))


def _normal(dip: float, dip_direction: float) -> Point:
    """Upward unit normal of a plane that dips by `dip` towards `dip_direction` [deg]."""
    (sd, cd), (sa, ca) = _trig(dip), _trig(dip_direction)
    return sd * sa, sd * ca, cd


@lru_cache(maxsize=65536)
def _plane(joints: JointSet, k: int) -> Plane:
    """Plane number k of a joint set."""
    normal = _normal(joints.dip, joints.dip_direction)
    spacing = joints.spacing or 0.0
    if joints.deviation == 0.0:
        return Plane(joints.origin, normal, k * spacing)
    # one generator per plane: what plane k looks like does not depend on how many are asked for
    rng = np.random.default_rng([joints.seed, abs(k), int(k < 0)])
    tilt = np.tan(np.radians(joints.deviation * rng.standard_normal(2)))
    (sd, cd), (sa, ca) = _trig(joints.dip), _trig(joints.dip_direction)
    down, strike = np.array([cd * sa, cd * ca, -sd]), np.array([ca, -sa, 0.0])
    n = np.array(normal) + tilt[0] * down + tilt[1] * strike
    n = n / np.sqrt((n * n).sum())
    x, y, z = (o + k * spacing * c for o, c in zip(joints.origin, normal, strict=True))
    return Plane((x, y, z), (float(n[0]), float(n[1]), float(n[2])))


def _planes(shape: Polyhedron, joints: JointSet) -> Iterator[Plane]:
    """Planes of a set that may meet a shape, in order."""
    if joints.spacing is None:
        yield _plane(joints, 0)
        return
    relative = shape.points - np.array(joints.origin)
    across = relative @ joints.normal
    low, high = float(across.min()), float(across.max())
    if joints.deviation > 0.0:
        # planes tilted by six standard deviations at most, about their points on the normal through origin
        aside = np.sqrt(np.maximum((relative * relative).sum(axis=1) - across * across, 0.0)).max()
        reach = float(aside) * np.tan(np.radians(min(6.0 * joints.deviation, 85.0)))
        low, high = low - reach, high + reach
    first, last = int(np.floor(low / joints.spacing)), int(np.ceil(high / joints.spacing))
    if last - first > MANY:
        raise SceneError(
            f"{_owner('JointSet', joints.name)}: spacing = {joints.spacing!r} makes {last - first} planes through one "
            "block; enlarge spacing, or put origin near the blocks if deviation is used"
        )
    for k in range(first, last + 1):
        plane = _plane(joints, k)
        d = np.einsum("ij,j->i", shape.points - np.array(plane.origin), np.array(plane.normal)) - plane.offset
        if d.min() < 0.0 < d.max():
            yield plane


def _split_by_planes(
    shape: Polyhedron, joints: JointSet, tag: str | None, rng: np.random.Generator
) -> tuple[Pool, list[list[Face]]]:
    """Pieces of a shape between the planes of a joint set."""
    pool = Pool(shape)
    pieces = [faces_of(shape, pool)]
    for plane in _planes(shape, joints):
        after: list[list[Face]] = []
        for piece in pieces:
            d = heights(pool, piece, plane).values()
            crossed = min(d) < 0.0 < max(d)
            if not crossed or (joints.persistence < 1.0 and rng.random() >= joints.persistence):
                after.append(piece)
                continue
            above, below, _ = divide_safely(pool, piece, plane, tag, shape.size)
            after += solids(pool, below, tag, shape.size) + solids(pool, above, tag, shape.size)
        pieces = after
    return pool, pieces


def _split_by_disc(shape: Polyhedron, disc: Disc, tag: str | None) -> tuple[Pool, list[list[Face]]]:
    """Pieces of a shape cut by the plane of a disc, if the section touches the disc."""
    pool = Pool(shape)
    faces = faces_of(shape, pool)
    plane = Plane(disc.centre, _normal(disc.dip, disc.dip_direction))
    d = heights(pool, faces, plane).values()
    if not min(d) < 0.0 < max(d):
        return pool, [faces]
    above, below, caps = divide_safely(pool, faces, plane, tag, shape.size)
    centre = np.array(disc.centre)
    if not any(_touches(np.array([pool.points[v] for v in cap]) - centre, disc) for cap in caps):
        return pool, [faces]
    return pool, solids(pool, below, tag, shape.size) + solids(pool, above, tag, shape.size)


def _touches(loop: Array, disc: Disc) -> bool:
    """Whether a polygon in the disc's plane, relative to its centre, meets the disc."""
    ahead = np.roll(loop, -1, axis=0)
    edge = ahead - loop
    t = np.clip(-(loop * edge).sum(axis=1) / (edge * edge).sum(axis=1), 0.0, 1.0)
    nearest = loop + t[:, None] * edge
    if ((nearest * nearest).sum(axis=1) <= disc.radius**2).any():
        return True
    # the centre inside the polygon: the edges go once round it
    angles = np.arctan2(np.cross(loop, ahead) @ disc.normal, (loop * ahead).sum(axis=1))
    return bool(abs(angles.sum()) > np.pi)


def _split_by_solid(shape: Polyhedron, solid: Polyhedron, tag: str | None) -> list[tuple[Shape, bool]]:
    """Pieces of a shape inside and outside a closed solid."""
    if (shape.bounds[0] >= solid.bounds[1]).any() or (shape.bounds[1] <= solid.bounds[0]).any():
        return [(shape, False)]
    parts = convex_parts(solid)
    try:
        pool, outside, inside = inside_outside(shape, parts, tag)
    except CavityError:
        raise
    except (MeshError, ZeroDivisionError):
        # the cutter touches the block in an unlucky way: leave it divided along the planes of the cutter
        pool, outside, inside = cells(shape, parts, tag)
    if not inside:
        return [(shape, False)]
    if not outside:
        return [(shape, True)]
    pieces: list[tuple[Shape, bool]] = []
    for group, within in ((outside, False), (inside, True)):
        pieces += [(as_polyhedron(pool, piece, shape.name), within) for piece in group]
    return pieces
