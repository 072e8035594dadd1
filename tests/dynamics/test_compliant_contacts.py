"""Compliant contacts: springs and dampers that only push, with friction, against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret

_BALL = """
kind: scene
name: ball
parameters: {k: 1000, d: 20}
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: 1}}}
surfaces: {mat: {height: 0}}
contacts: {foot: {point: {body: ball}, surface: mat, friction: 0, stiffness: k, damping: d}}
stop: {time: 0.9}
outputs:
  touch: {value: time, at: first foot.touchdown}
  lift: {value: time, at: first foot.liftoff}
  speed: {value: ball.dy, at: first foot.liftoff}
  again: {value: time, at: last foot.touchdown}
"""
_BLOCK = """
kind: scene
name: block
gravity: 9.81
bodies: {block: {mass: 2, start: {y: -2*9.81/1e5, dx: 2}}}
surfaces: {floor: {height: 0}}
contacts:
  base: {point: {body: block}, surface: floor, friction: 0.3, stiffness: 1e5, damping: 100}
stop: {time: 1}
outputs: {stops: {value: time, at: first base.stick}, x: {value: block.x}}
"""
_FEET = """
kind: scene
name: feet
gravity: [9.81*sin(0.2), -9.81*cos(0.2)]
bodies: {box: {mass: 2, inertia: 0.05, start: {y: 0.1}}}
surfaces: {slope: {height: 0}}
contacts:
  a:
    {point: {body: box, at: [-0.1, -0.1]}, surface: slope, stiffness: 1e5, damping: 300,
    friction: 0.4}
  b:
    {point: {body: box, at: [0.1, -0.1]}, surface: slope, stiffness: 1e5, damping: 300,
    friction: 0.4}
stop: {time: 1}
outputs:
  along: {value: a.H + b.H}
  across: {value: a.V + b.V}
  couple:
    value: >-
      (0.1*cos(box.angle) + 0.1*sin(box.angle))*b.V + (0.1*sin(box.angle) - 0.1*cos(box.angle))*a.V
      + (box.y - a.gap)*a.H + (box.y - b.gap)*b.H
"""
_WHEEL = """
kind: scene
name: wheel
gravity: 9.81
parameters: {k: 2000}
bodies: {disc: {mass: 1, inertia: 0.005, start: {y: 0.5, dx: 1, dangle: 30}}}
surfaces: {mat: {height: 0}}
contacts:
  rim:
    {point: {body: disc}, radius: 0.1, surface: mat, friction: 0.4, stiffness: k, damping: 20}
stop: {time: 1}
outputs: {rolls: {value: disc.dx}}
"""
_HELD = """
kind: scene
name: held
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: 0.01}}}
surfaces: {mat: {height: 0}}
contacts:
  foot:
    {point: {body: ball}, surface: mat, friction: 0, stiffness: 1000, damping: 20,
    enabled: time <= 1 or time >= 1.01}
stop: {time: 3}
outputs: {y: {value: ball.y}, off: {value: time, at: first foot.disable}}
"""


def _bounce(k: float, d: float) -> dict[str, float]:
    """A mass of 1 that meets a damped spring after a fall of 1, by the oscillator's solution."""
    g, v = 9.81, math.sqrt(2 * 9.81)
    a, w = 0.5 * d, math.sqrt(k - 0.25 * d * d)
    rest = -g / k
    one, two = -rest, (-v - a * rest) / w

    def at(t: float) -> tuple[float, float]:
        c, s, fades = math.cos(w * t), math.sin(w * t), math.exp(-a * t)
        y = rest + fades * (one * c + two * s)
        return y, fades * ((two * w - a * one) * c - (one * w + a * two) * s)

    def force(t: float) -> float:
        y, rate = at(t)
        return -k * y - d * rate

    low, high = 0.5 * math.pi / w, 1.4 * math.pi / w
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if force(middle) > 0.0 else (low, middle)
    y, rate = at(low)
    flight = (rate + math.sqrt(rate * rate + 2 * g * y)) / g
    touch = math.sqrt(2 / g)
    return {
        "touch": touch, "lift": touch + low, "speed": rate, "again": touch + low + flight,
    }  # fmt: skip


