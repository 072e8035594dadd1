"""How far apart the rows and columns of a grid stand, so that all words have room."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from statechart.diagram.layout.axis import Axis
from statechart.diagram.layout.block import Point

# Points: between a state and the frame around it; beside words; between two lines; an arrow's
# head with some of its line.
MARGIN, AIR, LINE, HEAD = 9.0, 4.0, 14.0, 12.0


@dataclass(frozen=True)
class Track:
    """A line of a grid that arrows of one kind run on, and the room of its words.

    Attributes
    ----------
    at : float
        Distance from the middle of the state: to the right of an arrow down, down of one along;
        of one that passes over states how far it keeps off, to the left or upwards.
    words : float
        Distance to the middle of its words, likewise.
    """

    at: float
    words: float


@dataclass(frozen=True)
class Rooms:
    """The measures of a grid, y downwards from its upper left corner.

    Attributes
    ----------
    cell : (float, float)
        Width and height of a state.
    columns, rows : tuple of float
        Where the middles of states are.
    down, along : mapping
        Number of a bond of the axis -> its track.
    size : (float, float)
        Of all.
    sides : (float, float)
        How far words reach to the left and to the right of the middle of a column.
    reach : (float, float)
        How far what belongs to a state reaches to the left and upwards.
    words : mapping
        Name -> width and height of words.
    """

    cell: Point
    columns: tuple[float, ...]
    rows: tuple[float, ...]
    down: Mapping[int, Track]
    along: Mapping[int, Track]
    size: Point
    sides: Point
    reach: Point
    words: Mapping[str, Point]


def rooms(down: Axis, along: Axis, cell: Point, words: Mapping[str, Point]) -> Rooms:
    """Return the measures of a grid."""
    bundles = {
        k: track
        for place in range(len(down.states) - 1)
        for k, track in _bundle(down.between(place), words).items()
    }
    stacks: dict[int, Track] = {}
    tallest = 0.0
    for place in range(len(along.states) - 1):
        tracks, height = _stack(along.between(place), words)
        stacks |= tracks
        tallest = max(tallest, height)
    widest = max((abs(track.at) for track in bundles.values()), default=0.0)
    width, height = max(cell[0], 2 * widest + 2 * HEAD), max(cell[1], tallest + 2 * AIR)
    sides = [(track.words, words.get(f"v{k}", (0.0, 0.0))[0] / 2) for k, track in bundles.items()]
    left = max([width / 2, *(half - at + AIR for at, half in sides)])
    right = max([width / 2, *(half + at + AIR for at, half in sides)])
    # Lanes of arrows that pass over states: to the left of a column, above a row.
    lanes_down, reach_left = {}, left + MARGIN * along.deepest + AIR
    for k in down.skipping:
        wide = words.get(f"v{k}", (0.0, 0.0))[0]
        lanes_down[k] = Track(reach_left, reach_left + AIR + wide / 2)
        reach_left += 2 * AIR + wide + AIR
    lanes_along, reach_up = {}, height / 2 + MARGIN * down.deepest + AIR
    for k in along.skipping:
        high = words.get(f"h{k}", (0.0, 0.0))[1]
        lanes_along[k] = Track(reach_up, reach_up + 1.0 + high / 2)
        reach_up += high + AIR
    line_left = max((track.at for track in lanes_down.values()), default=width / 2)
    columns, rows = [reach_left], [reach_up]
    for place in range(len(along.states) - 1):
        near, far = (MARGIN * along.margin(place + k, side) for k, side in ((0, 1), (1, -1)))
        room = max(
            (words.get(f"h{k}", (0.0, 0.0))[0] for k in _crossing(along, place)), default=0.0
        )
        # Words stand between the states, or between the frames around them.
        start, end = (
            bare if not frame else bare_words + frame
            for frame, bare, bare_words in ((near, width / 2, right), (far, width / 2, left))
        )
        reach = start + room + 2 * HEAD + max(end, line_left)
        columns.append(columns[-1] + max(reach, right + reach_left + 2 * AIR))
    for place in range(len(down.states) - 1):
        near, far = (MARGIN * down.margin(place + k, side) for k, side in ((0, 1), (1, -1)))
        room = max((words.get(f"v{k}", (0.0, 0.0))[1] for k in _crossing(down, place)), default=0.0)
        rows.append(
            rows[-1] + height / 2 + near + room + 2 * HEAD + max(height / 2 + far, reach_up)
        )
    edge = MARGIN * max(along.deepest, down.deepest, 1)
    size = columns[-1] + right + MARGIN * along.deepest + AIR, rows[-1] + height / 2 + edge
    return Rooms(
        (width, height),
        tuple(columns),
        tuple(rows),
        {**bundles, **lanes_down},
        {**stacks, **lanes_along},
        size,
        (left, right),
        (reach_left, reach_up),
        words,
    )


def _crossing(line: Axis, place: int) -> list[int]:
    """Return the bonds whose words stand in a gap: if they cross several, in the first."""
    return [k for k, bond in enumerate(line.bonds) if bond.gap[0] == place]


def _bundle(bonds: list[int], words: Mapping[str, Point]) -> dict[int, Track]:
    """Return arrows down beside each other: the first has its words on the left."""
    tracks: dict[int, Track] = {}
    at = -LINE / 2 if len(bonds) > 1 else 0.0
    for k in bonds:
        wide = words.get(f"v{k}", (0.0, 0.0))[0]
        first = not tracks and len(bonds) > 1
        tracks[k] = Track(at, at + (-1 if first else 1) * (AIR + wide / 2))
        at += LINE if first else 2 * AIR + wide + AIR
    return tracks


def _stack(bonds: list[int], words: Mapping[str, Point]) -> tuple[dict[int, Track], float]:
    """Return arrows along, one below the other, each below its words; and their height."""
    tracks: dict[int, Track] = {}
    y = 0.0
    for k in bonds:
        high = words.get(f"h{k}", (0.0, 0.0))[1]
        tracks[k] = Track(y + high + 1.0, y + high / 2)
        y += high + AIR
    return {k: replace(t, at=t.at - y / 2, words=t.words - y / 2) for k, t in tracks.items()}, y
