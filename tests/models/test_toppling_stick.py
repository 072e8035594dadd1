"""The toppling stick against reference numbers and closed forms (paper, section 4)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs import ENGINES, golden, modes, number, outputs, run
from scipy.integrate import quad
from scipy.optimize import brentq

MODEL = "toppling_stick"
CELLS = golden(MODEL)["cells"]
ANALYTIC = golden("toppling_stick_analytic")
NAMES = {
    "critical_angle": "critical_angle_rad",
    "slip_backward": "slip_backward",
    "slip_forward": "slip_forward",
    "omega_impact": "omega_impact",
    "t_impact": "t_impact",
}

pytestmark = pytest.mark.parametrize("engine", ENGINES)


def close(engine: str, cell: dict, mu: float, inertia: float, theta0: float) -> None:
    trace = run(MODEL, engine, mu=mu, I_G=inertia, theta0=theta0)
    assert trace.outcome.name == "STOPPED"
    assert trace.certified
    expected = ["pin" if m == "hinge" else m for m in cell["mode_sequence"][:-1]]
    assert modes(trace) == expected
    found = outputs(MODEL, engine, trace)
    for name, reference in NAMES.items():
        if cell[reference] is None:
            assert found[name] is None
        else:
            assert found[name] == pytest.approx(cell[reference], abs=1e-9, rel=0), name


@pytest.mark.parametrize("cell", CELLS, ids=lambda c: f"mu={c['mu']} I={c['I_G_str']}")
def test_outputs_and_modes_are_the_reference_ones(engine: str, cell: dict) -> None:
    close(engine, cell, number(cell["mu"]), number(cell["I_G_str"]), cell["theta0"])


@pytest.mark.parametrize("cell", ANALYTIC["initial_condition_variants"], ids=lambda c: c["phi0"])
def test_starts_of_equal_energy_agree(engine: str, cell: dict) -> None:
    close(engine, cell, cell["mu"], number(cell["I_G"]), cell["phi0"])


@pytest.mark.parametrize("case", ANALYTIC["infinite_friction"], ids=lambda c: f"I={c['I_G']}")
def test_a_stick_with_infinite_friction_matches_the_golden_outputs(engine: str, case: dict) -> None:
    trace = run(MODEL, engine, mu=math.inf, I_G=case["I_G"])
    found = outputs(MODEL, engine, trace)
    expected = ["pin", "slide+", "pin"] if case["stopped"] else ["pin", "slide+"]
    assert modes(trace) == expected
    assert found["critical_angle"] == pytest.approx(case["phi_c"], abs=1e-10)
    assert found["slip_forward"] == pytest.approx(case["slip_forward"], abs=1e-10)
    assert found["slip_backward"] == 0.0
    assert found["omega_impact"] == pytest.approx(case["omega_impact"], abs=1e-9)
    assert found["t_impact"] == pytest.approx(case["t_impact"], abs=1e-9)


def test_point_mass_at_infinite_friction_is_equations_11_and_19(engine: str) -> None:
    trace = run(MODEL, engine, mu=math.inf, I_G=0.0)
    found = outputs(MODEL, engine, trace)
    assert found["critical_angle"] == pytest.approx(math.acos(2 / 3), abs=1e-10)
    slip = 4 / 27 * math.sqrt(23) + 5 / 27 * math.sqrt(5) - 1
    assert found["slip_forward"] == pytest.approx(slip, abs=1e-10)
    assert trace.jumps[0].before[5] == pytest.approx(-math.sqrt(2 / 3), abs=1e-10)


@pytest.mark.parametrize("case", ANALYTIC["mu_zero"], ids=lambda c: f"I={c['I_G']}")
def test_a_frictionless_stick_matches_the_golden_outputs(engine: str, case: dict) -> None:
    trace = run(MODEL, engine, mu=0.0, I_G=case["I_G"])
    found = outputs(MODEL, engine, trace)
    assert modes(trace) == ["slide-", "slide+"]
    for name in ("slip_backward", "slip_forward", "omega_impact", "t_impact"):
        assert found[name] == pytest.approx(case[name], abs=1e-9), name
    energies = [_energy(state, case["I_G"]) for state in (trace.initial, trace.final)]
    assert energies[1] == pytest.approx(energies[0], abs=1e-12)
    # No horizontal force: the centre of mass keeps its horizontal velocity.
    assert trace.final[3] == pytest.approx(trace.initial[3], abs=1e-13)


def _energy(state: np.ndarray, inertia: float) -> float:
    return float(0.5 * (state[3] ** 2 + state[4] ** 2 + inertia * state[5] ** 2) + state[1])


@pytest.mark.parametrize("case", ANALYTIC["regime_boundaries"], ids=lambda c: f"I={c['I_G']}")
def test_the_direction_of_the_first_slip_changes_at_the_boundary(engine: str, case: dict) -> None:
    boundary = float(case["mu_backward_boundary_hp"])
    for factor, first in ((1 - 1e-6, "slide-"), (1 + 1e-6, "slide+")):
        trace = run(MODEL, engine, mu=boundary * factor, I_G=case["I_G"])
        assert modes(trace)[1] == first


@pytest.mark.parametrize("inertia", [0.4, 0.8])
def test_no_slip_above_a_critical_friction(engine: str, inertia: float) -> None:
    case = next(c for c in ANALYTIC["regime_boundaries"] if c["I_G"] == inertia)
    boundary = float(case["mu_no_slip_hp"])
    assert modes(run(MODEL, engine, mu=boundary * (1 + 1e-6), I_G=inertia)) == ["pin"]
    assert "slide+" in modes(run(MODEL, engine, mu=boundary * (1 - 1e-6), I_G=inertia))


@pytest.mark.parametrize(
    ("mu", "slip"), [(0.3, 0.0795123204), (0.5, 0.0921453921), (0.8, 0.0819263473)]
)
def test_the_net_slip_of_a_slender_rod_matches_the_paper(
    engine: str, mu: float, slip: float
) -> None:
    found = outputs(MODEL, engine, run(MODEL, engine, mu=mu))
    assert found["slip_forward"] - found["slip_backward"] == pytest.approx(slip, abs=1e-10)


def test_a_graze_at_one_third_is_no_slip(engine: str) -> None:
    trace = run(MODEL, engine, mu=math.inf, I_G=1 / 3)
    assert modes(trace) == ["pin"]
    assert outputs(MODEL, engine, trace)["critical_angle"] is None


@pytest.mark.parametrize("inertia", [0.34, 0.5, 1.0])
def test_long_sticks_never_slip_at_infinite_friction(engine: str, inertia: float) -> None:
    assert modes(run(MODEL, engine, mu=math.inf, I_G=inertia)) == ["pin"]


@pytest.mark.parametrize("mu", [1e6, 1e9, 1e300])
def test_huge_friction_agrees_with_infinite_within_its_reciprocal(engine: str, mu: float) -> None:
    near = outputs(MODEL, engine, run(MODEL, engine, mu=mu, I_G=0.1))
    limit = outputs(MODEL, engine, run(MODEL, engine, mu=math.inf, I_G=0.1))
    assert near["slip_forward"] == pytest.approx(limit["slip_forward"], abs=10 / mu + 1e-10)
    assert near["critical_angle"] == pytest.approx(limit["critical_angle"], abs=10 / mu + 1e-10)


@pytest.mark.parametrize("mu", [0.0, 1e-12])
def test_vanishing_friction_equals_none(engine: str, mu: float) -> None:
    trace = run(MODEL, engine, mu=mu)
    assert modes(trace) == ["slide-", "slide+"]
    none = run(MODEL, engine, mu=0.0)
    assert np.abs(trace.final - none.final).max() < 1e-11


@pytest.mark.parametrize("inertia", [1e-18, 1e-14, 1e-300])
def test_tiny_inertia_is_a_point_mass_with_a_warning(engine: str, inertia: float) -> None:
    tiny, none = (run(MODEL, engine, mu=0.5, I_G=i) for i in (inertia, 0.0))
    assert np.abs(tiny.final - none.final).max() < 1e-11
    assert any("point mass" in warning for warning in tiny.warnings)


@pytest.mark.parametrize("inertia", [1e6, 1e300])
def test_huge_inertia_hardly_moves(engine: str, inertia: float) -> None:
    trace = run(MODEL, engine, until=10.0, mu=0.5, I_G=inertia)
    assert trace.outcome.name == "HORIZON"
    assert np.isfinite(trace.final).all()


@pytest.mark.parametrize("mu", [0.2, 0.5, 2.0, math.inf])
def test_mirrored_start_mirrors_the_run(engine: str, mu: float) -> None:
    right = run(MODEL, engine, mu=mu, I_G=0.1)
    left = run(MODEL, engine, mu=mu, I_G=0.1, theta0=-0.01)
    flipped = {"slide+": "slide-", "slide-": "slide+"}
    assert modes(left) == [flipped.get(m, m) for m in modes(right)]
    signs = np.array([-1, 1, -1, -1, 1, -1])
    assert np.abs(left.final - signs * right.final).max() < 1e-12
    assert left.t_end == pytest.approx(right.t_end, abs=1e-12)


def test_upright_at_rest_stays_for_ever(engine: str) -> None:
    trace = run(MODEL, engine, until=1e3, theta0=0.0)
    assert modes(trace) == ["pin"]
    assert np.array_equal(trace.final, trace.initial)


def test_fall_time_grows_with_the_logarithm_of_the_offset(engine: str) -> None:
    trace = run(MODEL, engine, theta0=1e-16)
    # Equation 10's energy: t = sqrt((I + M L^2) / (M g L)) ln(tan(phi / 4) / tan(theta0 / 4)).
    phi = outputs(MODEL, engine, trace)["critical_angle"]
    expected = math.sqrt(4 / 3) * math.log(math.tan(phi / 4) / math.tan(0.25e-16))
    # One ulp of the stick's length is a hair too: the time is known to a part of an e-fold.
    assert trace.jumps[0].t == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize(("length", "time"), [(1e-9, 1e-9), (1e9, 1.0), (1.0, 1e6), (1e-3, 1e3)])
def test_other_units_give_the_same_run(engine: str, length: float, time: float) -> None:
    mass = 7.0
    unit = outputs(MODEL, engine, run(MODEL, engine))
    trace = run(
        MODEL, engine, until=1000.0 * time,
        M=mass, L=length, g=length / time**2, I_G=mass * length**2 / 3,
    )  # fmt: skip
    found = outputs(MODEL, engine, trace)
    factors = (1.0, length, length, 1 / time, time)
    for (name, value), factor in zip(unit.items(), factors, strict=True):
        assert found[name] == pytest.approx(value * factor, rel=1e-9), name


def _thrown(inertia: float) -> tuple[float, float, float]:
    """Return lean and rates, of it and of the centre, where mu = inf lets a short stick slip."""
    lean = math.acos((1.0 + math.sqrt(1.0 - 3.0 * inertia)) / 3.0)
    rate = math.sqrt(2.0 * (1.0 - math.cos(lean)) / (1.0 + inertia))
    return lean, rate, rate * math.cos(lean)


@pytest.mark.parametrize("inertia", [0.05, 0.06, 0.1])
def test_the_last_slip_ends_where_the_logarithm_of_its_force_says(
    engine: str, inertia: float
) -> None:
    # Without V the centre falls freely; H turns the stick with the arm cos(lean), and what turns
    # it less and less pushes more and more: the integral of H is a logarithm.
    start, rate, speed = _thrown(inertia)
    fall = (rate * math.sin(start)) ** 2

    def turning(lean: float) -> float:
        return math.sqrt(fall + 2.0 * (math.cos(start) - math.cos(lean))) / math.sin(lean)

    def slowing(log: float) -> float:
        """Return how the centre slows, per logarithm of the lean left."""
        left = math.exp(log)
        turn = turning(math.pi / 2 - left)
        return (
            inertia
            * (1.0 - turn**2 * math.sin(left))
            / (turn * math.cos(left))
            * (left / math.sin(left))
        )

    def slip(log: float) -> float:
        left = math.exp(log)
        lost = quad(slowing, log, math.log(math.pi / 2 - start), epsabs=1e-13, limit=200)[0]
        return speed - lost - turning(math.pi / 2 - left) * math.sin(left)

    trace = run(MODEL, engine, mu=math.inf, I_G=inertia)
    assert [jump.cause for jump in trace.jumps] == ["slip", "stick", "stop"]
    assert trace.warnings == ()
    left = math.pi / 2 + trace.jumps[1].after[2]
    expected = brentq(slip, math.log(0.1 * left), math.log(10.0 * left), xtol=1e-12)
    assert math.log(left) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("inertia", [0.02, 0.01, 0.003, 1e-6, 1e-9])
def test_slip_outlasting_the_fall_ends_with_unbounded_force(engine: str, inertia: float) -> None:
    # By the logarithm it ends at a lean that differs from pi/2 by less than rounding.
    start, rate, _ = _thrown(inertia)
    down = rate * math.sin(start)
    trace = run(MODEL, engine, mu=math.inf, I_G=inertia)
    assert [jump.cause for jump in trace.jumps] == ["slip", "jam", "stop"]
    assert trace.certified
    (warning,) = trace.warnings
    assert "the force of tip grows without bound: sliding of tip is" in warning
    slip, jam, stop = trace.jumps
    assert jam.before[2] == pytest.approx(-math.pi / 2, abs=1e-8)
    *_, angle, speed, _, spin = jam.after
    assert speed + math.cos(angle) * spin == pytest.approx(0.0, abs=1e-9)
    # The remaining slip depends logarithmically on round-off.
    assert speed < jam.before[3] - 1e-3
    # V = 0 from the slip on: the centre falls freely, the tip stays on the ground.
    expected = math.sqrt(down**2 + 2.0 * math.cos(start))
    assert stop.t - slip.t == pytest.approx(expected - down, abs=1e-9)
    found = outputs(MODEL, engine, trace)
    assert found["omega_impact"] == pytest.approx(expected, abs=1e-9)
