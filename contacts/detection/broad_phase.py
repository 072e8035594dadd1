"""Which bodies are near each other: a hashed grid, linear in the bodies.

Bodies lie in cells as large as the largest of them; what is much larger than most is looked at
beside all others. Pairs come in order, so that contacts find theirs of the step before.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Ints
from statechart.kernels.jit import beside, part

# Bodies that reach farther than so many times the mean have no cell.
_LARGE = 4.0
# Cells for each body.
_CELLS = 2
# Multiplier of a cell's column (Teschner and others, Optimized spatial hashing, 2003).
_ACROSS = 73856093


class Grid(NamedTuple):
    """Where the search for pairs works.

    Attributes
    ----------
    cells : (b, 2) array of int
        Cell of every body; of a large one none.
    large : (b,) array of int
    heads, order : (c + 1,), (b,) array of int
        Bodies by the hash of their cells.
    pairs : (p, 2) array of int
        Those found, in order.
    """

    cells: Ints
    large: Ints
    heads: Ints
    order: Ints
    pairs: Ints

    @classmethod
    def room(cls, count: int, most: int) -> Grid:
        """Return place for so many bodies and pairs."""
        cells = 1 << (_CELLS * count).bit_length()
        return cls(
            np.empty((count, 2), np.int64),
            np.empty(count, np.int64),
            np.empty(cells + 1, np.int64),
            np.empty(count, np.int64),
            np.empty((most, 2), np.int64),
        )


@part
def _bucket(across: int, up: int, most: int) -> int:
    # Cells above each other have buckets beside each other: three are looked through at once.
    return (across * _ACROSS + up) & (most - 1)


@part
def _sorted_in(centres: Array, reach: Array, grid: Grid) -> int:
    """Put bodies into cells by a counting sort; return how many are large."""
    cells, large, heads, order, _ = grid
    count, most = len(reach), len(heads) - 1
    mean = 0.0
    for b in range(count):
        mean += reach[b] / count
    widest, many = 0.0, 0
    for b in range(count):
        if reach[b] > _LARGE * mean:
            large[many] = b
            many += 1
        else:
            widest = max(widest, reach[b])
    cell = 2.0 * widest if widest > 0.0 else 1.0
    for i in range(most + 1):
        heads[i] = 0
    for b in range(count):
        cells[b, 0] = cells[b, 1] = 0
        if reach[b] <= _LARGE * mean:
            # What is as far off as no number of a cell is beside all that are.
            cells[b, 0] = int(min(max(math.floor(centres[b, 0] / cell), -(2.0**30)), 2.0**30))
            cells[b, 1] = int(min(max(math.floor(centres[b, 1] / cell), -(2.0**30)), 2.0**30))
            heads[_bucket(cells[b, 0], cells[b, 1], most) + 1] += 1
    for i in range(most):
        heads[i + 1] += heads[i]
    for b in range(count - 1, -1, -1):
        if reach[b] <= _LARGE * mean:
            bucket = _bucket(cells[b, 0], cells[b, 1], most) + 1
            heads[bucket] -= 1
            order[heads[bucket]] = b
    for i in range(most):
        heads[i] = heads[i + 1]
    heads[most] = count - many
    return many


@beside
def near_pairs(centres: Array, reach: Array, grid: Grid) -> int:
    """Find pairs (one < other) whose circles meet; return how many, or -1 where place is short.

    Parameters
    ----------
    centres : (b, 2)
    reach : (b,)
        Radii of circles that hold all of a body until the next look.
    grid : Grid
        Is overwritten.
    """
    count, most = len(reach), len(grid.heads) - 1
    many = _sorted_in(centres, reach, grid)
    cells, large, heads, order, pairs = grid
    found, next_large = 0, 0
    for b in range(count):
        begin = found
        is_large = next_large < many and large[next_large] == b
        if is_large:
            next_large += 1
            for c in range(b + 1, count):
                if found == len(pairs):
                    return -1
                found = _if_near(centres, reach, b, c, found, pairs)
            continue
        for i in range(next_large, many):
            if found == len(pairs):
                return -1
            found = _if_near(centres, reach, b, large[i], found, pairs)
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
                        found = _if_near(centres, reach, b, c, found, pairs)
        for i in range(begin + 1, found):
            c, k = pairs[i, 1], i
            while k > begin and pairs[k - 1, 1] > c:
                pairs[k, 1] = pairs[k - 1, 1]
                k -= 1
            pairs[k, 1] = c
    return found


@part
def _if_near(centres: Array, reach: Array, b: int, c: int, found: int, pairs: Ints) -> int:
    """Write a pair if its circles meet; return how many there are then."""
    x, y = centres[b, 0] - centres[c, 0], centres[b, 1] - centres[c, 1]
    both = reach[b] + reach[c]
    if x * x + y * y > both * both:
        return found
    pairs[found, 0], pairs[found, 1] = b, c
    return found + 1
