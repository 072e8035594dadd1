"""Jumps and changes of equations that take no time, or no more than its round-off."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from contacts import Scene
from statechart import run
from statechart.automaton.clock import Clock
from statechart.errors import EventLoop
from statechart.execution.livelock import JUMPS_AT_ONCE, JUMPS_NEAR, Livelock

MODEL: Any = SimpleNamespace(label="{}".format, regions=())


def _jumps(start: float, interval: float, count: int = JUMPS_NEAR) -> list[Any]:
    return [
        SimpleNamespace(t=start + k * interval, region="foot", cause="enable", target=("free",))
        for k in range(count)
    ]


@pytest.mark.parametrize(("start", "interval"), [(0.26, 1e-19), (0.0, 1e-21), (1e6, 1e-14)])
def test_jumps_within_the_round_off_of_time_are_a_loop(start: float, interval: float) -> None:
    jumps = _jumps(start, interval)
    with pytest.raises(EventLoop, match=r"1024 jumps at t = .*: enable -> .*free"):
        Livelock(1.0).check(jumps, Clock(jumps[-1].t), MODEL)


@pytest.mark.parametrize(("start", "interval"), [(0.26, 1e-16), (0.0, 1e-17), (1e6, 1e-11)])
def test_jumps_separated_by_time_are_no_livelock(start: float, interval: float) -> None:
    # Intervals below an ulp of the start add up.
    jumps = [SimpleNamespace(t=start, region="", cause="", target=())] * JUMPS_NEAR
    Livelock(1.0).check(jumps, Clock(start).later(JUMPS_NEAR * interval), MODEL)


def test_few_jumps_are_no_livelock() -> None:
    jumps = _jumps(1.0, 0.0, JUMPS_NEAR - 1)
    Livelock(1.0).check(jumps, Clock(1.0), MODEL)


def test_equations_that_change_while_time_creeps_are_a_loop() -> None:
    livelock, clock = Livelock(1.0), Clock(0.5)
    for _ in range(JUMPS_AT_ONCE):
        livelock.rearranged(clock, ("a.gap",))
        clock = clock.later(1e-20)
    with pytest.raises(EventLoop, match="equations of the mode follow one another"):
        livelock.rearranged(clock, ("a.gap",))
    livelock = Livelock(1.0)
    for k in range(10 * JUMPS_AT_ONCE):
        livelock.rearranged(Clock(0.5 + 1e-13 * k), ("a.gap",))


def test_margins_that_fall_in_turn_while_time_creeps_are_a_loop() -> None:
    livelock, clock = Livelock(1.0), Clock(0.5)
    found = False
    for k in range(2 * JUMPS_AT_ONCE):
        found = found or livelock.stalled(clock, ("a" if k % 2 else "b",))
        clock = clock.later(1e-20)
    assert found


def test_signs_of_rates_beside_a_locked_clutch_end_with_the_coupling_to_write() -> None:
    wheel = {"mass": 1, "inertia": 1}
    scene = Scene(
        name="shafts",
        bodies={"a": wheel, "b": wheel},
        couplings={"clutch": {"bodies": ["a", "b"], "limit": 1}},
        forces={
            "motor": {"body": "a", "moment": "8*sin(time) - 3*sign(a.dangle)"},
            "drag": {"body": "b", "moment": "-2*sign(b.dangle)"},
        },
        stop={"time": 1},
    )
    with pytest.raises(EventLoop, match=r"instead of sign write couplings: \{f: \{bodies: \[a\]"):
        run(scene)
