"""How a block moves: the formulation asked for, as an option object."""

from __future__ import annotations

from dataclasses import dataclass

from fdem.errors import SceneError
from fdem.scene.checks import number

__all__ = ["Rigid", "Zoned"]


@dataclass(frozen=True)
class Rigid:
    """A perfectly rigid block: six degrees of freedom, translation and rotation of its centroid."""


@dataclass(frozen=True)
class Zoned:
    """A deformable block subdivided into constant-strain tetrahedra.

    Parameters
    ----------
    size : float, optional
        Target zone edge [m]. Without it a convex block is divided into tetrahedra around its
        centroid, the coarsest subdivision there is.
    mass : {"voronoi", "row-sum", "inertia-matched"}, optional
        Gridpoint masses: the Voronoi cell clipped to the block (the theory's), a quarter of each
        zone, or lumped masses with a low-rank correction that makes centre and inertia exact.
    strain : {"large", "small"}, optional
        St. Venant-Kirchhoff, exact under any rotation, or a constant stiffness in a frame that
        rotates with the block: faster, for local strains below about 2 %.

    Raises
    ------
    SceneError
        If an option is not one of those listed.
    """

    size: float | None = None
    mass: str = "voronoi"
    strain: str = "large"

    def __post_init__(self) -> None:
        if self.size is not None:
            number("Zoned", "size", self.size, low=0.0, open_low=True)
        for field, allowed in (("mass", ("voronoi", "row-sum", "inertia-matched")), ("strain", ("large", "small"))):
            if getattr(self, field) not in allowed:
                raise SceneError(f"Zoned: {field} = {getattr(self, field)!r}, allowed are {', '.join(allowed)}")
