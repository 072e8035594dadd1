"""Groups of contacts that feel each other's impulses at an instant.

An impulse passes through the mass matrix, through joints, and through contacts. Forces pass none,
however stiff they are or however much they damp: at an instant they do nothing.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel


@kernel
def root(parents: Ints, node: int) -> int:
    """Return the node that stands for a connected component (union-find, paths halved in place)."""
    while parents[node] != node:
        parents[node] = parents[parents[node]]
        node = parents[node]
    return node


@kernel
def _unite(parents: Ints, one: int, other: int) -> None:
    """Join two components; the smallest node stands for them."""
    one, other = root(parents, one), root(parents, other)
    parents[max(one, other)] = min(one, other)


@kernel
def _unite_row(parents: Ints, row: Array, count: int) -> int:
    """Join the coordinates of the first `count` entries; return one of them, -1 for none."""
    n, first = len(parents), -1
    for j in range(count):
        if row[j] != 0.0:
            if first < 0:
                first = j % n
            _unite(parents, first, j % n)
    return first


@kernel
def coupled_contacts(
    mass: Array, held: Array, jacobians: Array, which: Ints, constraints: Ints
) -> Ints:
    """Label the contacts `which` (m,): those with one label feel each other's impulses.

    A label is the place in `which` of the first contact of its group. Rows may be longer than
    said: what follows in them is not read.

    Parameters
    ----------
    mass : (n, n) array
    held : (r, n) array
        Rows of joints.
    jacobians : (c, 2 n) array
        Normal and tangential rows of all contacts.
    which : (m,) array of int
    constraints : (c,) array of int
        Positive for contacts that are constraints.
    """
    m, n = len(which), len(mass)
    labels = np.zeros(m, np.int64)
    if m == 1:
        return labels
    parents = np.empty(n, np.int64)
    for j in range(n):
        parents[j] = j
    for j in range(n):
        for k in range(j):
            if mass[j, k] != 0.0:
                _unite(parents, j, k)
    for i in range(len(held)):
        _unite_row(parents, held[i], n)
    for i in range(len(constraints)):
        if constraints[i] > 0:
            _unite_row(parents, jacobians[i], 2 * n)
    for a in range(m):
        labels[a] = _unite_row(parents, jacobians[which[a]], 2 * n)
    firsts = np.full(n, -1)
    for a in range(m):
        if labels[a] < 0:
            labels[a] = a
            continue
        node = root(parents, labels[a])
        if firsts[node] < 0:
            firsts[node] = a
        labels[a] = firsts[node]
    return labels
