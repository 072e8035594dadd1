"""Declaration of controllers: refusals, and the modes of controllers."""

from __future__ import annotations

import pytest
from controllers import BALL, ICE, SPRINT, TWO, compose

from contacts.scene.scene import Scene
from statechart.automaton.product import feasibility
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.documents.yaml_writer import dump
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import run


def refused(text: str) -> str:
    with pytest.raises(DeclarationError) as caught:
        interpret(read_text(text, "f.yaml"))
    return str(caught.value)


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
        (
            "{push: 0}",
            "{push: 0, F: 1}",
            "F",
            "'F' is declared twice, first as parameters.F (line 3, c",
        ),
        ("{push: 0}", "{push: 0, cart: 1}", "cart", "'cart' is a body already, bodies.cart (line "),
        ("regions:\n  driver:", "regions:\n  wheel:", "wheel", "'wheel' is a contact already"),
        ("regions:\n  driver:", "regions:\n  push:", "push", "'push' is a control already"),
        ("go: {sets:", "go: {set:", "set", "unknown key 'set'; write sets: {CONTROL: FORMULA}"),
        ("initial: go", "initial: gone", "gone", "no state 'gone'; did you mean 'go'"),
        ("to: rest", "to: rust", "rust", "no state 'rust'; did you mean 'rest'"),
        ("guard: cart.dx <= 0", "guard: cart.v <= 0", "cart.v", "unknown name 'cart.v'"),
        ("guard: cart.dx <= 0", "on: wheel.land", "wheel", "no cause or state 'land'"),
        ("guard: cart.dx <= 0", "on: weel.touchdown", "weel", "no region 'weel'; did you mean"),
        ("guard: cart.dx <= 0", "on: wheel.stop", "wheel", "no cause or state 'stop'"),
        ("guard: cart.dx <= 0", "on: driver.far", "driver", "waits for an event of its own"),
        ("guard: cart.dx <= 0", "on: wheel.slide-", "wheel", "no cause or state 'slide-'"),
        ("guard: cart.dx <= 0", "on: a.b.c", "a.b.c", "'a.b.c' is not an event"),
        ("guard: cart.dx <= 0", "on: 3", "3", "must be text"),
        ("guard: cart.dx <= 0", "guard: true", "true", "not true; write x <= 0; time >= 0 always"),
        ("from: go", "from: [go, rest]", "[go", "one state, not a list; write one transition for"),
        ("from: go", "from: '*'", "*", "no state '*'; write one transition for each, or one from"),
        ("guard: cart.dx <= 0", "guard: cart.dx <= 0, updates: {x: 0}", "x: 0", "no variable 'x'"),
        ("{driver: go}", "{driver: gone}", "gone", "no state 'gone'"),
        ("each driver.far or", "each driver.fur or", "each", "no cause or state 'fur'"),
    ],
)
def test_mistakes_in_controllers_are_reported_with_their_place(
    old: str, new: str, token: str, words: str
) -> None:
    assert SPRINT.count(old) == 1
    text = SPRINT.replace(old, new)
    error = refused(text)
    assert error.startswith(place(text, token, after=new)), error
    assert words in error, error


