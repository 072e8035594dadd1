"""Summed bounces: outputs and guards do not see their mean force before they end."""

from __future__ import annotations

import functools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from runs import ENGINES, engine
from scenes import run, scene, times
from strategies import examples

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.execution.simulator import Simulator
from statechart.observation.observer import Observer
from statechart.observation.outputs import Outputs
from statechart.running.runner import Runner

both = pytest.mark.parametrize("name", ENGINES)

# A ball dropped on a floor at any height; a controller that feels its weight there.
DROP = """\
kind: scene
name: drop
parameters: {h: 1, base: 0, e: 0.3, g: 9.81, part: 0.5, mu: 0, v: 0}
gravity: g
bodies: {ball: {mass: 2, start: {y: base + h, dx: v}}}
surfaces: {floor: {height: base}}
contacts:
  skin: {point: {body: ball}, surface: floor, friction: mu, restitution: e}
regions:
  scale:
    initial: light
    states: {light: {}, heavy: {}, loose: {}}
    transitions:
      - {name: feel, from: light, to: heavy, guard: skin.V > part*2*g}
  rub:
    initial: no
    states: {no: {}, yes: {}}
    transitions: [{name: drag, from: no, to: yes, guard: abs(skin.H) > 0.9*mu*part*2*g}]
outputs:
  weight: {integral: skin.V}
  felt: {value: skin.V, at: first scale.feel}
  before: {value: skin.V, at: first skin.zeno, before: true}
  after: {value: skin.V, at: first skin.zeno}
"""
STOPPED = DROP.replace("outputs:", "stop: {conditions: {heavy: skin.V > part*2*g}}\noutputs:")


@functools.cache
def drop(name: str, text: str = DROP) -> Simulator:
    return Simulator(scene(text), engine(name))


def rest(h: float, g: float, e: float) -> float:
    return math.sqrt(2.0 * h / g) * (1.0 + e) / (1.0 - e)


@examples(20)
@given(
    st.floats(0.1, 3.0),
    st.sampled_from([0.0, 1.0, -30.0, 1000.0]),
    st.floats(0.05, 0.8),
    st.floats(1.0, 20.0),
    st.floats(0.05, 0.95),
    st.sampled_from([0.0, 0.3]),
)
def test_weight_acts_after_the_bounces_at_any_origin(
    h: float, base: float, e: float, g: float, part: float, mu: float
) -> None:
    end = rest(h, g, e)
    # Still fast when the bounces end: friction has taken mu times the impulse of the weight.
    speed = 3.0 * mu * g * end
    given_ = {"h": h, "base": base, "e": e, "g": g, "part": part, "mu": mu, "v": speed}
    for name in ENGINES:
        simulator = drop(name)
        trace = simulator.run(given_, until=1.5 * end)
        (zeno,) = [jump for jump in trace.jumps if jump.cause == "zeno"]
        felt = [jump for jump in trace.jumps if jump.region in ("scale", "rub")]
        assert [jump.cause for jump in felt] == ["feel", "drag"][: 1 + (mu > 0.0)], name
        assert {jump.t for jump in felt} == {zeno.t}
        # Bounces hidden by round-off of the height, by the third power of the omitted speed.
        assert zeno.t == pytest.approx(end, rel=1e-9)
        found = Outputs(Observer(simulator)).of(trace)
        assert found["before"] == 0.0
        assert found["after"] == found["felt"] == pytest.approx(2.0 * g, rel=1e-12)
        assert found["weight"] == pytest.approx(2.0 * g * (trace.t_end - zeno.t), rel=1e-9)
        assert trace.certified


@both
@pytest.mark.parametrize("base", [0.0, 1.0, 1000.0])
def test_a_stop_on_a_force_waits_for_the_end_of_the_bounces(name: str, base: float) -> None:
    trace = drop(name, STOPPED).run({"base": base}, until=5.0)
    assert trace.outcome is Outcome.STOPPED
    assert trace.t_end == pytest.approx(rest(1.0, 9.81, 0.3), rel=1e-11)
    assert [jump.cause for jump in trace.jumps][-3:] == ["zeno", "feel", "stop"]


