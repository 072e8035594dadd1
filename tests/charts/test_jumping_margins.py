"""Guards and conditions whose margin jumps over zero: an angle at its branch cut, a sign."""

from __future__ import annotations

import math

import pytest

from contacts.event_driven.compiled_laws import CompiledSceneLaws
from statechart import Runner, run
from statechart.documents.yaml_reader import read_text
from statechart.execution import compiled_loop

both = pytest.mark.parametrize("engine", ["taylor", "scipy"])


def turning(guard: str, start: str = "x: 1, y: 0", flows: str = '{x: "-y", y: x}') -> str:
    return f"""
kind: chart
name: turns
variables: {{{start}}}
regions:
  m: {{initial: a, states: {{a: {{flows: {flows}}}}}}}
  e:
    initial: w
    states: {{w: {{}}, d: {{}}}}
    transitions: [{{name: hit, from: w, to: d, guard: "{guard}"}}]
stop: {{time: 10}}
"""


CLOCKWISE = {"flows": '{x: y, y: "-x"}'}
CASES = [
    ("atan2(y, x) < 0", {}, math.pi),
    ("atan2(y, x) <= -3", {}, math.pi),
    ("atan2(y, x) > 0", CLOCKWISE, math.pi),
    ("atan2(y, -x) < 0", {"start": "x: -1, y: 1e-3", "flows": "{x: 0, y: -1}"}, 1e-3),
    ("atan2(y, x) < 0", {"start": "x: -1, y: 1", "flows": "{x: 0, y: -1}"}, 1),
    ("atan2(y, x) + y < 0", {}, math.pi),
    ("atan2(sin(time), cos(time)) < 0", {}, math.pi),
    ("atan2(y, x) <= -3", {"start": "x: -1, y: 0"}, 0),
    ("sign(x) <= 0", {}, math.pi / 2),
    ("sign(x) < 0", {}, math.pi / 2),
    ("sign(x)*y <= -0.5", {}, math.pi / 2),
    # No jump: the angle passes these where it is smooth.
    ("atan2(y, x) >= 3.14159", {}, 3.14159),
    ("abs(atan2(y, x)) > 3", {}, 3),
]


@both
@pytest.mark.parametrize(("guard", "how", "at"), CASES)
def test_a_guard_fires_where_its_margin_jumps(
    engine: str, guard: str, how: dict[str, str], at: float
) -> None:
    (jump,) = run(read_text(turning(guard, **how)), engine=engine).trace.jumps
    assert jump.t == pytest.approx(at, abs=1e-11)


@both
def test_an_angle_wraps_once_a_turn(engine: str) -> None:
    text = turning("atan2(y, x) < 0", "x: 1, y: 0, n: 0").replace(
        'guard: "atan2(y, x) < 0"}]',
        'guard: "atan2(y, x) < 0", updates: {n: n + 1}},\n'
        '      {name: back, from: d, to: w, guard: "atan2(y, x) > 0"}]',
    )
    result = run(read_text(text.replace("time: 10", "time: 30")), engine=engine)
    times = [jump.t for jump in result.trace.jumps if jump.cause == "hit"]
    assert times == pytest.approx([math.pi * (2 * k + 1) for k in range(5)], abs=1e-10)


SCENE = """
kind: scene
name: wraps
gravity: 9.81
bodies: {{ball: {{mass: 1, start: {{x: -1, dx: 1}}}}}}
surfaces: {{floor: {{height: 0}}}}
controls: {{push: 0}}
forces: {{f: {{body: ball, force: [0, push]}}}}
contacts:
  b:
    point: {{body: ball}}
    surface: floor
    modes: [free, slide]
    friction: 0
    restitution: 0
    {enabled}
regions: {{{region}}}
stop: {{time: 2{stop}}}
"""
REGION = (
    'c: {initial: w, states: {w: {}, "on": {sets: {push: 0.5}}},'
    ' transitions: [{name: hit, from: w, to: "on", guard: "atan2(ball.x, -1) > 0"}]}'
)
PLACES = [
    ("hit", {"region": REGION}),
    ("stop", {"stop": ", conditions: {end: 'atan2(ball.x, -1) > 0'}"}),
    ("disable", {"enabled": 'enabled: "atan2(ball.x, -1) < 0"'}),
]


@both
@pytest.mark.parametrize("loop", [True, False])
@pytest.mark.parametrize(("cause", "parts"), PLACES)
def test_scenes_see_the_jump_of_an_angle(
    engine: str, loop: bool, cause: str, parts: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(CompiledSceneLaws, "ready", lambda _: loop)
    monkeypatch.setattr(compiled_loop, "_WORTH_COMPILING", -1 if loop else math.inf)
    text = SCENE.format(**{"region": "", "stop": "", "enabled": "", **parts})
    if "region" not in parts:
        text = text.replace("controls: {push: 0}\n", "").replace("push]", "0]")
        text = text.replace("regions: {}\n", "")
    runner = Runner(read_text(text), engine=engine)
    runner.run()  # every mode is known to the loop
    (jump,) = runner.run().trace.jumps
    assert (jump.cause, jump.t) == (cause, pytest.approx(1, abs=1e-12))


@both
def test_a_guard_with_a_pole_is_refused_with_its_place(engine: str) -> None:
    result = run(read_text(turning("1/x < 0")), engine=engine, throw=False)
    assert result.trace.outcome.name == "NON_FINITE"
    assert "e.hit has no value near t = 1.5708" in result.trace.message


UNCUT = """
kind: chart
name: uncut
variables: {x: cos(2), y: sin(2)}
regions:
  m: {initial: a, states: {a: {flows: {x: -y, y: x}}}}
  e: {initial: w, states: {w: {}, d: {}}, transitions: [{name: hit, from: w, to: d, guard: GUARD}]}
stop: {time: 6}
outputs: {at: {value: time, at: first hit}}
"""


@pytest.mark.parametrize(
    ("guard", "at"),
    [
        ("atan2(abs(y), x) < 0.1", 2 * math.pi - 2.1),
        ("not atan2(abs(y), x) > 1", 2 * math.pi - 3),
        ("atan2(max(y, 0), x) <= 1", 1.5 * math.pi - 2),
        ("atan2(abs(y), abs(x)) < 0.1 and x > 0", 2 * math.pi - 2.1),
    ],
)
def test_an_angle_from_an_axis_does_not_wrap(guard: str, at: float) -> None:
    # It fired at pi - 2, where the angle of y itself wraps.
    found = run(read_text(UNCUT.replace("GUARD", f'"{guard}"'))).outputs["at"]
    assert found == pytest.approx(at, abs=1e-12)
