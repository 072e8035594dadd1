"""Shapes of bodies, and which of them collide, as declared."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Self

from pydantic import BeforeValidator, Field, model_validator

from statechart.documents.fields import FormulaText, Part, unit
from statechart.errors import DeclarationProblem

INDEX = "index"
"""Name of the number of a copy, from 0, in formulas of a body's start."""

MOST_PARTS = 16
"""Shapes that one body may have."""

_Pair = tuple[FormulaText, FormulaText]


class Shape(Part):
    """The outline of a body, or a part of it, in its own frame: a convex polygon, or a disc."""

    OTHER_WORDS: ClassVar = {
        "box": "polygon: [[-a, -b], [a, -b], [a, b], [-a, b]]",
        "rectangle": "polygon: [[-a, -b], [a, -b], [a, b], [-a, b]]",
        "circle": "disc",
        "radius": "disc",
    }

    polygon: Annotated[tuple[_Pair, ...], Field(min_length=3, max_length=16)] | None = Field(
        default=None,
        description="Corners, counter-clockwise.",
        examples=[[[-1, -1], [1, -1], [0, 1]]],
        json_schema_extra=unit("length"),
    )
    disc: FormulaText | None = Field(
        default=None, description="Radius.", examples=["r"], json_schema_extra=unit("length")
    )
    at: _Pair = Field(
        default=(0, 0),
        description="Centre of the disc in the body's frame.",
        examples=[["L/2", 0]],
        json_schema_extra=unit("length"),
    )

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.polygon is None) == (self.disc is None):
            raise DeclarationProblem(
                "a shape is a polygon or a disc",
                advice="write polygon: [[-1, -1], [1, -1], [0, 1]], or disc: 0.5",
            )
        if self.disc is None and self.at != (0, 0):
            raise DeclarationProblem("a polygon has no at", loc=("at",), key=True)
        return self


def _as_list(value: Any) -> Any:
    """Let a single shape be declared as itself."""
    return value if isinstance(value, list | tuple) else () if value is None else (value,)


_Several = Annotated[tuple[Shape, ...], Field(max_length=MOST_PARTS)]

Shapes = Annotated[
    _Several, BeforeValidator(_as_list, json_schema_input_type=Shape | _Several | None)
]
"""The outline of a body: a shape, or several that move as one and may overlap each other."""


LAW_WORDS = {
    "mu": "friction",
    **dict.fromkeys(
        ("mu_s", "mu_k", "static_friction", "kinetic_friction", "friction_coefficient"),
        ("friction: a number for both, or friction: {static: 0.5, kinetic: 0.3}"),
    ),
    **dict.fromkeys(("e", "bounce", "bounciness", "elasticity", "cor"), "restitution"),
    "coefficientOfRestitution": "restitution",
}
"""Names of coefficients in other programs -> ours."""


class Collision(Part):
    """Bodies with shapes that collide with each other and with surfaces, all by one law."""

    OTHER_WORDS: ClassVar = {
        **LAW_WORDS,
        **dict.fromkeys(
            ("mu_s", "mu_k", "static_friction", "kinetic_friction"),
            "friction: a number for both; contacts of points have {static, kinetic}",
        ),
    }

    bodies: Annotated[tuple[str, ...], Field(min_length=1)] = Field(
        description=(
            "Bodies that collide with each other; the name of copies means all of "
            "them. A pair that two lists contain collides by the first."
        ),
        examples=[["die"]],
    )
    surfaces: tuple[str, ...] = Field(
        default=(),
        description="Surfaces that the bodies collide with.",
        examples=[["floor", "wall"]],
    )
    friction: FormulaText = Field(
        description="Coulomb's friction coefficient, 0 to inf.",
        examples=[0.3],
        json_schema_extra=unit("1"),
    )
    restitution: FormulaText = Field(
        description="Coefficient of restitution of Moreau's law: 0 (plastic) to 1 (elastic).",
        examples=[0.2],
        json_schema_extra=unit("1"),
    )

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        others = "; bodies of one list, copies too, collide with each other anyway"
        for key, names, also in (("bodies", self.bodies, others), ("surfaces", self.surfaces, "")):
            for place, name in enumerate(names):
                if name in names[:place]:
                    raise DeclarationProblem(
                        f"{name!r} is listed twice", advice=f"list it once{also}", loc=(key, place)
                    )
        return self
