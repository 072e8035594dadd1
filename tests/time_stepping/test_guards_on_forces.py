"""Guards on forces that come to their bound and stay there, by steps and with events."""

from __future__ import annotations

from typing import Any

import pytest
from scipy.integrate import solve_ivp

from statechart import Runner
from statechart.documents.yaml_reader import read_text

_CONTACT = """\
bodies: {b: {mass: 1}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.5, restitution: 0}}
"""
_ROPE = (
    "bodies: {b: {mass: 1, start: {y: -1}}}\njoints: {c: {point: {body: b}, to: [0, 0], rope: 1}}"
)
_BRAKE = """\
bodies: {b: {mass: 1, inertia: 1, start: {dangle: 9}}}
joints: {p: {point: {body: b}, to: [0, 0]}}
couplings: {c: {bodies: [b], limit: 1, enabled: time <= 1.25}}
"""
_WATCH = """\
kind: scene
name: watch
gravity: 10
forces: {{lift: {{body: b, force: [0, "{force}"]}}}}
regions:
  r:
    initial: waits
    states: {{waits: {{}}, done: {{}}}}
    transitions: [{{name: go, from: waits, to: done, guard: "{guard}"}}]
stop: {{time: 2}}
outputs: {{t: {{value: time, at: first r.go}}}}
"""


@pytest.mark.parametrize("step", [None, 1e-3, 1e-4])
@pytest.mark.parametrize(
    ("scene", "force", "guard", "fires"),
    [
        # The contact and the rope bear 10 - 8 t, or 10 - min(8 t, 6).
        (_CONTACT, "8*time", "c.V <= 0", 1.25),
        (_CONTACT, "min(8*time, 6)", "c.V <= 4", 0.75),
        (_CONTACT, "min(8*time, 6)", "c.V < 4", None),
        (_CONTACT, "min(8*time, 6)", "c.V <= 4 and in(c.pin)", 0.75),
        (_ROPE, "8*time", "c.V <= 0", 1.25),
        (_ROPE, "min(8*time, 6)", "not c.V > 4", 0.75),
        (_BRAKE, "0", "abs(c.M) <= 0", 1.25),
    ],
)
def test_a_guard_on_a_force_that_stays_on_its_bound_fires(
    scene: str, force: str, guard: str, fires: float | None, step: float | None
) -> None:
    setting: Any = {} if step is None else {"engine": "impulse", "step": step}
    text = _WATCH.format(force=force, guard=guard) + scene
    result = Runner(read_text(text), **setting).run()
    near = pytest.approx(fires, abs=2.5 * step if step else 1e-12)
    assert result.outputs["t"] == (None if fires is None else near)


@pytest.mark.parametrize("step", [None, 1e-3, 1e-4])
@pytest.mark.parametrize("law", ["3*min(time/T, 1)", "3 - 3*max(1 - time/T, 0)"])
@pytest.mark.parametrize(
    ("guard", "part"), [("u >= 3", 1), ("abs(u) >= 3", 1), ("u > 3", None), ("u > 1.5", 0.5)]
)
def test_a_guard_on_a_control_that_saturates_between_steps(
    guard: str, part: float | None, law: str, step: float | None
) -> None:
    reach = 0.975312
    setting: Any = {} if step is None else {"engine": "impulse", "step": step}
    text = _WATCH.format(force="u", guard=guard).replace(
        "regions:",
        f"controls: {{u: 0}}\nparameters: {{T: {reach}}}\nregions:\n"
        f'  motor: {{initial: on, states: {{on: {{sets: {{u: "{law}"}}}}}}}}',
    )
    result = Runner(read_text(text + _CONTACT), **setting).run()
    near = None if part is None else pytest.approx(part * reach, abs=2.5 * step if step else 1e-12)
    assert result.outputs["t"] == near


