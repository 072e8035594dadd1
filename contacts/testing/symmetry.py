"""Scenes transformed so that the answer is known: mirrored, and in other units.

Formulas are changed at the places where their syntax trees have names, and wrapped as a whole;
text is never searched. What a formula reads is turned back into the scene's own directions and
units, and what it gives is turned into the new ones, so that no formula needs to be understood:
``y = f(x)`` becomes ``y = a f(x / a)`` whatever lengths are hidden in f.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from contacts.scene.controls import Controller, ControlRegion, ControlState
from contacts.scene.joints import Force, Joint, Path
from contacts.scene.parts import Body, Contact, Pair, Point, Surface
from contacts.scene.scene import Scene
from contacts.scene.shapes import Shape
from statechart.charts.transitions import Transition
from statechart.documents.declaration import TIME
from statechart.documents.fields import FormulaText
from statechart.documents.settings import Stop
from statechart.formulas.formula import Formula, parse
from statechart.formulas.relation import Relation, parse_relation
from statechart.formulas.tree import names_in
from statechart.testing.stories import Reading

# Powers of two: scaling is exact, so that what differs is a number that does not scale.
LENGTH = 2.0**20
TIMES = 2.0**-10
MASS = 2.0**-20
"""New units per old one in a rescaled scene."""


def mirrored(scene: Scene) -> tuple[Scene, Reading]:
    """Return the scene seen in a mirror, x -> -x, and how to read its runs.

    Parameters
    ----------
    scene : Scene
        What was declared.

    Raises
    ------
    DeclarationError
        If a formula is too long to be wrapped.
    """
    change = _Change(
        scene,
        x=-1.0,
        y=1.0,
        rates=(-1.0, 1.0),
        angle=-1.0,
        spin=-1.0,
        own=(1.0, 1.0),
        normal=1.0,
        tangential=-1.0,
        moment=-1.0,
        gravity=(-1.0, 1.0),
        mass=1.0,
        inertia=1.0,
        slip=-1.0,
        gap=1.0,
        energy=1.0,
        time=1.0,
    )
    return change.scene(), change.reading({"slide+": "slide-", "slide-": "slide+"})


def rescaled(scene: Scene) -> tuple[Scene, Reading]:
    """Return the scene in units `LENGTH`, `TIMES` and `MASS` smaller, and how to read its runs.

    Coordinates that the scene names keep their values: what their unit is only positions say.

    Parameters
    ----------
    scene : Scene
        What was declared.

    Raises
    ------
    DeclarationError
        If a formula is too long to be wrapped.
    """
    speed, acceleration = LENGTH / TIMES, LENGTH / TIMES**2
    force = MASS * acceleration
    change = _Change(
        scene,
        x=LENGTH,
        y=LENGTH,
        rates=(speed, speed),
        angle=1.0,
        spin=1.0 / TIMES,
        own=(1.0, 1.0 / TIMES),
        normal=force,
        tangential=force,
        moment=force * LENGTH,
        gravity=(acceleration, acceleration),
        mass=MASS,
        inertia=MASS * LENGTH**2,
        slip=speed,
        gap=LENGTH,
        energy=force * LENGTH,
        time=TIMES,
    )
    return change.scene(), change.reading({})


@dataclass(frozen=True)
class _Change:
    """The factor of everything that a scene has: new per old."""

    declared: Scene  # what is changed
    x: float  # of positions and of a free body's angle
    y: float
    rates: tuple[float, float]  # of their rates
    angle: float
    spin: float
    own: tuple[float, float]  # of coordinates that the scene names, and of their rates
    normal: float  # of forces along y and normals, along x and tangents, and of moments
    tangential: float
    moment: float
    gravity: tuple[float, float]  # of what they say
    mass: float
    inertia: float
    slip: float
    gap: float
    energy: float
    time: float

    def reading(self, states: Mapping[str, str]) -> Reading:
        """Return how to read the runs of the changed scene."""
        scene = self.declared
        names = (*scene.variables, *map(scene.rate_name, scene.variables), *scene.controlled.memory)
        factors = np.array([1.0 / self._factors.get(name, 1.0) for name in names])
        return Reading(factors, 1.0 / self.time, states)

    def scene(self) -> Scene:
        """Return the changed scene, without outputs, ranges and declared modes."""
        old = self.declared
        gravity = old.gravity if isinstance(old.gravity, tuple) else (0, f"-({old.gravity})")
        end = old.stop.time
        return Scene(
            name=old.name,
            parameters=old.parameters,
            gravity=(
                _times(gravity[0], self.gravity[0]),
                _times(gravity[1], self.gravity[1]),
            ),
            coordinates={
                name: c.model_copy(
                    update={
                        "start": _times(c.start, self.own[0]),
                        "rate": _times(c.rate, self.own[1]),
                    }
                )
                for name, c in old.coordinates.items()
            },
            bodies={name: self._body(body) for name, body in old.bodies.items()},
            surfaces={name: self._surface(surface) for name, surface in old.surfaces.items()},
            contacts={name: self._contact(contact) for name, contact in old.contacts.items()},
            joints={name: self._joint(joint) for name, joint in old.joints.items()},
            collisions=old.collisions,
            forces={name: self._force(force) for name, force in old.forces.items()},
            # Controls keep their values: what their unit is only the formulas say that use them.
            controls={
                name: self._read(parse(text), self._factors) for name, text in old.controls.items()
            },
            regions={name: self._controller(region) for name, region in old.regions.items()},
            simultaneous=old.simultaneous,
            paradox=old.paradox,
            stop=Stop(
                time=None if end is None else _times(end, self.time),
                conditions={
                    label: self._read(parse_relation(text), self._factors)
                    for label, text in old.stop.conditions.items()
                },
            ),
            settings=old.settings
            if old.settings.step is None
            else old.settings.model_copy(update={"step": old.settings.step * self.time}),
        )

    @property
    def _factors(self) -> dict[str, float]:
        """Name in a formula -> its factor, where it has one."""
        old = self.declared
        found = {TIME: self.time, "energy": self.energy}
        for name in old.coordinates:
            found |= {name: self.own[0], old.rate_name(name): self.own[1]}
        for name in (*old.single_bodies(), *old.bodies):
            found |= {f"{name}.x": self.x, f"{name}.y": self.y, f"{name}.angle": self.angle}
            found |= {f"{name}.dx": self.rates[0], f"{name}.dy": self.rates[1]}
            found[f"{name}.dangle"] = self.spin
        for name in old.contacts:
            found |= {f"{name}.gap": self.gap, f"{name}.slip": self.slip}
            found |= {f"{name}.V": self.normal, f"{name}.H": self.tangential}
        for name in old.joints:
            found |= {f"{name}.X": self.tangential, f"{name}.Y": self.normal}
        return found | dict.fromkeys(old.controlled.clocks, self.time)

    def _body(self, body: Body) -> Body:
        factors = {
            "x": self.x,
            "y": self.y,
            "angle": self.angle,
            "dx": self.rates[0],
            "dy": self.rates[1],
            "dangle": self.spin,
        }
        return Body(
            mass=_times(body.mass, self.mass),
            inertia=None if body.inertia is None else _times(body.inertia, self.inertia),
            position=None if body.position is None else self._pair(body.position),
            angle=None if body.angle is None else _times(body.angle, self.angle),
            start={key: _times(text, factors[key]) for key, text in body.start.items()},
            shape=tuple(map(self._shape, body.shape)),
            copies=body.copies,
        )

    def _shape(self, shape: Shape) -> Shape:
        if shape.polygon is None:
            assert shape.disc is not None
            return Shape(disc=_times(shape.disc, abs(self.x)), at=self._pair(shape.at))
        corners = [self._pair(corner) for corner in shape.polygon]
        # In a mirror they go round the other way.
        return Shape(polygon=tuple(corners if self.x > 0.0 else corners[::-1]))

    def _surface(self, surface: Surface) -> Surface:
        height, radius = surface.height, surface.radius
        if height is not None:
            height = _times(self._read(parse(height), {"x": self.x}), self.y)
        dx, dy = surface.displacement
        return Surface(
            height=height,
            # In a mirror a slope goes the other way, as an angle does.
            incline=None if surface.incline is None else _times(surface.incline, self.angle),
            through=self._pair(surface.through),
            line=self._line(surface.line),
            edge=self._line(surface.edge),
            circle=None if surface.circle is None else self._pair(surface.circle),
            radius=None if radius is None else _times(radius, abs(self.x)),
            body=surface.body,
            hollow=surface.hollow,
            displacement=(self._displaced(dx, self.x), self._displaced(dy, self.y)),
            turn=self._displaced(surface.turn, self.angle),
        )

    def _line(self, line: tuple[Pair, Pair] | None) -> tuple[Pair, Pair] | None:
        if line is None:
            return None
        # In a mirror the solid would be on the other side of the line.
        first, second = line if self.x > 0.0 else line[::-1]
        return self._pair(first), self._pair(second)

    def _displaced(self, text: FormulaText, factor: float) -> FormulaText:
        return text if text == 0 else _times(self._read(parse(text), self._factors), factor)

    def _contact(self, contact: Contact) -> Contact:
        enabled = tuple(self._read(parse_relation(t), self._factors) for t in contact.enabled)
        radius = None if contact.radius is None else _times(contact.radius, abs(self.x))
        changes = {"point": self._point(contact.point), "radius": radius, "enabled": enabled}
        return contact.model_copy(update=changes)

    def _point(self, point: Point) -> Point:
        return Point(body=point.body, at=self._pair(point.at))

    def _joint(self, joint: Joint) -> Joint:
        to = joint.to
        if isinstance(to, Point):
            return Joint(point=self._point(joint.point), to=self._point(to))
        x = None if to.x is None else self._displaced(to.x, self.x)
        y = None if to.y is None else self._displaced(to.y, self.y)
        return Joint(point=self._point(joint.point), to=Path(x=x, y=y))

    def _force(self, force: Force) -> Force:
        def formula(text: FormulaText, factor: float) -> FormulaText:
            return _times(self._read(parse(text), self._factors), factor)

        return Force(
            body=force.body,
            force=(
                formula(force.force[0], self.tangential),
                formula(force.force[1], self.normal),
            ),
            at=self._pair(force.at),
            moment=formula(force.moment, self.moment),
        )

    def _controller(self, region: Controller) -> Controller:
        """Return a controller that remembers the same values."""
        return region.model_copy(update=self._holder(region))

    def _holder(self, holder: Controller | ControlRegion | ControlState) -> dict[str, Any]:
        found: dict[str, Any] = {
            "states": {
                name: state.model_copy(update=self._state(state))
                for name, state in holder.states.items()
            },
            "transitions": tuple(map(self._transition, holder.transitions)),
        }
        if isinstance(holder, ControlState):
            found["regions"] = {
                name: region.model_copy(update=self._holder(region))
                for name, region in holder.regions.items()
            }
        return found

    def _state(self, state: ControlState) -> dict[str, Any]:
        return {
            **self._holder(state),
            "sets": self._texts(state.sets),
            "entry": self._texts(state.entry),
            "exit": self._texts(state.exit),
            "flows": {n: _times(t, 1.0 / self.time) for n, t in self._texts(state.flows).items()},
        }

    def _transition(self, transition: Transition) -> Transition:
        changed: dict[str, Any] = {"updates": self._texts(transition.updates)}
        if transition.guard is not None:
            changed["guard"] = self._read(parse_relation(transition.guard), self._factors)
        for key in ("after", "every"):
            if (period := getattr(transition, key)) is not None:
                changed[key] = _times(period, self.time)
        return transition.model_copy(update=changed)

    def _texts(self, texts: Mapping[str, FormulaText]) -> dict[str, FormulaText]:
        return {name: self._read(parse(text), self._factors) for name, text in texts.items()}

    def _pair(self, pair: tuple[FormulaText, FormulaText]) -> tuple[FormulaText, FormulaText]:
        return _times(pair[0], self.x), _times(pair[1], self.y)

    @staticmethod
    def _read(formula: Formula | Relation, factors: Mapping[str, float]) -> str:
        """Return the text with every name that has a factor divided by it."""
        roots = (
            [formula.root]
            if isinstance(formula, Formula)
            else [side.root for side in formula.formulas]
        )
        names = {name.offset: name.name for root in roots for name in names_in(root)}
        text = formula.text
        for offset, name in sorted(names.items(), reverse=True):
            factor = factors.get(name, 1.0)
            if factor != 1.0:
                end = offset + len(name)
                text = f"{text[:offset]}({name}/({factor!r})){text[end:]}"
        return text


def _times(text: FormulaText, factor: float) -> FormulaText:
    return text if factor == 1.0 or text == 0 else f"({text})*({factor!r})"
