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
    """Results of a batch besides arcs and events, which stand in a block."""

    # (m, 4): how it ended, why the loop did, the margin that fell, the kind of the first mode.
    ends: Ints
    spans: Ints  # (m, 4): where its arcs and its events begin and end.
    # (m, 6): where it has come, see `statechart.execution.compiled_loop`.
    now: Array
    place: Ints
    # Its parameters, first and last state.
    values: Array  # shape (m, p)
    initial: Array  # shape (m, n)
    final: Array  # shape (m, n)
    entered: Bools  # (m, k): the kinds of modes that it has been in.


class BatchInputs(NamedTuple):
    """Rows for a compiled call."""

    inputs: Array  # (m, i): what the numbers of a run are computed from.
    until: Array  # (m,): when each ends; not a number where that is refused.
    zeros: Bools  # (p,): which parameters are exactly zero.
    most_jumps: int
    floor: float  # What is smaller counts as so large.
    alone: bool  # Whether a row is handed back as far as it has come.
