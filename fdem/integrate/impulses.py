"""Impulses: hard contact over the `System` of forces, for Contact Dynamics."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fdem.contact import hard
from fdem.contact.hard_spheres import sphere_points
from fdem.integrate.mobility import Mobility

__all__ = ["Impulses"]

Array = Any

OUT = 1e-2  # of a block's size that it is pushed out by in a step at most
ROUGH, MOST = 1e-3, 60  # accuracy and iterations: what is left is pushed out in the next steps


class Impulses:
    """Contacts that are impulses, not springs.

    Parameters
    ----------
    system : System
        Its penalty contacts are left out from now on.
    """

    def __init__(self, system: Any) -> None:
        self.system, self.model, self.state = system, system.model, system.state
        system.harden()
        system.hard_table = partial(hard.table, hard.NONE, np.zeros((0, 3)), np.zeros(0))
        self._turners = [batch for batch in self.model.batches if batch.turns]
        self.turned = [np.zeros((len(batch.rows), 3)) for batch in self._turners]

    def take_turns(self) -> list[Any]:
        """Rotation vectors since last asked, of the batches that turn."""
        result, self.turned = self.turned, [np.zeros_like(turned) for turned in self.turned]
        return result

    def snapshot(self) -> tuple[Any, ...]:
        """What `back_to` needs."""
        return self.state.q.copy(), self.state.v.copy(), self.state.t, [turned.copy() for turned in self.turned]

    def back_to(self, before: tuple[Any, ...]) -> None:
        """Give up a step."""
        self.state.q[:], self.state.v[:], self.state.t, self.turned = before
        self.drift(0.0)

    def commit_loads(self) -> None:
        """Work of loads up to here, positions as those of the last commit."""
        self.system.forces()
        self.system.commit_loads()

    def drift(self, h: float) -> None:
        """Move the configuration by `h` [s] at the present velocities; look for contacts."""
        system, state = self.system, self.state
        for batch in self.model.batches:
            batch.advance(state.q, state.v, h)
            batch.place(state.q, state.x)
        for batch, turned in zip(self._turners, self.turned, strict=True):
            turned += batch.turn(state.q, state.v, h)
        state.t += h
        system.current = False
        if system.contacts is not None:
            system.contacts.update(state.x)
        if system.particles is not None:
            system.particles.update(state.x, state.x_old, state.v, h)

    def soft_forces(self, mass: Any) -> Array:
        """Forces without contact, with mass-proportional damping (n_dofs,) [N, N m]."""
        system = self.system
        parts = system.mean_contact, system.mean_moment
        kept = [part.copy() for part in parts]
        for part in parts:
            part[:] = 0.0
        system.current = False
        f = system.forces().copy()
        for part, values in zip(parts, kept, strict=True):
            part[:] = values
        system.current = False
        if system.rate is not None:
            f -= mass @ (system.rate * self.state.v)
        return f

    def mobility(self, assembler: Any, mass: Any, h: float) -> Any:
        """How velocities answer to impulses in the present configuration; `h` [s] is what stiffness acts over."""
        return Mobility(assembler, mass, assembler.soft(), h)

    def prescribe_velocity(self, v: Array, h: float) -> None:
        """Give constrained velocities their values."""
        self.system.constraints.prescribe(v, self.state.q, self.system.q0, self.state.t, h)

    def points(self) -> Any:
        """Points of hard contact in the present configuration; None where nothing can touch."""
        contacts, particles, points = self.system.contacts, self.system.particles, hard.NONE
        if contacts is not None and contacts.n_patches:
            points = hard.contact_points(contacts, self.state.x)
        if particles is not None:
            points = points.and_(sphere_points(particles, self.state.x))
        return points if len(points) else None

    def names(self, points: Any, i: int) -> str:
        """Names of the two blocks at point i, for messages."""
        a, b = sorted((int(points.slave[i]), int(points.master[i])))
        return f"{self.model.names[a]!r} and {self.model.names[b]!r}"

    def solver(self, tolerance: float, most: int) -> Any:
        """Solver of contact problems; see `hard.Solver`."""
        return hard.Solver(tolerance, most)

    def problem(self, points: Any, assembler: Any, mobility: Any, free: Array, h: float) -> Any:
        """Contact problem of `points` over a step of `h` [s]; gaps and restitution are left to the caller."""
        rows = hard.point_rows(points, assembler.placement())
        free_rows = mobility.free_rows(rows)
        friction, cohesion, tension, _ = points.law.T.copy()
        share = points.area * h
        return hard.Problem(
            rows, free_rows, mobility.matrix, mobility.mass, mobility.solve, lambda: mobility.answers(free_rows), free,
            np.zeros(len(points)), friction, cohesion * share, tension * share,
        )  # fmt: skip

    def largest_speed(self) -> float:
        """Largest velocity of a gridpoint [m/s]."""
        speed = np.zeros_like(self.state.x)
        for batch in self.model.batches:
            batch.push(self.state.q, self.state.v, speed)
        return float(np.sqrt(np.einsum("ni,ni->n", speed, speed).max(initial=0.0)))

    def push_out(self, problem: Any, gap: Array, size: Array, f: Array) -> None:
        """Move blocks apart where gaps (n,) [m] are negative, by least displacements, `OUT` of the sizes (n,) at most.

        What it does against the other forces `f` comes off the dissipation: blocks went too deep before.
        """
        system, none = self.system, np.zeros(len(gap))
        apart = replace(
            problem, free=np.zeros_like(problem.free), bias=np.maximum(gap, -OUT * size), friction=none, cohesion=none,
            tension=none,
        )  # fmt: skip
        _, d, _ = hard.Solver(ROUGH, MOST).solve(apart, np.zeros((len(gap), 3)))
        q, v, batches = self.state.q, self.state.v, self.model.batches
        gained = -sum(batch.kinetic(q, v) for batch in batches)  # where inertia turns against what spins
        for batch in batches:
            batch.shift(q, d)
            batch.place(q, self.state.x)
        system.current = False
        gained += sum(batch.kinetic(q, v) for batch in batches)
        self._lost()[1] += float(f @ d) - gained

    def _lost(self) -> Array:
        """Work of friction and of normal impulses [J], where the tables look for it."""
        system = self.system
        work: Array = (system.particles if system.contacts is None else system.contacts).work
        return work

    def keep(self, points: Any, impulses: Array, before: Array, problem: Any, f: Array, h: float) -> None:
        """Keep the mean forces of the step for the tables and the work of what is prescribed; count dissipation.

        `f` (n_dofs,) are the forces besides contact.
        """
        system, mean = self.system, f if problem is None else f + problem.rows.onto(impulses / h, len(f))
        system.dt = h
        system.keep_motion(0.5 * h * (before + self.state.v), mean)
        system.mean_contact[:], system.mean_moment[:] = 0.0, 0.0
        system.hard_table = partial(hard.table, hard.NONE, np.zeros((0, 3)), np.zeros(0))
        if problem is None:
            return
        world = np.einsum("nij,ni->nj", points.frame, impulses) / h
        shares, at = points.w[:, :, None] * world[:, None, :], points.gp.ravel()
        for axis in range(3):
            system.mean_contact[:, axis] = np.bincount(at, shares[:, :, axis].ravel(), len(system.mean_contact))
        for side, sign in ((0, 1.0), (1, -1.0)):
            turns = np.flatnonzero(points.spin[:, side] >= 0)
            if not len(turns):
                continue
            moment = sign * np.cross(points.arm[turns, side], world[turns])
            np.add.at(system.mean_moment, points.spin[turns, side][:, None] + np.arange(3), moment)
        after = problem.rows.times(self.state.v)
        mean = 0.5 * (problem.rows.times(before) + after)
        lost = self._lost()
        lost[0] -= float((impulses[:, 1:] * mean[:, 1:]).sum())
        lost[1] -= float((impulses[:, 0] * mean[:, 0]).sum())
        if points.law[:, 1:3].any():
            hard.wear(system.contacts, points, impulses / h, after, problem.speed)
        self._tell(points, impulses / h, np.hypot(after[:, 1], after[:, 2]))

    def _tell(self, points: Any, force: Array, sliding: Array) -> None:
        self._force, self._sliding = force, sliding
        self.system.hard_table = partial(hard.table, points, force, sliding)

    def kept(self, points: Any) -> dict[str, Array]:
        """Arrays of the points and forces of the last step, for `restore`."""
        system = self.system
        own = {"force": self._force, "sliding": self._sliding, "moment": system.mean_moment}
        return {f"point_{name}": value for name, value in vars(points).items()} | own | {"contact": system.mean_contact}

    def restore(self, arrays: dict[str, Array]) -> Any:
        """Points of the step that was saved."""
        head = "point_"
        points = hard.Points(**{key[len(head) :]: value for key, value in arrays.items() if key.startswith(head)})
        self.system.mean_contact[:], self.system.mean_moment[:] = arrays["contact"], arrays["moment"]
        self._tell(points, arrays["force"], arrays["sliding"])
        return points
