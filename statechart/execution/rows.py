"""Many runs of an automaton in one compiled call, as long as each of them is a usual one.

A row is a run: values of parameters. What is not usual, a start that is refused, an instant that a
loop would hand back, is not judged here: that row is left to a run of its own, with the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart import interrupts
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.laws import Setup
from statechart.automaton.trace import Jump, Outcome
from statechart.automaton.trace_store import TraceBuffer, arc_polynomials, event_of
from statechart.execution.ahead import N_JUMPS, N_MODE, T_HIGH, Begun, Made
from statechart.execution.finding import closing
from statechart.kernels.polynomials import summands

if TYPE_CHECKING:
    from statechart.automaton.trace_store import Kind
    from statechart.execution.loops import Modes
    from statechart.execution.simulator import Simulator

UNUSUAL, OTHER, ENDED, CLOSING, STOPPED, HANDED = range(6)
"""How a row ends: it is left to a run of its own; other parameters of it are zero than those that
the modes were solved for; at the end of the run; there, where it is to be judged whether something
just happens; at a stop; where the loop has handed a run back that is made alone."""

HOW, REASON, MARGIN, FIRST_MODE = range(4)
"""Columns of `Found.ends`."""
ARCS, ARCS_END, EVENTS, EVENTS_END = range(4)
"""Columns of `Found.spans`."""

# Rows of one call: tens of milliseconds, between which a signal is heard.
_AT_ONCE = 256


class Found(NamedTuple):
    """What rows gave beside their arcs and events, which stand in a block.

    Attributes
    ----------
    ends : (m, 4) array of int64
        How it ended, why the loop did, the margin that fell, the kind of the first mode.
    spans : (m, 4) array of int64
        Where its arcs and its events begin and end.
    now : (m, 6) array, place : (m, 6) array of int64
        Where it has come, see `statechart.execution.ahead`.
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


class Rows(NamedTuple):
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


class Batch(NamedTuple):
    """Rows that have gone through; valid until the next of them are made.

    Attributes
    ----------
    rows : (m,) array of int
        Which they are.
    found : Found
        Of them alone.
    block : TraceBuffer
        Holds their arcs and events, and others.
    kinds : tuple of (Key, Roles)
        Of the modes.
    modes : Modes
    zeros : frozenset of int
        Places of the parameters that are exactly zero.
    series : (s, ..) array
        Of the jumps of the last row, see `statechart.execution.zeno`.
    """

    rows: NDArray[np.intp]
    found: Found
    block: TraceBuffer
    kinds: tuple[Kind, ...]
    modes: Modes
    zeros: frozenset[int]
    series: Array

    @property
    def stopped(self) -> Bools:
        """Which rows (m,) a stop has ended."""
        return np.asarray(self.found.ends[:, HOW] == STOPPED)

    def begun(self) -> Begun:
        """Return how far a run has come that was made alone."""
        found = self.found
        reason, margin, first = found.ends[0, REASON:].tolist()
        made = Made(
            self.kinds, reason, margin, found.now[0], found.place[0], found.final[0],
            found.entered[0],
        )  # fmt: skip
        return Begun(self.kinds[first], made, self.series.copy())

    def outcome(self, row: int) -> Outcome:
        """Return why a row ended."""
        return Outcome.STOPPED if self.found.ends[row, HOW] == STOPPED else Outcome.HORIZON


