"""Difference of two runs of one model, the basis of error estimates."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import NamedTuple, TypeAlias

import numpy as np

from statechart.arrays import Array
from statechart.automaton.trace import Jump, Key, Trace, sizes
from statechart.observation.alignment import pair_jumps
from statechart.observation.sampling import at_times, sample_arcs
from statechart.observation.scales import NO_SCALES, Scales
from statechart.observation.scales import OutputValue as Output

# Values below this fraction of all others are round-off of zero. In time stepping, velocities of a
# stack at rest are 1.5e-12.
_ZERO_PART = 1e-11
_PARTED_PART = 1e-2  # relative difference of separated runs
_TIMES_BETWEEN = 16  # samples between two events, for separation
_TIMES_ALONG, _MIN_TIMES = 512, 2  # samples of the distance, in a run and between two events


class Compared(NamedTuple):
    """A value in two runs."""

    what: str  # the quantity, such as `output lift`
    coarse: float
    fine: float
    off: float  # difference, relative to the scale of the quantity

    def __str__(self) -> str:
        one, other = f"{self.coarse:.7g}", f"{self.fine:.7g}"
        if one == other:
            return f"{self.what} ({one}, difference {abs(self.fine - self.coarse):.2g})"
        return f"{self.what} ({one} and {other})"


_NONE = Compared("", 0.0, 0.0, 0.0)
Cuts: TypeAlias = Sequence[Sequence[int]]
"""Cuts of a list of a Zeno sequence in two runs; see `Outputs.truncated`."""


@dataclass(frozen=True)
class Difference:
    """Differences of two runs of one model, relative to the scales of the quantities."""

    state: float  # of the final state; inf for different outcomes
    times: float  # of common events and of the end, relative to the end
    named: Mapping[str, float]  # of every output, including lengths of lists
    decides: Compared  # the value with the largest difference
    diverged: float | None  # time of the first different mode or outcome
    pairs: Sequence[tuple[Jump, Jump]]  # the common events

    @property
    def outputs(self) -> float:
        """The largest of the outputs."""
        return max(self.named.values(), default=0.0)

    @property
    def largest(self) -> float:
        """The largest of the three; inf for different modes."""
        return math.inf if self.diverged is not None else max(self.state, self.times, self.outputs)


def compare(
    coarse: Trace,
    fine: Trace,
    coarse_outputs: Mapping[str, Output],
    fine_outputs: Mapping[str, Output],
    *,
    scales: Scales = NO_SCALES,
    endless: Collection[str] | Mapping[str, Cuts] = (),
    brief: float = 0.0,
    nothing: float = 0.0,
) -> Difference:
    """Compare two runs of one model from one start, and their outputs.

    Non-finite values must be equal. A value without a scale (from `Outputs.scales`) is relative to
    itself. For `endless` outputs (Zeno sequences) only common events are compared; a mapping has
    their cuts in the two runs (see `Outputs.truncated`). `brief`: as in `pair_jumps`. Values up to
    `nothing` are round-off of zero.
    """
    pairs, diverged = pair_jumps(coarse, fine, brief=brief)
    same_end = coarse.outcome is fine.outcome
    if diverged is None and not same_end:
        diverged = min(coarse.t_end, fine.t_end)
    largest = np.maximum(sizes(coarse), sizes(fine))
    nothing = max(nothing, _ZERO_PART * float(largest.max(initial=0.0)))
    if scales.variables is not None:
        largest = np.maximum(largest, scales.variables)
    zeros = np.maximum(np.broadcast_to(scales.zero_variables, largest.shape), nothing)
    table = np.array([coarse.final, fine.final, largest, zeros]).T.tolist()
    state = _worst(
        Compared(f"the final {name}", row[0], row[1], _relative(*row))
        for name, row in zip(fine.variables, table, strict=True)
    )
    end = max(coarse.t_end, fine.t_end)
    times = [("the end", coarse.t_end, fine.t_end)] if same_end else []
    times += [(f"the time of {one.region}.{one.cause}", one.t, other.t) for one, other in pairs]
    delay = _worst(Compared(*time, _relative(time[1], time[2], end, 0.0)) for time in times)
    cuts = endless if isinstance(endless, Mapping) else dict.fromkeys(endless, ())
    outputs: dict[str, Compared] = {}
    for name, one in coarse_outputs.items():
        size = scales.outputs.get(name, 0.0)
        zero = max(nothing, scales.zero_outputs.get(name, 0.0))
        outputs[name] = _worst(
            Compared(f"output {name}", a, b, _relative(a, b, max(abs(a), abs(b), size), zero))
            for a, b, size in _differences(one, fine_outputs[name], size, cuts.get(name))
        )
    off, named = state.off if same_end else math.inf, {n: one.off for n, one in outputs.items()}
    worst = _worst((state, delay, *outputs.values()))
    return Difference(off, delay.off, named, worst, diverged, pairs)


def _worst(compared: Iterable[Compared]) -> Compared:
    return max(compared, key=lambda one: one.off, default=_NONE)


def separation_time(reference: Trace, trace: Trace, *, brief: float = 0.0) -> float | None:
    """Return the time of separation of two runs, or None.

    The first time at which a variable differs by a hundredth of its size, or modes differ. States
    are not compared between the times of an event in the two runs, where a jump separates them.
    """
    pairs, diverged = pair_jumps(reference, trace, brief=brief)
    end = min(reference.t_end, trace.t_end)
    if diverged is None and reference.outcome is not trace.outcome:
        diverged = end
    until = end if diverged is None else min(diverged, end)
    marks = [(0.0, 0.0), *((one.t, other.t) for one, other in pairs), (until, until)]
    grids = [np.zeros(0)]
    for before, after in pairwise(marks):
        start, stop = max(before), min(*after, until)
        if stop > start:
            # Without the ends, where one run may have jumped and the other not.
            parts = (np.arange(_TIMES_BETWEEN) + 0.5) / _TIMES_BETWEEN
            grids.append(start + (stop - start) * parts)
    times = np.concatenate(grids)
    if len(times) == 0 or not (reference.arcs and trace.arcs):
        return diverged
    differing = _relative_differences(reference, trace, times) > _PARTED_PART
    where = np.flatnonzero(differing.any(axis=1))
    return float(times[where[0]]) if len(where) else diverged


def distance(reference: Trace, trace: Trace) -> float:
    """Return the L1 distance of two runs, the largest of all variables, for any modes.

    The mean of the difference of a variable over the common time, relative to its largest value. In
    this norm runs converge in spite of late events, and time stepping in spite of other modes
    (Moreau, "Numerical aspects of the sweeping process", 1999).
    """
    end = min(reference.t_end, trace.t_end)
    if not (end > 0.0 and reference.arcs and trace.arcs):
        return 0.0
    jumps = [jump.t for run in (reference, trace) for jump in run.jumps if jump.t < end]
    marks = np.unique([0.0, *jumps, end])
    lengths = np.diff(marks)
    counts = np.maximum(np.ceil(_TIMES_ALONG * lengths / end).astype(int), _MIN_TIMES)
    place = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    weights = np.repeat(lengths / counts, counts)
    times = np.minimum(np.repeat(marks[:-1], counts) + (place + 0.5) * weights, end)
    differences = _relative_differences(reference, trace, times)
    return float((weights @ differences).max(initial=0.0) / end)


def mode_disagreement(reference: Trace, trace: Trace) -> float:
    """Return the fraction of the common time in which two runs have different modes."""
    end = min(reference.t_end, trace.t_end)
    if not end > 0.0:
        return 0.0
    numbers: dict[Key, int] = {}
    changes, modes = [], []
    for run in (reference, trace):
        keys = [run.start_mode, *(jump.target for jump in run.jumps)]
        modes.append(np.array([numbers.setdefault(key, len(numbers)) for key in keys]))
        changes.append(np.array([jump.t for jump in run.jumps]))
    marks = np.unique(np.concatenate([[0.0, end], *changes]))
    marks = marks[marks <= end]
    middles = 0.5 * (marks[:-1] + marks[1:])
    pairs = zip(modes, changes, strict=True)
    one, other = (numbered[np.searchsorted(times, middles)] for numbered, times in pairs)
    return float(np.diff(marks) @ (one != other)) / end


def _relative_differences(reference: Trace, trace: Trace, times: Array) -> Array:
    """Return the differences (m, n) of two runs in their sizes; 0 for round-off of zero."""
    scale = np.maximum(sizes(reference), sizes(trace))
    scale[scale <= _ZERO_PART * scale.max(initial=0.0)] = math.inf
    one, other = (sample_arcs(*at_times(run, times)).states for run in (reference, trace))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(one - other) / scale)


def _differences(
    one: Output, other: Output, size: Output, cuts: Cuts | None
) -> Iterable[tuple[float, float, float]]:
    """Yield the values of an output in both runs, and their size; `cuts`: of an endless output."""
    if isinstance(one, list) and isinstance(other, list):
        if cuts is None:
            yield float(len(one)), float(len(other)), 1.0
        runs = [
            list(pairwise((0, *own, len(values))))
            for own, values in zip(cuts or ((), ()), (one, other), strict=True)
        ]
        sizes = size if isinstance(size, list) else []
        # The sequences of one run are those of the other, resolved up to another event.
        for (a, a_end), (b, b_end) in zip(*runs, strict=False):
            same_length = a_end - a == b_end - b
            # The last event of the run with fewer ones precedes the skipped rest.
            count = a_end - a if same_length else min(a_end - a, b_end - b) - 1
            own_sizes = [*sizes[b : b + count], *[0.0] * count]
            yield from islice(zip(one[a:], other[b:], own_sizes, strict=False), max(count, 0))
    elif isinstance(one, int) and isinstance(other, int):
        if cuts is None:
            yield float(one), float(other), 1.0
    elif isinstance(one, float) and isinstance(other, float):
        yield one, other, size if isinstance(size, float) else 0.0
    elif (one is None) != (other is None):
        yield math.nan, 0.0, 0.0  # an event of one run only


def _relative(a: float, b: float, scale: float, nothing: float) -> float:
    if a == b or (math.isnan(a) and math.isnan(b)):
        return 0.0
    if not (math.isfinite(a) and math.isfinite(b)):
        return math.inf
    return 0.0 if scale <= nothing else abs(a - b) / scale
