"""Controllers: regions of a scene that set forces and coefficients, beside its contacts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy.special
from runs import ENGINES, engine, outputs, run

from contacts.scene.scene import Scene
from contacts.testing.scene_properties import properties
from contacts.testing.violations import violations
from statechart.automaton.automaton import Automaton
from statechart.automaton.product import feasibility
from statechart.automaton.trace import Trace
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.documents.yaml_text import dump
from statechart.errors import DeclarationError, EventLoop
from statechart.execution.simulator import Simulator
from statechart.loading.kind import kind
from statechart.loading.load import interpret
from statechart.observation.observer import Observer
from statechart.observation.outputs import Outputs
from statechart.reporting.figure import figure
from statechart.running.result import Result
from statechart.running.runner import Runner
from statechart.testing.properties import generic
from statechart.testing.subject import Subject

both = pytest.mark.parametrize("name", ENGINES)

CART = """\
kind: scene
name: cart
parameters: {F: 2, mu: 0.5, g: 10}
gravity: g
bodies:
  cart: {mass: 1}
surfaces:
  ground: {height: 0}
contacts:
  wheel:
    point: {body: cart}
    surface: ground
    modes: [free, slide]
    friction: 0
    restitution: 0
"""
BLOCK = CART.replace("    modes: [free, slide]\n    friction: 0", "    friction: mu")
DRIVE = "forces: {drive: {body: cart, force: [push, 0]}}\n"


def compose(text: str) -> Automaton:
    document = read_text(text, "f.yaml")
    built = kind("scene").automaton(interpret(document))
    assert isinstance(built, Automaton)
    return built


def ran(text: str, name: str, until: float, **parameters: float) -> Trace:
    return Simulator(compose(text), engine(name)).run(parameters, until=until)


def jumps(trace: Trace) -> list[tuple[str, str]]:
    return [(jump.region, jump.cause) for jump in trace.jumps]


def refused(text: str) -> str:
    with pytest.raises(DeclarationError) as caught:
        interpret(read_text(text, "f.yaml"))
    return str(caught.value)


# A push over the first metre, a brake until the cart stops, then nothing.
SPRINT = (
    CART
    + DRIVE
    + """\
controls: {push: 0}
regions:
  driver:
    initial: go
    states:
      go: {sets: {push: F}}
      brake: {sets: {push: -F}}
      rest: {}
    transitions:
      - {name: far, from: go, to: brake, guard: cart.x >= 1}
      - {name: halt, from: brake, to: rest, guard: cart.dx <= 0}
outputs:
  pushes: {value: push, at: each driver.far or driver.halt}
  energy_in: {integral: push*cart.dx, during: {driver: go}}
"""
)


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


STEP = (
    BLOCK
    + DRIVE
    + """\
controls: {push: 0}
regions:
  pusher:
    initial: idle
    states:
      idle: {}
      busy: {sets: {push: F}}
    transitions:
      - {name: start, from: idle, to: busy, guard: time >= 0.7}
"""
)


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


# Ice under a block on a slope, then grip again.
ICE = """\
kind: scene
name: ice
parameters: {alpha: 0.3, rough: 0.5, smooth: 0.1, g: 10, T: 1, melt: 1.5}
gravity: g
bodies:
  block: {mass: 2}
surfaces:
  slope: {incline: alpha}
contacts:
  base: {point: {body: block}, surface: slope, friction: 2*grip, restitution: 0}
controls: {grip: rough/2}
regions:
  weather:
    initial: dry
    states:
      dry: {}
      icy: {sets: {grip: smooth/2}}
      wet: {}
    transitions:
      - {name: freeze, from: dry, to: icy, guard: time >= T}
      - {name: thaw, from: icy, to: wet, guard: time >= melt}
outputs:
  t_slip: {value: time, at: first base.slip}
  t_stick: {value: time, at: first base.stick}
  mu: {value: 2*grip, at: each weather.icy or weather.wet}
"""


@both
@pytest.mark.parametrize("smooth", [0.0, 0.1])
def test_friction_that_a_state_lowers_lets_a_pinned_block_go(name: str, smooth: float) -> None:
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


BALL = """\
kind: scene
name: ball
parameters: {h: 1, g: 10, hard: 0.8, soft: 0.25}
gravity: g
coordinates: {y: {start: h}}
bodies:
  ball: {mass: 1, position: [0, y]}
surfaces:
  floor: {height: 0}
contacts:
  skin:
    point: {body: ball}
    surface: floor
    modes: [free, slide]
    friction: 0
    restitution: bounce
