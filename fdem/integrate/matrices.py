"""The effective matrix of implicit steps, ``cm M + cc C + K``, from what batches, contacts and loads offer."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.contact import sphere_tangents, tangents

__all__ = ["Assembler", "projector"]

Array = Any

SMALL = 6000  # unknowns up to which sparse LU is used, which minds no asymmetry
ODD = 1e-3  # part of the tangent of contacts that may be asymmetric and left out: Newton's method still gains 10^3


class Assembler:
    """Matrices of a system over its unknowns.

    Parameters
    ----------
    system : System
        Its batches, contacts, loads and constraints are read.
    """

    def __init__(self, system: Any) -> None:
        self.system = system
        self.n = len(system.state.v)
        self.groups = [batch.groups() for batch in system.model.batches]
        self._steady = all(batch.steady for batch in system.model.batches)
        self._mass: Any = None
        self._blocked = len(system.model.batches) == 1 and system.model.batches[0].in_place
        self.symmetric = True  # whether the last matrix was, but for a part that Newton's method can do without
        self.stiffest = 0.0  # largest stiffness of a gridpoint in the last matrix [N/m]

    def mass(self) -> Any:
        """Mass matrix (n, n) at the present trial, scipy CSR."""
        from scipy.sparse import coo_matrix

        if self._mass is None or not self._steady:
            parts = [batch.mass_entries(self.system.state.q) for batch in self.system.model.batches]
            self._mass = coo_matrix(_joined(parts), shape=(self.n, self.n)).tocsr()
        return self._mass

    def effective(self, cm: Any, cc: float, dt: float, extra: Any = None) -> Any:
        """``cm M + cc C + K + extra`` at the present trial, constraints projected out, scipy CSR.

        Parameters
        ----------
        cm, cc : float
            Factors of mass and damping [1/s^2, 1/s].
        dt : float
            Time since the last commit [s], for the dashpots of contacts; 0: none.
        extra : (n, n) scipy sparse matrix, optional
            Added.
        """
        system, state = self.system, self.system.state
        self.symmetric, self.stiffest = True, 0.0
        K = self._inner()
        outer = self._at_gridpoints(cc, dt)
        if outer is not None:
            self.stiffest = max(self.stiffest, float(np.abs(outer.diagonal()[: state.x.size]).max(initial=0.0)))
            P = self.placement(turns=outer.shape[0] > state.x.size)
            K = K + self._shaped(P.T @ outer @ P)
        if cm:
            K = K + cm * self._shaped(self.mass())
        if cc and system.rate is not None:
            from scipy.sparse import diags

            K = K + self._shaped(self.mass() @ diags(np.broadcast_to(np.asarray(cc * system.rate), (self.n,))))
        if extra is not None:
            K = K + self._shaped(extra)
        return self.constrained(K)

    def _shaped(self, A: Any) -> Any:
        """`A` by rows, of 3x3 blocks where all unknowns are places of gridpoints."""
        return A.tobsr((3, 3)) if self._blocked else A.tocsr()

    def _inner(self) -> Any:
        """Stiffness of the blocks themselves, geometric terms of their placement included."""
        from scipy.sparse import bsr_matrix, coo_matrix

        system, state = self.system, self.system.state
        if self._blocked:
            (batch,) = system.model.batches
            blocks = batch.pattern.blocks(state.x)
            self.stiffest = float(np.abs(blocks).max(initial=0.0))
            return bsr_matrix((blocks, batch.pattern.column, batch.pattern.start), shape=(self.n, self.n))
        parts = [batch.tangent(state.q, state.x) for batch in system.model.batches]
        in_place = [part[2] for part, batch in zip(parts, system.model.batches, strict=True) if batch.in_place]
        self.stiffest = max((float(np.abs(values).max(initial=0.0)) for values in in_place), default=0.0)
        forces = state.f_gp if system.f_load is None else state.f_gp + system.f_load
        for batch in system.model.batches:
            rows, columns, values = batch.geometric(state.q, forces)
            self.symmetric &= not values.any()
            parts.append((rows, columns, -values))
        return coo_matrix(_joined(parts), shape=(self.n, self.n)).tocsr()

    def joints(self) -> Any:
        """Stiffness (n, n) of all joints as if they were closed and did not slip, scipy CSR."""
        from scipy.sparse import coo_matrix

        system, state = self.system, self.system.state
        if system.contacts is None or not system.contacts.n_patches:
            return coo_matrix((self.n, self.n)).tocsr()
        gp, w, frame, kn, ks = system.contacts.stiffness(state.x)
        spring = ks[:, None, None] * np.eye(3) + (kn - ks)[:, None, None] * frame[:, 0, :, None] * frame[:, 0, None, :]
        blocks = w[:, :, None, None, None] * w[:, None, :, None, None] * spring[:, None, None]
        dof = 3 * gp[:, :, None] + np.arange(3)
        rows = np.broadcast_to(dof[:, :, None, :, None], blocks.shape)
        cols = np.broadcast_to(dof[:, None, :, None, :], blocks.shape)
        K = coo_matrix((blocks.ravel(), (rows.ravel(), cols.ravel())), shape=(state.x.size, state.x.size)).tocsr()
        P = self.placement()
        return (P.T @ K @ P).tocsr()

    def modes(self) -> Array | None:
        """Rigid motions (n, 6) of every gridpoint for multigrid; None where unknowns are no positions."""
        if not all(batch.in_place for batch in self.system.model.batches):
            return None
        x = self.system.state.x[: self.n // 3]
        B = np.zeros((self.n, 6))
        for axis in range(3):
            B[axis::3, axis] = 1.0
            turn = np.cross(np.eye(3)[axis], x)
            B[:, 3 + axis] = turn.ravel()
        return B

    def soft(self) -> Any:
        """Stiffness (n, n) of what deforms between its contacts; None where nothing does."""
        from scipy.sparse import coo_matrix

        state = self.system.state
        inner = [batch.tangent(state.q, state.x) for batch in self.system.model.batches if batch.has_internal]
        return coo_matrix(_joined(inner), shape=(self.n, self.n)).tocsr() if inner else None

    def _even_out(self, blocks: Array) -> None:
        """Make the tangent of contacts symmetric where it nearly is and there is much to solve; in place."""
        turned = np.swapaxes(blocks, 1, 2)
        odd = float(np.abs(blocks - turned).max(initial=0.0))
        if odd > ODD * float(np.abs(blocks).max(initial=0.0)):
            self.symmetric = False
        elif self.n > SMALL:
            blocks += turned
            blocks *= 0.5

    def placement(self, turns: bool = False) -> Any:
        """``P`` (3 n_gp, n) of ``xdot = P v``, scipy CSR; with `turns` the unknowns themselves below."""
        from scipy.sparse import coo_matrix, identity, vstack

        state = self.system.state
        parts = [batch.jacobian(state.q) for batch in self.system.model.batches]
        P = coo_matrix(_joined(parts), shape=(state.x.size, self.n)).tocsr()
        return vstack([P, identity(self.n)], format="csr") if turns else P

    def _at_gridpoints(self, cc: float, dt: float) -> Any:
        """Stiffness of contacts, bedding, dashpots and follower loads between gridpoints; None: there are none.

        (3 n_gp, 3 n_gp), or with the unknowns below where there are spheres.
        """
        from scipy.sparse import coo_matrix

        system, state = self.system, self.system.state
        rows, cols, values = [], [], []
        if system.contacts is not None and system.contacts.n_patches:
            gp, blocks = tangents.tangent(system.contacts, state.x, dt)
            self._even_out(blocks.reshape(len(gp), 21, 21))
            dof = (3 * gp[:, :, None] + np.arange(3)).reshape(len(gp), 21)
            rows.append(np.repeat(dof, 21, axis=1).ravel())
            cols.append(np.tile(dof, (1, 21)).ravel())
            values.append(-blocks.reshape(len(gp), 441).ravel())
        for load in system.loads:
            entries = load.tangent(state.t, state.x, cc)
            if entries is not None:
                first, second, block = entries
                same = (first == second).all() and (np.abs(block - np.swapaxes(block, 1, 2)) == 0.0).all()
                self.symmetric &= bool(same)
                rows.append(np.broadcast_to(3 * first[:, None, None] + np.arange(3)[:, None], block.shape).ravel())
                cols.append(np.broadcast_to(3 * second[:, None, None] + np.arange(3), block.shape).ravel())
                values.append(block.ravel())
        size = state.x.size
        if system.particles is not None:
            first, second, rates = sphere_tangents.tangent(system.particles, len(state.x))
            rows, cols, values = [*rows, first], [*cols, second], [*values, -rates]
            size += self.n
            self.symmetric = False
        if not rows:
            return None
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))
        return coo_matrix(entries, shape=(size, size)).tocsr()

    def constrained(self, K: Any) -> Any:
        """``N^T K N + s (1 - N)^T (1 - N)`` with the projector N on what is free, s of the size of K's diagonal."""
        from scipy.sparse import identity

        constraints = self.system.constraints
        if not constraints.any:
            return K
        scale = float(np.abs(K.diagonal()).mean()) or 1.0
        if not len(constraints.oblique_rows) and not constraints.coupled:
            return self._masked(K, scale)
        N = projector(constraints, self.n)
        held = identity(self.n, format="csr") - N
        return (N.T @ K @ N + scale * (held.T @ held)).tocsr()

    def _masked(self, K: Any, scale: float) -> Any:
        """K with rows and columns of what is held left out, but for `scale` on the diagonal; in place."""
        from scipy.sparse import diags

        free = np.ones(self.n)
        free[self.system.constraints.held] = 0.0
        row = np.repeat(np.arange(len(K.indptr) - 1), np.diff(K.indptr))
        if K.data.ndim == 3:
            by_gridpoint = free.reshape(-1, 3)
            K.data *= by_gridpoint[row][:, :, None]
            K.data *= by_gridpoint[K.indices][:, None, :]
        else:
            K.data *= free[row] * free[K.indices]
        return K + self._shaped(diags(scale * (1.0 - free)).tocsr())


