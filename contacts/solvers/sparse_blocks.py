"""Sparse block elimination of equations in body rates.

Bodies that touch are neighbours; minimum-degree order (Tinney and Walker 1967) gives few new
entries in planar heaps, and is found in a time that grows with these. The pattern covers all
contacts whatever their status, so that it is computed once per problem. Contacts of a dense problem
share the same blocks. Blocks are not pivoted: the matrix is symmetric positive definite but for
friction; a failed pivot is reported.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_rows import ContactRows
from statechart.arrays import Array, Ints
from statechart.kernels.copies import copy_counts
from statechart.kernels.jit import kernel


class Equations(NamedTuple):
    """Block equations in body rates, by elimination order."""

    ends: Ints  # (m, s): places of the bodies of each contact; -1 for the fixed world.
    entries: Ints  # (m, s, s): entry that two of its bodies share; -1 for none.
    # Entries ``begins[p] : begins[p + 1]`` are the off-diagonal blocks of the body at place p, with
    # those at the later places `others`.
    begins: Ints  # shape (b + 1,)
    others: Ints  # shape (e,)
    # (t,): entry that each pair of entries of a body updates, in elimination order.
    targets: Ints
    diagonal: Array  # (b, 9): blocks of the bodies; once factored, inverses of the pivots.
    after: Array  # (e, 9): blocks above the diagonal.
    before: Array  # (e, 9): below it.
    rates: Array  # (b, 3)
    right: Array  # (m, 2): required changes of the contact velocities.


@kernel
def _body(contacts: ContactRows, i: int, side: int) -> int:
    """Return the index of a body of a contact; -1 for the fixed world."""
    body = contacts.bodies[i, side]
    return body if body < contacts.moving else -1


@kernel
def allocate_equations(contacts: ContactRows) -> Equations:
    """Allocate the equations of contacts and find their elimination order and pattern."""
    places, begins, others = _eliminate(contacts)
    bodies, filled = len(places), begins[-1]
    ends, entries = _shared(contacts, places, begins, others)
    return Equations(
        ends, entries, begins, others, _targets(begins, others), np.empty((bodies, 9)),
        np.empty((filled, 9)), np.empty((filled, 9)), np.empty((bodies, 3)),
        np.empty((len(contacts.own), 2)),
    )  # fmt: skip


@kernel
def _longer(numbers: Ints, least: int) -> Ints:
    """Return a longer array, of at least this length, that begins with the same numbers."""
    result = np.empty(max(2 * len(numbers), least), np.int64)
    copy_counts(numbers, result)
    return result


@kernel
def _prepend(lists: Ints, heads: Ints, which: int, item: int, at: int) -> int:
    """Write an item and the place of the next one, and let a list begin there; return the end."""
    lists[at], lists[at + 1], heads[which] = item, heads[which], at
    return at + 2


@kernel
def _is_listed(lists: Ints, at: int, body: int) -> bool:
    """Return whether a body is in the linked list that begins at a place."""
    while at >= 0 and lists[at] != body:
        at = lists[at + 1]
    return at >= 0


@kernel
def _eliminate(contacts: ContactRows) -> tuple[Ints, Ints, Ints]:
    """Return places of the bodies, and `Equations.begins` and `others`, in minimum-degree order."""
    (count, sides), bodies = contacts.bodies.shape, contacts.moving
    # Linked lists of neighbours, eliminated ones too, and of bodies that have or had a degree.
    heads, by_degree, degrees = np.full(bodies, -1), np.full(bodies, -1), np.zeros(bodies, np.int64)
    lists, end = np.empty(2 * bodies + 2 * count * sides * (sides - 1), np.int64), 0
    for i in range(count):
        for one in range(sides):
            for other in range(sides):
                b, c = _body(contacts, i, one), _body(contacts, i, other)
                if one != other and min(b, c) >= 0 and not _is_listed(lists, heads[b], c):
                    end = _prepend(lists, heads, b, c, end)
                    degrees[b] += 1
    for b in range(bodies - 1, -1, -1):
        end = _prepend(lists, by_degree, degrees[b], b, end)
    places, marks, lowest = np.full(bodies, -1), np.full(bodies, -1), 1
    begins, others = np.zeros(bodies + 1, np.int64), np.empty(count * sides, np.int64)
    for p in range(bodies):
        # An elimination reduces degrees by at most one.
        chosen, lowest = -1, max(lowest - 1, 0)
        while chosen < 0 or places[chosen] >= 0 or degrees[chosen] != lowest:
            while by_degree[lowest] < 0:
                lowest += 1
            chosen, by_degree[lowest] = lists[by_degree[lowest]], lists[by_degree[lowest] + 1]
        places[chosen], first, last = p, begins[p], begins[p] + lowest
        if last > len(others):
            others = _longer(others, last)
        if end + 2 * lowest * lowest > len(lists):
            lists = _longer(lists, end + 2 * lowest * lowest)
        begins[p + 1], k = first, heads[chosen]
        while k >= 0:
            if places[lists[k]] < 0:
                others[begins[p + 1]] = lists[k]
                begins[p + 1] += 1
            k = lists[k + 1]
        # Its neighbours become neighbours of each other.
        for i in range(first, last):
            b = others[i]
            degrees[b], marks[b], k = degrees[b] - 1, b, heads[b]
            while k >= 0:
                marks[lists[k]], k = b, lists[k + 1]
            for j in range(first, last):
                if marks[others[j]] != b:
                    end = _prepend(lists, heads, b, others[j], end)
                    degrees[b] += 1
            end = _prepend(lists, by_degree, degrees[b], b, end)
    for p in range(bodies):
        for at in range(begins[p], begins[p + 1]):
            q, k = places[others[at]], at
            while k > begins[p] and others[k - 1] > q:
                others[k] = others[k - 1]
                k -= 1
            others[k] = q
    return places, begins, others[: begins[bodies]]


@kernel
def _targets(begins: Ints, others: Ints) -> Ints:
    """Return `Equations.targets`."""
    bodies, pairs = len(begins) - 1, 0
    for p in range(bodies):
        size = begins[p + 1] - begins[p]
        pairs += size * (size - 1) // 2
    targets, where, last = np.empty(pairs, np.int64), np.empty(bodies, np.int64), 0
    for p in range(bodies):
        for at in range(begins[p], begins[p + 1]):
            q = others[at]
            for k in range(begins[q], begins[q + 1]):
                where[others[k]] = k
            for k in range(at + 1, begins[p + 1]):
                targets[last] = where[others[k]]
                last += 1
    return targets


@kernel
def _shared(contacts: ContactRows, places: Ints, begins: Ints, others: Ints) -> tuple[Ints, Ints]:
    """Return `Equations.ends` and `Equations.entries`."""
    count, sides = contacts.bodies.shape
    ends, entries = np.full((count, sides), -1), np.full((count, sides, sides), -1)
    for i in range(count):
        for side in range(sides):
            b = _body(contacts, i, side)
            if b >= 0:
                ends[i, side] = places[b]
        for one in range(sides):
            for other in range(sides):
                early, late = ends[i, one], ends[i, other]
                if 0 <= early < late:
                    for at in range(begins[early], begins[early + 1]):
                        if others[at] == late:
                            entries[i, one, other] = entries[i, other, one] = at
    return ends, entries


@kernel
def _invert(block: Array) -> bool:
    """Invert a block in place (Gauss-Jordan); False where a pivot fails."""
    for k in range(3):
        pivot = block[4 * k]
        if pivot == 0.0 or not math.isfinite(pivot):
            return False
        block[4 * k] = 1.0
        for c in range(3):
            block[3 * k + c] /= pivot
        for r in range(3):
            if r != k:
                factor = block[3 * r + k]
                block[3 * r + k] = 0.0
                for c in range(3):
                    block[3 * r + c] -= factor * block[3 * k + c]
    return True


@kernel
def _subtract_product(block: Array, left: Array, right: Array) -> None:
    """Subtract the product of two blocks from a block."""
    for r in range(3):
        a, b, c = left[3 * r], left[3 * r + 1], left[3 * r + 2]
        for k in range(3):
            block[3 * r + k] -= a * right[k] + b * right[3 + k] + c * right[6 + k]


@kernel
def factor_blocks(equations: Equations) -> bool:
    """Factor the blocks in place (LDU, inverted pivots); False where a pivot fails."""
    begins, others, targets = equations.begins, equations.others, equations.targets
    diagonal, after, before = equations.diagonal, equations.after, equations.before
    last, factor = 0, np.empty(9)
    for p in range(len(diagonal)):
        if not _invert(diagonal[p]):
            return False
        begin, end = begins[p], begins[p + 1]
        for at in range(begin, end):
            for k in range(9):
                factor[k] = 0.0
            _subtract_product(factor, before[at], diagonal[p])
            for k in range(9):
                before[at, k] = -factor[k]
        for at in range(begin, end):
            _subtract_product(diagonal[others[at]], before[at], after[at])
            for k in range(at + 1, end):
                target = targets[last]
                last += 1
                _subtract_product(after[target], before[at], after[k])
                _subtract_product(before[target], before[k], after[at])
    return True


@kernel
def solve_blocks(equations: Equations) -> None:
    """Solve factored equations for the right side in `Equations.rates`, in place."""
    begins, others, right = equations.begins, equations.others, equations.rates
    diagonal, after, before = equations.diagonal, equations.after, equations.before
    for p in range(len(diagonal)):
        x, y, z = right[p]
        for at in range(begins[p], begins[p + 1]):
            q = others[at]
            for r in range(3):
                right[q, r] -= (
                    before[at, 3 * r] * x + before[at, 3 * r + 1] * y + before[at, 3 * r + 2] * z
                )
    for p in range(len(diagonal) - 1, -1, -1):
        x, y, z = right[p]
        for at in range(begins[p], begins[p + 1]):
            u, v, w = right[others[at]]
            x -= after[at, 0] * u + after[at, 1] * v + after[at, 2] * w
            y -= after[at, 3] * u + after[at, 4] * v + after[at, 5] * w
            z -= after[at, 6] * u + after[at, 7] * v + after[at, 8] * w
        for r in range(3):
            right[p, r] = (
                diagonal[p, 3 * r] * x + diagonal[p, 3 * r + 1] * y + diagonal[p, 3 * r + 2] * z
            )
