"""Checks of a scene: numbers physical, formulas smooth, shapes convex, names in their places."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import combinations, pairwise

from contacts.scene.fields import SceneFields
from contacts.scene.joints import Path
from contacts.scene.parts import Point, Surface
from contacts.scene.shapes import INDEX, Shape
from statechart.documents.declaration import TIME
from statechart.documents.document import Loc
from statechart.documents.fields import FormulaText, check_named_infinity, check_names, value_of
from statechart.errors import DeclarationProblem, Findings, close_matches
from statechart.formulas.derivatives import PIECES, check_derived, check_smooth
from statechart.formulas.formula import Formula, parse
from statechart.formulas.tree import names_in

_OF_CONTACTS = ("gap", "slip", "V", "H")

# What to write in the place of what changes.
_MOVED = "a surface that moves has a displacement, or a turn; a hill is a height, a formula of x"
_SWITCHED = (
    "it is constant as long as a state lasts: write a control, which states of a region set, with "
    "transitions where it changes (guard: abs(tip.slip) >= v)"
)
_PULLED = "write a force on the body, or let the ground move"
_CONSTANT = "write a formula of parameters"


def check_misplaced_names(
    scene: SceneFields, formula: Formula, known: Collection[str], *loc: str | int
) -> None:
    """Refuse names that a formula cannot use where it stands, with what stands in for them.

    Raises
    ------
    DeclarationProblem
        At a control, what a controller remembers, the number of a copy, or what changes along a
        run where nothing does.
    """
    for node in names_in(formula.root):
        if node.name in known:
            continue
        what, advice = _reason(scene, node.name, known, loc)
        if advice:
            raise DeclarationProblem(
                f"{node.name!r}: {what}", advice=advice, loc=loc, offset=node.offset
            )


def _reason(scene: SceneFields, name: str, known: Collection[str], loc: Loc) -> tuple[str, str]:
    """Return why a name cannot stand in a place, and what to write; nothing for any other."""
    led = loc[0] in ("surfaces", "joints") and TIME in known
    if led and name in scene.controls and scene.collisions:
        return (
            "a control changes at an instant, and moves nothing",
            "let a variable of a region flow, and write that",
        )
    if led and name in {*scene.controls, *scene.controlled.memory}:
        return (
            "controllers move no surface, and no joint, of what touches by points",
            f"write a formula of {TIME}, or give bodies shapes, and collisions",
        )
    if name == INDEX and loc[-2:-1] == ("start",):
        return "it is the number of a copy", "say how many there are, beside start: copies: N"
    if name == INDEX and any(body.copies is not None for body in scene.bodies.values()):
        return (
            "copies are alike but for their start",
            "declare bodies that differ in more one by one",
        )
    if TIME not in known and name in _changing(scene):
        switched = loc[0] == "contacts" and loc[-1] in ("friction", "restitution")
        advice = {"surfaces": _MOVED, "gravity": _PULLED}.get(str(loc[0]), _CONSTANT)
        return "it changes along a run, and this does not", _SWITCHED if switched else advice
    return "", ""


def _changing(scene: SceneFields) -> Collection[str]:
    """Return what changes along a run."""
    found = {f"{contact}.{quantity}" for contact in scene.contacts for quantity in _OF_CONTACTS}
    found |= {f"{name}.{force}" for name, one in scene.joints.items() for force in one.components}
    return {*(scene.kinematic_names - {*scene.parameters}), *found, *scene.controls, "energy"}


def check_physical(scene: SceneFields, values: Mapping[str, float]) -> None:
    """Check masses, inertias, friction, restitution, radii and inclines.

    Raises
    ------
    DeclarationProblem
        At the first that is out of its bounds.
    """
    found = Findings()
    for name, body in scene.bodies.items():
        with found:
            at = ("bodies", name, "mass")
            _bounded(values, body.mass, at, "positive", positive=True)
            _weighed(values, body.mass, at)
        with found:
            if body.inertia is not None:
                _bounded(values, body.inertia, ("bodies", name, "inertia"), "zero or positive")
    for name, surface in scene.surfaces.items():
        with found:
            if surface.radius is not None:
                at = ("surfaces", name, "radius")
                _bounded(values, surface.radius, at, "positive", positive=True)
        with found:
            if surface.incline is not None:
                _within_right_angle(values, surface.incline, ("surfaces", name, "incline"))
    for name, contact in scene.contacts.items():
        with found:
            if contact.radius is not None:
                _within_its_circle(scene, values, name)
        for key, words, most in (
            ("friction", "zero or positive", math.inf),
            ("restitution", "between 0 and 1", 1.0),
        ):
            text: FormulaText | None = getattr(contact, key)
            if text is None:
                continue
            region = scene.controlled.region_of(text)
            for state, seen in scene.controlled.seen_in_states(text, values, Formula.value):
                where = f" in state {state!r} of {region!r}" if state else ""
                at, infinite = ("contacts", name, key), key == "friction"
                with found:
                    _bounded(seen, text, at, words + where, most=most, infinite=infinite)
    found.check()


def physical_limits(scene: SceneFields) -> list[tuple[FormulaText, float, float]] | None:
    """Return what `check_physical` looks at, each with bounds between which it is surely right.

    None where states of controllers set some of it.
    """
    most = sys.float_info.max
    found: list[tuple[FormulaText, float, float]] = []
    for body in scene.bodies.values():
        found.append((body.mass, *_MASSES))
        found += [(body.inertia, 0.0, most)] if body.inertia is not None else []
    for surface in scene.surfaces.values():
        found += [(surface.radius, math.ulp(0.0), most)] if surface.radius is not None else []
        found += [(surface.incline, -1.5, 1.5)] if surface.incline is not None else []
    for contact in scene.contacts.values():
        surface = scene.surfaces[contact.surface]
        if contact.radius is not None:
            found.append((contact.radius, math.ulp(0.0), most))
        if contact.radius is not None and surface.hollow:
            found.append((f"({surface.radius}) - ({contact.radius})", math.ulp(0.0), most))
        for text, last in ((contact.friction, math.inf), (contact.restitution, 1.0)):
            if scene.controlled.region_of(text) is not None:
                return None
            found += [(text, 0.0, last)] if text is not None else []
    return found


def check_finite(scene: SceneFields, values: Mapping[str, float]) -> None:
    """Check that places, gravity and the initial state are finite, and that lines have two ends.

    Raises
    ------
    DeclarationProblem
        At the first formula that has no finite value.
    """
    for loc, text in _places(scene):
        if not parse(text).names <= values.keys():
            # A start that uses the number of a copy.
            continue
        value = value_of(text, values, *loc)
        if math.isinf(value):
            raise DeclarationProblem(f"must be finite, not {value:g}", loc=loc)
    for name, surface in scene.surfaces.items():
        for form in ("line", "edge"):
            ends = getattr(surface, form)
            if ends is not None:
                one, two = ([parse(text).value(values) for text in end] for end in ends)
                if one == two:
                    raise DeclarationProblem(
                        "its two points are one",
                        advice="give two points of the line that are apart",
                        loc=("surfaces", name, form),
                    )


def _pair(texts: Sequence[FormulaText], *loc: str | int) -> Iterator[tuple[Loc, FormulaText]]:
    yield from (((*loc, index), text) for index, text in enumerate(texts))


def _places(scene: SceneFields) -> Iterator[tuple[Loc, FormulaText]]:
    """Yield the formulas of parameters alone, and where they stand."""
    if isinstance(scene.gravity, tuple):
        yield from _pair(scene.gravity, "gravity")
    else:
        yield ("gravity",), scene.gravity
    for name, coordinate in scene.coordinates.items():
        yield ("coordinates", name, "start"), coordinate.start
        yield ("coordinates", name, "rate"), coordinate.rate
    for name, body in scene.bodies.items():
        for key, text in body.start.items():
            yield ("bodies", name, "start", key), text
    for name, surface in scene.surfaces.items():
        at = ("surfaces", name)
        if surface.incline is not None:
            yield (*at, "incline"), surface.incline
            yield from _pair(surface.through, *at, "through")
        for form in ("line", "edge"):
            for index, end in enumerate(getattr(surface, form) or ()):
                yield from _pair(end, *at, form, index)
        yield from _pair(surface.circle or (), *at, "circle")
    for name, contact in scene.contacts.items():
        yield from _pair(contact.point.at, "contacts", name, "point", "at")
        if contact.radius is not None:
            yield ("contacts", name, "radius"), contact.radius
    for name, joint in scene.joints.items():
        yield from _pair(joint.point.at, "joints", name, "point", "at")
        if isinstance(joint.to, Point):
            yield from _pair(joint.to.at, "joints", name, "to", "at")
    for name, force in scene.forces.items():
        yield from _pair(force.at, "forces", name, "at")


def check_rim(surface: Surface, loc: Loc) -> None:
    """Check that a disc touches a surface where there is a formula for it.

    Raises
    ------
    DeclarationProblem
        Where it does not.
    """
    if surface.height is not None and "x" in parse(surface.height).names:
        raise DeclarationProblem(
            "where a disc touches a height that depends on x there is no formula for",
            advice="a slope is an incline, or a line; a hill or a valley a circle",
            loc=loc,
        )
    if surface.edge is not None:
        raise DeclarationProblem(
            "a disc touches the ends of an edge too",
            advice="declare a line and for each end a small circle, each contact enabled on its "
            "side of the end",
            loc=loc,
        )


def _within_its_circle(scene: SceneFields, values: Mapping[str, float], name: str) -> None:
    contact = scene.contacts[name]
    assert contact.radius is not None
    at = ("contacts", name, "radius")
    _bounded(values, contact.radius, at, "positive", positive=True)
    surface = scene.surfaces[contact.surface]
    if surface.hollow and surface.radius is not None:
        disc, circle = (value_of(text, values, *at) for text in (contact.radius, surface.radius))
        if not disc < circle:
            raise DeclarationProblem(
                f"a disc of radius {disc:g} does not roll in a circle of radius {circle:g}",
                advice="the circle has to be the larger one",
                loc=at,
            )


def _within_right_angle(
    values: Mapping[str, float], text: FormulaText, loc: tuple[str, ...]
) -> None:
    value = value_of(text, values, *loc)
    # Beyond it the solid would be above; what is meant are degrees, or a line for a ceiling.
    if abs(value) > math.nextafter(math.pi / 2, math.inf):
        raise DeclarationProblem(
            f"an incline of {value:g} is beyond a right angle",
            advice=f"angles are in radians: {value:g}*pi/180; a ceiling is a line",
            loc=loc,
        )


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
    value = value_of(text, values, *loc)
    within = 0.0 <= value <= most and not (positive and value == 0.0)
    if not within or (math.isinf(value) and not infinite):
        words = words if math.isfinite(value) else "finite"
        raise DeclarationProblem(f"must be {words}, not {value:g}", loc=loc)


# Beyond these energies are no floats, or the round-off of forces.
_MASSES = (1e-280, 1e300)


def _weighed(values: Mapping[str, float], text: FormulaText, loc: tuple[str, ...]) -> None:
    value, (least, most) = value_of(text, values, *loc), _MASSES
    if not least <= value <= most:
        raise DeclarationProblem(
            f"must be between {least:g} and {most:g}, not {value:g}",
            advice=f"take {'larger' if value > most else 'smaller'} units",
            loc=loc,
        )


_SURFACES = (
    "declare a surface and a contact for each smooth piece: that is all for the higher of them "
    "(max, abs); for the lower (min) each with enabled: a relation that holds on its side"
)
_SMOOTH = "a velocity that jumps takes an impact without cause: write a smooth formula"

Text = str | int | float


def check_kinks(scene: SceneFields) -> None:
    """Check that surfaces, paths and positions have the derivatives that are taken of them.

    Forces, and what controllers set them to, are smooth as long as a state lasts; derivatives are
    not too large to be built.

    Raises
    ------
    DeclarationProblem
        At the first that has not.
    """
    for loc, text, variables in _differentiated(scene):
        ground = loc[-1] == "height"
        advice, lacks = _SURFACES if ground else _SMOOTH, "slope, or no curvature,"
        check_smooth(text, variables, loc=loc, lacks=lacks, advice=advice, roots=ground)
        check_derived(parse(text).root, variables, loc)
    changing, texts = _forces(scene)
    for loc, text in texts:
        # Guards of controllers are derived along the motion, twice.
        check_derived(parse(text).root, changing, loc, order=1)
        check_named_infinity(text, *loc)
        check_smooth(text, changing, loc=loc, lacks="derivative, or no value,", advice=PIECES)


def _forces(scene: SceneFields) -> tuple[Collection[str], list[tuple[Loc, Text]]]:
    """Return the names that change as the scene flows, and the formulas of its forces."""
    found: list[tuple[Loc, Text]] = []
    for name, force in scene.forces.items():
        found += [(("forces", name, "force", i), text) for i, text in enumerate(force.force)]
        found.append((("forces", name, "moment"), force.moment))
    used = set[str]().union(*(parse(text).names for _, text in found))
    changing = set(scene.kinematic_names - scene.parameters.keys())
    controls = scene.controlled
    values: dict[str, list[tuple[Loc, Text]]] = {
        name: [(("controls", name), text)] for name, text in controls.declared.items()
    }
    for _, _, name, text, at in controls.sets():
        values.setdefault(name, []).append((at, text))
    for name in controls.order:
        if any(parse(text).names & changing for _, text in values[name]):
            changing.add(name)
    for name in reversed(controls.order):
        if name in used:
            found += values[name]
            used = used.union(*(parse(text).names for _, text in values[name]))
    return changing, found


def _differentiated(
    scene: SceneFields,
) -> Iterator[tuple[Loc, Text, Collection[str]]]:
    """Yield where a formula stands, it, and the names that it is differentiated by."""
    for name, surface in scene.surfaces.items():
        if surface.height is not None:
            yield ("surfaces", name, "height"), surface.height, ("x",)
        for place, text in enumerate(surface.displacement):
            yield ("surfaces", name, "displacement", place), text, (TIME,)
        yield ("surfaces", name, "turn"), surface.turn, (TIME,)
    for name, joint in scene.joints.items():
        if isinstance(joint.to, Path):
            for place, axis in enumerate(("x", "y")):
                yield ("joints", name, "to", place, axis), getattr(joint.to, axis) or 0, (TIME,)
    for name, body in scene.bodies.items():
        for place, text in enumerate(body.position or ()):
            yield ("bodies", name, "position", place), text, scene.coordinates
        yield ("bodies", name, "angle"), body.angle or 0, scene.coordinates


_Corner = tuple[float, float]
_Corners = Sequence[_Corner]

# A polygon turns at a corner by more than this angle; what is nearer than this part of its size is
# in one place: what rounding leaves of coordinates that are formulas is a thousandth of it.
_STRAIGHT = 1e-12
_WHAT = "a polygon is convex, its corners counter-clockwise"


def check_polygon(corners: _Corners) -> None:
    """Check that corners are those of a convex polygon, counter-clockwise.

    Raises
    ------
    DeclarationProblem
        With the number of the corner as its place, where one is wrong.
    """
    _check_places(corners)
    _check_crossings(corners)
    turns, area = _turns(corners)
    if area < 0.0:
        raise DeclarationProblem(f"{_WHAT}; these are clockwise", advice="reverse their order")
    if all(turn > _STRAIGHT for turn in turns):
        return
    wrong = ([turn > _STRAIGHT for turn in turns].index(False) + 1) % len(corners)
    how, advice = "lies on a straight edge", "leave it out"
    if turns[wrong - 1] < -_STRAIGHT:
        how, advice = "points inwards", _split(corners, wrong)
    raise DeclarationProblem(
        f"{_WHAT}; corner {wrong + 1}, at {_place(corners[wrong])}, {how}",
        advice=advice,
        loc=(wrong,),
    )


def _check_places(corners: _Corners) -> None:
    """Check that corners are apart, and not all on one line."""
    size = max(math.dist(one, other) for one, other in combinations(corners, 2))
    apart: list[_Corner] = []
    twice: tuple[int, int] | None = None
    for k, corner in enumerate(corners):
        same = [
            i for i, one in enumerate(corners[:k]) if math.dist(one, corner) <= _STRAIGHT * size
        ]
        if not same:
            apart.append(corner)
        elif twice is None:
            twice = same[0], k
    if len(apart) < 2:
        raise DeclarationProblem(
            f"all corners are at {_place(corners[0])}: a polygon has an area",
            advice="place them around it, or write disc: RADIUS",
        )
    # Those farthest from each other have the line between them that all others might lie on.
    a, b = max(combinations(apart, 2), key=lambda pair: math.dist(*pair))
    away = [_cross(a, b, corner) / math.dist(a, b) for corner in apart]
    if max(map(abs, away)) <= _STRAIGHT * size:
        raise DeclarationProblem(
            f"all corners lie on the line from {_place(a)} to {_place(b)}: a polygon has an area",
            advice="give it a width; a thin bar is polygon: [[-a, -b], [a, -b], [a, b], [-a, b]]",
        )
    if twice is not None:
        one, other = twice
        raise DeclarationProblem(
            f"corners {one + 1} and {other + 1} are in one place, {_place(corners[one])}",
            advice="leave one of them out",
            loc=(other,),
        )


def _check_crossings(corners: _Corners) -> None:
    """Check that no edges cross."""
    edges = list(zip(corners, [*corners[1:], corners[0]], strict=True))
    for i, j in combinations(range(len(edges)), 2):
        (a, b), (c, d) = edges[i], edges[j]
        if _cross(a, b, c) * _cross(a, b, d) < 0.0 and _cross(c, d, a) * _cross(c, d, b) < 0.0:
            raise DeclarationProblem(
                f"{_WHAT}; the edge from corner {i + 1} to {i + 2} crosses that from corner "
                f"{j + 1} to {(j + 1) % len(corners) + 1}",
                advice=_ordered(corners),
                loc=(j,),
            )


def _ordered(corners: _Corners) -> str:
    """Return in which order corners make a convex polygon; that there is one, if not which."""
    x, y = (sum(values) / len(corners) for values in zip(*corners, strict=True))
    around = sorted(
        range(len(corners)), key=lambda k: math.atan2(corners[k][1] - y, corners[k][0] - x)
    )
    first = around.index(0)
    around = [*around[first:], *around[:first]]
    if min(_turns([corners[k] for k in around])[0]) > _STRAIGHT:
        return f"list them in the order {', '.join(str(k + 1) for k in around)}"
    return "list corners in their order around it"


def _turns(corners: _Corners) -> tuple[list[float], float]:
    """Return the sines of a polygon's turns to the left after its edges, and its area."""
    following = [*corners[1:], corners[0]]
    edges = [(b[0] - a[0], b[1] - a[1]) for a, b in zip(corners, following, strict=True)]
    turns = [
        (x * v - y * u) / (math.hypot(x, y) * math.hypot(u, v))
        for (x, y), (u, v) in zip(edges, [*edges[1:], edges[0]], strict=True)
    ]
    area = 0.5 * sum(_cross(corners[0], a, b) for a, b in pairwise(corners))
    return turns, area


