"""The search behind `fdem.tune`: first the limit, then the cheapest run near it."""

from __future__ import annotations

import math
import time as clock
import warnings
from collections.abc import Callable
from statistics import median
from typing import Any

from fdem.errors import ConvergenceError, FdemError, FdemWarning, ToleranceError
from fdem.scene.scene import Scene
from fdem.simulation import Simulation
from fdem.tuning.result import Tuned
from fdem.tuning.settings import Settings
from fdem.tuning.track import Knob, Levels, Run, Track

__all__ = ["Search"]

AIM = 0.15  # of the tolerance: uncertainty of the limit that is aimed at, so that little of the tolerance goes there
ENOUGH = 0.5  # of the tolerance: uncertainty that will do where the budget ends
SLACK = 10.0  # times the tolerance: energy closure above which a run counts as failed
PATIENCE = 8  # refinements after which the latter will do
WITNESS = 0.1  # of what is left of the budget: what a second opinion may cost
POLISH = 14  # coarser settings tried for one formulation and integrator
GAIN = 0.95  # of the cost: less is noise
COARSEST, COARSEST_OTHER = {"ratio": 0.0, "dt": -2.0}, -3.0  # levels below the start that are tried
FINALISTS, REPEATS = 3, 3
SHORT_RUN = 20.0  # s: first runs shorter than that are repeated, as kernels may have been compiled in them
READ = ("size", "dt", "safety", "kn", "ratio")


class _Watched(Settings):
    """Settings that know which of their numbers were read."""

    def __getattribute__(self, name: str) -> Any:
        if name in READ or name in ("body", "integrator"):
            object.__getattribute__(self, "__dict__").setdefault("_read", set()).add(name)
        return object.__getattribute__(self, name)


class _Exhausted(Exception):
    """The budget is spent."""


