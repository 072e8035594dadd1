"""A block that rocks from corner to corner, against reference numbers (Housner 1963)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs import ENGINES, golden, outputs, run
from scipy.integrate import quad

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


def test_impacts_accumulate_at_the_reference_time(engine: str) -> None:
    trace = run(MODEL, engine, until=15.0, **GIVEN)
    assert trace.outcome.name == "HORIZON"
    assert trace.final_mode == ("pin", "pin")
    rest = trace.jumps[-1]
    assert rest.cause == "zeno"
    promised = {"taylor": 1e-11, "scipy": 1e-10}[engine]  # decision 0004
    assert rest.t == pytest.approx(float(CASE["zeno_time"]), rel=promised)
    # It has never slipped: it stands where it stood.
    assert trace.final == pytest.approx([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], abs=1e-11)


def test_the_tilt_agrees_with_the_reference(engine: str) -> None:
    trace = run(MODEL, engine, until=7.7, **GIVEN)
    expected = [float(amplitude) for amplitude in CASE["nonlinear_amplitudes"]]
    found = []
    for arc in trace.arcs:
        tilts = np.abs(arc.states(np.linspace(0.0, arc.duration, 4001))[:, 2])
        k = int(np.argmax(tilts))
        if 0 < k < len(tilts) - 1:  # the top of the parabola through three points
            one, two, three = tilts[k - 1 : k + 2]
            found.append(two + (three - one) ** 2 / (8.0 * (2.0 * two - one - three)))
    # The first is the start, and the run ends before the last.
    assert found[: len(expected) - 1] == pytest.approx(expected[1:], abs=1e-11)


def accumulation(b: float, h: float, tilt: float, g: float) -> float:
    """Return when the impacts of a block let go at a tilt accumulate, by quadratures."""
    alpha, p2 = math.atan2(b, h), 0.75 * g / math.hypot(b, h)
    eta = 1.0 - 1.5 * math.sin(alpha) ** 2

    def swing(top: float) -> float:
        """Return the time from an impact to the next, by the tilt between (s^2 below it)."""
        integrand = lambda s: (  # noqa: E731
            4.0 * s / math.sqrt(4.0 * p2 * math.sin(alpha - top + s * s / 2) * math.sin(s * s / 2))
        )
        return float(quad(integrand, 0.0, math.sqrt(top), epsabs=0.0, epsrel=1e-13)[0])

    time = swing(tilt) / 2.0
    rate = math.sqrt(2.0 * p2 * (math.cos(alpha - tilt) - math.cos(alpha)))
    slope = 2.0 / (p2 * math.sin(alpha))
    while rate > 1e-3 * math.sqrt(p2):
        rate *= eta
        time += swing(alpha - math.acos(math.cos(alpha) + rate**2 / (2.0 * p2)))
    # The time is odd in the rate: a multiple of it, and of its cube.
    rate *= eta
    cubic = swing(alpha - math.acos(math.cos(alpha) + rate**2 / (2.0 * p2))) - slope * rate
    return time + slope * rate / (1.0 - eta) + cubic / (1.0 - eta**3)


@pytest.mark.parametrize(
    ("b", "h", "g", "share"),
    [
        (0.4, 1.0, 9.81, 0.9),
        (0.3, 1.0, 1.0, 0.2),
        (0.25, 0.5, 1.62, 0.6),
        (0.5, 0.5, 9.81, 0.7),
        (0.7, 1.0, 9.81, 0.5),
        (0.15, 2.0, 9.81, 0.3),
    ],
)
def test_impacts_of_other_blocks_accumulate_in_time(
    engine: str, b: float, h: float, g: float, share: float
) -> None:
    tilt = share * math.atan2(b, h)
    expected = accumulation(b, h, tilt, g)
    trace = run(MODEL, engine, until=1.1 * expected, b=b, h=h, g=g, theta0=tilt)
    assert trace.final_mode == ("pin", "pin")
    promised = {"taylor": 1e-9, "scipy": 5e-9}[engine]  # decision 0004
    assert trace.jumps[-1].t == pytest.approx(expected, rel=promised)


@pytest.mark.parametrize("factor", [1 - 1e-6, 1 + 1e-6])
def test_a_block_falls_over_when_tilted_beyond_its_diagonal(engine: str, factor: float) -> None:
    trace = run(MODEL, engine, until=12.0, theta0=factor * math.atan(0.2))
    overturned = trace.jumps[-1].fired == ("overturned",)
    assert overturned is (factor > 1.0)
    assert any(jump.region == "left" for jump in trace.jumps) is (factor < 1.0)


def test_the_mirror_image_of_a_block_rocks_as_the_image(engine: str) -> None:
    one = run(MODEL, engine, until=7.7, **GIVEN)
    other = run(MODEL, engine, until=7.7, **{**GIVEN, "theta0": -GIVEN["theta0"]})
    assert [jump.t for jump in other.jumps] == pytest.approx([j.t for j in one.jumps], abs=1e-12)
    names = {"left": "right", "right": "left"}
    assert [jump.region for jump in other.jumps] == [names[jump.region] for jump in one.jumps]
    assert other.final == pytest.approx(one.final * [-1, 1, -1, -1, 1, -1], abs=1e-11)


def test_upright_block_stays_at_rest(engine: str) -> None:
    trace = run(MODEL, engine, until=5.0, theta0=0.0)
    assert trace.modes == (("pin", "pin"),)
    assert trace.final == pytest.approx([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], abs=1e-15)
