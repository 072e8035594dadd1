"""Expansion of a scene: joints that can be off become regions, ropes and limits contacts.

A joint with `enabled` becomes a controller region with the states closed and off; the position that
it captures is a variable of the region. A rope becomes a contact with the inside of a circle, each
limit of an angle a contact whose gap is the remaining angle.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from functools import cache
from typing import TYPE_CHECKING, Any

from contacts.scene.controls import Controller, ControlState
from contacts.scene.couplings import Coupling, Rolling
from contacts.scene.joints import Joint, Path
from contacts.scene.parts import Contact, Pair, Point, Surface
from contacts.states import CLOSED, OFF
from statechart.charts.transitions import Transition
from statechart.documents.declaration import TIME
from statechart.documents.fields import FiniteText, FormulaText, replace_fields
from statechart.errors import DeclarationProblem
from statechart.formulas.condition import InState, Or
from statechart.formulas.formula import parse
from statechart.formulas.relation import Comparison, Negation, Term, conjunction, parse_relation

if TYPE_CHECKING:
    from contacts.scene.fields import SceneFields

_Start = Callable[[], Mapping[str, float]]
"""Returns the values of all names at the start, computed if a relation asks for them."""
ENABLE, DISABLE = "enable", "disable"
"""Events of a joint: it closes, and it lets go."""
BROKEN = "broken"
"""State of a joint opened by its own forces; only another part of `enabled` closes it again."""


def is_switched(joint: Joint) -> bool:
    """Return whether a joint becomes a region with the states closed and off."""
    return bool(joint.enabled) and joint.rope is None


def captured_variables(name: str, joint: Joint) -> tuple[str, ...]:
    """Return the variables that hold the pose in which a joint closed."""
    names: dict[str, str] = {"X": "x", "Y": "y"} if joint.rest is not None else {}
    names |= {"M": "turn"} if is_switched(joint) else {}
    return tuple(f"{name}.{names[c]}" for c in joint.components if c in names)


class Reach(Surface):
    """Circle within which a rope holds a point."""


def reach_of(name: str) -> str:
    """Return the name of the circle of a rope."""
    return f"{name}.surface"


class Stop(Surface):
    """A limit of the angle of a body, against another or the world."""

    limit: FiniteText
    side: int  # 1 at the least angle, -1 at the greatest
    other: str | None


def limit_contacts(name: str) -> tuple[str, str]:
    """Return the names of the contacts with the least and the greatest angle of a joint."""
    return f"{name}_min", f"{name}_max"


def expansion(scene: SceneFields) -> dict[str, dict[str, Any]]:
    """Return the complete sections of a scene to which its joints add; {} if there are none."""
    surfaces: dict[str, Surface] = {}
    contacts: dict[str, Contact] = {}
    controllers: dict[str, Controller] = {}
    joints: dict[str, Joint] = {}

    def add_contact(name: str, joint: Joint, surface: Surface, gate: tuple[str, ...]) -> None:
        if scene.collisions:
            # Time steps of bodies with shapes have rows for ropes and limits.
            return
        surfaces[reach_of(name)] = surface
        contacts[name] = Contact(
            point=joint.point,
            surface=reach_of(name),
            friction=0,
            restitution=0 if joint.restitution is None else joint.restitution,
            enabled=gate,
        )

    # Of the whole scene, for all joints.
    start = cache(lambda: _start(scene, None))
    kinematic = cache(lambda: _kinematic_names(scene))
    for name, joint in scene.joints.items():
        gate = joint.enabled
        if joint.rope is None or scene.collisions:
            joints[name] = _as_captured(name, joint)
        elif gate and _uses_forces(scene, gate, kinematic()):
            holder = f"{name}_{CLOSED}"
            controllers[holder] = _region(scene, name, joint, start)
            gate = (f"in({holder}.{CLOSED})",)
        if is_switched(joint):
            controllers[name] = _region(scene, name, joint, start)
            gate = (f"in({name}.{CLOSED})",)
        if joint.rope is not None:
            add_contact(name, joint, _circle(joint, joint.rope), gate)
        if joint.limits is not None:
            other = joint.to.body if isinstance(joint.to, Point) else None
            limits = zip(limit_contacts(name), joint.limits, (1, -1), strict=True)
            for contact, limit, side in limits:
                stop = Stop.model_construct(limit=limit, side=side, other=other)
                add_contact(contact, joint, stop, gate)
    resisted = {name: _resistance(scene, contact) for name, contact in scene.rolling.items()}
    if not contacts and not controllers and not resisted:
        return {}
    _check_names(scene, {*contacts, *controllers, *resisted}.difference(scene.joints))
    return {
        "joints": joints,
        "couplings": {n: _in_joint(scene, c) for n, c in scene.couplings.items()} | resisted,
        "surfaces": {**scene.surfaces, **surfaces},
        "contacts": {**scene.contacts, **contacts},
        "regions": {**scene.regions, **controllers},
    }


def _resistance(scene: SceneFields, name: str) -> Rolling:
    contact = scene.contacts[name]
    carrier = scene.surface_of(name).body
    bodies = (contact.point.body,) if carrier is None else (contact.point.body, carrier)
    return Rolling.model_construct(limit=contact.rolling_resistance, bodies=bodies, contact=name)


def _in_joint(scene: SceneFields, coupling: Coupling) -> Coupling:
    """Return a coupling that is open while its joint is off."""
    joint = scene.joints.get(coupling.joint or "")
    if joint is None or not is_switched(joint):
        return coupling
    closed = f"in({coupling.joint}.{CLOSED})"
    return replace_fields(coupling, enabled=(*coupling.enabled, closed))


def _check_names(scene: SceneFields, added: AbstractSet[str]) -> None:
    for section in ("bodies", "contacts", "joints", "couplings", "regions"):
        for name in added & getattr(scene, section).keys():
            raise DeclarationProblem(
                f"{name!r} is a region of {name.rpartition('_')[0]!r}",
                advice="choose another name",
                key=(section, name),
            )


def _circle(joint: Joint, length: FormulaText) -> Surface:
    if isinstance(joint.to, Point):
        return Reach(circle=joint.to.at, radius=length, hollow=True, body=joint.to.body)
    x, y = joint.to.x or 0, joint.to.y or 0
    led = TIME in parse(x).names | parse(y).names
    centre, path = ((0, 0), (x, y)) if led else ((x, y), (0, 0))
    return Reach(circle=centre, radius=length, hollow=True, displacement=path)


def _kinematic_names(scene: SceneFields) -> frozenset[str]:
    """Return the names that depend on places and velocities, not on forces."""
    of_contacts = {f"{c}.{q}" for c in scene.contacts for q in ("gap", "slip")}
    return scene.kinematic_names | {*scene.controls} | of_contacts


def _uses_forces(
    scene: SceneFields, relations: tuple[str, ...], kinematic: AbstractSet[str]
) -> bool:
    """Return whether relations use forces, or states of contacts and couplings."""
    relation = parse_relation(conjunction(relations))
    return not relation.names <= kinematic or any(
        member.region not in scene.controlled.flat for member in relation.members
    )


def _region(scene: SceneFields, name: str, joint: Joint, start: _Start) -> Controller:
    """Return the region of a joint that can be off."""
    relation, captures = conjunction(joint.enabled), _capture_formulas(scene, name, joint)
    term = parse_relation(relation)
    own_forces = re.compile(rf"(?<![\w.]){re.escape(name)}\.\w+")
    # The joint's forces are zero while it is off: opened by them, it would close at once.
    without_forces = own_forces.sub("0", relation)
    other_names = term.members or term.names - {*own_forces.findall(relation), *scene.parameters}
    reclosing = without_forces if without_forces != relation and other_names else relation
    states = {CLOSED: ControlState(entry=dict(captures)), OFF: ControlState()}
    edges = [(DISABLE, CLOSED, OFF, f"not ({reclosing})")]
    if reclosing != relation:
        states[BROKEN] = ControlState()
        edges.append((DISABLE, CLOSED, BROKEN, f"not ({relation})"))
    if reclosing == without_forces:
        edges.append((ENABLE, OFF, CLOSED, reclosing))
    region = Controller(
        initial=OFF if _holds_at_start(scene, term.root, start) is False else CLOSED,
        states=states,
        transitions=tuple(
            Transition(**{"name": event, "from": before, "to": after, "guard": guard})
            for event, before, after, guard in edges
        ),
    )
    # Names with a dot, which no declared variable has.
    return replace_fields(region, variables=dict.fromkeys(captures, 0))


def joints_judged_at_start(scene: SceneFields) -> dict[str, int]:
    """Return joints that ask for contacts or other joints -> the places of their regions.

    Their relations depend on the first mode of a run; the scene is expanded.
    """
    places = {name: place for place, name in enumerate(scene.controlled.flat)}
    ropes = (name for name in scene.contacts if isinstance(scene.surface_of(name), Reach))
    found = {}
    for name in (*scene.joints, *ropes):
        region = name if name in scene.joints else f"{name}_{CLOSED}"
        if region not in places:
            continue
        referred = set[str]()
        for transition in scene.regions[region].transitions:
            relation = parse_relation(transition.guard or "")
            referred |= {member.region for member in relation.members}
            referred |= {used.rpartition(".")[0] for used in relation.names}
        if referred & {*scene.frictional, *scene.joints} - {name}:
            found[name] = places[region]
    return found


def start_problem(
    scene: SceneFields, problem: DeclarationProblem, values: Mapping[str, float]
) -> DeclarationProblem:
    """Return the problem of a closed joint at the start, or that `values` open the joint.

    Its first state is that with the declared parameters.
    """
    name = str(problem.loc[1])
    enabled = scene.joints[name].enabled
    if not enabled:
        return problem
    relation = parse_relation(conjunction(enabled))
    if _holds_at_start(scene, relation.root, cache(lambda: _start(scene, values))) is not False:
        return problem
    return DeclarationProblem(
        f"the declared parameters close joint {name!r} at the start, and it is off",
        advice="declare parameters with which it starts off, too",
        loc=("joints", name),
    )


def _holds_at_start(scene: SceneFields, term: Term, start: _Start) -> bool | None:
    """Return whether a relation holds at the start; None if it depends on forces."""
    if isinstance(term, Negation):
        operand = _holds_at_start(scene, term.part, start)
        return None if operand is None else not operand
    if isinstance(term, InState):
        region = scene.controlled.flat.get(term.region)
        if region is not None:
            return term.state in region.active(region.initial)
        # Bodies with shapes start free.
        return term.state == "free" if scene.collisions and term.region in scene.moving() else None
    if isinstance(term, Comparison):
        known = start()
        if not term.left.names | term.right.names <= known.keys():
            return None
        return bool(term.holds(term.left.value(known), term.right.value(known)))
    operands = [_holds_at_start(scene, operand, start) for operand in term.parts]
    decisive = isinstance(term, Or)
    return decisive if decisive in operands else None if None in operands else not decisive


def _start(scene: SceneFields, values: Mapping[str, float] | None) -> dict[str, float]:
    known = scene.values() if values is None else values
    texts = {**scene.starts(), **scene.controlled.controller_state}
    start_values = {name: parse(text).value(known) for name, text in texts.items()}
    return {TIME: 0.0, **known, **start_values}


def _frame(scene: SceneFields, name: str) -> tuple[str, str, str]:
    body = scene.single_body(name)
    assert body is not None
    if body.position is not None or body.fixed:
        x, y, angle = body.path
        return f"({x})", f"({y})", f"({angle})"
    return f"{name}.x", f"{name}.y", f"{name}.angle" if body.inertia is not None else "0"


def _rotated_formulas(vector: Pair, angle: str, back: bool = False) -> tuple[str, str]:
    x, y = map(str, vector)
    if angle == "0":
        return x, y
    c, s, sign, opposite_sign = f"cos({angle})", f"sin({angle})", "-+"[back], "+-"[back]
    return f"({c}*({x}) {sign} {s}*({y}))", f"({c}*({y}) {opposite_sign} {s}*({x}))"


def _capture_formulas(scene: SceneFields, name: str, joint: Joint) -> dict[str, str]:
    """Return the formulas of the captured pose of a joint, by variable."""
    x, y, angle = _frame(scene, joint.point.body)
    arm_x, arm_y = _rotated_formulas(joint.point.at, angle)
    position = f"{x} + {arm_x}", f"{y} + {arm_y}"
    if isinstance(joint.to, Point):
        x0, y0, angle0 = _frame(scene, joint.to.body)
        distance = f"{position[0]} - ({x0})", f"{position[1]} - ({y0})"
        relative = _rotated_formulas(distance, angle0, back=True)
    else:
        angle0 = "0"
        relative = f"{position[0]} - ({joint.to.x or 0})", f"{position[1]} - ({joint.to.y or 0})"
    values = {"x": relative[0], "y": relative[1], "turn": f"{angle} - {angle0}"}
    variables = captured_variables(name, joint)
    return {variable: values[variable.rpartition(".")[2]] for variable in variables}


def _as_captured(name: str, joint: Joint) -> Joint:
    """Return a joint at the position that its region has captured."""
    if joint.rest is None:
        return joint
    if isinstance(joint.to, Point):
        end = Point(body=joint.to.body, at=(f"{name}.x", f"{name}.y"))
        return replace_fields(joint, to=end)
    x, y = (
        None if text is None else f"{text} + {name}.{axis}"
        for axis, text in (("x", joint.to.x), ("y", joint.to.y))
    )
    return replace_fields(joint, to=Path(x=x, y=y))
