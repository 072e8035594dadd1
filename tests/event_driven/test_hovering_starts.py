"""Starts with a tiny gap: the body falls and bounces, and a warning reports it."""

from __future__ import annotations

import pytest

from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result

SCENE = """\
kind: scene
name: hovering
parameters: {above: 0, fast: 0, x: 0}
gravity: 9.81
bodies:
  %s
surfaces: {floor: {height: 0}, wall: {line: [[5, 0], [5, 1]]}}
contacts:
  foot: %s
  side: {point: {body: ball}, surface: wall, friction: 0.3, restitution: 0.5, enabled: ball.x > 1}
stop: {time: 0.2}
"""
POINT = SCENE % (
    "ball: {mass: 1, start: {x: x, y: above, dx: 1, dy: fast}}",
    "{point: {body: ball}, surface: floor, friction: 0.3, restitution: 0.5}",
)
RIM = SCENE % (
    "ball: {mass: 1, inertia: 0.01, start: {x: x, y: 0.2 + above, dx: 1, dy: fast}}",
    "{point: {body: ball, at: [0, 0]}, radius: 0.2, surface: floor, friction: 0.3, "
    "restitution: 0.5}",
)
TEXTS = {"point": POINT, "rim": RIM}
RUNNERS = {
    "taylor": {},
    "scipy": {"engine": "scipy"},
    "steps": {"engine": "impulse", "step": 1e-3},
}


def run(text: str, how: str, **values: float) -> Result:
    return Runner(read_text(text), **RUNNERS[how]).run(values)


def said(result: Result) -> list[str]:
    return [warning for warning in result.warnings if "write the exact coordinate" in warning]


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("how", RUNNERS)
def test_a_start_slightly_off_a_surface_gives_a_warning(text: str, how: str) -> None:
    for above in (1e-9, 1e-7):
        (warning,) = said(run(text, how, above=above))
        assert "contact 'foot' starts 1e-0" in warning
        assert "off surface 'floor'" in warning


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("how", RUNNERS)
def test_events_of_a_moved_start_are_those_of_rest_or_a_warning_is_given(
    text: str, how: str
) -> None:
    rest = [jump.cause for jump in run(text, how).trace.jumps]
    for power in range(-17, -6):
        for sign in (1.0, -1.0) if power <= -9 else (1.0,):
            moved = run(text, how, above=sign * 10.0**power)
            same = [jump.cause for jump in moved.trace.jumps] == rest
            assert same or said(moved), (power, sign)


@pytest.mark.parametrize("how", RUNNERS)
@pytest.mark.parametrize(
    "values", [{}, {"above": 1e-3}, {"above": 1e-9, "fast": 1.0}, {"above": 1e-9, "fast": -1.0}]
)
def test_ordinary_starts_give_no_warning(how: str, values: dict[str, float]) -> None:
    assert not said(run(POINT, how, **values))


FAST = """
kind: scene
name: fast
gravity: 9.81
bodies: {ball: {mass: 1, inertia: 0.02, start: {y: 0.5, dx: 1e6}}}
surfaces: {floor: {height: 0}}
contacts: {f: {point: {body: ball}, radius: R, surface: floor, friction: 0.4, restitution: 0}}
stop: {time: 0.4}
"""


@pytest.mark.parametrize("how", RUNNERS)
@pytest.mark.parametrize("radius", ["0.2", "0.5 - 1e-3"])
def test_a_gap_is_compared_with_the_places_of_a_fast_body(how: str, radius: str) -> None:
    assert not said(run(FAST.replace("R", radius), how))


@pytest.mark.parametrize("how", RUNNERS)
def test_disabled_contact_gives_no_warning(how: str) -> None:
    # Left of its gate the wall is not there.
    text = POINT.replace("enabled: ball.x > 1", "enabled: time > 1")
    assert not said(run(text, how, x=5.0 - 1e-9))