_EXPECTED: dict[str, tuple[str, dict[str, float]]] = {
    "damped": (_BALL, _bounce(1000, 20)),
    "undamped": (_BALL.replace("d: 20", "d: 0").replace("0.9", "1.5"), _bounce(1000, 0)),
    "stiff": (_BALL.replace("k: 1000, d: 20", "k: 1e9, d: 0").replace("0.9", "1.4"),
              _bounce(1e9, 0)),
    "block": (_BLOCK, {"stops": 2 / (0.3 * 9.81), "x": 4 / (2 * 0.3 * 9.81)}),
    "feet": (_FEET, {
        "along": -2 * 9.81 * math.sin(0.2), "across": 2 * 9.81 * math.cos(0.2), "couple": 0.0}),
    # The angular momentum about a point of the surface stays: m v + I w/r.
    "wheel": (_WHEEL, {"rolls": (2 * 1 - 0.1 * 30) / 3}),
    "held": (_HELD, {"y": -9.81 / 1000, "off": 1.0}),
}  # fmt: skip


def _outputs(text: str, **setting: Any) -> dict[str, Any]:
    return dict(statechart.run(interpret(read_text(text, "soft.yaml")), **setting).outputs)


@pytest.mark.parametrize("name", [*_EXPECTED])
@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_a_compliant_contact_moves_as_its_closed_form(name: str, engine: str) -> None:
    text, expected = _EXPECTED[name]
    found = _outputs(text, engine=engine)
    for output, value in expected.items():
        assert found[output] == pytest.approx(value, abs=1e-9), output


@pytest.mark.parametrize("name", ["damped", "undamped", "block", "feet", "wheel", "held"])
def test_steps_come_nearer_to_the_closed_form_of_a_compliant_contact(name: str) -> None:
    text, expected = _EXPECTED[name]
    for step in (1e-3, 2e-4, 4e-5):
        found = _outputs(text, engine="impulse", step=step)
        off = max(abs(found[output] - value) for output, value in expected.items())
        assert off < 40 * step


@pytest.mark.parametrize("step", [1e-3, 5e-4, 2.5e-4, 1e-4])
def test_an_undamped_bounce_keeps_its_speed_to_second_order(step: float) -> None:
    """Implicit Euler took pi/4 times frequency and step: 10 % at 1e-3."""
    model = interpret(read_text(_BALL))
    run = statechart.run(
        model, parameters={"k": 1e4, "d": 0}, engine="impulse", step=step, until=0.6
    )
    y, dy = run.trace.final[[1, 3]]
    assert math.hypot(dy, math.sqrt(2 * 9.81 * y)) == pytest.approx(
        math.sqrt(2 * 9.81), rel=0.25 * 1e4 * step**2
    )


def test_rigid_contact_bounces_on_a_compliant_rope() -> None:
    text = _BALL.replace("bodies: {", "bodies: {stone: {mass: 2, start: {x: 3, y: 0.5}}, ")
    text = (
        text.replace(
            "stop: {time: 0.9}",
            "  tip: {point: {body: stone}, surface: mat, friction: 0.2, restitution: 0.5}\n"
            "joints: {rope: {point: {body: stone}, to: {body: ball}, rope: 5}}\nstop: {time: 0.98}",
        )
        .replace("contacts: {foot: {", "contacts:\n  foot: {")
        .replace("damping: d}}", "damping: d}")
    )
    found = statechart.run(interpret(read_text(text, "soft.yaml")))
    for output, value in _bounce(1000, 20).items():
        assert found.outputs[output] == pytest.approx(value, abs=1e-9), output
    assert found.trace.final[1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("stiffness", [1e4, 1e7, 1e12])
@pytest.mark.parametrize("damping", [0, 100])
def test_steps_longer_than_a_contact_lasts_add_no_energy(stiffness: float, damping: float) -> None:
    text = _BALL.replace("k: 1000, d: 20", f"k: {stiffness}, d: {damping}").replace("0.9", "3")
    model = interpret(read_text(text, "soft.yaml"))
    trace = statechart.run(model, engine="impulse", step=0.02).trace
    energies = [
        9.81 * y + 0.5 * v * v
        for arc in trace.arcs
        if arc.mode == ("free",)
        for y, v in arc.states(arc.times)[:, [1, 3]].tolist()
    ]
    # In flight the delay of a step adds g^2 h^2/8 per unit of mass.
    assert max(energies) <= 9.81 * (1 + 1e-3)


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("stiffness: k,", "stiffness: k, restitution: 0.5,", "no restitution"),
        ("stiffness: k,", "stiffness: k, impact: newton,", "no impact"),
        ("stiffness: k, damping: d", "damping: d, restitution: 0", "give a stiffness"),
        ("stiffness: k,", "stiffness: 0,", "must be positive"),
        ("damping: d", "damping: -1", "must be zero or positive"),
        ("stiffness: k,", "stiffness: ball.y,", "ball.y"),
    ],
)
def test_a_mistake_in_a_compliant_contact_is_reported(old: str, new: str, reported: str) -> None:
    assert old in _BALL
    with pytest.raises(DeclarationError, match=reported):
        interpret(read_text(_BALL.replace(old, new), "soft.yaml"))


