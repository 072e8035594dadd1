"""Warnings about probable mistakes, and about impact laws that time stepping replaces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import combinations

from contacts.scene.fields import SceneFields
from contacts.scene.friction import Friction, coefficients
from contacts.scene.parts import MOREAU, Contact
from contacts.scene.regions import BODY_CAUSES, BODY_IMPACT, BODY_STATES
from statechart.charts.transitions import declared_transitions
from statechart.documents.declaration import TIME
from statechart.documents.fields import FormulaText
from statechart.documents.outputs import Count, Event, Value
from statechart.documents.quantities import fields_of
from statechart.errors import DeclarationError, DeclarationProblem
from statechart.formulas.formula import evaluator, parse
from statechart.formulas.relation import parse_relation
from statechart.formulas.tree import Name, Node, Number, Unary, calls_in

NEARLY_MEETING = 1e-3
"""Ends of edges closer than this part of the scene's length were probably meant to meet."""

# Ends closer than this part of the edges' extent are equal up to round-off.
_EQUAL = 1e-12
# A constant angle beyond a turn is probably in degrees.
_TURN = 2.0 * math.pi
# Depth of a point in a line's solid, relative to its distance from the line's first point, that is
# round-off.
_GAP_ROUND_OFF = 1e-9
# Plausible inertias relative to mass times the largest radius squared: usually 0.01 to 1. Mixed
# millimetres and metres give 1e6; bodies that never turn often have an arbitrary inertia of 1.
_MIN_INERTIA, _MAX_INERTIA = 1e-5, 1e4
_OF_ANGLES = frozenset({"sin", "cos", "tan"})


def lint(scene: SceneFields) -> tuple[str, ...]:
    """Return warnings about probable mistakes."""
    return tuple(dict.fromkeys(_warnings(scene)))


def _warnings(scene: SceneFields) -> Iterator[str]:
    if not isinstance(scene.gravity, tuple):
        value = _constant_value(parse(scene.gravity).root, scene.parameters)
        if value < 0.0:
            yield (
                f"gravity: {value:g} acts upwards, as it is the acceleration downwards; "
                f"write {-value:g}"
            )
    yield from angles_in_degrees(scene)
    yield from _limits_in_degrees(scene)
    yield from _static_by_hand(scene)
    if scene.collisions:
        yield from _idle(scene)
        yield from _impossible_events(scene)
    for check in (_spread, _starts_inside, nearly_meeting_ends):
        # Other checks report formulas that have no value.
        with suppress(DeclarationError, DeclarationProblem):
            yield from check(scene)
    for formula, _ in fields_of(scene):
        for call in calls_in(formula, _OF_ANGLES):
            value = _constant_value(call.arguments[0], {})
            if abs(value) > _TURN:
                yield f"{call.function}({value:g}): {_degrees(value)}"


def angles_in_degrees(scene: SceneFields) -> Iterator[str]:
    """Yield warnings about angles at the start beyond a turn."""
    angles: list[tuple[str, FormulaText]] = [
        (f"bodies.{name}.start.angle", body.start["angle"])
        for name, body in scene.bodies.items()
        if "angle" in body.start
    ]
    turning = {body.angle for body in scene.bodies.values()}
    angles += [
        (f"coordinates.{name}.start", coordinate.start)
        for name, coordinate in scene.coordinates.items()
        if name in turning
    ]
    yield from _beyond_a_turn(scene, angles)


def _limits_in_degrees(scene: SceneFields) -> Iterator[str]:
    for name, joint in scene.joints.items():
        yield from _beyond_a_turn(scene, [(f"joints.{name}.limits", x) for x in joint.limits or ()])


def _beyond_a_turn(scene: SceneFields, angles: Iterable[tuple[str, FormulaText]]) -> Iterator[str]:
    for place, text in angles:
        value = _constant_value(parse(text).root, scene.parameters)
        if _TURN < abs(value) < math.inf:
            yield f"{place}: {_degrees(value)}"


