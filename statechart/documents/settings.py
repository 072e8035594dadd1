"""Declarations of stop conditions and numerical settings."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, StrictInt, model_validator

from statechart.documents.documented import declare
from statechart.documents.fields import FormulaText, Label, Part, Real, RelationText
from statechart.documents.setting import Setting
from statechart.errors import FormulaError
from statechart.formulas.formula import parse


def _constant_value(value: Any) -> Any:
    """Return the value of a formula without names, such as 1/60."""
    if not isinstance(value, str):
        return value
    try:
        return parse(value).value({})
    except FormulaError as error:
        raise error.problem() from None


Written = Annotated[Real, BeforeValidator(_constant_value, json_schema_input_type=float | str)]
"""A number, or a formula of numbers."""

LATE_END = "write a late one; a condition of stop ends the run earlier"
"""Advice on an end that is not finite."""


class Stop(Part):
    """End of a run: at a time, or when a condition becomes true."""

    OTHER_WORDS: ClassVar = {
        "duration until end t t_end tmax t_max": "time",
        "when if condition": "conditions: {fallen: RELATION}",
    }

    time: FormulaText | None = declare(
        "End time of the run, a formula of parameters.", 10, "2*pi/omega", unit="time", default=None
    )
    conditions: dict[Label, RelationText] = declare(
        "Named relations; the run ends as soon as one becomes true.",
        {"fallen": "stick.angle <= -pi/2"},
        default={},
    )


class Settings(Part):
    """Computation of a run; everything has a sensible default."""

    OTHER_WORDS: ClassVar = {
        "dt timestep": "step",
        "solver integrator": "engine",
        "iterations": "impulse_tolerance",
        "fps": "step; a film takes --speed",
        "rtol atol": "tolerance",
        "max": "max_step, or max_jumps",
    }

    engine: Literal["auto", "taylor", "scipy", "impulse"] = declare(
        "Engine: taylor or scipy locate events, impulse takes fixed steps, auto chooses.",
        "impulse",
        default="auto",
    )
    method: Literal["RK45", "DOP853", "Radau", "LSODA"] | None = declare(
        "Method of the engine scipy; DOP853 by default.", "Radau", default=None
    )
    tolerance: Annotated[Real, Field(gt=0, lt=1)] | None = declare(
        "Relative tolerance of each step.", 1e-9, unit="1", default=None
    )
    accuracy: Annotated[Real, Field(gt=0, lt=1)] | None = declare(
        "Allowed relative error of the result. Tolerances or steps are reduced "
        "until the estimated error is below it.",
        1e-6,
        unit="1",
        default=None,
    )
    step: Annotated[Written, Field(gt=0, allow_inf_nan=False)] | None = declare(
        "Time step of the engine impulse; with an accuracy, the longest one.",
        0.001,
        unit="time",
        default=None,
    )
    max_step: Annotated[Written, Field(gt=0, allow_inf_nan=False)] | None = declare(
        "Longest time step of the engines taylor and scipy.", 0.01, unit="time", default=None
    )
    impulse_tolerance: Annotated[Real, Field(gt=0, lt=1)] | None = declare(
        "Allowed residual of the contact impulses in a step, relative to its fastest approach "
        "velocity: 1e-6. Steps above it are counted in a warning.",
        1e-8,
        unit="1",
        default=None,
    )
    impulse_bound: Annotated[Real, Field(gt=0, allow_inf_nan=False)] | None = declare(
        "Residual of the contact impulses above which the run ends; none by default.",
        0.01,
        unit="1",
        default=None,
    )
    record: Literal["modes", "poses", "nothing"] = declare(
        "Recording of the engine impulse: modes with all events, poses with the "
        "states at every step, or nothing but start, end and outputs.",
        "poses",
        default="modes",
    )
    max_jumps: Annotated[StrictInt, Field(gt=0)] = declare(
        "Number of jumps after which the run ends.", 1000, default=100_000
    )

    @model_validator(mode="after")
    def _compatible(self) -> Self:
        Setting(**self.model_dump(exclude={"max_jumps"})).check()
        return self
