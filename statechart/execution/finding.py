"""Judgement of a located event: integrator noise, an event, or undecided.

The tolerance of a margin is the round-off of its terms where the flow begins. Elsewhere the margin
can be known far better: after a start at x = -1 the tolerance of ``x**2 - 1e-14`` is 4e-14, but at
x = 0 its error is 1e-28. A margin that begins above its tolerance is therefore searched with
tolerance zero first. What that finds is an event if the margin falls further than an error of the
state changes it by.
"""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array
from statechart.automaton.laws import Flow, Instant, Setup
from statechart.engines.compiled_flow import EVALUATED
from statechart.engines.engine import Engine, FlowWatch, Path
from statechart.engines.event_location import Crossing, Search, Verdict, search
from statechart.errors import NonFinite, Undecided
from statechart.execution.compiled_modes import CompiledMode
from statechart.formulas.series import sizes_at
from statechart.formulas.tape import Tape
from statechart.kernels.polynomials import sample_states

# Errors of dense output, in tolerances of the engine.
_NOISE = 100.0
# A gap that is closed to this part of its tolerance as the run ends has just closed.
AT_END = 1e-2
_LOCATED = (Verdict.CROSSING, Verdict.GRAZE)
STATE_TOLERANCES, STATE_ROUND_OFF = 10.0, 1e-13
"""Error of a variable: so many tolerances of the engine, or that part of its size."""


