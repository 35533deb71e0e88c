"""Moving a state from one compiled scene to another: excavation, `start=`, and files."""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np

from fdem.contact import sphere_readout
from fdem.contact.carry import adopt
from fdem.errors import CheckpointError
from fdem.model import Model
from fdem.scene import boundary
from fdem.scene.kept import Kept
from fdem.scene.scene import Applied, Block, Gridpoint

if TYPE_CHECKING:
    from fdem.simulation import Simulation

__all__ = ["Carrier", "carry", "read", "restore", "save", "transfer"]

FORMAT = 1
SCALARS = ("lag", "dt", "work", "damped", "omega")
ARRAYS = ("q", "v", "x", "x_old")
KEPT = (
    "elastic_old",
    "_load_old",
    "_reaction_old",
    "_turning_old",
    "_spun",
    "_k_used",
    "force_before",
    "a_old",
    "given",
)


class Carrier:
    """What a simulation was before it was compiled again."""

    def __init__(self, sim: Simulation) -> None:
        if hasattr(sim.integrator, "settle"):
            sim.integrator.settle(sim.system)
        self.model, self.state, self.system = sim.model, sim.state, sim.system
        self.x0, self.centroids0, self.turned = sim.x0, sim.centroids0, sim.turned

    def rows(self, model: Model) -> list[tuple[int, int]]:
        """Pairs (old row, new row) of the blocks that `model` still has."""
        old = {name: i for i, name in enumerate(self.model.names)}
        return [(old[name], i) for i, name in enumerate(model.names) if name in old]

    def gridpoints(self, model: Model) -> np.ndarray:
        """New number of every old gridpoint; -1 if its block is gone."""
        number = np.full(len(self.model.X), -1, dtype=np.int64)
        for old, new in self.rows(model):
            start, stop = self.model.gp_range[old]
            number[start:stop] = model.gp_range[new, 0] + np.arange(stop - start)
        return number


def carry(old: Carrier, sim: Simulation, *, motion: bool = True) -> None:
    """Move positions, velocities and contact history of `old` into the newly compiled `sim`.

    Parameters
    ----------
    old : Carrier
        Where the state comes from.
    sim : Simulation
        Where it goes; matched by block name.
    motion : bool, optional
        Take velocities, time and the sums of work as well.

    Raises
    ------
    CheckpointError
        If a block of the same name has other gridpoints.
    """
    model, state = sim.model, sim.state
    for before, after in old.rows(model):
        a, b = slice(*old.model.gp_range[before]), slice(*model.gp_range[after])
        if a.stop - a.start != b.stop - b.start:
            raise CheckpointError(
                f"block {model.names[after]!r} has {b.stop - b.start} gridpoints, the state has {a.stop - a.start}"
            )
        state.x[b], state.x_old[b], sim.x0[b] = old.state.x[a], old.state.x_old[a], old.x0[a]
        sim.centroids0[after] = old.centroids0[before]
        _carry_block(old, sim, before, after, motion)
        if sim.system._load_old is not None and old.system._load_old is not None:
            sim.system._load_old[b] = old.system._load_old[a]
    if sim.system.contacts is not None and old.system.contacts is not None:
        adopt(sim.system.contacts, old.system.contacts, np.array(old.rows(model)), old.gridpoints(model), state.x)
    if sim.system.particles is not None and old.system.particles is not None:
        sphere_readout.adopt(sim.system.particles, old.system.particles, np.array(old.rows(model)), state.x)
    if motion:
        for name in SCALARS:
            setattr(sim.system, name, getattr(old.system, name))
        state.t, state.step = old.state.t, old.state.step
    sim.system.current = False


def _carry_block(old: Carrier, sim: Simulation, before: int, after: int, motion: bool) -> None:
    source, target = old.model.batch_of(before), sim.model.batch_of(after)
    rows = int(old.model.batch_row[before]), int(sim.model.batch_row[after])
    if source is None or target is None or type(source) is not type(target):
        if target is not None:
            target.fit(rows[1], sim.state.q, sim.state.x)
        return
    a, b = source.coords_of(rows[0]), target.coords_of(rows[1])
    sim.state.q[b] = old.state.q[a]
    sim.system.q0[b] = old.system.q0[a]
    sim.turned[after] = old.turned[before]
    if not motion:
        return
    a, b = source.dofs_of(rows[0]), target.dofs_of(rows[1])
    sim.state.v[b] = old.state.v[a]
    if old.system.elastic_old is not None:
        if sim.system.elastic_old is None:
            sim.system.elastic_old = np.zeros_like(sim.state.v)
        sim.system.elastic_old[b] = old.system.elastic_old[a]
    if old.system._reaction_old is not None and sim.system._reaction_old is not None:
        sim.system._reaction_old[b] = old.system._reaction_old[a]


