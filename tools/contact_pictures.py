"""Pictures of docs/contact.md: run by `make docs`, or ``python tools/contact_pictures.py [folder]``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tools")]

from contact_study import CORNER, EDGE, KN, on_floor  # noqa: E402
from contact_tools import World, box, coulomb, grid_box, move, rotation  # noqa: E402

from fdem.contact.laws import LawTable  # noqa: E402


def patches(path: Path) -> None:
    """A cube standing with an edge in another cube: the cells of the master cut the slave's surface into patches."""
    import matplotlib
    import pyvista

    lower = move(box(1, 1, 1), rotation([0, 0, 1], 0.3))
    upper = move(box(1, 1, 1), rotation([1, 0.35, 0], 0.75))
    upper = (upper[0] + np.array([0.35, 0.25, 0.5 - 0.16 - upper[0][:, 2].min()]), upper[1])
    w = World([upper, lower], law=coulomb(kn=KN))
    w.forces()
    p = w.contacts.patches
    colours = matplotlib.colormaps["tab10"]
    faces = {int(f): i for i, f in enumerate(np.unique(p.face_m))}
    plotter = pyvista.Plotter(off_screen=True, window_size=(1100, 800))
    for points, loops in (upper, lower):
        cells = np.concatenate([[len(loop), *loop] for loop in loops])
        surface = pyvista.PolyData(points, cells)
        plotter.add_mesh(surface, color="lightgrey", opacity=0.12, lighting=False)
        plotter.add_mesh(surface.extract_feature_edges(10), color="grey", line_width=2)
    for i in range(len(p)):
        corners = p.corners[p.start[i] : p.start[i + 1]]
        weights = np.column_stack([1 - corners.sum(axis=1), corners])
        polygon = weights @ w.x[p.gp[i, :3]]
        mesh = pyvista.PolyData(polygon, [len(polygon), *range(len(polygon))])
        plotter.add_mesh(mesh, color=colours(faces[int(p.face_m[i])]), show_edges=True, line_width=3, lighting=False)
        if w.contacts._active[i]:
            points = w.contacts._points[i]
            places = np.column_stack([1 - points.sum(axis=1), points]) @ w.x[p.gp[i, :3]]
            plotter.add_points(places, color="black", point_size=12, render_points_as_spheres=True)
    middle = np.array([0.42, 0.15, 0.45])
    plotter.camera_position = [middle + np.array([1.2, -1.6, 0.5]), middle, (0, 0, 1)]
    plotter.camera.zoom(1.5)
    plotter.screenshot(str(path))
    plotter.close()


def tilting(axes: Any) -> None:
    """Normal and lateral force while a cube turns from face to edge to corner at a fixed depth."""
    steps, h = 200, 0.02
    normal, lateral = [], []
    for k in range(steps + 1):
        a = k / steps
        turn = rotation([1, 0, 0], min(2 * a, 1) * np.pi / 4)
        if a > 0.5:
            turn = rotation([0, 1, 0], (2 * a - 1) * np.arctan(np.sqrt(0.5))) @ turn
        f = on_floor(box(1, 1, 1), h, turn, law=coulomb(kn=KN)).forces()[:8].sum(axis=0)
        normal.append(f[2])
        lateral.append(np.hypot(f[0], f[1]))
    share = np.linspace(0, 1, steps + 1)
    axes.semilogy(share, normal, label="normal")
    axes.semilogy(share, np.maximum(lateral, 1e-12), label="lateral")
    axes.set(xlabel="face ... edge ... corner", ylabel="force [N]", title="Tilting at a depth of 2 cm")
    axes.legend()


def eccentric(axes: Any) -> None:
    """Rotation under an eccentric load against the no-tension Winkler foundation."""
    from scipy.optimize import fsolve

    load, b = 1e5, 1.0
    w = on_floor(box(b, 1, 1), 0.0, np.eye(3), law=coulomb(kn=KN))
    base = w.x[:8].copy()

    def left(state: Any, e: float) -> Any:
        depth, angle = state
        turned = base - [0.03, 0.02, 0.5]
        turned = turned @ rotation([0, 1, 0], angle).T + [0.03, 0.02, 0.5 - depth]
        w.x[:8] = turned
        w.contacts.update(w.x)
        w.forces()
        force, moment = w.resultant(0, about=(0.03, 0.02, 0.5))
        return [(force[2] - load) / load, (moment[1] - load * e) / load]

    shares = np.linspace(0.0, 0.45, 10)
    found, exact, guess = [], [], np.array([load / KN, 0.0])
    for e in shares * b:
        guess = fsolve(left, guess, args=(e,), xtol=1e-9)
        found.append(abs(guess[1]))
        length = 3 * (b / 2 - e)
        exact.append(12 * load * e / (KN * b**3) if e <= b / 6 else 2 * load / (KN * length**2))
    axes.semilogy(shares[1:], exact[1:], "k-", label="no-tension Winkler")
    axes.semilogy(shares[1:], found[1:], "o", label="patches")
    axes.set(xlabel="eccentricity / width", ylabel="rotation [rad]", title="Eccentric load")
    axes.legend()


def sliding(axes: Any) -> None:
    """Friction over its limit while a brick slides across triangles of the floor."""
    floor = grid_box(16, 6, size=(8.0, 3.0, 1.0))
    for always, label in ((True, "cut every step"), (False, "cut when due")):
        w = World(
            [move(box(1, 1, 1), t=(1.3, 1.4, 1.5 - 1e-4)), floor], law=coulomb(tan=0.5), affine=[True, False],
            fixed=[False, True], prune=1e-4, clip_always=always,
        )  # fmt: skip
        ratio = []
        for _ in range(800):
            w.shift(0, [5e-4, 1e-4, 0])
            w.contacts.update(w.x)
            w.forces(1e-4)
            w.commit()
            f = w.resultant(0)[0]
            ratio.append(np.hypot(f[0], f[1]) / (0.5 * f[2]))
        axes.plot(np.arange(800) * 0.51, ratio, label=label)
    axes.set(xlabel="path [mm]", ylabel="friction / mu N", title="Sliding across triangles", ylim=(0.995, 1.001))
    axes.legend()


def stiff_corners(axes: Any) -> None:
    """Force against depth of a corner and an edge, with and without stiff corners of 10 cm."""
    depth = np.geomspace(1e-4, 0.1, 40)
    for name, turn, colour in (("corner", CORNER, "C0"), ("edge", EDGE, "C1")):
        for size, style in ((0.0, "--"), (0.1, "-")):
            law = LawTable("coulomb", coulomb(kn=KN).props, corner=np.array([size**2]))
            force = [on_floor(box(1, 1, 1), h, turn, law=law).forces()[:8].sum(axis=0)[2] for h in depth]
            axes.loglog(depth, force, style, color=colour, label=f"{name}{', stiff' if size else ''}")
    axes.set(xlabel="depth [m]", ylabel="force [N]", title="Stiff corners, 10 cm")
    axes.legend()


def main(folder: Path) -> None:
    """Draw all."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    patches(folder / "contact_patches.png")
    figure, axes = pyplot.subplots(2, 2, figsize=(11, 8))
    for draw, ax in zip((tilting, eccentric, sliding, stiff_corners), axes.ravel(), strict=True):
        draw(ax)
        ax.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(folder / "contact_curves.png", dpi=90)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs")
