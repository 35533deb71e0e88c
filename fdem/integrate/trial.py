"""Trial: configurations an implicit method tries before one is accepted, over the `System` of forces."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.contact import tangents
from fdem.errors import SceneError
from fdem.integrate.matrices import projector

__all__ = ["Trial"]

Array = Any


class Trial:
    """What implicit methods ask of a system: trial configurations, their forces, and how far they are from balance.

    Parameters
    ----------
    system : System
        Forces, masses and kinematics.
    """

    def __init__(self, system: Any) -> None:
        self.system, self.model, self.state = system, system.model, system.state
        self.constraints = system.constraints
        self.mass: Any = None

    def all_forces(self) -> Array:
        """Forces of the trial with gyroscopic terms and mass-proportional damping (n_dofs,) [N, N m]."""
        system, state = self.system, self.state
        system.current = False
        f = system.forces().copy()
        for batch in self.model.batches:
            batch.gyroscopic(state.q, state.v, f)
        if system.rate is not None:
            f -= self.mass @ (system.rate * state.v)
        return f

    def unbalanced(self) -> Array:
        """Forces of the trial that nothing holds (n_dofs,) [N, N m]."""
        self.system.current = False
        f = self.system.forces().copy()
        self.constraints.release(f)
        return f

    def snapshot(self) -> tuple[Any, ...]:
        """What `back_to` needs."""
        state = self.state
        return state.q.copy(), state.v.copy(), state.t, self.system.dt

    def back_to(self, before: tuple[Any, ...]) -> None:
        """Give up a trial."""
        state = self.state
        state.q[:], state.v[:], state.t, self.system.dt = before
        self._place()
        self.find_contacts()
        self.system.current = False

    def displace(self, before: tuple[Any, ...], d: Array, h: float) -> None:
        """Trial configuration: the increment `d` (n_dofs,) over `h` [s] from `before`; contacts are found there."""
        state = self.state
        state.q[:] = before[0]
        state.t, self.system.dt = before[2] + h, h
        self.displace_further(d)
        self.find_contacts()

    def displace_further(self, d: Array) -> None:
        """Move the trial configuration by `d` (n_dofs,)."""
        for batch in self.model.batches:
            batch.shift(self.state.q, d)
        self._place()
        self.system.current = False

    def _place(self) -> None:
        for batch in self.model.batches:
            batch.place(self.state.q, self.state.x)

    def find_contacts(self) -> bool:
        """Look for contacts at the trial; whether they changed."""
        system, state, changed = self.system, self.state, False
        if system.contacts is not None:
            changed = system.contacts.update(state.x)
        if system.particles is not None:
            changed |= system.particles.update(state.x, state.x_old, state.v, system.dt)
        if changed:
            system.current = False
        return changed

    def contact_state(self) -> bytes:
        """What is open, closed and slipping, to tell when Newton's method goes round in circles."""
        return b"" if self.system.contacts is None else tangents.signature(self.system.contacts)

    def prescribe_increment(self, d: Array, h: float, share: float | None = None) -> None:
        """Give constrained increments their values over the next `h` [s]; `share` of displacements still to come."""
        state, v = self.state, d / h
        self.constraints.prescribe(v, state.q, self.system.q0, state.t + 0.5 * h, h, share)
        d[:] = h * v

    def reference_stiffness(self) -> Any:
        """Diagonal matrix (n_dofs, n_dofs): masses times the squared frequency of their block on all its joints.

        Raises
        ------
        SceneError
            A block that can move touches nothing that could hold it.
        """
        from scipy.sparse import diags

        omega2, owner = self.system.block_frequencies(), self.owners()
        free = projector(self.constraints, len(owner)).diagonal() != 0.0
        loose = np.unique(owner[free & (omega2[owner] == 0.0)])
        if len(loose):
            raise SceneError(f"Static: block {self.model.names[loose[0]]!r} is free: no joint or support can hold it")
        diagonal = self.mass.diagonal() * omega2[owner]
        return diags(np.where(diagonal > 0.0, diagonal, 1.0)).tocsr()

    def owners(self) -> Array:
        """Row in the model of the block of every unknown (n_dofs,)."""
        owner = np.zeros(len(self.state.v), dtype=np.int64)
        for batch in self.model.batches:
            for row, block in enumerate(batch.rows):
                owner[batch.dofs_of(row)] = block
        return owner

    def pushed(self, d: Array) -> Array:
        """Motion (n_gp, 3) of gridpoints by the rates or increments `d` (n_dofs,)."""
        moved = np.zeros_like(self.state.x)
        for batch in self.model.batches:
            batch.push(self.state.q, d, moved)
        return moved

    def relative_motion(self, d: Array) -> float:
        """Largest motion of a gridpoint in the increment `d` over the size of the smallest block."""
        size = float(self.model.size[~self.model.fixed].min(initial=np.inf))
        return _longest(self.pushed(d)) / size

    def residual_ratio(self, r: Array, a: Array | None) -> float:
        """Largest unbalanced force `r` over the largest force acting, inertia among them; worst formulation."""
        system, state = self.system, self.state
        pushes = np.linalg.norm(state.f_gp, axis=1)
        pushes[: system.first_pulled] = 0.0
        if system.particles is not None:
            system.particles.add_pushes(pushes)
        if system.f_load is not None:
            pushes += np.linalg.norm(system.f_load, axis=1)
        pull = float(np.linalg.norm(self.model.gravity))
        if a is not None:
            pull = max(pull, _longest(self.pushed(a)))
        return max((b.unbalance(state.q, state.x, r, pushes, pull, None) for b in self.model.batches), default=0.0)

    def worst_block(self) -> str:
        """The block with the largest acceleration, for messages."""
        f = self.state.f.copy()
        self.constraints.release(f)
        gp = int(np.argmax((self.pushed(self.system.accelerate(f)) ** 2).sum(axis=1)))
        return f"block {self.model.names[self.model.gp_block[gp]]!r}"

    def numerical_loss(self, d: Array, v0: Array, v1: Array, a0: Array, a1: Array) -> float:
        """What the rule of a step takes out of the motion [J]: work of inertia less gain of kinetic energy."""
        d, v, a, gain = (part - self.constraints.given(part) for part in (d, v1 + v0, a0 + a1, v1 - v0))
        return 0.5 * float(d @ (self.mass @ a)) - 0.5 * float(v @ (self.mass @ gain))


def _longest(vectors: Array) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).max(initial=0.0)))
