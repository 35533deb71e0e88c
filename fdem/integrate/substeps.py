"""Sub-steps: blocks with a large stable step feel their internal forces and joints every 2, 4, ... steps only."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from fdem.errors import FdemWarning, UnsupportedError

__all__ = ["Level", "Substeps"]

LEAK = 1e-2  # of the energy turned over: growth between two looks above which rates are halved
FEWER = 0.8  # of the updates of forces: rates that save more than this leaves are worth another table of contacts


class Level:
    """Forces that are found every so many steps.

    Parameters
    ----------
    system : System
        With `Rated` contacts, or none.
    level : int
        The steps between two impulses are ``2^level``.
    internal : list of callable
        Internal forces of the blocks of this level, as ``Blocks.internal``.
    """

    def __init__(self, system: Any, level: int, internal: list[Callable[..., None]]) -> None:
        self.level, self.every = level, 2**level
        state, self._system = system.state, system
        self._forces = np.zeros_like(state.forces)
        f, self._f_gp = self._forces[: len(state.f)], self._forces[-state.f_gp.size :].reshape(-1, 3)
        self._terms: list[Callable[[], None]] = []
        if system.contacts is not None:
            self._terms.append(self._joints)
            pulled = [batch for batch in system.model.batches if not batch.in_place]
            self._terms += [partial(batch.pull, state.q, self._f_gp, f) for batch in pulled]
        self._terms += [partial(each, state.q, state.x, f) for each in internal]

    def _joints(self) -> None:
        system, state = self._system, self._system.state
        system.contacts.act(self.level, state.x, state.x_old, self.every * system.dt, self._f_gp)

    def find(self) -> np.ndarray:
        """Forces (n,) of the present configuration, laid out as in `State.forces` [N, N m]."""
        self._forces.fill(0.0)
        for term in self._terms:
            term()
        return self._forces


class Substeps:
    """Steps of an explicit integrator in which every block has its own rate.

    Parameters
    ----------
    system : System
        What is moved.
    damping : object
        Changes the velocities by the forces (``kick``).
    most : int
        Largest number of steps between two impulses, a power of two.

    Attributes
    ----------
    level : (n_blocks,) int array
        Forces of a block are found every ``2^level`` steps; joints go with the smaller level of their blocks.

    Notes
    -----
    Impulses of several rates in the leapfrog scheme (Tuckerman, Berne and Martyna, J. Chem. Phys. 97 (1992) 1990; in
    finite elements: Hughes and Liu, J. Appl. Mech. 45 (1978) 371): symmetric in time, momentum exact. A force of level
    k acts as an impulse ``2^k dt f`` every ``2^k`` steps. All blocks are in step after ``2^max(level)`` of them: that
    is one step of the simulation. Impulses can resonate with modes of faster blocks, a narrow and weak instability
    that the energy balance shows: where energy grows, rates are halved (`watch`).
    """

    def __init__(self, system: Any, damping: Any, most: int) -> None:
        contacts = system.contacts
        if contacts is not None and (contacts.curved or contacts._corner is not None):
            raise UnsupportedError("Explicit: substeps is not there for joints that stiffen; use substeps=1")
        self.system, self.most, self._damping = system, most, damping
        model = system.model
        self.level = np.zeros(model.n_blocks, dtype=np.int64)
        self.work = np.diff(model.zone_start) + np.diff(model.gp_range, axis=1).ravel()  # of finding a block's forces
        self._turning = [batch for batch in model.batches if batch.turns]
        self.turned: list[np.ndarray] = []
        self._error: float | None = None  # of the energy balance at the last look [J]
        self._x_start = np.empty_like(system.state.x)
        self._lay_out()

    @property
    def every(self) -> int:
        """Sub-steps after which all blocks are in step."""
        return int(2 ** self.level.max(initial=0))

    @property
    def saved(self) -> float:
        """Updates of forces of blocks without sub-steps over those with them."""
        return float(self.work.sum() / self._cost(self.level)) if self.work.sum() else 1.0

    def _cost(self, level: np.ndarray) -> float:
        return float((self.work / 2.0**level).sum())

    def choose(self, steps: np.ndarray, h: float, longest: float) -> None:
        """Choose the rates for stable steps `steps` (n_blocks,) of the blocks [s].

        Sub-steps are `h`, and all blocks are in step again after `longest` at the latest [s]. Rates that are still
        allowed stay if new ones would save little.
        """
        most = np.log2(min(float(self.most), max(longest / h, 1.0))) if np.isfinite(h) else 0.0
        with np.errstate(invalid="ignore"):
            allowed = np.floor(np.log2(np.maximum(np.where(np.isfinite(steps), steps / h, np.inf), 1.0)) + 1e-9)
        wanted = np.minimum(allowed, np.floor(most + 1e-9))
        moving = np.isfinite(allowed)  # what nothing holds, or is fixed, goes along with the slowest
        wanted = np.where(moving, wanted, wanted[moving].max(initial=0.0)).astype(np.int64)
        allowed_still = (self.level <= wanted).all() and self.every <= self.most
        if allowed_still and self._cost(wanted) > FEWER * self._cost(self.level):
            return
        self.take(wanted)

    def take(self, level: np.ndarray) -> None:
        """Give blocks other rates `level` (n_blocks,)."""
        self.settle()
        self.level = level
        if self.system.contacts is not None:
            self.system.contacts.grade(level, self.system.state.x)
        self._lay_out()

    def _lay_out(self) -> None:
        """Make the levels of forces."""
        model = self.system.model
        found: dict[int, list[Any]] = {k: [] for k in range(int(self.level.max(initial=0)) + 1)}
        for batch in model.batches:
            if batch.has_internal:
                for level, internal in batch.graded(self.level[batch.rows]):
                    found[level].append(internal)
        self.system.grade([Level(self.system, k, internal) for k, internal in sorted(found.items())])

    def step(self, system: Any, dt: float) -> None:
        """Bring all blocks `dt` [s] further, in sub-steps."""
        n, x_start = self.every, self._x_start
        h = dt / n
        np.copyto(x_start, system.state.x)
        turned = [np.zeros((len(batch.rows), 3)) for batch in self._turning]
        for k in range(n):
            if k:
                system.act(k)
                system.commit()
            else:
                self._begin()
            self._damping.kick(system, system.lag + 0.5 * h)
            system.prescribe(h)
            system.move(h)
            system.lag = 0.5 * h
            for sum_, batch in zip(turned, self._turning, strict=True):
                sum_ += batch.turn(system.state.q, system.state.v, h)
        self.turned = turned
        system.arrive(x_start, dt)

    def _begin(self) -> None:
        """Find all forces and accept them, each as often as its impulse counts."""
        system = self.system
        system.state.f[:] = system.feel()
        system.surplus, system.current = None, False
        system.commit()

    def settle(self) -> None:
        """Bring the velocities to the time of the configuration, and all joints to the same commit."""
        system = self.system
        if system.lag == 0.0:
            return
        self._begin()
        self._damping.kick(system, system.lag)
        system.lag = system.dt = 0.0
        if system._spun is not None:
            system._spun.fill(0.0)

    def watch(self, error: float, turned: float) -> bool:
        """Halve the rates if the energy balance's `error` has grown by a share of what was `turned` over [J]."""
        before, self._error = self._error, error
        if before is None or error - before <= LEAK * turned or self.every == 1:
            return False
        self.most = self.every // 2
        warnings.warn(
            f"Explicit: energy has grown by {error - before:.3g} J of {turned:.3g} J turned over; forces are now found "
            f"after at most {self.most} sub-steps",
            FdemWarning,
            stacklevel=2,
        )
        return True

    def kept(self) -> dict[str, np.ndarray]:
        """What the next step needs besides the state."""
        contacts = self.system.contacts
        before = {} if contacts is None else {f"x_{k}": x for k, x in contacts.x_before.items()}
        return {"level": self.level, **before}

    def restore(self, arrays: dict[str, Any]) -> None:
        """Take back what `kept` returned."""
        self.level = np.array(arrays["level"])
        if self.system.contacts is not None:
            before = {int(key[2:]): np.array(x) for key, x in arrays.items() if key.startswith("x_")}
            self.system.contacts.resume(self.level, before)
        self._lay_out()
