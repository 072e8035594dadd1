"""Variables of controllers: the hopper with foot placement, and the sampled balance."""

from __future__ import annotations

import numpy as np
import pytest

from statechart.running.runner import Runner


@pytest.mark.parametrize("v", [0.5, 1.0, 1.5])
def test_the_hopper_reaches_the_required_speed(v: float) -> None:
    found = Runner("raibert_hopper").run({"v": v})
    assert found.trace.certified
    speeds, stances = found.outputs["speeds"], found.outputs["stances"]
    assert isinstance(speeds, list)
    assert isinstance(stances, list)
    assert speeds[-1] == pytest.approx(v, rel=0.02)
    assert max(speeds[:3]) < v
    # The controller remembers the duration of a stance; the last one may not be over.
    left = found.outputs["in_stance"] - sum(stances)
    assert -1e-12 <= left <= max(stances)
    assert found.outputs["in_stance"] == pytest.approx(found.outputs["on_ground"], rel=1e-12)


def test_engines_agree_on_the_hopper() -> None:
    taylor = Runner("raibert_hopper", engine="taylor").run(until=3.0).outputs
    scipy = Runner("raibert_hopper", engine="scipy", tolerance=1e-12).run(until=3.0).outputs
    assert taylor["hops"] == scipy["hops"]
    assert scipy["speeds"] == pytest.approx(taylor["speeds"], rel=1e-7)


def test_integral_control_identifies_the_load() -> None:
    found = Runner("sampled_balance").run({"T": 0.04, "load": 0.7}).outputs
    assert found["samples"] == 100
    # Upright and at rest the torque is the load's; the slowest mode of the loop has a rate of 2/s.
    assert found["torque"] == pytest.approx(-0.7, abs=0.02)
    assert found["angle"] == pytest.approx(0.0, abs=0.002)


def test_a_torque_is_constant_between_samples() -> None:
    runner = Runner("sampled_balance")
    found = runner.run(until=0.1)
    place = runner.automaton.names.index("held")
    ends = [arc.states(np.array([0.0, arc.duration]))[:, place] for arc in found.trace.arcs]
    torques = [0.0, *found.outputs["torques"]]
    assert len(ends) > 3
    for (begin, end), torque in zip(ends, torques, strict=False):
        assert begin == end == torque


def test_pendulum_falls_when_sampled_too_rarely() -> None:
    trace = Runner("sampled_balance").run({"T": 0.4}).trace
    assert trace.outcome.name == "STOPPED"
