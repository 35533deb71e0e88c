"""Zoned blocks: constant-strain tetrahedra, the gridpoints are the unknowns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial
from typing import Any

import numpy as np

from fdem.blocks import entries, recovery
from fdem.blocks.assembly import coupling_norms, elastic_stiffness
from fdem.blocks.bounds import Springs, share
from fdem.blocks.masses import InertiaCorrection, block_moments, lumped_moments, row_sum_masses, voronoi_masses
from fdem.blocks.zoneforces import LargeStrain, SmallStrain, rotation_vectors, terms_of
from fdem.blocks.zonetangents import ZonePattern
from fdem.errors import MeshError, SceneError
from fdem.kernels import stiffness
from fdem.kernels import zones as kernels

__all__ = ["ZonedBlocks"]

Array = Any

_SWEEPS = 12  # power sweeps of the frequency bound: 0.75 of the true step becomes about 0.95
_MASS_RULES = ("voronoi", "row-sum", "inertia-matched")


class ZonedBlocks(entries.Additive):
    """All zoned blocks of a model.

    Parameters
    ----------
    X : (n, 3) array
        Reference positions of the batch's gridpoints [m].
    zones : (m, 4) int array
        Global gridpoint numbers of the zones, sorted by block, positively oriented.
    zone_start, gp_start : (n_blocks + 1,) int arrays
        Zones and (global) gridpoints of every block.
    density : (n_blocks,) or (m,) array
        [kg/m^3], per block or per zone.
    lam, mu : (n_blocks,) arrays
        Lame constants [Pa].
    large : (n_blocks,) bool array
        True: St. Venant-Kirchhoff, exact at any rotation; False: constant stiffness in a frame that rotates
        with the block, for small strain.
    mass : sequence of str
        ``"voronoi"``, ``"row-sum"`` or ``"inertia-matched"`` for every block.
    dofs, coords, gridpoints : slice
        The batch's share of v, of q and of x.
    stress0 : (m, 6) array, optional
        In-situ stress in the reference configuration (2nd Piola-Kirchhoff), xx yy zz yz zx xy [Pa].
    threads : int, optional
        Threads for the internal force; the bits do not depend on it.

    Attributes
    ----------
    gp_mass : (n,) array
        Lumped masses [kg].
    gravity_mass : (n,) array
        Row sums of the mass matrix [kg]: what gravity acts on; `gp_mass` unless inertia-matched.
    zone_volume, zone_mass, block_mass : (m,), (m,), (n_blocks,) arrays
        Exact volumes and masses [m^3, kg].
    inertia_ratio : (n_blocks,) array
        Polar moment of the mass matrix about the exact centroid over the exact one [-].
    centre_shift : (n_blocks,) array
        Distance of the gridpoint masses' centre from the exact one over the cube root of the volume [-].
    limiting_gridpoint : (n_blocks,) int array
        Global gridpoint that limits the step of each block, after `frequency_bound`.

    Notes
    -----
    Gradients and volumes are closed forms (scikit-fem takes 20-40 us a zone to give the same numbers, and 1 s to be
    imported); where a stiffness matrix is needed, scikit-fem assembles it.
    """

    label = "zoned"
    has_internal = True
    in_place = True
    turns = False
    coupled = False
    has_strain = True

    def __init__(
        self,
        X: Array,
        zones: Array,
        zone_start: Array,
        gp_start: Array,
        density: Array,
        lam: Array,
        mu: Array,
        large: Array,
        mass: Sequence[str],
        dofs: slice,
        coords: slice,
        gridpoints: slice,
        stress0: Array | None = None,
        threads: int = 1,
    ) -> None:
        self.dofs, self.coords, self.gridpoints = dofs, coords, gridpoints
        self.threads = max(1, int(threads or 1))
        self._pool: ThreadPoolExecutor | None = None
        n = gridpoints.stop - gridpoints.start
        # a copy: the caller's array may be the positions, and those move
        self.X = np.array(X if len(X) == n else X[gridpoints], dtype=np.float64, order="C")
        self.zone_start = np.ascontiguousarray(zone_start, dtype=np.int32)
        self._start = np.ascontiguousarray(np.asarray(gp_start) - gridpoints.start, dtype=np.int32)
        self._nodes = np.ascontiguousarray(np.asarray(zones) - gridpoints.start, dtype=np.int32)
        self.lam, self.mu = np.asarray(lam, dtype=np.float64), np.asarray(mu, dtype=np.float64)
        self.large = np.asarray(large, dtype=bool)
        self.n_blocks = self.large.size
        self.rows = np.arange(self.n_blocks)
        self.zone_block = np.repeat(np.arange(self.n_blocks), np.diff(self.zone_start))
        m = self._nodes.shape[0]
        self.gradients, self.zone_volume = np.empty((m, 9)), np.empty(m)
        kernels.shape_gradients(self.X, self._nodes, self.gradients, self.zone_volume)
        if not np.all(self.zone_volume > 0.0):
            zone = int(np.argmin(self.zone_volume > 0.0))
            block = int(self.zone_block[zone])
            local = zone - int(self.zone_start[block])
            volume = self.zone_volume[zone]
            raise MeshError(f"zoned block {block}: zone {local} has volume {volume:.3g} m^3, must be > 0")
        self.block_volume = np.add.reduceat(self.zone_volume, self.zone_start[:-1])
        self._set_masses(np.asarray(density, dtype=np.float64), list(mass))
        self._coupling: tuple[Array, Array, Array, Array] | None = None
        self._terms: list[LargeStrain | SmallStrain] = []
        self.set_initial_stress(stress0)

    def set_initial_stress(self, stress0: Array | None) -> None:
        """Choose the in-situ stress of the reference configuration (m, 6) [Pa]; None: stress-free."""
        self.stress0 = None if stress0 is None else np.ascontiguousarray(stress0, dtype=np.float64)
        self._terms = terms_of(self, np.ones(self.n_blocks, dtype=bool))

    def _set_masses(self, density: Array, rules: list[str]) -> None:
        for k, rule in enumerate(rules):
            if rule not in _MASS_RULES:
                raise SceneError(f"zoned block {k}: mass={rule!r}; allowed: {', '.join(map(repr, _MASS_RULES))}")
        per_zone = density if density.size == self.zone_volume.size and density.size != self.n_blocks else None
        zone_density = density[self.zone_block] if per_zone is None else per_zone
        zone_mass = self.zone_mass = zone_density * self.zone_volume
        n = self.X.shape[0]
        chosen = np.array(rules)
        self.gp_mass = row_sum_masses(self._nodes, zone_mass, n)
        voronoi = np.flatnonzero(chosen == "voronoi")
        if voronoi.size:
            masses = voronoi_masses(self.X, self._nodes, zone_density, self._start, self.zone_start, voronoi)
            rows = np.isin(np.repeat(np.arange(self.n_blocks), np.diff(self._start)), voronoi)
            self.gp_mass[rows] = masses[rows]
        centre = 0.25 * self.X[self._nodes].sum(axis=1) * zone_mass[:, None]
        self.block_mass = np.add.reduceat(zone_mass, self.zone_start[:-1])
        self.centroid = np.add.reduceat(centre, self.zone_start[:-1], axis=0) / self.block_mass[:, None]
        exact = block_moments(self.X, self._nodes, zone_mass, self.zone_start, self.centroid)
        lumped = lumped_moments(self.X, self.gp_mass, self._start, self.centroid)
        self._inverse_mass = np.repeat(1.0 / self.gp_mass, 3)  # flat: a product of (n, 3) and (n, 1) is much slower
        self._motion = np.empty(3 * n)
        matched = np.flatnonzero(chosen == "inertia-matched")
        self._matched = matched
        self._correction: InertiaCorrection | None = None
        self.gravity_mass = self.gp_mass
        if matched.size:
            self._correction = InertiaCorrection.build(self.X, self.gp_mass, self._start, self.centroid, exact, matched)
            lumped[matched] = exact[matched]
            self.gravity_mass = self.multiply_mass(np.ones((n, 3)))[:, 0].copy()
        second = np.array([1, 2, 3])
        self.inertia_ratio = lumped[:, second, second].sum(axis=1) / exact[:, second, second].sum(axis=1)
        shift = np.linalg.norm(lumped[:, 0, 1:] / lumped[:, :1, 0], axis=1)
        self.centre_shift = shift / np.cbrt(self.block_volume)

    # positions: the gridpoints are the unknowns, q and x share memory

    def start(self, q: Array) -> None:
        """Nothing: positions are the configuration already."""

    def launch(self, q: Array, x: Array, v: Array, velocity: Array, spin: Array) -> None:
        """Write velocities of rigid motion about the centres of the gridpoint masses into `v`."""
        arm, owner = recovery.arms(self, x[self.gridpoints])
        v[self.dofs] = (velocity[owner] + np.cross(spin[owner], arm)).ravel()

    def place(self, q: Array, x: Array) -> None:
        """Write positions (n_gp, 3) of this batch's gridpoints: q itself."""
        target, source = x[self.gridpoints], q[self.coords]
        if not np.may_share_memory(target, source):
            target[:] = source.reshape(-1, 3)

    def show(self, q: Array, x: Array) -> None:
        """Nothing: gridpoints are material points."""

    def push(self, q: Array, v: Array, xdot: Array) -> None:
        """Write velocities of gridpoints (n_gp, 3) [m/s]."""
        xdot[self.gridpoints] = v[self.dofs].reshape(-1, 3)

    def pull(self, q: Array, f_gp: Array, f: Array) -> None:
        """Add gridpoint forces (n_gp, 3) to generalised forces (n_dofs,) [N]."""
        f[self.dofs] += f_gp[self.gridpoints].ravel()

    def advance(self, q: Array, v: Array, dt: float, scaled: Array | None = None) -> None:
        """``q += dt v``."""
        np.multiply(v[self.dofs], dt, out=self._motion)
        q[self.coords] += self._motion

    def fit(self, row: int, q: Array, x: Array) -> None:
        """Nothing: the positions are the unknowns."""

    # forces

    def internal(self, q: Array, x: Array, f: Array, terms: list[Any] | None = None) -> None:
        """Subtract internal forces (n_dofs,) [N] at the positions x (n_gp, 3) [m]."""
        local, force = x[self.gridpoints], f[self.dofs].reshape(-1, 3)
        for term in self._terms if terms is None else terms:
            term.subtract_force(local, force)

    def graded(self, level: Array) -> list[tuple[int, Callable[..., None]]]:
        """`internal` of the blocks of every `level` (n_blocks,)."""
        return [(int(k), partial(self.internal, terms=terms_of(self, level == k))) for k in np.unique(level)]

    def weight(self, g: Array, f: Array) -> None:
        """Add weights M g for the gravity g (3,) [m/s^2]."""
        f[self.dofs].reshape(-1, 3)[:] += self.gravity_mass[:, None] * np.asarray(g)

    def accelerate(self, q: Array, f: Array, a: Array, scaled: Array | None = None) -> None:
        """Write ``a = M^-1 f``; `scaled` (n,) replaces the masses [kg] (relaxation)."""
        force, result = f[self.dofs], a[self.dofs]
        if scaled is not None:
            np.divide(force.reshape(-1, 3), scaled[:, None], out=result.reshape(-1, 3))
            return
        np.multiply(force, self._inverse_mass, out=result)
        if self._correction is not None:
            self._correction.add_inverse(force.reshape(-1, 3), result.reshape(-1, 3))

    def multiply_mass(self, v: Array) -> Array:
        """Return M v (n, 3) for velocities or accelerations v (n, 3) of this batch."""
        result = self.gp_mass[:, None] * v
        if self._correction is not None:
            self._correction.add_mass(v, result)
        return result

    # energies

    def resist(self, q: Array, f: Array, v: Array, share: float, out: Array) -> None:
        """Write a `share` of every force, against the velocity, into `out`."""
        out[self.dofs] = share * np.abs(f[self.dofs]) * np.sign(v[self.dofs])

    def kinetic(self, q: Array, v: Array) -> float:
        """Kinetic energy [J]."""
        velocity = v[self.dofs].reshape(-1, 3)
        return float(0.5 * np.sum(velocity * self.multiply_mass(velocity)))

    def strain_energy(self, q: Array, x: Array) -> float:
        """Strain energy [J]; with in-situ stress, counted from the reference configuration."""
        local = x[self.gridpoints]
        return float(sum(term.energy(local) for term in self._terms))

    def potential(self, g: Array, x: Array, q: Array) -> float:
        """Potential energy of gravity ``-sum m g.x`` [J]."""
        return -float(np.sum(self.gravity_mass * (x[self.gridpoints] @ np.asarray(g, dtype=np.float64))))

    # stable step

    def _couple(self) -> tuple[Array, Array, Array, Array]:
        """Norms of the stiffness blocks at the reference configuration, as a sparse symmetric pattern."""
        if self._coupling is None:
            lam, mu = self.lam[self.zone_block], self.mu[self.zone_block]
            n = self.X.shape[0]
            self._coupling = coupling_norms(self._nodes, self.gradients, self.zone_volume, lam, mu, n)
        return self._coupling

    def frequency_bound(self, q: Array, x: Array, k_gp: Array) -> Array:
        """Upper bounds of omega^2 per block (n_blocks,) [1/s^2], contact stiffness k_gp (n_gp,) [N/m] included."""
        n, pattern = self.X.shape[0], self._couple()
        bound, worst = np.empty(self.n_blocks), np.empty(self.n_blocks, dtype=np.int64)
        k_local = np.ascontiguousarray(k_gp[self.gridpoints], dtype=np.float64)
        room = np.empty(n), np.empty(n)
        stiffness.perron_bounds(*pattern, self.gp_mass, k_local, self._start, _SWEEPS, *room, bound, worst)
        self.limiting_gridpoint = worst + self.gridpoints.start
        if self._correction is not None:
            b = self._matched
            largest = self.block_volume[b] * np.maximum(3.0 * self.lam[b] + 2.0 * self.mu[b], 2.0 * self.mu[b])
            bound[b] += self._correction.frequency_bound(largest, k_local[self._correction.rows])
        return bound

    def relaxation_mass(self, q: Array, x: Array, k_gp: Array) -> Array:
        """Fictitious masses (n,) with which no frequency exceeds 1 rad/s: row sums of stiffness norms."""
        row_start, _, value, diagonal = self._couple()
        sums = np.add.reduceat(value, row_start[:-1])
        return diagonal + sums + k_gp[self.gridpoints]

    def step_bound(self, q: Array, springs: Springs) -> Array:
        """Upper bounds of omega^2 per block (n_blocks,) on all springs [1/s^2]."""
        return self.frequency_bound(q, springs.x, springs.k_gp)

    def scaled_masses(self, q: Array, springs: Springs, swing: float) -> Array:
        """Fictitious masses (n,) for `springs`; `swing` is the largest factor by which damping stiffens them.

        Row sums are met only by blocks of a single zone; a step of 0.8 of the limit then bears 1 / 0.64 of stiffness.
        """
        return max(1.0, 0.64 * swing) * self.relaxation_mass(q, springs.x, springs.k_gp)

    def scaled_kinetic(self, q: Array, v: Array, scaled: Array) -> float:
        """``v.M v`` with the fictitious masses."""
        return float(scaled @ (v[self.dofs].reshape(-1, 3) ** 2).sum(axis=1))

    def decay_bound(self, q: Array, c_gp: Array) -> float:
        """Largest decay rate [1/s] that dashpots `c_gp` (n_gp,) [N s/m] give a gridpoint."""
        return float((c_gp[self.gridpoints] / self.gp_mass).max(initial=0.0))

    def unbalance(
        self, q: Array, x: Array, unbalanced: Array, pushes: Array, gravity: float, scaled: Array | None
    ) -> float:
        """Largest unbalanced gridpoint force over the largest acting (see `RigidBlocks.unbalance`).

        Positions end at their last bits, and so forces: that much (8 for the sum over the zones of a gridpoint) is not
        counted when masses, and so stiffness, are known.
        """
        left = np.linalg.norm(unbalanced[self.dofs].reshape(-1, 3), axis=1)
        if scaled is not None:
            left -= 8 * np.finfo(float).eps * np.abs(x[self.gridpoints]).max() * scaled
        inner = np.zeros(len(unbalanced))
        self.internal(q, x, inner)
        acting = float(np.linalg.norm(inner[self.dofs].reshape(-1, 3), axis=1).max())
        weight = gravity * float(self.gp_mass.max())
        return share(max(float(left.max()), 0.0), max(acting, weight, float(pushes[self.gridpoints].max(initial=0.0))))

    def jacobian(self, q: Array) -> entries.Entries:
        """``P`` of `push`: rows 3 gp + axis of the model, columns its unknowns: the positions themselves."""
        return entries.same(3 * self.gridpoints.start, self.dofs)

    # recovery

    def dofs_of(self, row: int) -> slice:
        """Unknowns of one block."""
        return slice(*(self.dofs.start + 3 * self._start[row : row + 2]))

    def coords_of(self, row: int) -> slice:
        """Coordinates of one block in `q`."""
        return slice(*(self.coords.start + 3 * self._start[row : row + 2]))

    def centres(self, q: Array, x: Array) -> Array:
        """Centroids (n_blocks, 3) [m]."""
        return recovery.centres(self, x)

    def stresses(self, q: Array, x: Array) -> Array:
        """Volume mean of the Cauchy stress (n_blocks, 6) [Pa]."""
        return recovery.volume_mean(self, x, self.zone_stress(x))

    def strains(self, q: Array, x: Array) -> Array:
        """Volume mean of the strain (n_blocks, 6)."""
        return recovery.volume_mean(self, x, self.zone_strain(x))

    def motion(self, q: Array, v: Array, x: Array) -> tuple[Array, Array]:
        """Momentum over mass, and angular velocity of the mean rotation, (n_blocks, 3) each."""
        return recovery.motion(self, v, x)

    def turn(self, q: Array, v: Array, dt: float) -> Array:
        """Zeros (n_blocks, 3): the rotation is read from the positions."""
        return np.zeros((self.n_blocks, 3))

    def rotation(self, q: Array, x: Array) -> Array:
        """Rotations (n_blocks, 3, 3) of the mean deformation."""
        return recovery.rotation(self, x)

    def inertia(self, q: Array, x: Array) -> Array:
        """Inertia about the centroids now (n_blocks, 3, 3) [kg m^2]."""
        return recovery.inertia(self, x)

    def angular_momentum(self, q: Array, v: Array, x: Array) -> Array:
        """Angular momentum about the centroids (n_blocks, 3) [kg m^2/s]."""
        return recovery.angular_momentum(self, v, x)

    def mass_of(self, row: int, q: Array) -> Array:
        """Mass matrix (3 n, 3 n) of one block with n gridpoints."""
        return recovery.mass_matrix(self, row)

    def generalised_displacement(self, row: int, q: Array, displacement: Array, moved: Array, turned: Array) -> Array:
        """The theory's u (3 n,): displacements of the gridpoints [m]."""
        start, stop = self._start[row : row + 2] + self.gridpoints.start
        return displacement[start:stop].ravel()

    def inverted(self, q: Array, x: Array) -> tuple[int, int, str] | None:
        """Row in the model, a gridpoint and the name of the first zone turned inside out, or None."""
        found = self.first_inverted(x)
        if found is None:
            return None
        return int(self.rows[found[0]]), int(self.nodes_of(*found)[0]), f"zone {found[1]} of it"

    def first_inverted(self, x: Array) -> tuple[int, int] | None:
        """Return (block, zone of that block) of the first zone turned inside out, or None."""
        zone = int(kernels.first_inverted(x[self.gridpoints], self._nodes))
        if zone < 0:
            return None
        block = int(self.zone_block[zone])
        return block, zone - int(self.zone_start[block])

    def nodes_of(self, block: int, zone: int) -> Array:
        """Global gridpoints (4,) of a zone, counted within its block."""
        return self._nodes[self.zone_start[block] + zone] + self.gridpoints.start

    def deformation(self, x: Array) -> Array:
        """Deformation gradients of the zones (m, 3, 3)."""
        F = np.empty((self._nodes.shape[0], 3, 3))
        kernels.deformation(x[self.gridpoints], self._nodes, self.gradients, F)
        return F

    def zone_strain(self, x: Array) -> Array:
        """Strain of the zones (m, 6), xx yy zz yz zx xy in global axes, engineering shear; see `recovery.strain`."""
        return recovery.strain(self, x)

    def zone_stress(self, x: Array) -> Array:
        """Cauchy stress of the zones (m, 6), xx yy zz yz zx xy in global axes, tension positive [Pa]."""
        return recovery.stress(self, x)

    def zone_rotation(self, x: Array) -> Array:
        """Rotation vectors of the zones (m, 3) [rad], polar decomposition of the deformation gradient."""
        return rotation_vectors(recovery.polar(self.deformation(x)))

    def local_range(self, x: Array) -> tuple[Array, Array]:
        """Largest strain component and largest rotation [rad] against the block's frame, per block.

        What `strain="small"` neglects; 2 % is a sensible limit for both. Zeros for ``strain="large"``.
        """
        strain, rotation = np.zeros(self.n_blocks), np.zeros(self.n_blocks)
        for term in self._terms:
            if isinstance(term, SmallStrain):
                term.local_range(x[self.gridpoints], self.deformation(x), strain, rotation)
        return strain, rotation

    def mass_entries(self, q: Array) -> entries.Entries:
        """Mass matrix."""
        return entries.zone_mass(self)

    def tangent(self, q: Array, x: Array) -> entries.Entries:
        """Derivative of the internal forces by the unknowns."""
        return entries.of_pairs(self.dofs.start, *self.pattern.pairs, self.pattern.blocks(x))

    @cached_property
    def pattern(self) -> ZonePattern:
        """Return where zones have entries in the stiffness, found once."""
        return ZonePattern(self)

    def stiffness(self) -> Any:
        """Return K (3n, 3n), scipy CSR, of linear elasticity at the reference configuration, from scikit-fem [N/m]."""
        return elastic_stiffness(self.X, self._nodes, self.lam[self.zone_block], self.mu[self.zone_block])

    def executor(self) -> ThreadPoolExecutor:
        """Return the pool of helper threads, started at the first call."""
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads - 1, thread_name_prefix="fdem-zones")
        return self._pool
