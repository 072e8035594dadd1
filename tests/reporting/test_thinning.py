"""Curves of very many points are decimated without visible change."""

from __future__ import annotations

import numpy as np
import pytest

from statechart.observation.sampling import Samples
from statechart.reporting.curves import COLUMNS, DrawnCurve, largest_impulses
from statechart.reporting.figure import _visible
from statechart.running.runner import Runner


def samples(t, j) -> Samples:
    return Samples(t, j, np.zeros(len(t), dtype=np.intp), (("a",),), {})


def test_few_points_are_drawn_as_they_are_and_broken_at_jumps() -> None:
    t = np.array([0.0, 1.0, 1.0, 2.0])
    line = DrawnCurve.of(samples(t, np.array([0, 0, 1, 1])))
    np.testing.assert_array_equal(line.times, [0.0, 1.0, np.nan, 1.0, 2.0])
    np.testing.assert_array_equal(line.values(t + 5.0), [5.0, 6.0, np.nan, 6.0, 7.0])


def test_thinning_keeps_outlying_points() -> None:
    t = np.linspace(0.0, 3.0, 200_001)
    values = np.sin(40_000.0 * t)
    values[[777, 123_456]] = 9.0, -8.0
    values[5000:5003] = np.nan
    line = DrawnCurve.of(samples(t, np.arange(len(t)) // 1000))
    drawn = line.values(values)
    assert len(drawn) == len(line.times) <= 4 * COLUMNS
    for place in (777, 123_456):
        near = np.abs(line.times - t[place]) <= 3.0 / COLUMNS
        assert values[place] in drawn[near]
    assert np.nanmax(drawn) == 9.0
    assert np.nanmin(drawn) == -8.0
    assert (np.diff(line.times[~np.isnan(line.times)]) >= 0.0).all()


def test_thinning_keeps_jumps_between_two_columns() -> None:
    half = np.linspace(0.0, 1.0, 15_000)
    t = np.concatenate([half, 1.0 + half])
    j = np.repeat([0, 1], 15_000)
    line = DrawnCurve.of(samples(t, j))
    broken = line.times[:-1][np.isnan(line.times[1:])]
    assert broken == pytest.approx([1.0], abs=2.0 / COLUMNS)


def test_thinning_keeps_the_largest_impulse_of_a_column() -> None:
    times = np.linspace(0.0, 2.0, 50_000)
    sizes = 1.0 + 0.5 * np.sin(np.arange(50_000))
    sizes[31_234] = -7.0
    chosen, drawn = largest_impulses(times, sizes, 2.0)
    assert len(chosen) == COLUMNS
    assert (np.diff(chosen) > 0.0).all()
    assert drawn[chosen == times[31_234]] == -7.0
    assert np.abs(drawn).min() > 1.4
    few = largest_impulses(times[:9], sizes[:9], 2.0)
    np.testing.assert_array_equal(few[1], sizes[:9])


def test_recomputed_run_is_identical() -> None:
    result = Runner("bouncing_ball").run()
    held = result.trace.at_hand()
    assert isinstance(held.jumps, tuple)
    assert [jump.t for jump in held.jumps] == [jump.t for jump in result.trace.jumps]
    assert [arc.start for arc in held.arcs] == [arc.start for arc in result.trace.arcs]
    assert held.jumps[3] is held.jumps[3]
    assert held.at_hand().outcome is result.trace.outcome


def test_the_first_events_of_a_report_are_those_of_all() -> None:
    result = Runner("bouncing_ball").run()
    reported = result.to_dict(explain=True)["events"]
    assert len(reported) > 5
    assert result.to_dict(explain=True, most=5)["events"] == reported[:5]


def test_thinning_keeps_visible_stretches() -> None:
    ends = np.linspace(0.0, 5.0, 60_001)
    fast = list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))
    # Three in four of the first half are one state; the second half is another for long.
    first = [pair for k, pair in enumerate(fast[:30_000]) if k % 4]
    second = [pair for k, pair in enumerate(fast[:30_000]) if not k % 4]
    drawn = _visible({"a": first, "b": second, "c": [(2.5, 5.0)]}, 5.0)
    assert sum(map(len, drawn.values())) <= COLUMNS
    widths = {state: sum(end - start for start, end in those) for state, those in drawn.items()}
    assert widths == pytest.approx({"a": 1.875, "b": 0.625, "c": 2.5}, abs=0.02)
    assert drawn["c"] == [(2.5, 5.0)]
    few = {"a": [(0.0, 1.0)]}
    assert _visible(few, 1.0) is few
