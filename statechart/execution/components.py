"""Runs of independent components, each by its own steps and events, merged to the run of the whole.

Event-driven molecular dynamics does the same (B. J. Alder and T. E. Wainwright, 1959): the next
event of the whole is the least of the components' next events, and an event of one restarts no
other. States of the whole are assembled on the common refinement of the steps when somebody looks.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton, Component, Places
from statechart.automaton.clock import Clock, between
from statechart.automaton.laws import Setup
from statechart.automaton.lazy import LazyMapping, LazySequence
from statechart.automaton.trace import Arc, Jump, Key, Outcome, Roles, Trace
from statechart.automaton.trace_store import jump_times
from statechart.formulas.tape import Tape
from statechart.tabular import several

# Instants this near, in units in the last place of time, are one.
_ONE_INSTANT = 4.0
_ULP = float(np.finfo(float).eps)
# Longer runs do not keep arcs and jumps that were read: each is as large as the whole.
_MAX_CACHED = 1 << 12


class _Part:
    """The run of a component."""

    def __init__(self, component: Component, places: Places, trace: Trace) -> None:
        self.component, self.places, self.trace = component, places, trace
        self.times = jump_times(trace.jumps)
        self.numbers: list[int] = []  # of its jumps among those of the whole

    @cached_property
    def arcs(self) -> list[Arc]:
        """Its arcs."""
        return list(self.trace.arcs)

    @cached_property
    def starts(self) -> list[Clock]:
        """Starts of the arcs."""
        return [arc.start for arc in self.arcs]

    def key(self, count: int) -> Key:
        """Return its mode after so many of its jumps."""
        return self.trace.jumps[count - 1].target if count else self.trace.start_mode

    def arc(self, time: Clock) -> Arc:
        """Return the arc that a time lies in."""
        return self.arcs[max(bisect_right(self.starts, time) - 1, 0)]

    def state(self, time: Clock) -> Array:
        """Return its state at a time at which it does not jump."""
        if not self.arcs:
            return self.trace.initial
        arc = self.arc(time)
        local = min(max(between(arc.start, time), 0.0), arc.duration)
        return arc.states(np.array([local]))[0]

    def state_at(self, count: int, time: Clock) -> Array:
        """Return its state at a jump of another component, after so many own jumps."""
        near = _ONE_INSTANT * _ULP * time.high
        if count and time.high - self.times[count - 1] <= near:
            return self.trace.jumps[count - 1].after
        if count < len(self.times) and self.times[count] - time.high <= near:
            return self.trace.jumps[count].before
        return self.state(time)

    def energy(self, time: Clock) -> float:
        """Return its energy at a time at which it does not jump."""
        tape = _energy(self.component.automaton)
        return tape.at(self.state(time), self.trace.values, time.high).item()


class MergedRun:
    """The run of a whole automaton from those of its components."""

    def __init__(
        self,
        automaton: Automaton,
        setup: Setup,
        parts: Sequence[tuple[Component, Places, Trace]],
        max_jumps: int,
    ) -> None:
        self._automaton, self._setup = automaton, setup
        self._parts = [_Part(*part) for part in parts]
        ends = [part.trace.t_end for part in self._parts]
        # Among those that end at one time, one that ends the run.
        at_end = [part.trace.outcome is Outcome.HORIZON for part in self._parts]
        self._last = min(range(len(ends)), key=lambda place: (ends[place], at_end[place]))
        self.end = ends[self._last]
        ended, until = self._parts[self._last], self.end * (1.0 + _ONE_INSTANT * _ULP)
        stops = ended.trace.outcome is Outcome.STOPPED
        groups = _instants(
            sorted(
                (time, place, j)
                for place, part in enumerate(self._parts)
                for j, time in enumerate(part.times[: -1 if stops and part is ended else None])
                if time <= until
            ),
            joint=self._parts[0].component.joint,
        )
        if stops:
            # Other events of this instant come first.
            groups.append((self.end, {self._last: len(ended.times) - 1}))
        self.many = len(groups) >= max_jumps
        if self.many:
            groups = groups[:max_jumps]
            self.end = groups[-1][0]
        self._groups = groups
        self._times = [time for time, _ in groups]
        for number, (_, jumping) in enumerate(groups):
            for place in jumping:
                self._parts[place].numbers.append(number)

    def trace(self, engine: str, tolerance: float, modes_built: int) -> Trace:
        """Return the trace of the whole."""
        automaton, parts = self._automaton, self._parts
        ended = parts[self._last]
        outcome, message = ended.trace.outcome, ended.component.named(ended.trace.message)
        if self.many:
            outcome, message = Outcome.TOO_MANY_JUMPS, several(len(self._groups), "jump")
        end, jumps = Clock(self.end), len(self._groups)
        finals = [
            part.trace.final
            if part.trace.t_end == self.end and len(part.numbers) == len(part.times)
            else self._after(part, end)
            for part in parts
        ]
        counts = {
            name: sum(part.trace.counts[name] for part in parts)
            for name in ("steps", "evaluations", "boxes", "python_instants")
        }
        named = [(part.component.named, part.trace) for part in parts]
        proved = all(trace.certified for _, trace in named)
        return automaton.trace(
            self._setup.values,
            arcs=LazySequence(self._arc, lambda: len(self._spans), cached=jumps < _MAX_CACHED),
            jumps=LazySequence(self._jump, lambda: jumps, cached=jumps < _MAX_CACHED),
            initial=self._state([part.trace.initial for part in parts]),
            final=self._state(finals),
            start_mode=self._key([part.trace.start_mode for part in parts]),
            final_mode=self._key([part.key(len(part.numbers)) for part in parts]),
            t_end=self.end,
            outcome=outcome,
            message=message,
            certified=proved and "guards",
            evidence=LazyMapping(
                lambda: {name(k): v for name, one in named for k, v in one.evidence.items()}
            ),
            tolerances=dict(self._setup.tolerances),
            engine=engine,
            tolerance=tolerance,
            warnings=tuple(
                dict.fromkeys(
                    (
                        *self._setup.warnings,
                        *(name(text) for name, one in named for text in one.warnings),
                    )
                )
            ),
            counts={**counts, "jumps": jumps, "modes_built": modes_built},
        )

    def _after(self, part: _Part, time: Clock) -> Array:
        """Return the state of a component at a time, after its own jumps there."""
        count = len(part.numbers)
        if count and part.times[count - 1] >= time.high:
            return part.trace.jumps[count - 1].after
        return part.state(time)

    def _state(self, states: Sequence[Array]) -> Array:
        found = np.empty(len(self._automaton.variables))
        for part, state in zip(self._parts, states, strict=True):
            found[part.places.variables] = state
        return found

    def _key(self, keys: Sequence[Key]) -> Key:
        found = [""] * len(self._automaton.regions)
        for part, key in zip(self._parts, keys, strict=True):
            for place, state in zip(part.places.regions.tolist(), key, strict=True):
                found[place] = state
        return tuple(found)

    def _jump(self, number: int) -> Jump:
        """Return a jump of the whole."""
        time, places = self._groups[number]
        jumps = {place: self._parts[place].trace.jumps[j] for place, j in places.items()}
        counts = [bisect_right(part.numbers, number - 1) for part in self._parts]
        before = [part.key(count) for part, count in zip(self._parts, counts, strict=True)]
        after = [jumps[k].target if k in jumps else key for k, key in enumerate(before)]
        now = Clock(time)
        beside = {
            k: part.state_at(counts[k], now) for k, part in enumerate(self._parts) if k not in jumps
        }
        states = [beside[k] if k in beside else jumps[k].before for k in range(len(before))]
        left = [beside[k] if k in beside else jumps[k].after for k in range(len(before))]
        named = [(self._parts[place].component.named, jump) for place, jump in jumps.items()]
        name, first = named[0]
        considered = [(name, jump.considered) for name, jump in named]
        energy = first.energy
        if energy is not None:
            rest = sum(part.energy(now) for k, part in enumerate(self._parts) if k in beside)
            pairs = [jump.energy for jump in jumps.values() if jump.energy is not None]
            energy = rest + sum(pair[0] for pair in pairs), rest + sum(pair[1] for pair in pairs)
        return replace(
            first,
            t=time,
            j=number,
            region=name(first.region),
            cause=name(first.cause),
            source=self._key(before),
            target=self._key(after),
            before=self._state(states),
            after=self._state(left),
            fired=tuple(name(margin) for margin in first.fired),
            impulse={name(k): v for name, jump in named for k, v in jump.impulse.items()},
            path=tuple(name(text) for name, jump in named for text in jump.path),
            considered=LazyMapping(
                lambda: {name(k): name(v) for name, modes in considered for k, v in modes.items()}
            ),
            energy=energy,
            skipped=max(jump.skipped for _, jump in named),
        )

    @cached_property
    def _spans(self) -> list[tuple[Clock, Clock]]:
        """Starts and ends of the arcs of the whole, wherever a component jumps or starts an arc."""
        end = Clock(self.end)
        found = {Clock()} | {s for part in self._parts for s in part.starts if s < end}
        starts: list[Clock] = []
        for start in sorted(found):
            near = _ONE_INSTANT * _ULP * start.high
            if not starts or between(starts[-1], start) > near:
                starts.append(start)
        last = max((part.arcs[-1].end for part in self._parts if part.arcs), default=end)
        ends = [*starts[1:], min(last, end) if last.high == end.high else end]
        return [pair for pair in zip(starts, ends, strict=True) if between(*pair) > 0.0]

    def _arc(self, place: int) -> Arc:
        """Return an arc of the whole, its polynomials on the common refinement of the steps."""
        start, end = self._spans[place]
        duration = between(start, end)
        number = bisect_right(self._times, start.high + _ONE_INSTANT * _ULP * start.high)
        middle = start.later(0.5 * duration)
        flying = [(part, part.arc(middle)) for part in self._parts]
        marks = [np.array([0.0, duration])]
        for _, arc in flying:
            local = arc.times + between(start, arc.start)
            marks.append(local[(local > 0.0) & (local < duration)])
        times = np.unique(np.concatenate(marks))
        # Steps that end within the last bits of each other end together.
        keep = np.diff(times, prepend=-math.inf) > _ONE_INSTANT * _ULP * (start.high + duration)
        keep[-1] = False
        times = np.append(times[keep], duration)
        terms = max(arc.coefficients.shape[2] for _, arc in flying)
        coefficients = np.zeros((len(times) - 1, len(self._automaton.variables), terms))
        keys: list[Key] = []
        roles: list[Roles] = []
        for part, arc in flying:
            keys.append(arc.mode)
            roles.append(arc.roles)
            begins = times[:-1] + between(arc.start, start)
            cut = _restricted_steps(arc, begins, np.diff(times))
            coefficients[:, part.places.variables, : cut.shape[2]] = cut
        found = [roles[0][0]] * len(self._automaton.regions)
        for part, own in zip(self._parts, roles, strict=True):
            for region, role in zip(part.places.regions.tolist(), own, strict=True):
                found[region] = part.component.shown(role, part.places)
        return Arc(self._key(keys), tuple(found), start, number, times, coefficients)


def _instants(
    jumps: Sequence[tuple[float, int, int]], *, joint: bool
) -> list[tuple[float, dict[int, int]]]:
    """Return jumps (time, component, number) in order of time as those of the whole.

    Each is the time of its instant, and component -> number of its jump. Components that jump at
    one instant do so in one `joint` jump, the first jumps of all of them before the second ones; or
    one after another, in their order.
    """
    if not joint:
        order: list[tuple[float, int, int]] = []
        instant = last = -math.inf
        for time, place, j in jumps:
            if time - last > _ONE_INSTANT * _ULP * time:
                instant = time
            last = time
            order.append((instant, place, j))
        return [(time, {place: j}) for time, place, j in sorted(order)]
    found: list[tuple[float, dict[int, int]]] = []
    first, instant, last = 0, -math.inf, -math.inf
    for time, place, j in jumps:
        if time - last > _ONE_INSTANT * _ULP * time:
            first, instant = len(found), time
        last = time
        rank = next((k for k in range(first, len(found)) if place not in found[k][1]), len(found))
        if rank == len(found):
            found.append((instant, {}))
        found[rank][1][place] = j
    return found


@lru_cache(maxsize=64)
def _energy(automaton: Automaton) -> Tape:
    return automaton.tape([automaton.observables["energy"]])


def _restricted_steps(arc: Arc, begins: Array, lengths: Array) -> Array:
    """Return the polynomials of an arc over intervals (m,), each within one of its steps."""
    middles = begins + 0.5 * lengths
    steps = np.clip(np.searchsorted(arc.times, middles, side="right") - 1, 0, len(arc.times) - 2)
    whole = np.diff(arc.times)[steps]
    shift = np.clip((begins - arc.times[steps]) / whole, 0.0, 1.0)
    scale = lengths / whole
    # c'_i = sum_k c_k binom(k, i) shift^(k - i) scale^i
    i = np.arange(arc.coefficients.shape[2])
    powers = shift[:, None, None] ** np.maximum(i[None, :] - i[:, None], 0)
    binomials = np.array([[math.comb(k, row) for k in i.tolist()] for row in i.tolist()], float)
    matrix = binomials * powers * (scale[:, None] ** i)[:, :, None]
    return np.einsum("mik,mvk->mvi", matrix, arc.coefficients[steps])
