"""Tolerance in, settings out: the cheapest formulation, mesh, step and contact stiffness for an error asked for."""

from __future__ import annotations

import math
import time as clock
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from fdem.errors import ConvergenceError, FdemError, FdemWarning, SceneError, ToleranceError
from fdem.integrate.explicit import Adaptive, Explicit, Relaxation
from fdem.integrate.implicit import GeneralizedAlpha, Newmark
from fdem.integrate.nonsmooth import ContactDynamics
from fdem.integrate.static import Static
from fdem.scene.bodies import LinearStrain, Rigid, UniformStrain, Zoned
from fdem.scene.scene import Scene
from fdem.simulation import Simulation
from fdem.tuning.settings import Settings
from fdem.tuning.track import Knob, Run, Track

__all__ = ["Tuned", "tune"]

AIM = 0.15  # of the tolerance: uncertainty of the limit that is aimed at, so that little of the tolerance goes there
ENOUGH = 0.5  # of the tolerance: uncertainty that will do where the budget ends
SLACK = 10.0  # times the tolerance: energy closure above which a run counts as failed
POLISH = 14  # coarser settings tried for one formulation and integrator
FINALISTS, REPEATS = 3, 3
SHORT_RUN = 20.0  # s: first runs shorter than that are repeated, as kernels may have been compiled in them
READ = ("size", "dt", "safety", "kn", "ratio")


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


def tune(
    scene_factory: Callable[[Settings], Any],
    quantity: Callable[[Any], float],
    tolerance: float = 0.01,
    *,
    body: Any = None,
    integrator: Any = None,
    size: float | None = None,
    dt: float | None = None,
    kn: float | None = None,
    ratio: float | None = None,
    time: float | None = None,
    scale: float | None = None,
    budget: float = 600.0,
    max_runs: int = 300,
) -> Tuned:
    """Find the cheapest settings that give a quantity to a relative error asked for.

    Parameters
    ----------
    scene_factory : callable
        ``scene_factory(s)`` builds the scene from the settings ``s.body``, ``s.integrator``, ``s.size``, ``s.dt``,
        ``s.kn``, ``s.ratio``, as far as they matter to it. It returns a `Scene` (which is then run for `time`, or
        solved to ``s.ratio``) or whatever `quantity` takes, for instance a `Simulation` that it has run itself.
    quantity : callable
        ``quantity(sim)`` is the number wanted.
    tolerance : float, optional
        Relative error asked for.
    body : body or list of bodies, optional
        Formulations to choose from. The first is the model that is asked for; another one is chosen if it gives the
        same. None: zoned, linear strain, uniform strain, rigid, where the factory reads ``s.body``.
    integrator : integrator or list of integrators, optional
        To choose from. None: explicit, implicit and non-smooth ones if `time` is given, otherwise those for rest.
    size : float, optional
        A coarse size of zones or pieces to begin with [m]. None: that of the body, or half a block.
    dt : float, optional
        A long step of implicit rules to begin with [s]. None: that of the integrator, or `time` / 50.
    kn : float, optional
        A soft contact to begin with [Pa/m], where stiffness stands for a hard contact; its limit is that of a hard one.
        Leave it out where the stiffness of joints is a datum.
    ratio : float, optional
        A solve ratio to begin with. None: 1e-3.
    time : float, optional
        How long a scene is to run [s]. None: it is solved for equilibrium.
    scale : float, optional
        What errors are relative to. None: the quantity itself, which must not be zero then.
    budget : float, optional
        CPU time for everything [s].
    max_runs : int, optional
        Runs for everything.

    Returns
    -------
    Tuned
        With the best estimate of the quantity, its error, the settings, their simulation and all that was tried.

    Raises
    ------
    ToleranceError
        If the tolerance cannot be met within the budget; its `best` is the best that was reached.
    SceneError
        If the scene or an option is wrong.

    Notes
    -----
    A number (mesh size, step, share of the stable step, contact stiffness, solve ratio) is refined if the factory
    reads it or the body or integrator has it. One number is refined at a time, that with most of the uncertainty for
    its cost; the limit follows from Richardson's extrapolation with the order that is observed, and one run with all of
    them finer checks that they do not depend on each other. Limits of two integrators must agree. Then coarser
    settings are tried, the cheapest that lie within the tolerance of the limit are timed, and the fastest is chosen.
    Runs that raise an `FdemError`, do not converge or do not keep their energy are data: they are left aside.
    """
    if not (isinstance(tolerance, (int, float)) and 0.0 < tolerance < 1.0):
        raise SceneError(f"tune: tolerance = {tolerance!r}, allowed is a number between 0 and 1")
    if not callable(scene_factory) or not callable(quantity):
        raise SceneError("tune: scene_factory and quantity must be callable")
    for name, value in {"size": size, "dt": dt, "kn": kn, "ratio": ratio, "time": time, "scale": scale}.items():
        if value is not None and not (isinstance(value, (int, float)) and 0.0 < value < math.inf):
            raise SceneError(f"tune: {name} = {value!r}, allowed is a positive number")
    bodies = _listed(body) or [Zoned(), LinearStrain(), UniformStrain(), Rigid()]
    rules = _listed(integrator) or _rules(time, dt)
    start = {"size": size, "dt": dt, "kn": kn, "ratio": ratio}
    return _Search(scene_factory, quantity, float(tolerance), time, scale, budget, max_runs).find(bodies, rules, start)


