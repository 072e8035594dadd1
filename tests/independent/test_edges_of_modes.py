"""Starts, stops and grazes exactly on the edge of a mode, against answers by hand."""

from __future__ import annotations

from typing import Any

import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

pytestmark = pytest.mark.parametrize("engine", ["taylor", "scipy"])

_PUSHED = """
kind: scene
name: pushed
gravity: 10
bodies: {b: {mass: 1, start: {}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.5, restitution: 0}}
forces: {f: {body: b, force: ["FORCE", 0]}}
stop: {time: 1}
outputs:
  x: {value: b.x}
  H: {value: c.H}
  slips: {count: c.slip or c.stick or c.reverse}
"""
_LOWERED = """
kind: scene
name: lowered
gravity: 10
bodies: {b: {mass: 2, start: {}}}
surfaces: {plate: {height: 0, displacement: [0, "PATH"]}}
contacts: {c: {point: {body: b}, surface: plate, friction: 0.3, restitution: 0}}
stop: {time: 1}
outputs: {y: {value: b.y}, V: {value: c.V}, on: {count: c.touchdown}, off: {count: c.liftoff}}
"""
_THROWN = """
kind: scene
name: thrown
gravity: 10
bodies: {b: {mass: 1, start: {dx: 3, dy: 10}}}
surfaces: {ceiling: {line: [[9, 5], [0, 5]]}}
contacts: {c: {point: {body: b}, surface: ceiling, friction: 0.3, restitution: 0.5}}
stop: {time: 2}
outputs: {x: {value: b.x}, y: {value: b.y}, dy: {value: b.dy}, hits: {count: c.touchdown}}
"""


def outputs(text: str, engine: str) -> Any:
    result = statechart.run(interpret(read_text(text, "scene.yaml")), engine=engine)
    assert result.trace.certified
    return result.outputs


@pytest.mark.parametrize(
    ("force", "moved"),
    [
        ("5 + time", 1 / 6),
        ("5 + time**2", 1 / 12),
        ("5 + time**3", 1 / 20),
        ("5 + time**5", 1 / 42),
        ("5 + (time - 0.5)**3", 0.5**5 / 20),
    ],
)
def test_force_that_grows_from_the_friction_bound_starts_slip(
    engine: str, force: str, moved: float
) -> None:
    found = outputs(_PUSHED.replace("FORCE", force), engine)
    assert found["x"] == pytest.approx(moved, abs=1e-13)
    assert (found["H"], found["slips"]) == (-5.0, 1)


@pytest.mark.parametrize(
    "force", ["5", "5 - time", "5*cos(9*time)", "5*sin(pi*time)", "5 - (time - 0.5)**2"]
)
def test_a_block_at_the_friction_limit_sticks(engine: str, force: str) -> None:
    found = outputs(_PUSHED.replace("FORCE", force), engine)
    assert (found["x"], found["slips"]) == (0.0, 0)


@pytest.mark.parametrize(
    ("path", "y", "push", "left"),
    [
        ("-5*time**2", -5.0, 0.0, 0),
        ("-5*time**2 + time**4", -4.0, 24.0, 0),
        ("-5*time**2 - time**3", -5.0, 0.0, 1),
        ("-5*time**2 - time**4", -5.0, 0.0, 1),
    ],
)
def test_a_falling_plate_carries_its_load_without_force(
    engine: str, path: str, y: float, push: float, left: int
) -> None:
    # The terms of its path beyond the second order decide whether it presses or leaves.
    found = outputs(_LOWERED.replace("PATH", path), engine)
    assert [found["y"], found["V"]] == pytest.approx([y, push], abs=1e-12)
    assert (found["on"], found["off"]) == (0, left)


def test_a_ball_that_turns_exactly_at_the_ceiling_does_not_hit_it(engine: str) -> None:
    found = outputs(_THROWN, engine)
    assert [found["x"], found["y"], found["dy"]] == pytest.approx([6.0, 0.0, -10.0], abs=1e-12)
    assert found["hits"] == 0


@pytest.mark.parametrize("tolerance", [1e-6, 1e-10, 1e-12, 1e-14])
@pytest.mark.parametrize("speed", [1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-7])
def test_throws_faster_than_the_speed_tolerance_bounce(
    engine: str, speed: float, tolerance: float
) -> None:
    # Speeds are those of a fall by g/2 s^2, and below ten tolerances of it, or rounding, none.
    text = _PUSHED.replace("start: {}", f"start: {{dy: {speed}}}").replace("FORCE", "0")
    text = text.replace("restitution: 0", "restitution: 0.5")
    least = 10.0 * max(10.0 * tolerance, 1e-12)
    result = statechart.run(
        interpret(read_text(text, "s.yaml")), engine=engine, tolerance=tolerance
    )
    causes = [jump.cause for jump in result.trace.jumps]
    assert causes == ([] if speed <= least else ["touchdown", "zeno"][: 1 + (speed > 2.0 * least)])
    assert [jump.t for jump in result.trace.jumps] == pytest.approx(
        [speed / 5.0, speed / 2.5][: len(causes)], rel=1e-6
    )


@pytest.mark.parametrize("rate", [1e3, 1.0, 1e-3])
def test_a_slip_begins_where_its_force_has_passed_the_bound_by_1e12_of_the_weight(
    engine: str, rate: float
) -> None:
    # The weight is 10, and friction bears 5; the margin is a distance from the edge of its cone.
    text = _PUSHED.replace("FORCE", f"{rate}*time").replace("time: 1", f"time: {6.0 / rate}")
    result = statechart.run(interpret(read_text(text, "scene.yaml")), engine=engine)
    (slip,) = result.trace.jumps
    assert slip.t * rate - 5.0 == pytest.approx(1e-11 * 1.25**0.5, abs=1e-13)
