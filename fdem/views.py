"""What ``sim[target]`` gives: read-only results of blocks, gridpoints, loads and supports."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from fdem.errors import SolveError, UnsupportedError

if TYPE_CHECKING:
    from fdem.simulation import Simulation

__all__ = ["BlockView", "GridpointView", "LoadView"]


def _readonly(values: Any) -> np.ndarray:
    result = np.array(values, dtype=np.float64)
    result.setflags(write=False)
    return result


class BlockView:
    """Results of one block, or of several stacked along the first axis.

    Parameters
    ----------
    sim : Simulation
        The simulation.
    rows : list of int
        Model rows of the blocks.
    single : bool
        One block was asked for: arrays lose their first axis.
    """

    def __init__(self, sim: Simulation, rows: list[int], single: bool) -> None:
        self._sim, self._rows, self._single = sim, rows, single

    def _stack(self, values: Any) -> np.ndarray:
        values = np.asarray(values, dtype=np.float64)
        return _readonly(values[0] if self._single else values)

    def _per_block(self, function: Any) -> np.ndarray:
        return self._stack([function(row) for row in self._rows])

    def _only(self, what: str, has: Callable[[int], bool]) -> None:
        model = self._sim.model
        for row in self._rows:
            if not has(row):
                batch = model.batch_of(row)
                kind = "fixed" if batch is None else batch.label
                raise UnsupportedError(f"block {model.names[row]!r} is {kind} and has no {what}")

    def _oriented(self, row: int) -> bool:
        batch = self._sim.model.batch_of(row)
        return batch is None or getattr(batch, "oriented", True)

    def _zoned(self, what: str) -> None:
        self._only(what, lambda row: bool(self._sim.model.zoned[row]))

    def _strained(self, what: str) -> None:
        self._only(what, lambda row: getattr(self._sim.model.batch_of(row), "has_strain", False))

    def _moving(self, what: str) -> None:
        self._only(what, lambda row: self._sim.model.batch_of(row) is not None)

    @property
    def mass(self) -> Any:
        """Mass [kg]."""
        values = self._sim.model.mass[self._rows]
        return float(values[0]) if self._single else _readonly(values)

    @property
    def position(self) -> np.ndarray:
        """Centroid (3,) [m]."""
        return self._stack(self._sim.centroids()[self._rows] + self._sim.model.origin)

    @property
    def displacement(self) -> np.ndarray:
        """Displacement of the centroid (3,) [m] since the start or the last reset."""
        return self._stack((self._sim.centroids() - self._sim.centroids0)[self._rows])

    @property
    def velocity(self) -> np.ndarray:
        """Velocity of the centroid (3,) [m/s]; zoned blocks: momentum over mass."""
        return self._stack(self._sim.block_motions(self._sim.velocity)[0][self._rows])

    @property
    def acceleration(self) -> np.ndarray:
        """Acceleration of the centroid (3,) [m/s^2]."""
        return self._stack(self._sim.block_motions(self._sim.acceleration)[0][self._rows])

    @property
    def angular_velocity(self) -> np.ndarray:
        """Angular velocity (3,) [rad/s], global axes; zoned blocks: of the mean rotation."""
        return self._stack(self._sim.block_motions(self._sim.velocity)[1][self._rows])

    @property
    def angular_momentum(self) -> np.ndarray:
        """Angular momentum about the centroid (3,) [kg m^2/s]."""
        return self._stack(self._sim.angular_momenta()[self._rows])

    @property
    def inertia(self) -> np.ndarray:
        """Moments of inertia (3, 3) about the centroid now [kg m^2]."""
        self._moving("inertia")
        return self._stack(self._sim.inertias()[self._rows])

    @property
    def rotation(self) -> np.ndarray:
        """Rotation matrix (3, 3) from the start; zoned blocks: of the mean deformation; spheres have none."""
        self._only("orientation (Rigid(orientation=True) keeps it)", self._oriented)
        return self._stack(self._sim.rotations()[self._rows])

    @property
    def rotation_vector(self) -> np.ndarray:
        """Accumulated rotation vector (3,) [rad]: the integral of the angular velocity."""
        return self._stack(self._sim.rotation_vectors()[self._rows])

    @property
    def stress(self) -> np.ndarray:
        """Volume mean of the Cauchy stress (6,) [Pa], xx yy zz yz zx xy."""
        self._strained("stress")
        return self._stack(self._sim.block_stress()[self._rows])

    @property
    def strain(self) -> np.ndarray:
        """Volume mean of the strain (6,) [-], engineering shear."""
        self._strained("strain")
        return self._stack(self._sim.block_strain()[self._rows])

    @property
    def contact_force(self) -> np.ndarray:
        """Sum (3,) of what the contacts do to the block [N]."""
        return self._stack(self._sim.contact_forces()[self._rows])

    def _gridpoints(self, values: np.ndarray) -> np.ndarray:
        return _readonly(np.concatenate([values[slice(*self._sim.model.gp_range[row])] for row in self._rows]))

    @property
    def gridpoints(self) -> np.ndarray:
        """Positions (n, 3) of the gridpoints [m]."""
        return self._gridpoints(self._sim.positions())

    @property
    def gridpoint_displacement(self) -> np.ndarray:
        """Displacements (n, 3) of the gridpoints [m]."""
        return self._gridpoints(self._sim.displacements())

    @property
    def gridpoint_mass(self) -> np.ndarray:
        """Masses (n,) of the gridpoints [kg]."""
        self._zoned("gridpoint_mass")
        return self._gridpoints(self._sim.model.gp_mass)

    def _zone_rows(self) -> np.ndarray:
        start = self._sim.model.zone_start
        return np.concatenate([np.arange(start[row], start[row + 1]) for row in self._rows])

    @property
    def zones(self) -> np.ndarray:
        """Zones (m, 4): rows of `gridpoints`."""
        self._zoned("zones")
        model, parts, first = self._sim.model, [], 0
        for row in self._rows:
            start, stop = model.gp_range[row]
            parts.append(model.zones[model.zone_start[row] : model.zone_start[row + 1]] - start + first)
            first += stop - start
        return np.vstack(parts)

    @property
    def zone_stress(self) -> np.ndarray:
        """Cauchy stress (m, 6) of the zones [Pa]."""
        self._zoned("zone_stress")
        return _readonly(self._sim.zone_stresses()[self._zone_rows()])

    @property
    def zone_strain(self) -> np.ndarray:
        """Strain (m, 6) of the zones [-]."""
        self._zoned("zone_strain")
        return _readonly(self._sim.model.deformable.zone_strain(self._sim.state.x)[self._zone_rows()])

    @property
    def zone_rotation(self) -> np.ndarray:
        """Rotation vectors (m, 3) of the zones [rad]."""
        self._zoned("zone_rotation")
        return _readonly(self._sim.model.deformable.zone_rotation(self._sim.state.x)[self._zone_rows()])

    def _batch(self, row: int, what: str) -> tuple[Any, int]:
        """Formulation of a block and its row there."""
        model = self._sim.model
        self._moving(what)
        return model.batch_of(row), int(model.batch_row[row])

    @property
    def generalised_displacement(self) -> np.ndarray:
        """The theory's u: translation [m] and accumulated rotation [rad] (6,), and strain (12,); zoned (3 n,) [m]."""
        sim, moved = self._sim, self._sim.centroids() - self._sim.centroids0
        gridpoints, turned = sim.displacements(), sim.rotation_vectors()

        def one(row: int) -> np.ndarray:
            batch, place = self._batch(row, "unknowns")
            return np.asarray(batch.generalised_displacement(place, sim.state.q, gridpoints, moved[row], turned[row]))

        return self._per_block(one)

    @property
    def generalised_force(self) -> np.ndarray:
        """The theory's f: force [N] and moment [N m] (6,), with what drives the strain [J] (12,); zoned (3 n,) [N]."""
        return self._per_block(lambda row: self._in_theory(row, self._sim.forces()))

    def _in_theory(self, row: int, f: np.ndarray) -> np.ndarray:
        batch, place = self._batch(row, "unknowns")
        own, theory = f[batch.dofs_of(place)], batch.theory(place, self._sim.state.q)
        return np.array(own if theory is None else theory.T @ own)

    @property
    def generalised_mass(self) -> np.ndarray:
        """The theory's M: (6, 6), with uniform strain (12, 12), zoned (3 n, 3 n)."""

        def one(row: int) -> np.ndarray:
            batch, place = self._batch(row, "unknowns")
            q = self._sim.state.q
            mass, theory = batch.mass_of(place, q), batch.theory(place, q)
            return np.asarray(mass if theory is None else theory.T @ mass @ theory)

        return self._per_block(one)

    @property
    def residual(self) -> np.ndarray:
        """M a - f of the free unknowns, with `acceleration` as the integrator takes it [N, N m]."""

        def one(row: int) -> np.ndarray:
            batch, place = self._batch(row, "unknowns")
            dofs, sim = batch.dofs_of(place), self._sim
            left = np.zeros(len(sim.state.v))
            left[dofs] = batch.mass_of(place, sim.state.q) @ sim.acceleration[dofs] - sim.forces()[dofs]
            sim.system.constraints.release(left)
            return self._in_theory(row, left)

        return self._per_block(one)


