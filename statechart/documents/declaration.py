"""What every model declares, whatever its kind: parameters, ranges, end, outputs, settings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal, Self

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
    unit,
    value_of,
)
from statechart.documents.outputs import Count, Maximum, Minimum, Output, Value
from statechart.documents.quantities import Quantity, unit_of
from statechart.documents.setting import Setting
from statechart.documents.validation import located
from statechart.errors import (
    DeclarationError,
    DeclarationProblem,
    Findings,
    FormulaError,
    close_matches,
)
from statechart.formulas.constants import Constants
from statechart.formulas.formula import parse

TIME = "time"
"""What formulas call the time since the start."""


class Stop(Part):
    """When a run ends: at a time, or when a condition becomes true."""

    time: FormulaText | None = Field(
        default=None,
        description="When it ends at the latest: a formula of parameters.",
        examples=[10, "2*pi/omega"],
        json_schema_extra=unit("time"),
    )
    conditions: dict[Label, RelationText] = Field(
        default={},
        description="Words to a relation: the run ends as soon as one becomes true.",
        examples=[{"fallen": "stick.angle <= -pi/2"}],
    )


class Settings(Part):
    """How a run is computed; everything has a sensible default."""

    engine: Literal["auto", "taylor", "scipy", "impulse"] = Field(
        default="auto",
        description="What integrates: taylor or scipy, which locate events; impulse, which takes "
        "fixed steps; auto chooses.",
        examples=["impulse"],
    )
    method: Literal["RK45", "DOP853", "Radau", "LSODA"] | None = Field(
        default=None, description="Of the engine scipy; DOP853 by default.", examples=["Radau"]
    )
    tolerance: Annotated[Real, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="Relative tolerance of every step.",
        examples=[1e-9],
        json_schema_extra=unit("1"),
    )
    accuracy: Annotated[Real, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="Relative error allowed in the result: tolerances are tightened, or steps of "
        "the engine impulse shortened, until the estimated error is below it.",
        examples=[1e-6],
        json_schema_extra=unit("1"),
    )
    step: Annotated[Real, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="Length of every step in time, of the engine impulse; of the longest where an "
        "accuracy is asked for.",
        examples=[0.001],
        json_schema_extra=unit("time"),
    )
    max_step: Annotated[Real, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="Length of the longest step in time, of an engine that chooses its own.",
        examples=[0.01],
        json_schema_extra=unit("time"),
    )
    impulse_tolerance: Annotated[Real, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="By how much the impulses of a step of the engine impulse may miss the contact "
        "laws, in parts of the step's fastest approach: 1e-6. What misses by more is told.",
        examples=[1e-8],
        json_schema_extra=unit("1"),
    )
    impulse_bound: Annotated[Real, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="What misses by more than this ends the run; nothing does by itself.",
        examples=[0.01],
        json_schema_extra=unit("1"),
    )
    max_jumps: Annotated[StrictInt, Field(gt=0)] = Field(
        default=100_000, description="A run ends after so many jumps.", examples=[1000]
    )

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

    kind: str = Field(description="What is declared.", examples=["scene"])
    name: NameText = Field(
        description="Of the model: letters, digits and _.", examples=["toppling_stick"]
    )
    doc: str = Field(
        default="",
        description="What the model is, in a line.",
        examples=["A stick balanced on its tip topples and may slip."],
    )
    parameters: dict[NameText, FormulaText] = Field(
        default={},
        description="Constants: name to a number, or to a formula of others.",
        examples=[{"m": 1, "L": 0.5, "inertia": "m*L**2/3", "mu": 0.3}],
        json_schema_extra=unit("that of each"),
    )
    ranges: dict[str, tuple[Real, Real]] = Field(
        default={},
        description="What checks vary: parameter to least and greatest value.",
        examples=[{"mu": [0, 2]}],
        json_schema_extra=unit("that of the parameter"),
    )
    stop: Stop = Field(
        default=Stop(),
        description="When a run ends.",
        examples=[{"time": 5, "conditions": {"fallen": "stick.angle <= -pi/2"}}],
    )
    invariants: dict[Label, RelationText] = Field(
        default={},
        description="Named relations that hold in all of a run: tested by check, reported by run.",
        examples=[{"stays above": "stick.y >= 0"}],
    )
    outputs: dict[NameText, Output] = Field(
        default={},
        description="What a run reports: name to a value, integral, count, minimum or maximum.",
        examples=[{"t_slip": {"value": "time", "at": "first tip.slip"}}],
    )
    units: dict[str, Label] = Field(
        default={},
        description="For tables and axes: length, time, mass, force, or a name of the model, to "
        "its unit. Nothing is converted.",
        examples=[{"length": "m", "time": "s", "mass": "kg"}],
    )
    settings: Settings = Field(
        default=Settings(),
        description="How a run is computed, where nobody asks for something else.",
        examples=[{"engine": "impulse", "step": 0.001}],
    )

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

    def quantity(self, name: str) -> Quantity:
        """Return what a variable, an observable or an output measures, as far as is known."""
        return Quantity(name, "time" if name == TIME else "")

    def unit(self, name: str) -> str:
        """Return the unit of a variable, an observable or an output; empty where it is unknown.

        Examples
        --------
        >>> from statechart import load
        >>> model = load("toppling_stick")
        >>> model.unit("stick.angle"), model.unit("stick.x")
        ('rad', '')
        >>> model.model_copy(update={"units": {"length": "m"}}).unit("stick.x")
        'm'
        """
        if name in self.units:
            return self.units[name]
        match self.outputs.get(name):
            case Value(value=text) | Minimum(minimum=text) | Maximum(maximum=text):
                # Of a formula that is one name the unit is that of the name.
                same = str(text).strip()
                return self.unit(same) if same in parse(text).names and same != name else ""
            case Count():
                return "1"
        return unit_of(self.quantity(name).dimension, self.units)

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

    def modes(self) -> Any:
        """Return the modes, and which are possible where a run starts; see `statechart.modes`."""
        return _public("modes")(self)

    def equations(self, mode: str, *, latex: bool = False) -> Any:
        """Return the equations of motion of a mode; see `statechart.equations`."""
        return _public("equations")(self, mode, latex=latex)

    def diagram(self, path: str | Path | None = None, *, visited: bool = False) -> Any:
        """Return the statechart, and write it to a file where one is named; see `statechart.draw`.

        Examples
        --------
        >>> from statechart import load
        >>> load("toppling_stick").diagram().title
        'toppling_stick'
        """
        return _public("draw")(self, path, visited=visited)

    def check(self, *, examples: int = 50, seed: int | None = None) -> Any:
        """Test what must hold of every run over the ranges; see `statechart.check`."""
        return _public("check")(self, examples=examples, seed=seed)

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
        found = Findings()
        for name, text in self.parameters.items():
            with found:
                check_names(parse(text), self.parameters, "parameters", name)
        found.check()
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
        found = Findings()
        for name, (least, greatest) in self.ranges.items():
            with found:
                if name not in self.parameters:
                    raise DeclarationProblem(
                        f"no parameter {name!r}",
                        advice=close_matches(name, self.parameters),
                        loc=("ranges", name),
                        key=True,
                    )
                if least > greatest:
                    raise DeclarationProblem(
                        "the least value comes first",
                        advice=f"write [{greatest:g}, {least:g}]",
                        loc=("ranges", name),
                    )
        found.check()
        return self


def _public(name: str) -> Any:
    """Return a function of the public page: what a model is asked for stands above it."""
    return getattr(import_module("statechart"), name)
