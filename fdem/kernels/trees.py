"""Kernels of the trees of boxes over the faces of blocks: what is near a face is found without a look at all others.

Nodes stand in preorder: the left child of node i is i + 1, and ``skip[i]`` is the node after all of its descendants,
so that a search needs no stack. A node is a leaf if ``skip[i] == i + 1``. Which faces belong together is decided once
(split at the median of the widest direction); the boxes follow motion.
"""

from __future__ import annotations

import numpy as np

from fdem._jit import kernel

LEAF = 8  # most faces of a leaf


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
    skip, begin, end : (n_nodes,) int32
        Node after the descendants; range of places in `order`.
    order : (n_faces,) int32
        Faces, those of every node side by side.
    """
    n_blocks = len(face_start) - 1
    node_start = np.zeros(n_blocks + 1, np.int32)
    for b in range(n_blocks):
        leaves = (face_start[b + 1] - face_start[b] + LEAF - 1) // LEAF
        node_start[b + 1] = node_start[b] + max(0, 2 * leaves - 1)
    n_nodes = node_start[n_blocks]
    skip, begin, end = np.zeros(n_nodes, np.int32), np.zeros(n_nodes, np.int32), np.zeros(n_nodes, np.int32)
    order = np.arange(len(lower)).astype(np.int32)
    centre = 0.5 * (lower + upper).T.copy()
    for b in range(n_blocks):
        if node_start[b] == node_start[b + 1]:
            continue
        begin[node_start[b]], end[node_start[b]] = face_start[b], face_start[b + 1]
        for i in range(node_start[b], node_start[b + 1]):
            first, last = begin[i], end[i]
            leaves = (last - first + LEAF - 1) // LEAF
            skip[i] = i + 2 * leaves - 1
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
            begin[i + 1], end[i + 1] = first, middle
            begin[i + 2 * left], end[i + 2 * left] = middle, last
    return node_start, skip, begin, end, order


@kernel
def grow(blocks, node_start, skip, begin, end, order, lower, upper, node_lower, node_upper):
    """Boxes node_lower, node_upper (n_nodes, 3) [m] of the trees of `blocks`, from those of the faces."""
    for b in blocks:
        for i in range(node_start[b + 1] - 1, node_start[b] - 1, -1):
            if skip[i] > i + 1:
                left, right = i + 1, skip[i + 1]
                for d in range(3):
                    node_lower[i, d] = min(node_lower[left, d], node_lower[right, d])
                    node_upper[i, d] = max(node_upper[left, d], node_upper[right, d])
                continue
            for d in range(3):
                node_lower[i, d], node_upper[i, d] = np.inf, -np.inf
                for k in range(begin[i], end[i]):
                    node_lower[i, d] = min(node_lower[i, d], lower[order[k], d])
                    node_upper[i, d] = max(node_upper[i, d], upper[order[k], d])
