"""Running ahead in compiled code: the modes of a run as arrays, and how a loop over them ends.

The loop itself is that of the laws (`statechart.automaton.laws.Ordinary`), which know what a usual
instant is. What it does not do, the execution does, and lets it go on from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from statechart import interrupts
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.automaton.laws import Flow, Ordinary, Setup, roles_in
from statechart.automaton.recording import Block, Event, Kind
from statechart.automaton.trace import Clock, Jump, Key, Roles
from statechart.engines.engine import Engine, Entry, Pace
from statechart.engines.whole_flow import (
    COLUMNS,
    KINDS,
    LAWS_AT,
    TAPE,
    Program,
    Scratch,
    scratch,
)
from statechart.execution.compiled_modes import CompiledMode
from statechart.execution.flow import floors
from statechart.formulas.tape import Tape
from statechart.kernels.polynomials import summands

if TYPE_CHECKING:
    from statechart.execution.execution import Execution
    from statechart.execution.rows import Found, Rows

OVER, FELL, FLOW, FULL, PAUSED, COUNTED, ACCUMULATES = range(7)
"""Why a compiled loop ends: the run is over; a margin fell, and what follows is to be decided; the
flow from here has to be made step by step; the pad is full; to be looked at; the jumps are to be
counted; they accumulate."""

T_HIGH, T_LOW, T_END, T_HORIZON, T_SINCE = range(5)
"""Where a loop is: the clock, when the run ends, how far to look ahead, when the last jump was."""
N_MODE, N_JUMPS, N_MOST, N_STEPS, N_BOXES, N_ASKED = range(6)
"""Likewise: the row of its mode, the number of jumps, the most of them, steps and boxes so far;
1 where an instant is under way, and the laws are to be asked again."""

AHEAD = 16.0
"""How far to look ahead at first, in lengths of the last flow: those of bounces shrink."""

# Loops that are not compiled yet are, once so many flows could have been theirs: about two seconds.
_WORTH = 2000
# Steps of a flow that is made whole, and what they may take of a pad.
_STEPS, _PART = 512, 1 << 17


class Modes:
    """The modes of a simulator for one set of zero parameters, as a `Program`; grows.

    Parameters
    ----------
    ordinary : Ordinary
        Of the laws.
    engine : Engine
    stops : int
        Margins that end a run; they stand last.

    Attributes
    ----------
    kinds : list of (Key, Roles)
        Of every row; those of other flows of the runs stand between them.
    """

    def __init__(self, ordinary: Ordinary, engine: Engine, stops: int) -> None:
        self.kinds: list[Kind] = []
        self._ordinary, self._engine, self._stops = ordinary, engine, stops
        self._compiled: dict[Kind, CompiledMode] = {}
        self._entries: dict[Kind, Entry] = {}
        self._bands: dict[str, int] = {}
        self._memory: Scratch | None = None
        self._loop: Loop | None = None
        self._asked, self._worth = 0, False
        self._calls: dict[tuple[str, ...], RowCall | None] = {}
        self._rows_asked, self._rows_worth = 0, False

    def compiled(self, kind: Kind) -> CompiledMode:
        """Return a mode that was added."""
        return self._compiled[kind]

    def knows(self, kind: Kind) -> bool:
        """Whether loops can go through a mode."""
        return kind in self._compiled

    def about(self, event: Event) -> tuple[str, str]:
        """Return the region that an event of a loop is about, and its cause."""
        return self._ordinary.about(event)

    def jump(self, setup: Setup, event: Event) -> Jump:
        """Return the jump of an event that a loop has made, in a run with these numbers."""
        names = self._compiled[event.source, roles_in(event.source)].names
        fired = names[event.fired] if event.fired >= 0 else ""
        return self._ordinary.jump(setup, event, fired)

    def add(self, mode: Key, roles: Roles, compiled: CompiledMode) -> None:
        """Make a mode known, if loops can go through it."""
        kind = mode, roles
        if kind in self._compiled or self._ordinary.listed(*kind, compiled.names) is None:
            return
        entry = self._engine.entry(compiled.stepper)
        if entry is not None:
            self._compiled[kind], self._entries[kind] = compiled, entry
            self._loop = None
            self._calls.clear()

    def rows(self, names: tuple[str, ...], count: int) -> RowCall | None:
        """Return the call for so many runs with values of some parameters; None where none is.

        As a loop it is compiled once it is worth that.
        """
        self._rows_asked += count
        if not self._rows_worth:
            self._rows_worth = self._rows_asked > _WORTH or self._ordinary.rows_compiled()
        if not self._rows_worth or not self._compiled:
            return None
        if names not in self._calls:
            if self._loop is None:
                self._loop = self._made()
            self._calls[names] = self._ordinary.rows(self._loop, names, self._engine.tolerance)
        return self._calls[names]

    def tolerances(self, setup: Setup) -> Mapping[str, float]:
        """Return the margins that have a tolerance of their own in a run, with it."""
        return self._ordinary.tolerances(setup)

    def loop(self, mode: Key, roles: Roles) -> Loop | None:
        """Return what loops run through from a flow on; None where they cannot enter it."""
        if (mode, roles) not in self._compiled:
            return None
        self._asked += 1
        if not self._worth:
            self._worth = self._asked > _WORTH or self._ordinary.compiled()
        if not self._worth:
            return None
        if self._loop is None:
            self._loop = self._made()
        return self._loop

    def _made(self) -> Loop:
        packed = Packed()
        known = set(self.kinds)
        self.kinds += [kind for kind in self._compiled if kind not in known]
        rows = np.zeros((len(self.kinds), COLUMNS), np.int64)
        rows[:, LAWS_AT] = -1
        for kind, compiled in self._compiled.items():
            entry = self._entries[kind]
            margins = [
                (KINDS.index(how), self._bands.setdefault(name, len(self._bands)))
                for name, how in compiled.watched
            ]
            listed = self._ordinary.listed(*kind, compiled.names)
            assert listed is not None
            within = self._ordinary.within(kind[0])
            row = rows[self.kinds.index(kind)]
            row[:] = (
                entry.address,
                packed.ints(entry.used),
                entry.takes,
                packed.ints(np.ravel(margins)),
                len(margins),
                len(margins) - self._stops,
                packed.ints(listed),
                *packed.tape(compiled.guards),
                *packed.tape(compiled.rates),
                *(packed.tape(within) if within is not None else _NO_TAPE),
                *packed.tape(compiled.lifting.tape),
                *packed.tape(compiled.lifting.anchors),
                packed.ints(compiled.lifting.places),
            )
        tapes = np.array([packed.tape(tape) for tape in self._ordinary.tapes], np.int64)
        # Of one engine, and so of one order.
        pace, memory = entry.pace, self._memory
        if memory is None:
            numbers = self._ordinary.tapes[0]
            steps = max(min(_STEPS, _PART // (numbers.n_variables * pace.terms)), 1)
            memory = scratch(steps, numbers.n_variables, numbers.n_parameters, pace.terms)
            self._memory = memory
        return Loop(
            packed.program(rows), tapes, pace, memory, tuple(self._bands), tuple(self.kinds)
        )


class RowCall(Protocol):
    """Runs rows of values of some parameters in one call."""

    @property
    def loop(self) -> Loop:
        """What they go through."""
        ...

    def inputs(self, table: Array) -> Array:
        """Return what the numbers of runs are computed from (m, i), of rows (m, p) of values."""
        ...

    def run(self, rows: Rows, block: Block, found: Found) -> int:
        """Make runs; return how many of them before the block was full."""
        ...


class Loop(NamedTuple):
    """What compiled loops run through.

    Attributes
    ----------
    program : Program
    tapes : (t, 9) array of int64
        The laws' own.
    pace : Pace
    memory : Scratch
    margins : tuple of str
        Whose tolerances a run may set one by one, in their order.
    kinds : tuple of (Key, Roles)
        Of the rows of the program.
    """

    program: Program
    tapes: NDArray[np.int64]
    pace: Pace
    memory: Scratch
    margins: tuple[str, ...]
    kinds: tuple[Kind, ...]


_NO_TAPE = (0,) * TAPE


class Packed:
    """Arrays one behind the other."""

    def __init__(self) -> None:
        self._ints: list[Ints32] = []
        self._floats: list[Array] = []
        self._sizes = [0, 0]

    def ints(self, array: ArrayLike) -> int:
        """Add whole numbers; return where they begin."""
        array = np.asarray(array, np.int32).ravel()
        self._ints.append(array)
        self._sizes[0] += array.size
        return self._sizes[0] - array.size

    def tape(self, tape: Tape) -> tuple[int, ...]:
        """Add a tape; return its columns."""
        self._floats.append(tape.constants)
        self._sizes[1] += len(tape.constants)
        return (
            self.ints(tape.code),
            len(tape.code),
            self._sizes[1] - len(tape.constants),
            len(tape.constants),
            self.ints(tape.outputs),
            len(tape.outputs),
            self.ints(tape.reads),
            len(tape.reads),
            tape.n_fixed,
        )

    def program(self, modes: Ints) -> Program:
        """Return all of it."""
        return Program(*self.arrays(), modes)

    def arrays(self) -> tuple[Ints32, Array]:
        """Return whole numbers and floats, one behind the other."""
        ints, floats = [np.zeros(0, np.int32), *self._ints], [np.zeros(0), *self._floats]
        return np.concatenate(ints), np.concatenate(floats)


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

    def go(self, run: Execution) -> tuple[str, ...] | None:
        """Go on from a flow; return what fired, or nothing at the end of the run.

        None where the flow that the run has come to is to be made step by step.
        """
        while True:
            assert run.flow is not None
            if not self._ordinary.takes(self._setup, run.flow):
                return None
            loop = self.modes.loop(run.flow.mode, run.flow.roles)
            if loop is None:
                return None
            reason, margin, rest = self._advance(run, loop)
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

    def _advance(self, run: Execution, loop: Loop) -> tuple[int, int, float]:
        """Call the loop once; bring the run to where it has come."""
        flow, record = run.flow, run.record
        assert flow is not None
        if loop is not self._loop or self._call is None:
            self._loop = loop
            self._call = self._ordinary.ready(self._setup, loop, floors(run.engine, len(run.state)))
            self._entered = np.zeros(len(loop.kinds), np.bool_)
        since = record.jumps[-1].t if record.jumps else 0.0
        now = np.array([*run.clock, run.until, run.horizon, since])
        row, count = loop.kinds.index((flow.mode, flow.roles)), len(record.jumps)
        place = np.array([row, count, run.max_jumps, 0, 0, 0])
        state, flown = run.state.copy(), len(record.arcs)
        reason, margin, rest = self._call(
            record.memory, now, place, state, run.accumulation.series, self._entered
        )
        for k, been in enumerate(self._entered.tolist()):
            roles = loop.kinds[k][1]
            if been and roles not in run.entered:
                run.entered[roles] = self.modes.compiled(loop.kinds[k])
        if reason == FULL:
            record.seal()
        run.clock, run.state = Clock(*now[: T_LOW + 1].tolist()), state
        run.horizon = now.item(T_HORIZON)
        run.steps += place.item(N_STEPS)
        run.boxes += place.item(N_BOXES)
        run.show()
        interrupts.check()
        jumped, flew = place.item(N_JUMPS) > count, len(record.arcs) > flown
        if jumped:
            mode, roles = loop.kinds[place.item(N_MODE)]
            settled = place.item(N_ASKED) == 0
            flow = Flow(mode, roles, settled=settled, tolerances=flow.tolerances)
        if reason == OVER or (reason == FELL and margin >= 0):
            terms = flow.terms
            if flew and record.arcs[-1].j == place.item(N_JUMPS):
                arc = record.arcs[-1]
                terms = summands(arc.times, arc.coefficients)
            flow = flow._replace(settled=False, terms=terms, warning="", notes=(), start=None)
        run.flow = flow
        return reason, margin, rest
