"""Forces and joints of a scene."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Discriminator, Tag, model_validator

from contacts.scene.parts import Pair, Point, Relations
from statechart.documents.documented import declare
from statechart.documents.fields import FiniteText, FormulaText, Part
from statechart.errors import DeclarationProblem

JOINT_WORDS = {
    "hinge pin revolute pivot": "joints: {NAME: {point: {body: arm}, to: [0, 0]}}",
    "prismatic slider slot": (
        "joints: {NAME: {point: {body: arm}, to: {y: 0}}}; along another line place the body "
        "by coordinates"
    ),
    "weld": "joints: {NAME: {point: {body: arm}, to: [0, 0], angle: held}}",
    "rope ropes cables": "joints: {NAME: {point: {body: load}, to: [0, 0], rope: L}}",
    "rod rods": "joints: {NAME: {point: {body: load}, to: [0, 0], rod: L}}",
}
"""Names of joints in other programs -> what to write here."""


class Force(Part):
    """A force on a point of a body, or a moment on it."""

    OTHER_WORDS: ClassVar = {
        "torque": "moment",
        "stiffness spring k": "force: [-k*rod.x, 0]",
        "damping c": "force: [-c*rod.dx, 0]",
        "rest_length length l0": "it into the force: [-k*(rod.x - L), 0]",
        "between bodies from to type": (
            "one force for each body: {body: a, force: [0, F]}, {body: b, force: [0, -F]}"
        ),
        "fx fy x y": "force: [fx, fy]",
        "point application_point position": "at: [x, y], in its frame",
    }

    body: str = declare("Body on which it acts.", "rod")
    force: Pair = declare(
        "Components along x and y.", ["-k*rod.x", 0], unit="force", default=(0, 0)
    )
    at: Pair = declare(
        "Point of application in the body's frame.", [0, "L"], unit="length", default=(0, 0)
    )
    moment: FiniteText = declare(
        "Counter-clockwise.", "-c*rod.dangle", unit="force length", default=0
    )

    @model_validator(mode="after")
    def _does_something(self) -> Self:
        if not self.model_fields_set & {"force", "moment"}:
            raise DeclarationProblem(
                "neither force nor moment is given", advice="write force: [fx, fy], or moment: m"
            )
        return self


class Path(Part):
    """A place in the world, or one component of it, as formulas of time."""

    x: FiniteText | None = declare(
        "A formula of time; not held where not given.", "v*time", unit="length", default=None
    )
    y: FiniteText | None = declare(
        "A formula of time; not held where not given.", 0, unit="length", default=None
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
    point = "body" in value if isinstance(value, dict) else isinstance(value, Point | str)
    return "point" if point else "path"


_End = Annotated[
    Annotated[Annotated[Point, Tag("point")] | Annotated[Path, Tag("path")], Discriminator(_end)],
    BeforeValidator(_as_path, json_schema_input_type=Point | Path | Pair),
]


class Joint(Part):
    """A point of a body held to a point of another body, or to a path in the world.

    It turns freely unless its `angle` is held. A path without time is a fixed pivot; one with time
    drives the point. A path with one component holds that one only. With `rod` or `rope` the point
    is held at, or within, a distance of the other.
    """

    OTHER_WORDS: ClassVar = {
        "friction": "couplings: {bearing: {joint: NAME, limit: M_max}}",
        "damping": "a moment among the forces: {body: arm, moment: -c*arm.dangle}",
        "stiffness spring": "a moment among the forces: -k*arm.angle",
        "motor motor_speed enable_motor": (
            "a moment among the forces, or to: {x: ..., y: ...}, a path in time"
        ),
        "fixed": "angle: held",
        "type": "what it holds: to: [0, 0], angle: held, rope: L or rod: L",
        "child body body_b body2": "point: {body: arm, at: [-L, 0]}",
        "parent body_a body1 origin anchor pos between bodies": (
            "to: [0, 0], or to: {body: rod, at: [0, L]}"
        ),
        "break_force breaking_force max_force strength": 'enabled: "hypot(JOINT.X, JOINT.Y) <= F"',
        "lower lower_angle upper upper_angle min_angle max_angle range": "limits: [a, b]",
        "length distance rigid": "rod: L, which holds the distance",
        "cable string max_length max_distance": "rope: L",
        "active when condition": "enabled: RELATION",
        "axis": "to: {x: f} or {y: f}, which leaves the other component free",
        **JOINT_WORDS,
    }

    point: Point = declare(
        "Point of a body that the joint holds.", {"body": "arm", "at": ["-L", 0]}
    )
    to: _End = declare(
        "Point of another body, or a path in the world: [x, y], {x: ...} or {y: ...}.",
        [0, 0],
        {"body": "rod", "at": [0, "L"]},
    )

    angle: Literal["held"] | None = declare(
        "Holds the relative angle, too, as it is when the joint closes: a weld.",
        "held",
        default=None,
    )
    rod: FormulaText | None = declare(
        "Holds the two points at this distance instead of together; may use time.",
        "L",
        unit="length",
        default=None,
    )
    rope: FormulaText | None = declare(
        "Keeps the two points within this distance: a rope, taut or slack. It may use time, "
        "controls and variables of controllers: a winch.",
        "L",
        unit="length",
        default=None,
    )
    limits: Pair | None = declare(
        "Least and greatest relative angle of the bodies: stops of the joint.",
        [0, "pi/2"],
        unit="rad",
        default=None,
    )
    restitution: FormulaText | None = declare(
        "Coefficient of restitution of a rope, or of limits, 0 to 1; 0 by default.",
        0.5,
        unit="1",
        default=None,
    )
    enabled: Relations = declare(
        "Relation, or several that must all hold; while it fails, the joint is off. One that "
        "uses the joint's own forces breaks it: it stays off.",
        "hypot(hook.X, hook.Y) <= 25",
        default=(),
    )
    rest: Literal["captured"] | None = declare(
        "Keeps the place that the points have when the joint closes; needs enabled.",
        "captured",
        default=None,
    )

    @property
    def components(self) -> tuple[Literal["X", "Y", "M", "T", "V", "H"], ...]:
        """Names of the forces, one for each component that is held."""
        if self.rope is not None:
            return ("V", "H")
        if self.rod is not None:
            return ("T",)
        turn: tuple[Literal["M"], ...] = () if self.angle is None else ("M",)
        if isinstance(self.to, Point) or (self.to.x is not None and self.to.y is not None):
            return ("X", "Y", *turn)
        return ("X" if self.to.y is None else "Y", *turn)

    @property
    def ends(self) -> dict[str, Point]:
        """The points of bodies that it holds, by key: `point`, and `to` unless that is a path."""
        return {"point": self.point} | ({"to": self.to} if isinstance(self.to, Point) else {})

    @property
    def forces(self) -> tuple[str, ...]:
        """Forces that formulas may use: one per component, and the moment M of limits."""
        return (*self.components, *(() if self.limits is None else ("M",)))

    @model_validator(mode="after")
    def _one_law(self) -> Self:
        distance = [key for key in ("rod", "rope") if getattr(self, key) is not None]
        if len(distance) > 1:
            raise DeclarationProblem(
                "a joint is a rod or a rope",
                advice="write rope: L for a distance of at most L, rod: L for exactly L",
                key=("rope",),
            )
        for key in distance:
            others = [k for k in ("angle", "limits", "rest") if getattr(self, k) is not None]
            if others:
                raise DeclarationProblem(
                    f"a {key} has no {others[0]}",
                    advice=f"declare another joint for it, beside the {key}",
                    key=(others[0],),
                )
            if not isinstance(self.to, Point) and None in (self.to.x, self.to.y):
                raise DeclarationProblem(
                    f"a {key} ends at a point", advice="write to: [x, y]", loc=("to",)
                )
        if self.angle is not None and self.limits is not None:
            raise DeclarationProblem(
                "an angle that is held has no limits",
                advice="write angle: held, or limits: [least, greatest]",
                key=("limits",),
            )
        if self.restitution is not None and self.rope is None and self.limits is None:
            raise DeclarationProblem(
                "restitution is for a rope, and for limits",
                advice="remove it: a joint that closes stops its points without rebound",
                key=("restitution",),
            )
        if self.rest is not None and not self.enabled:
            raise DeclarationProblem(
                "a joint without enabled is closed from the start, and captures nothing",
                advice="write enabled: RELATION, or remove rest",
                key=("rest",),
            )
        return self

    @model_validator(mode="after")
    def _two_bodies(self) -> Self:
        if isinstance(self.to, Point) and self.to.body == self.point.body:
            raise DeclarationProblem(
                "a joint holds two bodies together",
                advice="name another body, or write to: [x, y] for a place in the world",
                loc=("to", "body"),
            )
        return self
