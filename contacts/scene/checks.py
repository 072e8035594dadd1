"""Checks of a scene: numbers physical, formulas smooth, shapes convex, names in their places."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, combinations, groupby, pairwise, product
from string import digits
from types import MappingProxyType
from typing import NamedTuple

from pydantic import BaseModel

from contacts.scene.expansion import reach_of
from contacts.scene.fields import SceneFields
from contacts.scene.friction import AT_REST, SLIP, Friction, check_sides, friction_law
from contacts.scene.parts import Surface, used_names
from contacts.scene.shapes import INDEX
from statechart.charts.transitions import PERIOD, PERIOD_ADVICE, periods_in
from statechart.charts.wrapping import WRAP_ADVICE
from statechart.documents.declaration import TIME
from statechart.documents.documented import leaves
from statechart.documents.fields import (
    FormulaText,
    ValueCheck,
    check_derived,
    check_named_infinity,
    check_names,
    check_smooth,
    finite_check,
    has_switch,
    value_of,
)
from statechart.documents.outputs import check_member
from statechart.errors import DeclarationProblem, Findings, Loc
from statechart.formulas.formula import Formula, parse
from statechart.formulas.tree import names_in

# Advice on formulas that must not change along a run.
_NEVER_SLIPS = (
    "a large number never slips; what never turns is a joint with angle: held, or one coordinate"
)
_MOVED = "a surface that moves has a displacement, or a turn; a hill is a height, a formula of x"
_SWITCHED = (
    "write a control, which the states of a region set, and transitions where it changes "
    "(guard: abs(tip.slip) >= v)"
)
_PULLED = "write a force on the body, or give the ground a displacement"
_CONSTANT = "write a formula of parameters"
_LED = (
    "a body with a shape that follows a path has no mass: remove mass; "
    "a joint leads a point of any other body, to: [v*time, 0]"
)
# Quantities of a contact that forces cannot use: reason, and alternative.
_PUSH = (
    "a force follows from places and velocities",
    "for a contact that gives, write stiffness and damping of {0!r}; else coordinates and rates of "
    "bodies",
)
_FRICTION = (
    "forces of contacts follow from the others",
    "for a couple against rolling, write rolling_resistance: LENGTH of {0!r}; for a force along "
    "the surface, friction",
)
_CARRIED = (
    "loads of joints and couplings follow from the other forces",
    "for friction in a joint, write couplings: {{f: {{joint: JOINT, limit: F}}}} with F a formula "
    "of places and velocities",
)
_OF_FORCES = {"gap": _PUSH, "slip": _PUSH, "V": _FRICTION, "H": _FRICTION}


def formulas(part: BaseModel) -> Iterator[tuple[Loc, FormulaText]]:
    """Yield the formulas of a part of a scene with their places: all fields with a unit."""
    for loc, value, unit in leaves(part, single="shape"):
        if unit and isinstance(value, str | int | float) and not isinstance(value, bool):
            if loc[-2:] in (("to", "x"), ("to", "y")):
                # A path may be declared as a list or as a mapping.
                loc = (*loc[:-1], "xy".index(str(loc[-1])), loc[-1])
            yield loc, value


_SECTIONS = frozenset(
    ("gravity", "coordinates", "bodies", "surfaces", "contacts", "joints", "couplings", "forces")
) | {"collisions"}


def scene_formulas(scene: SceneFields) -> Iterator[tuple[Loc, FormulaText]]:
    """Yield the formulas of bodies, surfaces and contacts, with their places."""
    return ((loc, text) for loc, text in formulas(scene) if loc[0] in _SECTIONS)


@dataclass(frozen=True)
class _Names(Collection[str]):
    """A union of names, not copied: a scene has many formulas, and each uses a few names."""

    parts: tuple[Collection[str], ...]

    def __contains__(self, name: object) -> bool:
        return any(name in part for part in self.parts)

    def __iter__(self) -> Iterator[str]:
        return chain(*self.parts)

    def __len__(self) -> int:
        return sum(map(len, self.parts))


def _motion_names(scene: SceneFields) -> frozenset[str]:
    """Return the names that forces and limits of couplings may use."""
    return scene.kinematic_names | {*scene.controls} | scene.placed_names


def _names_for(scene: SceneFields, loc: Loc, motion: Collection[str]) -> Collection[str]:
    """Return the names that the formula at a place may use; `motion` are `_motion_names`."""
    return _Names((scene.parameters, *_further_names(scene, loc, motion)))


def _further_names(
    scene: SceneFields, loc: Loc, motion: Collection[str]
) -> tuple[Collection[str], ...]:
    """Return the names, other than parameters, that the formula at a place may use."""
    memory, controls = scene.controlled.controller_state, scene.controls
    section, name, key, *_ = (*map(str, loc), "", "")
    match section, key:
        case "bodies", "angle" | "position":
            if not scene.bodies[name].prescribed:
                return (scene.coordinates,)
            numbered = {TIME, INDEX} if scene.bodies[name].copies is not None else {TIME}
            return numbered, memory, controls
        case "bodies", "start" if scene.bodies[name].copies is not None:
            return ({INDEX},)
        case "surfaces", "height":
            return ({"x"},)
        case ("surfaces", "displacement" | "turn") | ("joints", "to") if loc[-1] != "at":
            # Variables of controllers may move surfaces, and joints of bodies with shapes.
            if section == "surfaces":
                return {TIME}, memory, () if scene.collisions else controls
            if loc[-1] in ("x", "y"):
                return {TIME}, memory if scene.collisions else ()
        case "joints", "rope" | "rod" if not scene.collisions:
            return ({TIME}, memory, controls) if key == "rope" else ({TIME},)
        case "contacts", "friction" | "restitution":
            law = scene.friction_of(name) if key == "friction" and loc[-1] != "static" else None
            return controls, law.slips if law else ()
        case "forces", "force" | "moment":
            # A force on copies may use the coordinates of each copy.
            copied = scene.bodies.get(scene.forces[name].body)
            coordinates = (
                {f"{scene.forces[name].body}.{c}" for c in copied.coordinates} if copied else ()
            )
            return motion, coordinates, {*map(scene.rate_name, coordinates)}
        case "couplings", "limit":
            return (motion,)
    return ()


def check_formulas(scene: SceneFields, findings: Findings) -> None:
    """Check that formulas use only names that are defined at their place."""
    motion = _motion_names(scene)
    for loc, text in scene_formulas(scene):
        with findings:
            known, formula = _names_for(scene, loc, motion), parse(text)
            for node in names_in(formula.root):
                if node.name not in known:
                    # The error of a name that a formula cannot use gives the alternative.
                    reason, advice = _reason(scene, node.name, known, loc)
                    if advice:
                        raise DeclarationProblem(
                            f"{node.name!r}: {reason}", advice=advice, loc=loc, offset=node.offset
                        )
            check_names(formula, known, *loc)
            if _is_coefficient(loc):
                scene.controlled.check_coefficient(text, scene.parameters, *loc)
    for name in scene.contacts:
        with findings:
            _check_law(scene, name)


def _is_coefficient(loc: Loc) -> bool:
    return loc[0] == "contacts" and loc[2] in ("friction", "restitution")


def _check_law(scene: SceneFields, name: str) -> None:
    """Check that one region sets both coefficients, and that only the kinetic one has a side."""
    law, loc = scene.friction_of(name), ("contacts", name, "friction")
    if law is None or not law.splits:
        return
    scene.controlled.check_coefficient(law.both, scene.parameters, *loc)
    check_sides(law.kinetic, law.slips, loc)


def _reason(scene: SceneFields, name: str, known: Collection[str], loc: Loc) -> tuple[str, str]:
    """Return why a name is not allowed at a place, and the alternative; empty if it is."""
    if loc[0] == "joints" and loc[-1] in ("rod", "rope") and name in _changing_names(scene):
        advice = f"write a formula of {TIME}, or a rope, whose length may use controls"
        if loc[-1] == "rope":
            advice = f"write a formula of {TIME}, controls and variables of controllers"
        if scene.collisions:
            advice = "lead its end along a path, to: [x, y]"
        return f"the length of a {loc[-1]} does not follow it", advice
    if loc[0] == "forces" and loc[2] == "at" and name in {TIME, *_changing_names(scene)}:
        return (
            "the point of a force is fixed in its body",
            "let moment change instead, such as moment: v*time*F",
        )
    led = loc[0] in ("surfaces", "joints") and TIME in known
    if led and name in scene.controls and scene.collisions:
        return (
            "a control jumps, and a path must not",
            "write a variable of a region that has a flow",
        )
    if led and name in {*scene.controls, *scene.controlled.controller_state}:
        return (
            "controllers cannot move the joints and surfaces of a scene without collisions",
            f"write a formula of {TIME}, or give bodies shapes and declare collisions",
        )
    if name == SLIP and loc[0] == "collisions":
        return (
            "friction between bodies with shapes does not depend on the slip",
            "write {static: s, kinetic: k} with formulas of parameters",
        )
    owner, _, quantity = name.rpartition(".")
    if loc[0] in ("forces", "couplings") and owner and name in scene.quantity_names:
        law = _OF_FORCES.get(quantity, _CARRIED) if owner in scene.contacts else _CARRIED
        return law[0], law[1].format(owner)
    if name == INDEX and loc[-2:-1] == ("start",):
        return "it is the number of a copy", "add copies: N to the body"
    if name == INDEX and any(body.copies is not None for body in scene.bodies.values()):
        return (
            "copies differ only in their start",
            "declare bodies that differ in more than that one by one",
        )
    if TIME not in known and name in _changing_names(scene):
        switched = _is_coefficient(loc)
        advice = {"surfaces": _MOVED, "gravity": _PULLED}.get(str(loc[0]), _CONSTANT)
        why = "it changes during a run, and this value is constant"
        placed = loc[2:3] in (("position",), ("angle",))
        return why, _SWITCHED if switched else _LED if placed else advice
    return "", ""


def _changing_names(scene: SceneFields) -> Collection[str]:
    return scene.kinematic_names - {*scene.parameters} | scene.quantity_names | {*scene.controls}


class Limit(NamedTuple):
    """Bounds of the value of a formula, and the message for a value beyond them."""

    loc: Loc
    text: FormulaText
    least: float
    most: float
    words: str = "must be zero or positive, not {:g}"
    advice: str = ""
    shown: tuple[FormulaText, ...] = ()  # Formulas whose values the message gives, if not its own
    at: Mapping[str, float] = MappingProxyType({})  # Slip or time -> value where it is checked


_MAX_NUMBER = sys.float_info.max
# A float of this many radians is known to 1.5e-8.
_MAX_ANGLE = 1e8
_POSITIVE = math.ulp(0.0), _MAX_NUMBER, "must be positive, not {:g}"
_PART = 0.0, 1.0, "must be between 0 and 1, not {:g}"
# Beyond these masses energies are no floats, or the round-off of forces.
_MASSES = "must be between 1e-280 and 1e+300, not {:g}"
_LIGHT = 1e-280, _MAX_NUMBER, _MASSES, "take smaller units"
_HEAVY = 0.0, 1e300, _MASSES, "take larger units"
MAX_SIZE = 1e100
"""Beyond it the squares of lengths and rates overflow."""

# Beyond it the solid would be above: degrees instead of radians, or a ceiling, which needs a line.
_RIGHT_ANGLE = math.nextafter(math.pi / 2, math.inf)
_INCLINES = (
    -_RIGHT_ANGLE,
    _RIGHT_ANGLE,
    "an incline of {:g} is beyond a right angle",
    "angles are in radians: {:g}*pi/180; a ceiling is a line",
)


def limits(scene: SceneFields) -> Iterator[Limit]:
    """Yield the limits of masses, points, friction, restitution, radii, inclines and periods."""
    words = f"must be at most {MAX_SIZE:g} in size, not {{:g}}"
    for section, parts in (("contacts", scene.contacts), ("joints", scene.joints)):
        for name, part in parts.items():
            for axis, text in enumerate(part.point.at):
                at: Loc = (section, name, "point", "at", axis)
                yield Limit(at, text, -MAX_SIZE, MAX_SIZE, words, "take larger units")
    for name, region in scene.regions.items():
        for loc, period in periods_in(region, "regions", name):
            yield Limit(loc, period, *_POSITIVE[:2], PERIOD, PERIOD_ADVICE)
        if (count := region.count) is not None:
            words = f"the period of {name.rstrip(digits)} is {{:g}}"
            yield Limit(count.loc, count.period, *_POSITIVE[:2], words, WRAP_ADVICE)
    for name, body in scene.bodies.items():
        at = ("bodies", name)
        angle = body.start.get("angle", 0)
        if parse(angle).names <= scene.parameters.keys():
            words = f"must be at most {_MAX_ANGLE:g} rad in size, not {{:g}}"
            yield Limit(
                (*at, "start", "angle"), angle, -_MAX_ANGLE, _MAX_ANGLE, words,
                "floats of larger angles are too far apart; subtract whole turns",
            )  # fmt: skip
        if not body.prescribed:
            yield Limit((*at, "mass"), body.mass, *_POSITIVE)
            yield Limit((*at, "mass"), body.mass, *_LIGHT)
            yield Limit((*at, "mass"), body.mass, *_HEAVY)
        if body.inertia is not None:
            yield Limit((*at, "inertia"), body.inertia, 0.0, _MAX_NUMBER)
        for place, shape in enumerate(body.shape):
            if shape.disc is not None:
                several = (place,) if len(body.shape) > 1 else ()
                yield Limit((*at, "shape", *several, "disc"), shape.disc, *_POSITIVE)
    for name, surface in scene.surfaces.items():
        if surface.radius is not None:
            discs = [own.radius for own in scene.contacts.values() if own.surface == name]
            bounds, advice = _POSITIVE, ""
            if discs and not surface.hollow:
                advice = "a point cannot touch a corner (radius 0), a contact with a radius can"
                if None not in discs:
                    bounds, advice = (0.0, _MAX_NUMBER, "must be zero or positive, not {:g}"), ""
            rope = name.removesuffix(reach_of(""))
            at = ("surfaces", name, "radius") if rope == name else ("joints", rope, "rope")
            start = {TIME: 0.0} if TIME in parse(surface.radius).names else {}
            yield Limit(at, surface.radius, *bounds, advice, at=start)
        if surface.incline is not None:
            yield Limit(("surfaces", name, "incline"), surface.incline, *_INCLINES)
    for name, contact in scene.contacts.items():
        at, surface = ("contacts", name), scene.surfaces[contact.surface]
        if contact.radius is not None:
            yield Limit((*at, "radius"), contact.radius, *_POSITIVE)
            if surface.hollow:
                words = "a disc of radius {:g} does not roll in a circle of radius {:g}"
                advice, outer = "the circle has to be the larger one", surface.radius or 0
                yield _ascending((*at, "radius"), contact.radius, outer, words, advice)
    for section, laws in (("contacts", scene.contacts), ("collisions", scene.collisions)):
        for name, law in laws.items():
            yield from _friction_limits(scene, (section, name, "friction"), law.friction)
            if law.restitution is not None:
                yield Limit((section, name, "restitution"), law.restitution, *_PART)
            if law.stiffness is not None:
                yield Limit((section, name, "stiffness"), law.stiffness, *_POSITIVE)
            for key in ("damping", "rolling_resistance"):
                if (text := getattr(law, key)) is not None:
                    yield Limit((section, name, key), text, 0.0, _MAX_NUMBER)
    for name, joint in scene.joints.items():
        for key in ("rod", "rope"):
            text = getattr(joint, key)
            if text is not None and parse(text).names <= scene.parameters.keys():
                yield Limit(("joints", name, key), text, *_POSITIVE)
        if joint.restitution is not None:
            yield Limit(("joints", name, "restitution"), joint.restitution, *_PART)
        if joint.limits is not None:
            words = "the least angle, {:g}, is not below the greatest, {:g}"
            advice = "write limits: [least, greatest]"
            yield _ascending(("joints", name, "limits"), *joint.limits, words, advice)


def _ascending(loc: Loc, least: FormulaText, most: FormulaText, words: str, advice: str) -> Limit:
    return Limit(loc, f"({most}) - ({least})", *_POSITIVE[:2], words, advice, (least, most))


def _friction_limits(
    scene: SceneFields, loc: Loc, friction: FormulaText | Friction | None
) -> Iterator[Limit]:
    law = friction_law(friction, str(loc[1]), scene.parameters, scene.controls)
    if law is None:
        return
    for side in (1.0, -1.0) if law.varies else (1.0,):
        slips = dict.fromkeys(law.slips, side * AT_REST)
        if not isinstance(friction, Friction):
            yield Limit(loc, law.kinetic, 0.0, math.inf, at=slips)
            continue
        yield Limit((*loc, "static"), law.static, 0.0, math.inf, at=slips)
        yield Limit((*loc, "kinetic"), law.kinetic, 0.0, math.inf, at=slips)
        difference = f"({law.static}) - ({law.kinetic})"
        words = "the static coefficient {:g} is below the kinetic one at rest, {:g}"
        advice, shown = "exchange them, or write one number for both", (law.static, law.kinetic)
        yield Limit(loc, difference, 0.0, math.inf, words, advice, shown, slips)


def physical_checks(scene: SceneFields) -> Iterator[ValueCheck]:
    """Yield the checks of the `limits` of a scene, and of its polygons."""
    controlled = scene.controlled
    for _, found in groupby(limits(scene), key=lambda limit: limit.loc):
        of_place = (*found,)
        names = used_names(limit.text for limit in of_place)
        for region in {controlled.region_of(limit.text) for limit in of_place} - {None}:
            for state in controlled.flat[str(region)].states:
                names |= used_names(controlled.values(str(region), state).values())
        yield ValueCheck(names, partial(_check_limits, scene, of_place))
    for name, body in scene.bodies.items():
        for place, shape in enumerate(body.shape):
            if shape.polygon is not None:
                several = (place,) if len(body.shape) > 1 else ()
                at = ("bodies", name, "shape", *several, "polygon")
                names = used_names(chain(*shape.polygon))
                yield ValueCheck(names, partial(_check_corners, shape.polygon, at))


def finite_checks(scene: SceneFields) -> Iterator[ValueCheck]:
    """Yield the checks that formulas of parameters are finite, and that lines have two ends.

    Formulas with `limits` are finite within them.
    """
    limited = {(limit.loc, limit.text) for limit in limits(scene)}
    for loc, text in scene_formulas(scene):
        # A start that uses the number of a copy is checked with each copy's own number.
        if loc[2:3] == ("friction",) or not parse(text).names <= scene.parameters.keys():
            continue
        if (loc, text) not in limited:
            yield finite_check(text, *loc)
    for name, surface in scene.surfaces.items():
        for form in ("line", "edge"):
            if (ends := getattr(surface, form)) is not None:
                at = ("surfaces", name, form)
                yield ValueCheck(used_names(chain(*ends)), partial(_check_ends, ends, at))


def _check_limits(
    scene: SceneFields, of_place: Sequence[Limit], values: Mapping[str, float]
) -> None:
    """Check the limits at one place, in all states that set coefficients."""
    for loc, text, least, most, words, advice, shown, point in of_place:
        region = scene.controlled.region_of(text)
        known = {**values, **point}
        for state, state_values in scene.controlled.values_by_state(text, known, Formula.value):
            value = value_of(text, state_values, *loc)
            if least <= value <= most:
                continue
            if not math.isfinite(value) and not shown:
                words = "must be finite, not {:g}"
            place_text = f" in state {state!r} of {region!r}" if state else ""
            numbers = [value_of(formula, state_values, *loc) for formula in shown] or [value]
            raise DeclarationProblem(
                words.replace(",", place_text + ",", 1).format(*numbers),
                advice=advice.format(value),
                loc=loc,
            )


def _check_corners(
    polygon: Sequence[Sequence[FormulaText]], at: Loc, values: Mapping[str, float]
) -> None:
    corners = [(parse(x).value(values), parse(y).value(values)) for x, y in polygon]
    for number, axis in product(range(len(corners)), range(2)):
        if not math.isfinite(value := corners[number][axis]):
            raise DeclarationProblem(f"must be finite, not {value:g}", loc=(*at, number, axis))
    try:
        check_polygon(corners)
    except DeclarationProblem as problem:
        problem.loc = (*at, *problem.loc)
        raise


def _check_ends(
    ends: Sequence[Sequence[FormulaText]], at: Loc, values: Mapping[str, float]
) -> None:
    one, two = ([parse(text).value(values) for text in end] for end in ends)
    if one == two:
        raise DeclarationProblem(
            "its two points coincide", advice="give two points of the line that are apart", loc=at
        )


def check_rim(surface: Surface, loc: Loc) -> None:
    """Check that the contact of a disc with a surface has a closed form."""
    if surface.height is not None and "x" in parse(surface.height).names:
        raise DeclarationProblem(
            "a disc (a contact with a radius) cannot touch a height that depends on x",
            advice="write a slope as an incline or a line, a hill or a valley as a circle",
            loc=loc,
        )
    if surface.edge is not None:
        raise DeclarationProblem(
            "a disc (a contact with a radius) cannot touch an edge, which has ends",
            advice="declare a line, and for each end a circle of radius 0; enable each contact on "
            "its side of the end",
            loc=loc,
        )


_SURFACES = (
    "declare a surface and a contact for each smooth piece; for min, which is the lower one, add "
    "enabled: a relation that holds on its side"
)
_SMOOTH = "write a smooth formula: a velocity that jumps would be an impact without cause"


def check_kinks(scene: SceneFields) -> None:
    """Check that surfaces, paths and positions have the necessary derivatives.

    Forces, and what controllers set them to, are smooth as long as a state lasts; derivatives are
    not too large to be built.
    """
    constant = {*scene.parameters, *scene.controlled.controller_state, *scene.controls, INDEX}
    for loc, text in scene_formulas(scene):
        if loc[0] not in ("surfaces", "joints") and loc[2:3] not in (("position",), ("angle",)):
            continue
        known = _names_for(scene, loc, ())
        if variables := {name for name in parse(text).names - constant if name in known}:
            ground = loc[-1] == "height"
            advice, lacks = _SURFACES if ground else _SMOOTH, "slope, or no curvature,"
            check_smooth(text, variables, loc=loc, lacks=lacks, advice=advice, roots=ground)
            check_derived(parse(text).root, variables, loc)
    changing, texts = _force_formulas(scene)
    for loc, text in texts:
        # Guards of controllers are derived along the motion, twice.
        check_derived(parse(text).root, changing, loc, order=1)
        if loc[0] == "couplings":
            check_named_infinity(text, *loc, advice=_NEVER_SLIPS)
        check_named_infinity(text, *loc)
        if scene.collisions and has_switch(text, changing, ("sign",)):
            raise DeclarationProblem(
                "a force on a body with a shape cannot use sign: a time step would jump past zero",
                advice="declare a coupling for dry friction in a joint or against rotation, or "
                "write sat(v/e, -1, 1) with a small speed e",
                loc=loc,
            )


def has_switches(scene: SceneFields) -> bool:
    """Return whether forces, flows or controls have abs, sign, min, max or sat of variables."""
    changing, texts = _force_formulas(scene)
    controls = scene.controlled
    formulas = [text for _, text in texts]
    formulas += [text for _, _, text, _ in controls.declared_flows()]
    formulas += [text for _, _, _, text, _ in controls.sets()]
    changing = {*changing, TIME, *controls.controller_state}
    return any(has_switch(text, changing) for text in formulas)


def _force_formulas(scene: SceneFields) -> tuple[Collection[str], list[tuple[Loc, FormulaText]]]:
    """Return the names that change as the scene flows, and the formulas of its forces."""
    texts: list[tuple[Loc, FormulaText]] = []
    for name, force in scene.forces.items():
        texts += [(("forces", name, "force", i), text) for i, text in enumerate(force.force)]
        texts.append((("forces", name, "moment"), force.moment))
    texts += [(loc, text) for loc, text in scene_formulas(scene) if loc[0] == "couplings"]
    used = used_names(text for _, text in texts)
    changing = set(scene.kinematic_names - scene.parameters.keys())
    controls = scene.controlled
    values: dict[str, list[tuple[Loc, FormulaText]]] = {
        name: [(("controls", name), text)] for name, text in controls.declared.items()
    }
    for _, _, name, text, at in controls.sets():
        values.setdefault(name, []).append((at, text))
    for name in controls.order:
        if any(parse(text).names & changing for _, text in values[name]):
            changing.add(name)
    for name in reversed(controls.order):
        if name in used:
            texts += values[name]
            used |= used_names(text for _, text in values[name])
    return changing, texts


_Corner = tuple[float, float]
_Corners = Sequence[_Corner]

# Least angle at a corner of a polygon, and least distance of corners relative to its size, a
# thousand times the round-off of coordinates that are formulas.
_STRAIGHT = 1e-12
_WHAT = "a polygon is convex, its corners counter-clockwise"


def check_polygon(corners: _Corners) -> None:
    """Check that corners are those of a convex polygon, counter-clockwise.

    The place of the problem is the number of the corner that is wrong.
    """
    _check_places(corners)
    _check_crossings(corners)
    turns, area = _turn_sines(corners)
    if area < 0.0:
        raise DeclarationProblem(f"{_WHAT}; these are clockwise", advice="reverse their order")
    if all(turn > _STRAIGHT for turn in turns):
        return
    edge = next(k for k, turn in enumerate(turns) if not turn > _STRAIGHT)
    wrong = (edge + 1) % len(corners)
    how, advice = "lies on a straight edge", "leave it out"
    if turns[edge] < -_STRAIGHT:
        how, advice = "points inwards", _split(corners, wrong)
    raise DeclarationProblem(
        f"{_WHAT}; corner {wrong + 1}, at {_format_corner(corners[wrong])}, {how}",
        advice=advice,
        loc=(wrong,),
    )


def _check_places(corners: _Corners) -> None:
    """Check that corners are apart, and not all on one line."""
    # Those farthest from each other have the line between them that all others might lie on.
    a, b = max(combinations(corners, 2), key=lambda pair: math.dist(*pair))
    size = math.dist(a, b)
    if size == 0.0:
        raise DeclarationProblem(
            f"all corners are at {_format_corner(a)}: a polygon has an area",
            advice="place them around it, or write disc: RADIUS",
        )
    if all(abs(_cross(a, b, corner)) / size <= _STRAIGHT * size for corner in corners):
        raise DeclarationProblem(
            f"all corners lie on the line from {_format_corner(a)} to {_format_corner(b)}: "
            "a polygon has an area",
            advice="give it a width; a thin bar is polygon: [[-a, -b], [a, -b], [a, b], [-a, b]]",
        )
    for (i, one), (k, other) in combinations(enumerate(corners), 2):
        if math.dist(one, other) <= _STRAIGHT * size:
            raise DeclarationProblem(
                f"corners {i + 1} and {k + 1} are in one place, {_format_corner(one)}",
                advice="leave one of them out",
                loc=(k,),
            )


def _check_crossings(corners: _Corners) -> None:
    edges = list(zip(corners, [*corners[1:], corners[0]], strict=True))
    for i, j in combinations(range(len(edges)), 2):
        (a, b), (c, d) = edges[i], edges[j]
        if _cross(a, b, c) * _cross(a, b, d) < 0.0 and _cross(c, d, a) * _cross(c, d, b) < 0.0:
            raise DeclarationProblem(
                f"{_WHAT}; the edge from corner {i + 1} to {i + 2} crosses that from corner "
                f"{j + 1} to {(j + 1) % len(corners) + 1}",
                advice=_convex_order(corners),
                loc=(j,),
            )


def _convex_order(corners: _Corners) -> str:
    """Return advice on the order in which corners make a convex polygon, if one exists."""
    x, y = (sum(values) / len(corners) for values in zip(*corners, strict=True))
    around = sorted(
        range(len(corners)), key=lambda k: math.atan2(corners[k][1] - y, corners[k][0] - x)
    )
    first = around.index(0)
    around = [*around[first:], *around[:first]]
    if min(_turn_sines([corners[k] for k in around])[0]) > _STRAIGHT:
        return f"list them in the order {', '.join(str(k + 1) for k in around)}"
    return "list corners in their order around it"


def _turn_sines(corners: _Corners) -> tuple[list[float], float]:
    """Return the sines of a polygon's turns to the left after its edges, and its area."""
    following = [*corners[1:], corners[0]]
    edges = [(b[0] - a[0], b[1] - a[1]) for a, b in zip(corners, following, strict=True)]
    turns = [
        (x * v - y * u) / (math.hypot(x, y) * math.hypot(u, v))
        for (x, y), (u, v) in zip(edges, [*edges[1:], edges[0]], strict=True)
    ]
    area = 0.5 * sum(_cross(corners[0], a, b) for a, b in pairwise(corners))
    return turns, area


