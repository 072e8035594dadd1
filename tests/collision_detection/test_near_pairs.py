"""Near pairs equal a brute-force search, with any earlier list."""

from __future__ import annotations

import numpy as np
import pytest

from contacts.collision_detection.broad_phase import Grid, near_pairs
from statechart.arrays import Array


def of_all(centres: Array, radii: Array) -> list[list[int]]:
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1)
    one, other = np.nonzero(np.triu(apart <= radii[:, None] + radii, 1))
    return np.stack([one, other], 1).tolist()


@pytest.mark.parametrize("large", [0, 3])
@pytest.mark.parametrize("seed", range(3))
def test_pairs_are_those_of_brute_force_as_bodies_move(seed: int, large: int) -> None:
    random = np.random.default_rng(seed)
    count, listings, last = 60, 0, np.zeros(0)
    sizes = random.uniform(0.2, 0.6, count)
    sizes[:large] = 5.0
    centres, rates = random.uniform(-5.0, 5.0, (count, 2)), random.normal(0.0, 0.02, (count, 2))
    grid = Grid.allocate(count, 4000)
    for k in range(40):
        centres += rates
        if k == 20:  # one is somewhere else
            centres[7] = [-4.0, 4.0]
        if k == 30:  # another goes fast all of a sudden
            rates[9] *= 40.0
        reach = 2.0 * np.linalg.norm(rates, axis=1)
        found = near_pairs.py_func(centres, sizes, reach, grid)
        assert grid.pairs[:found].tolist() == of_all(centres, sizes + reach)
        listings += not np.array_equal(last, grid.circles)
        last = grid.circles.copy()
    assert 3 <= listings < 25


def test_a_too_small_buffer_is_reported_until_it_suffices() -> None:
    centres, sizes = np.zeros((5, 2)), np.ones(5)
    assert near_pairs.py_func(centres, sizes, np.zeros(5), Grid.allocate(5, 9)) == -1
    grid = Grid.allocate(5, 10)
    assert near_pairs.py_func(centres, sizes, np.zeros(5), grid) == 10
    assert near_pairs.py_func(centres + 9.0, sizes, np.zeros(5), grid) == 10
