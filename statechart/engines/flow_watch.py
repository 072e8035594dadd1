"""The margins of a flow in compiled code: their kinds, their tolerances, their values."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.engines.mode_table import MARGINS, MARGINS_AT, TAPE, WATCHED, Program, tape_of
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import tape_values

PLAIN, GAP, SPEED, FORCE = range(4)
KINDS = ("plain", "gap", "speed", "force")
"""Kinds of margins: their numbers, and their names in that order."""

EVALUATED = 8.0 * float(np.finfo(float).eps)
"""Round-off of an instant, and of a formula in parts of its terms."""
JUMP = 1e-9
"""A margin that jumps below zero is above this part of its first value just before."""


class Watch(NamedTuple):
    """Numbers that the search of a flow needs, beside its margins."""

    parameters: Array  # shape (p,)
    kinds: Array  # (4,): tolerance of each kind of margin.
    bands: Array  # (b,): tolerances of single margins; -1 where that of the kind is the one.
    floors: Array  # (n,): what is smaller counts as so large.
    off: NDArray[np.int64]  # (9,): tape of the constraints.
    # (k,): of the constraints.
    targets: Array
    weights: Array
    room: float  # How far what is to stay above zero may fall.


@kernel
def usual_tolerances(
    program: Program, row: NDArray[np.int64], watch: Watch, tolerances: Array
) -> None:
    """Write the tolerance of every margin: its own, or that of its kind."""
    for i in range(row[MARGINS]):
        own = watch.bands[program.ints[row[MARGINS_AT] + 2 * i + 1]]
        tolerances[i] = own if own >= 0.0 else watch.kinds[program.ints[row[MARGINS_AT] + 2 * i]]


@kernel
def first_tolerances(
    program: Program,
    row: NDArray[np.int64],
    watch: Watch,
    initial: Array,
    start: float,
    usual: Array,
    margins: Array,
    tolerances: Array,
) -> None:
    """Write the tolerances to search with first: see `statechart.execution.shallow_falls`.

    Also writes the margins at the start if one of them is plain.
    """
    plain = False
    for i in range(row[MARGINS]):
        tolerances[i] = usual[i]
        plain = plain or program.ints[row[MARGINS_AT] + 2 * i] == PLAIN
    if plain:
        _margins_at(program, row, watch, initial, start, margins)
        for i in range(row[MARGINS]):
            if program.ints[row[MARGINS_AT] + 2 * i] == PLAIN and margins[i] > usual[i]:
                tolerances[i] = 0.0


@kernel
def _margins_at(
    program: Program,
    row: NDArray[np.int64],
    watch: Watch,
    state: Array,
    time: float,
    margins: Array,
) -> None:
    """Write the margins in a state."""
    code, constants, outputs, _, _ = tape_of(program, row[WATCHED : WATCHED + TAPE])
    guards = outputs[: row[MARGINS]]
    tape_values(code, constants, guards, state, watch.parameters, time, margins)
