"""Linkages that start, or are started, at rest in a dead point: friction cannot hold them there."""

from __future__ import annotations

import math

import pytest

import statechart
from statechart.documents.yaml_reader import read_text

YOKE = """
kind: scene
name: yoke
doc: A crank at its dead centre drives a block on a floor through a yoke.
parameters: {T: 2, mu: 0.05, q0: 0, on: 0}
gravity: 9.81
coordinates: {q: {start: q0}, y: {}}
bodies:
  crank: {mass: 1, inertia: 1, position: [0, 0], angle: q}
  block: {mass: 2, position: [cos(q), y]}
surfaces: {floor: {height: 0}}
contacts: {foot: {point: {body: block}, surface: floor, friction: mu, restitution: 0}}
controls: {M: 0}
forces: {motor: {body: crank, moment: M}}
regions:
  motor:
    initial: rests
    states: {rests: {}, drives: {sets: {M: T}}}
    transitions: [{name: go, from: rests, to: drives, guard: time >= on}]
stop: {time: on + 1}
outputs:
  surplus: {value: energy - T*(q - q0) + mu*2*9.81*(1 - abs(block.x))}
  way: {value: abs(q - q0)}
  held: {integral: 1, during: {foot: pin}}
"""
CRANK = """
kind: scene
name: crank
doc: A crank at its dead centre drives a piston in a guide with friction.
parameters: {T: 2, L: 3}
bodies:
  crank: {mass: 1, inertia: 0.1, start: {x: 0.25}}
  rod: {mass: 1, inertia: 0.1, start: {x: 1}}
  piston: {mass: 2, start: {x: 1.5}}
joints:
  shaft: {point: {body: crank, at: [-0.25, 0]}, to: [0, 0]}
  pin: {point: {body: rod, at: [-0.5, 0]}, to: {body: crank, at: [0.25, 0]}}
  end: {point: {body: piston}, to: {body: rod, at: [0.5, 0]}}
  guide: {point: {body: piston}, to: {y: 0}}
forces: {motor: {body: crank, moment: T}}
couplings: {wall: {joint: guide, limit: L}}
stop: {time: 3, conditions: {turned: abs(crank.angle) >= 2}}
outputs:
  surplus: {value: energy - T*crank.angle + L*(1.5 - piston.x)}
  turned: {value: crank.angle}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("torque", [2, -2])
@pytest.mark.parametrize(("start", "on"), [(0, 0), (math.pi, 0), (0, 0.5), (math.pi, 0.5)])
def test_friction_does_not_hold_a_yoke_at_its_dead_centre(
    engine: str, torque: float, start: float, on: float
) -> None:
    parameters = {"T": torque, "q0": start, "on": on}
    result = statechart.run(
        read_text(YOKE, "y.yaml"), parameters=parameters, engine=engine, throw=False
    )
    assert result.trace.outcome.name == "HORIZON", result.trace.message
    assert result.outputs["surplus"] == pytest.approx(0.0, abs=1e-9)
    assert 0.5 < result.outputs["way"] < 1.5  # Before the block turns round
    assert result.outputs["held"] == pytest.approx(on, abs=1e-9)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("torque", [1e-3, 1e-4, -1e-5])
@pytest.mark.parametrize("start", [0, math.pi, 2 * math.pi])
def test_friction_stops_a_yoke_that_a_small_couple_turns(
    engine: str, torque: float, start: float
) -> None:
    # I q'' = T - mu m g q: at t = pi/w friction holds the block.
    text = YOKE.replace("stop: {time: on + 1}", "stop: {time: 4}")
    result = statechart.run(
        read_text(text, "y.yaml"), parameters={"T": torque, "q0": start}, engine=engine
    )
    stiffness = 0.05 * 2 * 9.81
    assert result.trace.jumps[-1].t == pytest.approx(math.pi / math.sqrt(stiffness), rel=1e-5)
    assert result.outputs["way"] == pytest.approx(2 * abs(torque) / stiffness, rel=1e-5)


def test_a_yoke_off_its_dead_centre_is_held() -> None:
    result = statechart.run(read_text(YOKE, "y.yaml"), parameters={"q0": 0.4, "mu": 0.6})
    assert result.outputs["held"] == pytest.approx(1.0)


@pytest.mark.parametrize("torque", [2, -2])
def test_a_crank_leaves_its_dead_centre_against_friction_in_a_guide(torque: float) -> None:
    result = statechart.run(read_text(CRANK, "c.yaml"), parameters={"T": torque}, throw=False)
    assert result.trace.outcome.name == "STOPPED", result.trace.message
    assert result.outputs["turned"] == pytest.approx(math.copysign(2.0, torque))
    assert result.outputs["surplus"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_a_coordinate_at_a_dead_point_has_the_scale_of_the_body_it_turns(engine: str) -> None:
    text = YOKE.replace(
        "stop: {time: on + 1}", "stop: {time: 4, conditions: {turned: q >= q0 + 0.5}}"
    )
    result = statechart.run(read_text(text, "y.yaml"), parameters={"q0": math.pi}, engine=engine)
    assert result.outputs["way"] == pytest.approx(0.5, rel=1e-11)


ROCKER = """
kind: scene
name: rocker
doc: A motor starts a crank at the dead centre of the rocker that a brake holds.
parameters: {q0: 0, side: 1}
gravity: 0
coordinates: {q: {start: q0}}
bodies:
  crank: {mass: 1, inertia: 1, position: [0, 0], angle: q}
  rocker: {mass: 1, inertia: 1, position: [3, 0], angle: side*cos(q)}
couplings: {brake: {bodies: [rocker], limit: 2}}
controls: {M: 0}
forces: {motor: {body: crank, moment: M}}
regions:
  motor:
    initial: rests
    states: {rests: {}, drives: {sets: {M: 1}}}
    transitions: [{name: go, from: rests, to: drives, guard: time >= 5}]
stop: {time: 6}
outputs:
  waits: {value: abs(q - q0), at: first go}
  way: {value: q - q0}
  surplus: {value: energy - (q - q0) + 2*(1 - abs(cos(q)))}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("start", [0, math.pi, 2 * math.pi])
def test_a_crank_waits_at_the_dead_centre_of_a_braked_rocker(
    engine: str, side: float, start: float
) -> None:
    parameters = {"q0": start, "side": side}
    result = statechart.run(read_text(ROCKER, "r.yaml"), parameters=parameters, engine=engine)
    assert result.outputs["waits"] <= 1e-12
    assert 0.1 < result.outputs["way"] < 1.0
    assert result.outputs["surplus"] == pytest.approx(0.0, abs=1e-9)
