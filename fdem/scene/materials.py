"""What blocks are made of: frozen descriptions in SI units, checked when they are made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fdem.errors import SceneError
from fdem.scene.checks import number

__all__ = ["Elastic"]


@dataclass(frozen=True)
class Elastic:
    """Isotropic linear elasticity.

    Parameters
    ----------
    density : float or callable
        Mass density [kg/m^3]; a callable of places (n, 3) gives (n,) densities.
    young : float, optional
        Young's modulus [Pa]; a rigid block needs none.
    poisson : float, optional
        Poisson's ratio, in (-1, 0.5).

    Raises
    ------
    SceneError
        If a value is missing, not finite or out of range.

    Notes
    -----
    Lame's constants are lambda = E nu / ((1 + nu)(1 - 2 nu)) and mu = E / (2 (1 + nu)).
    """

    density: float | Callable[[np.ndarray], np.ndarray]
    young: float | None = None
    poisson: float | None = None

    def __post_init__(self) -> None:
        if not callable(self.density):
            number("Elastic", "density", self.density, low=0.0, open_low=True)
        if (self.young is None) != (self.poisson is None):
            raise SceneError(f"Elastic: young = {self.young!r} and poisson = {self.poisson!r}: give both or none")
        if self.young is not None:
            number("Elastic", "young", self.young, low=0.0, open_low=True)
            number("Elastic", "poisson", self.poisson, low=-1.0, high=0.5, open_low=True, open_high=True)

    @property
    def lame(self) -> tuple[float, float]:
        """Lame's constants lambda and mu [Pa].

        Raises
        ------
        SceneError
            If the material has no elastic constants.
        """
        if self.young is None or self.poisson is None:
            raise SceneError("Elastic: young and poisson are missing, a deformable block needs both")
        young, poisson = float(self.young), float(self.poisson)
        return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))
