"""Reasons of rebounds: the recorded candidates agree with the impact law."""

from __future__ import annotations

import pytest

from contacts.event_driven.compiled_laws import CompiledSceneLaws
from statechart.running.runner import Runner


@pytest.mark.parametrize(
    ("name", "values"),
    [("bouncing_ball", {}), ("bouncing_ball_hills", {}), ("two_balls", {"h2": 1.6, "apart": 0.7})],
)
def test_candidates_at_a_rebound_agree_with_the_laws(
    name: str, values: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = Runner(name)

    def told() -> list[dict[str, str]]:
        return [dict(jump.considered) for jump in runner.run(values).trace.jumps]

    found = told()
    assert sum("taken: it leaves its surface at" in str(event) for event in found) > 2
    monkeypatch.setattr(CompiledSceneLaws, "_rebound", lambda *_: None)
    assert told() == found
