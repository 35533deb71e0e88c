"""NumPy twins of the kernels: a few lines each, slow, obviously right."""

from __future__ import annotations

import itertools

import numpy as np

# zones


def kuhn_cube(n, jitter=0.0, seed=0):
    """Unit cube of n^3 cells, six tetrahedra each; interior gridpoints jittered by a part of the cell."""
    grid = np.stack(np.meshgrid(*3 * [np.arange(n + 1)], indexing="ij"), -1).reshape(-1, 3)
    X = grid / n
    if jitter:
        inside = np.all((grid > 0) & (grid < n), axis=1)
        X[inside] += jitter / n * np.random.default_rng(seed).uniform(-1, 1, (inside.sum(), 3))
    corners = np.stack(np.meshgrid(*3 * [np.arange(n)], indexing="ij"), -1).reshape(-1, 3)
    tets = []
    for order in itertools.permutations(range(3)):
        steps = np.zeros((4, 3), dtype=int)
        for k, axis in enumerate(order, start=1):
            steps[k] = steps[k - 1]
            steps[k, axis] += 1
        tets.append(corners[:, None, :] + steps)
    tets = np.stack(tets, axis=1).reshape(-1, 4, 3)
    ids = (tets[..., 0] * (n + 1) + tets[..., 1]) * (n + 1) + tets[..., 2]
    inverted = tet_volumes(X, ids) < 0
    ids[inverted] = ids[inverted][:, [0, 2, 1, 3]]
    return X, ids.astype(np.int32)


def tet_volumes(X, tets):
    """Signed volumes of tetrahedra."""
    return np.linalg.det(X[tets[:, 1:]] - X[tets[:, :1]]) / 6.0


def gradients(X, tets):
    """Gradients (m, 4, 3) of the four linear shape functions."""
    inverse = np.linalg.inv(X[tets[:, 1:]] - X[tets[:, :1]])
    g = np.swapaxes(inverse, 1, 2)
    return np.concatenate([-g.sum(axis=1, keepdims=True), g], axis=1)


def stvk(x, X, tets, lam, mu, stress0=None):
    """Energy and internal forces (n, 3) of St. Venant-Kirchhoff zones; stress0 (m, 3, 3)."""
    G, V = gradients(X, tets), tet_volumes(X, tets)
    F = np.einsum("eai,eaj->eij", x[tets], G)
    E = 0.5 * (np.einsum("eki,ekj->eij", F, F) - np.eye(3))
    S = lam * np.trace(E, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 2 * mu * E
    energy = 0.5 * np.einsum("e,eij,eij->", V, S, E)
    if stress0 is not None:
        energy += np.einsum("e,eij,eij->", V, stress0, E)
        S = S + stress0
    f = np.zeros_like(X)
    np.add.at(f, tets, np.einsum("e,eij,ejk,eak->eai", V, F, S, G))
    return energy, f


def polar(F):
    """Rotations of the polar decomposition of (n, 3, 3) gradients, by singular values."""
    U, _, Vt = np.linalg.svd(F)
    return U @ Vt


def rotation(vector):
    """Rotation matrix of a rotation vector [rad]."""
    angle = np.linalg.norm(vector)
    k = np.cross(np.eye(3), np.asarray(vector) / angle)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def voronoi_samples(X, tets, n, seed=0):
    """Shares of random points of a body that are nearest to each gridpoint (a check within 1/sqrt(n))."""
    rng = np.random.default_rng(seed)
    V = tet_volumes(X, tets)
    barycentric = rng.dirichlet(np.ones(4), n)
    tet = rng.choice(len(tets), n, p=V / V.sum())
    points = np.einsum("na,nai->ni", barycentric, X[tets[tet]])
    nearest = np.argmin(((points[:, None] - X) ** 2).sum(axis=2), axis=1)
    return np.bincount(nearest, minlength=len(X)) * V.sum() / n