def transfer(source: Simulation, sim: Simulation) -> None:
    """State of another simulation at the start of `sim` (see `Simulation`, `start`)."""
    same = source.integrator.scaled == sim.integrator.scaled
    carry(Carrier(source), sim, motion=same)
    if not same:
        # what happened since the last commit belongs to the past, not to the first step
        sim.system.forces()
        sim.system.commit()
        sim.system.current = False
        sim.x0, sim.centroids0 = sim.places(), sim.centroids()
        sim.turned[:] = 0.0


def save(sim: Simulation, path: str | Path) -> None:
    """Write everything that influences the next step to one ``.npz`` file."""
    system, state = sim.system, sim.state
    arrays: dict[str, Any] = {name: getattr(state, name) for name in ARRAYS}
    arrays |= {"x0": sim.x0, "centroids0": sim.centroids0, "turned": sim.turned, "q0": system.q0}
    for name in KEPT:
        if getattr(system, name) is not None:
            arrays[name] = getattr(system, name)
    for i, scaled in enumerate(system.scaled):
        if scaled is not None:
            arrays[f"scaled_{i}"] = scaled
    arrays |= {f"coupled_{i}": group.inverse for i, group in enumerate(system.constraints.coupled)}
    if system.contacts is not None:
        arrays |= {f"contacts_{key}": value for key, value in system.contacts.state_arrays().items()}
    if system.particles is not None:
        arrays |= {f"spheres_{key}": value for key, value in sphere_readout.state_arrays(system.particles).items()}
    if hasattr(sim.integrator, "kept"):
        arrays |= {f"integrator_{key}": value for key, value in sim.integrator.kept().items()}
    for i, (gp, forces, _, _) in enumerate(sim._releases):
        arrays |= {f"release_gp_{i}": gp, f"release_f_{i}": forces}
    if sim._before is not None:
        layout = sim.compiled.layout
        arrays |= {f"kept_{key}": value for key, value in Kept(layout.origin, layout.kept).arrays().items()}
    handles = list(sim._applied)
    head = {
        "format": FORMAT,
        "scaled": bool(sim.integrator.scaled),
        "names": sim.model.names,
        "digests": digests(sim.model),
        "t": state.t.hex(),
        "step": state.step,
        "step_length": float(sim.dt).hex(),
        "stale": bool(system.stale),
        "scalars": {name: float(getattr(system, name)).hex() for name in SCALARS},
        "removed": sorted(sim._removed),
        "releases": [[int(at), int(over)] for _, _, at, over in sim._releases],
        "factors": [_factor(sim._applied[h].factor) for h in sim.scene.loads],
        "loads": [_written(sim._applied[h]) for h in handles[len(sim.scene.loads) :]],
        "ledger": None if sim.ledger is None else {"start": sim.ledger.start, "turned": sim.ledger.turned},
    }
    arrays["head"] = np.frombuffer(json.dumps(head).encode(), dtype=np.uint8)
    try:
        with open(path, "wb") as file:
            np.savez(file, **arrays)
    except OSError as error:
        raise CheckpointError(f"save: {path}: {error}") from error


def _factor(factor: Any) -> Any:
    return "callable" if callable(factor) else float(factor)


def _written(applied: Applied) -> dict[str, Any]:
    """A load as plain data; callables are marked, a file cannot hold them."""
    load = applied.load
    known = type(load).__name__ in boundary.__all__
    fields = {}
    if known:
        for key, value in asdict(load).items():
            fields[key] = "callable" if callable(value) else value.tolist() if isinstance(value, np.ndarray) else value
    return {
        "class": type(load).__name__ if known else "callable",
        "fields": fields,
        "target": _target(applied.target),
        "where": None if applied.where is None else "callable",
        "factor": _factor(applied.factor),
    }


def _target(target: Any) -> Any:
    if isinstance(target, Block):
        return target.name
    if isinstance(target, (list, tuple)):
        return [_target(entry) for entry in target]
    if isinstance(target, Gridpoint):
        return {"near": list(target.near), "target": _target(target.target)}
    return target


