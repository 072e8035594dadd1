"""The compiled event loop over a batch of runs: table of modes, calls, results.

The loop is part of the laws (`statechart.automaton.laws.CompiledLaws`), which recognise unambiguous
instants. It starts runs from parameters, or continues one run, and returns the reason why it
stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import CompiledLaws, Flow, Setup, roles_in
from statechart.automaton.trace import Jump, Key, Outcome, Roles
from statechart.automaton.trace_store import Kind, RecordedEvent, TraceBuffer
from statechart.engines.compiled_flow import (
    COLUMNS,
    KINDS,
    LAWS_AT,
    TAPE,
    FlowWorkspace,
    ModeTable,
    flow_workspace,
)
from statechart.engines.engine import Engine, Pace, StepFunction
from statechart.execution.compiled_modes import CompiledMode
from statechart.formulas.tape import Tape

OVER, FELL, FLOW, FULL, PAUSED, COUNTED, ACCUMULATES = range(7)
"""Reasons of the end of a compiled loop: end of the run; a margin fell at an ambiguous instant; the
next flow needs Python; the buffer is full; a pause for interrupts; the jumps are to be counted; the
jumps accumulate."""

T_HIGH, T_LOW, T_END, T_HORIZON, T_SINCE, T_REST = range(6)
"""Columns of `BatchResult.clock`: the clock, the end of the run, the horizon, the time of the last
jump, and the time to an accumulation as the loop ends."""
N_MODE, N_JUMPS, N_MOST, N_STEPS, N_BOXES, N_RETRY = range(6)
"""Columns of `BatchResult.place`: row of the mode, number of jumps, limit of jumps, steps and boxes
so far; 1 if the laws are evaluated again at this instant."""

LOOK_AHEAD = 16.0
"""First horizon of a flow relative to the duration of the last flow."""


UNUSUAL, OTHER, ENDED, CLOSING, STOPPED, HANDED = range(6)
"""Outcomes of a run of a batch: Python must repeat it; other parameters are zero than those of the
modes; end of the run; end with a possible event; stop; Python continues it."""

HOW, REASON, MARGIN, FIRST_MODE = range(4)
"""Columns of `BatchResult.ends`."""
ARCS, ARCS_END, EVENTS, EVENTS_END = range(4)
"""Columns of `BatchResult.spans`."""


class BatchInputs(NamedTuple):
    """Runs for a compiled call."""

    # Program of the tape of the setup, and its inputs (m, i).
    code: Ints32
    constants: Array
    outputs: Ints32
    inputs: Array
    until: Array  # (m,): end of each run; nan if it is invalid.
    zeros: Bools  # (p,): mask of the parameters that are exactly zero.
    most_jumps: int
    floor: float  # Smallest magnitude of variables.
    single: bool  # The single run is handed over to Python when the loop ends.
    resumed: bool  # The single run continues, with its setup in the buffers.


class BatchResult(NamedTuple):
    """Results of a batch; its arcs and events are in a `TraceBuffer`."""

    # (m, 4): outcome, reason of the loop's end, margin that fell or series that accumulates, kind
    # of the first mode.
    ends: Ints
    spans: Ints  # (m, 4): begins and ends of the arcs and events of each run.
    # (m, 6): see `T_HIGH` and `N_MODE`.
    clock: Array
    place: Ints
    values: Array  # (m, p): parameters
    initial: Array  # (m, n)
    final: Array  # (m, n)
    entered: Bools  # (m, k): mask of the kinds of modes entered.

    @classmethod
    def empty(cls, m: int, p: int, n: int, kinds: int) -> BatchResult:
        """Allocate the results of m runs."""
        return cls(
            np.zeros((m, 4), np.int64), np.zeros((m, 4), np.int64), np.zeros((m, 6)),
            np.zeros((m, 6), np.int64), np.empty((m, p)), np.empty((m, n)), np.empty((m, n)),
            np.zeros((m, kinds), np.bool_),
        )  # fmt: skip


class Batch(NamedTuple):
    """Runs of a batch; valid until the next call of the loop."""

    rows: NDArray[np.intp]  # (m,): indices of the runs.
    result: BatchResult
    block: TraceBuffer  # Arcs and events of these and other runs.
    kinds: tuple[Kind, ...]  # Kinds of the modes.
    modes: LoopModes
    zeros: frozenset[int]  # Indices of the parameters that are exactly zero.
    series: Array  # (s, ..): of the last run, of `CompiledLaws.series`.

    @property
    def stopped(self) -> Bools:
        """Mask (m,) of the runs ended by a stop."""
        return np.asarray(self.result.ends[:, HOW] == STOPPED)

    def outcome(self, row: int) -> Outcome:
        """Return the outcome of a run."""
        return Outcome.STOPPED if self.result.ends[row, HOW] == STOPPED else Outcome.HORIZON

    def entered(self) -> list[tuple[Kind, CompiledMode]]:
        """Return the modes that the single run has entered."""
        kinds = zip(self.kinds, self.result.entered[0].tolist(), strict=True)
        return [(kind, self.modes.compiled[kind]) for kind, entered in kinds if entered]


# Flows after which a loop is compiled: about two seconds of interpreted runs.
_WORTH_COMPILING = 2000
# Limits of the steps of a flow in the loop, and of their coefficients.
_MAX_STEPS, _MAX_COEFFICIENTS = 512, 1 << 17


class _CompilationPolicy:
    """Decides whether to use compiled code: it is cached, or many flows could use it.

    A check of the cache takes as long as a short run, and is repeated when the requests doubled.
    """

    def __init__(self, compiled: Callable[[], bool]) -> None:
        self.compiled, self._requests, self._on_disk = compiled, 0, False

    def pays(self, count: int = 1) -> bool:
        """Return whether compiled code pays for `count` more flows."""
        before = self._requests.bit_length()
        self._requests += count
        if not self._on_disk and self._requests.bit_length() > before:
            self._on_disk = self.compiled()
        return self._on_disk or self._requests > _WORTH_COMPILING


class LoopModes:
    """Modes of a simulator for one set of zero parameters, as a growing `ModeTable`.

    `kinds` are the modes and roles of its rows, `compiled` those that were added, `series`
    those of `CompiledLaws`.
    """

    def __init__(self, laws: CompiledLaws, engine: Engine, automaton: Automaton) -> None:
        self.kinds: list[Kind] = []
        self.series = laws.series
        self.laws, self._engine, self._automaton = laws, engine, automaton
        self._watched: dict[Kind, Tape] = {}
        self.compiled: dict[Kind, CompiledMode] = {}
        self._step_functions: dict[Kind, StepFunction] = {}
        self._bands: dict[str, int] = {}
        self._call: Any = None  # as `CompiledLaws.call` returns it
        self._worth = _CompilationPolicy(laws.ready)
        self._batch_worth = _CompilationPolicy(laws.compiled)

    def jump(self, setup: Callable[[], Setup], event: RecordedEvent) -> Jump:
        """Return the jump of an event of the loop; `setup` returns the run's setup."""
        names = self.compiled[event.source, roles_in(event.source)].names
        fired = names[event.fired] if event.fired >= 0 else ""
        return self.laws.jump(setup, event, fired)

    def add(self, mode: Key, roles: Roles, compiled: CompiledMode) -> None:
        """Add a mode, if it can be compiled."""
        kind = mode, roles
        if kind in self.compiled or self.laws.listed(*kind, compiled.names) is None:
            return
        step_function = self._engine.step_function(compiled.stepper)
        if step_function is not None and self._engine.time_budget is None:
            self.compiled[kind], self._step_functions[kind] = compiled, step_function
            self._call = None

    def batch(self, count: int) -> Any:
        """Return the calls that start `count` runs; None if they cannot, or do not pay."""
        if not self._batch_worth.pays(count) or not self.compiled:
            return None
        call = self._calls()
        return call if call.starts else None

    def flow(
        self, setup: Setup, kind: Kind, state: Array, time: float, terms: Array | None = None
    ) -> Flow:
        """Return a flow in a mode with its default tolerances."""
        mode, roles = kind
        tolerances = self.laws.tolerances(setup, state, time)
        return Flow(mode, roles, settled=True, tolerances=tolerances, terms=terms)

    def resume(
        self, setup: Setup, flow: Flow, clock: Array, counts: tuple[int, int], state: Array,
        buffer: TraceBuffer, series: Array, zeros: frozenset[int],
    ) -> Batch | None:  # fmt: skip
        """Resume a run from a flow; None if the loop cannot.

        `clock` (6,): see `T_HIGH`; `counts` are the number of jumps and its limit; `series` (s, ..)
        is updated; parameters `zeros` are exactly zero.
        """
        kind, floor = (flow.mode, flow.roles), self._engine.floor
        if not self.laws.takes(setup, flow, state, clock.item(T_HIGH)):
            return None
        if kind not in self.compiled or not self._worth.pays():
            return None
        assert isinstance(floor, float)
        call = self._calls()
        kinds = call.loop.kinds
        result = BatchResult.empty(1, len(setup.values), len(state), len(kinds))
        result.clock[0], result.final[0] = clock, state
        result.values[0] = setup.values if flow.values is None else flow.values
        result.place[0, :N_STEPS] = kinds.index(kind), *counts
        call.resume(setup, floor, buffer, result, series)
        return Batch(np.zeros(1, np.intp), result, buffer, kinds, self, zeros, series)

    def _calls(self) -> Any:
        if self._call is None:
            self._call = self.laws.call(self._loop(), self._engine.tolerance)
        return self._call

    def _loop(self) -> Loop:
        packed = Packed()
        known = set(self.kinds)
        self.kinds += [kind for kind in self.compiled if kind not in known]
        rows = np.zeros((len(self.kinds), COLUMNS), np.int64)
        rows[:, LAWS_AT] = -1
        for kind, compiled in self.compiled.items():
            step_function = self._step_functions[kind]
            margins = [
                (KINDS.index(kind_of_margin), self._bands.setdefault(name, len(self._bands)))
                for name, kind_of_margin in compiled.watched
            ]
            listed = self.laws.listed(*kind, compiled.names)
            assert listed is not None
            curvature_tape = self.laws.within(kind[0])
            row = rows[self.kinds.index(kind)]
            row[:] = (
                step_function.address,
                step_function.takes,
                packed.ints(np.ravel(margins)),
                len(margins),
                # Stop margins are the last ones.
                len(margins) - len(self._automaton.stop_margins),
                packed.ints(listed),
                *packed.tape(step_function.fixed),
                *packed.tape(self._watched_of(kind)),
                *packed.tape(compiled.rates),
                *(packed.tape(curvature_tape) if curvature_tape is not None else _NO_TAPE),
                *packed.tape(compiled.reconstruction.tape),
                *packed.tape(compiled.reconstruction.anchors),
                packed.ints(compiled.reconstruction.places),
            )
        tapes = np.array([packed.tape(tape) for tape in self.laws.tapes], np.int64)
        # All modes have the same engine and order.
        pace, n = step_function.pace, len(self._automaton.variables)
        steps = max(min(_MAX_STEPS, _MAX_COEFFICIENTS // (n * pace.terms)), 1)
        memory = flow_workspace(steps, pace.terms, rows, n, len(self._automaton.parameters))
        return Loop(
            packed.program(rows), tapes, pace, memory, tuple(self._bands), tuple(self.kinds)
        )

    def _watched_of(self, kind: Kind) -> Tape:
        """Return margins and rates of a mode as one tape with shared operations."""
        tape = self._watched.get(kind)
        if tape is None:
            mode = self.compiled[kind].mode
            margins = [margin.expression for margin in mode.margins]
            tape = self._watched[kind] = self._automaton.tape([*margins, *mode.rates], mode)
        return tape


class Loop(NamedTuple):
    """Modes and buffers of a compiled loop."""

    program: ModeTable
    tapes: NDArray[np.int64]  # (t, 9): the laws' own.
    pace: Pace
    workspace: FlowWorkspace
    margins: tuple[str, ...]  # Margins with individual tolerances, in order.
    kinds: tuple[Kind, ...]  # Kinds of the rows of the program.


_NO_TAPE = (0,) * TAPE


class Packed:
    """Concatenated arrays."""

    def __init__(self) -> None:
        self._ints: list[Ints32] = []
        self._floats: list[Array] = []
        self._sizes = [0, 0]

    def ints(self, array: ArrayLike) -> int:
        """Append integers; return their offset."""
        array = np.asarray(array, np.int32).ravel()
        self._ints.append(array)
        self._sizes[0] += array.size
        return self._sizes[0] - array.size

    def tape(self, tape: Tape) -> tuple[int, ...]:
        """Append a tape; return its columns."""
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

    def program(self, modes: Ints) -> ModeTable:
        """Return the program of all arrays."""
        return ModeTable(*self.arrays(), modes)

    def arrays(self) -> tuple[Ints32, Array]:
        """Return the concatenated integers and floats."""
        ints, floats = [np.zeros(0, np.int32), *self._ints], [np.zeros(0), *self._floats]
        return np.concatenate(ints), np.concatenate(floats)
