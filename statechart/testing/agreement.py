"""Comparison of two runs that should agree within their errors.

The growth of errors is measured by runs with parameters perturbed by a relative `NUDGE`, and by the
condition numbers of events. If perturbations change the sequence of events, or errors grow too
large, agreement cannot be decided, and `Undecidable` is raised.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, islice, pairwise, zip_longest
from typing import NoReturn

import numpy as np

from statechart.arrays import Array
from statechart.automaton.trace import Jump, Key, Trace, sizes
from statechart.observation.alignment import Event, resolved_events

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
    runs = [reference, *sensitivity.nudged]
    if until is not None:
        runs = [_shortened(run, *until) for run in runs]
    runs.append(other if reading is None else reading.apply(other))
    scales = np.concatenate([[reference.t_end], *[sizes(reference)] * 2])
    rounded, rates = _rounded(reference, sensitivity.conditions, known), _rates(reference)
    first, *near, second = resolved_events([run.jumps for run in runs])
    error = bare = _STEP_ERRORS * (_error(reference) + _error(other) + residual)
    floor = np.zeros(len(scales))
    traces = (reference,) if reading else (reference, other)
    # The gap tolerance of time stepping is penetration, not a projection.
    kinds = [("speed",) if t.step is not None else ("gap", "speed") for t in traces]
    pairs = [(trace, kind) for trace, own in zip(traces, kinds, strict=True) for kind in own]
    floor[1:] = sum(trace.tolerances.get(kind, 0.0) for trace, kind in pairs)
    for i, (mine, its) in enumerate(zip_longest(first, second)):
        if mine and its:
            error = bare + rounded[mine.jump.j]
        if not (mine and its and mine.matches(its)):
            _raise_if_tolerances_decide(loosened, other, i, mine or its)
            both, ends = (first, second), (runs[0].t_end, runs[-1].t_end)
            _raise_difference(both, near, i, error, scales, ends, residual, (reference, other))
        shaken = [s for s in near if len(s) > i and s[i].matches(mine)]
        allowed = _allowed(mine, [s[i].numbers for s in shaken], scales, error, floor)
        if len(shaken) < len(near):
            raise Undecidable(f"{_event_label(i, mine)}: {_ANOTHER_COURSE}")
        near = shaken
        # States at different times differ by the motion in between.
        moves = rates[mine.jump.j]
        allowed[1:] += abs(mine.jump.t - its.jump.t) * moves[[int(mine.ends), 1]].ravel()
        if _hit(mine.jump) != _hit(its.jump):
            _raise_undecidable_hit(first, second, i, scales, NUDGE * runs[0].t_end)
        _assert_close(mine.numbers, its.numbers, allowed, reference, _event_label(i, mine))
    if any(len(events) != len(first) for events in near):
        raise Undecidable(f"the end: {_ANOTHER_COURSE}")
    if runs[0].final_mode != runs[-1].final_mode:
        message = f"{runs[0].final_mode} at the end of one run, {runs[-1].final_mode} of the other"
        raise AssertionError(message)
    last, *others = (_end(run) for run in runs)
    allowed = _allowed(last, [one.numbers for one in others[: len(near)]], scales, error, floor)
    _assert_close(last.numbers, others[-1].numbers, allowed, reference, "the end")


def _end(run: Trace) -> Event:
    """Return the end of a run as an event."""
    mode, state = run.final_mode, run.final
    return Event(Jump(run.t_end, len(run.jumps), "", "end", mode, mode, state, state), ends=False)


def _hit(jump: Jump) -> tuple[str, ...]:
    """Return the contacts of a jump in the order of impact."""
    return tuple(piece.split()[0] for piece in jump.path)


def _shortened(trace: Trace, t: float, state: Array) -> Trace:
    """Return a run up to a time with this state."""
    jumps = tuple(jump for jump in trace.jumps if jump.t <= t)
    mode = jumps[-1].target if jumps else trace.start_mode
    return replace(trace, jumps=jumps, t_end=t, final=state, final_mode=mode)


def identical(reference: Trace, other: Trace, reading: Reading) -> bool:
    """Return whether two runs have bitwise equal events and end."""
    runs = reference, reading.apply(other)
    found = [[*(Event(jump, ends=False) for jump in run.jumps), _end(run)] for run in runs]
    return len(found[0]) == len(found[1]) and all(
        mine.matches(its) and mine.numbers.tolist() == its.numbers.tolist()
        for mine, its in zip(*found, strict=True)
    )


def _error(trace: Trace) -> float:
    steps = trace.counts["steps"]
    if trace.step is not None:
        return (_START_EVENTS + steps) * _LOCATED
    return steps * trace.tolerance + (_START_EVENTS + len(trace.jumps)) * _LOCATED


def _allowed(
    event: Event, near: Sequence[Array], scales: Array, error: float, floor: Array
) -> Array:
    """Return the allowed difference: error times growth of a perturbation, and round-off."""
    grown = np.zeros(len(event.numbers))
    for numbers in near:
        grown = np.maximum(grown, np.abs(numbers - event.numbers) / NUDGE)
    allowed = error * (grown + scales)
    if (allowed > _CHAOTIC * scales + floor).any():
        raise Undecidable(f"by t = {event.jump.t:.6g} errors of {error:.0e} have grown too large")
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


def _raise_undecidable_hit(
    first: Sequence[Event], second: Sequence[Event], i: int, scales: Array, instant: float
) -> None:
    """Raise `Undecidable` if round-off decides which contacts event `i` hits.

    Impacts within the gap tolerance merge, and slow impacts of contacts that move together have no
    definite order.
    """
    for events in (first, second):
        for one, two in pairwise(events[i : i + 2]):
            if two.jump.t - one.jump.t <= instant:
                words = f"impacts closer than {instant:.1e} in time"
                place = _event_label(i, one)
                raise Undecidable(f"{place}: {words} are a single one in one of the runs")
    n = len(scales) // 2
    both = np.array([events[i].numbers for events in (first, second)])
    if (np.abs(both[:, n + 1 :] - both[:, 1 : n + 1]) <= _SLOW_IMPACT * scales[n + 1 :]).all():
        raise Undecidable(
            f"{_event_label(i, first[i])}: the impact is so slow that round-off decides "
            "which of the contacts that move together is hit first"
        )


def _raise_if_tolerances_decide(
    loosened: Callable[[], Trace] | None, other: Trace, i: int, event: Event
) -> None:
    """Raise `Undecidable` if the runs differ at `event` because of their tolerances."""
    if loosened is None:
        return
    first, second = resolved_events([loosened().jumps, other.jumps])
    count = sum(one.jump.t <= event.jump.t for one in second)
    ours, theirs = first[: count + 1], second[: count + 1]
    same = len(ours) == len(theirs) and all(map(Event.matches, ours, theirs))
    if same and not any(one.matches(event) for one in ours[count:]):
        raise Undecidable(
            f"{_event_label(i, event)}: with the tolerances of the other engine, this run has the "
            "events of the other run"
        )


def _raise_difference(
    both: tuple[Sequence[Event], Sequence[Event]],
    near: Sequence[Sequence[Event]],
    i: int,
    error: float,
    scales: Array,
    ends: tuple[float, float],
    residual: float,
    traces: tuple[Trace, Trace],
) -> NoReturn:
    """Raise the error for a different event `i`; runs end at `ends`."""
    own, others = (events[i : i + 1] for events in both)
    place = _event_label(i, (*own, *others)[0])
    there = [events[i : i + 1] for events in near]
    if any(len(one) != len(own) or not all(map(Event.matches, own, one)) for one in there):
        raise Undecidable(f"{place}: {_ANOTHER_COURSE}")
    instant = error * ends[0]
    if own:
        numbers = [events[i].numbers for events in near]
        instant = _allowed(own[0], numbers, scales, error, np.zeros(len(scales))).item(0)
    for events, end in zip(both, reversed(ends), strict=True):
        times = [event.jump.t for event in events[max(i - 1, 0) : i + 2]]
        at_end = any(abs(event.jump.t - end) <= instant for event in events[i : i + 1])
        if at_end or any(b - a <= instant for a, b in pairwise(times)):
            raise Undecidable(f"{place}: events closer than {instant:.1e} in time")
    if residual > NUDGE:
        raise Undecidable(
            f"{place}: the residual of the impulses, {residual:.0e}, may decide the event; use a "
            "smaller impulse_tolerance"
        )
    if not all(trace.certified or trace.step is not None for trace in traces):
        raise Undecidable(f"{place}: a guard could not be decided")
    shown = ["nothing more", "nothing more"]
    for k, event in ((k, e[0].jump) for k, e in enumerate((own, others)) if e):
        shown[k] = f"{event.region} {event.cause} to {' '.join(event.target)}"
    raise AssertionError(f"{place}: {shown[0]} in one run, {shown[1]} in the other")


def _event_label(i: int, event: Event) -> str:
    jump = event.jump
    return f"event {i + 1} ({jump.region} {jump.cause}, t = {jump.t:.7g})"


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

    def apply(self, trace: Trace) -> Trace:
        """Return a run, without its arcs, as one of the original model."""
        names = {name: self.regions.get(name, name) for name in trace.regions}
        order = [trace.regions.index(name) for name in names.values()]
        maps = [{} if trace.regions[i] in self.untransformed else self.states for i in order]

        def key(mode: Key) -> Key:
            states = [mode[i] for i in order]
            return tuple(known.get(state, state) for known, state in zip(maps, states, strict=True))

        def jump(one: Jump) -> Jump:
            return replace(
                one,
                t=one.t * self.time,
                region=names.get(one.region, one.region),
                source=key(one.source),
                target=key(one.target),
                before=one.before * self.factors,
                after=one.after * self.factors,
                path=tuple(names.get(name, name) for name in _hit(one)),
                skipped=one.skipped * self.time,
            )

        return replace(
            trace,
            arcs=(),
            jumps=tuple(map(jump, trace.jumps)),
            initial=trace.initial * self.factors,
            final=trace.final * self.factors,
            start_mode=key(trace.start_mode),
            final_mode=key(trace.final_mode),
            t_end=trace.t_end * self.time,
        )


def _rounded(trace: Trace, conditions: Sequence[float | None], known: float) -> list[float]:
    """Return the relative error by round-off at every jump, of states with error `known`."""
    own = (known * min(condition or 0.0, 1.0 / known) for condition in conditions)
    errors = [*islice(accumulate(own), len(trace.jumps))]
    return errors + [errors[-1] if errors else 0.0] * (len(trace.jumps) - len(errors))


def _rates(trace: Trace) -> list[Array]:
    """Return the time derivatives (2, n) of the states before and after every jump."""
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
    return [np.abs(pair) for pair in zip(before[1:], after[:0:-1], strict=True)]
