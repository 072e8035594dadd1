"""Surfaces that follow each other with a small step or gap between their ends."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations

from contacts.scene.fields import SceneFields
from statechart.formulas.formula import parse

NEARLY = 1e-3
"""Ends closer than this part of the scene's length were hardly meant to be apart."""

# Ends closer than this part of the edges' extent are equal but for round-off.
_EQUAL = 1e-12


def stays_off(scene: SceneFields, contact: str, depth: float) -> str:
    """Return a warning: a contact stays off, as its point is inside where its conditions hold."""
    surface = scene.contacts[contact].surface
    if scene.surfaces[surface].edge is None:
        return (
            f"{contact} stays off: its point is {depth:.3g} below the surface {surface} where its "
            "conditions begin to hold; let surfaces that follow each other meet"
        )
    return (
        f"{contact} stays off: its point is {depth:.3g} below the edge {surface} where it gets "
        "over it; let the ends of edges meet"
    )


def nearly_meeting(scene: SceneFields) -> Iterator[str]:
    """Yield a warning for each two edges whose ends nearly meet."""
    known = scene.values()
    ends = {
        name: [tuple(parse(text).value(known) for text in corner) for corner in surface.edge]
        for name, surface in scene.surfaces.items()
        if surface.edge is not None and not surface.moves
    }
    corners = [corner for edge in ends.values() for corner in edge]
    if not corners:
        return
    extent = math.hypot(*(max(side) - min(side) for side in zip(*corners, strict=True)))
    for one, other in combinations(ends, 2):
        if scene.surfaces[one].body != scene.surfaces[other].body:
            continue
        near, a, b = min(
            (math.dist(ends[one][a], ends[other][b]), a, b) for a in range(2) for b in range(2)
        )
        if _EQUAL * extent < near < NEARLY * extent:
            numbers = ("first", "second")
            yield (
                f"surfaces.{other}.edge: its {numbers[b]} point is {near:.3g} from the "
                f"{numbers[a]} point of {one!r}, and a point that slides off the one may get under "
                "the other; where one follows the other, write the same point"
            )
