"""Deformable discrete elements: blocks, joints and how they move, from geometry to pictures.

Everything a user needs is ``import fdem``. SI units; degrees for angles; z up by habit, x east, y
north for dip directions (clockwise from y). Stress is tension positive, contact traction
compression positive, a `Pressure` pushes inward. Stress and strain vectors are xx yy zz yz zx xy
with engineering shear strain; quaternions are (w, x, y, z).
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOME = {
    "fdem.errors": (
        "CheckpointError",
        "ConvergenceError",
        "FdemError",
        "FdemWarning",
        "JointError",
        "MeshError",
        "OverlapError",
        "SceneError",
        "SolveError",
        "ToleranceError",
        "UnstableError",
        "UnsupportedError",
    ),
    "fdem.log": ("show_log",),
    "fdem._jit": ("kernel",),
    "fdem.scene.bodies": ("LinearStrain", "Rigid", "UniformStrain", "Zoned"),
    "fdem.scene.materials": ("Elastic",),
    "fdem.scene.joints": ("BartonBandis", "Bonded", "Coulomb", "Hertz", "Joint"),
    "fdem.scene.boundary": (
        "Displacement",
        "Drag",
        "Force",
        "Moment",
        "Pressure",
        "Stress",
        "Support",
        "Traction",
        "Velocity",
    ),
    "fdem.scene.scene": ("Scene",),
    "fdem.scene.generate": (
        "arch",
        "brick",
        "convex_hull",
        "icosphere",
        "polyhedron",
        "prism",
        "surface",
        "tet_mesh",
        "voronoi",
        "wall",
    ),
    "fdem.scene.round": ("clump", "cylinder", "sphere"),
    "fdem.scene.cutting": ("Disc", "JointSet", "cut"),
    "fdem.scene.reading": ("read",),
    "fdem.integrate.explicit": ("Adaptive", "Explicit", "Local", "Rayleigh", "Relaxation"),
    "fdem.integrate.implicit": ("GeneralizedAlpha", "Newmark"),
    "fdem.integrate.nonsmooth": ("ContactDynamics",),
    "fdem.integrate.sleep": ("Sleep",),
    "fdem.integrate.static": ("Static",),
    "fdem.simulation": ("Report", "Simulation", "load"),
    "fdem.tuning.result": ("Tuned",),
    "fdem.tuning.tune": ("tune",),
    "fdem.tuning.settings": ("Settings",),
    "fdem.strength": ("StrengthReduction", "strength_reduction"),
    "fdem.results.history": ("Every", "History"),
    "fdem.results.output": ("Checkpoint", "Frames"),
}
_WHERE = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "Adaptive",
    "BartonBandis",
    "Bonded",
    "Checkpoint",
    "CheckpointError",
    "ContactDynamics",
    "ConvergenceError",
    "Coulomb",
    "Disc",
    "Displacement",
    "Drag",
    "Elastic",
    "Every",
    "Explicit",
    "FdemError",
    "FdemWarning",
    "Force",
    "Frames",
    "GeneralizedAlpha",
    "Hertz",
    "History",
    "Joint",
    "JointError",
    "JointSet",
    "LinearStrain",
    "Local",
    "MeshError",
    "Moment",
    "Newmark",
    "OverlapError",
    "Pressure",
    "Rayleigh",
    "Relaxation",
    "Report",
    "Rigid",
    "Scene",
    "SceneError",
    "Settings",
    "Simulation",
    "Sleep",
    "SolveError",
    "Static",
    "StrengthReduction",
    "Stress",
    "Support",
    "ToleranceError",
    "Traction",
    "Tuned",
    "UniformStrain",
    "UnstableError",
    "UnsupportedError",
    "Velocity",
    "Zoned",
    "arch",
    "brick",
    "clump",
    "convex_hull",
    "cut",
    "cylinder",
    "icosphere",
    "kernel",
    "load",
    "polyhedron",
    "prism",
    "read",
    "show_log",
    "sphere",
    "strength_reduction",
    "surface",
    "tet_mesh",
    "tune",
    "voronoi",
    "wall",
]


def __getattr__(name: str) -> Any:
    """Import a public name where it is first used, so that ``import fdem`` stays cheap."""
    if name not in _WHERE:
        raise AttributeError(f"module 'fdem' has no attribute {name!r}")
    value = getattr(import_module(_WHERE[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
