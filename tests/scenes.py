"""Charts and scenes that tests write in a line or two."""

from __future__ import annotations

from typing import Any

from runs import engine

from contacts.scene.scene import Scene
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.charts.chart import Chart
from statechart.charts.laws import automaton as chart_automaton
from statechart.documents.settings import Stop
from statechart.documents.yaml_reader import read_text
from statechart.execution.simulator import Simulator
from statechart.loading.kind import kind
from statechart.loading.load import interpret


def compose(
    variables: dict[str, Any],
    regions: dict[str, Any],
    parameters: dict[str, Any] | None = None,
    **settings: Any,
) -> Automaton:
    return chart_automaton(
        Chart.model_validate(
            {
                "name": "test",
                "variables": variables,
                "regions": regions,
                "parameters": parameters or {},
                "settings": settings,
            }
        )
    )


def region(
    states: dict[str, dict[str, Any]], *transitions: dict[str, Any], initial: str | None = None
) -> dict[str, Any]:
    flows = {name: {"flows": flows} for name, flows in states.items()}
    return {"initial": initial or next(iter(states)), "states": flows, "transitions": transitions}


def go(source: str, target: str, guard: str, name: str = "go", **updates: Any) -> dict[str, Any]:
    return {"name": name, "from": source, "to": target, "guard": guard, "updates": updates}


def times(trace: Trace, cause: str = "go") -> list[float]:
    return [jump.t for jump in trace.jumps if jump.cause == cause]


def run(automaton: Automaton, name: str, until: float, **parameters: float) -> Trace:
    """Run an automaton on an engine at its tightest."""
    return Simulator(automaton, engine(name)).run(parameters, until=until)


def scene(text: str) -> Automaton:
    """Return the automaton of a scene."""
    model = interpret(read_text(text, "f.yaml"))
    assert isinstance(model, Scene)
    built = kind("scene").automaton(model)
    assert isinstance(built, Automaton)
    return built


def with_starts(scene: Scene) -> tuple[Scene, dict[str, str]]:
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
