"""Bodies on two compliant feet that stick: level feet are dependent, tilted ones are not."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from statechart import run
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text

TABLE = """\
kind: scene
name: table
gravity: 9.81
bodies: {t: {mass: 1, inertia: 0.1, start: START}}
surfaces: {floor: {height: 0}}
contacts:
  a: {point: {body: t, at: [-0.5, -0.5]}, surface: floor, friction: 0.5, stiffness: 2000, damping: 10}
  b: {point: {body: t, at: [0.5, -0.5]}, surface: floor, friction: 0.5, stiffness: 2000, damping: 10}
forces: {push: {body: t, moment: AMPLITUDE*sin(5*time)}}
stop: {time: 2}
"""  # noqa: E501


def regularised(start, amplitude, slow):
    """Integrate the table with friction that is smooth below a slip, by code of its own."""

    def rates(t, state):
        _, y, angle, dx, dy, dangle = state
        force = np.array([0.0, -9.81, amplitude * np.sin(5 * t)])
        for side in (-0.5, 0.5):
            across = side * np.cos(angle) + 0.5 * np.sin(angle)
            up = side * np.sin(angle) - 0.5 * np.cos(angle)
            normal = max(0.0, -2000 * (y + up) - 10 * (dy + dangle * across))
            if y + up > 0:
                normal = 0.0
            friction = -0.5 * normal * np.tanh((dx - dangle * up) / slow)
            force += friction, normal, across * normal - up * friction
        return dx, dy, dangle, *(force / (1, 1, 0.1))

    found = solve_ivp(rates, (0, 2), start, method="LSODA", rtol=1e-8, atol=1e-13)
    return found.y[:, -1]


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_moment_rocks_level_feet_that_stick(engine):
    # Level feet imply each other's constraints; the first turn ends that, and one of them slides.
    text = TABLE.replace("START", "{y: 0.4975475}").replace("AMPLITUDE", "0.3")
    trace = run(read_text(text), engine=engine).trace
    expected = regularised([0, 0.4975475, 0, 0, 0, 0], 0.3, 1e-9)
    assert trace.final[2] == pytest.approx(-1.584185e-4, abs=1e-9)
    assert trace.final[[0, 2]] == pytest.approx(expected[[0, 2]], rel=3e-5)
    assert {"slip", "stick", "reverse"} <= {jump.cause for jump in trace.jumps}
    # The slip between the feet is sin(a) a': it turns round where the table swings through level.
    level = [jump.cause for jump in trace.jumps if abs(jump.before[2]) < 1e-12]
    assert level == ["reverse"] * 3


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_dropped_table_comes_to_rest_on_both_feet(engine):
    text = TABLE.replace("START", "{y: 0.5, angle: 0.05}").replace("AMPLITUDE", "0")
    trace = run(read_text(text), engine=engine).trace
    assert trace.outcome is Outcome.HORIZON
    assert trace.final[[0, 2]] == pytest.approx([0.0443834, 0], abs=1e-7)
    expected = regularised([0, 0.5, 0.05, 0, 0, 0], 0, 1e-6)
    assert trace.final[:3] == pytest.approx(expected[:3], abs=1e-5)


THREE_FEET = """\
kind: scene
name: table
gravity: 9.81
bodies: {t: {mass: 0.645033, inertia: 0.0041051, start: {y: 0.164320155}}}
surfaces: {floor: {height: 0}}
contacts:
  a: {point: {body: t, at: [-0.1218145, -0.164333]}, FOOT}
  b: {point: {body: t, at: [0, -0.164333]}, FOOT}
  c: {point: {body: t, at: [0.1570739, -0.164333]}, FOOT}