class GridpointView:
    """Results of one gridpoint: ``position``, ``displacement``, ``velocity``, ``acceleration`` (3,)."""

    def __init__(self, sim: Simulation, gridpoint: int) -> None:
        self._sim, self.gridpoint = sim, gridpoint

    @property
    def position(self) -> np.ndarray:
        """Position (3,) [m]."""
        return _readonly(self._sim.positions()[self.gridpoint])

    @property
    def displacement(self) -> np.ndarray:
        """Displacement (3,) [m] since the start or the last reset."""
        return _readonly(self._sim.displacements()[self.gridpoint])

    @property
    def velocity(self) -> np.ndarray:
        """Velocity (3,) [m/s]."""
        return _readonly(self._sim.velocities()[self.gridpoint])

    @property
    def acceleration(self) -> np.ndarray:
        """Acceleration (3,) [m/s^2] (its change by rotation of a rigid block left out)."""
        return _readonly(self._sim.pushed(self._sim.acceleration)[self.gridpoint])


class LoadView:
    """A load or support of a running simulation."""

    def __init__(self, sim: Simulation, handle: Any) -> None:
        self._sim, self._handle = sim, handle

    @property
    def factor(self) -> Any:
        """Factor of the load; can be set between runs."""
        return self._handle.factor

    @factor.setter
    def factor(self, value: Any) -> None:
        if not callable(value):
            known = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
            if not known or not np.isfinite(value):
                raise SolveError(f"load {self._handle.load!r}: factor = {value!r} is not a finite number")
        self._handle.factor = value
        self._sim.system.current = False

    @property
    def force(self) -> np.ndarray:
        """Total force (3,) [N] the load exerts now; of a support: its reaction on the blocks."""
        return _readonly(self._sim.load_force(self._handle))
