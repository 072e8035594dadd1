"""Broad phase: pairs of near bodies by sweep and prune along x (Baraff 1992).

Pairs are sorted, so that warm starts are found. Pairs of enlarged circles are listed, and reused
until a body leaves its circle (neighbour list: Verlet 1967): listing takes less than the steps
between two lists, also in a single column of thousands of bodies.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel

# Enlargement of circles: relative to the body's size, and to its reach until the next detection (at
# most its size).
_WIDER, _FARTHER = 0.1, 4.0


class Sweep(NamedTuple):
    """Workspace of the broad phase."""

    order: Ints  # (b,): bodies by the left ends of their circles.
    heads: Ints  # (b + 1,): first listed pair of each body.
    pairs: Ints  # (p, 2): near pairs, sorted.
    circles: Array  # (b, 3): centres and radii of the enlarged circles.
    listed: Ints  # (p, 2): pairs of these, sorted.
    n_listed: Ints  # (1,): their number; -1: not listed yet.

    @classmethod
    def allocate(cls, count: int, most: int) -> Sweep:
        """Allocate arrays for so many bodies and pairs."""
        return cls(
            np.arange(count), np.empty(count + 1, np.int64), np.empty((most, 2), np.int64),
            np.empty((count, 3)), np.empty((most, 2), np.int64), np.full(1, -1),
        )  # fmt: skip


@kernel
def sort_by_key(keys: Ints, count: int, begins: Ints, order: Ints) -> None:
    """Sort the first `count` items by their keys (counting sort); leave out negative keys.

    The items of key k are ``order[begins[k] : begins[k + 1]]``.
    """
    for k in range(len(begins)):
        begins[k] = 0
    for i in range(count):
        if keys[i] >= 0:
            begins[keys[i]] += 1
    for k in range(len(begins) - 1):
        begins[k + 1] += begins[k]
    for i in range(count - 1, -1, -1):
        if keys[i] >= 0:
            begins[keys[i]] -= 1
            order[begins[keys[i]]] = i


@kernel
def _list_pairs(sweep: Sweep) -> int:
    """List pairs (one < other) of overlapping enlarged circles; return their number, -1: full."""
    circles, order, found, n_pairs = sweep.circles, sweep.order, sweep.pairs, 0
    count = len(circles)
    # Insertion sort: the order of the last list is nearly right.
    for i in range(1, count):
        b, k = order[i], i
        left = circles[b, 0] - circles[b, 2]
        while k > 0 and circles[order[k - 1], 0] - circles[order[k - 1], 2] > left:
            order[k] = order[k - 1]
            k -= 1
        order[k] = b
    for i in range(count):
        b = order[i]
        x, y, radius = circles[b, 0], circles[b, 1], circles[b, 2]
        for j in range(i + 1, count):
            c = order[j]
            both = radius + circles[c, 2]
            along, up = circles[c, 0] - x, circles[c, 1] - y
            if along > both:
                break
            if along * along + up * up > both * both:
                continue
            if n_pairs == len(found):
                return -1
            found[n_pairs, 0], found[n_pairs, 1] = min(b, c), max(b, c)
            n_pairs += 1
    firsts, places = np.empty(n_pairs, np.int64), np.empty(n_pairs, np.int64)
    for i in range(n_pairs):
        firsts[i] = found[i, 0]
    sort_by_key(firsts, n_pairs, sweep.heads, places)
    for i in range(n_pairs):
        one, other, k = found[places[i], 0], found[places[i], 1], i
        while k > sweep.heads[one] and sweep.listed[k - 1, 1] > other:
            sweep.listed[k, 1] = sweep.listed[k - 1, 1]
            k -= 1
        sweep.listed[i, 0], sweep.listed[k, 1] = one, other
    return n_pairs


@kernel
def _are_circles_valid(centres: Array, sizes: Array, reach: Array, circles: Array) -> bool:
    """Return whether all bodies with their reach are within their enlarged circles."""
    for b in range(len(sizes)):
        x, y = centres[b, 0] - circles[b, 0], centres[b, 1] - circles[b, 1]
        slack = circles[b, 2] - sizes[b] - reach[b]
        if not (slack >= 0.0 and x * x + y * y <= slack * slack):
            return False
    return True


@kernel
def near_pairs(centres: Array, sizes: Array, reach: Array, sweep: Sweep) -> int:
    """Find pairs (one < other) of overlapping circles; return their number, -1: full."""
    circles, listed, pairs, n_pairs = sweep.circles, sweep.listed, sweep.pairs, 0
    if sweep.n_listed[0] < 0 or not _are_circles_valid(centres, sizes, reach, circles):
        for b in range(len(sizes)):
            circles[b, 0], circles[b, 1] = centres[b]
            circles[b, 2] = sizes[b] + reach[b]
            circles[b, 2] += _WIDER * sizes[b] + min(_FARTHER * reach[b], sizes[b])
        sweep.n_listed[0] = _list_pairs(sweep)
    for i in range(sweep.n_listed[0]):
        b, c = listed[i, 0], listed[i, 1]
        x, y = centres[b, 0] - centres[c, 0], centres[b, 1] - centres[c, 1]
        both = sizes[b] + reach[b] + (sizes[c] + reach[c])
        # Written unconditionally: a mispredicted branch takes longer.
        pairs[n_pairs, 0], pairs[n_pairs, 1] = b, c
        n_pairs += 0 if x * x + y * y > both * both else 1
    return n_pairs if sweep.n_listed[0] >= 0 else -1
