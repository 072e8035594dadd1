"""Forces on bodies with shapes, and controllers that set them and move surfaces."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import Runner

SCENE = """
kind: scene
name: pushed
parameters: {{F: 3, g: 9.81}}
gravity: {gravity}
bodies:
  box: {{mass: 2, inertia: 0.1, start: {{y: 0.1}},
    shape: {{polygon: [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]}}}}
  ball: {{copies: 3, mass: 1, inertia: 0.02, start: {{x: 1 + index, y: 0.1}}, shape: {{disc: 0.1}}}}
surfaces: {{ground: {{height: 0}}{surfaces}}}
collisions:
  all: {{bodies: [box, ball], surfaces: [ground{names}], friction: {mu}, restitution: 0}}
{more}
stop: {{time: {time}}}
settings: {{engine: impulse, step: 1e-3}}
"""


def text(more, *, mu=0.0, time=1.0, gravity="g", surfaces="", names=""):
    return SCENE.format(
        more=more, mu=mu, time=time, gravity=gravity, surfaces=surfaces, names=names
    )


def run(scene):
    result = Runner(interpret(read_text(scene))).run()
    assert result.trace.outcome is Outcome.HORIZON, result.trace.message
    return result


def test_a_constant_force_accelerates_a_box():
    final = run(
        text("forces: {push: {body: box, force: [F, 0], at: [0, -0.05]}}", time=0.8)
    ).trace.final
    # Its moment is borne by the ground.
    assert final[[0, 1, 2]] == pytest.approx([0.48, 0.1, 0.0], abs=1e-9)
    assert final[12] == pytest.approx(1.2, abs=1e-9)


def test_forces_and_moments_turn_a_free_body():
    more = "forces: {push: {body: box, force: [0, F], at: [0.1, 0], moment: 0.2}}"
    final = run(text(more, gravity=0, time=0.01)).trace.final
    assert final[14] == pytest.approx((3 * 0.1 + 0.2) / 0.1 * 0.01, rel=1e-4)


def test_a_force_on_a_body_with_copies_acts_on_each():
    more = "forces: {drag: {body: ball, force: [-2*(ball.x - 1.5), 0]}}"
    final = run(text(more, gravity=0, time=0.3)).trace.final
    wave = math.cos(math.sqrt(2) * 0.3)
    assert final[3:12:3] == pytest.approx([1.5 + (k - 0.5) * wave for k in range(3)], abs=1e-6)


def test_a_force_on_one_copy_leaves_the_others():
    final = run(text("forces: {push: {body: ball1, force: [1, 0]}}", time=0.5)).trace.final
    assert final[3:12:3] == pytest.approx([1.0, 2.125, 3.0], abs=1e-9)


BANG = """
controls: {push: 0}
forces: {act: {body: box, force: [push, 0]}}
regions:
  motor:
    initial: forward
    states: {forward: {sets: {push: F}}, back: {sets: {push: -F}}}
    transitions:
      - {name: far, from: forward, to: back, guard: box.x >= 0.25}
"""


def test_a_controller_switches_a_force_on_a_guard():
    result = run(text(BANG, time=0.8))
    trace = result.trace
    turned = math.sqrt(2 * 0.25 * 2 / 3)
    (jump,) = (jump for jump in trace.jumps if jump.region == "motor")
    assert jump.t == pytest.approx(turned, abs=1e-3)
    v, rest = 1.5 * turned, 0.8 - turned
    assert trace.final[0] == pytest.approx(0.25 + v * rest - 0.75 * rest**2, abs=2e-3)
    assert trace.final_mode[-1] == "back"


GATE = """
regions:
  gate:
    initial: shut
    variables: {lift: 0}
    states: {shut: {}, opening: {flows: {lift: 0.5}}, open: {}}
    transitions:
      - {name: waited, from: shut, to: opening, after: 0.2}
      - {name: up, from: opening, to: open, guard: lift >= 0.1}
"""


def test_a_gate_lifts_the_bodies_on_it_and_clocks_go_on():
    scene = text(
        GATE, surfaces=", plate: {edge: [[-1, 0.0], [0.8, 0.0]], displacement: [0, lift]}",
        names=", plate", time=0.6,
    )  # fmt: skip
    scene += "outputs: {up: {value: lift, at: first gate.open}}\n"
    result = run(scene)
    trace = result.trace
    # Both fall on ends of steps.
    assert result.outputs["up"] == pytest.approx(0.1, abs=1e-12)
    changes = [(jump.cause, jump.t) for jump in trace.jumps if jump.region == "gate"]
    assert [cause for cause, _ in changes] == ["waited", "up"]
    assert [t for _, t in changes] == pytest.approx([0.2, 0.4], abs=1e-12)
    # It stops with the plate, or is thrown a little and lands on it.
    assert trace.final[1] == pytest.approx(0.2, abs=1e-3)
    lift = result.observer.sample(trace, ["lift"], times=np.array([0.1, 0.3, 0.5])).columns["lift"]
    assert lift == pytest.approx([0.0, 0.05, 0.1], abs=1e-12)


def test_timeouts_that_end_with_steps_add_up():
    # Each was a step late, all of them 199 steps.
    text = """
