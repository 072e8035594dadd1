"""What a scene is made of: coordinates, bodies, surfaces, contacts, joints, forces."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, PlainSerializer, Tag, model_validator

from contacts.scene.modes import ContactMode, Free, Pin, Slide, as_mode
from contacts.scene.shapes import INDEX, Shape
from statechart.documents.fields import FiniteText, FormulaText, Part, RelationText
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse

Pair = tuple[FiniteText, FiniteText]
"""Two components, along x and y."""


def _components(value: Any) -> str:
    return "components" if isinstance(value, list | tuple) else "downwards"


Gravity = Annotated[
    Annotated[FiniteText, Tag("downwards")] | Annotated[Pair, Tag("components")],
    Discriminator(_components),
]
"""An acceleration downwards, or its two components."""

ImpactLaw = Literal["stronge", "newton", "poisson", "moreau"]
"""The law of an impact at one contact."""

MOREAU: ImpactLaw = "moreau"
"""The one that solves for the velocities after the impact, as time stepping does."""

Simultaneous = Literal["plastic", "capped", "sequential"]
"""What coupled contacts do that are hit at once."""

Resolution = Literal["impact", "stop"]
"""What follows where no mode of a sliding contact agrees with the state."""

_DeclaredMode = Annotated[
    ContactMode,
    BeforeValidator(as_mode, json_schema_input_type=ContactMode | Literal["free", "slide", "pin"]),
    PlainSerializer(lambda mode: mode.mode),
]
"""A mode, or its name; written as its name."""


class Coordinate(Part):
    """A generalised coordinate that positions of bodies are formulas of."""

    start: FiniteText = Field(default=0, description="Value at the start.")
    rate: FiniteText = Field(default=0, description="Its rate at the start.")


class Body(Part):
    """A rigid body in the plane.

    Without `position` it moves freely: coordinates x and y of its centre of mass, and angle
    (counter-clockwise) where it has an inertia. With it, `position` and `angle` are formulas of
    the scene's coordinates.
    """

    mass: FormulaText
    inertia: FormulaText | None = Field(
        default=None, description="About the centre of mass; a particle has none."
    )
    position: Pair | None = Field(default=None, description="Of the centre of mass.")
    angle: FiniteText | None = Field(
        default=None, description="Counter-clockwise; only with position."
    )
    start: dict[Literal["x", "y", "angle", "dx", "dy", "dangle"], FiniteText] = Field(
        default={}, description="Initial position and velocity of a free body; 0 where not given."
    )
    shape: Shape | None = Field(default=None, description="Outline, for collisions and pictures.")
    copies: FiniteText | None = Field(
        default=None,
        description="How many bodies like this there are: NAME0, NAME1, ...; their start may use "
        "index, which counts them from 0.",
    )

    def numbered(self, index: int) -> Body:
        """Return the copy of this number: a body by itself."""
        start = {
            key: re.sub(rf"(?<![\w.]){INDEX}(?![\w.])", str(index), text)
            if isinstance(text, str)
            else text
            for key, text in self.start.items()
        }
        return self.model_copy(update={"start": start, "copies": None})

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of its own coordinates; none where its position is a formula."""
        if self.position is not None:
            return ()
        return ("x", "y") if self.inertia is None else ("x", "y", "angle")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.position is None:
            if self.angle is not None:
                raise DeclarationProblem(
                    "a free body has its own angle",
                    advice="give its initial value under start, or give a position as well",
                    loc=("angle",),
                    key=True,
                )
            for name in self.start:
                if name.removeprefix("d") not in self.coordinates:
                    raise DeclarationProblem(
                        "a particle has no angle",
                        advice="remove it, or give the body an inertia",
                        loc=("start", name),
                        key=True,
                    )
            return self
        if self.start:
            raise DeclarationProblem(
                "a body whose position is a formula starts where its coordinates start",
                advice="give the initial values under coordinates",
                loc=("start",),
                key=True,
            )
        if self.inertia is not None and self.angle is None:
            raise DeclarationProblem(
                "a body with an inertia and a position needs an angle",
                advice="give the angle as a formula of the coordinates, or remove the inertia",
                loc=("inertia",),
                key=True,
            )
        return self


