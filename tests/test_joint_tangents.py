"""The tangent of every joint law's contact forces against differences of the forces, along the path of its contract."""

from __future__ import annotations

import numpy as np
import pytest
from contracts import DT, LAWS, Ride, whole_path

from fdem.contact.tangents import tangent

EDGES = 0.2  # part of the states of a path that may lie where a law has a kink within the difference


def derivative(w, du, dt):
    """What the tangent makes of a small motion `du` (n_gp, 3)."""
    gp, blocks = tangent(w.contacts, w.x, dt)
    out = np.zeros_like(w.x)
    for k, block in zip(gp, blocks, strict=True):
        np.add.at(out, k, np.einsum("aibj,bj->ai", block, du[k]))
    return out


def mismatch(law):
    """Differences between the tangent and one-sided differences of the forces, relative, for all states of a path."""
    ride, rng, found = Ride(law), np.random.default_rng(0), []
    ride.w.law.smooth = True
    way, e = whole_path(6), 1e-10
    for at in way:
        w = ride.w
        w.x[:] = ride.place(at)
        w.contacts.update(w.x)
        base, x = w.forces(DT).copy(), w.x.copy()
        moved = x - w.x_old  # further the same way, and a little any way
        own = slice(w.start[ride.cube], w.start[ride.cube + 1])
        du = moved / max(np.abs(moved).max(), 1e-300)
        du[own] += 0.1 * (rng.normal(size=3) + np.cross(rng.normal(size=3), x[own]))
        expected = derivative(w, du, DT)
        w.x[:] = x + e * du
        change = (w.forces(DT) - base) / e
        w.x[:] = x
        w.forces(DT)
        size = max(np.abs(expected).max(), np.abs(change).max(), 1e-300)
        found.append(np.abs(change - expected).max() / size)
        w.commit()
    return np.sort(found)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_tangent_of_every_law(law):
    """5e-3: what friction frames and closed areas change is left out, of the order of the closure over the size."""
    found = mismatch(law)
    assert found[int((1.0 - EDGES) * len(found)) - 1] < 5e-3, found
