"""Internal edges: contacts that adjacent obstacles cover (ghost collisions).

Two edges that end in each other, two tiles side by side and two pieces of one body make one
boundary. Against each of them alone, a body that slides along it meets the end of the next. Box2D
leaves such contacts out by the ghost vertices of its chains (Catto 2020), Bullet by the Voronoi
regions of the edges of a mesh. Here they follow from all obstacles that touch the feature of a
contact and do not move against it:

- a corner has the normals that are in the normal cones of all obstacles at it;
- a face has none where obstacles cover it all along, or stand between its end and the body.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers
from contacts.collision_detection.convex import against_faces, write
from contacts.collision_detection.ground import Ground
from contacts.collision_detection.midpoint import Midpoint
from contacts.collision_detection.obstacles import (
    DISC,
    FLUSH,
    HALF,
    POLYGON,
    RAYS,
    Obstacle,
    add_rays,
    between_normals,
    chord,
    distance_to,
    edge_of,
    edges,
    goes_on,
    obstacle,
)
from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel

# The normal of a contact is that of a face where it leans by less than this, and the point is
# between the ends of that.
_LEANS = 0.1

# A contact with a face, or with a corner or a rim, that is bare; one that is covered; one whose
# normal the corner does not have, nor has a contact along it that is less deep.
_OF_FACE, _OF_CORNER, _COVERED, _BARRED = range(4)


@kernel
def _beyond(
    one: Obstacle, place: tuple[float, float], outward: tuple[float, float], far: float
) -> tuple[float, float]:
    """Return a point of what touches a face: its middle, or one far out where it is a surface."""
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
def _face(
    one: Obstacle, place: tuple[float, float], outward: tuple[float, float], leans: float
) -> int:
    """Return on which face with this normal a point is; -1: on a corner or a rim.

    What may lean by more than rounding is between the ends of the face.
    """
    near, inset = FLUSH * one.size, FLUSH * one.size if leans > FLUSH else -math.inf
    for i in range(edges(one) if one.sort != DISC else 0):
        ax, ay, ux, uy, length = edge_of(one, i)
        away = uy * (place[0] - ax) - ux * (place[1] - ay)
        along = ux * (place[0] - ax) + uy * (place[1] - ay)
        turned, facing = uy * outward[1] + ux * outward[0], uy * outward[0] - ux * outward[1]
        inside = inset < along < length - inset
        if abs(away) <= near and abs(turned) <= leans and facing >= 0.0 and inside:
            return i
    return -1


@kernel
def _covered_to(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, one: Obstacle, which: int, covering: Ints,
    start: tuple[float, float], way: tuple[float, float], along_face: float, length: float,
) -> float:  # fmt: skip
    """Return how far solid obstacles cover a face from its end on.

    `start`, `way`: the end of the face, and the direction from there along it; `along_face`: 1
    where that is the direction of the face, in which its solid is on the left; else -1.
    """
    (x, y), (ux, uy), covered, gained = start, way, 0.0, True
    while gained and covered < length - FLUSH * one.size:
        gained = False
        for q in covering:
            at = x + covered * ux, y + covered * uy
            other = obstacle(numbers, ground, mid, q, at[0], at[1])
            near = FLUSH * min(one.size, other.size)
            if q == which or goes_on(other, x, y, along_face * ux, along_face * uy, near):
                continue
            low, high = chord(other, x, y, ux, uy, near)
            if low <= covered + near and high > covered + near:
                covered, gained = high, True
    return covered


@kernel
def _is_covered(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, which: int, covering: Ints,
    place: tuple[float, float], outward: tuple[float, float],
) -> bool:  # fmt: skip
    """Return whether a point is on a face that solid obstacles cover all along."""
    one = obstacle(numbers, ground, mid, which, place[0], place[1])
    i = _face(one, place, outward, FLUSH)
    if i < 0:
        return False
    ax, ay, ux, uy, length = edge_of(one, i)
    covered = _covered_to(
        numbers, ground, mid, one, which, covering, (ax, ay), (ux, uy), 1.0, length
    )
    return covered >= length - FLUSH * one.size


@kernel
def _stands_between(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int], covering: Ints,
    i: int, place: tuple[float, float], middle: tuple[float, float], rays: Array,
) -> bool:  # fmt: skip
    """Return whether an obstacle at an end of a face stands between the face and a body.

    From where the face is bare, it is the first that the way out of the face turns to. The body's
    middle is beyond it, and the segment from there to the point of contact crosses it, or the face,
    or what goes on behind that.
    """
    which = pair[0]
    one = obstacle(numbers, ground, mid, which, place[0], place[1])
    ax, ay, ex, ey, length = edge_of(one, i)
    nx, ny, (u, v), (cx, cy) = ey, -ex, place, middle
    for way in (1.0, -1.0):
        x, y = (ax, ay) if way > 0.0 else (ax + length * ex, ay + length * ey)
        tx, ty = way * ex, way * ey
        covered = _covered_to(
            numbers, ground, mid, one, which, covering, (x, y), (tx, ty), way, length
        )
        x, y, many = x + covered * tx, y + covered * ty, 0
        for q in covering:
            other = obstacle(numbers, ground, mid, q, x, y)
            near = FLUSH * min(one.size, other.size)
            # A disc curves away from its rays: what is beyond them may see the face.
            if q != which and other.sort != DISC and distance_to(other, x, y) <= near:
                many = add_rays(other, x, y, near, rays, many)
        turned = math.atan2((cx - x) * nx + (cy - y) * ny, (cx - x) * tx + (cy - y) * ty)
        if turned < 0.0:
            turned += 2.0 * math.pi
        along, before, crossed = (u - x) * tx + (v - y) * ty, False, turned > math.pi
        for k in range(many):
            dx, dy, reach = rays[k]
            angle = math.atan2(dx * nx + dy * ny, dx * tx + dy * ty)
            before = before or FLUSH < angle < min(turned, math.pi) - FLUSH
            crossed = crossed or _crosses(
                (u, v), (cx, cy), (x, y), (dx, dy), reach, FLUSH * one.size
            )
        if before and (crossed or along <= FLUSH * one.size):
            return True
    return False


@kernel
def _crosses(
    place: tuple[float, float], middle: tuple[float, float], start: tuple[float, float],
    ray: tuple[float, float], reach: float, near: float,
) -> bool:  # fmt: skip
    """Return whether the segment from a place to a middle crosses a ray or passes its start."""
    (u, v), (cx, cy), (x, y), (dx, dy) = place, middle, start, ray
    # On which sides of the ray both are, and where on it the segment is.
    here, there = dx * (v - y) - dy * (u - x), dx * (cy - y) - dy * (cx - x)
    if here * there > 0.0 and abs(here) > near:
        return False
    part_of = here / (here - there) if here != there else 0.0
    along = (u + part_of * (cx - u) - x) * dx + (v + part_of * (cy - v) - y) * dy
    return -near <= along <= reach + near


@kernel
def drop_internal_edges(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int], covering: Ints,
    side: float, found: Array, features: Ints, count: int,
) -> tuple[int, bool]:  # fmt: skip
    """Leave out contacts with internal edges; return how many are left.

    And whether a corner does not have the normal by which it is least deep.

    Parameters
    ----------
    pair : (int, int)
        What is touched, a piece or a plate, and what touches it.
    covering : (c,) array of int
        See `contacts.collision_detection.obstacles.near_obstacles`.
    side : float
        Whether normals point away from it (1) or into it (-1).
    found : (m, FOUND), features : (m,) array of int, count : int
        Points of contact; those left come first.
    """
    kept, rays, how = 0, np.empty((RAYS, 3)), np.empty(count, np.int64)
    barred = math.inf
    for i in range(count):
        how[i] = _how(numbers, ground, mid, pair, covering, side, found[i], rays)
        if how[i] == _BARRED:
            barred = min(barred, found[i, 4])
    for i in range(count):
        if how[i] == _OF_FACE or (how[i] == _OF_CORNER and found[i, 4] < barred):
            (nx, ny, x, y, gap), feature = found[i], features[i]
            write(found[kept], nx, ny, x, y, gap)
            features[kept] = feature
            kept += 1
    return kept, barred < 0.0


@kernel
def _how(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int], covering: Ints,
    side: float, point: Array, rays: Array,
) -> int:  # fmt: skip
    """Return how a point of contact is on what is touched; see `_OF_FACE`."""
    which, all_pieces = pair[0], len(numbers.pieces.sizes)
    body = numbers.pieces.bodies[which] if which < all_pieces else -1
    nx, ny, x, y, gap = point
    out = side * nx, side * ny
    one = obstacle(numbers, ground, mid, which, x, y)
    # The point is on the one or on the other.
    u, v = x - gap * out[0], y - gap * out[1]
    here, there, face = abs(distance_to(one, x, y)), abs(distance_to(one, u, v)), -1
    # Beside the end of a face both are on it, but for rounding: that on the face is it.
    if max(here, there) <= FLUSH * one.size:
        face = _face(one, (u, v), out, FLUSH)
    if face < 0:
        if there >= here - FLUSH * one.size:
            u, v = x, y
        face = _face(one, (u, v), out, FLUSH)
    beside = False
    for q in covering:
        if q == which:
            continue
        other = obstacle(numbers, ground, mid, q, u, v)
        near = FLUSH * min(one.size, other.size)
        away = distance_to(other, u, v)
        if away > near:
            continue
        beside = True
        same = q < all_pieces and numbers.pieces.bodies[q] == body
        if same and away >= -near and between_normals(other, (u, v), out):
            # A contact of both pieces is that of the first, where no other covers it.
            if q < which and not _is_covered(numbers, ground, mid, q, covering, (u, v), out):
                return _COVERED
        elif face < 0 and one.sort == DISC:
            # A contact of a rim beside another obstacle is as deep in that as its point is.
            deep = -distance_to(other, u + gap * out[0], v + gap * out[1])
            if away < -(near + 2.0 * max(deep, 0.0)):
                return _COVERED
        elif face < 0 and (away < -near or not _in_cone(other, (u, v), out, near, rays)):
            # Another piece of the body may be far from the other points of contact.
            return _COVERED if same else _BARRED
    if face < 0:
        # Two faces that lie on each other share the normal of one.
        return _OF_CORNER if _face(one, (u, v), out, _LEANS) < 0 else _OF_FACE
    if beside and _is_covered(numbers, ground, mid, which, covering, (u, v), out):
        return _COVERED
    middle = _beyond(obstacle(numbers, ground, mid, pair[1], u, v), (u, v), out, one.size)
    if _stands_between(numbers, ground, mid, pair, covering, face, (u, v), middle, rays):
        return _COVERED
    return _OF_FACE


@kernel
def _in_cone(
    other: Obstacle, place: tuple[float, float], outward: tuple[float, float], near: float,
    rays: Array,
) -> bool:  # fmt: skip
    """Return whether a direction is inside the normal cone of an obstacle at a boundary point.

    On the boundary of the cone it is the normal of a face, which has this contact itself.
    """
    for k in range(add_rays(other, place[0], place[1], near, rays, 0)):
        if outward[0] * rays[k, 0] + outward[1] * rays[k, 1] > -FLUSH:
            return False
    return True


@kernel
def met_by_faces(
    numbers: BodyNumbers, ground: Ground, mid: Midpoint, pair: tuple[int, int], side: float,
    whole: bool, found: Array, features: Ints,
) -> int:  # fmt: skip
    """Find where one of a pair is overlapped through its faces; return how many points there are.

    Parameters
    ----------
    pair : (int, int)
        What is touched, and what touches it.
    side : float
        Whether normals point away from the first (1) or into it (-1).
    whole : bool
        Whether both are pieces.
    found : (m, FOUND), features : (m,) array of int
        To be filled.
    """
    one = obstacle(numbers, ground, mid, pair[0], 0.0, 0.0)
    other = obstacle(numbers, ground, mid, pair[1], 0.0, 0.0)
    if len(one.corners) == 0 or len(other.corners) == 0 or HALF in (one.sort, other.sort):
        return 0
    # Plates are the first, where they are met by others (`contacts.collision_detection.surfaces`).
    flip = side > 0.0 if whole else side < 0.0
    count = against_faces(one.corners, other.corners, 0.0, flip, found, features)
    for i in range(count if not whole else 0):
        found[i, 0], found[i, 1] = -found[i, 0], -found[i, 1]
    return count