_PUSHED = """
kind: scene
name: pushed
gravity: 0
parameters: {w: 0.8, k: 40, d: 6, L: 3}
%sbodies: {b: {mass: 1, inertia: 1, start: {y: 0.08}}}
joints: {guide: {point: {body: b}, to: {x: 0}}}
couplings: {brake: {joint: guide, limit: L}}
surfaces: {plate: {height: 0, displacement: [0, %s]}}
contacts: {c: {point: {body: b}, surface: plate, friction: 0, stiffness: k, damping: d}}
stop: {time: 0.2}
outputs: {gap: {value: c.gap}, slips: {value: time, at: first brake.slip}}
"""


@pytest.mark.parametrize(("engine", "step"), [("taylor", None), ("impulse", 1e-4)])
@pytest.mark.parametrize("led", [False, True])
def test_a_landing_damper_moves_a_braked_body(engine: str, step: float | None, led: bool) -> None:
    # The damper's force at the touch, d w, exceeds the limit: the brake slips at once, and the gap
    # obeys g'' + d g' + k g = -L.
    region = "regions: {r: {initial: on, variables: {s: 0}, states: {on: {flows: {s: w}}}}}\n"
    text = _PUSHED % ((region, "s") if led else ("", "w*time"))
    result = statechart.Runner(read_text(text, "pushed.yaml"), engine=engine, step=step).run()
    settled, turns = -3.0 / 40.0, math.sqrt(40.0 - 9.0)
    cosine, sine = math.cos(turns * 0.1), math.sin(turns * 0.1)
    wave = -settled * cosine + (-0.8 - 3.0 * settled) / turns * sine
    gap = settled + math.exp(-0.3) * wave
    # By steps the mode begins with the step at whose end the gap closes.
    allowed = 1e-9 if step is None else step * (1 + 1e-9)
    assert result.trace.jumps[0].t == pytest.approx(0.1, abs=allowed)
    assert result.outputs["gap"] == pytest.approx(gap, abs=1e-11 if step is None else 5 * step)


@pytest.mark.parametrize(
    ("start", "reported"),
    [
        ("{y: 0.4, x: 0.2}", "0.04 apart; a position that closes all: load.y = 0.36"),
        ("{y: 0.36, x: 0.2, dy: 1}", "apart at 1; velocities that it allows: load.dy = 0"),
    ],
)
def test_inconsistent_joints_with_compliant_contacts_suggest_a_start(
    start: str, reported: str
) -> None:
    text = f"""
kind: scene
name: cart
gravity: 9.81
bodies:
  b: {{mass: 1, start: {{y: 0.26}}}}
  load: {{mass: 0.4, start: {start}}}
surfaces: {{floor: {{height: 0}}}}
contacts: {{foot: {{point: {{body: b}}, surface: floor, friction: 0, stiffness: 1000}}}}
joints: {{peg: {{point: {{body: load}}, to: [0.2, 0.36]}}}}
stop: {{time: 1}}
"""
    with pytest.raises(DeclarationError) as caught:
        statechart.run(interpret(read_text(text)))
    assert reported in str(caught.value)


