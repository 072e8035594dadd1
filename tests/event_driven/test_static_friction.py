"""Static and kinetic friction, and kinetic friction that depends on the slip."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from statechart import sweep
from statechart.documents.yaml_reader import read_text
from statechart.errors import AmbiguousMode, DeclarationError
from statechart.running.result import Result
from statechart.running.runner import Runner

G = 9.81
STEP = 1e-4
both = pytest.mark.parametrize("engine", ["taylor", "scipy"])
every = pytest.mark.parametrize("engine", ["taylor", "scipy", "impulse"])


def ran(text: str, engine: str, **parameters: float) -> Result:
    setting: dict[str, Any] = {"engine": engine}
    if engine == "impulse":
        setting["step"] = STEP
    return Runner(read_text(text, "f.yaml"), **setting).run(parameters)


def near(engine: str, tolerance: float) -> float:
    """Return the tolerance of an engine: the first order of steps, with a factor."""
    return 20.0 * STEP if engine == "impulse" else tolerance


DRAGGED = """
kind: scene
name: dragged
parameters: {m: 1, k: 50, v: 0.1, s: 0.9, mu: 0.2}
gravity: 9.81
bodies: {block: {mass: m}}
surfaces: {floor: {height: 0}}
contacts:
  base: {point: {body: block}, surface: floor, modes: [slide, pin],
         friction: {static: s, kinetic: mu}}
forces: {spring: {body: block, force: [k*(v*time - block.x), 0]}}
stop: {time: 6}
outputs:
  slips: {value: time, at: each base.slip}
  sticks: {value: time, at: each base.stick}
"""


def period(m: float, k: float, v: float, s: float, mu: float) -> tuple[float, float]:
    """Return the time that a block on a belt sticks, and that it slips."""
    w, reach = math.sqrt(k / m), (s - mu) * m * G / k
    return 2.0 * reach / v, (2.0 * math.pi - 2.0 * math.atan(reach * w / v)) / w


@every
def test_a_dragged_block_holds_where_static_friction_does(engine: str) -> None:
    result = ran(DRAGGED, engine)
    sticks, slips = period(1.0, 50.0, 0.1, 0.9, 0.2)
    first = 0.9 * G / 5.0
    expected = [first, first + sticks + slips]
    assert result.outputs["slips"] == pytest.approx(expected, abs=near(engine, 1e-11))
    ends = [time + slips for time in expected]
    assert result.outputs["sticks"] == pytest.approx(ends, abs=near(engine, 1e-11))
    assert {jump.cause for jump in result.trace.jumps} == {"slip", "stick"}


BELT = """
kind: scene
name: belt
parameters: {m: 1.3, k: 40, v: 0.2, s: 0.6, mu: 0.25}
gravity: 9.81
bodies: {block: {mass: m, start: {dx: v}}}
surfaces: {belt: {height: 0, displacement: [v*time, 0]}}
contacts:
  base: {point: {body: block}, surface: belt, modes: [slide, pin],
         friction: {static: s, kinetic: mu}}
forces: {spring: {body: block, force: [-k*block.x, 0]}}
stop: {time: 8}
outputs:
  slips: {value: time, at: each base.slip}
"""


@both
@pytest.mark.parametrize("mu", [0.0, 0.25, 0.55])
def test_a_block_on_a_belt_has_the_period_of_its_closed_form(engine: str, mu: float) -> None:
    slips = ran(BELT, engine, mu=mu).outputs["slips"]
    expected = sum(period(1.3, 40.0, 0.2, 0.6, mu))
    assert len(slips) >= 3
    assert np.diff(slips) == pytest.approx(expected, abs=1e-12)


ROOT = """
kind: scene
name: root
parameters: {v: 2}
gravity: 9.81
bodies: {block: {mass: 1, start: {dx: v}}}
surfaces: {floor: {height: 0}}
contacts:
  base: {point: {body: block}, surface: floor, modes: [slide, pin],
         friction: {static: 0.5, kinetic: 0.3*sqrt(abs(slip)) + 0.1}}
