"""Logging: records go to the logger ``fdem``; nothing is ever printed."""

from __future__ import annotations

import logging

__all__ = ["logger", "show_log"]

logger = logging.getLogger("fdem")
logger.addHandler(logging.NullHandler())


def show_log(level: int | str = "INFO") -> None:
    """Send fdem's log records to stderr.

    Parameters
    ----------
    level : int or str, optional
        The lowest level shown, as in `logging`.
    """
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))
    logger.addHandler(handler)
    logger.setLevel(level)
