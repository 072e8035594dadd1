"""Controllers: regions of a scene that set forces and coefficients, beside its contacts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from controllers import BALL, BLOCK, CART, DRIVE, ICE, SPRINT, STEP, TWO, both, compose, jumps, ran
from runs import engine, run

from contacts.scene.scene import Scene
from contacts.testing.scene_properties import properties
from contacts.testing.violations import violations
from statechart.diagram.scxml import scxml
from statechart.documents.yaml_reader import read_text
from statechart.errors import EventLoop
from statechart.execution.simulator import Simulator
from statechart.loading.load import interpret
from statechart.observation.observer import Observer
from statechart.observation.outputs import Outputs
from statechart.reporting.figure import figure
from statechart.running.drawing import drawn
from statechart.running.result import Result
from statechart.running.runner import Runner
from statechart.testing.properties import generic
from statechart.testing.subject import Subject


@both
def test_a_force_switched_by_guards_moves_a_cart_as_its_closed_form_says(name: str) -> None:
    trace = ran(SPRINT, name, 4.0)
    assert jumps(trace) == [("driver", "far"), ("driver", "halt")]
    assert [jump.t for jump in trace.jumps] == pytest.approx([1.0, 2.0], abs=1e-9)
    assert trace.final[[0, 2]] == pytest.approx([2.0, 0.0], abs=1e-9)
    assert trace.certified
    assert trace.modes == (("slide", "go"), ("slide", "brake"), ("slide", "rest"))


@both
def test_controls_are_outputs_and_states_of_controllers_select_times(name: str) -> None:
    simulator = Simulator(compose(SPRINT), engine(name))
    found = Outputs(Observer(simulator)).of(simulator.run(until=4.0))
    assert found["pushes"] == [-2.0, 0.0]
    assert found["energy_in"] == pytest.approx(2.0, abs=1e-9)


@both
@pytest.mark.parametrize("force", [5.1, -7.0])
def test_a_push_makes_a_pinned_block_slip_at_that_very_instant(name: str, force: float) -> None:
    trace = ran(STEP, name, 1.7, F=force)
    assert jumps(trace) == [("pusher", "start"), ("wheel", "slip")]
    assert {jump.t for jump in trace.jumps} == {trace.jumps[0].t}
    assert trace.jumps[0].t == pytest.approx(0.7, abs=1e-15)
    assert trace.final_mode == ("slide+" if force > 0 else "slide-", "busy")
    acceleration = force - math.copysign(5.0, force)
    assert trace.final[[0, 2]] == pytest.approx([acceleration / 2, acceleration], abs=1e-9)


@both
def test_a_push_within_friction_leaves_a_block_pinned(name: str) -> None:
    trace = ran(STEP, name, 1.7, F=4.9)
    assert jumps(trace) == [("pusher", "start")]
    assert abs(trace.final).max() < 1e-15


@both
@pytest.mark.parametrize("smooth", [0.0, 0.1])
def test_lowering_friction_releases_a_pinned_block(name: str, smooth: float) -> None:
    simulator = Simulator(compose(ICE), engine(name))
    trace = simulator.run({"smooth": smooth}, until=4.0)
    assert jumps(trace) == [
        ("weather", "freeze"), ("base", "slip"), ("weather", "thaw"), ("base", "stick"),
    ]  # fmt: skip
    s, c = math.sin(0.3), math.cos(0.3)
    fast = 10 * (s - smooth * c) * 0.5
    rest = fast / (10 * (0.5 * c - s))
    found = Outputs(Observer(simulator)).of(trace)
    assert found["t_slip"] == pytest.approx(1.0, abs=1e-15)
    assert found["t_stick"] == pytest.approx(1.5 + rest, abs=1e-9)
    assert found["mu"] == [smooth, 0.5]
    slid = -fast * (0.5 + rest) / 2
    assert trace.final[:2] == pytest.approx([slid * c, slid * s], abs=1e-9)


@both
@pytest.mark.parametrize(("smooth", "acceleration"), [(math.inf, 0.0), (1e300, 0.0), (0.0, 1.0)])
def test_friction_of_states_may_be_zero_or_infinite(
    name: str, smooth: float, acceleration: float
) -> None:
    trace = ran(ICE, name, 2.0, alpha=0.6, melt=9, smooth=smooth, rough=math.inf)
    speed = 10 * math.sin(0.6) * acceleration
    assert np.hypot(*trace.final[2:]) == pytest.approx(speed, abs=1e-9)


@both
def test_restitution_changes_with_the_first_bounce(name: str) -> None:
    simulator = Simulator(compose(BALL), engine(name))
    trace = simulator.run(until=1.5)
    first = math.sqrt(20.0)
    speeds = Outputs(Observer(simulator)).of(trace)["speeds"]
    assert isinstance(speeds, list)
    # The event has happened when the controller answers it: the first bounce is hard.
    assert speeds[:3] == pytest.approx([0.8 * first, 0.2 * first, 0.05 * first], abs=1e-9)
    assert trace.jumps[1].t == trace.jumps[0].t
    assert jumps(trace)[:3] == [("skin", "touchdown"), ("pump", "puncture"), ("skin", "touchdown")]


@both
def test_a_controller_that_counts_bounces_does_not_disturb_their_accumulation(name: str) -> None:
    text = BALL.replace(
        "- {name: puncture, from: full, to: flat, on: skin.touchdown}",
        "- {name: odd, from: full, to: flat, on: skin.touchdown}\n"
        "      - {name: even, from: flat, to: full, on: skin.touchdown}",
    ).replace("{sets: {bounce: soft}}", "{sets: {bounce: hard}}")
    trace = ran(text, name, 10.0)
    plain = run("bouncing_ball", name, 10.0, x0=1, g=10, k=0.8)
    bounces = [jump for jump in trace.jumps if jump.cause == "touchdown"]
    assert len(bounces) == len([jump for jump in plain.jumps if jump.cause == "touchdown"])
    assert sum(jump.region == "pump" for jump in trace.jumps) == len(bounces)
    # The events at their end are ordinary events.
    rests = [jump.t for t in (trace, plain) for jump in t.jumps if jump.cause == "zeno"]
    assert rests == pytest.approx([rests[1]] * 2, abs=1e-12)


@both
def test_two_controllers_react_at_one_instant(name: str) -> None:
    trace = ran(TWO, name, 3.0)
    assert jumps(trace) == [
        ("motor", "start"), ("gear", "shift"), ("gear", "shift"), ("motor", "end"),
    ]  # fmt: skip
    times = [jump.t for jump in trace.jumps]
    assert times == pytest.approx([1.0, 1.0, 1.5, 1.5], abs=1e-9)
    assert times[0] == times[1]
    assert times[2] == times[3]
    # Gear high from the start: 6 m/s2 for half a second, then 3 m/s for 1.5 s.
    assert trace.final[0] == pytest.approx(0.75 + 4.5, abs=1e-9)


@both
def test_transitions_due_at_one_instant_are_taken_in_the_order_of_the_declaration(
    name: str,
) -> None:
    regions = "".join(
        f"  {region}:\n    initial: a\n    states: {{a: {{}}, b: {{}}}}\n"
        f"    transitions: [{{name: go, from: a, to: b, guard: {guard}}}]\n"
        for region, guard in (("late", "y <= 0"), ("first", "dy >= 0"), ("never", "y < -1e-3"))
    )
    text = BALL[: BALL.index("controls:")].replace("restitution: bounce", "restitution: 0")
    trace = ran(text + "regions:\n" + regions, name, 1.0)
    # The ball falls from rest: dy >= 0 becomes true, and y <= 0, where it lands.
    assert jumps(trace) == [("skin", "touchdown"), ("late", "go"), ("first", "go")]
    assert len({jump.t for jump in trace.jumps}) == 1
    # Without gravity nothing moves, and dy >= 0 holds from the start.
    assert jumps(ran(text + "regions:\n" + regions, name, 1.0, g=0)) == [("first", "go")]


@both
def test_a_guard_on_a_contact_force_fires_where_the_force_passes_it(name: str) -> None:
    # A growing pull takes the weight off a pinned block, and is let go at half of it.
    text = (
        BLOCK
        + """\
