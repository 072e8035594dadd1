"""One flow: from a state to the first event, chunk by chunk of steps, each proved by enclosure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from statechart.automaton import Automaton, Projector
from statechart.compose import Mode
from statechart.enclosure import Crossing, Search, Verdict, search
from statechart.engine import Begin, Engine, Path
from statechart.errors import NonFinite, SimulationError, Undecided
from statechart.kernels import cut_steps
from statechart.tape import Tape, compile_tape

__all__ = ["Advance", "CompiledMode", "advance", "compile_mode"]

Array = NDArray[np.float64]

# Steps are made in chunks that grow by half, so that little is dropped behind an early event.
_FIRST_CHUNK = 4
_LONGEST_CHUNK = 64
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
    names, kinds : tuple of str
        Name and kind of every margin.
    stepper : object
        The engine's own.
    """

    mode: Mode
    guards: Tape
    names: tuple[str, ...]
    kinds: tuple[str, ...]
    stepper: object


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
        tuple(margin.name for margin in mode.margins),
        tuple(margin.kind for margin in mode.margins),
        engine.compile(automaton, mode),
    )


def advance(
    engine: Engine,
    compiled: CompiledMode,
    path: Path,
    *,
    parameters: Array,
    tolerances: Array,
    start: float,
    state: Array,
    duration: float,
    horizon: float,
    project: Projector | None,
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
        Takes the steps; what it held is dropped.
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
    project : Projector or None
        From `Laws.projector`.
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
    failure: SimulationError | KeyboardInterrupt | None = None
    try:
        while reached < duration:
            path.count = kept
            ended = np.empty(len(state))
            finished = engine.steps(
                compiled.stepper,
                path,
                parameters,
                start + reached,
                state,
                end - reached,
                count,
                begin,
                ended,
            )
            last = path.count
            taken = last - kept
            total += taken
            if finished:
                path.times[last] = end
            local = path.times.item(last)
            following, off = ended, 0.0
            if project is not None:
                following, off = project(ended, local)
                if off > _DRIFT and taken > 1:
                    # The chunk drifted off its constraints: again, in shorter ones.
                    count, begin = max(1, taken // 4), Begin.MOVED
                    continue
            found = search(
                compiled.guards,
                tolerances,
                path.times,
                path.coefficients,
                parameters,
                start,
                kept,
                last,
            )
            boxes += found.boxes
            if found.verdict is not Verdict.NONE:
                crossing = _decide(found, compiled, tolerances, path, parameters, start + reached)
                graze = found.verdict is not Verdict.CROSSING
                late = graze or compiled.kinds[crossing.guard] == "force"
                at = crossing.crossed if late else crossing.time
                path.count = cut_steps(path.times, path.coefficients, last, at, ended)
                state = ended if path.count > 0 else initial
                return Advance(state, crossing, graze, boxes, total)
            kept, state, reached = last, following, local
            if on_steps is not None:
                on_steps(reached, total)
            if finished:
                horizon *= _GROWTH
                end = min(reached + horizon, duration)
            if following is ended:
                begin = Begin.MOVED if finished else Begin.ON
                count = min(count + count // 2, _LONGEST_CHUNK)
            else:
                # Chunks as long as this one stay near enough to be brought back.
                begin = Begin.MOVED
    except (SimulationError, KeyboardInterrupt) as error:
        failure = error
    path.count = kept
    return Advance(state, None, False, boxes, total, failure)


def _decide(
    found: Search,
    compiled: CompiledMode,
    tolerances: Array,
    path: Path,
    parameters: Array,
    time: float,
) -> Crossing:
    """Return the event that a search found or must be taken for one; raise where it is neither."""
    where = found.crossing or found.undecided
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
    margins = compiled.guards.values(state, parameters, time)
    for guard, (value, tolerance) in enumerate(zip(margins, tolerances, strict=True)):
        if compiled.kinds[guard] == "plain" and abs(value) <= tolerance:
            return where._replace(guard=guard, crossed=where.time)
    name = names[where.guard] if where.guard >= 0 else "one of " + ", ".join(names)
    raise NonFinite(f"the guard {name} cannot be evaluated near t = {time:.17g}")
