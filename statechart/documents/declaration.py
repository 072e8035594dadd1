"""What every model declares, whatever its kind: parameters, ranges, end, outputs, settings."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, StrictInt, model_validator

from statechart.documents.fields import (
    FormulaText,
    Label,
    NameText,
    Part,
    Real,
    RelationText,
    check_names,
    problem,
    value_of,
)
from statechart.documents.outputs import (
    Count,
    Event,
    Integral,
    Maximum,
    Minimum,
    Output,
    Value,
    check_event,
    check_member,
)
from statechart.documents.setting import Setting
from statechart.documents.validation import located
from statechart.errors import DeclarationError, DeclarationProblem, FormulaError, close_matches
from statechart.formulas.constants import Constants
from statechart.formulas.formula import parse, parse_relation

TIME = "time"
"""What formulas call the time since the start."""


class Stop(Part):
    """When a run ends: at a time, or when a condition becomes true."""

    time: FormulaText | None = None
    conditions: dict[Label, RelationText] = Field(default={})


class Settings(Part):
    """How a run is computed; everything has a sensible default."""

    engine: Literal["auto", "taylor", "scipy", "impulse"] = "auto"
    method: Literal["RK45", "DOP853", "Radau", "LSODA"] | None = None
    tolerance: Annotated[Real, Field(gt=0, lt=1)] | None = Field(
        default=None, description="Relative tolerance of every step."
    )
    accuracy: Annotated[Real, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="Relative error allowed in the result: tolerances are tightened, or steps of "
        "the engine impulse shortened, until the estimated error is below it.",
    )
    step: Annotated[Real, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="Length of every step in time, of the engine impulse; of the longest where an "
        "accuracy is asked for.",
    )
    max_step: Annotated[Real, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="Length of the longest step in time, of an engine that chooses its own.",
    )
    impulse_tolerance: Annotated[Real, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="By how much the impulses of a step of the engine impulse may miss the contact "
        "laws, in parts of the step's fastest approach: 1e-6. What misses by more is told.",
    )
    impulse_bound: Annotated[Real, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="What misses by more than this ends the run; nothing does by itself.",
    )
    max_jumps: Annotated[StrictInt, Field(gt=0)] = 100_000

    @model_validator(mode="after")
    def _compatible(self) -> Self:
        Setting(
            self.engine,
            self.method,
            self.tolerance,
            self.accuracy,
            self.step,
            max_step=self.max_step,
            impulse_tolerance=self.impulse_tolerance,
            impulse_bound=self.impulse_bound,
        ).check()
        return self


class Declaration(Part):
    """Base of the documents' models; `kind` is the word that a document of it begins with."""

    kind: str
    name: NameText
    doc: str = Field(default="", description="What the model is, in a line.")
    parameters: dict[NameText, FormulaText] = Field(
        default={}, description="Constants: numbers, or formulas of each other."
    )
    ranges: dict[str, tuple[Real, Real]] = Field(
        default={}, description="What checks vary: parameter to least and greatest value."
    )
    stop: Stop = Stop()
    invariants: dict[Label, RelationText] = Field(
        default={},
        description="Named relations that hold in all of a run: tested by check, reported by run.",
    )
    outputs: dict[NameText, Output] = Field(default={})
    settings: Settings = Settings()

    def values(self, overrides: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return the value of every parameter.

        Parameters
        ----------
        overrides : mapping of str to float, optional
            Values that replace those of some parameters; formulas of them follow.

        Raises
        ------
        FormulaError
            If an override names no parameter, or a formula has no value.
        """
        return self.constants().values(overrides or {})

    def constants(self) -> Constants:
        """Return the parameters, read once for many values."""
        return Constants({name: parse(text) for name, text in self.parameters.items()})

    @property
    def whole(self) -> frozenset[str]:
        """Parameters that count something: their values are whole numbers."""
        return frozenset()

    def variant(self, overrides: Mapping[str, float]) -> Self:
        """Return the model that runs with `overrides`: another where they change what it has."""
        return self

    def with_(self, **values: FormulaText) -> Self:
        """Return the model with other values of parameters.

        Parameters
        ----------
        **values : number or str
            Parameter -> its value, or a formula of the others.

        Raises
        ------
        DeclarationError
            If there is no such parameter, or no model has this value.

        Examples
        --------
        >>> from statechart import load
        >>> load("toppling_stick").with_(mu=0.3).values()["mu"]
        0.3
        """
        for name, text in values.items():
            if name not in self.parameters:
                raise DeclarationError(
                    f"no parameter {name!r}", advice=close_matches(name, self.parameters)
                )
            with located(None, {}, ("parameters", name)):
                parse(text)
        made = self.model_copy(update={"parameters": {**self.parameters, **values}})
        with located(None, {}):
            made.check_values(made.values())
        return made

    def alternatives(self) -> Mapping[str, Self]:
        """Return the model under the other choices that its laws leave open, by their names."""
        return {}

    def omitted(self, values: Mapping[str, float], *, stepped: bool) -> Mapping[str, str]:
        """Return what a run does without, and why.

        Parameters
        ----------
        values : mapping of str to float
            Parameters of the run.
        stepped : bool
            Whether it was by time stepping.
        """
        return {}

    def check_values(self, values: Mapping[str, float]) -> None:
        """Check what the values of the parameters decide.

        Models of a kind check what they have besides.

        Raises
        ------
        DeclarationProblem
            At the first that is not allowed.
        """
        if self.stop.time is None:
            return
        end = value_of(self.stop.time, values, "stop", "time")
        if not 0.0 <= end < math.inf:
            raise DeclarationProblem(
                f"must be a finite time from 0 on, not {end:g}", loc=("stop", "time")
            )

    def check_ranges(self) -> None:
        """Check the ends of every range, the other parameters as declared.

        For the last validator of the models of a kind: all else must be right by then.

        Raises
        ------
        DeclarationProblem
            At the first end that is no model.
        """
        for name, ends in self.ranges.items():
            whole = (math.ceil(ends[0]), math.floor(ends[1])) if name in self.whole else ends
            for place, end in enumerate(whole):
                try:
                    self.check_values(self.values({name: end}))
                except (DeclarationProblem, FormulaError) as error:
                    at: tuple[str | int, ...] = (
                        error.loc
                        if isinstance(error, DeclarationProblem)
                        else ("parameters", error.name)
                    )
                    raise DeclarationProblem(
                        f"with {name} = {end:g}, {'.'.join(map(str, at))}: {error.message}",
                        advice="let the range end where the model is still one",
                        loc=("ranges", name, place),
                    ) from None

    @model_validator(mode="after")
    def _parameters_have_values(self) -> Self:
        if TIME in self.parameters:
            raise DeclarationProblem(
                f"{TIME!r} is the time of the run", loc=("parameters", TIME), key=True
            )
        try:
            values = self.values()
        except FormulaError as error:
            raise problem(error, "parameters", error.name) from None
        if self.stop.time is not None:
            check_names(parse(self.stop.time), self.parameters, "stop", "time")
        Declaration.check_values(self, values)
        return self

    @model_validator(mode="after")
    def _ranges_are_of_parameters(self) -> Self:
        for name, (least, greatest) in self.ranges.items():
            if name not in self.parameters:
                raise DeclarationProblem(
                    f"no parameter {name!r}",
                    advice=close_matches(name, self.parameters),
                    loc=("ranges", name),
                    key=True,
                )
            if least > greatest:
                raise DeclarationProblem("the least value comes first", loc=("ranges", name))
        return self

    def check_uses(
        self,
        names: Collection[str],
        states: Mapping[str, Collection[str]],
        causes: Mapping[str, Collection[str]],
    ) -> None:
        """Check that stop conditions, invariants and outputs speak of things that exist.

        For the validators of the models of a kind, which know what exists.

        Parameters
        ----------
        names : collection of str
            What formulas may use.
        states : mapping of str to collection of str
            The states of every region.
        causes : mapping of str to collection of str
            The causes of jumps of every region; `stop` need not be among them.

        Raises
        ------
        DeclarationProblem
            At the first that does not.
        """
        for label, relation in self.stop.conditions.items():
            check_names(parse_relation(relation), names, "stop", "conditions", label)
        for label, relation in self.invariants.items():
            check_names(parse_relation(relation), names, "invariants", label)
        for label, output in self.outputs.items():
            loc = ("outputs", label)
            match output:
                case Value():
                    check_names(parse(output.value), names, *loc, "value")
                    self._check_events(output.moment.events, causes, states, *loc, "at")
                case Integral():
                    check_names(parse(output.integral), names, *loc, "integral")
                    for region, state in output.during.items():
                        check_member("region", region, states, *loc, "during", region)
                        check_member("state", state, states[region], *loc, "during", region)
                case Count():
                    self._check_events(output.events, causes, states, *loc, "count")
                case Minimum():
                    check_names(parse(output.minimum), names, *loc, "minimum")
                case Maximum():
                    check_names(parse(output.maximum), names, *loc, "maximum")

    @staticmethod
    def _check_events(
        events: Sequence[Event],
        causes: Mapping[str, Collection[str]],
        states: Mapping[str, Collection[str]],
        *loc: str,
    ) -> None:
        for event in events:
            # Runs stop, not regions.
            if event != Event(None, "stop"):
                check_event(event, causes, states, *loc)
