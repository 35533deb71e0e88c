"""What was compiled, what was left out and why: the text of `Simulation.describe`."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.contact import sphere_readout
from fdem.contact.carry import notes
from fdem.contact.parking import sleepers

__all__ = ["describe"]


def describe(sim: Any) -> str:
    """Return the description of a simulation, one fact a line."""
    model, contacts, integrator = sim.model, sim.system.contacts, sim.integrator
    lines = [
        f"fdem: {model.n_blocks} blocks, {len(model.X)} gridpoints, {len(model.zones)} zones, "
        f"{len(sim.state.v)} unknowns, {0 if contacts is None else 3 * contacts.n_patches} contact points",
        f"integrator: {integrator!r}",
        _step(sim),
    ]
    lines += model.notes
    if contacts is not None:
        lines += notes(contacts)
    if sim.system.particles is not None:
        lines += sphere_readout.notes(sim.system.particles)
    lines += [sleepers(contacts), _substeps(sim)]
    if contacts is not None:
        lines.append("detection: left out of steps before which nothing has moved far enough to matter")
    if len(model.zones):
        lines.append("stress recovery: left out of steps, stresses are computed when asked for")
    if not sim._observers:
        lines.append("histories and frames: left out, none is asked for")
    if sim.ledger is None:
        lines.append("energy ledger: left out (energy=False)")
    if sim.system.f_load is None:
        lines.append("work of loads: left out, there are none")
    if not sim.system.constraints.moving:
        lines.append("work of prescribed motion: left out, nothing is driven")
    return "\n".join(lines)


def _step(sim: Any) -> str:
    if getattr(sim.integrator, "implicit", False):
        return _implicit(sim)
    bounds = sim.system.block_frequencies()
    if sim.integrator.scaled:
        return f"step: {sim.dt:g} units of fictitious time, half of which is the limit of the scaled masses' bound"
    if not bounds.any():
        return f"step: {sim.dt:.4g} s, nothing limits it"
    block = int(np.argmax(bounds))
    gp = getattr(sim.model.batch_of(block), "limiting_gridpoint", None)
    where = ""
    if gp is not None:
        where = f" at gridpoint {int(gp[sim.model.batch_row[block]]) - int(sim.model.gp_range[block, 0])}"
    limit = sim.integrator.limit(sim.system)
    return f"step: {sim.dt:.4g} s, limit {limit:.4g} s set by block {sim.model.names[block]!r}{where}"


def _substeps(sim: Any) -> str:
    rates = getattr(sim.integrator, "rates", None)
    if rates is None:
        return "sub-steps: left out, not asked for"
    counts = np.bincount(rates.level[~sim.model.fixed])
    blocks = ", ".join(f"{n} blocks every {2**k}" for k, n in enumerate(counts.tolist()) if n)
    return (
        f"sub-steps: {rates.every} of {sim.dt / rates.every:.4g} s in a step; forces are found for {blocks}: "
        f"{rates.saved:.2g} times fewer than all in all"
    )


def _implicit(sim: Any) -> str:
    integrator, n = sim.integrator, len(sim.state.v)
    linear, trial = integrator.linear, integrator.trial
    method = linear.chosen(n, trial.assembler, integrator.scaled)
    why = "chosen by size and kind of blocks" if linear.method == "auto" else "asked for"
    step = "one step is a solution at rest" if integrator.scaled else f"{sim.dt:.4g} s, no limit"
    return f"step: {step}; linear systems: {method} ({why}), last used: {linear.used}"
