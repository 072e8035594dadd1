"""Layout of the path of a run: a chain of modes, followed by a cycle as of a gait.

A mode visited twice in the chain has two nodes. The cycle is drawn once as a ring, with the number
of rounds in the middle. Rows are no wider than a slide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import ceil
from typing import NamedTuple

from statechart.diagram.layout import markup
from statechart.diagram.layout.block import (
    Arrow,
    Attributes,
    Box,
    LayoutBlock,
    Point,
    bounding_block,
    polyline,
    with_start,
)
from statechart.diagram.layout.graphviz_program import measure_boxes
from statechart.diagram.model import Chart
from statechart.palette import RUN
from statechart.tabular import pluralise

# Points: width of a row, and of a picture that would be higher; line beside a label; its gap.
_WIDTH, _WIDEST, _PADDING, _AIR = 740.0, 980.0, 16.0, 3.0
_MIN_RING = 3  # modes of a ring
_ROUNDS = 1.5  # least repetitions of a cycle

MAX_STEPS = 16
"""Limit of the modes of a path."""


class Round(NamedTuple):
    """A path with contracted cycle.

    `order` are the modes, with the cycle once; `back` is the index of the first mode of the cycle
    (None without one), and `rounds` the number of repetitions.
    """

    order: tuple[str, ...]
    back: int | None
    rounds: int


def find_rounds(path: Sequence[str]) -> Round | None:
    """Return a path as a chain, or with a cycle from the earliest possible start.

    None if modes repeat without a cycle of at least half of the path.
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


def ring(chart: Chart, style: markup.Style, prefix: str) -> LayoutBlock | None:
    """Return the layout of the path of a run; None if it is too long or too short."""
    found = find_rounds(chart.path) or Round(chart.path, None, 1)
    order, back = found.order, found.back
    short = back is not None and len(order) - back < _MIN_RING
    fits = _MIN_RING <= len(order) <= MAX_STEPS and not short
    if not fits or {*order} != {n.name for n in chart.nodes}:
        return None
    bare = replace(chart, links=())
    names = [
        f"{prefix}again_{k}_{style.names[name]}" if name in order[:k] else style.names[name]
        for k, name in enumerate(order)
    ]
    looks: dict[str, Attributes] = {
        name: markup.state_attributes(replace(chart.node(mode), visits=None), bare, style)
        for name, mode in zip(names, order, strict=True)
    }
    steps = [*pairwise(range(len(names)))]
    if back is not None:
        steps.append((len(names) - 1, back))
    taken = [chart.bundles[order[a], order[b]] for a, b in steps]
    words = [markup.arrow_attributes(links, style, narrow=True, counted=False) for links in taken]
    labels: dict[str, Attributes] = {f"{prefix}{k}": look for k, look in enumerate(words) if look}
    count = markup.text(pluralise(found.rounds, "round"), size=markup.STATE, bold=True, colour=RUN)
    middle = {f"{prefix}rounds": {"shape": "plain", "label": markup.table([count])}}
    sizes = measure_boxes({**looks, **labels, **middle})
    cell = max(sizes[n][0] for n in looks), max(sizes[n][1] for n in looks)
    wide, high = (
        cell[k] + max((sizes[n][k] for n in labels), default=0.0) + 2 * _PADDING for k in (0, 1)
    )
    if back is not None and len(order) - back == 3:
        # In a triangle the count is between the labels of the slanted arrows.
        side_width = max((sizes[n][0] for n in labels), default=0.0) + sizes[f"{prefix}rounds"][0]
        wide = max(wide, 2 * (side_width + 2 * _PADDING))
    most = 1 + int((_WIDTH - cell[0]) // wide)
    if ceil(len(names) / max(most, 2)) * high > _WIDTH:
        most = 1 + int((_WIDEST - cell[0]) // wide)
    spots = [(x * wide, -y * high) for x, y in _spots(found, max(most, 2))]
    boxes = [Box(n, spot, cell, looks[n]) for n, spot in zip(names, spots, strict=True)]
    arrows = []
    for k, (a, b) in enumerate(steps):
        name = f"{prefix}{k}"
        between = _middle((spots[a], spots[b]))
        if name in labels:
            boxes.append(Box(name, between, sizes[name], labels[name]))
        line = _line(spots[a], spots[b], cell, between, sizes.get(name))
        arrows.append(Arrow(names[a], names[b], line, markup.arrow(taken[k])))
    if back is not None:
        centre = _middle(spots[back:])
        boxes += [Box(n, centre, sizes[n], look) for n, look in middle.items()]
    return with_start(bounding_block(boxes, arrows), names[0], f"{prefix}start")


def _spots(found: Round, most: int) -> list[Point]:
    """Return columns and rows from the upper left corner of the ring or chain."""
    if found.back is None:
        return [_snake(k, most) for k in range(len(found.order))]
    lead = [(x, -1.0 - y) for x, y in (_snake(k, most) for k in reversed(range(found.back)))]
    size = len(found.order) - found.back
    top = min(ceil(size / 2), most)
    side = max(size - 2 * top + 1, 0) // 2
    low = size - top - 2 * side
    start = (top - low) / 2 if not side else 0.0
    return [
        *lead,
        *((float(k), 0.0) for k in range(top)),
        *((top - 1.0, 1.0 + k) for k in range(side)),
        *((start + low - 1.0 - k, 1.0 + side) for k in range(low)),
        *((0.0, float(side - k)) for k in range(side)),
    ][: len(found.order)]


def _snake(place: int, most: int) -> Point:
    """Return column and row of a place in boustrophedon order."""
    row, column = divmod(place, most)
    return float(column if row % 2 == 0 else most - 1 - column), float(row)


def _middle(spots: Sequence[Point]) -> Point:
    xs, ys = zip(*spots, strict=True)
    return (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2


def _line(one: Point, other: Point, cell: Point, middle: Point, gap: Point | None) -> str:
    """Return a straight line between two states, with a gap for its label."""
    start, end = _edge(one, other, cell), _edge(other, one, cell)
    if gap is None:
        return polyline([start, end])
    gap = gap[0] + 2 * _AIR, gap[1] + 2 * _AIR
    to, on = _edge(middle, one, gap), _edge(middle, other, gap)
    return f"{polyline([start, to], head=False)};{polyline([on, end])}"


def _edge(centre: Point, toward: Point, size: Point) -> Point:
    """Return the intersection of a rectangle with the line from its centre to a point."""
    way = toward[0] - centre[0], toward[1] - centre[1]
    reach = min(size[k] / 2 / abs(way[k]) for k in (0, 1) if way[k])
    return centre[0] + reach * way[0], centre[1] + reach * way[1]
