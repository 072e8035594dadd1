"""A run that starts from a state of another run goes on as that run does."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import with_starts

from contacts.scene.scene import Scene
from statechart.loading.load import load
from statechart.running.runner import Runner

# Model -> end of the run, and instants at which it is split: between events, and at one.
SPLITS = {
    "toppling_stick": (5.5, (2.0, "tip.slip", "tip.reverse")),
    "rocking_block": (6.0, (1.0, "left.touchdown")),
    "rope_swing": (2.0, (0.3, "rope.liftoff", 0.9)),
    "compass_walker": (3.0, (1.2, "foot_two.touchdown", "foot_one.enable")),
}


@pytest.mark.parametrize("model", SPLITS)
def test_a_run_that_is_split_in_two_has_the_same_events_and_end(model: str) -> None:
    until, places = SPLITS[model]
    declared = load(model)
    assert isinstance(declared, Scene)
    scene, names = with_starts(declared)
    runner = Runner(scene)
    whole = runner.run(until=until)
    for place in places:
        if isinstance(place, str):
            jump = next(j for j in whole.trace.jumps if f"{j.region}.{j.cause}" == place)
            at, values = jump.t, dict(zip(whole.trace.variables, jump.after.tolist(), strict=True))
        else:
            at, values = place, dict(whole.at(place).values)
        starts = {name: values[variable] for variable, name in names.items()}
        rest = runner.run(starts, until=until - at)
        later = [jump for jump in whole.trace.jumps if jump.t > at + 1e-9]
        events = [(jump.region, jump.cause, jump.target) for jump in rest.trace.jumps]
        assert events == [(jump.region, jump.cause, jump.target) for jump in later]
        times = [jump.t - at for jump in later]
        assert [jump.t for jump in rest.trace.jumps] == pytest.approx(times, abs=1e-11)
        np.testing.assert_allclose(rest.trace.final, whole.trace.final, rtol=1e-10, atol=1e-10)
