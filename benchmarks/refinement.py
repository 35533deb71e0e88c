"""Contact inside whole steps: what a patch costs and its share of the step, against the fineness of the blocks.

    python benchmarks/refinement.py [--full]

A cube of 20 m cut into some 70 blocks by three joint sets, zoned without a size and then with finer and finer zones
(--full: down to 0.5 m), stands on rollers under gravity; a second scene is settled first by `Relaxation` so that
joints are closed all over. Printed are zones, patches (closed ones beside them), CPU time of an explicit step without
the energy ledger, the share of contact (forces, commit, detection) in it, and nanoseconds per patch: of the geometry
(re-projection, closing, rows: what `contact.py` measures alone, goal 120 ns where patches are closed, 400 where partly
open), and of everything. Writes results/refinement.json and the section of README.md.
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
from fdem.contact.contacts import Contacts
from fdem.kernels import footprints, patches

GOAL = 120.0  # ns for a closed patch, part 2
STEPS, REPEATS = 20, 5


def shapes() -> list[Any]:
    """The cube in some seventy pieces."""
    pieces = [fdem.brick((0, 0, 0), (jointed.SIDE,) * 3)]
    for k, (dip, direction) in enumerate([(75, 40), (65, 150), (15, 280)]):
        joints = fdem.JointSet(dip, direction, spacing=6.0, origin=(10.5, 9.2, 9.8), deviation=2, seed=k)
        pieces = fdem.cut(pieces, joints)
    return pieces


def scene(pieces: list[Any], size: float | None) -> fdem.Scene:
    """On rollers on all sides but the top."""
    result = fdem.Scene()
    result.add(pieces, fdem.Zoned(size=size) if size else fdem.Zoned(), jointed.ROCK, name="block")
    result.joint(fdem.Coulomb(kn=2e10, ks=1e10, friction=35))
    for axis, name in enumerate("xyz"):
        far = np.inf if name == "z" else jointed.SIDE - 1e-6
        result.fix(component=name, where=lambda x, k=axis, far=far: (x[:, k] < 1e-6) | (x[:, k] > far))
    return result


def spent(sim: fdem.Simulation) -> dict[str, float]:
    """Medians of CPU seconds of a step: in all, of contact, and of its geometry."""
    clocks = {"contact": 0.0, "geometry": 0.0}

    def clocked(kind: str, function: Any) -> Any:
        def call(*args: Any, **given: Any) -> Any:
            start = time.process_time()
            result = function(*args, **given)
            clocks[kind] += time.process_time() - start
            return result

        return call

    places = [(Contacts, name, "contact") for name in ("forces", "commit", "update")]
    places += [(footprints, "close_patches", "geometry"), (patches, "fill_rows", "geometry")]
    old = [getattr(owner, name) for owner, name, _ in places]
    for (owner, name, kind), function in zip(places, old, strict=True):
        setattr(owner, name, clocked(kind, function))
    rows = []
    try:
        for _ in range(REPEATS):
            clocks.update(contact=0.0, geometry=0.0)
            start = time.process_time()
            sim.cycle(STEPS)
            rows.append([time.process_time() - start, clocks["contact"], clocks["geometry"]])
    finally:
        for (owner, name, _), function in zip(places, old, strict=True):
            setattr(owner, name, function)
    step, contact, geometry = np.median(rows, axis=0) / STEPS
    return {"step": step, "contact": contact, "geometry": geometry}


def measure(pieces: list[Any], size: float | None) -> dict[str, Any]:
    """One line."""
    start = fdem.Simulation(scene(pieces, size), fdem.Relaxation(), energy=False, progress=False)
    start.cycle(100)
    sim = fdem.Simulation(start.scene, fdem.Explicit(), start=start, energy=False, progress=False)
    sim.cycle(3)
    times, contacts = spent(sim), sim.system.contacts
    return {
        "size": size, "blocks": sim.model.n_blocks, "zones": len(sim.model.zones), "patches": contacts.n_patches,
        "closed": int(contacts._active.sum()), **times,
    }  # fmt: skip


def main() -> None:
    """Measure, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true")
    full = parser.parse_args().full
    warnings.simplefilter("ignore", fdem.FdemWarning)
    facts, pieces = reporting.machine(), shapes()
    found = [measure(pieces, size) for size in (None, 3.0, 2.0, 1.4, *((1.0, 0.7, 0.5) if full else ()))]
    rows = [
        [
            r["size"] or "none", r["blocks"], r["zones"], r["patches"], r["closed"], 1e3 * r["step"],
            r["contact"] / r["step"], 1e9 * r["geometry"] / r["patches"], 1e9 * r["contact"] / r["patches"],
            1e9 * (r["step"] - r["contact"]) / r["zones"],
        ]
        for r in found
    ]  # fmt: skip
    head = [
        "zone size [m]", "blocks", "zones", "patches", "closed", "step [ms]", "contact share", "geometry [ns/patch]",
        "contact [ns/patch]", "rest [ns/zone]",
    ]  # fmt: skip
    text = reporting.table(head, rows)
    print(text)
    reporting.keep("refinement", {"machine": facts, "full": full, "rows": found})
    words = f"Goal for the geometry of a closed patch: {GOAL:g} ns."
    reporting.section(
        "refinement",
        "Contact inside whole steps, against the fineness of blocks",
        f"{reporting.caption(facts)} {words}\n\n{text}",
    )


if __name__ == "__main__":
    main()
