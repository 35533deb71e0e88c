"""Joint laws and their properties, as the contact layer takes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdem.errors import JointError, SceneError
from fdem.kernels import joints

if TYPE_CHECKING:
    from fdem.contact.narrow import Patches

__all__ = ["COMMON", "NEEDS", "TAKEN", "LawTable", "stiffness_of", "try_law"]

Array = NDArray[np.float64]

NEEDS = ("arms", "bonds", "damping", "dilation")  # what a user's law may ask for
COMMON = 6  # columns of history that every law has
# arrays of the contact table: no column of a law may be named so
TAKEN = (
    "block_a", "block_b", "joint", "normal", "gap", "area", "traction", "force", "slip", "state", "failure", "position",
    "patch", "frame", "joint_names",
)  # fmt: skip


def _coulomb(p: Array) -> dict[str, Any]:
    return {
        "tensile": p[:, 4] > 0.0,
        "dilates": p[:, 5] > 0.0,
        "damped": bool((p[:, 9] > 0.0).any()),
        "brittle": (p[:, 4] > 0.0) | (p[:, 3] > p[:, 8]) | (p[:, 2] > p[:, 7]),
    }


def _moments(p: Array) -> dict[str, Any]:
    return {**_coulomb(p), "arms": True, "columns": ("rolling", "twisting"), "lengths": p[:, 10:12]}


def _bonded(p: Array) -> dict[str, Any]:
    return {"tensile": p[:, 4] > 0.0, "brittle": np.ones(len(p), bool)}


def _barton_bandis(p: Array) -> dict[str, Any]:
    return {
        "dilates": p[:, 3] * p[:, 7] > 0.0,
        "damped": bool((p[:, 8] > 0.0).any()),
        "columns": ("worn",),
        "reach": p[:, 2],
    }


# what a law of fdem needs, from its properties; its kernels are found by its name
KNOWN: dict[str, Callable[[Array], dict[str, Any]]] = {
    "coulomb": _coulomb,
    "coulomb_moments": _moments,
    "bonded": _bonded,
    "barton_bandis": _barton_bandis,
}


@dataclass
class LawTable:
    """One joint law and the properties of all joints that use it.

    Parameters
    ----------
    kernel : str or callable
        A name in kernels/joints.py, or a kernel with the signature at the top of that file. The rest is for kernels of
        the user's own; the laws of fdem find it out from their properties.
    props : (n_props, k) array
        Columns 0 and 1 are kn and ks [Pa/m].
    columns : tuple of str
        Names of the columns of history the law has beyond the common ones.
    needs : set of str
        "bonds": points do not move while bond > 0 (the law carries tension), failures are kept;
        "dilation": memory 5 lifts the faces; "damping": the law reads `mass`; "arms": it reads `arm`.
    closure : callable, optional
        Normal response and energy, see kernels/joints.py; None: p = kn depth.
    reach : (n_props,) array, optional
        Length [m] over which closure changes the normal stiffness; infinite: it does not.
    corner : (n_props,) array, optional
        Least area of a contact [m2] (kernels/corners.py); 0: none.
    smooth : bool
        Whether differences of the law are a tangent: for implicit methods.
    hard : (n_props, 6) array, optional
        Friction coefficient, cohesion [Pa], tension [Pa] and restitution of the hard counterpart, friction coefficient
        and cohesion after its strength was exceeded; None: none.

    Attributes
    ----------
    tensile, dilates, brittle : (n_props,) bool arrays
        Which joints carry tension, dilate, and have something to lose by failure.
    lengths : (n_props, 2) array
        Rolling and twisting resistance [m], whose springs count for the stable step.
    """

    kernel: str | Callable[..., None]
    props: Array
    columns: tuple[str, ...] = ()
    needs: frozenset[str] = field(default_factory=frozenset)
    closure: Any = None
    reach: Any = None
    corner: Array | None = None
    smooth: bool = False
    hard: Array | None = None

    def __post_init__(self) -> None:
        self.props = np.atleast_2d(np.ascontiguousarray(self.props, dtype=float))
        n = len(self.props)
        self.corner = np.zeros(n) if self.corner is None else np.asarray(self.corner, dtype=float)
        traits: dict[str, Any] = {name: np.full(n, need in self.needs) for name, need in _ROWWISE}
        traits |= {"damped": "damping" in self.needs, "arms": "arms" in self.needs, "lengths": np.zeros((n, 2))}
        traits |= {"columns": self.columns, "reach": np.full(n, np.inf) if self.reach is None else self.reach}
        if isinstance(self.kernel, str):
            self.smooth = True
            if self.kernel not in KNOWN:
                raise SceneError(f"joint law {self.kernel!r}: known names are {', '.join(map(repr, KNOWN))}")
            self.sweep = getattr(joints, self.kernel)
            self.closure = getattr(joints, f"{self.kernel}_closure", None)
            traits |= KNOWN[self.kernel](self.props)
        else:
            self.sweep = self.kernel
        self.tensile, self.dilates, self.brittle = traits["tensile"], traits["dilates"], traits["brittle"]
        self.damped, self.arms, self.lengths = traits["damped"], traits["arms"], traits["lengths"]
        self.columns, self.reach = tuple(traits["columns"]), np.asarray(traits["reach"], dtype=float)

    @property
    def name(self) -> str:
        """What messages call the law."""
        return self.kernel if isinstance(self.kernel, str) else self.kernel.__name__

    @property
    def memory(self) -> int:
        """Columns of history."""
        return COMMON + len(self.columns)

    @property
    def curved(self) -> bool:
        """Whether closure changes the normal stiffness."""
        return self.closure is not None and bool(np.isfinite(self.reach).any())

    def respond(self, gap: Array, prop: Any, memory: Array) -> Array:
        """What `closure` answers for the three points of patches: (3 n, 4), see kernels/joints.py.

        Parameters
        ----------
        gap : (3 n,) array
            [m].
        prop : (n,) int array
            Row of properties per patch.
        memory : (3 n, m) array
            History.
        """
        out = np.zeros((len(gap), 4))
        assert self.closure is not None
        self.closure(0, len(gap), gap, prop, self.props, memory, out)
        return out

    def depth(self, pressure: Array, prop: Any) -> Array:
        """Closure (3 n,) [m] under pressures (3 n,) [Pa] by Newton's method, without dilation or other history."""
        depth = pressure / self.props[np.repeat(prop, 3), 0]
        if self.closure is None:
            return depth
        blank = np.zeros((len(depth), self.memory))
        blank[:, 3] = depth < 0.0
        for _ in range(100):
            out = self.respond(-depth, prop, blank)
            step = (pressure - out[:, 0]) / out[:, 1]
            depth = depth + step
            if not (np.abs(step) > 1e-15 * np.abs(depth)).any():
                break
        return depth


