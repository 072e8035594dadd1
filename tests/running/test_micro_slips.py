"""Accuracy of slips that are far smaller than the scales of their scene, against a closed form."""

from __future__ import annotations

import math

import pytest
from scipy.optimize import brentq

from statechart.running.runner import run

VALUES = {"F0": 4.2855, "omega": 4.83773, "mu": 0.251545, "m": 1.73354}


def slip_length() -> float:
    """Return the length of one slip, in which the force exceeds friction by 0.2 %.

    With s = time from its maximum and sin(omega t) = mu m g/F0 at s = -a,
    v = F0/(m omega) (sin(omega s) + sin(omega a) - omega (s + a) cos(omega a)) until v(b) = 0.
    """
    w, push = VALUES["omega"], VALUES["F0"] / VALUES["m"]
    a = math.acos(VALUES["mu"] * 9.81 / push) / w

    def speed(s: float) -> float:
        return math.sin(w * s) + math.sin(w * a) - w * (s + a) * math.cos(w * a)

    b = brentq(speed, 1.5 * a, 3.0 * a, xtol=1e-15)
    fall = math.cos(w * a) - math.cos(w * b)
    parabola = (w * (a + b)) ** 2 / 2.0 * math.cos(w * a)
    return push / w**2 * (fall + w * (a + b) * math.sin(w * a) - parabola)


@pytest.mark.parametrize("accuracy", [1e-3, 1e-5, 1e-6, 1e-7, 1e-8])
def test_the_error_of_slips_of_a_micrometre_is_estimated(accuracy: float) -> None:
    result = run("stick_slip_block", engine="scipy", accuracy=accuracy, parameters=VALUES)
    assert result.error_estimate is not None
    exact = slip_length()  # eleven slips, to and fro
    error = abs(result.outputs["x_end"] - exact) / exact
    # The estimate is a difference of two runs, the closed form loses 5 digits.
    assert error <= 2.0 * result.error_estimate + 1e-10
    assert error <= accuracy
    assert result.error_estimate <= accuracy


def test_a_slip_is_as_accurate_as_the_steps() -> None:
    result = run("stick_slip_block", engine="scipy", tolerance=1e-10, parameters=VALUES)
    assert result.outputs["x_end"] == pytest.approx(slip_length(), rel=1e-9)
