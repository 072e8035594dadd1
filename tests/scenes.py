"""Charts and scenes that tests write in a line or two."""

from __future__ import annotations

from typing import Any

from runs import engine

from contacts.scene.scene import Scene
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.charts.chart import Chart
from statechart.charts.laws import automaton as chart_automaton
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
