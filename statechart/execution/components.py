"""Runs of independent components, each with its own steps and events, merged into one run.

As in event-driven molecular dynamics (B. J. Alder and T. E. Wainwright, 1959) the next event is the
earliest of the components' next events, and an event of one component restarts no other. Merged
states are assembled lazily on the common refinement of the steps.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import TypeVar

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton, Component, Places
from statechart.automaton.clock import Clock, between
from statechart.automaton.laws import Setup, roles_in
from statechart.automaton.lazy import LazyMapping, LazySequence
from statechart.automaton.trace import Arc, Jump, Key, Outcome, Roles, Trace
from statechart.automaton.trace_store import jump_times
from statechart.formulas.tape import Tape
from statechart.tabular import pluralise

# Distance of simultaneous instants, in units in the last place of time.
_ONE_INSTANT = 4.0
_ULP = float(np.finfo(float).eps)
_T = TypeVar("_T")

# Jumps up to which merged arcs and jumps are cached.
_MAX_CACHED_JUMPS = 1 << 12


class _ComponentRun:
    """The run of a component."""

    def __init__(self, component: Component, places: Places, trace: Trace) -> None:
        self.component, self.places, self.trace = component, places, trace
        self.times = jump_times(trace.jumps)
        self.numbers: list[int] = []  # Numbers of its jumps in the merged run

    @cached_property
    def arcs(self) -> list[Arc]:
        return list(self.trace.arcs)

    @cached_property
    def starts(self) -> list[Clock]:
        return [arc.start for arc in self.arcs]

    def rank(self, j: int) -> tuple[bool, int, str]:
        """Return whether its jump `j` is alone, the place of its region in the whole, its cause."""
        jump = self.trace.jumps[j]
        place = self.component.automaton.region_names.index(jump.region)
        alone = jump.region not in self.component.jump_together
        return alone, self.places.regions[place].item(), jump.cause

    def key(self, count: int) -> Key:
        """Return its mode after `count` of its jumps."""
        return self.trace.jumps[count - 1].target if count else self.trace.start_mode

    def roles(self, count: int) -> Roles:
        """Return its roles after `count` of its jumps."""
        place = bisect_left(self.arcs, count, key=lambda arc: arc.j)
        if place < len(self.arcs) and self.arcs[place].j == count:
            return self.arcs[place].roles
        return self.trace.passed_roles.get(count) or roles_in(self.key(count))

    def arc(self, time: Clock) -> Arc:
        return self.arcs[max(bisect_right(self.starts, time) - 1, 0)]

    def state(self, time: Clock) -> Array:
        """Return its state at a time without a jump of its own."""
        if not self.arcs:
            return self.trace.initial
        arc = self.arc(time)
        local = min(max(between(arc.start, time), 0.0), arc.duration)
        return arc.states(np.array([local]))[0]

    def state_at(self, count: int, time: Clock) -> Array:
        """Return its state at a time of the merged run, after `count` own jumps."""
        same_instant = _ONE_INSTANT * _ULP * time.high
        if count and time.high - self.times[count - 1] <= same_instant:
            return self.trace.jumps[count - 1].after
        if count < len(self.times) and self.times[count] - time.high <= same_instant:
            return self.trace.jumps[count].before
        return self.state(time)

    def energy(self, time: Clock) -> float:
        """Return its energy at a time without a jump of its own."""
        tape = _energy(self.component.automaton)
        return tape.at(self.state(time), self.trace.values, time.high).item()


class MergedRun:
    """Merged run of an automaton from those of its components."""

    def __init__(
        self, automaton: Automaton, setup: Setup, runs: Sequence[tuple[Component, Places, Trace]]
    ) -> None:
        self._automaton, self._setup = automaton, setup
        self._parts = [_ComponentRun(*run) for run in runs]
        ends = [run.trace.t_end for run in self._parts]
        # The component that ends first; one that stops precedes one at the end of time.
        at_end = [run.trace.outcome is Outcome.HORIZON for run in self._parts]
        self._last = min(range(len(ends)), key=lambda place: (ends[place], at_end[place]))
        self.end = ends[self._last]
        ended, until = self._parts[self._last], self.end * (1.0 + _ONE_INSTANT * _ULP)
        stops = ended.trace.outcome is Outcome.STOPPED
        groups = self._instants(
            sorted(
                (time, place, j)
                for place, run in enumerate(self._parts)
                for j, time in enumerate(run.times[: -1 if stops and run is ended else None])
                if time <= until
            )
        )
        if stops:
            # Other events of this instant precede the stop.
            groups.append((self.end, {self._last: len(ended.times) - 1}))
        self.many = len(groups) >= automaton.max_jumps
        if self.many:
            groups = groups[: automaton.max_jumps]
            self.end = groups[-1][0]
        self._groups = groups
        self._times = [time for time, _ in groups]
        for number, (_, jumping) in enumerate(groups):
            for place in jumping:
                self._parts[place].numbers.append(number)

    def trace(self, engine: str, tolerance: float, modes_built: int) -> Trace:
        """Return the merged trace."""
        automaton, runs = self._automaton, self._parts
        ended = runs[self._last]
        outcome, message = ended.trace.outcome, ended.component.named(ended.trace.message)
        if self.many:
            outcome, message = Outcome.TOO_MANY_JUMPS, pluralise(len(self._groups), "jump")
        end, jumps = Clock(self.end), len(self._groups)
        finals = [
            run.trace.final
            if run.trace.t_end == self.end and len(run.numbers) == len(run.times)
            else run.state_at(len(run.numbers), end)
            for run in runs
        ]
        counts = {
            name: sum(run.trace.counts[name] for run in runs)
            for name in ("steps", "evaluations", "boxes", "python_instants")
        }
        names_of_run = [(run.component.named, run.trace) for run in runs]
        proved = all(trace.certified for _, trace in names_of_run)
        return automaton.trace(
            self._setup.values,
            arcs=LazySequence(
                self._arc, lambda: len(self._spans), cached=jumps < _MAX_CACHED_JUMPS
            ),
            jumps=LazySequence(self._jump, lambda: jumps, cached=jumps < _MAX_CACHED_JUMPS),
            initial=self._state([run.trace.initial for run in runs]),
            final=self._state(finals),
            start_mode=self._by_regions([run.trace.start_mode for run in runs]),
            final_mode=self._by_regions([run.key(len(run.numbers)) for run in runs]),
            passed_roles=self._passed_roles(),
            t_end=self.end,
            outcome=outcome,
            message=message,
            certified=proved and "guards",
            evidence=LazyMapping(
                lambda: {
                    name(k): v
                    for name, run_warning in names_of_run
                    for k, v in run_warning.evidence.items()
                }
            ),
            tolerances=dict(self._setup.tolerances),
            engine=engine,
            tolerance=tolerance,
            warnings=tuple(
                dict.fromkeys(
                    (
                        *self._setup.warnings,
                        *(
                            name(text)
                            for name, run_warning in names_of_run
                            for text in run_warning.warnings
                        ),
                    )
                )
            ),
            counts={**counts, "jumps": jumps, "modes_built": modes_built},
        )

    def _instants(
        self, jumps: Sequence[tuple[float, int, int]]
    ) -> list[tuple[float, dict[int, int]]]:
        """Group jumps (time, component, number): time, and component -> number of its jump.

        At one instant, as in one component, contacts jump first, together if they have the same
        cause, then declared regions one by one in the order of the document.
        """
        instants: list[tuple[float, dict[int, int]]] = []
        waiting: dict[int, list[int]] = {}
        first = previous = -math.inf
        for time, place, j in jumps:
            if waiting and time - previous > _ONE_INSTANT * _ULP * time:
                instants += ((first, jumping) for jumping in self._in_order(waiting))
                waiting = {}
            if not waiting:
                first = time
            previous = time
            waiting.setdefault(place, []).append(j)
        instants += ((first, jumping) for jumping in self._in_order(waiting))
        return instants

    def _in_order(self, waiting: Mapping[int, Sequence[int]]) -> Iterator[dict[int, int]]:
        """Yield the jumps of one instant, component -> number, from those of each component."""
        if len(waiting) == 1:
            ((place, numbers),) = waiting.items()
            yield from ({place: j} for j in numbers)
            return
        remaining = {place: deque(numbers) for place, numbers in waiting.items()}
        while remaining:
            ranks = {place: self._parts[place].rank(js[0]) for place, js in remaining.items()}
            places = sorted(remaining, key=ranks.__getitem__)
            alone, _, cause = ranks[places[0]]
            together = (
                places[:1] if alone else [p for p in places if ranks[p][::2] == (alone, cause)]
            )
            yield {place: remaining[place].popleft() for place in together}
            remaining = {place: js for place, js in remaining.items() if js}

    def _state(self, states: Sequence[Array]) -> Array:
        merged = np.empty(len(self._automaton.variables))
        for run, state in zip(self._parts, states, strict=True):
            merged[run.places.variables] = state
        return merged

    def _by_regions(self, parts: Iterable[Sequence[_T]]) -> tuple[_T, ...]:
        """Merge values of the regions of every component."""
        merged: dict[int, _T] = {}
        for run, part in zip(self._parts, parts, strict=True):
            merged |= zip(run.places.regions.tolist(), part, strict=True)
        return tuple(merged[place] for place in range(len(self._automaton.regions)))

    def _passed_roles(self) -> dict[int, Roles]:
        numbers = set[int]()
        for run in self._parts:
            starts = [0, *(number + 1 for number in run.numbers), len(self._groups) + 1]
            for count in run.trace.passed_roles:
                if count <= len(run.numbers):
                    numbers.update(range(starts[count], starts[count + 1]))
        counts = {n: [bisect_right(run.numbers, n - 1) for run in self._parts] for n in numbers}
        return {n: self._roles(map(_ComponentRun.roles, self._parts, counts[n])) for n in numbers}

    def _roles(self, roles: Iterable[Roles]) -> Roles:
        return self._by_regions(
            [run.component.shown(role, run.places) for role in own]
            for run, own in zip(self._parts, roles, strict=True)
        )

    def _jump(self, number: int) -> Jump:
        time, places = self._groups[number]
        jumps = {place: self._parts[place].trace.jumps[j] for place, j in places.items()}
        counts = [bisect_right(run.numbers, number - 1) for run in self._parts]
        before = [run.key(count) for run, count in zip(self._parts, counts, strict=True)]
        after = [jumps[k].target if k in jumps else key for k, key in enumerate(before)]
        clock = Clock(time)
        others = {
            k: run.state_at(counts[k], clock) for k, run in enumerate(self._parts) if k not in jumps
        }
        states = others | {k: jump.before for k, jump in jumps.items()}
        states_after = others | {k: jump.after for k, jump in jumps.items()}
        named_jumps = [(self._parts[place].component.named, jump) for place, jump in jumps.items()]
        name, first_jump = named_jumps[0]
        considered = [(name, jump.considered) for name, jump in named_jumps]
        energy = first_jump.energy
        if energy is not None:
            rest = sum(self._parts[k].energy(clock) for k in others)
            energies = [jump.energy for jump in jumps.values() if jump.energy is not None]
            start, end = (rest + sum(side) for side in zip(*energies, strict=True))
            energy = start, end
        return replace(
            first_jump,
            t=time,
            j=number,
            region=name(first_jump.region),
            cause=name(first_jump.cause),
            source=self._by_regions(before),
            target=self._by_regions(after),
            before=self._state([states[k] for k in range(len(states))]),
            after=self._state([states_after[k] for k in range(len(states))]),
            fired=tuple(name(margin) for margin in first_jump.fired),
            impulse={name(k): v for name, jump in named_jumps for k, v in jump.impulse.items()},
            joint_impulse={
                name(k): v for name, jump in named_jumps for k, v in jump.joint_impulse.items()
            },
            path=tuple(name(text) for name, jump in named_jumps for text in jump.path),
            considered=LazyMapping(
                lambda: {name(k): name(v) for name, modes in considered for k, v in modes.items()}
            ),
            energy=energy,
            skipped=max(jump.skipped for _, jump in named_jumps),
        )

    @cached_property
    def _spans(self) -> list[tuple[Clock, Clock]]:
        """Starts and ends of the merged arcs: a component jumps or starts an arc there."""
        end = Clock(self.end)
        spans = {Clock()} | {s for run in self._parts for s in run.starts if s < end}
        starts: list[Clock] = []
        jumps = {*self._times}
        for start in sorted(spans):
            same_instant = _ONE_INSTANT * _ULP * start.high
            if not starts or between(starts[-1], start) > same_instant:
                starts.append(start)
            elif start.high in jumps and starts[-1].high not in jumps:
                starts[-1] = start  # An arc that follows no jump starts beside a jump.
        previous = max((run.arcs[-1].end for run in self._parts if run.arcs), default=end)
        ends = [*starts[1:], min(previous, end) if previous.high == end.high else end]
        return [pair for pair in zip(starts, ends, strict=True) if between(*pair) > 0.0]

    def _arc(self, place: int) -> Arc:
        start, duration = _fitted(*self._spans[place])
        number = bisect_right(self._times, start.high + _ONE_INSTANT * _ULP * start.high)
        middle = start.later(0.5 * duration)
        active_arcs = [(run, run.arc(middle)) for run in self._parts]
        marks = [np.array([0.0, duration])]
        for _, arc in active_arcs:
            local = arc.times + between(start, arc.start)
            marks.append(local[(local > 0.0) & (local < duration)])
        times = np.unique(np.concatenate(marks))
        # Steps that end within round-off of each other are merged.
        keep = np.diff(times, prepend=-math.inf) > _ONE_INSTANT * _ULP * (start.high + duration)
        keep[-1] = False
        times = np.append(times[keep], duration)
        terms = max(arc.coefficients.shape[2] for _, arc in active_arcs)
        coefficients = np.zeros((len(times) - 1, len(self._automaton.variables), terms))
        keys: list[Key] = []
        roles: list[Roles] = []
        for run, arc in active_arcs:
            keys.append(arc.mode)
            roles.append(arc.roles)
            begins = times[:-1] + between(arc.start, start)
            cut = _restricted_steps(arc, begins, np.diff(times))
            coefficients[:, run.places.variables, : cut.shape[2]] = cut
        return Arc(self._by_regions(keys), self._roles(roles), start, number, times, coefficients)


def _fitted(start: Clock, end: Clock) -> tuple[Clock, float]:
    """Return start and duration of an arc; the last bit of one changes so that it meets its end."""
    duration = between(start, end)
    for near in (duration, math.nextafter(duration, math.inf), math.nextafter(duration, 0.0)):
        if start.later(near).high == end.high:
            return start, near
    # Sums half-way between two floats round to the even one.
    return start._replace(low=start.low + between(start.later(duration), end)), duration


@lru_cache(maxsize=64)
def _energy(automaton: Automaton) -> Tape:
    return automaton.tape([automaton.observables["energy"]])


def _restricted_steps(arc: Arc, begins: Array, lengths: Array) -> Array:
    """Return the polynomials of an arc over intervals (m,), each within one of its steps."""
    middles = begins + 0.5 * lengths
    steps = np.clip(np.searchsorted(arc.times, middles, side="right") - 1, 0, len(arc.times) - 2)
    step_lengths = np.diff(arc.times)[steps]
    shift = np.clip((begins - arc.times[steps]) / step_lengths, 0.0, 1.0)
    scale = lengths / step_lengths
    # c'_i = sum_k c_k binom(k, i) shift^(k - i) scale^i
    i = np.arange(arc.coefficients.shape[2])
    powers = shift[:, None, None] ** np.maximum(i[None, :] - i[:, None], 0)
    binomials = np.array([[math.comb(k, row) for k in i.tolist()] for row in i.tolist()], float)
    matrix = binomials * powers * (scale[:, None] ** i)[:, :, None]
    return np.einsum("mik,mvk->mvi", matrix, arc.coefficients[steps])
