"""Explicit (leapfrog) and Relaxation (the same loop with scaled masses), and their damping."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdem.errors import FdemWarning, SceneError
from fdem.integrate.sleep import Sleep, work_of

__all__ = ["Adaptive", "Explicit", "Local", "Rayleigh", "Relaxation"]


def _check(owner: str, name: str, value: Any, low: float, high: float = np.inf) -> None:
    known = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    if not known or not low <= value <= high or not np.isfinite(value):
        raise SceneError(f"{owner}: {name} = {value!r}, allowed is a finite number in [{low:g}, {high:g}]")


@dataclass(frozen=True)
class Local:
    """Local damping: a force against each velocity component, a share of the unbalanced force.

    Parameters
    ----------
    coefficient : float, optional
        Share alpha of the unbalanced force, in [0, 1).

    Notes
    -----
    ``f_d = -alpha |f| sign(v)`` (Cundall 1987), with the velocity at the time of the force: the
    half-step value locks forces in.
    """

    coefficient: float = 0.8

    def __post_init__(self) -> None:
        _check("Local", "coefficient", self.coefficient, 0.0, 1.0 - 1e-12)

    def start(self, system: Any) -> None:
        """Nothing to prepare."""

    def kick(self, system: Any, h: float) -> None:
        """Change the velocities by the accelerations over `h` [s]."""
        v, f = system.state.v, system.state.f
        before = v + system.lag * system.accelerate(f)
        free = f.copy()
        system.constraints.release(free)
        resist = system.resist(self.coefficient, free, before)
        a = system.accelerate(f - resist)
        system.damped += h * float(resist @ (v + 0.5 * h * a))
        # fictitious masses and time know no drag, and it is gone at rest
        if system.alpha is None or system.scaled[0] is not None:
            v += h * a
        else:
            _centred(system, h, a, system.alpha, None)


@dataclass(frozen=True)
class Adaptive:
    """Viscous damping of `Relaxation` that stays near critical for the slowest mode still moving.

    Notes
    -----
    ``C = 2 omega M`` on the scaled masses, with omega from the Rayleigh quotient of the present motion,
    ``omega^2 = v.K v / v.M v`` and ``K v dt = f(n-1) - f(n)`` (Underwood, Dynamic relaxation, 1983). Fast modes
    die first, then the quotient follows the slower ones: about five times fewer cycles than `Local` for
    slender blocks. Local damping is the choice where blocks come apart or move on their own.
    """

    every: int = field(default=10, init=False, repr=False)

    def start(self, system: Any) -> None:
        """Start strongly damped: sudden loads must not make joints slip by rebound."""
        system.omega, system.force_before = 0.5, None

    def kick(self, system: Any, h: float) -> None:
        """Change the velocities by the accelerations over `h` [s]."""
        v, f = system.state.v, system.state.f
        phase = system.state.step % self.every
        if phase == self.every - 1 or phase == 0:
            free = f.copy()
            system.constraints.release(free)
            if phase == 0 and system.force_before is not None:
                self._measure(system, system.force_before - free)
            system.force_before = free if phase else None
        # below the rate at which a step would turn velocities round
        half = min(system.omega * h, 0.95)
        middle = 0.5 * v
        v *= (1.0 - half) / (1.0 + half)
        v += h / (1.0 + half) * system.accelerate(f)
        middle += 0.5 * v
        system.damped += 2.0 * half * system.scaled_kinetic(middle)

    def _measure(self, system: Any, change: np.ndarray) -> None:
        v = system.state.v.copy()
        system.constraints.still(v)
        twice = system.scaled_kinetic(v)
        if twice > 0.0:
            system.omega = float(np.sqrt(max(change @ v, 0.0) / (system.dt * twice)))


@dataclass(frozen=True)
class Rayleigh:
    """Viscous damping proportional to mass and stiffness: C = mass M + stiffness K.

    Parameters
    ----------
    mass : float, optional
        [1/s].
    stiffness : float, optional
        [s]; it lags half a step, which shortens the stable step (NUMERICS.md section 5).
    """

    mass: float = 0.0
    stiffness: float = 0.0

    def __post_init__(self) -> None:
        _check("Rayleigh", "mass", self.mass, 0.0)
        _check("Rayleigh", "stiffness", self.stiffness, 0.0)

    def start(self, system: Any) -> None:
        """Keep the elastic forces, whose rate is the stiffness-proportional part."""
        if self.stiffness > 0 and system.elastic is None:
            system.elastic = np.zeros_like(system.state.f)
        system.rate = self.mass if system.alpha is None else self.mass + system.alpha

    def kick(self, system: Any, h: float) -> None:
        """Change the velocities by the accelerations over `h` [s], mass damping centred."""
        v, f = system.state.v, system.state.f
        viscous = np.zeros_like(v)
        if self.stiffness > 0:
            if system.elastic_old is None:
                system.elastic_old = system.elastic.copy()
            elif system.dt > 0:
                viscous = self.stiffness / system.dt * (system.elastic - system.elastic_old)
        a = system.accelerate(f + viscous)
        _centred(system, h, a, system.rate, viscous)


@dataclass(frozen=True)
class _Braked:
    """A damping of `Relaxation`, after which blocks go no faster than joints that stiffen as they close can take."""

    damping: Any
    dt: float

    def kick(self, system: Any, h: float) -> None:
        """Change the velocities by the accelerations over `h`, then slow down."""
        self.damping.kick(system, h)
        system.brake(self.dt)


@dataclass(frozen=True)
class _Undamped:
    """No damping; mass-proportional drag of the scene is applied if there is one."""

    def start(self, system: Any) -> None:
        """Nothing to prepare."""

    def kick(self, system: Any, h: float) -> None:
        """Change the velocities by the accelerations over `h` [s]."""
        if system.alpha is None:
            system.kick(h)
        else:
            _centred(system, h, system.accelerate(system.state.f), system.alpha, None)


def _centred(system: Any, h: float, a: np.ndarray, alpha: Any, viscous: np.ndarray | None) -> None:
    """Velocity update with damping ``-alpha v`` at the middle of the step; its loss goes to the ledger."""
    v = system.state.v
    new = ((1.0 - 0.5 * alpha * h) * v + h * a) / (1.0 + 0.5 * alpha * h)
    middle = 0.5 * (v + new)
    loss = sum(b.kinetic(system.state.q, np.sqrt(2.0 * h * np.asarray(alpha)) * middle) for b in system.model.batches)
    if viscous is not None:
        loss -= h * float(viscous @ middle)
    system.damped += loss
    v[:] = new


def _safe(system: Any, dt: float) -> float:
    """Step in which no joint stiffens by more than its law allows."""
    return min(dt, float(system.safe_closing()))


def _unchanged(system: Any, dt: float) -> float:
    """Return the step as it is."""
    return dt


def _swing(damping: Any) -> float:
    """Largest factor on a spring's force: local damping adds its share wherever the motion slows down."""
    return 1.0 + damping.coefficient if isinstance(damping, Local) else 1.0