def _static_by_hand(scene: SceneFields) -> Iterator[str]:
    """Yield warnings about coefficients that controllers switch on slip and stick."""
    for name, contact in scene.contacts.items():
        law = scene.friction_of(name)
        region = None if law is None else scene.controlled.region_of(law.both)
        if region is None or isinstance(contact.friction, Friction):
            continue
        transitions = declared_transitions(scene.regions[region], "regions", region)
        causes = {
            event.cause
            for transition, _ in transitions
            for event in transition.events
            if event.region == name
        }
        if causes & {"slip", "stick"}:
            yield (
                f"contacts.{name}.friction: {contact.friction} changes after {name} slips or "
                "sticks, so where it comes to rest that of its motion decides; write friction: "
                "{static: S, kinetic: K}"
            )


def _idle(scene: SceneFields) -> Iterator[str]:
    """Yield warnings about bodies with shapes, and surfaces, that are in no collisions.

    Fixed and led bodies may serve as ends of joints alone.
    """
    used = {("bodies", name) for law in scene.collisions.values() for name in law.bodies}
    used |= {("surfaces", name) for law in scene.collisions.values() for name in law.surfaces}
    owners = scene.owners()
    ends = {owners[end.body] for joint in scene.joints.values() for end in joint.ends.values()}
    used |= {("bodies", name) for name in ends if scene.bodies[name].prescribed}
    shaped = [("bodies", n) for n, body in scene.bodies.items() if body.shape and not body.linked]
    for kind, name in (*shaped, *(("surfaces", name) for name in scene.surfaces)):
        if (kind, name) not in used:
            yield (
                f"{kind}.{name}: it collides with nothing; list it in {kind} of "
                "collisions, if it should"
            )


def _impossible_events(scene: SceneFields) -> Iterator[str]:
    """Yield warnings about awaited events and states that bodies with shapes cannot have."""
    owners, awaited = scene.owners(), [*_events_of_outputs(scene)]
    for region, declared in scene.regions.items():
        for transition, loc in declared_transitions(declared, "regions", region):
            awaited.append((".".join(map(str, loc)), transition.events))
    for place, events in awaited:
        for body, event in ((event.region, event.cause) for event in events):
            if body not in owners or event not in {*BODY_CAUSES, *BODY_STATES}:
                continue
            possible = _events_of_body(scene, owners[body])
            if event not in possible:
                causes = [cause for cause in BODY_CAUSES if cause in possible]
                advice = f"its events are {', '.join(causes)}" if causes else "it has no collisions"
                yield f"{place}: {body}.{event} never happens in this scene; {advice}"


def _events_of_outputs(scene: SceneFields) -> Iterator[tuple[str, Sequence[Event]]]:
    """Yield the place and the awaited events of outputs."""
    for name, output in scene.outputs.items():
        if isinstance(output, Value | Count):
            moment = output.moment if isinstance(output, Value) else output
            yield f"outputs.{name}", moment.events


def _events_of_body(scene: SceneFields, body: str) -> set[str]:
    """Return the events and states that a declared body with a shape may have.

    Only friction pins a body. A single disc on one line or circle has one contact, which nothing
    else strikes.
    """
    laws, declared = [x for x in scene.collisions.values() if body in x.bodies], scene.bodies[body]
    possible = {*BODY_CAUSES, *BODY_STATES} if laws else {"free"}
    frictions = [x.friction for x in laws if not isinstance(x.friction, Friction)]
    if len(frictions) == len(laws) and all(
        _constant_value(parse(x).root, {}) == 0 for x in frictions
    ):
        possible -= {"stick", "slip", "pin"}
    met = {name for law in laws for name in (*law.bodies, *law.surfaces)} - {body}
    surface = scene.surfaces.get(met.pop()) if len(met) == 1 else None
    alone = declared.copies is None and not (scene.joints or scene.couplings)
    if alone and surface and not (surface.moves or surface.body):
        one = len(declared.shape) == 1 and declared.shape[0].disc is not None
        possible -= {BODY_IMPACT} if one and (surface.straight or surface.circle) else set()
    return possible


def _spread(scene: SceneFields) -> Iterator[str]:
    """Yield warnings about inertias that are implausible for the shapes (mixed units)."""
    number = evaluator(scene.values())
    for name, body in scene.bodies.items():
        if not body.shape or body.inertia is None:
            continue
        reach = max(
            math.hypot(*map(number, corner)) + number(shape.disc or 0)
            for shape in body.shape
            for corner in shape.polygon or (shape.at,)
        )
        mass, inertia = number(body.mass), number(body.inertia)
        largest = mass * reach**2
        if largest > 0.0 and not _MIN_INERTIA * largest <= inertia <= _MAX_INERTIA * largest:
            yield (
                f"bodies.{name}.inertia: {inertia:.3g} is {inertia / largest:.1g} times "
                f"mass*radius**2 = {largest:.3g} of its shape; check the units (a disc has "
                "m*r**2/2, a box m*(width**2 + height**2)/12)"
            )


