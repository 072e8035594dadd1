"""Forces, paths and controls that change in a fraction of a step are seen by every integrator."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from strategies import examples

from statechart import Outcome, Runner, run
from statechart.documents.yaml_reader import read_text

FALL = """\
kind: scene
name: thrust
parameters: {{w: 0.1, t0: 2, F: 10}}
gravity: 9.81
bodies: {{b: {{mass: 1, start: {{y: 100, dx: 3}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts: {{c: {{point: {{body: b}}, surface: floor, friction: 0.3, restitution: 0.5}}}}
{push}
stop: {{time: 4}}
outputs: {{vy: {{value: b.dy}}}}
"""
FORCE = "forces: {{burn: {{body: b, force: [0, 'F*{shape}']}}}}"
CONTROL = (
    "controls: {{lift: 0}}\n"
    "regions: {{r: {{initial: s, states: {{s: {{sets: {{lift: 'F*{shape}'}}}}}}}}}}\n"
    "forces: {{burn: {{body: b, force: [0, lift]}}}}"
)
# Rate, and its integral from 0 to 4.
SHAPES: dict[str, Callable[[float, float], float]] = {
    "(1+tanh((time-t0)/w))/2": lambda t0, w: (
        4.0
        - t0
        + 0.5
        * w
        * (math.log1p(math.exp(2.0 * (t0 - 4.0) / w)) - math.log1p(math.exp(-2.0 * t0 / w)))
    ),
    "exp(-((time-t0)/w)**2)": lambda t0, w: (
        0.5 * w * math.sqrt(math.pi) * (math.erf((4.0 - t0) / w) + math.erf(t0 / w))
    ),
    "1/(1+((time-t0)/w)**2)": lambda t0, w: w * (math.atan((4.0 - t0) / w) + math.atan(t0 / w)),
}
CHOICES: list[tuple[dict[str, object], float]] = [
    ({"engine": "taylor"}, 1e-11),
    ({"engine": "scipy", "method": "DOP853", "tolerance": 1e-8}, 1e-6),
    ({"engine": "scipy", "method": "RK45", "tolerance": 1e-6}, 1e-4),
    ({"engine": "scipy", "method": "Radau", "tolerance": 1e-6}, 1e-4),
    ({"engine": "scipy", "method": "LSODA", "tolerance": 1e-6}, 1e-4),
]


@pytest.mark.parametrize(("choice", "near"), CHOICES)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("push", [FORCE, CONTROL], ids=["force", "control"])
def test_narrow_force_is_detected(
    push: str, shape: str, choice: dict[str, object], near: float
) -> None:
    runner = Runner(read_text(FALL.format(push=push.format(shape=shape))), **choice)  # type: ignore[arg-type]
    for w in (0.1, 1e-2, 1e-4):
        for t0 in (2.0, 3.1234):
            # The switch is too far from both ends of the run for the tails of tanh to count.
            exact = -39.24 + 10.0 * SHAPES[shape](t0, w)
            assert runner.run({"w": w, "t0": t0}).outputs["vy"] == pytest.approx(
                exact, abs=40.0 * near
            )


@examples(30)
@given(
    shape=st.sampled_from(sorted(SHAPES)),
    power=st.floats(-4.0, -1.0),
    t0=st.floats(1.0, 3.0),
    push=st.floats(-30.0, 30.0),
)
def test_the_error_estimate_includes_narrow_features(
    shape: str, power: float, t0: float, push: float
) -> None:
    w = 10.0**power
    text = FALL.format(push=FORCE.format(shape=shape)).replace("y: 100", "y: 1000")
    found = run(
        read_text(text),
        parameters={"w": w, "t0": t0, "F": push},
        engine="scipy",
        method="DOP853",
        accuracy=1e-6,
    )
    assert found.error_estimate is not None
    assert found.error_estimate <= 1e-6
    exact = -39.24 + push * SHAPES[shape](t0, w)
    assert found.outputs["vy"] == pytest.approx(exact, abs=40.0 * 1e-6)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("w", [1e-1, 1e-3])
def test_a_local_gust_is_not_missed(engine: str, w: float) -> None:
    # Work done is the integral of force over way, whatever the time it takes.
    push = FORCE.format(shape="0*time").replace("[0, 'F*0*time']", "['F/(1+((b.x-4)/w)**2)', 0]")
    text = FALL.format(push=push).replace("value: b.dy", "value: b.dx**2/2")
    found = run(read_text(text + "  \n"), parameters={"w": w}, engine=engine)
    x = found.trace.final[0]
    work = 10.0 * w * (math.atan((x - 4.0) / w) + math.atan(4.0 / w))
    assert found.outputs["vy"] == pytest.approx(4.5 + work, rel=1e-8)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_jerking_pivot_transfers_angular_momentum(engine: str) -> None:
    # With the pivot's speed u, 1.5 angle' + u cos(angle) changes by -u angle' sin(angle).
    text = """
kind: scene
name: jerk
parameters: {w: 1e-3}
gravity: 0
bodies: {b: {mass: 1, inertia: 0.5, start: {x: 0, y: -1}}}
joints: {j: {point: {body: b, at: [0, 1]}, to: ['0.01*(1+tanh((time-2)/w))/2', 0]}}
stop: {time: 4}
outputs: {turned: {value: b.angle}, rate: {value: b.dangle}}
"""

    def rates(t: float, z: list[float]) -> list[float]:
        speed = 5.0 / math.cosh(min(abs(t - 2.0) / 1e-3, 300.0)) ** 2
        rate = (z[1] - speed * math.cos(z[0])) / 1.5
        return [rate, -speed * rate * math.sin(z[0])]

    exact = solve_ivp(rates, (1.97, 2.03), [0.0, 0.0], "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    found = run(read_text(text), engine=engine)
    assert found.outputs["rate"] == pytest.approx(exact[1] / 1.5, rel=1e-6)
    assert found.outputs["turned"] == pytest.approx(exact[0] + 1.97 * exact[1] / 1.5, rel=1e-6)


def test_rate_leaving_its_domain_ends_the_run_with_a_message() -> None:
    text = FALL.format(push="forces: {f: {body: b, force: [-5*sqrt(b.x), 0]}}")
    found = run(read_text(text), engine="scipy", throw=False).trace
    assert found.outcome is Outcome.STEP_FAILURE
    # Time of return to x = 0, by quadrature of dx / sqrt(9 - 20/3 x**1.5); beyond it is no root.
    assert found.t_end == pytest.approx(1.4044991527, rel=1e-9)
    assert found.final[0] == pytest.approx(0.0, abs=1e-12)


def test_overflowing_exponential_acts_as_a_switch() -> None:
    # exp(-(time-t0)/w) is a product whose one factor is beyond all floats.
    text = FALL.format(push="forces: {f: {body: b, force: [0, '10/(1+exp(-(time-2)/1e-3))']}}")
    for engine in ("taylor", "scipy"):
        assert run(read_text(text), engine=engine).outputs["vy"] == pytest.approx(-19.24, rel=1e-8)


def test_pulse_with_overflowing_series_uses_scipy() -> None:
    text = FALL.format(push="forces: {f: {body: b, force: [0, '10/cosh((time-2)/1e-4)']}}")
    found = run(read_text(text))
    assert found.trace.engine.startswith("scipy")
    assert any("series of the rates overflows" in warning for warning in found.warnings)
    assert found.outputs["vy"] == pytest.approx(-39.24 + 10.0 * 1e-4 * math.pi, abs=1e-7)


def test_a_path_by_exponentials_has_its_acceleration() -> None:
    # Written as it stands its second derivative is a quotient of two infinities.
    text = """
kind: scene
name: shift
gravity: 0
bodies: {b: {mass: 1, start: {x: 0, y: 0}}}
joints: {j: {point: {body: b}, to: ['1/(1+exp(-(time-2)/1e-3)) + 0.1/cosh((time-3)/1e-3)', 0]}}
stop: {time: 3}
outputs: {x: {value: b.x}}
"""
    assert run(read_text(text)).outputs["x"] == pytest.approx(1.1, rel=1e-9)


@pytest.mark.parametrize(
    ("method", "tolerance", "parameters"),
    [
        (
            "LSODA",
            1e-3,
            {
                "A": 0.388,
                "k": 1.784,
                "phase": 4.147,
                "y0": 1.821,
                "vx0": 2.04,
                "vy0": -0.49,
                "e": 0.217,
            },
        ),
        (
            "DOP853",
            0.1,
            {
                "A": 0.7579440998422889,
                "k": 14.745975671628784,
                "phase": 3.864576140227966,
                "y0": 1.5821718366013298,
                "vx0": 7.27,
                "vy0": -1.22,
                "e": 0.332,
            },
        ),
    ],
)
def test_a_ball_that_slides_over_hills_at_a_loose_tolerance_arrives(
    method: str, tolerance: float, parameters: dict[str, float]
) -> None:
    # It is off the ground by less than the tolerance of gaps: no step was blind to that.
    found = run(
        "bouncing_ball_hills", engine="scipy", method=method, tolerance=tolerance,
        parameters=parameters,
    )  # fmt: skip
    assert found.trace.outcome is Outcome.HORIZON
    assert found.trace.counts["steps"] < 2000
