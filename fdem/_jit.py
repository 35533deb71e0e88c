"""The one door to numba: how every kernel of fdem is compiled and cached."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

__all__ = ["held_off", "kernel"]


@contextmanager
def held_off() -> Iterator[None]:
    """No collections inside: importing and compiling make many objects that stay, and next to none to be collected."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


@cache
def _numba() -> Any:
    """The package, told to leave the garbage collector off while it compiles: an eighth of the time, for nothing."""
    with held_off():
        import numba
        from numba.core import event

    was_on: list[bool] = []  # one entry for every compilation inside another

    def on_start(_listener: Any, _event: Any) -> None:
        was_on.append(gc.isenabled())
        gc.disable()

    def on_end(_listener: Any, _event: Any) -> None:
        if was_on.pop():
            gc.enable()

    pause = type("Pause", (event.Listener,), {"on_start": on_start, "on_end": on_end})
    event.register("numba:compile", pause())
    return numba


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

    A first start is spent compiling: 2 ms for an element of an array read, 5 for an ``if``, 10 for a loop, hundreds
    for ``np.sort``, ``np.argsort``, ``np.searchsorted`` or an array assigned to a slice, which brings its own messages.
    A literal handed to a helper, or a variable that starts as one, compiles it once more: start it as ``np.int64(0)``.
    An argument None takes away the branches ``if argument is not None``, with the helpers that only they call.
    """

    def compile_(f: Callable[..., Any]) -> Any:
        return _numba().njit(
            f,
            error_model="numpy",
            nogil=True,
            fastmath=fastmath,
            forceinline=inline,
            cache=os.environ.get("FDEM_CACHE", "1") != "0",
            boundscheck=os.environ.get("FDEM_CHECK", "0") == "1",
            no_cfunc_wrapper=True,  # kernels are no arguments of others, so no C entry is needed
        )

    return compile_ if function is None else compile_(function)
