"""Relations that start where a root, a power or an angle has no derivative."""

from __future__ import annotations

import math

import pytest

import statechart
from statechart.documents.yaml_reader import read_text

SCENE = """
kind: scene
name: singular
gravity: 9.81
bodies: {{ball: {{mass: 1, start: {{y: 60}}}}, sled: {{mass: 1, start: {{dx: 1}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts:
  b: {{point: {{body: ball}}, surface: floor, friction: 0, restitution: 0{enabled}}}
  s: {{point: {{body: sled}}, surface: floor, friction: 0, restitution: 0}}
regions:
  r:
    initial: w
    states: {{w: {{}}, d: {{}}}}
    transitions: [{{name: go, from: w, to: d, guard: "{guard}"}}]
stop: {{time: 2, conditions: {{met: "{stop}"}}}}
outputs: {{go: {{value: time, at: first go}}}}
"""
# Relation, and the first instant at which it is true.
STARTS = {
    "sqrt(time) - time <= 0": 1.0,
    "sqrt(sled.x) - sled.x <= 0": 1.0,
    "time**1.5 <= 0": math.inf,
    "sled.x**1.5 > 0": 0.0,
    "asin(1 - time) >= pi/2": math.inf,
    "acos(1 - time) >= 1": 1 - math.cos(1),
    "atan2(ball.dy, ball.dx) < -0.5": 0.0,
    "atan2(ball.dy, ball.dx) > 0.5": math.inf,
    "atan2(sled.y, sled.x) >= 0": 0.0,
    "hypot(ball.dx, ball.dy) > 0": 0.0,
}


@pytest.mark.parametrize("relation", STARTS)
def test_a_relation_without_a_derivative_at_the_start_counts_as_just_after(relation: str) -> None:
    first = STARTS[relation]
    never = "time > 5"

    def run(**texts: str) -> statechart.Result:
        words = {"guard": never, "stop": never, "enabled": "", **texts}
        return statechart.run(read_text(SCENE.format(**words)))

    close = pytest.approx(first, abs=1e-12)
    assert run(guard=relation).outputs["go"] == (None if first > 2 else close)
    assert run(stop=relation).trace.t_end == (2 if first > 2 else close)
    gated = run(enabled=f', enabled: "{relation}"').trace
    enabled = [jump.t for jump in gated.jumps if jump.cause == "enable"]
    assert enabled == ([] if first in (0, math.inf) else [close])
    assert gated.modes[0][0] == ("free" if first == 0 else "off")
