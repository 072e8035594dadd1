"""Guards by steps that are true for less than a step, against closed forms."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

import statechart
from contacts.time_stepping import stepper
from contacts.time_stepping.chunk import SteppedSystem
from statechart.documents.yaml_reader import read_text

STEP = 1e-3

# A ball falls for 0.3, passes x = t, and rebounds at 3 E, by steps in the middle of a step.
BALL = """
kind: scene
name: ball
gravity: 10
bodies: {b: {mass: 1, start: {y: 0.45, dx: 1}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0, restitution: E}}
regions:
  r:
    initial: a
    states: {a: {}, b: {}}
    transitions: [{name: go, from: a, to: b, guard: "GUARD"}]
stop: {time: 0.6}
outputs: {t: {value: time, at: first r.go}}
"""


def by_steps(guard: str, restitution: float, stops: bool) -> tuple[float | None, list[str]]:
    """Return when a guard or a stop condition fires, and the warnings of it."""
    text = BALL.replace("E}", f"{restitution}}}").replace("GUARD", "time > 9" if stops else guard)
    if stops:
        text = text.replace("0.6}", f"0.6, conditions: {{go: '{guard}'}}}}")
    run = statechart.run(read_text(text), engine="impulse", step=STEP)
    jumps = [jump.t for jump in run.trace.jumps if jump.cause in ("go", "stop")]
    warnings = [re.sub("^r[.]", "", w) for w in run.warnings if "shorter step" in w]
    return (jumps[0] if jumps else None), warnings


@pytest.mark.parametrize("stops", [False, True])
@pytest.mark.parametrize(
    ("guard", "restitution", "fires", "warning"),
    [
        # The speed is 1.5 from 0.3 on.
        ("b.dy > 0 and b.x <= 0.3013", 0.5, 0.301, None),
        ("b.dy > 0 and b.x <= 0.3003", 0.5, None, "within the step of 0.001 at t = 0.3,"),
        ("b.dy > 0 and b.x <= 0.2993", 0.5, None, None),
        ("b.dy > 1.6 and b.x <= 0.3013", 0.5, None, None),
        ("b.dy > 1 and b.dy < -1", 0.5, None, None),
        # The force is 10 from 0.3 on, and steps know it from 0.304 on.
        ("c.V >= 5 and b.x <= 0.3045", 0.0, 0.304, None),
        ("c.V >= 5 and b.x <= 0.3015", 0.0, None, "before t = 0.304,"),
        ("c.V >= 15 and b.x <= 0.3015", 0.0, None, None),
        ("c.V >= 5 and b.x <= 0.2995", 0.0, None, None),
        ("c.V >= 15 or b.x >= 0.55 and b.x > 0.3003", 0.0, 0.55, None),
        ("c.V >= 5 and b.x >= 0.5003 and b.x <= 0.5007", 0.0, None, "within the step"),
        ("c.V >= 15 and b.x >= 0.5003 and b.x <= 0.5007", 0.0, None, None),
    ],
)
def test_guards_on_quantities_that_an_impact_changes(
    guard: str, restitution: float, fires: float | None, warning: str | None, stops: bool
) -> None:
    found, warnings = by_steps(guard, restitution, stops)
    # A stop is located within its step.
    late = 1.1 * STEP if stops else 1e-9
    assert found == (None if fires is None else pytest.approx(fires, abs=late))
    assert len(warnings) == (warning is not None)
    assert all(w.startswith(f"go is true {warning}") for w in warnings)


@pytest.mark.parametrize(
    ("guard", "when"),
    [
        ("c.V >= 5 and b.x <= 0.3015", "before t = 0.304,"),
        # It is true about x = (pi/2 + 2 pi k)/(40 pi) for less than a step: 0.0125, 0.0625, ...
        ("sin(40*pi*b.x) > 0.999 and b.y > -9", "at t = 0.012,"),
    ],
)
def test_the_size_of_chunks_changes_no_warning(
    guard: str, when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for size in (512, 64, 1):
        monkeypatch.setattr(stepper, "_CHUNK", size)
        fires, (warning,) = by_steps(guard, 0.0, False)
        assert fires is None
        assert when in warning


@pytest.mark.parametrize("height", [0.150501, 0.150502])
@pytest.mark.parametrize("stops", [False, True])
def test_steps_warn_of_a_summit_between_their_ends(height: float, stops: bool) -> None:
    """The ball rises by 1.005^2/20 to 0.15050125, in the middle of a step at 0.1005."""
    guard = "time > 9" if stops else f"b.y >= {height}"
    text = BALL.replace("y: 0.45, dx: 1", "y: 0.1, dy: 1.005").replace("GUARD", guard)
    text = text.replace("E}", "0.5}").replace("time: 0.6", "time: 0.2")
    if stops:
        text = text.replace("0.2}", f"0.2, conditions: {{go: b.y >= {height}}}}}")
    run = statechart.run(read_text(text), engine="impulse", step=STEP)
    assert not run.trace.jumps or run.trace.jumps[0].cause == "stop"
    warns = any("go is true within the step of 0.001 at t = 0.1," in w for w in run.warnings)
    assert warns == (height < 0.15050125)


@pytest.mark.parametrize(("lift", "fires"), [(8, 0.0), (12, None)])
@pytest.mark.parametrize("stops", [False, True])
def test_accelerations_at_the_start_decide_a_guard_on_its_boundary(
    lift: float, fires: float | None, stops: bool
) -> None:
    """The ball starts at rest on the floor, and is lifted by more or less than its weight."""
    guard = "time > 9" if stops else "b.y <= 0"
    text = BALL.replace("y: 0.45, dx: 1", "y: 0").replace("GUARD", guard).replace("E}", "0}")
    text += f"forces: {{up: {{body: b, force: [0, {lift}]}}}}\n"
    if stops:
        text = text.replace("0.6}", "0.6, conditions: {go: b.y <= 0}}")
    for options in ({"engine": "taylor"}, {"engine": "impulse", "step": STEP}):
        setting: Any = options
        run = statechart.run(read_text(text), **setting)
        times = [jump.t for jump in run.trace.jumps if jump.cause in ("go", "stop")]
        assert times == ([] if fires is None else [fires])


@pytest.mark.parametrize("stops", [False, True])
@pytest.mark.parametrize(
    ("start", "flow", "guard", "fires", "passes"),
    [
        (1.0, "-1", "z >= 1", None, False),  # It leaves its bound at once.
        (1.0, "1", "z > 1", 0.0, False),
        # z = 0.1 + 0.1005 t - t^2/2 has its summit in the middle of a step, at 0.105050125.
        (0.1, "0.1005 - time", "z > 0.10505012", None, True),
        (0.1, "0.1005 - time", "z > 0.10505013", None, False),
    ],
)
def test_rates_of_variables_of_controllers_decide_guards(
    start: float, flow: str, guard: str, fires: float | None, passes: bool, stops: bool
) -> None:
    text = BALL.replace("E}", "0}").replace(
        "initial: a", f"variables: {{z: {start}}}\n    initial: a"
    )
    text = text.replace("{a: {},", f"{{a: {{flows: {{z: {flow}}}}},").replace("0.6}", "0.2}")
    text = text.replace("GUARD", "time > 9" if stops else guard)
    if stops:
        text = text.replace("0.2}", f"0.2, conditions: {{go: '{guard}'}}}}")
    run = statechart.run(read_text(text), engine="impulse", step=STEP)
    times = [jump.t for jump in run.trace.jumps if jump.cause in ("go", "stop")]
    assert times == ([] if fires is None else pytest.approx([fires], abs=1.1 * STEP))
    warns = [w for w in run.warnings if "go is true within the step of 0.001 at t = 0.1," in w]
    assert len(warns) == passes


@pytest.mark.parametrize(("limit", "fires"), [("b.y < 5", False), ("b.dy < 5", True)])
def test_guards_that_read_no_accelerations_take_no_further_steps(
    limit: str, fires: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The height and its rate are known after a transition; the acceleration is not."""
    taken, next_steps = list[float](), SteppedSystem.next_steps

    def count(self: Any, start: float, h: float, state: Any, steps: int) -> Any:
        taken.append(start)
        return next_steps(self, start, h, state, steps)

    monkeypatch.setattr(SteppedSystem, "next_steps", count)
    text = BALL.replace("E}", "0.5}").replace("from: a, to: b", "from: a, to: a, every: 0.1")
    text = text.replace(', guard: "GUARD"', "").replace("time: 0.6}", "time: 0.25, CONDITIONS}")
    text = text.replace("CONDITIONS", f"conditions: {{go: {limit} and time > 0.3}}")
    statechart.run(read_text(text), engine="impulse", step=STEP)
    assert bool(taken) == fires


