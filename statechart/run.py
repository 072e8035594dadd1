"""A model and an end to a result: settings, engine, accuracy on request."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from statechart.accuracy import difference
from statechart.automaton import Automaton, Setup
from statechart.declaration import Declaration
from statechart.document import Document, find, interpret, read
from statechart.engine import Engine
from statechart.engines import choose
from statechart.errors import (
    DeclarationError,
    DeclarationProblem,
    FormulaError,
    StatechartError,
)
from statechart.formula import close_matches, parse
from statechart.kinds import kind
from statechart.observe import Observer
from statechart.outputs import Outputs
from statechart.outputs import Result as Output
from statechart.simulate import Simulator, error_of
from statechart.stepping import SteppingSimulator
from statechart.trace import Key, Outcome, Trace

__all__ = ["Result", "Runner", "run"]

# The step from one tolerance to the next when an error is estimated. Measured over 180 runs: with
# it the difference of the two bounds the error in 179, at 3.2 to 3.7 times the cost of one.
_TIGHTER = 1.0 / 20.0
# Errors of a run exceed its tolerance by about so much: where an accuracy is asked for, the first
# tolerance is that far below.
_BELOW = 1.0 / 10.0


@dataclass(frozen=True, eq=False)
class Result:
    """What a run gave.

    Attributes
    ----------
    trace : Trace
        Arcs and jumps, the outcome, warnings, costs.
    observer : Observer
        Evaluates formulas along the trace.
    error_estimate : float or None
        Where an accuracy was asked for: the largest difference between this run and one at 20
        times its tolerance, of the final state, the times of events and the outputs, each
        relative to its own size; inf where the two took different modes.
    timings : mapping of str to float
        What took how many seconds.
    """

    trace: Trace
    observer: Observer
    error_estimate: float | None
    timings: Mapping[str, float]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know."""
        return self.trace.warnings

    @cached_property
    def outputs(self) -> Mapping[str, Output]:
        """The outputs that the model declares."""
        return Outputs(self.observer).of(self.trace)

    def report(self, *, explain: bool = False) -> dict[str, Any]:
        """Return the run as one plain object; see `statechart.report.report`."""
        from statechart.report import report

        return report(
            self.observer,
            self.trace,
            error_estimate=self.error_estimate,
            timings=self.timings,
            explain=explain,
        )

    def save(self, folder: Path | str) -> tuple[str, ...]:
        """Write tables, data set and figure; see `statechart.tables.write_run`."""
        from statechart.tables import write_run

        return write_run(folder, self.observer, self.trace, self.report(explain=True))