IDLE = """\
kind: scene
name: idle
gravity: 9.81
bodies: {b: {mass: 1, start: {y: 1, dx: 1}}}
surfaces: {s: {height: 0}}
controls: {mu: 0.5}
contacts: {c: {point: {body: b}, surface: s, friction: 0.3, restitution: 0.2}}
forces: {f: {body: b, force: [0, 0]}}
stop: {time: 1}
"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("", ""),
        ("friction: 0.3", "friction: mu"),
        ("friction: 0.3", "friction: 2*mu + 0.1"),
        ("restitution: 0.2", "restitution: mu"),
        ("restitution: 0.2", 'restitution: 0.2, enabled: "time <= mu"'),
        ("restitution: 0.2", "restitution: 0.2, radius: mu"),
        ("mass: 1", "mass: mu"),
        ("mass: 1", "mass: 1, inertia: mu"),
        ("y: 1", "y: mu"),
        ("gravity: 9.81", "gravity: 20*mu"),
        ("height: 0", "height: mu*x"),
        ("height: 0", "height: 0, displacement: [0, mu]"),
        ("[0, 0]", "[mu, 0]"),
        ("{mu: 0.5}", "{mu: 0.5, nu: 2*mu}"),
        ("contacts:", "regions: {r: {initial: a, states: {a: {}}}}\ncontacts:"),
        ("time: 1", "time: 1, conditions: {far: b.x >= mu}"),
    ],
)
def test_a_control_without_a_setting_state_is_refused(old: str, new: str) -> None:
    text = IDLE.replace(old, new, 1)
    assert "f.yaml:6:12: controls.mu: no state sets 'mu'; set it in a state of" in refused(text)


def test_a_transition_has_one_trigger() -> None:
    text = SPRINT.replace(", guard: cart.dx <= 0", "")
    error = refused(text)
    assert error.startswith(place(text, "{name", after="x >= 1}")), error
    assert "transition 'halt' needs one of guard, on" in error


def test_conflicting_regions_are_named() -> None:
    text = TWO.replace("high: {sets: {gain: 3}}", "high: {sets: {push: 3}}")
    error = refused(text)
    assert error.startswith(place(text, "push", after="high:")), error
    assert "region 'gear' in state 'high' and region 'motor' in state 'on' both set 'push'" in error


def test_coefficients_of_contacts_are_constant_in_a_state_of_one_region() -> None:
    for old, new, words in (
        ("smooth/2", "block.x", "'grip' depends on 'block.x': a coefficient of a contact is"),
        ("smooth/2", "-1", "must be zero or positive in state 'icy' of 'weather', not -2"),
        ("friction: 2*grip", "friction: 2*grap", "unknown name 'grap'"),
        *(
            (
                "friction: 2*grip",
                f"friction: 0.3*exp(-{name})",
                f"'{name}': it changes during a run",
            )
            for name in ("base.V", "block.dx", "time")
        ),
    ):
        assert old in ICE
        error = refused(ICE.replace(old, new))
        assert words in error, error
    curve = refused(ICE.replace("friction: 2*grip", "friction: 2/(1 + abs(base.V))"))
    assert "friction: 'base.V': it changes during a run" in curve, curve
    assert "write a control, which the states of a region set, and transitions where it" in curve
    two = TWO.replace("    friction: 0\n", "    friction: gain*push\n")
    assert "regions 'motor' and 'gear' both set what it depends on" in refused(two)


def test_a_scene_with_controllers_survives_a_round_trip_through_yaml() -> None:
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


def test_every_mode_of_contacts_is_possible_with_every_state_of_controllers() -> None:
    held = ICE.replace("friction: 2*grip, restitution: 0", "modes: [slide, pin], friction: 2*grip")
    built = compose(held)
    setup = built.setup({}, 1e-9)
    found = feasibility(built, setup, setup.initial, 0.0)
    assert found is not None
    assert found.declared == {(m, w): "" for m in ("slide", "pin") for w in ("dry", "icy", "wet")}


_NESTED = """
kind: scene
name: nested
gravity: 10
controls: {x: 0}
bodies: {b: {mass: 1, start: {y: 20}}}
surfaces: {}
contacts: {}
forces: {f: {body: b, force: [x, 0]}}
regions:
  arm:
    initial: wait
    states:
      wait: {}
      work:
        initial: push
        states: {push: {sets: {x: 2}}, pull: {sets: {x: -1}}}
        transitions:
          - {name: back, from: push, to: pull, after: 0.25}
          - {name: forth, from: pull, to: push, after: 0.5}
    transitions: [{name: go, from: wait, to: work, after: 1}]
  lamp:
    initial: dark
    states: {dark: {}, lit: {}}
    transitions: [{name: on, from: dark, to: lit, on: arm.pull}]
stop: {time: 2.5}
outputs:
  pushed: {value: time, at: each arm.push}
  pulled: {count: arm.pull}
  pushing: {integral: 1, during: {arm: push}}
  lit: {value: time, at: first lamp.lit}
  speed: {value: b.dx, at: first arm.pull}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_outputs_and_events_accept_nested_states(engine: str) -> None:
    found = run(interpret(read_text(_NESTED)), engine=engine).outputs
    wanted = {"pushed": [1.0, 1.75, 2.5], "pulled": 2, "pushing": 0.5, "lit": 1.25, "speed": 0.5}
    assert found == {name: pytest.approx(value, rel=1e-9) for name, value in wanted.items()}
    with pytest.raises(DeclarationError, match="no state 'puss'; did you mean 'push'"):
        interpret(read_text(_NESTED.replace("{arm: push}", "{arm: puss}")))
