"""Contacts, controllers and stop conditions at one instant: in this order, as with events."""

from __future__ import annotations

from typing import Any

import pytest

from statechart import Runner
from statechart.automaton.trace import Trace
from statechart.documents.yaml_reader import read_text

STEP = 1e-3

POINT = """\
bodies: {b: {mass: 1, START}}
surfaces: {floor: {height: 0}}
contacts: {k: {point: {body: b}, surface: floor, friction: 0.5, restitution: e}}
"""
SHAPE = """\
bodies: {b: {mass: 1, inertia: 0.1, shape: {disc: 1}, START}}
surfaces: {floor: {height: 0}}
collisions: {a: {bodies: [b], surfaces: [floor], friction: 0.5, restitution: e}}
"""
SCENE = """\
kind: scene
name: order
gravity: 10
parameters: {{e: 0.5}}
{body}
regions:
  c:
    initial: a
    variables: {{n: 0}}
    states: {{a: {{}}, b: {{}}}}
    transitions: [{{name: go, from: a, {go}, updates: {{n: n + 1}}}}]
stop: {{time: 1, conditions: {{met: {stop}}}}}
"""


def run(text: str, step: float | None) -> Trace:
    setting: Any = {} if step is None else {"engine": "impulse", "step": step}
    return Runner(read_text(text), **setting).run().trace


def events(trace: Trace) -> list[tuple[str, str]]:
    return [(jump.region, jump.cause) for jump in trace.jumps]


@pytest.mark.parametrize("body", [POINT, SHAPE], ids=["point", "shape"])
@pytest.mark.parametrize(
    ("start", "go", "stop", "times"),
    [
        ("dy: 4", "to: b, guard: b.dy <= 0", "b.dy <= 0", (0.4, 0.4)),
        ("dy: 4.003", "to: b, guard: b.dy <= 0", "b.dy <= 0", (0.4003, 0.4003)),
        ("dy: 4", "to: b, after: 0.4", "time >= 0.4", (0.4, 0.4)),
        ("dy: 4", "every: 0.1", "b.dy <= 1", (0.1, 0.2, 0.3, 0.3)),
        ("dy: 4", "to: b, guard: b.dy <= 2.5", "in(c.b)", (0.15, 0.15)),
        ("dy: 4", "to: b, guard: b.dy <= 2.503", "n >= 1", (0.1497, 0.1497)),
        ("dy: 4", "to: b, guard: b.dy >= 3", "b.dy >= 1", (0.0, 0.0)),
        # The stop comes before the transition of the same step, or is over with it.
        ("dy: 4.003", "to: b, guard: b.dy <= 0", "b.dy <= 0.005", (0.3998,)),
        ("dy: 4", "to: b, guard: b.dy <= 0", "b.dy <= 0 and in(c.a)", (0.4,)),
        ("dy: 4.003", "to: b, guard: b.dy <= 0", "b.dy <= 0 and n < 1", (0.4003,)),
    ],
)
def test_a_stop_comes_after_the_transitions_of_its_instant(
    body: str, start: str, go: str, stop: str, times: tuple[float, ...]
) -> None:
    """The body rises by 4 t - 5 t^2."""
    body = body.replace("START", f"start: {{y: {int(body is SHAPE)}, {start}}}")
    text = SCENE.format(body=body, go=go, stop=stop)
    for step in (STEP, *([None] if "contacts" in body else [])):
        acts = [jump for jump in run(text, step).jumps if jump.region in ("c", "")]
        assert [jump.t for jump in acts] == [pytest.approx(t, abs=step or 1e-9) for t in times]
        ends = " and " not in stop
        assert [jump.cause for jump in acts] == ["go"] * (len(times) - ends) + ["stop"] * ends


@pytest.mark.parametrize("step", [None, 1e-3, 1e-4])
def test_a_stop_asks_for_the_state_of_a_controller_that_listens_to_a_touchdown(
    step: float | None,
) -> None:
    text = SCENE.format(
        body=POINT.replace("START", "start: {y: 1}"), go="to: b, on: k.touchdown", stop="in(c.b)"
    )
    trace = run(text, step)
    assert events(trace) == [("k", "touchdown"), ("c", "go"), ("", "stop")]
    assert trace.final_mode == ("free", "b")
    assert trace.t_end == pytest.approx(0.2**0.5, abs=step or 1e-9)


