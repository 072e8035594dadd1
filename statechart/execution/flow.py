"""One flow: from a state to the first event, chunk by chunk of steps, each proved by enclosure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from statechart import interrupts
from statechart.arrays import Array
from statechart.automaton.trace import LARGEST
from statechart.engines.engine import (
    FIRST_CHUNK,
    GROWTH,
    LONGEST_CHUNK,
    MAX_DEFECT_BOXES,
    NEAR,
    Begin,
    Engine,
    FlowWatch,
    Path,
)
from statechart.engines.event_location import Crossing, Search, Verdict, search
from statechart.errors import SimulationError, StepFailure, TooLong, Unsupported
from statechart.execution.compiled_modes import CompiledMode
from statechart.execution.finding import (
    decided,
    first_tolerances,
    judge,
    noise,
    path_sizes,
    relative_error,
)
from statechart.formulas.series import sizes_at
from statechart.kernels.boxes import Steps
from statechart.kernels.defect import find_defect
from statechart.kernels.polynomials import cut_steps, local_time, sample_states

FOLLOWED = "the slopes of all steps were compared with the rates"
UNFOLLOWED = "steps may not follow the rates: narrow features may have been missed"
# A chunk may end this far off its constraints, in tolerances; inside it may be farther.
_DRIFT = 0.2
# A single step that ends so far off was blind to something; of what rounding does this is no part.
_BLIND = 1e3
# If a step half as long is off by more than this part, the cause is round-off far from the start
# of the run.
_STAYS = 0.75
# The defect of a step over smooth rates falls by more than this as the step is halved; a defect
# above the second, in parts of the motion, is not round-off.
_FALLS, _ROUGH = 0.25, 1e-3
# After so many steps of which it is not known what they miss, they are no longer asked.
_UNKNOWN = 4096
# Variables count as so large at least, in their sizes.
LEAST = 1e-6
# Ends of a flow into a jump of a margin, in units in the last place of time.
_BEYOND = (0.0, 1.0, 2.0, 4.0)
# Part of the way to the place where a step left its constraints unseen, or missed its rates.
_NEARER = 0.5
# So many steps tell how many the rest takes; of more than this, days at a microsecond each.
_PACE_STEPS, _TOO_MANY = 4096, 1e12
# Over so many steps a drift varies by a few times its extent, an oscillation by some at every
# step. What moves less, in parts of its size, may be round-off.
_DRIFTS, _STILL = 16.0, 1e-9
STIFF = "the model is stiff"


@dataclass(eq=False, slots=True)
class Advance:
    """A flow in one mode to the first event or to the end of `duration`; its steps are in the path.

    The integrator runs ahead by a few steps at a time; the search then proves, step by step, that
    no margin fell, or finds the first that did. What was integrated beyond it is dropped. `horizon`
    is how far to look ahead at first; it grows as the flow goes on. Where a flow is a polynomial
    (free flight) one step could span all of `duration`, and an event soon after its start would be
    lost in that step's rounding. `on_steps` takes the local time reached and the steps taken, now
    and then.
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
    unfollowed: float | None = None  # From when on it is not known whether steps follow the rates.
    # Steps that are proved, and the local time that they reach.
    _proved: int = field(init=False)
    _reached: float = field(init=False)
    # The next chunk: its steps, where it has to end, how it follows from the last.
    _count: int = field(init=False)
    _end: float = field(init=False)
    _begin: Begin = field(init=False)
    # Distance by which the last repeated step was off; steps and time at the last check of pace.
    _last_defect: float = field(init=False)
    _mark: tuple[int, float] = field(init=False)
    # Start of the last step that missed its rates, the place and the amount; the defect known to be
    # round-off; the number of steps whose defect has no bound.
    _missed: tuple[float, float, float] = field(init=False)
    _rounded: float = field(init=False)
    _unknown: int = field(init=False)

    def run(self) -> Advance:
        """Flow; return this, also where the flow could not be continued."""
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
        self.state, self._proved, self._reached = self.initial, 0, 0.0
        self._count, self._begin = FIRST_CHUNK, Begin.NEW
        self._end = min(self.horizon, self.duration)
        self._last_defect, self._mark = math.inf, (0, 0.0)
        self._missed, self._rounded, self._unknown = (-1.0, 0.0, 0.0), 0.0, 0

    def _chunk(self) -> None:
        """Make steps and prove them; then go on, end at an event, or make them again."""
        watch, path, first = self.watch, self.path, self._proved
        path.count, ended = first, np.empty(len(self.state))
        tolerances = first_tolerances(self.compiled, watch, self.state, self._reached)
        if self.engine.allowance is not None:
            self.engine.allowance.check(watch.start + path.times.item(first))
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
        last = path.count
        taken, local = last - first, path.times.item(last)
        self.steps += taken
        self._count = max(self._count, taken)
        following, off = _constrained(watch, ended, local)
        if off > _DRIFT and taken > 1:
            # The chunk drifted off its constraints: again, in shorter ones.
            self._count, self._begin = max(1, taken // 4), Begin.MOVED
            return
        found = search(watch.guards, tolerances, path, watch.parameters, watch.start, first, last)
        self.boxes += found.boxes
        if found.verdict is not Verdict.NONE:
            found = judge(found, self.engine, self.compiled, watch, path, tolerances, last)
        blind = _blind(watch, path, first, last, found) or self._find_missed(first, last, found)
        if _BLIND < off <= _STAYS * self._last_defect and watch.constraints.within is not None:
            blind, self._last_defect = (first, local), off
        if blind is not None:
            self._retreat(*blind, ended)
        elif found.verdict is Verdict.NONE:
            self._go_on(following, finished, moved=following is not ended)
        elif not self._widened(found):
            self._arrive(found, ended)

    def _retreat(self, step: int, blind: float, ended: Array) -> None:
        """Go on from before a step: the integrator did not see what it ran into, and when."""
        path = self.path
        self._proved, self._reached = step, path.times.item(step)
        self.horizon = _NEARER * (blind - self._reached)
        self._end = self._reached + self.horizon
        if not self._end > self._reached:
            raise StepFailure(
                f"at t = {self.watch.start + self._reached:.6g} no step is short enough to "
                "stay on the constraints"
            )
        left = cut_steps(path.times, path.coefficients, path.count, self._reached, ended)
        self.state = ended if left > 0 else self.initial
        self._count, self._begin = 1, Begin.BACK

    def _find_missed(self, first: int, last: int, found: Search) -> tuple[int, float] | None:
        """Return the step, up to what was found in them, that misses its rates, and where."""
        watch, path, rates = self.watch, self.path, self.compiled.rates
        where = found.crossing or found.undecided
        while True:
            step, s, off, _ = find_defect(
                rates.parts,
                Steps(path.times, path.coefficients, watch.parameters, watch.start),
                first,
                last if where is None else where.step + 1,
                floors(self.engine, len(self.initial)),
                max(self.engine.allowed, self._rounded),
                MAX_DEFECT_BOXES,
            )
            if step < 0:
                return None
            begun, at = path.times.item(step), local_time(path.times, step, s)
            last_begun, last_at, before = self._missed
            self._missed = begun, at, off
            again = begun == last_begun
            if again and _FALLS * before < off < _ROUGH:
                # A defect that halving the step does not reduce is round-off.
                self._rounded, first = 2.0 * off, step
            elif not begun < begun + _NEARER * (at - begun):
                # No time passes in it, but the rates may end there.
                self._check_method(begun, step)
                first = step + 1
            elif (again and at >= last_at) or self._unknown > _UNKNOWN:
                self._check_method(begun, step)
                self._rounded, self.unfollowed = math.inf, watch.start + begun
                return None
            else:
                self._unknown += off == math.inf
                return step, at

    def _check_method(self, time: float, step: int) -> None:
        """Raise `Unsupported` where the method cannot go on from a step, however short."""
        watch, state = self.watch, self.path.coefficients[step, :, 0]
        self.engine.check(self.compiled.stepper, state, watch.parameters, watch.start + time)

    def _widened(self, found: Search) -> bool:
        """Begin again with wider tolerances, where what was found is not a fall but noise."""
        wider = noise(self.engine, self.compiled, self.watch, self.path, self.initial, found)
        if wider is None:
            return False
        self.watch, self.horizon = self.watch._replace(tolerances=wider), self._end
        self._start()
        return True

    def _arrive(self, found: Search, ended: Array) -> None:
        """End at the event that was found."""
        try:
            crossing = decided(found, self.compiled, self.watch, self.path)
        except SimulationError:
            if found.undecided is not None:
                self._cut(found.undecided.time, ended)
            raise
        self.graze = found.verdict is not Verdict.CROSSING
        late = self.graze or self.compiled.kind(crossing.guard) in ("force", "hold")
        at = crossing.crossed if late else crossing.time
        if self.compiled.plain[crossing.guard] and self._above(crossing.guard, at):
            # A margin that jumps over zero (an angle at its branch cut) is above it until then.
            ulp = math.ulp(abs(self.watch.start) + crossing.crossed)
            for beyond in _BEYOND:
                at = min(crossing.crossed + beyond * ulp, self.duration)
                if not self._above(crossing.guard, at):
                    break
        self._cut(at, ended)
        self.crossing = crossing

    def _above(self, guard: int, at: float) -> bool:
        """Tell whether a margin is above zero at a local time, and not by round-off."""
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
        """Keep what was flown up to a local time; its state is written to `ended`."""
        path = self.path
        self._proved = cut_steps(path.times, path.coefficients, path.count, at, ended)
        self.state = ended if self._proved > 0 else self.initial

    def _go_on(self, following: Array, finished: bool, *, moved: bool) -> None:
        """Keep the steps made; `moved` says whether their end was brought onto its constraints."""
        path, duration = self.path, self.duration
        self._proved, self._reached = path.count, path.times.item(path.count)
        self.state, self._last_defect = following, math.inf
        steps, since = self._mark
        if self._proved - steps >= _PACE_STEPS:
            if self.engine.gives_way:
                self._check_stiffness(self._proved - steps, self._reached - since)
            _check_pace(self._proved - steps, self._reached - since, duration - self._reached)
            self._mark = self._proved, self._reached
        if self.on_steps is not None:
            self.on_steps(self._reached, self.steps)
        if finished:
            self.horizon *= GROWTH
            self._end = min(self._reached + self.horizon, duration)
        # Chunks as long as one whose end had to be moved stay near enough to be brought back.
        if not moved:
            self._count = min(self._count + self._count // 2, LONGEST_CHUNK)
        self._begin = Begin.MOVED if moved or finished else Begin.ON

    def _check_stiffness(self, steps: int, took: float) -> None:
        """Raise `Unsupported` where stability, not the motion, keeps explicit steps short.

        Then the rest does not fit into a trace, and the states drift: their total variation over
        many steps is about their range. In fast oscillations it is many times that.
        """
        series, at = self.path.coefficients, self.watch.start + self._reached
        room = LARGEST // (8 * series.shape[1] * series.shape[2])
        if self._proved + steps * (self.duration - self._reached) / took < room:
            return
        states = series[self._proved - steps : self._proved, :, 0]
        variation, extent = np.abs(np.diff(states, axis=0)).sum(axis=0), np.ptp(states, axis=0)
        moves = extent > _STILL * np.abs(states).max(axis=0)
        if (variation[moves] <= _DRIFTS * extent[moves]).all():
            raise Unsupported(
                f"{STIFF}: its steps collapse to {took / steps:.3g} at t = {at:.6g}; "
                "use engine: scipy, method: Radau"
            )


def floors(engine: Engine, variables: int) -> Array:
    """Return how small each variable (n,) can be and still count."""
    least = np.empty(variables)
    least[:] = LEAST if engine.sizes is None else LEAST * engine.sizes
    return np.maximum(least, engine.floor)


def _check_pace(steps: int, took: float, left: float) -> None:
    """Raise `TooLong` where the rest of a flow takes more steps than can be made."""
    pace = took / steps
    if pace * _TOO_MANY < left:
        raise TooLong(
            f"{steps} steps advanced the time by {took:.6g}, of {took + left:.6g}; end the run "
            "earlier, or "
            "replace the fast variation by its mean"
        )


def _constrained(watch: FlowWatch, state: Array, local: float) -> tuple[Array, float]:
    """Return a state brought onto its constraints, and how far it was off; the same if near."""
    time = watch.start + local
    off = watch.constraints.off(state, watch.parameters, time)
    # The guards report a state that is not finite.
    if off <= NEAR or not math.isfinite(off):
        return state, 0.0
    following = watch.constraints.project(state, time)
    return following, 0.0 if following is state else off


def _blind(
    watch: FlowWatch, path: Path, first: int, last: int, found: Search
) -> tuple[int, float] | None:
    """Return the step, up to what was found in them, that leaves its constraints, and when."""
    within = watch.constraints.within
    if within is None:
        return None
    where = found.crossing or found.undecided
    left = search(
        within,
        np.full(len(within.outputs), watch.constraints.max_depth),
        path,
        watch.parameters,
        watch.start,
        first,
        last if where is None else where.step + 1,
    )
    blind = left.crossing or left.undecided
    if blind is None or (where is not None and blind.time > where.time):
        return None
    return blind.step, blind.time
