"""Kinks of a scene: where a formula has no derivative that motion or contact needs."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from contacts.fields import SceneFields
from contacts.parts import Path
from statechart.documents.declaration import TIME
from statechart.documents.document import Loc
from statechart.formulas.derived import check_derived
from statechart.formulas.formula import parse
from statechart.formulas.kinks import PIECES, check_smooth

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
        advice = _SURFACES if loc[-1] == "height" else _SMOOTH
        check_smooth(text, variables, loc=loc, lacks="slope, or no curvature,", advice=advice)
        check_derived(parse(text).root, variables, loc)
    changing, texts = _forces(scene)
    for loc, text in texts:
        # Guards of controllers are derived along the motion, twice.
        check_derived(parse(text).root, changing, loc, order=1)
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
    for region, declared in controls.regions.items():
        for state, content in declared.states.items():
            for name, text in content.sets.items():
                at = ("regions", region, "states", state, "sets", name)
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
    for name, joint in scene.joints.items():
        if isinstance(joint.to, Path):
            for place, axis in enumerate(("x", "y")):
                yield ("joints", name, "to", place, axis), getattr(joint.to, axis) or 0, (TIME,)
    for name, body in scene.bodies.items():
        for place, text in enumerate(body.position or ()):
            yield ("bodies", name, "position", place), text, scene.coordinates
        yield ("bodies", name, "angle"), body.angle or 0, scene.coordinates
