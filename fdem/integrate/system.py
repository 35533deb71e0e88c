"""System: the one interface M(q) a = f(t, q, v) that integrators see, over a Model and a State."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from fdem.blocks.bounds import joint_stiffness
from fdem.constraints import Constraints
from fdem.errors import UnstableError
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
        deformable = model.deformable
        self._first_rigid_gp = 0 if deformable is None else deformable.gridpoints.stop
        self._keeps_old = contacts is not None or self._load_old is not None
        self.weight = self._weight()
        self._terms = self._choose_terms()
        self._held = constraints.held() if constraints.moving else None

    def _choose_terms(self) -> tuple[Callable[[], None], ...]:
        """The force terms this scene needs, in order."""
        state = self.state
        terms: list[Callable[[], None]] = []
        if self.contacts is not None:
            terms.append(lambda: self.contacts.forces(state.x, state.x_old, self._real_dt, state.f_gp))
            if self.model.rigid is not None:
                terms.append(lambda: self.model.rigid.pull(state.q, state.f_gp, state.f))
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
        if self.model.rigid is not None:
            self.model.rigid.pull(state.q, total, state.f)
        if self.model.deformable is not None:
            state.f[self.model.deformable.dofs] += total[self.model.deformable.gridpoints].ravel()

    def forces(self) -> np.ndarray:
        """Generalised forces f(t, q, v) of the present configuration [N, N m]."""
        if not self.current:
            # zoned gridpoints share memory with f: only the others are cleared here
            self.state.f_gp[self._first_rigid_gp :].fill(0.0)
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

    def stiffness(self) -> np.ndarray:
        """Contact and bedding stiffness per gridpoint (n_gp,) [N/m], a row-sum bound."""
        model = self.model
        k = self._bedding()
        if self.contacts is not None:
            mobile = ~np.isin(model.gp_block, np.flatnonzero(model.fixed))
            k += self.contacts.potential_k_gp(self.state.x, mobile)
        return k

    def _bedding(self) -> np.ndarray:
        k = np.zeros(len(self.model.X))
        for load in self.loads:
            if isinstance(load, Bedding):
                k[load.gp] += np.linalg.norm(load.matrices, 2, axis=(1, 2))
        return k

    def _springs(self, batch: Any) -> tuple[np.ndarray, ...]:
        """What bounds the frequencies of a batch: gridpoint stiffness, and the joints of rigid blocks."""
        model = self.model
        if batch is not model.rigid or self.contacts is None:
            return (self.stiffness(),)
        place = np.where(model.zoned, -1, model.batch_row)
        centre = self.state.q[batch.coords].reshape(-1, 7)[:, :3]
        rows = self.contacts.stiffness(self.state.x)
        return self._bedding(), joint_stiffness(rows, self.state.x, model.gp_block, ~model.fixed, place, centre)

    def stiffened(self) -> bool:
        """Whether contact stiffness grew by 2 % of its block's largest anywhere, or halved in all, since last asked."""
        k, model = self.stiffness(), self.model
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
        model, result = self.model, np.zeros(self.model.n_blocks)
        for batch, zoned in ((model.rigid, False), (model.deformable, True)):
            if batch is not None:
                rows = np.flatnonzero((model.batch_row >= 0) & (model.zoned == zoned))
                result[rows] = batch.frequency_bound(self.state.q, self.state.x, *self._springs(batch))
        result[model.fixed] = 0.0
        return result

    def dashpot_rate(self) -> float:
        """Bound of the decay rate 2 zeta omega [1/s] that dashpots on faces give a gridpoint."""
        rate = 0.0
        for load in self.loads:
            if isinstance(load, Dashpot):
                strength = np.linalg.norm(load.matrices, 2, axis=(1, 2))
                movable = self.model.gp_mass[load.gp] > 0
                # a rigid block's gridpoints share its mass; 4 covers its rotation
                per_block = np.bincount(self.model.gp_block[load.gp], strength, self.model.n_blocks)
                zoned = self.model.zoned[self.model.gp_block[load.gp]]
                lumped = np.where(zoned, strength, 4.0 * per_block[self.model.gp_block[load.gp]])
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
            Largest factor by which damping makes a spring stiffer: what bounds rigid blocks is close to their true
            frequency, and has no reserve for it (the row sums that bound zones have).
        """
        self.fictitious = True
        q, x, model = self.state.q, self.state.x, self.model
        self.scaled = [b.relaxation_mass(q, x, *self._springs(b)) for b in model.batches]
        self.scaled = [s * swing if b is model.rigid else s for s, b in zip(self.scaled, model.batches, strict=True)]
        if self.contacts is not None and model.rigid is not None:
            self._slow_down_loose_blocks()

    def _slow_down_loose_blocks(self) -> None:
        """A rigid block that touches nothing yet moves as if on its joint: else it falls through what is below it."""
        model, batch = self.model, self.model.rigid
        rows = np.flatnonzero((model.batch_row >= 0) & ~model.zoned)
        loose = batch.frequency_bound(self.state.q, self.state.x, *self._springs(batch)) == 0.0
        kn = max(float(law.props[:, 0].max()) for law in self.contacts.laws)
        joint = kn * model.size[rows[loose]] ** 2 / batch.mass[loose]
        self.scaled[0][loose] = np.maximum(self.scaled[0][loose], joint)

    def scaled_kinetic(self, v: np.ndarray) -> float:
        """``v.M v`` with the fictitious masses."""
        total = 0.0
        for batch, scaled in zip(self.model.batches, self.scaled, strict=True):
            if batch is self.model.rigid:
                six = v[batch.dofs].reshape(-1, 6)
                total += float(np.einsum("n,ni,nij,nj->", scaled, six, batch.generalised_mass(self.state.q), six))
            else:
                total += float(scaled @ (v[batch.dofs].reshape(-1, 3) ** 2).sum(axis=1))
        return total

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
        state, model = self.state, self.model
        unbalanced = state.f.copy()
        self.constraints.release(unbalanced)
        worst = 0.0
        if model.rigid is not None:
            worst = self._rigid_ratio(unbalanced[model.rigid.dofs].reshape(-1, 6))
        if model.deformable is not None:
            batch = model.deformable
            free = np.linalg.norm(unbalanced[batch.dofs].reshape(-1, 3), axis=1)
            scaled = self.scaled[-1]
            if scaled is not None:
                # positions end at their last bits, and so forces: 8 for the sum over the zones of a gridpoint
                free -= 8 * np.finfo(float).eps * np.abs(state.x[batch.gridpoints]).max() * scaled
            left = max(float(free.max()), 0.0)
            inner = np.zeros_like(state.f)
            batch.internal(state.x, inner)
            acting = float(np.linalg.norm(inner[batch.dofs].reshape(-1, 3), axis=1).max())
            weight = float(np.linalg.norm(model.gravity)) * float(batch.gp_mass.max())
            pushed = 0.0 if self.f_load is None else np.linalg.norm(self.f_load[batch.gridpoints], axis=1).max()
            worst = max(worst, _share(left, max(acting, weight, pushed)))
        return worst

    def _rigid_ratio(self, unbalanced: np.ndarray) -> float:
        model = self.model
        rows = np.flatnonzero((model.batch_row >= 0) & ~model.zoned)
        force = np.linalg.norm(unbalanced[:, :3], axis=1)
        moment = np.linalg.norm(unbalanced[:, 3:], axis=1) / model.size[rows]
        pushes = np.linalg.norm(self.state.f_gp, axis=1)
        if self.f_load is not None:
            pushes = pushes + np.linalg.norm(self.f_load, axis=1)
        total = np.add.reduceat(pushes[: model.rigid.gridpoints.stop], model.gp_range[rows, 0])
        acting = np.maximum(total, model.mass[rows] * np.linalg.norm(model.gravity))
        free = ~model.fixed[rows]
        if not free.any():
            return 0.0
        return _share(float(np.maximum(force, moment)[free].max()), float(acting[free].max()))

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


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0 else 0.0 if part == 0 else 1.0
