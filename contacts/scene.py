"""A scene as declared: bodies, surfaces, contacts with their modes, forces, start."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from contacts.modes import ContactMode, Free, Pin, Slide, as_mode
from statechart.declaration import TIME, Declaration, Part, check_names
from statechart.errors import DeclarationProblem, FormulaError
from statechart.fields import FormulaText, NameText, problem
from statechart.formula import close_matches, parse

__all__ = ["Body", "Contact", "Coordinate", "Force", "Point", "Scene", "Surface"]

Pair = tuple[FormulaText, FormulaText]

_DeclaredMode = Annotated[
    ContactMode,
    BeforeValidator(as_mode, json_schema_input_type=ContactMode | Literal["free", "slide", "pin"]),
]
"""A mode, or its name."""


class Coordinate(Part):
    """A generalised coordinate that positions of bodies are formulas of."""

    start: FormulaText = Field(default=0, description="Value at the start.")
    rate: FormulaText = Field(default=0, description="Its rate at the start.")


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
    angle: FormulaText | None = Field(
        default=None, description="Counter-clockwise; only with position."
    )
    start: dict[Literal["x", "y", "angle", "dx", "dy", "dangle"], FormulaText] = Field(
        default={}, description="Initial position and velocity of a free body; 0 where not given."
    )

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
    """A line that points may touch: a height function, an incline, a straight line, a circle.

    The normal is to the left of the line's direction, the solid to its right: a ground goes from
    left to right. A surface may be carried by a body, or displaced in time.
    """

    height: FormulaText | None = Field(default=None, description="y as a formula of x.")
    incline: FormulaText | None = Field(default=None, description="Angle of slope, rad.")
    through: Pair = Field(default=(0, 0), description="A point of the incline.")
    line: tuple[Pair, Pair] | None = Field(
        default=None, description="Two points; the solid is on the right going from one to two."
    )
    circle: Pair | None = Field(default=None, description="Centre; the solid is inside.")
    radius: FormulaText | None = Field(default=None, description="Of the circle.")
    body: str | None = Field(default=None, description="What carries it, in that body's frame.")
    displacement: Pair = Field(
        default=(0, 0), description="How far it has moved as a whole: formulas of time."
    )

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        forms = [f for f in (self.height, self.incline, self.line, self.circle) if f is not None]
        if len(forms) != 1:
            raise DeclarationProblem(
                "a surface has one of height, incline, line, circle",
                advice="write height: 0 for flat ground, incline: alpha for a slope",
            )
        if self.incline is None and self.through != (0, 0):
            raise DeclarationProblem(
                "only an incline goes through a point", loc=("through",), key=True
            )
        if (self.circle is None) != (self.radius is None):
            raise DeclarationProblem("a circle has a centre and a radius", loc=("radius",))
        if self.body is not None and self.displacement != (0, 0):
            raise DeclarationProblem(
                "a surface carried by a body moves with it", loc=("displacement",), key=True
            )
        return self


class Point(Part):
    """A point of a body, in the body's own frame (origin: centre of mass)."""

    body: str
    at: Pair = (0, 0)


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
    impact: Literal["stronge", "newton", "poisson"] = Field(
        default="stronge",
        description="What restitution means: of energy, of velocity, of impulse.",
    )

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
        """Whether friction is declared to be the number zero."""
        return self.friction is not None and _is_zero(self.friction)


def _is_zero(text: str | int | float) -> bool:
    formula = parse(text)
    return not formula.names and formula.value({}) == 0.0


class Force(Part):
    """A force on a point of a body, or a moment on it."""

    body: str
    force: Pair = (0, 0)
    at: Pair = (0, 0)
    moment: FormulaText = 0


