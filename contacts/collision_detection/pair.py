"""A piece of a body, and what it may touch."""

from __future__ import annotations

from typing import NamedTuple

from contacts.collision_detection.body_numbers import BodyNumbers
from contacts.collision_detection.joints import held
from contacts.collision_detection.look import Look
from contacts.collision_detection.meeting import nearby, turning
from statechart.kernels.jit import part

CROSSED = 0.5
"""Bodies that cross less than this part of their size in a step are looked at once."""


class Pair(NamedTuple):
    """A piece of a body, and what it may touch."""

    # The piece; another, or a surface, which stand behind all pieces.
    p: int
    q: int
    # Of the piece; which other body it touches, also one that carries a surface, or -1.
    body: int
    other: int
    key: int  # See `Memory`.
    material: int  # Which law they touch by; -1: they do not.
    # Whether both are pieces; both discs; one a surface that moves, and no body.
    whole: bool
    discs: bool
    moves: bool
    # Whether the step is short beside how fast pieces move: all that looks closer at what is fast
    # is within its error; whether they turn much in it.
    slowly: bool
    turns: bool
    size: float  # Of the smaller one.


@part
def paired(numbers: BodyNumbers, look: Look, p: int, q: int, since: float) -> Pair:
    """Return a piece and what it may touch."""
    pieces, surfaces = numbers.pieces, numbers.surfaces
    count, b = len(pieces.sizes), pieces.bodies[p]
    s, key = q - count, p * (count + len(surfaces.kinds)) + q
    if s < 0:
        other = pieces.bodies[q]
        touch = other != b and not held(numbers.joints, b, other)
        material = numbers.laws[numbers.kinds[b], numbers.kinds[other]] if touch else -1
        size, discs = min(pieces.sizes[p], pieces.sizes[q]), pieces.radii[p] * pieces.radii[q] > 0.0
        turns = since * turning(numbers, look, p, q) > CROSSED * min(
            pieces.cores[p], pieces.cores[q]
        )
        slowly = not turns and nearby(look.drifts, pieces.sizes, p, q, CROSSED / since)
        return Pair(p, q, b, other, key, material, True, discs, False, slowly, turns, size)
    other = surfaces.carriers[s]
    material = numbers.laws[numbers.kinds[b], len(numbers.laws) + s] if other != b else -1
    moves, size = other < 0 and surfaces.moves[s], pieces.sizes[p]
    return Pair(p, q, b, other, key, material, False, False, moves, True, False, size)
