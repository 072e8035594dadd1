"""Transformed scenes with known solutions: mirrored, and in other units.

Every field of a scene declares its unit, from which its factor follows. Formulas are edited at the
names in their syntax trees, and wrapped as a whole: inputs are transformed back to the old units,
results to the new ones, so that ``y = f(x)`` becomes ``y = a f(x / a)`` whatever lengths are in f.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from contacts.scene.couplings import Coupling
from contacts.scene.friction import SLIP, StaticKinetic
from contacts.scene.scene import Scene
from statechart.documents.declaration import TIME
from statechart.documents.fields import FormulaText, Part, replace_fields
from statechart.errors import DeclarationError
from statechart.formulas.formula import Formula, parse
from statechart.formulas.relation import Relation, parse_relation
from statechart.formulas.tree import names_in
from statechart.testing.agreement import Reading, assert_same, identical
from statechart.testing.properties import Property
from statechart.testing.subject import Case, Subject

# Powers of two: scaling is exact.
LENGTH = 2.0**20
TIMES = 2.0**-10
MASS = 2.0**-20
"""New units per old one in a rescaled scene."""

# Fields of an image; others (outputs, ranges, invariants, declared modes) do not affect runs.
_KEPT = (
    "name", "parameters", "gravity", "coordinates", "bodies", "surfaces", "contacts", "joints",
    "couplings", "collisions", "forces", "controls", "regions", "simultaneous", "paradox", "stop",
    "settings",
)  # fmt: skip
_RELATIONS = ("guard", "enabled", "conditions")
# A mirror reverses the orientation of corners and ends.
_OUTLINES = ("polygon", "line", "edge")


def mirrored(scene: Scene) -> tuple[Scene, Reading]:
    """Return the scene mirrored, x -> -x, and how to read its runs.

    Parameters
    ----------
    scene : Scene
        The declaration.

    Raises
    ------
    DeclarationError
        If a formula is too long to be wrapped, or controllers may listen to limits of joints.
    """
    change = _Change(scene, x=-1.0)
    states = {"slide+": "slide-", "slide-": "slide+", "slip+": "slip-", "slip-": "slip+"}
    # The slip along a vertical guide is that of its image.
    untransformed = frozenset(name for name in scene.couplings if scene.along_guide(name) == "Y")
    # The least angle of a joint is the greatest one of the image.
    ends = [(f"{n}_min", f"{n}_max") for n, joint in scene.joints.items() if joint.limits]
    if ends and scene.regions:
        raise DeclarationError("its controllers may listen to limits, which change their places")
    regions = dict(ends) | {greatest: least for least, greatest in ends}
    return change.scene(), replace(
        change.reading(states), regions=regions, untransformed=untransformed
    )


def rescaled(scene: Scene) -> tuple[Scene, Reading]:
    """Return the scene in units `LENGTH`, `TIMES` and `MASS` smaller, and how to read its runs.

    Declared coordinates keep their values: only positions tell their unit.

    Parameters
    ----------
    scene : Scene
        The declaration.

    Raises
    ------
    DeclarationError
        If a formula is too long to be wrapped.
    """
    change = _Change(scene, x=LENGTH, y=LENGTH, time=TIMES, mass=MASS)
    return change.scene(), change.reading({})


@dataclass(frozen=True)
class _Change:
    """Factors of lengths, times and masses, new per old; x < 0 is a mirror."""

    declared: Scene
    x: float = 1.0
    y: float = 1.0
    time: float = 1.0
    mass: float = 1.0

    @cached_property
    def _units(self) -> Mapping[str, tuple[float, float, float]]:
        """Unit of a field -> factors along x, along y, and of a scalar."""
        angle = math.copysign(1.0, self.x)
        per = 1.0 / self.time
        force = self.mass * per**2
        lengths = self.x, self.y, self.y
        return {
            "length": lengths,
            "rad": (angle, angle, angle),
            "time": (self.time,) * 3,
            "mass": (self.mass,) * 3,
            "mass length**2": (self.mass * self.x**2,) * 3,
            "length/time": (self.x * per, self.y * per, self.y * per),
            "rad/time": (angle * per,) * 3,
            "length/time, or rad/time": (per,) * 3,
            "length/time**2": (self.x * per**2, self.y * per**2, self.y * per**2),
            "force": (force * self.x, force * self.y, force * self.y),
            "force length": (force * self.x * self.y,) * 3,
            "force/length": (force,) * 3,
            "force time/length": (self.mass * per,) * 3,
        }

    def reading(self, states: Mapping[str, str]) -> Reading:
        """Return how to read the runs of the changed scene."""
        scene = self.declared
        names = (*scene.variables, *map(scene.rate_name, scene.variables))
        names = (*names, *scene.expanded.controlled.controller_state)
        factors = np.array([1.0 / self._factors.get(name, 1.0) for name in names])
        return Reading(factors, 1.0 / self.time, states)

    def scene(self) -> Scene:
        """Return the changed scene, without outputs, ranges and declared modes."""
        changed = self._changed(self.declared, _KEPT)
        gravity = self.declared.gravity
        components = gravity if isinstance(gravity, tuple) else (0, f"-({gravity})")
        changed["gravity"] = self._value("gravity", components, "length/time**2")
        return Scene(**changed)

    def _changed(self, part: Part, names: Collection[str]) -> dict[str, Any]:
        fields = {}
        for name in names:
            extra = type(part).model_fields[name].json_schema_extra
            unit = extra.get("unit", "") if isinstance(extra, dict) else ""
            fields[name] = self._value(name, getattr(part, name), str(unit))
        return fields

    def _value(self, name: str, value: Any, unit: str) -> Any:
        """Return a field's value (or an item of it) in the new units."""
        factor_x, up, plain = self._units.get(unit, (1.0, 1.0, 1.0))
        match value:
            case Coupling():
                return self._coupling(value)
            case Part():
                return type(value)(**self._changed(value, value.model_fields_set))
            case dict():
                return {key: self._item(name, key, one, unit) for key, one in value.items()}
            case tuple() if name in _RELATIONS:
                return tuple(map(self._relation, value))
            case (least, greatest) if name == "limits" and factor_x < 0.0:
                return self._formula(greatest, factor_x), self._formula(least, factor_x)
            case (str() | int() | float(), str() | int() | float()) if unit:
                return self._formula(value[0], factor_x), self._formula(value[1], up)
            case tuple():
                items = tuple(self._value(name, one, unit) for one in value)
                return items[::-1] if name in _OUTLINES and self.x < 0.0 else items
            case str() if name in _RELATIONS:
                return self._relation(value)
            case str() | int() | float() if name == "height":
                return _times(self._read(parse(value), {"x": self.x}), up)
            case str() | int() | float() if unit and not isinstance(value, bool):
                factor = {"x": factor_x, "radius": abs(factor_x), "disc": abs(factor_x)}.get(
                    name, plain
                )
                return self._formula(value, factor)
        return value

    @cached_property
    def _factors(self) -> dict[str, float]:
        """Name in a formula -> its factor."""
        old, units = self.declared, self._units
        (tangential, normal, _), (slip, *_) = units["force"], units["length/time"]
        factors = {TIME: self.time, "energy": tangential * self.x}
        if SLIP not in old.parameters:
            factors[SLIP] = slip
        factors |= {old.rate_name(name): 1.0 / self.time for name in old.coordinates}
        for name in (*old.single_bodies(), *old.bodies):
            places = ("x", "y", "angle", "dx", "dy", "dangle")
            factors |= {f"{name}.{key}": self._start(key) for key in places}
        for name in old.expanded.contacts:
            factors |= {f"{name}.gap": self.y, f"{name}.slip": slip}
            factors |= {f"{name}.V": normal, f"{name}.H": tangential}
        for name in old.couplings:
            couple, slip = self._couple(name)
            factors |= {f"{name}.M": couple, f"{name}.slip": slip}
        for name in old.joints:
            factors |= {f"{name}.X": tangential, f"{name}.Y": normal}
            factors |= {f"{name}.x": self.x, f"{name}.y": self.y}
            factors |= {f"{name}.turn": self._start("angle")}
            factors |= {f"{name}.M": units["force length"][2], f"{name}.T": units["force"][2]}
        return factors | dict.fromkeys(old.controlled.clocks, self.time)

    def _couple(self, name: str) -> tuple[float, float]:
        factor_x = ("X", "Y").index(self.declared.along_guide(name) or "X")
        if self.declared.along_guide(name):
            return self._units["force"][factor_x], self._units["length/time"][factor_x]
        return self._units["force length"][0], self._units["rad/time"][0]

    def _coupling(self, coupling: Coupling) -> Coupling:
        name = next(n for n, one in self.declared.couplings.items() if one is coupling)
        size = abs(self._couple(name)[0])
        limit = coupling.limit
        fields = replace_fields(coupling, limit=0).model_dump(exclude_unset=True)
        fields["enabled"] = tuple(map(self._relation, coupling.enabled))
        if isinstance(limit, StaticKinetic):
            static, kinetic = (self._formula(text, size) for text in coupling.bounds)
            fields["limit"] = {"static": static, "kinetic": kinetic}
        else:
            fields["limit"] = self._formula(limit, size)
        return Coupling(**fields)

    def _start(self, key: str) -> float:
        factors = {"x": self.x, "y": self.y, "angle": math.copysign(1.0, self.x)}
        return factors[key] if key in factors else factors[key[1:]] / self.time

    def _item(self, name: str, key: str, value: Any, unit: str) -> Any:
        """Return a value of a mapping in the new units."""
        if name in _RELATIONS:
            return self._relation(value)
        if name == "start":
            return self._formula(value, self._start(key))
        if unit.startswith("that of"):
            return self._formula(value, 1.0 / self.time if "per time" in unit else 1.0)
        return self._value(name, value, unit)

    def _formula(self, text: FormulaText, factor: float) -> FormulaText:
        if isinstance(text, str):
            text = self._read(parse(text), self._factors)
        return _times(text, factor)

    def _relation(self, text: str) -> str:
        return self._read(parse_relation(text), self._factors)

    @staticmethod
    def _read(formula: Formula | Relation, factors: Mapping[str, float]) -> str:
        """Return the text with every scaled name divided by its factor."""
        sides = [formula] if isinstance(formula, Formula) else formula.formulas
        names = {name.offset: name.name for side in sides for name in names_in(side.root)}
        text = formula.text
        for offset, name in sorted(names.items(), reverse=True):
            factor = factors.get(name, 1.0)
            if factor != 1.0:
                end = offset + len(name)
                text = f"{text[:offset]}({name}/({factor!r})){text[end:]}"
        return text


def _times(text: FormulaText, factor: float) -> FormulaText:
    if factor == 1.0:
        return text
    return text * factor if isinstance(text, int | float) else f"({text})*({factor!r})"


def image_properties(scene: Scene) -> tuple[Property, ...]:
    """Return the properties that relate the runs of a scene and of its images."""
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
            # Solver residuals do not scale with any variable: compare more accurate runs.
            compare(finer.case(case.parameters))

    return Property(name, holds)
