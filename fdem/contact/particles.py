"""Particles and their laws, as the contact of spheres takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.errors import SceneError

__all__ = ["Particles", "SphereLaw", "SphereTable"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

DENSE = 4096  # rows of a table that holds every combination of classes
COLUMNS = 10


@dataclass
class Particles:
    """Spheres that meet others: bodies of their own, or members of a clump.

    Attributes
    ----------
    gp, block : (n,) int32
        Gridpoint at the centre, and block.
    radius : (n,)
        [m].
    spin : (n,) int64
        First rotational velocity of the block in ``v``, -1: it does not turn.
    """

    gp: Ints
    block: Ints
    radius: Array
    spin: NDArray[np.int64]

    def __len__(self) -> int:
        """Count the particles."""
        return len(self.gp)


@dataclass(frozen=True)
class SphereLaw:
    """One joint rule as spheres feel it.

    Attributes
    ----------
    hertz : bool
        Hertz-Mindlin; else linear springs.
    kn, ks : float
        Of linear springs, per reference area [Pa/m].
    tan : float
        Tangent of the friction angle.
    damping : float
        Fraction of critical.
    compliance : (float, float) or None
        ``(1 - nu^2) / E`` and ``(2 - nu) / G`` [1/Pa] for every body that has a material; None: their own.
    rolling, twisting : float
        Lengths [m] that times the normal force limit the couples.
    name : str
        For messages.
    """

    hertz: bool
    kn: float
    ks: float
    tan: float
    damping: float
    compliance: tuple[float, float] | None
    rolling: float
    twisting: float
    name: str


class SphereTable:
    """Rows of constants that contacts of spheres read, by rule and by the classes of the two sides.

    Parameters
    ----------
    laws : sequence of SphereLaw
    radius : (n,) array
        Radius of every side that can meet another: particles, then the faces of each block (infinite) [m].
    inverse_mass : (n,) array
        0 where it cannot move [1/kg].
    compliance : (n, 2) array
        ``(1 - nu^2) / E`` and ``(2 - nu) / G`` [1/Pa]: 0 for a rigid body, not a number where a material lacks them.
    material : (n,) bool array
        Whether the side has a material, so that a law's elastic constants stand for it.
    names : sequence of str
        Of the block of each side, for messages.

    Notes
    -----
    Sides that are alike make a class. Few classes: all combinations are tabulated once, and a row number is looked up.
    Many (a size distribution): each contact gets a row of its own.
    """

    def __init__(
        self,
        laws: Sequence[SphereLaw],
        radius: Array,
        inverse_mass: Array,
        compliance: Array,
        material: Any,
        names: Sequence[str],
    ) -> None:
        self.laws, self._names = tuple(laws), names
        sides = np.column_stack([radius, inverse_mass, compliance, np.asarray(material, dtype=float)])
        # not-a-number is a class too
        unique, first, inverse = np.unique(
            np.where(np.isnan(sides), -1.0, sides), axis=0, return_index=True, return_inverse=True
        )
        self._sides, self._first = sides[first], first
        self._class = inverse.ravel().astype(np.int64)
        n = len(unique)
        self.dense = n * n * len(self.laws) <= DENSE
        self._n = n
        self.rows = np.zeros((0, COLUMNS))
        self._checked = np.zeros(n * n * len(self.laws), dtype=bool) if self.dense else None
        if self.dense:
            rule, a, b = (part.ravel() for part in np.indices((len(self.laws), n, n)))
            self.rows = self._constants(rule, a, b, check=False)

    def kinds(self, rule: Any, a: Any, b: Any) -> NDArray[np.uint32]:
        """Row of the table for contacts between sides `a` and `b` under `rule`, (m,) each.

        Without a dense table this makes the rows anew, one per contact: ask for all contacts at once.

        Raises
        ------
        SceneError
            A Hertz law meets bodies without elastic constants.
        """
        first, second = self._class[a], self._class[b]
        rule = np.asarray(rule, dtype=np.int64)
        if self._checked is None:
            self.rows = self._constants(rule, first, second, check=True)
            return np.arange(len(rule), dtype=np.uint32)
        kind = (rule * self._n + first) * self._n + second
        if not self._checked[kind].all():
            new = np.unique(kind[~self._checked[kind]])
            self._constants(new // self._n**2, new // self._n % self._n, new % self._n, check=True)
            self._checked[new] = True
        return kind.astype(np.uint32)

    def _constants(self, rule: Any, a: Any, b: Any, check: bool) -> Array:
        """Rows (n, 10) of kernels/spheres.py for pairs of classes."""
        rows = np.zeros((len(rule), COLUMNS))
        for k, law in enumerate(self.laws):
            mine = np.flatnonzero(rule == k)
            first, second = self._sides[a[mine]], self._sides[b[mine]]
            inverse = first[:, 1] + second[:, 1]
            with np.errstate(divide="ignore", invalid="ignore"):
                mass = 1.0 / inverse
                if law.hertz:
                    rows[mine, :4] = self._hertz(law, first, second, mass, a[mine], b[mine], check)
                else:
                    area = np.pi * np.minimum(first[:, 0], second[:, 0]) ** 2
                    rows[mine, 0] = law.kn * area
                    rows[mine, 1] = law.ks * area
                    rows[mine, 2] = 2.0 * law.damping * np.sqrt(rows[mine, 0] * mass)
            rows[mine, 4], rows[mine, 5] = law.tan, float(law.hertz)
            rows[mine, 6], rows[mine, 7] = law.rolling, law.twisting
        # without shear stiffness there is no friction; a spring of any stiffness with no limit says so
        slick = rows[:, 1] == 0.0
        rows[slick, 4], rows[slick, 3], rows[slick, 1] = 0.0, 0.0, rows[slick, 0]
        return rows

    def _hertz(self, law: SphereLaw, first: Array, second: Array, mass: Array, a: Any, b: Any, check: bool) -> Array:
        """Columns 0-3: stiffness and dashpots of a Hertz-Mindlin contact.

        In the variable ``2 d^(5/4) / sqrt(5)`` a Hertz contact with the dashpot ``a sqrt(m K) d^(1/4)`` is a linear
        one with the damping ratio ``a / sqrt(5)`` (Antypov and Elliott, EPL 94 (2011) 50004), so that the restitution
        of a linear contact that does not pull is also that of this one.
        """
        normal, shear = np.zeros(len(first)), np.zeros(len(first))
        for side in (first, second):
            own = side[:, 2:4] if law.compliance is None else np.asarray(law.compliance) * side[:, 4:5]
            normal, shear = normal + own[:, 0], shear + own[:, 1]
        bad = np.flatnonzero(~(normal > 0.0))
        if check and len(bad):
            name, other = (self._names[self._first[side[bad[0]]]] for side in (a, b))
            raise SceneError(
                f"joint {law.name}: young and poisson are missing: the law has none, nor have the materials of blocks "
                f"like {name!r} and {other!r}"
            )
        root = np.sqrt(1.0 / (1.0 / first[:, 0] + 1.0 / second[:, 0]))
        stiffness, tangent = 4.0 / 3.0 / normal * root, 8.0 / shear * root
        dashpot = np.sqrt(5.0) * law.damping * np.sqrt(mass * stiffness)
        # the same fraction of critical across: as the roots of the tangent stiffnesses, 3/2 K and k_t
        return np.column_stack([stiffness, tangent, dashpot, dashpot * np.sqrt(tangent / (1.5 * stiffness))])
