"""A scene that needs no mesher as a whole process, with and without the imports of one: for `skip.py`."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import reporting

import fdem

PROGRAM = """
import sys, warnings
{first}
import fdem
warnings.simplefilter("ignore")
scene = fdem.Scene()
scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True)
block = scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), {body}, fdem.Elastic(2500.0, 1e9, 0.2))
scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
sim = fdem.Simulation(scene, fdem.Explicit(), progress=False)
sim.cycle(20)
print(*sim[block].position)
"""


class Process:
    """Looks like a simulation whose step is a whole process."""

    def __init__(self, needed: bool) -> None:
        self.first, self.position = "import gmsh, skfem, pyvista" if needed else "", None

    @staticmethod
    def clock() -> float:
        """CPU time of processes that have ended [s]."""
        times = os.times()
        return times.children_user + times.children_system

    def cycle(self, steps: int) -> None:
        """Run the program."""
        self.position = output(self.first, "fdem.Rigid()")

    def describe(self) -> str:
        """Of the same scene."""
        scene = fdem.Scene()
        scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), fdem.Elastic(2500.0))
        return fdem.Simulation(scene, fdem.Explicit(), progress=False).describe()


def output(first: str, body: str) -> list[float] | None:
    """Where the block is at the end; None if the program fails."""
    code = PROGRAM.format(first=first, body=body)
    env = os.environ | {"PYTHONPATH": str(reporting.HERE.parent)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env, check=False)
    return None if done.returncode else [float(value) for value in done.stdout.split()]


def without_mesher() -> tuple[Any, Any]:
    """A block of zones where gmsh cannot be imported."""
    body = "fdem.Zoned(size=0.5)"
    return output("", body), output('sys.modules["gmsh"] = None', body)
