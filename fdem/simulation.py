"""Simulation: a scene, an integrator and the loop that brings them together."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fdem import checkpoint
from fdem.compile import Compiled, compile_scene
from fdem.contact import carry
from fdem.contact.parking import Parking
from fdem.contact.rates import Rated
from fdem.errors import FdemWarning, SceneError
from fdem.guard import CHECK_EVERY, Guard
from fdem.integrate.explicit import Explicit, Relaxation
from fdem.integrate.system import System
from fdem.loads import Release
from fdem.readout import Readout
from fdem.results.energy import Ledger
from fdem.results.history import Every, History, adapted, watch
from fdem.scene.checks import number
from fdem.scene.kept import Kept
from fdem.scene.scene import Applied, Fix, Gridpoint, Scene, Where
from fdem.stopping import Report, solve
from fdem.views import BlockView, GridpointView, LoadView

__all__ = ["Report", "Simulation", "load"]


class Simulation(Readout):
    """A compiled scene that an integrator moves.

    Parameters
    ----------
    scene : Scene
        What to simulate.
    integrator : Explicit, Relaxation, Newmark, GeneralizedAlpha, Static or ContactDynamics
        How.
    start : Simulation or path, optional
        Another simulation (or a saved file) whose state goes over by block name. Fictitious time and
        velocities of a Relaxation do not go over to another integrator.
    threads : int, optional
        Threads of the zone kernels; the bits do not depend on it. None: 1.
    progress : bool, optional
        Show progress on stderr; None: if it is a terminal.
    energy : bool, optional
        Keep the energy ledger.

    Raises
    ------
    SceneError, JointError, MeshError
        If the scene is wrong; before the first step.
    """

    def __init__(
        self,
        scene: Scene,
        integrator: Any,
        *,
        start: Simulation | str | Path | None = None,
        threads: int | None = None,
        progress: bool | None = None,
        energy: bool = True,
    ) -> None:
        if not isinstance(scene, Scene):
            raise SceneError(f"Simulation: scene = {scene!r} is not a Scene")
        if isinstance(integrator, type) or not callable(getattr(integrator, "step", None)):
            raise SceneError(f"Simulation: integrator = {integrator!r} is not an integrator")
        if threads is not None and (not isinstance(threads, int) or threads < 1):
            raise SceneError(f"Simulation: threads = {threads!r}, allowed is a whole number >= 1")
        self.scene, self.integrator = scene, replace(integrator)
        self._threads, self._progress = threads or 1, progress
        self.ledger = Ledger() if energy else None
        self._observers: list[Any] = []
        self._guard = Guard()
        self._applied: dict[Applied, Applied] = {handle: replace(handle) for handle in scene.loads}
        self._removed: frozenset[str] = frozenset()
        self._releases: list[tuple[np.ndarray, np.ndarray, int, int]] = []
        source = _saved(start, scene, integrator) if isinstance(start, (str, Path)) else start
        if source is not None and not isinstance(source, Simulation):
            raise SceneError(f"Simulation: start = {start!r}, allowed is a simulation or the path of a saved one")
        if source is not None:
            self._removed = source._removed
            # loads applied on the way go along within a scene; those of another scene know other blocks
            known = source._applied if source.scene.loads is scene.loads else self._applied
            self._applied |= {key: replace(value) for key, value in source._applied.items() if key in known}
        self._before = None if source is None else Kept.of(source.compiled.layout)
        self._compile()
        if self.integrator.scaled:
            self.state.v[:] = 0.0  # the speeds of the scene are in m/s, not per unit of fictitious time
        if source is not None:
            checkpoint.transfer(source, self)
        self.integrator.start(self.system)
        if self.ledger is not None:
            self.ledger.entry(self.stored())

    def _compile(self) -> None:
        self.compiled: Compiled = compile_scene(
            self.scene, self._removed, list(self._applied.values()), self._threads, self._before
        )
        self._make_system(self.compiled)
        self.x0, self.centroids0 = self.places(), self.centroids()
        self.turned = np.zeros((self.model.n_blocks, 3))

    def _make_system(self, compiled: Compiled) -> None:
        self.model, self.state, self.drags = compiled.model, compiled.state, compiled.drags
        self._turning = [_run(batch.rows) for batch in compiled.model.batches if batch.turns]
        self._turns = getattr(self.integrator, "take_turns", self._advanced)
        contacts, state, model = compiled.contacts, compiled.state, compiled.model
        if contacts is not None and getattr(self.integrator, "sleep", None) is not None:
            contacts = Parking(contacts, state.x, state.x_old, model.gp_block, model.batch_index < 0)
        if contacts is not None and getattr(self.integrator, "substeps", 1) > 1:
            contacts = Rated(contacts)
        loads = compiled.loads + [Release(None, gp, forces, at, over) for gp, forces, at, over in self._releases]
        self.system = System(
            compiled.model,
            compiled.state,
            contacts,
            compiled.particles,
            compiled.constraints,
            loads,
            compiled.alpha,
            energy=self.ledger is not None,
        )

    @property
    def dt(self) -> float:
        """The time step now [s]."""
        return float(self.integrator.step_length)

    @property
    def ratio(self) -> float:
        """Solve ratio: largest unbalanced force over the largest force acting."""
        return self.system.ratio()

    def _steps(self, n: int, end: float | None = None) -> None:
        """Take `n` steps, or as many as `end` [s] needs, stopping where observers are due."""
        progress = self._start_progress(n, end)
        observers = [*self._observers, *([progress] if progress is not None else [])]
        done = 0
        while done < n and (end is None or end - self.state.t > 1e-6 * self.dt):
            due = [self.state.step + o.next(self.state.step, self.state.t, self.dt) for o in observers]
            target = min([self.state.step + min(n - done, CHECK_EVERY), *due])
            while self.state.step < target and (end is None or end - self.state.t > 1e-6 * self.dt):
                self._step(self.dt if end is None else _fit(self.dt, end - self.state.t))
                done += 1
            self._guard.look(self)
            for observer, step in zip(observers, due, strict=True):
                if step <= self.state.step:
                    observer.record(self)
        if progress is not None:
            progress.finish()

    def _step(self, dt: float) -> None:
        self.integrator.step(self.system, dt)
        for rows, turn in zip(self._turning, self._turns(), strict=True):
            self.turned[rows] += turn

    def _advanced(self) -> list[np.ndarray]:
        """Rotation vectors of the last explicit step, of the batches that turn."""
        state, dt = self.state, self.system.dt
        return [batch.turn(state.q, state.v, dt) for batch in self.model.batches if batch.turns]

    def _start_progress(self, n: int, end: float | None) -> Any:
        if self._progress is False:
            return None
        from fdem.results.progress import Progress

        left = None if end is None else end - self.state.t
        progress = Progress(n if end is None else None, left, show=self._progress)
        if not progress.active:
            return None
        progress.start(self)
        return progress

    def cycle(self, n: int) -> None:
        """Advance by `n` steps."""
        if not isinstance(n, (int, np.integer)) or n < 0:
            raise SceneError(f"cycle: n = {n!r}, allowed is a whole number >= 0")
        if not np.isfinite(self.dt):
            raise SceneError("cycle: nothing limits the step; give Explicit a dt, or use run(time)")
        self._steps(int(n))

    def run(self, time: float) -> None:
        """Advance by `time` [s]; the last steps are shortened to end there."""
        number("run", "time", time, low=0.0)
        if not np.isfinite(self.dt):
            self.integrator.step_length = time / 1000.0  # nothing limits the step: at rest, in free flight
        self._steps(2**62, self.state.t + float(time))

    def solve(self, ratio: float = 1e-5, max_cycles: int = 200_000) -> Report:
        """Step until equilibrium, collapse or `max_cycles`.

        Parameters
        ----------
        ratio : float, optional
            Solve ratio to reach.
        max_cycles : int, optional
            Steps after which to give up.

        Returns
        -------
        Report
            Why it stopped, with ratio, kinetic energy and the displacement still to come. `Static` takes one step,
            that is all its load steps, to the smaller of `ratio` and its own tolerance.
        """
        number("solve", "ratio", ratio, low=0.0, open_low=True)
        if not isinstance(max_cycles, (int, np.integer)) or max_cycles < 0:
            raise SceneError(f"solve: max_cycles = {max_cycles!r}, allowed is a whole number >= 0")
        return solve(self, ratio, int(max_cycles))

    def apply(self, load: Any, target: Any = None, where: Where | None = None, factor: Any = 1.0) -> Applied:
        """Apply a load from now on (see `Scene.apply`)."""
        handle = self.scene.applied(load, target, where, factor)
        self._rebuild(applied=self._applied | {handle: replace(handle)})
        return handle

    def excavate(self, target: Any = None, where: Where | None = None, over: int = 0) -> list[str]:
        """Remove blocks; what they did to the others is released over so many cycles.

        Parameters
        ----------
        target : selector, optional
            Blocks to remove.
        where : callable, optional
            (n, 3) block centroids -> (n,) bool.
        over : int, optional
            Cycles of the release; 0: at once.

        Returns
        -------
        list of str
            Names of the blocks removed.

        Raises
        ------
        SceneError
            If nothing is selected, or everything.
        """
        if not isinstance(over, (int, np.integer)) or over < 0:
            raise SceneError(f"excavate: over = {over!r}, allowed is a whole number >= 0")
        chosen = self.scene._where("excavate", self.scene.select_blocks(target), where)
        gone = [b.name for b in chosen if b.name not in self._removed]
        if not gone:
            raise SceneError(f"excavate: target {target!r} selects no block that is still there")
        release = [(*self.tractions_of(gone), self.state.step, int(over))] if over else []
        self._rebuild(removed=self._removed | frozenset(gone), release=release)
        self._end_histories()
        return gone

    def _end_histories(self) -> None:
        """Histories of blocks that are gone, or of groups that shrank, keep what they have and record no more."""
        for history in [o for o in self._observers if isinstance(o, History)]:
            try:
                history.record(self)
            except SceneError as error:
                self._observers.remove(history)
                warnings.warn(f"history {history.name!r} ends here: {error}", FdemWarning, stacklevel=3)

    def _rebuild(
        self,
        applied: dict[Applied, Applied] | None = None,
        removed: frozenset[str] | None = None,
        release: Sequence[tuple[np.ndarray, np.ndarray, int, int]] = (),
    ) -> None:
        """Compile again and move the state over: the one mechanism for every change on the way."""
        applied = self._applied if applied is None else applied
        removed = self._removed if removed is None else removed
        # first of all, so that a change that is refused changes nothing
        compiled = compile_scene(self.scene, removed, list(applied.values()), self._threads, self._before)
        before = self.stored() if self.ledger is not None else {}
        old = checkpoint.Carrier(self)
        self.compiled, self._applied, self._removed = compiled, applied, removed
        number = old.gridpoints(compiled.model)
        running = [entry for entry in (*self._releases, *release) if self.state.step - entry[2] < entry[3]]
        self._releases = []
        for gp, forces, at, over in running:
            left = number[gp] >= 0
            self._releases.append((number[gp][left], forces[left], at, over))
        self._make_system(compiled)
        self.x0, self.centroids0 = self.places(), self.centroids()
        self.turned = np.zeros((self.model.n_blocks, 3))
        checkpoint.carry(old, self)
        self.integrator.start(self.system)
        if self.ledger is not None:
            self.ledger.rebase(before, self.stored())

    def reset(self, what: str = "displacement") -> None:
        """Set "displacement", "velocity", "slip" or "time" to zero."""
        if what == "displacement":
            self.x0, self.centroids0 = self.places(), self.centroids()
            self.turned[:] = 0.0
        elif what == "velocity":
            before = self.stored() if self.ledger is not None else {}
            self.state.v[:] = 0.0
            self.system.lag = 0.0
            self.system.current = False
            if self.ledger is not None:
                self.ledger.rebase(before, self.stored())
        elif what == "slip":
            if self.system.contacts is not None:
                carry.reset_slip(self.system.contacts)
                self.system.current = False
        elif what == "time":
            self.state.t = 0.0
        else:
            raise SceneError(f'reset: what = {what!r}, allowed are "displacement", "velocity", "slip", "time"')

    def history(
        self, target: Any, name: str | None = None, component: str | int | None = None, every: int | Every | None = 1
    ) -> History:
        """Record a quantity every so many steps.

        Parameters
        ----------
        target : selector, Gridpoint, Applied, Fix, callable or str
            What to watch; a callable is a function of the simulation; the name of a quantity of the
            whole simulation ("ratio", "kinetic", ...) stands alone.
        name : str, optional
            Quantity, as in ``sim[target]``.
        component : str or int, optional
            "x", "y", "z", "xx", ..., or an index.
        every : int or Every, optional
            Steps between two records.

        Returns
        -------
        History
            With ``time``, ``steps``, ``values`` and ``unit``.
        """
        history = watch(target, name, component, every)
        history.record(self)
        self._observers.append(history)
        return history

    def observe(self, observer: Any) -> Any:
        """Add an observer: anything with ``next(step, t, dt)`` or ``next(step, t)``, and ``record(sim)``."""
        for method in ("next", "record"):
            if not callable(getattr(observer, method, None)):
                raise SceneError(f"observe: observer = {observer!r} has no {method}()")
        observer.record(self)
        self._observers.append(adapted(observer))
        return observer

    def __getitem__(self, target: Any) -> Any:
        """View of blocks, a gridpoint, a load or a support."""
        if isinstance(target, Applied):
            if target not in self._applied:
                raise SceneError("this load was not applied to the scene or simulation")
            return LoadView(self, self._applied[target])
        if isinstance(target, Fix):
            return LoadView(self, target)
        if isinstance(target, Gridpoint):
            return GridpointView(self, self.compiled.select.nearest(target))
        rows = self.compiled.select.blocks(target, "sim[...]")
        if not rows:
            raise SceneError(f"sim[{target!r}]: all its blocks have been removed")
        single = len(rows) == 1 and not isinstance(target, (list, tuple))
        return BlockView(self, rows, single)

    def save(self, path: str | Path) -> None:
        """Save the state, so that `load` continues bit for bit."""
        checkpoint.save(self, path)


def _run(rows: np.ndarray) -> np.ndarray | slice:
    """Rows as a slice where they follow each other: much cheaper for many."""
    first = int(rows[0])
    return slice(first, first + len(rows)) if np.array_equal(rows, first + np.arange(len(rows))) else rows


def _fit(dt: float, left: float) -> float:
    """Step that lands on the end: the last two share what is left."""
    if left <= dt * (1 + 1e-6):
        return left
    return 0.5 * left if left < 2 * dt else dt


def _saved(path: str | Path, scene: Scene, integrator: Any) -> Simulation:
    """The simulation a file holds, whichever kind of integrator wrote it."""
    saved = checkpoint.read(path)
    if saved["head"]["scaled"] != integrator.scaled:
        integrator = Relaxation() if saved["head"]["scaled"] else Explicit()
    sim = Simulation(scene, integrator, progress=False)
    checkpoint.restore(saved, sim)
    return sim


def load(path: str | Path, scene: Scene, integrator: Any, **options: Any) -> Simulation:
    """Continue a saved simulation bit for bit.

    Parameters
    ----------
    path : path
        What `Simulation.save` wrote.
    scene : Scene
        The same scene, built again.
    integrator : Explicit, Relaxation, ...
        The same integrator.
    **options
        As of `Simulation`.

    Returns
    -------
    Simulation
        At the saved time.

    Raises
    ------
    CheckpointError
        If the file cannot be read, does not fit the scene, or needs a callable that is missing.
    """
    saved = checkpoint.read(path)
    sim = Simulation(scene, integrator, **options)
    checkpoint.restore(saved, sim)
    return sim
