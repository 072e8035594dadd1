"""Contact detection at the middle of a step, and the selection of active contacts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.active_contacts import (
    ROLLS,
    ActiveContacts,
    has_two_coefficients,
    remove_body_motion,
    restore_impulses,
    turning_change,
    velocity,
    write_compliant,
    write_contact,
    write_friction,
    write_resistance,
)
from contacts.collision_detection.body_numbers import (
    RESTITUTION,
    ROLLING,
    STIFFNESS,
    BodyNumbers,
    WarmStart,
)
from contacts.collision_detection.broad_phase import Grid, near_pairs, sort_by_key
from contacts.collision_detection.convex import FOUND, ConvexShape, norm, shape_contacts
from contacts.collision_detection.internal_edges import (
    COVERING,
    Neighbours,
    TouchedSide,
    drop_internal_edges,
    find_face_contacts,
    list_neighbours,
    near_obstacles,
)
from contacts.collision_detection.joints import is_joined
from contacts.collision_detection.midpoint import TOUCH_TOLERANCE, Midpoint
from contacts.collision_detection.surfaces import (
    HOLLOW,
    PLATE,
    ROUND,
    Ground,
    distance,
    surface_contacts,
    to_world,
)
from contacts.collision_detection.time_of_impact import (
    ARRIVED,
    carrier_of,
    entered_other_side,
    is_relatively_slow,
    overlap_interval,
    passing_time,
    relative_speed,
    time_of_impact,
    turning_speed,
    will_collide,
)
from contacts.time_stepping.chunk import (
    HIT,
    SEPARATED,
    SLOW,
    TIME_MARGIN,
    contact_role,
    curvature_speed,
)
from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel

CROSSED = 0.5
"""Relative motion in a step, in sizes, below which a pair needs no continuous detection."""


POINTS = 16
"""Capacity of contact points per pair: a polygon on a surface has one per corner."""


class CandidatePair(NamedTuple):
    """A piece of a body, and another piece or a surface that it may touch."""

    # The piece; another, or a surface (indices behind the pieces).
    p: int
    q: int
    # The piece's body, which moves freely; the other body or the surface's carrier, or -1.
    body: int
    other: int
    key: int  # See `WarmStart`.
    material: int  # Row of the contact law; -1: no contact.
    whole: bool  # Both are pieces.
    discs: bool  # Both are discs.
    # Whether pieces move little in the step, so that continuous detection is within its error;
    # whether they turn much.
    slowly: bool
    turns: bool
    rolls: bool  # One is a disc.
    size: float  # Smaller one's.
    within: float  # Largest gap that they can close.


@kernel
def pair_reach(numbers: BodyNumbers, mid: Midpoint, p: int, q: int, h: float) -> float:
    """Return the gap that a piece and another or a surface can close; -1: they are farther apart.

    Near pieces are known.
    """
    s = q - len(numbers.pieces.sizes)
    if s < 0:
        return mid.reach[p] + mid.reach[q]
    c, (x, y) = carrier_of(numbers, q), mid.centres[p]
    u, v, turning = mid.free_rates[c]
    u, v = u - turning * (y - mid.poses[c, 1]), v + turning * (x - mid.poses[c, 0])
    within = mid.reach[p] + 2.0 * h * norm(u, v)
    away = distance(numbers.surfaces, s, mid.poses[c], x, y)
    return -1.0 if away > numbers.pieces.sizes[p] + within else within


@kernel
def candidate_pair(
    numbers: BodyNumbers, mid: Midpoint, p: int, q: int, since: float, within: float
) -> CandidatePair:
    """Return the data of a piece and what it may touch."""
    pieces, surfaces = numbers.pieces, numbers.surfaces
    count, b = len(pieces.sizes), pieces.bodies[p]
    s, key = q - count, p * (count + len(surfaces.kinds)) + q
    if s < 0:
        other = pieces.bodies[q]
        touch = other != b and not is_joined(numbers.joints, b, other)
        material = numbers.laws[numbers.kinds[b], numbers.kinds[other]] if touch else -1
        size, discs = min(pieces.sizes[p], pieces.sizes[q]), pieces.radii[p] * pieces.radii[q] > 0.0
        turning = turning_speed(numbers, mid, p) + turning_speed(numbers, mid, q)
        turns = since * turning > CROSSED * min(pieces.cores[p], pieces.cores[q])
        slowly = not turns and is_relatively_slow(mid.drifts, pieces.sizes, p, q, CROSSED / since)
        rolls = pieces.radii[p] + pieces.radii[q] > 0.0
        return CandidatePair(
            p, q, b, other, key, material, True, discs, slowly, turns, rolls, size, within
        )
    other = surfaces.carriers[s]
    material = numbers.laws[numbers.kinds[b], len(numbers.laws) + s] if other != b else -1
    rolls, size = pieces.radii[p] > 0.0, pieces.sizes[p]
    # Ground has no other side.
    slowly, turns, way = True, False, CROSSED * pieces.cores[p]
    if surfaces.kinds[s] in (PLATE, ROUND):
        slowly = since * relative_speed(numbers, mid, p, q) <= way
        turns = since * turning_speed(numbers, mid, p) > way
    return CandidatePair(
        p, q, b, other, key, material, False, False, slowly, turns, rolls, size, within
    )


# Part of the radii within which a piece that has passed another since the last detection missed it;
# for fast pieces, which graze at a tenth of their speed farther out.
_CORE, _WHOLE = 0.9, 0.995
# Depth, relative to the inscribed circle, up to which a piece that passes a surface only grazes it.
_GRAZED = 0.1
# Depth of an impact, relative to the smaller piece, above which the step is split.
_SUNK = 0.25
# Penetration, relative to that size, that the first detection may add to the checked initial one.
_STARTED = 1e-5
# Slip of a new contact, relative to the velocity change of a step, above which friction is kinetic.
_STUCK = 1e-6
LANDED = 0.5
"""Largest depth of an impact in its nearest step, in steps at fastest approach."""


APPROACH, CLOSING, PASSED, SUNK, TURNED = range(5)
"""Indices of `_Points.worst`; see `DetectionResult`."""


class DetectionResult(NamedTuple):
    """Result of contact detection."""

    contacts: int  # Number of active contacts; -1: capacity exceeded.
    # Fastest approach of touching contacts; largest gap or depth of an impact.
    approach: float
    closing: float
    passed: float  # See `contacts.time_stepping.chunk.Chunk`.
    # Largest unexplained depth: of a new contact, beyond two detections' motion; of an impact, if
    # large relative to the piece; of an approaching contact, if more than a step at the fastest
    # approach.
    unexplained_depth: float
    # Twice the largest change of a lasting contact's normal velocity by rotation: over a step, the
    # allowed depth.
    turned: float


class _Times(NamedTuple):
    """Times of contact detection."""

    # Step size; time since the last detection, of straight motion.
    h: float
    since: float
    fall: float  # Speed that gravity gives in a step.
    first: bool  # This is the first detection.
    lowest: float  # Largest allowed target depth; infinite at the start.


class _Points(NamedTuple):
    """Contact points of a pair, and the workspace of their search."""

    # See `contacts.collision_detection.convex.shape_contacts`.
    manifold: Array
    features: Ints
    buffer: Array  # (m, FOUND): buffer for other times.
    worst: Array  # (5,): see `APPROACH`.


@kernel
def _update_maximum(points: _Points, what: int, value: float) -> None:
    """Update the largest value of a detection."""
    points.worst[what] = max(points.worst[what], value)


@kernel
def _add_passing(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: CandidatePair, times: _Times,
    points: _Points, count: int,
) -> None:  # fmt: skip
    """Note for which part of the step a piece was in another or a surface that it has passed."""
    p, q, cores, since = pair.p, pair.q, numbers.pieces.cores, times.since
    core, end, gap = _CORE if pair.slowly else _WHOLE, 0.0, math.inf
    if not pair.whole:
        for at in range(count):
            gap = min(gap, points.manifold[at, 4])
        # A piece that has passed a surface is clear of it.
        if gap < 0.0 or times.h * relative_speed(numbers, mid, p, q) <= CROSSED * cores[p]:
            return
        deep = _GRAZED * cores[p]
    elif not pair.turns and (
        pair.discs or is_relatively_slow(mid.drifts, cores, p, q, CROSSED / since)
    ):
        begin, end = overlap_interval(mid.centres, mid.drifts, p, q, core * (cores[p] + cores[q]))
        if -since < begin and begin + end < 0.0:
            _update_maximum(points, PASSED, (end - begin) / times.h)
        return
    else:
        deep = (1.0 - core) * (cores[p] + cores[q])
    past = passing_time(numbers, ground, mid, (p, q), min(since, times.h), deep, points.buffer)
    _update_maximum(points, PASSED, past / times.h)


@kernel
def _pair_points(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: CandidatePair, times: _Times,
    points: _Points, near: Neighbours,
) -> int:  # fmt: skip
    """Find the contact points of a pair, and whether they have passed; return their number."""
    pieces, (manifold, features), p, q = numbers.pieces, points[:2], pair.p, pair.q
    firsts, centres, s = pieces.firsts, mid.centres, q - len(pieces.sizes)
    shape = ConvexShape(mid.world[firsts[p] : firsts[p + 1]], centres[p], pieces.radii[p])
    if pair.whole:
        other = ConvexShape(mid.world[firsts[q] : firsts[q + 1]], centres[q], pieces.radii[q])
        count = shape_contacts(shape, other, pair.within, manifold, features)
    else:
        count = surface_contacts(
            numbers.surfaces, s, mid.poses[pair.other], ground, shape, pair.within, manifold,
            features,
        )  # fmt: skip
    _add_passing(numbers, ground, mid, pair, times, points, count)
    # The depth counts even if internal edges remove all contacts, but not that of compliant ones.
    rigid = numbers.materials[pair.material, STIFFNESS] == 0.0
    for at in range(count if rigid else 0):
        gap = manifold[at, 4]
        if gap < mid.gaps[pair.body]:
            mid.gaps[pair.body], mid.deepest[pair.body] = gap, q
        if pair.other >= 0 and gap < mid.gaps[pair.other]:
            mid.gaps[pair.other], mid.deepest[pair.other] = gap, p
    for turn in range(2 if count > 0 else 0):
        several = turn == 0 and pieces.begins[pair.body + 1] - pieces.begins[pair.body] > 1
        # A half-plane has one normal, which others do not take away.
        if pair.whole or several or numbers.surfaces.kinds[s] in (PLATE, ROUND):
            count = _drop_ghost_contacts(
                numbers, ground, mid, pair, turn, times.h, points, near, count
            )
    return count


@kernel
def _drop_ghost_contacts(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: CandidatePair, turn: int, h: float,
    points: _Points, near: Neighbours, count: int,
) -> int:  # fmt: skip
    """Remove ghost contacts at the first or second of a pair.

    If none remains of an overlap, its faces touch: a sharp corner in the angle of two faces is less
    deep along its own normals, and a corner that has just passed a seam along the face behind it.
    """
    manifold, features = points.manifold, points.features
    sides = (pair.p, pair.q) if turn == 0 else (pair.q, pair.p)
    many = near_obstacles(numbers, ground, mid, sides, near, h, manifold, count)
    if many <= 1:
        return count
    soft = numbers.materials[pair.material, STIFFNESS] > 0.0
    touched = TouchedSide(sides[0], sides[1], 2.0 * turn - 1.0, near.covering[:many], soft)
    count, barred = drop_internal_edges(numbers, ground, mid, touched, manifold, features, count)
    if count == 0 and (barred or soft):
        count = find_face_contacts(numbers, ground, mid, touched, pair.whole, manifold, features)
        if count > 0:
            count, _ = drop_internal_edges(numbers, ground, mid, touched, manifold, features, count)
    return count


@kernel
def _discs_pass(numbers: BodyNumbers, mid: Midpoint, pair: CandidatePair, h: float) -> bool:
    """Return whether two discs in straight motion do not touch in a step."""
    radii = numbers.pieces.radii
    apart = radii[pair.p] + radii[pair.q]
    return overlap_interval(mid.centres, mid.drifts, pair.p, pair.q, apart)[0] > h


@kernel
def _will_strike(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: CandidatePair, point: Array,
    nearing: float, h: float, points: _Points,
) -> bool:  # fmt: skip
    """Return whether a fast, near pair collides in a step; it may pass the other body."""
    gap, pieces = point[4], (pair.p, pair.q)
    if pair.turns and gap > 0.0:
        until, near = (0.5 + TIME_MARGIN) * h, ARRIVED * gap
        touch = time_of_impact(numbers, ground, mid, pieces, 0.0, until, near, points.buffer)
        return touch < math.inf
    # At its arrival other corners and edges of a fast body can be the nearest.
    later = max(gap / nearing, -h)
    meets, crossed = will_collide(numbers, ground, mid, pieces, point, later, points.buffer)
    _update_maximum(points, PASSED, crossed)
    return meets


@kernel
def _write_velocity_bounds(
    warm: WarmStart, place: int, lasting: bool, m: int, times: _Times, gained: float,
    above: float, active: ActiveContacts,
) -> float:  # fmt: skip
    """Write the bias of a lasting contact; return the change of its normal velocity by rotation.

    At the next detection the gap shall be the target gap, and a sticking contact shall have no mean
    slip. If the penetration exceeds what rotation explains, the contact feature changed: the
    correction velocity is then limited to the larger of the approach velocity and the velocity that
    forces give in a step, so that no energy is added. The same holds for unloaded contacts that are
    not out yet, and for rotation that closes a contact whose force falls to zero.
    """
    h, since, turn, shift = times.h, times.since, 0.0, 0.0
    if place >= 0 and warm.contacts[place, 1] != 0.0:
        turn, shift = turning_change(warm, place, m, active)
    if not lasting and turn < -gained:
        turn = shift = 0.0
    if above < 0.0:
        above = min(above - 0.5 * since * min(turn, 0.0), 0.0)
    back, part = max(0.5 * gained, -active.before[m, 0]), 0.5 * h / since
    active.bias[m, 0] = max(above / h + part * turn, -back)
    active.bias[m, 1] = part * shift
    return turn


@kernel
def _move_between(
    radii: Array, pair: CandidatePair, point: Array, feature: int, part: float
) -> None:
    """Move a contact point of two pieces from one surface to a `part` of the gap from the first.

    In the middle lever arms do not depend on the order of bodies. The point of a disc and a polygon
    is on the polygon, that of two discs on the second; see `contacts.collision_detection.convex`.
    """
    on_first = feature >= 0 and feature % 2 == 1
    if radii[pair.q] > 0.0:
        on_first = radii[pair.p] == 0.0
    shift = -part * point[4] if on_first else (1.0 - part) * point[4]
    point[2] += shift * point[0]
    point[3] += shift * point[1]


@kernel
def _hollow_curvature_speed(
    numbers: BodyNumbers, mid: Midpoint, pair: CandidatePair, point: Array
) -> float:
    """Return the `curvature_speed` of a disc or a corner in a hollow circle; 0 for other pairs."""
    p, s, surfaces = pair.p, pair.q - len(numbers.pieces.sizes), numbers.surfaces
    if pair.whole or surfaces.kinds[s] != HOLLOW:
        return 0.0
    pose, (u, v, turning) = mid.poses[pair.other], mid.old_rates[pair.other]
    x, y = to_world(pose, surfaces.numbers[s, 0], surfaces.numbers[s, 1])
    u, v = u - turning * (y - pose[1]), v + turning * (x - pose[0])
    pose, (du, dv, turning) = mid.poses[pair.body], mid.old_rates[pair.body]
    across, up = point[2], point[3]
    if numbers.pieces.radii[p] > 0.0:
        across, up = mid.centres[p]
    lever = across - pose[0], up - pose[1]
    du, dv = du - turning * lever[1] - u, dv + turning * lever[0] - v
    across, up = across - x, up - y
    away = norm(across, up)
    if away == 0.0:
        return 0.0
    along = (across * dv - up * du) / away
    # A corner, and a disc beside its body's centre, accelerate towards that.
    turned = turning * turning * (lever[0] * point[0] + lever[1] * point[1])
    return curvature_speed(along * along / away + turned, -point[4])


@kernel
def _write_if_active(
    numbers: BodyNumbers, ground: Ground, warm: WarmStart, mid: Midpoint, pair: CandidatePair,
    times: _Times, at: int, at_old: int, m: int, points: _Points, active: ActiveContacts,
) -> bool:  # fmt: skip
    """Return whether a contact point is active in this step; write it as contact m.

    The pair's entries of the warm start begin at `at_old`.
    """
    h, point, feature = times.h, points.manifold[at], points.features[at]
    gap, law = point[4], numbers.materials[pair.material]
    prescribed = pair.other >= len(numbers.inverse)
    if pair.whole:
        # A body is as deep in a prescribed one as in a surface: lever arms end on the body.
        part = 0.0 if prescribed and law[STIFFNESS] > 0.0 else 0.5
        _move_between(numbers.pieces.radii, pair, point, feature, part)
    known = at_old < warm.n_contacts[0] and warm.keys[at_old, 0] == pair.key
    level, lasting, place = restore_impulses(warm, at_old, pair.key, feature, h, m, active)
    write_contact(mid, pair.body, -1 if prescribed else pair.other, point, m, active)
    if prescribed:
        pull = remove_body_motion(mid, pair.other, point, m, active)
        mid.force_speed[pair.body] = max(mid.force_speed[pair.body], pull)
    nearing = -active.before[m, 0]
    gained = max(abs(active.free[m, 0] - active.before[m, 0]), times.fall)
    active.compliances[m], active.laws[m], active.landings[m] = 0.0, pair.material, 0.0
    active.rolling_roles[m] = ROLLS if pair.rolls and law[ROLLING] > 0.0 else 0
    if law[STIFFNESS] > 0.0:
        shift = turning_change(warm, place, m, active)[1] if lasting else 0.0
        active.hit[m], active.materials[m, 2] = False, 0.0
        active.keys[m, 0], active.keys[m, 1] = pair.key, feature
        for k in range(4):
            active.levels[m, k] = 0.0
        _write_slip_direction(numbers, warm, place, lasting, gained, m, active)
        near, shift = TOUCH_TOLERANCE * pair.size, 0.5 * h / times.since * shift
        return write_compliant(gap, near, h, shift, m, active)
    turned = 0.0
    if place >= 0 and warm.contacts[place, 1] == 0.0:
        # A contact that has rebounded can return by rotation alone: no impact in every step.
        turned = h / times.since * turning_change(warm, place, m, active)[0]
    forced = abs(active.free[m, 0] - active.before[m, 0] + turned)
    curved = _hollow_curvature_speed(numbers, mid, pair, point)
    slow = SLOW * max(gained, forced, curved, TOUCH_TOLERANCE * pair.size / h)
    if gap < 0.0 and not known:
        explained = times.since * max(warm.last_step[1], nearing, slow)
        if times.first:
            explained += _STARTED * pair.size + LANDED * warm.last_step[2]
        _update_maximum(points, SUNK, -gap - explained)
    # The impact is in the step whose middle is nearest to the touch.
    closing, reached = h * (slow - active.free[m, 0]), (0.5 + TIME_MARGIN) * h * nearing
    role, level, above = contact_role(gap, level, lasting, nearing, slow, closing, reached, 0.0)
    # A pair that was near at the last detection, or is slow, does not pass.
    certain = known or pair.slowly
    if role == HIT and (
        (gap > 0.0 and pair.discs and _discs_pass(numbers, mid, pair, h))
        or not (certain or _will_strike(numbers, ground, mid, pair, point, nearing, h, points))
    ):
        role = SEPARATED
    if gap < 0.0 and -nearing > slow and not certain:
        # It leaves: if it was outside before, it entered by another side. A shorter step than the
        # last one was checked at its end.
        pieces, normal = (pair.p, pair.q), (point[0], point[1])
        since = min(times.since, h)
        crossed = entered_other_side(numbers, ground, mid, pieces, normal, since, points.buffer)
        _update_maximum(points, PASSED, crossed)
    if role == SEPARATED:
        return False
    active.levels[m, 3] = above
    _update_maximum(points, APPROACH, nearing)
    if nearing > slow and -gap > max(warm.last_step[2], h * nearing):
        _update_maximum(points, SUNK, -gap)
    if role == HIT:
        active.bias[m, 0] = -numbers.materials[pair.material, RESTITUTION] * nearing
        active.bias[m, 1] = 0.0
        _update_maximum(points, CLOSING, abs(gap))
        if -gap > _SUNK * pair.size:
            _update_maximum(points, SUNK, -gap)
    else:
        # The target is no deeper than impacts leave a contact.
        above, level = min(above, gap + times.lowest), max(level, -times.lowest)
        turn = _write_velocity_bounds(warm, place, lasting, m, times, gained, above, active)
        active.landings[m] = active.before[m, 0] - turn + active.bias[m, 0]
        # Half remains, half is corrected by the next detection.
        _update_maximum(points, TURNED, 2.0 * abs(turn))
    if not lasting:
        # Impulses of an impact are no warm start.
        active.pushes[m, 0] = active.pushes[m, 1] = 0.0
    active.hit[m] = role == HIT
    active.keys[m, 0], active.keys[m, 1] = pair.key, feature
    active.levels[m, 0] = level
    active.levels[m, 1] = 0.0 if lasting and role != HIT else above
    active.materials[m, 2] = law[RESTITUTION]
    _write_slip_direction(numbers, warm, place, lasting, gained, m, active)
    return True


@kernel
def _write_slip_direction(
    numbers: BodyNumbers, warm: WarmStart, place: int, lasting: bool, gained: float, m: int,
    active: ActiveContacts,
) -> None:  # fmt: skip
    """Write the friction of contact m: kinetic if it slipped, or is new with a slip."""
    slip = active.before[m, 1]
    one = not has_two_coefficients(numbers.materials[active.laws[m]])
    stuck = lasting and place >= 0 and warm.contacts[place, 9] == 0.0
    if one or stuck or abs(slip) <= _STUCK * gained:
        write_friction(numbers, m, 0, active)
    else:
        write_friction(numbers, m, 1 if slip > 0.0 else -1, active)


@kernel
def _add_resistance(
    numbers: BodyNumbers, warm: WarmStart, mid: Midpoint, pair: CandidatePair, times: _Times,
    at_old: int, m: int, active: ActiveContacts,
) -> None:  # fmt: skip
    """Write the rolling resistance of contact m - 1 as contact m."""
    before = after = 0.0
    if pair.other >= len(numbers.inverse):
        before, after = mid.old_rates[pair.other, 2], mid.free_rates[pair.other, 2]
    write_resistance(numbers, warm, at_old, (before, after), times.h, m, active)
    active.before[m, 1] += velocity(active.bodies, active.rows, mid.old_rates, m, 1)
    active.free[m, 1] += velocity(active.bodies, active.rows, mid.free_rates, m, 1)


@kernel
def find_contacts(
    numbers: BodyNumbers, ground: Ground, warm: WarmStart, mid: Midpoint, grid: Grid, h: float,
    active: ActiveContacts,
) -> DetectionResult:  # fmt: skip
    """Find the active contacts of a step of size h.

    Writes the `active` contacts, and gaps and pulls of the midpoint; `grid` is workspace.
    """
    sizes, pairs, keys = numbers.pieces.sizes, grid.pairs, warm.keys
    count, others = len(sizes), len(sizes) + len(numbers.surfaces.kinds)
    manifold, buffer, worst = np.empty((POINTS, FOUND)), np.empty((POINTS, FOUND)), np.zeros(5)
    points = _Points(manifold, np.empty(POINTS, np.int64), buffer, worst)
    first = not warm.last_step[0] > 0.0
    fall = math.hypot(numbers.gravity[0], numbers.gravity[1]) * h
    lowest = math.inf if first else LANDED * warm.last_step[2]
    times = _Times(h, 0.5 * (h + (h if first else warm.last_step[0])), fall, first, lowest)
    m, at_old, end = 0, 0, 0
    many = near_pairs(mid.centres, sizes, mid.reach, grid)
    # Discs have no internal edges.
    corners = len(numbers.pieces.vertices) > 0
    near = Neighbours(
        np.zeros(count + 1, np.int64), np.empty(max(many, 0) if corners else 0, np.int64),
        np.empty(count, np.int64), np.zeros(1, np.int64), np.empty(COVERING, np.int64),
    )  # fmt: skip
    if corners:
        seconds = pairs[: max(many, 0), 1].copy()
        sort_by_key(seconds, len(seconds), near.heads, near.order)
    # Bodies in prescribed motion come last, and do not collide with each other.
    moving = numbers.pieces.begins[len(numbers.inverse)]
    for p in range(moving if many >= 0 else 0):
        begin = end
        while end < many and pairs[end, 0] == p:
            end += 1
        if corners:
            list_neighbours(pairs, begin, end, p, near)
        for i in range(begin, end + others - count):
            q = pairs[i, 1] if i < end else count + i - end
            within = pair_reach(numbers, mid, p, q, h)
            if within < 0.0:
                continue
            pair = candidate_pair(numbers, mid, p, q, times.since, within)
            if pair.material < 0:
                continue
            met = _pair_points(numbers, ground, mid, pair, times, points, near)
            while at_old < warm.n_contacts[0] and keys[at_old, 0] < pair.key:
                at_old += 1
            for at in range(met):
                if _write_if_active(
                    numbers, ground, warm, mid, pair, times, at, at_old, m, points, active
                ):
                    m += 1
                    if m < len(active.hit) and active.rolling_roles[m - 1] == ROLLS:
                        _add_resistance(numbers, warm, mid, pair, times, at_old, m, active)
                        m += 1
                if m == len(active.hit):
                    return DetectionResult(-1, worst[0], worst[1], worst[2], worst[3], worst[4])
    return DetectionResult(m if many >= 0 else -1, worst[0], worst[1], worst[2], worst[3], worst[4])
