"""Blocks at their own rates: updates and CPU time saved, against the error, on a jointed rock mass; one thread.

    python benchmarks/substeps.py [--full]

A cube of 585 zoned blocks cut by three joint sets, slivers among them, is loaded from above by a pressure that comes
within 0.2 ms (--full: 2 ms of it and finer meshes too). Printed for ``Explicit(substeps=n)``: how many times fewer
zones are updated, CPU seconds, the difference of all displacements (root mean square over that of the displacements,
and the largest over the largest) from plain steps of half the size, that of the mesh (plain steps on zones of 0.9 m),
and the closure of the energy balance. Writes results/substeps.json and the section of README.md.
"""

from __future__ import annotations

import argparse
import time
import warnings
from typing import Any

import jointed
import numpy as np
import reporting

import fdem

PRESSURE, RISE = 1e6, 2e-4


def rock(size: float | None) -> fdem.Scene:
    """The jointed cube on rollers under a pressure from above."""
    scene = fdem.Scene()
    scene.add(jointed.blocks(1.0), fdem.Zoned(size=size) if size else fdem.Zoned(), jointed.ROCK, name="block")
    scene.joint(fdem.Coulomb(kn=2e10, ks=1e10, friction=35))
    for axis, name in enumerate("xyz"):
        scene.fix(component=name, where=lambda x, k=axis: x[:, k] < 1e-9)
    top = jointed.SIDE - 1e-6
    scene.apply(fdem.Pressure(PRESSURE), where=lambda x: x[:, 2] > top, factor=lambda t: min(t / RISE, 1.0))
    return scene


def run(scene: fdem.Scene, span: float, **given: Any) -> tuple[fdem.Simulation, float]:
    """The simulation after `span` [s], and the CPU seconds of its steps."""
    sim = fdem.Simulation(scene, fdem.Explicit(**given), progress=False)
    sim.run(2e-6)  # compiles what is not in the cache
    start = time.process_time()
    sim.run(span - 2e-6)
    return sim, time.process_time() - start


def off(u: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Root mean square and largest difference, relative."""
    d = u - reference
    return float(np.linalg.norm(d) / np.linalg.norm(reference)), float(np.abs(d).max() / np.abs(reference).max())


def centres(sim: fdem.Simulation) -> np.ndarray:
    """Displacements of the blocks' centroids."""
    return sim.centroids() - sim.centroids0


def measure(
    size: float | None, span: float, settings: tuple[tuple[int, float], ...], finer: float | None
) -> list[dict[str, Any]]:
    """One line for every number of sub-steps."""
    scene = rock(size)
    half, _ = run(scene, span, safety=0.4)
    reference, at_centres = half.displacements(), centres(half)
    mesh = None if finer is None else off(at_centres, centres(run(rock(finer), span)[0]))[0]
    found = []
    for n, safety in settings:
        sim, seconds = run(scene, span, substeps=n, safety=safety)
        rms, largest = off(sim.displacements(), reference)
        own = sim.integrator.rates
        found.append({
            "blocks": len(scene.blocks), "zones": len(sim.model.zones), "substeps": n, "safety": safety,
            "times fewer updates": safety / 0.8 * (1.0 if own is None else own.saved), "seconds": seconds, "rms": rms,
            "largest": largest, "mesh": mesh, "closure": sim.energy.closure,
        })  # fmt: skip
        print(found[-1], flush=True)
    return found


def main() -> None:
    """Measure, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true")
    full = parser.parse_args().full
    warnings.simplefilter("ignore", fdem.FdemWarning)
    facts = reporting.machine()
    span = 2e-3 if full else 3e-4
    settings = ((1, 0.8), (4, 0.8), (8, 0.4), (16, 0.8))
    found = measure(None, span, (*settings, (2, 0.8), (32, 0.8)) if full else settings, 0.9 if full else None)
    if full:
        found += measure(1.5, 1e-3, settings, None)
    first = {row["zones"]: row["seconds"] for row in reversed(found)}
    rows = [
        [
            row["blocks"], row["zones"], row["substeps"], row["safety"], row["times fewer updates"],
            row["seconds"], first[row["zones"]] / row["seconds"], row["rms"], row["largest"], row["mesh"],
            row["closure"],
        ]
        for row in found
    ]  # fmt: skip
    head = [
        "blocks",
        "zones",
        "substeps",
        "safety",
        "fewer updates",
        "CPU s",
        "faster",
        "rms",
        "largest",
        "mesh, rms",
        "closure",
    ]
    text = reporting.table(head, rows)
    print(text)
    reporting.keep("substeps", {"machine": facts, "full": full, "rows": found})
    words = (
        "'rms' and 'largest' are differences from plain steps of half the size, 'mesh' that of plain steps on zones of "
        "0.9 m (centroids of blocks, root mean square)."
    )
    reporting.section("substeps", "Blocks at their own rates", f"{reporting.caption(facts)} {words}\n\n{text}")


if __name__ == "__main__":
    main()