def _cross(origin: _Corner, one: _Corner, other: _Corner) -> float:
    """Return twice the area of a triangle, above 0 where it is counter-clockwise."""
    (x, y), (a, b), (c, d) = origin, one, other
    return (a - x) * (d - y) - (b - y) * (c - x)


def _split(corners: _Corners, inward: int) -> str:
    """Return how to split a polygon at a corner that points inwards."""
    count = len(corners)
    order = [(inward + step) % count for step in range(count)]
    for step in range(2, count - 1):
        halves = order[: step + 1], [*order[step:], inward]
        if all(min(_turns([corners[k] for k in half])[0]) > _STRAIGHT for half in halves):
            first, second = (", ".join(str(k + 1) for k in half) for half in halves)
            return (
                f"split it from there to corner {order[step] + 1}: shape: [{{polygon: corners "
                f"{first}}}, {{polygon: corners {second}}}]"
            )
    return "split it there into convex ones: shape: [{polygon: [...]}, {polygon: [...]}]"


def _place(corner: _Corner) -> str:
    x, y = (value + 0.0 for value in corner)  # no negative zero
    return f"({x:.6g}, {y:.6g})"


def check_copies(scene: SceneFields) -> None:
    """Check what copies of bodies need.

    Raises
    ------
    DeclarationProblem
        At the first thing that is missing.
    """
    if INDEX in scene.parameters and any(b.copies is not None for b in scene.bodies.values()):
        raise DeclarationProblem(
            f"{INDEX!r} is the number of a copy", loc=("parameters", INDEX), key=True
        )
    for name, body in scene.bodies.items():
        if body.copies is None:
            continue
        check_names(parse(body.copies), scene.parameters, "bodies", name, "copies")
        taken = [n for n in scene.bodies if n.startswith(name) and n[len(name) :].isdecimal()]
        if taken:
            raise DeclarationProblem(
                f"{taken[0]!r} is the name of a copy of {name!r}",
                advice="choose another name",
                loc=("bodies", taken[0]),
                key=True,
            )
        if not scene.collisions:
            raise DeclarationProblem(
                "copies of a body need collisions that they take part in",
                advice="declare collisions, or each body by itself",
                loc=("bodies", name, "copies"),
                key=True,
            )