def test_pads_that_steps_do_not_resolve_together_add_no_energy() -> None:
    """Each of nine pads is soft for a step, all of them are not: h^2 k/m is 1/9 and 1."""
    h, count = 1e-3, 9
    pads = "".join(
        f"  pad{i}: {{point: {{body: plank, at: [{i / (count - 1) - 0.5}, 0]}}, surface: mat, "
        "friction: 0, stiffness: k, damping: 0}\n"
        for i in range(count)
    )
    text = (
        "kind: scene\nname: plank\nparameters: {k: 1, y: 1}\ngravity: 9.81\n"
        "bodies: {plank: {mass: 1, inertia: 1, start: {y: y}}}\nsurfaces: {mat: {height: 0}}\n"
        f"contacts:\n{pads}stop: {{time: 0.6}}\n"
        "outputs: {energy: {maximum: plank.dy**2/2 + 9.81*plank.y}}\n"
    )
    model = interpret(read_text(text, "plank.yaml"))
    for stiffness in (0.6, 1.0):
        for start in range(6):
            height = 0.3 + start * 4e-4
            run = statechart.run(
                model, parameters={"k": stiffness / count / h**2, "y": height},
                engine="impulse", step=h,
            )  # fmt: skip
            assert run.outputs["energy"] <= 9.81 * height * (1 + 1e-3)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_a_joint_lets_go_at_the_touchdown_whose_damper_overloads_it(engine: str) -> None:
    text = """
kind: scene
name: magnet
gravity: 9.81
parameters: {h: 0.2}
bodies: {cart: {mass: 1, start: {y: h}}, load: {mass: 1, start: {y: h}}}
surfaces: {floor: {height: 0}}
contacts: {pad: {point: {body: cart}, surface: floor, friction: 0, stiffness: 1000, damping: 50}}
joints:
  magnet: {point: {body: load}, to: {body: cart}, enabled: 'abs(magnet.Y) <= 20'}
outputs: {off: {value: time, at: first magnet.disable}}
"""
    runner = statechart.Runner(read_text(text), engine=engine)
    # In half of them the gap rounds to above zero at the touchdown.
    for h in np.linspace(0.1, 0.5, 30).tolist():
        off = runner.run({"h": h}, until=0.4).outputs["off"]
        assert off == pytest.approx(math.sqrt(2.0 * h / 9.81), abs=1e-11)


_TABLE = """
kind: scene
name: table
gravity: 9.81
bodies: {table: {mass: 200, inertia: 2, start: {y: 0.6 - 200*9.81/6e4, dangle: 0.04}}}
surfaces: {floor: {height: 0}}
contacts:
  left: {point: {body: table, at: [-1.4, -0.6]}, surface: floor, friction: 0.3, FOOT}
  right: {point: {body: table, at: [0.1, -0.6]}, surface: floor, friction: 0.3, FOOT}
stop: {time: 0.02}
"""


@pytest.mark.parametrize("step", [1e-4, 5e-5])
def test_slow_slip_that_stops_on_compliant_feet_adds_no_energy(step: float) -> None:
    """The mass of the feet is the scale of the energy, not the compliance of their pads."""
    text = _TABLE.replace("FOOT", "stiffness: 3e4, damping: 5")
    trace = statechart.run(read_text(text), engine="impulse", step=step).trace
    assert trace.t_end == pytest.approx(0.02, abs=1e-9)


ROCKING = """
kind: scene
name: rocking
gravity: 9.81
bodies: {b: {mass: 1, inertia: 0.02, start: {y: 0.1, dx: -0.5}}}
surfaces: {floor: {height: 0}}
contacts:
  soft: {point: {body: b, at: [-0.2, -0.1]}, surface: floor,
    friction: {static: 0.7, kinetic: 0.5}, stiffness: 2e4, damping: 100}
  hard: {point: {body: b, at: [0.2, -0.1]}, surface: floor,
    friction: {static: 0.7, kinetic: 0.5}, restitution: 0, impact: moreau}
forces: {rock: {body: b, moment: 0.3*sin(40*time)}}
stop: {time: 0.4}
"""


@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_a_foot_beside_a_pinned_foot_creeps_as_the_box_turns(step: float) -> None:
    # While one foot is pinned the other slips at 0.4 sin(angle) |dangle|, here by 1e-6: both are
    # pinned only where the box does not turn, in steps that settle.
    result = statechart.run(interpret(read_text(ROCKING)), engine="impulse", step=step)
    arcs = result.trace.arcs
    still = [arc.duration for arc in arcs if arc.mode == ("pin", "pin")]
    assert sum(arc.mode in (("pin", "slide+"), ("slide+", "pin")) for arc in arcs) >= 4
    assert max(still, default=0.0) <= 4.5 * step


ROUGH = """
kind: scene
name: rough
gravity: 9.81
bodies: {b: {mass: 1, inertia: 0.02, start: {y: 0.5, dx: DX}}}
surfaces: {s: {height: 0}}
contacts: {f: {point: {body: b}, radius: 0.2, surface: s, friction: inf, stiffness: 1000}}
stop: {time: 0.5}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_a_slip_at_the_touch_of_infinite_friction_is_advised_a_finite_one(engine: str) -> None:
    landing = statechart.run(read_text(ROUGH.replace("DX", "0")), engine=engine)
    assert landing.trace.jumps[0].t == pytest.approx((0.6 / 9.81) ** 0.5)
    result = statechart.run(read_text(ROUGH.replace("DX", "1")), engine=engine, throw=False)
    assert result.trace.outcome.name == "NO_CONSISTENT_MODE"
    assert "'f' touches with a slip" in result.trace.message
    assert "write contacts.f.friction: 100" in result.trace.message