stop: {time: 2}
outputs: {stop: {value: time, at: first base.stick}}
"""


@every
@pytest.mark.parametrize("v", [2.0, -2.0])
def test_friction_with_a_root_of_the_slip_brings_a_block_to_rest(engine: str, v: float) -> None:
    # With u = sqrt(v) the time is the integral of 2 u/(g (0.3 u + 0.1)).
    u, share = math.sqrt(abs(v)), 1.0 / 3.0
    stop = 2.0 / (0.3 * G) * (u - share * math.log1p(u / share))
    result = ran(ROOT, engine, v=v)
    assert result.outputs["stop"] == pytest.approx(stop, abs=near(engine, 1e-11))
    assert not result.warnings


STRIBECK = BELT.replace(
    "friction: {static: s, kinetic: mu}", "friction: mu + (s - mu)*exp(-abs(slip)/0.1)"
)


@every
def test_stribecks_curve_matches_an_integration(engine: str) -> None:
    m, k, v, s, mu = 1.3, 40.0, 0.2, 0.6, 0.25
    result = ran(STRIBECK, engine)
    begin = s * m * G / k

    def rates(_: float, y: np.ndarray) -> list[float]:
        friction = m * G * (mu + (s - mu) * math.exp((y[1] - v) / 0.1))
        return [y[1], (friction - k * y[0]) / m]

    path = solve_ivp(
        rates, (0.0, 2.0), [begin, v], method="DOP853", rtol=1e-13, atol=1e-15, dense_output=True
    ).sol
    times = np.linspace(1e-2, 2.0, 4000)
    place = int(np.argmax(path(times)[1] >= v))
    stuck = brentq(lambda t: path(t)[1] - v, times[place - 1], times[place], xtol=1e-15)
    sticks = (begin - path(stuck)[0]) / v
    slips = result.outputs["slips"]
    assert slips[0] == pytest.approx(begin / v, abs=near(engine, 1e-12))
    # Slip begins on the flank of the curve: an instant's error grows with exp(t s g/(0.1 w)).
    assert np.diff(slips) == pytest.approx(stuck + sticks, abs=50.0 * near(engine, 2e-11))


@both
def test_reasons_name_the_friction_coefficient(engine: str) -> None:
    slip, stick, *_ = ran(DRAGGED, engine).trace.jumps
    assert slip.considered["base:pin"] == "base: |H| = 8.829 > mu V (base: static friction 0.9)"
    assert slip.considered["base:slide+"] == "taken (base: kinetic friction 0.2)"
    assert stick.considered["base:slide-"] == "consistent (base: kinetic friction 0.2)"
    assert stick.considered["base:pin"] == "taken (base: static friction 0.9)"


BOX = """
kind: scene
name: box
parameters: {s: 0.5, mu: 0.3, F: 20}
gravity: 9.81
bodies:
  box: {mass: 2, inertia: 0.1, shape: {polygon: [[-1, -0.1], [1, -0.1], [1, 0.1], [-1, 0.1]]},
        start: {y: 0.1}}
surfaces: {floor: {height: 0}}
contacts:
  rear: {point: {body: box, at: [-1, -0.1]}, surface: floor, restitution: 0,
         friction: {static: s, kinetic: mu}}
  front: {point: {body: box, at: [1, -0.1]}, surface: floor, restitution: 0,
          friction: {static: s, kinetic: mu}}
forces: {pull: {body: box, force: [F*time, 0]}}
stop: {time: 1}
outputs:
  slips: {value: time, at: first rear.slip}
  end: {value: box.dx}
"""


@every
def test_two_feet_share_a_load_up_to_static_friction(engine: str) -> None:
    result = ran(BOX, engine)
    slips = 0.5 * 2.0 * G / 20.0
    # m dv/dt = F t - mu m g from there on.
    end = (10.0 * (1.0 - slips**2) - 0.3 * 2.0 * G * (1.0 - slips)) / 2.0
    assert result.outputs["slips"] == pytest.approx(slips, abs=near(engine, 1e-11))
    assert result.outputs["end"] == pytest.approx(end, abs=near(engine, 1e-10))


DISC = """
kind: scene
name: disc
parameters: {a: atan(0.75), s: 0.4, mu: 0.1, spin: 0}
gravity: 9.81
bodies:
  disc: {mass: 1, inertia: 0.5, start: {x: -sin(a), y: cos(a), dangle: spin}}
surfaces: {slope: {incline: -a}}
contacts:
  rim: {point: {body: disc}, radius: 1, surface: slope, modes: [slide, pin],
        friction: {static: s, kinetic: mu}}
stop: {time: 1}
outputs:
  dx: {value: disc.dx}
