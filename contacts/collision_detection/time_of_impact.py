"""Time of impact of two bodies that move in straight lines between two steps."""

from __future__ import annotations

import math

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers, PieceNumbers
from contacts.collision_detection.convex import ConvexShape, between, norm, place
from contacts.collision_detection.midpoint import Midpoint
from statechart.arrays import Array
from statechart.kernels.jit import kernel

# Remaining gap at the predicted arrival, relative to the gap now, that counts as a touch.
_ARRIVED = 0.01
# The cosine of the angle by which the normal of a hit may turn from its detection to the touch.
_ALIKE = 0.8
# Resolution of the time of impact of turning pieces: the interval is divided by this.
_DIVISIONS = 256
# Part of a step for which a piece that leaves by another side than it entered has crossed.
_CROSSED_PART = 0.5


@kernel
def overlap(centres: Array, velocities: Array, b: int, c: int, apart: float) -> tuple[float, float]:
    """Return the interval in which two pieces on straight lines are nearer than `apart`.

    The pieces are at `centres` at time zero. It is (inf, inf) if they never are.
    """
    x, y = centres[b, 0] - centres[c, 0], centres[b, 1] - centres[c, 1]
    u, v = velocities[b, 0] - velocities[c, 0], velocities[b, 1] - velocities[c, 1]
    # |r + v t|^2 = apart^2
    square, half, rest = u * u + v * v, x * u + y * v, x * x + y * y - apart * apart
    inside = half * half - square * rest
    if not inside > 0.0:
        return math.inf, math.inf
    root = math.sqrt(inside)
    return (-half - root) / square, (-half + root) / square


@kernel
def nearby(velocities: Array, sizes: Array, one: int, other: int, rate: float) -> bool:
    """Return whether the relative speed is below `rate` times the size of the smaller piece."""
    x = velocities[one, 0] - velocities[other, 0]
    y = velocities[one, 1] - velocities[other, 1]
    least = rate * min(sizes[one], sizes[other])
    return x * x + y * y < least * least


@kernel
def turning_speed(numbers: BodyNumbers, mid: Midpoint, one: int, other: int) -> float:
    """Return how fast turning brings parts of two pieces nearer, beside their motion.

    What is round turns nothing.
    """
    pieces, total = numbers.pieces, 0.0
    for p in (one, other):
        total += abs(mid.old[pieces.bodies[p], 2]) * (pieces.spans[p] - pieces.cores[p])
    return total


@kernel
def shape_at(pieces: PieceNumbers, p: int, pose: Array) -> ConvexShape:
    """Return a piece of a body that is there."""
    x, y, angle = pose
    corners = place(pieces.vertices[pieces.firsts[p] : pieces.firsts[p + 1]], x, y, angle)
    middle = place(pieces.middles[p : p + 1], x, y, angle)[0]
    return ConvexShape(corners, middle, pieces.radii[p])


@kernel
def _points(
    numbers: BodyNumbers, mid: Midpoint, pair: tuple[int, int], later: float, within: float,
    found: Array,
) -> int:  # fmt: skip
    """Find the points where two pieces are this near that have moved on as they do."""
    pieces, (p, q) = numbers.pieces, pair
    b, c = pieces.bodies[p], pieces.bodies[q]
    one = shape_at(pieces, p, mid.places[b] + later * mid.old[b])
    other = shape_at(pieces, q, mid.places[c] + later * mid.old[c])
    return between(one, other, within, found, np.empty(len(found), np.int64))


