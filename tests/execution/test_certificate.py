"""Certificates: bounds of every step, and the estimate of the global error."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from runs import EVENT_BASED, shipped

from statechart import DeclarationError, Runner, run
from statechart.charts.laws import automaton
from statechart.documents.yaml_reader import read_text
from statechart.engines.taylor import Taylor
from statechart.execution import flow
from statechart.execution.certificate import Certificate
from statechart.execution.simulator import Simulator
from statechart.kernels.tapes import tape_values
from statechart.loading.load import interpret
from statechart.observation.difference import compare

METHODS = [
    {"engine": "taylor", "tolerance": 1e-8},
    {"engine": "scipy", "method": "DOP853", "tolerance": 1e-8},
    {"engine": "scipy", "method": "LSODA", "tolerance": 1e-7},
    {"engine": "scipy", "method": "RK45", "tolerance": 1e-6},
]
THRUST = """\
kind: scene
name: thrust
gravity: 9.81
bodies: {b: {mass: 1, start: {y: 100, dx: 3}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.3, restitution: 0.5}}
forces: {burn: {body: b, force: [0, "10*(1+tanh((time-2)/0.1))/2"]}}
stop: {time: 4}
outputs: {vy: {value: b.dy}}
"""


def off(reference, trace):
    found = compare(reference, trace, {}, {}, brief=1e-6)
    return None if found.diverged is not None else max(found.state, found.times)


@pytest.mark.parametrize("name", EVENT_BASED)
def test_the_motion_of_shipped_models_is_proved(name):
    plain = shipped(name).trace
    trace = run(name, engine="auto", certify=True, throw=False).trace
    assert plain.certified == "guards"
    assert plain.motion is None
    assert trace.certified is True
    assert trace.motion.local < 1e-11
    assert trace.motion.whole < 1e-9
    assert trace.evidence["motion"] == str(trace.motion)
    # To prove it changes nothing.
    assert np.array_equal(trace.final, plain.final)
    assert [jump.t for jump in trace.jumps] == [jump.t for jump in plain.jumps]


@functools.cache
def reference_trace(name):
    return run(name, engine="taylor", throw=False).trace


@pytest.mark.parametrize("choice", METHODS, ids=lambda c: c.get("method", "taylor"))
@pytest.mark.parametrize(
    "name",
    ["toppling_stick", "newtons_cradle", "simplest_walker", "stick_slip_block",
     "sliding_ladder", "bouncing_ball"],
)  # fmt: skip
def test_global_estimate_equals_the_error(name, choice):
    assert_estimate_equals_error(name, choice)


@pytest.mark.parametrize("choice", METHODS[:2], ids=lambda c: c.get("method", "taylor"))
@pytest.mark.parametrize("name", ["hopper", "compass_walker", "woodpecker"])
def test_global_estimate_of_many_events_equals_the_error(name, choice):
    assert_estimate_equals_error(name, choice)


def assert_estimate_equals_error(name, choice):
    reference = reference_trace(name)
    trace = run(name, **choice, certify=True, throw=False).trace
    error = off(reference, trace)
    assert error is not None
    assert error / 4.0 <= trace.motion.whole <= 20.0 * max(error, trace.tolerance)
    assert trace.certified is True


def test_step_bound_holds_for_a_known_pendulum():
    # x' = v, v' = -x: after a turn all is as it was.
    text = """\
kind: chart
name: swing
variables: {x: 1, v: 0}
regions: {r: {initial: s, states: {s: {flows: {x: v, v: -x}}}}}
stop: {time: 2*pi}
"""
    for choice in METHODS:
        trace = run(read_text(text), **choice, certify=True).trace
        error = float(np.abs(trace.final - trace.initial).max())
        steps = sum(len(arc.coefficients) for arc in trace.arcs)
        # The bound is of every step, relative to the largest value of a variable.
        assert error <= 2.0 * steps * trace.motion.local
        assert error / 2.0 <= trace.motion.whole <= 20.0 * max(error, trace.tolerance)


@pytest.mark.parametrize("choice", [{}, *METHODS], ids=lambda c: c.get("method", "taylor"))
def test_a_step_over_a_narrow_feature_is_not_certified(choice, monkeypatch):
    right = run(read_text(THRUST), **choice, certify=True)
    assert right.trace.certified is True
    assert right.outputs["vy"] == pytest.approx(-19.24, abs=1e-3)
    # Were steps not held against the rates, the proof would fail, whatever was missed.
    monkeypatch.setattr(flow.Advance, "_find_missed", lambda *_: None)
    blind = run(read_text(THRUST), **choice, certify=True)
    missed = abs(blind.outputs["vy"] - right.outputs["vy"])
    assert blind.trace.motion.whole * 39.24 >= 0.5 * missed
    if missed > 1e-3:
        assert blind.trace.certified == "guards"
        assert "not proved" in blind.trace.evidence["motion"]


def test_a_run_to_an_accuracy_is_certified_once(monkeypatch):
    result = Runner("toppling_stick", engine="scipy", accuracy=1e-6).run(certify=True)
    assert result.trace.certified is True
    assert result.trace.motion.whole <= result.error_estimate * 10.0 < 1e-5


def test_certificate_compiles_tape_kernel_for_one_signature_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tape_values, "_hot", True)
    run("rimless_wheel", engine="scipy", method="RK45", tolerance=1e-6, certify=True)
    assert len(tape_values.compiled.signatures) == 1


def test_a_run_without_steps_is_proved() -> None:
    trace = run("toppling_stick", until=0, certify=True).trace
    assert trace.certified is True
    assert trace.evidence["motion"] == "the run has no steps"


def test_time_steps_cannot_be_certified():
    with pytest.raises(DeclarationError, match="impulse cannot certify"):
        run("toppling_stick", engine="impulse", step=1e-3, certify=True)


def test_estimate_grows_with_sensitivity():
    # A stick that is balanced falls the later the less it leans, and errors grow as it does, until
    # it slips: from there on the delay, a tolerance of forces, is larger.
    wholes = [
        run("toppling_stick", parameters={"theta0": lean}, until=until, certify=True)
        .trace.motion.whole
        for lean, until in ((0.1, 1.1), (1e-3, 6.4), (1e-6, 14.4))
    ]  # fmt: skip
    assert wholes == sorted(wholes)
    assert math.isfinite(wholes[-1])


_LOW = """
kind: chart
name: low
parameters: {s: 1e-2}
variables: {x: 1, v: 0, n: 0}
regions:
  it:
    initial: high
    states: {high: {flows: {x: v, v: -9}}, low: {flows: {x: v, v: -9}}, end: {}}
    transitions:
      - {name: hit, from: high, to: low, guard: x <= 0, updates: {v: s}}
      - {name: bounce, from: low, to: low, guard: x <= 0, updates: {v: -0.9*v, n: n + 1}}
      - {name: done, from: low, to: end, guard: n >= 10}
