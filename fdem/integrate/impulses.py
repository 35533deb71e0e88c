"""Impulses: hard contact over the `System` of forces, for Contact Dynamics."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.contact import hard
from fdem.integrate.mobility import Mobility

__all__ = ["Impulses"]

Array = Any


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
        state.t += h
        system.dt = h
        system.current = False
        if system.contacts is not None:
            system.contacts.update(state.x)

    def soft_forces(self, mass: Any) -> Array:
        """Forces without contact, with mass-proportional damping (n_dofs,) [N, N m]."""
        system = self.system
        kept = system.mean_contact.copy()
        system.mean_contact[:] = 0.0
        system.current = False
        f = system.forces().copy()
        system.mean_contact[:], system.current = kept, False
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
        contacts = self.system.contacts
        return hard.contact_points(contacts, self.state.x) if contacts is not None and contacts.n_patches else None

    def pair_sizes(self) -> Array:
        """Size of the smaller block of every pair [m]."""
        c = self.system.contacts
        return np.minimum(c.surfaces.size[c.slave], c.surfaces.size[c.master])

    def solver(self, tolerance: float, most: int) -> Any:
        """Solver of contact problems; see `hard.Solver`."""
        return hard.Solver(tolerance, most)

    def problem(self, points: Any, assembler: Any, mobility: Any, free: Array, h: float) -> Any:
        """Contact problem of `points` over a step of `h` [s]; gaps and restitution are left to the caller."""
        mobile = ~self.model.fixed[self.model.gp_block]
        rows = hard.point_rows(points, assembler.placement(), mobile)
        free_rows = mobility.free_rows(rows)
        share = points.area * h
        return hard.Problem(
            rows, free_rows, mobility.matrix, mobility.solve, lambda: mobility.answers(free_rows), free,
            np.zeros(len(points)), points.friction, points.cohesion * share, points.tension * share,
        )  # fmt: skip

    def keep(self, points: Any, impulses: Array, before: Array, problem: Any, h: float) -> None:
        """Keep the mean forces of the step for the tables, and count what contact dissipated."""
        system = self.system
        system.mean_contact[:] = 0.0
        system.hard_table = None
        if problem is None:
            return
        world = np.einsum("nij,ni->nj", points.frame, impulses) / h
        np.add.at(system.mean_contact, points.gp.ravel(), (points.w[:, :, None] * world[:, None, :]).reshape(-1, 3))
        after = problem.rows.times(self.state.v)
        mean = 0.5 * (problem.rows.times(before) + after)
        system.contacts.work[0] -= float((impulses[:, 1:] * mean[:, 1:]).sum())
        system.contacts.work[1] -= float((impulses[:, 0] * mean[:, 0]).sum())
        sliding = np.hypot(after[:, 1], after[:, 2])
        system.hard_table = hard.table(system.contacts, points, impulses / h, sliding)