@kernel
def _gap_and_cosine(
    numbers: BodyNumbers, mid: Midpoint, pair: tuple[int, int], later: float,
    normal: tuple[float, float], found: Array,
) -> tuple[float, float]:  # fmt: skip
    """Return how two pieces touch that have moved on as they do: gap, cosine to a normal.

    The gap is inf, and the cosine 1, where they are far apart. Bodies are at `mid` at the time
    zero, and move on for `later`; of the normals then the one nearest to `normal` counts. `found`
    (p, FOUND) is overwritten.
    """
    one, other = numbers.pieces.bodies[pair[0]], numbers.pieces.bodies[pair[1]]
    fastest = np.abs(mid.old[one]).max() + np.abs(mid.old[other]).max()
    count = _points(numbers, mid, pair, later, 2.0 * abs(later) * fastest, found)
    gap, along = math.inf, 1.0 if count == 0 else -1.0
    for p in range(count):
        gap = min(gap, found[p, 4])
        along = max(along, found[p, 0] * normal[0] + found[p, 1] * normal[1])
    return gap, along


@kernel
def _time_of_impact(
    numbers: BodyNumbers, mid: Midpoint, pair: tuple[int, int], begin: float, end: float,
    near: float, aside: Array,
) -> float:  # fmt: skip
    """Return the first time at which two moving, turning pieces are this near; inf if never.

    Conservative advancement (Mirtich 1996): no point of them is faster than both bodies and what
    these turn, so that nothing happens in the time that the gap gives. Against the time where it
    `end`s before it begins.
    """
    pieces, p, q = numbers.pieces, pair[0], pair[1]
    u, v = mid.old[pieces.bodies[p]], mid.old[pieces.bodies[q]]
    fastest = norm(u[0] - v[0], u[1] - v[1])
    fastest += abs(u[2]) * pieces.spans[p] + abs(v[2]) * pieces.spans[q]
    way, time = math.copysign(1.0, end - begin), begin
    least = abs(end - begin) / _DIVISIONS
    while (end - time) * way > 0.0:
        gap = math.inf
        for k in range(_points(numbers, mid, pair, time, math.inf, aside)):
            gap = min(gap, aside[k, 4])
        if gap <= near:
            return time
        time += way * max((gap - near) / fastest, least)
    return math.inf


@kernel
def will_collide(
    numbers: BodyNumbers, mid: Midpoint, pair: tuple[int, int], normal: tuple[float, float],
    gap: float, nearing: float, h: float, aside: Array,
) -> tuple[bool, float]:  # fmt: skip
    """Return whether bodies that are not beside each other touch, and for how long they did.

    Ahead of its arrival, or behind, other corners and edges of a fast body are the nearest.
    """
    later = max(gap / nearing, -h)
    arrived, along = _gap_and_cosine(numbers, mid, pair, later, normal, aside)
    if gap > 0.0 and not arrived <= _ARRIVED * gap:
        return False, 0.0
    return True, _CROSSED_PART if along < _ALIKE else 0.0


@kernel
def will_collide_turning(
    numbers: BodyNumbers,
    mid: Midpoint,
    pair: tuple[int, int],
    gap: float,
    until: float,
    aside: Array,
) -> bool:
    """Return whether two quickly turning bodies that are apart touch before the given time."""
    return _time_of_impact(numbers, mid, pair, 0.0, until, _ARRIVED * gap, aside) < math.inf


@kernel
def passing_time(
    numbers: BodyNumbers, mid: Midpoint, pair: tuple[int, int], since: float, deep: float,
    aside: Array,
) -> float:  # fmt: skip
    """Return for how long pieces were so deep in each other since the last detection."""
    left = _time_of_impact(numbers, mid, pair, 0.0, -since, -deep, aside)
    if not -since < left < 0.0:
        return 0.0
    begin = _time_of_impact(numbers, mid, pair, -since, 0.0, -deep, aside)
    return left - begin if -since < begin else 0.0


@kernel
def entered_other_side(
    numbers: BodyNumbers, mid: Midpoint, pair: tuple[int, int], normal: tuple[float, float],
    since: float, aside: Array,
) -> float:  # fmt: skip
    """Return for how long a body was in another that it leaves: if it came by another side."""
    earlier, _ = _gap_and_cosine(numbers, mid, pair, -since, normal, aside)
    return _CROSSED_PART if earlier > 0.0 else 0.0
