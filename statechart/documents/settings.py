"""Stop conditions and numerical settings, as declared."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, StrictInt, model_validator

from statechart.documents.fields import FormulaText, Label, Part, Real, RelationText, problem, unit
from statechart.documents.setting import Setting
from statechart.errors import FormulaError
from statechart.formulas.formula import parse


def _number(value: Any) -> Any:
    """Return the value of a formula without names, such as 1/60."""
    if not isinstance(value, str):
        return value
    try:
        return parse(value).value({})
    except FormulaError as error:
        raise problem(error) from None


Written = Annotated[Real, BeforeValidator(_number, json_schema_input_type=float | str)]
"""A number, or a formula of numbers."""


class Stop(Part):
    """End of a run: at a time, or when a condition becomes true."""

    OTHER_WORDS: ClassVar = {"duration": "time", "until": "time", "end": "time", "t": "time"}

    time: FormulaText | None = Field(
        default=None,
        description="End time of the run, a formula of parameters.",
        examples=[10, "2*pi/omega"],
        json_schema_extra=unit("time"),
    )
    conditions: dict[Label, RelationText] = Field(
        default={},
        description="Named relations; the run ends as soon as one becomes true.",
        examples=[{"fallen": "stick.angle <= -pi/2"}],
    )


class Settings(Part):
    """Computation of a run; everything has a sensible default."""

    OTHER_WORDS: ClassVar = {"dt": "step", "solver": "engine", "rtol": "tolerance"}

    engine: Literal["auto", "taylor", "scipy", "impulse"] = Field(
        default="auto",
        description=(
            "Engine: taylor or scipy locate events, impulse takes fixed steps, auto chooses."
        ),
        examples=["impulse"],
    )
    method: Literal["RK45", "DOP853", "Radau", "LSODA"] | None = Field(
        default=None,
        description="Method of the engine scipy; DOP853 by default.",
        examples=["Radau"],
    )
    tolerance: Annotated[Real, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="Relative tolerance of each step.",
        examples=[1e-9],
        json_schema_extra=unit("1"),
    )
    accuracy: Annotated[Real, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description=(
            "Allowed relative error of the result. Tolerances or steps are reduced "
            "until the estimated error is below it."
        ),
        examples=[1e-6],
        json_schema_extra=unit("1"),
    )
    step: Annotated[Written, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="Time step of the engine impulse; with an accuracy, the longest one.",
        examples=[0.001],
        json_schema_extra=unit("time"),
    )
    max_step: Annotated[Written, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="Longest time step of the engines taylor and scipy.",
        examples=[0.01],
        json_schema_extra=unit("time"),
    )
    impulse_tolerance: Annotated[Real, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description=(
            "Allowed residual of the contact impulses in a step, relative to its "
            "fastest approach velocity: 1e-6. Steps above it are counted in a "
            "warning."
        ),
        examples=[1e-8],
        json_schema_extra=unit("1"),
    )
    impulse_bound: Annotated[Real, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description=("Residual of the contact impulses above which the run ends; none by default."),
        examples=[0.01],
        json_schema_extra=unit("1"),
    )
    record: Literal["modes", "poses", "nothing"] = Field(
        default="modes",
        description=(
            "Recording of the engine impulse: modes with all events, poses with the "
            "states at every step, or nothing but start, end and outputs."
        ),
        examples=["poses"],
    )
    max_jumps: Annotated[StrictInt, Field(gt=0)] = Field(
        default=100_000, description="Number of jumps after which the run ends.", examples=[1000]
    )

    @model_validator(mode="after")
    def _compatible(self) -> Self:
        Setting(**self.model_dump(exclude={"max_jumps"})).check()
        return self
