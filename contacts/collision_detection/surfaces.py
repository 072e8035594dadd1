"""Contact manifolds of shapes on lines, plates, circles from both sides and graphs.

A surface is evaluated in its own frame, which its path or its carrier moves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.convex import ConvexShape, norm, shape_contacts, write_contact
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import run_tape

LINE, PLATE, ROUND, HOLLOW, GRAPH = range(5)
"""Kinds of surfaces: half-plane, straight sheet without thickness, disc, outside of a disc, region
below a function graph."""

# Search intervals for the nearest points of a graph, and Newton iterations for each.
_INTERVALS, _STEPS = 16, 40
# Distance of a crest from the end of an edge, relative to its length, at which it is the corner.
_SAME_NORMAL = 1e-3


class SurfaceNumbers(NamedTuple):
    """The surfaces that bodies collide with."""

    kinds: Ints  # shape (s,)
    # (s, 4): lines: point and outward unit normal; plates: ends; circles: centre and radius.
    numbers: Array
    carriers: Ints  # (s,): bodies that carry them; -1: none.
    moves: Bools  # (s,): whether they have paths.
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
def crossing_time(
    surfaces: SurfaceNumbers, s: int, before: tuple[float, float], after: tuple[float, float],
    core: float,
) -> float:  # fmt: skip
    """Return the part of a step for which a body was in a surface that it has passed; else 0.

    `before`, `after`: its centre in the surface's frame, a step ago and now; `core`: radius of its
    inscribed circle.
    """
    kind = surfaces.kinds[s]
    a, b, c, d = surfaces.numbers[s]
    u, v = after[0] - before[0], after[1] - before[1]
    if kind == PLATE:
        length = norm(c - a, d - b)
        nx, ny = (b - d) / length, (c - a) / length
        begin = nx * (before[0] - a) + ny * (before[1] - b)
        end = nx * (after[0] - a) + ny * (after[1] - b)
        if not begin * end < 0.0:
            return 0.0
        at = begin / (begin - end)
        along = ((before[0] + at * u - a) * (c - a) + (before[1] + at * v - b) * (d - b)) / length
        return min(1.0, 2.0 * core / abs(begin - end)) if 0.0 <= along <= length else 0.0
    if kind == ROUND:
        x, y, reach = after[0] - a, after[1] - b, 0.9 * (c + core)
        # |r + w t|^2 = reach^2, t = 0 now
        square, half, rest = u * u + v * v, x * u + y * v, x * x + y * y - reach * reach
        inside = half * half - square * rest
        if inside > 0.0:
            root = math.sqrt(inside)
            begin, end = (-half - root) / square, (-half + root) / square
            if begin > -1.0 and begin + end < 0.0:
                return end - begin
    return 0.0


@kernel
def surface_contacts(
    surfaces: SurfaceNumbers, s: int, pose: Array, registers: tuple[int, Array], shape: ConvexShape,
    within: float, manifold: Array, features: Ints,
) -> int:  # fmt: skip
    """Find the contact points of a piece with a surface, up to a gap; return their number.

    `pose` (3,): frame of the surface; `registers`: of the height tape (see
    `statechart.kernels.tapes.allocate_registers`); outputs: `manifold` (m, FOUND), `features` (m,).
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
                if far == 0.0:
                    continue
                nx, ny, away = (a - x) / far, (b - y) / far, c - far
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
def _evaluate_graph(
    surfaces: SurfaceNumbers, s: int, registers: tuple[int, Array], count: int
) -> int:
    """Evaluate a graph at the first columns of the registers; return its place in the outputs."""
    base, numbers = registers
    run_tape(surfaces.code, 0, len(surfaces.code), base, numbers, count)
    return surfaces.graphs[s]


@kernel
def tangent_at(
    surfaces: SurfaceNumbers, s: int, pose: Array, registers: tuple[int, Array], x: float, y: float
) -> tuple[float, float, float, float]:
    """Return the boundary point of a surface (no plate) near x, y, and its normal."""
    u, v = to_frame(pose, x, y)
    a, b, c, d = surfaces.numbers[s]
    kind = surfaces.kinds[s]
    if kind == GRAPH:
        numbers, outputs = registers[1], surfaces.outputs
        numbers[0, 0] = u
        at = _evaluate_graph(surfaces, s, registers, 1)
        height, slope = numbers[outputs[at], 0], numbers[outputs[at + 1], 0]
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
def _distance_to_disc(
    surfaces: SurfaceNumbers, s: int, registers: tuple[int, Array], x: float, middle: Array
) -> tuple[float, float, float, float]:
    """Return height and slope at x, and two derivatives of half the squared distance."""
    numbers, outputs = registers[1], surfaces.outputs
    numbers[0, 0] = x
    at = _evaluate_graph(surfaces, s, registers, 1)
    height, slope = numbers[outputs[at], 0], numbers[outputs[at + 1], 0]
    bend, above = numbers[outputs[at + 2], 0], height - middle[1]
    return height, slope, x - middle[0] + above * slope, 1.0 + slope * slope + above * bend


