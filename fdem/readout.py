"""What can be read from a compiled system: positions, motions, stresses, contacts, energies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fdem.contact.carry import present, scatter_between
from fdem.contact.sphere_readout import forces_between, sphere_table
from fdem.errors import UnsupportedError
from fdem.integrate.system import System
from fdem.model import Model
from fdem.results.energy import Energy, Ledger
from fdem.state import State

__all__ = ["Readout"]


class Readout:
    """Quantities of a system by block, gridpoint, zone and contact; base of `Simulation`."""

    system: System
    model: Model
    state: State
    x0: np.ndarray
    centroids0: np.ndarray
    turned: np.ndarray
    ledger: Ledger | None
    compiled: Any

    @property
    def time(self) -> float:
        """Time [s]."""
        return self.state.t

    @property
    def steps(self) -> int:
        """Steps done."""
        return self.state.step

    def forces(self) -> np.ndarray:
        """Generalised forces of the present configuration (n_dofs,)."""
        return self.system.forces()

    @property
    def velocity(self) -> np.ndarray:
        """Generalised velocities at the time of the configuration (n_dofs,)."""
        return self.system.velocity()

    @property
    def acceleration(self) -> np.ndarray:
        """Generalised accelerations M^-1 f (n_dofs,)."""
        return self.system.accelerate(self.system.forces()).copy()

    def positions(self) -> np.ndarray:
        """Gridpoint positions (n_gp, 3) [m]."""
        return self.places() + self.model.origin

    def places(self) -> np.ndarray:
        """Places (n_gp, 3) [m] of gridpoints as material points, relative to the model's origin."""
        x = self.state.x.copy()
        for batch in self.model.batches:
            batch.show(self.state.q, x)
        return x

    def displacements(self) -> np.ndarray:
        """Gridpoint displacements (n_gp, 3) [m] since the start or the last reset."""
        return self.places() - self.x0

    def pushed(self, v: np.ndarray) -> np.ndarray:
        """Gridpoint values (n_gp, 3) of generalised velocities or accelerations."""
        result = np.zeros_like(self.state.x)
        for batch in self.model.batches:
            batch.push(self.state.q, v, result)
        return result

    def velocities(self) -> np.ndarray:
        """Gridpoint velocities (n_gp, 3) [m/s]."""
        return self.pushed(self.velocity)

    def _per_block(self, read: Callable[[Any], np.ndarray], result: np.ndarray) -> np.ndarray:
        """Fill the rows of `result` (n_blocks, ...) with what `read` gets from every batch."""
        for batch in self.model.batches:
            result[batch.rows] = read(batch)
        return result

    def centroids(self) -> np.ndarray:
        """Centroids of all blocks (n_blocks, 3) [m], relative to the model's origin."""
        q, x = self.state.q, self.state.x
        return self._per_block(lambda batch: batch.centres(q, x), self.model.centroid.copy())

    def block_motions(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean translation and rotation (n_blocks, 3) each in generalised velocities `v`; zero for fixed blocks."""
        both = np.zeros((2, self.model.n_blocks, 3))
        for batch in self.model.batches:
            both[:, batch.rows] = batch.motion(self.state.q, v, self.state.x)
        return both[0], both[1]

    def angular_momenta(self) -> np.ndarray:
        """Angular momentum (n_blocks, 3) about the centroids [kg m^2/s]; zero for fixed blocks."""
        q, v, x = self.state.q, self.velocity, self.state.x
        return self._per_block(lambda batch: batch.angular_momentum(q, v, x), np.zeros((self.model.n_blocks, 3)))

    def inertias(self) -> np.ndarray:
        """Moments of inertia (n_blocks, 3, 3) about the centroids now [kg m^2]; nan for fixed blocks."""
        q, x = self.state.q, self.state.x
        return self._per_block(lambda batch: batch.inertia(q, x), np.full((self.model.n_blocks, 3, 3), np.nan))

    def rotations(self) -> np.ndarray:
        """Rotations (n_blocks, 3, 3) from the start."""
        q, x = self.state.q, self.state.x
        return self._per_block(lambda batch: batch.rotation(q, x), np.tile(np.eye(3), (self.model.n_blocks, 1, 1)))

    def rotation_vectors(self) -> np.ndarray:
        """Rotation vectors (n_blocks, 3) [rad]: accumulated, or that of the rotation where a batch accumulates none."""
        result = self.turned.copy()
        for batch in self.model.batches:
            if not batch.turns:
                result[batch.rows] = [_vector(R) for R in batch.rotation(self.state.q, self.state.x)]
        return result

    def zone_stresses(self) -> np.ndarray:
        """Cauchy stress (m, 6) of all zones [Pa]."""
        if self.model.deformable is None:
            return np.zeros((0, 6))
        return np.asarray(self.model.deformable.zone_stress(self.state.x))

    def block_stress(self) -> np.ndarray:
        """Volume mean of the stress (n_blocks, 6) [Pa]; nan for blocks that have none."""
        return self._strained("stresses")

    def block_strain(self) -> np.ndarray:
        """Volume mean of the strain (n_blocks, 6); nan for blocks that have none."""
        return self._strained("strains")

    def _strained(self, name: str) -> np.ndarray:
        result = np.full((self.model.n_blocks, 6), np.nan)
        for batch in self.model.batches:
            if batch.has_strain:
                result[batch.rows] = getattr(batch, name)(self.state.q, self.state.x)
        return result

    def surface_stress(self, triangles: np.ndarray) -> np.ndarray:
        """Stress (n, 6) [Pa] at surface triangles (rows of the model's) without zones; nan where a block has none."""
        model = self.model
        return self._stress_at(model.triangle_block[triangles], model.X[model.triangles[triangles]].mean(axis=1))

    def gridpoint_stress(self) -> np.ndarray:
        """Stress (n_gp, 6) [Pa] at gridpoints without zones; nan at others, and where a block has none."""
        return self._stress_at(self.model.gp_block, self.model.X)

    def _stress_at(self, block: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Stress (n, 6) [Pa] at reference places of the blocks `block` (n,) that have strain but no zones."""
        model, result = self.model, np.full((len(places), 6), np.nan)
        for number, batch in enumerate(model.batches):
            mine = model.batch_index[block] == number
            if batch.has_strain and not batch.in_place and mine.any():
                result[mine] = batch.stress_at(self.state.q, model.batch_row[block[mine]], places[mine])
        return result

    def contact_table(self) -> dict[str, Any]:
        """Contact points: blocks, joint, normal, gap, area, traction, force, slip, state, failure, position."""
        contacts, particles = self.system.contacts, self.system.particles
        self.forces()
        names = ("block_a", "block_b", "joint", "state", "failure", "patch")
        table: dict[str, Any] = {name: np.zeros(0, dtype=np.int32) for name in names}
        table |= {name: np.zeros(0) for name in ("gap", "area", "slip")}
        table |= {name: np.zeros((0, 3)) for name in ("normal", "traction", "force", "position")}
        table["frame"] = np.zeros((0, 3, 3))
        hard = self.system.hard_table
        if hard is not None:
            table = hard()
        elif contacts is not None:
            table = dict(contacts.table(self.state.x))
        if particles is not None and hard is None:
            own = sphere_table(particles)
            n = len(own["joint"])
            # what only laws of faces remember
            own |= {name: np.zeros((n, *rows.shape[1:])) for name, rows in table.items() if name not in own}
            table = {name: np.concatenate([table[name], own[name]]) for name in table}
        table["position"] = table["position"] + self.model.origin
        table["joint_names"] = self.model.joint_names
        return table

    def contact_forces(self) -> np.ndarray:
        """Sum of contact forces on every block (n_blocks, 3) [N]."""
        table, result = self.contact_table(), np.zeros((self.model.n_blocks, 3))
        np.add.at(result, table["block_b"], table["force"])
        np.add.at(result, table["block_a"], -table["force"])
        return result

    def tractions_of(self, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
        """Gridpoints (k,) of other blocks, and forces (k, 3) [N] the blocks `names` exert on them."""
        contacts, total = self.system.contacts, np.zeros_like(self.state.f_gp)
        chosen = np.isin(self.model.names, names)
        if contacts is not None:
            self.forces()
            scatter_between(contacts, chosen, total)
        if self.system.particles is not None:
            self.forces()
            forces_between(self.system.particles, chosen, total)
        total[chosen[self.model.gp_block]] = 0.0
        gp = np.flatnonzero(np.any(total != 0.0, axis=1))
        return gp, total[gp]

    def load_force(self, handle: Any) -> np.ndarray:
        """Total force (3,) [N] of a load, or the reaction of a support on the blocks."""
        system, total = self.system, np.zeros(3)
        f = self.forces()
        for load in system.loads:
            if load.handle is handle:
                total += load.total
        for held in system.constraints.reactions:
            if held.handle is handle:
                index = held.rows[:, None] + np.arange(3)
                total -= np.einsum("nij,nj->ni", held.projector, f[index]).sum(axis=0)
                total -= self.state.f_gp[held.static_gp].sum(axis=0)
                if system.f_load is not None:
                    total -= system.f_load[held.static_gp].sum(axis=0)
        for group in system.constraints.coupled:
            total += group.reaction(handle, f)
        for drag, dofs in self.drags:
            if drag is handle:
                total += self._drag_force(drag, dofs)
        return total

    drags: list[tuple[Any, np.ndarray]]

    def _drag_force(self, drag: Any, dofs: np.ndarray) -> np.ndarray:
        v = np.zeros_like(self.state.v)
        v[dofs] = self.velocity[dofs]
        return -drag.load.mass * (self.model.mass @ self.block_motions(v)[0])

    def stored(self) -> dict[str, float]:
        """Entries of the energy balance now [J]."""
        system, state, model = self.system, self.state, self.model
        self.forces()
        contacts = system.contacts
        joint, friction, damping = (0.0, 0.0, 0.0) if contacts is None else present(contacts)
        if system.particles is not None:
            own = system.particles.present()
            joint, friction, damping = joint + own[0], friction + own[1], damping + own[2]
        return {
            "kinetic": float(system.kinetic()),
            "strain": float(sum(b.strain_energy(state.q, state.x) for b in model.batches)),
            "joint": joint,
            "potential": float(sum(b.potential(model.gravity, state.x, state.q) for b in model.batches)),
            "friction": float(friction),
            "damping": float(damping + system.damped),
            "work": float(system.work + system.pending_work()),
        }

    @property
    def energy(self) -> Energy:
        """The energy balance at this time.

        Raises
        ------
        UnsupportedError
            If the simulation was made with ``energy=False``.
        """
        if self.ledger is None:
            raise UnsupportedError("energy: this simulation was made with energy=False")
        return self.ledger.entry(self.stored())

    def pair_force(self, a: Any, b: Any) -> np.ndarray:
        """Total force (3,) on `b` by `a` [N]."""
        return self._pair(a, b)[0]

    def pair_moment(self, a: Any, b: Any) -> np.ndarray:
        """Total moment (3,) on `b` by `a` about b's centroid [N m]."""
        return self._pair(a, b)[1]

    def _pair(self, a: Any, b: Any) -> tuple[np.ndarray, np.ndarray]:
        select, table = self.compiled.select, self.contact_table()
        first, second = select.blocks(a, "pair"), select.blocks(b, "pair")
        sign = np.where(np.isin(table["block_a"], first) & np.isin(table["block_b"], second), 1.0, 0.0)
        sign -= np.isin(table["block_b"], first) & np.isin(table["block_a"], second)
        force = sign[:, None] * table["force"]
        weight = self.model.volume[second]
        centre = weight @ (self.centroids()[second] + self.model.origin) / weight.sum()
        return force.sum(axis=0), np.cross(table["position"] - centre, force).sum(axis=0)

    def describe(self) -> str:
        """What was compiled, what was left out and why, the step and what limits it."""
        from fdem.description import describe

        return describe(self)

    def mesh(self) -> Any:
        """Everything as one `pyvista.UnstructuredGrid`."""
        from fdem.results.datasets import mesh

        return mesh(self)

    def contacts(self) -> Any:
        """Contact points as `pyvista.PolyData`."""
        from fdem.results.datasets import contacts

        return contacts(self)

    def plot(self, path: str | Path, scalars: str = "displacement", warp: float | str = 1.0, **options: Any) -> Path:
        """Write an image with no display (options: `fdem.results.plot.plot`)."""
        from fdem.results.plot import plot

        return plot(self, path, scalars, warp, **options)


def _vector(R: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) [rad] of a rotation matrix, its angle at most pi."""
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, np.trace(R) - 1.0)
    if sine < 1e-9:
        if angle < 1.0:
            return 0.5 * axis
        half = 0.5 * (R + np.eye(3))
        column = half[:, int(np.argmax(np.diag(half)))]
        return np.pi * column / np.linalg.norm(column)
    return angle / sine * axis
