"""Subject of property tests: a model compiled for its engines, and its runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import sympy as sp
from pydantic import ValidationError

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import Mode
from statechart.automaton.time_stepper import DEFAULT_IMPULSES
from statechart.automaton.trace import Arc, Outcome, Trace
from statechart.documents.declaration import Declaration
from statechart.documents.fields import replace_fields
from statechart.documents.setting import Setting
from statechart.engines.request import plan_request
from statechart.errors import DeclarationError, DeclarationProblem, SimulationError
from statechart.execution.perturbation import with_loosened_modes
from statechart.execution.simulator import Simulator
from statechart.execution.time_stepping import SteppingSimulator
from statechart.formulas.formula import parse
from statechart.loading.kind import kind
from statechart.observation.condition import conditions
from statechart.observation.observer import Observer, Programs
from statechart.observation.observers import Observers
from statechart.testing.agreement import NUDGE, Sensitivity, Undecidable

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy

_FINER_TOLERANCE = 1e-3 * NUDGE  # well above the round-off of iterations
_MAX_CASES = 64  # cached cases


class Subject:
    """A model compiled once for each engine, for any number of runs.

    Parameters
    ----------
    model : Declaration
        The model.
    automaton : Automaton, optional
        By default that of the model.
    """

    def __init__(self, model: Declaration, automaton: Automaton | None = None) -> None:
        self.automaton = automaton or kind(model.kind).automaton(model)
        self.observers: dict[str, Observer] = {}
        self.missing: dict[str, str] = {}
        made = Observers(self.automaton)
        setting = plan_request(Setting(record="modes"), model, self.automaton).setting
        self.model, self.step = model, setting.step
        if self.step is not None:
            # Transformed models are run with the step of the original.
            chosen = replace_fields(model.settings, engine="impulse", step=self.step)
            self.model = replace_fields(model, settings=chosen)
            self.observers["impulse"] = made.at(setting)
        method = model.settings.method
        for name in ("taylor", "scipy") if self.step is None else ():
            try:
                self.observers[name] = made.at(Setting(name, method if name == "scipy" else None))
            except DeclarationError as error:
                self.missing[name] = error.message
        self._variants: dict[str, Subject] = {}
        self._cases: dict[tuple[tuple[str, float], ...], Case] = {}
        self._loosened: dict[float, Simulator] = {}
        self._programs = Programs(self.automaton)

    @property
    def engines(self) -> tuple[str, ...]:
        """The engines of the runs."""
        if self.step is not None:
            return (f"impulse at steps of {self.step:g}",)
        return tuple(name for name in self.observers if name not in self.missing)

    def case(self, parameters: Mapping[str, float]) -> Case:
        """Return the cached case of some parameters."""
        key = tuple(sorted(parameters.items()))
        self._cases[key] = found = self._cases.pop(key, None) or self.fresh(parameters)
        if len(self._cases) > _MAX_CASES:
            del self._cases[next(iter(self._cases))]
        return found

    def fresh(self, parameters: Mapping[str, float]) -> Case:
        """Return a new case of some parameters."""
        variant = self.model.variant(parameters)
        if variant is self.model:
            return Case(self, dict(parameters))
        # Only structural parameters need another subject.
        key = repr([parameters[name] for name in sorted(self.model.whole & {*parameters})])
        if key not in self._variants:
            self._variants[key] = Subject(variant)
        return Case(self._variants[key], dict(parameters))

    def loosened(self, relative: float) -> Simulator:
        """Return the most accurate engine's simulator of modes chosen as at `relative`."""
        if relative not in self._loosened:
            simulator = self.observers[self.engines[0]].simulator
            assert isinstance(simulator, Simulator)  # there are several engines
            automaton = with_loosened_modes(self.automaton, relative)
            self._loosened[relative] = Simulator(automaton, simulator.engine)
        return self._loosened[relative]

    @cached_property
    def finer(self) -> Subject | None:
        """The subject with impulse residuals well below `NUDGE`, if its own may be larger."""
        settings = self.model.settings
        tolerance = settings.impulse_tolerance or DEFAULT_IMPULSES.tolerance
        if self.step is None or tolerance <= _FINER_TOLERANCE:
            return None
        chosen = replace_fields(settings, impulse_tolerance=_FINER_TOLERANCE)
        return Subject(replace_fields(self.model, settings=chosen))

    def end(self, parameters: Mapping[str, float]) -> float:
        """Return the end time of a run; raise `DeclarationError` if the model has none."""
        if self.model.stop.time is None:
            raise DeclarationError("the run has no end", advice="write stop: {time: 10}")
        return parse(self.model.stop.time).value(self.model.values(parameters))

    def mode(self, trace: Trace, arc: Arc) -> Mode:
        """Return the solved mode of an arc."""
        simulator = self.observers[trace.engine.split()[0]].simulator
        assert isinstance(simulator, Simulator)  # time stepping solves no modes
        return simulator.modes.compiled(arc.roles, trace.zeros).mode

    def solved(
        self,
        trace: Trace,
        arc: Arc,
        tau: Array,
        expressions: Sequence[sp.Expr],
        states: Array | None = None,
    ) -> Array:
        """Return the values (m, f) of expressions at local times (m,) of an arc, or in `states`."""
        times = arc.start.high + (arc.start.low + tau)
        states, known = arc.states(tau) if states is None else states, arc.unknowns(tau)
        mode = self.mode(trace, arc) if known is None else None
        rows = states if known is None else np.hstack([states, known])
        tape = self._programs.tape(tuple(expressions), mode, known=known is not None)
        return tape.table(rows, trace.values, times)

    def values(
        self, trace: Trace, expressions: Sequence[sp.Expr], states: Array, times: Array
    ) -> Array:
        """Return the values (m, f) of expressions without unknowns in states (m, n)."""
        return self._programs.tape(tuple(expressions), None).table(states, trace.values, times)