"""


@every
@pytest.mark.parametrize("static", [0.3, 0.2])
def test_a_disc_rolls_down_where_static_friction_holds_it(engine: str, static: float) -> None:
    text = DISC.replace("{x: -sin(a), y: cos(a), dangle: spin}", "{x: sin(a), y: cos(a)}")
    result = ran(text, engine, s=static)
    # Rolling takes tan(a)/3 = 0.25 of the load.
    along = G * 0.6 / 1.5 if static > 0.25 else G * (0.6 - 0.1 * 0.8)
    assert result.outputs["dx"] == pytest.approx(0.8 * along, abs=near(engine, 1e-12))


ROD = """
kind: scene
name: rod
parameters: {s: 0.9, mu: 0.1, u: 0}
gravity: 0
bodies:
  rod: {mass: 1, inertia: 1/3, start: {x: 0, y: 0.8 + 0.1, angle: atan(0.75), dx: u, dy: -1}}
surfaces: {floor: {height: 0}}
contacts:
  tip: {point: {body: rod, at: [0, -1]}, surface: floor, restitution: 0,
        friction: {static: s, kinetic: mu}}
stop: {time: 0.2}
outputs:
  slip: {value: tip.slip, at: first tip.touchdown}
"""


@every
@pytest.mark.parametrize(
    ("s", "u", "ratio"), [(0.9, 0.0, 0.72 / 1.46), (0.3, 0.0, 0.1), (0.9, 3.0, 0.1)]
)
def test_an_impact_slips_under_kinetic_and_sticks_under_static_friction(
    engine: str, s: float, u: float, ratio: float
) -> None:
    # A stick takes |P_t/P_n| = 3 sin cos/(1 + 3 cos^2) of a rod that stands at the angle.
    result = ran(ROD, engine, s=s, u=u)
    normal, tangential = result.trace.jumps[0].impulse["tip"]
    assert abs(tangential) / normal == pytest.approx(ratio, abs=1e-9)
    assert (abs(result.outputs["slip"]) < 1e-9) == (ratio > 0.1)


SWITCHED = DRAGGED.replace(
    "friction: {static: s, kinetic: mu}", "friction: {static: c, kinetic: c/3}"
)
SWITCHED = SWITCHED.replace("stop:", """
controls: {c: s}
regions:
  ground:
    initial: dry
    states: {dry: {sets: {c: s}}, wet: {sets: {c: s/2}}}
    transitions: [{name: rain, from: dry, to: wet, guard: time >= 1.5}]
