"""Impacts of points that touch in turn within a step."""

from __future__ import annotations

import math

import numpy as np
import pytest

from statechart import run
from statechart.documents.yaml_reader import read_text

G = 9.81

BAR = """
kind: scene
name: bar
gravity: 9.81
bodies: {s: {mass: 1, inertia: 0.08, start: {y: 9.81*0.45**2/2, angle: TILT}}}
surfaces: {floor: {height: 0}}
contacts:
  r: {point: {body: s, at: [0.5, 0]}, surface: floor, friction: 0, restitution: E, impact: moreau}
  l: {point: {body: s, at: [-0.5, 0]}, surface: floor, friction: 0, restitution: E, impact: moreau}
stop: {time: 0.5}
settings: {engine: impulse, step: STEP}
"""


@pytest.mark.parametrize(
    ("tilt", "e", "step", "warns"),
    [
        (4e-4, 0.5, 1e-3, True),
        (4e-4, 0.5, 2e-5, False),
        (4e-4, 0.0, 1e-3, False),
        (0, 0.5, 1e-3, False),
    ],
)
def test_elastic_impacts_in_turn_that_a_step_makes_at_once_are_told(
    tilt: float, e: float, step: float, warns: bool
) -> None:
    text = BAR.replace("TILT", str(tilt)).replace("E,", f"{e},").replace("STEP", str(step))
    warnings = [line for line in run(read_text(text)).warnings if "at once" in line]
    assert len(warnings) == int(warns)
    # The ends are at heights that differ by 2 L sin(tilt), and fall with g t.
    apart = math.sin(tilt) / (G * 0.45)
    assert all(f"r and l touch {apart:.2g} apart" in line for line in warnings)


TWO = """
kind: scene
name: two
gravity: 10
bodies:
  a: {mass: 1, start: {x: 0, y: YA, dx: 1}}
  b: {mass: 1, start: {x: 2, y: YB, dx: 1}}
surfaces: {floor: {height: 0}}
contacts:
  c: {point: {body: a}, surface: floor, friction: 0.5, restitution: EA}
  d: {point: {body: b}, surface: floor, friction: 0.5, restitution: EB}
regions:
  who:
    initial: nobody
    states: {nobody: {}, a: {}, b: {}}
    transitions: [FIRST, SECOND]
"""
LOWER = 0.9999


def two(lower: str, restitution: tuple[float, float] = (0.0, 0.0), declared: str = "ab") -> str:
    """Return two points that fall from 1 and 0.9999, and touch 2.2e-5 apart."""
    on = {
        "a": "{name: go, from: nobody, to: a, on: c.touchdown}",
        "b": "{name: to, from: nobody, to: b, on: d.touchdown}",
    }
    values = {
        "YA": LOWER if lower == "a" else 1.0,
        "YB": LOWER if lower == "b" else 1.0,
        "EA": restitution[0],
        "EB": restitution[1],
        "FIRST": on[declared[0]],
        "SECOND": on[declared[1]],
    }
    text = TWO
    for name, value in values.items():
        text = text.replace(name, str(value))
    return text


@pytest.mark.parametrize("step", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("restitution", [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5)])
@pytest.mark.parametrize("declared", ["ab", "ba"])
@pytest.mark.parametrize("lower", ["a", "b"])
def test_controllers_hear_the_touchdowns_of_a_step_in_their_order(
    lower: str, declared: str, restitution: tuple[float, float], step: float
) -> None:
    text = two(lower, restitution, declared) + "stop: {time: 0.5}\n"
    trace = run(read_text(text), engine="impulse", step=step).trace
    assert trace.final_mode[-1] == lower
    found = [(jump.region, jump.t) for jump in trace.jumps if jump.cause == "touchdown"]
    first, second = ("c", "d") if lower == "a" else ("d", "c")
    assert [name for name, _ in found] == [first, second]
    assert found[0][1] == pytest.approx(math.sqrt(2.0 * LOWER / 10.0), abs=step)
    assert found[1][1] == pytest.approx(math.sqrt(2.0 / 10.0), abs=step)


