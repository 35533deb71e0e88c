"""Running-bond wall of rigid bricks in LMGC90; benchmarks/wall.py starts it with the Python that has compas_lmgc90.

Arguments: width, height (bricks), steps, time step [s]. Prints one line RESULT {json}.
"""

import json
import sys
import time

import numpy as np
from compas_lmgc90.solver import Solver

BRICK, DENSITY, FRICTION, G = np.array([0.4, 0.2, 0.2]), 2000.0, 0.6, 9.81
FACES = [[3, 2, 1, 0], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
CORNERS = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])


def box(centre, size):
    """Vertices and faces as the solver takes them."""
    return {"vertices": (np.asarray(centre) + 0.5 * CORNERS * np.asarray(size)).tolist(), "faces": FACES}


width, height, steps, dt = int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
centres = np.array(
    [((i + 0.5 + 0.5 * (k % 2)) * 0.4, 0.0, (k + 0.5) * 0.2) for k in range(height) for i in range(width)]
)
length = (width + 0.5) * 0.4
solver = Solver(dt=dt, theta=0.5, density=DENSITY)
solver.geometry_from_v_f([box([length / 2, 0, -0.25], [length + 2, 2, 0.5]), *(box(c, BRICK) for c in centres)])
solver.set_supports(z_threshold=0.0)
solver.contact_law("IQS_CLB", FRICTION)
solver.preprocess()
step = solver.lmgc90.compute_one_step
start = time.perf_counter()
result = step()
first = time.perf_counter() - start
start = time.perf_counter()
for _ in range(steps - 1):
    result = step()
seconds = time.perf_counter() - start
pairs = zip(result.interaction_bodies, result.interaction_force_global, strict=True)
base = sum(abs(force[2]) for bodies, force in pairs if min(bodies) <= 1)
found = {
    "first": first,
    "rate": (steps - 1) / seconds,
    "points": len(result.interaction_gap),
    "gap": float(np.abs(result.interaction_gap).max()),
    "base": base / (len(centres) * BRICK.prod() * DENSITY * G),
}
print("RESULT " + json.dumps(found), flush=True)
