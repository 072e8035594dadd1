"""Copies of arrays by plain loops.

A slice that an array is assigned to makes numba compile a message on shapes that differ, which
takes it two to three seconds in every process that compiles one.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel


@kernel
def put(source: Array, target: Array) -> None:
    """Copy numbers (n,) to the first n places of a row."""
    for i in range(len(source)):
        target[i] = source[i]


@kernel
def put_counts(source: Ints, target: Ints) -> None:
    """Copy counts (n,) to the first n places of a row."""
    for i in range(len(source)):
        target[i] = source[i]


@kernel
def put_rows(source: Array, target: Array) -> None:
    """Copy rows (m, n) to the first n places of the first m rows."""
    for i in range(source.shape[0]):
        for k in range(source.shape[1]):
            target[i, k] = source[i, k]


@kernel
def indices(chosen: Bools) -> Ints:
    """Return where an array (n,) is true."""
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
