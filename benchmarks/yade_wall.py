"""Running-bond wall of rigid bricks in Yade; benchmarks/contact.py starts it by ``yade -x -n -j1 yade_wall.py``.

Environment: WIDTH, HEIGHT (bricks), WARM and STEPS (cycles). Prints one line RESULT {json}.
"""

import json
import os
import time

import numpy as np
from yade import O, polyhedra_utils, utils
from yade.wrapper import (
    Bo1_Polyhedra_Aabb,
    Bo1_Wall_Aabb,
    ForceResetter,
    Ig2_Polyhedra_Polyhedra_PolyhedraGeom,
    Ig2_Wall_Polyhedra_PolyhedraGeom,
    InsertionSortCollider,
    InteractionLoop,
    Ip2_PolyhedraMat_PolyhedraMat_PolyhedraPhys,
    Law2_PolyhedraGeom_PolyhedraPhys_Volumetric,
    NewtonIntegrator,
    PolyhedraMat,
)

BRICK, DENSITY, KN, FRICTION = (0.4, 0.2, 0.2), 2000.0, 1e10, 0.6
width, height, warm, steps = (int(os.environ[name]) for name in ("WIDTH", "HEIGHT", "WARM", "STEPS"))
stone = PolyhedraMat(density=DENSITY, young=KN, poisson=0.5, frictionAngle=float(np.arctan(FRICTION)))
O.materials.append(stone)
O.bodies.append(utils.wall(0, axis=2, material=stone))
corners = [
    tuple(0.5 * s * b for s, b in zip((i, j, k), BRICK, strict=True)) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)
]
for course in range(height):
    for i in range(width):
        brick = polyhedra_utils.polyhedra(stone, v=corners)
        brick.state.pos = ((i + 0.5 + 0.5 * (course % 2)) * BRICK[0], 0.0, (course + 0.5) * BRICK[2])
        O.bodies.append(brick)
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Polyhedra_Aabb(), Bo1_Wall_Aabb()], verletDist=0.01),
    InteractionLoop(
        [Ig2_Wall_Polyhedra_PolyhedraGeom(), Ig2_Polyhedra_Polyhedra_PolyhedraGeom()],
        [Ip2_PolyhedraMat_PolyhedraMat_PolyhedraPhys()],
        [Law2_PolyhedraGeom_PolyhedraPhys_Volumetric()],
    ),
    NewtonIntegrator(gravity=(0, 0, -9.81), damping=0.3),
]
# a fifth of the stable step of a brick on two full bed faces
O.dt = 0.4 * (DENSITY * BRICK[2] / (4.0 * KN)) ** 0.5
O.run(warm, True)
start = time.perf_counter()
O.run(steps, True)
seconds = time.perf_counter() - start
pairs = sum(1 for contact in O.interactions if contact.isReal)
print("RESULT " + json.dumps({"pairs": pairs, "seconds_per_step": seconds / steps, "dt": O.dt}), flush=True)
