"""Midpoint configuration of a step: poses, forces and reach of bodies.

Linked bodies have poses p(q) and rates G q' with G = dp/dq; forces F on them give M(q) q'' = f(q,
q') + G^T F. In arrays of rates (b + k, 3) the coordinates' rates fill the last k rows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers, LinkNumbers
from contacts.collision_detection.convex import norm, write_placed_vertices
from contacts.solvers.saddle_point import factorise, substitute
from statechart.arrays import Array, Ints, Ints32
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import run_tape


class ForceProgram(NamedTuple):
    """Forces and moments on some bodies."""

    bodies: Ints  # shape (f,)
    # Tape (`statechart.formulas.tape.Tape`) over state and parameters: force (2) and moment each.
    code: Ints32
    constants: Array
    outputs: Ints32
    values: Array


class LimitProgram(NamedTuple):
    """Limits of couplings: a tape of `contacts.collision_detection.couplings.STATIC` and so on."""

    code: Ints32
    constants: Array
    outputs: Ints32
    values: Array


class Prescribed(NamedTuple):
    """Prescribed motion and forces of the next steps."""

    # At the midpoints of the previous step, these steps and the one after: poses of led bodies,
    # controller variables.
    poses: Array  # shape (k + 2, l, 3)
    controller_states: Array  # shape (k + 2, w)
    forces: ForceProgram
    limits: LimitProgram

    def after(self, count: int) -> Prescribed:
        """Return the prescribed motion after so many steps."""
        return self._replace(
            poses=self.poses[count:], controller_states=self.controller_states[count:]
        )


TOUCH_TOLERANCE = 1e-12
"""Round-off of positions, relative to the smaller body: bodies this near touch."""


class LinkMotion(NamedTuple):
    """Gradients and compliance of linked bodies at a midpoint."""

    gradients: Array  # (l, 3, c): Jacobian of the poses.
    # (c, c): inverse of M - h/2 df/dq', for inertial forces at the mean of the rates.
    compliance: Array

    @classmethod
    def allocate(cls, links: LinkNumbers) -> LinkMotion:
        """Allocate its arrays."""
        return cls(np.zeros((links.bodies, 3, links.size)), np.zeros((links.size, links.size)))


class Midpoint(NamedTuple):
    """Bodies in the middle of a step."""

    # (b + 1, 3): poses; (b + k + 1, 3): rates before the step, and after it without contacts. Rates
    # of led bodies are differences between midpoints. The last rows are the world's, zero.
    poses: Array
    old_rates: Array
    free_rates: Array
    # In the world: centres of pieces, their velocities before the step, polygon corners.
    centres: Array  # shape (p, 2)
    drifts: Array  # shape (p, 2)
    world: Array  # shape (v, 2)
    # (p,): largest motion of a piece within two steps and since the last detection, plus tolerance.
    reach: Array
    gaps: Array  # (b,): smallest gap found.
    deepest: Ints  # (b,): the piece or surface at that gap.
    # (b,): speed that gravity, forces or prescribed motion give in the step.
    force_speed: Array
    links: LinkMotion

    @classmethod
    def allocate(cls, numbers: BodyNumbers) -> Midpoint:
        """Allocate its arrays."""
        count, pieces = len(numbers.sizes), len(numbers.pieces.sizes)
        return cls(
            np.zeros((count + 1, 3)), np.zeros((count + numbers.links.rows + 1, 3)),
            np.zeros((count + numbers.links.rows + 1, 3)), np.empty((pieces, 2)),
            np.empty((pieces, 2)), np.empty_like(numbers.pieces.vertices), np.empty(pieces),
            np.empty(count), np.empty(count, np.int64), np.empty(count),
            LinkMotion.allocate(numbers.links),
        )  # fmt: skip


@kernel
def write_linked_rates(numbers: BodyNumbers, mid: Midpoint, rates: Array) -> None:
    """Write the rates G q' of linked bodies, in place."""
    count, size, whole = numbers.links.bodies, numbers.links.size, len(numbers.sizes)
    free, gradients = len(numbers.inverse) - count, mid.links.gradients
    for i in range(count):
        for d in range(3):
            total = 0.0
            for j in range(size):
                total += gradients[i, d, j] * rates[whole + j // 3, j % 3]
            rates[free + i, d] = total


@kernel
def apply_link_impulse(
    numbers: BodyNumbers, mid: Midpoint, b: int, x: float, y: float, turn: float, rates: Array
) -> None:
    """Apply an impulse (x, y, moment) on linked body b to the rates of the coordinates."""
    size, whole = numbers.links.size, len(numbers.sizes)
    gradients = mid.links.gradients[b - len(numbers.inverse) + numbers.links.bodies]
    for j in range(size):
        push = x * gradients[0, j] + y * gradients[1, j] + turn * gradients[2, j]
        for k in range(size):
            rates[whole + k // 3, k % 3] += mid.links.compliance[k, j] * push


@kernel
def place_links(
    numbers: BodyNumbers, state: Array, h: float, registers: tuple[int, Array], mid: Midpoint
) -> bool:
    """Move the coordinates to the middle of a step, in place, and place the linked bodies.

    Returns whether the mass matrix is regular. `registers` are those of `LinkNumbers`.
    """
    links, whole, (base, values) = numbers.links, len(numbers.sizes), registers
    count, size, free = links.bodies, links.size, len(numbers.inverse) - links.bodies
    first, n = 3 * free, 3 * free + size
    outputs, gradients, compliance = links.outputs, mid.links.gradients, mid.links.compliance
    for row in range(whole, len(mid.old_rates)):
        for d in range(3):
            mid.old_rates[row, d] = mid.free_rates[row, d] = 0.0
    for j in range(size):
        rate = state[n + first + j]
        state[first + j] += 0.5 * h * rate
        values[j, 0], values[size + j, 0] = state[first + j], rate
        mid.old_rates[whole + j // 3, j % 3] = rate
    values[2 * size, 0] = 0.0
    run_tape(links.code, 0, len(links.code), base, values, 1)
    at, mass = 3 * count, np.empty((size, size))
    for i in range(count):
        for d in range(3):
            mid.poses[free + i, d] = values[outputs[3 * i + d], 0]
            for j in range(size):
                gradients[i, d, j] = values[outputs[at], 0]
                at += 1
    for j in range(size):
        for k in range(size):
            mass[j, k] = values[outputs[at], 0]
            mass[j, k] -= 0.5 * h * values[outputs[at + size * size], 0]
            at += 1
    at += size * size
    order, unit = np.arange(size), np.zeros(size)
    if not factorise(mass, order, np.empty((size, size))):
        return False
    column = np.empty(size)
    for j in range(size):
        unit[j] = 1.0
        substitute(mass, order, unit, column)
        unit[j] = 0.0
        for k in range(size):
            compliance[k, j] = column[k]
    for k in range(size):
        row, d = whole + k // 3, k % 3
        mid.free_rates[row, d] = mid.old_rates[row, d]
        for j in range(size):
            mid.free_rates[row, d] += h * compliance[k, j] * values[outputs[at + j], 0]
    write_linked_rates(numbers, mid, mid.old_rates)
    write_linked_rates(numbers, mid, mid.free_rates)
    return True


@kernel
def _equivalent_speed(numbers: BodyNumbers, mid: Midpoint, b: int) -> float:
    """Return the translational speed with the energy of a body's change of rates."""
    sped = norm(
        mid.free_rates[b, 0] - mid.old_rates[b, 0], mid.free_rates[b, 1] - mid.old_rates[b, 1]
    )
    turned, inverse = mid.free_rates[b, 2] - mid.old_rates[b, 2], numbers.inverse[b]
    return math.sqrt(sped**2 + turned**2 * inverse[0] / inverse[2])


@kernel
def move_to_midpoint(
    numbers: BodyNumbers, state: Array, poses: Array, h: float, past: float, mid: Midpoint
) -> None:
    """Move bodies to the middle of a step, in place, and write the midpoint.

    `past` is the previous step size: motion since its midpoint is within the reach. `poses` (3, l,
    3) are those of led bodies at the previous midpoint, this one and the next. Linked bodies are
    placed before (see `place_links`).
    """
    places, old, loose, centres, drifts, world, reach, gaps, _, pull, _ = mid
    count, pieces = len(numbers.inverse), numbers.pieces
    free = count - numbers.links.bodies
    n = 3 * free + numbers.links.size
    gx, gy = numbers.gravity
    fall = norm(gx, gy) * h
    for b in range(len(numbers.sizes)):
        led = b - count
        for d in range(3):
            at = 3 * b + d
            if b < free:
                old[b, d] = loose[b, d] = state[n + at]
                state[at] += 0.5 * h * old[b, d]
                places[b, d] = state[at]
            elif led < 0:
                continue
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
        # A centred disc needs no rotation.
        if end - first != 1 or pieces.spans[first] != pieces.radii[first]:
            c, s = math.cos(angle), math.sin(angle)
        write_placed_vertices(pieces.middles, first, end, x, y, c, s, centres)
        write_placed_vertices(
            pieces.vertices, pieces.firsts[first], pieces.firsts[end], x, y, c, s, world
        )
        sped = 0.0
        if b < free:
            loose[b, 0] += h * gx
            loose[b, 1] += h * gy
            sped = fall
        fast = norm(old[b, 0], old[b, 1])
        for p in range(first, end):
            drifts[p, 0] = old[b, 0] - old[b, 2] * (centres[p, 1] - y)
            drifts[p, 1] = old[b, 1] + old[b, 2] * (centres[p, 0] - x)
            speed = fast + pieces.spans[p] * abs(old[b, 2]) + sped
            if b >= free:
                next_speed = norm(loose[b, 0], loose[b, 1]) + pieces.spans[p] * abs(loose[b, 2])
                speed = max(speed, next_speed)
            reach[p] = max(2.0 * h, 0.5 * (h + past)) * speed + TOUCH_TOLERANCE * pieces.sizes[p]
        gaps[b] = math.inf
        pull[b] = _equivalent_speed(numbers, mid, b) if free <= b < count else sped


@kernel
def run_at(
    numbers: BodyNumbers, code: Ints32, registers: tuple[int, Array], memory: Array, state: Array,
    time: float,
) -> None:  # fmt: skip
    """Run a tape over a state, controller variables (w,) and time in its registers.

    For `registers` see `statechart.kernels.tapes.allocate_registers`.
    """
    base, values = registers
    at = 2 * (3 * (len(numbers.inverse) - numbers.links.bodies) + numbers.links.size)
    for i in range(at):
        values[i, 0] = state[i]
    for j in range(len(memory)):
        values[at + j, 0] = memory[j]
    values[at + len(memory), 0] = time
    run_tape(code, 0, len(code), base, values, 1)


@kernel
def apply_forces(
    numbers: BodyNumbers, forces: ForceProgram, registers: tuple[int, Array], memory: Array,
    state: Array, time: float, h: float, mid: Midpoint,
) -> None:  # fmt: skip
    """Apply forces on bodies in a step, and extend their reach.

    `registers`: of the force tape (see `statechart.kernels.tapes.allocate_registers`); `memory`
    (w,): controller variables at the midpoint.
    """
    free, linked = len(numbers.inverse) - numbers.links.bodies, False
    run_at(numbers, forces.code, registers, memory, state, time)
    values = registers[1]
    for i in range(len(forces.bodies)):
        b, linked = forces.bodies[i], linked or forces.bodies[i] >= free
        if b >= free:
            x, y = values[forces.outputs[3 * i], 0], values[forces.outputs[3 * i + 1], 0]
            turn = values[forces.outputs[3 * i + 2], 0]
            apply_link_impulse(numbers, mid, b, h * x, h * y, h * turn, mid.free_rates)
            continue
        for d in range(3):
            force = values[forces.outputs[3 * i + d], 0]
            mid.free_rates[b, d] += h * numbers.inverse[b, d] * force
        _extend_reach(numbers, mid, b, h)
    if linked:
        write_linked_rates(numbers, mid, mid.free_rates)
        for b in range(free, len(numbers.inverse)):
            _extend_reach(numbers, mid, b, h)


@kernel
def _extend_reach(numbers: BodyNumbers, mid: Midpoint, b: int, h: float) -> None:
    """Extend the reach of a body by its motion under forces."""
    sped = norm(
        mid.free_rates[b, 0] - mid.old_rates[b, 0], mid.free_rates[b, 1] - mid.old_rates[b, 1]
    )
    turned = abs(mid.free_rates[b, 2] - mid.old_rates[b, 2])
    for p in range(numbers.pieces.begins[b], numbers.pieces.begins[b + 1]):
        mid.reach[p] += 2.0 * h * (sped + numbers.pieces.spans[p] * turned)
    mid.force_speed[b] = _equivalent_speed(numbers, mid, b)


@kernel
def fastest_turn(rates: Array) -> float:
    """Return the largest absolute angular velocity."""
    most = 0.0
    for b in range(len(rates)):
        most = max(most, abs(rates[b, 2]))
    return most
