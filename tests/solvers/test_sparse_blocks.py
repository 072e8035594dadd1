"""The sparse elimination of bodies against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from batches import contact_rows

from contacts.solvers.contact_rows import ContactRows
from contacts.solvers.proximal_points import (
    OPEN,
    SLIDES,
    STICKS,
    add_newton_step,
    assemble_and_factor,
)
from contacts.solvers.sparse_blocks import Equations, allocate_equations
from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel


def contacts_of(pairs, seed):
    """Return contacts between bodies; -1: with what nothing moves."""
    generator = np.random.default_rng(seed)
    bodies = np.array(pairs)
    last = bodies.max() + 1
    bodies[bodies < 0] = last
    places = (3 * bodies[:, :, None] + np.arange(3)).reshape(-1, 6)
    rows = generator.normal(size=(len(pairs), 2, 6)) * (places < 3 * last)[:, None]
    columns = rows * generator.uniform(0.5, 2.0, 3 * last + 3)[places][:, None]
    return contact_rows(bodies, last, rows, columns, np.full((len(pairs), 2), np.sqrt(0.5)))


def dense(contacts):
    """Return the velocities (2 m, 2 m) per unit impulses."""
    count = len(contacts.own)
    felt = np.zeros((2 * count, 3 * contacts.moving + 3))
    moved = np.zeros_like(felt)
    for i in range(count):
        for side, body in enumerate(contacts.bodies[i]):
            at, k = slice(3 * body, 3 * body + 3), slice(3 * side, 3 * side + 3)
            felt[2 * i : 2 * i + 2, at] += contacts.rows[i, :, k]
            moved[2 * i : 2 * i + 2, at] += contacts.columns[i, :, k]
    return felt @ moved.T


GRID = [(b, b + 1) for b in range(144) if b % 12 < 11] + [(b, b + 12) for b in range(132)]

# A pile, a chain, a body that all touch, contacts twice between the same two, and a grid.
PAIRS = (
    [(b, -1) for b in range(4)] + [(b, b + 4) for b in range(8)] + [(b, b + 5) for b in range(7)],
    [(0, -1), *[(b, b + 1) for b in range(30)]],
    [(0, b) for b in range(1, 20)] + [(b, -1) for b in range(1, 20)],
    [(0, 1), (0, 1), (1, 2), (1, 2), (2, -1), (2, -1)],
    GRID,
)


def begin(contacts: ContactRows) -> Equations:
    # Interpreted kernels return plain tuples.
    return Equations(*allocate_equations(contacts))


@kernel
def solve(
    contacts: ContactRows,
    equations: Equations,
    compliance: float,
    status: Ints,
    edges: Array,
    impulses: Array,
) -> bool:
    if not assemble_and_factor(contacts, equations, compliance, status, edges):
        return False
    add_newton_step(contacts, equations, compliance, status, edges, impulses)
    return True


@pytest.mark.parametrize("pairs", PAIRS)
@pytest.mark.parametrize("compliance", [1.0, 1e-3])
def test_impulses_are_those_of_the_dense_equations(pairs, compliance):
    contacts, count = contacts_of(pairs, 3), len(pairs)
    generator = np.random.default_rng(4)
    status = generator.integers(3, size=count)
    edges = generator.choice([-0.3, 0.3], size=count)
    equations, found = begin(contacts), generator.normal(size=(count, 2))
    equations.right[:] = generator.normal(size=(count, 2))
    begun, right = found.copy(), equations.right.copy()
    assert solve(contacts, equations, compliance, status, edges, found)
    # Impulses are these unknowns; what is felt is asked for, where there is one.
    ways, along = [], []
    for i in range(count):
        first, second = np.zeros(2 * count), np.zeros(2 * count)
        first[2 * i], second[2 * i + 1] = 1.0, 1.0
        if status[i] == STICKS:
            ways += [first, second]
            along += [first, second]
        elif status[i] == SLIDES:
            ways.append(first + edges[i] * second)
            along.append(first)
    ways, along = np.array(ways).T, np.array(along)
    held = dense(contacts) + compliance * np.diag(contacts.own[:, :2].ravel())
    unknowns = np.linalg.solve(along @ held @ ways, along @ right.ravel())
    assert (found - begun).ravel() == pytest.approx(ways @ unknowns, rel=1e-8, abs=1e-8)
    assert (found[status == OPEN] == begun[status == OPEN]).all()


@pytest.mark.parametrize("pairs", PAIRS)
def test_elimination_reserves_its_fill_in(pairs):
    equations = begin(contacts_of(pairs, 1))
    beside = [
        equations.others[begin:end].tolist()
        for begin, end in zip(equations.begins[:-1], equations.begins[1:], strict=True)
    ]
    targets = iter(equations.targets.tolist())
    for p, later in enumerate(beside):
        assert later == sorted(set(later))
        assert all(q > p for q in later)
        for k, q in enumerate(later):
            for r in later[k + 1 :]:
                assert equations.begins[q] + beside[q].index(r) == next(targets)
    assert next(targets, None) is None
    for ends, entry in zip(equations.ends.tolist(), equations.entries.tolist(), strict=True):
        shared = entry[0][1]
        assert entry == [[-1, shared], [shared, -1]]
        if -1 in ends:
            assert shared == -1
        else:
            assert equations.others[shared] == max(ends)
            assert equations.begins[min(ends)] <= shared < equations.begins[min(ends) + 1]


def test_a_chain_is_eliminated_without_new_entries():
    assert len(begin(contacts_of(PAIRS[1], 2)).others) == 30


def test_contacts_that_all_feel_each_other_are_eliminated_as_a_dense_matrix():
    generator = np.random.default_rng(6)
    bodies, rows, columns = np.tile(np.arange(3), (4, 1)), *generator.normal(size=(2, 4, 2, 9))
    columns += 3.0 * rows
    contacts = contact_rows(bodies, 3, rows, columns, np.full((4, 2), np.sqrt(0.5)))
    equations, found = begin(contacts), np.zeros((4, 2))
    equations.right[:] = generator.normal(size=(4, 2))
    assert solve(contacts, equations, 0.1, np.full(4, STICKS), np.zeros(4), found)
    held = rows.reshape(8, 9) @ columns.reshape(8, 9).T + 0.1 * np.diag(contacts.own[:, :2].ravel())
    assert held @ found.ravel() == pytest.approx(equations.right.ravel(), rel=1e-9)
