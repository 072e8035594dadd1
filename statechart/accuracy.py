"""How far two runs of one model are apart: the estimate behind an accuracy that was asked for."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from statechart.outputs import Result as Output
from statechart.trace import Jump, Trace

__all__ = ["difference"]

Array = NDArray[np.float64]

# A number that is this much smaller than every other of its run is the rounding of zero, and has
# no digits to be right.
_NOTHING = 1e-12


def difference(
    coarse: Trace,
    fine: Trace,
    coarse_outputs: Mapping[str, Output],
    fine_outputs: Mapping[str, Output],
) -> tuple[float, float | None]:
    """Return the largest relative difference of two runs.

    Compared are the final state (relative to the largest value that a variable had), the times
    of events and of the end (relative to the end), and outputs (relative to themselves; counts
    are not compared, as a Zeno sequence has any number of jumps). A number that is not finite in
    both runs must be the same.

    Parameters
    ----------
    coarse, fine : Trace
        Two runs of one model from one start.
    coarse_outputs, fine_outputs : mapping
        Their outputs.

    Returns
    -------
    float
        inf where the runs took different modes or ended for different reasons.
    float or None
        When they first did so; None if they did not.
    """
    diverged, times = _events(coarse, fine)
    if diverged is None and coarse.outcome is not fine.outcome:
        diverged = min(coarse.t_end, fine.t_end)
    if diverged is not None:
        return math.inf, diverged
    largest = np.maximum(_largest(coarse), _largest(fine))
    nothing = _NOTHING * float(largest.max(initial=0.0))
    parts = [
        _relative(a, b, scale, nothing)
        for a, b, scale in zip(
            coarse.final.tolist(), fine.final.tolist(), largest.tolist(), strict=True
        )
    ]
    end = max(coarse.t_end, fine.t_end)
    parts += [_relative(a, b, end, 0.0) for a, b in times]
    for name, one in coarse_outputs.items():
        for a, b in _pairs(one, fine_outputs[name]):
            parts.append(_relative(a, b, max(abs(a), abs(b)), nothing))
    return max(parts, default=0.0), None


def _events(coarse: Trace, fine: Trace) -> tuple[float | None, list[tuple[float, float]]]:
    """Pair the jumps of two runs; return when they part, if they do, and the pairs of times.

    How many jumps of a Zeno sequence are resolved depends on the tolerance: where one run is at
    the accumulation, the other's further jumps of that sequence are passed over.
    """
    times = [(coarse.t_end, fine.t_end)]
    a, b = list(coarse.jumps), list(fine.jumps)
    i = j = 0
    while i < len(a) and j < len(b):
        one, other = a[i], b[j]
        if _same(one, other):
            times.append((one.t, other.t))
            i, j = i + 1, j + 1
        elif _accumulates(one) and _repeats(other, one):
            j += 1
        elif _accumulates(other) and _repeats(one, other):
            i += 1
        else:
            return min(one.t, other.t), times
    rest = (*a[i:], *b[j:])
    return (rest[0].t if rest else None), times


def _same(one: Jump, other: Jump) -> bool:
    return (one.region, one.cause, one.source, one.target) == (
        other.region,
        other.cause,
        other.source,
        other.target,
    )


def _accumulates(jump: Jump) -> bool:
    return jump.fired == ("zeno",)


def _repeats(jump: Jump, end: Jump) -> bool:
    """Whether `jump` belongs to the sequence that accumulates in `end`."""
    return jump.region == end.region and not _accumulates(jump)


def _largest(trace: Trace) -> Array:
    """Return the largest magnitude (n,) of every variable at the ends of arcs and jumps."""
    states = [trace.initial, trace.final]
    states += [state for jump in trace.jumps for state in (jump.before, jump.after)]
    return np.abs(np.array(states)).max(axis=0)


def _pairs(one: Output, other: Output) -> Iterable[tuple[float, float]]:
    if isinstance(one, list) and isinstance(other, list):
        return zip(one, other, strict=False)
    if isinstance(one, float) and isinstance(other, float):
        return [(one, other)]
    return []


def _relative(a: float, b: float, scale: float, nothing: float) -> float:
    if a == b or (math.isnan(a) and math.isnan(b)):
        return 0.0
    if not (math.isfinite(a) and math.isfinite(b)):
        return math.inf
    return 0.0 if scale <= nothing else abs(a - b) / scale
