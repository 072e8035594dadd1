"""The path of a run through few modes: a chain, or rounds of a cycle as a gait makes them.

A mode that is passed twice stands in two places. One round is drawn as a ring, with the number of
rounds in the middle; what came before leads to it. Rows are no wider than a slide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil

from statechart.diagram.layout.block import Arrow, Block, Box, Look, Point, bounded, polyline
from statechart.diagram.layout.markup import STATE, Style, arrow, arrow_look, state_look, table
from statechart.diagram.layout.markup import text as words
from statechart.diagram.layout.measure import measured
from statechart.diagram.layout.start import begun
from statechart.diagram.legend import drawn_once
from statechart.diagram.model import Chart
from statechart.palette import RUN
from statechart.tabular import several

# Points: what a row may take, and in a picture that were higher than that; a line on each side of
# its words; between words and a line's end.
_WIDTH, _WIDEST, _ROOM, _AIR = 740.0, 980.0, 16.0, 3.0
# Between fewer modes there is nothing to see.
_LEAST = 3
# What comes again in the same order is a round from so many on.
_ROUNDS = 1.5

MOST_STEPS = 16
"""Of more modes on the way a path is no longer seen at a glance."""


@dataclass(frozen=True)
class Round:
    """The course of a path.

    Attributes
    ----------
    order : tuple of str
        Names of modes, each round once.
    back : int or None
        To which of them the last leads back; None where nothing repeats.
    count : int
        How often the path went from there to the last.
    """

    order: tuple[str, ...]
    back: int | None
    count: int


def course(path: Sequence[str]) -> Round | None:
    """Return the course of a path: rounds from as early on as there are some, or a chain.

    None where modes come again, and not in rounds for at least half of the path.
    """
    length = len(path)
    if len(set(path)) == length:
        return Round(tuple(path), None, 1)
    found: list[Round] = []
    for period in range(1, length):
        first = length - period
        while first > 0 and path[first - 1] == path[first - 1 + period]:
            first -= 1
        if length - first >= max(_ROUNDS * period, length / 2):
            found.append(Round(tuple(path[: first + period]), first, (length - first) // period))
    return min(found, key=lambda one: len(one.order), default=None)


def ring(chart: Chart, style: Style, prefix: str) -> Block | None:
    """Lay out the path of a run; None where it has more steps than can be seen, or next to none."""
    found = course(chart.path) or Round(chart.path, None, 1)
    lone = found.back is not None and len(found.order) - found.back < _LEAST
    if lone or not _LEAST <= len(found.order) <= MOST_STEPS:
        return None
    if set(found.order) != {node.name for node in chart.nodes}:
        return None
    nodes = {node.name: replace(node, visits=None) for node in chart.nodes}
    names = [
        f"{prefix}again_{k}_{style.names[name]}" if name in found.order[:k] else style.names[name]
        for k, name in enumerate(found.order)
    ]
    looks: dict[str, Look] = {
        name: state_look(nodes[mode], replace(chart, links=()), style)
        for name, mode in zip(names, found.order, strict=True)
    }
    steps = [*pairwise(range(len(names)))]
    if found.back is not None:
        steps.append((len(names) - 1, found.back))
    links = drawn_once(chart)
    taken = [tuple(links[found.order[a], found.order[b]]) for a, b in steps]
    said = [arrow_look(of, style, narrow=True, counted=False) for of in taken]
    labels = {f"{prefix}{k}": look for k, look in enumerate(said) if look is not None}
    sizes = measured({**looks, **labels})
    cell = max(sizes[n][0] for n in looks), max(sizes[n][1] for n in looks)
    pitch = tuple(
        cell[k] + max((sizes[n][k] for n in labels), default=0.0) + 2 * _ROOM for k in (0, 1)
    )
    most = 1 + int((_WIDTH - cell[0]) // pitch[0])
    if ceil(len(names) / max(most, 2)) * pitch[1] > _WIDTH:
        most = 1 + int((_WIDEST - cell[0]) // pitch[0])
    spots = [(x * pitch[0], -y * pitch[1]) for x, y in _spots(found, most)]
    boxes = [Box(n, spot, cell, looks[n]) for n, spot in zip(names, spots, strict=True)]
    arrows = []
    for k, (a, b) in enumerate(steps):
        name = f"{prefix}{k}"
        size = sizes.get(name, (0.0, 0.0))
        middle = _middle(spots[a], spots[b])
        if name in labels:
            boxes.append(Box(name, middle, size, labels[name]))
        line = _line(spots[a], spots[b], cell, middle, size if name in labels else None)
        arrows.append(Arrow(names[a], names[b], line, arrow(taken[k])))
    if found.back is not None:
        boxes.append(_count(f"{prefix}rounds", found, spots[found.back :]))
    return begun(bounded(tuple(boxes), tuple(arrows)), names[0], f"{prefix}start")


def _spots(found: Round, most: int) -> list[Point]:
    """Return columns and rows, counted from the upper left corner of the ring, or of the chain."""
    most = max(most, 2)
    if found.back is None:
        return [_snake(k, most) for k in range(len(found.order))]
    before = [_snake(k, most) for k in range(found.back)]
    lead = [(float(x), -1.0 - y) for x, y in reversed(before)]
    size = len(found.order) - found.back
    top = min(ceil(size / 2), most)
    side = max(size - 2 * top + 1, 0) // 2
    low = size - top - 2 * side
    around = [(float(k), 0.0) for k in range(top)]
    around += [(top - 1.0, 1.0 + k) for k in range(side)]
    start = (top - low) / 2 if not side else 0.0
    around += [(start + low - 1.0 - k, 1.0 + side) for k in range(low)]
    around += [(0.0, float(side - k)) for k in range(side)]
    return [*lead, *around[:size]]


def _snake(place: int, most: int) -> Point:
    """Return the column and row of a place in rows that turn at their ends."""
    row, column = divmod(place, most)
    return float(column if row % 2 == 0 else most - 1 - column), float(row)


def _middle(one: Point, other: Point) -> Point:
    return (one[0] + other[0]) / 2, (one[1] + other[1]) / 2


def _line(one: Point, other: Point, cell: Point, middle: Point, gap: Point | None) -> str:
    """Return a straight line between two states, broken where its words stand."""
    start, end = _edge(one, other, cell, 0.0), _edge(other, one, cell, 0.0)
    if gap is None:
        return polyline([start, end])
    to, on = _edge(middle, one, gap, _AIR), _edge(middle, other, gap, _AIR)
    return f"{polyline([start, to], head=False)};{polyline([on, end])}"


def _edge(centre: Point, toward: Point, size: Point, off: float) -> Point:
    """Return where the line from the middle of a rectangle to a point leaves it."""
    way = toward[0] - centre[0], toward[1] - centre[1]
    reach = min((size[k] / 2 + off) / abs(way[k]) for k in (0, 1) if way[k])
    return centre[0] + reach * way[0], centre[1] + reach * way[1]


def _count(name: str, found: Round, spots: Sequence[Point]) -> Box:
    """Return how often a ring was gone through, in the middle of it."""
    said = several(found.count, "round")
    look = {
        "shape": "plain",
        "label": table([words(said, size=STATE, bold=True, colour=RUN)]),
    }
    low = [min(spot[k] for spot in spots) for k in (0, 1)]
    high = [max(spot[k] for spot in spots) for k in (0, 1)]
    return Box(
        name, _middle((low[0], low[1]), (high[0], high[1])), measured({name: look})[name], look
    )
