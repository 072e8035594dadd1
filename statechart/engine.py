"""The interface of an integrator, and the one loop that uses it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from statechart.automaton import Automaton
from statechart.compose import Mode
from statechart.enclosure import Crossing, Search, Verdict, search
from statechart.errors import NonFinite, SimulationError, Undecided
from statechart.tape import Tape, compile_tape

__all__ = [
    "LONGEST_CHUNK",
    "Advance",
    "Begin",
    "CompiledMode",
    "Engine",
    "Steps",
    "advance",
    "compile_mode",
    "rates_tape",
]

Array = NDArray[np.float64]

# Steps are made in chunks that grow, so that little is dropped behind an early event.
_FIRST_CHUNK = 4
LONGEST_CHUNK = 64
# A chunk may end this far off its constraints, in tolerances; inside it may be farther.
_DRIFT = 0.2
# The look-ahead in time grows likewise.
_GROWTH = 16.0


@dataclass(frozen=True, eq=False)
class CompiledMode:
    """A mode with its guards on tape, and what an engine made of its rates.

    Attributes
    ----------
    mode : Mode
        Equations and margins.
    guards : Tape
        Outputs: the margins, in order.
    kinds : tuple of str
        Kind of every margin.
    stepper : object
        The engine's own.
    """

    mode: Mode
    guards: Tape
    kinds: tuple[str, ...]
    stepper: object


@dataclass(eq=False)
class Steps:
    """Consecutive steps of an integrator.

    Attributes
    ----------
    times : (k + 1,) array
        When every step ends, counted from where the first starts; 0 before.
    coefficients : (k, n, d + 1) array
        As in `Arc`.
    finished : bool
        Whether the last step ends at the end of the duration asked for.
    """

    times: Array
    coefficients: Array
    finished: bool


class Begin(Enum):
    """How a call for steps follows from the last one."""

    NEW = "another flow, or another run"
    MOVED = "the same flow, its state projected since"
    ON = "the same flow, where it was left"


class Engine(ABC):
    """An integrator: it makes a mode's steps, and knows nothing of events.

    An engine is created for one tolerance and may keep what it compiled for a mode.

    Attributes
    ----------
    name, method : str
        What it is called; `method` is `name` where there is only one.
    tolerance : float
        Relative.
    evaluations : int
        Of the rates, so far; 0 where they are not counted.
    sizes : (n,) array or None
        How large each variable is in the model's own scales, where it says so; set for each run.
    """

    name: str
    method: str
    tolerance: float
    evaluations: int = 0
    sizes: Array | None = None

    @abstractmethod
    def compile(self, automaton: Automaton, mode: Mode) -> object:
        """Return what `steps` needs to integrate `mode`."""

    @abstractmethod
    def steps(
        self,
        stepper: object,
        parameters: Array,
        start: float,
        state: Array,
        duration: float,
        count: int,
        begin: Begin,
    ) -> Steps:
        """Take up to `count` steps.

        Parameters
        ----------
        stepper : object
            What `compile` returned.
        parameters : (p,) array
            Values of the automaton's parameters.
        start : float
            Absolute time at which `state` holds.
        state : (n,) array
            Where to start; not modified.
        duration : float
            Do not step beyond ``start + duration``; the last step ends there exactly.
        count : int
            At most so many steps.
        begin : Begin
            How `state` follows from the last call with this stepper.

        Raises
        ------
        StepFailure, NonFinite
            When not a single step can be made.
        """


@dataclass(frozen=True, eq=False)
class Advance:
    """What `advance` reached.

    Attributes
    ----------
    times, coefficients : arrays
        The arc, as in `Arc`.
    state : (n,) array
        Where it ends.
    crossing : Crossing or None
        The event that ended it; None at the end of the duration.
    graze : bool
        True when the event is one that could not be proved.
    boxes, steps : int
        Costs.
    failure : SimulationError, KeyboardInterrupt or None
        What stopped the flow where it is.
    """

    times: Array
    coefficients: Array
    state: Array
    crossing: Crossing | None
    graze: bool
    boxes: int
    steps: int
    failure: SimulationError | KeyboardInterrupt | None = None


@dataclass(eq=False)
class _Collector:
    times: list[Array] = field(default_factory=list)
    coefficients: list[Array] = field(default_factory=list)

    def arc(self, start: Array) -> tuple[Array, Array]:
        if not self.times:
            return np.zeros(1), np.zeros((0, len(start), 1))
        if len(self.times) == 1:
            return self.times[0], self.coefficients[0]
        return _joined(self.times, self.coefficients)

    def rejoined(self, steps: Steps, local: Array) -> tuple[Steps, Array]:
        """Take the last chunk back and put it before `steps`."""
        times, coefficients = _joined(
            [self.times.pop(), local], [self.coefficients.pop(), steps.coefficients]
        )
        return Steps(times, coefficients, steps.finished), times


def _joined(times: list[Array], coefficients: list[Array]) -> tuple[Array, Array]:
    degree = max(c.shape[2] for c in coefficients)
    padded = [
        c if c.shape[2] == degree else np.pad(c, ((0, 0), (0, 0), (0, degree - c.shape[2])))
        for c in coefficients
    ]
    ends = [times[0], *(later[1:] for later in times[1:])]
    return np.concatenate(ends), np.concatenate(padded)


def compile_mode(engine: Engine, automaton: Automaton, mode: Mode) -> CompiledMode:
    """Put the guards of `mode` on tape and let `engine` compile its rates."""
    return CompiledMode(
        mode,
        compile_tape(
            [margin.expression for margin in mode.margins],
            variables=automaton.variables,
            parameters=automaton.parameters,
            time=automaton.time,
            definitions=mode.definitions,
        ),
        tuple(margin.kind for margin in mode.margins),
        engine.compile(automaton, mode),
    )


def advance(
    engine: Engine,
    compiled: CompiledMode,
    *,
    parameters: Array,
    tolerances: Array,
    start: float,
    state: Array,
    duration: float,
    horizon: float,
    project: Callable[[Array, Array], tuple[Array, float]],
    on_steps: Callable[[float], None],
) -> Advance:
    """Flow in one mode to the first event or to the end of `duration`.

    The integrator runs ahead by a few steps at a time; the search then proves, step by step, that
    no margin fell, or finds the first that did. What was integrated beyond it is dropped.

    Parameters
    ----------
    engine, compiled
        Integrator and mode.
    parameters : (p,) array
        Values of the automaton's parameters.
    tolerances : (g,) array
        One per margin.
    start : float
        Absolute time.
    state : (n,) array
        State there.
    duration : float
        Longest flow.
    horizon : float
        How far to look ahead at first; grows as the flow goes on. Where a flow is a polynomial
        (free flight) one step could span all of `duration`, and an event soon after its start
        would be lost in that step's rounding.
    project : callable
        (state, anchor) -> (state on the mode's constraints, how far it was off in tolerances);
        the same object where they hold.
    on_steps : callable
        Called with the local time reached, now and then (progress).

    Returns
    -------
    Advance
        What was reached, also where the flow could not be continued.
    """
    collected = _Collector()
    anchor = state
    reached, boxes, total = 0.0, 0, 0
    count, begin = _FIRST_CHUNK, Begin.NEW
    end = min(horizon, duration)
    failure: SimulationError | KeyboardInterrupt | None = None
    try:
        while reached < duration:
            steps = engine.steps(
                compiled.stepper, parameters, start + reached, state, end - reached, count, begin
            )
            taken = len(steps.coefficients)
            total += taken
            ended = steps.coefficients[-1].sum(axis=1)
            following, off = project(ended, anchor)
            if off > _DRIFT and taken > 1:
                # The chunk drifted off its constraints: again, in shorter ones.
                count, begin = max(1, taken // 4), Begin.MOVED
                continue
            local = steps.times + reached
            if steps.finished:
                local[-1] = end
                horizon *= _GROWTH
            found = search(
                compiled.guards, tolerances, local, steps.coefficients, parameters, start
            )
            boxes += found.boxes
            while (
                found.crossing is not None and found.crossing.time <= local[0] and collected.times
            ):
                # It fell below zero, though not below its tolerance, in a chunk before.
                steps, local = collected.rejoined(steps, local)
                found = search(
                    compiled.guards, tolerances, local, steps.coefficients, parameters, start
                )
                boxes += found.boxes
            crossing = _decide(found, compiled, tolerances, steps, parameters, start + reached)
            if crossing is not None:
                graze = found.verdict is not Verdict.CROSSING
                late = graze or compiled.kinds[crossing.guard] == "force"
                at = crossing.crossed if late else crossing.time
                state = _cut(collected, steps, local, at, anchor)
                times, coefficients = collected.arc(state)
                return Advance(times, coefficients, state, crossing, graze, boxes, total)
            collected.times.append(local)
            collected.coefficients.append(steps.coefficients)
            reached = float(local[-1])
            on_steps(reached)
            state = following
            if state is ended:
                begin = Begin.MOVED if steps.finished else Begin.ON
                count = min(2 * count, LONGEST_CHUNK)
            else:
                begin = Begin.MOVED
                count = max(1, count // 2)
            if begin is not Begin.ON:
                end = min(reached + horizon, duration)
    except (SimulationError, KeyboardInterrupt) as error:
        failure = error
    times, coefficients = collected.arc(state)
    return Advance(times, coefficients, state, None, False, boxes, total, failure)


def _decide(
    found: Search,
    compiled: CompiledMode,
    tolerances: Array,
    steps: Steps,
    parameters: Array,
    time: float,
) -> Crossing | None:
    if found.verdict is Verdict.NONE:
        return None
    if found.verdict is Verdict.CROSSING:
        return found.crossing
    where = found.undecided
    assert where is not None
    if found.verdict is Verdict.GRAZE:
        return where
    names = [margin.name for margin in compiled.mode.margins]
    if found.verdict is Verdict.BUDGET:
        raise Undecided(
            f"no decision within {found.boxes} boxes on one of the guards {', '.join(names)}"
        )
    # An end of the run may lie where the equations end too: the cosine under a force vanishes as
    # the stick lies flat. A margin that is zero there to within its tolerance has been reached.
    state = (steps.coefficients[where.step] * where.s ** _powers(steps)).sum(axis=1)
    margins = compiled.guards.values(state, parameters, time)
    for guard, (value, tolerance) in enumerate(zip(margins, tolerances, strict=True)):
        if compiled.kinds[guard] == "plain" and abs(value) <= tolerance:
            return replace(where, guard=guard, crossed=where.time)
    name = names[where.guard] if where.guard >= 0 else "one of " + ", ".join(names)
    raise NonFinite(f"the guard {name} cannot be evaluated near t = {time:.17g}")


def _powers(steps: Steps) -> Array:
    return np.arange(steps.coefficients.shape[2], dtype=float)


def _cut(collected: _Collector, steps: Steps, local: Array, end: float, anchor: Array) -> Array:
    """End the arc at local time `end`, inside or before the steps at hand; return the state."""
    if end <= local[0]:
        # The margin started falling where this chunk starts: nothing of it is kept.
        before = collected.coefficients
        return before[-1][-1].sum(axis=1) if before else anchor
    kept = max(int(local.searchsorted(end)), 1)
    begin = local[kept - 1]
    s = (end - begin) / (local[kept] - begin)
    times, coefficients = local[: kept + 1], steps.coefficients[:kept]
    times[-1] = end
    last = coefficients[-1]
    last *= s ** _powers(steps)
    collected.times.append(times)
    collected.coefficients.append(coefficients)
    return last.sum(axis=1)


def rates_tape(automaton: Automaton, mode: Mode) -> Tape:
    """Return the rates of `mode` as a tape."""
    return compile_tape(
        mode.rates,
        variables=automaton.variables,
        parameters=automaton.parameters,
        time=automaton.time,
        definitions=mode.definitions,
    )
