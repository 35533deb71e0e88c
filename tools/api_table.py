"""Write the table of public names: signature and first line of the docstring of each."""

from __future__ import annotations

import inspect
import sys
from pathlib import Path

import fdem


def row(name: str) -> str:
    """One line of the table."""
    thing = getattr(fdem, name)
    summary = (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ").replace("|", "\\|")
    names = ""
    if callable(thing) and not (isinstance(thing, type) and issubclass(thing, BaseException)):
        parameters = inspect.signature(thing).parameters.values()
        names = ", ".join(str(p.replace(annotation=inspect.Parameter.empty)) for p in parameters)
    return f"| `fdem.{name}({names})` | {summary} |" if names else f"| `fdem.{name}` | {summary} |"


def main() -> None:
    """Write to the path given."""
    lines = ["# Public names", "", "Made by `make docs`.", "", "| name | what |", "|---|---|"]
    lines += [row(name) for name in sorted(fdem.__all__, key=str.lower)]
    Path(sys.argv[1]).write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
