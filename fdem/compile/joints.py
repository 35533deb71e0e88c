"""From joint rules to property tables, and which contact gets which."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdem.compile.layout import Layout
from fdem.compile.select import Selector
from fdem.contact.laws import NEEDS, TAKEN, LawTable, try_law
from fdem.errors import FdemWarning, JointError
from fdem.scene.checks import number
from fdem.scene.joints import Joint
from fdem.scene.scene import JointRule, choose

__all__ = ["JointTables"]


@dataclass
class _Side:
    """What a selector means for contacts: any face of the blocks, faces of joint sets, faces with mesh tags."""

    blocks: np.ndarray
    sets: list[int] = field(default_factory=list)
    tags: list[int] = field(default_factory=list)

    def holds(self, block: np.ndarray, tag: np.ndarray) -> np.ndarray:
        """Mask of faces (their block and tag) that the selector means."""
        return self.blocks[block] | np.isin(tag, self.sets + self.tags)


class JointTables:
    """Property rows of all rules and the assignment of contacts to them.

    Parameters
    ----------
    layout : Layout
        Blocks in model order.
    select : Selector
        Resolves the rules' targets.
    """

    def __init__(self, layout: Layout, select: Selector) -> None:
        self.layout, self.select, self.model = layout, select, select.model
        self.rules: list[JointRule] = list(layout.scene.joints)
        self.notes: list[str] = []
        self.kinds: list[Joint] = []  # the first law of each kind: of one class, with one kernel
        self.rows: list[list[tuple[float, ...]]] = []
        self.reach: list[list[float]] = []
        self.corner: list[list[float]] = []
        self.numerical = False  # whether some stiffness was chosen here
        self.location: list[tuple[int, int]] = []
        self.laws: list[Joint] = []
        self.stiffness: list[tuple[float, float]] = []
        self._pairs: dict[int, int] = {}
        for rule in self.rules:
            law = rule.law
            self.laws.append(law)
            if not law.for_faces:
                self.location.append((-1, -1))
                self.stiffness.append((0.0, 0.0))
                continue
            same = [i for i, kind in enumerate(self.kinds) if _alike(kind, law)]
            place = same[0] if same else len(self.kinds)
            if not same:
                self.kinds.append(law)
                self.rows.append([])
                self.reach.append([])
                self.corner.append([])
            self.location.append((place, len(self.rows[place])))
            self.stiffness.append(self._stiffness(rule))
            self.rows[place].append(_row(law, *self.stiffness[-1], self.rows[place]))
            reach = number(type(law).__name__, "reach", law.reach, low=0.0, open_low=True, infinite=True)
            self.reach[place].append(reach)
            self.corner[place].append(law.corner**2)
        order = sorted(range(len(self.rules)), key=lambda i: (self.rules[i].rank, i))
        sides = [[(r.target, True)] if r.between is None else [(s, False) for s in r.between] for r in self.rules]
        self._tests = [(i, [self._side(*side) for side in sides[i]]) for i in order]

    def tables(self) -> list[LawTable]:
        """One table per kind of law, as the contact layer takes them.

        Raises
        ------
        JointError
            If a law of the user's own does not keep to the signature or to its columns.
        """
        result: list[LawTable] = []
        for law, rows, reach, corner in zip(self.kinds, self.rows, self.reach, self.corner, strict=True):
            name, kernel = type(law).__name__, law.sweep
            if isinstance(kernel, str):
                hard = self._hard(len(result))
                result.append(LawTable(kernel, np.array(rows), corner=np.array(corner), hard=hard))
                continue
            columns, needs = _declared(name, law)
            table = LawTable(
                kernel,
                np.array(rows),
                columns=columns,
                needs=needs,
                closure=type(law).closure,
                reach=np.array(reach),
                corner=np.array(corner),
                smooth=bool(type(law).smooth),
            )
            try_law(name, table)
            result.append(table)
        return result

    def _hard(self, law: int) -> np.ndarray | None:
        """Rows (n, 6) of the hard counterpart of a law (`Joint.hard`); None if it has none."""
        rows = [rule.law.hard() for rule, (k, _) in zip(self.rules, self.location, strict=True) if k == law]
        return None if any(row is None for row in rows) else np.array(rows, dtype=float).reshape(-1, 6)

    def _side(self, target: Any, faces: bool) -> _Side:
        """What a selector means: blocks, and tags of faces; a cutting shape's name means faces only if `faces`."""
        scene, side = self.layout.scene, _Side(np.zeros(self.model.n_blocks, dtype=bool))
        if isinstance(target, (list, tuple)):
            parts = [self._side(entry, faces) for entry in target]
            side.blocks[:] = np.any([part.blocks for part in parts], axis=0)
            side.sets, side.tags = [t for p in parts for t in p.sets], [t for p in parts for t in p.tags]
            return side
        kinds: frozenset[str] | set[str] = scene._names.kinds.get(target, set()) if isinstance(target, str) else set()
        if kinds in ({"joint set"}, {"cutting shape"}, {"tag"}) or (faces and "cutting shape" in kinds):
            number = self.select.tag_number.get(target, -2)
            (side.tags if kinds == {"tag"} else side.sets).append(number)
        else:
            side.blocks[self.select.blocks(target, "joint")] = True
        return side

    def assign(
        self, block_a: np.ndarray, block_b: np.ndarray, tag_a: np.ndarray, tag_b: np.ndarray, points: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Law, property row and rule of contacts between faces.

        Parameters
        ----------
        block_a, block_b : (n,) int array
            Blocks.
        tag_a, tag_b : (n,) int array
            Tags of the two faces.
        points : (n, 3) array
            Contact points, relative to the model's origin [m].

        Raises
        ------
        JointError
            If a contact has no law; names the two blocks.
        """
        chosen, loose = self._rules_of(block_a, block_b, tag_a, tag_b, points)
        self._complete(chosen, loose, block_a, block_b)
        location = np.array(self.location, dtype=np.int32).reshape(-1, 2)
        bad = np.flatnonzero(location[chosen, 0] < 0)
        if len(bad):
            a, b = (self.model.names[i] for i in sorted((block_a[bad[0]], block_b[bad[0]])))
            law = type(self.laws[chosen[bad[0]]]).__name__
            raise JointError(
                f"blocks {a!r} and {b!r} can touch with faces, but {law} is for spheres; add a law for them"
            )
        return location[chosen, 0], location[chosen, 1], chosen

    def assign_spheres(
        self, block_a: np.ndarray, block_b: np.ndarray, tag_a: np.ndarray, tag_b: np.ndarray, points: np.ndarray
    ) -> np.ndarray:
        """Rule of contacts with a sphere in them (see `assign`)."""
        chosen, loose = self._rules_of(block_a, block_b, tag_a, tag_b, points)
        chosen[:] = np.where(chosen < 0, loose, chosen)
        if (chosen < 0).any():
            self._refuse(block_a[np.argmin(chosen)], block_b[np.argmin(chosen)])
        return chosen

    def _rules_of(
        self, block_a: np.ndarray, block_b: np.ndarray, tag_a: np.ndarray, tag_b: np.ndarray, points: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rule of each contact, and the rule of a joint set that one of its two faces was made by; -1: none."""
        chosen = np.full(len(block_a), -1, dtype=np.int32)
        loose = chosen.copy()
        for rule_id, sides in self._tests:
            rule, (first, second) = self.rules[rule_id], (sides[0], sides[-1])
            if rule.between is not None:
                mask = first.holds(block_a, tag_a) & second.holds(block_b, tag_b)
                mask |= first.holds(block_b, tag_b) & second.holds(block_a, tag_a)
            else:
                mask = first.blocks[block_a] | first.blocks[block_b]
                mask |= np.isin(tag_a, first.tags) | np.isin(tag_b, first.tags)
                mask |= np.isin(tag_a, first.sets) & (tag_a == tag_b)
                loose[np.isin(tag_a, first.sets) | np.isin(tag_b, first.sets)] = rule_id
            if rule.where is not None and mask.any():
                mask[mask] = choose("joint", rule.where, points[mask] + self.model.origin)
            chosen[mask] = rule_id
        return chosen, loose

    def _complete(self, chosen: np.ndarray, loose: np.ndarray, block_a: np.ndarray, block_b: np.ndarray) -> None:
        """Give contacts that no rule names the law of their pair.

        Beside the faces of a joint, its two blocks meet with the faces around it: those belong to the
        joint one of the two was made by, or to what else joins the pair.
        """
        chosen[:] = np.where(chosen < 0, loose, chosen)
        n = self.model.n_blocks
        pair = np.minimum(block_a, block_b).astype(np.int64) * n + np.maximum(block_a, block_b)
        known = dict(self._pairs)
        for key, rule_id in zip(pair[chosen >= 0].tolist(), chosen[chosen >= 0].tolist(), strict=True):
            known.setdefault(key, rule_id)
        if not self._pairs:
            self._pairs = known  # of compile alone, so that a restart decides alike
        for row in np.flatnonzero(chosen < 0):
            if int(pair[row]) not in known:
                self._refuse(block_a[row], block_b[row])
            chosen[row] = known[int(pair[row])]

    def _refuse(self, block_a: int, block_b: int) -> None:
        a, b = (self.model.names[i] for i in sorted((block_a, block_b)))
        raise JointError(f"blocks {a!r} and {b!r} can touch, but no joint law covers them; add scene.joint(law)")

    def _stiffness(self, rule: JointRule) -> tuple[float, float]:
        """Stiffness of a rule; what the user left out is chosen as CONTACT.md 3.12 proposes."""
        law, layout = rule.law, self.layout
        poisson = None
        kn = law.kn
        if kn is None:
            soft = []
            for i in layout.of_kind("zoned"):
                mesh, material = layout.meshes[i], layout.blocks[i].material
                corners = mesh.points[mesh.triangles]
                edge = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())
                lam, mu = material.lame
                soft.append(((lam + 2 * mu) / edge, material.poisson))
            for i in layout.of_kind("uniform") + layout.of_kind("linear"):
                lam, mu = layout.blocks[i].material.lame
                soft.append(((lam + 2 * mu) / float(np.cbrt(layout.volume[i])), layout.blocks[i].material.poisson))
            if soft:
                kn, poisson = min(soft)
            else:
                kn = self._rigid_stiffness()
            self.numerical = True
            self.notes.append(
                f"joint {type(law).__name__}: kn = {kn:.3g} Pa/m was chosen (numerical, not a rock property)"
            )
            if not rule.implicit:
                warnings.warn(
                    f"joint {type(law).__name__}: kn = None, {kn:.3g} Pa/m was chosen; it changes with mesh and scene",
                    FdemWarning,
                    stacklevel=2,
                )
        ks = law.ks
        if ks is None:
            ks = kn * (0.8 if poisson is None else (1 - poisson) / (1 - poisson / 2))
            self.notes.append(f"joint {type(law).__name__}: ks = {ks:.3g} Pa/m was chosen")
        return float(kn), float(ks)

    def _rigid_stiffness(self) -> float:
        """Closure of 1e-4 L under the full overburden, or under the impact of the speeds given."""
        model = self.model
        free = model.mass > 0
        if not free.any():
            raise JointError("joint: kn = None, but no block has a mass to choose it from; give kn")
        density = float((model.mass[free] / model.volume[free]).max())
        length = float(np.median(model.size[free]))
        gravity = float(np.linalg.norm(model.gravity))
        speed = max(float(np.linalg.norm(b.velocity)) for b in self.layout.blocks)
        if gravity > 0:
            height = float(np.ptp(model.X @ (model.gravity / gravity)))
            return max(density * gravity * height, density * speed**2) / (1e-4 * length)
        if speed > 0:
            return density * speed**2 / (1e-4 * length)
        raise JointError(
            "joint: kn = None, but without gravity or velocities there is nothing to choose it from; give kn"
        )


