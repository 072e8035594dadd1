"""Comparison of two runs that should agree within their errors.

The growth of errors is measured by runs with parameters perturbed by a relative `NUDGE`, and by the
condition numbers of events. If perturbations change the sequence of events, or errors grow too
large, agreement cannot be decided, and `Undecidable` is raised.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise, zip_longest
from typing import NoReturn

import numpy as np

from statechart.arrays import Array
from statechart.automaton.trace import Jump, Key, Trace
from statechart.observation.zeno_tails import drop_summed

NUDGE = 1e-7
"""Relative perturbation of parameters; above the errors of the runs."""

_ANOTHER_COURSE = f"a relative change of the parameters by {NUDGE:g} leads to other events"

# Round-off at the start of a run, and of the location of every event.
_LOCATED = 1e-13
_START_EVENTS = 10
# Round-off of a margin at an event, magnified by the condition of the event.
_MARGIN_ROUND_OFF = 1e-14
# Bound of the accumulated errors of steps, relative to their number times the tolerance.
_STEP_ERRORS = 10.0
# Relative error above which runs cannot be compared.
_CHAOTIC = 1e-2
# Largest relative change of the variables in a slow impact.
_SLOW_IMPACT = 1e-6


class Undecidable(Exception):  # noqa: N818 -- not an error
    """The runs do not decide whether a property holds."""


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """The growth of errors in a run.

    Attributes
    ----------
    nudged : sequence of Trace
        Runs with parameters perturbed by a relative `NUDGE` up and down.
    conditions : sequence of float or None
        Condition numbers of its events, from `statechart.observation.condition.conditions`. They
        show the effect of round-off of an event's location on a short flight after it.
    """

    nudged: Sequence[Trace]
    conditions: Sequence[float | None]


def assert_same(
    reference: Trace,
    other: Trace,
    sensitivity: Sensitivity,
    *,
    reading: Reading | None = None,
    until: tuple[float, Array] | None = None,
    loosened: Callable[[], Trace] | None = None,
) -> None:
    """Check that two runs have the same modes, times of events and states.

    Parameters
    ----------
    reference, other : Trace
        The runs.
    sensitivity : Sensitivity
        Sensitivity of `reference`.
    reading : Reading, optional
        Transformation of `other`, if it is of a transformed model.
    until : (float, (n,) array), optional
        Compare up to this time, when the reference has this state.
    loosened : callable, optional
        Returns the reference with modes chosen by the tolerances of `other`, in which slower
        separations stay closed.

    Raises
    ------
    AssertionError
        If they differ by more than their errors.
    Undecidable
        If that cannot be decided.
    """
    # Runs with fixed steps have no tolerance.
    known = [trace.tolerance for trace in (reference, other) if trace.step is None]
    tolerance = max(known, default=0.0)
    residual = max(trace.tolerances.get("impulse", 0.0) for trace in (reference, other))
    try:
        _compare(reference, other, sensitivity, _MARGIN_ROUND_OFF, 0.0, reading, until, loosened)
    except AssertionError:
        # Beyond round-off: errors of steps magnified by events, or residuals of impulses.
        if max(tolerance, residual) <= _MARGIN_ROUND_OFF:
            raise
        located = max(tolerance, _MARGIN_ROUND_OFF)
        _compare(reference, other, sensitivity, located, residual, reading, until, loosened)


def _compare(
    reference: Trace,
    other: Trace,
    sensitivity: Sensitivity,
    known: float,
    residual: float,
    reading: Reading | None,
    until: tuple[float, Array] | None,
    loosened: Callable[[], Trace] | None,
) -> None:
    """Compare runs with relative errors `known` of states at events, and impulse `residual`."""
    sequences = [EventSequence.of(trace, Reading()) for trace in (reference, *sensitivity.nudged)]
    sequences[0] = sequences[0].rounded(reference, sensitivity.conditions, known)
    sequences.append(EventSequence.of(other, reading or Reading()))
    if until is not None:
        sequences = [*(sequence.shortened(*until) for sequence in sequences[:-1]), sequences[-1]]
    first, *near, second = without_unresolved(sequences)
    error = bare = _STEP_ERRORS * (_error(reference) + _error(other) + residual)
    floor = np.zeros(len(first.end))
    traces = (reference,) if reading else (reference, other)
    # The gap tolerance of time stepping is penetration, not a projection.
    kinds = [("speed",) if t.step is not None else ("gap", "speed") for t in traces]
    floor[1:] = sum(
        t.tolerances.get(kind, 0.0) for t, of in zip(traces, kinds, strict=True) for kind in of
    )
    for i, (mine, its) in enumerate(zip_longest(first.events, second.events)):
        if mine and its:
            error = bare + mine.rounded
        if not (mine and its and mine.what == its.what):
            _raise_if_tolerances_decide(loosened, other, i, mine or its)
            _raise_difference(first, second, near, i, error, residual, (reference, other))
        shaken = [s for s in near if len(s.events) > i and s.events[i].what == mine.what]
        allowed = _allowed(mine, [s.events[i].numbers for s in shaken], first, error, floor)
        if len(shaken) < len(near):
            raise Undecidable(f"{_event_label(i, mine)}: {_ANOTHER_COURSE}")
        near = shaken
        # States at different times differ by the motion in between.
        allowed += abs(mine.t - its.t) * mine.rates
        if mine.hit != its.hit:
            _raise_undecidable_hit(first, second, i)
        _assert_close(mine.numbers, its.numbers, allowed, reference, _event_label(i, mine))
    if any(len(sequence.events) != len(first.events) for sequence in near):
        raise Undecidable(f"the end: {_ANOTHER_COURSE}")
    if first.mode != second.mode:
        raise AssertionError(f"{first.mode} at the end of one run, {second.mode} of the other")
    last = Event(("", "end", (), ()), first.end, 0.0)
    allowed = _allowed(last, [sequence.end for sequence in near], first, error, floor)
    _assert_close(first.end, second.end, allowed, reference, "the end")


def identical(reference: Trace, other: Trace, reading: Reading) -> bool:
    """Return whether two runs have bitwise equal events and end."""

    def numbers(sequence: EventSequence) -> object:
        events = [(event.what, event.numbers.tolist()) for event in sequence.events]
        return sequence.mode, sequence.end.tolist(), events

    first, second = EventSequence.of(reference, Reading()), EventSequence.of(other, reading)
    return numbers(first) == numbers(second)


def _error(trace: Trace) -> float:
    steps = trace.counts["steps"]
    if trace.step is not None:
        return (_START_EVENTS + steps) * _LOCATED
    return steps * trace.tolerance + (_START_EVENTS + len(trace.jumps)) * _LOCATED


def _allowed(
    event: Event, near: Sequence[Array], sequence: EventSequence, error: float, floor: Array
) -> Array:
    """Return the allowed difference: error times growth of a perturbation, and round-off."""
    grown = np.zeros(len(event.numbers))
    for numbers in near:
        grown = np.maximum(grown, np.abs(numbers - event.numbers) / NUDGE)
    allowed = error * (grown + sequence.sizes)
    if (allowed > _CHAOTIC * sequence.sizes + floor).any():
        raise Undecidable(f"by t = {event.t:.6g} errors of {error:.0e} have grown too large")
    return allowed + floor


def _assert_close(mine: Array, its: Array, allowed: Array, trace: Trace, place: str) -> None:
    off = np.abs(mine - its)
    worst = int(np.argmax(np.where(allowed > 0, off / np.where(allowed > 0, allowed, 1), off)))
    if not (off <= allowed).all():
        names = ["the time", *(f"{v} before" for v in trace.variables), *trace.variables]
        raise AssertionError(
            f"{place}: {names[worst]} is {mine[worst]:.7g} in one run, and differs by "
            f"{off[worst]:.2g} in the other; their errors explain {allowed[worst]:.1e}"
        )


def _raise_undecidable_hit(first: EventSequence, second: EventSequence, i: int) -> None:
    """Raise `Undecidable` if round-off decides which contacts event `i` hits.

    Impacts within the gap tolerance merge, and slow impacts of contacts that move together have no
    definite order.
    """
    instant = NUDGE * float(first.end[0])
    for sequence in (first, second):
        for one, two in pairwise(sequence.events[i : i + 2]):
            if two.t - one.t <= instant:
                raise Undecidable(
                    f"{_event_label(i, one)}: impacts closer than {instant:.1e} in time are a "
                    "single one in one of the runs"
                )
    n = len(first.end) // 2
    small = _SLOW_IMPACT * first.sizes[n + 1 :]
    both = [sequence.events[i].numbers for sequence in (first, second)]
    if all((np.abs(at[n + 1 :] - at[1 : n + 1]) <= small).all() for at in both):
        raise Undecidable(
            f"{_event_label(i, first.events[i])}: the impact is so slow that round-off decides "
            "which of the contacts that move together is hit first"
        )


def _raise_if_tolerances_decide(
    loosened: Callable[[], Trace] | None, other: Trace, i: int, event: Event
) -> None:
    """Raise `Undecidable` if the runs differ at `event` because of their tolerances."""
    if loosened is None:
        return
    first, second = without_unresolved(
        [EventSequence.of(t, Reading()) for t in (loosened(), other)]
    )
    count = sum(one.t <= event.t for one in second.events)
    courses = [[one.what for one in s.events[: count + 1]] for s in (first, second)]
    if courses[0] == courses[1] and courses[0][count:] != [event.what]:
        raise Undecidable(
            f"{_event_label(i, event)}: with the tolerances of the other engine, this run has the "
            "events of the other run"
        )


def _raise_difference(
    first: EventSequence,
    second: EventSequence,
    near: Sequence[EventSequence],
    i: int,
    error: float,
    residual: float,
    traces: tuple[Trace, Trace],
) -> NoReturn:
    """Raise the error for a different event `i`."""
    own, others = first.events[i : i + 1], second.events[i : i + 1]
    place = _event_label(i, (own or others)[0])
    what = tuple(event.what for event in own)
    if any(tuple(e.what for e in sequence.events[i : i + 1]) != what for sequence in near):
        raise Undecidable(f"{place}: {_ANOTHER_COURSE}")
    instant = error * float(first.end[0])
    if own:
        numbers = [sequence.events[i].numbers for sequence in near]
        instant = float(_allowed(own[0], numbers, first, error, np.zeros(len(first.end)))[0])
    for sequence, end in ((first, second.end[0]), (second, first.end[0])):
        times = [event.t for event in sequence.events[max(i - 1, 0) : i + 2]]
        at_end = any(abs(event.t - end) <= instant for event in sequence.events[i : i + 1])
        if at_end or any(b - a <= instant for a, b in pairwise(times)):
            raise Undecidable(f"{place}: events closer than {instant:.1e} in time")
    if residual > NUDGE:
        raise Undecidable(
            f"{place}: the residual of the impulses, {residual:.0e}, may decide the event; use a "
            "smaller impulse_tolerance"
        )
    if not all(trace.certified or trace.step is not None for trace in traces):
        raise Undecidable(f"{place}: a guard could not be decided")
    shown = [
        f"{e[0].what[0]} {e[0].what[1]} to {' '.join(e[0].what[3])}" if e else "nothing more"
        for e in (own, others)
    ]
    raise AssertionError(f"{place}: {shown[0]} in one run, {shown[1]} in the other")


def _event_label(i: int, event: Event) -> str:
    return f"event {i + 1} ({event.what[0]} {event.what[1]}, t = {event.t:.7g})"


@dataclass(frozen=True, eq=False)
class Reading:
    """Transformation of a trace of a transformed model to the original.

    Attributes
    ----------
    factors : (n,) array or float
        Original variable per transformed one.
    time : float
        Original time per transformed one.
    states : mapping
        Transformed -> original state of regions, if different.
    regions : mapping
        Transformed -> original name of regions, if different.
    untransformed : frozenset of str
        Regions whose states stay as they are.
    """

    factors: Array | float = 1.0
    time: float = 1.0
    states: Mapping[str, str] = field(default_factory=dict)
    regions: Mapping[str, str] = field(default_factory=dict)
    untransformed: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class Event:
    """A jump for comparison."""

    what: tuple[str, str, Key, Key]  # region, cause, mode before and after
    numbers: Array  # time, state before, state after
    skipped: float  # see `Jump`
    rounded: float = 0.0  # relative error by round-off until then
    rates: Array | float = 0.0  # time derivatives of the numbers
    hit: tuple[str, ...] = ()  # contacts in the order of impact

    @property
    def t(self) -> float:
        """The time."""
        return float(self.numbers[0])

    @property
    def resolved(self) -> Event:
        """The end of a Zeno sequence without data of its last resolved jump."""
        n = len(self.numbers) // 2
        after = self.numbers[n + 1 :]
        numbers = np.concatenate([self.numbers[:1], after, after])
        rates = np.zeros_like(numbers) + self.rates
        rates[1 : n + 1] = rates[n + 1 :]
        what = ("", self.what[1], (), self.what[3])
        return replace(self, what=what, numbers=numbers, rates=rates)


@dataclass(frozen=True, eq=False)
class EventSequence:
    """The events and the end of a run for comparison."""

    events: tuple[Event, ...]
    mode: Key  # final mode
    end: Array  # time, state, state
    sizes: Array  # largest magnitudes

    @classmethod
    def of(cls, trace: Trace, reading: Reading) -> EventSequence:
        """Return the sequence of a trace."""

        def region(name: str) -> str:
            return reading.regions.get(name, name)

        order = [trace.regions.index(region(name)) for name in trace.regions]
        maps = [{} if trace.regions[i] in reading.untransformed else reading.states for i in order]

        def key(mode: Key) -> Key:
            return tuple(
                states.get(mode[i], mode[i]) for i, states in zip(order, maps, strict=True)
            )

        def event(jump: Jump) -> Event:
            states = [jump.before * reading.factors, jump.after * reading.factors]
            return Event(
                (region(jump.region), jump.cause, key(jump.source), key(jump.target)),
                np.concatenate([[jump.t * reading.time], *states]),
                jump.skipped * reading.time,
                hit=tuple(region(piece.split()[0]) for piece in jump.path),
            )

        ends = [arc.coefficients[:, :, 0] for arc in trace.arcs]
        visited = np.concatenate([*ends, trace.initial[None], trace.final[None]]) * reading.factors
        sizes = np.abs(visited).max(axis=0)
        t_end, final = trace.t_end * reading.time, trace.final * reading.factors
        return cls(
            tuple(map(event, trace.jumps)),
            key(trace.final_mode),
            np.concatenate([[t_end], final, final]),
            np.concatenate([[t_end], sizes, sizes]),
        )

    def rounded(
        self, trace: Trace, conditions: Sequence[float | None], known: float
    ) -> EventSequence:
        """Add round-off (of states with relative error `known`) and rates to every event."""
        rounded, events = 0.0, []
        pairs = zip_longest(self.events, conditions[: len(self.events)])
        for (event, condition), rates in zip(pairs, _rates(trace), strict=True):
            rounded += known * min(condition or 0.0, 1.0 / known)
            events.append(replace(event, rounded=rounded, rates=rates))
        return replace(self, events=tuple(events))

    def shortened(self, t: float, state: Array) -> EventSequence:
        """Return the sequence up to a time with this state."""
        events = tuple(event for event in self.events if event.t <= t)
        first = self.events[0].what[2] if self.events else self.mode
        mode = events[-1].what[3] if events else first
        return replace(self, events=events, mode=mode, end=np.concatenate([[t], state, state]))


def _rates(trace: Trace) -> list[Array]:
    """Return the time derivatives of the numbers of every jump, 0 for its time."""
    starts: dict[int, Array] = {}
    ends: dict[int, Array] = {}
    for arc in trace.arcs:
        first, last = arc.coefficients[0], arc.coefficients[-1]
        starts.setdefault(arc.j, first[:, 1:2].sum(axis=1) / arc.times[1])
        ends[arc.j] = last @ np.arange(last.shape[1]) / (arc.times[-1] - arc.times[-2])
    # The first of simultaneous jumps has an arc before it, the last one an arc after it.
    count, still = len(trace.jumps), np.zeros(len(trace.variables))
    before = [*accumulate(range(count), lambda rates, j: ends.get(j, rates), initial=still)]
    after = [*accumulate(range(count, 0, -1), lambda r, j: starts.get(j, r), initial=still)]
    pairs = zip(before[1:], after[:0:-1], strict=True)
    return [np.abs(np.concatenate([[0.0], *pair])) for pair in pairs]


def without_unresolved(sequences: list[EventSequence]) -> list[EventSequence]:
    """Omit the bounces that at least one run skipped; see `drop_summed`."""
    left = drop_summed([sequence.events for sequence in sequences])
    if left is None:
        return sequences
    return [
        replace(sequence, events=tuple(event.resolved if end else event for event, end in events))
        for sequence, events in zip(sequences, left, strict=True)
    ]
