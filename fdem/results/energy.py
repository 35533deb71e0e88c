"""The energy ledger: where energy is, where it went, and how well the balance closes."""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["Energy", "Ledger"]

STORED = ("kinetic", "strain", "joint", "potential")
SPENT = ("friction", "damping")


@dataclass(frozen=True)
class Energy:
    """Energies [J] at one time.

    Attributes
    ----------
    kinetic, strain, joint, potential : float
        Stored in motion, zones, joints and height (the last from the start of the simulation).
    friction, damping : float
        Dissipated since the start.
    work : float
        Done by loads and prescribed motion since the start.
    error : float
        stored - stored at the start + dissipated - work [J].
    closure : float
        ``|error|`` over the energy turned over [-].
    """

    kinetic: float
    strain: float
    joint: float
    potential: float
    friction: float
    damping: float
    work: float
    error: float
    closure: float


@dataclass
class Ledger:
    """Baseline and turnover of an energy balance.

    Attributes
    ----------
    start : dict
        Entries at the start [J]; None before the first. What was spent before (in the state of another
        simulation, or by a joint law that holds less than the state carries) is no part of this balance.
    turned : float
        Largest sum of the balance's entries seen [J].
    """

    start: dict[str, float] | None = None
    turned: float = 0.0
    last: dict[str, float] = field(default_factory=dict)

    def entry(self, now: dict[str, float]) -> Energy:
        """Balance for the present energies `now` [J] (keys: all entries of `Energy` but the last two)."""
        if self.start is None:
            self.start = dict(now)
        now = {**now, **{name: now[name] - self.start[name] for name in (*SPENT, "work")}}
        change = {name: now[name] - self.start[name] for name in STORED}
        error = sum(change.values()) + sum(now[name] for name in SPENT) - now["work"]
        turned = sum(abs(v) for v in change.values()) + sum(abs(now[name]) for name in (*SPENT, "work"))
        self.turned = max(self.turned, turned, self.start["kinetic"])
        # differences of large stored energies carry their round-off: it is no error of the balance
        noise = 1e-13 * sum(abs(now[name]) for name in STORED)
        closure = abs(error) / self.turned if self.turned > noise else 0.0
        return Energy(error=error, closure=closure, **now)

    def rebase(self, before: dict[str, float], after: dict[str, float]) -> None:
        """Move the baseline by what the entries changed when blocks were removed or loads came."""
        if self.start is not None:
            self.start = {name: self.start[name] + after[name] - before[name] for name in self.start}
