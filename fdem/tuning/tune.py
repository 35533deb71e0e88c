"""Tolerance in, settings out: the cheapest formulation, mesh, step and contact stiffness for an error asked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from fdem.errors import SceneError
from fdem.integrate.explicit import Adaptive, Explicit, Relaxation
from fdem.integrate.implicit import GeneralizedAlpha, Newmark
from fdem.integrate.nonsmooth import ContactDynamics
from fdem.integrate.static import Static
from fdem.scene.bodies import LinearStrain, Rigid, UniformStrain, Zoned
from fdem.tuning.result import Tuned
from fdem.tuning.search import Search
from fdem.tuning.settings import Settings

__all__ = ["tune"]


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
        To choose from. None: explicit and implicit ones if `time` is given, contact dynamics too if `kn` is,
        otherwise those for rest.
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
    rules = _listed(integrator) or _rules(time, dt, kn)
    start = {"size": size, "dt": dt, "kn": kn, "ratio": ratio}
    return Search(scene_factory, quantity, float(tolerance), time, scale, budget, max_runs).find(
        bodies, rules, start, unnamed=body is None
    )


def _listed(choice: Any) -> list[Any]:
    if choice is None:
        return []
    return list(choice) if isinstance(choice, Sequence) else [choice]


def _rules(time: float | None, dt: float | None, kn: float | None) -> list[Any]:
    if time is None:
        return [Static(), Relaxation(damping=Adaptive())]
    step = dt or time / 50.0
    # hard contact is another model where the stiffness of joints is a datum
    hard = [] if kn is None else [ContactDynamics(step)]
    return [Explicit(), Newmark(step), GeneralizedAlpha(step), *hard]
