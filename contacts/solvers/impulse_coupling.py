"""Groups of contacts that are coupled by impulses at an instant.

Impulses act through the mass matrix, joints and contacts. Springs and dampers, however stiff,
transmit none.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel


@kernel
def root(parents: Ints, node: int) -> int:
    """Return the representative of a connected component (union-find with path halving)."""
    while parents[node] != node:
        parents[node] = parents[parents[node]]
        node = parents[node]
    return node


@kernel
def _unite(parents: Ints, one: int, other: int) -> None:
    """Join two components; the smallest node represents them."""
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
def label_coordinates(mass: Array, rows: Array, width: int) -> Ints:
    """Label coupled coordinates (n,) by the first of their group.

    Mass (n, n), and the first `width` entries, k n, of rows (m, k n or more), couple them.
    """
    parents = np.arange(len(mass))
    for i in range(len(mass)):
        _unite_row(parents, mass[i], len(mass))
    for i in range(len(rows)):
        _unite_row(parents, rows[i], width)
    for j in range(len(mass)):
        parents[j] = root(parents, j)
    return parents


@kernel
def coupled_contacts(
    mass: Array, joint_rows: Array, jacobians: Array, which: Ints, constraints: Ints
) -> Ints:
    """Label the contacts `which` (m,) so that coupled contacts share a label.

    A label is the place in `which` of the group's first contact. Mass (n, n), joint rows (r, n),
    and normal and tangential rows (c, 2 n) of all contacts, which may be longer; `constraints` (c,)
    is positive for bilateral contacts.
    """
    m, n = len(which), len(mass)
    labels = np.zeros(m, np.int64)
    if m == 1:
        return labels
    parents = label_coordinates(mass, joint_rows, n)
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
