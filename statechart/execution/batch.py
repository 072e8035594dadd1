"""Many runs of an automaton in one compiled call, as long as each of them is a usual one.

A row is a run: values of parameters. What is not usual, a start that is refused, an instant that a
loop would hand back, is not judged here: that row is left to a run of its own, with the same bits.
"""

from __future__ import annotations

from typing import NamedTuple

from statechart.arrays import Array, Bools, Ints

UNUSUAL, OTHER, ENDED, CLOSING, STOPPED, HANDED = range(6)
"""How a row ends: it is left to a run of its own; other parameters of it are zero than those that
the modes were solved for; at the end of the run; there, where it is to be judged whether something
just happens; at a stop; where the loop has handed a run back that is made alone."""

HOW, REASON, MARGIN, FIRST_MODE = range(4)
"""Columns of `BatchResult.ends`."""
ARCS, ARCS_END, EVENTS, EVENTS_END = range(4)
"""Columns of `BatchResult.spans`."""


class BatchResult(NamedTuple):
    """What rows gave beside their arcs and events, which stand in a block.

    Attributes
    ----------
    ends : (m, 4) array of int64
        How it ended, why the loop did, the margin that fell, the kind of the first mode.
    spans : (m, 4) array of int64
        Where its arcs and its events begin and end.
    now : (m, 6) array, place : (m, 6) array of int64
        Where it has come, see `statechart.execution.compiled_loop`.
    values : (m, p), initial, final : (m, n) array
        Its parameters, first and last state.
    entered : (m, k) array of bool
        The kinds of modes that it has been in.
    """

    ends: Ints
    spans: Ints
    now: Array
    place: Ints
    values: Array
    initial: Array
    final: Array
    entered: Bools


class BatchInputs(NamedTuple):
    """Rows for a compiled call.

    Attributes
    ----------
    inputs : (m, i) array
        What the numbers of a run are computed from.
    until : (m,) array
        When each ends; not a number where that is refused.
    zeros : (p,) array of bool
        Which parameters are exactly zero.
    most_jumps : int
    floor : float
        What is smaller counts as so large.
    alone : bool
        Whether a row is handed back as far as it has come.
    """

    inputs: Array
    until: Array
    zeros: Bools
    most_jumps: int
    floor: float
    alone: bool
