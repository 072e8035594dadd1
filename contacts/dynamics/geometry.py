"""Positions of bodies, points and surfaces as expressions of the coordinates.

Discs (wheels, round feet, balls) touch straight surfaces and circles with their rims. The contact
point of a disc has the velocity of the centre plus that of the rotation, and moves along the rim
as the disc rolls. Rolling in the plane is holonomic: the rolled length is the radius times the
angle of the disc relative to its surface.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import sympy as sp

from contacts.scene.joints import Path
from contacts.scene.parts import Contact, Pair, Point, Surface
from contacts.scene.scene import Scene
from statechart.documents.declaration import TIME
from statechart.formulas.formula import parse

Vector = tuple[sp.Expr, sp.Expr]


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
        back = _rotation(-self._orbit_angle)
        return back((centre[0] - x, centre[1] - y)), back(tangent)

    def centre(self, anchor: Vector, tangent: Vector) -> Vector:
        """Return the centre of a disc that rolls, by its anchor; see `anchored`."""
        if self.radius == 0:
            return anchor
        if self.circle is None:
            return _sum(anchor, tangent, -self.radius * self.turn)
        (x, y), _ = self.circle
        dx, dy = _rotation(self._orbit_angle)(anchor)
        return x + dx, y + dy

    @property
    def _orbit_angle(self) -> sp.Expr:
        """Angle by which a rolling disc's centre has moved about the centre of the circle."""
        assert self.circle is not None
        return self.side * self.radius * self.turn / self.circle[1]


def _sum(place: Vector, direction: Vector, by: sp.Expr) -> Vector:
    return place[0] + by * direction[0], place[1] + by * direction[1]


def _rotation(angle: sp.Expr) -> Callable[[Vector], Vector]:
    c, s = sp.cos(angle), sp.sin(angle)
    return lambda v: (c * v[0] - s * v[1], s * v[0] + c * v[1])


