"""System: the one interface M(q) a = f(t, q, v) that integrators see, over a Model and a State."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from fdem.blocks.bounds import Springs
from fdem.constraints import Constraints
from fdem.contact.wear import refuse_leaps
from fdem.errors import UnstableError
from fdem.integrate.pace import Pace
from fdem.loads import Bedding, Load, Torque
from fdem.model import Model
from fdem.state import State

__all__ = ["System"]


class System(Pace):
    """Forces, masses and kinematics of a compiled scene; knows no formulation and no joint law.

    Parameters
    ----------
    model, state : Model, State
        What compile made.
    contacts, particles : Contacts or None, SphereContacts or None
        The contact layer; contacts with a sphere in them.
    constraints : Constraints
        Fixed and prescribed components.
    loads : list of Load
        Forces on gridpoints.
    alpha : (n_dofs,) array or None
        Mass-proportional damping [1/s].
    energy : bool
        Keep the work of loads and prescribed motion.
    """

    def __init__(
        self,
        model: Model,
        state: State,
        contacts: Any,
        particles: Any,
        constraints: Constraints,
        loads: list[Load],
        alpha: np.ndarray | None,
        energy: bool = True,
    ) -> None:
        self.model, self.state, self.contacts, self.particles = model, state, contacts, particles
        self.constraints, self.loads, self.alpha = constraints, loads, alpha
        self.rate: Any = alpha  # all mass-proportional damping, that of the integrator included [1/s]
        self.lag = 0.0  # time by which v is behind q: 0 before the first step, then half a step [s]
        self.dt = 0.0  # the last step [s]
        self.fictitious = False  # masses are scaled: time and velocities have no meaning of their own
        self.mean_contact: np.ndarray | None = None  # forces of hard contact over the last step, in place of springs
        self.mean_moment: np.ndarray | None = None  # and moments on spheres
        self.hard_table: Callable[[], dict[str, Any]] | None = None
        self.a_old: np.ndarray | None = None  # acceleration that implicit steps go on from
        self.given: np.ndarray | None = None  # prescribed increments of the last implicit step
        self.work = 0.0
        self.damped = 0.0
        self.scaled: list[Any] = [None] * len(model.batches)
        self.levels: tuple[Any, ...] = ()  # forces found at rates of their own, see `grade`
        self.surplus: np.ndarray | None = None  # what the impulses of a step have beyond its forces
        self.elastic: np.ndarray | None = None  # elastic forces, kept only if a damping asks for them
        self.elastic_old: np.ndarray | None = None
        self.omega = 0.0  # frequency and forces that `Adaptive` damping goes by
        self.force_before: np.ndarray | None = None
        self.q0 = state.q.copy()
        self.a = np.zeros_like(state.v)
        self.f_load = np.zeros_like(state.f_gp) if loads else None
        self.xdot = np.zeros_like(state.x) if any(load.needs_velocity for load in loads) else None
        self._k_used: np.ndarray | None = None
        self.current = False
        self.stale = True
        self._load_old = np.zeros_like(state.f_gp) if loads and energy else None
        self._reaction_old = np.zeros_like(state.v) if constraints.moving and energy else None
        self._moving = max((b.gridpoints.stop for b in model.batches), default=0)  # those of fixed blocks come last
        self.first_pulled = max((b.gridpoints.stop for b in model.batches if b.in_place), default=0)
        self.stiffening = contacts is not None and contacts.curved  # joints whose stiffness grows as they close
        self._torques = [load for load in loads if isinstance(load, Torque)]
        self._turning = np.zeros_like(state.v) if self._torques else None
        self._turning_old = np.zeros_like(state.v) if self._torques and energy else None
        self._spun = np.zeros_like(state.v) if self._torques and energy else None
        self._keeps_old = contacts is not None or particles is not None or self._load_old is not None
        # changes the velocities by the accelerations of the present forces over a time [s]
        self.kick = self._kick_held if constraints.any else self._kick_free
        self.weight = self._weight()
        for group in constraints.coupled:
            model.batch_of(group.block).confine(int(model.batch_row[group.block]), group.rows)
        self.weigh()
        self._terms = self._choose_terms()
        self._smallest = float(model.size[~model.fixed].min(initial=np.inf))

    def _choose_terms(self) -> tuple[Callable[[], None], ...]:
        """The force terms this scene needs, in order."""
        state = self.state
        terms: list[Callable[[], None]] = []
        if self.mean_contact is not None:
            terms.append(partial(np.add, state.f_gp, self.mean_contact, out=state.f_gp))
            terms.append(partial(np.add, state.f, self.mean_moment, out=state.f))
        elif self.contacts is not None and not self.levels:
            terms.append(lambda: self.contacts.forces(state.x, state.x_old, self._real_dt, state.f_gp))
        if self.particles is not None and self.mean_contact is None:
            terms.append(lambda: self.particles.forces(state.x, state.x_old, self._real_dt, state.f_gp, state.f))
        if terms:
            for batch in self.model.batches:
                if not batch.in_place:
                    terms.append(partial(batch.pull, state.q, state.f_gp, state.f))
        for batch in self.model.batches:
            if batch.has_internal and not self.levels:
                terms.append(partial(batch.internal, state.q, state.x, state.f))
        terms.append(self._keep_elastic)
        if self.loads:
            terms.append(self._add_loads)
        if self.levels:
            terms.append(self._add_levels)
        return tuple(terms)

    def _weight(self) -> np.ndarray:
        """Weight of everything (n_dofs,) [N]; it does not change, so forces start from it."""
        weight = np.zeros_like(self.state.f)
        if np.any(self.model.gravity):
            for batch in self.model.batches:
                batch.weight(self.model.gravity, weight)
        return weight

    def _keep_elastic(self) -> None:
        if self.elastic is not None:
            np.subtract(self.state.f, self.weight, out=self.elastic)

    def _add_loads(self) -> None:
        state, total = self.state, self.f_load
        assert total is not None
        total.fill(0.0)
        if self.xdot is not None and not self.fictitious:
            for batch in self.model.batches:
                batch.push(state.q, state.v, self.xdot)
        for load in self.loads:
            load.add(state.t, state.step, state.x, self.xdot, total)
        for batch in self.model.batches:
            batch.pull(state.q, total, state.f)
        if self._turning is not None:
            self._turning.fill(0.0)
            for torque in self._torques:
                torque.turn(state.t, self._turning)
            state.f += self._turning

    def forces(self) -> np.ndarray:
        """Generalised forces f(t, q, v) of the present configuration [N, N m]."""
        if not self.current:
            # gridpoints whose positions are unknowns share memory with f: only the others are cleared here
            self.state.f_gp[self.first_pulled :].fill(0.0)
            np.copyto(self.state.f, self.weight)
            for term in self._terms:
                term()
            self.current = True
        return self.state.f

    def accelerate(self, f: np.ndarray) -> np.ndarray:
        """Accelerations M^-1 f with the constrained part set to zero."""
        if self.constraints.coupled:
            f = self.constraints.carried_off(f)
        for batch, scaled in zip(self.model.batches, self.scaled, strict=True):
            batch.accelerate(self.state.q, f, self.a, scaled)
        self.constraints.still(self.a)
        return self.a

    def _kick_held(self, h: float) -> None:
        a = self.accelerate(self.state.f)
        a *= h
        self.state.v += a

    def _kick_free(self, h: float) -> None:
        state = self.state
        for batch, scaled in zip(self.model.batches, self.scaled, strict=True):
            batch.kick(state.q, state.f, state.v, h, self.a, scaled)

    def resist(self, share: float, f: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Forces that resist the motion `v`, a `share` of the forces `f` by components (n_dofs,)."""
        result = np.empty_like(f)
        for batch in self.model.batches:
            batch.resist(self.state.q, f, v, share, result)
        return result

    def prescribe(self, dt: float) -> None:
        """Give constrained velocities their values in the middle of the step of length `dt` [s]."""
        self.constraints.prescribe(self.state.v, self.state.q, self.q0, self.state.t + 0.5 * dt, dt)

    def grade(self, levels: Sequence[Any]) -> None:
        """Let contacts and internal forces be those of `levels`, each found every so many steps.

        Parameters
        ----------
        levels : sequence
            With ``every``, the steps between two impulses, and ``find()``, which returns forces like those of
            `State` as one array.
        """
        self.levels, self.surplus = tuple(levels), None
        self._terms, self.current = self._choose_terms(), False

    def _add_levels(self) -> None:
        state = self.state
        self.surplus = np.zeros_like(state.f)
        for level in self.levels:
            found = level.find()
            state.forces += found
            if level.every > 1:
                self.surplus += (level.every - 1) * found[: len(state.f)]

    def act(self, sub_step: int) -> None:
        """Find the forces whose impulses are due in a sub-step, each as often as it counts."""
        state = self.state
        state.f_gp[self.first_pulled :].fill(0.0)
        np.copyto(state.f, self.weight)
        for term in self._terms[:-1]:
            term()
        for level in self.levels:
            if sub_step % level.every == 0:
                found = level.find()
                state.forces += found if level.every == 1 else level.every * found

    def feel(self) -> np.ndarray:
        """Forces of the present configuration, each as often as its impulse counts now [N, N m]."""
        f = self.forces()
        return f if self.surplus is None else f + self.surplus

    def commit(self) -> None:
        """Accept the forces of the present configuration: memory of contacts, work of loads."""
        self.work += self.pending_work()
        if self._load_old is not None:
            self._load_old[:] = self.f_load
        if self._turning_old is not None:
            self._turning_old[:] = self._turning
        if self._reaction_old is not None:
            self._reaction_old[:] = self.state.f
        if self.elastic is not None:
            self.elastic, self.elastic_old = self.elastic_old, self.elastic
        if self.contacts is not None:
            self.contacts.commit()
        if self.particles is not None:
            self.particles.commit()
        if self._keeps_old:
            self.state.x_old[: self._moving] = self.state.x[: self._moving]

    def keep_motion(self, d: np.ndarray, mean: np.ndarray | None = None) -> None:
        """Take note of the increment `d` (n_dofs,) of a step, for the work of moments and reactions.

        `mean` are the forces over the step (n_dofs,) [N, N m] where they are known; else those at its ends count.
        """
        if self._spun is not None:
            self._spun[:] = d
        if self._reaction_old is not None:
            self.given = self.constraints.given(d)
            if mean is not None:
                self._reaction_old[:] = mean

    def harden(self) -> None:
        """Leave the forces of penalty contacts out; mean forces over the last step take their place."""
        self.mean_contact, self.mean_moment = np.zeros_like(self.state.f_gp), np.zeros_like(self.state.f)
        self._terms = self._choose_terms()
        self.current = False

    def commit_loads(self) -> None:
        """Work of loads up to here; positions as those of the last commit."""
        self.work += self.pending_work()
        if self._load_old is not None:
            self._load_old[:] = self.f_load
        if self._turning_old is not None:
            self._turning_old[:] = self._turning
        self.state.x_old[:] = self.state.x

    def pending_work(self) -> float:
        """Work [J] of loads and prescribed motion over the last step, by the trapezoidal rule."""
        work = 0.0
        if self._load_old is not None and self.state.step > 0:
            moved = self.state.x - self.state.x_old
            work += 0.5 * float(np.vdot(self._load_old + self.f_load, moved))
        if self._turning_old is not None and self.state.step > 0:
            work += 0.5 * float((self._turning_old + self._turning) @ self._spun)
        if self._reaction_old is not None and self.state.step > 0:
            given = self.dt * self.constraints.given(self.state.v) if self.given is None else self.given
            f = self.state.f if self.surplus is None else self.state.f + self.surplus
            work -= 0.5 * float((self._reaction_old + f) @ given)
        return work

    def advance(self, dt: float) -> None:
        """Move the configuration by `dt` [s] with the present velocities; look for contacts if due."""
        self.move(dt)
        self.arrive(self.state.x_old, dt)

    def move(self, dt: float) -> None:
        """Move the configuration by `dt` [s] with the present velocities."""
        state = self.state
        aims = [group.aim(state.q, state.v, dt) for group in self.constraints.coupled]
        if self._spun is not None:
            np.multiply(state.v, dt, out=self._spun)
        for batch, scaled in zip(self.model.batches, self.scaled, strict=True):
            batch.advance(state.q, state.v, dt, scaled)
        for group, aim in zip(self.constraints.coupled, aims, strict=True):
            group.meet(state.q, aim)
        for batch in self.model.batches:
            batch.place(state.q, state.x)
        state.t += dt
        self.dt = dt
        self.current = False

    def arrive(self, before: np.ndarray, dt: float) -> None:
        """Count a step of `dt` [s] that began at `before` (n_gp, 3) [m], and look for contacts if due."""
        state = self.state
        state.step += 1
        if self.contacts is not None and (self.contacts.update(state.x) or self.contacts.stiffer):
            self.stale = True
            refuse_leaps(self.contacts, before, state.x)
        if self.particles is not None and self.particles.update(state.x, before, state.v, dt):
            self.stale = True

    def velocity(self) -> np.ndarray:
        """Velocities at the time of the configuration, not half a step behind (n_dofs,)."""
        if self.lag == 0.0:
            return self.state.v.copy()
        self.accelerate(self.feel())
        if self.rate is None or (self.fictitious and self.rate is self.alpha):
            v = self.state.v + self.lag * self.a
        else:
            half = 0.5 * self.lag * self.rate
            v = ((1.0 - half) * self.state.v + self.lag * self.a) / (1.0 + half)
        if self.constraints.moving:
            self.constraints.keep(v, self.state.v)
        return v

    def springs(self) -> Springs:
        """Contacts and bedded faces, as the bounds of frequencies see them."""
        bedding = np.zeros(len(self.model.X))
        for load in self.loads:
            if isinstance(load, Bedding):
                bedding[load.gp] += np.linalg.norm(load.matrices, 2, axis=(1, 2))
        particles = None
        if self.particles is not None:
            particles = self.particles.springs(self.state.x, self._speeds())
            bedding += particles.on_faces(len(bedding))
        return Springs(self.state.x, bedding, self.contacts, self.model.gp_block, ~self.model.fixed, particles)

    def _speeds(self) -> np.ndarray:
        """Gridpoint velocities (n_gp, 3) [m/s]; zero in fictitious time."""
        speed = np.zeros_like(self.state.x)
        if not self.fictitious:
            for batch in self.model.batches:
                batch.push(self.state.q, self.state.v, speed)
        return speed

    def bedded(self) -> list[np.ndarray]:
        """Gridpoints of every elastic support."""
        return [load.gp for load in self.loads if isinstance(load, Bedding)]

    @property
    def _real_dt(self) -> float:
        """The last step [s]; 0 in fictitious time, where dashpots would mix its unit with seconds."""
        return 0.0 if self.fictitious else self.dt

    def scale_masses(self, swing: float = 1.0) -> None:
        """Replace the masses by fictitious ones for which one unit of time is half the stable step.

        Parameters
        ----------
        swing : float, optional
            Largest factor by which damping makes a spring stiffer.
        """
        self.fictitious = True
        springs = self.springs()
        self.scaled = [batch.scaled_masses(self.state.q, springs, swing) for batch in self.model.batches]
        self.weigh()

    def weigh(self) -> None:
        """Tell conditions on blocks whose mass couples their unknowns what that mass is."""
        for group in self.constraints.coupled:
            batch, scaled = self.model.batch_of(group.block), self.scaled[self.model.batch_index[group.block]]
            row = int(self.model.batch_row[group.block])
            group.weigh(batch.inverse_mass(row, self.state.q, scaled), scaled is not None)

    def scaled_kinetic(self, v: np.ndarray) -> float:
        """``v.M v`` with the fictitious masses."""
        pairs = zip(self.model.batches, self.scaled, strict=True)
        return sum(float(batch.scaled_kinetic(self.state.q, v, scaled)) for batch, scaled in pairs)

    def largest_force(self) -> float:
        """Largest component [N] of contact forces, loads and weights."""
        parts = [self.state.f_gp, self.weight] + ([] if self.f_load is None else [self.f_load])
        return max(float(np.abs(part).max(initial=0.0)) for part in parts)

    def kinetic(self) -> float:
        """Kinetic energy [J] of what is free to move, at the time of the configuration."""
        v = self.velocity()
        if self.constraints.moving:
            v -= self.constraints.given(v)
        return sum(batch.kinetic(self.state.q, v) for batch in self.model.batches)

    def ratio(self) -> float:
        """Solve ratio: largest unbalanced force over the largest force acting, worst formulation."""
        self.forces()
        unbalanced = self.state.f.copy()
        self.constraints.release(unbalanced)
        pushes = np.linalg.norm(self.state.f_gp, axis=1)
        pushes[: self.first_pulled] = 0.0  # there f_gp is the sum of all forces
        if self.particles is not None:
            self.particles.add_pushes(pushes)
        if self.f_load is not None:
            pushes += np.linalg.norm(self.f_load, axis=1)
        gravity = float(np.linalg.norm(self.model.gravity))
        pairs = zip(self.model.batches, self.scaled, strict=True)
        shares = [
            batch.unbalance(self.state.q, self.state.x, unbalanced, pushes, gravity, scaled) for batch, scaled in pairs
        ]
        return max(shares, default=0.0)

    def check(self) -> None:
        """Refuse positions or velocities that are not finite.

        Raises
        ------
        UnstableError
            Names step, time, block and gridpoint.
        """
        state = self.state
        if np.isfinite(state.x).all() and np.isfinite(state.v).all():
            return
        bad = ~np.isfinite(state.x).all(axis=1)
        gp = int(np.argmax(bad)) if bad.any() else 0
        self.unstable(gp, "a value is not finite")

    def unstable(self, gp: int, why: str) -> None:
        """Raise `UnstableError` about gridpoint `gp`."""
        name = self.model.names[self.model.gp_block[gp]]
        raise UnstableError(
            f"step {self.state.step}, t = {self.state.t:.6g} s, dt = {self.dt:.4g} s: {why}; "
            f"worst is gridpoint {gp} of block {name!r}"
        )
