"""Make tunnel.msh: a block of rock around a horseshoe tunnel, in three stages, crossed by a fault.

Run ``python meshes/make_tunnel.py [path]``; gmsh is all it needs. Lengths in metres.

- rock: -10 <= x <= 10, 0 <= y <= 10, -112 <= z <= -92 without the tunnel,
- tunnel along y, 5 m wide, crown at z = -100: stage_1 (vault), stage_2 (bench), stage_3 (invert),
- fault: a plane through (4.5, 0, -102.5) that dips 70 degrees towards x and crosses the whole body,
- outer: the six sides of the body.
"""

from __future__ import annotations

import sys
from pathlib import Path

import gmsh
import numpy as np

RADIUS, DEPTH = 2.5, 10.0
LEVELS = (-102.5, -103.5, -104.5)  # springing line, bench, floor
LOWER, UPPER = (-10.0, 0.0, -112.0), (10.0, DEPTH, -92.0)
FAULT, DIP = (4.5, 0.0, -102.5), np.radians(70.0)
FINE, COARSE = 1.1, 3.6


def profile(occ: object) -> list[int]:
    """Faces of the three stages in the plane y = 0."""
    top = occ.addPoint(0.0, 0.0, LEVELS[0] + RADIUS)
    centre = occ.addPoint(0.0, 0.0, LEVELS[0])
    left, right = ([occ.addPoint(x, 0.0, z) for z in LEVELS] for x in (-RADIUS, RADIUS))
    across = [occ.addLine(a, b) for a, b in zip(left, right, strict=True)]
    vault = [occ.addCircleArc(right[0], centre, top), occ.addCircleArc(top, centre, left[0])]
    faces = [occ.addPlaneSurface([occ.addCurveLoop([across[0], *vault])])]
    for k in (1, 2):
        down, up = occ.addLine(left[k], left[k - 1]), occ.addLine(right[k - 1], right[k])
        faces.append(occ.addPlaneSurface([occ.addCurveLoop([across[k - 1], up, -across[k], down])]))
    return faces


def build(path: Path) -> None:
    """Build, mesh and write."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    model, occ = gmsh.model, gmsh.model.occ
    faces = profile(occ)
    stages = [(d, t) for face in faces for d, t in occ.extrude([(2, face)], 0.0, DEPTH, 0.0) if d == 3]
    box = (3, occ.addBox(*LOWER, *(b - a for a, b in zip(LOWER, UPPER, strict=True))))
    down = np.array([np.cos(DIP), 0.0, -np.sin(DIP)])
    # a sheet larger than the body
    corners = [
        occ.addPoint(*(np.array(FAULT) + s * 20.0 * down + [0.0, y, 0.0]))
        for s, y in ((-1, -5), (1, -5), (1, 15), (-1, 15))
    ]
    lines = [occ.addLine(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    sheet = (2, occ.addPlaneSurface([occ.addCurveLoop(lines)]))
    _, made = occ.fragment([box], [*stages, sheet])
    occ.synchronize()
    staged = [{t for d, t in made[1 + k] if d == 3} for k in range(3)]
    rock = {t for d, t in made[0] if d == 3} - set.union(*staged)
    for name, tags in (("rock", rock), *((f"stage_{k + 1}", staged[k]) for k in range(3))):
        model.addPhysicalGroup(3, sorted(tags), name=name)
    boundary = {t for _, t in model.getBoundary(model.getEntities(3), oriented=False)}
    fault = {t for d, t in made[4] if d == 2 and model.getAdjacencies(2, t)[0].size == 2}
    model.addPhysicalGroup(2, sorted(fault), name="fault")
    model.addPhysicalGroup(2, sorted(boundary), name="outer")
    # parts of the sheet outside of the body
    for d, t in model.getEntities(2):
        if not model.getAdjacencies(2, t)[0].size:
            model.removeEntities([(d, t)], recursive=True)
    sizes()
    model.mesh.generate(3)
    model.mesh.optimize("Netgen")
    gmsh.write(str(path))
    gmsh.finalize()


def sizes() -> None:
    """Fine zones at the tunnel, growing away from it."""
    field = gmsh.model.mesh.field
    field.add("MathEval", 1)
    middle = LEVELS[0] - 0.5
    field.setString(1, "F", f"{FINE} + 0.35 * Max(0, Sqrt(x*x + (z - ({middle}))^2) - {RADIUS})")
    field.add("MathEval", 2)
    field.setString(2, "F", str(COARSE))
    field.add("Min", 3)
    field.setNumbers(3, "FieldsList", [1, 2])
    field.setAsBackgroundMesh(3)
    for option in ("MeshSizeFromPoints", "MeshSizeFromCurvature", "MeshSizeExtendFromBoundary"):
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)


if __name__ == "__main__":
    build(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("tunnel.msh"))
