"""The dot from which the first arrow comes, at a corner of the state that it leads to."""

from __future__ import annotations

from statechart.diagram.layout.block import (
    Arrow,
    Block,
    Box,
    Point,
    bounded,
    covered,
    crossings,
    polyline,
)
from statechart.diagram.layout.markup import START, arrow

# Where it can be, to the right and upwards of the state.
_CORNERS = ((-1, 1), (1, 1), (-1, -1), (1, -1))
# Its width, how far it stands off, and how far the corner of a state is rounded, in points.
_DOT, _OFF, _ROUND = 9.4, 13.0, 2.5


def begun(block: Block, state: str, name: str) -> Block:
    """Return a block with the dot and its arrow, where they are least in the way."""
    (box,) = (box for box in block.boxes if box.name == state)
    found = (_at(block, box, name, corner) for corner in _CORNERS)
    return min(found, key=lambda one: (covered(one), crossings(one)))


def _at(block: Block, box: Box, name: str, corner: Point) -> Block:
    tip = tuple(box.centre[k] + corner[k] * (box.size[k] / 2 - _ROUND) for k in (0, 1))
    dot = tip[0] + corner[0] * _OFF, tip[1] + corner[1] * _OFF
    line = polyline([dot, (tip[0], tip[1])])
    return bounded(
        (*block.boxes, Box(name, dot, (_DOT, _DOT), START)),
        (*block.arrows, Arrow(name, box.name, line, arrow(()))),
    )
