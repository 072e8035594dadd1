"""Points on surfaces that controllers move, against closed forms."""

from __future__ import annotations

import math
from typing import Any

import pytest

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.result import Result
from statechart.running.runner import Runner

G = 9.81
ENGINES = ("{engine: taylor}", "{engine: scipy}", "{engine: impulse, step: 1e-4}")


def _run(text: str, settings: str, until: float, **further: Any) -> Result:
    whole = f"kind: scene\nname: n\ngravity: {G}\n{text}\nsettings: {settings}\n"
    return Runner(interpret(read_text(whole))).run(until=until, **further)


LIFT = """
parameters: {v: 1.2, e: 0}
bodies: {ball: {mass: 1}}
surfaces: {plate: {height: 0, displacement: [0, s]}}
contacts: {foot: {point: {body: ball}, surface: plate, friction: 0.3, restitution: e}}
regions:
  drive:
    initial: rests
    variables: {s: 0}
    states: {rests: {}, lifts: {flows: {s: v}}, holds: {}}
    transitions:
      - {name: go, from: rests, to: lifts, after: 0.25}
      - {name: done, from: lifts, to: holds, guard: s >= 0.6}
outputs:
  top: {maximum: ball.y}
  lands: {value: time, at: last foot.touchdown}
"""


@pytest.mark.parametrize("settings", ENGINES)
def test_a_plate_that_starts_strikes_and_one_that_stops_throws(settings: str) -> None:
    result = _run(LIFT, settings, 1.5)
    near = 1e-9 if "impulse" not in settings else 3e-4
    assert result.outputs["top"] == pytest.approx(0.6 + 1.2**2 / (2 * G), abs=near)
    assert result.outputs["lands"] == pytest.approx(0.75 + 2 * 1.2 / G, abs=near)
    assert result.trace.final[1] == pytest.approx(0.6, abs=near)


@pytest.mark.parametrize("settings", ENGINES)
def test_the_jump_opens_the_contact_and_the_impact_follows(settings: str) -> None:
    trace = _run(LIFT.replace("e: 0}", "e: 0.5}"), settings, 0.35).trace
    near = 1e-12 if "impulse" not in settings else 3e-4
    go, struck = trace.jumps[:2]
    assert (go.region, go.cause) == ("drive", "go")
    assert go.target == ("free", "lifts")
    assert (struck.region, struck.cause) == ("foot", "touchdown")
    assert [go.t, struck.t] == pytest.approx([0.25, 0.25], abs=near)
    assert struck.impulse["foot"][0] == pytest.approx(1.2 * 1.5, abs=10 * near)
    # It flies off with e v against the plate.
    assert trace.final[1] == pytest.approx(1.8 * 0.1 - G / 2 * 0.1**2, abs=near)


TABLE = """
parameters: {a: 3}
bodies: {box: {mass: 2}}
surfaces: {table: {height: 0, displacement: [s, 0]}}
contacts: {foot: {point: {body: box}, surface: table, friction: 0.2, restitution: 0}}
regions:
  drive:
    initial: speeds
    variables: {s: 0, u: 0}
    states: {speeds: {flows: {s: u, u: a}}, stands: {}}
    transitions: [{name: halt, from: speeds, to: stands, after: 0.5}]
outputs:
  slips: {value: foot.slip, at: first halt, before: true}
  rests: {value: time, at: first foot.stick}
"""


@pytest.mark.parametrize("settings", ENGINES)
def test_a_table_that_speeds_up_under_a_box_and_halts(settings: str) -> None:
    # The table's acceleration is that of a variable that another one lets flow: a box slips where
    # it is above mu g, and gains mu g t; the table halts at once, and friction brakes the box.
    mu_g = 0.2 * G
    result = _run(TABLE, settings, 1.2)
    near = 1e-9 if "impulse" not in settings else 3e-4
    assert result.outputs["slips"] == pytest.approx((mu_g - 3) * 0.5, abs=near)
    assert result.outputs["rests"] == pytest.approx(1.0, abs=near)
    assert result.trace.final[0] == pytest.approx(mu_g * 0.5**2, abs=near)


