"""Tanks that run empty, h' = -c sqrt(h), and other flows that reach the zero of a root's base."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from statechart import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result
from statechart.running.runner import run

TANKS = """\
kind: chart
name: tanks
parameters: {{c: 0.7}}
variables: {{h: 2, g: 0, clock: 0}}
regions:
  r:
    initial: drains
    states: {{drains: {{flows: {{{flows}, clock: 1}}}}, empty: {{}}}}
    transitions: [{{name: ends, from: drains, to: empty, guard: {guard}}}]
{other}stop: {{time: 9}}
outputs:
  t: {{value: time, at: first r.ends}}
  h: {{value: h}}
  g: {{value: g, at: first r.ends}}
"""
CLOCK = """\
  {name}:
    initial: a
    states: {{a: {{}}, b: {{}}}}
    transitions: [{{name: tick, from: a, to: b, after: {tick}}}]
"""
ENGINES = [("taylor", None), *[("scipy", m) for m in ("RK45", "DOP853", "Radau", "LSODA")]]
TORRICELLI = 2 * math.sqrt(2) / 0.7


def empty_at(loss: float) -> float:
    """Return the time at which h' = -loss - c sqrt(h) reaches 0 from 2."""
    k = loss / 0.7
    return 2 / 0.7 * (math.sqrt(2) - k * math.log1p(math.sqrt(2) / k))


def drained(flows: str, guard: str, engine: tuple[str, str | None], other: str = "") -> Result:
    name, method = engine
    options: dict[str, Any] = {} if method is None else {"method": method}
    text = TANKS.format(flows=flows, guard=guard, other=other)
    return run(read_text(text), engine=name, throw=False, **options)


@pytest.mark.parametrize("engine", ENGINES, ids=str)
@pytest.mark.parametrize(
    ("flows", "guard", "time"),
    [
        ("h: -c*sqrt(h)", "h <= 0", TORRICELLI),
        ("h: '-c*sqrt(max(h, 0))'", "h <= 0", TORRICELLI),
        ("h: -c*sqrt(h)", "h <= 1e-9", TORRICELLI - 2 * math.sqrt(1e-9) / 0.7),
        ("h: -c*h**(1/3)", "h <= 0", 1.5 * 2 ** (2 / 3) / 0.7),
        ("h: -c*h**0.75", "h <= 0", 4 * 2**0.25 / 0.7),
        ("h: -2*sqrt(h - 1)", "h <= 1", 1.0),
        ("h: '-2*sqrt(max(h - 1, 0))'", "h <= 1", 1.0),
        # Two tanks joined by a pipe.
        ("h: '-sqrt(max(h - g, 0))', g: 'sqrt(max(h - g, 0))'", "g >= h", math.sqrt(2)),
        ("h: -0.1 - c*sqrt(h)", "h <= 0", empty_at(0.1)),
        ("h: '-1e-4 - c*sqrt(max(h, 0))'", "h <= 0", empty_at(1e-4)),
        # A tank that is empty stays so.
        ("h: '-c*sqrt(max(h, 0))'", "clock >= 7", 7.0),
        ("h: '-2*sqrt(max(h - 1, 0))'", "clock >= 7", 7.0),
        # 0.49 h = 0.0025: the inflow holds the level.
        ("h: 0.0007 - c*sqrt(h)", "clock >= 8", 8.0),
    ],
)
def test_the_zero_of_a_base_is_reached_in_time(
    flows: str, guard: str, time: float, engine: tuple[str, str | None]
) -> None:
    found = drained(flows, guard, engine)
    assert found.outputs["t"] == pytest.approx(time, abs=1e-9)
    assert not found.trace.warnings


@pytest.mark.parametrize("engine", ENGINES, ids=str)
def test_a_root_of_a_negative_base_ends_the_run(engine: tuple[str, str | None]) -> None:
    trace = drained("h: -2*sqrt(h - 1)", "h <= 0.5", engine).trace
    assert trace.outcome is Outcome.STEP_FAILURE
    assert trace.t_end == pytest.approx(1.0, abs=1e-9)
    assert "the base of a root would be negative after t = 1" in trace.message


@pytest.mark.parametrize("engine", ENGINES, ids=str)
@pytest.mark.parametrize("flow", ["-2*sqrt(h - 1)", "'-2*sqrt(max(h - 1, 0))'"])
@pytest.mark.parametrize("ticks", [(0.9,), (0.99999,), (0.9999, 0.9999 + 1e-9)], ids=str)
def test_events_elsewhere_delay_no_tank_that_is_almost_empty(
    ticks: tuple[float, ...], flow: str, engine: tuple[str, str | None]
) -> None:
    clocks = "".join(CLOCK.format(name=f"k{i}", tick=tick) for i, tick in enumerate(ticks))
    found = drained(f"h: {flow}", "h <= 1", engine, clocks)
    # The method has a tolerance of 1e-10.
    assert found.outputs["t"] == pytest.approx(1.0, abs=1e-9)
    assert len(found.trace.jumps) == 1 + len(ticks)


