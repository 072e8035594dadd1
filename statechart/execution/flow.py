"""One flow: from a state to the first event, chunk by chunk of steps, each proved by enclosure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from statechart import interrupts
from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import Mode
from statechart.engines.engine import LONGEST_CHUNK, NEAR, Begin, Engine, FlowWatch, Path
from statechart.engines.event_location import Crossing, Search, Verdict, search
from statechart.errors import NonFinite, SimulationError, StepFailure, TooLong, Undecided
from statechart.formulas.series import size_at
from statechart.formulas.tape import Tape, compile_tape
from statechart.kernels.polynomials import cut_steps, sample_states

_FIRST_CHUNK = 4
# A chunk may end this far off its constraints, in tolerances; inside it may be farther.
_DRIFT = 0.2
# A single step that ends so far off was blind to something; of what rounding does this is no part.
_BLIND = 1e3
# What a step half as long is off as much as this part of, comes of errors and rounding far from
# where the run began.
_STAYS = 0.75
# Of the way to where a step left its constraints unseen.
_NEARER = 0.5
# So many steps tell how many the rest takes; of more than this, days at a microsecond each.
_LOOKED_AT, _TOO_MANY = 4096, 1e12
# Errors of dense output, in tolerances of the engine.
_NOISE = 100.0
_LOCATED = (Verdict.CROSSING, Verdict.GRAZE)
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
    watched : tuple of (str, str)
        Name and kind of every margin.
    names : tuple of str
        The names.
    stepper : object
        The engine's own.
    """

    mode: Mode
    guards: Tape
    watched: tuple[tuple[str, str], ...]
    names: tuple[str, ...]
    stepper: object

    def kind(self, guard: int) -> str:
        """Return the kind of a margin."""
        return self.watched[guard][1]


