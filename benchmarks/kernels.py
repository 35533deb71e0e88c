"""Speed of the zone kernels on one thread: large strain against a linear element loop, block rows against the triad.

Run ``python benchmarks/kernels.py [cells ...]``: unit cubes of so many cells an edge (six zones a cell, jittered).
Everything is timed interleaved in one process; the numbers are medians.
"""

from __future__ import annotations

import sys
import time
from itertools import permutations

import numpy as np

from fdem._jit import kernel
from fdem.blocks.zoned import ZonedBlocks

ROUNDS = 7


@kernel
def linear_force(u, nodes, gradients, lam, mu, f):
    """Small strain, element scatter: ``f += V (lam tr(e) I + 2 mu e) G_a``; the plain loop everybody would write."""
    for e in range(nodes.shape[0]):
        i0, i1, i2, i3 = nodes[e, 0], nodes[e, 1], nodes[e, 2], nodes[e, 3]
        ox, oy, oz = u[i0, 0], u[i0, 1], u[i0, 2]
        ax, ay, az = u[i1, 0] - ox, u[i1, 1] - oy, u[i1, 2] - oz
        bx, by, bz = u[i2, 0] - ox, u[i2, 1] - oy, u[i2, 2] - oz
        cx, cy, cz = u[i3, 0] - ox, u[i3, 1] - oy, u[i3, 2] - oz
        g10, g11, g12 = gradients[e, 0], gradients[e, 1], gradients[e, 2]
        g20, g21, g22 = gradients[e, 3], gradients[e, 4], gradients[e, 5]
        g30, g31, g32 = gradients[e, 6], gradients[e, 7], gradients[e, 8]
        exx = ax * g10 + bx * g20 + cx * g30
        eyy = ay * g11 + by * g21 + cy * g31
        ezz = az * g12 + bz * g22 + cz * g32
        eyz = ay * g12 + by * g22 + cy * g32 + az * g11 + bz * g21 + cz * g31
        ezx = az * g10 + bz * g20 + cz * g30 + ax * g12 + bx * g22 + cx * g32
        exy = ax * g11 + bx * g21 + cx * g31 + ay * g10 + by * g20 + cy * g30
        pressure = lam[e] * (exx + eyy + ezz)
        sxx, syy, szz = pressure + 2.0 * mu[e] * exx, pressure + 2.0 * mu[e] * eyy, pressure + 2.0 * mu[e] * ezz
        syz, szx, sxy = mu[e] * eyz, mu[e] * ezx, mu[e] * exy
        px = sxx * g10 + sxy * g11 + szx * g12
        py = sxy * g10 + syy * g11 + syz * g12
        pz = szx * g10 + syz * g11 + szz * g12
        qx = sxx * g20 + sxy * g21 + szx * g22
        qy = sxy * g20 + syy * g21 + syz * g22
        qz = szx * g20 + syz * g21 + szz * g22
        rx = sxx * g30 + sxy * g31 + szx * g32
        ry = sxy * g30 + syy * g31 + syz * g32
        rz = szx * g30 + syz * g31 + szz * g32
        f[i0, 0] -= px + qx + rx
        f[i0, 1] -= py + qy + ry
        f[i0, 2] -= pz + qz + rz
        f[i1, 0] += px
        f[i1, 1] += py
        f[i1, 2] += pz
        f[i2, 0] += qx
        f[i2, 1] += qy
        f[i2, 2] += qz
        f[i3, 0] += rx
        f[i3, 1] += ry
        f[i3, 2] += rz


@kernel
def triad(a, b, c, s):
    """``a = b + s c``: 24 bytes an entry, as STREAM counts them."""
    for i in range(a.size):
        a[i] = b[i] + s * c[i]