def check_carrier(scene: SceneFields, surface: str, body: str) -> None:
    """Check that what carries a surface is one body.

    Raises
    ------
    DeclarationProblem
        If it has copies.
    """
    if body in scene.bodies and scene.bodies[body].copies is not None:
        raise DeclarationProblem(
            f"one body carries a surface, and {body!r} has copies",
            advice="declare the body that carries it by itself, without copies",
            loc=("surfaces", surface, "body"),
        )


def check_collisions(scene: SceneFields, values: Mapping[str, float]) -> None:
    """Check the collisions of a scene.

    Raises
    ------
    DeclarationProblem
        At the first thing that is wrong.
    """
    check_shapes(scene, values)
    if not scene.collisions:
        return
    absent = {
        "contacts": scene.contacts,
        "coordinates": scene.coordinates,
        "modes": scene.initial_modes,
    }
    for section, declared in absent.items():
        if declared:
            raise DeclarationProblem(
                f"a scene with collisions has no {section} yet",
                advice="bodies are free, and touch by their shapes",
                loc=(section,),
                key=True,
            )
    _check_memory(scene)
    for name, body in scene.bodies.items():
        if body.coordinates != ("x", "y", "angle"):
            raise DeclarationProblem(
                "a body that collides is free and has an inertia",
                advice="give it an inertia, and no position",
                loc=("bodies", name),
            )
    for name, collision in scene.collisions.items():
        at = ("collisions", name)
        for place, one in enumerate(collision.bodies):
            if one not in scene.bodies:
                advice = close_matches(one, scene.bodies)
                loc: tuple[str | int, ...] = (*at, "bodies", place)
                raise DeclarationProblem(f"no body {one!r}", advice=advice, loc=loc)
            if not scene.bodies[one].shape:
                raise DeclarationProblem(
                    f"body {one!r} has no shape",
                    advice="give it a polygon or a disc",
                    loc=("bodies", one),
                    key=True,
                )
        for place, one in enumerate(collision.surfaces):
            loc = (*at, "surfaces", place)
            if one not in scene.surfaces:
                advice = close_matches(one, scene.surfaces)
                raise DeclarationProblem(f"no surface {one!r}", advice=advice, loc=loc)