controls: {pull: F*time}
forces: {crane: {body: cart, force: [0, pull]}}
regions:
  crane:
    inital_state
    states: {up: {}, off: {sets: {pull: 0}}, again: {}}
    transitions:
      - {name: drop, from: up, to: off, guard: wheel.V <= 5}
      - {name: regain, from: off, to: again, guard: wheel.V >= 5}
""".replace("inital_state", "initial: up")
    )
    trace = ran(text, name, 3.0)
    assert jumps(trace)[:2] == [("crane", "drop"), ("crane", "regain")]
    assert [jump.t for jump in trace.jumps[:2]] == pytest.approx([2.5, 2.5], abs=1e-9)


@both
def test_a_relay_without_hysteresis_is_an_event_loop_that_names_its_transitions(
    name: str,
) -> None:
    text = (
        CART.replace("cart: {mass: 1}", "cart: {mass: 1, start: {dx: 1}}")
        + DRIVE
        + """\
controls: {push: 0}
regions:
  relay:
    initial: back
    states: {back: {sets: {push: -F}}, forth: {sets: {push: F}}}
    transitions:
      - {name: pull, from: forth, to: back, guard: cart.dx >= 0}
      - {name: push, from: back, to: forth, guard: cart.dx <= 0}
"""
    )
    with pytest.raises(EventLoop, match=r"pull -> .*relay:back.*push -> .*relay:forth") as caught:
        ran(text, name, 3.0)
    assert caught.value.trace is not None
    assert caught.value.trace.t_end == pytest.approx(0.5, abs=1e-11)


@pytest.mark.parametrize("text", [SPRINT, STEP, ICE, BALL, TWO], ids=lambda text: text[18:24])
def test_every_property_of_runs_holds_with_controllers(text: str) -> None:
    model = interpret(read_text(text + "stop: {time: 2.7}\n"))
    assert isinstance(model, Scene)
    case = Subject(model).case({})
    for item in (*generic(case.subject), *properties(model)):
        if not item.skipped:
            item.holds(case)


@both
def test_a_stop_condition_on_a_control_ends_the_run_at_the_jump(name: str) -> None:
    text = STEP + "stop: {conditions: {pushed: push >= 5}}\n"
    trace = ran(text, name, 3.0, F=7.0)
    assert trace.outcome.name == "STOPPED"
    assert trace.t_end == pytest.approx(0.7, abs=1e-15)
    assert jumps(trace) == [("pusher", "start"), ("wheel", "slip"), ("", "stop")]


@both
def test_a_state_can_switch_a_contact_off(name: str) -> None:
    # A trapdoor opens under a resting ball, and closes above it; a spring brings the ball back.
    text = (
        BALL[: BALL.index("controls:")]
        .replace("restitution: bounce", "restitution: 0\n    enabled: open < 0.5")
        .replace("{start: h}", "{start: 0}")
        + """\
