"""Contacts: every pair of blocks, every law, one table of contact points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.contact import corners, response, startup, table
from fdem.contact.broad import REACH, block_skins, candidate_pairs, common_pairs, master_first
from fdem.contact.history import inherit_history, inherit_laws, known_offsets
from fdem.contact.laws import LawTable, stiffness_of
from fdem.contact.narrow import Cut, Ghosts, Patches, cut_pairs
from fdem.contact.surface import BlockSurface, FaceGeometry, Surfaces
from fdem.contact.wear import closing, drifted_pairs, least_volumes, too_deep, worn_pairs
from fdem.errors import OverlapError, SceneError
from fdem.kernels import footprints, joints, memory, upkeep
from fdem.kernels import patches as kernels
from fdem.kernels import response as responses

__all__ = ["Contacts", "LawTable"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]


class Contacts:
    """All contacts of a model.

    Parameters
    ----------
    blocks : sequence of BlockSurface
    x : (n_gp, 3) array
        Positions at compile [m].
    gp_mass : (n_gp,) array
        Mass of every gridpoint; for blocks that move affinely the block's mass [kg].
    laws : sequence of LawTable
    assign : callable
        ``assign(block_s, block_m, tag_s, tag_m, points) -> (law, prop[, joint])``, int arrays; law -1: no contact.
        Tags are those of the two faces (-1: none).
    may_touch : callable, optional
        ``may_touch(block_a, block_b) -> mask``.
    gap_tolerance : float, optional
        [m]; gaps and overlaps of parallel faces below it are taken as zero; None: 1e-3 of the smaller block; 0: off.
    names : sequence of str, optional
        Block names for messages.
    prune : float
        Patches smaller than this part of the pair's largest are dropped; 0: none.
    clip_always : bool
        Cut all patches anew in every `update` (energy-exact impacts).
    numerical : bool
        Some stiffness was chosen by the code: closures are to be watched.

    Raises
    ------
    SceneError
        Two blocks overlap by more than the gap tolerance; names them.

    Notes
    -----
    A row's relative motion is ``sum_k w_k x[gp_k]``: + on the slave, - on the master. Rows 3 i .. 3 i + 2 belong to
    patch i. `forces` works on trial memory and may be repeated; `commit` makes the last trial the history.
    """

    def __init__(
        self,
        blocks: Sequence[BlockSurface],
        x: Array,
        *,
        gp_mass: Array,
        laws: Sequence[LawTable],
        assign: Callable[..., Any],
        may_touch: Callable[..., Any] | None = None,
        gap_tolerance: float | None = None,
        names: Sequence[str] | None = None,
        prune: float = 1e-4,
        clip_always: bool = False,
        numerical: bool = False,
    ) -> None:
        self.surfaces = Surfaces.build(blocks, x)
        s = self.surfaces
        self.laws, self.assign, self.may_touch = tuple(laws), assign, may_touch
        self.names = list(names) if names is not None else [str(i) for i in range(s.n_blocks)]
        self.prune, self.clip_always, self.gap_tolerance = prune, clip_always, gap_tolerance
        self.numerical = numerical
        self.n_memory = max([6] + [law.memory for law in laws])
        self._geometry = FaceGeometry.of(s)
        self._skins = block_skins(s)
        self._mobile_gp = np.zeros(len(x), dtype=bool)
        for b in blocks:
            self._mobile_gp[b.gp[0] : b.gp[1]] = not b.fixed
        with np.errstate(divide="ignore"):
            self._inverse_gp = np.where(self._mobile_gp, 1.0 / np.asarray(gp_mass, dtype=float), 0.0)
            inverse_block = np.where(np.isfinite(s.mass), 1.0 / s.mass, 0.0)
        self._inverse_block = np.where((s.whole == 1) | (s.fixed == 1), inverse_block, -1.0)
        self.work = np.zeros(2)
        self.n_detections, self.n_cuts = 0, 0
        self._stored: float | None = 0.0
        self._curved = [k for k, law in enumerate(self.laws) if law.curved]
        self.curved = bool(self._curved)  # whether some joint stiffens as it closes
        self.stiffer = False  # whether joints have changed so that the stable step must be found again
        self._trial = False  # whether the working arrays hold a trial that is not committed
        self._filled = False  # whether they hold anything: not between a cut and the next forces
        self.x_ref, self.x_check = x.copy(), x.copy()
        self.pairs = np.zeros((0, 2), np.int32)
        self.patches = Patches.none(self.n_memory)
        self.ghosts = Ghosts()
        self.report: dict[str, float] = {}
        self._start(x)

    def _start(self, x: Array) -> None:
        """First detection: reference gaps, intact flags, refusal of overlapping blocks."""
        self.pairs = candidate_pairs(self.surfaces, x, self._skins, self.may_touch)
        self._orient()
        cut = self._cut(np.arange(len(self.pairs), dtype=np.int32), x, self.patches, raise_deep=SceneError)
        self.report = startup.close_gaps(self, cut)
        self._install(cut.patches, cut.ghosts, x, np.arange(len(cut.patches)))
        self.n_detections = 1

    def _orient(self) -> None:
        self.slave, self.master = master_first(self.surfaces, self.pairs)
        self._window = REACH * (self._skins[self.slave] + self._skins[self.master])
        if self.gap_tolerance is not None:
            self._window = np.maximum(self._window, self.gap_tolerance)
        self._least = np.zeros(len(self.pairs))  # overlap that matters beside the other contacts of the blocks [m3]

    def pair_names(self, pair: int) -> str:
        """Names of the two blocks of a pair, for messages."""
        a, b = sorted((int(self.slave[pair]), int(self.master[pair])))
        return f"{self.names[a]!r} and {self.names[b]!r}"

    def _cut(self, which: Ints, x: Array, old: Patches, raise_deep: type[Exception]) -> Cut:
        """Cut pairs anew; laws and flags set, history not yet."""
        s = self.surfaces
        cut = cut_pairs(
            s, self._geometry, which, self.slave, self.master, self._window, self._least, x,
            known_offsets(old, s.n_faces, self._geometry), self.prune, self.n_memory,
        )  # fmt: skip
        if len(cut.too_deep):
            raise raise_deep(
                f"blocks {self.pair_names(cut.too_deep[0])} overlap deeper than their surfaces describe (a quarter of "
                "the local thickness); is the joint too soft, the step too large, or a block inside another?"
            )
        p = cut.patches
        fresh = np.flatnonzero(inherit_laws(old, p, s.n_faces))
        if len(fresh):
            answer = self.assign(
                self.slave[p.pair[fresh]],
                self.master[p.pair[fresh]],
                s.tag[p.face_s[fresh]],
                s.tag[p.face_m[fresh]],
                cut.centre[fresh],
            )
            p.law[fresh], p.prop[fresh] = answer[0], answer[1]
            p.joint[fresh] = answer[2] if len(answer) > 2 else answer[1]
        keep = np.flatnonzero(p.law >= 0)
        if len(keep) < len(p):
            names = ("area", "closed", "align", "depth", "plane_depth", "centre")
            cut = Cut(p.take(keep), cut.ghosts, cut.too_deep, *(getattr(cut, n)[keep] for n in names))
            p = cut.patches
        for k, law in enumerate(self.laws):
            mine = p.law == k
            facing = (p.flags & kernels.FACING) > 0
            p.flags[mine & facing] |= (law.tensile[p.prop[mine & facing]] * kernels.WHOLE).astype(np.uint8)
            p.flags[mine & facing] |= (law.dilates[p.prop[mine & facing]] * kernels.DILATES).astype(np.uint8)
        self.n_cuts += len(which)
        return cut

    def update(self, x: Array) -> bool:
        """Detect again and cut patches anew where motion makes it due; True if patches changed.

        Parameters
        ----------
        x : (n_gp, 3) array
            Positions [m].

        Raises
        ------
        OverlapError
            Blocks overlap deeper than a quarter of the local thickness; names the pair.
        """
        s = self.surfaces
        if self.clip_always:
            return self._redo(x, np.ones(s.n_blocks, bool))
        due = np.zeros(len(self.pairs), np.uint8)
        if not (self._ajar and closing(self, x, due)) and not upkeep.moved(
            s.movers, s.surface_gp, s.surface_start, x, self.x_check, self._tolerance
        ):
            return False
        motion = np.zeros(s.n_blocks)
        upkeep.block_motion(s.movers, s.surface_gp, s.surface_start, x, self.x_ref, motion)
        if (motion > 0.5 * self._skins).any():
            return self._redo(x, motion > 0.25 * self._skins)
        self.x_check[:] = x
        worn = worn_pairs(self, x)
        if not worn.any():
            return False
        self._least = least_volumes(self)
        self._replace(np.flatnonzero(worn).astype(np.int32), x, response.slip_energies(self))
        return True

    def _redo(self, x: Array, refreshed: Any) -> bool:
        """New broad phase; pairs of refreshed blocks, new pairs and worn ones are cut anew."""
        self.energy()
        corners.absorb(self)
        worn, drifted = worn_pairs(self, x), drifted_pairs(self, x)
        old_pairs, least = self.pairs, least_volumes(self)
        self.pairs = candidate_pairs(self.surfaces, x, self._skins, self.may_touch)
        at_old, at_new, new_index = common_pairs(old_pairs, self.pairs)
        due = refreshed[self.pairs[:, 0]] | refreshed[self.pairs[:, 1]]
        known = np.zeros(len(due), bool)
        known[at_new] = True
        due[at_new] &= drifted[at_old]
        due |= ~known
        due[at_new] |= worn[at_old] > 0
        self._orient()
        self._least[at_new] = least[at_old]
        there = new_index[self.patches.pair] >= 0
        slip = response.slip_energies(self)
        self._lose_slip(float(slip[~there].sum()))
        slip = slip[there]
        self.patches = self.patches.take(np.flatnonzero(there))
        self.patches.pair = new_index[self.patches.pair]
        self.ghosts = self.ghosts.without(new_index < 0)
        self.ghosts.pair = new_index[self.ghosts.pair]
        ids = self.surfaces.surface_gp[np.repeat(refreshed, np.diff(self.surfaces.surface_start))]
        self.x_ref[ids] = x[ids]
        self.n_detections += 1
        self._replace(np.flatnonzero(due).astype(np.int32), x, slip)
        return True

    def _lose_slip(self, energy: float) -> None:
        """Count elastic slip energy that goes with its patches as dissipated [J] (negative: it came with new ones)."""
        if self._filled:
            self.work[0] += energy
            self._stored = self.energy() - energy

    def _replace(self, which: Ints, x: Array, slip: Array) -> None:
        """Cut the pairs `which` anew and merge the result with the patches of all others.

        `slip` (n_patches,) [J] is their elastic slip energy: what the new patches do not take over was dissipated.
        """
        self.energy()  # the arrays it reads are about to go
        corners.absorb(self)
        mask = np.zeros(len(self.pairs), bool)
        mask[which] = True
        touched = mask[self.patches.pair]
        ghosts = self.ghosts.without(mask)
        kept = np.flatnonzero(~touched)
        old = self.patches.take(np.flatnonzero(touched)) if len(kept) else self.patches
        merged, ids = self.patches, kept
        if len(which):
            cut = self._cut(which, x, old, raise_deep=OverlapError)
            new = cut.patches
            area = inherit_history(self.surfaces, old, new, x)
            taken = memory.slip_energy(area, new.memory_old, stiffness_of(self.laws, new)[1], new.active_old)
            taken += float(response.held_energy(self.laws, new).sum())
            self._lose_slip(float(slip[touched].sum()) - taken)
            merged, ids = cut.patches, np.arange(len(cut.patches))
            if len(kept):
                merged, ids = Patches.join(self.patches, merged), np.concatenate([kept, len(self.patches) + ids])
            ghosts = Ghosts.join(ghosts, cut.ghosts)
        self._install(merged, ghosts, x, ids)

    def _install(self, p: Patches, ghosts: Ghosts, x: Array, ids: Any) -> None:
        """Sort the patches `ids` of `p` and allocate what `forces` writes."""
        ids = ids[self._order(p.face_s[ids], p.face_m[ids], p.pair[ids], p.law[ids])]
        as_they_are = len(ids) == len(p) and bool((ids == np.arange(len(ids))).all())
        self.patches = p if as_they_are else p.take(ids)
        self.ghosts = ghosts
        self.x_check[:] = x
        self._prepare()

    def _order(self, face_s: Ints, face_m: Ints, pair: Ints, law: Ints) -> Any:
        """Order in which patches are worked on."""
        return np.lexsort((face_s, face_m, pair, law))

    def _prepare(self) -> None:
        p, s = self.patches, self.surfaces
        n = len(p)
        self._trial, self._filled = False, False
        self._law_start = np.searchsorted(p.law, np.arange(len(self.laws) + 1)).tolist()
        self._thick = s.has_behind[p.face_m]
        self._inverse = np.column_stack(
            [self._inverse_block[self.slave[p.pair]], self._inverse_block[self.master[p.pair]]]
        )
        present = [law for k, law in enumerate(self.laws) if self._law_start[k + 1] > self._law_start[k]]
        self._damped, self._armed = any(law.damped for law in present), any(law.arms for law in present)
        self._kn, self._ks = stiffness_of(self.laws, p)
        self._brittle = response.brittle_of(self.laws, p)
        self._fragile = bool(self._brittle.any())
        self._bound = self._kn.copy()
        self._corner = corners.pair_corners(self)
        self._points, self._active = p.points_old.copy(), np.zeros(n, np.uint8)
        self._memory_start = np.zeros((3 * n, self.n_memory))
        self._memory = np.zeros((3 * n, self.n_memory))
        self._w, self._gap, self._area = np.zeros((3 * n, 7)), np.zeros(3 * n), np.zeros(3 * n)
        self._align, self._normal, self._push = np.zeros(3 * n), np.zeros((3 * n, 3)), np.zeros((n, 3))
        self._slip, self._mass, self._facing = np.zeros((3 * n, 3)), np.zeros(3 * n), np.zeros(n)
        self._cluster = p.clusters()
        self._cluster_normal = np.zeros((int(self._cluster.max(initial=-1)) + 1, 3))
        self._pair_area, self._foot, self._lost = np.zeros(len(self.pairs)), np.zeros((n, 5)), np.zeros(n)
        self._traction, self._work = np.zeros((3 * n, 4)), np.zeros((3 * n, 2))
        self._arm = np.zeros((3 * n if self._armed else 0, 3))
        self._response = np.zeros((3 * n if any(law.closure is not None for law in present) else 0, 4))
        self._state = np.full(3 * n, joints.OPEN, np.int8)
        tolerance = 0.25 * self._skins
        reach = 0.25 * np.minimum(p.reach, p.normal_reach)
        for blocks, pair, r in (
            (self.slave, p.pair, reach), (self.master, p.pair, reach),
            (self.slave, self.ghosts.pair, 0.25 * self.ghosts.reach),
            (self.master, self.ghosts.pair, 0.25 * self.ghosts.reach),
        ):  # fmt: skip
            np.minimum.at(tolerance, blocks[pair], r)
        self._tolerance = tolerance
        self._depth, self._face_normal = np.zeros((n, 3)), np.zeros((n, 3))
        self._ajar = bool((p.flags & kernels.AJAR).any())
        self._partner: Ints | None = None
        self._walled = False  # whether cells meet on a slave face; known with the partners
        self._bundle()

    def _bundle(self) -> None:
        """Arguments of the kernels that do not change from step to step."""
        p = self.patches
        self._close_arguments = (p.gp, p.start, p.corners, p.offset, p.flags, p.limit, p.ref_points, p.ref_ratio)
        self._closed = (self._area, self._gap, self._depth, self._face_normal)
        self._rows = (
            self._w, self._gap, self._area, self._align, self._normal, self._push, self._slip, self._facing,
            self._pair_area, self._cluster_normal, self._foot, self._depth, self._face_normal,
        )  # fmt: skip

    def forces(self, x: Array, x_old: Array, dt: float, f_gp: Array) -> None:
        """Add the contact forces on gridpoints; the trial memory starts from the committed one every time.

        Parameters
        ----------
        x, x_old : (n_gp, 3) array
            Positions now and at the last commit [m].
        dt : float
            Time between them [s]; 0: no damping.
        f_gp : (n_gp, 3) array
            Forces [N], added to in place.

        Raises
        ------
        OverlapError
            A patch is deeper than a quarter of the local thickness; names the pair.
        """
        p = self.patches
        if not len(p):
            return
        deep = footprints.close_patches(
            *self._close_arguments, x, p.active_old, p.memory_old, self._points, self._active, *self._closed
        )
        if deep >= 0:
            raise OverlapError(too_deep(self, deep))
        kernels.fill_rows(
            p.gp, p.pair, self._cluster, self._thick, x, x_old, self._points, self._active, *self._rows
        )  # fmt: skip
        memory.carry_memory(
            p.gp, x, x_old, p.points_old, p.active_old, p.area_old, p.memory_old, self._points, self._active,
            self._area, self._memory_start, self._lost,
        )  # fmt: skip
        if self._damped:
            kernels.reduced_mass(
                p.gp, self._active, p.pair, self._pair_area, self._inverse, self._inverse_gp, self._area, self._w,
                self._mass,
            )  # fmt: skip
        if self._armed:
            responses.arms(p.gp, self._points, self._active, x, self._arm)
        corners.stiffen(self)
        for k, law in enumerate(self.laws):
            lo, hi = self._law_start[k], self._law_start[k + 1]
            if hi > lo:
                law.sweep(
                    3 * lo, 3 * hi, dt, self._gap, self._push, self._slip, self._normal, self._align, self._area,
                    self._mass, self._arm, p.prop, law.props, self._memory_start, self._memory, self._traction,
                    self._work, self._state,
                )  # fmt: skip
        corners.push(self)
        self._trial, self._filled = True, True
        response.look(self)
        kernels.scatter(p.gp, self._active, self._w, self._area, self._push, self._foot, self._traction, f_gp)

    def commit(self) -> None:
        """Make the last trial the history, and add its dissipation to `work`."""
        p = self.patches
        if not len(p):
            self._stored = 0.0
            return
        joints.total_work(self._area, self._work, self.work)
        self.work[0] += 0.5 * float(self._ks @ self._lost)
        p.area_old[:] = self._area[::3]
        if self._fragile:
            responses.fail(self._active, p.active_old, self._memory, p.memory_old, self._brittle, p.failure)
        self._keep()
        corners.keep(self)
        self._trial = False
        self._stored = None

    def _keep(self) -> None:
        """Let the trial be the history; the exchanged arrays are written completely by the next `forces`."""
        p = self.patches
        p.memory_old, self._memory = self._memory, p.memory_old
        p.points_old, self._points = self._points, p.points_old
        p.active_old, self._active = self._active, p.active_old

    def energy(self) -> float:
        """Elastic energy stored in the joints in the last committed state [J]."""
        if self._stored is None:
            self._stored = response.stored(self, self.patches.memory_old, self.patches.active_old)
        return self._stored

    @property
    def friction_work(self) -> float:
        """Energy dissipated by slip and failure, committed [J]."""
        return float(self.work[0])

    @property
    def damping_work(self) -> float:
        """Energy dissipated by the joints' dashpots, committed [J]."""
        return float(self.work[1])

    @property
    def n_patches(self) -> int:
        """Number of patches, open ones included."""
        return len(self.patches)

    stiffness = table.stiffness
    potential_k_gp = table.potential_k_gp
    pace = response.pace
    preload = table.preload

    def table(self, x: Array) -> dict[str, Any]:
        """Contact table as a dict of arrays; see `table.contact_table`."""
        return table.contact_table(self, x)

    def state_arrays(self) -> dict[str, Array]:
        """Everything that influences the next step, as copies; give it to `restore` of the same model."""
        return startup.state_arrays(self)

    def restore(self, arrays: dict[str, Any]) -> None:
        """Take back what `state_arrays` returned; `CheckpointError` if it does not fit this model."""
        startup.restore(self, arrays)