@pytest.mark.parametrize("stops", [False, True])
@pytest.mark.parametrize(
    ("start", "restitution", "guard", "fires"),
    [
        # The depth of a landing is of the step.
        ("y: 0.45, dx: 1", 0.5, "b.y < 0", None),
        # A force on its bound is known from the start on.
        ("y: 0, dx: 1", 0.0, "c.V <= 10", 0.0),
        ("y: 0, dx: 1", 0.0, "c.V < 10", None),
        # True at the start, and false before a step ends.
        ("y: 3.0e-4, dy: 1", 0.0, "b.y <= 4.0e-4", 0.0),
    ],
)
def test_stops_and_transitions_fire_alike_with_events_and_by_steps(
    start: str, restitution: float, guard: str, fires: float | None, stops: bool
) -> None:
    text = BALL.replace("y: 0.45, dx: 1", start).replace("E}", f"{restitution}}}")
    text = text.replace("GUARD", "time > 9" if stops else guard)
    if stops:
        text = text.replace("0.6}", f"0.6, conditions: {{go: '{guard}'}}}}")
    for options in ({"engine": "taylor"}, {"engine": "impulse", "step": STEP}):
        setting: Any = options
        run = statechart.run(read_text(text), **setting)
        times = [jump.t for jump in run.trace.jumps if jump.cause in ("go", "stop")]
        assert times == ([] if fires is None else pytest.approx([fires], abs=1.1 * STEP))


