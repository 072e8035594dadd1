"""State of controllers: closed forms, and invariance where nothing depends on it."""

from __future__ import annotations

from typing import Any

import pytest

from contacts.scene.scene import Scene
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret, load
from statechart.running.result import Result
from statechart.running.runner import Runner

ENGINES = pytest.mark.parametrize("engine", ["taylor", "scipy"])

BALL = """\
kind: scene
name: ball
parameters: {h: 0.5, g: 10, e: 0.5, D: 0.1}
gravity: g
coordinates: {y: {start: h}}
bodies: {ball: {mass: 1, position: [0, y]}}
surfaces: {ground: {height: 0}}
contacts:
  floor: {point: {body: ball}, surface: ground, modes: [free, slide], friction: 0, restitution: e}
controls: {lift: 0}
forces: {rocket: {body: ball, force: [0, lift]}}
regions:
  counter:
    variables: {n: 0, fallen: 0, hit: -1}
    initial: active
    states:
      active: {flows: {fallen: h - y}}
    transitions:
      - {name: count, from: active, on: floor.touchdown, updates: {n: n + 1, hit: time}}
  burner:
    initial: waits
    states:
      waits: {}
      burns: {sets: {lift: 2*g}}
      done: {}
    transitions:
      - {name: ignite, from: waits, to: burns, guard: n >= 1}
      - {name: stop, from: burns, to: done, after: D}
stop: {time: 0.5}
outputs:
  n: {value: n}
  at_impact: {value: fallen, at: first floor.touchdown}
  ignited: {value: time, at: first burner.ignite}
  stopped: {value: time, at: first burner.stop}
  speed: {value: dy, at: first burner.stop}
  hit: {value: hit}
"""


def run(text: str, engine: str = "taylor") -> Result:
    return Runner(read_text(text, "f.yaml"), engine=engine).run()


@ENGINES
def test_controller_variables_count_integrate_and_time_out(engine: str) -> None:
    found = run(BALL, engine).outputs
    # It falls for sqrt(2 h / g), in which the integral of g t^2 / 2 is g t^3 / 6.
    fall = 0.1**0.5
    assert found["at_impact"] == pytest.approx(10 * fall**3 / 6, rel=1e-9)
    assert found["n"] == 1
    assert found["hit"] == pytest.approx(fall, rel=1e-12)
    assert found["ignited"] == pytest.approx(fall, rel=1e-12)
    assert found["stopped"] == pytest.approx(fall + 0.1, rel=1e-12)
    # It rebounds at half of g t, and is lifted by 2 g - g for 0.1.
    assert found["speed"] == pytest.approx(0.5 * 10 * fall + 10 * 0.1, rel=1e-9)


def test_controller_receives_superstate_entry() -> None:
    text = BALL.replace("e: 0.5, D", "e: 0, D")
    rested = text.replace("on: floor.touchdown", "on: floor.closed")
    assert run(rested).outputs["hit"] == pytest.approx(0.1**0.5, rel=1e-12)


IDLE: dict[str, Any] = {
    "idle": {
        "initial": "on",
        "variables": {"w": 1},
        "states": {"on": {"flows": {"w": "cos(time)"}}},
    }
}


@pytest.mark.parametrize("model", ["toppling_stick", "double_contact_bar", "sliding_ladder"])
def test_unused_variables_do_not_change_the_motion(model: str) -> None:
    plain = load(model)
    assert isinstance(plain, Scene)
    data = plain.model_dump(by_alias=True, exclude_unset=True)
    beside = Scene.model_validate({**data, "regions": IDLE})
    one, other = (Runner(m, engine="taylor").run() for m in (plain, beside))
    assert [j.cause for j in one.trace.jumps] == [j.cause for j in other.trace.jumps]
    for name, value in one.outputs.items():
        assert other.outputs[name] == pytest.approx(value, rel=1e-9, abs=1e-12)
    n = len(one.trace.final)
    assert other.trace.final[:n] == pytest.approx(one.trace.final, rel=1e-9, abs=1e-12)
    assert len(other.trace.final) == n + 1


@pytest.mark.parametrize(
    ("old", "new", "token", "words"),
    [
        ("after: D", "after: D - 0.1", "D - 0.1", "must be a finite time above 0"),
        ("{n: 0,", "{n: y,", "y,", "unknown name 'y'"),
        ("{n: 0,", "{h: 0,", "h: 0", "'h' is declared twice, first as parameters.h (line 3, c"),
        ("n: n + 1", "m: n + 1", "m: n", "no variable 'm' of region 'counter'"),
        (
            "burns: {sets",
            "burns: {flows: {n: 1}, sets",
            "n: 1}",
            "change variables of their own region alone; declare a variable of another name",
        ),
        ("guard: n >= 1", "guard: N >= 1", "N >=", "unknown name 'N'"),
        ("done: {}", "done: {states: {a: {}}}", "done:", "and no initial one"),
        ("done: {}", "done: {history: deep}", "deep", "is not inside a state that has states"),
    ],
)
def test_mistakes_in_variables_of_controllers_are_reported_with_their_place(
    old: str, new: str, token: str, words: str
) -> None:
    assert BALL.count(old) == 1
    text = BALL.replace(old, new)
    with pytest.raises(DeclarationError) as caught:
        interpret(read_text(text, "f.yaml"))
    at = text.index(token, BALL.index(old))
    line, column = text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at)
    assert words in str(caught.value)
    assert str(caught.value).startswith(f"f.yaml:{line}:{column}: "), str(caught.value)


MOVING_BOWL = """\
kind: scene
name: bowl
parameters: {k: 0.8, g: 2, a: 1.5}
gravity: g
regions: {counter: {initial: on, variables: {n: 5}, states: {on: {}}}}
bodies: {ball: {mass: 1, start: {x: 0.5, y: k/4}}}
surfaces: {bowl: {height: k*x**2, displacement: [0, a*time**2/2]}}
contacts: {c: {point: {body: ball}, surface: bowl, friction: 0, restitution: 0}}
stop: {time: 2}
outputs:
  energy: {value: (ball.dx**2 + (ball.dy - a*time)**2)/2 + (g + a)*(ball.y - a*time**2/2)}
  gap: {maximum: abs(c.gap)}
"""


@ENGINES
def test_a_ball_in_a_rising_bowl_conserves_energy_with_a_variable(engine: str) -> None:
    # In the frame of the bowl gravity is g + a.
    ran = run(MOVING_BOWL, engine)
    assert ran.trace.outcome.name == "HORIZON"
    assert ran.outputs["energy"] == pytest.approx(3.5 * 0.2, rel=1e-11)
    assert ran.outputs["gap"] <= 1e-11
    assert len(ran.trace.jumps) == 0
