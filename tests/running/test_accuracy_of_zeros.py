"""Accuracies of quantities that are zero, or nearly: each is judged on the scale of its kind."""

from __future__ import annotations

import random

import pytest

from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result
from statechart.running.runner import Runner

CAM = """\
kind: scene
name: cam
units: SI
parameters: {R: 0.03, r: 0.008, e: 0.01, rpm: 900, w: rpm*2*pi/60, m: 0.25, k: 2000, F0: 30,
  y0: "sqrt((R+r)**2 - e**2)"}
gravity: 9.81
coordinates: {y: {start: y0, rate: e*w}}
bodies: {follower: {mass: m, position: [0, y], shape: {disc: r}}}
surfaces: {cam: {circle: [0, 0], radius: R, displacement: [e*cos(w*time), e*sin(w*time)]}}
contacts:
  roller: {point: {body: follower}, radius: r, surface: cam, friction: 0, restitution: 0.3,
    modes: [free, slide]}
forces: {spring: {body: follower, force: [0, -F0 - k*(y - y0)]}}
stop: {time: 0.5}
outputs:
  lift: {maximum: y}
  least: {minimum: roller.V}
  floats: {count: roller.liftoff}
  blows: {count: roller.touchdown}
  first_float: {value: time, at: first roller.liftoff}
"""
SHAKEN = """\
kind: scene
name: shaken
parameters: {a: 0.01, w: 40, g: 9.81, m: 1}
gravity: g
coordinates: {y: {start: 0, rate: a*w}}
bodies: {b: {mass: m, position: [0, y]}}
surfaces: {s: {height: 0, displacement: [0, a*sin(w*time)]}}
contacts: {c: {point: {body: b}, surface: s, friction: 0, restitution: 0, modes: [free, slide]}}
stop: {time: 0.5}
outputs:
  least: {minimum: c.V}
  gap: {minimum: c.gap}
  weights: {minimum: c.V/(m*g)}
  impulse: {integral: "min(c.V, 0)"}
  speed: {minimum: "abs(dy - a*w*cos(w*time))"}
  moment: {minimum: a*c.V}
  energy: {minimum: "abs(m*(dy - a*w*cos(w*time))**2/2)"}
"""
TOPPLING = """\
kind: scene
name: toppling
parameters: {L: 0.5, th: 0.1, mu: 0.4, m: 1}
gravity: 9.81
bodies: {b: {mass: m, inertia: m*L**2/3, start: {x: L*sin(th), y: L*cos(th), angle: -th}}}
surfaces: {g: {height: 0}}
contacts:
  tip: {point: {body: b, at: [0, -L]}, surface: g, friction: mu, restitution: 0}
stop: {time: 10, conditions: {fallen: b.angle <= -pi/2}}
outputs:
  cone: {minimum: mu*tip.V - abs(tip.H)}
  gap: {minimum: tip.gap}
  work: {integral: tip.gap*tip.V}
"""


def reached(result: Result) -> bool:
    assert result.asked is not None
    return result.asked.reached(result.error_estimate)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("seed", range(3))
def test_quantities_that_fall_to_zero_reach_the_requested_accuracy(engine: str, seed: int) -> None:
    rng = random.Random(seed)
    mass = 10.0 ** rng.uniform(-2, 3)
    drawn = {
        CAM: {"rpm": 1400.0 + 100.0 * seed},
        SHAKEN: {"a": rng.uniform(0.008, 0.03), "m": mass},
        TOPPLING: {"th": rng.uniform(0.05, 0.4), "mu": rng.uniform(0.1, 1.2), "m": mass},
    }
    for text, parameters in drawn.items():
        runner = Runner(read_text(text), engine=engine, accuracy=1e-8)
        result = runner.run(parameters)
        assert reached(result), result.warnings
        for name in {CAM: ("least",), SHAKEN: ("gap", "speed"), TOPPLING: ("gap",)}[text]:
            assert abs(result.outputs[name]) <= 1e-8, name


def test_the_quantity_that_decides_is_named_with_both_values(
    capsys: pytest.CaptureFixture[str], tmp_path: pytest.TempPathFactory
) -> None:
    path = f"{tmp_path}/shaken.yaml"
    with open(path, "w") as stream:
        stream.write(SHAKEN.replace("minimum: c.gap", "value: sin(1e16*dy)"))
    assert main(["run", path, "--accuracy", "1e-6"]) == 1
    said = capsys.readouterr()
    assert "the estimated error is" in said.err
    assert ", in output gap (" in said.err
    assert said.err.count("output gap (") == 1
    assert "estimated relative error" in said.out
    assert ", in output gap (" in said.out


def test_the_report_names_the_quantity_that_decides() -> None:
    for options in ({"accuracy": 1e-6}, {"budget": 20.0}):
        asked = Runner(read_text(TOPPLING), **options).run().to_dict()["asked"]
        what, _, values = asked["decides"].partition(" (")
        assert what.startswith(("output ", "the time of ", "the final ", "the end"))
        one, differ, other = values.removesuffix(")").partition(" and ")
        if not differ:
            one, _, difference = one.partition(", difference ")
            other = str(float(one) + float(difference))
        assert float(one) == pytest.approx(float(other), rel=1e-6, abs=1e-9)
