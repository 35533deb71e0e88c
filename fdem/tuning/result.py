"""What a search for settings gives."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from fdem.tuning.settings import Settings
from fdem.tuning.track import Run

__all__ = ["Tuned"]


@dataclass
class Tuned:
    """What `tune` found.

    Attributes
    ----------
    value : float
        Best estimate of the quantity: the limit the runs tend to.
    uncertainty : float
        Estimated relative error of `value`.
    quantity : float
        What the chosen settings gave.
    error : float
        Estimated relative error of `quantity`, at most the tolerance.
    settings : Settings
        The cheapest that were found for the tolerance.
    sim : object
        What was run with them (a `Simulation`, or what the scene factory returned).
    cost : float
        CPU time of a run with them, set-up and solve [s].
    total_cost : float
        CPU time of everything that was tried [s].
    runs : list of Run
        Everything that was tried: `settings`, `value`, `cost`, `failure`, `closure`.
    """

    value: float
    uncertainty: float
    quantity: float
    error: float
    settings: Settings | None
    sim: Any = field(default=None, repr=False)
    cost: float = math.nan
    total_cost: float = math.nan
    runs: list[Run] = field(default_factory=list, repr=False)

    def table(self) -> str:
        """Everything that was tried, one run a line: CPU time, distance from the best estimate, settings."""
        lines = ["  CPU s       value    distance  settings"]
        for run in self.runs:
            off = abs(run.value / self.value - 1.0) if self.value else math.nan
            lines.append(f"{run.cost:7.3f} {run.value:11.5g} {off:11.2e}  {run.settings}  {run.failure}".rstrip())
        return "\n".join(lines)
