"""Evaluation of the setup of a run from its parameters: coefficients, scales, tolerances.

The kernel `run_numbers` is the batched version.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import compress
from typing import NamedTuple

import numpy as np
import sympy as sp
from numpy.typing import NDArray
from sympy.utilities.iterables import connected_components

from contacts.dynamics.conditions import Conditions, undecided_couplings
from contacts.dynamics.contact_law import ContactLaw, coupling_law, touching_pairs
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.parameters import GAP_OFFSET, LEVER, MASS_UNIT, with_sizes
from contacts.dynamics.scales import Scales, ScaleTape, VariableSizes, horizon, mass_unit, measure
from contacts.dynamics.setup import (
    FORCE_BAND,
    ROUNDING,
    SHORT,
    SceneSetup,
    force_uncertainty,
    tolerated,
    write_tolerances,
)
from contacts.scene.checks import finite_checks, limits, physical_checks
from contacts.scene.couplings import Rolling, coupling_states
from contacts.scene.lint import lint
from contacts.scene.regions import states as states_of
from contacts.scene.scene import Scene
from contacts.solvers.dependence import dependent_rows
from contacts.states import implied_joints
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.automaton.regions import StopCondition
from statechart.documents.fields import FormulaText, check_all
from statechart.engines.compiled_flow import KINDS, ModeTable, tape_of
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse
from statechart.formulas.tape import Tape
from statechart.kernels.jets import tape_ranges
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import tape_values

# A moment of inertia below this part of mass times arm squared is set to zero: the torques are then
# differences of terms larger by the inverse factor.
POINT_MASS = 1e-12
# Round-off of positions, relative to the length, above which there is a warning: with one bouncing
# contact, and with several, where the order of impacts depends on the gaps of the others.
FAR, FAR_IN_TURN = 1e-10, 1e-12
# Least share of a body in the mass of the scene without a warning that its events are late.
_MIN_SHARE = 1e-6
# First horizon of a run, in the scene's unit of time.
LOOK_AHEAD = 64.0


class SceneNumbers:
    """Evaluates the setup of a run from its parameters."""

    def __init__(self, mechanics: Mechanics, stops: Sequence[StopCondition]) -> None:
        scene = mechanics.scene
        self.scene, self._mechanics = scene, mechanics
        self.parameters = mechanics.parameters
        # Parameter -> its index among the values.
        self.places = {name: i for i, name in enumerate(mechanics.parameters.names)}
        offsets = [self.places.get(f"{name}.{GAP_OFFSET}", -1) for name in mechanics.scene.contacts]
        self.gap_offsets = np.array(offsets, np.int64)
        self.scale_tape = ScaleTape(mechanics)
        self._variable_sizes = VariableSizes(mechanics)
        laws = [parse(c.restitution or "0") for c in mechanics.scene.contacts.values()]
        bouncing = sum(bool(law.names) or law.to_sympy({}) != 0 for law in laws)
        self.far = FAR if bouncing < 2 else FAR_IN_TURN
        self.conditions = Conditions(mechanics)
        self._coefficients: dict[tuple[str, ...], tuple[Ints, Array]] = {}
        self._pairs = touching_pairs(self.scene)[: len(self.scene.contacts)].tolist()
        self._region_states = {
            name: states_of(contact, gate=scene.gate(name))
            for name, contact in scene.contacts.items()
        } | {name: coupling_states(one) for name, one in scene.couplings.items()}
        margins = [margin for stop in stops for margin in stop.margins]
        self.stops = tuple(margin.name for margin in margins)
        # True if every stop condition holds as soon as one of its margins falls.
        self.disjoint = all(stop.condition.disjoint for stop in stops)
        self._single = {stop.name for stop in stops if stop.condition.single}
        forces = mechanics.unknown_forces
        # Margins that have no value before forces are known.
        self.of_forces = {m.name for m in margins if m.expression.free_symbols & {*forces}}
        self.stop_tape = mechanics.tape(
            [margin.expression for margin in margins],
            definitions=[*mechanics.controlled(), *((force, sp.S.Zero) for force in forces)],
        )
        rows = [row for row in mechanics.joint_rows if row.closed is None]
        self._joint_names = tuple(row.joint for row in rows)
        self._redundant = [self.places[f"{r.joint}.redundant_{r.component.lower()}"] for r in rows]
        # Entries of the joint rows, and their rows and columns; groups of rows without a common
        # coordinate.
        self._joint_tape = mechanics.tape([e for row in rows for e in row.jacobian.values()])
        entries = [(k, ~i) for k, row in enumerate(rows) for i in row.jacobian]
        self._entries = np.array(entries, np.int64).reshape(-1, 2)
        vertices = [*range(len(rows)), *{column for _, column in entries}]
        groups = connected_components((vertices, entries))
        self._groups = [sorted(k for k in group if k >= 0) for group in groups]
        # Bodies, and the indices of their moments of inertia among the values.
        self.inertias = [(name, self.places.get(f"{name}.inertia")) for name in scene.bodies]
        self.lint = (*lint(scene), *_unpressed(mechanics), *undecided_couplings(mechanics))
        masses = {n: sp.Abs(mechanics.formula(body.mass)) for n, body in scene.bodies.items()}
        # Their shares in the mass of all bodies.
        self._unloaded = _unloaded_bodies(scene)
        total = sp.Add(*masses.values())
        shares = [masses[name] / total for name in self._unloaded]
        self._shares = mechanics.tape(shares)
        # Quantities with limits `bounds` (2, l), physical ones and shares of light bodies; None if
        # controllers set some of them.
        self.limits: Tape | None = None
        self.bounds = np.empty((2, 0))
        # Constants are checked when the scene is read.
        varying = [limit for limit in limits(scene) if parse(limit.text).names]
        if all(scene.controlled.region_of(limit.text) is None for limit in varying):
            bounded = [
                mechanics.formula(limit.text, **{n: sp.Float(s) for n, s in limit.at.items()})
                for limit in varying
            ]
            if not any(expression.has(sp.oo) for expression in bounded):
                # A share below its limit gives a warning.
                ranges = [(limit.least, limit.most) for limit in varying]
                ranges += [(_MIN_SHARE, math.inf)] * len(shares)
                self.limits = mechanics.tape([*bounded, *shares])
                self.bounds = np.array(ranges).reshape(-1, 2).T

    @property
    def compiled(self) -> bool:
        """True if `run_numbers` computes the setup of its runs."""
        return self.limits is not None and MASS_UNIT not in self.places

    def at(
        self, overrides: Mapping[str, float], relative: float, *, stepped: bool = False
    ) -> SceneSetup:
        """Return the numbers for `overrides` of the parameters.

        By steps, relations use the sizes of coordinates and rates, which are then parameters.
        Raises `DeclarationProblem` or `FormulaError` if a parameter is unknown, or a number has no
        value or is not physical.
        """
        values, further = self.parameters.values(overrides)
        values, warnings = self._point_masses(values, further[-len(self.inertias) :])
        initial = further[: -len(self.inertias)]
        if overrides and not self._physical(values, initial):
            check_all(physical_checks(self.scene), self.scene.values(overrides))
        if not all(map(math.isfinite, initial[: self.scale_tape.size].tolist())):
            check_all(finite_checks(self.scene), self.scene.values(overrides))
            raise DeclarationProblem("the initial state is not finite", loc=("bodies",))
        values, implied = self._implied(values, initial)
        try:
            scales = self.scale_tape.at(values, initial)
        except DeclarationProblem:
            # Blame a formula that has no finite value first.
            check_all(finite_checks(self.scene), self.scene.values(overrides))
            raise
        values = values.copy()
        if LEVER in self.places:
            values[self.places[LEVER]] = scales.lever
        if MASS_UNIT in self.places:
            values[self.places[MASS_UNIT]] = mass_unit(scales.acceleration, scales.force)
        if stepped:
            values = with_sizes(values, self.places, scales.sizes)
        margins = self.stop_tape.at(initial, values, 0.0).tolist()
        for name, margin in zip(self.stops, margins, strict=True):
            if math.isnan(margin) and name in self._single - self.of_forces:
                raise DeclarationProblem(
                    "it has no value at the start",
                    advice="look for a logarithm, a root or a quotient without a value there",
                    loc=("stop", "conditions", name),
                )
        gap, speed = tolerated(relative)
        tolerances = np.empty(len(KINDS))
        write_tolerances(gap, speed, scales.numbers, tolerances)
        contacts = self.contacts(values)
        shares = zip(self._unloaded, self._shares.at(initial, values, 0.0).tolist(), strict=True)
        light = {name: share for name, share in shares if 0.0 < share < _MIN_SHARE}
        if light and not stepped:
            allowed = np.array([gap * scales.length, speed * scales.speed])
            starts = self._approaches.at(initial, values, 0.0).reshape(-1, 2)
            rests: Bools = np.all(np.abs(starts) <= allowed, axis=1)
            laws = zip(self.scene.contacts.values(), contacts, rests.tolist(), strict=False)
            # A body that only rebounds has no lasting contact force.
            lasting = {c.point.body for c, law, at_rest in laws if at_rest or law.restitution != 1}
            warnings += (*_light(light, lasting),)
        return SceneSetup(
            values=values,
            initial=initial,
            tolerances=dict(zip(KINDS, tolerances.tolist(), strict=True)),
            short=SHORT,
            warnings=(*self.lint, *warnings, *implied, *_far(scales, self.far)),
            sizes=self._variable_sizes.at(scales, values, initial),
            precision=gap,
            horizon=LOOK_AHEAD * scales.length / scales.speed,
            scales=scales,
            contacts=contacts,
            simultaneous=self.scene.simultaneous,
            paradox=self.scene.paradox,
            capture=force_uncertainty(relative) * scales.speed,
            coordinates=self.scene.variables,
            bands={
                n: ROUNDING * abs(v) if math.isfinite(v) else 0.0
                for n, v in zip(self.stops, margins, strict=True)
            },
        )

    @cached_property
    def _approaches(self) -> Tape:
        """The gap and the gap rate of every contact."""
        contacts = map(self._mechanics.contact, self.scene.contacts)
        return self._mechanics.tape([e for one in contacts for e in (one.gap, one.gap_rate)])

    def _physical(self, values: Array, initial: Array) -> bool:
        """Return whether masses and other limited quantities are certainly within their limits."""
        if self.limits is None:
            return False
        limits, (lower, upper) = self.limits.at(initial, values, 0.0), self.bounds
        return bool(((lower <= limits) & (limits <= upper)).all())

    def _point_masses(self, values: Array, levers: Array) -> tuple[Array, tuple[str, ...]]:
        """Set negligible moments of inertia to zero, with a warning for each."""
        warnings, values = list[str](), values.copy()
        for (name, place), lever in zip(self.inertias, levers.tolist(), strict=True):
            if place is not None and 0.0 < values[place] < POINT_MASS * lever:
                warnings.append(
                    f"body {name!r} is run as a point mass: its inertia, {values[place]:g}, is "
                    f"below {POINT_MASS:g} of its mass times arm squared"
                )
                values[place] = 0.0
        return values, tuple(warnings)

    def _implied(self, values: Array, initial: Array) -> tuple[Array, tuple[str, ...]]:
        """Mark redundant joint rows, whose forces are not determined."""
        if not self._redundant:
            return values, ()
        redundant = np.zeros(len(self._redundant), np.bool_)
        jacobian = np.zeros((len(redundant), len(self._mechanics.q)))
        rows, columns = self._entries.T
        jacobian[rows, ~columns] = self._joint_tape.at(initial, values, 0.0)
        for group in self._groups:
            moved = jacobian[group].any(axis=0)
            redundant[group] = dependent_rows(jacobian[np.ix_(group, moved)])
        if not redundant.any():
            return values, ()
        values = values.copy()
        values[self._redundant] = redundant
        return values, (implied_joints(compress(self._joint_names, redundant)),)

    def contacts(
        self, values: Array, states: Mapping[str, str] | None = None
    ) -> tuple[ContactLaw, ...]:
        """Return the contacts' laws."""
        places, fixed = self.coefficients(states)
        coefficients = np.where(places >= 0, values[places], fixed).tolist()
        contacts = [*self.scene.contacts]
        declared = zip(self.scene.contacts.items(), coefficients, self._pairs, strict=True)
        laws = [
            ContactLaw(name, self._region_states[name], n, t, e, one.impact, pair=pair)
            for (name, one), (n, t, e), pair in declared
        ]
        for name, one in self.scene.couplings.items():
            carrier = contacts.index(one.contact) if isinstance(one, Rolling) else -1
            lever = 1.0 if self.scene.along_guide(name) else float(values[self.places[LEVER]])
            laws.append(coupling_law(name, self._region_states[name], carrier, lever))
        return tuple(laws)

    def coefficients(self, states: Mapping[str, str] | None = None) -> tuple[Ints, Array]:
        """Return the indices (c, 3) of cone_n, cone_t and restitution among the values of a run.

        The second array (c, 3) has the constants to use where the index is -1.
        """
        states = states or self.scene.controlled.initial
        key = tuple(states.values())
        if key not in self._coefficients:
            region_of = self.scene.controlled.region_of

            def place(name: str, key: str, text: FormulaText | None) -> int:
                region = region_of(text)
                name = f"{name}.{key}" + (f".{states[region]}" if region else "")
                return self.places.get(name, -1)

            # Without symbols: smooth (1, 0), or unable to slip (0, 1), as in `friction_cones`.
            places, fixed = [], []
            for name, contact in self.scene.contacts.items():
                law = self.scene.friction_of(name)
                cone = [place(name, key, law and law.both) for key in ("cone_n", "cone_t")]
                places.append([*cone, place(name, "restitution", contact.restitution)])
                fixed.append((1.0, 0.0, 0.0) if contact.frictionless else (0.0, 1.0, 0.0))
            self._coefficients[key] = (
                np.array(places, np.int64).reshape(-1, 3), np.array(fixed, float).reshape(-1, 3)
            )  # fmt: skip
        return self._coefficients[key]


