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

    def velocity_rows(self, points: Any, assembler: Any) -> Any:
        """``J`` (3 n, n_dofs) of the relative velocities of contact points in their frames, scipy CSR."""
        from scipy.sparse import coo_matrix

        n = len(points)
        values = points.frame[:, :, None, :] * points.w[:, None, :, None]
        rows = np.broadcast_to((3 * np.arange(n)[:, None] + np.arange(3))[:, :, None, None], values.shape)
        columns = np.broadcast_to((3 * points.gp[:, :, None] + np.arange(3))[:, None], values.shape)
        mobile = ~self.model.fixed[self.model.gp_block[points.gp]]
        mobile = np.broadcast_to(mobile[:, None, :, None], values.shape) & (values != 0.0)
        entries = values[mobile], (rows[mobile], columns[mobile])
        return (coo_matrix(entries, shape=(3 * n, self.state.x.size)).tocsr() @ assembler.placement()).tocsr()

    def solve(self, *arguments: Any) -> tuple[int, float]:
        """Gauss-Seidel over the contact points; see `hard.solve`."""
        return hard.solve(*arguments)

    def keep(self, points: Any, impulses: Array, before: Array, rows: Any, h: float) -> None:
        """Keep the mean forces of the step for the tables, and count what contact dissipated."""
        system = self.system
        system.mean_contact[:] = 0.0
        system.hard_table = None
        if points is None or not len(points):
            return
        world = np.einsum("nij,ni->nj", points.frame, impulses) / h
        np.add.at(system.mean_contact, points.gp.ravel(), (points.w[:, :, None] * world[:, None, :]).reshape(-1, 3))
        mean = 0.5 * (rows @ (before + self.state.v)).reshape(-1, 3)
        system.contacts.work[0] -= float((impulses[:, 1:] * mean[:, 1:]).sum())
        system.contacts.work[1] -= float((impulses[:, 0] * mean[:, 0]).sum())
        sliding = np.hypot(*(rows @ self.state.v).reshape(-1, 3)[:, 1:].T)
        system.hard_table = hard.table(system.contacts, points, impulses / h, sliding)
