"""Which points of a run the curves of its page are drawn by."""

from __future__ import annotations

import numpy as np

from statechart.pages.content import _POINTS, _rows
from statechart.reporting.curves import curves
from statechart.running.runner import Runner


def test_curves_reach_the_instants_at_which_they_jump() -> None:
    result = Runner("bouncing_ball").run()
    samples, _ = curves(result.observer, result.trace)
    rows = _rows(samples, result.trace.t_end)
    assert len(rows) < 0.75 * len(samples.t)
    assert (np.diff(rows) > 0).all()
    height = samples.columns["height"][rows]
    last = np.flatnonzero(np.diff(samples.j[rows]))
    assert len(last) == len(result.trace.jumps)
    # Before each bounce the ball is on the ground.
    assert np.abs(height[last]).max() < 1e-9


def test_of_very_many_jumps_points_are_few_all_the_same() -> None:
    result = Runner("bouncing_ball").run({"k": 0.9999}, until=2000.0)
    assert len(result.trace.jumps) > _POINTS
    samples, _ = curves(result.observer, result.trace)
    assert len(_rows(samples, result.trace.t_end)) <= 2 * _POINTS


def test_a_long_flow_has_as_many_points_for_its_length_as_short_ones() -> None:
    result = Runner("bouncing_ball").run()
    samples, _ = curves(result.observer, result.trace)
    rows = _rows(samples, 8.77)
    first = rows[samples.j[rows] == 0]
    assert len(first) == np.count_nonzero(samples.j == 0)
