"""Checks that numbers of a scene are finite and physical, and its formulas smooth."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence

from contacts.scene.fields import SceneFields
from contacts.scene.joints import Path
from contacts.scene.parts import Point, Surface
from statechart.documents.declaration import TIME
from statechart.documents.document import Loc
from statechart.documents.fields import FormulaText, check_named_infinity, value_of
from statechart.errors import DeclarationProblem, Findings
from statechart.formulas.derivatives import PIECES, check_derived, check_smooth
from statechart.formulas.formula import Formula, parse


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