def noise(
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
    (size,) = sizes_at(guards, (where.guard,), middle, sizes, parameters, start + where.time)
    wider = _NOISE * engine.tolerance * size
    # Twice as wide at least each time, so that this comes to an end.
    if margin > wider or not wider > 2.0 * tolerance:
        return None
    tolerances = watch.tolerances.copy()
    tolerances[where.guard] = wider
    return tolerances


def decided(found: Search, compiled: CompiledMode, watch: FlowWatch, path: Path) -> Crossing:
    """Return the event that a search found or must be taken for one; raise where it is neither."""
    where = found.crossing or found.undecided
    assert where is not None
    time = watch.start + where.time
    if found.verdict is Verdict.CROSSING:
        return where
    if found.verdict is Verdict.GRAZE:
        return where
    names = compiled.names
    if found.verdict is Verdict.BUDGET:
        raise Undecided(
            f"the search for events of {', '.join(names)} was given up after {found.boxes} "
            "interval evaluations; simplify the guard, or take shorter steps (--max-step)"
        )
    # An end of the run may lie where the equations end too: the cosine under a force vanishes as
    # the stick lies flat. A margin that is zero there to within its tolerance has been reached.
    terms = path.coefficients[where.step]
    state = (terms * where.s ** np.arange(terms.shape[1])).sum(axis=1)
    margins = compiled.guards.values(state, watch.parameters, time)
    for guard, (value, tolerance) in enumerate(zip(margins, watch.tolerances, strict=True)):
        if compiled.kind(guard) == "plain" and abs(value) <= tolerance < math.inf:
            return where._replace(guard=guard, crossed=where.time)
    name = names[where.guard] if where.guard >= 0 else "one of " + ", ".join(names)
    raise NonFinite(
        f"the guard {name} has no value near t = {time:.6g}; look for a logarithm, root or "
        "quotient without a value there"
    )


def closing(
    engine: Engine, compiled: CompiledMode, flow: Flow, setup: Setup, state: Array, time: float
) -> tuple[bool, dict[str, float]]:
    """Return whether something may just be happening in a state, and the tolerances of the flow.

    Those of margins that a run may be off by more than by their own are wider.
    """
    guards, parameters = compiled.guards, setup.values
    margins = guards.values(state, parameters, time).tolist()
    sizes = np.abs(state) if flow.sizes is None else flow.sizes
    closed, tolerances = False, {**flow.tolerances}
    wider = tuple(
        place
        for place, (name, kind) in enumerate(compiled.watched)
        if kind == "plain" and tolerances.get(name, math.inf) < math.inf
    )
    terms = dict(zip(wider, sizes_at(guards, wider, state, sizes, parameters, time), strict=True))
    for place, ((name, kind), margin) in enumerate(zip(compiled.watched, margins, strict=True)):
        if kind == "gap":
            closed |= margin <= AT_END * setup.tolerances[kind]
        elif kind == "speed":
            closed |= margin <= setup.tolerances[kind]
        elif place in terms:
            tolerances[name] = max(tolerances[name], engine.tolerance * terms[place])
            closed |= margin <= tolerances[name]
    return closed, tolerances


def only_stops(compiled: CompiledMode, at: Instant, stops: int) -> bool:
    """Return whether only stop conditions, which stand last, are on their boundary."""
    margins = compiled.guards.values(at.state, at.setup.values, at.clock.high).tolist()
    usual, special = at.setup.tolerances, at.flow.tolerances
    watched = zip(compiled.watched[: len(margins) - stops], margins, strict=False)
    for (name, kind), margin in watched:
        tolerance = special.get(name, usual[kind])
        if tolerance < math.inf and not margin > tolerance:
            return False
    return True


def from_here(compiled: CompiledMode, flow: Flow, setup: Setup, state: Array, time: float) -> Flow:
    """Return a flow in which forces that begin beyond their bounds fall from where they begin."""
    tolerances = {**flow.tolerances}
    margins = compiled.guards.values(state, setup.values, time).tolist()
    for (name, kind), margin in zip(compiled.watched, margins, strict=True):
        if kind in ("force", "hold") and margin < 0.0 and name not in tolerances:
            tolerances[name] = setup.tolerances[kind] - margin
    return flow._replace(tolerances=tolerances)


def first_tolerances(compiled: CompiledMode, watch: FlowWatch, state: Array, local: float) -> Array:
    """Return the tolerances to search with first, from a state at a local time on.

    They are zero for the plain margins that are above their tolerance there.
    """
    usual, plain = watch.tolerances, compiled.plain
    if not (usual[plain] > 0.0).any():
        return usual
    margins = compiled.guards.values(state, watch.parameters, watch.start + local)
    return np.where(plain & (margins > usual), 0.0, usual)


def judge(
    found: Search,
    engine: Engine,
    compiled: CompiledMode,
    watch: FlowWatch,
    path: Path,
    tolerances: Array,
    last: int,
) -> Search:
    """Return the first event among the falls that a search with `first_tolerances` comes upon.

    A fall below the usual tolerance is one, and a fall below the local error of the margin. The
    steps before `last` are searched again with a larger tolerance where a fall is neither.
    """
    tolerances = tolerances.copy()
    while found.verdict in _LOCATED:
        where = found.crossing or found.undecided
        assert where is not None
        guard, usual = where.guard, watch.tolerances.item(where.guard)
        if not tolerances[guard] < usual:
            break
        again = _search(watch, path, watch.tolerances, where.step, last)
        if again.crossing and again.crossing.guard == guard and _same(again.crossing, where):
            found = again
            break
        local, steps = where.time, path.coefficients[:last]
        state = sample_states(steps, path.times[: last + 1], np.array([local]))[0]
        time = watch.start + local
        errors = relative_error(engine) * path_sizes(steps)
        error = margin_errors(compiled.guards, guard, state, errors, watch.parameters, time)
        error = min(usual, error)
        if found.verdict is Verdict.CROSSING and error <= 2.0 * tolerances[guard]:
            break
        # At least twice as large each time, so that this comes to an end.
        tolerances[guard] = error if error > 2.0 * tolerances[guard] else usual
        found = _search(watch, path, tolerances, where.step, last)
    return found


def _search(watch: FlowWatch, path: Path, tolerances: Array, first: int, last: int) -> Search:
    return search(watch.guards, tolerances, path, watch.parameters, watch.start, first, last)


def _same(one: Crossing, other: Crossing) -> bool:
    """Tell whether two crossings are one root to within round-off of time."""
    return one.time <= max(other.time, other.crossed) * (1.0 + EVALUATED)


def relative_error(engine: Engine) -> float:
    """Return by what part of its size a variable may be off."""
    return max(STATE_TOLERANCES * engine.tolerance, STATE_ROUND_OFF)


def path_sizes(steps: Array) -> Array:
    """Return bounds of the variables (n,) over steps (m, n, d + 1)."""
    found: Array = np.abs(steps).sum(axis=2).max(axis=0)
    return found


def margin_errors(
    guards: Tape, guard: int, state: Array, errors: Array, parameters: Array, time: float
) -> float:
    """Return by how much a margin is off in a state (n,) whose variables are off by `errors`.

    That is what it changes by when each of them is moved alone, and time by its round-off, and the
    round-off of its own terms.
    """
    states = np.vstack([state, state, state + np.diag(errors)])
    times = np.full(len(states), time)
    times[1] += EVALUATED * abs(time)
    with np.errstate(all="ignore"):
        values = guards.table(states, parameters, times)[:, guard]
    (terms,) = sizes_at(guards, (guard,), state, np.abs(state), parameters, time)
    return float(np.abs(values[1:] - values[0]).sum()) + EVALUATED * terms
