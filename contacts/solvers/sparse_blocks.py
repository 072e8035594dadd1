"""Equations of contacts that share bodies, eliminated block by block where they are not zero.

Contacts are neighbours that move a body together; in the plane those of a heap are eliminated with
few new entries in order of their number of neighbours (minimum degree: Tinney and Walker 1967).
The pattern of the entries is that of all contacts, whatever their status, so that it is found once
for a problem. There is no pivoting between blocks: what is symmetric and positive but for friction,
with a small part of its diagonal added, needs none, and where a pivot fails that is told.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_rows import ContactRows
from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel, part

# Entries of the elimination that there is place for at first, for each contact.
_ENTRIES = 16


class Pattern(NamedTuple):
    """Which entries the elimination of contacts fills.

    Attributes
    ----------
    order, place : (m,) array of int
        The contacts in the order of their elimination, and the place of each.
    begins : (m + 1,), others : (e,) array of int
        By place: entries ``begins[p] : begins[p + 1]`` are the blocks beside the diagonal of
        contact ``order[p]``, with contacts `others` that are eliminated later, in their order.
    targets : (t,) array of int
        Which entry each pair of entries of a contact changes, in the order of elimination.
    diagonal : (m, 4), after : (e, 4), before : (e, 4)
        Velocities per unit impulses, two by two: of a contact by its own; of it by another's, and
        of another by its own.
    """

    order: Ints
    place: Ints
    begins: Ints
    others: Ints
    targets: Ints
    diagonal: Array
    after: Array
    before: Array


@part
def _neighbours(contacts: ContactRows, heads: Ints, joined: Ints, found: Ints, begins: Ints) -> int:
    """Write the neighbours of every contact; return how many entries there are, or need be."""
    count = len(contacts.own)
    for b in range(len(heads)):
        heads[b] = 0
    for i in range(count):
        for side in range(2):
            heads[contacts.places[i, 3 * side] // 3 + 1] += 1
    for b in range(len(heads) - 1):
        heads[b + 1] += heads[b]
    for i in range(count - 1, -1, -1):
        for side in range(2):
            b = contacts.places[i, 3 * side] // 3 + 1
            heads[b] -= 1
            joined[heads[b]] = i
    for b in range(len(heads) - 1):
        heads[b] = heads[b + 1]
    heads[len(heads) - 1] = 2 * count
    total = 0
    for i in range(count):
        begins[i] = total
        for side in range(2):
            b = contacts.places[i, 3 * side] // 3
            if contacts.places[i, 3 * side] == contacts.places[i, 3 * side + 1]:
                continue
            for at in range(heads[b], heads[b + 1]):
                j, new = joined[at], True
                for k in range(begins[i], total):
                    new = new and found[k] != j
                if new and j != i:
                    if total == len(found):
                        return -1
                    found[total] = j
                    total += 1
    begins[count] = total
    return total


@kernel
def pattern_of(contacts: ContactRows) -> Pattern:
    """Return how contacts are eliminated, and their compliances.

    Parameters
    ----------
    contacts : ContactRows
        Of bodies: of the six rates that a contact moves three are one body's; three that are one
        stand for what nothing moves.
    """
    count = len(contacts.own)
    heads = np.empty(contacts.places.max() // 3 + 3, np.int64)
    joined, first = np.empty(2 * count, np.int64), np.empty(count + 1, np.int64)
    pool = np.empty(_ENTRIES * count + 16, np.int64)
    while True:
        total = _neighbours(contacts, heads, joined, pool, first)
        if total >= 0:
            break
        pool = np.empty(2 * len(pool), np.int64)
    sizes, places = np.empty(count, np.int64), np.empty(count, np.int64)
    for i in range(count):
        sizes[i] = first[i + 1] - first[i]
        places[i] = -1
    order, begins = np.empty(count, np.int64), np.zeros(count + 1, np.int64)
    others, mark = np.empty(_ENTRIES * count + 16, np.int64), np.full(count, -1)
    filled = 0
    for p in range(count):
        chosen, fewest = -1, count + 1
        for i in range(count):
            if places[i] < 0 and sizes[i] < fewest:
                chosen, fewest = i, sizes[i]
        order[p], places[chosen] = chosen, p
        begins[p] = filled
        if filled + fewest > len(others):
            others = _longer(others, filled + fewest)
        for k in range(first[chosen], first[chosen] + fewest):
            others[filled] = pool[k]
            filled += 1
        # Its neighbours become neighbours of each other.
        for at in range(begins[p], filled):
            i = others[at]
            if total + sizes[i] + fewest > len(pool):
                pool = _longer(pool, total + sizes[i] + fewest)
            begin, mark[i] = total, i
            for k in range(first[i], first[i] + sizes[i]):
                j = pool[k]
                if j != chosen:
                    mark[j] = i
                    pool[total] = j
                    total += 1
            for k in range(begins[p], filled):
                j = others[k]
                if mark[j] != i:
                    mark[j] = i
                    pool[total] = j
                    total += 1
            first[i], sizes[i] = begin, total - begin
            for k in range(begin, total):
                mark[pool[k]] = -1
            mark[i] = -1
    begins[count] = filled
    targets = _targets(places, begins, others)
    found = Pattern(
        order, places, begins, others[:filled].copy(), targets, np.empty((count, 4)),
        np.empty((filled, 4)), np.empty((filled, 4)),
    )  # fmt: skip
    for p in range(count):
        i = order[p]
        _between(contacts, i, i, found.diagonal[p])
        for at in range(begins[p], begins[p + 1]):
            _between(contacts, i, others[at], found.after[at])
            _between(contacts, others[at], i, found.before[at])
    return found


@part
def _targets(places: Ints, begins: Ints, others: Ints) -> Ints:
    """Put the entries of each contact in order; return `Pattern.targets`."""
    count, pairs = len(places), 0
    for p in range(count):
        begin, end = begins[p], begins[p + 1]
        pairs += (end - begin) * (end - begin - 1) // 2
        for at in range(begin + 1, end):
            i, k = others[at], at
            while k > begin and places[others[k - 1]] > places[i]:
                others[k] = others[k - 1]
                k -= 1
            others[k] = i
    targets, where, last = np.empty(pairs, np.int64), np.empty(count, np.int64), 0
    for p in range(count):
        for at in range(begins[p], begins[p + 1]):
            q = places[others[at]]
            for k in range(begins[q], begins[q + 1]):
                where[others[k]] = k
            for k in range(at + 1, begins[p + 1]):
                targets[last] = where[others[k]]
                last += 1
    return targets


@part
def _longer(array: Ints, needed: int) -> Ints:
    """Return a copy with place for twice as much as is needed."""
    result = np.empty(2 * needed, np.int64)
    for k in range(len(array)):
        result[k] = array[k]
    return result


@part
def _between(contacts: ContactRows, i: int, j: int, block: Array) -> None:
    """Write the velocities of contact i per unit impulses of contact j."""
    places, rows, columns = contacts.places, contacts.rows, contacts.columns
    for k in range(4):
        block[k] = 0.0
    for one in range(2):
        for other in range(2):
            if places[i, 3 * one] != places[j, 3 * other]:
                continue
            for k in range(3):
                for a in range(2):
                    for b in range(2):
                        product = rows[i, a, 3 * one + k] * columns[j, b, 3 * other + k]
                        block[2 * a + b] += product


@part
def factored(pattern: Pattern, diagonal: Array, after: Array, before: Array) -> bool:
    """Eliminate blocks in place: the inverses of the pivots, and the factors; False if one fails.

    Parameters
    ----------
    pattern : Pattern
    diagonal, after, before
        The blocks of the equations, as those of the pattern.
    """
    place, begins, others, targets = pattern.place, pattern.begins, pattern.others, pattern.targets
    last = 0
    for p in range(len(place)):
        a, b, c, d = diagonal[p]
        det = a * d - b * c
        if det == 0.0 or not math.isfinite(det):
            return False
        a, b, c, d = d / det, -b / det, -c / det, a / det
        diagonal[p, 0], diagonal[p, 1], diagonal[p, 2], diagonal[p, 3] = a, b, c, d
        begin, end = begins[p], begins[p + 1]
        for at in range(begin, end):
            e, f, g, h = before[at]
            before[at, 0], before[at, 1] = e * a + f * c, e * b + f * d
            before[at, 2], before[at, 3] = g * a + h * c, g * b + h * d
        for at in range(begin, end):
            q = place[others[at]]
            e, f, g, h = before[at]
            t, u, v, w = after[at]
            if e == f == g == h == t == u == v == w == 0.0:
                # One of the two is open.
                last += end - at - 1
                continue
            diagonal[q, 0] -= e * t + f * v
            diagonal[q, 1] -= e * u + f * w
            diagonal[q, 2] -= g * t + h * v
            diagonal[q, 3] -= g * u + h * w
            for k in range(at + 1, end):
                target = targets[last]
                last += 1
                r, s, x, y = after[k]
                after[target, 0] -= e * r + f * x
                after[target, 1] -= e * s + f * y
                after[target, 2] -= g * r + h * x
                after[target, 3] -= g * s + h * y
                i, j, m, n = before[k]
                before[target, 0] -= i * t + j * v
                before[target, 1] -= i * u + j * w
                before[target, 2] -= m * t + n * v
                before[target, 3] -= m * u + n * w
    return True


@part
def solved(pattern: Pattern, diagonal: Array, after: Array, before: Array, right: Array) -> None:
    """Solve factored equations for a right side (m, 2), in place."""
    order, begins, others = pattern.order, pattern.begins, pattern.others
    for p in range(len(order)):
        x, y = right[order[p]]
        for at in range(begins[p], begins[p + 1]):
            i = others[at]
            right[i, 0] -= before[at, 0] * x + before[at, 1] * y
            right[i, 1] -= before[at, 2] * x + before[at, 3] * y
    for p in range(len(order) - 1, -1, -1):
        x, y = right[order[p]]
        for at in range(begins[p], begins[p + 1]):
            u, v = right[others[at]]
            x -= after[at, 0] * u + after[at, 1] * v
            y -= after[at, 2] * u + after[at, 3] * v
        right[order[p], 0] = diagonal[p, 0] * x + diagonal[p, 1] * y
        right[order[p], 1] = diagonal[p, 2] * x + diagonal[p, 3] * y
