"""Internal edges: removal of ghost collisions.

Two edges that share an end, adjacent tiles and adjacent pieces of one body form one boundary. If
they are tested separately, a body that slides along it hits the end of the next edge. Box2D uses
the ghost vertices of its chains (Catto 2020), Bullet the Voronoi regions of mesh edges. Here all
obstacles at relative rest that touch the feature of a contact decide:

- a corner admits the normals in the normal cones of all obstacles at it;
- a face admits none where obstacles cover it entirely, or stand between its end and the body.

An obstacle is a piece or a surface as a convex set in the world: polygon, disc, half-plane or sheet
(an edge without thickness). Other curves are replaced by their tangent half-plane.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers, PieceNumbers
from contacts.collision_detection.convex import face_contacts, interval_within, norm, write_contact
from contacts.collision_detection.joints import is_joined
from contacts.collision_detection.midpoint import Midpoint
from contacts.collision_detection.surfaces import (
    PLATE,
    ROUND,
    Ground,
    SurfaceNumbers,
    distance,
    tangent_at,
    to_world,
)
from contacts.collision_detection.time_of_impact import carrier_of
from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel

POLYGON, DISC, HALF, SHEET = range(4)

FLUSH = 1e-6
"""Relative distance of flush obstacles, and angle of equal normals."""

RAYS = 32
"""Capacity of boundary rays at a point."""


class Obstacle(NamedTuple):
    """A convex set."""

    sort: int
    # (k, 2): of a polygon, counter-clockwise; two boundary points of a half-plane with its solid
    # on the left; the ends of a sheet.
    corners: Array
    centre: Array  # shape (2,)
    radius: float
    size: float  # Circumscribed radius; infinite for a half-plane.


@kernel
def make_obstacle(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, q: int, x: float, y: float
) -> Obstacle:
    """Return a piece, or a surface (indices behind the pieces), as an obstacle near a point."""
    pieces, surfaces = numbers.pieces, numbers.surfaces
    if q < len(pieces.sizes):
        corners = mid.world[pieces.firsts[q] : pieces.firsts[q + 1]]
        sort = DISC if pieces.radii[q] > 0.0 else POLYGON
        return Obstacle(sort, corners, mid.centres[q], pieces.radii[q], pieces.sizes[q])
    s = q - len(pieces.sizes)
    return _surface_obstacle(surfaces, s, mid.poses[surfaces.carriers[s]], ground, x, y)


@kernel
def _surface_obstacle(
    surfaces: SurfaceNumbers, s: int, pose: Array, ground: Ground, x: float, y: float
) -> Obstacle:
    """Return a surface as an obstacle near a point."""
    two, centre = np.zeros((2, 2)), np.zeros(2)
    a, b, c, d = surfaces.numbers[s]
    if surfaces.kinds[s] == PLATE:
        two[0, 0], two[0, 1] = to_world(pose, a, b)
        two[1, 0], two[1, 1] = to_world(pose, c, d)
        centre[0], centre[1] = 0.5 * (two[0, 0] + two[1, 0]), 0.5 * (two[0, 1] + two[1, 1])
        return Obstacle(SHEET, two, centre, 0.0, 0.5 * norm(c - a, d - b))
    if surfaces.kinds[s] == ROUND:
        centre[0], centre[1] = to_world(pose, a, b)
        return Obstacle(DISC, two[:0], centre, c, c)
    two[0, 0], two[0, 1], nx, ny = tangent_at(surfaces, s, pose, ground, x, y)
    two[1, 0], two[1, 1] = two[0, 0] - ny, two[0, 1] + nx
    return Obstacle(HALF, two, centre, 0.0, math.inf)


@kernel
def edge_count(one: Obstacle) -> int:
    """Return the number of edges; a sheet has one on each side."""
    return 1 if one.sort == HALF else len(one.corners)


@kernel
def edge_of(one: Obstacle, i: int) -> tuple[float, float, float, float, float]:
    """Return the start of an edge, its direction, and its length."""
    j = i + 1 if i + 1 < len(one.corners) else 0
    x, y = one.corners[i, 0], one.corners[i, 1]
    ex, ey = one.corners[j, 0] - x, one.corners[j, 1] - y
    length = norm(ex, ey)
    return x, y, ex / length, ey / length, (math.inf if one.sort == HALF else length)


@kernel
def distance_to(one: Obstacle, x: float, y: float) -> float:
    """Return the distance of a point from an obstacle along its normals; < 0 inside."""
    if one.sort == DISC:
        return norm(x - one.centre[0], y - one.centre[1]) - one.radius
    most = -math.inf
    for i in range(edge_count(one)):
        ax, ay, ux, uy, length = edge_of(one, i)
        offset = uy * (x - ax) - ux * (y - ay)
        if one.sort == SHEET:
            along = ux * (x - ax) + uy * (y - ay)
            offset = norm(offset, max(0.0, -along, along - length))
        most = max(most, offset)
    return most


@kernel
def add_rays(one: Obstacle, x: float, y: float, near: float, rays: Array, count: int) -> int:
    """Append the boundary rays (direction, length) from a boundary point; return their number."""
    if one.sort == DISC:
        ux, uy = (x - one.centre[0]) / one.radius, (y - one.centre[1]) / one.radius
        for way in (-1.0, 1.0):
            if count < RAYS:
                rays[count, 0], rays[count, 1] = -way * uy, way * ux
                rays[count, 2] = one.radius
                count += 1
        return count
    for i in range(1 if one.sort == SHEET else edge_count(one)):
        ax, ay, ux, uy, length = edge_of(one, i)
        along, offset = ux * (x - ax) + uy * (y - ay), uy * (x - ax) - ux * (y - ay)
        endless = one.sort == HALF
        if abs(offset) > near or not (endless or -near <= along <= length + near):
            continue
        if along < length - near and count < RAYS:
            rays[count, 0], rays[count, 1], rays[count, 2] = ux, uy, length - along
            count += 1
        if (along > near or endless) and count < RAYS:
            rays[count, 0], rays[count, 1] = -ux, -uy
            rays[count, 2] = math.inf if endless else along
            count += 1
    return count


@kernel
def chord_interval(
    one: Obstacle, x: float, y: float, ux: float, uy: float, near: float
) -> tuple[float, float]:
    """Return the interval of a line from x, y along a unit vector inside a solid obstacle."""
    low, high = -math.inf, math.inf
    if one.sort == SHEET:
        return high, low
    if one.sort == DISC:
        return interval_within(x - one.centre[0], y - one.centre[1], ux, uy, one.radius)
    for i in range(edge_count(one)):
        ax, ay, ex, ey, _ = edge_of(one, i)
        offset, rate = ey * (x - ax) - ex * (y - ay), ey * ux - ex * uy
        if abs(rate) <= FLUSH:
            if offset > near:
                return math.inf, -math.inf
        elif rate > 0.0:
            high = min(high, -offset / rate)
        else:
            low = max(low, -offset / rate)
    return low, high


@kernel
def continues_face(one: Obstacle, x: float, y: float, ux: float, uy: float, near: float) -> bool:
    """Return whether an obstacle has a collinear face in the same direction: it covers nothing."""
    for i in range(edge_count(one) if one.sort != DISC else 0):
        ax, ay, ex, ey, _ = edge_of(one, i)
        offset = abs(uy * (ax - x) - ux * (ay - y))
        if offset <= near and abs(ux * ey - uy * ex) <= FLUSH and ux * ex + uy * ey > 0.0:
            return True
    return False


@kernel
def have_contact_law(numbers: BodyNumbers, one: int, other: int) -> bool:
    """Return whether two pieces, or a piece and a surface, have a contact law."""
    count = len(numbers.pieces.sizes)
    if one >= count:
        one, other = other, one
    if one >= count:
        return False
    b, kinds = numbers.pieces.bodies[one], numbers.kinds
    if other >= count:
        s = other - count
        carrier = numbers.surfaces.carriers[s]
        return carrier != b and numbers.laws[kinds[b], len(numbers.laws) + s] >= 0
    c = numbers.pieces.bodies[other]
    return b != c and not is_joined(numbers.joints, b, c) and numbers.laws[kinds[b], kinds[c]] >= 0


@kernel
def _velocity(
    numbers: BodyNumbers, mid: Midpoint, q: int, x: float, y: float
) -> tuple[float, float, float]:
    """Return the velocity of a piece's or surface's point at x, y, and its angular velocity."""
    b = carrier_of(numbers, q)
    turning = mid.old_rates[b, 2]
    u, v = x - mid.poses[b, 0], y - mid.poses[b, 1]
    return mid.old_rates[b, 0] - turning * v, mid.old_rates[b, 1] + turning * u, turning


@kernel
def is_relatively_still(
    numbers: BodyNumbers, mid: Midpoint, pair: tuple[int, int], x: float, y: float, h: float,
    near: float,
) -> bool:  # fmt: skip
    """Return whether the relative motion of two obstacles at x, y is below `near` in a step."""
    u, v, turning = _velocity(numbers, mid, pair[0], x, y)
    other_u, other_v, other_turning = _velocity(numbers, mid, pair[1], x, y)
    along, across = u - other_u, v - other_v
    turned = near / FLUSH * (turning - other_turning)
    return h * h * (along * along + across * across + turned * turned) <= near * near


COVERING = 64
"""Capacity of obstacles at a contact."""

# Search distance of obstacles, relative to the touched one: contact points nearer than half of it
# are one.
_AROUND = 2e-3


class TouchedSide(NamedTuple):
    """One side of a pair, as touched by the other."""

    which: int  # A piece, or a plate (indices behind the pieces).
    by: int  # The touching one.
    side: float  # Normals point away from it (1) or into it (-1).
    covering: Ints  # (c,): itself, and the obstacles around; see `near_obstacles`.
    # Whether the contact is compliant. Points at ends of faces that others continue would make it
    # stiffer; between rigid bodies they change no motion.
    soft: bool


class Neighbours(NamedTuple):
    """The pieces near each piece."""

    # Pairs by their second piece (see `contacts.collision_detection.broad_phase.sort_by_key`).
    heads: Ints  # shape (p + 1,)
    order: Ints
    # (p,): the pieces near one piece, and their number.
    others: Ints
    n_others: Ints
    covering: Ints  # (c,): buffer; see `near_obstacles`.


@kernel
def list_neighbours(pairs: Ints, begin: int, end: int, p: int, near: Neighbours) -> None:
    """List the pieces near p, whose pairs with later pieces are from `begin` to `end`."""
    n_near = 0
    for i in range(near.heads[p], near.heads[p + 1]):
        near.others[n_near] = pairs[near.order[i], 0]
        n_near += 1
    for i in range(begin, end):
        near.others[n_near] = pairs[i, 1]
        n_near += 1
    near.n_others[0] = n_near


@kernel
def near_obstacles(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int],
    near_pieces: Neighbours, h: float, manifold: Array, count: int,
) -> int:  # fmt: skip
    """List the obstacles at the contact points of one side of a pair; return their number.

    The first of the `pair` is touched by the second. `near_pieces.covering` receives the first, and
    the pieces and surfaces at rest relative to it that the second can touch; `manifold` (m, FOUND)
    has `count` contact points.
    """
    pieces, surfaces, (one, touched_by) = numbers.pieces, numbers.surfaces, pair
    all_pieces, n_near = len(pieces.sizes), 1
    others, covering = near_pieces.others, near_pieces.covering
    count_others = near_pieces.n_others[0]
    covering[0] = one
    plate = one >= all_pieces
    body = -1 if plate else pieces.bodies[one]
    if plate:
        s = one - all_pieces
        pose = mid.poses[surfaces.carriers[s]]
        size = _surface_obstacle(surfaces, s, pose, ground, 0.0, 0.0).size
    else:
        size = pieces.sizes[one]
        first, end = pieces.begins[body], pieces.begins[body + 1]
        is_compound = False
        for q in range(first, end):
            is_compound = is_compound or (
                q != one and _near_circle(mid, pieces, q, manifold, count, size) >= 0
            )
        # Several pieces may cover a face.
        for q in range(first, end if is_compound else first):
            if q != one and n_near < len(covering):
                covering[n_near] = q
                n_near += 1
    solid = touched_by >= all_pieces and surfaces.kinds[touched_by - all_pieces] not in (
        PLATE,
        ROUND,
    )
    if solid or (not plate and pieces.radii[one] > 0.0):
        # Half-planes and rims have one normal, which others do not take away.
        return n_near
    for k in range(count_others + len(surfaces.kinds)):
        is_piece = k < count_others
        q = others[k] if is_piece else all_pieces + k - count_others
        if q in (one, touched_by) or (is_piece and pieces.bodies[q] == body):
            continue
        if is_piece:
            at = _near_circle(mid, pieces, q, manifold, count, size)
        else:
            at = _near_obstacle(numbers, ground, mid, q, manifold, count, size)
        near = FLUSH * (min(size, pieces.sizes[q]) if is_piece else size)
        if (
            at < 0
            or n_near == len(covering)
            or not is_relatively_still(
                numbers, mid, (one, q), manifold[at, 2], manifold[at, 3], h, near
            )
        ):
            continue
        if is_piece and _near_obstacle(numbers, ground, mid, q, manifold, count, size) < 0:
            continue
        if have_contact_law(numbers, touched_by, q):
            covering[n_near] = q
            n_near += 1
    return n_near


@kernel
def _near_circle(
    mid: Midpoint, pieces: PieceNumbers, q: int, manifold: Array, count: int, size: float
) -> int:
    """Return the first contact point near the circumscribed circle of a piece; -1: none."""
    for i in range(count):
        x, y = manifold[i, 2] - mid.centres[q, 0], manifold[i, 3] - mid.centres[q, 1]
        reach = pieces.sizes[q] + _AROUND * size + 2.0 * abs(manifold[i, 4])
        if x * x + y * y <= reach * reach:
            return i
    return -1


@kernel
def _near_obstacle(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, q: int, manifold: Array, count: int,
    size: float,
) -> int:  # fmt: skip
    """Return the first contact point near a piece or surface; -1: none."""
    s = q - len(numbers.pieces.sizes)
    for i in range(count):
        x, y = manifold[i, 2], manifold[i, 3]
        if s >= 0:
            away = distance(numbers.surfaces, s, mid.poses[carrier_of(numbers, q)], x, y)
        else:
            away = distance_to(make_obstacle(numbers, ground, mid, q, x, y), x, y)
        if away <= _AROUND * size + 2.0 * abs(manifold[i, 4]):
            return i
    return -1


# Largest angle between a contact normal and that of a face it belongs to, inside the face.
_LEANS = 0.1

# Bare face contact; bare corner or rim contact; covered contact; contact whose normal the corner
# does not admit, as any deeper one along it.
_OF_FACE, _OF_CORNER, _COVERED, _BARRED = range(4)


@kernel
def _point_beyond(
    one: Obstacle, place: tuple[float, float], outward: tuple[float, float], far: float
) -> tuple[float, float]:
    """Return an interior point of the touching obstacle, or one far out for a surface."""
    x, y = place[0] + far * outward[0], place[1] + far * outward[1]
    if one.sort == DISC:
        x, y = one.centre[0], one.centre[1]
    elif one.sort == POLYGON:
        x = y = 0.0
        for i in range(len(one.corners)):
            x += one.corners[i, 0] / len(one.corners)
            y += one.corners[i, 1] / len(one.corners)
    return x, y


@kernel
def _face_at(
    one: Obstacle, place: tuple[float, float], outward: tuple[float, float], leans: float
) -> int:
    """Return the face with this normal at a point; -1: a corner or a rim.

    With a tolerance `leans` above round-off, the point must be between the ends.
    """
    near, inset = FLUSH * one.size, FLUSH * one.size if leans > FLUSH else -math.inf
    for i in range(edge_count(one) if one.sort != DISC else 0):
        ax, ay, ux, uy, length = edge_of(one, i)
        away = uy * (place[0] - ax) - ux * (place[1] - ay)
        along = ux * (place[0] - ax) + uy * (place[1] - ay)
        turned, facing = uy * outward[1] + ux * outward[0], uy * outward[0] - ux * outward[1]
        inside = inset < along < length - inset
        if abs(away) <= near and abs(turned) <= leans and facing >= 0.0 and inside:
            return i
    return -1


@kernel
def _ends_in_face(
    one: Obstacle, other: Obstacle, place: tuple[float, float], outward: tuple[float, float],
    near: float,
) -> bool:  # fmt: skip
    """Return whether a face ends at a place and another obstacle continues it."""
    for i in range(edge_count(one) if one.sort != DISC else 0):
        ax, ay, ux, uy, length = edge_of(one, i)
        along = ux * (place[0] - ax) + uy * (place[1] - ay)
        turned, facing = uy * outward[1] + ux * outward[0], uy * outward[0] - ux * outward[1]
        at_end = min(abs(along), abs(along - length)) <= near
        if at_end and abs(turned) <= _LEANS and facing >= 0.0:
            return continues_face(other, place[0], place[1], ux, uy, near)
    return False


@kernel
def _covered_length(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, touched: TouchedSide,
    start: tuple[float, float], way: tuple[float, float], along_face: float, length: float,
) -> float:  # fmt: skip
    """Return how far solid obstacles cover a face from its end.

    `start`, `way`: end of the face, and direction from there along it; `along_face`: 1 if that is
    the direction with the solid on the left, else -1.
    """
    (x, y), (ux, uy), covered, grows = start, way, 0.0, True
    size = make_obstacle(numbers, ground, mid, touched.which, x, y).size
    while grows and covered < length - FLUSH * size:
        grows = False
        for q in touched.covering:
            at = x + covered * ux, y + covered * uy
            other = make_obstacle(numbers, ground, mid, q, at[0], at[1])
            near = FLUSH * min(size, other.size)
            if q == touched.which or continues_face(
                other, x, y, along_face * ux, along_face * uy, near
            ):
                continue
            low, high = chord_interval(other, x, y, ux, uy, near)
            if low <= covered + near and high > covered + near:
                covered, grows = high, True
    return covered


@kernel
def _is_face_covered(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, touched: TouchedSide, one: Obstacle, i: int
) -> bool:
    """Return whether solid obstacles cover a face of the touched obstacle entirely."""
    ax, ay, ux, uy, length = edge_of(one, i)
    covered = _covered_length(numbers, ground, mid, touched, (ax, ay), (ux, uy), 1.0, length)
    return covered >= length - FLUSH * one.size


@kernel
def _is_covered(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, touched: TouchedSide,
    place: tuple[float, float], outward: tuple[float, float],
) -> bool:  # fmt: skip
    """Return whether a point is on a face that solid obstacles cover entirely."""
    one = make_obstacle(numbers, ground, mid, touched.which, place[0], place[1])
    i = _face_at(one, place, outward, FLUSH)
    return i >= 0 and _is_face_covered(numbers, ground, mid, touched, one, i)


@kernel
def _separates(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, touched: TouchedSide, i: int,
    place: tuple[float, float], middle: tuple[float, float], rays: Array,
) -> bool:  # fmt: skip
    """Return whether an obstacle at an end of a face stands between the face and a body.

    At the end of the face's bare part it is the first obstacle met when the direction along the
    face turns outward. The body's middle is beyond it, and the segment from there to the contact
    point crosses it, or the face, or the continuation of the obstacle.
    """
    one = make_obstacle(numbers, ground, mid, touched.which, place[0], place[1])
    ax, ay, ex, ey, length = edge_of(one, i)
    nx, ny, (u, v), (cx, cy) = ey, -ex, place, middle
    for way in (1.0, -1.0):
        x, y = (ax, ay) if way > 0.0 else (ax + length * ex, ay + length * ey)
        tx, ty = way * ex, way * ey
        covered = _covered_length(numbers, ground, mid, touched, (x, y), (tx, ty), way, length)
        x, y, n_near = x + covered * tx, y + covered * ty, 0
        for q in touched.covering:
            other = make_obstacle(numbers, ground, mid, q, x, y)
            near = FLUSH * min(one.size, other.size)
            # A disc curves away from its rays, and may leave the face visible.
            if q != touched.which and other.sort != DISC and distance_to(other, x, y) <= near:
                n_near = add_rays(other, x, y, near, rays, n_near)
        turned = math.atan2((cx - x) * nx + (cy - y) * ny, (cx - x) * tx + (cy - y) * ty)
        if turned < 0.0:
            turned += 2.0 * math.pi
        along, before, crossed = (u - x) * tx + (v - y) * ty, False, turned > math.pi
        for k in range(n_near):
            dx, dy, reach = rays[k]
            angle = math.atan2(dx * nx + dy * ny, dx * tx + dy * ty)
            before = before or FLUSH < angle < min(turned, math.pi) - FLUSH
            crossed = crossed or _crosses_ray(
                (u, v), (cx, cy), (x, y), (dx, dy), reach, FLUSH * one.size
            )
        if before and (crossed or along <= FLUSH * one.size):
            return True
    return False


@kernel
def _crosses_ray(
    place: tuple[float, float], middle: tuple[float, float], start: tuple[float, float],
    ray: tuple[float, float], reach: float, near: float,
) -> bool:  # fmt: skip
    """Return whether the segment from a place to a middle crosses a ray or passes its start."""
    (u, v), (cx, cy), (x, y), (dx, dy) = place, middle, start, ray
    # Side of the ray of both ends, and the crossing along it.
    here, there = dx * (v - y) - dy * (u - x), dx * (cy - y) - dy * (cx - x)
    if here * there > 0.0 and abs(here) > near:
        return False
    part_of = here / (here - there) if here != there else 0.0
    along = (u + part_of * (cx - u) - x) * dx + (v + part_of * (cy - v) - y) * dy
    return -near <= along <= reach + near


@kernel
def drop_internal_edges(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, touched: TouchedSide, manifold: Array,
    features: Ints, count: int,
) -> tuple[int, bool]:  # fmt: skip
    """Remove contacts with internal edges, in place; return the number of remaining ones.

    And whether a corner does not admit its normal of least depth. The `count` contact points are in
    `manifold` (m, FOUND), with `features` (m,).
    """
    remaining, rays, classes = 0, np.empty((RAYS, 3)), np.empty(count, np.int64)
    barred = math.inf
    for i in range(count):
        classes[i] = _classify_point(numbers, ground, mid, touched, manifold[i], rays)
        if classes[i] == _BARRED:
            barred = min(barred, manifold[i, 4])
    for i in range(count):
        if classes[i] == _OF_FACE or (classes[i] == _OF_CORNER and manifold[i, 4] < barred):
            (nx, ny, x, y, gap), feature = manifold[i], features[i]
            write_contact(manifold[remaining], nx, ny, x, y, gap)
            features[remaining] = feature
            remaining += 1
    return remaining, barred < 0.0


@kernel
def _classify_point(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, touched: TouchedSide, point: Array,
    rays: Array,
) -> int:  # fmt: skip
    """Classify a contact point on the touched obstacle; see `_OF_FACE`."""
    which, by, side, covering, soft = touched
    all_pieces = len(numbers.pieces.sizes)
    body = numbers.pieces.bodies[which] if which < all_pieces else -1
    nx, ny, x, y, gap = point
    out = side * nx, side * ny
    one = make_obstacle(numbers, ground, mid, which, x, y)
    # The point is on either body.
    u, v = x - gap * out[0], y - gap * out[1]
    here, there, face = abs(distance_to(one, x, y)), abs(distance_to(one, u, v)), -1
    # Beside the end of a face both projections are on it, up to round-off: take the one on the
    # face.
    if max(here, there) <= FLUSH * one.size:
        face = _face_at(one, (u, v), out, FLUSH)
    if face < 0:
        if there >= here - FLUSH * one.size:
            u, v = x, y
        face = _face_at(one, (u, v), out, FLUSH)
    offset = False
    for q in covering:
        if q == which:
            continue
        other = make_obstacle(numbers, ground, mid, q, u, v)
        near = FLUSH * min(one.size, other.size)
        away = distance_to(other, u, v)
        if away > near:
            continue
        offset = True
        if soft and _ends_in_face(one, other, (u, v), out, near):
            touching = make_obstacle(numbers, ground, mid, by, u, v)
            on_it, inward = (u + gap * out[0], v + gap * out[1]), (-out[0], -out[1])
            if _face_at(touching, on_it, inward, _LEANS) >= 0:
                return _COVERED
        same = q < all_pieces and numbers.pieces.bodies[q] == body
        if same and away >= -near and _faces_outward(other, (u, v), out, near, rays):
            # Two pieces share a contact: the first has it, unless another piece covers it there.
            first = TouchedSide(q, by, side, covering, soft)
            if q < which and not _is_covered(numbers, ground, mid, first, (u, v), out):
                return _COVERED
        elif face < 0 and one.sort == DISC:
            # A rim contact beside another obstacle is as deep in that as its point.
            deep = -distance_to(other, u + gap * out[0], v + gap * out[1])
            if away < -(near + 2.0 * max(deep, 0.0)):
                return _COVERED
        elif face < 0 and (away < -near or not _in_cone(other, (u, v), out, near, -FLUSH, rays)):
            # Another piece of the body may be far from the other contact points.
            return _COVERED if same else _BARRED
    if face < 0:
        # Two faces in contact share a normal.
        return _OF_CORNER if _face_at(one, (u, v), out, _LEANS) < 0 else _OF_FACE
    if offset and _is_covered(numbers, ground, mid, touched, (u, v), out):
        return _COVERED
    middle = _point_beyond(make_obstacle(numbers, ground, mid, by, u, v), (u, v), out, one.size)
    if _separates(numbers, ground, mid, touched, face, (u, v), middle, rays):
        return _COVERED
    return _OF_FACE


@kernel
def _in_cone(
    other: Obstacle, place: tuple[float, float], outward: tuple[float, float], near: float,
    most: float, rays: Array,
) -> bool:  # fmt: skip
    """Return whether a direction is in the normal cone of an obstacle at a boundary point.

    Its cosine to every boundary ray is at most `most`: below zero inside the cone. On the cone's
    boundary it is a face normal, and the face has this contact itself.
    """
    for k in range(add_rays(other, place[0], place[1], near, rays, 0)):
        if outward[0] * rays[k, 0] + outward[1] * rays[k, 1] > most:
            return False
    return True


@kernel
def _faces_outward(
    one: Obstacle, place: tuple[float, float], outward: tuple[float, float], near: float,
    rays: Array,
) -> bool:  # fmt: skip
    """Return whether a direction is in the normal cone of a piece, including the cone's boundary.

    The opposite of a face normal is not: it points to the interior.
    """
    x, y = _point_beyond(one, place, outward, 0.0)
    ahead = outward[0] * (place[0] - x) + outward[1] * (place[1] - y) > 0.0
    return ahead and _in_cone(one, place, outward, near, FLUSH, rays)


@kernel
def find_face_contacts(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, touched: TouchedSide, whole: bool,
    manifold: Array, features: Ints,
) -> int:  # fmt: skip
    """Find contact points of an overlap with a face; return their number.

    `whole`: whether both are pieces; `manifold` (m, FOUND) and `features` (m,) are written.
    """
    one = make_obstacle(numbers, ground, mid, touched.which, 0.0, 0.0)
    other = make_obstacle(numbers, ground, mid, touched.by, 0.0, 0.0)
    if len(one.corners) == 0 or len(other.corners) == 0 or HALF in (one.sort, other.sort):
        return 0
    # Plates come first in a pair (see `contacts.collision_detection.surfaces`).
    flip = touched.side > 0.0 if whole else touched.side < 0.0
    bare = np.empty(len(one.corners), np.bool_)
    for i in range(len(bare)):
        bare[i] = not (touched.soft and _is_face_covered(numbers, ground, mid, touched, one, i))
    count = face_contacts(one.corners, bare, other.corners, flip, manifold, features)
    for i in range(count if not whole else 0):
        manifold[i, 0], manifold[i, 1] = -manifold[i, 0], -manifold[i, 1]
    return count
