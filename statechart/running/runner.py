"""Runner: a model on an engine, with checked inputs and located errors."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Unpack

from statechart.automaton.laws import Setup
from statechart.automaton.time_stepper import Control, Sample, Sampling
from statechart.automaton.trace import Arc, Jump, Key, Outcome
from statechart.compiling import working_time
from statechart.documents.declaration import Declaration
from statechart.documents.hints import check_arguments, unknown_parameter
from statechart.documents.setting import Record, Setting, SettingWords, describe_value, is_real
from statechart.documents.settings import LATE_END
from statechart.documents.validation import Document, located
from statechart.engines.engine import TimeBudget
from statechart.engines.request import Measured, plan_request
from statechart.errors import DeclarationError, DeclarationProblem, FormulaError
from statechart.execution.outcome import error_of
from statechart.execution.simulator import BatchRunner, Simulator
from statechart.formulas.formula import parse
from statechart.loading.kind import kind
from statechart.loading.load import resolve_model
from statechart.observation.observer import Observer
from statechart.observation.observers import Observers
from statechart.observation.outputs import Outputs, outputs_of
from statechart.running.accuracy import AccuracyRequest, RunPlanner
from statechart.running.result import Result


class Runner:
    """A model on an engine, compiled once for many runs.

    Arguments default to the settings of the model.

    Parameters
    ----------
    model : Declaration, str or Path
        A model, a file, or the name of a shipped model.
    engine : str, optional
        auto, taylor, scipy or impulse.
    method : str, optional
        RK45, DOP853, Radau or LSODA; of the engine scipy.
    tolerance : float, optional
        Relative tolerance of the integration.
    accuracy : float, optional
        Allowed relative error of the result: tolerances or time steps are reduced until the
        estimated error is below it.
    step : float, optional
        Time step of the engine impulse, which needs it or an accuracy; then it is the longest.
    budget : float, optional
        Seconds for a run: tolerances are tightened as long as there is time.
    max_step : float, optional
        Longest time step of engines with step size control.
    impulse_tolerance, impulse_bound : float, optional
        Residuals of the contact impulses in a step of the engine impulse, relative to its fastest
        approach velocity: above the first (1e-6 by default), steps are counted in a warning; above
        the second (by default none) the run ends.
    record : str, optional
        Recording of a run of the engine impulse: modes, poses (states at every step) or nothing
        (start, end and outputs).
    study : Study, optional
        Measurements of this model, which choose engine and tolerance.
    once : bool
        Choose the cheapest setting for a single run with its compilation, as on the command line;
        else for many runs of this runner.
    progress : bool
        Whether runs above about a second report to stderr.

    Raises
    ------
    DeclarationError
        If the model or one of the settings is wrong.
    """

    @check_arguments
    def __init__(
        self,
        model: Declaration | Document | str | Path,
        *,
        study: Measured | None = None,
        once: bool = False,
        progress: bool = False,
        **setting: Unpack[SettingWords],
    ) -> None:
        began = working_time()
        model, document = resolve_model(model)
        self.model = model
        self._inputs = RunInputs(model, document)
        self._copies = self._inputs.copies({})
        read_at = working_time()
        try:
            self.automaton = kind(model.kind).automaton(model)
        except FormulaError as error:
            loc = document.where(error.text) if document else ()
            with located(document, {}, loc):
                raise
        self._timings = {"read": read_at - began, "compose": working_time() - read_at}
        self._asked = Setting(**setting)
        self.study, self._once, self._progress = study, once, progress
        self._turn = threading.RLock()  # workspaces serve one run at a time
        # Cached runner of the last other number of copies of bodies.
        self._varied: Runner | None = None
        with located(document, {}):
            self._plan = plan_request(self._asked, model, self.automaton, study, once=once)
        budget = self._plan.setting.budget
        time_budget = None if budget is None else TimeBudget(budget)
        self.observers = Observers(self.automaton, time_budget=time_budget, progress=progress)
        self._planner = RunPlanner(self.observers, self._plan, time_budget)

    @property
    def document(self) -> Document | None:
        """The document of the model, if any."""
        return self._inputs.document

    @property
    def setting(self) -> Setting:
        """The setting of the last run, which may have fallen back to another engine."""
        return self._planner.setting

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the model and the setting; the other process compiles them."""
        return _restored, (self.model, self._arguments(self.study), self.document)

    @check_arguments
    def run(
        self,
        parameters: Mapping[str, float] | None = None,
        *,
        until: float | None = None,
        certify: bool = False,
        throw: bool = True,
    ) -> Result:
        """Run from the declared initial state.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            Values of some parameters.
        until : float, optional
            End of the run; `stop.time` of the model by default.
        certify : bool
            Bound the defect of every step with proof, and estimate the global error (see
            `Trace.motion`), in a second run; not on the engine impulse.
        throw : bool
            Raise an error if the run cannot go on; else return the partial result.

        Raises
        ------
        DeclarationError
            If a parameter, the end or the initial state is wrong.
        SimulationError
            With the trace so far, if the run cannot go on and `throw` is set.
        """
        overrides = as_overrides(parameters)
        end = self.end(overrides, until=until)
        fitting = self._fitting(overrides)
        if (measured := fitting._plan.measured) is not None and (overrides or end != measured):
            fitting = fitting._other(fitting.model, None)
        return fitting._run(overrides, end, certify=certify, throw=throw)

    def _fitting(self, overrides: Mapping[str, float]) -> Runner:
        """Return the runner for the numbers of copies of these values."""
        if self._inputs.copies(overrides) == self._copies:
            return self
        varied = self._varied
        if varied is None or varied._inputs.copies(overrides) != varied._copies:
            with located(self.document, overrides):
                variant = self.model.variant(overrides)
            self._varied = varied = self._other(variant, self.study)
        return varied

    def _run(
        self, overrides: Mapping[str, float], end: float, *, certify: bool, throw: bool
    ) -> Result:
        if certify and self.setting.stepped:
            message = "the engine impulse cannot certify: its steps follow no differential equation"
            advice = "leave certify out, or take the engine taylor or scipy"
            raise DeclarationError(message, advice=advice)
        planner = self._planner
        with self._turn, located(self.document, overrides):
            began = working_time()
            found, basis = planner.run(overrides, end)
            trace = planner.certified(found, overrides, end) if certify else found.trace
            setting, request = self.setting, None
            if planner.searching:
                parts = found.cost, found.not_judged, found.decides
                request = AccuracyRequest(setting, basis, *parts)
            warnings = (*filter(None, (planner.reason, *trace.warnings)), *found.warnings)
        trace = trace if warnings == trace.warnings else replace(trace, warnings=warnings)
        if throw and not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
            raise error_of(trace)
        timings = {**self._timings, "run": working_time() - began}
        if request is not None and setting.stepped:
            setting = replace(setting, step=trace.step, accuracy=None)
        elif request is not None:
            setting = replace(setting, tolerance=trace.tolerance)
        source = _Source(self, setting, found.observer)
        return Result(trace, found.observer, found.error, timings, source, request, self.study)

    def batch(self, names: Sequence[str]) -> tuple[Observer, BatchRunner] | None:
        """Return the observer and the batch runner for values of some parameters.

        None if runs cannot be batched: with an accuracy or budget, or with time stepping.
        """
        planner = self._planner
        if planner.searching or self.setting.stepped or self._plan.measured is not None:
            return None
        observer = self.observers.at(planner.first)
        assert isinstance(observer.simulator, Simulator)
        return observer, BatchRunner(observer.simulator, names)

    @check_arguments
    def stream(
        self,
        parameters: Mapping[str, float] | None = None,
        *,
        until: float | None = None,
        every: float = math.inf,
        control: Control | None = None,
    ) -> Iterator[Arc | Jump]:
        """Yield the arcs and jumps of a run as they are computed.

        Parameters
        ----------
        parameters, until
            As for `run`.
        every : float, optional
            Arcs end at multiples of this time (rounded to steps of the engine impulse).
        control : callable, optional
            Called at the start and at these multiples with a `Sample`: time, mode and variables.
            Returns new values of parameters.

        Raises
        ------
        DeclarationError
            As `run`, and with an accuracy or a budget, which take several runs.
        SimulationError
            If the run cannot go on, after its last item.

        Examples
        --------
        >>> from statechart import Jump
        >>> pieces = Runner("toppling_stick").stream()
        >>> [piece.cause for piece in pieces if isinstance(piece, Jump)]
        ['slip', 'reverse', 'stop']
        """
        overrides = as_overrides(parameters)
        end = self.end(overrides, until=until)
        setting = self.setting
        with located(self.document, overrides):
            variant = self.model.variant(overrides)
            if variant is not self.model:
                other = self._other(variant, None)
                return other.stream(overrides, until=end, every=every, control=control)
            self._inputs.values(overrides)
            if setting.accuracy is not None or setting.budget is not None:
                message = "a stream is a single run; an accuracy or a budget needs several"
                raise DeclarationError(message, advice="give a tolerance or a step instead")
            sampling = self._inputs.sampling(every, end, control)
            pieces = self.observers.fresh(setting).stream(overrides, sampling, until=end)

        def located_items() -> Iterator[Arc | Jump]:
            with located(self.document, overrides):  # includes errors of a control
                yield from pieces

        return located_items()

    def alternatives(self) -> dict[str, Runner]:
        """Return runners of the variants of the model (`Declaration.alternatives`), by name."""
        others = self.model.alternatives()
        return {choice: self._other(model, None) for choice, model in others.items()}

    def start(self, parameters: Mapping[str, float] | None = None) -> tuple[Key, tuple[str, ...]]:
        """Check the initial state; return its mode and warnings.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            As for `run`.

        Raises
        ------
        DeclarationError, SimulationError
            If no run can start.
        """
        overrides = as_overrides(parameters)
        with located(self.document, overrides):
            if self.automaton.stepper is not None and self.setting.stepped:
                self._inputs.values(overrides)
                mode, warnings = self.automaton.stepper().start(overrides)
            else:
                setup = self.setup(overrides)
                flow, _ = self.automaton.laws_of_events.begin(setup)
                mode, warnings = flow.mode, (*setup.warnings, flow.warning)
        return mode, tuple(dict.fromkeys(filter(None, (self._planner.reason, *warnings))))

    def setup(self, parameters: Mapping[str, float] | None = None) -> Setup:
        """Return the setup of a run: parameters, initial state, tolerances.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            As for `run`.

        Raises
        ------
        DeclarationError
            If a parameter or a derived number is wrong.
        """
        overrides = as_overrides(parameters)
        self._inputs.values(overrides)
        stepped = self.setting.stepped
        relative = math.nan if stepped else self.observers.engine(self.setting).tolerance
        with located(self.document, overrides):
            return self.automaton.setup(overrides, relative)

    def end(
        self, parameters: Mapping[str, float] | None = None, *, until: float | None = None
    ) -> float:
        """Return the end time of a run.

        Parameters
        ----------
        parameters, until
            As for `run`.

        Raises
        ------
        DeclarationError
            If a parameter or the end is wrong or missing.
        """
        return self._inputs.end(as_overrides(parameters), until)

    def __repr__(self) -> str:
        return f"<runner of {self.model.name}>"

    def with_modes(self) -> Runner:
        """Return a runner of the same model that records modes."""
        if self.setting.recorded is Record.MODES:
            return self
        return self._other(self.model, None, record=Record.MODES.value)

    def _arguments(self, study: Measured | None, **changed: str) -> dict[str, Any]:
        arguments = {**asdict(self._asked), **changed}
        return {**arguments, "study": study, "once": self._once, "progress": self._progress}

    def _other(self, model: Declaration, study: Measured | None, **changed: str) -> Runner:
        """Return a runner of another model or setting, with the other arguments of this one."""
        return _restored(model, self._arguments(study, **changed), self.document)


