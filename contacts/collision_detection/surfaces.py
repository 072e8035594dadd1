"""Contact manifolds of shapes on lines, plates, circles from both sides and graphs.

A surface is evaluated in its own frame, which its carrier moves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.convex import (
    ConvexShape,
    norm,
    shape_contacts,
    write_contact,
)
from statechart.arrays import Array, Ints, Ints32
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import run_tape

LINE, PLATE, ROUND, HOLLOW, GRAPH = range(5)
"""Kinds of surfaces: half-plane, straight sheet without thickness, disc, outside of a disc, region
below a function graph."""

# Search intervals for the nearest points of a graph, and Newton iterations for each.
_INTERVALS, _STEPS = 16, 40
# Distance of a crest from the end of an edge, relative to its length, at which it is the corner.
_SAME_NORMAL = 1e-3


Ground = tuple[int, Array]
"""Registers of the height tape; see `statechart.kernels.tapes.allocate_registers`."""


class SurfaceNumbers(NamedTuple):
    """The surfaces that bodies collide with."""

    kinds: Ints  # shape (s,)
    # (s, 4): lines: point and outward unit normal; plates: ends; circles: centre and radius.
    numbers: Array
    carriers: Ints  # (s,): bodies that carry them; -1: the world.
    graphs: Ints  # (s,): place of height, slope and curvature in the outputs of the tape.
    # Tape (`statechart.formulas.tape.Tape`) of the graphs, and its parameters.
    code: Ints32
    constants: Array
    outputs: Ints32
    values: Array


@kernel
def distance(surfaces: SurfaceNumbers, s: int, pose: Array, x: float, y: float) -> float:
    """Return a lower bound of the distance of a point from a surface; < 0 in the solid."""
    kind = surfaces.kinds[s]
    if kind == GRAPH:
        return -math.inf
    x, y = to_frame(pose, x, y)
    a, b, c, d = surfaces.numbers[s]
    if kind == LINE:
        return c * (x - a) + d * (y - b)
    if kind == PLATE:
        along = ((x - a) * (c - a) + (y - b) * (d - b)) / ((c - a) ** 2 + (d - b) ** 2)
        along = min(max(along, 0.0), 1.0)
        return norm(x - a - along * (c - a), y - b - along * (d - b))
    away = norm(x - a, y - b) - c
    return away if kind == ROUND else -away


@kernel
def to_frame(pose: Array, x: float, y: float) -> tuple[float, float]:
    """Return a world point in a frame (x, y, angle)."""
    dx, dy = x - pose[0], y - pose[1]
    if pose[2] == 0.0:
        return dx, dy
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return c * dx + s * dy, c * dy - s * dx


@kernel
def to_world(pose: Array, x: float, y: float) -> tuple[float, float]:
    """Return a point of a frame (x, y, angle) in the world."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[0] + c * x - s * y, pose[1] + s * x + c * y


