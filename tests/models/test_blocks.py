"""Blocks on an incline and under a harmonic force, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs import ENGINES, golden, modes, outputs, run

GOLDEN = golden("block_friction")

pytestmark = pytest.mark.parametrize("engine", ENGINES)


@pytest.mark.parametrize("case", GOLDEN["thrown_up"] + GOLDEN["thrown_down"])
def test_a_block_thrown_along_an_incline(engine: str, case: dict) -> None:
    v0 = case["v0_up"] if "v0_up" in case else -case["v0_down"]
    trace = run(
        "block_on_incline", engine, until=3.0,
        alpha=math.radians(case["alpha_deg"]), mu=case["mu"], v0=v0,
    )  # fmt: skip
    found = outputs("block_on_incline", engine, trace)
    assert found["t_stop"] == pytest.approx(float(case["t_stop"]), abs=1e-9)
    assert found["d_stop"] == pytest.approx(float(case["d_stop"]), abs=1e-9)
    assert modes(trace) == ["pin" if m == "stick" else m for m in case["modes"]]
    if "t_return" in case:
        back = run(
            "block_on_incline", engine, until=float(case["t_return"]),
            alpha=math.radians(case["alpha_deg"]), mu=case["mu"], v0=v0,
        )  # fmt: skip
        assert back.final[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
        assert math.hypot(*back.final[2:]) == pytest.approx(float(case["v_return"]), abs=1e-9)


def test_friction_at_the_angle_of_repose_holds(engine: str) -> None:
    alpha = 0.3
    above = run("block_on_incline", engine, until=3.0, alpha=alpha, mu=math.tan(alpha) * 1.000001)
    assert modes(above) == ["slide+", "pin"]
    below = run("block_on_incline", engine, until=3.0, alpha=alpha, mu=math.tan(alpha) * 0.999999)
    assert modes(below) == ["slide+", "slide-"]


def test_a_block_that_sticks_does_not_creep(engine: str) -> None:
    trace = run("block_on_incline", engine, until=1e6, alpha=0.3, mu=0.5, v0=0.0)
    assert modes(trace) == ["pin"]
    assert np.abs(trace.final).max() < trace.tolerances["gap"]


def test_frictionless_block_accelerates_at_g_sin_alpha(engine: str) -> None:
    alpha, t = 0.3, 2.0
    trace = run("block_on_incline", engine, until=t, alpha=alpha, mu=0.0, v0=0.0)
    assert modes(trace) == ["slide-"]
    distance = 0.5 * 9.81 * math.sin(alpha) * t**2
    assert math.hypot(*trace.final[:2]) == pytest.approx(distance, rel=1e-12)


@pytest.mark.parametrize("case", GOLDEN["forced_block"])
def test_a_forced_block_sticks_slips_and_turns(engine: str, case: dict) -> None:
    trace = run(
        "stick_slip_block",
        engine,
        until=7.0,
        **{n: case[n] for n in ("F0", "omega", "mu", "m", "g")},
    )
    found = outputs("stick_slip_block", engine, trace)
    assert found["t_first_slip"] == pytest.approx(float(case["t_first_slip"]), abs=1e-9)
    jumps = trace.jumps
    for jump, stop, phase in zip(jumps, jumps[1:], case["phases"], strict=False):
        assert jump.target[0] == phase["mode"]
        assert jump.t == pytest.approx(float(phase["t_start"]), abs=1e-9)
        assert stop.t == pytest.approx(float(phase["t_stop"]), abs=1e-9)
        assert stop.before[0] == pytest.approx(float(phase["x"]), abs=1e-9)
    assert len(jumps) >= len(case["phases"]) + 1


def test_a_force_below_friction_never_moves_it(engine: str) -> None:
    trace = run("stick_slip_block", engine, until=7.0, F0=0.98, mu=0.1)
    assert modes(trace) == ["pin"]
    assert np.array_equal(trace.final, trace.initial)


@pytest.mark.parametrize("alpha", [0.0, 1e-9, 0.3, 1.0, 1.5])
@pytest.mark.parametrize("mu", [math.inf, 1e300, 1e16])
def test_friction_without_bound_stops_a_block_at_once(engine: str, alpha: float, mu: float) -> None:
    trace = run("block_on_incline", engine, until=3.0, alpha=alpha, mu=mu, v0=3.0)
    assert [jump.cause for jump in trace.jumps] == ["jam"]
    assert trace.jumps[0].impulse["base"] == pytest.approx((0.0, -3.0), abs=1e-12)
    assert trace.final_mode == ("pin",)
    assert outputs("block_on_incline", engine, trace)["t_stop"] == 0.0
    assert np.abs(trace.final).max() < 1e-13


@pytest.mark.parametrize("mu", [1e6, 1e10])
def test_large_friction_stops_a_block_quickly(engine: str, mu: float) -> None:
    trace = run("block_on_incline", engine, until=3.0, alpha=0.3, mu=mu, v0=3.0)
    found = outputs("block_on_incline", engine, trace)
    assert found["t_stop"] == pytest.approx(3.0 / (9.81 * math.cos(0.3) * mu), rel=1e-5)
    assert modes(trace) == ["slide+", "pin"]


def test_a_slip_soon_after_the_start_of_a_long_step_is_located_to_round_off(engine: str) -> None:
    values = {"F0": 32.0, "omega": 25.0, "mu": 0.0035, "m": 0.03}
    trace = run("stick_slip_block", engine, until=7.0, **values)
    expected = math.asin(0.0035 * 0.03 * 9.81 / 32.0) / 25.0
    assert trace.jumps[0].t == pytest.approx(expected, rel=1e-9)
