"""Trial: configurations an implicit method tries before one is accepted, over the `System` of forces."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.contact import tangents
from fdem.contact.wear import refuse_leaps
from fdem.errors import SceneError
from fdem.integrate.matrices import Assembler, projector

__all__ = ["Trial"]

Array = Any

ROUND_OFF = 8 * np.finfo(float).eps  # of the largest coordinate: what positions and the gaps between them end at


class Trial:
    """What implicit methods ask of a system: trial configurations, their forces, and how far they are from balance.

    Parameters
    ----------
    system : System
        Forces, masses and kinematics.

    Attributes
    ----------
    d : (n_dofs,) array
        Increment of the unknowns from the last accepted configuration to the trial.
    assembler : Assembler
        Matrices at the trial.
    """

    def __init__(self, system: Any) -> None:
        self.system, self.model, self.state = system, system.model, system.state
        self.constraints, self.assembler = system.constraints, Assembler(system)
        self.n = len(self.state.v)
        self.d = np.zeros(self.n)
        self._turners = [batch for batch in self.model.batches if batch.turns]
        self.turned = [np.zeros((len(batch.rows), 3)) for batch in self._turners]
        self._signature: Any = b""
        spin = np.zeros(0, np.int64) if system.particles is None else system.particles.particles.spin
        self._turning = np.flatnonzero(spin >= 0)
        self._spin = spin[self._turning][:, None] + np.arange(3)

    # forces

    def plain_forces(self) -> Array:
        """Forces of the trial (n_dofs,) [N, N m]."""
        self.system.current = False
        return self.system.forces().copy()

    def all_forces(self, plain: Array) -> Array:
        """`plain` forces with gyroscopic terms and mass-proportional damping (n_dofs,) [N, N m]."""
        system, state, f = self.system, self.state, plain.copy()
        for batch in self.model.batches:
            batch.gyroscopic(state.q, state.v, f)
        if system.rate is not None:
            f -= self.assembler.mass() @ (system.rate * state.v)
        return f

    def released(self, f: Array) -> Array:
        """What nothing holds of the forces `f`, in place."""
        self.constraints.release(f)
        return f

    # trial configurations

    def begin(self) -> None:
        """Accept the present configuration; its forces are known."""
        self.system.forces()
        self.system.commit()
        state = self.state
        self._before = state.q.copy(), state.v.copy(), state.t, self.system.dt

    def back(self) -> None:
        """Give up a trial."""
        state = self.state
        state.q[:], state.v[:], state.t, self.system.dt = self._before
        self.d[:] = 0.0
        self._place()
        self.find_contacts()

    def displace(self, d: Array, h: float) -> None:
        """Trial configuration at the increment `d` (n_dofs,) over `h` [s]; contacts are found there."""
        self.state.t, self.system.dt = self._before[2] + h, h
        self.d[:] = d
        self._place()
        self.find_contacts()

    def displace_further(self, change: Array) -> None:
        """Move the trial configuration by `change` (n_dofs,)."""
        for batch in self.model.batches:
            batch.compose(self.d, change)
        self._place()

    def _place(self) -> None:
        state, particles = self.state, self.system.particles
        state.q[:] = self._before[0]
        for batch in self.model.batches:
            batch.shift(state.q, self.d)
            batch.place(state.q, state.x)
        if particles is not None:
            particles.turn[self._turning] = self.d[self._spin]
        self.system.current = False

    def accept(self) -> float:
        """The trial stands; return the longest motion of a gridpoint in it [m].

        What it turned is kept for `Simulation`, prescribed motion for the work it does.
        """
        for batch, turned in zip(self._turners, self.turned, strict=True):
            turned += batch.turned(self._before[0], self.state.q, self.d)
        self.system.keep_motion(self.d)
        longest = _longest(self.pushed(self.d))
        self.d[:] = 0.0
        return longest

    def take_turns(self) -> list[Any]:
        """Rotation vectors since last asked, of the batches that turn."""
        result, self.turned = self.turned, [np.zeros_like(turned) for turned in self.turned]
        return result

    def find_contacts(self) -> bool:
        """Look for contacts at the trial; whether they changed."""
        system, state, changed = self.system, self.state, False
        if system.contacts is not None:
            changed = bool(system.contacts.update(state.x))
        if system.particles is not None:
            count = system.particles.n_detections
            system.particles.update(state.x, state.x_old, state.v, 0.0)
            changed |= system.particles.n_detections > count
        if changed:
            system.current = False
        return changed

    def refuse_leaps(self) -> None:
        """Refuse a step in which blocks went through each other.

        Raises
        ------
        OverlapError
            Names the pair.
        """
        if self.system.contacts is not None:
            refuse_leaps(self.system.contacts, self.state.x_old, self.state.x)

    def prescribe(self, d: Array, h: float, share: float | None = None) -> None:
        """Give constrained increments `d` their values over the next `h` [s]; `share` of displacements to come."""
        state, v = self.state, d / h
        self.constraints.prescribe(v, state.q, self.system.q0, state.t + 0.5 * h, h, share)
        d[:] = h * v

    def end_velocity(self, d: Array, h: float) -> Array:
        """Velocities (n_dofs,) whose prescribed part is that at the end of a step by `d` in `h` [s]."""
        end = d / h
        for motion in self.constraints.motions:
            end[motion.dofs] = self.constraints.velocity(motion, self.state.t)
        return end

    # how far from balance

    def contact_state(self) -> bytes:
        """What is open, closed and slipping, to tell when Newton's method goes round in circles."""
        return b"" if self.system.contacts is None else tangents.signature(self.system.contacts)

    def owners(self) -> Array:
        """Row in the model of the block of every unknown (n_dofs,)."""
        owner = np.zeros(self.n, dtype=np.int64)
        for batch in self.model.batches:
            for row, block in enumerate(batch.rows):
                owner[batch.dofs_of(row)] = block
        return owner

    def reference_stiffness(self) -> Array:
        """Stiffness (n_dofs,) of every unknown: its mass times the squared frequency of its block on all its joints.

        Raises
        ------
        SceneError
            A block that can move touches nothing that could hold it.
        """
        omega2, owner = self.system.block_frequencies(), self.owners()
        free = projector(self.constraints, self.n).diagonal() != 0.0
        loose = np.unique(owner[free & (omega2[owner] == 0.0)])
        if len(loose):
            raise SceneError(f"Static: block {self.model.names[loose[0]]!r} is free: no joint or support can hold it")
        diagonal = self.assembler.mass().diagonal() * omega2[owner]
        return np.where(diagonal > 0.0, diagonal, 1.0)

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

    def round_off(self, a: Array | None) -> float:
        """Residual ratio that the last bits of positions make of the stiffest gridpoint's force."""
        force = ROUND_OFF * float(np.abs(self.state.x).max(initial=0.0)) * self.assembler.stiffest
        r = np.zeros(self.n)
        for group in self.assembler.groups:
            r[group[:, :3]] = force / np.sqrt(3.0)
        return self.residual_ratio(r, a)

    def worst(self, r: Array) -> str:
        """Block that the unbalanced forces `r` (n_dofs,) accelerate most, and its largest contact; for messages."""
        gp = int(np.argmax((self.pushed(self.system.accelerate(r)) ** 2).sum(axis=1)))
        block = int(self.model.gp_block[gp])
        pair = "" if self.system.contacts is None else tangents.culprit(self.system.contacts, block)
        return f"worst is block {self.model.names[block]!r}{pair}"

    def kinetic(self) -> float:
        """Kinetic energy [J] of what is free to move."""
        v = self.state.v - self.constraints.given(self.state.v)
        return sum(batch.kinetic(self.state.q, v) for batch in self.model.batches)

    def work_on_free(self, f: Array) -> float:
        """Work [J] of forces `f` (n_dofs,) on the increment of the trial, prescribed motion left out."""
        return float((self.d - self.constraints.given(self.d)) @ f)


def _longest(vectors: Array) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).max(initial=0.0)))
