"""Fixed and prescribed components of velocities: what the solution must not change."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from fdem.errors import SolveError

__all__ = ["Approach", "Condition", "Constraints", "Coupled", "Directions", "Motion"]

# a prescribed displacement closer than this share of its largest value goes there in one step
ARRIVED = 1e-9
# share of the remaining prescribed displacement travelled in one step: slow against the stable step
APPROACH = 0.02


@dataclass
class Motion:
    """Prescribed velocities ``values * factor(t)`` of some degrees of freedom."""

    handle: Any
    dofs: np.ndarray
    values: np.ndarray


@dataclass
class Approach:
    """Prescribed displacements, approached by a fixed share of what is left each step."""

    handle: Any
    dofs: np.ndarray
    coords: np.ndarray
    target: np.ndarray
    share: float


@dataclass
class Directions:
    """Constrained directions of one handle: rows of 3 dofs with a projector on what is fixed."""

    handle: Any
    rows: np.ndarray
    projector: np.ndarray
    static_gp: np.ndarray


@dataclass
class Condition:
    """Conditions of one handle on the unknowns of one block: ``rows v`` is given.

    Attributes
    ----------
    handle : Fix or Applied
        Who asked.
    rows : (m, d) array
        Left sides, such that each is a velocity [m/s].
    target : (d,) array or None
        Velocities whose left sides are the values prescribed, or displacements; None: all zero.
    displacement : bool
        Whether `target` is a displacement.
    """

    handle: Any
    rows: np.ndarray
    target: np.ndarray | None = None
    displacement: bool = False


class Coupled:
    """All conditions on a block whose mass matrix couples its unknowns.

    Parameters
    ----------
    block : int
        Row in the model.
    dofs, coords : slice
        Its unknowns and coordinates.
    conditions : list of Condition
        What is prescribed; `Condition.rows` of different handles may depend on each other.

    Notes
    -----
    With C all rows together, motions that C leaves free are ``P v``, ``P = 1 - W C^T (C W C^T)^+ C`` with the inverse
    mass W; accelerations under forces f are then ``W P^T f = P W f``: Gauss' principle of least constraint.
    """

    def __init__(self, block: int, dofs: slice, coords: slice, conditions: list[Condition]) -> None:
        self.block, self.dofs, self.coords, self.conditions = block, dofs, coords, conditions
        self.rows = np.vstack([condition.rows for condition in conditions])
        self._start = np.cumsum([0, *(len(condition.rows) for condition in conditions)])
        self.weigh(np.eye(self.rows.shape[1]))

    @property
    def moving(self) -> bool:
        """Whether anything but zero is prescribed."""
        return any(condition.target is not None for condition in self.conditions)

    def weigh(self, inverse: np.ndarray, fictitious: bool = False) -> None:
        """Take `inverse` (d, d) as the inverse of the mass matrix.

        A motion that is prescribed anew then moves the rest of the block as an impact would; not with `fictitious`
        masses, whose impact would be fictitious too.
        """
        C, self.inverse = self.rows, inverse
        gram = C @ inverse @ C.T
        # powers of two bring the diagonal near to 1, so that what counts as dependent does not depend on units
        scale = np.exp2(-np.round(0.5 * np.log2(np.diag(gram) / np.diag(gram).max())))
        both = scale[:, None] * scale[None, :]
        middle = np.linalg.pinv(gram * both, rcond=1e-11, hermitian=True) * both
        self._forces = middle @ C @ inverse
        lift = inverse @ C.T @ middle
        self._free = np.eye(C.shape[1]) - lift @ C
        self._lift = np.linalg.pinv(C) if fictitious else lift

    @property
    def free(self) -> np.ndarray:
        """Projector (d, d) of motions on what is free."""
        return self._free

    def given(self, v: np.ndarray) -> np.ndarray:
        """Return what is prescribed of velocities `v` (d,) of the block."""
        return v - self._free @ v

    def still(self, v: np.ndarray) -> None:
        """Take out of motions `v` (n_dofs,) what is prescribed."""
        v[self.dofs] = self._free @ v[self.dofs]

    def release(self, f: np.ndarray) -> None:
        """Take out of forces `f` (n_dofs,) what the conditions carry."""
        f[self.dofs] = self._free.T @ f[self.dofs]

    def prescribe(
        self, v: np.ndarray, q: np.ndarray, q0: np.ndarray, t: float, dt: float, share: float | None = None
    ) -> None:
        """Give velocities `v` what is prescribed at the time `t`; see `Constraints.prescribe`."""
        given = np.zeros(len(self._free))
        for condition in self.conditions:
            if condition.target is None:
                continue
            wanted = condition.target * _factor(condition.handle, t)
            if condition.displacement:
                left = wanted - (q - q0)[self.coords]
                ahead, whole, place = (np.abs(condition.rows @ part).max() for part in (left, wanted, q[self.coords]))
                # by shares it would stop where a share is less than the last bit of q
                arrived = ahead <= max(ARRIVED * whole, 2.0 * np.finfo(float).eps / APPROACH * place)
                wanted = (1.0 if arrived else APPROACH if share is None else share) / dt * left
            given += np.linalg.pinv(condition.rows) @ (condition.rows @ wanted)
        v[self.dofs] += self._lift @ (self.rows @ (given - v[self.dofs]))

    def aim(self, q: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Coordinates (d,) at which velocities `v` arrive straight on."""
        return q[self.coords] + dt * v[self.dofs]

    def meet(self, q: np.ndarray, aim: np.ndarray) -> None:
        """Let what is prescribed of `q` be that of `aim`, whatever way the block has taken there."""
        off = q[self.coords] - aim
        q[self.coords] -= self.given(off)

    def ahead(self, q: np.ndarray, q0: np.ndarray, t: float) -> float:
        """Prescribed displacement still to come, over the largest prescribed."""
        worst = 0.0
        for condition in self.conditions:
            if condition.target is None or not condition.displacement:
                continue
            wanted = condition.target * _factor(condition.handle, t)
            left = np.abs(condition.rows @ (wanted - (q - q0)[self.coords]))
            noise = 4 * np.finfo(float).eps * np.abs(condition.rows) @ np.abs(q[self.coords])
            left = np.maximum(left - noise, 0.0).max()
            scale = max(np.abs(condition.rows @ wanted).max(), left)
            worst = max(worst, float(left / scale) if scale > 0 else 0.0)
        return worst

    def reaction(self, handle: Any, f: np.ndarray) -> np.ndarray:
        """Force (3,) [N] that the conditions of a handle exert, against forces `f` (n_dofs,)."""
        total = np.zeros(3)
        for condition, start in zip(self.conditions, self._start[:-1], strict=True):
            if condition.handle is handle:
                carried = (self._forces @ f[self.dofs])[start : start + len(condition.rows)]
                total -= (condition.rows.T @ carried)[:3]
        return total


