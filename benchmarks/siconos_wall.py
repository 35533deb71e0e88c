"""Running-bond wall of rigid bricks in Siconos; benchmarks/peers.py starts it with the Python that has siconos.

Arguments: width, height (bricks), steps, time step [s], tolerance of the contact solver. Moreau-Jean with Gauss-Seidel,
contacts by Bullet. Prints one line RESULT {json}; rates are those of the second half of the steps.
"""

import json
import os
import sys
import tempfile
import time

import h5py
import numpy as np
import siconos.kernel as kernel
import siconos.numerics as numerics
from siconos.io.mechanics_run import MechanicsHdf5Runner
from siconos.mechanics.collision.bullet import SiconosBulletOptions
from siconos.mechanics.collision.tools import Contactor

BRICK, DENSITY, FRICTION, G = np.array([0.4, 0.2, 0.2]), 2000.0, 0.6, 9.81
width, height, steps = (int(word) for word in sys.argv[1:4])
dt, tolerance = float(sys.argv[4]), float(sys.argv[5])
centres = np.array(
    [((i + 0.5 + 0.5 * (k % 2)) * 0.4, 0.0, (k + 0.5) * 0.2) for k in range(height) for i in range(width)]
)
mass = DENSITY * float(BRICK.prod())
inertia = (mass / 12 * (np.sum(BRICK**2) - BRICK**2)).tolist()
length = (width + 0.5) * 0.4
path = os.path.join(tempfile.mkdtemp(), "wall.hdf5")
with MechanicsHdf5Runner(io_filename=path, verbose=False) as io:
    io.add_primitive_shape("brick", "Box", BRICK.tolist(), insideMargin=0.005, outsideMargin=0.0)
    io.add_primitive_shape("ground", "Box", (length + 2, 2, 0.5), insideMargin=0.005, outsideMargin=0.0)
    io.add_Newton_impact_friction_nsl("contact", mu=FRICTION, e=0.0)
    io.add_object("ground", [Contactor("ground")], translation=[length / 2, 0, -0.25])
    for number, place in enumerate(centres.tolist()):
        io.add_object(
            f"brick {number}", [Contactor("brick")], translation=place, velocity=[0] * 6, mass=mass, inertia=inertia
        )
options = kernel.solver_options_create(numerics.SICONOS_FRICTION_3D_NSGS)
options.iparam[numerics.SICONOS_IPARAM_MAX_ITER] = 1000
options.dparam[numerics.SICONOS_DPARAM_TOL] = tolerance
bullet = SiconosBulletOptions()
bullet.worldScale, bullet.contactBreakingThreshold = 1.0, 0.01
stamps = []


class Clock:
    """Notes when steps begin."""

    def initialize(self, io):
        """Nothing to prepare."""

    def step(self):
        """A step begins."""
        stamps.append(time.perf_counter())


with MechanicsHdf5Runner(io_filename=path, mode="r+", verbose=False) as io:
    io.run(
        t0=0, T=steps * dt, h=dt, theta=0.50001, Newton_max_iter=1, bullet_options=bullet, solver_options=options,
        verbose=False, verbose_progress=False, with_timer=False, output_frequency=1, controller=Clock(),
    )  # fmt: skip
with h5py.File(path, "r") as file:
    moves, points = file["data"]["dynamic"][:], file["data"]["cf"][:]
last = moves[moves[:, 0] == moves[:, 0].max()]
places = last[np.argsort(last[:, 1])][:, 2:5]
acting = points[points[:, 0] == points[:, 0].max()]
base = float(np.abs(acting[acting[:, 4] < 0.02][:, 13]).sum() / dt) / (len(centres) * mass * G)
each = np.diff(stamps)
found = {
    "first": float(each[0]),
    "rate": 1.0 / float(np.mean(each[len(each) // 2 :])),
    "points": len(acting),
    "moved": float(np.abs(places - centres).max()),
    "base": base,
}
print("RESULT " + json.dumps(found), flush=True)
