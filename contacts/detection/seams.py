"""What pieces of one body cover of each other: where they meet, nothing else can touch.

A face that other pieces cover all along is none: what slides over two boxes that make one flat top
meets no side of the second, as with plates that go on in each other (`surfaces`). A face that is
covered in part holds to its end, so that what lies in the angle of two pieces touches both. Corners
that are in other pieces are touched along normals of these alone.
"""

from __future__ import annotations

import math

from contacts.detection.body_numbers import PieceNumbers
from contacts.detection.convex import norm, write
from statechart.arrays import Array, Ints
from statechart.kernels.jit import late, part

# Pieces this close, relative to their size, are flush; normals of less than this angle are one.
_FLUSH = 1e-6


@part
def _away(pieces: PieceNumbers, centres: Array, world: Array, p: int, x: float, y: float) -> float:
    """Return how far a point is outside of a piece, along its normals; below zero in it."""
    if pieces.radii[p] > 0.0:
        return norm(x - centres[p, 0], y - centres[p, 1]) - pieces.radii[p]
    first, end = pieces.firsts[p], pieces.firsts[p + 1]
    most = -math.inf
    for i in range(first, end):
        j = i + 1 if i + 1 < end else first
        ex, ey = world[j, 0] - world[i, 0], world[j, 1] - world[i, 1]
        beside = (ey * (x - world[i, 0]) - ex * (y - world[i, 1])) / norm(ex, ey)
        most = max(most, beside)
    return most


@part
def _between_normals(
    pieces: PieceNumbers, centres: Array, world: Array, p: int, place: tuple[float, float],
    outward: tuple[float, float],
) -> bool:  # fmt: skip
    """Whether a direction is among the normals of a piece at a point of its boundary."""
    (x, y), (nx, ny) = place, outward
    first, end = pieces.firsts[p], pieces.firsts[p + 1]
    if pieces.radii[p] > 0.0:
        ux, uy = x - centres[p, 0], y - centres[p, 1]
        return abs(ux * ny - uy * nx) <= _FLUSH * pieces.radii[p] and ux * nx + uy * ny > 0.0
    near, many = _FLUSH * pieces.sizes[p], 0
    ax = ay = bx = by = 0.0
    for i in range(first, end):
        j = i + 1 if i + 1 < end else first
        ex, ey = world[j, 0] - world[i, 0], world[j, 1] - world[i, 1]
        length = norm(ex, ey)
        ux, uy = ey / length, -ex / length
        if abs(ux * (x - world[i, 0]) + uy * (y - world[i, 1])) <= near:
            if many == 0:
                ax, ay = ux, uy
            bx, by = ux, uy
            many += 1
    # The first of the two in a counter-clockwise sense; they turn by less than a half.
    if ax * by - ay * bx < 0.0:
        ax, ay, bx, by = bx, by, ax, ay
    ahead = (ax + bx) * nx + (ay + by) * ny > 0.0
    return many > 0 and ahead and ax * ny - ay * nx >= -_FLUSH and nx * by - ny * bx >= -_FLUSH


@part
def _along(
    pieces: PieceNumbers, centres: Array, world: Array, p: int, x: float, y: float, ux: float,
    uy: float,
) -> tuple[float, float]:  # fmt: skip
    """Return between which lengths a line from x, y along a unit vector is in a piece."""
    near, low, high = _FLUSH * pieces.sizes[p], -math.inf, math.inf
    if pieces.radii[p] > 0.0:
        dx, dy, reach = x - centres[p, 0], y - centres[p, 1], pieces.radii[p] + near
        half = dx * ux + dy * uy
        inside = half * half - (dx * dx + dy * dy - reach * reach)
        root = math.sqrt(max(inside, 0.0))
        return (-half - root, -half + root) if inside > 0.0 else (math.inf, -math.inf)
    first, end = pieces.firsts[p], pieces.firsts[p + 1]
    for i in range(first, end):
        j = i + 1 if i + 1 < end else first
        ex, ey = world[j, 0] - world[i, 0], world[j, 1] - world[i, 1]
        length = norm(ex, ey)
        nx, ny = ey / length, -ex / length
        beside = nx * (x - world[i, 0]) + ny * (y - world[i, 1]) - near
        rate = nx * ux + ny * uy
        if abs(rate) <= _FLUSH:
            if beside > 0.0:
                return math.inf, -math.inf
        elif rate > 0.0:
            high = min(high, -beside / rate)
        else:
            low = max(low, -beside / rate)
    return low, high


