"""Joint laws: frozen data; the sweep that evaluates a law is named by `kernel` (kernels/joints.py)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fdem.errors import UnsupportedError
from fdem.scene.checks import number

__all__ = ["Bonded", "Coulomb", "Joint"]


@dataclass(frozen=True, kw_only=True)
class Joint:
    """Base of the joint laws.

    Parameters
    ----------
    kn, ks : float, optional
        Normal and shear stiffness [Pa/m]; None lets compile choose (and say so).
    """

    kn: float | None = None
    ks: float | None = None
    kernel: ClassVar[str] = ""

    def __post_init__(self) -> None:
        owner = type(self).__name__
        for field in ("kn", "ks"):
            if getattr(self, field) is not None:
                number(owner, field, getattr(self, field), low=0.0, open_low=field == "kn")

    def properties(self, kn: float, ks: float) -> tuple[float, ...]:
        """Row of the property table that the law's sweep reads; the first two are kn and ks [Pa/m]."""
        raise UnsupportedError(f"{type(self).__name__}: a law needs properties(kn, ks)")

    def hard(self) -> tuple[float, float, float, float] | None:
        """Friction coefficient, cohesion [Pa], tension [Pa] and restitution for `ContactDynamics`; None: no such law."""
        return None


@dataclass(frozen=True, kw_only=True)
class Coulomb(Joint):
    """Linear normal and shear stiffness, slip at the friction cone, brittle cohesion and tension.

    Parameters
    ----------
    kn, ks : float, optional
        Normal and shear stiffness [Pa/m]; None lets compile choose (and say so).
    friction : float
        Friction angle [deg].
    cohesion, tension : float, optional
        Strength [Pa] of contacts that exist at compile; lost at the first failure.
    dilation : float, optional
        Dilation angle [deg], acts while slipping.
    dilation_limit : float, optional
        Shear displacement [m] at which dilation stops.
    residual_friction : float, optional
        Friction angle after the first slip [deg]; None keeps `friction`.
    residual_cohesion : float, optional
        Cohesion left after failure [Pa].
    restitution : float, optional
        Restitution coefficient; sets the damping of penalty contacts if given.
    damping : float, optional
        Viscous damping as a fraction of critical of the contact's normal spring.
    rolling, twisting : float, optional
        Rolling and twisting resistance lengths [m].

    Raises
    ------
    SceneError
        If a value is out of range.
    UnsupportedError
        For rolling or twisting resistance.

    Notes
    -----
    ``traction_n = kn closure``; the shear traction grows with ``ks`` and is cut at
    ``cohesion + traction_n tan(friction)``.
    """

    friction: float
    cohesion: float = 0.0
    tension: float = 0.0
    dilation: float = 0.0
    dilation_limit: float | None = None
    residual_friction: float | None = None
    residual_cohesion: float = 0.0
    restitution: float | None = None
    damping: float = 0.0
    rolling: float = 0.0
    twisting: float = 0.0
    kernel: ClassVar[str] = "coulomb"

    def __post_init__(self) -> None:
        super().__post_init__()
        number("Coulomb", "friction", self.friction, low=0.0, high=90.0, open_high=True)
        number("Coulomb", "dilation", self.dilation, low=0.0, high=90.0, open_high=True)
        for field in ("cohesion", "tension", "residual_cohesion", "damping"):
            number("Coulomb", field, getattr(self, field), low=0.0)
        for field, high in (("dilation_limit", np.inf), ("residual_friction", 90.0), ("restitution", 1.0)):
            if getattr(self, field) is not None:
                number("Coulomb", field, getattr(self, field), low=0.0, high=high)
        for field in ("rolling", "twisting"):
            if number("Coulomb", field, getattr(self, field), low=0.0) > 0:
                value = getattr(self, field)
                raise UnsupportedError(f"Coulomb: {field} = {value!r}: contact moments are not there yet")

    def properties(self, kn: float, ks: float) -> tuple[float, ...]:
        """Row of the table of the "coulomb" sweep (kernels/joints.py)."""
        residual = self.friction if self.residual_friction is None else self.residual_friction
        return (
            kn,
            ks,
            _tan(self.friction),
            float(self.cohesion),
            float(self.tension),
            _tan(self.dilation),
            np.inf if self.dilation_limit is None else float(self.dilation_limit),
            _tan(residual),
            float(self.residual_cohesion),
            self.damping_ratio,
        )

    def hard(self) -> tuple[float, float, float, float]:
        """Friction, cohesion, tension and restitution (0 if None) of hard contact."""
        return _tan(self.friction), float(self.cohesion), float(self.tension), float(self.restitution or 0.0)

    @property
    def damping_ratio(self) -> float:
        """Fraction of critical damping; from `restitution` e: -ln e / sqrt(pi^2 + ln^2 e)."""
        if self.restitution is None:
            return float(self.damping)
        if self.restitution == 0:
            return 1.0
        log = np.log(self.restitution)
        return float(-log / np.sqrt(np.pi**2 + log**2))


@dataclass(frozen=True, kw_only=True)
class Bonded(Joint):
    """Glued faces: elastic in tension, compression and shear until a strength is exceeded, then Coulomb friction.

    Parameters
    ----------
    kn, ks : float, optional
        Normal and shear stiffness [Pa/m]; None lets compile choose (and say so).
    tension, shear : float, optional
        Strength [Pa]; infinite never breaks.
    friction : float, optional
        Friction angle after breaking [deg].

    Raises
    ------
    SceneError
        If a value is out of range.
    """

    tension: float = np.inf
    shear: float = np.inf
    friction: float = 0.0
    kernel: ClassVar[str] = "bonded"

    def __post_init__(self) -> None:
        super().__post_init__()
        number("Bonded", "friction", self.friction, low=0.0, high=90.0, open_high=True)
        for field in ("tension", "shear"):
            number("Bonded", field, getattr(self, field), low=0.0, infinite=True)

    def properties(self, kn: float, ks: float) -> tuple[float, ...]:
        """Row of the table of the "bonded" sweep (kernels/joints.py)."""
        return kn, ks, _tan(self.friction), float(self.shear), float(self.tension)

    def hard(self) -> tuple[float, float, float, float]:
        """Friction, cohesion, tension and restitution of hard contact."""
        return _tan(self.friction), float(self.shear), float(self.tension), 0.0


def _tan(degrees: float) -> float:
    return float(np.tan(np.radians(degrees)))
