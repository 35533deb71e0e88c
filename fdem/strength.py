"""Factor of safety: by how much the strength of joints may fall until equilibrium is lost."""

from __future__ import annotations

import copy
import warnings
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fdem.errors import ConvergenceError, FdemWarning, SceneError
from fdem.integrate.explicit import Relaxation
from fdem.log import logger
from fdem.scene.checks import number
from fdem.scene.scene import Scene
from fdem.simulation import Simulation

__all__ = ["StrengthReduction", "strength_reduction"]

RATIO = 1e-5  # solve ratio of a state that counts as equilibrium
STEPS = 3  # of an integrator that sees at once whether blocks stand


@dataclass(frozen=True)
class StrengthReduction:
    """Between which factors equilibrium is lost.

    Attributes
    ----------
    lower, upper : float
        Largest factor with equilibrium, smallest without; infinite if there is one at the upper bound.
    sim : Simulation
        The state without equilibrium at `upper` (with it at `lower`, if `upper` is infinite).
    trials : list of (float, bool)
        Factors tried, and whether there was equilibrium.
    """

    lower: float
    upper: float
    sim: Simulation
    trials: list[tuple[float, bool]] = field(default_factory=list)


def strength_reduction(
    scene_or_sim: Scene | Simulation,
    integrator: Any = None,
    *,
    tolerance: float = 0.01,
    bounds: tuple[float, float] = (0.5, 5.0),
    target: Any = None,
    max_cycles: int = 200_000,
) -> StrengthReduction:
    """Bracket the factor that divides cohesion, tension and tan(friction) of joints when equilibrium is lost.

    Parameters
    ----------
    scene_or_sim : Scene or Simulation
        A simulation goes on from its state and with its loads.
    integrator : Relaxation, Static or ContactDynamics, optional
        What looks for equilibrium; None: that of the simulation, `Relaxation` for a scene.
    tolerance : float, optional
        Of the bracket, as part of its lower end.
    bounds : (float, float), optional
        Factors to stay between.
    target : selector, optional
        Reduce only the joint rules that were given for this target, or with it in `between`; None: all.
    max_cycles : int, optional
        Cycles after which a state that is neither at rest nor collapsing counts as lost, with a warning.

    Returns
    -------
    StrengthReduction
        ``.lower``, ``.upper``, ``.sim`` (the failed state), ``.trials``.

    Raises
    ------
    SceneError
        There is no equilibrium at the lower bound, or no rule for `target`.
    UnsupportedError
        A joint law cannot be weakened.

    Notes
    -----
    Every trial starts from the last state in equilibrium, since friction remembers the way. Zienkiewicz, Humpheson &
    Lewis, Geotechnique 25 (1975) 671.
    """
    number("strength_reduction", "tolerance", tolerance, low=1e-6, high=1.0)
    low, high = (number("strength_reduction", "bounds", value, low=0.0, open_low=True) for value in bounds)
    if not low <= 1.0 <= high or low == high:
        raise SceneError(f"strength_reduction: bounds = {bounds!r}, allowed are two factors with 1 between them")
    search = _Search(scene_or_sim, integrator, target, max_cycles)
    lower, upper = 0.0, np.inf
    for factor in (1.0, high, low):
        if lower < factor < upper:
            if search.stands(factor):
                lower = factor
            else:
                upper = factor
    if lower == 0.0:
        raise SceneError(f"strength_reduction: no equilibrium even at the factor {low:g}, the lower bound")
    while np.isfinite(upper) and upper - lower > tolerance * lower:
        middle = float(np.sqrt(lower * upper))
        if search.stands(middle):
            lower = middle
        else:
            upper = middle
    failed = search.fallen if np.isfinite(upper) else search.standing
    assert failed is not None
    return StrengthReduction(lower, float(upper), failed, search.trials)


class _Search:
    """Trials at factors, each from the last state in equilibrium."""

    def __init__(self, scene_or_sim: Scene | Simulation, integrator: Any, target: Any, most: int) -> None:
        self.start = scene_or_sim if isinstance(scene_or_sim, Simulation) else None
        self.scene = scene_or_sim.scene if isinstance(scene_or_sim, Simulation) else scene_or_sim
        if integrator is None:
            integrator = Relaxation() if self.start is None else self.start.integrator
        self.integrator, self.most = integrator, most
        self.standing: Simulation | None = None
        self.fallen: Simulation | None = None
        self.trials: list[tuple[float, bool]] = []
        if not isinstance(self.scene, Scene):
            raise SceneError(f"strength_reduction: {scene_or_sim!r} is neither a scene nor a simulation")
        self.chosen = [_is_for(rule, target) for rule in self.scene.joints]
        if not any(self.chosen):
            raise SceneError(f"strength_reduction: target = {target!r} has no joint rule; give it one by scene.joint")

    def stands(self, factor: float) -> bool:
        """Whether there is equilibrium at `factor`."""
        scene = copy.copy(self.scene)
        scene.joints = [
            replace(rule, law=rule.law.weakened(factor)) if chosen else rule
            for rule, chosen in zip(self.scene.joints, self.chosen, strict=True)
        ]
        start = self.start if self.standing is None else self.standing
        sim = Simulation(scene, self.integrator, start=start, progress=False, energy=False)
        stood = self._at_rest(sim)
        logger.info("strength over %.4g: %s", factor, "equilibrium" if stood else "none")
        self.trials.append((factor, stood))
        if stood:
            self.standing = sim
        elif self.fallen is None or factor < min((f for f, s in self.trials[:-1] if not s), default=np.inf):
            self.fallen = sim
        return stood

    def _at_rest(self, sim: Simulation) -> bool:
        """Let a simulation find its equilibrium, if there is one."""
        at_once = getattr(sim.integrator, "at_rest", None)
        if at_once is not None and not any(batch.has_internal for batch in sim.model.batches):
            sim.state.v[:] = 0.0
            try:
                sim.cycle(STEPS)
            except ConvergenceError:
                return False
            return bool(at_once(STEPS * RATIO))
        report = sim.solve(ratio=RATIO, max_cycles=self.most)
        if report.reason == "cycles":
            warnings.warn(
                f"strength_reduction: no verdict after {self.most} cycles (ratio {report.ratio:.2g}); taken as lost",
                FdemWarning,
                stacklevel=4,
            )
        return bool(report.converged)


def _is_for(rule: Any, target: Any) -> bool:
    if target is None:
        return True
    sides = [rule.target] if rule.between is None else list(rule.between)
    return any(side is target or (isinstance(side, str) and side == target) for side in sides)