class RowRunner:
    """Runs rows of values of some parameters.

    Parameters
    ----------
    simulator : Simulator
        Whose modes they go through, those that runs of it have entered.
    names : sequence of str
        The parameters.

    Attributes
    ----------
    simulator : Simulator
    """

    def __init__(self, simulator: Simulator, names: Sequence[str]) -> None:
        self.simulator, self._names = simulator, tuple(names)
        self._gone: dict[frozenset[int], Bools] = {}

    def ready(self, count: int) -> bool:
        """Whether so many rows can be run: the call for them is compiled, or worth that now."""
        return any(modes.rows(self._names, count) for _, modes in self.simulator.known())

    def run(self, table: Array, until: Array, max_jumps: int) -> Iterator[Batch]:
        """Run rows; yield those that have gone through, in batches."""
        left = np.arange(len(table))
        for zeros, modes in self.simulator.known():
            if not left.size:
                return
            others: list[NDArray[np.intp]] = []
            done = 0
            while done < left.size:
                interrupts.check()
                part = left[done : done + _AT_ONCE]
                batch = self._called(
                    modes, zeros, part, table[part], until[part], max_jumps, alone=False
                )
                if batch is None:
                    others.append(left[done:])
                    break
                how = batch.found.ends[:, HOW]
                done += len(how)
                others.append(batch.rows[how == OTHER])
                kept = np.flatnonzero(self._judged(batch, table[batch.rows]))
                if kept.size:
                    found = Found._make([array[kept] for array in batch.found])
                    yield batch._replace(rows=batch.rows[kept], found=found)
            left = np.concatenate(others)

    def alone(self, values: Array, until: float, max_jumps: int) -> Batch | None:
        """Make one run, as far as a loop takes it."""
        row = np.zeros(1, np.intp)
        for zeros, modes in self.simulator.known():
            batch = self._called(
                modes, zeros, row, values[None], np.array([until]), max_jumps, alone=True
            )
            how = OTHER if batch is None else batch.found.ends.item(HOW)
            if how != OTHER:
                return None if how == UNUSUAL else batch
        return None

    def _called(
        self,
        modes: Modes,
        zeros: frozenset[int],
        rows: NDArray[np.intp],
        table: Array,
        until: Array,
        max_jumps: int,
        *,
        alone: bool,
    ) -> Batch | None:
        """Make as many rows as there is room for; None where none can be made."""
        simulator = self.simulator
        automaton, engine = simulator.automaton, simulator.engine
        call = modes.rows(self._names, len(rows))
        if call is None or not isinstance(engine.floor, float):
            return None
        m, kinds = len(rows), call.loop.kinds
        p, n = len(automaton.parameters), len(automaton.variables)
        found = Found(
            np.zeros((m, 4), np.int64),
            np.zeros((m, 4), np.int64),
            np.zeros((m, 6)),
            np.zeros((m, 6), np.int64),
            np.empty((m, p)),
            np.empty((m, n)),
            np.empty((m, n)),
            np.zeros((m, len(kinds)), np.bool_),
        )
        gone = self._gone.get(zeros)
        if gone is None:
            gone = self._gone[zeros] = np.zeros(p, np.bool_)
            gone[list(zeros)] = True
        asked = Rows(call.inputs(table), until, gone, max_jumps, engine.floor, alone)
        block = simulator.buffer
        block.used[:] = 0
        made = max(call.run(asked, block, found), 1)
        if made < m:
            found = Found._make([array[:made] for array in found])
        return Batch(rows[:made], found, block, kinds, modes, zeros, call.series)

    def _judged(self, batch: Batch, table: Array) -> Bools:
        """Return which rows (m,) have gone through: nothing just happens as they end."""
        how = batch.found.ends[:, HOW]
        kept = np.asarray((how == ENDED) | (how == STOPPED))
        for row in np.flatnonzero(how == CLOSING).tolist():
            kept[row] = not self._closing(batch, row, table[row])
        return kept

    def _closing(self, batch: Batch, row: int, values: Array) -> bool:
        """Whether something may just be happening as a row ends (see `closing`)."""
        found, block, simulator = batch.found, batch.block, self.simulator
        setup = self.setup(values)
        kind = batch.kinds[found.place[row, N_MODE]]
        terms = None
        size = len(simulator.automaton.variables)
        arc = int(found.spans[row, ARCS_END]) - 1
        if arc >= found.spans[row, ARCS] and block.arcs[arc, 1] == found.place[row, N_JUMPS]:
            terms = summands(*arc_polynomials(block, arc, size))
        final, time = found.final[row], float(found.now[row, T_HIGH])
        flow = batch.modes.flow(setup, kind, final, time, terms)
        compiled = batch.modes.compiled(kind)
        happens, _ = closing(simulator.engine, compiled, flow, setup, final, time)
        return happens

    def jump(self, batch: Batch, table: Array, row: int, j: int) -> Jump:
        """Return a jump of a row of a batch, of the values `table`, before which there were `j`."""
        event = event_of(batch.block, int(batch.found.spans[row, EVENTS]) + j, j, batch.kinds)
        return batch.modes.jump(partial(self.setup, table[row]), event)

    def setup(self, values: Array) -> Setup:
        """Return the numbers of a row's run."""
        overrides: Mapping[str, float] = dict(zip(self._names, values.tolist(), strict=True))
        return self.simulator.automaton.setup(overrides, self.simulator.engine.tolerance)
