"""The document kind `scene`: from the declaration to the automaton."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from contacts.scene.checks import has_switches
from contacts.scene.scene import Scene
from statechart.automaton.automaton import Automaton
from statechart.loading.kind import Kind

if TYPE_CHECKING:
    from contacts.dynamics.mechanics import Mechanics
    from contacts.dynamics.setup_evaluation import SceneNumbers
    from statechart.automaton.regions import Region, State
    from statechart.automaton.time_stepper import TimeStepper
    from statechart.automaton.trace import Role
    from statechart.pictures.stage import Stage


def automaton(scene: Scene) -> Automaton:
    """Compose the automaton of a scene; modes are built when a run enters them."""
    if scene.collisions:
        from contacts.rigid_bodies.body_stepper import bodies_automaton

        return bodies_automaton(scene)
    return _composed(scene)[0]


def _composed(scene: Scene) -> tuple[Automaton, SceneNumbers]:
    """Compose the automaton of a scene; return it and its setup of runs."""
    from contacts.dynamics.components import components
    from contacts.dynamics.mechanics import Mechanics
    from contacts.dynamics.minimal import coordinates
    from contacts.dynamics.setup_evaluation import SceneNumbers
    from contacts.event_driven.laws import SceneLaws
    from statechart.automaton.laws import Laws
    from statechart.automaton.regions import stop_conditions

    def stepper() -> TimeStepper:
        from contacts.time_stepping.scene_stepper import SceneStepper

        return SceneStepper(mechanics, stops, regions)

    mechanics, switching = Mechanics(scene.expanded), has_switches(scene)
    parameters, observables = mechanics.parameters, mechanics.observables
    stops = stop_conditions(scene.stop.conditions, observables)
    regions = _regions(mechanics)
    numbers = SceneNumbers(mechanics, stops)
    contact_laws = SceneLaws(mechanics, numbers)
    laws: Laws = contact_laws
    if mechanics.scene.regions:
        from contacts.event_driven.controlled_laws import ControlledLaws

        laws = ControlledLaws(contact_laws, mechanics, regions)
    made = Automaton(
        name=scene.name,
        declaration=scene,
        names=mechanics.state_names,
        variables=mechanics.state,
        parameter_names=parameters.names,
        parameters=parameters.ordered,
        time=mechanics.time,
        unknowns=(*mechanics.a, *mechanics.unknown_forces),
        rates=(*mechanics.v, *mechanics.a, *mechanics.controller_rates.values()),
        equations=mechanics.equations,
        regions=regions,
        stops=stops,
        observables=observables,
        setup=numbers.at,
        laws=laws,
        controls=mechanics.controls,
        # Rates of eliminated coordinates would depend on the memory as well.
        coordinates=None if mechanics.scene.leading else coordinates(mechanics),
        stepper=stepper,
        switching=switching,
        components=tuple if switching else cache(partial(components, scene, _composed)),
    )
    return made, numbers


def _regions(mechanics: Mechanics) -> tuple[Region, ...]:
    """Return a region for every contact, then for every coupling, then for every controller."""
    from contacts.dynamics.controllers import controller
    from contacts.scene.couplings import coupling_state
    from contacts.scene.regions import contact_state
    from contacts.states import INACTIVE

    scene = mechanics.scene

    def build(name: str, role: Role) -> State:
        """Return a state of a contact or a coupling, with the margins of its conditions."""
        symbols, gate = mechanics.contact(name), mechanics.gate(name)
        if name in scene.couplings:
            state = coupling_state(mechanics.coupling(name), role)
        else:
            state = contact_state(scene.contacts[name], symbols, role)
        margins = state.margins
        if role.state in INACTIVE:
            margins += () if gate is None else gate.back(symbols.gap)
        else:
            margins += mechanics.hauled(name) + (() if gate is None else gate.margins)
        return replace(state, margins=margins)

    forces = mechanics.forces | {name: (couple,) for name, couple in mechanics.couples.items()}
    return (
        *(
            scene.contact_region(name, partial(build, name), forces[name])
            for name in scene.frictional
        ),
        *(controller(n, r, mechanics) for n, r in scene.controlled.flat.items()),
    )


def stage(automaton: Automaton) -> Stage:
    """Return the stage of a scene, which makes its pictures and films."""
    from contacts.pictures.stage import SceneStage

    return SceneStage(automaton)


SCENE = Kind("scene", Scene, automaton, Path(__file__).with_name("starter.yaml"), stage)
