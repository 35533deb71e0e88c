"""Settings of a simulation that decide how exact it is and what it costs."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

__all__ = ["Settings"]


@dataclass(frozen=True)
class Settings:
    """What a scene is to be built and solved with.

    Attributes
    ----------
    body : Rigid, UniformStrain, LinearStrain or Zoned
        Formulation, with `size` in it if it has one.
    integrator : integrator
        With `dt` or `safety` in it if it has one.
    size : float or None
        Edge of zones, facets or pieces [m].
    dt : float or None
        Time step [s].
    safety : float or None
        Share of the stable step that an explicit integrator takes.
    kn : float or None
        Stiffness of contacts [Pa/m], where it stands for a hard contact.
    ratio : float or None
        Solve ratio of a quasi-static run.
    """

    body: Any = None
    integrator: Any = None
    size: float | None = None
    dt: float | None = None
    safety: float | None = None
    kn: float | None = None
    ratio: float | None = None

    @classmethod
    def of(cls, body: Any, integrator: Any, **numbers: float | None) -> Settings:
        """Settings whose body and integrator carry the size, step, share and tolerance given."""
        size, dt, safety = numbers.get("size"), numbers.get("dt"), numbers.get("safety")
        if size is not None and hasattr(body, "size"):
            body = replace(body, size=size)
        if dt is not None and hasattr(integrator, "dt"):
            integrator = replace(integrator, dt=dt)
        if safety is not None and hasattr(integrator, "safety"):
            integrator = replace(integrator, safety=safety)
        ratio = numbers.get("ratio")
        if ratio is not None and getattr(integrator, "static", False):
            integrator = replace(integrator, tolerance=ratio)
        return cls(body, integrator, **numbers)

    @property
    def key(self) -> tuple[Any, ...]:
        """Equal for equal settings."""
        return self.kind, *(getattr(self, f.name) for f in fields(self)[2:])

    @property
    def kind(self) -> str:
        """Formulation and integrator without the numbers: ``"Zoned(strain='small'), Static"``."""
        return f"{_told(self.body, ('size',))}, {_told(self.integrator, ('dt', 'safety', 'tolerance'))}"

    def __str__(self) -> str:
        numbers = [f"{f.name}={getattr(self, f.name):.3g}" for f in fields(self)[2:] if getattr(self, f.name)]
        return "; ".join([self.kind, " ".join(numbers)] if numbers else [self.kind])


def _told(thing: Any, without: tuple[str, ...]) -> str:
    """Name of an option object and the options that are not the default, `without` some."""
    if thing is None:
        return "-"
    shown = []
    for field in fields(thing):
        value = getattr(thing, field.name)
        if field.init and field.name not in without and value != field.default:
            shown.append(f"{field.name}={_told(value, ()) if hasattr(value, '__dataclass_fields__') else repr(value)}")
    return type(thing).__name__ + (f"({', '.join(shown)})" if shown else "")
