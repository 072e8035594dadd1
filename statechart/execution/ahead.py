"""Running ahead in compiled code: the modes of a run as arrays, and how a loop over them ends.

The loop itself is that of the laws (`statechart.automaton.laws.Ordinary`), which know what a usual
instant is. What it does not do, the execution does, and lets it go on from there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from statechart import interrupts
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.clock import Clock
from statechart.automaton.laws import Flow, Ordinary, Setup
from statechart.automaton.trace_store import Kind
from statechart.execution.flow import floors
from statechart.execution.loops import Loop, Modes
from statechart.kernels.polynomials import summands

if TYPE_CHECKING:
    from statechart.execution.execution import Execution

OVER, FELL, FLOW, FULL, PAUSED, COUNTED, ACCUMULATES = range(7)
"""Why a compiled loop ends: the run is over; a margin fell, and what follows is to be decided; the
flow from here has to be made step by step; the pad is full; to be looked at; the jumps are to be
counted; they accumulate."""

T_HIGH, T_LOW, T_END, T_HORIZON, T_SINCE, T_REST = range(6)
"""Where a loop is: the clock, when the run ends, how far to look ahead, when the last jump was; the
time to an accumulation, as it ends."""
N_MODE, N_JUMPS, N_MOST, N_STEPS, N_BOXES, N_ASKED = range(6)
"""Likewise: the row of its mode, the number of jumps, the most of them, steps and boxes so far;
1 where an instant is under way, and the laws are to be asked again."""

AHEAD = 16.0
"""How far to look ahead at first, in lengths of the last flow: those of bounces shrink."""


class Made(NamedTuple):
    """What a loop has made of a run.

    Attributes
    ----------
    kinds : tuple of (Key, Roles)
        Of the modes.
    reason, margin : int
        Why it ended, and the margin that fell, or the series that accumulates.
    now : (6,) array, place : (6,) array of int64, state : (n,) array
        Where it has come.
    entered : (k,) array of bool
        The kinds that the run has been in.
    jumps, arcs : int
        Of the run before.
    """

    kinds: tuple[Kind, ...]
    reason: int
    margin: int
    now: Array
    place: Ints
    state: Array
    entered: Bools
    jumps: int = 0
    arcs: int = 0


class Begun(NamedTuple):
    """How far a loop has taken a run from its start.

    Attributes
    ----------
    kind : (Key, Roles)
        Of the first mode.
    made : Made
    series : (s, ..) array
        Of jumps, see `statechart.execution.zeno`.
    """

    kind: Kind
    made: Made
    series: Array


class Ahead:
    """Lets compiled loops take one run as far as they can.

    Parameters
    ----------
    ordinary : Ordinary
        Of the laws.
    modes : Modes
        What loops run through.
    setup : Setup
        The numbers of the run.
    """

    def __init__(self, ordinary: Ordinary, modes: Modes, setup: Setup) -> None:
        self.modes, self._ordinary, self._setup = modes, ordinary, setup
        self._loop: Loop | None = None
        self._call: Callable[..., tuple[int, int, float]] | None = None
        self._entered: Bools = np.zeros(0, np.bool_)

    def go(self, run: Execution, made: Made | None = None) -> tuple[str, ...] | None:
        """Go on from a flow; return what fired, or nothing at the end of the run.

        None where the flow that the run has come to is to be made step by step.
        """
        while True:
            if made is None:
                if not self._ordinary.takes(self._setup, run.flow, run.state, run.clock.high):
                    return None
                loop = self.modes.loop(run.flow.mode, run.flow.roles)
                if loop is None:
                    return None
                made = self._advance(run, loop)
            self._reached(run, made)
            reason, margin, rest = made.reason, made.margin, made.now.item(T_REST)
            made = None
            if reason in (FULL, PAUSED):
                continue
            if reason == OVER:
                return ()
            if reason == FLOW:
                return None
            if reason == FELL and margin >= 0:
                return run.fell(self.modes.compiled((run.flow.mode, run.flow.roles)), margin)
            if reason == ACCUMULATES:
                run.accumulated(margin, rest)
            if reason in (ACCUMULATES, COUNTED) and run.counted():
                return ()
            if not run.flow.settled and run.settle():
                return ()

    def _advance(self, run: Execution, loop: Loop) -> Made:
        """Call the loop once."""
        flow, record = run.flow, run.record
        assert flow is not None
        if loop is not self._loop or self._call is None:
            self._loop = loop
            self._call = self._ordinary.ready(self._setup, loop, floors(run.engine, len(run.state)))
            self._entered = np.zeros(len(loop.kinds), np.bool_)
        since = record.jumps[-1].t if record.jumps else 0.0
        now = np.array([*run.clock, run.until, run.horizon, since, 0.0])
        row, count = loop.kinds.index((flow.mode, flow.roles)), len(record.jumps)
        place = np.array([row, count, run.max_jumps, 0, 0, 0])
        state, flown = run.state.copy(), len(record.arcs)
        reason, margin, now[T_REST] = self._call(
            record.buffer, now, place, state, run.accumulation.series, self._entered
        )
        return Made(loop.kinds, reason, margin, now, place, state, self._entered, count, flown)

    def _reached(self, run: Execution, made: Made) -> None:
        """Bring a run to where a loop has come."""
        flow, record, now, place = run.flow, run.record, made.now, made.place
        assert flow is not None
        for kind, been in zip(made.kinds, made.entered.tolist(), strict=True):
            if been and kind[1] not in run.entered:
                run.entered[kind[1]] = self.modes.compiled(kind)
        if made.reason == FULL:
            record.seal()
        run.clock, run.state = Clock(*now[: T_LOW + 1].tolist()), made.state
        run.horizon = now.item(T_HORIZON)
        run.steps += place.item(N_STEPS)
        run.boxes += place.item(N_BOXES)
        run.show()
        interrupts.check()
        jumped, flew = place.item(N_JUMPS) > made.jumps, len(record.arcs) > made.arcs
        if jumped:
            mode, roles = made.kinds[place.item(N_MODE)]
            settled = place.item(N_ASKED) == 0
            tolerances = self._ordinary.tolerances(self._setup, run.state, run.clock.high)
            flow = Flow(mode, roles, settled=settled, tolerances=tolerances)
        if made.reason == OVER or (made.reason == FELL and made.margin >= 0):
            terms = flow.terms
            if flew and record.arcs[-1].j == place.item(N_JUMPS):
                arc = record.arcs[-1]
                terms = summands(arc.times, arc.coefficients)
            flow = flow._replace(settled=False, terms=terms, warning="", notes=(), start=None)
        run.flow = flow
