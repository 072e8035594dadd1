"""Broad phase: pairs of near bodies by spatial hashing, linear in the number of bodies.

Cells are as large as the largest ordinary body; much larger bodies are tested against all. Pairs
are sorted, so that warm starts are found. Pairs of enlarged circles are listed, and reused until a
body leaves its circle (neighbour list: Verlet 1967).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel

# Size, relative to the mean, above which a body has no cell.
_LARGE = 4.0
# Cells per body.
_CELLS = 2
# Enlargement of circles: relative to the body's size, and to its reach until the next detection (at
# most its size).
_WIDER, _FARTHER = 0.1, 4.0
# Hash multiplier of columns (Teschner and others, Optimized spatial hashing, 2003).
_ACROSS = 73856093


class Grid(NamedTuple):
    """Workspace of the broad phase."""

    cells: Ints  # (b, 2): cell of each body.
    keys: Ints  # (b,): its hash; -1 for large bodies.
    large: Ints  # shape (b,)
    # (c + 1,): bodies by the hash of their cells.
    heads: Ints
    order: Ints
    pairs: Ints  # (p, 2): near pairs, sorted.
    circles: Array  # (b, 3): centres and radii of the enlarged circles.
    listed: Ints  # (p, 2): pairs of these, sorted.
    n_listed: Ints  # (1,): their number; -1: not listed yet.

    @classmethod
    def allocate(cls, count: int, most: int) -> Grid:
        """Allocate arrays for so many bodies and pairs."""
        cells = 1 << (_CELLS * count).bit_length()
        return cls(
            np.empty((count, 2), np.int64), np.empty(count, np.int64), np.empty(count, np.int64),
            np.empty(cells + 1, np.int64), np.empty(count, np.int64), np.empty((most, 2), np.int64),
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
def _bucket(across: int, up: int, most: int) -> int:
    # Vertically adjacent cells have adjacent buckets: three are scanned at once.
    return (across * _ACROSS + up) & (most - 1)


@kernel
def _sort_into_cells(grid: Grid) -> int:
    """Sort bodies into cells (counting sort); return the number of large bodies."""
    cells, large, circles, keys = grid.cells, grid.large, grid.circles, grid.keys
    count, mean = len(circles), 0.0
    for b in range(count):
        mean += circles[b, 2] / count
    widest, many = 0.0, 0
    for b in range(count):
        if circles[b, 2] > _LARGE * mean:
            large[many] = b
            many += 1
        else:
            widest = max(widest, circles[b, 2])
    cell = 2.0 * widest if widest > 0.0 else 1.0
    for b in range(count):
        cells[b, 0], cells[b, 1], keys[b] = 0, 0, -1
        if circles[b, 2] <= _LARGE * mean:
            # Bodies beyond the integer range share the outermost cells.
            cells[b, 0] = int(min(max(math.floor(circles[b, 0] / cell), -(2.0**30)), 2.0**30))
            cells[b, 1] = int(min(max(math.floor(circles[b, 1] / cell), -(2.0**30)), 2.0**30))
            keys[b] = _bucket(cells[b, 0], cells[b, 1], len(grid.heads) - 1)
    sort_by_key(keys, count, grid.heads, grid.order)
    return many


@kernel
def _list_pairs(grid: Grid) -> int:
    """List pairs (one < other) of overlapping enlarged circles; return their number, -1: full."""
    count, most = len(grid.circles), len(grid.heads) - 1
    many = _sort_into_cells(grid)
    cells, large, heads, order, pairs = grid.cells, grid.large, grid.heads, grid.order, grid.listed
    n_pairs, next_large = 0, 0
    for b in range(count):
        begin = n_pairs
        is_large = next_large < many and large[next_large] == b
        if is_large:
            next_large += 1
            for c in range(b + 1, count):
                if n_pairs == len(pairs):
                    return -1
                n_pairs = _append_if_near(grid.circles, b, c, n_pairs, pairs)
            continue
        for i in range(next_large, many):
            if n_pairs == len(pairs):
                return -1
            n_pairs = _append_if_near(grid.circles, b, large[i], n_pairs, pairs)
        for across in range(cells[b, 0] - 1, cells[b, 0] + 2):
            first = _bucket(across, cells[b, 1] - 1, most)
            # Buckets wrap around.
            run = min(3, most - first)
            for turn in range(1 if run == 3 else 2):
                begin_at, end_at = (first, first + run) if turn == 0 else (0, 3 - run)
                for i in range(heads[begin_at], heads[end_at]):
                    c = order[i]
                    if c > b and cells[c, 0] == across and abs(cells[c, 1] - cells[b, 1]) <= 1:
                        if n_pairs == len(pairs):
                            return -1
                        n_pairs = _append_if_near(grid.circles, b, c, n_pairs, pairs)
        for i in range(begin + 1, n_pairs):
            c, k = pairs[i, 1], i
            while k > begin and pairs[k - 1, 1] > c:
                pairs[k, 1] = pairs[k - 1, 1]
                k -= 1
            pairs[k, 1] = c
    return n_pairs


@kernel
def _append_if_near(circles: Array, b: int, c: int, n_pairs: int, pairs: Ints) -> int:
    """Append a pair if its circles overlap; return the number of pairs."""
    x, y = circles[b, 0] - circles[c, 0], circles[b, 1] - circles[c, 1]
    both = circles[b, 2] + circles[c, 2]
    if x * x + y * y > both * both:
        return n_pairs
    pairs[n_pairs, 0], pairs[n_pairs, 1] = b, c
    return n_pairs + 1


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
def near_pairs(centres: Array, sizes: Array, reach: Array, grid: Grid) -> int:
    """Find pairs (one < other) of overlapping circles; return their number, -1: full."""
    circles, listed, pairs, n_pairs = grid.circles, grid.listed, grid.pairs, 0
    if grid.n_listed[0] < 0 or not _are_circles_valid(centres, sizes, reach, circles):
        for b in range(len(sizes)):
            circles[b, 0], circles[b, 1] = centres[b]
            circles[b, 2] = sizes[b] + reach[b]
            circles[b, 2] += _WIDER * sizes[b] + min(_FARTHER * reach[b], sizes[b])
        grid.n_listed[0] = _list_pairs(grid)
    for i in range(grid.n_listed[0]):
        b, c = listed[i, 0], listed[i, 1]
        x, y = centres[b, 0] - centres[c, 0], centres[b, 1] - centres[c, 1]
        both = sizes[b] + reach[b] + (sizes[c] + reach[c])
        # Written unconditionally: a mispredicted branch takes longer.
        pairs[n_pairs, 0], pairs[n_pairs, 1] = b, c
        n_pairs += 0 if x * x + y * y > both * both else 1
    return n_pairs if grid.n_listed[0] >= 0 else -1
