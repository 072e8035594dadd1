"""A model and an end to a result: what is asked for, on an engine, with its problems located."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from statechart.automaton.laws import Setup
from statechart.automaton.sampling import Control
from statechart.automaton.trace import Arc, Jump, Key, Outcome
from statechart.compiling import working_time
from statechart.documents.declaration import Declaration
from statechart.documents.document import Document
from statechart.documents.hints import checked
from statechart.documents.setting import Record, Setting
from statechart.documents.validation import located
from statechart.engines.budget import Allowance
from statechart.engines.request import planned
from statechart.errors import DeclarationError, FormulaError
from statechart.execution.outcome import error_of
from statechart.execution.rows import RowRunner
from statechart.execution.simulator import Simulator
from statechart.kernels.jit import meanwhile
from statechart.loading.kind import kind
from statechart.loading.load import resolved
from statechart.observation.observer import Observer
from statechart.observation.observers import Observers
from statechart.running.answer import Asked
from statechart.running.answers import Answers
from statechart.running.given import Given, overridden
from statechart.running.result import Result
from statechart.running.streaming import placed, sampled, unsearched

if TYPE_CHECKING:
    from statechart.engines.request import Measured


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
        Error allowed, relative to the size of what is computed: tolerances are tightened, or
        steps of the engine impulse shortened, until the estimated error is below it.
    step : float, optional
        Length of a step in time, of the engine impulse, which needs it or an accuracy; then it is
        the longest.
    budget : float, optional
        Seconds allowed for a run: tolerances are tightened as long as there is time.
    max_step : float, optional
        Longest step in time, of the engines that choose their own.
    impulse_tolerance, impulse_bound : float, optional
        By how much the impulses of a step of the engine impulse may miss the contact laws, in parts
        of the step's fastest approach, 1e-6 by default: more is told, and beyond the bound, which
        is none by default, ends the run.
    record : str, optional
        What is kept of a run of the engine impulse: modes, poses (states at every step) or nothing
        (start, end and outputs).
    study : Study, optional
        What was measured of this model: engine and tolerance are chosen by it.
    once : bool
        Whether what is chosen is to be the cheapest for a single run, which loads and compiles
        all that it needs, as those of the command line; else for many runs of this runner. Python
        may take its steps of time while another process compiles what takes them.
    progress : bool
        Whether runs above about a second report to stderr.

    Raises
    ------
    DeclarationError
        If the model or one of the settings is wrong.
    """

    # One argument for every word of a setting: what a person writes.
    @checked
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
        max_step: float | None = None,
        impulse_tolerance: float | None = None,
        impulse_bound: float | None = None,
        record: str | None = None,
        study: Measured | None = None,
        once: bool = False,
        progress: bool = False,
    ) -> None:
        began = working_time()
        model, self.document = resolved(model)
        self.model = model
        self._given = Given(model)
        self._counted = self._given.counted({}, self.document)
        read_at = working_time()
        try:
            self.automaton = kind(model.kind).automaton(model)
        except FormulaError as error:
            loc = self.document.where(error.text) if self.document else ()
            with located(self.document, {}, loc):
                raise
        self._timings = {"read": read_at - began, "compose": working_time() - read_at}
        self._asked = Setting(
            engine, method, tolerance, accuracy, step, budget, max_step, impulse_tolerance,
            impulse_bound, record,
        )  # fmt: skip
        self.study, self._alone, self._progress = study, once, progress
        self._turn = threading.RLock()  # what is compiled has memory that serves one run at a time
        # The last one with other copies of bodies: composing takes its time.
        self._varied: Runner | None = None
        with located(self.document, {}):
            self._plan = planned(self._asked, model, self.automaton, study, once=once)
        budget = self._plan.setting.budget
        allowance = None if budget is None else Allowance(budget)
        self.observers = Observers(self.automaton, allowance=allowance, progress=progress)
        self._answers = Answers(model, self.observers, self._plan, allowance)

    @property
    def setting(self) -> Setting:
        """How it is run; the engine is another one where the first choice could not."""
        return self._answers.setting

    def __reduce__(self) -> tuple[object, ...]:
        """Travel as the model and what is asked for: what is compiled is compiled anew there."""
        asked = {
            **asdict(self._asked),
            "study": self.study,
            "once": self._alone,
            "progress": self._progress,
        }
        return partial(Runner, self.model, **asked), (), {"document": self.document}

    @checked
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
            Values that replace those of some parameters.
        until : float, optional
            End of the run; `stop.time` of the model by default.
        certify : bool
            Prove of every step how far it is off its differential equation, and estimate what all
            of them amount to (see `Trace.motion`), in a second run; not on the engine impulse.
        throw : bool
            Raise where the run cannot go on; else return what there is, with its outcome.

        Raises
        ------
        DeclarationError
            If a parameter or the end is wrong, or the initial state is.
        SimulationError
            With the trace so far, if the run cannot go on and `throw` is set.
        """
        overrides = overridden(parameters)
        end = self.end(overrides, until=until)
        fitting = self._fitting(overrides)
        if (measured := fitting._plan.measured) is not None and (overrides or end != measured):
            fitting = fitting._other(fitting.model, None)
        return fitting._run(overrides, end, certify=certify, throw=throw)

    def _fitting(self, overrides: Mapping[str, float]) -> Runner:
        """Return what runs as many copies as these values make: this one where it does."""
        if self._given.counted(overrides, self.document) == self._counted:
            return self
        varied = self._varied
        if varied is None or varied._given.counted(overrides, self.document) != varied._counted:
            with located(self.document, overrides):
                variant = self.model.variant(overrides)
            self._varied = varied = self._other(variant, self.study)
        return varied

    def _run(self, given: Mapping[str, float], end: float, *, certify: bool, throw: bool) -> Result:
        if certify and self.setting.stepped:
            raise DeclarationError(
                "the engine impulse cannot certify: its steps follow no differential equation",
                advice="leave certify out, or take the engine taylor or scipy",
            )
        # Where it is declared is known later than what is run, of a runner that travelled.
        with self._turn, located(self.document, given):
            began, answers = working_time(), self._answers
            # Whoever looks for a tolerance measures what runs take.
            with meanwhile() if self._alone and not answers.searching else nullcontext():
                answer, basis = answers.answer(given, end)
            trace = answers.certified(answer, given, end) if certify else answer.trace
            sought = (self.setting, basis, answer.cost, answer.not_judged, answer.decides)
            asked = Asked(*sought) if answers.searching else None
            warnings = (*filter(None, (answers.reason, *trace.warnings)), *answer.warnings)
        trace = trace if warnings == trace.warnings else replace(trace, warnings=warnings)
        if throw and not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
            raise error_of(trace)
        timings = {**self._timings, "run": working_time() - began}
        return Result(trace, answer.observer, answer.estimate, timings, self, asked)

    def rows(self, names: Sequence[str]) -> tuple[Observer, RowRunner] | None:
        """Return what runs rows of values of some parameters, and what observes such runs.

        None where each run is to be looked at alone: an accuracy is looked for, time is stepped.
        """
        answers = self._answers
        if answers.searching or self.setting.stepped or self._plan.measured is not None:
            return None
        observer = self.observers.at(answers.first)
        assert isinstance(observer.simulator, Simulator)
        return observer, RowRunner(observer.simulator, names)

    @checked
    def stream(
        self,
        parameters: Mapping[str, float] | None = None,
        *,
        until: float | None = None,
        every: float = math.inf,
        control: Control | None = None,
    ) -> Iterator[Arc | Jump]:
        """Yield the arcs and jumps of a run as they come: for a display, a logger, a controller.

        Parameters
        ----------
        parameters, until
            As for `run`.
        every : float, optional
            Arcs end at multiples of this time at the latest, of the engine impulse at its steps.
        control : callable, optional
            Called at the start and at these multiples with a `Sample`: time, mode and variables.
            What it returns, parameters to values, holds from there on.

        Raises
        ------
        DeclarationError
            As `run`, and where an accuracy or a budget is asked for, which take several runs.
        SimulationError
            Where the run cannot go on, after all that it made.

        Examples
        --------
        >>> from statechart import Jump
        >>> pieces = Runner("toppling_stick").stream()
        >>> [piece.cause for piece in pieces if isinstance(piece, Jump)]
        ['slip', 'reverse', 'stop']
        """
        overrides = overridden(parameters)
        end = self.end(overrides, until=until)
        with located(self.document, overrides):
            variant = self.model.variant(overrides)
            if variant is not self.model:
                other = self._other(variant, None)
                return other.stream(overrides, until=end, every=every, control=control)
            self._given.values(overrides, self.document)
            simulator = self.observers.fresh(unsearched(self.setting))
            check = partial(self._given.check, document=self.document)
            limit, sampling = self.model.settings.max_jumps, sampled(every, end, control, check)
            pieces = simulator.stream(overrides, sampling, until=end, max_jumps=limit)
        return placed(pieces, located(self.document, overrides))

    def alternatives(self) -> dict[str, Runner]:
        """Return what runs the model under the other choices that its laws leave open.

        Each is asked for what this one is, by the name of the choice.
        """
        others = self.model.alternatives()
        return {choice: self._other(model, None) for choice, model in others.items()}

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
        overrides = overridden(parameters)
        with located(self.document, overrides):
            if self.automaton.stepper is not None and self.setting.stepped:
                self._given.values(overrides, self.document)
                mode, warnings = self.automaton.stepper().start(overrides)
            else:
                setup = self.setup(overrides)
                flow, _ = self.automaton.laws_of_events.begin(setup)
                mode, warnings = flow.mode, (*setup.warnings, flow.warning)
        return mode, tuple(dict.fromkeys(filter(None, (self._answers.reason, *warnings))))

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
        overrides = overridden(parameters)
        self._given.values(overrides, self.document)
        stepped = self.setting.stepped
        relative = math.nan if stepped else self.observers.engine(self.setting).tolerance
        with located(self.document, overrides):
            return self.automaton.setup(overrides, relative)

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
        return self._given.end(overridden(parameters), until, self.document)

    def with_modes(self) -> Runner:
        """Return what runs the same and keeps modes: this one where it does."""
        if self.setting.kept is Record.MODES:
            return self
        return self._other(self.model, None, record=Record.MODES.value)

    def _other(self, model: Declaration, study: Measured | None, **changed: str) -> Runner:
        """Return what runs another model, or is asked otherwise, in the place of this one."""
        asked = {**asdict(self._asked), **changed}
        other = Runner(model, **asked, study=study, once=self._alone, progress=self._progress)
        other.document = self.document
        return other


# As `Runner` and `Runner.run` together.
@checked
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
    max_step: float | None = None,
    impulse_tolerance: float | None = None,
    impulse_bound: float | None = None,
    record: str | None = None,
    study: Measured | None = None,
    progress: bool = False,
    certify: bool = False,
    throw: bool = True,
) -> Result:
    """Run a model once; see `Runner` and `Runner.run` for the parameters.

    By a study what is cheapest is chosen as for `Runner(once=True)`.

    Examples
    --------
    >>> result = run("bouncing_ball", parameters={"k": 0.5})
    >>> result.trace.outcome.name
    'HORIZON'
    """
    asked = Setting(
        engine, method, tolerance, accuracy, step, budget, max_step, impulse_tolerance,
        impulse_bound, record,
    )  # fmt: skip
    runner = Runner(model, **asdict(asked), study=study, once=True, progress=progress)
    return runner.run(parameters, until=until, certify=certify, throw=throw)
