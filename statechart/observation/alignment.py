"""Alignment of the events of runs, which truncate Zeno sequences at different jumps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array
from statechart.automaton.trace import Jump, Trace

# Window of the truncated jumps, relative to the skipped time, before and after.
_WINDOW = (0.5, 1.001)
_MAX_PASSED_OVER = 64  # jumps

_what, _what_ends = attrgetter("region", "cause", "source", "target"), attrgetter("cause", "target")


class Event(NamedTuple):
    """A jump of a run for comparison; `ends` a Zeno sequence, after its last resolved jump."""

    jump: Jump
    ends: bool

    def matches(self, other: Event) -> bool:
        """Return whether two events are the same; ends of sequences may be of other regions."""
        same = _what_ends if self.ends else _what
        return self.ends == other.ends and bool(same(self.jump) == same(other.jump))

    @property
    def numbers(self) -> Array:
        """Time, state before, state after; only the latter at the end of a sequence."""
        jump = self.jump
        return np.concatenate([[jump.t], jump.after if self.ends else jump.before, jump.after])


# In time stepping, a bounce that is taken for rest has at most the velocity of two steps of free
# fall, and lasts four steps.
_CAPTURED = 5.0


def last_resolved(trace: Trace) -> list[Jump]:
    """Return the last resolved jumps of the Zeno sequences of a run.

    Event-driven runs skip the rest. Time stepping lets low bounces rest: the region is free before
    and after its last impact, and closed within the steps of such a bounce.
    """
    if trace.step is None:
        return [jump for jump in trace.jumps if jump.skipped > 0.0]
    bounced: dict[int, Jump] = {}
    found: dict[int, Jump] = {}
    places = {name: i for i, name in enumerate(trace.regions)}
    for jump in trace.jumps:
        about = places.get(jump.region)
        for i, (before, after) in enumerate(zip(jump.source, jump.target, strict=True)):
            if before == after or i not in bounced:
                continue
            latest = bounced.pop(i)
            # A region that was not free has another cause of its last jump.
            same_cause = i != about or jump.cause == latest.cause
            if same_cause and jump.t - latest.t <= _CAPTURED * trace.step:
                found[id(latest)] = latest
        if about is not None and jump.impulse and jump.source[about] == jump.target[about]:
            bounced[about] = jump
    return list(found.values())


def resolved_events(runs: Sequence[Sequence[Jump]]) -> list[list[Event]]:
    """Return the events of runs, without those that at least one skipped in a Zeno sequence.

    If regions bounce in turn, round-off decides at which of them the rest is skipped. If the runs
    skipped different numbers of sequences, events remain from the first one on whose ends are
    farther apart than the skipped times; runs with equal numbers differ by their errors.
    """
    sums = [[jump for jump in run if jump.skipped > 0.0] for run in runs]
    same = len(set(map(len, sums))) == 1
    windows = []
    for alike in zip(*sums, strict=False):
        ends, times = zip(*((jump.t + jump.skipped, jump.skipped) for jump in alike), strict=True)
        if not same and max(ends) - min(ends) > max(times):
            break
        windows.append((_WINDOW[0] * min(times), _WINDOW[1] * max(times)))
    return [_resolved(run, own, windows) for run, own in zip(runs, sums, strict=True)]


def _resolved(
    jumps: Sequence[Jump], sums: Sequence[Jump], windows: Sequence[tuple[float, float]]
) -> list[Event]:
    ends = [(end.t + end.skipped, *window) for end, window in zip(sums, windows, strict=False)]
    found = []
    for jump in jumps:
        left = [(end - jump.t, least, most) for end, least, most in ends]
        if not any(least <= time <= most for time, least, most in left):
            found.append(Event(jump, any(abs(time) < least for time, least, _ in left)))
    return found


def pair_jumps(
    coarse: Trace, fine: Trace, *, brief: float = 0.0
) -> tuple[list[tuple[Jump, Jump]], float | None]:
    """Pair the jumps of two runs; return the pairs, and the time of the first unpaired one.

    The number of resolved jumps of a Zeno sequence depends on the tolerance: jumps that one run
    summed up are omitted (see `resolved_events`), and those after the accumulation of the other run
    are passed over.
    """
    pairs: list[tuple[Jump, Jump]] = []
    events = resolved_events([coarse.jumps, fine.jumps])
    a, b = ([event.jump for event in run] for run in events)
    window = brief * max(coarse.t_end, fine.t_end)
    i = j = 0
    while i < len(a) and j < len(b):
        one, other = a[i], b[j]
        if events[0][i].matches(events[1][j]):
            pairs.append((one, other))
            i, j = i + 1, j + 1
        elif _is_zeno(one) and _repeats(other, one):
            j += 1
        elif _is_zeno(other) and _repeats(one, other):
            i += 1
        else:
            next_match = _next_common_mode(a, b, i, j, window) if window > 0.0 else None
            if next_match is None:
                return pairs, min(one.t, other.t)
            i, j = next_match
    remainder = (*a[i:], *b[j:])
    if not remainder:
        return pairs, None
    ended = remainder[0].t
    passed = 0.0 <= remainder[-1].t - ended < window and remainder[-1].target == remainder[0].source
    return pairs, None if passed else ended


def _next_common_mode(
    a: Sequence[Jump], b: Sequence[Jump], i: int, j: int, window: float
) -> tuple[int, int] | None:
    """Return the nearest indices in both runs, within `window`, after which their modes agree."""
    limit = min(a[i].t, b[j].t) + window
    after_a = [a[i].source, *(jump.target for jump in _jumps_until(a, i, limit))]
    after_b = [b[j].source, *(jump.target for jump in _jumps_until(b, j, limit))]
    for total in range(1, len(after_a) + len(after_b) - 1):
        for p in range(max(0, total - len(after_b) + 1), min(total, len(after_a) - 1) + 1):
            after = i + p, j + total - p
            if after_a[p] == after_b[total - p] and _resumes_together(a, b, *after, window):
                return after
    return None


def _resumes_together(a: Sequence[Jump], b: Sequence[Jump], i: int, j: int, window: float) -> bool:
    if i < len(a) and j < len(b):
        return abs(a[i].t - b[j].t) <= window
    return i == len(a) and j == len(b)


def _jumps_until(jumps: Sequence[Jump], start: int, limit: float) -> Iterator[Jump]:
    for jump in islice(jumps, start, start + _MAX_PASSED_OVER):
        if jump.t > limit:
            return
        yield jump


def _is_zeno(jump: Jump) -> bool:
    return jump.fired == ("zeno",)


def _repeats(jump: Jump, end: Jump) -> bool:
    """Return whether `jump` belongs to the Zeno sequence that ends in `end`."""
    return jump.region == end.region and not _is_zeno(jump)
