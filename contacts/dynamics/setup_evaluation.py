"""Evaluation of the setup of a run from its parameters: coefficients, scales, tolerances."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
import sympy as sp

from contacts.dynamics.conditions import Conditions
from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.parameters import GAP_OFFSET, MASS_UNIT
from contacts.dynamics.scales import Scales, ScaleTape, mass_unit
from contacts.dynamics.setup import ROUNDING, SHORT, SceneSetup, doubtful, tolerated
from contacts.scene.checks import check_finite, check_physical, physical_limits
from contacts.scene.lint import lint
from contacts.scene.parts import Contact
from contacts.scene.regions import states as states_of
from contacts.solvers.dependence import implied
from contacts.states import implied_joints
from statechart.arrays import Array
from statechart.automaton.regions import StopCondition
from statechart.documents.fields import FormulaText
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse
from statechart.formulas.tape import Tape

_Reader = Callable[[Sequence[float]], ContactLaw]

# A moment of inertia below this part of mass times arm squared cannot be told from zero: the
# forces that turn the body are then differences of terms that many times larger.
POINT_MASS = 1e-12
# Round-off of positions above this part of the length is worth a warning.
FAR = 1e-10
# How far the first flow looks ahead, in the scene's own unit of time.
LOOK_AHEAD = 64.0


class SceneNumbers:
    """Evaluates the numbers of a run from its parameters.

    Attributes
    ----------
    scene : Scene
    parameters : Parameters
        What the values follow from.
    places : mapping
        Parameter -> its place among the values.
    scale_tape : ScaleTape
    conditions : Conditions
    stops, of_forces : collection of str
        Margins of stop conditions; those that have no value before forces are known.
    disjoint : bool
        Whether every stop condition holds as soon as one of its margins falls.
    stop_tape : Tape
        Outputs: their margins.
    inertias : list of (str, int or None)
        Body and the place of its moment of inertia among the values.
    limits : Tape or None
        What is surely physical between `bounds` (2, l); None where that cannot be told so.
    """

    def __init__(self, mechanics: Mechanics, stops: Sequence[StopCondition]) -> None:
        scene = mechanics.scene
        self.scene = scene
        self.parameters = mechanics.parameters
        self._remembered = len(mechanics.memory)
        self.places = {name: i for i, name in enumerate(mechanics.parameters.names)}
        offsets = [self.places.get(f"{name}.{GAP_OFFSET}", -1) for name in mechanics.scene.contacts]
        self.gap_offsets = np.array(offsets, np.int64)
        self.scale_tape = ScaleTape(mechanics)
        self.conditions = Conditions(mechanics)
        self._readers: dict[tuple[str, ...], tuple[_Reader, ...]] = {}
        margins = [margin for stop in stops for margin in stop.margins]
        self.stops = tuple(margin.name for margin in margins)
        self.disjoint = all(stop.condition.disjoint for stop in stops)
        self._single = {stop.name for stop in stops if stop.condition.single}
        forces = mechanics.unknown_forces
        self.of_forces = {
            margin.name for margin in margins if margin.expression.free_symbols.intersection(forces)
        }
        self.stop_tape = mechanics.tape(
            [margin.expression for margin in margins],
            definitions=[*mechanics.controlled(), *((force, sp.S.Zero) for force in forces)],
        )
        rows = mechanics.joint_rows
        self._joint_names = tuple(row.joint for row in rows)
        self._redundant = [self.places[f"{r.joint}.redundant_{r.component.lower()}"] for r in rows]
        self._joint_tape = mechanics.tape(
            [entry for row in rows for entry in row.jacobian],
        )
        self.inertias = [(name, self.places.get(f"{name}.inertia")) for name in scene.bodies]
        self._unlikely = (*lint(scene), *_unpressed(mechanics))
        self.limits: Tape | None = None
        limits = physical_limits(scene)
        if limits is not None:
            # What is a number was checked when it was read.
            varying = [limit for limit in limits if parse(limit[0]).names]
            bounded = [parse(text).to_sympy(mechanics.known) for text, _, _ in varying]
            if not any(expression.has(sp.oo) for expression in bounded):
                self.limits = mechanics.tape(bounded)
                self.bounds = np.array([bounds for _, *bounds in varying]).reshape(-1, 2).T

    def at(self, overrides: Mapping[str, float], relative: float) -> SceneSetup:
        """Return the numbers for `overrides` of the parameters.

        Raises
        ------
        DeclarationProblem, FormulaError
            If a parameter is unknown, or a number has no value or is not physical.
        """
        values, further = self.parameters.values(overrides)
        values, warnings = self._point_masses(values, further[-len(self.inertias) :])
        begins = further[: -len(self.inertias)]
        initial = begins[: len(begins) - self._remembered]
        memory = begins[len(initial) :]
        if overrides and not self._physical(_known(memory, values), initial):
            check_physical(self.scene, self.scene.values(overrides))
        if not all(map(math.isfinite, initial.tolist())):
            check_finite(self.scene, self.scene.values(overrides))
            raise DeclarationProblem("the initial state is not finite", loc=("bodies",))
        values, implied = self._implied(values, initial, memory)
        known = _known(memory, values)
        try:
            scales = self.scale_tape.at(known, initial)
        except DeclarationProblem:
            # It is a formula's fault where one has no finite value.
            check_finite(self.scene, self.scene.values(overrides))
            raise
        if MASS_UNIT in self.places:
            values = values.copy()
            values[self.places[MASS_UNIT]] = mass_unit(scales.acceleration, scales.force)
            known = _known(memory, values)
        margins = self.stop_tape.at(initial, known, 0.0).tolist()
        for name, margin in zip(self.stops, margins, strict=True):
            if math.isnan(margin) and name in self._single - self.of_forces:
                raise DeclarationProblem(
                    "it has no value at the start, so that nobody could watch it",
                    advice="look for a logarithm, a root or a quotient without a value there",
                    loc=("stop", "conditions", name),
                )
        gap, speed, force = tolerated(relative)
        tolerances = {
            "gap": max(gap * scales.length, scales.rounding),
            "speed": speed * scales.speed,
            "force": force * scales.force,
            "plain": 0.0,
        }
        return SceneSetup(
            values=values,
            initial=begins,
            tolerances=tolerances,
            short=SHORT,
            warnings=(*self._unlikely, *warnings, *implied, *_far(scales)),
            sizes=scales.state(memory),
            precision=gap,
            horizon=LOOK_AHEAD * scales.length / scales.speed,
            scales=scales,
            contacts=self.contacts(values),
            capture=doubtful(relative) * scales.speed,
            bands={
                n: ROUNDING * abs(v) if math.isfinite(v) else 0.0
                for n, v in zip(self.stops, margins, strict=True)
            },
        )

    def _physical(self, values: Array, initial: Array) -> bool:
        """Whether masses and the like are surely within their bounds."""
        if self.limits is None:
            return False
        found, (least, most) = self.limits.at(initial, values, 0.0), self.bounds
        return bool(((least <= found) & (found <= most)).all())

    def _point_masses(self, values: Array, levers: Array) -> tuple[Array, tuple[str, ...]]:
        """Set to zero the moments of inertia that cannot be told from it."""
        warnings = []
        for (name, place), lever in zip(self.inertias, levers.tolist(), strict=True):
            if place is not None and 0.0 < values[place] < POINT_MASS * lever:
                warnings.append(
                    f"the inertia of {name!r}, {values[place]:g}, is below {POINT_MASS:g} of its "
                    "mass times arm squared: computed as a point mass"
                )
                values = values.copy()
                values[place] = 0.0
        return values, tuple(warnings)

    def _implied(
        self, values: Array, initial: Array, memory: Array
    ) -> tuple[Array, tuple[str, ...]]:
        """Mark the rows of joints that other rows imply: their forces are not determined."""
        if not self._redundant:
            return values, ()
        rows = self._joint_tape.at(initial, _known(memory, values), 0.0)
        rows = rows.reshape(len(self._redundant), -1)
        found = implied(rows)
        if not found.any():
            return values, ()
        values = values.copy()
        values[self._redundant] = found
        names = [n for n, implied in zip(self._joint_names, found.tolist(), strict=True) if implied]
        return values, (implied_joints(names),)

    def contacts(
        self, values: Array, states: Mapping[str, str] | None = None
    ) -> tuple[ContactLaw, ...]:
        """Return the contacts' laws."""
        states = states or self.scene.controlled.initial
        key = tuple(states.values())
        if key not in self._readers:
            self._readers[key] = tuple(
                self._reader(name, contact, states) for name, contact in self.scene.contacts.items()
            )
        listed = values.tolist()
        return tuple(read(listed) for read in self._readers[key])

    def coefficients(
        self, name: str, contact: Contact, states: Mapping[str, str] | None = None
    ) -> tuple[tuple[int | None, float], ...]:
        """Return where cone_n, cone_t and the restitution of a contact are found.

        Places among the values, and what they are where there is none.
        """
        states = self.scene.controlled.initial if states is None else states
        region_of = self.scene.controlled.region_of

        def place(key: str, text: FormulaText | None) -> int | None:
            region = region_of(text)
            return self.places.get(f"{name}.{key}" + (f".{states[region]}" if region else ""))

        # Without symbols: frictionless (1, 0), or without slide (0, 1), as in `friction_cones`.
        fixed = (1.0, 0.0) if contact.frictionless else (0.0, 1.0)
        n, t = (place(key, contact.friction) for key in ("cone_n", "cone_t"))
        return (n, fixed[0]), (t, fixed[1]), (place("restitution", contact.restitution), 0.0)

    def _reader(self, name: str, contact: Contact, states: Mapping[str, str]) -> _Reader:
        """Return what reads a contact's coefficients off the values of a run."""
        region_states = states_of(contact, gate=self.scene.gate(name))
        found = self.coefficients(name, contact, states)

        def read(values: Sequence[float]) -> ContactLaw:
            n, t, e = [fixed if place is None else values[place] for place, fixed in found]
            return ContactLaw(name, region_states, n, t, e, contact.impact)

        return read


def _far(scales: Scales) -> Iterator[str]:
    """Yield a warning where the scene lies so far from the origin that round-off shows."""
    if scales.rounding > FAR * scales.length:
        yield (
            f"the scene is {scales.length:.3g} in size, and lies so far from the origin that its "
            f"positions are known to {scales.rounding:.2g} only; put the origin nearer"
        )


def _known(memory: Array, values: Array) -> Array:
    """Return what controllers remember with the parameters, as tapes of a scene take them."""
    return np.concatenate([memory, values]) if len(memory) else values


def _unpressed(mechanics: Mechanics) -> Iterator[str]:
    """Yield of contacts that no coordinate moves along their normals: no motion tells their forces.

    With events what they hold is held by the smallest forces that do, by steps by none.
    """
    names = [
        name
        for name, contact in mechanics.scene.contacts.items()
        if not contact.frictionless and not any(mechanics.contact(name).jacobian_n)
    ]
    if names:
        yield (
            f"no coordinate moves {', '.join(names)} along the normal of what is touched: how hard "
            "that presses does not follow from the motion, and neither does its friction; let the "
            "body move that way, too"
        )