controls: {bounce: hard}
regions:
  pump:
    initial: full
    states:
      full: {}
      flat: {sets: {bounce: soft}}
    transitions:
      - {name: puncture, from: full, to: flat, on: skin.touchdown}
outputs:
  speeds: {value: dy, at: each skin.touchdown}
"""


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
    # What happens at their end is an event like another.
    rests = [jump.t for t in (trace, plain) for jump in t.jumps if jump.cause == "zeno"]
    assert rests == pytest.approx([rests[1]] * 2, abs=1e-12)


TWO = (
    CART
    + DRIVE
    + """\
controls: {push: 0, gain: 1}
regions:
  motor:
    initial: off
    states:
      off: {}
      on: {sets: {push: gain*F}}
      done: {}
    transitions:
      - {name: start, from: off, to: on, guard: time >= 1}
      - {name: end, from: on, to: done, on: gear.over}
  gear:
    initial: low
    states:
      low: {}
      high: {sets: {gain: 3}}
      over: {sets: {gain: 9}}
    transitions:
      - {name: shift, from: low, to: high, on: motor.on}
      - {name: shift, from: high, to: over, guard: cart.dx >= 3}
"""
)


@both
def test_two_controllers_answer_each_other_at_one_instant(name: str) -> None:
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


def place(text: str, token: str, after: str) -> str:
    """Return line and column of a token, the first one after some text."""
    at = text.index(token, text.index(after))
    return f"f.yaml:{text.count(chr(10), 0, at) + 1}:{at - text.rfind(chr(10), 0, at)}: "


@pytest.mark.parametrize(
    ("old", "new", "token", "words"),
    [
        ("{push: F}", "{pull: F}", "pull", "no control 'pull'; known: push"),
        ("{push: F}", "{push: E}", "E", "unknown name 'E'"),
        ("{push: F}", "{push: 2*wheel.V}", "wheel", "unknown name 'wheel.V'"),
        ("{push: 0}", "{push: 0, pull: 1}", "pull", "no state sets 'pull'"),
        ("{push: 0}", "{push: 2*push}", "push", "in a circle: push -> push"),
        ("{push: 0}", "{push: 0, F: 1}", "F", "'F' is declared twice"),
        ("{push: 0}", "{push: 0, cart: 1}", "cart", "'cart' is a body already"),
        ("regions:\n  driver:", "regions:\n  wheel:", "wheel", "'wheel' is a contact already"),
        ("regions:\n  driver:", "regions:\n  push:", "push", "'push' is a control already"),
        ("initial: go", "initial: gone", "gone", "no state 'gone'; did you mean 'go'"),
        ("to: rest", "to: rust", "rust", "no state 'rust'; did you mean 'rest'"),
        ("guard: cart.dx <= 0", "guard: cart.v <= 0", "cart.v", "unknown name 'cart.v'"),
        ("guard: cart.dx <= 0", "on: wheel.land", "wheel", "no cause or state 'land'"),
        ("guard: cart.dx <= 0", "on: weel.touchdown", "weel", "no region 'weel'; did you mean"),
        ("guard: cart.dx <= 0", "on: wheel.stop", "wheel", "no cause or state 'stop'"),
        ("guard: cart.dx <= 0", "on: driver.far", "driver", "waits for an event of its own"),
        ("guard: cart.dx <= 0", "on: a.b.c", "a.b.c", "'a.b.c' is not an event"),
        ("guard: cart.dx <= 0", "on: 3", "3", "must be text"),
        ("guard: cart.dx <= 0", "guard: cart.dx <= 0, updates: {x: 0}", "x: 0", "no variable 'x'"),
        ("{driver: go}", "{driver: gone}", "gone", "no state 'gone'"),
        ("each driver.far or", "each driver.fur or", "each", "no cause or state 'fur'"),
    ],
)
def test_what_is_wrong_with_controllers_is_said_with_its_place(
    old: str, new: str, token: str, words: str
) -> None:
    assert SPRINT.count(old) == 1
    text = SPRINT.replace(old, new)
    error = refused(text)
    assert error.startswith(place(text, token, after=new)), error
    assert words in error, error


def test_a_transition_has_one_trigger() -> None:
    text = SPRINT.replace(", guard: cart.dx <= 0", "")
    error = refused(text)
    assert error.startswith(place(text, "{name", after="x >= 1}")), error
    assert "transition 'halt' needs one of guard, on" in error


def test_two_regions_that_set_one_quantity_are_named() -> None:
    text = TWO.replace("high: {sets: {gain: 3}}", "high: {sets: {push: 3}}")
    error = refused(text)
    assert error.startswith(place(text, "push", after="high:")), error
    assert "region 'gear' in state 'high' and region 'motor' in state 'on' both set 'push'" in error


def test_coefficients_of_contacts_are_constant_in_a_state_of_one_region() -> None:
    for old, new, words in (
        ("smooth/2", "block.x", "'grip' depends on 'block.x': a coefficient of a contact is"),
        ("smooth/2", "-1", "must be zero or positive in state 'icy' of 'weather', not -2"),
        ("friction: 2*grip", "friction: 2*grap", "unknown name 'grap'"),
    ):
        assert old in ICE
        error = refused(ICE.replace(old, new))
        assert words in error, error
    two = TWO.replace("    friction: 0\n", "    friction: gain*push\n")
    assert "regions 'motor' and 'gear' both set what it depends on" in refused(two)


def test_a_scene_with_controllers_equals_what_is_read_back_from_its_own_text() -> None:
    for text in (SPRINT, ICE, BALL, TWO):
        model = interpret(read_text(text))
        assert isinstance(model, Scene)
        again = validate(read_text(dump(model)), Scene)
        assert again == model


def test_the_product_counts_states_of_controllers_as_well() -> None:
    built = compose(TWO)
    assert [region.name for region in built.regions] == ["wheel", "motor", "gear"]
    assert (built.modes_declared, built.modes_total) == (18, 18)
    edges = {(e.cause, e.guard, e.reset) for e in built.regions[1].edges}
    assert edges == {("start", "time >= 1", "push := gain*F"), ("end", "on gear.over", "push := 0")}


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


def test_every_mode_of_contacts_is_possible_with_every_state_of_controllers() -> None:
    held = ICE.replace("friction: 2*grip, restitution: 0", "modes: [slide, pin], friction: 2*grip")
    built = compose(held)
    setup = built.setup({}, 1e-9)
    found = feasibility(built, setup, setup.initial, 0.0)
    assert found is not None
    assert found.declared == {(m, w): "" for m in ("slide", "pin") for w in ("dry", "icy", "wet")}


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


PENDULUM = """\
kind: scene
name: pendulum
parameters: {g: 10, lean: 1, hard: 0}
gravity: g
bodies:
  rod: {mass: 2, inertia: 0.5, start: {x: sin(lean), y: -cos(lean), angle: lean}}
