"""When something is recorded, what can be recorded by name, and the record itself.

An *observer* has ``next(step, t, dt) -> int``, the number of steps until it is due (at least one),
and ``record(view)``, called by the simulation when that step has been done.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fdem.errors import SceneError

__all__ = [
    "NEVER",
    "QUANTITIES",
    "Every",
    "History",
    "Observer",
    "Quantity",
    "adapted",
    "as_every",
    "quantity",
    "watch",
]

NEVER = 2**62  # steps until something that does not come

Array = NDArray[np.float64]


class Observer(Protocol):
    """Anything a simulation can be asked to call now and then."""

    def next(self, step: int, t: float, dt: float) -> int:
        """Give the steps from `step` until `record` is due, at least one."""

    def record(self, view: Any) -> None:
        """Take what is wanted from the simulation, which must not be changed."""


@dataclass(frozen=True)
class Every:
    """A trigger that comes back regularly: every so many steps, or every so much time.

    Parameters
    ----------
    steps : int, optional
        Due at every multiple of so many steps.
    time : float, optional
        Due at the first step that reaches a multiple of so much time [s].

    Raises
    ------
    SceneError
        Unless exactly one of the two is given, and positive.

    Examples
    --------
    >>> Every(steps=10).next(step=13, t=0.0, dt=1e-3)
    7
    >>> Every(time=0.01).next(step=13, t=0.013, dt=1e-3)
    7
    """

    steps: int | None = None
    time: float | None = None

    def __post_init__(self) -> None:
        if (self.steps is None) == (self.time is None):
            raise SceneError(f"Every: give either steps or time, got steps={self.steps!r}, time={self.time!r}")
        if self.steps is not None:
            whole = isinstance(self.steps, (int, np.integer)) and not isinstance(self.steps, bool)
            if not whole or self.steps < 1:
                raise SceneError(f"Every: steps must be a whole number >= 1, got {self.steps!r}")
        elif not (isinstance(self.time, (int, float, np.number)) and math.isfinite(self.time) and self.time > 0):
            raise SceneError(f"Every: time must be a positive number of seconds, got {self.time!r}")

    def next(self, step: int, t: float, dt: float) -> int:
        """Count the steps until due.

        Parameters
        ----------
        step : int
            Steps done so far.
        t : float
            Time now [s].
        dt : float
            Length of the coming steps [s]; 0 if time stands still.

        Returns
        -------
        int
            At least 1; `NEVER` for a time trigger while time stands still.
        """
        if self.steps is not None:
            return int(self.steps - step % self.steps)
        if not dt > 0.0:
            return NEVER
        period = float(self.time)  # type: ignore[arg-type]
        # A sum of many dt misses a multiple of the period by round-off: what lies within 1e-6 dt of
        # one counts as there, in both directions.
        slack = 1e-6 * dt
        due = (math.floor((t + slack) / period) + 1) * period
        return max(1, min(NEVER, math.ceil((due - t - slack) / dt)))


def as_every(value: Every | int | None) -> Every:
    """Make a trigger of what a user gives: an `Every`, a number of steps, or None for each step."""
    if isinstance(value, Every):
        return value
    if isinstance(value, float):
        raise SceneError(f"every: {value!r} is ambiguous; a number of steps is whole, a time is Every(time={value!r})")
    return Every(steps=1 if value is None else value)


# ---------------------------------------------------------------------------------------------------------------------
# quantities by name


@dataclass(frozen=True)
class Quantity:
    """A named quantity: where it is read, its unit and its components.

    Parameters
    ----------
    path : str
        Dotted attribute of the view it is read from.
    unit : str
        Unit, "-" if none.
    kind : {"scalar", "vector", "voigt", "matrix"}
        Names of the components: none; x y z; xx yy zz yz zx xy; row and column, as in "xy".
    where : {"block", "simulation"}
        Whether it belongs to the view of blocks or gridpoints, or to the simulation as a whole.
    """

    path: str
    unit: str
    kind: str = "vector"
    where: str = "block"


QUANTITIES: dict[str, Quantity] = {
    "position": Quantity("position", "m"),
    "displacement": Quantity("displacement", "m"),
    "velocity": Quantity("velocity", "m/s"),
    "acceleration": Quantity("acceleration", "m/s^2"),
    "rotation": Quantity("rotation", "-", "matrix"),
    "rotation_vector": Quantity("rotation_vector", "rad"),
    "angular_velocity": Quantity("angular_velocity", "rad/s"),
    "angular_momentum": Quantity("angular_momentum", "kg m^2/s"),
    "mass": Quantity("mass", "kg", "scalar"),
    "inertia": Quantity("inertia", "kg m^2", "matrix"),
    "strain": Quantity("strain", "-", "voigt"),
    "stress": Quantity("stress", "Pa", "voigt"),
    "contact_force": Quantity("contact_force", "N"),
    "force": Quantity("force", "N"),
    "gridpoints": Quantity("gridpoints", "m"),
    "gridpoint_displacement": Quantity("gridpoint_displacement", "m"),
    "zone_stress": Quantity("zone_stress", "Pa", "voigt"),
    "zone_strain": Quantity("zone_strain", "-", "voigt"),
    "zone_rotation": Quantity("zone_rotation", "rad"),
    "ratio": Quantity("ratio", "-", "scalar", "simulation"),
    "dt": Quantity("dt", "s", "scalar", "simulation"),
    "closure": Quantity("energy.closure", "-", "scalar", "simulation"),
    "unbalanced_ratio": Quantity("ratio", "-", "scalar", "simulation"),
    "strain_energy": Quantity("energy.strain", "J", "scalar", "simulation"),
}
for _name in ("kinetic", "joint", "potential", "friction", "damping", "work"):
    QUANTITIES[_name] = Quantity(f"energy.{_name}", "J", "scalar", "simulation")

_VOIGT = {"xx": 0, "yy": 1, "zz": 2, "yz": 3, "zx": 4, "xy": 5, "zy": 3, "xz": 4, "yx": 5}
_AXES = {"x": 0, "y": 1, "z": 2}


def quantity(name: str, component: str | int | None = None) -> tuple[Callable[[Any], Any], str]:
    """Look a quantity up by name.

    Parameters
    ----------
    name : str
        A key of `QUANTITIES`; blanks and underscores are the same.
    component : str or int, optional
        "x", "y", "z" of a vector, "xx", ... of a stress, strain or matrix, "magnitude" (Euclidean
        norm) of a vector, or an index. None takes all of them.

    Returns
    -------
    getter : callable
        From a view (of blocks, of a gridpoint, or the simulation: `Quantity.where`) to a float or
        an array; of a view of many blocks the rows are blocks.
    unit : str
        Its unit.

    Raises
    ------
    SceneError
        If there is no quantity or component of that name.
    """
    known = _find(name)
    pick = _picker(name, known.kind, component)
    path = known.path.split(".")

    def getter(view: Any) -> Any:
        value = view
        for attribute in path:
            value = getattr(value, attribute)
        return pick(np.asarray(value, dtype=np.float64))

    return getter, known.unit


def _find(name: str) -> Quantity:
    known = QUANTITIES.get(name.replace(" ", "_"))
    if known is not None:
        return known
    raise SceneError(f"history: unknown quantity {name!r}; known: {', '.join(sorted(QUANTITIES))}")


def _picker(name: str, kind: str, component: str | int | None) -> Callable[[Array], Any]:
    """Make the function that takes the wanted component of a (..., k) or (..., 3, 3) array."""
    if component is None:
        return lambda a: a
    n = {"scalar": 0, "vector": 3, "voigt": 6, "matrix": 9}[kind]
    if component == "magnitude" and kind == "vector":
        return lambda a: np.sqrt((a * a).sum(axis=-1))
    i: int | None = None
    if isinstance(component, (int, np.integer)):
        i = int(component) if 0 <= component < n else None
    elif kind == "vector":
        i = _AXES.get(component)
    elif kind == "voigt":
        i = _VOIGT.get(component)
    elif kind == "matrix" and len(component) == 2 and set(component) <= set(_AXES):
        i = 3 * _AXES[component[0]] + _AXES[component[1]]
    if i is None:
        allowed = {
            "scalar": "none: it is a scalar",
            "vector": "x, y, z, magnitude, 0 to 2",
            "voigt": "xx, yy, zz, yz, zx, xy, 0 to 5",
            "matrix": "xx, xy, ... zz (row, column), 0 to 8",
        }[kind]
        raise SceneError(f"history: {name!r} has no component {component!r}; allowed: {allowed}")
    index = i
    if kind == "matrix":
        return lambda a: a[..., index // 3, index % 3]
    return lambda a: a[..., index]


# ---------------------------------------------------------------------------------------------------------------------
# the record


class History:
    """One quantity over time.

    Parameters
    ----------
    sample : callable
        From the simulation to a float or an array that keeps its shape.
    every : Every, int or None, optional
        When to record; None is each step.
    name : str, optional
        What it is called in a legend.
    unit : str, optional
        Unit of the values.

    Examples
    --------
    >>> history = History(lambda view: view.time**2, every=2, name="square", unit="s^2")
    """

    def __init__(
        self, sample: Callable[[Any], Any], every: Every | int | None = None, name: str = "", unit: str = "-"
    ) -> None:
        self.every = as_every(every)
        self.name = name
        self.unit = unit
        self._sample = sample
        self._n = 0
        self._steps = np.empty(64, dtype=np.int64)
        self._time = np.empty(64)
        self._values: Array | None = None

    def next(self, step: int, t: float, dt: float) -> int:
        """Count the steps until due (see `Every.next`)."""
        return self.every.next(step, t, dt)

    def record(self, view: Any) -> None:
        """Append the state of now; a second record of the same step replaces the first."""
        value = np.asarray(self._sample(view), dtype=np.float64)
        if self._values is None:
            self._values = np.empty((len(self._steps), *value.shape))
        if value.shape != self._values.shape[1:]:
            raise SceneError(f"history {self.name!r}: shape changed from {self._values.shape[1:]} to {value.shape}")
        if self._n and self._steps[self._n - 1] == view.steps and self._time[self._n - 1] == view.time:
            self._n -= 1
        if self._n == len(self._steps):
            self._grow()
        self._steps[self._n] = view.steps
        self._time[self._n] = view.time
        self._values[self._n] = value
        self._n += 1

    def _grow(self) -> None:
        """Double the buffers."""
        assert self._values is not None
        self._steps = np.concatenate([self._steps, np.empty_like(self._steps)])
        self._time = np.concatenate([self._time, np.empty_like(self._time)])
        self._values = np.concatenate([self._values, np.empty_like(self._values)])

    @property
    def time(self) -> Array:
        """Times of the records [s], (n,)."""
        return self._time[: self._n].copy()

    @property
    def steps(self) -> NDArray[np.int64]:
        """Step numbers of the records, (n,)."""
        return self._steps[: self._n].copy()

    @property
    def values(self) -> Array:
        """Recorded values [`unit`], (n,) or (n, ...)."""
        return np.empty(0) if self._values is None else self._values[: self._n].copy()

    def to_numpy(self) -> Array:
        """Time and values side by side, (n, 1 + number of components)."""
        return np.column_stack([self.time, self.values.reshape(self._n, -1)])

    def __len__(self) -> int:
        """Count the records."""
        return self._n

    def __repr__(self) -> str:
        """Name, unit and length."""
        return f"History({self.name!r}, unit={self.unit!r}, records={self._n})"


class _WithoutStep:
    """An observer whose ``next`` takes no length of the step."""

    def __init__(self, observer: Any) -> None:
        self._observer = observer
        self.record = observer.record

    def next(self, step: int, t: float, dt: float) -> int:
        """Steps until due."""
        return int(self._observer.next(step, t))


def adapted(observer: Any) -> Any:
    """The observer itself, or one that drops the length of the step if its ``next`` takes none."""
    try:
        signature(observer.next).bind(0, 0.0, 0.0)
    except TypeError:
        return _WithoutStep(observer)
    return observer


def watch(target: Any, name: str | None, component: str | int | None, every: Every | int | None) -> History:
    """History of what `Simulation.history` was asked for: a callable, a quantity of all, or one of a target."""
    if callable(target):
        return History(target, every, name or "")
    if name is None:
        getter, unit = quantity(target, component)
        return History(getter, every, str(target), unit)
    getter, unit = quantity(name, component)
    return History(lambda sim: getter(sim[target]), every, name, unit)