ROCK = """\
kind: scene
name: rock
gravity: 9.81
parameters: {b: 0.2, h: 0.3, lean: 0.1}
bodies:
  block:
    mass: 1
    inertia: (b**2 + h**2)/3
    start: {x: 0, y: b*sin(lean) + h*cos(lean), angle: -lean}
surfaces: {ground: {height: 0}}
contacts:
  left: {point: {body: block, at: [-b, -h]}, surface: ground, friction: inf, restitution: 0}
  right: {point: {body: block, at: [b, -h]}, surface: ground, friction: inf, restitution: 0}
regions:
  scale:
    initial: one
    states: {one: {}, both: {}}
    transitions: [{name: stand, from: one, to: both, guard: left.V*right.V > 1}]
"""


@both
def test_rattling_feet_share_load_after_coming_to_rest(name: str) -> None:
    trace = run(scene(ROCK), name, 3.0)
    (zeno,) = times(trace, "zeno")
    assert times(trace, "stand") == [zeno]
    assert sum(jump.cause == "touchdown" for jump in trace.jumps) > 10


@both
@pytest.mark.parametrize(("e", "count"), [(0.5, 24), (0.8, 70)])
@pytest.mark.parametrize("base", [0.0, 0.1, 5.0, 1e3])
def test_the_number_of_resolved_bounces_does_not_depend_on_the_origin(
    name: str, base: float, e: float, count: int
) -> None:
    values = {"base": 0.0, "e": e, "mu": 0.1, "v": 0.3, "h": 0.25, "part": 99.0}
    trace = drop(name).run({**values, "base": base}, until=4.0)
    found = [jump.t for jump in trace.jumps if jump.cause == "touchdown"]
    (rests,) = (jump.t for jump in trace.jumps if jump.cause == "zeno")
    if name == "taylor":
        assert len(found) == count - 1
        expected = math.sqrt(2.0 * 0.25 / 9.81) * (1.0 + e) / (1.0 - e)
        assert rests == pytest.approx(expected, abs=1e-12 + 4e-16 * base)
    else:
        alone = drop(name).run(values, until=4.0)
        others = [jump.t for jump in alone.jumps if jump.cause == "touchdown"]
        assert len(found) == len(others)


def _rest_with_drag(e: float, k: float, g: float = 9.81) -> float:
    """Return when a ball from height 1 rests under the drag -k v |v| per mass.

    It falls from h with v^2 = g/k (1 - exp(-2 k h)) in acosh(exp(k h))/sqrt(g k), and rises from v
    to log(1 + k v^2/g)/(2 k) in atan(v sqrt(k/g))/sqrt(g k).
    """
    t, height, root = 0.0, 1.0, math.sqrt(g * k)
    while height > 1e-32:
        # acosh(exp(x)) with cosh(y) - 1 = 2 sinh(y/2)^2, which is exact for small x.
        t += 2.0 * math.asinh(math.sqrt(0.5 * math.expm1(k * height))) / root
        v = e * math.sqrt(-math.expm1(-2.0 * k * height) * g / k)
        t += math.atan(v * math.sqrt(k / g)) / root
        height = math.log1p(k * v * v / g) / (2.0 * k)
    return t


@pytest.mark.parametrize("tolerance", [1e-9, 1e-12, 2.2e-16])
@pytest.mark.parametrize(("e", "k"), [(0.5, 0.2), (0.7, 0.1), (0.2, 0.2)])
@pytest.mark.parametrize("name", ENGINES)
def test_the_top_of_a_low_flight_where_drag_switches_is_no_contact(
    name: str, e: float, k: float, tolerance: float
) -> None:
    # The ball rested at the top of its first flight below the tolerance of gaps: 2e-4 s early.
    text = """\
kind: scene
name: dragged
gravity: 9.81
parameters: {e: 0.5, k: 0.2}
bodies: {ball: {mass: 1, start: {y: 1}}}
surfaces: {floor: {height: 0}}
contacts: {skin: {point: {body: ball}, surface: floor, friction: 0, restitution: e}}
forces: {drag: {body: ball, force: [0, -k*ball.dy*abs(ball.dy)]}}
stop: {time: 4}
"""
    trace = Runner(read_text(text), engine=name, tolerance=tolerance).run({"e": e, "k": k}).trace
    assert trace.jumps[-1].cause == "zeno"
    assert trace.jumps[-1].t == pytest.approx(_rest_with_drag(e, k), abs=max(10 * tolerance, 1e-13))
