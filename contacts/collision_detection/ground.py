"""Surfaces at the midpoint of a step, and contact points of bodies on them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers
from contacts.collision_detection.convex import FOUND, ConvexShape, norm
from contacts.collision_detection.midpoint import Midpoint
from contacts.collision_detection.surfaces import (
    SurfaceNumbers,
    crossing_time,
    distance,
    surface_contacts,
    to_frame,
    to_world,
)
from contacts.collision_detection.time_of_impact import shape_at
from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel

POINTS = 16
"""Capacity of contact points per pair: a polygon on a surface has one per corner."""

# Sampling of a piece's path: stride relative to the inscribed circle, and largest number of
# samples; a shorter path passes nothing.
_STRIDE, _MAX_SAMPLES = 0.5, 64
# Depth, relative to that circle, up to which a pass only grazes.
_GRAZED = 0.1


class Ground(NamedTuple):
    """The surfaces at the midpoint of a step."""

    # Registers of the height tape (see `statechart.kernels.tapes.allocate_registers`).
    registers: tuple[int, Array]
    frames: Array  # (3, 3): buffer.
    still: Array  # (3, 3): zero.


@kernel
def _write_frames(ground: Ground, carrier: int, mid: Midpoint, h: float) -> None:
    """Write the frames (3, 3) of a carrier at the previous detection, this one and the next."""
    for d in range(3):
        now = mid.poses[carrier, d]
        ground.frames[0, d] = now - h * mid.old_rates[carrier, d]
        ground.frames[1, d] = now
        ground.frames[2, d] = now + h * mid.free_rates[carrier, d]


@kernel
def pose_of(numbers: BodyNumbers, ground: Ground, mid: Midpoint, s: int) -> Array:
    """Return the frame (3,) of a surface at this detection."""
    carrier = numbers.surfaces.carriers[s]
    return mid.poses[carrier] if carrier >= 0 else ground.still[1]


@kernel
def is_far(
    surfaces: SurfaceNumbers, ground: Ground, mid: Midpoint, p: int, s: int, size: float
) -> bool:
    """Return whether a piece is out of reach of a fixed surface."""
    if surfaces.carriers[s] >= 0:
        return False
    x, y = mid.centres[p, 0], mid.centres[p, 1]
    return distance(surfaces, s, ground.still[1], x, y) > size + mid.reach[p]


@kernel
def on_surface(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, p: int, s: int, h: float, manifold: Array,
    features: Ints,
) -> tuple[int, float]:  # fmt: skip
    """Find the points of a piece near a surface; return their number, and `crossing_time`."""
    surfaces, x, y = numbers.surfaces, mid.centres[p, 0], mid.centres[p, 1]
    pieces, carrier, within = numbers.pieces, surfaces.carriers[s], mid.reach[p]
    frames = ground.frames if carrier >= 0 else ground.still
    if carrier >= 0:
        _write_frames(ground, carrier, mid, h)
        u, v = to_frame(frames[1], x, y)
        u, v = to_world(frames[2], u, v)
        within += 2.0 * norm(u - x, v - y)
    if distance(surfaces, s, frames[1], x, y) > pieces.sizes[p] + within:
        return 0, 0.0
    before = to_frame(frames[0], x - h * mid.drifts[p, 0], y - h * mid.drifts[p, 1])
    after = to_frame(frames[1], x, y)
    passed = crossing_time(surfaces, s, before, after, pieces.cores[p])
    first, end = pieces.firsts[p], pieces.firsts[p + 1]
    points = surface_contacts(
        surfaces, s, frames[1], ground.registers,
        ConvexShape(mid.world[first:end], mid.centres[p], pieces.radii[p]), within, manifold,
        features,
    )  # fmt: skip
    turned = h * mid.old_rates[pieces.bodies[p], 2] - (frames[1, 2] - frames[0, 2])
    way = norm(after[0] - before[0], after[1] - before[1]) + pieces.spans[p] * abs(turned)
    if passed == 0.0 and way > _STRIDE * pieces.cores[p]:
        clear = True
        for at in range(points):
            clear = clear and manifold[at, 4] >= 0.0
        if clear:
            samples = math.ceil(min(way / (_STRIDE * pieces.cores[p]), 1.0 * _MAX_SAMPLES))
            passed = _passed_over(numbers, ground, mid, (p, s), h, frames, samples)
    return points, passed


@kernel
def _passed_over(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int], h: float,
    frames: Array, samples: int,
) -> float:  # fmt: skip
    """Return the part of a step for which a piece, clear now, was inside a surface.

    Samples its corners and rim on the path since the last detection, in straight motion and uniform
    rotation. A piece that starts inside is leaving, and does not count.
    """
    (p, s), pieces = pair, numbers.pieces
    b = pieces.bodies[p]
    manifold, features = np.empty((POINTS, FOUND)), np.empty(POINTS, np.int64)
    frame, within, was_clear, inside = np.empty(3), 0.0, False, 0
    for i in range(samples):
        back = 1.0 - i / samples
        shape = shape_at(pieces, p, mid.poses[b] - back * h * mid.old_rates[b])
        for d in range(3):
            frame[d] = frames[1, d] + back * (frames[0, d] - frames[1, d])
        points = surface_contacts(
            numbers.surfaces, s, frame, ground.registers, shape, within, manifold, features
        )
        deepest = 0.0
        for at in range(points):
            deepest = min(deepest, manifold[at, 4])
        was_clear = was_clear or deepest == 0.0
        if was_clear and deepest < -_GRAZED * pieces.cores[p]:
            inside += 1
    return inside / samples
