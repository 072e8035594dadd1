"""Grazing guards: minima of a margin near zero that the error of a run leaves undecided.

A guard that only touches its boundary does not fire. A graze is undecided if the least value of the
margin, or its overshoot, is below the change of the margin by the errors of all variables. A larger
overshoot below the tolerance at the start of the flow is a missed event, and is reported too.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence, Set
from functools import cached_property
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Ints
from statechart.automaton.laws import uncaptured
from statechart.automaton.margin_derivatives import derivative
from statechart.automaton.regions import whole_margins
from statechart.automaton.trace import Arc, Jump, Roles, Trace, sizes
from statechart.engines.compiled_flow import EVALUATION_ROUND_OFF
from statechart.execution.event_classification import (
    STATE_ROUND_OFF,
    STATE_TOLERANCES,
    margin_errors,
)
from statechart.execution.simulator import Simulator
from statechart.formulas.condition import AtomsAt
from statechart.formulas.tape import Tape, contiguous
from statechart.observation.observer import Observer
from statechart.observation.sampling import sample_arcs, subdivide

# Samples per step, and arcs per batch.
_GRID, _MAX_ARCS = 16, 1024
# Distance of an additional sample from the end of an arc, relative to the step.
_EDGE = 1.0 / 4096.0
# Refinements of a minimum, each of which divides its bracket by 8, and the bracket in spacings of
# floats where they end.
_REFINEMENTS, _NARROWEST = 18, 4.0
# Last part of a step from which a guard is extrapolated.
_EXTRAPOLATED = 1.0 / 64.0
# Extrapolation after a guard of several relations, relative to its last step. A relation that was
# true before the guard is so for about as long after it.
_AHEAD = 2.0
# Relative time difference of simultaneous jumps.
_SAME_INSTANT = 1e-12


class Graze(NamedTuple):
    """Approach of a guard to its boundary, and the uncertainty of its margin there."""

    guard: str  # Name of the guard.
    t: float  # Time.
    least: float  # Least value; of a guard that has fired, the extrapolated one.
    uncertainty: float  # Error of the least value.
    fired: bool
    turned: bool = False  # An event of another region turned it back.
    placed: str = ""  # The event of another region that put it on its boundary for an instant.


def graze_warnings(found: Sequence[Graze]) -> tuple[str, ...]:
    """Return a sentence for every guard."""
    groups: dict[str, list[Graze]] = {}
    for graze in found:
        groups.setdefault(graze.guard, []).append(graze)
    return tuple([_sentence(several) for several in groups.values()])


def _sentence(several: Sequence[Graze]) -> str:
    graze, count = several[0], len(several) - 1
    further = f"; {count} further time{'s' if count > 1 else ''}" if count else ""
    if graze.placed:
        return (
            f"{graze.guard} is true at the instant t = {graze.t:.6g} only, at which {graze.placed} "
            f"puts it on its boundary, and does not fire{further}; write every: PERIOD, on: EVENT, "
            "or a relation that holds for a span"
        )
    if graze.turned:
        return (
            f"{graze.guard} reaches its boundary at t = {graze.t:.6g}, where another event "
            f"reverses it, and does not fire{further}"
        )
    if graze.least < -graze.uncertainty:
        return (
            f"{graze.guard} passes its boundary at t = {graze.t:.6g} by {-graze.least:.2g}, "
            "less than its tolerance at the start of the flow, and does not fire; start the "
            "flow farther from the boundary"
        )
    does, would, might = "grazes its boundary", "is", "fire"
    if graze.fired:
        does, would, might = "fires", "would be", "not fire"
    return (
        f"{graze.guard} {does} at t = {graze.t:.6g}, where its least value {would} "
        f"{graze.least:.2g}, within the error of the run, {graze.uncertainty:.2g}: it might "
        f"{might}{further}"
    )


def grazes(observer: Observer, trace: Trace) -> tuple[Graze, ...]:
    """Return the instants at which errors of a run may decide whether a guard passes its boundary.

    One per guard and flow, in order of time; none for runs by steps. Minima are bracketed by 16
    samples of every step.
    """
    simulator = observer.simulator
    if not isinstance(simulator, Simulator):
        return ()
    groups: dict[tuple[Roles, int], list[Arc]] = {}
    for arc in trace.arcs:
        groups.setdefault((arc.roles, arc.coefficients.shape[2]), []).append(arc)
    last_arcs = {arc.j: arc for arc in trace.arcs}
    begun = {id(arc) for arc in {arc.j: arc for arc in reversed(trace.arcs)}.values() if arc.j}
    fired = (jump for jump in trace.jumps if jump.fired and jump.j in last_arcs)
    ended = {id(last_arcs[jump.j]): jump for jump in fired}
    times = [jump.t for jump in trace.jumps]

    def simultaneous(t: float) -> Sequence[Jump]:
        tolerance = _SAME_INSTANT * max(t, 1.0)
        begin = bisect_left(times, t - tolerance)
        return trace.jumps[begin : bisect_right(times, t + tolerance)]

    def is_unmoved(guard: str, t: float) -> bool:
        moved = {jump.region or guard for jump in simultaneous(t)}
        for jump in simultaneous(t):
            states = zip(trace.regions, jump.source, jump.target, strict=True)
            moved |= {name for name, before, after in states if before != after}
        return guard.split(".")[0] not in moved

    stops = {stop.name for stop in simulator.automaton.stops}
    approaches: list[Graze] = []
    scales = sizes(trace)
    for (roles, _), arcs in groups.items():
        scan = _GuardScan(trace, simulator, roles, stops, scales)
        for first in range(0, len(arcs), _MAX_ARCS):
            batch = arcs[first : first + _MAX_ARCS]
            approaches += scan.between(batch)
            ends = [(arc, ended[id(arc)]) for arc in batch if id(arc) in ended]
            approaches += scan.beyond(ends)
            joints = [(arc, None) for arc in batch if arc is not last_arcs[arc.j]]
            starts = [(arc, simultaneous(arc.start.high)) for arc in batch if id(arc) in begun]
            approaches += scan.turned_back([*ends, *joints], is_unmoved)
            approaches += [one for one in scan.placed(starts) if is_unmoved(one.guard, one.t)]
    return tuple(sorted(approaches, key=lambda one: one.t))


class _GuardScan:
    """Scans the guards of one mode."""

    def __init__(
        self, trace: Trace, simulator: Simulator, roles: Roles, stops: Set[str], scales: Array
    ) -> None:
        self._automaton, self._roles = simulator.automaton, roles
        compiled = simulator.modes.compiled(roles, trace.zeros)
        self._compiled, self._guards = compiled, compiled.wholes
        wholes = whole_margins(compiled.mode.margins)
        self._watched = tuple((margin.name, margin.kind) for margin in wholes)
        self._stops = stops
        guards = stops | {m.name for m in wholes if "." in m.name and ": " not in m.name}
        judged = [m.kind == "plain" and m.name in guards for m in wholes]
        self._judged = np.array(judged, np.bool_)
        # Atom -> its relation.
        self._named = {margin.name: margin.name for margin in wholes}
        self._named |= {m.name: m.relation for m in compiled.mode.margins if m.whole is not None}
        self._values = contiguous(trace.values)
        self._kinds = trace.tolerances
        relative_error = max(STATE_TOLERANCES * trace.tolerance, STATE_ROUND_OFF)
        self._errors = relative_error * scales
        self._round_off = EVALUATION_ROUND_OFF * scales
        # Larger minima, relative to the size of a margin in its flows, are not refined.
        self._near = float(np.sqrt(relative_error))

    def _table(self, states: Array, times: Array) -> Array:
        with np.errstate(all="ignore"):
            return self._guards.table(states, self._values, times)

    def between(self, arcs: Sequence[Arc]) -> Iterator[Graze]:
        """Yield the undecided minima of guards inside flows."""
        tau, rows, of = self._grid(arcs)
        margins, edges = rows[1:-1], np.searchsorted(of, np.arange(len(arcs) + 1))
        with np.errstate(all="ignore"):
            low = (margins <= rows[:-2]) & (margins <= rows[2:]) & (of[:-2] == of[2:])[:, None]
            before, after = rows[:-2] - margins, rows[2:] - margins
            # Samples are not evenly spaced between steps of different lengths.
            spans = np.diff(tau)[:, None]
            drops = np.fmax(before / spans[:-1] * spans[1:], after / spans[1:] * spans[:-1])
            threshold = self._near * np.fmax.reduce(np.abs(rows), initial=0.0)
            low &= margins <= np.fmax(before + after, drops) + threshold
        lowest: dict[tuple[int, int], int] = {}
        for i, k in np.argwhere(low).tolist():
            place = lowest.setdefault((int(of[i]), k), i + 1)
            if rows[i + 1, k] < rows[place, k]:
                lowest[int(of[i]), k] = i + 1
        for (place, k), i in lowest.items():
            arc, column = arcs[place], rows[:, k]
            at = self._least(arc, k, tau.item(i - 1), tau.item(i + 1))
            graze = self._open(arc, k, at, 0.0, fired=False)
            sides = column[edges[place] : i], column[i + 1 : edges[place + 1]]
            if graze and min(map(np.fmax.reduce, sides)) > graze.uncertainty:
                yield graze

    def _grid(self, arcs: Sequence[Arc]) -> tuple[Array, Array, Ints]:
        """Return local times, the guards there, and the index of their arc.

        One more sample near each end of an arc brackets a minimum next to it.
        """
        local = []
        for arc, tau in zip(arcs, subdivide(arcs, _GRID), strict=True):
            begin, end = arc.times.item(1), arc.times.item(-1)
            near = [_EDGE * begin], [end - _EDGE * (end - arc.times.item(-2))]
            local.append(np.concatenate([tau[:1], near[0], tau[1:-1], near[1], tau[-1:]]))
        points = sample_arcs(arcs, local)
        of = np.repeat(np.arange(len(arcs)), [len(tau) for tau in local])
        return np.concatenate(local), self._table(points.states, points.times), of

    def _minima(
        self, arc: Arc, k: int, left: float, right: float, shifts: Array
    ) -> tuple[Array, Array]:
        """Return local times and values (m,) of minima of a guard in a bracket.

        The variables are shifted by `shifts` (m, n) from those of the arc.
        """
        each = np.arange(len(shifts))
        lefts, rights = np.full(len(shifts), left), np.full(len(shifts), right)
        for _ in range(_REFINEMENTS):
            tau = np.linspace(lefts, rights, _GRID + 1, axis=1)
            states = arc.states(tau.ravel())
            shifted = (states.reshape(*tau.shape, -1) + shifts[:, None]).reshape(states.shape)
            values = self._table(shifted, arc.start.high + tau.ravel())[:, k].reshape(tau.shape)
            i = values.argmin(axis=1)
            lefts, rights = tau[each, np.maximum(i - 1, 0)], tau[each, np.minimum(i + 1, _GRID)]
            if (rights - lefts <= _NARROWEST * np.spacing(np.abs(rights))).all():
                break
        return 0.5 * (lefts + rights), values.min(axis=1)

    def _least(self, arc: Arc, k: int, left: float, right: float) -> float:
        """Return the local time of the minimum of a guard in a bracket."""
        times, _ = self._minima(arc, k, left, right, np.zeros((1, len(self._errors))))
        return times.item()

    def beyond(self, ends: Sequence[tuple[Arc, Jump]]) -> Iterator[Graze]:
        """Yield undecided guards that fired, by extrapolating the flow, or with a parabola."""
        names = [name for name, _ in self._watched]
        ends = [(arc, jump) for arc, jump in ends if jump.fired[0] in self._named]
        if not ends:
            return
        for (arc, jump), guards in zip(ends, self._last([arc for arc, _ in ends]), strict=True):
            k = names.index(self._named[jump.fired[0]])
            beyond, soon, now, before, first = guards[:, k].tolist()
            bend, fall = now - 2.0 * before + first, 0.5 * (3.0 * now - 4.0 * before + first)
            end, graze = arc.times.item(-1), None
            last = end - arc.times.item(-2)
            if bend > 0.0 > fall:
                graze = self._open(arc, k, end, -0.5 * fall * (fall / bend), fired=True)
            extrapolated = last * (_EXTRAPOLATED if soon > now else _AHEAD)
            if graze is None and max(soon, beyond) > now:
                # One relation makes the guard true, and another one ends that.
                at = self._least(arc, k, end, end + extrapolated)
                graze = self._open(arc, k, at, 0.0, fired=True)
            if graze and self._shifts(arc, k, end - last, end + extrapolated, graze.t):
                yield graze

    def _shifts(self, arc: Arc, k: int, left: float, right: float, t: float) -> bool:
        """Return whether errors of variables change the minimum of a guard in a bracket.

        They only delay that of guards such as ``abs(x) <= 0``, which is zero for any error.
        """
        errors = self._errors_along(arc.states(np.array([t - arc.start.high]))[0], t)
        shifts = np.vstack([np.zeros(len(errors)), errors, -errors])
        times, minima = self._minima(arc, k, left, right, shifts)
        state = arc.states(times[:1])[0]
        round_off = margin_errors(self._guards, k, state, self._round_off, self._values, t)
        return bool(np.abs(minima - minima[0]).max() > round_off)

    def _errors_along(self, state: Array, t: float) -> Array:
        """Return the errors of the variables (n, n), without those that constraints remove.

        Each row is the error of one variable, projected onto the motions that the constraints of
        the flow allow, in which distances are relative to the errors.
        """
        errors, coordinates = np.diag(self._errors), self._automaton.coordinates
        if coordinates is None or self._gradients is None:
            return errors
        variables, moving = self._automaton.variables, coordinates.positions
        gradients = self._gradients.at(contiguous(state), self._values, t).reshape(-1, len(moving))
        for group in (moving, coordinates.rates):
            places = [variables.index(symbol) for symbol in group]
            scaled = gradients * self._errors[places]
            keeps = np.eye(len(places)) - np.linalg.pinv(scaled) @ scaled
            errors[np.ix_(places, places)] = keeps * self._errors[places]
        return errors

    @cached_property
    def _gradients(self) -> Tape | None:
        """The gradients of the constraints of the flow, one after another; None without any."""
        coordinates = self._automaton.coordinates
        assert coordinates is not None
        holds = [*coordinates.joints]
        for region, role in zip(self._automaton.regions, uncaptured(self._roles), strict=False):
            holds += region.build(role).holds
        rows = [
            derivative(place, symbol).xreplace(hold.anchors)
            for hold in holds
            for place in hold.places
            for symbol in coordinates.positions
        ]
        return self._automaton.tape(rows) if rows else None

    def turned_back(
        self, ends: Sequence[tuple[Arc, Jump | None]], is_unmoved: Callable[[str, float], bool]
    ) -> Iterator[Graze]:
        """Yield guards and stop conditions within their error of zero at another event.

        The state after that event decides whether they fire, if their region `is_unmoved` by it.
        Where a relation of a guard ends, or a function switches, there is no jump.
        """
        places = np.flatnonzero(self._judged).tolist()
        if not (ends and places):
            return
        rows = self._last([arc for arc, _ in ends])[:, :, places]
        with np.errstate(all="ignore"):
            falling = rows[:, 2] < rows[:, 3]
            near = np.abs(rows[:, 2]) <= self._near * np.abs(rows[:, 3])
        for i, place in np.argwhere(falling & near).tolist():
            (arc, jump), k = ends[i], places[place]
            begin, end = arc.times[-2:].tolist()
            t = arc.start.high + end
            if is_unmoved(self._watched[k][0], t):
                at = self._least(arc, k, end - _EXTRAPOLATED * (end - begin), end)
                if graze := self._open(arc, k, at, 0.0, fired=False):
                    yield graze._replace(t=t, turned=jump is not None)

    def placed(self, starts: Sequence[tuple[Arc, Sequence[Jump]]]) -> Iterator[Graze]:
        """Yield false guards that jumps put on their boundary, and that rise from there.

        As ``mod(time, T) <= D`` with D = 0, they are true at one instant.
        """
        for arc, jumps in starts:
            tau = np.array([0.0, _EXTRAPOLATED * arc.times.item(1)])
            states = np.vstack([jumps[0].before, arc.states(tau)])
            before, now, soon = self._table(states, arc.start.high + np.array([0.0, *tau]))
            with np.errstate(all="ignore"):
                touched = (np.abs(now) <= self._near * soon) & (before > np.abs(now))
            for k in np.flatnonzero(touched & self._judged).tolist():
                graze = self._open(arc, k, 0.0, 0.0, fired=False)
                near = graze and abs(graze.least) <= graze.uncertainty < before[k]
                if graze and near and self._is_true(graze, states[1]):
                    yield graze._replace(placed=f"{jumps[0].region}.{jumps[0].cause}")

    def _is_true(self, graze: Graze, state: Array) -> bool:
        """Return whether a guard is true at the instant of a graze."""
        guards, margins = self._compiled.guards, self._compiled.mode.margins
        names = [margin.relation or margin.name for margin in margins]
        first = names.index(graze.guard)
        condition = margins[first].condition
        if condition is None:
            return True
        errors = [
            margin_errors(guards, k, state, self._errors, self._values, graze.t)
            for k in range(first, first + len(condition.atoms))
        ]
        values = guards.values(state, self._values, graze.t)[first:].tolist()
        closed = [not atom.strict for atom in condition.atoms]
        atoms = AtomsAt(values, errors, closed, lambda _: 0.0)
        return atoms.touched(condition, 0, lambda *_: False)

    def _last(self, arcs: Sequence[Arc]) -> Array:
        """Return the guards after the end of flows, there and shortly before, (m, 5, k)."""
        s = 1.0 - np.array([-_AHEAD, -_EXTRAPOLATED, 0.0, _EXTRAPOLATED, 2.0 * _EXTRAPOLATED])
        terms = np.array([arc.coefficients[-1] for arc in arcs])
        spans = np.array([arc.times[-1] - arc.times[-2] for arc in arcs])
        states = np.swapaxes(terms @ s ** np.arange(terms.shape[2])[:, None], 1, 2)
        times = np.array([arc.start.high + arc.times[-1] for arc in arcs])
        at = (times[:, None] - (1.0 - s) * spans[:, None]).ravel()
        return self._table(states.reshape(-1, terms.shape[1]), at).reshape(len(arcs), len(s), -1)

    def _open(self, arc: Arc, k: int, tau: float, further: float, *, fired: bool) -> Graze | None:
        """Return the graze of a guard if its least value is within its uncertainty."""
        state = arc.states(np.array([tau]))[0]
        t = arc.start.high + tau
        name, kind = self._watched[k]
        lowest = self._table(state[None], np.array([t])).item(k) + further
        uncertainty = margin_errors(self._guards, k, state, self._errors, self._values, t)
        uncertainty += self._kinds.get(kind, 0.0)
        missed = kind == "plain" and not fired and lowest < 0.0
        if missed or abs(lowest) <= uncertainty:
            return Graze(name, t, lowest, uncertainty, fired)
        return None
