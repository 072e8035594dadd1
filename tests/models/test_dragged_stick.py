"""A dragged stick against reference numbers (paper, equations 6 and 7; figure 4)."""

from __future__ import annotations

import math
from typing import Any

import pytest
from runs import ENGINES, golden, outputs, run

MODEL = "dragged_stick"
GOLDEN = golden(MODEL)
# Place of the pull, as the parameter `pull`.
FORMS = {"seed_eq6": 0.0, "uniform_end_pulled": 1.0}

pytestmark = [
    pytest.mark.parametrize("engine", ENGINES),
    pytest.mark.parametrize("form", FORMS),
]


def forces(engine: str, form: str, degrees: float, mu: float) -> dict[str, Any]:
    trace = run(MODEL, engine, 1.0, theta=math.radians(degrees), mu=mu, pull=FORMS[form])
    assert trace.outcome.succeeded
    assert trace.modes == (("slide+",),)
    return outputs(MODEL, engine, trace)


def test_forces_are_the_reference_ones(engine: str, form: str) -> None:
    for row in GOLDEN["table"]:
        found = forces(engine, form, row["theta_deg"], row["mu"])
        assert found["H"] == pytest.approx(float(row[f"H_{form}"]), abs=1e-11)
        name = "N_from_seed_eq6" if form == "seed_eq6" else f"N_{form}"
        assert found["N"] == pytest.approx(float(row[name]), abs=1e-11)
        assert found["N"] + found["P"] == pytest.approx(1.0, abs=1e-11)


def test_infinite_friction_is_not_no_slip(engine: str, form: str) -> None:
    name = "H_limit_seed_eq7" if form == "seed_eq6" else f"H_limit_{form}"
    for row in GOLDEN["limits"]:
        found = forces(engine, form, row["theta_deg"], math.inf)
        assert found["H"] == pytest.approx(float(row[name]), abs=1e-11)
        assert found["N"] == pytest.approx(0.0, abs=1e-11)
