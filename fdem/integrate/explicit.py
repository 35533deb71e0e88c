"""Explicit (leapfrog) and Relaxation (the same loop with scaled masses), and their damping."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdem.errors import FdemWarning, SceneError, UnsupportedError
from fdem.integrate.sleep import Sleep, work_of
from fdem.integrate.substeps import Substeps

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
    substeps : int, optional
        Largest number of steps, a power of two, after which the forces of a block with a larger stable step than
        others are found again. The steps of the simulation are then those after which all blocks are in step; `dt` is
        still that of the fastest blocks. 1: all forces in every step.

    Raises
    ------
    SceneError
        If `dt` or `safety` is not positive, or `substeps` no power of two.
    UnsupportedError
        Sub-steps with a damping that feels forces (`Local`, stiffness-proportional), sleep or joints that stiffen.

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
    substeps: int = 1
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
        self.rates: Substeps | None = None
        self._check_substeps()

    def _check_substeps(self) -> None:
        n = self.substeps
        if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 1 or n & (n - 1):
            raise SceneError(f"{type(self).__name__}: substeps = {n!r}, allowed are powers of two")
        if n == 1:
            return
        stiff = isinstance(self.damping, Rayleigh) and self.damping.stiffness == 0.0
        if self.damping is not None and not stiff:
            raise UnsupportedError(
                f"Explicit: damping = {self.damping!r} feels the forces of every step; substeps = {n} needs None or "
                "mass-proportional damping"
            )
        if self.sleep is not None:
            raise UnsupportedError(f"Explicit: substeps = {n} with sleep; choose one of them")
        self.take_turns = self._turned

    @property
    def _every(self) -> int:
        """Sub-steps in a step."""
        return 1 if self.rates is None else self.rates.every

    def _turned(self) -> list[np.ndarray]:
        """Rotation vectors of the last step, of the batches that turn."""
        assert self.rates is not None
        return self.rates.turned

    def start(self, system: Any) -> None:
        """Prepare the damping and find the step."""
        self._damping.start(system)
        self._forces, self._advance = work_of(system, self.sleep)
        self._shorten = _safe if system.stiffening and self.dt is None and not self.scaled else _unchanged
        self._take = self._whole_step
        if self.substeps > 1:
            self.rates = Substeps(system, self._damping, self.substeps)
            self._take = self.rates.step
        self.refresh(system)

    def refresh(self, system: Any) -> None:
        """Find the stable step again after contacts have changed."""
        limits = self._limits(system)
        limit = float(limits.min(initial=np.inf))
        if self.dt is None:
            wanted = min(self.safety * limit, system.unseen_motion())
            # in free flight the step stays what it was
            self.step_length = wanted if np.isfinite(wanted) else getattr(self, "step_length", wanted) / self._every
        else:
            self.step_length = self.dt
            if self.dt > limit and not getattr(self, "_warned", False):
                self._warned = True
                warnings.warn(
                    f"Explicit: dt = {self.dt:.4g} s is above {limit:.4g} s, the largest step known to be stable",
                    FdemWarning,
                    stacklevel=2,
                )
        if self.rates is not None:
            self.rates.choose(self.safety * limits, self.step_length, system.unseen_motion())
            self.step_length *= self._every
        system.stale = False

    def settle(self, system: Any) -> None:
        """Bring what goes at rates of its own to the same time."""
        if self.rates is not None:
            self.rates.settle()

    def watch(self, system: Any, error: float, turned: float) -> None:
        """See whether sub-steps make energy: `error` of the balance [J], of what was `turned` over."""
        if self.rates is not None and self.rates.watch(error, turned):
            self.refresh(system)

    def kept(self) -> dict[str, np.ndarray]:
        """What a saved state needs besides the arrays of the system."""
        return {} if self.rates is None else self.rates.kept()

    def restore(self, arrays: dict[str, Any]) -> None:
        """Take back what `kept` returned."""
        if self.rates is not None and arrays:
            self.rates.restore(arrays)

    def restrain(self, system: Any, dt: float) -> None:
        """Real velocities stay as they are."""

    def limit(self, system: Any) -> float:
        """Largest step known to be stable [s]; infinite without any stiffness."""
        return float(self._limits(system).min(initial=np.inf))

    def _limits(self, system: Any) -> np.ndarray:
        """Largest steps (n_blocks,) [s] known to be stable for every block."""
        omega, rate = np.sqrt(system.block_frequencies()), system.dashpot_rate()
        fastest = float(omega.max(initial=0.0))
        if fastest == 0.0:
            return np.full(len(omega), 2.0 / rate if rate > 0 else np.inf)
        zeta = max(system.model.damping_ratio, 0.5 * rate / fastest)
        with np.errstate(divide="ignore", invalid="ignore"):
            if isinstance(self.damping, Rayleigh):
                zeta = zeta + 0.5 * self.damping.stiffness * omega
            limits = 2.0 / omega * (np.sqrt(1.0 + zeta * zeta) - zeta) / np.sqrt(_swing(self.damping))
        return np.where(omega > 0.0, limits, np.inf)

    def step(self, system: Any, dt: float) -> None:
        """One step of `dt` [s], or shorter where joints stiffen as they close."""
        self._take(system, dt)
        if system.stale:
            system.stale = False
            if system.stiffened() or (self.rates is not None and self.step_length > system.unseen_motion()):
                self.refresh(system)
            elif self.dt is None and not self.scaled:
                self.step_length = min(self.step_length, system.unseen_motion())

    def _whole_step(self, system: Any, dt: float) -> None:
        self._forces()
        dt = self._shorten(system, dt)
        h = system.lag + 0.5 * dt
        self._damping.kick(system, h)
        self.restrain(system, dt)
        system.commit()
        system.prescribe(dt)
        self._advance(dt)
        system.lag = 0.5 * dt


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
    substeps: int = field(default=1, init=False, repr=False)

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