def cube(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit cube of n^3 cells, six zones each, interior points jittered."""
    grid = np.stack(np.meshgrid(*3 * [np.arange(n + 1)], indexing="ij"), -1).reshape(-1, 3)
    X = grid / n
    inside = np.all((grid > 0) & (grid < n), axis=1)
    X[inside] += 0.15 / n * np.random.default_rng(0).uniform(-1, 1, (inside.sum(), 3))
    corners = np.stack(np.meshgrid(*3 * [np.arange(n)], indexing="ij"), -1).reshape(-1, 3)
    tets = []
    for order in permutations(range(3)):
        steps = np.zeros((4, 3), dtype=int)
        for k, axis in enumerate(order, start=1):
            steps[k] = steps[k - 1]
            steps[k, axis] += 1
        tets.append(corners[:, None, :] + steps)
    place = np.stack(tets, axis=1).reshape(-1, 4, 3)
    ids = (place[..., 0] * (n + 1) + place[..., 1]) * (n + 1) + place[..., 2]
    inverted = np.linalg.det(X[ids[:, 1:]] - X[ids[:, :1]]) < 0
    ids[inverted] = ids[inverted][:, [0, 2, 1, 3]]
    return X, ids.astype(np.int32)


def block(X: np.ndarray, tets: np.ndarray, large: bool, threads: int = 1) -> ZonedBlocks:
    """One zoned block of rock."""
    n = len(X)
    return ZonedBlocks(
        X,
        tets,
        np.array([0, len(tets)]),
        np.array([0, n]),
        np.array([2700.0]),
        np.array([2e10]),
        np.array([2e10]),
        np.array([large]),
        ["row-sum"],
        slice(0, 3 * n),
        slice(0, 3 * n),
        slice(0, n),
        threads=threads,
    )


def medians(jobs: dict) -> dict[str, float]:
    """Median seconds of each job, rounds interleaved."""
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for job in jobs.values():
        job()
    for _ in range(ROUNDS):
        for name, job in jobs.items():
            start = time.perf_counter()
            repeats = 0
            while time.perf_counter() - start < 0.05:
                job()
                repeats += 1
            times[name].append((time.perf_counter() - start) / repeats)
    return {name: float(np.median(values)) for name, values in times.items()}


def table(n: int) -> None:
    """Print one line of rates and ratios."""
    X, tets = cube(n)
    x = X + 1e-3 * np.random.default_rng(1).standard_normal(X.shape) / n
    u, f, flat = x - X, np.zeros_like(X), np.zeros(X.size)
    large, small, large2, small2 = (block(X, tets, s, t) for s, t in ((True, 1), (False, 1), (True, 2), (False, 2)))
    lam_v, mu_v = 2e10 * large.zone_volume, 2e10 * large.zone_volume
    size = 4_000_000
    a, b, c = np.zeros(size), np.ones(size), np.ones(size)
    rows = small._terms[0]
    g = np.zeros_like(X)
    product = (rows.row_start, rows.column, rows.diagonal, rows.upper, rows.y)
    partition = (rows.chunk_row, rows.window_start, rows.windows)

    def rows_only() -> None:
        from fdem.kernels.corotated import block_row_product

        block_row_product(*product, *partition, g)

    t = medians(
        {
            "triad": lambda: triad(a, b, c, 0.5),
            "linear": lambda: linear_force(u, tets, large.gradients, lam_v, mu_v, f),
            "stvk": lambda: large.internal(None, x, flat),
            "stvk 2 threads": lambda: large2.internal(None, x, flat),
            "block rows": rows_only,
            "small strain": lambda: small.internal(None, x, flat),
            "small strain 2 threads": lambda: small2.internal(None, x, flat),
        }
    )
    m = len(tets)
    # blocks and columns, then diagonal, y read, window and result written once each
    moved = rows.column.size * (72 + 4) + len(X) * (48 + 4 + 24 + 24)
    bandwidth, used = 24 * size / t["triad"], moved / t["block rows"]
    print(f"{m} zones, {len(X)} gridpoints; triad {bandwidth / 1e9:.1f} GB/s")
    for name in list(t)[1:]:
        print(f"  {name:24s} {m / t[name] / 1e6:8.1f} Mzones/s")
    print(f"  stvk / linear            {t['linear'] / t['stvk']:8.2f}   (target >= 0.6)")
    print(f"  block rows / triad       {used / bandwidth:8.2f}   (target >= 0.5; {used / 1e9:.1f} GB/s)")
    print(f"  small strain / stvk      {t['stvk'] / t['small strain']:8.2f}")
    print(
        f"  2 threads                {t['stvk'] / t['stvk 2 threads']:8.2f}   stvk,"
        f" {t['small strain'] / t['small strain 2 threads']:.2f} small strain"
    )


if __name__ == "__main__":
    for cells in [int(word) for word in sys.argv[1:]] or [12, 25]:
        table(cells)