def test_landings_of_a_step_are_jumps_of_their_own() -> None:
    text = two("b") + "stop: {time: 0.5}\n"
    trace = run(read_text(text), engine="impulse", step=1e-3).trace
    b, a, who = trace.jumps
    assert (b.region, a.region, who.region) == ("d", "c", "who")
    for jump, height, name in ((b, LOWER, "d"), (a, 1.0, "c")):
        # Of second order in the step.
        assert jump.t == pytest.approx(math.sqrt(0.2 * height), abs=1e-6)
        assert list(jump.impulse) == [name]
        np.testing.assert_allclose(jump.before[:4], jump.after[:4], rtol=0, atol=1e-5)
        assert jump.energy is not None
        # All of its own energy: friction stops the point, as 0.5 sqrt(20) > 1.
        assert jump.energy[0] - jump.energy[1] == pytest.approx(10.0 * height + 0.5, abs=1e-5)


def test_a_stop_between_the_landings_of_a_step_ends_the_run_there() -> None:
    text = two("a").partition("regions:")[0] + "stop: {time: 1, conditions: {low: b.y <= 5e-5}}\n"
    trace = run(read_text(text), engine="impulse", step=1e-3).trace
    assert trace.t_end == pytest.approx(math.sqrt(0.2 * (1.0 - 5e-5)), abs=1e-6)
    assert [jump.region for jump in trace.jumps] == ["c", ""]
    assert trace.final_mode == ("pin", "free")
    np.testing.assert_allclose(trace.final[[1, 3]], [0.0, 5e-5], rtol=0, atol=1e-5)


LIFT = """
kind: scene
name: lift
gravity: 10
bodies: {b: {mass: 1, start: {dx: 9}}}
surfaces: {floor: {height: 0}}
contacts: {k: {point: {body: b}, surface: floor, friction: MU, restitution: 0}}
controls: {F: 0}
forces: {up: {body: b, force: [0, 30*time + F]}}
regions:
  c:
    initial: down
    states: {down: {}, up: {sets: {F: PUSH}}}
    transitions: [{name: leave, from: down, to: up, on: k.liftoff}]
stop: {time: 0.5}
"""


@pytest.mark.parametrize("step", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("friction", [0.0, 0.1])
def test_controllers_hear_a_liftoff_when_it_is_recorded(friction: float, step: float) -> None:
    """The force 30 t lifts the weight 10 at t = 1/3; then another 10 drive the body."""
    text = LIFT.replace("MU", str(friction)).replace("PUSH", "10")
    trace = run(read_text(text), engine="impulse", step=step).trace
    assert [(jump.region, jump.cause) for jump in trace.jumps] == [("k", "liftoff"), ("c", "leave")]
    lifts, leaves = trace.jumps
    assert leaves.t == lifts.t == pytest.approx(1.0 / 3.0, abs=0.51 * step)
    t = 0.5 - 1.0 / 3.0
    assert trace.final[3] == pytest.approx(15.0 * t**2 + 10.0 * t, abs=6.0 * step)
    assert trace.final[1] == pytest.approx(5.0 * t**3 + 5.0 * t**2, abs=2.0 * step)


@pytest.mark.parametrize("step", [1e-2, 1e-3])
def test_a_liftoff_that_its_controller_undoes_has_no_flight(step: float) -> None:
    trace = run(
        read_text(LIFT.replace("MU", "0.1").replace("PUSH", "-40")), engine="impulse", step=step
    ).trace
    lifts, leaves, lands = trace.jumps
    assert (lifts.cause, leaves.cause, lands.cause) == ("liftoff", "leave", "touchdown")
    assert lifts.t == leaves.t == lands.t
    assert trace.final[3] == 0.0
