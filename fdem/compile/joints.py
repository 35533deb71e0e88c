"""From joint rules to property tables, and which contact gets which."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from fdem.compile.assembly import Layout
from fdem.compile.select import Selector
from fdem.errors import FdemWarning, JointError
from fdem.scene.joints import Joint
from fdem.scene.scene import JointRule, choose

__all__ = ["JointTables"]


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
        self.kernels: list[Any] = []
        self.rows: list[list[tuple[float, ...]]] = []
        self.location: list[tuple[int, int]] = []
        self.laws: list[Joint] = []
        self._pairs: dict[int, int] = {}
        for rule in self.rules:
            kernel = rule.law.kernel
            if kernel not in self.kernels:
                self.kernels.append(kernel)
                self.rows.append([])
            law = self.kernels.index(kernel)
            kn, ks = self._stiffness(rule)
            self.location.append((law, len(self.rows[law])))
            self.rows[law].append(rule.law.properties(kn, ks))
            self.laws.append(rule.law)
        order = sorted(range(len(self.rules)), key=lambda i: (self.rules[i].rank, i))
        self._tests = [(i, self._test(self.rules[i])) for i in order]

    def hard(self, law: int) -> np.ndarray | None:
        """Friction coefficient, cohesion, tension and restitution (n, 4) of a law's rows; None if it has none."""
        rows = [rule.law.hard() for rule, (k, _) in zip(self.rules, self.location, strict=True) if k == law]
        return None if any(row is None for row in rows) else np.array(rows, dtype=float).reshape(-1, 4)

    def _test(self, rule: JointRule) -> Any:
        """What decides whether a contact falls under a rule: tags, block masks."""
        n = self.model.n_blocks

        def members(target: Any) -> np.ndarray:
            mask = np.zeros(n, dtype=bool)
            mask[self.select.blocks(target, "joint")] = True
            return mask

        if rule.between is not None:
            return None, members(rule.between[0]), members(rule.between[1])
        if isinstance(rule.target, str) and self.layout.scene.is_joint_set(rule.target):
            return self.select.tag_number.get(rule.target, -2), None, None
        return None, members(rule.target), np.ones(n, dtype=bool)

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
        chosen = np.full(len(block_a), -1, dtype=np.int32)
        loose = chosen.copy()
        for rule_id, (tag, first, second) in self._tests:
            rule = self.rules[rule_id]
            if tag is not None:
                mask = (tag_a == tag) & (tag_b == tag)
                loose[(tag_a == tag) | (tag_b == tag)] = rule_id
            else:
                mask = (first[block_a] & second[block_b]) | (first[block_b] & second[block_a])
            if rule.where is not None and mask.any():
                mask[mask] = choose("joint", rule.where, points[mask] + self.model.origin)
            chosen[mask] = rule_id
        self._complete(chosen, loose, block_a, block_b)
        location = np.array(self.location, dtype=np.int32).reshape(-1, 2)
        return location[chosen, 0], location[chosen, 1], chosen

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
                a, b = (self.model.names[i] for i in sorted((block_a[row], block_b[row])))
                raise JointError(
                    f"blocks {a!r} and {b!r} can touch, but no joint law covers them; add scene.joint(law)"
                )
            chosen[row] = known[int(pair[row])]

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
            if soft:
                kn, poisson = min(soft)
            else:
                kn = self._rigid_stiffness()
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