def read(path: str | Path) -> dict[str, Any]:
    """Arrays of a saved file, with its head decoded.

    Raises
    ------
    CheckpointError
        If the file is missing, damaged or of another format.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            saved: dict[str, Any] = {key: file[key] for key in file.files}
        saved["head"] = json.loads(saved["head"].tobytes().decode())
    except (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error) as error:
        raise CheckpointError(f"load: {path}: the file is missing or damaged: {error}") from error
    if saved["head"].get("format") != FORMAT:
        raise CheckpointError(f"load: {path}: format {saved['head'].get('format')}, expected {FORMAT}")
    return saved


def restore(saved: dict[str, Any], sim: Simulation) -> None:
    """Put a saved state into a simulation of the same scene.

    Raises
    ------
    CheckpointError
        If the scene differs or a callable is missing.
    """
    head = saved["head"]
    if head["scaled"] != sim.integrator.scaled:
        written = "a Relaxation" if head["scaled"] else "an integrator in real time"
        raise CheckpointError(
            f"load: the file was written by {written}, the integrator is {sim.integrator!r}; "
            "to go on with another integrator use Simulation(scene, integrator, start=path)"
        )
    _same_blocks([b.name for b in sim.scene.blocks if b.name not in head["removed"]], head["names"])
    _restore_loads(head, sim)
    sim._removed = frozenset(head["removed"])
    sim._releases = [
        (saved[f"release_gp_{i}"], saved[f"release_f_{i}"], at, over) for i, (at, over) in enumerate(head["releases"])
    ]
    kept = {key[len("kept_") :]: value for key, value in saved.items() if key.startswith("kept_")}
    sim._before = Kept.read(kept) if kept else None
    sim._compile()
    for name, have, wanted in zip(head["names"], digests(sim.model), head["digests"], strict=True):
        if have != wanted:
            raise CheckpointError(f"load: block {name!r} of the scene has other gridpoints or zones than the file's")
    system, state = sim.system, sim.state
    for name in ARRAYS:
        have, wanted = getattr(state, name), saved[name]
        if have.shape != wanted.shape:
            raise CheckpointError(f"load: {name} has shape {wanted.shape} in the file, {have.shape} in the scene")
        have[:] = wanted
    sim.x0, sim.centroids0, sim.turned = saved["x0"], saved["centroids0"], saved["turned"]
    system.q0 = saved["q0"]
    sim.integrator.start(system)
    for name in KEPT:
        if name in saved:
            setattr(system, name, saved[name])
    system.scaled = [saved.get(f"scaled_{i}") for i in range(len(system.scaled))]
    for i, group in enumerate(system.constraints.coupled):
        group.weigh(saved[f"coupled_{i}"], sim.integrator.scaled)
    if system.contacts is not None:
        system.contacts.restore({k[len("contacts_") :]: v for k, v in saved.items() if k.startswith("contacts_")})
    if system.particles is not None:
        own = {k[len("spheres_") :]: v for k, v in saved.items() if k.startswith("spheres_")}
        sphere_readout.restore(system.particles, own, state.x)
    if hasattr(sim.integrator, "kept"):
        sim.integrator.restore({k[len("integrator_") :]: v for k, v in saved.items() if k.startswith("integrator_")})
    for name in SCALARS:
        setattr(system, name, float.fromhex(head["scalars"][name]))
    state.t, state.step = float.fromhex(head["t"]), int(head["step"])
    sim.integrator.step_length = float.fromhex(head["step_length"])
    system.stale, system.current = bool(head["stale"]), False
    if sim.ledger is not None and head["ledger"] is not None:
        sim.ledger.start, sim.ledger.turned = head["ledger"]["start"], head["ledger"]["turned"]


def _same_blocks(have: list[str], wanted: list[str]) -> None:
    if have != wanted:
        other = sorted(set(have) ^ set(wanted))
        which = ", ".join(other[:5]) or "in another order"
        raise CheckpointError(f"load: the scene has other blocks than the file: {which}")


def digests(model: Model) -> list[int]:
    """Checksum of gridpoints and zones of every block."""
    result = []
    for row, (start, stop) in enumerate(model.gp_range):
        zones = model.zones[model.zone_start[row] : model.zone_start[row + 1]] - start
        result.append(zlib.crc32(zones.astype(np.int64).tobytes(), zlib.crc32(model.X[start:stop].tobytes())))
    return result


def _restore_loads(head: dict[str, Any], sim: Simulation) -> None:
    if len(head["factors"]) != len(sim.scene.loads):
        raise CheckpointError(f"load: the scene has {len(sim.scene.loads)} loads, the file {len(head['factors'])}")
    for handle, factor in zip(sim.scene.loads, head["factors"], strict=True):
        if factor != "callable":
            sim._applied[handle].factor = factor
        elif not callable(handle.factor):
            raise CheckpointError(
                f"load: the factor of {handle.load!r} was a callable; the scene gives {handle.factor!r}"
            )
    for entry in head["loads"]:
        missing = [key for key in ("class", "where", "factor") if entry[key] == "callable"]
        missing += [key for key, value in entry["fields"].items() if value == "callable"]
        if missing:
            raise CheckpointError(
                f"load: {entry['class']} was applied to the simulation with a callable ({', '.join(missing)}) "
                "that a file cannot hold; apply it to the scene instead"
            )
        target = entry["target"]
        if isinstance(target, dict):
            target = Gridpoint(tuple(target["near"]), target["target"])
        load = getattr(boundary, entry["class"])(**entry["fields"])
        handle = sim.scene.applied(load, target, None, entry["factor"])
        sim._applied[handle] = Applied(handle.load, handle.target, None, handle.factor)
