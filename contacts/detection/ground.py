"""Surfaces in the middle of a step, which may move, and what of a body is near them."""

from __future__ import annotations

import math
from typing import NamedTuple

from contacts.detection.body_numbers import BodyNumbers
from contacts.detection.look import Look
from contacts.detection.surfaces import (
    HOLLOW,
    ROUND,
    SurfaceNumbers,
    against_surface,
    carried,
    crossed,
    distance,
    seen_from,
)
from contacts.detection.touches import Touches
from statechart.arrays import Array, Ints
from statechart.kernels.jit import part


class Ground(NamedTuple):
    """The surfaces in the middle of a step.

    Attributes
    ----------
    paths : (3, s, 3)
        Their frames at the look before, at this one and at the next; of no use where none moves.
    registers : (int, array)
        Of the program of heights; see `statechart.kernels.tapes.filled`.
    frames : (3, 3)
        Is overwritten.
    still : (3, 3)
        Zero.
    """

    paths: Array
    registers: tuple[int, Array]
    frames: Array
    still: Array


@part
def _swung(ground: Ground, s: int, carrier: int, look: Look, h: float) -> None:
    """Write the frames (3, 3) of a surface that moves."""
    for at in range(3):
        for d in range(3):
            if carrier >= 0:
                moved = (at - 1) * h * look.old[carrier, d]
                ground.frames[at, d] = look.places[carrier, d] + moved
            else:
                ground.frames[at, d] = ground.paths[at, s, d]


@part
def _moved(frames: Array, x: float, y: float, look: int) -> tuple[float, float]:
    """Return where the point of a surface that now is at x, y is at a look."""
    u, v = seen_from(frames[1], x, y)
    return carried(frames[look], u, v)


@part
def on_surface(
    numbers: BodyNumbers, ground: Ground, look: Look, p: int, s: int, h: float, found: Array,
    features: Ints,
) -> tuple[int, float]:  # fmt: skip
    """Find the points of a piece near a surface; return their number, and `crossed`."""
    surfaces, x, y = numbers.surfaces, look.centres[p, 0], look.centres[p, 1]
    pieces, carrier, within = numbers.pieces, surfaces.carriers[s], look.reach[p]
    moves = carrier >= 0 or surfaces.moves[s]
    frames = ground.frames if moves else ground.still
    if moves:
        _swung(ground, s, carrier, look, h)
        u, v = _moved(frames, x, y, 2)
        within += 2.0 * math.hypot(u - x, v - y)
    if distance(surfaces, s, frames[1], x, y) > pieces.sizes[p] + within:
        return 0, 0.0
    before = seen_from(frames[0], x - h * look.drifts[p, 0], y - h * look.drifts[p, 1])
    passed = crossed(surfaces, s, before, seen_from(frames[1], x, y), pieces.cores[p])
    first, end = pieces.firsts[p], pieces.firsts[p + 1]
    points = against_surface(
        surfaces, s, frames[1], ground.registers, look.world[first:end], look.centres[p],
        pieces.radii[p], within, found, features,
    )  # fmt: skip
    return points, passed


@part
def carried_along(
    ground: Ground, surfaces: SurfaceNumbers, s: int, found: Array, h: float, m: int,
    touches: Touches,
) -> float:  # fmt: skip
    """Take the motion of a surface from a contact's velocities; return its pull.

    It moves from look to look, as the bodies do. A circle nears only as its centre does, and slips
    along its rim.
    """
    nx, ny, x, y = found[0], found[1], found[2], found[3]
    before, free, frames = touches.before, touches.free, ground.frames
    a, b = x, y
    if surfaces.kinds[s] == ROUND or surfaces.kinds[s] == HOLLOW:
        a, b = carried(frames[1], surfaces.numbers[s, 0], surfaces.numbers[s, 1])
    arm = nx * (x - a) + ny * (y - b)
    for look in (0, 2):
        way, turned = (look - 1.0) / h, frames[look, 2] - frames[1, 2]
        u, v = _moved(frames, a, b, look)
        nearing = way * (nx * (u - a) + ny * (v - b))
        along = way * (ny * (u - a) - nx * (v - b) - turned * arm)
        if look == 0:
            before[m, 0] -= nearing
            before[m, 1] -= along
        else:
            free[m, 0] -= nearing
            free[m, 1] -= along
    return math.hypot(free[m, 0] - before[m, 0], free[m, 1] - before[m, 1])
