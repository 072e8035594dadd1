"""A table that stands on more legs than its motion determines the forces of."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs import ENGINES, outputs, run, simulator

from statechart.automaton.trace import Outcome
from statechart.observation.observer import Observer
from statechart.reporting.report import report

MODEL = "four_legged_table"
W, B, C, H = 98.1, 0.5, 0.2, 0.7
ARMS = np.array([-B, -C, C, B])
PINNED = ("pin",) * 4
NOTE = "the forces of A, B, C, D are indeterminate: the smallest are shown"

pytestmark = pytest.mark.parametrize("engine", ENGINES)


def test_at_rest_every_leg_bears_a_quarter_with_a_warning_of_indeterminacy(engine: str) -> None:
    trace = run(MODEL, engine)
    assert trace.outcome is Outcome.HORIZON
    assert trace.certified
    assert (trace.final == trace.initial).all()
    assert trace.modes == (PINNED,)
    assert NOTE in trace.warnings
    found = outputs(MODEL, engine, trace)
    assert [found[f"V_{leg}"] for leg in "ABCD"] == pytest.approx([W / 4] * 4, rel=1e-13)
    assert found["weight"] == pytest.approx(W, rel=1e-14)
    assert found["moment"] == pytest.approx(0.0, abs=1e-13)
    reported = report(Observer(simulator(MODEL, engine)), trace)["indeterminate"]
    assert reported == [{"mode": dict.fromkeys("ABCD", "pin"), "regions": list("ABCD")}]


@pytest.mark.parametrize("push", [-19.0, 5.0, 12.0])
def test_a_pushed_table_has_the_leg_forces_of_euler(engine: str, push: float) -> None:
    # Legs that give way alike: V is linear along the row; the moment of the push is what skews it.
    trace = run(MODEL, engine, push=push, until=1.0)
    assert (trace.final == trace.initial).all()
    found = outputs(MODEL, engine, trace)
    expected = W / 4 + push * H * ARMS / (ARMS**2).sum()
    assert [found[f"V_{leg}"] for leg in "ABCD"] == pytest.approx(expected, rel=1e-12)
    assert found["friction"] == pytest.approx(-push, rel=1e-13)


@pytest.mark.parametrize("growth", [20.0, -7.5])
def test_the_table_slips_when_the_push_exceeds_the_friction_of_all_legs(
    engine: str, growth: float
) -> None:
    # Some legs are on the edge of their cones long before.
    limit = 0.4 * W / abs(growth)
    trace = run(MODEL, engine, growth=growth, until=limit + 0.5)
    assert trace.modes == (PINNED, (("slide+" if growth > 0 else "slide-"),) * 4)
    (slip,) = trace.jumps
    assert slip.cause == "slip"
    assert slip.t == pytest.approx(limit, rel=1e-10)
    # From then on the force in excess of friction grows from zero.
    assert trace.final[0] == pytest.approx(growth / 10 * 0.5**3 / 6, rel=1e-9)
    flows = [arc.roles for arc in trace.arcs if arc.mode == PINNED]
    assert len(set(flows)) > 1
    for first, second in zip(trace.arcs, trace.arcs[1:], strict=False):
        assert second.start.high == pytest.approx(first.end.high, abs=1e-15)


def test_forces_stay_in_their_cones_and_are_continuous_while_legs_come_to_their_edges(
    engine: str,
) -> None:
    trace = run(MODEL, engine, growth=20.0, mu=0.9, until=3.4)
    assert trace.modes == (PINNED,)
    names = [f"{leg}.{force}" for leg in "ABCD" for force in "VH"]
    seen = Observer(simulator(MODEL, engine)).sample(trace, names)
    values = np.array([seen.columns[name] for name in names]).T
    V, along = values[:, ::2], values[:, 1::2]
    band = 2.0 * trace.tolerances["force"]
    assert V.min() > -band
    assert (0.9 * V - np.abs(along)).min() / math.hypot(1.0, 0.9) > -band
    assert V.sum(axis=1) == pytest.approx(W, rel=1e-12)
    assert along.sum(axis=1) == pytest.approx(-20.0 * seen.t, abs=1e-9)
    assert (V * ARMS).sum(axis=1) == pytest.approx(20.0 * seen.t * H, abs=1e-9)
    # In one arc after the other, other legs are on the edges of their cones.
    assert len(trace.arcs) > 3
    assert (np.abs(np.diff(values, axis=0)).max(axis=1) <= 200.0 * np.diff(seen.t) + 1e-8).all()


def test_a_table_on_a_rough_floor_tips_about_its_outer_leg(engine: str) -> None:
    # P h = W b: the whole weight on D.
    trace = run(MODEL, engine, growth=20.0, mu=0.9, until=3.6)
    assert trace.jumps[0].t == pytest.approx(W * B / (20.0 * H), rel=1e-10)
    assert trace.modes[1] == ("free", "free", "free", "pin")
    assert trace.final[2] < 0.0


def test_both_engines_slip_if_slipping_and_tipping_coincide(engine: str) -> None:
    trace = run(MODEL, engine, growth=20.0, mu=B / H, until=3.6)
    assert trace.modes == (PINNED, ("slide+",) * 4)
    assert trace.jumps[0].t == pytest.approx(W * B / (20.0 * H), rel=1e-10)


@pytest.mark.parametrize(("tilt", "mu"), [(0.5, 0.4), (0.3, 0.4)])
def test_a_table_on_a_slope_slides_beyond_the_angle_of_friction(
    engine: str, tilt: float, mu: float
) -> None:
    trace = run(MODEL, engine, tilt=tilt, mu=mu, until=1.0)
    moves = math.tan(tilt) > mu
    assert trace.modes == ((("slide-",) * 4,) if moves else (PINNED,))
    down = 9.81 * (math.sin(tilt) - mu * math.cos(tilt)) / 2.0 if moves else 0.0
    assert math.dist(trace.final[:2], trace.initial[:2]) == pytest.approx(down, abs=1e-12)
