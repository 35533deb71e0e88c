"""Loads, prescribed motion and in-situ stress: what acts on a scene from outside."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fdem.errors import SceneError
from fdem.scene.checks import number, vector

__all__ = ["Displacement", "Drag", "Force", "Moment", "Pressure", "Stress", "Support", "Traction", "Velocity"]

Place = Callable[[np.ndarray], np.ndarray]


def _value(owner: str, value: Any, sizes: tuple[int, ...]) -> None:
    if not callable(value):
        vector(owner, "value", value, sizes)


@dataclass(frozen=True)
class Force:
    """A force [N], the total over the selection, shared by gridpoint mass.

    Parameters
    ----------
    value : (3,) array or callable
        Force [N]; a callable is a function of place (n, 3) -> (n, 3), evaluated at the gridpoints.
    at : (3,) array, optional
        The material point it acts at [m].

    Raises
    ------
    SceneError
        If a value is not finite.
    """

    value: Sequence[float] | Place
    at: Sequence[float] | None = None

    def __post_init__(self) -> None:
        _value("Force", self.value, (3,))
        if self.at is not None:
            vector("Force", "at", self.at)


@dataclass(frozen=True)
class Moment:
    """A moment [N m] about the centroid of whole blocks (the total over the selection).

    Parameters
    ----------
    value : (3,) array
        Moment [N m], global axes.

    Raises
    ------
    SceneError
        If the value is not finite.
    """

    value: Sequence[float]

    def __post_init__(self) -> None:
        vector("Moment", "value", self.value)


@dataclass(frozen=True)
class Traction:
    """A traction on faces [Pa], per area of the undeformed face.

    Parameters
    ----------
    value : (3,) or (6,) array or callable
        Global traction, or a stress (xx yy zz yz zx xy) whose traction is t = sigma n.

    Raises
    ------
    SceneError
        If the value is not finite.
    """

    value: Sequence[float] | Place

    def __post_init__(self) -> None:
        _value("Traction", self.value, (3, 6))


@dataclass(frozen=True)
class Pressure:
    """A pressure [Pa] pushing inward; it follows the face. On a joint set: on both faces.

    Parameters
    ----------
    value : float or callable
        Pressure [Pa]; a callable is a function of place (n, 3) -> (n,).

    Raises
    ------
    SceneError
        If the value is not finite.
    """

    value: float | Place

    def __post_init__(self) -> None:
        if not callable(self.value):
            number("Pressure", "value", self.value)


@dataclass(frozen=True)
class Velocity:
    """Prescribed velocity [m/s]; None inside `value` leaves that component free.

    Parameters
    ----------
    value : (3,) sequence of float or None, or callable
        Velocity [m/s]; a callable is a function of place (n, 3) -> (n, 3).
    angular : (3,) array, optional
        Angular velocity [rad/s] about the centroid, for rigid and fixed blocks.

    Raises
    ------
    SceneError
        If a value is not finite.
    """

    value: Sequence[float | None] | Place
    angular: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if not callable(self.value):
            vector("Velocity", "value", [0.0 if v is None else v for v in self.value])
        if self.angular is not None:
            vector("Velocity", "angular", self.angular)


@dataclass(frozen=True)
class Displacement:
    """Prescribed displacement [m] from the start, approached slowly; None leaves a component free.

    Parameters
    ----------
    value : (3,) sequence of float or None, or callable
        Displacement [m]; a callable is a function of place (n, 3) -> (n, 3).

    Raises
    ------
    SceneError
        If a value is not finite.
    """

    value: Sequence[float | None] | Place

    def __post_init__(self) -> None:
        if not callable(self.value):
            vector("Displacement", "value", [0.0 if v is None else v for v in self.value])


@dataclass(frozen=True)
class Drag:
    """Dashpots: on faces (the quiet boundary of Lysmer and Kuhlemeyer), or on the mass of a block.

    Parameters
    ----------
    normal, shear : float, optional
        Traction per velocity [Pa s/m]; None: rho c_p and rho c_s of the block.
    mass : float, optional
        Instead: a force -mass m v on the block [1/s].

    Raises
    ------
    SceneError
        If a value is negative, or `mass` comes with a face value.
    """

    normal: float | None = None
    shear: float | None = None
    mass: float | None = None

    def __post_init__(self) -> None:
        for field in ("normal", "shear", "mass"):
            if getattr(self, field) is not None:
                number("Drag", field, getattr(self, field), low=0.0)
        if self.mass is not None and (self.normal is not None or self.shear is not None):
            raise SceneError("Drag: mass excludes normal and shear")


@dataclass(frozen=True)
class Support:
    """Elastic bedding of faces.

    Parameters
    ----------
    normal, shear : float, optional
        Stiffness [Pa/m] along and across the face normal.

    Raises
    ------
    SceneError
        If a value is negative.
    """

    normal: float = 0.0
    shear: float = 0.0

    def __post_init__(self) -> None:
        for field in ("normal", "shear"):
            number("Support", field, getattr(self, field), low=0.0)


@dataclass(frozen=True)
class Stress:
    """In-situ stress [Pa], tension positive: starts zones, strained blocks and contact tractions.

    Parameters
    ----------
    xx, yy, zz, yz, zx, xy : float or callable
        Components [Pa]; a callable is a function of place (n, 3) -> (n,).
    k : (2,) sequence or callable, optional
        (kx, ky): xx and yy as multiples of zz.

    Raises
    ------
    SceneError
        If a value is not finite, or `k` comes with xx or yy.
    """

    xx: float | Place = 0.0
    yy: float | Place = 0.0
    zz: float | Place = 0.0
    yz: float | Place = 0.0
    zx: float | Place = 0.0
    xy: float | Place = 0.0
    k: Sequence[float] | Place | None = None

    def __post_init__(self) -> None:
        for field in ("xx", "yy", "zz", "yz", "zx", "xy"):
            if not callable(getattr(self, field)):
                number("Stress", field, getattr(self, field))
        if self.k is not None:
            if not callable(self.k):
                vector("Stress", "k", self.k, (2,))
            if callable(self.xx) or callable(self.yy) or self.xx != 0 or self.yy != 0:
                raise SceneError("Stress: k excludes xx and yy")

    def at(self, places: np.ndarray) -> np.ndarray:
        """Stress [Pa] at places, in the order xx yy zz yz zx xy.

        Parameters
        ----------
        places : (n, 3) array
            [m].

        Returns
        -------
        (n, 6) array
            [Pa], tension positive.

        Raises
        ------
        SceneError
            If a callable returns the wrong shape or a value that is not finite.
        """
        result = np.zeros((len(places), 6))
        for column, field in enumerate(("xx", "yy", "zz", "yz", "zx", "xy")):
            result[:, column] = evaluate(f"Stress {field}", getattr(self, field), places, ())
        if self.k is not None:
            ratios = evaluate("Stress k", self.k, places, (2,))
            result[:, :2] = ratios * result[:, 2:3]
        return result


def evaluate(owner: str, value: Any, places: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Value (n, *shape) at `places`: a constant repeated, or a callable's answer, checked.

    Raises
    ------
    SceneError
        If a callable returns the wrong shape or a value that is not finite.
    """
    expected = (len(places), *shape)
    if not callable(value):
        return np.broadcast_to(np.asarray(value, dtype=np.float64), expected)
    result = np.asarray(value(places), dtype=np.float64)
    if result.shape == shape:
        result = np.broadcast_to(result, expected)
    if result.shape != expected:
        raise SceneError(f"{owner}: the function returned shape {result.shape}, expected {expected}")
    if not np.isfinite(result).all():
        bad = places[~np.isfinite(result.reshape(len(places), -1)).all(axis=1)][0]
        raise SceneError(f"{owner}: the function returned a value that is not finite at {bad}")
    return result
