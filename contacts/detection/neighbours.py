"""The pieces near each piece, and the obstacles at a point of contact among them."""

from __future__ import annotations

import math
from typing import NamedTuple

from contacts.detection.body_numbers import BodyNumbers
from contacts.detection.convex import norm
from contacts.detection.ground import Ground
from contacts.detection.look import Look
from contacts.detection.obstacles import FLUSH, collide, rest_together
from contacts.detection.surfaces import distance
from statechart.arrays import Array, Ints
from statechart.kernels.jit import part

COVERING = 64
"""Obstacles at a contact that are looked at."""

# Obstacles this near to a point of contact, relative to what is touched, are looked at: points of
# contact nearer than half of that are one.
_AROUND = 2e-3


class Neighbours(NamedTuple):
    """The pieces near each piece.

    Attributes
    ----------
    heads, lower : (p + 1,), (k,) array of int
        Of every piece those near it that stand before it: where they begin, and which they are.
    others, many : (p,), (1,) array of int
        Those near one piece, and how many they are.
    covering : (c,) array of int
        Is overwritten; see `near_obstacles`.
    """

    heads: Ints
    lower: Ints
    others: Ints
    many: Ints
    covering: Ints


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
    numbers: BodyNumbers, ground: Ground, look: Look, pair: tuple[int, int], others: Ints,
    h: float, found: Array, count: int, covering: Ints,
) -> int:  # fmt: skip
    """List the obstacles at points of contact of one of a pair; return how many there are.

    Parameters
    ----------
    numbers, ground, look
    pair : (int, int)
        What is touched, and what touches it.
    others : (k,) array of int
        Pieces that are near.
    h : float
    found : (m, FOUND), count : int
        Points of contact.
    covering : (c,) array of int
        Is filled with the first, and with pieces and surfaces that do not move against it and touch
        the second.
    """
    pieces, surfaces, (one, touched_by) = numbers.pieces, numbers.surfaces, pair
    all_pieces, many = len(pieces.sizes), 1
    covering[0] = one
    size = pieces.sizes[one] if one < all_pieces else _half_length(numbers, one - all_pieces)
    body = pieces.bodies[one] if one < all_pieces else -1
    if body >= 0:
        for q in range(pieces.begins[body], pieces.begins[body + 1]):
            if q != one and many < len(covering):
                covering[many] = q
                many += 1
    for k in range(len(others) + len(surfaces.kinds)):
        q = others[k] if k < len(others) else all_pieces + k - len(others)
        if q in (one, touched_by) or (q < all_pieces and pieces.bodies[q] == body):
            continue
        near = FLUSH * (min(size, pieces.sizes[q]) if q < all_pieces else size)
        at = -1
        for i in range(count):
            x, y = found[i, 2], found[i, 3]
            if q < all_pieces:
                away = norm(x - look.centres[q, 0], y - look.centres[q, 1]) - pieces.sizes[q]
            else:
                s = q - all_pieces
                moves = surfaces.moves[s] or surfaces.carriers[s] >= 0
                away = -math.inf if moves else distance(surfaces, s, ground.still[1], x, y)
            if away <= _AROUND * size + 2.0 * abs(found[i, 4]):
                at = i
        if at < 0 or many == len(covering) or not collide(numbers, touched_by, q):
            continue
        if rest_together(numbers, ground, look, (one, q), found[at, 2], found[at, 3], h, near):
            covering[many] = q
            many += 1
    return many


@part
def _half_length(numbers: BodyNumbers, s: int) -> float:
    a, b, c, d = numbers.surfaces.numbers[s]
    return 0.5 * norm(c - a, d - b)
