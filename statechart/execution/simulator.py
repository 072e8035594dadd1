"""Runs of an automaton on an engine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from statechart.automaton.automaton import Automaton
from statechart.automaton.components import Places
from statechart.automaton.laws import Setup
from statechart.automaton.sampling import Sampling
from statechart.automaton.trace import Arc, Jump, Outcome, Roles, Trace
from statechart.automaton.trace_store import Kind, TraceRecorder, trace_buffer
from statechart.engines.engine import Engine
from statechart.engines.path import Path
from statechart.errors import DeclarationProblem
from statechart.execution.ahead import Ahead
from statechart.execution.compiled_modes import CompiledMode, CompiledModes, SolvedModes
from statechart.execution.components import MergedRun
from statechart.execution.execution import Execution
from statechart.execution.loops import Modes
from statechart.execution.outcome import error_of
from statechart.execution.record import trace_of_row
from statechart.execution.rows import HANDED, HOW, Batch, RowRunner
from statechart.execution.stream import streamed


class _Once:
    """The numbers of a run, made when they are first asked for."""

    def __init__(self, make: Callable[[], Setup]) -> None:
        self._make = make
        self._found: Setup | None = None

    def __call__(self) -> Setup:
        if self._found is None:
            self._found = self._make()
        return self._found


class Simulator:
    """An automaton on an engine: modes are compiled when first entered and kept between runs.

    Parameters
    ----------
    automaton : Automaton
        What to run.
    engine : Engine
        How to integrate.
    solved : SolvedModes, optional
        The automaton's modes, where others run it, too: from another start, or on another engine.
    progress : bool
        Whether runs above about a second report to stderr.

    Attributes
    ----------
    buffer : TraceBuffer
        Takes what a run records, or many at a time, until it is copied.
    """

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
        # Their arrays are used again, from flow to flow and from run to run.
        self.path, self.buffer = Path(), trace_buffer(len(automaton.variables))
        self._loops: dict[frozenset[int], Modes] = {}
        self._rows: dict[tuple[str, ...], RowRunner] = {}
        self._of_components: dict[Automaton, Simulator] = {}
        self._places: list[Places] | None = None

    def run(
        self,
        parameters: Mapping[str, float] | None = None,
        *,
        until: float,
        max_jumps: int = 100_000,
        throw: bool = True,
    ) -> Trace:
        """Run from the declared initial state.

        Raises
        ------
        DeclarationError
            If a parameter is unknown or the initial state is inconsistent.
        SimulationError
            With the trace so far, where the run cannot go on and `throw` is set.
        """
        trace = self._by_components(parameters or {}, until, max_jumps)
        if trace is None:
            trace = self._run(parameters or {}, until, max_jumps)
        if throw and not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
            raise error_of(trace)
        return trace

    def _run(self, parameters: Mapping[str, float], until: float, max_jumps: int) -> Trace:
        """Let a loop make the run from its start, where it can; as for the rest, an execution."""
        names = tuple(parameters)
        rows = self._rows.get(names)
        if rows is None:
            rows = self._rows[names] = RowRunner(self, names)
        values = np.fromiter(parameters.values(), float, len(names))
        batch = rows.alone(values, until, max_jumps)
        if batch is None or batch.found.ends.item(HOW) == HANDED:
            return self._execution(self._setup(parameters), until, max_jumps, batch).run()
        return trace_of_row(self, batch, _Once(partial(self._setup, dict(parameters))))

    def certified(
        self,
        trace: Trace,
        parameters: Mapping[str, float] | None = None,
        *,
        until: float,
        max_jumps: int = 100_000,
    ) -> Trace:
        """Make a run again, and prove of every step how far it is off."""
        from statechart.execution.certificate import Certificate

        made = self._execution(self._setup(parameters or {}), until, max_jumps)
        laws = self.automaton.laws_of_events
        made.ahead = None
        made.certificate = Certificate(trace, made.setup, laws, self.engine)
        return made.run()

    def stream(
        self,
        parameters: Mapping[str, float],
        sampling: Sampling,
        *,
        until: float,
        max_jumps: int = 100_000,
    ) -> Iterator[Arc | Jump]:
        """Yield arcs and jumps of a run as they come; see `streamed`.

        No other run may be made meanwhile.
        """
        made = self._execution(self._setup(parameters), until, max_jumps)
        made.ahead = None
        return streamed(made, parameters, sampling)

    def _by_components(
        self, parameters: Mapping[str, float], until: float, max_jumps: int
    ) -> Trace | None:
        """Run the components of the automaton one by one; None where it has none."""
        components = self.automaton.components()
        if not components:
            return None
        if self._places is None:
            self._places = [Places(component, self.automaton) for component in components]
        setup, end = self._setup(parameters), until
        parts = []
        made: dict[tuple[Automaton, bytes, bytes], Trace] = {}
        for component, places in zip(components, self._places, strict=True):
            own = component.restricted(setup, places)
            # Of components that start alike one is run.
            alike = component.automaton, own.initial.tobytes(), own.values.tobytes()
            trace = made.get(alike)
            if trace is None or trace.t_end > end:
                try:
                    trace = self._alone(component.automaton)._from(own, end, max_jumps)
                except DeclarationProblem:
                    # The whole says so in the names that the model declares.
                    return None
                made[alike] = trace
            parts.append((component, places, trace))
            if trace.outcome is not Outcome.HORIZON:
                end = trace.t_end
        merged = MergedRun(self.automaton, setup, parts, max_jumps)
        built = sum(simulator.modes_built for simulator in self._of_components.values())
        return merged.trace(self.engine.title, self.engine.tolerance, built)

    def _alone(self, automaton: Automaton) -> Simulator:
        """Return what runs a component."""
        found = self._of_components.get(automaton)
        if found is None:
            found = Simulator(automaton, self.engine, solved=self.modes.solved.part(automaton))
            self._of_components[automaton] = found
        return found

    def _from(self, setup: Setup, until: float, max_jumps: int) -> Trace:
        """Run with the numbers of a run."""
        modes = partial(self.modes.mode, zeros=setup.zeros)
        return self._execution(replace(setup, modes=modes), until, max_jumps).run()

    def _setup(self, parameters: Mapping[str, float]) -> Setup:
        """Return the numbers of a run."""
        setup = self.automaton.setup(parameters, self.engine.tolerance)
        return replace(setup, modes=partial(self.modes.mode, zeros=setup.zeros))

    def _execution(
        self,
        setup: Setup,
        until: float,
        max_jumps: int,
        batch: Batch | None = None,
    ) -> Execution:
        zeros = setup.zeros
        self.engine.sizes = setup.sizes
        kinds: list[Kind] = []
        ahead, jump = self._ahead(setup, zeros), None
        if ahead is not None:
            kinds, jump = ahead.modes.kinds, partial(ahead.modes.jump, lambda: setup)
        begun = None if batch is None else batch.begun()
        variables = len(self.automaton.variables)
        record = TraceRecorder(variables, kinds, self.buffer, jump, begun=begun is not None)
        return Execution(
            self.modes, self.path, record, setup, zeros, until, max_jumps, self.progress, ahead,
            begun=begun,
        )  # fmt: skip

    def known(self) -> list[tuple[frozenset[int], Modes]]:
        """Return the modes that compiled loops know, by the parameters that are zero in them."""
        setup = self.automaton.setup
        return [(zeros, modes) for zeros, modes in self._loops.items() if modes.follows(setup)]

    def _ahead(self, setup: Setup, zeros: frozenset[int]) -> Ahead | None:
        """Return what runs usual instants in compiled code; None where nothing can."""
        laws = self.automaton.laws
        ordinary = None if laws is None else laws.ordinary
        if ordinary is None:
            return None
        modes = self._loops.get(zeros)
        if modes is None:
            modes = self._loops[zeros] = Modes(ordinary, self.engine, self.automaton)
        return Ahead(ordinary, modes, setup)

    def compiled(self, roles: Roles, zeros: frozenset[int]) -> CompiledMode:
        """Return the mode of `roles`, compiled for zero parameters at the places `zeros`."""
        return self.modes.compiled(roles, zeros)

    @property
    def modes_built(self) -> int:
        """Number of modes whose equations were built so far."""
        return self.modes.built