controls: {open: 0, lift: 0}
forces: {jack: {body: ball, force: [0, lift]}}
regions:
  trap:
    initial: shut
    states: {shut: {}, open: {sets: {open: 1}}, again: {sets: {lift: 4*g}}}
    transitions:
      - {name: unlock, from: shut, to: open, guard: time >= 1}
      - {name: lock, from: open, to: again, guard: y <= -1}
"""
    )
    trace = ran(text, name, 2.5)
    # It falls 1, is braked over 1/3, rises through the door, which is there again above it.
    fall, brake = math.sqrt(0.2), math.sqrt(0.2) / 3
    rise = math.sqrt(2 * (4 / 3) / 30)
    assert jumps(trace)[:4] == [
        ("trap", "unlock"), ("skin", "disable"), ("trap", "lock"), ("skin", "enable"),
    ]  # fmt: skip
    expected = [1.0, 1.0, 1.0 + fall, 1.0 + fall + brake + rise]
    assert [jump.t for jump in trace.jumps[:4]] == pytest.approx(expected, abs=1e-9)


def test_a_scene_without_contacts_may_have_controllers() -> None:
    text = SPRINT.replace(CART, CART[: CART.index("surfaces:")]).replace("gravity: g", "gravity: 0")
    trace = ran(text, "taylor", 4.0)
    assert trace.modes == (("go",), ("brake",), ("rest",))
    assert trace.final[[0, 2]] == pytest.approx([2.0, 0.0], abs=1e-12)


def test_the_figure_shows_controls_and_the_cone_of_every_state() -> None:
    simulator = Simulator(compose(ICE), engine("taylor"))
    trace = simulator.run(until=3.0)
    axes = figure(Observer(simulator), trace).axes
    assert [ax.get_ylabel() for ax in axes[:-1]] == ["position", "velocity", "force", "control"]
    edge = next(line for line in axes[2].lines if "cone" in str(line.get_label()))
    times, values = (np.asarray(data, float) for data in edge.get_data())
    weight = 20 * math.cos(0.3)
    for at, mu in ((0.5, 0.5), (1.2, 0.1), (2.5, 0.5)):
        assert np.interp(at, times, values) == pytest.approx(mu * weight, abs=1e-9)


def test_violations_of_friction_that_a_controller_sets_are_measured_by_its_state() -> None:
    text = """\
