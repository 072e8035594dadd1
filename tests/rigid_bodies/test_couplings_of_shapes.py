"""Brakes, clutches and stiff joints between bodies with shapes."""

from __future__ import annotations

import math

import pytest

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import Runner
from statechart.testing.checking import check

DISC = "shape: {disc: 0.1}"


def scene(
    sections, bodies, names, *, shaped=True, gravity=0.0, stop=3.0, floor=False, restitution=0,
    step=1e-3,
):  # fmt: skip
    """Return a scene of discs, on a floor or touching nothing, or of bodies without shapes."""
    shape = f", {DISC}" if shaped else ""
    lines = "\n".join(f"  {name}: {{{one}{shape}}}" for name, one in bodies.items())
    touched = ", surfaces: [floor]" if floor else ""
    law = f"friction: 0.5, restitution: {restitution}"
    collisions = f"collisions: {{all: {{bodies: [{names}]{touched}, {law}}}}}"
    ground = "surfaces: {floor: {height: 0}}\nsimultaneous: plastic\n" if floor else ""
    return interpret(
        read_text(
            f"kind: scene\nname: discs\ngravity: {gravity}\nbodies:\n{lines}\n"
            f"{collisions if shaped else ''}\n{ground}{sections}\nstop: {{time: {stop}}}\n"
            f"settings: {{engine: impulse, step: {step}}}\n"
        )
    )


def run(*arguments, **settings):
    return Runner(scene(*arguments, **settings)).run(throw=False)


def events(result):
    return [(jump.region, jump.cause) for jump in result.trace.jumps]


WHEELS = {
    "a": "mass: 1, inertia: 0.5, start: {dangle: 10}",
    "b": "mass: 1, inertia: 0.5, start: {x: 3}",
}


def test_a_clutch_locks_when_the_speeds_are_equal():
    """Under a brake of 1 and a clutch of 2 the slip is 9 - 10 t, then both turn as one."""
    result = run(
        "couplings:\n  brake: {bodies: [a], limit: 1}\n"
        "  clutch: {bodies: [a, b], limit: {static: 3, kinetic: 2}, enabled: time >= 0.5}",
        WHEELS,
        "a, b",
    )
    assert events(result) == [("clutch", "close"), ("clutch", "lock")]
    assert [jump.t for jump in result.trace.jumps] == pytest.approx([0.5, 1.4], abs=2e-3)
    final = dict(zip(result.trace.variables, result.trace.final, strict=True))
    assert final["a.dangle"] == pytest.approx(2, abs=1e-9)
    assert final["b.dangle"] == pytest.approx(final["a.dangle"], abs=1e-10)


@pytest.mark.parametrize(("loop", "named"), [("[b]", True), ("[a]", True), ("[c]", False)])
def test_couplings_that_hold_the_same_rotation_are_named(loop, named):
    result = run(
        "couplings:\n  brake: {bodies: [a], limit: 1}\n  clutch: {bodies: [a, b], limit: 2}\n"
        f"  more: {{bodies: {loop}, limit: 2}}",
        {**WHEELS, "c": "mass: 1, inertia: 0.5, start: {x: 6}"},
        "a, b, c",
        stop=0.1,
    )
    held = [words for words in result.warnings if "hold the same rotation as 'more'" in words]
    assert len(held) == named


JOINTED = {
    "pendulum": (
        "joints: {pin: {point: {body: b, at: [0, 0.5]}, to: [0, 0]}}\n"
        "couplings: {dry: {joint: pin, limit: {static: 0.6, kinetic: 0.5}}}",
        {"b": "mass: 1, inertia: 0.1, start: {x: 0.5, angle: 1.5707963267948966}"},
    ),
    "guide": (
        "joints: {rail: {point: {body: b, at: [0, 0.1]}, to: {y: 0}}}\n"
        "couplings: {dry: {joint: rail, limit: 3}}\n"
        "forces: {drive: {body: b, force: ['6*sin(3*time)', 0]}}",
        {"b": "mass: 1, inertia: 0.05, start: {y: -0.1, dx: 0.5}"},
    ),
    "elbow": (
        "joints:\n  hook: {point: {body: b, at: [-0.25, 0]}, to: [0, 0]}\n"
        "  elbow: {point: {body: c, at: [-0.25, 0]}, to: {body: b, at: [0.25, 0]}}\n"
        "couplings: {dry: {joint: elbow, limit: 0.2}, base: {bodies: [b], limit: 0.1}}",
        {
            "b": "mass: 1, inertia: 0.02, start: {x: 0.25}",
            "c": "mass: 0.5, inertia: 0.01, start: {x: 0.75}",
        },
    ),
    "switched": (
        "couplings: {k: {bodies: [b], limit: '0.4*(1.2 + sin(5*time))', enabled: in(ctl.on)}}\n"
        "forces: {drive: {body: b, moment: 0.5}}\n"
        "regions:\n  ctl:\n    initial: off\n    states: {off: {}, on: {}}\n    transitions:\n"
        "    - {name: hold, from: off, to: on, guard: b.dangle >= 3}\n"
        "    - {name: let, from: on, to: off, after: 0.7}",
        {"b": "mass: 1, inertia: 0.05"},
    ),
}


