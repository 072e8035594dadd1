"""Shapes of bodies, and which of them collide, as declared."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Self

from pydantic import BeforeValidator, Field, model_validator

from contacts.scene.friction import DeclaredFriction
from statechart.documents.documented import declare
from statechart.documents.fields import FormulaText, Part
from statechart.errors import DeclarationProblem

INDEX = "index"
"""Name of the number of a copy, from 0, in formulas of a body's start."""

MOST_PARTS = 16
"""Shapes that one body may have."""

_Pair = tuple[FormulaText, FormulaText]


class Shape(Part):
    """The outline of a body, or a part of it, in its own frame: a convex polygon, or a disc."""

    OTHER_WORDS: ClassVar = {
        "box rectangle rect size": "polygon: [[-a, -b], [a, -b], [a, b], [-a, b]]",
        "circle sphere radius": "disc: r",
        "square points vertices corners": "polygon: [[-1, -1], [1, -1], [0, 1]]",
        "capsule": "shape: [{polygon: ...}, {disc: r, at: [a, 0]}, {disc: r, at: [-a, 0]}]",
        "ellipse oval": "polygon: [[x, y], ...], of at most 16 corners",
        "mesh": "polygon: [[x, y], ...], its outline",
    }

    polygon: Annotated[tuple[_Pair, ...], Field(min_length=3, max_length=16)] | None = declare(
        "Corners, counter-clockwise.", [[-1, -1], [1, -1], [0, 1]], unit="length", default=None
    )
    disc: FormulaText | None = declare("Radius.", "r", unit="length", default=None)
    at: _Pair = declare(
        "Centre of the disc in the body's frame.", ["L/2", 0], unit="length", default=(0, 0)
    )

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.polygon is None) == (self.disc is None):
            raise DeclarationProblem(
                "a shape is a polygon or a disc",
                advice="write polygon: [[-1, -1], [1, -1], [0, 1]], or disc: 0.5",
            )
        if self.disc is None and self.at != (0, 0):
            raise DeclarationProblem("a polygon has no at", key=("at",))
        return self


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else () if value is None else (value,)


_Several = Annotated[tuple[Shape, ...], Field(max_length=MOST_PARTS)]

Shapes = Annotated[
    _Several, BeforeValidator(_as_list, json_schema_input_type=Shape | _Several | None)
]
"""The outline of a body: a shape, or several that move as one and may overlap each other."""


LAW_WORDS = {
    "k": "stiffness",
    "d": "damping",
    "spring solref solimp point_contact_stiffness": "stiffness, and damping",
    "hunt_crossley_dissipation": "stiffness, and damping",
    "rolling_friction": "rolling_resistance: LENGTH",
    "mu": "friction",
    "material": "friction, and restitution",
    "mu_s mu_k mu_static mu_dynamic static_friction kinetic_friction dynamic_friction"
    " friction_coefficient coulomb_friction": (
        "friction: a number for both, or friction: {static: 0.5, kinetic: 0.3}"
    ),
    "e bounce bounciness elasticity cor coefficient_of_restitution": "restitution",
}
"""Names of coefficients in other programs -> ours."""


def check_compliant(law: Any, rigid: tuple[str, ...]) -> None:
    """Check that compliant contacts have no impacts, and rigid ones no damping."""
    if law.stiffness is None and law.damping is not None:
        raise DeclarationProblem(
            "damping belongs to a compliant contact",
            advice="give a stiffness, too",
            key=("damping",),
        )
    for key in rigid:
        if law.stiffness is not None and key in law.model_fields_set:
            raise DeclarationProblem(
                f"a compliant contact has no impacts, and no {key}",
                advice=f"remove {key}, or stiffness; damping takes energy out of a bounce",
                key=(key,),
            )


class Collision(Part):
    """Bodies with shapes that collide with each other and with surfaces, all by one law."""

    OTHER_WORDS: ClassVar = {
        **LAW_WORDS,
        "pairs layer layers mask category group category_bits mask_bits": (
            "bodies: [die, cup], which collide with each other; one list for each group"
        ),
        "sensor": "a relation among conditions, guards or outputs, such as die.y < 0",
    }

    bodies: Annotated[tuple[str, ...], Field(min_length=1)] = declare(
        "Bodies that collide with each other; the name of copies means all of "
        "them. A pair that two lists contain collides by the first.",
        ["die"],
    )
    surfaces: tuple[str, ...] = declare(
        "Surfaces that the bodies collide with.", ["floor", "wall"], default=()
    )
    friction: DeclaredFriction = declare(
        "Coulomb's friction coefficient, 0 to inf, or a static and a kinetic one.", 0.3, unit="1"
    )
    restitution: FormulaText | None = declare(
        "Coefficient of restitution of Moreau's law: 0 (plastic) to 1 (elastic); needed "
        "without stiffness.",
        0.2,
        unit="1",
        default=None,
    )
    rolling_resistance: FormulaText | None = declare(
        "Rolling resistance of discs: a couple against their relative rotation of at most this "
        "length times the normal force.",
        "0.02*r",
        unit="length",
        default=None,
    )
    stiffness: FormulaText | None = declare(
        "Makes contacts compliant: the normal force at each point is stiffness times depth, "
        "plus damping times its rate, and never pulls. They have no impacts.",
        "k",
        unit="force/length",
        default=None,
    )
    damping: FormulaText | None = declare(
        "Damping of compliant contacts; 0 by default.", "d", unit="force time/length", default=None
    )

    @model_validator(mode="after")
    def _one_law(self) -> Self:
        check_compliant(self, ("restitution",))
        if self.stiffness is None and self.restitution is None:
            raise DeclarationProblem(
                "bodies that collide need a coefficient of restitution",
                advice="write restitution: 0 for impacts without rebound, or stiffness: k",
                loc=("restitution",),
            )
        return self

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
