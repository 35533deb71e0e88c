"""Fixed and prescribed components of velocities: what the solution must not change."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdem.errors import SolveError

__all__ = ["Approach", "Constraints", "Directions", "Motion"]

# a prescribed displacement closer than this share of its largest value goes there in one step
ARRIVED = 1e-9


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
    """

    fixed: np.ndarray
    oblique_rows: np.ndarray
    oblique: np.ndarray
    motions: list[Motion] = field(default_factory=list)
    approaches: list[Approach] = field(default_factory=list)
    reactions: list[Directions] = field(default_factory=list)

    @property
    def moving(self) -> bool:
        """Whether a prescribed component can do work."""
        return bool(self.motions or self.approaches)

    def held(self) -> np.ndarray:
        """Degrees of freedom whose velocity is given."""
        parts = [self.fixed, *(m.dofs for m in self.motions), *(a.dofs for a in self.approaches)]
        return np.unique(np.concatenate(parts))

    def release(self, a: np.ndarray) -> None:
        """Set the constrained part of accelerations or forces `a` to zero."""
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

    def ahead(self, q: np.ndarray, q0: np.ndarray, t: float) -> float:
        """Prescribed displacement still to come at time `t`, over the largest prescribed: the worst of all loads."""
        worst = 0.0
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
