"""Stop conditions on values that stay zero by steps agree with events, whatever the round-off."""

from __future__ import annotations

import pytest

from statechart import Runner
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

MU, G = 0.3, 9.81
STILL = 1.0 / (MU * G)

HEAD = """
kind: scene
name: slid
gravity: 9.81
surfaces: {floor: {height: 0}}
"""
POINT = f"""{HEAD}
bodies: {{b: {{mass: 1, start: {{dx: 1}}}}}}
contacts: {{c: {{point: {{body: b}}, surface: floor, friction: {MU}, restitution: 0}}}}
"""
BOX = f"""{HEAD}
bodies:
  b:
    mass: 1
    inertia: 0.1
    shape: {{polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]}}
    start: {{dx: 1, y: 0.1}}
collisions: {{all: {{bodies: [b], surfaces: [floor], friction: {MU}, restitution: 0}}}}
"""


def ended(text, condition, **settings):
    text += f"stop: {{time: 1, conditions: {{met: {condition}}}}}\n"
    return Runner(interpret(read_text(text)), **settings).run().trace


@pytest.mark.parametrize("step", [2e-3, 1e-3, 3e-4])
@pytest.mark.parametrize(
    ("text", "condition"),
    [
        *((text, f"b.{what}") for text in (POINT, BOX) for what in ("dx < 0", "dy > 0", "dy < 0")),
        (POINT, "b.y < 0"),
        (POINT, "c.V < 0"),
        (BOX, "b.dangle > 0"),
        (BOX, "b.dangle < 0"),
    ],
)
def test_a_margin_that_stays_zero_fires_neither_strict_relation(text, condition, step):
    assert ended(text, condition, engine="impulse", step=step).outcome is Outcome.HORIZON
    if text == POINT:
        assert ended(text, condition).outcome is Outcome.HORIZON


@pytest.mark.parametrize("step", [2e-3, 1e-3, 3e-4])
@pytest.mark.parametrize("text", [POINT, BOX])
def test_a_body_at_rest_has_zero_velocity(text, step):
    trace = ended(text, "b.dx <= 0", engine="impulse", step=step)
    # It is at rest at the end of a step, and stays there for another.
    assert STILL < trace.t_end <= STILL + 2.0 * step * (1.0 + 1e-9)
    assert trace.outcome is Outcome.STOPPED


@pytest.mark.parametrize("text", [POINT, BOX])
def test_stop_on_a_rate_is_located_within_the_step(text):
    trace = ended(text, "b.dx < 0.5", engine="impulse", step=1e-3)
    assert trace.t_end == pytest.approx(0.5 * STILL, abs=1e-12)
