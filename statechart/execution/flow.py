"""Flow from a state to the first event, in chunks of steps verified by interval enclosures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from statechart import interrupts
from statechart.arrays import Array, Bools
from statechart.automaton.trace import LARGEST
from statechart.engines.engine import (
    FIRST_CHUNK,
    GROWTH,
    LONGEST_CHUNK,
    MAX_DEFECT_BOXES,
    NEAR,
    Continuation,
    Engine,
    FlowWatch,
    Path,
)
from statechart.engines.event_location import Crossing, Search, Verdict, search
from statechart.errors import SimulationError, StepFailure, TooLong, Unsupported
from statechart.execution.compiled_modes import CompiledMode
from statechart.execution.event_classification import (
    first_event,
    first_tolerances,
    noise,
    path_sizes,
    relative_error,
    resolve_search,
    search_steps,
)
from statechart.execution.root_arrival import steps_to_zero
from statechart.formulas.series import sizes_at
from statechart.kernels.boxes import Steps
from statechart.kernels.defect import find_defect
from statechart.kernels.polynomials import cut_steps, local_time, sample_states

FOLLOWED = "the slopes of all steps were compared with the rates"
UNFOLLOWED = "steps may not follow the rates: narrow features may have been missed"
# Allowed violation of the constraints at the end of a chunk, in tolerances.
_DRIFT = 0.2
# Violation of the constraints, in tolerances, by which a step missed a feature of a surface.
_BLIND = 1e3
# If halving a step reduces its violation by less than this factor, the cause is round-off.
_STAYS = 0.75
# Factor by which halving a step reduces the defect over smooth rates; relative defect that cannot
# be round-off.
_FALLS, _ROUGH = 0.25, 1e-3
# Steps without a bound of the defect after which the check ends.
_MAX_UNKNOWN = 4096
# Smallest magnitude of a variable, relative to its size.
LEAST = 1e-6
# Ends of a flow at a discontinuity of a margin, in units in the last place of time.
_BEYOND = (0.0, 1.0, 2.0, 4.0)
# A step is repeated up to this part of the way to the missed feature.
_NEARER = 0.5
# A step is repeated up to an event between these parts of it, if a variable is larger by this
# factor at its end and has a defect of so many tolerances; then to this part of the way to it.
_NEAR_START, _NEAR_END, _FAR, _ACCURATE, _PAST_EVENT = 1e-3, 0.9, 4.0, 10.0, 1.01
# A margin is zero below this part of its terms.
_ZERO = 4.0 * float(np.finfo(float).eps)
# Steps between estimates of the remaining number of steps, and the limit of that number.
_PACE_STEPS, _TOO_MANY = 4096, 1e12
# Ratio of total variation to range of a drift over _PACE_STEPS steps; oscillations have more.
# Relative changes below the second number may be round-off.
_DRIFTS, _STILL = 16.0, 1e-9
STIFF = "the model is stiff"


@dataclass(eq=False)
class Advance:
    """Flow in one mode to the first event or to the end of `duration`; its steps are in the path.

    The integrator takes a chunk of steps; the search then proves that no margin fell in them, or
    locates the first fall, after which steps are dropped. `horizon` limits the first chunk and
    grows: one step of a polynomial flow (free flight) could span all of `duration`, and the
    round-off of such a step would hide an early event. `on_steps` is called with the local time and
    the number of steps.
    """

    engine: Engine
    compiled: CompiledMode
    path: Path
    watch: FlowWatch
    initial: Array
    duration: float
    horizon: float
    on_steps: Callable[[float, int], None] | None
    state: Array = field(init=False)  # (n,): where it is.
    crossing: Crossing | None = None  # The event that ended it; None at the end of the duration.
    graze: bool = False  # True when the event is one that could not be proved.
    # Costs.
    boxes: int = 0
    steps: int = 0
    failure: SimulationError | KeyboardInterrupt | None = None  # The error that stopped the flow.
    unfollowed: float | None = None  # Time from which on the defect of steps has no bound.

    def run(self) -> Advance:
        """Flow; return this, also after a failure."""
        self._start()
        try:
            while self._reached < self.duration and self.crossing is None:
                interrupts.check()
                self._chunk()
        except (SimulationError, KeyboardInterrupt) as error:
            self.failure = error
        path, watch = self.path, self.watch
        path.count = self._proved
        reached = watch.start + path.times.item(path.count)
        self.state = watch.reconstruction.onto(self.state, reached)
        return self

    def _start(self) -> None:
        # Verified steps, and their local end time.
        self.state, self._proved, self._reached = self.initial, 0, 0.0
        # The next chunk: number of steps, how it continues the last one, end.
        self._count, self._begin = FIRST_CHUNK, Continuation.NEW
        self._end = min(self.horizon, self.duration)
        # Violation of the last repeated step; steps and time at the last check of pace.
        self._last_defect, self._mark = math.inf, (0, 0.0)
        # Start of the last step with a large defect, its time and amount; defect known to be
        # round-off; number of steps without a bound of the defect.
        self._missed, self._rounded, self._unknown = (-1.0, 0.0, 0.0), 0.0, 0
        self._sizes = np.abs(self.initial)  # (n,) largest magnitudes so far

    def _chunk(self) -> None:
        """Take steps and verify them; then continue, end at an event, or repeat them."""
        watch, path, first = self.watch, self.path, self._proved
        path.count, ended = first, np.empty(len(self.state))
        tolerances = first_tolerances(self.compiled, watch, self.state, self._reached)
        if self.engine.time_budget is not None:
            self.engine.time_budget.check(watch.start + path.times.item(first))
        finished, arriving = False, 0
        if self._begin is not Continuation.NEW or not self._arrive_from_start(ended):
            finished = self.engine.steps(
                self.compiled.stepper,
                path,
                watch,
                self.state,
                self._end,
                self._count,
                self._begin,
                ended,
            )
            arriving = self._arrive(first, ended)
        end = path.count
        new_steps, local = end - first, path.times.item(end)
        self.steps += new_steps
        self._count = max(self._count, new_steps)
        following, distance = _constrained(watch, ended, local)
        if distance > _DRIFT and new_steps > 1:
            # The chunk drifted off its constraints: repeat with fewer steps.
            self._count = max(1, new_steps // 4)
            self._begin = Continuation.BACK if arriving < end else Continuation.MOVED
            return
        found = self._search(tolerances, first, arriving)
        if found.verdict is Verdict.NONE and arriving < end:
            # Margins that end at zero have no crossing there.
            zero = self._zero_margins(ended, local)
            found = self._search(np.where(zero, math.inf, tolerances), arriving, end)
        blind = _blind(watch, path, first, end, found) or self._find_missed(first, arriving, found)
        if _BLIND < distance <= _STAYS * self._last_defect and watch.constraints.within is not None:
            blind, self._last_defect = (first, local), distance
        if blind is not None:
            self._retreat(*blind, ended)
        elif found.verdict is Verdict.NONE:
            arrived = arriving < end
            self._accept_steps(
                following, finished and not arrived, moved=arrived or following is not ended
            )
            if arrived:
                self._continue_from_zero()
        elif not (self._widened(found) or self._shorten(found, ended)):
            self._end_at_event(found, ended)

    def _search(self, tolerances: Array, first: int, last: int) -> Search:
        watch, path = self.watch, self.path
        found = search_steps(watch, path, tolerances, first, last)
        self.boxes += found.boxes
        if found.verdict is Verdict.NONE:
            return found
        return first_event(found, self.engine, self.compiled, watch, path, tolerances, last)

    def _zero_margins(self, state: Array, local: float) -> Bools:
        """Return the mask of the watched plain margins that are zero in a state."""
        watch, guards, time = self.watch, self.compiled.guards, self.watch.start + local
        margins, places = guards.values(state, watch.parameters, time), range(len(guards.outputs))
        terms = sizes_at(guards, tuple(places), state, self._sizes, watch.parameters, time)
        zero = np.abs(margins) <= _ZERO * np.array(terms)
        result: Bools = zero & self.compiled.plain & (watch.tolerances < math.inf)
        return result

    def _near_zero(self, state: Array, local: float) -> Array:
        """Return the values from which the bases of roots are continued to zero."""
        watch, bases = self.watch, self.compiled.roots.bases
        places, time = tuple(range(len(bases.outputs))), self.watch.start + local
        terms = sizes_at(bases, places, state, self._sizes, watch.parameters, time)
        return math.sqrt(self.engine.tolerance) * np.array(terms)

    def _arrive_from_start(self, ended: Array) -> bool:
        """Take the steps from a start near the zero of the base of a root to it, if it falls."""
        watch, roots = self.watch, self.compiled.roots
        if not roots.exponents:
            return False
        bases = roots.bases.values(self.initial, watch.parameters, watch.start)
        near = (bases > 0.0) & (bases <= self._near_zero(self.initial, 0.0))
        for index in np.flatnonzero(near).tolist():
            if steps := self._steps_to_zero(index, self.initial, 0.0):
                self._append(steps, ended)
                return True
        return False

    def _steps_to_zero(self, index: int, state: Array, local: float) -> list[tuple[float, Array]]:
        """Return the steps to the zero of a base; [] if it turns, or the flow ends before."""
        time = self.watch.start + local
        found = steps_to_zero(self.compiled, index, self.watch.parameters, state, time)
        return found if local + sum(h for h, _ in found) <= self.duration else []

    def _append(self, steps: list[tuple[float, Array]], ended: Array) -> None:
        for h, polynomial in steps:
            self.path.append(h, polynomial)
        polynomial.sum(axis=1, out=ended)

    def _arrive(self, first: int, ended: Array) -> int:
        """Replace steps in which the base of a root falls by those to its zero.

        Returns the number of steps before these.
        """
        path, watch, roots = self.path, self.watch, self.compiled.roots
        count = path.count
        if not roots.exponents:
            return count
        steps, times = path.coefficients[first:count], path.times[first : count + 1]
        self._sizes = np.maximum(self._sizes, path_sizes(steps))
        states, now = np.vstack([steps[:, :, 0], ended]), watch.start + times
        near = self._near_zero(ended, times.item(-1))
        bases = roots.bases.table(states, watch.parameters, now)
        falls = (bases[:-1] > near) & (bases[1:] <= near)
        if not falls.any():
            return count
        from scipy.optimize import brentq  # slow import

        def state(local: float) -> Array:
            return sample_states(steps, times, np.array([local]))[0]

        def excess(local: float, index: int) -> float:
            values = roots.bases.values(state(local), watch.parameters, watch.start + local)
            return values.item(index) - near.item(index)

        for step, index in np.argwhere(falls).tolist():
            a, b = times[step : step + 2].tolist()
            if not excess(a, index) > 0.0 >= excess(b, index):
                continue  # Its end was projected.
            at = float(brentq(excess, a, b, (index,)))
            if further := self._steps_to_zero(index, state(at), at):
                count = path.count = cut_steps(
                    path.times, path.coefficients, first + step + 1, at, ended
                )
                self._append(further, ended)
                return count
        return count

    def _continue_from_zero(self) -> None:
        """End at a margin that is zero where the base of a root is, or prepare the next chunk."""
        zero, time = self._zero_margins(self.state, self._reached), self.watch.start + self._reached
        if zero.any():
            guard, last = int(zero.argmax()), self.path.count - 1
            self.crossing = Crossing(guard, last, 1.0, self._reached, self._reached)
        rates = self.compiled.rates.values(self.state, self.watch.parameters, time)
        if not np.isfinite(rates).all():
            raise StepFailure(
                f"the base of a root would be negative after t = {time:.6g}; write sqrt(max(x, 0)) "
                "for the root of an x that ends at 0"
            )
        self._begin = Continuation.BACK
        if self._end <= self._reached:
            self._end = min(self._reached + self.horizon, self.duration)

    def _retreat(self, step: int, blind: float, ended: Array) -> None:
        """Return to the start of a step that missed a feature at the local time `blind`."""
        path = self.path
        self._proved, self._reached = step, path.times.item(step)
        self.horizon = _NEARER * (blind - self._reached)
        self._end = self._reached + self.horizon
        if not self._end > self._reached:
            raise StepFailure(
                f"at t = {self.watch.start + self._reached:.6g} no step is short enough to "
                "stay on the constraints"
            )
        remaining = cut_steps(path.times, path.coefficients, path.count, self._reached, ended)
        self.state = ended if remaining > 0 else self.initial
        self._count, self._begin = 1, Continuation.BACK

    def _find_missed(self, first: int, last: int, found: Search) -> tuple[int, float] | None:
        """Return the first step with a large defect before the located event, and its time."""
        watch, path, rates = self.watch, self.path, self.compiled.rates
        location = found.crossing or found.undecided
        while True:
            step, s, defect, _ = find_defect(
                rates.parts,
                Steps(path.times, path.coefficients, watch.parameters, watch.start),
                first,
                last if location is None else min(last, location.step + 1),
                self._significant_sizes(first),
                max(self.engine.allowed, self._rounded),
                MAX_DEFECT_BOXES,
            )
            if step < 0:
                return None
            step_start, at = path.times.item(step), local_time(path.times, step, s)
            last_start, last_at, before = self._missed
            self._missed = step_start, at, defect
            repeated = step_start == last_start
            if repeated and _FALLS * before < defect < _ROUGH:
                # Halving the step does not reduce the defect: round-off.
                self._rounded, first = 2.0 * defect, step
            elif not step_start < step_start + _NEARER * (at - step_start):
                # The step has no duration, but the rates may be singular there.
                self._check_method(step_start, step)
                first = step + 1
            elif (repeated and at >= last_at) or self._unknown > _MAX_UNKNOWN:
                self._check_method(step_start, step)
                self._rounded, self.unfollowed = math.inf, watch.start + step_start
                return None
            else:
                self._unknown += defect == math.inf
                return step, at

    def _significant_sizes(self, first: int) -> Array:
        """Return the smallest significant magnitude of each variable (n,).

        Without declared scales it is a part of the largest variable that moves, at most 1.
        """
        scales = self.engine.sizes
        if scales is None:
            terms = np.abs(self.path.coefficients[first : self.path.count]).sum(axis=2)
            largest = terms.max(initial=0.0, where=np.array(self.compiled.mode.varying))
            scales = np.full(len(self.initial), min(largest, 1.0) or 1.0)
        smallest: Array = np.maximum(LEAST * scales, self.engine.floor)
        return smallest

    def _check_method(self, time: float, step: int) -> None:
        watch, path, now = self.watch, self.path, self.watch.start + time
        state = path.coefficients[step, :, 0]
        self.engine.check(self.compiled.stepper, path, state, watch.parameters, now)

    def _widened(self, found: Search) -> bool:
        """Restart with wider tolerances if the located event is noise."""
        wider = noise(self.engine, self.compiled, self.watch, self.path, self.initial, found)
        if wider is None:
            return False
        self.watch, self.horizon = self.watch._replace(tolerances=wider), self._end
        self._start()
        return True

    def _shorten(self, found: Search, ended: Array) -> bool:
        """Repeat the step of an event up to it, if the dense output is less accurate than the step.

        The step allows errors relative to its end, which may lie far beyond the event.
        """
        location, path, watch = found.crossing, self.path, self.watch
        if self.engine.sharp or location is None or not _NEAR_START < location.s < _NEAR_END:
            return False
        step, steps = location.step, path.coefficients[: location.step + 1]
        start, terms = path.times.item(step), np.arange(steps.shape[2])
        span, places = path.times.item(step + 1) - start, np.array([[0.5], [1.0]]) * location.s
        states = places**terms @ steps[step].T
        rates = self.compiled.rates.table(
            states, watch.parameters, watch.start + start + span * places[:, 0]
        )
        slopes = (terms[1:] * places ** terms[:-1]) @ steps[step, :, 1:].T
        defects = np.abs(slopes - span * rates).max(axis=0)
        sizes = np.abs(np.vstack([steps[:, :, 0], states])).max(axis=0)
        far = np.abs(steps[step].sum(axis=1)) > _FAR * sizes
        if not (far & (defects > _ACCURATE * self.engine.tolerance * sizes)).any():
            return False
        self._retreat(step, start + _PAST_EVENT / _NEARER * (location.time - start), ended)
        return True

    def _end_at_event(self, found: Search, ended: Array) -> None:
        """End at the located event."""
        try:
            crossing = resolve_search(found, self.compiled, self.watch, self.path)
        except SimulationError:
            if found.undecided is not None:
                self._cut(found.undecided.time, ended)
            raise
        kind, located = self.compiled.kind(crossing.guard), found.verdict is Verdict.CROSSING
        # A slip comes to rest where its friction has no value beyond.
        self.graze = not located and (kind != "speed" or found.verdict is Verdict.GRAZE)
        at_crossing = not located or kind in ("force", "hold", "implied")
        at = crossing.crossed if at_crossing else crossing.time
        if self.compiled.plain[crossing.guard] and self._above(crossing.guard, at):
            # A discontinuous margin (an angle at its branch cut) is positive up to its jump.
            ulp = math.ulp(abs(self.watch.start) + crossing.crossed)
            for beyond in _BEYOND:
                at = min(crossing.crossed + beyond * ulp, self.duration)
                if not self._above(crossing.guard, at):
                    break
        self._cut(at, ended)
        self.crossing = crossing

    def _above(self, guard: int, at: float) -> bool:
        """Return whether a margin is positive beyond round-off at a local time."""
        watch, path, guards = self.watch, self.path, self.compiled.guards
        steps, times = path.coefficients[: path.count], path.times[: path.count + 1]
        state = sample_states(steps, times, np.array([at]))[0]
        margin = guards.values(state, watch.parameters, watch.start + at).item(guard)
        if not margin > watch.tolerances.item(guard):
            return False
        sizes = path_sizes(steps)
        (terms,) = sizes_at(guards, (guard,), state, sizes, watch.parameters, watch.start + at)
        return margin > relative_error(self.engine) * terms

    def _cut(self, at: float, ended: Array) -> None:
        path = self.path
        self._proved = cut_steps(path.times, path.coefficients, path.count, at, ended)
        self.state = ended if self._proved > 0 else self.initial

    def _accept_steps(self, following: Array, finished: bool, *, moved: bool) -> None:
        """Accept the steps; `moved` is true if their end was projected onto the constraints."""
        path, duration = self.path, self.duration
        self._proved, self._reached = path.count, path.times.item(path.count)
        self.state, self._last_defect = following, math.inf
        steps, since = self._mark
        if self._proved - steps >= _PACE_STEPS:
            # The root of an expression that reaches zero has no series there.
            self._check_method(self._reached, self._proved - 1)
            if self.engine.gives_way:
                self._check_stiffness(self._proved - steps, self._reached - since)
            _check_pace(self._proved - steps, self._reached - since, duration - self._reached)
            self._mark = self._proved, self._reached
        if self.on_steps is not None:
            self.on_steps(self._reached, self.steps)
        if finished:
            self.horizon *= GROWTH
            self._end = min(self._reached + self.horizon, duration)
        # The length of a chunk that needed projection is not increased.
        if not moved:
            self._count = min(self._count + self._count // 2, LONGEST_CHUNK)
        self._begin = Continuation.MOVED if moved or finished else Continuation.ON

    def _check_stiffness(self, steps: int, took: float) -> None:
        """Raise `Unsupported` if stability, not the motion, limits explicit steps.

        In that case the remaining steps exceed a trace, and the total variation of the states is
        about their range; fast oscillations have a much larger variation.
        """
        series, at = self.path.coefficients, self.watch.start + self._reached
        max_steps = LARGEST // (8 * series.shape[1] * series.shape[2])
        if self._proved + steps * (self.duration - self._reached) / took < max_steps:
            return
        states = series[self._proved - steps : self._proved, :, 0]
        variation, extent = np.abs(np.diff(states, axis=0)).sum(axis=0), np.ptp(states, axis=0)
        moves = extent > _STILL * np.abs(states).max(axis=0)
        if (variation[moves] <= _DRIFTS * extent[moves]).all():
            raise Unsupported(
                f"{STIFF}: its steps collapse to {took / steps:.3g} at t = {at:.6g}; "
                "use engine: scipy, method: Radau"
            )


def _check_pace(steps: int, took: float, remaining: float) -> None:
    """Raise `TooLong` if the rest of a flow needs too many steps."""
    pace = took / steps
    if pace * _TOO_MANY < remaining:
        raise TooLong(
            f"{steps} steps advanced the time by {took:.6g}, of {took + remaining:.6g}; end the "
            "run earlier, or replace the fast variation by its mean"
        )


def _constrained(watch: FlowWatch, state: Array, local: float) -> tuple[Array, float]:
    """Project a state onto its constraints if necessary; return it and the violation."""
    time = watch.start + local
    distance = watch.constraints.off(state, watch.parameters, time)
    # A state that is not finite is reported by the guards.
    if distance <= NEAR or not math.isfinite(distance):
        return state, 0.0
    following = watch.constraints.project(state, time)
    return following, 0.0 if following is state else distance


def _blind(
    watch: FlowWatch, path: Path, first: int, last: int, found: Search
) -> tuple[int, float] | None:
    """Return the first step that leaves its constraints before the located event, and its time."""
    curvature_tape = watch.constraints.within
    if curvature_tape is None:
        return None
    location = found.crossing or found.undecided
    exits = search(
        curvature_tape,
        np.full(len(curvature_tape.outputs), watch.constraints.max_depth),
        path,
        watch.parameters,
        watch.start,
        first,
        last if location is None else location.step + 1,
    )
    blind = exits.crossing or exits.undecided
    if blind is None or (location is not None and blind.time > location.time):
        return None
    return blind.step, blind.time