def _check_memory(scene: SceneFields) -> None:
    """Check that what controllers remember is known ahead of the steps."""
    if not any(region.variables for region in scene.regions.values()):
        return
    moving = {*scene.variables, *map(scene.rate_name, scene.variables)}
    for region, declared in scene.regions.items():
        for state, at in scene.controlled.states(region):
            for variable, text in state.flows.items():
                used = [n for n in parse(text).names if n in moving]
                used += [
                    n
                    for n in parse(text).names.intersection(scene.controls)
                    if any(parse(t).names & moving for t in scene.controlled.texts(n))
                ]
                if used and declared.variables:
                    raise DeclarationProblem(
                        f"the flow of {variable!r} depends on {min(used)!r}, on how bodies move: "
                        "in a scene with collisions it may not",
                        advice="let it depend on time, controls and variables",
                        loc=(*at, "flows", variable),
                    )


def check_shapes(scene: SceneFields, values: Mapping[str, float]) -> None:
    """Check the numbers of shapes and collisions for `values` of the parameters.

    Raises
    ------
    DeclarationProblem
        At the first that is out of its bounds.
    """
    for name, body in scene.bodies.items():
        for place, shape in enumerate(body.shape):
            at = ("bodies", name, "shape", *((place,) if len(body.shape) > 1 else ()))
            _check_shape(scene, at, shape, values)
    for name, collision in scene.collisions.items():
        at = ("collisions", name)
        for key, most in (("friction", math.inf), ("restitution", 1.0)):
            text = getattr(collision, key)
            _check_names(scene, text, *at, key)
            value = value_of(text, values, *at, key)
            if not 0.0 <= value <= most:
                raise DeclarationProblem(
                    f"must be between 0 and {most:g}, not {value:g}", loc=(*at, key)
                )


