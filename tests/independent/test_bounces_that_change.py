"""Bounces under changing acceleration, against a computation bounce by bounce in 30 digits."""

from __future__ import annotations

import mpmath
import pytest

from statechart import Runner
from statechart.documents.yaml_reader import read_text

# The floor lies where rounding of the height ends the bounces early; the push grows with time, the
# drag and the lift (of what slips) with velocities.
_SCENE = """\
kind: scene
name: changing
parameters: {e: 0.5, j: 0, c: 0, k: 0, mu: 0}
gravity: 9
bodies: {ball: {mass: 1, start: {y: 1, dx: 1, dy: 0.01}}}
forces: {push: {body: ball, force: [0, j*time - c*ball.dy + k*(ball.dx - 1)]}}
surfaces: {floor: {height: 1}}
contacts:
  touch:
    {point: {body: ball}, surface: floor, modes: [free, slide], friction: mu, restitution: e}
stop: {time: 0.05}
outputs: {rests: {value: time, at: first zeno}, slip: {value: touch.slip, at: first zeno}}
"""


def _followed(e: float, j: float, c: float, k: float, mu: float) -> tuple[float, float]:
    """Return when bounces have come to an end, and the slip there."""
    with mpmath.workdps(30):
        time, rate, slip = mpmath.mpf(0), mpmath.mpf("0.01"), mpmath.mpf(1)
        while rate > mpmath.mpf(10) ** -25:
            falls = 9 - j * time - k * (slip - 1)

            def height(s, falls=falls, rate=rate):
                # v' = -falls + j s - c v
                if not c:
                    return rate * s - falls * s**2 / 2 + j * s**3 / 6
                slope = mpmath.mpf(j) / c
                level = (-falls - slope) / c
                return level * s + slope * s**2 / 2 + (rate - level) * -mpmath.expm1(-c * s) / c

            lasts = 2 * rate / falls
            lasts = mpmath.findroot(height, (0.98 * lasts, 1.02 * lasts), verify=False)
            strikes = -mpmath.diff(height, lasts, h=mpmath.mpf(10) ** -18 * lasts)
            time += lasts
            slip -= mu * (1 + e) * strikes
            rate = e * strikes
        return float(time), float(slip)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("e", [0.3, 0.9])
@pytest.mark.parametrize(
    ("j", "c", "k", "mu"), [(50, 0, 0, 0), (-50, 0, 0, 0), (30, -40, 0, 0), (0, 40, 90, 0.5)]
)
def test_the_zeno_sum_includes_the_change_of_acceleration(
    engine: str, e: float, j: float, c: float, k: float, mu: float
) -> None:
    values = {"e": e, "j": j, "c": c, "k": k, "mu": mu}
    found = Runner(read_text(_SCENE), engine=engine).run(values).outputs
    time, slip = _followed(e, j, c, k, mu)
    assert found["rests"] == pytest.approx(time, abs=4e-10)
    assert found["slip"] == pytest.approx(slip, abs=4e-9)