joints:
  pivot: {point: {body: rod, at: [0, 1]}, to: [0, 0]}
regions:
  swing:
    initial: there
    states: {there: {}, back: {}}
    transitions:
      - {name: turn, from: there, to: back, guard: rod.dangle >= 0}
      - {name: turn, from: back, to: there, guard: rod.dangle <= 0}
  load:
    initial: light
    states: {light: {}, heavy: {}}
    transitions:
      - {name: grow, from: light, to: heavy, guard: pivot.Y >= hard}
      - {name: drop, from: heavy, to: light, guard: pivot.Y <= hard}
"""


@both
def test_guards_of_jointed_bodies_fire_where_closed_forms_say(name: str) -> None:
    rate = math.sqrt(2 * 10 / 2.5)
    half = 2 * scipy.special.ellipk(math.sin(0.5) ** 2) / rate

    def force(angle: float) -> float:
        spin = 2 * rate**2 * (math.cos(angle) - math.cos(1))
        return 2 * (10 + math.cos(angle) * spin - (rate * math.sin(angle)) ** 2)

    trace = ran(PENDULUM, name, 2.2 * half, hard=force(0.3))
    turns = [jump.t for jump in trace.jumps if jump.cause == "turn"]
    # At rest at the start it is about to swing there, so that it does not turn back at once.
    assert turns == pytest.approx([half, 2 * half], abs=1e-9)
    loads = [(jump.cause, jump.after[2]) for jump in trace.jumps if jump.region == "load"]
    assert [cause for cause, _ in loads] == ["grow", "drop"] * 2
    assert [angle for _, angle in loads] == pytest.approx([0.3, -0.3, -0.3, 0.3], abs=1e-9)


STAIRS = (
    BLOCK
    + DRIVE
    + """\
controls: {push: F0}
regions:
  stairs:
    initial: s0
    states: {s0: {}, s1: {sets: {push: F1}}, s2: {sets: {push: F2}}, s3: {sets: {push: F3}}}
    transitions:
      - {name: step, from: s0, to: s1, guard: time >= 0.5}
      - {name: step, from: s1, to: s2, guard: time >= 1}
      - {name: step, from: s2, to: s3, guard: time >= 1.5}
