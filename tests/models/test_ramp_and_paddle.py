"""The disc on the ramp of fixed crates beside its closed form."""

from __future__ import annotations

import math

import pytest

from statechart.running.runner import Runner


@pytest.mark.parametrize(("v", "e"), [(0.4, 0.6), (0.1, 0.0), (0.8, 0.9)])
def test_the_disc_meets_the_paddle_where_rolling_takes_it(v: float, e: float) -> None:
    h, a, d = 5e-4, 9.81 * math.sin(math.radians(20)) / 1.5, 0.7
    meets = (math.sqrt(v * v + 2 * a * d) - v) / a
    outputs = Runner("ramp_and_paddle").run({"v": v, "e": e}, until=0.75).outputs
    assert outputs["meets"] == pytest.approx(meets, abs=h)
    assert outputs["comes"] == pytest.approx(a * meets, abs=2 * a * h)
    assert outputs["goes"] == pytest.approx(v + e * (v + a * meets), abs=2 * a * h)