def _starts_inside(scene: SceneFields) -> Iterator[str]:
    """Yield warnings about bodies whose centre starts in the solid of a line that they touch."""
    values = scene.values()
    values |= {
        name: parse(coordinate.start).value(values)
        for name, coordinate in scene.coordinates.items()
    }
    number = evaluator({**values, TIME: 0.0})
    for name, contact in scene.contacts.items():
        surface, body = scene.surfaces[contact.surface], scene.bodies[contact.point.body]
        if surface.line is None or surface.body is not None or surface.moves:
            continue
        if scene.initial_modes.get(name) == "off":
            continue
        x, y = map(number, body.path[:2])
        (a, b), (c, d) = (map(number, end) for end in surface.line)
        depth = ((x - a) * (d - b) - (y - b) * (c - a)) / math.hypot(c - a, d - b)
        if depth > _GAP_ROUND_OFF * max(abs(x - a), abs(y - b)):
            yield (
                f"contacts.{name}: {contact.point.body!r} starts {depth:.3g} inside the solid of "
                f"{contact.surface!r}, which is on the right of the way from its first point to "
                "its second; to have the other side solid, swap the points"
            )


def _constant_value(node: Node, parameters: Mapping[str, FormulaText]) -> float:
    """Return the value of a constant, or of a parameter that is one; nan for other formulas."""
    match node:
        case Number(value=value):
            return value
        case Unary(operator=sign, operand=operand):
            return _constant_value(operand, parameters) * (-1.0 if sign == "-" else 1.0)
        case Name(name=name) if name in parameters:
            return _constant_value(parse(parameters[name]).root, {})
    return math.nan


def _degrees(value: float) -> str:
    return (
        f"{value:g} radians are {abs(value) / _TURN:.3g} turns; of degrees write {value:g}*pi/180"
    )


def stays_off_warning(scene: SceneFields, contact: str, depth: float) -> str:
    """Return the warning about a contact that stays off since its point is inside the surface."""
    surface = scene.contacts[contact].surface
    when = f"edge {surface} when it reaches it; let the ends of edges meet"
    if scene.surfaces[surface].edge is None:
        when = f"surface {surface} when its conditions become true; let adjacent surfaces meet"
    return f"{contact} stays off: its point is {depth:.3g} below the {when}"


def missed_edge_warning(contact: str) -> str:
    """Return the warning about a point that passes a surface next to where its conditions hold."""
    return (
        f"{contact} stays off: its conditions just fail as its point passes the surface; "
        "let adjacent surfaces overlap"
    )


def goes_off_warning(contact: str, time: float) -> str:
    """Return a warning: the conditions of a contact end on its own surface."""
    return (
        f"{contact} goes off at t = {time:.7g}, as its point touches: its conditions fail there; "
        "let them hold on the surface and a little below it"
    )


def nearly_meeting_ends(scene: SceneFields) -> Iterator[str]:
    """Yield a warning for each two edges whose ends nearly meet."""
    number = evaluator(scene.values())
    ends = {
        name: [tuple(map(number, corner)) for corner in surface.edge]
        for name, surface in scene.surfaces.items()
        if surface.edge is not None and not surface.moves
    }
    corners = [corner for edge in ends.values() for corner in edge]
    if not corners:
        return
    extent = math.hypot(*(max(side) - min(side) for side in zip(*corners, strict=True)))
    for first, second in combinations(ends, 2):
        if scene.surfaces[first].body != scene.surfaces[second].body:
            continue
        distance, a, b = min(
            (math.dist(ends[first][a], ends[second][b]), a, b) for a in range(2) for b in range(2)
        )
        if _EQUAL * extent < distance < NEARLY_MEETING * extent:
            numbers = ("first", "second")
            yield (
                f"surfaces.{second}.edge: its {numbers[b]} point is {distance:.3g} from the "
                f"{numbers[a]} point of {first!r}, so that a sliding point may fall between; "
                "write the same point for both"
            )