@pytest.mark.parametrize("name", JOINTED)
def test_shapes_that_touch_nothing_do_not_change_a_coupling(name):
    """The same steps with and without shapes: two providers of one stepper.

    Joints of shapes close at midpoints, those of coordinates at the ends of steps: their motions
    differ in second order.
    """
    sections, bodies = JOINTED[name]
    names, errors = ", ".join(bodies), []
    for step in (1e-3, 5e-4):
        shaped, bare = (
            run(sections, bodies, names, shaped=shaped, gravity=9.81, stop=1.2, step=step)
            for shaped in (True, False)
        )
        assert events(shaped) == events(bare)
        errors.append(abs(shaped.trace.final - bare.trace.final).max())
    assert errors[0] < 1e-4
    assert errors[1] < 0.27 * errors[0] + 1e-12


def test_a_coupling_leaves_the_rebound_of_a_ball():
    """A bounded couple has no impulse, and counts as no second contact of a plastic impact."""
    ball = {"b": "mass: 1, inertia: 0.005, start: {y: 0.6, dangle: 5}"}
    free, braked = (
        run(text, ball, "b", gravity=9.81, stop=0.6, floor=True, restitution=0.8)
        for text in ("", "couplings: {k: {bodies: [b], limit: 2}}")
    )
    assert free.trace.final[1] > 0.2
    assert braked.trace.final[1] == pytest.approx(free.trace.final[1], abs=1e-12)


def test_a_locked_wheel_slides_and_a_weak_brake_lets_it_roll():
    """M a = -F, I w' = F r - M: a brake above mu m g r slides the wheel at mu g."""
    wheel = {"b": "mass: 2, inertia: 0.01, start: {y: 0.1, dx: 3, dangle: -30}"}
    locked, rolling = (
        run(
            f"couplings: {{brake: {{bodies: [b], limit: {limit}}}}}",
            wheel,
            "b",
            gravity=9.81,
            stop=0.4,
            floor=True,
        )
        for limit in (20, 0.3)
    )
    final = dict(zip(locked.trace.variables, locked.trace.final, strict=True))
    assert final["b.dangle"] == pytest.approx(0, abs=1e-9)
    assert final["b.dx"] == pytest.approx(3 - 0.5 * 9.81 * 0.4, abs=5e-3)
    final = dict(zip(rolling.trace.variables, rolling.trace.final, strict=True))
    # Rolling: (m + I/r^2) a = -M/r.
    assert final["b.dx"] == pytest.approx(3 - 0.4 * 0.3 / 0.1 / 3, abs=1e-6)
    assert final["b.dangle"] == pytest.approx(-final["b.dx"] / 0.1, abs=1e-6)


def test_a_led_body_drives_by_a_clutch():
    """A motor at 4 rad/s, declared first: its couple is that on the motor."""
    bodies = {"b": "mass: 1, inertia: 0.05", "m": "position: [3, 0], angle: 4*time"}
    result = run(
        "couplings: {k: {bodies: [m, b], limit: 0.1}}\noutputs: {least: {minimum: k.M}}",
        bodies,
        "b, m",
        stop=2.5,
    )
    assert events(result) == [("k", "lock")]
    assert result.trace.jumps[0].t == pytest.approx(2, abs=2e-3)
    assert result.outputs["least"] == pytest.approx(-0.1)
    final = dict(zip(result.trace.variables, result.trace.final, strict=True))
    assert final["b.dangle"] == pytest.approx(4, abs=1e-9)