def _cross(origin: _Corner, first: _Corner, second: _Corner) -> float:
    """Return twice the area of a triangle, above 0 where it is counter-clockwise."""
    (x, y), (a, b), (c, d) = origin, first, second
    return (a - x) * (d - y) - (b - y) * (c - x)


def _split(corners: _Corners, inward: int) -> str:
    """Return how to split a polygon at a corner that points inwards."""
    count = len(corners)
    order = [(inward + step) % count for step in range(count)]
    for step in range(2, count - 1):
        halves = order[: step + 1], [*order[step:], inward]
        if all(min(_turn_sines([corners[k] for k in half])[0]) > _STRAIGHT for half in halves):
            first, second = (", ".join(str(k + 1) for k in half) for half in halves)
            return (
                f"split it from there to corner {order[step] + 1}: shape: [{{polygon: corners "
                f"{first}}}, {{polygon: corners {second}}}]"
            )
    return "split it there into convex ones: shape: [{polygon: [...]}, {polygon: [...]}]"


def _format_corner(corner: _Corner) -> str:
    x, y = (value + 0.0 for value in corner)  # no negative zero
    return f"({x:.6g}, {y:.6g})"


def check_turns(scene: SceneFields) -> None:
    """Check that bodies whose relative angle a joint holds or limits have an angle."""
    for name, joint in scene.joints.items():
        key = "angle" if joint.angle is not None else "limits"
        for end in joint.ends.values() if getattr(joint, key) is not None else ():
            body = scene.single_body(end.body)
            if body and body.inertia is None and not body.prescribed:
                raise DeclarationProblem(
                    f"{end.body!r} is a particle, which has no angle",
                    advice=f"give it an inertia, or remove {key}",
                    key=("joints", name, key),
                )