@kernel
def surface_contacts(
    surfaces: SurfaceNumbers, s: int, pose: Array, registers: Ground, shape: ConvexShape,
    within: float, manifold: Array, features: Ints,
) -> int:  # fmt: skip
    """Find the contact points of a piece with a surface, up to a gap; return their number.

    `pose` (3,): frame of the surface; outputs: `manifold` (m, FOUND), `features` (m,).
    """
    body, centre, radius = shape
    moved = pose[0] != 0.0 or pose[1] != 0.0 or pose[2] != 0.0
    middle, corners = centre, body
    if moved:
        middle, corners = np.empty(2), np.empty_like(body)
        middle[0], middle[1] = to_frame(pose, centre[0], centre[1])
        for i in range(len(body)):
            corners[i, 0], corners[i, 1] = to_frame(pose, body[i, 0], body[i, 1])
    kind = surfaces.kinds[s]
    a, b, c, d = surfaces.numbers[s]
    if kind in (PLATE, ROUND):
        ends, piece = np.empty((2, 2)), ConvexShape(corners, middle, radius)
        ends[0, 0], ends[0, 1], ends[1, 0], ends[1, 1] = a, b, c, d
        origin = np.empty(2)
        origin[0], origin[1] = (a, b) if kind == ROUND else (0.5 * (a + c), 0.5 * (b + d))
        if kind == ROUND:
            disc = ConvexShape(np.empty((0, 2)), origin, c)
            count = shape_contacts(piece, disc, within, manifold, features)
        else:
            # The plate comes first: if a body's corner is beside the plate's end, in a valley, the
            # body's face is as near to that end as the plate is to the corner, which touches.
            plate = ConvexShape(ends, origin, 0.0)
            count = shape_contacts(plate, piece, within, manifold, features)
            for i in range(count):
                manifold[i, 0], manifold[i, 1] = -manifold[i, 0], -manifold[i, 1]
    elif kind == GRAPH:
        if len(body) == 0:
            count = _disc_on_graph(surfaces, s, registers, middle, radius, within, manifold)
            for i in range(count):
                features[i] = i
        else:
            count = _polygon_on_graph(surfaces, s, registers, corners, within, manifold, features)
    else:
        count = 0
        for i in range(max(len(body), 1)):
            x, y = (middle[0], middle[1]) if len(body) == 0 else (corners[i, 0], corners[i, 1])
            if kind == LINE:
                nx, ny, away = c, d, c * (x - a) + d * (y - b)
            else:
                far = norm(x - a, y - b)
                nx, ny = ((a - x) / far, (b - y) / far) if far > 0.0 else (0.0, 1.0)
                away = c - far
            if away - radius <= within and count < len(manifold):
                write_contact(
                    manifold[count], nx, ny, x - radius * nx, y - radius * ny, away - radius
                )
                features[count] = i
                count += 1
    if moved:
        for i in range(count):
            x, y = to_world(pose, manifold[i, 2], manifold[i, 3])
            nx, ny = to_world(pose, manifold[i, 0], manifold[i, 1])
            write_contact(manifold[i], nx - pose[0], ny - pose[1], x, y, manifold[i, 4])
    return count


@kernel
def _evaluate_graph(surfaces: SurfaceNumbers, s: int, registers: Ground, count: int) -> int:
    """Evaluate a graph at the first columns of the registers; return its place in the outputs."""
    base, numbers = registers
    run_tape(surfaces.code, 0, len(surfaces.code), base, numbers, count)
    return surfaces.graphs[s]


@kernel
def _height_and_slope(
    surfaces: SurfaceNumbers, s: int, registers: Ground, x: float
) -> tuple[float, float]:
    """Return height and slope of a graph."""
    numbers, outputs = registers[1], surfaces.outputs
    numbers[0, 0] = x
    at = _evaluate_graph(surfaces, s, registers, 1)
    return numbers[outputs[at], 0], numbers[outputs[at + 1], 0]


@kernel
def tangent_at(
    surfaces: SurfaceNumbers, s: int, pose: Array, registers: Ground, x: float, y: float
) -> tuple[float, float, float, float]:
    """Return the boundary point of a surface (no plate) near x, y, and its normal."""
    u, v = to_frame(pose, x, y)
    a, b, c, d = surfaces.numbers[s]
    kind = surfaces.kinds[s]
    if kind == GRAPH:
        height, slope = _height_and_slope(surfaces, s, registers, u)
        unit = 1.0 / math.sqrt(1.0 + slope * slope)
        a, b, c, d = u, height, -slope * unit, unit
    elif kind != LINE:
        away, side = norm(u - a, v - b), 1.0 if kind == ROUND else -1.0
        nx, ny = ((u - a) / away, (v - b) / away) if away > 0.0 else (0.0, 1.0)
        a, b, c, d = a + c * nx, b + c * ny, side * nx, side * ny
    x, y = to_world(pose, a, b)
    nx, ny = to_world(pose, c, d)
    return x, y, nx - pose[0], ny - pose[1]