@part
def _goes_on(
    pieces: PieceNumbers, world: Array, p: int, x: float, y: float, ux: float, uy: float
) -> bool:
    """Whether a piece has a face on the same line, which faces the same way as this one.

    It covers nothing of what it makes one face with.
    """
    first, end, near = pieces.firsts[p], pieces.firsts[p + 1], _FLUSH * pieces.sizes[p]
    for i in range(first, end):
        j = i + 1 if i + 1 < end else first
        ex, ey = world[j, 0] - world[i, 0], world[j, 1] - world[i, 1]
        length = norm(ex, ey)
        beside = abs(uy * (world[i, 0] - x) - ux * (world[i, 1] - y))
        along = (ux * ex + uy * ey) / length
        if beside <= near and abs(ux * ey - uy * ex) <= _FLUSH * length and along > 0.0:
            return True
    return False


@part
def _face(
    pieces: PieceNumbers, centres: Array, world: Array, p: int, place: tuple[float, float],
    outward: tuple[float, float],
) -> int:  # fmt: skip
    """Return how a point is on a piece: 0 a corner or a rim, 1 a face, 2 one that is covered."""
    first, end, near = pieces.firsts[p], pieces.firsts[p + 1], _FLUSH * pieces.sizes[p]
    b = pieces.bodies[p]
    for i in range(first, end):
        j = i + 1 if i + 1 < end else first
        ex, ey = world[j, 0] - world[i, 0], world[j, 1] - world[i, 1]
        length = norm(ex, ey)
        ux, uy = ex / length, ey / length
        away = uy * (place[0] - world[i, 0]) - ux * (place[1] - world[i, 1])
        turned = uy * outward[1] + ux * outward[0]
        facing = uy * outward[0] - ux * outward[1]
        if abs(away) > near or abs(turned) > _FLUSH or facing < 0.0:
            continue
        covered, gained = 0.0, True
        while gained and covered < length - near:
            gained = False
            for other in range(pieces.begins[b], pieces.begins[b + 1]):
                x, y = world[i]
                if other != p and not _goes_on(pieces, world, other, x, y, ux, uy):
                    low, high = _along(pieces, centres, world, other, x, y, ux, uy)
                    if low <= covered + near and high > covered + near:
                        covered, gained = high, True
        return 2 if covered >= length - near else 1
    return 0


@late
def exposed(
    pieces: PieceNumbers, centres: Array, world: Array, p: int, side: float, found: Array,
    features: Ints, count: int,
) -> int:  # fmt: skip
    """Leave out what touches a piece where others of its body are; return how many are left.

    For bodies of several pieces.

    Parameters
    ----------
    pieces : PieceNumbers
    centres : (p, 2), world : (v, 2)
        Their middles and corners in the world.
    p : int
        Which piece.
    side : float
        Whether normals point away from it (1) or into it (-1).
    found : (m, FOUND), features : (m,) array of int, count : int
        Points of contact; those left come first.
    """
    first, end = pieces.begins[pieces.bodies[p]], pieces.begins[pieces.bodies[p] + 1]
    kept = 0
    for i in range(count):
        nx, ny, x, y, gap = found[i]
        ox, oy = side * nx, side * ny
        # The point is on the one or on the other.
        u, v = x - gap * ox, y - gap * oy
        here = abs(_away(pieces, centres, world, p, x, y))
        there, face = abs(_away(pieces, centres, world, p, u, v)), 0
        # Beside the end of a face both are on its piece, but for rounding: that on the face is it.
        if max(here, there) <= _FLUSH * pieces.sizes[p]:
            face = _face(pieces, centres, world, p, (u, v), (ox, oy))
        if face == 0:
            if there >= here:
                u, v = x, y
            face = _face(pieces, centres, world, p, (u, v), (ox, oy))
        free = face < 2
        for other in range(first, end):
            if other == p or not free:
                continue
            near = _FLUSH * pieces.sizes[other]
            away = _away(pieces, centres, world, other, u, v)
            if away > near:
                continue
            alike = away >= -near and _between_normals(
                pieces, centres, world, other, (u, v), (ox, oy)
            )
            # What both have is that of the first, where no other covers that.
            if alike:
                free = other > p or _face(pieces, centres, world, other, (u, v), (ox, oy)) == 2
            elif face == 0:
                # What touches a rim beside another piece is as deep in that as its place is.
                deep = -_away(pieces, centres, world, other, u + gap * ox, v + gap * oy)
                slack = near + (2.0 * max(deep, 0.0) if pieces.radii[p] > 0.0 else -2.0 * near)
                free = away >= -slack
        if free:
            feature = features[i]
            write(found[kept], nx, ny, x, y, gap)
            features[kept] = feature
            kept += 1
    return kept
