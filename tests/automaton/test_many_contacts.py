"""Twenty contacts: 4^20 modes are declared, and nothing grows with them."""

from __future__ import annotations

import pytest

from statechart.automaton.product import explore, feasibility
from statechart.diagram.build import build, needs_run
from statechart.diagram.dot import dot
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

COUNT = 20
POINTS = "\n".join(
    f"  c{i}: {{point: {{body: bar, at: [{-1 + 2 * i / (COUNT - 1)}, 0]}}, surface: floor,"
    " friction: 0.3, restitution: 0}"
    for i in range(COUNT)
)
SCENE = f"""\
kind: scene
name: bar
gravity: 9.81
bodies: {{bar: {{mass: 1, inertia: 1/3, start: {{y: 0.2 + sin(0.3), angle: 0.3}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts:
{POINTS}
stop: {{time: 2, conditions: {{nearly flat: bar.angle <= 0.05}}}}
"""


@pytest.fixture(autouse=True)
def _no_product(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever asks for the product of twenty contacts never comes back."""

    def refused(*_: object) -> None:
        raise AssertionError("the product was enumerated")

    monkeypatch.setattr("statechart.automaton.product.product", refused)
    monkeypatch.setattr("contacts.modes.feasibility.product", refused)


def test_a_run_builds_the_modes_that_it_visits_and_no_other() -> None:
    runner = Runner(read_text(SCENE))
    automaton = runner.automaton
    assert (automaton.modes_declared, automaton.modes_total) == (3**COUNT, 4**COUNT)
    start, _ = runner.start()
    assert start == ("free",) * COUNT
    result = runner.run()
    visited = list(dict.fromkeys(result.trace.modes))
    assert [key[0] for key in visited] == ["free", "slide-", "slide+"]
    assert {key[1:] for key in visited} == {("free",) * (COUNT - 1)}
    assert result.trace.counts["modes_built"] == len(visited)
    report = result.to_dict(explain=True)
    assert (report["modes_total"], report["modes_built"]) == (4**COUNT, 3)
    edges = [edge for edge in automaton.regions[0].edges if edge.source == "free"]
    near = explore(automaton, around=[start], within=1).graph()
    assert near.out_degree(start) == COUNT * len({(e.cause, e.target) for e in edges})
    assert len(near) == 1 + COUNT * 3
    # The jump of the end considers the modes of the one touching contact only.
    assert max(len(event["considered"]) for event in report["events"]) <= 4


def test_picture_has_visited_modes_and_one_contact_chart() -> None:
    runner = Runner(read_text(SCENE))
    start, _ = runner.start()
    assert needs_run(runner.automaton)
    setup = runner.setup()
    found = feasibility(runner.automaton, setup, setup.initial, 0.0)
    assert found is None
    diagram = build(runner.automaton, start, runner.run().trace, found)
    run, chart = diagram.charts
    assert [node.label for node in run.nodes] == ["free", "slide-", "slide+"]
    assert [node.name for node in chart.leaves] == ["c0:free", "c0:slide+", "c0:slide-", "c0:pin"]
    assert "always free: c1, c2, c3, ... c19 (19 in all)" in diagram.notes
    assert chart.title == "c0, c1, c2, ... c19 (20 in all)"
    assert len(dot(diagram)) < 50_000