class Surface(Part):
    """What bodies may touch: a height function, an incline, a straight line, an edge, a circle.

    The normal is to the left of the line's direction, the solid to its right: a ground goes from
    left to right. A surface may be carried by a body, or displaced and turned in time.
    """

    height: FiniteText | None = Field(default=None, description="y as a formula of x.")
    incline: FiniteText | None = Field(default=None, description="Angle of slope, rad.")
    through: Pair = Field(default=(0, 0), description="A point of the incline.")
    line: tuple[Pair, Pair] | None = Field(
        default=None, description="Two points; the solid is on the right going from one to two."
    )
    edge: tuple[Pair, Pair] | None = Field(
        default=None, description="As a line, but it ends at the two points."
    )
    circle: Pair | None = Field(default=None, description="Centre; the solid is inside.")
    radius: FiniteText | None = Field(default=None, description="Of the circle.")
    hollow: bool = Field(
        default=False, description="Whether the circle's solid is outside, as that of a drum."
    )
    body: str | None = Field(default=None, description="What carries it, in that body's frame.")
    displacement: Pair = Field(
        default=(0, 0), description="How far it has moved as a whole: formulas of time."
    )
    turn: FiniteText = Field(
        default=0,
        description="By which angle it has turned, counter-clockwise, about a circle's centre, "
        "the point of an incline, else the origin: a formula of time.",
    )

    @property
    def moves(self) -> bool:
        """Whether it has a path in time."""
        return self.displacement != (0, 0) or self.turn != 0

    @property
    def pivot(self) -> Pair:
        """What it turns about."""
        return self.through if self.circle is None else self.circle

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        forms = (self.height, self.incline, self.line, self.edge, self.circle)
        if sum(form is not None for form in forms) != 1:
            raise DeclarationProblem(
                "a surface has one of height, incline, line, edge, circle",
                advice="write height: 0 for flat ground, incline: alpha for a slope",
            )
        if self.incline is None and self.through != (0, 0):
            raise DeclarationProblem(
                "only an incline goes through a point", loc=("through",), key=True
            )
        if (self.circle is None) != (self.radius is None):
            raise DeclarationProblem("a circle has a centre and a radius", loc=("radius",))
        if self.hollow and self.circle is None:
            raise DeclarationProblem("only a circle is hollow", loc=("hollow",), key=True)
        for key in ("displacement", "turn"):
            if self.body is not None and getattr(self, key) not in ((0, 0), 0):
                raise DeclarationProblem(
                    "a surface carried by a body moves with it", loc=(key,), key=True
                )
        return self


class Point(Part):
    """A point of a body, in the body's own frame (origin: centre of mass)."""

    body: str
    at: Pair = (0, 0)


def _as_list(value: Any) -> Any:
    """Let a single relation be declared as itself."""
    return (value,) if isinstance(value, str) else value


class Contact(Part):
    """A point that may touch a surface, and the modes that this contact may take."""

    point: Point
    surface: str
    modes: Annotated[tuple[_DeclaredMode, ...], Field(min_length=1)] = (Free(), Slide(), Pin())
    friction: FormulaText | None = Field(
        default=None, description="Coulomb's coefficient, 0 to inf; needed with slide."
    )
    restitution: FormulaText | None = Field(
        default=None, description="0 (plastic) to 1 (elastic); needed with free."
    )
    impact: ImpactLaw = Field(
        default="stronge",
        description="What restitution means: of energy (stronge), velocity (newton) or impulse "
        "(poisson) on the path of the impact; of velocity, for the velocities after it (moreau).",
    )
    enabled: Annotated[
        tuple[RelationText, ...],
        BeforeValidator(_as_list, json_schema_input_type=RelationText | list[RelationText]),
    ] = Field(default=(), description="Conditions without which the contact is off.")

    @property
    def kinds(self) -> frozenset[str]:
        """The modes' names."""
        return frozenset(mode.mode for mode in self.modes)

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if len(self.kinds) != len(self.modes):
            raise DeclarationProblem("a mode is listed twice", loc=("modes",))
        if "slide" in self.kinds and self.friction is None:
            raise DeclarationProblem(
                "a contact that can slide needs a friction coefficient",
                advice="write friction: mu, or friction: 0",
                loc=("friction",),
            )
        if "free" in self.kinds and self.restitution is None:
            raise DeclarationProblem(
                "a contact that can be free needs a coefficient of restitution",
                advice="write restitution: 0 for an impact without rebound",
                loc=("restitution",),
            )
        if "slide" not in self.kinds and self.friction is not None:
            raise DeclarationProblem(
                "friction has no meaning for a contact that cannot slide",
                advice="list slide among the modes, or remove friction",
                loc=("friction",),
                key=True,
            )
        if "free" not in self.kinds and self.restitution is not None:
            raise DeclarationProblem(
                "restitution has no meaning for a contact that is never free",
                advice="list free among the modes, or remove restitution",
                loc=("restitution",),
                key=True,
            )
        if self.frictionless and "pin" in self.kinds and "slide" in self.kinds:
            raise DeclarationProblem(
                "a frictionless contact has no pin",
                advice="write modes: [free, slide], or a positive friction",
                loc=("modes",),
            )
        return self

    @property
    def frictionless(self) -> bool:
        """Whether no force acts along the surface: friction is the number 0, or it only bounces."""
        if self.friction is None:
            return self.kinds == {"free"}
        return _is_zero(self.friction)


def _is_zero(text: str | int | float) -> bool:
    formula = parse(text)
    return not formula.names and formula.value({}) == 0.0


class Force(Part):
    """A force on a point of a body, or a moment on it."""

    body: str
    force: Pair = (0, 0)
    at: Pair = (0, 0)
    moment: FiniteText = 0


class Path(Part):
    """A place in the world, or one component of it, as formulas of time."""

    x: FiniteText | None = None
    y: FiniteText | None = None

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

    point: Point
    to: _End = Field(description="A point of another body, or a path: [x, y], {x: ...}, {y: ...}.")

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
