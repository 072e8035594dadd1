"""Positions of bodies, points and surfaces as expressions of the coordinates.

Discs (wheels, round feet, balls) touch straight surfaces and circles with their rims. The contact
point of a disc has the velocity of the centre plus that of the rotation, and moves along the rim
as the disc rolls. Rolling in the plane is holonomic: the rolled length is the radius times the
angle of the disc relative to its surface.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import sympy as sp

from contacts.scene.joints import Path
from contacts.scene.modes import Row
from contacts.scene.parts import Contact, Pair, Point, Surface
from contacts.scene.scene import Scene
from statechart.documents.declaration import TIME
from statechart.formulas.formula import parse

Vector = tuple[sp.Expr, sp.Expr]
Frame = tuple[Vector, sp.Expr]
"""Origin and angle."""


@dataclass(frozen=True, eq=False)
class Rim:
    """A disc about a point of a body."""

    radius: sp.Expr  # Radius of the disc; 0: the point itself touches
    turn: sp.Expr  # Angle of its body against the surface
    # Centre of the circle that it touches, and the distance of its own centre from there
    circle: tuple[Vector, sp.Expr] | None = None
    side: int = 1  # 1 where it is outside the circle, -1 where it is inside a hollow one

    def anchored(self, centre: Vector, tangent: Vector) -> tuple[Vector, Vector]:
        """Return a position that is constant in rolling, and the direction that it slips in.

        Both are in the frame of the surface. On a line the position is the centre of the disc less
        the rolled length; on a circle it is the centre turned back by the rolled angle. A point
        without a radius is its own anchor.
        """
        if self.radius == 0:
            return centre, tangent
        if self.circle is None:
            rolled = self.radius * self.turn
            return _sum(centre, tangent, rolled), tangent
        (x, y), _ = self.circle
        back = rotation(-self._orbit_angle)
        return back((centre[0] - x, centre[1] - y)), back(tangent)

    def centre(self, anchor: Vector, tangent: Vector) -> Vector:
        """Return the centre of a disc that rolls, by its anchor; see `anchored`."""
        if self.radius == 0:
            return anchor
        if self.circle is None:
            return _sum(anchor, tangent, -self.radius * self.turn)
        return in_world((self.circle[0], self._orbit_angle), anchor)

    @property
    def _orbit_angle(self) -> sp.Expr:
        """Angle by which a rolling disc's centre has moved about the centre of the circle."""
        assert self.circle is not None
        return self.side * self.radius * self.turn / self.circle[1]


def _sum(place: Vector, direction: Vector, by: sp.Expr) -> Vector:
    return place[0] + by * direction[0], place[1] + by * direction[1]


def rotation(angle: sp.Expr) -> Callable[[Vector], Vector]:
    """Return the rotation of vectors by an angle."""
    c, s = sp.cos(angle), sp.sin(angle)
    return lambda v: (c * v[0] - s * v[1], s * v[0] + c * v[1])


def linear_combination(*terms: tuple[sp.Expr, Row]) -> Row:
    """Return the sum of factors times rows."""
    row: Row = {}
    for factor, entries in terms:
        for i, entry in entries.items():
            row[i] = row.get(i, sp.S.Zero) + factor * entry
    return {i: entry for i, entry in row.items() if entry != 0}


def in_world(frame: Frame, place: Vector) -> Vector:
    """Return the position in the world of a place in a frame."""
    (x, y), angle = frame
    dx, dy = rotation(angle)(place)
    return x + dx, y + dy


