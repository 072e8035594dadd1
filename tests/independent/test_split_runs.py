"""A run that starts from a state of another run goes on as that run does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from contacts.scene.scene import Scene
from statechart.documents.settings import Stop
from statechart.loading.load import load
from statechart.running.runner import Runner

# Model -> end of the run, and instants at which it is split: between events, and at one.
SPLITS = {
    "toppling_stick": (5.5, (2.0, "tip.slip", "tip.reverse")),
    "rocking_block": (6.0, (1.0, "left.touchdown")),
    "rope_swing": (2.0, (0.3, "rope.liftoff", 0.9)),
    "compass_walker": (3.0, (1.2, "foot_two.touchdown", "foot_one.enable")),
}


def _with_starts(scene: Scene) -> tuple[Scene, dict[str, str]]:
    """Return a scene whose starts are parameters, and their names by those of the variables."""
    parameters: dict[str, Any] = dict(scene.parameters)
    names: dict[str, str] = {}

    def named(variable: str, value: Any) -> str:
        names[variable] = f"start_{variable}".replace(".", "_")
        parameters[names[variable]] = 0 if value is None else value
        return names[variable]

    coordinates = {
        name: declared.model_copy(
            update={
                "start": named(name, declared.start),
                "rate": named(f"d{name}", declared.rate),
            }
        )
        for name, declared in scene.coordinates.items()
    }
    bodies = {
        name: body
        if body.position is not None
        else body.model_copy(
            update={
                "start": {
                    key: named(f"{name}.{key}", body.start.get(key))
                    for key in ("x", "y", "angle", "dx", "dy", "dangle")
                    if body.inertia is not None or "angle" not in key
                }
            }
        )
        for name, body in scene.bodies.items()
    }
    fields = {key: getattr(scene, key) for key in Scene.model_fields}
    changed = {"parameters": parameters, "coordinates": coordinates, "bodies": bodies}
    return Scene(**{**fields, **changed, "outputs": {}, "stop": Stop(time=1e3)}), names


@pytest.mark.parametrize("model", SPLITS)
def test_a_run_that_is_split_in_two_has_the_same_events_and_end(model: str) -> None:
    until, places = SPLITS[model]
    declared = load(model)
    assert isinstance(declared, Scene)
    scene, names = _with_starts(declared)
    runner = Runner(scene)
    whole = runner.run(until=until)
    for place in places:
        if isinstance(place, str):
            jump = next(j for j in whole.trace.jumps if f"{j.region}.{j.cause}" == place)
            at, values = jump.t, dict(zip(whole.trace.variables, jump.after.tolist(), strict=True))
        else:
            at, values = place, dict(whole.at(place).values)
        starts = {name: values[variable] for variable, name in names.items()}
        rest = runner.run(starts, until=until - at)
        later = [jump for jump in whole.trace.jumps if jump.t > at + 1e-9]
        events = [(jump.region, jump.cause, jump.target) for jump in rest.trace.jumps]
        assert events == [(jump.region, jump.cause, jump.target) for jump in later]
        times = [jump.t - at for jump in later]
        assert [jump.t for jump in rest.trace.jumps] == pytest.approx(times, abs=1e-11)
        np.testing.assert_allclose(rest.trace.final, whole.trace.final, rtol=1e-10, atol=1e-10)
