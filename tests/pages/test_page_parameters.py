"""Parameters listed on a run's page."""

from __future__ import annotations

from statechart.pages.page import content
from statechart.running.runner import Runner


def test_a_page_has_the_parameters_that_its_model_declares() -> None:
    result = Runner("rimless_wheel").run(until=1.0)
    shown = content(result.observer, result.trace, result.to_dict(), None)["parameters"]
    assert list(shown) == list(result.observer.automaton.declaration.parameters)
    assert shown["g"] == {"text": "9.81 m/s²", "values": []}