class Search:
    """One search; see `fdem.tune` for what the arguments are."""

    def __init__(
        self,
        factory: Callable[[Settings], Any],
        quantity: Callable[[Any], float],
        tolerance: float,
        time: float | None,
        scale: float | None,
        budget: float,
        max_runs: int,
    ) -> None:
        self.factory, self.quantity, self.tolerance, self.time = factory, quantity, tolerance, time
        self.scale, self.budget, self.max_runs = scale, budget, max_runs
        self.runs: list[Run] = []
        self.tracks: list[Track] = []
        self.total, self.read = 0.0, set[str]()
        self.value, self.doubt = math.nan, math.inf
        self.why, self.conflict, self.unnamed = "the budget is spent", False, False

    # ------------------------------------------------------------------------------------------------ single runs

    def run(self, settings: Settings) -> Run:
        """Build, run and measure once; what goes wrong is kept."""
        if self.total >= self.budget or len(self.runs) >= self.max_runs:
            raise _Exhausted
        watched = _Watched(**{name: getattr(settings, name) for name in settings.__dataclass_fields__})
        begin, value, failure, closure, sim = clock.process_time(), math.nan, "", None, None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FdemWarning)
                sim = self._simulated(watched)
                value = float(self.quantity(sim))
            closure = _closure(sim)
        except (FdemError, ArithmeticError) as error:
            failure = f"{type(error).__name__}: {error}"
        if not failure and not math.isfinite(value):
            failure = f"the quantity is {value}"
        if not failure and closure is not None and closure > SLACK * self.tolerance:
            failure = f"energy does not close: {closure:.2g}"
        self.read |= watched.__dict__.get("_read", set())
        run = Run(settings, math.nan if failure else value, clock.process_time() - begin, failure, closure, sim)
        self.runs.append(run)
        self.total += run.cost
        return run

    def _simulated(self, settings: Settings) -> Any:
        made = self.factory(settings)
        if isinstance(made, Scene):
            sim = Simulation(made, settings.integrator, progress=False)
            if self.time is not None:
                sim.run(time=self.time)
                return sim
            report = sim.solve(ratio=settings.ratio or 1e-5)
            if not report.converged:
                raise ConvergenceError(f"no equilibrium: {report.reason}; {report.notes}")
            return sim
        return made

    def allowed(self, value: float) -> float:
        """Absolute error that the tolerance stands for."""
        return self.tolerance * (self.scale or abs(value))

    # ------------------------------------------------------------------------------------------------- candidates

    def candidates(self, bodies: list[Any], rules: list[Any], start: dict[str, float | None]) -> None:
        """A track for every body and integrator; those that are never read are not told apart."""
        first = True
        for rank, body in enumerate(bodies):
            for rule in rules:
                if not first and ("body" not in self.read and body is not bodies[0]):
                    continue
                numbers = self._numbers(body, rule, start)
                cold = run = self.run(Settings.of(body, rule, **numbers))
                if hasattr(body, "size") and "size" not in numbers and (size := _coarse(run.sim, body)) is not None:
                    numbers["size"] = size
                    run = self.run(Settings.of(body, rule, **numbers))
                if first or run.cost < SHORT_RUN:
                    run = self.run(run.settings)  # kernels were loaded in the first
                    cold.cost = run.cost
                first = False
                counted = {name: value for name, value in numbers.items() if self._counts(name, body, rule)}
                cold.settings = run.settings = Settings.of(body, rule, **counted)
                knobs = [Knob(name, value) for name, value in counted.items()]
                track = Track(knobs, self._runner(body, rule), rank)
                track.runs[track.base], track.spent = run, run.cost
                track.begin()
                self.tracks.append(track)
        # bodies that nobody named and that the scene cannot have are no model of it
        model = min((t.rank for t in self.tracks if not t.dead), default=0) if self.unnamed else 0
        for track in self.tracks:
            track.trusted = track.rank == model

    def _numbers(self, body: Any, rule: Any, start: dict[str, float | None]) -> dict[str, float]:
        """Where the numbers of a body and an integrator begin."""
        found = {"kn": start["kn"], "size": start["size"] or getattr(body, "size", None)}
        if getattr(rule, "dt", None) is not None:
            found["dt"] = start["dt"] or rule.dt
        elif hasattr(rule, "safety") and not rule.scaled:
            found["safety"] = rule.safety
        if self.time is None:
            found["ratio"] = start["ratio"] or 1e-3
        return {name: value for name, value in found.items() if value is not None}

    def _counts(self, name: str, body: Any, rule: Any) -> bool:
        """Whether refining a number can do anything."""
        if name in ("dt", "safety"):
            return True
        return name in self.read or (name == "size" and hasattr(body, "size")) or (
            name == "ratio" and getattr(rule, "static", False)
        )  # fmt: skip

    def _runner(self, body: Any, rule: Any) -> Callable[[dict[str, float]], Run]:
        def run(numbers: dict[str, float]) -> Run:
            try:
                settings = Settings.of(body, rule, **numbers)
            except FdemError as error:  # beyond what the body or the integrator takes
                return Run(Settings(body, rule, **numbers), math.nan, 0.0, str(error))
            return self.run(settings)

        return run

    # -------------------------------------------------------------------------------------------------- the limit

    def find(self, bodies: list[Any], rules: list[Any], start: dict[str, float | None], unnamed: bool = False) -> Tuned:
        """Limit first, then the cheapest settings near it; `unnamed`: nobody named the bodies."""
        self.unnamed = unnamed
        try:
            self.candidates(bodies, rules, start)
            if not any(track.trusted and not track.dead for track in self.tracks):
                self.why = f"no run of {type(bodies[0]).__name__} gave a value: {self.runs[0].failure}"
                raise _Exhausted
            if not self.converge():
                raise _Exhausted
            self.compete()
            self.finish()
        except _Exhausted:
            self._settle(ENOUGH)
        chosen = self.chosen()
        best = self.told(chosen)
        if chosen is None or best.error > self.tolerance or self.conflict:
            raise ToleranceError(
                f"a relative error of {self.tolerance:g} was not reached: {self.why} ({self.total:.0f} s of "
                f"{self.budget:g}, {len(self.runs)} runs); the best estimate is {best.value:.6g} with an error of "
                f"about {best.uncertainty:.1g}. A larger budget, a finer start or a larger tolerance helps; where the "
                "quantity is close to zero give a scale",
                best,
            )
        return best

    def converge(self) -> bool:
        """Refine the trusted tracks, the one that has cost least first, until limits are sure and agree."""
        aim, waited = AIM, 0
        while True:
            live = [t for t in self.tracks if t.trusted and not t.dead]
            waited += any(t.estimate[1] <= ENOUGH * self.allowed(t.estimate[0]) for t in live)
            asked_for = aim if waited <= PATIENCE else max(aim, ENOUGH)
            sure = [t for t in live if self._sure(t, asked_for)]
            if sure:
                first = min(sure, key=lambda t: t.estimate[1])
                witness = self._witness(first, live)
                if witness is None and self._call(first, live, aim):
                    continue
                if witness is None or self._agree(first, witness):
                    self._take(first)
                    return True
                step = witness.next_step(self.allowed(first.estimate[0]) * aim)
                if step is not None and self._affords(first, witness, step[1]):
                    witness.refine(*step)
                    continue
                aim, waited = 0.5 * aim, 0  # one of the two is wrong about itself
                if aim < AIM / 16:
                    self.why = f"{first.kind} and {witness.kind} tend to different limits"
                    self.conflict = True
                    return False
                continue
            asked = [(t, t.next_step(self.allowed(t.estimate[0]) * aim)) for t in live if t not in sure]
            steps = [(t, step) for t, step in asked if step is not None]
            if not steps:
                self.why = "refining does not settle the limit, or fails"
                return self._settle(ENOUGH)
            track, (k, target) = min(steps, key=lambda item: item[0].spent + item[0].expected(item[1][1]))
            if track.expected(target) > self.budget - self.total:
                self.why = "the next refinement would cost more than is left of the budget"
                return self._settle(ENOUGH)
            track.refine(k, target)

    def _sure(self, track: Track, share: float) -> bool:
        """Whether the limit of a track is known to so much of the tolerance, looked at with all numbers finer."""
        value, doubt = track.estimate
        allowed = self.allowed(value)
        if not doubt <= share * allowed or any(line.stale(track.base, k) for k, line in enumerate(track.lines)):
            return False
        if not track.checked:
            track.check(allowed * share)
            if track.estimate[1] > share * allowed and track.move_to_corner(allowed * share):
                return False
        return track.estimate[1] <= share * allowed

    def _witness(self, first: Track, live: list[Track]) -> Track | None:
        """The surest other track of the same model that has been refined at all."""
        others = [t for t in live if t is not first and math.isfinite(t.estimate[1])]
        return min(others, key=lambda t: t.estimate[1], default=None)

    def _call(self, first: Track, live: list[Track], aim: float) -> bool:
        """Refine another track of the same model until it can bear witness, if that costs no more than the first."""
        allowed = self.allowed(first.estimate[0]) * aim
        asked = [(t, t.next_step(allowed)) for t in live if t is not first]
        steps = [(t, step) for t, step in asked if step is not None]
        if not steps:
            return False
        track, (k, target) = min(steps, key=lambda item: item[0].spent + item[0].expected(item[1][1]))
        if not self._affords(first, track, target):
            return False
        track.refine(k, target)
        return True

    def _affords(self, first: Track, other: Track, target: Levels) -> bool:
        """Whether a second opinion may cost what a run would bring it to."""
        return other.spent + other.expected(target) <= max(first.spent, WITNESS * (self.budget - self.total))

    def _agree(self, a: Track, b: Track) -> bool:
        (x, u), (y, w) = a.estimate, b.estimate
        return abs(x - y) <= u + w + 0.25 * self.allowed(x)

    def _take(self, track: Track) -> None:
        self.value, self.doubt = track.estimate

    def _settle(self, share: float) -> bool:
        """Take the surest limit there is; whether it is sure enough."""
        live = [t for t in self.tracks if t.trusted and not t.dead]
        best = min(live, key=lambda t: t.estimate[1], default=None)
        if best is not None and not best.estimate[1] >= self.doubt:
            self._take(best)
        return self.doubt <= share * self.allowed(self.value)

    # ---------------------------------------------------------------------------------------------- the cheapest

    def within(self, run: Run) -> bool:
        """Whether a run is within the tolerance, the doubt of the limit counted."""
        return not run.failure and abs(run.value - self.value) + self.doubt <= self.allowed(self.value)

    def cheapest(self, runs: Any) -> Run | None:
        """The cheapest run within the tolerance."""
        return min((r for r in runs if self.within(r)), key=lambda r: r.cost, default=None)

    def compete(self) -> None:
        """Every track that may be cheaper than what is known is refined or coarsened until it is not."""
        live = [t for t in self.tracks if not t.dead]
        while True:
            best = self.cheapest(self.runs)
            limit = math.inf if best is None else best.cost
            steps = []
            for track in live:
                if self.cheapest(track.runs.values()) is not None or self._elsewhere(track):
                    continue
                step = track.next_step(0.3 * self.allowed(self.value))
                if step is not None and track.expected(step[1]) < limit:
                    steps.append((track.expected(step[1]), track, step))
            if not steps:
                break
            _, track, (k, target) = min(steps, key=lambda item: item[0])
            track.refine(k, target)
        order = [(run, t) for t in live if (run := self.cheapest(t.runs.values())) is not None]
        for _, track in sorted(order, key=lambda item: item[0].cost):
            self.polish(track)

    def _elsewhere(self, track: Track) -> bool:
        """Whether a track tends to another limit: its model is another one."""
        value, doubt = track.estimate
        return abs(value - self.value) - doubt - self.doubt > self.allowed(self.value)

    def polish(self, track: Track) -> None:
        """Coarser numbers as long as the quantity stays within the tolerance: a level, then half, then a quarter."""
        at = min((a for a, r in track.runs.items() if self.within(r)), key=lambda a: track.runs[a].cost)
        stride, left = 1.0, POLISH
        while stride >= 0.25 and left > 0:
            better = None
            for k in sorted(range(len(track.knobs)), key=lambda k: -track._growth(k)):
                trial = track.moved(at, k, -stride)
                best = self.cheapest(self.runs)
                if trial in track.runs or best is None or track.expected(trial) > 1.2 * best.cost:
                    continue
                if trial[k] < COARSEST.get(track.knobs[k].name, COARSEST_OTHER):
                    continue
                left -= 1
                run = track.try_at(trial)
                if self.within(run) and run.cost < GAIN * track.runs[at].cost:
                    better = trial
                    break
            if better is None:
                stride *= 0.5
            else:
                at = better

    def finish(self) -> None:
        """Time the cheapest few again: one measurement is not enough to choose by."""
        known = {r.settings.key: r for r in self.runs if self.within(r)}
        for run in sorted(known.values(), key=lambda r: r.cost)[:FINALISTS]:
            times = [run.cost, *(self.run(run.settings).cost for _ in range(REPEATS - 1))]
            for other in self.runs:
                if other.settings.key == run.settings.key:
                    other.cost = median(times)

    def chosen(self) -> Run | None:
        """The run to return."""
        return self.cheapest(self.runs)

    def told(self, run: Run | None) -> Tuned:
        """The result."""
        scale = self.scale or abs(self.value)
        relative = self.doubt / scale if scale else math.inf
        if run is None:
            known = [r for r in self.runs if not r.failure]
            run = min(known, key=lambda r: abs(r.value - self.value), default=None)
        error = math.inf if run is None else (abs(run.value - self.value) + self.doubt) / scale
        return Tuned(
            self.value,
            relative,
            math.nan if run is None else run.value,
            error,
            None if run is None else run.settings,
            None if run is None else run.sim,
            math.nan if run is None else run.cost,
            self.total,
            self.runs,
        )


def _coarse(sim: Any, body: Any) -> float | None:
    """Half the smallest extent of the blocks of a body [m], where there are any to look at."""
    scene = sim if isinstance(sim, Scene) else getattr(sim, "scene", None)
    blocks = [b for b in scene.blocks if type(b.body) is type(body)] if isinstance(scene, Scene) else []
    extents = [float(min(high - low for low, high in zip(*b.shape.bounds, strict=True))) for b in blocks]
    return 0.5 * median(extents) if extents else None


def _closure(sim: Any) -> float | None:
    """Energy closure of a run that has one."""
    if not isinstance(sim, Simulation) or sim.ledger is None or sim.integrator.scaled:
        return None
    return abs(float(sim.energy.closure))