kind: scene
name: rain
gravity: 9.81
parameters: {dry: 0.5}
bodies: {b: {mass: 1, start: {dx: 1}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, modes: [slide, pin], friction: mu}}
controls: {mu: dry}
regions:
  weather:
    initial: dry
    states: {dry: {}, wet: {sets: {mu: dry/5}}}
    transitions: [{name: rain, from: dry, to: wet, guard: time >= 0.05}]
stop: {time: 2}
"""
    runner = Runner(read_text(text))
    result = runner.run()
    found = violations(runner.model, result.observer, result.trace)  # type: ignore[arg-type]
    assert found == pytest.approx({"constraint": 0.0, "cone": 0.0}, abs=1e-12)
    assert result.trace.final[0] == pytest.approx(0.3342089959225, rel=1e-11)


MERGED = """\
kind: scene
name: merged
gravity: 9.81
bodies: {b: {mass: 1, start: {y: 100, dx: 3}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.3, restitution: 0}}
controls: {lift: 0}
regions:
  r:
    initial: off
    states: {off: {}, on: {sets: {lift: 50}}, done: {}}
    transitions:
      - {name: begin, from: off, to: on, guard: b.x >= 6}
      - {name: end, from: on, to: done, guard: b.x >= 6.001}
forces: {push: {body: b, force: [0, lift]}}
stop: {time: 4}
outputs: {vy: {value: b.dy}}
"""


def test_events_merged_by_a_tolerance_give_a_warning() -> None:
    def merged(accuracy: float) -> Result:
        return Runner(read_text(MERGED), engine="scipy", method="RK45", accuracy=accuracy).run()

    exact = -4 * 9.81 + 50 * 0.001 / 3
    loose = merged(1e-2)
    assert any("r.end counts as true: it is 0.001 short of it" in text for text in loose.warnings)
    assert loose.outputs["vy"] == pytest.approx(exact, rel=1e-2)
    for accuracy in (1e-6, 1e-9):
        tight = merged(accuracy)
        assert not any("counts as true" in text for text in tight.warnings)
        assert tight.outputs["vy"] == pytest.approx(exact, rel=accuracy)


OSCILLATOR = """\
kind: scene
name: oscillator
parameters: {mu: 0.1, k: 5, v: 3, g: 10}
gravity: g
bodies: {block: {mass: 1, start: {dx: v}}}
surfaces: {floor: {height: 0}}
contacts: {base: {point: {body: block}, surface: floor, modes: [slide, pin], friction: mu}}
controls: {push: 0}
forces: {spring: {body: block, force: [push - k*block.x, 0]}}
regions:
  hand:
    initial: away
    states: {away: {}, there: {sets: {push: 1}}}
    transitions: [{name: begin, from: away, to: there, on: base.slide-}]
stop: {time: 1}
outputs:
  back: {value: time, at: first base.slide-}
  begun: {value: time, at: first begin}
"""


@both
def test_controller_receives_the_slip_direction(name: str) -> None:
    runner = Runner(read_text(OSCILLATOR), engine=name)
    outputs = runner.run().outputs
    # m x'' = -k x - mu m g, until the speed is 0.
    back = math.atan2(3 * math.sqrt(5), 0.1 * 10) / math.sqrt(5)
    assert outputs == pytest.approx({"back": back, "begun": back}, rel=1e-9)
    assert '<transition event="base.slide_minus" target="hand_there"' in scxml(drawn(runner)[0])


LISTENER = """\
kind: scene
name: counted
parameters: {k: 0.5, h: 1}
gravity: 10
bodies: {ball: {mass: 1, position: [0, y]}}
coordinates: {y: {start: h}}
surfaces: {ground: {height: 0}}
contacts:
  foot: {point: {body: ball}, surface: ground, friction: 0, restitution: k}
