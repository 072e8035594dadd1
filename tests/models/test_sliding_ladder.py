"""A ladder between a wall and the floor, against closed forms."""

from __future__ import annotations

import math

import pytest
from runs import ENGINES, outputs, run
from scipy.integrate import quad

MODEL = "sliding_ladder"

pytestmark = pytest.mark.parametrize("engine", ENGINES)


@pytest.mark.parametrize("theta0", [0.05, 0.2, 1.0])
def test_the_ladder_leaves_the_wall_at_two_thirds_of_its_height(engine: str, theta0: float) -> None:
    trace = run(MODEL, engine, theta0=theta0)
    assert trace.certified
    assert trace.modes == (("slide+", "slide+"), ("slide+", "free"))
    found = outputs(MODEL, engine, trace)
    assert found["height_ratio"] == pytest.approx(2 / 3, abs=1e-11)

    # Energy: theta'^2 = 3 g/(2 l) (cos theta0 - cos theta), from rest; u = sqrt(theta - theta0).
    def duration(u: float) -> float:
        fall = 2.0 * math.sin(theta0 + u**2 / 2.0) * math.sin(u**2 / 2.0)
        return 2.0 * u / math.sqrt(1.5 * 9.81 / 2.0 * fall)

    end = math.sqrt(math.acos(2 / 3 * math.cos(theta0)) - theta0)
    assert found["t_leave"] == pytest.approx(quad(duration, 0.0, end, epsabs=1e-13)[0], abs=1e-9)
    # Beside the wall nothing moves it sideways any more.
    left = trace.jumps[0].after
    assert trace.final[3] == pytest.approx(left[3], abs=1e-12)


@pytest.mark.parametrize(("mu", "slides"), [(0.09, True), (0.11, False)])
def test_friction_holds_a_ladder_up_to_a_critical_lean(
    engine: str, mu: float, slides: bool
) -> None:
    # At the critical lean both ends are about to slide: tan(theta) = 2 mu/(1 - mu^2).
    trace = run(MODEL, engine, until=3.0, mu=mu, theta0=0.2)
    assert (trace.start_mode == ("slide+", "slide+")) is slides
    assert bool(trace.final[2] > 0.3) is slides
