"""Sleep: blocks at rest are left out of the work of a step until something disturbs them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fdem.errors import SceneError, UnsupportedError

__all__ = ["Sleep", "Sleeper", "work_of"]

LOOKS = 31  # per window; an odd number, so that few oscillations are in step with it


@dataclass(frozen=True)
class Sleep:
    """Blocks at rest sleep: they are held, and contacts among them cost nothing, until something disturbs them.

    Parameters
    ----------
    motion : float, optional
        A block is at rest if it moved by less than this share of its size in `steps` steps.
    steps : int, optional
        Steps of the window.
    share : float, optional
        It is no rest if more than this share of the forces on a block is not balanced, and a change of them by as much
        wakes it.

    Raises
    ------
    SceneError
        If a value is not in its range.

    Notes
    -----
    Blocks that hang together by closed contacts (an island; fixed and driven blocks and those that sleep already do not
    join islands) fall asleep together and wake together. What they still had of kinetic energy goes to the ledger's
    damping. Blocks with a prescribed motion never sleep. Blocks awake feel sleepers as fixed ones; a change of force
    below `share` is not passed on. The time step is the one without sleeping. Without any damping elastic vibrations
    never end, and nothing sleeps.
    """

    motion: float = 1e-6
    steps: int = 1000
    share: float = 1e-3

    def __post_init__(self) -> None:
        for name, low, high in (("motion", 0.0, 1.0), ("share", 0.0, 1.0)):
            value = getattr(self, name)
            known = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
            if not known or not low < value <= high:
                raise SceneError(f"Sleep: {name} = {value!r}, allowed is a number in ({low:g}, {high:g}]")
        if not isinstance(self.steps, (int, np.integer)) or isinstance(self.steps, bool) or self.steps < 1:
            raise SceneError(f"Sleep: steps = {self.steps!r}, allowed is a whole number >= 1")


class Sleeper:
    """Lets blocks of a system fall asleep and wakes them; stands in a step for the system's `forces` and `advance`.

    Parameters
    ----------
    system : System
        With contacts that can be parked.
    options : Sleep
        What counts as rest.

    """

    def __init__(self, system: Any, options: Sleep) -> None:
        self.system, self.options, self.parking = system, options, system.contacts
        model, constraints = system.model, system.constraints
        self._every = max(1, options.steps // LOOKS)
        self._fixed = constraints.fixed
        self._dof_block = np.zeros(len(system.state.v), dtype=np.int64)
        self._mobile = (model.batch_index >= 0) & ~model.fixed
        for block in np.flatnonzero(model.batch_index >= 0):
            self._dof_block[model.batch_of(block).dofs_of(int(model.batch_row[block]))] = block
        self._may = self._mobile.copy()  # blocks with a prescribed motion never sleep
        for given in (*constraints.motions, *constraints.approaches):
            self._may[self._dof_block[given.dofs]] = False
        for group in constraints.coupled:
            self._may[group.block] &= not group.moving
        self._pulled = max((b.gridpoints.stop for b in model.batches if b.in_place), default=0)
        self._limit = options.motion * model.size
        self._mass, self._weight = model.mass, model.mass * float(np.linalg.norm(model.gravity))
        self.parking.changed = self._hold
        self._hold()

    def _hold(self) -> None:
        """Hold the unknowns of sleepers as fixed ones are."""
        constraints = self.system.constraints
        dofs = np.flatnonzero(self.parking.asleep[self._dof_block])
        constraints.fixed = np.union1d(self._fixed, dofs)
        vars(constraints).pop("held", None)

    def _forces_on_gridpoints(self) -> np.ndarray:
        """Forces (n_gp, 3) [N] of contacts and loads; where gridpoints are unknowns, of everything."""
        system, f = self.system, self.system.state.f_gp
        if system.f_load is not None:
            f = f.copy()
            f[self._pulled :] += system.f_load[self._pulled :]
        return f

    def forces(self) -> None:
        """Forces of the present configuration, after waking those that feel a change."""
        system = self.system
        system.forces()
        if not len(self.parking.gps):
            return
        if (woken := self.parking.disturbed(self._forces_on_gridpoints())) is not None:
            self.parking.wake(woken, system.state.step)
            system.current = False
            system.forces()

    def advance(self, dt: float) -> None:
        """Let what is at rest fall asleep, then move by `dt` [s]."""
        if self.system.state.step % self._every == 0:
            self._look(dt)
        self.system.advance(dt)

    def _look(self, dt: float) -> None:
        state, parking, limit = self.system.state, self.parking, self._limit
        astir = parking.largest(state.x, parking.mark) > limit
        astir |= self._every * dt * parking.largest(self._pushed(state.v)) > limit
        parking.restart((astir | (parking.since < 0)) & self._mobile, state.step)
        ready = self._may & ~parking.asleep & (state.step - parking.since >= self.options.steps)
        if not ready.any():
            return
        allowed = self.options.share * self._acting()
        ready &= self._mass * parking.largest(self._pushed(self.system.accelerate(state.f))) <= allowed
        ready = parking.resting(ready, self._mobile)
        if ready.any():
            self.system.stale |= parking.park(ready)
            self._stop(ready, allowed)

    def _acting(self) -> np.ndarray:
        """Sum (n_blocks,) of the sizes of all forces on each block [N]: contacts, loads, weight."""
        model, load = self.system.model, self.system.f_load
        each = np.linalg.norm(self.parking.pushes(), axis=1)
        if load is not None:
            each += np.linalg.norm(load, axis=1)
        total: np.ndarray = self._weight + np.bincount(model.gp_block, each, model.n_blocks)
        return total

    def _pushed(self, v: np.ndarray) -> np.ndarray:
        out = np.zeros_like(self.system.state.x)
        for batch in self.system.model.batches:
            batch.push(self.system.state.q, v, out)
        return out

    def _stop(self, blocks: np.ndarray, allowed: np.ndarray) -> None:
        """Take the motion of `blocks` to the ledger, and keep the forces that hold them; `allowed` changes [N]."""
        system, state = self.system, self.system.state
        mine = blocks[self._dof_block]
        lost = np.where(mine, state.v, 0.0)
        state.v[mine] = 0.0
        system.damped += sum(batch.kinetic(state.q, lost) for batch in system.model.batches)
        system.current = False
        system.forces()
        self.parking.remember(blocks, self._forces_on_gridpoints(), allowed)


def work_of(system: Any, options: Sleep | None) -> tuple[Callable[[], Any], Callable[[float], None]]:
    """What finds the forces of a step and what moves the system on: its own methods, or those of a `Sleeper`.

    Raises
    ------
    UnsupportedError
        Blocks shall sleep, but there are spheres.
    """
    if options is None:
        return system.forces, system.advance
    if system.particles is not None:
        raise UnsupportedError("Explicit: sleep is not there for scenes with spheres; leave it out")
    if system.contacts is None:  # nothing to be saved
        return system.forces, system.advance
    sleeper = Sleeper(system, options)
    return sleeper.forces, sleeper.advance