@pytest.mark.parametrize("step", [None, 1e-3, 1e-4])
@pytest.mark.parametrize("record", ["modes", "poses", "nothing"])
@pytest.mark.parametrize("speed", [3.0, 3.0025])
@pytest.mark.parametrize("controlled", [False, True])
def test_a_stop_asks_for_the_mode_of_a_contact(
    step: float | None, record: str, speed: float, controlled: bool
) -> None:
    """The slip 3 - 5 t ends at 0.6 in this mode, and not before."""
    body = POINT.replace("START", f"start: {{dx: {speed}}}")
    text = SCENE.format(body=body, go="to: b, on: k.stick", stop="in(k.pin)")
    if not controlled:
        text = text[: text.index("regions")] + text[text.index("stop") :]
    if step is not None:
        text += f"settings: {{record: {record}}}\n"
    trace = run(text, step)
    assert trace.t_end == pytest.approx(speed / 5, abs=step or 1e-9)
    if record == "modes" or step is None:
        assert trace.final_mode == (("pin", "b") if controlled else ("pin",))
        turn = [("c", "go")] if controlled else []
        assert events(trace) == [("k", "stick"), *turn, ("", "stop")]


@pytest.mark.parametrize("step", [None, 1e-3, 1e-4])
@pytest.mark.parametrize("speed", [2.5, 2.5025])
def test_a_contact_sticks_before_controllers_act(step: float | None, speed: float) -> None:
    body = POINT.replace("START", f"start: {{dx: {speed}}}")
    text = SCENE.format(body=body, go="to: b, guard: b.dx <= 0", stop="time >= 0.9").replace(
        "stop:",
        """\
  d:
    initial: waits
    states: {waits: {}, stuck: {}, late: {}}
    transitions:
      - {name: late, from: waits, to: late, on: c.go}
      - {name: stuck, from: waits, to: stuck, on: k.stick}
stop:""",
    )
    trace = run(text, step)
    assert events(trace)[:3] == [("k", "stick"), ("c", "go"), ("d", "stuck")]
    assert [jump.t for jump in trace.jumps[:3]] == [pytest.approx(speed / 5, abs=step or 1e-9)] * 3


_PRESS = """\
kind: scene
name: press
gravity: 10
{body}
controls: {{push: 0}}
forces: {{p: {{body: b, force: [0, -push]}}}}
regions:
  c:
    initial: press
    states: {{press: {{sets: {{push: {push}}}}}, rest: {{sets: {{push: {rest}}}}}, alarm: {{}}}}
    transitions:
      - {{name: enough, from: press, to: rest, {enough}}}
      - {{name: alarm, from: rest, to: alarm, guard: "{alarm}"}}
stop: {{time: 1}}
"""
_ROPE = (
    "bodies: {b: {mass: 1, inertia: 1, SHAPEstart: {y: -1}}}\n"
    "joints: {k: {point: {body: b}, to: [0, 0], rope: 1}}\n"
)


@pytest.mark.parametrize("step", [None, 1e-3, 1e-4])
@pytest.mark.parametrize(
    "body", [POINT.replace("START", "start: {y: 0}"), _ROPE], ids=["contact", "rope"]
)
@pytest.mark.parametrize(
    ("push", "enough", "rest", "alarm", "times"),
    [
        # The force is 10 + push: the state just entered never has the one of the state left.
        ("20*time", "guard: k.V >= 20", 0, "k.V >= 15", [0.5]),
        ("20", "after: 0.5", 0, "k.V >= 15", [0.5]),
        ("20", "after: 0.5", 0, "k.V > 10 and k.V < 31", [0.5]),
        ("0", "after: 0.5", 20, "k.V >= 15", [0.5, 0.5]),
        ("0", "after: 0.5", 0, "k.V >= 5", [0.5, 0.5]),
        ("0", "after: 0.5", "40*(time - 0.5)", "k.V >= 20", [0.5, 0.75]),
    ],
)
def test_a_guard_of_a_state_just_entered_knows_its_forces(
    body: str, step: float | None, push: str, enough: str, rest: object, alarm: str, times: Any
) -> None:
    text = _PRESS.format(body=body, push=push, enough=enough, rest=rest, alarm=alarm)
    for shape in ("", "shape: {disc: 0.1}, ")[: 2 if step and "SHAPE" in body else 1]:
        scene = text.replace("SHAPE", shape).replace("restitution: e", "restitution: 0")
        if shape:
            scene += "surfaces: {floor: {height: -9}}\n"
            scene += (
                "collisions: {a: {bodies: [b], surfaces: [floor], friction: 0, restitution: 0}}"
            )
        fired = [jump.t for jump in run(scene, step).jumps if jump.region == "c"]
        assert fired == [pytest.approx(t, abs=2.5 * step if step else 1e-9) for t in times]


