"""Contact manifolds of convex shapes: discs and polygons in the plane.

Separating axis theorem: the edge normal of largest separation is the contact normal; the facing
edge, clipped to the width of the reference edge, gives the contact points (Gottschalk, Lin and
Manocha 1996; Catto, Contact manifolds, 2007).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel


class ConvexShape(NamedTuple):
    """A convex polygon or a disc in the world."""

    corners: Array  # (k, 2): counter-clockwise; empty for a disc.
    centre: Array  # shape (2,)
    radius: float  # 0 for a polygon.


FOUND = 5
"""Columns of a contact point: normal towards the first body (2), point (2), gap."""

# Relative difference of separations that are equal: then the normal of the longer face is taken, in
# any order of the bodies, so that the faces do not alternate.
_PREFERRED = 1e-3
# Relative difference of lengths that are equal, as those of congruent bodies.
_SAME_LENGTH = 1e-9
# Distance of coincident points, relative to the shorter edge.
_SAME_DIRECTION = 1e-3
# Cosine between opposite normals above which only the ends of an edge touch.
_FACING = 0.1
# Difference of equal gaps, relative to that distance: far above round-off.
_EVEN = 1e-6
# Distance of corners that meet, and of faces that end side by side, relative to the smaller reach:
# far above round-off.
_MEETING = 1e-6
# Features of contact points are numbers of two corners or edges, of polygons with fewer corners.
_MOST_CORNERS = 64


@kernel
def norm(x: float, y: float) -> float:
    """Return the length of a vector: `hypot` of the C library takes ten times as long."""
    return math.sqrt(x * x + y * y)


@kernel
def interval_within(x: float, y: float, u: float, v: float, apart: float) -> tuple[float, float]:
    """Return the interval in which a point, now at x, y with velocity u, v, is within `apart` of 0.

    (inf, inf) if it never is.
    """
    # |r + v t|^2 = apart^2
    square, half, rest = u * u + v * v, x * u + y * v, x * x + y * y - apart * apart
    inside = half * half - square * rest
    if not inside > 0.0:
        return math.inf, math.inf
    root = math.sqrt(inside)
    return (-half - root) / square, (-half + root) / square


@kernel
def write_contact(point: Array, nx: float, ny: float, x: float, y: float, gap: float) -> None:
    """Write a contact point; see `FOUND`."""
    point[0], point[1], point[2], point[3], point[4] = nx, ny, x, y, gap


@kernel
def place_vertices(vertices: Array, x: float, y: float, angle: float) -> Array:
    """Return vertices (k, 2) of a body frame in the world."""
    world = np.empty_like(vertices)
    write_placed_vertices(vertices, 0, len(vertices), x, y, math.cos(angle), math.sin(angle), world)
    return world


@kernel
def write_placed_vertices(
    vertices: Array, first: int, end: int, x: float, y: float, c: float, s: float, world: Array
) -> None:
    """Write some of the vertices (k, 2) of body frames in the world."""
    for i in range(first, end):
        world[i, 0] = x + c * vertices[i, 0] - s * vertices[i, 1]
        world[i, 1] = y + s * vertices[i, 0] + c * vertices[i, 1]


@kernel
def _separation_across(one: Array, edge: int, other: Array) -> float:
    """Return the separation of two polygons along an edge normal of the first."""
    j = (edge + 1) % len(one)
    ex, ey = one[j, 0] - one[edge, 0], one[j, 1] - one[edge, 1]
    length = norm(ex, ey)
    nx, ny = ey / length, -ex / length
    least = math.inf
    for k in range(len(other)):
        least = min(least, nx * (other[k, 0] - one[edge, 0]) + ny * (other[k, 1] - one[edge, 1]))
    return least


@kernel
def _separating_edge(one: Array, other: Array) -> tuple[float, int]:
    """Return the largest separation along an edge normal of `one`, and that edge."""
    best, edge = -math.inf, 0
    for i in range(len(one)):
        least = _separation_across(one, i, other)
        if least > best:
            best, edge = least, i
    return best, edge


@kernel
def _clip_edges(
    one: Array, edge: int, other: Array, within: float, flip: bool, manifold: Array, features: Ints
) -> int:
    j = (edge + 1) % len(one)
    ex, ey = one[j, 0] - one[edge, 0], one[j, 1] - one[edge, 1]
    length = norm(ex, ey)
    ex, ey = ex / length, ey / length
    nx, ny = ey, -ex
    facing, least = 0, math.inf
    for k in range(len(other)):
        m = (k + 1) % len(other)
        dx, dy = other[m, 0] - other[k, 0], other[m, 1] - other[k, 1]
        against = (dy * nx - dx * ny) / norm(dx, dy)
        if against < least:
            least, facing = against, k
    m = (facing + 1) % len(other)
    across = norm(other[m, 0] - other[facing, 0], other[m, 1] - other[facing, 1])
    count, same = 0, _SAME_DIRECTION * min(length, across)
    ax, ay, bx, by = other[facing, 0], other[facing, 1], other[m, 0], other[m, 1]
    sa = ex * (ax - one[edge, 0]) + ey * (ay - one[edge, 1])
    sb = ex * (bx - one[edge, 0]) + ey * (by - one[edge, 1])
    for end in range(2):
        s, x, y = (sa, ax, ay) if end == 0 else (sb, bx, by)
        t, u, v = (sb, bx, by) if end == 0 else (sa, ax, ay)
        clipped = s
        if s < 0.0:
            clipped = 0.0
        elif s > length:
            clipped = length
        if clipped != s:
            # The other end of the facing edge must lie beyond the cut.
            if (clipped - s) * (t - clipped) <= 0.0:
                continue
            part = (clipped - s) / (t - s)
            x, y = x + part * (u - x), y + part * (v - y)
        gap = nx * (x - one[edge, 0]) + ny * (y - one[edge, 1])
        if clipped != s and gap > 0.0 and least > -_FACING:
            continue
        # Coincident points would share their impulse arbitrarily: take the deeper one, or their
        # middle, which is independent of reflection.
        which = end
        if count == 1 and norm(x - manifold[0, 2], y - manifold[0, 3]) <= same:
            if abs(gap - manifold[0, 4]) <= _EVEN * same:
                x, y, which = 0.5 * (x + manifold[0, 2]), 0.5 * (y + manifold[0, 3]), 2
            elif gap > manifold[0, 4]:
                continue
            count = 0
        if gap <= within:
            sign = -1.0 if flip else 1.0
            write_contact(manifold[count], -sign * nx, -sign * ny, x, y, gap)
            features[count] = 6 * (_MOST_CORNERS * edge + facing) + 2 * which + (1 if flip else 0)
            count += 1
    return count


@kernel
def _feature_of_corners(a: int, b: int) -> int:
    """Return the feature of two corners: negative, as those of edges are not."""
    return -1 - (_MOST_CORNERS * a + b)


@kernel
def _nearest_corners(
    one: Array, other: Array, within: float, manifold: Array, features: Ints
) -> int:
    """Write the nearest corners of polygons whose facing edges do not overlap."""
    best, a, b = math.inf, 0, 0
    for i in range(len(one)):
        for k in range(len(other)):
            d = norm(one[i, 0] - other[k, 0], one[i, 1] - other[k, 1])
            if d < best:
                best, a, b = d, i, k
    if best > within or best == 0.0:
        return 0
    nx, ny = (one[a, 0] - other[b, 0]) / best, (one[a, 1] - other[b, 1]) / best
    write_contact(manifold[0], nx, ny, other[b, 0], other[b, 1], best)
    features[0] = _feature_of_corners(a, b)
    return 1


@kernel
def _outward(corners: Array, edge: int) -> tuple[float, float]:
    """Return the outward normal of an edge."""
    j = (edge + 1) % len(corners)
    ex, ey = corners[j, 0] - corners[edge, 0], corners[j, 1] - corners[edge, 1]
    length = norm(ex, ey)
    return ey / length, -ex / length


@kernel
def _meeting_corners(
    one: Array, edge: int, other: Array, edge_of_other: int, within: float, width: float,
    manifold: Array, features: Ints,
) -> int:  # fmt: skip
    """Write the point of two corners that meet; return 0 if there are none.

    Its normal bisects those of both faces: one of these would depend on the order of the bodies,
    the difference of the corners on round-off. Corners with parallel faces meet by these.
    """
    ax, ay = _outward(one, edge)
    bx, by = _outward(other, edge_of_other)
    if abs(ax * by - ay * bx) <= _SAME_DIRECTION or ax * bx + ay * by >= -_FACING:
        return 0
    length = norm(bx - ax, by - ay)
    nx, ny = (bx - ax) / length, (by - ay) / length
    for i in (edge, (edge + 1) % len(one)):
        for k in (edge_of_other, (edge_of_other + 1) % len(other)):
            x, y = one[i, 0] - other[k, 0], one[i, 1] - other[k, 1]
            gap = nx * x + ny * y
            if norm(x, y) <= _MEETING * width and gap <= within:
                write_contact(manifold[0], nx, ny, other[k, 0], other[k, 1], gap)
                features[0] = _feature_of_corners(i, k)
                return 1
    return 0


@kernel
def _disc_and_polygon(
    disc: ConvexShape, polygon: Array, flip: bool, within: float, manifold: Array
) -> int:
    _, centre, radius = disc
    best, edge = -math.inf, 0
    for i in range(len(polygon)):
        j = (i + 1) % len(polygon)
        ex, ey = polygon[j, 0] - polygon[i, 0], polygon[j, 1] - polygon[i, 1]
        length = norm(ex, ey)
        away = (ey * (centre[0] - polygon[i, 0]) - ex * (centre[1] - polygon[i, 1])) / length
        if away > best:
            best, edge = away, i
    j = (edge + 1) % len(polygon)
    ex, ey = polygon[j, 0] - polygon[edge, 0], polygon[j, 1] - polygon[edge, 1]
    length = norm(ex, ey)
    s = (ex * (centre[0] - polygon[edge, 0]) + ey * (centre[1] - polygon[edge, 1])) / length
    part = min(max(s / length, 0.0), 1.0)
    x, y = polygon[edge, 0] + part * ex, polygon[edge, 1] + part * ey
    nx, ny = ey / length, -ex / length
    gap = best - radius
    # The centre may lie on the line of a body without thickness.
    if best >= 0.0 and (s < 0.0 or s > length):
        away = norm(centre[0] - x, centre[1] - y)
        # A centre on the corner has any normal.
        if away > 0.0:
            nx, ny, gap = (centre[0] - x) / away, (centre[1] - y) / away, away - radius
    if gap > within:
        return 0
    sign = -1.0 if flip else 1.0
    write_contact(manifold[0], sign * nx, sign * ny, x, y, gap)
    return 1


@kernel
def shape_contacts(
    one: ConvexShape, other: ConvexShape, within: float, manifold: Array, features: Ints
) -> int:
    """Find the contact points of two shapes up to a gap `within`; return their number.

    `manifold` (m, FOUND) and `features` (m,) are written.
    """
    # A disc has one point.
    features[0] = 0
    if len(one.corners) > 0 and len(other.corners) > 0:
        return _polygons(one, other, within, manifold, features)
    if len(other.corners) > 0:
        return _disc_and_polygon(one, other.corners, False, within, manifold)
    if len(one.corners) > 0:
        return _disc_and_polygon(other, one.corners, True, within, manifold)
    dx, dy = one.centre[0] - other.centre[0], one.centre[1] - other.centre[1]
    away = norm(dx, dy)
    gap = away - one.radius - other.radius
    if gap > within:
        return 0
    nx, ny = (dx / away, dy / away) if away > 0.0 else (0.0, 1.0)
    x, y = other.centre[0] + other.radius * nx, other.centre[1] + other.radius * ny
    write_contact(manifold[0], nx, ny, x, y, gap)
    return 1


@kernel
def face_contacts(
    one: Array, bare: Bools, other: Array, flip: bool, manifold: Array, features: Ints
) -> int:
    """Find contact points with the bare faces of `one`, not its corners; see `shape_contacts`.

    Polygons are (k, 2), the bare edges of the first (k,); `flip`: the first is the second body.
    """
    best, edge = -math.inf, -1
    for i in range(len(one)):
        if bare[i] and _separation_across(one, i, other) > best:
            best, edge = _separation_across(one, i, other), i
    return _clip_edges(one, edge, other, 0.0, flip, manifold, features) if edge >= 0 else 0


@kernel
def _reach(corners: Array, middle: Array) -> float:
    """Return the largest distance of a corner from the middle."""
    most = 0.0
    for i in range(len(corners)):
        most = max(most, norm(corners[i, 0] - middle[0], corners[i, 1] - middle[1]))
    return most


@kernel
def _edge_length(corners: Array, edge: int) -> float:
    j = (edge + 1) % len(corners)
    return norm(corners[j, 0] - corners[edge, 0], corners[j, 1] - corners[edge, 1])


@kernel
def _separation_along(one: Array, edge: int, other: Array) -> float:
    """Return the separation of two polygons along an edge of the first; < 0: they overlap."""
    j = (edge + 1) % len(one)
    ex, ey, length = one[j, 0] - one[edge, 0], one[j, 1] - one[edge, 1], _edge_length(one, edge)
    low, high, least, most = math.inf, -math.inf, math.inf, -math.inf
    for k in range(len(one)):
        along = (ex * (one[k, 0] - one[edge, 0]) + ey * (one[k, 1] - one[edge, 1])) / length
        low, high = min(low, along), max(high, along)
    for k in range(len(other)):
        along = (ex * (other[k, 0] - one[edge, 0]) + ey * (other[k, 1] - one[edge, 1])) / length
        least, most = min(least, along), max(most, along)
    return max(least - high, low - most)


@kernel
def _polygons(
    shape: ConvexShape, other_shape: ConvexShape, within: float, manifold: Array, features: Ints
) -> int:
    """Find the contact points of two polygons; see `shape_contacts`."""
    one, other = shape.corners, other_shape.corners
    first, edge = _separating_edge(one, other)
    if first > within:
        return 0
    second, edge_of_other = _separating_edge(other, one)
    if second > within:
        return 0
    width = min(_reach(one, shape.centre), _reach(other, other_shape.centre))
    farther = second > first
    if max(first, second) > 0.0:
        # A corner that passes along a face, over a gap between level faces, strikes no side.
        across = (
            _separation_along(other, edge_of_other, one)
            if farther
            else _separation_along(one, edge, other)
        )
        if abs(across) <= _MEETING * width:
            return 0
    if abs(second - first) <= _PREFERRED * width:
        length = _edge_length(one, edge)
        farther = _edge_length(other, edge_of_other) > (1.0 + _SAME_LENGTH) * length
    count, turn = 0, 0
    # The preferred face may have no point where the farther one has: a tip just before a corner.
    while count == 0 and turn < (2 if farther != (second > first) else 1):
        if farther == (turn == 0):
            count = _clip_edges(other, edge_of_other, one, within, True, manifold, features)
        else:
            count = _clip_edges(one, edge, other, within, False, manifold, features)
        turn += 1
    if count <= 1 and _meeting_corners(
        one, edge, other, edge_of_other, within, width, manifold, features
    ):
        return 1
    if count == 0 and max(first, second) > 0.0:
        return _nearest_corners(one, other, within, manifold, features)
    return count
