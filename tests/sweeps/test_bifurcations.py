"""Bifurcation diagrams against the literature."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from statechart import sweep

PLATE = str(Path(__file__).parents[2] / "docs" / "models" / "ball_on_a_plate.yaml")


def periods(values: np.ndarray) -> int:
    """Return after how many values a list repeats itself."""
    return next(
        (n for n in (1, 2, 4, 8) if np.allclose(values[n:], values[:-n], rtol=0.0, atol=1e-5)), 0
    )


def test_periods_of_a_ball_on_a_plate_double_where_theory_says() -> None:
    e = 0.5
    # One bounce a period exists above, and is stable below (Holmes 1982).
    least = math.pi * (1.0 - e) / (1.0 + e)
    greatest = math.hypot(least, 2.0 * (1.0 + e**2) / (1.0 + e) ** 2)
    accelerations = [1.15, 1.3, greatest - 0.02, greatest + 0.02, 1.6, 1.695]
    found = sweep(PLATE, {"acceleration": accelerations, "e": [e]}, until=300.0)
    assert found["certified"].all()
    speeds = found["speed"].to_numpy()[:, 0]
    assert [periods(row) for row in speeds] == [1, 1, 1, 2, 2, 4]
    # Then the ball leaves at the speed that carries it through a period.
    np.testing.assert_allclose(speeds[:2], 0.5, rtol=1e-9)


def test_gaits_of_the_simplest_walker_double_where_garcia_found_it() -> None:
    slopes = [0.009, 0.013, 0.0148, 0.0154, 0.017, 0.0178]
    found = sweep("simplest_walker", {"gamma": slopes}, until=2000.0, outputs=["gait"])
    gaits = found["gait"].to_numpy()
    # Garcia et al. (1998): one step a period up to a slope of 0.015, then two, four.
    assert [periods(row) for row in gaits] == [1, 1, 1, 2, 2, 4]