stop:""")  # fmt: skip


@every
def test_controllers_switch_both_coefficients(engine: str) -> None:
    result = ran(SWITCHED, engine)
    # At 1.5 s the spring pulls by 7.5, more than wet ground holds (0.45 g).
    slips = result.outputs["slips"]
    assert slips[0] == pytest.approx(1.5, abs=near(engine, 1e-12))
    # It stops where the spring has gone from 7.5 to as much below 0.15 g, and turns round there.
    w = math.sqrt(50.0)
    reach = 7.5 - 0.15 * G
    lasts = (2.0 * math.pi - 2.0 * math.atan(reach / 50.0 * w / 0.1)) / w
    turns = [jump.t for jump in result.trace.jumps if jump.cause == "reverse"]
    assert turns == pytest.approx([1.5 + lasts], abs=near(engine, 1e-10))


@pytest.mark.parametrize(
    ("friction", "words"),
    [
        ("{static: 0.1, kinetic: 0.2}", "the static coefficient 0.1 is below the kinetic one"),
        ("{static: 0.5, kinetic: 0.3 + 0.4*exp(-abs(slip))}", "one at rest, 0.7"),
        ("{static: 0.5, kinetic: 0.4 + 0.2*sign(slip)}", "one at rest, 0.6"),
        ('{static: 0.5, kinetic: "0.3*max(slip, 1)"}', "max of slip has no derivative"),
        ("{static: 0.5, kinetic: abs(slip - 1)}", "abs of slip has no derivative"),
        ("{static: slip, kinetic: 0.1}", "unknown name 'slip'"),
        ("{static: 0.5}", "'kinetic' is missing"),
        ("{static: 0.5, mu_k: 0.3}", "write kinetic"),
    ],
)
def test_invalid_laws_of_friction_are_refused(friction: str, words: str) -> None:
    text = DRAGGED.replace("{static: s, kinetic: mu}", friction)
    with pytest.raises(DeclarationError) as caught:
        Runner(read_text(text, "f.yaml"))
    assert words in str(caught.value)


def test_overridden_coefficients_are_checked() -> None:
    with pytest.raises(DeclarationError, match="the static coefficient"):
        ran(DRAGGED, "taylor", s=0.1)

    with pytest.raises(DeclarationError, match=r"0\.9 is below the kinetic one at rest, inf"):
        ran(DRAGGED, "taylor", mu=math.inf)


@every
def test_a_compliant_contact_has_both_coefficients(engine: str) -> None:
    text = DRAGGED.replace("{mass: m}", "{mass: m, start: {y: -m*9.81/4e3}}")
    text = text.replace("modes: [slide, pin]", "stiffness: 4e3, damping: 100")
    result = ran(text, engine)
    sticks, slips = period(1.0, 50.0, 0.1, 0.9, 0.2)
    expected = [0.9 * G / 5.0 + n * (sticks + slips) for n in (0, 1)]
    assert result.outputs["slips"] == pytest.approx(expected, abs=near(engine, 1e-11))
    ends = [time + slips for time in expected]
    assert result.outputs["sticks"] == pytest.approx(ends, abs=near(engine, 1e-11))


@every
def test_sweeps_vary_both_coefficients(engine: str) -> None:
    text = DRAGGED[: DRAGGED.index("outputs:")] + (
        "outputs:\n  first: {value: time, at: first base.slip}\n"
        "  last: {value: time, at: last base.slip}\n  slips: {count: base.slip}\n"
    )
    statics, kinetics = [0.3, 0.6, 0.9], [0.1, 0.2, 0.3, 0.4]
    words = {"engine": engine} | ({"step": 10.0 * STEP} if engine == "impulse" else {})
    found = sweep(read_text(text, "f.yaml"), {"s": statics, "mu": kinetics}, **words)
    for s, mu in product(statics, kinetics):
        first, last, count = (
            float(found[name].sel(s=s, mu=mu)) for name in ("first", "last", "slips")
        )
        if s < mu:
            assert math.isnan(first)
        elif s > mu:
            once, close = sum(period(1.0, 50.0, 0.1, s, mu)), 10.0 * near(engine, 1e-11)
            assert first == pytest.approx(s * G / 5.0, abs=close)
            assert last == pytest.approx(first + (count - 1) * once, abs=close)
            assert count == 1 + (6.0 - s * G / 5.0) // once


@both
def test_both_sides_of_zero_have_their_own_friction(engine: str) -> None:
    text = DRAGGED.replace("kinetic: mu}", "kinetic: 0.3 + 0.1*sign(slip)}")
    text = text.replace("{mass: m}", "{mass: m, start: {dx: v0}}").replace("v: 0.1", "v0: 1, v: 0")
    text = text.replace("50", "0")
    for v0, mu in ((1.0, 0.4), (-1.0, 0.2)):
        sticks = ran(text, engine, v0=v0).outputs["sticks"]
        assert sticks == pytest.approx([1.0 / (mu * G)], abs=1e-12)


INCHWORM = """
kind: scene
name: inchworm
parameters: {m: 1}
gravity: 10
bodies: {tail: {mass: 1}, head: {mass: m, start: {x: 1, dx: 0.2}}}
surfaces: {floor: {height: 0}}
contacts:
  rear: {point: {body: tail}, surface: floor, friction: {static: 0.6, kinetic: 0.4}, IMPACT}
  front: {point: {body: head}, surface: floor, friction: {static: 0.6, kinetic: 0.4}, IMPACT}
joints: {back: {point: {body: tail}, to: {body: head}, rod: 1 + 0.1*sin(2*time)}}
stop: {time: 1.5}
""".replace("IMPACT", "restitution: 0, impact: moreau")


@every
@pytest.mark.parametrize(("m", "grips"), [(0.9, "rear"), (1.1, "front")])
def test_foot_that_static_friction_holds_less_breaks_loose(
    engine: str, m: float, grips: str
) -> None:
    """As the back shortens, the head breaks loose under 6 m + 0.4 m, the tail under 6 + 0.4."""
    result = ran(INCHWORM, engine, m=m)
    length = 1.0 + 0.1 * math.sin(3.0)
    tail = 0.0 if grips == "rear" else 1.1 - length
    assert result.trace.final[0] == pytest.approx(tail, abs=near(engine, 1e-9))
    assert result.trace.final[2] == pytest.approx(tail + length, abs=near(engine, 1e-9))
    modes = dict(zip(("rear", "front"), result.trace.jumps[-1].target, strict=True))
    assert modes[grips] == "pin"


@both
def test_feet_of_which_none_breaks_loose_first_are_ambiguous(engine: str) -> None:
    with pytest.raises(AmbiguousMode, match="does not decide between rear:pin front:slide-"):
        ran(INCHWORM, engine)
