"""What can be read from a compiled system: positions, motions, stresses, contacts, energies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fdem.contact.carry import present, scatter_between
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
        return self.state.x + self.model.origin

    def displacements(self) -> np.ndarray:
        """Gridpoint displacements (n_gp, 3) [m] since the start or the last reset."""
        return self.state.x - self.x0

    def pushed(self, v: np.ndarray) -> np.ndarray:
        """Gridpoint values (n_gp, 3) of generalised velocities or accelerations."""
        result = np.zeros_like(self.state.x)
        for batch in self.model.batches:
            batch.push(self.state.q, v, result)
        return result

    def velocities(self) -> np.ndarray:
        """Gridpoint velocities (n_gp, 3) [m/s]."""
        return self.pushed(self.velocity)

    def centroids(self) -> np.ndarray:
        """Centroids of all blocks (n_blocks, 3) [m], relative to the model's origin."""
        model, result = self.model, self.model.centroid.copy()
        if model.rigid is not None:
            rows = np.flatnonzero((model.batch_row >= 0) & ~model.zoned)
            result[rows] = self.state.q[model.rigid.coords].reshape(-1, 7)[:, :3]
        if model.deformable is not None:
            centre = self.state.x[model.zones].mean(axis=1)
            volume = self._volumes()
            for axis in range(3):
                weighted = np.bincount(model.zone_block, volume * centre[:, axis], model.n_blocks)
                rows = np.flatnonzero(model.zoned)
                result[rows, axis] = weighted[rows] / np.bincount(model.zone_block, volume, model.n_blocks)[rows]
        return result

    def _volumes(self) -> np.ndarray:
        a, b, c, d = (self.state.x[self.model.zones[:, k]] for k in range(4))
        return np.abs(np.einsum("ni,ni->n", np.cross(b - a, c - a), d - a)) / 6.0

    def block_motion(self, v: np.ndarray, row: int) -> tuple[np.ndarray, np.ndarray]:
        """Translation and rotation (3,), (3,) of block `row` in generalised velocities `v`."""
        model = self.model
        if model.batch_row[row] < 0:
            return np.zeros(3), np.zeros(3)
        if not model.zoned[row]:
            six = v[6 * model.batch_row[row] :][:6]
            return six[:3].copy(), six[3:].copy()
        start, stop = model.gp_range[row]
        mass = model.gp_mass[start:stop]
        speed = v[model.deformable.dofs].reshape(-1, 3)[start:stop]
        mean = mass @ speed / mass.sum()
        arm = self.state.x[start:stop] - mass @ self.state.x[start:stop] / mass.sum()
        inertia = (mass @ (arm * arm).sum(axis=1)) * np.eye(3) - np.einsum("n,ni,nj->ij", mass, arm, arm)
        return mean, np.linalg.solve(inertia, mass @ np.cross(arm, speed - mean))

    def angular_momentum(self, row: int) -> np.ndarray:
        """Angular momentum (3,) about the centroid of block `row` [kg m^2/s]."""
        model, v = self.model, self.velocity
        if model.batch_row[row] < 0:
            return np.zeros(3)
        if not model.zoned[row]:
            return np.asarray(model.rigid.angular_momentum(self.state.q, v)[model.batch_row[row]])
        start, stop = model.gp_range[row]
        momentum = model.deformable.multiply_mass(v[model.deformable.dofs].reshape(-1, 3))[start:stop]
        arm = self.state.x[start:stop] - self.centroids()[row]
        return np.cross(arm, momentum).sum(axis=0)

    def inertia(self, row: int) -> np.ndarray:
        """Moments of inertia (3, 3) of block `row` now [kg m^2]."""
        model = self.model
        if model.zoned[row]:
            zones = model.zones[model.zone_start[row] : model.zone_start[row + 1]]
            corner = self.state.x[zones] - self.centroids()[row]
            mass = model.deformable.zone_mass[model.zone_start[row] : model.zone_start[row + 1]]
            total = corner.sum(axis=1)
            second = np.einsum("n,nki,nkj->ij", mass, corner, corner) + np.einsum("n,ni,nj->ij", mass, total, total)
            second /= 20.0
            return np.trace(second) * np.eye(3) - second
        if model.batch_row[row] >= 0:
            return np.asarray(model.rigid.inertia(self.state.q)[model.batch_row[row]])
        raise UnsupportedError(f"block {model.names[row]!r} is fixed: its inertia takes no part")

    def rotation(self, row: int) -> np.ndarray:
        """Rotation matrix (3, 3) of block `row` from the start."""
        model = self.model
        if model.batch_row[row] < 0:
            return np.eye(3)
        if not model.zoned[row]:
            return np.asarray(model.rigid.rotation(self.state.q)[model.batch_row[row]])
        start, stop = model.gp_range[row]
        mass = model.gp_mass[start:stop, None]
        arms = [p[start:stop] - (mass * p[start:stop]).sum(axis=0) / mass.sum() for p in (model.X, self.state.x)]
        left, _, right = np.linalg.svd(arms[1].T @ (mass * arms[0]))
        return left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right

    def rotation_vector(self, row: int) -> np.ndarray:
        """Accumulated rotation vector (3,) of block `row` [rad]."""
        model = self.model
        if model.batch_row[row] >= 0 and not model.zoned[row]:
            return self.turned[model.batch_row[row]].copy()
        R = self.rotation(row)
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

    def zone_stresses(self) -> np.ndarray:
        """Cauchy stress (m, 6) of all zones [Pa]."""
        if self.model.deformable is None:
            return np.zeros((0, 6))
        return np.asarray(self.model.deformable.zone_stress(self.state.x))

    def _block_mean(self, values: np.ndarray) -> np.ndarray:
        result = np.full((self.model.n_blocks, 6), np.nan)
        if len(values):
            volume, block = self._volumes(), self.model.zone_block
            total = np.bincount(block, volume, self.model.n_blocks)
            rows = np.flatnonzero(self.model.zoned)
            for k in range(6):
                result[rows, k] = np.bincount(block, volume * values[:, k], self.model.n_blocks)[rows] / total[rows]
        return result

    def block_stress(self) -> np.ndarray:
        """Volume mean of the stress (n_blocks, 6) [Pa]; nan for rigid blocks."""
        return self._block_mean(self.zone_stresses())

    def block_strain(self) -> np.ndarray:
        """Volume mean of the strain (n_blocks, 6); nan for rigid blocks."""
        batch = self.model.deformable
        return self._block_mean(np.zeros((0, 6)) if batch is None else batch.zone_strain(self.state.x))

    def contact_table(self) -> dict[str, Any]:
        """Contact points: blocks, joint, normal, gap, area, traction, force, slip, state, position."""
        contacts = self.system.contacts
        self.forces()
        if contacts is None:
            empty: dict[str, Any] = {
                name: np.zeros(0, dtype=np.int32) for name in ("block_a", "block_b", "joint", "state")
            }
            empty |= {name: np.zeros(0) for name in ("gap", "area", "slip")}
            empty |= {name: np.zeros((0, 3)) for name in ("normal", "traction", "force", "position")}
            return empty | {"joint_names": self.model.joint_names}
        table = dict(self.system.contact_table())
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
                moments = (held.rows < 6 * self._n_rigid) & (held.rows % 6 == 3)
                total -= np.einsum("nij,nj->ni", held.projector, f[index])[~moments].sum(axis=0)
                total -= self.state.f_gp[held.static_gp].sum(axis=0)
                if system.f_load is not None:
                    total -= system.f_load[held.static_gp].sum(axis=0)
        for drag, dofs in self.drags:
            if drag is handle:
                total += self._drag_force(drag, dofs)
        return total

    @property
    def _n_rigid(self) -> int:
        return 0 if self.model.rigid is None else (self.model.rigid.dofs.stop - self.model.rigid.dofs.start) // 6

    drags: list[tuple[Any, np.ndarray]]

    def _drag_force(self, drag: Any, dofs: np.ndarray) -> np.ndarray:
        v, total = np.zeros_like(self.state.v), np.zeros(3)
        v[dofs] = self.velocity[dofs]
        for row in range(self.model.n_blocks):
            total -= drag.load.mass * self.model.mass[row] * self.block_motion(v, row)[0]
        return total

    def stored(self) -> dict[str, float]:
        """Entries of the energy balance now [J]."""
        system, state, model = self.system, self.state, self.model
        self.forces()
        contacts = system.contacts
        joint, friction, damping = (0.0, 0.0, 0.0) if contacts is None else present(contacts)
        return {
            "kinetic": float(system.kinetic()),
            "strain": float(sum(b.strain_energy(state.x) for b in model.batches)),
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