def check_copies(scene: SceneFields) -> None:
    """Check the requirements of copies of bodies."""
    if INDEX in scene.parameters and any(b.copies is not None for b in scene.bodies.values()):
        raise DeclarationProblem(f"{INDEX!r} is the number of a copy", key=("parameters", INDEX))
    for name, body in scene.bodies.items():
        if body.copies is None:
            continue
        clashes = [n for n in scene.bodies if n.startswith(name) and n[len(name) :].isdecimal()]
        if clashes:
            raise DeclarationProblem(
                f"{clashes[0]!r} is the name of a copy of {name!r}",
                advice="choose another name",
                key=("bodies", clashes[0]),
            )
        if not scene.collisions:
            raise DeclarationProblem(
                "copies of a body need collisions that they take part in",
                advice="declare collisions, or each body by itself",
                key=("bodies", name, "copies"),
            )


def check_coupled(scene: SceneFields, name: str) -> None:
    """Check that the bodies of a coupling can turn, and that its limit is determined."""
    coupling = scene.couplings[name]
    if coupling.joint is not None and coupling.joint not in scene.joints:
        return
    if scene.along_guide(name):
        return
    moves = False
    for place, body in enumerate(scene.coupled(name)):
        declared = scene.single_body(body)
        loc = ("bodies", place) if coupling.bodies is not None else ("joint",)
        if declared is None:
            return
        moves = moves or not declared.prescribed
        if declared.fixed:
            raise DeclarationProblem(
                f"body {body!r} is fixed, as the world is",
                advice="name the other body alone, bodies: [wheel]",
                loc=("couplings", name, *loc),
            )
        if declared.inertia is None and declared.angle is None:
            raise DeclarationProblem(
                f"body {body!r} does not turn: it has no inertia and no angle",
                advice="give it an inertia, or name a body that turns",
                loc=("couplings", name, *loc),
            )
    if not moves:
        raise DeclarationProblem(
            "its bodies turn as prescribed, and no couple changes that",
            advice="name a body with an inertia",
            key=("couplings", name),
        )


