"""Copies of arrays by plain loops.

For an assignment to a slice numba compiles an error message about shapes, which takes two to three
seconds per process.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel


@kernel
def copy_numbers(source: Array, target: Array) -> None:
    """Copy numbers (n,) to the first n places of a row."""
    for i in range(len(source)):
        target[i] = source[i]


@kernel
def copy_counts(source: Ints, target: Ints) -> None:
    """Copy counts (n,) to the first n places of a row."""
    for i in range(len(source)):
        target[i] = source[i]


@kernel
def copy_rows(source: Array, target: Array) -> None:
    """Copy rows (m, n) to the first n places of the first m rows."""
    for i in range(source.shape[0]):
        for k in range(source.shape[1]):
            target[i, k] = source[i, k]


@kernel
def indices(chosen: Bools) -> Ints:
    """Return the indices of the true entries of an array (n,)."""
    count = 0
    for i in range(len(chosen)):
        if chosen[i]:
            count += 1
    found = np.empty(count, np.int64)
    count = 0
    for i in range(len(chosen)):
        if chosen[i]:
            found[count] = i
            count += 1
    return found
