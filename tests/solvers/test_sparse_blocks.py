"""The sparse elimination of contacts against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from contacts.solvers.contact_rows import ContactRows
from contacts.solvers.sparse_blocks import pattern_of


def contacts_of(pairs, seed):
    """Return contacts between bodies; -1: with what nothing moves."""
    generator = np.random.default_rng(seed)
    last = 3 * (max(max(pair) for pair in pairs) + 1)
    places = np.array(
        [[3 * b + k if b >= 0 else last for b in pair for k in range(3)] for pair in pairs]
    )
    rows = generator.normal(size=(len(pairs), 2, 6)) * (places < last)[:, None]
    columns = rows * generator.uniform(0.5, 2.0, last + 1)[places][:, None]
    own = np.stack([(rows[:, a] * columns[:, b]).sum(-1) for a, b in ((0, 0), (1, 1), (0, 1))], 1)
    return ContactRows(places, rows, columns, own, np.full((len(pairs), 2), np.sqrt(0.5)))


def dense(contacts):
    """Return the velocities (2 m, 2 m) per unit impulses."""
    count = len(contacts.own)
    felt = np.zeros((2 * count, contacts.places.max() + 1))
    moved = np.zeros_like(felt)
    for i in range(count):
        for k, place in enumerate(contacts.places[i]):
            felt[2 * i : 2 * i + 2, place] += contacts.rows[i, :, k]
            moved[2 * i : 2 * i + 2, place] += contacts.columns[i, :, k]
    return felt @ moved.T


# A pile, a chain, and a body that all touch; contacts twice between the same two.
PAIRS = (
    [(b, -1) for b in range(4)] + [(b, b + 4) for b in range(8)] + [(b, b + 5) for b in range(7)],
    [(0, -1), *[(b, b + 1) for b in range(30)]],
    [(0, b) for b in range(1, 20)] + [(b, -1) for b in range(1, 20)],
    [(0, 1), (0, 1), (1, 2), (1, 2), (2, -1), (2, -1)],
)


@pytest.mark.parametrize("pairs", PAIRS)
def test_blocks_are_those_of_the_dense_matrix_and_fill_in_is_an_elimination(pairs):
    contacts = contacts_of(pairs, 1)
    pattern, whole = pattern_of(contacts), dense(contacts)
    assert sorted(pattern.order) == list(range(len(pairs)))
    assert (pattern.order[pattern.place] == np.arange(len(pairs))).all()
    seen = set()
    for p, i in enumerate(pattern.order.tolist()):
        block = whole[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
        assert pattern.diagonal[p].reshape(2, 2) == pytest.approx(block)
        beside = pattern.others[pattern.begins[p] : pattern.begins[p + 1]].tolist()
        assert all(pattern.place[j] > p for j in beside)
        assert len(set(beside)) == len(beside)
        for at, j in zip(range(pattern.begins[p], pattern.begins[p + 1]), beside, strict=True):
            one, other = slice(2 * i, 2 * i + 2), slice(2 * j, 2 * j + 2)
            assert pattern.after[at].reshape(2, 2) == pytest.approx(whole[one, other])
            assert pattern.before[at].reshape(2, 2) == pytest.approx(whole[other, one])
            seen.add((min(i, j), max(i, j)))
    # Every entry of the matrix has a place, and so have all that their elimination fills.
    for i in range(len(pairs)):
        for j in range(i):
            if whole[2 * i : 2 * i + 2, 2 * j : 2 * j + 2].any():
                assert (j, i) in seen
    filled = {frozenset(pair) for pair in seen}
    for p in range(len(pairs)):
        beside = pattern.others[pattern.begins[p] : pattern.begins[p + 1]].tolist()
        assert all(frozenset((i, j)) in filled for i in beside for j in beside if i < j)


def test_a_chain_is_eliminated_without_new_entries():
    pairs = PAIRS[1]
    assert len(pattern_of(contacts_of(pairs, 2)).others) == len(pairs) - 1
