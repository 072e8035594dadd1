"""Flows with abs, sign, min, max and sat: pieces, slides and their ends against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes import compose, go, region, times

from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Outcome, Trace
from statechart.engines.engine import Engine
from statechart.engines.scipy import SciPy
from statechart.engines.taylor import Taylor
from statechart.execution import livelock
from statechart.execution.simulator import Simulator

TAYLOR, SCIPY = Taylor(2.2e-16), SciPy(1e-12)
both = pytest.mark.parametrize("engine", [TAYLOR, SCIPY], ids=["taylor", "scipy"])


def run(chart: Automaton, engine: Engine, until: float, **parameters: float) -> Trace:
    return Simulator(chart, engine).run(parameters, until=until)


def flow(start: dict[str, object], **rates: str) -> Automaton:
    return compose(start, {"r": region({"s": rates})})


def breaks(trace: Trace) -> list[float]:
    return [arc.start.high for arc in trace.arcs[1:]]


@both
def test_a_mass_drawn_to_the_middle_by_a_constant_force_has_its_period(engine: Engine) -> None:
    trace = run(flow({"x": 1, "v": 0}, x="v", v="-sign(x)"), engine, 8.0 * math.sqrt(2.0))
    expected = math.sqrt(2.0) * np.array([1, 3, 5, 7])
    tolerance = 1e-13 if engine is TAYLOR else 1e-10
    assert breaks(trace) == pytest.approx(expected, abs=tolerance)
    assert trace.final == pytest.approx([1.0, 0.0], abs=1e-12 if engine is TAYLOR else 1e-10)
    assert trace.certified
    assert not trace.jumps


@both
def test_a_relay_slides_with_the_equivalent_control_and_lets_go(engine: Engine) -> None:
    # Half of the way to zero at the rate 1/2; there until the disturbance is as large as 1.
    chart = flow({"x": 1, "u": 0}, x="-sign(x) + time/4", u="-sign(x)")
    trace = run(chart, engine, 6.0)
    first = 4.0 - math.sqrt(8.0)
    assert breaks(trace) == pytest.approx([first, 4.0], abs=1e-11)
    x, u = trace.final
    assert x == pytest.approx(0.5, abs=1e-12)  # (6 - 4)^2 / 8
    assert u == pytest.approx(-first - (16.0 - first**2) / 8.0 - 2.0, abs=1e-11)
    assert any("slides along x = 0" in text for text in trace.warnings)
    assert trace.certified


@both
def test_a_saturated_actuator_is_off_its_limits_in_between(engine: Engine) -> None:
    chart = flow({"x": 3, "v": 0}, x="v", v="sat(-x - v, -1, 1)")
    trace = run(chart, engine, 10.0)
    # x = 3 - t^2/2, v = -t until x + v = 1.
    first = math.sqrt(5.0) - 1.0
    assert breaks(trace)[0] == pytest.approx(first, abs=1e-12)
    x, v = 3.0 - first**2 / 2.0, -first
    w, t = math.sqrt(0.75), 10.0 - first
    c, s, decay = math.cos(w * t), math.sin(w * t), math.exp(-t / 2.0)
    if len(breaks(trace)) == 1:
        assert trace.final[0] == pytest.approx(decay * (x * c + (v + x / 2.0) / w * s), abs=1e-12)
    else:
        pytest.fail("it saturates once")


@both
def test_two_blocks_with_friction_come_to_rest_each_at_its_time(engine: Engine) -> None:
    chart = flow({"v": 2, "w": 1, "x": 0}, v="-sign(v)", w="-2*sign(w)", x="v + w")
    trace = run(chart, engine, 3.0)
    assert breaks(trace) == pytest.approx([0.5, 2.0], abs=1e-12)
    assert trace.final == pytest.approx([0.0, 0.0, 2.25], abs=1e-12)


@both
def test_two_blocks_that_stop_at_one_instant_both_slide(engine: Engine) -> None:
    chart = flow({"v": 1, "w": 2}, v="-sign(v) + sign(w)/4", w="-2*sign(w) + sign(v)/8")
    trace = run(chart, engine, 30.0)
    assert trace.final == pytest.approx([0.0, 0.0], abs=1e-12)
    assert len(breaks(trace)) == 2


@both
@pytest.mark.parametrize("angle", ["atan2(y, x)", "atan2(sin(time), cos(time))"])
def test_angle_in_a_flow_jumps_at_its_branch_cut(angle: str, engine: Engine) -> None:
    chart = flow({"x": 1, "y": 0, "w": 0}, x="-y", y="x", w=angle)
    # The angle is time, from pi on time - 2 pi.
    assert run(chart, engine, 6.0).final[2] == pytest.approx(18.0 - 2.0 * math.pi * (6.0 - math.pi))


@both
def test_flow_slides_along_a_branch_cut_that_attracts(engine: Engine) -> None:
    trace = run(flow({"w": 2}, w="atan2(sin(w), cos(w))"), engine, 6.0)
    assert breaks(trace)[-1] == pytest.approx(math.log(math.pi / 2.0), abs=1e-9)
    assert trace.final == pytest.approx([math.pi], abs=1e-9)


@both
def test_a_sign_of_an_angle_is_named_as_declared(engine: Engine) -> None:
    rate = "0.8*sign(atan2(3 - y, -3 - x) - th)"
    trace = run(flow({"x": 0, "y": 0, "th": -2.5}, x="cos(th)", y="sin(th)", th=rate), engine, 2.0)
    assert "sign of -th + atan2(3 - y, -x - 3)" in trace.evidence
    assert trace.final[2] == pytest.approx(-0.9)


@both
def test_angle_on_the_negative_axis_is_pi(engine: Engine) -> None:
    # y stays zero: the force towards the origin points along +x.
    chart = flow({"x": -2, "y": 0}, x="cos(atan2(-y, -x))", y="sin(atan2(-y, -x))")
    assert run(chart, engine, 1.0).final == pytest.approx([-1.0, 0.0], abs=1e-12)
    away = flow({"x": -2, "y": 0}, x="cos(atan2(y, x))", y="sin(atan2(y, x))")
    assert run(away, engine, 1.0).final == pytest.approx([-3.0, 0.0], abs=1e-12)


@both
def test_grazing_fires_no_event(engine: Engine) -> None:
    trace = run(flow({"x": 1, "y": 0}, x="2*(time - 1)", y="abs(x)"), engine, 2.0)
    assert trace.final[1] == pytest.approx(2.0 / 3.0, abs=1e-12)
    assert not trace.jumps
    assert trace.outcome is Outcome.HORIZON


@both
def test_start_on_the_surface_follows_the_vector_field(engine: Engine) -> None:
    trace = run(flow({"x": 0, "v": 0, "y": 0}, x="v", v="1", y="abs(x) + sign(x)"), engine, 1.0)
    assert trace.final[2] == pytest.approx(1.0 / 6.0 + 1.0, abs=1e-13)
    assert not breaks(trace)


@both
def test_rest_under_a_restoring_sign_persists(engine: Engine) -> None:
    trace = run(flow({"x": 0, "v": 0}, x="v", v="-sign(x)"), engine, 1.0)
    assert trace.final == pytest.approx([0.0, 0.0], abs=0.0)


@both
def test_an_unstable_surface_is_not_unique(engine: Engine) -> None:
    trace = run(flow({"x": 0}, x="sign(x)"), engine, 1.0)
    assert trace.final == pytest.approx([0.0], abs=0.0)
    assert any("not unique" in text for text in trace.warnings)


@both
def test_friction_holds_until_the_load_exceeds_it(engine: Engine) -> None:
    chart = flow({"v": 0, "x": 0}, v="2*time - 3*sign(v)", x="v")
    trace = run(chart, engine, 3.0)
    assert breaks(trace) == pytest.approx([1.5], abs=1e-12)
    assert trace.final[0] == pytest.approx(1.5**2, abs=1e-11)


@both
def test_guard_fires_during_sliding_flow(engine: Engine) -> None:
    chart = compose(
        {"x": 1, "y": 0},
        {
            "r": region(
                {"s": {"x": "-sign(x)", "y": "1 + sign(x)/2"}, "done": {"x": "1"}},
                go("s", "done", "y >= 2", "there"),
            )
        },
    )
    trace = run(chart, engine, 3.0)
    # 3/2 until x is zero, then 1.
    assert times(trace, "there") == pytest.approx([1.5], abs=1e-12)
    assert trace.final[0] == pytest.approx(1.5, abs=1e-11)


@both
def test_nested_switches_cross_one_after_another(engine: Engine) -> None:
    trace = run(flow({"x": 2, "y": 0}, x="-1", y="abs(abs(x) - 1)"), engine, 4.0)
    assert breaks(trace) == pytest.approx([1.0, 2.0, 3.0], abs=1e-12)
    assert trace.final[1] == pytest.approx(2.0, abs=1e-12)


@both
def test_a_fractional_power_of_a_clipped_value_is_zero_beyond_the_clip(engine: Engine) -> None:
    trace = run(flow({"y": 1, "v": 0}, y="v", v="9*max(0, -y)**1.5 - 1"), engine, 4.0)
    assert breaks(trace)[0] == pytest.approx(math.sqrt(2.0), abs=1e-12)
    y, v = trace.final
    energy = 0.5 * v**2 + y + 9.0 * max(-y, 0.0) ** 2.5 / 2.5
    assert energy == pytest.approx(1.0, abs=1e-10)


@both
def test_products_of_signs_at_intersecting_surfaces_are_reported(engine: Engine) -> None:
    rates = {"x": "-sign(x)*(1 + sign(y)/2)", "y": "-sign(y)*(1 + sign(x)/2)"}
    chart = flow({"x": 1, "y": 1, "z": 0}, **rates, z="sign(x)*sign(y)")
    trace = Simulator(chart, engine).run({}, until=2.0, throw=False)
    assert trace.outcome is Outcome.AMBIGUOUS_MODE
    assert "in several switches at once" in trace.message
    # Without z, the intersection is a point, where the state stays.
    trace = run(flow({"x": 1, "y": 1}, **rates), engine, 2.0)
    assert trace.final == pytest.approx([0.0, 0.0], abs=1e-12)


@both
def test_time_optimal_control_ends_at_the_origin(engine: Engine) -> None:
    # One switch half-way, at t = 1; the target is reached at t = 2.
    trace = run(flow({"x": 1, "v": 0}, x="v", v="-sign(x + v*abs(v)/2)"), engine, 5.0)
    assert breaks(trace) == pytest.approx([1.0, 2.0], abs=1e-6)
    assert trace.final == pytest.approx([0.0, 0.0], abs=1e-12)
    # Under a disturbance the origin is reached, but its signs are not found.
    pushed = flow({"x": 1, "v": 0}, x="v", v="-sign(x + v*abs(v)/2) + 0.1*sin(pi*time)")
    trace = Simulator(pushed, engine).run(until=5.0, throw=False)
    assert trace.outcome is Outcome.AMBIGUOUS_MODE
    assert np.abs(trace.final).max() < 1e-12


@both
@pytest.mark.parametrize("size", [1e6, 1.0, 1e-6])
def test_units_of_surfaces_do_not_decide_whether_they_fix_the_state(
    engine: Engine, size: float
) -> None:
    surface = f"1e11*x + {1e11 * size}*v*abs(v)/2"
    trace = run(flow({"x": size, "v": 0}, x=f"{size}*v", v=f"-sign({surface})"), engine, 3.0)
    assert breaks(trace) == pytest.approx([1.0, 2.0], abs=1e-6)
    assert trace.final == pytest.approx([0.0, 0.0], abs=1e-12 * size)


@both
def test_twisting_control_under_a_disturbance_rests(engine: Engine) -> None:
    # Both signs act by x'' only, and do not determine each other.
    push = "0.1*sin(3*time + 1.64)"
    chart = flow({"x": 0.3, "v": 0.33}, x="v", v=f"-3.69*sign(x) - 0.86*sign(v) + {push}")
    trace = run(chart, engine, 6.0)
    assert trace.final == pytest.approx([0.0, 0.0], abs=1e-12)
    assert breaks(trace)[-1] == pytest.approx(3.63185, abs=1e-5)


@both
def test_a_spiral_around_two_surfaces_ends_at_their_intersection(engine: Engine) -> None:
    # Each turn shrinks by 1/81; z integrates the sliding mode with x' = y' = 0, sign(x) = 0.1.
    chart = flow(
        {"x": 1, "y": -0.7, "z": 0},
        x="-sign(x)/2 - sign(y)", y="sign(x) - sign(y)/2 - 1/8", z="sign(x)",
    )  # fmt: skip
    trace = run(chart, engine, 4.0)
    assert trace.final[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
    later = run(chart, engine, 5.0)
    assert later.final[2] - trace.final[2] == pytest.approx(0.1, abs=1e-12)


@both
def test_slides_at_rates_of_eleven_decades_are_found_together(engine: Engine) -> None:
    # x slides from 1e6 on, where its sign is 1/3.
    rates = {"x": "1e-6*(1/2 - 3/2*sign(x))", "y": "1e5*(1/2 - 3/2*sign(y))", "z": "sign(x)"}
    trace = run(flow({"x": 1, "y": 1, "z": 0}, **rates), engine, 2e6)
    assert trace.final == pytest.approx([0.0, 0.0, 4e6 / 3.0], rel=1e-9, abs=1e-9)


def test_rates_without_a_value_beside_a_surface_end_as_ambiguous() -> None:
    rates = {"x": "-sign(x)*sqrt(3/2 + 2*sign(x)*sign(y))", "y": "-sign(y)"}
    trace = Simulator(flow({"x": 1, "y": 1}, **rates), SCIPY).run(until=3.0, throw=False)
    assert trace.outcome is Outcome.AMBIGUOUS_MODE


def test_a_tank_that_has_drained_stays_empty_until_water_flows_in() -> None:
    # sqrt(h) falls at the constant rate 0.05: the tank is empty at t = 20. It has no Taylor series.
    drained = run(flow({"h": 1}, h="-0.1*sqrt(max(h, 0))"), SCIPY, 100.0)
    assert drained.outcome is Outcome.HORIZON
    assert drained.final == pytest.approx([0.0], abs=1e-9)
    rate = "-0.1*sqrt(max(h, 0)) + 0.02*max(0, time - 30)"
    filled = run(flow({"h": 1}, h=rate), SCIPY, 40.0)
    # An explicit Runge-Kutta method, with a tolerance of 1e-10.
    assert filled.final == pytest.approx([0.6096118], rel=1e-6)


@both
@pytest.mark.parametrize("rate", ["-sqrt(max(h, 0))", "-sign(h)*sqrt(abs(h))"])
def test_a_tank_with_a_root_as_outflow_empties_on_time(rate: str, engine: Engine) -> None:
    drained = run(flow({"h": 1}, h=rate), engine, 2.5)
    assert breaks(drained)[0] == pytest.approx(2.0, abs=1e-12)
    assert drained.final == pytest.approx([0.0], abs=1e-15)


def test_switches_at_a_steady_pace_that_cannot_reach_the_end_are_too_long() -> None:
    trace = Simulator(flow({"x": 1, "v": 0}, x="v", v="-sign(x)"), TAYLOR).run(
        until=1e9, throw=False
    )
    assert trace.outcome is Outcome.TOO_LONG
    # 512 switches, two in each period of 4 sqrt(2).
    assert trace.t_end == pytest.approx(512 * 2 * math.sqrt(2), rel=0.01)


def test_a_stiff_inflow_into_an_empty_tank_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(livelock, "SWITCHES", 64)
    # The level 100 u^2 is far below the tolerance of an explicit method, which passes zero.
    chart = flow({"h": 1}, h="-0.1*sqrt(max(h, 0)) + 0.02*exp(-(time - 35)**2)")
    trace = Simulator(chart, SCIPY).run(until=60.0, throw=False)
    # Round-off decides whether switches repeat at one instant, or too many follow.
    assert trace.outcome in (Outcome.EVENT_LOOP, Outcome.TOO_LONG)
    assert "smooth the function" in trace.message
    assert abs(trace.final[0]) < 1e-9


def test_tanks_that_drain_into_each_other_stay_empty() -> None:
    out = [f"0.{k}*sqrt(max({h}, 0))" for h, k in (("a", 1), ("b", 2), ("c", 3))]
    chart = flow(
        {"a": 1, "b": 0.2, "c": 0},
        a=f"-{out[0]}", b=f"{out[0]} - {out[1]}", c=f"{out[1]} - {out[2]}",
    )  # fmt: skip
    three = run(chart, SCIPY, 40.0)
    assert breaks(three)[0] == pytest.approx(20.0, abs=1e-7)
    assert three.final == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    out = ["0.1*sqrt(max(a, 0))", "0.05*sqrt(max(b, 0))"]
    two = run(flow({"a": 1, "b": 0}, a=f"-{out[0]}", b=f"{out[0]} - {out[1]}"), SCIPY, 40.0)
    # At t = 20, b = 0.389988020 (LSODA, steps of 0.05); sqrt(b) then falls at the rate 0.025.
    assert two.final == pytest.approx([0.0, (math.sqrt(0.389988020) - 0.5) ** 2], abs=1e-8)


def test_a_slide_without_equations_is_no_candidate() -> None:
    # a is empty from 1.20 until its inflow begins at 3.87; the equations of a slide there are 0/0.
    inflow, out = "0.23*max(0, sin(time + 2.41))", "sqrt(max(a, 0))"
    rates = {"a": f"-0.76*{out} + {inflow}", "b": f"0.15*{out} - 0.43*sqrt(max(b, 0))"}
    for k in range(4):
        # No last bit of the start decides how the empty tanks begin to fill.
        start = {"a": 0.13 * (1 + k * 3e-16), "b": 0.47}
        trace = run(flow(start, **rates), SCIPY, 6.0)
        # LSODA, tolerance 1e-12, steps of 1e-3.
        assert trace.final == pytest.approx([0.0722935, 0.0078531], abs=1e-6)


def test_super_twisting_control_slides_with_its_second_derivative_at_zero() -> None:
    # With s = s' = 0, w = -d and w' = -1.1 u: the disturbance d leaves where |d'| exceeds 1.1.
    rates = {"s": "-1.5*sqrt(abs(s))*sign(s) + w + d", "w": "-1.1*sign(s)"}
    held = {n: rate.replace("d", "0.2*sin(time)") for n, rate in rates.items()}
    trace = run(flow({"s": 1, "w": 0}, **held), SCIPY, 5.0)
    assert trace.final == pytest.approx([0.0, -0.2 * math.sin(5.0)], abs=1e-8)
    left = {n: rate.replace("d", "0.001*time**9") for n, rate in rates.items()}
    trace = run(flow({"s": 0.1, "w": 0}, **left), SCIPY, 2.2)
    leaves = (1.1 / 0.009) ** (1 / 8)
    assert breaks(trace)[-1] == pytest.approx(leaves, abs=1e-6)
    # w' = -1.1 from then on. LSODA from s = 0 at 1.8234496 gives s.
    final_w = -0.001 * leaves**9 - 1.1 * (2.2 - leaves)
    assert trace.final == pytest.approx([0.0298126, final_w], abs=1e-6)


def test_rates_without_a_value_end_the_run() -> None:
    trace = Simulator(flow({"x": 0}, x="1/x"), SCIPY).run(until=1.0, throw=False)
    assert trace.outcome is Outcome.NON_FINITE
    assert "write a state for each side" in trace.message
