"""Kernels that tell which blocks are at rest, and which of the sleeping ones feel a change."""

from __future__ import annotations

import math

from fdem._jit import kernel


@kernel
def largest(gp_block, values, origin, out):
    """Largest length of ``values - origin`` (n_gp, 3) at a gridpoint of every block (n_blocks,)."""
    out[:] = 0.0
    for g in range(len(gp_block)):
        s = 0.0
        for d in range(3):
            s += (values[g, d] - origin[g, d]) ** 2
        b = gp_block[g]
        if not s <= out[b]:
            out[b] = s
    for b in range(len(out)):
        out[b] = math.sqrt(out[b])


@kernel
def changes(gps, gp_block, f, reference, out):
    """Sums (n_blocks,) of the lengths of ``f - reference`` (n_gp, 3) [N] over the gridpoints `gps`; others stay."""
    for g in gps:
        out[gp_block[g]] = 0.0
    for g in gps:
        s = 0.0
        for d in range(3):
            s += (f[g, d] - reference[g, d]) ** 2
        out[gp_block[g]] += math.sqrt(s)
