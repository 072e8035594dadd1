"""Positions to the motion of bodies that nothing touches: mass matrix and forces, by SymPy."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import sympy as sp

from contacts.dynamics.geometry import Geometry
from contacts.dynamics.rims import Vector
from contacts.scene.parts import Body, Point
from contacts.scene.scene import Scene
from statechart.formulas.parameters import Parameters


class FreeMotion(Geometry):
    """The kinetic energy of a scene's bodies, and what is applied to them.

    With centres and angles that are expressions of coordinates q it gives
    ``M(q) a + b(q, v) = Q``.

    Parameters
    ----------
    scene : Scene
        As declared.
    parameters : Parameters
        Declared ones, and what follows from them.
    constants : mapping
        Name -> symbol of what does not follow from the coordinates.
    """

    def __init__(
        self, scene: Scene, parameters: Parameters, constants: Mapping[str, sp.Symbol]
    ) -> None:
        super().__init__(scene, constants)
        self.parameters = parameters

    @cached_property
    def mass_matrix(self) -> sp.Matrix:
        """(n, n): of the kinetic energy ``v^T M v / 2``."""
        return self._inertia[0]

    @cached_property
    def generalised_forces(self) -> tuple[sp.Expr, ...]:
        """(n,): ``Q - b``, so that ``M a`` equals it where no contact is closed."""
        return tuple(q - b for q, b in zip(self._applied, self._inertia[1], strict=True))

    @cached_property
    def energy(self) -> sp.Expr:
        """Kinetic energy plus that of gravity."""
        kinetic = [
            entry * self.v[i] * self.v[k] / 2 for (i, k), entry in self.mass_matrix.todok().items()
        ]
        gx, gy = self.gravity
        potential = []
        for name, body in self.scene.bodies.items():
            (x, y), _ = self.body_frame(name)
            potential.append(-self._formula(body.mass) * (gx * x + gy * y))
        return sp.Add(*kinetic, *potential)

    def gradient(self, place: sp.Expr) -> list[sp.Expr]:
        """Return the derivatives (n,) by the coordinates; few of many bodies' move a place."""
        used = place.free_symbols
        return [sp.diff(place, q) if q in used else sp.S.Zero for q in self.q]

    @cached_property
    def gravity(self) -> Vector:
        """Acceleration of gravity."""
        declared = self.scene.gravity
        if isinstance(declared, tuple):
            gx, gy = (self._formula(text) for text in declared)
            return gx, gy
        return sp.S.Zero, -self._formula(declared)

    def inertia(self, name: str, body: Body) -> tuple[sp.Expr, sp.Expr]:
        """Return the mass of a body, and its moment of inertia; 0 where it has none."""
        mass = self._formula(body.mass)
        if body.inertia is None:
            return mass, sp.S.Zero
        return mass, self.parameters.symbols[f"{name}.inertia"]

    @cached_property
    def applied_forces(self) -> tuple[sp.Expr, ...]:
        """(n,): what the declared forces do to every coordinate."""
        total = [sp.S.Zero] * len(self.q)
        for force in self.scene.forces.values():
            point = self.point(Point(body=force.body, at=force.at))
            _, angle = self.body_frame(force.body)
            components = [self._formula(text) for text in force.force]
            moment = self._formula(force.moment)
            for i, q in enumerate(self.q):
                work = [f * sp.diff(p, q) for f, p in zip(components, point, strict=True)]
                total[i] += sp.Add(*work, moment * sp.diff(angle, q))
        return tuple(total)

    @cached_property
    def _applied(self) -> tuple[sp.Expr, ...]:
        total = list(self.applied_forces)
        gx, gy = self.gravity
        for name, body in self.scene.bodies.items():
            (x, y), _ = self.body_frame(name)
            mass = self._formula(body.mass)
            for i, (dx, dy) in enumerate(zip(self.gradient(x), self.gradient(y), strict=True)):
                if dx != 0 or dy != 0:
                    total[i] += mass * (gx * dx + gy * dy)
        return tuple(total)

    @cached_property
    def _inertia(self) -> tuple[sp.Matrix, tuple[sp.Expr, ...]]:
        """Mass matrix and bias forces, summed over the bodies."""
        size = len(self.q)
        matrix = sp.zeros(size, size)
        bias = [sp.S.Zero] * size
        at_rest = dict.fromkeys(self.a, sp.S.Zero)
        for name, body in self.scene.bodies.items():
            (x, y), angle = self.body_frame(name)
            mass, inertia = self.inertia(name, body)
            for weight, position in ((mass, x), (mass, y), (inertia, angle)):
                gradient = self.gradient(position)
                moving = [i for i, g in enumerate(gradient) if g != 0]
                drift = self.rate(self.rate(position)).xreplace(at_rest)
                for i in moving:
                    bias[i] += weight * gradient[i] * drift
                    for k in moving:
                        matrix[i, k] += weight * gradient[i] * gradient[k]
        return matrix, tuple(bias)
