"""A mesh made by someone else: read it, settle it, check that the supports carry its weight.

    python examples/imported.py [mesh file] [scale] [picture folder]

Any file of blocks works (OBJ with one block a group, STL, PLY, msh, vtu...). Blocks whose lowest
point lies within 2 % of the height from the bottom are the supports.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import fdem

MESH = Path(__file__).parent.parent / "meshes" / "vault.obj"


def main(path: Path = MESH, scale: float = 1.0, folder: Path = Path("out")) -> float:
    """Return the relative error of the vertical support reaction."""
    shapes = fdem.read(path, scale=scale)
    bottom = np.array([np.asarray(shape.bounds)[0, 2] for shape in shapes])
    height = max(np.asarray(shape.bounds)[1, 2] for shape in shapes) - bottom.min()
    # rounded coordinates leave neighbours apart, or overlapping, by some thousandths of their size
    size = float(np.cbrt(np.median([shape.volume for shape in shapes])))
    scene = fdem.Scene(gap_tolerance=3e-3 * size)
    blocks = scene.add(shapes, fdem.Rigid(), fdem.Elastic(density=2400), name="stone")
    supports = scene.fix([b for b, z in zip(blocks, bottom, strict=True) if z < bottom.min() + 0.02 * height])
    free = [b for b, z in zip(blocks, bottom, strict=True) if z >= bottom.min() + 0.02 * height]
    scene.joint(fdem.Coulomb(kn=10e9, ks=5e9, friction=35))

    sim = fdem.Simulation(scene, fdem.Relaxation())
    report = sim.solve(ratio=1e-6)
    weight = 9.81 * sim[free].mass.sum()
    error = abs(float(sim[supports].force[2]) / weight - 1)
    folder.mkdir(parents=True, exist_ok=True)
    sim.plot(folder / f"imported_{path.parent.name}_{path.stem}.png", scalars="displacement", warp="auto")
    print(f"{len(blocks)} blocks, {len(free)} free: {report.reason}, {report.cycles} cycles, ratio {report.ratio:.1e}")
    return error


if __name__ == "__main__":
    arguments = sys.argv[1:]
    path = Path(arguments[0]) if arguments else MESH
    scale = float(arguments[1]) if len(arguments) > 1 else 1.0
    print(f"relative error of the support reaction: {main(path, scale, *map(Path, arguments[2:])):.2e}")
