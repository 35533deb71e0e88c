"""What is looked at every so many steps: values not finite, zones inside out, energy from nowhere, closures."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from fdem.contact import carry
from fdem.errors import FdemWarning

__all__ = ["CHECK_EVERY", "Guard"]

CHECK_EVERY = 100  # steps between two looks
CLOSURE = 1e-2  # of the block size: overlap above which a stiffness that was chosen is called too low


class Guard:
    """Stops a simulation that has gone wrong, before anybody believes its numbers."""

    def __init__(self) -> None:
        self._suspect: tuple[int, float] | None = None  # step and error at which energy began to grow
        self._warned = False

    def look(self, sim: Any) -> None:
        """Look at everything.

        Raises
        ------
        UnstableError
            Names step, block and gridpoint.
        """
        sim.system.check()
        for batch in sim.model.batches:
            if (found := batch.inverted(sim.state.q, sim.state.x)) is not None:
                block, gp, what = found
                sim.system.unstable(gp, f"block {sim.model.names[block]!r}: {what} is turned inside out")
        if sim.ledger is not None and not sim.integrator.scaled:
            self._energy(sim)
        contacts = sim.system.contacts
        if contacts is not None and contacts.numerical and not self._warned:
            self._closure(contacts)

    def _energy(self, sim: Any) -> None:
        """Refuse energy that grows; a load that sets in looks like it for a step, so it must go on growing."""
        entry, suspect = sim.energy, self._suspect
        if hasattr(sim.integrator, "watch"):
            sim.integrator.watch(sim.system, entry.error, sim.ledger.turned)
        # round-off of balanced forces does work too: it is no growth
        noise = 1e-12 * sim.system.largest_force() * float(sim.model.size.max())
        if entry.closure == 0.0 or entry.error <= max(0.5 * sim.ledger.turned, noise):
            self._suspect = None
        elif suspect is None or entry.error < suspect[1]:
            self._suspect = sim.state.step, entry.error
        elif sim.state.step - suspect[0] >= CHECK_EVERY:
            speed = np.linalg.norm(sim.velocities(), axis=1)
            sim.system.unstable(
                int(np.argmax(speed)),
                f"energy has grown by {entry.error:.3g} J of {sim.ledger.turned:.3g} J turned over; "
                f"the stable step is {sim.integrator.limit(sim.system):.4g} s",
            )

    def _closure(self, contacts: Any) -> None:
        """Warn, once, where a stiffness that was chosen lets blocks overlap visibly."""
        deepest, names = carry.closure(contacts)
        if deepest > CLOSURE:
            self._warned = True
            warnings.warn(
                f"blocks {names} overlap by {deepest:.1%} of their size: the joint stiffness that was chosen is too "
                "low for this scene; give kn",
                FdemWarning,
                stacklevel=5,
            )
