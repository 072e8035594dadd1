"""Whether corners are those of a convex polygon; what is said where they are not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, pairwise

from statechart.errors import DeclarationProblem

_Corner = tuple[float, float]
_Corners = Sequence[_Corner]

# A polygon turns at a corner by more than this angle; what is nearer than this part of its size is
# in one place: what rounding leaves of coordinates that are formulas is a thousandth of it.
_STRAIGHT = 1e-12
_WHAT = "a polygon is convex, its corners counter-clockwise"


def check_polygon(corners: _Corners) -> None:
    """Check that corners are those of a convex polygon, counter-clockwise.

    Raises
    ------
    DeclarationProblem
        With the number of the corner as its place, where one is wrong.
    """
    _check_places(corners)
    _check_crossings(corners)
    turns, area = _turns(corners)
    if area < 0.0:
        raise DeclarationProblem(f"{_WHAT}; these are clockwise", advice="reverse their order")
    if all(turn > _STRAIGHT for turn in turns):
        return
    wrong = ([turn > _STRAIGHT for turn in turns].index(False) + 1) % len(corners)
    how, advice = "lies on a straight edge", "leave it out"
    if turns[wrong - 1] < -_STRAIGHT:
        how, advice = "points inwards", _split(corners, wrong)
    raise DeclarationProblem(
        f"{_WHAT}; corner {wrong + 1}, at {_place(corners[wrong])}, {how}",
        advice=advice,
        loc=(wrong,),
    )


def _check_places(corners: _Corners) -> None:
    """Check that corners are apart, and not all on one line."""
    size = max(math.dist(one, other) for one, other in combinations(corners, 2))
    apart: list[_Corner] = []
    twice: tuple[int, int] | None = None
    for k, corner in enumerate(corners):
        same = [
            i for i, one in enumerate(corners[:k]) if math.dist(one, corner) <= _STRAIGHT * size
        ]
        if not same:
            apart.append(corner)
        elif twice is None:
            twice = same[0], k
    if len(apart) < 2:
        raise DeclarationProblem(
            f"all corners are at {_place(corners[0])}: a polygon has an area",
            advice="place them around it, or write disc: RADIUS",
        )
    # Those farthest from each other have the line between them that all others might lie on.
    a, b = max(combinations(apart, 2), key=lambda pair: math.dist(*pair))
    away = [_cross(a, b, corner) / math.dist(a, b) for corner in apart]
    if max(map(abs, away)) <= _STRAIGHT * size:
        raise DeclarationProblem(
            f"all corners lie on the line from {_place(a)} to {_place(b)}: a polygon has an area",
            advice="give it a width; a thin bar is polygon: [[-a, -b], [a, -b], [a, b], [-a, b]]",
        )
    if twice is not None:
        one, other = twice
        raise DeclarationProblem(
            f"corners {one + 1} and {other + 1} are in one place, {_place(corners[one])}",
            advice="leave one of them out",
            loc=(other,),
        )


def _check_crossings(corners: _Corners) -> None:
    """Check that no edges cross."""
    edges = list(zip(corners, [*corners[1:], corners[0]], strict=True))
    for i, j in combinations(range(len(edges)), 2):
        (a, b), (c, d) = edges[i], edges[j]
        if _cross(a, b, c) * _cross(a, b, d) < 0.0 and _cross(c, d, a) * _cross(c, d, b) < 0.0:
            raise DeclarationProblem(
                f"{_WHAT}; the edge from corner {i + 1} to {i + 2} crosses that from corner "
                f"{j + 1} to {(j + 1) % len(corners) + 1}",
                advice=_ordered(corners),
                loc=(j,),
            )


def _ordered(corners: _Corners) -> str:
    """Return in which order corners make a convex polygon; that there is one, if not which."""
    x, y = (sum(values) / len(corners) for values in zip(*corners, strict=True))
    around = sorted(
        range(len(corners)), key=lambda k: math.atan2(corners[k][1] - y, corners[k][0] - x)
    )
    first = around.index(0)
    around = [*around[first:], *around[:first]]
    if min(_turns([corners[k] for k in around])[0]) > _STRAIGHT:
        return f"list them in the order {', '.join(str(k + 1) for k in around)}"
    return "list corners in their order around it"


def _turns(corners: _Corners) -> tuple[list[float], float]:
    """Return the sines of a polygon's turns to the left after its edges, and its area."""
    following = [*corners[1:], corners[0]]
    edges = [(b[0] - a[0], b[1] - a[1]) for a, b in zip(corners, following, strict=True)]
    turns = [
        (x * v - y * u) / (math.hypot(x, y) * math.hypot(u, v))
        for (x, y), (u, v) in zip(edges, [*edges[1:], edges[0]], strict=True)
    ]
    area = 0.5 * sum(_cross(corners[0], a, b) for a, b in pairwise(corners))
    return turns, area


def _cross(origin: _Corner, one: _Corner, other: _Corner) -> float:
    """Return twice the area of a triangle, above 0 where it is counter-clockwise."""
    (x, y), (a, b), (c, d) = origin, one, other
    return (a - x) * (d - y) - (b - y) * (c - x)


def _split(corners: _Corners, inward: int) -> str:
    """Return how to split a polygon at a corner that points inwards."""
    count = len(corners)
    order = [(inward + step) % count for step in range(count)]
    for step in range(2, count - 1):
        halves = order[: step + 1], [*order[step:], inward]
        if all(min(_turns([corners[k] for k in half])[0]) > _STRAIGHT for half in halves):
            first, second = (", ".join(str(k + 1) for k in half) for half in halves)
            return (
                f"split it from there to corner {order[step] + 1}: shape: [{{polygon: corners "
                f"{first}}}, {{polygon: corners {second}}}]"
            )
    return "split it there into convex ones: shape: [{polygon: [...]}, {polygon: [...]}]"


def _place(corner: _Corner) -> str:
    x, y = (value + 0.0 for value in corner)  # no negative zero
    return f"({x:.6g}, {y:.6g})"
