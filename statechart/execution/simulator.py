"""Runs of an automaton on an engine, one by one and in batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from statechart import interrupts
from statechart.arrays import Array, Bools
from statechart.automaton.automaton import Automaton, Places
from statechart.automaton.laws import Setup
from statechart.automaton.lazy import LazyMapping
from statechart.automaton.time_stepper import Sampling
from statechart.automaton.trace import Arc, Jump, Outcome, Trace
from statechart.automaton.trace_store import (
    Kind,
    TraceStore,
    arc_polynomials,
    copy_buffer,
    event_of,
    trace_buffer,
)
from statechart.engines.engine import Engine, Path
from statechart.errors import DeclarationProblem
from statechart.execution import compiled_loop as runs
from statechart.execution.compiled_loop import (
    ARCS,
    ARCS_END,
    EVENTS,
    Batch,
    BatchInputs,
    BatchResult,
    LoopModes,
)
from statechart.execution.compiled_modes import CompiledModes, SolvedModes
from statechart.execution.components import MergedRun
from statechart.execution.event_classification import closing
from statechart.execution.execution import Execution, evidence_of
from statechart.execution.outcome import error_of
from statechart.execution.slow_start import slow_start_warning
from statechart.kernels.polynomials import term_sizes

_MAX_ROWS = 256  # of one call: tens of milliseconds between checks for signals


class Simulator:
    """An automaton on an engine, with cached compiled modes."""

    def __init__(
        self,
        automaton: Automaton,
        engine: Engine,
        *,
        solved: SolvedModes | None = None,
        progress: bool = False,
    ) -> None:
        self.automaton = automaton
        self.engine = engine
        self.progress = progress
        self.modes = CompiledModes(solved or SolvedModes(automaton), engine)
        # Reused by all flows and runs.
        self.path, self.buffer = Path(), trace_buffer(len(automaton.variables))
        self._loops: dict[frozenset[int], LoopModes] = {}
        self._rows = cache(partial(BatchRunner, self))
        self._of_components: dict[Automaton, Simulator] = {}
        self._places: list[Places] | None = None

    def run(
        self, parameters: Mapping[str, float] | None = None, *, until: float, throw: bool = True
    ) -> Trace:
        """Run from the declared initial state.

        Raises `DeclarationError` for an inconsistent start, `SimulationError` with the partial
        trace.
        """
        trace = self._by_components(parameters or {}, until)
        if trace is None:
            trace = self._run(parameters or {}, until)
        if throw and not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
            raise error_of(trace)
        return trace

    def _run(self, parameters: Mapping[str, float], until: float) -> Trace:
        """Run by the compiled loop as far as possible, and by an `Execution` from there."""
        names = tuple(parameters)
        values = np.fromiter(parameters.values(), float, len(names))
        batch = self._rows(names).run_single(values, until)
        overrides, made = dict(parameters), list[Setup]()

        def setup() -> Setup:  # once; `functools.cache` would take 7 us to create
            if not made:
                made.append(self._setup(overrides))
            return made[0]

        if batch is None or batch.result.ends.item(runs.HOW) == runs.HANDED:
            return self._execution(setup(), until, batch).run()
        return self._trace_of(batch, setup)

    def _trace_of(self, batch: Batch, setup: Callable[[], Setup]) -> Trace:
        """Return the trace of a run that the compiled loop completed."""
        automaton, engine, result = self.automaton, self.engine, batch.result
        modes, kinds = batch.modes, batch.kinds
        place, final = result.place[0].tolist(), result.final[0]
        t_end, final_kind = result.clock.item(runs.T_HIGH), kinds[place[runs.N_MODE]]
        start_mode = kinds[result.ends.item(runs.FIRST_MODE)][0]
        outcome, stop = batch.outcome(0), None
        if outcome is Outcome.STOPPED:
            margin = automaton.stop_of[
                modes.compiled[final_kind].names[result.ends.item(runs.MARGIN)]
            ].name
            message = f"{margin} at t = {t_end:.6g}"
            key, count = final_kind[0], place[runs.N_JUMPS]
            stop = partial(Jump, t_end, count, "", "stop", key, key, final, final, (margin,))
        else:
            message = f"reached t = {t_end:.6g}"
        block = copy_buffer(batch.block)
        jump = partial(modes.jump, setup)
        store = TraceStore(len(automaton.variables), modes.kinds, None, jump, stop)
        store.add(block)
        arcs, jumps = store.close()
        arcs.source = batch._replace(block=block)
        remarks: tuple[str, ...] = ()
        if modes.laws.has_remarks:
            remarks = automaton.laws_of_events.remarks(setup(), arcs)
        if len(arcs):
            rates, values = (
                lambda: modes.compiled[arcs[0].mode, arcs[0].roles].rates,
                result.values[0],
            )
            remarks += slow_start_warning(arcs[0], rates, values, engine.tolerance)
        return automaton.trace(
            result.values[0],
            arcs=arcs,
            jumps=jumps,
            initial=result.initial[0],
            final=final,
            start_mode=start_mode,
            final_mode=final_kind[0],
            t_end=t_end,
            outcome=outcome,
            message=message,
            certified="guards",
            evidence=LazyMapping(lambda: evidence_of(mode.names for _, mode in batch.entered())),
            tolerances=LazyMapping(lambda: dict(setup().tolerances)),
            engine=engine.title,
            tolerance=engine.tolerance,
            warnings=(*modes.laws.warnings, *remarks),
            counts={
                "steps": place[runs.N_STEPS],
                "evaluations": 0,
                "boxes": place[runs.N_BOXES],
                "jumps": len(jumps),
                "modes_built": self.modes.built,
                "python_instants": 0,
            },
        )

    def certified(
        self, trace: Trace, parameters: Mapping[str, float] | None = None, *, until: float
    ) -> Trace:
        """Repeat a run with proved bounds of the local error of every step."""
        from statechart.execution.certificate import Certificate

        execution = self._execution(self._setup(parameters or {}), until)
        laws = self.automaton.laws_of_events
        execution.loop = None
        execution.certificate = Certificate(trace, execution.setup, laws, self.engine)
        return execution.run()

    def stream(
        self, parameters: Mapping[str, float], sampling: Sampling, *, until: float
    ) -> Iterator[Arc | Jump]:
        """Yield arcs and jumps of a run as they are computed; see `Execution.stream`.

        No other run may be computed meanwhile.
        """
        execution = self._execution(self._setup(parameters), until)
        execution.loop = None
        return execution.stream(parameters, sampling)

    def _by_components(self, parameters: Mapping[str, float], until: float) -> Trace | None:
        """Run the components of the automaton one by one; None without components."""
        components = self.automaton.components()
        if not components:
            return None
        if self._places is None:
            self._places = [Places(component, self.automaton) for component in components]
        setup, end = self._setup(parameters), until
        component_runs = []
        traces: dict[tuple[Automaton, bytes, bytes], Trace] = {}
        for component, places in zip(components, self._places, strict=True):
            component_setup = component.restricted(setup, places)
            # Isomorphic components with equal setups are run once.
            cache_key = (
                component.automaton,
                component_setup.initial.tobytes(),
                component_setup.values.tobytes(),
            )
            trace = traces.get(cache_key)
            if trace is None or trace.t_end > end:
                try:
                    simulator = self._of_component(component.automaton)
                    trace = simulator._execution(simulator._with_modes(component_setup), end).run()
                except DeclarationProblem:
                    # A run of the whole reports the error in declared names.
                    return None
                traces[cache_key] = trace
            component_runs.append((component, places, trace))
            if trace.outcome is not Outcome.HORIZON:
                end = trace.t_end
        merged = MergedRun(self.automaton, setup, component_runs)
        built = sum(simulator.modes.built for simulator in self._of_components.values())
        return merged.trace(self.engine.title, self.engine.tolerance, built)

    def _of_component(self, automaton: Automaton) -> Simulator:
        simulator = self._of_components.get(automaton)
        if simulator is None:
            simulator = Simulator(automaton, self.engine, solved=self.modes.solved.part(automaton))
            self._of_components[automaton] = simulator
        return simulator

    def _setup(self, parameters: Mapping[str, float]) -> Setup:
        return self._with_modes(self.automaton.setup(parameters, self.engine.tolerance))

    def _with_modes(self, setup: Setup) -> Setup:
        return replace(setup, modes=partial(self.modes.mode, zeros=setup.zeros))

    def _execution(self, setup: Setup, until: float, batch: Batch | None = None) -> Execution:
        zeros = setup.zeros
        self.engine.sizes = setup.sizes
        kinds: list[Kind] = []
        loop, jump = self._loop(zeros), None
        if loop is not None:
            kinds, jump = loop.kinds, partial(loop.jump, lambda: setup)
        if batch is None:
            self.buffer.used[:] = 0
        record = TraceStore(len(self.automaton.variables), kinds, self.buffer, jump)
        return Execution(
            self.modes, self.path, record, setup, zeros, until, self.progress, loop,
            batch_start=batch,
        )  # fmt: skip

    def known(self) -> list[tuple[frozenset[int], LoopModes]]:
        """Return the modes of compiled loops with the automaton's setup, by zero parameters."""
        setup = self.automaton.setup
        return [(zeros, m) for zeros, m in self._loops.items() if m.laws.setup == setup]

    def _loop(self, zeros: frozenset[int]) -> LoopModes | None:
        """Return the modes of the compiled loop, or None if the model has no loop."""
        # The compiled loop does not support switches.
        supported = not self.automaton.switching and self.automaton.laws is not None
        laws = self.automaton.laws_of_events.compiled_laws if supported else None
        if laws is not None and zeros not in self._loops:
            self._loops[zeros] = LoopModes(laws, self.engine, self.automaton)
        return self._loops.get(zeros)