@pytest.mark.parametrize(("width", "true"), [(4e-4, True), (8e-4, True), (9e-4, False)])
def test_steps_warn_of_a_window_just_after_a_wrap(width: float, true: bool) -> None:
    """The period ends at 0.30017, within the step to 0.301; the window ends there, or after it."""
    text = BALL.replace("GUARD", f"mod(time, 0.30017) < {width} and time > 0.1")
    for step in (None, STEP, 1e-4):
        setting: Any = {} if step is None else {"engine": "impulse", "step": step}
        run = statechart.run(read_text(text.replace("E}", "0}")), **setting)
        times = [jump.t for jump in run.trace.jumps if jump.cause == "go"]
        passed = step == STEP and true
        assert times == ([] if passed else [pytest.approx(0.30017, abs=1.1 * (step or 1e-9))])
        warns = [w for w in run.warnings if "go is true within the step of 0.001 at t = 0.3" in w]
        assert len(warns) == passed


@pytest.mark.parametrize("step", [None, STEP, 3.1e-4])
@pytest.mark.parametrize(
    "tick", ["to: b, after: 0.5", "every: 0.1", "to: b, on: c.touchdown", "every: 0.01"]
)
@pytest.mark.parametrize(("guard", "restitution"), [("b.y < 0", 0.0), ("b.y <= 0", 0.5)])
def test_transitions_of_another_region_turn_no_reversed_guard_true(
    guard: str, restitution: float, tick: str, step: float | None
) -> None:
    """The ball lands at 0.44759: it then rests at 0, or rises until 0.895."""
    text = BALL.replace("y: 0.45", "y: 1.0017").replace("E}", f"{restitution}}}")
    text = text.replace("GUARD", guard).replace(
        "stop:",
        "  s: {initial: a, states: {a: {}, b: {}}, transitions: [{name: tick, from: a, TICK}]}\n"
        "stop:".replace("TICK", tick),
    )
    setting: Any = {} if step is None else {"engine": "impulse", "step": step}
    run = statechart.run(read_text(text), **setting)
    causes = [jump.cause for jump in run.trace.jumps]
    assert causes.count("touchdown") == 1
    assert "go" not in causes
    assert any("r.go reaches its boundary" in w for w in run.warnings)


