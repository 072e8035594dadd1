"""What was considered at a rebound is what the laws say of it."""

from __future__ import annotations

import pytest

from contacts.event_driven.compiled_laws import CompiledSceneLaws
from statechart.documents.yaml_reader import read_text
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


_SLOPE = """kind: scene
name: slope
gravity: 9.81
bodies: {{b: {{mass: 1, inertia: 0.02, start: {{y: {height}, dx: 0.4}}}}}}
surfaces: {{f: {{line: [[0, 0], [1, {slope}]]}}}}
contacts: {{c: {{point: {{body: b}}, radius: 0.2, surface: f, friction: 0.3, restitution: {e}}}}}
stop: {{time: 9}}
"""


@pytest.mark.parametrize("e", [0.1, 0.5, 0.8])
@pytest.mark.parametrize(("height", "slope"), [(1.0, 0.0), (1.3, 0.1), (0.7, -0.2)])
def test_bounces_that_are_counted_do_not_depend_on_the_engine(
    height: float, slope: float, e: float
) -> None:
    text = _SLOPE.format(height=height, slope=slope, e=e)
    settings = [("taylor", None), ("scipy", None), ("scipy", 1e-9)]
    counts = set()
    for engine, tolerance in settings:
        trace = Runner(read_text(text), engine=engine, tolerance=tolerance).run().trace
        assert any(jump.cause == "zeno" for jump in trace.jumps)
        counts.add(tuple(jump.cause for jump in trace.jumps))
    assert len(counts) == 1
