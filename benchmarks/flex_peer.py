"""MuJoCo flex on the case of flex.py; apart, so that a Python without fdem can run it: flex_peer.py STEPS."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable

CELLS, EDGE, DT = 10, 0.05, 1e-5
YOUNG, POISSON, DENSITY = 1e6, 0.3, 1000.0


def mujoco_steps() -> tuple[Callable[[int], None], str]:
    """Return a function that runs so many steps of MuJoCo flex, and what it is."""
    import mujoco

    side = CELLS * EDGE
    xml = f"""<mujoco>
      <option timestep="{DT}" integrator="Euler" solver="CG" tolerance="1e-6" gravity="0 0 -9.81"/><size memory="2G"/>
      <worldbody>
        <geom type="plane" size="0 0 1"/>
        <flexcomp name="block" type="grid" dim="3" count="{CELLS + 1} {CELLS + 1} {CELLS + 1}"
          spacing="{EDGE} {EDGE} {EDGE}" pos="0 0 {side / 2 + 0.001}" mass="{DENSITY * side**3}" radius="0.001">
          <elasticity young="{YOUNG}" poisson="{POISSON}" damping="0"/><contact selfcollide="none"/>
        </flexcomp>
      </worldbody>
    </mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    assert int(model.flex_elemnum[0]) == 6 * CELLS**3

    def run(steps: int) -> None:
        for _ in range(steps):
            mujoco.mj_step(model, data)

    return run, f"MuJoCo {mujoco.__version__} flex, Euler"


if __name__ == "__main__":
    run, name = mujoco_steps()
    run(10)
    start = time.perf_counter()
    run(int(sys.argv[1]))
    print(json.dumps([name, time.perf_counter() - start]))
