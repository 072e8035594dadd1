"""Whether bodies start inside what is hollow."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from contacts.collisions.declared_surfaces import touched
from contacts.detection.body_numbers import BodyNumbers
from contacts.detection.surfaces import HOLLOW
from contacts.scene.scene import Scene
from statechart.arrays import Array
from statechart.errors import DeclarationProblem


def check_inside(
    scene: Scene, owners: Sequence[str], numbers: BodyNumbers, initial: Array, frames: Array
) -> None:
    """Check that what collides with a hollow circle starts in it.

    Parameters
    ----------
    scene : Scene
        Its bodies one by one.
    owners : sequence of str
        What they are declared by.
    numbers : BodyNumbers
    initial : (6 b,)
        Coordinates and rates.
    frames : (s, 3)
        Of the surfaces, at the start.

    Raises
    ------
    DeclarationProblem
        If a body is too large, or starts outside.
    """
    names, surfaces = list(scene.bodies), numbers.surfaces
    places = initial[: 3 * len(names)].reshape(-1, 3)
    for s, name in enumerate(touched(scene)):
        if surfaces.kinds[s] != HOLLOW:
            continue
        x, y, radius, _ = surfaces.numbers[s].tolist()
        carrier = int(surfaces.carriers[s])
        u, v, angle = (frames[s] if carrier < 0 else places[carrier]).tolist()
        cos, sin = math.cos(angle), math.sin(angle)
        centre = np.array([u + cos * x - sin * y, v + sin * x + cos * y])
        meets = numbers.laws[numbers.kinds, len(numbers.laws) + s] >= 0
        members = [b for b in np.flatnonzero(meets).tolist() if b != carrier]
        outside = []
        for b in members:
            mine = slice(*numbers.pieces.begins[b : b + 2].tolist())
            core = float(numbers.pieces.cores[mine].max(initial=0.0))
            if core > radius:
                raise DeclarationProblem(
                    f"body {names[b]!r} reaches {core:.6g} around its centre, and "
                    f"{name!r}, which it is to move in, has a radius of {radius:.6g}",
                    advice="make the circle larger, or the body smaller",
                    loc=("bodies", owners[b], "shape"),
                )
            if math.hypot(*(places[b, :2] - centre)) >= radius:
                outside.append(b)
        if outside:
            who = "every body" if len(outside) == len(members) else f"body {names[outside[0]]!r}"
            raise DeclarationProblem(
                f"{who} starts outside of {name!r}, whose solid is around it",
                advice=f"let bodies start within {radius:.6g} of its centre; to touch a circle "
                "from outside, leave out hollow",
                loc=("bodies", owners[outside[0]], "start"),
            )
