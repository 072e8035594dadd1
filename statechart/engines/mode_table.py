"""Modes as a table for compiled loops: tapes, kinds and tolerances of margins, memory of flows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Bools, Ints32
from statechart.kernels.jit import kernel
from statechart.kernels.search_memory import Memory, room
from statechart.kernels.tapes import TapeCode, tape_values

PLAIN, GAP, SPEED, FORCE = range(4)
KINDS = ("plain", "gap", "speed", "force")
"""Kinds of margins: their numbers, and their names in that order."""

EVALUATED = 8.0 * float(np.finfo(float).eps)
"""Round-off of an instant, and of a formula in parts of its terms."""
JUMP = 1e-9
"""A margin that jumps below zero is above this part of its first value just before."""

# A part of a variable that is more than it is off by.
_SMALL = 1e-9

TAPE = 9
"""Columns of a tape in a table: begin and number of operations, constants, outputs, reads; n_fixed.
"""

(ADDRESS, PARS, MARGINS_AT, MARGINS, STOPS, LAWS_AT) = range(6)
FIXED = 6
WATCHED = FIXED + TAPE
RATES = WATCHED + TAPE
WITHIN = RATES + TAPE
LIFT = WITHIN + TAPE
ANCHORS = LIFT + TAPE
PLACES_AT = ANCHORS + TAPE
COLUMNS = PLACES_AT + 1
"""Columns of a mode in a table. Address of heyoka's step; how many parameters it takes, the time
among them; where the kinds of its margins are listed, each with the place of a tolerance of its
own, how many, and which is the first stop; where the laws list what they know of it; tapes of these
parameters, of the margins and the rates behind them, of the rates alone, of what is to stay above
the room, of what follows from other variables, of its anchors; where the places of what follows are
listed."""


class Program(NamedTuple):
    """The modes of an automaton for compiled loops."""

    ints: Ints32  # shape (..,)
    # (..,): codes, outputs and reads of tapes, and their constants, one behind the other.
    floats: Array
    modes: NDArray[np.int64]  # (m, `COLUMNS`): rows of zeros are modes that have not been compiled.


@kernel
def tape_of(program: Program, row: NDArray[np.int64]) -> TapeCode:
    """Return a tape of a table."""
    ints, floats = program.ints, program.floats
    return TapeCode(
        ints[row[0] : row[0] + 3 * row[1]].reshape((row[1], 3)),
        floats[row[2] : row[2] + row[3]],
        ints[row[4] : row[4] + row[5]],
        ints[row[6] : row[6] + row[7]],
        row[8],
    )


@kernel
def evaluate(
    program: Program,
    row: NDArray[np.int64],
    state: Array,
    parameters: Array,
    time: float,
    result: Array,
) -> None:
    """Write the first outputs of a tape, as many as there is room for."""
    code, constants, outputs, _, _ = tape_of(program, row)
    tape_values(code, constants, outputs[: result.shape[0]], state, parameters, time, result)


@kernel
def stands(
    program: Program, mode: int, parameters: Array, floors: Array, state: Array, time: float
) -> bool:
    """Whether a flow may begin on the boundary of a stop condition, so that it is to be judged.

    See `statechart.execution.standing`; `floors` (n,) are small for the variables, and more than
    what they are off by.
    """
    row = program.modes[mode]
    first, margins = row[STOPS], row[MARGINS]
    if first == margins:
        return False
    code, constants, outputs, _, _ = tape_of(program, row[WATCHED : WATCHED + TAPE])
    stops, moved = outputs[first:margins], state.copy()
    values, others = np.empty(margins - first), np.empty(margins - first)
    reach = np.zeros(margins - first)
    tape_values(code, constants, stops, state, parameters, time, values)
    for v in range(state.shape[0]):
        moved[v] += max(floors[v], _SMALL * abs(state[v]))
        tape_values(code, constants, stops, moved, parameters, time, others)
        moved[v] = state[v]
        for i in range(reach.shape[0]):
            reach[i] += abs(others[i] - values[i])
    near = False
    for i in range(reach.shape[0]):
        near = near or not abs(values[i]) > reach[i]
    return near


class Scratch(NamedTuple):
    """Memory of a flow: its steps, as in `statechart.engines.path.Path`, and their first states."""

    # Of the steps; times[0] is 0.
    times: Array  # shape (s + 1,)
    coefficients: Array  # shape (s, n, terms)
    # of shape (n,) each
    state: Array
    ended: Array
    pars: Array  # (p,): at least as many as any mode takes.
    clock: Array  # shape (2,)
    series: Array  # shape (n, terms)
    # Of the length of a step.
    powers: Array  # shape (terms,)
    length: Array  # shape (1,)
    # (n,): of a step, see `statechart.engines.taylor_loop.stray`.
    offs: Array
    sizes: Array
    doubtful: Bools  # (s,): steps.
    # (m,): of margins; at least as many as any mode has, likewise for what follows.
    tolerances: Array
    searched: Memory
    whole: Array  # (r, 6): ranges over a step.


def scratch(
    steps: int, terms: int, modes: NDArray[np.int64], variables: int, parameters: int
) -> Scratch:
    """Return memory for flows of so many steps, in modes as those of a `Program`."""
    _, operations, _, constants, _, outputs = modes[:, WATCHED : WATCHED + 6].max(axis=0).tolist()
    registers = variables + 1 + parameters + constants + operations
    return Scratch(
        np.zeros(steps + 1),
        np.empty((steps, variables, terms)),
        np.empty(variables),
        np.empty(variables),
        np.empty(modes[:, PARS].max()),
        np.zeros(2),
        np.empty((variables, terms)),
        np.empty(terms),
        np.empty(1),
        np.empty(variables),
        np.empty(variables),
        np.empty(steps, np.bool_),
        np.empty(modes[:, MARGINS].max()),
        Memory(*room(registers, operations, outputs, variables)),
        np.empty((registers, 6)),
    )


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
    """Write the tolerances to search with first: see `statechart.execution.finding`.

    Also writes the margins at the start if one of them is plain.
    """
    plain = False
    for i in range(row[MARGINS]):
        tolerances[i] = usual[i]
        plain = plain or program.ints[row[MARGINS_AT] + 2 * i] == PLAIN
    if plain:
        evaluate(program, row[WATCHED : WATCHED + TAPE], initial, watch.parameters, start, margins)
        for i in range(row[MARGINS]):
            if program.ints[row[MARGINS_AT] + 2 * i] == PLAIN and margins[i] > usual[i]:
                tolerances[i] = 0.0
