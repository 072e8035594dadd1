"""Automaton and time stepper of free bodies that collide by their shapes.

Each body is a region of the trace: free, sliding or pinned. Equations of motion are not composed:
gravity, forces and contact impulses move the bodies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import get_args

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers
from contacts.collision_detection.couplings import ENABLED
from contacts.collision_detection.surfaces import GRAPH, LINE, PLATE
from contacts.dynamics.conditions import undecided_couplings
from contacts.dynamics.contact_law import coupling_law
from contacts.dynamics.controllers import Controllers, controller
from contacts.dynamics.parameters import with_sizes
from contacts.dynamics.scales import Scales, VariableSizes, check_range
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.starting import check_limits
from contacts.rigid_bodies.body_step import StepOptions
from contacts.rigid_bodies.declared_numbers import (
    body_names,
    body_numbers,
    closed_joints,
    implied_remarks,
    led_parts,
    link_numbers,
    rotated,
    touchable_surfaces,
)
from contacts.rigid_bodies.default_step import default_step, forced_speed, led_speed
from contacts.rigid_bodies.initial_penetration import check_containers, check_penetration
from contacts.rigid_bodies.mechanics import BodyMechanics
from contacts.rigid_bodies.prescribed_motion import Paths, PrescribedMotion
from contacts.rigid_bodies.rigid_body_run import DetectedContacts, RigidBodyRun
from contacts.scene.checks import physical_checks
from contacts.scene.expansion import start_problem
from contacts.scene.lint import angles_in_degrees, lint
from contacts.scene.parts import Simultaneous
from contacts.scene.regions import BODY_EDGES, BODY_IMPACT, BODY_STATES
from contacts.scene.scene import Scene
from contacts.states import FREE, superstates_of
from contacts.time_stepping.step_rejection import DEEPEST
from contacts.time_stepping.stepper import RELATIVE, RunInputs, Stepper
from statechart.arrays import EPS, Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.clock import Clock
from statechart.automaton.regions import Region, State, stop_conditions
from statechart.automaton.time_stepper import DEFAULT_IMPULSES
from statechart.documents.fields import check_all
from statechart.errors import DeclarationProblem, NonFinite, StepTooLarge
from statechart.formulas.formula import parse

# Largest length of a scene, relative to its extent; coordinates exceed it far from the origin.
_MAX_LENGTH = 10.0
# Duration of a step that shows a state, relative to the scene's.
_SOON = 1e-9
# Overlap at the start, relative to the scene, without a warning; and opening of joints.
_START_DEPTH = 1e-6
# Round-off of the inertia of a motion, relative to the diagonal.
_NO_INERTIA = 1e-13


def bodies_automaton(scene: Scene) -> Automaton:
    """Return the automaton of a scene with collisions: regions and stepper."""
    declared, mechanics = scene, BodyMechanics(scene.expanded)
    scene, superstates = mechanics.scene, superstates_of(BODY_STATES)
    observables = mechanics.observables
    stops = stop_conditions(scene.stop.conditions, observables)
    of_bodies = (
        Region(
            name,
            BODY_STATES,
            lambda state: State(),
            BODY_EDGES,
            superstates,
            impact_cause=BODY_IMPACT,
            default="free",
        )
        for name in declared.moving()
    )
    of_couplings = (
        scene.contact_region(name, lambda role: State(), (mechanics.couples[name],))
        for name in scene.couplings
    )
    controllers = scene.controlled.flat
    regions = (
        *of_bodies,
        *of_couplings,
        *(controller(n, r, mechanics) for n, r in controllers.items()),
    )
    rates = mechanics.controller_rates

    def stepper() -> BodyStepper:
        return BodyStepper(declared, mechanics, regions)

    return Automaton(
        name=scene.name,
        declaration=scene,
        names=mechanics.state_names,
        variables=mechanics.state,
        parameter_names=mechanics.parameters.names,
        parameters=mechanics.parameters.ordered,
        time=mechanics.time,
        unknowns=(*mechanics.a, *mechanics.unknown_forces),
        rates=(*mechanics.v, *mechanics.a, *rates.values()),
        equations=(),
        regions=regions,
        stops=stops,
        observables=observables,
        setup=lambda overrides, _: stepper().setup(overrides),
        laws=None,
        controls=mechanics.controls,
        stepper=stepper,
        default_step=lambda: stepper().default_step(),
    )


def extent(bodies: BodyNumbers, placed: Array, paths: Paths) -> float:
    """Return the extent of a scene: its bodies, surfaces and anchors; infinite with a graph.

    `placed` (b, 3): the poses of all bodies. An endless line counts where it is nearest to moving
    ones, a guide (`to: {x: f}`) by its anchor. Surfaces on moving bodies do not count.
    """
    surfaces, moving = bodies.surfaces, len(bodies.inverse)
    places, first = placed[:moving, :2], moving + paths.bodies
    found = [places, placed[moving:first, :2], placed[first + paths.surfaces :, :2]]
    frames = np.concatenate([placed, np.zeros((1, 3))])[surfaces.carriers]
    points = frames[:, None, :2] + rotated(frames[:, None, 2], surfaces.numbers.reshape(-1, 2, 2))
    for kind, carrier, (one, other), frame, numbers in zip(
        surfaces.kinds, surfaces.carriers, points, frames, surfaces.numbers, strict=True
    ):
        if kind == GRAPH:
            return math.inf
        if 0 <= carrier < moving:
            continue
        if kind == LINE:
            normal = other - frame[:2]
            found.append(places - ((places - one) @ normal)[:, None] * normal)
        elif kind == PLATE:
            found.append(np.stack([one, other]))
        else:
            found.append(one + numbers[2] * np.array([[-1.0, -1.0], [1.0, 1.0]]))
    return float(np.hypot(*np.ptp(np.concatenate(found), axis=0)))


class BodyStepper(Stepper):
    """Steps colliding bodies; see `Stepper`."""

    def __init__(
        self,
        declared: Scene,
        mechanics: BodyMechanics,
        regions: tuple[Region, ...],
    ) -> None:
        collisions = declared.collisions.values()
        rolls = any(collision.rolling_resistance is not None for collision in collisions)
        resisted = [f"{body}_rolling" for body in declared.moving()] if rolls else []
        super().__init__(
            mechanics,
            regions,
            Controllers(mechanics),
            again=BODY_IMPACT,
            forces=None,
            sticks=np.repeat([False, True], [len(declared.moving()), len(declared.couplings)]),
            turning=resisted,
        )
        self._resisted = len(resisted)
        self._declared, self._bodies = declared, mechanics
        self._paths = Paths(mechanics)
        self._constants = declared.constants()
        self._variable_sizes = VariableSizes(mechanics)
        self._owners = dict(zip(mechanics.scene.bodies, mechanics.owners, strict=True))
        self._names = body_names(mechanics.scene, mechanics.scene.owners())
        self._surfaces = touchable_surfaces(mechanics.scene)
        self._warnings = (*lint(declared), *undecided_couplings(mechanics))

    def default_step(self) -> float:
        """Return the default step size at the declared parameters; see `default_step`."""
        setup, bodies = self._new_run({}, DEFAULT_IMPULSES.tolerance, False)
        controlled, end = self._scene.controlled, self._scene.stop.time
        each = [controlled.initial]
        for name, region in controlled.flat.items():
            each += [{**controlled.initial, name: state} for state in region.states]
        known = self._constants.values({})
        until = math.inf if end is None else parse(end).value(known)
        forced = forced_speed(
            [self._bodies.at(states).forces(setup.values) for states in each],
            bodies.numbers,
            setup.initial,
            until,
            setup.scales.length,
        )
        remembered = setup.initial[len(self._mechanics.variables) :]
        led = led_speed(self._paths, bodies.numbers, setup.values, remembered, until)
        return default_step(bodies.numbers, setup.scales, max(forced, led))

    def setup(self, overrides: Mapping[str, float]) -> SceneSetup:
        """Return the setup of a run.

        Raises `DeclarationProblem` if no run can start there.
        """
        return self._new_run(overrides, DEFAULT_IMPULSES.tolerance, False)[0]

    def _begin(
        self, overrides: Mapping[str, float], step: float, tolerance: float, forces: bool
    ) -> RunInputs:
        setup, bodies = self._new_run(overrides, tolerance, forces, step)
        size, fall = setup.scales.length, math.hypot(*bodies.numbers.gravity) * step**2
        failure = None
        if fall > DEEPEST * size:
            # All bodies would be near all others.
            longest = 0.1 * math.sqrt(DEEPEST * size / fall) * step
            failure = StepTooLarge(
                f"bodies fall by {fall:.3g} in one step of {step:g}, in a scene of size "
                f"{size:.3g}; take {longest:.1g} or less"
            )
        free = np.full(len(bodies.numbers.inverse), FREE)
        if self._scene.couplings:
            soon = _SOON * setup.scales.length / setup.scales.speed
            free = np.append(free, bodies.detect(setup.initial, 0.0, soon).couplings)
        warnings = self._replaced_laws(setup)
        unknown = np.full(len(self._mechanics.solved), np.nan)
        return RunInputs(setup, bodies, free, warnings, self.controls, unknown, failure)

    def _new_run(
        self, overrides: Mapping[str, float], tolerance: float, forces: bool, step: float = 0.0
    ) -> tuple[SceneSetup, RigidBodyRun]:
        values, remembered = self._mechanics.parameters.values(overrides)
        known = self._constants.values(overrides)
        expanded = self._declared.expanded
        if overrides:
            check_all(physical_checks(expanded), known)
        placed = self._bodies.starts.at(values, known)
        links = link_numbers(self._bodies.linked, known)
        bodies = body_numbers(expanded, known, self._owners, links)
        self._check_inertia(bodies, placed)
        setup = self._setup(values, placed, remembered, bodies)
        defaults = StepOptions(get_args(Simultaneous).index(self._scene.simultaneous))

        def run_of(
            bodies: BodyNumbers, options: StepOptions = defaults, start_depth: float = 0.0
        ) -> RigidBodyRun:
            prescribed = PrescribedMotion(self._bodies, self._paths, setup.values)
            names, surfaces = self._names, self._surfaces
            return RigidBodyRun(
                names, surfaces, bodies, prescribed, options, start_depth, step, self._resisted
            )

        if self._scene.couplings:
            tape = self._bodies.at(self._scene.controlled.initial).limits
            bounds = tape.table(setup.initial[None], setup.values, np.zeros(1)).reshape(-1, 3)
            check_limits([coupling_law(n, ()) for n in self._scene.couplings], bounds[:, :ENABLED])
        bodies, depth, remarks = self._started(setup, bodies, known, run_of)
        setup = replace(setup, start_depth=depth, warnings=(*setup.warnings, *remarks))
        options = StepOptions(defaults.law, forces, tolerance, DEEPEST * setup.scales.length)
        return setup, run_of(bodies, options, depth)

    def _check_inertia(self, bodies: BodyNumbers, placed: Array) -> None:
        """Check that every motion of the coordinates has inertia at the start."""
        if not bodies.links.bodies:
            return
        mass = bodies.inertia(placed[None])[0][0]
        root = np.sqrt(np.maximum(np.diag(mass), np.finfo(float).tiny))
        sizes, shapes = np.linalg.eigh(mass / root / root[:, None])
        if not sizes[0] > _NO_INERTIA:
            name = list(self._declared.coordinates)[int(np.argmax(np.abs(shapes[:, 0])))]
            raise DeclarationProblem(
                "it has no inertia at the start, or its motion combines those of other coordinates",
                advice="let it move a body that has a mass or an inertia there",
                loc=("coordinates", name),
            )

    def _setup(
        self, values: Array, placed: Array, remembered: Array, bodies: BodyNumbers
    ) -> SceneSetup:
        """Return the setup of a run, in scales of the initial positions and sizes."""
        largest = int(np.argmax(bodies.sizes))
        owner = self._owners[self._names[largest]]
        check_range(float(bodies.sizes[largest]), "its size", ("bodies", owner, "shape"))
        for number in bodies.gravity.tolist():
            check_range(number, "", ("gravity",))
        own = bodies.sizes[: len(bodies.inverse)]
        poses, rates = bodies.motion(placed[None])
        reach = length = float(np.abs(poses[..., :2]).max() + own.max())
        every = bodies.poses(placed[None], self._paths.at(values, np.zeros(1), remembered[None]))[0]
        # A path without a value at the start is refused later.
        with np.errstate(invalid="ignore"):
            within = float(extent(bodies, every, self._paths) + own.max())
        if within > 0.0:
            length = min(length, _MAX_LENGTH * within)
        speed = math.sqrt(math.hypot(*bodies.gravity) * length)
        speed = max(speed, float(np.abs(rates).max())) or 1.0
        initial = np.concatenate([placed, remembered])
        places = np.append(
            np.tile([length, length, 1.0], bodies.free), length / bodies.levers(placed)
        )
        sizes = np.concatenate([places, places * (speed / length)])
        acceleration = speed**2 / length
        force = float((1.0 / bodies.inverse[:, 0]).sum()) * acceleration
        scales = Scales(length, speed, acceleration, force, EPS * reach, sizes)
        at = {name: i for i, name in enumerate(self._bodies.parameters.names)}
        return SceneSetup(
            values=with_sizes(values, at, sizes),
            initial=initial,
            tolerances={"gap": RELATIVE * length, "speed": RELATIVE * speed,
                        "force": 0.0, "plain": 0.0},
            scales=scales,
            contacts=(),
            simultaneous=self._scene.simultaneous,
            paradox=self._scene.paradox,
            capture=0.0,
            bands={},
            sizes=self._variable_sizes.at(scales, values, initial),
            warnings=(
                *self._warnings,
                *implied_remarks(self._scene, bodies, every),
            ),
            rounded=RELATIVE,
        )  # fmt: skip

    def _started(
        self,
        setup: SceneSetup,
        bodies: BodyNumbers,
        known: Mapping[str, float],
        run_of: Callable[[BodyNumbers], RigidBodyRun],
    ) -> tuple[BodyNumbers, float, tuple[str, ...]]:
        """Check that bodies start with closed joints, and apart.

        Returns the bodies with joints closed to round-off, their largest depth, and a warning of
        it.
        """
        scene, owners = self._scene, self._bodies.owners
        enter = self._controllers.enter_initial_states
        initial = enter(setup, Clock(), setup.initial, self.controls)
        placed, remembered = np.split(initial, [2 * bodies.size])
        run_of(bodies).capture(remembered)
        length, speed = setup.scales.length, setup.scales.speed
        soon = 1e-6 * length / speed
        led = self._paths.at(setup.values, soon * np.arange(3.0), np.tile(remembered, (3, 1)))
        paths = (("bodies", "position", "angle"), ("surfaces", "displacement", "turn"),
                 ("joints", "to", "to"))  # fmt: skip
        places = iter(led[0])
        for names, (part, place, angle) in zip(led_parts(scene), paths, strict=True):
            for name, pose in zip(names, places, strict=False):
                if not np.isfinite(pose).all():
                    raise DeclarationProblem(
                        "has no value at the start, or an infinite one",
                        loc=(part, self._owners.get(name, name),
                             place if np.isfinite(pose[2]) else angle),
                    )  # fmt: skip
        # One-sided differences of second order: a path need not exist before the start.
        moved = led[1:] - led[0]
        rates = (2.0 * moved[0] - 0.5 * moved[1]) / soon
        slow = _START_DEPTH * speed + 2.5 * setup.scales.rounding / soon
        try:
            every = bodies.moved(placed, np.stack([led[0], rates]))
            joints = closed_joints(scene, bodies.joints, every, _START_DEPTH * length, slow)
        except DeclarationProblem as problem:
            problem.advice = next(angles_in_degrees(self._declared), problem.advice)
            raise start_problem(scene, problem, known) from None
        bodies = bodies._replace(joints=joints)
        check_containers(bodies, self._names, self._surfaces, owners, every[0])

        def detect(numbers: BodyNumbers, start: Array) -> DetectedContacts:
            return run_of(numbers).detect(start, 0.0, _SOON * length / speed)

        near = _START_DEPTH * length
        try:
            depth_and_warning = check_penetration(
                detect, bodies, self._names, self._surfaces, owners, initial, near
            )
        except NonFinite as error:
            raise DeclarationProblem(f"{error.message} at the start", loc=("forces",)) from None
        return bodies, *depth_and_warning
