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

LOOSE = 1e-9  # of the stiffness of a block on all its joints: what resists less does not resist
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
        """Stiffness (n_dofs,) of every unknown: its mass times the squared frequency of its block on all its joints."""
        diagonal = self.assembler.mass().diagonal() * self.system.block_frequencies()[self.owners()]
        return np.where(diagonal > 0.0, diagonal, 1.0)

    def round_owners(self) -> Array:
        """Which unknowns (n_dofs,) belong to blocks with spheres, whose contacts are no patches."""
        particles = self.system.particles
        mine = np.zeros(self.model.n_blocks, dtype=bool)
        if particles is not None:
            mine[particles.particles.block] = True
        return mine[self.owners()]

    def refuse_free(self) -> None:
        """Refuse blocks that nothing can hold.

        Raises
        ------
        SceneError
            No chain of contacts leads from a block to one that is held; names it.
        """
        model, holds = self.model, self.model.fixed.copy()
        free = projector(self.constraints, self.n)
        moved = np.ones(self.n) - free.diagonal()
        holds[self.owners()[moved > 1e-12]] = True
        for gp in self.system.bedded():
            holds[model.gp_block[gp]] = True
        pairs = [np.zeros((0, 2), int)]
        if self.system.contacts is not None:
            pairs.append(self.system.contacts.pairs[np.unique(self.system.contacts.patches.pair)])
        if self.system.particles is not None:
            pairs.append(self.system.particles.touching())
        links = np.concatenate(pairs)
        while len(links):
            ends = holds[links]
            news = links[ends[:, 0] != ends[:, 1]]
            if not len(news):
                break
            holds[news] = True
        if not holds.all():
            name = model.names[int(np.argmin(holds))]
            raise SceneError(f"Static: block {name!r} is free: no joint or support can hold it")

    def loose(self) -> list[str]:
        """Names of blocks that can move as a whole without resistance at the trial, all others held."""
        from scipy.sparse import coo_matrix

        state, n_blocks = self.state, self.model.n_blocks
        owner, columns = self.owners(), []
        for k in range(6):
            v, unit = np.zeros(self.n), np.zeros((n_blocks, 6))
            unit[:, k] = 1.0
            for batch in self.model.batches:
                batch.launch(state.q, state.x, v, unit[batch.rows, :3], unit[batch.rows, 3:])
            columns.append(v)
        values = np.concatenate(columns)
        place = np.tile(np.arange(self.n), 6), np.concatenate([6 * owner + k for k in range(6)])
        R = projector(self.constraints, self.n) @ coo_matrix((values, place), shape=(self.n, 6 * n_blocks)).tocsc()
        K = self.assembler.effective(0.0, 0.0, 0.0)
        D = self.reference_stiffness()
        found = []
        for block in np.flatnonzero(~self.model.fixed):
            own = R[:, 6 * block : 6 * block + 6]
            stiff, size = (own.T @ (K @ own)).toarray(), (own.T @ own.multiply(D[:, None])).toarray()
            values, vectors = np.linalg.eigh(size)
            kept = vectors[:, values > 1e-9 * values.max(initial=0.0)]
            kept = kept / np.sqrt(values[values > 1e-9 * values.max(initial=0.0)])
            if kept.size and np.linalg.eigvalsh(kept.T @ (stiff + stiff.T) @ kept)[0] < LOOSE:
                found.append(self.model.names[block])
        return found

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

    def round_off(self, r: Array, ratio: float) -> float:
        """Residual ratio that the last bits of positions make of the stiffest gridpoint's force; `r` makes `ratio`."""
        force = ROUND_OFF * float(np.abs(self.state.x).max(initial=0.0)) * self.assembler.stiffest
        return force * ratio / max([_longest(r[group[:, :3]]) for group in self.assembler.groups])

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
