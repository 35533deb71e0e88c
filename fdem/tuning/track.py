"""One formulation with one integrator: its numbers are refined one at a time until their limits are known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from fdem.tuning.estimate import Limit, limit
from fdem.tuning.settings import Settings

__all__ = ["REFINE", "Knob", "Run", "Track"]

Levels = tuple[float, ...]

NEGLIGIBLE = 0.02  # of the error allowed: a number that matters less is left as it is
DEAREST = 40.0  # largest growth of cost in a step of refinement that is expected
RETRIES = 4  # joint refinements of a start that fails
FIRST = 1e6  # times the error allowed: doubt of such a number, so that it comes first
STALE = 3.0  # levels that others have been refined by since a number was looked at: it is looked at again
STRAY = 0.1  # worth of refining on where values move further apart
AGAIN = 2  # further refinements where a finer number gave the same bits

# factor of a step of refinement, ratio of the error's steps it stands for, order taken where none is seen
REFINE = {
    "size": (1 / 1.5, 1.5, 1.0),
    "dt": (0.5, 2.0, 1.0),
    "safety": (0.5, 2.0, 1.0),
    "kn": (4.0, 4.0, 0.5),
    "ratio": (0.1, 10.0, 1.0),
}


@dataclass(frozen=True)
class Knob:
    """A number that can be refined: `start` times ``factor**level``."""

    name: str
    start: float

    def at(self, level: float) -> float:
        """The number at a level."""
        return float(self.start * REFINE[self.name][0] ** level)


@dataclass
class Run:
    """One simulation that was tried.

    Attributes
    ----------
    settings : Settings
        With what.
    value : float
        The quantity; nan if it failed.
    cost : float
        CPU time of set-up and solve [s].
    failure : str
        Why there is no value; empty otherwise.
    closure : float or None
        Energy closure, where there is a ledger.
    """

    settings: Settings
    value: float
    cost: float
    failure: str = ""
    closure: float | None = None
    sim: Any = field(default=None, repr=False)


@dataclass
class _Line:
    """What refining one number has shown: values along it, up to the one beyond the base."""

    values: list[float] = field(default_factory=list)
    ahead: float = 0.0  # from the base to the last value
    blocked: bool = False
    found: Limit = field(default_factory=Limit)
    seen: Levels = ()  # the base from which the last look was taken

    def stale(self, base: Levels, k: int) -> bool:
        """Whether the other numbers are much finer now than at the last look."""
        return (
            len(self.values) > 1
            and sum(b - a for i, (a, b) in enumerate(zip(self.seen, base, strict=True)) if i != k) >= STALE
        )

    def straying(self) -> int:
        """How often in a row the values have moved by more than before: other numbers are too coarse."""
        steps = [abs(b - a) for a, b in pairwise(self.values)]
        count = 0
        while count < len(steps) - 1 and steps[-1 - count] >= steps[-2 - count] > 0.0:
            count += 1
        return count


class Track:
    """Runs of one formulation and integrator.

    Parameters
    ----------
    knobs : list of Knob
        Numbers that can be refined.
    run : callable
        ``run({name: number}) -> Run``.
    rank : int
        Place of the body among those to choose from; `trusted` says whether its limit is that of the model asked for.
    """

    def __init__(self, knobs: list[Knob], run: Callable[[dict[str, float]], Run], rank: int) -> None:
        self.knobs, self._run, self.rank, self.trusted = knobs, run, rank, False
        self.runs: dict[Levels, Run] = {}
        self.base: Levels = tuple(0.0 for _ in knobs)
        self.lines = [_Line() for _ in knobs]
        self.spent, self.mismatch, self.checked, self.dead = 0.0, 0.0, False, False

    # ------------------------------------------------------------------------------------------------ single runs

    def try_at(self, levels: Levels) -> Run:
        """Run at these levels, or what it gave before."""
        if levels not in self.runs:
            run = self._run({knob.name: knob.at(level) for knob, level in zip(self.knobs, levels, strict=True)})
            self.runs[levels] = run
            self.spent += run.cost
        return self.runs[levels]

    def moved(self, levels: Levels, k: int, by: float) -> Levels:
        """Levels with one changed."""
        return tuple(level + by * (i == k) for i, level in enumerate(levels))

    def expected(self, levels: Levels) -> float:
        """Cost of a run [s] from those nearby: the dearest growth per level that was seen, or a guess."""
        if levels in self.runs:
            return 0.0
        known = {at: run.cost for at, run in self.runs.items() if not run.failure}
        if not known:
            return 0.0
        near = min(known, key=lambda at: sum(abs(a - b) for a, b in zip(at, levels, strict=True)))
        cost = known[near]
        for k, (a, b) in enumerate(zip(near, levels, strict=True)):
            cost *= self._growth(k) ** (b - a)
        return cost

    def _growth(self, k: int) -> float:
        """How cost grows with a level of one number, at the finest place where that is known."""
        for at in sorted(self.runs, key=lambda a: -sum(a)):
            coarser = self.runs.get(self.moved(at, k, -1.0))
            if coarser is not None and not coarser.failure and not self.runs[at].failure:
                return min(max(self.runs[at].cost / max(coarser.cost, 1e-9), 1.0), DEAREST)
        return 1.0 / REFINE[self.knobs[k].name][0] if self.knobs[k].name != "kn" else 2.0

    # ----------------------------------------------------------------------------------------------------- limits

    def begin(self) -> None:
        """First run; where it fails all numbers are refined together a few times."""
        for _ in range(RETRIES):
            if not self.try_at(self.base).failure:
                for line in self.lines:
                    line.values = [self.runs[self.base].value]
                return
            if not self.knobs:
                break
            self.base = tuple(level + 1.0 for level in self.base)
        self.dead = True

    @property
    def kind(self) -> str:
        """Formulation and integrator."""
        return self.runs[self.base].settings.kind

    @property
    def estimate(self) -> tuple[float, float]:
        """Limit of the quantity and its uncertainty."""
        if self.dead or self.base not in self.runs:
            return math.nan, math.inf
        value = self.runs[self.base].value + sum(line.ahead + line.found.rest for line in self.lines)
        floor = [abs(value) * k.at(b) for k, b in zip(self.knobs, self.base, strict=True) if k.name == "ratio"]
        return value, self.mismatch + sum(line.found.uncertainty for line in self.lines) + sum(floor)

    def next_step(self, allowed: float) -> tuple[int, Levels] | None:
        """Number to refine and where to run: where most uncertainty goes for the cost; None if nothing is left."""
        best, choice = 0.0, None
        for k, line in enumerate(self.lines):
            if line.blocked:
                continue
            doubt = line.found.uncertainty
            if self.knobs[k].name == "ratio":  # what the residual itself leaves open
                doubt = max(doubt, abs(self.runs[self.base].value) * self.knobs[k].at(self.base[k]))
            stale = line.stale(self.base, k)
            if stale:
                doubt = max(doubt, FIRST * allowed)
            if doubt <= NEGLIGIBLE * allowed:
                continue
            further = float(len(line.values) > 1 and not stale)
            target = self.moved(self.base, k, 1.0 + further)
            cost = self.expected(target) + self.expected(self.moved(self.base, k, further))
            worth = (doubt if stale else min(doubt, 1e3 * allowed)) / max(cost, 1e-6) * STRAY ** line.straying()
            if math.isinf(doubt):
                worth *= 1e3
            if worth > best:
                best, choice = worth, (k, target)
        return choice

    def refine(self, k: int, target: Levels) -> None:
        """Move the base to what is known beyond it in one number, and look one further."""
        line, before = self.lines[k], self.base
        stale = line.stale(self.base, k)
        if len(line.values) > 1 and not stale:
            self.base = self.moved(self.base, k, 1.0)
        if self.try_at(self.base).failure:
            self.base, line.blocked = before, True
            return
        run = self.try_at(target)
        if not run.failure and self.knobs[k].name in ("size", "ratio"):
            # the same bits say that nothing was refined, not that nothing depends on it
            same = 0
            while run.value == self.runs[self.base].value and same < AGAIN and not run.failure:
                same += 1
                run = self.try_at(self.moved(target, k, float(same)))
        if run.failure:
            line.blocked, line.ahead = True, 0.0
            return
        line.ahead = run.value - self.runs[self.base].value
        if stale:
            line.values.pop()
        line.values.append(line.values[-1] + line.ahead)
        line.seen = self.base
        if line.straying():  # something else is too coarse here: look at all of it again
            for other in self.lines:
                if other is not line and other.seen != self.base:
                    other.seen = tuple(-math.inf for _ in self.base)
        _, step, assumed = REFINE[self.knobs[k].name]
        line.found = limit(line.values, step, assumed)
        self.checked = False

    def check(self, allowed: float) -> None:
        """Refine all numbers that matter at once: what they do together beside the sum of what each does alone."""
        self.checked = True
        matter = [k for k, line in enumerate(self.lines) if abs(line.ahead) > NEGLIGIBLE * allowed and not line.blocked]
        if len(matter) < 2:
            return
        corner = tuple(level + (k in matter) for k, level in enumerate(self.base))
        run = self.try_at(corner)
        if not run.failure:
            expected = self.runs[self.base].value + sum(self.lines[k].ahead for k in matter)
            self.mismatch = 2.0 * abs(run.value - expected)

    def move_to_corner(self, allowed: float) -> bool:
        """Go on from the run that refined all numbers at once, with new looks ahead; whether that is possible."""
        matter = [k for k, line in enumerate(self.lines) if abs(line.ahead) > NEGLIGIBLE * allowed and not line.blocked]
        corner = tuple(level + (k in matter) for k, level in enumerate(self.base))
        if corner == self.base or corner not in self.runs or self.runs[corner].failure:
            return False
        self.base, self.mismatch, self.checked = corner, 0.0, False
        for k in matter:
            line = self.lines[k]
            line.values, line.ahead, line.found = [self.runs[corner].value], 0.0, Limit()
        return True