class Runner:
    """A model on an engine, compiled once for many runs.

    What is not given is what the model's settings say.

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
        Error allowed, relative to the size of what is computed: tolerances are tightened until
        the estimated error is below it.
    step : float, optional
        Length of a step in time; of the engine impulse, which needs it.
    progress : bool
        Whether runs above about a second report to stderr.

    Raises
    ------
    DeclarationError
        If the model or one of the settings is wrong.
    """

    def __init__(
        self,
        model: Declaration | Document | str | Path,
        *,
        engine: str | None = None,
        method: str | None = None,
        tolerance: float | None = None,
        accuracy: float | None = None,
        step: float | None = None,
        progress: bool = False,
    ) -> None:
        began = time.perf_counter()
        self.document: Document | None = None
        if isinstance(model, str | Path):
            model = read(find(str(model)))
        if isinstance(model, Document):
            self.document = model
            model = _declaration(model)
        self.model = model
        read_at = time.perf_counter()
        self.automaton = _automaton(model)
        self.accuracy: float | None = None
        self._reason = ""
        self._timings = {"read": read_at - began, "compose": time.perf_counter() - read_at}
        self._progress = progress
        self.step = self._stepping(engine, method, tolerance, accuracy, step)
        if self.step is None:
            self._settle(engine, method, tolerance, accuracy)
        self._observers: dict[float, Observer] = {}

    def run(
        self,
        parameters: Mapping[str, float] | None = None,
        *,
        until: float | None = None,
        throw: bool = True,
    ) -> Result:
        """Run from the declared initial state.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            Values that replace those of some parameters.
        until : float, optional
            End of the run; `stop.time` of the model by default.
        throw : bool
            Raise where the run cannot go on; else return what there is, with its outcome.

        Raises
        ------
        DeclarationError
            If a parameter or the end is wrong, or the initial state is.
        SimulationError
            With the trace so far, if the run cannot go on and `throw` is set.
        """
        overrides = dict(parameters or {})
        end = self._end(overrides, until)
        began = time.perf_counter()
        if self.step is not None:
            observer, trace = self._once(math.nan, overrides, end)
            estimate = None
        elif self.accuracy is None:
            observer, trace = self._once(self._engine.tolerance, overrides, end)
            estimate = None
        else:
            observer, trace, estimate = self._accurate(self.accuracy, overrides, end)
        if self._reason:
            trace = replace(trace, warnings=(self._reason, *trace.warnings))
        if throw and not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
            raise error_of(trace)
        timings = {**self._timings, "run": time.perf_counter() - began}
        return Result(trace, observer, estimate, timings)

    def start(self, parameters: Mapping[str, float] | None = None) -> tuple[Key, tuple[str, ...]]:
        """Check the initial state without running; return its mode and the warnings.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            As for `run`.

        Raises
        ------
        DeclarationError, SimulationError
            If no run can start there.
        """
        overrides = dict(parameters or {})
        mode, warnings = self._begin(overrides)
        found = (self._reason, *warnings)
        return mode, tuple(dict.fromkeys(text for text in found if text))

    def setup(self, parameters: Mapping[str, float] | None = None) -> Setup:
        """Return the numbers of a run: parameters, initial state, tolerances.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            As for `run`.

        Raises
        ------
        DeclarationError
            If a parameter or a number that follows from it is wrong.
        """
        overrides = dict(parameters or {})
        self._check(overrides)
        relative = math.nan if self.step is not None else self._engine.tolerance
        try:
            return self.automaton.laws.setup(overrides, relative)
        except DeclarationProblem as problem:
            raise self._located(problem, overrides) from None
        except FormulaError as error:
            raise self._formula(error, ("parameters", error.name)) from None

    def _stepping(
        self,
        engine: str | None,
        method: str | None,
        tolerance: float | None,
        accuracy: float | None,
        step: float | None,
    ) -> float | None:
        """Return the step where the engine is impulse, else None."""
        settings = self.model.settings
        named = engine or ("scipy" if method is not None else settings.engine)
        if named != "impulse":
            if step is not None:
                raise DeclarationError(
                    f"the engine {named} chooses its own steps",
                    advice="leave the step out, or take the engine impulse",
                )
            return None
        for what, given in (
            ("method", method), ("tolerance", tolerance), ("accuracy", accuracy)
        ):  # fmt: skip
            if given is not None:
                raise DeclarationError(
                    f"the engine impulse has no {what}",
                    advice="its error follows the step: give a step",
                )
        if self.automaton.stepper is None:
            raise DeclarationError(
                f"{self.model.name!r} cannot run on the engine impulse, which moves bodies in "
                "contact: a scene is needed",
                advice="take the engine taylor or scipy",
            )
        step = settings.step if step is None else step
        if step is None:
            raise DeclarationError(
                "the engine impulse needs a step",
                advice="say --step 1e-3, or write settings: {engine: impulse, step: 1e-3}; a "
                "thousandth of the shortest time of interest is a good start",
            )
        if not 0.0 < step < math.inf:
            raise DeclarationError(f"the step must be a positive time, not {step:g}")
        return step

    def _settle(
        self,
        engine: str | None,
        method: str | None,
        tolerance: float | None,
        accuracy: float | None,
    ) -> None:
        settings = self.model.settings
        if tolerance is not None and accuracy is not None:
            raise DeclarationError(
                "tolerance and accuracy exclude each other",
                advice="accuracy finds the tolerance that it needs",
            )
        for what, value in (("tolerance", tolerance), ("accuracy", accuracy)):
            if value is not None and not 0.0 < value < 1.0:
                raise DeclarationError(f"{what} must be above 0 and below 1, not {value:g}")
        if engine is None:
            # A method asks for the engine that has methods, whatever the file says.
            engine = settings.engine if method is None else "scipy"
            method = method or settings.method
        elif engine != "taylor":
            method = method or settings.method
        if tolerance is None and accuracy is None:
            tolerance, accuracy = settings.tolerance, settings.accuracy
        self.accuracy = accuracy
        self._named, self._method = engine, method
        self._engine, self._reason = self._choose(tolerance)

    def _choose(self, tolerance: float | None) -> tuple[Engine, str]:
        return choose(engine=self._named, method=self._method, tolerance=tolerance)

    def _end(self, overrides: Mapping[str, float], until: float | None) -> float:
        values = self._check(overrides)
        if until is not None:
            if not 0.0 <= until < math.inf:
                raise DeclarationError(f"the end must be a finite time from 0 on, not {until:g}")
            return until
        text = self.model.stop.time
        if text is None:
            raise self._located(
                DeclarationProblem(
                    "the run has no end",
                    advice="write stop: {time: 10}, or say until when",
                    loc=("stop",),
                ),
                {},
            )
        try:
            end = parse(text).value(values)
        except FormulaError as error:
            raise self._formula(error, ("stop", "time")) from None
        if not 0.0 <= end < math.inf:
            raise self._located(
                DeclarationProblem(f"must be a finite time, not {end:g}", loc=("stop", "time")),
                overrides,
            )
        return end

    def _check(self, overrides: Mapping[str, float]) -> dict[str, float]:
        """Return the parameters' values with `overrides`."""
        for name, value in overrides.items():
            if name not in self.model.parameters:
                raise DeclarationError(
                    f"no parameter {name!r}",
                    advice=close_matches(name, self.model.parameters),
                    source=self.document.source if self.document else "",
                )
            if math.isnan(value):
                raise DeclarationError(f"parameter {name!r} must be a number, not nan")
        try:
            return self.model.values(overrides)
        except FormulaError as error:
            raise self._formula(error, ("parameters", error.name)) from None

    def _once(
        self, tolerance: float, overrides: Mapping[str, float], end: float
    ) -> tuple[Observer, Trace]:
        observer = self._observer(tolerance)
        limit = self.model.settings.max_jumps
        try:
            trace = observer.simulator.run(overrides, until=end, max_jumps=limit, throw=False)
        except DeclarationProblem as problem:
            raise self._located(problem, overrides) from None
        except FormulaError as error:
            raise self._formula(error, ("parameters", error.name)) from None
        except StatechartError as error:
            if not self._fall_back(error):
                raise
            return self._once(self._engine.tolerance, overrides, end)
        return observer, trace

    def _observer(self, tolerance: float) -> Observer:
        if self.step is not None:
            return self._stepped(self.step)
        found = self._observers.get(tolerance)
        if found is None:
            engine = self._choose(tolerance)[0]
            simulator = Simulator(self.automaton, engine, progress=self._progress)
            found = self._observers[tolerance] = Observer(simulator)
        return found

    def _stepped(self, step: float) -> Observer:
        found = self._observers.get(step)
        if found is None:
            simulator = SteppingSimulator(self.automaton, step, progress=self._progress)
            found = self._observers[step] = Observer(simulator)
        return found

    def _fall_back(self, error: StatechartError) -> bool:
        """Take scipy where taylor was picked for the user and cannot expand a flow."""
        if self._named != "auto" or self._engine.name != "taylor":
            return False
        from statechart.engines.taylor import Unsupported

        if not isinstance(error, Unsupported):
            return False
        self._named = "scipy"
        given = self.model.settings.tolerance
        self._engine = self._choose(given)[0]
        self._reason = f"engine scipy: {error}"
        self._observers.clear()
        return True

    def _accurate(
        self, accuracy: float, overrides: Mapping[str, float], end: float
    ) -> tuple[Observer, Trace, float]:
        """Run at ever tighter tolerances until two runs differ by less than `accuracy`."""
        floor = self._choose(math.ulp(0.0))[0].tolerance
        tolerance = max(accuracy * _BELOW, floor / _TIGHTER)
        observer, trace = self._once(tolerance, overrides, end)
        warnings: list[str] = []
        while trace.outcome is not Outcome.INTERRUPTED:
            coarse, coarse_outputs = trace, Outputs(observer).of(trace)
            tolerance = max(tolerance * _TIGHTER, floor)
            observer, trace = self._once(tolerance, overrides, end)
            if trace.outcome is Outcome.INTERRUPTED:
                break
            estimate, diverged = difference(
                coarse, trace, coarse_outputs, Outputs(observer).of(trace)
            )
            if diverged is not None:
                warnings.append(
                    f"runs at tolerances {coarse.tolerance:.2g} and {trace.tolerance:.2g} take "
                    f"different modes: accuracy is undefined from t = {diverged:.17g} on"
                )
            if estimate <= accuracy:
                # What looser tolerances did is of no concern now.
                return observer, trace, estimate
            if tolerance <= floor:
                if diverged is None:
                    warnings.append(
                        f"the accuracy {accuracy:g} was not reached: at the least tolerance of "
                        f"the engine the estimated error is {estimate:.2g}"
                    )
                return observer, _warned(trace, warnings[-1:]), estimate
        return observer, _warned(trace, ["interrupted before its error was estimated"]), math.inf

    def _begin(self, overrides: Mapping[str, float]) -> tuple[Key, tuple[str, ...]]:
        try:
            if self.automaton.stepper is not None and self.step is not None:
                self._check(overrides)
                return self.automaton.stepper().start(overrides)
            setup = self.setup(overrides)
            flow, _ = self.automaton.laws.begin(setup)
        except DeclarationProblem as problem:
            raise self._located(problem, overrides) from None
        except FormulaError as error:
            raise self._formula(error, ("parameters", error.name)) from None
        return flow.mode, (*setup.warnings, flow.warning)

    def _located(
        self, problem: DeclarationProblem, overrides: Mapping[str, float]
    ) -> DeclarationError:
        """Return a problem with its place in the document, and the overrides that led to it."""
        path = ".".join(map(str, problem.loc))
        message = f"{path}: {problem.message}" if path else problem.message
        if overrides:
            message += " with " + ", ".join(f"{k}={v:g}" for k, v in overrides.items()) + " set"
        if self.document is None:
            return DeclarationError(message, advice=problem.advice)
        at = self.document.position(problem.loc, key=problem.key).shifted(problem.offset)
        return DeclarationError(
            message, advice=problem.advice, source=at.source, line=at.line, column=at.column
        )

    def _formula(self, error: FormulaError, loc: tuple[str, ...]) -> DeclarationError:
        problem = DeclarationProblem(
            error.message, advice=error.advice, loc=loc, offset=error.offset
        )
        return self._located(problem, {})


