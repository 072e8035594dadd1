"""Parts of a scene: coordinates, bodies, surfaces, contacts."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, PlainSerializer, field_validator, model_validator

from contacts.scene.friction import DeclaredFriction, Friction
from contacts.scene.modes import ContactMode, Free, Pin, Slide, as_mode
from contacts.scene.shapes import INDEX, LAW_WORDS, Shapes, check_compliant
from statechart.documents.documented import declare
from statechart.documents.fields import (
    FiniteConstantText,
    FiniteText,
    FormulaText,
    OneRelation,
    Part,
    replace_fields,
)
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse

Pair = tuple[FiniteText, FiniteText]
"""Two components, along x and y."""


FREE_START = "the initial position of a free body is start: {x: 0, y: 1}"


ImpactLaw = Literal["stronge", "newton", "poisson", "moreau"]
"""The law of an impact at one contact."""

MOREAU: ImpactLaw = "moreau"
"""The one that solves for the velocities after the impact, as time stepping does."""

Simultaneous = Literal["plastic", "capped", "sequential"]
"""Law of simultaneous impacts of coupled contacts."""

Resolution = Literal["impact", "stop"]
"""Resolution of Painleve's paradox: no mode of a sliding contact agrees with the state."""

_DeclaredMode = Annotated[
    ContactMode,
    BeforeValidator(as_mode, json_schema_input_type=ContactMode | Literal["free", "slide", "pin"]),
    PlainSerializer(lambda mode: mode.mode),
]
"""A mode, or its name; written as its name."""


class Coordinate(Part):
    """A generalised coordinate that positions of bodies are formulas of."""

    OTHER_WORDS: ClassVar = {
        "velocity vel speed": "rate",
        "initial init value": "start",
        "damping friction": "forces: {drag: {body: rod, force: [-c*rod.dx, 0]}}",
    }

    start: FiniteConstantText = declare(
        "Value at the start.", "pi/6", unit="length, or rad", default=0
    )
    rate: FiniteConstantText = declare(
        "Rate at the start.", -0.5, unit="length/time, or rad/time", default=0
    )