"""
).replace("{F: 2, ", "{F0: 0, F1: 0, F2: 0, F3: 0, ")


def staircase(forces: list[float]) -> tuple[float, float, int]:
    """Return place, speed and number of changes of mode of a block of weight 10, mu = 1/2."""
    x, v, mode, changes = 0.0, 0.0, 0, 0
    for force in forces:
        left = 0.5
        while left > 0.0:
            now = 0 if v == 0.0 and abs(force) <= 5.0 else math.copysign(1, v or force)
            changes += now != mode
            mode = now
            a = 0.0 if now == 0 else force - 5.0 * now
            dt = min(left, -v / a) if v * a < 0.0 else left
            stops = dt < left
            x, v, left = x + v * dt + a * dt**2 / 2, 0.0 if stops else v + a * dt, left - dt
    return x, v, changes


def test_a_staircase_of_forces_moves_a_block_as_its_parabolas_say() -> None:
    random = np.random.default_rng(8)
    simulators = {name: Simulator(compose(STAIRS), engine(name)) for name in ENGINES}
    seen: set[str] = set()
    for _ in range(60):
        forces = (random.choice([0, 4.8, 5.15, 7.3, 12.1], 4) * random.choice([-1, 1], 4)).tolist()
        x, v, changes = staircase(forces)
        for name, simulator in simulators.items():
            trace = simulator.run({f"F{i}": f for i, f in enumerate(forces)}, until=2.0)
            assert trace.final[[0, 2]] == pytest.approx([x, v], abs=1e-9), (name, forces)
            modes = [trace.start_mode[0], *(jump.target[0] for jump in trace.jumps)]
            found = sum(a != b for a, b in zip(["pin", *modes], modes, strict=False))
            assert found == changes, (name, forces)
            seen |= {jump.cause for jump in trace.jumps}
    assert seen == {"step", "slip", "stick", "reverse"}


def hops(until: float, **parameters: float) -> dict[str, list[float]]:
    """Return the hopper's events in closed form: falls, half periods of springs, an impact."""
    p = {"m": 1.0, "foot": 0.05, "k": 200.0, "l0": 1.0, "d": 0.03, "h0": 0.2, "g": 9.81}
    p |= parameters
    rate, sag = math.sqrt(p["k"] / p["m"]), p["m"] * p["g"] / p["k"]
    found: dict[str, list[float]] = {"landings": [], "bottoms": [], "lift_offs": [], "speeds": []}
    t, speed = math.sqrt(2 * p["h0"] / p["g"]), math.sqrt(2 * p["h0"] * p["g"])
    while t < until:
        found["landings"].append(t)
        t += (math.pi - math.atan2(speed * rate, p["g"])) / rate
        bottom = p["l0"] - sag - math.hypot(sag, speed / rate)
        if t > until:
            break
        found["bottoms"].append(bottom)
        # About the raised rest length, from rest at the bottom to the leg's full length.
        swing = p["l0"] - sag + p["d"] - bottom
        phase = math.acos((p["d"] - sag) / swing)
        t += phase / rate
        if t > until:
            break
        speed = swing * rate * math.sin(phase) * p["m"] / (p["m"] + p["foot"])
        found["lift_offs"].append(t)
        found["speeds"].append(speed)
        t += 2 * speed / p["g"]
    return found


@both
@pytest.mark.parametrize(
    "parameters", [{}, {"k": 1000.0, "foot": 0.2}, {"d": 0.01, "foot": 0.01, "h0": 0.4}]
)
def test_the_hopper_lands_and_leaves_as_its_closed_form_says(
    name: str, parameters: dict[str, float]
) -> None:
    trace = run("hopper", name, 5.0, **parameters)
    found: dict[str, Any] = outputs("hopper", name, trace)
    expected = hops(5.0, **parameters)
    assert found["hops"] == len(expected["lift_offs"]) >= 5
    for key, values in expected.items():
        assert found[key] == pytest.approx(values, abs=1e-9)
    assert trace.certified


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


def test_events_that_a_tolerance_merges_are_told() -> None:
    def merged(accuracy: float) -> Result:
        return Runner(read_text(MERGED), engine="scipy", method="RK45", accuracy=accuracy).run()

    exact = -4 * 9.81 + 50 * 0.001 / 3
    loose = merged(1e-2)
    assert any("r.end is taken for true, 0.001 short of it" in text for text in loose.warnings)
    assert loose.outputs["vy"] == pytest.approx(exact, rel=1e-2)
    for accuracy in (1e-6, 1e-9):
        tight = merged(accuracy)
        assert not any("taken for true" in text for text in tight.warnings)
        assert tight.outputs["vy"] == pytest.approx(exact, rel=accuracy)
