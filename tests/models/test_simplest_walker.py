"""The simplest walker against reference numbers (Garcia et al. 1998)."""

from __future__ import annotations

import numpy as np
import pytest
from runs import ENGINES, golden, outputs, run

MODEL = "simplest_walker"
(LONG,) = golden(MODEL)["gaits"]
FIXED = float(LONG["theta_star"]), float(LONG["thetadot_star"])
PERIOD = float(LONG["step_period"])

pytestmark = pytest.mark.parametrize("engine", ENGINES)


def step(engine: str, theta: float, thetadot: float) -> tuple[float, float]:
    """Return the state after one step."""
    trace = run(MODEL, engine, until=5.0, theta=theta, thetadot=thetadot)
    after = next(jump.after for jump in trace.jumps if jump.cause == "heel_strike")
    return float(after[0]), float(after[2])


def test_every_step_from_the_fixed_point_is_the_reference_one(engine: str) -> None:
    trace = run(MODEL, engine, until=20.0)
    assert trace.certified
    assert [jump.cause for jump in trace.jumps] == ["scuff", "heel_strike"] * 5
    found = outputs(MODEL, engine, trace)
    assert np.diff([0.0, *found["strike_times"]]) == pytest.approx(PERIOD, abs=1e-9)
    assert found["theta_plus"] == pytest.approx([FIXED[0]] * 5, abs=1e-9)
    assert found["thetadot_plus"] == pytest.approx([FIXED[1]] * 5, abs=1e-9)
    strikes = [jump for jump in trace.jumps if jump.cause == "heel_strike"]
    before = [float(x) for x in LONG["state_before_heelstrike"]]
    assert strikes[0].before == pytest.approx(before, abs=1e-9)
    assert strikes[0].after[1] == pytest.approx(float(LONG["phi_star"]), abs=1e-9)
    assert strikes[0].after[3] == pytest.approx(float(LONG["phidot_star"]), abs=1e-9)


def test_eigenvalues_of_a_step_are_the_reference_ones(engine: str) -> None:
    h = 5e-5
    jacobian = np.zeros((2, 2))
    for i, (a, b) in enumerate(((h, 0.0), (0.0, h))):
        for n, weight in enumerate((45, -9, 1), start=1):  # central differences of order six
            ahead = step(engine, FIXED[0] + n * a, FIXED[1] + n * b)
            behind = step(engine, FIXED[0] - n * a, FIXED[1] - n * b)
            jacobian[:, i] += weight / (60.0 * h) * np.subtract(ahead, behind)
    found = sorted(np.linalg.eigvals(jacobian), key=lambda x: x.imag)
    expected = [complex(float(a), float(b)) for a, b in LONG["eigenvalues"]]
    # Differences of runs at a tolerance of 1e-12 are not good for more.
    assert found == pytest.approx(expected, abs=1e-10 if engine == "taylor" else 2e-9)


def test_perturbation_decays_by_the_eigenvalues(engine: str) -> None:
    trace = run(MODEL, engine, until=80.0, theta=FIXED[0] + 1e-4, thetadot=FIXED[1] + 1e-4)
    found = outputs(MODEL, engine, trace)
    last = found["theta_plus"][-1], found["thetadot_plus"][-1]
    steps = len(found["theta_plus"])
    assert steps == 20
    bound = 10.0 * 1e-4 * float(LONG["max_abs_eig"]) ** steps
    assert last == pytest.approx(FIXED, abs=bound + 1e-12)


def test_a_walker_that_starts_too_slowly_falls_backward(engine: str) -> None:
    trace = run(MODEL, engine, thetadot=-0.15)
    assert trace.outcome.name == "STOPPED"
    assert trace.jumps[-1].fired == ("fallen backward",)
