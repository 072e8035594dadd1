"""The gripper beside an integration of its own until it grips, and its rest in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from statechart.arrays import Array
from statechart.running.runner import Runner


def _open(t: float, q: Array) -> Array:
    """Return the rates of z, phi and their rates by Lagrange's equations, before the pads touch."""
    _, phi, dz, dphi = q
    mass, length = 0.2, 0.2
    s, c = math.sin(phi), math.cos(phi)
    lift = 400 * (0.36 - q[0]) - 60 * dz + 1.4 * 9.81
    matrix = [[1 + 2 * mass, 2 * mass * length * s], [2 * mass * length * s, 2 * mass * length**2]]
    forces = [
        lift - 1.4 * 9.81 - 2 * mass * length * c * dphi**2,
        -2 * 20 * length * c - 2 * mass * 9.81 * length * s,
    ]
    return np.array([dz, dphi, *np.linalg.solve(matrix, forces)])


def test_the_pads_meet_the_box_where_the_cranks_take_them() -> None:
    def touches(t: float, q: Array) -> float:
        return float(0.2 * math.sin(q[1]) - 0.03)

    touches.terminal = True  # type: ignore[attr-defined]
    start = [0.36, 0.35, 0.0, 0.0]
    exact = solve_ivp(_open, (0, 1), start, events=touches, rtol=1e-11, atol=1e-12).t[-1]
    for h in (1e-3, 2.5e-4):
        outputs = Runner("four_bar_gripper", step=h).run(until=0.1).outputs
        assert outputs["grips"] == pytest.approx(exact, abs=h)


@pytest.mark.parametrize(("squeeze", "m"), [(20, 0.5), (15, 0.2), (30, 0.8)])
def test_the_lift_bears_the_box_in_the_end(squeeze: float, m: float) -> None:
    result = Runner("four_bar_gripper").run({"squeeze": squeeze, "m": m}, until=5.0)
    trace = result.trace
    found = dict(zip(trace.variables, trace.final.tolist(), strict=True))
    assert dict(zip(trace.regions, trace.final_mode, strict=True))["box"] == "pin"
    assert found["z"] == pytest.approx(0.56 - m * 9.81 / 400, abs=1e-5)
    assert found["box.y"] > 0.25
    # Nothing slips between the pads and the box.
    risen = found["box.y"] - 0.1
    pads = found["z"] - 0.2 * math.cos(found["phi"])
    at_grip = [jump for jump in trace.jumps if jump.region == "box"][-1].after
    height = at_grip[trace.variables.index("z")] - 0.2 * math.cos(found["phi"])
    assert pads - height == pytest.approx(risen, abs=2e-3)