@kernel
def _newton_step(low: float, high: float, x: float, rate: float, steeper: float) -> float:
    """Return Newton's next x, or the middle of the bracket if it leaves that."""
    following = x - rate / steeper if steeper > 0.0 else math.inf
    return following if low < following < high else 0.5 * (low + high)


@kernel
def _disc_on_graph(
    surfaces: SurfaceNumbers, s: int, registers: tuple[int, Array], middle: Array, radius: float,
    within: float, manifold: Array,
) -> int:  # fmt: skip
    """Find the points of a graph nearest to a disc: local minima of the distance."""
    numbers = registers[1]
    reach, away = radius + within, np.empty(_INTERVALS + 1)
    for j in range(_INTERVALS + 1):
        numbers[0, j] = middle[0] + reach * (2.0 * j / _INTERVALS - 1.0)
    at = _evaluate_graph(surfaces, s, registers, _INTERVALS + 1)
    for j in range(_INTERVALS + 1):
        x, y = reach * (2.0 * j / _INTERVALS - 1.0), numbers[surfaces.outputs[at], j] - middle[1]
        away[j] = x * x + y * y
    count = 0
    for j in range(1, _INTERVALS):
        if not (away[j] <= away[j - 1] and away[j] < away[j + 1]) or count == len(manifold):
            continue
        low = middle[0] + reach * (2.0 * (j - 1) / _INTERVALS - 1.0)
        high = middle[0] + reach * (2.0 * (j + 1) / _INTERVALS - 1.0)
        x = 0.5 * (low + high)
        for _ in range(_STEPS):
            _, _, rate, steeper = _distance_to_disc(surfaces, s, registers, x, middle)
            if rate > 0.0:
                high = x
            else:
                low = x
            following = _newton_step(low, high, x, rate, steeper)
            done = abs(following - x) <= 1e-15 * reach
            x = following
            if done:
                break
        height, slope, _, _ = _distance_to_disc(surfaces, s, registers, x, middle)
        unit = 1.0 / math.sqrt(1.0 + slope * slope)
        gap = unit * (middle[1] - height - slope * (middle[0] - x)) - radius
        if gap <= within:
            write_contact(manifold[count], -slope * unit, unit, x, height, gap)
            count += 1
    return count


@kernel
def _polygon_on_graph(
    surfaces: SurfaceNumbers, s: int, registers: tuple[int, Array], corners: Array, within: float,
    manifold: Array, features: Ints,
) -> int:  # fmt: skip
    """Find corners near a graph, and its crests near edges."""
    numbers, outputs = registers[1], surfaces.outputs
    for i in range(len(corners)):
        numbers[0, i] = corners[i, 0]
    at = _evaluate_graph(surfaces, s, registers, len(corners))
    count = 0
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
        length = norm(ex, ey)
        nx, ny = ey / length, -ex / length
        away = np.empty(_INTERVALS + 1)
        for j in range(_INTERVALS + 1):
            numbers[0, j] = x + ex * j / _INTERVALS
        at = _evaluate_graph(surfaces, s, registers, _INTERVALS + 1)
        for j in range(_INTERVALS + 1):
            away[j] = nx * (ex * j / _INTERVALS) + ny * (numbers[outputs[at], j] - y)
        crests = 0
        for j in range(1, _INTERVALS):
            if not (away[j] <= away[j - 1] and away[j] < away[j + 1]) or count == len(manifold):
                continue
            low, high = x + ex * (j - 1) / _INTERVALS, x + ex * (j + 1) / _INTERVALS
            place = 0.5 * (low + high)
            for _ in range(_STEPS):
                numbers[0, 0] = place
                at = _evaluate_graph(surfaces, s, registers, 1)
                rate = nx + ny * numbers[outputs[at + 1], 0]
                if rate > 0.0:
                    high = place
                else:
                    low = place
                following = _newton_step(low, high, place, rate, ny * numbers[outputs[at + 2], 0])
                done = abs(following - place) <= 1e-15 * length
                place = following
                if done:
                    break
            numbers[0, 0] = place
            at = _evaluate_graph(surfaces, s, registers, 1)
            height = numbers[outputs[at], 0]
            gap = nx * (place - x) + ny * (height - y)
            offset = min(place - x, x + ex - place)
            if gap <= within and offset > _SAME_NORMAL * length:
                write_contact(manifold[count], -nx, -ny, place, height, gap)
                features[count] = len(corners) + _INTERVALS * i + crests
                count += 1
                crests += 1
    return count