class Geometry:
    """Positions of a scene's bodies, points and surfaces as expressions of its coordinates `q`.

    `v` and `a` are rates and accelerations, `variables` q and v together. `known` maps the names
    that formulas may use to expressions; `constants` are those of parameters and controls.
    """

    def __init__(self, scene: Scene, constants: Mapping[str, sp.Symbol]) -> None:
        self.scene = scene
        self.names = scene.variables
        count = range(len(self.names))
        self.time = sp.Symbol("t", real=True)
        self.q = tuple(sp.Symbol(f"q{i}", real=True) for i in count)
        self.v = tuple(sp.Symbol(f"v{i}", real=True) for i in count)
        self.a = tuple(sp.Symbol(f"a{i}", real=True) for i in count)
        rates = tuple(map(scene.rate_name, self.names))
        self.variable_names, self.variables = (*self.names, *rates), (*self.q, *self.v)
        # Variables of controllers that move surfaces, and their rates.
        self.carried: tuple[tuple[sp.Symbol, sp.Symbol], ...] = ()
        self.known: dict[str, sp.Expr] = {
            TIME: self.time,
            **constants,
            **dict(zip(self.variable_names, self.variables, strict=True)),
        }

    def rate(self, expression: sp.Expr) -> sp.Expr:
        """Return the total derivative with respect to time, accelerations included."""
        used = expression.free_symbols
        terms = [sp.diff(expression, self.time)] if self.time in used else []
        pairs = (*zip(self.q, self.v, strict=True), *zip(self.v, self.a, strict=True))
        for x, dx in (*pairs, *self.carried):
            if x in used:
                terms.append(sp.diff(expression, x) * dx)
        return sp.Add(*terms)

    def body_frame(self, name: str) -> tuple[Vector, sp.Expr]:
        """Return the centre of mass and the angle of a body."""
        body = self.scene.bodies[name]
        if body.position is not None:
            x, y = (self._formula(text) for text in body.position)
            return (x, y), self._formula(body.angle) if body.angle is not None else sp.S.Zero
        coordinates = {c: self.known[f"{name}.{c}"] for c in body.coordinates}
        return (coordinates["x"], coordinates["y"]), coordinates.get("angle", sp.S.Zero)

    def point(self, point: Point) -> Vector:
        """Return the position of a point of a body."""
        (x, y), angle = self.body_frame(point.body)
        local_x, local_y = (self._formula(text) for text in point.at)
        c, s = sp.cos(angle), sp.sin(angle)
        return x + local_x * c - local_y * s, y + local_x * s + local_y * c

    def curved(self, name: str) -> bool:
        """Return whether a contact's surface is the graph of a function that is not linear."""
        height = self.scene.surfaces[self.scene.contacts[name].surface].height
        x = sp.Symbol("x", real=True)
        return height is not None and sp.diff(self._formula(height, x=x), x, 2) != 0

    def _formula(self, text: str | int | float, **further: sp.Expr) -> sp.Expr:
        return parse(text).to_sympy({**self.known, **further})

    def _corners(self, line: tuple[Pair, Pair]) -> tuple[Vector, Vector]:
        (x0, y0), (x1, y1) = line
        return (self._formula(x0), self._formula(y0)), (self._formula(x1), self._formula(y1))

    def joint_end(self, to: Point | Path) -> Vector:
        """Return the position that a joint holds its point at; 0 for a component without a row."""
        if isinstance(to, Point):
            return self.point(to)
        return self._formula(to.x or 0), self._formula(to.y or 0)

    def edge_ends(self, surface: Surface) -> tuple[Vector, ...]:
        """Return the ends of an edge in the world; () for other surfaces."""
        if surface.edge is None:
            return ()
        (x0, y0), angle = self._frame(surface)
        c, s = sp.cos(angle), sp.sin(angle)
        return tuple(
            (x0 + c * x - s * y, y0 + s * x + c * y) for x, y in self._corners(surface.edge)
        )

    def _frame(self, surface: Surface) -> tuple[Vector, sp.Expr]:
        if surface.body is not None:
            return self.body_frame(surface.body)
        x0, y0, angle = surface_frame(surface, self.known)
        return (x0, y0), angle

    def _rim(self, contact: Contact) -> Rim:
        surface = self.scene.surfaces[contact.surface]
        radius = self._formula(contact.radius or 0)
        turn = self.body_frame(contact.point.body)[1] - self._frame(surface)[1]
        if surface.circle is None or surface.radius is None:
            return Rim(radius, turn)
        cx, cy = (self._formula(text) for text in surface.circle)
        side = -1 if surface.hollow else 1
        return Rim(radius, turn, ((cx, cy), self._formula(surface.radius) + side * radius), side)

    def _in_frame(self, surface: Surface, point: Vector) -> Vector:
        (x0, y0), angle = self._frame(surface)
        c, s = sp.cos(angle), sp.sin(angle)
        dx, dy = point[0] - x0, point[1] - y0
        return c * dx + s * dy, c * dy - s * dx

    def _surface(
        self, surface: Surface, x: sp.Symbol, y: sp.Symbol
    ) -> tuple[sp.Expr, Vector, sp.Expr]:
        """Return an implicit function f of the surface, its unit normal, and 1 / |grad f|.

        f / |grad f| is the distance to first order.
        """
        if surface.height is not None:
            height = self._formula(surface.height, x=x)
            slope = sp.diff(height, x)
            unit = 1 / sp.sqrt(1 + slope**2)
            return y - height, (-slope * unit, unit), unit
        if surface.circle is not None and surface.radius is not None:
            cx, cy = (self._formula(text) for text in surface.circle)
            distance = sp.sqrt((x - cx) ** 2 + (y - cy) ** 2)
            side = -1 if surface.hollow else 1
            return (
                side * (distance - self._formula(surface.radius)),
                (side * (x - cx) / distance, side * (y - cy) / distance),
                sp.S.One,
            )
        line = surface.line or surface.edge
        if line is not None:
            (x0, y0), (x1, y1) = self._corners(line)
            length = sp.sqrt((x1 - x0) ** 2 + (y1 - y0) ** 2)
            normal = ((y0 - y1) / length, (x1 - x0) / length)
        else:
            angle = self._formula(surface.incline)  # type: ignore[arg-type]
            x0, y0 = (self._formula(text) for text in surface.through)
            normal = (-sp.sin(angle), sp.cos(angle))
        return normal[0] * (x - x0) + normal[1] * (y - y0), normal, sp.S.One


def surface_frame(surface: Surface, known: Mapping[str, sp.Expr]) -> tuple[sp.Expr, ...]:
    """Return x, y and angle of the frame of a surface that moves on a path."""
    dx, dy, turn = (parse(t).to_sympy(known) for t in (*surface.displacement, surface.turn))
    if turn == 0:
        return dx, dy, turn
    px, py = (parse(text).to_sympy(known) for text in surface.pivot)
    c, s = sp.cos(turn), sp.sin(turn)
    return dx + px - c * px + s * py, dy + py - s * px - c * py, turn
