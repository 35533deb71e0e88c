"""Pace: how far a step of a `System` may move blocks, so that contacts to come are seen."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.loads import Dashpot

__all__ = ["Pace"]

MOTION = 2e-3  # of the smallest block's size per step: corners meet with next to no stiffness, which then grows fast


class Pace:
    """The part of `System` that looks ahead."""

    model: Any
    state: Any
    contacts: Any
    particles: Any
    lag: float
    damped: float
    _smallest: float
    forces: Any
    accelerate: Any
    scaled_kinetic: Any
    springs: Any
    loads: Any
    _speeds: Any
    _k_used: np.ndarray | None

    def unseen_motion(self) -> float:
        """Longest step [s] in which no block moves so far that a stiff contact goes unseen; infinite at rest."""
        speed, faced = self._pushed(self.state.v), np.ones(self.model.n_blocks, dtype=bool)
        unseen = np.inf
        if self.particles is not None:
            faced[self.particles.particles.block] = False
            unseen = self.particles.unseen_motion(speed)
        if not faced.any():
            return unseen
        square = np.einsum("ni,ni->n", speed, speed) * faced[self.model.gp_block]
        fastest = float(np.sqrt(square.max(initial=0.0)))
        size = float(self.model.size[faced & ~self.model.fixed].min(initial=np.inf))
        return min(unseen, MOTION * size / fastest) if fastest > 0.0 else unseen

    def slow_down(self, dt: float) -> None:
        """Take away from the velocities what would move a block by more than MOTION of its size in `dt`."""
        state, model = self.state, self.model
        if dt * self._speed_bound() <= MOTION * self._smallest:
            return
        speed = self._pushed(state.v)
        path = dt * np.sqrt(np.einsum("ni,ni->n", speed, speed))
        if not (path > MOTION * model.size[model.gp_block]).any():
            return
        longest = np.zeros(model.n_blocks)
        np.maximum.at(longest, model.gp_block, path)
        factor = np.minimum(1.0, MOTION * model.size / np.maximum(longest, np.finfo(float).tiny))
        before = self.scaled_kinetic(state.v)
        for batch in model.batches:
            rows = model.gp_block[batch.gridpoints] if batch.in_place else batch.rows
            v = state.v[batch.dofs].reshape(len(rows), -1)
            v *= factor[rows][:, None]
        self.damped += 0.5 * (before - self.scaled_kinetic(state.v))

    def _speed_bound(self) -> float:
        """At least the largest speed of any gridpoint [m/s]."""
        bound, speed = 0.0, np.zeros_like(self.state.x)
        for batch in self.model.batches:
            if batch.in_place:
                bound = max(bound, 2.0 * float(np.abs(self.state.v[batch.dofs]).max(initial=0.0)))  # 2 > sqrt(3)
            else:
                batch.push(self.state.q, self.state.v, speed)
                own = speed[batch.gridpoints]
                bound = max(bound, float(np.sqrt(np.einsum("ni,ni->n", own, own).max(initial=0.0))))
        return bound

    def safe_closing(self) -> float:
        """Longest step t [s] in which no joint that stiffens closes further than it can take; kicks last lag + t/2."""
        a = self._pushed(self.accelerate(self.forces()))
        speed = self._pushed(self.state.v) + self.lag * a
        return float(self.contacts.pace(speed, 0.5 * a).min(initial=np.inf))

    def _pushed(self, v: np.ndarray) -> np.ndarray:
        """Values at gridpoints (n_gp, 3) of generalised velocities or accelerations."""
        result = np.zeros_like(self.state.x)
        for batch in self.model.batches:
            batch.push(self.state.q, v, result)
        return result

    def brake(self, dt: float) -> None:
        """Slow down blocks that would close a stiffening joint further than it can take in `dt`; fictitious time only.

        Parameters
        ----------
        dt : float
            The step to come.
        """
        speed = self._pushed(self.state.v)
        share = np.minimum(self.contacts.pace(speed, np.zeros_like(speed)) / dt, 1.0)
        if (share == 1.0).all():
            return
        v, before = self.state.v, self.scaled_kinetic(self.state.v)
        for batch in self.model.batches:
            owner = self.model.gp_block[batch.gridpoints] if batch.in_place else batch.rows
            mine = v[batch.dofs].reshape(len(owner), -1)
            mine *= share[owner][:, None]
        self.damped += 0.5 * (before - self.scaled_kinetic(v))

    def stiffened(self) -> bool:
        """Whether contact stiffness grew by 2 % of its block's largest anywhere, or halved in all, since last asked."""
        if self.particles is not None and self.particles.stiffened(self._speeds()):
            return True
        if self.contacts is None:
            return False
        k, model = self.springs().k_gp, self.model
        if self._k_used is not None:
            largest = np.zeros(model.n_blocks)
            np.maximum.at(largest, model.gp_block, self._k_used)
            if (k <= self._k_used + 0.02 * largest[model.gp_block]).all() and k.sum() >= 0.5 * self._k_used.sum():
                return False
        self._k_used = k
        return True

    def block_frequencies(self) -> np.ndarray:
        """Upper bounds of the squared frequency (n_blocks,) [1/s^2]; 0 for fixed blocks."""
        springs, result = self.springs(), np.zeros(self.model.n_blocks)
        for batch in self.model.batches:
            result[batch.rows] = batch.step_bound(self.state.q, springs)
        result[self.model.fixed] = 0.0
        return result

    def dashpot_rate(self) -> float:
        """Bound of the decay rate 2 zeta omega [1/s] that dashpots on faces give a gridpoint or a block."""
        rate = 0.0
        for load in self.loads:
            if isinstance(load, Dashpot):
                strength = np.zeros(len(self.model.X))
                strength[load.gp] = np.linalg.norm(load.matrices, 2, axis=(1, 2))
                rate = max([rate, *(batch.decay_bound(self.state.q, strength) for batch in self.model.batches)])
        return rate
