"""Checks of copies of bodies, shapes and collisions."""

from __future__ import annotations

import math
from collections.abc import Mapping

from contacts.scene.fields import SceneFields
from contacts.scene.misplaced_names import check_misplaced_names
from contacts.scene.polygons import check_polygon
from contacts.scene.shapes import INDEX, Shape
from statechart.documents.document import Loc
from statechart.documents.fields import FormulaText, check_names, value_of
from statechart.errors import DeclarationProblem, close_matches
from statechart.formulas.formula import parse


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