def _far(scales: Scales, limit: float) -> Iterator[str]:
    """Yield a warning if the scene is too far from the origin for the precision of positions."""
    if scales.rounding > limit * scales.length:
        yield (
            f"the scene is {scales.length:.3g} in size, and so far from the origin that "
            f"round-off of positions is {scales.rounding:.2g}; put the origin nearer"
        )


def _unloaded_bodies(scene: Scene) -> list[str]:
    """Return the free bodies with contacts that carry no other by a surface or joint."""
    touching = {contact.point.body for contact in scene.contacts.values()}
    carrying = {surface.body for surface in scene.surfaces.values()}
    for joint in scene.joints.values():
        carrying |= {joint.point.body, getattr(joint.to, "body", None)}
    free = (name for name, body in scene.bodies.items() if body.position is None)
    return [name for name in free if name in touching and name not in carrying]


def _light(shares: Mapping[str, float], lasting: Collection[str]) -> list[str]:
    """Return a warning for each `lasting` body whose events the tolerance of forces delays."""
    return [
        f"contacts of body {name!r} change their modes late, by up to {FORCE_BAND / share:.1g} of "
        "its weight, beside the heavy bodies of the scene; put it into another scene, or take "
        "engine: impulse"
        for name, share in shares.items()
        if name in lasting
    ]


