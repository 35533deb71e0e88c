"""Joint laws: frozen data; the sweep that evaluates a law is named by `kernel` (kernels/joints.py)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from fdem.errors import SceneError, UnsupportedError
from fdem.scene.checks import number

__all__ = ["BartonBandis", "Bonded", "Coulomb", "Hertz", "Joint"]


@dataclass(frozen=True, kw_only=True)
class Joint:
    """Base of the joint laws, and of those a user writes: this data class and a kernel.

    Parameters
    ----------
    kn, ks : float, optional
        Normal and shear stiffness [Pa/m]; None lets compile choose (and say so).
    corner : float, optional
        Least size [m] of a contact: corners and edges are as stiff as a face of this size (docs/contact.md); 0: soft.

    Raises
    ------
    SceneError
        If a value is out of range.

    Notes
    -----
    A law of your own is a frozen dataclass that derives from `Joint` and says, as class attributes,

    - ``kernel``: the sweep over contact points, a function decorated with ``@fdem.kernel``; its arguments, units and
      what it has to write stand at the top of ``fdem/kernels/joints.py``;
    - ``memory``: names of the columns of history it needs beyond the six that every law has. They are saved, moved and
      restored with the contacts and are arrays of ``sim.contact_table()`` and ``sim.contacts()``;
    - ``needs``: of "bonds" (it carries tension, memory 3 tells whether the bond holds), "dilation" (memory 5 lifts the
      faces), "damping" (it reads ``mass``), "arms" (it reads ``arm``);
    - ``closure``, only if pressure is not ``kn depth``: a kernel that tells pressure, tangent stiffness and energy, and
      the property ``reach`` [m], over which closure changes the stiffness. The stable step follows the tangent;
    - ``smooth = True``, if differences of the tractions over small changes of depth and slip are their derivatives but
      for kinks: implicit integrators ask for it.

    and has the method ``properties(kn, ks)``. See ``examples/user_law.py``.
    """

    kn: float | None = None
    ks: float | None = None
    corner: float = 0.0
    kernel: ClassVar[Any] = None
    closure: ClassVar[Any] = None
    memory: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[frozenset[str] | set[str]] = frozenset()
    for_faces: ClassVar[bool] = True
    smooth: ClassVar[bool] = False

    def __post_init__(self) -> None:
        owner = type(self).__name__
        for field in ("kn", "ks"):
            if getattr(self, field) is not None:
                number(owner, field, getattr(self, field), low=0.0, open_low=field == "kn")
        number(owner, "corner", self.corner, low=0.0)

    def properties(self, kn: float, ks: float) -> tuple[float, ...]:
        """Row of the property table that the law's sweep reads; the first two are kn and ks [Pa/m]."""
        raise UnsupportedError(f"{type(self).__name__}: a law needs properties(kn, ks)")

    def hard(self) -> tuple[float, ...] | None:
        """Friction coefficient, cohesion [Pa], tension [Pa], restitution for `ContactDynamics`; None: no such law.

        Then friction coefficient and cohesion [Pa] after the cohesion or tension was exceeded.
        """
        return None

    def weakened(self, factor: float) -> Joint:
        """The law with its strength over `factor`, for `strength_reduction`.

        Parameters
        ----------
        factor : float
            Divides cohesion, tension and tangents of friction.

        Raises
        ------
        UnsupportedError
            If strength is not a number in the law.
        """
        raise UnsupportedError(f"{type(self).__name__}: a law needs weakened(factor) for a strength reduction")

    @property
    def sweep(self) -> Any:
        """Kernel of the law: a name in fdem, or the user's own."""
        return type(self).kernel  # of the class: an instance would make a method of it

    @property
    def reach(self) -> float:
        """Length [m] over which closure changes the normal stiffness; infinite: it does not."""
        return np.inf

    @property
    def damping_ratio(self) -> float:
        """Fraction of critical damping, which shortens the stable step."""
        return 0.0


