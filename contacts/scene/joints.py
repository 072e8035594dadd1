"""Forces and joints of a scene."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from contacts.scene.parts import Pair, Point
from statechart.documents.fields import FiniteText, Part, unit
from statechart.errors import DeclarationProblem

JOINT_WORDS = {
    **dict.fromkeys(
        ("hinge", "pin", "revolute", "pivot"), "joints: {NAME: {point: {body: arm}, to: [0, 0]}}"
    ),
    "weld": "one body: of several shapes, or with the masses of both",
}
"""Names of joints in other programs -> what to write here."""


class Force(Part):
    """A force on a point of a body, or a moment on it."""

    OTHER_WORDS: ClassVar = {
        "torque": "moment",
        **dict.fromkeys(("stiffness", "spring", "k"), "force: [-k*rod.x, 0]"),
        **dict.fromkeys(("damping", "c"), "force: [-c*rod.dx, 0]"),
        "fx": "force: [fx, fy]",
        "fy": "force: [fx, fy]",
    }

    body: str = Field(description="What it acts on.", examples=["rod"])
    force: Pair = Field(
        default=(0, 0),
        description="Components along x and y.",
        examples=[["-k*rod.x", 0]],
        json_schema_extra=unit("force"),
    )
    at: Pair = Field(
        default=(0, 0),
        description="Point of application in the body's frame.",
        examples=[[0, "L"]],
        json_schema_extra=unit("length"),
    )
    moment: FiniteText = Field(
        default=0,
        description="Counter-clockwise.",
        examples=["-c*rod.dangle"],
        json_schema_extra=unit("force length"),
    )

    @model_validator(mode="after")
    def _does_something(self) -> Self:
        if not self.model_fields_set & {"force", "moment"}:
            raise DeclarationProblem(
                "neither force nor moment is given",
                advice="write force: [fx, fy], or moment: m",
            )
        return self


class Path(Part):
    """A place in the world, or one component of it, as formulas of time."""

    x: FiniteText | None = Field(
        default=None,
        description="A formula of time; not held where not given.",
        examples=["v*time"],
        json_schema_extra=unit("length"),
    )
    y: FiniteText | None = Field(
        default=None,
        description="A formula of time; not held where not given.",
        examples=[0],
        json_schema_extra=unit("length"),
    )

    @model_validator(mode="after")
    def _something(self) -> Self:
        if self.x is None and self.y is None:
            raise DeclarationProblem(
                "a path has an x, a y, or both", advice="write [0, 0] for a fixed pivot"
            )
        return self


def _as_path(value: Any) -> Any:
    """Let a path be declared as its two components."""
    if isinstance(value, list | tuple):
        if len(value) != 2:
            raise DeclarationProblem(f"must be two components, not {len(value)}")
        return {"x": value[0], "y": value[1]}
    return value


def _end(value: Any) -> str:
    point = "body" in value if isinstance(value, dict) else isinstance(value, Point)
    return "point" if point else "path"


_End = Annotated[
    Annotated[
        Annotated[Point, Tag("point")] | Annotated[Path, Tag("path")],
        Discriminator(_end),
    ],
    BeforeValidator(_as_path, json_schema_input_type=Point | Path | Pair),
]


class Joint(Part):
    """A point of a body held to a point of another body, or to a path in the world.

    It turns freely. A path without time is a fixed pivot; one with time drives the point. A path
    with one component holds that one only.
    """

    OTHER_WORDS: ClassVar = {
        "friction": "couplings: {bearing: {joint: NAME, limit: M_max}}",
        "damping": "a moment among the forces: {body: arm, moment: -c*arm.dangle}",
        **dict.fromkeys(("stiffness", "spring"), "a moment among the forces: -k*arm.angle"),
        "motor": "a moment among the forces, or to: {x: ..., y: ...}, a path in time",
        **JOINT_WORDS,
    }

    point: Point = Field(
        description="Point of a body that the joint holds.",
        examples=[{"body": "arm", "at": ["-L", 0]}],
    )
    to: _End = Field(
        description=(
            "Point of another body, or a path in the world: [x, y], {x: ...} or {y: ...}."
        ),
        examples=[[0, 0], {"body": "rod", "at": [0, "L"]}],
    )

    @property
    def components(self) -> tuple[Literal["X", "Y"], ...]:
        """Names of the forces, one for each component that is held."""
        if isinstance(self.to, Point) or (self.to.x is not None and self.to.y is not None):
            return ("X", "Y")
        return ("X",) if self.to.y is None else ("Y",)

    @model_validator(mode="after")
    def _two_bodies(self) -> Self:
        if isinstance(self.to, Point) and self.to.body == self.point.body:
            raise DeclarationProblem(
                "a joint holds two bodies together",
                advice="name another body, or write to: [x, y] for a place in the world",
                loc=("to", "body"),
            )
        return self
