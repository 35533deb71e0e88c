"""Handles of what a scene holds: blocks, gridpoints, loads, supports, joint rules and their names."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from fdem.errors import SceneError
from fdem.scene.joints import Joint
from fdem.scene.shapes import Polyhedron, Shape, Surface, TetMesh

if TYPE_CHECKING:
    from fdem.scene.scene import Scene

__all__ = [
    "Applied",
    "Block",
    "Fix",
    "Gridpoint",
    "JointRule",
    "Names",
    "Where",
    "as_shape",
    "check_where",
    "choose",
    "surface_of",
    "tags_of",
]

Where = Callable[[np.ndarray], np.ndarray]


class Block:
    """A block of the scene; after a cut the handle means all its pieces.

    Attributes
    ----------
    name : str
        Unique name.
    group, shape, body, material, fixed
        As given to `Scene.add`; assignable until a simulation is made.
    """

    def __init__(self, scene: Scene, name: str, **given: Any) -> None:
        self._scene = scene
        self.name = name
        self.pieces: list[Block] = []
        self._given: dict[str, Any] = given

    def __repr__(self) -> str:
        return f"<Block {self.name!r}>"

    def leaves(self) -> Iterator[Block]:
        """Yield the uncut pieces this handle means (itself if it was never cut)."""
        if not self.pieces:
            yield self
        for piece in self.pieces:
            yield from piece.leaves()

    def tree(self) -> Iterator[Block]:
        """Yield this handle and everything cut from it."""
        yield self
        for piece in self.pieces:
            yield from piece.tree()

    def set(self, **values: Any) -> None:
        """Assign fields on this block and all its pieces, with the checks of `Scene.add`."""
        blocks = list(dict.fromkeys([self, *self.leaves()]))
        before = [block._given for block in blocks]
        for block in blocks:
            block._given = {**block._given, **values}
        try:
            for leaf in self.leaves():
                self._scene.check(leaf)
        except SceneError:
            for block, given in zip(blocks, before, strict=True):
                block._given = given
            raise

    @property
    def velocity(self) -> np.ndarray:
        """Velocity at the start (3,) [m/s]."""
        return np.asarray(self._given["velocity"])

    @property
    def angular_velocity(self) -> np.ndarray:
        """Angular velocity at the start (3,) [rad/s]."""
        return np.asarray(self._given["angular_velocity"])

    group = property(lambda self: self._given["group"], lambda self, value: self._scene.regroup(self, value))
    shape = property(lambda self: self._given["shape"], lambda self, value: self.set(shape=as_shape(value)))
    body = property(lambda self: self._given["body"], lambda self, value: self.set(body=value))
    material = property(lambda self: self._given["material"], lambda self, value: self.set(material=value))
    fixed = property(lambda self: self._given["fixed"], lambda self, value: self.set(fixed=bool(value)))


def as_shape(value: Any) -> Shape:
    """Shape from what the user handed over (fdem shape, pyvista surface, skfem or meshio mesh)."""
    if isinstance(value, Shape):
        return value
    from fdem.scene.reading import as_shape as convert

    return convert(value)


def surface_of(shape: Any) -> Polyhedron | Surface:
    """Faces of a shape: its own, or the boundary of its zones."""
    return shape.surface if isinstance(shape, TetMesh) else shape


def tags_of(shape: Any) -> set[str]:
    """Tags the faces of a shape carry."""
    return {tag for tag in surface_of(shape).face_tags if tag is not None}


@dataclass(frozen=True)
class Gridpoint:
    """Handle of the gridpoint nearest to a place among the selected blocks."""

    near: tuple[float, float, float]
    target: Any


@dataclass(eq=False)
class Applied:
    """Handle of a load in a scene or simulation; key of ``sim[load]``."""

    load: Any
    target: Any = None
    where: Where | None = None
    factor: Any = 1.0


@dataclass(eq=False)
class Fix:
    """Handle of fixed components; key of ``sim[fix]``, whose force is the reaction."""

    target: Any
    components: tuple[str, ...] | None
    where: Where | None = None


@dataclass(frozen=True)
class JointRule:
    """A law and the contacts it is for."""

    law: Joint
    target: Any = None
    between: tuple[Any, Any] | None = None
    where: Where | None = None
    implicit: bool = False

    @property
    def rank(self) -> int:
        """Precedence: `where` with anything, then `between`, then target, the default, what is implied."""
        if self.implicit:
            return -1
        return 3 if self.where is not None else 2 if self.between is not None else 1 if self.target is not None else 0


_SHARED: dict[frozenset[str], frozenset[str]] = {}  # one set for all names of the same kinds: there may be many


@dataclass
class Names:
    """The one namespace of blocks, groups, joint sets, cutting shapes and mesh tags."""

    kinds: dict[str, frozenset[str]] = field(default_factory=dict)

    def check(self, name: str, kind: str) -> None:
        """Refuse a clash; only a cutting shape and the group its pieces join share a name."""
        if not isinstance(name, str) or not name:
            raise SceneError(f"{kind}: name = {name!r}, allowed is a text that is not empty")
        have = self.kinds.get(name, frozenset())
        if have - {kind} and have | {kind} != {"group", "cutting shape"}:
            raise SceneError(f"name {name!r} is taken by a {min(have - {kind})}, it cannot name a {kind} as well")
        if kind == "block" and kind in have:
            raise SceneError(f"name {name!r}: a block of that name exists")

    def take(self, name: str, kind: str) -> None:
        """Give a name to a kind of thing, see `check`."""
        self.check(name, kind)
        have = self.kinds.get(name, frozenset()) | {kind}
        self.kinds[name] = _SHARED.setdefault(have, have)

    def unused(self, stem: str, first: int) -> str:
        """First of ``stem_first``, ``stem_(first + 1)``, ... that nothing is named by."""
        while f"{stem}_{first}" in self.kinds:
            first += 1
        return f"{stem}_{first}"


def check_where(what: str, where: Any) -> None:
    """Refuse a `where` that is no function.

    Raises
    ------
    SceneError
        Naming `what` asked for it.
    """
    if where is not None and not callable(where):
        raise SceneError(f"{what}: where = {where!r}, allowed is a function of places (n, 3) -> (n,) bool")


def choose(what: str, where: Where, places: np.ndarray) -> np.ndarray:
    """Mask (n,) of `places` that the user's `where` selects, its shape checked.

    Raises
    ------
    SceneError
        If it returns anything but n booleans.
    """
    mask = np.asarray(where(places))
    if mask.shape != (len(places),) or mask.dtype != np.bool_:
        raise SceneError(
            f"{what}: where returned {mask.dtype} of shape {mask.shape} for {len(places)} places, "
            f"expected bool of shape ({len(places)},)"
        )
    return mask
