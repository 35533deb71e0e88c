"""Semicircular arch in compas_cra (coupled rigid-block analysis); benchmarks/peers.py starts it.

Mean radius 1 m, thickness 0.15 m, depth 0.2 m, 27 voussoirs on two blocks, mu = 0.7. Prints one line of JSON.
"""

import json
import time

import numpy as np
from compas.datastructures import Mesh
from compas_assembly.datastructures import Block
from compas_cra.algorithms import assembly_interfaces_numpy
from compas_cra.datastructures import CRA_Assembly
from compas_cra.equilibrium import cra_solve

N, THICK, DEPTH, FRICTION, WEIGHT = 27, 0.15, 0.2, 0.7, 2000.0 * 9.81 / 1e4
SIDES = [[0, 1, 2, 3], [7, 6, 5, 4], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0]]


def voussoir(first, last):
    """Between two angles."""
    inner, outer = 1 - THICK / 2, 1 + THICK / 2
    corners = [
        (r * np.cos(a), r * np.sin(a)) for a, r in ((first, inner), (first, outer), (last, outer), (last, inner))
    ]
    points = [[float(x), y, float(z)] for y in (0.0, DEPTH) for x, z in corners]
    return Mesh.from_vertices_and_faces(points, SIDES)


def support(sign):
    """Under one springing."""
    x0, x1 = sorted((sign * (1 - THICK), sign * (1 + THICK)))
    points = [[x, y, z] for z in (-0.2, 0.0) for x, y in ((x0, -0.1), (x1, -0.1), (x1, DEPTH + 0.1), (x0, DEPTH + 0.1))]
    return Mesh.from_vertices_and_faces(
        points, [[3, 2, 1, 0], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    )


start = time.perf_counter()
angles = np.linspace(0, np.pi, N + 1)
assembly = CRA_Assembly()
for i in range(N):
    assembly.add_block(voussoir(angles[i], angles[i + 1]).copy(cls=Block), node=i)
for k, sign in ((N, 1), (N + 1, -1)):
    assembly.add_block(support(sign).copy(cls=Block), node=k)
assembly.set_boundary_conditions([N, N + 1])
assembly_interfaces_numpy(assembly, nmax=7, tmax=1e-4, amin=1e-4)
try:
    cra_solve(assembly, mu=FRICTION, density=WEIGHT)
    verdict = "stands"
except ValueError:
    verdict = "falls"
print(json.dumps({"seconds": time.perf_counter() - start, "verdict": verdict}))
