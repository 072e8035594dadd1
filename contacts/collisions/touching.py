"""Who touches whom in the middle of a step, and which contacts take part in it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collisions.applied import ForceProgram, apply
from contacts.collisions.body_numbers import MEMORY, BodyNumbers, Memory
from contacts.collisions.broad_phase import Grid, near_pairs
from contacts.collisions.detection import FOUND, between, placed
from contacts.collisions.islands import velocity
from contacts.collisions.joints import BOTH, JointNumbers, joint_rows
from contacts.collisions.meeting import met, nearby, overlap
from contacts.collisions.seams import exposed
from contacts.collisions.surfaces import (
    against_surface,
    carried,
    crossed,
    distance,
    seen_from,
)
from contacts.solvers.contact_rows import GUIDED, HELD
from contacts.time_stepping.chunk import APART, BESIDE, HIT, SLOW, arriving
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import beside, late, part

# Points of contact that a pair can have: a polygon on a surface has as many as corners.
_POINTS = 16
# What is past another, within this part of their radii, since the last look has missed it; and of
# what crosses much of its size in a step, where farther out it approaches at a tenth of its speed.
_CORE, _WHOLE = 0.9, 0.995
# Bodies that cross less than this part of their size in a step are looked at once.
_CROSSED = 0.5
# Of the size of the smaller one: what is hit deeper than this in another is looked at more often.
_SUNK = 0.25
# What is hit in the step nearest to its arrival is so deep at most, in parts of the way that the
# fastest goes in a step.
_LANDED = 0.5
# What is to be hit ahead of its arrival is by then no farther than this part of its gap.
_ARRIVED = 0.01
# The cosine of the angle by which the normal of a hit may turn from its look to the touch.
_ALIKE = 0.8
# What came in by another side than it leaves by has crossed for this part of a step at most.
_ELSEWHERE = 0.5


class Look(NamedTuple):
    """Bodies in the middle of a step.

    Attributes
    ----------
    places, old, loose : (b, 3)
        Where they are; their rates before the step, and after it without contacts.
    centres, drifts : (p, 2), world : (v, 2)
        Middles of pieces in the world and their velocities before the step; corners of polygons.
    reach : (p,)
        How far a piece moves within two steps, and since the last look.
    gaps : (b,)
        To what is nearest, where that is found.
    pull : (b,)
        How much faster gravity, or a surface that moves, makes a body within the step.
    """

    places: Array
    old: Array
    loose: Array
    centres: Array
    drifts: Array
    world: Array
    reach: Array
    gaps: Array
    pull: Array

    @classmethod
    def room(cls, numbers: BodyNumbers) -> Look:
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


class Touches(NamedTuple):
    """Contacts that take part in a step.

    Attributes
    ----------
    bodies : (c, 2) array of int
        Which touch; -1: a surface.
    rows : (c, 2, 6)
        Velocities, normal and tangential, per unit rates of the two.
    keys : (c, 2) array of int, memory : (c, MEMORY)
        See `Memory`; in the place of lasting, how far the contact is above its level.
    materials : (c, 3)
        See `BodyNumbers`.
    before, free, wanted : (c, 2)
        Velocities before the step, and after it without impulses; what these may not fall below,
        negated.
    pushes : (c, 2)
        Impulses of the step before.
    carries : (c,)
        Velocity of the surface along the contact, where it has a path.
    hit : (c,) array of bool
        Who is struck.
    """

    bodies: Ints
    rows: Array
    keys: Ints
    memory: Array
    materials: Array
    before: Array
    free: Array
    wanted: Array
    pushes: Array
    carries: Array
    hit: Bools

    @classmethod
    def room(cls, most: int) -> Touches:
        """Return place for so many contacts."""
        return cls(
            np.empty((most, 2), np.int64),
            np.zeros((most, 2, 6)),
            np.empty((most, 2), np.int64),
            np.empty((most, MEMORY)),
            np.empty((most, 3)),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty(most),
            np.empty(most, np.bool_),
        )


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


class Seen(NamedTuple):
    """What a look has found.

    Attributes
    ----------
    contacts : int
        That take part; -1: more than there is place for.
    approach, closing : float
        The fastest approach of what touches; the deepest that an impact is.
    passed : float
        See `contacts.time_stepping.chunk.Chunk`.
    sunk : float
        By how much the deepest that was not known yet is deeper than two looks explain; or how
        deep what is hit is, where that is much beside its size.
    """

    contacts: int
    approach: float
    closing: float
    passed: float
    sunk: float


@part
def look_at(numbers: BodyNumbers, state: Array, h: float, past: float, look: Look) -> None:
    """Move bodies to the middle of a step, in place, and write what they are there.

    The step before was `past` long: what they have passed since its middle is within their reach.
    """
    places, old, loose, centres, drifts, world, reach, gaps, pull = look
    count, pieces = len(numbers.sizes), numbers.pieces
    gx, gy = numbers.gravity
    fall = math.hypot(gx, gy) * h
    for b in range(count):
        for d in range(3):
            at = 3 * b + d
            old[b, d] = loose[b, d] = state[3 * count + at]
            state[at] += 0.5 * h * old[b, d]
            places[b, d] = state[at]
        x, y, angle = places[b]
        first, end = pieces.begins[b], pieces.begins[b + 1]
        placed(pieces.middles, first, end, x, y, angle, centres)
        placed(pieces.vertices, pieces.firsts[first], pieces.firsts[end], x, y, angle, world)
        loose[b, 0] += h * gx
        loose[b, 1] += h * gy
        for p in range(first, end):
            drifts[p, 0] = old[b, 0] - old[b, 2] * (centres[p, 1] - y)
            drifts[p, 1] = old[b, 1] + old[b, 2] * (centres[p, 0] - x)
            speed = math.hypot(old[b, 0], old[b, 1]) + pieces.spans[p] * abs(old[b, 2]) + fall
            reach[p] = max(2.0 * h, 0.5 * (h + past)) * speed
        gaps[b], pull[b] = math.inf, fall


@late
def pushed(
    numbers: BodyNumbers, forces: ForceProgram, registers: tuple[int, Array], memory: Array,
    time: float, h: float, look: Look,
) -> None:  # fmt: skip
    """Let forces act on bodies in a step that are looked at."""
    apply(forces, registers, look.places, look.old, memory, time, numbers.inverse, h, look.loose)
    for b in forces.bodies:
        sped = math.hypot(look.loose[b, 0] - look.old[b, 0], look.loose[b, 1] - look.old[b, 1])
        turned, inverse = abs(look.loose[b, 2] - look.old[b, 2]), numbers.inverse[b]
        for p in range(numbers.pieces.begins[b], numbers.pieces.begins[b + 1]):
            look.reach[p] += 2.0 * h * (sped + numbers.pieces.spans[p] * turned)
        # As fast as the same energy would make it without turning.
        look.pull[b] = math.sqrt(sped**2 + turned**2 * inverse[0] / inverse[2])


@late
def joined(
    numbers: BodyNumbers, places: Array, memory: Memory, look: Look, h: float, count: int,
    touches: Touches,
) -> int:  # fmt: skip
    """Append the joints to the contacts of a step; return how many there are in all.

    Parameters
    ----------
    numbers, memory, look, h, touches
        See `touching`.
    places : (3, j, 2)
        Where what they hold points to is at this look, the one before and the next.
    count : int
        Contacts.
    """
    joints, pieces = numbers.joints, len(numbers.pieces.sizes)
    first, at_old, m = pieces * (pieces + len(numbers.surfaces.kinds)), 0, count
    for j in range(len(joints.holds)):
        b = joints.bodies[j, 0]
        touches.bodies[m, 0], touches.bodies[m, 1] = b, joints.bodies[j, 1]
        bent = joint_rows(
            joints, j, look.places, look.old, look.loose, places, h, touches.rows[m],
            touches.before[m], touches.free[m], touches.wanted[m],
        )  # fmt: skip
        look.pull[b] += bent
        touches.materials[m, 0] = HELD if joints.holds[j] == BOTH else GUIDED
        touches.materials[m, 1] = touches.materials[m, 2] = touches.carries[m] = 0.0
        touches.hit[m] = False
        while at_old < memory.many[0] and memory.keys[at_old, 0] < first + j:
            at_old += 1
        _recalled(memory, at_old, first + j, 0, h, m, touches)
        touches.keys[m, 0], touches.keys[m, 1] = first + j, 0
        touches.memory[m, 0] = touches.memory[m, 1] = 0.0
        m += 1
    return m


@part
def _held(joints: JointNumbers, one: int, other: int) -> bool:
    """Whether a joint holds two bodies together."""
    for j in range(len(joints.holds)):
        a, b = joints.bodies[j]
        if (a == one and b == other) or (a == other and b == one):
            return True
    return False


@part
def _felt(look: Look, b: int, c: int, found: Array, m: int, touches: Touches) -> None:
    """Write the rows of a point of contact, and its velocities."""
    bodies, rows, centres = touches.bodies, touches.rows, look.places
    nx, ny, x, y = found[0], found[1], found[2], found[3]
    bodies[m, 0], bodies[m, 1] = b, c
    for d in range(2):
        ux, uy = (nx, ny) if d == 0 else (ny, -nx)
        rx, ry = x - centres[b, 0], y - centres[b, 1]
        rows[m, d, 0], rows[m, d, 1], rows[m, d, 2] = ux, uy, rx * uy - ry * ux
        if c >= 0:
            rx, ry = x - centres[c, 0], y - centres[c, 1]
            rows[m, d, 3], rows[m, d, 4], rows[m, d, 5] = -ux, -uy, -(rx * uy - ry * ux)
        touches.before[m, d] = velocity(bodies, rows, look.old, m, d)
        touches.free[m, d] = velocity(bodies, rows, look.loose, m, d)


@late
def _arrives(
    numbers: BodyNumbers, look: Look, pair: tuple[int, int], normal: tuple[float, float],
    gap: float, nearing: float, h: float, aside: Array,
) -> tuple[bool, float]:  # fmt: skip
    """Return whether bodies that are not beside each other touch, and for how long they did.

    Ahead of its arrival, or behind, other corners and edges of a fast body are the nearest.
    """
    later = max(gap / nearing, -h)
    arrived, along = met(numbers, look.places, look.old, pair, later, normal, aside)
    if gap > 0.0 and not arrived <= _ARRIVED * gap:
        return False, 0.0
    return True, _ELSEWHERE if along < _ALIKE else 0.0


@late
def _came(
    numbers: BodyNumbers, look: Look, pair: tuple[int, int], normal: tuple[float, float],
    since: float, aside: Array,
) -> float:  # fmt: skip
    """Return for how long a body was in another that it leaves: if it came by another side."""
    earlier, _ = met(numbers, look.places, look.old, pair, -since, normal, aside)
    return _ELSEWHERE if earlier > 0.0 else 0.0


@part
def _recalled(
    memory: Memory, first: int, pair: int, feature: int, h: float, m: int, touches: Touches
) -> tuple[float, bool]:
    """Write the impulses that a contact had in a step; return its level, and if it lasts."""
    touches.pushes[m, 0] = touches.pushes[m, 1] = 0.0
    level, lasting, at = 0.0, False, first
    # Forces last, so that impulses go with the length of a step.
    longer = h / memory.past[0] if memory.past[0] > 0.0 else 1.0
    while at < memory.many[0] and memory.keys[at, 0] == pair:
        if memory.keys[at, 1] == feature:
            level, lasting = memory.contacts[at, 0], memory.contacts[at, 1] > 0.0
            touches.pushes[m, 0] = longer * memory.contacts[at, 2]
            touches.pushes[m, 1] = longer * memory.contacts[at, 3]
        at += 1
    return level, lasting


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
def _on_surface(
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
def _carried_along(frames: Array, found: Array, h: float, m: int, touches: Touches) -> float:
    """Take the motion of a surface from a contact's velocities; return its pull.

    It moves from look to look, as the bodies do.
    """
    nx, ny, x, y = found[0], found[1], found[2], found[3]
    before, free = touches.before, touches.free
    u, v = _moved(frames, x, y, 0)
    before[m, 0] -= (nx * (x - u) + ny * (y - v)) / h
    before[m, 1] -= (ny * (x - u) - nx * (y - v)) / h
    u, v = _moved(frames, x, y, 2)
    touches.carries[m] = (ny * (u - x) - nx * (v - y)) / h
    free[m, 0] -= (nx * (u - x) + ny * (v - y)) / h
    free[m, 1] -= touches.carries[m]
    return math.hypot(free[m, 0] - before[m, 0], free[m, 1] - before[m, 1])


@beside
def touching(
    numbers: BodyNumbers, ground: Ground, memory: Memory, look: Look, grid: Grid, h: float,
    touches: Touches,
) -> Seen:  # fmt: skip
    """Find the contacts that take part in a step.

    Parameters
    ----------
    numbers : BodyNumbers
    ground : Ground
    memory : Memory
        Of the step before.
    look : Look
        Its gaps and pulls are written.
    grid : Grid
        Is overwritten.
    h : float
        Length of the step.
    touches : Touches
        To be filled.
    """
    pieces, surfaces, pairs = numbers.pieces, numbers.surfaces, grid.pairs
    bodies, sizes, radii, cores = pieces.bodies, pieces.sizes, pieces.radii, pieces.cores
    firsts, centres, drifts = pieces.firsts, look.centres, look.drifts
    p_count, s_count = len(sizes), len(surfaces.kinds)
    found, aside = np.empty((_POINTS, FOUND)), np.empty((_POINTS, FOUND))
    features, near = np.empty(_POINTS, np.int64), np.empty(p_count, np.int64)
    # Between looks bodies move in straight lines.
    since = 0.5 * (h + (memory.past[0] if memory.past[0] > 0.0 else h))
    fall = math.hypot(numbers.gravity[0], numbers.gravity[1]) * h
    lowest = _LANDED * memory.past[2]
    m, at_old, at_pair = 0, 0, 0
    approach = closing = passed = sunk = 0.0
    many = near_pairs(centres, sizes + look.reach, grid)
    if many < 0:
        return Seen(-1, approach, closing, passed, sunk)
    for p in range(p_count):
        count, b = 0, bodies[p]
        while at_pair < many and pairs[at_pair, 0] == p:
            near[count] = pairs[at_pair, 1]
            count += 1
            at_pair += 1
        for i in range(count + s_count):
            q = near[i] if i < count else p_count + i - count
            s = q - p_count
            # What it touches: a body, also one that carries a surface, or none.
            whole, other, moves = s < 0, bodies[q] if s < 0 else surfaces.carriers[s], False
            if other == b:
                continue
            if whole:
                material = numbers.laws[numbers.kinds[b], numbers.kinds[other]]
                if material < 0 or _held(numbers.joints, b, other):
                    continue
                # In short steps all that follows is within their error.
                slowly = nearby(drifts, sizes, p, q, _CROSSED / since)
                # Of what grazes the approach is slow.
                core = _CORE if slowly else _WHOLE
                begin, end = overlap(centres, drifts, p, q, core * (cores[p] + cores[q]))
                if -since < begin and begin + end < 0.0:
                    passed = max(passed, (end - begin) / h)
                points = between(
                    look.world[firsts[p] : firsts[p + 1]], centres[p], radii[p],
                    look.world[firsts[q] : firsts[q + 1]], centres[q], radii[q],
                    look.reach[p] + look.reach[q], found, features,
                )  # fmt: skip
            else:
                material = numbers.laws[numbers.kinds[b], len(numbers.laws) + s]
                if material < 0:
                    continue
                slowly, moves = True, other < 0 and surfaces.moves[s]
                points, crosses = _on_surface(numbers, ground, look, p, s, h, found, features)
                passed = max(passed, crosses)
            if pieces.begins[b + 1] - pieces.begins[b] > 1:
                points = exposed(pieces, centres, look.world, p, -1.0, found, features, points)
            if whole and pieces.begins[other + 1] - pieces.begins[other] > 1:
                points = exposed(pieces, centres, look.world, q, 1.0, found, features, points)
            pair = p * (p_count + s_count) + q
            while at_old < memory.many[0] and memory.keys[at_old, 0] < pair:
                at_old += 1
            known = at_old < memory.many[0] and memory.keys[at_old, 0] == pair
            for at in range(points):
                nx, ny, gap = found[at, 0], found[at, 1], found[at, 4]
                look.gaps[b] = min(look.gaps[b], gap)
                if other >= 0:
                    look.gaps[other] = min(look.gaps[other], gap)
                level, lasting = _recalled(memory, at_old, pair, features[at], h, m, touches)
                _felt(look, b, other, found[at], m, touches)
                touches.carries[m] = 0.0
                if moves:
                    pull = _carried_along(ground.frames, found[at], h, m, touches)
                    look.pull[b] = max(look.pull[b], pull)
                nearing = -touches.before[m, 0]
                changed = touches.free[m, 0] - touches.before[m, 0]
                gained = max(abs(changed), fall)
                slow = SLOW * gained
                if gap < 0.0 and not known:
                    explained = since * max(memory.past[1], nearing, slow)
                    sunk = max(sunk, -gap - explained)
                # Struck in the step whose middle is nearest to the instant of touching.
                role, level, above = arriving(
                    gap, level, lasting, nearing, touches.free[m, 0], slow, 0.5 + BESIDE, h
                )
                if role == HIT and gap > 0.0 and whole and radii[p] * radii[q] > 0.0:
                    # Discs that are near and fast may pass beside each other.
                    touch, _ = overlap(centres, drifts, p, q, radii[p] + radii[q])
                    role = HIT if touch <= h else APART
                if role == HIT and not (known or slowly):
                    arrives, crossed = _arrives(
                        numbers, look, (p, q), (nx, ny), gap, nearing, h, aside
                    )
                    passed = max(passed, crossed)
                    role = HIT if arrives else APART
                if gap < 0.0 and -nearing > slow and not (known or slowly):
                    # It leaves: if it was not in it at the last look, it came by another side.
                    crossed = _came(numbers, look, (p, q), (nx, ny), since, aside)
                    passed = max(passed, crossed)
                if role == APART:
                    continue
                touches.hit[m] = role == HIT
                touches.wanted[m, 0] = touches.wanted[m, 1] = 0.0
                if role == HIT:
                    touches.wanted[m, 0] = -numbers.materials[material, 2] * nearing
                    approach = max(approach, nearing)
                    closing = max(closing, -gap)
                    if -gap > _SUNK * (min(sizes[p], sizes[q]) if whole else sizes[p]):
                        sunk = max(sunk, -gap)
                else:
                    # No deeper than an impact leaves a contact does it stay.
                    above, level = min(above, gap + lowest), max(level, -lowest)
                    # A point that turns away faster than forces follow lifts off. What is deeper
                    # than that makes came there as its normal turned, and goes back as fast, or
                    # by a change of features.
                    touches.wanted[m, 0] = max(above / h, -max(0.5 * gained, nearing))
                    approach = max(approach, nearing)
                for d in range(3):
                    touches.materials[m, d] = numbers.materials[material, d]
                touches.keys[m, 0], touches.keys[m, 1] = pair, features[at]
                touches.memory[m, 0] = level
                touches.memory[m, 1] = 0.0 if lasting or role == HIT else above
                if not lasting:
                    # An impact's impulses say nothing of the next.
                    touches.pushes[m, 0] = touches.pushes[m, 1] = 0.0
                m += 1
                if m == len(touches.hit):
                    return Seen(-1, approach, closing, passed, sunk)
    return Seen(m, approach, closing, passed, sunk)
