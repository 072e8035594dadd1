"""The document kind `scene`: from the declaration to the automaton."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, get_args

import numpy as np
from pydantic import BaseModel

from contacts.parts import Simultaneous
from contacts.scene import Scene
from statechart.automaton import Automaton
from statechart.kinds import Kind

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from contacts.modes import ContactSymbols
    from statechart.automaton import Setup
    from statechart.feasibility import Feasibility
    from statechart.observe import Observer
    from statechart.testing import Property
    from statechart.trace import Trace


def automaton(scene: Scene) -> Automaton:
    """Compose the automaton of a scene; modes are built when a run enters them."""
    from contacts.controllers import ControlledLaws, controller
    from contacts.laws import SceneLaws
    from contacts.mechanics import Mechanics
    from contacts.regions import region
    from contacts.setup import cones, scene_parameters
    from contacts.stepper import SceneStepper
    from statechart.automaton import Laws, Margin
    from statechart.formula import parse_relation

    if scene.collisions:
        from contacts.heap import heap

        return heap(scene)
    parameters = scene_parameters(scene)
    mechanics = Mechanics(scene, parameters.symbols, cones(scene, parameters.symbols))
    names = mechanics.names
    observables = mechanics.observables
    stops = {
        name: Margin(name, parse_relation(text).margin(observables))
        for name, text in scene.stop.conditions.items()
    }

    def symbols(contact: str) -> ContactSymbols:
        return mechanics.contact(contact).symbols

    regions = tuple(
        region(
            name,
            contact,
            partial(symbols, name),
            partial(mechanics.gates, name),
            jams=scene.jams(name),
            bounces=scene.bounces(name),
            gate=scene.gate(name),
            forces=mechanics.forces[name],
        )
        for name, contact in scene.contacts.items()
    )
    forces = [row.force for row in mechanics.joint_rows]
    forces += [symbol for pair in mechanics.forces.values() for symbol in pair]
    contact_laws = SceneLaws(mechanics, parameters, stops)
    laws: Laws = contact_laws
    if scene.regions:
        regions += tuple(controller(n, r, mechanics) for n, r in scene.regions.items())
        values = tuple(parameters.symbols.values())
        laws = ControlledLaws(contact_laws, mechanics, values, regions)
    return Automaton(
        name=scene.name,
        declaration=scene,
        names=(*names, *(scene.rate_name(name) for name in names)),
        variables=(*mechanics.q, *mechanics.v),
        parameter_names=parameters.names,
        parameters=tuple(parameters.symbols.values()),
        time=mechanics.time,
        unknowns=(*mechanics.a, *forces),
        rates=(*mechanics.v, *mechanics.a),
        equations=mechanics.equations,
        regions=regions,
        stops=stops,
        observables=observables,
        laws=laws,
        controls=mechanics.controls,
        stepper=lambda: SceneStepper(mechanics, parameters, stops, regions),
    )


def _automaton(scene: BaseModel) -> object:
    if not isinstance(scene, Scene):
        raise TypeError(f"a Scene was expected, not {type(scene).__name__}")
    return automaton(scene)


def _properties(scene: BaseModel) -> Sequence[Property]:
    from contacts.testing import properties

    if not isinstance(scene, Scene):
        raise TypeError(f"a Scene was expected, not {type(scene).__name__}")
    return properties(scene)


def _alternatives(scene: BaseModel) -> Mapping[str, Scene]:
    """Return the scene under the other meanings of simultaneous impacts."""
    if not isinstance(scene, Scene):
        raise TypeError(f"a Scene was expected, not {type(scene).__name__}")
    if len(scene.contacts) < 2:
        return {}
    return {
        f"simultaneous: {choice}": scene.model_copy(update={"simultaneous": choice})
        for choice in get_args(Simultaneous)
        if choice != scene.simultaneous
    }


def _feasibility(
    automaton: Automaton, setup: Setup, state: NDArray[np.float64], time: float
) -> Feasibility | None:
    from contacts.configuration import feasibility

    if isinstance(automaton.declaration, Scene) and automaton.declaration.collisions:
        return None  # a body touches what it meets: every mode is possible somewhere
    return feasibility(automaton, setup, state, time)


def _violations(scene: BaseModel, observer: Observer, trace: Trace) -> Mapping[str, float]:
    from contacts.violations import violations

    if not isinstance(scene, Scene):
        raise TypeError(f"a Scene was expected, not {type(scene).__name__}")
    return violations(scene, observer, trace)


def _omitted(scene: BaseModel, trace: Trace) -> Mapping[str, str]:
    """Return what a run of the scene does without, and why."""
    from contacts.other_laws import replaced

    if not isinstance(scene, Scene):
        raise TypeError(f"a Scene was expected, not {type(scene).__name__}")
    found = {} if trace.step is None else replaced(scene, trace.parameters)
    for name, body in scene.bodies.items():
        if body.position is None and body.inertia is None:
            found[f"the angle of {name}"] = "it has no inertia declared: a particle"
        elif body.position is not None:
            found[f"coordinates of {name}"] = "its position follows from those of the scene"
    for name, contact in scene.contacts.items():
        missing = [mode for mode in ("free", "slide", "pin") if mode not in contact.kinds]
        for mode in missing:
            found[f"{mode} of {name}"] = "not among its modes"
        if contact.frictionless:
            found[f"friction of {name}"] = "frictionless: one slide, without direction"
        elif "slide" not in contact.kinds:
            found[f"the coefficient of friction of {name}"] = "it may not slide"
        if "free" not in contact.kinds:
            found[f"restitution of {name}"] = "it is never free"
    return found


_STARTER = """\
# A rod dropped on the floor: one body, one contact. Run it with
#   statechart run NAME.yaml
# and draw its statechart with
#   statechart draw NAME.yaml -o NAME.svg
kind: scene
name: NAME
doc: A leaning rod falls, hits the floor with its lower end, and topples.

