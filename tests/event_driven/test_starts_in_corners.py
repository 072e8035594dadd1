"""Points that start in the corner of two surfaces, or next to it."""

from __future__ import annotations

import math

import pytest
from runs import ENGINES

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import run

_CORNER = """\
kind: scene
name: corner
gravity: {gravity}
bodies: {{b: {{mass: 1, start: {{x: {x!r}, y: {y!r}, dx: {dx!r}, dy: {dy!r}}}}}}}
surfaces:
  f: {{{kind}: [{begin}, {corner}]}}
  w: {{{kind}: [{corner}, {end}]}}
contacts:
  c: {{point: {{body: b}}, surface: f, friction: {mu}, restitution: {e}}}
  d: {{point: {{body: b}}, surface: w, friction: {mu}, restitution: {e}}}
stop: {{time: 0.5}}
"""


def _corner(
    kind: str, left: float, right: float, at: tuple[float, float] = (0.0, 0.0), **values: object
) -> str:
    (x, y), begin, end = at, math.pi - left, right
    numbers = {"gravity": 9.81, "x": x, "y": y, "dx": 0.0, "dy": 0.0, "mu": 0, "e": 0}
    places = {
        "corner": [x, y],
        "begin": [x + math.cos(begin), y + math.sin(begin)],
        "end": [x + math.cos(end), y + math.sin(end)],
    }
    return _CORNER.format(kind=kind, **places, **numbers | values)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", ["line", "edge"])
@pytest.mark.parametrize(("left", "right"), [(0.5, 0.5), (0.3, 0.9), (math.pi / 4, math.atan(0.3))])
@pytest.mark.parametrize("at", [(0.0, 0.0), (-0.7, 0.31)])
@pytest.mark.parametrize("mu", [0, 0.4])
def test_a_point_that_starts_in_a_corner_stays_there(
    engine: str, kind: str, left: float, right: float, at: tuple[float, float], mu: float
) -> None:
    text = _corner(kind, left, right, at, mu=mu, dy=-1.0)
    trace = run(read_text(text), engine=engine, throw=False).trace
    assert trace.outcome is Outcome.HORIZON
    assert trace.final.tolist() == pytest.approx([*at, 0.0, 0.0], abs=1e-12)
    assert "free" not in trace.final_mode


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("left", "right", "mu"), [(0.4495, 1.0906, 0.0), (0.5, 1.05, 0.0), (0.6, 0.86, 0.02)]
)
def test_point_oscillating_through_a_corner_comes_to_rest(
    engine: str, left: float, right: float, mu: float
) -> None:
    # An impact leaves the part cos(turn) - mu sin(turn) of the speed, friction the root of
    # (tan(slope) - mu) / (tan(slope) + mu).
    speed, rest, slopes = 1.0, 0.0, (left, right)
    text = _corner("edge", left, right, mu=mu).replace(
        "dx: 0.0, dy: 0.0",
        f"dx: {-speed * math.cos(left)!r}, dy: {speed * math.sin(left)!r}",
    )
    while speed > 1e-16:
        normal, along = 9.81 * math.cos(slopes[0]), 9.81 * math.sin(slopes[0])
        up, down = along + mu * normal, along - mu * normal
        rest += speed / up + speed / math.sqrt(up * down)
        left_over = math.cos(left + right) - mu * math.sin(left + right)
        speed, slopes = speed * math.sqrt(down / up) * left_over, slopes[::-1]
    trace = run(read_text(text.replace("time: 0.5", "time: 1.0")), engine=engine, throw=False).trace
    assert trace.outcome is Outcome.HORIZON
    assert trace.final.tolist() == pytest.approx([0.0] * 4, abs=1e-12)
    assert trace.final_mode == (("pin", "pin") if mu else ("slide", "slide"))
    assert trace.jumps[-1].t == pytest.approx(rest, abs=1e-9)
    assert len(trace.jumps) < 40


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("at", [(0.0, 0.0), (-1e4, 3e4), (1e5, -1e5), (1e6, 1e6)])
def test_edge_end_at_a_stopped_point_stays_enabled(engine: str, at: tuple[float, float]) -> None:
    # It slides down one edge and strikes the other, where friction takes the remaining speed.
    text = _corner("edge", math.pi / 4, 0.6, at, mu=0.3).replace(
        f"x: {at[0]!r}, y: {at[1]!r}", f"x: {at[0] - 0.5!r}, y: {at[1] + 0.5!r}"
    )
    trace = run(read_text(text.replace("time: 0.5", "time: 2")), engine=engine).trace
    slope = 9.81 * (math.sin(math.pi / 4) - 0.3 * math.cos(math.pi / 4))
    *_, enabled, struck = trace.jumps
    assert [(j.region, j.cause) for j in (enabled, struck)] == [("d", "enable"), ("d", "touchdown")]
    assert struck.t == pytest.approx(math.sqrt(2 * math.hypot(0.5, 0.5) / slope), rel=1e-8)
    assert not any(j.region == "c" for j in trace.jumps)
    assert trace.final_mode == ("pin", "pin")
