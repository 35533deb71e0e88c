"""Volume, centroid and second moments of a union of balls, overlaps counted once."""

from __future__ import annotations

import numpy as np

from fdem.scene.polygons import Array

__all__ = ["union_moments"]

TRIPLES = 12  # balls up to which every change of the section is found
ORDER, ORDER_MANY = 20, 8  # points between two changes


def union_moments(centres: Array, radii: Array) -> tuple[float, Array, Array]:
    """Volume [m^3], centroid (3,) [m] and second moments about it (3, 3) [m^5] of a union of balls.

    Parameters
    ----------
    centres : (n, 3) array
        [m].
    radii : (n,) array
        [m].

    Notes
    -----
    Sections across an axis are unions of discs, whose moments follow from the arcs of their outline (Green's theorem).
    The integral over the axis is divided where the section changes its form, and each part is done by Gauss's rule in a
    variable in which the roots at its ends are smooth. Centres on a line: exact to round-off (the sections are single
    discs and the integrand is a polynomial). Otherwise the error is below 1e-9 of the values for up to 12 balls, and
    below 1e-6 beyond, where changes made by three spheres meeting in a point are not looked for.
    """
    keep = _not_within(centres, radii)
    centres, radii = centres[keep], radii[keep]
    middle = 0.5 * ((centres - radii[:, None]).min(axis=0) + (centres + radii[:, None]).max(axis=0))
    size = float(radii.max())
    local, r = (centres - middle) / size, radii / size
    frame, straight = _axes(local)
    local = local @ frame.T
    moments = _on_a_line(local, r) if straight else _in_sections(local, r)
    volume = moments[0]
    centre = moments[1:4] / volume
    xx, yy, zz, yz, zx, xy = moments[4:]
    second = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]) - volume * np.outer(centre, centre)
    return volume * size**3, middle + size * (frame.T @ centre), size**5 * (frame.T @ second @ frame)


def _not_within(centres: Array, radii: Array) -> Array:
    """Balls that are not inside another one (of equal ones the first)."""
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)
    within = apart + radii[:, None] <= radii[None, :]
    twin = within & within.T
    within &= ~twin | (np.arange(len(radii))[:, None] > np.arange(len(radii)))
    np.fill_diagonal(within, False)
    return np.asarray(~within.any(axis=1))


def _axes(local: Array) -> tuple[Array, bool]:
    """Axes in rows, the last along the centres where these lie on a line; whether they do."""
    spread = local - local[0]
    far = spread[int(np.argmax(np.linalg.norm(spread, axis=1)))]
    length = np.linalg.norm(far)
    if length == 0.0:
        return np.eye(3), True
    axis = far / length
    off = spread - np.outer(spread @ axis, axis)
    straight = bool(np.linalg.norm(off, axis=1).max() < 1e-13 * max(1.0, float(length)))
    if not straight:
        # any axis will do that no two spheres share a circle across
        axis = np.array([0.2672612419124244, 0.5345224838248488, 0.8017837257372732])
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(axis, first), axis]), straight


def _on_a_line(local: Array, r: Array) -> Array:
    """Moments 1, x, y, z, xx, yy, zz, yz, zx, xy of balls on a line parallel to z."""
    x, y, z = local[0, 0], local[0, 1], local[:, 2]
    cuts = [z - r, z + r]
    for i in range(len(r)):
        with np.errstate(divide="ignore", invalid="ignore"):
            meet = 0.5 * (z[i] + z + (r[i] ** 2 - r**2) / (z - z[i]))
        cuts.append(meet[np.isfinite(meet)])
    cut = np.unique(np.concatenate(cuts))
    node, weight = np.polynomial.legendre.leggauss(4)
    half = 0.5 * np.diff(cut)[:, None]
    s = (0.5 * (cut[1:] + cut[:-1])[:, None] + half * node).ravel()
    square = np.maximum((r**2 - (s[:, None] - z) ** 2).max(axis=1), 0.0)
    area = np.pi * square * (half * weight).ravel()
    across = 0.25 * area @ square
    volume, first, second = area.sum(), area @ s, area @ (s * s)
    return np.array(
        [volume, x * volume, y * volume, first, across + x * x * volume, across + y * y * volume, second, y * first,
         x * first, x * y * volume]
    )  # fmt: skip