@dataclass
class Explicit:
    """Leapfrog: positions and half-step velocities, second order, momentum exact.

    Parameters
    ----------
    dt : float, optional
        Time step [s]. None: chosen below the stable limit and kept there as contacts change.
    safety : float, optional
        Share of the estimated limit used when `dt` is None.
    damping : Local or Rayleigh, optional
        Numerical damping.
    sleep : Sleep, optional
        Let blocks at rest sleep.

    Raises
    ------
    SceneError
        If `dt` or `safety` is not positive.

    Notes
    -----
    ``v(n+1/2) = v(n-1/2) + dt M^-1 f(n)``, ``q(n+1) = q(n) + dt v(n+1/2)``; stable for
    ``dt < 2/omega_max``. With damping that lags half a step the limit is
    ``(2/omega)(sqrt(1 + zeta^2) - zeta)``.
    """

    dt: float | None = None
    safety: float = 0.8
    damping: Local | Rayleigh | Adaptive | None = None
    sleep: Sleep | None = None
    scaled: bool = field(default=False, init=False, repr=False)

    def __post_init__(self) -> None:
        owner = type(self).__name__
        if self.dt is not None:
            _check(owner, "dt", self.dt, np.finfo(float).tiny)
        _check(owner, "safety", self.safety, np.finfo(float).tiny, 1.0)
        if self.damping is not None and not isinstance(self.damping, (Local, Rayleigh, Adaptive)):
            raise SceneError(f"{owner}: damping = {self.damping!r}, allowed are Local, Rayleigh and Adaptive")
        if isinstance(self.damping, Adaptive) and not isinstance(self, Relaxation):
            raise SceneError(f"{owner}: damping = {self.damping!r} is for Relaxation")
        if self.sleep is not None and not isinstance(self.sleep, Sleep):
            raise SceneError(f"{owner}: sleep = {self.sleep!r}, allowed is a Sleep")
        self._damping: Any = self.damping or _Undamped()

    def start(self, system: Any) -> None:
        """Prepare the damping and find the step."""
        self._damping.start(system)
        self._forces, self._advance = work_of(system, self.sleep)
        self._shorten = _safe if system.stiffening and self.dt is None and not self.scaled else _unchanged
        self.refresh(system)

    def refresh(self, system: Any) -> None:
        """Find the stable step again after contacts have changed."""
        limit = self.limit(system)
        if self.dt is None:
            wanted = min(self.safety * limit, system.unseen_motion())
            # in free flight the step stays what it was
            self.step_length = wanted if np.isfinite(wanted) else getattr(self, "step_length", wanted)
        else:
            self.step_length = self.dt
            if self.dt > limit and not getattr(self, "_warned", False):
                self._warned = True
                warnings.warn(
                    f"Explicit: dt = {self.dt:.4g} s is above {limit:.4g} s, the largest step known to be stable",
                    FdemWarning,
                    stacklevel=2,
                )
        system.stale = False

    def restrain(self, system: Any, dt: float) -> None:
        """Real velocities stay as they are."""

    def limit(self, system: Any) -> float:
        """Largest step known to be stable [s]; infinite without any stiffness."""
        omega = float(np.sqrt(system.block_frequencies().max(initial=0.0)))
        rate = system.dashpot_rate()
        if omega == 0.0:
            return 2.0 / rate if rate > 0 else np.inf
        zeta = max(system.model.damping_ratio, 0.5 * rate / omega)
        if isinstance(self.damping, Rayleigh):
            zeta += 0.5 * self.damping.stiffness * omega
        return 2.0 / omega * (np.sqrt(1.0 + zeta * zeta) - zeta) / np.sqrt(_swing(self.damping))

    def step(self, system: Any, dt: float) -> None:
        """One step of `dt` [s], or shorter where joints stiffen as they close."""
        self._forces()
        dt = self._shorten(system, dt)
        h = system.lag + 0.5 * dt
        self._damping.kick(system, h)
        self.restrain(system, dt)
        system.commit()
        system.prescribe(dt)
        self._advance(dt)
        system.lag = 0.5 * dt
        if system.stale:
            system.stale = False
            if system.stiffened():
                self.refresh(system)
            elif self.dt is None and not self.scaled:
                self.step_length = min(self.step_length, system.unseen_motion())


@dataclass
class Relaxation(Explicit):
    """Dynamic relaxation: the explicit loop with masses scaled to one stable step, to equilibrium.

    Parameters
    ----------
    damping : Local, optional
        Damping that takes the kinetic energy out.

    Notes
    -----
    Time is fictitious. `Simulation.solve` stops by the unbalanced force ratio, the kinetic energy
    and the displacement still to come (NUMERICS.md section 10).
    """

    dt: float | None = field(default=None, init=False)
    safety: float = field(default=0.8, init=False)
    damping: Local | Rayleigh | Adaptive | None = field(default_factory=Local)
    sleep: Sleep | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.scaled = True

    def start(self, system: Any) -> None:
        """Prepare the damping and scale the masses."""
        plain = self._damping = self.damping or _Undamped()
        super().start(system)
        self._damping = _Braked(plain, self.step_length) if system.stiffening else plain

    def refresh(self, system: Any) -> None:
        """Scale the masses again after contacts have changed."""
        system.scale_masses(_swing(self.damping))
        self.step_length = 2.0 * self.safety
        system.stale = False

    def restrain(self, system: Any, dt: float) -> None:
        """Slow down what falls freely: a fictitious speed may not carry a block unseen into another."""
        system.slow_down(dt)
