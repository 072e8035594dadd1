"""The compiled loop: modes of a run as arrays, and calls of the loop that the laws have over them.

The loop is that of the laws (`statechart.automaton.laws.CompiledLaws`), which know which instants
are unambiguous. It returns why it ended, and the execution alone acts on that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import CompiledLaws, Flow, Setup, roles_in
from statechart.automaton.trace import Jump, Key, Roles
from statechart.automaton.trace_store import Kind, RecordedEvent, TraceBuffer
from statechart.engines.engine import Engine, Entry, Pace
from statechart.engines.flow_watch import KINDS
from statechart.engines.mode_table import COLUMNS, LAWS_AT, TAPE, Program, Scratch, scratch
from statechart.execution.batch import BatchInputs, BatchResult
from statechart.execution.compiled_modes import CompiledMode
from statechart.formulas.tape import Tape

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

LOOK_AHEAD = 16.0
"""How far to look ahead at first, in lengths of the last flow: those of bounces shrink."""


class LoopResult(NamedTuple):
    """Result of a compiled loop."""

    kinds: tuple[Kind, ...]  # Of the modes.
    # Why it ended, and the margin that fell, or the series that accumulates.
    reason: int
    margin: int
    # Where it has come.
    now: Array  # shape (6,)
    place: Ints  # shape (6,)
    state: Array  # shape (n,)
    entered: Bools  # (k,): the kinds that the run has been in.
    values: Array | None = None  # (p,): the parameters of the flow there, see `Flow.values`.


class LoopStart(NamedTuple):
    """Start of a run by the compiled loop."""

    kind: Kind  # (Key, Roles): of the first mode.
    made: LoopResult
    series: Array  # (s, ..): of jumps, see `statechart.execution.zeno`.


# Loops that are not compiled yet are, once so many flows could have been theirs: about two seconds.
_WORTH = 2000
# Steps of a flow that is made whole, and what they may take of a pad.
_STEPS, _PART = 512, 1 << 17


class _Worth:
    """Whether it pays to have something compiled: it is, on disk, or it was asked for often.

    To look on the disk takes as long as a short run: that is done when twice as much was asked for.
    """

    def __init__(self, compiled: Callable[[], bool]) -> None:
        self._compiled, self._asked, self._found = compiled, 0, False

    def asked(self, count: int = 1) -> bool:
        """Return whether it does, for so many more."""
        before = self._asked.bit_length()
        self._asked += count
        if not self._found and self._asked.bit_length() > before:
            self._found = self._compiled()
        return self._found or self._asked > _WORTH


class LoopModes:
    """The modes of a simulator for one set of zero parameters, as a `Program`; grows.

    Attributes
    ----------
    kinds : list of (Key, Roles)
        Of every row; those of other flows of the runs stand between them.
    """

    def __init__(self, laws: CompiledLaws, engine: Engine, automaton: Automaton) -> None:
        self.kinds: list[Kind] = []
        self._laws, self._engine, self._automaton = laws, engine, automaton
        self._watched: dict[Kind, Tape] = {}
        self._compiled: dict[Kind, CompiledMode] = {}
        self._entries: dict[Kind, Entry] = {}
        self._bands: dict[str, int] = {}
        self._loop: Loop | None = None
        self._worth = _Worth(laws.compiled)
        self._calls: dict[tuple[str, ...], BatchCall | None] = {}
        self._batch_worth = _Worth(laws.batch_compiled)

    def compiled(self, kind: Kind) -> CompiledMode:
        """Return a mode that was added."""
        return self._compiled[kind]

    def knows(self, kind: Kind) -> bool:
        """Whether loops can go through a mode."""
        return kind in self._compiled

    def about(self, event: RecordedEvent) -> tuple[str, str]:
        """Return the region that an event of a loop is about, and its cause."""
        return self._laws.about(event)

    def jump(self, setup: Callable[[], Setup], event: RecordedEvent) -> Jump:
        """Return the jump of an event that a loop has made; `setup` gives the run's numbers."""
        names = self._compiled[event.source, roles_in(event.source)].names
        fired = names[event.fired] if event.fired >= 0 else ""
        return self._laws.jump(setup, event, fired)

    def add(self, mode: Key, roles: Roles, compiled: CompiledMode) -> None:
        """Make a mode known, if loops can go through it."""
        kind = mode, roles
        if kind in self._compiled or self._laws.listed(*kind, compiled.names) is None:
            return
        entry = self._engine.entry(compiled.stepper)
        if entry is not None:
            self._compiled[kind], self._entries[kind] = compiled, entry
            self._loop = None
            self._calls.clear()

    def batch(self, names: tuple[str, ...], count: int) -> BatchCall | None:
        """Return the call for so many runs with values of some parameters; None where none is.

        As a loop it is compiled once it is worth that.
        """
        if not self._batch_worth.asked(count) or not self._compiled:
            return None
        if names not in self._calls:
            if self._loop is None:
                self._loop = self._made()
            self._calls[names] = self._laws.batch(self._loop, names, self._engine.tolerance)
        return self._calls[names]

    def follows(self, setup: Callable[..., Setup]) -> bool:
        """Whether rows of runs have the numbers that this gives for one."""
        return self._laws.setup == setup

    def flow(
        self, setup: Setup, kind: Kind, state: Array, time: float, terms: Array | None = None
    ) -> Flow:
        """Return a usual flow in a mode, from a state."""
        mode, roles = kind
        tolerances = self._laws.tolerances(setup, state, time)
        return Flow(mode, roles, settled=True, tolerances=tolerances, terms=terms)

    def loop(self, mode: Key, roles: Roles) -> Loop | None:
        """Return what loops run through from a flow on; None where they cannot enter it."""
        if (mode, roles) not in self._compiled:
            return None
        if not self._worth.asked():
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
            listed = self._laws.listed(*kind, compiled.names)
            assert listed is not None
            within = self._laws.within(kind[0])
            row = rows[self.kinds.index(kind)]
            row[:] = (
                entry.address,
                entry.takes,
                packed.ints(np.ravel(margins)),
                len(margins),
                # Those that end a run stand last.
                len(margins) - len(self._automaton.stop_margins),
                packed.ints(listed),
                *packed.tape(entry.fixed),
                *packed.tape(self._watched_of(kind)),
                *packed.tape(compiled.rates),
                *(packed.tape(within) if within is not None else _NO_TAPE),
                *packed.tape(compiled.reconstruction.tape),
                *packed.tape(compiled.reconstruction.anchors),
                packed.ints(compiled.reconstruction.places),
            )
        tapes = np.array([packed.tape(tape) for tape in self._laws.tapes], np.int64)
        # Of one engine, and so of one order.
        pace, n = entry.pace, len(self._automaton.variables)
        steps = max(min(_STEPS, _PART // (n * pace.terms)), 1)
        memory = scratch(steps, pace.terms, rows, n, len(self._automaton.parameters))
        return Loop(
            packed.program(rows), tapes, pace, memory, tuple(self._bands), tuple(self.kinds)
        )

    def _watched_of(self, kind: Kind) -> Tape:
        """Return the margins of a mode and its rates as one tape, which share most operations."""
        found = self._watched.get(kind)
        if found is None:
            mode = self._compiled[kind].mode
            margins = [margin.expression for margin in mode.margins]
            found = self._watched[kind] = self._automaton.tape([*margins, *mode.rates], mode)
        return found


class BatchCall(Protocol):
    """Runs rows of values of some parameters in one call."""

    @property
    def loop(self) -> Loop:
        """What they go through."""
        ...

    @property
    def series(self) -> Array:
        """The series of the jumps of the last row."""
        ...

    def inputs(self, table: Array) -> Array:
        """Return what the numbers of runs are computed from (m, i), of rows (m, p) of values."""
        ...

    def run(self, rows: BatchInputs, block: TraceBuffer, found: BatchResult) -> int:
        """Make runs; return how many of them before the block was full."""
        ...


class Loop(NamedTuple):
    """Modes and buffers of a compiled loop."""

    program: Program
    tapes: NDArray[np.int64]  # (t, 9): the laws' own.
    pace: Pace
    memory: Scratch
    margins: tuple[str, ...]  # Whose tolerances a run may set one by one, in their order.
    kinds: tuple[Kind, ...]  # Of the rows of the program.


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


class CompiledLoop:
    """Calls of the compiled loop for one run.

    Parameters
    ----------
    laws : CompiledLaws
    modes : LoopModes
        What loops run through.
    setup : Setup
        The numbers of the run.
    floors : (n,) array
        What is smaller of a variable counts as so large.

    Attributes
    ----------
    jumps : tuple of (str, str)
        Regions and causes of the jumps that it makes.
    """

    def __init__(self, laws: CompiledLaws, modes: LoopModes, setup: Setup, floors: Array) -> None:
        self.modes, self._laws, self._setup, self._floors = modes, laws, setup, floors
        self.jumps = laws.series
        self._loop: Loop | None = None
        self._call: Callable[..., tuple[int, int, float]] | None = None
        self._entered: Bools = np.zeros(0, np.bool_)
        self._values = setup.values.copy()

    def advance(
        self, flow: Flow, now: Array, counts: tuple[int, int], state: Array, buffer: TraceBuffer,
        series: Array,
    ) -> LoopResult | None:  # fmt: skip
        """Go on from a flow; None where the loop cannot.

        Parameters
        ----------
        now : (6,) array
            See `T_HIGH`; brought up to date.
        counts : (int, int)
            Of jumps so far, and the most of them.
        state : (n,) array
            Brought up to date.
        buffer : TraceBuffer
            Takes arcs and events.
        series : (s, ..) array
            Of jumps, see `statechart.execution.zeno`.
        """
        if not self._laws.takes(self._setup, flow, state, now.item(T_HIGH)):
            return None
        loop = self.modes.loop(flow.mode, flow.roles)
        if loop is None:
            return None
        if loop is not self._loop or self._call is None:
            self._loop = loop
            self._call = self._laws.ready(self._setup, loop, self._floors, self._values)
            self._entered = np.zeros(len(loop.kinds), np.bool_)
        self._values[:] = self._setup.values if flow.values is None else flow.values
        place = np.array([loop.kinds.index((flow.mode, flow.roles)), *counts, 0, 0, 0])
        reason, margin, now[T_REST] = self._call(buffer, now, place, state, series, self._entered)
        return LoopResult(
            loop.kinds, reason, margin, now, place, state, self._entered, self._values.copy()
        )

    def flow(self, kind: Kind, state: Array, time: float, *, settled: bool = True) -> Flow:
        """Return an unambiguous flow in a mode, from a state."""
        return self.modes.flow(self._setup, kind, state, time)._replace(settled=settled)