stop: {time: 0.26}
""".replace("FOOT", "surface: floor, friction: 0.5, stiffness: 164169.3, damping: 0")


def test_events_of_nearly_level_feet_keep_the_rotation_of_their_body():
    # Uneven loads rock it by 1e-5. Radau with friction that is smooth below a slip of 1e-9.
    trace = run(read_text(THREE_FEET), engine="scipy").trace
    expected = [-3.78195e-6, 2.30138e-5, -6.93635e-4]
    assert trace.final[[0, 2, 5]] == pytest.approx(expected, rel=2e-3)


TILTED = """\
kind: scene
name: tilted
parameters: {k: 14000, a: ANGLE, s: -0.113, h: 0.1*cos(a) - 5*cos(s)/k}
gravity: 10
surfaces: {floor: {incline: s}}
bodies:
  b: {mass: 1, inertia: 0.02, start: {x: -h*sin(s), y: h*cos(s), angle: s + a}}
  load: {mass: 1, inertia: 0.01, start: {y: 3, angle: s + a}}
contacts:
  left: {point: {body: b, at: [-0.2, -0.1]}, surface: floor, friction: 0.8, stiffness: k, damping: 80}
  right: {point: {body: b, at: [0.2, -0.1]}, surface: floor, friction: 0.8, stiffness: k, damping: 80}
couplings: {rub: {bodies: [load, b], limit: 1}}
forces: {turn: {body: b, moment: MOMENT + RATE*time}}
stop: {time: 0.11}
"""  # noqa: E501


def tilted(angle: float, slip: float) -> tuple[str, float, str]:
    """Return a scene whose foot slips at a time, its margin of friction at the start, and its name.

    At rest H = +-r t/(0.4 sin a) of the two feet, on top of half the weight along the slope.
    """
    across = [np.cos(angle) * x + 0.1 * np.sin(angle) for x in (-0.2, 0.2)]
    up = [np.sin(angle) * x - 0.1 * np.cos(angle) for x in (-0.2, 0.2)]
    height = 0.1 * np.cos(angle) - 5 * np.cos(-0.113) / 14000
    normal = [-14000 * (height + y) for y in up]
    along = 5 * np.sin(-0.113)
    moment = along * sum(up) - sum(n * x for n, x in zip(normal, across, strict=True))
    first, force = min(
        (0.8 * normal[0] + along, "left.mu V + H"), (0.8 * normal[1] - along, "right.mu V - H")
    )
    text = TILTED.replace("ANGLE", repr(angle)).replace("MOMENT", repr(float(moment)))
    return text.replace("RATE", repr(float(first * 0.4 * np.sin(angle) / slip))), first, force


@pytest.mark.parametrize(
    ("angle", "settings"),
    [(3e-5, {}), (8e-5, {}), (1e-3, {}), (3e-5, {"engine": "scipy", "tolerance": 1e-8})],
)
def test_the_slip_of_feet_that_are_nearly_level_tells_the_round_off_of_their_forces(
    angle: float, settings: dict[str, Any]
) -> None:
    text, first, force = tilted(angle, 0.1)
    result = run(read_text(text), **settings)
    jump = result.trace.jumps[0]
    assert (jump.cause, jump.fired) == ("slip", (force,))
    (warning,) = [warning for warning in result.warnings if "is known to" in warning]
    known = float(warning.removeprefix(f"{force} is known to ").split()[0])
    # The margin falls by `first` in 0.1. Its enclosure is wider than the round-off of its value.
    assert jump.t - 0.1 == pytest.approx(known * 0.1 / first, rel=0.3)
    assert known < 1e-11 / angle**2


@pytest.mark.parametrize("tolerance", [1e-10, 1e-12, 1e-13])
def test_steps_do_not_shrink_below_the_round_off_of_the_rates(tolerance: float) -> None:
    # That both feet stick forbids the body to turn, by forces of order 1/a.
    text, _, force = tilted(8e-5, 0.03)
    result = run(read_text(text), engine="scipy", tolerance=tolerance, until=0.039)
    jump = result.trace.jumps[0]
    assert (jump.cause, jump.fired) == ("slip", (force,))
    # They magnify round-off, as taylor's: 0.0300037.
    assert jump.t == pytest.approx(0.03, rel=1e-3)
    assert result.trace.counts["steps"] < 1000  # 37546 at 1e-12 if errors of round-off shorten them
