"""Groups of contacts that feel each other's impulses at an instant.

An impulse passes through the mass matrix, through joints, and through contacts. Forces pass none,
however stiff they are or however much they damp: at an instant they do nothing.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel, part


@part
def root(parents: Ints, node: int) -> int:
    """Return the node that stands for a connected component (union-find, paths halved in place)."""
    while parents[node] != node:
        parents[node] = parents[parents[node]]
        node = parents[node]
    return node


@part
def _unite(parents: Ints, one: int, other: int) -> None:
    """Join two components; the smallest node stands for them."""
    one, other = root(parents, one), root(parents, other)
    parents[max(one, other)] = min(one, other)


@kernel
def coupled_contacts(mass: Array, held: Array, jacobians: Array) -> Ints:
    """Label the contacts (m,): those with one label feel each other's impulses.

    A label is the number of the first contact of its group.

    Parameters
    ----------
    mass : (n, n) array
    held : (r, n) array
        Rows of joints.
    jacobians : (m, 2, n) array
        Contacts.
    """
    m, n, r = len(jacobians), len(mass), len(held)
    parents = np.empty(m + n, np.int64)
    for node in range(m + n):
        parents[node] = node
    for j in range(n):
        for k in range(j):
            if mass[j, k] != 0.0:
                _unite(parents, m + j, m + k)
    for i in range(r):
        first = -1
        for j in range(n):
            if held[i, j] != 0.0:
                first = j if first < 0 else first
                _unite(parents, m + first, m + j)
    for a in range(m):
        for j in range(n):
            if jacobians[a, 0, j] != 0.0 or jacobians[a, 1, j] != 0.0:
                _unite(parents, a, m + j)
    labels = np.empty(m, np.int64)
    for a in range(m):
        labels[a] = root(parents, a)
    return labels
