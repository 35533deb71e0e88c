"""The exception tree of fdem: everything it raises on purpose is a `FdemError`."""

from __future__ import annotations

from collections.abc import Iterable

__all__ = [
    "CheckpointError",
    "ConvergenceError",
    "FdemError",
    "FdemWarning",
    "JointError",
    "MeshError",
    "OverlapError",
    "SceneError",
    "SolveError",
    "UnstableError",
    "UnsupportedError",
]


class FdemError(Exception):
    """Base of every error fdem raises."""


class SceneError(FdemError, ValueError):
    """The scene is wrong: names the block, joint or field, its value and what is allowed."""


class MeshError(SceneError):
    """A surface or volume mesh is open, inverted, self-overlapping or degenerate."""


class JointError(SceneError):
    """Two groups can touch and no joint law covers them."""


class UnsupportedError(FdemError, NotImplementedError):
    """What was asked does not exist for this body, law or integrator."""


class SolveError(FdemError, RuntimeError):
    """The solution could not be continued."""


class UnstableError(SolveError):
    """A value is not finite or energy grows: names step, time, block and gridpoint."""


class ConvergenceError(SolveError):
    """An iteration did not converge; carries the residual history.

    Attributes
    ----------
    residuals : tuple of float
        Of the last attempt, as the message's words count them; empty where there is no such history.
    """

    def __init__(self, message: str, residuals: Iterable[float] = ()) -> None:
        super().__init__(message)
        self.residuals = tuple(residuals)


class OverlapError(SolveError):
    """Blocks penetrate deeper than their contact surfaces can describe: names the pair."""


class CheckpointError(FdemError, OSError):
    """A saved state cannot be read or does not fit the scene."""


class FdemWarning(UserWarning):
    """Something deserves a look, but the answer is not wrong."""
