"""A scene as declared: bodies, surfaces, contacts with their modes, forces, start."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal, Self

from pydantic import Field, model_validator

from contacts.controls import Controller, Controls
from contacts.kinks import check_kinks
from contacts.numbers import check_finite, check_physical
from contacts.parts import (
    Body,
    Contact,
    Coordinate,
    Force,
    Gravity,
    Joint,
    Path,
    Point,
    Resolution,
    Simultaneous,
    Surface,
)
from contacts.shapes import INDEX, Collision, check_collisions, check_copies, copies
from statechart.declaration import TIME, Declaration, check_names
from statechart.errors import DeclarationProblem
from statechart.fields import FormulaText, NameText
from statechart.formula import parse, parse_relation
from statechart.syntax import close_matches
from statechart.transitions import check_listening


class Scene(Declaration):
    """Rigid bodies in contact.

    Formulas of forces, stop conditions and outputs may use ``time``, the parameters, the
    coordinates (``stick.x``, ``stick.angle``, ...) and their rates (``stick.dx``, ...), and of
    every contact ``gap``, ``slip`` (tangential velocity), ``V`` and ``H`` (normal and tangential
    force on the body), as in ``tip.V``, of every joint ``X`` and ``Y`` (force on the body of its
    point).
    """

    kind: Literal["scene"] = "scene"
    gravity: Gravity = Field(
        default=0, description="Acceleration downwards, or its two components."
    )
    coordinates: dict[NameText, Coordinate] = Field(default={})
    bodies: dict[NameText, Body] = Field(min_length=1)
    surfaces: dict[NameText, Surface] = Field(default={})
    contacts: dict[NameText, Contact] = Field(default={})
    joints: dict[NameText, Joint] = Field(default={})
    forces: dict[NameText, Force] = Field(default={})
    collisions: dict[NameText, Collision] = Field(
        default={}, description="Which bodies with shapes collide; on the engine impulse alone."
    )
    simultaneous: Simultaneous = Field(
        default="capped",
        description="What contacts do that are hit together: plastic, Moreau's law as far as the "
        "energy allows (capped), or one after another by their own laws (sequential).",
    )
    paradox: Resolution = Field(
        default="impact",
        description="What follows where no mode of a sliding contact agrees with the state "
        "(Painleve): an impact without collision, or the end of the run.",
    )
    controls: dict[NameText, FormulaText] = Field(
        default={},
        description="What states of regions set, to be used in forces and in coefficients of "
        "contacts: name to its value where no state sets it.",
    )
    regions: dict[NameText, Controller] = Field(
        default={}, description="Controllers: regions beside the contacts."
    )
    modes: dict[str, Literal["free", "slide", "slide+", "slide-", "pin", "off"]] = Field(
        default={}, description="Initial modes, checked; found from the state where not given."
    )

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of all coordinates."""
        own = [f"{n}.{c}" for n, b in self.single_bodies().items() for c in b.coordinates]
        return (*self.coordinates, *own)

    def single_bodies(self, overrides: Mapping[str, float] | None = None) -> dict[str, Body]:
        """Return the bodies, copies one by one; all alike but for the index in their start."""
        if all(body.copies is None for body in self.bodies.values()):
            return self.bodies
        result: dict[str, Body] = {}
        for name, count in copies(self, self.values(overrides)).items():
            if count is None:
                result[name] = self.bodies[name]
                continue
            for index in range(count):
                result[f"{name}{index}"] = self.bodies[name].numbered(index)
        return result

    @property
    def whole(self) -> frozenset[str]:
        """Parameters that count copies of bodies."""
        counts = [b.copies for b in self.bodies.values() if b.copies is not None]
        used = frozenset[str]().union(*(parse(text).names for text in counts))
        return used & frozenset(self.parameters)

    def variant(self, overrides: Mapping[str, float]) -> Self:
        """Return the scene itself, or the one with as many copies as `overrides` make."""
        if copies(self, self.values()) == copies(self, self.values(overrides)):
            return self
        return self.model_copy(update={"parameters": {**self.parameters, **overrides}})

    def rate_name(self, coordinate: str) -> str:
        """Return the name of the rate of `coordinate`: stick.x -> stick.dx, theta -> dtheta."""
        *owner, name = coordinate.split(".")
        return ".".join([*owner, f"d{name}"])

    def jams(self, contact: str) -> bool:
        """Whether a contact may see an impact without collision.

        It rubs, and its point turns or others can wedge it.
        """
        declared = self.contacts[contact]
        body = self.bodies[declared.point.body]
        rubs = "slide" in declared.kinds and not declared.frictionless
        turns = body.inertia is not None or body.position is not None
        return rubs and (turns or len(self.contacts) > 1) and self.paradox == "impact"

    def bounces(self, contact: str) -> bool:
        """Whether impacts may accumulate: its own, or in turn with those elsewhere on its body."""
        declared = self.contacts[contact]
        beside = sum(other.point.body == declared.point.body for other in self.contacts.values())
        return "free" in declared.kinds and (declared.restitution != 0 or beside > 1)

    @property
    def controlled(self) -> Controls:
        """The controls and the regions that set them."""
        return Controls(self.controls, self.regions)

    @property
    def kinematic_names(self) -> frozenset[str]:
        """What formulas of controls, and with them those of forces, may use."""
        rates = map(self.rate_name, self.variables)
        return frozenset((TIME, *self.parameters, *self.variables, *rates))

    def gate(self, contact: str) -> str:
        """Return the conditions without which a contact is off, as text; "" for none."""
        declared = self.contacts[contact]
        ends = self.surfaces[declared.surface].edge is not None
        return " and ".join((*declared.enabled, *(["within its edge"] if ends else [])))

    def check_values(self, values: Mapping[str, float]) -> None:
        """Check that numbers are physical, finite and, of copies, whole, too."""
        super().check_values(values)
        copies(self, values)
        check_physical(self, values)
        check_finite(self, values)
        check_collisions(self, values)

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
        rates = map(self.rate_name, self.coordinates)
        formula_names = {TIME, *self.parameters, *self.coordinates, *rates}
        sections: dict[str, Iterable[str]] = {
            "contacts": self.contacts,
            "joints": self.joints,
            "bodies": self.bodies,
            "controls": self.controls,
        }
        for section, names in sections.items():
            for name in names:
                if name in formula_names:
                    raise DeclarationProblem(
                        f"{name!r} is declared twice",
                        advice="choose another name",
                        loc=(section, name),
                        key=True,
                    )
        taken = dict.fromkeys(self.bodies, "body")
        for section, names in {**sections, "regions": self.regions}.items():
            if section == "bodies":
                continue
            for name in names:
                if name in taken:
                    raise DeclarationProblem(
                        f"{name!r} is a {taken[name]} already",
                        advice=f"choose another name for the {section[:-1]}",
                        loc=(section, name),
                        key=True,
                    )
            taken |= dict.fromkeys(names, section[:-1])
        return self

    @model_validator(mode="after")
    def _copies_are_whole(self) -> Self:
        check_copies(self)
        return self

    @model_validator(mode="after")
    def _references_exist(self) -> Self:
        for name, contact in self.contacts.items():
            self._member("body", contact.point.body, self.bodies, "contacts", name, "point", "body")
            self._member("surface", contact.surface, self.surfaces, "contacts", name, "surface")
        for name, surface in self.surfaces.items():
            if surface.body is not None:
                self._member("body", surface.body, self.bodies, "surfaces", name, "body")
        for name, joint in self.joints.items():
            at = ("joints", name)
            self._member("body", joint.point.body, self.bodies, *at, "point", "body")
            if isinstance(joint.to, Point):
                self._member("body", joint.to.body, self.bodies, *at, "to", "body")
        for name, force in self.forces.items():
            self._member("body", force.body, self.bodies, "forces", name, "body")
        for name, mode in self.modes.items():
            self._member("contact", name, self.contacts, "modes", name)
            known = self.contacts[name].kinds | ({"off"} if self.gate(name) else set())
            if mode.rstrip("+-") not in known:
                raise DeclarationProblem(
                    f"contact {name!r} does not list the mode {mode!r}",
                    advice="its modes: " + ", ".join(sorted(known)),
                    loc=("modes", name),
                )
        return self

    @model_validator(mode="after")
    def _formulas_use_declared_names(self) -> Self:
        self.controlled.check(self.kinematic_names)
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
                known = parameters if body.copies is None else parameters | {INDEX}
                check_names(parse(text), known, *at, "start", part)
        for name, surface in self.surfaces.items():
            at = ("surfaces", name)
            if surface.height is not None:
                check_names(parse(surface.height), parameters | {"x"}, *at, "height")
            if surface.incline is not None:
                check_names(parse(surface.incline), parameters, *at, "incline")
            self._formulas(surface.through, parameters, *at, "through")
            for form in ("line", "edge"):
                for place, corner in enumerate(getattr(surface, form) or ()):
                    self._formulas(corner, parameters, *at, form, place)
            self._formulas(surface.circle or (), parameters, *at, "circle")
            if surface.radius is not None:
                check_names(parse(surface.radius), parameters, *at, "radius")
            self._formulas(surface.displacement, parameters | {TIME}, *at, "displacement")
        for name, contact in self.contacts.items():
            at = ("contacts", name)
            if self.gate(name) and "free" not in contact.kinds:
                raise DeclarationProblem(
                    "a contact that can be off comes back as free",
                    advice="list free among the modes",
                    loc=(*at, "modes"),
                )
            self._formulas(contact.point.at, parameters, *at, "point", "at")
            for key in ("friction", "restitution"):
                text = getattr(contact, key)
                if text is not None:
                    self.controlled.check_coefficient(text, parameters, *at, key)
        seen = self.kinematic_names | {f"{c}.{q}" for c in self.contacts for q in ("gap", "slip")}
        seen |= set(self.controls)
        for name, contact in self.contacts.items():
            for place, text in enumerate(contact.enabled):
                loc = ("contacts", name, "enabled", place)
                check_names(parse_relation(text), seen, *loc)
        for name, joint in self.joints.items():
            at = ("joints", name)
            self._formulas(joint.point.at, parameters, *at, "point", "at")
            if isinstance(joint.to, Path):
                for place, key in enumerate(("x", "y")):
                    text = getattr(joint.to, key)
                    if text is not None:
                        # Declared as a list or as a mapping: what it is not is skipped.
                        check_names(parse(text), parameters | {TIME}, *at, "to", place, key)
            else:
                self._formulas(joint.to.at, parameters, *at, "to", "at")
        known = self.kinematic_names | frozenset(self.controls)
        for name, force in self.forces.items():
            at = ("forces", name)
            self._formulas(force.force, known, *at, "force")
            self._formulas(force.at, parameters, *at, "at")
            check_names(parse(force.moment), known, *at, "moment")
        return self

    @model_validator(mode="after")
    def _coordinates_move_bodies(self) -> Self:
        texts = [text for body in self.bodies.values() for text in body.position or ()]
        texts += [body.angle for body in self.bodies.values() if body.angle is not None]
        used = frozenset[str]().union(*(parse(text).names for text in texts))
        for name in self.coordinates:
            if name not in used:
                raise DeclarationProblem(
                    "it moves no body",
                    advice="use it in the position or the angle of a body, or remove it",
                    loc=("coordinates", name),
                    key=True,
                )
        return self

    @model_validator(mode="after")
    def _numbers_are_physical(self) -> Self:
        check_kinks(self)
        self.check_values(self.values())
        return self

    @model_validator(mode="after")
    def _uses_exist(self) -> Self:
        from contacts.regions import edges, states

        quantities = ("gap", "slip", "V", "H")
        names = self.kinematic_names | {f"{c}.{q}" for c in self.contacts for q in quantities}
        names |= {f"{name}.{force}" for name, x in self.joints.items() for force in x.components}
        names |= {"energy", *self.controls}
        gates = {c: self.gate(c) for c in self.contacts}
        found = {
            c: {s for state in states(x, gate=gates[c]) for s in (state, state.rstrip("+-"))}
            for c, x in self.contacts.items()
        } | {name: set(region.states) for name, region in self.regions.items()}
        causes = {
            c: {
                edge.cause
                for edge in edges(x, jams=self.jams(c), bounces=self.bounces(c), gate=gates[c])
            }
            for c, x in self.contacts.items()
        } | {name: {t.name for t in region.transitions} for name, region in self.regions.items()}
        if self.collisions:
            from contacts.heap import CAUSES, STATES

            found |= {body: {*STATES} for body in self.single_bodies()}
            causes |= {body: {*CAUSES} for body in self.single_bodies()}
        self.check_uses(names, found, causes)
        for name, region in self.regions.items():
            check_listening(name, region.transitions, causes, found)
            for index, transition in enumerate(region.transitions):
                if transition.guard is not None:
                    loc = ("regions", name, "transitions", index, "guard")
                    check_names(parse_relation(transition.guard), names, *loc)
        return self

    @model_validator(mode="after")
    def _ranges_hold_models(self) -> Self:
        self.check_ranges()
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