# Constants: numbers, or formulas of each other (+ - * / **, sqrt, sin, ..., pi, inf). Use any
# units that belong together. `statechart run NAME.yaml --set mu=0.1` changes one.
parameters:
  m: 1                  # mass
  L: 0.5                # from the middle of the rod to its end
  lean: 20*pi/180       # toward +x
  drop: 0.2             # height of the lower end above the floor
  mu: 0.3               # friction, 0 to inf
  e: 0                  # restitution, 0 (plastic) to 1 (elastic)

# What `statechart check` varies.
ranges:
  lean: [0.1, 1]
  mu: [0, 2]
  e: [0, 0.9]

gravity: 9.81           # downwards

# A free body has the coordinates x, y (of its centre of mass) and angle (counter-clockwise); a
# body without an inertia is a particle and has no angle. Speeds are dx, dy, dangle; all start at 0.
bodies:
  rod:
    mass: m
    inertia: m*L**2/3
    start: {x: 0, y: drop + L*cos(lean), angle: -lean}

surfaces:
  floor: {height: 0}    # y as a formula of x; or {incline: angle}

# A point of a body (in its own frame) that may touch a surface, and the modes it may be in.
contacts:
  end:
    point: {body: rod, at: [0, -L]}
    surface: floor
    modes: [free, slide, pin]
    friction: mu
    restitution: e

# A run ends at the time, or as soon as a condition becomes true.
stop:
  time: 5
  conditions:
    flat: rod.angle <= -pi/2

# What a run reports. Events are touchdown, liftoff, slip, stick, reverse and zeno; of every
# contact there are gap, slip (speed along the surface), V and H (normal and tangential force).
outputs:
  t_touchdown: {value: time, at: first end.touchdown}
  impacts: {count: end.touchdown}
  slid: {integral: abs(end.slip), during: {end: slide}}
  hardest_push: {maximum: end.V}
  t_flat: {value: time, at: end}
"""

SCENE = Kind(
    "scene",
    Scene,
    _automaton,
    _STARTER,
    _properties,
    _alternatives,
    _feasibility,
    violations=_violations,
    omitted=_omitted,
)
