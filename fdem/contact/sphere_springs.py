"""How stiff contacts of spheres are, now and in the collisions to come: what bounds the step and scales masses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from fdem.contact.spheres import SphereContacts

__all__ = ["ParticleSprings", "alone", "springs_of", "stiffest_alone"]

Array = NDArray[np.float64]

FALL = 0.01  # of its radius: every sphere is taken to be at least as fast as if it had fallen by that much
# a collision that presses in by more than this share of the radius is resolved: its stiffness counts so many times
# more, which makes ten steps of 0.8 times the limit of its duration
FELT, RESOLVED = 1e-5, 26.0


@dataclass
class ParticleSprings:
    """Springs of all candidate contacts, as if each were closed as far as its speed will close it.

    Attributes
    ----------
    gp : (n,) int array
        Gridpoints of the particles.
    block : (n,) int array
        Their blocks.
    centre : (n, 3) array
        Centres [m].
    radius : (n,)
        [m].
    alone : (n,)
        Stiffness against whatever a particle may meet at its own speed [N/m].
    a, b : (m,) int arrays
        Particles of a contact; b -1: a face.
    normal : (m, 3)
        From a to the other side.
    kn, kt : (m,)
        Normal and shear stiffness [N/m], twice where both sides move.
    turning : (m,)
        Stiffness against rolling and twisting [N m].
    face_gp, weight : (k, 3), (k, 3)
        Gridpoints of faces and weights, for the last k contacts.
    """

    gp: Any
    block: Any
    centre: Array
    radius: Array
    alone: Array
    a: Any
    b: Any
    normal: Array
    kn: Array
    kt: Array
    turning: Array
    face_gp: Any
    weight: Array

    def _sides(self) -> tuple[Any, Any]:
        """Particle and contact of all sides that are particles."""
        both = np.flatnonzero(self.b >= 0)
        return np.concatenate([self.a, self.b[both]]), np.concatenate([np.arange(len(self.a)), both])

    def at_gridpoints(self, chosen: slice) -> tuple[Array, Array]:
        """Stiffness (n, 3, 3) of the particles of `chosen` gridpoints: translations [N/m], rotations [N m]."""
        n = chosen.stop - chosen.start
        particle, contact = self._sides()
        row = self.gp[particle] - chosen.start
        mine = (row >= 0) & (row < n)
        row, contact, particle = row[mine], contact[mine], particle[mine]
        kn, kt, normal = self.kn[contact], self.kt[contact], self.normal[contact]
        across = kt * self.radius[particle] ** 2
        straight, turning = np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
        for i in range(3):
            for j in range(i + 1):
                dyad = normal[:, i] * normal[:, j]
                straight[:, i, j] = np.bincount(row, kt * (i == j) + (kn - kt) * dyad, n)
                turning[:, i, j] = np.bincount(row, (across + self.turning[contact]) * (i == j) - across * dyad, n)
                straight[:, j, i], turning[:, j, i] = straight[:, i, j], turning[:, i, j]
        # what is not in reach of anything yet
        there = (self.gp >= chosen.start) & (self.gp < chosen.stop)
        least = np.zeros(n)
        least[self.gp[there] - chosen.start] = self.alone[there]
        trace = np.trace(straight, axis1=1, axis2=2)
        straight += np.where(trace < least, least - trace, 0.0)[:, None, None] * np.eye(3)
        return straight, turning

    def on_blocks(self, place: Any, centre: Array) -> Array:
        """Stiffness (n, 6, 6) of blocks whose particles these are, about their centroids `centre` (n, 3) [m].

        `place` (n_blocks,) is the row of a block, -1: none of them.
        """
        result = np.zeros((len(centre), 6, 6))
        particle, contact = self._sides()
        row = place[self.block[particle]]
        mine = row >= 0
        row, particle, contact = row[mine], particle[mine], contact[mine]
        sign = np.where(self.b[contact] == particle, -1.0, 1.0)[:, None]
        normal = self.normal[contact]
        arm = self.centre[particle] + sign * self.radius[particle][:, None] * normal - centre[row]
        move = np.zeros((len(row), 3, 6))
        move[:, [0, 1, 2], [0, 1, 2]] = 1.0
        move[:, [0, 1, 2], [4, 5, 3]] = arm[:, [2, 0, 1]]
        move[:, [0, 1, 2], [5, 3, 4]] = -arm[:, [1, 2, 0]]
        along = np.einsum("ni,nij->nj", normal, move)
        kn, kt = self.kn[contact], self.kt[contact]
        spring = kt[:, None, None] * np.swapaxes(move, 1, 2) @ move
        spring += (kn - kt)[:, None, None] * along[:, :, None] * along[:, None, :]
        spring[:, [3, 4, 5], [3, 4, 5]] += self.turning[contact][:, None]
        np.add.at(result, row, spring)
        rows = place[self.block]
        least = np.zeros(len(centre))
        np.maximum.at(least, rows[rows >= 0], self.alone[rows >= 0])
        free = np.trace(result[:, :3, :3], axis1=1, axis2=2) < least
        result[free] += least[free, None, None] * np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        return result

    def on_faces(self, n_gp: int) -> Array:
        """Upper bound (n_gp,) of the stiffness that contacts with faces give gridpoints [N/m]."""
        first = len(self.a) - len(self.face_gp)
        k = np.maximum(self.kn[first:], self.kt[first:])
        w = np.abs(self.weight)
        share = k[:, None] * w.sum(axis=1, keepdims=True) * w
        return np.bincount(self.face_gp.ravel(), share.ravel(), n_gp).astype(np.float64)


def springs_of(c: SphereContacts, x: Array, xdot: Array) -> ParticleSprings:
    """Springs of all candidates in the positions `x` [m] with the gridpoint velocities `xdot` (n_gp, 3) [m/s]."""
    p, f = c.particles, c.faces
    first, second = c.pair_particles()
    a, b = x[p.gp[first]], x[p.gp[second]]
    apart = np.linalg.norm(b - a, axis=1)
    normal = (b - a) / apart[:, None]
    closing = np.einsum("ij,ij->i", xdot[p.gp[first]] - xdot[p.gp[second]], normal)
    overlap = p.radius[first] + p.radius[second] - apart
    inverse = c.inverse_mass[p.block[first]] + c.inverse_mass[p.block[second]]
    both = c.mobile[p.block[first]] & c.mobile[p.block[second]]
    kind, radius = c.kind, np.minimum(p.radius[first], p.radius[second])
    face_gp: Any = np.zeros((0, 3), np.int64)
    weight = np.zeros((0, 3))
    if len(f.face):
        count = np.diff(f.start)
        particle = c.order[np.repeat(f.at, count)]
        face_gp = f.ref[f.face]
        corners, centre = x[face_gp], x[p.gp[particle]]
        facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing /= -np.linalg.norm(facing, axis=1)[:, None]
        height = np.einsum("ij,ij->i", corners[:, 0] - centre, facing)
        weight = _in_face(corners, centre + height[:, None] * facing)
        moving = np.einsum("ij,ijk->ik", weight, xdot[face_gp])
        block = np.repeat(f.block, count)
        first, second = np.concatenate([first, particle]), np.concatenate([second, np.full(len(particle), -1)])
        normal = np.concatenate([normal, facing])
        closing = np.append(closing, np.einsum("ij,ij->i", xdot[p.gp[particle]] - moving, facing))
        overlap = np.append(overlap, p.radius[particle] - height)
        inverse = np.append(inverse, c.inverse_mass[p.block[particle]] + c.inverse_mass[block])
        both = np.append(both, c.mobile[p.block[particle]] & c.mobile[block])
        kind = np.append(kind, f.kind)
        radius = np.append(radius, p.radius[particle])
    rows = c.table.rows[kind]
    kn, kt = _stiffness(rows, overlap, np.maximum(closing, 0.0) ** 2, radius, c.gravity, inverse)
    twice = np.where(both, 2.0, 1.0)
    turning = twice * (kn * rows[:, 9] ** 2 + kt * rows[:, 10] ** 2)
    return ParticleSprings(
        p.gp, p.block, x[p.gp], p.radius, alone(c, xdot), first, second, normal, twice * kn, twice * kt, turning,
        face_gp, weight,
    )  # fmt: skip


def alone(c: SphereContacts, xdot: Array) -> Array:
    """Normal stiffness (n,) [N/m] of particles that hit something fixed and hard at their own speed."""
    p = c.particles
    square = np.einsum("ij,ij->i", xdot[p.gp], xdot[p.gp])
    return _stiffness(c.hardest, np.zeros(len(p)), square, p.radius, c.gravity, c.inverse_mass[p.block])[0]


def stiffest_alone(c: SphereContacts, xdot: Array) -> float:
    """Largest of `alone` over the mass [1/s^2]: only the fastest of particles that are alike is looked at."""
    v = xdot[c.particles.gp]
    square = np.zeros(len(c.alike[0]))
    np.maximum.at(square, c.alike[1], np.einsum("ij,ij->i", v, v))
    one, none = c.alike[0], np.zeros(len(square))
    inverse = c.inverse_mass[c.particles.block[one]]
    k = _stiffness(c.hardest[one], none, square, c.particles.radius[one], c.gravity, inverse)[0]
    return float((k * inverse).max(initial=0.0))


def _stiffness(
    rows: Array, overlap: Array, square: Array, radius: Array, gravity: float, inverse: Array
) -> tuple[Array, Array]:
    """Tangent stiffness at the largest overlap that contacts reach, of their overlap and the square of their speed.

    A Hertz contact of reduced mass m that closes at v from the overlap d goes to ``(d^5/2 + 5 m v^2 / (4 K))^(2/5)``.
    """
    hertz = rows[:, 5] > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        softness = np.where(inverse > 0.0, 1.0 / (rows[:, 0] * inverse), 0.0)
    pressed = np.where(hertz, (1.25 * softness * square) ** 0.4, np.sqrt(softness * square))
    energy = 1.25 * softness * (square + 2.0 * FALL * gravity * radius)
    root = np.where(hertz, (np.maximum(overlap, 0.0) ** 2.5 + energy) ** 0.2, 1.0)
    # a dashpot across, of the ratio z, lags half a step: the stable step w has ``w^2 (1 + z w) = 4`` instead of 4
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = 0.5 * rows[:, 3] * np.sqrt(3.5 * rows[:, 0] / rows[:, 1])
    ratio = np.where(ratio > 0.0, ratio, 0.0)
    # not where the spheres are pressed together more than that already
    impact = (pressed > FELT * radius) & (pressed > 0.5 * overlap)
    normal = rows[:, 0] * root * np.where(hertz, 1.5, 1.0) * np.where(impact, RESOLVED, 1.0)
    return normal, rows[:, 1] * root * (1.0 + 2.0 * ratio)


def _in_face(corners: Array, point: Array) -> Array:
    """Barycentric weights (n, 3) of points in the planes of triangles (n, 3, 3).

    No weight is larger than 1: a face's reference triangle is its largest, and points beyond the face do not count.
    """
    u, v, s = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], point - corners[:, 0]
    uu, uv, vv, su, sv = (np.einsum("ij,ij->i", *pair) for pair in ((u, u), (u, v), (v, v), (s, u), (s, v)))
    det = uu * vv - uv * uv
    weight = np.column_stack([np.zeros(len(u)), (vv * su - uv * sv) / det, (uu * sv - uv * su) / det])
    weight[:, 0] = 1.0 - weight[:, 1] - weight[:, 2]
    return np.clip(weight, -1.0, 1.0)