@dataclass
class Constraints:
    """All constraints of a model.

    Attributes
    ----------
    fixed : (n,) int array
        Degrees of freedom held at zero velocity.
    oblique_rows, oblique : (k,) int array, (k, 3, 3) array
        First dof of a velocity vector, and the projector on what stays free.
    motions, approaches : list
        Prescribed velocities and displacements.
    reactions : list of Directions
        What each handle holds, for its reaction.
    coupled : list of Coupled
        Conditions on blocks whose mass couples their unknowns.
    """

    fixed: np.ndarray
    oblique_rows: np.ndarray
    oblique: np.ndarray
    motions: list[Motion] = field(default_factory=list)
    approaches: list[Approach] = field(default_factory=list)
    reactions: list[Directions] = field(default_factory=list)
    coupled: list[Coupled] = field(default_factory=list)

    @property
    def moving(self) -> bool:
        """Whether a prescribed component can do work."""
        return bool(self.motions or self.approaches) or any(group.moving for group in self.coupled)

    @cached_property
    def held(self) -> np.ndarray:
        """Degrees of freedom whose velocity is given."""
        parts = [self.fixed, *(m.dofs for m in self.motions), *(a.dofs for a in self.approaches)]
        return np.unique(np.concatenate(parts))

    def given(self, v: np.ndarray) -> np.ndarray:
        """Return the part of velocities `v` that is prescribed."""
        result = np.zeros_like(v)
        result[self.held] = v[self.held]
        for group in self.coupled:
            result[group.dofs] = group.given(v[group.dofs])
        return result

    def keep(self, v: np.ndarray, known: np.ndarray) -> None:
        """Give the prescribed part of velocities `v` the values it has in `known`."""
        v[self.held] = known[self.held]
        for group in self.coupled:
            v[group.dofs] += group.given(known[group.dofs] - v[group.dofs])

    def release(self, f: np.ndarray) -> None:
        """Take out of forces `f` what the constraints carry."""
        self._clear(f)
        for group in self.coupled:
            group.release(f)

    def carried_off(self, f: np.ndarray) -> np.ndarray:
        """Return forces `f` without what `Coupled` conditions carry.

        Then it is the forces that decide where a block comes to rest, whatever fictitious masses have turned to.
        """
        f = f.copy()
        for group in self.coupled:
            group.release(f)
        return f

    def still(self, a: np.ndarray) -> None:
        """Take out of accelerations or velocities `a` what is prescribed."""
        self._clear(a)
        for group in self.coupled:
            group.still(a)

    @property
    def any(self) -> bool:
        """Whether anything is constrained."""
        return bool(len(self.held) or len(self.oblique_rows) or self.coupled)

    def _clear(self, a: np.ndarray) -> None:
        a[self.fixed] = 0.0
        for motion in self.motions:
            a[motion.dofs] = 0.0
        for approach in self.approaches:
            a[approach.dofs] = 0.0
        if len(self.oblique_rows):
            self._project(a)

    def prescribe(
        self, v: np.ndarray, q: np.ndarray, q0: np.ndarray, t: float, dt: float, share: float | None = None
    ) -> None:
        """Give the constrained velocities their values at time `t`; `share` replaces that of the approaches.

        Raises
        ------
        SolveError
            If a factor is not finite.
        """
        v[self.fixed] = 0.0
        if len(self.oblique_rows):
            self._project(v)
        for motion in self.motions:
            v[motion.dofs] = motion.values * _factor(motion.handle, t)
        for approach in self.approaches:
            target = approach.target * _factor(approach.handle, t)
            left = target - (q[approach.coords] - q0[approach.coords])
            # the last part in one step: by shares it would stop where a share is less than the last bit of q
            near = np.abs(left) <= ARRIVED * np.abs(target).max(initial=0.0)
            v[approach.dofs] = np.where(near, 1.0, approach.share if share is None else share) / dt * left
        for group in self.coupled:
            group.prescribe(v, q, q0, t, dt, share)

    def velocity(self, motion: Motion, t: float) -> np.ndarray:
        """Velocities of a prescribed motion at the time `t`."""
        return motion.values * _factor(motion.handle, t)

    def ahead(self, q: np.ndarray, q0: np.ndarray, t: float) -> float:
        """Prescribed displacement still to come at time `t`, over the largest prescribed: the worst of all loads."""
        worst = max((group.ahead(q, q0, t) for group in self.coupled), default=0.0)
        for approach in self.approaches:
            target = approach.target * _factor(approach.handle, t)
            left = np.abs(target - (q[approach.coords] - q0[approach.coords]))
            # no closer than the last bits of the coordinates
            left = np.maximum(left - 4 * np.finfo(float).eps * np.abs(q[approach.coords]), 0.0).max(initial=0.0)
            scale = max(np.abs(target).max(initial=0.0), left)
            worst = max(worst, float(left / scale) if scale > 0 else 0.0)
        return worst

    def _project(self, v: np.ndarray) -> None:
        index = self.oblique_rows[:, None] + np.arange(3)
        v[index] = np.einsum("nij,nj->ni", self.oblique, v[index])


def _factor(handle: Any, t: float) -> float:
    value = float(handle.factor(t)) if callable(handle.factor) else float(handle.factor)
    if not np.isfinite(value):
        raise SolveError(f"load {handle.load!r}: factor = {value!r} at t = {t:g} s is not finite")
    return value