def _restored(model: Declaration, arguments: Any, document: Document | None) -> Runner:
    runner = Runner(model, **arguments)
    runner._inputs.document = document
    return runner


class _Source:
    """Picklable factory of the outputs and observer of a runner at a setting."""

    def __init__(self, runner: Runner, setting: Setting, observer: Observer | None = None) -> None:
        self.runner, self._setting, self._observer = runner, setting, observer

    def __reduce__(self) -> tuple[object, ...]:
        return _Source, (self.runner, self._setting)

    def __call__(self) -> Outputs:
        if self._observer is None:
            self._observer = self.runner.observers.at(self._setting)
        return outputs_of(self._observer)


@check_arguments
def run(
    model: Declaration | Document | str | Path,
    *,
    parameters: Mapping[str, float] | None = None,
    until: float | None = None,
    study: Measured | None = None,
    progress: bool = False,
    certify: bool = False,
    throw: bool = True,
    **setting: Unpack[SettingWords],
) -> Result:
    """Run a model once; see `Runner` and `Runner.run` for the parameters.

    A study chooses the setting as for `Runner(once=True)`.

    Examples
    --------
    >>> result = run("bouncing_ball", parameters={"k": 0.5})
    >>> result.trace.outcome.name
    'HORIZON'
    """
    runner = Runner(model, **setting, study=study, once=True, progress=progress)
    return runner.run(parameters, until=until, certify=certify, throw=throw)


