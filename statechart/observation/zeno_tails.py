"""Alignment of the ends of Zeno sequences that two runs truncate at different jumps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeVar

from statechart.automaton.trace import Jump, Trace

# Window of the truncated jumps, relative to the skipped time, before and after.
_WINDOW = (0.5, 1.001)


class _Timed(Protocol):
    """Event with a time, and the time skipped after it."""

    @property
    def t(self) -> float: ...

    @property
    def skipped(self) -> float: ...


Jumping = TypeVar("Jumping", bound=_Timed)

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


def drop_summed(runs: Sequence[Sequence[Jumping]]) -> list[list[tuple[Jumping, bool]]] | None:
    """Omit the jumps that at least one run skipped at the end of a Zeno sequence.

    If regions bounce in turn, round-off decides at which of them the rest is skipped. Returns the
    remaining jumps, and whether a sequence ends there (its state before is of the last resolved
    jump). None if the runs did not skip the same sequences.
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
    return [
        _resolved_jumps(run, run_sums, windows) for run, run_sums in zip(runs, sums, strict=True)
    ]


def _resolved_jumps(
    jumps: Sequence[Jumping], sums: Sequence[Jumping], windows: Sequence[tuple[float, float]]
) -> list[tuple[Jumping, bool]]:
    ends = [(jump.t + jump.skipped, *window) for jump, window in zip(sums, windows, strict=True)]
    found = []
    for jump in jumps:
        left = [(end - jump.t, least, most) for end, least, most in ends]
        if not any(least <= time <= most for time, least, most in left):
            found.append((jump, any(abs(time) < least for time, least, _ in left)))
    return found
