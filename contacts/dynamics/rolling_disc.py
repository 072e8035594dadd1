"""Discs that touch straight surfaces and circles with their rims: wheels, round feet, balls.

A point on a rim has the velocity of the disc's centre and that of its turning, and is another one
as the disc rolls. In the plane rolling is holonomic: what a disc has rolled is how far it has
turned against its surface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import sympy as sp

Vector = tuple[sp.Expr, sp.Expr]


@dataclass(frozen=True, eq=False)
class Rim:
    """A disc about a point of a body."""

    radius: sp.Expr  # Of the disc; 0: the point itself touches
    turn: sp.Expr  # Angle of its body against the surface
    # ((Expr, Expr), Expr), optional: Centre of the circle that it touches, and how far its own
    # centre is from there
    circle: tuple[Vector, sp.Expr] | None = None
    side: int = 1  # 1 where it is outside the circle, -1 where it is inside a hollow one

    def anchored(self, centre: Vector, tangent: Vector) -> tuple[Vector, Vector]:
        """Return what is constant as the disc rolls, a place, and the direction it slips in.

        Both in the frame of the surface. On a line that is where the centre of the disc would be
        had it not turned; on a circle, as it would be seen by who turns about the circle's centre
        as the centre of a rolling disc does. Of a point it is the point.
        """
        if self.radius == 0:
            return centre, tangent
        if self.circle is None:
            rolled = self.radius * self.turn
            return _sum(centre, tangent, rolled), tangent
        (x, y), _ = self.circle
        back = _turned(-self._round)
        return back((centre[0] - x, centre[1] - y)), back(tangent)

    def centre(self, anchor: Vector, tangent: Vector) -> Vector:
        """Return the centre of a disc that rolls, by its anchor; see `anchored`."""
        if self.radius == 0:
            return anchor
        if self.circle is None:
            return _sum(anchor, tangent, -self.radius * self.turn)
        (x, y), _ = self.circle
        dx, dy = _turned(self._round)(anchor)
        return x + dx, y + dy

    @property
    def _round(self) -> sp.Expr:
        """By which angle the disc's centre goes round the circle as it rolls."""
        assert self.circle is not None
        return self.side * self.radius * self.turn / self.circle[1]


def _sum(place: Vector, direction: Vector, by: sp.Expr) -> Vector:
    return place[0] + by * direction[0], place[1] + by * direction[1]


def _turned(angle: sp.Expr) -> Callable[[Vector], Vector]:
    c, s = sp.cos(angle), sp.sin(angle)
    return lambda v: (c * v[0] - s * v[1], s * v[0] + c * v[1])
