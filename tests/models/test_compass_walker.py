"""The compass walker against reference numbers (Goswami, Thuilot, Espiau 1998)."""

from __future__ import annotations

import numpy as np
import pytest
from runs import ENGINES, golden, outputs, run

MODEL = "compass_walker"
(GAIT,) = golden("compass_gait")["gaits"]
START = {name: float(GAIT[name]) for name in ("theta_ns", "theta_s", "dtheta_ns", "dtheta_s")}
PERIOD = float(GAIT["step_period"])

pytestmark = pytest.mark.parametrize("engine", ENGINES)


def test_every_step_from_the_fixed_point_is_the_reference_one(engine: str) -> None:
    trace = run(MODEL, engine, until=4.5 * PERIOD, **START)
    assert trace.certified
    found = outputs(MODEL, engine, trace)
    assert np.diff([0.0, *found["strike_times"]]) == pytest.approx([PERIOD] * 4, abs=1e-9)
    before = dict(
        zip(
            ("theta_ns", "theta_s", "dtheta_ns", "dtheta_s"),
            map(float, GAIT["pre_impact_state_ns_s_dns_ds"]),
            strict=True,
        )
    )
    for name, value in START.items():
        assert found[f"{name}_plus"] == pytest.approx([value] * 4, abs=1e-9)
        assert found[f"{name}_minus"] == pytest.approx([before[name]] * 4, abs=1e-9)


def test_a_strike_pins_the_swing_foot_and_frees_the_other(engine: str) -> None:
    trace = run(MODEL, engine, until=1.5 * PERIOD, **START)
    assert trace.start_mode == ("pin", "off")
    causes = [(jump.region, jump.cause, jump.target) for jump in trace.jumps[:3]]
    assert causes == [
        ("foot_two", "enable", ("pin", "free")),
        ("foot_two", "touchdown", ("free", "pin")),
        ("foot_one", "disable", ("off", "pin")),
    ]
    strike = trace.jumps[1]
    normal, along = strike.impulse["foot_two"]
    assert set(strike.impulse) == {"foot_two"}
    # The reference has the impulse along the world's axes.
    c, s = np.cos(float(GAIT["gamma_rad"])), np.sin(float(GAIT["gamma_rad"]))
    world = (along * c + normal * s, normal * c - along * s)
    assert world == pytest.approx([float(x) for x in GAIT["impulse_xy"]], abs=1e-9)
    # The foot that stood leaves as the reference says.
    one, dx, dy, done = strike.after[[2, 4, 5, 6]]
    velocity = (dx + np.cos(one) * done, dy + np.sin(one) * done)
    expected = [float(v) for v in GAIT["old_stance_foot_velocity_after"]]
    assert velocity == pytest.approx(expected, abs=1e-9)


def test_perturbation_decays(engine: str) -> None:
    pushed = {**START, "dtheta_s": START["dtheta_s"] + 1e-3}
    found = outputs(MODEL, engine, run(MODEL, engine, until=12 * PERIOD, **pushed))
    off = np.abs(np.array(found["dtheta_s_plus"]) - START["dtheta_s"])
    assert len(off) >= 11
    # Eigenvalues below 0.58 in size: the deviation decays as 0.58^11 in eleven steps.
    assert off[10] < 10.0 * 1e-3 * float(GAIT["max_abs_eig"]) ** 11