@dataclass(eq=False, slots=True)
class Advance:
    """What `advance` reached; its steps stand in the path.

    Attributes
    ----------
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

    state: Array
    crossing: Crossing | None
    graze: bool
    boxes: int
    steps: int
    failure: SimulationError | KeyboardInterrupt | None = None


def compile_mode(
    engine: Engine, automaton: Automaton, mode: Mode, stepper: object = None
) -> CompiledMode:
    """Put the guards of `mode` on tape; without a `stepper`, let `engine` compile its rates."""
    return CompiledMode(
        mode,
        compile_tape(
            [margin.expression for margin in mode.margins],
            variables=automaton.variables,
            parameters=automaton.parameters,
            time=automaton.time,
            definitions=mode.definitions,
        ),
        tuple((margin.name, margin.kind) for margin in mode.margins),
        tuple(margin.name for margin in mode.margins),
        stepper or engine.compile(automaton, mode),
    )


def advance(
    engine: Engine,
    compiled: CompiledMode,
    path: Path,
    watch: FlowWatch,
    *,
    state: Array,
    duration: float,
    horizon: float,
    on_steps: Callable[[float, int], None] | None,
) -> Advance:
    """Flow in one mode to the first event or to the end of `duration`.

    The integrator runs ahead by a few steps at a time; the search then proves, step by step, that
    no margin fell, or finds the first that did. What was integrated beyond it is dropped.

    Parameters
    ----------
    engine, compiled
        Integrator and mode.
    path : Path
        Takes the steps.
    watch : Watch
        The flow's guards and constraints, its parameters, when it starts.
    state : (n,) array
        State there.
    duration : float
        Longest flow.
    horizon : float
        How far to look ahead at first; grows as the flow goes on. Where a flow is a polynomial
        (free flight) one step could span all of `duration`, and an event soon after its start
        would be lost in that step's rounding.
    on_steps : callable or None
        Called with the local time reached and the steps taken, now and then (progress).

    Returns
    -------
    Advance
        What was reached, also where the flow could not be continued.
    """
    initial = state
    kept = path.count = 0
    reached, boxes, total = 0.0, 0, 0
    count, begin = _FIRST_CHUNK, Begin.NEW
    end = min(horizon, duration)
    seen, mark = math.inf, (0, 0.0)
    failure: SimulationError | KeyboardInterrupt | None = None
    try:
        while reached < duration:
            interrupts.check()
            path.count = kept
            ended, first = np.empty(len(state)), kept
            made = engine.steps(compiled.stepper, path, watch, state, end, count, begin, ended)
            last = path.count
            if made.finished:
                path.times[last] = end
            boxes += made.boxes
            total += last - kept
            if made.first > kept:
                kept, state, reached = made.first, made.begun.copy(), path.times.item(made.first)
            taken = last - kept
            count = max(count, taken)
            local, off = path.times.item(last), 0.0
            following, found = ended, made.found
            if found is None:
                following, off = _constrained(watch, ended, local)
                if off > _DRIFT and taken > 1:
                    # The chunk drifted off its constraints: again, in shorter ones.
                    count, begin = max(1, taken // 4), Begin.MOVED
                    continue
                found = search(
                    watch.guards,
                    watch.tolerances,
                    path.times,
                    path.coefficients,
                    watch.parameters,
                    watch.start,
                    kept,
                    last,
                )
                boxes += found.boxes
            blind = _blind(watch, path, first, last, found)
            if _BLIND < off <= _STAYS * seen and watch.constraints.within is not None:
                blind, seen = (kept, local), off
            if blind is not None:
                # The integrator did not see what it ran into: again, from before that.
                kept, reached = blind[0], path.times.item(blind[0])
                horizon = _NEARER * (blind[1] - reached)
                end = reached + horizon
                if not end > reached:
                    raise StepFailure(
                        f"at t = {watch.start + reached:.17g} no step is short enough to stay on "
                        "the constraints"
                    )
                if cut_steps(path.times, path.coefficients, last, reached, ended) > 0:
                    state = ended
                else:
                    state = initial
                path.count, count, begin = kept, 1, Begin.MOVED
                continue
            noise = _noise(engine, compiled, watch, path, initial, found)
            if noise is not None:
                wider = watch._replace(tolerances=noise)
                again = advance(
                    engine,
                    compiled,
                    path,
                    wider,
                    state=initial,
                    duration=duration,
                    horizon=end,
                    on_steps=on_steps,
                )
                again.boxes, again.steps = again.boxes + boxes, again.steps + total
                return again
            if found.verdict is not Verdict.NONE:
                crossing = _decide(found, compiled, watch, path, reached)
                graze = found.verdict is not Verdict.CROSSING
                late = graze or compiled.kind(crossing.guard) == "force"
                at = crossing.crossed if late else crossing.time
                path.count = cut_steps(path.times, path.coefficients, last, at, ended)
                state = ended if path.count > 0 else initial
                return Advance(state, crossing, graze, boxes, total)
            kept, state, reached, seen = last, following, local, math.inf
            if kept - mark[0] >= _LOOKED_AT:
                _check_pace(kept - mark[0], reached - mark[1], duration - reached)
                mark = kept, reached
            if on_steps is not None:
                on_steps(reached, total)
            if made.finished:
                horizon *= _GROWTH
                end = min(reached + horizon, duration)
            if following is ended:
                begin = Begin.MOVED if made.finished else Begin.ON
                count = min(count + count // 2, LONGEST_CHUNK)
            else:
                # Chunks as long as this one stay near enough to be brought back.
                begin = Begin.MOVED
    except (SimulationError, KeyboardInterrupt) as error:
        failure = error
    path.count = kept
    return Advance(state, None, False, boxes, total, failure)


def _check_pace(steps: int, took: float, left: float) -> None:
    """Raise `TooLong` where the rest of a flow takes more steps than can be made."""
    pace = took / steps
    if pace * _TOO_MANY < left:
        raise TooLong(
            f"{steps} steps took {took:.3g}, and {left:.3g} is left; end the run earlier, or write "
            "what varies so fast by its mean"
        )


def _constrained(watch: FlowWatch, state: Array, local: float) -> tuple[Array, float]:
    """Return a state brought onto its constraints, and how far it was off; the same if near."""
    time = watch.start + local
    off = watch.constraints.off(state, watch.parameters, time)
    # What is not finite is left to the guards to report.
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
        np.full(len(within.outputs), watch.constraints.room),
        path.times,
        path.coefficients,
        watch.parameters,
        watch.start,
        first,
        last if where is None else where.step + 1,
    )
    blind = left.crossing or left.undecided
    if blind is None or (where is not None and blind.time > where.time):
        return None
    return blind.step, blind.time


def _noise(
    engine: Engine,
    compiled: CompiledMode,
    watch: FlowWatch,
    path: Path,
    initial: Array,
    found: Search,
) -> Array | None:
    """Return wider tolerances where what was found is no fall but noise; None where it may be one.

    The laws have kept a mode whose margin starts at zero: it rises from there, or stays. Where its
    first derivatives are zero the polynomials are so to their own errors only, and may dip below
    zero before it rises.
    """
    where = found.crossing or found.undecided
    if where is None or where.guard < 0 or found.verdict not in _LOCATED:
        return None
    guards, parameters, start = compiled.guards, watch.parameters, watch.start
    tolerance = watch.tolerances.item(where.guard)
    begun = guards.values(initial, parameters, start).item(where.guard)
    if compiled.kind(where.guard) != "plain" or not abs(begun) <= tolerance:
        return None
    sizes = np.maximum(np.abs(path.coefficients[where.step]).sum(axis=1), engine.floor)
    times, terms = path.times[: where.step + 2], path.coefficients[: where.step + 1]
    middle = sample_states(terms, times, np.array([0.5 * where.time]))[0]
    margin = guards.values(middle, parameters, start + 0.5 * where.time).item(where.guard)
    size = size_at(guards, where.guard, middle, sizes, parameters, start + where.time)
    wider = _NOISE * engine.tolerance * size
    # Twice as wide at least each time, so that this comes to an end.
    if margin > wider or not wider > 2.0 * tolerance:
        return None
    tolerances = watch.tolerances.copy()
    tolerances[where.guard] = wider
    return tolerances


def _decide(
    found: Search,
    compiled: CompiledMode,
    watch: FlowWatch,
    path: Path,
    reached: float,
) -> Crossing:
    """Return the event that a search found or must be taken for one; raise where it is neither."""
    where, time = found.crossing or found.undecided, watch.start + reached
    assert where is not None
    if found.verdict is Verdict.CROSSING:
        return where
    if found.verdict is Verdict.GRAZE:
        return where
    names = compiled.names
    if found.verdict is Verdict.BUDGET:
        raise Undecided(
            f"no decision within {found.boxes} boxes on one of the guards {', '.join(names)}"
        )
    # An end of the run may lie where the equations end too: the cosine under a force vanishes as
    # the stick lies flat. A margin that is zero there to within its tolerance has been reached.
    terms = path.coefficients[where.step]
    state = (terms * where.s ** np.arange(terms.shape[1])).sum(axis=1)
    margins = compiled.guards.values(state, watch.parameters, time)
    for guard, (value, tolerance) in enumerate(zip(margins, watch.tolerances, strict=True)):
        if compiled.kind(guard) == "plain" and abs(value) <= tolerance:
            return where._replace(guard=guard, crossed=where.time)
    name = names[where.guard] if where.guard >= 0 else "one of " + ", ".join(names)
    raise NonFinite(f"the guard {name} cannot be evaluated near t = {time:.17g}")
