"""The formulations a scene may use, one row each: from blocks of the scene to a batch of the numerics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fdem.compile.layout import Layout, in_situ
from fdem.scene.moments import cell_densities, quadrature

__all__ = ["FORMULATIONS", "Formulation", "Share"]


@dataclass(frozen=True)
class Share:
    """What a batch is made from.

    Attributes
    ----------
    layout : Layout
        All blocks.
    rows : list of int
        Model rows of the blocks of this batch.
    X : (n_gp, 3) array
        Positions of all gridpoints [m].
    dofs, coords, gridpoints : slice
        The batch's share of ``v``, ``q`` and ``x``.
    notes : list of str
        What was chosen and left out.
    threads : int
        Threads of the zone kernels.
    """

    layout: Layout
    rows: list[int]
    X: np.ndarray
    dofs: slice
    coords: slice
    gridpoints: slice
    notes: list[str]
    threads: int

    @property
    def gp_start(self) -> np.ndarray:
        """First gridpoint of every block of the batch and the end (n + 1,)."""
        ranges = self.layout.gp_range[self.rows]
        return np.append(ranges[:, 0], ranges[-1, 1])

    @property
    def lame(self) -> np.ndarray:
        """Lame constants (n, 2) [Pa]."""
        return np.array([self.layout.blocks[i].material.lame for i in self.rows])


@dataclass(frozen=True)
class Formulation:
    """A row of the table.

    Attributes
    ----------
    kind : str
        As the option object and `Layout.kind` say.
    label : str
        What `describe` calls its blocks.
    coords, dofs : int
        Numbers of a block in ``q`` and ``v``; 0: three per gridpoint.
    make : callable
        From a `Share` to the batch.
    """

    kind: str
    label: str
    coords: int
    dofs: int
    make: Callable[[Share], Any]


def _rigid(share: Share) -> Any:
    from fdem.blocks.rigid import RigidBlocks

    layout, n = share.layout, len(share.rows)
    mass, inertia, centre = np.zeros(n), np.zeros((n, 3, 3)), np.zeros((n, 3))
    # a platen without material moves as prescribed: its mass is never used, its weight must not matter
    least = 1e-30 * float(layout.density.max()) or 1.0
    for row, i in enumerate(share.rows):
        shape = layout.blocks[i].shape
        if layout.blocks[i].material is None:
            mass[row], inertia[row], centre[row] = least * shape.volume, shape.inertia(least), shape.centroid
        else:
            body = layout.properties(i)
            mass[row], inertia[row], centre[row] = body.mass, body.inertia, body.centre
        if layout.blocks[i].fixed:
            # equal moments: a prescribed spin then stays what it is within a step
            inertia[row] = np.trace(inertia[row]) / 3.0 * np.eye(3)
    return RigidBlocks(
        X=share.X,
        gp_start=share.gp_start,
        mass=mass,
        inertia=inertia,
        centroid=centre - layout.origin,
        dofs=share.dofs,
        coords=share.coords,
        gridpoints=share.gridpoints,
    )


def _sphere(share: Share) -> Any:
    from fdem.blocks.spheres import SphereBlocks

    layout = share.layout
    radius = np.array([layout.blocks[i].shape.radius for i in share.rows])
    density, volume = layout.density[share.rows], layout.volume[share.rows]
    least = 1e-30 * float(layout.density.max()) or 1.0
    return SphereBlocks(
        centre=share.X[share.gridpoints],
        radius=radius,
        mass=np.where(density > 0.0, density, least) * volume,
        dofs=share.dofs,
        coords=share.coords,
        gridpoints=share.gridpoints,
    )


def _uniform(share: Share) -> Any:
    from fdem.blocks.uniform import UniformBlocks

    layout = share.layout
    bodies = [layout.properties(i) for i in share.rows]
    lame = share.lame
    batch = UniformBlocks(
        X=share.X,
        gp_start=share.gp_start,
        mass=np.array([body.mass for body in bodies]),
        moments=np.array([body.second for body in bodies]),
        centre=np.array([body.centre for body in bodies]) - layout.origin,
        volume=np.array([layout.blocks[i].shape.volume for i in share.rows]),
        lam=lame[:, 0],
        mu=lame[:, 1],
        dofs=share.dofs,
        coords=share.coords,
        gridpoints=share.gridpoints,
    )
    # the mean of a stress that varies linearly is its value at the centroid
    middle = np.array([layout.blocks[i].shape.centroid for i in share.rows])
    batch.set_initial_stress(in_situ(layout, middle, np.array(share.rows)))
    return batch


def _linear(share: Share) -> Any:
    from fdem.blocks.linear import LinearBlocks, fairing, function_moments, monomials

    layout, lame, n = share.layout, share.lame, len(share.rows)
    bodies = [layout.properties(i) for i in share.rows]
    integrals, moments, stress = np.zeros((n, 10, 10)), np.zeros((n, 10, 10)), np.zeros((n, 10, 6))
    stressed, faired = False, []
    for row, (i, body) in enumerate(zip(share.rows, bodies, strict=True)):
        points, weights = quadrature(layout.blocks[i].shape, 4)
        values = monomials(points - body.centre)
        integrals[row] = values.T @ (weights[:, None] * values)
        if body.points is None or body.weights is None:
            moments[row] = body.density * integrals[row]
        else:
            massive = monomials(body.points - body.centre)
            moments[row] = massive.T @ (body.weights[:, None] * massive)
        facets = layout.meshes[i]
        faired.append(fairing(facets.points - body.centre, facets.triangles, facets.triangle_face))
        given = in_situ(layout, points, np.full(len(points), i))
        if given is not None:
            stress[row], stressed = values.T @ (weights[:, None] * given), True
    batch = LinearBlocks(
        integrals=integrals,
        fairing=np.vstack(faired),
        X=share.X,
        gp_start=share.gp_start,
        mass=np.array([body.mass for body in bodies]),
        moments=function_moments(moments),
        centre=np.array([body.centre for body in bodies]) - layout.origin,
        volume=np.array([layout.blocks[i].shape.volume for i in share.rows]),
        lam=lame[:, 0],
        mu=lame[:, 1],
        dofs=share.dofs,
        coords=share.coords,
        gridpoints=share.gridpoints,
    )
    batch.set_initial_stress(stress if stressed else None)
    return batch


def _zoned(share: Share) -> Any:
    from fdem.blocks.zoned import ZonedBlocks

    layout = share.layout
    blocks, lame = [layout.blocks[i] for i in share.rows], share.lame
    zones, _, start = layout.zones()
    counts = np.diff(start)[share.rows]
    stress = in_situ(layout, share.X[zones].mean(axis=1) + layout.origin, np.repeat(share.rows, counts))
    if stress is None:
        share.notes.append("zones: no in-situ stress, its arrays are left out")
    return ZonedBlocks(
        X=share.X[share.gridpoints],
        zones=zones,
        zone_start=np.concatenate([[0], np.cumsum(counts)]),
        gp_start=share.gp_start,
        density=_zone_density(share),
        lam=lame[:, 0].copy(),
        mu=lame[:, 1].copy(),
        large=np.array([b.body.strain == "large" for b in blocks]),
        mass=[b.body.mass for b in blocks],
        dofs=share.dofs,
        coords=share.coords,
        gridpoints=share.gridpoints,
        stress0=stress,
        threads=share.threads,
    )


def _zone_density(share: Share) -> np.ndarray:
    """Density of every block, or of every zone where one of them varies [kg/m^3]."""
    blocks = [share.layout.blocks[i] for i in share.rows]
    if not any(callable(b.material.density) for b in blocks):
        return np.array([float(b.material.density) for b in blocks])
    parts = []
    for i, block in zip(share.rows, blocks, strict=True):
        mesh, density = share.layout.meshes[i], block.material.density
        if callable(density):
            parts.append(cell_densities(mesh.points, mesh.tets, density, f"block {block.name!r}"))
        else:
            parts.append(np.full(len(mesh.tets), float(density)))
    return np.concatenate(parts)


# in the order of their unknowns; those whose unknowns are gridpoints come last, in memory that q and x share
FORMULATIONS = (
    Formulation("rigid", "rigid or driven", 7, 6, _rigid),
    Formulation("sphere", "spheres without orientation", 3, 6, _sphere),
    Formulation("uniform", "of uniform strain", 12, 12, _uniform),
    Formulation("linear", "of linear strain", 30, 30, _linear),
    Formulation("zoned", "zoned", 0, 0, _zoned),
)
