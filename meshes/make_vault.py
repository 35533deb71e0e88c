"""Write meshes/vault.obj: a barrel vault of dry voussoirs in running bond, coordinates rounded to a millimetre.

    python meshes/make_vault.py

Courses stand along the vault's axis; every other one starts with half a voussoir. One OBJ group a
voussoir, as other programs write such files.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

INNER, OUTER = 2.0, 2.35  # radii [m]
LENGTH = 0.6  # of a course [m]
COURSES, VOUSSOIRS = 6, 9
SPRINGING = np.radians(20.0)  # above the horizontal


def angles(course: int) -> np.ndarray:
    """Angles of the radial joints of a course, from one springing to the other."""
    full = np.linspace(SPRINGING, np.pi - SPRINGING, VOUSSOIRS + 1)
    if course % 2 == 0:
        return full
    return np.concatenate([full[:1], 0.5 * (full[1:] + full[:-1]), full[-1:]])


def main(path: Path = Path(__file__).parent / "vault.obj") -> None:
    """Write the file."""
    lines = ["# barrel vault, written by meshes/make_vault.py; metres"]
    count = 0
    for course in range(COURSES):
        y = np.array([course, course + 1]) * LENGTH
        joints = angles(course)
        for k, (a, b) in enumerate(pairwise(joints)):
            lines.append(f"o voussoir_{course}_{k}")
            for depth in y:
                for radius, angle in ((INNER, a), (OUTER, a), (OUTER, b), (INNER, b)):
                    lines.append(f"v {radius * np.cos(angle):.3f} {depth:.3f} {radius * np.sin(angle):.3f}")
            loops = ((1, 2, 3, 4), (8, 7, 6, 5), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 8, 4), (4, 8, 5, 1))
            lines += ["f " + " ".join(str(count + v) for v in loop) for loop in loops]
            count += 8
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