_ROWWISE = (("tensile", "bonds"), ("dilates", "dilation"), ("brittle", "bonds"))


def stiffness_of(laws: Sequence[LawTable], p: Patches) -> tuple[Array, Array]:
    """Normal and shear stiffness (n,) of patches [Pa/m]."""
    kn, ks = np.zeros(len(p)), np.zeros(len(p))
    for k, law in enumerate(laws):
        mine = p.law == k
        kn[mine], ks[mine] = law.props[p.prop[mine], 0], law.props[p.prop[mine], 1]
    return kn, ks


def try_law(name: str, law: LawTable) -> None:
    """Run a law of the user's own on a few rows in Python, where array bounds are checked.

    Parameters
    ----------
    name : str
        For messages.
    law : LawTable
        The law.

    Raises
    ------
    JointError
        If a kernel is none, takes other arguments, reads or writes columns that are not there, changes its input, or
        leaves a traction, a work or a state unwritten.
    """
    sweep = _python(name, "kernel", law.sweep, 18)
    n, length = 6, float(np.min(law.reach)) if np.isfinite(law.reach).any() else 1.0
    given: list[Any] = [
        np.repeat([-0.5 * length, 0.5 * length], 3), np.tile([0.0, 0.0, -1.0], (2, 1)),
        np.tile([0.1 * length, 0.0, -0.1 * length], (n, 1)), np.tile([0.0, 0.0, 1.0], (n, 1)), np.ones(n), np.ones(n),
        np.ones(n), np.tile([[1.0, 0, 0], [0, 1, 0], [-1, -1, 0]], (2, 1)) if law.arms else np.zeros((0, 3)),
        np.zeros(2, np.int32), law.props.copy(), np.zeros((n, law.memory)),
    ]  # fmt: skip
    given[10][:, 3] = 1.0
    for array in given:
        array.flags.writeable = False
    for dt in (0.0, 1.0):
        memory = np.zeros((n, law.memory))
        out = [np.full((n, 4), np.nan), np.full((n, 2), np.nan), np.full(n, 99, np.int8)]
        if not _attempt(name, "kernel", sweep, 0, n, dt, *given, memory, *out):
            continue
        for what, values in zip(("traction", "work"), out[:2], strict=True):
            if np.isnan(values).any():
                raise JointError(f"joint law {name}: kernel leaves {what} unwritten, or not a number, where area > 0")
        if (out[2] == 99).any():
            raise JointError(f"joint law {name}: kernel leaves state unwritten")
    if law.closure is not None:
        closure = _python(name, "closure", law.closure, 7)
        gap, prop, props, memory = given[0], given[8], given[9], given[10]
        _attempt(name, "closure", closure, 0, n, gap, prop, props, memory, np.zeros((n, 4)))


def _python(name: str, what: str, function: Any, n: int) -> Any:
    """The Python function behind a kernel, after a look at its arguments."""
    plain = getattr(function, "py_func", None)
    if plain is None:
        raise JointError(f"joint law {name}: {what} = {function!r}, allowed is a function decorated with @fdem.kernel")
    have = plain.__code__.co_argcount
    if have != n:
        raise JointError(f"joint law {name}: {what} takes {have} arguments, not the {n} that joint laws have")
    return plain


def _attempt(name: str, what: str, function: Any, *arguments: Any) -> bool:
    """Call a kernel in Python; whether it came to an end."""
    try:
        with np.errstate(all="ignore"):
            function(*arguments)
    except IndexError as error:
        raise JointError(
            f"joint law {name}: {what} reaches beyond its arrays ({error}); are all columns of history named in "
            "`memory`, all properties in `properties`, and the arms asked for in `needs`?"
        ) from error
    except ValueError as error:
        if "read-only" in str(error):
            raise JointError(f"joint law {name}: {what} changes an array that is not its own") from error
        return False  # a number of this trial that the law cannot take
    except ArithmeticError:
        return False
    return True
