"""Charts against closed forms: switching by hysteresis, drag, timeouts with histories, Zeno."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

import statechart

_CHARTS = Path(__file__).parent / "charts"

pytestmark = pytest.mark.parametrize("engine", ["taylor", "scipy"])


def outputs(name: str, engine: str, **parameters: float) -> Any:
    path = _CHARTS / f"{name}.yaml"
    return statechart.run(path, engine=engine, parameters=parameters).outputs


def test_a_thermostat_switches_after_logarithms(engine: str) -> None:
    out, k, power, low, high = 5.0, 0.1, 4.0, 19.0, 21.0
    top = out + power / k
    t, at, times, on, used = 0.0, 15.0, [], True, 0.0
    while True:
        ratio = (top - at) / (top - high) if on else (at - out) / (low - out)
        took = math.log(ratio) / k
        used += power * (min(t + took, 60.0) - t) if on else 0.0
        t += took
        if t > 60.0:
            break
        times.append(t)
        at, on = (high, False) if on else (low, True)
    found = outputs("thermostat", engine)
    assert found["t"] == pytest.approx(times, rel=1e-10)
    assert found["used"] == pytest.approx(used, rel=1e-10)
    assert found["onT"] == pytest.approx(used / power, rel=1e-10)


def test_a_ball_with_drag_rises_by_an_arc_tangent_and_falls_by_an_arc_cosine(engine: str) -> None:
    g, c, e, height = 9.81, 0.3, 0.8, 5.0
    fast = math.sqrt(g / c)
    t, times, speeds, tops = 0.0, [], [], []
    while True:
        t += fast / g * math.acosh(math.exp(c * height))
        if t > 4.4:
            break
        speed = fast * math.sqrt(-math.expm1(-2 * c * height))
        times.append(t)
        speeds.append(-speed)
        t += fast / g * math.atan(e * speed / fast)
        height = math.log1p((e * speed / fast) ** 2) / (2 * c)
        tops += [height] if t <= 4.4 else []
    found = outputs("drag", engine)
    assert found["t"] == pytest.approx(times, rel=1e-9)
    assert found["v"] == pytest.approx(speeds, rel=1e-8)
    assert found["h"] == pytest.approx(tops, rel=1e-7)


def test_engine_resumes_its_interrupted_stroke(engine: str) -> None:
    # The key is off for 0.5 and on for 1.1; strokes of pi take pi/10 and pi/15.
    t, angle, fires, fuel, power = 0.0, 0.0, [], 1.0, False
    while t + 0.5 < 6.0:
        t += 0.5
        end = min(t + 1.1, 6.0)
        while True:
            rate, goal = (15.0, 2 * math.pi) if power else (10.0, math.pi)
            took = (goal - angle) / rate
            if t + took > end:
                angle += rate * (end - t)
                fuel -= 0.05 * (end - t) if power else 0.0
                t = end
                break
            t += took
            fuel -= 0.05 * took if power else 0.0
            angle, power = (0.0, False) if power else (math.pi, True)
            fires += [t] if power else []
    found = outputs("engine2", engine)
    assert found["fires"] == pytest.approx(fires, rel=1e-12)
    assert found["fuel"] == pytest.approx(fuel, rel=1e-12)
    assert found["angle"] == pytest.approx(angle, rel=1e-10)


def test_tanks_run_dry_when_their_water_is_gone(engine: str) -> None:
    # In all 2 of water, and 0.5 more goes than comes.
    found = outputs("tanks", engine)
    assert found["t"] == pytest.approx([1.0, 2.5, 3.25, 3.625, 3.8125, 3.90625], rel=1e-12)
    assert found["tz"] == pytest.approx(4.0, rel=1e-9)
    later = outputs("tanks", engine, a=2.0, w=1.2)
    assert later["tz"] == pytest.approx((2.0 + 1.0) / (2.0 - 1.2), rel=1e-9)
