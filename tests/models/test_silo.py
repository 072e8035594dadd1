"""The silo beside the law of Beverloo, in the plane."""

from __future__ import annotations

import numpy as np
import pytest

from statechart.running.runner import Runner

TIMES = np.linspace(0.15, 0.45, 3)


@pytest.fixture(scope="module")
def silo():
    return Runner("silo")


def flow(runner, opening):
    """Return the discs that leave per interval in five runs; a single run scatters by a tenth."""
    frictions = (0.46, 0.48, 0.5, 0.52, 0.54)
    return np.diff(sum(discs_out(runner, {"D": opening, "mu": mu}) for mu in frictions))


def discs_out(runner, values):
    result = runner.run(values, until=TIMES[-1])
    assert result.trace.outcome.succeeded, result.trace.message
    assert result.trace.counts["inexact_steps"] == 0
    names = [f"grain{k}.y" for k in range(150)]
    found = result.observer.sample(result.trace, names, times=TIMES).columns
    return (np.array([found[name] for name in names]) < -0.005).sum(axis=0)


def test_discs_flow_out_at_a_constant_rate_that_grows_as_beverloo_says(silo):
    narrow, wide = flow(silo, 0.05), flow(silo, 0.06)
    early, late = narrow + wide
    assert late == pytest.approx(early, rel=0.15)
    # (D - 1.3 d)^(3/2)
    expected = ((0.06 - 0.013) / (0.05 - 0.013)) ** 1.5
    assert wide.sum() == pytest.approx(expected * narrow.sum(), rel=0.2)


def test_the_pan_has_no_load_before_the_gate_opens(silo):
    assert silo.run(until=0.04).outputs["load"] == pytest.approx(9.81, rel=1e-9)