class Case:
    """A choice of parameters of a subject, with runs computed on demand.

    Parameters
    ----------
    subject : Subject
        The subject.
    parameters : mapping of str to float
        Values of some parameters.
    """

    def __init__(self, subject: Subject, parameters: Mapping[str, float]) -> None:
        self.subject = subject
        self.parameters = parameters
        self._runs: dict[str, Trace | None] = {}

    def _run_by(self, name: str) -> Trace | None:
        if name not in self._runs:
            self._runs[name] = self._run(name, self.parameters)
        return self._runs[name]

    @property
    def traces(self) -> Mapping[str, Trace]:
        """Engine -> run, the most accurate first, without engines that cannot run the model."""
        first = self.engine  # raises an error if there is none
        names = dict.fromkeys((first, *self.subject.observers))
        runs = {name: self._run_by(name) for name in names}
        return {name: trace for name, trace in runs.items() if trace is not None}

    @cached_property
    def engine(self) -> str:
        """The most accurate engine that can run the model."""
        for name in self.subject.observers:
            if self._run_by(name) is not None:
                return name
        raise SimulationError("; ".join(self.subject.missing.values()))

    @property
    def trace(self) -> Trace:
        """The run of the most accurate engine."""
        trace = self._run_by(self.engine)
        assert trace is not None
        return trace

    @property
    def sound(self) -> tuple[Trace, ...]:
        """The runs; raises `Undecidable` if one is not complete, which `assert_ended` reports."""
        for trace in self.traces.values():
            if not trace.outcome.succeeded:
                raise Undecidable("a run did not come to its end")
        return tuple(self.traces.values())

    @cached_property
    def sensitivity(self) -> Sensitivity:
        """Runs with parameters (except counts) perturbed by `NUDGE`, and conditions of events."""
        model = self.subject.model
        values = model.values(self.parameters)
        plain = {name for name, text in model.parameters.items() if not parse(text).names}
        varied = (plain | {*self.parameters}) - model.whole
        names = [name for name in model.parameters if name in varied]
        found = []
        for signs in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0)):
            nudges = {name: 1.0 + NUDGE * signs[i % 2] for i, name in enumerate(names)}
            finite = (name for name in names if math.isfinite(values[name]))
            changed = {name: values[name] * nudges[name] for name in finite}
            try:
                trace = self._run(self.engine, changed)
            except (DeclarationError, DeclarationProblem):
                continue  # beyond the bounds of the model
            if trace is not None and trace.outcome.succeeded:
                found.append(trace)
        if not found:
            raise Undecidable("no run with slightly changed parameters comes to its end")
        if self.trace.step is not None:  # events are not located
            return Sensitivity(found, ())
        observer = self.subject.observers[self.engine]
        return Sensitivity(found, conditions(observer, self.trace))

    def shorter(self, until: float) -> Trace:
        """Return the run of the most accurate engine up to `until`."""
        simulator = self.subject.observers[self.engine].simulator
        return self._uninterrupted(simulator, self.parameters, until)

    def loosened(self, relative: float) -> Trace:
        """Return the run of the most accurate engine with modes chosen at tolerance `relative`."""
        end = self.subject.end(self.parameters)
        return self._uninterrupted(self.subject.loosened(relative), self.parameters, end)

    def _uninterrupted(
        self,
        simulator: Simulator | SteppingSimulator,
        parameters: Mapping[str, float],
        until: float,
    ) -> Trace:
        """Return a run; an interruption ends the check."""
        trace = simulator.run(parameters, until=until, throw=False)
        if trace.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        return trace

    def _run(self, name: str, parameters: Mapping[str, float]) -> Trace | None:
        subject = self.subject
        if name in subject.missing:
            return None
        simulator = subject.observers[name].simulator
        trace = self._uninterrupted(simulator, parameters, subject.end(parameters))
        if trace.outcome is not Outcome.UNSUPPORTED:
            return trace
        # Some formulas have no Taylor series; earlier runs of the engine remain.
        subject.missing[name] = trace.message
        return None