controls: {push: 0}
forces: {push: {body: ball, force: [0, push]}}
regions:
  job:
    initial: wait
    variables: {n: 0}
    states:
      wait: {}
      work:
        initial: up
        states: {up: {sets: {push: 10}}, ended: {final: true}}
        transitions: [{name: finish, from: up, to: ended, after: 0.1, guard: y >= 0.3}]
      over: {}
    transitions:
      - {name: note, from: wait, on: foot.touchdown, guard: dy >= 2, updates: {n: n + 1}}
      - {name: begin, from: wait, to: work, on: foot.touchdown, guard: n >= 1 and dy < 2}
      - {name: end, from: work, to: over, on: work.done}
stop: {time: 2}
outputs:
  begin: {value: time, at: first job.begin}
  end: {value: time, at: each work.done}
  n: {value: n}
"""


@pytest.mark.parametrize(
    ("setting", "near"),
    [
        ({"engine": "taylor"}, 1e-9),
        ({"engine": "scipy"}, 1e-9),
        ({"engine": "impulse", "step": 1e-5}, 3e-4),
    ],
)
def test_controllers_take_guarded_events_and_reach_final_states(
    setting: dict[str, object], near: float
) -> None:
    # Rebounds at sqrt(5) and sqrt(5)/2: the first is noted, the second begins the work, in which
    # the ball flies on at that speed, over 0.3 later than 0.1 after it.
    fall, speed = math.sqrt(0.2), math.sqrt(5.0)
    found = Runner(interpret(read_text(LISTENER, "f.yaml")), **setting).run().outputs  # type: ignore[arg-type]
    begin = fall + speed / 10 * 2
    assert found["n"] == 1
    assert found["begin"] == pytest.approx(begin, abs=near)
    assert found["end"] == [pytest.approx(begin + 0.3 / (speed / 2), abs=2 * near)]


LANDING = """\
kind: scene
name: landing
gravity: 10
bodies: {block: {mass: 1}, ball: {mass: 1, start: {x: 3, y: 0.2}}}
surfaces: {floor: {height: 0}}
contacts:
  base: {point: {body: block}, surface: floor, friction: 0.5, restitution: 0}
  hit: {point: {body: ball}, surface: floor, friction: 0.5, restitution: 0}
controls: {pull: 0, push: 0}
forces: {hand: {body: block, force: [pull + push, 0]}}
stop: {time: 0.5}
regions: REGIONS
"""
_HANDS = (
    "left: {initial: a, states: {a: {}, b: {sets: {pull: 8}}}, "
    "transitions: [{name: haul, from: a, to: b, on: hit.touchdown}]}, "
    "right: {initial: c, states: {c: {}, d: {sets: {push: -6}}}, "
    "transitions: [{name: brace, from: c, to: d, on: hit.touchdown}]}"
)
_STEPS = {"engine": "impulse", "step": 1e-3}


@pytest.mark.parametrize("setting", [{"engine": "taylor"}, {"engine": "scipy"}, _STEPS])
def test_contacts_are_classified_once_after_all_regions_of_a_state_answer_an_event(
    setting: dict[str, object],
) -> None:
    # Friction of 5 N holds the block against 8 - 6 N, but not against 8 N.
    regions = f"{{hands: {{initial: on, states: {{on: {{regions: {{{_HANDS}}}}}}}}}}}"
    text = LANDING.replace("REGIONS", regions)
    trace = Runner(interpret(read_text(text, "f.yaml")), **setting).run().trace  # type: ignore[arg-type]
    assert jumps(trace) == [("hit", "touchdown"), ("hands", "haul+brace")]
    assert trace.final_mode == ("pin", "pin", "b|d")


@pytest.mark.parametrize("setting", [{"engine": "taylor"}, {"engine": "scipy"}, _STEPS])
def test_regions_of_a_scene_answer_an_event_in_turn(setting: dict[str, object]) -> None:
    text = LANDING.replace("REGIONS", f"{{{_HANDS}}}")
    trace = Runner(interpret(read_text(text, "f.yaml")), **setting).run().trace  # type: ignore[arg-type]
    # With events contacts are classified after each region; by steps once, in the next step.
    between = [] if setting is _STEPS else [("base", "slip")]
    after = [] if setting is _STEPS else [("base", "stick")]
    answers = [("left", "haul"), *between, ("right", "brace"), *after]
    assert jumps(trace) == [("hit", "touchdown"), *answers]
    assert trace.final_mode == ("pin", "pin", "b", "d")
    assert trace.final[0] == 0.0
