"""A model and an end to a result: settings, engine, accuracy on request."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from statechart.automaton import Automaton, Setup
from statechart.budget import Allowance, Limited
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
from statechart.estimate import BELOW, TIGHTER, Answer, Cost, tighten, within
from statechart.formula import close_matches, parse
from statechart.kinds import kind
from statechart.nudge import nudged
from statechart.observe import Observer
from statechart.outputs import Outputs
from statechart.outputs import Result as Output
from statechart.simulate import Simulator, error_of
from statechart.stepping import SteppingSimulator
from statechart.trace import Key, Outcome, Trace

if TYPE_CHECKING:
    from statechart.study import Study

__all__ = ["Asked", "Result", "Runner", "run"]


@dataclass(frozen=True)
class Asked:
    """What was asked for instead of a tolerance, and what it took.

    Attributes
    ----------
    accuracy : float or None
        Relative error allowed.
    budget : float or None
        Seconds allowed.
    basis : str
        What the first tolerance was chosen by.
    cost : Cost
        Of all runs.
    """

    accuracy: float | None
    budget: float | None
    basis: str
    cost: Cost

    def reached(self, estimate: float | None) -> bool:
        """Whether `estimate` is what was asked for: of an accuracy, any of a budget."""
        return estimate is not None and estimate <= (self.accuracy or math.inf)

    def report(self, estimate: float | None) -> dict[str, Any]:
        """Return this as one plain object."""
        return {
            "accuracy": self.accuracy,
            "budget": self.budget,
            "reached": self.reached(estimate),
            "basis": self.basis,
            "cost": asdict(self.cost),
        }


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
        relative to its own size; inf where the two took different modes. None where nothing was
        estimated.
    timings : mapping of str to float
        What took how many seconds.
    asked : Asked or None
        The accuracy or the budget that was asked for, and what it took.
    """

    trace: Trace
    observer: Observer
    error_estimate: float | None
    timings: Mapping[str, float]
    asked: Asked | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know."""
        return self.trace.warnings

    @cached_property
    def outputs(self) -> Mapping[str, Output]:
        """The outputs that the model declares."""
        return Outputs(self.observer).of(self.trace)

    @cached_property
    def conditions(self) -> tuple[float | None, ...]:
        """How much an error is magnified into the time of every event; see `conditions`."""
        from statechart.condition import conditions

        return conditions(self.observer, self.trace)

    def report(self, *, explain: bool = False) -> dict[str, Any]:
        """Return the run as one plain object; see `statechart.report.report`."""
        from statechart.report import report

        return report(
            self.observer,
            self.trace,
            error_estimate=self.error_estimate,
            timings=self.timings,
            explain=explain,
            asked=None if self.asked is None else self.asked.report(self.error_estimate),
            conditions=() if self.asked is None else self.conditions,
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
    budget : float, optional
        Seconds allowed for a run: tolerances are tightened as long as there is time.
    study : Study, optional
        What was measured of this model: engine and first tolerance are chosen by it.
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
        budget: float | None = None,
        study: Study | None = None,
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
        self.budget: float | None = None
        self._reason = ""
        self._timings = {"read": read_at - began, "compose": time.perf_counter() - read_at}
        self._progress = progress
        self.step = self._stepping(engine, method, tolerance, accuracy, budget, step)
        self._allowance: Allowance | None = None
        self._first: float | None = None
        if self.step is None:
            self._settle(engine, method, tolerance, accuracy, budget)
            self._learn(study)
        self._observers: dict[tuple[float, bool], Observer] = {}
        self._options: dict[str, Any] = {
            "engine": engine,
            "method": method,
            "tolerance": tolerance,
            "accuracy": accuracy,
            "step": step,
            "budget": budget,
            "study": study,
            "progress": progress,
        }

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
        end = self.end(overrides, until=until)
        variant = self.model.variant(overrides)
        if variant is not self.model:
            return self._other(variant).run(overrides, until=end, throw=throw)
        began = time.perf_counter()
        answer = self._answer(overrides, end)
        observer, trace, estimate = answer.observer, answer.trace, answer.estimate
        asked = None
        if self.accuracy is not None or self.budget is not None:
            asked = Asked(self.accuracy, self.budget, self._basis, answer.cost)
        if answer.warnings:
            trace = replace(trace, warnings=(*trace.warnings, *answer.warnings))
        if self._reason:
            trace = replace(trace, warnings=(self._reason, *trace.warnings))
        if throw and not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
            raise error_of(trace)
        timings = {**self._timings, "run": time.perf_counter() - began}
        return Result(trace, observer, estimate, timings, asked)

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
        budget: float | None,
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
            ("method", method), ("tolerance", tolerance), ("accuracy", accuracy),
            ("budget", budget),
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
        budget: float | None,
    ) -> None:
        settings = self.model.settings
        given = {"tolerance": tolerance, "accuracy": accuracy, "budget": budget}
        named = [what for what, value in given.items() if value is not None]
        if len(named) > 1:
            raise DeclarationError(
                f"{' and '.join(named)} exclude each other",
                advice="accuracy and budget find the tolerance that they need",
            )
        if budget is not None:
            if not 0.0 < budget < math.inf:
                raise DeclarationError(f"the budget must be a time in seconds, not {budget:g}")
            self._allowance = Allowance(budget)
        for what, value in (("tolerance", tolerance), ("accuracy", accuracy)):
            if value is not None and not 0.0 < value < 1.0:
                raise DeclarationError(f"{what} must be above 0 and below 1, not {value:g}")
        if engine is None:
            # A method asks for the engine that has methods, whatever the file says.
            engine = settings.engine if method is None else "scipy"
            method = method or settings.method
        elif engine != "taylor":
            method = method or settings.method
        if not named:
            tolerance, accuracy = settings.tolerance, settings.accuracy
        self.accuracy, self.budget = accuracy, budget
        self._named, self._method = engine, method
        self._engine, self._reason = self._choose(tolerance)

    def _learn(self, study: Study | None) -> None:
        """Choose the engine and the first tolerance by what was measured, where something was."""
        self._first = None if self.accuracy is None else self.accuracy * BELOW
        self._basis = "estimated: nothing was measured of this model"
        if study is None or (self.accuracy is None and self.budget is None):
            return
        from statechart.study import fingerprint

        if study.fingerprint != fingerprint(self.model):
            self._basis = "estimated: the study given is of another model"
            return
        found = study.choose(
            accuracy=self.accuracy,
            budget=self.budget,
            engine=None if self._named == "auto" else self._named,
            method=self._method,
        )
        if found is None:
            self._basis = "estimated: no setting that was measured is expected to do"
            return
        self._named, self._method, self._first = found.engine, found.method, found.tolerance
        if self.budget is not None and self._first is not None:
            # Two runs are to fit in: that one, and one before it to compare it with.
            self._first /= TIGHTER
        self._engine, self._reason = self._choose(None)
        self._basis = f"measured: {found.label}"

    def _choose(self, tolerance: float | None) -> tuple[Engine, str]:
        engine, reason = choose(engine=self._named, method=self._method, tolerance=tolerance)
        if self._allowance is not None:
            engine = Limited(engine, self._allowance)
        return engine, reason

    def end(
        self, parameters: Mapping[str, float] | None = None, *, until: float | None = None
    ) -> float:
        """Return when a run ends at the latest.

        Parameters
        ----------
        parameters, until
            As for `run`.

        Raises
        ------
        DeclarationError
            If a parameter or the end is wrong, or there is none.
        """
        overrides = dict(parameters or {})
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
        self, tolerance: float, overrides: Mapping[str, float], end: float, *, off: bool = False
    ) -> tuple[Observer, Trace]:
        observer = self._observer(tolerance, off)
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
            if self._first is None and self._allowance is None:
                tolerance = self._engine.tolerance
            return self._once(tolerance, overrides, end, off=off)
        return observer, trace

    def _observer(self, tolerance: float, off: bool) -> Observer:
        """Return what makes the runs at a tolerance; `off`: from a start off by it."""
        if self.step is not None:
            return self._stepped(self.step)
        found = self._observers.get((tolerance, off))
        if found is None:
            engine = self._choose(tolerance)[0]
            automaton = nudged(self.automaton) if off else self.automaton
            simulator = Simulator(automaton, engine, progress=self._progress)
            found = self._observers[tolerance, off] = Observer(simulator)
        return found

    def _other(self, variant: Declaration) -> Runner:
        """Return what runs another model in the place of this one."""
        other = Runner(variant, **self._options)
        other.document = self.document
        return other

    def _stepped(self, step: float) -> Observer:
        found = self._observers.get((step, False))
        if found is None:
            simulator = SteppingSimulator(self.automaton, step, progress=self._progress)
            found = self._observers[step, False] = Observer(simulator)
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

    def _answer(self, overrides: Mapping[str, float], end: float) -> Answer:
        def once(tolerance: float, off: bool) -> tuple[Observer, Trace]:
            return self._once(tolerance, overrides, end, off=off)

        if self.step is not None:
            observer, trace = once(math.nan, False)
            return Answer(observer, trace, None, Cost(1, 0, 0, 0.0))
        floor = self._choose(math.ulp(0.0))[0].tolerance
        if self.accuracy is not None and self._first is not None:
            return tighten(once, self.accuracy, first=self._first, floor=floor)
        if self._allowance is not None:
            self._allowance.begin()
            return within(once, self._allowance.seconds, first=self._first, floor=floor)
        observer, trace = once(self._engine.tolerance, False)
        return Answer(observer, trace, None, Cost(1, 0, 0, 0.0))

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
    budget: float | None = None,
    study: Study | None = None,
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
        budget=budget,
        study=study,
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