def check_collisions(scene: SceneFields) -> None:
    """Check the requirements of collisions."""
    if not scene.collisions:
        return
    for contact in scene.contacts.values():
        x, y = contact.point.at
        raise DeclarationProblem(
            "a scene with collisions has no contacts yet",
            advice=f"bodies touch by their shapes: give {contact.point.body!r} a disc as a foot, "
            f"{{disc: {contact.radius or 0.01}, at: [{x}, {y}]}}, and list it with "
            f"{contact.surface!r} in collisions",
            key=("contacts",),
        )
    if scene.initial_modes:
        raise DeclarationProblem(
            "a scene with collisions has no modes yet",
            advice="remove it: bodies start in the modes of what they touch",
            key=("modes",),
        )
    for name, joint in scene.joints.items():
        if joint.rope is not None and joint.enabled:
            raise DeclarationProblem(
                "a rope of bodies that collide is never off",
                advice="remove enabled, or let a joint with rod hold the distance",
                key=("joints", name, "enabled"),
            )
    _check_controller_state(scene)
    _check_joint_ends(scene)
    for name, body in scene.bodies.items():
        if not (body.prescribed or body.linked) and body.inertia is None:
            raise DeclarationProblem(
                "a free body that collides needs an inertia",
                advice="write inertia: m*r**2/2 of a disc, m*(width**2 + height**2)/12 of a box; "
                "or place it by coordinates, or lead it along a path without a mass",
                loc=("bodies", name),
            )
        if body.linked and body.copies is not None:
            raise DeclarationProblem(
                "copies of a body that coordinates place would all be in one place",
                advice="declare each body by itself",
                key=("bodies", name, "copies"),
            )
    _check_paths(scene)
    if all(body.prescribed for body in scene.bodies.values()):
        raise DeclarationProblem(
            "all bodies are fixed or led, and nothing moves by itself",
            advice="declare a body with a mass, an inertia and a shape",
            key=("bodies",),
        )
    for name, collision in scene.collisions.items():
        at = ("collisions", name)
        for place, name_of in enumerate(collision.bodies):
            check_member("body", name_of, scene.bodies, *at, "bodies", place)
            if not scene.bodies[name_of].shape:
                raise DeclarationProblem(
                    f"body {name_of!r} has no shape",
                    advice="give it a polygon or a disc",
                    key=("bodies", name_of),
                )
        discs = (s.disc for name_of in collision.bodies for s in scene.bodies[name_of].shape)
        if collision.rolling_resistance is not None and not any(discs):
            raise DeclarationProblem(
                "rolling resistance is of a disc that rolls, and no body has a disc",
                advice="list a body with shape: {disc: r}, or remove it",
                key=(*at, "rolling_resistance"),
            )
        for place, name_of in enumerate(collision.surfaces):
            check_member("surface", name_of, scene.surfaces, *at, "surfaces", place)


