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
from statechart.automaton.components import Data, composed, split
from statechart.automaton.laws import Setup
from statechart.automaton.trace import Role

_REGIONS = ("contacts", "couplings", "regions")
_MOVING = ("coordinates", "bodies", *_REGIONS, "joints", "forces", "controls")

# In the names of the parameters that say whether rows of joints are redundant, in their order.
_ROW = ".redundant_"


def components(
    scene: Scene, compose: Callable[[Scene], tuple[Automaton, SceneNumbers]]
) -> tuple[Component, ...]:
    """Return the components of a scene, none where all of it belongs together."""
    copied = any(body.copies is not None for body in scene.bodies.values())
    if scene.collisions or copied or scene.expanded is not scene:
        return ()
    data = scene.model_dump(by_alias=True, exclude_unset=True)
    if "energy" in json.dumps([data.get(key) for key in (*_MOVING, "stop")], default=str):
        return ()
    numbers: dict[int, SceneNumbers] = {}

    def automaton(part: Data) -> Automaton:
        made, own = compose(Scene.model_validate(part))
        numbers[id(made)] = own
        return made

    parts = split(data, _MOVING, _REGIONS, Path(__file__).parents[1] / "schema.json")
    if not all(part.get("bodies") for part, _ in parts):
        # A controller of time alone is no scene by itself.
        return ()
    return composed(
        parts,
        _form,
        automaton,
        lambda made: partial(_restricted, numbers[id(made)]),
        _shown,
        joint=True,
    )


def _form(part: Data) -> Data:
    """Return a declaration without the numbers that its equations take as parameters."""
    found = deepcopy(part)
    for section in ("bodies", "coordinates"):
        for content in found.get(section, {}).values():
            for key in ("start", "rate"):
                content.pop(key, None)
            content["inertia"] = _class(content.get("inertia"))
    for content in found.get("contacts", {}).values():
        for key in ("friction", "restitution"):
            content[key] = _class(content.get(key))
    return found


def _class(value: Any) -> Any:
    """Return what the structure of equations shows of a number: whether it is 0, or 1."""
    if isinstance(value, dict):
        return {key: _class(one) for key, one in value.items()}
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return value if value in (0, 1) else "a number"


def _restricted(numbers: SceneNumbers, whole: Setup, places: Places) -> SceneSetup:
    """Return the numbers of a run of a component: its own values, in the scales of the scene."""
    assert isinstance(whole, SceneSetup)
    assert whole.sizes is not None
    values, variables = whole.values[places.parameters], places.variables
    moving = variables[variables < len(whole.scales.sizes)]
    return replace(
        whole,
        values=values,
        initial=whole.initial[variables],
        warnings=(),
        sizes=whole.sizes[variables],
        modes=None,
        scales=replace(whole.scales, sizes=whole.scales.sizes[moving]),
        contacts=numbers.contacts(values),
        bands={name: whole.bands[name] for name in numbers.stops},
    )


def _shown(role: Role, places: Places) -> Role:
    """Return a role whose shared load names coordinates and rows of joints as the scene does."""
    share = role.share
    if not isinstance(share, Bearing):
        return role
    rows = [place for place, n in enumerate(places.whole.parameter_names) if _ROW in n]
    own = [place for place in places.parameters.tolist() if place in rows]
    return role._replace(
        share=share._replace(
            coordinates=tuple(places.variables.item(k) for k in share.coordinates),
            joints=tuple(rows.index(own[k]) for k in share.joints),
        )
    )