def ranges(model: Declaration) -> dict[str, tuple[float, float]]:
    """Return the ranges of a check: parameter -> least and greatest value.

    The declared ranges. Without any, from half to twice the value of every parameter that is a
    number other than 0 and inf, reduced to valid models (a restitution of 0.9 cannot be 1.8).

    Parameters
    ----------
    model : Declaration
        A chart, a scene.
    """
    if model.ranges:
        return dict(model.ranges)
    values = model.values()
    found = {}
    for name, text in model.parameters.items():
        value = values[name]
        if parse(text).names or value == 0.0 or math.isinf(value):
            continue
        ends = [_valid_towards(model, name, value, factor * value) for factor in (0.5, 2.0)]
        found[name] = (min(ends), max(ends))
    return found


def _valid_towards(model: Declaration, name: str, value: float, end: float) -> float:
    for halvings in range(8):
        candidate = value + (end - value) * 0.5**halvings
        try:
            changed = {"parameters": {**model.parameters, name: candidate}}
            data = model.model_dump(by_alias=True) | changed
            type(model).model_validate(data, by_alias=True)
        except ValidationError:
            continue
        return candidate
    return value


def parameters(model: Declaration) -> SearchStrategy[dict[str, float]]:
    """Return the strategy over the `ranges` of a model.

    Shrinking leads to the declared values. Ends of ranges are drawn often.

    Parameters
    ----------
    model : Declaration
        A chart, a scene.

    Returns
    -------
    SearchStrategy
        Of parameter -> value, as runs take them.
    """
    from hypothesis import strategies as st

    values = model.values()
    choices: dict[str, SearchStrategy[float]] = {}
    for name, (least, greatest) in ranges(model).items():
        declared = values[name]
        if name in model.whole:
            choices[name] = st.integers(math.ceil(least), math.floor(greatest)).map(float)
            continue
        # Subnormal numbers have few digits.
        within = st.floats(least, greatest, allow_subnormal=False)
        drawn = [within, st.sampled_from((least, greatest))]
        if least <= declared <= greatest:
            drawn.insert(0, st.just(declared))
        choices[name] = st.one_of(drawn)
    return st.fixed_dictionaries(choices)