def projector(constraints: Any, n: int) -> Any:
    """Projector (n, n) of motions on what constraints leave free, scipy CSR; its transpose releases forces."""
    from scipy.sparse import coo_matrix, diags

    free = np.ones(n)
    free[constraints.held] = 0.0
    oblique = zip(constraints.oblique_rows, constraints.oblique, strict=True)
    blocks = [(row + np.arange(3), matrix) for row, matrix in oblique]
    blocks += [(np.arange(group.dofs.start, group.dofs.stop), group.free) for group in constraints.coupled]
    if not blocks:
        return diags(free).tocsr()
    rest = np.setdiff1d(np.arange(n), np.concatenate([index for index, _ in blocks]))
    rows = np.concatenate([*(np.repeat(index, len(index)) for index, _ in blocks), rest])
    columns = np.concatenate([*(np.tile(index, len(index)) for index, _ in blocks), rest])
    values = np.concatenate([*(matrix.ravel() for _, matrix in blocks), np.ones(len(rest))])
    return diags(free).tocsr() @ coo_matrix((values, (rows, columns)), shape=(n, n)).tocsr()


def _joined(parts: list[tuple[Array, Array, Array]]) -> tuple[Array, tuple[Array, Array]]:
    """Entries of several batches as scipy's coo_matrix takes them."""
    rows, cols, values = (np.concatenate([part[k] for part in parts]) for k in range(3))
    return values, (rows, cols)
