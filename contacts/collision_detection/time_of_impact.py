"""Time of impact of bodies and surfaces in straight motion and uniform rotation between steps."""

from __future__ import annotations

import math

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers, PieceNumbers
from contacts.collision_detection.convex import (
    ConvexShape,
    interval_within,
    norm,
    place_vertices,
    shape_contacts,
)
from contacts.collision_detection.midpoint import Midpoint
from contacts.collision_detection.surfaces import GRAPH, Ground, surface_contacts
from statechart.arrays import Array
from statechart.kernels.jit import kernel

# Gap at the predicted arrival, relative to the present one, that counts as touching.
ARRIVED = 0.01
# Cosine of the largest turn of the normal between detection and touch.
_ALIKE = 0.8
# Time steps of conservative advancement while pieces are close: the interval over _DIVISIONS; for
# fast pieces the time in which they move by _PART of their inner radii, but at least the interval
# over _MAX_DIVISIONS. Surfaces count as fast pieces of the same radius; _NEAR: search distance of
# graphs, relative to it.
_DIVISIONS, _PART, _MAX_DIVISIONS, _NEAR = 256, 0.25, 2**16, 0.5
# Part of a step that counts as crossed if a piece leaves by another side than it entered.
_CROSSED_PART = 0.5


@kernel
def overlap_interval(
    centres: Array, velocities: Array, b: int, c: int, apart: float
) -> tuple[float, float]:
    """Return the interval in which two pieces in straight motion are nearer than `apart`.

    The pieces are at `centres` at time zero; (inf, inf) if they never are.
    """
    x, y = centres[b, 0] - centres[c, 0], centres[b, 1] - centres[c, 1]
    u, v = velocities[b, 0] - velocities[c, 0], velocities[b, 1] - velocities[c, 1]
    return interval_within(x, y, u, v, apart)


@kernel
def is_relatively_slow(velocities: Array, sizes: Array, one: int, other: int, rate: float) -> bool:
    """Return whether the relative speed is below `rate` times the smaller size."""
    x = velocities[one, 0] - velocities[other, 0]
    y = velocities[one, 1] - velocities[other, 1]
    least = rate * min(sizes[one], sizes[other])
    return x * x + y * y < least * least


@kernel
def turning_speed(numbers: BodyNumbers, mid: Midpoint, p: int) -> float:
    """Return the approach speed by rotation of a piece; 0 for a disc."""
    pieces = numbers.pieces
    return abs(mid.old_rates[pieces.bodies[p], 2]) * (pieces.spans[p] - pieces.cores[p])


@kernel
def shape_at(pieces: PieceNumbers, p: int, pose: Array) -> ConvexShape:
    """Return a piece of a body in a pose."""
    x, y, angle = pose
    corners = place_vertices(pieces.vertices[pieces.firsts[p] : pieces.firsts[p + 1]], x, y, angle)
    middle = place_vertices(pieces.middles[p : p + 1], x, y, angle)[0]
    return ConvexShape(corners, middle, pieces.radii[p])


@kernel
def carrier_of(numbers: BodyNumbers, q: int) -> int:
    """Return the body of a piece, or of a surface (indices behind the pieces); -1: the world."""
    pieces = numbers.pieces.bodies
    return pieces[q] if q < len(pieces) else numbers.surfaces.carriers[q - len(pieces)]


@kernel
def _points(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int], later: float,
    within: float, manifold: Array,
) -> int:  # fmt: skip
    """Find the points where a piece is within a distance of another or a surface, later."""
    pieces, (p, q), features = numbers.pieces, pair, np.empty(len(manifold), np.int64)
    b, c, s = pieces.bodies[p], carrier_of(numbers, q), q - len(pieces.sizes)
    one = shape_at(pieces, p, mid.poses[b] + later * mid.old_rates[b])
    pose = mid.poses[c] + later * mid.old_rates[c]
    if s >= 0:
        return surface_contacts(numbers.surfaces, s, pose, ground, one, within, manifold, features)
    return shape_contacts(one, shape_at(pieces, q, pose), within, manifold, features)


