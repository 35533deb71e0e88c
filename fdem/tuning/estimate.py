"""How far a sequence is from its limit: Richardson extrapolation with the order that is observed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, log

__all__ = ["Limit", "limit"]

SLOWEST, FASTEST = 0.4, 2.0  # orders believed; a higher one is counted as second, which errs on the safe side
GUESS = 1.5  # safety of an order that is assumed (two values)
SWING = 1.25  # safety of a sequence that swings
TRUST = 0.25  # of the last correction: least uncertainty of a limit that two triples agree on
NOTHING = 1e-13  # relative change that is round-off


@dataclass(frozen=True)
class Limit:
    """Where a sequence goes.

    Attributes
    ----------
    rest : float
        Limit less the last value.
    uncertainty : float
        How wrong that may be.
    order : float or None
        Observed order; None where there is none.
    """

    rest: float = 0.0
    uncertainty: float = inf
    order: float | None = None


def limit(values: Sequence[float], factor: float, assumed: float) -> Limit:
    """Limit of values at steps that shrink by `factor` each time.

    Parameters
    ----------
    values : sequence of float
        Coarsest first.
    factor : float
        Ratio of two steps, above 1.
    assumed : float
        Order taken where two values show none.

    Returns
    -------
    Limit
        Without use for a single value.

    Notes
    -----
    With differences d1, d2 of the last three values the order is ``p = log(d1/d2)/log(factor)`` and the rest
    ``d2/(factor^p - 1)`` (Richardson 1911). The uncertainty is the whole of that rest, or, if the three values before
    tell the same limit, how much the two limits differ. Values that swing or do not come closer are not extrapolated.
    """
    if len(values) < 2:
        return Limit()
    last = values[-1] - values[-2]
    scale = max(abs(v) for v in values)
    if abs(last) <= NOTHING * scale and (len(values) == 2 or abs(values[-2] - values[-3]) <= NOTHING * scale):
        return Limit(0.0, NOTHING * scale)
    if len(values) == 2:
        return Limit(0.0, GUESS * abs(last) / (factor**assumed - 1.0))
    now = _triple(values[-3:], factor, assumed)
    if len(values) > 3 and now.order is not None:
        before = _triple(values[-4:-1], factor, assumed)
        if before.order is not None:
            moved = abs(values[-1] + now.rest - values[-2] - before.rest)
            return Limit(now.rest, min(now.uncertainty, max(moved, TRUST * abs(now.rest))), now.order)
    return now


def _triple(values: Sequence[float], factor: float, assumed: float) -> Limit:
    first, last = values[1] - values[0], values[2] - values[1]
    larger = max(abs(first), abs(last))
    if last == 0.0:  # a value that came twice says nothing of the next
        return Limit(0.0, larger)
    if first * last <= 0.0:
        return Limit(0.0, SWING * larger)
    order = log(first / last) / log(factor)
    if order < SLOWEST:
        return Limit(0.0, GUESS * larger / (factor ** min(assumed, 0.5) - 1.0))
    rest = last / (factor ** min(order, FASTEST) - 1.0)
    return Limit(rest, abs(rest), order)
