"""Groups of contacts that feel each other's impulses, against components of the whole graph."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components

from contacts.solvers.impulse_coupling import coupled_contacts


def test_labels_are_the_components_of_the_graph() -> None:
    for seed in range(200):
        random = np.random.default_rng(seed)
        n, c, r = random.integers(1, 9), random.integers(1, 7), random.integers(0, 3)
        mass = np.diag(random.uniform(1.0, 2.0, n))
        for i, j in random.integers(0, n, (random.integers(0, 3), 2)):
            mass[i, j] = mass[j, i] = 1.0
        held = np.where(random.uniform(size=(r, n)) < 0.2, 1.0, 0.0)
        jacobians = np.where(random.uniform(size=(c, 2 * n)) < 0.2, 1.0, 0.0)
        constraints = (random.uniform(size=c) < 0.3).astype(np.int64)
        which = np.flatnonzero(random.uniform(size=c) < 0.7)
        lasting = jacobians[constraints > 0]
        # Nodes: coordinates, joints, constraints, contacts.
        rows = np.vstack([jacobians[which], lasting])
        rows = np.vstack([held, (rows[:, :n] != 0.0) | (rows[:, n:] != 0.0)])
        graph = np.zeros((n + len(rows),) * 2)
        graph[:n, :n], graph[n:, :n] = mass, rows
        found = connected_components(graph, directed=False)[1][n + r : n + r + len(which)]
        expected = [found.tolist().index(label) for label in found.tolist()]
        # Later entries of a row are not read.
        wide = [np.hstack([array, np.ones((len(array), 3))]) for array in (held, jacobians)]
        assert coupled_contacts(mass, *wide, which, constraints).tolist() == expected, seed