def _unpressed(mechanics: Mechanics) -> Iterator[str]:
    """Yield a warning about contacts that no coordinate moves along their normals.

    Their normal forces are undetermined: runs with events use the smallest, steps use zero.
    """
    rough = (name for name, one in mechanics.scene.contacts.items() if not one.frictionless)
    if names := [name for name in rough if not mechanics.contact(name).jacobian_n]:
        yield (
            f"no coordinate moves {', '.join(names)} along the normal of its surface, so that "
            "normal force and friction are undetermined; let the body move that way, too"
        )


LIMITS, SCALES, MOTIONS, STOPS = range(4)
"""Indices of the tapes of `run_numbers`."""


class SetupRules(NamedTuple):
    """Indices and limits by which `run_numbers` computes the setup of a run."""

    # (b,): Index of every body's moment of inertia among the values; -1 if it has none
    inertias: Ints
    # `lower`, `upper`: (l,): Limits of physical quantities
    lower: Array
    upper: Array
    begins: Ints  # (g + 1,)
    # `places`, `gravity`, `paths`: See `contacts.dynamics.scales.ScaleTape`
    places: int
    gravity: int
    paths: int
    forced: Bools  # (s,): Stop conditions that have no value before forces are known
    far: float  # Round-off of positions that warns, relative to the length
    lever: int  # Index of the lever of couplings among the values; -1: none


