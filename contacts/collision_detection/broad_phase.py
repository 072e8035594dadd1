"""Broad phase: pairs of near bodies by a hashed grid, in time linear in the bodies.

Bodies lie in cells as large as the largest of them; what is much larger than most is looked at
beside all others. Pairs come in order, so that contacts find theirs of the step before. Pairs of
wider circles are listed, and the list is good until a body leaves its own (Verlet 1967).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel

# Bodies that reach farther than so many times the mean have no cell.
_LARGE = 4.0
# Cells for each body.
_CELLS = 2
# How much wider the circles of listed pairs are: by this part of a body's size, and by so many
# times how far it may go until the next detection, which is its size at most.
_WIDER, _FARTHER = 0.1, 4.0
# Multiplier of a cell's column (Teschner and others, Optimized spatial hashing, 2003).
_ACROSS = 73856093


class Grid(NamedTuple):
    """Workspace of the broad phase."""

    cells: Ints  # (b, 2): cell of every body; of a large one none.
    large: Ints  # shape (b,)
    # (c + 1,): bodies by the hash of their cells.
    heads: Ints
    order: Ints
    pairs: Ints  # (p, 2): those found, in order.
    circles: Array  # (b, 3): middles and radii of the circles that the listed pairs are of.
    listed: Ints  # (p, 2): pairs of these, in order.
    n_listed: Ints  # (1,): how many; -1: none are listed.

    @classmethod
    def allocate(cls, count: int, most: int) -> Grid:
        """Allocate arrays for so many bodies and pairs."""
        cells = 1 << (_CELLS * count).bit_length()
        return cls(
            np.empty((count, 2), np.int64),
            np.empty(count, np.int64),
            np.empty(cells + 1, np.int64),
            np.empty(count, np.int64),
            np.empty((most, 2), np.int64),
            np.empty((count, 3)),
            np.empty((most, 2), np.int64),
            np.full(1, -1),
        )


@kernel
def _bucket(across: int, up: int, most: int) -> int:
    # Cells above each other have buckets beside each other: three are looked through at once.
    return (across * _ACROSS + up) & (most - 1)


@kernel
def _sorted_in(grid: Grid) -> int:
    """Put bodies into cells by a counting sort; return how many are large."""
    cells, large, circles = grid.cells, grid.large, grid.circles
    heads, order = grid.heads, grid.order
    count, most = len(circles), len(heads) - 1
    mean = 0.0
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
    for i in range(most + 1):
        heads[i] = 0
    for b in range(count):
        cells[b, 0] = cells[b, 1] = 0
        if circles[b, 2] <= _LARGE * mean:
            # Bodies beyond the range of cell numbers share the outermost cells.
            cells[b, 0] = int(min(max(math.floor(circles[b, 0] / cell), -(2.0**30)), 2.0**30))
            cells[b, 1] = int(min(max(math.floor(circles[b, 1] / cell), -(2.0**30)), 2.0**30))
            heads[_bucket(cells[b, 0], cells[b, 1], most) + 1] += 1
    for i in range(most):
        heads[i + 1] += heads[i]
    for b in range(count - 1, -1, -1):
        if circles[b, 2] <= _LARGE * mean:
            bucket = _bucket(cells[b, 0], cells[b, 1], most) + 1
            heads[bucket] -= 1
            order[heads[bucket]] = b
    for i in range(most):
        heads[i] = heads[i + 1]
    heads[most] = count - many
    return many


@kernel
def _list_pairs(grid: Grid) -> int:
    """List the pairs (one < other) whose circles meet; return how many, or -1: place is short."""
    count, most = len(grid.circles), len(grid.heads) - 1
    many = _sorted_in(grid)
    cells, large, heads, order, pairs = grid.cells, grid.large, grid.heads, grid.order, grid.listed
    found, next_large = 0, 0
    for b in range(count):
        begin = found
        is_large = next_large < many and large[next_large] == b
        if is_large:
            next_large += 1
            for c in range(b + 1, count):
                if found == len(pairs):
                    return -1
                found = _if_near(grid.circles, b, c, found, pairs)
            continue
        for i in range(next_large, many):
            if found == len(pairs):
                return -1
            found = _if_near(grid.circles, b, large[i], found, pairs)
        for across in range(cells[b, 0] - 1, cells[b, 0] + 2):
            first = _bucket(across, cells[b, 1] - 1, most)
            # Beyond the last bucket comes the first.
            left = min(3, most - first)
            for turn in range(1 if left == 3 else 2):
                begin_at, end_at = (first, first + left) if turn == 0 else (0, 3 - left)
                for i in range(heads[begin_at], heads[end_at]):
                    c = order[i]
                    if c > b and cells[c, 0] == across and abs(cells[c, 1] - cells[b, 1]) <= 1:
                        if found == len(pairs):
                            return -1
                        found = _if_near(grid.circles, b, c, found, pairs)
        for i in range(begin + 1, found):
            c, k = pairs[i, 1], i
            while k > begin and pairs[k - 1, 1] > c:
                pairs[k, 1] = pairs[k - 1, 1]
                k -= 1
            pairs[k, 1] = c
    return found


@kernel
def _if_near(circles: Array, b: int, c: int, found: int, pairs: Ints) -> int:
    """Write a pair if its circles meet; return how many there are then."""
    x, y = circles[b, 0] - circles[c, 0], circles[b, 1] - circles[c, 1]
    both = circles[b, 2] + circles[c, 2]
    if x * x + y * y > both * both:
        return found
    pairs[found, 0], pairs[found, 1] = b, c
    return found + 1


@kernel
def _all_within(centres: Array, sizes: Array, reach: Array, circles: Array) -> bool:
    """Return whether the reach of every body lies within the circles of the listed pairs."""
    for b in range(len(sizes)):
        x, y = centres[b, 0] - circles[b, 0], centres[b, 1] - circles[b, 1]
        left = circles[b, 2] - sizes[b] - reach[b]
        if not (left >= 0.0 and x * x + y * y <= left * left):
            return False
    return True


@kernel
def near_pairs(centres: Array, sizes: Array, reach: Array, grid: Grid) -> int:
    """Find pairs (one < other) whose circles meet; return how many, or -1 where place is short."""
    circles, listed, pairs, found = grid.circles, grid.listed, grid.pairs, 0
    if grid.n_listed[0] < 0 or not _all_within(centres, sizes, reach, circles):
        for b in range(len(sizes)):
            circles[b, 0], circles[b, 1] = centres[b]
            circles[b, 2] = sizes[b] + reach[b]
            circles[b, 2] += _WIDER * sizes[b] + min(_FARTHER * reach[b], sizes[b])
        grid.n_listed[0] = _list_pairs(grid)
    for i in range(grid.n_listed[0]):
        b, c = listed[i, 0], listed[i, 1]
        x, y = centres[b, 0] - centres[c, 0], centres[b, 1] - centres[c, 1]
        both = sizes[b] + reach[b] + (sizes[c] + reach[c])
        # Written whether or not: to guess which takes longer.
        pairs[found, 0], pairs[found, 1] = b, c
        found += 0 if x * x + y * y > both * both else 1
    return found if grid.n_listed[0] >= 0 else -1
