"""Spheres and clumps of a scene as the contact of spheres takes them."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.compile.joints import JointTables
from fdem.compile.layout import Layout
from fdem.errors import UnsupportedError
from fdem.model import Model
from fdem.scene.joints import Coulomb, Hertz
from fdem.scene.shapes import Balls
from fdem.state import State

__all__ = ["compile_particles", "has_particles"]


def has_particles(layout: Layout) -> bool:
    """Whether a block of the scene is a sphere or a clump."""
    return any(isinstance(block.shape, Balls) for block in layout.blocks)


def compile_particles(layout: Layout, model: Model, state: State, surfaces: Any, tables: JointTables) -> Any:
    """Contacts of all spheres with each other and with the faces in `surfaces` (None: there are no faces)."""
    from fdem.contact.facets import Facets
    from fdem.contact.particles import Particles, SphereTable
    from fdem.contact.spheres import SphereContacts

    block = model.gp_block[model.balls]
    spin = np.full(model.n_blocks, -1, dtype=np.int64)
    for batch in model.batches:
        if not batch.in_place and not batch.coupled:
            spin[batch.rows] = batch.dofs.start + 6 * np.arange(len(batch.rows)) + 3
    particles = Particles(gp=model.balls, block=block, radius=model.ball_radius, spin=spin[block])
    mobile = ~model.fixed
    inverse = np.where(mobile & (model.mass > 0.0), 1.0 / np.where(model.mass > 0.0, model.mass, 1.0), 0.0)
    compliance = np.array([_compliance(b) for b in layout.blocks])
    material = np.array([b.material is not None for b in layout.blocks])
    sides = np.concatenate([block, np.arange(model.n_blocks)])
    table = SphereTable(
        [_law(rule.law, *stiffness) for rule, stiffness in zip(tables.rules, tables.stiffness, strict=True)],
        np.concatenate([particles.radius, np.full(model.n_blocks, np.inf)]),
        inverse[sides],
        compliance[sides],
        material[sides],
        [model.names[i] for i in sides],
    )
    return SphereContacts(
        particles,
        state.x,
        facets=None if surfaces is None else Facets(surfaces, mobile),
        table=table,
        assign=tables.assign_spheres,
        mobile=mobile,
        inverse_mass=inverse,
        gravity=float(np.linalg.norm(model.gravity)),
        names=model.names,
    )


def _compliance(block: Any) -> tuple[float, float]:
    """``(1 - nu^2) / E`` and ``(2 - nu) / G`` [1/Pa]; 0 for a fixed block without material, nan without constants."""
    material = block.material
    if material is None:
        return 0.0, 0.0
    if material.young is None:
        return np.nan, np.nan
    return _of_constants(material.young, material.poisson)


def _of_constants(young: float, poisson: float) -> tuple[float, float]:
    return (1.0 - poisson**2) / young, (2.0 - poisson) * 2.0 * (1.0 + poisson) / young


def _law(law: Any, kn: float, ks: float) -> Any:
    """A joint law as spheres feel it.

    Raises
    ------
    UnsupportedError
        If the law has a property that contacts of spheres do not have.
    """
    from fdem.contact.particles import SphereLaw

    name, bounce = type(law).__name__, float(getattr(law, "restitution", None) or 0.0)
    if isinstance(law, Hertz):
        given = None if law.young is None or law.poisson is None else _of_constants(law.young, law.poisson)
        return SphereLaw(
            True, 0.0, 0.0, _tan(law.friction), law.damping_ratio, given, law.rolling, law.twisting, name, bounce
        )
    if not isinstance(law, Coulomb):
        raise UnsupportedError(f"joint {name}: contacts of spheres know Coulomb and Hertz")
    for field in ("cohesion", "tension", "dilation", "residual_cohesion"):
        if getattr(law, field) > 0.0:
            raise UnsupportedError(f"joint {name}: {field} = {getattr(law, field)!r}: contacts of spheres have none")
    friction = law.friction if law.residual_friction is None else law.residual_friction
    return SphereLaw(False, kn, ks, _tan(friction), law.damping_ratio, None, law.rolling, law.twisting, name, bounce)


def _tan(degrees: float) -> float:
    return float(np.tan(np.radians(degrees)))
