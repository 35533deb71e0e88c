"""Joint laws: frozen data; the sweep that evaluates a law is named by `kernel` (kernels/joints.py)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fdem.errors import SceneError, UnsupportedError
from fdem.scene.checks import number

__all__ = ["Bonded", "Coulomb", "Hertz", "Joint"]


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
    for_faces: ClassVar[bool] = True

    def __post_init__(self) -> None:
        owner = type(self).__name__
        for field in ("kn", "ks"):
            if getattr(self, field) is not None:
                number(owner, field, getattr(self, field), low=0.0, open_low=field == "kn")

    def properties(self, kn: float, ks: float) -> tuple[float, ...]:
        """Row of the property table that the law's sweep reads; the first two are kn and ks [Pa/m]."""
        raise UnsupportedError(f"{type(self).__name__}: a law needs properties(kn, ks)")


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
        Rolling and twisting resistance: lengths [m] that times the normal force limit the couple of a patch.

    Raises
    ------
    SceneError
        If a value is out of range.

    Notes
    -----
    ``traction_n = kn closure``; the shear traction grows with ``ks`` and is cut at
    ``cohesion + traction_n tan(friction)``.

    Spheres: kn and ks times the reference area ``pi r^2`` of the smaller sphere are linear springs. Rolling and
    twisting there are springs ``k l^2`` of the length l given and of the normal and the shear spring.
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
        for field in ("cohesion", "tension", "residual_cohesion", "damping", "rolling", "twisting"):
            number("Coulomb", field, getattr(self, field), low=0.0)
        for field, high in (("dilation_limit", np.inf), ("residual_friction", 90.0), ("restitution", 1.0)):
            if getattr(self, field) is not None:
                number("Coulomb", field, getattr(self, field), low=0.0, high=high, open_high=high == 90.0)

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

    @property
    def damping_ratio(self) -> float:
        """Fraction of critical damping: that of `restitution` if given, else `damping`."""
        return float(self.damping) if self.restitution is None else _damping_of(float(self.restitution))


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


@dataclass(frozen=True, kw_only=True)
class Hertz(Joint):
    """Elastic contact of spheres by Hertz, friction by a simplified Mindlin spring with history; for spheres only.

    Parameters
    ----------
    friction : float
        Friction angle [deg].
    young : float, optional
        Young's modulus [Pa] of every body in contact that has a material; None: that of its material.
    poisson : float, optional
        Poisson's ratio, given together with `young`.
    restitution : float, optional
        Restitution coefficient of the normal impact, the same at every speed.
    rolling, twisting : float, optional
        Rolling and twisting resistance: lengths [m] that times the normal force limit the couples.
    kn, ks : None
        Not to be given: the stiffness follows from the elastic constants.

    Raises
    ------
    SceneError
        If a value is out of range.

    Notes
    -----
    With ``1/E* = sum (1 - nu^2)/E``, ``1/G* = sum (2 - nu)/G``, ``1/R* = sum 1/R`` (a plane has R infinite, a fixed
    body without material has E infinite) and the overlap d:

    - ``N = 4/3 E* sqrt(R*) d^(3/2) + c d^(1/4) d'``, never less than 0, c from `restitution`;
    - shear: a spring ``8 G* sqrt(R* d)`` with history, cut at ``N tan(friction)``, and a dashpot of the same fraction
      of critical. Mindlin's partial slip is left out: below gross slip a loop dissipates nothing. Where the contact
      grows the shear force stays, where it shrinks it falls with the stiffness, so that no energy comes from it.

    References
    ----------
    Johnson (1985), Contact Mechanics, chapters 4 and 7; Antypov, Elliott (2011), EPL 94, 50004 (damping); Thornton,
    Cummins, Cleary (2013), Powder Technology 233, 30-46 (history).
    """

    friction: float
    young: float | None = None
    poisson: float | None = None
    restitution: float = 1.0
    rolling: float = 0.0
    twisting: float = 0.0
    kernel: ClassVar[str] = "hertz"
    for_faces: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for field in ("kn", "ks"):
            if getattr(self, field) is not None:
                raise SceneError(
                    f"Hertz: {field} = {getattr(self, field)!r}: its stiffness follows from young and poisson"
                )
        number("Hertz", "friction", self.friction, low=0.0, high=90.0, open_high=True)
        number("Hertz", "restitution", self.restitution, low=0.0, high=1.0)
        for field in ("rolling", "twisting"):
            number("Hertz", field, getattr(self, field), low=0.0)
        if (self.young is None) != (self.poisson is None):
            raise SceneError(f"Hertz: young = {self.young!r} and poisson = {self.poisson!r}: give both or none")
        if self.young is not None:
            number("Hertz", "young", self.young, low=0.0, open_low=True)
            number("Hertz", "poisson", self.poisson, low=-1.0, high=0.5, open_low=True)

    @property
    def damping_ratio(self) -> float:
        """Fraction of critical damping of the contact, as that of a linear one (contact/particles.py)."""
        return _damping_of(float(self.restitution))


def _damping_of(restitution: float) -> float:
    """Damping ratio of a spring and dashpot that do not pull, for a restitution coefficient.

    ``e = exp(-2 z acos(z) / sqrt(1 - z^2))``, beyond z = 1 with the hyperbolic functions (Schwager and Poeschel 2007,
    Granular Matter 9, 465-469). It reaches 0 nowhere: e below 0.01 is taken as 0.01, z = 4.6.
    """
    wanted, low, high = -np.log(max(restitution, 0.01)), 0.0, 8.0
    for _ in range(60):
        z = 0.5 * (low + high)
        root = np.sqrt(abs(1.0 - z * z))
        turned = np.arccos(z) if z < 1.0 else np.arccosh(z)
        loss = 2.0 * z * turned / root if root > 0.0 else 2.0
        low, high = (z, high) if loss < wanted else (low, z)
    return 0.5 * (low + high) if restitution < 1.0 else 0.0


def _tan(degrees: float) -> float:
    return float(np.tan(np.radians(degrees)))
