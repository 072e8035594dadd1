"""Scenes transformed so that the answer is known: mirrored, and in other units.

Formulas are changed at the places where their syntax trees have names, and wrapped as a whole;
text is never searched. What a formula reads is turned back into the scene's own directions and
units, and what it gives is turned into the new ones, so that no formula needs to be understood:
``y = f(x)`` becomes ``y = a f(x / a)`` whatever lengths are hidden in f.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

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
from statechart.errors import DeclarationError
from statechart.formulas.formula import Formula, parse
from statechart.formulas.relation import Relation, parse_relation
from statechart.formulas.tree import names_in
from statechart.testing.agreement import assert_same, identical
from statechart.testing.event_sequences import Reading
from statechart.testing.properties import Property
from statechart.testing.subject import Case, Subject

T = TypeVar("T", FormulaText, FormulaText | None)

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
    change = _Change(scene, x=-1.0)
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
    change = _Change(scene, x=LENGTH, y=LENGTH, time=TIMES, mass=MASS)
    return change.scene(), change.reading({})


@dataclass(frozen=True)
class _Change:
    """The factors of lengths, times and masses of a scene, new per old; x < 0 is a mirror."""

    declared: Scene
    x: float = 1.0
    y: float = 1.0
    time: float = 1.0
    mass: float = 1.0

    @property
    def angle(self) -> float:
        return math.copysign(1.0, self.x)

    @property
    def accelerations(self) -> tuple[float, float]:
        return self.x / self.time**2, self.y / self.time**2

    @property
    def forces(self) -> tuple[float, float]:
        """Along x and tangents, along y and normals."""
        x, y = self.accelerations
        return self.mass * x, self.mass * y

    def reading(self, states: Mapping[str, str]) -> Reading:
        """Return how to read the runs of the changed scene."""
        scene = self.declared
        names = (*scene.variables, *map(scene.rate_name, scene.variables), *scene.controlled.memory)
        factors = np.array([1.0 / self._factors.get(name, 1.0) for name in names])
        return Reading(factors, 1.0 / self.time, states)

    def scene(self) -> Scene:
        """Return the changed scene, without outputs, ranges and declared modes."""
        old, step = self.declared, self.declared.settings.step
        gravity = old.gravity if isinstance(old.gravity, tuple) else (0, f"-({old.gravity})")
        along, down = self.accelerations
        return Scene(
            name=old.name,
            parameters=old.parameters,
            gravity=(_times(gravity[0], along), _times(gravity[1], down)),
            coordinates={
                name: c.model_copy(update={"rate": _times(c.rate, 1.0 / self.time)})
                for name, c in old.coordinates.items()
            },
            bodies={name: self._body(body) for name, body in old.bodies.items()},
            surfaces={name: self._surface(surface) for name, surface in old.surfaces.items()},
            contacts={name: self._contact(contact) for name, contact in old.contacts.items()},
            joints={name: self._joint(joint) for name, joint in old.joints.items()},
            collisions=old.collisions,
            forces={name: self._force(force) for name, force in old.forces.items()},
            # Controls keep their values: what their unit is only the formulas say that use them.
            controls=self._texts(old.controls),
            regions={
                name: region.model_copy(update=self._holder(region))
                for name, region in old.regions.items()
            },
            simultaneous=old.simultaneous,
            paradox=old.paradox,
            stop=Stop(
                time=_times(old.stop.time, self.time),
                conditions={
                    label: self._relation(text) for label, text in old.stop.conditions.items()
                },
            ),
            settings=old.settings.model_copy(
                update={} if step is None else {"step": step * self.time}
            ),
        )

    @cached_property
    def _factors(self) -> dict[str, float]:
        """Name in a formula -> its factor, where it has one."""
        old, (tangential, normal) = self.declared, self.forces
        found = {TIME: self.time, "energy": tangential * self.x}
        found |= {old.rate_name(name): 1.0 / self.time for name in old.coordinates}
        for name in (*old.single_bodies(), *old.bodies):
            found |= {f"{name}.{key}": factor for key, factor in self._starts.items()}
        for name in old.contacts:
            found |= {f"{name}.gap": self.y, f"{name}.slip": self.x / self.time}
            found |= {f"{name}.V": normal, f"{name}.H": tangential}
        for name in old.joints:
            found |= {f"{name}.X": tangential, f"{name}.Y": normal}
        return found | dict.fromkeys(old.controlled.clocks, self.time)

    @property
    def _starts(self) -> dict[str, float]:
        """Coordinate of a free body -> its factor."""
        found = {"x": self.x, "y": self.y, "angle": self.angle}
        return found | {f"d{name}": factor / self.time for name, factor in found.items()}

    def _body(self, body: Body) -> Body:
        return Body(
            mass=_times(body.mass, self.mass),
            inertia=_times(body.inertia, self.mass * self.x**2),
            position=None if body.position is None else self._pair(body.position),
            angle=_times(body.angle, self.angle),
            start={key: _times(text, self._starts[key]) for key, text in body.start.items()},
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
        height = surface.height
        if height is not None:
            height = _times(self._read(parse(height), {"x": self.x}), self.y)
        dx, dy = surface.displacement
        return Surface(
            height=height,
            # In a mirror a slope goes the other way, as an angle does.
            incline=_times(surface.incline, self.angle),
            through=self._pair(surface.through),
            line=self._line(surface.line),
            edge=self._line(surface.edge),
            circle=None if surface.circle is None else self._pair(surface.circle),
            radius=_times(surface.radius, abs(self.x)),
            body=surface.body,
            hollow=surface.hollow,
            displacement=(self._formula(dx, self.x), self._formula(dy, self.y)),
            turn=self._formula(surface.turn, self.angle),
        )

    def _line(self, line: tuple[Pair, Pair] | None) -> tuple[Pair, Pair] | None:
        if line is None:
            return None
        # In a mirror the solid would be on the other side of the line.
        first, second = line if self.x > 0.0 else line[::-1]
        return self._pair(first), self._pair(second)

    def _contact(self, contact: Contact) -> Contact:
        enabled = tuple(map(self._relation, contact.enabled))
        radius = _times(contact.radius, abs(self.x))
        changes = {"point": self._point(contact.point), "radius": radius, "enabled": enabled}
        return contact.model_copy(update=changes)

    def _point(self, point: Point) -> Point:
        return Point(body=point.body, at=self._pair(point.at))

    def _joint(self, joint: Joint) -> Joint:
        to = joint.to
        if isinstance(to, Point):
            return Joint(point=self._point(joint.point), to=self._point(to))
        path = Path(x=self._formula(to.x, self.x), y=self._formula(to.y, self.y))
        return Joint(point=self._point(joint.point), to=path)

    def _force(self, force: Force) -> Force:
        (x, y), (tangential, normal) = force.force, self.forces
        return Force(
            body=force.body,
            force=(self._formula(x, tangential), self._formula(y, normal)),
            at=self._pair(force.at),
            moment=self._formula(force.moment, tangential * self.y),
        )

    def _holder(self, holder: Controller | ControlRegion | ControlState) -> dict[str, Any]:
        """Return what changes in a controller, which remembers the same values."""
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
        changed: dict[str, Any] = {
            "updates": self._texts(transition.updates),
            "after": _times(transition.after, self.time),
            "every": _times(transition.every, self.time),
        }
        if transition.guard is not None:
            changed["guard"] = self._relation(transition.guard)
        return transition.model_copy(update=changed)

    def _texts(self, texts: Mapping[str, FormulaText]) -> dict[str, FormulaText]:
        return {name: self._read(parse(text), self._factors) for name, text in texts.items()}

    def _relation(self, text: str) -> str:
        return self._read(parse_relation(text), self._factors)

    def _formula(self, text: T, factor: float) -> T | str:
        """Return a formula of what changes along a run, read and given in the new units."""
        if text is None or text == 0:
            return text
        return _times(self._read(parse(text), self._factors), factor)

    def _pair(self, pair: tuple[FormulaText, FormulaText]) -> tuple[FormulaText, FormulaText]:
        return _times(pair[0], self.x), _times(pair[1], self.y)

    @staticmethod
    def _read(formula: Formula | Relation, factors: Mapping[str, float]) -> str:
        """Return the text with every name that has a factor divided by it."""
        sides = [formula] if isinstance(formula, Formula) else formula.formulas
        names = {name.offset: name.name for side in sides for name in names_in(side.root)}
        text = formula.text
        for offset, name in sorted(names.items(), reverse=True):
            factor = factors.get(name, 1.0)
            if factor != 1.0:
                end = offset + len(name)
                text = f"{text[:offset]}({name}/({factor!r})){text[end:]}"
        return text


def _times(text: T, factor: float) -> T | str:
    """Return a formula times a factor; nothing, and zero, as they are."""
    return text if text is None or factor == 1.0 or text == 0 else f"({text})*({factor!r})"


def image_properties(scene: Scene) -> tuple[Property, ...]:
    """Return what holds of the runs of a scene and of those of its images."""
    return (
        image_property("the mirror image moves as the image", scene, mirrored),
        image_property("other units give the same motion", scene, rescaled),
    )


def image_property(
    name: str, scene: Scene, transform: Callable[[Scene], tuple[Scene, Reading]]
) -> Property:
    """Return the property that the transformed scene has the transformed runs."""
    changed: dict[Subject, tuple[Subject, Reading]] = {}

    def compare(case: Case) -> None:
        own = case.subject
        assert isinstance(own.model, Scene)
        if own not in changed:
            turned, reading = transform(own.model)
            changed[own] = Subject(turned), reading
        subject, reading = changed[own]
        trace = case.sound[0]
        image = subject.fresh(case.parameters).trace
        assert image.outcome is trace.outcome, f"the changed scene ends: {image.message}"
        if not identical(trace, image, reading):
            assert_same(trace, image, case.sensitivity, reading=reading)

    try:
        transform(scene)
    except DeclarationError as error:
        reason = error.message
        return Property(name, lambda case: None, f"the scene cannot be transformed: {reason}")

    def holds(case: Case) -> None:
        try:
            compare(case)
        except AssertionError:
            finer = case.subject.finer
            if finer is None:
                raise
            # What impulses miss their laws by is in no variable's size, nor the image's in the
            # image: runs that miss less tell whether it was that.
            compare(finer.case(case.parameters))

    return Property(name, holds)
