"""Every shipped model, on every engine, has every property."""

import functools

import numpy as np
import pytest
from runs import EVENT_BASED, PARADOXICAL

from statechart.documents.setting import Setting
from statechart.engines.request import choose
from statechart.engines.scipy import METHODS
from statechart.execution.simulator import Simulator
from statechart.loading.load import load
from statechart.testing.agreement import Undecidable, assert_same
from statechart.testing.checking import check
from statechart.testing.subject import Subject

NAMES = EVENT_BASED
EXAMPLES = 4
# Runs of many events, of which two examples take seconds.
LONG = ("compass_walker", "raibert_hopper", "rimless_wheel")
# Runs whose small errors grow too large: from bounce to bounce, and where a restitution just below
# 1 parts balls that at 1 stay together.
GROWING = ("bouncing_ball_hills", "newtons_cradle")


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_model_has_every_property(name):
    report = check(load(name), examples=2 if name in LONG else EXAMPLES, seed=1)
    assert report.engines == ("taylor", "scipy")
    assert report.passed, report.text()
    for result in report.properties:
        assert result.skipped or result.undecidable < result.examples, report.text()


@functools.lru_cache(maxsize=1)
def case_of(name):
    """The runs that those by all methods of a model are compared with."""
    return Subject(load(name)).case({})


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau", "LSODA"])
@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_model_has_the_same_run_by_every_method(name, method):
    case = case_of(name)
    subject = case.subject
    engine, _ = choose(Setting("scipy", method, 1e-9))
    trace = Simulator(subject.automaton, engine).run(until=subject.end({}), throw=False)
    assert trace.outcome is case.trace.outcome, trace.message
    if not trace.outcome.succeeded:
        assert name in PARADOXICAL
        assert trace.modes == case.trace.modes
        return
    try:
        assert_same(case.trace, trace, case.sensitivity)
    except Undecidable:
        assert name in GROWING


def test_tests_cover_all_methods_of_scipy():
    assert set(METHODS) == {"RK45", "DOP853", "Radau", "LSODA"}


def test_every_shipped_model_declares_ranges_and_a_stop_time():
    for name in NAMES:
        model = load(name)
        assert model.ranges, name
        assert np.isfinite(Subject(model).end({})), name