@kernel
def _nearest_places(
    surfaces: SurfaceNumbers, s: int, registers: Ground, begin: float, length: float,
    origin: tuple[float, float], normal: tuple[float, float], places: Array,
) -> int:  # fmt: skip
    """Find where a graph is nearest to a point, or deepest along a normal; return the number.

    Local minima over `length` from `begin` on, bracketed by samples, then by Newton's method. With
    a zero `normal` those of half the squared distance from the origin; else of the distance from
    the origin along the normal.
    """
    numbers, outputs, (x0, y0), (nx, ny) = registers[1], surfaces.outputs, origin, normal
    away, round_off = np.empty(_INTERVALS + 1), 1e-15 * length
    square = 1.0 if nx == 0.0 and ny == 0.0 else 0.0
    for j in range(_INTERVALS + 1):
        numbers[0, j] = begin + length * j / _INTERVALS
    at = _evaluate_graph(surfaces, s, registers, _INTERVALS + 1)
    for j in range(_INTERVALS + 1):
        x, y = begin + length * j / _INTERVALS - x0, numbers[outputs[at], j] - y0
        away[j] = square * 0.5 * (x * x + y * y) + nx * x + ny * y
    count = 0
    for j in range(1, _INTERVALS):
        if not (away[j] <= away[j - 1] and away[j] < away[j + 1]):
            continue
        low, high = begin + length * (j - 1) / _INTERVALS, begin + length * (j + 1) / _INTERVALS
        place = 0.5 * (low + high)
        for _ in range(_STEPS):
            numbers[0, 0] = place
            at = _evaluate_graph(surfaces, s, registers, 1)
            x, y, slope = place - x0, numbers[outputs[at], 0] - y0, numbers[outputs[at + 1], 0]
            bend = numbers[outputs[at + 2], 0]
            rate = square * (x + y * slope) + nx + ny * slope
            steeper = square * (1.0 + slope * slope + y * bend) + ny * bend
            if rate > 0.0:
                high = place
            else:
                low = place
            following = place - rate / steeper if steeper > 0.0 else math.inf
            if not low < following < high:
                following = 0.5 * (low + high)
            done = abs(following - place) <= round_off
            place = following
            if done:
                break
        places[count] = place
        count += 1
    return count


@kernel
def _disc_on_graph(
    surfaces: SurfaceNumbers, s: int, registers: Ground, middle: Array, radius: float,
    within: float, manifold: Array,
) -> int:  # fmt: skip
    """Find the points of a graph nearest to a disc."""
    reach, count, places = radius + within, 0, np.empty(_INTERVALS)
    begin, origin, any_way = middle[0] - reach, (middle[0], middle[1]), (0.0, 0.0)
    for k in range(
        _nearest_places(surfaces, s, registers, begin, 2.0 * reach, origin, any_way, places)
    ):
        x = places[k]
        height, slope = _height_and_slope(surfaces, s, registers, x)
        unit = 1.0 / math.sqrt(1.0 + slope * slope)
        gap = unit * (middle[1] - height - slope * (middle[0] - x)) - radius
        if gap <= within and count < len(manifold):
            write_contact(manifold[count], -slope * unit, unit, x, height, gap)
            count += 1
    return count


@kernel
def _polygon_on_graph(
    surfaces: SurfaceNumbers, s: int, registers: Ground, corners: Array, within: float,
    manifold: Array, features: Ints,
) -> int:  # fmt: skip
    """Find corners near a graph, and its crests near edges."""
    numbers, outputs, count, places = registers[1], surfaces.outputs, 0, np.empty(_INTERVALS)
    for i in range(len(corners)):
        numbers[0, i] = corners[i, 0]
    at = _evaluate_graph(surfaces, s, registers, len(corners))
    for i in range(len(corners)):
        slope = numbers[outputs[at + 1], i]
        unit = 1.0 / math.sqrt(1.0 + slope * slope)
        gap = unit * (corners[i, 1] - numbers[outputs[at], i])
        if gap <= within and count < len(manifold):
            write_contact(manifold[count], -slope * unit, unit, corners[i, 0], corners[i, 1], gap)
            features[count] = i
            count += 1
    for i in range(len(corners)):
        x, y = corners[i]
        ex, ey = corners[(i + 1) % len(corners), 0] - x, corners[(i + 1) % len(corners), 1] - y
        # Lower edges of counter-clockwise polygons point right.
        if not ex > 0.0:
            continue
        length, crests = norm(ex, ey), 0
        nx, ny = ey / length, -ex / length
        for k in range(_nearest_places(surfaces, s, registers, x, ex, (x, y), (nx, ny), places)):
            place = places[k]
            height, _ = _height_and_slope(surfaces, s, registers, place)
            gap = nx * (place - x) + ny * (height - y)
            inside = min(place - x, x + ex - place) > _SAME_NORMAL * length
            if gap <= within and inside and count < len(manifold):
                write_contact(manifold[count], -nx, -ny, place, height, gap)
                features[count] = len(corners) + _INTERVALS * i + crests
                count += 1
                crests += 1
    return count
