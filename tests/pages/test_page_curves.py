"""Sample points of the curves on a run's page."""

from __future__ import annotations

import base64

import numpy as np

from statechart.pages.page import _panels, _sample_rows
from statechart.reporting.curves import COLUMNS, curves
from statechart.running.runner import Runner


def numbers(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4")


def test_curves_reach_the_instants_at_which_they_jump() -> None:
    result = Runner("bouncing_ball").run()
    samples, _ = curves(result.observer, result.trace)
    rows = _sample_rows(samples, result.trace.t_end)
    assert len(rows) < 0.75 * len(samples.t)
    assert (np.diff(rows) > 0).all()
    height = samples.columns["height"][rows]
    last = np.flatnonzero(np.diff(samples.j[rows]))
    assert len(last) == len(result.trace.jumps)
    # Before each bounce the ball is on the ground.
    assert np.abs(height[last]).max() < 1e-9


def test_curves_of_many_jumps_have_few_points() -> None:
    result = Runner("bouncing_ball").run({"k": 0.99999}, until=9000.0)
    assert len(result.trace.jumps) > 9000
    samples, panels = curves(result.observer, result.trace)
    made = _panels(result.trace, samples, panels)
    for panel in made[:2]:
        t, (curve,) = numbers(panel["t"]), map(numbers, panel["curves"])
        assert len(t) == len(curve) < 3 * COLUMNS
        # Points beside each other make a line: between any two breaks there are two at least.
        assert (np.diff(np.flatnonzero(np.isnan(t))) > 2).all()
        column = samples.columns[panel["names"][0]]
        assert np.nanmax(curve) == np.float32(column.max())
        assert np.nanmin(curve) == np.float32(column.min())


def test_a_long_flow_has_as_many_points_for_its_length_as_short_ones() -> None:
    result = Runner("bouncing_ball").run()
    samples, _ = curves(result.observer, result.trace)
    rows = _sample_rows(samples, 8.77)
    first = rows[samples.j[rows] == 0]
    assert len(first) == np.count_nonzero(samples.j == 0)