def test_a_box_is_carried_below_the_limit_of_friction() -> None:
    trace = _run(TABLE.replace("a: 3", "a: 1.5"), ENGINES[0], 0.45).trace
    assert [jump.cause for jump in trace.jumps] == []
    assert trace.final[0] == pytest.approx(0.75 * 0.45**2, rel=1e-12)
    assert trace.final[2] == pytest.approx(1.5 * 0.45, rel=1e-12)


SWING = """
parameters: {w: 2}
bodies: {bead: {mass: 1, start: {x: 1}}}
surfaces: {arm: {height: 0, turn: q}}
contacts: {foot: {point: {body: bead}, surface: arm, friction: 0, restitution: 0}}
regions:
  motor:
    initial: waits
    variables: {q: 0}
    states: {waits: {}, turns: {flows: {q: w}}}
    transitions: [{name: go, from: waits, to: turns, after: 0.1}]
"""


@pytest.mark.parametrize("settings", ENGINES)
def test_a_bead_on_a_driven_arm_follows_the_closed_form(settings: str) -> None:
    # r'' = w^2 r - g sin(w t) from r = 1, r' = 0: r = (1 - c) cosh(w t) ... with c = g/(2 w^2).
    w, t = 2.0, 0.4
    c = G / (2 * w**2)
    r = math.cosh(w * t) - c * math.sinh(w * t) + c * math.sin(w * t)
    result = _run(SWING, settings, 0.1 + t)
    near = 1e-9 if "impulse" not in settings else 1e-3
    assert result.trace.final[:2] == pytest.approx(
        [r * math.cos(w * t), r * math.sin(w * t)], abs=near
    )


STEP = """
bodies: {ball: {mass: 1, start: {y: 1}}}
surfaces: {shelf: {height: 0, displacement: [0, h]}}
contacts: {foot: {point: {body: ball}, surface: shelf, friction: 0.3, restitution: 0}}
controls: {h: 1}
regions:
  lever:
    initial: up
    states: {up: {}, down: {sets: {h: TO}}}
    transitions: [{name: drop, from: up, to: down, after: 0.2}]
outputs: {lands: {value: time, at: last foot.touchdown}}
"""


@pytest.mark.parametrize("settings", ENGINES)
def test_shelf_that_jumps_away_releases_its_load(settings: str) -> None:
    result = _run(STEP.replace("TO", "0.5"), settings, 1.0)
    near = 1e-9 if "impulse" not in settings else 3e-4
    assert result.outputs["lands"] == pytest.approx(0.2 + math.sqrt(2 * 0.5 / G), abs=near)
    assert result.trace.final[1] == pytest.approx(0.5, abs=near)


@pytest.mark.parametrize("settings", ENGINES)
def test_a_shelf_that_jumps_into_a_point_ends_the_run(settings: str) -> None:
    trace = _run(STEP.replace("TO", "1.2"), settings, 1.0, throw=False).trace
    assert trace.outcome is Outcome.NO_CONSISTENT_MODE
    assert "surface 'shelf' jumps 0.2 deep into the point of 'foot'" in trace.message


def test_a_path_that_depends_on_bodies_is_refused() -> None:
    with pytest.raises(DeclarationError, match=r"'s' moves a surface, and depends on 'ball\.x'"):
        _run(LIFT.replace("{s: v}", "{s: ball.x}"), ENGINES[0], 1.0)
    with pytest.raises(DeclarationError, match=r"'h' moves a surface, and depends on 'ball\.y'"):
        _run(STEP.replace("TO", "ball.y"), ENGINES[0], 1.0)


@pytest.mark.parametrize("settings", ENGINES)
def test_a_contact_that_may_not_open_is_not_torn_open(settings: str) -> None:
    text = LIFT.replace("restitution: e}", "modes: [slide, pin]}").split("outputs:")[0]
    trace = _run(text, settings, 1.0, throw=False).trace
    assert trace.outcome is Outcome.NO_CONSISTENT_MODE
    assert "'foot' would be free, which is not among its modes" in trace.message
