"""Bodies in the middle of a step: where they are, what moves them, how far they reach."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers
from contacts.collision_detection.convex import norm, placed
from statechart.arrays import Array, Ints, Ints32
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import run_tape


class ForceProgram(NamedTuple):
    """Forces and moments on some bodies."""

    bodies: Ints  # (f,): which.
    # The program (see `statechart.formulas.tape.Tape`) over the state of a run, and the parameters:
    # two components and a moment for each.
    code: Ints32
    constants: Array
    outputs: Ints32
    values: Array


class Prescribed(NamedTuple):
    """Prescribed motion and forces in the next steps."""

    # Frames of surfaces, and points that joints hold to in the world, at the midpoints of the
    # steps, of the step before and of the one after.
    frames: Array  # shape (k + 2, s, 3)
    places: Array  # shape (k + 2, j, 2)
    poses: Array  # (k + 2, l, 3): led bodies, then.
    memories: Array  # (k + 2, w): what controllers remember then.
    forces: ForceProgram

    def after(self, count: int) -> Prescribed:
        """Return what acts after so many steps."""
        return self._replace(
            frames=self.frames[count:],
            places=self.places[count:],
            poses=self.poses[count:],
            memories=self.memories[count:],
        )


TOUCHING = 1e-12
"""Bodies this near, in parts of the size of the smaller one, touch: where they are is rounded."""


class Midpoint(NamedTuple):
    """Bodies in the middle of a step."""

    # (b, 3): where they are; their rates before the step, and after it without contacts. Rates of
    # led bodies take them from midpoint to midpoint.
    places: Array
    old: Array
    loose: Array
    # Middles of pieces in the world and their velocities before the step; corners of polygons.
    centres: Array  # shape (p, 2)
    drifts: Array  # shape (p, 2)
    world: Array  # shape (v, 2)
    # (p,): how far a piece moves within two steps, and since the last detection, and is taken to
    # touch.
    reach: Array
    gaps: Array  # (b,): to what is nearest, where that is found.
    # (b,): how much faster gravity, or what moves as prescribed, makes a body within the step.
    pull: Array

    @classmethod
    def allocate(cls, numbers: BodyNumbers) -> Midpoint:
        """Return place for it."""
        count, pieces = len(numbers.sizes), len(numbers.pieces.sizes)
        return cls(
            np.empty((count, 3)),
            np.empty((count, 3)),
            np.empty((count, 3)),
            np.empty((pieces, 2)),
            np.empty((pieces, 2)),
            np.empty_like(numbers.pieces.vertices),
            np.empty(pieces),
            np.empty(count),
            np.empty(count),
        )


@kernel
def move_to_midpoint(
    numbers: BodyNumbers, state: Array, poses: Array, h: float, past: float, mid: Midpoint
) -> None:
    """Move bodies to the middle of a step, in place, and write what they are there.

    The step before was `past` long: what they have passed since its middle is within their reach.
    `poses` (3, l, 3) are those of led bodies at the midpoint before, at this one and at the next.
    """
    places, old, loose, centres, drifts, world, reach, gaps, pull = mid
    count, pieces = len(numbers.inverse), numbers.pieces
    gx, gy = numbers.gravity
    fall = norm(gx, gy) * h
    for b in range(len(numbers.sizes)):
        led = b - count
        for d in range(3):
            at = 3 * b + d
            if led < 0:
                old[b, d] = loose[b, d] = state[3 * count + at]
                state[at] += 0.5 * h * old[b, d]
                places[b, d] = state[at]
            elif led < poses.shape[1]:
                places[b, d] = poses[1, led, d]
                old[b, d] = (places[b, d] - poses[0, led, d]) / h
                loose[b, d] = (poses[2, led, d] - places[b, d]) / h
            else:
                places[b, d] = numbers.fixed[led - poses.shape[1], d]
                old[b, d] = loose[b, d] = 0.0
        x, y, angle = places[b]
        first, end = pieces.begins[b], pieces.begins[b + 1]
        c, s = 1.0, 0.0
        # A disc about its body's centre looks the same however it turns.
        if end - first != 1 or pieces.spans[first] != pieces.radii[first]:
            c, s = math.cos(angle), math.sin(angle)
        placed(pieces.middles, first, end, x, y, c, s, centres)
        placed(pieces.vertices, pieces.firsts[first], pieces.firsts[end], x, y, c, s, world)
        sped = 0.0
        if led < 0:
            loose[b, 0] += h * gx
            loose[b, 1] += h * gy
            sped = fall
        fast = norm(old[b, 0], old[b, 1])
        for p in range(first, end):
            drifts[p, 0] = old[b, 0] - old[b, 2] * (centres[p, 1] - y)
            drifts[p, 1] = old[b, 1] + old[b, 2] * (centres[p, 0] - x)
            speed = fast + pieces.spans[p] * abs(old[b, 2]) + sped
            if led >= 0:
                next_speed = norm(loose[b, 0], loose[b, 1]) + pieces.spans[p] * abs(loose[b, 2])
                speed = max(speed, next_speed)
            reach[p] = max(2.0 * h, 0.5 * (h + past)) * speed + TOUCHING * pieces.sizes[p]
        gaps[b], pull[b] = math.inf, sped


@kernel
def apply_forces(
    numbers: BodyNumbers, forces: ForceProgram, registers: tuple[int, Array], memory: Array,
    time: float, h: float, mid: Midpoint,
) -> None:  # fmt: skip
    """Let forces act on bodies in a step, and extend what these reach.

    `registers` are those of the forces (see `statechart.kernels.tapes.filled`), `memory` (w,) is
    what controllers remember in the middle of the step.
    """
    (base, values), at = registers, 0
    for source in (mid.places, mid.old):
        for b in range(len(numbers.inverse)):
            for d in range(3):
                values[at, 0] = source[b, d]
                at += 1
    for j in range(len(memory)):
        values[at + j, 0] = memory[j]
    values[at + len(memory), 0] = time
    run_tape(forces.code, 0, len(forces.code), base, values, 1)
    for i in range(len(forces.bodies)):
        b = forces.bodies[i]
        for d in range(3):
            force = values[forces.outputs[3 * i + d], 0]
            mid.loose[b, d] += h * numbers.inverse[b, d] * force
    for b in forces.bodies:
        sped = norm(mid.loose[b, 0] - mid.old[b, 0], mid.loose[b, 1] - mid.old[b, 1])
        turned, inverse = abs(mid.loose[b, 2] - mid.old[b, 2]), numbers.inverse[b]
        for p in range(numbers.pieces.begins[b], numbers.pieces.begins[b + 1]):
            mid.reach[p] += 2.0 * h * (sped + numbers.pieces.spans[p] * turned)
        # As fast as the same energy would make it without turning.
        mid.pull[b] = math.sqrt(sped**2 + turned**2 * inverse[0] / inverse[2])


@kernel
def fastest_turn(rates: Array) -> float:
    """Return the largest angular velocity, of either sense."""
    most = 0.0
    for b in range(len(rates)):
        most = max(most, abs(rates[b, 2]))
    return most
