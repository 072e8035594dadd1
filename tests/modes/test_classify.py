"""Mode selection against tables for Painleve's rod and contact mass matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs import automaton, golden, number

from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot
from contacts.event_driven.laws import SceneLaws
from contacts.modes.candidates import Case, candidates
from contacts.modes.classification import choose
from statechart.errors import NoConsistentMode

PAINLEVE = golden("painleve")
NAMES = {"slip+": "slide+", "slip-": "slide-", "stick": "pin", "lift_off": "free"}


def rod(phi: float, omega: float, speed: float, mu: float, inertia: float) -> tuple:
    """Return the stick's snapshot and numbers where it leans by phi, its tip moving at speed."""
    built = automaton("toppling_stick")
    laws = built.laws
    assert isinstance(laws, SceneLaws)
    setup = built.setup({"mu": mu, "I_G": inertia}, 2.2e-16)
    assert isinstance(setup, SceneSetup)
    s, c = math.sin(phi), math.cos(phi)
    # The lean is clockwise, the body's angle counter-clockwise.
    state = np.array([s, c, -phi, speed + c * omega, -s * omega, -omega])
    return laws.tape.at(setup.values, state, 0.0), setup


def consistent(snapshot: Snapshot, setup: SceneSetup, options: tuple, still: bool) -> dict:
    tried = candidates(Case(snapshot, setup.contacts, [True], [still], setup.scales), [options])
    return {c.states[0]: c for c in tried if c.violation <= 0.0}


@pytest.mark.parametrize("case", PAINLEVE["zero_velocity_table"], ids=lambda c: f"{c['phi_deg']}")
def test_at_rest_exactly_the_reference_modes_are_consistent(case: dict) -> None:
    snapshot, setup = rod(
        math.radians(case["phi_deg"]), case["omega"], 0.0, case["mu"], number(case["I_G"])
    )
    found = consistent(snapshot, setup, ("free", "slide+", "slide-", "pin"), True)
    assert set(found) == {NAMES[mode] for mode in case["consistent_modes"]}
    for mode, forces in case["forces"].items():
        V, H = found[NAMES[mode]].forces[0]
        assert pytest.approx(float(forces["V"]), abs=1e-12) == V
        assert pytest.approx(float(forces["H"]), abs=1e-12) == H


@pytest.mark.parametrize("case", PAINLEVE["sliding_table"], ids=lambda c: f"{c['phi_deg']:.0f}")
def test_sliding_exactly_the_reference_modes_are_consistent(case: dict) -> None:
    sigma = case["sigma"]
    snapshot, setup = rod(
        math.radians(case["phi_deg"]), case["omega"], float(sigma), case["mu"], case["I_G"]
    )
    slide = "slide+" if sigma > 0 else "slide-"
    found = consistent(snapshot, setup, ("free", slide), False)
    names = {"slide": slide, "lift_off": "free"}
    assert set(found) == {names[mode] for mode in case["consistent"]}
    (tried,) = candidates(Case(snapshot, setup.contacts, [True], [False], setup.scales), [(slide,)])
    assert not tried.undetermined
    assert tried.forces[0, 0] == pytest.approx(float(case["V_slide"]), rel=1e-9)
    if case["classification"] == "inconsistent":
        with pytest.raises(NoConsistentMode, match="tip:free"):
            choose(setup, snapshot, [True])
    else:
        choice = choose(setup, snapshot, [True])
        indeterminate = case["classification"] == "indeterminate"
        assert ("indeterminate" in choice.warning) is indeterminate
        expected = "free" if indeterminate else names[case["consistent"][0]]
        assert choice.taken.states == (expected,)
        assert choice.considered[f"tip:{expected}"] == "taken"


@pytest.mark.parametrize("case", golden("contact_mass_matrix")["table"])
def test_the_contact_mass_matrix_matches_the_reference(case: dict) -> None:
    snapshot, _ = rod(math.radians(case["phi_deg"]), 0.0, 0.0, 0.3, number(case["I_G"]))
    normal, tangential = snapshot.jacobians[0]
    rows = np.array([tangential, normal])
    found = rows @ np.linalg.solve(snapshot.mass, rows.T)
    assert found == pytest.approx(np.array(case["W"], dtype=float), abs=1e-11)