class Body(Part):
    """A rigid body in the plane.

    Without `position` it moves freely: coordinates x and y of its centre of mass, and angle
    (counter-clockwise) where it has an inertia. With it, `position` and `angle` are formulas of
    the scene's coordinates. A body that collides may be fixed, or be led along a path in time.
    """

    OTHER_WORDS: ClassVar = {
        "m": "mass",
        "weight": "mass; its weight is mass times gravity",
        "I J Izz moment_of_inertia": "inertia",
        "count number n": "copies",
        "velocity vel linear_velocity": "start: {dx: ..., dy: ...}",
        "angular_velocity omega": "start: {dangle: ...}",
        "radius": "shape: {disc: r}, and radius: r of its contacts",
        "damping linear_damping drag": "forces: {drag: {body: rod, force: [-c*rod.dx, -c*rod.dy]}}",
        "pos origin initial init": "start: {x: ..., y: ...}",
        "geom geometry collision visual collider fixtures size": (
            "shape: [{disc: r}], or a polygon, and collisions for how it rebounds"
        ),
        "inertial": "mass, and inertia",
        "static immovable is_static frozen anchored": (
            "fixed: true, of a body with a shape that collides; else surfaces: {floor: {height: 0}}"
        ),
        "type": "fixed: true, of a body that stands still; every other body with a mass moves",
        "fixed_rotation": "no inertia: a particle does not turn; a shape needs a large one",
        "freejoint": "no position: a body without one moves freely",
        "kinematic": 'position: ["v*time", 0], a path of a body with a shape that collides',
        "density": "mass, and inertia: of a disc m*r**2/2, of a box m*(width**2 + height**2)/12",
    }

    mass: FormulaText = declare(
        "Above 0; bodies that are fixed, or led along a path, have none.",
        "m",
        unit="mass",
        default=0,
    )
    inertia: FormulaText | None = declare(
        "Moment of inertia about the centre of mass; without one the body is a particle.",
        "m*L**2/12",
        unit="mass length**2",
        default=None,
    )
    position: Pair | None = declare(
        "Position of the centre of mass: x and y as formulas of the scene's coordinates; of a body "
        "that collides, its path: formulas of time, controls and variables of controllers.",
        ["-l*sin(theta)", "l*cos(theta)"],
        ["v*time", 0],
        unit="length",
        default=None,
    )
    angle: FiniteText | None = declare(
        "Angle, counter-clockwise, as a formula of what the position may use; only with position.",
        "theta",
        "omega*time",
        unit="rad",
        default=None,
    )
    fixed: bool = declare(
        "Holds a body that collides in the place where it starts: a crate, a wall, a funnel. "
        "It has a shape and no mass.",
        True,
        default=False,
    )
    start: dict[Literal["x", "y", "angle", "dx", "dy", "dangle"], FiniteConstantText] = declare(
        "Initial position and velocity of a free body; 0 where not given.",
        {"y": "h", "angle": 0.3, "dx": 1},
        unit="length, length/time; of angles rad, rad/time",
        default={},
    )
    shape: Shapes = declare(
        "Outline for collisions and pictures: a shape, or a list of shapes, which may overlap.",
        {"disc": "r"},
        [{"disc": "r", "at": ["-L/2", 0]}, {"disc": "r", "at": ["L/2", 0]}],
        default=(),
    )
    copies: FiniteConstantText | None = declare(
        "Number of equal bodies NAME0, NAME1, ... Their start, or path, may use index, "
        "which counts from 0; mod(index, 20) and floor(index/20) make rows of 20.",
        100,
        unit="1",
        default=None,
    )

    @field_validator("position", mode="before")
    @classmethod
    def _not_a_start(cls, position: Any) -> Any:
        if isinstance(position, Mapping):
            start = ", ".join(f"{key}: {value}" for key, value in position.items())
            raise DeclarationProblem(
                "position is a list of two formulas of coordinates or time",
                advice=f"write start: {{{start}}} for the initial position of a free body",
            )
        return position

    def numbered(self, index: int) -> Body:
        """Return the copy of this number: a body by itself."""

        def own(text: Any) -> Any:
            if not isinstance(text, str):
                return text
            return re.sub(rf"(?<![\w.]){INDEX}(?![\w.])", str(index), text)

        update: dict[str, object] = {"start": {key: own(text) for key, text in self.start.items()}}
        if self.position is not None:
            update |= {"position": tuple(map(own, self.position)), "angle": own(self.angle)}
        return replace_fields(self, **update, copies=None)

    @property
    def prescribed(self) -> bool:
        """True if the body is fixed or led along a path, so that contacts do not move it."""
        return self.fixed or (self.position is not None and "mass" not in self.model_fields_set)

    @property
    def linked(self) -> bool:
        """True if coordinates of the scene place the body."""
        return self.position is not None and not self.prescribed

    @property
    def path(self) -> tuple[FiniteText, FiniteText, FiniteText]:
        """Its x, y and angle: formulas, or the start of a body without a position."""
        if self.position is None:
            return self.start.get("x", 0), self.start.get("y", 0), self.start.get("angle", 0)
        return (*self.position, 0 if self.angle is None else self.angle)

    @property
    def placing(self) -> frozenset[str]:
        """Names that its position and its angle are formulas of."""
        return used_names((*(self.position or ()), self.angle or 0))

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of its own coordinates; none where its position is a formula, or fixed."""
        if self.position is not None or self.fixed:
            return ()
        return ("x", "y") if self.inertia is None else ("x", "y", "angle")

    def start_of(self, coordinate: str) -> tuple[FiniteText, FiniteText]:
        """Return the start of one of its own coordinates, and of its rate."""
        start: Mapping[str, FiniteText] = self.start  # type: ignore[assignment]
        return start.get(coordinate, 0), start.get(f"d{coordinate}", 0)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.fixed:
            self._check_fixed()
            return self
        if "mass" not in self.model_fields_set and (self.position is None or not self.shape):
            raise DeclarationProblem(
                "a body needs a mass",
                advice="write mass: 1, or of a body with a shape that nothing moves fixed: true"
                if self.position is None
                else "write mass: 1, or give a body that is led along its position a shape; a "
                "joint holds another body to a path by itself: to: [x, y]",
            )
        if self.position is None:
            if self.angle is not None:
                raise DeclarationProblem(
                    "a free body has its own angle",
                    advice="give its initial value under start, or give a position as well",
                    key=("angle",),
                )
            for name in self.start:
                if name.removeprefix("d") not in self.coordinates:
                    raise DeclarationProblem(
                        "a particle has no angle",
                        advice="remove it, or give the body an inertia",
                        key=("start", name),
                    )
            return self
        if self.start:
            raise DeclarationProblem(
                "a body with a position has no start",
                advice="write the start of its coordinates",
                key=("start",),
            )
        if self.prescribed and self.inertia is not None:
            raise DeclarationProblem(
                "a body that is led along a path has no inertia",
                advice="remove it: nothing that touches the body moves it; or give it a mass",
                key=("inertia",),
            )
        if self.inertia is not None and self.angle is None:
            raise DeclarationProblem(
                "a body with an inertia and a position needs an angle",
                advice="give the angle as a formula of the coordinates, or remove the inertia; "
                + FREE_START,
                key=("inertia",),
            )
        return self

    def _check_fixed(self) -> None:
        """Check that a fixed body has a shape and a place, and no motion."""
        for key in ("mass", "inertia", "position", "angle"):
            if key in self.model_fields_set:
                raise DeclarationProblem(
                    f"a fixed body has no {key}",
                    advice="remove it; its place is start: {x: 0, y: 1, angle: 0}",
                    key=(key,),
                )
        for name in self.start:
            if name.startswith("d"):
                raise DeclarationProblem(
                    "a fixed body has no velocity",
                    advice="remove it; a body that moves as prescribed has a path, position: "
                    '["v*time", 0]',
                    key=("start", name),
                )
        if not self.shape:
            raise DeclarationProblem(
                "a fixed body needs a shape, by which others touch it",
                advice="give it a polygon or a disc",
                key=("fixed",),
            )


class Surface(Part):
    """Ground or wall: a height function, an incline, a straight line, an edge, a circle.

    The normal is to the left of the line's direction, the solid to its right: a ground goes from
    left to right. A surface may be carried by a body, or displaced and turned in time.
    """

    OTHER_WORDS: ClassVar = {
        "slope angle": "incline",
        "y level": "height",
        "plane halfspace type normal offset pos": (
            "height: 0, incline: ANGLE, or line: [[0, 0], [1, 0]]"
        ),
        "profile polyline points vertices mesh polygon heightfield": (
            "height: FORMULA of x, or several surfaces, such as edge: [[0, 0], [1, 2]]"
        ),
        "arc": "circle: [x, y], radius: r; contacts end where enabled: RELATION fails",
        "velocity": "displacement: [v*time, 0]",
        "x wall": "line: [[1, -1], [1, 1]], a wall; the solid is on the right of its direction",
        "one_way": "enabled: ball.dy <= 0 of the contact",
        "pivot axis": "turn: ANGLE, about the origin or the point `through` of an incline",
    }

    height: FiniteText | None = declare(
        "Height y as a formula of x; the solid is below.",
        0,
        "0.1*sin(x)",
        unit="length",
        default=None,
    )
    incline: FiniteText | None = declare(
        "Angle of slope, upwards to the right.", "10*pi/180", unit="rad", default=None
    )
    through: Pair = declare("A point of the incline.", [0, 1], unit="length", default=(0, 0))
    line: tuple[Pair, Pair] | None = declare(
        "Two points of an endless line; the solid is on the right of the way "
        "from the first to the second.",
        [[0, 1], [0, 0]],
        unit="length",
        default=None,
    )
    edge: tuple[Pair, Pair] | None = declare(
        "Two points of a line that ends there.", [[0, 0], [2, 0]], unit="length", default=None
    )
    circle: Pair | None = declare(
        "Centre of a circle; the solid is inside.", [0, 0], unit="length", default=None
    )
    radius: FiniteText | None = declare("Radius of the circle.", "r", unit="length", default=None)
    hollow: bool = declare("Puts the solid outside the circle, as in a drum.", True, default=False)
    body: str | None = declare(
        "Body that carries the surface; the surface is given in its frame.", "cart", default=None
    )
    displacement: Pair = declare(
        "Displacement of the surface: two formulas of time and of variables of "
        "controllers (for points, also of controls).",
        ["v*time", 0],
        unit="length",
        default=(0, 0),
    )
    turn: FiniteText = declare(
        "Angle of rotation, counter-clockwise, as a formula of what the displacement may use; "
        "about a circle's centre, the point of an incline, else the origin.",
        "omega*time",
        unit="rad",
        default=0,
    )

    @property
    def moves(self) -> bool:
        """True if it has a path in time."""
        return self.displacement != (0, 0) or self.turn != 0

    @property
    def pivot(self) -> Pair:
        """Centre of its turn."""
        return self.through if self.circle is None else self.circle

    @property
    def straight(self) -> bool:
        """True if it is a straight line without ends."""
        graph = self.height is not None and "x" in parse(self.height).names
        return not graph and self.edge is None and self.circle is None

    def point_and_direction(
        self, number: Callable[[FormulaText], float]
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return a point of a straight surface and its direction, the solid on the right."""
        if self.height is not None:
            return (0.0, number(self.height)), (1.0, 0.0)
        if self.line is not None:
            (x0, y0), (x1, y1) = ((number(x), number(y)) for x, y in self.line)
            length = math.hypot(x1 - x0, y1 - y0)
            return (x0, y0), ((x1 - x0) / length, (y1 - y0) / length)
        angle, (x, y) = number(self.incline or 0), self.through
        return (number(x), number(y)), (math.cos(angle), math.sin(angle))

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        forms = (self.height, self.incline, self.line, self.edge, self.circle)
        if sum(form is not None for form in forms) != 1:
            raise DeclarationProblem(
                "a surface needs exactly one of height, incline, line, edge, circle",
                advice="write height: 0 for flat ground, incline: alpha for a slope",
            )
        if self.incline is None and self.through != (0, 0):
            raise DeclarationProblem("only an incline goes through a point", key=("through",))
        if (self.circle is None) != (self.radius is None):
            raise DeclarationProblem(
                "a circle has a centre and a radius",
                advice="write circle: [0, 0], radius: 1",
                loc=("radius",),
            )
        if self.hollow and self.circle is None:
            raise DeclarationProblem("only a circle is hollow", key=("hollow",))
        for key in ("displacement", "turn"):
            if self.body is not None and getattr(self, key) not in ((0, 0), 0):
                raise DeclarationProblem("a surface carried by a body moves with it", key=(key,))
        return self