stop: {time: 1}
outputs: {ends: {value: time, at: last bounce}}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("s", [1e-2, 1e-9, 1e-10])
def test_impacts_as_slow_as_rounding_leave_no_estimate(engine: str, s: float) -> None:
    # A height off by the error of the first fall (1e-16) makes the next speed sqrt(2 g 1e-16),
    # 4e-8: more than such bounces have, but where the fall ends at the height 0 to the last bit.
    result = Runner(read_text(_LOW), engine=engine).run({"s": s}, certify=True)
    motion = result.trace.motion
    ends = math.sqrt(2.0 / 9.0) + 2.0 * s / 9.0 * math.fsum(0.9**k for k in range(10))
    if s == 1e-2 or motion.whole < math.inf:
        assert abs(result.outputs["ends"] - ends) < 10.0 * motion.whole < 1e-10
    else:
        assert "the whole run by an unknown amount" in str(motion)


_SWING = """
kind: chart
name: swing
variables: {x: 1, v: 0}
stop: {time: 10}
regions:
  r: {initial: s, states: {s: {flows: {x: v, v: -x}}}}
"""
_LOWEST = (
    _SWING
    + """
  e:
    initial: w
    states: {w: {}, d: {}}
    transitions: [{name: low, from: w, to: d, guard: x <= -0.999999}]
"""
)


@pytest.mark.parametrize("until", [10, 100, 1000])
def test_round_off_of_steps_is_part_of_the_global_error(until: float) -> None:
    # Each step has only a bound; the sum of bounds is at least one of them.
    motion = run(read_text(_SWING), engine="taylor", until=until, certify=True).trace.motion
    assert motion.local <= motion.whole <= 100.0 * motion.local


def test_round_off_delays_an_event_by_its_inverse_slope() -> None:
    trace = run(read_text(_LOWEST), engine="taylor", until=4, certify=True).trace
    (jump,) = trace.jumps
    slope = math.sqrt(1.0 - 0.999999**2)
    late = trace.motion.local / slope / 4.0
    assert jump.t == pytest.approx(math.pi - math.asin(slope), abs=4.0 * trace.motion.whole)
    assert 0.5 * late <= trace.motion.whole <= 10.0 * late


@pytest.mark.parametrize(("part", "proved"), [(6.0, True), (9.0, False), (50.0, False)])
def test_a_step_is_proved_up_to_sixteen_times_the_allowed_defect(part: float, proved: bool) -> None:
    # x' = 0, and a step whose defect integral is a multiple of the allowed error. The enclosure
    # bounds it by a little more than twice its value.
    chart = interpret(read_text(_SWING.replace("{x: v, v: -x}", "{x: 0}")))
    simulator = Simulator(automaton(chart), Taylor(2.2e-16))
    trace = simulator.run(until=1.0)
    setup = simulator.automaton.setup({}, trace.tolerance)
    certificate = Certificate(trace, setup, simulator.automaton.laws_of_events, simulator.engine)
    (arc,) = trace.arcs
    coefficients = np.zeros((1, 2, 2))
    coefficients[0, :, 0] = trace.initial
    coefficients[0, 0, 1] = part * simulator.engine.allowed
    certificate.flow(
        replace(arc, coefficients=coefficients), simulator.modes.compiled(arc.roles, trace.zeros)
    )
    motion = certificate.motion()
    assert part <= motion.local / simulator.engine.allowed <= 2.2 * part
    assert motion.proved is proved


def test_an_event_at_which_the_guard_stands_still_leaves_no_estimate() -> None:
    # x - b = (1 - t)^2 until 1: an error of 1e-12 delays the event by 1e-6.
    model = interpret(
        read_text(
            """\
kind: chart
name: tank
parameters: {b: 1}
variables: {x: 2}
regions:
  r:
    initial: full
    states: {full: {flows: {x: "-2*sqrt(max(x - b, 0))"}}, empty: {}}
    transitions: [{name: empties, from: full, to: empty, guard: x <= b}]
stop: {time: 2}
outputs: {t: {value: time, at: first r.empties}}
"""
        )
    )
    result = run(model, certify=True)
    assert result.outputs["t"] == pytest.approx(1.0, abs=1e-4)
    assert result.trace.motion is not None
    assert result.trace.motion.whole == math.inf
