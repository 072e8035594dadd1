"""Bodies on two compliant feet that stick: level feet are dependent, tilted ones are not."""

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
