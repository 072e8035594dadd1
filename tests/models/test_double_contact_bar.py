"""A bar that falls on its two ends against reference numbers: sequences, times, impulses."""

from __future__ import annotations

import numpy as np
import pytest
from runs import ENGINES, golden, outputs, run

MODEL = "double_contact_bar"
CASES = golden(MODEL)["cases"]

pytestmark = pytest.mark.parametrize("engine", ENGINES)


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case['tilt_deg']:g}")
def test_the_fall_is_the_reference_one(engine: str, case: dict) -> None:
    trace = run(
        MODEL, engine, until=4.0, tilt_deg=case["tilt_deg"], mu=case["mu"],
        drop_height=case["drop_height_A"],
    )  # fmt: skip
    assert trace.certified
    expected = [tuple(mode.strip("()").split(",")) for mode in case["mode_sequence"]]
    named = [tuple("pin" if state == "stick" else state for state in mode) for mode in expected]
    assert list(trace.modes) == named
    found = outputs(MODEL, engine, trace)
    for name in ("t_A", "t_B", "omega_before_B", "xA_final"):
        assert found[name] == pytest.approx(float(case[name]), abs=1e-9), name

    hit_a, turn, hit_b = case["events"]
    first, reverse, last = trace.jumps
    assert [jump.t for jump in trace.jumps] == pytest.approx(
        [float(event["t"]) for event in case["events"]], abs=1e-9
    )
    # Impulses are (normal, tangential) here, (x, y) there.
    along, across = map(float, hit_a["impulse_A"])
    assert first.impulse["A"] == pytest.approx((across, along), abs=1e-9)
    assert -first.after[5] == pytest.approx(float(hit_a["omega_after"]), abs=1e-9)
    assert first.energy[0] - first.energy[1] == pytest.approx(float(hit_a["energy_lost"]), abs=1e-9)
    assert -reverse.after[5] == pytest.approx(float(turn["omega"]), abs=1e-9)
    assert last.impulse["A"][0] == pytest.approx(float(hit_b["impulse_A_y"]), abs=1e-9)
    assert last.impulse["B"][0] == pytest.approx(float(hit_b["impulse_B_y"]), abs=1e-9)
    assert last.before[3] == pytest.approx(float(hit_b["xdot_before"]), abs=1e-9)
    assert last.after[3:] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_a_bar_on_both_ends_rests_with_indeterminate_friction(engine: str) -> None:
    trace = run(MODEL, engine, until=4.0)
    assert trace.final_mode == ("pin", "pin")
    assert any("indeterminate" in warning for warning in trace.warnings)
    assert trace.final[[1, 2]] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_end_thrown_off_immediately_flies_from_its_impact(engine: str) -> None:
    # From high up the bar turns so fast after its plastic impact that A is lifted.
    trace = run(MODEL, engine, until=4.0, drop_height=2.0)
    down, again = trace.jumps[:2]
    assert (down.region, down.cause, down.target) == ("A", "touchdown", ("free", "free"))
    assert (again.region, again.cause) == ("A", "touchdown")
    assert down.t == pytest.approx(2.0, abs=1e-12)
    assert again.t > 2.1
    omega, angle = down.after[5], down.after[2]
    # Without force the end accelerates by what turning about the centre of mass gives it: upwards.
    assert omega**2 * np.sin(angle) > 1.0
