"""Alignment of runs that truncate geometric Zeno sequences at different jumps."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from statechart.automaton.trace import Jump
from statechart.observation.alignment import (
    Event,
    last_resolved,
    pair_jumps,
    resolved_events,
)

FREE, CLOSED = ("free",), ("slide",)


def jump_at(t: float, j: int = 0, **changes: Any) -> Jump:
    declared = {"region": "foot", "cause": "touchdown", "source": FREE, "target": FREE}
    return Jump(t, j, before=np.array([t]), after=np.array([-t]), **(declared | changes))


def bounces(count: int, *later: Jump) -> list[Jump]:
    """Impacts at 2 - 2^(1 - k), which accumulate at 2; the rest after the last is skipped."""
    times = [2.0 - 2.0 ** (1 - k) for k in range(count)]
    jumps = [jump_at(t, j) for j, t in enumerate(times[:-1])]
    last = jump_at(times[-1], count - 1, target=CLOSED, skipped=2.0 - times[-1])
    return [*jumps, last, *later]


def run_of(jumps: list[Jump]) -> Any:
    return SimpleNamespace(jumps=jumps, t_end=3.0, step=None)


def opening(region: str = "foot", cause: str = "liftoff", t: float = 2.0) -> Jump:
    return jump_at(t, region=region, cause=cause, source=CLOSED, target=FREE)


def test_an_event_is_its_region_cause_and_modes() -> None:
    one = Event(jump_at(1.0), ends=False)
    assert one.matches(Event(jump_at(1.5), ends=False))
    for change in ({"region": "hand"}, {"cause": "slip"}, {"source": CLOSED}, {"target": CLOSED}):
        assert not one.matches(Event(jump_at(1.0, **change), ends=False))


def test_ends_of_sequences_match_ends_of_the_same_cause_and_target() -> None:
    end = Event(opening(), ends=True)
    assert end.matches(Event(opening("hand"), ends=True))
    assert not end.matches(Event(opening("hand"), ends=False))
    assert not end.matches(Event(opening(), ends=False))
    assert not Event(opening(), ends=False).matches(end)
    assert not end.matches(Event(opening(cause="disable"), ends=True))
    assert not end.matches(Event(jump_at(2.0, cause="liftoff", target=CLOSED), ends=True))


def test_numbers_at_the_end_of_a_sequence_are_those_after_it() -> None:
    jump = jump_at(2.0)
    assert Event(jump, ends=False).numbers.tolist() == [2.0, 2.0, -2.0]
    assert Event(jump, ends=True).numbers.tolist() == [2.0, -2.0, -2.0]


@pytest.mark.parametrize("counts", [(6, 6), (6, 7), (7, 6)])
def test_events_that_one_run_skipped_are_omitted_from_both(counts: tuple[int, int]) -> None:
    """The shorter run skips 2^-4 from its sixth impact on: five impacts remain, and the end."""
    runs = [bounces(count, opening()) for count in counts]
    found = resolved_events(runs)
    assert [len(events) for events in found] == [6, 6]
    for events in found:
        assert [event.jump.t for event in events[:5]] == [0.0, 1.0, 1.5, 1.75, 1.875]
        assert [event.ends for event in events] == [False] * 5 + [True]
    pairs, unpaired = pair_jumps(*map(run_of, runs))
    assert unpaired is None
    assert [one.t for one, _ in pairs] == [other.t for _, other in pairs]


def test_all_events_remain_if_the_runs_did_not_skip_the_same_sequences() -> None:
    resolved = [jump_at(2.0 - 2.0 ** (1 - k), k) for k in range(8)]
    found = resolved_events([bounces(6, opening()), [*resolved, opening()]])
    assert [len(events) for events in found] == [7, 9]
    assert not any(event.ends for events in found for event in events)


def test_a_sequence_that_one_run_skipped_alone_leaves_the_earlier_ones_aligned() -> None:
    alone = jump_at(2.8, target=CLOSED, skipped=0.1)
    found = resolved_events([bounces(6, opening()), bounces(7, opening(), alone)])
    assert [len(events) for events in found] == [6, 7]
    assert [event.jump.t for event in found[0]] == [event.jump.t for event in found[1][:6]]
    elsewhere = jump_at(0.0, target=CLOSED, skipped=0.5)
    found = resolved_events([bounces(6, opening()), [elsewhere, *bounces(7, opening())]])
    assert [len(events) for events in found] == [7, 9]


def test_runs_with_as_many_sequences_are_aligned_whatever_their_errors() -> None:
    """A run at a loose tolerance ends its bounces later by more than the time that it skipped."""
    late = [replace(jump, t=1.1 * jump.t) for jump in bounces(6, opening())]
    found = resolved_events([late, bounces(6, opening())])
    assert [len(events) for events in found] == [6, 6]


def test_a_jump_of_one_run_alone_ends_the_pairs() -> None:
    one, other = bounces(6, opening(t=2.5)), bounces(6, opening("hand", t=2.5))
    pairs, unpaired = pair_jumps(run_of(one), run_of(other))
    assert (len(pairs), unpaired) == (5, 2.5)


def test_the_last_resolved_jump_with_events_skips_the_rest() -> None:
    jumps = bounces(6, opening())
    assert last_resolved(run_of(jumps)) == [jumps[5]]
