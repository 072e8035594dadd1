"""Film of a run as plain values: shapes in frames, poses of the frames over time, forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array

ShapeKind = Literal[
    "outline", "disc", "bar", "mass", "joint", "pivot", "link", "rope", "spring", "damper",
    "reaction", "coupling", "ground",
]  # fmt: skip
"""Kinds of shapes. All but the ground lie within the hull of their points.

outline: a filled polygon. disc: a filled circle. bar: a thick line with round ends. mass, joint,
pivot: marks of a fixed size on the paper, at one point. link, rope, spring, damper, reaction: from
a point of one frame to a point of another; a slack rope is dashed. coupling:
from a point to a point, with a mark between, which the state of its region colours. ground: a line,
the solid on its right, which is hatched.
"""

BETWEEN: frozenset[ShapeKind] = frozenset(
    ("link", "rope", "spring", "damper", "reaction", "coupling")
)
"""Those that join two frames."""

WORLD = 0
"""The number of the frame that does not move."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape in a frame that moves; its points (m, 2) are in that frame.

    The last point of a link between two frames is in the frame `other`; `radius` is that of a disc.
    The state of `region` (a number in the film, -1 for none) colours it, and `name` is its owner's.
    A spring or damper is drawn `aside` of its line, in half widths of a spring, to the left;
    `slack` (k,) is where a rope is dashed. A disc that `turns` has a radius.
    """

    kind: ShapeKind
    points: Array
    frame: int
    other: int
    radius: float = 0.0
    region: int = -1
    name: str = ""
    aside: float = 0.0
    slack: NDArray[np.bool_] | None = None
    turns: bool = False


@dataclass(frozen=True, eq=False)
class Touch:
    """A contact, of a region of the film, along its k instants.

    `places`, `normals` (unit, of the surface) and `forces` (on the body) are (k, 2); `friction`
    (k,) is Coulomb's coefficient, 0 to inf.
    """

    name: str
    region: int
    places: Array
    normals: Array
    forces: Array
    friction: Array


@dataclass(frozen=True, eq=False)
class Film:
    """Pictures of a run at k instants, the shapes from back to front."""

    title: str
    times: Array  # (k,), in order
    jumps: NDArray[np.int64]  # (k,), how many precede each instant
    regions: tuple[str, ...]
    states: tuple[tuple[str, ...], ...]  # of every region
    modes: NDArray[np.intp]  # (k, r), the state of every region as its place among these
    shapes: tuple[Shape, ...]
    poses: Array  # (k, f, 3), place and angle of every frame
    touches: tuple[Touch, ...]
    centres: Array  # (k, 2), the middle of the picture
    half: tuple[float, float]  # of its width and height
    force: float  # its arrow is as long as a quarter of the smaller of width and height
    trails: tuple[int, ...] = ()  # frames that leave one
    unit_of_time: str = ""  # beside the times that are shown

    @property
    def unit(self) -> float:
        """Unit length of marks of fixed size: the larger side of the picture."""
        return 2.0 * max(self.half)

    @property
    def arrow(self) -> float:
        """Length of the arrow of a unit force."""
        return _arrow(self.half, self.force)

    @property
    def spacing(self) -> float:
        """Distance between the strokes of a hatching."""
        return HATCH * self.unit

    def clock(self, instant: int) -> str:
        """Return the time of an instant in words."""
        return f"t = {self.times[instant]:.4g} {self.unit_of_time}".rstrip()

    def state(self, instant: int, region: int) -> str:
        """Return the state of a region at an instant, by their numbers."""
        return self.states[region][self.modes[instant, region]]


def _arrow(half: tuple[float, float], force: float) -> float:
    return 0.5 * min(half) / force


def arrows(forces: Array, half: tuple[float, float], force: float) -> Array:
    """Return the arrows (..., 2) of forces (..., 2), cut where they are much longer than usual."""
    sizes = np.hypot(forces[..., 0], forces[..., 1])
    longest = LONGEST * force
    cut = np.where(sizes > longest, longest / np.where(sizes > 0.0, sizes, 1.0), 1.0)
    found: Array = _arrow(half, force) * forces * cut[..., None]
    return found


def cones(touch: Touch, half: tuple[float, float], points: int = 3) -> Array:
    """Return points (k, points, 2) on the rims of the friction cones of a contact."""
    turn = np.arctan(touch.friction)[:, None] * np.linspace(-1.0, 1.0, points)
    (x, y), (c, s) = touch.normals.T[:, :, None], (np.cos(turn), np.sin(turn))
    rim = np.stack([c * x - s * y, s * x + c * y], axis=-1)
    reach = _arrow(half, 1.0) * (touch.friction > 0.0)
    found: Array = touch.places[:, None] + reach[:, None, None] * rim
    return found


LONGEST = 1.7
"""At so many times the length of a usual one, which is a quarter of the picture, arrows are cut."""

HATCH = 1.0 / 48.0
"""Between the strokes of a hatching, in parts of `Film.unit`."""


def place_points(points: Array, pose: Array) -> Array:
    """Return points (..., m, 2) of a frame in the world, for its poses (..., 3)."""
    x, y, angle = (pose[..., k, None] for k in range(3))
    c, s = np.cos(angle), np.sin(angle)
    tangential, normal = points.T
    return np.stack([x + c * tangential - s * normal, y + s * tangential + c * normal], axis=-1)


def ends_of(shape: Shape, poses: Array) -> tuple[Array, Array]:
    """Return the first and last point (..., 2) of a shape, for poses (..., f, 3) of all frames."""
    first = place_points(shape.points[:1], poses[..., shape.frame, :])
    return first[..., 0, :], place_points(shape.points[-1:], poses[..., shape.other, :])[..., 0, :]


def hatching(points: Array, spacing: float) -> Array:
    """Return the strokes (m, 2, 2) of the hatching on the right of a line of points.

    Strokes have the same distance at sharp turns of the line.
    """
    ends = np.diff(points, axis=0)
    tangential = np.concatenate([[0.0], np.cumsum(np.hypot(*ends.T))])
    if not tangential[-1] > 0.0:
        return np.empty((0, 2, 2))
    at = np.arange(spacing / 2, tangential[-1], spacing)
    piece = np.clip(np.searchsorted(tangential, at, side="right") - 1, 0, len(ends) - 1)
    direction = ends[piece] / np.hypot(*ends[piece].T)[:, None]
    start = points[piece] + (at - tangential[piece])[:, None] * direction
    right = np.column_stack([direction[:, 1], -direction[:, 0]])
    return np.stack([start, start + spacing * (right - direction) * np.sqrt(0.5)], axis=1)
