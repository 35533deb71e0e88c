"""System: the one interface M(q) a = f(t, q, v) that integrators see, over a Model and a State."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from fdem.blocks.bounds import Springs
from fdem.constraints import Constraints
from fdem.contact import hard
from fdem.errors import SceneError, UnstableError
from fdem.loads import Bedding, Dashpot, Load
from fdem.model import Model
from fdem.state import State

__all__ = ["System"]

MOTION = 2e-3  # of the smallest block's size per step: corners meet with next to no stiffness, which then grows fast


class System:
    """Forces, masses and kinematics of a compiled scene; knows no formulation and no joint law.

    Parameters
    ----------
    model, state : Model, State
        What compile made.
    contacts : Contacts or None
        The contact layer.
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
        constraints: Constraints,
        loads: list[Load],
        alpha: np.ndarray | None,
        energy: bool = True,
    ) -> None:
        self.model, self.state, self.contacts = model, state, contacts
        self.constraints, self.loads, self.alpha = constraints, loads, alpha
        self.rate: Any = alpha  # all mass-proportional damping, that of the integrator included [1/s]
        self.lag = 0.0  # time by which v is behind q: 0 before the first step, then half a step [s]
        self.dt = 0.0  # the last step [s]
        self.fictitious = False  # masses are scaled: time and velocities have no meaning of their own
        self.hard = False  # contacts are impulses, not springs
        self.work = 0.0
        self.damped = 0.0
        self.scaled: list[Any] = [None] * len(model.batches)
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
        self._first_pulled = max((b.gridpoints.stop for b in model.batches if b.in_place), default=0)
        self._keeps_old = contacts is not None or self._load_old is not None
        self.weight = self._weight()
        self._terms = self._choose_terms()
        self._held = constraints.held() if constraints.moving else None

    def _choose_terms(self) -> tuple[Callable[[], None], ...]:
        """The force terms this scene needs, in order."""
        state = self.state
        terms: list[Callable[[], None]] = []
        if self.hard:
            terms.append(lambda: np.add(state.f_gp, self._hard_force, out=state.f_gp))
        elif self.contacts is not None:
            terms.append(lambda: self.contacts.forces(state.x, state.x_old, self._real_dt, state.f_gp))
        if self.contacts is not None:
            for batch in self.model.batches:
                if not batch.in_place:
                    terms.append(partial(batch.pull, state.q, state.f_gp, state.f))
        for batch in self.model.batches:
            if batch.has_internal:
                terms.append(partial(batch.internal, state.x, state.f))
        terms.append(self._keep_elastic)
        if self.loads:
            terms.append(self._add_loads)
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

    def forces(self) -> np.ndarray:
        """Generalised forces f(t, q, v) of the present configuration [N, N m]."""
        if not self.current:
            # gridpoints whose positions are unknowns share memory with f: only the others are cleared here
            self.state.f_gp[self._first_pulled :].fill(0.0)
            np.copyto(self.state.f, self.weight)
            for term in self._terms:
                term()
            self.current = True
        return self.state.f

    def accelerate(self, f: np.ndarray) -> np.ndarray:
        """Accelerations M^-1 f with the constrained part set to zero."""
        for batch, scaled in zip(self.model.batches, self.scaled, strict=True):
            batch.accelerate(self.state.q, f, self.a, scaled)
        self.constraints.release(self.a)
        return self.a

    def prescribe(self, dt: float) -> None:
        """Give constrained velocities their values in the middle of the step of length `dt` [s]."""
        self.constraints.prescribe(self.state.v, self.state.q, self.q0, self.state.t + 0.5 * dt, dt)

    def commit(self) -> None:
        """Accept the forces of the present configuration: memory of contacts, work of loads."""
        self.work += self.pending_work()
        if self._load_old is not None:
            self._load_old[:] = self.f_load
        if self._reaction_old is not None:
            self._reaction_old[:] = self.state.f
        if self.elastic is not None:
            self.elastic, self.elastic_old = self.elastic_old, self.elastic
        if self.contacts is not None:
            self.contacts.commit()
        if self._keeps_old:
            self.state.x_old[:] = self.state.x

    def pending_work(self) -> float:
        """Work [J] of loads and prescribed motion over the last step, by the trapezoidal rule."""
        work = 0.0
        if self._load_old is not None and self.state.step > 0:
            moved = self.state.x - self.state.x_old
            work += 0.5 * float(np.vdot(self._load_old + self.f_load, moved))
        if self._reaction_old is not None and self._held is not None and self.state.step > 0:
            held = self._held
            work -= 0.5 * self.dt * float((self._reaction_old + self.state.f)[held] @ self.state.v[held])
        return work

    def advance(self, dt: float) -> None:
        """Move the configuration by `dt` [s] with the present velocities; look for contacts if due."""
        state = self.state
        for batch in self.model.batches:
            batch.advance(state.q, state.v, dt)
            batch.place(state.q, state.x)
        state.t += dt
        state.step += 1
        self.dt = dt
        self.current = False
        if self.contacts is not None and self.contacts.update(state.x):
            self.stale = True

    def velocity(self) -> np.ndarray:
        """Velocities at the time of the configuration, not half a step behind (n_dofs,)."""
        if self.lag == 0.0:
            return self.state.v.copy()
        self.forces()
        self.accelerate(self.state.f)
        if self.rate is None or (self.fictitious and self.rate is self.alpha):
            v = self.state.v + self.lag * self.a
        else:
            half = 0.5 * self.lag * self.rate
            v = ((1.0 - half) * self.state.v + self.lag * self.a) / (1.0 + half)
        if self._held is not None:
            v[self._held] = self.state.v[self._held]
        return v

    # ------------------------------------------------------------------ implicit steps

    def all_forces(self) -> np.ndarray:
        """Forces of the trial with gyroscopic terms and mass-proportional damping (n_dofs,) [N, N m]."""
        self.current = False
        f, state = self.forces(), self.state
        for batch in self.model.batches:
            batch.gyroscopic(state.q, state.v, f)
        if self.rate is not None:
            f -= self.mass_times(self.rate * state.v)
        return f

    def mass_times(self, v: np.ndarray) -> np.ndarray:
        """``M v`` (n_dofs,)."""
        out = np.zeros_like(v)
        for batch in self.model.batches:
            batch.add_momentum(self.state.q, v, out)
        return out

    def snapshot(self) -> tuple[Any, ...]:
        """What `back_to` needs."""
        state = self.state
        return state.q.copy(), state.v.copy(), state.t, self.dt

    def back_to(self, before: tuple[Any, ...]) -> None:
        """Give up a trial."""
        state = self.state
        state.q[:], state.v[:], state.t, self.dt = before
        self._place()
        self.find_contacts()
        self.current = False

    def displace(self, before: tuple[Any, ...], d: np.ndarray, h: float) -> None:
        """Trial configuration: the increment `d` (n_dofs,) over `h` [s] from `before`; contacts are found there."""
        state = self.state
        state.q[:] = before[0]
        state.t, self.dt = before[2] + h, h
        self.displace_further(d)
        self.find_contacts()

    def displace_further(self, d: np.ndarray) -> None:
        """Move the trial configuration by `d` (n_dofs,)."""
        for batch in self.model.batches:
            batch.shift(self.state.q, d)
        self._place()
        self.current = False

    def _place(self) -> None:
        for batch in self.model.batches:
            batch.place(self.state.q, self.state.x)

    def find_contacts(self) -> bool:
        """Look for contacts at the trial; whether they changed."""
        if self.contacts is None or not self.contacts.update(self.state.x):
            return False
        self.current = False
        return True

    def contact_state(self) -> bytes:
        """What is open, closed and slipping, to tell when Newton's method goes round in circles."""
        return b"" if self.contacts is None else self.contacts.signature()

    def prescribe_increment(self, d: np.ndarray, h: float, share: float | None = None) -> None:
        """Give constrained increments their values over the next `h` [s]; `share` of displacements still to come."""
        v = self.state.v.copy()
        self.constraints.prescribe(v, self.state.q, self.q0, self.state.t + 0.5 * h, h, share)
        held = self.constraints.held()
        d[held] = h * v[held]
        if len(self.constraints.oblique_rows):
            self.constraints._project(d)

    def unbalanced(self) -> np.ndarray:
        """Forces of the trial that nothing holds (n_dofs,) [N, N m]."""
        self.current = False
        f = self.forces().copy()
        self.constraints.release(f)
        return f

    def reference_stiffness(self) -> Any:
        """Diagonal matrix (n_dofs, n_dofs): masses times the squared frequency of their block on all its joints.

        Raises
        ------
        SceneError
            A block that can move has no mass, or touches nothing that could hold it.
        """
        from scipy.sparse import diags

        omega2, free = self.block_frequencies(), np.ones(len(self.state.v), dtype=bool)
        free[self.constraints.held()] = False
        diagonal = np.zeros(len(free))
        for batch in self.model.batches:
            owner = batch.dof_rows()
            loose = np.unique(owner[free[batch.dofs] & (omega2[owner] == 0.0)])
            if len(loose):
                raise SceneError(
                    f"Static: block {self.model.names[loose[0]]!r} is free: no joint or support can hold it"
                )
            diagonal[batch.dofs] = batch.mass_diagonal(self.state.q) * omega2[owner]
        return diags(np.where(diagonal > 0.0, diagonal, 1.0)).tocsr()

    def relative_motion(self, d: np.ndarray) -> float:
        """Largest motion of a gridpoint in the increment `d` over the size of the smallest block."""
        moved = np.zeros_like(self.state.x)
        for batch in self.model.batches:
            batch.push(self.state.q, d, moved)
        size = float(self.model.size[~self.model.fixed].min(initial=np.inf))
        return float(np.sqrt((moved**2).sum(axis=1).max(initial=0.0))) / size

    def residual_ratio(self, r: np.ndarray, mass: Any, a: np.ndarray | None) -> float:
        """Largest unbalanced force `r` over the largest force acting, inertia among them; worst formulation."""
        state = self.state
        pushes = np.linalg.norm(state.f_gp, axis=1)
        pushes[: self._first_pulled] = 0.0
        if self.f_load is not None:
            pushes += np.linalg.norm(self.f_load, axis=1)
        speedup = np.zeros_like(state.x)
        for batch in self.model.batches if a is not None else ():
            batch.push(state.q, a, speedup)
        pull = max(float(np.linalg.norm(self.model.gravity)), float(np.sqrt((speedup**2).sum(axis=1).max(initial=0.0))))
        return max((b.unbalance(state.x, r, pushes, pull, None) for b in self.model.batches), default=0.0)

    def worst_block(self) -> str:
        """The block with the largest unbalanced force, for messages."""
        f = self.state.f.copy()
        self.constraints.release(f)
        push = np.zeros_like(self.state.x)
        self.accelerate(f)
        for batch in self.model.batches:
            batch.push(self.state.q, self.a, push)
        gp = int(np.argmax((push**2).sum(axis=1)))
        return f"block {self.model.names[self.model.gp_block[gp]]!r}"

    def numerical_loss(self, d: np.ndarray, v0: np.ndarray, v1: np.ndarray, a0: np.ndarray, a1: np.ndarray) -> float:
        """What the rule of a step takes out of the motion [J]: work of the inertia forces less gain of kinetic energy."""
        free = np.ones(len(d), dtype=bool)
        free[self.constraints.held()] = False
        work = 0.5 * float((d * self.mass_times(a0 + a1))[free].sum())
        return work - 0.5 * float(((v1 + v0) * self.mass_times(v1 - v0))[free].sum())

    # ------------------------------------------------------------------ hard contact

    def harden(self) -> None:
        """Leave the forces of penalty contacts out; impulses over the last step take their place."""
        self.hard, self._hard_force = True, np.zeros_like(self.state.f_gp)
        self._hard_points: tuple[Any, np.ndarray] | None = None
        self._terms = self._choose_terms()
        self.current = False

    def commit_loads(self) -> None:
        """Work of loads up to here, positions as those of the last commit."""
        self.forces()
        self.work += self.pending_work()
        if self._load_old is not None:
            self._load_old[:] = self.f_load
        self.state.x_old[:] = self.state.x

    def drift(self, h: float) -> None:
        """Move the configuration by `h` [s] at the present velocities; look for contacts."""
        state = self.state
        for batch in self.model.batches:
            batch.advance(state.q, state.v, h)
            batch.place(state.q, state.x)
        state.t += h
        self.dt = h
        self.current = False
        if self.contacts is not None:
            self.contacts.update(state.x)

    def soft_forces(self) -> np.ndarray:
        """Forces without contact, with mass-proportional damping (n_dofs,) [N, N m]."""
        kept, self._hard_force = self._hard_force, np.zeros_like(self._hard_force)
        self.current = False
        f = self.forces().copy()
        self._hard_force, self.current = kept, False
        if self.rate is not None:
            f -= self.mass_times(self.rate * self.state.v)
        return f

    def mobility(self, assembler: Any, h: float) -> Any:
        """How velocities answer to impulses in the present configuration; `h` [s] is what stiffness acts over."""
        from fdem.integrate.mobility import Mobility

        return Mobility(assembler, assembler.mass(), assembler.soft(), h)

    def prescribe_velocity(self, v: np.ndarray, h: float) -> None:
        """Give constrained velocities their values."""
        self.constraints.prescribe(v, self.state.q, self.q0, self.state.t, h)

    def hard_points(self) -> Any:
        """Points of hard contact in the present configuration; None where nothing can touch."""
        if self.contacts is None or not self.contacts.n_patches:
            return None
        return hard.contact_points(self.contacts, self.state.x)

    def pair_sizes(self) -> np.ndarray:
        """Size of the smaller block of every pair [m]."""
        size = self.contacts.surfaces.size
        return np.minimum(size[self.contacts.slave], size[self.contacts.master])

    def point_rows(self, points: Any, assembler: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Relative velocities of contact points over the unknowns: start, unknowns, values (entries, 3)."""
        mobile = ~self.model.fixed[self.model.gp_block]
        return hard.point_rows(points, assembler.placement(), mobile)

    def impulse_problem(self, *parts: Any) -> Any:
        """Contact problem; see `hard.problem`."""
        return hard.problem(*parts)

    def impulse_solver(self, tolerance: float, most: int) -> Any:
        """Solver of contact problems."""
        return hard.Solver(tolerance, most)

    def after_impulses(self, points: Any, impulses: np.ndarray, before: np.ndarray, problem: Any, h: float) -> None:
        """Keep the mean forces of the step for the tables, and count what contact dissipated."""
        self._hard_force[:] = 0.0
        self._hard_points = None
        if points is None or not len(points):
            return
        world = np.einsum("nij,ni->nj", points.frame, impulses) / h
        shares = points.w[:, :, None] * world[:, None, :]
        np.add.at(self._hard_force, points.gp.ravel(), shares.reshape(-1, 3))
        after = problem.relative(self.state.v)
        after[:, 0] -= problem.bias
        mean = 0.5 * (problem.relative(before) + after)
        mean[:, 0] -= 0.5 * problem.bias
        self.contacts.work[0] -= float((impulses[:, 1:] * mean[:, 1:]).sum())
        self.contacts.work[1] -= float((impulses[:, 0] * mean[:, 0]).sum())
        sliding = np.hypot(after[:, 1], after[:, 2])
        self._hard_points = points, hard.table(self.contacts, points, impulses / h, sliding)

    def contact_table(self) -> dict[str, Any]:
        """Contact points as a dict of arrays: of the last forces, or of the last impulses."""
        if self.hard:
            return self._hard_points[1] if self._hard_points is not None else self.contacts.table(self.state.x)
        table: dict[str, Any] = self.contacts.table(self.state.x)
        return table

    def springs(self) -> Springs:
        """Contacts and bedded faces, as the bounds of frequencies see them."""
        bedding = np.zeros(len(self.model.X))
        for load in self.loads:
            if isinstance(load, Bedding):
                bedding[load.gp] += np.linalg.norm(load.matrices, 2, axis=(1, 2))
        return Springs(self.state.x, bedding, self.contacts, self.model.gp_block, ~self.model.fixed)

    def stiffened(self) -> bool:
        """Whether contact stiffness grew by 2 % of its block's largest anywhere, or halved in all, since last asked."""
        k, model = self.springs().k_gp, self.model
        if self._k_used is not None:
            largest = np.zeros(model.n_blocks)
            np.maximum.at(largest, model.gp_block, self._k_used)
            if (k <= self._k_used + 0.02 * largest[model.gp_block]).all() and k.sum() >= 0.5 * self._k_used.sum():
                return False
        self._k_used = k
        return True

    def unseen_motion(self) -> float:
        """Longest step [s] in which no block moves so far that a stiff contact goes unseen; infinite at rest."""
        speed = np.zeros_like(self.state.x)
        for batch in self.model.batches:
            batch.push(self.state.q, self.state.v, speed)
        fastest = float(np.sqrt(np.einsum("ni,ni->n", speed, speed).max(initial=0.0)))
        size = float(self.model.size[~self.model.fixed].min(initial=np.inf))
        return MOTION * size / fastest if fastest > 0.0 else np.inf

    def block_frequencies(self) -> np.ndarray:
        """Upper bounds of the squared frequency (n_blocks,) [1/s^2]; 0 for fixed blocks."""
        springs, result = self.springs(), np.zeros(self.model.n_blocks)
        for batch in self.model.batches:
            result[batch.rows] = batch.step_bound(self.state.q, springs)
        result[self.model.fixed] = 0.0
        return result

    def dashpot_rate(self) -> float:
        """Bound of the decay rate 2 zeta omega [1/s] that dashpots on faces give a gridpoint."""
        rate = 0.0
        for load in self.loads:
            if isinstance(load, Dashpot):
                strength = np.linalg.norm(load.matrices, 2, axis=(1, 2))
                movable = self.model.gp_mass[load.gp] > 0
                # the gridpoints of a block that moves as a whole share its mass; 4 covers its rotation
                owner = self.model.gp_block[load.gp]
                per_block = np.bincount(owner, strength, self.model.n_blocks)
                lumped = np.where(load.gp < self._first_pulled, strength, 4.0 * per_block[owner])
                rate = max(rate, float((lumped[movable] / self.model.gp_mass[load.gp][movable]).max(initial=0.0)))
        return rate

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
        if self._held is not None:
            v[self._held] = 0.0
        return sum(batch.kinetic(self.state.q, v) for batch in self.model.batches)

    def ratio(self) -> float:
        """Solve ratio: largest unbalanced force over the largest force acting, worst formulation."""
        self.forces()
        unbalanced = self.state.f.copy()
        self.constraints.release(unbalanced)
        pushes = np.linalg.norm(self.state.f_gp, axis=1)
        pushes[: self._first_pulled] = 0.0  # there f_gp is the sum of all forces
        if self.f_load is not None:
            pushes += np.linalg.norm(self.f_load, axis=1)
        gravity = float(np.linalg.norm(self.model.gravity))
        pairs = zip(self.model.batches, self.scaled, strict=True)
        shares = [batch.unbalance(self.state.x, unbalanced, pushes, gravity, scaled) for batch, scaled in pairs]
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