@pytest.mark.parametrize("step", [None, 1e-3, 1e-4])
@pytest.mark.parametrize(("push", "rest"), [(20, 0), (0, 20)])
def test_a_listener_to_a_transition_knows_the_forces_of_the_state_entered(
    push: int, rest: int, step: float | None
) -> None:
    body = POINT.replace("START", "start: {y: 0}").replace("restitution: e", "restitution: 0")
    text = _PRESS.format(body=body, push=push, rest=rest, enough="after: 0.5", alarm="1 < 0")
    listener = """  d:
    initial: quiet
    states: {quiet: {}, alarm: {}}
    transitions: [{name: alarm, from: quiet, to: alarm, on: c.enough, guard: "k.V >= 15"}]
"""
    text = text.replace("stop: {time", listener + "stop: {time")
    # The force is 10 + push, and that of the state entered 10 + rest.
    fired = [jump.cause for jump in run(text, step).jumps]
    assert fired == ["enough", "alarm"][: 2 if rest else 1]


@pytest.mark.parametrize("step", [None, 1e-3, 1e-4])
@pytest.mark.parametrize("speed", [1.0, 1.0003])
@pytest.mark.parametrize(("back", "end"), [(20, None), (5, 1.0)])
def test_a_stop_that_a_transition_turns_back_gives_a_warning(
    back: float, end: float | None, speed: float, step: float | None
) -> None:
    """The rate falls as 10 t until 0.5, and rises again if the controller pushes with 20."""
    body = "bodies: {b: {mass: 1, START}}\n".replace("START", f"start: {{dy: {5 * speed}}}")
    push = "controls: {F: 0}\nforces: {f: {body: b, force: [0, F]}}\n"
    text = SCENE.format(
        body=body + push, go="to: b, guard: b.dy <= 0", stop="b.dy <= 0 and time > 0.1"
    ).replace("b: {}}", f"b: {{sets: {{F: {back}}}}}}}")
    trace = run(text, step)
    assert trace.t_end == pytest.approx(1 if end is None else speed / 2, abs=step or 1e-9)
    turned = [w for w in trace.warnings if w.startswith("met ")]
    # With events only a stop of one relation is named.
    assert step is None or len(turned) == (end is None)


@pytest.mark.parametrize("step", [None, 1e-3, 1e-4])
@pytest.mark.parametrize("stop", ["k.V >= 30", "k.V > 25", "push >= 20", "not push < 20"])
@pytest.mark.parametrize(("trigger", "end"), [("after: 0.5", 0.5), ("guard: b.y >= 0", 0.0)])
def test_a_stop_knows_the_forces_and_controls_of_the_state_just_entered(
    trigger: str, end: float, stop: str, step: float | None
) -> None:
    text = _PRESS.format(
        body=POINT.replace("START", "start: {y: 0}"), push=0, rest=20, enough=trigger, alarm="1 < 0"
    ).replace("stop: {time: 1}", f"stop: {{time: 1, conditions: {{met: {stop}}}}}")
    trace = run(text.replace("restitution: e", "restitution: 0"), step)
    assert events(trace) == [("c", "enough"), ("", "stop")]
    assert trace.t_end == pytest.approx(end, abs=2.5 * step if step else 1e-9)
