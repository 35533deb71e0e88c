"""The effective matrix of implicit steps, ``cm M + cc C + K``, from what batches, contacts and loads offer."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.contact import sphere_tangents, tangents

__all__ = ["Assembler", "projector"]

Array = Any


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
        from scipy.sparse import coo_matrix

        system, state = self.system, self.system.state
        inner = [batch.tangent(state.q, state.x) for batch in system.model.batches]
        in_place = [part[2] for part, batch in zip(inner, system.model.batches, strict=True) if batch.in_place]
        self.stiffest = max((float(np.abs(values).max(initial=0.0)) for values in in_place), default=0.0)
        forces = state.f_gp if system.f_load is None else state.f_gp + system.f_load
        for batch in system.model.batches:
            rows, columns, values = batch.geometric(state.q, forces)
            inner.append((rows, columns, -values))
        K = coo_matrix(_joined(inner), shape=(self.n, self.n)).tocsr()
        outer = self._at_gridpoints(cc, dt)
        if outer is not None:
            self.stiffest = max(self.stiffest, float(np.abs(outer.diagonal()[: state.x.size]).max(initial=0.0)))
            P = self.placement(turns=outer.shape[0] > state.x.size)
            K = K + P.T @ outer @ P
        if cm:
            K = K + cm * self.mass()
        if cc and system.rate is not None:
            from scipy.sparse import diags

            K = K + self.mass() @ diags(np.broadcast_to(np.asarray(cc * system.rate), (self.n,)))
        if extra is not None:
            K = K + extra
        return self.constrained(K.tocsr())

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
            dof = (3 * gp[:, :, None] + np.arange(3)).reshape(len(gp), 21)
            rows.append(np.repeat(dof, 21, axis=1).ravel())
            cols.append(np.tile(dof, (1, 21)).ravel())
            values.append(-blocks.reshape(len(gp), 441).ravel())
        for load in system.loads:
            entries = load.tangent(state.t, state.x, cc)
            if entries is not None:
                first, second, block = entries
                rows.append(np.broadcast_to(3 * first[:, None, None] + np.arange(3)[:, None], block.shape).ravel())
                cols.append(np.broadcast_to(3 * second[:, None, None] + np.arange(3), block.shape).ravel())
                values.append(block.ravel())
        size = state.x.size
        if system.particles is not None:
            first, second, rates = sphere_tangents.tangent(system.particles, len(state.x))
            rows, cols, values = [*rows, first], [*cols, second], [*values, -rates]
            size += self.n
        if not rows:
            return None
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))
        return coo_matrix(entries, shape=(size, size)).tocsr()

    def constrained(self, K: Any) -> Any:
        """``N^T K N + s (1 - N)^T (1 - N)`` with the projector N on what is free, s of the size of K's diagonal."""
        from scipy.sparse import identity

        if not self.system.constraints.any:
            return K
        N = projector(self.system.constraints, self.n)
        held = identity(self.n, format="csr") - N
        scale = float(np.abs(K.diagonal()).mean()) or 1.0
        return (N.T @ K @ N + scale * (held.T @ held)).tocsr()


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
