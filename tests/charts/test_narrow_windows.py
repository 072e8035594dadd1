"""Relations that hold for a short time: located if the window exceeds round-off, else reported."""

from __future__ import annotations

import math
from typing import Any

import pytest

from contacts.event_driven.compiled_laws import CompiledSceneLaws
from statechart import Runner, run
from statechart.documents.yaml_reader import read_text
from statechart.execution import compiled_loop

both = pytest.mark.parametrize("engine", ["taylor", "scipy"])
OPEN = "within the error of the run"


def chart(guard: str, start: str = "x: -1", flows: str = "x: 1", time: float = 10) -> str:
    return f"""
kind: chart
name: window
variables: {{{start}}}
regions:
  m: {{initial: a, states: {{a: {{flows: {{{flows}}}}}}}}}
  e:
    initial: w
    states: {{w: {{}}, d: {{}}}}
    transitions: [{{name: hit, from: w, to: d, guard: "{guard}"}}]
stop: {{time: {time}}}
"""


def scene(*, guard: str = "", stop: str = "", enabled: str = "", start: float = -1) -> str:
    """Return a ball that slides on a floor past x = 0."""
    region = f"""
controls: {{push: 0}}
forces: {{f: {{body: ball, force: [0, push]}}}}
regions:
  c:
    initial: w
    states: {{w: {{}}, "on": {{sets: {{push: 0.5}}}}}}
    transitions: [{{name: hit, from: w, to: "on", guard: "{guard}"}}]
"""
    return f"""
kind: scene
name: window
gravity: 9.81
bodies: {{ball: {{mass: 1, start: {{x: {start}, dx: 1}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts:
  b:
    point: {{body: ball}}
    surface: floor
    modes: [free, slide]
    friction: 0
    restitution: 0
    {f'enabled: "{enabled}"' if enabled else ""}
{region if guard else ""}
stop: {{time: 2{f', conditions: {{end: "{stop}"}}' if stop else ""}}}
"""


def made(text: str, engine: str) -> Any:
    return run(read_text(text), engine=engine)


# Guard, and when it becomes true for x = t - 1.
WIDE = [
    ("x**2 <= 1e-14", 1 - 1e-7),
    ("x**2 <= 1e-20", 1 - 1e-10),
    ("x**4 <= 1e-28", 1 - 1e-7),
    ("abs(x) <= 1e-12", 1 - 1e-12),
    ("(x - 1)*(x - 1 - 1e-7) <= 0", 2),
    ("(x - 1)**2*(x - 3)**2 <= 1e-14", 2 - 5e-8),
    ("cos(x) >= 1 - 5e-14", 1 - math.acos(1 - 5e-14)),
    ("cos(time - 1) >= 1 - 5e-14", 1 - math.acos(1 - 5e-14)),
]
NARROW = [
    "x**2 <= 0",
    "x**2 <= 1e-30",
    "(x - 1)*(x - 1 - 1e-13) <= 0",
    "sin(x) >= 1",
    "sin(x) >= 1 - 1e-15",
    "sin(time) >= 1 - 1e-15",
]


@both
@pytest.mark.parametrize(("guard", "at"), WIDE)
def test_a_guard_fires_where_its_window_begins(engine: str, guard: str, at: float) -> None:
    result = made(chart(guard), engine)
    (jump,) = result.trace.jumps
    # A cosine near 1 is known to its last bit, which is worth 3e-10 of its angle there.
    assert jump.t == pytest.approx(at, abs=1e-9 if "cos" in guard else 1e-11)
    # The error of SciPy exceeds the least of these windows, but delays both of its sides alike.
    assert not result.warnings


@both
@pytest.mark.parametrize("guard", NARROW)
def test_a_window_as_narrow_as_round_off_is_reported(engine: str, guard: str) -> None:
    result = made(chart(guard), engine)
    assert not result.trace.jumps
    (warning,) = result.warnings
    assert warning.startswith("e.hit grazes its boundary")
    assert OPEN in warning


@both
def test_a_run_locates_every_window_of_a_swing(engine: str) -> None:
    text = chart("x**2 <= 1e-16", "x: 1, v: 0, n: 0", "x: v, v: -x", 20).replace(
        'transitions: [{name: hit, from: w, to: d, guard: "x**2 <= 1e-16"}]',
        "transitions:\n"
        '      - {name: hit, from: w, to: d, guard: "x**2 <= 1e-16", updates: {n: n + 1}}\n'
        '      - {name: left, from: d, to: w, guard: "x**2 >= 1e-16"}',
    )
    result = made(text, engine)
    expected = [math.pi * (k + 0.5) + side * 1e-8 for k in range(6) for side in (-1, 1)]
    assert [jump.t for jump in result.trace.jumps] == pytest.approx(expected, abs=2e-10)


@both
@pytest.mark.parametrize("width", [1e-7, 3e-9])
@pytest.mark.parametrize("loop", [True, False])
def test_scenes_see_windows_in_guards_stops_and_conditions(
    engine: str, width: float, loop: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(CompiledSceneLaws, "ready", lambda _: loop)
    monkeypatch.setattr(compiled_loop, "_WORTH_COMPILING", -1 if loop else math.inf)
    for cause, text in (
        ("hit", scene(guard=f"ball.x**2 <= {width**2!r}")),
        ("stop", scene(stop=f"ball.x**2 <= {width**2!r}")),
        ("disable", scene(enabled=f"ball.x**2 >= {width**2!r}")),
    ):
        runner = Runner(read_text(text), engine=engine)
        runner.run()  # every mode is known to the loop
        jump, *others = runner.run().trace.jumps
        assert (jump.cause, jump.t) == (cause, pytest.approx(1 - width, abs=1e-12))
        # The ball has fallen by less than the gap tolerance as its contact comes back.
        assert [one.cause for one in others] == ["enable", "touchdown"] * (cause == "disable")


@both
def test_scenes_report_windows_as_narrow_as_round_off(engine: str) -> None:
    for text in (scene(guard="ball.x**2 <= 0"), scene(stop="ball.x**2 <= 1e-29")):
        result = made(text, engine)
        assert not result.trace.jumps
        assert [OPEN in warning for warning in result.warnings] == [True]


@both
@pytest.mark.parametrize("at", [0.05, 0.9, 9.3, 9.97])
def test_tangency_anywhere_in_a_step_is_reported(engine: str, at: float) -> None:
    result = made(chart(f"(x + 1 - {at})**2 <= 0"), engine)
    assert not result.trace.jumps
    (warning,) = result.warnings
    assert f"at t = {at:.6g}," in warning


@both
def test_narrow_window_starting_on_its_boundary_is_reported(engine: str) -> None:
    # At the start the margin is zero and rises: its tolerance there exceeds the later window.
    result = made(chart("(x + 1)*(x**2 - 1e-14) <= 0"), engine)
    times = [jump.t for jump in result.trace.jumps]
    assert times == pytest.approx([1 - 1e-7], abs=1e-9) or any(
        "does not fire" in warning for warning in result.warnings
    )
