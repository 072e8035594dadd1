"""A scene as declared: bodies, surfaces, contacts with their modes, forces, start."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, Self, TypeVar, get_args

from pydantic import model_validator

from contacts.scene.checks import (
    check_collisions,
    check_copies,
    check_coupled,
    check_formulas,
    check_kinks,
    check_led_surfaces,
    check_prescribed,
    check_rim,
    check_turns,
    finite_checks,
    physical_checks,
)
from contacts.scene.controls import Controller
from contacts.scene.expansion import expansion
from contacts.scene.fields import SceneFields
from contacts.scene.lint import replaced_laws
from contacts.scene.parts import FREE_START, Contact, Simultaneous
from contacts.scene.regions import BODY_CAUSES, BODY_STATES
from contacts.states import declared_state, superstates_of
from statechart.charts.flatten import causes_of
from statechart.charts.transitions import check_listening, check_periods, declared_transitions
from statechart.charts.wrapping import check_wrapping, count_periods, wrap_checks
from statechart.documents.declaration import TIME
from statechart.documents.fields import (
    ValueCheck,
    check_names,
    check_relation,
    finite_check,
    replace_fields,
)
from statechart.documents.outputs import check_member
from statechart.errors import DeclarationProblem, Findings, Loc
from statechart.formulas.formula import parse
from statechart.formulas.relation import parse_relation

_Scene = TypeVar("_Scene", bound="Scene")


class Scene(SceneFields):
    """Rigid bodies in contact.

    Formulas of forces, stop conditions and outputs may use ``time``, the parameters, the
    coordinates (``stick.x``, ``stick.angle``, ...) and their rates (``stick.dx``, ...), and of
    every contact ``gap``, ``slip`` (tangential velocity), ``V`` and ``H`` (normal and tangential
    force on the body), as in ``tip.V``, of every joint ``X`` and ``Y`` (force on the body of its
    point), of every coupling ``M`` (couple on its first body) and ``slip``.
    """

    @property
    def expanded(self) -> Self:
        """The scene with the regions and contacts of its joints (`contacts.scene.expansion`).

        And with those that count periods (`statechart.charts.wrapping`).
        """
        scene, counts = count_periods(self)
        if counts:
            regions = {name: Controller.counting(count) for name, count in counts.items()}
            scene = _replaced(scene, {"regions": {**regions, **scene.regions}})
        added = expansion(scene)
        return _replaced(scene, added) if added else scene

    def alternatives(self) -> Mapping[str, Self]:
        """Return the scene under the other meanings of simultaneous impacts."""
        if len(self.contacts) < 2 and not self.collisions:
            return {}
        return {
            f"simultaneous: {choice}": replace_fields(self, simultaneous=choice)
            for choice in get_args(Simultaneous)
            if choice != self.simultaneous
        }

    def omitted(self, values: Mapping[str, float], *, stepped: bool) -> Mapping[str, str]:
        """Return the parts that a run of the scene omits, with reasons."""
        reasons = replaced_laws(self, values) if stepped else {}
        for name, body in self.bodies.items():
            if body.fixed:
                reasons[f"coordinates of {name}"] = "it is fixed"
            elif body.prescribed:
                reasons[f"coordinates of {name}"] = "it moves along its path"
            elif body.position is None and body.inertia is None:
                reasons[f"the angle of {name}"] = "it has no inertia declared: a particle"
            elif body.position is not None:
                reasons[f"coordinates of {name}"] = "its position follows from those of the scene"
        for name, contact in self.contacts.items():
            for mode in ("free", "slide", "pin"):
                if mode not in contact.kinds:
                    reasons[f"{mode} of {name}"] = "not among its modes"
            if contact.frictionless and "slide" in contact.kinds:
                reasons[f"friction of {name}"] = "frictionless: one slide, without direction"
            elif "slide" not in contact.kinds:
                reasons[f"the coefficient of friction of {name}"] = "it may not slide"
            if "free" not in contact.kinds:
                reasons[f"restitution of {name}"] = "it is never free"
        return reasons

    def value_checks(self) -> Iterator[ValueCheck]:
        """Yield the checks that numbers are physical, finite and, of copies, whole, too."""
        yield from super().value_checks()
        yield from wrap_checks(self)
        yield ValueCheck(self.whole, self.counted)
        yield from physical_checks(self)
        yield from finite_checks(self)
        for name, region in self.regions.items():
            for variable, text in region.variables.items():
                yield finite_check(text, "regions", name, "variables", variable)

    @model_validator(mode="after")
    def _names_are_distinct(self) -> Self:
        # Names in formulas, and where they are declared; the time is nowhere.
        declared: dict[str, Loc] = {TIME: ()}
        declared |= {name: ("parameters", name) for name in self.parameters}
        for name in self.coordinates:
            loc: Loc = ("coordinates", name)
            for used in (name, self.rate_name(name)):
                if used in declared:
                    raise _twice(used, loc, declared[used], " for the coordinate")
                declared[used] = loc
        things: dict[str, str] = {}  # Name -> its section
        for section in ("bodies", "contacts", "joints", "couplings", "controls", "regions"):
            for name in getattr(self, section):
                if name in declared and section != "regions":
                    raise _twice(name, (section, name), declared[name])
                if name in things:
                    one = "body" if things[name] == "bodies" else things[name][:-1]
                    raise DeclarationProblem(
                        f"{name!r} is a {one} already, {{see}}",
                        advice=f"choose another name for the {section[:-1]}",
                        key=(section, name),
                        see=(things[name], name),
                    )
                things[name] = section
        declared = {
            n: (section, n) for n, section in things.items() if section != "regions"
        } | declared
        for region, controller in self.regions.items():
            for name in controller.variables:
                loc = ("regions", region, "variables", name)
                if name in declared:
                    raise _twice(name, loc, declared[name])
                declared[name] = loc
        return self

    @model_validator(mode="after")
    def _names_mean_something(self) -> Self:
        check_copies(self)
        findings = Findings()
        self._references_exist(findings)
        self._formulas_use_declared_names(findings)
        self._coordinates_move_bodies(findings)
        findings.check()
        return self

    def _references_exist(self, findings: Findings) -> None:
        for kind, referred, known, loc in self._references():
            with findings:
                world = referred in ("world", "ground") and referred not in known
                if world and (kind, loc[0]) == ("body", "couplings"):
                    advice = f"against the world write bodies: [{self.coupled(str(loc[1]))[0]}]"
                    raise DeclarationProblem(f"no body {referred!r}", advice=advice, loc=loc)
                check_member(kind, referred, known, *loc)
        copied = {name for name, body in self.bodies.items() if body.copies is not None}
        for name, surface in self.surfaces.items():
            with findings:
                if surface.body in copied:
                    raise DeclarationProblem(
                        f"one body carries a surface, and {surface.body!r} has copies",
                        advice="declare the body that carries it by itself, without copies",
                        loc=("surfaces", name, "body"),
                    )
        for name, mode in self.initial_modes.items():
            if name not in self.contacts or self.contacts[name].surface not in self.surfaces:
                continue
            present = self.region_states(name)
            listed = dict.fromkeys(map(declared_state, present)) | _active(present)
            with findings:
                if mode not in listed:
                    raise DeclarationProblem(
                        f"contact {name!r} does not list the mode {mode!r}",
                        advice="its modes: " + ", ".join(listed),
                        loc=("modes", name),
                    )

    def _references(self) -> Iterator[tuple[str, str, Collection[str], Loc]]:
        """Yield kind, name, declared names, and place of every reference between parts."""
        # Joints hold one copy of a body, by its number; forces act on one or on all.
        single = self.owners()
        for name, contact in self.contacts.items():
            yield "body", contact.point.body, self.bodies, ("contacts", name, "point", "body")
            yield "surface", contact.surface, self.surfaces, ("contacts", name, "surface")
        for name, surface in self.surfaces.items():
            if surface.body is not None:
                yield "body", surface.body, self.bodies, ("surfaces", name, "body")
        for name, joint in self.joints.items():
            for key, end in joint.ends.items():
                yield "body", end.body, single, ("joints", name, key, "body")
        forced = {**self.bodies, **single}
        for name, force in self.forces.items():
            yield "body", force.body, forced, ("forces", name, "body")
        for name, coupling in self.couplings.items():
            if coupling.joint is not None:
                yield "joint", coupling.joint, self.joints, ("couplings", name, "joint")
            for place, body in enumerate(coupling.bodies or ()):
                yield "body", body, single, ("couplings", name, "bodies", place)
        for name in self.initial_modes:
            yield "contact", name, self.contacts, ("modes", name)

    def _formulas_use_declared_names(self, findings: Findings) -> None:
        with findings:
            self.controlled.check(self.kinematic_names)
        with findings:
            self.controlled.check_controller_state(self.kinematic_names)
        # A body that does not move may have a constant place.
        free = [name for name, body in self.bodies.items() if body.position is None]
        check_prescribed(self, findings)
        for name, body in self.bodies.items():
            with findings:
                if not (self.coordinates or free or body.prescribed):
                    raise DeclarationProblem(
                        "a position is a formula of coordinates, and the scene has none",
                        advice=FREE_START,
                        key=("bodies", name, "position"),
                    )
        check_formulas(self, findings)
        check_led_surfaces(self, findings)
        self._check_enabled(findings)
        for name, contact in self.contacts.items():
            self._check_contact(findings, name, contact)
        for name in self.couplings:
            with findings:
                check_coupled(self, name)

    def _check_contact(self, findings: Findings, name: str, contact: Contact) -> None:
        at: Loc = ("contacts", name)
        surface = self.surfaces.get(contact.surface)
        if surface is None:
            return
        with findings:
            if self.gate(name) and "free" not in contact.kinds:
                raise DeclarationProblem(
                    "a contact that can be off comes back as free",
                    advice="list free among the modes",
                    loc=(*at, "modes"),
                )
        with findings:
            if contact.radius is not None:
                check_rim(surface, (*at, "radius"))
        with findings:
            if surface.body == contact.point.body:
                raise DeclarationProblem(
                    f"its point and its surface are of one body, {contact.point.body!r}: nothing "
                    "can bring them together",
                    advice="name a point of another body, or a surface of another one",
                    loc=(*at, "surface"),
                )

    def _check_enabled(self, findings: Findings) -> None:
        relations: list[tuple[str, Loc]] = [
            (text, (section, name, "enabled", place))
            for section, parts in (("contacts", self.contacts), ("couplings", self.couplings))
            for name, part in parts.items()
            for place, text in enumerate(part.enabled)
        ]
        known = self.kinematic_names | self.placed_names | {*self.controls}
        known |= {f"{c}.{q}" for c in self.contacts for q in ("gap", "slip")}
        known |= {f"{coupling}.slip" for coupling in self.couplings}
        changing = known - {*self.parameters}
        named = {name: {*region.named} for name, region in self.controlled.flat.items()}
        ropes = {name for name, joint in self.joints.items() if joint.rope is not None}
        for text, here in relations:
            with findings:
                for member in parse_relation(text).members:
                    owner = member.region
                    if owner in ropes or owner in self.frictional:
                        quantity = f"{owner}.{'gap' if owner in self.contacts else 'slip'}"
                        relation = "" if owner in ropes else f"a relation of {quantity}, or "
                        raise DeclarationProblem(
                            f"in({owner}.{member.state}) asks for a state of a contact, a coupling "
                            "or a rope, which `enabled` cannot",
                            advice=f"write {relation}in(REGION.STATE) of a controller that listens "
                            f"to the events of {owner}",
                            loc=here,
                        )
                for name in sorted(parse_relation(text).names - known):
                    if name.endswith((".V", ".H", ".M")):
                        raise DeclarationProblem(
                            f"`enabled` cannot ask for the force {name}",
                            advice=f"write enabled: in(REGION.STATE), and a guard on {name} there",
                            loc=here,
                        )
                check_relation(text, known, named, changing, *here)

    def _coordinates_move_bodies(self, findings: Findings) -> None:
        used = frozenset[str]().union(*(body.placing for body in self.bodies.values()))
        for name in (n for n in self.coordinates if n not in used):
            with findings:
                raise DeclarationProblem(
                    "it moves no body",
                    advice="use it in the position or the angle of a body, or remove it",
                    key=("coordinates", name),
                )

    @model_validator(mode="after")
    def _numbers_are_physical(self) -> Self:
        check_turns(self)
        check_kinks(self)
        # A pin by points has no impacts of its own: its path is smooth.
        pins = [] if self.collisions else [n for n, x in self.joints.items() if x.rope is None]
        check_wrapping(self, [("joints", name, "to") for name in pins])
        changing = {*self.controlled.controller_state, *self.kinematic_names} - {*self.parameters}
        check_periods(self.regions, self.parameters, changing)
        for name, region in self.regions.items():
            for variable, text in region.variables.items():
                check_names(parse(text), self.parameters, "regions", name, "variables", variable)
        self.check_values(self.values())
        check_collisions(self)
        return self

    @model_validator(mode="after")
    def _uses_exist(self) -> Self:
        expanded = self.expanded
        names = self.kinematic_names | self.quantity_names | self.placed_names | {*self.controls}
        variables = {v for region in self.regions.values() for v in region.variables}
        changing = names - {*self.parameters, *(variables - {*self.controlled.flowing})}
        flat = expanded.controlled.flat
        found = {name: {*region.named} for name, region in flat.items()}
        causes = {name: {*of_region} for name, of_region in causes_of(flat).items()}
        for name in expanded.frictional:
            found[name] = {*_active(expanded.region_states(name))}
            causes[name] = {edge.cause for edge in expanded.region_edges(name)}
        if self.collisions:
            found |= {name: {*_active(BODY_STATES)} for name in self.moving()}
            causes |= {name: {*BODY_CAUSES} for name in self.moving()}
        findings = Findings()
        with findings:
            self.check_uses(names, found, causes, changing)
        for name, region in self.regions.items():
            transitions = list(declared_transitions(region, "regions", name))
            with findings:
                check_listening(name, transitions, causes, found)
            for transition, at in transitions:
                with findings:
                    if transition.guard is not None:
                        check_relation(transition.guard, names, found, changing, *at, "guard")
        for name, joint in self.joints.items():
            for place, text in enumerate(joint.enabled):
                with findings:
                    check_relation(text, names, found, changing, "joints", name, "enabled", place)
        findings.check()
        self.check_ranges()
        return self


def _replaced(scene: _Scene, changes: Mapping[str, Any]) -> _Scene:
    fields = {name: getattr(scene, name) for name in type(scene).model_fields}
    return scene.model_construct(**{**fields, **changes})


def _twice(name: str, loc: Loc, before: Loc, of: str = "") -> DeclarationProblem:
    what = "declared twice, first as {see}" if before else "the time of the run"
    advice = f"choose another name{of}"
    return DeclarationProblem(f"{name!r} is {what}", advice=advice, key=loc, see=before)


def _active(states: Iterable[str]) -> dict[str, None]:
    names = dict.fromkeys(states)
    return names | dict.fromkeys(superstates_of(names).values())
