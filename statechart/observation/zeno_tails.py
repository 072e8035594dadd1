"""Alignment of the ends of Zeno sequences that two runs summed up at different jumps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeVar

from statechart.automaton.trace import Jump, Trace

# The window in which one run sums up the jumps that the other resolves, either side.
_WINDOW = (0.5, 1.001)


class _Timed(Protocol):
    """Event with a time, and a time skipped behind it."""

    @property
    def t(self) -> float: ...

    @property
    def skipped(self) -> float: ...


Jumping = TypeVar("Jumping", bound=_Timed)

# A bounce that a step takes for rest is no faster than two steps of free fall, and lasts four.
_CAPTURED = 5.0


def last_resolved(trace: Trace) -> list[Jump]:
    """Return the last jumps of Zeno sequences that a run resolves.

    One that locates events has summed up what was left. One that steps in time lets what bounces
    too low rest: there a region, free before and after its last impact, is so no longer within the
    steps of such a bounce.
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
            # What was not free came to its impact, and leaves it, by another cause.
            same_cause = i != about or jump.cause == latest.cause
            if same_cause and jump.t - latest.t <= _CAPTURED * trace.step:
                found[id(latest)] = latest
        if about is not None and jump.impulse and jump.source[about] == jump.target[about]:
            bounced[about] = jump
    return list(found.values())


def without_summed(runs: Sequence[Sequence[Jumping]]) -> list[list[tuple[Jumping, bool]]] | None:
    """Leave out the jumps that at least one run summed up at the end of a Zeno sequence.

    Several regions may bounce in turn, and rounding decides at which of them the sum begins.
    Returns the jumps that are left, and whether a sequence ends there: what was before is then that
    of the last jump resolved. None where the runs did not sum up the same sequences.
    """
    sums = [[jump for jump in run if jump.skipped > 0.0] for run in runs]
    if len(set(map(len, sums))) != 1:
        return None
    windows = [
        (
            _WINDOW[0] * min(j.skipped for j in same_series),
            _WINDOW[1] * max(j.skipped for j in same_series),
        )
        for same_series in zip(*sums, strict=True)
    ]
    return [_left(run, run_sums, windows) for run, run_sums in zip(runs, sums, strict=True)]


def _left(
    jumps: Sequence[Jumping], sums: Sequence[Jumping], windows: Sequence[tuple[float, float]]
) -> list[tuple[Jumping, bool]]:
    ends = [(jump.t + jump.skipped, *window) for jump, window in zip(sums, windows, strict=True)]
    found = []
    for jump in jumps:
        left = [(end - jump.t, least, most) for end, least, most in ends]
        if not any(least <= time <= most for time, least, most in left):
            found.append((jump, any(abs(time) < least for time, least, _ in left)))
    return found
