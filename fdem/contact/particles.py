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
COLUMNS = 11


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
    restitution : float
        Of hard contact.
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
    restitution: float = 0.0


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

    Attributes
    ----------
    rows : (k, 11) array
        See kernels/spheres.py.
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
            self.rows = self._constants(rule, self._sides[a], self._sides[b])

    def hardest(self, sides: slice) -> Array:
        """Rows (n, 11) of `sides` against a rigid plane, under the law that makes it stiffest."""
        plane = np.tile([np.inf, 0.0, 0.0, 0.0, 0.0], (self._n, 1))
        best = np.zeros((self._n, COLUMNS))
        for k in range(len(self.laws)):
            rows = self._constants(np.full(self._n, k), self._sides, plane)
            # a contact without elastic constants on either side cannot be: it is refused when it comes
            rows[~np.isfinite(rows[:, 0])] = 0.0
            best = np.where((rows[:, 0] > best[:, 0])[:, None], rows, best)
        return best[self._class[sides]]

    def alike(self, sides: slice) -> tuple[Any, Any]:
        """One of each class of `sides`, and the class of each of them, counted in these."""
        _, one, member = np.unique(self._class[sides], return_index=True, return_inverse=True)
        return one, member.ravel()

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
            self._check(rule, first, second)
            self.rows = self._constants(rule, self._sides[first], self._sides[second])
            return np.arange(len(rule), dtype=np.uint32)
        kind = (rule * self._n + first) * self._n + second
        if not self._checked[kind].all():
            new = np.unique(kind[~self._checked[kind]])
            self._check(new // self._n**2, new // self._n % self._n, new % self._n)
            self._checked[new] = True
        return kind.astype(np.uint32)

    def _check(self, rule: Any, a: Any, b: Any) -> None:
        """Refuse Hertz contacts between classes without elastic constants."""
        for k, law in enumerate(self.laws):
            mine = np.flatnonzero(rule == k) if law.hertz else np.zeros(0, int)
            bad = ~(self._compliance(law, self._sides[a[mine]], self._sides[b[mine]])[0] > 0.0)
            if bad.any():
                name, other = (self._names[self._first[side[mine[np.argmax(bad)]]]] for side in (a, b))
                raise SceneError(
                    f"joint {law.name}: young and poisson are missing: the law has none, nor have the materials of "
                    f"blocks like {name!r} and {other!r}"
                )

    def _constants(self, rule: Any, first: Array, second: Array) -> Array:
        """Rows (n, 11) of kernels/spheres.py for contacts between sides (n, 5)."""
        rows = np.zeros((len(rule), COLUMNS))
        for k, law in enumerate(self.laws):
            mine = np.flatnonzero(rule == k)
            a, b = first[mine], second[mine]
            inverse = a[:, 1] + b[:, 1]
            with np.errstate(divide="ignore", invalid="ignore"):
                if law.hertz:
                    normal, shear = self._compliance(law, a, b)
                    root = np.sqrt(1.0 / (1.0 / a[:, 0] + 1.0 / b[:, 0]))
                    rows[mine, 0], rows[mine, 1] = 4.0 / 3.0 / normal * root, 8.0 / shear * root
                else:
                    area = np.pi * np.minimum(a[:, 0], b[:, 0]) ** 2
                    rows[mine, 0], rows[mine, 1] = law.kn * area, law.ks * area
                rows[mine, 7], rows[mine, 8] = 1.0 / inverse, inverse
            # in the variable 2 d^(5/4) / sqrt(5) a Hertz contact with the dashpot a sqrt(m K) d^(1/4) is a linear one
            # with the damping ratio a / sqrt(5) (Antypov and Elliott, EPL 94 (2011) 50004): the restitution of a linear
            # contact that does not pull is also its own
            rows[mine, 2] = law.damping * (np.sqrt(5.0) if law.hertz else 2.0)
            rows[mine, 4], rows[mine, 5] = law.tan, float(law.hertz)
            rows[mine, 9], rows[mine, 10] = law.rolling, law.twisting
            with np.errstate(divide="ignore", invalid="ignore"):
                # the same fraction of critical across, where a sphere that rolls has 2/7 of its mass
                rows[mine, 3] = 2.0 * law.damping * np.sqrt(rows[mine, 1] / (3.5 * rows[mine, 0]))
        # without shear stiffness there is no friction; a spring of any stiffness with no limit says so
        slick = rows[:, 1] == 0.0
        rows[slick, 4], rows[slick, 3], rows[slick, 1] = 0.0, 0.0, rows[slick, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            rows[:, 6] = 1.0 / rows[:, 1]
        return rows

    @staticmethod
    def _compliance(law: SphereLaw, first: Array, second: Array) -> tuple[Array, Array]:
        """``1 / E*`` and ``1 / G*`` [1/Pa]; negative or 0 where a constant is missing or both sides are rigid."""
        normal, shear = np.zeros(len(first)), np.zeros(len(first))
        for side in (first, second):
            own = side[:, 2:4] if law.compliance is None else np.asarray(law.compliance) * side[:, 4:5]
            normal, shear = normal + own[:, 0], shear + own[:, 1]
        return normal, shear