@pytest.mark.parametrize(
    ("start", "limit", "first"),
    [
        ("dx: 1", 0.0015, 0.0),  # It rests from the start on.
        ("dx: 1, y: 0.2", 0.2045, 0.204),  # It lands at 0.2.
    ],
)
def test_a_guard_on_a_force_fires_where_steps_know_it_first(
    start: str, limit: float, first: float
) -> None:
    """The guard is false a step later; in a landing, steps know the force later than it acts."""
    text = _WATCH.format(force="0", guard=f"c.V >= 5 and b.x <= {limit}")
    text += _CONTACT.replace("mass: 1", f"mass: 1, start: {{{start}}}")
    text = text.replace("friction: 0.5", "friction: 0")
    exact = Runner(read_text(text)).run().outputs["t"]
    found = Runner(read_text(text), engine="impulse", step=1e-3).run().outputs["t"]
    assert exact == pytest.approx(0.2 if "y" in start else 0.0, abs=1e-9)
    assert found == pytest.approx(first, abs=1e-9)


_LANDING = """\
kind: scene
name: landing
gravity: 10
bodies: {{b: {{mass: 1, start: {{y: {height}}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts:
  foot: {{point: {{body: b}}, surface: floor, friction: 0.5, stiffness: 3000, damping: 30}}
regions:
  r:
    initial: falls
    states: {{falls: {{}}, bears: {{}}, light: {{}}}}
    transitions:
      - {{name: lands, from: falls, to: bears, on: foot.touchdown}}
      - {{name: go, from: bears, to: light, guard: foot.V <= 20}}
stop: {{time: 0.4}}
outputs: {{t: {{value: time, at: first r.go}}, V: {{value: foot.V, at: first r.lands}}}}
"""


@pytest.mark.parametrize("height", [0.2, 0.2002, 0.2006, 0.201, 0.2015])
@pytest.mark.parametrize("step", [None, 1e-3, 1e-4])
def test_a_compliant_force_is_that_from_the_touchdown_on(height: float, step: float | None) -> None:
    """It jumps to d v, and falls below the bound as the point leaves."""
    setting: Any = {} if step is None else {"engine": "impulse", "step": step}
    outputs = Runner(read_text(_LANDING.format(height=height)), **setting).run().outputs
    lands, fast = (2 * height / 10) ** 0.5, (20 * height) ** 0.5

    def light(t: float, q: Any) -> float:
        return float(-3000 * q[0] - 30 * q[1] - 20)

    flight = solve_ivp(
        lambda t, q: (q[1], -10 - 3000 * q[0] - 30 * q[1]),
        (0.0, 0.1), (0.0, -fast), events=light, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    near = 2 * (step or 1e-9)
    assert outputs["t"] == pytest.approx(lands + flight.t_events[0][-1], abs=near)
    # 3000 v is the rate of the spring's force.
    assert outputs["V"] == pytest.approx(30 * fast, abs=3000 * fast * near)


LANDS = """
kind: scene
name: lands
parameters: {press: 10}
gravity: 10
bodies: {ball: {mass: 1, start: {y: 0.2}}}
surfaces: {floor: {height: 0}}
contacts: {foot: {point: {body: ball}, surface: floor, friction: 0.5, restitution: 0}}
forces: {hand: {body: ball, force: [0, -press*time]}}
regions:
  clock:
    initial: waits
    states: {waits: {}, over: {}}
    transitions: [{name: tick, from: waits, to: over, after: 0.8}]
  watch:
    initial: idle
    states: {idle: {}, loaded: {}, late: {}}
    transitions:
      - {name: load, from: idle, to: loaded, guard: foot.V >= 15}
      - {name: stop, from: idle, to: late, guard: in(clock.over)}
stop: {time: 1}
outputs: {fires: {value: time, at: first watch.load or watch.stop}}
"""


@pytest.mark.parametrize(("press", "fires"), [(10.0, 0.5), (1.0, 0.8)])
def test_a_guard_on_states_alone_has_a_value_in_steps_with_impacts(
    press: float, fires: float
) -> None:
    runner = Runner(read_text(LANDS), engine="impulse", step=1e-3)
    found = runner.run({"press": press}).outputs["fires"]
    assert found == pytest.approx(fires, abs=3e-3)