@dataclass(frozen=True, kw_only=True)
class Coulomb(Joint):
    """Linear normal and shear stiffness, slip at the friction cone, brittle cohesion and tension.

    Parameters
    ----------
    kn, ks : float, optional
        Normal and shear stiffness [Pa/m]; None lets compile choose (and say so).
    corner : float, optional
        Least size [m] of a contact: corners and edges are as stiff as a face of this size (docs/contact.md); 0: soft.
    friction : float
        Friction angle [deg].
    cohesion, tension : float, optional
        Strength [Pa] of contacts that exist at compile; both are lost at the first failure, in tension or in shear.
    dilation : float, optional
        Dilation angle [deg], acts while slipping under pressure.
    dilation_limit : float, optional
        Slip [m], all slip of a contact added up, at which dilation stops.
    residual_friction : float, optional
        Friction angle after the first failure [deg], and of contacts formed later; None keeps `friction`.
    residual_cohesion : float, optional
        Cohesion left after failure, and of contacts formed later [Pa].
    restitution : float, optional
        Restitution coefficient; sets the damping of penalty contacts if given.
    damping : float, optional
        Viscous damping as a fraction of critical of the contact's normal spring, with the reduced mass of the blocks.
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

    Rolling and twisting are elastic-plastic, their couple comes on top of what pressure and friction of the patch give.
    With the area A, its second moments A S and the length L, a relative rotation in the plane of the patch is resisted
    by ``kn A (S + L^2)``, one about its normal by ``ks A (tr S + L^2)``, until the couple is L times the normal force.
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

    def __post_init__(self) -> None:
        super().__post_init__()
        number("Coulomb", "friction", self.friction, low=0.0, high=90.0, open_high=True)
        number("Coulomb", "dilation", self.dilation, low=0.0, high=90.0, open_high=True)
        for field in ("cohesion", "tension", "residual_cohesion", "damping", "rolling", "twisting"):
            number("Coulomb", field, getattr(self, field), low=0.0)
        for field, high in (("dilation_limit", np.inf), ("residual_friction", 90.0), ("restitution", 1.0)):
            if getattr(self, field) is not None:
                number("Coulomb", field, getattr(self, field), low=0.0, high=high, open_high=high == 90.0)

    @property
    def sweep(self) -> str:
        """The sweep in kernels/joints.py: contact moments have their own."""
        return "coulomb_moments" if self.rolling > 0 or self.twisting > 0 else "coulomb"

    def properties(self, kn: float, ks: float) -> tuple[float, ...]:
        """Row of the table of the sweep (kernels/joints.py)."""
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
            *((float(self.rolling), float(self.twisting)) if self.sweep == "coulomb_moments" else ()),
        )

    def hard(self) -> tuple[float, ...] | None:
        """Friction, cohesion, tension, restitution (0 if None), what is left; no rolling, twisting, dilation."""
        if self.rolling > 0.0 or self.twisting > 0.0 or self.dilation > 0.0:
            return None
        residual = self.friction if self.residual_friction is None else self.residual_friction
        whole = _tan(self.friction), float(self.cohesion), float(self.tension), float(self.restitution or 0.0)
        return *whole, _tan(residual), float(self.residual_cohesion)

    def weakened(self, factor: float) -> Coulomb:
        """Cohesion, tension and tangents of friction over `factor`, residual ones too."""
        residual = None if self.residual_friction is None else _angle(_tan(self.residual_friction) / factor)
        parts = {name: getattr(self, name) / factor for name in ("cohesion", "tension", "residual_cohesion")}
        return replace(self, friction=_angle(_tan(self.friction) / factor), residual_friction=residual, **parts)

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
    corner : float, optional
        Least size [m] of a contact: corners and edges are as stiff as a face of this size (docs/contact.md); 0: soft.
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

    def hard(self) -> tuple[float, ...]:
        """Friction, cohesion, tension and restitution of hard contact, and what is left of the first two."""
        return _tan(self.friction), float(self.shear), float(self.tension), 0.0, _tan(self.friction), 0.0

    def weakened(self, factor: float) -> Bonded:
        """Strengths and tangent of friction over `factor`."""
        friction = _angle(_tan(self.friction) / factor)
        return replace(self, friction=friction, shear=self.shear / factor, tension=self.tension / factor)


@dataclass(frozen=True, kw_only=True)
class BartonBandis(Joint):
    """A rough, unfilled rock joint: Bandis' hyperbolic closure and Barton's shear strength, which wears off.

    Parameters
    ----------
    kn : float
        Normal stiffness at no closure [Pa/m].
    ks : float, optional
        Shear stiffness [Pa/m]; None lets compile choose (and say so).
    corner : float, optional
        Least size [m] of a contact: corners and edges are as stiff as a face of this size (docs/contact.md); 0: soft.
    max_closure : float
        Closure Vm [m] that no pressure reaches.
    jrc : float
        Joint roughness coefficient, 0 to 20, at the size of the blocks.
    jcs : float
        Joint wall compressive strength [Pa], at the size of the blocks.
    residual_friction : float
        Residual friction angle [deg], at most 70.
    peak_displacement : float, optional
        Shear displacement [m] at the peak: roughness wears off with slip in multiples of it. None: it does not.
    damage : float, optional
        Damage coefficient M of Barton, by which the dilation angle is less than the roughness angle; infinite: no
        dilation.
    damping : float, optional
        Viscous damping as a fraction of critical of the normal spring at no closure.

    Raises
    ------
    SceneError
        If a value is missing or out of range.

    Notes
    -----
    Under the normal stress s and the closure d,

    - ``s = kn d / (1 - d / Vm)``; from d = 0.99 Vm on the curve goes on along its tangent. No tension.
    - ``tau = s tan(i + residual_friction)``, ``i = JRC log10(JCS / s)`` [deg], 0 where s > JCS. The angle is at most 70
      degrees, since the logarithm has no bound; towards no stress the strength so goes to zero with a slope of tan 70.
    - dilation by ``tan(i / damage)`` times the slip.
    - With a peak displacement u, JRC falls with the slip: 1, 0.85, 0.7, 0.5, 0.4 and 0 times its value at slips of 0,
      1, 3, 9, 24 and 99 u, straight between. What comes before the peak is elastic, by ``ks``.
    - Contacts formed later have the same law: their slip starts from zero.

    References
    ----------
    Bandis, Lumsden, Barton (1983), Int. J. Rock Mech. Min. Sci. 20, 249-268 (closure); Barton, Choubey (1977), Rock
    Mechanics 10, 1-54 (strength); Barton (1976), Int. J. Rock Mech. Min. Sci. 13, 255-279 (70 degrees); Barton, Bandis,
    Bakhtar (1985), Int. J. Rock Mech. Min. Sci. 22, 121-140 (mobilised JRC, dilation).
    """

    max_closure: float
    jrc: float
    jcs: float
    residual_friction: float
    peak_displacement: float | None = None
    damage: float = 2.0
    damping: float = 0.0
    kernel: ClassVar[str] = "barton_bandis"

    def __post_init__(self) -> None:
        super().__post_init__()
        for field in ("kn", "max_closure", "jcs"):
            number("BartonBandis", field, getattr(self, field), low=0.0, open_low=True)
        number("BartonBandis", "jrc", self.jrc, low=0.0, high=20.0)
        number("BartonBandis", "residual_friction", self.residual_friction, low=0.0, high=70.0)
        number("BartonBandis", "damage", self.damage, low=1.0, infinite=True)
        number("BartonBandis", "damping", self.damping, low=0.0)
        if self.peak_displacement is not None:
            number("BartonBandis", "peak_displacement", self.peak_displacement, low=0.0, open_low=True)

    def properties(self, kn: float, ks: float) -> tuple[float, ...]:
        """Row of the table of the "barton_bandis" sweep (kernels/joints.py)."""
        peak = np.inf if self.peak_displacement is None else float(self.peak_displacement)
        most, jrc, jcs = float(self.max_closure), float(self.jrc), float(self.jcs)
        return kn, ks, most, jrc, jcs, float(self.residual_friction), peak, 1.0 / self.damage, float(self.damping)

    @property
    def damping_ratio(self) -> float:
        """Fraction of critical damping."""
        return float(self.damping)


@dataclass(frozen=True, kw_only=True)
class Hertz(Joint):
    """Elastic contact of spheres by Hertz, friction by a simplified Mindlin spring with history; for spheres only.

    Parameters
    ----------
    kn, ks : None
        Not to be given: the stiffness follows from the elastic constants.
    corner : float, optional
        Of no use for spheres.
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

    def weakened(self, factor: float) -> Hertz:
        """Tangent of friction over `factor`."""
        return replace(self, friction=_angle(_tan(self.friction) / factor))

    @property
    def damping_ratio(self) -> float:
        """Fraction of critical damping of the contact, as that of a linear one (contact/particles.py)."""
        return _damping_of(float(self.restitution))


def _angle(tangent: float) -> float:
    return float(np.degrees(np.arctan(tangent)))


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
