"""Joint laws and their properties, as the contact layer takes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fdem.errors import SceneError
from fdem.kernels import joints, responses

if TYPE_CHECKING:
    from fdem.contact.narrow import Patches

__all__ = ["LawTable", "stiffness_of"]

Array = NDArray[np.float64]


@dataclass
class LawTable:
    """One joint law and the properties of all joints that use it.

    Parameters
    ----------
    kernel : str or callable
        "coulomb", "bonded", or a kernel with the signature at the top of kernels/joints.py.
    props : (n_props, k) array
        Columns 0 and 1 are kn and ks [Pa/m].
    memory : int
        Columns of history the law needs (at least 6 are kept).
    needs : set of str
        "bonds": points do not move while the intact flag is set (law carries tension);
        "damping": the law reads `mass`. The built-in laws find out from their properties.
    corner : (n_props,) array, optional
        Least area of a contact [m2] (kernels/corners.py); 0: none.
    hard : (n_props, 4) array, optional
        Friction coefficient, cohesion [Pa], tension [Pa] and restitution of the hard counterpart; None: none.
    """

    kernel: str | Callable[..., None]
    props: Array
    memory: int = 6
    needs: frozenset[str] = field(default_factory=frozenset)
    corner: Array | None = None
    hard: Array | None = None

    def __post_init__(self) -> None:
        self.props = np.atleast_2d(np.ascontiguousarray(self.props, dtype=float))
        if isinstance(self.kernel, str) and self.kernel not in ("coulomb", "bonded"):
            raise SceneError(f"joint law {self.kernel!r}: known names are 'coulomb' and 'bonded'")
        self.sweep = getattr(joints, self.kernel) if isinstance(self.kernel, str) else self.kernel
        n = len(self.props)
        self.corner = np.zeros(n) if self.corner is None else np.asarray(self.corner, dtype=float)
        self.name = self.kernel if isinstance(self.kernel, str) else self.kernel.__name__
        self.response = getattr(responses, self.name, None) if isinstance(self.kernel, str) else None
        known = isinstance(self.kernel, str)
        coulomb = self.kernel == "coulomb"
        self.tensile = self.props[:, 4] > 0.0 if known else np.full(n, "bonds" in self.needs)
        self.dilates = self.props[:, 5] > 0.0 if coulomb else np.full(n, "dilation" in self.needs)
        self.damped = bool((self.props[:, 9] > 0.0).any()) if coulomb else "damping" in self.needs


def stiffness_of(laws: Sequence[LawTable], p: Patches) -> tuple[Array, Array]:
    """Normal and shear stiffness (n,) of patches [Pa/m]."""
    kn, ks = np.zeros(len(p)), np.zeros(len(p))
    for k, law in enumerate(laws):
        mine = p.law == k
        kn[mine], ks[mine] = law.props[p.prop[mine], 0], law.props[p.prop[mine], 1]
    return kn, ks