class Geometry:
    """Positions of a scene's bodies, points and surfaces as expressions of its coordinates `q`.

    `v` and `a` are rates and accelerations, `variables` q and v together. `known` maps the names
    that formulas may use to expressions; `constants` are those of parameters and controls.
    `carried` are further variables, those of controllers that move surfaces, and their rates.
    """

    def __init__(
        self,
        scene: Scene,
        constants: Mapping[str, sp.Symbol],
        carried: Mapping[sp.Symbol, sp.Symbol],
    ) -> None:
        self.scene = scene
        self.names = scene.variables
        count = range(len(self.names))
        self.time = sp.Symbol("t", real=True)
        self.q = tuple(sp.Symbol(f"q{i}", real=True) for i in count)
        self.v = tuple(sp.Symbol(f"v{i}", real=True) for i in count)
        self.a = tuple(sp.Symbol(f"a{i}", real=True) for i in count)
        rates = tuple(map(scene.rate_name, self.names))
        self.variable_names, self.variables = (*self.names, *rates), (*self.q, *self.v)
        rates_of = dict(zip(self.variables, (*self.v, *self.a), strict=True))
        varying = {self.time: sp.S.One, **rates_of, **carried}.items()
        # Symbol -> its index among the variables (-1: time), itself, and its rate.
        self._varying = {x: (i, x, dx) for i, (x, dx) in enumerate(varying, start=-1)}
        self._at_rest = dict.fromkeys(self.a, sp.S.Zero)
        self.known: dict[str, sp.Expr] = {
            TIME: self.time,
            **constants,
            **dict(zip(self.variable_names, self.variables, strict=True)),
        }

    def rate(self, expression: sp.Expr) -> sp.Expr:
        """Return the total derivative with respect to time, accelerations included."""
        return sp.Add(*(sp.diff(expression, x) * dx for _, x, dx in self._variables_in(expression)))

    def drift(self, rate: sp.Expr) -> sp.Expr:
        """Return the derivative of a rate at zero accelerations."""
        return self.rate(rate).xreplace(self._at_rest)

    def gradient(self, place: sp.Expr) -> Row:
        """Return the derivatives of a position by the coordinates."""
        used = [(i, q) for i, q, _ in self._variables_in(place) if 0 <= i < len(self.q)]
        return {i: slope for i, q in used if (slope := sp.diff(place, q)) != 0}

    def dense(self, rows: Iterable[Row]) -> list[sp.Expr]:
        """Return the entries of rows for all coordinates, row by row."""
        return [row.get(i, sp.S.Zero) for row in rows for i in range(len(self.q))]

    def _variables_in(self, expression: sp.Expr) -> list[tuple[int, sp.Symbol, sp.Expr]]:
        return sorted(self._varying[x] for x in expression.free_symbols if x in self._varying)

    def body_frame(self, name: str) -> Frame:
        """Return the centre of mass and the angle of a body."""
        body = self.scene.bodies[name]
        if body.position is not None:
            return self.vector(body.position), self.formula(body.angle or 0)
        coordinates = {c: self.known[f"{name}.{c}"] for c in body.coordinates}
        return (coordinates["x"], coordinates["y"]), coordinates.get("angle", sp.S.Zero)

    def point(self, point: Point) -> Vector:
        """Return the position of a point of a body."""
        return in_world(self.body_frame(point.body), self.vector(point.at))

    def curved(self, name: str) -> bool:
        """Return whether a contact's surface is the graph of a function that is not linear."""
        height = self.scene.surface_of(name).height
        x = sp.Symbol("x", real=True)
        return height is not None and sp.diff(self.formula(height, x=x), x, 2) != 0

    def formula(self, text: str | int | float, **further: sp.Expr) -> sp.Expr:
        """Return the expression of a formula; `further` names precede those of `known`."""
        return parse(text).to_sympy(ChainMap(further, self.known))

    def vector(self, pair: Pair) -> Vector:
        """Return the expressions of two components."""
        return self.formula(pair[0]), self.formula(pair[1])

    def _corners(self, line: tuple[Pair, Pair]) -> tuple[Vector, Vector]:
        return self.vector(line[0]), self.vector(line[1])

    def joint_end(self, to: Point | Path) -> Vector:
        """Return the position that a joint holds its point at; 0 for a component without a row."""
        return self.point(to) if isinstance(to, Point) else self.vector((to.x or 0, to.y or 0))

    def edge_ends(self, surface: Surface) -> tuple[Vector, ...]:
        """Return the ends of an edge in the world; () for other surfaces."""
        if surface.edge is None:
            return ()
        frame = self.surface_frame(surface)
        return tuple(in_world(frame, corner) for corner in self._corners(surface.edge))

    def surface_frame(self, surface: Surface) -> Frame:
        """Return the frame of a surface: that of its body, or the one that its path moves."""
        if surface.body is not None:
            return self.body_frame(surface.body)
        x0, y0, angle = surface_frame(surface, self.known)
        return (x0, y0), angle

    def _rim(self, contact: Contact) -> Rim:
        surface = self.scene.surfaces[contact.surface]
        radius = self.formula(contact.radius or 0)
        turn = self.body_frame(contact.point.body)[1] - self.surface_frame(surface)[1]
        if surface.circle is None or surface.radius is None:
            return Rim(radius, turn)
        side = -1 if surface.hollow else 1
        distance = self.formula(surface.radius) + side * radius
        return Rim(radius, turn, (self.vector(surface.circle), distance), side)

    def _in_frame(self, surface: Surface, point: Vector) -> Vector:
        (x0, y0), angle = self.surface_frame(surface)
        return rotation(-angle)((point[0] - x0, point[1] - y0))

    def _surface(
        self, surface: Surface, x: sp.Symbol, y: sp.Symbol
    ) -> tuple[sp.Expr, Vector, sp.Expr]:
        """Return an implicit function f of the surface, its unit normal, and 1 / |grad f|.

        f / |grad f| is the distance to first order.
        """
        if surface.height is not None:
            height = self.formula(surface.height, x=x)
            slope = sp.diff(height, x)
            unit = 1 / sp.sqrt(1 + slope**2)
            return y - height, (-slope * unit, unit), unit
        if surface.circle is not None and surface.radius is not None:
            cx, cy = self.vector(surface.circle)
            distance = sp.sqrt((x - cx) ** 2 + (y - cy) ** 2)
            side = -1 if surface.hollow else 1
            return (
                side * (distance - self.formula(surface.radius)),
                (side * (x - cx) / distance, side * (y - cy) / distance),
                sp.S.One,
            )
        line = surface.line or surface.edge
        if line is not None:
            (x0, y0), (x1, y1) = self._corners(line)
            length = sp.sqrt((x1 - x0) ** 2 + (y1 - y0) ** 2)
            normal = ((y0 - y1) / length, (x1 - x0) / length)
        else:
            angle = self.formula(surface.incline)  # type: ignore[arg-type]
            x0, y0 = self.vector(surface.through)
            normal = (-sp.sin(angle), sp.cos(angle))
        return normal[0] * (x - x0) + normal[1] * (y - y0), normal, sp.S.One


def surface_frame(surface: Surface, known: Mapping[str, sp.Expr]) -> tuple[sp.Expr, ...]:
    """Return x, y and angle of the frame of a surface that moves on a path."""
    dx, dy, turn = (parse(t).to_sympy(known) for t in (*surface.displacement, surface.turn))
    if turn == 0:
        return dx, dy, turn
    px, py = (parse(text).to_sympy(known) for text in surface.pivot)
    x, y = rotation(turn)((px, py))
    return dx + px - x, dy + py - y, turn
