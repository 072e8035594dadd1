"""Time steps of many free bodies that collide, compiled once: block by block, island by island.

The scheme is that of `contacts.time_stepping.scene_step`. The mass matrix is diagonal; bodies that
touch each other form islands, each with a contact problem of its own, whose impulses are the best
that `contacts.solvers.island_impulses` finds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collisions.detection import FOUND, between, place
from contacts.collisions.islands import gathered, grouped, push, velocity
from contacts.collisions.meeting import met, nearby, overlap
from contacts.collisions.surfaces import (
    SurfaceNumbers,
    against_surface,
    carried,
    crossed,
    distance,
    seen_from,
)
from contacts.solvers.island_impulses import island_impulses, solve_rows
from contacts.states import FREE, PIN, SLIDE
from contacts.time_stepping.chunk import (
    APART,
    BESIDE,
    DONE,
    FULL,
    HIT,
    NOT_FINITE,
    SLOW,
    Chunk,
    arriving,
)
from statechart.arrays import Array, Ints
from statechart.kernels.copies import put, put_rows
from statechart.kernels.jit import kernel, part
from statechart.kernels.tapes import BLOCK, filled

MEMORY = 4
"""What is kept of a contact from step to step: level, lasting, impulses."""

# Points of contact that a pair can have: a polygon on a surface has as many as corners.
_POINTS = 16
# What is past another, within this part of their radii, since the last look has missed it; and of
# what crosses much of its size in a step, where farther out it approaches at a tenth of its speed.
_CORE, _WHOLE = 0.9, 0.995
# Bodies that cross less than this part of their size in a step are looked at once.
_CROSSED = 0.5
# What is to be hit ahead of its arrival is by then no farther than this part of its gap.
_ARRIVED = 0.01
# The cosine of the angle by which the normal of a hit may turn from its look to the touch.
_ALIKE = 0.8
# What came in by another side than it leaves by has crossed for this part of a step at most.
_ELSEWHERE = 0.5
# What is no farther from the edge of its cone than this part of its impulse slides.
_EDGE = 1e-9


class BodyNumbers(NamedTuple):
    """What does not change in a run of colliding bodies.

    Attributes
    ----------
    vertices : (v, 2), firsts : (b + 1,)
        Corners of all bodies in their frames, and where those of a body begin; none of discs.
    radii, sizes : (b,)
        Of discs; and how far a body reaches from its centre.
    cores : (b,)
        And how far it reaches at least.
    inverse : (b, 3)
        1/mass, 1/mass, 1/moment of inertia.
    gravity : (2,)
    surfaces : SurfaceNumbers
    pairs : (b, b + s) array of int
        Which law bodies touch each other and surfaces by; -1: they do not.
    materials : (m, 3)
        Laws: edge of the cone (2), restitution.
    """

    vertices: Array
    firsts: Ints
    radii: Array
    sizes: Array
    cores: Array
    inverse: Array
    gravity: Array
    surfaces: SurfaceNumbers
    pairs: Ints
    materials: Array


@part
def _frames(
    paths: Array, s: int, carrier: int, k: int, places: Array, old: Array, h: float, frames: Array
) -> None:
    """Write the frames (3, 3) of a surface: at the look before, at this one and the next."""
    for look in range(3):
        for d in range(3):
            if carrier >= 0:
                frames[look, d] = places[carrier, d] + (look - 1) * h * old[carrier, d]
            else:
                frames[look, d] = paths[k + look, s, d]


@part
def _moved(frames: Array, x: float, y: float, look: int) -> tuple[float, float]:
    """Return where the point of a surface that now is at x, y is at a look."""
    u, v = seen_from(frames[1], x, y)
    return carried(frames[look], u, v)


@kernel
def step_bodies(
    numbers: BodyNumbers,
    paths: Array,
    plastic: bool,
    keys: Ints,
    memory: Array,
    remembered: Ints,
    allowed: float,
    chunk: Chunk,
) -> tuple[int, int]:
    """Take the steps of a chunk; return (steps, status).

    Parameters
    ----------
    numbers : BodyNumbers
    paths : (k + 2, s, 3) array
        Where the frames of surfaces are at the midpoints of the steps, of the one before and of
        the one after; (1, s, 3) where none moves.
    plastic : bool
        Whether what is hit together does not rebound.
    keys : (c, 2), memory : (c, MEMORY), remembered : (1,)
        Contacts of the step before: pair and feature; see `MEMORY`; and how many they are. They
        must be more than take part in a step, else the status is `FULL`. Changed in place.
    allowed : float
        Residual of impulses that are good enough.
    chunk : Chunk
        To be filled, per body instead of per contact; the unknowns are accelerations alone.
    """
    vertices, firsts, radii, sizes, cores, inverse, gravity, surfaces, pairs, materials = numbers
    h, states, solved, codes, struck, _, impulses, gaps, approach, closing, passed, _, efforts = (
        chunk
    )
    state = states[0].copy()
    b_count, s_count = len(sizes), len(surfaces.kinds)
    registers = filled(surfaces.code, surfaces.constants, surfaces.values, 1, BLOCK)
    registers[1][1] = 0.0
    still, swung = np.zeros((3, 3)), np.zeros((3, 3))
    n = 3 * b_count
    most = len(keys)
    found, aside = np.empty((_POINTS, FOUND)), np.empty((_POINTS, FOUND))
    bodies = np.empty((most, 2), np.int64)
    rows = np.empty((most, 2, 6))
    new_keys = np.empty((most, 2), np.int64)
    new_memory = np.empty((most, MEMORY))
    cones, elastic = np.empty((most, 2)), np.empty(most)
    before, free, wanted = np.empty((most, 2)), np.empty((most, 2)), np.empty((most, 2))
    pushes, steady = np.empty((most, 2)), np.empty((most, 2))
    hit, bounces = np.empty(most, np.bool_), np.empty(most, np.bool_)
    carries = np.zeros(most)
    pull = np.empty(b_count)
    parents, begins = np.empty(b_count, np.int64), np.empty(b_count + 1, np.int64)
    order, local = np.empty(most, np.int64), np.empty(b_count, np.int64)
    centres = np.empty((b_count, 2))
    world = np.empty_like(vertices)
    reach = np.empty(b_count)
    fall = math.hypot(gravity[0], gravity[1]) * h
    for k in range(len(codes)):
        old = state[n:].copy().reshape(b_count, 3)
        loose = old.copy()
        places = state[:n].reshape(b_count, 3)
        for b in range(b_count):
            at = 3 * b
            x = state[at] + 0.5 * h * old[b, 0]
            y = state[at + 1] + 0.5 * h * old[b, 1]
            angle = state[at + 2] + 0.5 * h * old[b, 2]
            state[at], state[at + 1], state[at + 2] = x, y, angle
            centres[b, 0], centres[b, 1] = x, y
            corners = vertices[firsts[b] : firsts[b + 1]]
            put_rows(place(corners, x, y, angle), world[firsts[b] : firsts[b + 1]])
            loose[b, 0] += h * gravity[0]
            loose[b, 1] += h * gravity[1]
            speed = math.hypot(old[b, 0], old[b, 1]) + sizes[b] * abs(old[b, 2]) + fall
            reach[b] = 2.0 * h * speed
        m, at_old = 0, 0
        approach[k] = closing[k] = passed[k] = 0.0
        for b in range(b_count):
            gaps[k, b], pull[b] = math.inf, fall
            struck[k, b] = False
            codes[k, b] = FREE
            impulses[k, b, 0] = impulses[k, b, 1] = 0.0
        for b in range(b_count):
            mine = world[firsts[b] : firsts[b + 1]]
            for c in range(b + 1, b_count + s_count):
                material = pairs[b, c]
                if material < 0:
                    continue
                other, moves = c, False
                if c < b_count:
                    within = reach[b] + reach[c]
                    away = math.hypot(centres[b, 0] - centres[c, 0], centres[b, 1] - centres[c, 1])
                    if away > sizes[b] + sizes[c] + within:
                        continue
                    # Of what grazes the approach is slow.
                    core = _CORE if nearby(old, sizes, b, c, _CROSSED / h) else _WHOLE
                    begin, end = overlap(centres, old, b, c, core * (cores[b] + cores[c]))
                    if -h < begin and begin + end < 0.0:
                        passed[k] = max(passed[k], (end - begin) / h)
                    count, features = between(
                        mine, centres[b], radii[b], world[firsts[c] : firsts[c + 1]],
                        centres[c], radii[c], within, found,
                    )  # fmt: skip
                else:
                    s = c - b_count
                    other, within = surfaces.carriers[s], reach[b]
                    if other == b:
                        continue
                    moves = other >= 0 or surfaces.moves[s]
                    frames = swung if moves else still
                    if moves:
                        _frames(paths, s, other, k, places, old, h, frames)
                        u, v = _moved(frames, centres[b, 0], centres[b, 1], 2)
                        within += 2.0 * math.hypot(u - centres[b, 0], v - centres[b, 1])
                    away = distance(surfaces, s, frames[1], centres[b, 0], centres[b, 1])
                    if away > sizes[b] + within:
                        continue
                    passed[k] = max(
                        passed[k],
                        crossed(
                            surfaces, s,
                            seen_from(
                                frames[0], centres[b, 0] - h * old[b, 0],
                                centres[b, 1] - h * old[b, 1],
                            ),
                            seen_from(frames[1], centres[b, 0], centres[b, 1]), cores[b],
                        ),
                    )  # fmt: skip
                    count, features = against_surface(
                        surfaces, s, frames[1], registers, mine, centres[b], radii[b], within,
                        found,
                    )  # fmt: skip
                pair = b * (b_count + s_count) + c
                while at_old < remembered[0] and keys[at_old, 0] < pair:
                    at_old += 1
                for p in range(count):
                    nx, ny, x, y, gap = found[p]
                    gaps[k, b] = min(gaps[k, b], gap)
                    if other >= 0:
                        gaps[k, other] = min(gaps[k, other], gap)
                    level, lasting = 0.0, False
                    pushes[m, 0] = pushes[m, 1] = 0.0
                    place_old = at_old
                    while place_old < remembered[0] and keys[place_old, 0] == pair:
                        if keys[place_old, 1] == features[p]:
                            level = memory[place_old, 0]
                            lasting = memory[place_old, 1] > 0.0
                            pushes[m, 0], pushes[m, 1] = memory[place_old, 2], memory[place_old, 3]
                        place_old += 1
                    bodies[m, 0], bodies[m, 1] = b, other
                    for d in range(2):
                        ux, uy = (nx, ny) if d == 0 else (ny, -nx)
                        rx, ry = x - centres[b, 0], y - centres[b, 1]
                        rows[m, d, 0], rows[m, d, 1], rows[m, d, 2] = ux, uy, rx * uy - ry * ux
                        if other >= 0:
                            rx, ry = x - centres[other, 0], y - centres[other, 1]
                            rows[m, d, 3], rows[m, d, 4] = -ux, -uy
                            rows[m, d, 5] = -(rx * uy - ry * ux)
                        before[m, d] = velocity(bodies, rows, old, m, d)
                        free[m, d] = velocity(bodies, rows, loose, m, d)
                    carries[m] = 0.0
                    if moves and other < 0:
                        # What the surface moves by from look to look, as the bodies do.
                        u, v = _moved(frames, x, y, 0)
                        before[m, 0] -= (nx * (x - u) + ny * (y - v)) / h
                        before[m, 1] -= (ny * (x - u) - nx * (y - v)) / h
                        u, v = _moved(frames, x, y, 2)
                        carries[m] = (ny * (u - x) - nx * (v - y)) / h
                        free[m, 0] -= (nx * (u - x) + ny * (v - y)) / h
                        free[m, 1] -= carries[m]
                        pull[b] = max(pull[b], math.hypot(
                            free[m, 0] - before[m, 0], free[m, 1] - before[m, 1]
                        ))  # fmt: skip
                    nearing = -before[m, 0]
                    slow = SLOW * max(abs(free[m, 0] - before[m, 0]), fall)
                    # Struck in the step whose middle is nearest to the instant of touching.
                    part, level, above = arriving(
                        gap, level, lasting, nearing, free[m, 0], slow, 0.5 + BESIDE, h
                    )
                    if part == HIT and gap > 0.0 and c < b_count and radii[b] * radii[c] > 0.0:
                        # Discs that are near and fast may pass beside each other.
                        touch, _ = overlap(centres, old, b, c, radii[b] + radii[c])
                        part = HIT if touch <= h else APART
                    known = at_old < remembered[0] and keys[at_old, 0] == pair
                    # In short steps all that follows is within their error.
                    known = known or c >= b_count or nearby(old, sizes, b, c, _CROSSED / h)
                    if part == HIT and not known:
                        # Ahead of its arrival, or behind, other corners and edges are the nearest.
                        later = max(gap / nearing, -h)
                        arrived, along = met(
                            vertices, firsts, radii, places, old, (b, c), later, (nx, ny), aside
                        )
                        if gap > 0.0 and not arrived <= _ARRIVED * gap:
                            part = APART
                        elif along < _ALIKE:
                            passed[k] = max(passed[k], _ELSEWHERE)
                    if gap < 0.0 and -nearing > slow and not known:
                        # It leaves: if it was not in it at the last look, it came by another side.
                        earlier, _ = met(
                            vertices, firsts, radii, places, old, (b, c), -h, (nx, ny), aside
                        )
                        if earlier > 0.0:
                            passed[k] = max(passed[k], _ELSEWHERE)
                    if part == APART:
                        continue
                    hit[m] = part == HIT
                    wanted[m, 0] = wanted[m, 1] = 0.0
                    if hit[m]:
                        wanted[m, 0] = -materials[material, 2] * nearing
                        approach[k] = max(approach[k], nearing)
                        closing[k] = max(closing[k], -gap)
                    else:
                        # A point that turns away faster than gravity follows lifts off; what is
                        # deeper than that makes was moved there by a change of features.
                        wanted[m, 0] = max(above / h, -0.5 * fall)
                    if m == most - 1:
                        return k, FULL
                    cones[m, 0], cones[m, 1] = materials[material, 0], materials[material, 1]
                    elastic[m] = materials[material, 2]
                    new_keys[m, 0], new_keys[m, 1] = pair, features[p]
                    new_memory[m, 0] = level
                    new_memory[m, 1] = 0.0 if lasting or hit[m] else above
                    if not lasting:
                        # An impact's impulses say nothing of the next.
                        pushes[m, 0] = pushes[m, 1] = 0.0
                    m += 1
        rates = loose.copy()
        efforts[k, 0] = efforts[k, 1] = efforts[k, 3] = 0.0
        efforts[k, 2] = m
        grouped(bodies, m, parents, begins, order)
        for island in range(b_count):
            members = order[begins[island] : begins[island + 1]]
            size = len(members)
            if size == 0:
                continue
            contacts = gathered(members, bodies, rows, inverse, cones, local)
            start, unforced = np.empty((size, 2)), np.empty((size, 2))
            asked, chosen = np.empty((size, 2)), np.empty((size, 2))
            rebounds, quiet = np.empty(size, np.bool_), 0
            for a in range(size):
                i = members[a]
                put(before[i], start[a])
                put(free[i], unforced[a])
                put(pushes[i], chosen[a])
                rebounds[a] = hit[i] and elastic[i] > 0.0
                if plastic and size > 1 and rebounds[a]:
                    rebounds[a], wanted[i, 0] = False, 0.0
                put(wanted[i], asked[a])
                bounces[i] = rebounds[a]
                quiet += 0 if hit[i] else 1
            bound = 0.0
            for a in range(size):
                for side in range(2):
                    b = bodies[members[a], side]
                    # Once for each body.
                    if b >= 0 and local[b] >= 0:
                        bound += 0.125 * pull[b] * pull[b] / inverse[b, 0]
                        local[b] = -1
            missed, done, softened = island_impulses(
                contacts, start, unforced, asked, rebounds, chosen, allowed, bound
            )
            for a in range(size):
                put(chosen[a], steady[members[a]])
                if hit[members[a]]:
                    steady[members[a], 0] = steady[members[a], 1] = 0.0
            if 0 < quiet < size:
                # What is force of it: the impulses without what strikes.
                others, last = np.empty(quiet, np.int64), 0
                for i in members:
                    if not hit[i]:
                        others[last] = i
                        last += 1
                alone, ours = np.empty((quiet, 2)), np.empty((quiet, 2))
                for a in range(quiet):
                    for d in range(2):
                        ours[a, d] = free[others[a], d] + wanted[others[a], d]
                    put(pushes[others[a]], alone[a])
                _, further = solve_rows(
                    gathered(others, bodies, rows, inverse, cones, local), ours, alone, allowed,
                    False,
                )  # fmt: skip
                done += further
                for a in range(quiet):
                    put(alone[a], steady[others[a]])
            for a in range(size):
                put(chosen[a], pushes[members[a]])
            efforts[k, 0] = max(efforts[k, 0], missed)
            efforts[k, 1] += done
            efforts[k, 3] = max(efforts[k, 3], 1.0 if softened else 0.0)
        forced = loose.copy()
        for i in range(m):
            for d in range(2):
                if pushes[i, d] != 0.0:
                    push(bodies, rows, inverse, rates, i, d, pushes[i, d])
                if steady[i, d] != 0.0:
                    push(bodies, rows, inverse, forced, i, d, steady[i, d])
        for i in range(m):
            pressed = pushes[i, 0] > 0.0
            lasts = pressed and not bounces[i]
            keys[i, 0], keys[i, 1] = new_keys[i, 0], new_keys[i, 1]
            memory[i, 0] = new_memory[i, 0]
            memory[i, 1] = 1.0 if lasts else 0.0
            memory[i, 2], memory[i, 3] = pushes[i, 0], pushes[i, 1]
            for side in range(2):
                b = bodies[i, side]
                if b < 0:
                    continue
                if hit[i] and pressed:
                    struck[k, b] = True
                    impulses[k, b, 0] += pushes[i, 0]
                    impulses[k, b, 1] += pushes[i, 1] if side == 0 else -pushes[i, 1]
                if lasts:
                    if not hit[i]:
                        closing[k] = max(closing[k], new_memory[i, 1])
                    edge = cones[i, 1] * pushes[i, 0] - cones[i, 0] * abs(pushes[i, 1])
                    slip = abs(velocity(bodies, rows, rates, i, 1) - carries[i])
                    sticks = cones[i, 1] > 0.0 and (
                        edge > _EDGE * pushes[i, 0] or slip <= allowed * fall
                    )
                    if sticks:
                        codes[k, b] = PIN
                    elif codes[k, b] == FREE:
                        codes[k, b] = SLIDE
        remembered[0] = m
        for b in range(b_count):
            for d in range(3):
                at = 3 * b + d
                solved[k, at] = (forced[b, d] - old[b, d]) / h
                state[n + at] = rates[b, d]
                state[at] += 0.5 * h * rates[b, d]
                if not math.isfinite(state[at]):
                    return k, NOT_FINITE
        for i in range(2 * n):
            states[k + 1, i] = state[i]
    return len(codes), DONE
