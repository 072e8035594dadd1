"""Layout of the product of two regions as a grid: the first down, the second along.

An arrow changes one region: arrows along a row are the chart of the second region, arrows down a
column that of the first. Frames around states are bands through the grid.

Axis 0 goes along, axis 1 down; `u` is a coordinate on an axis and `v` across it, both from the
upper left corner. An arrow between neighbours is straight; one that skips states has a lane.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice, permutations, product
from typing import NamedTuple

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
from statechart.diagram.layout.markup import (
    Style,
    arrow,
    arrow_attributes,
    state_attributes,
    title_attributes,
)
from statechart.diagram.model import Chart, Link, Node
from statechart.palette import FAINT, FRAME

_BAND = {"shape": "box", "style": "rounded,dashed", "label": ""}
_MAX_ORDERS = 5040  # permutations of states that are tried
# Points: between a state and its frame; beside labels; between two lines; an arrowhead with some
# of its line.
_MARGIN, _AIR, _LINE, _HEAD = 9.0, 4.0, 14.0, 12.0
# Gaps of lanes down and along: from line to label, and around both.
_LANES = ((_AIR, 3 * _AIR), (1.0, _AIR))

Span = tuple[int, int]
"""First and last index of a state or frame."""


class _Bond(NamedTuple):
    """An arrow between states or frames on an axis."""

    tail: Span
    head: Span
    links: tuple[Link, ...]

    @property
    def onward(self) -> bool:
        return self.tail[1] < self.head[0]

    @property
    def gap(self) -> Span:
        """The last place before the crossed line, and the first one after it."""
        return (self.tail[1], self.head[0]) if self.onward else (self.head[1], self.tail[0])

    @property
    def skips(self) -> bool:
        return self.gap[1] - self.gap[0] > 1


class _Axis:
    """The states of a chart in the order with the fewest skips of arrows.

    `frames` are nodes of several states, with span and depth of nesting.
    """

    def __init__(self, chart: Chart) -> None:
        arrows = chart.arrows

        def skipped(order: tuple[Node, ...]) -> int:
            spans = _spans(chart, order)
            bonds = (_Bond(spans[s], spans[t], ()) for s, t in arrows)
            return sum(bond.gap[1] - bond.gap[0] - 1 for bond in bonds)

        self.states = min(islice(_orders(chart, None), _MAX_ORDERS), key=skipped)
        spans = _spans(chart, self.states)
        many = {n.name for n in chart.nodes if spans[n.name][0] < spans[n.name][1]}

        def depth(node: Node) -> int:
            return 1 + max((depth(n) for n in chart.within(node.name) if n.name in many), default=0)

        self.frames = [(n, spans[n.name], depth(n)) for n in chart.nodes if n.name in many]
        self.deepest = max((deep for _, _, deep in self.frames), default=0)
        self.bonds = [_Bond(spans[s], spans[t], tuple(links)) for (s, t), links in arrows.items()]
        self.lanes = [k for k, bond in enumerate(self.bonds) if bond.skips]

    def margin(self, place: int, side: int) -> int:
        """Return the depth of frames that end at a side (-1, 1) of a place."""
        ends = ((span[side > 0], deep) for _, span, deep in self.frames)
        return max((deep for end, deep in ends if end == place), default=0)

    def between(self, place: int) -> list[int]:
        """Return the indices of the bonds between a place and the next."""
        return [k for k, bond in enumerate(self.bonds) if bond.gap == (place, place + 1)]


def _orders(chart: Chart, inside: str | None) -> Iterator[tuple[Node, ...]]:
    """Yield orders with contiguous substates, first the declared one."""
    for order in permutations(chart.within(inside)):
        parts = [list(_orders(chart, n.name)) if chart.within(n.name) else [(n,)] for n in order]
        for chosen in product(*parts):
            yield tuple(node for part in chosen for node in part)


def _spans(chart: Chart, order: tuple[Node, ...]) -> dict[str, Span]:
    spans = {node.name: (k, k) for k, node in enumerate(order)}
    for k, node in enumerate(order):
        for outer in chart.around(node.name):
            low, high = spans.get(outer, (k, k))
            spans[outer] = min(low, k), max(high, k)
    return spans


def grid(chart: Chart, style: Style, prefix: str) -> LayoutBlock:
    """Lay out the product of two regions; see `Chart.axes`."""
    drawn = _Grid(chart, style, prefix)
    axes = (0, 1)
    bands = [box for axis in axes for box in drawn.bands(axis)]
    words = [box for axis in axes for box in drawn.arrow_labels(axis)]
    arrows = [one for axis in axes for one in drawn.arrows(axis)]
    block = bounding_block((*bands, *drawn.states(), *words), arrows)
    if chart.initial is None:
        return block
    return with_start(block, style.names[chart.initial.name], f"{prefix}start")


class _Grid:
    """A grid with its measures by axis.

    `cell` is the size of a state, `places` are the centres of states, `sides` the extents of states
    with labels before and after the centre, `reach` the extent with lanes before it, `tracks` the
    offsets of arrows and labels across, and `tops` the extent with frames across, by their depth.
    """

    def __init__(self, chart: Chart, style: Style, prefix: str) -> None:
        if chart.axes is None:
            raise ValueError("a grid is drawn of a product of two regions")
        self.chart, self.names, self.prefix = chart, style.names, prefix
        vertical, horizontal = chart.axes
        self.axes = _Axis(horizontal), _Axis(vertical)
        # The nodes of the product by row and column.
        rows, columns = ([part.leaves.index(n) for n in axis.states] for part, axis in
                         ((vertical, self.axes[1]), (horizontal, self.axes[0])))  # fmt: skip
        nodes = chart.nodes
        self.nodes = [[nodes[row * len(columns) + column] for column in columns] for row in rows]
        self.looks: dict[str, Attributes] = {}
        for k, part in enumerate((horizontal, vertical)):
            for number, bond in enumerate(self.axes[k].bonds):
                attributes = arrow_attributes(bond.links, style, narrow=k == 1)
                self.looks |= {self._key(k, number): attributes} if attributes else {}
            for number, (node, _, _) in enumerate(self.axes[k].frames):
                self.looks[self._key(k, f"in{number}")] = title_attributes(node, part, style)
        self.cells = {self.names[node.name]: state_attributes(node, chart, style) for node in nodes}
        self.sizes = measure_boxes({**self.looks, **self.cells})
        self._measure()

    def _key(self, axis: int, number: int | str) -> str:
        return f"{self.prefix}{'hv'[axis]}{number}"

    def _size(self, axis: int, bond: int) -> Point:
        return self.sizes.get(self._key(axis, bond), (0.0, 0.0))

    def _measure(self) -> None:
        horizontal, vertical = self.axes
        stacks, bundles = dict[int, Point](), dict[int, Point]()
        tallest = 0.0
        for place in range(len(horizontal.states) - 1):
            tracks, height = self._stack(horizontal.between(place))
            stacks |= tracks
            tallest = max(tallest, height)
        for place in range(len(vertical.states) - 1):
            bundles |= self._bundle(vertical.between(place))
        widest = max((abs(at) for at, _ in bundles.values()), default=0.0)
        cell = (max(self.sizes[name][k] for name in self.cells) for k in (0, 1))
        self.cell = width, height = (
            max(next(cell), 2 * widest + 2 * _HEAD),
            max(next(cell), tallest + 2 * _AIR),
        )
        halves = [(words, self._size(1, k)[0] / 2 + _AIR) for k, (_, words) in bundles.items()]
        before = max([width / 2, *(half - words for words, half in halves)])
        behind = max([width / 2, *(half + words for words, half in halves)])
        self.sides = (before, behind), (height / 2, height / 2)
        self.tracks = stacks, bundles
        # Lanes of arrows down are left of a column, lanes along are above a row.
        self.reach = [self.sides[k][0] + _MARGIN * self.axes[k].deepest + _AIR for k in (0, 1)]
        for axis, across in ((1, 0), (0, 1)):
            near, clear = _LANES[across]
            for k in self.axes[axis].lanes:
                size, at = self._size(axis, k)[across], self.reach[across]
                self.tracks[axis][k] = -at, -(at + near + size / 2)
                self.reach[across] += size + clear
        line = max((-bundles[k][0] for k in vertical.lanes), default=width / 2)
        self.places = self._places(0, line), self._places(1, self.reach[1])
        self.tops = [self._tops(0), self._tops(1)]
        edge = (
            _MARGIN * horizontal.deepest + _AIR,
            _MARGIN * max(horizontal.deepest, vertical.deepest, 1),
        )
        self.size = [self.places[k][-1] + self.sides[k][1] + edge[k] for k in (0, 1)]

    def _tops(self, k: int) -> list[float]:
        """Return the extents, each frame above the titles of those inside."""
        tops = [self.reach[1 - k]]
        for deep in range(self.axes[k].deepest):
            inner = (n for n, (_, _, depth) in enumerate(self.axes[k].frames) if depth == deep)
            titles = [self.sizes[self._key(k, f"in{number}")][1 - k] for number in inner]
            tops.append(tops[-1] + max(_MARGIN, *titles, 0.0))
        return tops

    def _places(self, k: int, lane: float) -> list[float]:
        """Return the centres of states, with space for labels or frames between them."""
        axis, half, (before, behind) = self.axes[k], self.cell[k] / 2, self.sides[k]
        places = [self.reach[k]]
        for place in range(len(axis.states) - 1):
            near, far = (_MARGIN * axis.margin(place + i, side) for i, side in ((0, 1), (1, -1)))
            crossing = (n for n, bond in enumerate(axis.bonds) if bond.gap[0] == place)
            words = max((self._size(k, n)[k] for n in crossing), default=0.0)
            start = behind + near if near else half
            end = before + far if far else half
            step = start + words + 2 * _HEAD + max(end, lane)
            places.append(places[-1] + max(step, behind + self.reach[k] + 2 * _AIR))
        return places

    def _bundle(self, bonds: list[int]) -> dict[int, Point]:
        """Return tracks of adjacent arrows down; the label of the first is on the left."""
        tracks: dict[int, Point] = {}
        at = -_LINE / 2 if len(bonds) > 1 else 0.0
        for k in bonds:
            wide = self._size(1, k)[0]
            first = not tracks and len(bonds) > 1
            tracks[k] = at, at + (-1 if first else 1) * (_AIR + wide / 2)
            at += _LINE if first else 2 * _AIR + wide + _AIR
        return tracks

    def _stack(self, bonds: list[int]) -> tuple[dict[int, Point], float]:
        """Return tracks of arrows along, each below its label, and the total height."""
        heights = [self._size(0, k)[1] for k in bonds]
        total = sum(heights) + _AIR * len(bonds)
        tracks, v = {}, -total / 2
        for k, high in zip(bonds, heights, strict=True):
            tracks[k] = v + high + 1.0, v + high / 2
            v += high + _AIR
        return tracks, total

    def _side(self, axis: int, place: int, side: int, deep: int) -> float:
        half = self.sides[axis][side > 0] + _MARGIN * deep if deep else self.cell[axis] / 2
        return self.places[axis][place] + side * half

    def states(self) -> Iterator[Box]:
        for row, y in zip(self.nodes, self.places[1], strict=True):
            for node, x in zip(row, self.places[0], strict=True):
                name = self.names[node.name]
                yield Box(name, (x, -y), self.cell, self.cells[name])

    def bands(self, k: int) -> Iterator[Box]:
        """Yield the frames through the grid, and their titles."""
        across = 1 - k
        for number, (node, span, deep) in enumerate(self.axes[k].frames):
            low, high = self._side(k, span[0], -1, deep), self._side(k, span[1], 1, deep)
            top = self.places[across][0] - self.tops[k][deep]
            end = self.size[across] + _MARGIN * deep
            colour = FRAME if node.infeasible is None else FAINT
            size = _along_axis(k, high - low, end - top)
            centre = _point(k, (low + high) / 2, (top + end) / 2)
            yield Box(self._key(k, f"_{number}"), centre, size, {**_BAND, "color": colour})
            name = self._key(k, f"in{number}")
            size = self.sizes[name]
            centre = _point(k, low + size[k] / 2, top - size[across] / 2 - 1.0)
            yield Box(name, centre, size, self.looks[name])

    def arrow_labels(self, k: int) -> Iterator[Box]:
        """Yield the labels of arrows, centred in the free space."""
        axis, across = self.axes[k], 1 - k
        for number, bond in enumerate(axis.bonds):
            name, place = self._key(k, number), bond.gap[0]
            if name not in self.looks:
                continue
            low = self._side(k, place, 1, axis.margin(place, 1))
            high = self._side(k, place + 1, -1, axis.margin(place + 1, -1))
            high = min(high, self.places[k][place + 1] - self._lane(across))
            for other, v in enumerate(self.places[across]):
                centre = _point(k, (low + high) / 2, v + self.tracks[k][number][1])
                yield Box(f"{name}_{other}", centre, self.sizes[name], self.looks[name])

    def _lane(self, axis: int) -> float:
        """Return how far lanes are before a state: along, their labels are in the way, too."""
        tracks = ((self.tracks[axis][k], self._size(axis, k)[1]) for k in self.axes[axis].lanes)
        reach = [-line if axis else size / 2 - words for (line, words), size in tracks]
        return max(reach, default=0.0)

    def arrows(self, k: int) -> Iterator[Arrow]:
        for number, bond in enumerate(self.axes[k].bonds):
            for other, v in enumerate(self.places[1 - k]):
                (tail, no_tail), (head, no_head) = (
                    self._end(k, span, other) for span in (bond.tail, bond.head)
                )
                attributes = arrow(bond.links) | ({"color": FAINT} if no_tail or no_head else {})
                points = [_point(k, *at) for at in self._corners(k, number, v)]
                yield Arrow(tail, head, polyline(points), attributes)

    def _end(self, k: int, span: Span, across: int) -> tuple[str, bool]:
        """Return the box at the end of an arrow, and whether it is infeasible."""
        line = self.nodes[across] if k == 0 else [row[across] for row in self.nodes]
        nodes = line[span[0] : span[1] + 1]
        impossible = all(node.infeasible is not None for node in nodes)
        if span[0] == span[1]:
            return self.names[nodes[0].name], impossible
        number = next(n for n, (_, other, _) in enumerate(self.axes[k].frames) if other == span)
        return self._key(k, f"_{number}"), impossible

    def _corners(self, k: int, number: int, v: float) -> list[Point]:
        """Return the corners (u, v) of an arrow, with turns from and to a lane."""
        bond = self.axes[k].bonds[number]
        way = 1 if bond.onward else -1
        start, end = self._border(k, bond.tail, way), self._border(k, bond.head, -way)
        lane = v + self.tracks[k][number][0]
        points = [(start, lane), (end, lane)]
        inset, side = way * (self.cell[0] / 5, _AIR + 2.0)[k], v - self.cell[1 - k] / 2
        if bond.skips and bond.tail[0] == bond.tail[1]:
            points[0:1] = [(start - inset, side), (start - inset, lane)]
        if bond.skips and bond.head[0] == bond.head[1]:
            points[-1:] = [(end + inset, lane), (end + inset, side)]
        return points

    def _border(self, k: int, span: Span, side: int) -> float:
        deep = next((d for _, other, d in self.axes[k].frames if other == span), 0)
        return self._side(k, span[side > 0], side, deep)


def _along_axis(axis: int, horizontal: float, across: float) -> Point:
    return (horizontal, across) if axis == 0 else (across, horizontal)


def _point(axis: int, u: float, v: float) -> Point:
    x, y = _along_axis(axis, u, v)
    return x, -y