def run(
    model: Declaration | Document | str | Path,
    *,
    parameters: Mapping[str, float] | None = None,
    until: float | None = None,
    engine: str | None = None,
    method: str | None = None,
    tolerance: float | None = None,
    accuracy: float | None = None,
    step: float | None = None,
    progress: bool = False,
    throw: bool = True,
) -> Result:
    """Run a model once; see `Runner` and `Runner.run` for the parameters.

    Examples
    --------
    >>> result = run("bouncing_ball", parameters={"k": 0.5})
    >>> result.trace.outcome.name
    'HORIZON'
    """
    runner = Runner(
        model,
        engine=engine,
        method=method,
        tolerance=tolerance,
        accuracy=accuracy,
        step=step,
        progress=progress,
    )
    return runner.run(parameters, until=until, throw=throw)


def _declaration(document: Document) -> Declaration:
    model = interpret(document)
    if not isinstance(model, Declaration):
        raise TypeError(f"a kind of document must be a Declaration, not {type(model).__name__}")
    return model


def _automaton(model: Declaration) -> Automaton:
    automaton = kind(str(getattr(model, "kind", ""))).automaton(model)
    if not isinstance(automaton, Automaton):
        raise TypeError(f"a kind must build an Automaton, not {type(automaton).__name__}")
    return automaton


def _warned(trace: Trace, warnings: list[str]) -> Trace:
    return replace(trace, warnings=(*trace.warnings, *warnings))
