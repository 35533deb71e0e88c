"""Can gmsh be loaded and VTK draw without a display? Exit status 1 and a line on stderr per failure."""

from __future__ import annotations

import os
import subprocess
import sys

CHECKS = {
    "gmsh": "import gmsh; gmsh.initialize(); gmsh.finalize()",
    "VTK": "import pyvista as pv; p = pv.Plotter(off_screen=True, window_size=(64, 64)); p.add_mesh(pv.Cube());"
    "assert p.screenshot(return_img=True).std() > 0; p.close()",
}


def main() -> int:
    """Run each check in a process of its own: a missing library may abort it."""
    failed = False
    env = {"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow", **os.environ}
    for name, code in CHECKS.items():
        run = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
        if run.returncode != 0:
            failed = True
            lines = run.stderr.strip().splitlines() or [f"exit status {run.returncode}"]
            print(f"{name} does not work: {lines[-1]}", file=sys.stderr)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