class RunInputs:
    """Checks the inputs of runs of a model; errors have positions in its document."""

    def __init__(self, model: Declaration, document: Document | None) -> None:
        self.document = document
        self._parameters, self._constants = model.parameters, model.constants()
        self._count = model.counted if model.whole else None
        self._end = None if model.stop.time is None else parse(model.stop.time)

    def check(self, overrides: Mapping[str, float]) -> None:
        """Check names and values of parameters."""
        for name, value in overrides.items():
            if name not in self._parameters:
                raise DeclarationError(
                    f"no parameter {name!r}",
                    advice=unknown_parameter(str(name), self._parameters),
                    source=self.document.source if self.document else "",
                )
            if not is_real(value):
                message = f"parameter {name!r} must be a number, not {describe_value(value)}"
                advice = f"a formula is for with_({name}=...) of the model"
                raise DeclarationError(message, advice=advice)
            if math.isnan(value):
                raise DeclarationError(f"parameter {name!r} must be a number, not nan")

    def values(self, overrides: Mapping[str, float]) -> dict[str, float]:
        """Return the values of the parameters with `overrides`."""
        self.check(overrides)
        with located(self.document, overrides):
            return self._constants.values(overrides)

    def copies(self, overrides: Mapping[str, float]) -> Mapping[str, int | None]:
        """Return the numbers of copies of bodies with `overrides`."""
        if self._count is None:
            return {}
        values = self.values(overrides)
        with located(self.document, overrides):
            return self._count(values)

    def end(self, overrides: Mapping[str, float], until: float | None) -> float:
        """Return the end time of a run; see `Runner.end`."""
        self.check(overrides)
        if until is not None:
            if not is_real(until) or not 0.0 <= until < math.inf:
                message = f"the end must be a finite time from 0 on, not {describe_value(until)}"
                raise DeclarationError(message, advice=LATE_END if until == math.inf else "")
            return until
        with located(self.document, {} if self._end is None else overrides, ("stop", "time")):
            if self._end is None:
                advice = "write stop: {time: 10}, or --until T (in Python until=T)"
                raise DeclarationProblem("the run has no end", advice=advice, loc=("stop",))
            end = self._end.value(self.values(overrides) if self._end.names else {})
            if not 0.0 <= end < math.inf:
                message = f"must be a finite time, not {end:g}"
                raise DeclarationProblem(message, loc=("stop", "time"))
        return end

    def sampling(self, every: float, end: float, control: Control | None) -> Sampling:
        """Return the sampling of a stream; see `Runner.stream`."""
        if not is_real(every) or not every > 0.0 or (control is not None and every == math.inf):
            message = f"every must be a finite time above 0, not {describe_value(every)}"
            advice = "give the sampling period of control, such as every=0.01"
            raise DeclarationError(message, advice=advice)
        if control is not None and not callable(control):
            raise DeclarationError(
                f"control must be a function, not {control!r}",
                advice="it takes a sample, and returns parameters and their values, or None",
            )
        if end + every == end > 0.0:
            message = f"every must be above the round-off of time at {end:g}, not {every:g}"
            raise DeclarationError(message, advice="sample less often, or end the run earlier")
        if control is None:
            return Sampling(every, None)

        def checked(sample: Sample) -> Mapping[str, float] | None:
            changed = control(sample)
            if not isinstance(changed, Mapping | None):
                raise DeclarationError(
                    f"control must return parameters and their values, or None, not {changed!r}",
                    advice="such as {'mu': 0.3}",
                )
            self.check(changed or {})
            return changed

        return Sampling(every, checked)


def as_overrides(parameters: Mapping[str, float] | None) -> dict[str, float]:
    """Return the parameters of a call as a dictionary."""
    if parameters is not None and not isinstance(parameters, Mapping):
        raise DeclarationError(
            f"parameters are names and their values, not {parameters!r}",
            advice="such as parameters={'mu': 0.3}",
        )
    return dict(parameters or {})
