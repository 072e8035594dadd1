"""The states of a region in a line, so that few of its arrows pass over others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

from statechart.diagram.layout.markup import nested
from statechart.diagram.legend import drawn_once
from statechart.diagram.model import Chart, Link, Node

# Of more states beside each other only so many orders are tried.
_MOST_ORDERS = 5040


@dataclass(frozen=True)
class Bond:
    """An arrow between states, or states that hold others, on a line.

    Attributes
    ----------
    tail, head : (int, int)
        The first and the last place of what it leaves and what it enters.
    links : tuple of Link
        What it stands for.
    """

    tail: tuple[int, int]
    head: tuple[int, int]
    links: tuple[Link, ...]

    @property
    def onward(self) -> bool:
        """Whether it leads to a later place."""
        return self.tail[1] < self.head[0]

    @property
    def gap(self) -> tuple[int, int]:
        """The last place before what it crosses, and the first behind."""
        return (self.tail[1], self.head[0]) if self.onward else (self.head[1], self.tail[0])

    @property
    def skips(self) -> bool:
        """Whether it passes over a state."""
        return self.gap[1] - self.gap[0] > 1


@dataclass(frozen=True)
class Axis:
    """States in order, what holds several of them, and the arrows between.

    Attributes
    ----------
    states : tuple of Node
        Those that hold no others, in order.
    frames : tuple of (Node, (int, int), int)
        What holds several: with its first and last place, and how deep frames are within it.
    bonds : tuple of Bond
        Arrows.
    """

    states: tuple[Node, ...]
    frames: tuple[tuple[Node, tuple[int, int], int], ...]
    bonds: tuple[Bond, ...]

    def margin(self, place: int, side: int) -> int:
        """Return how deep frames are that end at a side (-1, 1) of a place."""
        ends = ((span[0] if side < 0 else span[1], deep) for _, span, deep in self.frames)
        return max((deep for end, deep in ends if end == place), default=0)

    @property
    def deepest(self) -> int:
        """How deep frames are."""
        return max((deep for _, _, deep in self.frames), default=0)

    def between(self, place: int) -> list[int]:
        """Return the bonds from one place to the next, or back, by their numbers."""
        return [k for k, bond in enumerate(self.bonds) if bond.gap == (place, place + 1)]

    @property
    def skipping(self) -> list[int]:
        """The bonds that pass over states, by their numbers."""
        return [k for k, bond in enumerate(self.bonds) if bond.skips]


def axis(chart: Chart) -> Axis:
    """Return the states of a chart in the order in which its arrows pass over the fewest."""
    arrows = {e: links for e, links in drawn_once(chart).items() if not nested(chart, links[0])}

    def passed(order: tuple[Node, ...]) -> int:
        spans = _spans(chart, order)
        bonds = [Bond(spans[s], spans[t], ()) for s, t in arrows]
        return sum(bond.gap[1] - bond.gap[0] - 1 for bond in bonds)

    orders = (order for _, order in zip(range(_MOST_ORDERS), _orders(chart, None), strict=False))
    states = min(orders, key=passed)
    spans = _spans(chart, states)
    many = {n.name for n in chart.nodes if spans[n.name][0] < spans[n.name][1]}
    frames = [
        (node, spans[node.name], 1 + _deepest(chart, node, many))
        for node in chart.nodes
        if node.name in many
    ]
    bonds = tuple(Bond(spans[s], spans[t], tuple(links)) for (s, t), links in arrows.items())
    return Axis(states, tuple(frames), bonds)


def _orders(chart: Chart, inside: str | None) -> Iterator[tuple[Node, ...]]:
    """Yield orders in which states of one state stay together, first the one declared."""
    for order in permutations(chart.within(inside)):
        parts = [list(_orders(chart, n.name)) if chart.within(n.name) else [(n,)] for n in order]
        for chosen in product(*parts):
            yield tuple(node for part in chosen for node in part)


def _spans(chart: Chart, order: tuple[Node, ...]) -> dict[str, tuple[int, int]]:
    spans = {node.name: (k, k) for k, node in enumerate(order)}
    for k, node in enumerate(order):
        for outer in chart.around(node.name):
            low, high = spans.get(outer, (k, k))
            spans[outer] = min(low, k), max(high, k)
    return spans


def _deepest(chart: Chart, node: Node, many: set[str]) -> int:
    inner = [n for n in chart.within(node.name) if n.name in many]
    return max((1 + _deepest(chart, n, many) for n in inner), default=0)
