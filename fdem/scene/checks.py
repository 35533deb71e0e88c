"""Checks shared by everything the user writes: a bad value is refused with the name of its field."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.errors import SceneError

__all__ = ["number", "vector"]


def number(
    owner: str,
    field: str,
    value: Any,
    *,
    low: float = -np.inf,
    high: float = np.inf,
    open_low: bool = False,
    open_high: bool = False,
    infinite: bool = False,
) -> float:
    """Return `value` as a float after checking that it is a number within bounds.

    Raises
    ------
    SceneError
        Naming `owner`, `field`, the value and what is allowed.
    """
    try:
        result = float(value)
    except (TypeError, ValueError):
        raise SceneError(f"{owner}: {field} = {value!r} is not a number") from None
    inside = (low < result if open_low else low <= result) and (result < high if open_high else result <= high)
    if np.isnan(result) or not inside or (np.isinf(result) and not infinite):
        left, right = ("(" if open_low else "["), (")" if open_high else "]")
        raise SceneError(f"{owner}: {field} = {value!r}, allowed is a finite number in {left}{low:g}, {high:g}{right}")
    return result


def vector(owner: str, field: str, value: Any, sizes: tuple[int, ...] = (3,)) -> np.ndarray:
    """Return `value` as a finite float vector of one of the `sizes`.

    Raises
    ------
    SceneError
        Naming `owner`, `field` and the value.
    """
    try:
        result = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError(f"{owner}: {field} = {value!r} is not a vector of numbers") from None
    if result.shape not in {(size,) for size in sizes}:
        allowed = " or ".join(map(str, sizes))
        raise SceneError(f"{owner}: {field} has shape {result.shape}, allowed are {allowed} numbers")
    if not np.isfinite(result).all():
        raise SceneError(f"{owner}: {field} = {value!r} is not finite")
    return result