def replaced_laws(scene: SceneFields, values: Mapping[str, float]) -> dict[str, str]:
    """Return the declared laws and events that time stepping replaces, or passes over -> why."""
    replacements = {}
    rigid = {n: c for n, c in scene.contacts.items() if "free" in c.kinds and c.stiffness is None}
    if scene.simultaneous == "sequential" and rigid and _nearly_meet(scene):
        replacements["simultaneous: sequential"] = (
            "with time steps, simultaneous impacts follow Moreau's law, as with capped"
        )
    if scene.paradox == "stop" and scene.collisions:
        replacements["paradox: stop"] = (
            "bodies with shapes that friction presses into others are stopped by an impact, "
            "as with impact"
        )
    waiting = [
        place
        for place, events in _events_of_outputs(scene)
        if any(event.cause == "zeno" for event in events)
    ]
    regions = scene.controlled.flat.items()
    waiting += [f"regions.{name}" for name, region in regions if "zeno" in region.awaited]
    if waiting:
        replacements[f"event zeno of {', '.join(waiting)}"] = (
            "with time steps, bounces end with a touchdown, and there is no such event; write the "
            "state that is entered, such as CONTACT.slide"
        )
    replacements |= _passed_instants(scene, values)
    other_laws: dict[str, list[str]] = {}
    for name, contact in rigid.items():
        if contact.impact != MOREAU and not _impact_laws_agree(scene, contact, values):
            other_laws.setdefault(contact.impact, []).append(name)
    for law, names in other_laws.items():
        replacements[f"impact: {law} at {', '.join(names)}"] = (
            "steps use Moreau's law instead; impact: moreau gives the same with events"
        )
    return replacements


def _passed_instants(scene: SceneFields, values: Mapping[str, float]) -> Iterator[tuple[str, str]]:
    """Yield relations of positions that hold at an instant only, which steps pass over."""
    import sympy as sp

    relations = [(f"stop.conditions.{n}", text) for n, text in scene.stop.conditions.items()]
    for name, region in scene.regions.items():
        for transition, loc in declared_transitions(region, "regions", name):
            if transition.guard is not None:
                place = ("joints", name, "enabled") if name in scene.joints else (*loc, "guard")
                relations.append((".".join(map(str, place)), transition.guard))
    for where, text in relations:
        relation = parse_relation(text)
        symbols = {name: sp.Symbol(name, real=True) for name in relation.names}
        known = {**symbols, **{name: sp.Float(value) for name, value in values.items()}}
        moving = {symbols[name] for name in relation.names & {*scene.variables, TIME}}
        if relation.condition(known).instantaneous(moving):
            yield (
                where,
                "steps pass over the instant at which it holds; write one comparison by <= or >=, "
                "which becomes true as its left side passes the right one",
            )


def _nearly_meet(scene: SceneFields) -> bool:
    """Return whether contacts may be coupled: on one body, or by joints and coordinates."""
    linked = bool(scene.joints) or any(body.position is not None for body in scene.bodies.values())
    touched = [contact.point.body for contact in scene.contacts.values()]
    carriers = (scene.surfaces[contact.surface].body for contact in scene.contacts.values())
    touched += [body for body in carriers if body is not None]
    return len(scene.contacts) > 1 and (linked or len({*touched}) < len(touched))


def _impact_laws_agree(scene: SceneFields, contact: Contact, values: Mapping[str, float]) -> bool:
    """Return whether all impact laws agree: no friction, or a free particle or centred point."""
    static, _ = coefficients("inf" if contact.friction is None else contact.friction)
    largest = parse(static)
    if contact.frictionless or (largest.names <= values.keys() and largest.value(values) == 0.0):
        return True
    name = contact.point.body
    body = scene.bodies[name]
    jointed = {end.body for joint in scene.joints.values() for end in joint.ends.values()}
    fixed = scene.surfaces[contact.surface].body is None
    # Its normal impulse does not turn it, and friction does not lift it.
    centred = contact.rolling_resistance is None
    centred = centred and all(parse(text).value(values) == 0.0 for text in contact.point.at)
    free = (body.inertia is None or centred) and body.position is None
    return free and fixed and name not in jointed