def _check_paths(scene: SceneFields) -> None:
    """Check that paths of fixed and led bodies are prescribed, and that no force acts on them."""
    moving, owners = _moving_names(scene), scene.owners()
    led = {name: body.path for name, body in scene.bodies.items() if body.prescribed}
    for name, path in led.items():
        for key, text in zip(("position", "position", "angle"), path, strict=True):
            for control in parse(text).names.intersection(scene.controls):
                if dependent := used_names(scene.controlled.texts(control)) & moving:
                    raise DeclarationProblem(
                        f"the path uses {control!r}, which depends on {min(dependent)!r}, "
                        "on how bodies move",
                        advice="let it depend on time, controls and variables; a force follows "
                        "bodies",
                        loc=("bodies", name, key),
                    )
    for force, declared in scene.forces.items():
        name = owners.get(declared.body, declared.body)
        if name in led:
            raise DeclarationProblem(
                f"{_described(scene, name)}, and no force moves it",
                advice="remove the force, or give the body a mass and no path",
                loc=("forces", force, "body"),
            )


def _described(scene: SceneFields, body: str) -> str:
    return f"{body!r} {'is fixed' if scene.bodies[body].fixed else 'moves as prescribed'}"


def _check_joint_ends(scene: SceneFields) -> None:
    """Check that joints hold free bodies, to each other or to fixed and led ones."""
    owners = scene.owners()
    for name, joint in scene.joints.items():
        for key, end in joint.ends.items():
            owner, loc = owners[end.body], ("joints", name, key, "body")
            if scene.bodies[owner].linked:
                raise DeclarationProblem(
                    "coordinates place this body, and joints of a scene with collisions hold free "
                    "bodies",
                    advice="place the other body by coordinates, too, as the joint holds it",
                    loc=loc,
                )
            if scene.bodies[owner].prescribed and key == "point":
                raise DeclarationProblem(
                    f"{_described(scene, owner)}, and the point of a joint is on a body that moves "
                    "by itself",
                    advice="name a body with a mass in point, and this one in "
                    f"to: {{body: {end.body}, at: [0, 0]}}",
                    loc=loc,
                )


