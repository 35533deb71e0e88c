"""How a block moves: the formulation asked for, as an option object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fdem.errors import SceneError
from fdem.scene.checks import number

__all__ = ["BODIES", "LinearStrain", "Rigid", "UniformStrain", "Zoned"]


@dataclass(frozen=True)
class Rigid:
    """A perfectly rigid block: six degrees of freedom, translation and rotation of its centroid.

    Parameters
    ----------
    orientation : bool, optional
        Keep the orientation of a sphere, which nothing in its motion depends on; other shapes always have one.
    """

    kind: ClassVar[str] = "rigid"
    deforms: ClassVar[bool] = False

    orientation: bool = False


@dataclass(frozen=True)
class UniformStrain:
    """A block with one homogeneous deformation, of any shape: discontinuous deformation analysis (DDA).

    Notes
    -----
    Twelve unknowns: inside, the centre of mass c and the deformation gradient F, ``x = c + F (X - C)``; ``sim[block]``
    gives the theory's translation, rotation and strain. Rotations of any size leave shape and volume alone. Stress is
    linear in the stretch, in axes that turn with the block. A component fixed by `Scene.fix` is fixed for the whole
    block.
    """

    kind: ClassVar[str] = "uniform"
    deforms: ClassVar[bool] = True


@dataclass(frozen=True)
class LinearStrain:
    """A block whose strain is linear in place, of any shape: it bends without a mesh.

    Parameters
    ----------
    size : float, optional
        Target edge [m] of the facets that contact sees; None: two thirds of the cube root of the volume. Faces curve,
        the facets between their gridpoints are flat: finer ones follow more closely and cost more contact points.

    Raises
    ------
    SceneError
        If `size` is not positive.

    Notes
    -----
    Thirty unknowns, ``x = c + F xi + G : (xi xi) / 2`` with ``xi = X - C``. St. Venant-Kirchhoff, integrated exactly.
    """

    kind: ClassVar[str] = "linear"
    deforms: ClassVar[bool] = True

    size: float | None = None

    def __post_init__(self) -> None:
        if self.size is not None:
            number("LinearStrain", "size", self.size, low=0.0, open_low=True)


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

    kind: ClassVar[str] = "zoned"
    deforms: ClassVar[bool] = True

    size: float | None = None
    mass: str = "voronoi"
    strain: str = "large"

    def __post_init__(self) -> None:
        if self.size is not None:
            number("Zoned", "size", self.size, low=0.0, open_low=True)
        for field, allowed in (("mass", ("voronoi", "row-sum", "inertia-matched")), ("strain", ("large", "small"))):
            if getattr(self, field) not in allowed:
                raise SceneError(f"Zoned: {field} = {getattr(self, field)!r}, allowed are {', '.join(allowed)}")


BODIES = (Rigid, UniformStrain, LinearStrain, Zoned)
