"""The progress line of a run, with the time left."""

from __future__ import annotations

import math
import sys
import time as clock
from typing import Any, TextIO

from fdem.results.history import NEVER

__all__ = ["Progress"]


class Progress:
    """One line on stderr: how far, how fast, how long still. Silent where nobody watches.

    Parameters
    ----------
    steps : int, optional
        Number of steps of this run.
    time : float, optional
        Length of this run [s].
    ratio : float, optional
        Solve ratio to be reached; the view then has a `ratio`.
    show : bool, optional
        True always shows, False never; None only if `stream` is a terminal.
    stream : file, optional
        Where to; None is ``sys.stderr``.

    Notes
    -----
    `next` depends on the wall clock: what a simulation computes must not depend on where its loop
    is interrupted.
    """

    refresh = 0.2  # s of wall time between two lines

    def __init__(
        self,
        steps: int | None = None,
        time: float | None = None,
        ratio: float | None = None,
        *,
        show: bool | None = None,
        stream: TextIO | None = None,
    ) -> None:
        self._stream = sys.stderr if stream is None else stream
        self.active = bool(self._stream.isatty()) if show is None else bool(show)
        self._n_steps, self._length, self._ratio = steps, time, ratio
        self._begin: tuple[float, int, float] | None = None  # wall clock, step and time at the start
        self._first_ratio = math.nan
        self._width = 0
        self._last: tuple[float, int] = (0.0, 0)
        self._rate = 0.0
        self._due = 0  # step at which the line is written again

    def start(self, view: Any) -> None:
        """Remember where the run starts."""
        now = clock.perf_counter()
        self._begin = (now, int(view.steps), float(view.time))
        self._last = (now, int(view.steps))

    def next(self, step: int, t: float, dt: float) -> int:
        """Count the steps until the line is written again: about five times a second of wall time."""
        if not self.active:
            return NEVER
        return max(1, self._due - step)

    def record(self, view: Any) -> None:
        """Write the line."""
        if not self.active:
            return
        if self._begin is None:
            self.start(view)
        assert self._begin is not None
        now, step = clock.perf_counter(), int(view.steps)
        wall = now - self._last[0]
        if wall > 0.0 and step > self._last[1]:
            self._rate = (step - self._last[1]) / wall
            self._last = (now, step)
        self._due = step + max(1, int(self._rate * self.refresh))
        done = self._done(view)
        text = f"step {step}  t = {view.time:.4g} s  {self._rate:.4g} steps/s"
        if self._ratio is not None:
            text += f"  ratio {float(view.ratio):.2e} / {self._ratio:.0e}"
        if done is not None:
            elapsed = now - self._begin[0]
            left = f"  {_duration(elapsed * (1.0 - done) / done)} left" if done > 0.0 else ""
            text = f"{100.0 * done:5.1f} %  {text}{left}"
        self._stream.write("\r" + text.ljust(self._width))
        self._stream.flush()
        self._width = len(text)

    def _done(self, view: Any) -> float | None:
        """Share of the run that is done, 0 to 1; None if it is not known."""
        assert self._begin is not None
        shares = []
        if self._n_steps:
            shares.append((view.steps - self._begin[1]) / self._n_steps)
        if self._length:
            shares.append((view.time - self._begin[2]) / self._length)
        if self._ratio:
            ratio = float(view.ratio)
            if ratio > 0.0 and math.isfinite(ratio):
                # ratios fall exponentially: progress is the share of the way on a logarithmic scale
                if not self._first_ratio >= ratio:
                    self._first_ratio = ratio
                way = math.log(self._first_ratio / self._ratio)
                shares.append(math.log(self._first_ratio / ratio) / way if way > 0.0 else 1.0)
        return min(1.0, max(0.0, *shares)) if shares else None

    def finish(self) -> None:
        """End the line."""
        if self.active and self._width:
            self._stream.write("\n")
            self._stream.flush()
            self._width = 0


def _duration(seconds: float) -> str:
    """Wall time as people say it."""
    s = round(seconds)
    if s < 60:
        return f"{s} s"
    return f"{s // 60}:{s % 60:02d} min" if s < 3600 else f"{s // 3600}:{s // 60 % 60:02d} h"
