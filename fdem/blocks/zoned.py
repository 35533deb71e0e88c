"""Zoned blocks: constant-strain tetrahedra, the gridpoints are the unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import numpy as np

from fdem.blocks.assembly import coupling_norms, elastic_stiffness
from fdem.blocks.bounds import Springs, share
from fdem.blocks.masses import InertiaCorrection, block_moments, lumped_moments, row_sum_masses, voronoi_masses
from fdem.blocks.zoneforces import LargeStrain, SmallStrain, elasticity, rotation_vectors, voigt_strain
from fdem.blocks.zonetangents import ZoneMatrices
from fdem.errors import MeshError, SceneError
from fdem.kernels import corotated, stiffness, zones

__all__ = ["ZonedBlocks"]

Array = Any

_SWEEPS = 12  # power sweeps of the frequency bound: 0.75 of the true step becomes about 0.95
_MASS_RULES = ("voronoi", "row-sum", "inertia-matched")


class ZonedBlocks:
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
    zone_volume, zone_mass : (m,) arrays
        [m^3], [kg].
    block_mass : (n_blocks,) array
        Exact masses [kg].
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

    has_internal = True
    in_place = True

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
        _shape_gradients(self.X, self._nodes, self.gradients, self.zone_volume)
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
        self._terms = []
        if self.large.any():
            self._terms.append(LargeStrain(self, self.large[self.zone_block]))
        if not self.large.all():
            self._terms.append(SmallStrain(self, ~self.large))

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

    def place(self, q: Array, x: Array) -> None:
        """Write positions (n_gp, 3) of this batch's gridpoints: q itself."""
        target, source = x[self.gridpoints], q[self.coords]
        if not np.may_share_memory(target, source):
            target[:] = source.reshape(-1, 3)

    def push(self, q: Array, v: Array, xdot: Array) -> None:
        """Write velocities of gridpoints (n_gp, 3) [m/s]."""
        xdot[self.gridpoints] = v[self.dofs].reshape(-1, 3)

    def pull(self, q: Array, f_gp: Array, f: Array) -> None:
        """Add gridpoint forces (n_gp, 3) to generalised forces (n_dofs,) [N]."""
        f[self.dofs] += f_gp[self.gridpoints].ravel()

    def advance(self, q: Array, v: Array, dt: float) -> None:
        """``q += dt v``."""
        np.multiply(v[self.dofs], dt, out=self._motion)
        q[self.coords] += self._motion

    # forces

    def internal(self, x: Array, f: Array) -> None:
        """Subtract internal forces (n_dofs,) [N] at the positions x (n_gp, 3) [m]."""
        local, force = x[self.gridpoints], f[self.dofs].reshape(-1, 3)
        for term in self._terms:
            term.subtract_force(local, force)

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

    def kinetic(self, q: Array, v: Array) -> float:
        """Kinetic energy [J]."""
        velocity = v[self.dofs].reshape(-1, 3)
        return float(0.5 * np.sum(velocity * self.multiply_mass(velocity)))

    def strain_energy(self, x: Array) -> float:
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
            self._coupling = coupling_norms(
                self._nodes,
                self.gradients,
                self.zone_volume,
                self.lam[self.zone_block],
                self.mu[self.zone_block],
                self.X.shape[0],
            )
        return self._coupling

    def frequency_bound(self, q: Array, x: Array, k_gp: Array) -> Array:
        """Upper bounds of omega^2 per block (n_blocks,) [1/s^2], contact stiffness k_gp (n_gp,) [N/m] included."""
        row_start, column, value, diagonal = self._couple()
        n = self.X.shape[0]
        bound, worst = np.empty(self.n_blocks), np.empty(self.n_blocks, dtype=np.int64)
        k_local = np.ascontiguousarray(k_gp[self.gridpoints], dtype=np.float64)
        stiffness.perron_bounds(
            row_start,
            column,
            value,
            diagonal,
            self.gp_mass,
            k_local,
            self._start,
            _SWEEPS,
            np.empty(n),
            np.empty(n),
            bound,
            worst,
        )
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

    def unbalance(self, x: Array, unbalanced: Array, pushes: Array, gravity: float, scaled: Array | None) -> float:
        """Largest unbalanced gridpoint force over the largest acting (see `RigidBlocks.unbalance`).

        Positions end at their last bits, and so forces: that much (8 for the sum over the zones of a gridpoint) is not
        counted when masses, and so stiffness, are known.
        """
        left = np.linalg.norm(unbalanced[self.dofs].reshape(-1, 3), axis=1)
        if scaled is not None:
            left -= 8 * np.finfo(float).eps * np.abs(x[self.gridpoints]).max() * scaled
        inner = np.zeros(len(unbalanced))
        self.internal(x, inner)
        acting = float(np.linalg.norm(inner[self.dofs].reshape(-1, 3), axis=1).max())
        weight = gravity * float(self.gp_mass.max())
        return share(max(float(left.max()), 0.0), max(acting, weight, float(pushes[self.gridpoints].max(initial=0.0))))

    # implicit steps

    def shift(self, q: Array, d: Array) -> None:
        """``q += d`` for this batch's unknowns."""
        q[self.coords] += d[self.dofs]

    def gyroscopic(self, q: Array, v: Array, f: Array) -> None:
        """Nothing: gridpoints do not turn."""

    def dof_rows(self) -> Array:
        """Row in the model of the block of every unknown of this batch."""
        return np.repeat(np.repeat(self.rows, np.diff(self._start)), 3)

    def mass_diagonal(self, q: Array) -> Array:
        """Diagonal of the mass matrix of this batch (lumped part)."""
        return np.repeat(self.gp_mass, 3)

    def add_momentum(self, q: Array, v: Array, out: Array) -> None:
        """``out += M v``."""
        out[self.dofs] += self.multiply_mass(v[self.dofs].reshape(-1, 3)).ravel()

    def unknown_groups(self) -> list[Array]:
        """Unknowns that belong together: three of every gridpoint."""
        return [self.dofs.start + np.arange(self.X.size).reshape(-1, 3)]

    def mass_entries(self, q: Array) -> tuple[Array, Array, Array]:
        """Rows, columns and values of the mass matrix."""
        return self._matrices.mass()

    def stiffness_entries(self, x: Array) -> tuple[Array, Array, Array]:
        """Rows, columns and values of d internal force / d position at the positions x (n_gp, 3)."""
        return self._matrices.stiffness(x[self.gridpoints])

    def jacobian_entries(self, q: Array) -> tuple[Array, Array, Array]:
        """Entries of ``P``: the unknowns are the positions."""
        rows = 3 * self.gridpoints.start + np.arange(self.X.size)
        return rows, self.dofs.start + np.arange(self.X.size), np.ones(self.X.size)

    @cached_property
    def _matrices(self) -> ZoneMatrices:
        return ZoneMatrices(self)

    # recovery

    def first_inverted(self, x: Array) -> tuple[int, int] | None:
        """Return (block, zone of that block) of the first zone turned inside out, or None."""
        zone = int(zones.first_inverted(x[self.gridpoints], self._nodes))
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
        zones.deformation(x[self.gridpoints], self._nodes, self.gradients, F)
        return F

    def _rotations(self, F: Array) -> Array:
        R = np.empty_like(F)
        corotated.polar_rotations(F, R)
        return R

    def _strained(self, x: Array) -> tuple[Array, Array, Array]:
        """F, the rotation and the material strain of every zone, as its block's formulation measures them."""
        F = self.deformation(x)
        R = self._rotations(F)
        strain = 0.5 * (np.swapaxes(F, 1, 2) @ F - np.eye(3))
        for term in self._terms:
            if isinstance(term, SmallStrain):
                term.override(x[self.gridpoints], F, R, strain)
        return F, R, strain

    def zone_strain(self, x: Array) -> Array:
        """Strain of the zones (m, 6), xx yy zz yz zx xy in global axes, engineering shear.

        Green-Lagrange strain turned to the present axes, ``R E R^T``; for ``strain="small"`` the linear strain in
        the frame of the block, turned alike.
        """
        _, R, strain = self._strained(x)
        return voigt_strain(R @ strain @ np.swapaxes(R, 1, 2))

    def zone_stress(self, x: Array) -> Array:
        """Cauchy stress of the zones (m, 6), xx yy zz yz zx xy in global axes, tension positive [Pa]."""
        F, R, strain = self._strained(x)
        material = elasticity(strain, self.lam[self.zone_block], self.mu[self.zone_block])
        if self.stress0 is not None:
            material += _tensor(self.stress0)
        large = self.large[self.zone_block][:, None, None]
        carrier = np.where(large, F, R)
        cauchy = carrier @ material @ np.swapaxes(carrier, 1, 2)
        cauchy /= np.where(large[:, 0, 0], np.linalg.det(F), 1.0)[:, None, None]
        return cauchy[:, [0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]]

    def zone_rotation(self, x: Array) -> Array:
        """Rotation vectors of the zones (m, 3) [rad], polar decomposition of the deformation gradient."""
        return rotation_vectors(self._rotations(self.deformation(x)))

    def local_range(self, x: Array) -> tuple[Array, Array]:
        """Largest strain component and largest rotation [rad] against the block's frame, per block.

        What `strain="small"` neglects; 2 % is a sensible limit for both. Zeros for ``strain="large"``.
        """
        strain, rotation = np.zeros(self.n_blocks), np.zeros(self.n_blocks)
        for term in self._terms:
            if isinstance(term, SmallStrain):
                term.local_range(x[self.gridpoints], self.deformation(x), strain, rotation)
        return strain, rotation

    def stiffness(self) -> Any:
        """Return K (3n, 3n), scipy CSR, of linear elasticity at the reference configuration, from scikit-fem [N/m]."""
        block = self.zone_block
        return elastic_stiffness(self.X, self._nodes, self.lam[block], self.mu[block])

    def executor(self) -> ThreadPoolExecutor:
        """Return the pool of helper threads, started at the first call."""
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads - 1, thread_name_prefix="fdem-zones")
        return self._pool


def _shape_gradients(X: Array, nodes: Array, gradients: Array, volume: Array) -> None:
    zones.shape_gradients(X, nodes, gradients, volume)


def _tensor(voigt: Array) -> Array:
    """Symmetric tensors (m, 3, 3) of stresses (m, 6) xx yy zz yz zx xy."""
    return voigt[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
