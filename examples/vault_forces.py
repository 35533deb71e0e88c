"""A published vault: its contact forces against those of another code, and why they need not agree.

    python examples/vault_forces.py [folder with blocks.obj and lmgc90_reference.json] [picture folder]

The reference (BlockResearchGroup/compas_dem) was computed by LMGC90 with rigid blocks and hard contact. Equilibrium,
friction cones and the pairs that touch can be checked; the forces of single pairs cannot: the thrust of a vault of
rigid blocks on rigid supports is one of many, chosen by elasticity, by the solver or by the way it was loaded. How
far that goes is shown by moving one springing by half a millimetre.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

import fdem

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "barrel_vault"


def vault(shapes: list[Any], reference: dict[str, Any], spread: float = 0.0) -> tuple[fdem.Simulation, list[Any]]:
    """Settle the vault, the supports at x > 0 moved outwards by `spread` [m]; the simulation and its two supports."""
    scene, fixed = fdem.Scene(gravity=reference["gravity"]), set(reference["support_blocks"])
    stone = fdem.Elastic(density=reference["density"])
    blocks = [scene.add(shape, fdem.Rigid(), stone, name=f"block {i}") for i, shape in enumerate(shapes)]
    left, right = ([blocks[i] for i in fixed if (shapes[i].centroid[0] > 0) == side] for side in (False, True))
    supports = [scene.fix(left), scene.fix(right, component=("y", "z", "rotation") if spread else None)]
    if spread:
        scene.apply(fdem.Displacement((spread, None, None)), right)
    friction = float(np.degrees(np.arctan(reference["friction_coefficient"])))
    scene.joint(fdem.Coulomb(kn=1e10, ks=4e9, friction=friction))
    sim = fdem.Simulation(scene, fdem.Relaxation(fdem.Adaptive()), progress=False)
    report = sim.solve(ratio=1e-8)
    if report.reason != "equilibrium":
        raise SystemExit(f"the vault does not settle: {report}")
    return sim, supports


def pair_forces(sim: fdem.Simulation) -> dict[tuple[int, int], tuple[float, float, np.ndarray]]:
    """Normal force [N], shear force [N] and place of every pair of blocks that touch, by the numbers of the blocks."""
    table = sim.contact_table()
    result = {}
    keys = np.sort(np.column_stack([table["block_a"], table["block_b"]]), axis=1)
    for a, b in np.unique(keys, axis=0).tolist():
        mine = (keys == [a, b]).all(axis=1)
        # faces carry nearly all of it: their normal is that of the largest contact point
        normal = table["normal"][mine][np.argmax(table["area"][mine])]
        force = sim.pair_force(f"block {a}", f"block {b}")
        push = abs(float(force @ normal))
        place = np.average(table["position"][mine], axis=0, weights=table["area"][mine] + 1e-12)
        result[a, b] = push, float(np.linalg.norm(force - (force @ normal) * normal)), place
    return result


def published(reference: dict[str, Any]) -> dict[tuple[int, int], tuple[float, float, np.ndarray]]:
    """The same of the reference."""
    result = {}
    for contact in reference["contacts"]:
        a, b = sorted(contact["blocks"])
        shear = np.hypot(sum(contact["tangent_force_1"]), sum(contact["tangent_force_2"]))
        result[a, b] = sum(contact["normal_force"]), float(shear), np.mean(contact["points"], axis=0)
    return result


def compared(ours: Any, theirs: Any) -> list[tuple[float, float, float]]:
    """Correlation, relative L2 difference and ratio of sums, of normal and of shear forces."""
    pairs = sorted(ours.keys() & theirs.keys())
    rows = []
    for k in (0, 1):
        a, b = (np.array([forces[pair][k] for pair in pairs]) for forces in (ours, theirs))
        rows.append((np.corrcoef(a, b)[0, 1], np.linalg.norm(a - b) / np.linalg.norm(b), a.sum() / b.sum()))
    return rows


def picture(sim: fdem.Simulation, columns: dict[str, Any], path: Path) -> None:
    """Normal forces of the pairs as balls at the joints, one view for every column, one scale for all."""
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    import pyvista

    largest = max(force[0] for forces in columns.values() for force in forces.values()) / 1e3
    plotter = pyvista.Plotter(shape=(1, len(columns)), off_screen=True, border=False, window_size=(1700, 520))
    surface = sim.mesh().extract_surface(algorithm=None)
    for k, (title, forces) in enumerate(columns.items()):
        plotter.subplot(0, k)
        plotter.add_text(title, font_size=12, color="black")
        plotter.add_mesh(surface, color="lightgray", opacity=0.15)
        plotter.add_mesh(surface.extract_feature_edges(20), color="darkgray", line_width=1)
        points = pyvista.PolyData(np.array([force[2] for force in forces.values()]))
        points["normal force [kN]"] = np.array([force[0] for force in forces.values()]) / 1e3
        balls = points.glyph(scale=False, orient=False, geom=pyvista.Sphere(radius=0.07))
        bar = {"vertical": False, "position_x": 0.25, "position_y": 0.03, "width": 0.5, "color": "black"}
        plotter.add_mesh(
            balls, scalars="normal force [kN]", cmap="viridis", clim=(0.0, largest), scalar_bar_args=bar,
            show_scalar_bar=k == 0,
        )  # fmt: skip
        plotter.camera_position = [(0.0, -6.5, 8.0), (0.0, 0.0, 0.2), (0.0, 0.0, 1.0)]
        plotter.enable_parallel_projection()
        plotter.camera.parallel_scale = 1.9
    plotter.screenshot(str(path))
    plotter.close()


def main(data: Path = DATA, folder: Path = Path("out")) -> float:
    """Return the relative error of the vertical support reaction."""
    if not (data / "lmgc90_reference.json").exists():
        raise SystemExit(f"{data} holds no lmgc90_reference.json")
    reference = json.loads((data / "lmgc90_reference.json").read_text())
    shapes, theirs = fdem.read(data / "blocks.obj"), published(reference)
    settled, supports = vault(shapes, reference)
    forces = pair_forces(settled)
    print("                              normal force                      shear force")
    print("springing moved   thrust      corr.  rel. L2  ratio of sums    corr.  rel. L2  ratio of sums")
    for spread in (0.0, 5e-4, -5e-4):
        sim, (left, _) = vault(shapes, reference, spread) if spread else (settled, supports)
        both = compared(pair_forces(sim), theirs)
        numbers = "".join(f"{c:9.3f} {d:7.3f} {r:10.3f}    " for c, d, r in both)
        print(f"{1e3 * spread:9.1f} mm  {sim[left].force[0] / 1e3:9.1f} kN {numbers}")
    folder.mkdir(parents=True, exist_ok=True)
    picture(settled, {"fdem": forces, "LMGC90": {pair: theirs[pair] for pair in forces}}, folder / "vault_forces.png")
    free = [block for i, block in enumerate(settled.scene.blocks) if i not in reference["support_blocks"]]
    reaction = sum(float(settled[side].force[2]) for side in supports)
    return abs(reaction / (9.81 * settled[free].mass.sum()) - 1)


if __name__ == "__main__":
    print(f"relative error of the support reaction: {main(*map(Path, sys.argv[1:])):.2e}")