class Numbers(NamedTuple):
    """Setup of a run in arrays."""

    values: Array  # (p,): Of the parameters
    initial: Array  # (n,): State
    # `scales`, `sizes`: (6,), (n,): See `contacts.dynamics.scales.Scales`
    scales: Array
    sizes: Array
    bands: Array  # (s,): Tolerances of the stop conditions


def setup_rules(numbers: SceneNumbers) -> SetupRules:
    """Return the rules of a scene."""
    return SetupRules(
        np.array([-1 if place is None else place for _, place in numbers.inertias], np.int64),
        np.ascontiguousarray(numbers.bounds[0]),
        np.ascontiguousarray(numbers.bounds[1]),
        numbers.scale_tape.begins,
        numbers.scale_tape.places,
        numbers.scale_tape.gravity,
        numbers.scale_tape.paths,
        np.array([name in numbers.of_forces for name in numbers.stops], np.bool_),
        numbers.far,
        numbers.places.get(LEVER, -1),
    )


def run_buffer(parameters: int, variables: int, rules: SetupRules) -> Numbers:
    """Allocate the setup of a run."""
    return Numbers(
        np.empty(parameters),
        np.empty(variables),
        np.empty(6),
        np.empty(variables),
        np.empty(len(rules.forced)),
    )


@kernel
def run_numbers(
    program: ModeTable,
    tapes: NDArray[np.int64],
    rules: SetupRules,
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    inputs: Array,
    run: Numbers,
) -> bool:
    """Compute the setup of a run; False if it needs an error message or a warning.

    The program holds the `tapes` (4, 9) of limits, scales, motions and stops; `code`, `constants`
    and `outputs` are the tape of parameters, initial state and levers of bodies, with `inputs`
    (i,). Fills `run`.
    """
    values, initial, bodies = run.values, run.initial, rules.inertias.shape[0]
    initial_outputs = np.empty(outputs.shape[0])
    tape_values(code, constants, outputs, np.empty(0), inputs, 0.0, initial_outputs)
    p, n = values.shape[0], initial.shape[0]
    for i in range(p):
        values[i] = initial_outputs[i]
        if values[i] != values[i]:
            return False
    for i in range(n):
        initial[i] = initial_outputs[p + i]
        if not abs(initial[i]) < math.inf:
            return False
    for b in range(bodies):
        lever, place = initial_outputs[p + n + b], rules.inertias[b]
        if lever != lever:
            return False
        if place >= 0 and 0.0 < values[place] < POINT_MASS * lever:
            return False
    code, constants, outputs, _, _ = tape_of(program, tapes[LIMITS])
    limits = np.empty(outputs.shape[0])
    tape_values(code, constants, outputs, initial, values, 0.0, limits)
    for i in range(limits.shape[0]):
        if not rules.lower[i] <= limits[i] <= rules.upper[i]:
            return False
    code, constants, outputs, _, _ = tape_of(program, tapes[SCALES])
    numbers = np.empty(outputs.shape[0])
    tape_values(code, constants, outputs, initial, values, 0.0, numbers)
    duration = horizon(numbers, rules.begins)
    code, constants, outputs, _, _ = tape_of(program, tapes[MOTIONS])
    ranges = np.empty((outputs.shape[0], 2))
    tape_ranges(code, constants, outputs, initial, values, duration, ranges)
    if not measure(
        numbers, rules.begins, rules.places, rules.gravity, rules.paths, ranges, run.scales,
        run.sizes,
    ):  # fmt: skip
        return False
    if run.scales[4] > rules.far * run.scales[0]:
        return False
    if rules.lever >= 0:
        values[rules.lever] = run.scales[5]
    code, constants, outputs, _, _ = tape_of(program, tapes[STOPS])
    bands = run.bands
    tape_values(code, constants, outputs, initial, values, 0.0, bands)
    for i in range(bands.shape[0]):
        if bands[i] != bands[i] and not rules.forced[i]:
            return False
        bands[i] = ROUNDING * abs(bands[i]) if abs(bands[i]) < math.inf else 0.0
    return True
