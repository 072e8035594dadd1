"""The product of two regions as a grid: the first goes down the columns, the second along the rows.

An arrow changes one region, so that arrows along a row are the second region's chart, and those
down a column the first's: every row has the same, and so has every column. Frames around states
are bands through the whole grid. Words stand in rooms of their own, which no line crosses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from statechart.diagram.layout.axis import Axis, Bond, axis
from statechart.diagram.layout.block import Arrow, Block, Box, Look, Point, bounded, polyline
from statechart.diagram.layout.markup import Style, arrow, arrow_look, frame_look, state_look
from statechart.diagram.layout.measure import measured
from statechart.diagram.layout.rooms import AIR, MARGIN, Rooms, rooms
from statechart.diagram.layout.start import begun
from statechart.diagram.model import Chart, Node
from statechart.palette import FAINT, FRAME

_BAND = {"shape": "box", "style": "rounded,dashed", "label": ""}


def grid(chart: Chart, style: Style, prefix: str) -> Block:
    """Lay out the product of two regions; see `Chart.axes`."""
    if chart.axes is None:
        raise ValueError("a grid is drawn of a product of two regions")
    down, along = map(axis, chart.axes)
    looks: dict[str, Look] = {}
    for way, line, part in (("v", down, chart.axes[0]), ("h", along, chart.axes[1])):
        for k, bond in enumerate(line.bonds):
            look = arrow_look(bond.links, style, narrow=way == "v")
            looks |= {f"{way}{k}": look} if look else {}
        for k, (node, _, _) in enumerate(line.frames):
            looks[f"{way}in{k}"] = frame_look(node, part, style)
    cells = {style.names[node.name]: state_look(node, chart, style) for node in chart.nodes}
    sizes = measured({**{f"_{name}": look for name, look in looks.items()}, **cells})
    words = {name: sizes[f"_{name}"] for name in looks}
    cell = max(sizes[name][0] for name in cells), max(sizes[name][1] for name in cells)
    draft = _Draft(
        chart, chart.axes, style, prefix, down, along, rooms(down, along, cell, words), looks
    )
    boxes = (*draft.bands(), *draft.states(cells), *draft.words())
    block = bounded(boxes, tuple(draft.arrows()))
    if chart.initial is None:
        return block
    return begun(block, style.names[chart.initial.name], f"{prefix}start")


@dataclass(frozen=True)
class _Draft:
    """A grid whose measures are known; y upwards from its upper left corner, so below 0."""

    chart: Chart
    axes: tuple[Chart, Chart]
    style: Style
    prefix: str
    down: Axis
    along: Axis
    rooms: Rooms
    looks: dict[str, Look]

    def state(self, row: int, column: int) -> Node:
        """Return the state at a place."""
        first, second = self.axes
        at = (
            first.leaves.index(self.down.states[row]),
            second.leaves.index(self.along.states[column]),
        )
        return self.chart.nodes[at[0] * len(second.leaves) + at[1]]

    def centre(self, row: int, column: int) -> Point:
        """Return the middle of a state."""
        return self.rooms.columns[column], -self.rooms.rows[row]

    def states(self, cells: dict[str, dict[str, str]]) -> Iterator[Box]:
        """Yield the states, and the dot that the first arrow comes from."""
        for row in range(len(self.down.states)):
            for column in range(len(self.along.states)):
                node, centre = self.state(row, column), self.centre(row, column)
                name = self.style.names[node.name]
                yield Box(name, centre, self.rooms.cell, cells[name])

    def bands(self) -> Iterator[Box]:
        """Yield the frames through the grid, and their names outside them."""
        width, height = self.rooms.size
        for k, (node, span, deep) in enumerate(self.along.frames):
            left = self._side(self.along, span[0], -1, deep)
            right = self._side(self.along, span[1], 1, deep)
            top = -self.rooms.rows[0] + self.rooms.reach[1] + MARGIN * deep
            name, size = f"hin{k}", self.rooms.words[f"hin{k}"]
            low = -height - MARGIN * deep
            yield _between(f"{self.prefix}h_{k}", (left, low), (right, top), node)
            place = left + size[0] / 2, top + size[1] / 2 + 1.0
            yield Box(self.prefix + name, place, size, self.looks[name])
        for k, (node, span, deep) in enumerate(self.down.frames):
            top = self._side(self.down, span[0], -1, deep)
            low = self._side(self.down, span[1], 1, deep)
            left = self.rooms.columns[0] - self.rooms.reach[0] - MARGIN * deep
            name, size = f"vin{k}", self.rooms.words[f"vin{k}"]
            corner = width + MARGIN * deep, top
            yield _between(f"{self.prefix}v_{k}", (left, low), corner, node)
            place = left - size[0] / 2 - 1.0, top - size[1] / 2
            yield Box(self.prefix + name, place, size, self.looks[name])

    def _side(self, line: Axis, place: int, side: int, deep: int) -> float:
        """Return where a state, or a frame around it, ends on one side: an x, or a y."""
        if line is self.down:
            return -self.rooms.rows[place] - side * (self.rooms.cell[1] / 2 + MARGIN * deep)
        half = self.rooms.cell[0] / 2
        if deep:
            half = self.rooms.sides[0 if side < 0 else 1] + MARGIN * deep
        return self.rooms.columns[place] + side * half

    def words(self) -> Iterator[Box]:
        """Yield the words on all arrows."""
        for k, bond in enumerate(self.along.bonds):
            for row in range(len(self.down.states)):
                yield from self._word(f"h{k}", f"_{row}", self._along_words(k, bond, row))
        for k, bond in enumerate(self.down.bonds):
            for column in range(len(self.along.states)):
                yield from self._word(f"v{k}", f"_{column}", self._down_words(k, bond, column))

    def _word(self, name: str, mark: str, place: Point) -> Iterator[Box]:
        if name in self.looks:
            yield Box(self.prefix + name + mark, place, self.rooms.words[name], self.looks[name])

    def _along_words(self, k: int, bond: Bond, row: int) -> Point:
        track, y = self.rooms.along[k], -self.rooms.rows[row]
        near, far = bond.gap[0], bond.gap[0] + 1
        left = self._side(self.along, near, 1, self.along.margin(near, 1))
        right = self._side(self.along, far, -1, self.along.margin(far, -1))
        lanes = (self.rooms.down[j].at for j in self.down.skipping)
        right = min([right, *(self.rooms.columns[far] - at for at in lanes)])
        return (left + right) / 2, y + track.words if bond.skips else y - track.words

    def _down_words(self, k: int, bond: Bond, column: int) -> Point:
        track, x = self.rooms.down[k], self.rooms.columns[column]
        near, far = bond.gap[0], bond.gap[0] + 1
        top = self._side(self.down, near, 1, self.down.margin(near, 1))
        low = self._side(self.down, far, -1, self.down.margin(far, -1))
        low = max(
            [low, *(self.rooms.along[j].at - self.rooms.rows[far] for j in self.along.skipping)]
        )
        return x - track.words if bond.skips else x + track.words, (top + low) / 2

    def arrows(self) -> Iterator[Arrow]:
        """Yield all arrows."""
        for k, bond in enumerate(self.along.bonds):
            for row in range(len(self.down.states)):
                ends = [self._end(self.along, span, row) for span in (bond.tail, bond.head)]
                yield self._arrow(ends, self._along_course(k, bond, row), bond)
        for k, bond in enumerate(self.down.bonds):
            for column in range(len(self.along.states)):
                ends = [self._end(self.down, span, column) for span in (bond.tail, bond.head)]
                yield self._arrow(ends, self._down_course(k, bond, column), bond)

    def _arrow(self, ends: list[tuple[str, bool]], course: str, bond: Bond) -> Arrow:
        look = arrow(bond.links)
        if any(refused for _, refused in ends):
            look["color"] = FAINT
        return Arrow(ends[0][0], ends[1][0], course, look)

    def _end(self, line: Axis, span: tuple[int, int], across: int) -> tuple[str, bool]:
        """Return the box at an arrow's end, and whether no motion can be there."""
        places = [
            self.state(k, across) if line is self.down else self.state(across, k)
            for k in range(span[0], span[1] + 1)
        ]
        refused = all(node.infeasible is not None for node in places)
        if span[0] == span[1]:
            return self.style.names[places[0].name], refused
        k = next(k for k, (_, other, _) in enumerate(line.frames) if other == span)
        return f"{self.prefix}{'v' if line is self.down else 'h'}_{k}", refused

    def _border(self, line: Axis, span: tuple[int, int], side: int) -> float:
        """Return where an arrow meets what spans some places, on one side: an x, or a y."""
        deep = next((d for _, other, d in line.frames if other == span), 0)
        return self._side(line, span[0] if side < 0 else span[1], side, deep)

    def _along_course(self, k: int, bond: Bond, row: int) -> str:
        track, y = self.rooms.along[k], -self.rooms.rows[row]
        way = 1 if bond.onward else -1
        start = self._border(self.along, bond.tail, way)
        end = self._border(self.along, bond.head, -way)
        if not bond.skips:
            return polyline([(start, y - track.at), (end, y - track.at)])
        lane, top = y + track.at, y + self.rooms.cell[1] / 2
        inset = self.rooms.cell[0] / 5
        points = [(start, lane), (end, lane)]
        if bond.tail[0] == bond.tail[1]:
            points[0:1] = [(start - way * inset, top), (start - way * inset, lane)]
        if bond.head[0] == bond.head[1]:
            points[-1:] = [(end + way * inset, lane), (end + way * inset, top)]
        return polyline(points)

    def _down_course(self, k: int, bond: Bond, column: int) -> str:
        track, x = self.rooms.down[k], self.rooms.columns[column]
        way = 1 if bond.onward else -1
        start = self._border(self.down, bond.tail, way)
        end = self._border(self.down, bond.head, -way)
        if not bond.skips:
            return polyline([(x + track.at, start), (x + track.at, end)])
        lane, left = x - track.at, x - self.rooms.cell[0] / 2
        inset = AIR + 2.0
        points = [(lane, start), (lane, end)]
        if bond.tail[0] == bond.tail[1]:
            points[0:1] = [(left, start + way * inset), (lane, start + way * inset)]
        if bond.head[0] == bond.head[1]:
            points[-1:] = [(lane, end - way * inset), (left, end - way * inset)]
        return polyline(points)


def _between(name: str, low: Point, high: Point, node: Node) -> Box:
    """Return the frame of a node between two corners."""
    colour = FRAME if node.infeasible is None else FAINT
    centre = (low[0] + high[0]) / 2, (low[1] + high[1]) / 2
    return Box(name, centre, (high[0] - low[0], high[1] - low[1]), {**_BAND, "color": colour})