@kernel
def _gap_and_cosine(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int], later: float,
    normal: tuple[float, float], buffer: Array,
) -> tuple[float, float]:  # fmt: skip
    """Return the smallest gap of two pieces at a later time, and its best cosine to a normal.

    (inf, 1) if they are far apart. Bodies are at `mid` at time zero; `buffer` (p, FOUND) is
    overwritten.
    """
    one, other = numbers.pieces.bodies[pair[0]], carrier_of(numbers, pair[1])
    fastest = np.abs(mid.old_rates[one]).max() + np.abs(mid.old_rates[other]).max()
    count = _points(numbers, ground, mid, pair, later, 2.0 * abs(later) * fastest, buffer)
    gap, along = math.inf, 1.0 if count == 0 else -1.0
    for p in range(count):
        gap = min(gap, buffer[p, 4])
        along = max(along, buffer[p, 0] * normal[0] + buffer[p, 1] * normal[1])
    return gap, along


@kernel
def relative_speed(numbers: BodyNumbers, mid: Midpoint, p: int, q: int) -> float:
    """Return a bound of the speed of a piece's points relative to another or a surface."""
    pieces, c = numbers.pieces, carrier_of(numbers, q)
    u, v = mid.old_rates[pieces.bodies[p]], mid.old_rates[c]
    # A surface turns about its origin.
    x, y = mid.centres[p, 0] - mid.poses[c, 0], mid.centres[p, 1] - mid.poses[c, 1]
    arm = pieces.spans[q] if q < len(pieces.spans) else norm(x, y) + pieces.sizes[p]
    return norm(u[0] - v[0], u[1] - v[1]) + abs(u[2]) * pieces.spans[p] + abs(v[2]) * arm


@kernel
def time_of_impact(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int], begin: float,
    end: float, near: float, buffer: Array,
) -> float:  # fmt: skip
    """Return the first time at which a piece is this near another or a surface; inf if never.

    Conservative advancement (Mirtich 1996): no point is faster than both bodies and their rotation,
    so that the gap bounds the time. Backwards if `end` < `begin`.
    """
    pieces, (p, q), within = numbers.pieces, pair, math.inf
    fastest, s, core = relative_speed(numbers, mid, p, q), q - len(pieces.sizes), pieces.cores[p]
    way, time, whole = math.copysign(1.0, end - begin), begin, abs(end - begin)
    if s >= 0 and numbers.surfaces.kinds[s] == GRAPH:
        within = _NEAR * core
    least, part = whole / _DIVISIONS, _PART * (core + (core if s >= 0 else pieces.cores[q]))
    if s >= 0 or least * fastest > part:
        least = max(part / fastest, whole / _MAX_DIVISIONS)
    while (end - time) * way > 0.0:
        gap = within
        for k in range(_points(numbers, ground, mid, pair, time, within, buffer)):
            gap = min(gap, buffer[k, 4])
        if gap <= near:
            return time
        time += way * max((gap - near) / fastest, least)
    return math.inf


@kernel
def will_collide(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int], point: Array,
    later: float, buffer: Array,
) -> tuple[bool, float]:  # fmt: skip
    """Return whether fast bodies touch `later`, and for which part of the step they crossed.

    `point`: their nearest points now, see `contacts.collision_detection.convex.shape_contacts`.
    """
    normal, gap = (point[0], point[1]), point[4]
    arrived, along = _gap_and_cosine(numbers, ground, mid, pair, later, normal, buffer)
    if gap > 0.0 and not arrived <= ARRIVED * gap:
        return False, 0.0
    return True, _CROSSED_PART if along < _ALIKE else 0.0


@kernel
def passing_time(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int], since: float,
    deep: float, buffer: Array,
) -> float:  # fmt: skip
    """Return for how long a piece was `deep` in another or a surface since the last detection.

    A piece that was inside at that detection is leaving, and does not count.
    """
    end = time_of_impact(numbers, ground, mid, pair, 0.0, -since, -deep, buffer)
    if not -since < end < 0.0:
        return 0.0
    begin = time_of_impact(numbers, ground, mid, pair, -since, 0.0, -deep, buffer)
    return end - begin if -since < begin else 0.0


@kernel
def entered_other_side(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int],
    normal: tuple[float, float], since: float, buffer: Array,
) -> float:  # fmt: skip
    """Return `_CROSSED_PART` if a body leaves another by another side than it entered, else 0."""
    earlier, _ = _gap_and_cosine(numbers, ground, mid, pair, -since, normal, buffer)
    return _CROSSED_PART if earlier > 0.0 else 0.0
