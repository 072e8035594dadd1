"""A block that rocks from corner to corner, against reference numbers (Housner 1963)."""

from __future__ import annotations

import math

import pytest
from runs import ENGINES, golden, outputs, run

MODEL = "rocking_block"
(CASE,) = golden(MODEL)["cases"]
GIVEN = {
    "b": CASE["b"],
    "h": CASE["h"],
    "g": CASE["g"],
    "theta0": CASE["theta0_over_alpha"] * float(CASE["alpha"]),
}

pytestmark = pytest.mark.parametrize("engine", ENGINES)


def test_impacts_are_the_reference_ones(engine: str) -> None:
    trace = run(MODEL, engine, until=7.7, **GIVEN)
    assert trace.certified
    found = outputs(MODEL, engine, trace)
    impacts = CASE["nonlinear_impacts"]
    assert len(trace.jumps) == len(impacts)
    assert found["impact_times"] == pytest.approx([float(i["t"]) for i in impacts], abs=1e-9)
    rates = [float(i["omega_minus"]) for i in impacts]
    assert found["rates_before"] == pytest.approx(rates, abs=1e-9)
    for n, (jump, before, after) in enumerate(
        zip(trace.jumps, found["rates_before"], found["rates_after"], strict=True)
    ):
        hit, left = ("left", "right") if n % 2 == 0 else ("right", "left")
        assert (jump.region, jump.cause) == (hit, "touchdown")
        states = dict(zip(trace.regions, jump.target, strict=True))
        assert states == {hit: "pin", left: "free"}
        assert list(jump.impulse) == [hit]
        eta = float(CASE["velocity_restitution_eta"])
        assert after / before == pytest.approx(eta, abs=1e-11)


def test_its_impacts_accumulate_when_the_reference_says_and_it_stands(engine: str) -> None:
    trace = run(MODEL, engine, until=15.0, **GIVEN)
    assert trace.outcome.name == "HORIZON"
    assert trace.final_mode == ("pin", "pin")
    rest = trace.jumps[-1]
    assert rest.cause == "zeno"
    # The looser the tolerance, the sooner the times of impacts are noise and their rest is summed.
    allowed = 1e-9 if engine == "taylor" else 2e-8
    assert rest.t == pytest.approx(float(CASE["zeno_time"]), abs=allowed)
    # It has never slipped: it stands where it stood.
    assert trace.final == pytest.approx([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], abs=1e-11)


@pytest.mark.parametrize("factor", [1 - 1e-6, 1 + 1e-6])
def test_it_falls_over_when_tilted_beyond_its_diagonal(engine: str, factor: float) -> None:
    trace = run(MODEL, engine, until=12.0, theta0=factor * math.atan(0.2))
    overturned = trace.jumps[-1].fired == ("overturned",)
    assert overturned is (factor > 1.0)
    assert any(jump.region == "left" for jump in trace.jumps) is (factor < 1.0)
