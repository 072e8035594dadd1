"""The document kind `scene`: from the declaration to the automaton."""

from __future__ import annotations

from pydantic import BaseModel

from contacts.scene import Scene
from statechart.automaton import Automaton
from statechart.kinds import Kind

__all__ = ["SCENE", "automaton"]


def automaton(scene: Scene) -> Automaton:
    """Compose the automaton of a scene; modes are built when a run enters them."""
    from contacts.laws import SceneLaws, cones, scene_parameters
    from contacts.mechanics import Mechanics
    from contacts.regions import region
    from statechart.automaton import Margin
    from statechart.formula import parse_relation

    parameters = scene_parameters(scene)
    mechanics = Mechanics(scene, parameters.symbols, cones(scene, parameters.symbols))
    names = mechanics.names
    observables = mechanics.observables
    stops = {
        name: Margin(name, parse_relation(text).margin(observables))
        for name, text in scene.stop.conditions.items()
    }
    regions = tuple(
        region(name, contact, lambda name=name: mechanics.contact(name).symbols)  # type: ignore[misc]
        for name, contact in scene.contacts.items()
    )
    forces = [symbol for pair in mechanics.forces.values() for symbol in pair]
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
        laws=SceneLaws(scene, mechanics, parameters, stops),
    )


def _automaton(scene: BaseModel) -> object:
    if not isinstance(scene, Scene):
        raise TypeError(f"a Scene was expected, not {type(scene).__name__}")
    return automaton(scene)


_STARTER = """\
kind: scene
name: NAME
"""

SCENE = Kind("scene", Scene, _automaton, _STARTER)