def _moving_names(scene: SceneFields) -> set[str]:
    return {*scene.variables, *map(scene.rate_name, scene.variables)}


def check_led_surfaces(scene: SceneFields, findings: Findings) -> None:
    """Check that the motion of surfaces within a state depends on time and itself only."""
    leading, constant = scene.leading, {*scene.parameters}
    texts: list[tuple[Loc, FormulaText]] = [(("controls", n), t) for n, t in scene.controls.items()]
    texts += [(loc, text) for _, _, _, text, loc in scene.controlled.sets()]
    texts += [(loc, text) for _, _, text, loc in scene.controlled.declared_flows()]
    for loc, text in texts:
        allowed = constant | ({TIME, *leading} if "flows" in loc else set())
        with findings:
            if loc[-1] in leading and (forbidden := parse(text).names - allowed):
                raise DeclarationProblem(
                    f"{loc[-1]!r} moves a surface, and depends on {min(forbidden)!r}",
                    advice="set a control that moves a surface to a formula of parameters, and let "
                    "a variable flow by time, parameters and variables",
                    loc=loc,
                )


def check_prescribed(scene: SceneFields, findings: Findings) -> None:
    """Check that fixed and led bodies are in a scene with collisions."""
    if scene.collisions:
        return
    for name, body in scene.bodies.items():
        with findings:
            if body.fixed:
                raise DeclarationProblem(
                    "a fixed body takes part in collisions, and the scene has none",
                    advice="declare collisions; what points touch is a surface: "
                    "surfaces: {wall: {line: [[1, 0], [1, 1]]}}",
                    key=("bodies", name, "fixed"),
                )
            if body.prescribed:
                raise DeclarationProblem(
                    "a body needs a mass",
                    advice="write mass: 1; a body without one is led along its position in a "
                    "scene with collisions",
                    loc=("bodies", name),
                )


def _check_controller_state(scene: SceneFields) -> None:
    """Check that variables of controllers do not depend on the motion of bodies."""
    moving = _moving_names(scene)
    dependent = {n for n in scene.controls if used_names(scene.controlled.texts(n)) & moving}
    for _, variable, text, loc in scene.controlled.declared_flows():
        if used := parse(text).names & (moving | dependent):
            raise DeclarationProblem(
                f"the flow of {variable!r} depends on {min(used)!r}, on how bodies move: "
                "in a scene with collisions it may not",
                advice="let it depend on time, controls and variables",
                loc=loc,
            )
