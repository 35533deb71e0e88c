"""What the user writes: blocks, cuts, joints, supports and loads. Plain Python, no numerics."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from fdem.errors import SceneError
from fdem.scene.bodies import BODIES, Rigid
from fdem.scene.checks import number, vector
from fdem.scene.handles import (
    Applied,
    Block,
    Fix,
    Gridpoint,
    JointRule,
    Names,
    Where,
    as_shape,
    check_where,
    choose,
    surface_of,
    tags_of,
)
from fdem.scene.joints import Bonded, Joint
from fdem.scene.materials import Elastic
from fdem.scene.shapes import Balls, Shape, Surface

__all__ = ["Applied", "Block", "Fix", "Gridpoint", "JointRule", "Scene", "Where", "choose", "surface_of", "tags_of"]

COMPONENTS = ("x", "y", "z", "normal", "rotation")


class Scene:
    """Blocks, joints, supports and loads, as the user describes them.

    Parameters
    ----------
    gravity : (3,) array, optional
        Acceleration of gravity [m/s^2].
    gap_tolerance : float, optional
        Gaps and overlaps of nearly parallel faces below this length [m] are taken as closed joints
        at the start. None: 1e-3 of the smaller block's size; 0: off.

    Raises
    ------
    SceneError
        If a value is not finite.
    """

    def __init__(self, gravity: Sequence[float] = (0, 0, -9.81), gap_tolerance: float | None = None) -> None:
        self.gravity = vector("Scene", "gravity", gravity)
        self.gap_tolerance = None if gap_tolerance is None else number("Scene", "gap_tolerance", gap_tolerance, low=0.0)
        self.handles: list[Block] = []
        self.joints: list[JointRule] = []
        self.fixes: list[Fix] = []
        self.loads: list[Applied] = []
        self._names = Names()

    @property
    def blocks(self) -> list[Block]:
        """Every block in order; a cut block is replaced by its pieces."""
        return [leaf for handle in self.handles for leaf in handle.leaves()]

    def add(
        self,
        shape: Any,
        body: Any,
        material: Elastic | None = None,
        *,
        name: str | None = None,
        group: str | None = None,
        fixed: bool = False,
        velocity: Sequence[float] = (0, 0, 0),
        angular_velocity: Sequence[float] = (0, 0, 0),
    ) -> Any:
        """Add a block, or a list of blocks from a list of shapes.

        Parameters
        ----------
        shape : Shape or list of Shape
            Geometry [m]; closed pyvista surfaces, skfem and meshio meshes are shapes too.
        body : Rigid, UniformStrain, LinearStrain or Zoned
            How it moves.
        material : Elastic, optional
            What it is made of; not needed by fixed rigid blocks.
        name, group : str, optional
            Unique name (lists: ``name_0``, ``name_1``...) and group.
        fixed : bool, optional
            The block does not move, or moves as its velocity prescribes.
        velocity, angular_velocity : (3,) array, optional
            At the start [m/s], [rad/s].

        Returns
        -------
        Block or list of Block
            Handle of the new block(s).

        Raises
        ------
        SceneError
            If a value is wrong; the message names block, field and value.
        """
        several = isinstance(shape, (list, tuple))
        if several and not shape:
            raise SceneError("add: the list of shapes is empty")
        first = self._names.unused("block", len(self.handles)) if name is None else name
        moves = {"velocity": velocity, "angular_velocity": angular_velocity}
        # one array for all blocks of a list
        given: dict[str, Any] = {key: vector(f"block {first!r}", key, value) for key, value in moves.items()}
        given |= {"body": body, "material": material, "group": group, "fixed": bool(fixed)}
        if not several:
            return self._add(shape, name, given)
        return [self._add(s, None if name is None else f"{name}_{i}", given) for i, s in enumerate(shape)]

    def _add(self, shape: Any, name: str | None, given: dict[str, Any]) -> Block:
        label = self._names.unused("block", len(self.handles)) if name is None else name
        self._names.check(label, "block")
        group = given["group"]
        block = Block(self, label, shape=as_shape(shape), **given)
        self.check(block)
        wanted = [(label, "block"), *([] if group is None else [(group, "group")])]
        wanted += [(tag, "tag") for tag in sorted(tags_of(block.shape))]
        for text, kind in wanted:
            self._names.check(text, kind)
        for text, kind in wanted:
            self._names.take(text, kind)
        self.handles.append(block)
        return block

    def check(self, block: Block) -> None:
        """Refuse a block whose body, material and shape do not go together.

        Parameters
        ----------
        block : Block
            What to check.

        Raises
        ------
        SceneError
            Naming block, field and value.
        """
        who, body, material = f"block {block.name!r}", block.body, block.material
        if not isinstance(body, BODIES):
            raise SceneError(f"{who}: body = {body!r}, allowed are {', '.join(f'{k.__name__}()' for k in BODIES)}")
        if material is not None and not isinstance(material, Elastic):
            raise SceneError(f"{who}: material = {material!r}, allowed is an Elastic")
        if isinstance(block.shape, Balls) and (body.deforms or callable(getattr(material, "density", None))):
            raise SceneError(f"{who}: spheres and clumps are Rigid() and of one density; an icosphere need not be")
        if isinstance(block.shape, Surface) and not (block.fixed and isinstance(body, Rigid)):
            raise SceneError(f"{who}: shape is an open surface: only fixed rigid blocks can have one")
        if material is None and not block.fixed:
            raise SceneError(f"{who}: material is missing; only fixed blocks need none")
        if body.deforms and not block.fixed and (material is None or material.young is None):
            raise SceneError(f"{who}: material has no young and poisson, a deformable block needs both")

    def regroup(self, block: Block, group: str | None) -> None:
        """Move a block (with its pieces) to another group."""
        if group is not None:
            self._names.check(group, "group")
        block.set(group=group)
        if group is not None:
            self._names.take(group, "group")

    def cut(self, cutter: Any, target: Any = None, where: Where | None = None, name: str | None = None) -> list[Block]:
        """Cut blocks with a joint set, a disc or a closed shape.

        Parameters
        ----------
        cutter : JointSet, Disc or closed shape
            What cuts. Pieces inside a closed shape join group `name`.
        target : selector, optional
            Blocks to cut; None: all.
        where : callable, optional
            (n, 3) block centroids -> (n,) bool.
        name : str, optional
            Name the new faces remember; None: the cutter's.

        Returns
        -------
        list of Block
            The new pieces.

        Raises
        ------
        SceneError
            If nothing is selected or the name clashes.
        """
        from fdem.scene.cutting import Disc, JointSet, split

        if not isinstance(cutter, (JointSet, Disc)):
            cutter = as_shape(cutter)
        kind = "cutting shape" if isinstance(cutter, Shape) else "joint set"
        label = name or getattr(cutter, "name", None) or self._names.unused("cut", 0)
        self._names.check(label, kind)
        chosen = self._where("cut", self.select_blocks(target), where)
        rng = np.random.default_rng(getattr(cutter, "seed", 0))
        parts = [split(block.shape, cutter, label, rng) for block in chosen]
        self._names.take(label, kind)
        new: list[Block] = []
        for block, pieces in zip(chosen, parts, strict=True):
            if len(pieces) == 1 and not pieces[0][1]:
                continue
            for shape, inside in pieces:
                piece = Block(self, f"{block.name}/{len(block.pieces)}", **{**block._given, "shape": shape})
                if inside:
                    self._names.take(label, "group")
                    piece._given["group"] = label
                block.pieces.append(piece)
                new.append(piece)
        return new

    def joint(
        self, law: Joint, target: Any = None, between: tuple[Any, Any] | None = None, where: Where | None = None
    ) -> JointRule:
        """Give contacts a joint law; the most specific rule wins, among equals the later.

        Parameters
        ----------
        law : Joint
            The law.
        target : selector, optional
            None: every contact; a group: contacts with a block in it; a joint set: contacts between faces it made;
            a mesh tag: contacts with a face of that tag.
        between : (selector, selector), optional
            One block in each.
        where : callable, optional
            (n, 3) contact points -> (n,) bool.

        Returns
        -------
        JointRule
            The rule.

        Raises
        ------
        SceneError
            If the selection is empty or `law` is not a joint law.
        """
        if not isinstance(law, Joint):
            raise SceneError(f"joint: law = {law!r} is not a joint law")
        if between is not None and (not isinstance(between, (tuple, list)) or len(between) != 2):
            raise SceneError(f"joint: between = {between!r}, allowed is a pair of selectors")
        check_where("joint", where)
        rule = JointRule(law, target, None if between is None else (between[0], between[1]), where)
        for selector in [target] if between is None else list(between):
            if selector is not None and not (isinstance(selector, str) and self.is_joint_set(selector)):
                self.select_blocks(selector)
        self.joints.append(rule)
        return rule

    def fix(self, target: Any = None, component: Any = None, where: Where | None = None) -> Fix:
        """Fix gridpoints of zoned blocks, or whole blocks of other kinds (strain included, unless with "rotation").

        Parameters
        ----------
        target : selector, optional
            None: every block.
        component : str or tuple of str, optional
            None (all), "x", "y", "z", "normal", "rotation" or a tuple of them.
        where : callable, optional
            (n, 3) gridpoints -> (n,) bool.

        Returns
        -------
        Fix
            Handle; ``sim[fix].force`` is the reaction.

        Raises
        ------
        SceneError
            If the selection is empty or a component unknown.
        """
        components = None if component is None else (component,) if isinstance(component, str) else tuple(component)
        for entry in components or ():
            if entry not in COMPONENTS:
                raise SceneError(f"fix: component = {entry!r}, allowed are {', '.join(COMPONENTS)}")
        if not isinstance(target, Gridpoint):
            self.select(target)
        check_where("fix", where)
        fix = Fix(target, components, where)
        self.fixes.append(fix)
        return fix

    def apply(self, load: Any, target: Any = None, where: Where | None = None, factor: Any = 1.0) -> Applied:
        """Apply a load.

        Parameters
        ----------
        load : Force, Moment, Traction, Pressure, Velocity, Displacement, Drag, Support, Stress or object
            An object of the user's own has ``force(t, x, v) -> (n, 3)`` [N] on gridpoints.
        target : selector, optional
            None: every block.
        where : callable, optional
            Gridpoints, face centroids or block centroids (n, 3) -> (n,) bool.
        factor : float or callable, optional
            A number, or a function of time.

        Returns
        -------
        Applied
            Handle of the load.

        Raises
        ------
        SceneError
            If the selection is empty or the load unknown.
        """
        applied = self.applied(load, target, where, factor)
        self.loads.append(applied)
        return applied

    def applied(self, load: Any, target: Any, where: Where | None, factor: Any) -> Applied:
        """Check a load and its selection without adding it."""
        from fdem.scene import boundary

        known = tuple(getattr(boundary, name) for name in boundary.__all__)
        if not isinstance(load, known) and not callable(getattr(load, "force", None)):
            raise SceneError(f"apply: load = {load!r} is neither a load of fdem nor has it force(t, x, v)")
        if not callable(factor):
            number("apply", "factor", factor)
        check_where("apply", where)
        if not isinstance(target, Gridpoint):
            self.select(target)
        return Applied(load, target, where, factor)

    def gridpoint(self, near: Sequence[float], target: Any = None) -> Gridpoint:
        """Handle of the gridpoint nearest to `near` [m] among the blocks of `target`."""
        place = vector("gridpoint", "near", near)
        self.select_blocks(target)
        return Gridpoint((float(place[0]), float(place[1]), float(place[2])), target)

    def is_joint_set(self, name: str) -> bool:
        """Whether `name` is that of a joint set or mesh tag, so that it means faces."""
        return bool({"joint set", "cutting shape", "tag"} & self._names.kinds.get(name, set()))

    def select(self, target: Any) -> list[tuple[Block, str | None]]:
        """Blocks a selector means, each with the face tag that selects within it (None: all of it).

        Parameters
        ----------
        target : selector
            A block, a list, a name, a group or pattern, a joint set or a mesh tag; None: every block.

        Returns
        -------
        list of (Block, str or None)
            In the order of the scene.

        Raises
        ------
        SceneError
            If the selection is empty or the selector unknown.
        """
        found: list[tuple[Block, str | None]]
        if target is None:
            found = [(block, None) for block in self.blocks]
        elif isinstance(target, Block):
            if target._scene.handles is not self.handles:
                raise SceneError(f"selector {target!r}: this block belongs to another scene")
            found = [(leaf, None) for leaf in target.leaves()]
        elif isinstance(target, (list, tuple)):
            found = list(dict.fromkeys(pair for entry in target for pair in self.select(entry)))
        elif isinstance(target, str):
            found = self._named(target)
        else:
            raise SceneError(
                f"selector {target!r}: allowed are a block, a list, a name, a group, a pattern, a joint set or a tag"
            )
        if not found:
            known = ", ".join(sorted(self._names.kinds)) or "none"
            raise SceneError(f"selector {target!r} selects nothing; known names: {known}")
        return found

    def _named(self, name: str) -> list[tuple[Block, str | None]]:
        for handle in self.handles:
            for block in handle.tree():
                if block.name == name:
                    return [(leaf, None) for leaf in block.leaves()]
        kinds = self._names.kinds.get(name, frozenset())
        blocks = self.blocks
        if kinds in ({"joint set"}, {"cutting shape"}, {"tag"}):
            return [(block, name) for block in blocks if name in tags_of(block.shape)]
        return [(b, None) for b in blocks if any(fnmatchcase(own, name) for own in (b.name, b.group or b.name))]

    def select_blocks(self, target: Any) -> list[Block]:
        """Blocks a selector means, whatever selects within them."""
        return list(dict.fromkeys(block for block, _ in self.select(target)))

    def _where(self, what: str, blocks: list[Block], where: Where | None) -> list[Block]:
        check_where(what, where)
        if where is None:
            return blocks
        mask = choose(what, where, np.array([block.shape.centroid for block in blocks]))
        return [block for block, keep in zip(blocks, mask, strict=True) if keep]

    @classmethod
    def from_mesh(
        cls, mesh_or_path: Any, body: Any, material: Any, split: Any = None, gravity: Sequence[float] = (0, 0, -9.81)
    ) -> Scene:
        """Scene from a volume mesh: one block per physical volume and connected part.

        Parameters
        ----------
        mesh_or_path : path or mesh
            What meshio reads, a meshio mesh or a `skfem.MeshTet`.
        body, material
            One value, or a dict by group pattern.
        split : str or list of str, optional
            Surface tags along which the mesh becomes several blocks.
        gravity : (3,) array, optional
            Acceleration of gravity [m/s^2].

        Returns
        -------
        Scene
            The scene; groups and tags are the mesh's. Where two volumes meet without a split they are
            glued (`Bonded`), unless a joint law is given for them.

        Raises
        ------
        SceneError
            If a group has no body or material, or a splitting surface ends inside.
        """
        from fdem.scene.reading import tet_blocks

        scene = cls(gravity)
        for shape, group in tet_blocks(mesh_or_path, split):
            scene.add(shape, _by_group("body", body, group), _by_group("material", material, group), group=group)
        for tag in [split] if isinstance(split, str) else split or []:
            scene._names.take(tag, "tag")
        # volumes of one mesh hang together unless the user splits them or says otherwise
        for tag in sorted({tag for block in scene.blocks for tag in tags_of(block.shape) if "|" in tag}):
            scene.joints.append(JointRule(Bonded(), tag, implicit=True))
        return scene


def _by_group(what: str, value: Any, group: str | None) -> Any:
    if not isinstance(value, dict):
        return value
    for pattern, entry in value.items():
        if group is not None and fnmatchcase(group, pattern):
            return entry
    raise SceneError(f"from_mesh: group {group!r} has no {what}; given for {', '.join(map(str, value))}")
