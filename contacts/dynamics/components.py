"""Components of a scene: groups of bodies that no contact, joint, force or controller couples."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.setup_evaluation import SceneNumbers
from contacts.scene.modes import Bearing
from contacts.scene.scene import Scene
from statechart.automaton.automaton import Automaton, Component, Places
from statechart.automaton.components import Data, compose_components, split
from statechart.automaton.trace import Role

_REGIONS = ("contacts", "couplings", "regions")
_MOVING = ("coordinates", "bodies", *_REGIONS, "joints", "forces", "controls")

# Part of the names of the parameters that mark redundant joint rows.
_REDUNDANT = ".redundant_"


def components(
    scene: Scene, compose: Callable[[Scene], tuple[Automaton, SceneNumbers]]
) -> tuple[Component, ...]:
    """Return the components of a scene; none if everything is coupled."""
    copied = any(body.copies is not None for body in scene.bodies.values())
    if scene.collisions or copied or scene.expanded is not scene:
        return ()
    data = scene.model_dump(by_alias=True, exclude_unset=True)
    if "energy" in json.dumps([data.get(key) for key in (*_MOVING, "stop")], default=str):
        return ()
    numbers: dict[int, SceneNumbers] = {}

    def automaton(declaration: Data) -> Automaton:
        component_automaton, numbers_of_part = compose(Scene.model_validate(declaration))
        numbers[id(component_automaton)] = numbers_of_part
        return component_automaton

    parts = split(data, _MOVING, _REGIONS, Path(__file__).parents[1] / "schema.json")
    if not all(part.get("bodies") for part, _ in parts):
        # A controller of time alone has no bodies and is no scene.
        return ()
    return compose_components(
        parts,
        _scene_form,
        automaton,
        lambda part: partial(_restrict, numbers[id(part)]),
        _renumber_share,
    )


def _scene_form(declaration: Data) -> Data:
    """Return a declaration without the numbers that its equations take as parameters."""
    form = deepcopy(declaration)
    for section in ("bodies", "coordinates"):
        for content in form.get(section, {}).values():
            for key in ("start", "rate"):
                content.pop(key, None)
            content["inertia"] = _structure_key(content.get("inertia"))
    for content in form.get("contacts", {}).values():
        for key in ("friction", "restitution"):
            content[key] = _structure_key(content.get(key))
    return form


def _structure_key(value: Any) -> Any:
    """Replace numbers other than 0 and 1, which shape the equations, by a placeholder."""
    if isinstance(value, dict):
        return {key: _structure_key(entry) for key, entry in value.items()}
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return value if value in (0, 1) else "a number"


def _restrict(numbers: SceneNumbers, setup: SceneSetup, places: Places) -> SceneSetup:
    """Restrict the setup of a scene to a component; the scales remain those of the scene."""
    values, variables = setup.values[places.parameters], places.variables
    moving = variables[variables < len(setup.scales.sizes)]
    return replace(
        setup,
        values=values,
        initial=setup.initial[variables],
        warnings=(),
        sizes=setup.sizes[variables],
        modes=None,
        scales=replace(setup.scales, sizes=setup.scales.sizes[moving]),
        contacts=numbers.contacts(values),
        bands={name: setup.bands[name] for name in numbers.stops},
    )


def _renumber_share(role: Role, places: Places) -> Role:
    """Renumber the coordinates and joint rows of a shared load from component to scene."""
    share = role.share
    if not isinstance(share, Bearing):
        return role
    rows = [place for place, n in enumerate(places.whole.parameter_names) if _REDUNDANT in n]
    own_rows = [place for place in places.parameters.tolist() if place in rows]
    return role._replace(
        share=share._replace(
            coordinates=tuple(places.variables.item(k) for k in share.coordinates),
            joints=tuple(rows.index(own_rows[k]) for k in share.joints),
        )
    )