@pytest.mark.parametrize("engine", ENGINES, ids=str)
def test_a_flow_goes_on_from_the_zero_of_a_base_after_two_events_in_turn(
    engine: tuple[str, str | None],
) -> None:
    ticks = "".join(CLOCK.format(name=f"k{i}", tick=0.9999 + 1e-9 * i) for i in range(2))
    found = drained("h: '-2*sqrt(max(h - 1, 0))', g: h", "clock >= 3", engine, ticks)
    # g' = 1 + (1 - t)^2 until t = 1, then 1.
    assert found.outputs["t"] == pytest.approx(3.0, abs=1e-9)
    assert found.outputs["g"] == pytest.approx(3.0 + 1 / 3, abs=1e-8)
    assert (np.diff([arc.end.high for arc in found.trace.arcs]) >= 0.0).all()


@pytest.mark.parametrize(
    ("flow", "time"), [("-1/h", 2.0), ("log(h) - 2", 0.0), ("-1/sqrt(h)", 2 / 3 * 2**1.5)]
)
def test_a_guard_on_whose_boundary_the_rates_end_fires_there(flow: str, time: float) -> None:
    # For log(h) - 2 the integral of 1/(2 - log(h)) from 0 to 2.
    time = time or quad(lambda h: 1 / (2 - math.log(h)), 0, 2, epsabs=1e-12)[0]
    found = drained(f"h: '{flow}'", "h <= 0", ("scipy", None))
    assert found.outputs["t"] == pytest.approx(time, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES, ids=str)
def test_two_tanks_exchange_all_water_between_their_levels(
    engine: tuple[str, str | None],
) -> None:
    flows = "h: '-c*sqrt(max(h - g, 0))', g: '2*c*sqrt(max(h - g, 0))'"
    found = drained(flows, "h <= g", engine)
    # d = h - g has d' = -3 c sqrt(d); h + g/2 stays.
    assert found.outputs["t"] == pytest.approx(2 * math.sqrt(2) / 2.1, abs=1e-9)
    assert found.outputs["h"] == pytest.approx(4 / 3, abs=1e-9)
    assert found.outputs["g"] == pytest.approx(4 / 3, abs=1e-9)


CYCLE = """\
kind: chart
name: cycle
variables: {h: 1}
regions:
  tank:
    initial: drains
    states: {drains: {flows: {h: -sqrt(h)}}, fills: {flows: {h: 0.5}}}
    transitions:
      - {name: dry, from: drains, to: fills, guard: h <= 0}
      - {name: full, from: fills, to: drains, guard: h >= 1}
stop: {time: 11}
outputs: {dry: {value: time, at: each tank.dry}, full: {value: time, at: each tank.full}}
"""
CASCADE = """\
kind: chart
name: cascade
variables: {a: 1, b: 1}
regions:
  first:
    initial: drains
    states:
      drains: {flows: {a: "-sqrt(max(a, 0))", b: "sqrt(max(a, 0)) - sqrt(max(b, 0))"}}
      empty: {}
    transitions: [{name: dry, from: drains, to: empty, guard: b <= 0}]
  second:
    initial: drains
    states: {drains: {}, empty: {}}
    transitions: [{name: dry, from: drains, to: empty, guard: a <= 0}]
stop: {time: 11}
outputs: {a: {value: time, at: first second.dry}, b: {value: time, at: first first.dry}}
"""
BRAKE = """\
kind: scene
name: brake
bodies: {b: {mass: 1, start: {dx: 1}}}
forces: {drag: {body: b, force: ["-2*sqrt(max(b.dx, 0))", 0]}}
regions:
  r:
    initial: runs
    states: {runs: {}, rests: {}}
    transitions: [{name: rest, from: runs, to: rests, guard: b.dx <= 0}]
stop: {time: 2}
outputs: {t: {value: time, at: first r.rest}, x: {value: b.x}}
"""


@pytest.mark.parametrize("engine", ENGINES, ids=str)
def test_tanks_in_a_cycle_and_in_a_row_and_a_brake_end_on_time(
    engine: tuple[str, str | None],
) -> None:
    name, method = engine
    options: dict[str, Any] = {} if method is None else {"method": method}
    cycle, cascade, brake = (
        run(read_text(text), engine=name, **options).outputs for text in (CYCLE, CASCADE, BRAKE)
    )
    assert cycle["dry"] == pytest.approx([2, 6, 10], abs=1e-9)
    assert cycle["full"] == pytest.approx([4, 8], abs=1e-9)
    # u = sqrt(a) = 1 - t/2 and v = sqrt(b) with v' = (u/v - 1)/2; from t = 2 on v' = -1/2.
    accuracy: dict[str, Any] = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15}
    rates = solve_ivp(lambda t, v: ((1 - t / 2) / v - 1) / 2, (0, 2), [1.0], **accuracy)
    assert cascade["a"] == pytest.approx(2, abs=1e-9)
    assert cascade["b"] == pytest.approx(2 + 2 * rates.y[0, -1], abs=1e-9)
    # sqrt(v) = 1 - t.
    assert brake == {"t": pytest.approx(1, abs=1e-9), "x": pytest.approx(1 / 3, abs=1e-9)}