def test_a_coupling_holds_a_body_that_coordinates_place():
    """The brake of a crank of inertia I + m r^2 about its pivot."""
    model = scene(
        "coordinates: {q: {rate: 3}}\ncouplings: {k: {bodies: [b], limit: 0.5}}",
        {"b": "mass: 1, inertia: 0.05, position: [cos(q), sin(q)], angle: q", "c": WHEELS["a"]},
        "b, c",
        stop=1.0,
    )
    result = Runner(model).run()
    final = dict(zip(result.trace.variables, result.trace.final, strict=True))
    assert final["dq"] == pytest.approx(3 - 0.5 / 1.05, abs=1e-9)


def test_static_friction_holds_until_its_limit():
    """A moment that grows as time passes overcomes 0.6 at 0.6 s, and then works against 0.4."""
    result = run(
        "couplings: {k: {bodies: [b], limit: {static: 0.6, kinetic: 0.4}}}\n"
        "forces: {ramp: {body: b, moment: time}}",
        {"b": "mass: 1, inertia: 0.05"},
        "b",
        stop=1.0,
    )
    assert [(j.cause, round(j.t, 2)) for j in result.trace.jumps] == [("slip", 0.6)]
    rate = ((1 - 0.36) / 2 - 0.4 * 0.4) / 0.05
    final = dict(zip(result.trace.variables, result.trace.final, strict=True))
    assert final["b.dangle"] == pytest.approx(rate, abs=2e-2)


def test_the_properties_of_couplings_hold_by_steps():
    bodies = WHEELS | {"m": "position: [8, 3], angle: 4*time"}
    model = scene(
        "controls: {u: 0}\n"
        "couplings:\n  brake: {bodies: [a], limit: '1 + 0.5*sin(7*time)'}\n"
        "  clutch: {bodies: [a, b], limit: {static: 3, kinetic: 2}, enabled: time >= 0.5}\n"
        "  motor: {bodies: [m, b], limit: u, enabled: in(ctl.on)}\n"
        "regions:\n  ctl:\n    initial: off\n    states: {off: {}, on: {sets: {u: 2}}}\n"
        "    transitions: [{name: go, from: off, to: on, on: clutch.lock}]",
        bodies,
        "a, b, m",
        gravity=9.81,
    )
    report = check(model, examples=1)
    assert report.passed, str(report)


@pytest.mark.parametrize(("limit", "time"), [("0.3 - time", 0.301), ("sqrt(0.3 - time)", 0.301)])
def test_a_limit_that_ends_ends_the_run(limit, time):
    result = run(
        f"couplings: {{k: {{bodies: [b], limit: {limit}}}}}",
        {"b": "mass: 1, inertia: 0.05, start: {dangle: 20}"},
        "b",
    )
    assert result.trace.outcome is Outcome.NO_CONSISTENT_MODE
    assert "coupling 'k': its limit is below zero or has no value by" in result.trace.message
    assert result.trace.t_end == pytest.approx(time, abs=2e-3)


@pytest.mark.parametrize(
    ("coupling", "words"),
    [
        ("{bodies: [f], limit: 1}", "body 'f' is fixed, as the world is; name the other body"),
        ("{bodies: [m], limit: 1}", "its bodies turn as prescribed"),
        ("{bodies: [d], limit: 1}", "no body 'd'; there are d0 to d1"),
        ("{bodies: [b], limit: -1}", "must be zero or positive, not -1 at the start"),
    ],
)
def test_mistakes_in_couplings_of_shapes_give_advice(coupling, words):
    bodies = {
        "b": "mass: 1, inertia: 0.05",
        "d": "mass: 1, inertia: 0.05, copies: 2, start: {x: index + 2}",
        "m": "position: [9, 0], angle: time",
        "f": "fixed: true, start: {x: 12}",
    }
    with pytest.raises(DeclarationError, match=words):
        Runner(scene(f"couplings: {{k: {coupling}}}", bodies, "b, d, m, f")).run()


def test_copies_are_coupled_one_by_one():
    bodies = {"d": "mass: 1, inertia: 0.05, copies: 2, start: {x: index, dangle: 4}"}
    result = run("couplings: {k: {bodies: [d1], limit: 0.1}}", bodies, "d", stop=1.0)
    final = dict(zip(result.trace.variables, result.trace.final, strict=True))
    assert final["d0.dangle"] == 4
    assert final["d1.dangle"] == pytest.approx(2)
    assert math.isfinite(final["d1.angle"])


