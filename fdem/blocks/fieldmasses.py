"""Masses of polynomial blocks (`fields`) against springs: highest frequencies, fictitious masses for relaxation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fdem.blocks.bounds import Springs
from fdem.kernels import fields as kernels

if TYPE_CHECKING:
    from fdem.blocks.fields import FieldBlocks

__all__ = [
    "GRADIENTS",
    "axial",
    "cross",
    "fictitious",
    "inner",
    "inverse",
    "largest",
    "masses",
    "motions",
    "outer",
    "spread",
    "turns",
]

Array = npt.NDArray[np.float64]

# fictitious mass of motions that nothing resists, over that of the strains of a block, where no joint is near
FREE = 0.05


def _gradients() -> Array:
    """Gradients (9, 3, 3) of the theory's rotations and strains (xx yy zz yz zx xy, engineering shear)."""
    result = np.zeros((9, 3, 3))
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        result[i, k, j], result[i, j, k] = 1.0, -1.0
        result[3 + i, i, i] = 1.0
        result[6 + i, j, k] = result[6 + i, k, j] = 0.5
    return result


def cross(vectors: Array) -> Array:
    """Matrices (n, 3, 3) of the cross products with vectors (n, 3)."""
    return np.einsum("ni,ijk->njk", vectors, GRADIENTS[:3])


def axial(tensors: Array) -> Array:
    """``sum r x p`` (n, 3) of the sums ``sum p r^T`` (n, 3, 3)."""
    return np.einsum("njk,ijk->ni", tensors, GRADIENTS[:3])


def inverse(moments: Array, mass: Array) -> Array:
    """Inverses of moments (n, k, k) of mass, taken over the masses (n,) and scaled by powers of two to near 1."""
    mass = mass[:, None, None]
    scale = np.exp2(-np.round(0.5 * np.log2(np.diagonal(moments / mass, axis1=1, axis2=2))))
    both = scale[:, :, None] * scale[:, None, :]
    result = np.linalg.inv(moments / mass * both) * both / mass
    return np.ascontiguousarray(0.5 * (result + np.swapaxes(result, 1, 2)))


GRADIENTS = _gradients()


def masses(blocks: FieldBlocks) -> Array:
    """Mass matrices (n_blocks, width, width)."""
    result = np.zeros((blocks.n_blocks, blocks.width, blocks.width))
    for d in range(3):
        result[:, d, d] = blocks.mass
        part = slice(3 + d * blocks.k, 3 + (d + 1) * blocks.k)
        result[:, part, part] = blocks.moments
    return result


def outer(blocks: FieldBlocks, springs: Springs) -> Array:
    """Stiffness (n_blocks, width, width) of joints, as if closed, and of bedding."""
    result = np.zeros((blocks.n_blocks, blocks.width, blocks.width))
    if springs.contacts is not None:
        place = np.full(len(springs.mobile), -1)
        place[blocks.rows] = np.arange(blocks.n_blocks)
        gp, w, frame, kn, ks = springs.rows
        kernels.joint_stiffness(
            gp, w, frame, kn, ks, springs.x, springs.gp_block, springs.mobile, place, blocks.phi,
            blocks.gridpoints.start, result,
        )  # fmt: skip
    return result + spread(blocks, springs.bedding)


def spread(blocks: FieldBlocks, k_gp: Array) -> Array:
    """``P^T diag(k_gp) P`` (n_blocks, width, width) of the same `k_gp` (n_gp,) in all directions."""
    value = np.concatenate([np.ones((len(blocks.phi), 1)), blocks.phi], axis=1)
    pairs = k_gp[blocks.gridpoints][:, None, None] * value[:, :, None] * value[:, None, :]
    sums = np.add.reduceat(pairs, blocks._start[:-1], axis=0)
    result = np.zeros((blocks.n_blocks, blocks.width, blocks.width))
    for d in range(3):
        index = np.r_[d, 3 + d * blocks.k : 3 + (d + 1) * blocks.k]
        result[:, index[:, None], index] = sums
    return result


def _root(blocks: FieldBlocks) -> Array:
    """Matrices L^-1 (n_blocks, width, width) of the Cholesky factors of the mass matrices over the masses [1, 1/m].

    Over the masses, so that numbers in other units of length, time and mass have the same bits.
    """
    root = np.zeros((blocks.n_blocks, blocks.width, blocks.width))
    lower = np.linalg.inv(np.linalg.cholesky(blocks.moments / blocks.mass[:, None, None]))
    for d in range(3):
        root[:, d, d] = 1.0
        part = slice(3 + d * blocks.k, 3 + (d + 1) * blocks.k)
        root[:, part, part] = lower
    return root


def _reduced(blocks: FieldBlocks, root: Array, stiffness: Array) -> Array:
    return root @ (stiffness / blocks.mass[:, None, None]) @ np.swapaxes(root, 1, 2)