@pytest.mark.parametrize("step", [None, STEP])
@pytest.mark.parametrize("tick", ["to: b, after: 0.448", "every: 0.001"])
@pytest.mark.parametrize("stops", [False, True])
def test_a_bound_waits_for_an_impact_across_transitions(
    stops: bool, tick: str, step: float | None
) -> None:
    """The ball touches at 0.44759, and is struck by steps after 0.448."""
    text = BALL.replace("y: 0.45", "y: 1.0017").replace("E}", "0.5}")
    text = text.replace("GUARD", "time > 9" if stops else "b.y <= 0")
    ticks = f"[{{name: tick, from: a, {tick}}}]"
    region = f"  s: {{initial: a, states: {{a: {{}}, b: {{}}}}, transitions: {ticks}}}\n"
    text = text.replace("stop:", f"{region}stop:")
    if stops:
        text = text.replace("0.6}", "0.6, conditions: {go: b.y <= 0}}")
    setting: Any = {} if step is None else {"engine": "impulse", "step": step}
    jumps = statechart.run(read_text(text), **setting).trace.jumps
    assert {jump.cause for jump in jumps} <= {"touchdown", "tick"}
    if "after" in tick:
        assert [j.t for j in jumps if j.cause == "tick"] == [pytest.approx(0.448, abs=1e-9)]


@pytest.mark.parametrize("end", [0.301, 0.302])
def test_steps_warn_of_a_window_in_the_last_step(end: float) -> None:
    """A period ends at 0.30017, and the window of the guard at 0.30057."""
    text = BALL.replace("GUARD", "mod(time, 0.30017) < 4e-4 and time > 0.1").replace("E}", "0}")
    text = text.replace("time: 0.6", f"time: {end}")
    assert [jump.t for jump in statechart.run(read_text(text)).trace.jumps if jump.cause == "go"]
    run = statechart.run(read_text(text), engine="impulse", step=STEP)
    assert any("go is true within the step of 0.001 at t = 0.3" in w for w in run.warnings)


@pytest.mark.parametrize("height", [1.0, 1.0005, 1.0017, 0.8])
@pytest.mark.parametrize(
    ("guard", "fires"),
    [("b.y < 0", None), ("b.y <= -2e-4", None), ("b.y >= 0 and time >= 0.46", 0.46)],
)
@pytest.mark.parametrize("stops", [False, True])
@pytest.mark.parametrize("step", [None, STEP, 3.1e-4])
def test_a_body_that_lands_without_restitution_rests_on_its_surface(
    step: float | None, stops: bool, guard: str, fires: float | None, height: float
) -> None:
    text = BALL.replace("y: 0.45", f"y: {height}").replace("E}", "0}")
    text = text.replace("GUARD", "time > 9" if stops else guard)
    if stops:
        text = text.replace("0.6}", f"0.6, conditions: {{go: '{guard}'}}}}")
    setting: Any = {} if step is None else {"engine": "impulse", "step": step}
    jumps = statechart.run(read_text(text), **setting).trace.jumps
    times = [jump.t for jump in jumps if jump.cause in ("go", "stop")]
    assert times == ([] if fires is None else [pytest.approx(fires, abs=step or 1e-9)])
    assert [jump.t for jump in jumps if jump.cause == "touchdown"] == [
        # Half of the touches come in the second half of a step, and count as at its end.
        pytest.approx((height / 5.0) ** 0.5, abs=0.501 * (step or 1e-9))
    ]


@pytest.mark.parametrize("window", [False, True])
@pytest.mark.parametrize("period", [0.3, 0.3002, 0.301])
@pytest.mark.parametrize("height", [0.4501, 0.4515, 0.4529])
def test_a_period_that_ends_in_the_step_of_a_landing_ends_once_and_in_time(
    height: float, period: float, window: bool
) -> None:
    """The ball touches between 0.30003 and 0.30096; the window is 4e-4 long."""
    guard = "mod(time, T) < 4e-4 and time > 0.1" if window else "b.x < mod(time, T) - 2"
    text = BALL.replace("GUARD", guard).replace("E}", "0}").replace("y: 0.45", f"y: {height}")
    text = text.replace("time: 0.6", "time: 0.5")
    run = statechart.run(
        read_text(text + f"parameters: {{T: {period}}}\n"), engine="impulse", step=STEP
    )
    times = [jump.t for jump in run.trace.jumps if jump.region == "mod"]
    assert times == pytest.approx([math.ceil(round(period / STEP, 9)) * STEP], abs=1e-9)
    assert not any("unwrap" in warning for warning in run.warnings)
    passed = window and period == 0.3002
    assert any("go is true within the step" in w for w in run.warnings) == passed