class Scene(Declaration):
    """Rigid bodies in contact.

    Formulas of forces, stop conditions and outputs may use ``time``, the parameters, the
    coordinates (``stick.x``, ``stick.angle``, ...) and their rates (``stick.dx``, ...), and of
    every contact ``gap``, ``slip`` (tangential velocity), ``V`` and ``H`` (normal and tangential
    force on the body), as in ``tip.V``.
    """

    kind: Literal["scene"] = "scene"
    gravity: FormulaText | Pair = Field(
        default=0, description="Acceleration downwards, or its two components."
    )
    coordinates: dict[NameText, Coordinate] = Field(default={})
    bodies: dict[NameText, Body] = Field(min_length=1)
    surfaces: dict[NameText, Surface] = Field(default={})
    contacts: dict[NameText, Contact] = Field(default={})
    forces: dict[NameText, Force] = Field(default={})
    modes: dict[str, Literal["free", "slide", "slide+", "slide-", "pin"]] = Field(
        default={}, description="Initial modes, checked; found from the state where not given."
    )

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of all coordinates."""
        own = [f"{body}.{c}" for body, b in self.bodies.items() for c in b.coordinates]
        return (*self.coordinates, *own)

    def rate_name(self, coordinate: str) -> str:
        """Return the name of the rate of `coordinate`: stick.x -> stick.dx, theta -> dtheta."""
        *owner, name = coordinate.split(".")
        return ".".join([*owner, f"d{name}"])

    @property
    def kinematic_names(self) -> frozenset[str]:
        """What formulas of forces may use."""
        rates = map(self.rate_name, self.variables)
        return frozenset((TIME, *self.parameters, *self.variables, *rates))

    @model_validator(mode="after")
    def _names_are_apart(self) -> Self:
        taken = {TIME: "the time of the run", **dict.fromkeys(self.parameters, "a parameter")}
        for name in self.coordinates:
            for used in (name, f"d{name}"):
                if used in taken:
                    raise DeclarationProblem(
                        f"{used!r} is {taken[used]}",
                        advice="choose another name for the coordinate",
                        loc=("coordinates", name),
                        key=True,
                    )
        for section, names in (("contacts", self.contacts), ("bodies", self.bodies)):
            for name in names:
                if name in self.parameters or name in self.coordinates:
                    raise DeclarationProblem(
                        f"{name!r} is declared twice",
                        advice="choose another name",
                        loc=(section, name),
                        key=True,
                    )
        for name in self.contacts:
            if name in self.bodies:
                raise DeclarationProblem(
                    f"{name!r} is a body already",
                    advice="choose another name for the contact",
                    loc=("contacts", name),
                    key=True,
                )
        return self

    @model_validator(mode="after")
    def _references_exist(self) -> Self:
        for name, contact in self.contacts.items():
            self._member("body", contact.point.body, self.bodies, "contacts", name, "point", "body")
            self._member("surface", contact.surface, self.surfaces, "contacts", name, "surface")
        for name, surface in self.surfaces.items():
            if surface.body is not None:
                self._member("body", surface.body, self.bodies, "surfaces", name, "body")
        for name, force in self.forces.items():
            self._member("body", force.body, self.bodies, "forces", name, "body")
        for name, mode in self.modes.items():
            self._member("contact", name, self.contacts, "modes", name)
            if mode.rstrip("+-") not in self.contacts[name].kinds:
                raise DeclarationProblem(
                    f"contact {name!r} does not list the mode {mode!r}",
                    advice="its modes: " + ", ".join(sorted(self.contacts[name].kinds)),
                    loc=("modes", name),
                )
        return self

    @model_validator(mode="after")
    def _formulas_use_declared_names(self) -> Self:
        parameters = frozenset(self.parameters)
        positions = parameters | frozenset(self.coordinates)
        gravity = self.gravity if isinstance(self.gravity, tuple) else (self.gravity,)
        self._formulas(gravity, parameters, "gravity")
        for name, coordinate in self.coordinates.items():
            at = ("coordinates", name)
            check_names(parse(coordinate.start), parameters, *at, "start")
            check_names(parse(coordinate.rate), parameters, *at, "rate")
        for name, body in self.bodies.items():
            at = ("bodies", name)
            check_names(parse(body.mass), parameters, *at, "mass")
            if body.inertia is not None:
                check_names(parse(body.inertia), parameters, *at, "inertia")
            if body.angle is not None:
                check_names(parse(body.angle), positions, *at, "angle")
            self._formulas(body.position or (), positions, *at, "position")
            for part, text in body.start.items():
                check_names(parse(text), parameters, *at, "start", part)
        for name, surface in self.surfaces.items():
            at = ("surfaces", name)
            if surface.height is not None:
                check_names(parse(surface.height), parameters | {"x"}, *at, "height")
            if surface.incline is not None:
                check_names(parse(surface.incline), parameters, *at, "incline")
            self._formulas(surface.through, parameters, *at, "through")
            for place, corner in enumerate(surface.line or ()):
                self._formulas(corner, parameters, *at, "line", place)
            self._formulas(surface.circle or (), parameters, *at, "circle")
            if surface.radius is not None:
                check_names(parse(surface.radius), parameters, *at, "radius")
            self._formulas(surface.displacement, parameters | {TIME}, *at, "displacement")
        for name, contact in self.contacts.items():
            at = ("contacts", name)
            self._formulas(contact.point.at, parameters, *at, "point", "at")
            for key in ("friction", "restitution"):
                text = getattr(contact, key)
                if text is not None:
                    check_names(parse(text), parameters, *at, key)
        for name, force in self.forces.items():
            at = ("forces", name)
            self._formulas(force.force, self.kinematic_names, *at, "force")
            self._formulas(force.at, parameters, *at, "at")
            check_names(parse(force.moment), self.kinematic_names, *at, "moment")
        return self

    @model_validator(mode="after")
    def _numbers_are_physical(self) -> Self:
        self.check_numbers(self.values())
        return self

    def check_numbers(self, values: Mapping[str, float]) -> None:
        """Check masses, inertias, friction and restitution for `values` of the parameters.

        Raises
        ------
        DeclarationProblem
            At the first that is out of its bounds.
        """
        for name, body in self.bodies.items():
            _bounded(values, body.mass, ("bodies", name, "mass"), "positive", positive=True)
            if body.inertia is not None:
                _bounded(values, body.inertia, ("bodies", name, "inertia"), "zero or positive")
        for name, contact in self.contacts.items():
            at = ("contacts", name)
            if contact.friction is not None:
                words = "zero or positive"
                _bounded(values, contact.friction, (*at, "friction"), words, infinite=True)
            if contact.restitution is not None:
                words = "between 0 and 1"
                _bounded(values, contact.restitution, (*at, "restitution"), words, most=1.0)

    @model_validator(mode="after")
    def _uses_exist(self) -> Self:
        from contacts.regions import edges, states

        quantities = ("gap", "slip", "V", "H")
        names = self.kinematic_names | {f"{c}.{q}" for c in self.contacts for q in quantities}
        self.check_uses(
            names | {"energy"},
            {
                c: {*states(x), *(s.rstrip("+-") for s in states(x))}
                for c, x in self.contacts.items()
            },
            {c: {edge.cause for edge in edges(c, x)} for c, x in self.contacts.items()},
        )
        return self

    @staticmethod
    def _member(what: str, name: str, known: object, *loc: str) -> None:
        assert isinstance(known, dict)
        if name not in known:
            raise DeclarationProblem(
                f"no {what} {name!r}", advice=close_matches(name, known), loc=loc
            )

    @staticmethod
    def _formulas(texts: tuple[FormulaText, ...], known: frozenset[str], *loc: str | int) -> None:
        for index, text in enumerate(texts):
            where: tuple[str | int, ...] = (*loc, index) if len(texts) > 1 else loc
            check_names(parse(text), known, *where)


def _bounded(
    values: Mapping[str, float],
    text: FormulaText,
    loc: tuple[str, ...],
    words: str,
    *,
    most: float = math.inf,
    positive: bool = False,
    infinite: bool = False,
) -> None:
    try:
        value = parse(text).value(values)
    except FormulaError as error:
        raise problem(error, *loc) from None
    within = 0.0 <= value <= most and not (positive and value == 0.0)
    if not within or (math.isinf(value) and not infinite):
        raise DeclarationProblem(f"must be {words}, not {value:g}", loc=loc)
