"""The pieces near each piece, and the obstacles at a point of contact among them."""

from __future__ import annotations

from typing import NamedTuple

from contacts.collision_detection.body_numbers import BodyNumbers, PieceNumbers
from contacts.collision_detection.convex import norm
from contacts.collision_detection.ground import Ground
from contacts.collision_detection.look import Look
from contacts.collision_detection.obstacles import (
    FLUSH,
    collide,
    distance_to,
    obstacle,
    rest_together,
)
from contacts.collision_detection.surfaces import PLATE, ROUND, distance
from statechart.arrays import Array, Ints
from statechart.kernels.jit import part

COVERING = 64
"""Obstacles at a contact that are looked at."""

# Obstacles this near to a point of contact, relative to what is touched, are looked at: points of
# contact nearer than half of that are one.
_AROUND = 2e-3


class Neighbours(NamedTuple):
    """The pieces near each piece."""

    # (p + 1,): of every piece those near it that stand before it: where they begin, and which they
    # are.
    heads: Ints
    lower: Ints
    # (p,): those near one piece, and how many they are.
    others: Ints
    many: Ints
    covering: Ints  # (c,): is overwritten; see `near_obstacles`.


@part
def sort_pairs(pairs: Ints, many: int, count: int, near: Neighbours) -> None:
    """Sort pairs by their second piece, by counting."""
    heads = near.heads
    for p in range(count + 1):
        heads[p] = 0
    for i in range(many):
        heads[pairs[i, 1]] += 1
    for p in range(count):
        heads[p + 1] += heads[p]
    for i in range(many - 1, -1, -1):
        q = pairs[i, 1]
        heads[q] -= 1
        near.lower[heads[q]] = pairs[i, 0]


@part
def list_neighbours(pairs: Ints, begin: int, end: int, p: int, near: Neighbours) -> None:
    """List the pieces near one, whose pairs with those behind it are from `begin` to `end`."""
    many = 0
    for i in range(near.heads[p], near.heads[p + 1]):
        near.others[many] = near.lower[i]
        many += 1
    for i in range(begin, end):
        near.others[many] = pairs[i, 1]
        many += 1
    near.many[0] = many


@part
def near_obstacles(
    numbers: BodyNumbers, ground: Ground, look: Look, pair: tuple[int, int],
    near_pieces: Neighbours, h: float, found: Array, count: int,
) -> int:  # fmt: skip
    """List the obstacles at points of contact of one of a pair; return how many there are.

    Parameters
    ----------
    numbers, ground, look
    pair : (int, int)
        What is touched, and what touches it.
    near_pieces : Neighbours
        Its `covering` is filled with the first, and with pieces and surfaces that do not move
        against it and touch the second.
    h : float
    found : (m, FOUND), count : int
        Points of contact.
    """
    pieces, surfaces, (one, touched_by) = numbers.pieces, numbers.surfaces, pair
    all_pieces, many = len(pieces.sizes), 1
    others, covering, count_others = near_pieces.others, near_pieces.covering, near_pieces.many[0]
    covering[0] = one
    plate = one >= all_pieces
    body = -1 if plate else pieces.bodies[one]
    size = _half_length(numbers, one - all_pieces) if plate else pieces.sizes[one]
    if not plate:
        first, end = pieces.begins[body], pieces.begins[body + 1]
        beside = False
        for q in range(first, end):
            beside = beside or (q != one and _near_circle(look, pieces, q, found, count, size) >= 0)
        # A face may be covered by several.
        for q in range(first, end if beside else first):
            if q != one and many < len(covering):
                covering[many] = q
                many += 1
    solid = touched_by >= all_pieces and surfaces.kinds[touched_by - all_pieces] not in (
        PLATE,
        ROUND,
    )
    if solid or (not plate and pieces.radii[one] > 0.0):
        # A half-plane has one normal, and so has a rim: others beside it take none away.
        return many
    for k in range(count_others + len(surfaces.kinds)):
        is_piece = k < count_others
        q = others[k] if is_piece else all_pieces + k - count_others
        if q in (one, touched_by) or (is_piece and pieces.bodies[q] == body):
            continue
        if is_piece:
            at = _near_circle(look, pieces, q, found, count, size)
        else:
            at = _near_obstacle(numbers, ground, look, q, found, count, size)
        near = FLUSH * (min(size, pieces.sizes[q]) if is_piece else size)
        if (
            at < 0
            or many == len(covering)
            or not rest_together(
                numbers, ground, look, (one, q), found[at, 2], found[at, 3], h, near
            )
        ):
            continue
        if is_piece and _near_obstacle(numbers, ground, look, q, found, count, size) < 0:
            continue
        if collide(numbers, touched_by, q):
            covering[many] = q
            many += 1
    return many


@part
def _near_circle(
    look: Look, pieces: PieceNumbers, q: int, found: Array, count: int, size: float
) -> int:
    """Return the first point of contact that is near the circle around a piece; -1: none."""
    for i in range(count):
        x, y = found[i, 2] - look.centres[q, 0], found[i, 3] - look.centres[q, 1]
        reach = pieces.sizes[q] + _AROUND * size + 2.0 * abs(found[i, 4])
        if x * x + y * y <= reach * reach:
            return i
    return -1


@part
def _near_obstacle(
    numbers: BodyNumbers, ground: Ground, look: Look, q: int, found: Array, count: int, size: float
) -> int:
    """Return the first point of contact that is near a piece or surface; -1: none."""
    s = q - len(numbers.pieces.sizes)
    still = s >= 0 and not (numbers.surfaces.moves[s] or numbers.surfaces.carriers[s] >= 0)
    for i in range(count):
        x, y = found[i, 2], found[i, 3]
        if still:
            away = distance(numbers.surfaces, s, ground.still[1], x, y)
        else:
            away = distance_to(obstacle(numbers, ground, look, q, x, y), x, y)
        if away <= _AROUND * size + 2.0 * abs(found[i, 4]):
            return i
    return -1


@part
def _half_length(numbers: BodyNumbers, s: int) -> float:
    a, b, c, d = numbers.surfaces.numbers[s]
    return 0.5 * norm(c - a, d - b)