@pytest.mark.parametrize(
    ("enabled", "opens"), [("a.dx > 0", True), ("a.dx <= 0", False), ("abs(a.dx) > 0", True)]
)
@pytest.mark.parametrize("mu", [0.3, 0.31, 0.47])
def test_the_residual_motion_of_a_resting_box_switches_no_brake(enabled, opens, mu):
    """The box stops after 1/(mu g); its round-off, of either sign, opened and closed the brake."""
    square = "polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]"
    text = f"""
kind: scene
name: braked
gravity: 9.81
bodies:
  a: {{mass: 1, inertia: 0.01, shape: {{{square}}}, start: {{y: 0.1, dx: 1}}}}
  b: {{mass: 1, inertia: 0.5, {DISC}, start: {{x: -3, y: 0.1}}}}
surfaces: {{floor: {{height: 0}}}}
forces: {{turn: {{body: b, moment: 1, force: [0, 9.81]}}}}
collisions: {{all: {{bodies: [a, b], surfaces: [floor], friction: {mu}, restitution: 0}}}}
couplings: {{brake: {{bodies: [b], limit: 5, enabled: "{enabled}"}}}}
stop: {{time: 1.5}}
settings: {{engine: impulse, step: 1e-3}}
"""
    result = Runner(interpret(read_text(text))).run()
    stops = 1 / (mu * 9.81)
    spun = 2 * (1.5 - stops) if opens else 0.0
    assert result.trace.final[11] == pytest.approx(spun, abs=2 * 2e-3)
    brakes = [jump.cause for jump in result.trace.jumps if jump.region == "brake"]
    assert brakes == (["open"] if opens else ["close", "lock"])


@pytest.mark.parametrize("to", ["[0, 0]", "{body: frame}"])
@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_a_hinge_with_friction_that_has_come_to_rest_stays_locked(to, step):
    """Without gravity all velocities are zero then, and round-off must not count as slip."""
    text = f"""
kind: scene
name: swing_door
bodies:
  frame: {{fixed: true, start: {{x: 5}}, shape: {{disc: 0.02}}}}
  door: {{mass: 10, inertia: 0.6, shape: {{disc: 0.02}}, start: {{x: 0.4, dangle: 2, dy: 0.8}}}}
joints:
  hinge:
    point: {{body: door, at: [-0.4, 0]}}
    to: {to}
    limits: [-0.5, 1]
    restitution: 0.4
couplings: {{rub: {{joint: hinge, limit: 0.2}}}}
collisions: {{a: {{bodies: [door, frame], friction: 0, restitution: 0}}}}
settings: {{engine: impulse, step: {step}}}
"""
    text = text.replace("start: {x: 5}, ", "") if "frame" in to else text
    trace = Runner(interpret(read_text(text))).run(until=6.0).trace
    events = [(jump.t, jump.cause) for jump in trace.jumps if jump.region == "rub"]
    assert [cause for _, cause in events] == ["reverse", "reverse", "lock"]
    # I = 0.6 + 10 (0.4)**2; the couple takes 0.2/I of the rate in every second.
    slowing = 0.2 / 2.2
    turn, rate, rest = 1.0, math.sqrt(4.0 - 2.0 * slowing), 0.0
    rest += (2.0 - rate) / slowing
    rate *= 0.4
    met = math.sqrt(rate**2 - 2.0 * slowing * (turn + 0.5))
    rest += (rate - met) / slowing + 0.4 * met / slowing
    assert events[-1][0] == pytest.approx(rest, abs=10 * step)


def test_a_step_that_is_too_large_still_knows_the_states_of_couplings():
    """A body falls by 9.81 in a step of 1; the report lists the mode at the start."""
    result = run(
        "couplings:\n  brake: {bodies: [a], limit: 1}", WHEELS, "a, b", gravity=9.81, step=1
    )
    assert result.trace.outcome is Outcome.STEP_TOO_LARGE
    assert result.trace.modes == (("free", "free", "slip+"),)
    assert result.to_dict()["modes"] == [{"a": "free", "b": "free", "brake": "slip+"}]
