"""Numbers for the eye: prefixes of units, ranges of colours, palettes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["NEUTRAL", "PALETTE", "STONES", "limits_of", "readable"]

Array = NDArray[np.float64]

# well apart, also for most colour-blind readers (after Okabe and Ito, toned down)
PALETTE = ("#4c78a8", "#e0883b", "#5a9e6f", "#b5574f", "#8a79b0", "#c9a93a", "#5fa8b5", "#b77b9c", "#7d6b5d", "#9aa35a")
STONES = ("#c9b79c", "#a9b4b8", "#b9a58c", "#d3c8b2", "#93a0a3", "#c0a98e", "#b7bda9", "#9d9384", "#cdbfa8", "#a8a396")
NEUTRAL = "#cfd2d3"

_PREFIXED = {"m", "Pa", "N", "J", "m/s"}
_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "\N{MICRO SIGN}"))


def readable(unit: str, largest: float) -> tuple[float, str]:
    """Factor and unit that bring the largest value between 1 and 1000.

    Parameters
    ----------
    unit : str
        SI unit; only m, m/s, Pa, N and J take prefixes, lengths none above.
    largest : float
        Largest absolute value.

    Returns
    -------
    factor : float
        What to multiply values with.
    unit : str
        The unit they then have.
    """
    if unit not in _PREFIXED or not (largest > 0.0 and math.isfinite(largest)):
        return 1.0, unit
    for scale, prefix in _PREFIXES:
        if prefix in ("G", "M", "k") and unit in ("m", "m/s"):
            continue
        if largest >= 0.9999 * scale:
            return 1.0 / scale, prefix + unit
    return 1e6, _PREFIXES[-1][1] + unit


def limits_of(values: Array, symmetric: bool) -> tuple[float, float, str]:
    """Range of colours for values, and which end goes beyond it ("neither", "min", "max", "both").

    A few values far off (a block that has fallen) do not take the colours from all others: the range
    ends at percentiles 1 and 99 where the extreme is more than twice as far.
    """
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 1.0, "neither"
    low, high = float(finite.min()), float(finite.max())
    p1, p50, p99 = (float(p) for p in np.percentile(finite, (1.0, 50.0, 99.0)))
    far_low, far_high = p50 - low > 2.0 * (p50 - p1) > 0.0, high - p50 > 2.0 * (p99 - p50) > 0.0
    low, high = p1 if far_low else low, p99 if far_high else high
    if symmetric:
        high = max(abs(low), abs(high))
        low = -high
    elif 0.0 <= low < 0.35 * high:
        low = 0.0
    if not high > low:
        pad = 0.5 * abs(high) or 0.5
        low, high = low - pad, high + pad
    return low, high, {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[int(far_low), int(far_high)]