kind: scene
name: pulses
gravity: 0
bodies: {b: {copies: 2, mass: 1, inertia: 1, shape: {disc: 0.1}, start: {y: 3*index}}}
collisions: {all: {bodies: [b], friction: 0, restitution: 0}}
controls: {push: 0}
forces: {push: {body: b0, force: [push, 0]}}
regions:
  hand:
    initial: waits
    states: {waits: {}, pushes: {sets: {push: 3}}}
    transitions:
      - {name: begins, from: waits, to: pushes, after: 0.1}
      - {name: ends, from: pushes, to: waits, after: 0.2}
stop: {time: 30}
outputs: {times: {value: time, at: each hand.pushes}}
settings: {engine: impulse, step: 0.01}
"""
    result = Runner(interpret(read_text(text))).run()
    assert result.outputs["times"] == pytest.approx(0.1 + 0.3 * np.arange(100), abs=1e-9)
    assert result.trace.final[6] == pytest.approx(0.6 * 100, abs=1e-9)


def test_flows_that_depend_on_how_bodies_move_are_refused():
    more = GATE.replace("lift: 0.5", "lift: box.dx")
    with pytest.raises(DeclarationError, match=r"the flow of 'lift' depends on 'box\.dx'"):
        interpret(read_text(text(more)))


def test_paths_of_surfaces_use_no_controls_that_jump():
    more = BANG
    surfaces = ", plate: {edge: [[-1, 0.0], [0.8, 0.0]], displacement: [0, push]}"
    with pytest.raises(DeclarationError, match="'push': a control jumps"):
        interpret(read_text(text(more, surfaces=surfaces, names=", plate")))


@pytest.mark.parametrize(("condition", "end"), [("n >= 3", 0.3), ("3 <= n", 0.3), ("n > 3", 0.4)])
def test_a_count_ends_a_run_by_steps_as_its_relation_is_written(condition: str, end: float) -> None:
    more = """
regions:
  counter:
    initial: on
    variables: {n: 0}
    states: {on: {}}
    transitions: [{name: tick, from: on, every: 0.1, updates: {n: n + 1}}]
"""
    stopping = text(more).replace(
        "{time: 1.0}", f"{{time: 1.0, conditions: {{enough: {condition}}}}}"
    )
    trace = Runner(interpret(read_text(stopping))).run().trace
    assert trace.outcome is Outcome.STOPPED
    # Controllers act at the end of a step, here of the one behind 0.3, and conditions are seen
    # at the end of the next.
    assert trace.t_end == pytest.approx(end, abs=2.5e-3)


@pytest.mark.parametrize("mass", [1.0, 1e-6, 1e-12])
def test_a_guard_on_the_force_of_a_joint_is_met_whatever_the_masses(mass):
    """With forces scaled by a newton, all forces of a nanogram were round-off."""
    runner = Runner(
        interpret(
            read_text(
                """
kind: scene
name: swing
parameters: {m: 1}
gravity: 9.81
bodies:
  disc: {mass: m, inertia: m*0.005, shape: {disc: 0.1}, start: {x: 0.5, y: 0}}
joints: {hinge: {point: {body: disc, at: [-0.5, 0]}, to: [0, 0]}}
surfaces: {ground: {height: -5}}
collisions: {all: {bodies: [disc], surfaces: [ground], friction: 0.5, restitution: 0}}
regions:
  load:
    initial: low
    states: {low: {}, high: {}}
    transitions: [{name: rises, from: low, to: high, guard: "hinge.Y > 1.5*m*9.81"}]
stop: {time: 0.8}
outputs: {risen: {value: time, at: first load.rises}}
settings: {engine: impulse, step: 1e-3}
"""
            )
        )
    )
    arm = 0.5**2 / (0.5**2 + 0.005)

    # The pivot lifts with (1 - arm + 3 arm sin(t)^2) times the weight.
    def lifts(_, y):
        return 1.0 - arm + 3.0 * arm * math.sin(y[0]) ** 2 - 1.5

    lifts.terminal = True
    swing = solve_ivp(
        lambda _, y: [y[1], 9.81 / 0.5 * arm * math.cos(y[0])],
        (0.0, 0.8),
        [0.0, 0.0],
        events=lifts,
        rtol=1e-10,
    )
    assert runner.run({"m": mass}).outputs["risen"] == pytest.approx(swing.t[-1], abs=1e-3)


def test_a_controller_switches_a_led_body_at_the_start():
    model = interpret(
        read_text("""
kind: scene
name: press
gravity: 9.81
bodies:
  box: {mass: 1, inertia: 0.002, shape: {disc: 0.05}, start: {y: 0.05}}
  press: {position: [1 + s, 0.05], shape: {disc: 0.05}}
surfaces: {floor: {height: 0}}
collisions: {all: {bodies: [box, press], surfaces: [floor], friction: 0.3, restitution: 0}}
regions:
  ctl:
    initial: rest
    variables: {s: 0}
    states: {rest: {}, moves: {flows: {s: -1}}}
    transitions: [{name: go, from: rest, to: moves, guard: box.y <= 1}]
stop: {time: 0.5}
settings: {engine: impulse, step: 1e-3}
""")
    )
    result = Runner(model).run()
    assert ("go", 0.0) in [(jump.cause, jump.t) for jump in result.trace.jumps]
    assert result.trace.final[-1] == pytest.approx(-0.5)