def largest(blocks: FieldBlocks, stiffness: Array) -> Array:
    """Largest eigenvalues (n_blocks,) of ``M^-1 K`` for K (n_blocks, width, width) [1/s^2]."""
    return np.maximum(np.linalg.eigvalsh(_reduced(blocks, _root(blocks), stiffness))[:, -1], 0.0)


def inner(blocks: FieldBlocks, q: Array) -> Array:
    """`FieldBlocks.stiffness` among all unknowns (n_blocks, width, width)."""
    result = np.zeros((blocks.n_blocks, blocks.width, blocks.width))
    result[:, 3:, 3:] = blocks.stiffness(q)
    return result


def fictitious(blocks: FieldBlocks, q: Array, springs: Springs, swing: float) -> Array:
    """Fictitious mass matrices and their inverses (2, n_blocks, width, width), in the frames of the blocks.

    The mass is the stiffness of the block, strains and joints together, so that stiff rock on soft joints takes no
    longer; motions that are softer than the stiffest of the joints get the mass a rigid block would have. `swing` is
    the largest factor by which damping stiffens springs.
    """
    joints = outer(blocks, springs)
    held = largest(blocks, joints)
    strains = 2.0 * blocks.mu * blocks.volume / np.linalg.eigvalsh(blocks.moments)[:, -1]
    loose = np.where(held > 0.0, held, springs.kn * blocks.size**2 / blocks.mass)
    loose = np.where(loose > 0.0, loose, FREE * strains)
    turn, root = turns(blocks, q), _root(blocks)
    # mass and placement do not turn with the block, its strains do
    stiffness = np.swapaxes(turn, 1, 2) @ (inner(blocks, q) + joints) @ turn
    squares, vectors = np.linalg.eigh(_reduced(blocks, root, stiffness))
    # compression takes stiffness away: its size counts, for a mass must be positive
    squares = swing * np.maximum(np.abs(squares), loose[:, None])
    modes, mass = np.swapaxes(root, 1, 2) @ vectors, blocks.mass[:, None, None]
    carried = masses(blocks) @ modes
    frame = (carried * squares[:, None, :]) @ np.swapaxes(carried, 1, 2) / mass
    return np.stack([frame, (modes / squares[:, None, :]) @ np.swapaxes(modes, 1, 2) / mass])


def motions(blocks: FieldBlocks, row: int, q: Array, stiffness: Array, rows: Array | None = None) -> Array:
    """Motions that one block is damped by, and mass times these (2, width, width), in columns; the rest zeros.

    Translations first, then rotations, then modes of strain: orthogonal in the mass, and all obeying ``rows v = 0``. A
    force that strains shall not brake a rotation, nor one mode of strain another.

    Parameters
    ----------
    blocks, row, q : FieldBlocks, int, (n_q,) array
        The batch, the block, and the configuration at the start.
    stiffness : (width, width) array
        `inner` of the block.
    rows : (m, width) array, optional
        Conditions on its unknowns.
    """
    root = _root(blocks)[row]
    factor = np.linalg.inv(root).T  # unknowns in which the mass matrix over the mass is 1
    rigid = factor @ blocks.theory(row, q)[:, :6]
    limits = np.zeros((1, blocks.width)) if rows is None else rows @ root.T
    found = np.zeros((blocks.width, 0))
    for span in (rigid[:, :3], rigid, np.eye(blocks.width)):
        span = span / np.linalg.norm(span, axis=0)
        span = span - found @ (found.T @ span)
        left, size, _ = np.linalg.svd(span, full_matrices=False)
        span = left[:, size > 1e-6]
        _, size, right = np.linalg.svd(limits @ span)
        span = span @ right[int((size > 1e-9 * np.linalg.norm(limits)).sum()) :].T
        inner_part = span.T @ (root @ stiffness @ root.T) @ span
        # those of no stiffness are told apart by what they are, not by round-off
        order = np.linalg.eigh(inner_part)[1] if span.shape[1] > 3 else np.eye(span.shape[1])
        found = np.hstack([found, span @ order])
    result = np.zeros((2, blocks.width, blocks.width))
    result[0, :, : found.shape[1]] = root.T @ found
    result[1] = masses(blocks)[row] @ result[0]
    return result


def turns(blocks: FieldBlocks, q: Array) -> Array:
    """Matrices (n_blocks, width, width) that turn unknowns from the frames of the blocks to global axes."""
    result = np.zeros((blocks.n_blocks, blocks.width, blocks.width))
    rotation = blocks.rotation(q)
    result[:, :3, :3] = rotation
    for m in range(blocks.k):
        index = 3 + m + blocks.k * np.arange(3)
        result[:, index[:, None], index] = rotation
    return result