def _in_sections(local: Array, r: Array) -> Array:
    """Moments as `_on_a_line`, of balls anywhere."""
    cut = _changes(local, r)
    node, weight = np.polynomial.legendre.leggauss(ORDER if len(r) <= TRIPLES else ORDER_MANY)
    # z = a + (b - a) (1 - cos t) / 2 makes the square roots at both ends smooth
    t = 0.5 * np.pi * (node + 1.0)
    length = np.diff(cut)[:, None]
    z = (cut[:-1, None] + 0.5 * length * (1.0 - np.cos(t))).ravel()
    w = (0.25 * np.pi * length * np.sin(t) * weight).ravel()
    total = np.zeros(10)
    rows = max(1, 200_000 // len(r) ** 2)
    for k in range(0, len(z), rows):
        s, ws = z[k : k + rows], w[k : k + rows]
        area, x, y, xx, yy, xy = ws * _discs(local, r, s)
        total += [
            area.sum(), x.sum(), y.sum(), area @ s, xx.sum(), yy.sum(), area @ (s * s), y @ s, x @ s, xy.sum()
        ]  # fmt: skip
    return total


def _changes(local: Array, r: Array) -> Array:
    """Heights at which the section may change its form, ascending."""
    n, cuts = len(r), [*(local[:, 2] - r), *(local[:, 2] + r)]
    for i in range(n):
        for j in range(i):
            d = local[j] - local[i]
            length = float(np.linalg.norm(d))
            if not abs(r[i] - r[j]) < length < r[i] + r[j]:
                continue
            # the circle in which both spheres meet
            along = (length**2 + r[i] ** 2 - r[j] ** 2) / (2.0 * length)
            radius = np.sqrt(max(r[i] ** 2 - along**2, 0.0))
            height = local[i, 2] + along * d[2] / length
            reach = radius * np.sqrt(max(1.0 - (d[2] / length) ** 2, 0.0))
            cuts += [height - reach, height + reach]
            for k in range(j) if n <= TRIPLES else ():
                cuts += _meetings(local[[i, j, k]], r[[i, j, k]])
    cut = np.unique(cuts)
    return np.concatenate([cut[:1], cut[1:][np.diff(cut) > 1e-13]])


def _meetings(c: Array, r: Array) -> list[float]:
    """Heights of the points in which three spheres meet."""
    a, b = c[1] - c[0], c[2] - c[0]
    normal = np.cross(a, b)
    square = float(normal @ normal)
    if square < 1e-24:
        return []
    p = 0.5 * (a @ a + r[0] ** 2 - r[1] ** 2)
    q = 0.5 * (b @ b + r[0] ** 2 - r[2] ** 2)
    foot = (p * np.cross(b, normal) + q * np.cross(normal, a)) / square
    left = r[0] ** 2 - foot @ foot
    if left < 0.0:
        return []
    up = np.sqrt(left / square) * normal
    return [float(c[0, 2] + foot[2] + up[2]), float(c[0, 2] + foot[2] - up[2])]


def _discs(local: Array, r: Array, z: Array) -> Array:
    """Moments 1, x, y, xx, yy, xy (6, n_sections) of the unions of discs at the heights `z`."""
    n = len(r)
    square = r**2 - (z[:, None] - local[:, 2]) ** 2
    rho = np.sqrt(np.maximum(square, 0.0))
    d = local[None, :, :2] - local[:, None, :2]  # from disc i to disc j
    apart = np.linalg.norm(d, axis=2)[None]
    mine, other = rho[:, :, None], rho[:, None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = (apart**2 + mine**2 - other**2) / (2.0 * apart * mine)
    half = np.arccos(np.clip(cosine, -1.0, 1.0))
    half = np.where((other == 0.0) | (mine == 0.0), 0.0, half)
    # a disc inside another one is covered all round; of equal ones the first stays
    inside = (apart + mine <= other) & (other > 0.0)
    same = (apart == 0.0) & (mine == other)
    order = np.arange(n)
    half = np.where(inside & (~same | (order[:, None] > order)), np.pi, np.where(same, 0.0, half))
    half[:, order, order] = 0.0
    middle = np.arctan2(d[:, :, 1], d[:, :, 0])[None]
    begin = np.mod(middle - half, 2.0 * np.pi)
    end = begin + 2.0 * half
    # intervals that run beyond one turn are listed on both sides
    begin = np.concatenate([begin, begin - 2.0 * np.pi], axis=2)
    end = np.concatenate([end, end - 2.0 * np.pi], axis=2)
    rank = np.argsort(begin, axis=2)
    begin, end = np.take_along_axis(begin, rank, axis=2), np.take_along_axis(end, rank, axis=2)
    covered = np.maximum.accumulate(end, axis=2)
    start = np.concatenate([np.zeros((len(z), n, 1)), np.clip(covered, 0.0, 2.0 * np.pi)], axis=2)
    stop = np.concatenate([np.clip(begin, 0.0, 2.0 * np.pi), np.full((len(z), n, 1), 2.0 * np.pi)], axis=2)
    return _arcs(local, rho, start, np.maximum(stop, start), len(z))


def _arcs(local: Array, rho: Array, start: Array, stop: Array, n_sections: int) -> Array:
    """Moments of regions bounded by arcs: circle (section, disc), from the angle `start` to `stop`."""
    section, disc, gap = np.nonzero((stop > start) & (rho > 0.0)[:, :, None])
    node, weight = np.polynomial.legendre.leggauss(24)
    half = 0.5 * (stop - start)[section, disc, gap][:, None]
    angle = start[section, disc, gap][:, None] + half * (node + 1.0)
    radius = rho[section, disc][:, None]
    dx, dy = -radius * np.sin(angle), radius * np.cos(angle)
    x, y = local[disc, 0][:, None] + dy, local[disc, 1][:, None] - dx
    w = half * weight
    parts = [x * dy, 0.5 * x * x * dy, -0.5 * y * y * dx, x**3 * dy / 3.0, -(y**3) * dx / 3.0, 0.5 * x * x * y * dy]
    return np.array([np.bincount(section, (w * part).sum(axis=1), n_sections) for part in parts])