class Point(Part):
    """A point of a body, in the body's own frame (origin: centre of mass)."""

    body: str = declare("Body that has the point.", "rod")
    at: Pair = declare("Position in the body's frame.", [0, "-L"], unit="length", default=(0, 0))


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else (value,)


Relations = Annotated[
    tuple[OneRelation, ...],
    BeforeValidator(_as_list, json_schema_input_type=OneRelation | list[OneRelation]),
]
"""A relation, or several that must all hold."""


class Contact(Part):
    """A point that may touch a surface, and the modes that this contact may take."""

    OTHER_WORDS: ClassVar = {
        **LAW_WORDS,
        "r": "radius",
        "between bodies body1 body2 body_a body_b": (
            "point: {body: rod}, and surface: NAME; shapes have collisions"
        ),
        "body at": "point: {body: rod, at: [0, -L]}",
    }

    point: Point = declare(
        "Point of a body that may touch the surface.", {"body": "rod", "at": [0, "-L"]}
    )
    radius: FiniteText | None = declare(
        "Radius of a disc about the point, which touches with its rim and rolls: "
        "a wheel, a ball, a round foot.",
        "r",
        unit="length",
        default=None,
    )
    rolling_resistance: FiniteText | None = declare(
        "Rolling resistance of a disc: a couple against its rolling of at most this length "
        "times the normal force V.",
        "0.02*r",
        unit="length",
        default=None,
    )
    surface: str = declare("Surface that the point may touch.", "floor")
    modes: Annotated[tuple[_DeclaredMode, ...], Field(min_length=1)] = declare(
        "Allowed modes among free, slide and pin; all by default, but no pin with friction: 0.",
        ["slide", "pin"],
        default=(Free(), Slide(), Pin()),
    )
    friction: DeclaredFriction | None = declare(
        "Coulomb's friction coefficient, 0 to inf, or a static and a kinetic one; needed with "
        "slide.",
        "mu",
        {"static": 0.5, "kinetic": 0.3},
        unit="1",
        default=None,
    )
    restitution: FormulaText | None = declare(
        "Coefficient of restitution, 0 (plastic) to 1 (elastic); needed with free.",
        0,
        unit="1",
        default=None,
    )
    stiffness: FormulaText | None = declare(
        "Makes the contact compliant: the normal force is stiffness times depth, plus damping "
        "times its rate, and never pulls. It has no impacts.",
        "k",
        unit="force/length",
        default=None,
    )
    damping: FormulaText | None = declare(
        "Damping of a compliant contact; 0 by default.", "d", unit="force time/length", default=None
    )
    impact: ImpactLaw = declare(
        "Impact law: restitution is a ratio of energies (stronge), impulses "
        "(poisson) or normal velocities (newton, moreau).",
        "newton",
        default="stronge",
    )
    enabled: Relations = declare(
        "Relation, or several that must all hold; while it fails, the contact is off.",
        "rod.x >= 0",
        default=(),
    )

    @property
    def kinds(self) -> frozenset[str]:
        """The modes' names."""
        return frozenset(mode.mode for mode in self.allowed)

    @property
    def allowed(self) -> tuple[ContactMode, ...]:
        """The modes; a contact without friction that lists none has no pin."""
        if self.frictionless and "modes" not in self.model_fields_set:
            return tuple(mode for mode in self.modes if not isinstance(mode, Pin))
        return self.modes

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.rolling_resistance is not None and self.radius is None:
            raise DeclarationProblem(
                "rolling resistance is of a disc that rolls",
                advice="give the contact a radius, or remove it",
                key=("rolling_resistance",),
            )
        if len({mode.mode for mode in self.modes}) != len(self.modes):
            raise DeclarationProblem(
                "a mode is listed twice", advice="list each once", loc=("modes",)
            )
        if "slide" in self.kinds and self.friction is None:
            raise DeclarationProblem(
                "a contact that can slide needs a friction coefficient",
                advice="write friction: mu, or friction: 0",
                loc=("friction",),
            )
        check_compliant(self, ("restitution", "impact"))
        if self.stiffness is None and "free" in self.kinds and self.restitution is None:
            raise DeclarationProblem(
                "a contact that can be free needs a coefficient of restitution",
                advice="write restitution: 0 for an impact without rebound",
                loc=("restitution",),
            )
        for key, mode, lack in (
            ("friction", "slide", "cannot slide"), ("restitution", "free", "is never free")
        ):  # fmt: skip
            if mode not in self.kinds and getattr(self, key) is not None:
                raise DeclarationProblem(
                    f"{key} has no meaning for a contact that {lack}",
                    advice=f"list {mode} among the modes, or remove {key}",
                    key=(key,),
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
        """True if no force acts along the surface: friction is the number 0, or it only bounces."""
        if self.friction is None:
            return {mode.mode for mode in self.modes} == {"free"}
        return not isinstance(self.friction, Friction) and _is_zero(self.friction)


def used_names(texts: Iterable[FormulaText]) -> frozenset[str]:
    """Return the names in formulas."""
    return frozenset[str]().union(*(parse(text).names for text in texts))


def _is_zero(text: str | int | float) -> bool:
    formula = parse(text)
    return not formula.names and formula.value({}) == 0.0
