"""Contacts of spheres: with each other, and with the faces of all other blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact.facets import FaceContacts, Facets
from fdem.contact.particles import Particles, SphereTable
from fdem.contact.sphere_springs import ParticleSprings, springs_of, stiffest_alone
from fdem.errors import OverlapError, SceneError
from fdem.kernels import couples, spheres
from fdem.kernels import facets as face_kernels
from fdem.kernels import particles as kernels

__all__ = ["SphereContacts"]

Array = NDArray[np.float64]

SKIN = 0.14  # of the radius: pairs are looked for that much further, and again when half of it is used up
TOUCH = 1.0 / (1.0 + 0.5 * SKIN)  # of the reach, with the skin: what touches when pairs are looked for
GROWN = 1.1  # growth of stiffness, in squared frequency, after which the step is found again
UNSEEN = 0.1  # of the radius per step: far below, the stiffness that an impact will have is known from its speed
FAST = 0.25  # of the radius: motion in a step from which on a sphere could pass something


class SphereContacts:
    """All contacts that have a sphere in them.

    Parameters
    ----------
    particles : Particles
    x : (n_gp, 3) array
        Positions at compile [m].
    facets : Facets or None
        Faces of the other blocks.
    table : SphereTable
        Constants of laws; sides are the particles, then the faces of every block.
    assign : callable
        ``assign(block_a, block_b, tag_a, tag_b, points) -> rule``, int arrays; tags are -1 for spheres.
    mobile : (n_blocks,) bool array
        Which blocks can move.
    inverse_mass : (n_blocks,) array
        0 where it cannot move [1/kg].
    gravity : float
        [m/s^2].
    names : sequence of str
        Block names for messages.

    Raises
    ------
    SceneError
        Two spheres, or a sphere and a face, overlap by more than half the (smaller) radius; names them.

    Notes
    -----
    The same life as `Contacts`: `forces` works on trial memory and may be repeated, `commit` makes the last trial the
    history, `update` follows the motion and looks for pairs again when it is due.
    """

    def __init__(
        self,
        particles: Particles,
        x: Array,
        *,
        facets: Facets | None,
        table: SphereTable,
        assign: Callable[..., Any],
        mobile: Any,
        inverse_mass: Array,
        gravity: float,
        names: Sequence[str],
    ) -> None:
        self.particles, self.facets, self.table, self.assign = particles, facets, table, assign
        self.mobile, self.names = np.asarray(mobile, dtype=bool), names
        self.n_blocks = len(self.mobile)
        n = len(particles)
        self.inverse_mass, self.gravity = inverse_mass, gravity
        self.hardest = table.hardest(slice(0, n))
        self.alike = table.alike(slice(0, n))
        self._moves = np.ascontiguousarray(self.mobile[particles.block])
        self.allowed = 0.5 * SKIN * particles.radius
        self._pad = float(np.median(self.allowed)) if n else 0.0
        self.turn = np.zeros((n, 3))
        self.place, self.motion, self.force = np.zeros((n, 4)), np.zeros((n, 8)), np.zeros((n, 6))
        self.work = np.zeros(2)
        self.n_detections = 0
        # largest stiffness over reduced mass of a contact: in the last forces, and when the step was found [1/s^2]
        self.stiffest, self._known = 0.0, 0.0
        self._trial, self._packed = False, False  # packed: `update` has seen to `place` and `motion`
        self._dt = 0.0
        self.order = np.zeros(0, np.int64)
        self.start, self.partner = np.zeros(1, np.uint32), np.zeros(0, np.uint32)
        self._couples = any(law.rolling > 0.0 or law.twisting > 0.0 for law in table.laws)
        self.memory, self.held, self.rule = np.zeros((0, 5)), np.zeros((0, 6)), np.zeros(0, np.int32)
        self.faces = FaceContacts.group(np.zeros(0, int), np.zeros(0, int), np.zeros(1, np.int32), self._couples)
        self.detect(x)
        try:
            self.forces(x, x, 0.0, np.zeros_like(x), np.zeros(int(particles.spin.max(initial=0)) + 3))
        except OverlapError as error:
            raise SceneError(str(error)) from None
        self._trial = False

    def detect(self, x: Array, motion: Array | None = None) -> None:
        """Look for near pairs in the positions `x`, of spheres that moved by `motion` (n,) [m] further than usual."""
        p = self.particles
        n = len(p)
        reach = p.radius + self.allowed if motion is None else p.radius + self.allowed + motion
        centres = x[p.gp]
        level, cell, origin = np.zeros(n, np.int64), np.zeros((n, 3), np.int64), np.zeros(3)
        size = kernels.cells(centres, reach, level, cell, origin)
        key = np.zeros(n, np.int64)
        if kernels.sort_keys(level, cell, key):
            order = np.sort(key) % max(n, 1)
        else:
            order = np.lexsort((cell[:, 2], cell[:, 1], cell[:, 0], -level))
        near = (centres[order], reach[order], p.block[order], self._moves[order], level[order], cell[order])
        grid = kernels.tabulate(*near[4:])
        start, partner = kernels.near_pairs(*near, *grid, TOUCH)
        before, at_old = self._shear_energy(), self._earlier(order)
        memory, source = np.zeros((len(partner), 5)), np.zeros(len(partner), np.int64)
        kernels.carry_pairs(self.start, self.partner, self.memory, at_old, start, partner, memory, source)
        held = np.zeros((len(partner) if self._couples else 0, 6))
        if self._couples:
            kernels.carry_pairs(self.start, self.partner, self.held, at_old, start, partner, held, source)
        rule = np.where(source >= 0, self.rule[source], -1) if len(self.rule) else np.full(len(partner), -1)
        self.order, self.start, self.partner, self.memory, self.held = order, start, partner, memory, held
        self.rule = rule.astype(np.int32)
        self._assign_pairs(x, np.flatnonzero(rule < 0))
        self._detect_faces(x, near, grid, origin, size, at_old)
        self.x_ref = centres
        self.n_detections += 1
        self._prepare(x)
        self.work[0] += before - self._shear_energy()

    def touching(self) -> NDArray[np.int64]:
        """Blocks (n, 2) of contacts that are listed, open ones included."""
        p, f = self.particles, self.faces
        first, second = self.pair_particles()
        pairs = np.column_stack([p.block[first], p.block[second]]).astype(np.int64)
        return np.concatenate([pairs, np.column_stack([p.block[self.order[f.at]], f.block])]).astype(np.int64)

    def places(self) -> NDArray[np.int64]:
        """Packed place of every particle."""
        place = np.empty(len(self.order), np.int64)
        place[self.order] = np.arange(len(self.order))
        return place

    def _earlier(self, order: Any) -> NDArray[np.int64]:
        """Place in the list that is there of the particles in `order`; -1: not in it."""
        return self.places()[order] if len(self.order) else np.full(len(order), -1, np.int64)

    def _assign_pairs(self, x: Array, rows: Any) -> None:
        """Rules of the pairs in `rows`."""
        if not len(rows):
            return
        first, second = self.pair_particles(rows)
        p = self.particles
        a, b = x[p.gp[first]], x[p.gp[second]]
        share = (p.radius[first] / (p.radius[first] + p.radius[second]))[:, None]
        none = np.full(len(rows), -1, np.int32)
        self.rule[rows] = self.assign(p.block[first], p.block[second], none, none, a + share * (b - a))

    def counts(self) -> NDArray[np.int64]:
        """Number of pairs listed under every packed particle."""
        return self.start[1:].astype(np.int64) - self.start[:-1]

    def pair_particles(self, rows: Any = None) -> tuple[Any, Any]:
        """Both particles of pairs (all, or some `rows`)."""
        first = np.repeat(self.order, self.counts())
        second = self.order[self.partner]
        return (first, second) if rows is None else (first[rows], second[rows])

    def _detect_faces(self, x: Array, near: Any, grid: Any, origin: Array, size: float, at_old: Any) -> None:
        """Candidate faces of every sphere, with rules and history."""
        if self.facets is None:
            return
        f = self.facets
        f.place(x)
        who, which = kernels.near_faces(
            f.lower, f.upper, f.point, f.normal, self._pad, f.block, f.mobile, *near, *grid, origin, size
        )
        old, faces = self.faces, FaceContacts.group(who, which, f.block, self._couples)
        faces.inherit(old, at_old, self.n_blocks)
        if len(faces.face):
            at = np.repeat(faces.at, np.diff(faces.start))
            particle, face = self.order[at], faces.used[faces.face]
            none = np.full(len(at), -1, np.int32)
            block = self.particles.block[particle]
            faces.rule = np.asarray(
                self.assign(block, f.block[face], none, f.surfaces.tag[face], x[self.particles.gp[particle]])
            )
        self.faces = faces
        self.face_ref = x[f.moving_gp]

    def _prepare(self, x: Array) -> None:
        """Rows of the table, and what `forces` writes."""
        p, n = self.particles, len(self.particles)
        first, second = self.pair_particles()
        faces = self.faces
        at = np.repeat(faces.at, np.diff(faces.start))
        kinds = self.table.kinds(
            np.concatenate([self.rule, faces.rule]),
            np.concatenate([first, self.order[at]]),
            np.concatenate([second, n + np.repeat(faces.block, np.diff(faces.start))]),
        )
        self.at = self.places()
        self._gp, self._spin = p.gp[self.order].astype(np.uint32), p.spin[self.order]
        self._before = np.column_stack([self.x_ref[self.order], self.allowed[self.order] ** 2])
        self.kind, faces.kind = kinds[: len(first)].copy(), kinds[len(first) :].copy()
        self._memory, self._held = np.zeros_like(self.memory), np.zeros_like(self.held)
        # couples need the normal forces
        self._record = np.zeros((len(self.held), 4))
        self.motion.fill(0.0)
        self.place[:, :3], self.place[:, 3] = x[p.gp[self.order]], p.radius[self.order]
        self.out, self._face_out, self._couple_out = np.zeros(5), np.zeros(5), np.zeros(1)
        if self.facets is not None:
            faces.prepare(self.facets, x)
        self._trial = self._packed = False

    def update(self, x: Array, x_old: Array, v: Array, dt: float) -> bool:
        """Follow a step of `dt` [s] with the velocities `v`, and look for pairs again if due.

        Returns True if they were, or if contacts are stiffer than `stiffened` last knew.

        Raises
        ------
        OverlapError
            A sphere went by more than half its radius in a step in which it met something.
        """
        p = self.particles
        due, fast = kernels.follow(
            self.order, self._gp, self._spin, x, x_old, self._before, v, dt, self.turn, self.place, self.motion
        )  # fmt: skip
        if not due and self.facets is not None:
            due = kernels.strayed(self.facets.moving_gp, x, self.face_ref, self._pad)
        if not due:
            self._packed = True
            return self.stiffest > self._known
        moved = np.linalg.norm(x[p.gp] - x_old[p.gp], axis=1) if fast > FAST else None
        self.detect(x, moved)
        if moved is not None:
            self._refuse_passing(x, x_old)
        return True

    def _refuse_passing(self, x: Array, x_old: Array) -> None:
        p, faces = self.particles, self.faces
        kernels.pack(self.order, self._gp, x, x_old, self.turn, self.place, self.motion)
        pair = kernels.passed(self.start, self.partner, self.place, self.motion)
        group = -1
        if self.facets is not None:
            group = face_kernels.swept(
                faces.at, faces.start, faces.face, self.place, self.motion, faces.corner_start, faces.corner_x,
                faces.normal,
            )  # fmt: skip
        if pair < 0 and group < 0:
            return
        if pair >= 0:
            a, b = (int(p.block[k[int(pair)]]) for k in self.pair_particles())
        else:
            a, b = int(p.block[self.order[faces.at[group]]]), int(faces.block[group])
        raise OverlapError(
            f"blocks {self.names[a]!r} and {self.names[b]!r} meet in a step in which they move by more than half a "
            "radius: the step is too large"
        )

    # ------------------------------------------------------------------ forces

    def forces(self, x: Array, x_old: Array, dt: float, f_gp: Array, f: Array) -> None:
        """Add the contact forces on gridpoints, and moments on what turns; starts from the committed memory every time.

        Parameters
        ----------
        x, x_old : (n_gp, 3) array
            Positions now and at the last commit [m].
        dt : float
            Time between them [s]; 0: no dashpots.
        f_gp : (n_gp, 3) array
            Forces [N], added to in place.
        f : (n_dofs,) array
            Generalised forces; moments [N m] are added.

        Raises
        ------
        OverlapError
            Two spheres overlap by more than half the smaller radius, or a sphere a face by half of it; names them.
        """
        faces, self._dt = self.faces, dt
        if not self._packed:
            kernels.pack(self.order, self._gp, x, x_old, self.turn, self.place, self.motion)
        self._packed = False
        self._pair_forces(self._record)
        self._face_out[:], self._couple_out[0] = 0.0, 0.0
        if len(faces.at):
            faces.touch(self.place, self.motion, x, x_old)
            spheres.face_forces(
                faces.slot_at, faces.active, faces.geometry, faces.slot_kind, self.table.rows, faces.memory,
                faces.source, faces.trial, dt, self.force, faces.push, faces.record, self._face_out,
            )  # fmt: skip
            faces.spread(f_gp)
        if self._couples:
            self._add_couples(x, f_gp)
        kernels.unpack(self._gp, self._spin, self.force, f_gp, f)
        self.stiffest = max(float(self.out[4]), float(self._face_out[4]))
        self._trial = True
        if self.out[3] > 0.0 or self._face_out[3] > 0.0:
            raise OverlapError(self._too_deep())

    def _add_couples(self, x: Array, f_gp: Array) -> None:
        """Rolling and twisting resistance; after the forces, whose normal forces limit it."""
        faces = self.faces
        couples.pair_couples(
            self.place, self.motion, self.start, self.partner, self.kind, self.table.rows, self.memory, self._memory,
            self._record, self.held, self._held, self.force, self._couple_out,
        )  # fmt: skip
        if len(faces.at):
            couples.face_couples(
                faces.slot_at, faces.active, faces.geometry, faces.slot_kind, self.table.rows, faces.memory,
                faces.source, faces.trial, faces.record, faces.held, faces.trial_held, self.force, faces.couple,
                self._couple_out,
            )  # fmt: skip
            couples.spread_couples(
                faces.active, faces.candidate, faces.face, faces.ref, faces.couple, x, f_gp
            )  # fmt: skip

    def _pair_forces(self, record: Array) -> None:
        self.out[:] = 0.0
        spheres.pair_forces(
            self.place, self.motion, self.start, self.partner, self.kind, self.table.rows, self.memory, self._memory,
            self._dt, self.force, record, self.out,
        )  # fmt: skip

    def recorded(self) -> Array:
        """Normal force and shear force on the second sphere (n_pairs, 4) [N] of the last forces."""
        record = np.zeros((len(self.partner), 4))
        if self._trial:
            self._pair_forces(record)
        return record

    def trial_roots(self) -> Array:
        """Positive for pairs (n_pairs,) that touch in the last forces."""
        return self._memory[:, 3] if self._trial else self.memory[:, 3]

    def _too_deep(self) -> str:
        p = self.particles
        if self.out[3] > 0.0:
            a, b = (int(k[int(self.out[3]) - 1]) for k in self.pair_particles())
            first, second = p.block[a], p.block[b]
        else:
            row = int(self._face_out[3]) - 1
            group = int(np.searchsorted(self.faces.slot_start, row, side="right")) - 1
            first, second = p.block[self.order[self.faces.at[group]]], self.faces.block[group]
        return (
            f"blocks {self.names[first]!r} and {self.names[second]!r} overlap by more than half a radius; is the joint "
            "too soft, the step too large, or a sphere inside something?"
        )

    def commit(self) -> None:
        """Make the last trial the history, and add its dissipation to `work`."""
        self.turn.fill(0.0)
        if not self._trial:
            return
        self.work += self._trial_work()
        self.memory, self._memory = self._memory, self.memory
        self.held, self._held = self._held, self.held
        if len(self.faces.at):
            self.faces.commit()
        self._trial = False

    def _trial_work(self) -> Array:
        work: Array = self.out[:2] + self._face_out[:2]
        work[0] += self._couple_out[0]
        if len(self.faces.at):
            work[0] += self.faces.lost[0]
        return work

    # ------------------------------------------------------------------ stiffness

    def springs(self, x: Array, xdot: Array) -> ParticleSprings:
        """Springs of all contacts, present and to come, for the velocities `xdot` (n_gp, 3) [m/s]."""
        return springs_of(self, x, xdot)

    def stiffened(self, xdot: Array) -> bool:
        """Whether contacts got stiffer since last asked, or much softer; those to come at `xdot` included."""
        now = max(self.stiffest, stiffest_alone(self, xdot))
        if 0.2 * self._known <= now <= self._known:
            return False
        self._known = GROWN * now
        return True

    def unseen_motion(self, xdot: Array) -> float:
        """Longest step [s] in which no sphere moves by more than a tenth of its radius; infinite at rest."""
        speed = np.sqrt(np.einsum("ij,ij->i", xdot[self.particles.gp], xdot[self.particles.gp]))
        with np.errstate(divide="ignore"):
            return float((UNSEEN * self.particles.radius / speed).min(initial=np.inf))

    def add_pushes(self, pushes: Array) -> None:
        """Add the sum of normal forces on every sphere to `pushes` (n_gp,) [N]: on its one gridpoint they cancel."""
        first, second = self.pair_particles()
        normal, gp = self.recorded()[:, 0], self.particles.gp
        np.add.at(pushes, gp[first], normal)
        np.add.at(pushes, gp[second], normal)
        if len(self.faces.at):
            np.add.at(pushes, gp[self.order[self.faces.slot_at]], self.faces.record[:, 0])

    # ------------------------------------------------------------------ energy

    def _shear_energy(self) -> float:
        """Energy of all shear, rolling and twisting springs in the committed history [J]."""
        if not len(self.memory) and not len(self.faces.memory):
            return 0.0
        energy = float(spheres.stored(np.zeros(len(self.kind)), self.kind, self.table.rows, self.memory)[1])
        m = self.faces.memory
        energy += 0.5 * float((m[:, 8] * m[:, 3] * (m[:, :3] ** 2).sum(axis=1)).sum())
        return energy + couples.stored_couples(self.memory, self.held) + couples.stored_couples(m, self.faces.held)

    def present(self) -> tuple[float, float, float]:
        """Stored energy, friction and damping work [J] of the last forces, committed or not."""
        f, trial = self.faces, self._trial
        work = self.work + self._trial_work() if trial else self.work
        memory, held = (self._memory, self._held) if trial else (self.memory, self.held)
        energy = sum(spheres.stored(self.overlaps(), self.kind, self.table.rows, memory))
        energy += couples.stored_couples(memory, held)
        if len(f.at):
            memory, held = (f.trial, f.trial_held) if trial else (f.memory, f.held)
            energy += sum(spheres.stored(f.geometry[:, 3], f.slot_kind, self.table.rows, memory))
            energy += couples.stored_couples(memory, held)
        return float(energy), float(work[0]), float(work[1])

    def overlaps(self) -> Array:
        """Overlap of all pairs in the positions of the last forces (m,) [m]."""
        first = np.repeat(np.arange(len(self.order)), self.counts())
        a, b = self.place[first], self.place[self.partner]
        overlap: Array = a[:, 3] + b[:, 3] - np.linalg.norm(b[:, :3] - a[:, :3], axis=1)
        return overlap
