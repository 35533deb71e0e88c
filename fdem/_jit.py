"""The one door to numba: how every kernel of fdem is compiled and cached."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

__all__ = ["kernel"]


def kernel(function: Callable[..., Any] | None = None, *, fastmath: bool = False, inline: bool = False) -> Any:
    """Compile a module-level function of arrays and scalars with numba.

    Parameters
    ----------
    function : callable, optional
        The kernel; without it a decorator is returned.
    fastmath : bool, optional
        Let the compiler reorder sums. Only for element loops in which no NaN is looked for.
    inline : bool, optional
        Put it in place of every call: an array handed over costs seven words, which counts in the innermost loop.

    Notes
    -----
    Kernels release the GIL, so fixed chunks of one kernel can run on threads. They may call other
    kernels of the *same file* only: numba's disk cache does not see edits elsewhere.
    ``FDEM_CACHE=0`` switches the disk cache off, ``FDEM_CHECK=1`` switches bounds checks on.
    """
    import numba

    def compile_(f: Callable[..., Any]) -> Any:
        return numba.njit(
            f,
            error_model="numpy",
            nogil=True,
            fastmath=fastmath,
            forceinline=inline,
            cache=os.environ.get("FDEM_CACHE", "1") != "0",
            boundscheck=os.environ.get("FDEM_CHECK", "0") == "1",
        )

    return compile_ if function is None else compile_(function)
