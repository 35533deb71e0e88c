"""Kernels of the trees of boxes over the faces of blocks: what is near a face is found without a look at all others.

Nodes stand in preorder: the left child of node i is i + 1, and ``nodes[i, 0]`` is the node after all its descendants,
so that a search needs no stack. A node is a leaf if ``nodes[i, 0] == i + 1``; ``nodes[i, 1:]`` is its range of places
in `order`. Which faces belong together is decided once (split at the median of the widest direction); what bounds
them follows motion, `bounds` (n_nodes, 15): smallest and largest coordinates [m], smallest and largest components of
normals, largest lean.
"""

from __future__ import annotations

import numpy as np

from fdem._jit import kernel

LEAF = 8  # most faces of a leaf
FEW = 32  # faces of a block that is one leaf, in order


@kernel
def _select(key, order, lo, hi, at):
    """Rearrange ``order[lo:hi]`` so that no key before place `at` is larger than one behind it (quickselect)."""
    while hi - lo > 1:
        pivot = key[order[(lo + hi) // 2]]
        i, j = lo, hi - 1
        while i <= j:
            while key[order[i]] < pivot:
                i += 1
            while key[order[j]] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
        if at <= j:
            hi = j + 1
        elif at >= i:
            lo = i
        else:
            return


@kernel
def plant(face_start, lower, upper):
    """Trees over the faces of all blocks, from their boxes lower, upper (n_faces, 3) [m].

    Returns
    -------
    node_start : (n_blocks + 1,) int32
    nodes : (n_nodes, 3) int32
    order : (n_faces,) int32
        Faces, those of every node side by side.
    """
    n_blocks = len(face_start) - 1
    node_start = np.zeros(n_blocks + 1, np.int32)
    for b in range(n_blocks):
        n = face_start[b + 1] - face_start[b]
        node_start[b + 1] = node_start[b] + (2 * ((n + LEAF - 1) // LEAF) - 1 if n > FEW else min(n, 1))
    nodes = np.zeros((node_start[n_blocks], 3), np.int32)
    order = np.arange(len(lower)).astype(np.int32)
    centre = 0.5 * (lower + upper).T.copy()
    for b in range(n_blocks):
        if node_start[b] == node_start[b + 1]:
            continue
        root = node_start[b]
        nodes[root, 1], nodes[root, 2] = face_start[b], face_start[b + 1]
        for i in range(root, node_start[b + 1]):
            first, last = nodes[i, 1], nodes[i, 2]
            leaves = (last - first + LEAF - 1) // LEAF if node_start[b + 1] > root + 1 else 1
            nodes[i, 0] = i + 2 * leaves - 1
            if leaves == 1:
                continue
            axis, widest = 0, -1.0
            for d in range(3):
                low, high = np.inf, -np.inf
                for k in range(first, last):
                    low, high = min(low, centre[d, order[k]]), max(high, centre[d, order[k]])
                if high - low > widest:
                    axis, widest = d, high - low
            left = leaves // 2
            middle = first + left * LEAF
            _select(centre[axis], order, first, last, middle)
            nodes[i + 1, 1], nodes[i + 1, 2] = first, middle
            nodes[i + 2 * left, 1], nodes[i + 2 * left, 2] = middle, last
    return node_start, nodes, order


@kernel
def grow(blocks, node_start, nodes, order, bounds, lower, upper, normal, lean):
    """What bounds the nodes of `blocks`, from boxes lower, upper [m], normals and lean (n_faces, 3) of the faces."""
    for b in blocks:
        for i in range(node_start[b + 1] - 1, node_start[b] - 1, -1):
            if nodes[i, 0] > i + 1:
                left, right = i + 1, nodes[i + 1, 0]
                for d in range(3):
                    for low in (d, d + 6):
                        bounds[i, low] = min(bounds[left, low], bounds[right, low])
                    for high in (d + 3, d + 9, d + 12):
                        bounds[i, high] = max(bounds[left, high], bounds[right, high])
                continue
            for d in range(3):
                bounds[i, d], bounds[i, d + 6] = np.inf, np.inf
                bounds[i, d + 3], bounds[i, d + 9], bounds[i, d + 12] = -np.inf, -np.inf, 0.0
                for f in order[nodes[i, 1] : nodes[i, 2]]:
                    bounds[i, d] = min(bounds[i, d], lower[f, d])
                    bounds[i, d + 3] = max(bounds[i, d + 3], upper[f, d])
                    bounds[i, d + 6] = min(bounds[i, d + 6], normal[f, d])
                    bounds[i, d + 9] = max(bounds[i, d + 9], normal[f, d])
                    bounds[i, d + 12] = max(bounds[i, d + 12], lean[f, d])
