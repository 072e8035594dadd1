"""The events of a run as numbers, so that two runs can be compared event by event."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, zip_longest

import numpy as np

from statechart.arrays import Array
from statechart.automaton.trace import Jump, Key, Trace
from statechart.observation.zeno_tails import without_summed


@dataclass(frozen=True, eq=False)
class Reading:
    """Factors that turn a trace of a transformed model into one of the original.

    Attributes
    ----------
    factors : (n,) array or float
        Original variable per transformed one.
    time : float
        Original time per transformed one.
    states : mapping
        State of a region as transformed -> as original, where they differ.
    """

    factors: Array | float = 1.0
    time: float = 1.0
    states: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Event:
    """A jump as numbers to compare."""

    what: tuple[str, str, Key, Key]  # region, cause, mode before and after
    numbers: Array  # time, state before, state after
    skipped: float  # see `Jump`
    rounded: float = 0.0  # the relative error that rounding has caused by then
    rates: Array | float = 0.0  # how fast the numbers change
    # The first words of its path: the contacts in the order in which they were hit.
    hit: tuple[str, ...] = ()

    @property
    def t(self) -> float:
        """Its time."""
        return float(self.numbers[0])

    @property
    def resolved(self) -> Event:
        """The end of a sequence without what depends on which jump was the last resolved."""
        n = len(self.numbers) // 2
        after = self.numbers[n + 1 :]
        numbers = np.concatenate([self.numbers[:1], after, after])
        rates = np.zeros_like(numbers) + self.rates
        rates[1 : n + 1] = rates[n + 1 :]
        what = ("", self.what[1], (), self.what[3])
        return replace(self, what=what, numbers=numbers, rates=rates)


@dataclass(frozen=True, eq=False)
class EventSequence:
    """The events and the end of a run, as numbers."""

    events: tuple[Event, ...]  # in order
    mode: Key  # the last one
    end: Array  # where it ended (time, state, state), and how large all gets
    sizes: Array

    @classmethod
    def of(cls, trace: Trace, reading: Reading) -> EventSequence:
        """Read a trace."""

        def key(mode: Key) -> Key:
            return tuple(reading.states.get(state, state) for state in mode)

        def event(jump: Jump) -> Event:
            states = [jump.before * reading.factors, jump.after * reading.factors]
            return Event(
                (jump.region, jump.cause, key(jump.source), key(jump.target)),
                np.concatenate([[jump.t * reading.time], *states]),
                jump.skipped * reading.time,
                hit=tuple(piece.split()[0] for piece in jump.path),
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
        """Note at every event what it makes of states known to the part `known`, and its rates."""
        rounded, events = 0.0, []
        pairs = zip_longest(self.events, conditions[: len(self.events)])
        for (event, condition), rates in zip(pairs, _rates(trace), strict=True):
            rounded += known * min(condition or 0.0, 1.0 / known)
            events.append(replace(event, rounded=rounded, rates=rates))
        return replace(self, events=tuple(events))

    def shortened(self, t: float, state: Array) -> EventSequence:
        """Return it up to a time, when it has this state."""
        events = tuple(event for event in self.events if event.t <= t)
        first = self.events[0].what[2] if self.events else self.mode
        mode = events[-1].what[3] if events else first
        return replace(self, events=events, mode=mode, end=np.concatenate([[t], state, state]))


def _rates(trace: Trace) -> list[Array]:
    """Return how fast the numbers of every jump change, 0 for its time."""
    starts: dict[int, Array] = {}
    ends: dict[int, Array] = {}
    for arc in trace.arcs:
        first, last = arc.coefficients[0], arc.coefficients[-1]
        starts.setdefault(arc.j, first[:, 1:2].sum(axis=1) / arc.times[1])
        ends[arc.j] = last @ np.arange(last.shape[1]) / (arc.times[-1] - arc.times[-2])
    # Of jumps at one instant the first has an arc before it, and the last one after it.
    count, still = len(trace.jumps), np.zeros(len(trace.variables))
    before = [*accumulate(range(count), lambda rates, j: ends.get(j, rates), initial=still)]
    after = [*accumulate(range(count, 0, -1), lambda r, j: starts.get(j, r), initial=still)]
    pairs = zip(before[1:], after[:0:-1], strict=True)
    return [np.abs(np.concatenate([[0.0], *pair])) for pair in pairs]


def without_unresolved(sequences: list[EventSequence]) -> list[EventSequence]:
    """Leave out the bounces that at least one run summed up; see `without_summed`."""
    left = without_summed([sequence.events for sequence in sequences])
    if left is None:
        return sequences
    return [
        replace(sequence, events=tuple(event.resolved if end else event for event, end in events))
        for sequence, events in zip(sequences, left, strict=True)
    ]
