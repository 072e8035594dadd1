"""Who touches whom in the middle of a step, and which contacts take part in it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.detection.body_numbers import BodyNumbers, Memory
from contacts.detection.broad_phase import Grid, near_pairs
from contacts.detection.convex import FOUND, between
from contacts.detection.ground import Ground, carried_along, on_surface
from contacts.detection.joints import held
from contacts.detection.look import TOUCHING, Look
from contacts.detection.meeting import arrives, came, crossing, nearby, overlap
from contacts.detection.seams import exposed
from contacts.detection.touches import Touches, felt, recalled, turned
from contacts.time_stepping.chunk import APART, BESIDE, HIT, SLOW, arriving
from statechart.kernels.jit import beside

# Points of contact that a pair can have: a polygon on a surface has as many as corners.
_POINTS = 16
# What is past another, within this part of their radii, since the last look has missed it; and of
# what crosses much of its size in a step, where farther out it approaches at a tenth of its speed.
_CORE, _WHOLE = 0.9, 0.995
# Bodies that cross less than this part of their size in a step are looked at once.
_CROSSED = 0.5
# Of the size of the smaller one: what is hit deeper than this in another is looked at more often.
_SUNK = 0.25
# Of that size: so deep something may be at the first look because it starts there, which is checked
# before the run.
_STARTED = 1e-5
# What is hit in the step nearest to its arrival is so deep at most, in parts of the way that the
# fastest goes in a step.
_LANDED = 0.5


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
        deep is what is hit, where that is much beside its size, or what approaches, where that is
        more than a step at the fastest approach.
    """

    contacts: int
    approach: float
    closing: float
    passed: float
    sunk: float


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
    # Where it starts, a contact may be deeper.
    lowest = _LANDED * memory.past[2] if memory.past[0] > 0.0 else math.inf
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
                if material < 0 or held(numbers.joints, b, other):
                    continue
                # In short steps all that follows is within their error.
                slowly = nearby(drifts, sizes, p, q, _CROSSED / since)
                # Of what grazes the approach is slow.
                core = _CORE if slowly else _WHOLE
                if radii[p] * radii[q] > 0.0 or nearby(drifts, cores, p, q, _CROSSED / since):
                    begin, end = overlap(centres, drifts, p, q, core * (cores[p] + cores[q]))
                    if -since < begin and begin + end < 0.0:
                        passed = max(passed, (end - begin) / h)
                else:
                    passed = max(passed, crossing(numbers, look, (p, q), since, core, aside) / h)
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
                points, crosses = on_surface(numbers, ground, look, p, s, h, found, features)
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
                level, lasting, place = recalled(memory, at_old, pair, features[at], h, m, touches)
                felt(look, b, other, found[at], m, touches)
                if moves:
                    pull = carried_along(ground, surfaces, s, found[at], h, m, touches)
                    look.pull[b] = max(look.pull[b], pull)
                nearing = -touches.before[m, 0]
                changed = touches.free[m, 0] - touches.before[m, 0]
                size = min(sizes[p], sizes[q]) if whole else sizes[p]
                gained = max(abs(changed), fall)
                slow = SLOW * max(gained, TOUCHING * size / h)
                if gap < 0.0 and not known:
                    explained = since * max(memory.past[1], nearing, slow)
                    explained += 0.0 if memory.past[0] > 0.0 else _STARTED * size
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
                    meets, crossed = arrives(
                        numbers, look, (p, q), (nx, ny), gap, nearing, h, aside
                    )
                    passed = max(passed, crossed)
                    role = HIT if meets else APART
                if gap < 0.0 and -nearing > slow and not (known or slowly):
                    # It leaves: if it was not in it at the last look, it came by another side.
                    crossed = came(numbers, look, (p, q), (nx, ny), since, aside)
                    passed = max(passed, crossed)
                if role == APART:
                    continue
                if nearing > slow and -gap > max(memory.past[2], h * nearing):
                    sunk = max(sunk, -gap)
                touches.hit[m] = role == HIT
                touches.wanted[m, 0] = touches.wanted[m, 1] = 0.0
                if role == HIT:
                    touches.wanted[m, 0] = -numbers.materials[material, 2] * nearing
                    approach = max(approach, nearing)
                    closing = max(closing, -gap)
                    if -gap > _SUNK * size:
                        sunk = max(sunk, -gap)
                else:
                    # No deeper than an impact leaves a contact does it stay.
                    above, level = min(above, gap + lowest), max(level, -lowest)
                    # On the way to the next look it is to be where it is kept, and the velocities
                    # of what sticks to be none on average. What is deeper than turning takes it
                    # was moved there by a change of features: it goes back no faster than forces
                    # take it, or than it came.
                    # So is what bears nothing any more and is not out yet: nothing kicks it. What
                    # leaves as its force falls to zero turns no faster than forces move it.
                    kept = place >= 0 and memory.contacts[place, 1] != 0.0
                    turn, shift = turned(memory, place, m, touches) if kept else (0.0, 0.0)
                    if not lasting and abs(turn) > gained:
                        turn = shift = 0.0
                    if above < 0.0:
                        above = min(above - 0.5 * since * min(turn, 0.0), 0.0)
                    back, part = max(0.5 * gained, nearing), 0.5 * h / since
                    touches.wanted[m, 0] = max(above / h + part * turn, -back)
                    touches.wanted[m, 1] = part * shift
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
