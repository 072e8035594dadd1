"""The rimless wheel against closed forms and reference numbers (McGeer 1990, Coleman 1998)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs import ENGINES, golden, outputs, run

MODEL = "rimless_wheel"
CASES = golden(MODEL)["cases"]

pytestmark = pytest.mark.parametrize("engine", ENGINES)
cases = pytest.mark.parametrize("case", CASES, ids=lambda case: f"g={case['g']}")


def given(case: dict) -> dict[str, float]:
    return {name: float(case[name]) for name in ("alpha", "gamma", "g", "l")}


@cases
def test_rates_after_impacts_are_the_reference_ones(engine: str, case: dict) -> None:
    start, *expected = map(float, case["omega_plus_sequence"])
    until = (len(expected) + 0.5) * float(case["step_period"])
    trace = run(MODEL, engine, until=until, omega0=start, **given(case))
    assert trace.certified
    found = outputs(MODEL, engine, trace)["omega_plus"]
    assert found[: len(expected)] == pytest.approx(expected, abs=1e-11)


@cases
def test_spokes_touch_down_in_order(engine: str, case: dict) -> None:
    until = 9.5 * float(case["step_period"])
    start = float(case["omega_plus_star"])
    trace = run(MODEL, engine, until=until, omega0=start, **given(case))
    assert len(trace.jumps) == 9
    for n, jump in enumerate(trace.jumps):
        now = f"s{(n + 1) % 8}"
        assert (jump.region, jump.cause) == (now, "touchdown")
        assert (jump.source[n % 8], jump.target[n % 8]) == ("pin", "free")
        assert list(jump.impulse) == [now]
        # Angular momentum about the new foot: the factor is cos(2 alpha).
        ratio = jump.after[5] / jump.before[5]
        assert ratio == pytest.approx(float(case["lambda_restitution"]), abs=1e-11)


@cases
def test_the_limit_cycle_equals_the_reference(engine: str, case: dict) -> None:
    period, rate = float(case["step_period"]), float(case["omega_plus_star"])
    trace = run(MODEL, engine, until=9.5 * period, omega0=rate, **given(case))
    found = outputs(MODEL, engine, trace)
    assert found["omega_plus"] == pytest.approx([rate] * 9, abs=1e-11)
    assert np.diff([0.0, *found["impact_times"]]) == pytest.approx([period] * 9, abs=1e-11)
    before = [-jump.before[5] for jump in trace.jumps]
    assert before == pytest.approx([float(case["omega_minus_star"])] * 9, abs=1e-9)
    # A step takes the hub 2 l sin(alpha) along the slope.
    hub = np.diff([jump.before[:2] for jump in trace.jumps], axis=0)
    step = 2.0 * float(case["l"]) * math.sin(float(case["alpha"]))
    assert np.hypot(*hub.T) == pytest.approx([step] * 8, abs=1e-9)


@cases
@pytest.mark.parametrize("factor", [1 + 1e-4, 1 - 1e-4])
def test_the_wheel_passes_the_vertical_only_above_a_rate(
    engine: str, case: dict, factor: float
) -> None:
    rate = factor * float(case["omega_min_to_pass_vertical"])
    until = 4.0 * float(case["step_period"])
    trace = run(MODEL, engine, until=until, omega0=rate, **given(case))
    assert trace.jumps[0].region == ("s1" if factor > 1.0 else "s7")


@pytest.mark.parametrize(
    ("spokes", "gamma"), [(6, 0.22), (7, 0.15), (10, 0.1), (12, 0.1), (16, 0.05)]
)
def test_wheels_of_other_spokes_follow_the_map(engine: str, spokes: int, gamma: float) -> None:
    alpha, g, length = math.pi / spokes, 2.0, 0.5
    gain = 4.0 * g / length * math.sin(alpha) * math.sin(gamma)
    rates = [1.1 * math.sqrt(gain) / math.tan(2.0 * alpha)]
    for _ in range(2 * spokes):
        rates.append(math.cos(2.0 * alpha) * math.sqrt(rates[-1] ** 2 + gain))
    trace = run(
        MODEL, engine, until=40.0, alpha=alpha, gamma=gamma, g=g, l=length, omega0=rates[0]
    )  # fmt: skip
    assert trace.outcome.succeeded
    found = outputs(MODEL, engine, trace)["omega_plus"]
    assert found[: 2 * spokes] == pytest.approx(rates[1:], abs=1e-10)
    for n, jump in enumerate(trace.jumps[: 2 * spokes]):
        assert (jump.region, jump.cause) == (f"s{(n + 1) % spokes}", "touchdown")


def test_a_wheel_without_spokes_and_inertia_ends_with_the_reason(engine: str) -> None:
    assert "add it to its body" in run(MODEL, engine, l=0.0).message