def _alike(first: Joint, second: Joint) -> bool:
    """Whether two laws share one table: fdem's by the name of their kernel, the user's by their class."""
    if isinstance(first.sweep, str) or isinstance(second.sweep, str):
        return bool(first.sweep == second.sweep)
    return type(first) is type(second)


def _row(law: Joint, kn: float, ks: float, others: list[tuple[float, ...]]) -> tuple[float, ...]:
    """Properties of a law, checked."""
    name, row = type(law).__name__, law.properties(kn, ks)
    try:
        values = tuple(float(value) for value in row)
    except (TypeError, ValueError):
        raise JointError(f"joint law {name}: properties gives {row!r}, allowed is a tuple of numbers") from None
    if values[:2] != (kn, ks):
        raise JointError(f"joint law {name}: properties begins with {values[:2]}, not with kn, ks = {kn:g}, {ks:g}")
    if np.isnan(values).any():
        raise JointError(f"joint law {name}: properties gives {values}, one of which is not a number")
    if others and len(values) != len(others[0]):
        raise JointError(f"joint law {name}: properties gives {len(values)} numbers here, {len(others[0])} elsewhere")
    return values


def _declared(name: str, law: Joint) -> tuple[tuple[str, ...], frozenset[str]]:
    """Columns of history and needs of a law of the user's own, checked."""
    columns, needs = law.memory, law.needs
    fine = isinstance(columns, (tuple, list)) and all(isinstance(c, str) and c.isidentifier() for c in columns)
    if not fine or len(set(columns)) < len(columns) or set(columns) & set(TAKEN):
        raise JointError(
            f"joint law {name}: memory = {columns!r}, allowed is a tuple of names, one per column of history beyond "
            f"the six common ones, none of {', '.join(TAKEN)}"
        )
    if isinstance(needs, str) or not set(needs) <= set(NEEDS):
        raise JointError(f"joint law {name}: needs = {needs!r}, allowed is a set of {', '.join(NEEDS)}")
    return tuple(columns), frozenset(needs)