def _check_shape(scene: SceneFields, at: Loc, shape: Shape, values: Mapping[str, float]) -> None:
    if shape.disc is not None:
        places: list[tuple[FormulaText, Loc]] = [(shape.disc, (*at, "disc"))]
        places += [(text, (*at, "at", axis)) for axis, text in enumerate(shape.at)]
        for text, loc in places:
            _check_names(scene, text, *loc)
            _check_finite(text, values, loc)
        if not (radius := parse(shape.disc).value(values)) > 0.0:
            raise DeclarationProblem(f"must be positive, not {radius:g}", loc=(*at, "disc"))
        return
    assert shape.polygon is not None
    for place, corner in enumerate(shape.polygon):
        for axis, text in enumerate(corner):
            loc = (*at, "polygon", place, axis)
            _check_names(scene, text, *loc)
            _check_finite(text, values, loc)
    try:
        check_polygon([(parse(x).value(values), parse(y).value(values)) for x, y in shape.polygon])
    except DeclarationProblem as problem:
        problem.loc = (*at, "polygon", *problem.loc)
        raise


def _check_names(scene: SceneFields, text: FormulaText, *loc: str | int) -> None:
    check_misplaced_names(scene, parse(text), scene.parameters, *loc)
    check_names(parse(text), scene.parameters, *loc)


def _check_finite(text: FormulaText, values: Mapping[str, float], loc: Loc) -> None:
    if not math.isfinite(value := value_of(text, values, *loc)):
        raise DeclarationProblem(f"must be finite, not {value:g}", loc=loc)
