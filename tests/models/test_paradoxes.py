"""Rods whose contact laws are hard: Painleve's, against reference numbers, and McGeer's."""

from __future__ import annotations

import math

import pytest
from runs import ENGINES, golden, modes, number, outputs, run

from statechart.automaton.trace import Trace

PAINLEVE = golden("painleve")
ROD, PENCIL = "painleve_rod", "no_slip_pencil"

pytestmark = pytest.mark.parametrize("engine", ENGINES)


def jams(trace: Trace) -> bool:
    """Return whether a run begins with an impact without collision."""
    return bool(trace.jumps) and (trace.jumps[0].cause, trace.jumps[0].t) == ("jam", 0.0)


@pytest.mark.parametrize("case", PAINLEVE["sliding_table"], ids=lambda c: f"{c['phi_deg']:.0f}")
def test_a_sliding_rod_starts_in_the_reference_mode(engine: str, case: dict) -> None:
    trace = run(
        ROD, engine, until=0.0, phi=math.radians(case["phi_deg"]), omega=case["omega"],
        mu=case["mu"], I_G=case["I_G"], v=float(case["sigma"]),
    )  # fmt: skip
    assert trace.outcome.succeeded
    assert jams(trace) is (case["classification"] == "inconsistent")
    if jams(trace):
        return
    slide = "slide+" if case["sigma"] > 0 else "slide-"
    assert trace.start_mode == (slide if case["classification"] == "slide" else "free",)
    V = float(case["V_slide"]) if case["classification"] == "slide" else 0.0
    assert outputs(ROD, engine, trace)["V_start"] == pytest.approx(V, abs=1e-11)
    indeterminate = any("indeterminate" in warning for warning in trace.warnings)
    assert indeterminate is (case["classification"] == "indeterminate")


@pytest.mark.parametrize("case", PAINLEVE["zero_velocity_table"], ids=lambda c: f"{c['phi_deg']}")
def test_a_rod_at_rest_starts_in_the_reference_mode(engine: str, case: dict) -> None:
    trace = run(
        ROD, engine, until=0.0, phi=math.radians(case["phi_deg"]), omega=case["omega"],
        mu=case["mu"], I_G=number(case["I_G"]), v=0.0,
    )  # fmt: skip
    names = {"slip+": "slide+", "slip-": "slide-", "stick": "pin", "lift_off": "free"}
    (mode,) = case["consistent_modes"]
    assert trace.start_mode == (names[mode],)
    V = float(case["forces"][mode]["V"])
    assert outputs(ROD, engine, trace)["V_start"] == pytest.approx(V, abs=1e-11)


@pytest.mark.parametrize("case", PAINLEVE["mu_painleve"], ids=lambda c: c["I_G"])
def test_the_paradox_begins_at_the_critical_friction(engine: str, case: dict) -> None:
    phi = math.atan(float(case["tan_phi"]))
    for factor, consistent in ((1 - 1e-9, True), (1 + 1e-9, False)):
        trace = run(
            ROD, engine, until=0.0, phi=phi, omega=0.0, v=-1.0,
            mu=factor * float(case["mu_P"]), I_G=float(case["I_G"]),
        )  # fmt: skip
        assert jams(trace) is not consistent
        assert not consistent or trace.start_mode == ("slide-",)


@pytest.mark.parametrize("case", PAINLEVE["slender_rod_p_negative_interval"], ids=lambda c: c["mu"])
def test_the_paradox_has_its_interval_of_leans(engine: str, case: dict) -> None:
    low, high = float(case["phi_lo_deg"]), float(case["phi_hi_deg"])
    edges = ((low, -1, True), (low, 1, False), (high, -1, False), (high, 1, True))
    for lean, way, consistent in edges:
        phi = math.radians(lean + way * 1e-8)
        trace = run(ROD, engine, until=0.0, phi=phi, omega=0.0, v=-1.0, mu=float(case["mu"]))
        assert jams(trace) is not consistent, lean


@pytest.mark.parametrize("inertia", [1e-6, 0.01, 0.1, 0.3])
def test_without_slip_a_short_pencil_would_go_through_the_ground(
    engine: str, inertia: float
) -> None:
    trace = run(PENCIL, engine, I_G=inertia)
    assert trace.outcome.name == "NO_CONSISTENT_MODE"
    assert modes(trace) == ["pin"]
    assert "tip:free fails, it would accelerate at" in trace.message
    assert "into the surface; tip:pin fails, V = " in trace.message
    # The normal force of a stick pinned at its tip, with equation 10, vanishes here (section 4.7).
    lean = math.acos((1.0 + math.sqrt(1.0 - 3.0 * inertia)) / 3.0)
    assert outputs(PENCIL, engine, trace)["lean_end"] == pytest.approx(lean, abs=1e-10)


@pytest.mark.parametrize("inertia", [1 / 3, 0.4, 1.0])
def test_without_slip_a_long_pencil_topples_to_the_end(engine: str, inertia: float) -> None:
    trace = run(PENCIL, engine, I_G=inertia)
    assert trace.outcome.name == "STOPPED"
    assert modes(trace) == ["pin"]
    assert outputs(PENCIL, engine, trace)["lean_end"] == pytest.approx(math.pi / 2, abs=1e-12)