class BatchRunner:
    """Runs rows of values of some parameters."""

    def __init__(self, simulator: Simulator, names: Sequence[str]) -> None:
        self.simulator, self._names = simulator, tuple(names)
        self._masks: dict[frozenset[int], Bools] = {}  # of the zero parameters

    def ready(self, count: int) -> bool:
        """Return whether `count` rows can be run: their call is compiled, or pays compiling."""
        return any(modes.batch(count) for _, modes in self.simulator.known())

    def run(self, table: Array, until: Array) -> Iterator[Batch]:
        """Run rows of a table; yield complete ones in batches."""
        pending = np.arange(len(table))
        for zeros, modes in self.simulator.known():
            if not pending.size:
                return
            postponed: list[NDArray[np.intp]] = []
            started = 0
            while started < pending.size:
                interrupts.check()
                chunk = pending[started : started + _MAX_ROWS]
                batch = self._called(modes, zeros, chunk, table[chunk], until[chunk], alone=False)
                if batch is None:
                    postponed.append(pending[started:])
                    break
                outcomes = batch.result.ends[:, runs.HOW]
                started += len(outcomes)
                postponed.append(batch.rows[outcomes == runs.OTHER])
                complete = np.flatnonzero(self._complete_rows(batch, table[batch.rows]))
                if complete.size:
                    result = BatchResult._make([array[complete] for array in batch.result])
                    yield batch._replace(rows=batch.rows[complete], result=result)
            pending = np.concatenate(postponed)

    def run_single(self, values: Array, until: float) -> Batch | None:
        """Compute one run as far as the loop can."""
        row = np.zeros(1, np.intp)
        for zeros, modes in self.simulator.known():
            batch = self._called(
                modes, zeros, row, values[None], np.array([until], float), alone=True
            )
            outcome = runs.OTHER if batch is None else batch.result.ends.item(runs.HOW)
            if outcome != runs.OTHER:
                return None if outcome == runs.UNUSUAL else batch
        return None

    def _called(
        self,
        modes: LoopModes,
        zeros: frozenset[int],
        rows: NDArray[np.intp],
        table: Array,
        until: Array,
        *,
        alone: bool,
    ) -> Batch | None:
        """Run as many rows as the buffer can store; None if the loop cannot run any."""
        simulator = self.simulator
        automaton, engine = simulator.automaton, simulator.engine
        call = modes.batch(len(rows))
        if call is None or not isinstance(engine.floor, float):
            return None
        m, kinds, p = len(rows), call.loop.kinds, len(automaton.parameters)
        result = BatchResult.empty(m, p, len(automaton.variables), len(kinds))
        zero_mask = self._masks.get(zeros)
        if zero_mask is None:
            zero_mask = self._masks[zeros] = np.isin(np.arange(p), list(zeros))
        code, constants, outputs, inputs = call.inputs(self._names, table)
        inputs_of_call = BatchInputs(
            code, constants, outputs, inputs, until, zero_mask, automaton.max_jumps, engine.floor,
            alone, resumed=False,
        )  # fmt: skip
        block = simulator.buffer
        block.used[:] = 0
        count = max(call.start(inputs_of_call, block, result), 1)
        if count < m:
            result = BatchResult._make([array[:count] for array in result])
        return Batch(rows[:count], result, block, kinds, modes, zeros, call.series)

    def _complete_rows(self, batch: Batch, table: Array) -> Bools:
        """Return the mask (m,) of the complete rows, without an event at their end."""
        outcomes = batch.result.ends[:, runs.HOW]
        complete = np.asarray((outcomes == runs.ENDED) | (outcomes == runs.STOPPED))
        for row in np.flatnonzero(outcomes == runs.CLOSING).tolist():
            complete[row] = not self._closing(batch, row, table[row])
        return complete

    def _closing(self, batch: Batch, row: int, values: Array) -> bool:
        """Return whether an event may coincide with the end of a row (see `closing`)."""
        result, block, simulator = batch.result, batch.block, self.simulator
        setup = self.setup(values)
        kind = batch.kinds[result.place[row, runs.N_MODE]]
        terms = None
        size = len(simulator.automaton.variables)
        arc = int(result.spans[row, ARCS_END]) - 1
        if arc >= result.spans[row, ARCS] and block.arcs[arc, 1] == result.place[row, runs.N_JUMPS]:
            terms = term_sizes(*arc_polynomials(block, arc, size))
        final, time = result.final[row], float(result.clock[row, runs.T_HIGH])
        flow = batch.modes.flow(setup, kind, final, time, terms)
        compiled = batch.modes.compiled[kind]
        happens, _ = closing(simulator.engine, compiled, flow, setup, final, time)
        return happens

    def jump(self, batch: Batch, table: Array, row: int, j: int) -> Jump:
        """Return jump `j` of a row of a batch with parameter values `table`."""
        event = event_of(batch.block, int(batch.result.spans[row, EVENTS]) + j, j, batch.kinds)
        return batch.modes.jump(partial(self.setup, table[row]), event)

    def setup(self, values: Array) -> Setup:
        """Return the setup of a row."""
        overrides: Mapping[str, float] = dict(zip(self._names, values.tolist(), strict=True))
        return self.simulator.automaton.setup(overrides, self.simulator.engine.tolerance)