def _listed(choice: Any) -> list[Any]:
    if choice is None:
        return []
    return list(choice) if isinstance(choice, Sequence) else [choice]


def _rules(time: float | None, dt: float | None) -> list[Any]:
    if time is None:
        return [Static(), Relaxation(damping=Adaptive())]
    step = dt or time / 50.0
    return [Explicit(), Newmark(step), GeneralizedAlpha(step), ContactDynamics(step)]


class _Watched(Settings):
    """Settings that know which of their numbers were read."""

    def __getattribute__(self, name: str) -> Any:
        if name in READ or name in ("body", "integrator"):
            object.__getattribute__(self, "__dict__").setdefault("_read", set()).add(name)
        return object.__getattribute__(self, name)


class _Exhausted(Exception):
    """The budget is spent."""


class _Search:
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
        for body in bodies:
            for rule in rules:
                if not first and ("body" not in self.read and body is not bodies[0]):
                    continue
                numbers = self._numbers(body, rule, start)
                run = self.run(Settings.of(body, rule, **numbers))
                if first or run.cost < SHORT_RUN:
                    run = self.run(run.settings)  # kernels were loaded in the first
                first = False
                knobs = [Knob(name, value) for name, value in numbers.items() if self._counts(name, body, rule)]
                fixed = {name: value for name, value in numbers.items() if name not in {k.name for k in knobs}}
                track = Track(knobs, self._runner(body, rule, fixed), body is bodies[0])
                track.runs[track.base], track.spent = run, run.cost
                track.begin()
                self.tracks.append(track)

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

    def _runner(self, body: Any, rule: Any, fixed: dict[str, float]) -> Callable[[dict[str, float]], Run]:
        return lambda numbers: self.run(Settings.of(body, rule, **fixed, **numbers))

    # -------------------------------------------------------------------------------------------------- the limit

    def find(self, bodies: list[Any], rules: list[Any], start: dict[str, float | None]) -> Tuned:
        """Limit first, then the cheapest settings near it."""
        why = "the budget is spent"
        try:
            self.candidates(bodies, rules, start)
            if not any(track.trusted and not track.dead for track in self.tracks):
                why = f"no run of {type(bodies[0]).__name__} gave a value: {self.runs[0].failure}"
                raise _Exhausted
            if not self.converge():
                why = "refining does not settle the limit"
                raise _Exhausted
            self.compete()
            self.finish()
        except _Exhausted:
            self._settle(ENOUGH)
        chosen = self.chosen()
        best = self.told(chosen)
        if chosen is None or best.error > self.tolerance:
            raise ToleranceError(
                f"a relative error of {self.tolerance:g} was not reached: {why} ({self.total:.0f} of {self.budget:g} s "
                f"in {len(self.runs)} runs); the best estimate is {best.value:.6g} with an error of about "
                f"{best.uncertainty:.1g}. A larger budget, a finer start or a larger tolerance helps; where the "
                "quantity is close to zero give a scale",
                best,
            )
        return best

    def converge(self) -> bool:
        """Refine the trusted tracks, the one that has cost least first, until limits are sure and agree."""
        aim = AIM
        while True:
            live = [t for t in self.tracks if t.trusted and not t.dead]
            sure = [t for t in live if self._sure(t, aim)]
            if sure:
                first = min(sure, key=lambda t: t.estimate[1])
                witness = self._witness(first, live)
                if witness is None or self._agree(first, witness):
                    self._take(first)
                    return True
                aim *= 0.5  # one of the two is wrong about itself
                if aim < AIM / 16:
                    return False
            steps = [(t, t.next_step(self.allowed(t.estimate[0]) * aim)) for t in live if t not in sure]
            steps = [(t, step) for t, step in steps if step is not None]
            if not steps:
                return self._settle(ENOUGH)
            track, (k, target) = min(steps, key=lambda item: item[0].spent + item[0].expected(item[1][1]))
            if track.expected(target) > self.budget - self.total:
                return self._settle(ENOUGH)
            track.refine(k, target)

    def _sure(self, track: Track, share: float) -> bool:
        """Whether the limit of a track is known to so much of the tolerance, looked at with all numbers finer."""
        value, doubt = track.estimate
        allowed = self.allowed(value)
        if not doubt <= share * allowed:
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
                left -= 1
                run = track.try_at(trial)
                if self.within(run) and run.cost < 1.05 * track.runs[at].cost:
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


def _closure(sim: Any) -> float | None:
    """Energy closure of a run that has one."""
    if not isinstance(sim, Simulation) or sim.ledger is None or sim.integrator.scaled:
        return None
    return abs(float(sim.energy.closure))
