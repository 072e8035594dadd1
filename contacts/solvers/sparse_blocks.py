"""Sparse block elimination of equations in body rates.

Bodies that touch are neighbours; minimum-degree order (Tinney and Walker 1967) gives few new
entries in planar heaps. The pattern covers all contacts whatever their status, so that it is
computed once per problem. Contacts of a dense problem share the same blocks. Blocks are not
pivoted: the matrix is symmetric positive definite but for friction; a failed pivot is reported.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_rows import ContactRows
from statechart.arrays import Array, Ints
from statechart.kernels.copies import indices
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
    (count, sides), bodies = contacts.bodies.shape, contacts.moving
    adjacent, degrees = np.zeros((bodies, bodies), np.bool_), np.zeros(bodies, np.int64)
    for i in range(count):
        for one in range(sides):
            for other in range(sides):
                b, neighbour = _body(contacts, i, one), _body(contacts, i, other)
                if one != other and min(b, neighbour) >= 0 and not adjacent[b, neighbour]:
                    adjacent[b, neighbour] = True
                    degrees[b] += 1
    places, order = np.full(bodies, -1), np.empty(bodies, np.int64)
    begins = np.zeros(bodies + 1, np.int64)
    for p in range(bodies):
        chosen = -1
        for b in range(bodies):
            if places[b] < 0 and (chosen < 0 or degrees[b] < degrees[chosen]):
                chosen = b
        places[chosen], order[p], begins[p + 1] = p, chosen, begins[p] + degrees[chosen]
        # Its neighbours become neighbours of each other; its row keeps those at later places.
        later = indices(adjacent[chosen])
        for b in later:
            adjacent[b, chosen] = False
            degrees[b] -= 1
            for other in later:
                if other != b and not adjacent[b, other]:
                    adjacent[b, other] = True
                    degrees[b] += 1
    others, filled = np.empty(begins[bodies], np.int64), 0
    for p in range(bodies):
        for q in range(p + 1, bodies):
            if adjacent[order[p], order[q]]:
                others[filled] = q
                filled += 1
    targets = _targets(begins, others)
    ends, entries = _shared(contacts, places, begins, others)
    return Equations(
        ends, entries, begins, others, targets, np.empty((bodies, 9)), np.empty((filled, 9)),
        np.empty((filled, 9)), np.empty((bodies, 3)), np.empty((len(contacts.own), 2)),
    )  # fmt: skip


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
