"""Kinks: where a formula has no derivative that motion or contact needs."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING

from contacts.parts import Path
from statechart.declaration import TIME
from statechart.errors import DeclarationProblem
from statechart.formula import parse
from statechart.syntax import Call, names_in, nodes

if TYPE_CHECKING:
    from contacts.scene import Scene

__all__ = ["check_kinks"]

# Their first or second derivative jumps, or is infinite at a point.
_KINKED = ("abs", "sign", "min", "max")
_PIECES = (
    "declare a surface and a contact for each smooth piece: that is all for the higher of them "
    "(max, abs); for the lower (min) each with enabled: a relation that holds on its side"
)
_SMOOTH = "a velocity that jumps takes an impact without cause: write a smooth formula"


def check_kinks(scene: Scene) -> None:
    """Check that surfaces, paths and positions have the derivatives that are taken of them.

    Raises
    ------
    DeclarationProblem
        At the first that has not.
    """
    for loc, text, variables in _differentiated(scene):
        calls = (node for node in nodes(parse(text).root) if isinstance(node, Call))
        for call in calls:
            switched = {name.name for name in names_in(call)}.intersection(variables)
            if call.function in _KINKED and switched:
                raise DeclarationProblem(
                    f"{call.function} of {', '.join(sorted(switched))} has no slope, or no "
                    "curvature, where it switches",
                    advice=_PIECES if loc[-1] == "height" else _SMOOTH,
                    loc=loc,
                )


def _differentiated(
    scene: Scene,
) -> Iterator[tuple[tuple[str | int, ...], str | int | float, Collection[str]]]:
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
